//! The roads that estimate the scene, each in its own words, brought to the form that [`crate::verdict`] joins.

use crate::candidates::{CANDIDATES, Scales};
use crate::case::Case;
use crate::covariates::Covariate;
use crate::deviation::context_of;
use crate::diagnose::{RoadKind, Setting};
use crate::first_order::{self, ALONE, BESIDE, Biases, LARGEST};
use crate::floor::Floor;
use crate::knowledge::Knowledge;
use crate::law::{Law, Moved};
use crate::likelihood::{self, Likelihood, LikelihoodSetting, likelihood};
use crate::linear::Linear;
use crate::refit::{Explained, Refitted};
use crate::report::{Detectable, NotTestable};
use crate::search::{Search, SearchSetting, search};
use crate::synthesis::{Ranked, Synthesis, SynthesisSetting, synthesis};
use crate::verdict::{Proposal, Road, Unexplained};

/// All roads, in the order in which they are run. Synthesis needs to know what recordings without an effect look like, and is left out without that knowledge.
pub fn all(knowledge: Option<Knowledge>) -> Vec<RoadKind> {
    let biases = knowledge.as_ref().map(|knowledge| knowledge.biases.clone());
    let refit = RoadKind::new(REFIT, move |case, _| run_refit(case, biases.as_ref()));
    let mut roads = vec![refit, RoadKind::new("likelihood", run_likelihood)];
    roads.extend(knowledge.map(|knowledge| RoadKind::new(SYNTHESIS, move |case, setting| run_synthesis(case, &knowledge, setting))));
    roads
}

/// With fewer events a pixel than this, frames alone make the scene, and every effect of the events looks like every other.
const LEAST_EVENTS_A_PIXEL: f64 = 0.3;

fn run_synthesis(case: &Case, knowledge: &Knowledge, setting: &Setting) -> Result<Road, String> {
    let events_a_pixel = case.events.all().len() as f64 / case.events.pixels().max(1) as f64;
    if events_a_pixel < LEAST_EVENTS_A_PIXEL {
        return Err(format!("there are {events_a_pixel:.2} events a pixel, and {LEAST_EVENTS_A_PIXEL} are needed; record more change, or for longer"));
    }
    let own = SynthesisSetting { seed: setting.seed, ..SynthesisSetting::default() };
    Ok(from_synthesis(&synthesis(case, knowledge, &own)?))
}

fn run_likelihood(case: &Case, setting: &Setting) -> Result<Road, String> {
    let nominal = case.nominal().map_err(|why| why.to_string())?;
    // Strengths are what refits are for.
    let setting = LikelihoodSetting { seed: setting.seed, refined: [5, 3, 0, 0], calibrated: 0, ..LikelihoodSetting::default() };
    Ok(from_likelihood(&likelihood(case, &nominal, &setting)?, &setting))
}

fn run_refit(case: &Case, biases: Option<&Floor>) -> Result<Road, String> {
    let nominal = case.nominal().map_err(|why| why.to_string())?;
    let scales = Scales::of(case, &nominal);
    let biases = biases.map_or_else(Vec::new, |biases| biases.root_mean_square(&context_of(case, &nominal)));
    Ok(from_refit(&search(case, &nominal, &scales, &SearchSetting::default())?, &Biases(biases), &|candidate, strength| {
        CANDIDATES[candidate].value(strength, &scales, &nominal)
    }))
}

/// The road that refits.
pub const REFIT: &str = "refit";
/// What all pixels say to first order, which is part of that road.
pub const CLOSURES: &str = "closures";
/// The road that compares summaries with those of every effect on the recording's own scene.
pub const SYNTHESIS: &str = "synthesis";
/// Share of the cost that an effect must take away on pixels that it was not fitted to; nulls of other people's simulators reach 0.1.
const LEAST_TAKEN: f64 = 0.14;
/// And a second effect of what the first leaves.
const LEAST_TAKEN_SECOND: f64 = 0.2;
/// And the share of blocks that either must improve.
const LEAST_BETTER: f64 = 0.6;
/// And how much better either must foretell an event of pixels that it was not fitted to, nats: what makes that harder is no explanation, however much else it matches.
pub(crate) const LEAST_NATS: f64 = 0.01;
/// Knots twice as near must take away this share to be told; nulls reach 0.23.
const LEAST_NUMERICAL: f64 = 0.25;
/// A candidate whose score is greater than the best by this share is believed a factor e less.
const SCORE_SOFTNESS: f64 = 0.35;

