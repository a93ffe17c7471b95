//! How far a foretold light may be believed, and the hints that are left of it.
//!
//! Whoever foretells a pixel's light (its neighbours along the motion, a picture that moves) is measured twice: by how much two sources
//! contradict each other, and by how much they contradict the pixel's own events and frames. Both can only widen the error.

use super::film::LogTracks;
use photocurrent_sensor::map::{Hint, MapEvent, MapFrame};

/// No hint is better than this, natural-log units.
pub(super) const FLOOR: f64 = 0.01;
/// Neighbouring hints err together: each counts as if its variance were so many times as large.
const TOGETHER: f64 = 4.0;
/// Contradictions are pooled over this time, ms.
const POOLED_MS: f64 = 3.0;
/// And over this, to see whether there is anything in the hints at all.
const WIDE_MS: f64 = 15.0;
/// What a frame weighs beside an event when a pixel judges its hints.
const FRAME_WEIGHT: f64 = 3.0;
/// One source alone can contradict nobody: its variance counts so many times.
const ONE_SIDED: f64 = 4.0;

/// Nothing is said any more where contradictions reach one in so many squared thresholds: by itself a pixel knows its light to a threshold or so, and at
/// one, chance hits of pixels that have nothing to do with each other still cost 0.2 dB.
const BEYOND_TRUST: f64 = 2.0;

/// What is foretold may be late by so much, ms: steep edges err in their place, not in their height.
const LATE_MS: f64 = 0.05;

/// What is foretold for one instant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Said {
    pub t_ns: i64,
    pub log: f64,
    /// The variance that the contradiction of two sources shows, where there are two.
    pub contradiction: Option<f64>,
}

/// What a pixel's events know of its light, to judge hints by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Known {
    /// Its level at each event: careful, for the pixel itself may be wrong there.
    Level,
    /// How far it moved from each event to the next: that is a threshold, whatever the level.
    Change,
}

/// Collects hints.
pub(super) struct Trust {
    known: Known,
    said: Vec<Said>,
    /// The variance that each of them would have by itself: the floor, and what a small error of its place brings where light changes fast.
    expected: Vec<f64>,
    /// Instants, squared contradictions in terms of what was expected, weights.
    own: Vec<(i64, f64, f64)>,
}

impl Trust {
    pub fn new(known: Known) -> Trust {
        Trust { known, said: Vec::new(), expected: Vec::new(), own: Vec::new() }
    }

    /// The hints of a pixel every `step_ns` of `span`, in order of time, out of what `say` foretells; none where it has nothing to say, or the
    /// pixel disagrees.
    ///
    /// `threshold` is how exactly the pixel knows its light by itself, natural-log units.
    #[expect(clippy::too_many_arguments, reason = "a pixel and all that surrounds it")]
    pub fn hints(
        &mut self,
        say: impl Fn(i64) -> Option<Said>,
        tracks: &LogTracks,
        (x, y): (usize, usize),
        (span, step_ns): ((i64, i64), i64),
        events: &[MapEvent],
        frames: &[MapFrame],
        threshold: f64,
        hints: &mut Vec<Hint>,
    ) {
        hints.clear();
        self.said.clear();
        if events.is_empty() {
            return;
        }
        let mut t_ns = span.0 + step_ns / 2;
        while t_ns < span.1 {
            if let Some(said) = say(t_ns) {
                self.said.push(said);
            }
            t_ns += step_ns;
        }
        self.expect(step_ns);
        self.judge(tracks, (x, y), step_ns, events, frames);
        for (said, expected) in self.said.iter().zip(&self.expected) {
            let pooled = |list: &mut dyn Iterator<Item = (i64, f64, f64)>, start: f64, over_ms: f64| {
                let mut sum = (start, start);
                for (t, square, weight) in list {
                    let apart = (t - said.t_ns) as f64 * 1e-6 / over_ms;
                    let weight = weight / (1.0 + apart * apart * apart * apart);
                    sum = (sum.0 + weight * square, sum.1 + weight);
                }
                sum.0 / sum.1
            };
            let contradiction = pooled(&mut self.said.iter().filter_map(|s| s.contradiction.map(|c| (s.t_ns, c / (FLOOR * FLOOR), 1.0))), 0.1, POOLED_MS);
            let contradiction = FLOOR * FLOOR * contradiction;
            let own = expected * pooled(&mut self.own.iter().copied(), 0.1, POOLED_MS);
            let wide = expected * pooled(&mut self.own.iter().copied(), 0.1, WIDE_MS);
            let trust = 1.0 - BEYOND_TRUST * f64::max(own, wide) / (threshold * threshold);
            if trust <= 0.0 {
                continue;
            }
            let mut variance = expected + contradiction + own;
            variance += said.contradiction.unwrap_or(variance * (ONE_SIDED - 1.0));
            hints.push(Hint { t_ns: said.t_ns, log_photocurrent: said.log, variance: TOGETHER * variance / (trust * trust) });
        }
    }

    /// What each hint may err by.
    fn expect(&mut self, step_ns: i64) {
        let Trust { known, said, expected, .. } = self;
        let late_ms = if *known == Known::Change { LATE_MS } else { 0.0 };
        let variance = |k: usize| {
            let (before, after) = (&said[k.saturating_sub(1)], &said[usize::min(k + 1, said.len() - 1)]);
            let apart_ns = after.t_ns - before.t_ns;
            let slope = if apart_ns > 0 && apart_ns <= 2 * step_ns { (after.log - before.log) / (apart_ns as f64 * 1e-6) } else { 0.0 };
            let off = slope * late_ms;
            FLOOR * FLOOR + off * off
        };
        expected.clear();
        expected.extend((0..said.len()).map(variance));
    }

