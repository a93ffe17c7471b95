//! What the pixel misses while it is being read out, and how to add it back.
//!
//! After an event fires (at `t_in`) the pixel waits for its turn on the readout bus (until `t_off`) and then
//! rests for the refractory period `t_rp`. All that time the front-end voltage keeps moving, and the
//! reference is taken from it only at the end. So two events lie further apart in voltage than one threshold.
//!
//! Idea: assume the voltage moves with one slope from the previous event to this one. The comparator saw the
//! slope only while it was armed, from `t_off(k) + t_rp` to `t_in(k+1)`, and there it moved by exactly one
//! threshold; stretch that to the whole interval:
//! `step = c (1 + (t_off(k) - t_in(k) + t_rp) / (t_in(k+1) - t_off(k) - t_rp))`.
//!
//! Source: Eqs. (9)-(12), with two guards of ours (see [`compensated_step`]).
//! Limits: the slope is taken from the *next* interval; close ON/OFF pairs break that assumption, and there
//! compensation can hurt (the paper's own Table 2 has such a row). It needs in-pixel times.

use crate::scalar::Scalar;

/// The largest blind-to-armed ratio that is used.
///
/// An event that fires right after the reference was taken implies an almost vertical slope; Eq. (9) would
/// turn one threshold into hundreds. Beyond this ratio the local slope does not constrain the blind time.
pub const RATIO_LIMIT: f64 = 20.0;

/// The shortest armed time, in seconds, that is divided by.
///
/// Time stamps are quantised (often to 1 us), so the armed time can come out as zero or negative;
/// without this floor Eq. (9) divides by zero or flips the sign of the step.
pub(crate) const ARMED_FLOOR_S: f64 = 5e-6;

/// The signed log step from event `k` to event `k+1`, blind time included: Eqs. (9)-(12).
///
/// `step` is the plain step `c(k+1)` (signed, natural-log units). Times are seconds on one clock: `t_in_s`
/// and `t_off_s` of event `k`, `next_t_in_s` of event `k+1`. The result has the sign of `step` and lies
/// between `step` and `step * (1 + RATIO_LIMIT)` when `t_off_s >= t_in_s` and `refractory_s >= 0`.
///
/// Two guards, both absent from the paper: the armed time is at least [`ARMED_FLOOR_S`], the ratio at most
/// [`RATIO_LIMIT`].
///
/// ```
/// # use photocurrent_sensor::readout::compensated_step;
/// // 100 us blind, 200 us armed: half a threshold was missed.
/// let step = compensated_step(0.2, 0.0, 40e-6, 300e-6, 60e-6);
/// assert!((step - 0.3_f64).abs() < 1e-12);
/// ```
pub fn compensated_step<S: Scalar>(step: S, t_in_s: S, t_off_s: S, next_t_in_s: S, refractory_s: S) -> S {
    let blind = t_off_s - t_in_s + refractory_s;
    let armed = (next_t_in_s - t_off_s - refractory_s).max(S::from_f64(ARMED_FLOOR_S));
    step * (S::from_f64(1.0) + (blind / armed).min(S::from_f64(RATIO_LIMIT)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_blind_time_leaves_the_step_alone() {
        assert_eq!(compensated_step(-0.2, 1.0, 1.0, 1.5, 0.0), -0.2);
    }

    #[test]
    fn a_straight_ramp_is_measured_exactly() {
        // V rises by 3 per second; the comparator is armed until V has risen by 0.2 since t_off + t_rp.
        let (slope, latency, refractory) = (3.0, 0.004, 0.010);
        let armed = 0.2 / slope;
        let next = 1.0 + latency + refractory + armed;
        let step = compensated_step(0.2, 1.0, 1.0 + latency, next, refractory);
        assert!((step - slope * (next - 1.0)).abs() < 1e-12);
    }

    #[test]
    fn an_interval_shorter_than_the_refractory_period_keeps_its_sign() {
        let step = compensated_step(0.2, 0.0, 50e-6, 90e-6, 60e-6);
        assert!((step - 0.2 * 21.0_f64).abs() < 1e-12); // 110 us over the 5 us floor is 22, limited to 20
    }

    #[test]
    fn the_ratio_is_limited() {
        assert!((compensated_step(-0.1, 0.0, 1.0, 1.0 + 1e-4, 0.0) + 0.1 * 21.0_f64).abs() < 1e-12);
    }

    #[test]
    fn shifting_time_changes_nothing() {
        let here: f64 = compensated_step(0.2, 0.0, 4e-5, 3e-4, 6e-5);
        let there = compensated_step(0.2, 8.0, 8.0 + 4e-5, 8.0 + 3e-4, 6e-5);
        assert!((here - there).abs() < 1e-9); // f64 seconds near 8 resolve 1e-15 s of a 2e-4 s interval
    }
}
