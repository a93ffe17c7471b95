//! `run.json` (`photocurrent-run/1`): what a run says of itself in its output folder, so that a report can be
//! made of it later.
//!
//! It names the nodes that ran, how they are wired, how each ended and how long it took, and by digest what
//! the cache holds of them. Nothing here enters a key, and no node reads it. The form is described in
//! docs/formats.md.

use crate::expect::ExpectRecord;
use crate::failure::{Failure, write_whole};
use photocurrent_core::Digest;
use photocurrent_engine::TaskInput;
use photocurrent_engine::{End, Extract, Outcome, Plan, Project};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

/// Its name in the output folder.
pub const FILE: &str = "run.json";
const SCHEMA: &str = "photocurrent-run/1";

/// A run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    pub schema: String,
    /// Version of the program.
    pub version: String,
    /// The manifest as it was named.
    pub manifest: String,
    /// What the pipeline is for, in the manifest's words.
    pub about: Option<String>,
    pub seed: u64,
    /// What was laid over the manifest.
    pub sets: Vec<String>,
    /// The cache, from the folder of this file.
    pub cache: PathBuf,
    /// The manifest's file, from the folder of this file; empty in what earlier versions wrote.
    #[serde(default, skip_serializing_if = "is_empty")]
    pub manifest_file: PathBuf,
    /// From start to end.
    pub seconds: f64,
    /// Axes of the ablation with their levels; empty without one.
    pub axes: Vec<(String, Vec<String>)>,
    pub variants: Vec<VariantRecord>,
    pub tasks: Vec<TaskRecord>,
    pub warnings: Vec<String>,
    /// Bounds on scores and how these came out.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub expect: Vec<ExpectRecord>,
}

/// A variant and its nodes in running order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VariantRecord {
    pub name: String,
    /// Node and place in `tasks`.
    pub nodes: Vec<(String, usize)>,
    /// Nodes that did not run because a file is missing, and why.
    pub left_out: Vec<(String, String)>,
}

/// What came of one task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TaskRecord {
    pub label: String,
    pub kind: String,
    pub end: End,
    /// How long it ran; a reused one, then.
    pub seconds: f64,
    pub key: Option<Digest>,
    /// All parameters, defaults filled in.
    pub params: serde_json::Value,
    /// Those that differ from their defaults, as `name = value`.
    pub changed: Vec<String>,
    pub inputs: Vec<InputRecord>,
    pub outputs: BTreeMap<String, OutputRecord>,
    pub notes: Vec<String>,
    pub error: Option<String>,
    /// Of a skipped one: the nodes that failed.
    pub because: Vec<String>,
    /// Its files, from the folder of this file.
    pub files: Option<PathBuf>,
}

/// An input of a task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InputRecord {
    pub port: String,
    #[serde(rename = "type")]
    pub data_type: String,
    /// Place in `tasks`, and port, in the manifest's order; the first block of what is joined of several.
    pub from: Vec<(usize, String)>,
    /// What is joined of blocks of time, block by block.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub joined: Vec<Part>,
}

/// A block of a value that is joined in time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Part {
    /// Which entry of `from` it belongs to.
    pub value: usize,
    /// Place in `tasks`.
    pub task: usize,
    pub port: String,
    /// The share of time that is taken from it, ns.
    pub start_ns: i64,
    pub end_ns: i64,
}

/// A stored output.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OutputRecord {
    #[serde(rename = "type")]
    pub data_type: String,
    pub digest: Digest,
    pub bytes: u64,
}

impl RunRecord {
    /// Of a run into `folder` with the cache at `cache`.
    pub fn of(
        project: &Project,
        plan: &Plan,
        outcome: &Outcome,
        sets: &[String],
        cache: &Path,
        folder: &Path,
        seconds: f64,
    ) -> RunRecord {
        let task =
            |(task, came): (&photocurrent_engine::Task, &photocurrent_engine::TaskOutcome)| TaskRecord {
                label: task.label.clone(),
                kind: task.decl.kind.into(),
                end: came.end,
                seconds: came.seconds,
                key: came.key,
                params: task.params.clone(),
                changed: task.changed_params.clone(),
                inputs: task.inputs.iter().map(input_record).collect(),
                outputs: came
                    .outputs
                    .iter()
                    .map(|(port, stored)| {
                        (
                            port.clone(),
                            OutputRecord {
                                data_type: stored.data_type.name().into(),
                                digest: stored.digest,
                                bytes: stored.bytes,
                            },
                        )
                    })
                    .collect(),
                notes: came.notes.clone(),
                error: came.error.as_ref().map(ToString::to_string),
                because: came.because.clone(),
                files: came.export.as_ref().map(|files| relative(folder, files)),
            };
        let variant = |variant: &photocurrent_engine::PlannedVariant| VariantRecord {
            name: variant.name.clone(),
            nodes: variant.nodes.clone(),
            left_out: variant.left_out.iter().map(|left| (left.node.clone(), left.why.clone())).collect(),
        };
        let first = project.pipelines.first();
        RunRecord {
            schema: SCHEMA.into(),
            version: env!("CARGO_PKG_VERSION").into(),
            manifest: project.path.display().to_string(),
            about: first.and_then(|pipeline| pipeline.about.clone()),
            seed: first.map_or(0, |pipeline| pipeline.seed),
            sets: sets.to_vec(),
            cache: relative(folder, cache),
            manifest_file: relative(&real(folder), &real(&project.path)),
            seconds,
            axes: project.ablation.as_ref().map_or_else(Vec::new, |ablation| ablation.axes.clone()),
            variants: outcome.variants.iter().map(variant).collect(),
            tasks: plan.tasks.iter().zip(&outcome.tasks).map(task).collect(),
            warnings: outcome.warnings.clone(),
            expect: Vec::new(),
        }
    }

