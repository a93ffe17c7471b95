//! The decision model: from gains of all hypotheses to posterior probabilities.
//!
//! - Probability that the recording differs: a logistic function of the log gains of the best effect and of a
//!   second effect in addition to it.
//! - Probability of each effect: a softmax of log gains relative to the best one. Random effects and
//!   uncatalogued dependences have offsets of their own.
//! - Probability of a second effect: a logistic function of its log gain, alone and relative to the first.
//!
//! Its numbers are calibrated on simulated recordings (the crate `photocurrent-calibrate`).

use crate::candidates::CANDIDATES;
pub use crate::residual::evidence::KINDS;
use crate::residual::evidence::{RankedEffect, SceneEvidence};
use crate::residual::open::CovariateCurve;
use schemars::{JsonSchema, Schema};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};

/// Numbers of a model; those that are left out are the built-in ones.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(transform = |schema: &mut Schema| drop(schema.remove("required")))]
pub struct DecisionModel {
    /// Log odds of a difference: a constant, and weights of three log features: gain of the best effect and
    /// of a second one, and share of the events that are evaluated.
    pub something: [f64; SOMETHING],
    /// Log odds of a second effect: constant, and weights of the logarithms of its gain and of that over the
    /// first's.
    pub second: [f64; SECOND],
    /// Discounts on the log gains of random effects and of effects that change the swing of light between
    /// events: both gain from errors of the scene.
    pub discount: [f64; 2],
    /// Discount on the log gain of the best uncatalogued curve.
    pub discount_of_curves: f64,
    /// Log of the softmax temperature over log gain: its value at 1 nat per event, and its slope over the log
    /// of the best gain.
    pub softness: [f64; 2],
    /// Log odds of a random effect over one with a size, at the same gain.
    pub random: f64,
    /// Log odds of an uncatalogued dependence: a constant, and weights of two log gains of the best curve
    /// relative to the best effect: beyond that effect, and alone.
    pub unnamed: [f64; 3],
    /// Gains below this do not indicate a difference, nats per event: nominal recordings gain as much.
    #[schemars(range(min = 0.0))]
    pub least_gain: f64,
}

/// Numbers of [`DecisionModel::detection_features`].
pub const SOMETHING: usize = 3;
/// Numbers of [`DecisionModel::second_effect_features`].
pub const SECOND: usize = 3;

impl Default for DecisionModel {
    /// `photocurrent-calibrate`, docs/diagnosis.md.
    fn default() -> DecisionModel {
        DecisionModel {
            something: [3.612, 0.797, 0.533],
            second: [1.576, 0.344, 0.248],
            discount: [1.5, 1.0],
            discount_of_curves: 2.0,
            softness: [-2.588, -0.92],
            random: 0.119,
            unnamed: [-0.498, 0.698, 0.594],
            least_gain: LEAST_GAIN,
        }
    }
}

/// Decision models by kind of scene: the misfit without an effect differs between kinds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct DecisionModels {
    /// The model of a moving picture, and of every kind of scene that has none of its own.
    #[serde(deserialize_with = "deserialise_over_defaults::<_, 0>")]
    pub picture: DecisionModel,
    /// The model of a scene in parts, or before a still ground.
    #[serde(deserialize_with = "deserialise_over_defaults::<_, 2>")]
    pub patches: DecisionModel,
    /// The model of known light.
    #[serde(deserialize_with = "deserialise_over_defaults::<_, 1>")]
    pub given: DecisionModel,
    /// The model of the light of pixels, free in time.
    #[serde(deserialize_with = "deserialise_over_defaults::<_, 3>")]
    pub pixels: DecisionModel,
    /// The model of one moving picture of frames and events together.
    #[serde(deserialize_with = "deserialise_over_defaults::<_, 4>")]
    pub joint: DecisionModel,
}

/// The stated numbers of a model, and the built-in ones of its kind of scene ([`KINDS`]) for the rest.
fn deserialise_over_defaults<'de, D: Deserializer<'de>, const KIND: usize>(
    stated: D,
) -> Result<DecisionModel, D::Error> {
    let stated: Map<String, Value> = Map::deserialize(stated)?;
    let mut numbers =
        serde_json::to_value(DecisionModels::default().for_scene(KINDS[KIND])).map_err(D::Error::custom)?;
    stated.into_iter().for_each(|(name, number)| numbers[name] = number);
    DecisionModel::deserialize(numbers).map_err(D::Error::custom)
}

impl DecisionModels {
    /// Of a kind of scene ([`SceneEvidence::scene`]).
    pub fn for_scene(&self, scene: &str) -> &DecisionModel {
        match KINDS.iter().position(|kind| *kind == scene) {
            Some(1) => &self.given,
            Some(2) => &self.patches,
            Some(3) => &self.pixels,
            Some(4) => &self.joint,
            _ => &self.picture,
        }
    }
}

