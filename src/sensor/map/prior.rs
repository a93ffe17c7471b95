//! What is expected of log light before any measurement: it moves with a speed that lasts a while and differs
//! from place to place in time.
//!
//! The increment over segment j is `w_j = sqrt(q_j) z_j` with z of unit variance, correlated between
//! neighbours like `exp(-distance / memory)`. Its variance is the local one:
//! `q_j = s_j^2 (floor^2 + mean square slope nearby)`, taken anew from the estimate in every iteration. Quiet
//! stretches stay quiet, edges may be steep: an empirical-Bayes relative of a heavy-tailed prior that pools
//! over time. `s_j` is how far a slope of one that lasts for the memory m takes light over the segment's
//! length h, root mean square: `s^2 = 2 m^2 (h / m - 1 + exp(-h / m))`, which is h^2 for a short segment and
//! 2 m h for a long one. So knots may stand anywhere.
//!
//! In addition there are the two families with Student's t, each place for itself: [`Family::Walk`], whose
//! increments are independent, and [`Family::IntegratedWalk`], whose slopes change by independent increments
//! (an integrated Wiener process). Their weights are those of iteratively re-weighted least squares: the
//! variance of an increment e with scale s^2 and nu degrees of freedom is `(nu s^2 + e^2) / (nu + 1)`.

use crate::elementary::{exp, exp_m1};
use multiversion::multiversion;

/// The constants of the family with local variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Local {
    /// Slope that is always allowed, natural-log units per second.
    pub floor_per_s: f64,
    /// How long a slope lasts, seconds.
    pub memory_s: f64,
    /// Slopes up to this far away count for the local variance, seconds.
    pub reach_s: f64,
}

/// What is expected of log light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Prior {
    /// Slopes that last a while, with a variance of their own at every place.
    Local(Local),
    /// Independent increments with Student's t: variance per second, and degrees of freedom.
    Walk {
        /// Squared scale of an increment over its time, natural-log units squared per second.
        per_s: f64,
        /// Degrees of freedom.
        nu: f64,
    },
    /// Slopes that change by independent increments with Student's t.
    IntegratedWalk {
        /// Squared scale of a change of slope over its time, per second cubed.
        per_s3: f64,
        /// Degrees of freedom.
        nu: f64,
    },
}

impl Prior {
    /// Suits most recordings.
    pub const USUAL: Prior = Prior::Local(Local::USUAL);
}

impl Local {
    /// Suits most recordings.
    pub const USUAL: Local = Local { floor_per_s: 6.0, memory_s: 2.0e-3, reach_s: 0.25e-3 };
}

impl Default for Prior {
    fn default() -> Prior {
        Prior::USUAL
    }
}

/// Variance of the first slope of an integrated walk, per second squared: any speed will do.
pub const FIRST_SLOPE_VARIANCE: f64 = 1e6;

/// The prior of each segment of one pixel: entry j belongs to the segment that ends at knot j; entry 0 to
/// none.
#[derive(Clone, Debug, Default)]
pub(super) struct Segments {
    /// Length, seconds.
    pub length_s: Vec<f64>,
    /// One over it.
    pub per_s: Vec<f64>,
    /// Correlation of z with the segment before; 0 for the first.
    pub correlation: Vec<f64>,
    /// s, seconds.
    pub reach_s: Vec<f64>,
    /// Variance of z given the one before: with local variance, one less the correlation's square.
    pub fresh: Vec<f64>,
    /// First and last segment that count for the local variance, and one over their length in seconds.
    pub nearby: Vec<(u32, u32)>,
    pub per_nearby: Vec<f64>,
    pub middle_s: Vec<f64>,
}

impl Segments {
    /// Lengths, correlations and neighbourhoods of the segments between knots.
    pub(super) fn lay(&mut self, t_ns: &[i64], prior: &Prior) {
        let knots = t_ns.len();
        for column in [
            &mut self.length_s,
            &mut self.per_s,
            &mut self.correlation,
            &mut self.reach_s,
            &mut self.fresh,
            &mut self.per_nearby,
            &mut self.middle_s,
        ] {
            // All entries but the first are set below or before they are asked for; the first stays 0.
            column.resize(knots, 0.0);
        }
        measure(t_ns, &mut self.length_s, &mut self.per_s, &mut self.middle_s);
        match prior {
            Prior::Local(local) => self.lay_local(t_ns, local),
            Prior::Walk { .. } => {
                self.correlation.fill(0.0);
                self.fresh.fill(1.0);
            }
            Prior::IntegratedWalk { .. } => {
                self.correlation.fill(1.0);
                if knots > 1 {
                    self.correlation[1] = 0.0;
                }
            }
        }
    }

