//! The evidence of a scene for effects; [`super::ranking`] computes it.

use super::located::LocatedEffect;
use super::open::CovariateCurve;
pub use super::setting::EvidenceSetting;
use crate::candidates::CANDIDATES;
use crate::report::SceneEstimate;
use photocurrent_scene::block::Block;
use serde::{Deserialize, Serialize};

/// Kinds of scenes that decisions have a model for, by their names.
pub const KINDS: [&str; 5] = ["picture", "given", "patches", "pixels", "joint"];

/// Evidence of the events for one effect.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RankedEffect {
    /// Number in [`CANDIDATES`].
    pub candidate: usize,
    /// Estimated effect size less the control's.
    pub effect_size: f64,
    /// Standard error, effect sizes.
    pub error: f64,
    /// The parameter, in the unit of its declaration.
    pub value: f64,
    /// Held-out gain over the nominal sensor, nats per event.
    pub gain: f64,
    /// Its standard error.
    pub gain_error: f64,
    /// Fisher information per event about the effect size: a small size s gains half of it times s^2.
    #[serde(default)]
    pub information: f64,
    /// The same were the light known, of a scene that follows events; 0 of others.
    #[serde(default)]
    pub of_known_light: f64,
    /// Change of the parameter by an effect size of 1, in the unit of its declaration.
    #[serde(default)]
    pub unit: f64,
    /// The same of the control.
    pub control_gain: f64,
    /// And the size that the control finds, effect sizes.
    pub control_effect_size: f64,
    /// Was it evaluated at its size?
    pub is_exact: bool,
    /// Effect size of the first effect together with this one, of a second effect.
    pub of_first: Option<f64>,
    /// Median absolute residual over the threshold that it leaves.
    pub left: f64,
    /// Distance of the residuals with the effect from the control's noise (`EventNoise::distance`); 0 where
    /// it was not fitted exactly.
    #[serde(default)]
    pub ks: f64,
    /// Is its size material ([`crate::candidates::Candidate::is_material`])?
    #[serde(default)]
    pub is_material: bool,
    /// Shift of the free parameters of a known target from the fit to frames alone, shares of their ranges.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub by: Vec<f64>,
    /// Where it is; of effects that were evaluated at their size.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub located: Option<LocatedEffect>,
}

impl RankedEffect {
    /// Held-out gain beyond the control's, nats per event.
    pub fn gain_beyond_control(&self) -> f64 {
        self.gain - self.control_gain
    }

    /// Best first.
    pub(super) fn by_gain(a: &RankedEffect, b: &RankedEffect) -> std::cmp::Ordering {
        b.gain_beyond_control().total_cmp(&a.gain_beyond_control()).then(a.candidate.cmp(&b.candidate))
    }

    /// Gain for comparison with other effects, nats per event, where wider event noise alone gains `noise`
    /// ([`SceneEvidence::noise`]).
    ///
    /// The gain of wider noise is relative to the control's noise. Every other effect is fitted with its own,
    /// wider noise, so the gain of wider noise alone is added to its own. Noise itself lets others gain
    /// almost nothing.
    pub fn gain_beyond_noise(&self, noise: f64) -> f64 {
        let is_noise = NOISE.contains(&CANDIDATES[self.candidate].id);
        if is_noise || self.gain_beyond_control() <= 0.0 {
            self.gain_beyond_control()
        } else {
            self.gain_beyond_control() + f64::max(noise - OVER_NOISE, 0.0)
        }
    }
}

/// Effects that only widen the event noise.
pub(super) const NOISE: [&str; 2] = ["threshold_noise", "timestamp_jitter"];
/// An effect that gains less than this on noisy events is their noise, nats per event.
const OVER_NOISE: f64 = 0.03;

impl SceneEvidence {
    /// Share of the recording that the scene explains. Where it is small, the scene may be wrong in that as
    /// well.
    pub fn covered(&self) -> f64 {
        if self.follows_events() { self.explained } else { self.share }
    }

    /// Is the scene estimated from events as well?
    pub fn follows_events(&self) -> bool {
        KINDS[3..].contains(&&*self.scene)
    }
}

/// Evidence of one scene for all effects.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SceneEvidence {
    /// The scene ([`photocurrent_scene::SampledScene::name`]).
    #[serde(default)]
    pub scene: String,
    /// First and last evaluated instant, ns; `None` where it is the whole recording.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub span_ns: Option<(i64, i64)>,
    /// The part of the array that was evaluated; none where it is all of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<Block>,
    /// Held-out log-likelihood of an event's time with the description, nats (of a density per second).
    #[serde(default)]
    pub nats_per_event: f64,
    /// Parameters that the description states as ranges, estimated before.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub estimated: Vec<SceneEstimate>,
    /// Share of the events that are evaluated.
    pub share: f64,
    /// On scenes that follow events: share of the evaluated events that miss their threshold by no more than
    /// 2 % of it once the best effect is applied. 0 on other scenes.
    #[serde(default)]
    pub explained: f64,
    /// Number of evaluated events.
    pub events: usize,
    /// Median absolute residual over the threshold.
    pub median: f64,
    /// The same of the control.
    pub control_median: f64,
    /// Distance of the residuals from the control's noise (`EventNoise::distance`).
    #[serde(default)]
    pub ks: f64,
    /// Median slope of the voltage at the events, ln/s.
    pub slope_per_s: f64,
    /// Share of the squares of residuals that is noise of pixels.
    pub white: f64,
    /// How much too soft the picture may be and is found to be, as the size of a blur's column, 0 or below.
    #[serde(default)]
    pub softness: [f64; 2],
    /// Median absolute residual of frames, standard deviations.
    pub misfit: f64,
    /// Median absolute residual over the threshold with the first effect applied, and with both.
    pub left: [f64; 2],
    /// Gain of wider event noise alone over the control's, with nothing applied and with
    /// [`SceneEvidence::first`], nats per event; 0 on a scene fitted to frames.
    #[serde(default)]
    pub noise: [f64; 2],
    /// Of effects with a size, best first.
    pub ranked: Vec<RankedEffect>,
    /// With [`SceneEvidence::first`] applied, best first.
    pub second: Vec<RankedEffect>,
    /// The best of all, if any gains anything.
    pub first: Option<RankedEffect>,
    /// Random effects with nothing applied, best first.
    pub random: Vec<RankedEffect>,
    /// And with [`SceneEvidence::first`] applied.
    pub random_second: Vec<RankedEffect>,
    /// Curves of no effect of the catalogue, with nothing applied, best first.
    pub open: Vec<CovariateCurve>,
    /// And with [`SceneEvidence::first`] applied.
    pub open_second: Vec<CovariateCurve>,
    /// On one moving picture of frames and events together, where this scene is one moving picture and leaves
    /// too much: it decides where it explains more.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub on_joint: Option<Box<SceneEvidence>>,
    /// On the light of pixels, where this scene leaves too much: it decides where this one cannot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub on_pixels: Option<Box<SceneEvidence>>,
}
