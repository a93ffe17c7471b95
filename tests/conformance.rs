//! Every node kind keeps the promises that all of them make: a name, a manual, an example that holds,
//! parameters with meaning and default.
//!
//! The checks run over the catalogue, so that a new kind is held to them without a line here. In addition:
//! what the command prints about the catalogue (`nodes`, `schema`, completions, help), and `docs/nodes.md`,
//! which is generated: `UPDATE_EXPECT=1 cargo test --test photocurrent conformance` writes it anew.

use crate::support::{Bench, root};
use photocurrent_core::document::{self, Item, Origin, Problem, Source, Table, Tree};
use photocurrent_core::ports::{Arity, PortSpec};
use photocurrent_core::quantity::Dimension;
use photocurrent_core::{Kind, schema};
use photocurrent_engine::Project;
use serde_json::{Value as Json, json};
use std::collections::BTreeSet;
use std::fs;

/// Calls `check` with every kind; what it complains about is reported for all kinds at once.
fn for_every_kind(check: impl Fn(&Kind, &mut Vec<String>)) {
    let mut complaints = Vec::new();
    for kind in photocurrent_nodes::catalogue().kinds() {
        let mut found = Vec::new();
        check(kind, &mut found);
        complaints.extend(found.into_iter().map(|complaint| format!("{}: {complaint}", kind.decl.kind)));
    }
    assert!(complaints.is_empty(), "\n{}\n", complaints.join("\n"));
}

fn is_snake_case(name: &str) -> bool {
    let fits = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    name.starts_with(|c: char| c.is_ascii_lowercase())
        && name.chars().all(fits)
        && !name.ends_with('_')
        && !name.contains("__")
}

/// One line that ends with a full stop, for lists and tables.
fn is_one_sentence_line(text: &str) -> bool {
    text.ends_with('.') && !text.contains('\n') && text.trim() == text && text.len() > 3
}

/// A tree of what a text says, as the engine would read it.
fn tree(name: &str, text: &str) -> Result<Tree, Vec<Problem>> {
    let source = Source::new(name, "", text);
    let table = document::parse(&source)?;
    Ok(Tree { item: Item::Table(table), origin: Origin { source, span: 0..0 } })
}

fn table_at<'t>(tree: &'t Tree, path: &[&str]) -> Option<&'t Table> {
    path.iter().try_fold(tree, |tree, name| tree.as_table()?.get(name)).and_then(Tree::as_table)
}

fn shown(problems: &[Problem]) -> String {
    problems.iter().map(|p| format!("{:?}: {}", p.at, p.message)).collect::<Vec<_>>().join("; ")
}

#[test]
fn a_kind_is_called_family_and_name() {
    for_every_kind(|kind, complaints| {
        let parts: Vec<&str> = kind.decl.kind.split('/').collect();
        if parts.len() != 2 || !parts.iter().all(|part| is_snake_case(part)) {
            complaints.push("a kind is `family/name`, both in snake_case".into());
        }
    });
}

#[test]
fn a_kind_says_what_it_does_since_when_and_by_whose_method() {
    for_every_kind(|kind, complaints| {
        if !is_one_sentence_line(kind.decl.about) {
            complaints.push(format!(
                "`about` is one line that ends with a full stop, and is {:?}",
                kind.decl.about
            ));
        }
        if kind.decl.revision < 1 {
            complaints.push("`revision` counts from 1".into());
        }
        if kind.decl.sources.is_empty() {
            complaints.push(
                "`sources` is empty: name the paper, the format or the rule that it follows; \
                             the manual prints it"
                    .into(),
            );
        }
        if kind.decl.sources.iter().any(|source| source.trim().is_empty() || source.ends_with('.')) {
            complaints.push("a source is a text without a full stop: the manual adds it".into());
        }
    });
}

#[test]
fn the_sockets_of_a_kind_have_names_and_meanings() {
    for_every_kind(|kind, complaints| {
        if kind.outputs.is_empty() {
            complaints.push("it has no output: also a writer says what it wrote".into());
        }
        for (side, ports) in [("input", &kind.inputs), ("output", &kind.outputs)] {
            for (at, port) in ports.iter().enumerate() {
                if !is_snake_case(port.name) {
                    complaints.push(format!("{side} `{}` is not in snake_case", port.name));
                }
                if !is_one_sentence_line(port.about) {
                    complaints.push(format!(
                        "{side} `{}` has one line about it that ends with a full stop, and it is {:?}",
                        port.name, port.about
                    ));
                }
                if ports[..at].iter().any(|other| other.name == port.name) {
                    complaints.push(format!("{side} `{}` stands twice", port.name));
                }
            }
        }
        if kind.outputs.iter().any(|port| port.arity == Arity::Many) {
            complaints.push("an output gives one value: the store has one place for it".into());
        }
    });
}

