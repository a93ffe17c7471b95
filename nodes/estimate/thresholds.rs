//! `estimate/thresholds`: the log change of an ON and of an OFF event.
//!
//! Between two frames the log light of a pixel rises by the ON threshold per ON event and falls by the OFF
//! threshold per OFF event. Both are fitted robustly to the change of the frames over the busiest pixels,
//! bright ones alone: in dark ones a step of the scale is a large change, and slow pixels lose events.
//!
//! Where a description states thresholds and the values that a solver needs, they are also evaluated by
//! held-out frames ([`evidence`]). The description is passed on with other thresholds where those predict the
//! frames clearly better, and unchanged otherwise.
//!
//! Limits: nonlinear frames give the thresholds of their curve; the fit assumes an ideal front end.

mod evidence;
#[cfg(test)]
mod tests;

use super::{In, PanelSettings, TableRow, table};
use evidence::{AcceptanceRule, ThresholdPair, ThresholdVerdict};
use photocurrent_core::quantity::Duration;
use photocurrent_core::table::Column;
use photocurrent_core::{Context, DataType, Decl, Grain, Meta, Node, NodeError, PortMetas, Sensor, Table};
use photocurrent_sensor::estimate;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `estimate/thresholds`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Most frames that are evaluated: all of a short recording, otherwise runs of neighbours spread over it.
    #[schemars(range(min = 2, max = 512))]
    pub frames: usize,
    /// How late events are against frames; absent = estimated as estimate/offset does.
    pub offset: Option<Duration>,
    /// Pixels whose held-out frames judge thresholds, at most; half of them search, the other half decides.
    #[schemars(range(min = 32, max = 65536))]
    pub pixels: usize,
    /// Least improvement on held-out frames, standard errors, at which other thresholds than the
    /// description's are used.
    #[schemars(range(min = 0.0))]
    pub least_z: f64,
    /// And only where held-out frames are missed by at least this share less.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub least_gain: f64,
    /// Search range of a threshold: up to this many times the description's, and down to one part in this
    /// many.
    #[schemars(range(min = 1.0, max = 100.0))]
    pub most_factor: f64,
}

impl Default for Params {
    fn default() -> Params {
        Params { frames: 48, offset: None, pixels: 1024, least_z: 3.0, least_gain: 0.03, most_factor: 4.0 }
    }
}

photocurrent_core::ports! {
    /// The results.
    pub struct Out {
        /// `threshold_on` and `threshold_off`, natural-log units, positive, as the frames measure them, next
        /// to the description's (`description`) and those of `sensor` (`used`); `heldout_gain`, the share by
        /// which held-out frames are missed less with the best thresholds found than with the description's.
        estimates: Arc<Table>,
        /// The description, with other thresholds where those predict held-out frames clearly better, else
        /// unchanged.
        sensor: Option<Arc<Sensor>>,
    }
}

/// The node.
pub struct EstimateThresholds {
    params: Params,
}

