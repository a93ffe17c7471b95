//! Some rows of a pipeline by themselves, and their union: how one result is made by several processes or
//! machines.
//!
//! A task whose outputs are cut into row bands can be run for some rows only, as long as what it takes can be
//! as well, or is there whole. [`run_part`] does so for every such task of a plan, with as many more rows of
//! the tasks before as those after reach, and keeps the bands in a folder. What must be whole and comes
//! before such a task is run as ever, into the cache. What must be whole and comes after all of them, scores
//! and written files among it, is left to the run that joins the parts: [`crate::run`] with
//! [`Options::parts`] takes bands from them instead of computing them, so cache and files are what one
//! process would have made, byte for byte.
//!
//! A part is complete when its `part.toml` is there, which is written last; the same command on a complete
//! part does nothing, and on another one goes on.

use crate::blocks::extracted;
use crate::key;
use crate::observer::{End, Observer};
use crate::outcome::Outcome;
use crate::plan::Plan;
use crate::schedule::{Cutter, Options, checked, cut, guarded, halo_of, inputs_of, wanted};
use crate::task::{PlannedVariant, Task, TaskId};
use photocurrent_core::context::{Common, Notes, Silent};
use photocurrent_core::ports::PortValues;
use photocurrent_core::{Context, Digest, Meta, NodeError, Rows, Value};
use photocurrent_store::{BandStore, Cache, KeptBand, Lookup, TOOL_VERSION};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

const FORMAT: &str = "photocurrent-part/1";
/// The file that makes a part complete.
const PROMISE: &str = "part.toml";
/// Where its bands are, and those of other rows that it needed for them.
const BANDS: &str = "bands";
const AROUND: &str = "around";

/// What `part.toml` says.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Promise {
    format: String,
    tool_version: String,
    start: u32,
    end: u32,
    /// Node, and what its result is a function of.
    nodes: BTreeMap<String, Digest>,
}

/// What came of a part.
#[derive(Debug)]
pub enum PartEnd {
    /// It is complete; these nodes ran for its rows, none where it was there already.
    Complete(Vec<String>),
    /// What must be whole before it did not come to its end.
    Before(Outcome),
}

/// Which tasks of a plan can be made in parts.
struct Division {
    /// Those that can, in running order.
    parted: Vec<TaskId>,
    /// Those that must be whole before.
    before: BTreeSet<TaskId>,
}

fn divide(plan: &Plan) -> Division {
    let can: Vec<bool> = plan
        .tasks
        .iter()
        .map(|task| rows_of(task).is_some_and(|rows| halo_of(task, rows).is_some()))
        .collect();
    let mut before = BTreeSet::new();
    // From the last on: what something in `before` needs is there as well, and so is what cannot be cut and
    // is needed by what can.
    let mut has_parted_after = vec![false; plan.tasks.len()];
    for id in (0..plan.tasks.len()).rev() {
        if has_parted_after[id] && !can[id] {
            before.insert(id);
        }
        for need in plan.tasks[id].needs() {
            has_parted_after[need] |= has_parted_after[id] || can[id];
            if before.contains(&id) {
                before.insert(need);
            }
        }
    }
    let parted = (0..plan.tasks.len()).filter(|id| can[*id] && !before.contains(id)).collect();
    Division { parted, before }
}

fn rows_of(task: &Task) -> Option<Rows> {
    task.stored().find_map(|output| output.meta.rows())
}

impl Plan {
    /// Only some tasks, which must include all that they need.
    fn only(&self, keep: &BTreeSet<TaskId>) -> Plan {
        let place: BTreeMap<TaskId, TaskId> = keep.iter().enumerate().map(|(new, old)| (*old, new)).collect();
        let tasks = keep.iter().map(|id| {
            let mut task = self.tasks[*id].clone();
            task.inputs
                .iter_mut()
                .flat_map(|input| &mut input.from)
                .for_each(|source| source.task = place[&source.task]);
            task
        });
        let variants = self.variants.iter().map(|variant| {
            let nodes =
                variant.nodes.iter().filter_map(|(node, id)| Some((node.clone(), *place.get(id)?))).collect();
            PlannedVariant { nodes, ..variant.clone() }
        });
        Plan {
            manifest_id: self.manifest_id,
            tasks: tasks.collect(),
            variants: variants.collect(),
            is_ablation: self.is_ablation,
        }
    }

