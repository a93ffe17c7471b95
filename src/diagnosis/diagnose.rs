//! A whole diagnosis: direct tests, what is decided on a scene, verdict, fitted description, proof, report;
//! and its last two stages one by one ([`check`], [`confirm`]).

use crate::candidates::{CANDIDATES, Candidate, Scales};
use crate::fitted::{add_numbers, fitted};
use crate::heldout::{Prediction, predict};
use crate::integrity::data::{FEWEST_EVENTS, FEWEST_FRAMES, is_enough};
use crate::integrity::{Finding, Integrity, TESTED, hot, integrity, stamps};
use crate::judge::judged;
use crate::report::{
    BeforeAfter, EffectReport, Evidence, Fit, Location, MASK_LIMIT, NotTestable, Parameter, Provenance,
    Report, SCHEMA, Verdict,
};
use crate::residual::located::{Located, answered, of_claim, of_unnamed};
use crate::sample::Sample;
use crate::unstated;
use crate::verdict::{Answer, Claim, DIRECT, Decided, Proposal, Unexplained, verdict};
use photocurrent_core::digest::DigestBuilder;
use photocurrent_core::{NodeError, Sensor};
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use photocurrent_sensor::effects::{EffectDecl, Stage, catalogue};
use photocurrent_solve::SolveOptions;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How a diagnosis is confirmed.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Setting {
    /// Are held-out frames predicted with the stated and the fitted description? It needs an estimate of the
    /// light; without it direct tests take a second.
    pub proof: bool,
    /// What predicts held-out frames worse than the nominal description, by more than this, dB, is withdrawn.
    #[schemars(range(min = 0.0))]
    pub most_worse_db: f64,
    /// Where no scene is evidence, what pairs of frames of long exposure propose counts only where it
    /// predicts held-out frames better by more than this, dB.
    #[schemars(range(min = 0.0))]
    pub least_better_db: f64,
    /// Seed of everything random.
    #[serde(skip)]
    pub seed: u64,
    /// How the light of held-out frames is estimated: as `solve/map` does.
    #[serde(skip)]
    pub solve: SolveOptions,
}

impl Default for Setting {
    fn default() -> Setting {
        Setting {
            proof: true,
            most_worse_db: 0.05,
            least_better_db: 1.0,
            seed: 0,
            solve: SolveOptions::default(),
        }
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
    /// What was decided on a scene, or why nothing was.
    pub proposed: Proposed,
    /// Ids of effects that were withdrawn, as held-out frames are predicted worse with them.
    pub withdrawn: Vec<String>,
    /// Held-out frames predicted with the nominal and with the fitted description.
    pub predictions: (Option<Prediction>, Option<Prediction>),
    /// The pixels of the predictions.
    pub sample: Option<Sample>,
    /// Where effects of the report are, by id; those that were measured.
    pub located: Vec<(String, Located)>,
}

/// What is decided on a scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Proposed {
    /// Nobody asked.
    #[default]
    NotAsked,
    /// The scene is no evidence, and why.
    Nothing(String),
    /// This.
    Decided(Box<Decided>),
}

impl Proposed {
    /// What is decided; none where nothing is.
    pub fn decided(&self) -> Option<&Decided> {
        match self {
            Proposed::Decided(decided) => Some(decided),
            _ => None,
        }
    }
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
    integrity.broken.is_empty() && is_enough(case)
}

/// The recording with what direct tests found in its description, and without the pixels that they exclude:
/// what is decided on a scene is the rest.
///
/// # Errors
/// When the description does not state what the model needs, or its effects are not understood.
pub fn amend(case: &Case, integrity: &Integrity) -> Result<Case, NodeError> {
    let nominal = case.nominal()?;
    Ok(amended(case, &nominal, &Scales::of(case, &nominal), integrity))
}

