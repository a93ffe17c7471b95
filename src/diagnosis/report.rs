//! The report of a diagnosis: `diagnosis.json` (`photocurrent-diagnosis/1`, docs/formats.md), field by field.
//!
//! The text is the same bytes for the same report: fields stand in the order of these structs, numbers are
//! rounded to six significant digits, and nothing in it depends on the clock, the machine or the number of
//! threads.

use crate::candidates::Candidate;
use photocurrent_core::Sensor;
use photocurrent_scene::nominal::Nominal;
use photocurrent_sensor::effects::EffectDecl;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// The version of the form.
pub const SCHEMA: &str = "photocurrent-diagnosis/1";

/// Verdict of a diagnosis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The recording agrees with the description.
    Consistent,
    /// One effect explains the difference.
    Named,
    /// Several causes would do; the recording cannot decide.
    Ambiguous,
    /// Something differs, and no effect of the catalogue explains it.
    Unnamed,
    /// The difference is within the numerical errors of this program.
    Numerical,
    /// The data are inconsistent.
    BrokenData,
    /// There are too few data for any conclusion.
    Insufficient,
}

impl Verdict {
    /// As in the JSON.
    pub fn name(self) -> &'static str {
        match self {
            Verdict::Consistent => "consistent",
            Verdict::Named => "named",
            Verdict::Ambiguous => "ambiguous",
            Verdict::Unnamed => "unnamed",
            Verdict::Numerical => "numerical",
            Verdict::BrokenData => "broken_data",
            Verdict::Insufficient => "insufficient",
        }
    }
}

/// A parameter of an effect by its name, with a value in the unit of its declaration.
pub type NamedNumber = (&'static str, f64);

/// One number of an effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// In `unit`.
    pub estimate: f64,
    /// 95 % interval; absent when it was not worked out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ci95: Option<[f64; 2]>,
    /// The description's value, or the one that means no effect; absent where there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nominal: Option<f64>,
    /// `s`, `Hz`, `fraction`, ...
    pub unit: String,
}

/// Location of an effect: pixels, rows, time, polarity and covariate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Location {
    /// `events`, `frames` or `both`.
    pub stream: String,
    /// `on`, `off` or `both`.
    pub polarity: String,
    /// First and last row.
    pub rows: [u32; 2],
    /// First and last column.
    pub columns: [u32; 2],
    /// First and last instant, ns.
    pub time_ns: [i64; 2],
    /// Covariate, by the names of docs/formats.md.
    pub covariate: String,
    /// How it depends on that, in a word; absent when unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shape: Option<String>,
    /// How many pixels.
    pub pixels: u64,
    /// Which pixels a direct test names, when not all (`y * width + x`, rising; at most [`MASK_LIMIT`]).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pixel_list: Vec<u32>,
}

/// Direct tests, as one that found something.
pub const DIRECT: &str = "direct";

/// The most pixels that a location lists.
pub const MASK_LIMIT: usize = 4096;

/// The recording's evidence for an effect. Quantities that were not measured are absent.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// The test's statistic over its detection threshold (1 = at the threshold).
    pub statistic: f64,
    /// Chance of so much without the effect.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub p_value: Option<f64>,
    /// Gain in log-likelihood on measurements that the estimate did not see, nats.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heldout_nats: Option<f64>,
    /// Its 95 % interval.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heldout_nats_ci95: Option<[f64; 2]>,
    /// The same per event.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heldout_nats_per_event: Option<f64>,
    /// Posterior probability of this effect, conditional on a difference; absent for direct tests.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub posterior: Option<f64>,
    /// Source of the finding: `direct`, or a scene (`picture`, `patches`, `given`).
    pub found_by: Vec<String>,
}

