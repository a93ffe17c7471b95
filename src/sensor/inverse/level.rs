//! The closed form: measured steps through an ideal front end, at the level that fits the frames best.
//!
//! With `V_FE = V_DC` the photocurrent is `e^level * exp(sum of steps)`, so every digital number is
//! proportional to `e^level` and the best level is one weighted mean. This is the event-based double integral
//! (EDI); it starts the iteration, and it is the double-integral estimate of a pixel that does not converge.
//! For a pixel without events it is the exact solution.

use super::overlap::Overlap;
use super::problem::{LOG_PHOTOCURRENT_MAX, LOG_PHOTOCURRENT_MIN, PixelProblem};

/// Fills `log_photocurrent` (one per knot, at least one); returns whether the frames are brighter than black.
///
/// A pixel at or below black has no level: every value is then [`LOG_PHOTOCURRENT_MIN`].
pub(super) fn fit_level(
    problem: &PixelProblem<'_>,
    overlap: &Overlap,
    log_photocurrent: &mut Vec<f64>,
) -> bool {
    log_photocurrent.clear();
    log_photocurrent.push(0.0);
    let (mut sum, mut largest) = (0.0, 0.0);
    for step in problem.steps.iter().skip(1) {
        sum += step;
        largest = if sum > largest { sum } else { largest };
        log_photocurrent.push(sum);
    }
    // Relative to the brightest knot, so that a long run of one polarity cannot overflow the exponential.
    let (mut along, mut square) = (0.0, 0.0);
    for (l, frame) in problem.frames.iter().enumerate() {
        let held = overlap.row(l).iter().zip(log_photocurrent.iter());
        let per_unit: f64 = held.map(|(seconds, u)| problem.gain * seconds * libm::exp(u - largest)).sum();
        along += frame.weight * per_unit * (frame.dn - problem.black_level);
        square += frame.weight * per_unit * per_unit;
    }
    let unit = along / square;
    let level = if unit > 0.0 { libm::log(unit) - largest } else { f64::NEG_INFINITY };
    for u in log_photocurrent.iter_mut() {
        let raised = *u + level;
        *u = raised.clamp(LOG_PHOTOCURRENT_MIN, LOG_PHOTOCURRENT_MAX);
    }
    unit > 0.0
}
