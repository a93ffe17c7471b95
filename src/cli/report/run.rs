//! A finished run: what it says of itself, its cache, and what its outputs are called.

use crate::failure::Failure;
use crate::file_kind::FileKind;
use crate::run_record::{FILE, Part, RunRecord, TaskRecord, VariantRecord, check_same_manifest};
use photocurrent_core::{TimeSpan, Value};
use photocurrent_engine::node_of;
use photocurrent_store::Cache;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A task's place and one of its ports.
pub type Output = (usize, String);

/// A finished run.
pub struct Run {
    /// What it is called: its folder.
    pub name: String,
    /// Its output folder.
    pub folder: PathBuf,
    pub record: RunRecord,
    /// Why there is no cache, where there is none.
    cache: Result<Cache, String>,
    labels: BTreeMap<Output, String>,
    /// What is joined of blocks of time, by the first of them.
    joined: BTreeMap<Output, Vec<(Output, TimeSpan)>>,
    /// Only variants with this in their names, if any.
    wanted: Vec<String>,
}

impl Run {
    /// The run of a manifest or of a folder, for `command`; with its cache, unless that is elsewhere, and of
    /// an ablation the variants with a part of `wanted` in their names.
    pub fn open(
        source: &Path,
        command: &str,
        wanted: &[String],
        cache: Option<&Path>,
    ) -> Result<Run, Failure> {
        let usage = |message: String| Failure::Other { message, code: 2 };
        let kind = FileKind::of(source);
        let is_manifest = matches!(kind, FileKind::Manifest);
        let folder = if is_manifest {
            Path::new("out").join(source.file_stem().unwrap_or_default())
        } else {
            source.to_path_buf()
        };
        if !is_manifest && source.exists() && !source.join(FILE).exists() {
            return Err(match kind {
                FileKind::RunFolder => usage(format!(
                    "{}: no {FILE} in the folder: it was written by an earlier version\n  hint: run the \
                     manifest again; what the cache has is not run again",
                    source.display()
                )),
                kind => {
                    kind.refuse(source, command, "a manifest that was run, or the folder that a run wrote to")
                }
            });
        }
        if !folder.join(FILE).exists() {
            let command = if is_manifest {
                format!("photocurrent run {}", source.display())
            } else {
                "photocurrent run MANIFEST".into()
            };
            return Err(usage(format!(
                "{} is not there\n  hint: `{command}` makes it; with --out, name that folder instead of the \
                 manifest",
                folder.join(FILE).display()
            )));
        }
        if is_manifest {
            check_same_manifest(
                &folder,
                source,
                "this is",
                "run this manifest with --out FOLDER, and name that folder instead of the manifest",
            )?;
        }
        let record = RunRecord::load(&folder)?;
        let at = cache.map_or_else(|| folder.join(&record.cache), Path::to_path_buf);
        // Looking makes no folder.
        let cache = if at.is_dir() {
            Cache::open(&at).map_err(|error| error.to_string())
        } else {
            Err(format!("the cache {} is not there", at.display()))
        };
        let absolute = std::path::absolute(&folder)?;
        let name =
            absolute.file_name().map_or_else(|| "run".into(), |name| name.to_string_lossy().into_owned());
        let (labels, joined) = (labels(&record), joined(&record));
        let run = Run { name, folder, record, cache, labels, joined, wanted: wanted.to_vec() };
        if run.variants().next().is_none() {
            let names: Vec<&str> = run.record.variants.iter().map(|variant| variant.name.as_str()).collect();
            return Err(usage(format!(
                "--variant {}: no variant of {} has this in its name\n  hint: there are {}",
                wanted.join(", "),
                run.name,
                names.join("; ")
            )));
        }
        Ok(run)
    }

    /// The variants that are shown.
    pub fn variants(&self) -> impl Iterator<Item = &VariantRecord> {
        self.record.variants.iter().filter(|variant| {
            self.wanted.is_empty() || self.wanted.iter().any(|wanted| variant.name.contains(wanted.as_str()))
        })
    }

    /// A stored output, with the blocks of time that it is joined with; the reason where it cannot be had.
    pub fn value(&self, output: &Output) -> Result<Value, String> {
        let load = |output: &Output| {
            let task = &self.record.tasks[output.0];
            let stored = task
                .outputs
                .get(&output.1)
                .ok_or_else(|| format!("`{}.{}` was not stored", task.label, output.1))?;
            let cache = self.cache.as_ref().map_err(Clone::clone)?;
            cache.load(&stored.digest).map_err(|error| error.to_string())
        };
        let Some(parts) = self.joined.get(output) else { return load(output) };
        let parts: Result<Vec<(Value, TimeSpan)>, String> =
            parts.iter().map(|(part, share)| Ok((load(part)?, *share))).collect();
        Value::joined_in_time(parts?).map_err(|error| error.to_string())
    }

