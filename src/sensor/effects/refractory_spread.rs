//! Refractory spread: some pixels rest longer after an event than others.
//!
//! The refractory period is the time in which a current of picoamperes charges a small capacitor. Such a
//! current comes from a transistor below threshold, where a small offset of the voltage is a factor on the
//! current, so each pixel has its own period, for good. A pixel that rests longer misses more of a fast edge,
//! and its shortest interval between events is longer. Typical: 10 to 30 % from pixel to pixel.
//!
//! Source: Pelgrom, Duinmaijer, Welbers, "Matching properties of MOS transistors" (1989), for the offsets.
//! Limits: log-normal with the stated period as its median; constant in time and light.

use super::refractory::{self, SOME_REFRACTORY_S};
use super::sought::{Applied, Companion, SPREAD, Search, Size, Sought};
use super::{Chance, Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, Site, Stage, Unit};

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "refractory_spread",
        stage: Stage::Reset,
        about: "Every pixel has a refractory period of its own, which stays",
        equation: "t_rp(x, y) = t_rp * exp(sigma * z(x, y)), z ~ N(0, 1) once for each pixel",
        parameters: &[ParameterDecl {
            name: "sigma",
            unit: Unit::Number("ln"),
            null: Some(0.0),
            allowed: (0.0, 3.0),
            plausible: (0.03, 1.0),
            about: "standard deviation of the logarithm of the refractory period over the pixels; for small \
                    values its relative spread",
        }],
        covariate: "pixel*slope",
        signature: "after each event a pixel is off by an amount of its own times the slope; the shortest \
                    interval between events differs from pixel to pixel",
        confused_with: &["threshold_mismatch", "threshold_noise", "refractory"],
        source: "Pelgrom, Duinmaijer, Welbers 1989",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Fixed(0.9),
            material: SPREAD,
            companion: Some(Companion {
                id: refractory::KIND.decl.id,
                parameter: "refractory",
                seconds: period,
            }),
            spread_of: Some((refractory::KIND.decl.id, "refractory")),
            ..Sought::random("sigma")
        }]),
    },
    build,
};

fn period(applied: &Applied) -> Option<f64> {
    (applied.model.pixel.refractory_ns == 0).then_some(SOME_REFRACTORY_S)
}

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(RefractorySpread { sigma: parameters.need("sigma")? }))
}

/// A refractory period that differs from pixel to pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct RefractorySpread {
    /// Standard deviation of the period's logarithm, at least zero.
    pub sigma: f64,
}

impl Effect for RefractorySpread {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn refractory_ns(&self, site: &Site, _i: f64, refractory_ns: i64) -> i64 {
        let factor = libm::exp(self.sigma * site.random(KIND.decl.id).normal());
        (refractory_ns as f64 * factor).round() as i64
    }

    fn chance(&self) -> Option<Chance> {
        Some(Chance::default())
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::{MS, Samples, ideal_pixel, intervals_s, recorded_at};
    use super::super::testing::{described, moments, site, sites};
    use serde_json::json;

    #[test]
    fn the_logarithm_of_the_period_has_the_stated_spread_around_the_stated_period() {
        let effect = described("refractory_spread", json!({ "sigma": 0.2 }));
        let logs: Vec<f64> = sites()
            .map(|site| libm::log(effect.refractory_ns(&site, 1.0, 50_000) as f64 / 50_000.0))
            .collect();
        let (mean, sigma) = moments(&logs);
        // Five standard errors with 20,000 pixels.
        assert!(mean.abs() < 7.1e-3, "{mean}");
        assert!((sigma - 0.2).abs() < 5e-3, "{sigma}");
    }

    #[test]
    fn a_pixel_keeps_its_period_in_any_light_and_zero_stays_zero() {
        let effect = described("refractory_spread", json!({ "sigma": 0.2 }));
        assert_eq!(
            effect.refractory_ns(&site(3, 4), 0.1, 50_000),
            effect.refractory_ns(&site(3, 4), 100.0, 50_000)
        );
        assert_ne!(
            effect.refractory_ns(&site(3, 4), 1.0, 50_000),
            effect.refractory_ns(&site(4, 4), 1.0, 50_000)
        );
        assert_eq!(effect.refractory_ns(&site(3, 4), 1.0, 0), 0);
    }

    #[test]
    fn on_a_ramp_the_pixels_intervals_differ_by_their_periods() {
        let ramp = Samples::of_log(60 * MS, |t| 20.0 * t);
        let extra = |site| {
            let pixel = crate::forward::Pixel { refractory_ns: 2 * MS, ..ideal_pixel() };
            let effects = vec![described("refractory_spread", json!({ "sigma": 0.2 }))];
            let intervals = intervals_s(&recorded_at(&site, pixel, effects, &ramp, 60 * MS));
            assert!(
                intervals.iter().all(|interval| (interval - intervals[0]).abs() < 3e-9),
                "constant in time"
            );
            libm::log((intervals[0] - 0.2 / 20.0) / 2e-3)
        };
        let (mean, sigma) = moments(&sites().take(400).map(extra).collect::<Vec<f64>>());
        // Five standard errors with 400 pixels.
        assert!(mean.abs() < 0.05, "{mean}");
        assert!((sigma - 0.2).abs() < 0.036, "{sigma}");
    }
}