/// What all pixels say to first order of a refit's candidate must be so many standard errors in its direction.
const LEAST_SUPPORT: f64 = 1.2;
/// Where all pixels can say nothing of it, it must take away so many times as much.
const UNSEEN: f64 = 2.0;
/// What such a standard error, up to [`MOST_SUPPORT`], counts as a logarithm of belief.
const SUPPORT: f64 = 0.2;
/// See there.
const MOST_SUPPORT: f64 = 6.0;
/// And what it takes away of what the best does, as a logarithm.
const SHARE_WEIGHT: f64 = 5.0;
/// A smaller share says no more than this: some effects are such that a light can be found for them.
const LEAST_SHARE: f64 = 0.22;
/// Where nothing is known of it.
const USUAL_SHARE: f64 = 0.85;
/// Less than this, as a share of all squares, is nothing.
const LEAST_VISIBLE: f64 = 0.001;
/// What a refit names is believed before a law when it is so many standard errors to first order.
const FIRM: f64 = 3.0;
/// And what all pixels name alone when it takes away so many times as much as a law.
const SHADOW: f64 = 2.0;
/// All pixels name an effect where no refit does only where the light of the stated sensor fires so many of the events again.
const LEAST_AGREEMENT: f64 = 0.4;

/// A number of a refit errs by this share of its departure from nothing, beside what differs from block to block: what all blocks share.
const SHARED_ERROR: f64 = 0.05;

/// What all pixels say to first order of a candidate.
struct Support {
    /// Its strength in the direction of the refit, standard errors.
    sigmas: f64,
    /// What it takes away over what the best does.
    share: f64,
}

impl Support {
    /// As a logarithm of belief.
    fn belief(&self) -> f64 {
        SUPPORT * self.sigmas.min(MOST_SUPPORT) + SHARE_WEIGHT * libm::log(self.share.max(LEAST_SHARE))
    }
}

/// What refits say. `value` is a candidate's parameter at a strength, in the unit of its declaration.
pub fn from_refit(found: &Search, biases: &Biases, value: &dyn Fn(usize, f64) -> f64) -> Road {
    let most = found.linear.iter().map(|one| one.taken).fold(LEAST_VISIBLE, f64::max);
    // To first order of the candidate, in the direction of the refit; none where that says nothing.
    let support = |one: &Explained| {
        let linear = found.linear.iter().find(|linear| linear.candidate == one.candidate)?;
        let sigmas = libm::copysign(1.0, one.strength) * linear.sigmas(biases.of(one.candidate));
        Some(Support { sigmas, share: f64::max(linear.taken, LEAST_VISIBLE) / most })
    };
    let mut second =
        found.second.as_ref().map_or_else(Vec::new, |second| told(second, LEAST_TAKEN_SECOND, &|_| Some(Support { sigmas: f64::INFINITY, share: 1.0 })));
    let has_second = second.iter().any(|one| one.passed);
    let mut first = told(found.again.as_ref().filter(|_| has_second).unwrap_or(&found.first), LEAST_TAKEN, &support);
    first.iter_mut().for_each(|one| widen(one, &found.linear, value));
    second.iter_mut().for_each(|one| widen(one, &found.second_linear, value));
    let is_heard = found.agreement >= LEAST_AGREEMENT;
    let all = if is_heard { first_order::told(&found.linear, biases, value, ALONE) } else { Vec::new() };
    let alone = found.linear.iter().zip(&all).filter(|(_, told)| told.passed).map(|(linear, _)| linear.taken).fold(0.0, f64::max);
    let passed = |one: &&&Explained| first.iter().any(|told| told.passed && told.candidate == one.candidate);
    let is_firm = found.first.leading().iter().filter(passed).any(|one| support(one).is_some_and(|of| of.sigmas > FIRM));
    let has_gradient = first.iter().any(|one| one.passed && CANDIDATES[one.candidate].id.ends_with("_gradient"));
    // A law of a few bins may be a name's shadow, and one of places is that of a gradient.
    let is_shadow = |law: &Law| is_firm || alone > SHADOW * law.taken || has_gradient && is_place(law.covariate);
    let best = found.first.leading().first().copied().cloned();
    let alarm = first.iter().any(|one| one.passed);
    Road {
        name: REFIT.into(),
        alarm,
        proposals: first,
        second,
        nats_per_event: best.as_ref().map(|best| best.nats_per_event).filter(|_| alarm),
        unexplained: found.laws.first().filter(|law| !is_shadow(law)).and_then(unexplained),
        is_numerical: found.numerical > f64::max(LEAST_NUMERICAL, best.as_ref().map_or(0.0, |best| best.heldout)),
        residual_left: best.as_ref().map(|best| best.cost / f64::max(found.first.stated, 1e-12)).filter(|_| alarm),
        to_first_order: if is_heard { all.into_iter().chain(first_order::of_chance(&found.components, &found.laws)).collect() } else { Vec::new() },
        second_to_first_order: first_order::told(&found.second_linear, biases, value, BESIDE),
        detectability: found.linear.iter().map(|linear| first_order::measured(linear, biases, value)).collect(),
        ..Road::default()
    }
}

