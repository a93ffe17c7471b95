//! Exposure: from photocurrent to the digital number (DN) of a frame pixel.
//!
//! A frame pixel adds up photocurrent while its row is exposed. With a rolling shutter each row starts a
//! little later than the one above, so the same formula runs with other limits: that is all there is to
//! rolling-shutter correction here.
//!
//! Source: Eq. (5) and Section 4.1 ("Rolling Shutter (RS) Effect Correction"). The photocurrent of a solved
//! pixel is a zero-order hold ([`HeldTrack`]): `i[k]` from knot `k` to knot `k + 1`, `i[0]` before the first,
//! the last for ever; or its logarithm is linear between knots ([`LogLinearTrack`]), with the same ends.
//!
//! Times are whole nanoseconds, so limits and overlaps are exact; only the photocurrent is `f64`. An overlap
//! becomes an `f64` exactly up to 2^53 ns (104 days). Rendering thousands of frames per second from one track
//! goes through [`ManyExposures`] or [`ExposureCursor`], which give the same bits without searching anew.

use crate::elementary;
use multiversion::multiversion;
use photocurrent_core::Exposure;

/// How a collected charge becomes a digital number: `DN = black_level + gain * integral`, Eq. (5).
///
/// The paper has no black level; zero gives its form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DigitalNumber {
    /// DN of a dark exposure.
    pub black_level: f64,
    /// DN per photocurrent and second.
    pub gain: f64,
}

impl DigitalNumber {
    /// The DN of `integral`, photocurrent times seconds. Linear: no clipping, no rounding.
    pub fn of(&self, integral: f64) -> f64 {
        self.black_level + self.gain * integral
    }

    /// The integral, photocurrent times seconds, whose DN is `dn`: the inverse of [`DigitalNumber::of`],
    /// negative below the black level.
    pub fn integral(&self, dn: f64) -> f64 {
        (dn - self.black_level) / self.gain
    }
}

/// A pixel's photocurrent over time as a zero-order hold. Photocurrents may be `f32` or `f64`; sums are taken
/// in `f64`.
#[derive(Clone, Copy, Debug)]
pub struct HeldTrack<'a, P = f64> {
    knots_ns: &'a [i64],
    photocurrent: &'a [P],
}

impl<'a, P: Copy + Into<f64>> HeldTrack<'a, P> {
    /// Holds `photocurrent[k]` from `knots_ns[k]` to `knots_ns[k + 1]`.
    ///
    /// # Panics
    ///
    /// When the slices are empty, differ in length, or the knots go back in time: the integral below relies
    /// on order. Equal knots are allowed (the earlier one then holds for no time).
    pub fn new(knots_ns: &'a [i64], photocurrent: &'a [P]) -> Self {
        assert!(!knots_ns.is_empty(), "a track has at least one knot");
        assert_eq!(knots_ns.len(), photocurrent.len(), "a track has one photocurrent per knot");
        assert!(knots_ns.is_sorted(), "knots of a track are in time order");
        HeldTrack { knots_ns, photocurrent }
    }

    /// The integral of the photocurrent over `exposure`, in photocurrent times seconds: Eq. (5) without its
    /// gain.
    pub fn integral(&self, exposure: Exposure) -> f64 {
        let after = self.knots_ns.partition_point(|&knot| knot <= exposure.start.0);
        self.integral_from(after.saturating_sub(1), exposure)
    }
}

/// A pixel's photocurrent over time that can be integrated.
pub trait Track {
    /// Its knots, in order of time, at least one.
    fn knots_ns(&self) -> &[i64];

    /// The integral over `exposure`, photocurrent times seconds; `first` is the last knot not after the
    /// exposure's start, or 0. All ways to an integral end here, so they round alike.
    fn integral_from(&self, first: usize, exposure: Exposure) -> f64;
}

impl<P: Copy + Into<f64>> Track for HeldTrack<'_, P> {
    fn knots_ns(&self) -> &[i64] {
        self.knots_ns
    }

    fn integral_from(&self, first: usize, exposure: Exposure) -> f64 {
        let mut sum = 0.0;
        let mut from = exposure.start.0;
        let mut k = first;
        while from < exposure.end.0 {
            let hold_ends = self.knots_ns.get(k + 1).copied().unwrap_or(i64::MAX);
            let to = hold_ends.min(exposure.end.0);
            sum += self.photocurrent[k].into() * (to - from) as f64;
            from = to;
            k += 1;
        }
        sum / 1e9
    }
}

