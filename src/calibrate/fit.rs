//! Fits the numbers of the decision model to simulated recordings, with cross-validation.
//!
//! The two logistic functions are fitted by Newton's method with a weak prior, at the best of some discounts
//! of gains. Softness, offset and odds of uncatalogued dependences are searched one after the other. Both
//! maximise the likelihood of the truth. Every recording is scored by a model that was fitted without it.

use crate::example::CalibrationExample;
use nalgebra::{SMatrix, SVector};
use photocurrent_diagnosis::decide::DecisionThresholds;
use photocurrent_diagnosis::decide::model::{
    DecisionFeatures, DecisionModel, DecisionModels, NO_CURVES, SECOND, SOMETHING, logistic,
};
use photocurrent_diagnosis::verdict::IN_SET_SHARE as IN_SET;
use serde::{Deserialize, Serialize};

/// Softness beforehand, and its standard deviations: as kinds of scene with a hundred recordings or more
/// differ.
const USUAL_SOFTNESS: [f64; 2] = [-2.0, -0.5];
const SOFTNESS_PRIOR: [f64; 2] = [1.0, 0.5];

/// Standard deviation of the logistic weights beforehand, which are about zero.
const PRIOR: f64 = 3.0;
/// That of the share of the events that are explained: kinds of scene with a hundred recordings or more have
/// 0 to 0.5. Of fifty it came out as 1.5, and a black level that gains 0.7 nats an event was withheld.
const SHARE_PRIOR: f64 = 0.5;

const SOMETHING_PRIOR: [f64; SOMETHING] = [PRIOR, PRIOR, SHARE_PRIOR];

/// Logistic weights, zero beforehand within deviations.
fn newton<const N: usize>(examples: &[([f64; N], bool)], deviations: [f64; N]) -> [f64; N] {
    let precision = SVector::from(deviations.map(|deviation| 1.0 / (deviation * deviation)));
    let mut weights = SVector::<f64, N>::zeros();
    for _ in 0..50 {
        let mut gradient = -precision.component_mul(&weights);
        let mut curvature = SMatrix::<f64, N, N>::from_diagonal(&precision);
        for (facts, is_true) in examples {
            let x = SVector::<f64, N>::from_column_slice(facts);
            let p = logistic(weights.dot(&x));
            gradient += x * (f64::from(u8::from(*is_true)) - p);
            curvature += x * x.transpose() * (p * (1.0 - p));
        }
        let Some(step) = curvature.cholesky().map(|factor| factor.solve(&gradient)) else { break };
        weights += step;
        if step.norm() < 1e-9 {
            break;
        }
    }
    std::array::from_fn(|n| weights[n])
}

/// Discounts of each kind that are tried, a half apart.
const DISCOUNTS: usize = 7;

/// Discounts of curves that are tried.
const DISCOUNTS_OF_CURVES: [f64; 5] = [0.0, 0.5, 1.0, 2.0, NO_CURVES];

/// Log probability of the truth.
fn log_of<const N: usize>(examples: &[([f64; N], bool)], weights: &[f64; N]) -> f64 {
    let odds = |facts: &[f64; N]| -> f64 { facts.iter().zip(weights).map(|(a, b)| a * b).sum() };
    examples
        .iter()
        .map(|(facts, is_true)| {
            libm::log(f64::max(logistic(if *is_true { odds(facts) } else { -odds(facts) }), 1e-12))
        })
        .sum()
}

