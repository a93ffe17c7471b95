//! One answer from the direct tests and from what was decided on a scene.
//!
//! A direct test that finds something counts: it needs no scene. It does not end the search: the scene is
//! looked at with what it found in the description, and reports the rest. Where no scene is evidence, direct
//! tests answer alone.
//!
//! An effect is named only when it matters ([`Candidate::is_material`]), not only when it is certain: in a
//! million events a microsecond is a hundred standard deviations.

use crate::candidates::{CANDIDATES, Candidate};
use crate::finding::UNNAMED;
use crate::integrity::episodes::Failure;
use crate::integrity::{Departure, Integrity, data, regular};
use crate::report::{Finding, Verdict};
use crate::residual::located::Located;
use crate::stages::{Decided, Proposal, Unexplained};
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use photocurrent_sensor::effects::catalogue;

/// The answer.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// In a word.
    pub verdict: Verdict,
    /// Strongest first.
    pub findings: Vec<Finding>,
    /// What no candidate explains.
    pub unexplained: Option<Unexplained>,
}

impl Answer {
    /// Has these findings only.
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

/// Joins what direct tests found and what was decided.
pub fn verdict(case: &Case, nominal: &Nominal, integrity: &Integrity, decided: Option<&Decided>) -> Answer {
    if !integrity.broken.is_empty() {
        return Answer { verdict: Verdict::BrokenData, findings: Vec::new(), unexplained: None };
    }
    let departures = integrity.findings.iter().filter(|departure| matters(case, nominal, departure));
    let mut findings: Vec<Finding> =
        departures.map(|departure| Finding::of_departure(case, nominal, departure)).collect();
    let failures = integrity.episodes.iter().filter(|episode| episode.failure != Failure::Rhythm);
    findings.extend(failures.map(|episode| Finding::of_episode(case, episode)));
    let left = decided.map(|decided| without(case, nominal, decided, &findings));
    // What shows without a scene comes first.
    let shown = integrity
        .dependences
        .first()
        .map(|dependence| Unexplained::by(dependence, regular::score(dependence)));
    let on_scene = left.as_ref().and_then(|decided| decided.unexplained.clone());
    let unexplained = match (shown, on_scene) {
        // The same, measured where its size and what it moves show.
        (Some(shown), Some(seen)) if shown.covariate == seen.covariate => Some(seen),
        (shown, seen) => shown.or(seen),
    };
    // No name is forced on what explains more than any effect does.
    if let Some(left) = left.filter(|_| !findings.is_empty() || unexplained.is_none()) {
        findings.extend(of_scene(case, nominal, &left));
    }
    for finding in &mut findings {
        located(decided, finding).into_iter().for_each(|located| located.put(&mut finding.location));
    }
    findings.sort_by(|a, b| b.evidence.statistic.total_cmp(&a.evidence.statistic));
    let mut answer = Answer { verdict: Verdict::Consistent, findings: Vec::new(), unexplained };
    answer.set(findings);
    if answer.verdict == Verdict::Consistent && case.events.len() < data::FEWEST_EVENTS {
        answer.verdict = Verdict::Insufficient;
    }
    answer.unexplained = answer.unexplained.filter(|_| answer.verdict == Verdict::Unnamed);
    answer
}

/// Findings of what was decided: an effect, and a second one.
fn of_scene(case: &Case, nominal: &Nominal, decided: &Decided) -> Vec<Finding> {
    let found = |one: &Proposal, proposals: &[Proposal]| {
        let also_possible = alternatives(one, proposals).into_iter().map(str::to_owned).collect();
        Finding { also_possible, ..Finding::of_proposal(case, nominal, &decided.name, one) }
    };
    let Some(one) = best(&decided.proposals) else { return Vec::new() };
    let mut first = found(one, &decided.proposals);
    if decided.is_unnamed_near {
        first.also_possible.push(UNNAMED.to_owned());
    }
    // It was fitted with the first one applied: what looks alike is distinguished there.
    let apart = |one: &&Proposal| first.also_possible.iter().all(|other| other != one.id());
    let rest: Vec<Proposal> = decided.second.iter().filter(apart).cloned().collect();
    match best(&rest) {
        // Another number of the same effect.
        Some(second) if second.id() == first.id => {
            first.put(&CANDIDATES[second.candidate], second.value, second.ci95, &case.sensor, nominal);
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
fn best(proposals: &[Proposal]) -> Option<&Proposal> {
    let passed = proposals.iter().filter(|one| one.passed);
    passed.max_by(|a, b| a.probability.total_cmp(&b.probability).then(b.candidate.cmp(&a.candidate)))
}

/// Effects that are nearly as probable as one, most first, whether they passed or not.
fn alternatives(one: &Proposal, proposals: &[Proposal]) -> Vec<&'static str> {
    let mut near: Vec<&Proposal> =
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

/// Is a number of a departure worth a finding, or has it none that is sought? Events that are counted are
/// certain however few they are; the limits are for what is fitted.
fn matters(case: &Case, nominal: &Nominal, departure: &Departure) -> bool {
    let sought = departure.parameters.iter().filter_map(|(name, value)| {
        let candidate = Candidate::find(departure.id, name)?;
        Some(candidate.sought.is_counted || candidate.is_material(case, nominal, *value))
    });
    let mut sought = sought.peekable();
    sought.peek().is_none() || sought.any(|is_material| is_material)
}

/// Where a finding is, as it was measured on the scene; none for direct tests.
fn located<'a>(decided: Option<&'a Decided>, finding: &Finding) -> Option<&'a Located> {
    let decided = decided.filter(|_| !finding.is_direct())?;
    let candidate = Candidate::number(&finding.id, finding.values.first()?.0)?;
    // The best of the first list is the first effect; another one was measured with it applied.
    let passed = decided.proposals.iter().filter(|one| one.passed);
    let best = passed.max_by(|a, b| a.probability.total_cmp(&b.probability));
    let is_first = best.is_some_and(|best| best.id() == finding.id);
    decided.located.of(candidate, !is_first).or_else(|| decided.located.of(candidate, is_first))
}

/// Where the effects of an answer are, by id.
pub fn answered(decided: Option<&Decided>, answer: &Answer) -> Vec<(String, Located)> {
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

/// What was decided, less what is known already or looks like it, and what does not matter.
fn without(case: &Case, nominal: &Nominal, decided: &Decided, known: &[Finding]) -> Decided {
    let left = |proposals: &[Proposal]| -> Vec<Proposal> {
        let is_new = |proposal: &&Proposal| {
            let candidate = &CANDIDATES[proposal.candidate];
            !known.iter().any(|known| looks_like(&known.id, candidate))
                && candidate.is_material(case, nominal, proposal.value)
        };
        proposals.iter().filter(is_new).cloned().collect()
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

#[cfg(test)]
#[path = "verdict_tests.rs"]
mod tests;
