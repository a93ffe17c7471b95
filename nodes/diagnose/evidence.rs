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
//! With `target`, `light` or `tracks` the scene is known, and no picture is fitted: events are held against
//! it, and frame values too, with a column of each effect of frames.
//!
//! Source: docs/diagnosis.md, the moving picture. Limits: where frames do not predict one another (no single
//! motion, no texture, too few frames) there is no evidence, and the document says why.

use super::Amend;
use super::target::read_target;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{
    Between, Colour, Context, DataType, Decl, Diagnosis, DiagnosisKind, DiagnosisMeta, EventStream,
    FrameSequence, Grain, Light, Meta, Node, NodeError, PortMetas, Sensor, TrackSet,
};
use photocurrent_diagnosis::diagnose::{amend, can_compare};
use photocurrent_diagnosis::residual::evidence::{Evidence, EvidenceSetting};
use photocurrent_diagnosis::residual::ranking::evidence;
use photocurrent_diagnosis::stages::{Seen, write_evidence};
use photocurrent_diagnosis::unstated::without_scene;
use photocurrent_scene::case::Case;
use photocurrent_scene::grey::Grey;
use photocurrent_scene::known::KnownLight;
use photocurrent_scene::light::Knots;
use photocurrent_scene::mosaic::{MosaicSetting, scene};
use photocurrent_scene::moving::MovingPicture;
use photocurrent_scene::picture::PictureSetting;
use photocurrent_scene::picture::patches::PatchSetting;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `diagnose/evidence`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Where the scene is from when no light is connected.
    pub scene: Scene,
    /// What is taken for known.
    pub amend: Amend,
    /// Distance of the picture's coefficients, pixels.
    #[schemars(range(min = 0.3, max = 4.0))]
    pub pitch: f64,
    /// Shortest time between knots of the picture's motion.
    #[schemars(extend("x-min" = "1 ms", "x-max" = "1 s"))]
    pub knot: Duration,
    /// The picture is fitted so many times more to what it leaves.
    #[schemars(range(max = 50))]
    pub again: u32,
    /// The scene is looked at this often.
    #[schemars(extend("x-min" = "10 us", "x-max" = "10 ms"))]
    pub step: Duration,
    /// About so many events are looked at.
    #[schemars(range(min = 500))]
    pub events: u32,
    /// Of at most so many pixels.
    #[schemars(range(min = 20))]
    pub pixels: u32,
    /// Fewer events than this in places that frames predict are no evidence.
    #[schemars(range(min = 100))]
    pub least_events: u32,
    /// Nor is a smaller share of all events.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub least_share: f64,
    /// Light that flickers by a larger share is no evidence: a picture does not flicker.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub most_flicker: f64,
    /// Side of the blocks that gains are held out by, pixels.
    #[schemars(range(min = 2, max = 64))]
    pub block: u32,
    /// So many of the best effects are fitted exactly.
    #[schemars(range(min = 1, max = 60))]
    pub refined: u32,
    /// And so many of a second effect in addition to the first.
    #[schemars(range(min = 1, max = 60))]
    pub refined_second: u32,
    /// In so many rounds for each size.
    #[schemars(range(min = 1, max = 20))]
    pub rounds: u32,
    /// The picture may be softer than the scene by so many times what the control's is.
    #[schemars(range(min = 0.0))]
    pub softness: f64,
    /// Side of the tiles that may have a picture of their own, pixels.
    #[schemars(range(min = 4, max = 256))]
    pub tile: u32,
    /// Which is fitted to so many pixels around the tile as well.
    #[schemars(range(min = 2, max = 64))]
    pub margin: u32,
    /// And to so many frames.
    #[schemars(range(min = 3, max = 64))]
    pub window: u32,
    /// At most so many such pictures are fitted, those of tiles with the most events.
    #[schemars(range(max = 100_000))]
    pub most_parts: u32,
    /// Of a recording with more frame values, only the neighbouring frames with the most events between them
    /// are looked at, as many as have so many values: a fit takes some 300 bytes for each.
    #[schemars(range(min = 1_000))]
    pub most_values: u32,
    /// What a picture is sharpened over for the control, to find what its fit removes, pixels.
    #[schemars(range(min = 0.0, max = 4.0))]
    pub sharpest: f64,
}

impl Default for Params {
    fn default() -> Params {
        let (of, picture, parts) =
            (EvidenceSetting::default(), PictureSetting::default(), MosaicSetting::default());
        Params {
            scene: Scene::default(),
            amend: Amend::default(),
            pitch: picture.pitch,
            knot: Duration::new(picture.knot_ns),
            again: picture.again as u32,
            step: Duration::new(of.step_ns),
            events: of.events as u32,
            pixels: of.pixels as u32,
            least_events: of.least_events as u32,
            least_share: of.least_share,
            most_flicker: 0.01,
            block: of.block as u32,
            refined: of.refined as u32,
            refined_second: of.refined_second as u32,
            rounds: of.rounds as u32,
            softness: of.softness,
            tile: parts.patches.side,
            margin: parts.patches.margin,
            window: parts.patches.frames as u32,
            most_parts: parts.most_parts as u32,
            most_values: picture.most_values as u32,
            sharpest: picture.sharpest,
        }
    }
}

