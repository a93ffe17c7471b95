//! The sensor description: what is known of one sensor, in TOML (`format = "photocurrent-sensor/1"`).
//!
//! A field that is absent is unknown, not zero, where zero would be a claim. So most fields are optional, and
//! who needs one asks with [`Sensor::need`], which says what to add to the description.

use crate::data_type::DataType;
#[cfg(feature = "graph")]
use crate::document::{Item, Origin, Problem, Source, Tree, parse};
use crate::error::NodeError;
use crate::quantity::Duration;
#[cfg(feature = "graph")]
use crate::ranges;
pub use crate::ranges::Range;
#[cfg(feature = "graph")]
use crate::schema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
#[cfg(feature = "graph")]
use std::sync::Arc;

/// The ids that `[effects]` may name: what a sensor may do beyond the paper's model. The list grows, ids
/// never change meaning.
pub const EFFECT_IDS: [&str; 42] = [
    // Front end.
    "dark_current",
    "time_constant",
    "second_pole",
    "large_signal_front_end",
    "slew_limit",
    "high_pass_front_end",
    "bandwidth_gradient",
    // Comparator and reset.
    "dependence",
    "threshold_scale",
    "threshold_asymmetry",
    "threshold_mismatch",
    "threshold_noise",
    "threshold_drift",
    "threshold_gradient",
    "refractory",
    "refractory_spread",
    "refractory_light",
    "reset_memory",
    "leak_events",
    "parasitic_leak",
    "background_activity",
    "hot_pixels",
    "hot_rows",
    "lateral_inhibition",
    // Readout and time.
    "readout_queue",
    "event_loss",
    "timestamp_quantization",
    "timestamp_jitter",
    "clock_offset",
    "clock_drift",
    "row_skew",
    "frame_coupling",
    // Optics.
    "misalignment",
    "blur",
    "crosstalk",
    // Exposure.
    "black_level",
    "frame_nonlinearity",
    "vignetting",
    "row_time",
    "exposure_time",
    "frame_gain_steps",
    "image_lag",
];

/// The version of the form.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "graph", derive(schemars::JsonSchema))]
pub enum SensorFormat {
    /// The only one so far.
    #[serde(rename = "photocurrent-sensor/1")]
    V1,
}

/// A sensor description.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "graph", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// `photocurrent-sensor/1`.
    pub format: SensorFormat,
    /// A name for people.
    #[serde(default)]
    pub name: String,
    /// Photodiode to front-end voltage.
    #[serde(default)]
    pub front_end: FrontEnd,
    /// Front-end voltage to event.
    #[serde(default)]
    pub comparator: Comparator,
    /// Event to stamp.
    #[serde(default)]
    pub readout: Readout,
    /// Photodiode to digital number.
    #[serde(default)]
    pub frames: Frames,
    /// Light to photocurrent.
    #[serde(default)]
    pub optics: Optics,
    /// Anything beyond the paper's model, by catalogue id.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub effects: BTreeMap<String, serde_json::Map<String, serde_json::Value>>,
    /// Of numbers that are stated as a range, by their TOML paths; their fields hold its middle. In TOML the
    /// range stands in the field.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[cfg_attr(feature = "graph", schemars(skip))]
    pub ranges: BTreeMap<String, Range>,
}

/// Photodiode to front-end voltage: `tau = tau_0 + alpha / i_pd`, Eq. (3).
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "graph", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct FrontEnd {
    /// Time constant in bright light.
    #[cfg_attr(feature = "graph", schemars(extend("x-min" = "0 ns")))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tau_0: Option<Duration>,
    /// Time times photocurrent unit.
    #[cfg_attr(feature = "graph", schemars(extend("x-min" = "0 ns")))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alpha: Option<Duration>,
}

/// Front-end voltage to event, Eq. (4).
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "graph", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Comparator {
    /// ON threshold, natural-log units, positive.
    #[cfg_attr(feature = "graph", schemars(extend("exclusiveMinimum" = 0.0)))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub threshold_on: Option<f64>,
    /// OFF threshold, natural-log units, positive.
    #[cfg_attr(feature = "graph", schemars(extend("exclusiveMinimum" = 0.0)))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub threshold_off: Option<f64>,
    /// Sigma of the threshold drawn at each reset, natural-log units; absent = unknown.
    #[cfg_attr(feature = "graph", schemars(range(min = 0.0)))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub threshold_noise: Option<f64>,
    /// What the reference does after an event.
    pub reset: Reset,
}

