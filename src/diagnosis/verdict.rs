//! One answer from several independent tests: the direct ones, and any number of roads that estimate the scene.
//!
//! Two roads that give the same name are far more often right than either is alone, so agreement is what a name is believed for. Where they differ and both are sure,
//! the answer is a set. Where one is sure and the other silent, it is named if it is well over its alarm. A direct test that speaks is believed: it needs no scene.
//! But it does not end the search: the roads are run with what it found added to the description, and speak of the rest.
//!
//! An effect is named only when it matters ([`is_material`]), not only when it is certain: in a million events a microsecond is a hundred standard deviations.

use crate::candidates::{CANDIDATES, Candidate};
use crate::case::Case;
use crate::integrity::regular;
use crate::integrity::{Finding, Integrity};
use crate::law::Law;
use crate::nominal::Nominal;
use crate::report::{Detectable, NotTestable, Verdict};
use crate::residual::located::Locations;
use crate::roads::{CLOSURES, REFIT};
use photocurrent_sensor::effects::{Unit, catalogue};
use serde::{Deserialize, Serialize};

/// What a road thinks of one candidate.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Proposal {
    /// Index into [`CANDIDATES`].
    pub candidate: usize,
    /// Its statistic over the one from which this road speaks: 1 = just.
    pub score: f64,
    /// Share of this road's belief among its candidates, 0 to 1.
    pub probability: f64,
    /// The parameter, in the unit of its declaration.
    pub value: f64,
    /// Its 95 % interval.
    pub ci95: Option<[f64; 2]>,
    /// Did it pass every gate of its road?
    pub passed: bool,
    /// Gain in log-likelihood on held-out measurements, nats, and per event.
    pub heldout_nats: Option<f64>,
    /// See there.
    pub heldout_nats_per_event: Option<f64>,
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
    /// What it takes away over the least that counts.
    pub score: f64,
    /// Gain in the log of the likelihood, nats, of a change of closure or of an event: see [`Law::nats_per_change`].
    pub nats: f64,
    /// As it was measured.
    pub law: Option<Law>,
    /// Effects that were tried for it and are believed too little to be its name.
    #[serde(default)]
    pub hardly: Vec<String>,
}

impl Unexplained {
    /// By a curve, `score` over the least that counts.
    pub fn by(law: &Law, score: f64) -> Unexplained {
        Unexplained {
            covariate: law.covariate.name().to_owned(),
            equation: law.equation(),
            insertion: law.moved.insertion().to_owned(),
            score,
            nats: law.nats_per_change,
            law: Some(law.clone()),
            hardly: Vec::new(),
        }
    }
}

