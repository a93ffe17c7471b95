//! What is written beside the recordings: the list of their digests, and the answers, in one file or in two
//! halves.
//!
//! With two halves one can be scored and learnt from first, and the other opened once at the end.

use crate::digest::sha256;
use crate::plan::Plan;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// One version: which recordings, and from which seed.
#[derive(Clone, Debug)]
pub struct Version {
    pub plan: Plan,
    pub seed: String,
    /// Are the answers written in two halves?
    pub blind: bool,
    /// Which half alone is made, 0 = open; none for all.
    pub half: Option<usize>,
    pub out: PathBuf,
}

impl Version {
    /// Is it made as the stored version is? Then answers say what that one's say, and lie beside the folder.
    pub fn is_plain(&self) -> bool {
        self.plan == Plan::Short && !self.blind
    }

    /// A file of the list of answers, from the folder in which the list lies.
    pub fn file(&self, name: &str) -> String {
        if self.is_plain() { format!("recordings/{name}") } else { name.to_owned() }
    }
}

/// The name of a recording without folder and ending.
fn id(answer: &Value) -> &str {
    let file = answer["file"].as_str().unwrap_or_default();
    file.rsplit('/').next().unwrap_or_default().trim_end_matches(".h5")
}

/// The answers in two halves: in the order of the hashes of their names the odd places, which may be looked
/// at first, and the even ones. Each half is in the order of names, so that the order does not give the plan
/// away.
pub fn halves(answers: &[Value]) -> [Vec<Value>; 2] {
    let mut ordered: Vec<&Value> = answers.iter().collect();
    ordered.sort_by_key(|answer| sha256(id(answer).as_bytes()));
    let half = |first: usize| {
        let mut half: Vec<Value> =
            ordered.iter().skip(first).step_by(2).map(|answer| (*answer).clone()).collect();
        half.sort_by(|a, b| id(a).cmp(id(b)));
        half
    };
    [half(0), half(1)]
}

/// The list of recordings beside them; it does not give away what they conceal.
fn list(version: &Version, answers: &[Value]) -> String {
    let row = |answer: &Value| {
        format!(
            "| `{}.h5` | {} | {} | `{}` |\n",
            id(answer),
            answer["bytes"],
            answer["events"],
            answer["sha256"].as_str().unwrap_or_default()
        )
    };
    let mut rows: Vec<String> = answers.iter().map(row).collect();
    rows.sort();
    let about = if version.is_plain() {
        "Written by [the generator](../generator) together with the recordings; do not edit.\nWhat they \
         are, how they are made and under which licence: [README.md](../README.md)."
            .to_owned()
    } else {
        format!(
            "Written by the generator of `data/concealed` together with the recordings: plan `{}`, seed \
             `{}`.\nWhat they are, how they are made and under which licence: `data/concealed/README.md`.",
            version.plan.name(),
            version.seed
        )
    };
    format!(
        "# Recordings\n\n{about}\n\n| file | bytes | events | SHA-256 |\n| --- | --- | --- | --- |\n{}",
        rows.concat()
    )
}

/// The answers as a document.
fn document(version: &Version, part: Option<&str>, answers: &[Value]) -> Value {
    let mut document = json!({ "schema": "photocurrent-sealed-answers/1", "seed": version.seed });
    if !version.is_plain() {
        document["plan"] = version.plan.name().into();
    }
    if let Some(part) = part {
        document["part"] = part.into();
    }
    let size = match version.plan {
        Plan::Short | Plan::Field | Plan::Outside => Some([72, 54]),
        Plan::Long => Some([96, 72]),
        Plan::Target => None,
    };
    if let Some([width, height]) = size {
        document["width"] = width.into();
        document["height"] = height.into();
    }
    document["recordings"] = answers.into();
    document
}

/// Writes the list and the answers of all recordings of a version.
///
/// # Errors
/// What the file system says, with the file's name.
pub fn write(version: &Version, answers: &[Value]) -> Result<(), String> {
    let save = |path: &Path, text: &str| {
        std::fs::write(path, text).map_err(|error| format!("{}: cannot be written: {error}", path.display()))
    };
    let answer = |path: &Path, part: Option<&str>, answers: &[Value]| {
        let text = serde_json::to_string_pretty(&document(version, part, answers))
            .map_err(|error| format!("answers: {error}"))?;
        save(path, &(text + "\n"))
    };
    if version.is_plain() {
        let beside = version
            .out
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty())
            .unwrap_or(Path::new("."))
            .join("answers.json");
        answer(&beside, None, answers)?;
    } else if let Some(half) = version.half {
        let [name, part] = [["answers.json", "open"], ["answers-blind.json", "blind"]][half];
        let mut answers = answers.to_vec();
        answers.sort_by(|a, b| id(a).cmp(id(b)));
        answer(&version.out.join(name), Some(part), &answers)?;
    } else if version.blind {
        let [open, blind] = halves(answers);
        answer(&version.out.join("answers.json"), Some("open"), &open)?;
        answer(&version.out.join("answers-blind.json"), Some("blind"), &blind)?;
    } else {
        answer(&version.out.join("answers.json"), None, answers)?;
    }
    save(&version.out.join("README.md"), &list(version, answers))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn the_two_halves_are_disjoint_and_complete() {
        for n in [1usize, 2, 12, 24, 120, 121] {
            let answers: Vec<Value> =
                (0..n).map(|k| json!({ "file": format!("recordings/{:08x}.h5", k * 7_919_111) })).collect();
            let [open, blind] = halves(&answers)
                .map(|half| half.iter().map(|answer| id(answer).to_owned()).collect::<BTreeSet<String>>());
            assert!(open.is_disjoint(&blind));
            assert_eq!((open.len(), blind.len()), (n.div_ceil(2), n / 2));
            assert_eq!(open.union(&blind).count(), n);
            // Which half a recording is in hangs on names alone, and not on the order in which recordings are
            // made.
            let turned: Vec<Value> = answers.iter().rev().cloned().collect();
            assert_eq!(halves(&turned), halves(&answers));
        }
    }

    #[test]
    fn documents_say_which_part_they_are() {
        let version =
            |plan, blind| Version { plan, seed: "s".into(), blind, half: None, out: PathBuf::new() };
        let stored = document(&version(Plan::Short, false), None, &[]);
        let keys: Vec<&String> = stored.as_object().expect("an object").keys().collect();
        assert_eq!(keys, ["schema", "seed", "width", "height", "recordings"]);
        let half = document(&version(Plan::Target, true), Some("blind"), &[]);
        assert_eq!(
            (&half["plan"], &half["part"], half.get("width")),
            (&json!("target"), &json!("blind"), None)
        );
    }
}