/// What the reference voltage does after an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "graph", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Reset {
    /// `V_ref := V_FE` at `t_off + refractory`: the paper's rule.
    #[default]
    Resample,
    /// `V_ref` moves by one threshold at `t_in`; a crossing inside the blind time fires at its end.
    Advance,
    /// The same, but a crossing inside the blind time is lost.
    AdvanceLossy,
}

/// Event to stamp.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "graph", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Readout {
    /// Refractory period `t_rp`, from `t_off` on.
    #[cfg_attr(feature = "graph", schemars(extend("x-min" = "0 ns")))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refractory: Option<Duration>,
    /// Smallest `t_off - t_in`.
    #[cfg_attr(feature = "graph", schemars(extend("x-min" = "0 ns")))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub latency_min: Option<Duration>,
}

/// Photodiode to digital number: `DN = black_level + gain x integral of i_pd dt`, Eq. (5).
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "graph", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Frames {
    /// DN per second and photocurrent unit.
    #[cfg_attr(feature = "graph", schemars(extend("exclusiveMinimum" = 0.0)))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain: Option<f64>,
    /// Gain of red, green and blue over `gain`; absent = 1 each: a channel's photocurrent is then counted in
    /// what its frames read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub channel_gain: Option<[f64; 3]>,
    /// DN of darkness.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub black_level_dn: Option<f64>,
    /// DN from which a pixel counts as saturated.
    #[cfg_attr(feature = "graph", schemars(extend("exclusiveMinimum" = 0.0)))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub saturation_dn: Option<f64>,
    /// Delay from one row's exposure to the next.
    #[cfg_attr(feature = "graph", schemars(extend("x-min" = "0 ns")))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub row_time: Option<Duration>,
    /// Sigma of read noise, DN.
    #[cfg_attr(feature = "graph", schemars(range(min = 0.0)))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub read_noise_dn: Option<f64>,
    /// Electrons at `saturation_dn` above black level; 0 = photon shot noise unknown.
    #[cfg_attr(feature = "graph", schemars(range(min = 0.0)))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub full_well_e: Option<f64>,
}

/// Light to photocurrent.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "graph", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Optics {
    /// Photocurrent units per lux on the scene.
    #[cfg_attr(feature = "graph", schemars(extend("exclusiveMinimum" = 0.0)))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub photocurrent_per_lux: Option<f64>,
    /// How strongly an event pixel sees the light of the red, green and blue frame pixels that it lies on,
    /// relative to each other; absent = every photodiode alike.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub event_weights: Option<[f64; 3]>,
}

impl Sensor {
    /// A description that knows nothing.
    pub fn unknown(name: impl Into<String>) -> Sensor {
        Sensor {
            format: SensorFormat::V1,
            name: name.into(),
            front_end: FrontEnd::default(),
            comparator: Comparator::default(),
            readout: Readout::default(),
            frames: Frames::default(),
            optics: Optics::default(),
            effects: BTreeMap::new(),
            ranges: BTreeMap::new(),
        }
    }

    /// From TOML text.
    ///
    /// # Errors
    /// Every mistake, at its place.
    #[cfg(feature = "graph")]
    pub fn parse(source: &Arc<Source>) -> Result<Sensor, Vec<Problem>> {
        let mut table = parse(source)?;
        let mut problems = Vec::new();
        let ranges = ranges::take(&mut table, &mut problems);
        let tree = Tree { item: Item::Table(table), origin: Origin { source: source.clone(), span: 0..0 } };
        let schema = schemars::schema_for!(Sensor).to_value();
        schema::validate(&tree, &schema, "field of a sensor description", &mut problems);
        let effects = tree.as_table().and_then(|table| table.get("effects")).and_then(Tree::as_table);
        for (key, _) in effects.iter().flat_map(|effects| &effects.entries) {
            if !EFFECT_IDS.contains(&key.name.as_str()) {
                let problem =
                    Problem::at(&key.origin, format!("`{}` is no effect of the catalogue", key.name))
                        .label("unknown id");
                problems.push(problem.did_you_mean(&key.name, EFFECT_IDS));
            }
        }
        if !problems.is_empty() {
            return Err(problems);
        }
        let sensor: Sensor = serde_json::from_value(schema::to_json(&tree, &schema))
            .map_err(|error| vec![Problem::at(&tree.origin, error.to_string())])?;
        Ok(Sensor { ranges, ..sensor })
    }