/// What one road found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Road {
    /// `likelihood`, `synthesis`.
    pub name: String,
    /// Does the recording differ from the description at all?
    pub alarm: bool,
    /// For one more effect, best first.
    pub proposals: Vec<Proposal>,
    /// For a second one beside the first of `proposals`, best first.
    pub second: Vec<Proposal>,
    /// What all pixels together say to first order, where no proposal passes.
    pub to_first_order: Vec<Proposal>,
    /// The same beside the first of `proposals`.
    pub second_to_first_order: Vec<Proposal>,
    /// What takes away more than any candidate does, and is none.
    pub unexplained: Option<Unexplained>,
    /// Does it decide alone, whatever the others say?
    #[serde(default)]
    pub decides: bool,
    /// Is an error of our own larger than anything that was found?
    pub is_numerical: bool,
    /// What could have been seen.
    pub detectability: Vec<Detectable>,
    /// What could not.
    pub not_testable: Vec<NotTestable>,
    /// Held-out log-likelihood per event with the description, and with the first proposal.
    pub nats_per_event: Option<(f64, f64)>,
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
    /// Over the alarm of what found it.
    pub score: f64,
    /// How far to believe that it is this one, 0 to 1: by the contest ([`crate::contest`]), or the share of the belief of the roads that found it, among the effects that they found
    /// enough for; none for direct tests.
    pub belief: Option<f64>,
    /// Who found it.
    pub found_by: Vec<String>,
    /// Gain on held-out measurements.
    pub heldout_nats: Option<f64>,
    /// The same per event.
    pub heldout_nats_per_event: Option<f64>,
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
    /// The answer with these claims only.
    pub fn keep(&mut self, claims: Vec<Claim>) {
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
/// A road that stands alone while the other is silent must be so far over its alarm: noise of the frames that nobody stated brings one to seven and eight.
const ALONE: f64 = 10.0;
/// A second effect must be so far over it.
const SECOND: f64 = 4.0;
/// A candidate with this share of the best one's support is in the set.
const IN_SET: f64 = 0.5;
/// The least probability that counts as support.
const LEAST: f64 = 0.02;
/// A name needs so many times the least support: then one of two roads gives it a third of its belief where the other gives nothing.
const BELIEVED: f64 = 4.0;
/// Beside a direct finding the refit must be so far over its alarm.
const BESIDE: f64 = 2.0;
/// Refits below this leave half of what differs.
const HALF: f64 = 3.2;
/// An effect with this share of the best one's probability is told with it.
pub const IN_SET_SHARE: f64 = 0.25;
/// What is believed less than this is no name: a quarter of what a contest gives away.
const NO_NAME: f64 = 0.2;
/// The largest set that is told.
const LARGEST_SET: usize = 3;

/// Joins what the tests found.
pub fn verdict(case: &Case, nominal: &Nominal, integrity: &Integrity, roads: &[Road]) -> Answer {
    if !integrity.broken.is_empty() {
        return Answer { verdict: Verdict::BrokenData, claims: Vec::new(), unexplained: None };
    }
    let mut claims: Vec<Claim> = integrity.findings.iter().filter_map(|finding| direct(case, nominal, finding)).collect();
    let known: Vec<&str> = claims.iter().map(|claim| claim.id).collect();
    let speaking: Vec<Road> = roads.iter().map(|road| without(case, nominal, road, &known)).collect();
    if let Some(one) = speaking.iter().find(|road| road.decides) {
        return decided(integrity, one, claims);
    }
    // What shows without an estimate of the scene comes first.
    let shown = integrity.laws.first().map(|law| Unexplained::by(law, regular::score(law)));
    let unexplained = shown.or_else(|| speaking.iter().filter_map(|road| road.unexplained.clone()).find(|found| found.score >= 1.0));
    let is_numerical = speaking.iter().any(|road| road.is_numerical);
    let more = match speaking.iter().position(|road| road.name == REFIT) {
        // No name is forced on what takes away more than any effect does, nor on what is an error of our own.
        _ if claims.is_empty() && (unexplained.is_some() || is_numerical) => Vec::new(),
        Some(at) => {
            let others: Vec<Road> = speaking.iter().enumerate().filter(|(n, _)| *n != at).map(|(_, road)| road.clone()).collect();
            led(&speaking[at], &others, &claims)
        }
        None => side_by_side(&speaking, &claims),
    };
    // Roads of equal standing that differ share their belief among what they tell.
    let is_led = speaking.iter().any(|road| road.name == REFIT);
    let is_hardly_believed = |claim: &Claim| is_led && claim.belief.is_some_and(|belief| belief < NO_NAME);
    // Something is there, and it has no name; a second was looked for beside the first, and goes with it.
    let hardly = more.first().filter(|first| claims.is_empty() && is_hardly_believed(first)).map(nameless);
    claims.extend(more.into_iter().take_while(|claim| !is_hardly_believed(claim)));
    let unexplained = unexplained.or(hardly);
    claims.sort_by(|a, b| b.score.total_cmp(&a.score));
    let verdict = match (&claims[..], &unexplained) {
        ([], _) if is_numerical => Verdict::Numerical,
        ([], Some(_)) => Verdict::Unnamed,
        ([], None) if case.events.all().len() < crate::integrity::data::FEWEST_EVENTS => Verdict::Insufficient,
        ([], None) => Verdict::Consistent,
        (claims, _) if claims.iter().any(|claim| !claim.also_possible.is_empty()) => Verdict::Ambiguous,
        _ => Verdict::Named,
    };
    let unexplained = unexplained.filter(|_| verdict == Verdict::Unnamed);
    Answer { verdict, claims, unexplained }
}

/// The answer where one method decides alone, with what direct tests claim.
fn decided(integrity: &Integrity, method: &Road, mut claims: Vec<Claim>) -> Answer {
    let unexplained = integrity.laws.first().map(|law| Unexplained::by(law, regular::score(law))).or_else(|| method.unexplained.clone());
    let first = if claims.is_empty() && unexplained.is_some() { None } else { measured(&method.name, &method.proposals) };
    if let Some(mut first) = first {
        // It was fitted with the first one applied: what looks alike is told apart there.
        let apart = |one: &&Proposal| !first.also_possible.contains(&CANDIDATES[one.candidate].id);
        let rest: Vec<Proposal> = method.second.iter().filter(apart).cloned().collect();
        match measured(&method.name, &rest) {
            // Another number of the same effect.
            Some(second) if second.id == first.id => first.values.extend(second.values),
            second => claims.extend(second),
        }
        claims.push(first);
    }
    claims.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut answer = Answer { verdict: Verdict::Consistent, claims: Vec::new(), unexplained };
    answer.keep(claims);
    answer.unexplained = answer.unexplained.filter(|_| answer.verdict == Verdict::Unnamed);
    answer
}

/// The best of a method's proposals that passed, with those that are not told apart from it.
fn measured(method: &str, proposals: &[Proposal]) -> Option<Claim> {
    let one = believed_most(proposals.iter().filter(|one| one.passed))?;
    Some(Claim {
        id: CANDIDATES[one.candidate].id,
        also_possible: beside(one, proposals),
        values: vec![(one.candidate, one.value, one.ci95)],
        score: one.score,
        belief: Some(one.probability),
        found_by: vec![method.to_owned()],
        heldout_nats: one.heldout_nats,
        heldout_nats_per_event: one.heldout_nats_per_event,
        finding: None,
    })
}

/// What differs where a claim is hardly believed: where and over what the nearest effect would have it.
fn nameless(claim: &Claim) -> Unexplained {
    let ids = std::iter::once(claim.id).chain(claim.also_possible.iter().copied());
    let nearest = catalogue().into_iter().find(|kind| kind.decl.id == claim.id).map(|kind| kind.decl);
    Unexplained {
        covariate: nearest.map_or_else(String::new, |decl| decl.covariate.to_owned()),
        equation: nearest.map_or_else(String::new, |decl| format!("not known; nearest is {}", decl.equation)),
        insertion: nearest.map_or_else(String::new, |decl| decl.stage.name().to_owned()),
        score: claim.score,
        nats: claim.heldout_nats.unwrap_or(0.0),
        law: None,
        hardly: ids.map(str::to_owned).collect(),
    }
}

/// Claims of roads of equal standing, beside what is known.
fn side_by_side(speaking: &[Road], known: &[Claim]) -> Vec<Claim> {
    let alone = if known.is_empty() { ALONE } else { 2.0 * ALONE };
    let Some(first) = strongest(speaking, |road| &road.proposals, alone) else { return Vec::new() };
    if !first.also_possible.is_empty() && !known.is_empty() {
        return Vec::new();
    }
    let rest: Vec<Road> = speaking.iter().map(|road| second_of(road, first.id)).collect();
    let two_by_two = rest.iter().filter(|road| road.alarm && !road.proposals.is_empty()).count() > 1;
    let is_new = |second: &Claim| second.id != first.id && !first.also_possible.contains(&second.id) && known.iter().all(|claim| claim.id != second.id);
    let second = strongest(&rest, |road| &road.proposals, SECOND).filter(|second| (two_by_two || second.score > SECOND) && is_new(second));
    std::iter::once(first).chain(second).collect()
}

/// Claims of the road that refits, which hears the others where it cannot tell effects apart. Where it is silent, nothing that has events of its own is missing, and the others
/// speak of random effects alone.
fn led(refit: &Road, others: &[Road], known: &[Claim]) -> Vec<Claim> {
    let is_random = |proposal: &Proposal| CANDIDATES[proposal.candidate].is_random;
    let of_chance: Vec<Road> =
        others.iter().map(|road| Road { proposals: road.proposals.iter().filter(|one| is_random(one)).cloned().collect(), ..road.clone() }).collect();
    let least = if known.is_empty() { 1.0 } else { BESIDE };
    let found = if refit.alarm { refitted(&refit.proposals, others, least) } else { None };
    let Some(first) = found else {
        // Variances that all pixels share are of chance or of light that errs: another road has to put such a name first as well.
        let is_seconded = |one: &&Proposal| {
            let puts_first =
                |road: &Road| road.alarm && road.proposals.first().is_some_and(|first| CANDIDATES[first.candidate].id == CANDIDATES[one.candidate].id);
            !is_random(one) || others.iter().any(puts_first)
        };
        let seconded: Vec<Proposal> = refit.to_first_order.iter().filter(is_seconded).cloned().collect();
        // What a direct finding leaves of chance looks like chance.
        let alone = || first_order(&seconded).or_else(|| strongest(&of_chance, |road| &road.proposals, ALONE));
        if known.is_empty() {
            return alone().into_iter().collect();
        }
        // Closures count events: where some are lost, thresholds seem higher.
        if known.iter().any(|claim| claim.id == "event_loss") {
            return Vec::new();
        }
        let rest: Vec<Proposal> = seconded.into_iter().filter(|one| !is_random(one)).collect();
        return first_order(&rest).filter(|first| first.score >= least).into_iter().collect();
    };
    // What leaves much unexplained may be chance that all others name.
    let leaders: Vec<&Proposal> = others.iter().filter(|road| road.alarm).filter_map(|road| road.proposals.first()).collect();
    let same = |a: &Proposal, b: &Proposal| CANDIDATES[a.candidate].id == CANDIDATES[b.candidate].id;
    if first.score < HALF
        && leaders.len() == others.len()
        && leaders.first().is_some_and(|first| is_random(first) && leaders.iter().all(|other| same(first, other)))
        && let Some(chance) = strongest(&of_chance, |road| &road.proposals, 1.0)
    {
        return vec![chance];
    }
    let mut claims = vec![first];
    // The others speak of the first. What they moved to the first place is no second beside what it was moved from.
    let is_first = |one: &Proposal| claims[0].values.iter().any(|(candidate, ..)| *candidate == one.candidate);
    let rest: Vec<Proposal> = refit.second.iter().filter(|one| !is_first(one)).cloned().collect();
    if let Some(second) = refitted(&rest, &[], 1.0) {
        let first = &mut claims[0];
        if second.id == first.id {
            // Another number of the same effect.
            first.values.extend(second.values);
        } else if !first.also_possible.contains(&second.id) && known.iter().all(|claim| claim.id != second.id) {
            claims.push(second);
        }
    }
    let is_apart = |one: &&Proposal| {
        claims.iter().all(|claim| !looks_like(claim.id, &CANDIDATES[one.candidate]) && !claim.also_possible.contains(&CANDIDATES[one.candidate].id))
    };
    if claims.len() == 1 && known.is_empty() {
        let rest: Vec<Proposal> = refit.second_to_first_order.iter().filter(is_apart).cloned().collect();
        claims.extend(first_order(&rest));
    }
    claims
}

fn believed_most<'a>(proposals: impl Iterator<Item = &'a Proposal>) -> Option<&'a Proposal> {
    proposals.max_by(|a, b| a.probability.total_cmp(&b.probability).then(b.candidate.cmp(&a.candidate)))
}

