//! Writing events and frames as they come, whatever their number: our own recording, and the HDF5 layout of
//! DSEC.
//!
//! Only shuffle and deflate are used, so that h5py opens the files with nothing installed. A file appears
//! whole or not at all. Both layouts want events in the order of time; what they cannot say is refused, with
//! the event and what to do.

use crate::error::StoreError;
use crate::hdf::write::{ColumnWriter, GridWriter};
use crate::hdf::{Opened, locked};
use crate::layout::create_group;
use crate::recording::whole::{whole_file, write_colour, write_times};
use crate::recording::{DnType, FORMAT};
use photocurrent_core::{Colour, Extent};
use std::path::Path;

/// A piece of an event stream: columns of one length, in the order of time.
#[derive(Clone, Copy)]
pub struct EventPiece<'a> {
    /// Off-pixel time, ns.
    pub t: &'a [i64],
    /// Column.
    pub x: &'a [u16],
    /// Row.
    pub y: &'a [u16],
    /// 1 = ON, 0 = OFF.
    pub on: &'a [u8],
    /// In-pixel time, ns.
    pub t_in: Option<&'a [i64]>,
}

/// Where pieces of events go.
pub struct EventSink {
    path: std::path::PathBuf,
    extent: Extent,
    x: ColumnWriter<u16>,
    y: ColumnWriter<u16>,
    p: ColumnWriter<u8>,
    times: Times,
    last: Option<i64>,
    count: u64,
}

/// How a layout keeps stamps.
enum Times {
    Recording {
        t: ColumnWriter<i64>,
        t_in: Option<ColumnWriter<i64>>,
    },
    Dsec {
        t: ColumnWriter<u32>,
        index: ColumnWriter<u64>,
        offset_us: Option<i64>,
        next_ms: i64,
        rounded: u64,
    },
}

impl EventSink {
    fn new(opened: &Opened, path: &Path, extent: Extent, times: Times) -> EventSink {
        let (x, y, p) = (
            ColumnWriter::new(opened, "events/x"),
            ColumnWriter::new(opened, "events/y"),
            ColumnWriter::new(opened, "events/p"),
        );
        EventSink { path: path.into(), extent, x, y, p, times, last: None, count: 0 }
    }

    /// Adds events.
    ///
    /// # Errors
    /// When columns differ in length, an event lies outside the sensor or before the one ahead of it, its
    /// time cannot be said, or the disk is full.
    pub fn append(&mut self, piece: EventPiece) -> Result<(), StoreError> {
        let refuse = |what: String| Err(StoreError::Misuse { path: self.path.clone(), what });
        let n = piece.t.len();
        if [piece.x.len(), piece.y.len(), piece.on.len(), piece.t_in.map_or(n, <[i64]>::len)]
            .iter()
            .any(|&other| other != n)
        {
            return refuse("columns of events differ in length".into());
        }
        for i in 0..n {
            let (t, x, y, at) = (piece.t[i], piece.x[i], piece.y[i], self.count + i as u64);
            if u32::from(x) >= self.extent.width || u32::from(y) >= self.extent.height {
                return refuse(format!(
                    "event {at} (x = {x}, y = {y}) lies outside the {} pixels; state the \
                                       right extent, or crop",
                    self.extent
                ));
            }
            if let Some(last) = self.last.filter(|&last| last > t) {
                return refuse(format!(
                    "event {at} is stamped {t} ns, before {last} ns of the one ahead; this layout wants \
                     events in the order of time: sort them"
                ));
            }
            self.last = Some(t);
        }
        self.x.append(piece.x)?;
        self.y.append(piece.y)?;
        self.p.append(piece.on)?;
        match &mut self.times {
            Times::Recording { t, t_in } => {
                t.append(piece.t)?;
                match (t_in, piece.t_in) {
                    (Some(column), Some(t_in)) => column.append(t_in)?,
                    (None, None) => {}
                    _ if n == 0 => {}
                    _ => return refuse("in-pixel times must be there for all events or for none".into()),
                }
            }
            Times::Dsec { t, index, offset_us, next_ms, rounded } => {
                let mut stored = Vec::with_capacity(n);
                for (i, &ns) in piece.t.iter().enumerate() {
                    *rounded += u64::from(ns % 1000 != 0);
                    // To the nearest microsecond: order is kept.
                    let us = ns.saturating_add(500).div_euclid(1000);
                    let us = us - *offset_us.get_or_insert(us);
                    let Ok(narrow) = u32::try_from(us) else {
                        return refuse(format!(
                            "event {} comes {us} us after the first, and this layout counts 4294967295 us \
                             at most: cut the time",
                            self.count + i as u64
                        ));
                    };
                    while *next_ms * 1000 <= us {
                        index.append(&[self.count + i as u64])?;
                        *next_ms += 1;
                    }
                    stored.push(narrow);
                }
                t.append(&stored)?;
            }
        }
        self.count += n as u64;
        Ok(())
    }
}

