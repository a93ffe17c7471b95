//! Where every task stands, and which one a worker takes next.
//!
//! A task is looked up first, which needs no memory; when the cache does not have it, it waits until its
//! estimate fits in what is left. The first task in the plan's order that can go, goes. A task larger than
//! the whole budget runs when nothing else does.

use super::bands::Bands;
use crate::observer::End;
use crate::plan::Plan;
use crate::task::TaskId;
use photocurrent_core::{Digest, NodeError, Value};
use photocurrent_store::{Ingredients, StoredOutput};
use std::collections::BTreeMap;

/// How far a task is.
#[derive(Debug)]
pub(crate) enum Phase {
    /// For those before it.
    Waiting,
    /// A worker computes its key and looks it up.
    Checking,
    /// It must run, and waits for memory.
    Admitted,
    /// A worker runs it.
    Running,
    /// It ended.
    Done(End),
}

/// All that is known of one task.
pub(crate) struct Slot {
    pub phase: Phase,
    /// Run it whatever the cache says: asked for, or its result was found damaged.
    pub force: bool,
    /// How often it was run again because its stored result was damaged.
    pub repaired: u32,
    /// Another task that makes the same under the same key: this one is looked up again when that has ended.
    pub twin: Option<TaskId>,
    pub ingredients: Option<Ingredients>,
    pub bands: Option<Bands>,
    pub key: Option<Digest>,
    pub outputs: BTreeMap<String, StoredOutput>,
    /// Handles for those that take its outputs: in memory, or opened in the store once.
    pub values: BTreeMap<&'static str, Value>,
    /// Bytes of those that are in memory.
    pub retained: u64,
    pub error: Option<NodeError>,
    pub because: Vec<String>,
    pub notes: Vec<String>,
    pub seconds: f64,
}

/// What a worker is to do.
pub(crate) enum Claim {
    /// Look a task up.
    Check(TaskId),
    /// Run a task.
    Run(TaskId),
    /// Nothing now: somebody has to finish first.
    Wait,
    /// Nothing ever.
    Stop,
}

/// Where every task stands.
pub(crate) struct State {
    pub slots: Vec<Slot>,
    /// The tasks that each one needs, from the plan.
    needs: Vec<Vec<TaskId>>,
    /// The memory budget.
    pub memory: u64,
    /// Estimates of the tasks that run.
    pub used: u64,
    /// How many run.
    pub running: usize,
    /// Bytes of results kept for those that take them.
    pub retained: u64,
    pub warnings: Vec<String>,
    /// A worker broke off through a mistake of the engine: the others stop, so that it is seen.
    pub broken: bool,
}

impl State {
    pub(super) fn new(plan: &Plan, memory: u64, forced: impl Fn(TaskId) -> bool) -> State {
        let slot = |task| Slot {
            phase: Phase::Waiting,
            force: forced(task),
            repaired: 0,
            twin: None,
            ingredients: None,
            bands: None,
            key: None,
            outputs: BTreeMap::new(),
            values: BTreeMap::new(),
            retained: 0,
            error: None,
            because: Vec::new(),
            notes: Vec::new(),
            seconds: 0.0,
        };
        let needs = plan.tasks.iter().map(|task| task.needs().into_iter().collect()).collect();
        State {
            slots: (0..plan.tasks.len()).map(slot).collect(),
            needs,
            memory,
            used: 0,
            running: 0,
            retained: 0,
            warnings: Vec::new(),
            broken: false,
        }
    }

    fn ended_well(&self, task: TaskId) -> bool {
        matches!(self.slots[task].phase, Phase::Done(End::Executed | End::Reused))
    }

    /// The next thing to do; marks it as taken.
    pub(super) fn claim(&mut self) -> Claim {
        if self.broken {
            return Claim::Stop;
        }
        let mut idle = true;
        for id in 0..self.slots.len() {
            let twin_ended =
                self.slots[id].twin.is_none_or(|twin| matches!(self.slots[twin].phase, Phase::Done(_)));
            let ready = twin_ended && self.needs[id].iter().all(|&need| self.ended_well(need));
            match self.slots[id].phase {
                Phase::Admitted if ready && self.fits(id) => {
                    self.slots[id].phase = Phase::Running;
                    self.used += self.estimate(id);
                    self.running += 1;
                    return Claim::Run(id);
                }
                Phase::Waiting if ready => {
                    self.slots[id].phase = Phase::Checking;
                    return Claim::Check(id);
                }
                Phase::Done(_) => {}
                _ => idle = false,
            }
        }
        if idle { Claim::Stop } else { Claim::Wait }
    }