/// Effects that are believed nearly as much as one, most first, whether they passed or not.
fn beside(one: &Proposal, proposals: &[Proposal]) -> Vec<&'static str> {
    let mut near: Vec<&Proposal> = proposals.iter().filter(|other| other.probability > IN_SET_SHARE * one.probability).collect();
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

/// What all pixels say to first order: the best, with what explains as much.
fn first_order(proposals: &[Proposal]) -> Option<Claim> {
    Some(Claim { heldout_nats: None, heldout_nats_per_event: None, ..measured(CLOSURES, proposals)? })
}

/// The best of the refits, with those that are not told apart from it.
fn refitted(proposals: &[Proposal], others: &[Road], least: f64) -> Option<Claim> {
    let one = believed_most(proposals.iter().filter(|one| one.passed && one.score >= least))?;
    let id = CANDIDATES[one.candidate].id;
    let agrees = |road: &&Road| road.alarm && road.proposals.first().is_some_and(|first| CANDIDATES[first.candidate].id == id);
    let found_by = std::iter::once(REFIT.to_owned()).chain(others.iter().filter(agrees).map(|road| road.name.clone())).collect();
    Some(Claim {
        id,
        also_possible: beside(one, proposals),
        values: vec![(one.candidate, one.value, one.ci95)],
        score: one.score,
        belief: Some(one.probability),
        found_by,
        heldout_nats: one.heldout_nats,
        heldout_nats_per_event: one.heldout_nats_per_event,
        finding: None,
    })
}