impl Default for DecisionModels {
    /// `photocurrent-calibrate`, docs/diagnosis.md.
    fn default() -> DecisionModels {
        DecisionModels {
            picture: DecisionModel::default(),
            patches: DecisionModel::for_patches(),
            given: DecisionModel::for_known_light(),
            pixels: DecisionModel::for_pixels(),
            joint: DecisionModel::for_joint(),
        }
    }
}

impl DecisionModel {
    /// The built-in numbers for scenes in parts: `photocurrent-calibrate --scene parts`.
    pub fn for_patches() -> DecisionModel {
        DecisionModel {
            something: [2.356, 0.630, 0.062],
            second: [2.601, 0.951, 0.607],
            discount: [1.5, 0.5],
            discount_of_curves: 2.0,
            softness: [-1.661, -0.447],
            random: 2.332,
            unnamed: [0.359, 0.887, 0.0],
            least_gain: LEAST_GAIN,
        }
    }

    /// The built-in numbers for the light of pixels: `photocurrent-calibrate --scene pixels`.
    pub fn for_pixels() -> DecisionModel {
        DecisionModel {
            something: [7.647, 2.275, 0.0],
            second: [0.708, -0.684, 2.119],
            discount: [3.0, 0.0],
            discount_of_curves: 0.0,
            softness: [-2.039, -0.346],
            random: 0.0,
            unnamed: [-0.097, 0.204, 0.0],
            least_gain: 0.04,
        }
    }

    /// The built-in numbers for one moving picture of frames and events: `photocurrent-calibrate --scene
    /// joint`.
    pub fn for_joint() -> DecisionModel {
        DecisionModel {
            something: [11.270, 3.821, 0.030],
            second: [-0.150, 0.239, 0.079],
            discount: [1.5, 0.5],
            discount_of_curves: 0.5,
            softness: [-3.260, -0.781],
            random: -2.469,
            unnamed: [0.711, 0.184, 0.773],
            least_gain: 0.05,
        }
    }

    /// The built-in numbers for known light: `photocurrent-calibrate --scene given`.
    pub fn for_known_light() -> DecisionModel {
        DecisionModel {
            something: [4.148, 1.102, 0.0],
            second: [1.693, 0.319, 0.471],
            discount: [0.0, 0.0],
            discount_of_curves: NO_CURVES,
            softness: [-3.183, -0.115],
            random: -1.930,
            unnamed: [1.540, 2.172, 0.405],
            least_gain: LEAST_GAIN,
        }
    }
}

/// Logarithms between which a softness lies.
const SOFTNESS: (f64, f64) = (-5.0, 2.0);

/// A discount of curves with which they are no sign that something differs.
pub const NO_CURVES: f64 = 10.0;

/// Floor of gains, nats per event.
const LEAST_GAIN: f64 = 1e-3;

/// Log of the best gains by class of effect, gains in nats per event.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LogGains {
    /// Of other effects with a size.
    pub sized: f64,
    /// Of random ones.
    pub random: f64,
    /// Of effects that change the swing of light between events. Defaults to the floor in older lists.
    #[serde(default = "least_log_gain")]
    pub swing: f64,
}

fn least_log_gain() -> f64 {
    libm::log(LEAST_GAIN)
}

impl LogGains {
    fn best(&self) -> f64 {
        self.discounted([0.0; 2])
    }

    fn discounted(&self, discount: [f64; 2]) -> f64 {
        f64::max(self.sized, f64::max(self.random - discount[0], self.swing - discount[1]))
    }
}

/// Features of the decision model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DecisionFeatures {
    /// Of the first effect.
    pub gains: LogGains,
    /// Of a second one; none where there is none.
    pub second_gains: Option<LogGains>,
    /// Hypotheses, best first: catalogue id, gain over the best one's, is it random.
    pub first: Vec<(String, f64, bool)>,
    /// The same in addition to the first.
    pub second: Vec<(String, f64, bool)>,
    /// Logarithms of the gains of curves over that of the best effect: with it, and alone.
    pub open: [f64; 2],
    /// Log of the share of the events that are evaluated. Where it is small, the scene may be wrong in the
    /// rest.
    pub share: f64,
    /// Kind of scene ([`KINDS`]).
    #[serde(default)]
    pub scene: String,
}

