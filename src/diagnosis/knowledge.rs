//! What a diagnosis knows beforehand: the floor of nulls, their biases, and the net, in one file.
//!
//! The file is written with its lengths first and little-endian numbers, the same bytes for the same content. Deviations and weights are rounded to 16 bits (a third
//! of a per cent): far below what they mean.

use crate::candidates::CANDIDATES;
use crate::floor::{Floor, Null};
use crate::proposer::{Layer, Net, labels};

/// Floor, biases and net.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Knowledge {
    /// Names of the summaries that it was made for.
    pub names: Vec<String>,
    /// Deviations that mean nothing.
    pub floor: Floor,
    /// Strengths of all candidates that recordings without an effect seem to have ([`crate::linear`]), as deviations of nulls.
    pub biases: Floor,
    /// Proposes causes; without it every cause is as likely.
    pub net: Option<Net>,
}

const MAGIC: &[u8] = b"photocurrent-knowledge/2\n";

struct Reader<'a> {
    bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    fn take(&mut self, n: usize) -> Result<&'a [u8], String> {
        let (head, tail) = self.bytes.split_at_checked(n).ok_or_else(|| "it ends too early".to_owned())?;
        self.bytes = tail;
        Ok(head)
    }
    fn number(&mut self) -> Result<usize, String> {
        let b = self.take(4)?;
        Ok(u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize)
    }
    fn text(&mut self) -> Result<String, String> {
        let n = self.number()?;
        String::from_utf8(self.take(n)?.to_vec()).map_err(|_| "a name is no UTF-8".to_owned())
    }
    fn values(&mut self) -> Result<Vec<f32>, String> {
        let n = self.number()?;
        Ok(self.take(2 * n)?.chunks_exact(2).map(|b| f32::from_bits(u32::from(u16::from_le_bytes([b[0], b[1]])) << 16)).collect())
    }
}

fn put_number(bytes: &mut Vec<u8>, n: usize) {
    bytes.extend((n as u32).to_le_bytes());
}

fn put_text(bytes: &mut Vec<u8>, text: &str) {
    put_number(bytes, text.len());
    bytes.extend(text.as_bytes());
}

/// The upper half of a number's bits, rounded to nearest.
fn put_values(bytes: &mut Vec<u8>, values: &[f32]) {
    put_number(bytes, values.len());
    for value in values {
        let bits = value.to_bits();
        let rounded = bits.saturating_add(0x7fff + ((bits >> 16) & 1)) >> 16;
        bytes.extend((rounded as u16).to_le_bytes());
    }
}

/// What comes with the program.
const SHIPPED: &[u8] = include_bytes!("../../data/diagnosis/knowledge.bin");

impl Knowledge {
    /// The knowledge that comes with the program.
    ///
    /// # Errors
    /// When it was made for another catalogue of effects.
    pub fn shipped() -> Result<Knowledge, String> {
        Knowledge::from_bytes(SHIPPED)
    }

    /// As a file.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        put_number(&mut bytes, self.names.len());
        self.names.iter().for_each(|name| put_text(&mut bytes, name));
        put_nulls(&mut bytes, &self.floor);
        put_nulls(&mut bytes, &self.biases);
        put_number(&mut bytes, self.net.as_ref().map_or(0, |net| net.layers.len()));
        if let Some(net) = &self.net {
            put_values(&mut bytes, &net.context.iter().map(|(mean, _)| *mean).collect::<Vec<f32>>());
            put_values(&mut bytes, &net.context.iter().map(|(_, spread)| *spread).collect::<Vec<f32>>());
            put_number(&mut bytes, net.labels.len());
            net.labels.iter().for_each(|label| put_text(&mut bytes, label));
            for layer in &net.layers {
                put_number(&mut bytes, layer.inputs);
                put_values(&mut bytes, &layer.weights);
                put_values(&mut bytes, &layer.bias);
            }
        }
        bytes
    }

    /// From a file's content.
    ///
    /// # Errors
    /// When it is no such file, is cut off, its lengths do not fit each other, or its labels are not those of this catalogue.
    pub fn from_bytes(bytes: &[u8]) -> Result<Knowledge, String> {
        let Some(content) = bytes.strip_prefix(MAGIC) else {
            let is_other = bytes.starts_with(b"photocurrent-knowledge/");
            let why = if is_other {
                "it is knowledge of another version of this program; make it anew with `photocurrent learn`"
            } else {
                "it does not begin as knowledge of a diagnosis does"
            };
            return Err(why.to_owned());
        };
        let mut reader = Reader { bytes: content };
        let count = reader.number()?;
        let names = (0..count).map(|_| reader.text()).collect::<Result<Vec<String>, String>>()?;
        let floor = read_nulls(&mut reader)?;
        let contexts = floor.nulls.first().map_or(0, |null| null.context.len());
        if floor.nulls.iter().any(|null| null.deviation.len() != names.len() || null.context.len() != contexts) {
            return Err("a null has another number of summaries than there are names".to_owned());
        }
        let biases = read_nulls(&mut reader)?;
        if biases.nulls.iter().any(|null| null.deviation.len() > CANDIDATES.len() || null.context.len() != contexts) {
            return Err("a null has another number of strengths than there are candidates in this catalogue; make it anew".to_owned());
        }
        let count = reader.number()?;
        let net = if count == 0 { None } else { Some(read_net(&mut reader, count, names.len() + contexts)?) };
        Ok(Knowledge { names, floor, biases, net })
    }
}

