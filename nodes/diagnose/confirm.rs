//! `diagnose/confirm`: one answer from direct tests and from what was decided on a scene, the description
//! with what was found put in, and the proof.
//!
//! The verdict joins what the stages before found; the fitted description is the stated one with the claimed
//! effects; the proof predicts held-out frames, nominal and fitted. The report is what `diagnosis.json`
//! holds, byte for byte.
//!
//! Limits: see docs/diagnosis.md. A page is made only when something takes it.

use photocurrent_core::{
    Context, Decl, Diagnosis, DiagnosisKind, DiagnosisMeta, EventStream, FrameSequence, Grain, Meta, Node,
    NodeError, PortMetas, Sensor,
};
use photocurrent_diagnosis::diagnose::{Setting, confirm};
use photocurrent_diagnosis::page::page;
use photocurrent_diagnosis::stages::{read_integrity, read_proposals};
use std::sync::Arc;

photocurrent_core::ports! {
    /// The recording, what is stated of its sensor, and what the stages before found.
    pub struct In {
        /// The events.
        events: Option<EventStream>,
        /// The frames as captured; colours and finer pixels are averaged over each event pixel.
        frames: Option<FrameSequence>,
        /// The nominal description.
        sensor: Arc<Sensor>,
        /// What direct tests saw, a diagnosis of kind `integrity`.
        integrity: Arc<Diagnosis>,
        /// What is decided on a scene, a diagnosis of kind `proposals`; without it direct tests answer alone.
        proposals: Option<Arc<Diagnosis>>,
    }
}

photocurrent_core::ports! {
    /// The answer.
    pub struct Out {
        /// The answer: a diagnosis of kind `report`, what `diagnosis.json` holds.
        report: Arc<Diagnosis>,
        /// The same for people: a diagnosis of kind `page`.
        page: Option<Arc<Diagnosis>>,
        /// The description with what was found put in; nominal when nothing was.
        sensor: Arc<Sensor>,
    }
}

/// The node.
pub struct DiagnoseConfirm {
    setting: Setting,
}

impl Node for DiagnoseConfirm {
    const DECL: Decl = Decl {
        kind: "diagnose/confirm",
        about: "Joins what direct tests found and what was decided on a scene: verdict, fitted description, \
                proof on held-out frames, report.",
        revision: 36,
        grain: Grain::Whole,
        draws: true,
        exports: false,
        sources: &["docs/diagnosis.md, verdicts", "photocurrent-diagnosis/1 (docs/formats.md)"],
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
kind = "diagnose/decide"
in   = { evidence = "evidence", sensor = "integrity.sensor" }

[nodes.confirm]
kind = "diagnose/confirm"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor", integrity = "integrity.findings", proposals = "decide" }
"#,
    };
    type Params = Setting;
    type In = In;
    type Out = Out;

    fn build(setting: Setting) -> Result<Self, NodeError> {
        Ok(DiagnoseConfirm { setting })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let sensor = super::check(inputs)?;
        inputs.diagnosis("integrity")?.need(DiagnosisKind::Integrity, "integrity")?;
        if inputs.has("proposals") {
            inputs.diagnosis("proposals")?.need(DiagnosisKind::Proposals, "proposals")?;
        }
        let document = |kind| Meta::Diagnosis(Arc::new(DiagnosisMeta { kind }));
        Ok(vec![document(DiagnosisKind::Report), document(DiagnosisKind::Page), super::planned(sensor)])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let case = super::case(input.events.as_ref(), input.frames.as_ref(), &input.sensor)?;
        let proposed =
            input.proposals.map(|document| read_proposals(&document)).transpose()?.unwrap_or_default();
        let setting = Setting { seed: cx.seed(), ..self.setting };
        let integrity = read_integrity(&input.integrity)?;
        let before = integrity.findings.len();
        let found = confirm(&case, &setting, integrity, proposed)?;
        found
            .integrity
            .findings
            .iter()
            .skip(before)
            .for_each(|finding| cx.note(format!("{}: {}", finding.id, finding.seen)));
        let text = found
            .report
            .to_json()
            .map_err(|why| NodeError::failed(format!("the report cannot be written as JSON: {why}")))?;
        for id in &found.withdrawn {
            cx.note(format!(
                "{id} is withdrawn: with it, held-out frames are predicted worse by more than {} dB",
                setting.most_worse_db
            ));
        }
        cx.note(format!("{}: {}", found.report.verdict.name(), found.report.summary));
        let page = cx
            .wants("page")
            .then(|| Diagnosis::of(DiagnosisKind::Page, &page(&found.report, Some(&case), Some(&found))))
            .transpose()?;
        Ok(Out {
            report: Arc::new(Diagnosis::from_text(DiagnosisKind::Report, text)?),
            page: page.map(Arc::new),
            sensor: found.fitted.map_or(input.sensor, Arc::new),
        })
    }
}
