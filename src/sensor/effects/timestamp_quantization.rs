//! Timestamp quantization: stamps are whole multiples of a step.
//!
//! The stamp is the count of a clock when the event is noted, so it lies up to one step before the truth,
//! never after it. A step that is long against the interval between events makes bursts of equal stamps.
//! Typical: 1 us; 100 us and 1 ms in some sensors and file formats.
//!
//! Sources: manuals of event cameras; recordings whose stamps are multiples of 100 us.
//! Limits: a perfect clock that rounds down; a jagged (nonlinear) in-pixel converter is not here.

use super::clock_offset::ClockOffset;
use super::sought::{Search, Size, Sought, TIME};
use super::{
    Chance, Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, PixelEvent, Site, Stage, Unit,
};
use photocurrent_core::random::Random;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "timestamp_quantization",
        stage: Stage::Time,
        about: "Stamps are rounded down to whole multiples of a step",
        equation: "t_recorded = step * floor(t_true / step)",
        parameters: &[ParameterDecl {
            name: "step",
            unit: Unit::Time,
            null: Some(0.0),
            allowed: (0.0, 10.0),
            plausible: (1e-6, 2e-3),
            about: "distance between two stamps; events come up to one step early",
        }],
        covariate: "time",
        signature: "a comb in the remainder of the stamps by the step; events early by half a step on \
                    average; many equal stamps",
        confused_with: &["timestamp_jitter", "clock_offset", "a readout that scans the rows"],
        source: "manuals of event cameras",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Fixed(120e-6),
            material: TIME,
            is_made: false,
            ..Sought::positive("step")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(TimestampQuantization { step_ns: parameters.need_ns("step")? }))
}

/// Stamps on a grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct TimestampQuantization {
    /// Distance of the grid, nanoseconds, at least zero; zero = no grid.
    pub step_ns: i64,
}

impl TimestampQuantization {
    /// The last instant of the grid that is not after `t_ns`.
    pub(super) fn grid(&self, t_ns: i64) -> i64 {
        // Euclidean, so that instants before zero also go down.
        if self.step_ns > 0 { t_ns - t_ns.rem_euclid(self.step_ns) } else { t_ns }
    }
}

impl Effect for TimestampQuantization {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn stamp(&self, _site: &Site, _random: &mut Random, event: &mut PixelEvent) {
        event.t_in_ns = self.grid(event.t_in_ns);
        event.t_off_ns = self.grid(event.t_off_ns);
    }

    fn chance(&self) -> Option<Chance> {
        // A stamp is the last instant of the grid: half a step early in the mean.
        let early = ClockOffset { offset_ns: -self.step_ns / 2 };
        (self.step_ns > 0).then(|| Chance {
            of_stamps_s: self.step_ns as f64 * 1e-9 / libm::sqrt(12.0),
            known: Some(Box::new(early)),
            ..Chance::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{described, site};
    use super::*;
    use serde_json::json;

    fn stamped(step: &str, t_in_ns: i64, t_off_ns: i64) -> (i64, i64) {
        let mut event = PixelEvent { t_in_ns, t_off_ns, polarity: 1 };
        described("timestamp_quantization", json!({ "step": step })).stamp(
            &site(3, 4),
            &mut Random::new(1, &[]),
            &mut event,
        );
        (event.t_in_ns, event.t_off_ns)
    }

    #[test]
    fn stamps_are_multiples_of_the_step_up_to_one_step_early() {
        assert_eq!(stamped("100 us", 1_234_567, 1_999_999), (1_200_000, 1_900_000));
        assert_eq!(stamped("100 us", -1, 0), (-100_000, 0));
        for t_ns in (-2_000..2_000).step_by(7) {
            let (t_in_ns, t_off_ns) = stamped("1 us", t_ns, t_ns + 300);
            assert!(t_in_ns % 1_000 == 0 && (0..1_000).contains(&(t_ns - t_in_ns)) && t_in_ns <= t_off_ns);
        }
    }

    #[test]
    fn no_step_is_no_change() {
        assert_eq!(stamped("0 ns", 1_234_567, 1_999_999), (1_234_567, 1_999_999));
    }
}