    /// The rows that can be made in parts: all of them, as the first such task has them.
    ///
    /// # Errors
    /// When nothing of the plan can be made in parts, or tasks differ in their number of rows.
    pub fn rows(&self) -> Result<Rows, NodeError> {
        let mut found: Option<(Rows, &str)> = None;
        for task in divide(self).parted.into_iter().map(|id| &self.tasks[id]) {
            let rows = rows_of(task).unwrap_or(Rows { start: 0, end: 0 });
            match found {
                Some((before, label)) if before != rows => {
                    return Err(NodeError::usage(format!(
                        "{label} has {before} and {} has {rows}: a part has the same rows everywhere",
                        task.label
                    ))
                    .hint("name one of them with --to, or run the pipeline in one piece"));
                }
                _ => found = Some((rows, &task.label)),
            }
        }
        found.map(|(rows, _)| rows).ok_or_else(|| {
            NodeError::usage("nothing in this plan can be made row by row")
                .hint("run it in one piece: leave --rows and --part away")
        })
    }
}

/// Runs what can be cut into row bands for `rows` only, and keeps it in `folder`.
///
/// # Errors
/// When `rows` are not there or cannot be made by themselves, the folder holds something else, or a node
/// fails.
pub fn run_part(
    plan: &Plan,
    cache: &Cache,
    options: &Options,
    rows: Rows,
    folder: &Path,
    observer: &dyn Observer,
    cancel: &AtomicBool,
) -> Result<PartEnd, NodeError> {
    let all = plan.rows()?;
    if !all.contains(rows) || rows.start > rows.end {
        return Err(NodeError::usage(format!(
            "--rows {}..{} was asked for, and there are {all}",
            rows.start, rows.end
        ))
        .hint(format!("name rows between 0 and {}, the end not included", all.end)));
    }
    let division = divide(plan);
    let identities = key::identities(plan, cache);
    let mut nodes = BTreeMap::new();
    for &id in &division.parted {
        let identity = identities[id].ok_or_else(|| {
            NodeError::files(format!(
                "{}: a file that its result depends on cannot be read",
                plan.tasks[id].label
            ))
        })?;
        nodes.insert(plan.tasks[id].label.clone(), identity);
    }
    let promise = Promise {
        format: FORMAT.into(),
        tool_version: TOOL_VERSION.into(),
        start: rows.start,
        end: rows.end,
        nodes,
    };
    if is_there(folder, &promise)? {
        return Ok(PartEnd::Complete(Vec::new()));
    }
    if !division.before.is_empty() {
        let outcome = crate::run(&plan.only(&division.before), cache, options, observer, cancel);
        if outcome.exit_code() != 0 {
            return Ok(PartEnd::Before(outcome));
        }
    }
    let mut part = Part {
        plan,
        cache,
        options,
        all,
        own: BandStore::open(&folder.join(BANDS))?,
        around: BandStore::open(&folder.join(AROUND))?,
        identities,
        cancel,
    };
    let whole = part.whole(&division)?;
    // No rows: only what must be whole before any.
    let parted: Vec<TaskId> =
        division.parted.iter().copied().filter(|id| !rows.is_empty() && !whole.contains_key(id)).collect();
    let needed = part.needed(&parted, rows);
    let mut made: BTreeMap<TaskId, BTreeMap<String, Value>> = whole;
    for &id in &parted {
        let (task, began) = (&plan.tasks[id], std::time::Instant::now());
        observer.task_started(id, &task.label);
        let outputs = part.make(id, rows, needed[&id], &made)?;
        observer.task_finished(id, End::Executed, began.elapsed().as_secs_f64(), 0);
        made.insert(id, outputs);
    }
    drop(made);
    let gone = std::fs::remove_dir_all(folder.join(AROUND));
    gone.map_err(|error| {
        NodeError::files(photocurrent_core::error::cannot_read(&folder.join(AROUND), &error))
    })?;
    write_promise(folder, &promise)?;
    Ok(PartEnd::Complete(parted.iter().map(|id| plan.tasks[*id].label.clone()).collect()))
}

