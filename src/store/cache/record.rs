//! What a node made and of what: the ingredients that are its key, in clear text.
//!
//! The key is computed in one place, [`Ingredients::key`]. What is not an ingredient (node id, paths,
//! threads, bands) may stand in the record for people to read, and never enters the key.

use photocurrent_core::digest::DigestBuilder;
use photocurrent_core::{DataType, Digest};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The parameters of a node, as they count.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Params {
    /// [`photocurrent_core::node::canonical_params`] of them: what the key is made of.
    pub canonical: String,
    /// The same for people, defaults filled in. Give the form without paths: what does not enter the key
    /// explains no change.
    pub readable: serde_json::Map<String, serde_json::Value>,
}

/// What stands at an input port.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortInput {
    /// Name of the port.
    pub port: String,
    /// Position at a port that takes several values; 0 elsewhere.
    #[serde(default)]
    pub index: u32,
    /// Type of the value.
    pub data_type: DataType,
    /// Version of its layout.
    pub layout: u32,
    /// Its content.
    pub digest: Digest,
    /// The window of time that is taken of it, ns; all of it where nothing is said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub window: Option<(i64, i64)>,
    /// Of a part of what is joined in time: its share, ns.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub share: Option<(i64, i64)>,
}

/// An outside file that decides the output.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileInput {
    /// The parameter that names it.
    pub param: String,
    /// Where it was, for people; no part of the key.
    pub path: String,
    /// Its content.
    pub digest: Digest,
}

/// Everything that decides a node's outputs.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct Ingredients {
    /// `solve/map`.
    pub kind: String,
    /// Revision of that kind.
    pub revision: u32,
    /// The pipeline's seed, when the node draws.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "seed_text")]
    pub seed: Option<u64>,
    /// Parameters.
    #[serde(flatten, with = "params_text")]
    pub params: Params,
    /// Inputs, in port order.
    #[serde(default)]
    pub inputs: Vec<PortInput>,
    /// Outside files, in declared order.
    #[serde(default)]
    pub files: Vec<FileInput>,
}

impl Ingredients {
    /// The key of the record that holds the outputs.
    pub fn key(&self) -> Digest {
        let mut key = DigestBuilder::new("photocurrent-key/1");
        key.text(&self.kind).integer(self.revision.into()).text(&self.params.canonical);
        key.integer(self.inputs.len() as i64);
        for input in &self.inputs {
            key.text(&input.port)
                .integer(input.index.into())
                .integer(input.layout.into())
                .digest(&input.digest);
            // Nothing is added for whole values: their keys are those of before.
            for (word, span) in [("window", input.window), ("share", input.share)] {
                if let Some((start, end)) = span {
                    key.text(word).integer(start).integer(end);
                }
            }
        }
        key.integer(self.files.len() as i64);
        for file in &self.files {
            key.text(&file.param).digest(&file.digest);
        }
        match self.seed {
            // The bits of the seed: an integer field is signed.
            Some(seed) => key.integer(1).integer(seed as i64),
            None => key.integer(0),
        };
        key.finish()
    }

