//! A manifest as written: a TOML file whose outline is checked and whose every key still knows its line.
//!
//! What is checked here needs no knowledge of nodes: which tables there are, which keys they may have, what a
//! node may be called. Whether a kind exists, takes these parameters and fits its neighbours is for `typed`.
//! A mistake never stops the reading: it is noted, the node it stands in is left out of later checks, and the
//! rest goes on, so that one run shows every mistake.

use crate::blocks::Blocks;
use crate::expect;
use crate::overlay::{node_names, overlay};
use photocurrent_core::document::{self, Item, Key, Origin, Problem, Source, Table, Tree};
use photocurrent_core::{Catalogue, error, schema};
use serde_json::{Value as Json, json};
use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

/// The manifest format that this version reads and writes.
pub(crate) const FORMAT: i64 = 1;

/// One manifest, as written, with everything it extends merged below it.
#[derive(Default)]
pub(crate) struct Manifest<'a> {
    /// The merged document, without `format` and `extends`.
    pub table: Table,
    /// Every mistake found so far.
    pub problems: Vec<Problem>,
    /// Nodes that have a mistake: later checks pass over them.
    pub broken: BTreeSet<String>,
    /// The beginning of the manifest that was asked for: the place of what is nowhere in it.
    pub start: Option<Origin>,
    /// Does it extend another one?
    pub extends: bool,
    /// It and what it extends, in the order in which they were read.
    pub files: Vec<ManifestFile>,
    /// The kinds, to say of a stray key that it is a parameter.
    catalogue: Option<&'a Catalogue>,
}

/// A file that a manifest consists of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ManifestFile {
    /// Where it is.
    pub path: PathBuf,
    /// Does the manifest that it belongs to name it by an absolute path?
    pub is_absolute: bool,
}

/// Reads a manifest and, below it, what it extends.
pub(crate) fn read<'a>(path: &Path, catalogue: &'a Catalogue) -> Manifest<'a> {
    let mut manifest = Manifest { catalogue: Some(catalogue), ..Manifest::default() };
    read_chain(path, None, &mut Vec::new(), &mut manifest);
    manifest
}

fn read_chain(path: &Path, asked_by: Option<&Origin>, chain: &mut Vec<PathBuf>, manifest: &mut Manifest) {
    let problem = |message: String| {
        asked_by.map_or_else(|| Problem::new(message.clone()), |origin| Problem::at(origin, message.clone()))
    };
    let shown = shorten(path);
    let bytes = match std::fs::read(path) {
        Ok(bytes) => bytes,
        Err(error) => {
            let from = if asked_by.is_some() {
                "paths are relative to the manifest that names them"
            } else {
                "check the path: it is relative to the current folder"
            };
            return manifest.problems.push(problem(error::cannot_read(&shown, &error)).help(from));
        }
    };
    let text = match String::from_utf8(bytes) {
        Ok(text) => text,
        Err(error) => return manifest.problems.push(not_utf8(&shown, &error)),
    };
    let canonical = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    if chain.contains(&canonical) {
        return manifest.problems.push(
            problem(format!("{} extends itself", shown.display()))
                .label("leads back to a manifest that is being read"),
        );
    }
    chain.push(canonical);
    manifest
        .files
        .push(ManifestFile { path: path.to_path_buf(), is_absolute: asked_by.is_some_and(is_absolute) });
    let folder = shown.parent().map(Path::to_path_buf).unwrap_or_default();
    let source = Source::new(shown.display().to_string(), folder.clone(), text);
    manifest.start.get_or_insert_with(|| Origin { source: source.clone(), span: 0..0 });
    let mut table = match document::parse(&source) {
        Ok(table) => table,
        Err(problems) => return manifest.problems.extend(problems),
    };
    check_format(&table, &source, &mut manifest.problems);
    check_outline(&mut table, &source, manifest);
    table.remove("format");
    if let Some((_, tree)) = table.remove("extends")
        && let Some(base) = tree.as_str()
    {
        manifest.extends = true;
        read_chain(&folder.join(base), Some(&tree.origin), chain, manifest);
    }
    overlay(&mut manifest.table, &table);
}

/// Is an absolute path written here, as a text in quotes or in a list of them?
pub(crate) fn is_absolute(written: &Origin) -> bool {
    let text = written.source.text.get(written.span.clone()).unwrap_or_default();
    text.contains("\"/") || text.contains("'/")
}

/// The place of the first byte that is no UTF-8.
fn not_utf8(shown: &Path, error: &std::string::FromUtf8Error) -> Problem {
    let start = error.utf8_error().valid_up_to();
    // The text before the bad byte stays as it is, so its place holds.
    let source = Source::new(shown.display().to_string(), "", String::from_utf8_lossy(error.as_bytes()));
    let end = start + char::REPLACEMENT_CHARACTER.len_utf8();
    let problem = Problem::at(
        &Origin { source, span: start..end },
        format!("cannot read {}: it is not text in UTF-8", shown.display()),
    );
    problem.label(format!("the byte 0x{:02x}", error.as_bytes()[start])).help("save it as UTF-8")
}

