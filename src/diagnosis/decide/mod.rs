//! From the evidence of one scene ([`crate::residual::evidence`]) to probabilities of effects, in the form
//! that [`crate::verdict`] joins.
//!
//! A scene of frames alone cannot absorb an effect of events. An effect that is not detected there is smaller
//! than its limit, which follows from its standard error ([`limits`]).
//!
//! - `model`: probabilities.
//!
//! The crate `photocurrent-calibrate` fits its numbers.

use crate::candidates::{CANDIDATES, Signs};
use crate::report::MinimumDetectable;
use crate::residual::evidence::{RankedEffect, SceneEvidence};
use crate::residual::located::{EffectLocations, LocatedEffect};
use crate::stages::{EffectProposal, SceneDecision, Unexplained};
use crate::verdict::IN_SET_SHARE;
use model::{DecisionFeatures, DecisionModels, KINDS, Posterior, hypotheses};
use photocurrent_scene::nominal::Nominal;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub mod model;

/// Decision thresholds: probabilities and misfits from which effects are reported.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(extend("additionalProperties" = false))]
pub struct DecisionThresholds {
    /// Least probability that the recording differs from the description, 0 to 1, at which that is reported.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub least: f64,
    /// Least probability of a second effect, 0 to 1, at which it is reported.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub least_second: f64,
    /// The decision abstains where simulated events of the stated sensor miss their thresholds on their own
    /// scene by more than this share of the threshold (median).
    #[schemars(range(min = 0.0))]
    pub most_control: f64,
    /// It also abstains, on a scene fitted to frames, where the best effect leaves more than this share.
    #[schemars(range(min = 0.0))]
    pub most_left: f64,
    /// Where a scene leaves more than this share of the thresholds, limits of detection grow with it. Set on
    /// a few recordings, not calibrated.
    #[schemars(range(min = 0.0))]
    pub usual_left: f64,
    /// Error of sizes that all blocks share, as a share of the departure.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub shared_error: f64,
    /// The model's numbers, for each kind of scene.
    #[serde(flatten)]
    pub models: DecisionModels,
}

impl Default for DecisionThresholds {
    fn default() -> DecisionThresholds {
        DecisionThresholds {
            least: 0.9,
            least_second: 0.6,
            most_control: 0.3,
            most_left: 0.3,
            usual_left: 0.12,
            shared_error: 0.02,
            models: DecisionModels::default(),
        }
    }
}

/// Computes the decision on one scene: probabilities of all effects and limits of detection.
///
/// # Errors
/// When the control's misfit exceeds `most_control`, or the misfit with the best effect exceeds `most_left`.
pub fn decide(
    found: &SceneEvidence,
    nominal: &Nominal,
    decision: &DecisionThresholds,
) -> Result<SceneDecision, String> {
    if found.control_median > decision.most_control {
        return Err(format!(
            "events of the nominal sensor on its own scene miss their thresholds by {:.2} of them: this \
             sensor is not modelled well enough",
            found.control_median
        ));
    }
    // Known light is not at fault.
    let is_known = found.scene == KINDS[1];
    if !is_known && found.left[0] > decision.most_left {
        return Err(format!(
            "events miss their thresholds by {:.2} of them, and no effect explains it on this scene",
            found.left[0]
        ));
    }
    Ok(decide_by_model(found, nominal, decision))
}

/// The least gain at which a difference is reported, nats per event.
fn needed_gain(found: &SceneEvidence, decision: &DecisionThresholds) -> f64 {
    let log_odds = libm::log(decision.least / (1.0 - decision.least));
    decision.models.for_scene(&found.scene).needed_gain(log_odds, libm::log(found.covered().max(1e-3)))
}

fn decide_by_model(found: &SceneEvidence, nominal: &Nominal, decision: &DecisionThresholds) -> SceneDecision {
    let facts = DecisionFeatures::from_evidence(found);
    let posterior = decision.models.for_scene(&found.scene).first(&facts);
    let is_something = posterior.something >= decision.least;
    let first = proposals(
        found,
        &hypotheses(&found.ranked, &found.random, found.noise[0]),
        &posterior,
        posterior.something / decision.least,
        nominal,
        decision,
    );
    let most = first.iter().map(|one| one.probability).fold(0.0, f64::max);
    let is_unnamed = is_something && posterior.unnamed > most;
    let second = decision.models.for_scene(&found.scene).second(&facts).map_or_else(Vec::new, |posterior| {
        let list = hypotheses(&found.second, &found.random_second, found.noise[1]);
        proposals(found, &list, &posterior, posterior.something / decision.least_second, nominal, decision)
    });
    // On a scene that follows events, the curve that was estimated with it, without any effect.
    let [one, other] = if found.follows_events() {
        [&found.open, &found.open_second]
    } else {
        [&found.open_second, &found.open]
    };
    let curve = one.first().or(other.first());
    let least_near = IN_SET_SHARE * most;
    let near: Vec<String> = first
        .iter()
        .filter(|one| one.probability > IN_SET_SHARE * posterior.unnamed)
        .map(|one| one.id().to_owned())
        .collect();
    // What is not claimed stays to be compared with what is.
    let unclaimed =
        |of: Vec<EffectProposal>| of.into_iter().map(|one| EffectProposal { passed: false, ..one }).collect();
    SceneDecision {
        name: found.scene.clone(),
        share: found.share,
        span_ns: found.span_ns,
        part: found.part,
        other_scene: String::new(),
        detected: is_something,
        proposals: if is_unnamed { unclaimed(first) } else { first },
        second: if is_unnamed { Vec::new() } else { second },
        is_unnamed_near: is_something && !is_unnamed && curve.is_some() && posterior.unnamed > least_near,
        unexplained: curve.filter(|_| is_unnamed).map(|curve| Unexplained {
            also_possible: near,
            ..Unexplained::from_dependence(&curve.dependence, posterior.something / decision.least)
        }),
        detectability: limits(found, nominal, decision),
        nats_per_event: Some(found.nats_per_event),
        ks: Some(found.ks),
        residual_left: Some(found.left[0] / f64::max(found.median, 1e-12)),
        located: EffectLocations {
            first: located(&found.ranked),
            second: located(&found.second),
            unnamed: curve.filter(|_| is_unnamed).and_then(|curve| curve.located.clone()),
        },
        estimated: Vec::new(),
    }
}

