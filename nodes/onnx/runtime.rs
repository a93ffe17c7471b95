//! The backend that a manifest may name: the ONNX Runtime library, loaded while the program runs.
//!
//! Where a library is: PyPI's `onnxruntime` has it as `onnxruntime/capi/libonnxruntime.so.<version>`; 1.24 is
//! the oldest that fits. A process loads one library, and keeps it.

use super::{Network, Sockets, Tensor};
use ort::environment::Environment;
use ort::session::{Session, SessionInputValue};
use photocurrent_core::NodeError;
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// The library of this process.
static LOADED: Mutex<Option<(PathBuf, Environment)>> = Mutex::new(None);

/// A network of ONNX Runtime.
pub(crate) struct Runtime {
    name: String,
    library: String,
    content: Vec<u8>,
    environment: Environment,
    sockets: Sockets,
    /// A session serves one caller at a time; those that nobody uses wait here.
    idle: Mutex<Vec<Session>>,
}

fn environment(library: &Path) -> Result<Environment, NodeError> {
    let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((path, environment)) = &*loaded {
        if path == library {
            return Ok(environment.clone());
        }
        return Err(NodeError::usage(format!(
            "{} was loaded before, and one process cannot use {} as well",
            path.display(),
            library.display()
        ))
        .hint("name one library in all nodes")
        .param("runtime"));
    }
    let cannot = |error: String| {
        NodeError::files(format!("cannot load {} as the ONNX Runtime library: {error}", library.display()))
            .hint(
                "name libonnxruntime of version 1.24 or newer (in PyPI's onnxruntime: \
                   onnxruntime/capi/libonnxruntime.so.<version>), or leave `runtime` out",
            )
            .param("runtime")
    };
    if !library.is_file() {
        return Err(cannot("there is no such file".into()));
    }
    let environment = ort::init_from(library)
        .map_err(|error| cannot(error.to_string()))?
        .build()
        .map_err(|error| cannot(error.to_string()))?;
    *loaded = Some((library.into(), environment.clone()));
    Ok(environment)
}

impl Runtime {
    /// From the content of an ONNX file.
    ///
    /// # Errors
    /// When the library cannot be loaded, or refuses the network.
    pub(crate) fn load(name: &str, content: Vec<u8>, library: &Path) -> Result<Runtime, NodeError> {
        let environment = environment(library)?;
        let file = library.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let mut runtime = Runtime {
            name: name.into(),
            library: file,
            content,
            environment,
            sockets: Sockets { inputs: Vec::new(), outputs: Vec::new() },
            idle: Mutex::new(Vec::new()),
        };
        let first = runtime.session()?;
        let names =
            |outlets: &[ort::value::Outlet]| outlets.iter().map(|outlet| outlet.name().to_string()).collect();
        runtime.sockets = Sockets { inputs: names(first.inputs()), outputs: names(first.outputs()) };
        runtime.give_back(first);
        Ok(runtime)
    }

    fn session(&self) -> Result<Session, NodeError> {
        let waiting = self.idle.lock().unwrap_or_else(PoisonError::into_inner).pop();
        if let Some(session) = waiting {
            return Ok(session);
        }
        let refused = |error: String| {
            NodeError::input(format!("{} is no network that ONNX Runtime can run: {error}", self.name))
                .hint("check the file")
        };
        // One thread: frames are what runs side by side, on the threads that the user allows.
        let builder = Session::builder(&self.environment).map_err(|error| refused(error.to_string()))?;
        let mut builder = builder.with_intra_threads(1).map_err(|error| refused(error.to_string()))?;
        builder.commit_from_memory(&self.content).map_err(|error| refused(error.to_string()))
    }

    fn give_back(&self, session: Session) {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).push(session);
    }

    fn failed(&self, error: impl std::fmt::Display) -> NodeError {
        NodeError::failed(format!("the network {} failed: {error}", self.name))
            .hint("check that pictures are of a size that the network takes")
    }

    fn calculate(
        &self,
        session: &mut Session,
        inputs: &[(&str, &Tensor)],
        outputs: &[&str],
    ) -> Result<Vec<Tensor>, NodeError> {
        let mut values: Vec<(Cow<str>, SessionInputValue)> = Vec::with_capacity(inputs.len());
        for (name, tensor) in inputs {
            let shape: Vec<i64> = tensor.shape.iter().map(|n| *n as i64).collect();
            let value = ort::value::Tensor::from_array((shape, tensor.values.clone()))
                .map_err(|error| self.failed(error))?;
            values.push(((*name).into(), value.into()));
        }
        let results = session.run(values).map_err(|error| self.failed(error))?;
        let tensor = |output: &&str| -> Result<Tensor, NodeError> {
            let value = results.get(output).ok_or_else(|| {
                NodeError::input(format!("the network {} has no input or output `{output}`", self.name))
            })?;
            let (shape, values) = value.try_extract_tensor::<f32>().map_err(|error| self.failed(error))?;
            Ok(Tensor { shape: shape.iter().map(|n| *n as usize).collect(), values: values.to_vec() })
        };
        outputs.iter().map(tensor).collect()
    }
}

impl Network for Runtime {
    fn run_all(&self, inputs: &[(&str, &Tensor)], outputs: &[&str]) -> Result<Vec<Tensor>, NodeError> {
        let mut session = self.session()?;
        let result = self.calculate(&mut session, inputs, outputs);
        self.give_back(session);
        result
    }

    fn sockets(&self) -> Sockets {
        self.sockets.clone()
    }

    fn backend(&self) -> String {
        format!("ONNX Runtime ({})", self.library)
    }
}