/// The parameters of a kind: name and schema.
fn parameters(kind: &Kind) -> Vec<(&String, &Json)> {
    kind.schema["properties"].as_object().into_iter().flatten().collect()
}

#[test]
fn every_parameter_has_a_name_a_meaning_and_a_default() {
    for_every_kind(|kind, complaints| {
        for (name, schema) in parameters(kind) {
            if !is_snake_case(name) {
                complaints.push(format!("params.{name} is not in snake_case"));
            }
            let about = schema["description"].as_str().unwrap_or_default();
            if !about.ends_with('.') {
                complaints.push(format!(
                    "params.{name} has a doc comment that ends with a full stop, and it is {about:?}"
                ));
            }
            if schema.get("default").is_none() {
                complaints.push(format!(
                    "params.{name} has no default in the schema: put #[serde(default)] on the struct"
                ));
            }
        }
        if kind.schema["required"].as_array().is_some_and(|required| !required.is_empty()) {
            complaints.push(
                "a parameter has a default or is an Option; what cannot do without is refused \
                             by `build`, with a hint"
                    .into(),
            );
        }
    });
}

/// Calls `look` with every schema inside a schema, and where it stands.
fn walk(schema: &Json, place: &str, look: &mut impl FnMut(&str, &Json)) {
    look(place, schema);
    for (name, inner) in schema.as_object().into_iter().flatten() {
        walk(inner, &format!("{place}.{name}"), look);
    }
    for (at, inner) in schema.as_array().into_iter().flatten().enumerate() {
        walk(inner, &format!("{place}.{at}"), look);
    }
}

#[test]
fn every_quantity_has_an_example_and_bounds_that_can_be_read() {
    for_every_kind(|kind, complaints| {
        walk(&kind.schema, "params", &mut |place, schema| {
            let Some(name) = schema["x-quantity"].as_str() else { return };
            let Some(dimension) = Dimension::named(name) else {
                return complaints.push(format!("{place}: there is no quantity `{name}`"));
            };
            let examples = schema["examples"].as_array().cloned().unwrap_or_default();
            if examples.is_empty() {
                complaints.push(format!("{place}: a quantity has an example"));
            }
            let bounds = ["x-min", "x-max", "default"]
                .iter()
                .filter_map(|key| schema.get(key))
                .filter(|value| !value.is_null());
            for text in examples.iter().chain(bounds) {
                if text.as_str().is_none_or(|text| dimension.read(text).is_err()) {
                    complaints.push(format!("{place}: {text} is not a {name}"));
                }
            }
        });
    });
}

#[test]
fn unknown_keys_are_refused_at_every_depth() {
    for_every_kind(|kind, complaints| {
        walk(&kind.schema, "params", &mut |place, schema| {
            if schema["properties"].is_object()
                && schema["type"] == "object"
                && schema["additionalProperties"] != false
            {
                complaints.push(format!(
                    "{place}: allows any key; put #[serde(deny_unknown_fields)] on the struct"
                ));
            }
        });
        let mut problems = Vec::new();
        let unknown = tree("params", "no_such_parameter = 1\n").expect("TOML");
        schema::validate(&unknown, &kind.schema, "parameter", &mut problems);
        if problems.len() != 1 {
            complaints.push(format!(
                "`no_such_parameter = 1` gives {} problems, and should give one",
                problems.len()
            ));
        }
    });
}

#[test]
fn the_default_parameters_stand_in_the_schema_and_survive_being_written() {
    for_every_kind(|kind, complaints| {
        let defaults: Json = parameters(kind)
            .into_iter()
            .filter(|(_, s)| s.get("default").is_some())
            .map(|(name, s)| (name.clone(), s["default"].clone()))
            .collect();
        match (kind.build(json!({})), kind.build(defaults.clone())) {
            (Ok(empty), Ok(stated)) => {
                if empty.params != stated.params || empty.params != defaults {
                    complaints.push(format!(
                        "defaults differ: {} when nothing is stated, {} in the schema",
                        empty.params, defaults
                    ));
                }
                match kind.build(empty.params.clone()) {
                    Ok(again) if again.params == empty.params => {}
                    Ok(again) => complaints
                        .push(format!("{} becomes {} when it is read again", empty.params, again.params)),
                    Err(error) => complaints.push(format!("{} cannot be read again: {error}", empty.params)),
                }
            }
            // A reader cannot do without its path: then it says which parameter is missing, and what to
            // write.
            (Err(error), Err(_)) if error.param.is_some() && error.hint.is_some() => {}
            (Err(error), _) | (_, Err(error)) => complaints
                .push(format!("the defaults do not build, and the error lacks parameter or hint: {error}")),
        }
    });
}

