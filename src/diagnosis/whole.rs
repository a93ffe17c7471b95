//! A whole diagnosis in one call ([`diagnose`]), and the stages between direct tests and confirmation:
//! evidence on a scene of the frames ([`on_frames`]), and the decision on it ([`decide_outcome`]).

use crate::candidates::CANDIDATES;
use crate::decide::{DecisionThresholds, decide};
use crate::diagnose::{ConfirmSetting, Diagnosis, amend_case, can_compare, check, confirm};
use crate::integrity::Integrity;
use crate::integrity::data::{FEWEST_FRAMES, is_enough};
use crate::limits::smaller_limits;
use crate::report::SceneEstimate;
use crate::residual::evidence::{EvidenceSetting, RankedEffect, SceneEvidence};
use crate::residual::free;
use crate::residual::ranking::evidence;
use crate::stages::{DecisionOutcome, EvidenceOutcome, SceneDecision};
use crate::unknowns::{UnknownParameter, nominal_with_estimates, unknowns, with_estimates};
use crate::unstated::without_scene;
use photocurrent_core::NodeError;
use photocurrent_scene::Scene;
use photocurrent_scene::case::Case;
use photocurrent_scene::mosaic::{PatchSetting, scene};
use photocurrent_scene::moving::MovingPicture;
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::picture::PictureSetting;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Source of the scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SceneSource {
    /// A moving picture, fitted to frames alone, and pictures of parts of the array for a few frames each
    /// where it does not predict them; where one picture leaves too much, it is estimated from frames and
    /// events together, and where these leave too much, the light of each pixel.
    #[default]
    Parts,
    /// One moving picture.
    Picture,
    /// One moving picture of frames and events together.
    Joint,
    /// The light of each pixel, free in time: of frames and events together.
    Pixels,
    /// No scene: events are not compared.
    None,
}

/// Settings of the scene's estimate and of the comparison with events.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct SceneSetting {
    /// Where the scene is from when no light is connected.
    pub scene: SceneSource,
    /// How a picture is fitted.
    #[serde(flatten)]
    pub picture: PictureSetting,
    /// How the array is cut into parts.
    #[serde(flatten)]
    pub parts: PatchSetting,
    /// How events are compared with the scene.
    #[serde(flatten)]
    pub evidence: EvidenceSetting,
    /// Largest relative flicker of light, 0 to 1, for which a scene is evidence: a picture does not flicker.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub most_flicker: f64,
}

impl Default for SceneSetting {
    fn default() -> SceneSetting {
        SceneSetting {
            scene: SceneSource::default(),
            picture: PictureSetting::default(),
            parts: PatchSetting::default(),
            evidence: EvidenceSetting::default(),
            most_flicker: 0.01,
        }
    }
}

/// Options of a diagnosis.
#[derive(Clone, Copy, Debug, Default)]
pub struct DiagnosisOptions {
    /// Scene and evidence.
    pub on_scene: SceneSetting,
    /// From evidence to probabilities.
    pub decision: DecisionThresholds,
    /// From probabilities to the verdict.
    pub confirm: ConfirmSetting,
}

/// Diagnoses a recording: verdict, findings, fitted description.
///
/// # Errors
/// When the description does not state what the model needs, or its effects are not understood.
pub fn diagnose(case: &Case, options: &DiagnosisOptions) -> Result<Diagnosis, NodeError> {
    let integrity = check(case)?;
    let seen = if options.on_scene.scene == SceneSource::None {
        EvidenceOutcome::NotAsked
    } else {
        match amend_or_refuse(case, &integrity)? {
            Ok(case) => on_frames(&case, &case.nominal()?, &integrity, &options.on_scene),
            Err(why) => EvidenceOutcome::Nothing(why),
        }
    };
    let nominal = Nominal::of(&amend_case(case, &integrity)?.sensor);
    confirm(case, &options.confirm, integrity, decide_outcome(seen, &nominal, &options.decision))
}

/// The recording for the comparison with a scene, with the direct tests' findings in its description; or the
/// reason why no scene can be estimated.
///
/// # Errors
/// When the description does not state what the model needs, or its effects are not understood.
pub fn amend_or_refuse(case: &Case, integrity: &Integrity) -> Result<Result<Case, String>, NodeError> {
    if !can_compare(case, integrity) {
        return Ok(Err("there is too little, or it is not sound enough, to estimate a scene".into()));
    }
    let filters = case.frames.as_ref().and_then(|frames| frames.filters).map(|filters| {
        format!(
            "the frames are behind a mosaic of filters ({filters}): neighbouring pixels measure other light"
        )
    });
    match without_scene(&case.sensor).or(filters) {
        Some(why) => Ok(Err(why)),
        None => Ok(part_without_failures(amend_case(case, integrity)?, integrity)),
    }
}