fn direct(case: &Case, nominal: &Nominal, finding: &Finding) -> Option<Claim> {
    let values: Vec<Valued> = finding
        .parameters
        .iter()
        .filter_map(|(parameter, value)| Some((CANDIDATES.iter().position(|one| one.id == finding.id && one.parameter == *parameter)?, *value, None)))
        .collect();
    // Events that are counted where nothing moves are certain however few they are; the limits are for what is fitted.
    let is_counted = finding.id == "leak_events";
    let matters = is_counted || values.is_empty() || values.iter().any(|(candidate, value, _)| is_material(case, nominal, &CANDIDATES[*candidate], *value));
    matters.then(|| Claim {
        id: finding.id,
        also_possible: Vec::new(),
        values,
        score: finding.statistic / finding.threshold,
        belief: None,
        found_by: vec![DIRECT.into()],
        heldout_nats: finding.heldout.map(|heldout| heldout.nats),
        heldout_nats_per_event: finding.heldout.map(|heldout| heldout.per_event()),
        finding: Some(finding.clone()),
    })
}

/// A road less what is known already or looks like it, and what does not matter.
fn without(case: &Case, nominal: &Nominal, road: &Road, known: &[&str]) -> Road {
    let keep = |proposals: &[Proposal]| -> Vec<Proposal> {
        let matters = |proposal: &&Proposal| is_material(case, nominal, &CANDIDATES[proposal.candidate], proposal.value);
        proposals.iter().filter(|proposal| !known.iter().any(|known| looks_like(known, &CANDIDATES[proposal.candidate]))).filter(matters).cloned().collect()
    };
    Road {
        proposals: keep(&road.proposals),
        second: keep(&road.second),
        to_first_order: keep(&road.to_first_order),
        second_to_first_order: keep(&road.second_to_first_order),
        ..road.clone()
    }
}

