//! Threshold noise: the same pixel fires at a slightly different contrast each time.
//!
//! Opening the reset switch freezes its thermal noise (kTC noise) on the capacitor, and the comparator adds
//! some, so the threshold is drawn afresh at every reset. A static pixel stays silent; at an edge the time of
//! firing scatters by `sigma` over the slope of the voltage. Typical: 0.002 to 0.03.
//!
//! Sources: Joubert et al. 2021 (IEBCS redraws a threshold at each event); the normal model of Eq. (4)'s
//! threshold. Limits: normal; one draw for both polarities, as with the description's `threshold_noise`. That
//! a noisy voltage can cross by itself, in the dark or in a static scene, is `background_activity`.

use super::sought::{Field, Measure, SPREAD, Search, Size, Sought};
use super::{
    Chance, Effect, EffectDecl, EffectKind, History, ParameterDecl, Parameters, Site, Stage, Thresholds, Unit,
};
use photocurrent_core::random::Random;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "threshold_noise",
        stage: Stage::Comparator,
        about: "The threshold is a little different after every reset",
        equation: "threshold_k = threshold + sigma * z_k, z ~ N(0, 1) at each reset",
        parameters: &[ParameterDecl {
            name: "sigma",
            unit: Unit::Number("ln"),
            null: Some(0.0),
            allowed: (0.0, 1.0),
            plausible: (0.002, 0.05),
            about: "standard deviation of the threshold from one reset to the next, natural-log units; adds \
                    to a stated threshold_noise",
        }],
        covariate: "slope",
        signature: "event times scatter by sigma / slope, independent from event to event; static pixels \
                    stay silent",
        confused_with: &[
            "threshold_mismatch",
            "timestamp_jitter",
            "background_activity",
            "refractory_spread",
        ],
        source: "Joubert et al. 2021",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Of(0.08, Measure::Threshold),
            material: SPREAD,
            field: Some(Field::ThresholdNoise),
            ..Sought::random("sigma")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(ThresholdNoise { sigma: parameters.need("sigma")? }))
}

/// A threshold that is redrawn at each reset.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ThresholdNoise {
    /// Standard deviation from reset to reset, natural-log units, at least zero.
    pub sigma: f64,
}

impl Effect for ThresholdNoise {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn thresholds(
        &self,
        _site: &Site,
        _history: &History,
        random: &mut Random,
        _t_reset_ns: i64,
        thresholds: &mut Thresholds,
    ) {
        let change = self.sigma * random.normal();
        thresholds.on += change;
        thresholds.off += change;
    }

    fn chance(&self) -> Option<Chance> {
        Some(Chance { of_events: self.sigma, ..Chance::default() })
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::{MS, Samples, ideal_pixel, intervals_s, recorded};
    use super::super::testing::{correlation, described, moments, site};
    use super::*;
    use serde_json::json;

    #[test]
    fn each_reset_draws_anew_around_the_stated_threshold() {
        let effect = described("threshold_noise", json!({ "sigma": 0.02 }));
        let mut random = Random::new(7, &[1]);
        let mut draw = |_| {
            let mut thresholds = Thresholds { on: 0.2, off: 0.25 };
            effect.thresholds(&site(3, 4), &History::default(), &mut random, 0, &mut thresholds);
            thresholds
        };
        let drawn: Vec<Thresholds> = (0..20_000).map(&mut draw).collect();
        let on: Vec<f64> = drawn.iter().map(|thresholds| thresholds.on).collect();
        let (mean, sigma) = moments(&on);
        // Five standard errors, as for the mismatch.
        assert!((mean - 0.2).abs() < 7.1e-4, "{mean}");
        assert!((sigma - 0.02).abs() < 5e-4, "{sigma}");
        assert!(
            correlation(&on[1..], &on[..on.len() - 1]).abs() < 5.0 / 20_000f64.sqrt(),
            "resets are independent"
        );
        assert!(
            drawn.iter().all(|thresholds| (thresholds.off - thresholds.on - 0.05).abs() < 1e-12),
            "one draw for both"
        );
    }

    #[test]
    fn intervals_on_a_ramp_scatter_by_sigma_over_slope_and_a_static_pixel_is_silent() {
        let noise = || vec![described("threshold_noise", json!({ "sigma": 0.02 }))];
        for slope in [20.0, -40.0] {
            let ramp = Samples::of_log(3_000 * MS, |t| slope * (t - 1.5));
            let (mean, sigma) = moments(&intervals_s(&recorded(ideal_pixel(), noise(), &ramp, 3_000 * MS)));
            // 0.2 / 20 with 299 intervals and half of that with 599; five standard errors of the fewer.
            assert!((mean * f64::abs(slope) - 0.2).abs() < 5.8e-3, "{mean}");
            assert!((sigma * f64::abs(slope) - 0.02).abs() < 4.1e-3, "{sigma}");
        }
        assert!(recorded(ideal_pixel(), noise(), &Samples::constant(1.0), 3_000 * MS).is_empty());
    }
}
