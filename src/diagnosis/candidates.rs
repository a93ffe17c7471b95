//! Every effect of the catalogue as a candidate: the parameters that its file declares as searchable
//! ([`Sought`]), evaluated for a recording.
//!
//! An effect with several independent parameters gives several candidates of the same id ("time_constant" by
//! `tau_0` or by `alpha`). An *effect size* is a normalised parameter: 0 is no effect, 1 is the size that an
//! engineer would care for. The parameter value of size 1 depends on the light and the speed of the recording
//! ([`EffectScales`]).

use crate::record::EffectParameters;
use photocurrent_core::Sensor;
use photocurrent_core::sensor::Reset;
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
pub use photocurrent_sensor::effects::sought::Signs;
use photocurrent_sensor::effects::sought::{Applied, Field, Grows, Measure, Size, Sought};
use photocurrent_sensor::effects::{EffectDecl, ParameterDecl, Unit, catalogue};
use std::sync::LazyLock;

/// Scales that convert effect sizes to parameter values: light, speed and event rate of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EffectScales {
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
    /// A fast slope of the scene, ln/s: thresholds over the 5th percentile of intervals between events of one
    /// polarity.
    pub slope_per_s: f64,
    /// Events per second of the whole array.
    pub rate_hz: f64,
    /// Period of the frames and the end of the readout-side exposure of row 0 of the first, seconds.
    pub frame_period_s: f64,
    /// See there.
    pub frame_phase_s: f64,
    /// Width of a stamp, seconds.
    pub stamp_s: f64,
    /// Rows of the array.
    pub rows: f64,
}

impl EffectScales {
    /// Of a recording.
    pub fn from_case(case: &Case, nominal: &Nominal) -> EffectScales {
        let threshold = 0.5 * (nominal.pixel.threshold_on + nominal.pixel.threshold_off);
        let duration_s = f64::max((case.span.1 - case.span.0) as f64 * 1e-9, 1e-6);
        let mut signals: Vec<f64> = Vec::new();
        let (mut exposure_s, mut frame_period_s, mut frame_phase_s) = (0.0, duration_s, 0.0);
        if let Some(frames) = &case.frames {
            exposure_s = frames.times.nominal_exposure_ns().unwrap_or(0) as f64 * 1e-9;
            // Every 7th value: enough for a median.
            signals = frames
                .every_nth(7)
                .filter(|dn| dn.is_finite())
                .map(|dn| f64::from(dn) - nominal.number.black_level)
                .collect();
            frame_period_s = frames.times.mean_period_ns().map_or(duration_s, |period_ns| period_ns * 1e-9);
            frame_phase_s = frames
                .times
                .exposures
                .first()
                .map_or(0.0, |exposure| exposure.end.0 as f64 * 1e-9)
                .rem_euclid(frame_period_s);
        }
        signals.sort_by(f64::total_cmp);
        let largest_dn = nominal.number.black_level
            + signals.get(signals.len() * 199 / 200).copied().unwrap_or(1.0).max(1.0);
        let signal_dn = signals.get(signals.len() / 2).copied().unwrap_or(0.0).max(0.0);
        let light = if exposure_s > 0.0 && signal_dn > 0.0 {
            signal_dn / (nominal.number.gain * exposure_s)
        } else {
            1.0
        };
        let mut intervals: Vec<i64> = Vec::new();
        for pixel in (0..case.events.pixels()).step_by(5) {
            let of_pixel = case.events.of_pixel(pixel);
            intervals.extend(
                of_pixel
                    .windows(2)
                    .filter(|pair| pair[0].polarity == pair[1].polarity)
                    .map(|pair| pair[1].t_in_ns - pair[0].t_in_ns),
            );
        }
        intervals.sort_unstable();
        let short_s =
            intervals.get(intervals.len() / 20).map_or(1e-2, |ns| f64::max(*ns as f64 * 1e-9, 1e-5));
        let rate_hz = f64::max(case.events.len() as f64 / duration_s, 1.0);
        let (stamp_s, rows, slope_per_s) =
            (case.t_resolution_ns as f64 * 1e-9, f64::from(case.extent.height), threshold / short_s);
        EffectScales {
            light,
            threshold,
            duration_s,
            exposure_s,
            signal_dn,
            largest_dn,
            slope_per_s,
            rate_hz,
            frame_period_s,
            frame_phase_s,
            stamp_s,
            rows,
        }
    }

