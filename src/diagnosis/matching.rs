//! How well a template explains a deviation: a strength and what is gained in likelihood.
//!
//! Summaries go together, so the sum over them is divided by twelve. Deviation and template are both known only to a share of themselves: the scene is reconstructed,
//! and strengths do not act linearly. That share enters by the deviation and by the template as it was made, not as it is scaled: a variance that grew with the
//! strength would pull it down.

/// Degrees of freedom of a summary's deviation: nearly normal.
const FREEDOM: f64 = 20.0;
/// Number of summaries that count as one.
const TOGETHER: f64 = 12.0;
/// Deviations and templates are known to this share.
const SHARE: f64 = 0.1;

/// The best strength of a template, as a factor on it, and the gain in log-likelihood over none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Match {
    /// Factor on the template.
    pub factor: f64,
    /// Nats over no effect.
    pub gain: f64,
}

/// Minus log-likelihood of deviations in spreads, none being exact.
pub fn misfit(z: &[f64]) -> f64 {
    misfit_with(z, z, 0.0)
}

fn one(z: f64) -> f64 {
    0.5 * (FREEDOM + 1.0) * libm::log1p(z * z / FREEDOM)
}

/// Minus log-likelihood with a template times a factor taken away.
pub fn misfit_with(z: &[f64], template: &[f64], factor: f64) -> f64 {
    let part = |(z, t): (&f64, &f64)| one((z - factor * t) / libm::sqrt(1.0 + SHARE * SHARE * (z * z + t * t)));
    z.iter().zip(template).map(part).sum::<f64>() / TOGETHER
}

/// The factor of a size within `range` that explains most, by a grid of quarter octaves and a bisection around its best. Factors below zero too with `both`.
pub fn best(z: &[f64], template: &[f64], range: (f64, f64), both: bool) -> Match {
    let without = misfit_with(z, template, 0.0);
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
    let widths: &[f64] = if range.0 < range.1 { &[1.09, 1.045, 1.022, 1.011] } else { &[] };
    for width in widths {
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