/// The nodes of an example that are of its kind: their names and tables.
fn own_nodes<'t>(example: &'t Tree, kind: &Kind) -> Vec<(&'t str, &'t Table)> {
    let nodes = table_at(example, &["nodes"]).into_iter().flat_map(|nodes| &nodes.entries);
    let of_kind = nodes.filter(|(_, node)| {
        node.as_table().and_then(|node| node.get("kind")).and_then(Tree::as_str) == Some(kind.decl.kind)
    });
    of_kind.filter_map(|(key, node)| Some((key.name.as_str(), node.as_table()?))).collect()
}

#[test]
fn the_example_of_a_kind_uses_it_once_and_as_it_is() {
    for_every_kind(|kind, complaints| {
        let example = match tree("example", kind.decl.example) {
            Ok(example) => example,
            Err(problems) => {
                return complaints.push(format!("the example is not TOML: {}", shown(&problems)));
            }
        };
        let own = own_nodes(&example, kind);
        let [(name, node)] = own[..] else {
            return complaints
                .push(format!("the example has {} nodes of this kind, and should have one", own.len()));
        };
        if let Some(params) = node.get("params") {
            let mut problems = Vec::new();
            schema::validate(params, &kind.schema, "parameter", &mut problems);
            if !problems.is_empty() {
                complaints.push(format!("nodes.{name}.params of the example: {}", shown(&problems)));
            } else if let Err(error) = kind.build(schema::to_json(params, &kind.schema)) {
                complaints.push(format!("nodes.{name}.params of the example: {error}"));
            }
        }
        let wired = |port: &PortSpec| {
            node.get("in").and_then(Tree::as_table).is_some_and(|wires| wires.get(port.name).is_some())
        };
        for port in kind.inputs.iter().filter(|port| port.arity != Arity::Optional && !wired(port)) {
            complaints.push(format!("nodes.{name} of the example leaves the input `{}` open", port.name));
        }
        let wires = node.get("in").and_then(Tree::as_table).into_iter().flat_map(|wires| &wires.entries);
        for (port, _) in wires.filter(|(port, _)| kind.input(&port.name).is_none()) {
            complaints.push(format!("nodes.{name} of the example wires `{}`, which is no input", port.name));
        }
    });
}

#[test]
fn the_example_of_a_kind_passes_the_engines_checks() {
    let bench = Bench::new();
    let catalogue = photocurrent_nodes::catalogue();
    for_every_kind(|kind, complaints| {
        let path = bench.write("example.toml", &format!("format = 1\n{}", kind.decl.example));
        let Err(problems) = Project::load(&path, &[], &catalogue) else { return };
        // An example is a fragment: the nodes before it are not there, and nothing else may be wrong.
        let wrong: Vec<Problem> = problems
            .into_iter()
            .filter(|problem| !problem.message.starts_with("there is no node `"))
            .collect();
        if !wrong.is_empty() {
            complaints.push(format!("the example: {}", shown(&wrong)));
        }
    });
}

#[test]
fn every_file_of_a_family_is_in_the_catalogue_and_nothing_else_is() {
    let catalogue = photocurrent_nodes::catalogue();
    let listed: BTreeSet<String> = catalogue.kinds().iter().map(|kind| kind.decl.kind.to_string()).collect();
    let list = fs::read_to_string(root().join("nodes/catalog.rs")).expect("the catalogue");
    let mut found = BTreeSet::new();
    let folders = fs::read_dir(root().join("nodes"))
        .expect("nodes/")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.is_dir());
    for family in folders {
        for path in fs::read_dir(&family).expect("a family").map(|entry| entry.expect("an entry").path()) {
            let text = if path.extension().is_some_and(|e| e == "rs") {
                fs::read_to_string(&path).expect("a source file")
            } else {
                continue;
            };
            // Files without a node are what the family's nodes share.
            let nodes = text.matches("impl Node for ").count();
            assert!(nodes <= 1, "{}: one file, one node; it has {nodes}", path.display());
            if nodes == 1 {
                let name =
                    |path: &std::path::Path| path.file_stem().expect("a name").to_string_lossy().into_owned();
                let module = format!("{}::{}::", name(&family), name(&path));
                assert!(
                    list.contains(&module),
                    "{} is not in nodes/catalog.rs: add `Kind::of::<{module}...>()` where it belongs in \
                     reading order",
                    path.display()
                );
                found.insert(format!("{}/{}", name(&family), name(&path)));
            }
        }
    }
    // Readers of other programs' files are one text with a table of formats, a line each.
    assert!(
        list.contains("read::formats::kinds()"),
        "the table of nodes/read/formats.rs is in nodes/catalog.rs"
    );
    let table = fs::read_to_string(root().join("nodes/read/formats.rs")).expect("the table of formats");
    let lines = table.lines().filter_map(|line| line.trim().split_once(" \"read/")?.1.split_once('"'));
    found.extend(lines.filter(|(_, rest)| rest.starts_with(" \"")).map(|(name, _)| format!("read/{name}")));
    let differing: Vec<&String> = found.symmetric_difference(&listed).collect();
    assert!(
        differing.is_empty(),
        "nodes/family/name.rs holds the kind `family/name` and is in catalog.rs; not so: {differing:?}"
    );
}

