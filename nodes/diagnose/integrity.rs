//! `diagnose/integrity`: tests of a recording that need no estimate of its scene.
//!
//! They detect inconsistent data, stamps on a coarser grid than stated, a readout queue, hot rows and pixels,
//! noise events, lost events, events in step with the frames, leaks, lost light and late events; and flicker
//! of the light, which is no fault of the sensor. The findings are applied to a copy of the description, so
//! that later stages search for the rest.
//!
//! Limits: every test is strict, and the absence of findings proves nothing. Hot rows and pixels are listed
//! in the findings only: they are left out, not described.

use photocurrent_core::{
    Context, Decl, Diagnosis, DiagnosisKind, DiagnosisMeta, EventStream, FrameSequence, Grain, Meta, Node,
    NodeError, PortMetas, Sensor,
};
use photocurrent_diagnosis::diagnose::{amend_case, check};
use photocurrent_diagnosis::integrity::Integrity;
use photocurrent_diagnosis::stages::write_integrity;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `diagnose/integrity`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The tests that are run.
    pub tests: TestSelection,
}

/// Which tests count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TestSelection {
    /// All of them.
    #[default]
    All,
    /// Only those of the data's consistency: departures of the sensor are left to the stages that estimate
    /// the scene.
    BrokenData,
}

photocurrent_core::ports! {
    /// The recording, at least one of its streams, and its description.
    pub struct In {
        /// The events.
        events: Option<EventStream>,
        /// The frames as captured; colours and finer pixels are averaged over each event pixel.
        frames: Option<FrameSequence>,
        /// The description to be held against them.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// The findings.
    pub struct Out {
        /// The findings: a diagnosis of kind `integrity`.
        findings: Arc<Diagnosis>,
        /// The description with the findings applied; the nominal one without findings.
        sensor: Arc<Sensor>,
    }
}

/// The node.
pub struct DiagnoseIntegrity {
    params: Params,
}

impl Node for DiagnoseIntegrity {
    const DECL: Decl = Decl {
        kind: "diagnose/integrity",
        about: "Tests a recording without an estimate of its scene: broken data, stamps, hot rows and \
                pixels, noise, loss.",
        revision: 14,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["docs/diagnosis.md, direct tests"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.integrity]
kind = "diagnose/integrity"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(DiagnoseIntegrity { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let sensor = super::check(inputs)?;
        Ok(vec![
            Meta::Diagnosis(Arc::new(DiagnosisMeta { kind: DiagnosisKind::Integrity })),
            super::planned(sensor),
        ])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let case = super::case(input.events.as_ref(), input.frames.as_ref(), &input.sensor)?;
        let found = check(&case)?;
        let found = match self.params.tests {
            TestSelection::All => found,
            TestSelection::BrokenData => {
                Integrity { findings: Vec::new(), masked: Vec::new(), dependences: Vec::new(), ..found }
            }
        };
        found.broken.iter().chain(&found.lacking).for_each(|why| cx.note(why.as_str()));
        found.findings.iter().for_each(|finding| cx.note(format!("{}: {}", finding.id, finding.seen)));
        found.dependences.iter().for_each(|dependence| cx.note(dependence.equation()));
        Ok(Out {
            findings: Arc::new(write_integrity(&found)?),
            sensor: Arc::new(amend_case(&case, &found)?.sensor),
        })
    }
}
