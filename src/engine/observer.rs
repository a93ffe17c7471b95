//! Who watches a run: the command draws bars or writes JSON Lines from these calls.
//!
//! The calls come from several threads at once, each for its own task; a task's calls are in order.

use crate::task::TaskId;
use serde::{Deserialize, Serialize};

/// How a task ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum End {
    /// It ran.
    Executed,
    /// The cache had it.
    Reused,
    /// It stopped with an error.
    Failed,
    /// Something before it failed.
    Skipped,
    /// The user interrupted the run.
    Interrupted,
}

impl End {
    /// In a word.
    pub fn name(self) -> &'static str {
        match self {
            End::Executed => "executed",
            End::Reused => "reused",
            End::Failed => "failed",
            End::Skipped => "skipped",
            End::Interrupted => "interrupted",
        }
    }

    /// Is there a result?
    pub fn is_well(self) -> bool {
        matches!(self, End::Executed | End::Reused)
    }
}

/// Watches a run. Every method does nothing unless it is written.
pub trait Observer: Sync {
    /// So many tasks there are.
    fn planned(&self, _tasks: usize) {}
    /// A task begins to run; what the cache has does not begin.
    fn task_started(&self, _task: TaskId, _label: &str) {}
    /// It has `total` items to do.
    fn progress_begin(&self, _task: TaskId, _total: u64, _unit: &str) {}
    /// So many more are done.
    fn progress_advance(&self, _task: TaskId, _items: u64) {}
    /// A task ended; `seconds` of a reused one is what it took when it ran. A result found damaged later is
    /// made again, and then ends twice.
    fn task_finished(&self, _task: TaskId, _end: End, _seconds: f64, _bytes: u64) {}
    /// Something the user should know.
    fn warning(&self, _text: &str) {}
}

/// Watches nothing.
pub struct Unobserved;

impl Observer for Unobserved {}