#[test]
fn the_manifests_schema_is_valid_json_and_has_every_kind() {
    let done = Bench::new().run(&["schema"]);
    assert_eq!((done.code, done.stderr.as_str()), (0, ""));
    let schema: Json = serde_json::from_str(&done.stdout).expect("`schema` prints JSON");
    let kinds = schema
        .pointer("/properties/nodes/additionalProperties/oneOf")
        .and_then(Json::as_array)
        .expect("one alternative per kind");
    for_every_kind(|kind, complaints| {
        let Some(node) = kinds.iter().find(|node| node["properties"]["kind"]["const"] == kind.decl.kind)
        else {
            return complaints.push("it is not in the manifest's schema".into());
        };
        for (name, _) in parameters(kind)
            .iter()
            .filter(|(name, _)| node["properties"]["params"]["properties"].get(name.as_str()).is_none())
        {
            complaints.push(format!("params.{name} is not in the manifest's schema"));
        }
        for port in
            kind.inputs.iter().filter(|port| node["properties"]["in"]["properties"].get(port.name).is_none())
        {
            complaints.push(format!("the input `{}` is not in the manifest's schema", port.name));
        }
    });
    let mut references = Vec::new();
    walk(&schema, "#", &mut |place, inner| {
        if let Some(target) =
            inner["$ref"].as_str().filter(|target| schema.pointer(target.trim_start_matches('#')).is_none())
        {
            references.push(format!("{place} -> {target}"));
        }
    });
    assert!(references.is_empty(), "references that lead nowhere: {references:?}");
}

#[test]
fn the_manual_is_what_the_command_prints() {
    let done = Bench::new().run(&["nodes", "--markdown"]);
    assert_eq!((done.code, done.stderr.as_str()), (0, ""));
    let path = root().join("docs/nodes.md");
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        fs::write(&path, &done.stdout).expect("docs/nodes.md is written");
    }
    let kept = fs::read_to_string(&path).unwrap_or_default();
    assert!(
        kept == done.stdout,
        "docs/nodes.md is not what `photocurrent nodes --markdown` prints: UPDATE_EXPECT=1 cargo test \
         --test photocurrent conformance"
    );
    for_every_kind(|kind, complaints| {
        if !kept.contains(&format!("\n| `{}` | {} |\n", kind.decl.kind, kind.decl.about)) {
            complaints.push("it has no line in docs/nodes.md".into());
        }
    });
}

#[test]
fn the_catalogue_of_effects_is_what_the_command_prints() {
    let done = Bench::new().run(&["effects", "--markdown"]);
    assert_eq!((done.code, done.stderr.as_str()), (0, ""));
    let path = root().join("docs/effects.md");
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        fs::write(&path, &done.stdout).expect("docs/effects.md is written");
    }
    let kept = fs::read_to_string(&path).unwrap_or_default();
    assert!(
        kept == done.stdout,
        "docs/effects.md is not what `photocurrent effects --markdown` prints: UPDATE_EXPECT=1 cargo test \
         --test photocurrent conformance"
    );
    // Every id that a sensor description may name is an effect, and the other way round.
    for id in photocurrent_core::sensor::EFFECT_IDS {
        assert!(kept.contains(&format!("\n## {id}\n")), "{id} has no heading in docs/effects.md");
    }
    assert_eq!(kept.matches("\n## ").count(), photocurrent_core::sensor::EFFECT_IDS.len());
}

