//! What a pixel's neighbours say about its light: their tracks, carried along the motion.
//!
//! What passes a pixel now passed the next pixel line a moment ago, and will pass the one on the other side a moment later. So log light
//! is read off where the path crosses the next [`LINES`] lines of pixels, backward and forward, never at the pixel itself and never more than
//! [`LONGEST_MS`] away. How far that may be believed is measured twice: by how much the past and the future contradict each other, and by how
//! much they contradict the pixel's own events and frames. Both can only widen the error.

use super::film::LogTracks;
use super::flow::Flow;
use photocurrent_sensor::map::{Hint, MapEvent, MapFrame};

/// Pixel lines that are looked at on either side.
const LINES: usize = 3;
/// What each of them weighs.
const LINE_WEIGHTS: [f64; LINES] = [1.0, 0.7, 0.5];
/// Longest time between a pixel and its neighbour's answer, ms.
const LONGEST_MS: f64 = 12.0;
/// No hint is better than this, natural-log units.
const FLOOR: f64 = 0.01;
/// Neighbouring hints err together: each counts as if its variance were so many times as large.
const TOGETHER: f64 = 4.0;
/// Contradictions are pooled over this time, ms.
const POOLED_MS: f64 = 3.0;
/// And over this, to see whether there is anything in the hints at all.
const WIDE_MS: f64 = 15.0;
/// A track counts half so long after or before an event of its pixel, ms.
const FRESH_MS: f64 = 1.5;
/// And never less than one part in so many and one.
const STALEST: f64 = 15.0;
/// What a frame weighs beside an event when a pixel judges its hints.
const FRAME_WEIGHT: f64 = 3.0;
/// One side alone can contradict nobody: its variance counts so many times.
const ONE_SIDED: f64 = 4.0;

/// What the neighbours say at one instant.
#[derive(Clone, Copy, Debug)]
struct Said {
    t_ns: i64,
    log: f64,
    /// Half the difference between future and past, squared, where both exist.
    contradiction: Option<f64>,
}

/// Collects hints; keeps its memory from pixel to pixel.
#[derive(Default)]
pub(super) struct Advection {
    said: Vec<Said>,
    own: Vec<(i64, f64, f64)>,
}

impl Advection {
    /// The hints of a pixel every `step_ns` of `span`, in order of time; none where nothing moves or the pixel disagrees.
    ///
    /// `threshold` is how exactly the pixel knows its light by itself, natural-log units.
    #[expect(clippy::too_many_arguments, reason = "a pixel and all that surrounds it")]
    pub fn hints(
        &mut self,
        tracks: &LogTracks,
        flow: &Flow,
        (x, y): (usize, usize),
        span: (i64, i64),
        step_ns: i64,
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
            if let Some(said) = neighbours(tracks, flow, x, y, span, t_ns) {
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
            // By itself a pixel knows its light to a threshold or so: who misses it by as much where it is known has nothing to say.
            let wide = pooled(&mut self.own.iter().copied(), 0.1, WIDE_MS);
            let trust = 1.0 - f64::max(own, wide) / (threshold * threshold);
            if trust <= 0.0 {
                continue;
            }
            let mut variance = FLOOR * FLOOR + contradiction + own;
            variance += said.contradiction.unwrap_or(variance * (ONE_SIDED - 1.0));
            hints.push(Hint { t_ns: said.t_ns, log_photocurrent: said.log, variance: TOGETHER * variance / (trust * trust) });
        }
    }

