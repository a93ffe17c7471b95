//! A recording in memory: the events of every pixel in order of time, the frames, and the description of the
//! sensor.

use crate::grey::{GreyFrames, SaturatedMean};
use crate::recorded::EventGatherer;
pub use crate::recorded::{CaseFrames, PixelEvents};
use photocurrent_core::events::{Event, EventRow};
use photocurrent_core::frames::FrameSource;
use photocurrent_core::handle::BandSource;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{
    Colour, DataError, EventBand, EventStream, EventsMeta, Extent, FrameBlock, FrameScale, FrameSequence,
    FrameTimes, FramesMeta, Meta, Polarity, Rows, Sensor, TimeSpan,
};
pub use photocurrent_sensor::comparator::PixelEvent;
use std::ops::Range;
use std::sync::Arc;

/// Most bands of rows in which events are read: each may be a scan of the whole file.
const MOST_BANDS: u64 = 8;
/// Fewer events than this are no band of their own.
const BAND_EVENTS: u64 = 1 << 20;

/// Number of bands for reading a number of events.
fn bands(events: u64) -> u64 {
    (events / BAND_EVENTS).clamp(1, MOST_BANDS)
}

/// A recording to be diagnosed. A copy shares events and frame values.
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
    /// The nominal sensor.
    pub sensor: Sensor,
}

impl Case {
    /// About how many bytes reading takes at its peak: events by pixel, a band of them as it is read, and
    /// frames.
    pub fn estimated_bytes(events: Option<&Arc<EventsMeta>>, frames: Option<&Arc<FramesMeta>>) -> u64 {
        let events = events.map_or(0, |meta| {
            let count = meta.count_hint.unwrap_or(8 * meta.extent.pixels() as u64);
            let band = Meta::Events(meta.clone()).estimated_bytes() / bands(count);
            count.saturating_mul(size_of::<PixelEvent>() as u64).saturating_add(band)
        });
        events.saturating_add(frames.map_or(0, |meta| Meta::Frames(meta.clone()).estimated_bytes()))
    }

    /// A recording as far as it is known before its data: with their times, and without events and frame
    /// values.
    ///
    /// # Errors
    /// When neither stream is there, or frames have no whole number of pixels along the side of an event's.
    pub fn before_data(
        events: Option<&EventsMeta>,
        frames: Option<&FramesMeta>,
        sensor: &Sensor,
    ) -> Result<Case, DataError> {
        let neither = || DataError::new("the recording has neither events nor frames");
        let extent =
            events.map(|events| events.extent).or(frames.map(|frames| frames.extent)).ok_or_else(neither)?;
        let grey = frames.map(|frames| GreyFrames::new(extent, frames, sensor)).transpose()?;
        Ok(Case {
            extent,
            span: Case::span_of(events, frames.map(|frames| (&frames.times, extent.height))),
            events: PixelEvents::default(),
            has_t_in: events.is_some_and(|events| events.has_t_in),
            t_resolution_ns: events.and_then(|events| events.t_resolution_ns).unwrap_or(0),
            frames: frames
                .zip(grey)
                .map(|(frames, grey)| CaseFrames::new(grey.times(&frames.times), Vec::new())),
            sensor: sensor.clone(),
        })
    }

    /// Reads a recording into memory.
    ///
    /// # Errors
    /// When neither stream is there, they cannot be read, or frames have no whole number of pixels along the
    /// side of an event's.
    pub fn read(
        events: Option<&EventStream>,
        frames: Option<&FrameSequence>,
        sensor: &Sensor,
    ) -> Result<Case, DataError> {
        let extent = match (events, frames) {
            (Some(events), _) => events.meta.extent,
            (None, Some(frames)) => frames.meta.extent,
            (None, None) => return Err(DataError::new("the recording has neither events nor frames")),
        };
        let grey = frames.map(|frames| GreyFrames::new(extent, &frames.meta, sensor)).transpose()?;
        let latency_ns = sensor.readout.latency_min.map_or(0, Duration::ns);
        let count = events.and_then(|events| events.meta.count_hint).unwrap_or(0);
        let mut gathered = EventGatherer::default();
        match events {
            Some(events) => {
                for rows in extent.rows().bands(u64::from(extent.height).div_ceil(bands(count)) as u32) {
                    let band = events.read(rows)?;
                    // By what was read: a stated number may be anything.
                    gathered.reserve(band.len());
                    rows.iter().for_each(|y| gather(&band.row(y), extent.width, latency_ns, &mut gathered));
                }
            }
            None => (0..extent.pixels()).for_each(|_| gathered.pixel([])),
        }
        let both = frames.zip(grey).filter(|(frames, _)| !frames.is_empty());
        let frames = both
            .map(|(frames, grey)| -> Result<CaseFrames, DataError> {
                let mut read = CaseFrames::new(
                    grey.times(&frames.meta.times),
                    grey.read(frames, SaturatedMean::Unknown)?,
                );
                read.filters = grey.is_behind_filters().then_some(frames.meta.colour);
                Ok(read)
            })
            .transpose()?;
        let span = Case::span_of(
            events.map(|events| &*events.meta),
            frames.as_ref().map(|frames| (&frames.times, extent.height)),
        );
        Ok(Case {
            extent,
            span,
            events: gathered.finish(),
            has_t_in: events.is_some_and(|events| events.meta.has_t_in),
            t_resolution_ns: events.and_then(|events| events.meta.t_resolution_ns).unwrap_or(0),
            frames,
            sensor: sensor.clone(),
        })
    }

