//! `diagnose/propose`: which effects explain what the stated sensor leaves of a recording.
//!
//! Where a moving picture is evidence, its decision (`decided`) stands alone. Where it is none, each road estimates a scene of its own and asks every effect of the catalogue how much of
//! the rest it explains: `refit` by estimating the light as a sensor with the effect must have seen it and simulating its events again, `likelihood` event by event and frame by frame with
//! the light of the stated sensor, `synthesis` by putting the effect on the recording's own scene and comparing three hundred summaries. What direct tests found is in the description
//! before. A road that cannot be made (too few events, say) is told, and the others go on.
//!
//! Limits: those of the roads, see docs/diagnosis.md. With too few events or frames for a scene there are no proposals.

use super::Amend;
use photocurrent_core::quantity::InputPath;
use photocurrent_core::{
    Context, Decl, Diagnosis, DiagnosisKind, DiagnosisMeta, EventStream, FileRef, FrameSequence, Grain, Meta, Node, NodeError, PortMetas, Sensor,
};
use photocurrent_diagnosis::diagnose::{Setting, propose};
use photocurrent_diagnosis::knowledge::Knowledge;
use photocurrent_diagnosis::roads;
use photocurrent_diagnosis::stages::{read_proposals, write_proposals};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `diagnose/propose`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Which roads are taken where a moving picture decides nothing, `"refit"`, `"likelihood"` and `"synthesis"`, in any order; none gives what direct tests find alone.
    pub roads: Vec<RoadName>,
    /// What roads take for known.
    pub amend: Amend,
    /// What recordings without an effect look like, for `"synthesis"`: a file made by the training of the diagnosis; absent = what is built in.
    pub knowledge: Option<InputPath>,
}

impl Default for Params {
    fn default() -> Params {
        Params { roads: vec![RoadName::Refit, RoadName::Likelihood, RoadName::Synthesis], amend: Amend::default(), knowledge: None }
    }
}

/// A test that estimates the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RoadName {
    /// The light estimated anew as a sensor with each effect must have seen it.
    Refit,
    /// Event by event, frame value by frame value.
    Likelihood,
    /// By templates of every effect.
    Synthesis,
}

impl RoadName {
    fn name(self) -> &'static str {
        match self {
            RoadName::Refit => "refit",
            RoadName::Likelihood => "likelihood",
            RoadName::Synthesis => "synthesis",
        }
    }
}

photocurrent_core::ports! {
    /// The recording, what is stated of its sensor, and what shows without a scene.
    pub struct In {
        /// The events.
        events: Option<EventStream>,
        /// The frames as captured, grey, of the events' pixels.
        frames: Option<FrameSequence>,
        /// The description as stated.
        sensor: Arc<Sensor>,
        /// What direct tests saw, a diagnosis of kind `integrity`; without it nothing is amended.
        integrity: Option<Arc<Diagnosis>>,
        /// What a moving picture decides, a diagnosis of kind `proposals`; where it decides, no road is taken.
        decided: Option<Arc<Diagnosis>>,
    }
}

photocurrent_core::ports! {
    /// What may be missing.
    pub struct Out {
        /// What each road proposes: a diagnosis of kind `proposals`.
        proposals: Arc<Diagnosis>,
    }
}

/// The node.
pub struct DiagnosePropose {
    params: Params,
}

impl DiagnosePropose {
    fn takes(&self, road: &str) -> bool {
        self.params.roads.iter().any(|taken| taken.name() == road)
    }

    /// What synthesis knows beforehand; none when it is not asked.
    fn knowledge(&self) -> Result<Option<Knowledge>, NodeError> {
        if !self.takes(RoadName::Synthesis.name()) {
            return Ok(None);
        }
        let Some(path) = self.params.knowledge.as_ref().map(InputPath::path) else {
            return Knowledge::shipped().map(Some).map_err(|why| NodeError::failed(format!("the knowledge that is built in cannot be read: {why}")));
        };
        let bytes = std::fs::read(path).map_err(|error| {
            NodeError::files(photocurrent_core::error::cannot_read(path, &error)).hint("paths are relative to the manifest that names them").param("knowledge")
        })?;
        let wrong = |why: String| {
            NodeError::usage(format!("{}: this is no knowledge of the diagnosis: {why}", path.display()))
                .hint("leave `knowledge` out to take what is built in")
                .param("knowledge")
        };
        Knowledge::from_bytes(&bytes).map(Some).map_err(wrong)
    }
}

