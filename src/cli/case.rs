//! Can a recording with its description be diagnosed? Checked before the graph begins, so that messages name
//! the command's own options.

use crate::diagnose::given::Given;
use crate::failure::{Failure, usage};
use crate::file_kind::{FileKind, Reader};
use crate::numbers::human_bytes;
use photocurrent_core::document::Source;
use photocurrent_core::error::Trouble;
use photocurrent_core::{EventsMeta, FramesMeta, NodeError, Sensor};
use photocurrent_engine::machine_memory;
use photocurrent_nodes::read::arranged;
use photocurrent_nodes::read::foreign::All;
use photocurrent_nodes::spans::check_one_clock;
use photocurrent_scene::case::Case;
use photocurrent_store::StoreError;
use photocurrent_store::recording::Recording;
use std::path::Path;
use std::sync::Arc;

/// Why a recording cannot be diagnosed.
pub enum Unread {
    /// Its data contradict the format or themselves: that is a verdict.
    Content(String),
    /// Anything else.
    Other(Failure),
}

impl From<Failure> for Unread {
    fn from(failure: Failure) -> Unread {
        Unread::Other(failure)
    }
}

/// The description in a file, or the recording's own. Refuses a recording that cannot be diagnosed with it,
/// and, before its data, one that takes more than `memory` bytes (none = what the machine has). Of data only
/// the events of a recording in this project's form are read: what contradicts its form is a verdict.
pub fn look(given: &Given, memory: Option<u64>) -> Result<Sensor, Unread> {
    let path = given.path();
    // The HDF5 library's word for a missing file comes without what to do about it.
    if let Err(error) = std::fs::metadata(path) {
        let hint = "hint: name a recording: docs/recordings.md lists the formats";
        return Err(usage(format!("{}: cannot read the recording: {error}\n  {hint}", path.display())).into());
    }
    if let FileKind::Recording(Reader::Format(_)) = FileKind::of(path) {
        return of_others(given, memory);
    }
    let recording = Recording::open(path).map_err(Failure::from)?;
    let sensor = sensor(given, recording.sensor_text())?;
    of_recording(&recording, &sensor, memory)?;
    Ok(sensor)
}

/// In a file of another program.
fn of_others(given: &Given, memory: Option<u64>) -> Result<Sensor, Unread> {
    let sensor = sensor(given, None)?;
    // What the file does not record of its rows, a description may know.
    let all = All { row_time: given.all.row_time.or(sensor.frames.row_time), ..given.all.clone() };
    let arranged = arranged(&all).map_err(|error| usage(unread(&error)))?;
    let (events, frames) = (arranged.events.as_ref().ok(), arranged.frames.as_ref().ok());
    one_clock(given.path(), events.map(|events| &**events), frames.map(|frames| &**frames), &sensor)?;
    fits(given.path(), events, frames, memory)?;
    can_be(given.path(), events.map(|events| &**events), frames.map(|frames| &**frames), &sensor)?;
    Ok(sensor)
}

/// Refuses streams that the model does not fit, and a description that lacks what it needs.
fn can_be(
    path: &Path,
    events: Option<&EventsMeta>,
    frames: Option<&FramesMeta>,
    sensor: &Sensor,
) -> Result<(), Failure> {
    let nominal = Case::before_data(events, frames, sensor)
        .map_err(|error| error.message)
        .and_then(|case| case.nominal().map_err(|error| error.to_string()));
    nominal.map(drop).map_err(|why| usage(format!("{}: {why}", path.display())))
}

/// Why a file is not read; with what states what it does not.
fn unread(error: &NodeError) -> String {
    match error.param.as_deref().filter(|param| *param != "path") {
        Some(param) => {
            let option = param.replace('_', "-");
            format!(
                "{error}\n  state it: --{option} ..., or name the manifest that `photocurrent init` \
                     writes: photocurrent diagnose my.toml"
            )
        }
        None => error.to_string(),
    }
}