    /// The events and the frames as data that others take, cut out of this recording as they are read; frames
    /// are grey, as captured.
    pub fn streams(&self) -> (EventStream, Option<FrameSequence>) {
        let (rows, shared) = (self.extent.rows(), Arc::new(SharedEvents(self.clone())));
        let events = EventStream::new(Arc::new(self.events_meta()), rows, shared.clone());
        let frames = self.frames.as_ref().map(|frames| {
            let meta = FramesMeta {
                extent: self.extent,
                colour: Colour::Mono,
                times: frames.times.clone(),
                scale: FrameScale::Captured,
            };
            FrameSequence::new(Arc::new(meta), rows, shared)
        });
        (events, frames)
    }

    /// Metadata of the stream of [`Case::streams`].
    pub fn events_meta(&self) -> EventsMeta {
        EventsMeta {
            extent: self.extent,
            span: Some(TimeSpan::new(self.span.0, self.span.1)),
            has_t_in: self.has_t_in,
            has_step: false,
            t_resolution_ns: (self.t_resolution_ns > 0).then_some(self.t_resolution_ns),
            count_hint: None,
        }
    }

    /// First and last instant of a recording, ns, from its metadata; (0, 0) without them.
    pub fn span_of(events: Option<&EventsMeta>, frames: Option<(&FrameTimes, u32)>) -> (i64, i64) {
        let span = |span: TimeSpan| (span.start.0, span.end.0);
        let covered = frames.and_then(|(times, height)| times.span(height)).map(span);
        match (events.and_then(|events| events.span).map(span), covered) {
            (Some(a), Some(b)) => (a.0.min(b.0), a.1.max(b.1)),
            (one, other) => one.or(other).unwrap_or((0, 0)),
        }
    }

    /// The neighbouring frames of at most `values` values in all with the most events between them, and the
    /// events from the first one's start to the last one's end; none where all frames fit, or fewer than
    /// three do.
    pub fn busiest_frames(&self, values: usize) -> Option<Case> {
        let frames = self.frames.as_ref()?;
        let pixels = self.extent.pixels();
        let (count, all) = (values / pixels.max(1), frames.times.len());
        if all <= count || count < 3 {
            return None;
        }
        let row = self.extent.height - 1;
        let span = |from: usize| {
            (frames.times.exposure(from, 0).start.0, frames.times.exposure(from + count - 1, row).end.0)
        };
        let mut instants: Vec<i64> = self.events.iter().map(|event| event.t_in_ns).collect();
        instants.sort_unstable();
        let number = |from: usize| {
            let (begin, end) = span(from);
            instants.partition_point(|t| *t < end) - instants.partition_point(|t| *t < begin)
        };
        let from = (0..=all - count).max_by_key(|&from| (number(from), usize::MAX - from))?;
        Some(self.frame_range(from..from + count))
    }

    /// A range of its frames, with the events from the start of the first one to the end of the last one.
    ///
    /// # Panics
    /// Where it does not have these frames.
    pub fn frame_range(&self, of: Range<usize>) -> Case {
        let frames = self.frames.as_ref().expect("frames are there");
        let pixels = self.extent.pixels();
        let span = (
            frames.times.exposure(of.start, 0).start.0,
            frames.times.exposure(of.end - 1, self.extent.height - 1).end.0,
        );
        let within =
            |event: &&PixelEvent| (span.0..span.1).contains(&event.t_in_ns) && event.t_off_ns < span.1;
        let events = PixelEvents::new(
            (0..pixels).map(|pixel| self.events.of_pixel(pixel).iter().filter(within).copied().collect()),
        );
        Case { span, events, frames: Some(frames.frame_range(of)), sensor: self.sensor.clone(), ..*self }
    }

    /// Column and row of a pixel.
    pub fn pixel_place(&self, pixel: usize) -> (u32, u32) {
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
        f64::from(self.frames.as_ref().expect("frames are there").dn(frame, pixel))
    }

    /// The recording without some pixels: they have no event, and their frame values are not known.
    #[must_use]
    pub fn without_pixels(&self, pixels: &[u32]) -> Case {
        let frames = self.frames.as_ref().map(|frames| frames.without_pixels(pixels));
        Case { events: self.events.without_pixels(pixels), frames, sensor: self.sensor.clone(), ..*self }
    }
}

/// A recording in memory as a source of rows.
struct SharedEvents(Case);