/// A pixel's photocurrent over time whose logarithm is linear between knots; the first value holds before,
/// the last one for ever.
#[derive(Clone, Copy, Debug)]
pub struct LogLinearTrack<'a, P = f64> {
    knots_ns: &'a [i64],
    photocurrent: &'a [P],
}

/// What a photocurrent of zero counts as: below it no logarithm of an `f32` exists.
const DARKEST: f64 = 1e-38;

impl<'a, P: Copy + Into<f64>> LogLinearTrack<'a, P> {
    /// Joins `photocurrent[k]` at `knots_ns[k]`; zero counts as the smallest positive number.
    ///
    /// # Panics
    ///
    /// When the slices are empty, differ in length, or the knots go back in time. Equal knots are allowed: a
    /// jump.
    pub fn new(knots_ns: &'a [i64], photocurrent: &'a [P]) -> Self {
        let HeldTrack { knots_ns, photocurrent } = HeldTrack::new(knots_ns, photocurrent);
        LogLinearTrack { knots_ns, photocurrent }
    }

    /// The integral of the photocurrent over `exposure`, in photocurrent times seconds: exact.
    ///
    /// ```
    /// # use photocurrent_core::Exposure;
    /// # use photocurrent_sensor::exposure::LogLinearTrack;
    /// // From 1 to 4 in 3 s: the mean of an exponential is 3 / ln 4.
    /// let track = LogLinearTrack::new(&[0, 3_000_000_000], &[1.0, 4.0]);
    /// let integral = track.integral(Exposure::new(0, 3_000_000_000));
    /// assert!((integral - 9.0 / 4.0_f64.ln()).abs() < 1e-12);
    /// ```
    pub fn integral(&self, exposure: Exposure) -> f64 {
        let after = self.knots_ns.partition_point(|&knot| knot <= exposure.start.0);
        self.integral_from(after.saturating_sub(1), exposure)
    }

    fn log_at(&self, k: usize) -> f64 {
        elementary::ln(f64::max(self.photocurrent[k].into(), DARKEST))
    }
}

impl<P: Copy + Into<f64>> Track for LogLinearTrack<'_, P> {
    fn knots_ns(&self) -> &[i64] {
        self.knots_ns
    }

    fn integral_from(&self, first: usize, exposure: Exposure) -> f64 {
        let knots = self.knots_ns;
        let (start, end) = (exposure.start.0, exposure.end.0);
        let last = knots.len() - 1;
        let held = |k: usize, from: i64, to: i64| self.photocurrent[k].into() * (to - from) as f64;
        let mut sum = 0.0;
        let mut from = start;
        if from < knots[0] && from < end {
            let to = i64::min(knots[0], end);
            sum += held(0, from, to);
            from = to;
        }
        let mut k = first;
        let mut log_here = self.log_at(k);
        while from < end && k < last {
            let log_next = self.log_at(k + 1);
            let to = i64::min(knots[k + 1], end);
            if to > from {
                let slope = (log_next - log_here) / (knots[k + 1] - knots[k]) as f64;
                let log = |t: i64| log_here + slope * (t - knots[k]) as f64;
                sum += log_linear_mean(log(from), log(to)) * (to - from) as f64;
                from = to;
            }
            log_here = log_next;
            k += 1;
        }
        if from < end {
            sum += held(last, from, end);
        }
        sum / 1e9
    }
}

/// The mean of a photocurrent whose logarithm goes linearly from `first` to `last`:
/// `(e^last - e^first) / (last - first)`.
#[inline(always)]
pub(crate) fn log_linear_mean(first: f64, last: f64) -> f64 {
    let rise = last - first;
    // Both, and then a choice: no branch, so that a loop becomes vector instructions.
    let short =
        1.0 + rise * (0.5 + rise * (1.0 / 6.0 + rise * (1.0 / 24.0 + rise * (1.0 / 120.0 + rise / 720.0))));
    let long = elementary::exp_m1(rise) / rise;
    elementary::exp(first) * if rise.abs() < 0.02 { short } else { long }
}

