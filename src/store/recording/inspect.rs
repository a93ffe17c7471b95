//! A summary of a recording, from its header alone.

use super::file::Recording;
use photocurrent_core::time::NS_PER_S;
use photocurrent_core::{Colour, TimeSpan};
use serde::Serialize;

/// What a recording holds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Inspection {
    /// The file.
    pub path: String,
    /// Its size.
    pub bytes: u64,
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `None` without an event stream.
    pub events: Option<EventsSummary>,
    /// `None` without frames.
    pub frames: Option<FramesSummary>,
    /// `None` for real data.
    pub truth: Option<TruthSummary>,
    /// Does it carry a sensor description?
    pub has_sensor: bool,
}

/// Of the event stream.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EventsSummary {
    /// Number of events.
    pub count: u64,
    /// From the first stamp to just after the last.
    pub span: Option<TimeSpan>,
    /// Mean rate over the span.
    pub events_per_s: Option<f64>,
    /// Mean rate of a pixel over the span.
    pub events_per_pixel_s: Option<f64>,
    /// Are there in-pixel times?
    pub has_t_in: bool,
    /// Step of the recorded stamps, when stated.
    pub t_resolution_ns: Option<i64>,
}

/// Smallest, middle and largest of some times.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Spread {
    /// Smallest.
    pub min_ns: i64,
    /// Middle, the lower one of an even number.
    pub median_ns: i64,
    /// Largest.
    pub max_ns: i64,
}

/// Of the frames.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FramesSummary {
    /// Number of frames.
    pub count: u64,
    /// From the first exposure's start to the last one's end, all rows counted.
    pub span: Option<TimeSpan>,
    /// From the starts of the first and the last frame; `None` below two frames.
    pub frames_per_s: Option<f64>,
    /// Lengths of exposures; `None` without a frame.
    pub exposure: Option<Spread>,
    /// Delay from one row to the next, when stated.
    pub row_time_ns: Option<i64>,
    /// Pixels in a row: the events' or a whole multiple.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Frame pixels along the side of an event pixel.
    pub pixels_per_event_pixel: u32,
    /// Values per pixel.
    pub channels: u32,
    /// `mono`, `rgb`, `bayer_rggb` ...
    pub colour: Colour,
    /// `f32` or `u16`.
    pub number_type: &'static str,
}

/// Of the true frames.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TruthSummary {
    /// Number of instants.
    pub count: u64,
    /// From the first to just after the last instant.
    pub span: Option<TimeSpan>,
}

impl Recording {
    /// A summary; reads nothing more than [`Recording::open`] did.
    pub fn inspect(&self) -> Inspection {
        let extent = self.extent();
        let events = self.inner.events.as_ref().map(|events| {
            let span = events.meta.span;
            let rate = span
                .filter(|span| span.length_ns() > 1)
                .map(|span| events.count as f64 / (span.length_ns() as f64 / NS_PER_S));
            EventsSummary {
                count: events.count as u64,
                span,
                events_per_s: rate,
                events_per_pixel_s: rate.map(|rate| rate / extent.pixels() as f64),
                has_t_in: events.meta.has_t_in,
                t_resolution_ns: events.meta.t_resolution_ns,
            }
        });
        let frames = self.inner.frames.as_ref().map(|frames| {
            let mut lengths: Vec<i64> =
                frames.exposures.iter().map(|exposure| exposure.length_ns()).collect();
            lengths.sort_unstable();
            let exposure = lengths.first().zip(lengths.last()).map(|(&min_ns, &max_ns)| Spread {
                min_ns,
                median_ns: lengths[(lengths.len() - 1) / 2],
                max_ns,
            });
            let between = frames
                .exposures
                .first()
                .zip(frames.exposures.last())
                .map_or(0, |(first, last)| last.start - first.start);
            FramesSummary {
                count: frames.exposures.len() as u64,
                span: self
                    .frames_meta(frames.row_time_ns.unwrap_or(0))
                    .and_then(|meta| meta.times.span(meta.extent.height)),
                frames_per_s: (between > 0)
                    .then(|| (frames.exposures.len() - 1) as f64 / (between as f64 / NS_PER_S)),
                exposure,
                row_time_ns: frames.row_time_ns,
                width: frames.dn.extent.width,
                height: frames.dn.extent.height,
                pixels_per_event_pixel: frames.dn.extent.multiple_of(extent).unwrap_or(1),
                channels: frames.colour.channels(),
                colour: frames.colour,
                number_type: frames.dn.number_type(),
            }
        });
        let truth = self.truth_times().map(|times| TruthSummary {
            count: times.len() as u64,
            span: times
                .first()
                .zip(times.last())
                .map(|(first, last)| TimeSpan::new(first.0, last.0.saturating_add(1))),
        });
        Inspection {
            path: self.path().display().to_string(),
            bytes: self.inner.opened.bytes,
            width: extent.width,
            height: extent.height,
            events,
            frames,
            truth,
            has_sensor: self.inner.sensor.is_some(),
        }
    }
}
