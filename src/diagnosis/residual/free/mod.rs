//! Which effects explain a recording on a scene of frames and events together
//! ([`photocurrent_scene::free`]): every effect is scored against what the scene would take over.
//!
//! The scene is one moving picture, which may pass before a still ground ([`on_picture`]), or the light of
//! each pixel, free in time ([`on_pixels`]), where nothing moves as one.
//!
//! 1. What is evaluated (`choose`). Of a picture: pixels by chance, some whose events take part in the fit
//!    and some whose events are held out. Of pixels: blocks with many events, spread over the array, and the
//!    busiest 0.15 s.
//! 2. The scene, its prior and the noise with the description as it is (`fit`).
//! 3. Score and information of every effect: a first size for each, and its gain when the scene follows
//!    by one step (`score`).
//! 4. The best are fitted exactly: scene and size in turn, and the description for as many rounds. The gain
//!    is that of the density in time of each event that is held out, or, on the light of pixels, when that is
//!    estimated from everything else, and of the probability that none fired between events.
//! 5. Random effects are parts of what held-out events miss (`random`); where thresholds differ from pixel to
//!    pixel, each pixel's own are estimated with the scene (`own`).
//! 6. With the best one applied, score and information of all others with its own size free.

mod binned;
mod choose;
mod curve;
mod exact;
mod fit;
mod own;
mod places;
mod products;
mod random;
mod score;
mod unknowns;

use super::chance::noise_gain;
use super::evidence::{KINDS, RankedEffect, SceneEvidence};
use super::fit::probability_t;
use super::setting::ERRORS;
use super::table::is_physics;
use crate::candidates::{CANDIDATES, EffectScales, Trial};
use crate::report::SceneEstimate;
use crate::unknowns::UnknownParameter;
use exact::ExactFit;
use fit::{BY_CHANCE, FitData, STEP_NS, SceneFit};
use photocurrent_scene::block::Block;
use photocurrent_scene::case::Case;
use photocurrent_scene::free::{FreeScene, SceneNoise, frame_noise};
use photocurrent_scene::joint::{ArrayPart, JointPicture};
use photocurrent_scene::moving::MovingPicture;
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::pixels::PixelLight;
use photocurrent_scene::statistics::MEDIAN_T;
use photocurrent_scene::{Scene, gate};
use places::{BaseFit, UnexplainedCurves};
use random::is_mismatch;
use rayon::prelude::*;
use score::EffectScores;
use std::fmt;

/// How much work is done on a scene.
#[derive(Clone, Copy, Debug)]
struct WorkPlan {
    /// Rounds with the description as it is, before effects are scored.
    rounds: usize,
    /// Corrections of a size.
    corrections: usize,
    /// The same of a second effect.
    corrections_of_second: usize,
    /// Numbers of effects that are fitted exactly: by their gain, and by the agreement of places.
    by_gain: usize,
    by_agreement: usize,
    /// Number of second effects that are fitted exactly.
    second: usize,
    /// Least first-order gain of an effect that is fitted, nats per event; and as a share of the best gain.
    least_gain: f64,
    worth: f64,
    /// Does the scene become more probable where a front end that is faster need not sharpen it?
    is_sharpened: bool,
    /// The scene is rejected where, with the best effect, the median misfit of the events exceeds this share
    /// of their thresholds.
    most_left: f64,
    /// Is noise of single events counted off? On a coarse grid part of that is the scene's.
    is_noise_counted_off: bool,
}

/// On the light of pixels.
const ON_PIXELS: WorkPlan = WorkPlan {
    rounds: 11,
    corrections: 3,
    corrections_of_second: 2,
    by_gain: 6,
    by_agreement: 3,
    second: 2,
    least_gain: 0.0,
    worth: 0.0,
    is_sharpened: true,
    most_left: f64::INFINITY,
    is_noise_counted_off: false,
};
/// Steps of that light between corrections of a size, and a knot every so many instants.
const STEPS_ON_PIXELS: usize = 3;
const PER_KNOT: usize = 5;
/// On a moving picture.
const ON_PICTURE: WorkPlan = WorkPlan {
    rounds: 9,
    corrections: 3,
    corrections_of_second: 2,
    by_gain: 5,
    by_agreement: 2,
    second: 2,
    least_gain: 0.002,
    worth: 0.25,
    is_sharpened: false,
    most_left: EXPLAINED,
    is_noise_counted_off: false,
};
const STEPS_ON_PICTURE: usize = 2;
/// On a finer grid, on which picture and size take longer to follow a shift in time.
const ON_FINER: WorkPlan =
    WorkPlan { corrections: 6, is_sharpened: true, is_noise_counted_off: true, ..ON_PICTURE };
