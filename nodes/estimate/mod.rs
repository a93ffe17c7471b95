//! What a file does not say and its own events and frames do: proposals with an interval, for a description
//! or a reader that lacks a value.
//!
//! - [`offset`]: how late events are against frames, and whether the clocks drift apart.
//! - [`row_time`]: the delay from row to row.
//! - [`thresholds`]: the log change of an ON and of an OFF event.
//! - [`held_out`]: the same by frames that are held out, for `photocurrent init`.
//! - [`exposure`]: the length of the exposure that blurred the frames.
//! - [`alignment`]: how far places of the event pixels on the frames miss.
//!
//! All look at some frames and at the busiest pixels of every band of rows ([`panel()`]) and call one
//! function of [`photocurrent_sensor::estimate`]. A value that the scene does not show is "not measured" in
//! the table, never a guess.

pub mod alignment;
pub mod exposure;
pub mod held_out;
pub mod offset;
mod panel;
pub mod row_time;
pub mod thresholds;

#[cfg(test)]
mod tests;

pub use panel::{Settings, panel};

use crate::spans::check_one_clock;
use photocurrent_core::table::{Column, TableMeta};
use photocurrent_core::{EventStream, FrameSequence, Meta, NodeError, PortMetas, Sensor, Table};
use photocurrent_sensor::estimate;
pub use photocurrent_sensor::estimate::Estimate;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

photocurrent_core::ports! {
    /// The recording.
    pub struct In {
        /// The events.
        events: EventStream,
        /// The frames as captured, of the events' pixels or a whole multiple.
        frames: FrameSequence,
        /// What is known of the sensor: black level and saturation are used where they are stated.
        sensor: Option<Arc<Sensor>>,
    }
}

/// Parameters of what needs nothing else.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Frames that are evaluated, at most: all of a short recording, otherwise runs of neighbours spread over
    /// it.
    #[schemars(range(min = 2, max = 512))]
    pub frames: usize,
}

impl Default for Params {
    fn default() -> Params {
        Params { frames: 48 }
    }
}

/// What events and frames together say of a sensor, for a description that has to begin somewhere.
#[derive(Clone, Debug, Default)]
pub struct Proposals {
    /// How late events are against frames, ns; none where nothing clearly moves.
    pub offset_ns: Option<Estimate>,
    /// Contrast thresholds, natural-log units.
    pub thresholds: Option<(Estimate, Estimate)>,
    /// Those with which frames that are held out are predicted best, and exposure and offset, where that can
    /// be tried.
    pub held_out: Option<held_out::HeldOut>,
    /// Length of the exposure, ns.
    pub exposure_ns: Option<Estimate>,
    /// Why there is none, where there is none.
    pub exposure_unclear: Option<String>,
}

impl In {
    /// The frames that are evaluated, and the events between them.
    fn panel(&self, settings: &Settings) -> Result<estimate::Panel, NodeError> {
        panel(&self.events, &self.frames, self.sensor.as_deref(), settings)
    }
}

/// Estimates everything that can be estimated at once. Where the exposure is not recorded, `anchor` is the
/// instant of it that stays when its length changes: 0 its start, 1 its end.
///
/// # Errors
/// When a stream cannot be read, or frames are no whole multiple of the events' pixels.
pub fn proposals(
    events: &EventStream,
    frames: &FrameSequence,
    anchor: Option<f64>,
) -> Result<Proposals, NodeError> {
    let panel = panel(events, frames, None, &Settings { by_row: true, ..Settings::default() })?;
    let offset_ns = estimate::offset(&panel).map(|shift| shift.ns);
    let late = offset_ns.unwrap_or(exactly(0.0));
    let thresholds = estimate::thresholds(&panel, late.value).map(|steps| (steps.on, steps.off));
    let exposure = exposure::of(&panel, thresholds.map(|(on, off)| (on.value, off.value)), &late);
    let exposure_unclear = exposure.as_ref().err().cloned();
    let given = thresholds.map(|(on, off)| (on.value, off.value)).filter(|(on, off)| on.min(*off) > 0.0);
    let length_ns = anchor.and(exposure.as_ref().ok()).map(|exposure| exposure.value as i64);
    let given =
        held_out::Given { late_ns: offset_ns.map(|late| late.value), thresholds: given, anchor, length_ns };
    let held_out = held_out::chosen(events, frames, &given)?;
    Ok(Proposals { offset_ns, thresholds, held_out, exposure_ns: exposure.ok(), exposure_unclear })
}

/// A value that is stated.
fn exactly(value: f64) -> Estimate {
    Estimate { value, ci95: (value, value) }
}

/// One row of the table: what it is called, value with interval, its unit, and what one is in the estimate's
/// own.
struct Row {
    name: &'static str,
    found: Option<Estimate>,
    unit: &'static str,
    scale: f64,
}

impl Row {
    /// `scale` of the estimate's own unit make one of `unit`.
    fn new(name: &'static str, found: Option<Estimate>, unit: &'static str, scale: f64) -> Row {
        Row { name, found, unit, scale }
    }
}

/// Values with their intervals; what was not measured is NaN.
fn table(rows: &[Row]) -> Table {
    let numbers = |of: fn(&Estimate) -> f64| {
        Column::Numbers(
            rows.iter()
                .map(|row| row.found.as_ref().map_or(f64::NAN, |found| of(found) / row.scale))
                .collect(),
        )
    };
    Table::default()
        .with("quantity", Column::Texts(rows.iter().map(|row| row.name.to_owned()).collect()))
        .with("value", numbers(|found| found.value))
        .with("ci95_low", numbers(|found| found.ci95.0))
        .with("ci95_high", numbers(|found| found.ci95.1))
        .with("unit", Column::Texts(rows.iter().map(|row| row.unit.to_owned()).collect()))
}

/// Refuses, before any data, streams that do not meet.
fn plan(inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
    let (events, frames) = (inputs.events("events")?, inputs.frames("frames")?);
    panel::fits(events, frames)?;
    check_one_clock(events, frames, inputs.sensor("sensor").ok().map(|sensor| &**sensor))?;
    Ok(vec![Meta::Table(Arc::new(TableMeta { scores: false }))])
}
