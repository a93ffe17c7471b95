//! What an effect declares, and how its parameters are read from a sensor description.
//!
//! A parameter is text with a unit (`"0.1 Hz"`, `"6 ms"`) or a plain number where there is no unit of
//! measure. The declaration says which; reading, limits and messages all follow from it, so that an effect's
//! file holds physics only.

use super::effect::Effect;
use super::sought::Search;
use photocurrent_core::document::nearest;
use photocurrent_core::quantity::Dimension;
use serde_json::{Map, Value};
use std::collections::BTreeMap;

/// Where in the chain an effect enters: the `insertion` of a diagnosis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Between scene and photodiode.
    Light,
    /// Between photodiode and comparator.
    FrontEnd,
    /// The threshold.
    Comparator,
    /// The reference and when it is taken.
    Reset,
    /// From firing to leaving the array.
    Readout,
    /// The stamp.
    Time,
    /// The frame.
    Exposure,
}

impl Stage {
    /// The word in files: `light`, `front_end`, `comparator`, `reset`, `readout`, `time`, `exposure`.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Light => "light",
            Stage::FrontEnd => "front_end",
            Stage::Comparator => "comparator",
            Stage::Reset => "reset",
            Stage::Readout => "readout",
            Stage::Time => "time",
            Stage::Exposure => "exposure",
        }
    }
}

/// What a parameter is measured in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Text with a unit of time; held in seconds.
    Time,
    /// Text with a unit of rate; held in hertz.
    Rate,
    /// A plain number, of what the text says (`fraction`, `ln`, `photocurrent`, `px`, `1/s`, `DN`).
    Number(&'static str),
    /// A list of whole numbers from 0, such as rows.
    Indices,
    /// One of these words.
    Choice(&'static [&'static str]),
    /// A list of numbers, or of texts with a unit, of what the text says.
    List(&'static str),
}

impl Unit {
    /// The unit in reports: `s`, `Hz`, or the number's own.
    pub fn text(self) -> &'static str {
        match self {
            Unit::Time => "s",
            Unit::Rate => "Hz",
            Unit::Number(of) => of,
            Unit::Indices => "index",
            Unit::Choice(_) => "word",
            Unit::List(of) => of,
        }
    }

    /// Is it one number? Otherwise it is a list or a word.
    pub fn is_number(self) -> bool {
        matches!(self, Unit::Time | Unit::Rate | Unit::Number(_))
    }

    /// What a JSON key appends to the parameter's name.
    pub fn suffix(self) -> &'static str {
        match self {
            Unit::Time => "_s",
            Unit::Rate => "_hz",
            Unit::Number(_) | Unit::Indices | Unit::Choice(_) | Unit::List(_) => "",
        }
    }

    /// A value in the unit of [`Unit::text`] as a description states it: times in whole nanoseconds.
    pub fn written(self, value: f64) -> Value {
        match self {
            Unit::Time => Value::from(format!("{} ns", (value * 1e9).round())),
            Unit::Rate => Value::from(format!("{value} Hz")),
            Unit::Number(_) | Unit::Indices | Unit::Choice(_) | Unit::List(_) => Value::from(value),
        }
    }
}

/// One parameter of an effect. Values are in the unit of [`Unit::text`].
#[derive(Clone, Copy, Debug)]
pub struct ParameterDecl {
    /// TOML key.
    pub name: &'static str,
    /// Its unit.
    pub unit: Unit,
    /// The value that means "no effect"; none = the description's own value of that field.
    pub null: Option<f64>,
    /// Values that are accepted, ends included.
    pub allowed: (f64, f64),
    /// Values met in sensors: where a search looks first.
    pub plausible: (f64, f64),
    /// What it is, with its sign.
    pub about: &'static str,
}

