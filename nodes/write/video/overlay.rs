//! What is drawn over the frames of a film: events in two colours, and counters.

use super::super::events::{Count, counted, over};
use super::super::font;
use crate::crop::Crop;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{EventStream, EventsMeta, FrameSequence, FramesMeta, NodeError, Sensor, TimeSpan};
use photocurrent_solve::pixel_events::clock_offset;
use std::ops::Range;

/// Events of so many frames are counted at a time, by the bytes that the counts take.
const COUNTED_BYTES: usize = 128 << 20;
/// The window of events where neither the parameter nor the time between frames states one.
const WINDOW_NS: i64 = 5_000_000;
/// A dot of the counters is as large as this many parts of the picture's width.
const PARTS: u32 = 250;
/// What is left of the picture behind the counters.
const DIMMED: u32 = 4;

/// The pictures of a film.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Film {
    /// Dots in a row.
    pub width: u32,
    /// Rows of dots.
    pub height: u32,
    /// Picture dots for each pixel along each side.
    scale: u32,
    /// Has it three values a dot, and not one?
    pub is_colour: bool,
}

impl Film {
    /// Of frames, with events over them or without.
    pub(super) fn of(frames: &FrameSequence, has_events: bool, scale: u32) -> Film {
        Film {
            width: frames.meta.extent.width * scale,
            height: frames.rows().len() as u32 * scale,
            scale,
            is_colour: has_events || frames.meta.channels() == 3,
        }
    }

    fn channels(self) -> usize {
        if self.is_colour { 3 } else { 1 }
    }
}

/// Refuses events that do not lie on the frames.
pub(super) fn check(events: &EventsMeta, frames: &FramesMeta) -> Result<(), NodeError> {
    if frames.extent.multiple_of(events.extent).is_some() {
        return Ok(());
    }
    Err(NodeError::usage(format!(
        "the events have {} pixels, and the frames have {}",
        events.extent, frames.extent
    ))
    .hint("connect events and frames of one sensor, or leave `events` out"))
}

/// What is drawn over the frames.
pub(super) struct Overlay<'a> {
    frames: &'a FrameSequence,
    events: Option<&'a EventStream>,
    /// When the events of each frame are drawn.
    windows: Vec<TimeSpan>,
    /// Subtracted from the events' stamps.
    shift_ns: i64,
    has_counters: bool,
    /// The frames whose events are counted, and the counts of their pixels.
    batch: Range<usize>,
    counts: Vec<Vec<Count>>,
}

impl<'a> Overlay<'a> {
    /// Of the events within `window`, that is the mean time between frames unless it is stated.
    ///
    /// # Errors
    /// When the description's clock offset is not understood.
    pub(super) fn new(
        frames: &'a FrameSequence,
        events: Option<&'a EventStream>,
        sensor: Option<&Sensor>,
        window: Option<Duration>,
        has_counters: bool,
    ) -> Result<Overlay<'a>, NodeError> {
        let times = &frames.meta.times;
        let step = times.mean_period_ns().map(|step| step.round() as i64).filter(|step| *step > 0);
        let length = window.map(Duration::ns).or(step).unwrap_or(WINDOW_NS);
        let around = |middle: i64| TimeSpan::new(middle - length / 2, middle - length / 2 + length);
        let offset = sensor.map(clock_offset).transpose()?;
        Ok(Overlay {
            frames,
            events,
            windows: times.exposures.iter().map(|exposure| around(exposure.mid().0)).collect(),
            shift_ns: offset.map_or(0, |offset| offset.offset_ns),
            has_counters,
            batch: 0..0,
            counts: Vec::new(),
        })
    }

    /// A sentence that says what is drawn; none where that is nothing.
    pub(super) fn about(&self) -> Option<String> {
        let window = self.events.and(self.windows.first())?;
        Some(format!(
            "events within {:.3} ms around the middle of each exposure are drawn: ON orange, OFF light blue",
            window.length_ns() as f64 / 1e6
        ))
    }

    /// The codes of frame `l` as the film shows them; `codes` are those of its pixels.
    ///
    /// # Errors
    /// When events cannot be read.
    pub(super) fn draw(&mut self, film: Film, l: usize, codes: Vec<u8>) -> Result<Vec<u8>, NodeError> {
        let (codes, rate) = match self.events {
            Some(events) => {
                let rate = self.count(events, l)?;
                (self.with_events(l, &codes), Some(rate))
            }
            None => (codes, None),
        };
        let mut codes = enlarged(codes, film);
        if self.has_counters {
            let t_ns = self.frames.meta.times.exposures[l].mid().0;
            write(&lines(t_ns, l, rate), film, &mut codes);
        }
        Ok(codes)
    }

    /// Counts the events of frame `l`, with those of the frames after it as far as memory allows; gives its
    /// events a second.
    fn count(&mut self, events: &EventStream, l: usize) -> Result<f64, NodeError> {
        let extent = self.frames.meta.extent;
        let ratio = extent.multiple_of(events.meta.extent).unwrap_or(1);
        if !self.batch.contains(&l) {
            let pixels = extent.width as usize * self.frames.rows().len();
            let most = (COUNTED_BYTES / (pixels * size_of::<Count>()).max(1)).max(1);
            self.batch = l..(l + most).min(self.windows.len());
            let rows = self.frames.rows();
            let crop = Crop { x: 0, y: rows.start, width: extent.width, height: rows.len() as u32 };
            self.counts = counted(events, ratio, &self.windows[self.batch.clone()], self.shift_ns, crop)?;
        }
        let all: u64 = self.counts[l - self.batch.start].iter().flatten().map(|&n| u64::from(n)).sum();
        // An event pixel is counted once for each of its frame pixels.
        let seconds = self.windows[l].length_ns() as f64 * 1e-9;
        Ok(all as f64 / f64::from(ratio * ratio) / seconds)
    }

    /// Red, green and blue of each pixel with its events over it.
    fn with_events(&self, l: usize, codes: &[u8]) -> Vec<u8> {
        let counts = &self.counts[l - self.batch.start];
        let channels = codes.len() / counts.len().max(1);
        let pixels = codes.chunks_exact(channels.max(1)).zip(counts);
        pixels.flat_map(|(c, &count)| over([0, 1, 2].map(|k| c[k.min(c.len() - 1)]), count)).collect()
    }
}

