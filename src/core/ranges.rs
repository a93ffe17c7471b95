//! Numbers of a sensor description that are known to lie in a range: `alpha = ["5 ms", "50 ms"]`.
//!
//! The middle of the range stands for the number wherever one is needed; a diagnosis estimates it from the
//! recording, and the range is what it knows beforehand.

#[cfg(feature = "graph")]
use crate::document::{Item, Problem, Table, Tree};
use crate::quantity::Duration;
#[cfg(feature = "graph")]
use crate::sensor::Sensor;
use serde::{Deserialize, Serialize};
#[cfg(feature = "graph")]
use std::collections::BTreeMap;

/// What a number is, and whether the middle of a range is that of logarithms.
#[cfg(feature = "graph")]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Time,
    Positive,
    Number,
}

/// The fields that may hold a range, by table and key.
#[cfg(feature = "graph")]
const FIELDS: [(&str, &str, Kind); 6] = [
    ("front_end", "tau_0", Kind::Time),
    ("front_end", "alpha", Kind::Time),
    ("comparator", "threshold_on", Kind::Positive),
    ("comparator", "threshold_off", Kind::Positive),
    ("readout", "refractory", Kind::Time),
    ("frames", "black_level_dn", Kind::Number),
];

/// The least and the largest value that a number may have.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Range {
    /// Of a time.
    Time([Duration; 2]),
    /// Of a number, in the unit of its field.
    Number([f64; 2]),
}

impl Range {
    /// Both ends, in seconds or in the unit of the field.
    pub fn ends(self) -> [f64; 2] {
        match self {
            Range::Time(ends) => ends.map(Duration::seconds),
            Range::Number(ends) => ends,
        }
    }

    /// `s` of times; empty otherwise.
    pub fn unit(self) -> &'static str {
        match self {
            Range::Time(_) => "s",
            Range::Number(_) => "",
        }
    }
}

/// Takes ranges out of a description: the middle takes the place of each. Adds what is wrong with them.
#[cfg(feature = "graph")]
pub(crate) fn take(tree: &mut Table, problems: &mut Vec<Problem>) -> BTreeMap<String, Range> {
    let mut found = BTreeMap::new();
    for (table, key, kind) in FIELDS {
        let Some(Tree { item: Item::Table(of), .. }) = tree.get_mut(table) else { continue };
        let Some(value) = of.get_mut(key) else { continue };
        let Item::Array(ends) = &value.item else { continue };
        match range(ends, kind) {
            Ok(range) => {
                value.item = middle(range, kind);
                found.insert(format!("{table}.{key}"), range);
            }
            Err(why) => {
                let example = if kind == Kind::Time { "[\"5 ms\", \"50 ms\"]" } else { "[0.15, 0.3]" };
                problems.push(
                    Problem::at(&value.origin, format!("`{table}.{key}` is no range: {why}"))
                        .label("two values, the smaller first")
                        .help(format!("write `{key} = {example}`, or one value")),
                );
                // Reported once.
                of.remove(key);
            }
        }
    }
    found
}

#[cfg(feature = "graph")]
fn range(ends: &[Tree], kind: Kind) -> Result<Range, String> {
    let [low, high] = ends else { return Err(format!("it has {} values", ends.len())) };
    let number = |tree: &Tree| match tree.item {
        Item::Float(number) if number.is_finite() => Ok(number),
        Item::Integer(number) => Ok(number as f64),
        _ => Err(format!("a number is needed, found {}", tree.describe())),
    };
    let time = |tree: &Tree| -> Result<Duration, String> {
        let text = tree
            .as_str()
            .ok_or_else(|| format!("a time such as \"100 us\" is needed, found {}", tree.describe()))?;
        text.parse().map_err(|error| format!("{error}"))
    };
    let range = match kind {
        Kind::Time => Range::Time([time(low)?, time(high)?]),
        Kind::Positive | Kind::Number => Range::Number([number(low)?, number(high)?]),
    };
    let [low, high] = range.ends();
    if low >= high {
        return Err("its first value is not below its second".to_owned());
    }
    if kind != Kind::Number && (low < 0.0 || kind == Kind::Positive && low == 0.0) {
        return Err("its values must be positive".to_owned());
    }
    Ok(range)
}

