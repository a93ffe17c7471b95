//! A pixel's events as times and signed log steps: what the solver and the double integrals work on.
//!
//! Stamps: the in-pixel time where the recording has it; otherwise the off-pixel time less the sensor's
//! smallest readout latency. The description's `clock_offset` is subtracted, so that events and frames share
//! one clock. Steps: the compensated ones where a node before made them, otherwise plus or minus the
//! threshold.

use photocurrent_core::events::{EventRow, Polarity};
use photocurrent_core::quantity::Duration;
use photocurrent_core::sensor::Reset;
use photocurrent_core::{EventsMeta, NodeError, Sensor};
use photocurrent_sensor::effects::clock_offset::ClockOffset;
use serde::{Deserialize, Serialize};

/// Which stamp dates an event.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Stamp {
    /// The in-pixel time where there is one, else the off-pixel time less the smallest latency.
    #[default]
    Best,
    /// The off-pixel time as recorded: what ordinary cameras give.
    OffPixel,
}

/// How events become times and steps.
#[derive(Clone, Copy, Debug)]
pub struct StepRule {
    /// ON threshold, natural-log units.
    pub threshold_on: f64,
    /// OFF threshold, natural-log units.
    pub threshold_off: f64,
    /// Which stamp dates an event.
    pub stamp: Stamp,
    /// Subtracted from every stamp, ns: clock offset, smallest latency or an assumed one.
    pub shift_ns: i64,
}

impl StepRule {
    /// From the sensor description, for events of a kind.
    ///
    /// # Errors
    /// When a threshold or a clock offset is needed and not stated, or not readable.
    pub fn from_sensor(
        sensor: &Sensor,
        events: &EventsMeta,
        stamp: Stamp,
        who: &str,
    ) -> Result<StepRule, NodeError> {
        sensor.need_all(&StepRule::needs(sensor), who)?;
        let latency = match stamp {
            Stamp::Best if !events.has_t_in => sensor.readout.latency_min.map_or(0, Duration::ns),
            _ => 0,
        };
        Ok(StepRule {
            threshold_on: sensor.need(sensor.comparator.threshold_on, "comparator.threshold_on", who)?,
            threshold_off: sensor.need(sensor.comparator.threshold_off, "comparator.threshold_off", who)?,
            stamp,
            shift_ns: latency + clock_offset(sensor)?.offset_ns,
        })
    }

