//! Values with a unit, written as text: `"100 us"`, `"10 kHz"`.
//!
//! A bare number where a unit is needed is an error that lists the units accepted. Times are exact:
//! `"0.1 us"` is 100 ns, and a time between two nanoseconds becomes the nearer one, and one that would become
//! zero is refused.

#[cfg(feature = "graph")]
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
#[cfg(feature = "graph")]
use std::borrow::Cow;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Which quantity a text must state. The name is what schema and messages use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dimension {
    /// ns, us, ms, s, min
    Time,
    /// Hz, kHz, MHz, fps
    Rate,
    /// rpm, Hz (turns per second), deg/s
    Rotation,
    /// lx, klx
    Illuminance,
}

impl Dimension {
    /// All of them.
    pub const ALL: [Dimension; 4] =
        [Dimension::Time, Dimension::Rate, Dimension::Rotation, Dimension::Illuminance];

    /// The name in schemas: `time`, `rate`, `rotation`, `illuminance`.
    pub fn name(self) -> &'static str {
        match self {
            Dimension::Time => "time",
            Dimension::Rate => "rate",
            Dimension::Rotation => "rotation",
            Dimension::Illuminance => "illuminance",
        }
    }

    /// The dimension with a name.
    pub fn named(name: &str) -> Option<Dimension> {
        Dimension::ALL.into_iter().find(|d| d.name() == name)
    }

    /// Units and their size in the dimension's base unit, largest last.
    pub fn units(self) -> &'static [(&'static str, f64)] {
        match self {
            Dimension::Time => &[("ns", 1.0), ("us", 1e3), ("ms", 1e6), ("s", 1e9), ("min", 60e9)],
            Dimension::Rate => &[("Hz", 1.0), ("fps", 1.0), ("kHz", 1e3), ("MHz", 1e6)],
            Dimension::Rotation => &[("deg/s", 1.0 / 6.0), ("rpm", 1.0), ("Hz", 60.0)],
            Dimension::Illuminance => &[("lx", 1.0), ("klx", 1e3)],
        }
    }

    /// An example to show in messages.
    pub fn example(self) -> &'static str {
        match self {
            Dimension::Time => "100 us",
            Dimension::Rate => "10 kHz",
            Dimension::Rotation => "292 rpm",
            Dimension::Illuminance => "1000 lx",
        }
    }

    /// `ns, us, ms, s, min`
    pub fn unit_list(self) -> String {
        self.units().iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ")
    }

    /// Reads a text as this quantity, in its base unit (ns, Hz, rpm, lx).
    pub fn read(self, text: &str) -> Result<f64, QuantityError> {
        let bad = |what: String| QuantityError { what, dimension: self };
        let text = text.trim();
        let split = text.find(|c: char| c.is_alphabetic() && c != 'e' && c != 'E').unwrap_or(text.len());
        // An exponent's `e` belongs to the number only when a digit or a sign follows.
        let (number, unit) = (text[..split].trim(), text[split..].trim());
        if unit.is_empty() {
            return Err(bad(format!("`{text}` has no unit")));
        }
        let value: f64 = number.parse().map_err(|_| bad(format!("`{text}` does not begin with a number")))?;
        if !value.is_finite() {
            return Err(bad(format!("`{text}` is not finite")));
        }
        // "µ" exists twice in Unicode; both mean micro.
        let unit = unit.replace(['\u{b5}', '\u{3bc}'], "u");
        let size = self.units().iter().find(|(name, _)| *name == unit).map(|(_, size)| *size);
        let size = size.ok_or_else(|| {
            let knows_it =
                |other: &Dimension| *other != self && other.units().iter().any(|(name, _)| *name == unit);
            bad(match Dimension::ALL.into_iter().find(knows_it) {
                Some(other) => format!("`{unit}` is a unit of {}, not of {}", other.name(), self.name()),
                None => format!("unknown unit `{unit}`"),
            })
        })?;
        let base = value * size;
        if self == Dimension::Time {
            let whole = base.round();
            if whole.abs() > i64::MAX as f64 / 4.0 {
                return Err(bad(format!("`{text}` is longer than the clock can count (about 73 years)")));
            }
            // Calibrations give time constants to the picosecond; the clock counts nanoseconds. Only a time
            // that would vanish is refused.
            if whole == 0.0 && base != 0.0 {
                return Err(bad(format!("`{text}` is shorter than the clock can count (1 ns)")));
            }
            return Ok(whole);
        }
        Ok(base)
    }

    /// Writes a value in base units with the largest unit that leaves no fraction (or the base unit).
    pub fn write(self, base: f64) -> String {
        let whole = |size: f64| base != 0.0 && (base / size).fract() == 0.0;
        let preferred = self.units().iter().rev().find(|(name, size)| {
            whole(*size)
                && *name != "fps"
                && *name != "min"
                && !(self == Dimension::Rotation && *name != "rpm")
        });
        let (name, size) = match (preferred, self) {
            (Some(unit), _) => *unit,
            (None, Dimension::Rotation) => ("rpm", 1.0),
            (None, _) => self.units()[0],
        };
        format!("{} {name}", base / size)
    }
}

/// A text that is not the quantity asked for.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "{what}; expected a {} such as \"{}\" (units: {})",
    dimension.name(), dimension.example(), dimension.unit_list()
)]
pub struct QuantityError {
    /// What was found.
    pub what: String,
    /// What was asked for.
    pub dimension: Dimension,
}

