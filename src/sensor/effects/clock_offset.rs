//! Clock offset: the event part of the sensor stamps its events on a clock that does not start with the
//! frames'.
//!
//! The recorded stamp is the true time plus a constant. An offset of a fraction of an exposure already
//! misplaces every event inside its frame, and reconstruction shows it as edges doubled along the motion.
//!
//! Parameter: `offset_ns`, any sign, null value 0; from 1 us (synchronised in hardware) to tens of
//! milliseconds (two free-running parts matched by hand). Confused with: a mean readout latency (which no
//! event stamp precedes) and a wrong row time (which grows along the rows). Limits: constant; a drift is
//! another effect.

use super::sought::{DELAY, Search, Size, Sought};
use super::{Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, PixelEvent, Site, Stage, Unit};
use photocurrent_core::random::Random;

/// The catalogue entry.
pub const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "clock_offset",
        stage: Stage::Time,
        about: "The event clock and the frame clock start at different instants",
        equation: "t_recorded = t_true + offset",
        parameters: &[ParameterDecl {
            name: "offset",
            unit: Unit::Time,
            null: Some(0.0),
            allowed: (-1e6, 1e6),
            plausible: (-0.05, 0.05),
            about: "recorded minus true time of an event; negative = events are stamped early",
        }],
        covariate: "slope",
        signature: "frames differ from what events predict in proportion to their rate of change, with one \
                    delay for all pixels",
        confused_with: &["misalignment", "row_time", "time_constant"],
        source: "two clocks; the same constant for every event",
        apart: &[
            (
                "time_constant",
                "the same scene in brighter light: the delay of a time constant shrinks, an offset stays",
            ),
            (
                "second_pole",
                "the same scene at twice the speed, and in brighter light: an offset changes with neither",
            ),
            (
                "misalignment",
                "the same scene moving the other way: a shift changes its sign in time, an offset does not",
            ),
        ],
        search: Search::For(&[Sought {
            typical: Size::Fixed(500e-6),
            material: DELAY,
            is_followed: true,
            ..Sought::both("offset")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(ClockOffset { offset_ns: parameters.need_ns("offset")? }))
}

/// A constant difference between the event clock and the frame clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ClockOffset {
    /// Recorded minus true time, nanoseconds.
    pub offset_ns: i64,
}

/// A stamp so far from zero that the offset moves it out of the range of 64-bit nanoseconds (292 years).
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "stamp {stamp_ns} ns at index {index} cannot be moved by {shift_ns} ns: beyond the range of 64-bit \
         nanoseconds"
)]
pub struct StampOutOfRange {
    /// Position in the slice; stamps before it were already moved.
    pub index: usize,
    /// The stamp that does not fit.
    pub stamp_ns: i64,
    /// The move that was asked for.
    pub shift_ns: i64,
}

impl ClockOffset {
    /// Turns true times into recorded ones, in place: `recorded = true + offset`.
    pub fn record(&self, stamps_ns: &mut [i64]) -> Result<(), StampOutOfRange> {
        shift(stamps_ns, |stamp| stamp.checked_add(self.offset_ns), self.offset_ns)
    }

    /// Turns recorded times back into true ones, in place: the exact inverse of [`ClockOffset::record`].
    pub fn undo(&self, stamps_ns: &mut [i64]) -> Result<(), StampOutOfRange> {
        shift(stamps_ns, |stamp| stamp.checked_sub(self.offset_ns), self.offset_ns.saturating_neg())
    }
}

impl Effect for ClockOffset {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn stamp(&self, _site: &Site, _random: &mut Random, event: &mut PixelEvent) {
        event.t_in_ns += self.offset_ns;
        event.t_off_ns += self.offset_ns;
    }
}

fn shift(
    stamps_ns: &mut [i64],
    moved: impl Fn(i64) -> Option<i64>,
    shift_ns: i64,
) -> Result<(), StampOutOfRange> {
    for (index, stamp) in stamps_ns.iter_mut().enumerate() {
        *stamp = moved(*stamp).ok_or(StampOutOfRange { index, stamp_ns: *stamp, shift_ns })?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn undo_returns_the_true_stamps() {
        let truth = [-5_000, 0, 1, 33_000_000];
        let mut stamps = truth;
        let clock = ClockOffset { offset_ns: -1_234_567 };
        assert_eq!(clock.record(&mut stamps), Ok(()));
        assert_eq!(stamps[1], -1_234_567);
        assert_eq!(clock.undo(&mut stamps), Ok(()));
        assert_eq!(stamps, truth);
    }

    #[test]
    fn no_offset_is_no_change() {
        let mut stamps = [3, 1, 2];
        assert_eq!(ClockOffset::default().record(&mut stamps), Ok(()));
        assert_eq!(stamps, [3, 1, 2]);
    }

    #[test]
    fn a_stamp_at_the_end_of_time_is_refused() {
        let mut stamps = [0, i64::MAX];
        let refused = ClockOffset { offset_ns: 1 }.record(&mut stamps);
        assert_eq!(refused, Err(StampOutOfRange { index: 1, stamp_ns: i64::MAX, shift_ns: 1 }));
    }
}