    /// How much there is of a measure.
    fn measure(&self, measure: Measure, nominal: &Nominal) -> f64 {
        match measure {
            Measure::Light => self.light,
            Measure::Threshold => self.threshold,
            Measure::Duration => self.duration_s,
            Measure::Exposure => self.exposure_s,
            Measure::Signal => self.signal_dn,
            Measure::LargestDn => self.largest_dn.ceil(),
            Measure::Slope => self.slope_per_s,
            Measure::EventRate => self.rate_hz,
            Measure::FramePeriod => self.frame_period_s,
            Measure::FramePhase => self.frame_phase_s,
            Measure::StampWidth => self.stamp_s,
            Measure::Rows => self.rows,
            Measure::Alpha => nominal.pixel.front_end.alpha_s,
            Measure::RowTime => nominal.row_time_ns as f64 * 1e-9,
        }
    }

    fn natural_size(&self, size: &Size, nominal: &Nominal) -> f64 {
        size.at(&|measure| self.measure(measure, nominal))
    }
}

/// One number of one effect that may be missing from the description.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// Catalogue id.
    pub id: &'static str,
    /// TOML key of the number; empty for a switch, `reset` for another reset rule.
    pub parameter: &'static str,
    /// Signs.
    pub signs: Signs,
    /// Is the effect random? Another seed then gives another recording with the same statistics.
    pub is_random: bool,
    /// How it is searched for, from the file of the effect.
    pub sought: Sought,
    decl: EffectDecl,
}

/// A sensor to simulate or to solve with: the stated one with effects in addition.
#[derive(Clone, Debug)]
pub struct Trial {
    /// The base fields.
    pub nominal: Nominal,
    /// Effects on top.
    pub effects: EffectParameters,
}

/// All candidates: the searchable parameters of all effects, in the order of the catalogue.
pub static CANDIDATES: LazyLock<Vec<Candidate>> = LazyLock::new(|| {
    let numbers = |decl: EffectDecl| {
        decl.search.numbers().iter().map(move |sought| Candidate::from_declaration(decl, *sought))
    };
    let mut all: Vec<Candidate> = catalogue().into_iter().flat_map(|kind| numbers(kind.decl)).collect();
    all.sort_by_key(|candidate| candidate.sought.comes_last);
    all
});

impl Candidate {
    fn from_declaration(decl: EffectDecl, sought: Sought) -> Candidate {
        Candidate {
            id: decl.id,
            parameter: sought.parameter,
            signs: sought.signs,
            is_random: sought.is_random,
            sought,
            decl,
        }
    }

    /// A name of its own: `leak_events.rate`, `large_signal_front_end`.
    pub fn label(&self) -> String {
        if self.parameter.is_empty() { self.id.to_owned() } else { format!("{}.{}", self.id, self.parameter) }
    }

    /// The effect's declaration in the catalogue.
    pub fn decl(&self) -> EffectDecl {
        self.decl
    }

    /// Declaration of its parameter; `None` for a switch.
    pub fn parameter_decl(&self) -> Option<ParameterDecl> {
        self.decl.parameter(self.parameter)
    }

    /// Its JSON key (`rate_hz`, `fraction`) and unit.
    pub fn json_key(&self) -> (String, &'static str) {
        match self.parameter_decl() {
            Some(decl) => (format!("{}{}", decl.name, decl.unit.suffix()), decl.unit.text()),
            None => (self.parameter.to_owned(), ""),
        }
    }

    /// The parameter's value in the description, or else the value that means no effect.
    pub fn nominal_value(&self, nominal: &Nominal) -> f64 {
        self.sought.stated(nominal)
    }

