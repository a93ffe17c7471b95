//! Writing a recording: for simulated data, demonstrations, converters and tests.
//!
//! The file appears whole or not at all. Events are brought from the order of rows into that of time through
//! a temporary file where they are many ([`super::by_time`]).

use super::by_time::{Sizes, for_slices_of_time};
use super::checked::FORMAT;
use super::whole::{whole_file, write_colour, write_numbers, write_times};
use crate::error::StoreError;
use crate::hdf::Opened;
use crate::hdf::write::ColumnWriter;
use crate::layout::create_group;
use photocurrent_core::{EventStream, Extent, FrameSequence, Rows, Truth};
use std::path::Path;

/// How digital numbers are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum DnType {
    /// As they are.
    #[default]
    F32,
    /// Rounded to whole numbers, 0 to 65535; NaN becomes 0.
    U16,
}

/// What goes into a recording. Either stream may be left out.
#[derive(Clone)]
pub struct RecordingContent<'a> {
    /// Size of the sensor.
    pub extent: Extent,
    /// Events of the whole sensor.
    pub events: Option<&'a EventStream>,
    /// Captured frames of the whole sensor.
    pub frames: Option<&'a FrameSequence>,
    /// How frames are stored.
    pub dn: DnType,
    /// Sensor description, TOML text.
    pub sensor: Option<&'a str>,
    /// True frames; the middle of each exposure becomes the instant.
    pub truth: Option<&'a Truth>,
}

impl RecordingContent<'_> {
    /// Nothing yet, of a sensor of this size.
    pub fn empty(extent: Extent) -> Self {
        RecordingContent { extent, events: None, frames: None, dn: DnType::F32, sensor: None, truth: None }
    }
}

/// Writes a recording, replacing what is there only when all is written and synced.
///
/// Gives the number of events, 0 without an event stream.
///
/// # Errors
/// When data cannot be read, do not cover the sensor, or the file cannot be written.
pub fn write_recording(path: &Path, content: &RecordingContent) -> Result<u64, StoreError> {
    whole_file(path, |opened| {
        opened.set_text_attribute(&opened.file, "format", FORMAT)?;
        opened.set_integer_attribute(&opened.file, "width", content.extent.width.into())?;
        opened.set_integer_attribute(&opened.file, "height", content.extent.height.into())?;
        let mut written = 0;
        if let Some(events) = content.events {
            covers(path, "events", (events.meta.extent, events.rows()), content.extent, Some(1))?;
            written = write_events(opened, events)?;
        }
        if let Some(frames) = content.frames {
            covers(path, "frames", (frames.meta.extent, frames.rows()), content.extent, None)?;
            write_frames(opened, frames, content)?;
        }
        if let Some(Truth(truth)) = content.truth {
            covers(path, "true frames", (truth.meta.extent, truth.rows()), content.extent, None)?;
            write_truth(opened, truth)?;
        }
        if let Some(sensor) = content.sensor {
            opened.set_text("sensor", sensor)?;
        }
        Ok(written)
    })
}

/// Data must have all rows, and `times` the extent of the sensor; any whole number of times without it.
fn covers(
    path: &Path,
    what: &str,
    (extent, rows): (Extent, Rows),
    sensor: Extent,
    times: Option<u32>,
) -> Result<(), StoreError> {
    let multiple = extent.multiple_of(sensor);
    if multiple.is_none() || times.is_some_and(|times| multiple != Some(times)) || rows != extent.rows() {
        return Err(StoreError::Misuse {
            path: path.into(),
            what: format!("the {what} cover {rows} of {extent} pixels, and the sensor has {sensor}"),
        });
    }
    Ok(())
}

/// Writes the events, and gives their number.
fn write_events(opened: &Opened, events: &EventStream) -> Result<u64, StoreError> {
    let group = create_group(opened, "events")?;
    if let Some(step) = events.meta.t_resolution_ns {
        opened.set_integer_attribute(&group, "t_resolution_ns", step)?;
    }
    let (mut x, mut y, mut on) = (
        ColumnWriter::new(opened, "events/x"),
        ColumnWriter::new(opened, "events/y"),
        ColumnWriter::new(opened, "events/p"),
    );
    let mut t = ColumnWriter::new(opened, "events/t");
    let mut t_in = events.meta.has_t_in.then(|| ColumnWriter::new(opened, "events/t_in"));
    let mut count = 0;
    for_slices_of_time(events, Sizes::default(), |slice| {
        count += slice.t.len() as u64;
        x.append(&slice.x)?;
        y.append(&slice.y)?;
        on.append(&slice.on)?;
        t.append(&slice.t)?;
        t_in.as_mut().map_or(Ok(()), |column| column.append(&slice.t_in))
    })?;
    x.finish()?;
    y.finish()?;
    on.finish()?;
    opened.set_text_attribute(t.finish()?.dataset(), "unit", "ns")?;
    if let Some(column) = t_in {
        opened.set_text_attribute(column.finish()?.dataset(), "unit", "ns")?;
    }
    Ok(count)
}

fn write_frames(
    opened: &Opened,
    frames: &FrameSequence,
    content: &RecordingContent,
) -> Result<(), StoreError> {
    let group = create_group(opened, "frames")?;
    opened.set_integer_attribute(&group, "row_time_ns", frames.meta.times.row_time_ns)?;
    write_colour(opened, &group, frames.meta.colour)?;
    match content.dn {
        DnType::F32 => write_numbers::<f32>(opened, "frames/dn", frames, None, |dn| dn)?,
        // `as` saturates, and makes 0 of NaN.
        DnType::U16 => write_numbers::<u16>(opened, "frames/dn", frames, None, |dn| dn.round() as u16)?,
    }
    let exposures = &frames.meta.times.exposures;
    write_times(
        opened,
        "frames/exposure_start",
        exposures.iter().map(|exposure| exposure.start.0).collect(),
    )?;
    write_times(opened, "frames/exposure_end", exposures.iter().map(|exposure| exposure.end.0).collect())
}

fn write_truth(opened: &Opened, truth: &FrameSequence) -> Result<(), StoreError> {
    let group = create_group(opened, "truth")?;
    write_colour(opened, &group, truth.meta.colour)?;
    write_numbers::<f32>(opened, "truth/dn", truth, None, |dn| dn)?;
    write_times(
        opened,
        "truth/t",
        truth
            .meta
            .times
            .exposures
            .iter()
            .map(|exposure| exposure.start.0 + exposure.length_ns() / 2)
            .collect(),
    )
}