/// Minimum detectable size of each effect, and its estimated size.
///
/// An effect size s gains `information s^2 / 2` nats per event to first order. Its limit is the size at whose
/// gain the model's probability reaches [`DecisionThresholds::least`]. Where the misfit of the scene exceeds
/// [`DecisionThresholds::usual_left`], limits grow in proportion.
pub fn limits(
    found: &SceneEvidence,
    nominal: &Nominal,
    decision: &DecisionThresholds,
) -> Vec<MinimumDetectable> {
    let needed = needed_gain(found, decision);
    let is_known = found.scene == KINDS[1];
    let errs = if is_known { 1.0 } else { f64::max(found.left[0] / decision.usual_left, 1.0) };
    let has_limit = |one: &&RankedEffect| {
        let kind = &CANDIDATES[one.candidate];
        one.information > 0.0 && kind.signs != Signs::Switch && !kind.is_limit() && one.unit != 0.0
    };
    let one = |one: &RankedEffect| {
        let kind = &CANDIDATES[one.candidate];
        let (parameter, unit) = kind.json_key();
        let needed = if kind.sought.is_of_swing {
            needed * libm::exp(decision.models.for_scene(&found.scene).discount[1])
        } else {
            needed
        };
        let least = |information: f64| (errs * libm::sqrt(2.0 * needed / information) * one.unit).abs();
        MinimumDetectable {
            id: kind.id.to_owned(),
            parameter,
            estimate: Some(kind.nominal_value(nominal) + one.effect_size * one.unit),
            standard_error: Some((one.error * one.unit).abs()),
            minimal_detectable: least(one.information),
            of_known_light: (one.of_known_light > 0.0).then(|| least(one.of_known_light)),
            usual: Some(one.unit.abs()),
            unit: unit.to_owned(),
        }
    };
    let mut limits: Vec<(usize, MinimumDetectable)> =
        found.ranked.iter().filter(has_limit).map(|ranked| (ranked.candidate, one(ranked))).collect();
    limits.sort_by_key(|limit| limit.0);
    limits.into_iter().map(|limit| limit.1).filter(|limit| limit.minimal_detectable.is_finite()).collect()
}

/// Where effects are, as far as that was measured.
fn located(ranked: &[RankedEffect]) -> Vec<(usize, LocatedEffect)> {
    ranked.iter().filter_map(|one| Some((one.candidate, one.located.clone()?))).collect()
}

