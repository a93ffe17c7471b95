//! `diagnose/evidence`: ranks effects by how much they explain of the events' misfit to their thresholds, on
//! a scene that is estimated from frames alone.
//!
//! One moving picture is fitted to the frames. The stated sensor is applied to it, and for every event
//! voltage less reference is compared with the threshold. Each effect of the catalogue is fitted to these
//! residuals and evaluated on held-out blocks of pixels. Random effects are components of their distribution.
//! Uncatalogued dependences are free per bin of every covariate. A control, the stated sensor simulated on
//! that scene with the estimated noise, is evaluated in the same way, and all gains and sizes are relative to
//! it. The direct tests' findings are in the description before.
//!
//! Where the misfit of that scene is too large, the light of each pixel is estimated from frames and events,
//! and every effect is scored with that light adapted.
//!
//! With `target`, `light` or `tracks` the scene is known and no picture is fitted. Events are compared with
//! it, and frame values too, with a column for each effect of frames.
//!
//! Source: docs/diagnosis.md, the moving picture. Limits: where frames do not predict one another and edges
//! pass pixels within a millisecond there is no evidence, and the document gives the reason.

use super::KnownFindings;
use super::target::read_target;
use photocurrent_core::{
    Between, Colour, Context, DataType, Decl, Diagnosis, DiagnosisKind, DiagnosisMeta, EventStream,
    FrameSequence, Grain, Light, Meta, Node, NodeError, PortMetas, Sensor, TrackSet,
};
use photocurrent_diagnosis::residual::ranking::evidence;
use photocurrent_diagnosis::stages::{EvidenceOutcome, write_evidence};
use photocurrent_diagnosis::whole::{
    SceneSetting, SceneSource, amend_or_refuse, evidence_outcome, on_frames,
};
use photocurrent_scene::Scene;
use photocurrent_scene::case::Case;
use photocurrent_scene::known::KnownLight;
use photocurrent_scene::light::LightKnots;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `diagnose/evidence`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(extend("additionalProperties" = false))]
pub struct Params {
    /// Scene and evidence.
    #[serde(flatten)]
    pub on_scene: SceneSetting,
    /// Findings that are applied to the description before.
    pub amend: KnownFindings,
}

photocurrent_core::ports! {
    /// The recording, its description, and the findings of direct tests.
    pub struct In {
        /// The events.
        events: Option<EventStream>,
        /// The frames as captured; colours and finer pixels are averaged over each event pixel.
        frames: Option<FrameSequence>,
        /// The nominal description.
        sensor: Arc<Sensor>,
        /// Findings of the direct tests, a diagnosis of kind `integrity`; without it the description stays as
        /// it is.
        integrity: Option<Arc<Diagnosis>>,
        /// A known target, a diagnosis of kind `target`: no picture is fitted then, and its free parameters
        /// are fitted with every effect.
        target: Option<Arc<Diagnosis>>,
        /// Light that is known, of the array's pixels, grey: no picture is fitted then, either.
        light: Option<Light>,
        /// The same as tracks. Tracks solved from these very events have absorbed most effects of the sensor:
        /// use others.
        tracks: Option<TrackSet>,
    }
}

photocurrent_core::ports! {
    /// The evidence.
    pub struct Out {
        /// Evidence of the residuals for every effect, or the reason why there is none: a diagnosis of kind
        /// `evidence`.
        evidence: Arc<Diagnosis>,
    }
}

/// The node.
pub struct DiagnoseEvidence {
    params: Params,
}

impl DiagnoseEvidence {
    fn compare(&self, input: &In, cx: &Context) -> Result<EvidenceOutcome, NodeError> {
        let case = super::case(input.events.as_ref(), input.frames.as_ref(), &input.sensor)?;
        let integrity = self.params.amend.select_from(input.integrity.as_deref())?;
        let case = match amend_or_refuse(&case, &integrity)? {
            Ok(case) => case,
            Err(why) => return Ok(EvidenceOutcome::Nothing(why)),
        };
        let nominal = case.nominal()?;
        let mut setting = self.params.on_scene;
        setting.evidence.seed = cx.seed();
        let known: Box<dyn Scene> = match (&input.target, &input.light, &input.tracks) {
            (Some(target), ..) => Box::new(read_target(target, &case, &nominal)?),
            (_, Some(light), _) => Box::new(KnownLight::new(&case, &nominal, knots(light, &case)?.into())),
            (.., Some(tracks)) => {
                Box::new(KnownLight::new(&case, &nominal, sampled_tracks(tracks, &case)?.into()))
            }
            _ => return Ok(on_frames(&case, &nominal, &integrity, &setting)),
        };
        Ok(evidence_outcome(evidence(&case, &nominal, &*known, &setting.evidence)))
    }
}

