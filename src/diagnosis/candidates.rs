//! Every effect of the catalogue as a candidate: which number of it is sought, how large it usually is on a recording like this, and how it is put on.
//!
//! An effect with several independent parameters gives several candidates of the same id ("time_constant" by `tau_0` or by `alpha`). A *strength* of 1 is an effect that
//! an engineer would care for, 0 none; what parameter value that is depends on the recording's light and speed ([`Scales`]).

use crate::case::Case;
use crate::nominal::Nominal;
use crate::record::Described;
use photocurrent_core::sensor::Reset;
use photocurrent_sensor::effects::{EffectDecl, ParameterDecl, Unit, catalogue};
use serde_json::{Map, Value, json};

/// What strengths of effects are measured by: how bright, fast and busy a recording is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scales {
    /// Median photocurrent.
    pub light: f64,
    /// Mean of both thresholds, natural-log units.
    pub threshold: f64,
    /// Length of the recording, seconds.
    pub duration_s: f64,
    /// Stated length of an exposure, seconds; 0 without frames.
    pub exposure_s: f64,
    /// Median frame value above black, DN; 0 without frames.
    pub signal_dn: f64,
    /// DN below which nearly all frame values lie: the range that is used.
    pub largest_dn: f64,
    /// A fast slope of the scene, ln/s: thresholds over the 5th percentile of intervals between events of one polarity.
    pub slope_per_s: f64,
    /// Events per second of the whole array.
    pub rate_hz: f64,
    /// Period of the frames and the end of the readout-side exposure of row 0 of the first, seconds.
    pub frame_period_s: f64,
    /// See there.
    pub frame_phase_s: f64,
}

impl Scales {
    /// Of a recording.
    pub fn of(case: &Case, nominal: &Nominal) -> Scales {
        let threshold = 0.5 * (nominal.pixel.threshold_on + nominal.pixel.threshold_off);
        let duration_s = f64::max((case.span.1 - case.span.0) as f64 * 1e-9, 1e-6);
        let mut signals: Vec<f64> = Vec::new();
        let (mut exposure_s, mut frame_period_s, mut frame_phase_s) = (0.0, duration_s, 0.0);
        if let Some(frames) = &case.frames {
            exposure_s = frames.times.nominal_exposure_ns().unwrap_or(0) as f64 * 1e-9;
            // Every 7th value: enough for a median.
            signals = frames.dn.iter().step_by(7).filter(|dn| dn.is_finite()).map(|dn| f64::from(*dn) - nominal.number.black_level).collect();
            frame_period_s = frames.times.mean_period_ns().map_or(duration_s, |period_ns| period_ns * 1e-9);
            frame_phase_s = frames.times.exposures.first().map_or(0.0, |exposure| exposure.end.0 as f64 * 1e-9).rem_euclid(frame_period_s);
        }
        signals.sort_by(f64::total_cmp);
        let largest_dn = nominal.number.black_level + signals.get(signals.len() * 199 / 200).copied().unwrap_or(1.0).max(1.0);
        let signal_dn = signals.get(signals.len() / 2).copied().unwrap_or(0.0).max(0.0);
        let light = if exposure_s > 0.0 && signal_dn > 0.0 { signal_dn / (nominal.number.gain * exposure_s) } else { 1.0 };
        let mut intervals: Vec<i64> = Vec::new();
        for pixel in (0..case.events.pixels()).step_by(5) {
            let of_pixel = case.events.of(pixel);
            intervals.extend(of_pixel.windows(2).filter(|pair| pair[0].polarity == pair[1].polarity).map(|pair| pair[1].t_in_ns - pair[0].t_in_ns));
        }
        intervals.sort_unstable();
        let short_s = intervals.get(intervals.len() / 20).map_or(1e-2, |ns| f64::max(*ns as f64 * 1e-9, 1e-5));
        let rate_hz = f64::max(case.events.all().len() as f64 / duration_s, 1.0);
        Scales { light, threshold, duration_s, exposure_s, signal_dn, largest_dn, slope_per_s: threshold / short_s, rate_hz, frame_period_s, frame_phase_s }
    }
}

/// Which signs of a strength are physics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signs {
    /// Only more than nothing.
    Positive,
    /// Either way.
    Both,
    /// There or not there.
    Switch,
}

