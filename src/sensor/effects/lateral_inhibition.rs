//! Lateral inhibition: what the surround sees is subtracted from what the pixel sees.
//!
//! Neighbouring pixels are coupled behind the logarithm (a resistive network, a shared supply), so the pixel
//! answers to `ln i - fraction * mean of ln i over its eight neighbours`. A change common to all pixels is
//! weakened to `1 - fraction` of itself; a lone spot keeps its full contrast, and pixels next to an edge see
//! a shadow of the other sign. Typical: 5 to 50 % where it is wanted, about 1 % where it is not.
//!
//! A common threshold error weakens all changes alike; here the deficit follows the neighbours' change.
//!
//! Source: Delbruck, Li, Graca and McReynolds, "Utility and feasibility of a center surround event camera"
//! (2022). Limits: the surround is that of the settled voltages, without a delay of its own; the simulated
//! pixel gets `exp` of the difference as its photocurrent, so time constants follow that and not the pixel's
//! own light; at the array's edge the nearest pixel stands in.

use super::sought::{SHARE, Search, Size, Sought};
use super::{Domain, Effect, EffectDecl, EffectKind, Kernel, ParameterDecl, Parameters, Stage, Tap, Unit};

/// The catalogue entry.
pub const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "lateral_inhibition",
        stage: Stage::Comparator,
        about: "The mean of the surround is subtracted from the pixel's own voltage",
        equation: "V_DC = ln i - fraction * mean(ln i of the 8 neighbours)",
        parameters: &[ParameterDecl {
            name: "fraction",
            unit: Unit::Number("fraction"),
            null: Some(0.0),
            allowed: (0.0, 1.0),
            plausible: (0.01, 0.9),
            about: "share of the surround's mean voltage that is subtracted",
        }],
        covariate: "laplacian",
        signature: "a change of the whole field makes too few events; next to an edge events of the other \
                    sign",
        confused_with: &["threshold_scale", "crosstalk", "blur"],
        source: "Delbruck et al. 2022",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Fixed(0.4),
            material: SHARE,
            ..Sought::positive("fraction")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(LateralInhibition { fraction: parameters.need("fraction")? }))
}

/// Subtraction of the surround.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LateralInhibition {
    /// Share of the surround's mean that is subtracted, 0 to 1.
    pub fraction: f64,
}

impl Effect for LateralInhibition {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn kernel(&self) -> Option<Kernel> {
        let weight = |dx, dy| if (dx, dy) == (0, 0) { 1.0 } else { -self.fraction / 8.0 };
        let taps =
            (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| Tap { dx, dy, weight: weight(dx, dy) })).collect();
        (self.fraction != 0.0).then_some(Kernel { domain: Domain::Log, taps })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the middle pixel sees when pixels changed by `change(dx, dy)`.
    fn seen(fraction: f64, change: impl Fn(i32, i32) -> f64) -> f64 {
        let kernel = LateralInhibition { fraction }.kernel().unwrap();
        assert_eq!(kernel.domain, Domain::Log);
        kernel.taps.iter().map(|tap| tap.weight * change(tap.dx, tap.dy)).sum()
    }

    #[test]
    fn a_change_of_the_whole_field_is_weakened_by_the_fraction() {
        assert!((seen(0.3, |_, _| 0.5) - 0.7 * 0.5).abs() < 1e-15);
    }

    #[test]
    fn a_lone_spot_keeps_its_contrast() {
        assert_eq!(seen(0.3, |dx, dy| if (dx, dy) == (0, 0) { 0.5 } else { 0.0 }), 0.5);
    }

    #[test]
    fn next_to_an_edge_the_shadow_has_the_other_sign() {
        let shadow = seen(0.3, |dx, _| if dx > 0 { 0.5 } else { 0.0 });
        assert!((shadow + 0.3 * 3.0 / 8.0 * 0.5).abs() < 1e-15);
    }

    #[test]
    fn nothing_subtracted_is_no_kernel() {
        assert_eq!(LateralInhibition::default().kernel(), None);
    }
}