impl DecisionFeatures {
    /// Computed from the evidence of one scene.
    pub fn from_evidence(found: &SceneEvidence) -> DecisionFeatures {
        let first = hypotheses(&found.ranked, &found.random, found.noise[0]);
        let second = hypotheses(&found.second, &found.random_second, found.noise[1]);
        // What a size that does not matter explains needs no other explanation.
        let small = explained_by_little(&found.ranked, &found.random);
        let second_small = explained_by_little(&found.second, &found.random_second);
        let gain = |list: &[&RankedEffect], small: f64, kind: [bool; 2]| {
            let of_kind = |one: &&&RankedEffect| {
                [CANDIDATES[one.candidate].is_random, CANDIDATES[one.candidate].sought.is_of_swing] == kind
            };
            libm::log(
                list.iter()
                    .filter(of_kind)
                    .map(|one| one.gain_beyond_control() - small)
                    .fold(LEAST_GAIN, f64::max),
            )
        };
        let gains = |list: &[&RankedEffect], small: f64| LogGains {
            sized: gain(list, small, [false; 2]),
            random: gain(list, small, [true, false]),
            swing: gain(list, small, [false, true]),
        };
        let of_first = gains(&first, small);
        let best = of_first.best();
        let named = |list: &[&RankedEffect], noise: f64| {
            let best = list.first().map_or(LEAST_GAIN, |one| one.gain_beyond_noise(noise).max(LEAST_GAIN));
            list.iter()
                .map(|one| {
                    (
                        CANDIDATES[one.candidate].id.to_owned(),
                        one.gain_beyond_noise(noise) / best,
                        CANDIDATES[one.candidate].is_random,
                    )
                })
                .collect()
        };
        let curve = |list: &[CovariateCurve], small: f64| {
            libm::log(
                list.first().map_or(LEAST_GAIN, |one| (one.gain_beyond_control() - small).max(LEAST_GAIN)),
            )
        };
        DecisionFeatures {
            gains: of_first,
            second_gains: (!second.is_empty()).then(|| gains(&second, second_small)),
            first: named(&first, found.noise[0]),
            second: named(&second, found.noise[1]),
            open: [curve(&found.open_second, second_small) - best, curve(&found.open, small) - best],
            share: libm::log(found.covered().clamp(LEAST_GAIN, 1.0)),
            scene: found.scene.clone(),
        }
    }

    /// To four digits behind the point.
    pub fn rounded(&self) -> DecisionFeatures {
        let round = |x: f64| (x * 1e4).round() / 1e4;
        let gains = |of: LogGains| LogGains {
            sized: round(of.sized),
            random: round(of.random),
            swing: round(of.swing),
        };
        let list = |of: &[(String, f64, bool)]| {
            of.iter().map(|(id, share, is_random)| (id.clone(), round(*share), *is_random)).collect()
        };
        DecisionFeatures {
            gains: gains(self.gains),
            second_gains: self.second_gains.map(gains),
            first: list(&self.first),
            second: list(&self.second),
            open: self.open.map(round),
            share: round(self.share),
            scene: self.scene.clone(),
        }
    }

    /// Logarithm of what a curve gains more than the best effect, over that effect's gain: with the effect
    /// applied, or by itself. Thresholds of each pixel's own take every curve over the place with them, and
    /// leave nothing in addition of one that explains more than they do.
    fn beyond_best(&self) -> f64 {
        let [with, alone] = self.open;
        with.max(libm::log((libm::exp(alone) - 1.0).max(LEAST_GAIN)))
    }

    /// Features of the detection odds: 1; log of the joint gain of the best effect (or curve) and a second
    /// effect, at least `least_gain`; log of the share of the events that are evaluated. `of_curves`:
    /// [`DecisionModel::discount_of_curves`].
    pub fn detection_features(
        &self,
        discount: [f64; 2],
        of_curves: f64,
        least_gain: f64,
    ) -> [f64; SOMETHING] {
        let second = self.second_gains.map_or(0.0, |gains| libm::exp(gains.discounted(discount)));
        let curve = self.open[1] + self.gains.best() - of_curves;
        let gain = libm::exp(self.gains.discounted(discount).max(curve)) + second;
        [1.0, libm::log(gain.max(least_gain)), self.share]
    }

    /// 1, the logarithm of the second gain, and of that over the first; none where there is no second.
    pub fn second_effect_features(&self, discount: [f64; 2]) -> Option<[f64; SECOND]> {
        let other = self.second_gains?.discounted(discount);
        Some([1.0, other, other - self.gains.discounted(discount)])
    }
}

impl DecisionModel {
    /// Gain of one effect, nats per event, at which the log odds of a difference are `log_odds`. `share`: log
    /// of the share of the events that are evaluated.
    pub fn needed_gain(&self, log_odds: f64, share: f64) -> f64 {
        let [constant, gain, of_share] = self.something;
        libm::exp((log_odds - constant - of_share * share) / gain).max(LEAST_GAIN)
    }
}