/// An effect that the description does not state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// Catalogue id, or `unnamed`.
    pub id: String,
    /// Ids that would explain the recording about as well.
    pub also_possible: Vec<String>,
    /// In plain words.
    pub plain: String,
    /// As an equation.
    pub equation: String,
    /// Where in the chain: `light`, `front_end`, `comparator`, `reset`, `readout`, `time`, `exposure`.
    pub insertion: String,
    /// Numbers by JSON key.
    pub parameters: BTreeMap<String, Parameter>,
    /// Where it shows.
    pub location: Location,
    /// Its evidence.
    pub evidence: Evidence,
    /// Its numbers as they are declared, by parameter. Not in the JSON.
    #[serde(skip)]
    pub values: Vec<NamedNumber>,
    /// Distance of the residuals with the effect (of a second one: with both) from the noise of the scene
    /// (Kolmogorov and Smirnov); `None` for direct tests. Not in the JSON.
    #[serde(skip)]
    pub ks: Option<f64>,
}

/// A number with the nominal description, and with the fitted one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BeforeAfter {
    /// Nominal.
    pub before: f64,
    /// Fitted.
    pub after: f64,
}

/// Fit of both descriptions to measurements that no earlier step used. Quantities that were not measured are
/// absent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DescriptionFit {
    /// Log-likelihood of held-out measurements, nats per event.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heldout_nats_per_event: Option<BeforeAfter>,
    /// Frames that were held out, predicted from events and the other frames, dB of the largest value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heldout_frame_psnr_db: Option<BeforeAfter>,
    /// Distance of residuals from uniform (Kolmogorov-Smirnov).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration_ks: Option<BeforeAfter>,
}

/// Minimum detectable size of an effect that is not reported.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MinimumDetectable {
    /// Catalogue id.
    pub id: String,
    /// Which number, by JSON key.
    pub parameter: String,
    /// Estimate; absent when only the limit is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub estimate: Option<f64>,
    /// Its standard error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub standard_error: Option<f64>,
    /// The smallest departure from nominal that would have been found in most recordings like this.
    pub minimal_detectable: f64,
    /// The same were the light known, where the scene follows events and absorbs a part of the effect.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub of_known_light: Option<f64>,
    /// The departure from nominal that is usual where a sensor has the effect.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub usual: Option<f64>,
    /// Of all five.
    pub unit: String,
}

/// A property of the scene that resembles a sensor effect.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SceneProperty {
    /// `flicker`.
    pub property: String,
    /// How often.
    pub frequency_hz: f64,
    /// Amplitude as a share of the light.
    pub depth: f64,
    /// First and last instant, ns, of a temporary property.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_ns: Option<[i64; 2]>,
    /// First and last row, where it covers a part of the array.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rows: Option<[u32; 2]>,
    /// And column.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub columns: Option<[u32; 2]>,
}

/// Frequencies this near are one, Hz.
const ONE_RHYTHM_HZ: f64 = 5.0;

impl SceneProperty {
    /// Light that flickers for the whole recording.
    pub(crate) fn flicker(frequency_hz: f64, depth: f64) -> SceneProperty {
        let property = "flicker".to_owned();
        SceneProperty { property, frequency_hz, depth, ..SceneProperty::default() }
    }

    /// Does it have this frequency?
    pub(crate) fn has_frequency(&self, frequency_hz: f64) -> bool {
        (self.frequency_hz - frequency_hz).abs() <= ONE_RHYTHM_HZ
    }
}

/// A number that was estimated with the scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SceneEstimate {
    /// Its TOML path in the sensor description.
    pub field: String,
    /// In `unit`.
    pub estimate: f64,
    /// 95 % interval, within the range.
    pub ci95: [f64; 2],
    /// The description's range: least and largest value.
    pub range: [f64; 2],
    /// `s`, or empty where the field has none.
    pub unit: String,
}

/// An effect that is not identifiable from this recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NotTestable {
    /// Catalogue id.
    pub id: String,
    /// Why.
    pub why: String,
}

/// Provenance of a report.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Digest of events, frames and their times.
    pub recording_digest: String,
    /// Digest of the sensor description.
    pub sensor_digest: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Of the program.
    pub version: String,
    /// The stages that took part, in order.
    pub stages: Vec<String>,
}

