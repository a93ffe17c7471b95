//! The backend that is always there: `rten`, in pure Rust.

use super::{Network, Sockets, Tensor};
use photocurrent_core::NodeError;
use rten::{Model, RunOptions, ThreadPool, ValueView};
use rten_tensor::Layout;
use std::sync::Arc;

/// A network of the embedded backend.
pub(crate) struct Embedded {
    name: String,
    model: Model,
}

impl Embedded {
    /// From the content of an ONNX file.
    ///
    /// # Errors
    /// When it is none, or has operators that are not known here.
    pub(crate) fn load(name: &str, content: Vec<u8>) -> Result<Embedded, NodeError> {
        let model = Model::load(content).map_err(|error| {
            NodeError::input(format!("{name} is no network that the embedded backend can run: {error}")).hint(
                "check the file, or name an ONNX Runtime library in `runtime`, which has more operators",
            )
        })?;
        Ok(Embedded { name: name.into(), model })
    }

    fn failed(&self, error: impl std::fmt::Display) -> NodeError {
        NodeError::failed(format!("the network {} failed: {error}", self.name))
            .hint("check that pictures are of a size that the network takes")
    }

    fn calculate(&self, inputs: &[(&str, &Tensor)], outputs: &[&str]) -> Result<Vec<Tensor>, NodeError> {
        let id = |name: &str| {
            self.model.node_id(name).map_err(|_| {
                NodeError::input(format!("the network {} has no input or output `{name}`", self.name))
            })
        };
        let mut values = Vec::with_capacity(inputs.len());
        for (name, tensor) in inputs {
            let view =
                ValueView::from_shape(&tensor.shape, &tensor.values).map_err(|error| self.failed(error))?;
            values.push((id(name)?, view.into()));
        }
        // One thread: frames are what runs side by side, on the threads that the user allows.
        let options = RunOptions::default().with_thread_pool(Some(Arc::new(ThreadPool::with_num_threads(1))));
        let wanted = outputs.iter().map(|name| id(name)).collect::<Result<Vec<_>, NodeError>>()?;
        let results = self.model.run(values, &wanted, Some(options)).map_err(|error| self.failed(error))?;
        let tensor = |result: rten::Value| -> Result<Tensor, NodeError> {
            let result: rten_tensor::Tensor<f32> =
                result.try_into().map_err(|error: rten::TryFromValueError| self.failed(error))?;
            Ok(Tensor { shape: result.shape().to_vec(), values: result.into_data() })
        };
        results.into_iter().map(tensor).collect()
    }
}

impl Network for Embedded {
    fn run_all(&self, inputs: &[(&str, &Tensor)], outputs: &[&str]) -> Result<Vec<Tensor>, NodeError> {
        // A thread of its own: a worker of the caller's pool that waited for another pool would begin further
        // frames meanwhile, without end.
        std::thread::scope(|scope| {
            let thread = scope.spawn(|| self.calculate(inputs, outputs));
            thread.join().unwrap_or_else(|_| Err(self.failed("it panicked")))
        })
    }

    fn sockets(&self) -> Sockets {
        let names = |ids: &[rten::NodeId]| {
            ids.iter().filter_map(|id| self.model.node_info(*id)?.name().map(String::from)).collect()
        };
        Sockets { inputs: names(self.model.input_ids()), outputs: names(self.model.output_ids()) }
    }

    fn backend(&self) -> String {
        "embedded (rten 0.27)".into()
    }
}
