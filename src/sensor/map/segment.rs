//! One segment between two knots: log light is a straight line, and everything that follows from that in closed form.
//!
//! Voltage: the low-pass of Eq. (1) driven by a ramp, with the time constant of the segment's middle (in log light). Exposure: the
//! integral of an exponential. Both come with their derivatives by the two ends; the formulas are checked against dual numbers.

use crate::exposure::{log_linear_mean, log_linear_mean_by_end};
use crate::front_end::{FrontEnd, settled_photocurrent, settling, time_constant};
use crate::scalar::Scalar;

/// The shortest time constant that is divided by, seconds: stands for the ideal front end's zero.
const TAU_FLOOR_S: f64 = 1e-30;

/// The voltage after `length_s` of log light rising from `first` to `last`, from `voltage` on.
///
/// `V1 = E V0 + (g - E) u0 + (1 - g) u1` with `E = exp(-h / tau)` and `g = (1 - E) tau / h`: the exact answer for a constant tau,
/// which is taken at the middle log light.
pub fn ramp_voltage<S: Scalar>(front_end: &FrontEnd<S>, voltage: S, first: S, last: S, length_s: S) -> S {
    let middle = settled_photocurrent((first + last) * S::from_f64(0.5));
    let tau_s = time_constant(front_end, middle).max(S::from_f64(TAU_FLOOR_S));
    let settled = settling(length_s, tau_s);
    let lag = settled * tau_s / length_s;
    voltage + settled * (first - voltage) + (S::from_f64(1.0) - lag) * (last - first)
}

/// A segment's voltage at its end, and its derivatives.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Ramp {
    pub voltage: f64,
    /// By the voltage at the start.
    pub by_voltage: f64,
    /// By the log light at the start.
    pub by_first: f64,
    /// By the log light at the end.
    pub by_last: f64,
}

impl Ramp {
    /// The value of [`ramp_voltage`] with its derivatives.
    pub fn new(front_end: &FrontEnd, voltage: f64, first: f64, last: f64, length_s: f64) -> Ramp {
        let light_part_s = if front_end.alpha_s == 0.0 { 0.0 } else { front_end.alpha_s * libm::exp(-0.5 * (first + last)) };
        let tau_s = f64::max(front_end.tau_0_s + light_part_s, TAU_FLOOR_S);
        let settled = -libm::expm1(-length_s / tau_s);
        let left = 1.0 - settled;
        let lag = settled * tau_s / length_s;
        // d tau / d u is -light_part / 2 at either end.
        let by_tau = left * (length_s / tau_s) / tau_s * (voltage - first) - (lag - left) / tau_s * (last - first);
        let through_tau = -0.5 * light_part_s * by_tau;
        Ramp {
            voltage: voltage + settled * (first - voltage) + (1.0 - lag) * (last - first),
            by_voltage: left,
            by_first: lag - left + through_tau,
            by_last: 1.0 - lag + through_tau,
        }
    }
}

/// The light collected on a segment, photocurrent times seconds, and its derivatives by both ends.
pub(super) fn collected(first: f64, last: f64, length_s: f64) -> (f64, f64, f64) {
    let mean = log_linear_mean(first, last);
    let by_last = log_linear_mean_by_end(first, last);
    (length_s * mean, length_s * (mean - by_last), length_s * by_last)
}

