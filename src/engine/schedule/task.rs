//! One task: looked up, and when the cache does not have it, run band by band, stored, and recorded last.

use super::bands::{self, Bands, Cutter, same_meta};
use super::kept::Found;
use super::shared::{Keep, Shared};
use super::writer::{Message, Stored, guarded};
use crate::blocks::extracted;
use crate::budget::size;
use crate::export::{Staging, StampedFile};
use crate::key::{self, Reuse};
use crate::observer::{End, Observer};
use crate::task::{Task, TaskId};
use crossbeam::channel::{Receiver, Sender, bounded};
use photocurrent_core::context::{Common, Notes, Progress};
use photocurrent_core::error::Trouble;
use photocurrent_core::ports::PortValues;
use photocurrent_core::{Context, Digest, Meta, NodeError, Rows, Value};
use photocurrent_store::{Cache, Export, Ingredients, Lookup, Record, StoredOutput, TOOL_VERSION};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// Computes a task's key and looks it up: ends it as reused, or lets it wait for memory.
pub(super) fn look_up(shared: &Shared<'_>, id: TaskId) {
    let task = &shared.plan.tasks[id];
    let contents: BTreeMap<(TaskId, &str), Digest> = {
        let state = shared.state();
        let sources = task.inputs.iter().flat_map(|input| &input.from);
        sources
            .filter_map(|source| {
                Some(((source.task, source.port), state.slots[source.task].outputs.get(source.port)?.digest))
            })
            .collect()
    };
    let ingredients = guarded(|| {
        let found = key::ingredients(task, shared.cache, &|from, port| contents.get(&(from, port)).copied())?;
        found.ok_or_else(|| {
            NodeError::failed("an input has no stored content: the plan marks as wanted what others take")
        })
    });
    let ingredients = match ingredients {
        Ok(ingredients) => ingredients,
        Err(error) => return end_with_error(shared, id, error, 0.0),
    };
    let key = ingredients.key();
    let force = shared.state().slots[id].force;
    let reuse = if force {
        Reuse::Nothing { damage: None }
    } else {
        key::look_up(task, &key, shared.cache, &shared.options.out_dir)
    };
    if let Reuse::Nothing { damage: Some(why) } = &reuse {
        shared.warn(format!("{}: the cache's record is damaged and is made again: {why}", task.label));
    }
    if let Reuse::Hit(record) = reuse {
        remember(shared, task, &key);
        let mut state = shared.state();
        let slot = &mut state.slots[id];
        slot.key = Some(key);
        slot.notes = record.notes.clone();
        slot.seconds = record.seconds;
        slot.outputs =
            record.outputs.into_iter().filter_map(|(port, output)| Some((port, output?))).collect();
        let ended = state.finish(shared.plan, id, End::Reused);
        drop(state);
        return shared.announce(ended);
    }
    // Three quarters of the budget are for running tasks, the rest for results that are kept for those that
    // take them. Nodes use all threads inside themselves, so two at a time keep them busy.
    let share = shared.options.memory / 4 * 3 / shared.options.threads.clamp(1, 2) as u64;
    let bands = bands::cut(shared.plan, task, share, shared.options.threads, shared.options.band_rows);
    shared.state().admit(id, key, ingredients, bands);
    shared.changed.notify_all();
}

/// The cache's history is for explanations: a run does not stop when it cannot be written.
fn remember(shared: &Shared<'_>, task: &Task, key: &Digest) {
    let manifest = shared.plan.manifest_id.to_string();
    for (variant, node) in &task.uses {
        if let Err(error) = shared.cache.remember(&manifest, variant, node, key) {
            shared.warn(format!("{}: the cache's history could not be written: {error}", task.label));
            return;
        }
    }
}

pub(super) fn end_with_error(shared: &Shared<'_>, id: TaskId, error: NodeError, seconds: f64) {
    let end = if error.trouble == Trouble::Interrupted { End::Interrupted } else { End::Failed };
    let mut state = shared.state();
    state.slots[id].seconds = seconds;
    state.slots[id].error = (end == End::Failed).then_some(error);
    let ended = state.finish(shared.plan, id, end);
    drop(state);
    shared.announce(ended);
}

