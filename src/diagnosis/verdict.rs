//! Joins direct tests and the decision on a scene into one list of findings.
//!
//! A direct test needs no scene, so its finding counts. The scene is then evaluated with that finding in the
//! description, and adds the rest. Where no scene gives evidence, direct tests alone decide.
//!
//! An effect is reported only where it is material ([`Candidate::is_material`]), not only significant: in a
//! million events a microsecond is a hundred standard deviations.

use crate::candidates::{CANDIDATES, Candidate};
use crate::finding::UNNAMED;
use crate::integrity::episodes::Failure;
use crate::integrity::{Departure, Integrity, data, regular};
use crate::report::{Finding, Verdict};
use crate::residual::located::LocatedEffect;
use crate::stages::{EffectProposal, SceneDecision, Unexplained};
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use photocurrent_sensor::effects::catalogue;

/// Verdict and findings of a diagnosis.
#[derive(Clone, Debug, PartialEq)]
pub struct JoinedFindings {
    /// The verdict.
    pub verdict: Verdict,
    /// Strongest first.
    pub findings: Vec<Finding>,
    /// The dependence that no candidate explains.
    pub unexplained: Option<Unexplained>,
}

impl JoinedFindings {
    /// Replaces the findings and updates the verdict.
    pub fn set(&mut self, findings: Vec<Finding>) {
        self.verdict = match (&findings[..], &self.unexplained) {
            ([], Some(_)) => Verdict::Unnamed,
            ([], None) => Verdict::Consistent,
            (found, _) if found.iter().all(|one| one.id == UNNAMED) => Verdict::Unnamed,
            (found, _) if found.iter().any(|one| !one.also_possible.is_empty()) => Verdict::Ambiguous,
            _ => Verdict::Named,
        };
        self.findings = findings;
    }
}

/// An effect with this share of the best one's probability is reported with it.
pub const IN_SET_SHARE: f64 = 0.25;
/// The largest set.
const LARGEST_SET: usize = 3;

/// Joins the findings of direct tests and the decision on a scene.
pub fn verdict(
    case: &Case,
    nominal: &Nominal,
    integrity: &Integrity,
    decided: Option<&SceneDecision>,
) -> JoinedFindings {
    if !integrity.broken.is_empty() {
        return JoinedFindings { verdict: Verdict::BrokenData, findings: Vec::new(), unexplained: None };
    }
    let departures = integrity.findings.iter().filter(|departure| is_large_enough(case, nominal, departure));
    let mut findings: Vec<Finding> =
        departures.map(|departure| Finding::from_departure(case, nominal, departure)).collect();
    let failures = integrity.episodes.iter().filter(|episode| episode.failure != Failure::Rhythm);
    findings.extend(failures.map(|episode| Finding::from_episode(case, episode)));
    let left = decided.map(|decided| exclude_known(case, nominal, decided, &findings));
    // What shows without a scene comes first.
    let shown = integrity
        .dependences
        .first()
        .map(|dependence| Unexplained::from_dependence(dependence, regular::score(dependence)));
    let on_scene = left.as_ref().and_then(|decided| decided.unexplained.clone());
    let unexplained = match (shown, on_scene) {
        // The same, measured where its size and what it moves show.
        (Some(shown), Some(seen)) if shown.covariate == seen.covariate => Some(seen),
        (shown, seen) => shown.or(seen),
    };
    // No name is forced on what explains more than any effect does.
    if let Some(left) = left.filter(|_| !findings.is_empty() || unexplained.is_none()) {
        findings.extend(findings_of_scene(case, nominal, &left));
    }
    for finding in &mut findings {
        located(decided, finding).into_iter().for_each(|located| located.copy_to(&mut finding.location));
    }
    findings.sort_by(|a, b| b.evidence.statistic.total_cmp(&a.evidence.statistic));
    let mut answer = JoinedFindings { verdict: Verdict::Consistent, findings: Vec::new(), unexplained };
    answer.set(findings);
    if answer.verdict == Verdict::Consistent && case.events.len() < data::FEWEST_EVENTS {
        answer.verdict = Verdict::Insufficient;
    }
    answer.unexplained = answer.unexplained.filter(|_| answer.verdict == Verdict::Unnamed);
    answer
}