/// The most that an effect of a size that does not matter gains, nats an event; at least 0.
fn explained_by_little(ranked: &[RankedEffect], random: &[RankedEffect]) -> f64 {
    ranked
        .iter()
        .chain(random)
        .filter(|one| one.is_exact && !one.is_material)
        .map(RankedEffect::gain_beyond_control)
        .fold(0.0, f64::max)
}

/// Each effect with its best parameter, in falling order of gain: those that were fitted exactly and are
/// material. `noise`: gain of wider event noise alone.
pub fn hypotheses<'a>(
    ranked: &'a [RankedEffect],
    random: &'a [RankedEffect],
    noise: f64,
) -> Vec<&'a RankedEffect> {
    let mut all: Vec<&RankedEffect> = ranked
        .iter()
        .chain(random)
        .filter(|one| one.is_exact && one.gain_beyond_control() > 0.0 && one.is_material)
        .collect();
    all.sort_by(|a, b| {
        b.gain_beyond_noise(noise).total_cmp(&a.gain_beyond_noise(noise)).then(a.candidate.cmp(&b.candidate))
    });
    let mut ids: Vec<&str> = Vec::new();
    all.retain(|one| {
        let id = CANDIDATES[one.candidate].id;
        let is_new = !ids.contains(&id);
        ids.push(id);
        is_new
    });
    all
}

/// Posterior probabilities: of a difference, of each hypothesis, of an uncatalogued dependence.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Posterior {
    /// That there is anything.
    pub something: f64,
    /// Of each hypothesis in its order, conditional on a difference.
    pub each: Vec<f64>,
    /// Of an uncatalogued dependence, conditional on a difference.
    pub unnamed: f64,
}

impl DecisionModel {
    /// Posterior of the first effect.
    pub fn first(&self, facts: &DecisionFeatures) -> Posterior {
        let odds = self.unnamed[0] + self.unnamed[1] * facts.beyond_best() + self.unnamed[2] * facts.open[1];
        self.posterior(
            dot(
                &self.something,
                &facts.detection_features(self.discount, self.discount_of_curves, self.least_gain),
            ),
            facts.gains.best(),
            &facts.first,
            Some(odds),
        )
    }

    /// And of a second one.
    pub fn second(&self, facts: &DecisionFeatures) -> Option<Posterior> {
        let gains = facts.second_gains?;
        Some(self.posterior(
            dot(&self.second, &facts.second_effect_features(self.discount)?),
            gains.best(),
            &facts.second,
            None,
        ))
    }

    /// `ln_gain`: of the best hypothesis, nats an event.
    fn posterior(
        &self,
        log_odds: f64,
        ln_gain: f64,
        list: &[(String, f64, bool)],
        unnamed: Option<f64>,
    ) -> Posterior {
        let softness =
            libm::exp((self.softness[0] + self.softness[1] * ln_gain).clamp(SOFTNESS.0, SOFTNESS.1));
        let score = |(_, share, is_random): &(String, f64, bool)| {
            libm::exp((share - 1.0) / softness + if *is_random { self.random } else { 0.0 })
        };
        let each: Vec<f64> = list.iter().map(score).collect();
        let unnamed = unnamed.map_or(0.0, |odds| libm::exp(odds.clamp(-50.0, 50.0)));
        let sum = (each.iter().sum::<f64>() + unnamed).max(1e-300);
        Posterior {
            something: logistic(log_odds),
            each: each.iter().map(|one| one / sum).collect(),
            unnamed: unnamed / sum,
        }
    }
}

/// 1 / (1 + exp(-x)).
pub fn logistic(x: f64) -> f64 {
    1.0 / (1.0 + libm::exp(-x))
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_that_explains_more_than_the_best_effect_counts_by_what_it_explains_more() {
        let facts = |alone: f64| DecisionFeatures {
            gains: LogGains {
                sized: libm::log(LEAST_GAIN),
                random: libm::log(0.4),
                swing: libm::log(LEAST_GAIN),
            },
            first: vec![("threshold_mismatch".into(), 1.0, true)],
            // With thresholds of each pixel's own nothing of a curve over the rows is left.
            open: [libm::log(LEAST_GAIN / 0.4), libm::log(alone / 0.4)],
            ..DecisionFeatures::default()
        };
        let unnamed = |alone: f64| DecisionModel::default().first(&facts(alone)).unnamed;
        assert!(unnamed(0.6) > 5.0 * unnamed(0.4), "{} {}", unnamed(0.6), unnamed(0.4));
        assert!(unnamed(0.4) < 1.5 * unnamed(0.3));
    }
}