/// Takes `a/../` out of a path for display; links are not followed, as the text is for people.
fn shorten(path: &Path) -> PathBuf {
    let mut short = PathBuf::new();
    for part in path.components() {
        let last_is_name =
            short.components().next_back().is_some_and(|last| matches!(last, Component::Normal(_)));
        match part {
            Component::ParentDir if last_is_name => drop(short.pop()),
            Component::CurDir => {}
            part => short.push(part),
        }
    }
    short
}

fn check_format(table: &Table, source: &Arc<Source>, problems: &mut Vec<Problem>) {
    match table.get("format") {
        None => problems.push(
            Problem::at(&Origin { source: source.clone(), span: 0..0 }, "`format` is missing")
                .help(format!("write `format = {FORMAT}` as the first line")),
        ),
        Some(Tree { item: Item::Integer(FORMAT), .. }) => {}
        Some(Tree { item: Item::Integer(other), origin }) => {
            let problem = Problem::at(
                origin,
                format!("this manifest has format {other}, and this version reads format {FORMAT}"),
            );
            let newer = if *other > FORMAT { "use a newer photocurrent, or " } else { "" };
            problems.push(problem.help(format!("{newer}write `format = {FORMAT}`")));
        }
        // A wrong type is reported with the rest of the outline.
        Some(_) => {}
    }
}

fn object(properties: Json) -> Json {
    json!({ "type": "object", "additionalProperties": false, "properties": properties })
}

fn table_of(values: Json) -> Json {
    json!({ "type": "object", "additionalProperties": values })
}

fn list_of(items: Json) -> Json {
    json!({ "type": "array", "items": items })
}

fn text() -> Json {
    json!({ "type": "string" })
}

/// A form with what to write instead of something else.
fn such_as(mut form: Json, example: &str) -> Json {
    form["x-example"] = Json::from(example);
    form
}

/// Checks one level of the outline; takes out what has the wrong form, so that later stages see only what
/// they can read.
fn check(tree: &Tree, form: &Json, what: &str, problems: &mut Vec<Problem>) -> bool {
    let before = problems.len();
    schema::validate(tree, form, what, problems);
    problems.len() == before
}

fn check_outline(table: &mut Table, source: &Arc<Source>, manifest: &mut Manifest) {
    let any_table = || table_of(json!({}));
    let top = object(json!({
        "format": such_as(json!({ "type": "integer" }), &format!("`format = {FORMAT}`")),
        "extends": such_as(text(), "`extends = \"base.toml\"`"),
        "pipeline": such_as(any_table(), "`pipeline = { seed = 7 }`"),
        "nodes": such_as(any_table(), "`[nodes.sensor]` with `kind = \"read/sensor\"` below it"),
        "ablation": such_as(any_table(), "`[ablation.axes.front_end]` with its levels below it"),
    }));
    let root =
        Tree { item: Item::Table(table.clone()), origin: Origin { source: source.clone(), span: 0..0 } };
    check(&root, &top, "key of a manifest", &mut manifest.problems);
    table.entries.retain(|(key, tree)| match key.name.as_str() {
        "pipeline" | "nodes" | "ablation" => tree.as_table().is_some(),
        name => matches!(name, "format" | "extends"),
    });
    let point = "`{ front_end = \"off\" }`: axes with their levels";
    let level = || such_as(any_table(), "`off = { nodes.solve.params.readout = \"none\" }`");
    let ablation = object(json!({
        "about": text(), "metrics": such_as(
            list_of(text()), "`metrics = [\"psnr.psnr_db\"]`",
        ), "baseline": such_as(any_table(), point),
        "skip": such_as(
            list_of(such_as(any_table(), point)), "`skip = [{ front_end = \"off\" }]`",
        ), "axes": table_of(table_of(level())),
        "sweep": such_as(any_table(), "`[ablation.sweep]` with `\"nodes.solve.params.cis_weight\" = [0.5, \
                                       1.0]` below it"),
    }));
    if table
        .get("ablation")
        .is_some_and(|tree| !check(tree, &ablation, "key of an ablation", &mut manifest.problems))
    {
        table.remove("ablation");
    }
    check_overlay(table, manifest);
}