/// Is the part there, complete and the same? Refuses a folder that holds something else.
fn is_there(folder: &Path, wanted: &Promise) -> Result<bool, NodeError> {
    let other = |what: String| {
        Err(NodeError::files(format!("{}: {what}", folder.display()))
            .hint("name another folder with --part, or remove this one"))
    };
    let names: Vec<String> = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(false),
        Err(error) => return Err(NodeError::files(photocurrent_core::error::cannot_read(folder, &error))),
        Ok(entries) => {
            entries.filter_map(|entry| Some(entry.ok()?.file_name().to_string_lossy().into_owned())).collect()
        }
    };
    if let Some(stranger) = names
        .iter()
        .find(|name| ![PROMISE, BANDS, AROUND].contains(&name.as_str()) && !name.ends_with(".part"))
    {
        return other(format!("it holds `{stranger}`, which is no part of a run"));
    }
    if !names.iter().any(|name| name == PROMISE) {
        return Ok(false);
    }
    let found = read_promise(folder)?;
    if (found.start, found.end) != (wanted.start, wanted.end) {
        return other(format!(
            "it is the part of rows {}..{}, and {}..{} were asked for",
            found.start, found.end, wanted.start, wanted.end
        ));
    }
    match wanted.nodes.iter().find(|(node, identity)| found.nodes.get(*node) != Some(identity)) {
        Some((node, _)) => other(format!(
            "it was made by another pipeline: `{node}` has other parameters, inputs or files there"
        )),
        None => Ok(true),
    }
}

fn read_promise(folder: &Path) -> Result<Promise, NodeError> {
    let path = folder.join(PROMISE);
    let text = std::fs::read_to_string(&path).map_err(|error| {
        NodeError::files(photocurrent_core::error::cannot_read(&path, &error))
            .hint("a part is complete when this file is there: run it again")
    })?;
    let promise: Promise = toml::from_str(&text).map_err(|error| {
        NodeError::input(format!("{}: this is no part of a run: {}", path.display(), error.message()))
    })?;
    if promise.format != FORMAT {
        return Err(NodeError::input(format!(
            "{}: format = \"{}\", expected \"{FORMAT}\"",
            path.display(),
            promise.format
        ))
        .hint("make the part again with this version"));
    }
    Ok(promise)
}

fn write_promise(folder: &Path, promise: &Promise) -> Result<(), NodeError> {
    let (path, failed) = (folder.join(PROMISE), |path: &Path, error: &std::io::Error| {
        NodeError::files(format!("{}: cannot write: {error}", path.display()))
    });
    let text = toml::to_string(promise).map_err(|error| NodeError::failed(error.to_string()))?;
    let temporary = folder.join(format!("{PROMISE}.{}.part", std::process::id()));
    std::fs::write(&temporary, text)
        .and_then(|()| std::fs::File::open(&temporary)?.sync_all())
        .map_err(|error| failed(&temporary, &error))?;
    std::fs::rename(&temporary, &path).map_err(|error| failed(&path, &error))
}

struct Part<'a> {
    plan: &'a Plan,
    cache: &'a Cache,
    options: &'a Options,
    all: Rows,
    /// The part's bands.
    own: BandStore,
    /// Bands of rows around it.
    around: BandStore,
    identities: Vec<Option<Digest>>,
    cancel: &'a AtomicBool,
}