/// What running a task gave.
struct Product {
    stored: Stored,
    notes: Vec<String>,
    /// The values, when the task ran in one band.
    values: BTreeMap<&'static str, Value>,
}

/// Why a task did not come to its end.
enum Stopped {
    /// It failed.
    Error(NodeError),
    /// A stored input cannot be read: this task waits until `producer` has made it again.
    SentBack,
}

impl From<NodeError> for Stopped {
    fn from(error: NodeError) -> Stopped {
        Stopped::Error(error)
    }
}

/// Runs a task whose memory was granted.
pub(super) fn run(shared: &Shared<'_>, id: TaskId, writer: &Sender<Message>) {
    let task = &shared.plan.tasks[id];
    let begun = Instant::now();
    let product = inputs(shared, id).and_then(|inputs| {
        shared.observer.task_started(id, &task.label);
        Ok(produce(shared, id, inputs, writer, begun)?)
    });
    shared.state().release(id);
    give_back();
    let seconds = begun.elapsed().as_secs_f64();
    match product {
        Ok(product) => {
            let mut state = shared.state();
            let room = (shared.options.memory / 4).saturating_sub(state.retained);
            let bytes = product
                .values
                .values()
                .map(|value| value.bytes(value.rows().unwrap_or(Rows { start: 0, end: 0 })))
                .sum();
            let slot = &mut state.slots[id];
            (slot.outputs, slot.notes, slot.seconds) = (product.stored, product.notes, seconds);
            if bytes <= room {
                (slot.values, slot.retained) = (product.values, bytes);
                state.retained += bytes;
            }
            let ended = state.finish(shared.plan, id, End::Executed);
            drop(state);
            shared.announce(ended);
        }
        Err(Stopped::Error(error)) => {
            // The writer is gone only when the whole run is being torn down.
            let _ = writer.send(Message::Abandon { task: id });
            end_with_error(shared, id, error, seconds);
        }
        Err(Stopped::SentBack) => shared.changed.notify_all(),
    }
}

/// The values that a task takes: those still in memory, others opened in the store.
fn inputs(shared: &Shared<'_>, id: TaskId) -> Result<PortValues, Stopped> {
    let task = &shared.plan.tasks[id];
    let mut values = PortValues::new();
    for input in &task.inputs {
        values.insert(input.port, extracted(&input.from, |from, port| value(shared, id, from, port))?);
    }
    Ok(values)
}

fn value(shared: &Shared<'_>, consumer: TaskId, from: TaskId, port: &'static str) -> Result<Value, Stopped> {
    let digest = {
        let state = shared.state();
        let slot = &state.slots[from];
        if let Some(value) = slot.values.get(port) {
            return Ok(value.clone());
        }
        slot.outputs.get(port).map(|output| output.digest)
    };
    let digest = digest.ok_or_else(|| {
        NodeError::failed(format!("{} has no stored `{port}`", shared.plan.tasks[from].label))
    })?;
    let error = match guarded(|| Ok(shared.cache.load(&digest))) {
        Ok(Ok(value)) => {
            shared.state().slots[from].values.insert(port, value.clone());
            return Ok(value);
        }
        Ok(Err(error)) => error,
        Err(panic) => return Err(Stopped::Error(panic)),
    };
    if error.is_damage() && shared.state().send_back(from, consumer) {
        shared.warn(format!("{}: output {port} is made again: {error}", shared.plan.tasks[from].label));
        return Err(Stopped::SentBack);
    }
    Err(Stopped::Error(error.into()))
}