/// Joins what direct tests found and what was decided: verdict, fitted description, proof, report.
///
/// # Errors
/// When the description does not state what the model needs, or its effects are not understood.
pub fn confirm(
    case: &Case,
    setting: &Setting,
    mut integrity: Integrity,
    proposed: Proposed,
) -> Result<Diagnosis, NodeError> {
    let nominal = case.nominal()?;
    let scales = Scales::of(case, &nominal);
    let can_compare = can_compare(case, &integrity);
    let sample = (can_compare && setting.proof).then(|| looked_at(case)).filter(|sample| !sample.is_empty());
    if proposed.decided().is_none() {
        judged(case, &nominal, setting.least_better_db, &setting.solve, &mut integrity)?;
    }
    let mut answer = verdict(case, &nominal, &integrity, proposed.decided());
    // A test that could not be made decides nothing.
    if answer.verdict == Verdict::Consistent {
        if let Proposed::Nothing(why) = &proposed {
            answer.verdict = Verdict::Insufficient;
            let is_unstated = unstated::without_scene(&case.sensor).is_some();
            integrity.lacking.push(if is_unstated {
                format!("no direct test contradicts the description, and {why}")
            } else {
                why.clone()
            });
        } else if !can_compare {
            answer.verdict = Verdict::Insufficient;
        }
    }
    let of_claims = |claims: &[Claim]| description(case, &nominal, &scales, claims);
    let mut changed = of_claims(&answer.claims);
    let predicted = |sensor: &Sensor| {
        sample.as_ref().map_or(Ok(None), |sample| predict(case, sensor, sample, &setting.solve))
    };
    let before = predicted(&case.sensor)?;
    let mut after = changed.as_ref().map(&predicted).transpose()?.flatten();
    let is_worse = |after: &Option<Prediction>| {
        before
            .as_ref()
            .zip(after.as_ref())
            .is_some_and(|(before, after)| after.psnr_db() < before.psnr_db() - setting.most_worse_db)
    };
    let mut withdrawn = Vec::new();
    if is_worse(&after) {
        for claims in fewer(&answer.claims) {
            changed = of_claims(&claims);
            after = changed.as_ref().map(&predicted).transpose()?.flatten();
            if claims.iter().all(|claim| claim.finding.is_some()) || !is_worse(&after) {
                let is_left = |claim: &&Claim| claims.iter().all(|left| left.id != claim.id);
                withdrawn.extend(answer.claims.iter().filter(is_left).map(|claim| claim.id.to_owned()));
                answer.set(claims);
                break;
            }
        }
    }
    let predictions = (before, after);
    let report =
        report(case, &nominal, setting, &integrity, &proposed, &answer, changed.as_ref(), &predictions);
    let located = answered(proposed.decided(), &answer);
    Ok(Diagnosis { located, report, fitted: changed, integrity, proposed, withdrawn, predictions, sample })
}

/// The description with claims put in; none without claims.
fn description(case: &Case, nominal: &Nominal, scales: &Scales, claims: &[Claim]) -> Option<Sensor> {
    let values: Vec<(usize, f64)> = claims
        .iter()
        .flat_map(|claim| claim.values.iter().map(|(candidate, value, _)| (*candidate, *value)))
        .collect();
    let mut changed = (!values.is_empty()).then(|| fitted(&case.sensor, nominal, scales, &values))?;
    claims
        .iter()
        .filter_map(|claim| claim.finding.as_ref())
        .for_each(|finding| add_numbers(&mut changed.effects, finding.id, &finding.parameters));
    Some(changed)
}

/// Claims without one of those that an estimate of the scene made, the weakest left out first; at last
/// without all of them. What direct tests found stays.
fn fewer(claims: &[Claim]) -> Vec<Vec<Claim>> {
    let estimated: Vec<&str> =
        claims.iter().filter(|claim| claim.finding.is_none()).map(|claim| claim.id).collect();
    let without = |ids: &[&str]| {
        claims.iter().filter(|claim| !ids.contains(&claim.id)).cloned().collect::<Vec<Claim>>()
    };
    let one_less = estimated.iter().rev().filter(|_| estimated.len() > 1).map(|id| without(&[*id]));
    one_less.chain([without(&estimated)]).collect()
}

/// The pixels in which the proof is looked for: blocks spread over the array, or all of a small one.
pub(crate) fn looked_at(case: &Case) -> Sample {
    const SIDE: u32 = 8;
    let zones = (6, 5);
    if case.extent.width < zones.0 * SIDE || case.extent.height < zones.1 * SIDE {
        return Sample::all(case, SIDE);
    }
    Sample::blocks(case, zones, SIDE, 1, (3.0, 300.0))
}

