//! `estimate/row_time`: the delay from one row of the frames to the next.
//!
//! It is the slope over rows of the shift at which events and frames agree, estimated by bands of rows. A row
//! time in the frames' metadata is not used: their mid-exposures are those of row 0.
//!
//! Limits: it needs motion in many rows; a scene that repeats within a frame period has several shifts.

pub use super::Params;
use super::{In, PanelSettings, TableRow, table};
use photocurrent_core::{Context, Decl, Grain, Meta, Node, NodeError, PortMetas, Table};
use photocurrent_sensor::estimate;
use std::sync::Arc;

photocurrent_core::ports! {
    /// The results.
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
        let settings =
            PanelSettings { frames: self.params.frames, by_front_end: true, ..PanelSettings::default() };
        let panel = input.panel(&settings)?;
        let found = estimate::row_time(&panel);
        if found.is_none() {
            cx.note("too few bands of rows show a shift: nothing moves there");
        }
        Ok(Out { estimates: Arc::new(table(&[TableRow::new("row_time", found, "us", 1e3)])) })
    }
}
