//! Crosstalk: part of a pixel's light ends up in its neighbours.
//!
//! Photons cross under the microlens and charge diffuses to the next photodiode, so the event pixel keeps
//! `1 - fraction` of its own light and takes `fraction / 4` from each of the four nearest. Unlike a blur it
//! reaches one pixel far, whatever the fraction. Typical: 1 to 10 %.
//!
//! Source: textbooks on image sensors, such as Nakamura (2006). Limits: the same for all pixels; only the
//! events' excess over the frames is meant: crosstalk that both share cannot be seen.

use super::sought::{SHARE, Search, Size, Sought};
use super::{Domain, Effect, EffectDecl, EffectKind, Kernel, ParameterDecl, Parameters, Stage, Tap, Unit};

/// The catalogue entry.
pub const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "crosstalk",
        stage: Stage::Light,
        about: "Neighbouring event pixels share light",
        equation: "i_events = (1 - fraction) i + fraction * mean(i of the 4 nearest)",
        parameters: &[ParameterDecl {
            name: "fraction",
            unit: Unit::Number("fraction"),
            null: Some(0.0),
            allowed: (0.0, 1.0),
            plausible: (0.005, 0.4),
            about: "share of a pixel's light that its four nearest neighbours get, a quarter each",
        }],
        covariate: "laplacian",
        signature: "frames differ from what events predict in proportion to pixel minus mean of neighbours; \
                    dark pixels next to bright ones fire too early",
        confused_with: &["blur", "lateral_inhibition", "dark_current"],
        source: "Nakamura 2006",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Fixed(0.25),
            material: SHARE,
            ..Sought::positive("fraction")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(Crosstalk { fraction: parameters.need("fraction")? }))
}

/// Light shared between nearest neighbours.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Crosstalk {
    /// Share that leaves the pixel, 0 to 1.
    pub fraction: f64,
}

impl Effect for Crosstalk {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn kernel(&self) -> Option<Kernel> {
        let own = Tap { dx: 0, dy: 0, weight: 1.0 - self.fraction };
        let nearest =
            [(0, -1), (-1, 0), (1, 0), (0, 1)].map(|(dx, dy)| Tap { dx, dy, weight: 0.25 * self.fraction });
        (self.fraction > 0.0)
            .then(|| Kernel { domain: Domain::Linear, taps: [&[own], &nearest[..]].concat() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(fraction: f64, light: impl Fn(i32, i32) -> f64) -> f64 {
        let kernel = Crosstalk { fraction }.kernel().unwrap();
        assert_eq!(kernel.domain, Domain::Linear);
        kernel.taps.iter().map(|tap| tap.weight * light(tap.dx, tap.dy)).sum()
    }

    #[test]
    fn a_flat_field_and_a_ramp_stay() {
        assert!((seen(0.1, |_, _| 7.0) - 7.0).abs() < 1e-14);
        assert!((seen(0.1, |dx, dy| 7.0 + f64::from(dx - 2 * dy)) - 7.0).abs() < 1e-14);
    }

    #[test]
    fn a_spot_loses_the_fraction_and_each_neighbour_gains_a_quarter_of_it() {
        assert!((seen(0.1, |dx, dy| if (dx, dy) == (0, 0) { 8.0 } else { 0.0 }) - 7.2).abs() < 1e-14);
        assert!((seen(0.1, |dx, dy| if (dx, dy) == (1, 0) { 8.0 } else { 0.0 }) - 0.2).abs() < 1e-14);
    }

    #[test]
    fn nothing_shared_is_no_kernel() {
        assert_eq!(Crosstalk::default().kernel(), None);
    }
}