/// The longest run of consecutive frames, with its events, without a temporary failure
/// ([`Integrity::episodes`]). Temporarily hot pixels are excluded before. The reason where too few frames are
/// left.
fn part_without_failures(case: Case, integrity: &Integrity) -> Result<Case, String> {
    let failures = integrity.episodes.iter().filter(|episode| episode.pixels.is_empty());
    let failing: Vec<[i64; 2]> = failures.map(|episode| episode.time_ns).collect();
    let Some(frames) = case.frames.as_ref().filter(|_| !failing.is_empty()) else { return Ok(case) };
    let last_row = case.extent.height.saturating_sub(1);
    let is_sound = |frame: usize| {
        let exposure = |row: u32| frames.times.exposure(frame, row);
        let (from, to) = (exposure(0).start.0, exposure(last_row).end.0);
        failing.iter().all(|[begin, end]| to < *begin || from > *end)
    };
    let (mut best, mut from) = (0..0, 0);
    for frame in 0..=case.frame_count() {
        if frame == case.frame_count() || !is_sound(frame) {
            if frame - from > best.len() {
                best = from..frame;
            }
            from = frame + 1;
        }
    }
    let part = (best.len() >= FEWEST_FRAMES).then(|| case.frame_range(best)).filter(is_enough);
    part.ok_or_else(|| "what fails for a while leaves too few frames without it, one after the other".into())
}

/// Evidence of the events of a recording ([`amend_or_refuse`]) on a scene fitted to its frames, or on the
/// light of each pixel. Parameters that the description states as ranges are estimated first.
pub fn on_frames(
    case: &Case,
    nominal: &Nominal,
    integrity: &Integrity,
    setting: &SceneSetting,
) -> EvidenceOutcome {
    let unknowns = unknowns(&case.sensor);
    if unknowns.is_empty() {
        return on_described(case, nominal, integrity, setting);
    }
    let estimated = match estimated(case, nominal, integrity, setting, &unknowns) {
        Ok(estimated) => estimated,
        Err(why) => {
            return EvidenceOutcome::Nothing(format!(
                "what the description leaves open is not estimated: {why}"
            ));
        }
    };
    let case = Case { sensor: with_estimates(&case.sensor, &estimated), ..case.clone() };
    let nominal = match case.nominal() {
        Ok(nominal) => nominal,
        Err(error) => return EvidenceOutcome::Nothing(error.message),
    };
    match on_described(&case, &nominal, integrity, setting) {
        EvidenceOutcome::Evidence(found) => {
            EvidenceOutcome::Evidence(Box::new(SceneEvidence { estimated, ..*found }))
        }
        other => other,
    }
}

/// Estimates parameters that the description states as ranges, on one moving picture of frames and events, or
/// else on the light of each pixel.
fn estimated(
    case: &Case,
    nominal: &Nominal,
    integrity: &Integrity,
    setting: &SceneSetting,
    unknowns: &[UnknownParameter],
) -> Result<Vec<SceneEstimate>, String> {
    let on_pixels = |why: String| {
        let found = free::estimated_on_pixels(case, nominal, unknowns);
        found.map_err(|other| format!("{why}; {other}"))
    };
    if setting.scene == SceneSource::Pixels || flickers(integrity, setting).is_some() {
        return on_pixels(String::new());
    }
    let part = case.busiest_frames(setting.picture.most_values);
    let part = part.as_ref().unwrap_or(case);
    let on_picture = MovingPicture::fit(part, nominal, &setting.picture)
        .and_then(|picture| free::estimated_on_picture(part, nominal, &picture, unknowns));
    on_picture.or_else(on_pixels)
}

/// The same for a description without ranges.
fn on_described(
    case: &Case,
    nominal: &Nominal,
    integrity: &Integrity,
    setting: &SceneSetting,
) -> EvidenceOutcome {
    match setting.scene {
        SceneSource::Pixels => return evidence_outcome(free::on_pixels(case, nominal)),
        SceneSource::Joint => {
            return evidence_outcome(evidence_on_part(case, integrity, setting, |part| {
                on_joint(part, nominal, setting)
            }));
        }
        _ => {}
    }
    let found = match evidence_on_part(case, integrity, setting, |part| on_picture(part, nominal, setting)) {
        Ok(found) if setting.scene == SceneSource::Picture || decides_alone(&found) => Ok(found),
        Err(why) if setting.scene == SceneSource::Picture => Err(why),
        Ok(found) if found.on_joint.is_some() => Ok(found),
        Ok(found) => {
            let on_pixels = free::on_pixels(case, nominal).ok().map(Box::new);
            Ok(SceneEvidence { on_pixels, ..found })
        }
        Err(why) => free::on_pixels(case, nominal).map_err(|other| format!("{why}; {other}")),
    };
    evidence_outcome(found)
}

