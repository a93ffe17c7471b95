//! Modules of a crate that import each other in a circle: none, but those that docs/architecture.md lists with a reason.
//!
//! What counts are `use` and paths in production files, parents and children included. The root of a crate only re-exports: a name imported from
//! there counts for the module that it comes from.

use crate::tidy::{DIRECTION, files, is_test_file, read, working_code};
use std::collections::{BTreeMap, BTreeSet};

/// Files in circles that stood when this test was written, by folder: at most so many. Lower a number when a circle is cut.
const PRESENT: [(&str, usize); 0] = [];

type Imports = BTreeMap<String, BTreeSet<String>>;

/// Paths in a `use`, with its braces taken apart.
fn flat(path: &str) -> Vec<String> {
    let path = path.trim();
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
    parts.iter().filter(|part| !part.trim().is_empty()).flat_map(|part| flat(part)).map(|part| format!("{before}{part}")).collect()
}

/// Paths of this crate that a file imports or names. An indented `use super::` stands in a module inside the file and names the file itself.
fn uses(code: &str) -> Vec<String> {
    let (mut paths, mut used) = (Vec::new(), String::new());
    for (at, _) in code.match_indices("use ") {
        let before = code[..at].rsplit('\n').next().unwrap_or_default();
        let text = code[at + 4..].split(';').next().unwrap_or_default();
        let is_use = before.trim().is_empty() || before.trim().starts_with("pub");
        if is_use && !(before.starts_with(' ') && text.starts_with("super::")) {
            paths.extend(flat(text));
        }
    }
    for line in code.lines().filter(|line| !line.trim_start().starts_with("use ")) {
        used.push_str(line);
        used.push('\n');
    }
    let is_path = |c: char| c.is_alphanumeric() || "_:".contains(c);
    let words = used.split(|c| !is_path(c)).filter(|word| ["crate::", "super::"].iter().any(|start| word.starts_with(start)));
    paths.extend(words.map(|word| word.trim_end_matches(':').to_string()));
    paths
}

/// The module of `root` that a path, seen from a module, leads to: the longest part of it that is one. `""` is the root of the crate.
fn module_of(path: &str, from: &str, modules: &BTreeSet<String>) -> Option<String> {
    let mut at: Vec<&str> = from.split('/').filter(|part| !part.is_empty()).collect();
    let mut parts = path.split("::").peekable();
    match *parts.peek()? {
        "crate" => at.clear(),
        "super" | "self" => {}
        child if modules.contains(&join(&at, child)) => {}
        _ => return None,
    }
    for part in parts {
        match part {
            "crate" | "self" => {}
            "super" => drop(at.pop()),
            child if modules.contains(&join(&at, child)) => at.push(child),
            _ => break,
        }
    }
    Some(at.join("/"))
}

fn join(at: &[&str], child: &str) -> String {
    at.iter().copied().chain([child]).collect::<Vec<_>>().join("/")
}

/// Which modules of a crate import which, from the code of each.
fn imports(code: &BTreeMap<String, String>) -> Imports {
    let modules: BTreeSet<String> = code.keys().filter(|name| !name.is_empty()).cloned().collect();
    let root = uses(code.get("").map_or("", String::as_str));
    let last = |path: &str| path.rsplit("::").next().unwrap_or_default().to_string();
    let from_root: BTreeMap<String, String> = root.iter().filter_map(|path| Some((last(path), module_of(path, "", &modules)?))).collect();
    let of = |name: &str, code: &str| {
        let found = uses(code).into_iter().filter_map(|path| match module_of(&path, name, &modules)? {
            to if to.is_empty() => from_root.get(&last(&path)).cloned(),
            to => Some(to),
        });
        found.filter(|to| to != name).collect()
    };
    code.iter().filter(|(name, _)| !name.is_empty()).map(|(name, code)| (name.clone(), of(name, code))).collect()
}

/// The modules that a module leads to.
fn reach<'a>(imports: &'a Imports, from: &'a str) -> BTreeSet<&'a str> {
    let (mut seen, mut next) = (BTreeSet::new(), vec![from]);
    while let Some(at) = next.pop() {
        next.extend(imports.get(at).into_iter().flatten().map(String::as_str).filter(|to| seen.insert(*to)));
    }
    seen
}

/// Modules that lead to each other, each circle once.
fn circles(imports: &Imports) -> BTreeSet<Vec<&str>> {
    let reached: BTreeMap<&str, BTreeSet<&str>> = imports.keys().map(|name| (name.as_str(), reach(imports, name))).collect();
    let circle = |name: &&str| reached[name].iter().copied().filter(|other| reached[other].contains(name)).collect::<Vec<_>>();
    reached.keys().map(circle).filter(|circle| !circle.is_empty()).collect()
}

/// The modules of a crate with their code.
fn modules(folder: &str) -> BTreeMap<String, String> {
    let names = files().into_iter().filter(|name| name.ends_with(".rs") && !is_test_file(name) && !name.contains("/examples/"));
    let module = |name: &str| {
        let inside = name.strip_prefix(folder)?.strip_prefix('/')?.strip_suffix(".rs")?;
        Some(inside.strip_suffix("/mod").unwrap_or(if inside == "lib" { "" } else { inside }).to_string())
    };
    names.filter_map(|name| Some((module(&name)?, working_code(&name)))).collect()
}

#[test]
fn modules_import_each_other_in_no_circle_without_a_reason() {
    let page = read("docs/architecture.md");
    let reasons = page.split_once("\n## Circles\n").and_then(|(_, rest)| rest.split("\n## ").next()).unwrap_or_default();
    let (mut found, mut present) = (Vec::new(), BTreeMap::<&str, usize>::new());
    for folder in DIRECTION.iter().map(|(folder, ..)| *folder).chain(["src/cli"]) {
        for circle in circles(&imports(&modules(folder))) {
            let listed = |line: &str| circle.iter().all(|name| line.contains(&format!("`{folder}/{name}`")));
            if reasons.lines().any(listed) {
                continue;
            }
            match PRESENT.iter().find(|(place, _)| format!("{folder}/{}/", circle[0]).starts_with(&format!("{place}/"))) {
                Some((place, _)) => *present.entry(place).or_default() += circle.len(),
                None => found.push(format!("{folder}: {}", circle.join(", "))),
            }
        }
    }
    for (place, most) in PRESENT {
        let now = present.get(place).copied().unwrap_or(0);
        assert!(now <= most, "{place} has {now} files in circles of imports, and had {most}: cut the new one");
    }
    assert!(
        found.is_empty(),
        "these import each other in a circle; move what they share to a module below them (types.rs), or list the circle with its reason in docs/architecture.md:\n{}\n",
        found.join("\n")
    );
}

#[test]
fn a_circle_is_found_through_parents_braces_and_the_root() {
    let code =
        [("", "pub use a::A;"), ("a", "use crate::{b, c::{x, y::Z}};"), ("b", "use super::A as Other;\nuse std::fmt;"), ("c", ""), ("c/y", "use super::Part;")];
    let code = code.map(|(name, text)| (name.to_string(), text.to_string())).into();
    let graph = imports(&code);
    assert_eq!(graph["a"], ["b", "c", "c/y"].map(String::from).into());
    assert_eq!(graph["c/y"], ["c"].map(String::from).into());
    assert_eq!(circles(&graph), [vec!["a", "b"]].into());
}