/// Of logarithms where both ends are positive numbers.
#[cfg(feature = "graph")]
fn middle(range: Range, kind: Kind) -> Item {
    let [low, high] = range.ends();
    let middle =
        if kind == Kind::Number || low <= 0.0 { f64::midpoint(low, high) } else { libm::sqrt(low * high) };
    match range {
        Range::Time(_) => Item::String(format!("{} ns", (middle * 1e9).round() as i64)),
        Range::Number(_) => Item::Float(middle),
    }
}

/// A description as TOML, with ranges in their places.
#[cfg(feature = "graph")]
pub(crate) fn to_toml(sensor: &Sensor) -> Result<String, toml::ser::Error> {
    if sensor.ranges.is_empty() {
        return toml::to_string(sensor);
    }
    let mut all = toml::Table::try_from(sensor)?;
    all.remove("ranges");
    for (field, range) in &sensor.ranges {
        let Some((table, key)) = field.split_once('.') else { continue };
        if let Some(toml::Value::Table(of)) = all.get_mut(table) {
            of.insert(key.to_owned(), toml::Value::try_from(range)?);
        }
    }
    toml::to_string(&all)
}

#[cfg(all(test, feature = "graph"))]
mod tests {
    use super::*;
    use crate::document::Source;

    const TEXT: &str = r#"
format = "photocurrent-sensor/1"
[front_end]
tau_0 = "20 us"
alpha = ["4 ms", "25 ms"]
[comparator]
threshold_on = [0.1, 0.4]
threshold_off = 0.2
[frames]
black_level_dn = [-10, 30]
"#;

    fn parse(text: &str) -> Result<Sensor, Vec<Problem>> {
        Sensor::parse(&Source::new("s.toml", "", text))
    }

    #[test]
    fn the_middle_of_a_range_stands_for_the_number() {
        let sensor = parse(TEXT).unwrap();
        assert_eq!(sensor.front_end.alpha, Some(Duration::new(10_000_000)));
        assert!((sensor.comparator.threshold_on.unwrap() - 0.2).abs() < 1e-12);
        assert_eq!(sensor.frames.black_level_dn, Some(10.0));
        assert_eq!(sensor.ranges["front_end.alpha"].ends(), [4e-3, 25e-3]);
        assert_eq!((sensor.ranges.len(), sensor.ranges["front_end.alpha"].unit()), (3, "s"));
    }

    #[test]
    fn ranges_survive_being_written_as_json_and_as_toml() {
        let sensor = parse(TEXT).unwrap();
        assert_eq!(serde_json::from_str::<Sensor>(&sensor.canonical_json()).unwrap(), sensor);
        assert!(sensor.to_toml().contains("alpha = [\"4 ms\", \"25 ms\"]"), "{}", sensor.to_toml());
        assert_eq!(parse(&sensor.to_toml()).unwrap(), sensor);
    }

    #[test]
    fn what_is_no_range_is_refused_where_it_stands() {
        let of = |text: &str| parse(&TEXT.replace("[\"4 ms\", \"25 ms\"]", text)).unwrap_err();
        for (text, why) in [
            ("[\"4 ms\"]", "it has 1 values"),
            ("[\"25 ms\", \"4 ms\"]", "not below"),
            ("[4, 25]", "a time such as"),
            ("[\"4 ms\", \"25\"]", "has no unit"),
            ("[\"-4 ms\", \"25 ms\"]", "positive"),
        ] {
            let problems = of(text);
            assert_eq!(problems.len(), 1, "{problems:?}");
            assert!(problems[0].message.contains(why), "{}", problems[0].message);
            assert_eq!(problems[0].at.as_ref().unwrap().line_column(), (5, 9));
        }
        // What may hold none says so.
        let problems = parse(&TEXT.replace("[frames]", "[frames]\ngain = [1, 2]")).unwrap_err();
        assert!(problems[0].message.contains("list"), "{}", problems[0].message);
        assert!(parse(&format!("{TEXT}[ranges]\n")).is_err());
    }
}