/// The model that makes the truth of these recordings most probable.
pub fn calibrate(examples: &[&CalibrationExample]) -> DecisionModel {
    let seen: Vec<(&CalibrationExample, &DecisionFeatures)> =
        examples.iter().filter_map(|one| Some((*one, one.facts.as_ref()?))).collect();
    // A second one counts where the first is right.
    let is_right = |one: &CalibrationExample, facts: &DecisionFeatures| {
        facts.first.first().is_some_and(|first| one.has_effect(&first.0))
    };
    let least_gain = seen
        .first()
        .map_or(DecisionModel::default(), |(_, facts)| *DecisionModels::default().for_scene(&facts.scene))
        .least_gain;
    let logistics = |(discount, of_curves): ([f64; 2], f64)| {
        // From no gain on: so the prior of the constant is one of the odds where nothing is seen.
        let from = libm::log(least_gain);
        let something: Vec<([f64; SOMETHING], bool)> = seen
            .iter()
            .map(|(one, facts)| {
                let [constant, gain, share] = facts.detection_features(discount, of_curves, least_gain);
                ([constant, gain - from, share], one.is_something())
            })
            .collect();
        let second: Vec<([f64; SECOND], bool)> = seen
            .iter()
            .filter(|(one, facts)| is_right(one, facts))
            .filter_map(|(one, facts)| {
                Some((facts.second_effect_features(discount)?, one.truth.effects.len() > 1))
            })
            .collect();
        let mut of_something = newton(&something, SOMETHING_PRIOR);
        if of_something[SOMETHING - 1] < 0.0 {
            // A scene that explains less of the events is no better reason: it is left out.
            let without: Vec<([f64; SOMETHING], bool)> =
                something.iter().map(|([one, gain, _], is)| ([*one, *gain, 0.0], *is)).collect();
            of_something = newton(&without, SOMETHING_PRIOR);
        }
        let of_second = newton(&second, [PRIOR; SECOND]);
        let likelihood = log_of(&something, &of_something) + log_of(&second, &of_second);
        of_something[0] -= of_something[1] * from;
        (
            likelihood,
            DecisionModel {
                something: of_something,
                second: of_second,
                discount,
                discount_of_curves: of_curves,
                softness: USUAL_SOFTNESS,
                random: 0.0,
                unnamed: [0.0; 3],
                least_gain,
            },
        )
    };
    let discounts =
        (0..DISCOUNTS * DISCOUNTS).map(|n| [0.5 * (n / DISCOUNTS) as f64, 0.5 * (n % DISCOUNTS) as f64]);
    let tried = discounts.flat_map(|discount| DISCOUNTS_OF_CURVES.map(|of_curves| (discount, of_curves)));
    let best = tried.map(logistics).max_by(|a, b| a.0.total_cmp(&b.0));
    let mut model = best.map_or_else(DecisionModel::default, |(_, model)| model);
    let named: Vec<_> = seen.iter().filter(|(one, _)| one.is_something()).collect();
    let fit = |model: &DecisionModel| -> f64 {
        named.iter().map(|(one, facts)| log_of_truth(model, one, facts)).sum::<f64>() - prior(model)
    };
    let mut best = fit(&model);
    let mut reach = 1.0;
    for _ in 0..40 {
        let mut is_better = false;
        for n in 0..6 {
            for by in [-reach, reach] {
                let Some(other) = shift_number(model, n, by) else { continue };
                let likelihood = fit(&other);
                if likelihood > best {
                    (model, best, is_better) = (other, likelihood, true);
                }
            }
        }
        if !is_better {
            reach *= 0.5;
        }
    }
    model
}

/// A model with one of its searched numbers shifted; `None` where the gain of a curve would lower the odds of
/// an uncatalogued dependence, as ten recordings once gave.
fn shift_number(mut model: DecisionModel, n: usize, by: f64) -> Option<DecisionModel> {
    match n {
        0 => model.softness[0] += 0.5 * by,
        1 => model.softness[1] += 0.25 * by,
        2 => model.random += by,
        _ => model.unnamed[n - 3] += by,
    }
    model.unnamed[1..].iter().all(|weight| *weight >= 0.0).then_some(model)
}

/// A weak prior: standard deviation 3 of log odds; of the softness around its usual value.
fn prior(model: &DecisionModel) -> f64 {
    let odds =
        model.unnamed.iter().chain([&model.random]).map(|odds| odds * odds).sum::<f64>() / (PRIOR * PRIOR);
    let soft: f64 = model
        .softness
        .iter()
        .zip(USUAL_SOFTNESS.iter().zip(SOFTNESS_PRIOR))
        .map(|(soft, (usual, deviation))| (soft - usual) / deviation)
        .map(|by| by * by)
        .sum();
    0.5 * (odds + soft)
}

/// Log probability of one of the true effects, conditional on a difference.
fn log_of_truth(model: &DecisionModel, one: &CalibrationExample, facts: &DecisionFeatures) -> f64 {
    let posterior = model.first(facts);
    let right = if one.truth.other.is_some() {
        posterior.unnamed
    } else {
        facts
            .first
            .iter()
            .zip(&posterior.each)
            .filter(|(first, _)| one.has_effect(&first.0))
            .map(|(_, p)| p)
            .sum()
    };
    // What never was a hypothesis does not constrain the model.
    if right > 0.0 { libm::log(right.max(1e-4)) } else { 0.0 }
}

