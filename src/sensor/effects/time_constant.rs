//! Time constant: the front end's low-pass has another `tau_0` or `alpha` than stated.
//!
//! Events follow sharp edges too late or too early: by `alpha / i` (more in the dark) or by the same time
//! everywhere.
//!
//! Source: Eq. (3); both depend on bias and temperature. Absolute values: what is not given stays nominal.
//! Confused with: a clock offset (the same delay for frames and events at every light) and a second pole.

use super::sought::{DELAY, Field, Measure, Search, Size, Sought};
use super::{Effect, EffectDecl, EffectKind, FrontEndModel, ParameterDecl, Parameters, Site, Stage, Unit};

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "time_constant",
        stage: Stage::FrontEnd,
        about: "The time constant of the front end differs from the stated one",
        equation: "tau = tau_0 + alpha / i",
        parameters: &[
            ParameterDecl {
                name: "tau_0",
                unit: Unit::Time,
                null: None,
                allowed: (0.0, 1.0),
                plausible: (0.0, 1e-3),
                about: "time constant in bright light",
            },
            ParameterDecl {
                name: "alpha",
                unit: Unit::Time,
                null: None,
                allowed: (0.0, 1e4),
                plausible: (0.0, 0.1),
                about: "time times photocurrent unit",
            },
        ],
        covariate: "lag",
        signature: "events follow edges late when the true value is larger, in proportion to 1 / i for alpha",
        confused_with: &["second_pole", "clock_offset", "reset_memory"],
        source: "Eq. (3)",
        apart: &[],
        search: Search::For(&[
            Sought {
                typical: Size::Fixed(150e-6),
                material: DELAY,
                field: Some(Field::Tau0),
                ..Sought::both("tau_0")
            },
            Sought {
                typical: Size::Larger(&Size::Of(1.3, Measure::Alpha), &Size::Of(50e-6, Measure::Light)),
                material: Size::Times(&DELAY, Measure::Light),
                field: Some(Field::Alpha),
                ..Sought::both("alpha")
            },
        ]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    let (tau_0_s, alpha_s) = (parameters.get("tau_0"), parameters.get("alpha"));
    if tau_0_s.is_none() && alpha_s.is_none() {
        return Err("`effects.time_constant` needs `tau_0` or `alpha`".to_owned());
    }
    Ok(Box::new(TimeConstant { tau_0_s, alpha_s }))
}

/// The true low-pass; what is absent is nominal.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct TimeConstant {
    /// Seconds, at least zero.
    pub tau_0_s: Option<f64>,
    /// Seconds times photocurrent unit, at least zero.
    pub alpha_s: Option<f64>,
}

impl Effect for TimeConstant {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn front_end(&self, _site: &Site, model: &mut FrontEndModel) {
        model.low_pass.tau_0_s = self.tau_0_s.unwrap_or(model.low_pass.tau_0_s);
        model.low_pass.alpha_s = self.alpha_s.unwrap_or(model.low_pass.alpha_s);
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::*;
    use super::*;
    use crate::forward::Pixel;
    use crate::front_end::FrontEnd;

    #[test]
    fn delays_follow_the_true_time_constant() {
        let stated = Pixel { front_end: FrontEnd { tau_0_s: 1e-4, alpha_s: 0.0 }, ..ideal_pixel() };
        for (change, tau_s) in [
            (TimeConstant { tau_0_s: Some(4e-4), alpha_s: None }, 4e-4),
            (TimeConstant { tau_0_s: None, alpha_s: Some(1e-3) }, 1e-4 + 1e-3 / 2.0),
            (TimeConstant::default(), 1e-4),
        ] {
            let events = recorded(stated, vec![Box::new(change)], &Samples::jump(1.0, 2.0), 10 * MS);
            let expected_s = -tau_s * libm::log(1.0 - 0.2 / libm::log(2.0));
            assert!(((events[0].t_in_ns - MS) as f64 / 1e9 - expected_s).abs() < 1e-8);
        }
    }
}