fn produce(
    shared: &Shared<'_>,
    id: TaskId,
    inputs: PortValues,
    writer: &Sender<Message>,
    begun: Instant,
) -> Result<Product, NodeError> {
    let task = &shared.plan.tasks[id];
    let (ingredients, bands) = {
        let state = shared.state();
        let slot = &state.slots[id];
        (
            slot.ingredients.clone().expect("an admitted task has ingredients"),
            slot.bands.clone().expect("an admitted task has bands"),
        )
    };
    let key = ingredients.key();
    let staging = task
        .export
        .as_ref()
        .map(|folder| Staging::create(&shared.options.out_dir.join(folder)))
        .transpose()?;
    let mut production = Production::new(shared, id, writer, &bands, &inputs);
    while production.reuse_band()? || production.produce_band(staging.as_ref().map(Staging::path))? {}
    let Production { notes, values, is_kept, .. } = production;
    let (reply, answer) = bounded(1);
    send(writer, Message::Finish { task: id, reply })?;
    let stored = answer.recv().map_err(|_| writer_stopped())??;
    let exports = staging.map(|staging| staging.publish(key)).transpose()?.unwrap_or_default();
    let notes = notes.lines();
    shared.cache.commit(&record(
        shared.cache,
        ingredients,
        &stored,
        exports,
        &notes,
        begun.elapsed().as_secs_f64(),
    ))?;
    remember(shared, task, &key);
    if is_kept && let Some((store, identity)) = shared.kept.own(id) {
        // What stays is found again at worst, and removed by gc.
        let _ = store.remove(&identity);
    }
    Ok(Product { stored, notes, values })
}

fn send(writer: &Sender<Message>, message: Message) -> Result<(), NodeError> {
    writer.send(message).map_err(|_| writer_stopped())
}

fn writer_stopped() -> NodeError {
    NodeError::failed("the writer has stopped")
}

/// A task while its bands are produced.
struct Production<'a> {
    shared: &'a Shared<'a>,
    id: TaskId,
    task: &'a Task,
    writer: &'a Sender<Message>,
    bands: &'a Bands,
    inputs: &'a PortValues,
    cutter: Cutter<'a>,
    /// Bands that are there already.
    kept_bands: Vec<Found>,
    progress: TaskProgress<'a>,
    notes: Notes,
    common: Common,
    /// The values, when the task runs in one band.
    values: BTreeMap<&'static str, Value>,
    /// Rings when the writer has written the band before.
    written: Option<Receiver<()>>,
    /// Are bands of it kept?
    is_kept: bool,
    /// Was it warned that a row takes too much memory?
    is_warned: bool,
}

