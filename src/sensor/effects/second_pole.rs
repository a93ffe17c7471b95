//! Second pole: behind the photodiode's low-pass comes another one, of the amplifier or source follower.
//!
//! A sharp edge then starts as a parabola instead of a straight line: the first event of a burst is late by
//! `sqrt(2 tau_1 tau theta / c)` instead of `tau_1 theta / c` for an edge of contrast `c`, and the later ones
//! hardly differ. A slow ramp only sees the sum of both time constants.
//!
//! Source: Graca and Delbruck, "Unraveling the paradox of intensity-dependent DVS pixel noise" (2021).
//! Limits: real poles only, so no ringing.

use super::sought::{DELAY, Measure, Search, Size, Sought};
use super::{
    Effect, EffectDecl, EffectKind, FrontEndModel, ParameterDecl, Parameters, SecondPole, Site, Stage, Unit,
};

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "second_pole",
        stage: Stage::FrontEnd,
        about: "The front end has a second low-pass",
        equation: "dV_2/dt = (V_1 - V_2) / (tau + tau_light / i)",
        parameters: &[
            ParameterDecl {
                name: "tau",
                unit: Unit::Time,
                null: Some(0.0),
                allowed: (0.0, 10.0),
                plausible: (1e-5, 5e-3),
                about: "time constant that light does not change",
            },
            ParameterDecl {
                name: "tau_light",
                unit: Unit::Time,
                null: Some(0.0),
                allowed: (0.0, 1e4),
                plausible: (1e-6, 1.0),
                about: "time times photocurrent unit: the part that grows in the dark",
            },
        ],
        covariate: "burst_index",
        signature: "the first event after a sharp edge is late, the later ones are not; independent of \
                    light when tau dominates",
        confused_with: &["time_constant", "reset_memory", "refractory"],
        source: "Graca and Delbruck 2021, arXiv 2109.08640",
        apart: &[(
            "time_constant",
            "a step of light of known instant (a flashing lamp): a second pole \
                                    delays the rise, a time constant only slows it",
        )],
        search: Search::For(&[
            Sought { typical: Size::Fixed(150e-6), material: DELAY, ..Sought::positive("tau") },
            Sought {
                typical: Size::Of(150e-6, Measure::Light),
                material: Size::Times(&DELAY, Measure::Light),
                ..Sought::positive("tau_light")
            },
        ]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    let pole = SecondPole {
        tau_s: parameters.get("tau").unwrap_or(0.0),
        tau_light_s: parameters.get("tau_light").unwrap_or(0.0),
    };
    if parameters.get("tau").is_none() && parameters.get("tau_light").is_none() {
        return Err("`effects.second_pole` needs `tau` or `tau_light`".to_owned());
    }
    Ok(Box::new(SecondPoleEffect { pole }))
}

/// Another low-pass behind the first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SecondPoleEffect {
    /// Its time constant.
    pub pole: SecondPole,
}

impl Effect for SecondPoleEffect {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn front_end(&self, _site: &Site, model: &mut FrontEndModel) {
        if self.pole.tau_s > 0.0 || self.pole.tau_light_s > 0.0 {
            model.second_pole = Some(self.pole);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::*;
    use super::*;
    use crate::forward::Pixel;
    use crate::front_end::FrontEnd;

    fn pixel() -> Pixel {
        Pixel { front_end: FrontEnd { tau_0_s: 0.3e-3, alpha_s: 0.0 }, ..ideal_pixel() }
    }

    #[test]
    fn events_lie_on_the_step_response_of_two_poles() {
        // tau_light / i after the jump is the same 2 ms / 2.
        for pole in
            [SecondPole { tau_s: 1e-3, tau_light_s: 0.0 }, SecondPole { tau_s: 0.0, tau_light_s: 2e-3 }]
        {
            let contrast = 1.5;
            let events = recorded(
                pixel(),
                vec![Box::new(SecondPoleEffect { pole })],
                &Samples::jump(2.0 * libm::exp(-contrast), 2.0),
                20 * MS,
            );
            assert_eq!(events.len(), 7); // 1.5 / 0.2
            let (a, b) = (0.3e-3, 1e-3);
            let response =
                |t: f64| contrast * (1.0 - (a * libm::exp(-t / a) - b * libm::exp(-t / b)) / (a - b));
            for (k, event) in events.iter().enumerate() {
                let t = (event.t_in_ns - MS) as f64 / 1e9;
                let slope = (response(t + 1e-7) - response(t - 1e-7)) / 2e-7;
                let late_s = (response(t) - 0.2 * (k + 1) as f64) / slope;
                assert!(late_s.abs() < 1e-7, "event {k} is off by {late_s} s");
            }
        }
    }

    #[test]
    fn the_first_event_is_late_by_a_square_root() {
        for contrast in [1.0, 4.0] {
            let sensitive = Pixel { threshold_on: 0.002, threshold_off: 0.002, ..pixel() };
            let pole = SecondPole { tau_s: 1e-3, tau_light_s: 0.0 };
            let events = recorded(
                sensitive,
                vec![Box::new(SecondPoleEffect { pole })],
                &Samples::jump(1.0, libm::exp(contrast)),
                2 * MS,
            );
            let expected_s = libm::sqrt(2.0 * 0.3e-3 * 1e-3 * 0.002 / contrast);
            let found_s = (events[0].t_in_ns - MS) as f64 / 1e9;
            // The next order of the expansion is t (1 / tau_1 + 1 / tau_2) / 6 of it: 2.5 % at contrast 1.
            assert!((found_s / expected_s - 1.0).abs() < 0.03, "{found_s} for {expected_s}");
        }
    }

    #[test]
    fn no_time_constant_is_no_effect() {
        let parameters =
            Parameters::read(&KIND.decl, &serde_json::from_str(r#"{"tau": "0 ns"}"#).unwrap()).unwrap();
        let mut model = FrontEndModel::plain(pixel().front_end);
        (KIND.build)(&parameters).unwrap().front_end(&SITE, &mut model);
        assert!(model.is_plain());
    }
}
