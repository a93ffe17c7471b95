//! One interval between two knots: how fast the front end settles in it, and which settled voltage makes a
//! given step.
//!
//! Forward, a settled voltage `u` at the interval's end moves the front end by `d = gamma (u - V)`, Eq. (1).
//! The solver works with the steps `d` as unknowns, so it needs the inverse. With the time constant of the
//! interval's start, gamma is known and that is a division. With the end's, gamma depends on `u` itself and
//! one scalar equation is solved.
//!
//! A surprise: that equation is monotone only down to a *fold*. A darker target is further away but also
//! slower to approach, so the fall per interval has a largest value; a step beyond it does not exist
//! (measured steps stretched by readout compensation do ask for it). In closed form, with `y = dt / tau(u)`
//! and `q = (alpha / i) / tau`, the slope has the sign of `(e^y - 1) / y - q (V - u)`, which grows with `u`:
//! one fold, and a unique solution above it. [`reach_step`] returns the fold when asked for more.
//!
//! Below the fold lies a second, darker solution for every step that exists. It is an artefact of the linear
//! low-pass (a darker pixel cannot fall more slowly), and it fools the cost: on reference problem 8 it
//! reaches 39.75, under the published optimum of 48.21, with two knots e^2 too dark. The search therefore
//! never goes beyond a fold.

use super::problem::{LOG_PHOTOCURRENT_MAX, LOG_PHOTOCURRENT_MIN};
use crate::front_end::{FrontEnd, settled_photocurrent, settling, time_constant};

/// Every so many trials the bracket is halved, so that it shrinks whatever Newton does.
const BISECT_EVERY: usize = 5;
/// Enough halvings to shrink the widest bracket to rounding.
const TRIALS: usize = 60 * BISECT_EVERY;

/// No fall is larger: the whole range of log photocurrents is 80.
const IMPOSSIBLE_FALL: f64 = -1e3;

/// How gamma of one interval depends on the log photocurrent that sets its time constant.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Settling {
    /// gamma, Eq. (2), 0 to 1.
    pub gamma: f64,
    /// First derivative by the log photocurrent, not negative: brighter is faster.
    pub slope: f64,
    /// Second derivative.
    pub curvature: f64,
}

/// gamma over `dt_s` at `photocurrent`, with derivatives.
pub(super) fn settling_at(front_end: &FrontEnd, photocurrent: f64, dt_s: f64) -> Settling {
    let tau = time_constant(front_end, photocurrent);
    let gamma = settling(dt_s, tau);
    if front_end.alpha_s == 0.0 {
        return Settling { gamma, slope: 0.0, curvature: 0.0 };
    }
    let y = dt_s / tau;
    // The light-dependent share of tau; d tau / du = -q tau, and dq / du = -q (1 - q).
    let q = front_end.alpha_s / (photocurrent * tau);
    let slope = (1.0 - gamma) * y * q;
    Settling { gamma, slope, curvature: slope * (2.0 * q - 1.0 - y * q) }
}

/// What [`reach_step`] found.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reached {
    /// Log photocurrent at the interval's end.
    pub u: f64,
    /// The step made: the one asked for, or the largest fall that exists.
    pub step: f64,
}

/// The log photocurrent at the interval's end that moves the front end by `step` from `voltage`, with the
/// time constant of that same photocurrent ([`crate::front_end::TauRule::End`]).
///
/// Solved to full precision by Newton's method inside a shrinking bracket; `guess` only saves iterations. A
/// fall that does not exist gives the fold and its step.
pub(super) fn reach_step(front_end: &FrontEnd, voltage: f64, step: f64, dt_s: f64, guess: f64) -> Reached {
    // A rise is at least one whole step, since gamma is at most 1. A fall may not exist, so only the start
    // bounds it.
    let (mut low, mut high) = if step > 0.0 {
        (voltage + step, LOG_PHOTOCURRENT_MAX + 1.0)
    } else {
        (LOG_PHOTOCURRENT_MIN - 1.0, voltage)
    };
    let is_inside = |u: f64, low: f64, high: f64| u > low && u < high;
    let mut u = guess;
    if front_end.alpha_s == 0.0 || step == 0.0 || !is_inside(u, low, high) {
        // The target if gamma stayed the start's: exact without a light-dependent part.
        let at_start = settling(dt_s, time_constant(front_end, settled_photocurrent(voltage)));
        u = voltage + step / at_start;
    }
    let is_empty = low >= high || (low + high).is_nan();
    if front_end.alpha_s == 0.0 || step == 0.0 || is_empty {
        return Reached { u, step };
    }
    if !is_inside(u, low, high) {
        u = 0.5 * (low + high);
    }
    let mut fold = Reached { u: high, step: 0.0 };
    for trial in 0..TRIALS {
        let at = settling_at(front_end, settled_photocurrent(u), dt_s);
        let drive = u - voltage;
        let excess = at.gamma * drive - step;
        let slope = at.gamma + at.slope * drive;
        if slope <= 0.0 || excess < 0.0 {
            low = u; // beyond the fold, or below the solution
        } else {
            high = u;
            fold = Reached { u, step: at.gamma * drive };
        }
        let newton = u - excess / slope;
        // Newton's error after this step is about the square of the step: below rounding.
        if slope > 0.0 && (newton - u).abs() <= 1e-8 {
            return Reached { u: newton, step };
        }
        // Where Newton leaves the bracket there may be no solution: look for the fold, the root of the slope.
        let bend = 2.0 * at.slope + at.curvature * drive;
        let towards_fold = u - slope / bend;
        if step < 0.0 && excess > 0.0 && (towards_fold - u).abs() <= 1e-12 {
            return Reached { u, step: at.gamma * drive };
        }
        u = if trial % BISECT_EVERY == BISECT_EVERY - 1 {
            0.5 * (low + high)
        } else if slope > 0.0 && is_inside(newton, low, high) {
            newton
        } else if is_inside(towards_fold, low, high) {
            towards_fold
        } else {
            0.5 * (low + high)
        };
        if !is_inside(u, low, high) {
            break;
        }
    }
    fold
}

