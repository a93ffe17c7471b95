//! Threshold drift: the contrast at which pixels fire grows or shrinks in the course of the recording.
//!
//! Bias currents follow temperature and supply, so a sensor that warms up counts fewer (or more) events for
//! the same scene at the end than at the start. All pixels share it, and ON and OFF scale together. Typical:
//! a few per cent over ten kelvin, so less than 1 % a second; a search also looks at short recordings with
//! more.
//!
//! Sources: Nozaki and Delbruck, "Temperature and parasitic photocurrent effects in dynamic vision sensors"
//! (2017), for the temperature; Graca, McReynolds, Delbruck, "Shining light on the DVS pixel" (2023), for the
//! threshold as a ratio of bias currents. No published rate. Limits: linear in time, counted from the
//! recording's zero; a threshold is taken at the reset, so one that is held for a time T is behind by
//! `rate x T`. The factor never falls below 0.05: at zero a pixel would fire without end.

use super::sought::{GAIN, Measure, Search, Size, Sought};
use super::{
    Effect, EffectDecl, EffectKind, History, ParameterDecl, Parameters, Site, Stage, Thresholds, Unit,
};
use photocurrent_core::random::Random;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "threshold_drift",
        stage: Stage::Comparator,
        about: "Both thresholds grow or shrink during the recording, in all pixels alike",
        equation: "threshold(t) = threshold * (1 + rate * t)",
        parameters: &[ParameterDecl {
            name: "rate",
            unit: Unit::Number("1/s"),
            null: Some(0.0),
            allowed: (-100.0, 100.0),
            plausible: (-1.0, 1.0),
            about: "growth of both thresholds per second, as a fraction of their value at time zero; \
                    positive = fewer events later on",
        }],
        covariate: "time",
        signature: "events count for more contrast as time goes on: the voltage at firing is off by an \
                    amount linear in time, same sense for ON and OFF",
        confused_with: &["threshold_scale", "leak_events", "dark_current", "a change of illumination"],
        source: "Nozaki and Delbruck 2017; Graca, McReynolds, Delbruck 2023",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Over(&Size::Fixed(0.2), Measure::Duration),
            material: Size::Over(&GAIN, Measure::Duration),
            ..Sought::both("rate")
        }]),
    },
    build,
};

/// No drift takes a threshold below this part of its value.
const LEAST_FACTOR: f64 = 0.05;

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(ThresholdDrift { rate_per_s: parameters.need("rate")? }))
}

/// Thresholds that change linearly in time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ThresholdDrift {
    /// Relative growth per second, any sign.
    pub rate_per_s: f64,
}

impl Effect for ThresholdDrift {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn thresholds(
        &self,
        _site: &Site,
        _history: &History,
        _random: &mut Random,
        t_reset_ns: i64,
        thresholds: &mut Thresholds,
    ) {
        let factor = f64::max(1.0 + self.rate_per_s * (t_reset_ns as f64 / 1e9), LEAST_FACTOR);
        thresholds.on *= factor;
        thresholds.off *= factor;
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::{MS, Samples, ideal_pixel, recorded};
    use super::super::testing::{described, site};
    use super::*;
    use serde_json::json;

    fn at(rate: f64, t_reset_ns: i64) -> Thresholds {
        let mut thresholds = Thresholds { on: 0.2, off: 0.25 };
        let effect = described("threshold_drift", json!({ "rate": rate }));
        effect.thresholds(
            &site(3, 4),
            &History::default(),
            &mut Random::new(1, &[]),
            t_reset_ns,
            &mut thresholds,
        );
        thresholds
    }

    #[test]
    fn the_thresholds_grow_linearly_in_time_from_time_zero() {
        assert_eq!(at(0.1, 0), Thresholds { on: 0.2, off: 0.25 });
        for seconds in [-1, 1, 2, 4] {
            let thresholds = at(0.1, seconds * 1_000_000_000);
            assert!((thresholds.on - (0.2 + 0.02 * seconds as f64)).abs() < 1e-12);
            assert!((thresholds.off - (0.25 + 0.025 * seconds as f64)).abs() < 1e-12);
        }
    }

    #[test]
    fn a_falling_threshold_stays_positive() {
        assert!((at(-0.1, 2_000_000_000).on - 0.16).abs() < 1e-12);
        assert!((at(-0.1, 60_000_000_000).on - 0.01).abs() < 1e-12);
    }

    #[test]
    fn on_a_ramp_both_polarities_slow_down_alike() {
        for slope in [20.0, -20.0] {
            let ramp = Samples::of_log(500 * MS, |t| slope * t);
            let effects = vec![described("threshold_drift", json!({ "rate": 0.5 }))];
            let events = recorded(ideal_pixel(), effects, &ramp, 500 * MS);
            // The threshold is taken at the event before: t[k + 1] = t[k] + 10 ms x (1 + 0.5 t[k]), from 0.
            let mut t_s = 0.0;
            assert_eq!(events.len(), 44); // t[k] = 2 s x (1.005^k - 1) passes 0.5 s at k = 45.
            for event in &events {
                t_s += 0.01 * (1.0 + 0.5 * t_s);
                assert!((event.t_in_ns as f64 / 1e9 - t_s).abs() < 1e-6);
            }
        }
    }
}