impl<'a> Production<'a> {
    fn new(
        shared: &'a Shared<'a>,
        id: TaskId,
        writer: &'a Sender<Message>,
        bands: &'a Bands,
        inputs: &'a PortValues,
    ) -> Production<'a> {
        let task = &shared.plan.tasks[id];
        let stored: Vec<&Meta> = task.stored().map(|output| &output.meta).collect();
        let may_reuse = bands.halo.is_some() && !shared.state().slots[id].force;
        Production {
            shared,
            id,
            task,
            writer,
            bands,
            inputs,
            cutter: Cutter::new(bands, bands.rows, &stored, inputs),
            kept_bands: if may_reuse { shared.kept.of(id) } else { Vec::new() },
            progress: TaskProgress { observer: shared.observer, task: id, of_band: None },
            notes: Notes::default(),
            common: Common::default(),
            values: BTreeMap::new(),
            written: None,
            is_kept: false,
            is_warned: false,
        }
    }

    /// Takes the next rows from a band that is there already; false when there is none.
    fn reuse_band(&mut self) -> Result<bool, NodeError> {
        let load = |row| self.kept_bands.iter().find_map(|band| self.shared.kept.load(band, row, self.task));
        let Some((rows, outputs, said)) = self.cutter.at().and_then(load) else { return Ok(false) };
        self.notes.absorb(said);
        for (port, value) in outputs {
            let message = Message::Write { task: self.id, port, meta: value.meta(), value };
            send(self.writer, message)?;
        }
        self.cutter.skip_to(rows.end);
        self.is_kept = true;
        Ok(true)
    }

    /// Computes the next band and sends it to the writer; false when there is none left.
    fn produce_band(&mut self, export: Option<&Path>) -> Result<bool, NodeError> {
        let next_kept = self
            .kept_bands
            .iter()
            .map(|band| band.rows().start)
            .filter(|start| Some(*start) > self.cutter.at())
            .min();
        let Some(band) = self.cutter.next(next_kept.unwrap_or(u32::MAX)) else { return Ok(false) };
        let whole = band == self.bands.rows;
        if !whole {
            self.begin_progress(band);
        }
        if self.shared.cancel.load(Ordering::Relaxed) {
            return Err(NodeError::interrupted());
        }
        let of_band = Notes::default();
        let began = Instant::now();
        let computed = self.compute(band, export, &of_band)?;
        // One band of a task waits for the writer while the next is computed, and no more.
        if let Some(written) = self.written.take() {
            written.recv().map_err(|_| writer_stopped())?;
        }
        let seconds = began.elapsed().as_secs_f64();
        self.notes.absorb(of_band.content());
        let (mut bytes, mut outputs) = (0, Vec::new());
        for (port, meta, value) in checked(self.task, computed, (!whole).then_some(band))? {
            bytes += value.bytes(band);
            if whole {
                self.values.insert(port, value.clone());
            }
            outputs.push((port, value.clone()));
            send(self.writer, Message::Write { task: self.id, port, meta, value })?;
        }
        self.cutter.learn(band, bytes);
        self.warn_of_memory();
        if !whole
            && let Some((store, identity)) = self.shared.kept.own(self.id)
            && (self.shared.options.keep == Keep::All || seconds * COSTLY_BYTES_PER_S > bytes as f64)
        {
            let message = Message::Keep { store, identity, rows: band, outputs, said: of_band.content() };
            send(self.writer, message)?;
            self.is_kept = true;
        }
        let (reply, answer) = bounded(1);
        send(self.writer, Message::Reached { reply })?;
        self.written = Some(answer);
        self.progress.end_of_band();
        if seconds > WORTH_GIVING_BACK_S {
            give_back();
        }
        Ok(true)
    }

    /// Counts rows from the first band on that is not the whole.
    fn begin_progress(&mut self, band: Rows) {
        if self.progress.of_band.is_none() {
            // What is there already carries no information of how fast the rest goes.
            let there: u64 = self.kept_bands.iter().map(|band| band.rows().len() as u64).sum();
            let left = (self.bands.rows.len() as u64).saturating_sub(there).max(1);
            self.shared.observer.progress_begin(self.id, left, "rows");
        }
        self.progress.of_band = Some(OfBand { rows: band.len() as u64, ..OfBand::default() });
    }

    /// Runs the node for a band.
    fn compute(&self, band: Rows, export: Option<&Path>, notes: &Notes) -> Result<PortValues, NodeError> {
        let wanted = wanted(self.task);
        let seed = self.task.seed.unwrap_or(0);
        let context = Context::new(band, seed, &wanted, &self.progress, self.shared.cancel, export, notes)
            .sharing(&self.common);
        guarded(|| self.task.node.run(bands::inputs_of(self.inputs, self.bands, band), &context))
    }

    /// Warns once where a single row takes more memory than its share.
    fn warn_of_memory(&mut self) {
        if self.task.local_in_time
            && !self.is_warned
            && let Some((needed, share)) = self.cutter.too_much()
        {
            self.is_warned = true;
            self.shared.warn(format!(
                "{}: a single row takes about {}, and its share of --memory is {}: blocks of time take less \
                 (`pipeline.blocks`)",
                self.task.label,
                size(needed),
                size(share)
            ));
        }
    }
}

/// The ports of a task whose outputs something wants.
pub(crate) fn wanted(task: &Task) -> BTreeSet<String> {
    let wanted = task.outputs.iter().filter(|output| output.wanted);
    wanted.map(|output| output.port.to_string()).collect()
}

fn record(
    cache: &Cache,
    ingredients: Ingredients,
    stored: &Stored,
    exports: Vec<StampedFile>,
    notes: &[String],
    seconds: f64,
) -> Record {
    let key = ingredients.key();
    let mut outputs: BTreeMap<String, Option<StoredOutput>> =
        stored.iter().map(|(port, output)| (port.clone(), Some(*output))).collect();
    // Another pipeline may have wanted other outputs of the same key: what it stored stays named.
    if let Lookup::Found(old) = cache.record(&key) {
        for (port, output) in old.outputs {
            outputs.entry(port).or_insert(output);
        }
    }
    let exports = exports
        .into_iter()
        .map(|file| Export { name: file.name, bytes: file.bytes, digest: file.digest })
        .collect();
    let created_unix_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    Record {
        key,
        tool_version: TOOL_VERSION.into(),
        seconds,
        created_unix_s,
        notes: notes.to_vec(),
        ingredients,
        outputs,
        exports,
    }
}

/// A band that gives fewer bytes a second is kept until the result is complete: writing it is quicker than
/// computing it.
const COSTLY_BYTES_PER_S: f64 = 32e6;