/// Where edges are too sharp for the grid of the whole array, a part of it is tried on a finer one, pixels.
const FINER: [f64; 2] = [0.4, 0.27];
/// A grid is fine enough where the coarser one left at most this ratio of its misfit: the rest is noise. Not
/// calibrated, like [`HOPEFUL`].
const FALLS: f64 = 1.25;
/// Where the best first-order gain is below this share of [`WorkPlan::most_left`], no effect explains the
/// misfit: an explanation gains the log of the misfit's ratio.
const HOPEFUL: f64 = 0.3;
/// Gain from which a curve may explain it, nats per event: few nominal recordings reach it
/// (`photocurrent-calibrate --scene joint`). A trial costs time alone.
const OF_CURVE: f64 = 0.04;
/// Least share of a curve's gain before the scene follows it; below this share of the best effect's gain it
/// cannot exceed that.
const OF_BEST: f64 = 0.25;
/// Number of a moving picture's events that are fitted, more where the description states threshold noise;
/// and that are held out.
const TRAINED: usize = 24_000;
const TRAINED_ON_NOISE: usize = 72_000;
const MEASURED: usize = 8_000;
/// Noise of thresholds below this share of them is none: a scene always leaves so much.
const LEAST_NOISE: f64 = 0.01;
/// A scene that misses thresholds by no more than this share of the noise that the description states: with
/// it the noise is an eighth wider.
const HIDDEN: f64 = 0.5;
/// Thresholds that differ from pixel to pixel are estimated where to predict each event from the others of
/// its pixel gains more than this, nats an event.
const LEAST_MISMATCH: f64 = 0.01;
/// Fewer events than this are no evidence.
const FEWEST_EVENTS: usize = 300;
/// An event is explained when it misses its threshold by no more than this share of it.
const EXPLAINED: f64 = 0.02;
/// A smaller scale than this share of a threshold is not distinguished.
const LEAST_SHARE: f64 = 1e-3;

/// Evidence on the light of pixels.
///
/// # Errors
/// When there are no frames or too few events, or stated effects cannot be combined.
pub fn on_pixels(case: &Case, nominal: &Nominal) -> Result<SceneEvidence, String> {
    with_pixels(case, nominal, |ground, span_ns| {
        let found = evidence_on(ground, &ON_PIXELS).map_err(|why| why.to_string())?;
        Ok(SceneEvidence { scene: KINDS[3].to_owned(), span_ns, ..found })
    })
}

/// Numbers that the description leaves open, estimated on the light of pixels.
///
/// # Errors
/// As [`on_pixels`].
pub fn estimated_on_pixels(
    case: &Case,
    nominal: &Nominal,
    unknowns: &[UnknownParameter],
) -> Result<Vec<SceneEstimate>, String> {
    with_pixels(case, nominal, |ground, _| unknowns::estimate(ground, unknowns))
}

