//! A whole diagnosis: direct tests, roads, verdict, fitted description, proof, report; and its stages one by one ([`check`], [`propose`], [`confirm`]).

use crate::candidates::{CANDIDATES, Candidate, Scales};
use crate::case::{Case, PixelEvents};
use crate::comparison::{Comparison, Ground, Step};
use crate::contest;
use crate::fitted::{fitted, put_beside};
use crate::heldout::{Prediction, predict};
use crate::integrity::data::{FEWEST_EVENTS, FEWEST_FRAMES};
use crate::integrity::{Finding, Integrity, TESTED, integrity};
use crate::nominal::Nominal;
use crate::report::{BeforeAfter, EffectReport, Evidence, Fit, Location, MASK_LIMIT, NotTestable, Parameter, Provenance, Report, SCHEMA, Verdict};
use crate::residual::located::{Located, answered, of_claim, of_unnamed};
use crate::sample::Sample;
use crate::scene::SceneSetting;
use crate::verdict::{Answer, Claim, Road, verdict};
use photocurrent_core::digest::DigestBuilder;
use photocurrent_core::{NodeError, Sensor};
use photocurrent_sensor::effects::{EffectDecl, Stage, catalogue};
use serde::{Deserialize, Serialize};

/// How a diagnosis is made.
#[derive(Clone, Copy, Debug)]
pub struct Setting {
    /// Seed of everything random.
    pub seed: u64,
    /// How the light is estimated.
    pub scene: SceneSetting,
    /// Are before and after not compared on what was held out?
    pub without_proof: bool,
    /// What predicts held-out frames worse than the description as stated, by more than this, dB, is withdrawn.
    pub most_worse_db: f64,
}

impl Default for Setting {
    fn default() -> Setting {
        Setting { seed: 0, scene: SceneSetting::default(), without_proof: false, most_worse_db: 0.05 }
    }
}

/// A test that estimates the scene: what it is called, and how it is run on a recording. The recording has what the direct tests found in its description.
pub struct RoadKind {
    /// `likelihood`, `synthesis`.
    pub name: &'static str,
    /// Runs it.
    pub run: RunRoad,
}

/// Runs a road on a recording; an error is told, and the others go on.
pub type RunRoad = Box<dyn Fn(&Case, &Setting) -> Result<Road, String>>;

impl RoadKind {
    /// A road by its name and what runs it.
    pub fn new(name: &'static str, run: impl Fn(&Case, &Setting) -> Result<Road, String> + 'static) -> RoadKind {
        RoadKind { name, run: Box::new(run) }
    }
}

/// What came of a diagnosis.
#[derive(Clone, Debug)]
pub struct Diagnosis {
    /// The report.
    pub report: Report,
    /// The description with what was found put in; none when nothing was found.
    pub fitted: Option<Sensor>,
    /// What direct tests saw.
    pub integrity: Integrity,
    /// What each road found.
    pub roads: Vec<Road>,
    /// Roads that did not get to an end, and why.
    pub failed: Vec<String>,
    /// Ids of effects that were withdrawn, as held-out frames are predicted worse with them.
    pub withdrawn: Vec<String>,
    /// Kept frames predicted as stated, and as fitted.
    pub predictions: (Option<Prediction>, Option<Prediction>),
    /// The pixels of the predictions.
    pub sample: Option<Sample>,
    /// Events, before and after; none where there was too little to compare.
    pub comparison: Option<Comparison>,
    /// Where effects of the report are, by id; those that a method measured.
    pub located: Vec<(String, Located)>,
}

/// What the roads found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Proposed {
    /// What each road found that came to its end.
    pub roads: Vec<Road>,
    /// Their names, in the order in which they were run.
    pub ran: Vec<String>,
    /// Roads that did not get to an end, and why.
    pub failed: Vec<String>,
}

/// Diagnoses a recording: [`check`], [`propose`], [`confirm`]. `tell` hears the name of each stage as it begins.
///
/// # Errors
/// When the description does not state what the model needs, or its effects are not understood.
pub fn diagnose(case: &Case, setting: &Setting, roads: &[RoadKind], mut tell: impl FnMut(&str)) -> Result<Diagnosis, NodeError> {
    tell("integrity");
    let integrity = check(case)?;
    let proposed = propose(case, setting, &integrity, roads, &mut tell)?;
    confirm(case, setting, integrity, proposed, tell)
}