/// The light collected from `start_ns` to `end_ns`, photocurrent times seconds, of log light that is linear between knots; both lie inside them.
pub(super) fn collected_between(t_ns: &[i64], u: &[f64], start_ns: i64, end_ns: i64) -> f64 {
    let mut sum = 0.0;
    let first = t_ns.partition_point(|&t| t <= start_ns).max(1);
    for k in first..t_ns.len() {
        let (from, to) = (i64::max(t_ns[k - 1], start_ns), i64::min(t_ns[k], end_ns));
        if to <= from {
            break;
        }
        let slope = (u[k] - u[k - 1]) / (t_ns[k] - t_ns[k - 1]) as f64;
        let log = |t: i64| u[k - 1] + slope * (t - t_ns[k - 1]) as f64;
        sum += collected(log(from), log(to), (to - from) as f64 * 1e-9).0;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Dual;

    const FRONT_ENDS: [FrontEnd; 4] = [
        FrontEnd { tau_0_s: 20e-6, alpha_s: 12e-3 },
        FrontEnd { tau_0_s: 0.0, alpha_s: 3e-2 },
        FrontEnd { tau_0_s: 2e-4, alpha_s: 0.0 },
        FrontEnd { tau_0_s: 0.0, alpha_s: 0.0 },
    ];

    #[test]
    fn derivatives_by_hand_equal_those_of_dual_numbers() {
        for front_end in FRONT_ENDS {
            for (voltage, first, last, length_s) in [(4.0, 4.2, 4.1, 2e-4), (3.0, 4.6, 2.0, 1e-6), (-1.0, -2.0, 1.0, 5e-3)] {
                let ramp = Ramp::new(&front_end, voltage, first, last, length_s);
                let lifted = front_end.lift::<Dual<f64>>();
                let with = |which: usize| {
                    let lift = |k: usize, x: f64| if k == which { Dual::variable(x) } else { Dual::constant(x) };
                    ramp_voltage(&lifted, lift(0, voltage), lift(1, first), lift(2, last), Dual::constant(length_s))
                };
                for (which, by_hand) in [ramp.by_voltage, ramp.by_first, ramp.by_last].into_iter().enumerate() {
                    let dual = with(which);
                    assert!((dual.primal - ramp.voltage).abs() < 1e-12);
                    assert!((dual.tangent - by_hand).abs() < 1e-9 * (1.0 + by_hand.abs()), "{front_end:?} {which}: {by_hand} against {}", dual.tangent);
                }
            }
        }
    }

    #[test]
    fn a_ramp_is_what_many_short_settling_steps_give() {
        let front_end = FrontEnd { tau_0_s: 3e-4, alpha_s: 0.0 };
        let (steps, length_s) = (100_000, 1e-3);
        let mut voltage = 0.5;
        for k in 0..steps {
            let middle = 1.0 + 0.8 * (k as f64 + 0.5) / steps as f64;
            voltage = crate::front_end::settle(voltage, middle, length_s / steps as f64, 3e-4);
        }
        assert!((ramp_voltage(&front_end, 0.5, 1.0, 1.8, length_s) - voltage).abs() < 1e-9);
    }

    #[test]
    fn collected_light_and_its_derivatives_match_differences() {
        for (first, last) in [(4.0, 4.0), (4.0, 4.02), (1.0, 5.0), (5.0, 1.0), (3.0, 2.95)] {
            let (_, by_first, by_last) = collected(first, last, 2e-3);
            let h = 1e-5;
            let numeric_first = (collected(first + h, last, 2e-3).0 - collected(first - h, last, 2e-3).0) / (2.0 * h);
            let numeric_last = (collected(first, last + h, 2e-3).0 - collected(first, last - h, 2e-3).0) / (2.0 * h);
            assert!((numeric_first / by_first - 1.0).abs() < 1e-7 && (numeric_last / by_last - 1.0).abs() < 1e-7, "{first} {last}");
        }
    }

    #[test]
    fn light_between_instants_is_that_of_the_log_linear_track() {
        let (t_ns, u) = ([0, 1_000, 5_000, 9_000], [4.0_f64, 4.5, 3.0, 3.1]);
        let current = u.map(libm::exp);
        for (start, end) in [(0, 9_000), (200, 700), (900, 5_100), (5_000, 9_000)] {
            let exact = crate::exposure::LogLinearTrack::new(&t_ns, &current).integral(photocurrent_core::Exposure::new(start, end));
            assert!((collected_between(&t_ns, &u, start, end) / exact - 1.0).abs() < 1e-12, "{start} to {end}");
        }
    }
}