/// A law must take away this share of the squares of closures' changes.
const LEAST_LAW: f64 = 0.02;
/// One of thresholds over the load of the array, which knows of the light where all of it changes together, takes away more.
const LEAST_LAW_OF_LOAD: f64 = 0.04;
/// And be so many standard errors from nothing.
const LEAST_SIGNIFICANCE: f64 = 4.0;

/// What no effect of the catalogue explains, from its measured curve. Light through the events errs in ways that depend on light, speed and history, and on which simulator
/// made a recording; where such a law is the strongest, none is believed.
fn unexplained(law: &Law) -> Option<Unexplained> {
    let least = least_taken(law)?;
    (law.significance >= LEAST_SIGNIFICANCE && law.taken >= least).then(|| Unexplained::by(law, law.taken / least))
}

/// The share that a law must take away; none for those over what knows of the pixel's own light. How late stamps are over the phase of frames is such, as exposures are.
fn least_taken(law: &Law) -> Option<f64> {
    use Covariate as C;
    match (law.moved, law.covariate) {
        (_, covariate) if is_place(covariate) => Some(LEAST_LAW),
        (_, C::RowParity | C::RowRate) | (Moved::Threshold, C::AcPhase) | (Moved::Threshold | Moved::Rate, C::FramePhase) => Some(LEAST_LAW),
        (Moved::Threshold, C::GlobalRate) => Some(LEAST_LAW_OF_LOAD),
        _ => None,
    }
}

/// Is it where a pixel is, on a scale on which effects of the catalogue change from end to end?
fn is_place(covariate: Covariate) -> bool {
    matches!(covariate, Covariate::Row | Covariate::Column | Covariate::ColumnBlock | Covariate::Radius)
}

fn told(found: &Refitted, least: f64, support: &dyn Fn(&Explained) -> Option<Support>) -> Vec<Proposal> {
    let leading = found.leading();
    let best = leading.first().map_or(1.0, |best| best.score());
    let mut proposals: Vec<Proposal> = leading
        .iter()
        .map(|one| Proposal {
            candidate: one.candidate,
            score: f64::max(one.heldout / least, 0.0),
            probability: libm::exp(
                libm::log(best / one.score()) / SCORE_SOFTNESS + support(one).unwrap_or(Support { sigmas: LEAST_SUPPORT, share: USUAL_SHARE }).belief(),
            ),
            value: one.value,
            ci95: Some(one.ci95),
            passed: one.heldout > least
                && one.blocks_better > LEAST_BETTER
                && one.nats_per_event.1 - one.nats_per_event.0 > LEAST_NATS
                && (one.strength.abs() < LARGEST || CANDIDATES[one.candidate].is_limit())
                && support(one).map_or(one.heldout > UNSEEN * least, |of| of.sigmas > LEAST_SUPPORT),
            heldout_nats: None,
            heldout_nats_per_event: Some(one.nats_per_event.1 - one.nats_per_event.0),
        })
        .collect();
    normalise(&mut proposals);
    proposals
}