/// What the direct tests see, less what the description states.
///
/// # Errors
/// When the description does not state what the model needs, or its effects are not understood.
pub fn check(case: &Case) -> Result<Integrity, NodeError> {
    let nominal = case.nominal()?;
    let mut integrity = integrity(case, Some(&nominal));
    // What the description states is no departure from it.
    integrity.findings.retain(|finding| !case.sensor.effects.contains_key(finding.id));
    Ok(integrity)
}

/// Is there enough, and is it sound enough, to estimate a scene?
pub fn can_compare(case: &Case, integrity: &Integrity) -> bool {
    integrity.broken.is_empty() && case.events.all().len() >= FEWEST_EVENTS && case.frame_count() >= FEWEST_FRAMES
}

/// The recording with what direct tests found in its description, and without the pixels that they exclude, so that roads look for the rest.
///
/// # Errors
/// When the description does not state what the model needs, or its effects are not understood.
pub fn amend(case: &Case, integrity: &Integrity) -> Result<Case, NodeError> {
    let nominal = case.nominal()?;
    Ok(amended(case, &nominal, &Scales::of(case, &nominal), integrity))
}

/// Runs roads on the amended recording; none where there is too little to estimate a scene. `tell` hears the name of each as it begins.
///
/// # Errors
/// When the description does not state what the model needs, or its effects are not understood.
pub fn propose(case: &Case, setting: &Setting, integrity: &Integrity, roads: &[RoadKind], mut tell: impl FnMut(&str)) -> Result<Proposed, NodeError> {
    let mut proposed = Proposed::default();
    if !can_compare(case, integrity) {
        return Ok(proposed);
    }
    let amended = amend(case, integrity)?;
    for road in roads {
        tell(road.name);
        match (road.run)(&amended, setting) {
            Ok(result) => {
                proposed.ran.push(road.name.to_owned());
                let decides = result.decides;
                proposed.roads.push(result);
                if decides {
                    break;
                }
            }
            Err(why) => proposed.failed.push(format!("{}: {why}", road.name)),
        }
    }
    Ok(proposed)
}

/// Joins what direct tests and roads found: verdict, fitted description, proof, report. `tell` hears the name of each stage as it begins.
///
/// # Errors
/// When the description does not state what the model needs, or its effects are not understood.
pub fn confirm(case: &Case, setting: &Setting, mut integrity: Integrity, proposed: Proposed, mut tell: impl FnMut(&str)) -> Result<Diagnosis, NodeError> {
    let nominal = case.nominal()?;
    let scales = Scales::of(case, &nominal);
    let Proposed { roads: mut found, ran, mut failed } = proposed;
    let can_compare = can_compare(case, &integrity);
    let sample = (can_compare && !setting.without_proof).then(|| looked_at(case)).filter(|sample| !sample.is_empty());
    tell("contest");
    let amended = amended(case, &nominal, &scales, &integrity);
    let amended_nominal = amended.nominal()?;
    let amended_scales = Scales::of(&amended, &amended_nominal);
    let mut told = |part: &str, why: String| failed.push(format!("{part}: {why}"));
    let ground = sample.as_ref().map_or(Ok(None), |_| Ground::new(&amended, &amended_nominal, &amended_scales));
    let ground = ground.unwrap_or_else(|why| {
        told("comparison", why);
        None
    });
    contest::judge(ground.as_ref(), &mut found).unwrap_or_else(|why| told("contest", why));
    tell("verdict");
    let mut answer = verdict(case, &nominal, &integrity, &found);
    // Silence of a test that could not be made says nothing.
    if answer.verdict == Verdict::Consistent && (!can_compare || !failed.is_empty()) {
        answer.verdict = Verdict::Insufficient;
        integrity.lacking.extend(failed.iter().cloned());
    }
    let of_claims = |claims: &[Claim]| description(case, &nominal, &scales, claims);
    let mut changed = of_claims(&answer.claims);
    tell("proof");
    let predicted = |sensor: &Sensor| sample.as_ref().map_or(Ok(None), |sample| predict(case, sensor, sample, &setting.scene));
    let before = predicted(&case.sensor)?;
    let mut after = changed.as_ref().map(&predicted).transpose()?.flatten();
    let is_worse = |after: &Option<Prediction>| {
        before.as_ref().zip(after.as_ref()).is_some_and(|(before, after)| after.psnr_db() < before.psnr_db() - setting.most_worse_db)
    };
    let mut withdrawn = Vec::new();
    if is_worse(&after) {
        for claims in fewer(&answer.claims) {
            changed = of_claims(&claims);
            after = changed.as_ref().map(&predicted).transpose()?.flatten();
            if claims.iter().all(|claim| claim.finding.is_some()) || !is_worse(&after) {
                let is_left = |claim: &&Claim| claims.iter().all(|left| left.id != claim.id);
                withdrawn.extend(answer.claims.iter().filter(is_left).map(|claim| claim.id.to_owned()));
                answer.keep(claims);
                break;
            }
        }
    }
    let predictions = (before, after);
    tell("comparison");
    // Roads look for the rest beside what direct tests found; the comparison is with the description as stated.
    let as_stated = without_masked(case, &integrity);
    let ground = if integrity.findings.is_empty() { Ok(ground) } else { ground.map_or(Ok(None), |_| Ground::new(&as_stated, &nominal, &scales)) };
    let compared = ground.and_then(|ground| ground.map(|ground| ground.compare(&answer.claims)).transpose());
    let comparison = compared.unwrap_or_else(|why| {
        failed.push(format!("comparison: {why}"));
        None
    });
    let stages = std::iter::once("integrity".to_owned()).chain(ran).collect();
    let located = answered(&found, &answer);
    let report = report(case, &nominal, setting, &integrity, &found, &answer, changed.as_ref(), &predictions, comparison.as_ref(), stages);
    Ok(Diagnosis { located, report, fitted: changed, integrity, roads: found, failed, withdrawn, predictions, sample, comparison })
}

