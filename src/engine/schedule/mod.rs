//! Runs a plan: independent tasks at the same time, inside a memory budget, with one thread that writes.
//!
//! Each worker takes the next task that can go (`state`), looks it up, and runs it when the cache does not have it (`task`), cut into row
//! bands where the node allows (`bands`). Neither the number of threads nor the height of a band changes a result; a failed node stops only
//! what hangs on it; an interrupted run leaves the cache whole, because a record is written after everything it names.
//!
//! Inside a node the work is split by rayon's global pool, whose size is the process's own choice: the command sets it to the same number
//! of threads.

mod bands;
mod kept;
mod state;
mod task;
mod writer;

use crate::blocks::is_of;
use crate::export;
use crate::observer::{End, Observer};
use crate::outcome::{Outcome, TaskOutcome};
use crate::plan::{Plan, TaskId};
pub(crate) use bands::{Cutter, cut, halo as halo_of, inputs_of, least_bytes};
pub(crate) use kept::Kept;
use photocurrent_store::Cache;
use state::{Claim, Phase, State};
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
pub(crate) use task::checked;
pub(crate) use writer::guarded;

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

/// Half of what the machine has free, and 4 GiB where it does not say.
pub fn default_memory() -> u64 {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"));
    let kilobytes = line.and_then(|line| line.trim().trim_end_matches("kB").trim().parse::<u64>().ok());
    kilobytes.map_or(4 << 30, |kilobytes| kilobytes * 1024 / 2)
}

/// All memory that this process may ever have: the machine's, or less where a control group says so. `None` when neither is known.
pub fn machine_memory() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"));
    let total = line.and_then(|line| line.trim().trim_end_matches("kB").trim().parse::<u64>().ok()).map(|kilobytes| kilobytes * 1024);
    let limits = ["/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"];
    let limits = limits.iter().filter_map(|path| std::fs::read_to_string(path).ok()?.trim().parse::<u64>().ok());
    limits.chain(total).min()
}

/// What the workers share.
pub(crate) struct Shared<'a> {
    plan: &'a Plan,
    cache: &'a Cache,
    options: &'a Options,
    observer: &'a dyn Observer,
    cancel: &'a AtomicBool,
    /// Bands that are there already.
    kept: Kept,
    state: Mutex<State>,
    /// Rung whenever something changes that may let a worker go on.
    changed: Condvar,
}

impl Shared<'_> {
    fn state(&self) -> MutexGuard<'_, State> {
        // A worker that panics while it holds the lock breaks the whole run anyway, through the scope.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn warn(&self, text: String) {
        self.observer.warning(&text);
        self.state().warnings.push(text);
    }

    /// Reports the end of a task and of what it takes with it.
    fn announce(&self, ended: Vec<(TaskId, End)>) {
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

/// Runs a plan. What goes wrong in a node is in the outcome; the run itself always comes to an end.
///
/// `cancel` may be set at any time, from a signal handler's thread: no further task begins, and running ones stop at their next step.
pub fn run(plan: &Plan, cache: &Cache, options: &Options, observer: &dyn Observer, cancel: &AtomicBool) -> Outcome {
    let threads = options.threads.max(1);
    let forced = |task: TaskId| plan.tasks[task].uses.iter().any(|(_, name)| options.force.iter().any(|node| is_of(name, node)));
    let state = Mutex::new(State::new(plan, options.memory, forced));
    let (kept, trouble) = Kept::open(plan, cache, &options.parts);
    let shared = Shared { plan, cache, options, observer, cancel, kept, state, changed: Condvar::new() };
    observer.planned(plan.tasks.len());
    trouble.into_iter().for_each(|text| shared.warn(text));
    refuse_foreign_folders(&shared);
    let (sender, receiver) = writer::channel(threads);
    std::thread::scope(|scope| {
        let receiver = &receiver;
        scope.spawn(move || writer::write(cache, receiver));
        for _ in 0..threads.min(plan.tasks.len().max(1)) {
            let (shared, sender) = (&shared, sender.clone());
            scope.spawn(move || work(shared, &sender));
        }
        // The writer stops when the last sender is gone.
        drop(sender);
    });
    outcome(plan, options, shared.state.into_inner().unwrap_or_else(PoisonError::into_inner))
}

/// A destination that holds somebody's own files is refused before hours are spent on what should go there.
fn refuse_foreign_folders(shared: &Shared<'_>) {
    for (id, task) in shared.plan.tasks.iter().enumerate() {
        let Some(folder) = task.export.as_ref().map(|folder| shared.options.out_dir.join(folder)) else { continue };
        if export::read_stamp(&folder).is_none()
            && let Err(error) = export::check_free(&folder)
        {
            task::end_with_error(shared, id, error, 0.0);
        }
    }
}

/// Stops the other workers when this one breaks off: they would wait for its task for ever.
struct StopsOthers<'a, 'b>(&'a Shared<'b>);

impl Drop for StopsOthers<'_, '_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.state().broken = true;
            self.0.changed.notify_all();
        }
    }
}

fn work(shared: &Shared<'_>, writer: &crossbeam::channel::Sender<writer::Message>) {
    let _stops = StopsOthers(shared);
    loop {
        let claim = {
            let mut state = shared.state();
            loop {
                if shared.cancel.load(Ordering::Relaxed) {
                    let ended = state.interrupt();
                    drop(state);
                    shared.announce(ended);
                    state = shared.state();
                }
                match state.claim() {
                    // The flag is set from outside and rings no bell, so the wait is short.
                    Claim::Wait => state = shared.changed.wait_timeout(state, Duration::from_millis(50)).unwrap_or_else(PoisonError::into_inner).0,
                    claim => break claim,
                }
            }
        };
        match claim {
            Claim::Check(id) => task::look_up(shared, id),
            Claim::Run(id) => task::run(shared, id, writer),
            Claim::Stop | Claim::Wait => return,
        }
    }
}

fn outcome(plan: &Plan, options: &Options, state: State) -> Outcome {
    let tasks = plan.tasks.iter().zip(state.slots).map(|(task, slot)| TaskOutcome {
        label: task.label.clone(),
        kind: task.decl.kind,
        uses: task.uses.clone(),
        end: match slot.phase {
            Phase::Done(end) => end,
            phase => panic!("every task has ended when the workers have, but {} is {phase:?}", task.label),
        },
        error: slot.error,
        because: slot.because,
        notes: slot.notes,
        seconds: slot.seconds,
        outputs: slot.outputs,
        key: slot.key,
        export: task.export.as_ref().map(|folder| options.out_dir.join(folder)),
    });
    Outcome { tasks: tasks.collect(), variants: plan.variants.clone(), warnings: state.warnings, is_ablation: plan.is_ablation }
}
