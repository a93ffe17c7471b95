//! A whole diagnosis: direct tests, decision on a scene, verdict, fitted description, held-out check and
//! report. Its last two stages are separate functions ([`check`], [`confirm`]).

use crate::advice::{SeparatedExplanations, next_experiments, two_best};
use crate::candidates::{CANDIDATES, Candidate, EffectScales};
use crate::curves::LogLightCurves;
use crate::fitted::{apply_direct_findings, fitted};
use crate::heldout::{HeldOutScore, predict};
pub use crate::integrity::can_compare;
use crate::integrity::data::{FEWEST_EVENTS, FEWEST_FRAMES, is_enough};
use crate::integrity::{Integrity, TESTED, integrity};
use crate::judge::add_confirmed_proposals;
use crate::limits::{nothing_would_show, seen_and_unseen};
use crate::report::{
    BeforeAfter, DescriptionFit, Finding, MinimumDetectable, NamedNumber, NotTestable, Provenance, Report,
    SCHEMA, SceneEstimate, Verdict,
};
use crate::residual::located::LocatedEffect;
use crate::residual::separation::{ExplanationPair, separation};
use crate::rivals::{by_frames, is_random};
use crate::sample::PixelSample;
use crate::stages::{DecisionOutcome, EffectProposal, SceneDecision, Unexplained};
use crate::units::readable;
use crate::unknowns::{is_left_open, with_estimates};
use crate::unstated;
use crate::verdict::{JoinedFindings, locations_of_findings, verdict};
use photocurrent_core::digest::DigestBuilder;
use photocurrent_core::{NodeError, Sensor};
use photocurrent_scene::block::Block;
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use photocurrent_sensor::effects::catalogue;
use photocurrent_solve::SolveOptions;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of the confirmation by held-out frames.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ConfirmSetting {
    /// Are held-out frames predicted with the stated and the fitted description? It needs an estimate of the
    /// light; without it direct tests take a second.
    pub proof: bool,
    /// Findings are withdrawn that predict held-out frames worse than the nominal description by more than
    /// this, dB.
    #[schemars(range(min = 0.0))]
    pub most_worse_db: f64,
    /// Least improvement on held-out frames, dB. Without a scene, proposals from pairs of long exposures must
    /// reach it. With a scene, a rival effect must reach it to replace the chosen one.
    #[schemars(range(min = 0.0))]
    pub least_better_db: f64,
    /// Seed of everything random.
    #[serde(skip)]
    pub seed: u64,
    /// How the light of held-out frames is estimated: as `solve/map` does.
    #[serde(skip)]
    pub solve: SolveOptions,
}

impl Default for ConfirmSetting {
    fn default() -> ConfirmSetting {
        ConfirmSetting {
            proof: true,
            most_worse_db: 0.05,
            least_better_db: 1.0,
            seed: 0,
            solve: SolveOptions::default(),
        }
    }
}

/// Held-out frames, predicted.
#[derive(Clone, Debug, Default)]
pub struct HeldOutPredictions {
    /// With the nominal description; none where they were not.
    pub nominal: Option<HeldOutScore>,
    /// With the fitted one.
    pub fitted: Option<HeldOutScore>,
}

impl HeldOutPredictions {
    /// The light that held-out frames were predicted from, by the fitted description where there is one.
    fn light(&self) -> Option<&LogLightCurves> {
        self.fitted.as_ref().or(self.nominal.as_ref()).map(|one| &one.light)
    }
}

/// The result of a diagnosis.
#[derive(Clone, Debug)]
pub struct Diagnosis {
    /// The report.
    pub report: Report,
    /// The description with the findings applied; `None` without findings.
    pub fitted: Option<Sensor>,
    /// Findings of the direct tests.
    pub integrity: Integrity,
    /// The decision on a scene, or the reason for abstaining.
    pub proposed: DecisionOutcome,
    /// Ids of effects that were withdrawn, as held-out frames are predicted worse with them.
    pub withdrawn: Vec<String>,
    /// Held-out frames.
    pub predictions: HeldOutPredictions,
    /// The pixels of the predictions.
    pub sample: Option<PixelSample>,
    /// Where effects of the report are, by id; those that were measured.
    pub located: Vec<(String, LocatedEffect)>,
}

