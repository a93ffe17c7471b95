//! `diagnose/confirm`: joins direct tests and the decision on a scene into a verdict, the fitted description
//! and the held-out check.
//!
//! The fitted description is the stated one with the reported effects. The check predicts held-out frames
//! with the nominal and with the fitted description. The report is the content of `diagnosis.json`, byte for
//! byte.
//!
//! Limits: see docs/diagnosis.md. A page is made only when an output takes it.

use photocurrent_core::{
    Context, Decl, Diagnosis, DiagnosisKind, DiagnosisMeta, EventStream, FrameSequence, Grain, Meta, Node,
    NodeError, PortMetas, Sensor,
};
use photocurrent_diagnosis::diagnose::{ConfirmSetting, confirm};
use photocurrent_diagnosis::page::page;
use photocurrent_diagnosis::stages::{read_integrity, read_proposals};
use std::sync::Arc;

photocurrent_core::ports! {
    /// The recording, its description, and the results of the stages before.
    pub struct In {
        /// The events.
        events: Option<EventStream>,
        /// The frames as captured; colours and finer pixels are averaged over each event pixel.
        frames: Option<FrameSequence>,
        /// The nominal description.
        sensor: Arc<Sensor>,
        /// Findings of the direct tests, a diagnosis of kind `integrity`.
        integrity: Arc<Diagnosis>,
        /// The decision on a scene, a diagnosis of kind `proposals`; without it direct tests decide alone.
        proposals: Option<Arc<Diagnosis>>,
    }
}

photocurrent_core::ports! {
    /// The answer.
    pub struct Out {
        /// A diagnosis of kind `report`: the content of `diagnosis.json`.
        report: Arc<Diagnosis>,
        /// The same for people: a diagnosis of kind `page`.
        page: Option<Arc<Diagnosis>>,
        /// The description with the findings applied; the nominal one without findings.
        sensor: Arc<Sensor>,
    }
}

/// The node.
pub struct DiagnoseConfirm {
    setting: ConfirmSetting,
}

impl Node for DiagnoseConfirm {
    const DECL: Decl = Decl {
        kind: "diagnose/confirm",
        about: "Joins direct tests and the decision on a scene: verdict, fitted description, check on \
                held-out frames, report.",
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
    type Params = ConfirmSetting;
    type In = In;
    type Out = Out;

    fn build(setting: ConfirmSetting) -> Result<Self, NodeError> {
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
        let setting = ConfirmSetting { seed: cx.seed(), ..self.setting };
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