    /// A task that the cache does not have waits for memory; or for its twin, when another task is about to
    /// make the same.
    pub(super) fn admit(&mut self, task: TaskId, key: Digest, ingredients: Ingredients, bands: Bands) {
        let about_to_run =
            |slot: &Slot| matches!(slot.phase, Phase::Admitted | Phase::Running) && slot.key == Some(key);
        let twin = self.slots.iter().position(about_to_run);
        let slot = &mut self.slots[task];
        (slot.key, slot.ingredients, slot.bands) = (Some(key), Some(ingredients), Some(bands));
        slot.twin = twin;
        slot.phase = if twin.is_some() { Phase::Waiting } else { Phase::Admitted };
    }

    fn estimate(&self, task: TaskId) -> u64 {
        self.slots[task].bands.as_ref().map_or(0, |bands| bands.estimate)
    }

    fn fits(&self, task: TaskId) -> bool {
        self.running == 0
            || self.used.saturating_add(self.retained).saturating_add(self.estimate(task)) <= self.memory
    }

    /// A running task stops running, however it went.
    pub(super) fn release(&mut self, task: TaskId) {
        self.used -= self.estimate(task);
        self.running -= 1;
    }

    /// A task ended: what hangs on a failed one is skipped, and results that nobody waits for any more are
    /// let go.
    pub(super) fn finish(&mut self, plan: &Plan, task: TaskId, end: End) -> Vec<(TaskId, End)> {
        self.slots[task].phase = Phase::Done(end);
        let mut ended = vec![(task, end)];
        if !matches!(end, End::Executed | End::Reused) {
            let after = if end == End::Interrupted { End::Interrupted } else { End::Skipped };
            let mut because: BTreeMap<TaskId, String> =
                BTreeMap::from([(task, plan.tasks[task].label.clone())]);
            // The plan's order lets one pass find all descendants.
            for id in task + 1..plan.tasks.len() {
                let Some(reason) = self.needs[id].iter().find_map(|need| because.get(need)).cloned() else {
                    continue;
                };
                // What has ended already keeps its result, even when a result before it could not be made
                // again.
                if matches!(self.slots[id].phase, Phase::Waiting | Phase::Admitted) {
                    because.insert(id, reason.clone());
                    self.slots[id].phase = Phase::Done(after);
                    self.slots[id].because.push(reason);
                    ended.push((id, after));
                }
            }
        }
        self.let_go();
        ended
    }

    /// Drops the handles of results that everybody who takes them is done with.
    fn let_go(&mut self) {
        let mut asked = vec![false; self.slots.len()];
        for (slot, needs) in self.slots.iter().zip(&self.needs) {
            if !matches!(slot.phase, Phase::Done(_)) {
                needs.iter().for_each(|&need| asked[need] = true);
            }
        }
        for (slot, asked) in self.slots.iter_mut().zip(asked) {
            if !asked && !slot.values.is_empty() {
                slot.values.clear();
                self.retained -= std::mem::take(&mut slot.retained);
            }
        }
    }

    /// Nothing new begins: what waits ends as interrupted.
    pub(super) fn interrupt(&mut self) -> Vec<(TaskId, End)> {
        let mut ended = Vec::new();
        for (id, slot) in self.slots.iter_mut().enumerate() {
            if matches!(slot.phase, Phase::Waiting | Phase::Admitted) {
                slot.phase = Phase::Done(End::Interrupted);
                ended.push((id, End::Interrupted));
            }
        }
        ended
    }

    /// A stored result of `producer` cannot be read: it is made again, and `consumer` waits for that. False
    /// when that was tried already.
    pub(super) fn send_back(&mut self, producer: TaskId, consumer: TaskId) -> bool {
        // Two consumers may find the same damage; the second one only waits, or finds it repaired when it
        // looks again. A result that is damaged again and again means a failing disk.
        if self.ended_well(producer) && self.slots[producer].repaired >= 2 {
            return false;
        }
        self.slots[consumer].phase = Phase::Waiting;
        if self.ended_well(producer) {
            let slot = &mut self.slots[producer];
            slot.phase = Phase::Waiting;
            slot.force = true;
            slot.repaired += 1;
            slot.values.clear();
            self.retained -= std::mem::take(&mut slot.retained);
        }
        true
    }
}
