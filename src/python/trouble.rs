//! Errors as Python exceptions, with the text that the command prints.

use pyo3::prelude::*;
use std::any::Any;

/// The exception for an exit code of the command, with the text that it printed: a class of
/// `photocurrent._errors`.
pub fn of(py: Python<'_>, code: u8, text: &str) -> PyErr {
    let made = py
        .import("photocurrent._errors")
        .and_then(|module| module.getattr("of"))
        .and_then(|of| of.call1((code, text)));
    match made {
        Ok(exception) => PyErr::from_value(exception),
        Err(error) => error,
    }
}

/// What input data could not be read for.
pub fn data(py: Python<'_>, why: impl ToString) -> PyErr {
    of(py, 3, &why.to_string())
}

/// A mistake of the caller.
pub fn usage(py: Python<'_>, why: impl ToString) -> PyErr {
    of(py, 2, &why.to_string())
}

/// A panic: a mistake of this program, whose message went to stderr as well.
pub fn panicked(py: Python<'_>, payload: &(dyn Any + Send)) -> PyErr {
    let message = payload
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| payload.downcast_ref::<&str>().copied())
        .unwrap_or("no reason given");
    of(py, u8::MAX, message)
}