impl Part<'_> {
    /// Outputs of the tasks that the cache has whole.
    fn whole(&self, division: &Division) -> Result<BTreeMap<TaskId, BTreeMap<String, Value>>, NodeError> {
        let mut contents: BTreeMap<(TaskId, String), Digest> = BTreeMap::new();
        let mut whole = BTreeMap::new();
        for id in 0..self.plan.tasks.len() {
            if !division.before.contains(&id) && !division.parted.contains(&id) {
                continue;
            }
            let task = &self.plan.tasks[id];
            let content = |from: TaskId, port: &str| contents.get(&(from, port.to_string())).copied();
            let Some(ingredients) = key::ingredients(task, self.cache, &content)? else { continue };
            let Lookup::Found(record) = self.cache.record(&ingredients.key()) else { continue };
            let stored: Option<Vec<(&str, Digest)>> = task
                .stored()
                .map(|output| Some((output.port, record.outputs.get(output.port).copied().flatten()?.digest)))
                .collect();
            let mut outputs = BTreeMap::new();
            for (port, digest) in stored.into_iter().flatten() {
                contents.insert((id, port.into()), digest);
                outputs.insert(port.to_string(), self.cache.load(&digest)?);
            }
            if outputs.len() == task.stored().count() {
                whole.insert(id, outputs);
            }
        }
        Ok(whole)
    }

    /// The rows of each task that `rows` of all need.
    fn needed(&self, parted: &[TaskId], rows: Rows) -> BTreeMap<TaskId, Rows> {
        let mut needed: BTreeMap<TaskId, Rows> = parted.iter().map(|id| (*id, rows)).collect();
        for id in parted.iter().rev().filter(|_| !rows.is_empty()) {
            let reach = needed[id].with_halo(halo_of(&self.plan.tasks[*id], self.all).unwrap_or(0), self.all);
            for need in self.plan.tasks[*id].needs() {
                if let Some(of_need) = needed.get_mut(&need) {
                    *of_need =
                        Rows { start: of_need.start.min(reach.start), end: of_need.end.max(reach.end) };
                }
            }
        }
        needed
    }

    /// The values that a task takes, out of those that were made.
    fn inputs(
        &self,
        task: &Task,
        made: &BTreeMap<TaskId, BTreeMap<String, Value>>,
    ) -> Result<PortValues, NodeError> {
        let mut inputs = PortValues::new();
        for input in &task.inputs {
            let values = extracted(&input.from, |from, port| {
                let value = made.get(&from).and_then(|outputs| outputs.get(port)).cloned();
                value.ok_or_else(|| {
                    NodeError::failed(format!("{} has no stored `{port}`", self.plan.tasks[from].label))
                })
            })?;
            inputs.insert(input.port, values);
        }
        Ok(inputs)
    }

    /// Makes the needed rows of a task: its own and those around, in bands that end where its own do.
    fn make(
        &mut self,
        id: TaskId,
        own: Rows,
        needed: Rows,
        made: &BTreeMap<TaskId, BTreeMap<String, Value>>,
    ) -> Result<BTreeMap<String, Value>, NodeError> {
        let task = &self.plan.tasks[id];
        let identity = self.identities[id]
            .ok_or_else(|| NodeError::failed("a task that is made in parts has an identity"))?;
        let inputs = self.inputs(task, made)?;
        let share = self.options.memory / 4 * 3;
        let bands = cut(self.plan, task, share, self.options.threads, self.options.band_rows);
        let metas: Vec<&Meta> = task.stored().map(|output| &output.meta).collect();
        let wanted = wanted(task);
        let mut parts: BTreeMap<String, Vec<Value>> = BTreeMap::new();
        let common = Common::default();
        let pieces =
            [Rows { start: needed.start, end: own.start }, own, Rows { start: own.end, end: needed.end }];
        for piece in pieces.into_iter().filter(|piece| !piece.is_empty()) {
            let store = if piece == own { &self.own } else { &self.around };
            let there: Vec<KeptBand> =
                store.list()?.into_iter().filter(|band| band.identity == identity).collect();
            let mut cutter = Cutter::new(&bands, piece, &metas, &inputs);
            while let Some(row) = cutter.at() {
                let starts_here = there.iter().filter(|band| band.start == row && band.end <= piece.end);
                let (band, outputs) = match starts_here
                    .max_by_key(|band| band.end)
                    .and_then(|band| Some((band.rows(), load(store, band, task).ok()?)))
                {
                    Some(found) => {
                        cutter.skip_to(found.0.end);
                        found
                    }
                    None => {
                        if self.cancel.load(Ordering::Relaxed) {
                            return Err(NodeError::interrupted());
                        }
                        let Some(band) = cutter.next(u32::MAX) else { break };
                        let notes = Notes::default();
                        let context = Context::new(
                            band,
                            task.seed.unwrap_or(0),
                            &wanted,
                            &Silent,
                            self.cancel,
                            None,
                            &notes,
                        )
                        .sharing(&common);
                        let given = guarded(|| task.node.run(inputs_of(&inputs, &bands, band), &context))?;
                        let outputs: Vec<(&'static str, Value)> = checked(task, given, Some(band))?
                            .into_iter()
                            .map(|(port, _, value)| (port, value))
                            .collect();
                        cutter.learn(band, outputs.iter().map(|(_, value)| value.bytes(band)).sum());
                        let kept = guarded(|| Ok(store.put(identity, band, &outputs, notes.content())?))?;
                        drop(outputs);
                        (band, load(store, &kept, task)?)
                    }
                };
                debug_assert_eq!(cutter.at().unwrap_or(piece.end), band.end);
                outputs.into_iter().for_each(|(port, value)| parts.entry(port).or_default().push(value));
            }
        }
        Ok(parts.into_iter().map(|(port, values)| (port, Value::splice(values))).collect())
    }
}

