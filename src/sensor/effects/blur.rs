//! Blur: the events see a softer image than the frames.
//!
//! The event pixel is larger, collects from a wider neighbourhood or stands behind other optics, so its light
//! is that of the frames, convolved with a Gaussian. Events of fine detail become weaker and of sharp edges
//! spread out. Typical: 0.2 to 1.5 pixels.
//!
//! The kernel is the discrete Gaussian `exp(-s^2) I_n(s^2)` along each axis (`I_n`: modified Bessel
//! function), not samples of the bell curve: its standard deviation is `s` exactly, also well below a pixel,
//! and two blurs add up as they should.
//!
//! Source: Lindeberg, "Scale-space for discrete signals" (1990). Limits: the same for all pixels and
//! directions; a blur that both paths share cannot be seen and is not meant here.

use super::sought::{Grows, Search, Size, Sought};
use super::{Domain, Effect, EffectDecl, EffectKind, Kernel, ParameterDecl, Parameters, Stage, Tap, Unit};

/// Parts of the kernel below this are left out; the rest is scaled to the sum 1.
const LEAST_WEIGHT: f64 = 1e-7;

/// The catalogue entry.
pub const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "blur",
        stage: Stage::Light,
        about: "Events see a softer image than frames",
        equation: "i_events = i_frames convolved with a Gaussian of width sigma",
        parameters: &[ParameterDecl {
            name: "sigma",
            unit: Unit::Number("px"),
            null: Some(0.0),
            allowed: (0.0, 5.0),
            plausible: (0.1, 2.0),
            about: "standard deviation of the Gaussian along each axis, pixels of the events",
        }],
        covariate: "laplacian",
        signature: "frames differ from what events predict in proportion to the curvature of the image",
        confused_with: &["crosstalk", "lateral_inhibition", "misalignment"],
        source: "Lindeberg 1990 (the discrete Gaussian)",
        apart: &[(
            "crosstalk",
            "a slanted sharp edge: blur widens it to both sides by its sigma, crosstalk \
                                adds a fixed share of the next pixel only",
        )],
        search: Search::For(&[Sought {
            typical: Size::Fixed(0.8),
            grows: Grows::WithSquare,
            ..Sought::positive("sigma")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(Blur { sigma_px: parameters.need("sigma")? }))
}

/// A Gaussian blur of the event image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Blur {
    /// Standard deviation along each axis, pixels, 0 to 5.
    pub sigma_px: f64,
}

impl Effect for Blur {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn kernel(&self) -> Option<Kernel> {
        if self.sigma_px == 0.0 {
            return None;
        }
        let half: Vec<f64> = (0..)
            .map(|n| discrete_gaussian(n, self.sigma_px * self.sigma_px))
            .take_while(|&weight| weight > LEAST_WEIGHT)
            .collect();
        let reach = half.len() as i32 - 1;
        let mut taps = Vec::new();
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let weight = half[dx.unsigned_abs() as usize] * half[dy.unsigned_abs() as usize];
                if weight > LEAST_WEIGHT {
                    taps.push(Tap { dx, dy, weight });
                }
            }
        }
        let sum: f64 = taps.iter().map(|tap| tap.weight).sum();
        taps.iter_mut().for_each(|tap| tap.weight /= sum);
        Some(Kernel { domain: Domain::Linear, taps })
    }
}

/// `exp(-variance) I_n(variance)`, by the series of `I_n`: all its terms are positive, so no digits are lost.
fn discrete_gaussian(n: u32, variance: f64) -> f64 {
    let half = 0.5 * variance;
    let mut term = (1..=n).fold(libm::exp(-variance), |term, k| term * half / f64::from(k));
    let mut sum = 0.0;
    let mut m = 0.0;
    while term > 1e-17 * sum {
        sum += term;
        m += 1.0;
        term *= half * half / (m * (m + f64::from(n)));
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taps(sigma_px: f64) -> Vec<Tap> {
        let kernel = Blur { sigma_px }.kernel().unwrap();
        assert_eq!(kernel.domain, Domain::Linear);
        kernel.taps
    }

    #[test]
    fn weights_are_positive_and_sum_to_one() {
        for sigma in [0.05, 0.3, 1.0, 2.5, 5.0] {
            assert!(taps(sigma).iter().all(|tap| tap.weight > 0.0));
            assert!((taps(sigma).iter().map(|tap| tap.weight).sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn the_width_is_the_stated_one_along_both_axes() {
        for sigma in [0.1, 0.3, 1.0, 2.5, 5.0] {
            let variance = |along: fn(&Tap) -> i32| {
                taps(sigma).iter().map(|tap| tap.weight * f64::from(along(tap)).powi(2)).sum::<f64>()
            };
            // What is cut off weighs at most a thousandth of the variance.
            for found in [variance(|tap| tap.dx), variance(|tap| tap.dy)] {
                assert!((found.sqrt() / sigma - 1.0).abs() < 1e-3, "sigma {sigma}: {found}");
            }
        }
    }

    #[test]
    fn a_linear_ramp_stays() {
        let mean: f64 = taps(1.3).iter().map(|tap| tap.weight * f64::from(3 * tap.dx - tap.dy)).sum();
        assert!(mean.abs() < 1e-12);
    }

    #[test]
    fn no_width_is_no_kernel() {
        assert_eq!(Blur::default().kernel(), None);
    }
}