    /// With fields laid over, table by table, in the form of the TOML file.
    ///
    /// # Errors
    /// With the reason when the result is no description: an unknown field or effect, a wrong type or unit.
    pub fn changed(&self, change: &serde_json::Map<String, serde_json::Value>) -> Result<Sensor, String> {
        let mut fields = serde_json::to_value(self).map_err(|error| error.to_string())?;
        lay_over(&mut fields, &serde_json::Value::Object(change.clone()));
        let changed: Sensor = serde_json::from_value(fields).map_err(|error| error.to_string())?;
        match changed.effects.keys().find(|id| !EFFECT_IDS.contains(&id.as_str())) {
            Some(id) => Err(format!("`{id}` is no effect of the catalogue")),
            None => Ok(changed),
        }
    }

    /// As the TOML text that [`Sensor::parse`] reads.
    #[cfg(feature = "graph")]
    pub fn to_toml(&self) -> String {
        self.as_toml().expect("a sensor description is plain data")
    }

    /// With ranges in their places.
    #[cfg(feature = "graph")]
    fn as_toml(&self) -> Result<String, toml::ser::Error> {
        if self.ranges.is_empty() {
            return toml::to_string(self);
        }
        let mut all = toml::Table::try_from(self)?;
        all.remove("ranges");
        for (field, range) in &self.ranges {
            let Some((table, key)) = field.split_once('.') else { continue };
            if let Some(toml::Value::Table(of)) = all.get_mut(table) {
                of.insert(key.to_owned(), toml::Value::try_from(range)?);
            }
        }
        toml::to_string(&all)
    }

    /// As JSON in field order, for digests and the cache.
    pub fn canonical_json(&self) -> String {
        serde_json::to_string(self).expect("a sensor description is plain data")
    }

    /// A field that somebody cannot do without.
    ///
    /// # Errors
    /// When the description does not state it; `field` is its TOML path, `who` the one that needs it.
    pub fn need<T: Copy>(&self, value: Option<T>, field: &str, who: &str) -> Result<T, NodeError> {
        value.ok_or_else(|| self.lacks(&[field], who))
    }

    /// Refuses a description that does not state all of several fields, so that those that are missing are
    /// reported at once. Each field is given with whether it is stated.
    ///
    /// # Errors
    /// When one is not.
    pub fn need_all(&self, fields: &[(&str, bool)], who: &str) -> Result<(), NodeError> {
        let missing: Vec<&str> =
            fields.iter().filter(|(_, stated)| !stated).map(|(field, _)| *field).collect();
        if missing.is_empty() { Ok(()) } else { Err(self.lacks(&missing, who)) }
    }

    fn lacks(&self, fields: &[&str], who: &str) -> NodeError {
        let quoted: Vec<String> = fields.iter().map(|field| format!("`{field}`")).collect();
        let list = match &quoted[..] {
            [all @ .., last] if !all.is_empty() => format!("{} and {last}", all.join(", ")),
            _ => quoted.concat(),
        };
        let called = if self.name.is_empty() { String::new() } else { format!(" \"{}\"", self.name) };
        let them = if fields.len() == 1 { "it" } else { "them" };
        let error = NodeError::usage(format!(
            "{who} needs {list}, and the sensor description{called} does not state {them}"
        ))
        .hint(format!("add {list} to the sensor description"))
        .blames(DataType::Sensor);
        NodeError { lacks: fields.iter().map(ToString::to_string).collect(), ..error }
    }
}

fn lay_over(below: &mut serde_json::Value, above: &serde_json::Value) {
    match (below, above) {
        (serde_json::Value::Object(below), serde_json::Value::Object(above)) => {
            for (key, value) in above {
                lay_over(below.entry(key.clone()).or_insert(serde_json::Value::Null), value);
            }
        }
        (below, above) => *below = above.clone(),
    }
}

#[cfg(all(test, feature = "graph"))]
#[path = "ranges_tests.rs"]
mod ranges_tests;

