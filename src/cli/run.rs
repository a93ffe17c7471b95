//! `photocurrent run`.

use crate::args::{MergeOptions, RunOptions};
use crate::common::failed_nodes;
use crate::expect::{self, ExpectRecord, exit_code};
use crate::failure::{Done, Failure};
use crate::numbers::{human_bytes, human_seconds};
use crate::progress::watcher;
use crate::run_record::RunRecord;
use crate::runs::remember;
use crate::tables::draw;
use crate::terminal::{host_cancel, print, print_json, say};
use photocurrent_core::document::Problem;
use photocurrent_core::error::Trouble;
use photocurrent_core::{NodeError, Rows, Table, Value};
use photocurrent_engine::{End, Keep, Options, Outcome, PartEnd, Plan, Project};
use photocurrent_store::Cache;
use serde_json::json;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// The exit code of a run that was shown and not wanted: that of one that is interrupted.
const NOT_CONFIRMED: u8 = 130;

/// A run that came to its end, and where its results are.
pub struct Ran {
    /// What came of every node.
    pub outcome: Outcome,
    /// Holds the results.
    pub cache: Cache,
    /// Holds files for the user.
    pub out_dir: PathBuf,
    /// From start to end.
    pub seconds: f64,
}

/// Runs a pipeline or an ablation.
pub fn run(options: &RunOptions) -> Done {
    Ok(run_with(options, &[])?.0)
}

/// The same; gives the results as well, unless only some rows were run.
pub fn run_and_keep(options: &RunOptions) -> Result<(u8, Option<Ran>), Failure> {
    run_with(options, &[])
}

/// Joins parts and runs what is left.
pub fn merge(options: &MergeOptions) -> Done {
    let (target, running, parts) = (options.target.clone(), options.running.clone(), options.parts.clone());
    let options = RunOptions {
        target,
        running,
        force: Vec::new(),
        band_rows: None,
        rows: None,
        part: None,
        confirm: false,
        report: false,
    };
    Ok(run_with(&options, &parts)?.0)
}

fn run_with(options: &RunOptions, parts: &[PathBuf]) -> Result<(u8, Option<Ran>), Failure> {
    let (project, plan) = options.target.plan(if parts.is_empty() { "run" } else { "merge" })?;
    check_forced(options, &plan)?;
    if options.part.is_none() {
        options.target.check_out_dir()?;
    }
    if options.confirm && !crate::plan::confirm(&options.target, &plan, &options.force)? {
        say!("nothing ran");
        return Ok((NOT_CONFIRMED, None));
    }
    let cancel = stop_on_signal(None)?;
    let cache = Cache::open(&options.target.cache)?;
    let out_dir = options.target.out_dir();
    let parts = if parts.is_empty() {
        Vec::new()
    } else {
        photocurrent_engine::join(&plan, &cache, parts).map_err(refused)?
    };
    let defaults = Options::default();
    let threads = options.running.threads.map_or(defaults.threads, |threads| threads as usize);
    // The pool inside nodes; it can only fail when something made it before us, and then it works as well.
    let _ = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    let how = Options {
        threads,
        memory: options.target.memory.unwrap_or(defaults.memory),
        band_rows: options.band_rows,
        out_dir: out_dir.clone(),
        force: options.force.iter().cloned().collect(),
        keep: Keep::default(),
        parts,
    };
    let started = Instant::now();
    let watcher = watcher(&plan, options.running.progress, options.running.quiet);
    if let (Some(rows), Some(folder)) = (options.rows, &options.part) {
        let end = photocurrent_engine::run_part(&plan, &cache, &how, rows, folder, &*watcher, &cancel)
            .map_err(refused)?;
        let all = plan.rows().map_err(refused)?;
        let seconds = started.elapsed().as_secs_f64();
        return Ok((part_report(options, (rows, all), folder, end, seconds)?, None));
    }
    // Before hours are spent on what could not be put down.
    std::fs::create_dir_all(&out_dir).map_err(|error| {
        Failure::other(format!("{}: cannot make the folder: {error}; --out names another", out_dir.display()))
    })?;
    let outcome = photocurrent_engine::run(&plan, &cache, &how, &*watcher, &cancel);
    let seconds = started.elapsed().as_secs_f64();
    finish(options, &project, &plan, Ran { outcome, cache, out_dir, seconds })
}

