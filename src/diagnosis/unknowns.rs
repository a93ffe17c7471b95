//! Parameters that a description states as a range ([`photocurrent_core::sensor::Range`]). They are estimated
//! with the scene, and the description with the estimates is diagnosed.

use crate::candidates::{CANDIDATES, Candidate};
use crate::report::{SceneEstimate, six_digits};
use photocurrent_core::Sensor;
use photocurrent_core::quantity::Duration;
use photocurrent_core::sensor::Range;
use photocurrent_scene::nominal::Nominal;
use photocurrent_sensor::effects::sought::Field;

/// A number that is stated as a range.
#[derive(Clone, Debug, PartialEq)]
pub struct UnknownParameter {
    /// Its TOML path.
    pub field: String,
    /// The range.
    pub range: Range,
}

/// All parameters that a description states as a range.
pub fn unknowns(sensor: &Sensor) -> Vec<UnknownParameter> {
    sensor
        .ranges
        .iter()
        .map(|(field, range)| UnknownParameter { field: field.clone(), range: *range })
        .collect()
}

/// Is an effect just another value of a parameter that the description states as a range?
pub fn is_left_open(sensor: &Sensor, id: &str) -> bool {
    let paths = |candidate: &Candidate| -> &[&str] {
        match candidate.sought.field {
            Some(Field::Tau0) => &["front_end.tau_0"],
            Some(Field::Alpha) => &["front_end.alpha"],
            Some(Field::Thresholds { .. }) => &["comparator.threshold_on", "comparator.threshold_off"],
            Some(Field::Refractory) => &["readout.refractory"],
            Some(Field::BlackLevel) => &["frames.black_level_dn"],
            _ => &[],
        }
    };
    let mut open = CANDIDATES.iter().filter(|one| one.id == id).flat_map(paths);
    open.any(|path| sensor.ranges.contains_key(*path))
}

impl UnknownParameter {
    /// Both ends as they are estimated.
    pub fn bounds(&self) -> [f64; 2] {
        self.range.ends().map(|end| if self.range.is_log() { libm::log(end) } else { end })
    }

    /// The sensor with this parameter at an estimated value.
    #[must_use]
    pub fn with_estimate(&self, nominal: &Nominal, estimated: f64) -> Nominal {
        with_field(nominal, &self.field, self.value(estimated))
    }

    /// In seconds or in the unit of the field.
    pub fn value(&self, estimated: f64) -> f64 {
        if self.range.is_log() { libm::exp(estimated) } else { estimated }
    }

    /// With its standard error, as it is estimated.
    pub fn estimated(&self, at: f64, error: f64) -> SceneEstimate {
        let [low, high] = self.bounds();
        let value = |at: f64| six_digits(self.value(at.clamp(low, high)));
        SceneEstimate {
            field: self.field.clone(),
            estimate: value(at),
            ci95: [-1.96, 1.96].map(|sigmas| value(at + sigmas * error)),
            range: self.range.ends().map(six_digits),
            unit: self.range.unit().to_owned(),
        }
    }
}

/// A sensor with a value in a field, in seconds or in the unit of the field.
fn with_field(nominal: &Nominal, field: &str, value: f64) -> Nominal {
    let mut with = nominal.clone();
    match field {
        "front_end.tau_0" => with.pixel.front_end.tau_0_s = value,
        "front_end.alpha" => with.pixel.front_end.alpha_s = value,
        "comparator.threshold_on" => with.pixel.threshold_on = value,
        "comparator.threshold_off" => with.pixel.threshold_off = value,
        "readout.refractory" => with.pixel.refractory_ns = (value * 1e9).round() as i64,
        "frames.black_level_dn" => with.number.black_level = value,
        _ => {}
    }
    with
}

/// A sensor with the estimates of its open parameters.
#[must_use]
pub fn nominal_with_estimates(nominal: &Nominal, estimates: &[SceneEstimate]) -> Nominal {
    estimates.iter().fold(nominal.clone(), |with, one| with_field(&with, &one.field, one.estimate))
}

/// A description with estimates in the places of ranges.
#[must_use]
pub fn with_estimates(sensor: &Sensor, estimated: &[SceneEstimate]) -> Sensor {
    let mut sensor = sensor.clone();
    for SceneEstimate { field, estimate, .. } in estimated {
        let time = || Some(Duration::new((estimate * 1e9).round() as i64));
        match field.as_str() {
            "front_end.tau_0" => sensor.front_end.tau_0 = time(),
            "front_end.alpha" => sensor.front_end.alpha = time(),
            "comparator.threshold_on" => sensor.comparator.threshold_on = Some(*estimate),
            "comparator.threshold_off" => sensor.comparator.threshold_off = Some(*estimate),
            "readout.refractory" => sensor.readout.refractory = time(),
            "frames.black_level_dn" => sensor.frames.black_level_dn = Some(*estimate),
            _ => continue,
        }
        sensor.ranges.remove(field);
    }
    sensor
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    fn sensor() -> Sensor {
        let mut sensor = testing::sensor();
        let ranges = [
            ("front_end.alpha", Range::Time([2_000_000, 20_000_000].map(Duration::new))),
            ("frames.black_level_dn", Range::Number([-5.0, 30.0])),
            ("comparator.threshold_on", Range::Number([0.1, 0.4])),
        ];
        sensor.ranges = ranges.into_iter().map(|(field, range)| (field.to_owned(), range)).collect();
        sensor
    }

    #[test]
    fn estimates_take_the_places_of_ranges_in_description_and_model_alike() {
        let sensor = sensor();
        let mut nominal = Nominal::of(&sensor);
        let mut all = Vec::new();
        for unknown in unknowns(&sensor) {
            let [low, high] = unknown.bounds();
            let at = low + 0.3 * (high - low);
            nominal = unknown.with_estimate(&nominal, at);
            all.push(unknown.estimated(at, 0.01 * (high - low)));
        }
        let with = with_estimates(&sensor, &all);
        assert!(with.ranges.is_empty() && with != sensor);
        let of = Nominal::of(&with);
        assert!((of.pixel.front_end.alpha_s / nominal.pixel.front_end.alpha_s - 1.0).abs() < 1e-5);
        assert!((of.pixel.threshold_on / nominal.pixel.threshold_on - 1.0).abs() < 1e-5);
        assert!((of.number.black_level - nominal.number.black_level).abs() < 1e-4);
        // 2 ms times 10 to the power of 0.3; -5 and 0.3 times 35.
        assert!((of.pixel.front_end.alpha_s - 2e-3 * libm::pow(10.0, 0.3)).abs() < 1e-7);
        assert!((of.number.black_level - 5.5).abs() < 1e-9);
    }

    #[test]
    fn an_interval_ends_where_the_range_does() {
        let sensor = sensor();
        let unknown = unknowns(&sensor).into_iter().find(|one| one.field == "frames.black_level_dn").unwrap();
        let found = unknown.estimated(28.0, 5.0);
        assert_eq!((found.estimate, found.ci95[1], found.range), (28.0, 30.0, [-5.0, 30.0]));
    }

    #[test]
    fn what_a_description_leaves_open_is_no_departure_from_it() {
        let is = |id: &str| is_left_open(&sensor(), id);
        assert!(is("time_constant") && is("black_level") && is("threshold_asymmetry"));
        assert!(!is("refractory") && !is("clock_offset"));
    }
}