/// The description with claims put in; none without claims.
fn description(case: &Case, nominal: &Nominal, scales: &Scales, claims: &[Claim]) -> Option<Sensor> {
    let values: Vec<(usize, f64)> = claims.iter().flat_map(|claim| claim.values.iter().map(|(candidate, value, _)| (*candidate, *value))).collect();
    let mut changed = (!values.is_empty()).then(|| fitted(&case.sensor, nominal, scales, &values))?;
    claims.iter().filter_map(|claim| claim.finding.as_ref()).for_each(|finding| put_beside(&mut changed.effects, finding.id, &finding.parameters));
    Some(changed)
}

/// Claims without one of those that an estimate of the scene made, the weakest left out first; at last without all of them. What direct tests found stays.
fn fewer(claims: &[Claim]) -> Vec<Vec<Claim>> {
    let estimated: Vec<&str> = claims.iter().filter(|claim| claim.finding.is_none()).map(|claim| claim.id).collect();
    let without = |ids: &[&str]| claims.iter().filter(|claim| !ids.contains(&claim.id)).cloned().collect::<Vec<Claim>>();
    let one_less = estimated.iter().rev().filter(|_| estimated.len() > 1).map(|id| without(&[*id]));
    one_less.chain([without(&estimated)]).collect()
}

/// The pixels in which the proof is looked for: blocks spread over the array, or all of a small one.
fn looked_at(case: &Case) -> Sample {
    const SIDE: u32 = 8;
    let zones = (6, 5);
    if case.extent.width < zones.0 * SIDE || case.extent.height < zones.1 * SIDE {
        return Sample::all(case, SIDE);
    }
    Sample::blocks(case, zones, SIDE, 1, (3.0, 300.0))
}

/// The recording without the pixels that direct tests exclude.
fn without_masked(case: &Case, integrity: &Integrity) -> Case {
    let mut rest = case.clone();
    if !integrity.masked.is_empty() {
        let keep = |pixel: usize| integrity.masked.binary_search(&(pixel as u32)).is_err();
        let events = (0..case.events.pixels()).map(|pixel| if keep(pixel) { case.events.of(pixel).to_vec() } else { Vec::new() });
        rest.events = PixelEvents::new(events);
        if let Some(frames) = &mut rest.frames {
            let pixels = case.extent.pixels();
            let masked = integrity.masked.iter().flat_map(|&pixel| (pixel as usize..frames.dn.len()).step_by(pixels));
            masked.collect::<Vec<_>>().into_iter().for_each(|at| frames.dn[at] = f32::NAN);
        }
    }
    rest
}