impl BandSource<EventBand> for SharedEvents {
    fn read(&self, rows: Rows) -> Result<EventBand, DataError> {
        let SharedEvents(case) = self;
        let width = case.extent.width as usize;
        let pixels = rows.start as usize * width..rows.end as usize * width;
        let mut events = Vec::with_capacity(case.events.count(pixels.clone()));
        for pixel in pixels {
            let (x, y) = case.pixel_place(pixel);
            events.extend(case.events.of_pixel(pixel).iter().map(|event| Event {
                x: x as u16,
                y: y as u16,
                polarity: if event.polarity > 0 { Polarity::On } else { Polarity::Off },
                t: event.t_off_ns,
                t_in: case.has_t_in.then_some(event.t_in_ns),
            }));
        }
        let mut band = EventBand::from_events(rows, events)?;
        if !case.has_t_in {
            band.t_in = None;
        }
        Ok(band)
    }
}

impl FrameSource for SharedEvents {
    fn read(&self, frames: Range<usize>, rows: Rows) -> Result<FrameBlock, DataError> {
        let width = self.0.extent.width as usize;
        let mut block = FrameBlock::zeros(frames.clone(), rows, width);
        for frame in frames {
            for row in rows.iter() {
                let first = row as usize * width;
                block
                    .row_mut(frame, row)
                    .iter_mut()
                    .enumerate()
                    .for_each(|(x, to)| *to = self.0.dn(frame, first + x) as f32);
            }
        }
        Ok(block)
    }
}

/// The events of a row, pixel by pixel.
fn gather(row: &EventRow<'_>, width: u32, latency_ns: i64, gathered: &mut EventGatherer) {
    let mut of = vec![Vec::new(); width as usize];
    for k in 0..row.len() {
        let t_off_ns = row.t[k];
        let t_in_ns = row.t_in.map_or(t_off_ns - latency_ns, |t_in| t_in[k]);
        of[usize::from(row.x[k])].push(PixelEvent {
            t_in_ns,
            t_off_ns,
            polarity: if row.on[k] == 1 { 1 } else { -1 },
        });
    }
    of.into_iter().for_each(|events| gathered.pixel(events));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use std::sync::Mutex;

    #[test]
    fn a_case_that_was_handed_on_is_read_again_as_it_was() {
        for has_t_in in [true, false] {
            let case = Case { has_t_in, t_resolution_ns: 20, ..testing::case() };
            // Without in-pixel times they follow from the off-pixel ones.
            let case = if has_t_in {
                case
            } else {
                Case::read(Some(&case.streams().0), None, &case.sensor).unwrap()
            };
            let (events, frames) = case.streams();
            let again = Case::read(Some(&events), frames.as_ref(), &case.sensor).unwrap();
            assert_eq!(
                (again.events, again.frames, again.span),
                (case.events.clone(), case.frames.clone(), case.span)
            );
            assert_eq!((again.has_t_in, again.t_resolution_ns), (has_t_in, 20));
        }
    }

    /// Says in which bands it was read.
    struct Watched(EventStream, Mutex<Vec<Rows>>);

    impl BandSource<EventBand> for Watched {
        fn read(&self, rows: Rows) -> Result<EventBand, DataError> {
            self.1.lock().unwrap().push(rows);
            self.0.read(rows)
        }
    }

    #[test]
    fn many_events_are_read_in_a_few_bands() {
        let case = testing::case();
        let (events, frames) = case.streams();
        let rows = case.extent.rows();
        for (count, bands) in
            [(Some(1000), vec![10]), (Some(3 * BAND_EVENTS), vec![4, 4, 2]), (None, vec![10])]
        {
            let watched = Arc::new(Watched(events.clone(), Mutex::default()));
            let meta = Arc::new(EventsMeta { count_hint: count, ..(*events.meta).clone() });
            let again = Case::read(
                Some(&EventStream::new(meta, rows, watched.clone())),
                frames.as_ref(),
                &case.sensor,
            )
            .unwrap();
            assert_eq!(watched.1.lock().unwrap().iter().map(Rows::len).collect::<Vec<_>>(), bands);
            assert_eq!((again.events, again.frames), (case.events.clone(), case.frames.clone()));
        }
    }

    #[test]
    fn the_busiest_frames_are_those_with_the_most_events_between_them() {
        let case = testing::case();
        let pixels = case.extent.pixels();
        assert!(case.busiest_frames(7 * pixels).is_none() && case.busiest_frames(2 * pixels).is_none());
        // Events of the last 25 ms only: the last four of seven frames have them all.
        let late = PixelEvents::new((0..pixels).map(|pixel| {
            case.events.of_pixel(pixel).iter().filter(|event| event.t_in_ns > 35_000_000).copied().collect()
        }));
        let part = Case { events: late, ..case.clone() }.busiest_frames(4 * pixels + 5).unwrap();
        assert_eq!(part.span, (24_000_000, 52_000_000 + 9 * 20_000));
        assert_eq!(part.frame_count(), 4);
        assert_eq!((part.dn(0, 17), part.dn(3, 50)), (case.dn(3, 17), case.dn(6, 50)));
        let within = case
            .events
            .iter()
            .filter(|event| event.t_in_ns > 35_000_000 && event.t_off_ns < part.span.1)
            .count();
        assert_eq!(part.events.len(), within);
    }
}