/// Integrates many exposures of log-linear tracks, all pieces between knots at once; keeps its memory from
/// track to track.
///
/// ```
/// # use photocurrent_core::Exposure;
/// # use photocurrent_sensor::exposure::{LogLinearTrack, ManyExposures};
/// let track = LogLinearTrack::new(&[0, 3_000_000_000], &[1.0, 4.0]);
/// let exposures = [0, 1, 2].map(|s| Exposure::new(s * 1_000_000_000, 4_000_000_000));
/// let mut integrals = ManyExposures::default();
/// for (integral, exposure) in integrals.of(&track, &exposures).iter().zip(exposures) {
///     assert_eq!(*integral, track.integral(exposure));
/// }
/// ```
#[derive(Clone, Debug, Default)]
pub struct ManyExposures {
    /// Log photocurrent at each knot.
    log: Vec<f64>,
    /// Of each piece of an exposure: log photocurrent at its ends, length in ns, and in the end what is
    /// collected on it, photocurrent times ns.
    first: Vec<f64>,
    last: Vec<f64>,
    length: Vec<f64>,
    /// Pieces before the first knot and after the last, and what is collected there.
    held: Vec<(usize, f64)>,
    /// Where the pieces of each exposure end.
    ends: Vec<usize>,
    integrals: Vec<f64>,
}

impl ManyExposures {
    /// For each exposure the same bits as [`LogLinearTrack::integral`]. Quickest in order of time.
    pub fn of<P: Copy + Into<f64>>(
        &mut self,
        track: &LogLinearTrack<'_, P>,
        exposures: &[Exposure],
    ) -> &[f64] {
        self.log.clear();
        self.log
            .extend(track.photocurrent.iter().map(|&photocurrent| f64::max(photocurrent.into(), DARKEST)));
        elementary::ln_all(&mut self.log);
        for column in [&mut self.first, &mut self.last, &mut self.length, &mut self.integrals] {
            column.clear();
        }
        self.held.clear();
        self.ends.clear();
        let mut holding = 0;
        for exposure in exposures {
            holding = last_not_after(track.knots_ns, holding, exposure.start.0);
            self.cut(track, holding, *exposure);
            self.ends.push(self.first.len());
        }
        to_collected(&self.first, &self.last, &mut self.length);
        for &(at, collected) in &self.held {
            self.length[at] = collected;
        }
        let mut begin = 0;
        for &end in &self.ends {
            self.integrals.push(self.length[begin..end].iter().fold(0.0, |sum, piece| sum + piece) / 1e9);
            begin = end;
        }
        &self.integrals
    }

    /// Cuts an exposure into pieces, as [`LogLinearTrack::integral_from`] does.
    fn cut<P: Copy + Into<f64>>(
        &mut self,
        track: &LogLinearTrack<'_, P>,
        holding: usize,
        exposure: Exposure,
    ) {
        let knots = track.knots_ns;
        let (mut from, end, last) = (exposure.start.0, exposure.end.0, knots.len() - 1);
        let hold = |at: usize, k: usize, ns: i64, this: &mut ManyExposures| {
            this.held.push((at, track.photocurrent[k].into() * ns as f64));
            this.push(0.0, 0.0, 1.0);
        };
        if from < knots[0] && from < end {
            let to = i64::min(knots[0], end);
            hold(self.first.len(), 0, to - from, self);
            from = to;
        }
        for k in holding..last {
            if from >= end {
                break;
            }
            let to = i64::min(knots[k + 1], end);
            if to > from {
                let (log_here, log_next) = (self.log[k], self.log[k + 1]);
                let slope = (log_next - log_here) / (knots[k + 1] - knots[k]) as f64;
                let log = |t: i64| log_here + slope * (t - knots[k]) as f64;
                self.push(log(from), log(to), (to - from) as f64);
                from = to;
            }
        }
        if from < end {
            hold(self.first.len(), last, end - from, self);
        }
    }

