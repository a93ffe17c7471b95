//! The one place that runs networks: a network is a file in ONNX format, and one trait stands before what
//! runs it.
//!
//! Two backends: [`embedded`] is pure Rust, always there, and the default; [`runtime`] loads the ONNX Runtime
//! library that a manifest names, which knows more operators and is faster. Which one ran belongs into the
//! card of a score, and the library's content into the key of the node.
//!
//! Limits: f32 tensors only. Sums are taken in another order on other processors, so numbers agree between
//! machines and backends to about 1e-6 of their size, not to the last bit; on one machine they do not depend
//! on the number of threads.

pub(crate) mod embedded;
pub(crate) mod runtime;

use photocurrent_core::quantity::InputPath;
use photocurrent_core::{FileRef, NodeError};
use std::path::Path;

/// Numbers with a shape, row-major.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tensor {
    /// Length of each dimension.
    pub shape: Vec<usize>,
    /// The values, the last dimension fastest.
    pub values: Vec<f32>,
}

/// Names of a network's inputs and outputs, in the order of its file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sockets {
    /// What it has to be given.
    pub inputs: Vec<String>,
    /// What it gives.
    pub outputs: Vec<String>,
}

/// A network ready to run, from many threads at once.
pub(crate) trait Network: Send + Sync {
    /// The outputs of these names, in this order, for inputs by name.
    ///
    /// # Errors
    /// When the network has no input or output of such a name, or does not take such shapes.
    fn run_all(&self, inputs: &[(&str, &Tensor)], outputs: &[&str]) -> Result<Vec<Tensor>, NodeError>;

    /// The output of a name for inputs by name.
    ///
    /// # Errors
    /// As [`Network::run_all`].
    fn run(&self, inputs: &[(&str, &Tensor)], output: &str) -> Result<Tensor, NodeError> {
        let all = self.run_all(inputs, &[output])?;
        all.into_iter()
            .next()
            .ok_or_else(|| NodeError::failed(format!("the network gave nothing for its output `{output}`")))
    }

    /// What it takes and gives.
    fn sockets(&self) -> Sockets;

    /// What runs it, for cards.
    fn backend(&self) -> String;
}

/// The files that a node reads which runs a network: the network, a parameter of this name, and the library
/// at `runtime`.
pub(crate) fn files(param: &str, network: &InputPath, runtime: Option<&InputPath>) -> Vec<FileRef> {
    let file = |(param, path): (&str, &InputPath)| FileRef { param: param.into(), path: path.path().into() };
    std::iter::once((param, network)).chain(runtime.map(|path| ("runtime", path))).map(file).collect()
}

/// Refuses a node without a name of its network at `weights`, of which this project has one at `ours`.
///
/// # Errors
/// When the parameter is missing.
pub(crate) fn need_weights(weights: &InputPath, ours: &str) -> Result<(), NodeError> {
    if weights.path().as_os_str().is_empty() {
        let hint = format!("name {ours} of this project, relative to the manifest");
        return Err(NodeError::usage("`weights` is missing: the file of the network")
            .hint(hint)
            .param("weights"));
    }
    Ok(())
}

/// Makes a network of the content of an ONNX file; `name` is the file's, for messages. With `library`, ONNX
/// Runtime runs it, else the embedded backend.
///
/// # Errors
/// When it is no network, uses operators that the backend does not have, or the library cannot be loaded.
pub(crate) fn load(
    name: &str,
    content: Vec<u8>,
    library: Option<&Path>,
) -> Result<Box<dyn Network>, NodeError> {
    match library {
        None => Ok(Box::new(embedded::Embedded::load(name, content)?)),
        Some(library) => Ok(Box::new(runtime::Runtime::load(name, content, library)?)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::PathBuf;

    /// What ONNX Runtime 1.32.0 for Python gives for these two pictures.
    const EXPECTED: f32 = 0.473_722_3;

    fn weights() -> Vec<u8> {
        std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("../data/weights/lpips_alex.onnx")).unwrap()
    }

    /// Two pictures of 48 x 40, of whole numbers modulo a prime.
    fn picture(step: usize) -> Tensor {
        Tensor {
            shape: vec![1, 3, 40, 48],
            values: (0..3 * 40 * 48).map(|i| (i * step % 997) as f32 / 997.0).collect(),
        }
    }

    fn distance(network: &dyn Network) -> f32 {
        let (a, b) = (picture(7919), picture(104_729));
        let distance = network.run(&[("img0", &a), ("img1", &b)], "lpips").unwrap();
        assert_eq!((distance.shape.as_slice(), distance.values.len()), (&[1][..], 1));
        distance.values[0]
    }

    #[test]
    fn a_network_names_its_inputs_and_outputs() {
        let sockets = load("alex", weights(), None).unwrap().sockets();
        assert_eq!(
            (sockets.inputs, sockets.outputs),
            (vec!["img0".to_string(), "img1".into()], vec!["lpips".to_string()])
        );
    }

    #[test]
    fn the_embedded_backend_agrees_with_onnx_runtime() {
        let network = load("alex", weights(), None).unwrap();
        assert!((distance(&*network) - EXPECTED).abs() < 1e-5, "{}", distance(&*network));
    }

    /// Where a library is there: `ORT_DYLIB_PATH=.../libonnxruntime.so cargo test -p photocurrent-nodes onnx
    /// -- --ignored`.
    #[test]
    #[ignore = "needs an ONNX Runtime library, named by ORT_DYLIB_PATH"]
    fn a_named_library_gives_the_same() {
        let library =
            std::env::var_os("ORT_DYLIB_PATH").map(PathBuf::from).expect("ORT_DYLIB_PATH names the library");
        let network = load("alex", weights(), Some(&library)).unwrap();
        assert!((distance(&*network) - EXPECTED).abs() < 1e-5, "{}", distance(&*network));
        assert!(network.backend().starts_with("ONNX Runtime"), "{}", network.backend());
        let error = network.run(&[("img0", &picture(1))], "lpips").unwrap_err();
        assert!(error.message.contains("alex"), "{}", error.message);
    }

    #[test]
    fn what_is_no_network_or_has_other_names_is_refused_with_the_files_name() {
        let refused = |result: Result<Box<dyn Network>, NodeError>| result.err().unwrap();
        let error = refused(load("notes.txt", b"no network".to_vec(), None));
        assert!(
            error.message.starts_with("notes.txt is no network that the embedded backend can run"),
            "{}",
            error.message
        );
        let network = load("alex", weights(), None).unwrap();
        let error = network.run(&[("picture", &picture(1))], "lpips").unwrap_err();
        assert_eq!(error.message, "the network alex has no input or output `picture`");
        let small = Tensor { shape: vec![1, 3, 4, 4], values: vec![0.0; 48] };
        assert!(
            network.run(&[("img0", &small), ("img1", &small)], "lpips").unwrap_err().message.contains("alex")
        );
    }

    #[test]
    fn a_library_that_is_not_there_is_a_message() {
        let error = load("alex", weights(), Some(Path::new("no/such/libonnxruntime.so"))).err().unwrap();
        assert!(error.message.contains("no/such/libonnxruntime.so"), "{}", error.message);
        assert!(error.hint.is_some());
    }
}
