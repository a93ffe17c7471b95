//! The front end: how photocurrent becomes the voltage that the event circuit watches.
//!
//! The pixel takes the logarithm of its photocurrent, but not at once: the voltage follows through a
//! first-order low-pass that is slow when the pixel is dark. That delay is the "pixel latency" which the
//! inverse model undoes.
//!
//! Source: Eqs. (1), (2), (3) and (6) of the paper. Voltages are in natural-log units, so the settled
//! voltage is exactly `ln i`. A surprise in the paper: Eq. (7) as printed lacks the leading `V_FE(k)`
//! that Eq. (1) has; the printed form would forget the voltage at every event. This crate follows Eq. (1).
//!
//! Limits: one pole; the time constant is held over an interval, and [`TauRule`] says at which end of the
//! interval it is taken. With [`TauRule::End`] the fall that an interval can make has a largest value: a
//! darker target is further away, but also slower to approach (see `inverse`).

use crate::scalar::Scalar;

/// The shortest time constant, in seconds, that division by it can take: stands for the ideal front end's
/// zero.
const TAU_FLOOR_S: f64 = 1e-30;

/// The two parameters of the low-pass: `tau(i) = tau_0 + alpha / i`, Eq. (3).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrontEnd<S = f64> {
    /// Time constant in bright light, seconds, at least zero.
    pub tau_0_s: S,
    /// Seconds times the unit of photocurrent, at least zero: `alpha / i` is the part that grows in the dark.
    pub alpha_s: S,
}

impl FrontEnd {
    /// A front end without delay: the voltage is `ln i` at every instant.
    pub const IDEAL: FrontEnd = FrontEnd { tau_0_s: 0.0, alpha_s: 0.0 };

    /// The same parameters as constants of another number type.
    pub fn lift<S: Scalar>(&self) -> FrontEnd<S> {
        FrontEnd { tau_0_s: S::from_f64(self.tau_0_s), alpha_s: S::from_f64(self.alpha_s) }
    }
}

/// Which end of an interval between two events sets the interval's time constant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum TauRule {
    /// The photocurrent at the interval's start, `i(k)`: Eqs. (2)-(3) as printed.
    ///
    /// At an edge out of the dark the interval is then far too slow, and the settled voltage overshoots.
    Start,
    /// The photocurrent at the interval's end, `i(k+1)`, which is the one that drives it in Eq. (1).
    #[default]
    End,
}

impl TauRule {
    /// Picks the photocurrent (or its logarithm) that sets the time constant.
    pub fn pick<S>(self, start: S, end: S) -> S {
        match self {
            TauRule::Start => start,
            TauRule::End => end,
        }
    }
}

/// The voltage the front end settles to, `V_DC = ln i`: the function f_DC of Eq. (6), in natural-log units.
///
/// `photocurrent` must be positive; zero gives minus infinity and a negative one NaN.
#[inline(always)]
pub fn settled_voltage<S: Scalar>(photocurrent: S) -> S {
    photocurrent.ln()
}

/// The photocurrent whose settled voltage is `settled_voltage`: the inverse of [`settled_voltage`].
#[inline(always)]
pub fn settled_photocurrent<S: Scalar>(settled_voltage: S) -> S {
    settled_voltage.exp()
}

/// The low-pass time constant in seconds at `photocurrent` (positive), Eq. (3).
#[inline(always)]
pub fn time_constant<S: Scalar>(front_end: &FrontEnd<S>, photocurrent: S) -> S {
    front_end.tau_0_s + front_end.alpha_s / photocurrent
}

/// One over [`time_constant`], 1/s, with one division less: `i / (tau_0 i + alpha)`. `photocurrent` is
/// positive; the ideal front end's rate is finite, 1e30/s.
#[inline(always)]
pub(crate) fn settling_rate<S: Scalar>(front_end: &FrontEnd<S>, photocurrent: S) -> S {
    photocurrent
        / (front_end.tau_0_s * photocurrent + front_end.alpha_s).max(S::from_f64(TAU_FLOOR_S) * photocurrent)
}

