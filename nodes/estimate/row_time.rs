//! `estimate/row_time`: the delay from one row of the frames to the next.
//!
//! The shift at which events and frames agree, by bands of rows, over rows. A row time that frames are read
//! with is not used: their middles are those of row 0.
//!
//! Limits: it needs motion in many rows; a scene that repeats within a frame period has several shifts.

use super::{In, Row, Settings, panel, table};
use photocurrent_core::{Context, Decl, Grain, Meta, Node, NodeError, PortMetas, Table};
use photocurrent_sensor::estimate;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `estimate/row_time`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Frames that are looked at, at most: all of a short recording, otherwise runs of neighbours spread over
    /// it.
    #[schemars(range(min = 2, max = 512))]
    pub frames: usize,
}

impl Default for Params {
    fn default() -> Params {
        Params { frames: 48 }
    }
}

photocurrent_core::ports! {
    /// What was found.
    pub struct Out {
        /// `row_time`, us: positive when lower rows are exposed later.
        estimates: Arc<Table>,
    }
}

/// The node.
pub struct EstimateRowTime {
    params: Params,
}

impl Node for EstimateRowTime {
    const DECL: Decl = Decl {
        kind: "estimate/row_time",
        about: "Delay from row to row of the frames, from the shift of events by rows, with an interval.",
        revision: 2,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["kalibr, issue 74: what the stamp of a rolling shutter means"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.row_time]
kind = "estimate/row_time"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(EstimateRowTime { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        super::plan(inputs)
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let settings = Settings { frames: self.params.frames, by_front_end: true, ..Settings::default() };
        let panel = panel(&input.events, &input.frames, input.sensor.as_deref(), &settings)?;
        let found = estimate::row_time(&panel);
        if found.is_none() {
            cx.note("too few bands of rows show a shift: nothing moves there");
        }
        Ok(Out { estimates: Arc::new(table(&[Row::new("row_time", found, "us", 1e3)])) })
    }
}
