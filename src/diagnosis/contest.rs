//! The contest: every effect that a refit can name is put on the description of pixels at which no refit looked, and what is seen there decides between them.
//!
//! A refit chooses among some sixty candidates on four hundred pixels, and what is best there is partly luck. On other pixels ([`crate::comparison`]) the light is estimated anew as the sensor with the effect
//! must have seen it; events are foretold better or worse than as stated, and rescaled intervals are nearer to those of a recording of that very sensor or not.
//! This, what the refit itself found, and what `synthesis` believes make the belief in an effect: a multinomial logit. Its weights were fitted to recordings with one or two
//! effects (docs/diagnosis.md says which), so that a belief is the share of such claims that were right.
//!
//! What does not foretell events or frames of these pixels better is withdrawn, whatever it explains of the others.

use crate::candidates::CANDIDATES;
use crate::comparison::{Ground, Step};
use crate::roads::{LEAST_NATS, REFIT, SYNTHESIS};
use crate::verdict::{Proposal, Road, Valued};
use rayon::prelude::*;

/// Proposals with less than this share of the best one's score do not take part.
const WORTH: f64 = 0.25;
/// Nor those with less than this, over the alarm.
const LEAST_SCORE: f64 = 0.5;
/// So often one of those that take part is the effect, where a refit speaks; else it is something that none of them is.
const AMONG: f64 = 0.85;

/// A proposal that takes part, and what it shows.
type Entered<'a> = (&'a Proposal, Option<Shown>);

/// What a proposal shows on the pixels of the contest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Shown {
    /// Nats that an event is better foretold by than as stated.
    nats_per_event: f64,
    /// dB that frames which were kept back are better predicted by; none where they cannot be.
    kept_db: Option<f64>,
    /// Distance of rescaled intervals from those of the described sensor, as stated and so; none with too few.
    ks: Option<(f64, f64)>,
}

/// Weights of the logit.
struct Weights {
    /// Of the logarithm of the refit's own belief, which knows what each effect leaves where it is right, and what all pixels say to first order.
    belief: f64,
    /// Of what is missing to the best share of the cost.
    score: f64,
    /// Of what is missing to the best gain in nats.
    nats: f64,
    /// Of the logarithm of the distance of rescaled intervals from theirs.
    ks: f64,
    /// Of the logarithm of the belief of `synthesis`.
    synthesis: f64,
}

/// See docs/diagnosis.md.
const WEIGHTS: Weights = Weights { belief: 0.55, score: 1.45, nats: 0.24, ks: 0.76, synthesis: 0.5 };
/// Beliefs below these say no more than these.
const LEAST_BELIEF: f64 = 1e-3;
/// See there.
const LEAST_SYNTHESIS: f64 = 0.03;
/// Scores differ by chance by this, and this share of the best.
const SCORE_ERROR: (f64, f64) = (0.3, 0.2);
/// Nats an event, likewise.
const NATS_ERROR: (f64, f64) = (0.01, 0.2);
/// What is missing by more errors than this says no more.
const MOST_MISSING: f64 = 6.0;
/// Distances of rescaled intervals differ by chance by this.
const KS_ERROR: f64 = 0.03;

/// Frames that were kept back must be predicted by so much better, where events are not.
const LEAST_KEPT_DB: f64 = 0.3;
/// And events by no more than this worse, nats.
const MOST_LOST: f64 = 0.02;
/// Or rescaled intervals must be this far from those of the described sensor,
const MISCALIBRATED: f64 = 0.1;
/// and come nearer by this factor.
const CALIBRATES: f64 = 0.65;

/// An effect that takes away this share of what an alarm takes is believed where all of these are better: events, nats,
const ALMOST: f64 = 0.65;
/// see there,
const LEAST_NATS_OF_ALL: f64 = 0.005;
/// frames, dB,
const LEAST_KEPT_DB_OF_ALL: f64 = 0.5;
/// and rescaled intervals, from this distance on.
const MISCALIBRATED_BY_LITTLE: f64 = 0.04;
/// So often an effect that only all pixels name is one of those that explain most to first order.
const AMONG_TO_FIRST_ORDER: f64 = 0.55;
/// And those explain at least this share of what the best does.
const WORTH_TO_FIRST_ORDER: f64 = 0.6;

impl Shown {
    fn of(step: &Step, before: &Step) -> Shown {
        let gain = step.gain_over(before);
        Shown {
            nats_per_event: gain.nats_per_event,
            kept_db: before.kept_psnr_db.zip(step.kept_psnr_db).map(|(before, after)| after - before),
            ks: before.calibration.as_ref().zip(step.calibration.as_ref()).map(|(before, after)| (before.ks, after.ks)),
        }
    }