/// The recording with what direct tests found in its description, and without the pixels that they exclude,
/// what is decided on a scene is the rest.
pub fn amended(case: &Case, nominal: &Nominal, scales: &Scales, integrity: &Integrity) -> Case {
    let mut amended = case.without(&integrity.masked);
    // Hot rows and pixels are out with their pixels.
    let rest = integrity.findings.iter().filter(|finding| !hot::IDS.contains(&finding.id));
    let values: Vec<(usize, f64)> = rest.clone().flat_map(values_of).collect();
    amended.sensor = fitted(&case.sensor, nominal, scales, &values);
    rest.for_each(|finding| add_numbers(&mut amended.sensor.effects, finding.id, &finding.parameters));
    if let Some(step) =
        values.iter().find(|(which, _)| CANDIDATES[*which].id == stamps::GRID).map(|(_, step)| *step)
    {
        amended.t_resolution_ns = (step * 1e9).round() as i64;
    }
    amended
}

fn values_of(finding: &Finding) -> Vec<(usize, f64)> {
    let place = |parameter: &str| {
        CANDIDATES.iter().position(|one| one.id == finding.id && one.parameter == parameter)
    };
    finding.parameters.iter().filter_map(|(parameter, value)| Some((place(parameter)?, *value))).collect()
}

fn report(
    case: &Case,
    nominal: &Nominal,
    setting: &Setting,
    integrity: &Integrity,
    proposed: &Proposed,
    answer: &Answer,
    changed: Option<&Sensor>,
    predictions: &(Option<Prediction>, Option<Prediction>),
) -> Report {
    let mut effects: Vec<EffectReport> =
        answer.claims.iter().map(|claim| effect(case, nominal, claim)).collect();
    for (effect, claim) in effects.iter_mut().zip(&answer.claims) {
        of_claim(proposed.decided(), claim).into_iter().for_each(|located| located.put(&mut effect.location));
    }
    if let Some(found) = &answer.unexplained {
        effects.push(unnamed(case, proposed, found));
    }
    let psnr = predictions
        .0
        .as_ref()
        .zip(predictions.1.as_ref())
        .map(|(before, after)| BeforeAfter { before: before.psnr_db(), after: after.psnr_db() });
    let decided = proposed.decided();
    let gained: f64 = answer
        .claims
        .iter()
        .filter(|claim| claim.finding.is_none())
        .filter_map(|claim| claim.heldout_nats_per_event)
        .sum();
    let nats = decided
        .and_then(|decided| decided.nats_per_event)
        .filter(|_| gained > 0.0)
        .map(|before| BeforeAfter { before, after: before + gained });
    // A second effect is fitted on top of the first, so the last one describes both.
    let left = answer.claims.iter().rev().find_map(|claim| claim.ks);
    let calibration_ks =
        decided.and_then(|decided| decided.ks).zip(left).map(|(before, after)| BeforeAfter { before, after });
    Report {
        schema: SCHEMA.to_owned(),
        verdict: answer.verdict,
        summary: summary(case, integrity, answer, decided),
        not_testable: not_testable(case, proposed, &answer.claims),
        next_experiment: crate::advice::next_experiments(case, answer, integrity),
        residual_left: decided
            .and_then(|decided| decided.residual_left)
            .filter(|_| answer.claims.iter().any(|claim| claim.finding.is_none())),
        effects,
        fit: Fit { heldout_nats_per_event: nats, heldout_frame_psnr_db: psnr, calibration_ks },
        detectability: decided.map_or_else(Vec::new, |decided| {
            let is_claimed = |id: &str| answer.claims.iter().any(|claim| claim.id == id);
            decided.detectability.iter().filter(|one| !is_claimed(&one.id)).cloned().collect()
        }),
        scene: integrity.scene.clone(),
        sensor_fitted: changed.map(|_| "sensor.fitted.toml".to_owned()),
        provenance: Provenance {
            recording_digest: digest(case),
            sensor_digest: DigestBuilder::new("photocurrent-diagnosis-sensor/1")
                .text(&case.sensor.canonical_json())
                .finish()
                .to_string(),
            seed: setting.seed,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            stages: std::iter::once("integrity".to_owned())
                .chain(decided.map(|decided| decided.name.clone()))
                .collect(),
        },
    }
}

