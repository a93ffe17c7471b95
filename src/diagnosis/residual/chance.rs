//! Random effects of a recording, counted from what there is without them.

use super::components::{Ground, Part, parts, value};
use super::evidence::{NOISE, Ranked};
use super::fit::EventNoise;
use super::setting::{LEAST_EVENT_NOISE, LEAST_UNSTATED_NOISE};
use super::table::OF_PIXELS;
use crate::candidates::{CANDIDATES, Candidate, Scales};
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;

/// What random effects are counted from.
pub(super) struct Chance<'a> {
    pub case: &'a Case,
    pub scales: &'a Scales,
    pub nominal: &'a Nominal,
    /// Does the scene stand without the frames?
    pub is_known: bool,
    /// Median slope of the voltage at the events, ln/s.
    pub slope_per_s: f64,
    /// Noise of events without such an effect, and what is found where none is; nothing where that was not
    /// computed.
    pub noise: EventNoise,
    pub control: Vec<Part>,
}

impl Chance<'_> {
    /// Best first, and the parts themselves.
    pub(super) fn beyond(&self, ground: &Ground<'_>) -> (Vec<Ranked>, Vec<Part>) {
        let Chance { case, scales, nominal, .. } = *self;
        let threshold = scales.threshold;
        let parts = parts(ground, &self.noise);
        // What a description does not state may be there; only on known light it is seen so sharply that it
        // must be allowed for.
        let unstated =
            if self.is_known && nominal.threshold_noise == 0.0 { LEAST_UNSTATED_NOISE } else { 0.0 };
        let matters = |one: &Ranked| match CANDIDATES[one.candidate].id {
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
        let one = |part: &Part| {
            let control = self.control.iter().find(|control| control.candidate == part.candidate);
            let (gain, size) = control.map_or((0.0, 0.0), |control| (control.gain.max(0.0), control.size));
            let effect_sizes = (effect_sizes[0], effect_sizes[1]);
            Ranked {
                candidate: part.candidate,
                effect_size: part.size,
                value: value(part, size, threshold, effect_sizes, nominal, rate),
                gain: part.gain,
                control_gain: gain,
                control_effect_size: size,
                is_exact: true,
                ..Ranked::default()
            }
        };
        let mut found: Vec<Ranked> = parts.iter().map(one).filter(matters).collect();
        found.sort_by(Ranked::by_gain);
        (found, parts)
    }
}

/// What wider noise of events alone gains.
pub(super) fn of_noise(random: &[Ranked]) -> f64 {
    let gain = |one: &Ranked| if NOISE.contains(&CANDIDATES[one.candidate].id) { one.beyond() } else { 0.0 };
    random.iter().map(gain).fold(0.0, f64::max)
}
