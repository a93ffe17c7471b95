//! What the evidence of a scene for effects is, and how it is obtained ([`super::ranking`]).

use super::located::Located;
use super::open::Open;
pub use super::setting::EvidenceSetting;
use crate::candidates::CANDIDATES;
use crate::report::Estimate;
use photocurrent_scene::block::Block;
use serde::{Deserialize, Serialize};

/// Kinds of scenes that decisions have a model for, by their names.
pub const KINDS: [&str; 5] = ["picture", "given", "patches", "pixels", "joint"];

/// One effect, as the events see it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ranked {
    /// Number in [`CANDIDATES`].
    pub candidate: usize,
    /// Its size, in effect sizes, less what the control finds.
    pub effect_size: f64,
    /// Standard error, effect sizes.
    pub error: f64,
    /// The parameter, in the unit of its declaration.
    pub value: f64,
    /// Held-out gain over the nominal sensor, nats per event.
    pub gain: f64,
    /// Its standard error.
    pub gain_error: f64,
    /// Fisher information of an event about the effect size: half of it times the effect size's square is
    /// what a small one gains.
    #[serde(default)]
    pub information: f64,
    /// The same were the light known, of a scene that follows events; 0 of others.
    #[serde(default)]
    pub of_known_light: f64,
    /// What an effect size of 1 adds to the parameter's nominal value, in the unit of its declaration.
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
    /// Distance of what it leaves from the control's noise (`EventNoise::distance`); 0 where it was not
    /// evaluated exactly.
    #[serde(default)]
    pub ks: f64,
    /// Is its size worth a word ([`crate::candidates::Candidate::is_material`])?
    #[serde(default)]
    pub is_material: bool,
    /// How far the free parameters of a known target then stand from where frames alone had them, shares of
    /// their ranges.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub by: Vec<f64>,
    /// Where it is; of effects that were evaluated at their size.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub located: Option<Located>,
}

impl Ranked {
    /// Held-out gain beyond the control's, nats per event.
    pub fn beyond(&self) -> f64 {
        self.gain - self.control_gain
    }

    /// Best first.
    pub(super) fn by_gain(a: &Ranked, b: &Ranked) -> std::cmp::Ordering {
        b.beyond().total_cmp(&a.beyond()).then(a.candidate.cmp(&b.candidate))
    }

    /// What it stands for among others where wider noise of events alone gains `noise` ([`Evidence::noise`]),
    /// nats per event.
    ///
    /// Wider noise is held against the control's noise, and every other effect against the noise that its own
    /// residuals have, which is wider already: what that alone gains is theirs as well. Noise by itself lets
    /// the others gain almost nothing.
    pub fn standing(&self, noise: f64) -> f64 {
        let is_noise = NOISE.contains(&CANDIDATES[self.candidate].id);
        if is_noise || self.beyond() <= 0.0 {
            self.beyond()
        } else {
            self.beyond() + f64::max(noise - OVER_NOISE, 0.0)
        }
    }
}

/// Effects that are wider noise of events and nothing else.
pub(super) const NOISE: [&str; 2] = ["threshold_noise", "timestamp_jitter"];
/// An effect that gains less than this on noisy events is their noise, nats per event.
const OVER_NOISE: f64 = 0.03;

impl Evidence {
    /// How much of the recording the scene explains, a share: where it is small, the scene may err in that as
    /// well.
    pub fn covered(&self) -> f64 {
        if self.follows_events() { self.explained } else { self.share }
    }

    /// Is the scene estimated from events as well?
    pub fn follows_events(&self) -> bool {
        KINDS[3..].contains(&&*self.scene)
    }
}

/// What the method found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// The scene ([`photocurrent_scene::Scene::name`]).
    #[serde(default)]
    pub scene: String,
    /// First and last instant that was looked at, ns; none where it is the whole recording.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub span_ns: Option<(i64, i64)>,
    /// The part of the array that was evaluated; none where it is all of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<Block>,
    /// Held-out log-likelihood of an event's time with the description, nats (of a density per second).
    #[serde(default)]
    pub nats_per_event: f64,
    /// What the description leaves open, estimated before.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub estimated: Vec<Estimate>,
    /// Share of the events that counts.
    pub share: f64,
    /// On scenes that follow events: share of the evaluated events that miss their threshold by no more than
    /// 2 % of it once the best effect is applied. 0 on other scenes.
    #[serde(default)]
    pub explained: f64,
    /// Events looked at.
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
    /// What wider noise of events alone gains over the control's, with nothing applied and with
    /// [`Evidence::first`], nats an event; 0 on a scene that was fitted to frames.
    #[serde(default)]
    pub noise: [f64; 2],
    /// Of effects with a size, best first.
    pub ranked: Vec<Ranked>,
    /// With [`Evidence::first`] applied, best first.
    pub second: Vec<Ranked>,
    /// The best of all, if any gains anything.
    pub first: Option<Ranked>,
    /// Random effects with nothing applied, best first.
    pub random: Vec<Ranked>,
    /// And with [`Evidence::first`] applied.
    pub random_second: Vec<Ranked>,
    /// What no effect of the catalogue has, with nothing applied, best first.
    pub open: Vec<Open>,
    /// And with [`Evidence::first`] applied.
    pub open_second: Vec<Open>,
    /// On one moving picture of frames and events together, where this scene is one moving picture and leaves
    /// too much: it decides where it explains more.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub on_joint: Option<Box<Evidence>>,
    /// On the light of pixels, where this scene leaves too much: it decides where this one cannot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub on_pixels: Option<Box<Evidence>>,
}
