//! The stages of `photocurrent diagnose` as the graph that they are: `pipelines/diagnose/recording.toml` with
//! this recording, this description and this seed in it.

use super::given::Given;
use crate::args::DiagnoseOptions;
use crate::common::failed_nodes;
use crate::failure::{Failure, usage};
use crate::progress::watcher;
use crate::run::stop_on_signal;
use photocurrent_core::{Digest, Node, Sensor};
use photocurrent_engine::{End, Options, Outcome, Plan, Selection};
use photocurrent_nodes::diagnose::target::{DiagnoseTarget, Params as TargetParams};
use photocurrent_store::Cache;
use std::path::{Path, PathBuf};

/// How the stages are wired; there is no other place.
const WIRING: &str = include_str!("../../../pipelines/diagnose/recording.toml");

/// The node that writes the files.
const ANSWER: &str = "answer";

/// The nodes that hold the recording against its description.
const STAGES: [&str; 3] = ["integrity", "evidence", "confirm"];

/// What came of it.
pub struct Answered {
    /// Where the files of the report are.
    pub files: PathBuf,
    /// What nodes had to say, with who said it.
    pub notes: Vec<(String, String)>,
    /// What has not gone well, though not so badly that there is no answer.
    pub warnings: Vec<String>,
}

/// Runs the stages in `folder`, which is empty and goes away afterwards; the exit code when they did not come
/// to an end, which was reported.
pub fn run(
    options: &DiagnoseOptions,
    given: &Given,
    sensor: &Sensor,
    folder: &Path,
) -> Result<Result<Answered, u8>, Failure> {
    let plan = plan(options, given, sensor, folder)?;
    let cancel = stop_on_signal(Some(folder))?;
    // An answer does not hang on what is kept of it.
    let mut warnings = Vec::new();
    let cache = Cache::open(&options.cache).or_else(|error| {
        warnings.push(format!("nothing is kept for later runs: {error}"));
        Cache::open(&folder.join("cache"))
    })?;
    let defaults = Options::default();
    let threads = options.threads.map_or(defaults.threads, |threads| threads as usize);
    // The pool inside nodes; it can only fail when something made it before us, and then it works as well.
    let _ = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    let out_dir = folder.join("out");
    let how = Options {
        threads,
        memory: options.memory.unwrap_or(defaults.memory),
        out_dir: out_dir.clone(),
        ..defaults
    };
    let outcome = photocurrent_engine::run(
        &plan,
        &cache,
        &how,
        &*watcher(&plan, options.progress, options.quiet),
        &cancel,
    );
    if outcome.exit_code() != 0 {
        failed_nodes(&outcome);
        return Ok(Err(outcome.exit_code()));
    }
    let notes = notes(&outcome);
    warnings.extend(outcome.warnings);
    Ok(Ok(Answered { files: out_dir.join(ANSWER), notes, warnings }))
}

fn notes(outcome: &Outcome) -> Vec<(String, String)> {
    let ended = outcome.tasks.iter().filter(|task| matches!(task.end, End::Executed | End::Reused));
    ended.flat_map(|task| task.notes.iter().map(|note| (task.label.clone(), note.clone()))).collect()
}

/// The wiring, and what is laid over it, as files in `folder`; planned.
fn plan(options: &DiagnoseOptions, given: &Given, sensor: &Sensor, folder: &Path) -> Result<Plan, Failure> {
    let write = |name: &str, text: &str| {
        let path = folder.join(name);
        std::fs::write(&path, text)
            .map_err(|error| Failure::other(format!("{}: cannot write: {error}", path.display())))
            .map(|()| path)
    };
    write("wiring.toml", WIRING)?;
    let manifest = write("diagnosis.toml", &manifest(options, given, sensor)?)?;
    let selection = Selection { to: vec![ANSWER.into()], memory: options.memory, ..Selection::default() };
    let (_, mut plan) = Plan::load(&manifest, &[], &photocurrent_nodes::catalogue(), &selection)?;
    // The folder is another one each time, and the cache's history goes by what is diagnosed.
    plan.manifest_id =
        Digest::of_bytes(format!("diagnosis of {}", whole(given.path())?.display()).as_bytes());
    Ok(plan)
}

