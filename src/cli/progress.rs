//! How far a run is: bars with rate and time left on a terminal, a plain line when a node begins and ends elsewhere, one JSON object a line when asked for.

use crate::args::ProgressStyle as Style;
use crate::common::{human_bytes, human_seconds};
use crate::terminal::say;
use indicatif::{MultiProgress, ProgressBar, ProgressState, ProgressStyle};
use photocurrent_engine::{End, Observer, Plan, TaskId};
use serde_json::json;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::io::IsTerminal;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Who watches a run.
pub enum Watcher {
    /// A person at a terminal.
    Bars(Bars),
    /// A log.
    Plain(Labels),
    /// A program.
    Lines(Lines),
    /// Nobody.
    Quiet,
}

impl Watcher {
    /// As asked for; by itself bars on a terminal and plain lines elsewhere, and nothing when `quiet`.
    pub fn new(plan: &Plan, style: Style, quiet: bool) -> Watcher {
        let labels = plan.tasks.iter().map(|task| (task.label.clone(), task.decl.kind)).collect();
        match (style, std::io::stderr().is_terminal()) {
            (Style::Auto, _) if quiet => Watcher::Quiet,
            (Style::None, _) => Watcher::Quiet,
            (Style::Json, _) => Watcher::Lines(Lines { labels, done: Mutex::default() }),
            (Style::Auto, true) => Watcher::Bars(Bars { multi: MultiProgress::new(), running: Mutex::default(), labels }),
            (Style::Auto, false) | (Style::Plain, _) => Watcher::Plain(labels),
        }
    }
}

/// Name and kind of every task.
type Labels = Vec<(String, &'static str)>;

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
    labels: Labels,
}

impl Bars {
    fn say(&self, text: &str) {
        // A terminal that went away is no reason to stop a run.
        let _ = self.multi.println(text);
    }
}

/// One JSON object a line.
pub struct Lines {
    labels: Labels,
    /// Progress is worth ten lines a node, not thousands.
    done: Mutex<BTreeMap<TaskId, Done>>,
}

/// How far a task is.
#[derive(Default)]
struct Done {
    at: u64,
    total: u64,
    /// The tenth last reported.
    tenth: u64,
    since: Option<Instant>,
}

fn line(value: serde_json::Value) {
    say!("{value}");
}

impl Observer for Watcher {
    fn planned(&self, tasks: usize) {
        match self {
            Watcher::Lines(_) => line(json!({"event": "planned", "nodes": tasks})),
            Watcher::Plain(_) => say!("{tasks} nodes"),
            Watcher::Bars(_) | Watcher::Quiet => {}
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
            Watcher::Plain(labels) => say!("started  {label} ({})", labels[task].1),
            Watcher::Lines(lines) => line(json!({"event": "started", "node": label, "kind": lines.labels[task].1})),
            Watcher::Quiet => {}
        }
    }

    fn progress_begin(&self, task: TaskId, total: u64, unit: &str) {
        match self {
            Watcher::Bars(bars) => {
                if let Some(bar) = locked(&bars.running).get(&task) {
                    let style = ProgressStyle::with_template(&format!("{{prefix:>18}} [{{bar:30}}] {{pos}}/{{len}} {unit}, {{per_sec}}{{left}}"));
                    let left = |state: &ProgressState, text: &mut dyn Write| {
                        let estimate = time_left(state.elapsed().as_secs_f64(), state.pos(), state.len().unwrap_or(0));
                        // A terminal that does not take it shows less.
                        let _ = estimate.map_or(Ok(()), |seconds| write!(text, ", {} left", human_seconds(seconds)));
                    };
                    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> ").with_key("left", left));
                    if bar.length().is_none() {
                        // What came before the first item does not show how fast they go.
                        bar.reset_elapsed();
                    }
                    // Each row band begins anew: the bar's length grows with them.
                    bar.set_length(bar.length().unwrap_or(0) + total);
                }
            }
            Watcher::Lines(lines) => {
                let mut done = locked(&lines.done);
                let done = done.entry(task).or_default();
                done.total += total;
                done.since.get_or_insert_with(Instant::now);
            }
            Watcher::Plain(_) | Watcher::Quiet => {}
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
                let Done { at, total, tenth, since } = done.entry(task).or_default();
                *at += items;
                let now = (10 * *at).checked_div(*total).unwrap_or(0);
                if now > *tenth {
                    *tenth = now;
                    let left = since.and_then(|since| time_left(since.elapsed().as_secs_f64(), *at, *total));
                    line(json!({"event": "progress", "node": lines.labels[task].0, "done": *at, "total": *total, "seconds_left": left}));
                }
            }
            Watcher::Plain(_) | Watcher::Quiet => {}
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
            // What the cache had is counted at the end.
            Watcher::Plain(_) if end == End::Reused => {}
            Watcher::Plain(labels) => {
                let (label, kind) = &labels[task];
                say!("{:<8} {label} ({kind}), {}, {}", word(end), human_seconds(seconds), human_bytes(bytes));
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
            Watcher::Plain(_) | Watcher::Quiet => say!("warning: {text}"),
        }
    }
}

/// Seconds that the rest will take when it goes as it went; `None` before enough is done to say so.
fn time_left(elapsed: f64, done: u64, total: u64) -> Option<f64> {
    // A twentieth and two seconds: the first items warm caches, and fill buffers that the others find full.
    let enough = done > 0 && done < total && elapsed >= 2.0 && done >= total.div_ceil(20);
    enough.then(|| elapsed * (total - done) as f64 / done as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_is_shown_when_enough_is_done_to_know_it() {
        assert_eq!((time_left(100.0, 0, 10), time_left(1.9, 5, 10), time_left(60.0, 49, 1000), time_left(60.0, 10, 10)), (None, None, None, None));
        assert_eq!((time_left(60.0, 50, 1000), time_left(2.0, 5, 10)), (Some(1140.0), Some(2.0)));
    }
}