/// Evidence on the light of pixels, and the evaluated time of the recording; `None` where that is all of it.
fn with_pixels<T>(
    case: &Case,
    nominal: &Nominal,
    find: impl FnOnce(&FitData<'_, PixelLight>, Option<(i64, i64)>) -> Result<T, String>,
) -> Result<T, String> {
    if case.frame_count() == 0 {
        return Err("there are no frames".to_owned());
    }
    let part = choose::window(case);
    let (case, span_ns) = part.as_ref().map_or((case, None), |part| (part, Some(part.span)));
    let scales = EffectScales::from_case(case, nominal);
    let noise = SceneNoise::new(frame_noise(case, nominal));
    let begin = PixelLight::new(case, nominal, choose::blocks(case), (STEP_NS, PER_KNOT), noise);
    let ground = FitData::new(case, nominal, &scales, begin, |_, _| true, (STEPS_ON_PIXELS, true))?;
    find(&ground, span_ns)
}

/// Evidence on one moving picture, which follows frames and events from where frames alone have it: on the
/// whole array, or on a part of it on a finer grid where that leaves too much, until a finer one leaves no
/// less.
///
/// # Errors
/// When there are too few events, stated effects cannot be combined, or half of the events remain unexplained
/// with the best effect.
pub fn on_picture(case: &Case, nominal: &Nominal, scene: &MovingPicture) -> Result<SceneEvidence, String> {
    let counted = CountedEvents::on_picture(case, scene);
    let first = ArrayPart::first(case, scene, &counted.kept).map(|part| (ON_PICTURE, part));
    let finer = |pitch: f64| Some((ON_FINER, ArrayPart::of_most_weight(case, scene, pitch, &counted.kept)?));
    let mut best = Err(NoEvidence::Other(NO_PART.into()));
    let mut before = f64::INFINITY;
    for (plan, part) in first.into_iter().chain(FINER.into_iter().filter_map(finer)) {
        let is_whole = part.block == Block::whole_array(case.extent);
        let found =
            with_picture(case, nominal, (scene, &part), &counted, |ground| evidence_on(ground, &plan));
        let left = match &found {
            Ok(found) => found.left[0],
            Err(NoEvidence::Leaves(left)) => *left,
            Err(NoEvidence::Other(_)) => f64::INFINITY,
        };
        if found.is_ok() || best.is_err() {
            best = found.map(|found| SceneEvidence {
                scene: KINDS[4].to_owned(),
                part: (!is_whole).then_some(part.block),
                ..found
            });
        }
        if left <= EXPLAINED || before < FALLS * left {
            break;
        }
        before = left;
    }
    best.map_err(|why| why.to_string())
}

/// Numbers that the description leaves open, estimated on one moving picture.
///
/// # Errors
/// As [`on_picture`].
pub fn estimated_on_picture(
    case: &Case,
    nominal: &Nominal,
    scene: &MovingPicture,
    unknowns: &[UnknownParameter],
) -> Result<Vec<SceneEstimate>, String> {
    let counted = CountedEvents::on_picture(case, scene);
    let part = ArrayPart::first(case, scene, &counted.kept).ok_or(NO_PART)?;
    let estimate = |ground: &FitData<'_, JointPicture>| Ok(unknowns::estimate(ground, unknowns)?);
    with_picture(case, nominal, (scene, &part), &counted, estimate).map_err(|why| why.to_string())
}

/// Why there is no moving picture of frames and events.
const NO_PART: &str = "so much of the picture passes that no part of the array can be fitted";

/// Events that are evaluated on a moving picture, and their number per pixel.
struct CountedEvents {
    gate: gate::PredictionGate,
    kept: Vec<usize>,
}

impl CountedEvents {
    fn on_picture(case: &Case, scene: &MovingPicture) -> CountedEvents {
        let gate = (scene as &dyn Scene).gate(case, gate::LEAST_DN, gate::SPREAD);
        let kept = choose::gated_events(case, &gate);
        CountedEvents { gate, kept }
    }
}

/// Evidence on a moving picture of a part of the array.
fn with_picture<T>(
    case: &Case,
    nominal: &Nominal,
    (scene, part): (&MovingPicture, &ArrayPart),
    CountedEvents { gate, kept }: &CountedEvents,
    find: impl FnOnce(&FitData<'_, JointPicture>) -> Result<T, NoEvidence>,
) -> Result<T, NoEvidence> {
    let scales = EffectScales::from_case(case, nominal);
    let is_noisy = nominal.threshold_noise > LEAST_NOISE * scales.threshold;
    let trained = if is_noisy { TRAINED_ON_NOISE } else { TRAINED };
    let (is_trained, is_measured) = choose::choose_pixels(case, &part.block, kept, (trained, MEASURED));
    let noise = SceneNoise::new(frame_noise(case, nominal));
    let begin = JointPicture::new(case, nominal, (scene, part), &is_trained, STEP_NS, noise)?;
    let keeps =
        |pixel: usize, t_ns: i64| (is_trained[pixel] || is_measured[pixel]) && gate.accepts(pixel, t_ns);
    let ground = FitData::new(case, nominal, &scales, begin, keeps, (STEPS_ON_PICTURE, false))?;
    find(&ground)
}

/// Reason why a scene gives no evidence.
#[derive(Debug)]
enum NoEvidence {
    /// Half of the events miss their thresholds by so much of them before anything is fitted, which grids are
    /// compared by, and no effect explains it.
    Leaves(f64),
    Other(String),
}

impl From<String> for NoEvidence {
    fn from(why: String) -> NoEvidence {
        NoEvidence::Other(why)
    }
}

impl fmt::Display for NoEvidence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            NoEvidence::Leaves(left) => write!(
                f,
                "events miss their thresholds by {left:.3} of them on a picture of frames and events, and it \
                 decides where that is at most {EXPLAINED}"
            ),
            NoEvidence::Other(why) => f.write_str(why),
        }
    }
}

