//! Clock drift: the event clock runs faster or slower than that of the frames.
//!
//! Two quartz oscillators never have the same frequency. The error of a stamp grows with time: after ten
//! seconds a difference of 50 parts in a million is half a millisecond, as much as a fast edge takes to cross
//! a pixel. Typical: 10 to 100 parts in a million.
//!
//! Source: tolerance of quartz oscillators; two clocks that are not locked to each other.
//! Limits: constant rate, no error at time zero; a constant error is `clock_offset`.

use super::sought::{Measure, Search, Size, Sought, TIME};
use super::{Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, PixelEvent, Site, Stage, Unit};
use photocurrent_core::random::Random;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "clock_drift",
        stage: Stage::Time,
        about: "The event clock runs faster or slower than the frame clock",
        equation: "t_recorded = t_true * (1 + rate)",
        parameters: &[ParameterDecl {
            name: "rate",
            unit: Unit::Number("fraction"),
            null: Some(0.0),
            allowed: (-0.5, 0.5),
            plausible: (-0.02, 0.02),
            about: "relative error of the event clock; positive = events are stamped later and later",
        }],
        covariate: "time*slope",
        signature: "frames differ from what events predict in proportion to their rate of change, by more \
                    and more as time goes on",
        confused_with: &["clock_offset", "time_constant", "threshold_drift"],
        source: "tolerance of quartz oscillators",
        apart: &[("clock_offset", "a recording four times as long: a drift grows with it")],
        search: Search::For(&[Sought {
            typical: Size::Over(&Size::Fixed(0.75e-3), Measure::Duration),
            material: Size::Over(&TIME, Measure::Duration),
            ..Sought::both("rate")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(ClockDrift { rate: parameters.need("rate")? }))
}

/// A clock that runs at another rate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ClockDrift {
    /// Relative error, any sign, far above -1.
    pub rate: f64,
}

impl ClockDrift {
    /// The recorded time of a true one, nanoseconds.
    pub(super) fn recorded(&self, t_ns: i64) -> i64 {
        // Only the difference goes through f64: a whole stamp can be too long for it.
        t_ns + (t_ns as f64 * self.rate).round() as i64
    }
}

impl Effect for ClockDrift {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn stamp(&self, _site: &Site, _random: &mut Random, event: &mut PixelEvent) {
        event.t_in_ns = self.recorded(event.t_in_ns);
        event.t_off_ns = self.recorded(event.t_off_ns);
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{described, site};
    use super::*;
    use serde_json::json;

    fn stamped(rate: f64, t_in_ns: i64, t_off_ns: i64) -> (i64, i64) {
        let mut event = PixelEvent { t_in_ns, t_off_ns, polarity: 1 };
        described("clock_drift", json!({ "rate": rate })).stamp(
            &site(3, 4),
            &mut Random::new(1, &[]),
            &mut event,
        );
        (event.t_in_ns, event.t_off_ns)
    }

    #[test]
    fn the_error_grows_in_proportion_to_time() {
        assert_eq!(stamped(50e-6, 0, 1_000_000), (0, 1_000_050));
        assert_eq!(stamped(50e-6, 10_000_000_000, 20_000_000_000), (10_000_500_000, 20_001_000_000));
        assert_eq!(stamped(-50e-6, 10_000_000_000, 20_000_000_000), (9_999_500_000, 19_999_000_000));
    }

    #[test]
    fn instants_before_zero_drift_the_other_way() {
        assert_eq!(stamped(1e-3, -1_000_000, -1_000), (-1_001_000, -1_001));
    }
}
