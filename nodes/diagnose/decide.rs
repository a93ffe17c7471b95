//! `diagnose/decide`: posterior probabilities from evidence: of a difference from the stated sensor, of each
//! effect, of a second one, and of an uncatalogued dependence.
//!
//! One small model per kind of scene, with calibrated numbers, which are parameters here.
//! `photocurrent-calibrate` recomputes them from simulated recordings. Evidence is cached by itself, so that
//! other numbers or thresholds cost no new evidence.
//!
//! Source: docs/diagnosis.md, the moving picture. Limits: without evidence, or where no effect explains the
//! misfit, the decision abstains, and the proposals give the reason.

use photocurrent_core::{
    Context, Decl, Diagnosis, DiagnosisKind, DiagnosisMeta, Grain, Meta, Node, NodeError, PortMetas, Sensor,
};
use photocurrent_diagnosis::decide::DecisionThresholds;
use photocurrent_diagnosis::stages::{DecisionOutcome, read_evidence, write_proposals};
use photocurrent_diagnosis::whole::decide_outcome;
use photocurrent_scene::nominal::Nominal;
use std::sync::Arc;

photocurrent_core::ports! {
    /// The evidence, and the description with which events were compared.
    pub struct In {
        /// Evidence of the residuals for every effect, a diagnosis of kind `evidence`.
        evidence: Arc<Diagnosis>,
        /// The description, with the direct tests' findings.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// The decision.
    pub struct Out {
        /// The decision, or the reason for abstaining: a diagnosis of kind `proposals`.
        proposals: Arc<Diagnosis>,
    }
}

/// The node.
pub struct DiagnoseDecide {
    decision: DecisionThresholds,
}

impl Node for DiagnoseDecide {
    const DECL: Decl = Decl {
        kind: "diagnose/decide",
        about: "Computes posterior probabilities from evidence: of a difference, of each effect, of a second \
                one, and of none of the catalogue.",
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
    type Params = DecisionThresholds;
    type In = In;
    type Out = Out;

    fn build(decision: DecisionThresholds) -> Result<Self, NodeError> {
        Ok(DiagnoseDecide { decision })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        inputs.diagnosis("evidence")?.need(DiagnosisKind::Evidence, "evidence")?;
        inputs.sensor("sensor")?;
        Ok(vec![Meta::Diagnosis(Arc::new(DiagnosisMeta { kind: DiagnosisKind::Proposals }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let seen = read_evidence(&input.evidence)?;
        let proposed = decide_outcome(seen, &Nominal::of(&input.sensor), &self.decision);
        if let DecisionOutcome::Nothing(why) = &proposed {
            cx.note(format!("no decision: {why}"));
        }
        Ok(Out { proposals: Arc::new(write_proposals(&proposed)?) })
    }
}