    /// What changed from here to `new`, one plain line each: `params.cis_weight 1.0 -> 2.0`. Empty when the
    /// keys are equal.
    pub fn differences(&self, new: &Ingredients) -> Vec<String> {
        let mut lines = Vec::new();
        if self.key() == new.key() {
            return lines;
        }
        if self.kind != new.kind {
            lines.push(format!("kind {} -> {}", self.kind, new.kind));
        }
        if self.revision != new.revision {
            lines.push(format!("revision {} -> {}", self.revision, new.revision));
        }
        if self.params.canonical != new.params.canonical {
            let before = lines.len();
            let (old_leaves, new_leaves) = (leaves(&self.params.readable), leaves(&new.params.readable));
            compare(&old_leaves, &new_leaves, |name, change| match change {
                Change::Added(value) => lines.push(format!("params.{name} added: {value}")),
                Change::Removed(value) => lines.push(format!("params.{name} removed: it was {value}")),
                Change::Other(old, new) => lines.push(format!("params.{name} {old} -> {new}")),
            });
            if lines.len() == before {
                lines.push("params changed".into());
            }
        }
        let by_port = |of: &Ingredients| -> BTreeMap<(String, u32), PortInput> {
            of.inputs.iter().map(|input| ((input.port.clone(), input.index), input.clone())).collect()
        };
        compare(&by_port(self), &by_port(new), |(port, index), change| {
            let name = if *index == 0 { port.clone() } else { format!("{port}[{index}]") };
            match change {
                Change::Added(_) => lines.push(format!("input {name} added")),
                Change::Removed(_) => lines.push(format!("input {name} removed")),
                Change::Other(old, new) => {
                    if old.layout != new.layout {
                        lines.push(format!("input {name} layout {} -> {}", old.layout, new.layout));
                    }
                    if old.digest != new.digest {
                        lines.push(format!("input {name} changed content"));
                    }
                    if (old.window, old.share) != (new.window, new.share) {
                        lines.push(format!("input {name} is cut from another block of time"));
                    }
                }
            }
        });
        let by_param = |of: &Ingredients| -> BTreeMap<String, FileInput> {
            of.files.iter().map(|file| (file.param.clone(), file.clone())).collect()
        };
        compare(&by_param(self), &by_param(new), |param, change| match change {
            Change::Added(file) => lines.push(format!("file {} added (params.{param})", file.path)),
            Change::Removed(file) => lines.push(format!("file {} removed (params.{param})", file.path)),
            Change::Other(old, new) if old.digest != new.digest && old.path == new.path => {
                lines.push(format!("file {} changed content", new.path))
            }
            Change::Other(old, new) if old.digest != new.digest => {
                lines.push(format!("file {} -> {}, with another content", old.path, new.path))
            }
            Change::Other(..) => {}
        });
        if self.seed != new.seed {
            let text = |seed: Option<u64>| seed.map_or("none".into(), |seed| seed.to_string());
            lines.push(format!("seed {} -> {}", text(self.seed), text(new.seed)));
        }
        if lines.is_empty() {
            lines.push("the order of inputs or files changed".into());
        }
        lines
    }
}

enum Change<'a, V> {
    Added(&'a V),
    Removed(&'a V),
    Other(&'a V, &'a V),
}

fn compare<K: Ord, V: PartialEq>(
    old: &BTreeMap<K, V>,
    new: &BTreeMap<K, V>,
    mut report: impl FnMut(&K, Change<V>),
) {
    let names: std::collections::BTreeSet<&K> = old.keys().chain(new.keys()).collect();
    for name in names {
        match (old.get(name), new.get(name)) {
            (Some(old), Some(new)) if old != new => report(name, Change::Other(old, new)),
            (Some(old), None) => report(name, Change::Removed(old)),
            (None, Some(new)) => report(name, Change::Added(new)),
            _ => {}
        }
    }
}

/// Every value that is no table, by its dotted name.
fn leaves(table: &serde_json::Map<String, serde_json::Value>) -> BTreeMap<String, serde_json::Value> {
    let mut found = BTreeMap::new();
    for (name, value) in table {
        match value {
            serde_json::Value::Object(inner) => {
                found.extend(leaves(inner).into_iter().map(|(rest, value)| (format!("{name}.{rest}"), value)))
            }
            serde_json::Value::Null => {}
            other => drop(found.insert(name.clone(), other.clone())),
        }
    }
    found
}

/// A value that lies in the cache.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoredOutput {
    /// Its type.
    pub data_type: DataType,
    /// Its content, and the name of its file.
    pub digest: Digest,
    /// Size of the file when it was stored.
    pub bytes: u64,
}

/// A file that the node wrote for the user.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Export {
    /// Name below the node's folder.
    pub name: String,
    /// Size.
    pub bytes: u64,
    /// Content.
    pub digest: Digest,
}

