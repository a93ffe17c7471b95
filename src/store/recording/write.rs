//! Writing a recording: for simulated data, demonstrations, converters and tests.
//!
//! The file appears whole or not at all. Events are held in memory while they are brought from row order into time order:
//! about 30 bytes each, so this is not for the largest recordings.

use super::FORMAT;
use crate::error::StoreError;
use crate::hdf::write::ColumnWriter;
use crate::hdf::{Item, Opened};
use crate::layout::{StripWriter, close, create_group};
use photocurrent_core::{EventStream, Extent, FrameSequence, Truth};
use std::os::unix::fs::PermissionsExt;
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
    /// `rgb`, `bayer_rggb` ...; left out, it is `mono`.
    pub colour: Option<&'a str>,
    /// Sensor description, TOML text.
    pub sensor: Option<&'a str>,
    /// True frames; the middle of each exposure becomes the instant.
    pub truth: Option<&'a Truth>,
}

impl RecordingContent<'_> {
    /// Nothing yet, of a sensor of this size.
    pub fn empty(extent: Extent) -> Self {
        RecordingContent { extent, events: None, frames: None, dn: DnType::F32, colour: None, sensor: None, truth: None }
    }
}

/// Writes a recording, replacing what is there only when all is written and synced.
///
/// # Errors
/// When data cannot be read, do not cover the sensor, or the file cannot be written.
pub fn write_recording(path: &Path, content: &RecordingContent) -> Result<(), StoreError> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // The umask still applies: temporary files are private by default, and a recording is not.
    let everybody = std::fs::Permissions::from_mode(0o666);
    let temporary = tempfile::Builder::new().prefix(".").suffix(".part").permissions(everybody).tempfile_in(folder);
    let temporary = temporary.map_err(|error| StoreError::io(folder, "create a file in the folder", error))?;
    let opened = Opened::create(temporary.path())?;
    opened.set_text_attribute(&opened.file, "format", FORMAT)?;
    opened.set_integer_attribute(&opened.file, "width", content.extent.width.into())?;
    opened.set_integer_attribute(&opened.file, "height", content.extent.height.into())?;
    if let Some(events) = content.events {
        covers(path, "events", events.meta.extent, events.rows(), content.extent)?;
        write_events(&opened, events)?;
    }
    if let Some(frames) = content.frames {
        covers(path, "frames", frames.meta.extent, frames.rows(), content.extent)?;
        write_frames(&opened, frames, content)?;
    }
    if let Some(Truth(truth)) = content.truth {
        covers(path, "true frames", truth.meta.extent, truth.rows(), content.extent)?;
        write_truth(&opened, truth)?;
    }
    if let Some(sensor) = content.sensor {
        opened.set_text("sensor", sensor)?;
    }
    close(opened)?;
    temporary.as_file().sync_all().map_err(|error| StoreError::io(path, "sync the file", error))?;
    temporary.persist(path).map_err(|error| StoreError::io(path, "move the file to its place", error.error))?;
    std::fs::File::open(folder).and_then(|folder| folder.sync_all()).map_err(|error| StoreError::io(folder, "sync the folder", error))
}

fn covers(path: &Path, what: &str, extent: Extent, rows: photocurrent_core::Rows, sensor: Extent) -> Result<(), StoreError> {
    if extent != sensor || rows != sensor.rows() {
        return Err(StoreError::Misuse { path: path.into(), what: format!("the {what} cover {rows} of {extent} pixels, and the sensor has {sensor}") });
    }
    Ok(())
}

fn write_events(opened: &Opened, events: &EventStream) -> Result<(), StoreError> {
    let group = create_group(opened, "events")?;
    if let Some(step) = events.meta.t_resolution_ns {
        opened.set_integer_attribute(&group, "t_resolution_ns", step)?;
    }
    let band = events.read(events.rows()).map_err(StoreError::Source)?;
    // Stable: equal stamps stay in row order, and inside a row in their own order.
    let mut order: Vec<usize> = (0..band.len()).collect();
    order.sort_by_key(|&i| band.t[i]);
    let mut y = vec![0u16; band.len()];
    for row in events.rows().iter() {
        let here = band.row(row);
        y[here.first..here.first + here.len()].fill(row as u16);
    }
    write_column(opened, "events/x", &band.x, &order, None)?;
    write_column(opened, "events/y", &y, &order, None)?;
    write_column(opened, "events/p", &band.on, &order, None)?;
    write_column(opened, "events/t", &band.t, &order, Some("ns"))?;
    if let Some(t_in) = &band.t_in {
        write_column(opened, "events/t_in", t_in, &order, Some("ns"))?;
    }
    Ok(())
}

/// Writes a column in some order, block by block.
fn write_column<T: Item>(opened: &Opened, name: &str, values: &[T], order: &[usize], unit: Option<&str>) -> Result<(), StoreError> {
    let mut column = ColumnWriter::new(opened, name);
    for block in order.chunks(1 << 20) {
        let ordered: Vec<T> = block.iter().map(|&i| values[i]).collect();
        column.append(&ordered)?;
    }
    let written = column.finish()?;
    unit.map_or(Ok(()), |unit| opened.set_text_attribute(written.dataset(), "unit", unit))
}

fn write_times(opened: &Opened, name: &str, times: Vec<i64>) -> Result<(), StoreError> {
    let order: Vec<usize> = (0..times.len()).collect();
    write_column(opened, name, &times, &order, Some("ns"))
}

fn write_frames(opened: &Opened, frames: &FrameSequence, content: &RecordingContent) -> Result<(), StoreError> {
    let group = create_group(opened, "frames")?;
    opened.set_integer_attribute(&group, "row_time_ns", frames.meta.times.row_time_ns)?;
    if let Some(colour) = content.colour {
        opened.set_text_attribute(&group, "colour", colour)?;
    }
    match content.dn {
        DnType::F32 => write_numbers::<f32>(opened, "frames/dn", frames, |dn| dn)?,
        // `as` saturates, and makes 0 of NaN.
        DnType::U16 => write_numbers::<u16>(opened, "frames/dn", frames, |dn| dn.round() as u16)?,
    }
    let exposures = &frames.meta.times.exposures;
    write_times(opened, "frames/exposure_start", exposures.iter().map(|exposure| exposure.start.0).collect())?;
    write_times(opened, "frames/exposure_end", exposures.iter().map(|exposure| exposure.end.0).collect())
}

fn write_truth(opened: &Opened, truth: &FrameSequence) -> Result<(), StoreError> {
    create_group(opened, "truth")?;
    write_numbers::<f32>(opened, "truth/dn", truth, |dn| dn)?;
    write_times(opened, "truth/t", truth.meta.times.exposures.iter().map(|exposure| exposure.start.0 + exposure.length_ns() / 2).collect())
}

fn write_numbers<T: Item>(opened: &Opened, name: &str, frames: &FrameSequence, convert: impl Fn(f32) -> T + Sync) -> Result<(), StoreError> {
    let (width, channels) = (frames.meta.extent.width as usize, frames.meta.channels as usize);
    let tail = [width, channels];
    // Grey frames have three dimensions.
    let tail = if channels == 1 { &tail[..1] } else { &tail[..] };
    let mut writer = StripWriter::create::<T>(opened, name, frames.len(), frames.meta.extent.height as usize, tail)?;
    for rows in frames.rows().bands(writer.rows_at_once()) {
        let block = frames.read_rows(rows).map_err(StoreError::Source)?;
        writer.append(&block, &convert)?;
    }
    Ok(())
}
