//! `photocurrent runs`: the past runs of a manifest in one table. Every run adds a line to a log in the
//! cache; nothing in it enters a key, and no node reads it.

use crate::args::RunsOptions;
use crate::expect::ExpectRecord;
use crate::failure::{Done, Failure, usage};
use crate::file_kind::need_manifest;
use crate::numbers::{human_seconds, print_count};
use crate::run_record::RunRecord;
use crate::tables::draw;
use crate::terminal::{print, print_json, say};
use photocurrent_core::Digest;
use photocurrent_engine::{End, Project, Verdict, manifest_id};
use photocurrent_store::Cache;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// A line of the log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Line {
    /// When it ended, seconds since 1970.
    unix_s: u64,
    /// Version of the program.
    version: String,
    /// What was laid over the manifest.
    sets: Vec<String>,
    /// Where its files went.
    out: PathBuf,
    seconds: f64,
    executed: usize,
    reused: usize,
    code: u8,
    /// Parameters that differ from their defaults, `solve.cis_weight`; none in an ablation, whose variants
    /// differ in them.
    params: BTreeMap<String, String>,
    /// Bounds on scores that do not hold.
    broken: usize,
    /// Pooled scores.
    scores: Vec<Score>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Score {
    variant: String,
    node: String,
    metric: String,
    value: Option<f64>,
    unit: String,
}

fn log(cache: &Path, manifest: &Digest) -> PathBuf {
    cache.join("runs").join(format!("{manifest}.jsonl"))
}

/// Adds a run to the log. A log that cannot be written is no reason to fail: it is reported.
pub fn remember(
    cache: &Cache,
    project: &Project,
    record: &RunRecord,
    pooled: &[Value],
    (out, code): (&Path, u8),
) {
    let text = |line: &Value, key: &str| line[key].as_str().unwrap_or_default().to_string();
    let score = |line: &Value| Score {
        variant: text(line, "variant"),
        node: text(line, "node"),
        metric: text(line, "metric"),
        value: line["value"].as_f64(),
        unit: text(line, "unit"),
    };
    let count = |end: End| record.tasks.iter().filter(|task| task.end == end).count();
    let changed = record.tasks.iter().filter(|_| record.variants.len() == 1).flat_map(|task| {
        let of = |changed: &String| {
            let (name, value) = changed.split_once(" = ")?;
            Some((format!("{}.{name}", task.label), value.to_string()))
        };
        task.changed.iter().filter_map(of)
    });
    let is_broken = |judged: &&ExpectRecord| judged.verdict == Verdict::Fail;
    let line = Line {
        unix_s: SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs()),
        version: record.version.clone(),
        sets: record.sets.clone(),
        out: out.into(),
        seconds: record.seconds,
        executed: count(End::Executed),
        reused: count(End::Reused),
        code,
        params: changed.collect(),
        broken: record.expect.iter().filter(is_broken).count(),
        scores: pooled.iter().filter(|line| line["metric"].is_string()).map(score).collect(),
    };
    let path = log(cache.root(), &project.manifest_id);
    if let Err(error) = append(&path, &line) {
        say!("warning: {}: cannot add this run: {error}", path.display());
    }
}

/// In one piece, so that two runs at once do not mix their lines.
fn append(path: &Path, line: &Line) -> std::io::Result<()> {
    std::fs::create_dir_all(path.parent().unwrap_or(Path::new(".")))?;
    let mut file = std::fs::OpenOptions::new().create(true).append(true).open(path)?;
    file.write_all(format!("{}\n", serde_json::to_string(line)?).as_bytes())
}

/// Prints the past runs of a manifest, the last one at the bottom.
pub fn runs(options: &RunsOptions) -> Done {
    need_manifest(&options.manifest, "runs")?;
    let path = log(&options.cache, &manifest_id(&options.manifest));
    let text = match std::fs::read_to_string(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            return Err(usage(format!(
                "{}: no run of it is known to the cache {}\n  hint: `photocurrent run` adds one; a manifest \
                 that was moved begins anew; --cache names another cache",
                options.manifest.display(),
                options.cache.display()
            )));
        }
        Err(error) => return Err(Failure::other(format!("{}: cannot read: {error}", path.display()))),
    };
    let read: Vec<Option<Line>> = text.lines().map(|line| serde_json::from_str(line).ok()).collect();
    let unread = read.iter().filter(|line| line.is_none()).count();
    let lines: Vec<Line> = read.into_iter().flatten().collect();
    let first = lines.len().saturating_sub(options.last as usize);
    if options.json {
        print_json(&json!(lines[first..]))?;
        return Ok(0);
    }
    let columns = columns(&lines[first..], &options.metric)?;
    let mut rows = vec![head(&columns)];
    for at in first..lines.len() {
        let before = at.checked_sub(1).map(|before| &lines[before]);
        rows.extend(cells(&lines[at], before, &columns));
    }
    print(&draw(&rows))?;
    if first > 0 {
        say!("{} before them: --last {} shows all", print_count(first, "run"), lines.len());
    }
    if unread > 0 {
        say!("note: {} of {} cannot be read", print_count(unread, "line"), path.display());
    }
    Ok(0)
}

