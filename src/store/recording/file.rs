//! An open recording: its header, and its streams as values that are read by band.

use super::checked::FORMAT;
use super::events::Events;
use super::frames::{Frames, TruthFrames};
use crate::error::{Mistakes, StoreError};
use crate::hdf::Opened;
use photocurrent_core::frames::FrameSource;
use photocurrent_core::handle::BandSource;
use photocurrent_core::{
    Colour, DataError, EventBand, EventStream, EventsMeta, Exposure, Extent, FrameScale, FrameSequence,
    FrameTimes, FramesMeta, Rows, Timestamp, Truth,
};
use std::path::Path;
use std::sync::Arc;

/// An open recording. Cheap to clone; may be read from many threads.
#[derive(Clone)]
pub struct Recording {
    pub(super) inner: Arc<Inner>,
}

pub(super) struct Inner {
    pub(super) opened: Opened,
    pub(super) extent: Extent,
    pub(super) events: Option<Events>,
    pub(super) frames: Option<Frames>,
    pub(super) sensor: Option<String>,
    pub(super) truth: Option<TruthFrames>,
}

impl Recording {
    /// Opens a file and reads its header: attributes, shapes, exposures, the first and the last stamp.
    ///
    /// # Errors
    /// When the file is no recording or its header contradicts the format, with every mistake there is. Event
    /// by event checks come with the first read.
    pub fn open(path: &Path) -> Result<Recording, StoreError> {
        let opened = Opened::read(path)?;
        if let Some(cut) = opened.cut() {
            let hint = format!(
                "keep what is whole in a file of its own: photocurrent convert {} OUT.h5",
                path.display()
            );
            return Err(StoreError::NotReadable { path: path.into(), found: cut, hint });
        }
        let format = opened.text_attribute(&opened.file, "/", "format")?;
        if format.as_deref() != Some(FORMAT) {
            let found =
                format.map_or("no attribute `format`".into(), |format| format!("format = \"{format}\""));
            let hint = "docs/formats.md states the layout of a recording; set the attribute if the file \
                        keeps to it";
            return Err(opened.content("/", found, format!("format = \"{FORMAT}\""), hint));
        }
        let mut mistakes = Mistakes::default();
        let (width, height) = (mistakes.take(side(&opened, "width")), mistakes.take(side(&opened, "height")));
        // Without a size, what does not depend on it is still looked at.
        let known = width.zip(height).map(|(width, height)| Extent { width, height });
        let extent = known.unwrap_or(Extent { width: 1, height: 1 });
        let events = mistakes.take(Events::open(&opened, extent)).flatten();
        let frames = mistakes.take(Frames::open(&opened, known)).flatten();
        let truth = mistakes.take(TruthFrames::open(&opened, known)).flatten();
        let sensor = opened
            .dataset("sensor")
            .and_then(|found| found.map(|dataset| opened.text("/sensor", &dataset)).transpose());
        let sensor = mistakes.take(sensor).flatten();
        mistakes.finish(path)?;
        Ok(Recording { inner: Arc::new(Inner { opened, extent, events, frames, sensor, truth }) })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.inner.opened.path
    }

    /// Size of the sensor.
    pub fn extent(&self) -> Extent {
        self.inner.extent
    }

    /// What is known about the events; `None` without an event stream.
    pub fn events_meta(&self) -> Option<&Arc<EventsMeta>> {
        self.inner.events.as_ref().map(|events| &events.meta)
    }

    /// Number of events; 0 without an event stream.
    pub fn event_count(&self) -> u64 {
        self.inner.events.as_ref().map_or(0, |events| events.count as u64)
    }

    /// The events of some rows in canonical order; a scan of the whole file. Without an event stream, a band
    /// without events.
    ///
    /// # Errors
    /// When a row is outside the sensor, events contradict the format, or the file cannot be read.
    pub fn read_events(&self, rows: Rows) -> Result<EventBand, StoreError> {
        if !self.extent().rows().contains(rows) {
            return Err(StoreError::Misuse {
                path: self.path().into(),
                what: format!("{rows} were asked for, but the sensor has {}", self.extent().rows()),
            });
        }
        match &self.inner.events {
            Some(events) => events.read(&self.inner.opened, rows),
            None => EventBand::from_events(rows, Vec::new())
                .map_err(|error| StoreError::Misuse { path: self.path().into(), what: error.message }),
        }
    }

    /// The events as a stream that is read by row band; `None` without an event stream.
    pub fn events(&self) -> Option<EventStream> {
        let meta = self.events_meta()?.clone();
        Some(EventStream::new(meta, self.extent().rows(), Arc::new(self.clone())))
    }