/// The recording with what direct tests found in its description, and without the pixels that they exclude, so that roads look for the rest.
pub fn amended(case: &Case, nominal: &Nominal, scales: &Scales, integrity: &Integrity) -> Case {
    let mut amended = without_masked(case, integrity);
    // Hot rows and pixels are out with their pixels.
    let rest = integrity.findings.iter().filter(|finding| !matches!(finding.id, "hot_rows" | "hot_pixels"));
    let values: Vec<(usize, f64)> = rest.clone().flat_map(values_of).collect();
    amended.sensor = fitted(&case.sensor, nominal, scales, &values);
    rest.for_each(|finding| put_beside(&mut amended.sensor.effects, finding.id, &finding.parameters));
    if let Some(step) = values.iter().find(|(which, _)| CANDIDATES[*which].id == "timestamp_quantization").map(|(_, step)| *step) {
        amended.t_resolution_ns = (step * 1e9).round() as i64;
    }
    amended
}

fn values_of(finding: &Finding) -> Vec<(usize, f64)> {
    let place = |parameter: &str| CANDIDATES.iter().position(|one| one.id == finding.id && one.parameter == parameter);
    finding.parameters.iter().filter_map(|(parameter, value)| Some((place(parameter)?, *value))).collect()
}

fn report(
    case: &Case,
    nominal: &Nominal,
    setting: &Setting,
    integrity: &Integrity,
    roads: &[Road],
    answer: &Answer,
    changed: Option<&Sensor>,
    predictions: &(Option<Prediction>, Option<Prediction>),
    comparison: Option<&Comparison>,
    stages: Vec<String>,
) -> Report {
    let mut effects: Vec<EffectReport> = answer.claims.iter().map(|claim| effect(case, nominal, claim)).collect();
    for (effect, claim) in effects.iter_mut().zip(&answer.claims) {
        of_claim(roads, claim).into_iter().for_each(|located| located.put(&mut effect.location));
    }
    // What was measured apart from the pixels of the fit says more than what a fit says of itself.
    let apart = comparison.filter(|comparison| comparison.is_apart && comparison.after().is_some());
    for effect in &mut effects {
        gained(effect, apart);
    }
    if let Some(found) = &answer.unexplained {
        let mut location = everywhere(case, None);
        of_unnamed(roads, found).into_iter().for_each(|located| located.put(&mut location));
        location.covariate.clone_from(&found.covariate);
        // Of closures the gain is that of a change; of a rate of events that of an event.
        let is_direct = found.law.as_ref().is_some_and(|law| law.moved == crate::law::Moved::EventRate);
        let (by, heldout_nats, per_event) = if is_direct {
            (crate::verdict::DIRECT, found.nats * case.events.all().len() as f64, Some(found.nats))
        } else {
            (crate::roads::REFIT, found.nats, None)
        };
        let evidence = Evidence {
            statistic: found.score,
            heldout_nats: Some(heldout_nats),
            heldout_nats_per_event: per_event,
            found_by: vec![by.into()],
            ..Evidence::default()
        };
        effects.push(EffectReport {
            id: "unnamed".into(),
            also_possible: found.hardly.clone(),
            plain: if found.hardly.is_empty() {
                "something that no effect of the catalogue explains"
            } else {
                "something that differs, and for which no effect is believed enough to be its name"
            }
            .into(),
            equation: found.equation.clone(),
            insertion: found.insertion.clone(),
            parameters: Default::default(),
            location,
            evidence,
        });
    }
    let psnr = predictions.0.as_ref().zip(predictions.1.as_ref()).map(|(before, after)| BeforeAfter { before: before.psnr_db(), after: after.psnr_db() });
    let first = roads.iter().find(|road| road.nats_per_event.is_some());
    let nats = first.and_then(|road| road.nats_per_event).filter(|_| !answer.claims.is_empty()).map(|(before, after)| BeforeAfter { before, after });
    let nats = apart.and_then(nats_of).or(nats);
    let ks = |step: &Step| step.calibration.as_ref().map(|calibration| calibration.ks);
    let calibration_ks = comparison.and_then(|comparison| Some(BeforeAfter { before: ks(comparison.before())?, after: ks(comparison.after()?)? }));
    let mut detectability: Vec<_> = roads.iter().flat_map(|road| road.detectability.iter().cloned()).collect();
    // The road that was asked first knows best.
    let mut seen: Vec<(String, String)> = Vec::new();
    detectability.retain(|one| {
        let key = (one.id.clone(), one.parameter.clone());
        let is_new = !seen.contains(&key);
        seen.push(key);
        is_new
    });
    Report {
        schema: SCHEMA.to_owned(),
        verdict: answer.verdict,
        summary: summary(integrity, answer),
        not_testable: not_testable(case, roads).into_iter().filter(|one| answer.claims.iter().all(|claim| claim.id != one.id)).collect(),
        next_experiment: crate::advice::next_experiments(case, answer, integrity),
        residual_left: roads.iter().find_map(|road| road.residual_left).filter(|_| !answer.claims.is_empty()),
        effects,
        fit: Fit { heldout_nats_per_event: nats, heldout_frame_psnr_db: psnr, calibration_ks },
        detectability,
        scene: integrity.scene.clone(),
        sensor_fitted: changed.map(|_| "sensor.fitted.toml".to_owned()),
        provenance: Provenance {
            recording_digest: digest(case),
            sensor_digest: DigestBuilder::new("photocurrent-diagnosis-sensor/1").text(&case.sensor.canonical_json()).finish().to_string(),
            seed: setting.seed,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            stages,
        },
    }
}

