//! Random effects of a recording, relative to those of the control.

use super::components::{ComponentData, VarianceComponent, component_parameter, variance_components};
use super::evidence::{NOISE, RankedEffect};
use super::fit::EventNoise;
use super::setting::{LEAST_EVENT_NOISE, LEAST_UNSTATED_NOISE};
use super::table::OF_PIXELS;
use crate::candidates::{CANDIDATES, Candidate, EffectScales};
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;

/// Reference of random effects: noise and components without them.
pub(super) struct RandomEffects<'a> {
    pub case: &'a Case,
    pub scales: &'a EffectScales,
    pub nominal: &'a Nominal,
    /// Is the scene known independently of the frames?
    pub is_known: bool,
    /// Median slope of the voltage at the events, ln/s.
    pub slope_per_s: f64,
    /// Event noise without such an effect, and the components found without one; empty where not computed.
    pub noise: EventNoise,
    pub control: Vec<VarianceComponent>,
}

impl RandomEffects<'_> {
    /// Random effects beyond the control's, best first, and their components.
    pub(super) fn rank_beyond_control(
        &self,
        ground: &ComponentData<'_>,
    ) -> (Vec<RankedEffect>, Vec<VarianceComponent>) {
        let RandomEffects { case, scales, nominal, .. } = *self;
        let threshold = scales.threshold;
        let parts = variance_components(ground, &self.noise);
        // What a description does not state may be there; only on known light it is seen so sharply that it
        // must be allowed for.
        let unstated =
            if self.is_known && nominal.threshold_noise == 0.0 { LEAST_UNSTATED_NOISE } else { 0.0 };
        let matters = |one: &RankedEffect| match CANDIDATES[one.candidate].id {
            "threshold_noise" => one.value > f64::max(LEAST_EVENT_NOISE, unstated) * threshold,
            "timestamp_jitter" => one.value * self.slope_per_s > LEAST_EVENT_NOISE * threshold,
            _ => true,
        };
        let effect_sizes = OF_PIXELS.map(|(id, parameter)| {
            Candidate::find(id, parameter).map_or(0.0, |candidate| {
                candidate.value(1.0, scales, nominal) - candidate.value(0.0, scales, nominal)
            })
        });
        let rate = case.events.len() as f64 / f64::max(case.extent.pixels() as f64 * scales.duration_s, 1e-9);
        let one = |part: &VarianceComponent| {
            let control = self.control.iter().find(|control| control.candidate == part.candidate);
            let (gain, size) = control.map_or((0.0, 0.0), |control| (control.gain.max(0.0), control.size));
            let effect_sizes = (effect_sizes[0], effect_sizes[1]);
            RankedEffect {
                candidate: part.candidate,
                effect_size: part.size,
                value: component_parameter(part, size, threshold, effect_sizes, nominal, rate),
                gain: part.gain,
                control_gain: gain,
                control_effect_size: size,
                is_exact: true,
                ..RankedEffect::default()
            }
        };
        let mut found: Vec<RankedEffect> = parts.iter().map(one).filter(matters).collect();
        found.sort_by(RankedEffect::by_gain);
        (found, parts)
    }
}

/// Gain of wider event noise alone.
pub(super) fn noise_gain(random: &[RankedEffect]) -> f64 {
    let gain = |one: &RankedEffect| {
        if NOISE.contains(&CANDIDATES[one.candidate].id) { one.gain_beyond_control() } else { 0.0 }
    };
    random.iter().map(gain).fold(0.0, f64::max)
}
