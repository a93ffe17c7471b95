//! How well a template explains a deviation: a strength and what is gained in likelihood.
//!
//! Deviations are heavy-tailed and summaries go together, so each summary counts as a Student-t variable and the sum is divided by twelve. A template is wrong
//! by a share of itself: the scene is reconstructed, and strengths do not act linearly.

/// Degrees of freedom of a summary's deviation.
const FREEDOM: f64 = 4.0;
/// Number of summaries that count as one.
const TOGETHER: f64 = 12.0;
/// A template is known to this share.
const TEMPLATE_SHARE: f64 = 0.25;

/// The best strength of a template, as a factor on it, and the gain in log-likelihood over none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Match {
    /// Factor on the template.
    pub factor: f64,
    /// Nats over no effect.
    pub gain: f64,
}

/// Minus log-likelihood of deviations in spreads.
pub fn misfit(z: &[f64]) -> f64 {
    z.iter().map(|z| one(*z)).sum::<f64>() / TOGETHER
}

fn one(z: f64) -> f64 {
    0.5 * (FREEDOM + 1.0) * libm::log1p(z * z / FREEDOM)
}

/// Minus log-likelihood with a template times a factor taken away, which widens what it touches.
pub fn misfit_with(z: &[f64], template: &[f64], factor: f64) -> f64 {
    let sum: f64 = z
        .iter()
        .zip(template)
        .map(|(z, t)| {
            let (moved, wide) = (factor * t, TEMPLATE_SHARE * factor * t);
            let variance = 1.0 + wide * wide;
            one((z - moved) / libm::sqrt(variance)) + 0.5 * libm::log(variance)
        })
        .sum();
    sum / TOGETHER
}

/// The factor of a size within `range` that explains most, by a grid of quarter octaves and a bisection around its best. Factors below zero too with `both`.
pub fn best(z: &[f64], template: &[f64], range: (f64, f64), both: bool) -> Match {
    let without = misfit(z);
    let mut found = Match::default();
    let consider = |factor: f64, found: &mut Match| {
        let gain = without - misfit_with(z, template, factor);
        if gain > found.gain {
            *found = Match { factor, gain };
        }
    };
    let mut factor = range.0;
    while factor <= range.1 {
        consider(factor, &mut found);
        if both {
            consider(-factor, &mut found);
        }
        factor *= 1.19;
    }
    for width in [1.09, 1.045, 1.022, 1.011] {
        let middle = found.factor;
        consider(middle / width, &mut found);
        consider(middle * width, &mut found);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_multiple_of_the_template_is_found_and_noise_is_not() {
        let template: Vec<f64> = (0..60).map(|n| 4.0 * libm::sin(f64::from(n))).collect();
        let noise: Vec<f64> = (0..60).map(|n| libm::cos(2.7 * f64::from(n) + 1.0)).collect();
        let z: Vec<f64> = template.iter().zip(&noise).map(|(t, n)| 1.7 * t + n).collect();
        let found = best(&z, &template, (0.1, 8.0), true);
        assert!((found.factor / 1.7 - 1.0).abs() < 0.1 && found.gain > 3.0, "{found:?}");
        assert!(best(&noise, &template, (0.1, 8.0), false).gain < 0.3);
    }
}