/// What no effect of the catalogue explains, as the report has it.
fn unnamed(case: &Case, proposed: &Proposed, found: &Unexplained) -> EffectReport {
    let mut location = everywhere(case, None);
    of_unnamed(proposed.decided(), found).into_iter().for_each(|located| located.put(&mut location));
    location.covariate.clone_from(&found.covariate);
    let is_direct = found
        .dependence
        .as_ref()
        .is_some_and(|dependence| dependence.moved == crate::dependence::Moved::EventRate);
    let by =
        if is_direct { DIRECT } else { proposed.decided().map_or(DIRECT, |decided| decided.name.as_str()) };
    let evidence = Evidence {
        statistic: found.score,
        heldout_nats_per_event: Some(found.nats),
        found_by: vec![by.to_owned()],
        ..Evidence::default()
    };
    EffectReport {
        id: "unnamed".into(),
        also_possible: Vec::new(),
        plain: "something that no effect of the catalogue explains".into(),
        equation: found.equation.clone(),
        insertion: found.insertion.clone(),
        parameters: Default::default(),
        location,
        evidence,
    }
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
        next_experiment: vec![
            "record again, or repair the file: nothing can be said of a sensor whose data \
                               contradict themselves"
                .into(),
        ],
        residual_left: None,
        sensor_fitted: None,
        provenance: Provenance {
            seed,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            ..Provenance::default()
        },
    }
}

fn effect(case: &Case, nominal: &Nominal, claim: &Claim) -> EffectReport {
    let decl = decl(claim.id);
    let evidence = Evidence {
        statistic: claim.score,
        p_value: None,
        heldout_nats: claim.heldout_nats,
        heldout_nats_ci95: claim.heldout_nats_ci95,
        posterior: claim.posterior,
        heldout_nats_per_event: claim.heldout_nats_per_event,
        found_by: claim.found_by.clone(),
    };
    let mut effect = EffectReport::of(&decl, location(case, &decl, claim.finding.as_ref()), evidence);
    effect.also_possible = claim.also_possible.iter().map(|id| (*id).to_owned()).collect();
    for (candidate, value, ci95) in &claim.values {
        let candidate = &CANDIDATES[*candidate];
        effect.put(candidate, *value, *ci95, nominal);
        if !unstated::is_stated(&case.sensor, candidate)
            && let Some(parameter) = effect.parameters.get_mut(&candidate.json_key().0)
        {
            parameter.nominal = None;
        }
    }
    if claim.values.iter().any(|(candidate, ..)| CANDIDATES[*candidate].is_reset()) {
        effect.equation = "the reference moves by one threshold at each event, or is taken anew, other than \
                           stated (comparator.reset)"
            .into();
    }
    if let Some(finding) = &claim.finding {
        effect.plain = format!("{}: {}", decl.about, finding.seen);
        if let Some((_, because)) = unstated::alike(&case.sensor, finding) {
            effect.plain += &format!("; the front end is not stated, and {because}");
        }
        // Numbers that are no candidates of their own are added.
        for (parameter, value) in &finding.parameters {
            if let Some(of) = decl
                .parameters
                .iter()
                .find(|of| of.name == *parameter)
                .filter(|_| Candidate::find(claim.id, parameter).is_none())
            {
                let key = format!("{parameter}{}", of.unit.suffix());
                effect.parameters.insert(
                    key,
                    Parameter {
                        estimate: *value,
                        ci95: finding.interval(parameter),
                        nominal: of.null,
                        unit: of.unit.text().to_owned(),
                    },
                );
            }
        }
    }
    effect
}

fn decl(id: &str) -> EffectDecl {
    catalogue()
        .into_iter()
        .map(|kind| kind.decl)
        .find(|decl| decl.id == id)
        .unwrap_or_else(|| unreachable!("claims are of the catalogue"))
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
        let places: Vec<(u32, u32)> =
            finding.pixels.iter().map(|&pixel| case.place(pixel as usize)).collect();
        let ends = |values: Vec<u32>| {
            [values.iter().copied().min().unwrap_or(0), values.iter().copied().max().unwrap_or(0)]
        };
        location.columns = ends(places.iter().map(|place| place.0).collect());
        location.rows = ends(places.iter().map(|place| place.1).collect());
        location.pixels = finding.pixels.len() as u64;
        location.pixel_list = finding.pixels.iter().copied().take(MASK_LIMIT).collect();
    }
    location
}

