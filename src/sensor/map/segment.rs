//! One segment between two knots: log light is a straight line, and everything that follows from that in
//! closed form.
//!
//! Voltage: the low-pass of Eq. (1) driven by a ramp, with the time constant of the segment's middle (in log
//! light). Exposure: the integral of an exponential. Both come with their derivatives by the two ends; the
//! formulas are checked against dual numbers.

use crate::elementary::{exp, exp_m1};
use crate::front_end::{FrontEnd, settled_photocurrent, settling, time_constant};
use crate::scalar::Scalar;
use multiversion::multiversion;

/// The shortest time constant that is divided by, seconds: stands for the ideal front end's zero.
const TAU_FLOOR_S: f64 = 1e-30;

/// The voltage after `length_s` of log light rising from `first` to `last`, from `voltage` on.
///
/// `V1 = E V0 + (g - E) u0 + (1 - g) u1` with `E = exp(-h / tau)` and `g = (1 - E) tau / h`: the exact answer
/// for a constant tau, which is taken at the middle log light.
pub fn ramp_voltage<S: Scalar>(front_end: &FrontEnd<S>, voltage: S, first: S, last: S, length_s: S) -> S {
    let middle = settled_photocurrent((first + last) * S::from_f64(0.5));
    let tau_s = time_constant(front_end, middle).max(S::from_f64(TAU_FLOOR_S));
    let settled = settling(length_s, tau_s);
    let lag = settled * tau_s / length_s;
    voltage + settled * (first - voltage) + (S::from_f64(1.0) - lag) * (last - first)
}

/// A segment's derivatives: of the voltage by voltage and both ends, of the scaled light by both ends.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Slopes<T> {
    pub by_voltage: T,
    /// By both ends together.
    pub by_both: T,
    pub by_last: T,
    /// By both ends together.
    pub light_by_both: T,
    pub light_by_last: T,
}

/// A segment's voltage at its end.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Ramp<T> {
    pub voltage: T,
    /// Its derivative by the voltage at the start.
    pub by_voltage: T,
    /// By the log light at both ends together.
    pub by_both: T,
    /// By the log light at the end.
    pub by_last: T,
}

impl<T: Scalar> Ramp<T> {
    /// From `voltage`, `gap` above the first log light, with log light that rises by `rise`: `left` is what
    /// is left of the gap, `follows` the part of the rise that
    /// the voltage follows, and `through_tau` the derivative by either end through the time constant
    /// ([`fill_pieces`]).
    #[inline(always)]
    pub(super) fn of(voltage: T, gap: T, rise: T, left: T, follows: T, through_tau: T) -> Ramp<T> {
        let settled = T::from_f64(1.0) - left;
        Ramp {
            voltage: voltage + (follows * rise - settled * gap),
            by_voltage: left,
            by_both: settled + T::from_f64(2.0) * through_tau,
            by_last: follows + through_tau,
        }
    }
}

/// What segments are made of, apart from the voltage they begin with, of segments with these lengths whose
/// log light and whose root of the photocurrent go from
/// the first of two columns to the second.
///
/// The columns: what is left of a difference at the start, `exp(-h / tau)`; the lag, `(1 - left) tau / h`;
/// two for the derivative of the voltage by either end through
/// the time constant, which is the first times voltage less first log light plus the second; light collected,
/// photocurrent times seconds, which is its derivative by
/// both ends together as well; and its derivative by the log light at the end. Nothing depends on the segment
/// before, so that loops become vector instructions.
#[inline(always)]
pub(super) fn fill_pieces(
    front_end: &FrontEnd,
    length_s: &[f64],
    (first, last): (&[f64], &[f64]),
    (from, to): (&[f64], &[f64]),
    into: [&mut [f64]; 6],
) {
    let n = length_s.len();
    let (first, last, from, to) = (&first[..n], &last[..n], &from[..n], &to[..n]);
    let [left, lag, through_gap, through_rise, light, light_by_last] = into;
    let (left, lag, through_gap, through_rise) =
        (&mut left[..n], &mut lag[..n], &mut through_gap[..n], &mut through_rise[..n]);
    let (light, light_by_last) = (&mut light[..n], &mut light_by_last[..n]);
    // In parts, so that a processor finds several turns of a loop to work on; what the next part needs stands
    // in columns that it fills.
    for k in 0..n {
        // The photocurrent at the middle log light, and the time constant times that.
        let middle = from[k] * to[k];
        let tau = front_end.tau_0_s * middle + front_end.alpha_s;
        let floor = TAU_FLOOR_S * middle;
        let one_over = 1.0 / if tau > floor { tau } else { floor };
        left[k] = length_s[k] * (middle * one_over);
        // d tau / d u is -alpha / 2 i at either end.
        lag[k] = -0.5 * (front_end.alpha_s * one_over);
    }
    for k in 0..n {
        let (lengths, by_tau, rise) = (left[k], lag[k], last[k] - first[k]);
        let is_short = rise.abs() < SHORT_RISE;
        // Never divides by a small number; what it gives for a short rise is not used. One division for both.
        let divisor = if is_short { 1.0 } else { rise };
        let one_over = 1.0 / (lengths * divisor);
        let settled = -exp_m1(-lengths);
        left[k] = 1.0 - settled;
        lag[k] = settled * (divisor * one_over);
        through_gap[k] = by_tau * left[k] * lengths;
        through_rise[k] = by_tau * (left[k] - lag[k]) * rise;
        light[k] = lengths * one_over;
    }
    for k in 0..n {
        let (mean, by_last) =
            log_linear_means(last[k] - first[k], light[k], from[k] * from[k], to[k] * to[k]);
        light[k] = length_s[k] * mean;
        light_by_last[k] = length_s[k] * by_last;
    }
}

