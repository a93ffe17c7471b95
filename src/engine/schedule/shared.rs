//! How a plan is run, and what the workers of a run share.

use super::kept::Kept;
use super::state::State;
use crate::budget::default_memory;
use crate::observer::{End, Observer};
use crate::plan::Plan;
use crate::task::TaskId;
use photocurrent_store::Cache;
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// How to run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Tasks at the same time.
    pub threads: usize,
    /// Bytes that inputs, outputs and kept results may take together, about.
    pub memory: u64,
    /// Height of every row band; chosen from the budget when not given.
    pub band_rows: Option<u32>,
    /// Folder for exported files.
    pub out_dir: PathBuf,
    /// Nodes to run even when the cache has their results.
    pub force: BTreeSet<String>,
    /// Which bands are kept until their result is complete, so that a run that was stopped goes on from them.
    pub keep: Keep,
    /// Folders with bands that were made elsewhere ([`crate::run_part`]).
    pub parts: Vec<PathBuf>,
}

/// Which bands are kept until their result is complete.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Keep {
    /// Those that took longer to compute than to write.
    #[default]
    Costly,
    /// All of a result that is cut.
    All,
}

impl Default for Options {
    fn default() -> Options {
        Options {
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            memory: default_memory(),
            band_rows: None,
            out_dir: PathBuf::from("out"),
            force: BTreeSet::new(),
            keep: Keep::default(),
            parts: Vec::new(),
        }
    }
}

/// What the workers share.
pub(crate) struct Shared<'a> {
    pub(super) plan: &'a Plan,
    pub(super) cache: &'a Cache,
    pub(super) options: &'a Options,
    pub(super) observer: &'a dyn Observer,
    pub(super) cancel: &'a AtomicBool,
    /// Bands that are there already.
    pub(super) kept: Kept,
    pub(super) state: Mutex<State>,
    /// Rung whenever something changes that may let a worker go on.
    pub(super) changed: Condvar,
}

impl Shared<'_> {
    pub(super) fn state(&self) -> MutexGuard<'_, State> {
        // A worker that panics while it holds the lock breaks the whole run anyway, through the scope.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn warn(&self, text: String) {
        self.observer.warning(&text);
        self.state().warnings.push(text);
    }

    /// Reports the end of a task and of what it takes with it.
    pub(super) fn announce(&self, ended: Vec<(TaskId, End)>) {
        for (task, end) in ended {
            let (seconds, bytes) = {
                let state = self.state();
                let slot = &state.slots[task];
                (slot.seconds, slot.outputs.values().map(|output| output.bytes).sum())
            };
            self.observer.task_finished(task, end, seconds, bytes);
        }
        self.changed.notify_all();
    }
}
