//! What a node may ask while it runs: its rows, its seed, whether to stop, where to write files.
//!
//! There is no clock, no environment and no thread-local randomness here, because a node's output is a
//! function of its inputs, parameters, declared files and seed.

use crate::error::NodeError;
use crate::extent::Rows;
use std::any::Any;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Hears how far a node is.
pub trait Progress: Send + Sync {
    /// There are `total` items to do, named by `unit`: "rows", "frames".
    fn begin(&self, total: u64, unit: &str);
    /// `items` more are done.
    fn advance(&self, items: u64);
}

/// Hears nothing.
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _: u64, _: &str) {}
    fn advance(&self, _: u64) {}
}

/// How a note begins that says that data were damaged and left out: a run that has one ends with exit code 3.
pub const LOSS: &str = "data lost: ";

/// What a node reported while it ran, whatever the number of row bands and threads.
#[derive(Default)]
pub struct Notes(Mutex<NoteBook>);

#[derive(Default)]
struct NoteBook {
    texts: BTreeSet<String>,
    counts: BTreeMap<String, u64>,
}

impl Notes {
    fn book(&self) -> MutexGuard<'_, NoteBook> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn say(&self, text: String) {
        self.book().texts.insert(text);
    }

    fn count(&self, n: u64, what: &str) {
        *self.book().counts.entry(what.into()).or_default() += n;
    }

    /// What was said: texts, and counts by what was counted.
    pub fn content(&self) -> (Vec<String>, BTreeMap<String, u64>) {
        let book = self.book();
        (book.texts.iter().cloned().collect(), book.counts.clone())
    }

    /// Adds what was said elsewhere, for other rows.
    pub fn absorb(&self, (texts, counts): (Vec<String>, BTreeMap<String, u64>)) {
        texts.into_iter().for_each(|text| self.say(text));
        counts.iter().for_each(|(what, n)| self.count(*n, what));
    }

    /// Texts, then counts, each in alphabetical order.
    pub fn lines(&self) -> Vec<String> {
        let book = self.book();
        let counts = book.counts.iter().filter(|(_, n)| **n > 0).map(|(what, n)| format!("{n} {what}"));
        book.texts.iter().cloned().chain(counts).collect()
    }
}

/// What the row bands of one task share: work that does not depend on the band, by a number of the node's own
/// choice.
#[derive(Default)]
pub struct Common(Mutex<BTreeMap<u64, Arc<dyn Any + Send + Sync>>>);

/// What a node may ask while it runs.
pub struct Context<'a> {
    rows: Rows,
    seed: u64,
    wanted: &'a BTreeSet<String>,
    progress: &'a dyn Progress,
    cancel: &'a AtomicBool,
    export: Option<&'a Path>,
    notes: &'a Notes,
    common: Option<&'a Common>,
}

impl<'a> Context<'a> {
    /// Made by the scheduler, and by tests.
    pub fn new(
        rows: Rows,
        seed: u64,
        wanted: &'a BTreeSet<String>,
        progress: &'a dyn Progress,
        cancel: &'a AtomicBool,
        export: Option<&'a Path>,
        notes: &'a Notes,
    ) -> Context<'a> {
        Context { rows, seed, wanted, progress, cancel, export, notes, common: None }
    }

    /// The same for one of several bands of a task.
    #[must_use]
    pub fn sharing(self, common: &'a Common) -> Context<'a> {
        Context { common: Some(common), ..self }
    }

    /// Keeps what other bands of the task need as well, and would work out to the same.
    pub fn keep<T: Send + Sync + 'static>(&self, number: u64, value: T) {
        if let Some(Common(all)) = self.common {
            all.lock().unwrap_or_else(PoisonError::into_inner).insert(number, Arc::new(value));
        }
    }

    /// What a band of the task kept under this number, if one did.
    pub fn recall<T: Send + Sync + 'static>(&self, number: u64) -> Option<Arc<T>> {
        let Common(all) = self.common?;
        all.lock().unwrap_or_else(PoisonError::into_inner).get(&number).cloned()?.downcast().ok()
    }

    /// The rows to produce. A node whose grain is `Whole` gets all rows of its first output.
    pub fn rows(&self) -> Rows {
        self.rows
    }

    /// The seed of the pipeline, for nodes that draw ([`crate::random::Random`]).
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Does anybody want this output? An output that nobody wants may be left out (or cheap).
    pub fn wants(&self, port: &str) -> bool {
        self.wanted.contains(port)
    }

    /// Says how much there is to do.
    pub fn begin(&self, total: u64, unit: &str) {
        self.progress.begin(total, unit);
    }

    /// Says that `items` more are done; call it often, it is cheap and safe from many threads.
    ///
    /// # Errors
    /// When the user interrupted the run: pass the error on.
    pub fn advance(&self, items: u64) -> Result<(), NodeError> {
        self.progress.advance(items);
        if self.cancel.load(Ordering::Relaxed) { Err(NodeError::interrupted()) } else { Ok(()) }
    }

    /// An empty folder for the files of a node that exports; the engine moves it to its place when the node
    /// is done.
    ///
    /// # Errors
    /// When the node did not declare that it exports.
    pub fn export_dir(&self) -> Result<&Path, NodeError> {
        self.export.ok_or_else(|| NodeError::failed("this node writes files but does not declare `exports`"))
    }

    /// Reports something that is no error: "row_time of the recording wins over the description's". Kept with
    /// the result, shown again on a cache hit. The same text said for several row bands counts once.
    pub fn note(&self, text: impl Into<String>) {
        self.notes.say(text.into());
    }

    /// Reports a damaged part of the input that was left out; what stands around it was taken. The run goes
    /// on and ends with exit code 3.
    pub fn loss(&self, text: impl AsRef<str>) {
        self.notes.say(format!("{LOSS}{}", text.as_ref()));
    }

    /// Reports how many of something there were: `count(31, "pixels did not converge")`. Counts of one text
    /// add up over threads and row bands, so the sum does not depend on either; a zero is not shown.
    pub fn count(&self, n: u64, what: &str) {
        self.notes.count(n, what);
    }
}
