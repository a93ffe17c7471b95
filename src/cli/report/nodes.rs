//! Graphs with times and states, what nodes said, failures, and where the numbers come from.

use super::run::Run;
use crate::expect::ExpectRecord;
use crate::numbers::{human_bytes, human_seconds, print_count};
use crate::run_record::{TaskRecord, VariantRecord};
use photocurrent_core::context::LOSS;
use photocurrent_engine::graph::{Drawing, Edge, Node};
use photocurrent_engine::{End, Verdict};
use photocurrent_page::{BoundMark, BoundRow, Graph, Hazard, NodeRow, RunPage, escaped};

/// Letters of a key that are shown: enough to find it in the cache.
const KEY: usize = 12;

/// Adds all of it.
pub fn describe(runs: &[Run], page: &mut RunPage) {
    for run in runs {
        let record = &run.record;
        let several = runs.len() > 1;
        page.about.extend(
            record
                .about
                .as_ref()
                .map(|about| if several { format!("{}: {about}", run.name) } else { about.clone() }),
        );
        let count = |end: End| record.tasks.iter().filter(|task| task.end == end).count();
        let not_well = record.tasks.len() - count(End::Executed) - count(End::Reused);
        let name = |what: &str| if several { format!("{}, {what}", run.name) } else { what.to_string() };
        page.facts.push((
            name("run"),
            format!(
                "{} executed, {} from the cache{}, in {}",
                print_count(count(End::Executed), "node"),
                count(End::Reused),
                if not_well > 0 {
                    format!(", {not_well} failed, skipped or interrupted")
                } else {
                    String::new()
                },
                human_seconds(record.seconds)
            ),
        ));
        if !record.axes.is_empty() {
            let axes: Vec<String> =
                record.axes.iter().map(|(axis, levels)| format!("{axis} ({})", levels.join(", "))).collect();
            page.facts.push((
                name("ablation"),
                format!("{}: {}", print_count(record.variants.len(), "variant"), axes.join("; ")),
            ));
        }
        for task in &record.tasks {
            match task.end {
                End::Failed => page.failures.push(format!(
                    "{} ({}) failed: {}",
                    task.label,
                    task.kind,
                    task.error.as_deref().unwrap_or("without a reason")
                )),
                End::Skipped => page.failures.push(format!(
                    "{} was skipped: it needs {}",
                    task.label,
                    task.because.join(", ")
                )),
                End::Interrupted => page.failures.push(format!("{} was interrupted", task.label)),
                End::Executed | End::Reused => {}
            }
        }
        let broken = record.expect.iter().filter(|judged| judged.verdict == Verdict::Fail);
        page.failures.extend(broken.filter_map(|judged| judged.complaint(!record.axes.is_empty())));
        page.bounds.extend(bounds(run, several));
        page.graphs.extend(run.variants().next().map(|variant| graph(run, variant)));
        page.hazards.extend(hazards(run));
        page.diagnosis += &diagnoses(run);
        provenance(run, &name, page);
    }
}

fn state(task: &TaskRecord) -> String {
    let time = human_seconds(task.seconds);
    match task.end {
        End::Executed => format!("ran {time}"),
        End::Reused => format!("cached, once {time}"),
        other => other.name().into(),
    }
}

/// Every bound of the variants that are shown; what is broken comes first.
fn bounds(run: &Run, several: bool) -> Vec<BoundRow> {
    let record = &run.record;
    let is_shown = |judged: &&ExpectRecord| run.variants().any(|variant| variant.name == judged.variant);
    let mut shown: Vec<&ExpectRecord> = record.expect.iter().filter(is_shown).collect();
    shown.sort_by_key(|judged| std::cmp::Reverse(judged.verdict));
    let row = |judged: &ExpectRecord| {
        let name = judged.name(!record.axes.is_empty());
        let mark = match judged.verdict {
            Verdict::Pass => BoundMark::Pass,
            Verdict::Warn => BoundMark::Warn,
            Verdict::Fail => BoundMark::Fail,
            Verdict::Unchecked => BoundMark::Unchecked,
        };
        BoundRow {
            name: if several { format!("{}, {name}", run.name) } else { name },
            measured: judged.measured(),
            bound: judged.bound(),
            warning: judged.warning(),
            mark,
        }
    };
    shown.into_iter().map(row).collect()
}

/// How the bounds of a node came out; `None` where it has none.
fn worst_verdict(run: &Run, variant: &VariantRecord, node: &str) -> Option<Verdict> {
    let of = run.record.expect.iter().filter(|judged| judged.variant == variant.name && judged.node == node);
    of.map(|judged| judged.verdict).max()
}