/// Rises of log light below this are short: differences of photocurrents lose digits.
const SHORT_RISE: f64 = 0.02;

/// The mean of a photocurrent whose logarithm is linear, and its derivative by the end, as in
/// [`crate::exposure`], where the photocurrents are known already, and one over the rise unless that is
/// short.
#[inline(always)]
fn log_linear_means(rise: f64, one_over: f64, from: f64, to: f64) -> (f64, f64) {
    let series = 1.0
        + rise
            * (0.5 + rise * (1.0 / 6.0 + rise * (1.0 / 24.0 + rise * (1.0 / 120.0 + rise * (1.0 / 720.0)))));
    let series_by_last = 0.5
        + rise
            * (1.0 / 3.0
                + rise * (1.0 / 8.0 + rise * (1.0 / 30.0 + rise * (1.0 / 144.0 + rise * (1.0 / 840.0)))));
    let is_short = rise.abs() < SHORT_RISE;
    let mean = (to - from) * one_over;
    let by_last = (to - mean) * one_over;
    (if is_short { from * series } else { mean }, if is_short { from * series_by_last } else { by_last })
}

/// The light collected on the segment that ends at each knot, photocurrent times seconds; fills `current` as
/// well. Columns are equally long.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub(super) fn collect(seconds: &[f64], u: &[f64], current: &mut [f64], light: &mut [f64]) {
    let n = u.len();
    for (current, u) in current.iter_mut().zip(u) {
        *current = exp(*u);
    }
    let (start_s, end_s, first, last) = (&seconds[..n - 1], &seconds[1..n], &u[..n - 1], &u[1..]);
    let (from, to, light) = (&current[..n - 1], &current[1..n], &mut light[1..n]);
    for k in 0..n - 1 {
        let rise = last[k] - first[k];
        let one_over = 1.0 / if rise.abs() < SHORT_RISE { 1.0 } else { rise };
        light[k] = (end_s[k] - start_s[k]) * log_linear_means(rise, one_over, from[k], to[k]).0;
    }
}

/// The light collected on a segment, photocurrent times seconds.
fn collected(first: f64, last: f64, length_s: f64) -> f64 {
    let rise = last - first;
    let one_over = 1.0 / if rise.abs() < SHORT_RISE { 1.0 } else { rise };
    length_s * log_linear_means(rise, one_over, exp(first), exp(last)).0
}

