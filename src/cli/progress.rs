//! How far a run is: bars with rate and time left on a terminal, one JSON object a line otherwise.

use crate::common::{human_bytes, human_seconds};
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use photocurrent_engine::{End, Observer, Plan, TaskId};
use serde_json::json;
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Who watches a run.
pub enum Watcher {
    /// A person at a terminal.
    Bars(Bars),
    /// A program, or a log.
    Lines(Lines),
    /// Nobody.
    Quiet,
}

impl Watcher {
    /// Bars on a terminal, lines otherwise, nothing when `quiet`.
    pub fn new(plan: &Plan, quiet: bool) -> Watcher {
        let labels = plan.tasks.iter().map(|task| (task.label.clone(), task.decl.kind)).collect();
        match (quiet, std::io::stderr().is_terminal()) {
            (true, _) => Watcher::Quiet,
            (false, true) => Watcher::Bars(Bars { multi: MultiProgress::new(), running: Mutex::default(), labels }),
            (false, false) => Watcher::Lines(Lines { labels, done: Mutex::default() }),
        }
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn word(end: End) -> &'static str {
    match end {
        End::Executed => "done",
        End::Reused => "reused",
        End::Failed => "FAILED",
        End::Skipped => "skipped",
        End::Interrupted => "interrupted",
    }
}

/// One bar a running node.
pub struct Bars {
    multi: MultiProgress,
    running: Mutex<BTreeMap<TaskId, ProgressBar>>,
    labels: Vec<(String, &'static str)>,
}

impl Bars {
    fn say(&self, text: &str) {
        // A terminal that went away is no reason to stop a run.
        let _ = self.multi.println(text);
    }
}

/// One JSON object a line.
pub struct Lines {
    labels: Vec<(String, &'static str)>,
    /// Items done and in all per task, and the tenth last told: progress is worth ten lines a node, not thousands.
    done: Mutex<BTreeMap<TaskId, (u64, u64, u64)>>,
}

fn line(value: serde_json::Value) {
    eprintln!("{value}");
}

impl Observer for Watcher {
    fn planned(&self, tasks: usize) {
        if let Watcher::Lines(_) = self {
            line(json!({"event": "planned", "nodes": tasks}));
        }
    }

    fn task_started(&self, task: TaskId, label: &str) {
        match self {
            Watcher::Bars(bars) => {
                let spinner = ProgressStyle::with_template("{prefix:>18} {spinner} {elapsed}").unwrap_or_else(|_| ProgressStyle::default_spinner());
                let bar = bars.multi.add(ProgressBar::new_spinner().with_prefix(label.to_string()).with_style(spinner));
                bar.enable_steady_tick(std::time::Duration::from_millis(120));
                locked(&bars.running).insert(task, bar);
            }
            Watcher::Lines(lines) => line(json!({"event": "started", "node": label, "kind": lines.labels[task].1})),
            Watcher::Quiet => {}
        }
    }

    fn progress_begin(&self, task: TaskId, total: u64, unit: &str) {
        match self {
            Watcher::Bars(bars) => {
                if let Some(bar) = locked(&bars.running).get(&task) {
                    let style = ProgressStyle::with_template(&format!("{{prefix:>18}} [{{bar:30}}] {{pos}}/{{len}} {unit}, {{per_sec}}, {{eta}} left"));
                    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
                    // Each row band begins anew: the bar's length grows with them.
                    bar.set_length(bar.length().unwrap_or(0) + total);
                }
            }
            Watcher::Lines(lines) => locked(&lines.done).entry(task).or_default().1 += total,
            Watcher::Quiet => {}
        }
    }

    fn progress_advance(&self, task: TaskId, items: u64) {
        match self {
            Watcher::Bars(bars) => {
                if let Some(bar) = locked(&bars.running).get(&task) {
                    bar.inc(items);
                }
            }
            Watcher::Lines(lines) => {
                let mut done = locked(&lines.done);
                let (at, total, told) = done.entry(task).or_default();
                *at += items;
                let tenth = (10 * *at).checked_div(*total).unwrap_or(0);
                if tenth > *told {
                    *told = tenth;
                    line(json!({"event": "progress", "node": lines.labels[task].0, "done": *at, "total": *total}));
                }
            }
            Watcher::Quiet => {}
        }
    }

    fn task_finished(&self, task: TaskId, end: End, seconds: f64, bytes: u64) {
        match self {
            Watcher::Bars(bars) => {
                if let Some(bar) = locked(&bars.running).remove(&task) {
                    bar.finish_and_clear();
                }
                if end != End::Reused {
                    let (label, kind) = &bars.labels[task];
                    bars.say(&format!("{label:>18} {:<12} {kind}, {}, {}", word(end), human_seconds(seconds), human_bytes(bytes)));
                }
            }
            Watcher::Lines(lines) => {
                line(json!({"event": "finished", "node": lines.labels[task].0, "end": word(end).to_lowercase(), "seconds": seconds, "bytes": bytes}))
            }
            Watcher::Quiet => {}
        }
    }

    fn warning(&self, text: &str) {
        match self {
            Watcher::Bars(bars) => bars.say(&format!("warning: {text}")),
            Watcher::Lines(_) => line(json!({"event": "warning", "text": text})),
            Watcher::Quiet => eprintln!("warning: {text}"),
        }
    }
}
