//! What a run would do, and why: for `plan` and `explain`. Writes no result and no history; at most the cache
//! remembers the digest of an outside file that it had to read.
//!
//! A task is compared with the record of its node's last run in this manifest and variant; when there is
//! none, with the most similar record of its kind. Behind a task that will run, keys are not known yet: what
//! follows *waits*, and may still turn out to be there when the new result equals the old one.

use crate::key::{self, Reuse};
use crate::plan::Plan;
use crate::task::{Task, TaskId};
use photocurrent_core::Digest;
use photocurrent_store::{Cache, Ingredients, Lookup, Record};
use std::path::Path;

/// What would happen to a task.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum State {
    /// It is in the cache.
    Hit,
    /// It would run.
    Miss {
        /// Why, one line each.
        reasons: Vec<String>,
    },
    /// A task before it would run; whether this one must is known after that.
    Waits {
        /// The nodes it waits for.
        on: Vec<String>,
        /// What is known to have changed besides.
        reasons: Vec<String>,
    },
}

/// A task and what would happen to it.
#[derive(Clone, Debug)]
pub struct TaskStatus {
    /// Its place in the plan.
    pub task: TaskId,
    /// What would happen.
    pub state: State,
    /// Its key, when it is known already.
    pub key: Option<Digest>,
    /// About how many bytes its outputs take.
    pub predicted_bytes: u64,
    /// What the run took that it was compared with.
    pub predicted_seconds: Option<f64>,
}

/// Says for every task of a plan what a run would do.
///
/// Parameters that name files which cannot be read make a miss with that reason: the run will say the rest.
pub fn status(plan: &Plan, cache: &Cache, out_dir: &Path) -> Vec<TaskStatus> {
    let mut all: Vec<TaskStatus> = Vec::new();
    let mut found: Vec<Option<Box<Record>>> = Vec::new();
    let mut history = History { plan, cache, records: None };
    for (id, task) in plan.tasks.iter().enumerate() {
        let stored = |from: TaskId, port: &str| found[from].as_ref()?.outputs.get(port).copied().flatten();
        let content = |from: TaskId, port: &str| stored(from, port).map(|output| output.digest);
        let ingredients = key::ingredients(task, cache, &content);
        let (mut state, mut known_key, mut record, mut seconds) = (State::Hit, None, None, None);
        match &ingredients {
            Err(error) => state = State::Miss { reasons: vec![error.message.clone()] },
            Ok(None) => {
                let waiting = task.needs().into_iter().filter(|&need| found[need].is_none());
                let last = history.last(task);
                let reasons = last.as_ref().map(|record| own_changes(task, record)).unwrap_or_default();
                seconds = last.map(|record| record.seconds);
                state = State::Waits {
                    on: waiting.map(|need| plan.tasks[need].label.clone()).collect(),
                    reasons,
                };
            }
            Ok(Some(ingredients)) => {
                let key = ingredients.key();
                known_key = Some(key);
                match key::look_up(task, &key, cache, out_dir) {
                    Reuse::Hit(hit) => record = Some(hit),
                    Reuse::Partly { reasons } => {
                        seconds = history.last(task).map(|record| record.seconds);
                        state = State::Miss { reasons };
                    }
                    Reuse::Nothing { damage } => {
                        let (reasons, compared) = history.reasons(task, ingredients, damage);
                        seconds = compared;
                        state = State::Miss { reasons };
                    }
                }
            }
        }
        let predicted_bytes = match &record {
            Some(record) => record.outputs.values().flatten().map(|output| output.bytes).sum(),
            None => task.stored().map(|output| output.meta.estimated_bytes()).sum(),
        };
        found.push(record);
        all.push(TaskStatus { task: id, state, key: known_key, predicted_bytes, predicted_seconds: seconds });
    }
    all
}

/// What changed in a task itself, while its inputs are not known.
fn own_changes(task: &Task, last: &Record) -> Vec<String> {
    let old = &last.ingredients;
    let now = Ingredients {
        revision: task.decl.revision,
        params: key::params(task),
        seed: task.seed,
        ..old.clone()
    };
    if now.kind == task.decl.kind {
        old.differences(&now)
    } else {
        vec![format!("kind {} -> {}", old.kind, task.decl.kind)]
    }
}

/// Records to compare with.
pub(crate) struct History<'a> {
    pub plan: &'a Plan,
    pub cache: &'a Cache,
    /// All records, read when they are first needed.
    pub records: Option<Vec<Record>>,
}

impl History<'_> {
    /// The record of the last run of one of the nodes that the task stands for.
    fn last(&self, task: &Task) -> Option<Record> {
        let keys = task.uses.iter().filter_map(|(variant, node)| {
            self.cache.recall(&self.plan.manifest_id.to_string(), variant, node)
        });
        keys.into_iter().find_map(|key| match self.cache.record(&key) {
            Lookup::Found(record) => Some(*record),
            _ => None,
        })
    }

    /// The most similar record of the same kind.
    fn nearest(&mut self, wanted: &Ingredients) -> Option<Record> {
        let cache = self.cache;
        // A cache that cannot be listed gives a poorer reason, not a failure.
        let records = self.records.get_or_insert_with(|| cache.records().unwrap_or_default());
        let same_kind = records.iter().filter(|record| record.ingredients.kind == wanted.kind);
        same_kind.min_by_key(|record| record.ingredients.differences(wanted).len()).cloned()
    }

    /// Why there is no record of these ingredients, and what a comparable run took.
    pub(crate) fn reasons(
        &mut self,
        task: &Task,
        wanted: &Ingredients,
        damage: Option<String>,
    ) -> (Vec<String>, Option<f64>) {
        if let Some(why) = damage {
            return (vec![format!("record damaged: {why}")], None);
        }
        let (record, is_own) = match self.last(task) {
            Some(record) => (record, true),
            None => match self.nearest(wanted) {
                Some(record) => (record, false),
                None => return (vec!["never ran".into()], None),
            },
        };
        if record.ingredients.kind != wanted.kind {
            return (vec![format!("kind {} -> {}", record.ingredients.kind, wanted.kind)], None);
        }
        let mut reasons = record.ingredients.differences(wanted);
        if !is_own {
            reasons.insert(0, "never ran here; compared with the most similar run:".into());
        }
        if reasons.is_empty() {
            reasons.push("its record is gone from the cache".into());
        }
        (reasons, Some(record.seconds))
    }
}
