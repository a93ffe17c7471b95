//! The invariants of docs/architecture.md, executed: who may know whom, what makes results reproducible, and
//! that files are where they belong.
//!
//! Text is searched with comments taken out, and mostly without the unit tests at the end of a file; each
//! failure says what to do. The compiler and clippy see more than a search does (`clippy.toml` refuses the
//! platform's functions by type); a search also sees what is not compiled on this machine.

use crate::direction::DIRECTION;
use crate::support::root;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::process::Command;

/// Not part of a bare `cargo build`: what is built for a Python, whose tests are Python's, and what is built
/// with the feature `gpu`, which brings sixty crates.
const ON_DEMAND: [&str; 2] = ["src/python", "src/gpu"];

/// A package that stands outside the workspace: it shares nothing with the others, so that its recordings can
/// examine them.
const OUTSIDE: &str = "data/concealed/generator";

/// The files of the project, relative to its root: what git has or would take; without git, what lies there.
pub fn files() -> BTreeSet<String> {
    let git = Command::new("git")
        .args(["ls-files", "-z", "--cached", "--others", "--exclude-standard"])
        .current_dir(root())
        .output();
    let mut found: BTreeSet<String> = match git {
        Ok(output) if output.status.success() => String::from_utf8_lossy(&output.stdout)
            .split('\0')
            .filter(|name| !name.is_empty())
            .map(String::from)
            .collect(),
        _ => BTreeSet::new(),
    };
    if found.is_empty() {
        walk(root(), "", &mut found);
    }
    // Git still lists what was deleted and not yet committed.
    found.retain(|name| root().join(name).is_file());
    assert!(found.contains("Cargo.toml"), "the project's files are listed");
    found
}

fn walk(folder: &Path, prefix: &str, found: &mut BTreeSet<String>) {
    for entry in fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry")) {
        let name = entry.file_name().to_string_lossy().into_owned();
        if entry.path().is_dir() {
            if !["target", "out", ".git", ".photocurrent"].contains(&name.as_str()) {
                walk(&entry.path(), &format!("{prefix}{name}/"), found);
            }
        } else {
            found.insert(format!("{prefix}{name}"));
        }
    }
}