/// Is a candidate an effect, or taken for it (or it for the candidate) by the catalogue's own word? What a direct estimate leaves of its effect looks like that.
fn looks_like(known: &str, candidate: &Candidate) -> bool {
    let confused = |id: &str| catalogue().into_iter().find(|kind| kind.decl.id == id).map_or(&[][..], |kind| kind.decl.confused_with);
    known == candidate.id || confused(known).contains(&candidate.id) || confused(candidate.id).contains(&known)
}

/// What a road says of a second effect when the first is `id`: its own second, or what it put first itself if that is another.
fn second_of(road: &Road, id: &str) -> Road {
    let other = |proposal: &&Proposal| CANDIDATES[proposal.candidate].id != id;
    let puts_first = road.proposals.first().is_some_and(|proposal| CANDIDATES[proposal.candidate].id == id);
    let proposals = if puts_first { road.second.iter().filter(other).cloned().collect() } else { Vec::new() };
    Road { proposals, ..road.clone() }
}

/// The claim that the roads support together; none when none is sure, or only one and not sure enough (`alone`).
fn strongest(roads: &[Road], of: fn(&Road) -> &Vec<Proposal>, alone: f64) -> Option<Claim> {
    let sure: Vec<&Road> = roads.iter().filter(|road| road.alarm && of(road).iter().any(|proposal| proposal.passed)).collect();
    let best_score = sure.iter().flat_map(|road| of(road)).filter(|proposal| proposal.passed).map(|proposal| proposal.score).fold(0.0, f64::max);
    let heard = roads.iter().filter(|road| !of(road).is_empty()).count();
    match sure.len() {
        0 => return None,
        // The other road was there and silent: this one must be well over its alarm.
        1 if heard > 1 && best_score < alone => return None,
        // There is no other: its own alarm is enough, unless something is named already.
        1 if heard == 1 && best_score < if alone > ALONE { alone } else { 1.0 } => return None,
        _ => {}
    }
    // Support of an id: the mean over the sure roads of the logarithm of its probability; each road knows an id by its best parameter.
    let mut ids: Vec<&'static str> = sure.iter().flat_map(|road| of(road)).map(|proposal| CANDIDATES[proposal.candidate].id).collect();
    ids.sort_unstable();
    ids.dedup();
    let probability = |road: &Road, id: &str| {
        of(road).iter().filter(|proposal| CANDIDATES[proposal.candidate].id == id).map(|proposal| proposal.probability).fold(LEAST, f64::max)
    };
    let support = |id: &str| libm::exp(sure.iter().map(|road| libm::log(probability(road, id))).sum::<f64>() / sure.len() as f64);
    let mut ranked: Vec<(&'static str, f64)> = ids.into_iter().map(|id| (id, support(id))).collect();
    ranked.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(b.0)));
    // What no road found enough for, or none believes in, is no name, however little the rest is believed.
    let is_found = |id: &str| sure.iter().flat_map(|road| of(road)).any(|proposal| proposal.passed && CANDIDATES[proposal.candidate].id == id);
    ranked.retain(|(id, support)| is_found(id) && *support > BELIEVED * LEAST);
    let (id, best) = *ranked.first()?;
    let firsts: Vec<&str> =
        sure.iter().filter_map(|road| of(road).iter().find(|proposal| proposal.passed)).map(|proposal| CANDIDATES[proposal.candidate].id).collect();
    let agreed = firsts.len() > 1 && firsts.iter().all(|first| *first == id);
    let mut also_possible: Vec<&'static str> = Vec::new();
    if !agreed {
        // What a sure road put first stays in the set; then whatever has support, as long as the set is small.
        let named = ranked.iter().skip(1).filter(|(other, support)| (firsts.len() > 1 && firsts.contains(other)) || *support > IN_SET * best);
        also_possible = named.map(|(other, _)| *other).take(LARGEST_SET - 1).collect();
    }
    let mut values: Vec<Valued> = Vec::new();
    let mut found_by = Vec::new();
    let (mut nats, mut per_event, mut score) = (None, None, 0.0_f64);
    for road in &sure {
        for proposal in of(road).iter().filter(|proposal| CANDIDATES[proposal.candidate].id == id).take(1) {
            found_by.push(road.name.clone());
            score = score.max(proposal.score);
            nats = nats.or(proposal.heldout_nats);
            per_event = per_event.or(proposal.heldout_nats_per_event);
            // The first road with an interval has the better estimate.
            if values.is_empty() || (values[0].2.is_none() && proposal.ci95.is_some()) {
                values = vec![(proposal.candidate, proposal.value, proposal.ci95)];
            }
        }
    }
    Some(Claim { id, also_possible, values, score, belief: Some(best), found_by, heldout_nats: nats, heldout_nats_per_event: per_event, finding: None })
}