    /// Writes it into the folder, whole or not at all.
    pub fn save(&self, folder: &Path) -> Result<(), Failure> {
        let text = serde_json::to_string_pretty(self)
            .map_err(|error| Failure::other(format!("{FILE} cannot be written as JSON: {error}")))?;
        write_whole(&folder.join(FILE), (text + "\n").as_bytes())
    }

    /// Reads that of a folder.
    ///
    /// # Errors
    /// When there is none, or it is of another form.
    pub fn load(folder: &Path) -> Result<RunRecord, Failure> {
        let path = folder.join(FILE);
        let wrong = |what: String| Failure::Other {
            message: format!(
                "{}: {what}\n  hint: run the manifest again; what the cache has is not run again",
                path.display()
            ),
            code: 2,
        };
        let text = std::fs::read_to_string(&path).map_err(|error| {
            wrong(format!("cannot read: {error}; a report is made of what `photocurrent run` leaves there"))
        })?;
        let schema = serde_json::from_str::<serde_json::Value>(&text)
            .ok()
            .and_then(|value| Some(value["schema"].as_str()?.to_string()));
        match schema {
            Some(schema) if schema == SCHEMA => {
                serde_json::from_str(&text).map_err(|error| wrong(format!("this is no {SCHEMA}: {error}")))
            }
            Some(other) => Err(wrong(format!("the form is `{other}`, and this version reads `{SCHEMA}`"))),
            None => Err(wrong(format!("found no `schema`; expected a {SCHEMA}"))),
        }
    }
}

fn input_record(input: &TaskInput) -> InputRecord {
    let mut record = InputRecord {
        port: input.port.into(),
        data_type: input.data_type.name().into(),
        from: Vec::new(),
        joined: Vec::new(),
    };
    for parts in input.from.chunk_by(|a, b| a.value == b.value) {
        for part in parts {
            if let Extract::Share(share) = part.extract {
                let (start_ns, end_ns) = (share.start.0, share.end.0);
                record.joined.push(Part {
                    value: record.from.len(),
                    task: part.task,
                    port: part.port.into(),
                    start_ns,
                    end_ns,
                });
            }
        }
        record.from.push((parts[0].task, parts[0].port.into()));
    }
    record
}

fn is_empty(path: &Path) -> bool {
    path.as_os_str().is_empty()
}

/// The path without links, where it is there.
fn real(path: &Path) -> PathBuf {
    std::fs::canonicalize(path).unwrap_or_else(|_| path.into())
}

/// The path as it is shown: from the current folder, when it is below.
fn shown(path: &Path) -> String {
    let here = std::env::current_dir().map(|here| real(&here)).unwrap_or_default();
    path.strip_prefix(&here).unwrap_or(path).display().to_string()
}

/// Two manifests of one name share `out/NAME`. Refuses a folder whose results are of another manifest that is
/// still there; where that was moved or deleted, the folder belongs to whoever has its name. `doing`
/// completes "..., and this is ...; " in the message; `hint` is what to do.
///
/// # Errors
/// When the folder holds the results of another manifest.
pub fn check_same_manifest(folder: &Path, manifest: &Path, doing: &str, hint: &str) -> Result<(), Failure> {
    let Some(record) = std::fs::read_to_string(folder.join(FILE))
        .ok()
        .and_then(|text| serde_json::from_str::<RunRecord>(&text).ok())
    else {
        return Ok(());
    };
    let other = real(&folder.join(&record.manifest_file));
    let this = real(manifest);
    if is_empty(&record.manifest_file) || !other.is_file() || other == this {
        return Ok(());
    }
    let message = format!(
        "{} has the results of {}; {doing} {}\n  hint: {hint}",
        folder.display(),
        shown(&other),
        shown(&this)
    );
    Err(Failure::Other { message, code: 2 })
}

/// `path` as it is written from inside `folder`, so that both may move together.
fn relative(folder: &Path, path: &Path) -> PathBuf {
    let (Ok(folder), Ok(path)) = (std::path::absolute(folder), std::path::absolute(path)) else {
        return path.into();
    };
    let (from, to): (Vec<Component>, Vec<Component>) =
        (folder.components().collect(), path.components().collect());
    let shared = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
    let up = std::iter::repeat_n(Component::ParentDir, from.len() - shared);
    let found: PathBuf = up.chain(to[shared..].iter().copied()).collect();
    if found.as_os_str().is_empty() { ".".into() } else { found }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_written_from_inside_the_folder() {
        let of =
            |folder: &str, path: &str| relative(Path::new(folder), Path::new(path)).display().to_string();
        assert_eq!(of("out/a", ".photocurrent"), "../../.photocurrent");
        assert_eq!(of("out/a", "out/a/sheet"), "sheet");
        assert_eq!(of("/x/out", "/y/cache"), "../../y/cache");
        assert_eq!(of("a", "a"), ".");
    }

    #[test]
    fn what_is_no_record_is_refused_with_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        let message = || match RunRecord::load(folder.path()) {
            Err(Failure::Other { message, code: 2 }) => message,
            _ => panic!("refused"),
        };
        assert!(message().contains("cannot read") && message().contains("run the manifest again"));
        std::fs::write(folder.path().join(FILE), "{\"schema\": \"photocurrent-run/9\"}").unwrap();
        assert!(
            message()
                .contains("the form is `photocurrent-run/9`, and this version reads `photocurrent-run/1`")
        );
        std::fs::write(folder.path().join(FILE), "{}").unwrap();
        assert!(message().contains("found no `schema`"));
    }
}
