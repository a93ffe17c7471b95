//! Reads a sensor description: what is known of one sensor, from a TOML file.
//!
//! The description is small and states facts (thresholds, time constants, gain), so it is read while
//! planning: a node that needs a field which the file does not state can refuse before any data are touched.
//! The form is `photocurrent-sensor/1`; a field that is absent is unknown, not zero. Mistakes in the file are
//! all reported at once, each at its line.
//!
//! Limits: TOML in UTF-8. A recording may carry a description of its own; `read/recording` gives that one.

use photocurrent_core::document::Source;
use photocurrent_core::quantity::InputPath;
use photocurrent_core::{Context, Decl, FileRef, Grain, Meta, Node, NodeError, PortMetas, Sensor};
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value as Json};
use std::sync::Arc;

/// Parameters of `read/sensor`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The description, a TOML file in the form `photocurrent-sensor/1`; relative to the manifest that names
    /// it.
    pub path: InputPath,
    /// Fields to lay over the file's, in its own form: `{ comparator = { threshold_on = 0.3 } }`. For sweeps
    /// over what is not known well.
    #[schemars(schema_with = "fields_of_a_sensor")]
    #[serde(skip_serializing_if = "Map::is_empty")]
    pub change: Map<String, Json>,
}

/// The schema of a description in which every field may be left out.
fn fields_of_a_sensor(generator: &mut SchemaGenerator) -> Schema {
    let mut schema = Sensor::json_schema(generator);
    schema.remove("required");
    schema.insert(
        "description".into(),
        "Fields to lay over the file's, in its own form: `{ comparator = { threshold_on = 0.3 } }`. For \
         sweeps over what is not known well."
            .into(),
    );
    schema.insert("default".into(), Json::Object(Map::new()));
    schema
}

photocurrent_core::ports! {
    /// Nothing is needed.
    pub struct In {}
}

photocurrent_core::ports! {
    /// What the file says.
    pub struct Out {
        /// The sensor description.
        sensor: Arc<Sensor>,
    }
}

/// The node.
pub struct ReadSensor {
    params: Params,
}

impl ReadSensor {
    fn read(&self) -> Result<Arc<Sensor>, NodeError> {
        let path = self.params.path.path();
        let text = std::fs::read_to_string(path).map_err(|error| super::cannot_read(path, &error))?;
        let source = Source::new(path.to_string_lossy(), path.parent().unwrap_or(path), text);
        let sensor = Sensor::parse(&source).map_err(|problems| {
            let mistakes =
                if problems.len() == 1 { "a mistake".into() } else { format!("{} mistakes", problems.len()) };
            NodeError::usage(format!("the sensor description {} has {mistakes}", path.display()))
                .param("path")
                .problems(problems)
        })?;
        if self.params.change.is_empty() {
            return Ok(Arc::new(sensor));
        }
        let changed =
            sensor.changed(&self.params.change).map_err(|why| NodeError::usage(why).param("change"))?;
        Ok(Arc::new(changed))
    }
}

impl Node for ReadSensor {
    const DECL: Decl = Decl {
        kind: "read/sensor",
        about: "Reads a sensor description from a TOML file.",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["photocurrent-sensor/1 (docs/formats.md)"],
        example: r#"
[nodes.sensor]
kind   = "read/sensor"
params = { path = "sensor.toml" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        super::need_path(&params.path, "sensor.toml")?;
        Ok(ReadSensor { params })
    }

    fn plan(&self, _: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Sensor(self.read()?)])
    }

    fn run(&self, _: In, _: &Context) -> Result<Out, NodeError> {
        Ok(Out { sensor: self.read()? })
    }

    fn files(&self) -> Vec<FileRef> {
        vec![FileRef { param: "path".into(), path: self.params.path.path().into() }]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(text: &str) -> Result<Vec<Meta>, NodeError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("hybrid.toml");
        std::fs::write(&path, text).unwrap();
        ReadSensor::build(Params { path: InputPath::new(path), ..Params::default() })?
            .plan(&PortMetas::default())
    }

    #[test]
    fn a_change_is_laid_over_field_by_field() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("hybrid.toml");
        std::fs::write(
            &path,
            "format = \"photocurrent-sensor/1\"\n[comparator]\nthreshold_on = 0.2\nthreshold_off = 0.3\n",
        )
        .unwrap();
        let with = |change: Json| {
            let params = Params { path: InputPath::new(&path), change: change.as_object().unwrap().clone() };
            ReadSensor::build(params).unwrap().read()
        };
        let change = serde_json::json!({
            "comparator": { "threshold_on": 0.25 },
            "effects": { "clock_offset": { "offset": "4 ms" } },
        });
        let sensor = with(change).unwrap();
        assert_eq!(
            (sensor.comparator.threshold_on, sensor.comparator.threshold_off),
            (Some(0.25), Some(0.3))
        );
        assert_eq!(sensor.effects["clock_offset"]["offset"], "4 ms");
        let error = with(serde_json::json!({ "effects": { "clock_ofset": {} } })).unwrap_err();
        assert!(error.message.contains("`clock_ofset` is no effect of the catalogue"), "{}", error.message);
    }

    #[test]
    fn what_the_file_states_is_known_before_any_data() {
        let metas =
            plan("format = \"photocurrent-sensor/1\"\nname = \"hybrid\"\n[comparator]\nthreshold_on = 0.2\n")
                .unwrap();
        let Meta::Sensor(sensor) = &metas[0] else { panic!("a sensor description") };
        assert_eq!(
            (sensor.name.as_str(), sensor.comparator.threshold_on, sensor.comparator.threshold_off),
            ("hybrid", Some(0.2), None)
        );
    }

    #[test]
    fn every_mistake_in_the_file_is_reported_at_its_line() {
        let error = plan(
            "format = \"photocurrent-sensor/1\"\n[comparator]\nthreshold_on = -0.2\ntreshold_off = 0.2\n",
        )
        .unwrap_err();
        assert!(error.message.ends_with("hybrid.toml has 2 mistakes"), "{error}");
        let lines: Vec<usize> =
            error.problems.iter().map(|problem| problem.at.as_ref().unwrap().line_column().0).collect();
        assert_eq!(lines, [3, 4]);
        assert_eq!(error.problems[1].help.as_deref(), Some("did you mean `threshold_off`?"));
    }

    #[test]
    fn a_missing_file_is_named() {
        let error = ReadSensor::build(Params { path: InputPath::new("no/such.toml"), ..Params::default() })
            .unwrap()
            .plan(&PortMetas::default())
            .unwrap_err();
        assert!(error.message.contains("no/such.toml"), "{error}");
        assert_eq!(error.param.as_deref(), Some("path"));
        assert!(ReadSensor::build(Params::default()).err().unwrap().message.contains("`path` is missing"));
    }
}