/// Findings of the direct tests, without what the description states already.
///
/// # Errors
/// When the description does not state what the model needs, or its effects are not understood.
pub fn check(case: &Case) -> Result<Integrity, NodeError> {
    let nominal = case.nominal()?;
    let mut integrity = integrity(case, Some(&nominal));
    // What the description states is no departure from it, and what it leaves open is estimated.
    let is_departure = |id: &str| !case.sensor.effects.contains_key(id) && !is_left_open(&case.sensor, id);
    integrity.findings.retain(|finding| is_departure(finding.id));
    Ok(integrity)
}

/// The recording with the direct tests' findings in its description and without the pixels that they exclude.
/// The scene is estimated from the rest.
///
/// # Errors
/// When the description does not state what the model needs, or its effects are not understood.
pub fn amend_case(case: &Case, integrity: &Integrity) -> Result<Case, NodeError> {
    let nominal = case.nominal()?;
    Ok(apply_direct_findings(case, &nominal, &EffectScales::from_case(case, &nominal), integrity))
}

/// Joins direct tests and the decision on a scene into verdict, fitted description, held-out check and
/// report.
///
/// # Errors
/// When the description does not state what the model needs, or its effects are not understood.
pub fn confirm(
    case: &Case,
    setting: &ConfirmSetting,
    mut integrity: Integrity,
    proposed: DecisionOutcome,
) -> Result<Diagnosis, NodeError> {
    let estimated = proposed.decided().map_or(&[][..], |decided| &decided.estimated);
    let stated = &case.sensor;
    let settled = Case { sensor: with_estimates(stated, estimated), ..case.clone() };
    let case = &settled;
    let nominal = case.nominal()?;
    let scales = EffectScales::from_case(case, &nominal);
    let can_compare = can_compare(case, &integrity);
    let sample = (can_compare && setting.proof)
        .then(|| PixelSample::for_held_out_frames(case))
        .filter(|sample| !sample.is_empty());
    let limits = proposed.decided().map_or(&[][..], |decided| &decided.detectability);
    let no_effect_shows = nothing_would_show(limits);
    if proposed.decided().is_none() || no_effect_shows.is_some() {
        add_confirmed_proposals(case, &nominal, setting.least_better_db, &setting.solve, &mut integrity)?;
    }
    let mut answer = verdict(case, &nominal, &integrity, proposed.decided());
    let with = |findings: &[Finding]| {
        let found = description(case, &nominal, &scales, findings);
        found.or_else(|| (case.sensor != *stated).then(|| case.sensor.clone()))
    };
    let with_curve = |unexplained: Option<&Unexplained>| {
        let curve = unexplained.and_then(|found| found.dependence.as_ref()).filter(|of| of.is_with_scene)?;
        let effects = curve.apply_to_effects(&case.sensor.effects, case.span.0)?;
        Some(Sensor { effects, ..case.sensor.clone() })
    };
    let predicted = |sensor: &Sensor| {
        sample.as_ref().map_or(Ok(None), |sample| predict(case, sensor, sample, &setting.solve))
    };
    let before = predicted(stated)?;
    let after = |findings: &[Finding]| -> Result<Option<HeldOutScore>, NodeError> {
        Ok(with(findings).as_ref().map(&predicted).transpose()?.flatten())
    };
    let is_worse = |after: &Option<HeldOutScore>| {
        before
            .as_ref()
            .zip(after.as_ref())
            .is_some_and(|(before, after)| after.psnr_db() < before.psnr_db() - setting.most_worse_db)
    };
    let stated_db = before.as_ref().map(HeldOutScore::psnr_db);
    let better_db = (stated_db, setting.least_better_db);
    answer = by_frames(case, (&nominal, &scales), proposed.decided(), answer, better_db, after)?;
    let (findings, fitted, withdrawn) = confirmed_findings(&answer.findings, after, is_worse)?;
    if !withdrawn.is_empty() {
        answer.set(findings);
    }
    if let Some(lacking) = undecided(case, &answer, &proposed, can_compare, no_effect_shows) {
        answer.verdict = Verdict::Insufficient;
        integrity.lacking.extend(lacking);
    }
    let mut changed = with(&answer.findings);
    let mut fitted = fitted;
    // What has no name is put in as its curve, if that was estimated with the scene, unless frames that were
    // held out are predicted worse with it.
    if let Some(sensor) = with_curve(answer.unexplained.as_ref()) {
        let after = predicted(&sensor)?;
        if !is_worse(&after) {
            (changed, fitted) = (Some(sensor), after);
        }
    }
    let predictions = HeldOutPredictions { nominal: before, fitted };
    let curve = with_curve(answer.unexplained.as_ref());
    let light = predictions.light().zip(sample.as_ref()).map(|(light, sample)| (sample, light));
    let describe = |findings: &[Finding]| description(case, &nominal, &scales, findings);
    let separate = |pair: &ExplanationPair<'_>| {
        light.map_or(Ok(None), |light| separation(case, light, pair, setting.seed))
    };
    let apart = two_best(case, &nominal, (proposed.decided(), &answer), describe, curve, separate)?;
    let found =
        ReportInputs { integrity: &integrity, proposed: &proposed, answer: &answer, apart: apart.as_ref() };
    let report = report(case, setting, &found, changed.as_ref(), &predictions);
    let located = locations_of_findings(proposed.decided(), &answer);
    Ok(Diagnosis { located, report, fitted: changed, integrity, proposed, withdrawn, predictions, sample })
}