#[test]
fn nodes_lists_every_kind_and_prints_the_manual_of_each() {
    let bench = Bench::new();
    let list = bench.run(&["nodes"]);
    assert_eq!(list.code, 0, "{}", list.stderr);
    let json: Json =
        serde_json::from_str(&bench.run(&["nodes", "--json"]).stdout).expect("`nodes --json` prints JSON");
    assert_eq!(json.as_array().map(Vec::len), Some(photocurrent_nodes::catalogue().kinds().len()));
    for_every_kind(|kind, complaints| {
        let name = kind.decl.kind;
        if !list
            .stdout
            .lines()
            .any(|line| line.split_whitespace().next() == Some(name) && line.ends_with(kind.decl.about))
        {
            complaints.push("`nodes` does not list it with what it does".into());
        }
        let page = bench.run(&["nodes", name]);
        if page.code != 0
            || !page.stdout.starts_with(&format!("## {name}\n"))
            || !page.stdout.contains(kind.decl.example.trim())
        {
            complaints.push(format!(
                "`nodes {name}` does not print its manual: exit code {}\n{}{}",
                page.code, page.stdout, page.stderr
            ));
        }
        let empty = ["Source: .", "| |  |", "``", "(): "]
            .iter()
            .find(|hole| page.stdout.replace("```", "").contains(*hole));
        if let Some(hole) = empty {
            complaints.push(format!("its manual has a hole: `{hole}`"));
        }
        for (parameter, _) in parameters(kind)
            .iter()
            .filter(|(parameter, _)| !page.stdout.contains(&format!("| `{parameter}` |")))
        {
            complaints.push(format!("its manual does not have params.{parameter}"));
        }
    });
}

#[test]
fn an_unknown_kind_gets_a_suggestion() {
    let done = Bench::new().run(&["nodes", "solve/papr"]);
    assert_eq!((done.code, done.stdout.as_str()), (2, ""));
    assert!(done.stderr.contains("did you mean `solve/paper`?"), "{}", done.stderr);
}

#[test]
fn completions_are_printed_for_every_common_shell() {
    let bench = Bench::new();
    for shell in ["bash", "zsh", "fish"] {
        let done = bench.run(&["completions", shell]);
        assert_eq!((done.code, done.stderr.as_str()), (0, ""), "{shell}");
        for word in ["photocurrent", "plan", "explain", "cache"] {
            assert!(done.stdout.contains(word), "the completions for {shell} do not know `{word}`");
        }
    }
}

/// The subcommands that a help text lists, with what it says about each.
fn commands(help: &str) -> Vec<(String, String)> {
    let listed = help
        .lines()
        .skip_while(|line| *line != "Commands:")
        .skip(1)
        .take_while(|line| line.starts_with("  "));
    // The program's own help groups them: the group stands before the first command of it.
    const GROUPS: usize = 15;
    let grouped = help
        .lines()
        .skip_while(|line| !line.starts_with("Run pipelines  "))
        .take_while(|line| !line.is_empty())
        .filter_map(|line| line.get(GROUPS..));
    let split = listed.chain(grouped).filter_map(|line| line.trim().split_once(' '));
    split
        .map(|(name, about)| (name.to_string(), about.trim().to_string()))
        .filter(|(name, _)| name != "help")
        .collect()
}

#[test]
fn every_subcommand_has_help() {
    let bench = Bench::new();
    let mut waiting: Vec<Vec<String>> = vec![Vec::new()];
    let mut seen = 0;
    while let Some(path) = waiting.pop() {
        let arguments: Vec<&str> = path.iter().map(String::as_str).chain(["--help"]).collect();
        let done = bench.run(&arguments);
        assert_eq!((done.code, done.stderr.as_str()), (0, ""), "{arguments:?}");
        assert!(done.stdout.contains("Usage: photocurrent"), "{arguments:?}:\n{}", done.stdout);
        assert!(
            done.stdout.lines().next().is_some_and(|line| !line.starts_with("Usage")),
            "{arguments:?}: help begins with what the command does"
        );
        for (name, about) in commands(&done.stdout) {
            assert!(!about.is_empty(), "{path:?} {name}: says what it does");
            waiting.push(path.iter().cloned().chain([name]).collect());
        }
        seen += 1;
    }
    assert!(seen >= 11, "only {seen} helps: is the list of commands read rightly?");
}

#[test]
fn a_command_that_does_not_exist_is_a_usage_error() {
    let done = Bench::new().run(&["plann"]);
    assert_eq!((done.code, done.stdout.as_str()), (2, ""));
    assert!(done.stderr.contains("'plan'"), "it suggests the near one:\n{}", done.stderr);
}