/// Writes down what came of a run, and says it.
fn finish(
    options: &RunOptions,
    project: &Project,
    plan: &Plan,
    ran: Ran,
) -> Result<(u8, Option<Ran>), Failure> {
    let Ran { outcome, cache, out_dir, seconds } = &ran;
    let target = &options.target;
    let scores = outcome.metrics(cache);
    let pooled = scores.as_ref().map_or(&[][..], |(_, pooled)| pooled);
    let judged: Vec<ExpectRecord> = outcome.judge(pooled).iter().map(ExpectRecord::from).collect();
    let mut record = RunRecord::of(project, plan, outcome, &target.sets, &target.cache, out_dir, *seconds);
    record.expect.clone_from(&judged);
    record.save(out_dir)?;
    let (single, pooled) = scores?;
    if !single.is_empty() || !pooled.is_empty() {
        write_lines(&out_dir.join("metrics.jsonl"), &single)?;
        write_lines(&out_dir.join("metrics.pooled.jsonl"), &pooled)?;
    }
    let quiet = options.running.quiet;
    let page = options.report.then(|| crate::report::of_run(out_dir, &target.cache, quiet)).transpose()?;
    if options.running.json {
        let mut all = as_json(outcome, *seconds);
        all["expect"] = json!(judged);
        all["report"] = json!(page);
        print_json(&all)?;
    } else {
        let text = tables(project, outcome, cache, &pooled)?;
        if !text.is_empty() {
            print(&text)?;
        }
    }
    talk(options, outcome, out_dir, *seconds);
    expect::talk(&judged, outcome.is_ablation, quiet);
    if let Some(page) = page.filter(|_| !options.running.json) {
        print(&page.display().to_string())?;
    }
    let code = exit_code(outcome, &judged);
    remember(cache, project, &record, &pooled, (out_dir.as_path(), code));
    Ok((code, Some(ran)))
}

/// What came of a part.
fn part_report(
    options: &RunOptions,
    (rows, all): (Rows, Rows),
    folder: &Path,
    end: PartEnd,
    seconds: f64,
) -> Done {
    let nodes = match end {
        PartEnd::Before(outcome) => {
            failed_nodes(&outcome);
            return Ok(outcome.exit_code());
        }
        PartEnd::Complete(nodes) => nodes,
    };
    let (first, end) = (rows.start, rows.end);
    if options.running.json {
        print_json(&json!({
            "part": folder, "first_row": first, "end_row": end, "all_rows": all.end, "nodes": nodes,
            "seconds": seconds,
        }))?;
    }
    if !options.running.quiet {
        let made = if nodes.is_empty() {
            "was there already or needed nothing".into()
        } else {
            format!("has {}", nodes.join(", "))
        };
        say!("\n{}: the part of rows {first}..{end} {made} ({})", folder.display(), human_seconds(seconds));
    }
    Ok(0)
}

/// An error of a part, with the exit code that its cause has in a run.
fn refused(error: NodeError) -> Failure {
    let code = match error.trouble {
        Trouble::Usage => 2,
        Trouble::Input => 3,
        Trouble::Interrupted => 130,
        _ => 1,
    };
    Failure::Other { message: error.to_string(), code }
}

fn check_forced(options: &RunOptions, plan: &Plan) -> Result<(), Failure> {
    let problems: Vec<Problem> = options
        .force
        .iter()
        .filter(|node| plan.tasks_of(node).is_empty())
        .map(|node| {
            Problem::new(format!("--force {node}: there is no such node in this plan"))
                .did_you_mean(node, plan.node_names())
        })
        .collect();
    if problems.is_empty() { Ok(()) } else { Err(problems.into()) }
}

/// Nodes that have not come to their next step so long after a signal are left where they are.
const PATIENCE: Duration = Duration::from_millis(1500);