/// Scores of a model on recordings that it was not fitted to.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ValidationScore {
    /// Recordings, and those where the method abstained.
    pub recordings: usize,
    /// See there.
    pub abstained: usize,
    /// Recordings without an effect, and those of them with a finding.
    pub nothing: (usize, usize),
    /// With one effect: how many, something claimed, it named first, it in the set.
    pub one: (usize, usize, usize, usize),
    /// With one effect: a second one named in addition.
    pub surplus: usize,
    /// Recordings with two effects: number, number with exactly both found, and sum of F1.
    pub two: (usize, usize, f64),
    /// In no catalogue: how many, unnamed, named with an effect.
    pub other: (usize, usize, usize),
    /// Reliability of findings: posterior from and to, findings, correct ones.
    pub reliability: Vec<(f64, f64, usize, usize)>,
    /// Mean log probability of whether something differs.
    pub log_something: f64,
}

/// Cross-validates in `folds` parts, with the claims that `decision` makes of probabilities.
pub fn validate(
    examples: &[CalibrationExample],
    folds: usize,
    decision: &DecisionThresholds,
) -> ValidationScore {
    let mut sums = ValidationScore {
        reliability: (0..5).map(|n| (0.2 * n as f64, 0.2 * (n + 1) as f64, 0, 0)).collect(),
        ..ValidationScore::default()
    };
    for fold in 0..folds {
        let training: Vec<&CalibrationExample> =
            examples.iter().enumerate().filter(|(n, _)| n % folds != fold).map(|(_, one)| one).collect();
        let model = calibrate(&training);
        examples
            .iter()
            .enumerate()
            .filter(|(n, _)| n % folds == fold)
            .for_each(|(_, one)| validate_example(&model, one, decision, &mut sums));
    }
    sums.log_something /= f64::max((sums.recordings - sums.abstained) as f64, 1.0);
    sums
}