/// After a band that took so long, memory that it freed goes back to the system.
const WORTH_GIVING_BACK_S: f64 = 0.5;

/// Gives memory that is free back to the system: the allocator keeps what a thread freed for that thread, and
/// bands and blocks of other sizes leave ever more of it.
fn give_back() {
    // SAFETY: the call takes a number of bytes to keep, and touches only memory that nobody has.
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    unsafe {
        libc::malloc_trim(0);
    }
}

/// A score that the node's kind does not name: no manifest could set a bound on it.
fn unnamed_metric(task: &Task, value: &Value) -> Option<String> {
    let Value::Table(table) = value else { return None };
    let scores = table.as_scores()?;
    scores.into_iter().map(|score| score.metric).find(|metric| !task.metrics.contains(metric))
}

/// The wanted outputs, held against the plan: a node that gives something else than it planned would poison
/// every key after it.
pub(crate) fn checked(
    task: &Task,
    mut given: PortValues,
    band: Option<Rows>,
) -> Result<Vec<(&'static str, Meta, Value)>, NodeError> {
    let broken = |text: String| {
        NodeError::failed(format!("{} broke its promise: {text}", task.decl.kind))
            .hint("this is a mistake in the node; please report it")
    };
    let mut outputs = Vec::new();
    for output in &task.outputs {
        let values = given.remove(output.port).unwrap_or_default();
        let absent = matches!(output.meta, Meta::Absent { .. });
        let value = match values.into_iter().next() {
            Some(_) if absent => {
                return Err(broken(format!(
                    "its plan said that there is no `{}`, and there is one",
                    output.port
                )));
            }
            None if output.wanted && !absent => {
                return Err(broken(format!(
                    "its plan said that there is `{}`, and there is none",
                    output.port
                )));
            }
            Some(value) if output.wanted => value,
            _ => continue,
        };
        let meta = value.meta();
        if !same_meta(&output.meta, &meta) {
            return Err(broken(format!("`{}` is not as planned", output.port))
                .note(format!("planned {:?}", output.meta))
                .note(format!("found   {meta:?}")));
        }
        if let Some(metric) = unnamed_metric(task, &value) {
            return Err(broken(format!("`{metric}` is not among its metrics")));
        }
        let value = match (band, value.rows()) {
            (Some(band), Some(rows)) if !rows.contains(band) => {
                return Err(broken(format!("`{}` has {rows} where {band} were asked for", output.port)));
            }
            (Some(band), Some(_)) => value.cut(band),
            _ => value,
        };
        outputs.push((output.port, meta, value));
    }
    Ok(outputs)
}

/// Passes a node's progress on; a task in bands counts its rows, and within a band what the node has done of
/// it.
struct TaskProgress<'a> {
    observer: &'a dyn Observer,
    task: TaskId,
    of_band: Option<OfBand>,
}

/// How far a node is with a band.
#[derive(Default)]
struct OfBand {
    rows: u64,
    /// Items that the node has to do in it, and has done.
    items: AtomicU64,
    done: AtomicU64,
    /// Rows that were reported to be done.
    reported: AtomicU64,
}

impl TaskProgress<'_> {
    fn end_of_band(&self) {
        self.report(u64::MAX);
    }

    /// So many rows of the band are done, all of them at most.
    fn report(&self, rows: u64) {
        let Some(band) = &self.of_band else { return };
        let rows = rows.min(band.rows);
        let reported = band.reported.fetch_max(rows, Ordering::Relaxed);
        if rows > reported {
            self.observer.progress_advance(self.task, rows - reported);
        }
    }
}

impl Progress for TaskProgress<'_> {
    fn begin(&self, total: u64, unit: &str) {
        match &self.of_band {
            Some(band) => {
                band.items.fetch_add(total, Ordering::Relaxed);
            }
            None => self.observer.progress_begin(self.task, total, unit),
        }
    }

    fn advance(&self, items: u64) {
        match &self.of_band {
            Some(band) => {
                let done = band.done.fetch_add(items, Ordering::Relaxed) + items;
                self.report((band.rows * done).checked_div(band.items.load(Ordering::Relaxed)).unwrap_or(0));
            }
            None => self.observer.progress_advance(self.task, items),
        }
    }
}
