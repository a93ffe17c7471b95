//! `diagnose/evidence`: which effects explain by how much the events of a recording miss their thresholds, on
//! a scene that frames alone state.
//!
//! One moving picture is fitted to the frames; the stated sensor looks at it, and every event says by how
//! much voltage less reference missed its threshold. Each effect of the catalogue is fitted to those
//! residuals and judged on blocks of pixels that it was not fitted to; random effects are parts of their
//! distribution; what no effect has is free per bin of every covariate. A control, the stated sensor on that
//! scene with the noise that was found, goes the same way, and all gains and sizes count from there. What
//! direct tests found is in the description before.
//!
//! Where that scene leaves too much, the light of each pixel is estimated from frames and events, and every
//! effect is scored against what that light would take over.
//!
//! With `target`, `light` or `tracks` the scene is known, and no picture is fitted: events are held against
//! it, and frame values too, with a column of each effect of frames.
//!
//! Source: docs/diagnosis.md, the moving picture. Limits: where frames do not predict one another and
//! edges pass pixels within a millisecond there is no evidence, and the document says why.

use super::Amend;
use super::target::read_target;
use photocurrent_core::{
    Between, Colour, Context, DataType, Decl, Diagnosis, DiagnosisKind, DiagnosisMeta, EventStream,
    FrameSequence, Grain, Light, Meta, Node, NodeError, PortMetas, Sensor, TrackSet,
};
use photocurrent_diagnosis::residual::ranking::evidence;
use photocurrent_diagnosis::stages::{Seen, write_evidence};
use photocurrent_diagnosis::whole::{Estimated, OnScene, amended, on_frames, seen};
use photocurrent_scene::Scene;
use photocurrent_scene::case::Case;
use photocurrent_scene::known::KnownLight;
use photocurrent_scene::light::Knots;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `diagnose/evidence`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(extend("additionalProperties" = false))]
pub struct Params {
    /// The scene, and what events miss on it.
    #[serde(flatten)]
    pub on_scene: OnScene,
    /// What is taken for known.
    pub amend: Amend,
}

photocurrent_core::ports! {
    /// The recording, what is stated of its sensor, and what shows without a scene.
    pub struct In {
        /// The events.
        events: Option<EventStream>,
        /// The frames as captured; colours and finer pixels are averaged over each event pixel.
        frames: Option<FrameSequence>,
        /// The nominal description.
        sensor: Arc<Sensor>,
        /// What direct tests saw, a diagnosis of kind `integrity`; without it nothing is amended.
        integrity: Option<Arc<Diagnosis>>,
        /// A known target, a diagnosis of kind `target`: no picture is fitted then, and what is free of the
        /// target is fitted with every effect.
        target: Option<Arc<Diagnosis>>,
        /// Light that is known, of the array's pixels, grey: no picture is fitted then, either.
        light: Option<Light>,
        /// The same as tracks. Those that were solved from these very events have taken most of what a sensor
        /// does: they should come from elsewhere.
        tracks: Option<TrackSet>,
    }
}

photocurrent_core::ports! {
    /// What the events say.
    pub struct Out {
        /// What the residuals say of every effect, or why there are none: a diagnosis of kind `evidence`.
        evidence: Arc<Diagnosis>,
    }
}

/// The node.
pub struct DiagnoseEvidence {
    params: Params,
}

impl DiagnoseEvidence {
    fn compare(&self, input: &In, cx: &Context) -> Result<Seen, NodeError> {
        let case = super::case(input.events.as_ref(), input.frames.as_ref(), &input.sensor)?;
        let integrity = self.params.amend.of(input.integrity.as_deref())?;
        let case = match amended(&case, &integrity)? {
            Ok(case) => case,
            Err(why) => return Ok(Seen::Nothing(why)),
        };
        let nominal = case.nominal()?;
        let mut setting = self.params.on_scene;
        setting.evidence.seed = cx.seed();
        let known: Box<dyn Scene> = match (&input.target, &input.light, &input.tracks) {
            (Some(target), ..) => Box::new(read_target(target, &case, &nominal)?),
            (_, Some(light), _) => Box::new(KnownLight::new(&case, &nominal, knots(light, &case)?.into())),
            (.., Some(tracks)) => {
                Box::new(KnownLight::new(&case, &nominal, of_tracks(tracks, &case)?.into()))
            }
            _ => return Ok(on_frames(&case, &nominal, &integrity, &setting)),
        };
        Ok(seen(evidence(&case, &nominal, &*known, &setting.evidence)))
    }
}

/// The light of every pixel.
fn knots(light: &Light, case: &Case) -> Result<Vec<Knots>, NodeError> {
    let band = light.read(case.extent.rows())?;
    let of = |pixel: usize| {
        let (x, y) = case.place(pixel);
        let series = band.pixel(x, y);
        (series.t.to_vec(), series.photocurrent.iter().map(|i| f64::from(*i)).collect())
    };
    Ok((0..case.extent.pixels()).map(of).collect())
}

/// The light of every pixel as tracks have it, at even instants.
fn of_tracks(tracks: &TrackSet, case: &Case) -> Result<Vec<Knots>, NodeError> {
    /// Between them light is linear, ns.
    const STEP_NS: usize = 100_000;
    let band = tracks.read(case.extent.rows())?;
    let is_held = tracks.meta.between == Between::Hold;
    let instants: Vec<i64> = (case.span.0..=case.span.1).step_by(STEP_NS).collect();
    let of = |pixel: usize| -> Knots {
        let (x, y) = case.place(pixel);
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
        about: "Computes how much each effect of the catalogue explains of what events miss their \
                thresholds by, on a scene of frames alone or of frames and events, or on known light.",
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
        let seen = if self.params.on_scene.scene == Estimated::None
            && input.target.is_none()
            && input.light.is_none()
            && input.tracks.is_none()
        {
            Seen::NotAsked
        } else {
            self.compare(&input, cx)?
        };
        match &seen {
            Seen::NotAsked => {}
            Seen::Nothing(why) => cx.note(format!("the scene is no evidence: {why}")),
            Seen::Evidence(found) => cx.note(format!(
                "{} events looked at, in places where {:.0} % of all are",
                found.events,
                100.0 * found.share
            )),
        }
        let written = match (write_evidence(&seen), &seen) {
            (Err(_), Seen::Evidence(_)) => {
                write_evidence(&Seen::Nothing("what events say on this scene is not finite".into()))
            }
            (written, _) => written,
        };
        Ok(Out { evidence: Arc::new(written?) })
    }
}
