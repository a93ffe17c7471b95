//! Which parts of a recording's time have frames near: a camera that paused, and events stamped far from all
//! frames.
//!
//! Work over a recording grows with its time, so time without frames must not be filled: nothing there states
//! the light's level. Frames are grouped into parts, split where the next frame begins more than [`PAUSE`]
//! usual periods after the one before. The time within as many periods of a frame is near one.
//!
//! The usual period is the median time from frame to frame, at most [`LONGEST`] exposures: two frames an hour
//! apart state no period. A single frame counts as one of a film with [`SINGLE`] exposures to a period.

use crate::frames::FrameTimes;
use crate::time::{TimeSpan, in_seconds};
use std::ops::Range;

/// Periods without a frame that make a pause, and periods around a frame that are near it. Fifteen dropped
/// frames are still reconstructed from events.
const PAUSE: i64 = 16;
/// The longest period, in exposures.
const LONGEST: i64 = 1000;
/// The period of a single frame, in exposures.
const SINGLE: i64 = 64;
/// A span is covered when the time near frames is at least one part in so many of it.
const SPARSE: i64 = 4;
/// Parts that messages list.
const LISTED: usize = 4;

/// Neighbouring frames without a pause.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// Which frames.
    pub frames: Range<usize>,
    /// From the start of the first exposure of them to the end of the last, all rows counted.
    pub span: TimeSpan,
}

/// The parts of a film.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Coverage {
    /// In order of time; empty without frames.
    pub parts: Vec<Part>,
    /// The usual time from frame to frame, ns, positive.
    pub period_ns: i64,
}

impl Coverage {
    /// Of frames of `height` rows.
    pub fn of(times: &FrameTimes, height: u32) -> Coverage {
        let exposures = &times.exposures;
        let mut periods: Vec<i64> = exposures
            .windows(2)
            .map(|pair| pair[1].start.0.saturating_sub(pair[0].start.0))
            .filter(|period| *period > 0)
            .collect();
        periods.sort_unstable();
        let exposure = times.nominal_exposure_ns().unwrap_or(1).max(1);
        let usual = periods
            .get(periods.len().saturating_sub(1) / 2)
            .copied()
            .unwrap_or(exposure.saturating_mul(SINGLE));
        let period_ns = usual.min(exposure.saturating_mul(LONGEST)).max(1);
        let mut parts: Vec<Part> = Vec::new();
        for frame in 0..exposures.len() {
            let Some(span) = times.select(&[frame]).span(height) else { continue };
            // One exposure that lasts longer than a pause is a wrong stamp, and covers no more than one.
            let span = TimeSpan::new(
                span.start.0,
                span.end.0.min(span.start.0.saturating_add(period_ns.saturating_mul(PAUSE))),
            );
            let joins = frame > 0
                && exposures[frame].start.0.saturating_sub(exposures[frame - 1].start.0)
                    <= period_ns.saturating_mul(PAUSE);
            match parts.last_mut().filter(|_| joins) {
                Some(part) => {
                    part.frames.end = frame + 1;
                    part.span = part.span.union(span);
                }
                None => parts.push(Part { frames: frame..frame + 1, span }),
            }
        }
        Coverage { parts, period_ns }
    }

    /// The part with most frames, the first of equal ones.
    pub fn fullest(&self) -> Option<&Part> {
        self.parts.iter().max_by_key(|part| (part.frames.len(), std::cmp::Reverse(part.frames.start)))
    }

    /// A part with the time around it that is near its frames.
    pub fn around(&self, part: &Part) -> TimeSpan {
        let reach = self.period_ns.saturating_mul(PAUSE);
        TimeSpan::new(part.span.start.0.saturating_sub(reach), part.span.end.0.saturating_add(reach))
    }

    /// How much of a span is near frames, ns.
    fn near_ns(&self, span: TimeSpan) -> i64 {
        let (mut near, mut until) = (0i64, span.start.0);
        for part in &self.parts {
            let around = self.around(part);
            let (from, to) = (around.start.0.max(until), around.end.0.min(span.end.0));
            if to > from {
                near = near.saturating_add(to.saturating_sub(from));
                until = to;
            }
        }
        near
    }

