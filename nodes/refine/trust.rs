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
    own: Vec<(i64, f64, f64)>,
}

impl Trust {
    pub fn new(known: Known) -> Trust {
        Trust { known, said: Vec::new(), own: Vec::new() }
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
        self.judge(tracks, (x, y), step_ns, events, frames);
        for said in &self.said {
            let pooled = |list: &mut dyn Iterator<Item = (i64, f64, f64)>, start: f64, over_ms: f64| {
                let mut sum = (start * FLOOR * FLOOR, start);
                for (t, square, weight) in list {
                    let apart = (t - said.t_ns) as f64 * 1e-6 / over_ms;
                    let weight = weight / (1.0 + apart * apart * apart * apart);
                    sum = (sum.0 + weight * square, sum.1 + weight);
                }
                sum.0 / sum.1
            };
            let contradiction = pooled(&mut self.said.iter().filter_map(|s| s.contradiction.map(|c| (s.t_ns, c, 1.0))), 0.1, POOLED_MS);
            let own = pooled(&mut self.own.iter().copied(), 0.1, POOLED_MS);
            let wide = pooled(&mut self.own.iter().copied(), 0.1, WIDE_MS);
            let trust = 1.0 - BEYOND_TRUST * f64::max(own, wide) / (threshold * threshold);
            if trust <= 0.0 {
                continue;
            }
            let mut variance = FLOOR * FLOOR + contradiction + own;
            variance += said.contradiction.unwrap_or(variance * (ONE_SIDED - 1.0));
            hints.push(Hint { t_ns: said.t_ns, log_photocurrent: said.log, variance: TOGETHER * variance / (trust * trust) });
        }
    }

    /// Squared contradictions to the pixel itself, where it knows its light: at its events, and over exposures.
    fn judge(&mut self, tracks: &LogTracks, (x, y): (usize, usize), step_ns: i64, events: &[MapEvent], frames: &[MapFrame]) {
        let Trust { known, said, own } = self;
        own.clear();
        let difference = |s: &Said| tracks.at(x, y, s.t_ns).map_or(0.0, |own| s.log - own);
        let mut k = 0;
        let mut last: Option<(i64, f64)> = None;
        for event in events {
            while k + 1 < said.len() && said[k + 1].t_ns <= event.t_in_ns {
                k += 1;
            }
            let Some(near) = said[k..].iter().take(2).min_by_key(|s| (s.t_ns - event.t_in_ns).abs()) else { continue };
            if (near.t_ns - event.t_in_ns).abs() <= step_ns {
                let d = difference(near);
                match (*known, last) {
                    (Known::Level, _) => own.push((event.t_in_ns, d * d, 1.0)),
                    (Known::Change, Some((before_ns, before))) => {
                        let change: f64 = d - before;
                        own.push(((event.t_in_ns + before_ns) / 2, 0.5 * change * change, 1.0));
                    }
                    (Known::Change, None) => {}
                }
                last = Some((event.t_in_ns, d));
            } else {
                last = None;
            }
        }
        for frame in frames.iter().filter(|frame| !frame.saturated) {
            let inside = said.iter().filter(|s| s.t_ns >= frame.start_ns && s.t_ns < frame.end_ns);
            let sum = inside.fold((0.0, 0.0), |(sum, n), s| (sum + difference(s), n + 1.0));
            if sum.1 > 0.0 {
                let d = sum.0 / sum.1;
                own.push(((frame.start_ns + frame.end_ns) / 2, d * d, FRAME_WEIGHT));
            }
        }
    }
}
