//! Large-signal front end: to a large step the pixel answers late upwards and early downwards.
//!
//! The photocurrent charges the photodiode and a transistor, exponential in the voltage, discharges it. With
//! the lag `x = ln i - V` that is `dV/dt = (1 - exp(-x)) / tau`; the model of Eq. (3) keeps the first term,
//! `x / tau`. At `x = +1` the voltage moves at 0.63 of the model's speed, at `x = -1` at 1.72. To first order
//! the difference is `-x^2 / (2 tau)`: it always pulls the voltage down, so ON events come late and OFF
//! events early, more so with contrast, speed and darkness. A step of height `c` still has a closed form:
//! `exp(x) - 1` decays with `tau`.
//!
//! It has no parameter: it is there or not.
//!
//! Source: Graca and Delbruck, large-signal equations of the event pixel, arXiv 2505.07386 (2025). Limits:
//! the time constant stays that of Eq. (3), `tau_0` included, although only its part `alpha / i` has this
//! form.

use super::sought::{Search, Sought};
use super::{Drive, Effect, EffectDecl, EffectKind, FrontEndModel, Parameters, Site, Stage};

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "large_signal_front_end",
        stage: Stage::FrontEnd,
        about: "The front end is exponential: large rises are slower and large falls faster than the \
                low-pass says",
        equation: "dV/dt = (1 - exp(-(ln i - V))) / tau",
        parameters: &[],
        covariate: "lag",
        signature: "the voltage is low by a parabola in the lag: ON late and OFF early, growing with \
                    contrast, speed and darkness",
        confused_with: &["threshold_asymmetry", "time_constant", "slew_limit"],
        source: "Graca and Delbruck 2025 (arXiv 2505.07386)",
        apart: &[],
        search: Search::For(&[Sought::switch("")]),
    },
    build,
};

fn build(_parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(LargeSignalFrontEnd))
}

/// The exponential answer to large steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct LargeSignalFrontEnd;

impl Effect for LargeSignalFrontEnd {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn front_end(&self, _site: &Site, model: &mut FrontEndModel) {
        model.drive = Drive::LargeSignal;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::simulated::{MS, Samples, ideal_pixel, recorded};
    use crate::forward::Pixel;
    use crate::front_end::FrontEnd;

    /// Seconds after a step of `ln i` by `change` at which the events of a pixel with a time constant of 1 ms
    /// come.
    fn delays_s(change: f64, effects: Vec<Box<dyn Effect>>) -> Vec<f64> {
        let pixel = Pixel { front_end: FrontEnd { tau_0_s: 1e-3, alpha_s: 0.0 }, ..ideal_pixel() };
        let events = recorded(pixel, effects, &Samples::jump(1.0, libm::exp(change)), 20 * MS);
        assert!(events.iter().all(|event| f64::from(event.polarity) == change));
        events.iter().map(|event| (event.t_in_ns - MS) as f64 / 1e9).collect()
    }

    #[test]
    fn a_step_up_is_late_and_a_step_down_early_by_the_closed_form() {
        for change in [1.0, -1.0] {
            let (plain, ours) =
                (delays_s(change, vec![]), delays_s(change, vec![Box::new(LargeSignalFrontEnd)]));
            for k in 1..=4 {
                // exp(x) - 1 decays with the time constant; the lag x goes from `change` to `change` minus k
                // thresholds of 0.2.
                let expected =
                    1e-3 * libm::log(libm::expm1(change) / libm::expm1(change * (1.0 - 0.2 * f64::from(k))));
                let found = ours[k as usize - 1];
                assert!((found - expected).abs() < 1e-7, "{change}, event {k}: {found} against {expected}");
                assert!((found - plain[k as usize - 1]) * change > 2e-5);
            }
        }
    }

    #[test]
    fn only_the_drive_changes() {
        let plain = FrontEndModel::plain(FrontEnd { tau_0_s: 2e-5, alpha_s: 1e-2 });
        let mut model = plain;
        LargeSignalFrontEnd.front_end(&Site { x: 0, y: 0, width: 1, height: 1, seed: 1 }, &mut model);
        assert_eq!(model, FrontEndModel { drive: Drive::LargeSignal, ..plain });
        assert!(!model.is_plain());
    }
}
