//! This project's own recordings, `photocurrent-recording/1`: events in file order with their in-pixel times,
//! linear frames, the sensor's description.

use super::stack::{Order, Stack};
use super::table::EventTable;
use super::{HdfRecording, extent, holds, open_file, optional, refused, with_cut};
use crate::error::FormatError;
use crate::format::{Format, Probe};
use crate::recording::{FrameStamp, FramesAbout, Pictures, Recording};
use crate::{Declared, StampRole, TimeUnit, Transfer};
use photocurrent_core::frames::FrameSource;
use photocurrent_core::{Colour, FramesMeta};
use photocurrent_store::foreign::{ForeignFile, Value};
use std::path::Path;
use std::sync::Arc;

/// Our own recordings.
pub(crate) static FORMAT: Format = Format {
    id: "recording",
    name: "photocurrent recording",
    recognises,
    open: |path, declared| with_cut(open(path, declared)),
};

fn recognises(probe: &Probe) -> bool {
    let says_so =
        |value: Option<Value>| value.is_some_and(|value| value.text() == Some("photocurrent-recording/1"));
    (holds(probe, &["events/t"]) || holds(probe, &["frames/dn"]) || probe.is_hdf5())
        && ForeignFile::open(&probe.path).is_ok_and(|file| file.attribute("", "format").is_ok_and(says_so))
}

fn open(path: &Path, _: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    let wrap = |error| refused(path, error);
    let file = open_file(path)?;
    if file.cut().is_some() {
        return open_cut(path, &file);
    }
    let stored = photocurrent_store::Recording::open(path).map_err(wrap)?;
    let mut table = None;
    if let Some(meta) = stored.events_meta() {
        let t_in = meta.has_t_in.then_some("events/t_in");
        let mut events =
            EventTable::of_columns(&file, ["events/x", "events/y", "events/t", "events/p"], t_in)?;
        events.unit_ns = TimeUnit::Ns.ns();
        events.extent = Some(stored.extent());
        table = Some(events);
    }
    let mut recording = HdfRecording::new(path, &file, table, Vec::new(), Vec::new());
    if let (Some(about), Some(step)) =
        (&mut recording.about, stored.events_meta().and_then(|meta| meta.t_resolution_ns))
    {
        about.tick_ns = step.max(1);
    }
    if let (Some(meta), Some(source)) =
        (stored.frames_meta(stored.row_time_ns().unwrap_or(0)), stored.frames_source())
    {
        let bits = file
            .dataset("frames/dn")
            .map_err(wrap)?
            .and_then(|dn| dn.numbers())
            .map_or(32, super::stack::bits);
        let about = FramesAbout { row_time_ns: stored.row_time_ns(), bits, ..about(&meta) };
        recording.pictures = Some(Arc::new(Frames { path: path.into(), about, source }) as Arc<dyn Pictures>);
    }
    recording.sensor = stored.sensor_text().map(str::to_string);
    if let Some(times) = stored.truth_times() {
        recording.facts.push(("true frames".into(), format!("{} (simulated data)", times.len())));
    }
    Ok(Box::new(recording))
}

/// What is left of a recording that ends before its stated end: the strict reader of recordings refuses it.
fn open_cut(path: &Path, file: &ForeignFile) -> Result<Box<dyn Recording>, FormatError> {
    let wrap = |error| refused(path, error);
    let integer = |of: &str, name: &str| {
        file.attribute(of, name)
            .ok()
            .flatten()
            .and_then(|value| value.numbers().first().map(|&number| number as i64))
    };
    let (mut table, mut lost) = (None, Vec::new());
    if file.has("events/t") {
        let t_in = file.has("events/t_in").then_some("events/t_in");
        let mut events =
            EventTable::of_columns(file, ["events/x", "events/y", "events/t", "events/p"], t_in)?;
        events.unit_ns = TimeUnit::Ns.ns();
        events.extent = integer("", "width")
            .zip(integer("", "height"))
            .and_then(|(width, height)| extent(width as f64, height as f64));
        table = Some(events);
    }
    let mut column = |name: &str| {
        optional(file, name, &mut lost)?
            .map(|column| column.integers())
            .transpose()
            .map_err(wrap)
            .map(Option::unwrap_or_default)
    };
    let (starts, ends) = (column("frames/exposure_start")?, column("frames/exposure_end")?);
    let stamps = starts
        .iter()
        .zip(&ends)
        .map(|(&start, &end)| FrameStamp { at: start, exposure: Some((start, end)) })
        .collect();
    let mut pictures = None;
    if let Some(dn) = optional(file, "frames/dn", &mut lost)? {
        let mut stack = Stack::of_dataset(path, dn, stamps, Order::Rgb, None)?;
        lost.extend(stack.lost.take());
        let about = stack.about_mut();
        (about.stamp_role, about.transfer) = (Some(StampRole::Start), Some(Transfer::Linear));
        about.row_time_ns = integer("frames", "row_time_ns");
        if let Ok(Some(colour)) = file.attribute("frames", "colour")
            && let Some(colour) = colour.text().and_then(Colour::named)
            && colour.channels() == about.colour.channels()
        {
            about.colour = colour;
        }
        pictures = Some(Arc::new(stack) as Arc<dyn Pictures>);
    }
    let mut recording = HdfRecording::new(path, file, table, Vec::new(), lost);
    if let (Some(about), Some(step)) = (&mut recording.about, integer("events", "t_resolution_ns")) {
        about.tick_ns = step.max(1);
    }
    recording.pictures = pictures;
    recording.sensor = file.text("sensor").ok().flatten();
    Ok(Box::new(recording))
}

fn about(meta: &FramesMeta) -> FramesAbout {
    let stamp = |exposure: &photocurrent_core::Exposure| FrameStamp {
        at: exposure.start.0,
        exposure: Some((exposure.start.0, exposure.end.0)),
    };
    FramesAbout {
        extent: meta.extent,
        colour: meta.colour,
        bits: 32,
        stamps: meta.times.exposures.iter().map(stamp).collect(),
        stamp_role: Some(StampRole::Start),
        row_time_ns: None,
        transfer: Some(Transfer::Linear),
        notes: Vec::new(),
    }
}

struct Frames {
    path: std::path::PathBuf,
    about: FramesAbout,
    source: Arc<dyn FrameSource>,
}

impl Pictures for Frames {
    fn about(&self) -> &FramesAbout {
        &self.about
    }

    fn read(&self, frame: usize, values: &mut Vec<f32>) -> Result<(), FormatError> {
        let wrong = |found: String| {
            FormatError::new(&self.path, found, "the file changed or is damaged: copy or record it again")
        };
        if frame >= self.about.stamps.len() {
            return Err(wrong(format!("there is no frame {frame}")));
        }
        let block = self
            .source
            .read(frame..frame + 1, self.about.extent.rows())
            .map_err(|error| wrong(error.message))?;
        *values = block.dn;
        Ok(())
    }
}
