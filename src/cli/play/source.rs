//! What is played, wherever it comes from.

use super::films::Film;
use super::options::PlayOptions;
use crate::failure::{Failure, usage};
use crate::numbers::in_ms;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{Sensor, TimeSpan};
use photocurrent_nodes::show::Packer;
use std::path::PathBuf;
use std::sync::Arc;

/// What is played.
pub struct Source {
    pub title: String,
    /// Where the page goes unless another place is named.
    pub folder: PathBuf,
    /// What it is, a name and a text each.
    pub facts: Vec<(String, String)>,
    /// What is missing, was assumed or left out, in whole sentences.
    pub notes: Vec<String>,
    pub span: TimeSpan,
    pub events: Option<Packer>,
    pub films: Vec<Film>,
    pub sensor: Option<Arc<Sensor>>,
    /// The label of the method that is shown first.
    pub best: Option<String>,
    pub is_damaged: bool,
}

/// The stretch of a recording that is played.
///
/// # Errors
/// When nothing of it is asked for.
pub fn stretch(options: &PlayOptions, whole: TimeSpan, what: &str) -> Result<TimeSpan, Failure> {
    let start = options.from.map_or(whole.start.0, |from| from.ns().max(whole.start.0));
    let end = options.to.map_or(whole.end.0, |to| to.ns().min(whole.end.0));
    if start < end {
        return Ok(TimeSpan::new(start, end));
    }
    let asked = |name: &str, time: Option<Duration>| time.map(|time| format!("--{name} {time}"));
    let asked: Vec<String> =
        [asked("from", options.from), asked("to", options.to)].into_iter().flatten().collect();
    Err(usage(format!(
        "{}: nothing of {what} lies there: it lasts from {} to {} ms\n  hint: choose a stretch within",
        asked.join(" "),
        in_ms(whole.start.0),
        in_ms(whole.end.0)
    )))
}