    /// Of a block of a value that is joined: the first of its blocks, and the block's share of time.
    pub fn share(&self, output: &Output) -> Option<(Output, TimeSpan)> {
        let of = |(first, parts): (&Output, &Vec<(Output, TimeSpan)>)| {
            parts.iter().find(|(part, _)| part == output).map(|(_, share)| (first.clone(), *share))
        };
        self.joined.iter().find_map(of)
    }

    /// What people call an output: its label in a table or a picture of the run, else the node's name.
    pub fn label(&self, output: &Output) -> String {
        let task = &self.record.tasks[output.0];
        let name = if self.joined.contains_key(output) { node_of(&task.label) } else { &task.label };
        let plain = || if task.outputs.len() > 1 { format!("{name}.{}", output.1) } else { name.to_string() };
        self.labels.get(output).cloned().unwrap_or_else(plain)
    }

    /// The same, with the variant where several are shown and the output is not common to all of them.
    pub fn label_in(&self, output: &Output, variant: &VariantRecord) -> String {
        let (label, count) = (self.label(output), self.variants().count());
        let sharing =
            self.variants().filter(|other| other.nodes.iter().any(|(_, task)| *task == output.0)).count();
        if count > 1 && sharing < count { format!("{label} [{}]", variant.name) } else { label }
    }

    /// The tasks of a variant with their places, in running order.
    pub fn tasks<'a>(&'a self, variant: &'a VariantRecord) -> impl Iterator<Item = (usize, &'a TaskRecord)> {
        variant.nodes.iter().map(|(_, task)| (*task, &self.record.tasks[*task]))
    }

    /// All stored outputs of a type that a variant's tasks have, in running order.
    pub fn outputs(&self, variant: &VariantRecord, data_type: &str) -> Vec<Output> {
        let of = |(at, task): (usize, &TaskRecord)| {
            let ports = task.outputs.iter().filter(|(_, stored)| stored.data_type == data_type);
            ports.map(|(port, _)| (at, port.clone())).collect::<Vec<_>>()
        };
        self.tasks(variant).flat_map(of).collect()
    }

    /// The frames that a scorer judges: what comes in at its port `frames`.
    pub fn judged(&self, scorer: usize) -> Option<&Output> {
        self.inputs(scorer, "frames").first()
    }

    /// What comes in at a port.
    pub fn inputs(&self, task: usize, port: &str) -> &[Output] {
        self.record.tasks[task]
            .inputs
            .iter()
            .find(|input| input.port == port)
            .map_or(&[], |input| &input.from)
    }
}

/// The blocks of time of every value that some task takes joined, by the first of them.
fn joined(record: &RunRecord) -> BTreeMap<Output, Vec<(Output, TimeSpan)>> {
    let mut all: BTreeMap<Output, Vec<(Output, TimeSpan)>> = BTreeMap::new();
    for input in record.tasks.iter().flat_map(|task| &task.inputs) {
        for parts in input.joined.chunk_by(|a, b| a.value == b.value) {
            let part =
                |part: &Part| ((part.task, part.port.clone()), TimeSpan::new(part.start_ns, part.end_ns));
            all.insert(input.from[parts[0].value].clone(), parts.iter().map(part).collect());
        }
    }
    all
}

/// Labels of outputs, as the run's own tables and pictures have them.
fn labels(record: &RunRecord) -> BTreeMap<Output, String> {
    let mut labels = BTreeMap::new();
    let input = |task: &TaskRecord, port: &str| {
        task.inputs
            .iter()
            .find(|input| input.port == port)
            .map(|input| input.from.clone())
            .unwrap_or_default()
    };
    for task in &record.tasks {
        let Some(texts) = task.params["labels"].as_array() else { continue };
        for (text, from) in texts
            .iter()
            .filter_map(|text| text.as_str())
            .zip(input(task, "frames").into_iter().chain(input(task, "tables")))
        {
            // A table's label is that of the frames it judges.
            let judged = if record.tasks[from.0].kind.starts_with("score/") {
                input(&record.tasks[from.0], "frames").into_iter().next()
            } else {
                None
            };
            labels.entry(judged.unwrap_or(from)).or_insert_with(|| text.to_string());
        }
    }
    labels
}

/// Numbers of colours and dashes, one for each name, the same in all parts of a page.
#[derive(Default)]
pub struct Styles(Vec<String>);

impl Styles {
    /// That of a name.
    pub fn of(&mut self, label: &str) -> usize {
        self.0.iter().position(|known| known == label).unwrap_or_else(|| {
            self.0.push(label.into());
            self.0.len() - 1
        })
    }
}