/// One proposal for each hypothesis, best first; `score`: see [`EffectProposal::score`].
fn proposals(
    found: &SceneEvidence,
    list: &[&RankedEffect],
    posterior: &Posterior,
    score: f64,
    nominal: &Nominal,
    decision: &DecisionThresholds,
) -> Vec<EffectProposal> {
    let events = found.events as f64;
    let one = |(one, probability): (&&RankedEffect, &f64)| {
        let width = one.error / f64::max(one.effect_size.abs(), 1e-12);
        let nothing = CANDIDATES[one.candidate].nominal_value(nominal);
        let error = 1.96 * libm::hypot(width, decision.shared_error) * (one.value - nothing).abs();
        EffectProposal {
            candidate: one.candidate,
            score,
            probability: *probability,
            value: one.value,
            ci95: (error > 0.0 && error.is_finite()).then_some([one.value - error, one.value + error]),
            passed: score >= 1.0,
            heldout_nats: Some(one.gain_beyond_control() * events),
            heldout_nats_ci95: (one.gain_error > 0.0).then(|| {
                [-1.96, 1.96].map(|sigmas| (one.gain_beyond_control() + sigmas * one.gain_error) * events)
            }),
            heldout_nats_per_event: Some(one.gain_beyond_control()),
            ks: Some(one.ks).filter(|ks| *ks > 0.0),
        }
    };
    list.iter().zip(&posterior.each).map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use model::DecisionModel;

    fn ranked(id: &str, gain: f64, control_gain: f64) -> RankedEffect {
        let candidate = CANDIDATES.iter().position(|one| one.id == id).unwrap();
        RankedEffect {
            candidate,
            gain,
            control_gain,
            effect_size: 1.0,
            value: 1.0,
            is_exact: true,
            is_material: true,
            ..RankedEffect::default()
        }
    }

    fn decide_nominal(found: &SceneEvidence) -> SceneDecision {
        super::decide_by_model(found, &testing::case().nominal().unwrap(), &DecisionThresholds::default())
    }

    #[test]
    fn gains_count_from_the_control() {
        let found = SceneEvidence {
            share: 1.0,
            left: [0.01; 2],
            ranked: vec![ranked("clock_offset", 0.5, 0.1), ranked("leak_events", 0.2, 0.19)],
            ..SceneEvidence::default()
        };
        let decided = decide_nominal(&found);
        assert!(decided.detected && decided.proposals[0].passed);
        assert!((decided.proposals[0].heldout_nats_per_event.unwrap() - 0.4).abs() < 1e-12);
        assert!(decided.proposals[0].probability > 0.9);
    }

    #[test]
    fn what_gains_almost_nothing_is_no_finding() {
        let found = SceneEvidence {
            share: 1.0,
            left: [0.05; 2],
            ranked: vec![ranked("clock_offset", 0.004, 0.001)],
            ..SceneEvidence::default()
        };
        assert!(!decide_nominal(&found).detected);
    }

    #[test]
    fn what_changes_the_swing_of_light_needs_more_where_scenes_err_in_it() {
        let nominal = testing::case().nominal().unwrap();
        let model =
            DecisionModel { something: [6.0, 2.0, 0.0], discount: [0.0, 2.0], ..DecisionModel::default() };
        let decision = DecisionThresholds {
            models: DecisionModels { picture: model, ..DecisionModels::default() },
            ..DecisionThresholds::default()
        };
        let of = |id: &str| SceneEvidence {
            share: 1.0,
            ranked: vec![RankedEffect { information: 2.0, unit: 1.0, ..ranked(id, 0.3, 0.0) }],
            ..SceneEvidence::default()
        };
        let decided = |id: &str| super::decide_by_model(&of(id), &nominal, &decision);
        // 6 + 2 ln 0.3 is 3.6, and 4 less for a swing.
        assert!(decided("clock_offset").detected && !decided("threshold_scale").detected);
        let [clock, swing] =
            ["clock_offset", "threshold_scale"].map(|id| decided(id).detectability[0].minimal_detectable);
        assert!((swing / clock - libm::exp(1.0)).abs() < 1e-9, "gains grow with the square of a size");
    }

    #[test]
    fn nothing_is_claimed_where_the_best_effect_leaves_too_much() {
        let nominal = testing::case().nominal().unwrap();
        let of = |left: f64, gain: f64| SceneEvidence {
            share: 1.0,
            left: [left; 2],
            ranked: vec![ranked("clock_offset", gain, 0.0)],
            ..SceneEvidence::default()
        };
        let decided = |left: f64, gain: f64| {
            decide(&of(left, gain), &nominal, &DecisionThresholds::default()).map(|decided| decided.detected)
        };
        assert_eq!((decided(0.05, 0.01), decided(0.2, 2.0)), (Ok(false), Ok(true)));
        assert!(decided(0.4, 2.0).unwrap_err().contains("no effect explains it"));
    }

    #[test]
    fn limits_grow_with_what_the_scene_leaves_beyond_what_is_usual() {
        let nominal = testing::case().nominal().unwrap();
        let of = |scene: &str, left: f64| SceneEvidence {
            scene: scene.into(),
            share: 1.0,
            left: [left; 2],
            ranked: vec![RankedEffect { information: 2.0, unit: 1.0, ..ranked("clock_offset", 0.0, 0.0) }],
            ..SceneEvidence::default()
        };
        let limit = |scene: &str, left: f64| {
            limits(&of(scene, left), &nominal, &DecisionThresholds::default())[0].minimal_detectable
        };
        let usual = limit("picture", 0.05);
        assert!((limit("picture", 0.12) - usual).abs() < 1e-12);
        assert!((limit("picture", 0.24) - 2.0 * usual).abs() < 1e-12);
        // Known light is not at fault.
        assert!((limit("given", 0.24) - limit("given", 0.05)).abs() < 1e-12);
    }

    #[test]
    fn alike_gains_share_their_probability() {
        let found = SceneEvidence {
            share: 1.0,
            ranked: vec![
                ranked("clock_offset", 1.0, 0.0),
                ranked("second_pole", 0.99, 0.0),
                ranked("blur", 0.5, 0.0),
            ],
            ..SceneEvidence::default()
        };
        let decided = decide_nominal(&found).proposals;
        assert!(
            decided[0].probability < 0.6 && decided[1].probability > 0.4 && decided[2].probability < 0.05
        );
    }
}
