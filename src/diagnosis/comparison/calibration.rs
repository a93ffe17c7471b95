//! Are rescaled intervals what they should be? The recording's against those of a simulated recording of the same description that was treated alike.
//!
//! Under the right sensor and the true light, rescaled intervals are uniform ([`photocurrent_sensor::likelihood`]). Estimated light is not the true light: it was fitted to
//! the same events, which makes every interval look better than it is. So each number is replaced by its rank among those of the control, whose light was estimated in the
//! same way: where the description is right, ranks are uniform, whatever the estimation does.
//!
//! Events of one pixel are not independent of each other: the band is from block to block, of both.

use photocurrent_sensor::likelihood::ks_uniform;

/// Fewest intervals of either side.
const FEWEST: usize = 100;
/// Steps of the curve.
const STEPS: usize = 50;

/// Ranks of rescaled intervals among those of the control.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// Largest distance of their distribution from the uniform one (Kolmogorov and Smirnov).
    pub ks: f64,
    /// Where the points of `found` stand: from 0 to 1.
    pub expected: Vec<f64>,
    /// The quantile of the ranks at each.
    pub found: Vec<f64>,
    /// So far from `expected` 95 % of the recordings of the described sensor lie, at each.
    pub half_width: Vec<f64>,
    /// Intervals of the recording.
    pub count: usize,
}

impl Calibration {
    /// From the rescaled intervals of the recording and of the control, each with the number of its block; none with fewer than a hundred of either.
    pub fn new(recorded: &[(u32, f64)], control: &[(u32, f64)]) -> Option<Calibration> {
        if recorded.len() < FEWEST || control.len() < FEWEST {
            return None;
        }
        let mut sorted: Vec<f64> = control.iter().map(|(_, u)| *u).collect();
        sorted.sort_by(f64::total_cmp);
        let rank = |u: f64| {
            let (below, upto) = (sorted.partition_point(|other| *other < u), sorted.partition_point(|other| *other <= u));
            (0.5 * (below + upto) as f64 + 0.5) / (sorted.len() + 1) as f64
        };
        let ranks: Vec<(u32, f64)> = recorded.iter().map(|(block, u)| (*block, rank(*u))).collect();
        let own: Vec<(u32, f64)> = control.iter().map(|(block, u)| (*block, rank(*u))).collect();
        let mut uniform: Vec<f64> = ranks.iter().map(|(_, rank)| *rank).collect();
        let ks = ks_uniform(&mut uniform);
        let expected: Vec<f64> = (0..=STEPS).map(|step| step as f64 / STEPS as f64).collect();
        let found = expected.iter().map(|at| uniform[((at * uniform.len() as f64) as usize).min(uniform.len() - 1)]).collect();
        let (a, b) = (variances(&ranks, &expected), variances(&own, &expected));
        let half_width = a.iter().zip(&b).map(|(a, b)| 1.96 * libm::sqrt(a + b)).collect();
        Some(Calibration { ks, expected, found, half_width, count: recorded.len() })
    }
}

/// Variance of the distribution at each point, from block to block.
fn variances(ranks: &[(u32, f64)], at: &[f64]) -> Vec<f64> {
    let blocks = ranks.iter().map(|(block, _)| *block as usize + 1).max().unwrap_or(0);
    let mut counts = vec![0.0; blocks];
    let mut below = vec![vec![0.0; at.len()]; blocks];
    for (block, rank) in ranks {
        counts[*block as usize] += 1.0;
        let first = at.partition_point(|at| at < rank);
        below[*block as usize][first..].iter_mut().for_each(|count| *count += 1.0);
    }
    let all: f64 = counts.iter().sum();
    let used = counts.iter().filter(|count| **count > 0.0).count() as f64;
    let one = |k: usize| {
        let share = below.iter().map(|below| below[k]).sum::<f64>() / all;
        let squares: f64 = below.iter().zip(&counts).map(|(below, count)| (below[k] - share * count) * (below[k] - share * count)).sum();
        used / f64::max(used - 1.0, 1.0) * squares / (all * all)
    };
    (0..at.len()).map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::random::Random;

    /// Numbers of ten blocks, each raised to a power: no uniform ones, as those of estimated light are.
    fn numbers(seed: u64, power: f64) -> Vec<(u32, f64)> {
        let mut random = Random::new(seed, &[]);
        (0..2000).map(|k| (k % 10, libm::pow(random.uniform(), power))).collect()
    }

    #[test]
    fn what_is_like_its_control_is_calibrated_however_far_from_uniform() {
        let found = Calibration::new(&numbers(1, 0.4), &numbers(2, 0.4)).unwrap();
        // 1.63 times the root of 1/n + 1/m is exceeded once in a hundred times.
        assert!(found.ks < 1.63 * libm::sqrt(2.0 / 2000.0), "{}", found.ks);
        let inside = (0..found.expected.len()).filter(|&k| (found.found[k] - found.expected[k]).abs() <= found.half_width[k] + 1e-3).count();
        assert!(inside * 10 >= found.expected.len() * 8, "{inside} of {}", found.expected.len());
        // Of independent numbers the band is that of two samples of 2000.
        let middle = found.half_width[STEPS / 2];
        let independent = 1.96 * libm::sqrt(0.25 / 2000.0 + 0.25 / 2000.0);
        assert!(middle > 0.5 * independent && middle < 2.0 * independent, "{middle} {independent}");
    }

    #[test]
    fn what_is_not_like_its_control_differs_by_as_much_as_the_laws_do() {
        // The distributions x^(1/0.4) and x differ most where the derivative of x - x^2.5 is nought.
        let found = Calibration::new(&numbers(1, 0.4), &numbers(2, 1.0)).unwrap();
        let x = libm::pow(1.0 / 2.5, 1.0 / 1.5);
        assert!((found.ks - (x - libm::pow(x, 2.5))).abs() < 0.05, "{}", found.ks);
    }

    #[test]
    fn of_a_few_intervals_nothing_is_told() {
        assert!(Calibration::new(&numbers(1, 1.0)[..99], &numbers(2, 1.0)).is_none());
    }
}