    fn lay_local(&mut self, t_ns: &[i64], prior: &Local) {
        let knots = t_ns.len();
        spread(&self.length_s, prior.memory_s, &mut self.reach_s);
        correlate(&self.middle_s, 1.0 / prior.memory_s, &mut self.correlation, &mut self.fresh);
        // Middles are rounded: a neighbour exactly at the reach counts.
        let reach_s = prior.reach_s * 1.001;
        let (mut low, mut high) = (1, 1);
        self.nearby.clear();
        self.nearby.resize(knots, (0, 0));
        for j in 1..knots {
            while high < knots && self.middle_s[high] <= self.middle_s[j] + reach_s {
                high += 1;
            }
            while self.middle_s[low] < self.middle_s[j] - reach_s {
                low += 1;
            }
            self.nearby[j] = (low as u32, high as u32 - 1);
            self.per_nearby[j] = 1e9 / (t_ns[high - 1] - t_ns[low - 1]) as f64;
        }
    }
}

/// Lengths, one over them, and middles counted from the first knot.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
fn measure(t_ns: &[i64], length_s: &mut [f64], per_s: &mut [f64], middle_s: &mut [f64]) {
    let n = t_ns.len();
    let (first, before, here) = (t_ns[0], &t_ns[..n - 1], &t_ns[1..]);
    let (length_s, per_s, middle_s) = (&mut length_s[1..n], &mut per_s[1..n], &mut middle_s[1..n]);
    for k in 0..n - 1 {
        length_s[k] = (here[k] - before[k]) as f64 * 1e-9;
        per_s[k] = 1.0 / length_s[k];
        middle_s[k] = 0.5 * ((here[k] - first) as f64 * 1e-9 + (before[k] - first) as f64 * 1e-9);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
fn spread(length_s: &[f64], memory_s: f64, reach_s: &mut [f64]) {
    let per_memory = 1.0 / memory_s;
    for (reach_s, length_s) in reach_s.iter_mut().zip(length_s) {
        let x = length_s * per_memory;
        // Over h^2; the difference is lost in rounding for short segments.
        let short = 1.0 - x * (1.0 / 3.0 - x * (1.0 / 12.0 - x * (1.0 / 60.0)));
        let long = 2.0 * (x + exp_m1(-x)) / (x * x);
        *reach_s = length_s * (if x < 1e-3 { short } else { long }).sqrt();
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
fn correlate(middle_s: &[f64], per_memory: f64, correlation: &mut [f64], fresh: &mut [f64]) {
    let n = middle_s.len();
    let (before, here) = (&middle_s[..n - 1], &middle_s[1..]);
    for (((correlation, fresh), before), here) in
        correlation[1..n].iter_mut().zip(&mut fresh[1..n]).zip(before).zip(here)
    {
        let distance = (here - before) * per_memory;
        *correlation = exp(-distance);
        *fresh = -exp_m1(-2.0 * distance);
    }
    if n > 1 {
        (correlation[1], fresh[1]) = (0.0, 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_increment_has_the_variance_of_a_slope_with_memory() {
        let prior = Prior::Local(Local { floor_per_s: 5.0, memory_s: 2e-3, reach_s: 0.25e-3 });
        for length_ns in [1_000, 1_990, 2_010, 250_000, 2_000_000, 16_000_000] {
            let mut segments = Segments::default();
            segments.lay(&[0, length_ns], &prior);
            let scale = 5.0 * segments.reach_s[1];
            // The double integral of floor^2 exp(-|s - t| / memory) over the segment, by midpoints.
            let (pieces, h) = (500, length_ns as f64 * 1e-9);
            let piece = h / f64::from(pieces);
            let covariance = |a: i32, b: i32| 25.0 * libm::exp(-f64::from((a - b).abs()) * piece / 2e-3);
            let variance: f64 =
                (0..pieces).map(|a| (0..pieces).map(|b| covariance(a, b)).sum::<f64>()).sum::<f64>()
                    * piece
                    * piece;
            assert!((scale * scale / variance - 1.0).abs() < 1e-4, "{length_ns} ns");
        }
    }

    #[test]
    fn a_slope_that_lasts_forgets_itself_like_an_exponential() {
        let prior = Prior::Local(Local { floor_per_s: 5.0, memory_s: 2e-3, reach_s: 0.25e-3 });
        let mut segments = Segments::default();
        segments.lay(&[0, 300_000, 1_300_000, 1_310_000], &prior);
        // Middles 0.65 and 0.505 ms apart.
        for (j, apart_s) in [(2, 0.65e-3), (3, 0.505e-3)] {
            let correlation = libm::exp(-apart_s / 2e-3);
            assert!((segments.correlation[j] - correlation).abs() < 1e-12);
            assert!((segments.fresh[j] - (1.0 - correlation * correlation)).abs() < 1e-12);
        }
    }
}