fn put_nulls(bytes: &mut Vec<u8>, floor: &Floor) {
    put_number(bytes, floor.nulls.len());
    for null in &floor.nulls {
        put_text(bytes, &null.name);
        put_values(bytes, &null.context);
        put_values(bytes, &null.deviation);
    }
}

fn read_nulls(reader: &mut Reader<'_>) -> Result<Floor, String> {
    let count = reader.number()?;
    let null = |reader: &mut Reader<'_>| -> Result<Null, String> { Ok(Null { name: reader.text()?, context: reader.values()?, deviation: reader.values()? }) };
    Ok(Floor { nulls: (0..count).map(|_| null(reader)).collect::<Result<Vec<Null>, String>>()? })
}

fn read_net(reader: &mut Reader<'_>, count: usize, inputs: usize) -> Result<Net, String> {
    let (mean, spread) = (reader.values()?, reader.values()?);
    let named = reader.number()?;
    let found = (0..named).map(|_| reader.text()).collect::<Result<Vec<String>, String>>()?;
    if found != labels() {
        return Err("its effects are not those of this catalogue; train it anew".to_owned());
    }
    let mut layers: Vec<Layer> = Vec::new();
    for _ in 0..count {
        let (inputs, weights, bias) = (reader.number()?, reader.values()?, reader.values()?);
        layers.push(Layer { inputs, outputs: bias.len(), weights, bias });
    }
    let fits = layers.iter().all(|layer| layer.weights.len() == layer.inputs * layer.outputs)
        && layers.windows(2).all(|pair| pair[0].outputs == pair[1].inputs)
        && layers.first().is_some_and(|layer| layer.inputs == inputs)
        && layers.last().is_some_and(|layer| layer.outputs == found.len());
    if !fits {
        return Err("its layers do not fit each other".to_owned());
    }
    Ok(Net { labels: found, context: mean.into_iter().zip(spread).collect(), layers })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_with_the_program_fits_its_summaries_and_has_nulls() {
        let shipped = Knowledge::shipped().unwrap();
        assert_eq!(shipped.names, crate::summaries::names().unwrap());
        assert!(shipped.floor.nulls.len() >= 30 && shipped.biases.nulls.len() >= 30 && shipped.net.is_some());
        assert_eq!(shipped.to_bytes(), SHIPPED);
    }

    #[test]
    fn knowledge_survives_being_written_and_a_cut_file_is_refused() {
        let null = Null { name: "a".into(), context: vec![1.0, -0.5], deviation: vec![0.25, 3.0, -2.0] };
        let layer = |inputs: usize, outputs: usize| Layer { inputs, outputs, weights: vec![0.5; inputs * outputs], bias: vec![-1.0; outputs] };
        let net = Net { labels: labels(), context: vec![(0.0, 1.0); 2], layers: vec![layer(5, 4), layer(4, labels().len())] };
        let names = ["x", "y", "z"].map(str::to_owned).to_vec();
        let bias = Null { deviation: vec![0.5; CANDIDATES.len()], ..null.clone() };
        let knowledge = Knowledge { names, floor: Floor { nulls: vec![null] }, biases: Floor { nulls: vec![bias] }, net: Some(net) };
        let bytes = knowledge.to_bytes();
        let back = Knowledge::from_bytes(&bytes).unwrap();
        assert_eq!(back, knowledge);
        for cut in [0, 10, 40, bytes.len() / 2, bytes.len() - 1] {
            assert!(Knowledge::from_bytes(&bytes[..cut]).is_err(), "{cut}");
        }
        assert!(Knowledge::from_bytes(b"photocurrent-knowledge/1\n").unwrap_err().contains("photocurrent learn"));
    }
}