    /// Is anything better, events foretold by more than `least` nats?
    fn is_proof(&self, least: f64) -> bool {
        let calibrates = self.ks.is_some_and(|(before, after)| before > MISCALIBRATED && after < CALIBRATES * before);
        self.nats_per_event > least || self.nats_per_event > -MOST_LOST && (calibrates || self.kept_db.is_some_and(|gain| gain > LEAST_KEPT_DB))
    }

    /// Is everything better, so that less of the cost needs to be taken away?
    fn is_full_proof(&self) -> bool {
        let calibrates = self.ks.is_some_and(|(before, after)| before > MISCALIBRATED_BY_LITTLE && after < CALIBRATES * before);
        self.nats_per_event > LEAST_NATS_OF_ALL && calibrates && self.kept_db.is_some_and(|gain| gain > LEAST_KEPT_DB_OF_ALL)
    }
}

/// Judges what refits propose, and what all pixels name to first order, on the pixels of `ground`; without any, by what refits and `synthesis` say.
///
/// A refit speaks when one of its proposals passed; which effect it names is decided by belief among all that explain enough.
///
/// # Errors
/// When effects that are on the description already cannot be combined.
pub fn judge(ground: Option<&Ground<'_>>, roads: &mut [Road]) -> Result<(), String> {
    let heard: Vec<Proposal> = roads.iter().filter(|road| road.name == SYNTHESIS && road.alarm).flat_map(|road| road.proposals.clone()).collect();
    let Some(refit) = roads.iter_mut().find(|road| road.name == REFIT) else { return Ok(()) };
    // Where a second effect was found, the first was looked for beside it; so it is here, if there is one.
    let [first, mut second] = [&refit.proposals, &refit.second].map(|proposals| best_of(proposals).cloned().into_iter().collect::<Vec<_>>());
    let is_shown = show(ground, &second, &|_| true, &first)?.into_iter().all(|shown| shown.is_none_or(|shown| shown.is_proof(LEAST_NATS)));
    second.retain(|_| is_shown);
    let shown = believe(ground, &mut refit.proposals, (LEAST_SCORE, WORTH), AMONG, &second, &heard)?;
    let explains = |one: &Proposal| one.passed || one.score > 1.0 && one.heldout_nats_per_event.is_some_and(|nats| nats > LEAST_NATS);
    for (one, shown) in refit.proposals.iter_mut().zip(&shown) {
        let is_full_proof = one.score > ALMOST && shown.is_some_and(|shown| shown.is_full_proof());
        // A refit has shown a gain of events already.
        one.passed = if refit.alarm { explains(one) && shown.is_none_or(|shown| shown.is_proof(0.0)) } else { is_full_proof };
        if one.passed {
            one.score = one.score.max(1.0);
        }
    }
    let first: Vec<Proposal> = best_of(&refit.proposals).cloned().into_iter().collect();
    refit.alarm = !first.is_empty();
    // Of an effect that a refit followed, its strength is the better one.
    for one in refit.to_first_order.iter_mut().filter(|one| one.passed) {
        if let Some(followed) = refit.proposals.iter().find(|other| other.candidate == one.candidate && other.score > 0.0) {
            (one.value, one.ci95) = (followed.value, followed.ci95);
        }
    }
    if refit.to_first_order.iter().any(|one| one.passed) {
        refit.to_first_order.iter_mut().filter(|one| !CANDIDATES[one.candidate].is_random).for_each(|one| one.probability = 1.0);
        let shown = believe(ground, &mut refit.to_first_order, (0.0, WORTH_TO_FIRST_ORDER), AMONG_TO_FIRST_ORDER, &[], &heard)?;
        refit
            .to_first_order
            .iter_mut()
            .zip(shown)
            .for_each(|(one, shown)| one.passed &= one.probability > 0.0 && shown.is_none_or(|shown| shown.is_proof(LEAST_NATS)));
    }
    for proposals in [&mut refit.second, &mut refit.second_to_first_order] {
        let shown = show(ground, proposals, &|one| one.passed, &first)?;
        for (one, shown) in proposals.iter_mut().zip(shown) {
            one.passed &= shown.is_none_or(|shown| shown.is_proof(LEAST_NATS));
            one.probability *= f64::from(u8::from(one.passed));
        }
    }
    Ok(())
}