    /// Why work over a span would mostly be work where no frames are near, with the parts that have some;
    /// `None` where at least a quarter of it is near frames.
    pub fn refuses(&self, span: TimeSpan) -> Option<String> {
        let (length, near) = (span.end.0.saturating_sub(span.start.0), self.near_ns(span));
        if self.parts.is_empty() || length / SPARSE <= near {
            return None;
        }
        let share = 100.0 * near as f64 / length as f64;
        let listed: Vec<String> = self
            .parts
            .iter()
            .take(LISTED)
            .map(|part| format!("{} to {}", in_seconds(part.span.start.0), in_seconds(part.span.end.0)))
            .collect();
        let more = if self.parts.len() > LISTED {
            format!(" and {} more", self.parts.len() - LISTED)
        } else {
            String::new()
        };
        let (from, to) = (in_seconds(span.start.0), in_seconds(span.end.0));
        Some(format!(
            "the recording lasts from {from} to {to}, and {share:.2} % of that has frames near; \
                      frames are at {}{more}",
            listed.join(", ")
        ))
    }

    /// The window that holds the fullest part, as parameters of a reader: `start = "0 s"`, `end = "1.5 s"`.
    pub fn window(&self) -> Option<String> {
        let part = self.fullest()?;
        Some(format!(
            "start = \"{}\", end = \"{}\"",
            in_seconds(part.span.start.0.max(0)),
            in_seconds(part.span.end.0)
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Exposure;

    const MS: i64 = 1_000_000;

    fn times(starts_ms: impl IntoIterator<Item = i64>) -> FrameTimes {
        FrameTimes::new(
            starts_ms.into_iter().map(|start| Exposure::new(start * MS, (start + 10) * MS)).collect(),
            0,
        )
        .unwrap()
    }

    fn film(pause_ms: i64) -> FrameTimes {
        times((0..8).map(|l| 20 * l).chain((8..15).map(|l| 20 * l + pause_ms)))
    }

    #[test]
    fn a_pause_parts_a_film_and_dropped_frames_do_not() {
        let coverage = Coverage::of(&film(600_000), 72);
        assert_eq!(coverage.period_ns, 20 * MS);
        assert_eq!(coverage.parts.iter().map(|part| part.frames.clone()).collect::<Vec<_>>(), [0..8, 8..15]);
        assert_eq!(coverage.fullest().unwrap().span, TimeSpan::new(0, 150 * MS));
        assert_eq!(Coverage::of(&film(280), 72).parts.len(), 1);
    }

    #[test]
    fn time_that_is_mostly_without_frames_is_refused_with_the_parts_that_have_some() {
        let coverage = Coverage::of(&film(600_000), 72);
        let why = coverage.refuses(TimeSpan::new(0, 600_300 * MS)).unwrap();
        assert!(
            why.contains("from 0 s to 600.3 s")
                && why.contains("frames are at 0 s to 0.15 s, 600.16 s to 600.29 s"),
            "{why}"
        );
        assert_eq!(coverage.window().unwrap(), "start = \"0 s\", end = \"0.15 s\"");
        // One second: two thirds of it are near frames.
        assert_eq!(Coverage::of(&film(1_000), 72).refuses(TimeSpan::new(0, 1_300 * MS)), None);
        // Stray events half an hour later, and before.
        let whole = Coverage::of(&film(0), 72);
        assert!(
            whole.refuses(TimeSpan::new(0, 1_702_000 * MS)).is_some()
                && whole.refuses(TimeSpan::new(-60_000 * MS, 300 * MS)).is_some()
        );
        assert_eq!(whole.refuses(TimeSpan::new(-300 * MS, 600 * MS)), None);
    }

    #[test]
    fn one_exposure_of_seconds_among_short_ones_covers_no_seconds() {
        let exposure = |start: i64, end: i64| Exposure::new(start * MS, end * MS);
        let times = FrameTimes::new(
            vec![exposure(0, 10), exposure(20, 30), exposure(40, 17_000), exposure(60, 70)],
            0,
        )
        .unwrap();
        let coverage = Coverage::of(&times, 1);
        assert_eq!(coverage.parts[0].span, TimeSpan::new(0, 40 * MS + 16 * 20 * MS));
        assert!(coverage.refuses(TimeSpan::new(0, 17_000 * MS)).is_some());
    }

    #[test]
    fn few_frames_state_no_period() {
        // An hour between two frames of 10 ms: each is a part of its own.
        let coverage = Coverage::of(&times([0, 3_600_000]), 72);
        assert!(
            coverage.refuses(TimeSpan::new(0, 3_600_010 * MS)).is_some() || coverage.period_ns <= 10_000 * MS
        );
        let single = Coverage::of(&times([0]), 72);
        assert_eq!(single.refuses(TimeSpan::new(0, 10_000 * MS)), None);
        assert!(single.refuses(TimeSpan::new(0, 3_600_000 * MS)).is_some());
        assert_eq!(Coverage::of(&times([]), 72).refuses(TimeSpan::new(0, i64::MAX)), None);
        assert!(single.refuses(TimeSpan::new(i64::MIN, i64::MAX)).is_some());
    }
}
