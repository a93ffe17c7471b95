//! One answer from the direct tests and from what was decided on a scene.
//!
//! A direct test that finds something counts: it needs no scene. It does not end the search: the scene is
//! looked at with what it found in the description, and reports the rest. Where no scene is evidence, direct
//! tests answer alone.
//!
//! An effect is named only when it matters ([`is_material`]), not only when it is certain: in a million
//! events a microsecond is a hundred standard deviations.

use crate::candidates::{CANDIDATES, Candidate, Scales, Signs};
use crate::dependence::Dependence;
use crate::integrity::regular;
use crate::integrity::{Finding, Integrity};
use crate::report::{Detectable, Verdict};
use crate::residual::located::{Located, Locations};
use crate::unstated::alike;
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use photocurrent_sensor::effects::catalogue;
use photocurrent_sensor::effects::sought::Measure;
use serde::{Deserialize, Serialize};

/// What is thought of one candidate.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Proposal {
    /// Index into [`CANDIDATES`].
    pub candidate: usize,
    /// How far over the probability from which something is said: 1 = just.
    pub score: f64,
    /// Its probability given that there is something, 0 to 1.
    pub probability: f64,
    /// The parameter, in the unit of its declaration.
    pub value: f64,
    /// Its 95 % interval.
    pub ci95: Option<[f64; 2]>,
    /// Is enough said for it?
    pub passed: bool,
    /// Gain in log-likelihood on held-out events beyond the control's, nats.
    pub heldout_nats: Option<f64>,
    /// Its 95 % interval, from block to block.
    pub heldout_nats_ci95: Option<[f64; 2]>,
    /// The same per event.
    pub heldout_nats_per_event: Option<f64>,
    /// Distance of what it leaves from the noise that the described sensor has on this scene (Kolmogorov and
    /// Smirnov).
    pub ks: Option<f64>,
}

/// Something that no effect of the catalogue explains.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Unexplained {
    /// What it depends on, by the names of docs/formats.md.
    pub covariate: String,
    /// How, as an equation or in words.
    pub equation: String,
    /// Where in the chain.
    pub insertion: String,
    /// How far over what counts.
    pub score: f64,
    /// Held-out gain in log-likelihood, nats an event.
    pub nats: f64,
    /// As it was measured.
    pub dependence: Option<Dependence>,
}

impl Unexplained {
    /// By a curve, `score` over the least that counts.
    pub fn by(dependence: &Dependence, score: f64) -> Unexplained {
        Unexplained {
            covariate: dependence.covariate.name().to_owned(),
            equation: dependence.equation(),
            insertion: dependence.moved.insertion().to_owned(),
            score,
            nats: dependence.nats_per_event,
            dependence: Some(dependence.clone()),
        }
    }
}

/// What is decided on one scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Decided {
    /// The scene: `picture`, `given`, ...
    pub name: String,
    /// Share of the events that lie where the scene predicts frames: the others were not looked at.
    #[serde(default)]
    pub share: f64,
    /// First and last instant that was looked at, ns; none where it is the whole recording.
    #[serde(default)]
    pub span_ns: Option<(i64, i64)>,
    /// Does the recording differ from the description at all?
    pub detected: bool,
    /// For one more effect, best first.
    pub proposals: Vec<Proposal>,
    /// For a second one in addition to the first of `proposals`, best first.
    pub second: Vec<Proposal>,
    /// What explains more than any candidate does, and is none.
    pub unexplained: Option<Unexplained>,
    /// What could have been seen.
    pub detectability: Vec<Detectable>,
    /// Held-out log-likelihood of an event's time with the description, nats (of a density per second).
    pub nats_per_event: Option<f64>,
    /// Distance of what the description leaves from the noise that it has on this scene.
    pub ks: Option<f64>,
    /// Share of the misfit that the first proposal leaves.
    pub residual_left: Option<f64>,
    /// Where its answers are; empty where that was not measured.
    #[serde(default)]
    pub located: Locations,
}