/// What is laid over the wiring.
fn manifest(options: &DiagnoseOptions, given: &Given, sensor: &Sensor) -> Result<String, Failure> {
    let mut all = toml::Table::new();
    let mut put = |path: &str, value: toml::Value| lay(&mut all, path, value);
    put("format", 1.into());
    put("extends", "wiring.toml".into());
    put("pipeline.seed", (options.seed as i64).into());
    put("nodes.recording.kind", given.kind.as_str().into());
    let failed =
        |why: String| Failure::other(format!("the manifest of the diagnosis cannot be written: {why}"));
    for (name, value) in toml::Table::try_from(&given.all).map_err(|why| failed(why.to_string()))? {
        put(&format!("nodes.recording.params.{name}"), value);
    }
    for (name, place) in [
        ("path", Some(&given.all.path)),
        ("frames", given.all.frames.as_ref()),
        ("stamps", given.all.stamps.as_ref()),
    ] {
        if let Some(place) = place {
            put(&format!("nodes.recording.params.{name}"), quoted(place.path())?);
        }
    }
    put("nodes.answer.params.recording", file_name(given.path()).into());
    if let Some(sensor) = &given.sensor {
        put("nodes.answer.params.description", file_name(sensor).into());
    }
    // A description knows the row time of frames that do not state it.
    if let Some(row_time) = sensor.frames.row_time.filter(|_| given.all.row_time.is_none()) {
        put("nodes.recording.params.row_time", row_time.to_string().into());
    }
    if let Some(sensor) = &given.sensor {
        put("nodes.sensor.kind", "read/sensor".into());
        put("nodes.sensor.params.path", quoted(sensor)?);
        if !given.change.is_empty() {
            put(
                "nodes.sensor.params.change",
                toml::Value::try_from(&given.change).map_err(|why| failed(why.to_string()))?,
            );
        }
        STAGES.iter().for_each(|stage| put(&format!("nodes.{stage}.in.sensor"), "sensor".into()));
    }
    if let Some(scene) = &options.scene {
        put("nodes.target.kind", "diagnose/target".into());
        let sensor = if given.sensor.is_some() { "sensor" } else { "recording.sensor" };
        [("events", "recording.events"), ("frames", "recording.frames"), ("sensor", sensor)]
            .into_iter()
            .for_each(|(port, from)| put(&format!("nodes.target.in.{port}"), from.into()));
        put("nodes.target.params", target(scene)?.into());
        put("nodes.evidence.in.target", "target.target".into());
    }
    if options.direct {
        put("nodes.evidence.params.scene", "none".into());
        put("nodes.confirm.params.proof", false.into());
    }
    toml::to_string(&all).map_err(|why| failed(why.to_string()))
}

/// Puts a value at a path of tables, which are made.
fn lay(table: &mut toml::Table, path: &str, value: toml::Value) {
    match path.split_once('.') {
        None => drop(table.insert(path.to_owned(), value)),
        Some((first, rest)) => {
            let inner = table.entry(first).or_insert_with(|| toml::Table::new().into());
            if let toml::Value::Table(inner) = inner {
                lay(inner, rest, value);
            }
        }
    }
}

/// The parameters of a known target, from its file.
fn target(path: &Path) -> Result<toml::Table, Failure> {
    let name = path.display();
    let text = std::fs::read_to_string(path)
        .map_err(|error| usage(format!("{name}: cannot read the scene: {error}")))?;
    let params: toml::Table = text.parse().map_err(|why| usage(format!("{name}: this is no TOML: {why}")))?;
    let hint = "hint: `photocurrent nodes diagnose/target` lists the parameters";
    let known =
        serde_json::to_value(TargetParams::default()).map_err(|why| Failure::other(why.to_string()))?;
    if let Some(key) = unknown(&params, &known) {
        let line = text
            .lines()
            .position(|line| line.contains(key.rsplit('.').next().unwrap_or_default()))
            .map_or(1, |line| line + 1);
        return Err(usage(format!("{name}:{line}: `{key}` is no parameter of a known target\n  {hint}")));
    }
    let parsed: TargetParams =
        toml::from_str(&text).map_err(|why| usage(format!("{name}: {why}\n  {hint}")))?;
    DiagnoseTarget::build(parsed).map_err(|why| usage(format!("{name}: {why}")))?;
    Ok(params)
}

/// The first key of a table that is none of what is known; what is free is named by whoever writes it.
fn unknown(table: &toml::Table, known: &serde_json::Value) -> Option<String> {
    table.iter().find_map(|(key, value)| match (value, known.get(key)) {
        (_, None) => Some(key.clone()),
        (toml::Value::Table(inner), Some(known)) if key != "free" => {
            unknown(inner, known).map(|inner| format!("{key}.{inner}"))
        }
        _ => None,
    })
}

/// The last part of a path, for people.
pub fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// A path as a manifest takes it, from the root: paths in it start from where it lies.
fn quoted(path: &Path) -> Result<toml::Value, Failure> {
    let path = whole(path)?;
    let text = path.to_str().ok_or_else(|| {
        Failure::other(format!("{}: the path is not UTF-8, as a manifest is", path.display()))
    })?;
    Ok(toml::Value::from(text))
}

fn whole(path: &Path) -> Result<PathBuf, Failure> {
    std::path::absolute(path).map_err(|error| Failure::other(format!("{}: {error}", path.display())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_with_anything_in_it_is_read_back_as_it_is() {
        let path = Path::new("/some where/\"quoted\" \\ and\tmore/scene.h5");
        let text = format!("path = {}", quoted(path).ok().unwrap());
        let table: toml::Table = text.parse().unwrap();
        assert_eq!(table["path"].as_str(), path.to_str());
        // From wherever the manifest lies it is the same file.
        let relative: toml::Table =
            format!("path = {}", quoted(Path::new("scene.h5")).ok().unwrap()).parse().unwrap();
        assert_eq!(
            Path::new(relative["path"].as_str().unwrap()),
            std::env::current_dir().unwrap().join("scene.h5")
        );
    }

    #[test]
    fn the_wiring_has_the_nodes_that_are_laid_over() {
        let wiring: toml::Table = WIRING.parse().unwrap();
        let nodes = wiring["nodes"].as_table().unwrap();
        for name in STAGES.into_iter().chain(["recording", ANSWER]) {
            assert!(nodes.contains_key(name), "{name}");
        }
        for stage in STAGES {
            assert_eq!(nodes[stage]["in"]["sensor"].as_str(), Some("recording.sensor"), "{stage}");
        }
    }
}