impl Node for DiagnosePropose {
    const DECL: Decl = Decl {
        kind: "diagnose/propose",
        about: "Asks every effect of the catalogue how much it explains of what the stated sensor leaves of a recording.",
        revision: 11,
        grain: Grain::Whole,
        draws: true,
        exports: false,
        sources: &["docs/diagnosis.md, roads"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.integrity]
kind = "diagnose/integrity"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }

[nodes.propose]
kind   = "diagnose/propose"
in     = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor", integrity = "integrity.findings" }
params = { roads = ["likelihood"] }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if let Some(twice) = (1..params.roads.len()).find(|&at| params.roads[..at].contains(&params.roads[at])) {
            return Err(NodeError::usage(format!("`roads` names \"{}\" twice", params.roads[twice].name()))
                .hint("name each road once")
                .param(format!("roads.{twice}")));
        }
        if params.knowledge.is_some() && !params.roads.contains(&RoadName::Synthesis) {
            return Err(NodeError::usage("`knowledge` is read by \"synthesis\" only, and `roads` does not name it")
                .hint("leave `knowledge` out, or add \"synthesis\" to `roads`")
                .param("knowledge"));
        }
        Ok(DiagnosePropose { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        super::check(inputs)?;
        if inputs.has("integrity") {
            inputs.diagnosis("integrity")?.need(DiagnosisKind::Integrity, "integrity")?;
        }
        if inputs.has("decided") {
            inputs.diagnosis("decided")?.need(DiagnosisKind::Proposals, "decided")?;
        }
        self.knowledge()?;
        Ok(vec![Meta::Diagnosis(Arc::new(DiagnosisMeta { kind: DiagnosisKind::Proposals }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let decided = input.decided.map(|document| read_proposals(&document)).transpose()?.unwrap_or_default();
        if self.params.roads.is_empty() || decided.roads.iter().any(|road| road.decides) {
            return Ok(Out { proposals: Arc::new(write_proposals(&decided)?) });
        }
        let case = super::case(input.events.as_ref(), input.frames.as_ref(), &input.sensor)?;
        let known = self.params.amend.of(input.integrity.as_deref())?;
        let mut roads = roads::all(self.knowledge()?);
        roads.retain(|road| self.takes(road.name));
        cx.begin(roads.len() as u64, "roads");
        let setting = Setting { seed: cx.seed(), ..Setting::default() };
        let mut begun = 0;
        let proposed = propose(&case, &setting, &known, &roads, |_| {
            // A run that is to stop is told at the end of the road.
            let _ = cx.advance(u64::from(begun > 0));
            begun += 1;
        })?;
        cx.advance(u64::from(begun > 0))?;
        Ok(Out { proposals: Arc::new(write_proposals(&proposed)?) })
    }

    fn files(&self) -> Vec<FileRef> {
        self.params.knowledge.iter().map(|path| FileRef { param: "knowledge".into(), path: path.path().into() }).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_road_named_twice_and_knowledge_that_nobody_reads_are_refused() {
        let build = |params| DiagnosePropose::build(params).err().unwrap().message;
        let twice = Params { roads: vec![RoadName::Likelihood, RoadName::Likelihood], ..Params::default() };
        assert_eq!(build(twice), "`roads` names \"likelihood\" twice");
        let unread = Params { roads: vec![RoadName::Likelihood], knowledge: Some(InputPath::new("nulls.bin")), ..Params::default() };
        assert!(build(unread).contains("is read by \"synthesis\" only"));
    }

    #[test]
    fn every_road_of_the_diagnosis_has_a_name_here() {
        let all = DiagnosePropose { params: Params::default() };
        for road in roads::all(all.knowledge().unwrap()) {
            assert!(all.takes(road.name), "{} is a road that no manifest can name", road.name);
        }
    }
}
