//! Threshold mismatch: no two pixels fire at the same contrast.
//!
//! Transistors of one size differ a little, so each comparator has an offset of its own that stays as long as
//! the sensor lives. A pixel with a high threshold always fires late and rarely, its neighbour early and
//! often: the picture gets a fixed, fine-grained pattern. ON and OFF are two comparators, drawn
//! independently. Typical: 2 to 4 % contrast (0.02 to 0.04).
//!
//! Sources: Lichtsteiner, Posch, Delbruck 2008 (2.1 % contrast); Hu, Liu, Delbruck 2021 (v2e: sigma 0.03 on
//! 0.2). Limits: normal, and no common part of ON and OFF; a pixel far out in the tail is a hot or a dead
//! one.

use super::sought::{Measure, SPREAD, Search, Size, Sought};
use super::{
    Chance, Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, Site, Stage, Thresholds, Unit,
    threshold_scale,
};

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "threshold_mismatch",
        stage: Stage::Comparator,
        about: "Every pixel has thresholds of its own, which stay",
        equation: "threshold_p(x, y) = threshold_p + sigma * z_p(x, y), z ~ N(0, 1) once for each pixel and \
                   polarity",
        parameters: &[ParameterDecl {
            name: "sigma",
            unit: Unit::Number("ln"),
            null: Some(0.0),
            allowed: (0.0, 1.0),
            plausible: (0.003, 0.1),
            about: "standard deviation of a threshold over the pixels, natural-log units",
        }],
        covariate: "pixel",
        signature: "each pixel is early or late by an amount of its own, white over the array and the same \
                    in both halves of a recording",
        confused_with: &["threshold_noise", "refractory_spread", "misalignment", "hot_pixels"],
        source: "Lichtsteiner, Posch, Delbruck 2008; Hu, Liu, Delbruck 2021",
        apart: &[
            ("threshold_noise", "the same scene again: mismatch repeats in each pixel, noise does not"),
            (
                "refractory_spread",
                "the same scene at a third of the speed: a blind time matters a third as \
                                   much, a threshold as before",
            ),
        ],
        search: Search::For(&[Sought {
            typical: Size::Of(0.17, Measure::Threshold),
            material: SPREAD,
            spread_of: Some((threshold_scale::KIND.decl.id, "fraction")),
            ..Sought::random("sigma")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(ThresholdMismatch { sigma: parameters.need("sigma")? }))
}

/// A fixed offset of each pixel's thresholds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ThresholdMismatch {
    /// Standard deviation over the pixels, natural-log units, at least zero.
    pub sigma: f64,
}

impl Effect for ThresholdMismatch {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn offsets(&self, site: &Site) -> Option<Thresholds> {
        let mut own = site.random(KIND.decl.id);
        Some(Thresholds { on: self.sigma * own.normal(), off: self.sigma * own.normal() })
    }

    fn chance(&self) -> Option<Chance> {
        Some(Chance { of_pixels: self.sigma, ..Chance::default() })
    }
}

#[cfg(test)]
mod tests {
    use super::super::History;
    use super::super::simulated::{MS, Samples, ideal_pixel, intervals_s, recorded_at};
    use super::super::testing::{correlation, described, moments, sites};
    use super::*;
    use photocurrent_core::random::Random;
    use serde_json::json;

    fn all(t_reset_ns: i64, events: u64) -> (Vec<f64>, Vec<f64>) {
        let effect = described("threshold_mismatch", json!({ "sigma": 0.03 }));
        let history = History { events, ..History::default() };
        let of = |site| {
            let mut thresholds = Thresholds { on: 0.2, off: 0.25 };
            effect.thresholds(&site, &history, &mut Random::new(1, &[events]), t_reset_ns, &mut thresholds);
            (thresholds.on, thresholds.off)
        };
        sites().map(of).unzip()
    }

    #[test]
    fn mean_and_spread_over_the_pixels_are_the_stated_ones() {
        let (on, off) = all(0, 0);
        // Five standard errors with 20,000 pixels: 5 x 0.03 / sqrt(n) of the mean, that over sqrt(2) of
        // sigma.
        for (thresholds, stated) in [(&on, 0.2), (&off, 0.25)] {
            let (mean, sigma) = moments(thresholds);
            assert!((mean - stated).abs() < 1.1e-3, "{mean}");
            assert!((sigma - 0.03).abs() < 7.5e-4, "{sigma}");
        }
        assert!(correlation(&on, &off).abs() < 5.0 / 20_000f64.sqrt(), "ON and OFF are two comparators");
    }

    #[test]
    fn the_two_halves_of_a_recording_are_identical() {
        assert_eq!(all(0, 0), all(5_000_000_000, 4_321));
    }

    #[test]
    fn neighbours_know_nothing_of_each_other() {
        let (on, _) = all(0, 0);
        assert!(correlation(&on[1..], &on[..on.len() - 1]).abs() < 5.0 / 20_000f64.sqrt());
    }

    #[test]
    fn on_a_ramp_every_pixel_keeps_a_pace_of_its_own() {
        let ramp = Samples::of_log(50 * MS, |t| 20.0 * t);
        let pace = |site: Site| {
            let effects = vec![described("threshold_mismatch", json!({ "sigma": 0.02 }))];
            let paces = intervals_s(&recorded_at(&site, ideal_pixel(), effects, &ramp, 50 * MS));
            assert!(
                paces.len() >= 2 && paces.iter().all(|pace| (pace - paces[0]).abs() < 3e-9),
                "constant in time"
            );
            paces[0]
        };
        let paces: Vec<f64> = sites().take(400).map(pace).collect();
        // Threshold over slope: 0.2 / 20 and 0.02 / 20; five standard errors with 400 pixels.
        let (mean, sigma) = moments(&paces);
        assert!((mean - 10e-3).abs() < 0.25e-3, "{mean}");
        assert!((sigma - 1e-3).abs() < 0.18e-3, "{sigma}");
    }
}
