//! Vignetting: frames get darker towards the corners and events do not follow, or the other way round.
//!
//! A lens gives a share `cos^4` of its light at an angle off the axis. Light lost to both paths cancels in
//! the logarithm and nobody sees it; what is modelled is the frames' share relative to the light that the
//! event circuit works with. With `r` from 0 (centre) to 1 (corner) and a corner angle `a`,
//! `share = 1 / (1 + r^2 tan^2 a)^2`, and `falloff = 1 - cos^4 a`. Typical: 0.1 to 0.6.
//!
//! Parameter: `falloff`, the share that frames lose at the corner; positive = frames are too dark there
//! (chief-ray angle of the frame pixels). Negative = frames are too bright there: flat-field corrected,
//! although the event circuit did get less light; the curve is then the reciprocal. Either way the frames
//! state a photocurrent that is not the one which sets the time constant: at the corner events come earlier
//! (later) than the frames let expect.
//!
//! Source: the cos^4 law of natural vignetting; EMVA 1288 for its removal.
//! Limits: centred on the array and round; depends on nothing but the radius.

use super::sought::{SHARE, Search, Size, Sought};
use super::{Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, Reading, Site, Stage, Unit};

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "vignetting",
        stage: Stage::Exposure,
        about: "Frames darken towards the corners and events do not (negative: the reverse)",
        equation: "charge = integral of i / (1 + r^2 * ((1 - falloff)^-0.5 - 1))^2, r = 0 (centre) to 1 \
                   (corner)",
        parameters: &[ParameterDecl {
            name: "falloff",
            unit: Unit::Number("fraction"),
            null: Some(0.0),
            allowed: (-10.0, 0.99),
            plausible: (-1.0, 0.7),
            about: "share of the light that frames lose at the corners against the events; negative = gain",
        }],
        covariate: "radius",
        signature: "frames are off by a factor that grows with the radius, at every light; the events' \
                    delay follows the other light",
        confused_with: &["time_constant", "bandwidth_gradient", "black_level"],
        source: "the cos^4 law",
        apart: &[("bandwidth_gradient", "an even bright surface: vignetting shows in a single frame")],
        search: Search::For(&[Sought {
            typical: Size::Fixed(0.3),
            material: SHARE,
            ..Sought::both("falloff")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(Vignetting { falloff: parameters.need("falloff")? }))
}

/// A fall of the frames' light towards the corners.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Vignetting {
    /// Share lost at the corners, below 1; negative = gained.
    pub falloff: f64,
}

impl Vignetting {
    /// The frames' share of the light at `radius`, 0 (centre) to 1 (corner).
    pub(super) fn share(&self, radius: f64) -> f64 {
        let corner = 1.0 - self.falloff;
        let (loss, power) = if self.falloff >= 0.0 { (1.0 / corner, -2.0) } else { (corner, 2.0) };
        libm::pow(1.0 + radius * radius * (libm::sqrt(loss) - 1.0), power)
    }
}

impl Effect for Vignetting {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn charge(&self, site: &Site, _reading: &Reading, charge: f64) -> f64 {
        charge * self.share(site.radius())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const READING: Reading =
        Reading { frame: 0, previous_charge: 0.0, gain: 850.0, black_level: 16.0, saturation: 1023.0 };

    fn charge(falloff: f64, x: u32, y: u32) -> f64 {
        Vignetting { falloff }.charge(&Site { x, y, width: 9, height: 7, seed: 1 }, &READING, 2.0)
    }

    #[test]
    fn the_centre_keeps_its_light_and_every_corner_loses_the_falloff() {
        assert_eq!(charge(0.4, 4, 3), 2.0);
        for (x, y) in [(0, 0), (8, 0), (0, 6), (8, 6)] {
            assert!((charge(0.4, x, y) - 2.0 * 0.6).abs() < 1e-14);
        }
    }

    #[test]
    fn between_them_it_is_the_fourth_power_of_the_cosine() {
        // A corner at 45 degrees: half way out the tangent is 1/2, and cos^4 = 1 / (1 + 1/4)^2.
        let falloff = 1.0 - 0.25;
        assert!((Vignetting { falloff }.share(0.5) - 0.64).abs() < 1e-14);
        assert!((Vignetting { falloff }.share(1.0) - 0.25).abs() < 1e-14);
    }

    #[test]
    fn a_flat_field_correction_is_the_reciprocal() {
        // Multiplying by 1 / 0.6 at the corner is a gain of 2/3.
        let (loses, gains) = (Vignetting { falloff: 0.4 }, Vignetting { falloff: -2.0 / 3.0 });
        assert!(
            [0.0, 0.3, 0.7, 1.0]
                .iter()
                .all(|&radius| (loses.share(radius) * gains.share(radius) - 1.0).abs() < 1e-14)
        );
    }
}