    /// The fields that [`StepRule::from_sensor`] needs, and whether they are stated: for
    /// [`Sensor::need_all`].
    pub fn needs(sensor: &Sensor) -> [(&'static str, bool); 2] {
        let comparator = &sensor.comparator;
        [
            ("comparator.threshold_on", comparator.threshold_on.is_some()),
            ("comparator.threshold_off", comparator.threshold_off.is_some()),
        ]
    }

    /// Time of event `k` of a row, ns.
    pub fn time(&self, row: &EventRow, k: usize) -> i64 {
        let stamp = match (self.stamp, row.t_in) {
            (Stamp::Best, Some(t_in)) => t_in[k],
            _ => row.t[k],
        };
        stamp - self.shift_ns
    }

    /// Signed log step of event `k` of a row.
    pub fn step(&self, row: &EventRow, k: usize) -> f64 {
        match row.step {
            Some(step) => f64::from(step[k]),
            None => self.plain_step(Polarity::from_bit(row.on[k])),
        }
    }

    /// Signed threshold of a polarity.
    pub fn plain_step(&self, polarity: Polarity) -> f64 {
        match polarity {
            Polarity::On => self.threshold_on,
            Polarity::Off => -self.threshold_off,
        }
    }
}

/// The description's clock offset: recorded = true + offset; zero when not stated.
///
/// # Errors
/// When `[effects] clock_offset` has no readable `offset`.
pub fn clock_offset(sensor: &Sensor) -> Result<ClockOffset, NodeError> {
    let Some(params) = sensor.effects.get("clock_offset") else { return Ok(ClockOffset::default()) };
    let offset = params.get("offset").and_then(|v| v.as_str()).map(str::parse::<Duration>);
    match offset {
        Some(Ok(offset)) if params.len() == 1 => Ok(ClockOffset { offset_ns: offset.ns() }),
        Some(Err(error)) => {
            Err(NodeError::usage(format!("`effects.clock_offset.offset` of \"{}\": {error}", sensor.name)))
        }
        _ => {
            Err(NodeError::usage(format!("`effects.clock_offset` of \"{}\" is not understood", sensor.name))
                .hint("write clock_offset = { offset = \"6 ms\" }"))
        }
    }
}

/// What the description states and neither solver nor simulator models yet, as a sentence for the user;
/// `None` when there is nothing.
pub fn left_out(sensor: &Sensor) -> Option<String> {
    let mut left: Vec<String> =
        sensor.effects.keys().filter(|id| *id != "clock_offset").map(|id| format!("effects.{id}")).collect();
    if sensor.comparator.reset != Reset::Resample {
        left.push("comparator.reset (V_ref is taken as resampled)".into());
    }
    (!left.is_empty()).then(|| {
        format!(
            "stated in the sensor description \"{}\" but not modelled here: {}",
            sensor.name,
            left.join(", ")
        )
    })
}

/// Refuses events that cannot be compensated.
///
/// # Errors
/// When in-pixel times are missing or steps are there already. `who` names the caller in the message,
/// `without` is its hint.
pub fn check_events(events: &EventsMeta, who: &str, without: &str) -> Result<(), NodeError> {
    if events.has_step {
        return Err(NodeError::usage(format!(
            "{who} compensates the readout itself, and `events` were compensated before"
        ))
        .hint("connect the events as recorded"));
    }
    // Without any event there is nothing to compensate, and no stamp to miss.
    if !events.has_t_in && events.span.is_some() {
        return Err(NodeError::usage(format!(
            "{who} needs in-pixel times, and `events` has only off-pixel times"
        ))
        .note("each event has one stamp, the off-pixel one")
        .hint(without));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::document::Source;
    use photocurrent_core::events::Event;
    use photocurrent_core::{Extent, testing};

    fn sensor(effects: &str) -> Sensor {
        let text = format!(
            "format = \"photocurrent-sensor/1\"\n[comparator]\nthreshold_on = 0.2\nthreshold_off = \
                     0.3\n[readout]\nlatency_min = \"1 us\"\n{effects}"
        );
        Sensor::parse(&Source::new("s.toml", "", text)).unwrap()
    }

    #[test]
    fn the_latency_is_subtracted_only_where_there_is_no_in_pixel_time() {
        for (t_in, expected) in [(Some(7_000), 7_000 - 6_000_000), (None, 9_000 - 1_000 - 6_000_000)] {
            let events = testing::stream(
                Extent { width: 1, height: 1 },
                vec![Event { x: 0, y: 0, polarity: Polarity::Off, t: 9_000, t_in }],
            );
            let rule = StepRule::from_sensor(
                &sensor("[effects]\nclock_offset = { offset = \"6 ms\" }"),
                &events.meta,
                Stamp::Best,
                "test",
            )
            .unwrap();
            let band = events.read(events.rows()).unwrap();
            assert_eq!(rule.time(&band.row(0), 0), expected);
            assert_eq!(rule.step(&band.row(0), 0), -0.3);
        }
    }

    #[test]
    fn what_is_not_modelled_is_said() {
        assert_eq!(left_out(&sensor("[effects]\nclock_offset = { offset = \"6 ms\" }")), None);
        let said = left_out(&sensor("[effects]\nleak_events = { rate = \"1 Hz\" }")).unwrap();
        assert!(said.ends_with("not modelled here: effects.leak_events"), "{said}");
    }

    #[test]
    fn a_clock_offset_without_unit_is_refused() {
        assert!(clock_offset(&sensor("[effects]\nclock_offset = { offset = 6 }")).is_err());
        assert!(
            clock_offset(&sensor("[effects]\nclock_offset = { offset = \"6\" }"))
                .unwrap_err()
                .message
                .contains("has no unit")
        );
    }
}