#[cfg(all(test, feature = "graph"))]
mod tests {
    use super::*;

    const HYBRID: &str = r#"
format = "photocurrent-sensor/1"
name   = "hybrid, indoor"
[front_end]
tau_0 = "20 us"
alpha = "12 ms"
[comparator]
threshold_on = 0.20
threshold_off = 0.21
reset = "advance_lossy"
[readout]
refractory = "50 us"
[frames]
gain = 850
[effects]
leak_events = { rate = "0.1 Hz" }
"#;

    #[test]
    fn absent_is_unknown_and_not_zero() {
        let sensor = Sensor::parse(&Source::new("s.toml", "", HYBRID)).unwrap();
        assert_eq!(sensor.comparator.reset, Reset::AdvanceLossy);
        assert_eq!(sensor.frames.gain, Some(850.0));
        assert_eq!(sensor.frames.black_level_dn, None);
        assert_eq!(sensor.effects["leak_events"]["rate"], "0.1 Hz");
        let error = sensor.need(sensor.frames.row_time, "frames.row_time", "render/rows").unwrap_err();
        assert_eq!(
            error.message,
            "render/rows needs `frames.row_time`, and the sensor description \
                                   \"hybrid, indoor\" does not state it"
        );
        let error = Sensor::unknown("")
            .need_all(&[("a", false), ("b", true), ("c", false), ("d", false)], "somebody")
            .unwrap_err();
        assert_eq!(
            error.message,
            "somebody needs `a`, `c` and `d`, and the sensor description does not state them"
        );
        assert_eq!(error.hint.as_deref(), Some("add `a`, `c` and `d` to the sensor description"));
    }

    #[test]
    fn it_survives_being_written_as_json_and_as_toml() {
        let sensor = Sensor::parse(&Source::new("s.toml", "", HYBRID)).unwrap();
        assert_eq!(serde_json::from_str::<Sensor>(&sensor.canonical_json()).unwrap(), sensor);
        assert_eq!(Sensor::parse(&Source::new("again.toml", "", sensor.to_toml())).unwrap(), sensor);
    }

    #[test]
    fn an_effect_that_is_not_in_the_catalogue_is_refused() {
        let text = HYBRID.replace("leak_events", "leek_events");
        let problems = Sensor::parse(&Source::new("s.toml", "", text)).unwrap_err();
        assert_eq!(problems[0].message, "`leek_events` is no effect of the catalogue");
        assert_eq!(problems[0].help.as_deref(), Some("did you mean `leak_events`?"));
    }

    #[test]
    fn colours_are_three_numbers() {
        let text = HYBRID.replace(
            "gain = 850",
            "gain = 850\nchannel_gain = [1.0, 2.0, 0.5]\n[optics]\nevent_weights = [1, 2, 1]",
        );
        let sensor = Sensor::parse(&Source::new("s.toml", "", text.clone())).unwrap();
        assert_eq!(
            (sensor.frames.channel_gain, sensor.optics.event_weights),
            (Some([1.0, 2.0, 0.5]), Some([1.0, 2.0, 1.0]))
        );
        let text = text.replace("[1, 2, 1]", "[1, 2]").replace("[1.0, 2.0, 0.5]", "[1.0, 2.0, 0.5, 1.0]");
        let problems = Sensor::parse(&Source::new("s.toml", "", text)).unwrap_err();
        let messages: Vec<&str> = problems.iter().map(|p| p.message.as_str()).collect();
        assert_eq!(messages, ["a list of 3 is needed, found 4", "a list of 3 is needed, found 2"]);
    }

    #[test]
    fn mistakes_are_all_reported() {
        let text = HYBRID
            .replace("threshold_on = 0.20", "threshold_on = -0.2")
            .replace("refractory = \"50 us\"", "refractory = 50\nrefactory = 1");
        let problems = Sensor::parse(&Source::new("s.toml", "", text)).unwrap_err();
        let messages: Vec<&str> = problems.iter().map(|p| p.message.as_str()).collect();
        assert_eq!(
            messages,
            [
                "`comparator.threshold_on` must be greater than 0, found -0.2",
                "expected a time with its unit, found the integer 50",
                "`refactory` is not a key of `readout`"
            ]
        );
        assert_eq!(problems[2].help.as_deref(), Some("did you mean `refractory`?"));
    }
}
