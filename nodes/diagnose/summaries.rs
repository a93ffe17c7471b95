//! `diagnose/summaries`: a recording in some three hundred numbers, and how they differ from those of the stated sensor's recording of the same scene.
//!
//! The scene is the recording's own, through its events and anchored to its frames; the stated sensor records it anew. `z` is the difference in spreads of recordings
//! without an effect that are like this one: what recognition by synthesis starts from.
//!
//! Limits: no number alone says much, and a scene absorbs part of every effect.

use photocurrent_core::table::{Column, TableMeta};
use photocurrent_core::{Context, Decl, EventStream, FrameSequence, Grain, Meta, Node, NodeError, PortMetas, Sensor, Table};
use photocurrent_diagnosis::deviation::{FULL, Prepared};
use photocurrent_diagnosis::knowledge::Knowledge;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `diagnose/summaries`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// How many blocks of 6 x 6 pixels are taken from each band of six rows; 1 to 100. The spreads behind `z` are those of 3.
    #[schemars(range(min = 1, max = 100))]
    pub across: u32,
}

impl Default for Params {
    fn default() -> Params {
        Params { across: FULL }
    }
}

photocurrent_core::ports! {
    /// The recording and what is stated of its sensor.
    pub struct In {
        /// The events.
        events: EventStream,
        /// The frames as captured, grey, of the events' pixels.
        frames: FrameSequence,
        /// The description as stated.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// The numbers.
    pub struct Out {
        /// One row a summary: `name`, `recording`, `deviation` (recording less the stated sensor's), `z` (in spreads of recordings without an effect).
        summaries: Arc<Table>,
    }
}

/// The node.
pub struct DiagnoseSummaries {
    params: Params,
}

impl Node for DiagnoseSummaries {
    const DECL: Decl = Decl {
        kind: "diagnose/summaries",
        about: "Brings a recording to some three hundred numbers, beside those of the stated sensor's recording of the same scene.",
        revision: 1,
        grain: Grain::Whole,
        draws: true,
        exports: false,
        sources: &["docs/diagnosis.md, synthesis"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.summaries]
kind = "diagnose/summaries"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(DiagnoseSummaries { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        super::check(inputs)?;
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: false }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let case = super::case(Some(&input.events), Some(&input.frames), &input.sensor)?;
        let knowledge = Knowledge::shipped().map_err(|why| NodeError::failed(format!("the knowledge that is built in cannot be read: {why}")))?;
        let found = Prepared::new(&case, case.nominal()?, self.params.across, cx.seed()).map_err(NodeError::failed)?;
        let z = if found.own.names == knowledge.names {
            knowledge.floor.level(&found.context).z(&found.deviation)
        } else {
            cx.note("the built-in knowledge was made for other summaries: `z` is not known");
            vec![f64::NAN; found.deviation.len()]
        };
        let summaries = Table::default()
            .with("name", Column::Texts(found.own.names.clone()))
            .with("recording", Column::Numbers(found.own.values.clone()))
            .with("deviation", Column::Numbers(found.deviation.clone()))
            .with("z", Column::Numbers(z))
            .note("frame_share", format!("{}", found.conditions.frame_share));
        Ok(Out { summaries: Arc::new(summaries) })
    }
}