/// Where the scene is from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Scene {
    /// A moving picture, fitted to frames alone, and pictures of parts of the array for a few frames each
    /// where it does not predict them.
    #[default]
    Parts,
    /// One moving picture.
    Picture,
    /// Nowhere: nothing is looked at.
    None,
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
    fn settings(&self, seed: u64) -> (PictureSetting, MosaicSetting, EvidenceSetting) {
        let Params {
            scene: _,
            amend: _,
            pitch,
            knot,
            again,
            step,
            events,
            pixels,
            least_events,
            least_share,
            most_flicker: _,
            block,
            refined,
            refined_second,
            rounds,
            softness,
            tile,
            margin,
            window,
            most_parts,
            most_values,
            sharpest,
        } = self.params.clone();
        let picture = PictureSetting {
            pitch,
            knot_ns: knot.ns(),
            again: again as usize,
            most_values: most_values as usize,
            sharpest,
            ..PictureSetting::default()
        };
        let parts = MosaicSetting::default();
        let patches = PatchSetting { side: tile, margin, frames: window as usize, ..parts.patches };
        let parts = MosaicSetting {
            patches,
            most_parts: most_parts as usize,
            picture: PictureSetting { pitch, knot_ns: knot.ns(), sharpest, ..parts.picture },
            ..parts
        };
        let of = EvidenceSetting {
            step_ns: step.ns(),
            events: events as usize,
            pixels: pixels as usize,
            least_events: least_events as usize,
            least_share,
            block: block as usize,
            refined: refined as usize,
            refined_second: refined_second as usize,
            rounds: rounds as usize,
            softness,
            seed,
            ..EvidenceSetting::default()
        };
        (picture, parts, of)
    }

    fn look(&self, input: &In, cx: &Context) -> Result<Seen, NodeError> {
        let case = super::case(input.events.as_ref(), input.frames.as_ref(), &input.sensor)?;
        let known = self.params.amend.of(input.integrity.as_deref())?;
        if !can_compare(&case, &known) {
            return Ok(Seen::Nothing(
                "there is too little, or it is not sound enough, to estimate a scene".into(),
            ));
        }
        if let Some(why) =
            without_scene(&input.sensor).or_else(|| behind_filters(input.frames.as_ref(), &case))
        {
            return Ok(Seen::Nothing(why));
        }
        let case = amend(&case, &known)?;
        let nominal = case.nominal()?;
        let (picture, parts, of) = self.settings(cx.seed());
        if let Some(target) = &input.target {
            let source = read_target(target, &case, &nominal, &picture)?;
            return Ok(evidence(&case, &nominal, &source, &of)
                .map_or_else(Seen::Nothing, |found| Seen::Evidence(Box::new(found))));
        }
        let given = match (&input.light, &input.tracks) {
            (Some(light), _) => Some(knots(light, &case)?),
            (None, Some(tracks)) => Some(of_tracks(tracks, &case)?),
            (None, None) => None,
        };
        if let Some(given) = given {
            let source = KnownLight::new(&case, &nominal, given.into(), &picture);
            return Ok(evidence(&case, &nominal, &source, &of)
                .map_or_else(Seen::Nothing, |found| Seen::Evidence(Box::new(found))));
        }
        if let Some(flicker) = known.scene.iter().find(|one| one.depth > self.params.most_flicker) {
            return Ok(Seen::Nothing(format!(
                "the light flickers at {:.0} Hz by {:.0} %",
                flicker.frequency_hz,
                100.0 * flicker.depth
            )));
        }
        let part = case.busiest(picture.most_values);
        let (case, span_ns) = part.as_ref().map_or((&case, None), |part| (part, Some(part.span)));
        let source = match self.params.scene {
            Scene::Parts => scene(case, &nominal, &picture, &parts),
            _ => MovingPicture::fit(case, &nominal, &picture)
                .map(|source| Box::new(source) as Box<dyn photocurrent_scene::Scene>),
        };
        let found = source.and_then(|source| evidence(case, &nominal, source.as_ref(), &of));
        Ok(found.map_or_else(Seen::Nothing, |found| Seen::Evidence(Box::new(Evidence { span_ns, ..found }))))
    }
}

/// Why frames behind a mosaic of filters state no scene; none for others.
fn behind_filters(frames: Option<&FrameSequence>, case: &Case) -> Option<String> {
    let meta = &frames?.meta;
    let is_behind = Grey::new(case.extent, meta, &case.sensor).is_ok_and(|grey| grey.is_behind_filters());
    is_behind.then(|| {
        format!(
            "the frames are behind a mosaic of filters ({}): neighbouring pixels measure other light",
            meta.colour
        )
    })
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
        about: "Asks every effect of the catalogue how much it explains of what events miss their \
                thresholds by, on a scene that frames alone state, or on known light.",
        revision: 7,
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
        let seen = if self.params.scene == Scene::None
            && input.target.is_none()
            && input.light.is_none()
            && input.tracks.is_none()
        {
            Seen::NotAsked
        } else {
            self.look(&input, cx)?
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