/// How well events of pixels to which nothing was fitted are foretold; none when no claim has events of its own.
fn nats_of(comparison: &Comparison) -> Option<BeforeAfter> {
    let is_told = comparison.steps.iter().any(|step| step.id.is_some() && !step.is_random);
    is_told.then(|| BeforeAfter { before: comparison.before().nats_per_event(), after: comparison.after().map_or(f64::NAN, Step::nats_per_event) })
}

/// What an effect gains on events of pixels to which nothing was fitted.
fn gained(effect: &mut EffectReport, comparison: Option<&Comparison>) {
    // A direct test that has a gain of its own speaks of all pixels.
    let has_own = effect.evidence.heldout_nats.is_some() && effect.evidence.found_by.iter().any(|by| by == "direct");
    let Some(comparison) = comparison.filter(|_| !has_own) else { return };
    let Some(at) = comparison.steps.iter().position(|step| step.id == Some(effect.id.as_str()) && !step.is_random) else { return };
    let gain = comparison.gain(at - 1, at);
    effect.evidence.heldout_nats = Some(gain.nats);
    effect.evidence.heldout_nats_ci95 = Some(gain.nats_ci95);
    effect.evidence.heldout_nats_per_event = Some(gain.nats_per_event);
}

/// The report of a recording that could not be read as one: its data contradict the format or themselves.
pub fn broken(why: &str, seed: u64) -> Report {
    Report {
        schema: SCHEMA.to_owned(),
        verdict: Verdict::BrokenData,
        summary: why.to_owned(),
        effects: Vec::new(),
        fit: Fit::default(),
        detectability: Vec::new(),
        scene: Vec::new(),
        not_testable: Vec::new(),
        next_experiment: vec!["record again, or repair the file: nothing can be said of a sensor whose data contradict themselves".into()],
        residual_left: None,
        sensor_fitted: None,
        provenance: Provenance { seed, version: env!("CARGO_PKG_VERSION").to_owned(), ..Provenance::default() },
    }
}

fn effect(case: &Case, nominal: &Nominal, claim: &Claim) -> EffectReport {
    let decl = decl(claim.id);
    let evidence = Evidence {
        statistic: claim.score,
        p_value: None,
        heldout_nats: claim.heldout_nats,
        heldout_nats_ci95: None,
        belief: claim.belief,
        heldout_nats_per_event: claim.heldout_nats_per_event,
        found_by: claim.found_by.clone(),
    };
    let mut effect = EffectReport::of(&decl, location(case, &decl, claim.finding.as_ref()), evidence);
    effect.also_possible = claim.also_possible.iter().map(|id| (*id).to_owned()).collect();
    for (candidate, value, ci95) in &claim.values {
        effect.put(&CANDIDATES[*candidate], *value, *ci95, nominal);
    }
    if claim.values.iter().any(|(candidate, ..)| CANDIDATES[*candidate].parameter == "reset") {
        effect.equation = "the reference moves by one threshold at each event, or is taken anew, other than stated (comparator.reset)".into();
    }
    if let Some(finding) = &claim.finding {
        effect.plain = format!("{}: {}", decl.about, finding.seen);
        // Numbers that are no candidates of their own stand beside.
        for (parameter, value) in &finding.parameters {
            if let Some(of) = decl.parameters.iter().find(|of| of.name == *parameter).filter(|_| Candidate::find(claim.id, parameter).is_none()) {
                let key = format!("{parameter}{}", of.unit.suffix());
                effect.parameters.insert(key, Parameter { estimate: *value, ci95: None, nominal: of.null, unit: of.unit.text().to_owned() });
            }
        }
    }
    effect
}

fn decl(id: &str) -> EffectDecl {
    catalogue().into_iter().map(|kind| kind.decl).find(|decl| decl.id == id).unwrap_or_else(|| unreachable!("claims are of the catalogue"))
}

