//! The fitted description: the stated one with the findings applied, as simulator and solver load it.
//!
//! Parameters with a field of their own (time constants, thresholds, blind time, black level, row time, reset
//! rule) change that field. All others stand under `[effects]`.

use crate::candidates::{Candidate, EffectScales, Trial};
use crate::integrity::{Integrity, hot, stamps};
use crate::record::EffectParameters;
use crate::report::{NamedNumber, six_digits};
use photocurrent_core::Sensor;
use photocurrent_core::quantity::Duration;
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use photocurrent_sensor::effects::catalogue;
use photocurrent_sensor::effects::sought::Field;

/// A description with effects put in: of each the catalogue's id, and numbers.
pub fn fitted(
    sensor: &Sensor,
    nominal: &Nominal,
    scales: &EffectScales,
    found: &[(&str, &[NamedNumber])],
) -> Sensor {
    let mut sensor = sensor.clone();
    let mut trial = Trial::nominal(nominal);
    for (id, numbers) in found {
        for (candidate, value) in
            numbers.iter().filter_map(|(name, value)| Some((Candidate::find(id, name)?, six_digits(*value))))
        {
            if !put_in_field(&mut sensor, nominal, candidate, value) {
                let effect_size = candidate.effect_size(value, scales, nominal);
                candidate.apply(&mut trial, effect_size, scales);
            }
        }
    }
    sensor.effects.extend(trial.effects);
    found.iter().for_each(|(id, numbers)| add_numbers(&mut sensor.effects, id, numbers));
    sensor
}

/// Puts numbers of an effect that are no candidates of their own (the phase of a coupling, the rate of hot
/// pixels) with those that are; each in the unit of its declaration. Nothing where the description does not
/// state the effect under `[effects]`.
fn add_numbers(effects: &mut EffectParameters, id: &str, numbers: &[NamedNumber]) {
    let Some(stated) = effects.get_mut(id) else { return };
    let Some(decl) = catalogue().into_iter().map(|kind| kind.decl).find(|decl| decl.id == id) else { return };
    for (name, value) in numbers.iter().filter(|(name, _)| Candidate::find(id, name).is_none()) {
        let Some(parameter) = decl.parameter(name) else { continue };
        stated.insert((*name).to_owned(), parameter.unit.written(six_digits(*value)));
    }
}

/// The recording with the direct tests' findings in its description and without the pixels that they exclude.
pub fn apply_direct_findings(
    case: &Case,
    nominal: &Nominal,
    scales: &EffectScales,
    integrity: &Integrity,
) -> Case {
    let mut amended = case.without_pixels(&integrity.masked);
    // Hot rows and pixels are out with their pixels.
    let rest = integrity.findings.iter().filter(|departure| !hot::IDS.contains(&departure.id));
    let found: Vec<(&str, &[NamedNumber])> =
        rest.clone().map(|departure| (departure.id, &departure.parameters[..])).collect();
    amended.sensor = fitted(&case.sensor, nominal, scales, &found);
    if let Some(step) = rest.filter(|departure| departure.id == stamps::GRID).find_map(|of| of.value("step"))
    {
        amended.t_resolution_ns = (step * 1e9).round() as i64;
    }
    amended
}

/// The text of a fitted description, headed by a comment that lists the findings and their alternatives.
pub fn with_findings(fitted: &Sensor, found: &[(String, Vec<String>)]) -> String {
    let mut text = String::from("# The stated sensor with what `photocurrent diagnose` found put in.\n");
    for (id, also_possible) in found {
        let others: String = also_possible.iter().map(|id| format!(" (or {id})")).collect();
        text.push_str(&format!("# {id}{others}\n"));
    }
    text.push_str(&fitted.to_toml());
    text
}