    fn push(&mut self, first: f64, last: f64, length: f64) {
        self.first.push(first);
        self.last.push(last);
        self.length.push(length);
    }
}

/// Lengths become what is collected over them.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
fn to_collected(first: &[f64], last: &[f64], length: &mut [f64]) {
    for ((first, last), length) in first.iter().zip(last).zip(length) {
        *length *= log_linear_mean(*first, *last);
    }
}

/// The last knot that is not after `t_ns`, or 0, from a guess on.
fn last_not_after(knots_ns: &[i64], guess: usize, t_ns: i64) -> usize {
    let mut k = guess;
    while k + 1 < knots_ns.len() && knots_ns[k + 1] <= t_ns {
        k += 1;
    }
    while k > 0 && knots_ns[k] > t_ns {
        k -= 1;
    }
    k
}

/// Integrates many exposures of one track, remembering where the last one started.
///
/// For exposures in time order (overlapping, abutting or apart) the search is one pass over the track.
/// Any other order is right as well, but walks back.
///
/// ```
/// # use photocurrent_core::Exposure;
/// # use photocurrent_sensor::exposure::{ExposureCursor, HeldTrack};
/// let track = HeldTrack::new(&[0, 50_000], &[1.0, 3.0]);
/// let mut cursor = ExposureCursor::new(track);
/// assert_eq!(cursor.integral(Exposure::new(0, 100_000)), 200e-6);
/// ```
#[derive(Clone, Debug)]
pub struct ExposureCursor<T> {
    track: T,
    holding: usize,
}

impl<T: Track> ExposureCursor<T> {
    /// Starts at the beginning of `track`.
    pub fn new(track: T) -> Self {
        ExposureCursor { track, holding: 0 }
    }