    /// Squared contradictions to the pixel itself, where it knows its light: at its events and over its exposures.
    fn judge(&mut self, tracks: &LogTracks, (x, y): (usize, usize), step_ns: i64, events: &[MapEvent], frames: &[MapFrame]) {
        let Advection { said, own } = self;
        own.clear();
        let difference = |s: &Said| tracks.at(x, y, s.t_ns).map_or(0.0, |own| s.log - own);
        let mut k = 0;
        for event in events {
            while k + 1 < said.len() && said[k + 1].t_ns <= event.t_in_ns {
                k += 1;
            }
            let Some(near) = said[k..].iter().take(2).min_by_key(|s| (s.t_ns - event.t_in_ns).abs()) else { continue };
            if (near.t_ns - event.t_in_ns).abs() <= step_ns {
                let d = difference(near);
                own.push((event.t_in_ns, d * d, 1.0));
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

/// Log light that past and future neighbours say; `None` where nothing moves.
fn neighbours(tracks: &LogTracks, flow: &Flow, x: usize, y: usize, span: (i64, i64), t_ns: i64) -> Option<Said> {
    let velocity = flow.at(x as f64, y as f64, t_ns);
    let side = |direction: f64| -> Option<(f64, f64)> {
        let (mut sum, mut weights) = (0.0, 0.0);
        for (k, line_weight) in LINE_WEIGHTS.iter().enumerate() {
            let Some((log, apart_ms)) = crossing(tracks, flow, x, y, span, t_ns, velocity, direction * (k + 1) as f64) else { break };
            let stale = apart_ms / FRESH_MS;
            let weight = line_weight / (1.0 + f64::min(stale * stale, STALEST));
            sum += weight * log;
            weights += weight;
        }
        (weights > 0.0).then(|| (sum / weights, weights))
    };
    match (side(-1.0), side(1.0)) {
        (Some((past, w0)), Some((future, w1))) => {
            let share = w1 / (w0 + w1);
            let apart = future - past;
            Some(Said { t_ns, log: past + share * apart, contradiction: Some(share * (1.0 - share) * apart * apart) })
        }
        (Some((log, _)), None) | (None, Some((log, _))) => Some(Said { t_ns, log, contradiction: None }),
        (None, None) => None,
    }
}

/// Log light where the path crosses the line `lines` further along the motion, and how many milliseconds away the nearest event of the pixels
/// there is; negative lines were crossed before.
#[expect(clippy::too_many_arguments, reason = "a pixel and all that surrounds it")]
fn crossing(tracks: &LogTracks, flow: &Flow, x: usize, y: usize, span: (i64, i64), t_ns: i64, velocity: [f64; 2], lines: f64) -> Option<(f64, f64)> {
    // Lines lie across the faster component.
    let axis = if velocity[0].abs() >= velocity[1].abs() { 0 } else { 1 };
    let allowed = |v: [f64; 2]| (lines / v[axis].abs()).abs() <= LONGEST_MS;
    if !allowed(velocity) {
        return None;
    }
    // The velocity halfway is that of the whole way to second order.
    let half_ms = 0.5 * lines / velocity[axis].abs();
    let middle = flow.at(x as f64 + velocity[0] * half_ms, y as f64 + velocity[1] * half_ms, t_ns + (half_ms * 1e6) as i64);
    if middle[axis] * velocity[axis] <= 0.0 || !allowed(middle) {
        return None;
    }
    let time_ms = lines / middle[axis].abs();
    let then_ns = t_ns + (time_ms * 1e6).round() as i64;
    if then_ns < span.0 || then_ns > span.1 {
        return None;
    }
    let here = [x as f64, y as f64];
    let size = [tracks.extent.width as usize, tracks.extent.height as usize];
    let line = here[axis] + lines * velocity[axis].signum();
    let along = here[1 - axis] + middle[1 - axis] * time_ms;
    if line < 0.0 || line > (size[axis] - 1) as f64 || along < 0.0 || along > (size[1 - axis] - 1) as f64 {
        return None;
    }
    let line = line as usize;
    let first = usize::min(along as usize, size[1 - axis].saturating_sub(2));
    let place = |k: i64| {
        let k = (first as i64 + k).clamp(0, size[1 - axis] as i64 - 1) as usize;
        if axis == 0 { (line, k) } else { (k, line) }
    };
    let read = |k: i64| {
        let (x, y) = place(k);
        tracks.at(x, y, then_ns)
    };
    let apart_ms = |k: i64| {
        let (x, y) = place(k);
        f64::min(tracks.fired.apart_ms(y * size[0] + x, then_ns), LONGEST_MS)
    };
    let s = along - first as f64;
    // The cubic through four pixels (Catmull and Rom).
    let [a, b, c, d] = [read(-1)?, read(0)?, read(1)?, read(2)?];
    let log = b + 0.5 * s * (c - a + s * (2.0 * a - 5.0 * b + 4.0 * c - d + s * (3.0 * (b - c) + d - a)));
    Some((log, (1.0 - s) * apart_ms(0) + s * apart_ms(1)))
}