/// A number of an effect with its interval: index into [`CANDIDATES`], value in the unit of the declaration.
pub type Valued = (usize, f64, Option<[f64; 2]>);

/// One effect that is claimed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Claim {
    /// Catalogue id.
    pub id: &'static str,
    /// Others that would do about as well.
    pub also_possible: Vec<&'static str>,
    /// Its numbers.
    pub values: Vec<Valued>,
    /// Over the value from which what found it counts.
    pub score: f64,
    /// Probability that it is this one, given that there is something, 0 to 1; none for direct tests.
    pub posterior: Option<f64>,
    /// Who found it.
    pub found_by: Vec<String>,
    /// Gain in log-likelihood on held-out events, nats.
    pub heldout_nats: Option<f64>,
    /// Its 95 % interval; none for direct tests.
    pub heldout_nats_ci95: Option<[f64; 2]>,
    /// The same per event.
    pub heldout_nats_per_event: Option<f64>,
    /// Distance of what it leaves (of a second effect: what both leave) from the noise of the scene; none for
    /// direct tests.
    pub ks: Option<f64>,
    /// What a direct test saw.
    pub finding: Option<Finding>,
}

/// The answer.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Answer {
    /// In a word.
    pub verdict: Verdict,
    /// Strongest first.
    pub claims: Vec<Claim>,
    /// What no candidate explains.
    pub unexplained: Option<Unexplained>,
}

impl Answer {
    /// Has these claims only.
    pub fn set(&mut self, claims: Vec<Claim>) {
        self.verdict = match (&claims[..], &self.unexplained) {
            ([], Some(_)) => Verdict::Unnamed,
            ([], None) => Verdict::Consistent,
            (claims, _) if claims.iter().any(|claim| !claim.also_possible.is_empty()) => Verdict::Ambiguous,
            _ => Verdict::Named,
        };
        self.claims = claims;
    }
}

/// Direct tests, as one that found something.
pub const DIRECT: &str = "direct";
/// An effect with this share of the best one's probability is reported with it.
pub const IN_SET_SHARE: f64 = 0.25;
/// The largest set.
const LARGEST_SET: usize = 3;

/// Joins what direct tests found and what was decided.
pub fn verdict(case: &Case, nominal: &Nominal, integrity: &Integrity, decided: Option<&Decided>) -> Answer {
    if !integrity.broken.is_empty() {
        return Answer { verdict: Verdict::BrokenData, claims: Vec::new(), unexplained: None };
    }
    let mut claims: Vec<Claim> =
        integrity.findings.iter().filter_map(|finding| direct(case, nominal, finding)).collect();
    let known: Vec<&str> = claims.iter().map(|claim| claim.id).collect();
    let decided = decided.map(|decided| without(case, nominal, decided, &known));
    // What shows without a scene comes first.
    let shown = integrity
        .dependences
        .first()
        .map(|dependence| Unexplained::by(dependence, regular::score(dependence)));
    let unexplained = shown.or_else(|| decided.as_ref().and_then(|decided| decided.unexplained.clone()));
    // No name is forced on what explains more than any effect does.
    if let Some(decided) = decided.filter(|_| !claims.is_empty() || unexplained.is_none()) {
        claims.extend(of_scene(&decided));
    }
    claims.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut answer = Answer { verdict: Verdict::Consistent, claims: Vec::new(), unexplained };
    answer.set(claims);
    if answer.verdict == Verdict::Consistent && case.events.len() < crate::integrity::data::FEWEST_EVENTS {
        answer.verdict = Verdict::Insufficient;
    }
    answer.unexplained = answer.unexplained.filter(|_| answer.verdict == Verdict::Unnamed);
    answer
}

