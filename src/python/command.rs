//! Every command of the program.

use crate::waiting::{Progress, wait};
use photocurrent_cli::embed::{Heard, Host};
use pyo3::prelude::*;
use std::ffi::OsString;
use std::sync::Arc;

/// The program itself, on this process' streams: what the script `photocurrent` calls. Arguments begin with
/// the name of the program.
#[pyfunction]
pub fn main(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    // Ctrl-C is the program's: it stops a run, or ends the process.
    py.detach(|| photocurrent_cli::run(arguments))
}

/// Runs a command, without the name of the program, and gives its exit code, stdout and stderr. `progress`
/// is called as [`wait`] states.
#[pyfunction]
#[pyo3(signature = (arguments, progress=None))]
pub fn command(
    py: Python<'_>,
    arguments: Vec<OsString>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<(u8, String, String)> {
    let heard = hosted(py, arguments, progress)?;
    Ok((heard.code, heard.out, heard.err))
}

/// A command in a thread of its own.
pub fn hosted(
    py: Python<'_>,
    arguments: Vec<OsString>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<Heard> {
    let (cancel, observer) = (Arc::default(), Arc::new(Progress::default()));
    let host = Host { cancel: Arc::clone(&cancel), observer: Some(observer.clone()) };
    let whole = std::iter::once("photocurrent".into()).chain(arguments);
    let whole: Vec<OsString> = whole.collect();
    let heard = progress.as_ref().map(|callback| (&*observer, callback));
    wait(py, &cancel, heard, move || photocurrent_cli::embed::command(whole, host))
}