/// Gives the interval of a refit what blocks do not know of: what they all share, and half of what all pixels say otherwise to first order.
fn widen(one: &mut Proposal, linear: &[Linear], value: &dyn Fn(usize, f64) -> f64) {
    let Some([low, high]) = one.ci95 else { return };
    let nothing = if CANDIDATES[one.candidate].is_limit() { 0.0 } else { value(one.candidate, 0.0) };
    let shared = SHARED_ERROR * (one.value - nothing);
    let other = linear.iter().find(|other| other.candidate == one.candidate).map_or(0.0, |other| 0.5 * (value(one.candidate, other.strength) - one.value));
    let more = 1.96 * libm::hypot(shared, other);
    if more.is_finite() {
        one.ci95 = Some([one.value - libm::hypot(one.value - low, more), one.value + libm::hypot(high - one.value, more)]);
    }
}

/// A candidate whose statistic is this much below the best, as a share of it, is believed a factor e less.
const SOFTNESS: f64 = 0.15;
/// How many of its candidates a road tells.
const TOLD: usize = 12;

/// What the likelihood says.
pub fn from_likelihood(found: &Likelihood, setting: &LikelihoodSetting) -> Road {
    let best = found.proposals.first().map_or(0.0, |first| first.statistic);
    let mut proposals: Vec<Proposal> = found
        .proposals
        .iter()
        .take(TOLD)
        .map(|one| {
            let passed = found.is_alarm && one.heldout_nats > setting.least_nats && one.blocks_better > setting.least_share;
            Proposal {
                candidate: one.candidate,
                score: f64::max(one.heldout_nats / setting.least_nats, 0.0),
                probability: libm::exp((one.statistic / f64::max(best, 1e-12) - 1.0) / SOFTNESS),
                value: one.value,
                ci95: Some(one.ci95),
                passed,
                heldout_nats: Some(one.heldout_nats),
                heldout_nats_per_event: Some(one.heldout_nats_per_event),
            }
        })
        .collect();
    normalise(&mut proposals);
    Road {
        name: "likelihood".into(),
        alarm: found.is_alarm,
        proposals,
        detectability: found.detectability.iter().filter(|one| one.not_testable.is_none()).map(detectable).collect(),
        not_testable: not_testable(&found.detectability),
        ..Road::default()
    }
}

/// What synthesis says: its order is by nats, so belief is their exponential.
pub fn from_synthesis(found: &Synthesis) -> Road {
    let best = found.ranked.first().map_or(0.0, |first| first.score);
    let one = |ranked: &Ranked| Proposal {
        candidate: ranked.candidate,
        score: f64::max(ranked.gain / found.threshold, 0.0),
        probability: libm::exp(ranked.score - best),
        value: ranked.value,
        passed: found.alarm && ranked.gain > found.threshold,
        ..Proposal::default()
    };
    let mut proposals: Vec<Proposal> = Vec::new();
    for ranked in &found.ranked {
        // Of each effect its best parameter only.
        if proposals.iter().all(|other| CANDIDATES[other.candidate].id != ranked.id) {
            proposals.push(one(ranked));
        }
    }
    proposals.truncate(TOLD);
    normalise(&mut proposals);
    let mut second: Vec<Proposal> = found.second.iter().map(one).collect();
    normalise(&mut second);
    Road { name: "synthesis".into(), alarm: found.alarm, proposals, second, residual_left: Some(found.left).filter(|_| found.alarm), ..Road::default() }
}

fn detectable(one: &likelihood::Detectable) -> Detectable {
    let candidate = &CANDIDATES[one.candidate];
    let (parameter, unit) = candidate.json_key();
    Detectable {
        id: candidate.id.to_owned(),
        parameter,
        estimate: Some(one.estimate).filter(|_| !candidate.is_limit() && !unit.is_empty()),
        standard_error: Some(one.standard_error),
        minimal_detectable: one.minimal_detectable,
        unit: unit.to_owned(),
    }
}

/// Effects of which no parameter can be tested.
fn not_testable(all: &[likelihood::Detectable]) -> Vec<NotTestable> {
    let id = |one: &likelihood::Detectable| CANDIDATES[one.candidate].id;
    let mut found: Vec<NotTestable> = Vec::new();
    for one in all {
        let Some(why) = &one.not_testable else { continue };
        let is_testable = all.iter().any(|other| id(other) == id(one) && other.not_testable.is_none());
        if !is_testable && !found.iter().any(|other| other.id == id(one)) {
            found.push(NotTestable { id: id(one).to_owned(), why: why.clone() });
        }
    }
    found
}