impl Node for EstimateThresholds {
    const DECL: Decl = Decl {
        kind: "estimate/thresholds",
        about: "Contrast thresholds from the log change of frames an event, with intervals, and the \
                description with those that held-out frames prefer.",
        revision: 7,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["v2e, issue 60; Brandli, Muller, Delbruck, ISCAS 2014: calibration by frames"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.thresholds]
kind = "estimate/thresholds"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(EstimateThresholds { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let mut metas = super::plan(inputs)?;
        // Thresholds are stated or not, and of whatever size: the plan is the same.
        let none = || Meta::Absent {
            data_type: DataType::Sensor,
            why: "estimate/thresholds got no description".into(),
        };
        metas.push(inputs.sensor("sensor").map_or_else(|_| none(), |sensor| Meta::Sensor(sensor.clone())));
        Ok(metas)
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let settings = PanelSettings { frames: self.params.frames, ..PanelSettings::default() };
        let panel = input.panel(&settings)?;
        let offset_ns = self
            .params
            .offset
            .map(|offset| offset.ns() as f64)
            .or_else(|| estimate::offset(&panel).map(|shift| shift.ns.value))
            .unwrap_or(0.0);
        let found = estimate::thresholds(&panel, offset_ns);
        drop(panel);
        match &found {
            Some(found) => cx.note(format!(
                "from {} pixels and pairs of frames that changed by 0.3 or more, sigma {:.3} left, without \
                 {} that are too dark; events taken {:.3} ms later",
                found.measured,
                found.sigma,
                found.too_dark,
                offset_ns * 1e-6
            )),
            None => cx.note("too few bright pixels changed by 0.3 or more between frames"),
        }
        let mut rows = vec![
            TableRow::new("threshold_on", found.map(|found| found.on), "ln", 1.0),
            TableRow::new("threshold_off", found.map(|found| found.off), "ln", 1.0),
        ];
        let stated = input.sensor.as_ref().and_then(|sensor| stated_thresholds(sensor));
        let (mut sensor, mut used) = (input.sensor.clone(), stated);
        let mut gain = None;
        if input.sensor.is_some() && stated.is_none() {
            cx.note("the description does not state both thresholds, and is passed on as it is");
        }
        if let (Some(description), Some(_)) = (&input.sensor, stated) {
            let Params { pixels, least_z, least_gain, most_factor, .. } = self.params;
            let rule = AcceptanceRule { pixels, least_z, least_gain, most_factor };
            let measured = found
                .map(|found| (found.on.value, found.off.value))
                .filter(|(on, off)| *on > 0.0 && *off > 0.0);
            match evidence::evaluate_thresholds(&input, description, measured, &rule, cx)? {
                Err(why) => cx.note(format!("the description's thresholds stay: {why}")),
                Ok(verdict) => {
                    cx.note(verdict_note(&verdict, &rule));
                    gain = Some(verdict.gain());
                    if verdict.is_used {
                        used = Some(verdict.found);
                        sensor = Some(Arc::new(with_thresholds(description, verdict.found)));
                    }
                }
            }
        }
        rows.push(TableRow::new("heldout_gain", gain, "1", 1.0));
        let next_to = |pair: Option<ThresholdPair>| {
            Column::Numbers(pair.map_or([f64::NAN; 3], |(on, off)| [on, off, f64::NAN]).to_vec())
        };
        Ok(Out {
            estimates: Arc::new(
                table(&rows).with("description", next_to(stated)).with("used", next_to(used)),
            ),
            sensor,
        })
    }
}

/// The thresholds of a description that states both.
fn stated_thresholds(sensor: &Sensor) -> Option<ThresholdPair> {
    sensor.comparator.threshold_on.zip(sensor.comparator.threshold_off)
}

fn with_thresholds(description: &Sensor, (on, off): ThresholdPair) -> Sensor {
    let mut sensor = description.clone();
    (sensor.comparator.threshold_on, sensor.comparator.threshold_off) = (Some(on), Some(off));
    sensor
}

/// The result in a sentence.
fn verdict_note(verdict: &ThresholdVerdict, rule: &AcceptanceRule) -> String {
    let ThresholdVerdict { stated, found, gain, pixels, .. } = *verdict;
    let two = |(on, off): ThresholdPair| format!("{on:.3} and {off:.3}");
    let missed = format!(
        "held-out frames of {pixels} pixels are missed by {:.1} % less (z = {:.1})",
        100.0 * gain,
        verdict.z()
    );
    if verdict.is_used {
        format!("thresholds {} instead of the description's {}: {missed}", two(found), two(stated))
    } else if found == stated {
        format!(
            "the description's thresholds {} stay: none was found that predicts held-out frames better",
            two(stated)
        )
    } else if verdict.z_as_solved() <= -rule.least_z {
        let (of_solver, z) = (-100.0 * verdict.as_solved.0, verdict.z_as_solved());
        format!(
            "the description's thresholds {} stay: with {} {missed}, but by {of_solver:.1} % more with the \
             noise that the solver chooses (z = {z:.1})",
            two(stated),
            two(found)
        )
    } else {
        let (share, z) = (100.0 * rule.least_gain, rule.least_z);
        format!(
            "the description's thresholds {} stay: with {} {missed}, and {share:.1} % and z = {z:.1} \
                 are asked for",
            two(stated),
            two(found)
        )
    }
}
