//! How far a run is: bars with rate and time left on a terminal, a plain line when a node begins and ends
//! elsewhere, one JSON object a line when asked for.

use crate::args::ProgressStyle as Style;
use crate::numbers::{human_bytes, human_seconds};
use crate::terminal::{host_observer, is_terminal, say};
use indicatif::{MultiProgress, ProgressBar, ProgressState, ProgressStyle};
use photocurrent_engine::{End, Observer, Plan, TaskId};
use serde_json::json;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// The form of a line of `--progress json`.
pub const SCHEMA: &str = include_str!("progress.schema.json");

/// Who watches a run of a process of ours.
enum Watcher {
    /// A person at a terminal.
    Bars(Bars),
    /// A log.
    Plain(Labels),
    /// A program.
    Lines(Lines),
    /// Nobody.
    Quiet,
}

/// Who watches a run: the program that the command runs in, otherwise a [`Watcher`].
pub fn watcher(plan: &Plan, style: Style, quiet: bool) -> Arc<dyn Observer + Send + Sync> {
    host_observer().unwrap_or_else(|| Arc::new(Watcher::new(plan, style, quiet)))
}

impl Watcher {
    /// As asked for; by itself bars on a terminal and plain lines elsewhere, and nothing when `quiet`.
    fn new(plan: &Plan, style: Style, quiet: bool) -> Watcher {
        let labels = plan.tasks.iter().map(|task| (task.label.clone(), task.decl.kind)).collect();
        match (style, is_terminal()) {
            (Style::Auto, _) if quiet => Watcher::Quiet,
            (Style::None, _) => Watcher::Quiet,
            (Style::Json, _) => Watcher::Lines(Lines { labels, done: Mutex::default() }),
            (Style::Auto, true) => {
                Watcher::Bars(Bars { multi: MultiProgress::new(), running: Mutex::default(), labels })
            }
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
struct Bars {
    multi: MultiProgress,
    running: Mutex<BTreeMap<TaskId, Running>>,
    labels: Labels,
}

/// A running node's bar, and its pace, which the bar asks when it is drawn.
struct Running {
    bar: ProgressBar,
    pace: Arc<Mutex<Pace>>,
}

impl Bars {
    fn say(&self, text: &str) {
        // A terminal that went away is no reason to stop a run.
        let _ = self.multi.println(text);
    }
}

/// One JSON object a line.
struct Lines {
    labels: Labels,
    /// Progress is worth ten lines a node, not thousands.
    done: Mutex<BTreeMap<TaskId, Done>>,
}

/// How far a task is.
#[derive(Default)]
struct Done {
    pace: Pace,
    /// The tenth last reported.
    tenth: u64,
}

/// How much of a task is done, and how fast it went.
#[derive(Default)]
struct Pace {
    /// When its first items began.
    since: Option<Instant>,
    done: u64,
    total: u64,
    /// Seconds and items done, a hundredth of the task apart or more.
    marks: Vec<(f64, u64)>,
}

impl Pace {
    /// So many more items there are: each row band may add its own.
    fn begin(&mut self, items: u64) {
        self.since.get_or_insert_with(Instant::now);
        self.total += items;
    }

    /// So many more are done.
    fn advance(&mut self, items: u64) {
        self.done += items;
        let last = self.marks.last().map_or(0, |&(_, done)| done);
        if self.done - last >= self.total.div_ceil(100) {
            self.marks.push((self.elapsed(), self.done));
        }
    }

    fn elapsed(&self) -> f64 {
        self.since.map_or(0.0, |since| since.elapsed().as_secs_f64())
    }

    fn left(&self) -> Option<f64> {
        time_left(&self.marks, self.elapsed(), self.done, self.total)
    }
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
                let spinner = ProgressStyle::with_template("{prefix:>18} {spinner} {elapsed}")
                    .unwrap_or_else(|_| ProgressStyle::default_spinner());
                let bar = bars
                    .multi
                    .add(ProgressBar::new_spinner().with_prefix(label.to_string()).with_style(spinner));
                bar.enable_steady_tick(std::time::Duration::from_millis(120));
                locked(&bars.running).insert(task, Running { bar, pace: Arc::default() });
            }
            Watcher::Plain(labels) => say!("started  {label} ({})", labels[task].1),
            Watcher::Lines(lines) => {
                line(json!({"event": "started", "node": label, "kind": lines.labels[task].1}))
            }
            Watcher::Quiet => {}
        }
    }

