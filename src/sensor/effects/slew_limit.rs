//! Slew limit: the voltage rises or falls no faster than a fixed pace, however large the step.
//!
//! A stage behind the photodiode has a bias current that must carry its capacitance: `|dV/dt| <= I_bias / C`.
//! A source follower drives one direction and is limited in the other, so usually one polarity is hit. Below
//! the limit nothing changes; above it events of that polarity come at most every `threshold / limit`
//! seconds. Typical: 1e2 to 1e5 ln/s.
//!
//! A refractory period caps events per second; this caps voltage per second, so a higher threshold lowers the
//! rate.
//!
//! Source: textbook behaviour of a bias-limited source follower, as in Lichtsteiner, Posch and Delbruck
//! (2008). Limits: a hard limit, the same for all pixels and independent of light.

use super::sought::{Grows, Measure, Search, Size, Sought};
use super::{Effect, EffectDecl, EffectKind, FrontEndModel, ParameterDecl, Parameters, Site, Stage, Unit};

/// From here on a limit is none: a factor e within a nanosecond.
const UNLIMITED_PER_S: f64 = 1e9;

const RISE: ParameterDecl = ParameterDecl {
    name: "rise",
    unit: Unit::Number("ln/s"),
    null: Some(UNLIMITED_PER_S),
    allowed: (1e-3, UNLIMITED_PER_S),
    plausible: (10.0, 1e6),
    about: "largest rise of the voltage, ln/s; 1e9 or absent = no limit",
};

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "slew_limit",
        stage: Stage::FrontEnd,
        about: "The front-end voltage cannot rise or fall faster than a fixed pace",
        equation: "-fall <= dV/dt <= rise",
        parameters: &[
            RISE,
            ParameterDecl {
                name: "fall",
                about: "largest fall of the voltage, ln/s, positive; 1e9 or absent = no limit",
                ..RISE
            },
        ],
        covariate: "slope",
        signature: "no residual up to a knee in |dV/dt|, then events ever later; usually of one polarity",
        confused_with: &["refractory", "large_signal_front_end", "readout_queue"],
        source: "Lichtsteiner, Posch and Delbruck 2008",
        apart: &[],
        search: Search::For(&[
            Sought {
                typical: Size::Of(1.0, Measure::Slope),
                grows: Grows::AsItFalls,
                ..Sought::positive("rise")
            },
            Sought {
                typical: Size::Of(1.0, Measure::Slope),
                grows: Grows::AsItFalls,
                ..Sought::positive("fall")
            },
        ]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    let (rise, fall) = (parameters.get("rise"), parameters.get("fall"));
    if rise.is_none() && fall.is_none() {
        return Err("`effects.slew_limit` needs `rise` or `fall`, or both".to_owned());
    }
    let limit = |given: Option<f64>| given.filter(|&limit| limit < UNLIMITED_PER_S).unwrap_or(f64::INFINITY);
    Ok(Box::new(SlewLimit { rise_per_s: limit(rise), fall_per_s: limit(fall) }))
}

/// Limits of the voltage's speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SlewLimit {
    /// Largest rise, ln/s, positive; infinite = no limit.
    pub rise_per_s: f64,
    /// Largest fall, ln/s, positive; infinite = no limit.
    pub fall_per_s: f64,
}

impl Effect for SlewLimit {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn front_end(&self, _site: &Site, model: &mut FrontEndModel) {
        model.slew_up_per_s = model.slew_up_per_s.min(self.rise_per_s);
        model.slew_down_per_s = model.slew_down_per_s.min(self.fall_per_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::simulated::{MS, Samples, ideal_pixel, recorded};
    use crate::forward::Pixel;
    use crate::front_end::FrontEnd;
    use serde_json::{Value, json};

    fn model_of(given: Value) -> Result<FrontEndModel, String> {
        let effect = KIND.read(given.as_object().unwrap())?;
        let mut model = FrontEndModel::plain(FrontEnd::IDEAL);
        effect.front_end(&Site { x: 0, y: 0, width: 1, height: 1, seed: 1 }, &mut model);
        Ok(model)
    }

    #[test]
    fn each_direction_has_its_own_limit() {
        let model = model_of(json!({ "fall": 500.0 })).unwrap();
        assert_eq!((model.slew_up_per_s, model.slew_down_per_s), (f64::INFINITY, 500.0));
        let model = model_of(json!({ "rise": 20, "fall": 500.0 })).unwrap();
        assert_eq!((model.slew_up_per_s, model.slew_down_per_s), (20.0, 500.0));
    }

    #[test]
    fn a_large_fall_goes_at_the_limit_and_a_rise_is_untouched() {
        let pixel = Pixel { front_end: FrontEnd { tau_0_s: 1e-5, alpha_s: 0.0 }, ..ideal_pixel() };
        let delays_ns = |after: f64| -> Vec<i64> {
            let limit = SlewLimit { rise_per_s: f64::INFINITY, fall_per_s: 20.0 };
            recorded(pixel, vec![Box::new(limit)], &Samples::jump(1.0, after), 100 * MS)
                .iter()
                .map(|event| event.t_in_ns - MS)
                .collect()
        };
        // 20 ln/s: a threshold of 0.2 every 10 ms.
        let (falls, rises) = (delays_ns(libm::exp(-1.1)), delays_ns(libm::exp(1.1)));
        assert_eq!((falls.len(), rises.len()), (5, 5));
        assert!((1..=5).all(|k| (falls[k as usize - 1] - 10 * MS * k).abs() < 1_000), "{falls:?}");
        assert!(rises.iter().all(|&delay_ns| delay_ns < 30_000), "{rises:?}");
    }

    #[test]
    fn the_null_value_leaves_the_front_end_plain() {
        assert!(model_of(json!({ "rise": 1e9, "fall": 1e9 })).unwrap().is_plain());
    }

    #[test]
    fn a_limit_without_a_value_is_refused() {
        assert_eq!(model_of(json!({})).unwrap_err(), "`effects.slew_limit` needs `rise` or `fall`, or both");
    }
}
