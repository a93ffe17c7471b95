//! Sensor descriptions between TOML and what Python holds: JSON in the form of the TOML file.

use crate::trouble;
use photocurrent_cli::embed::mistakes;
use photocurrent_core::Sensor;
use photocurrent_core::document::Source;
use pyo3::prelude::*;

/// A description; raises every mistake at its place.
fn parsed(py: Python<'_>, name: &str, text: &str) -> PyResult<Sensor> {
    Sensor::parse(&Source::new(name, "", text))
        .map_err(|problems| trouble::usage(py, mistakes(&problems).trim_end()))
}

/// A TOML text as JSON, checked. `name` is shown with mistakes.
#[pyfunction]
pub fn sensor_to_json(py: Python<'_>, text: &str, name: &str) -> PyResult<String> {
    let whole = parsed(py, name, text)?.to_toml();
    let fields: serde_json::Value =
        toml::from_str(&whole).map_err(|error| trouble::data(py, format!("error: {error}")))?;
    Ok(fields.to_string())
}

/// JSON as TOML text, checked.
#[pyfunction]
pub fn sensor_to_toml(py: Python<'_>, fields: &str) -> PyResult<String> {
    let refuse = |why: String| trouble::usage(py, format!("error: {why}"));
    let fields: serde_json::Value =
        serde_json::from_str(fields).map_err(|error| refuse(error.to_string()))?;
    let text = toml::to_string(&fields).map_err(|error| refuse(error.to_string()))?;
    Ok(parsed(py, "sensor", &text)?.to_toml())
}