/// The whole report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// [`SCHEMA`].
    pub schema: String,
    /// In a word.
    pub verdict: Verdict,
    /// In a sentence.
    pub summary: String,
    /// Strongest first.
    pub effects: Vec<Finding>,
    /// Before and after.
    pub fit: DescriptionFit,
    /// Minimum detectable effects.
    pub detectability: Vec<MinimumDetectable>,
    /// Properties of the scene; no mismatches.
    pub scene: Vec<SceneProperty>,
    /// Numbers that the description states as a range, estimated with the scene.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub estimated: Vec<SceneEstimate>,
    /// Effects that were not testable.
    pub not_testable: Vec<NotTestable>,
    /// Recommended recordings.
    pub next_experiment: Vec<String>,
    /// Share of the misfit that the named effects leave; absent when it was not measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub residual_left: Option<f64>,
    /// The fitted description, next to the report; absent when there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor_fitted: Option<String>,
    /// Provenance.
    pub provenance: Provenance,
}

impl Report {
    /// As the text of `diagnosis.json`, with a newline at its end.
    ///
    /// # Errors
    /// When a number is not finite: a report never holds one.
    pub fn to_json(&self) -> Result<String, String> {
        let mut value = serde_json::to_value(self).map_err(|error| error.to_string())?;
        round_numbers(&mut value);
        let mut text = serde_json::to_string_pretty(&value).map_err(|error| error.to_string())?;
        text.push('\n');
        Ok(text)
    }
}

impl Report {
    /// Effects that are not testable, grouped by reason in the order of the report: reason and ids.
    pub fn not_testable_by_reason(&self) -> Vec<(&str, Vec<&str>)> {
        let mut all: Vec<(&str, Vec<&str>)> = Vec::new();
        for one in &self.not_testable {
            match all.iter_mut().find(|(why, _)| *why == one.why) {
                Some((_, ids)) => ids.push(&one.id),
                None => all.push((&one.why, vec![&one.id])),
            }
        }
        all
    }
}

impl Finding {
    /// A finding of the effect `decl` of the catalogue, without parameters.
    pub fn from_catalogue(decl: &EffectDecl, location: Location, evidence: Evidence) -> Finding {
        Finding {
            id: decl.id.to_owned(),
            also_possible: Vec::new(),
            plain: decl.about.to_owned(),
            equation: decl.equation.to_owned(),
            insertion: decl.stage.name().to_owned(),
            parameters: BTreeMap::new(),
            location,
            evidence,
            values: Vec::new(),
            ks: None,
        }
    }

    /// Did a direct test find it?
    pub fn is_direct(&self) -> bool {
        self.evidence.found_by.iter().any(|by| by == DIRECT)
    }

    /// Adds the parameter of a candidate; a switch has none in the JSON. `sensor`: the description,
    /// `nominal`: the same in numbers.
    pub fn add_parameter(
        &mut self,
        candidate: &Candidate,
        estimate: f64,
        ci95: Option<[f64; 2]>,
        sensor: &Sensor,
        nominal: &Nominal,
    ) {
        self.values.push((candidate.parameter, estimate));
        if candidate.is_reset() {
            self.equation =
                "the reference moves by one threshold at each event, or is taken anew, other than \
                             stated (comparator.reset)"
                    .into();
        }
        if candidate.parameter_decl().is_none() {
            return;
        }
        let (key, unit) = candidate.json_key();
        let has_nominal = !candidate.is_limit() && candidate.is_stated(sensor);
        let nominal = has_nominal.then(|| candidate.nominal_value(nominal));
        self.parameters.insert(key, Parameter { estimate, ci95, nominal, unit: unit.to_owned() });
    }
}

/// The number to six significant digits.
pub fn six_digits(value: f64) -> f64 {
    format!("{value:.5e}").parse().unwrap_or(value)
}

