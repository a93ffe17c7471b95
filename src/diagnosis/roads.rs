//! The roads that estimate the scene, each in its own words, brought to the form that [`crate::verdict`] joins.

use crate::candidates::{CANDIDATES, Scales};
use crate::case::Case;
use crate::covariates::Covariate;
use crate::diagnose::{RoadKind, Setting};
use crate::knowledge::Knowledge;
use crate::likelihood::{self, Likelihood, LikelihoodSetting, likelihood};
use crate::nominal::Nominal;
use crate::open::{Law, Moved};
use crate::refit::Refitted;
use crate::report::{Detectable, NotTestable, short};
use crate::search::{Search, SearchSetting, search};
use crate::synthesis::{Ranked, Synthesis, SynthesisSetting, synthesis};
use crate::verdict::{Proposal, Road, Unexplained};

/// All roads, in the order in which they are run. Synthesis needs to know what recordings without an effect look like, and is left out without that knowledge.
pub fn all(knowledge: Option<Knowledge>) -> Vec<RoadKind> {
    let mut roads = vec![RoadKind::new(REFIT, run_refit), RoadKind::new("likelihood", run_likelihood)];
    roads.extend(knowledge.map(|knowledge| RoadKind::new("synthesis", move |case, setting| run_synthesis(case, &knowledge, setting))));
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
    let nominal = Nominal::new(case).map_err(|why| why.to_string())?;
    // Strengths are what refits are for.
    let setting = LikelihoodSetting { seed: setting.seed, refined: [5, 3, 0, 0], calibrated: 0, ..LikelihoodSetting::default() };
    Ok(from_likelihood(&likelihood(case, &nominal, &setting)?, &setting))
}

fn run_refit(case: &Case, _: &Setting) -> Result<Road, String> {
    let nominal = Nominal::new(case).map_err(|why| why.to_string())?;
    Ok(from_refit(&search(case, &nominal, &Scales::of(case, &nominal), &SearchSetting::default())?))
}

/// The road that refits.
pub const REFIT: &str = "refit";
/// Share of the cost that an effect must take away on pixels that it was not fitted to; nulls of other people's simulators reach 0.1.
const LEAST_TAKEN: f64 = 0.14;
/// And a second effect of what the first leaves.
const LEAST_TAKEN_SECOND: f64 = 0.2;
/// And the share of blocks that either must improve.
const LEAST_BETTER: f64 = 0.6;
/// And how much better either must foretell an event of pixels that it was not fitted to, nats: what makes that harder is no explanation, however much else it matches.
const LEAST_NATS: f64 = 0.01;
/// A candidate whose score is greater than the best by this share is believed a factor e less.
const SCORE_SOFTNESS: f64 = 0.1;

/// What refits say.
pub fn from_refit(found: &Search) -> Road {
    let second = found.second.as_ref().map_or_else(Vec::new, |second| told(second, LEAST_TAKEN_SECOND));
    let has_second = second.iter().any(|one| one.passed);
    let first = told(found.again.as_ref().filter(|_| has_second).unwrap_or(&found.first), LEAST_TAKEN);
    let best = found.first.leading().first().copied().cloned();
    let alarm = first.iter().any(|one| one.passed);
    Road {
        name: REFIT.into(),
        alarm,
        proposals: first,
        second,
        nats_per_event: best.as_ref().map(|best| best.nats_per_event).filter(|_| alarm),
        unexplained: found.laws.first().and_then(unexplained),
        is_numerical: found.numerical > f64::max(LEAST_TAKEN, best.as_ref().map_or(0.0, |best| best.heldout)),
        residual_left: best.as_ref().map(|best| best.cost / f64::max(found.first.stated, 1e-12)).filter(|_| alarm),
        ..Road::default()
    }
}

/// A law must take away this share of the squares of closures' changes.
const LEAST_LAW: f64 = 0.02;
/// And be so many standard errors from nothing.
const LEAST_SIGNIFICANCE: f64 = 4.0;

/// What no effect of the catalogue explains, from its measured curve. Light through the events errs in ways that depend on light, speed and history, and on which simulator
/// made a recording; where such a law is the strongest, or one of stamps, none is believed.
fn unexplained(law: &Law) -> Option<Unexplained> {
    let name = law.covariate.name();
    let point = |(at, value): (&f64, &f64)| match law.moved {
        Moved::Threshold => format!("{:+.1} % at {}", 100.0 * value, short(*at)),
        Moved::Stamps => format!("{:+.0} us at {}", 1e6 * value, short(*at)),
    };
    let points: Vec<String> = law.at.iter().zip(&law.value).map(point).collect();
    let rhythm = law.period_s.map_or_else(String::new, |period_s| format!(" of {} Hz", short(1.0 / period_s)));
    let is_believed = law.moved == Moved::Threshold && is_blind_to_light(law.covariate);
    (is_believed && law.significance >= LEAST_SIGNIFICANCE && law.taken >= LEAST_LAW).then(|| Unexplained {
        covariate: name.to_owned(),
        equation: format!("{}, c({name}){rhythm} = {}", law.moved.equation(), points.join(", ")),
        insertion: law.moved.insertion().to_owned(),
        score: law.taken / LEAST_LAW,
        nats: law.nats_per_change,
        law: Some(law.clone()),
    })
}

/// Does a covariate know nothing of the pixel's own light?
fn is_blind_to_light(covariate: Covariate) -> bool {
    use Covariate as C;
    matches!(covariate, C::RowParity | C::ColumnBlock | C::FramePhase | C::AcPhase | C::RowRate | C::GlobalRate)
}

fn told(found: &Refitted, least: f64) -> Vec<Proposal> {
    let leading = found.leading();
    let best = leading.first().map_or(1.0, |best| best.score());
    let mut proposals: Vec<Proposal> = leading
        .iter()
        .map(|one| Proposal {
            candidate: one.candidate,
            score: f64::max(one.heldout / least, 0.0),
            probability: libm::exp(libm::log(best / one.score()) / SCORE_SOFTNESS),
            value: one.value,
            ci95: Some(one.ci95),
            passed: one.heldout > least && one.blocks_better > LEAST_BETTER && one.nats_per_event.1 - one.nats_per_event.0 > LEAST_NATS,
            heldout_nats: None,
            heldout_nats_per_event: Some(one.nats_per_event.1 - one.nats_per_event.0),
        })
        .collect();
    normalise(&mut proposals);
    proposals
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
        // Where light errs with history no law is believed, not even a weaker one.
        let of_history = Law { covariate: Covariate::TimeSinceLastEvent, ..law(9.0, 0.4) };
        assert!(from_refit(&Search { laws: vec![of_history, law(9.0, 0.3)], ..Search::default() }).unexplained.is_none());
        let search = Search { laws: vec![law(9.0, 0.3)], ..Search::default() };
        assert!(from_refit(&search).unexplained.is_some() && !from_refit(&search).is_numerical);
        assert!(from_refit(&Search { numerical: 0.3, ..search }).is_numerical);
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