/// What a node made, of what, and when.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Hash of the ingredients, and the name of the record's file.
    pub key: Digest,
    /// Version of the tool that made it.
    pub tool_version: String,
    /// How long the node ran.
    pub seconds: f64,
    /// When it finished, seconds since 1970.
    pub created_unix_s: u64,
    /// What the node had to say.
    #[serde(default)]
    pub notes: Vec<String>,
    /// What decided the outputs.
    #[serde(flatten)]
    pub ingredients: Ingredients,
    /// By port; `None` for an output that is absent, or was not stored.
    #[serde(default, with = "outputs_text")]
    pub outputs: BTreeMap<String, Option<StoredOutput>>,
    /// Files for the user.
    #[serde(default)]
    pub exports: Vec<Export>,
}

impl Record {
    /// The key as the ingredients give it.
    pub fn compute_key(&self) -> Digest {
        self.ingredients.key()
    }
}

/// TOML has no null: an output that is not stored is the text "none".
mod outputs_text {
    use super::StoredOutput;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use std::collections::BTreeMap;

    #[derive(Serialize, Deserialize)]
    #[serde(untagged)]
    enum Output {
        Stored(StoredOutput),
        None(String),
    }

    pub(super) fn serialize<S: Serializer>(
        outputs: &BTreeMap<String, Option<StoredOutput>>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.collect_map(
            outputs
                .iter()
                .map(|(port, output)| (port, output.map_or(Output::None("none".into()), Output::Stored))),
        )
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<BTreeMap<String, Option<StoredOutput>>, D::Error> {
        let outputs = BTreeMap::<String, Output>::deserialize(deserializer)?;
        let output = |output| match output {
            Output::Stored(stored) => Ok(Some(stored)),
            Output::None(text) if text == "none" => Ok(None),
            Output::None(text) => Err(serde::de::Error::custom(format!(
                "an output is a stored value or \"none\", found \"{text}\""
            ))),
        };
        outputs.into_iter().map(|(port, found)| Ok((port, output(found)?))).collect()
    }
}

/// A seed has 64 bits and TOML integers 63: it is written as text.
mod seed_text {
    use serde::{Deserialize, Deserializer, Serializer};

    pub(super) fn serialize<S: Serializer>(seed: &Option<u64>, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&seed.unwrap_or_default())
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u64>, D::Error> {
        String::deserialize(deserializer)?.parse().map(Some).map_err(serde::de::Error::custom)
    }
}

/// Parameters as `params_canonical` and a table `[params]` without nulls.
mod params_text {
    use super::Params;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use serde_json::Value;

    #[derive(Serialize, Deserialize)]
    struct Text {
        params_canonical: String,
        #[serde(default)]
        params: serde_json::Map<String, Value>,
    }

    pub(super) fn serialize<S: Serializer>(params: &Params, serializer: S) -> Result<S::Ok, S::Error> {
        let readable = without_nulls(&Value::Object(params.readable.clone()));
        let params = Text {
            params_canonical: params.canonical.clone(),
            params: readable.as_object().cloned().unwrap_or_default(),
        };
        params.serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Params, D::Error> {
        let text = Text::deserialize(deserializer)?;
        Ok(Params { canonical: text.params_canonical, readable: text.params })
    }

    fn without_nulls(value: &Value) -> Value {
        match value {
            Value::Object(map) => Value::Object(
                map.iter()
                    .filter(|(_, v)| !v.is_null())
                    .map(|(k, v)| (k.clone(), without_nulls(v)))
                    .collect(),
            ),
            Value::Array(items) => Value::Array(
                items
                    .iter()
                    .map(|item| if item.is_null() { "null".into() } else { without_nulls(item) })
                    .collect(),
            ),
            // TOML integers end at 2^63 - 1.
            Value::Number(number) if number.is_u64() && number.as_i64().is_none() => {
                number.to_string().into()
            }
            other => other.clone(),
        }
    }
}
