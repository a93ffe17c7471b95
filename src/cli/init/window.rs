//! Which part of a recording is rendered first: where frames are, and short enough that the first run takes a
//! minute or two.

use photocurrent_core::quantity::Duration;
use photocurrent_core::{Coverage, FramesMeta, TimeSpan};
use photocurrent_formats::arrange::Arranged;
use photocurrent_formats::hazard::time;
use photocurrent_formats::{EventChunk, FormatError, Recording};

/// Values that are rendered, about, so that a first run takes a minute or two; pixels times frames.
const RENDERED: f64 = 1.2e8;

/// Events that are solved, about, for the same reason.
const SOLVED: f64 = 2e6;

/// A part of a recording, from its zero.
pub struct Window {
    pub start: Duration,
    pub end: Duration,
    /// Why it is cut so.
    pub why: String,
}

/// Whole milliseconds around a span, from zero on.
fn outwards(start_ns: i64, end_ns: i64, why: String) -> Window {
    const MS: i64 = 1_000_000;
    let (start, end) =
        (start_ns.max(0).div_euclid(MS) * MS, end_ns.div_euclid(MS).saturating_add(1).saturating_mul(MS));
    Window { start: Duration::new(start), end: Duration::new(end), why }
}

/// The part that has frames, where the recording is longer: a pause between frames, or events far from all of
/// them. `None` where frames are near throughout.
///
/// # Errors
/// When the events cannot be read.
pub fn with_frames(
    recording: &dyn Recording,
    arranged: &Arranged,
    frames: &FramesMeta,
    events: TimeSpan,
) -> Result<Option<Window>, FormatError> {
    let coverage = Coverage::of(&frames.times, frames.extent.height);
    let Some(part) = coverage.fullest() else { return Ok(None) };
    let around = coverage.around(part);
    // A frame that is exposed for seconds among short ones ends outside too.
    let last = frames.times.span(frames.extent.height).map_or(events.end, |span| span.end.max(events.end));
    let ends_outside = events.start < around.start || last > around.end;
    if coverage.parts.len() == 1 && !ends_outside {
        return Ok(None);
    }
    // What comes before the first and after the last frame of a part cannot be held against any.
    let mut window = outwards(part.span.start.0, part.span.end.0, String::new());
    let (outside, count) = count_outside(recording, arranged.zero_ns, around)?;
    let mut why = Vec::new();
    if coverage.parts.len() > 1 {
        let gap = part_gap(&coverage);
        why.push(format!(
            "frames pause for up to {}; of {} parts this is the one with most frames, {} of {}",
            time(gap as f64),
            coverage.parts.len(),
            part.frames.len(),
            frames.times.len()
        ));
    }
    if outside > 0 {
        let span = events.end.0.saturating_sub(events.start.0);
        why.push(format!(
            "{outside} of {count} events lie far from these frames, in a span of {}",
            time(span as f64)
        ));
    }
    if why.is_empty() {
        why.push("the exposure of a frame ends long after the others".to_owned());
    }
    window.why = why.join("; ");
    Ok(Some(window))
}

/// The longest time between two parts, ns.
fn part_gap(coverage: &Coverage) -> i64 {
    coverage
        .parts
        .windows(2)
        .map(|pair| pair[1].span.start.0.saturating_sub(pair[0].span.end.0))
        .max()
        .unwrap_or(0)
}

/// Events outside of a span, and all.
fn count_outside(recording: &dyn Recording, zero_ns: i64, span: TimeSpan) -> Result<(u64, u64), FormatError> {
    let (mut cursor, mut chunk) = (recording.events()?, EventChunk::default());
    let (mut outside, mut count) = (0u64, 0u64);
    while cursor.next(&mut chunk)? {
        count += chunk.len() as u64;
        outside += chunk
            .t
            .iter()
            .map(|t| t.saturating_sub(zero_ns))
            .filter(|t| *t < span.start.0 || *t >= span.end.0)
            .count() as u64;
    }
    Ok((outside, count))
}

/// A window with a few frames in which events and frames overlap, and a rate: the first run should be short.
pub fn to_render(frames: &FramesMeta, events: TimeSpan, count: u64) -> (Option<Window>, f64) {
    let span = frames.times.span(frames.extent.height).unwrap_or(events);
    let (start, end) = (span.start.max(events.start).0, span.end.min(events.end).0);
    let period_ns = (Coverage::of(&frames.times, frames.extent.height).period_ns as f64).max(1e5);
    // Sixteen pictures for each frame; a whole number of hertz.
    let rate_hz = (16e9 / period_ns).round().clamp(10.0, 10_000.0);
    let per_ns = count as f64 / (events.length_ns().max(1)) as f64;
    let by_pictures = RENDERED / frames.extent.pixels() as f64 / rate_hz * 1e9;
    let by_events = if per_ns > 0.0 { SOLVED / per_ns } else { f64::INFINITY };
    let length = by_pictures.min(by_events).max(3.5 * period_ns);
    if end.saturating_sub(start) as f64 <= 1.2 * length {
        return (None, rate_hz);
    }
    // From the first frame that is whole inside.
    let first =
        frames.times.exposures.iter().map(|exposure| exposure.start.0).find(|t| *t >= start).unwrap_or(start);
    let why = "a part, so that the first run is short; delete both lines for the whole recording";
    (Some(outwards(first, first.saturating_add(length as i64), why.into())), rate_hz)
}
