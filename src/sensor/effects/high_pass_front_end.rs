//! High-pass front end (adaptation): the pixel forgets slow changes.
//!
//! A high-pass stands before the comparator, so what the comparator sees returns to rest with a time
//! constant: `dU/dt = dV/dt - U / tau`. A change spread evenly over `T` seconds arrives as the share
//! `(tau / T) (1 - exp(-T / tau))`: fast edges pass whole, slow gradients make too few events, of both
//! polarities alike. After a lasting step the pull back can fire events of the other sign. Typical:
//! milliseconds to seconds; a low-frequency filter bias sets it.
//!
//! Leaks look alike for one polarity only; here ON and OFF are late together.
//!
//! Source: the high-pass bias (`bias_hpf`) of Prophesee sensors; Graca, Zhou, McReynolds and Delbruck, SciDVS
//! (2024). Limits: linear, one pole, the same for all pixels.

use super::sought::{Grows, Search, Size, Sought};
use super::{Effect, EffectDecl, EffectKind, FrontEndModel, ParameterDecl, Parameters, Site, Stage, Unit};

/// From here on the high-pass is none: no recording is that long.
const NONE_S: f64 = 1e6;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "high_pass_front_end",
        stage: Stage::FrontEnd,
        about: "A high-pass before the comparator lets the voltage return to rest: slow changes make too \
                few events",
        equation: "dU/dt = dV/dt - U / tau, and the comparator sees U",
        parameters: &[ParameterDecl {
            name: "tau",
            unit: Unit::Time,
            null: Some(NONE_S),
            allowed: (1e-6, NONE_S),
            plausible: (1e-3, 100.0),
            about: "time constant with which the voltage returns to rest; 1e6 s = none",
        }],
        covariate: "time_since_last_event",
        signature: "events of slow changes are missing or late, ON and OFF alike; fast edges are untouched",
        confused_with: &["threshold_scale", "leak_events", "refractory"],
        source: "bias_hpf of Prophesee sensors; Graca et al. 2024 (SciDVS)",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Fixed(0.04),
            grows: Grows::AsItFalls,
            ..Sought::positive("tau")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(HighPassFrontEnd { tau_s: parameters.need("tau")? }))
}

/// A high-pass before the comparator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct HighPassFrontEnd {
    /// Time constant, seconds, positive; 1e6 or more = none.
    pub tau_s: f64,
}

impl Effect for HighPassFrontEnd {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn front_end(&self, _site: &Site, model: &mut FrontEndModel) {
        model.high_pass_s = if self.tau_s < NONE_S { self.tau_s } else { f64::INFINITY };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::simulated::{MS, Samples, ideal_pixel, recorded};
    use crate::front_end::FrontEnd;
    use serde_json::json;

    fn model_of(tau: &str) -> FrontEndModel {
        let mut model = FrontEndModel::plain(FrontEnd::IDEAL);
        let effect = KIND.read(json!({ "tau": tau }).as_object().unwrap()).unwrap();
        effect.front_end(&Site { x: 0, y: 0, width: 1, height: 1, seed: 1 }, &mut model);
        model
    }

    #[test]
    fn only_the_high_pass_changes() {
        assert_eq!(
            model_of("20 ms"),
            FrontEndModel { high_pass_s: 0.02, ..FrontEndModel::plain(FrontEnd::IDEAL) }
        );
    }

    /// Seconds and polarities of the events of an ideal pixel with a high-pass of 50 ms.
    fn events(samples: &Samples) -> Vec<(f64, i8)> {
        let events =
            recorded(ideal_pixel(), vec![Box::new(HighPassFrontEnd { tau_s: 0.05 })], samples, 400 * MS);
        events.iter().map(|event| (event.t_in_ns as f64 / 1e9, event.polarity)).collect()
    }

    #[test]
    fn on_a_ramp_events_are_late_in_both_directions_and_then_stop() {
        for slope in [10.0_f64, -10.0] {
            let events = events(&Samples::of_log(400 * MS, |t_s| slope * t_s));
            // U = slope tau (1 - exp(-t / tau)) ends at 0.5: two thresholds of 0.2, not three.
            assert_eq!(events.len(), 2);
            for (k, (t_s, polarity)) in events.iter().enumerate() {
                let expected_s = -0.05 * libm::log1p(-0.2 * (k + 1) as f64 / 0.5);
                assert!((t_s - expected_s).abs() < 2e-6, "{t_s} against {expected_s}");
                assert_eq!(f64::from(*polarity), slope.signum());
            }
        }
    }

    #[test]
    fn after_a_step_the_pull_back_fires_the_other_sign() {
        let events = events(&Samples::jump(1.0, libm::exp(0.5)));
        assert_eq!(events.iter().map(|event| event.1).collect::<Vec<_>>(), [1, 1, -1]);
        // From 0.5 back to the reference 0.4 minus 0.2.
        let expected_s = 1e-3 + 0.05 * libm::log(0.5 / 0.2);
        assert!((events[2].0 - expected_s).abs() < 2e-6, "{} against {expected_s}", events[2].0);
    }

    #[test]
    fn the_null_value_leaves_the_front_end_plain() {
        assert!(model_of("1000000 s").is_plain());
    }
}