/// What an effect says about itself; its file's documentation in a form that programs read.
#[derive(Clone, Copy, Debug)]
pub struct EffectDecl {
    /// Catalogue id.
    pub id: &'static str,
    /// Where it enters.
    pub stage: Stage,
    /// What it is, in a newcomer's words.
    pub about: &'static str,
    /// The equation, in plain text.
    pub equation: &'static str,
    /// What may be set.
    pub parameters: &'static [ParameterDecl],
    /// The covariate on which it shows, by the names of the diagnosis.
    pub covariate: &'static str,
    /// What it does to events or frames.
    pub signature: &'static str,
    /// Ids (or plain words) of what looks alike.
    pub confused_with: &'static [&'static str],
    /// Where it is described.
    pub source: &'static str,
    /// Ids of what looks alike, and what to record next, to separate the two; each pair stands with one of
    /// them.
    pub apart: &'static [(&'static str, &'static str)],
    /// By which numbers a diagnosis looks for it.
    pub search: Search,
}

impl EffectDecl {
    /// What a parameter says about itself; none when the effect has no such parameter.
    pub fn parameter(&self, name: &str) -> Option<ParameterDecl> {
        self.parameters.iter().find(|parameter| parameter.name == name).copied()
    }
}

/// An effect of the catalogue: its declaration, and how to make one.
#[derive(Clone, Copy, Debug)]
pub struct EffectKind {
    /// What it says about itself.
    pub decl: EffectDecl,
    /// Makes one from parameters that passed the declaration.
    pub build: fn(&Parameters) -> Result<Box<dyn Effect>, String>,
}

impl EffectKind {
    /// Reads parameters and makes the effect.
    ///
    /// # Errors
    /// When a key is unknown, or a value of the wrong kind or out of its limits.
    pub fn read(&self, given: &Map<String, Value>) -> Result<Box<dyn Effect>, String> {
        (self.build)(&Parameters::read(&self.decl, given)?)
    }
}

/// Parameters that passed their declaration.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    effect: &'static str,
    values: BTreeMap<&'static str, f64>,
    lists: BTreeMap<&'static str, Vec<u32>>,
    words: BTreeMap<&'static str, &'static str>,
    rows: BTreeMap<&'static str, Vec<Value>>,
}

impl Parameters {
    /// Checks what is given against a declaration.
    ///
    /// # Errors
    /// With effect, key, what was found and what is expected.
    pub fn read(decl: &EffectDecl, given: &Map<String, Value>) -> Result<Parameters, String> {
        let mut read = Parameters {
            effect: decl.id,
            values: BTreeMap::new(),
            lists: BTreeMap::new(),
            words: BTreeMap::new(),
            rows: BTreeMap::new(),
        };
        for (key, value) in given {
            let Some(parameter) = decl.parameter(key) else {
                return Err(unknown_key(decl, key));
            };
            let wrong = |what: String| format!("`effects.{}.{key}`: {what}", decl.id);
            match parameter.unit {
                Unit::Indices => {
                    let list = indices(value).ok_or_else(|| {
                        wrong(format!("expected a list of whole numbers from 0, found {value}"))
                    })?;
                    read.lists.insert(parameter.name, list);
                    continue;
                }
                Unit::Choice(words) => {
                    read.words.insert(parameter.name, word(words, value).map_err(wrong)?);
                    continue;
                }
                Unit::List(_) => {
                    let list = value
                        .as_array()
                        .ok_or_else(|| wrong(format!("expected a list such as [0.0, 0.1], found {value}")))?;
                    read.rows.insert(parameter.name, list.clone());
                    continue;
                }
                Unit::Time | Unit::Rate | Unit::Number(_) => {}
            }
            let number = quantity(parameter.unit, value).map_err(wrong)?;
            let (least, most) = parameter.allowed;
            if !(number >= least && number <= most) {
                let unit = parameter.unit.text();
                return Err(wrong(format!("expected {least} to {most} {unit}, found {value}")));
            }
            read.values.insert(parameter.name, number);
        }
        Ok(read)
    }