fn graph(run: &Run, variant: &VariantRecord) -> Graph {
    let tasks: Vec<(usize, &TaskRecord)> = run.tasks(variant).collect();
    let worst = |name: &str| worst_verdict(run, variant, name);
    let is_broken = |name: &str| worst(name) == Some(Verdict::Fail);
    let bounds_of = |name: &str| match worst(name) {
        Some(Verdict::Fail) => "out of bounds, ",
        Some(Verdict::Warn) => "near its bound, ",
        Some(Verdict::Pass) => "in bounds, ",
        Some(Verdict::Unchecked) | None => "",
    };
    let place = |task: usize| tasks.iter().position(|(at, _)| *at == task);
    let node = |(name, _): &(String, usize), (_, task): &(usize, &TaskRecord)| Node {
        id: name.clone(),
        kind: task.kind.clone(),
        note: format!("{}{}", bounds_of(name), state(task)),
        state: [task.end.name(), if is_broken(name) { " broken" } else { "" }].concat(),
    };
    let edges = tasks.iter().enumerate().flat_map(|(to, (_, task))| {
        task.inputs.iter().flat_map(move |input| {
            let edge = |(from, port): (usize, String)| {
                Some(Edge {
                    from: place(from)?,
                    from_port: port,
                    to,
                    to_port: input.port.clone(),
                    data_type: input.data_type.clone(),
                })
            };
            let whole = input
                .from
                .iter()
                .enumerate()
                .filter(|(value, _)| !input.joined.iter().any(|part| part.value == *value))
                .map(|(_, from)| from.clone());
            let parts = input.joined.iter().map(|part| (part.task, part.port.clone()));
            whole.chain(parts).filter_map(edge).collect::<Vec<_>>()
        })
    });
    let title = if run.record.variants.len() > 1 {
        format!("{}, {}", run.name, variant.name)
    } else {
        run.name.clone()
    };
    let drawing = Drawing {
        title: title.clone(),
        nodes: variant.nodes.iter().zip(&tasks).map(|(name, task)| node(name, task)).collect(),
        edges: edges.collect(),
    };
    let row = |task: &TaskRecord| NodeRow {
        name: task.label.clone(),
        kind: task.kind.clone(),
        end: task.end.name().into(),
        time: human_seconds(task.seconds),
        size: human_bytes(task.outputs.values().map(|output| output.bytes).sum()),
        key: task.key.map(|key| key.to_string().chars().take(KEY).collect()).unwrap_or_default(),
        changed: task.changed.join(", "),
    };
    Graph { name: title, svg: drawing.svg(), nodes: run.record.tasks.iter().map(row).collect() }
}

fn hazards(run: &Run) -> Vec<Hazard> {
    let record = &run.record;
    let mut all: Vec<Hazard> = record
        .warnings
        .iter()
        .map(|text| Hazard { at: run.name.clone(), text: text.clone(), is_serious: true })
        .collect();
    for variant in run.variants() {
        all.extend(variant.left_out.iter().map(|(node, why)| Hazard {
            at: node.clone(),
            text: format!("left out: {why}"),
            is_serious: true,
        }));
    }
    for task in &record.tasks {
        all.extend(task.notes.iter().map(|text| Hazard {
            at: task.label.clone(),
            text: text.clone(),
            is_serious: text.starts_with(LOSS),
        }));
    }
    let mut unique: Vec<Hazard> = Vec::new();
    all.into_iter().for_each(|hazard| {
        if !unique.contains(&hazard) {
            unique.push(hazard);
        }
    });
    let files: Vec<&str> = record
        .tasks
        .iter()
        .filter(|task| task.kind.starts_with("read/") && task.kind != "read/sensor")
        .filter_map(|task| task.params["path"].as_str())
        .collect();
    unique.extend(files.into_iter().map(|file| Hazard {
        at: file_name(file),
        text: "`photocurrent inspect FILE` looks for hazards in the recording itself".into(),
        is_serious: false,
    }));
    unique
}

/// The manifest as it was named, without folders of a machine.
fn manifest(run: &Run) -> String {
    if run.record.manifest.starts_with('/') {
        file_name(&run.record.manifest)
    } else {
        run.record.manifest.clone()
    }
}

/// The last part of a path.
fn file_name(path: &str) -> String {
    std::path::Path::new(path)
        .file_name()
        .map_or_else(|| path.into(), |name| name.to_string_lossy().into_owned())
}

/// Diagnoses that were part of the run, with links to their own pages.
fn diagnoses(run: &Run) -> String {
    let mut html = String::new();
    for task in run.record.tasks.iter().filter(|task| task.kind == "write/diagnosis") {
        let Some(folder) = &task.files else { continue };
        let text = std::fs::read_to_string(run.folder.join(folder).join("diagnosis.json"));
        let Some(report) = text
            .ok()
            .and_then(|text| serde_json::from_str::<photocurrent_diagnosis::report::Report>(&text).ok())
        else {
            continue;
        };
        let page = escaped(&folder.join("report.html").to_string_lossy());
        html +=
            &format!("<h3>{}</h3>\n{}", escaped(&task.label), photocurrent_diagnosis::page::section(&report));
        html +=
            &format!("<p class=\"note\">With pictures, in the folder of the run: <code>{page}</code></p>\n");
    }
    html
}

fn provenance(run: &Run, name: &dyn Fn(&str) -> String, page: &mut RunPage) {
    let record = &run.record;
    let sets: String = record.sets.iter().map(|set| format!(" --set '{set}'")).collect();
    page.provenance.push((name("command"), format!("photocurrent run {}{sets}", manifest(run))));
    page.provenance.push((name("program"), format!("photocurrent {}", record.version)));
    page.provenance.push((name("seed"), record.seed.to_string()));
    for task in record.tasks.iter().filter(|task| task.kind.starts_with("read/")) {
        let Some(path) = task.params["path"].as_str() else { continue };
        let content: Vec<String> =
            task.outputs.iter().map(|(port, output)| format!("{port} {}", output.digest)).collect();
        // A page is passed on: it names files, and no folders of a machine.
        let path = file_name(path);
        page.provenance
            .push((name(&task.label), format!("{path}; content (BLAKE3): {}", content.join(", "))));
    }
}