/// One number of one effect that may be missing from the description.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// Catalogue id.
    pub id: &'static str,
    /// TOML key of the number; empty for a switch, `reset` for another reset law.
    pub parameter: &'static str,
    /// Signs.
    pub signs: Signs,
    /// Is what happens random, so that another seed gives another recording with the same statistics?
    pub is_random: bool,
    typical: fn(&Scales, &Nominal) -> f64,
}

/// What is simulated or solved instead of the stated sensor.
#[derive(Clone, Debug)]
pub struct Trial {
    /// The base fields.
    pub nominal: Nominal,
    /// Effects on top.
    pub effects: Described,
}

/// All candidates, in the order of the catalogue.
pub const CANDIDATES: &[Candidate] = &[
    both("misalignment", "shift_x", |_, _| 0.6),
    both("misalignment", "shift_y", |_, _| 0.6),
    positive("blur", "sigma", |_, _| 0.8),
    positive("crosstalk", "fraction", |_, _| 0.25),
    positive("dark_current", "current", |scales, _| 0.15 * scales.light),
    both("time_constant", "tau_0", |_, _| 150e-6),
    both("time_constant", "alpha", |scales, nominal| f64::max(1.3 * nominal.pixel.front_end.alpha_s, 50e-6 * scales.light)),
    positive("second_pole", "tau", |_, _| 150e-6),
    positive("second_pole", "tau_light", |scales, _| 150e-6 * scales.light),
    Candidate { id: "large_signal_front_end", parameter: "", signs: Signs::Switch, is_random: false, typical: |_, _| 1.0 },
    positive("slew_limit", "rise", |scales, _| scales.slope_per_s),
    positive("slew_limit", "fall", |scales, _| scales.slope_per_s),
    positive("high_pass_front_end", "tau", |_, _| 0.04),
    both("bandwidth_gradient", "fraction", |_, _| 0.5),
    both("threshold_scale", "fraction", |_, _| 0.2),
    both("threshold_asymmetry", "fraction", |_, _| 0.15),
    both("threshold_drift", "rate", |scales, _| 0.2 / scales.duration_s),
    both("threshold_gradient", "fraction", |_, _| 0.2),
    random("threshold_mismatch", "sigma", |scales, _| 0.17 * scales.threshold),
    random("threshold_noise", "sigma", |scales, _| 0.08 * scales.threshold),
    both("refractory", "refractory", |_, _| 250e-6),
    Candidate { id: "refractory", parameter: "reset", signs: Signs::Switch, is_random: false, typical: |_, _| 1.0 },
    random("refractory_spread", "sigma", |_, _| 0.9),
    positive("refractory_light", "coefficient", |scales, _| 1.0 / scales.light),
    both("reset_memory", "fraction", |_, _| 0.3),
    positive("leak_events", "rate", |_, _| 12.0),
    positive("parasitic_leak", "coefficient", |scales, _| 12.0 * scales.threshold / scales.light),
    random("background_activity", "rate", |_, _| 6.0),
    random("hot_pixels", "fraction", |_, _| 0.005),
    random("hot_rows", "fraction", |_, _| 0.03),
    positive("lateral_inhibition", "fraction", |_, _| 0.4),
    both("frame_coupling", "step", |scales, _| 0.4 * scales.threshold),
    positive("readout_queue", "service", |scales, _| 0.6 / scales.rate_hz),
    random("event_loss", "fraction", |_, _| 0.4),
    both("row_skew", "per_row", |_, _| 8e-6),
    random("row_skew", "sigma", |_, _| 150e-6),
    random("timestamp_jitter", "sigma", |_, _| 60e-6),
    both("clock_drift", "rate", |scales, _| 0.75e-3 / scales.duration_s),
    both("clock_offset", "offset", |_, _| 500e-6),
    positive("timestamp_quantization", "step", |_, _| 120e-6),
    both("row_time", "row_time", |_, nominal| f64::max(0.5 * nominal.row_time_ns as f64 * 1e-9, 5e-6)),
    both("exposure_time", "difference", |scales, _| 0.12 * scales.exposure_s),
    positive("image_lag", "fraction", |_, _| 0.08),
    both("vignetting", "falloff", |_, _| 0.3),
    both("frame_nonlinearity", "fraction", |_, _| 0.06),
    random("frame_gain_steps", "sigma", |_, _| 0.05),
    both("black_level", "black_level_dn", |scales, _| f64::max(0.12 * scales.signal_dn, 10.0)),
    positive("frame_nonlinearity", "compression", |_, _| 0.15),
];