    /// Is the parameter a limit or a time constant, for which infinity and not 0 means no effect?
    pub fn is_limit(&self) -> bool {
        self.sought.grows == Grows::AsItFalls
    }

    /// Is it the reset rule of the description, which is another one?
    pub fn is_reset(&self) -> bool {
        self.sought.field == Some(Field::Reset)
    }

    /// Does the description state its value, or does a 0 stand for it?
    pub fn is_stated(&self, sensor: &Sensor) -> bool {
        match self.sought.field {
            Some(Field::Tau0) => sensor.front_end.tau_0.is_some(),
            Some(Field::Alpha) => sensor.front_end.alpha.is_some(),
            Some(Field::Refractory) => sensor.readout.refractory.is_some(),
            _ => true,
        }
    }

    /// Does a value differ from no effect by a material size? The effect's file declares that size. A switch
    /// and a limit always do.
    pub fn is_material(&self, case: &Case, nominal: &Nominal, value: f64) -> bool {
        if self.signs == Signs::Switch || self.is_limit() {
            return true;
        }
        let measure = |measure: Measure| match measure {
            Measure::Light => typical_light(case, nominal),
            Measure::Signal => typical_dn(case, nominal),
            Measure::Threshold => nominal.pixel.threshold_on,
            Measure::Duration => (case.span.1 - case.span.0) as f64 * 1e-9,
            Measure::StampWidth => case.t_resolution_ns as f64 * 1e-9,
            Measure::Rows => f64::from(case.extent.height),
            other => EffectScales::from_case(case, nominal).measure(other, nominal),
        };
        (value - self.nominal_value(nominal)).abs() > self.sought.material.at(&measure)
    }

    /// The number in [`CANDIDATES`] of an effect's parameter.
    pub fn number(id: &str, parameter: &str) -> Option<usize> {
        CANDIDATES.iter().position(|candidate| candidate.id == id && candidate.parameter == parameter)
    }

    /// The candidate of an effect by one of its parameters.
    pub fn find(id: &str, parameter: &str) -> Option<&'static Candidate> {
        Candidate::number(id, parameter).map(|number| &CANDIDATES[number])
    }

    /// The parameter at an effect size, in the unit of its declaration.
    pub fn value(&self, effect_size: f64, scales: &EffectScales, nominal: &Nominal) -> f64 {
        let typical = scales.natural_size(&self.sought.typical, nominal);
        if self.is_limit() {
            // The faster the limit, the less it matters.
            return typical / f64::max(effect_size, 1e-6);
        }
        let value = self.nominal_value(nominal) + effect_size * typical;
        let (least, most) =
            self.parameter_decl().map_or((f64::NEG_INFINITY, f64::INFINITY), |decl| decl.allowed);
        value.clamp(least, most)
    }

    /// The effect size at which the parameter has a value.
    pub fn effect_size(&self, value: f64, scales: &EffectScales, nominal: &Nominal) -> f64 {
        let typical = scales.natural_size(&self.sought.typical, nominal);
        if self.is_limit() { typical / value } else { (value - self.nominal_value(nominal)) / typical }
    }

    /// Applies the effect to a trial, at an effect size.
    pub fn apply(&self, trial: &mut Trial, effect_size: f64, scales: &EffectScales) {
        if self.is_reset() {
            trial.effects.remove(self.id);
            trial.nominal.reset =
                if trial.nominal.reset == Reset::Resample { Reset::Advance } else { Reset::Resample };
            return;
        }
        let parameters = trial.effects.entry(self.id.to_owned()).or_default();
        if self.signs == Signs::Switch {
            return;
        }
        let value = self.value(effect_size, scales, &trial.nominal);
        let written = |name: &str, value: f64| {
            self.decl.parameter(name).map(|decl| (name.to_owned(), decl.unit.written(value)))
        };
        parameters.extend(written(self.parameter, value));
        for (name, size) in
            self.sought.others.iter().filter(|(name, _)| !parameters.contains_key(*name)).collect::<Vec<_>>()
        {
            parameters.extend(written(name, scales.natural_size(size, &trial.nominal)));
        }
        let Some(companion) = self.sought.companion else { return };
        let applied = Applied { effect_size, value, light: scales.light, model: &trial.nominal };
        if let Some(seconds) = (companion.seconds)(&applied) {
            let stated =
                [(companion.parameter.to_owned(), Unit::Time.written(seconds))].into_iter().collect();
            trial.effects.entry(companion.id.to_owned()).or_insert(stated);
        }
    }
}