/// The light of every pixel.
fn knots(light: &Light, case: &Case) -> Result<Vec<LightKnots>, NodeError> {
    let band = light.read(case.extent.rows())?;
    let of = |pixel: usize| {
        let (x, y) = case.pixel_place(pixel);
        let series = band.pixel(x, y);
        (series.t.to_vec(), series.photocurrent.iter().map(|i| f64::from(*i)).collect())
    };
    Ok((0..case.extent.pixels()).map(of).collect())
}

/// Light of every pixel from tracks, at even instants.
fn sampled_tracks(tracks: &TrackSet, case: &Case) -> Result<Vec<LightKnots>, NodeError> {
    /// Between them light is linear, ns.
    const STEP_NS: usize = 100_000;
    let band = tracks.read(case.extent.rows())?;
    let is_held = tracks.meta.between == Between::Hold;
    let instants: Vec<i64> = (case.span.0..=case.span.1).step_by(STEP_NS).collect();
    let of = |pixel: usize| -> LightKnots {
        let (x, y) = case.pixel_place(pixel);
        let series = band.pixel(x, y);
        let (t, light) = (series.t, series.photocurrent);
        if t.is_empty() {
            return (Vec::new(), Vec::new());
        }
        let at = |instant: i64| {
            let after = t.partition_point(|knot| *knot <= instant);
            let (before, next) = (after.saturating_sub(1), after.min(t.len() - 1));
            let (from, to) = (f64::from(light[before]), f64::from(light[next]));
            if is_held || before == next || t[before] > instant {
                return from;
            }
            let share = (instant - t[before]) as f64 / (t[next] - t[before]) as f64;
            from * libm::pow(to / from, share)
        };
        (instants.clone(), instants.iter().map(|instant| at(*instant)).collect())
    };
    Ok((0..case.extent.pixels()).map(of).collect())
}

impl Node for DiagnoseEvidence {
    const DECL: Decl = Decl {
        kind: "diagnose/evidence",
        about: "Computes how much of the events' misfit to their thresholds each effect of the catalogue \
                explains, on a scene of frames alone or of frames and events, or on known light.",
        revision: 23,
        grain: Grain::Whole,
        draws: true,
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
kind   = "diagnose/evidence"
in     = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor", integrity = "integrity.findings" }
params = { refined = 8 }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(DiagnoseEvidence { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        super::check(inputs)?;
        if inputs.has("integrity") {
            inputs.diagnosis("integrity")?.need(DiagnosisKind::Integrity, "integrity")?;
        }
        if inputs.has("target") {
            inputs.diagnosis("target")?.need(DiagnosisKind::Target, "target")?;
            if inputs.has("light") || inputs.has("tracks") {
                return Err(NodeError::usage("`target` and another scene are connected")
                    .hint("connect one of `target`, `light` and `tracks`")
                    .blames(DataType::Diagnosis));
            }
        }
        if let Ok(light) = inputs.light("light") {
            let extent = super::empty(inputs)?.extent;
            if light.extent != extent || light.colour != Colour::Mono {
                return Err(NodeError::usage(format!(
                    "the light is of {} pixels, {}, and the recording of {extent}, grey",
                    light.extent, light.colour
                ))
                .hint("make the light of the array's own pixels, without colours")
                .blames(DataType::Light));
            }
        }
        if let Ok(tracks) = inputs.tracks("tracks") {
            let extent = super::empty(inputs)?.extent;
            if inputs.has("light") {
                return Err(NodeError::usage("`light` and `tracks` are both connected")
                    .hint("connect one of them")
                    .blames(DataType::Tracks));
            }
            if tracks.extent != extent || tracks.colour != Colour::Mono {
                return Err(NodeError::usage(format!(
                    "the tracks are of {} pixels, {}, and the recording of {extent}, grey",
                    tracks.extent, tracks.colour
                ))
                .hint("solve the array's own pixels, without colours")
                .blames(DataType::Tracks));
            }
        }
        Ok(vec![Meta::Diagnosis(Arc::new(DiagnosisMeta { kind: DiagnosisKind::Evidence }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let seen = if self.params.on_scene.scene == SceneSource::None
            && input.target.is_none()
            && input.light.is_none()
            && input.tracks.is_none()
        {
            EvidenceOutcome::NotAsked
        } else {
            self.compare(&input, cx)?
        };
        match &seen {
            EvidenceOutcome::NotAsked => {}
            EvidenceOutcome::Nothing(why) => cx.note(format!("the scene gives no evidence: {why}")),
            EvidenceOutcome::Evidence(found) => cx.note(format!(
                "{} events evaluated, in places with {:.0} % of all",
                found.events,
                100.0 * found.share
            )),
        }
        let written = match (write_evidence(&seen), &seen) {
            (Err(_), EvidenceOutcome::Evidence(_)) => {
                write_evidence(&EvidenceOutcome::Nothing("the evidence on this scene is not finite".into()))
            }
            (written, _) => written,
        };
        Ok(Out { evidence: Arc::new(written?) })
    }
}
