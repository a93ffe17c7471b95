//! `estimate/offset`: the delay of events after frames, and the drift between the two clocks.
//!
//! The log change of frames between mid-exposures is compared with the events between them, at shifts of up
//! to a frame period. Rows are compared at their own exposure. The delay of a front end that the description
//! states (`front_end.alpha`, with `frames.gain`) is subtracted by light. The shift contains every other
//! delay of events: readout latency, an unstated front end, and a clock offset.
//!
//! Limits: no estimate where nothing moves; a scene that repeats within a frame period has several shifts.

pub use super::Params;
use super::{In, PanelSettings, TableRow, table};
use photocurrent_core::{Context, Decl, Grain, Meta, Node, NodeError, PortMetas, Table};
use photocurrent_sensor::estimate;
use std::sync::Arc;

photocurrent_core::ports! {
    /// The results.
    pub struct Out {
        /// `offset`, ms: delay of events after frames, beyond that of a stated front end; `drift`, us per
        /// second.
        estimates: Arc<Table>,
    }
}

/// The node.
pub struct EstimateOffset {
    params: Params,
}

impl Node for EstimateOffset {
    const DECL: Decl = Decl {
        kind: "estimate/offset",
        about: "Delay of events after frames, and drift between the clocks, with intervals.",
        revision: 2,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["the correlation that users make by hand: \
                    panpanfei/Bringing-a-Blurry-Frame-Alive-at-High-Frame-Rate-with-an-Event-Camera, issue \
                    5"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.offset]
kind = "estimate/offset"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(EstimateOffset { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        super::plan(inputs)
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let settings = PanelSettings {
            frames: self.params.frames,
            by_row: true,
            by_front_end: true,
            ..PanelSettings::default()
        };
        let panel = input.panel(&settings)?;
        let shift = estimate::offset(&panel);
        let drift = estimate::drift(&panel);
        match &shift {
            Some(shift) => cx.note(format!(
                "correlation {:.2} at the offset, {:.2} without; {} pairs of frames",
                shift.correlation, shift.correlation_at_none, shift.pairs
            )),
            None => cx.note(
                "events and frames do not clearly agree at any shift: nothing moves, or they \
                             are of different scenes",
            ),
        }
        let rows = [
            TableRow::new("offset", shift.map(|shift| shift.ns), "ms", 1e6),
            TableRow::new("drift", drift.map(|drift| drift.ns_per_s), "us/s", 1e3),
        ];
        Ok(Out { estimates: Arc::new(table(&rows)) })
    }
}