/// Evidence on a scene that is estimated from events.
fn evidence_on<L: FreeScene>(ground: &FitData<'_, L>, plan: &WorkPlan) -> Result<SceneEvidence, NoEvidence> {
    let (case, events) = (ground.case, ground.events());
    if events < FEWEST_EVENTS {
        return Err(NoEvidence::Other(format!(
            "{events} events follow another one in the pixels whose light is estimated; {FEWEST_EVENTS} are \
             needed"
        )));
    }
    let mut base = SceneFit::new(ground, &Trial::nominal(ground.nominal));
    base.rounds(plan.rounds)?;
    let all: Vec<usize> = (0..CANDIDATES.len()).filter(|n| !CANDIDATES[*n].is_random).collect();
    let scored = base.score_effects(&all, None)?;
    let mut list = ranked(&scored, ground);
    let mut random = base.random()?;
    let mut noise = [noise_gain(&random), 0.0];
    let most = list.iter().chain(&random).map(RankedEffect::gain_beyond_control).fold(0.0, f64::max);
    let unfitted = base.median_event_misfit()?;
    if !is_hopeful(&mut base, most, plan)? {
        return Err(NoEvidence::Leaves(unfitted));
    }
    let mut nothing = base.clone();
    // Exact fits have factors of their own.
    base.light.release();
    nothing.settled(plan.corrections)?;
    let level = BaseFit::from_fit(&mut nothing)?;
    let mut open = level.binned(&mut nothing)?;
    nothing.release();
    let of_size = |candidate: usize| Some((candidate, scored.best_size(candidate)?));
    let mut to_fit: Vec<_> = worth_fitting(&list, &scored, plan).into_iter().filter_map(of_size).collect();
    to_fit.extend(mismatch(&random, ground));
    let fitted = |(candidate, size): (usize, f64)| match is_mismatch(candidate) {
        true => base.with_own(candidate, size, plan.corrections).ok(),
        false => base.exact(candidate, size, plan.corrections).ok(),
    };
    let exact: Vec<ExactFit<'_, L>> = to_fit.into_par_iter().filter_map(fitted).collect();
    replace(&exact, &mut list, &level, ground, plan);
    replace(&exact, &mut random, &level, ground, plan);
    let first = first(&list, &random, noise[0]).cloned();
    let with = first.as_ref().and_then(|one| exact.iter().find(|fit| fit.candidate == one.candidate));
    let (second, open_second, random_second) = match (&first, with) {
        (Some(first), Some(with)) => {
            let (second, open) = second(with, ground, plan)?;
            (second, open, other_effects(&with.fit.random()?, first))
        }
        // Noise, and events too many or too few, change nothing of the others.
        (Some(first), None) => (other_effects(&list, first), open.clone(), other_effects(&random, first)),
        (None, _) => (Vec::new(), UnexplainedCurves::empty(), Vec::new()),
    };
    let gain = first.as_ref().map_or(0.0, RankedEffect::gain_beyond_control);
    follow_curve(&mut open, (&nothing, &level), gain, plan)?;
    noise[1] = noise_gain(&random_second);
    let median = nothing.median_event_misfit()?;
    let left = with.map_or(Ok(median), |with| with.fit.median_event_misfit())?;
    let wrong = self::scene_misfit(with.map_or(&nothing, |with| &with.fit), plan)?;
    // What is in no catalogue is no fault of the scene.
    let wrong = wrong.min(open.left).min(open_second.left);
    if wrong > most_left(ground, plan) {
        return Err(NoEvidence::Leaves(unfitted));
    }
    Ok(SceneEvidence {
        nats_per_event: level.left_out.iter().sum::<f64>() / events as f64,
        share: events as f64 / case.events.len() as f64,
        explained: explained(wrong / MEDIAN_T),
        events,
        median,
        left: [left; 2],
        slope_per_s: ground.slope_per_s(&nothing)?,
        white: 1.0,
        misfit: 1.0,
        ranked: list,
        first,
        second,
        noise,
        random,
        random_second,
        open: open.list,
        open_second: open_second.list,
        ..SceneEvidence::default()
    })
}

/// Largest misfit of a scene that decides: smaller where stated event noise would hide it.
fn most_left<L: FreeScene>(ground: &FitData<'_, L>, plan: &WorkPlan) -> f64 {
    f64::max(plan.most_left, HIDDEN * ground.stated_noise())
}