/// Lets proposals with a score of `least`, and this share of the best one's, take part, and makes their probabilities beliefs; others have none, but for what is random, which keeps its own.
fn believe(
    ground: Option<&Ground<'_>>,
    proposals: &mut [Proposal],
    (least, share): (f64, f64),
    among: f64,
    base: &[Proposal],
    heard: &[Proposal],
) -> Result<Vec<Option<Shown>>, String> {
    let is_chance = |one: &Proposal| CANDIDATES[one.candidate].is_random;
    let best = proposals.iter().filter(|one| !is_chance(one)).map(|one| one.score).fold(0.0, f64::max);
    let takes_part = |one: &Proposal| !is_chance(one) && one.score >= f64::max(least, share * best);
    let shown = show(ground, proposals, &takes_part, base)?;
    let entered: Vec<usize> = (0..proposals.len()).filter(|&n| takes_part(&proposals[n])).collect();
    let beliefs = believed(&entered.iter().map(|&n| (&proposals[n], shown[n])).collect::<Vec<_>>(), heard);
    proposals.iter_mut().filter(|one| !is_chance(one)).for_each(|one| one.probability = 0.0);
    entered.iter().zip(beliefs).for_each(|(&n, belief)| proposals[n].probability = among * belief);
    Ok(shown)
}

fn best_of(proposals: &[Proposal]) -> Option<&Proposal> {
    proposals.iter().filter(|one| one.passed).max_by(|a, b| a.probability.total_cmp(&b.probability).then(b.candidate.cmp(&a.candidate)))
}

/// What those that take part show beside what is on the description already; none for what is random, or cannot be put beside.
fn show(
    ground: Option<&Ground<'_>>,
    proposals: &[Proposal],
    takes_part: &(dyn Fn(&Proposal) -> bool + Sync),
    base: &[Proposal],
) -> Result<Vec<Option<Shown>>, String> {
    let Some(ground) = ground else { return Ok(vec![None; proposals.len()]) };
    let base: Vec<Valued> = base.iter().map(|one| (one.candidate, one.value, None)).collect();
    let with_base = if base.is_empty() || !proposals.iter().any(takes_part) { None } else { Some(ground.with(&base)?) };
    let before = with_base.as_ref().unwrap_or(ground.before());
    let one = |one: &Proposal| {
        let values: Vec<Valued> = base.iter().copied().chain([(one.candidate, one.value, None)]).collect();
        let is_seen = takes_part(one) && !CANDIDATES[one.candidate].is_random;
        is_seen.then(|| ground.with(&values).ok()).flatten().map(|step| Shown::of(&step, before))
    };
    Ok(proposals.par_iter().map(one).collect())
}

/// Shares of belief among those that take part.
fn believed(entered: &[Entered<'_>], heard: &[Proposal]) -> Vec<f64> {
    let best = |of: &dyn Fn(&Entered<'_>) -> f64| entered.iter().map(of).fold(f64::NEG_INFINITY, f64::max);
    let score = |one: &Entered<'_>| one.0.score;
    let nats = |one: &Entered<'_>| one.1.map_or(f64::NEG_INFINITY, |shown| shown.nats_per_event);
    let (best_score, best_nats) = (best(&score), best(&nats));
    let missing = |best: f64, own: f64, error: (f64, f64)| f64::min((best - own) / (error.0 + error.1 * best.max(0.0)), MOST_MISSING);
    let said_by_synthesis = |id: &str| {
        let own = heard.iter().filter(|one| CANDIDATES[one.candidate].id == id).map(|one| one.probability).fold(LEAST_SYNTHESIS, f64::max);
        if heard.is_empty() { 0.0 } else { libm::log(own) }
    };
    let logit = |one: &Entered<'_>| {
        let of_refit = WEIGHTS.belief * libm::log(one.0.probability.max(LEAST_BELIEF)) - WEIGHTS.score * missing(best_score, score(one), SCORE_ERROR);
        let of_ground = one.1.map_or(0.0, |shown| {
            let ks = shown.ks.map_or(0.0, |(_, after)| WEIGHTS.ks * libm::log(after + KS_ERROR));
            -WEIGHTS.nats * missing(best_nats, shown.nats_per_event, NATS_ERROR) - ks
        });
        of_refit + of_ground + WEIGHTS.synthesis * said_by_synthesis(CANDIDATES[one.0.candidate].id)
    };
    let logits: Vec<f64> = entered.iter().map(logit).collect();
    let most = logits.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let sum: f64 = logits.iter().map(|logit| libm::exp(logit - most)).sum();
    logits.iter().map(|logit| libm::exp(logit - most) / sum).collect()
}

#[cfg(test)]
#[path = "contest_tests.rs"]
mod tests;