const fn both(id: &'static str, parameter: &'static str, typical: fn(&Scales, &Nominal) -> f64) -> Candidate {
    Candidate { id, parameter, signs: Signs::Both, is_random: false, typical }
}

const fn positive(id: &'static str, parameter: &'static str, typical: fn(&Scales, &Nominal) -> f64) -> Candidate {
    Candidate { id, parameter, signs: Signs::Positive, is_random: false, typical }
}

const fn random(id: &'static str, parameter: &'static str, typical: fn(&Scales, &Nominal) -> f64) -> Candidate {
    Candidate { id, parameter, signs: Signs::Positive, is_random: true, typical }
}

/// The refractory period that spread and light act on where none is stated, seconds.
const SOME_REFRACTORY_S: f64 = 50e-6;

impl Candidate {
    /// A name of its own: `leak_events.rate`, `large_signal_front_end`.
    pub fn label(&self) -> String {
        if self.parameter.is_empty() { self.id.to_owned() } else { format!("{}.{}", self.id, self.parameter) }
    }

    /// What the effect says about itself.
    pub fn decl(&self) -> EffectDecl {
        catalogue().into_iter().map(|kind| kind.decl).find(|decl| decl.id == self.id).unwrap_or_else(|| unreachable!("candidates are of the catalogue"))
    }

    /// What its number says about itself; none for a switch.
    pub fn parameter_decl(&self) -> Option<ParameterDecl> {
        self.decl().parameters.iter().find(|parameter| parameter.name == self.parameter).copied()
    }

    /// Its JSON key (`rate_hz`, `fraction`) and unit.
    pub fn json_key(&self) -> (String, &'static str) {
        match self.parameter_decl() {
            Some(decl) => (format!("{}{}", decl.name, decl.unit.suffix()), decl.unit.text()),
            None => (self.parameter.to_owned(), ""),
        }
    }

    /// The value of the parameter that the description states, or that means nothing.
    pub fn nominal_value(&self, nominal: &Nominal) -> f64 {
        match (self.id, self.parameter) {
            ("time_constant", "tau_0") => nominal.pixel.front_end.tau_0_s,
            ("time_constant", "alpha") => nominal.pixel.front_end.alpha_s,
            ("refractory", "refractory") => nominal.pixel.refractory_ns as f64 * 1e-9,
            ("row_time", _) => nominal.row_time_ns as f64 * 1e-9,
            ("black_level", _) => nominal.number.black_level,
            _ => 0.0,
        }
    }

    /// Is its number a limit or a time constant that means nothing when it is infinite, not when it is 0?
    pub fn is_limit(&self) -> bool {
        matches!(self.id, "slew_limit" | "high_pass_front_end")
    }