/// Changes the field that an effect belongs to; false when it has none.
fn put_in_field(sensor: &mut Sensor, nominal: &Nominal, candidate: &Candidate, value: f64) -> bool {
    let duration = |seconds: f64| Some(Duration::new((seconds * 1e9).round().max(0.0) as i64));
    let (on, off) =
        (sensor.comparator.threshold_on.unwrap_or(0.0), sensor.comparator.threshold_off.unwrap_or(0.0));
    let Some(field) = candidate.sought.field else { return false };
    match field {
        Field::Tau0 => sensor.front_end.tau_0 = duration(value),
        Field::Alpha => sensor.front_end.alpha = duration(value),
        Field::Thresholds { off: sign } => {
            sensor.comparator.threshold_on = Some(six_digits(on * (1.0 + value)));
            sensor.comparator.threshold_off = Some(six_digits(off * (1.0 + sign * value)));
        }
        Field::ThresholdNoise => sensor.comparator.threshold_noise = Some(six_digits(value)),
        Field::Refractory => sensor.readout.refractory = duration(value),
        Field::Reset => {
            let mut trial = Trial::nominal(nominal);
            candidate.apply(&mut trial, 1.0, &EffectScales::default());
            sensor.comparator.reset = trial.nominal.reset;
        }
        Field::BlackLevel => sensor.frames.black_level_dn = Some(value),
        Field::RowTime => sensor.frames.row_time = duration(value),
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidates::CANDIDATES;
    use crate::testing;
    use photocurrent_core::document::Source;
    use photocurrent_core::sensor::Reset;
    use photocurrent_sensor::effects::from_description;
    use serde_json::json;
    use std::path::Path;

    fn fitted_with(found: &[(&str, &'static str, f64)]) -> Sensor {
        let case = testing::case();
        let nominal = case.nominal().unwrap();
        let scales = EffectScales::from_case(&case, &nominal);
        let numbers: Vec<[NamedNumber; 1]> = found.iter().map(|(_, name, value)| [(*name, *value)]).collect();
        let found: Vec<(&str, &[NamedNumber])> =
            found.iter().zip(&numbers).map(|((id, ..), numbers)| (*id, &numbers[..])).collect();
        fitted(&testing::sensor(), &nominal, &scales, &found)
    }

    fn read_back(sensor: &Sensor) -> Sensor {
        let source = Source::new("sensor.fitted.toml", Path::new("."), sensor.to_toml());
        Sensor::parse(&source)
            .unwrap_or_else(|problems| panic!("{}\n{}", problems[0].message, sensor.to_toml()))
    }

    #[test]
    fn effects_with_a_field_change_it_and_the_text_is_read_back() {
        let sensor = fitted_with(&[
            ("time_constant", "alpha", 0.012),
            ("threshold_asymmetry", "fraction", 0.1),
            ("refractory", "refractory", 379e-6),
        ]);
        assert_eq!(sensor.front_end.alpha, Some(Duration::new(12_000_000)));
        assert!((sensor.comparator.threshold_on.unwrap() - 0.22).abs() < 1e-12);
        assert!((sensor.comparator.threshold_off.unwrap() - 0.189).abs() < 1e-12);
        assert_eq!(sensor.readout.refractory, Some(Duration::new(379_000)));
        assert!(sensor.effects.is_empty());
        assert_eq!(read_back(&sensor), sensor);
    }

    #[test]
    fn numbers_that_are_not_sought_are_added_to_those_that_are() {
        let mut sensor = fitted_with(&[("frame_coupling", "step", 0.03), ("hot_pixels", "fraction", 0.002)]);
        add_numbers(
            &mut sensor.effects,
            "frame_coupling",
            &[("step", 0.5), ("period", 0.04), ("phase", 4.7e-4), ("row_time", 35.25e-6)],
        );
        add_numbers(&mut sensor.effects, "hot_pixels", &[("rate", 900.0)]);
        add_numbers(&mut sensor.effects, "hot_rows", &[("rate", 900.0)]);
        let coupling = &sensor.effects["frame_coupling"];
        assert!((coupling["step"].as_f64().unwrap() - 0.03).abs() < 1e-12);
        assert_eq!(
            ["period", "phase", "row_time"].map(|name| coupling[name].clone()),
            ["40000000 ns", "470000 ns", "35250 ns"].map(|text| json!(text))
        );
        assert_eq!(sensor.effects["hot_pixels"]["rate"], "900 Hz");
        assert!(!sensor.effects.contains_key("hot_rows"));
        assert_eq!(from_description(&read_back(&sensor).effects).unwrap().len(), 2);
    }

    #[test]
    fn another_reset_rule_and_a_common_threshold_error_change_fields_too() {
        let sensor = fitted_with(&[
            ("refractory", "reset", 1.0),
            ("threshold_scale", "fraction", -0.25),
            ("black_level", "black_level_dn", 31.5),
        ]);
        assert_eq!(sensor.comparator.reset, Reset::Advance);
        assert!((sensor.comparator.threshold_on.unwrap() - 0.15).abs() < 1e-12);
        assert_eq!(sensor.frames.black_level_dn, Some(31.5));
        assert_eq!(read_back(&sensor), sensor);
    }

    #[test]
    fn every_candidate_gives_a_description_that_loads() {
        let case = testing::case();
        let nominal = case.nominal().unwrap();
        let scales = EffectScales::from_case(&case, &nominal);
        for candidate in CANDIDATES.iter() {
            let sensor = fitted(
                &testing::sensor(),
                &nominal,
                &scales,
                &[(candidate.id, &[(candidate.parameter, candidate.value(1.0, &scales, &nominal))])],
            );
            let back = read_back(&sensor);
            from_description(&back.effects).unwrap_or_else(|why| panic!("{}: {why}", candidate.label()));
            assert_ne!(back, testing::sensor(), "{}", candidate.label());
        }
    }
}