fn validate_example(
    model: &DecisionModel,
    one: &CalibrationExample,
    decision: &DecisionThresholds,
    sums: &mut ValidationScore,
) {
    sums.recordings += 1;
    let Some(facts) = &one.facts else {
        sums.abstained += 1;
        return;
    };
    let posterior = model.first(facts);
    sums.log_something += libm::log(f64::max(
        if one.is_something() { posterior.something } else { 1.0 - posterior.something },
        1e-9,
    ));
    let claimed = posterior.something >= decision.least;
    let top = facts.first.iter().zip(&posterior.each).max_by(|a, b| a.1.total_cmp(b.1));
    let is_unnamed = top.is_none_or(|(_, p)| posterior.unnamed > *p);
    let first = top.filter(|_| claimed && !is_unnamed);
    let set: Vec<&str> = first.map_or_else(Vec::new, |(_, most)| {
        facts
            .first
            .iter()
            .zip(&posterior.each)
            .filter(|(_, p)| **p > IN_SET * most)
            .map(|((id, ..), _)| id.as_str())
            .collect()
    });
    let second = model
        .second(facts)
        .filter(|second| first.is_some() && second.something >= decision.least_second)
        .and_then(|second| {
            facts
                .second
                .iter()
                .zip(second.each)
                .max_by(|a, b| a.1.total_cmp(&b.1))
                .map(|((id, ..), _)| id.as_str())
        })
        .filter(|id| !set.contains(id));
    let right = first.is_some_and(|((id, ..), _)| one.has_effect(id));
    if let Some((_, p)) = first {
        let sure = posterior.something * p;
        if let Some(bin) = sums.reliability.iter_mut().find(|bin| sure <= bin.1) {
            bin.2 += 1;
            bin.3 += usize::from(right);
        }
    }
    match (one.truth.other.is_some(), one.truth.effects.len()) {
        (true, _) => {
            sums.other.0 += 1;
            sums.other.1 += usize::from(claimed && is_unnamed);
            sums.other.2 += usize::from(first.is_some());
        }
        (_, 0) => {
            sums.nothing.0 += 1;
            sums.nothing.1 += usize::from(claimed);
        }
        (_, 1) => {
            sums.one.0 += 1;
            sums.one.1 += usize::from(claimed);
            sums.one.2 += usize::from(right);
            sums.one.3 += usize::from(set.iter().any(|id| one.has_effect(id)));
            sums.surplus += usize::from(second.is_some());
        }
        _ => {
            let named: Vec<&str> = first.map(|((id, ..), _)| id.as_str()).into_iter().chain(second).collect();
            let hits = named.iter().filter(|id| one.has_effect(id)).count();
            sums.two.0 += 1;
            sums.two.1 += usize::from(hits == 2);
            sums.two.2 += if named.is_empty() { 0.0 } else { 2.0 * hits as f64 / (named.len() + 2) as f64 };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulated::InjectedFault;
    use photocurrent_core::random::Random;
    use photocurrent_diagnosis::decide::model::{KINDS, LogGains};

    fn features(gain: f64, share_of_other: f64) -> DecisionFeatures {
        DecisionFeatures {
            gains: LogGains { sized: libm::log(gain), random: -6.0, swing: -6.0 },
            second_gains: Some(LogGains { sized: libm::log(0.1 * gain), random: -6.0, swing: -6.0 }),
            first: vec![("clock_offset".into(), 1.0, false), ("second_pole".into(), share_of_other, false)],
            second: vec![("leak_events".into(), 1.0, false)],
            open: [-3.0, -2.0],
            share: 0.0,
            scene: String::new(),
        }
    }

    /// Recordings with an effect or without, whose gains state which by known odds.
    fn examples(count: u64) -> Vec<CalibrationExample> {
        let mut random = Random::new(8, &[]);
        (0..count)
            .map(|_| {
                let gain = libm::exp(-6.0 + 5.0 * random.uniform());
                let is_something = random.uniform() < logistic(9.0 + 3.0 * libm::log(gain));
                let truth = InjectedFault {
                    effects: if is_something {
                        vec![("clock_offset".into(), "offset".into(), 1.0)]
                    } else {
                        Vec::new()
                    },
                    ..InjectedFault::default()
                };
                CalibrationExample { truth, found: None, facts: Some(features(gain, 0.7)) }
            })
            .collect()
    }

    /// The recordings that the built-in numbers are calibrated on.
    fn training() -> Vec<CalibrationExample> {
        let sets = [
            include_str!("../../data/diagnosis/examples.jsonl"),
            include_str!("../../data/diagnosis/examples-parts.jsonl"),
            include_str!("../../data/diagnosis/examples-given.jsonl"),
            include_str!("../../data/diagnosis/examples-pixels.jsonl"),
            include_str!("../../data/diagnosis/examples-joint.jsonl"),
        ];
        sets.iter().flat_map(|text| text.lines()).map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    /// Those of one kind of scene.
    fn examples_of_kind<'a>(examples: &'a [CalibrationExample], kind: &str) -> Vec<&'a CalibrationExample> {
        examples.iter().filter(|one| one.facts.as_ref().is_some_and(|facts| facts.scene == kind)).collect()
    }

    #[test]
    fn cross_validation_is_what_the_docs_say() {
        let examples = training();
        let without = examples.iter().filter(|one| one.facts.is_none()).count();
        assert_eq!((examples.len(), without), (1232, 203));
        // Nothing wrong, claimed; one effect, claimed, first, in the set; two, both; in no catalogue,
        // unnamed, named: the table of docs/diagnosis.md.
        let named = |kind: &str| {
            let of_kind: Vec<CalibrationExample> =
                examples_of_kind(&examples, kind).into_iter().cloned().collect();
            let ValidationScore { nothing, one, two, other, .. } =
                validate(&of_kind, 5, &DecisionThresholds::default());
            (nothing, one, (two.0, two.1), other)
        };
        assert_eq!(named("picture"), ((214, 6), (241, 103, 81, 93), (75, 11), (45, 18, 5)));
        assert_eq!(named("patches"), ((54, 0), (70, 14, 11, 13), (18, 0), (16, 1, 0)));
        assert_eq!(named("given"), ((36, 1), (46, 36, 31, 31), (9, 2), (9, 6, 1)));
        assert_eq!(named("pixels"), ((42, 1), (66, 18, 9, 11), (16, 0), (10, 0, 4)));
        assert_eq!(named("joint"), ((19, 0), (27, 14, 9, 9), (7, 0), (9, 6, 1)));
    }

    #[test]
    fn the_built_in_numbers_are_those_of_the_training_sets() {
        let examples = training();
        let numbers = |model: DecisionModel| -> Vec<f64> {
            let DecisionModel { something, second, discount, softness, random, unnamed, least_gain, .. } =
                model;
            let single = [random, least_gain, model.discount_of_curves];
            [&something[..], &second, &discount, &softness, &unnamed, &single].concat()
        };
        for kind in KINDS {
            let (found, built_in) = (
                numbers(calibrate(&examples_of_kind(&examples, kind))),
                numbers(*DecisionModels::default().for_scene(kind)),
            );
            found.iter().zip(&built_in).for_each(|(a, b)| {
                assert!((a - b).abs() < 0.02 * (1.0 + b.abs()), "{kind}: {found:?} are {built_in:?}")
            });
        }
    }

    #[test]
    fn the_numbers_of_frames_and_events_hold_where_curves_are_scored_against_the_picture() {
        // Numbers that are fitted to curves on residuals, on recordings that none of them saw so.
        let text = include_str!("../../data/diagnosis/examples-joint-scored.jsonl");
        let examples: Vec<CalibrationExample> =
            text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        let (models, least) = (DecisionModels::default(), DecisionThresholds::default().least);
        let mut counts = [(0, 0); 3];
        let (mut unnamed, mut first) = (0, 0);
        for CalibrationExample { truth, facts, .. } in &examples {
            let (Some(facts), true) = (facts, truth.effects.len() < 2) else { continue };
            let found = models.for_scene("joint").first(facts);
            let kind = if truth.other.is_some() { 2 } else { truth.effects.len() };
            let most = found.each.iter().copied().fold(0.0, f64::max);
            counts[kind].0 += 1;
            counts[kind].1 += usize::from(found.something >= least);
            if found.something >= least {
                unnamed += usize::from(kind == 2 && found.unnamed > most);
                let name = found.each.iter().position(|each| *each == most).map(|n| &facts.first[n].0);
                let is_right = truth.effects.first().is_some_and(|(id, ..)| name == Some(id));
                first += usize::from(is_right && found.unnamed <= most);
            }
        }
        assert_eq!((examples.len(), counts, unnamed, first), (72, [(14, 0), (26, 13), (8, 7)], 7, 11));
    }

    #[test]
    fn odds_that_recordings_were_made_with_are_found_again() {
        let examples = examples(3_000);
        let model = calibrate(&examples.iter().collect::<Vec<&CalibrationExample>>());
        for gain in [0.01, 0.05, 0.2] {
            let (found, made) =
                (model.first(&features(gain, 0.7)).something, logistic(9.0 + 3.0 * libm::log(gain)));
            assert!((found - made).abs() < 0.06, "at {gain}: {found} is {made}");
        }
    }

    #[test]
    fn a_name_that_is_right_with_a_clear_lead_is_claimed_and_one_without_is_not() {
        let mut examples = examples(600);
        // With a close second, either is as often right.
        for (n, one) in examples.iter_mut().enumerate().filter(|(n, _)| n % 2 == 0) {
            one.facts = Some(features(0.5, 0.99));
            let id = if n % 4 == 0 { "clock_offset" } else { "second_pole" };
            one.truth.effects = vec![(id.into(), String::new(), 1.0)];
        }
        let model = calibrate(&examples.iter().collect::<Vec<&CalibrationExample>>());
        let (clear, close) = (model.first(&features(0.5, 0.7)), model.first(&features(0.5, 0.99)));
        assert!(clear.each[0] > 0.8 && (0.35..0.65).contains(&close.each[0]), "{clear:?} {close:?}");
    }

    #[test]
    fn what_was_not_seen_judges_and_claims_are_counted_by_kind() {
        let mut examples = examples(500);
        examples.push(CalibrationExample::new(InjectedFault::default(), None));
        let found = validate(&examples, 5, &DecisionThresholds::default());
        assert_eq!((found.recordings, found.abstained), (501, 1));
        assert_eq!(found.nothing.0 + found.one.0, 500);
        assert!(found.one.2 > found.one.0 / 2 && found.nothing.1 < found.nothing.0 / 5, "{found:?}");
    }
}