    /// The same bits as the track's own `integral`.
    pub fn integral(&mut self, exposure: Exposure) -> f64 {
        self.holding = last_not_after(self.track.knots_ns(), self.holding, exposure.start.0);
        self.track.integral_from(self.holding, exposure)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const KNOTS: [i64; 3] = [100, 200, 400];
    const CURRENT: [f64; 3] = [1.0, 10.0, 100.0];

    fn integral(start_ns: i64, end_ns: i64) -> f64 {
        HeldTrack::new(&KNOTS, &CURRENT).integral(Exposure::new(start_ns, end_ns))
    }

    #[test]
    fn a_digital_number_gives_its_integral() {
        let number = DigitalNumber { black_level: 20.0, gain: 800.0 };
        assert!(
            (number.integral(140.0) - 0.15).abs() < 1e-15 && (number.integral(12.0) + 0.01).abs() < 1e-15
        );
        assert!((number.of(number.integral(731.5)) - 731.5).abs() < 1e-12);
    }

    #[test]
    fn each_hold_counts_for_its_overlap() {
        assert_eq!(integral(150, 450), (50.0 + 2000.0 + 5000.0) / 1e9);
    }

    #[test]
    fn the_first_photocurrent_holds_before_the_first_knot() {
        assert_eq!(integral(0, 150), 150e-9);
        assert_eq!(integral(-100, -50), 50e-9);
    }

    #[test]
    fn the_last_photocurrent_holds_for_ever() {
        assert_eq!(integral(1000, 1001), 100e-9);
    }

    #[test]
    fn an_empty_exposure_collects_nothing() {
        assert_eq!(integral(250, 250), 0.0);
    }

    #[test]
    fn an_exposure_on_a_knot_takes_the_new_photocurrent() {
        assert_eq!(integral(200, 201), 10e-9);
    }

    #[test]
    fn the_later_of_two_equal_knots_wins() {
        let track = HeldTrack::new(&[0, 10, 10], &[1.0, 50.0, 2.0]);
        assert_eq!(track.integral(Exposure::new(0, 20)), 30e-9);
    }

    #[test]
    fn a_dark_exposure_reads_the_black_level() {
        let dn = DigitalNumber { black_level: 64.0, gain: 1.5e5 };
        assert_eq!(dn.of(0.0), 64.0);
        assert_eq!(dn.of(1e-3), 64.0 + 150.0);
    }

    #[test]
    fn abutting_windows_add_up_to_the_whole() {
        let mut cursor = ExposureCursor::new(HeldTrack::new(&KNOTS, &CURRENT));
        let sum: f64 = (0..25).map(|n| cursor.integral(Exposure::new(20 * n, 20 * n + 20))).sum();
        assert!((sum / integral(0, 500) - 1.0).abs() < 1e-14);
    }

    /// By many small steps of the interpolated logarithm: an integrator that knows nothing of knots.
    fn stepped(knots: &[i64], current: &[f64], exposure: Exposure) -> f64 {
        let steps = 200_000;
        let length = (exposure.end.0 - exposure.start.0) as f64 / f64::from(steps);
        let value = |t: f64| {
            let k = knots.partition_point(|&knot| knot as f64 <= t);
            if k == 0 || k == knots.len() {
                return current[k.min(knots.len() - 1)];
            }
            let share = (t - knots[k - 1] as f64) / (knots[k] - knots[k - 1]) as f64;
            libm::pow(current[k - 1], 1.0 - share) * libm::pow(current[k], share)
        };
        (0..steps)
            .map(|n| value(exposure.start.0 as f64 + (f64::from(n) + 0.5) * length) * length)
            .sum::<f64>()
            / 1e9
    }

    #[test]
    fn log_linear_light_is_integrated_exactly_inside_across_and_outside_knots() {
        let track = LogLinearTrack::new(&KNOTS, &CURRENT);
        for (start, end) in [(0, 50), (0, 150), (110, 190), (150, 350), (0, 900), (350, 450), (500, 501)] {
            let exposure = Exposure::new(start, end);
            let (exact, steps) = (track.integral(exposure), stepped(&KNOTS, &CURRENT, exposure));
            // The midpoint rule errs by (length / steps)^2 times the curvature, and by one step at each
            // corner.
            assert!((exact / steps - 1.0).abs() < 1e-5, "{start} to {end}: {exact} against {steps}");
        }
    }

    #[test]
    fn equal_values_and_jumps_and_darkness_are_no_trouble() {
        let at = |knots: &[i64], current: &[f32]| {
            LogLinearTrack::new(knots, current).integral(Exposure::new(0, 20))
        };
        assert!((at(&[0, 10, 20], &[2.0, 2.0, 2.0]) - 40e-9).abs() < 1e-20);
        assert!((at(&[0, 10, 10, 20], &[1.0, 1.0, 3.0, 3.0]) - 40e-9).abs() < 1e-20);
        assert!(at(&[0, 20], &[0.0, 0.0]) < 1e-40);
        assert!((at(&[5], &[2.0]) - 40e-9).abs() < 1e-20);
    }

    proptest! {
        #[test]
        fn cursors_and_many_at_once_give_the_same_bits_as_a_fresh_search(
            gaps in prop::collection::vec(0_i64..500, 1..40),
            windows in prop::collection::vec((-100_i64..400, 0_i64..900), 1..60),
        ) {
            let mut now = -300;
            let knots: Vec<i64> = gaps.iter().map(|gap| { now += gap; now }).collect();
            let current: Vec<f64> = (0..knots.len()).map(|k| 0.1 + (k as f64 * 0.7) % 1.3).collect();
            let track = HeldTrack::new(&knots, &current);
            let mut cursor = ExposureCursor::new(track);
            let joined = LogLinearTrack::new(&knots, &current);
            let mut joined_cursor = ExposureCursor::new(joined);
            let (mut start, mut exposures) = (-500, Vec::new());
            for (advance, length) in windows {
                start += advance; // sometimes backwards, often overlapping
                let exposure = Exposure::new(start, start + length);
                prop_assert_eq!(cursor.integral(exposure).to_bits(), track.integral(exposure).to_bits());
                prop_assert_eq!(
                    joined_cursor.integral(exposure).to_bits(), joined.integral(exposure).to_bits(),
                );
                exposures.push(exposure);
            }
            let mut many = ManyExposures::default();
            for _ in 0..2 {
                for (integral, exposure) in many.of(&joined, &exposures).iter().zip(&exposures) {
                    prop_assert_eq!(integral.to_bits(), joined.integral(*exposure).to_bits());
                }
            }
        }
    }
}
