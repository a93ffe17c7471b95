//! Predicts a pixel's light from its neighbours' tracks, carried along the motion.
//!
//! What passes a pixel now passed the last line of pixels a moment ago, and will pass the next one a moment
//! later. So log light is read where the path crosses the next [`LINES`] lines of pixels, backward and
//! forward, never at the pixel itself and never more than `longest` away. Its variance is estimated by
//! [`PseudoMeasurements`](crate::refine::pseudo_measurement::PseudoMeasurements): past and future must agree.
//! Where another motion explains the place nearly as well, its prediction is evaluated too, and the
//! difference of the two is an ambiguity variance.

use crate::refine::pseudo_measurement::PredictedLight;
use photocurrent_scene::film::LogTracks;
use photocurrent_scene::flow::{Flow, MotionParams};

/// Lines of pixels that are evaluated on either side.
const LINES: usize = 3;
/// Velocities that differ by less are the same, pixels per millisecond.
const ALIKE: f64 = 0.02;
/// Weights of the lines.
const LINE_WEIGHTS: [f64; LINES] = [1.0, 0.7, 0.5];
/// Log light predicted by past and future neighbours; `None` where nothing moves.
pub(in crate::refine) fn neighbours(
    tracks: &LogTracks,
    (flow, params, ambiguity): (&Flow, &MotionParams, f64),
    (x, y): (usize, usize),
    span: (i64, i64),
    t_ns: i64,
) -> Option<PredictedLight> {
    let own = predict_along_motion(tracks, (&|x, y, t_ns| flow.at(x, y, t_ns), params), (x, y), span, t_ns)?;
    if ambiguity == 0.0 {
        return Some(own);
    }
    let (here, there) = (flow.at(x as f64, y as f64, t_ns), flow.rival_at(x as f64, y as f64, t_ns));
    if libm::hypot(here[0] - there[0], here[1] - there[1]) < ALIKE {
        return Some(own);
    }
    // What explains the place as well predicts something else, perhaps; where that is that nothing moves, it
    // is the pixel's own track.
    let rival =
        predict_along_motion(tracks, (&|x, y, t_ns| flow.rival_at(x, y, t_ns), params), (x, y), span, t_ns)
            .map(|predicted| predicted.log)
            .or_else(|| tracks.at(x, y, t_ns));
    let apart = rival.map_or(0.0, |rival| rival - own.log);
    Some(PredictedLight { ambiguity: ambiguity * apart * apart, ..own })
}

/// Log light predicted by past and future neighbours along a motion.
fn predict_along_motion(
    tracks: &LogTracks,
    (flow, params): (&dyn Fn(f64, f64, i64) -> [f64; 2], &MotionParams),
    (x, y): (usize, usize),
    span: (i64, i64),
    t_ns: i64,
) -> Option<PredictedLight> {
    let (fresh_ms, longest_ms) = (params.fresh.ns() as f64 * 1e-6, params.longest.ns() as f64 * 1e-6);
    let velocity = flow(x as f64, y as f64, t_ns);
    let side = |direction: f64| -> Option<(f64, f64)> {
        let (mut sum, mut weights) = (0.0, 0.0);
        for (k, line_weight) in LINE_WEIGHTS.iter().enumerate() {
            let Some((log, apart_ms)) =
                crossing(tracks, flow, (x, y), span, longest_ms, t_ns, velocity, direction * (k + 1) as f64)
            else {
                break;
            };
            let stale = apart_ms / fresh_ms;
            let weight = line_weight / (1.0 + f64::min(stale * stale, params.stalest));
            sum += weight * log;
            weights += weight;
        }
        (weights > 0.0).then(|| (sum / weights, weights))
    };
    match (side(-1.0), side(1.0)) {
        (Some((past, w0)), Some((future, w1))) => {
            let share = w1 / (w0 + w1);
            let apart = future - past;
            Some(PredictedLight {
                t_ns,
                log: past + share * apart,
                innovation: Some(share * (1.0 - share) * apart * apart),
                ambiguity: 0.0,
            })
        }
        (Some((log, _)), None) | (None, Some((log, _))) => {
            Some(PredictedLight { t_ns, log, innovation: None, ambiguity: 0.0 })
        }
        (None, None) => None,
    }
}

/// Log light where the path crosses the line `lines` further along the motion, and how many milliseconds away
/// the nearest event of the pixels there is; negative lines were crossed before.
fn crossing(
    tracks: &LogTracks,
    flow: &dyn Fn(f64, f64, i64) -> [f64; 2],
    (x, y): (usize, usize),
    span: (i64, i64),
    longest_ms: f64,
    t_ns: i64,
    velocity: [f64; 2],
    lines: f64,
) -> Option<(f64, f64)> {
    // Lines lie across the faster component.
    let axis = if velocity[0].abs() >= velocity[1].abs() { 0 } else { 1 };
    let allowed = |v: [f64; 2]| (lines / v[axis].abs()).abs() <= longest_ms;
    if !allowed(velocity) {
        return None;
    }
    // The velocity halfway is that of the whole way to second order.
    let half_ms = 0.5 * lines / velocity[axis].abs();
    let middle = flow(
        x as f64 + velocity[0] * half_ms,
        y as f64 + velocity[1] * half_ms,
        t_ns + (half_ms * 1e6) as i64,
    );
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
        f64::min(tracks.fired.apart_ms(y * size[0] + x, then_ns), longest_ms)
    };
    let s = along - first as f64;
    // The cubic through four pixels (Catmull and Rom).
    let [a, b, c, d] = [read(-1)?, read(0)?, read(1)?, read(2)?];
    let log = b + 0.5 * s * (c - a + s * (2.0 * a - 5.0 * b + 4.0 * c - d + s * (3.0 * (b - c) + d - a)));
    Some((log, (1.0 - s) * apart_ms(0) + s * apart_ms(1)))
}