fn summary(case: &Case, integrity: &Integrity, answer: &Answer, decided: Option<&Decided>) -> String {
    let name = |claim: &Claim| {
        let others: String = claim.also_possible.iter().map(|id| format!(" or {id}")).collect();
        format!("{}{others}", claim.id)
    };
    let said = match answer.verdict {
        Verdict::BrokenData => return integrity.broken.join("; "),
        Verdict::Insufficient => return integrity.lacking.join("; "),
        Verdict::Consistent => "the recording agrees with the description as far as these tests see; \
                                detectability says how far that is"
            .into(),
        Verdict::Unnamed => "the recording differs from the description, and no effect of the catalogue \
                             explains how"
            .into(),
        Verdict::Numerical => "what differs is an error of our own".into(),
        Verdict::Named | Verdict::Ambiguous => {
            answer.claims.iter().map(name).collect::<Vec<_>>().join(", and ")
        }
    };
    let Some(decided) = decided else {
        let left_out = unstated::without_scene(&case.sensor).filter(|_| is_enough(case));
        return left_out.map_or(said.clone(), |why| format!("{said}; {why}"));
    };
    let near = nearly(decided, answer);
    let near = if near.is_empty() {
        near
    } else {
        format!("; near the detection threshold, and not reported: {near}")
    };
    format!("{said} ({}){near}", looked_at_of(decided))
}

/// From this share of its detection threshold on, a test is said to have nearly reached it.
const NEARLY: f64 = 0.5;

/// What came near its detection threshold on the scene without being reported, with its share of it.
fn nearly(decided: &Decided, answer: &Answer) -> String {
    let is_reported =
        |id: &str| answer.claims.iter().any(|claim| claim.id == id || claim.also_possible.contains(&id));
    let share = |one: &Proposal| one.score * one.probability;
    let near = decided
        .proposals
        .iter()
        .filter(|one| (NEARLY..1.0).contains(&share(one)) && !is_reported(CANDIDATES[one.candidate].id));
    near.map(|one| format!("{} ({:.0} % of it)", CANDIDATES[one.candidate].label(), 100.0 * share(one)))
        .collect::<Vec<_>>()
        .join(", ")
}

/// Which events were held against which scene.
fn looked_at_of(decided: &Decided) -> String {
    let scene = match decided.name.as_str() {
        "given" => "on known light",
        "patches" => "on a scene in parts",
        _ => "on a moving picture",
    };
    let when = decided.span_ns.map_or_else(String::new, |(from, to)| {
        format!(" from {:.2} to {:.2} s", from as f64 * 1e-9, to as f64 * 1e-9)
    });
    format!("{scene}, {:.0} % of the events{when}", 100.0 * decided.share)
}

/// What nothing was found out about.
fn not_testable(case: &Case, proposed: &Proposed, claims: &[Claim]) -> Vec<NotTestable> {
    let why = match proposed {
        Proposed::Decided(_) => return Vec::new(),
        _ if case.frame_count() < FEWEST_FRAMES => {
            "it needs events and frames of the same scene, and there are not enough frames"
        }
        _ if case.events.len() < FEWEST_EVENTS => {
            "it needs events and frames of the same scene, and there are not enough events"
        }
        Proposed::Nothing(why) => why,
        Proposed::NotAsked => "it needs the scene, and no test that estimates the scene took part",
    };
    let is_tested = |id: &str| {
        TESTED.contains(&id) && case.events.len() >= FEWEST_EVENTS
            || claims.iter().any(|claim| claim.id == id)
    };
    if is_enough(case) {
        let left_out = unstated::not_testable(&case.sensor, is_tested);
        if !left_out.is_empty() {
            return left_out;
        }
    }
    let ids = catalogue().into_iter().map(|kind| kind.decl.id).filter(|id| !is_tested(id));
    ids.map(|id| NotTestable { id: id.to_owned(), why: why.to_owned() }).collect()
}

/// Of events, frames and their times.
fn digest(case: &Case) -> String {
    let mut digest = DigestBuilder::new("photocurrent-diagnosis-case/2");
    digest
        .integer(case.extent.width.into())
        .integer(case.extent.height.into())
        .integer(case.t_resolution_ns)
        .integer(case.has_t_in.into());
    for pixel in 0..case.events.pixels() {
        let numbers: Vec<i64> = case
            .events
            .of(pixel)
            .iter()
            .flat_map(|event| [event.t_in_ns, event.t_off_ns, event.polarity.into()])
            .collect();
        digest.slice(&numbers);
    }
    if let Some(frames) = &case.frames {
        digest.integer(frames.times.row_time_ns);
        for exposure in frames.times.exposures.iter() {
            digest.integer(exposure.start.0).integer(exposure.end.0);
        }
        let pixels = 0..case.extent.pixels();
        (0..frames.times.len()).for_each(|l| {
            digest.slice(&pixels.clone().map(|pixel| frames.dn(l, pixel)).collect::<Vec<f32>>());
        });
    }
    digest.finish().to_string()
}

#[cfg(test)]
#[path = "diagnose_tests.rs"]
mod tests;