/// Can an effect explain the misfit of a scene, where the best first-order gain is `most`?
fn is_hopeful<L: FreeScene>(base: &mut SceneFit<'_, L>, most: f64, plan: &WorkPlan) -> Result<bool, String> {
    let (wrong, ground) = (scene_misfit(base, plan)?, base.ground);
    let most_left = most_left(ground, plan);
    if wrong <= most_left || most >= HOPEFUL * libm::log(wrong / most_left) {
        return Ok(true);
    }
    Ok(BaseFit::from_fit(base)?.dependences(ground).gain() > OF_CURVE)
}

/// Estimates the best curve with the scene where it may gain more than the best effect does (`most`).
fn follow_curve<L: FreeScene>(
    open: &mut UnexplainedCurves,
    (nothing, level): (&SceneFit<'_, L>, &BaseFit),
    most: f64,
    plan: &WorkPlan,
) -> Result<(), String> {
    if let Some(best) = open.list.first_mut()
        && best.gain_beyond_control() > f64::max(OF_CURVE, OF_BEST * most)
        && let Some((curve, with)) = curve::with_scene(nothing, (best, level), nothing.ground)?
    {
        best.gain = best.gain.max(curve.nats_per_event);
        best.dependence = curve;
        open.left = scene_misfit(&with, plan)?;
    }
    Ok(())
}

/// Thresholds that differ from pixel to pixel, where that gains anything, and about by how much.
fn mismatch<L: FreeScene>(random: &[RankedEffect], ground: &FitData<'_, L>) -> Option<(usize, f64)> {
    let found =
        random.iter().find(|one| is_mismatch(one.candidate) && one.gain_beyond_control() > LEAST_MISMATCH)?;
    let size = CANDIDATES[found.candidate].effect_size(found.value, ground.scales, ground.nominal);
    Some((found.candidate, size))
}

/// The best effect, where wider noise of events alone gains `noise`.
fn first<'a>(ranked: &'a [RankedEffect], random: &'a [RankedEffect], noise: f64) -> Option<&'a RankedEffect> {
    let found = ranked.iter().chain(random).filter(|one| one.is_exact && one.gain_beyond_control() > 0.0);
    found.max_by(|a, b| {
        a.gain_beyond_noise(noise).total_cmp(&b.gain_beyond_noise(noise)).then(RankedEffect::by_gain(b, a))
    })
}

/// Effects of a list other than `first`.
fn other_effects(list: &[RankedEffect], first: &RankedEffect) -> Vec<RankedEffect> {
    let id = |one: &RankedEffect| CANDIDATES[one.candidate].id;
    list.iter().filter(|one| id(one) != id(first)).cloned().collect()
}

/// Median misfit of events that is due to the scene, as a share of their thresholds. Stated event noise is
/// not included; where it is stated, only the part that events of one place have in common is. With
/// thresholds per pixel, their estimation error is not included either.
fn scene_misfit<L: FreeScene>(fit: &SceneFit<'_, L>, plan: &WorkPlan) -> Result<f64, String> {
    let beyond_stated = fit.ground.beyond_stated(fit.median_event_misfit()?);
    let is_noise_stated = fit.ground.stated_noise() > LEAST_NOISE;
    match plan.is_noise_counted_off || is_noise_stated || fit.own.is_some() {
        true => Ok(f64::min(fit.scene_misfit()?, beyond_stated)),
        false => Ok(beyond_stated),
    }
}

/// Share of explained events for Student-t misfits with three degrees of freedom and a scale of `share` of
/// the threshold.
fn explained(share: f64) -> f64 {
    2.0 * probability_t(EXPLAINED / share.max(LEAST_SHARE)) - 1.0
}

/// Is a front end described as slower than with this effect? Light that it need not sharpen is smoother, and
/// so more probable: where edges pass fast, recordings without a fault gain up to 0.4 nats an event by it,
/// and one turning star gained 0.22 on a grid of 0.4 pixels.
fn is_faster(one: &RankedEffect) -> bool {
    match CANDIDATES[one.candidate].id {
        "time_constant" => one.effect_size < 0.0,
        id => id == "large_signal_front_end",
    }
}

/// Exact fits in the places of first sizes and gains, best first.
fn replace<L: FreeScene>(
    exact: &[ExactFit<'_, L>],
    list: &mut [RankedEffect],
    level: &BaseFit,
    ground: &FitData<'_, L>,
    plan: &WorkPlan,
) {
    for found in exact {
        list.iter_mut()
            .filter(|one| one.candidate == found.candidate)
            .for_each(|one| found.replace(one, level, ground));
    }
    for one in list.iter_mut() {
        one.is_material = CANDIDATES[one.candidate].is_material(ground.case, ground.nominal, one.value);
        let is_absorbed = plan.is_sharpened && is_faster(one);
        one.control_gain = if is_absorbed { f64::max(one.gain, 0.0) } else { BY_CHANCE * one.gain_error };
    }
    list.sort_by(RankedEffect::by_gain);
}

/// All other effects and uncatalogued curves, with one effect applied.
fn second<L: FreeScene>(
    with: &ExactFit<'_, L>,
    ground: &FitData<'_, L>,
    plan: &WorkPlan,
) -> Result<(Vec<RankedEffect>, UnexplainedCurves), String> {
    let others: Vec<usize> = (0..CANDIDATES.len())
        .filter(|n| !CANDIDATES[*n].is_random && CANDIDATES[*n].id != CANDIDATES[with.candidate].id)
        .collect();
    let mut scene = with.fit.clone();
    let free = (!CANDIDATES[with.candidate].is_random).then_some(with.candidate);
    let scored = scene.score_effects(&others, free)?;
    let mut list = ranked(&scored, ground);
    let mut alone = scene.clone();
    alone.settled(plan.corrections_of_second)?;
    let level = BaseFit::from_fit(&mut alone)?;
    let open = level.binned(&mut alone)?;
    let mut exact = Vec::new();
    for one in list.iter().filter(|one| one.gain > plan.least_gain).take(plan.second) {
        exact.extend(scene.exact(one.candidate, one.effect_size, plan.corrections_of_second).ok());
    }
    replace(&exact, &mut list, &level, ground, plan);
    list.iter_mut()
        .filter(|one| one.is_exact && free.is_some())
        .for_each(|one| one.of_first = Some(with.effect_size));
    Ok((list, open))
}

/// First sizes and gains, best first.
fn ranked<L: FreeScene>(scored: &EffectScores, ground: &FitData<'_, L>) -> Vec<RankedEffect> {
    let (scales, nominal, events) = (ground.scales, ground.nominal, ground.events());
    let one = |n: usize| -> Option<RankedEffect> {
        let candidate = scored.candidates[n];
        let kind = &CANDIDATES[candidate];
        let (size, information) = (scored.sizes[n]?, scored.information[n]);
        let of_event = |information: f64| information / (ERRORS * ERRORS * ground.scored_events() as f64);
        Some(RankedEffect {
            candidate,
            effect_size: size,
            error: ERRORS / information.sqrt(),
            value: kind.value(size, scales, nominal),
            gain: if is_physics(candidate, size) { scored.gains[n] / events as f64 } else { 0.0 },
            information: of_event(information),
            of_known_light: of_event(scored.known[n]),
            unit: kind.value(1.0, scales, nominal) - kind.nominal_value(nominal),
            ..RankedEffect::default()
        })
    };
    let mut list: Vec<RankedEffect> = (0..scored.candidates.len()).filter_map(one).collect();
    list.sort_by(RankedEffect::by_gain);
    list
}

/// Best effects by gain and by agreement of places; and, where the size differs from 0, by what the scene
/// absorbs.
fn worth_fitting(ranked: &[RankedEffect], scored: &EffectScores, plan: &WorkPlan) -> Vec<usize> {
    let best = ranked.first().map_or(0.0, |one| one.gain);
    let is_something = |one: &&RankedEffect| one.gain > f64::max(plan.least_gain, plan.worth * best);
    let mut chosen: Vec<usize> =
        ranked.iter().filter(is_something).take(plan.by_gain).map(|one| one.candidate).collect();
    let mut by_agreement: Vec<(f64, usize)> = ranked
        .iter()
        .filter(is_something)
        .filter_map(|one| Some((scored.agreement(one.candidate)?, one.candidate)))
        .collect();
    by_agreement.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    for (_, candidate) in by_agreement.into_iter().take(plan.by_agreement) {
        if !chosen.contains(&candidate) {
            chosen.push(candidate);
        }
    }
    let is_followed = |one: &&RankedEffect| {
        CANDIDATES[one.candidate].sought.is_followed && one.effect_size.abs() > one.error
    };
    if !chosen.is_empty() {
        chosen.extend(ranked.iter().filter(is_followed).map(|one| one.candidate));
        chosen.sort_unstable();
        chosen.dedup();
    }
    chosen
}

#[cfg(test)]
mod tests;
