//! Numbers of a sensor description that are stated as a range: `alpha = ["5 ms", "50 ms"]`.
//!
//! The middle of the range stands for the number wherever one is needed; a diagnosis estimates it from the
//! recording, with the range as a prior.

#[cfg(feature = "graph")]
use crate::document::{Item, Problem, Table, Tree};
use crate::quantity::Duration;
use serde::{Deserialize, Serialize};
#[cfg(feature = "graph")]
use std::collections::BTreeMap;

/// What a number is.
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

    /// Is the logarithm of the number even in the range, not the number? Where both ends are positive.
    pub fn is_log(self) -> bool {
        self.ends()[0] > 0.0
    }

    /// The middle, of logarithms where these count, in seconds or in the unit of the field.
    pub fn middle(self) -> f64 {
        let [low, high] = self.ends();
        if self.is_log() { libm::sqrt(low * high) } else { f64::midpoint(low, high) }
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
                value.item = middle(range);
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

/// As it stands in a description.
#[cfg(feature = "graph")]
fn middle(range: Range) -> Item {
    match range {
        Range::Time(_) => Item::String(format!("{} ns", (range.middle() * 1e9).round() as i64)),
        Range::Number(_) => Item::Float(range.middle()),
    }
}