fn load(store: &BandStore, band: &KeptBand, task: &Task) -> Result<Vec<(String, Value)>, NodeError> {
    task.stored()
        .map(|output| Ok((output.port.to_string(), store.load(band, output.port, &output.meta)?)))
        .collect()
}

/// The folders of bands in some parts of a plan, for [`Options::parts`].
///
/// # Errors
/// When a part is not complete, is of another pipeline, or rows are missing; with what to do.
pub fn join(plan: &Plan, cache: &Cache, parts: &[PathBuf]) -> Result<Vec<PathBuf>, NodeError> {
    let all = plan.rows()?;
    let identities = key::identities(plan, cache);
    // In running order: what differs first is the reason for all that differs after it.
    let known: Vec<(&str, Digest)> = divide(plan)
        .parted
        .into_iter()
        .filter_map(|id| Some((plan.tasks[id].label.as_str(), identities[id]?)))
        .collect();
    let mut covered = Vec::new();
    for folder in parts {
        let promise = read_promise(folder)?;
        for (node, identity) in &known {
            if promise.nodes.get(*node) != Some(identity) {
                return Err(NodeError::input(format!(
                    "{}: it is a part of another pipeline: `{node}` has other parameters, inputs or files \
                     there",
                    folder.display()
                ))
                .hint("merge with the manifest, --set, --variant and --to that made the parts"));
            }
        }
        covered.push(Rows { start: promise.start, end: promise.end });
    }
    covered.sort_by_key(|rows| (rows.start, rows.end));
    let mut next = all.start;
    for rows in covered.iter().chain([&Rows { start: all.end, end: all.end }]) {
        if rows.start > next {
            return Err(NodeError::input(format!("no part has rows {next}..{}", rows.start)).hint(format!(
                "make it: photocurrent run MANIFEST --rows {next}..{} --part FOLDER",
                rows.start
            )));
        }
        next = next.max(rows.end);
    }
    Ok(parts.iter().map(|folder| folder.join(BANDS)).collect())
}
