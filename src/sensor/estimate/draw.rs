//! Intervals by drawing again: the same estimate from units drawn at random with replacement, and the middle
//! 95 % of what comes out.

use photocurrent_core::random::Random;

/// Draws: the ends of the interval then have an error of about a tenth of it.
const DRAWS: usize = 200;

/// A value with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its 95 % interval.
    pub ci95: (f64, f64),
}

impl Estimate {
    /// Does the interval hold a value?
    pub fn holds(&self, value: f64) -> bool {
        self.ci95.0 <= value && value <= self.ci95.1
    }
}

/// An estimate from `units` that count once, with the interval from units that count as often as they are
/// drawn. None when the estimate is none, or in a tenth of the draws.
pub fn by_draws(units: usize, of: impl Fn(&[f64]) -> Option<f64>) -> Option<Estimate> {
    let value = of(&vec![1.0; units])?;
    let mut random = Random::new(1, &[units as u64]);
    let mut weights = vec![0.0; units];
    let mut drawn: Vec<f64> = Vec::with_capacity(DRAWS);
    for _ in 0..DRAWS {
        weights.fill(0.0);
        (0..units).for_each(|_| weights[(random.uniform() * units as f64) as usize] += 1.0);
        drawn.extend(of(&weights));
    }
    if drawn.len() * 10 < DRAWS * 9 {
        return None;
    }
    drawn.sort_by(f64::total_cmp);
    let at = |share: f64| drawn[(share * (drawn.len() - 1) as f64).round() as usize];
    Some(Estimate { value, ci95: (at(0.025).min(value), at(0.975).max(value)) })
}

/// Where a curve over even steps has its top, in steps, by a parabola through the largest value and those
/// next to it; none at an end, or where nothing is finite.
pub(super) fn top(curve: &[f64]) -> Option<f64> {
    peak(
        curve,
        (0..curve.len()).filter(|n| curve[*n].is_finite()).max_by(|a, b| curve[*a].total_cmp(&curve[*b]))?,
    )
}

/// The same, when it is known which value is the largest.
pub(super) fn peak(curve: &[f64], best: usize) -> Option<f64> {
    let (before, after) = (*curve.get(best.checked_sub(1)?)?, *curve.get(best + 1)?);
    let bend = before - 2.0 * curve[best] + after;
    // Level on all three: the middle.
    let shift = if bend < 0.0 { 0.5 * (before - after) / bend } else { 0.0 };
    Some(best as f64 + shift)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_top_of_a_parabola_is_found_between_its_points() {
        let curve: Vec<f64> = (0..9).map(|n| -(f64::from(n) - 4.3) * (f64::from(n) - 4.3)).collect();
        assert!((top(&curve).unwrap() - 4.3).abs() < 1e-12);
        assert_eq!(top(&[3.0, 2.0, 1.0]), None);
    }

    #[test]
    fn the_interval_of_a_mean_is_that_of_its_standard_error() {
        let mut random = Random::new(3, &[]);
        let values: Vec<f64> = (0..400).map(|_| random.normal()).collect();
        let found = by_draws(values.len(), |weights| {
            Some(values.iter().zip(weights).map(|(v, w)| v * w).sum::<f64>() / 400.0)
        })
        .unwrap();
        // 1.96 / sqrt(400) to each side; the draws leave a tenth.
        let half = 0.5 * (found.ci95.1 - found.ci95.0);
        assert!((half - 0.098).abs() < 0.02, "{half}");
    }
}