/// Node and metric of each column, in the order in which they come up.
fn columns(lines: &[Line], wanted: &[String]) -> Result<Vec<(String, String)>, Failure> {
    let mut columns: Vec<(String, String)> = Vec::new();
    for score in lines.iter().flat_map(|line| &line.scores) {
        let column = (score.node.clone(), score.metric.clone());
        if !columns.contains(&column) {
            columns.push(column);
        }
    }
    let is_wanted = |(node, metric): &(String, String), name: &String| {
        *name == *metric || *name == format!("{node}.{metric}")
    };
    if let Some(name) = wanted.iter().find(|name| !columns.iter().any(|column| is_wanted(column, name))) {
        let known: Vec<String> = columns.iter().map(|(node, metric)| format!("{node}.{metric}")).collect();
        let known = if known.is_empty() { "none".into() } else { known.join(", ") };
        return Err(usage(format!("--metric {name}: no run has such a score\n  hint: there are: {known}")));
    }
    columns.retain(|column| wanted.is_empty() || wanted.iter().any(|name| is_wanted(column, name)));
    Ok(columns)
}

fn head(columns: &[(String, String)]) -> Vec<String> {
    let scores = columns.iter().map(|(node, metric)| format!("{node}.{metric}"));
    let before = ["ended (UTC)", "variant", "set, changed since the run before"].map(String::from);
    let after = ["took", "executed", "reused", "exit code"].map(String::from);
    before.into_iter().chain(scores).chain(after).collect()
}

/// A row for each variant of a run.
fn cells(line: &Line, before: Option<&Line>, columns: &[(String, String)]) -> Vec<Vec<String>> {
    let mut variants: Vec<&str> = line.scores.iter().map(|score| score.variant.as_str()).collect();
    variants.dedup();
    if variants.is_empty() {
        variants.push("");
    }
    let row = |variant: &str| {
        let score = |(node, metric): &(String, String)| {
            let of =
                |score: &&Score| score.variant == variant && score.node == *node && score.metric == *metric;
            let found = line.scores.iter().find(of).and_then(|score| score.value);
            found.map_or("-".into(), |value| format!("{value:.3}"))
        };
        let code = match line.broken {
            0 => line.code.to_string(),
            broken => format!("{}, {} broken", line.code, print_count(broken, "bound")),
        };
        let ended = [date(line.unix_s), variant.to_string(), changes(line, before)];
        let counts = [line.executed.to_string(), line.reused.to_string(), code];
        let took = std::iter::once(human_seconds(line.seconds));
        ended.into_iter().chain(columns.iter().map(score)).chain(took).chain(counts).collect()
    };
    variants.into_iter().map(row).collect()
}

/// What was laid over the manifest, and which parameters are others than in the run before.
fn changes(line: &Line, before: Option<&Line>) -> String {
    let mut all: Vec<String> = line.sets.iter().map(|set| format!("--set {set}")).collect();
    let Some(before) = before else { return all.join("; ") };
    let names = before.params.keys().chain(line.params.keys());
    let names: std::collections::BTreeSet<&String> = names.collect();
    for name in names {
        let value = |line: &Line| line.params.get(name).cloned().unwrap_or_else(|| "default".into());
        if value(before) != value(line) {
            all.push(format!("{name} {} -> {}", value(before), value(line)));
        }
    }
    all.join("; ")
}

/// `2025-01-31 13:05`, UTC.
fn date(unix_s: u64) -> String {
    let (days, minutes) = (unix_s / 86_400, unix_s % 86_400 / 60);
    // Days from the first of March of year 0 on, in cycles of 400 years: civil_from_days of Hinnant,
    // "chrono-Compatible Low-Level Date Algorithms".
    let days = days + 719_468;
    let (cycle, day) = (days / 146_097, days % 146_097);
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let day = day - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = year + 400 * cycle + u64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02} {:02}:{:02}", minutes / 60, minutes % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Expected by `date -u -d @SECONDS`.
    #[test]
    fn dates_are_those_of_the_calendar() {
        let expected = [
            (0, "1970-01-01 00:00"),
            (951_782_399, "2000-02-28 23:59"),
            (951_782_400, "2000-02-29 00:00"),
            (1_709_208_000, "2024-02-29 12:00"),
            (1_735_689_599, "2024-12-31 23:59"),
            (4_107_542_400, "2100-03-01 00:00"),
        ];
        expected.iter().for_each(|(seconds, text)| assert_eq!(date(*seconds), *text));
    }
}