    fn progress_begin(&self, task: TaskId, total: u64, unit: &str) {
        match self {
            Watcher::Bars(bars) => {
                if let Some(Running { bar, pace }) = locked(&bars.running).get(&task) {
                    let style = ProgressStyle::with_template(&format!(
                        "{{prefix:>18}} [{{bar:30}}] {{pos}}/{{len}} {unit}, {{per_sec}}{{left}}"
                    ));
                    locked(pace).begin(total);
                    let shown = Arc::clone(pace);
                    let left = move |_: &ProgressState, text: &mut dyn Write| {
                        // A terminal that does not take it shows less.
                        let _ = locked(&shown)
                            .left()
                            .map_or(Ok(()), |seconds| write!(text, ", {} left", human_seconds(seconds)));
                    };
                    bar.set_style(
                        style
                            .unwrap_or_else(|_| ProgressStyle::default_bar())
                            .progress_chars("=> ")
                            .with_key("left", left),
                    );
                    if bar.length().is_none() {
                        // What came before the first item does not show how fast they go.
                        bar.reset_elapsed();
                    }
                    bar.set_length(bar.length().unwrap_or(0) + total);
                }
            }
            Watcher::Lines(lines) => {
                let mut done = locked(&lines.done);
                done.entry(task).or_default().pace.begin(total);
            }
            Watcher::Plain(_) | Watcher::Quiet => {}
        }
    }

    fn progress_advance(&self, task: TaskId, items: u64) {
        match self {
            Watcher::Bars(bars) => {
                if let Some(Running { bar, pace }) = locked(&bars.running).get(&task) {
                    // Not held while the bar is drawn, which asks it.
                    locked(pace).advance(items);
                    bar.inc(items);
                }
            }
            Watcher::Lines(lines) => {
                let mut done = locked(&lines.done);
                let Done { pace, tenth } = done.entry(task).or_default();
                pace.advance(items);
                let now = (10 * pace.done).checked_div(pace.total).unwrap_or(0);
                if now > *tenth {
                    *tenth = now;
                    let Pace { done: at, total, .. } = *pace;
                    line(json!({
                        "event": "progress", "node": lines.labels[task].0, "done": at, "total": total,
                        "seconds_left": pace.left(),
                    }));
                }
            }
            Watcher::Plain(_) | Watcher::Quiet => {}
        }
    }

    fn task_finished(&self, task: TaskId, end: End, seconds: f64, bytes: u64) {
        match self {
            Watcher::Bars(bars) => {
                if let Some(Running { bar, .. }) = locked(&bars.running).remove(&task) {
                    bar.finish_and_clear();
                }
                if end != End::Reused {
                    let (label, kind) = &bars.labels[task];
                    bars.say(&format!(
                        "{label:>18} {:<12} {kind}, {}, {}",
                        word(end),
                        human_seconds(seconds),
                        human_bytes(bytes)
                    ));
                }
            }
            // What the cache had is counted at the end.
            Watcher::Plain(_) if end == End::Reused => {}
            Watcher::Plain(labels) => {
                let (label, kind) = &labels[task];
                say!("{:<8} {label} ({kind}), {}, {}", word(end), human_seconds(seconds), human_bytes(bytes));
            }
            Watcher::Lines(lines) => line(json!({
                "event": "finished", "node": lines.labels[task].0, "end": word(end).to_lowercase(),
                "seconds": seconds, "bytes": bytes,
            })),
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

/// Seconds that the rest will take when it goes as the later half of what is done; `None` before enough is
/// done to say so.
///
/// The first half may have shared the processor with a node that has ended since, and its first items fill
/// buffers that the others find full.
fn time_left(marks: &[(f64, u64)], elapsed: f64, done: u64, total: u64) -> Option<f64> {
    let enough = done < total && elapsed >= 2.0 && done >= total.div_ceil(20).max(1);
    let (from, before) =
        marks.iter().copied().take_while(|&(_, mark)| 2 * mark <= done).last().unwrap_or((0.0, 0));
    enough.then(|| (elapsed - from) * (total - done) as f64 / (done - before) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_is_shown_when_enough_is_done_to_know_it() {
        let even = |elapsed, done, total| time_left(&[], elapsed, done, total);
        assert_eq!(
            (even(100.0, 0, 10), even(1.9, 5, 10), even(60.0, 49, 1000), even(60.0, 10, 10)),
            (None, None, None, None)
        );
        assert_eq!((even(60.0, 50, 1000), even(2.0, 5, 10)), (Some(1140.0), Some(2.0)));
    }

    /// 40 items in 80 s while another node ran, then 60 in 60 s: 900 more take 900 s, not 1,260.
    #[test]
    fn the_time_left_follows_the_later_half_of_what_is_done() {
        let marks = [(20.0, 10), (40.0, 20), (60.0, 30), (80.0, 40), (90.0, 50), (100.0, 60), (140.0, 100)];
        assert_eq!(time_left(&marks, 140.0, 100, 1000), Some(900.0));
    }

    #[test]
    fn marks_are_a_hundredth_of_the_task_apart() {
        let mut pace = Pace::default();
        pace.begin(300);
        pace.begin(700);
        (0..1000).for_each(|_| pace.advance(1));
        let done: Vec<u64> = pace.marks.iter().map(|&(_, done)| done).collect();
        assert_eq!(done, (1..=100).map(|mark| 10 * mark).collect::<Vec<_>>());
    }
}