/// The first Ctrl-C (or SIGTERM) lets running nodes stop at their next step; a second one ends the process,
/// and so does [`PATIENCE`]: the cache survives that too. `leave` is then cleared away. Signals of a host
/// are the host's.
pub fn stop_on_signal(leave: Option<&Path>) -> Result<Arc<AtomicBool>, Failure> {
    if let Some(cancel) = host_cancel() {
        return Ok(cancel);
    }
    let flag = Arc::new(AtomicBool::new(false));
    let (cancel, leave) = (flag.clone(), leave.map(Path::to_path_buf));
    let end = move || {
        // What cannot be cleared away is no reason to stay.
        let _ = leave.as_ref().map(std::fs::remove_dir_all);
        std::process::exit(130);
    };
    ctrlc::set_handler(move || {
        if cancel.swap(true, Ordering::Relaxed) {
            end();
        }
        say!("\nstopping; what is finished stays (again to stop at once)");
        let end = end.clone();
        std::thread::spawn(move || {
            std::thread::sleep(PATIENCE);
            say!("stopped in the middle of a long step; what is finished stays in the cache");
            end();
        });
    })
    .map_err(|error| Failure::other(format!("cannot listen for Ctrl-C: {error}")))?;
    Ok(flag)
}

fn as_json(outcome: &Outcome, seconds: f64) -> serde_json::Value {
    let end = |end: End| format!("{end:?}").to_lowercase();
    let tasks = outcome.tasks.iter().map(|task| {
        json!({
            "node": task.label, "kind": task.kind, "uses": task.uses, "end": end(task.end),
            "seconds": task.seconds, "key": task.key, "outputs": task.outputs,
            "notes": task.notes, "error": task.error.as_ref().map(ToString::to_string),
            "because": task.because, "files": task.export,
        })
    });
    json!({
        "executed": outcome.count(End::Executed), "reused": outcome.count(End::Reused),
        "failed": outcome.count(End::Failed),
        "skipped": outcome.count(End::Skipped), "interrupted": outcome.count(End::Interrupted),
        "seconds": seconds,
        "variants": outcome.variants.iter().map(|v| v.name.clone()).collect::<Vec<_>>(),
        "warnings": outcome.warnings,
        "left_out": outcome.variants.iter().flat_map(|v| &v.left_out).map(|l| json!({ "node": l.node,
        "missing": l.missing, "why": l.why })).collect::<Vec<_>>(),
        "tasks": tasks.collect::<Vec<_>>(),
    })
}

/// The tables that the user asked for: those written by `write/table`, an ablation's metrics, or else every
/// pooled score.
fn tables(
    project: &Project,
    outcome: &Outcome,
    cache: &Cache,
    pooled: &[serde_json::Value],
) -> Result<String, Failure> {
    if let Some(ablation) = &project.ablation {
        return Ok(ablation_table(ablation, outcome, pooled));
    }
    let mut text = String::new();
    for variant in &outcome.variants {
        for (node, _) in &variant.nodes {
            let Some(task) = outcome.node(&variant.name, node).filter(|task| task.kind == "write/table")
            else {
                continue;
            };
            if let (Some(port), true) =
                (task.outputs.keys().next(), matches!(task.end, End::Executed | End::Reused))
                && let Some(Value::Table(table)) = outcome.value(cache, &variant.name, node, port)?
            {
                text.push_str(&drawn(&table));
                text.push('\n');
            }
        }
    }
    let measured: Vec<&serde_json::Value> = pooled.iter().filter(|line| line["missing"].is_null()).collect();
    if text.is_empty() && !measured.is_empty() {
        let cell = |line: &serde_json::Value, key: &str| line[key].as_str().unwrap_or_default().to_string();
        let value =
            |line: &serde_json::Value| line["value"].as_f64().map_or("-".into(), |v| format!("{v:.3}"));
        let mut rows = vec![["node", "metric", "value", "unit"].map(String::from).to_vec()];
        rows.extend(
            measured
                .iter()
                .map(|line| vec![cell(line, "node"), cell(line, "metric"), value(line), cell(line, "unit")]),
        );
        text = draw(&rows);
    }
    Ok(text)
}

