//! Runs a plan: independent tasks at the same time, inside a memory budget, with one thread that writes.
//!
//! Each worker takes the next task that can go (`state`), looks it up, and runs it when the cache does not
//! have it (`task`), cut into row bands where the node allows (`bands`). Neither the number of threads nor
//! the height of a band changes a result; a failed node stops only what hangs on it; an interrupted run
//! leaves the cache whole, because a record is written after everything it names.
//!
//! Inside a node the work is split by rayon's global pool, whose size is the process's own choice: the
//! command sets it to the same number of threads.

mod bands;
mod kept;
mod shared;
mod state;
mod task;
mod writer;

use crate::blocks::is_of;
use crate::export;
use crate::observer::Observer;
use crate::outcome::{Outcome, TaskOutcome};
use crate::plan::Plan;
use crate::task::TaskId;
pub(crate) use bands::{Cutter, cut, halo as halo_of, inputs_of};
use kept::Kept;
use photocurrent_store::Cache;
use shared::Shared;
pub use shared::{Keep, Options};
use state::{Claim, Phase, State};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;
pub(crate) use task::{checked, wanted};
pub(crate) use writer::guarded;

/// Runs a plan. What goes wrong in a node is in the outcome; the run itself always comes to an end.
///
/// `cancel` may be set at any time, from a signal handler's thread: no further task begins, and running ones
/// stop at their next step.
pub fn run(
    plan: &Plan,
    cache: &Cache,
    options: &Options,
    observer: &dyn Observer,
    cancel: &AtomicBool,
) -> Outcome {
    let threads = options.threads.max(1);
    let forced = |task: TaskId| {
        plan.tasks[task].uses.iter().any(|(_, name)| options.force.iter().any(|node| is_of(name, node)))
    };
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
        let Some(folder) = task.export.as_ref().map(|folder| shared.options.out_dir.join(folder)) else {
            continue;
        };
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
                    Claim::Wait => {
                        state = shared
                            .changed
                            .wait_timeout(state, Duration::from_millis(50))
                            .unwrap_or_else(PoisonError::into_inner)
                            .0
                    }
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
    Outcome {
        tasks: tasks.collect(),
        variants: plan.variants.clone(),
        warnings: state.warnings,
        is_ablation: plan.is_ablation,
    }
}