/// The claims of what was decided: an effect, and a second one.
fn of_scene(decided: &Decided) -> Vec<Claim> {
    let Some(mut first) = best(&decided.name, &decided.proposals) else { return Vec::new() };
    // It was fitted with the first one applied: what looks alike is distinguished there.
    let apart = |one: &&Proposal| !first.also_possible.contains(&CANDIDATES[one.candidate].id);
    let rest: Vec<Proposal> = decided.second.iter().filter(apart).cloned().collect();
    match best(&decided.name, &rest) {
        // Another number of the same effect.
        Some(second) if second.id == first.id => {
            first.values.extend(second.values);
            vec![first]
        }
        second => {
            let second = second.map(|second| Claim { score: second.score.min(first.score), ..second });
            std::iter::once(first).chain(second).collect()
        }
    }
}

/// The most probable of the proposals that passed, with those that are not distinguished from it.
fn best(scene: &str, proposals: &[Proposal]) -> Option<Claim> {
    let passed = proposals.iter().filter(|one| one.passed);
    let one =
        passed.max_by(|a, b| a.probability.total_cmp(&b.probability).then(b.candidate.cmp(&a.candidate)))?;
    Some(Claim {
        id: CANDIDATES[one.candidate].id,
        also_possible: alternatives(one, proposals),
        values: vec![(one.candidate, one.value, one.ci95)],
        score: one.score,
        posterior: Some(one.probability),
        found_by: vec![scene.to_owned()],
        heldout_nats: one.heldout_nats,
        heldout_nats_ci95: one.heldout_nats_ci95,
        heldout_nats_per_event: one.heldout_nats_per_event,
        ks: one.ks,
        finding: None,
    })
}

/// Effects that are nearly as probable as one, most first, whether they passed or not.
fn alternatives(one: &Proposal, proposals: &[Proposal]) -> Vec<&'static str> {
    let mut near: Vec<&Proposal> =
        proposals.iter().filter(|other| other.probability > IN_SET_SHARE * one.probability).collect();
    near.sort_by(|a, b| b.probability.total_cmp(&a.probability).then(a.candidate.cmp(&b.candidate)));
    let mut ids = vec![CANDIDATES[one.candidate].id];
    near.iter().map(|other| CANDIDATES[other.candidate].id).for_each(|id| {
        if !ids.contains(&id) {
            ids.push(id);
        }
    });
    ids.truncate(LARGEST_SET);
    ids.split_off(1)
}

fn direct(case: &Case, nominal: &Nominal, finding: &Finding) -> Option<Claim> {
    let values: Vec<Valued> = finding
        .parameters
        .iter()
        .filter_map(|(parameter, value)| {
            Some((
                CANDIDATES.iter().position(|one| one.id == finding.id && one.parameter == *parameter)?,
                *value,
                finding.interval(parameter),
            ))
        })
        .collect();
    // Events that are counted are certain however few they are; the limits are for what is fitted.
    let is_material = |(candidate, value, _): &Valued| {
        CANDIDATES[*candidate].sought.is_counted
            || is_material(case, nominal, &CANDIDATES[*candidate], *value)
    };
    let matters = values.is_empty() || values.iter().any(is_material);
    matters.then(|| Claim {
        id: finding.id,
        also_possible: alike(&case.sensor, finding).map(|(id, _)| id).into_iter().collect(),
        values,
        score: finding.statistic / finding.threshold,
        posterior: None,
        found_by: vec![DIRECT.into()],
        heldout_nats: finding.heldout.map(|heldout| heldout.nats),
        heldout_nats_ci95: None,
        heldout_nats_per_event: finding.heldout.map(|heldout| heldout.per_event()),
        ks: None,
        finding: Some(finding.clone()),
    })
}

/// Where a claim is, as it was measured on the scene; none for direct tests.
pub fn of_claim<'a>(decided: Option<&'a Decided>, claim: &Claim) -> Option<&'a Located> {
    let candidate = claim.values.first().filter(|_| claim.finding.is_none())?.0;
    let decided = decided?;
    // The best of the first list is the first effect; another one was measured with it applied.
    let best = decided
        .proposals
        .iter()
        .filter(|one| one.passed)
        .max_by(|a, b| a.probability.total_cmp(&b.probability));
    let is_first = best.is_some_and(|best| CANDIDATES[best.candidate].id == claim.id);
    decided.located.of(candidate, !is_first).or_else(|| decided.located.of(candidate, is_first))
}