fn drawn(table: &Table) -> String {
    let mut rows = vec![table.columns().iter().map(|(name, _)| name.clone()).collect()];
    rows.extend(
        (0..table.len())
            .map(|row| table.columns().iter().map(|(_, column)| column.cell(row)).collect::<Vec<_>>()),
    );
    draw(&rows)
}

fn ablation_table(
    ablation: &photocurrent_engine::Ablation,
    outcome: &Outcome,
    pooled: &[serde_json::Value],
) -> String {
    let names: Vec<(String, String)> = if ablation.metrics.is_empty() {
        let all: BTreeSet<(String, String)> = pooled
            .iter()
            .filter_map(|l| Some((l["node"].as_str()?.to_string(), l["metric"].as_str()?.to_string())))
            .collect();
        all.into_iter().collect()
    } else {
        ablation.metrics.clone()
    };
    let value = |variant: &str, node: &str, metric: &str| {
        pooled
            .iter()
            .find(|l| l["variant"] == variant && l["node"] == node && l["metric"] == metric)
            .and_then(|l| l["value"].as_f64())
    };
    let mut head: Vec<String> =
        ablation.axes.iter().map(|(axis, _)| axis.rsplit('.').next().unwrap_or(axis).to_string()).collect();
    for (node, metric) in &names {
        head.push(format!("{node}.{metric}"));
        if ablation.baseline.is_some() {
            head.push("gain".into());
        }
    }
    let mut rows = vec![head];
    for variant in &outcome.variants {
        let mut row: Vec<String> = variant.levels.iter().map(|(_, level)| level.clone()).collect();
        for (node, metric) in &names {
            let here = value(&variant.name, node, metric);
            let failed = !outcome.variant_is_whole(variant);
            row.push(here.map_or(if failed { "failed".into() } else { "-".into() }, |v| format!("{v:.3}")));
            if let Some(baseline) = &ablation.baseline {
                let gain = here.zip(value(baseline, node, metric)).map(|(here, there)| here - there);
                row.push(gain.map_or("-".into(), |gain| format!("{gain:+.3}")));
            }
        }
        rows.push(row);
    }
    draw(&rows)
}

/// What happened, on stderr.
fn talk(options: &RunOptions, outcome: &Outcome, out_dir: &Path, seconds: f64) {
    failed_nodes(outcome);
    if options.running.quiet {
        return;
    }
    for task in &outcome.tasks {
        task.notes.iter().for_each(|note| say!("note: {}: {note}", task.label));
    }
    for (why, nodes) in outcome.missing() {
        say!("left out: {}: {why}", nodes.join(", "));
    }
    let (executed, reused) = (outcome.count(End::Executed), outcome.count(End::Reused));
    let whole = executed + reused == outcome.tasks.len();
    let written: u64 = outcome
        .tasks
        .iter()
        .filter(|task| task.end == End::Executed)
        .map(photocurrent_engine::TaskOutcome::bytes)
        .sum();
    let took = human_seconds(seconds);
    match (executed, whole) {
        (0, true) => say!("\n0 nodes executed: all {reused} results were in the cache ({took})"),
        (_, true) => say!(
            "\n{executed} nodes executed, {reused} reused from the cache, {} stored ({took})",
            human_bytes(written)
        ),
        (_, false) => say!(
            "\n{executed} nodes executed, {reused} reused, {} failed, {} skipped, {} interrupted ({took}); \
             what is finished stays in the cache",
            outcome.count(End::Failed),
            outcome.count(End::Skipped),
            outcome.count(End::Interrupted)
        ),
    }
    if outcome
        .tasks
        .iter()
        .any(|task| task.export.is_some() && matches!(task.end, End::Executed | End::Reused))
    {
        say!("files are in {}", out_dir.display());
    }
}

/// Writes JSON Lines whole or not at all.
fn write_lines(path: &Path, lines: &[serde_json::Value]) -> Result<(), Failure> {
    let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
    crate::failure::write_whole(path, text.as_bytes())
}
