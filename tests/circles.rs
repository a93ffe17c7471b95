//! Modules of a crate that import each other in a circle: none but those that docs/architecture.md lists with
//! a reason.
//!
//! `use` and paths in production files count, parents and children included. The root of a crate only
//! re-exports: a name imported from there counts for the module that it comes from.

use crate::direction::DIRECTION;
use crate::tidy::{files, is_test_file, read, working_code};
use std::collections::{BTreeMap, BTreeSet};

type Imports = BTreeMap<String, BTreeSet<String>>;

/// Paths in a `use`, with its braces taken apart.
fn flat(path: &str) -> Vec<String> {
    let Some((before, inside)) = path.split_once('{') else {
        return vec![path.split(" as ").next().unwrap_or_default().trim().to_string()];
    };
    let inside = inside.rsplit_once('}').map_or(inside, |(inside, _)| inside);
    let (mut parts, mut depth) = (vec![String::new()], 0);
    for c in inside.chars() {
        depth += i32::from(c == '{') - i32::from(c == '}');
        match c {
            ',' if depth == 0 => parts.push(String::new()),
            _ => parts.last_mut().expect("a part").push(c),
        }
    }
    let parts = parts.iter().filter(|part| !part.trim().is_empty()).flat_map(|part| flat(part));
    parts.map(|part| format!("{}{part}", before.trim())).collect()
}

/// Paths of this crate that a file imports or names. An indented `use super::` is in a module inside the
/// file.
fn uses(code: &str) -> Vec<String> {
    let mut paths = Vec::new();
    for (at, _) in code.match_indices("use ") {
        let before = code[..at].rsplit('\n').next().unwrap_or_default();
        let text = code[at + 4..].split(';').next().unwrap_or_default();
        let is_use = before.trim().is_empty() || before.trim().starts_with("pub");
        if is_use && !(before.starts_with(' ') && text.starts_with("super::")) {
            paths.extend(flat(text));
        }
    }
    let rest = code.lines().filter(|line| !line.trim_start().starts_with("use "));
    let words = rest.flat_map(|line| line.split(|c: char| !c.is_alphanumeric() && !"_:".contains(c)));
    let named = words.filter(|word| word.starts_with("crate::") || word.starts_with("super::"));
    paths.extend(named.map(|word| word.trim_end_matches(':').to_string()));
    paths
}

fn join(at: &[&str], child: &str) -> String {
    at.iter().copied().chain([child]).collect::<Vec<_>>().join("/")
}

/// The module that a path, seen from another, leads to: the longest part of it that is one. `""` is the root.
fn module_of(path: &str, from: &str, modules: &BTreeSet<String>) -> Option<String> {
    let mut at: Vec<&str> = from.split('/').filter(|part| !part.is_empty()).collect();
    let first = path.split("::").next()?;
    if !["crate", "super", "self"].contains(&first) && !modules.contains(&join(&at, first)) {
        return None;
    }
    for part in path.split("::") {
        match part {
            "crate" => at.clear(),
            "self" => {}
            "super" => drop(at.pop()),
            child if modules.contains(&join(&at, child)) => at.push(child),
            _ => break,
        }
    }
    Some(at.join("/"))
}

/// Which modules of a crate import which, from the code of each.
fn imports(code: &BTreeMap<String, String>) -> Imports {
    let modules: BTreeSet<String> = code.keys().filter(|name| !name.is_empty()).cloned().collect();
    let last = |path: &str| path.rsplit("::").next().unwrap_or_default().to_string();
    let root = uses(code.get("").map_or("", String::as_str));
    let of_root = root.iter().filter_map(|path| Some((last(path), module_of(path, "", &modules)?)));
    let of_root: BTreeMap<String, String> = of_root.collect();
    let of = |name: &str, code: &str| {
        let found = uses(code).into_iter().filter_map(|path| match module_of(&path, name, &modules)? {
            to if to.is_empty() => of_root.get(&last(&path)).cloned(),
            to => Some(to),
        });
        found.filter(|to| to != name).collect()
    };
    code.iter()
        .filter(|(name, _)| !name.is_empty())
        .map(|(name, code)| (name.clone(), of(name, code)))
        .collect()
}

/// The modules that a module leads to.
fn reach<'a>(imports: &'a Imports, from: &'a str) -> BTreeSet<&'a str> {
    let (mut reached, mut next) = (BTreeSet::new(), vec![from]);
    while let Some(at) = next.pop() {
        next.extend(
            imports.get(at).into_iter().flatten().map(String::as_str).filter(|to| reached.insert(*to)),
        );
    }
    reached
}

/// Modules that lead to each other, each circle once.
fn circles(imports: &Imports) -> BTreeSet<Vec<&str>> {
    let all: BTreeMap<&str, _> = imports.keys().map(|name| (name.as_str(), reach(imports, name))).collect();
    let circle =
        |name: &&str| all[name].iter().copied().filter(|other| all[other].contains(name)).collect::<Vec<_>>();
    all.keys().map(circle).filter(|circle| !circle.is_empty()).collect()
}

/// The modules of a crate with their code.
fn modules(folder: &str, files: &BTreeSet<String>) -> BTreeMap<String, String> {
    let module = |name: &str| {
        let inside = name.strip_prefix(folder)?.strip_prefix('/')?.strip_suffix(".rs")?;
        Some(inside.strip_suffix("/mod").unwrap_or(if inside == "lib" { "" } else { inside }).to_string())
    };
    let production = files.iter().filter(|name| !is_test_file(name) && !name.contains("/examples/"));
    production.filter_map(|name| Some((module(name)?, working_code(name)))).collect()
}

#[test]
fn modules_import_each_other_in_no_circle_without_a_reason() {
    let (page, files) = (read("docs/architecture.md"), files());
    let reasons = page
        .split_once("\n## Circles\n")
        .and_then(|(_, rest)| rest.split("\n## ").next())
        .unwrap_or_default();
    let mut found = Vec::new();
    for folder in DIRECTION.iter().map(|(folder, ..)| *folder).chain(["src/cli"]) {
        for circle in circles(&imports(&modules(folder, &files))) {
            let listed = |line: &str| circle.iter().all(|name| line.contains(&format!("`{folder}/{name}`")));
            if !reasons.lines().any(listed) {
                found.push(format!("{folder}: {}", circle.join(", ")));
            }
        }
    }
    let hint = "move what they share to a module below them, or list the circle with its reason in \
                docs/architecture.md";
    assert!(found.is_empty(), "these import each other in a circle; {hint}:\n{}\n", found.join("\n"));
}

#[test]
fn a_circle_is_found_through_parents_braces_and_the_root() {
    let code = [
        ("", "pub use a::A;"),
        ("a", "use crate::{b, c::{x, y::Z}};"),
        ("b", "use super::A as Other;"),
        ("c", ""),
    ];
    let code =
        code.into_iter().chain([("c/y", "fn f() -> super::Part {}\nmod inner {\n    use super::Own;\n}")]);
    let code: BTreeMap<String, String> =
        code.map(|(name, text)| (name.to_string(), text.to_string())).collect();
    let graph = imports(&code);
    assert_eq!(graph["a"], ["b", "c", "c/y"].map(String::from).into());
    assert_eq!(graph["c/y"], ["c"].map(String::from).into());
    assert_eq!(circles(&graph), [vec!["a", "b"]].into());
}
