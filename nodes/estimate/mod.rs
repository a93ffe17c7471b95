//! Estimates values that a file lacks from its own events and frames: proposals with an interval, for a
//! description or a reader.
//!
//! - [`offset`]: delay of events after frames, and drift between the clocks.
//! - [`row_time`]: the delay from row to row.
//! - [`thresholds`]: the log change of an ON and of an OFF event.
//! - [`held_out`]: the same by held-out frames, for `photocurrent init`.
//! - [`exposure`]: the length of the exposure that blurred the frames.
//! - [`alignment`]: errors of the event pixels' places on the frames.
//!
//! All evaluate some frames and the busiest pixels of every band of rows ([`panel()`]) and call one function
//! of [`photocurrent_sensor::estimate`]. A value that the scene does not determine is "not measured" in the
//! table, never a guess.

pub mod alignment;
pub mod exposure;
pub mod held_out;
pub mod offset;
mod panel;
pub mod row_time;
pub mod thresholds;

#[cfg(test)]
mod tests;

pub use panel::{PanelSettings, panel};

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
        /// The description: black level and saturation are used where they are stated.
        sensor: Option<Arc<Sensor>>,
    }
}

/// Parameters of estimates without further ones.
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

/// Estimates of a sensor from events and frames, for a first description.
#[derive(Clone, Debug, Default)]
pub struct SensorEstimates {
    /// Delay of events after frames, ns; `None` where nothing clearly moves.
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
    fn panel(&self, settings: &PanelSettings) -> Result<estimate::Panel, NodeError> {
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
) -> Result<SensorEstimates, NodeError> {
    let panel = panel(events, frames, None, &PanelSettings { by_row: true, ..PanelSettings::default() })?;
    let offset_ns = estimate::offset(&panel).map(|shift| shift.ns);
    let late = offset_ns.unwrap_or(stated_estimate(0.0));
    let thresholds = estimate::thresholds(&panel, late.value).map(|steps| (steps.on, steps.off));
    let exposure =
        exposure::exposure_length(&panel, thresholds.map(|(on, off)| (on.value, off.value)), &late);
    let exposure_unclear = exposure.as_ref().err().cloned();
    let given = thresholds.map(|(on, off)| (on.value, off.value)).filter(|(on, off)| on.min(*off) > 0.0);
    let length_ns = anchor.and(exposure.as_ref().ok()).map(|exposure| exposure.value as i64);
    let given = held_out::KnownTimes {
        late_ns: offset_ns.map(|late| late.value),
        thresholds: given,
        anchor,
        length_ns,
    };
    let held_out = held_out::chosen(events, frames, &given)?;
    Ok(SensorEstimates { offset_ns, thresholds, held_out, exposure_ns: exposure.ok(), exposure_unclear })
}

/// A stated value, without an interval.
fn stated_estimate(value: f64) -> Estimate {
    Estimate { value, ci95: (value, value) }
}

/// One row of the table: name, value with interval, its unit, and that unit in the estimate's own.
struct TableRow {
    name: &'static str,
    found: Option<Estimate>,
    unit: &'static str,
    scale: f64,
}

impl TableRow {
    /// `scale` of the estimate's own unit make one of `unit`.
    fn new(name: &'static str, found: Option<Estimate>, unit: &'static str, scale: f64) -> TableRow {
        TableRow { name, found, unit, scale }
    }
}

/// Values with their intervals; NaN where not measured.
fn table(rows: &[TableRow]) -> Table {
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
