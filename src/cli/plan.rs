//! `photocurrent plan`, `explain`: what would happen and why. Neither writes anything. `run --confirm` shows
//! the same before it begins.

use crate::args::{ExplainOptions, PlanOptions, Target};
use crate::failure::{Done, Failure, usage};
use crate::numbers::{human_bytes, human_seconds, print_count};
use crate::tables::draw;
use crate::terminal::{is_terminal, print, print_json, say};
use photocurrent_engine::{Plan, State, TaskId, TaskStatus, status};
use photocurrent_store::{Cache, Lookup};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::io::{IsTerminal, Write};

/// A cache to look into: the one there is, or an empty one that is gone afterwards, so that looking makes no
/// folder.
struct Look {
    cache: Cache,
    _empty: Option<tempfile::TempDir>,
}

impl Look {
    fn new(target: &Target) -> Result<Look, Failure> {
        if target.cache.is_dir() {
            return Ok(Look { cache: Cache::open(&target.cache)?, _empty: None });
        }
        let empty = tempfile::tempdir()?;
        Ok(Look { cache: Cache::open(empty.path())?, _empty: Some(empty) })
    }
}

fn word(state: &State) -> &'static str {
    match state {
        State::Hit => "hit",
        State::Miss { .. } => "miss",
        State::Waits { .. } => "waits",
    }
}

fn reasons(state: &State) -> Vec<String> {
    match state {
        State::Hit => Vec::new(),
        State::Miss { reasons } => reasons.clone(),
        State::Waits { on, reasons } => {
            std::iter::once(format!("waits for {}", on.join(", "))).chain(reasons.iter().cloned()).collect()
        }
    }
}

fn as_json(plan: &Plan, status: &TaskStatus) -> Value {
    let task = &plan.tasks[status.task];
    json!({
        "node": task.label, "kind": task.decl.kind, "uses": task.uses, "params": task.params,
        "changed_params": task.changed_params,
        "state": word(&status.state), "reasons": reasons(&status.state), "key": status.key,
        "predicted_bytes": status.predicted_bytes, "predicted_seconds": status.predicted_seconds,
    })
}

/// Shows every task in running order.
pub fn plan(options: &PlanOptions) -> Done {
    let (_, plan) = options.target.plan("plan")?;
    options.target.check_out_dir()?;
    let look = Look::new(&options.target)?;
    let all = status(&plan, &look.cache, &options.target.out_dir());
    if options.json {
        print_json(&json!({
            "variants": plan.variants.iter().map(|v| v.name.clone()).collect::<Vec<_>>(),
            "tasks": all.iter().map(|s| as_json(&plan, s)).collect::<Vec<_>>(),
        }))?;
        return Ok(0);
    }
    print(&table(&plan, &all))?;
    let count = |name: &str| all.iter().filter(|s| word(&s.state) == name).count();
    let variants =
        if plan.is_ablation { format!(" for {} variants", plan.variants.len()) } else { String::new() };
    for left in
        plan.variants.iter().flat_map(|variant| &variant.left_out).collect::<std::collections::BTreeSet<_>>()
    {
        say!("left out: {}: {}", left.node, left.why);
    }
    say!(
        "\n{} nodes{variants}: {} in the cache, {} to run, {} waiting",
        all.len(),
        count("hit"),
        count("miss"),
        count("waits")
    );
    Ok(0)
}

/// Every task with what would happen to it.
fn table(plan: &Plan, all: &[TaskStatus]) -> String {
    let mut rows = vec![
        ["node", "kind", "state", "size", "time", "why", "parameters that differ from their defaults"]
            .map(String::from)
            .to_vec(),
    ];
    for status in all {
        let task = &plan.tasks[status.task];
        let seconds = status.predicted_seconds.map(human_seconds).unwrap_or_default();
        rows.push(vec![
            task.label.clone(),
            task.decl.kind.into(),
            word(&status.state).into(),
            human_bytes(status.predicted_bytes),
            seconds,
            reasons(&status.state).join("; "),
            task.changed_params.join(", "),
        ]);
    }
    draw(&rows)
}

/// Shows on the terminal what a run would do, and waits for a yes; true without a word where nothing would
/// run.
///
/// # Errors
/// Where no terminal is there to answer.
pub fn confirm(target: &Target, plan: &Plan, forced: &[String]) -> Result<bool, Failure> {
    if !is_terminal() || !std::io::stdin().is_terminal() {
        let hint = "leave it out, or run `photocurrent plan`, which shows the same and runs nothing";
        return Err(usage(format!(
            "--confirm waits for an answer, and stdin and stderr are no terminal\n  hint: {hint}"
        )));
    }
    let look = Look::new(target)?;
    let all = status(plan, &look.cache, &target.out_dir());
    let forced: BTreeSet<TaskId> = forced.iter().flat_map(|node| plan.tasks_of(node)).collect();
    let (there, to_run): (Vec<&TaskStatus>, Vec<&TaskStatus>) =
        all.iter().partition(|status| status.state == State::Hit && !forced.contains(&status.task));
    if to_run.is_empty() {
        return Ok(true);
    }
    say!("{}", table(plan, &all));
    // A forced one that the cache has: what it took.
    let took = |status: &TaskStatus| match look.cache.record(&status.key?) {
        Lookup::Found(record) => Some(record.seconds),
        Lookup::Missing | Lookup::Damaged { .. } => None,
    };
    let known: Vec<f64> =
        to_run.iter().filter_map(|status| status.predicted_seconds.or_else(|| took(status))).collect();
    let unknown = to_run.len() - known.len();
    let time = match unknown {
        0 => format!("about {}", human_seconds(known.iter().sum())),
        _ if known.is_empty() => "for an unknown time".into(),
        _ => format!("about {} and {unknown} of unknown time", human_seconds(known.iter().sum())),
    };
    let bytes: u64 = to_run.iter().map(|status| status.predicted_bytes).sum();
    let (count, there) = (print_count(to_run.len(), "node"), there.len());
    say!("at most {count} to execute ({time}, {} stored), {there} in the cache", human_bytes(bytes));
    if !forced.is_empty() {
        say!("{} of them forced", forced.len());
    }
    ask("run? [y/N] ")
}

/// Puts a question; yes is `y` or `yes`, everything else is no.
fn ask(question: &str) -> Result<bool, Failure> {
    let mut stderr = std::io::stderr().lock();
    stderr.write_all(question.as_bytes())?;
    stderr.flush()?;
    let mut answer = String::new();
    std::io::stdin().read_line(&mut answer)?;
    Ok(matches!(answer.trim().to_lowercase().as_str(), "y" | "yes"))
}

/// Says why a node would run.
pub fn explain(options: &ExplainOptions) -> Done {
    let (_, plan) = options.target.plan("explain")?;
    let look = Look::new(&options.target)?;
    let found = photocurrent_engine::explain(&plan, &look.cache, &options.target.out_dir(), &options.node)
        .map_err(|problem| Failure::Problems(vec![problem]))?;
    if options.json {
        print_json(
            &found
                .iter()
                .map(|e| {
                    json!({"variants": e.variants, "status": as_json(&plan, &e.status),
        "lines": e.lines})
                })
                .collect(),
        )?;
        return Ok(0);
    }
    let mut text = String::new();
    for explanation in &found {
        let variants =
            if plan.is_ablation { format!(" [{}]", explanation.variants.join("; ")) } else { String::new() };
        text.push_str(&format!("{}{variants}: {}\n", options.node, explanation.lines[0]));
        explanation.lines[1..].iter().for_each(|line| text.push_str(&format!("  {line}\n")));
    }
    print(&text)?;
    Ok(0)
}