/// Reason why the absence of findings is inconclusive: a test that could not be made, or one without power.
/// `None` where it is conclusive. `integrity` lists missing data itself.
fn undecided(
    case: &Case,
    answer: &JoinedFindings,
    proposed: &DecisionOutcome,
    can_compare: bool,
    no_effect_shows: Option<String>,
) -> Option<Vec<String>> {
    if answer.verdict != Verdict::Consistent {
        return None;
    }
    match proposed {
        DecisionOutcome::Nothing(why) if unstated::without_scene(&case.sensor).is_some() => {
            Some(vec![format!("no direct test contradicts the description, and {why}")])
        }
        DecisionOutcome::Nothing(why) => Some(vec![why.clone()]),
        _ if !can_compare => Some(Vec::new()),
        _ => no_effect_shows.map(|why| vec![why]),
    }
}

/// The description with findings applied; `None` where no finding has a searchable parameter.
fn description(
    case: &Case,
    nominal: &Nominal,
    scales: &EffectScales,
    findings: &[Finding],
) -> Option<Sensor> {
    let found: Vec<(&str, &[NamedNumber])> =
        findings.iter().map(|finding| (&finding.id[..], &finding.values[..])).collect();
    let is_sought = |(id, numbers): &(&str, &[NamedNumber])| {
        numbers.iter().any(|(name, _)| Candidate::find(id, name).is_some())
    };
    found.iter().any(is_sought).then(|| fitted(&case.sensor, nominal, scales, &found))
}

/// Findings that are kept, the held-out score with them, and ids of the withdrawn ones.
type ConfirmedFindings = (Vec<Finding>, Option<HeldOutScore>, Vec<String>);

/// Findings without those that make held-out predictions worse. `after` computes the held-out score with
/// findings.
fn confirmed_findings(
    findings: &[Finding],
    after: impl Fn(&[Finding]) -> Result<Option<HeldOutScore>, NodeError>,
    is_worse: impl Fn(&Option<HeldOutScore>) -> bool,
) -> Result<ConfirmedFindings, NodeError> {
    let (mut kept, mut predicted) = (findings.to_vec(), after(&systematic(findings))?);
    if is_worse(&predicted) {
        let fewer = leave_one_out(findings);
        for (n, left) in fewer.iter().enumerate() {
            predicted = after(&systematic(left))?;
            if n + 1 == fewer.len() || !is_worse(&predicted) {
                kept.clone_from(left);
                break;
            }
        }
    }
    if kept.iter().any(|one| is_random(&one.id)) {
        predicted = after(&kept)?;
    }
    let is_left = |one: &&Finding| kept.iter().all(|left| left.id != one.id);
    let withdrawn = findings.iter().filter(is_left).map(|one| one.id.clone()).collect();
    Ok((kept, predicted, withdrawn))
}

/// Findings of what is not random.
fn systematic(findings: &[Finding]) -> Vec<Finding> {
    findings.iter().filter(|one| !is_random(&one.id)).cloned().collect()
}

/// Subsets of the findings: each without one finding of the scene, the weakest first, and finally without all
/// of them. Direct and random findings stay.
fn leave_one_out(findings: &[Finding]) -> Vec<Vec<Finding>> {
    let is_judged = |one: &&Finding| !one.is_direct() && !is_random(&one.id);
    let estimated: Vec<&str> = findings.iter().filter(is_judged).map(|finding| &finding.id[..]).collect();
    let without = |ids: &[&str]| {
        findings.iter().filter(|one| !ids.contains(&&one.id[..])).cloned().collect::<Vec<Finding>>()
    };
    let one_less = estimated.iter().rev().filter(|_| estimated.len() > 1).map(|id| without(&[*id]));
    one_less.chain([without(&estimated)]).collect()
}