pub fn read(name: &str) -> String {
    fs::read_to_string(root().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

pub fn rust_files() -> impl Iterator<Item = String> {
    files().into_iter().filter(|name| name.ends_with(".rs"))
}

pub fn is_under(name: &str, folders: &[&str]) -> bool {
    folders
        .iter()
        .any(|folder| name == *folder || name.strip_prefix(folder).is_some_and(|rest| rest.starts_with('/')))
}

/// Is a file there for tests only?
pub fn is_test_file(name: &str) -> bool {
    name.starts_with("tests/")
        || name.contains("/tests/")
        || name.contains("/benches/")
        || name.ends_with("tests.rs")
        || name.ends_with("/testing.rs")
}

/// The code of a file: comments blanked, line by line; strings stay.
fn code(text: &str) -> String {
    let mut code = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(next) = rest.chars().next() {
        let taken = if rest.starts_with("//") {
            let end = rest.find('\n').unwrap_or(rest.len());
            rest = &rest[end..];
            continue;
        } else if rest.starts_with("/*") {
            let end = rest.find("*/").map_or(rest.len(), |at| at + 2);
            code.push_str(&"\n".repeat(rest[..end].matches('\n').count()));
            rest = &rest[end..];
            continue;
        } else if next == '"' {
            let mut escaped = false;
            let end = rest[1..].find(|c| {
                let ends = c == '"' && !escaped;
                escaped = c == '\\' && !escaped;
                ends
            });
            end.map_or(rest.len(), |end| end + 2)
        } else if rest.starts_with("r\"") || rest.starts_with("r#") {
            let hashes = rest[1..].chars().take_while(|c| *c == '#').count();
            match rest[1 + hashes..]
                .strip_prefix('"')
                .and_then(|body| body.find(&format!("\"{}", "#".repeat(hashes))))
            {
                Some(end) => 1 + hashes + 1 + end + 1 + hashes,
                None => 1,
            }
        } else if let Some(literal) =
            ["'\"'", "'\\\"'", "'/'"].into_iter().find(|literal| rest.starts_with(literal))
        {
            literal.len()
        } else {
            next.len_utf8()
        };
        code.push_str(&rest[..taken]);
        rest = &rest[taken..];
    }
    code
}

/// The code without the unit tests that stand at a file's end.
pub fn working_code(name: &str) -> String {
    let code = code(&read(name));
    let tests = code
        .match_indices("#[cfg(test)]\nmod ")
        .find(|(at, _)| code[at + 13..].lines().next().is_some_and(|line| line.trim_end().ends_with('{')));
    tests.map_or(code.clone(), |(at, _)| code[..at].to_string())
}

/// The lines, counted from 1, on which `word` stands by itself.
fn lines_with(code: &str, word: &str) -> Vec<usize> {
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let stands_alone = |line: &str, at: usize| {
        let before = line[..at].chars().next_back().is_some_and(|c| is_word(c) && word.starts_with(is_word));
        let after =
            line[at + word.len()..].chars().next().is_some_and(|c| is_word(c) && word.ends_with(is_word));
        !before && !after
    };
    let lines = code
        .lines()
        .enumerate()
        .filter(|(_, line)| line.match_indices(word).any(|(at, _)| stands_alone(line, at)));
    lines.map(|(at, _)| at + 1).collect()
}

/// Complains about every line of working code of `folders` that has one of `words`, unless `allowed` says
/// that the file may.
fn refuse(words: &[&str], folders: &[&str], allowed: impl Fn(&str) -> bool, what_to_do: &str) {
    let mut found = Vec::new();
    for name in rust_files().filter(|name| is_under(name, folders) && !is_test_file(name) && !allowed(name)) {
        let code = working_code(&name);
        found.extend(words.iter().flat_map(|word| {
            lines_with(&code, word)
                .into_iter()
                .map(|line| format!("{name}:{line}: `{word}`"))
                .collect::<Vec<_>>()
        }));
    }
    assert!(found.is_empty(), "{what_to_do}\n{}\n", found.join("\n"));
}

fn manifest(folder: &str) -> toml::Table {
    let name = if folder.is_empty() { "Cargo.toml".into() } else { format!("{folder}/Cargo.toml") };
    read(&name).parse().unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// Everything that a package may see: dependencies of any sort, on any target.
fn dependencies(manifest: &toml::Table) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for (key, value) in manifest {
        match key.as_str() {
            "dependencies" | "dev-dependencies" | "build-dependencies" => {
                for (name, how) in value.as_table().into_iter().flatten() {
                    found.insert(name.clone());
                    // `package = "..."` gives another name to the same thing.
                    found.extend(how.get("package").and_then(toml::Value::as_str).map(String::from));
                }
            }
            "target" => value
                .as_table()
                .into_iter()
                .flatten()
                .filter_map(|(_, target)| target.as_table())
                .for_each(|target| found.extend(dependencies(target))),
            _ => {}
        }
    }
    found
}

/// Every package's folder ("" is the root) and dependencies.
fn packages() -> BTreeMap<String, BTreeSet<String>> {
    let folders = files()
        .into_iter()
        .filter_map(|name| Some(name.strip_suffix("Cargo.toml")?.trim_end_matches('/').to_string()));
    folders
        .filter(|folder| folder != OUTSIDE)
        .map(|folder| (folder.clone(), dependencies(&manifest(&folder))))
        .collect()
}

/// Complains about packages other than `allowed` that depend on something that begins with `name`.
fn only_in(name: &str, allowed: &[&str]) {
    for (folder, dependencies) in packages() {
        let has = dependencies.iter().any(|d| d == name || d.starts_with(&format!("{name}-")));
        assert!(
            !has || allowed.contains(&folder.as_str()),
            "{folder}/Cargo.toml depends on {name}: only {allowed:?} may; ask them for what you need"
        );
    }
}

#[test]
fn dependencies_among_our_crates_point_down() {
    let packages = packages();
    for (folder, _, allowed) in DIRECTION {
        let ours = packages
            .get(folder)
            .unwrap_or_else(|| panic!("{folder} is a package"))
            .iter()
            .filter(|name| name.starts_with("photocurrent"));
        let wrong: Vec<&String> = ours.filter(|name| !allowed.contains(&name.as_str())).collect();
        assert!(
            wrong.is_empty(),
            "{folder} depends on {wrong:?}, and may depend on {allowed:?} only: move \
                                   what is shared down, or pass it in as an argument"
        );
    }
}

#[test]
fn the_direction_of_every_crate_is_stated_here() {
    let stated: BTreeMap<&str, &str> = DIRECTION.iter().map(|(folder, name, _)| (*folder, *name)).collect();
    for folder in packages().keys().filter(|folder| !folder.is_empty()) {
        let name = manifest(folder)["package"]["name"].as_str().expect("a name").to_string();
        assert_eq!(
            stated.get(folder.as_str()),
            Some(&name.as_str()),
            "{folder} is a new package: state in DIRECTION of tests/tidy.rs what it may depend on"
        );
    }
}

#[test]
fn the_physics_builds_without_the_engine_and_its_texts() {
    let tree = |package: &str| {
        let options = [
            "tree",
            "--offline",
            "--no-default-features",
            "-e",
            "normal",
            "--prefix",
            "none",
            "--no-dedupe",
            "-f",
            "{p}",
            "-p",
            package,
        ];
        let output = Command::new(std::env::var("CARGO").unwrap_or("cargo".into()))
            .args(options)
            .current_dir(root())
            .output()
            .expect("cargo runs");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        text.lines().filter_map(|line| line.split(' ').next()).map(String::from).collect::<BTreeSet<String>>()
    };
    for (package, most) in [("photocurrent-sensor", 40), ("photocurrent-solve", 52)] {
        let crates = tree(package);
        assert!(
            crates.len() <= most,
            "{package} builds {} crates, at most {most} are meant: {crates:?}",
            crates.len()
        );
        for heavy in ["toml", "schemars", "hdf5-metno", "photocurrent-engine", "photocurrent-store"] {
            assert!(
                !crates.contains(heavy),
                "{package} builds {heavy}: put what needs it behind a feature of photocurrent-core"
            );
        }
    }
}

#[test]
fn the_workspace_lists_its_members_one_by_one() {
    let workspace = &manifest("")["workspace"];
    let list = |key: &str| {
        workspace[key]
            .as_array()
            .expect("a list")
            .iter()
            .map(|name| name.as_str().expect("a path").to_string())
            .collect::<BTreeSet<_>>()
    };
    let members = list("members");
    let folders: BTreeSet<String> = packages().into_keys().filter(|folder| !folder.is_empty()).collect();
    assert!(
        members.iter().all(|member| !member.contains('*')),
        "members are listed one by one: a glob over src/ meets src/cli, which is no package"
    );
    assert_eq!(members, folders, "the packages that there are (right) are the workspace's members (left)");
    let mut tested = list("default-members");
    for folder in ON_DEMAND {
        assert!(tested.insert(folder.into()), "a bare `cargo build` needs no {folder}");
    }
    assert!(
        members.is_subset(&tested) && tested.contains("."),
        "default-members has the root and every other member, so that a bare `cargo test` runs all"
    );
}

#[test]
fn the_maker_of_concealed_recordings_shares_nothing_with_the_engine() {
    let outside = manifest(OUTSIDE);
    assert!(
        outside.contains_key("workspace"),
        "{OUTSIDE}/Cargo.toml has an empty [workspace] table: it belongs to no other"
    );
    let ours: Vec<String> =
        dependencies(&outside).into_iter().filter(|name| name.starts_with("photocurrent")).collect();
    assert!(
        ours.is_empty(),
        "{OUTSIDE}/Cargo.toml depends on {ours:?}: who makes the recordings that \
                              examine the engine may not use it"
    );
    for name in rust_files().filter(|name| is_under(name, &[OUTSIDE])) {
        let code = code(&read(&name));
        for word in [concat!("photocurrent", "_"), "#[path", "include!"] {
            assert!(
                !code.contains(word),
                "{name} has `{word}`: write it anew; who makes the recordings \
                                           that examine the engine may not use it"
            );
        }
    }
}

#[test]
fn hdf5_is_known_to_the_store_alone() {
    only_in("hdf5", &["src/store"]);
    let known = |name: &String| !is_under(name, &["src/store", OUTSIDE]);
    for name in rust_files().filter(known) {
        let code = code(&read(&name));
        for word in [concat!("hdf5", "::"), concat!("hdf5_", "sys")] {
            assert!(
                lines_with(&code, word).is_empty(),
                "{name} names {word}: files are opened, read and written through photocurrent-store"
            );
        }
    }
}

#[test]
fn networks_are_run_in_one_place() {
    for name in ["ort", "rten"] {
        only_in(name, &["nodes", "nodes/onnx"]);
        let path = format!("{name}::");
        refuse(
            &[&path],
            &["src", "nodes"],
            |file| is_under(file, &["nodes/onnx"]),
            "networks are run through the one trait of nodes/onnx",
        );
    }
}

#[test]
fn cards_are_used_in_one_place() {
    only_in("wgpu", &["src/gpu"]);
    refuse(&["wgpu::"], &["src", "nodes"], |file| is_under(file, &["src/gpu"]), "only src/gpu opens cards");
}

#[test]
fn arguments_are_parsed_in_the_command_alone() {
    only_in("clap", &["", "src/calibrate"]);
    only_in("indicatif", &["", "src/calibrate"]);
    refuse(
        &["clap::", "clap_complete::", "clap_mangen::"],
        &["src", "nodes"],
        |name| is_under(name, &["src/cli", "src/calibrate"]),
        "only src/cli knows the command line: pass values in",
    );
}

#[test]
fn only_readers_and_writers_open_recordings() {
    let allowed = |name: &str| is_under(name, &["nodes/read", "nodes/write"]);
    refuse(
        &["photocurrent_store"],
        &["nodes"],
        allowed,
        "nodes get values at their inputs; files are for nodes/read and nodes/write",
    );
}

#[test]
fn the_command_calculates_nothing() {
    let manifest = manifest("");
    let of = |key: &str| {
        manifest
            .get(key)
            .and_then(toml::Value::as_table)
            .into_iter()
            .flatten()
            .map(|(name, _)| name.clone())
            .collect::<Vec<_>>()
    };
    assert!(
        !of("dependencies").contains(&"photocurrent-sensor".to_string()),
        "src/cli has no business with the sensor's equations: make a node"
    );
}

#[test]
fn results_depend_on_no_clock_environment_or_thread() {
    let words = [
        "SystemTime",
        "Instant",
        "std::env",
        "env::var",
        "thread_rng",
        "thread_local!",
        "available_parallelism",
        "current_num_threads",
    ];
    refuse(
        &words,
        &["src/core", "src/sensor", "src/solve", "src/scene", "src/diagnosis", "nodes"],
        |_| false,
        "a result is a function of inputs, parameters, declared files and seed: take what you need as a \
         parameter, or draw from photocurrent_core::random",
    );
}

#[test]
fn numbers_come_from_libm() {
    // Generic over `Scalar`, or on lanes: `exp` and `ln` are the project's own there for every type that
    // there is.
    let generic = ["src/sensor/scalar.rs", "src/sensor/front_end.rs", "src/sensor/inverse/lanes.rs"];
    let exact = [
        ".mul_add(",
        ".powf(",
        ".powi(",
        ".sin(",
        ".cos(",
        ".tan(",
        ".atan2(",
        ".tanh(",
        ".hypot(",
        ".cbrt(",
        ".log2(",
        ".log10(",
        ".ln_1p(",
    ];
    let what_to_do = "the platform's functions round differently from machine to machine: use libm's \
                      (libm::exp, libm::log, libm::pow)";
    let folders = [
        "src/core",
        "src/sensor",
        "src/solve",
        "src/scene",
        "src/diagnosis",
        "src/engine",
        "src/store",
        "nodes",
    ];
    refuse(&exact, &folders, |_| false, what_to_do);
    let allowed = |name: &str| generic.contains(&name);
    refuse(&[".exp()", ".ln()", ".exp_m1()"], &folders, allowed, what_to_do);
}

#[test]
fn clippy_refuses_the_platforms_functions() {
    let clippy: toml::Table = read("clippy.toml").parse().expect("clippy.toml is TOML");
    let methods = clippy["disallowed-methods"].as_array().expect("a list of disallowed methods");
    for method in [
        "f64::exp",
        "f64::ln",
        "f64::powf",
        "f64::mul_add",
        "f32::exp",
        "f32::ln",
        "f32::powf",
        "f32::mul_add",
    ] {
        let listed =
            methods.iter().any(|entry| entry.get("path").and_then(toml::Value::as_str) == Some(method));
        assert!(
            listed,
            "clippy.toml disallows {method}: put it back, or results differ from machine to machine"
        );
    }
}

#[test]
fn truth_is_seen_by_scorers_and_by_those_who_make_show_and_store_it() {
    let makes_or_shows = [
        "nodes/score",
        "nodes/show",
        "nodes/simulate",
        "nodes/read/recording.rs",
        "nodes/write/recording.rs",
        "nodes/write/contact_sheet.rs",
    ];
    let carries = ["src/core", "src/store", "src/engine", "src/python"];
    let allowed = |name: &str| is_under(name, &makes_or_shows) || is_under(name, &carries);
    refuse(
        &["Truth"],
        &["src", "nodes"],
        allowed,
        "a method that sees the truth proves nothing: only scorers compare with it",
    );
}

#[test]
fn no_code_knows_where_answers_are_kept() {
    // File names that begin so hold what blind tests hide.
    let prefixes = [concat!("key", "_"), concat!("exam", "_")];
    for name in rust_files().filter(|name| is_under(name, &["src", "nodes"])) {
        let code = code(&read(&name));
        for (at, line) in code.lines().enumerate() {
            let names = prefixes.iter().any(|prefix| {
                let mut places = line.match_indices(prefix);
                places.any(|(at, _)| matches!(line[..at].chars().next_back(), Some('"' | '/' | '`')))
            });
            assert!(
                !names,
                "{name}:{}: names a file of answers; the code under test must not know them",
                at + 1
            );
        }
    }
    // What the concealed recordings conceal: no file of the tool names it, be it code, a comment or data.
    for name in files().into_iter().filter(|name| is_under(name, &["src", "nodes"])) {
        let bytes = fs::read(root().join(&name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let text = String::from_utf8_lossy(&bytes);
        assert!(
            !text.contains("answers.json"),
            "{name}: names the answers to the concealed recordings; the code under test must not know them"
        );
    }
}

#[test]
fn every_source_file_says_what_it_is() {
    let silent: Vec<String> = rust_files().filter(|name| !read(name).starts_with("//! ")).collect();
    assert!(
        silent.is_empty(),
        "the first line is `//! ` and what the file is, in a newcomer's words: {silent:?}"
    );
}

#[test]
fn no_file_names_a_place_on_one_machine() {
    let folders = ["work", "root", "tmp", "home", "Users"].map(|folder| format!("/{folder}/"));
    let mut found = Vec::new();
    for name in files() {
        let Ok(text) = fs::read_to_string(root().join(&name)) else { continue };
        for (at, line) in text.lines().enumerate() {
            // `target/tmp/` and `https://example.org/home/` are no absolute paths.
            let begins = |at: usize| {
                !matches!(
                    line[..at].chars().next_back(), Some(c) if c.is_alphanumeric() || "._-~$}*".contains(c),
                )
            };
            if folders.iter().any(|folder| line.match_indices(folder.as_str()).any(|(at, _)| begins(at))) {
                found.push(format!("{name}:{}: {}", at + 1, line.trim()));
            }
        }
    }
    assert!(
        found.is_empty(),
        "paths are relative to the project, or temporary ones made by the program:\n{}\n",
        found.join("\n")
    );
}

#[test]
fn every_pipeline_begins_with_what_it_is_for() {
    let pipelines: Vec<String> = files()
        .into_iter()
        .filter(|name| name.starts_with("pipelines/") && name.ends_with(".toml"))
        .collect();
    assert!(!pipelines.is_empty(), "there are pipelines");
    for name in pipelines {
        let text = read(&name);
        let first = text.lines().next().unwrap_or_default();
        assert!(
            first.starts_with("# ") && first.len() > 20,
            "{name}: the first line is a comment that says what the pipeline is for"
        );
    }
}

#[test]
fn every_data_file_is_named_in_a_readme() {
    let all = files();
    let mut missing = Vec::new();
    for name in all.iter().filter(|name| name.starts_with("data/") && !name.ends_with("README.md")) {
        let path = Path::new(name);
        let file = path.file_name().expect("a name").to_string_lossy();
        let readmes = path
            .ancestors()
            .skip(1)
            .map(|folder| folder.join("README.md").to_string_lossy().into_owned())
            .filter(|readme| readme.starts_with("data/"));
        if !readmes.filter(|readme| all.contains(readme)).any(|readme| read(&readme).contains(file.as_ref()))
        {
            missing.push(name);
        }
    }
    assert!(
        missing.is_empty(),
        "a README.md next to it or above it in data/ says what it is, where it \
                                 comes from and under which licence: {missing:?}"
    );
}

#[test]
fn decisions_are_numbered() {
    let decisions: Vec<String> = files()
        .into_iter()
        .filter_map(|name| Some(name.strip_prefix("docs/decisions/")?.to_string()))
        .filter(|n| n != "README.md")
        .collect();
    assert!(
        !decisions.is_empty(),
        "docs/decisions has a page for each decision that was hard, such as 0001-one-binary.md"
    );
    let mut numbers = BTreeSet::new();
    for name in decisions {
        let number = name.split('-').next().filter(|number| {
            number.len() >= 2 && number.chars().all(|c| c.is_ascii_digit()) && name.ends_with(".md")
        });
        let number = number
            .unwrap_or_else(|| panic!("docs/decisions/{name}: is called number-what-was-decided.md"))
            .to_string();
        assert!(numbers.insert(number), "docs/decisions/{name}: its number is taken");
    }
}

#[test]
fn comments_are_separated_from_code() {
    let text = "let a = \"// no comment\"; // a comment, \"quoted\"\n/* two\nlines */ let b = 'x'; let c = \
                r#\"raw \" // text\"#;\nlet d: &'static str = \"\\\"//\"; let e = ['\"', '\\\"']; // end\n";
    assert_eq!(
        code(text),
        "let a = \"// no comment\"; \n\n let b = 'x'; let c = r#\"raw \" // text\"#;\nlet d: &'static str = \
         \"\\\"//\"; let e = ['\"', '\\\"']; \n"
    );
    assert_eq!(lines_with("Instant\ninstant\nInstants\nstd::time::Instant::now()\n", "Instant"), [1, 4]);
}
