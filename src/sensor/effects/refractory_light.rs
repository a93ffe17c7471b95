//! Light-dependent refractory period: pixels in bright light rest for a shorter time after an event.
//!
//! The refractory period ends when a current has charged a small capacitor. Light that strays to that node
//! frees charge there too, and this parasitic photocurrent adds to the bias current: the brighter the pixel,
//! the sooner it is armed again. Seen with the period known in bright light, pixels in the dark seem to rest
//! too long. The size depends on the layout: where the bias current is picoamperes, full sunlight can halve
//! the period.
//!
//! Source: Nozaki and Delbruck, "Temperature and parasitic photocurrent effects in dynamic vision sensors"
//! (2017), for parasitic photocurrent at the reset switch. That it acts on the refractory node in the same
//! way is our assumption, and so is the form. Limits: the light when the event leaves holds for the whole
//! period; the stated period is that of darkness.

use super::refractory::{self, SOME_REFRACTORY_S};
use super::sought::{Applied, Companion, Measure, Search, Size, Sought};
use super::{Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, Site, Stage, Unit};

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "refractory_light",
        stage: Stage::Reset,
        about: "The refractory period is shorter in bright light",
        equation: "t_rp(i) = t_rp / (1 + coefficient * i)",
        parameters: &[ParameterDecl {
            name: "coefficient",
            unit: Unit::Number("1/photocurrent"),
            null: Some(0.0),
            allowed: (0.0, 1e9),
            plausible: (1e-4, 10.0),
            about: "stray current at the refractory node over its bias current, per photocurrent unit; \
                    1/coefficient is the light that halves the period",
        }],
        covariate: "photocurrent*slope",
        signature: "after each event pixels are off in proportion to the slope, by more in one end of the \
                    light range; the shortest interval falls with light",
        confused_with: &["refractory", "time_constant", "parasitic_leak"],
        source: "after the parasitic photocurrent of Nozaki and Delbruck 2017; the form is assumed",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Over(&Size::Fixed(1.0), Measure::Light),
            companion: Some(Companion {
                id: refractory::KIND.decl.id,
                parameter: "refractory",
                seconds: period,
            }),
            ..Sought::positive("coefficient")
        }]),
    },
    build,
};

/// What an engineer meets is a period that grows in the dark beyond the stated one, seconds; the stated one
/// is what it comes down to in bright light.
fn period(applied: &Applied) -> Option<f64> {
    let bright = f64::max(applied.model.pixel.refractory_ns as f64 * 1e-9, SOME_REFRACTORY_S);
    Some(bright * (1.0 + 4.0 * applied.effect_size.max(0.0)) * (1.0 + applied.value * applied.light))
}

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(RefractoryLight { coefficient: parameters.need("coefficient")? }))
}

/// A refractory period that light shortens.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct RefractoryLight {
    /// Per photocurrent unit, at least zero.
    pub coefficient: f64,
}

impl Effect for RefractoryLight {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn refractory_ns(&self, _site: &Site, i: f64, refractory_ns: i64) -> i64 {
        (refractory_ns as f64 / (1.0 + self.coefficient * i)).round() as i64
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::{MS, Samples, ideal_pixel, recorded};
    use super::super::testing::{described, site};
    use serde_json::json;

    #[test]
    fn the_period_falls_with_light_and_halves_at_one_over_the_coefficient() {
        let effect = described("refractory_light", json!({ "coefficient": 0.01 }));
        let periods = [0.0, 1.0, 25.0, 100.0, 300.0].map(|i| effect.refractory_ns(&site(3, 4), i, 100_000));
        assert_eq!(periods, [100_000, 99_010, 80_000, 50_000, 25_000]);
    }

    #[test]
    fn a_coefficient_of_zero_changes_nothing() {
        let effect = described("refractory_light", json!({ "coefficient": 0.0 }));
        assert_eq!(effect.refractory_ns(&site(3, 4), 1e6, 100_000), 100_000);
    }

    #[test]
    fn intervals_on_a_ramp_shorten_as_it_gets_brighter() {
        let pixel = crate::forward::Pixel { refractory_ns: 4 * MS, ..ideal_pixel() };
        let effects = vec![described("refractory_light", json!({ "coefficient": 1.0 }))];
        let ramp = Samples::of_log(400 * MS, |t| -4.0 + 20.0 * t);
        let events = recorded(pixel, effects, &ramp, 400 * MS);
        assert!(events.len() > 20);
        for pair in events.windows(2) {
            let i = libm::exp(-4.0 + 20.0 * pair[0].t_in_ns as f64 / 1e9);
            let expected_s = 0.2 / 20.0 + 4e-3 / (1.0 + i);
            assert!(((pair[1].t_in_ns - pair[0].t_in_ns) as f64 / 1e9 - expected_s).abs() < 1e-6);
        }
    }
}