fn everywhere(case: &Case, decl: Option<&EffectDecl>) -> Location {
    Location {
        stream: match decl.map(|decl| decl.stage) {
            Some(Stage::Exposure) => "frames",
            None => "both",
            Some(_) => "events",
        }
        .to_owned(),
        polarity: "both".to_owned(),
        rows: [0, case.extent.height.saturating_sub(1)],
        columns: [0, case.extent.width.saturating_sub(1)],
        time_ns: [case.span.0, case.span.1],
        covariate: decl.map_or_else(String::new, |decl| decl.covariate.to_owned()),
        shape: None,
        pixels: case.extent.pixels() as u64,
        pixel_list: Vec::new(),
    }
}

fn location(case: &Case, decl: &EffectDecl, finding: Option<&Finding>) -> Location {
    let mut location = everywhere(case, Some(decl));
    let Some(finding) = finding else { return location };
    location.polarity = finding.polarity.to_owned();
    if !finding.pixels.is_empty() {
        let places: Vec<(u32, u32)> = finding.pixels.iter().map(|&pixel| case.place(pixel as usize)).collect();
        let ends = |values: Vec<u32>| [values.iter().copied().min().unwrap_or(0), values.iter().copied().max().unwrap_or(0)];
        location.columns = ends(places.iter().map(|place| place.0).collect());
        location.rows = ends(places.iter().map(|place| place.1).collect());
        location.pixels = finding.pixels.len() as u64;
        location.pixel_list = finding.pixels.iter().copied().take(MASK_LIMIT).collect();
    }
    location
}

fn summary(integrity: &Integrity, answer: &Answer) -> String {
    let name = |claim: &Claim| {
        let others: String = claim.also_possible.iter().map(|id| format!(" or {id}")).collect();
        format!("{}{others}", claim.id)
    };
    match answer.verdict {
        Verdict::BrokenData => integrity.broken.join("; "),
        Verdict::Insufficient => integrity.lacking.join("; "),
        Verdict::Consistent => "the recording agrees with the description as far as these tests see; detectability says how far that is".into(),
        Verdict::Unnamed => "the recording differs from the description, and no effect of the catalogue explains how".into(),
        Verdict::Numerical => "what differs is an error of our own: light at knots twice as near takes away more of it than any effect does".into(),
        Verdict::Named | Verdict::Ambiguous => answer.claims.iter().map(name).collect::<Vec<_>>().join(", and "),
    }
}

fn not_testable(case: &Case, roads: &[Road]) -> Vec<NotTestable> {
    let mut found: Vec<NotTestable> = roads.iter().flat_map(|road| road.not_testable.iter().cloned()).collect();
    found.sort_by(|a, b| a.id.cmp(&b.id));
    found.dedup_by(|a, b| a.id == b.id);
    if !roads.is_empty() {
        return found;
    }
    let why = if case.frame_count() < FEWEST_FRAMES {
        "it needs events and frames of the same scene, and there are not enough frames"
    } else if case.events.all().len() < FEWEST_EVENTS {
        "it needs events and frames of the same scene, and there are not enough events"
    } else {
        "it needs the scene, and no test that estimates the scene took part"
    };
    let ids = catalogue().into_iter().map(|kind| kind.decl.id).filter(|id| !TESTED.contains(id) || case.events.all().len() < FEWEST_EVENTS);
    ids.map(|id| NotTestable { id: id.to_owned(), why: why.to_owned() }).collect()
}

/// Of events, frames and their times.
fn digest(case: &Case) -> String {
    let mut digest = DigestBuilder::new("photocurrent-diagnosis-case/1");
    digest.integer(case.extent.width.into()).integer(case.extent.height.into()).integer(case.t_resolution_ns).integer(case.has_t_in.into());
    for pixel in 0..case.events.pixels() {
        let numbers: Vec<i64> = case.events.of(pixel).iter().flat_map(|event| [event.t_in_ns, event.t_off_ns, event.polarity.into()]).collect();
        digest.slice(&numbers);
    }
    if let Some(frames) = &case.frames {
        digest.integer(frames.times.row_time_ns);
        for exposure in frames.times.exposures.iter() {
            digest.integer(exposure.start.0).integer(exposure.end.0);
        }
        digest.slice(&frames.dn);
    }
    digest.finish().to_string()
}

#[cfg(test)]
#[path = "diagnose_tests.rs"]
mod tests;