/// Every pixel as a square of dots.
fn enlarged(codes: Vec<u8>, film: Film) -> Vec<u8> {
    if film.scale == 1 {
        return codes;
    }
    let (scale, channels) = (film.scale as usize, film.channels());
    let row = film.width as usize / scale * channels;
    let mut all = Vec::with_capacity(codes.len() * scale * scale);
    for row in codes.chunks_exact(row.max(1)) {
        let begin = all.len();
        row.chunks_exact(channels).for_each(|dot| (0..scale).for_each(|_| all.extend_from_slice(dot)));
        let end = all.len();
        (1..scale).for_each(|_| all.extend_from_within(begin..end));
    }
    all
}

/// What the counters say.
fn lines(t_ns: i64, l: usize, rate: Option<f64>) -> Vec<String> {
    let mut lines = vec![format!("{:.3} ms", t_ns as f64 / 1e6), format!("frame {l}")];
    lines.extend(rate.map(|rate| match rate {
        rate if rate >= 1e6 => format!("{:.2} M events/s", rate / 1e6),
        rate if rate >= 1e3 => format!("{:.1} k events/s", rate / 1e3),
        rate => format!("{rate:.0} events/s"),
    }));
    lines
}

/// Writes the counters into the upper left corner: side by side where they fit, else one below the other.
fn write(lines: &[String], film: Film, codes: &mut [u8]) {
    let dot = (film.width / PARTS).max(1);
    let joined = lines.join("   ");
    let fits = font::width(&joined) * dot + 2 * dot <= film.width;
    let lines = if fits { std::slice::from_ref(&joined) } else { lines };
    let wide = lines.iter().map(|line| font::width(line)).max().unwrap_or(0) * dot + 2 * dot;
    let line_height = (font::CELL_HEIGHT + 1) * dot;
    let channels = film.channels();
    let place = |x: u32, y: u32| (y as usize * film.width as usize + x as usize) * channels;
    for y in 0..(lines.len() as u32 * line_height + dot).min(film.height) {
        for code in &mut codes[place(0, y)..place(wide.min(film.width), y)] {
            *code /= DIMMED as u8;
        }
    }
    for (k, line) in lines.iter().enumerate() {
        font::dots(line, |column, row| {
            for (dx, dy) in (0..dot).flat_map(|dy| (0..dot).map(move |dx| (dx, dy))) {
                let (x, y) = ((column + 1) * dot + dx, k as u32 * line_height + (row + 1) * dot + dy);
                if x < film.width && y < film.height {
                    codes[place(x, y)..place(x, y) + channels].fill(255);
                }
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::super::{In, Params};
    use super::*;
    use photocurrent_core::events::{Event, EventBand, Polarity};
    use photocurrent_core::{Exposure, Extent, testing};
    use std::sync::Arc;

    const EXTENT: Extent = Extent { width: 60, height: 20 };

    fn events(extent: Extent, all: &[(u16, u16, i64, bool)]) -> EventStream {
        let event = |&(x, y, t, on): &(u16, u16, i64, bool)| {
            let polarity = if on { Polarity::On } else { Polarity::Off };
            Event { x, y, polarity, t, t_in: None }
        };
        let meta = EventsMeta {
            extent,
            span: Some(TimeSpan::new(0, 10_000_000)),
            has_t_in: false,
            has_step: false,
            t_resolution_ns: None,
            count_hint: None,
        };
        let band = EventBand::from_events(extent.rows(), all.iter().map(event).collect()).unwrap();
        EventStream::in_memory(Arc::new(meta), band)
    }

    /// Two frames, exposed from 0 to 2 and from 4 to 6 ms.
    fn input(extent: Extent, all: &[(u16, u16, i64, bool)]) -> In {
        let exposures = vec![Exposure::new(0, 2_000_000), Exposure::new(4_000_000, 6_000_000)];
        let frames = testing::captured(EXTENT, exposures, 0, |_, _, _| 100.0);
        In { frames, events: Some(events(extent, all)), sensor: None }
    }

    fn overlay<'a>(input: &'a In, params: &Params) -> Overlay<'a> {
        let (events, sensor) = (input.events.as_ref(), input.sensor.as_deref());
        Overlay::new(&input.frames, events, sensor, params.window, params.counters).unwrap()
    }

    fn drawn(input: &In, params: Params, l: usize) -> (Film, Vec<u8>) {
        let film = Film::of(&input.frames, input.events.is_some(), params.scale);
        let mut overlay = overlay(input, &params);
        (film, overlay.draw(film, l, vec![100; EXTENT.pixels()]).unwrap())
    }

    #[test]
    fn events_of_a_frame_are_those_around_its_middle_and_no_others() {
        // From frame to frame pass 4 ms: the first has -1 to 3 ms, the second 3 to 7 ms.
        let all = [(5, 1, 2_999_999, true), (6, 1, 3_000_000, false), (7, 1, 7_000_000, true)];
        let input = input(EXTENT, &all);
        let coloured = |codes: &[u8]| {
            let pixels = codes.chunks(3).enumerate().filter(|(_, dot)| *dot != [100; 3]);
            pixels.map(|(at, dot)| (at, [dot[0], dot[1], dot[2]])).collect::<Vec<_>>()
        };
        let at = |x: usize| EXTENT.width as usize + x;
        assert_eq!(coloured(&drawn(&input, Params::default(), 0).1), [(at(5), over([100; 3], [1, 0]))]);
        assert_eq!(coloured(&drawn(&input, Params::default(), 1).1), [(at(6), over([100; 3], [0, 1]))]);
        let short = Params { window: Some(Duration::new(1_000_000)), ..Params::default() };
        assert_eq!(coloured(&drawn(&input, short, 1).1), []);
        // A clock that counts 1 ms more: what is stamped at 7 ms was at 6 ms.
        let mut sensor = Sensor::unknown("test");
        let offset = serde_json::json!({ "offset": "1 ms" });
        sensor.effects.insert("clock_offset".into(), serde_json::from_value(offset).unwrap());
        let late = In { sensor: Some(Arc::new(sensor)), ..input };
        assert_eq!(coloured(&drawn(&late, Params::default(), 1).1).len(), 1);
    }

    #[test]
    fn an_event_of_a_coarser_array_covers_its_frame_pixels_and_counts_once() {
        let coarse = Extent { width: 30, height: 10 };
        let input = input(coarse, &[(2, 3, 1_000_000, true)]);
        let (_, codes) = drawn(&input, Params::default(), 0);
        assert_eq!(codes.chunks(3).filter(|dot| *dot != [100; 3]).count(), 4);
        let mut overlay = overlay(&input, &Params::default());
        // One event in 4 ms.
        assert_eq!(overlay.count(input.events.as_ref().unwrap(), 0).unwrap(), 250.0);
    }

    #[test]
    fn counters_are_written_white_on_a_dimmed_corner() {
        let plain = In { events: None, ..input(EXTENT, &[]) };
        let params = Params { counters: true, ..Params::default() };
        let (film, codes) = drawn(&plain, params.clone(), 1);
        assert!(!film.is_colour && codes.len() == EXTENT.pixels());
        // One below the other: "5.000 ms" and "frame 1", eight characters of six dots at most.
        let row = |y: usize| &codes[y * 60..y * 60 + 60];
        assert!(row(0)[..50].iter().all(|code| *code == 25) && row(0)[50..].iter().all(|code| *code == 100));
        assert!(row(19).iter().all(|code| *code == 100));
        // The top of a 5 is a stroke of five dots.
        assert_eq!(row(1)[1..6], [255; 5]);
        let (large, codes) = drawn(&plain, Params { scale: 3, ..params }, 1);
        assert_eq!((large.width, large.height, codes.len()), (180, 60, 180 * 60));
        // Three times as wide, both stand in one line.
        assert!(codes[15 * 180..16 * 180].iter().all(|code| *code == 100));
    }

    #[test]
    fn the_counters_have_units_that_people_write() {
        assert_eq!(lines(1_234_567, 7, None), ["1.235 ms", "frame 7"]);
        assert_eq!(lines(0, 0, Some(999.4))[2], "999 events/s");
        assert_eq!(lines(0, 0, Some(45_678.0))[2], "45.7 k events/s");
        assert_eq!(lines(0, 0, Some(12_345_678.0))[2], "12.35 M events/s");
    }

    #[test]
    fn a_pixel_becomes_a_square() {
        let film = Film { width: 4, height: 2, scale: 2, is_colour: false };
        assert_eq!(enlarged(vec![1, 2], film), [1, 1, 2, 2, 1, 1, 2, 2]);
        let film = Film { is_colour: true, width: 2, ..film };
        assert_eq!(enlarged(vec![1, 2, 3], film), [1, 2, 3].repeat(4));
    }
}