    /// A value in its declared unit (seconds, hertz, plain), when it is given.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.values.get(name).copied()
    }

    /// A value in its declared unit.
    ///
    /// # Errors
    /// When it is not given.
    pub fn need(&self, name: &str) -> Result<f64, String> {
        self.get(name).ok_or_else(|| format!("`effects.{}` needs `{name}`", self.effect))
    }

    /// A time in whole nanoseconds, when it is given.
    pub(crate) fn get_ns(&self, name: &str) -> Option<i64> {
        self.get(name).map(|seconds| (seconds * 1e9).round() as i64)
    }

    /// A time in whole nanoseconds.
    ///
    /// # Errors
    /// When it is not given.
    pub(crate) fn need_ns(&self, name: &str) -> Result<i64, String> {
        self.need(name).map(|seconds| (seconds * 1e9).round() as i64)
    }

    /// One of the words of [`Unit::Choice`].
    ///
    /// # Errors
    /// When it is not given.
    pub(crate) fn need_choice(&self, name: &str) -> Result<&'static str, String> {
        self.choice(name).ok_or_else(|| format!("`effects.{}` needs `{name}`", self.effect))
    }

    /// One of the words of [`Unit::Choice`], when it is given.
    pub(crate) fn choice(&self, name: &str) -> Option<&'static str> {
        self.words.get(name).copied()
    }

    /// Is a [`Unit::List`] given?
    pub(crate) fn has_values(&self, name: &str) -> bool {
        self.rows.contains_key(name)
    }

    /// The values of a [`Unit::List`], each in this unit.
    ///
    /// # Errors
    /// When it is not given, or a value is of another kind.
    pub(crate) fn need_values(&self, name: &str, unit: Unit) -> Result<Vec<f64>, String> {
        let list = self.rows.get(name).ok_or_else(|| format!("`effects.{}` needs `{name}`", self.effect))?;
        let read = |value: &Value| match quantity(unit, value) {
            Ok(number) if number.is_finite() => Ok(number),
            Ok(_) => Err(format!("`effects.{}.{name}`: expected finite numbers, found {value}", self.effect)),
            Err(why) => Err(format!("`effects.{}.{name}`: {why}", self.effect)),
        };
        list.iter().map(read).collect()
    }

    /// A list of whole numbers, when it is given.
    pub fn list(&self, name: &str) -> Option<&[u32]> {
        self.lists.get(name).map(Vec::as_slice)
    }
}

fn unknown_key(decl: &EffectDecl, key: &str) -> String {
    let names: Vec<&str> = decl.parameters.iter().map(|parameter| parameter.name).collect();
    let hint = match nearest(key, names.iter().copied()) {
        Some(near) => format!("did you mean `{near}`?"),
        None => {
            format!("it has {}", names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", "))
        }
    };
    format!("`{key}` is not a parameter of `effects.{}`; {hint}", decl.id)
}

fn quantity(unit: Unit, value: &Value) -> Result<f64, String> {
    let text = |dimension: Dimension, scale: f64| match value {
        Value::String(text) => {
            dimension.read(text).map(|base| base / scale).map_err(|error| error.to_string())
        }
        other => {
            Err(format!("expected a {} such as \"{}\", found {other}", dimension.name(), dimension.example()))
        }
    };
    match unit {
        Unit::Time => text(Dimension::Time, 1e9),
        Unit::Rate => text(Dimension::Rate, 1.0),
        Unit::Number(of) => value.as_f64().ok_or_else(|| format!("expected a number ({of}), found {value}")),
        Unit::Indices | Unit::List(_) => Err("expected a list".to_owned()),
        Unit::Choice(_) => Err("expected a word".to_owned()),
    }
}

fn word(words: &'static [&'static str], value: &Value) -> Result<&'static str, String> {
    let all = || words.iter().map(|word| format!("\"{word}\"")).collect::<Vec<_>>().join(", ");
    let found = value.as_str().and_then(|text| words.iter().find(|word| **word == text));
    found.copied().ok_or_else(|| {
        let near = value.as_str().and_then(|text| nearest(text, words.iter().copied()));
        let hint = near.map(|near| format!("; did you mean \"{near}\"?")).unwrap_or_default();
        format!("expected one of {}, found {value}{hint}", all())
    })
}

fn indices(value: &Value) -> Option<Vec<u32>> {
    value.as_array()?.iter().map(|item| item.as_u64().and_then(|index| u32::try_from(index).ok())).collect()
}