/// The light collected from `start_ns` to `end_ns`, photocurrent times seconds, of log light that is linear
/// between knots; both lie inside them.
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
        sum += collected(log(from), log(to), (to - from) as f64 * 1e-9);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::elementary;
    use crate::exposure::log_linear_mean;
    use crate::scalar::Dual;

    const FRONT_ENDS: [FrontEnd; 4] = [
        FrontEnd { tau_0_s: 20e-6, alpha_s: 12e-3 },
        FrontEnd { tau_0_s: 0.0, alpha_s: 3e-2 },
        FrontEnd { tau_0_s: 2e-4, alpha_s: 0.0 },
        FrontEnd { tau_0_s: 0.0, alpha_s: 0.0 },
    ];

    /// The columns of the segments between `u`.
    fn pieces(front_end: &FrontEnd, u: &[f64], length_s: f64) -> [Vec<f64>; 6] {
        let n = u.len() - 1;
        let root: Vec<f64> = u.iter().map(|u| exp(0.5 * u)).collect();
        let mut pieces: [Vec<f64>; 6] = std::array::from_fn(|_| vec![0.0; n]);
        fill_pieces(
            front_end,
            &vec![length_s; n],
            (&u[..n], &u[1..]),
            (&root[..n], &root[1..]),
            pieces.each_mut().map(|column| column.as_mut_slice()),
        );
        pieces
    }

    /// The derivative of [`log_linear_mean`] by `last`.
    fn log_linear_mean_by_end(first: f64, last: f64) -> f64 {
        let rise = last - first;
        let ratio = if rise.abs() < 0.02 {
            0.5 + rise
                * (1.0 / 3.0 + rise * (1.0 / 8.0 + rise * (1.0 / 30.0 + rise * (1.0 / 144.0 + rise / 840.0))))
        } else {
            (elementary::exp(rise) - elementary::exp_m1(rise) / rise) / rise
        };
        elementary::exp(first) * ratio
    }

    #[test]
    fn derivatives_by_hand_equal_those_of_dual_numbers() {
        for front_end in FRONT_ENDS {
            for (voltage, first, last, length_s) in
                [(4.0, 4.2, 4.1, 2e-4), (3.0, 4.6, 2.0, 1e-6), (-1.0, -2.0, 1.0, 5e-3)]
            {
                let [left, lag, by_gap, by_rise, ..] =
                    pieces(&front_end, &[first, last], length_s).map(|column| column[0]);
                let gap = voltage - first;
                let ramp = Ramp::of(voltage, gap, last - first, left, 1.0 - lag, by_gap * gap + by_rise);
                let lifted = front_end.lift::<Dual<f64>>();
                let with = |which: usize| {
                    let lift =
                        |k: usize, x: f64| if k == which { Dual::variable(x) } else { Dual::constant(x) };
                    ramp_voltage(
                        &lifted,
                        lift(0, voltage),
                        lift(1, first),
                        lift(2, last),
                        Dual::constant(length_s),
                    )
                };
                for (which, by_hand) in
                    [ramp.by_voltage, ramp.by_both - ramp.by_last, ramp.by_last].into_iter().enumerate()
                {
                    let dual = with(which);
                    assert!((dual.primal - ramp.voltage).abs() < 1e-12);
                    assert!(
                        (dual.tangent - by_hand).abs() < 1e-9 * (1.0 + by_hand.abs()),
                        "{front_end:?} {which}: {by_hand} against {}",
                        dual.tangent
                    );
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
    fn collected_light_and_its_derivatives_match_the_mean_of_an_exponential() {
        let u = [4.0, 4.0, 4.02, 1.0, 5.0, 1.0, 0.985, 0.96501, 0.94499];
        let [.., all_light, all_by_last] = pieces(&FRONT_ENDS[0], &u, 2e-3);
        for j in 1..u.len() {
            let (own_light, own_by_last) = (all_light[j - 1], all_by_last[j - 1]);
            let (light, by_last) =
                (2e-3 * log_linear_mean(u[j - 1], u[j]), 2e-3 * log_linear_mean_by_end(u[j - 1], u[j]));
            assert!(
                (own_light / light - 1.0).abs() < 1e-13 && (own_by_last / by_last - 1.0).abs() < 1e-11,
                "{j}"
            );
            let h = 1e-5;
            let numeric =
                (collected(u[j - 1], u[j] + h, 2e-3) - collected(u[j - 1], u[j] - h, 2e-3)) / (2.0 * h);
            assert!((own_by_last / numeric - 1.0).abs() < 1e-7, "{j}");
        }
    }

    #[test]
    fn light_between_instants_is_that_of_the_log_linear_track() {
        let (t_ns, u) = ([0, 1_000, 5_000, 9_000], [4.0_f64, 4.5, 3.0, 3.1]);
        let current = u.map(libm::exp);
        for (start, end) in [(0, 9_000), (200, 700), (900, 5_100), (5_000, 9_000)] {
            let exact = crate::exposure::LogLinearTrack::new(&t_ns, &current)
                .integral(photocurrent_core::Exposure::new(start, end));
            assert!(
                (collected_between(&t_ns, &u, start, end) / exact - 1.0).abs() < 1e-12,
                "{start} to {end}"
            );
        }
    }
}
