//! The code map of docs/architecture.md names every module and folder, and no other.

use crate::direction::DIRECTION;
use crate::tidy::{files, is_test_file, is_under, read};
use std::collections::BTreeSet;

/// The modules that a table of the code map names: what stands between backticks in the first cell of each
/// row.
fn modules_of(table: &str) -> Vec<String> {
    let cells = table.lines().filter_map(|line| line.strip_prefix("| ")?.split(" | ").next());
    cells.flat_map(|cell| cell.split('`').skip(1).step_by(2)).map(String::from).collect()
}

/// What of a crate's folder the code map has to name: its modules and folders, without the root of the crate
/// and without what is there for tests only.
fn modules_in(folder: &str, files: &BTreeSet<String>) -> BTreeSet<String> {
    let inside = files
        .iter()
        .filter(|name| !is_test_file(name))
        .filter_map(|name| name.strip_prefix(&format!("{folder}/")));
    let top = inside.map(|rest| {
        rest.split_once('/')
            .map_or_else(|| rest.strip_suffix(".rs").unwrap_or(rest), |(first, _)| first)
            .to_string()
    });
    top.filter(|name| !["lib", "Cargo.toml"].contains(&name.as_str())).collect()
}

/// What is wrong with the code map, in words: modules that do not exist, and modules that it does not name.
fn faults_of_code_map(page: &str, files: &BTreeSet<String>) -> Vec<String> {
    let map = page
        .split_once("\n## Code map\n")
        .and_then(|(_, rest)| rest.split("\n## ").next())
        .unwrap_or_default();
    let folders: Vec<&str> = DIRECTION.iter().map(|(folder, ..)| *folder).chain(["src/cli"]).collect();
    let mut faults = Vec::new();
    for folder in &folders {
        let Some((_, rest)) = map.split_once(&format!("\n`{folder}`, ")) else {
            faults.push(format!("no table for {folder}"));
            continue;
        };
        let end = folders
            .iter()
            .filter_map(|other| rest.find(&format!("\n`{other}`, ")))
            .min()
            .unwrap_or(rest.len());
        let named = modules_of(&rest[..end]);
        let exists = |module: &str| {
            let path = format!("{folder}/{module}");
            files.contains(&path)
                || files.contains(&format!("{path}.rs"))
                || files.iter().any(|name| is_under(name, &[&path]))
        };
        faults.extend(
            named
                .iter()
                .filter(|module| !exists(module))
                .map(|module| format!("{folder}/{module} does not exist")),
        );
        faults.extend(
            modules_in(folder, files)
                .into_iter()
                .filter(|module| !named.contains(module))
                .map(|module| format!("{folder}/{module} is not named")),
        );
    }
    faults
}

#[test]
fn the_code_map_names_what_there_is() {
    let faults = faults_of_code_map(&read("docs/architecture.md"), &files());
    assert!(
        faults.is_empty(),
        "the first column of a table in the code map of docs/architecture.md names \
                                the modules of a crate:\n{}\n",
        faults.join("\n")
    );
}

#[test]
fn a_wrong_name_in_the_code_map_is_found() {
    let (page, files) = (read("docs/architecture.md"), files());
    let with = |from: &str, to: &str| faults_of_code_map(&page.replacen(from, to, 1), &files);
    assert_eq!(
        with("`front_end`, ", "`front_door`, "),
        ["src/sensor/front_door does not exist", "src/sensor/front_end is not named"]
    );
    assert_eq!(with("`map/group`", "`map/groups`"), ["src/sensor/map/groups does not exist"]);
    assert_eq!(with("| `split` |", "| |"), ["nodes/split is not named"]);
    assert_eq!(
        with("\n`src/page`, ", "\nPages, ").first().map(String::as_str),
        Some("no table for src/page")
    );
}