/// Inputs of a report.
struct ReportInputs<'a> {
    integrity: &'a Integrity,
    proposed: &'a DecisionOutcome,
    answer: &'a JoinedFindings,
    /// What separates the two best explanations.
    apart: Option<&'a SeparatedExplanations>,
}

fn report(
    case: &Case,
    setting: &ConfirmSetting,
    found: &ReportInputs<'_>,
    changed: Option<&Sensor>,
    predictions: &HeldOutPredictions,
) -> Report {
    let ReportInputs { integrity, proposed, answer, apart } = *found;
    let unnamed =
        answer.unexplained.iter().map(|found| Finding::from_unexplained(case, found, proposed.decided()));
    let effects: Vec<Finding> = answer.findings.iter().cloned().chain(unnamed).collect();
    let psnr = predictions
        .nominal
        .as_ref()
        .zip(predictions.fitted.as_ref())
        .map(|(before, after)| BeforeAfter { before: before.psnr_db(), after: after.psnr_db() });
    let decided = proposed.decided();
    let gained: f64 = effects
        .iter()
        .filter(|finding| !finding.is_direct())
        .filter_map(|finding| finding.evidence.heldout_nats_per_event)
        .sum();
    let nats = decided
        .and_then(|decided| decided.nats_per_event)
        .filter(|_| gained > 0.0)
        .map(|before| BeforeAfter { before, after: before + gained });
    // A second effect is fitted on top of the first, so the last one describes both.
    let left = answer.findings.iter().rev().find_map(|finding| finding.ks);
    let calibration_ks =
        decided.and_then(|decided| decided.ks).zip(left).map(|(before, after)| BeforeAfter { before, after });
    let is_found = |id: &str| answer.findings.iter().any(|finding| finding.id == id);
    let limits = decided.map_or(&[][..], |decided| &decided.detectability);
    let detectability: Vec<MinimumDetectable> =
        limits.iter().filter(|one| !is_found(&one.id)).cloned().collect();
    Report {
        schema: SCHEMA.to_owned(),
        verdict: answer.verdict,
        summary: summary(case, integrity, answer, decided, &detectability),
        not_testable: not_testable(case, proposed, &answer.findings),
        next_experiment: next_experiments(case, answer, integrity, &detectability, apart),
        residual_left: decided
            .and_then(|decided| decided.residual_left)
            .filter(|_| answer.findings.iter().any(|finding| !finding.is_direct())),
        effects,
        fit: DescriptionFit { heldout_nats_per_event: nats, heldout_frame_psnr_db: psnr, calibration_ks },
        detectability,
        scene: integrity.scene.clone(),
        estimated: decided.map_or_else(Vec::new, |decided| decided.estimated.clone()),
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

/// The report of unreadable data, which violate the format or are inconsistent. `why` is the reason, in
/// words.
pub fn unreadable_report(why: &str, seed: u64) -> Report {
    Report {
        schema: SCHEMA.to_owned(),
        verdict: Verdict::BrokenData,
        summary: why.to_owned(),
        effects: Vec::new(),
        fit: DescriptionFit::default(),
        detectability: Vec::new(),
        scene: Vec::new(),
        estimated: Vec::new(),
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

/// Sentence about a dependence that no effect of the catalogue explains.
fn without_a_name(found: Option<&Unexplained>) -> String {
    let mut text =
        "the recording differs from the description, and no effect of the catalogue explains how".to_owned();
    let Some(found) = found else { return text };
    text += &format!("; it depends on {}", found.covariate);
    if !found.also_possible.is_empty() {
        text += &format!(" ({} would do about as well)", found.also_possible.join(", "));
    }
    text
}

fn summary(
    case: &Case,
    integrity: &Integrity,
    answer: &JoinedFindings,
    decided: Option<&SceneDecision>,
    limits: &[MinimumDetectable],
) -> String {
    let name = |finding: &Finding| {
        let others: String = finding.also_possible.iter().map(|id| format!(" or {id}")).collect();
        format!("{}{others}", finding.id)
    };
    let text = match answer.verdict {
        Verdict::BrokenData => return integrity.broken.join("; "),
        Verdict::Insufficient => return integrity.lacking.join("; "),
        Verdict::Consistent => agrees(limits),
        Verdict::Unnamed => without_a_name(answer.unexplained.as_ref()),
        Verdict::Numerical => "what differs is an error of our own".into(),
        Verdict::Named | Verdict::Ambiguous => {
            answer.findings.iter().map(name).collect::<Vec<_>>().join(", and ")
        }
    };
    let Some(decided) = decided else {
        let left_out = unstated::without_scene(&case.sensor).filter(|_| is_enough(case));
        return left_out.map_or(text.clone(), |why| format!("{text}; {why}"));
    };
    let near = near_threshold_note(decided, answer);
    let near = if near.is_empty() {
        near
    } else {
        format!("; near the detection threshold, and not reported: {near}")
    };
    format!("{text} ({}){near}{}", evaluated_part(decided), estimated(&decided.estimated))
}

/// Sentence for no findings, with the minimum detectable effects.
fn agrees(limits: &[MinimumDetectable]) -> String {
    let text = "the recording agrees with the description as far as these tests see";
    let (seen, unseen) = seen_and_unseen(limits);
    match seen.len() + unseen.len() {
        0 => format!("{text}; detectability says how far that is"),
        all => format!(
            "{text}: {} of {all} effects would be seen at their usual size (detectability)",
            seen.len()
        ),
    }
}

/// Estimated parameters of the description, as the end of a sentence.
fn estimated(all: &[SceneEstimate]) -> String {
    let one = |one: &SceneEstimate| {
        let [value, low, high] =
            [one.estimate, one.ci95[0], one.ci95[1]].map(|value| readable(value, &one.unit));
        format!("{} {value} ({low} to {high})", one.field)
    };
    let all: Vec<String> = all.iter().map(one).collect();
    if all.is_empty() { String::new() } else { format!("; estimated with the scene: {}", all.join(", ")) }
}

/// A test is reported as near its detection threshold from this share of it on.
const NEARLY: f64 = 0.5;

/// Unreported effects near their detection threshold on the scene, with their share of it.
fn near_threshold_note(decided: &SceneDecision, answer: &JoinedFindings) -> String {
    let is_reported = |id: &str| {
        let mut reported = answer.findings.iter().flat_map(|one| one.also_possible.iter().chain([&one.id]));
        reported.any(|reported| reported == id)
    };
    let share = |one: &EffectProposal| one.score * one.probability;
    let near =
        decided.proposals.iter().filter(|one| (NEARLY..1.0).contains(&share(one)) && !is_reported(one.id()));
    near.map(|one| format!("{} ({:.0} % of it)", CANDIDATES[one.candidate].label(), 100.0 * share(one)))
        .collect::<Vec<_>>()
        .join(", ")
}

/// Which events were held against which scene.
fn evaluated_part(decided: &SceneDecision) -> String {
    let scene = match decided.name.as_str() {
        "given" => "on known light",
        "patches" => "on a scene in parts",
        "joint" => "on a moving picture of frames and events",
        "pixels" => "on the light of each pixel, free in time",
        _ => "on a moving picture",
    };
    let when = decided.span_ns.map_or_else(String::new, |(from, to)| {
        format!(" from {:.2} to {:.2} s", from as f64 * 1e-9, to as f64 * 1e-9)
    });
    let place = decided.part.map_or_else(String::new, |Block { x, y, width, height }| {
        format!(" in columns {x} to {} and rows {y} to {}", x + width - 1, y + height - 1)
    });
    let other = Some(&decided.other_scene).filter(|other| !other.is_empty());
    let other = other.map_or_else(String::new, |other| format!("; {other}"));
    format!("{scene}, {:.0} % of the events{when}{place}{other}", 100.0 * decided.share)
}

/// Effects that were not testable.
fn not_testable(case: &Case, proposed: &DecisionOutcome, findings: &[Finding]) -> Vec<NotTestable> {
    let why = match proposed {
        DecisionOutcome::Decided(_) => return Vec::new(),
        _ if case.frame_count() < FEWEST_FRAMES => {
            "it needs events and frames of the same scene, and there are not enough frames"
        }
        _ if case.events.len() < FEWEST_EVENTS => {
            "it needs events and frames of the same scene, and there are not enough events"
        }
        DecisionOutcome::Nothing(why) => why,
        DecisionOutcome::NotAsked => "it needs the scene, and no test that estimates the scene took part",
    };
    let is_tested = |id: &str| {
        TESTED.contains(&id) && case.events.len() >= FEWEST_EVENTS
            || findings.iter().any(|finding| finding.id == id)
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
            .of_pixel(pixel)
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