/// A number as text: four significant digits, without an exponent where that is short.
pub fn four_digits(value: f64) -> String {
    let rounded: f64 = format!("{value:.3e}").parse().unwrap_or(value);
    if rounded != 0.0 && (rounded.abs() < 1e-3 || rounded.abs() >= 1e6) {
        format!("{rounded:e}")
    } else {
        format!("{rounded}")
    }
}

fn round_numbers(value: &mut Value) {
    match value {
        Value::Number(number) if number.is_f64() => {
            if let Some(rounded) = number.as_f64().map(six_digits).and_then(serde_json::Number::from_f64) {
                *number = rounded;
            }
        }
        Value::Array(values) => values.iter_mut().for_each(round_numbers),
        Value::Object(fields) => fields.values_mut().for_each(round_numbers),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidates::CANDIDATES;
    use crate::testing;

    fn location() -> Location {
        Location {
            stream: "events".into(),
            polarity: "both".into(),
            rows: [0, 9],
            columns: [0, 11],
            time_ns: [0, 60_000_000],
            covariate: "time_since_last_event".into(),
            shape: None,
            pixels: 120,
            pixel_list: Vec::new(),
        }
    }

    #[test]
    fn a_report_has_the_documented_fields_and_six_digits() {
        let case = testing::case();
        let nominal = case.nominal().unwrap();
        let leak = CANDIDATES.iter().find(|candidate| candidate.id == "leak_events").unwrap();
        let mut effect = Finding::from_catalogue(
            &leak.decl(),
            location(),
            Evidence { statistic: 183.000_000_4, ..Evidence::default() },
        );
        effect.add_parameter(leak, 1.0 / 3.0, Some([0.3, 0.4]), &case.sensor, &nominal);
        let report = Report {
            schema: SCHEMA.to_owned(),
            verdict: Verdict::Named,
            summary: String::new(),
            effects: vec![effect],
            fit: DescriptionFit {
                heldout_frame_psnr_db: Some(BeforeAfter { before: 27.1, after: 31.0 }),
                ..DescriptionFit::default()
            },
            detectability: Vec::new(),
            scene: Vec::new(),
            estimated: Vec::new(),
            not_testable: Vec::new(),
            next_experiment: Vec::new(),
            residual_left: None,
            sensor_fitted: Some("sensor.fitted.toml".into()),
            provenance: Provenance { seed: 7, ..Provenance::default() },
        };
        let text = report.to_json().unwrap();
        let value: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(value["schema"], "photocurrent-diagnosis/1");
        assert_eq!(value["verdict"], "named");
        let effect = &value["effects"][0];
        assert_eq!(effect["id"], "leak_events");
        assert_eq!(effect["insertion"], "reset");
        assert_eq!(effect["parameters"]["rate_hz"]["estimate"], 0.333333);
        assert_eq!(effect["parameters"]["rate_hz"]["nominal"], 0.0);
        assert_eq!(effect["parameters"]["rate_hz"]["unit"], "Hz");
        assert_eq!(effect["evidence"]["statistic"], 183.0);
        assert_eq!(value["fit"]["heldout_frame_psnr_db"]["after"], 31.0);
        assert!(
            value["fit"].get("calibration_ks").is_none(),
            "what was not measured is absent, not null: {text}"
        );
        assert_eq!(value["provenance"]["seed"], 7);
        // What was written is read again as it was.
        let again: Report = serde_json::from_str(&text).unwrap();
        assert_eq!(again.to_json().unwrap(), text);
    }

    #[test]
    fn six_digits_are_kept_at_any_size() {
        assert_eq!(six_digits(123_456_789.0), 123_457_000.0);
        assert_eq!(six_digits(-1.234_567_8e-7), -1.234_57e-7);
        assert_eq!(six_digits(0.0), 0.0);
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!(four_digits(0.123_456), "0.1235");
        assert_eq!(four_digits(1.5e-5), "1.5e-5");
        assert_eq!(four_digits(0.0), "0");
        assert_eq!(four_digits(1234.6), "1235");
    }
}