/// Probabilities that add up to one.
fn normalise(proposals: &mut [Proposal]) {
    let sum: f64 = proposals.iter().map(|one| one.probability).sum();
    proposals.iter_mut().for_each(|one| one.probability /= f64::max(sum, 1e-300));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(id: &str, statistic: f64, heldout_nats: f64) -> likelihood::Proposal {
        let candidate = CANDIDATES.iter().position(|one| one.id == id).unwrap();
        likelihood::Proposal { candidate, statistic, heldout_nats, blocks_better: 0.9, value: 1.0, ..likelihood::Proposal::default() }
    }

    #[test]
    fn the_likelihood_keeps_its_order_and_its_gates() {
        let setting = LikelihoodSetting::default();
        let least = setting.least_nats;
        let proposals = vec![said("leak_events", 900.0, 3.0 * least), said("blur", 450.0, 0.5 * least)];
        let road = from_likelihood(&Likelihood { is_alarm: true, proposals, ..Likelihood::default() }, &setting);
        assert!(road.alarm && road.proposals[0].passed && !road.proposals[1].passed);
        assert!((road.proposals[0].score - 3.0).abs() < 1e-12);
        let sum: f64 = road.proposals.iter().map(|one| one.probability).sum();
        assert!((sum - 1.0).abs() < 1e-12 && road.proposals[0].probability > 0.9);
        let silent = from_likelihood(&Likelihood { proposals: vec![said("leak_events", 9.0, 9.0)], ..Likelihood::default() }, &setting);
        assert!(!silent.alarm && !silent.proposals[0].passed);
    }

    #[test]
    fn synthesis_believes_by_nats_and_passes_what_is_over_its_alarm() {
        let ranked = |id: &str, gain: f64| Ranked {
            candidate: CANDIDATES.iter().position(|one| one.id == id).unwrap(),
            id: id.into(),
            label: id.into(),
            probability: 0.5,
            gain,
            score: gain,
            strength: 1.0,
            value: 1.0,
            key: String::new(),
        };
        let found = Synthesis {
            alarm: true,
            statistic: 12.0,
            threshold: 4.0,
            consistent: 0.0,
            ranked: vec![ranked("leak_events", 12.0), ranked("blur", 2.0)],
            second: None,
            deviating: Vec::new(),
            context: Vec::new(),
            nulls: 10.0,
            left: 0.2,
            frame_share: 0.0,
        };
        let road = from_synthesis(&found);
        assert_eq!(road.proposals.iter().map(|one| one.passed).collect::<Vec<_>>(), [true, false]);
        let ratio = road.proposals[0].probability / road.proposals[1].probability;
        assert!((libm::log(ratio) - 10.0).abs() < 1e-9 && (road.proposals[0].score - 3.0).abs() < 1e-12);
    }

    #[test]
    fn a_law_that_takes_more_than_any_effect_is_something_without_a_name() {
        let law = |significance: f64, taken: f64| Law {
            moved: Moved::Threshold,
            covariate: Covariate::RowParity,
            period_s: None,
            at: vec![0.0, 1.0],
            value: vec![0.11, -0.11],
            error: vec![0.01, 0.01],
            taken,
            significance,
            nats_per_change: 0.2,
        };
        let found = unexplained(&law(9.0, 0.3)).unwrap();
        assert_eq!((found.covariate.as_str(), found.insertion.as_str()), ("row_parity", "comparator"));
        assert!((found.score - 0.3 / LEAST_LAW).abs() < 1e-12);
        assert_eq!(found.equation, "threshold * (1 + c), c(row_parity) = +11.0 % at 0, -11.0 % at 1");
        assert!(unexplained(&law(3.0, 0.3)).is_none() && unexplained(&law(9.0, 0.9 * LEAST_LAW)).is_none());
        let over = |moved: Moved, covariate: Covariate, taken: f64| unexplained(&Law { moved, covariate, ..law(9.0, taken) });
        let rate = over(Moved::Rate, Covariate::Radius, 0.3).unwrap();
        assert_eq!((rate.equation.as_str(), rate.insertion.as_str()), ("rate of ON less OFF events + c, c(radius) = +0.11 Hz at 0, -0.11 Hz at 1", "reset"));
        // The load of the array knows of the light where all of it flickers, and the phase of a frame of its exposure.
        assert!(over(Moved::Threshold, Covariate::GlobalRate, 0.03).is_none() && over(Moved::Threshold, Covariate::GlobalRate, 0.05).is_some());
        assert!(over(Moved::Threshold, Covariate::FramePhase, 0.03).is_some() && over(Moved::Stamps, Covariate::FramePhase, 0.3).is_none());
        let says = |search: &Search| from_refit(search, &Biases(Vec::new()), &|_, strength| strength);
        // Where light errs with history no law is believed, not even a weaker one.
        let of_history = Law { covariate: Covariate::TimeSinceLastEvent, ..law(9.0, 0.4) };
        assert!(says(&Search { laws: vec![of_history, law(9.0, 0.3)], ..Search::default() }).unexplained.is_none());
        let search = Search { laws: vec![law(9.0, 0.3)], ..Search::default() };
        assert!(says(&search).unexplained.is_some() && !says(&search).is_numerical);
        assert!(says(&Search { numerical: 0.3, ..search }).is_numerical);
    }

    #[test]
    fn a_refit_that_all_pixels_contradict_or_that_ran_to_the_end_is_not_believed() {
        let candidate = CANDIDATES.iter().position(|one| one.id == "clock_offset").unwrap();
        let explained = |strength: f64| Explained {
            candidate,
            strength,
            heldout: 0.25,
            nats_per_event: (-0.6, -0.5),
            blocks_better: 0.9,
            is_finished: true,
            cost: 0.1,
            ..Explained::default()
        };
        let linear = |strength: f64| Linear { candidate, strength, error: 0.1, taken: 0.05, significance: 5.0, better: 0.9 };
        let passes = |strength: f64, seen: Option<f64>| {
            let first = Refitted { explained: vec![explained(strength)], stated: 0.2, ..Refitted::default() };
            let search = Search { first, linear: seen.map(linear).into_iter().collect(), agreement: 0.9, ..Search::default() };
            from_refit(&search, &Biases(Vec::new()), &|_, strength| strength).alarm
        };
        assert!(passes(0.8, Some(0.7)) && passes(-0.8, Some(-0.7)));
        assert!(!passes(0.8, Some(-0.7)) && !passes(0.8, Some(0.05)) && !passes(6.0, Some(0.7)));
        // Where all pixels can say nothing of it, it must take away twice as much.
        assert!(!passes(0.8, None));
    }

    #[test]
    fn an_interval_holds_what_blocks_share_and_what_all_pixels_say_otherwise() {
        let candidate = CANDIDATES.iter().position(|one| one.id == "clock_offset").unwrap();
        let interval = |linear: &[Linear]| {
            let mut one = Proposal { candidate, value: -0.8, ci95: Some([-0.83, -0.77]), ..Proposal::default() };
            widen(&mut one, linear, &|_, strength| strength);
            one.ci95.unwrap()
        };
        let half = |[low, high]: [f64; 2]| {
            assert!((low + high + 1.6).abs() < 1e-12, "{low} to {high}");
            0.5 * (high - low)
        };
        assert!((half(interval(&[])) - libm::hypot(0.03, 1.96 * 0.04)).abs() < 1e-12);
        let linear = |candidate: usize| Linear { candidate, strength: -0.5, error: 0.1, taken: 0.05, significance: 5.0, better: 0.9 };
        let wide = half(interval(&[linear(candidate)]));
        assert!((wide - libm::hypot(0.03, 1.96 * libm::hypot(0.04, 0.15))).abs() < 1e-12, "{wide}");
        assert_eq!(interval(&[linear(candidate + 1)]), interval(&[]));
    }

    #[test]
    fn an_effect_with_one_testable_parameter_is_testable() {
        let place = |parameter: &str| CANDIDATES.iter().position(|one| one.id == "second_pole" && one.parameter == parameter).unwrap();
        let one = |parameter: &str, why: Option<&str>| likelihood::Detectable {
            candidate: place(parameter),
            not_testable: why.map(str::to_owned),
            ..likelihood::Detectable::default()
        };
        assert!(not_testable(&[one("tau", Some("dark")), one("tau_light", None)]).is_empty());
        assert_eq!(not_testable(&[one("tau", Some("dark")), one("tau_light", Some("dark"))]).len(), 1);
    }
}