macro_rules! quantity {
    ($(#[$doc:meta])* $name:ident, $dimension:expr, $inner:ty, $unit:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, PartialOrd, Default)]
        pub struct $name($inner);

        impl $name {
            #[doc = concat!("From a number of ", $unit, ".")]
            pub const fn new(value: $inner) -> $name {
                $name(value)
            }
        }

        impl FromStr for $name {
            type Err = QuantityError;
            fn from_str(text: &str) -> Result<$name, QuantityError> {
                Ok($name($dimension.read(text)? as $inner))
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(&$dimension.write(self.0 as f64))
            }
        }

        impl Serialize for $name {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<$name, D::Error> {
                String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
            }
        }

        #[cfg(feature = "graph")]
        impl JsonSchema for $name {
            fn schema_name() -> Cow<'static, str> {
                stringify!($name).into()
            }
            fn json_schema(_: &mut SchemaGenerator) -> Schema {
                json_schema!({
                    "type": "string",
                    "x-quantity": $dimension.name(),
                    "examples": [$dimension.example()],
                })
            }
            fn inline_schema() -> bool {
                true
            }
        }
    };
}

quantity!(
    /// A length of time, in whole nanoseconds: `"100 us"`.
    Duration, Dimension::Time, i64, "nanoseconds"
);
quantity!(
    /// Something per second: `"10 kHz"`, `"120 fps"`.
    Rate, Dimension::Rate, f64, "hertz"
);
quantity!(
    /// A speed of rotation: `"292 rpm"`.
    Rotation, Dimension::Rotation, f64, "turns per minute"
);
quantity!(
    /// Light on the scene: `"1000 lx"`.
    Illuminance, Dimension::Illuminance, f64, "lux"
);

impl Duration {
    /// Nanoseconds.
    pub fn ns(self) -> i64 {
        self.0
    }

    /// Seconds.
    pub fn seconds(self) -> f64 {
        self.0 as f64 / crate::time::NS_PER_S
    }
}

impl Rate {
    /// Hertz.
    pub fn hz(self) -> f64 {
        self.0
    }
}

impl Rotation {
    /// Turns per second.
    pub fn turns_per_s(self) -> f64 {
        self.0 / 60.0
    }
}

impl Illuminance {
    /// Lux.
    pub fn lux(self) -> f64 {
        self.0
    }
}

/// A file to read, written relative to the file that names it. Its place is no part of a cache key; its
/// content is.
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct InputPath(PathBuf);

impl InputPath {
    /// From a path.
    pub fn new(path: impl Into<PathBuf>) -> InputPath {
        InputPath(path.into())
    }

    /// The path.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

#[cfg(feature = "graph")]
impl JsonSchema for InputPath {
    fn schema_name() -> Cow<'static, str> {
        "InputPath".into()
    }
    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "string", "x-path": true })
    }
    fn inline_schema() -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_read_exactly() {
        for (text, ns) in [
            ("100 us", 100_000),
            ("0.1us", 100),
            ("1e3 ns", 1000),
            ("-6 ms", -6_000_000),
            ("2 min", 120_000_000_000),
            ("7 \u{b5}s", 7000),
            ("11.161933 us", 11_162),
        ] {
            assert_eq!(text.parse::<Duration>().unwrap().ns(), ns, "{text}");
        }
        assert_eq!("10 kHz".parse::<Rate>().unwrap().hz(), 10_000.0);
        assert_eq!("292 rpm".parse::<Rotation>().unwrap().turns_per_s(), 292.0 / 60.0);
    }

    #[test]
    fn a_bare_number_lists_the_units() {
        let error = "100".parse::<Duration>().unwrap_err().to_string();
        assert_eq!(
            error,
            "`100` has no unit; expected a time such as \"100 us\" (units: ns, us, ms, s, min)"
        );
        assert!("3 parsec".parse::<Rate>().unwrap_err().to_string().starts_with("unknown unit `parsec`"));
        assert!(
            "0.3 ns"
                .parse::<Duration>()
                .unwrap_err()
                .to_string()
                .contains("shorter than the clock can count")
        );
    }

    #[test]
    fn a_wrong_quantity_is_distinguished_from_a_wrong_unit_and_from_a_wrong_number() {
        let said = |error: QuantityError| error.what;
        assert_eq!(said("8 ms".parse::<Rate>().unwrap_err()), "`ms` is a unit of time, not of rate");
        assert_eq!(said("10 kHz".parse::<Duration>().unwrap_err()), "`kHz` is a unit of rate, not of time");
        assert_eq!(said("fast Hz".parse::<Rate>().unwrap_err()), "`fast Hz` does not begin with a number");
        for text in ["9e12 s", "-9e12 s", "9e300 min"] {
            assert_eq!(
                said(text.parse::<Duration>().unwrap_err()),
                format!("`{text}` is longer than the clock can count (about 73 years)")
            );
        }
    }

    #[test]
    fn one_quantity_has_one_text() {
        for (text, canonical) in
            [("0.1 ms", "100 us"), ("1000 us", "1 ms"), ("0 s", "0 ns"), ("1500 ns", "1500 ns")]
        {
            assert_eq!(text.parse::<Duration>().unwrap().to_string(), canonical);
        }
        assert_eq!("10000 Hz".parse::<Rate>().unwrap().to_string(), "10 kHz");
        assert_eq!("120 fps".parse::<Rate>().unwrap().to_string(), "120 Hz");
    }
}
