//! `diagnose/decide`: probabilities from evidence: that something differs from the stated sensor, which
//! effect it is, whether there is a second one, or that it is in no catalogue.
//!
//! One small model with calibrated numbers for each kind of scene, all of them parameters here;
//! `photocurrent-calibrate` makes them anew from simulated recordings. Evidence is cached by itself, so that
//! another model or threshold is tried in no time.
//!
//! Source: docs/diagnosis.md, the moving picture. Limits: without evidence, or where what is left has no
//! explanation, nothing is decided, and the proposals say why.

use photocurrent_core::{
    Context, Decl, Diagnosis, DiagnosisKind, DiagnosisMeta, Grain, Meta, Node, NodeError, PortMetas, Sensor,
};
use photocurrent_diagnosis::decide::Decision;
use photocurrent_diagnosis::stages::{Proposed, read_evidence, write_proposals};
use photocurrent_diagnosis::whole::proposed;
use photocurrent_scene::nominal::Nominal;
use std::sync::Arc;

photocurrent_core::ports! {
    /// What the events say, and the description that they were held against.
    pub struct In {
        /// What residuals say of every effect, a diagnosis of kind `evidence`.
        evidence: Arc<Diagnosis>,
        /// The description, with what direct tests found.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// What may be missing.
    pub struct Out {
        /// What is decided, or why nothing is: a diagnosis of kind `proposals`.
        proposals: Arc<Diagnosis>,
    }
}

/// The node.
pub struct DiagnoseDecide {
    decision: Decision,
}

impl Node for DiagnoseDecide {
    const DECL: Decl = Decl {
        kind: "diagnose/decide",
        about: "Makes probabilities of evidence: that something differs, which effect it is, a second one, \
                or none of the catalogue.",
        revision: 20,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["docs/diagnosis.md, the moving picture"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.integrity]
kind = "diagnose/integrity"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }

[nodes.evidence]
kind = "diagnose/evidence"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor", integrity = "integrity.findings" }

[nodes.decide]
kind   = "diagnose/decide"
in     = { evidence = "evidence", sensor = "integrity.sensor" }
params = { least = 0.9 }
"#,
    };
    type Params = Decision;
    type In = In;
    type Out = Out;

    fn build(decision: Decision) -> Result<Self, NodeError> {
        Ok(DiagnoseDecide { decision })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        inputs.diagnosis("evidence")?.need(DiagnosisKind::Evidence, "evidence")?;
        inputs.sensor("sensor")?;
        Ok(vec![Meta::Diagnosis(Arc::new(DiagnosisMeta { kind: DiagnosisKind::Proposals }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let seen = read_evidence(&input.evidence)?;
        let proposed = proposed(seen, &Nominal::of(&input.sensor), &self.decision);
        if let Proposed::Nothing(why) = &proposed {
            cx.note(format!("nothing is decided: {why}"));
        }
        Ok(Out { proposals: Arc::new(write_proposals(&proposed)?) })
    }
}
