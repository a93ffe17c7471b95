//! What is diagnosed: the events of every pixel in order of time, the frames, and the description of the sensor.

use photocurrent_core::quantity::Duration;
use photocurrent_core::{DataError, EventStream, Extent, FrameSequence, FrameTimes, Sensor};
use std::ops::Range;

/// An event as it was recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recorded {
    /// When it fired, ns: the recorded in-pixel stamp, or the off-pixel stamp less the smallest latency.
    pub t_in_ns: i64,
    /// When it left the array, ns, as recorded.
    pub t_off_ns: i64,
    /// +1 or -1.
    pub polarity: i8,
}

/// The events of all pixels of an array, pixel by pixel, each in order of in-pixel time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PixelEvents {
    first: Vec<usize>,
    all: Vec<Recorded>,
}

impl PixelEvents {
    /// From the events of each pixel, in row-major order of pixels; sorts each.
    pub fn new(pixels: impl IntoIterator<Item = Vec<Recorded>>) -> PixelEvents {
        let (mut first, mut all) = (vec![0], Vec::new());
        for mut events in pixels {
            events.sort_by_key(|event| (event.t_in_ns, event.t_off_ns));
            all.extend(events);
            first.push(all.len());
        }
        PixelEvents { first, all }
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.first.len() - 1
    }

    /// Where the events of a pixel stand in [`PixelEvents::all`].
    pub fn range(&self, pixel: usize) -> Range<usize> {
        self.first[pixel]..self.first[pixel + 1]
    }

    /// The events of a pixel (`y * width + x`).
    pub fn of(&self, pixel: usize) -> &[Recorded] {
        &self.all[self.range(pixel)]
    }

    /// Every event.
    pub fn all(&self) -> &[Recorded] {
        &self.all
    }
}

/// Frames in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct CaseFrames {
    /// Exposures and row time.
    pub times: FrameTimes,
    /// DN as [frame][y][x]; NaN = not known.
    pub dn: Vec<f32>,
}

/// A recording that is to be diagnosed.
#[derive(Clone, Debug)]
pub struct Case {
    /// Size of the array.
    pub extent: Extent,
    /// First and last instant, ns.
    pub span: (i64, i64),
    /// The events.
    pub events: PixelEvents,
    /// Was the in-pixel time of events recorded?
    pub has_t_in: bool,
    /// Width of a stamp's interval, ns; 0 = not stated.
    pub t_resolution_ns: i64,
    /// The frames, if there are any.
    pub frames: Option<CaseFrames>,
    /// The sensor as stated.
    pub sensor: Sensor,
}

impl Case {
    /// Reads a recording into memory.
    ///
    /// # Errors
    /// When neither stream is there, they cannot be read, or frames are not grey or have another extent than the events.
    pub fn read(events: Option<&EventStream>, frames: Option<&FrameSequence>, sensor: &Sensor) -> Result<Case, DataError> {
        let extent = match (events, frames) {
            (Some(events), _) => events.meta.extent,
            (None, Some(frames)) => frames.meta.extent,
            (None, None) => return Err(DataError::new("the recording has neither events nor frames")),
        };
        if let Some(frames) = frames
            && (frames.meta.extent != extent || frames.meta.row_values() != extent.width as usize || frames.meta.colour.is_mosaic())
        {
            let found = format!("{} pixels, {}", frames.meta.extent, frames.meta.colour.name());
            return Err(DataError::new(format!("frames have {found}; a diagnosis needs grey frames of {extent} pixels, as the events have")));
        }
        let latency_ns = sensor.readout.latency_min.map_or(0, Duration::ns);
        let mut pixels = vec![Vec::new(); extent.pixels()];
        let mut span: Option<(i64, i64)> = None;
        if let Some(events) = events {
            let band = events.read(extent.rows())?;
            for y in extent.rows().iter() {
                let row = band.row(y);
                for k in 0..row.len() {
                    let t_off_ns = row.t[k];
                    let t_in_ns = row.t_in.map_or(t_off_ns - latency_ns, |t_in| t_in[k]);
                    let recorded = Recorded { t_in_ns, t_off_ns, polarity: if row.on[k] == 1 { 1 } else { -1 } };
                    pixels[y as usize * extent.width as usize + usize::from(row.x[k])].push(recorded);
                }
            }
            span = events.meta.span.map(|span| (span.start.0, span.end.0));
        }
        let frames = frames.filter(|frames| !frames.is_empty()).map(|frames| -> Result<CaseFrames, DataError> {
            let block = frames.read_rows(extent.rows())?;
            Ok(CaseFrames { times: frames.meta.times.clone(), dn: block.dn })
        });
        let frames = frames.transpose()?;
        let covered = frames.as_ref().and_then(|frames| frames.times.span(extent.height)).map(|span| (span.start.0, span.end.0));
        let span = match (span, covered) {
            (Some(a), Some(b)) => (a.0.min(b.0), a.1.max(b.1)),
            (one, other) => one.or(other).unwrap_or((0, 0)),
        };
        Ok(Case {
            extent,
            span,
            events: PixelEvents::new(pixels),
            has_t_in: events.is_some_and(|events| events.meta.has_t_in),
            t_resolution_ns: events.and_then(|events| events.meta.t_resolution_ns).unwrap_or(0),
            frames,
            sensor: sensor.clone(),
        })
    }

    /// Column and row of a pixel.
    pub fn place(&self, pixel: usize) -> (u32, u32) {
        let width = self.extent.width as usize;
        ((pixel % width) as u32, (pixel / width) as u32)
    }

    /// Number of frames.
    pub fn frame_count(&self) -> usize {
        self.frames.as_ref().map_or(0, |frames| frames.times.len())
    }

    /// The value of a pixel in a frame.
    ///
    /// # Panics
    /// Without frames.
    pub fn dn(&self, frame: usize, pixel: usize) -> f64 {
        let frames = self.frames.as_ref().expect("frames are there");
        f64::from(frames.dn[frame * self.extent.pixels() + pixel])
    }
}