fn typical_dn(case: &Case, nominal: &Nominal) -> f64 {
    let Some(frames) = &case.frames else { return 0.0 };
    let mut signals: Vec<f64> = frames
        .every_nth(101)
        .filter(|dn| dn.is_finite())
        .map(|dn| f64::from(dn) - nominal.number.black_level)
        .collect();
    photocurrent_scene::statistics::median(&mut signals).max(0.0)
}

fn typical_light(case: &Case, nominal: &Nominal) -> f64 {
    let exposure_s =
        case.frames.as_ref().and_then(|frames| frames.times.nominal_exposure_ns()).unwrap_or(0) as f64 * 1e-9;
    if exposure_s > 0.0 { typical_dn(case, nominal) / (nominal.number.gain * exposure_s) } else { 0.0 }
}

impl Trial {
    /// The stated sensor.
    pub fn nominal(nominal: &Nominal) -> Trial {
        Trial { nominal: nominal.clone(), effects: EffectParameters::new() }
    }

    /// The stated sensor with one effect.
    pub fn nominal_with_effect(
        nominal: &Nominal,
        candidate: &Candidate,
        effect_size: f64,
        scales: &EffectScales,
    ) -> Trial {
        Trial::nominal(nominal).with_effect(candidate, effect_size, scales)
    }

    /// The same sensor with one effect more.
    #[must_use]
    pub fn with_effect(&self, candidate: &Candidate, effect_size: f64, scales: &EffectScales) -> Trial {
        let mut trial = self.clone();
        candidate.apply(&mut trial, effect_size, scales);
        trial
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use photocurrent_sensor::effects::from_description;
    use photocurrent_sensor::effects::sought::Search;

    #[test]
    fn every_effect_of_the_catalogue_is_a_candidate_or_states_why_not() {
        let mut numbers = 0;
        for kind in catalogue() {
            let of_effect = CANDIDATES.iter().filter(|candidate| candidate.id == kind.decl.id).count();
            match kind.decl.search {
                Search::For(sought) => {
                    assert!(!sought.is_empty() && of_effect == sought.len(), "{}", kind.decl.id)
                }
                Search::Not(why) => assert!(!why.is_empty() && of_effect == 0, "{}", kind.decl.id),
            }
            numbers += of_effect;
        }
        assert_eq!(numbers, CANDIDATES.len());
    }

    #[test]
    fn every_candidate_can_be_applied_at_any_effect_size_and_read_back() {
        let case = testing::case();
        let nominal = case.nominal().unwrap();
        let scales = EffectScales::from_case(&case, &nominal);
        for candidate in CANDIDATES.iter() {
            for effect_size in [0.3, 1.0, 2.0, -0.5] {
                if effect_size < 0.0 && candidate.signs != Signs::Both {
                    continue;
                }
                let trial = Trial::nominal_with_effect(&nominal, candidate, effect_size, &scales);
                from_description(&trial.effects).unwrap_or_else(|why| panic!("{}: {why}", candidate.label()));
                if candidate.signs != Signs::Switch {
                    let value = candidate.value(effect_size, &scales, &nominal);
                    let decl = candidate.parameter_decl().unwrap();
                    let is_cut = value == decl.allowed.0 || value == decl.allowed.1;
                    let back = candidate.effect_size(value, &scales, &nominal);
                    assert!(is_cut || (back - effect_size).abs() < 1e-9, "{}: {back}", candidate.label());
                }
            }
        }
    }
}