/// Does a value of a candidate differ from nothing by more than anybody would care about? Delays: the larger of 2 us and half of the stamp's width, as stamps may be rounded down; other
/// times: the larger of 2 us and a tenth of the stamp's width; thresholds, gains and light: 0.5 %; rates: 0.01 Hz a pixel; shares: 0.1 %.
pub fn is_material(case: &Case, nominal: &Nominal, candidate: &Candidate, value: f64) -> bool {
    let Some(decl) = candidate.parameter_decl() else { return true };
    if candidate.is_limit() {
        return true;
    }
    let size = (value - candidate.nominal_value(nominal)).abs();
    let width_s = case.t_resolution_ns as f64 * 1e-9;
    let seconds = (case.span.1 - case.span.0) as f64 * 1e-9;
    // Half a step of the stamps is no delay: they are rounded down.
    let delay_s = f64::max(2e-6, 0.55 * width_s);
    match (candidate.id, decl.unit) {
        // A tenth of a stamp over the length of the recording.
        ("clock_drift", _) => size * seconds > f64::max(2e-6, 0.1 * width_s),
        ("clock_offset", _) => size > delay_s,
        ("time_constant" | "second_pole", _) if matches!(candidate.parameter, "tau_0" | "tau") => size > delay_s,
        // Half of it is a shift of the middle.
        ("exposure_time", _) => size > 2.0 * delay_s,
        ("row_skew", _) if candidate.parameter == "per_row" => size * f64::from(case.extent.height) > f64::max(2e-6, 0.1 * width_s),
        ("row_time", _) => size * f64::from(case.extent.height) > 2e-6,
        ("time_constant" | "second_pole", _) => size > delay_s * typical_light(case, nominal),
        ("threshold_drift", _) => size * seconds > 0.005,
        ("dark_current", _) => size > 0.005 * typical_light(case, nominal),
        ("black_level", _) => size > 0.005 * typical_dn(case, nominal),
        (_, Unit::Time) => size > f64::max(2e-6, 0.1 * width_s),
        (_, Unit::Rate) => size > 0.01,
        ("threshold_scale" | "threshold_asymmetry" | "threshold_gradient" | "frame_nonlinearity", _) => size > 0.005,
        (_, Unit::Number("fraction")) => size > 0.001,
        (_, Unit::Number("ln")) => size > 0.005 * nominal.pixel.threshold_on,
        _ => size > 0.0,
    }
}

fn typical_dn(case: &Case, nominal: &Nominal) -> f64 {
    let Some(frames) = &case.frames else { return 0.0 };
    let mut signals: Vec<f64> = frames.dn.iter().step_by(101).filter(|dn| dn.is_finite()).map(|dn| f64::from(*dn) - nominal.number.black_level).collect();
    crate::integrity::median(&mut signals).max(0.0)
}

fn typical_light(case: &Case, nominal: &Nominal) -> f64 {
    let exposure_s = case.frames.as_ref().and_then(|frames| frames.times.nominal_exposure_ns()).unwrap_or(0) as f64 * 1e-9;
    if exposure_s > 0.0 { typical_dn(case, nominal) / (nominal.number.gain * exposure_s) } else { 0.0 }
}

#[cfg(test)]
#[path = "verdict_tests.rs"]
mod tests;
