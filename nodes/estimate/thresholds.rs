//! `estimate/thresholds`: the log change of an ON and of an OFF event.
//!
//! Between two frames a pixel's logarithm changes by the ON threshold for each ON event, and back by the other for each OFF one. A robust fit of the events of the busiest
//! pixels on the change of the frames gives both, from bright pixels alone: in dark ones a step of the scale is a large change, and slow pixels lose events.
//!
//! Limits: frames that are not linear give thresholds of their curve; the front end is taken as ideal.

use super::{In, Row, Settings, panel, table};
use photocurrent_core::quantity::Duration;
use photocurrent_core::{Context, Decl, Grain, Meta, Node, NodeError, PortMetas, Table};
use photocurrent_sensor::estimate;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `estimate/thresholds`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Frames that are looked at, at most: all of a short recording, otherwise runs of neighbours spread over it.
    #[schemars(range(min = 2, max = 512))]
    pub frames: usize,
    /// How late events are against frames; absent = estimated as estimate/offset does.
    pub offset: Option<Duration>,
}

impl Default for Params {
    fn default() -> Params {
        Params { frames: 48, offset: None }
    }
}

photocurrent_core::ports! {
    /// What was found.
    pub struct Out {
        /// `threshold_on` and `threshold_off`, natural-log units, positive.
        estimates: Arc<Table>,
    }
}

/// The node.
pub struct EstimateThresholds {
    params: Params,
}

impl Node for EstimateThresholds {
    const DECL: Decl = Decl {
        kind: "estimate/thresholds",
        about: "Contrast thresholds from the log change of frames an event, with intervals.",
        revision: 2,
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
        super::plan(inputs)
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let settings = Settings { frames: self.params.frames, ..Settings::default() };
        let panel = panel(&input.events, &input.frames, input.sensor.as_deref(), &settings)?;
        let offset_ns = self.params.offset.map(|offset| offset.ns() as f64).or_else(|| estimate::offset(&panel).map(|shift| shift.ns.value)).unwrap_or(0.0);
        let found = estimate::thresholds(&panel, offset_ns);
        match &found {
            Some(found) => cx.note(format!(
                "from {} pixels and pairs of frames that changed by 0.3 or more, sigma {:.3} left, without {} that are too dark; events taken {:.3} ms later",
                found.measured,
                found.sigma,
                found.too_dark,
                offset_ns * 1e-6
            )),
            None => cx.note("too few bright pixels changed by 0.3 or more between frames"),
        }
        let rows = [Row::new("threshold_on", found.map(|found| found.on), "ln", 1.0), Row::new("threshold_off", found.map(|found| found.off), "ln", 1.0)];
        Ok(Out { estimates: Arc::new(table(&rows)) })
    }
}