/// What was written in the layout of DSEC.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DsecWritten {
    /// Events.
    pub events: u64,
    /// Events whose stamp was rounded to whole microseconds.
    pub rounded: u64,
}

/// Writes events in the layout of DSEC: `events/{x,y,t,p}`, `ms_to_idx`, `t_offset`; the sensor's size as
/// attributes of `/events`. In-pixel times are left out.
///
/// # Errors
/// As [`EventSink::append`], what `fill` says, and when the file cannot be written.
pub fn write_dsec(
    path: &Path,
    extent: Extent,
    fill: impl FnOnce(&mut EventSink) -> Result<(), StoreError>,
) -> Result<DsecWritten, StoreError> {
    whole_file(path, |opened| {
        let group = create_group(opened, "events")?;
        opened.set_integer_attribute(&group, "sensor_width", extent.width.into())?;
        opened.set_integer_attribute(&group, "sensor_height", extent.height.into())?;
        opened.set_text_attribute(&group, "time_unit", "us")?;
        let (t, index) = (ColumnWriter::new(opened, "events/t"), ColumnWriter::new(opened, "ms_to_idx"));
        let mut sink = EventSink::new(
            opened,
            path,
            extent,
            Times::Dsec { t, index, offset_us: None, next_ms: 0, rounded: 0 },
        );
        fill(&mut sink)?;
        let EventSink { x, y, p, times, count, .. } = sink;
        x.finish()?;
        y.finish()?;
        p.finish()?;
        let Times::Dsec { t, index, offset_us, rounded, .. } = times else {
            return Ok(DsecWritten::default());
        };
        t.finish()?;
        index.finish()?;
        let offset = offset_us.unwrap_or(0);
        let written = locked(|| {
            let dataset = opened.file.new_dataset::<i64>().obj_track_times(false).create("t_offset")?;
            dataset.write_scalar(&offset)
        });
        opened.wrap("/t_offset", "write it", written)?;
        Ok(DsecWritten { events: count, rounded })
    })
}

/// Reads one frame: its values, row by row, channels side by side.
pub type ReadFrame<'a> = &'a dyn Fn(usize, &mut Vec<f32>) -> Result<(), StoreError>;

/// Frames that are read one by one while they are written.
#[derive(Clone)]
pub struct StreamedFrames<'a> {
    /// Size of a frame: the sensor's or a whole multiple.
    pub extent: Extent,
    /// Colours.
    pub colour: Colour,
    /// How they are stored.
    pub dn: DnType,
    /// Delay from one row to the next.
    pub row_time_ns: i64,
    /// Start and end of the exposure of row 0, ns, of every frame.
    pub exposures: Vec<(i64, i64)>,
    /// Gives linear digital numbers of a frame.
    pub read: ReadFrame<'a>,
}

/// A recording that is written as it comes.
#[derive(Clone)]
pub struct StreamedRecording<'a> {
    /// Size of the sensor.
    pub extent: Extent,
    /// Are there events, and does every one have its in-pixel time?
    pub events: Option<bool>,
    /// Step of the recorded stamps, when known.
    pub t_resolution_ns: Option<i64>,
    /// Frames.
    pub frames: Option<StreamedFrames<'a>>,
    /// Sensor description, TOML text.
    pub sensor: Option<&'a str>,
}