/// A picture that leaves less than this share of a threshold decides alone: as it does of textures whose
/// frames have no noise. Not calibrated.
const LEAVES_LITTLE: f64 = 0.03;

/// Is the misfit of a scene small enough to decide without another one?
fn decides_alone(found: &SceneEvidence) -> bool {
    f64::max(found.control_median, found.left[0]) < LEAVES_LITTLE
}

/// A picture of frames alone reports no effect with a smaller gain, nats per event, by the built-in
/// thresholds.
const CLAIMS_NOTHING: f64 = 0.1;

/// Is a picture of frames alone sufficient? An effect that it reports must be confirmed by a picture of
/// frames and events: a second effect that compensates errors of the first picture does not appear on the
/// other.
fn needs_no_joint_picture(found: &SceneEvidence) -> bool {
    let claims = |one: &RankedEffect| one.gain_beyond_control() > CLAIMS_NOTHING;
    decides_alone(found) && !found.first.as_ref().is_some_and(claims)
}

/// Evidence on the part of a recording that a picture is fitted to; an error where the light flickers, as a
/// picture does not.
fn evidence_on_part(
    case: &Case,
    integrity: &Integrity,
    setting: &SceneSetting,
    on: impl Fn(&Case) -> Result<SceneEvidence, String>,
) -> Result<SceneEvidence, String> {
    if let Some(why) = flickers(integrity, setting) {
        return Err(why);
    }
    let part = case.busiest_frames(setting.picture.most_values);
    let (case, span_ns) = part.as_ref().map_or((case, None), |part| (part, Some(part.span)));
    let mut found = on(case)?;
    found.span_ns = span_ns;
    found.on_joint.iter_mut().for_each(|joint| joint.span_ns = span_ns);
    Ok(found)
}

/// How the light flickers, where it does.
fn flickers(integrity: &Integrity, setting: &SceneSetting) -> Option<String> {
    // What flickers for a while is cut out ([`part_without_failures`]).
    let mut always = integrity.scene.iter().filter(|one| one.time_ns.is_none());
    let flicker = always.find(|one| one.depth > setting.most_flicker)?;
    Some(format!("the light flickers at {:.0} Hz by {:.0} %", flicker.frequency_hz, 100.0 * flicker.depth))
}

/// Evidence on one moving picture of frames and events together.
fn on_joint(case: &Case, nominal: &Nominal, setting: &SceneSetting) -> Result<SceneEvidence, String> {
    let picture = MovingPicture::fit(case, nominal, &setting.picture)?;
    free::on_picture(case, nominal, &picture)
}

/// The same on a scene that is fitted to the frames alone.
fn on_picture(case: &Case, nominal: &Nominal, setting: &SceneSetting) -> Result<SceneEvidence, String> {
    let fitted = match setting.scene {
        SceneSource::Parts => scene(case, nominal, &setting.picture, &setting.parts),
        _ => MovingPicture::fit(case, nominal, &setting.picture)
            .map(|picture| Box::new(picture) as Box<dyn Scene>),
    };
    let scene = fitted?;
    let found = evidence(case, nominal, &*scene, &setting.evidence)?;
    let picture = scene.as_any().and_then(|any| any.downcast_ref::<MovingPicture>());
    let on_joint = match picture {
        Some(picture) if picture.is_one && !needs_no_joint_picture(&found) => {
            free::on_picture(case, nominal, picture).ok().map(Box::new)
        }
        _ => None,
    };
    Ok(SceneEvidence { on_joint, ..found })
}

/// Evidence, or why there is none.
pub fn evidence_outcome(found: Result<SceneEvidence, String>) -> EvidenceOutcome {
    found.map_or_else(EvidenceOutcome::Nothing, |found| EvidenceOutcome::Evidence(Box::new(found)))
}