/// In a recording in this project's form.
fn of_recording(recording: &Recording, sensor: &Sensor, memory: Option<u64>) -> Result<(), Unread> {
    let row_time_ns = recording.row_time_ns().or(sensor.frames.row_time.map(|row_time| row_time.ns()));
    let events = recording.events_meta();
    let frames = recording.frames_meta(row_time_ns.unwrap_or(0)).map(Arc::new);
    one_clock(recording.path(), events.map(|events| &**events), frames.as_deref(), sensor)?;
    fits(recording.path(), events, frames.as_ref(), memory)?;
    match recording.read_events(recording.extent().rows()) {
        Ok(_) => {}
        Err(error @ (StoreError::Content { .. } | StoreError::Several { .. })) => {
            return Err(Unread::Content(error.to_string()));
        }
        Err(error) => return Err(Unread::Other(error.into())),
    }
    let frames = frames.filter(|_| recording.exposures().is_some_and(|exposures| !exposures.is_empty()));
    if frames.is_some() && row_time_ns.is_none() {
        let hint = "hint: set the attribute `row_time_ns` of /frames, or state `frames.row_time` in the \
                    sensor description; 0 is a global shutter";
        return Err(usage(format!(
            "{}: the row time of the frames is stated nowhere\n  {hint}",
            recording.path().display()
        ))
        .into());
    }
    Ok(can_be(recording.path(), events.map(|events| &**events), frames.as_deref(), sensor)?)
}

/// Refuses a recording that is too large to be held.
fn fits(
    path: &Path,
    events: Option<&Arc<EventsMeta>>,
    frames: Option<&Arc<FramesMeta>>,
    memory: Option<u64>,
) -> Result<(), Failure> {
    let (needed, allowed) = (
        Case::estimated_bytes(events, frames),
        [memory, machine_memory()].into_iter().flatten().min().unwrap_or(u64::MAX),
    );
    if needed <= allowed {
        return Ok(());
    }
    let hint = "hint: `photocurrent convert --start ... --end ...` writes a shorter part; --memory allows \
                more, where the machine has it";
    let (needed, allowed) = (human_bytes(needed), human_bytes(allowed));
    Err(usage(format!(
        "{}: a diagnosis holds the recording, which takes about {needed}, and there are {allowed}\n  {hint}",
        path.display()
    )))
}

/// Nothing can be said of a sensor whose two streams never saw the same moment, and looking would take for
/// ever.
fn one_clock(
    path: &Path,
    events: Option<&EventsMeta>,
    frames: Option<&FramesMeta>,
    sensor: &Sensor,
) -> Result<(), Unread> {
    let (Some(events), Some(frames)) = (events, frames) else { return Ok(()) };
    check_one_clock(events, frames, Some(sensor)).map_err(|error| match error.trouble {
        Trouble::Input => Unread::Content(format!("{}: {error}", path.display())),
        _ => usage(format!("{}: {error}", path.display())).into(),
    })
}

/// The description: a file's, with what a manifest lays over it, or the recording's own.
fn sensor(given: &Given, own: Option<&str>) -> Result<Sensor, Failure> {
    let parse = |source| Sensor::parse(&source).map_err(Failure::Problems);
    if let Some(file) = &given.sensor {
        let text = std::fs::read_to_string(file).map_err(|error| {
            usage(format!("{}: cannot read the sensor description: {error}", file.display()))
        })?;
        let sensor =
            parse(Source::new(file.display().to_string(), file.parent().unwrap_or(Path::new(".")), text))?;
        return sensor.changed(&given.change).map_err(|why| usage(format!("{}: {why}", file.display())));
    }
    let name = given.path().display();
    let Some(text) = own else {
        let hint = "hint: say which sensor it is: --sensor sensor.toml (docs/formats.md states the form; \
                    `photocurrent init` writes one)";
        return Err(usage(format!(
            "{name}: there is no sensor description in the recording (/sensor)\n  {hint}"
        )));
    };
    parse(Source::new(format!("{name}:/sensor"), given.path().parent().unwrap_or(Path::new(".")), text))
}