/// The fraction gamma, 0 to 1, of the way to the settled voltage covered in `dt_s`: Eq. (2).
///
/// `dt_s` and `tau_s` are seconds and not negative. Zero `dt_s` gives 0; otherwise zero `tau_s` gives 1.
#[inline(always)]
pub fn settling<S: Scalar>(dt_s: S, tau_s: S) -> S {
    -(-(dt_s / tau_s.max(S::from_f64(TAU_FLOOR_S)))).exp_m1()
}

/// Settles the front end from `voltage` towards `settled` over `dt_s`: Eqs. (1) and (2).
///
/// `tau_s` is the interval's time constant in seconds; which photocurrent it was taken at is the caller's
/// [`TauRule`]. A zero `dt_s` returns `voltage`; a zero `tau_s` is the ideal front end and returns `settled`
/// (to rounding).
///
/// ```
/// # use photocurrent_sensor::front_end::settle;
/// assert_eq!(settle(0.2, 0.5, 1e-3, 0.0), 0.5); // ideal front end
/// ```
#[inline(always)]
pub fn settle<S: Scalar>(voltage: S, settled: S, dt_s: S, tau_s: S) -> S {
    voltage + settling(dt_s, tau_s) * (settled - voltage)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Dual;

    #[test]
    fn settled_voltage_is_undone_by_its_inverse() {
        for i in [1e-6, 0.3, 1.0, 500.0] {
            assert!((settled_photocurrent(settled_voltage(i)) / i - 1.0).abs() < 1e-14);
        }
    }

    #[test]
    fn time_constant_grows_in_the_dark() {
        let front_end = FrontEnd { tau_0_s: 30e-6, alpha_s: 1e-4 };
        assert_eq!(time_constant(&front_end, 1.0), 30e-6 + 1e-4);
        assert_eq!(time_constant(&front_end, 0.1), 30e-6 + 1e-4 / 0.1);
    }

    #[test]
    fn the_rate_is_one_over_the_time_constant() {
        for (tau_0_s, alpha_s) in [(30e-6, 1e-4), (0.0, 1e-4), (30e-6, 0.0)] {
            for i in [1e-3, 0.2, 7.0] {
                let front_end = FrontEnd { tau_0_s, alpha_s };
                assert!((settling_rate(&front_end, i) * time_constant(&front_end, i) - 1.0).abs() < 1e-15);
            }
        }
        assert!((settling_rate(&FrontEnd::IDEAL, 0.2) * TAU_FLOOR_S - 1.0).abs() < 1e-15);
    }

    #[test]
    fn one_time_constant_covers_all_but_one_part_in_e() {
        assert!((settling(2e-3, 2e-3) - (1.0 - libm::exp(-1.0))).abs() < 1e-15);
    }

    #[test]
    fn settling_limits_are_exact() {
        assert_eq!(settling(1e-9, 0.0), 1.0);
        assert_eq!(settling(0.0, 1e-3), 0.0);
        assert_eq!(settling(0.0, 0.0), 0.0);
    }

    #[test]
    fn two_short_intervals_equal_one_long_interval() {
        let (tau, target) = (7e-4, -0.8);
        let halfway = settle(0.4, target, 2e-4, tau);
        let twice = settle(halfway, target, 3e-4, tau);
        assert!((twice - settle(0.4, target, 5e-4, tau)).abs() < 1e-15);
    }

    #[test]
    fn ideal_front_end_has_finite_derivatives() {
        let ideal = FrontEnd::IDEAL.lift::<Dual<f64>>();
        let i = Dual::variable(0.3);
        let v =
            settle(Dual::constant(0.1), settled_voltage(i), Dual::constant(1e-3), time_constant(&ideal, i));
        assert!((v.tangent - 1.0 / 0.3).abs() < 1e-12);
    }

    #[test]
    fn derivative_of_settle_matches_central_differences() {
        let front_end = FrontEnd { tau_0_s: 30e-6, alpha_s: 1e-4 };
        let at = |i: f64| settle(0.1, settled_voltage(i), 3e-4, time_constant(&front_end, i));
        let i = Dual::variable(0.3);
        let lifted = front_end.lift();
        let dual =
            settle(Dual::constant(0.1), settled_voltage(i), Dual::constant(3e-4), time_constant(&lifted, i));
        let numeric = (at(0.3 + 1e-6) - at(0.3 - 1e-6)) / 2e-6;
        assert!((dual.tangent - numeric).abs() < 1e-8);
    }
}
