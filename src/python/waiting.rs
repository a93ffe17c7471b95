//! Work in a thread of its own: Python's signals are seen meanwhile, and progress is reported.
//!
//! The first Ctrl-C sets the flag that stops the work at its next step, and the exception is raised when it
//! has stopped. A second one leaves the work to end by itself, and is raised at once.

use crate::trouble;
use photocurrent_engine::{End, Observer};
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How often signals and progress are looked after.
const TICK: Duration = Duration::from_millis(50);

/// How far a node is.
#[derive(Clone, Default)]
struct Step {
    node: String,
    done: u64,
    total: u64,
    unit: String,
    end: Option<&'static str>,
    seconds: f64,
}

/// Steps that Python has not heard of yet.
#[derive(Default)]
struct News {
    tasks: BTreeMap<usize, Step>,
    changed: Vec<usize>,
}

/// Keeps the progress of a run until Python takes it.
#[derive(Default)]
pub struct Progress(Mutex<News>);

impl Progress {
    fn news(&self) -> MutexGuard<'_, News> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn change(&self, task: usize, change: impl FnOnce(&mut Step)) {
        let mut news = self.news();
        change(news.tasks.entry(task).or_default());
        if !news.changed.contains(&task) {
            news.changed.push(task);
        }
    }

    fn take(&self) -> Vec<Step> {
        let mut news = self.news();
        let changed = std::mem::take(&mut news.changed);
        changed.iter().filter_map(|task| news.tasks.get(task).cloned()).collect()
    }
}

impl Observer for Progress {
    fn task_started(&self, task: usize, label: &str) {
        self.change(task, |step| step.node = label.to_owned());
    }

    fn progress_begin(&self, task: usize, total: u64, unit: &str) {
        self.change(task, |step| {
            step.total += total;
            step.unit = unit.to_owned();
        });
    }

    fn progress_advance(&self, task: usize, items: u64) {
        self.change(task, |step| step.done += items);
    }

    fn task_finished(&self, task: usize, end: End, seconds: f64, _bytes: u64) {
        // What the cache had never began, and has no name here.
        if self.news().tasks.contains_key(&task) {
            self.change(task, |step| (step.end, step.seconds) = (Some(end.name()), seconds));
        }
    }
}

/// Does the work in a thread of its own and waits for it. `heard` is called with the progress of its nodes,
/// as `(node, done, total, unit, end or None, seconds)`.
pub fn wait<T: Send + 'static>(
    py: Python<'_>,
    cancel: &Arc<AtomicBool>,
    heard: Option<(&Progress, &Bound<'_, PyAny>)>,
    work: impl FnOnce() -> T + Send + 'static,
) -> PyResult<T> {
    let (sender, mut receiver) = channel();
    let thread = std::thread::Builder::new().name("photocurrent".into()).stack_size(8 << 20);
    thread.spawn(move || {
        // Nobody waits any more after a second Ctrl-C.
        let _ = sender.send(catch_unwind(AssertUnwindSafe(work)));
    })?;
    // What Python raised, and that is raised when the work has stopped.
    let mut raised: Option<PyErr> = None;
    loop {
        // Moved, as it may not be shared between threads.
        let waiting = &mut receiver;
        let received = py.detach(move || waiting.recv_timeout(TICK));
        if let (Some((progress, callback)), None) = (heard, &raised) {
            let report = |Step { node, done, total, unit, end, seconds }| {
                callback.call1((node, done, total, unit, end, seconds)).map(drop)
            };
            raised = progress.take().into_iter().try_for_each(report).err();
        }
        match received {
            Ok(done) => {
                let done = done.map_err(|payload| trouble::panicked(py, &*payload))?;
                return raised.map_or(Ok(done), Err);
            }
            Err(RecvTimeoutError::Disconnected) => return Err(trouble::panicked(py, &"its thread is gone")),
            Err(RecvTimeoutError::Timeout) => {}
        }
        match py.check_signals() {
            Err(again) if raised.is_some() => return Err(again),
            Err(first) => raised = Some(first),
            Ok(()) => {}
        }
        if raised.is_some() {
            cancel.store(true, Ordering::Relaxed);
        }
    }
}