/// Where what has no name is; none where it is not the curve that was located.
pub fn of_unnamed<'a>(decided: Option<&'a Decided>, found: &Unexplained) -> Option<&'a Located> {
    let is_it = |own: &Unexplained| own.dependence.is_some() && own.dependence == found.dependence;
    decided.filter(|decided| decided.unexplained.as_ref().is_some_and(is_it))?.located.unnamed.as_ref()
}

/// Where the effects of an answer are, by id.
pub fn answered(decided: Option<&Decided>, answer: &Answer) -> Vec<(String, Located)> {
    let claimed = answer
        .claims
        .iter()
        .filter_map(|claim| Some((claim.id.to_owned(), of_claim(decided, claim)?.clone())));
    let nameless = answer
        .unexplained
        .iter()
        .filter_map(|found| Some(("unnamed".to_owned(), of_unnamed(decided, found)?.clone())));
    claimed.chain(nameless).collect()
}

/// What was decided, less what is known already or looks like it, and what does not matter.
fn without(case: &Case, nominal: &Nominal, decided: &Decided, known: &[&str]) -> Decided {
    let left = |proposals: &[Proposal]| -> Vec<Proposal> {
        let matters = |proposal: &&Proposal| {
            is_material(case, nominal, &CANDIDATES[proposal.candidate], proposal.value)
        };
        proposals
            .iter()
            .filter(|proposal| !known.iter().any(|known| looks_like(known, &CANDIDATES[proposal.candidate])))
            .filter(matters)
            .cloned()
            .collect()
    };
    Decided { proposals: left(&decided.proposals), second: left(&decided.second), ..decided.clone() }
}

/// Is a candidate an effect, or taken for it (or it for the candidate) by the catalogue's own word? What a
/// direct estimate leaves of its effect looks like that.
fn looks_like(known: &str, candidate: &Candidate) -> bool {
    let confused = |id: &str| {
        catalogue()
            .into_iter()
            .find(|kind| kind.decl.id == id)
            .map_or(&[][..], |kind| kind.decl.confused_with)
    };
    known == candidate.id
        || confused(known).contains(&candidate.id)
        || confused(candidate.id).contains(&known)
}

/// Does a value of a candidate differ from nothing by more than anybody would care about? From which size on,
/// the effect's file says; a switch and a limit always do.
pub fn is_material(case: &Case, nominal: &Nominal, candidate: &Candidate, value: f64) -> bool {
    if candidate.signs == Signs::Switch || candidate.is_limit() {
        return true;
    }
    let measure = |measure: Measure| match measure {
        Measure::Light => typical_light(case, nominal),
        Measure::Signal => typical_dn(case, nominal),
        Measure::Threshold => nominal.pixel.threshold_on,
        Measure::Duration => (case.span.1 - case.span.0) as f64 * 1e-9,
        Measure::StampWidth => case.t_resolution_ns as f64 * 1e-9,
        Measure::Rows => f64::from(case.extent.height),
        other => Scales::of(case, nominal).measure(other, nominal),
    };
    (value - candidate.nominal_value(nominal)).abs() > candidate.sought.material.at(&measure)
}

fn typical_dn(case: &Case, nominal: &Nominal) -> f64 {
    let Some(frames) = &case.frames else { return 0.0 };
    let mut signals: Vec<f64> = frames
        .every(101)
        .filter(|dn| dn.is_finite())
        .map(|dn| f64::from(dn) - nominal.number.black_level)
        .collect();
    photocurrent_scene::statistics::median(&mut signals).max(0.0)
}

fn typical_light(case: &Case, nominal: &Nominal) -> f64 {
    let exposure_s =
        case.frames.as_ref().and_then(|frames| frames.times.nominal_exposure_ns()).unwrap_or(0) as f64 * 1e-9;
    if exposure_s > 0.0 { typical_dn(case, nominal) / (nominal.number.gain * exposure_s) } else { 0.0 }
}

#[cfg(test)]
#[path = "verdict_tests.rs"]
mod tests;
