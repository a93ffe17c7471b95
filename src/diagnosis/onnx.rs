//! The proposer as a network file in ONNX format, so that any runtime of such files can run it.
//!
//! Source: onnx.proto of ONNX IR version 8, operator set 13: a message is a sequence of fields, each a key (number and wire type) and a value. Only what a chain of
//! `Gemm`, `Relu` and `Softmax` needs is written. The input is `input` [1, n] ([`crate::proposer::Net::input`]), the output `probability` [1, labels].

use crate::proposer::Net;

/// Bytes of a message.
#[derive(Default)]
struct Message(Vec<u8>);

impl Message {
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push((value as u8) | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    fn number(mut self, field: u64, value: u64) -> Message {
        self.varint(field << 3);
        self.varint(value);
        self
    }

    fn bytes(mut self, field: u64, value: &[u8]) -> Message {
        self.varint(field << 3 | 2);
        self.varint(value.len() as u64);
        self.0.extend(value);
        self
    }

    fn text(self, field: u64, value: &str) -> Message {
        self.bytes(field, value.as_bytes())
    }

    fn message(self, field: u64, value: &Message) -> Message {
        self.bytes(field, &value.0)
    }
}

const FLOAT: u64 = 1;

fn tensor(name: &str, shape: &[usize], values: &[f32]) -> Message {
    let mut message = Message::default();
    for length in shape {
        message = message.number(1, *length as u64);
    }
    let raw: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    message.number(2, FLOAT).text(8, name).bytes(9, &raw)
}

fn value(name: &str, shape: &[usize]) -> Message {
    let dimensions = shape.iter().fold(Message::default(), |message, length| message.message(1, &Message::default().number(1, *length as u64)));
    let of_tensor = Message::default().number(1, FLOAT).message(2, &dimensions);
    Message::default().text(1, name).message(2, &Message::default().message(1, &of_tensor))
}

fn node(operator: &str, inputs: &[&str], output: &str) -> Message {
    let message = inputs.iter().fold(Message::default(), |message, input| message.text(1, input));
    message.text(2, output).text(3, output).text(4, operator)
}

impl Net {
    /// The net as the content of an ONNX file: the same bytes for the same weights.
    pub fn to_onnx(&self) -> Vec<u8> {
        let (inputs, outputs) = (self.layers.first().map_or(0, |layer| layer.inputs), self.layers.last().map_or(0, |layer| layer.outputs));
        let (mut nodes, mut initial) = (Vec::new(), Vec::new());
        let mut from = "input".to_owned();
        for (n, layer) in self.layers.iter().enumerate() {
            let (weights, bias, sum) = (format!("weights_{n}"), format!("bias_{n}"), format!("sum_{n}"));
            initial.push(tensor(&weights, &[layer.inputs, layer.outputs], &layer.weights));
            initial.push(tensor(&bias, &[layer.outputs], &layer.bias));
            nodes.push(node("Gemm", &[&from, &weights, &bias], &sum));
            from = sum;
            if n + 1 < self.layers.len() {
                let hidden = format!("hidden_{n}");
                nodes.push(node("Relu", &[&from], &hidden));
                from = hidden;
            }
        }
        // Attribute `axis` = 1 of kind INT.
        let axis = Message::default().text(1, "axis").number(3, 1).number(20, 2);
        nodes.push(node("Softmax", &[&from], "probability").message(5, &axis));
        let mut graph = nodes.iter().fold(Message::default(), |graph, node| graph.message(1, node)).text(2, "proposer");
        for tensor in &initial {
            graph = graph.message(5, tensor);
        }
        let graph = graph.message(11, &value("input", &[1, inputs])).message(12, &value("probability", &[1, outputs]));
        let operators = Message::default().text(1, "").number(2, 13);
        Message::default().number(1, 8).text(2, "photocurrent").message(7, &graph).message(8, &operators).0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_as_the_format_says() {
        // 150 as field 1: the example of the format's own description.
        assert_eq!(Message::default().number(1, 150).0, [0x08, 0x96, 0x01]);
        assert_eq!(Message::default().text(2, "testing").0, [0x12, 0x07, 0x74, 0x65, 0x73, 0x74, 0x69, 0x6e, 0x67]);
    }
}