    /// The candidate of an effect by one of its parameters.
    pub fn find(id: &str, parameter: &str) -> Option<&'static Candidate> {
        CANDIDATES.iter().find(|candidate| candidate.id == id && candidate.parameter == parameter)
    }

    /// The parameter at a strength, in the unit of its declaration.
    pub fn value(&self, strength: f64, scales: &Scales, nominal: &Nominal) -> f64 {
        let typical = (self.typical)(scales, nominal);
        match self.id {
            // The faster the limit, the less it matters.
            "slew_limit" | "high_pass_front_end" => typical / f64::max(strength, 1e-6),
            _ => {
                let value = self.nominal_value(nominal) + strength * typical;
                let (least, most) = self.parameter_decl().map_or((f64::NEG_INFINITY, f64::INFINITY), |decl| decl.allowed);
                value.clamp(least, most)
            }
        }
    }

    /// The strength at which the parameter has a value.
    pub fn strength(&self, value: f64, scales: &Scales, nominal: &Nominal) -> f64 {
        let typical = (self.typical)(scales, nominal);
        match self.id {
            "slew_limit" | "high_pass_front_end" => typical / value,
            _ => (value - self.nominal_value(nominal)) / typical,
        }
    }

    /// Puts the effect on a trial, at a strength.
    pub fn put_on(&self, trial: &mut Trial, strength: f64, scales: &Scales) {
        let value = self.value(strength, scales, &trial.nominal);
        let parameters = trial.effects.entry(self.id.to_owned()).or_default();
        if self.signs == Signs::Switch {
            if self.parameter == "reset" {
                trial.effects.remove(self.id);
                trial.nominal.reset = if trial.nominal.reset == Reset::Resample { Reset::Advance } else { Reset::Resample };
            }
            return;
        }
        let written = match self.parameter_decl().map(|decl| decl.unit) {
            Some(Unit::Time) => json!(format!("{} ns", (value * 1e9).round())),
            Some(Unit::Rate) => json!(format!("{value} Hz")),
            _ => json!(value),
        };
        parameters.insert(self.parameter.to_owned(), written);
        self.complete(parameters, scales);
        if self.id == "refractory_light" {
            // What an engineer meets is a period that grows in the dark beyond the stated one; the stated one is what it comes down to in bright light.
            let bright = f64::max(trial.nominal.pixel.refractory_ns as f64 * 1e-9, SOME_REFRACTORY_S);
            let dark = bright * (1.0 + 4.0 * strength.max(0.0)) * (1.0 + value * scales.light);
            let refractory: Map<String, Value> = [("refractory".to_owned(), json!(format!("{} ns", (dark * 1e9).round())))].into_iter().collect();
            trial.effects.entry("refractory".to_owned()).or_insert(refractory);
        }
        if self.id == "refractory_spread" && trial.nominal.pixel.refractory_ns == 0 {
            let refractory: Map<String, Value> = [("refractory".to_owned(), json!(format!("{} ns", SOME_REFRACTORY_S * 1e9)))].into_iter().collect();
            trial.effects.entry("refractory".to_owned()).or_insert(refractory);
        }
    }

    /// The parameters that are not sought but must be there.
    fn complete(&self, parameters: &mut Map<String, Value>, scales: &Scales) {
        let mut put = |key: &str, value: Value| {
            parameters.entry(key.to_owned()).or_insert(value);
        };
        let ns = |seconds: f64| json!(format!("{} ns", (seconds * 1e9).round()));
        match self.id {
            "hot_pixels" => put("rate", json!("200 Hz")),
            "hot_rows" => put("rate", json!("60 Hz")),
            // Over the range that is used, as the rest of it says nothing.
            "frame_nonlinearity" => put("full_scale_dn", json!(scales.largest_dn.ceil())),
            "frame_coupling" => {
                put("period", ns(scales.frame_period_s));
                put("phase", ns(scales.frame_phase_s));
            }
            _ => {}
        }
    }
}

impl Trial {
    /// The stated sensor.
    pub fn stated(nominal: &Nominal) -> Trial {
        Trial { nominal: nominal.clone(), effects: Described::new() }
    }

    /// The stated sensor with one effect.
    pub fn with(nominal: &Nominal, candidate: &Candidate, strength: f64, scales: &Scales) -> Trial {
        let mut trial = Trial::stated(nominal);
        candidate.put_on(&mut trial, strength, scales);
        trial
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use photocurrent_core::sensor::EFFECT_IDS;
    use photocurrent_sensor::effects::from_description;

    #[test]
    fn every_effect_of_the_catalogue_is_a_candidate() {
        for id in EFFECT_IDS {
            assert!(CANDIDATES.iter().any(|candidate| candidate.id == id), "{id}");
        }
    }

    #[test]
    fn every_candidate_can_be_put_on_at_any_strength_and_read_back() {
        let case = testing::case();
        let nominal = case.nominal().unwrap();
        let scales = Scales::of(&case, &nominal);
        for candidate in CANDIDATES {
            for strength in [0.3, 1.0, 2.0, -0.5] {
                if strength < 0.0 && candidate.signs != Signs::Both {
                    continue;
                }
                let trial = Trial::with(&nominal, candidate, strength, &scales);
                from_description(&trial.effects).unwrap_or_else(|why| panic!("{}: {why}", candidate.label()));
                if candidate.signs != Signs::Switch {
                    let value = candidate.value(strength, &scales, &nominal);
                    let decl = candidate.parameter_decl().unwrap();
                    let is_cut = value == decl.allowed.0 || value == decl.allowed.1;
                    let back = candidate.strength(value, &scales, &nominal);
                    assert!(is_cut || (back - strength).abs() < 1e-9, "{}: {back}", candidate.label());
                }
            }
        }
    }
}