    /// Exposures of row 0; `None` without frames.
    pub fn exposures(&self) -> Option<&[Exposure]> {
        self.inner.frames.as_ref().map(|frames| frames.exposures.as_slice())
    }

    /// Delay from one row's exposure to the next as the recorder states it, ns; `None` when it does not.
    pub fn row_time_ns(&self) -> Option<i64> {
        self.inner.frames.as_ref().and_then(|frames| frames.row_time_ns)
    }

    /// How the frames' pixels are coloured; `None` without frames.
    pub fn colour(&self) -> Option<Colour> {
        self.inner.frames.as_ref().map(|frames| frames.colour)
    }

    /// What is known about the frames, with a row time that the caller settled (the recorder's word wins over
    /// the sensor description's).
    pub fn frames_meta(&self, row_time_ns: i64) -> Option<FramesMeta> {
        let frames = self.inner.frames.as_ref()?;
        let times = FrameTimes { exposures: Arc::new(frames.exposures.clone()), row_time_ns };
        Some(FramesMeta {
            extent: frames.dn.extent,
            colour: frames.colour,
            times,
            scale: FrameScale::Captured,
        })
    }

    /// The frames' numbers, u16 or f32 as f32; `None` without frames.
    pub fn frames_source(&self) -> Option<Arc<dyn FrameSource>> {
        self.inner.frames.as_ref().map(|frames| frames.dn.clone() as Arc<dyn FrameSource>)
    }

    /// The frames as a sequence; `None` without frames.
    pub fn frames(&self, row_time_ns: i64) -> Option<FrameSequence> {
        let meta = self.frames_meta(row_time_ns)?;
        let rows = meta.extent.rows();
        Some(FrameSequence::new(Arc::new(meta), rows, self.frames_source()?))
    }

    /// The nominal sensor description, as TOML text.
    pub fn sensor_text(&self) -> Option<&str> {
        self.inner.sensor.as_deref()
    }

    /// Instants of the true frames; `None` for real data.
    pub fn truth_times(&self) -> Option<&[Timestamp]> {
        self.inner.truth.as_ref().map(|truth| truth.times.as_slice())
    }

    /// The true frames' numbers; `None` for real data.
    fn truth_source(&self) -> Option<Arc<dyn FrameSource>> {
        self.inner.truth.as_ref().map(|truth| truth.dn.clone() as Arc<dyn FrameSource>)
    }

    /// The true frames; `None` for real data. An instant is written as an exposure of 1 ns; numbers are
    /// scaled to the median exposure of the frames, or count as captured when there is no frame.
    pub fn truth(&self) -> Option<Truth> {
        let truth = self.inner.truth.as_ref()?;
        let (extent, colour) = (truth.dn.extent, truth.colour);
        let exposures = truth.times.iter().map(|t| Exposure { start: *t, end: *t + 1 }).collect();
        let nominal = self.frames_meta(0).and_then(|frames| frames.times.nominal_exposure_ns());
        let scale = nominal.map_or(FrameScale::Captured, |exposure_ns| FrameScale::Nominal { exposure_ns });
        let meta = FramesMeta {
            extent,
            colour,
            times: FrameTimes { exposures: Arc::new(exposures), row_time_ns: 0 },
            scale,
        };
        Some(Truth(FrameSequence::new(Arc::new(meta), extent.rows(), self.truth_source()?)))
    }
}

/// The attribute `format` of an HDF5 file: which form of file it says it is. Reads nothing else.
///
/// # Errors
/// When it cannot be opened.
pub fn format_attribute(path: &Path) -> Result<Option<String>, StoreError> {
    let opened = Opened::read(path)?;
    opened.text_attribute(&opened.file, "/", "format")
}

impl BandSource<EventBand> for Recording {
    fn read(&self, rows: Rows) -> Result<EventBand, DataError> {
        Ok(self.read_events(rows)?)
    }
}

fn side(opened: &Opened, name: &str) -> Result<u32, StoreError> {
    let hint = "set `width` and `height` to the sensor's size in pixels";
    let value = opened.integer_attribute(&opened.file, "/", name)?;
    match value {
        // Columns and rows are u16 in the file.
        Some(value @ 1..=65536) => Ok(value as u32),
        Some(value) => Err(opened.content("/", format!("{name} = {value}"), "1 to 65536 pixels", hint)),
        None => Err(opened.content("/", format!("no attribute `{name}`"), "an integer", hint)),
    }
}