    /// Squared contradictions to the pixel itself, where it knows its light: at its events, and over exposures.
    fn judge(&mut self, tracks: &LogTracks, (x, y): (usize, usize), step_ns: i64, events: &[MapEvent], frames: &[MapFrame]) {
        let Trust { known, said, expected, own } = self;
        own.clear();
        let difference = |s: &Said| tracks.at(x, y, s.t_ns).map_or(0.0, |own| s.log - own);
        let mut k = 0;
        let mut last: Option<(i64, f64, f64)> = None;
        for event in events {
            while k + 1 < said.len() && said[k + 1].t_ns <= event.t_in_ns {
                k += 1;
            }
            let Some(at) = (k..usize::min(k + 2, said.len())).min_by_key(|&k| (said[k].t_ns - event.t_in_ns).abs()) else { continue };
            let near = &said[at];
            if (near.t_ns - event.t_in_ns).abs() <= step_ns {
                let d = difference(near);
                match (*known, last) {
                    (Known::Level, _) => own.push((event.t_in_ns, d * d / expected[at], 1.0)),
                    (Known::Change, Some((before_ns, before, variance))) => {
                        let change: f64 = d - before;
                        own.push(((event.t_in_ns + before_ns) / 2, change * change / (variance + expected[at]), 1.0));
                    }
                    (Known::Change, None) => {}
                }
                last = Some((event.t_in_ns, d, expected[at]));
            } else {
                last = None;
            }
        }
        for frame in frames.iter().filter(|frame| !frame.saturated) {
            let inside = said.iter().filter(|s| s.t_ns >= frame.start_ns && s.t_ns < frame.end_ns);
            let sum = inside.fold((0.0, 0.0), |(sum, n), s| (sum + difference(s), n + 1.0));
            if sum.1 > 0.0 {
                let d = sum.0 / sum.1;
                // An edge that is a little late changes little over an exposure: a frame allows for the floor alone.
                own.push(((frame.start_ns + frame.end_ns) / 2, d * d / (FLOOR * FLOOR), FRAME_WEIGHT));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refine::film::Fired;
    use photocurrent_core::{Extent, TrackBand};
    use std::sync::Arc;

    const EXTENT: Extent = Extent { width: 1, height: 1 };

    /// Dark and bright by turns, 6 ms each; from one to the other in half a millisecond.
    fn squares(ms: f64) -> f64 {
        let place = (ms / 12.0).fract();
        let up = (place * 24.0).clamp(0.0, 1.0);
        let down = ((place - 0.5) * 24.0).clamp(0.0, 1.0);
        2.0 * (up - down)
    }

    /// Of a pixel that sees these squares, when they are foretold late and too bright.
    fn hints(late_ms: f64, brighter: f64) -> Vec<Hint> {
        let mut band = TrackBand::begin(0, 1);
        let knots: Vec<(i64, f32)> = (0..=480).map(|n| (n * 100_000, libm::exp(squares(n as f64 * 0.1)) as f32)).collect();
        band.push(knots.iter().copied());
        let tracks = LogTracks::new(EXTENT, &band, &Arc::new(Fired::new(std::iter::empty())));
        let edges = (0..8).flat_map(|edge| [0.1, 0.2, 0.3, 0.4].map(|ms| ((6.0 * f64::from(edge) + ms) * 1e6) as i64));
        let event = |t_in_ns: i64| MapEvent { t_in_ns, t_off_ns: t_in_ns + 1_000, polarity: 1, is_lone: false };
        let events: Vec<MapEvent> = edges.map(event).collect();
        let frames: Vec<MapFrame> =
            (0..5).map(|l| MapFrame { start_ns: l * 9_000_000, end_ns: l * 9_000_000 + 6_000_000, dn: 100.0, sigma_dn: 1.0, saturated: false }).collect();
        let say = |t_ns: i64| Some(Said { t_ns, log: squares(t_ns as f64 * 1e-6 - late_ms + 12.0) + brighter, contradiction: Some(0.0) });
        let mut hints = Vec::new();
        Trust::new(Known::Change).hints(say, &tracks, (0, 0), ((0, 48_000_000), 250_000), &events, &frames, 0.2, &mut hints);
        hints
    }

    #[test]
    fn edges_that_come_a_little_late_leave_what_lies_between_them_trusted() {
        let hints = hints(0.04, 0.0);
        let between = |hint: &&Hint| (2.0..5.0).contains(&(hint.t_ns as f64 * 1e-6 % 6.0));
        let (flat, steep): (Vec<&Hint>, Vec<&Hint>) = hints.iter().partition(between);
        // Four edges of eight bound at least eighteen milliseconds of rest, asked four times a millisecond.
        assert!(flat.len() > 72, "{}", flat.len());
        let worst = flat.iter().map(|hint| hint.variance).fold(0.0, f64::max);
        assert!(worst < 0.1 * 0.1, "{worst}");
        // Where they are steep they are off by up to 0.16.
        assert!(steep.iter().all(|hint| (hint.log_photocurrent - squares(hint.t_ns as f64 * 1e-6)).abs() < 1e-6 || hint.variance > 2.0 * FLOOR * FLOOR));
    }

    #[test]
    fn what_is_too_bright_over_exposures_is_not_trusted() {
        assert!(hints(0.0, 0.3).is_empty());
        assert!(!hints(0.0, 0.0).is_empty());
    }
}
