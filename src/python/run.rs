//! `run`: what the command does, with the results to read.

use crate::command::hosted;
use crate::trouble;
use crate::values::Value;
use photocurrent_cli::embed::Ran;
use photocurrent_engine::TaskOutcome;
use pyo3::prelude::*;
use serde_json::json;
use std::ffi::OsString;

/// Results of a run.
#[pyclass(frozen, module = "photocurrent._native")]
pub struct Run {
    ran: Ran,
    /// The exit code of the command.
    #[pyo3(get)]
    code: u8,
    /// What the command wrote to stdout: tables.
    #[pyo3(get)]
    out: String,
    /// What it wrote to stderr: notes, warnings, mistakes.
    #[pyo3(get)]
    err: String,
}

/// Runs `photocurrent run` with these arguments. Raises what the command refused before anything ran; what
/// failed later is in the results and their `code`.
#[pyfunction]
#[pyo3(signature = (arguments, progress=None))]
pub fn run(py: Python<'_>, arguments: Vec<OsString>, progress: Option<Bound<'_, PyAny>>) -> PyResult<Run> {
    let whole = std::iter::once("run".into()).chain(arguments).collect();
    let heard = hosted(py, whole, progress)?;
    match heard.ran {
        Some(ran) => Ok(Run { ran, code: heard.code, out: heard.out, err: heard.err }),
        None => Err(trouble::of(py, heard.code, heard.err.trim_end())),
    }
}

#[pymethods]
impl Run {
    /// Names of the variants, one (`base`) without an ablation.
    #[getter]
    fn variants(&self) -> Vec<String> {
        self.ran.outcome.variants.iter().map(|variant| variant.name.clone()).collect()
    }

    /// Seconds from start to end.
    #[getter]
    fn seconds(&self) -> f64 {
        self.ran.seconds
    }

    /// The folder with files for the user.
    #[getter]
    fn out_dir(&self) -> std::path::PathBuf {
        self.ran.out_dir.clone()
    }

    /// Warnings, in the order in which they came up.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.ran.outcome.warnings.clone()
    }

    /// What came of every node, as JSON: a list of objects.
    fn tasks(&self) -> String {
        let of = |task: &TaskOutcome| {
            json!({
                "node": task.label, "kind": task.kind, "uses": task.uses, "end": task.end.name(),
                "seconds": task.seconds, "key": task.key, "outputs": task.outputs, "notes": task.notes,
                "error": task.error.as_ref().map(ToString::to_string), "because": task.because,
                "files": task.export,
            })
        };
        serde_json::Value::from_iter(self.ran.outcome.tasks.iter().map(of)).to_string()
    }

    /// A stored output; `None` when the node has none of that name, or did not get so far.
    fn value(&self, py: Python<'_>, variant: &str, node: &str, port: &str) -> PyResult<Option<Value>> {
        let Ran { outcome, cache, .. } = &self.ran;
        let stored = outcome.node(variant, node).and_then(|task| task.outputs.get(port));
        let Some(stored) = stored else { return Ok(None) };
        let loaded = py.detach(|| cache.load(&stored.digest));
        let value = loaded.map_err(|error| trouble::of(py, 1, &error.to_string()))?;
        Ok(Some(Value::new(value, stored.digest.to_string())))
    }

    /// Scores of single frames and pooled ones, as JSON: two lists of objects.
    fn metrics(&self, py: Python<'_>) -> PyResult<String> {
        let metrics = py.detach(|| self.ran.outcome.metrics(&self.ran.cache));
        let (single, pooled) = metrics.map_err(|error| trouble::of(py, 1, &error.to_string()))?;
        Ok(json!([single, pooled]).to_string())
    }
}
