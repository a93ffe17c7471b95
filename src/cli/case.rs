//! A recording and its description as a diagnosis takes them.

use crate::common::{Failure, human_bytes};
use crate::diagnose::Given;
use crate::file_kind::{FileKind, Reader};
use photocurrent_core::document::Source;
use photocurrent_core::error::Trouble;
use photocurrent_core::{EventsMeta, FramesMeta, NodeError, Sensor};
use photocurrent_diagnosis::case::Case;
use photocurrent_engine::machine_memory;
use photocurrent_nodes::read::foreign::All;
use photocurrent_nodes::read::whole;
use photocurrent_nodes::spans::check_one_clock;
use photocurrent_store::StoreError;
use photocurrent_store::recording::Recording;
use std::path::Path;
use std::sync::Arc;

/// Why a recording is no case.
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

/// Reads a recording with the description in a file, or its own; refuses, before its data, one that takes more than `memory` bytes (none = what the machine has).
pub fn read(given: &Given, memory: Option<u64>) -> Result<Case, Unread> {
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
    of_recording(&recording, &sensor, memory)
}

/// From a file of another program.
fn of_others(given: &Given, memory: Option<u64>) -> Result<Case, Unread> {
    let path = given.path();
    let sensor = sensor(given, None)?;
    // What the file does not record of its rows, a description may know.
    let all = All { row_time: given.all.row_time.or(sensor.frames.row_time), ..given.all.clone() };
    let streams = whole(&all).map_err(|error| usage(unread(&error)))?;
    one_clock(path, streams.events.as_ref().map(|events| &*events.meta), streams.frames.as_ref().map(|frames| &*frames.meta), &sensor)?;
    fits(path, streams.events.as_ref().map(|events| &events.meta), streams.frames.as_ref().map(|frames| &frames.meta), memory)?;
    Case::read(streams.events.as_ref(), streams.frames.as_ref(), &sensor).map_err(|error| usage(format!("{}: {}", path.display(), error.message)).into())
}

/// Why a file is not read; with what states what it does not.
fn unread(error: &NodeError) -> String {
    match error.param.as_deref().filter(|param| *param != "path") {
        Some(param) => {
            let option = param.replace('_', "-");
            format!("{error}\n  state it: --{option} ..., or name the manifest that `photocurrent init` writes: photocurrent diagnose my.toml")
        }
        None => error.to_string(),
    }
}

/// From a recording in this project's form.
fn of_recording(recording: &Recording, sensor: &Sensor, memory: Option<u64>) -> Result<Case, Unread> {
    let name = recording.path().display();
    let row_time_ns = recording.row_time_ns().or(sensor.frames.row_time.map(|row_time| row_time.ns()));
    let frames_meta = recording.frames_meta(row_time_ns.unwrap_or(0));
    one_clock(recording.path(), recording.events_meta().map(|events| &**events), frames_meta.as_ref(), sensor)?;
    fits(recording.path(), recording.events_meta(), frames_meta.map(Arc::new).as_ref(), memory)?;
    // Read once before, for the reader's own word on what is wrong.
    match recording.read_events(recording.extent().rows()) {
        Ok(_) => {}
        Err(error @ (StoreError::Content { .. } | StoreError::Several { .. })) => return Err(Unread::Content(error.to_string())),
        Err(error) => return Err(Unread::Other(error.into())),
    }
    let frames = match (recording.exposures().is_some_and(|exposures| !exposures.is_empty()), row_time_ns) {
        (false, _) => None,
        (true, Some(row_time_ns)) => recording.frames(row_time_ns),
        (true, None) => {
            let hint = "hint: set the attribute `row_time_ns` of /frames, or state `frames.row_time` in the sensor description; 0 is a global shutter";
            return Err(usage(format!("{name}: the row time of the frames is stated nowhere\n  {hint}")).into());
        }
    };
    Case::read(recording.events().as_ref(), frames.as_ref(), sensor).map_err(|error| usage(format!("{name}: {}", error.message)).into())
}

/// Refuses a recording that is too large to be held.
fn fits(path: &Path, events: Option<&Arc<EventsMeta>>, frames: Option<&Arc<FramesMeta>>, memory: Option<u64>) -> Result<(), Failure> {
    let (needed, allowed) = (Case::estimated_bytes(events, frames), [memory, machine_memory()].into_iter().flatten().min().unwrap_or(u64::MAX));
    if needed <= allowed {
        return Ok(());
    }
    let hint = "hint: `photocurrent convert --start ... --end ...` writes a shorter part; --memory allows more, where the machine has it";
    let (needed, allowed) = (human_bytes(needed), human_bytes(allowed));
    Err(usage(format!("{}: a diagnosis holds the recording, which takes about {needed}, and there are {allowed}\n  {hint}", path.display())))
}

/// Nothing can be said of a sensor whose two streams never saw the same moment, and looking would take for ever.
fn one_clock(path: &Path, events: Option<&EventsMeta>, frames: Option<&FramesMeta>, sensor: &Sensor) -> Result<(), Unread> {
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
        let text = std::fs::read_to_string(file).map_err(|error| usage(format!("{}: cannot read the sensor description: {error}", file.display())))?;
        let sensor = parse(Source::new(file.display().to_string(), file.parent().unwrap_or(Path::new(".")), text))?;
        return sensor.changed(&given.change).map_err(|why| usage(format!("{}: {why}", file.display())));
    }
    let name = given.path().display();
    let Some(text) = own else {
        let hint = "hint: say which sensor it is: --sensor sensor.toml (docs/formats.md states the form; `photocurrent init` writes one)";
        return Err(usage(format!("{name}: there is no sensor description in the recording (/sensor)\n  {hint}")));
    };
    parse(Source::new(format!("{name}:/sensor"), given.path().parent().unwrap_or(Path::new(".")), text))
}

/// A failure of what was asked for.
pub fn usage(message: String) -> Failure {
    Failure::Other { message, code: 2 }
}