/// Decides on the evidence. `nominal`: the sensor with which events were compared.
pub fn decide_outcome(
    seen: EvidenceOutcome,
    nominal: &Nominal,
    decision: &DecisionThresholds,
) -> DecisionOutcome {
    match seen {
        EvidenceOutcome::NotAsked => DecisionOutcome::NotAsked,
        EvidenceOutcome::Nothing(why) => DecisionOutcome::Nothing(why),
        EvidenceOutcome::Evidence(found) => {
            let nominal = nominal_with_estimates(nominal, &found.estimated);
            match decide_on_all_scenes(&found, &nominal, decision) {
                Ok(decided) => DecisionOutcome::Decided(Box::new(SceneDecision {
                    estimated: found.estimated.clone(),
                    ..decided
                })),
                Err(why) => DecisionOutcome::Nothing(why),
            }
        }
    }
}

/// Is the decision uncatalogued or random? A picture of frames and events does not test the first, and tests
/// the other on fewer pixels.
fn is_beyond_joint_picture(alone: &SceneDecision) -> bool {
    let is_random = alone.proposals.first().is_some_and(|one| CANDIDATES[one.candidate].is_random);
    alone.detected && (is_random || alone.unexplained.is_some())
}

/// Joins the decisions on all scenes.
fn decide_on_all_scenes(
    found: &SceneEvidence,
    nominal: &Nominal,
    decision: &DecisionThresholds,
) -> Result<SceneDecision, String> {
    let on =
        |other: &Option<Box<SceneEvidence>>| other.as_ref().map(|found| decide(found, nominal, decision));
    let alone = decide(found, nominal, decision);
    // The picture that explains the events better decides, with the best effect of each applied.
    let explains = |joint: &SceneEvidence| alone.is_err() || joint.left[0] < found.left[0];
    if found.on_joint.as_deref().is_some_and(explains)
        && let Some(Ok(joint)) = on(&found.on_joint)
    {
        let (left, share) = found.on_joint.as_ref().map_or((0.0, 0.0), |joint| (joint.left[0], joint.share));
        let other_scene =
            format!("it leaves {left:.3} of a threshold, the picture of frames alone {:.3}", found.left[0]);
        let alone = alone.ok().filter(is_beyond_joint_picture).filter(|_| !joint.detected).map(|alone| {
            SceneDecision {
                other_scene: format!(
                    "the picture of frames and events shows nothing on {:.0} % of them",
                    100.0 * share
                ),
                ..alone
            }
        });
        return Ok(alone.unwrap_or(SceneDecision { other_scene, ..joint }));
    }
    match (alone, on(&found.on_pixels)) {
        // What the picture does not show, the light of pixels may.
        (Ok(alone), Some(Ok(on_pixels))) if !alone.detected && on_pixels.detected => {
            Ok(SceneDecision { other_scene: "the picture shows nothing".into(), ..on_pixels })
        }
        // And where neither shows anything, either would have.
        (Ok(alone), Some(Ok(on_pixels))) if !alone.detected => {
            let detectability = smaller_limits(&alone.detectability, &on_pixels.detectability);
            let other_scene = "nor does the light of each pixel show anything".into();
            Ok(SceneDecision { detectability, other_scene, ..alone })
        }
        (Err(why), Some(Ok(on_pixels))) => {
            Ok(SceneDecision { other_scene: format!("on the picture {why}"), ..on_pixels })
        }
        (Err(why), Some(Err(other))) => Err(format!("{why}; {other}")),
        (alone, _) => alone,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::UNNAMED;
    use crate::integrity::episodes::{Episode, Failure};
    use crate::report::{Finding, Verdict};
    use crate::testing;
    use crate::verdict::verdict;

    fn episode(failure: Failure, time_ns: [i64; 2], pixels: Vec<u32>) -> Episode {
        let seen = "seen".to_owned();
        Episode { failure, time_ns, rows: [2, 5], columns: [1, 3], pixels, statistic: 2.0, seen }
    }

    #[test]
    fn a_scene_is_estimated_from_the_longest_stretch_of_frames_without_a_failure() {
        let case = testing::case();
        let frames = case.frames.as_ref().unwrap();
        let count = case.frame_count();
        let start = |frame: usize| frames.times.exposure(frame, 0).start.0;
        let of = |episodes: Vec<Episode>| {
            part_without_failures(case.clone(), &Integrity { episodes, ..Integrity::default() })
        };
        // During the second frame.
        let stall = episode(Failure::Stall, [start(1), start(1) + 1000], Vec::new());
        let part = of(vec![stall]).unwrap();
        assert_eq!((part.frame_count(), part.span.0), (count - 2, start(2)));
        assert!(part.events.iter().all(|event| event.t_in_ns >= start(2)));
        // Pixels that are hot are left out, and no time.
        let hot = episode(Failure::Hot, [start(1), start(1) + 1000], vec![7]);
        assert_eq!(of(vec![hot]).unwrap().frame_count(), count);
        let always = episode(Failure::Lost, [case.span.0, case.span.1], Vec::new());
        assert!(of(vec![always]).unwrap_err().contains("too few frames"));
    }

    #[test]
    fn a_failure_is_a_finding_with_its_place_and_time_and_no_effect_where_there_is_none() {
        let case = testing::case();
        let stuck = episode(Failure::Sign, [10_000, 20_000], Vec::new());
        let lost = episode(Failure::Lost, [10_000, 20_000], Vec::new());
        let of = |episodes: Vec<Episode>| {
            let integrity = Integrity { episodes, ..Integrity::default() };
            verdict(&case, &case.nominal().unwrap(), &integrity, None)
        };
        let answer = of(vec![stuck.clone()]);
        assert_eq!((answer.verdict, &answer.findings[0].id[..]), (Verdict::Unnamed, UNNAMED));
        let Finding { location, equation, .. } = &answer.findings[0];
        assert_eq!((location.rows, location.columns, location.time_ns), ([2, 5], [1, 3], [10_000, 20_000]));
        assert_eq!((location.pixels, &location.covariate[..]), (12, "time"));
        assert_eq!(equation, "from 0.0 ms to 0.0 ms: seen");
        let answer = of(vec![stuck, lost]);
        let ids: Vec<&str> = answer.findings.iter().map(|finding| &finding.id[..]).collect();
        assert_eq!((answer.verdict, ids), (Verdict::Named, vec![UNNAMED, "event_loss"]));
    }

    /// A scene on which a clock offset gains so much, nats an event, and has this information.
    fn on_scene(scene: &str, left: f64, gain: f64, information: f64) -> SceneEvidence {
        let candidate = CANDIDATES.iter().position(|one| one.id == "clock_offset").unwrap();
        let clock = RankedEffect {
            candidate,
            gain,
            information,
            unit: 5e-4,
            effect_size: 1.0,
            value: 5e-4,
            is_exact: true,
            is_material: true,
            ..RankedEffect::default()
        };
        let left = [left; 2];
        SceneEvidence {
            scene: scene.into(),
            share: 0.5,
            left,
            ranked: vec![clock],
            ..SceneEvidence::default()
        }
    }

    #[test]
    fn of_two_scenes_one_decides_and_what_the_other_leaves_or_shows_is_stated() {
        let nominal = testing::case().nominal().unwrap();
        let of = |found: &SceneEvidence| {
            decide_on_all_scenes(found, &nominal, &DecisionThresholds::default()).unwrap()
        };
        let with_joint = |joint: SceneEvidence, picture: SceneEvidence| {
            let decided = of(&SceneEvidence { on_joint: Some(Box::new(joint)), ..picture });
            (decided.name, decided.other_scene)
        };
        // The picture that leaves less.
        let (name, other) =
            with_joint(on_scene("joint", 0.01, 0.0, 1.0), on_scene("picture", 0.05, 1.0, 1.0));
        assert_eq!(
            (&name[..], &other[..]),
            ("joint", "it leaves 0.010 of a threshold, the picture of frames alone 0.050")
        );
        let alone = with_joint(on_scene("joint", 0.08, 0.0, 1.0), on_scene("picture", 0.05, 1.0, 1.0));
        assert_eq!(alone, ("picture".to_owned(), String::new()));
        let with_pixels = |pixels: SceneEvidence, picture: SceneEvidence| {
            of(&SceneEvidence { on_pixels: Some(Box::new(pixels)), ..picture })
        };
        let shown = with_pixels(on_scene("pixels", 0.05, 1.0, 1.0), on_scene("picture", 0.05, 0.0, 1.0));
        assert_eq!((&shown.name[..], &shown.other_scene[..]), ("pixels", "the picture shows nothing"));
        // Where neither shows anything, the smaller limit counts.
        let limit = |decided: &SceneDecision| decided.detectability[0].minimal_detectable;
        let neither = with_pixels(on_scene("pixels", 0.05, 0.0, 1e6), on_scene("picture", 0.05, 0.0, 1.0));
        let pixels = of(&on_scene("pixels", 0.05, 0.0, 1e6));
        let picture = of(&on_scene("picture", 0.05, 0.0, 1.0));
        assert_eq!((&neither.name[..], limit(&neither)), ("picture", limit(&pixels)));
        assert!(limit(&pixels) < limit(&picture));
        let failed = with_pixels(on_scene("pixels", 0.05, 0.0, 1.0), on_scene("picture", 0.4, 0.0, 1.0));
        assert!(failed.other_scene.contains("no effect explains it"), "{}", failed.other_scene);
    }
}