/// Writes a recording in bounded memory; `fill` gives the events, when there are any. Gives their number.
///
/// # Errors
/// As [`EventSink::append`], what `fill` and the frames' reader say, and when the file cannot be written.
pub fn stream_recording(
    path: &Path,
    content: &StreamedRecording,
    fill: impl FnOnce(&mut EventSink) -> Result<(), StoreError>,
) -> Result<u64, StoreError> {
    whole_file(path, |opened| {
        opened.set_text_attribute(&opened.file, "format", FORMAT)?;
        opened.set_integer_attribute(&opened.file, "width", content.extent.width.into())?;
        opened.set_integer_attribute(&opened.file, "height", content.extent.height.into())?;
        let mut count = 0;
        if let Some(has_t_in) = content.events {
            let group = create_group(opened, "events")?;
            if let Some(step) = content.t_resolution_ns {
                opened.set_integer_attribute(&group, "t_resolution_ns", step)?;
            }
            let t_in = has_t_in.then(|| ColumnWriter::new(opened, "events/t_in"));
            let mut sink = EventSink::new(
                opened,
                path,
                content.extent,
                Times::Recording { t: ColumnWriter::new(opened, "events/t"), t_in },
            );
            fill(&mut sink)?;
            count = sink.count;
            sink.x.finish()?;
            sink.y.finish()?;
            sink.p.finish()?;
            if let Times::Recording { t, t_in } = sink.times {
                for column in [Some(t), t_in].into_iter().flatten() {
                    opened.set_text_attribute(column.finish()?.dataset(), "unit", "ns")?;
                }
            }
        }
        if let Some(frames) = &content.frames {
            write_frames(opened, path, content.extent, frames)?;
        }
        if let Some(sensor) = content.sensor {
            opened.set_text("sensor", sensor)?;
        }
        Ok(count)
    })
}

/// One chunk a frame: it is read once and forgotten.
fn write_frames(
    opened: &Opened,
    path: &Path,
    sensor: Extent,
    frames: &StreamedFrames,
) -> Result<(), StoreError> {
    let misuse = |what: String| StoreError::Misuse { path: path.into(), what };
    if frames.extent.multiple_of(sensor).is_none() {
        return Err(misuse(format!(
            "frames of {} pixels are no whole multiple of the {sensor} event pixels: crop or bin them",
            frames.extent
        )));
    }
    let group = create_group(opened, "frames")?;
    opened.set_integer_attribute(&group, "row_time_ns", frames.row_time_ns)?;
    write_colour(opened, &group, frames.colour)?;
    let mut shape = vec![frames.exposures.len(), frames.extent.height as usize, frames.extent.width as usize];
    if frames.colour.channels() > 1 {
        shape.push(frames.colour.channels() as usize);
    }
    let chunk: Vec<usize> = std::iter::once(1).chain(shape[1..].iter().copied()).collect();
    let writer = match frames.dn {
        DnType::F32 => GridWriter::create::<f32>(opened, "frames/dn", &shape, &chunk, false)?,
        DnType::U16 => GridWriter::create::<u16>(opened, "frames/dn", &shape, &chunk, false)?,
    };
    let mut values = Vec::new();
    for frame in 0..frames.exposures.len() {
        (frames.read)(frame, &mut values)?;
        if values.len() != chunk.iter().product::<usize>() {
            return Err(misuse(format!(
                "frame {frame} has {} values instead of {}",
                values.len(),
                chunk.iter().product::<usize>()
            )));
        }
        let mut origin = vec![0; shape.len()];
        origin[0] = frame;
        match frames.dn {
            DnType::F32 => writer.write(&[(origin, values.as_slice())])?,
            // `as` saturates, and makes 0 of NaN.
            DnType::U16 => {
                writer.write(&[(origin, values.iter().map(|dn| dn.round() as u16).collect::<Vec<u16>>())])?
            }
        }
    }
    write_times(opened, "frames/exposure_start", frames.exposures.iter().map(|(start, _)| *start).collect())?;
    write_times(opened, "frames/exposure_end", frames.exposures.iter().map(|(_, end)| *end).collect())
}
