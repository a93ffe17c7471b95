//! Threshold gradient: pixels on one side of the array fire at a smaller contrast than those on the other.
//!
//! The bias that sets the threshold comes in on one side and loses some voltage on its way across the array,
//! or the wafer's doping changes slowly along it. ON and OFF scale together. Typical: up to some per cent
//! from the centre to an edge.
//!
//! Source: Pelgrom, Duinmaijer, Welbers, "Matching properties of MOS transistors" (1989): the part of a
//! mismatch that depends on distance. Limits: linear in the column; nothing along the rows. The fine-grained
//! part is `threshold_mismatch`.

use super::sought::{GAIN, Search, Size, Sought};
use super::{
    Effect, EffectDecl, EffectKind, History, ParameterDecl, Parameters, Site, Stage, Thresholds, Unit,
};
use photocurrent_core::random::Random;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "threshold_gradient",
        stage: Stage::Comparator,
        about: "Both thresholds grow from the first column to the last",
        equation: "threshold(x) = threshold * (1 + fraction * u), u from -1 (first column) to +1 (last)",
        parameters: &[ParameterDecl {
            name: "fraction",
            unit: Unit::Number("fraction"),
            null: Some(0.0),
            allowed: (-0.95, 0.95),
            plausible: (-0.3, 0.3),
            about: "relative change at the edge columns: +fraction in the last, -fraction in the first",
        }],
        covariate: "column",
        signature: "events count for more contrast on one side of the array than on the other, linear in \
                    the column, same sense for ON and OFF",
        confused_with: &["bandwidth_gradient", "vignetting", "threshold_scale"],
        source: "Pelgrom, Duinmaijer, Welbers 1989",
        apart: &[(
            "bandwidth_gradient",
            "the same scene in brighter light: a bandwidth matters less, a threshold as before",
        )],
        search: Search::For(&[Sought {
            typical: Size::Fixed(0.2),
            material: GAIN,
            ..Sought::both("fraction")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(ThresholdGradient { fraction: parameters.need("fraction")? }))
}

/// Thresholds that change linearly along the columns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ThresholdGradient {
    /// Relative change at the last column; the first has the opposite. Above -1 and below 1.
    pub fraction: f64,
}

impl Effect for ThresholdGradient {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn thresholds(
        &self,
        site: &Site,
        _history: &History,
        _random: &mut Random,
        _t_reset_ns: i64,
        thresholds: &mut Thresholds,
    ) {
        let factor = 1.0 + self.fraction * site.across();
        thresholds.on *= factor;
        thresholds.off *= factor;
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::{MS, Samples, count, ideal_pixel, recorded_at};
    use super::super::testing::{described, site};
    use super::*;
    use serde_json::json;

    fn at(x: u32, y: u32) -> Thresholds {
        let mut thresholds = Thresholds { on: 0.2, off: 0.25 };
        let effect = described("threshold_gradient", json!({ "fraction": 0.1 }));
        effect.thresholds(&site(x, y), &History::default(), &mut Random::new(1, &[]), 0, &mut thresholds);
        thresholds
    }

    #[test]
    fn the_edge_columns_differ_by_the_fraction_and_rows_do_not() {
        for (x, on, off) in [(0, 0.18, 0.225), (199, 0.22, 0.275)] {
            for y in [0, 50, 99] {
                assert!((at(x, y).on - on).abs() < 1e-12 && (at(x, y).off - off).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn columns_between_lie_on_a_line() {
        // 199 steps over 0.04.
        for x in 0..200 {
            assert!((at(x, 3).on - (0.18 + 0.04 * f64::from(x) / 199.0)).abs() < 1e-12);
        }
    }

    #[test]
    fn one_edge_fires_more_often_than_the_other() {
        let ramp = Samples::of_log(100 * MS, |t| 50.0 * t);
        let events = |x| {
            let effects = vec![described("threshold_gradient", json!({ "fraction": 0.1 }))];
            count(&recorded_at(&site(x, 3), ideal_pixel(), effects, &ramp, 100 * MS), 1)
        };
        // A rise of 5 over 0.18 and over 0.22.
        assert_eq!((events(0), events(199)), (27, 22));
    }
}