/// Checks that an overlay names nodes that exist, and nothing but nodes and the pipeline; notes what does
/// not.
pub(crate) fn check_targets(over: &mut Table, manifest: &mut Manifest) {
    let known: Vec<String> = node_names(&manifest.table);
    for (key, tree) in &over.entries {
        let allowed = ["nodes", "pipeline"];
        if !allowed.contains(&key.name.as_str()) {
            let problem = Problem::at(&key.origin, format!("`{}` cannot be laid over a manifest", key.name))
                .label("unknown key");
            manifest.problems.push(match known.contains(&key.name) {
                true => problem.help(format!("write `nodes.{}`: it is a node", key.name)),
                false => problem.did_you_mean(&key.name, allowed),
            });
        } else if tree.as_table().is_none() {
            manifest.problems.push(Problem::at(
                &tree.origin,
                format!("`{}` is a table, found {}", key.name, tree.describe()),
            ));
        }
    }
    over.entries
        .retain(|(key, tree)| matches!(key.name.as_str(), "nodes" | "pipeline") && tree.as_table().is_some());
    if let Some(Tree { item: Item::Table(nodes), .. }) = over.get_mut("nodes") {
        for (key, _) in nodes.entries.iter().filter(|(key, _)| !known.contains(&key.name)) {
            let problem = Problem::at(&key.origin, format!("there is no node `{}` to change", key.name))
                .label("unknown node");
            manifest.problems.push(problem.did_you_mean(&key.name, known.iter().map(String::as_str)));
        }
        nodes.entries.retain(|(key, _)| known.contains(&key.name));
    }
    check_overlay(over, manifest);
}

/// Checks what a file, a level and `--set` have in common: the tables `pipeline` and `nodes`.
fn check_overlay(table: &mut Table, manifest: &mut Manifest) {
    let seed = such_as(json!({ "type": "integer", "minimum": 0 }), "`seed = 7`");
    let keep = such_as(list_of(text()), "`keep = [\"solve.tracks\"]`");
    let pipeline = object(json!({ "about": text(), "seed": seed, "keep": keep, "blocks": Blocks::schema() }));
    if table
        .get("pipeline")
        .is_some_and(|tree| !check(tree, &pipeline, "key of a pipeline", &mut manifest.problems))
    {
        table.remove("pipeline");
    }
    if let Some(nodes) = table.get("nodes").and_then(Tree::as_table) {
        for (key, node) in &nodes.entries {
            if !check_node(key, node, manifest) {
                manifest.broken.insert(key.name.clone());
            }
        }
    }
}

fn check_node(key: &Key, node: &Tree, manifest: &mut Manifest) -> bool {
    let kind = |node: Option<&Tree>| Some(node?.as_table()?.get("kind")?.as_str()?.to_string());
    let below = manifest.table.get("nodes").and_then(Tree::as_table).and_then(|nodes| nodes.get(&key.name));
    let kind = kind(Some(node)).or(kind(below)).and_then(|kind| manifest.catalogue?.get(&kind));
    let problems = &mut manifest.problems;
    let form = such_as(
        object(json!({
            "kind": such_as(text(), "`kind = \"read/sensor\"`"),
            "in": such_as(table_of(json!({})), "`in = { events = \"scene.events\" }`"),
            "params": such_as(table_of(json!({})), "`params = { width = 64 }`"),
            "bypass": { "type": "boolean" },
            "optional": { "type": "boolean" },
            "expect": such_as(
                table_of(expect::schema()), "`expect = { psnr_db = { at_least = 35.0 } }`",
            ),
        })),
        &format!("`[nodes.{}]` with `kind = \"family/name\"` below it", key.name),
    );
    let before = problems.len();
    if !is_node_id(&key.name) {
        let problem = Problem::at(&key.origin, format!("`{}` is not a name for a node", key.name));
        problems.push(problem.help("names are small letters, digits and `_`, and begin with a letter"));
    }
    check(node, &form, "key of a node", problems);
    for (stray, value) in node.as_table().iter().flat_map(|node| &node.entries) {
        if kind.is_some_and(|kind| kind.schema["properties"].get(&stray.name).is_some())
            && let Some(problem) =
                problems[before..].iter_mut().find(|problem| problem.at.as_ref() == Some(&stray.origin))
        {
            problem.notes.clear();
            let text = &value.origin.source.text;
            let value = text
                .get(value.origin.span.clone())
                .filter(|value| value.len() <= 40 && !value.contains('\n'))
                .unwrap_or("...");
            problem.help = Some(format!(
                "it is a parameter: write it inside `params`, as in `params = {{ {} = {value} }}`",
                stray.name
            ));
        }
    }
    let ports = node.as_table().and_then(|node| node.get("in")).and_then(Tree::as_table);
    for (port, wire) in ports.iter().flat_map(|ports| &ports.entries) {
        let items = match &wire.item {
            Item::Array(items) => items.as_slice(),
            _ => std::slice::from_ref(wire),
        };
        for item in items.iter().filter(|item| item.as_str().is_none()) {
            let problem = Problem::at(
                &item.origin,
                format!("`in.{}` takes \"node.port\", found {}", port.name, item.describe()),
            );
            problems.push(
                problem
                    .label("expected a text in quotes")
                    .help(format!("such as `{} = \"scene.events\"`", port.name)),
            );
        }
    }
    problems.len() == before
}

/// Small letters, digits and `_`, a letter first: safe in paths, references and overlays.
fn is_node_id(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_lowercase())
        && name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')
}