/// The largest fall from `voltage` that exists, with the time constant of the interval's end.
pub(super) fn fold(front_end: &FrontEnd, voltage: f64, dt_s: f64, guess: f64) -> Reached {
    reach_step(front_end, voltage, IMPOSSIBLE_FALL, dt_s, guess)
}

#[cfg(test)]
mod tests {
    use super::*;

    const INDOOR: FrontEnd = FrontEnd { tau_0_s: 30e-6, alpha_s: 1e-4 };

    fn step_of(front_end: &FrontEnd, voltage: f64, u: f64, dt_s: f64) -> f64 {
        settling_at(front_end, settled_photocurrent(u), dt_s).gamma * (u - voltage)
    }

    #[test]
    fn derivatives_of_gamma_match_central_differences() {
        for u in [-4.0, -2.0, -0.5, 1.0] {
            for dt_s in [1e-5, 2e-4, 3e-3] {
                let h = 1e-5;
                let (at, below, above) = (
                    settling_at(&INDOOR, settled_photocurrent(u), dt_s),
                    settling_at(&INDOOR, settled_photocurrent(u - h), dt_s),
                    settling_at(&INDOOR, settled_photocurrent(u + h), dt_s),
                );
                assert!((at.slope - (above.gamma - below.gamma) / (2.0 * h)).abs() < 1e-9);
                assert!((at.curvature - (above.slope - below.slope) / (2.0 * h)).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_reached_step_is_the_step_asked_for() {
        for voltage in [-3.0, -1.0, 0.5] {
            for dt_s in [3e-5, 4e-4, 1e-2] {
                for u in [voltage - 0.3, voltage - 0.01, voltage + 0.01, voltage + 2.0, voltage + 5.0] {
                    let step = step_of(&INDOOR, voltage, u, dt_s);
                    for guess in [f64::NAN, voltage, u + 0.2, 30.0] {
                        let reached = reach_step(&INDOOR, voltage, step, dt_s, guess);
                        assert!((reached.u - u).abs() < 1e-10, "{} instead of {u}", reached.u);
                        assert_eq!(reached.step, step);
                    }
                }
            }
        }
    }

    #[test]
    fn a_fall_that_does_not_exist_stops_at_the_fold() {
        let (voltage, dt_s) = (-2.0, 1e-4);
        let reached = reach_step(&INDOOR, voltage, -1.0, dt_s, voltage);
        let at = settling_at(&INDOOR, settled_photocurrent(reached.u), dt_s);
        assert!((at.gamma + at.slope * (reached.u - voltage)).abs() < 1e-9, "the slope vanishes at the fold");
        assert!(reached.step > -1.0);
        assert!(reached.u > voltage - 2.0 && reached.u < voltage, "about one natural-log unit down");
        for aside in [-0.1, 0.1] {
            assert!(step_of(&INDOOR, voltage, reached.u + aside, dt_s) > reached.step);
        }
    }

    #[test]
    fn a_huge_fall_out_of_the_dark_stops_at_the_fold_too() {
        // gamma is 1e-6 here, so the linear guess lies far out of range.
        let reached = reach_step(&INDOOR, -5.0, -4.0, 1.5e-8, f64::NAN);
        assert!(reached.u > -7.0 && reached.u < -5.5, "{}", reached.u);
        assert!(reached.step < 0.0 && reached.step > -1e-5);
    }

    #[test]
    fn no_step_means_the_settled_voltage_is_the_voltage() {
        assert_eq!(reach_step(&INDOOR, -1.5, 0.0, 1e-4, 0.0).u, -1.5);
    }

    #[test]
    fn an_ideal_front_end_reaches_exactly_its_target() {
        let reached = reach_step(&FrontEnd::IDEAL, -1.0, 0.25, 1e-4, 0.0);
        assert_eq!((reached.u, reached.step), (-0.75, 0.25));
    }
}