/// Findings of a decision: an effect, and a second one.
fn findings_of_scene(case: &Case, nominal: &Nominal, decided: &SceneDecision) -> Vec<Finding> {
    let found = |one: &EffectProposal, proposals: &[EffectProposal]| {
        let also_possible = alternatives(one, proposals).into_iter().map(str::to_owned).collect();
        Finding { also_possible, ..Finding::from_proposal(case, nominal, &decided.name, one) }
    };
    let Some(one) = best(&decided.proposals) else { return Vec::new() };
    let mut first = found(one, &decided.proposals);
    if decided.is_unnamed_near {
        first.also_possible.push(UNNAMED.to_owned());
    }
    // It was fitted with the first one applied: what looks alike is distinguished there.
    let apart = |one: &&EffectProposal| first.also_possible.iter().all(|other| other != one.id());
    let rest: Vec<EffectProposal> = decided.second.iter().filter(apart).cloned().collect();
    match best(&rest) {
        // Another number of the same effect.
        Some(second) if second.id() == first.id => {
            first.add_parameter(
                &CANDIDATES[second.candidate],
                second.value,
                second.ci95,
                &case.sensor,
                nominal,
            );
            vec![first]
        }
        Some(second) => {
            let mut second = found(second, &rest);
            second.evidence.statistic = second.evidence.statistic.min(first.evidence.statistic);
            vec![first, second]
        }
        None => vec![first],
    }
}

/// The most probable of the proposals that passed.
fn best(proposals: &[EffectProposal]) -> Option<&EffectProposal> {
    let passed = proposals.iter().filter(|one| one.passed);
    passed.max_by(|a, b| a.probability.total_cmp(&b.probability).then(b.candidate.cmp(&a.candidate)))
}

/// Effects that are nearly as probable as one, most first, whether they passed or not.
fn alternatives(one: &EffectProposal, proposals: &[EffectProposal]) -> Vec<&'static str> {
    let mut near: Vec<&EffectProposal> =
        proposals.iter().filter(|other| other.probability > IN_SET_SHARE * one.probability).collect();
    near.sort_by(|a, b| b.probability.total_cmp(&a.probability).then(a.candidate.cmp(&b.candidate)));
    let mut ids = vec![one.id()];
    near.iter().map(|other| other.id()).for_each(|id| {
        if !ids.contains(&id) {
            ids.push(id);
        }
    });
    ids.truncate(LARGEST_SET);
    ids.split_off(1)
}

/// Is a parameter of a departure material, or does it have none that is searchable? Counted events are
/// certain however few they are; limits apply to fitted parameters.
fn is_large_enough(case: &Case, nominal: &Nominal, departure: &Departure) -> bool {
    let sought = departure.parameters.iter().filter_map(|(name, value)| {
        let candidate = Candidate::find(departure.id, name)?;
        Some(candidate.sought.is_counted || candidate.is_material(case, nominal, *value))
    });
    let mut sought = sought.peekable();
    sought.peek().is_none() || sought.any(|is_material| is_material)
}

/// Where a finding is, as it was measured on the scene; none for direct tests.
fn located<'a>(decided: Option<&'a SceneDecision>, finding: &Finding) -> Option<&'a LocatedEffect> {
    let decided = decided.filter(|_| !finding.is_direct())?;
    let candidate = Candidate::number(&finding.id, finding.values.first()?.0)?;
    // The best of the first list is the first effect; another one was measured with it applied.
    let passed = decided.proposals.iter().filter(|one| one.passed);
    let best = passed.max_by(|a, b| a.probability.total_cmp(&b.probability));
    let is_first = best.is_some_and(|best| best.id() == finding.id);
    decided
        .located
        .for_effect(candidate, !is_first)
        .or_else(|| decided.located.for_effect(candidate, is_first))
}

/// Locations of the reported effects, by id.
pub fn locations_of_findings(
    decided: Option<&SceneDecision>,
    answer: &JoinedFindings,
) -> Vec<(String, LocatedEffect)> {
    let named = answer
        .findings
        .iter()
        .filter_map(|finding| Some((finding.id.clone(), located(decided, finding)?.clone())));
    let nameless = answer
        .unexplained
        .iter()
        .filter_map(|found| Some(("unnamed".to_owned(), found.located(decided)?.clone())));
    named.chain(nameless).collect()
}

/// The decision without effects that are known already or resemble a known one, and without immaterial ones.
fn exclude_known(
    case: &Case,
    nominal: &Nominal,
    decided: &SceneDecision,
    known: &[Finding],
) -> SceneDecision {
    let left = |proposals: &[EffectProposal]| -> Vec<EffectProposal> {
        let is_new = |proposal: &&EffectProposal| {
            let candidate = &CANDIDATES[proposal.candidate];
            !known.iter().any(|known| looks_like(&known.id, candidate))
                && candidate.is_material(case, nominal, proposal.value)
        };
        proposals.iter().filter(is_new).cloned().collect()
    };
    SceneDecision { proposals: left(&decided.proposals), second: left(&decided.second), ..decided.clone() }
}

/// Is a candidate the known effect, or confusable with it by the catalogue? The remainder of a direct
/// estimate resembles its effect.
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

#[cfg(test)]
#[path = "verdict_tests.rs"]
mod tests;
