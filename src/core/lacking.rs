//! Fields that a sensor description does not state although somebody needs them: what each one is, and how it
//! is written.
//!
//! A pipeline's nodes ask for fields one after the other, and each refuses at the first that is absent. So
//! that a person writes all of them in one go, the planner goes on with example values ([`with_examples`])
//! after a refusal and hears what else is missing. Nothing ever runs with them.

use crate::sensor::Sensor;
use serde_json::{Map, Value, json};

/// A field that a node may not do without.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Needed {
    /// Its TOML path: `front_end.tau_0`.
    pub path: &'static str,
    /// A value as TOML, to show how it is written.
    pub example: &'static str,
    /// What it is.
    pub about: &'static str,
}

/// Every field that a node asks for.
pub const NEEDED: [Needed; 11] = [
    Needed { path: "front_end.tau_0", example: "\"20 us\"", about: "time constant in bright light" },
    Needed {
        path: "front_end.alpha",
        example: "\"12 ms\"",
        about: "how the time constant grows in the dark: time times photocurrent unit",
    },
    Needed { path: "comparator.threshold_on", example: "0.2", about: "ON threshold, natural-log units" },
    Needed { path: "comparator.threshold_off", example: "0.2", about: "OFF threshold, natural-log units" },
    Needed {
        path: "readout.refractory",
        example: "\"50 us\"",
        about: "blind time of a pixel after an event",
    },
    Needed {
        path: "readout.latency_min",
        example: "\"1 us\"",
        about: "smallest delay from the pixel to the stamp",
    },
    Needed { path: "frames.gain", example: "1000.0", about: "DN per second and photocurrent unit" },
    Needed { path: "frames.black_level_dn", example: "0.0", about: "DN of darkness" },
    Needed { path: "frames.saturation_dn", example: "1023.0", about: "DN of a full pixel" },
    Needed {
        path: "frames.row_time",
        example: "\"0 us\"",
        about: "delay from one row's exposure to the next; 0 is a global shutter",
    },
    Needed {
        path: "optics.photocurrent_per_lux",
        example: "0.001",
        about: "photocurrent units per lux on the scene",
    },
];

/// A field by its path.
pub fn needed(path: &str) -> Option<&'static Needed> {
    NEEDED.iter().find(|needed| needed.path == path)
}

/// The description with example values for some of its fields; `None` when one of them has none.
pub fn with_examples(sensor: &Sensor, paths: &[String]) -> Option<Sensor> {
    let mut change = Map::new();
    for path in paths {
        let (table, field) = path.split_once('.')?;
        let value: Value = serde_json::from_str(needed(path)?.example).ok()?;
        change.entry(table).or_insert_with(|| json!({})).as_object_mut()?.insert(field.into(), value);
    }
    sensor.changed(&change).ok()
}

/// The fields as TOML with example values, a table each: what may be copied into a description.
pub fn as_toml(paths: &[String]) -> String {
    let mut text = String::new();
    let mut tables: Vec<&str> = Vec::new();
    for (table, _) in paths.iter().filter_map(|path| path.split_once('.')) {
        if !tables.contains(&table) {
            tables.push(table);
        }
    }
    for table in tables {
        text += &format!("[{table}]\n");
        for (path, field) in paths.iter().filter_map(|path| {
            path.split_once('.').filter(|(of, _)| *of == table).map(|(_, field)| (path, field))
        }) {
            let (example, about) = needed(path).map_or(("...", ""), |needed| (needed.example, needed.about));
            text += &format!("{field} = {example}  # {about}\n");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::Source;

    #[test]
    fn every_example_is_a_value_of_its_field() {
        let all: Vec<String> = NEEDED.iter().map(|needed| needed.path.to_string()).collect();
        let text = format!("format = \"photocurrent-sensor/1\"\n{}", as_toml(&all));
        let read = Sensor::parse(&Source::new("s.toml", "", text)).unwrap();
        assert_eq!(with_examples(&Sensor::unknown(""), &all).unwrap(), read);
        assert_eq!((read.comparator.threshold_on, read.frames.row_time.unwrap().ns()), (Some(0.2), 0));
        assert!(with_examples(&read, &["frames.nothing".into()]).is_none());
    }
}
