//! Lines of at most 110 columns and functions of at most 80 lines, so that a file can be read next to another
//! one.

use crate::support::root;
use crate::tidy::{files, is_test_file, read, rust_files};
use std::fs;

/// Most columns of a line.
const COLUMNS: usize = 110;

/// Most lines of a function outside of tests.
const LINES: usize = 80;

/// Most lines of a source file: what has more is two files.
const FILE_LINES: usize = 700;

/// Functions that may be longer: an inner loop whose phases share so many locals that parts would only pass
/// them on.
const LONGER: [(&str, &str); 1] = [("src/sensor/map/group/columns.rs", "run")];

/// Raw strings that are open at the end of a line, as their closing quote; comments hold none.
fn raw_string_end(line: &str) -> Option<String> {
    let code = line.split("//").next().unwrap_or(line);
    let at = code.rfind("r#\"").map(|at| (at, "\"#")).or_else(|| code.rfind(" r\"").map(|at| (at, "\"")));
    let (at, end) = at?;
    let after = &code[at + 3..];
    (!after.contains(end)).then(|| end.to_owned())
}

/// Lines that are too long and could be broken: not within raw strings, and not one word or one row of a
/// table.
fn too_long(text: &str) -> Vec<(usize, usize)> {
    let (mut open, mut found): (Option<String>, Vec<(usize, usize)>) = (None, Vec::new());
    for (number, line) in text.lines().enumerate() {
        if let Some(end) = &open {
            if line.contains(end.as_str()) {
                open = None;
            }
            continue;
        }
        open = raw_string_end(line);
        let words = line.trim_start_matches(['/', '!', ' ']);
        let is_one_word = !words.contains(' ') || words.starts_with('|');
        let columns = line.chars().count();
        let is_raw = open.is_some() || line.contains("r#\"");
        if columns > COLUMNS && !is_one_word && !is_raw {
            found.push((number + 1, columns));
        }
    }
    found
}

/// Functions of a file before its tests, with their number of lines, signature included.
fn functions(text: &str) -> Vec<(String, usize)> {
    let production = text.split("\n#[cfg(test)]\nmod ").next().unwrap_or(text);
    let lines: Vec<&str> = production.lines().collect();
    let mut found = Vec::new();
    for (first, line) in lines.iter().enumerate() {
        let code = line.trim_start();
        let words = code.split_whitespace().take_while(|word| *word != "fn").count();
        let Some(name) =
            code.split_whitespace().nth(words + 1).filter(|_| words < 4 && !code.starts_with("//"))
        else {
            continue;
        };
        let end = format!("{}}}", &line[..line.len() - code.len()]);
        let rest = || lines[first..].iter();
        // A declaration, or a body on the line itself.
        if line.ends_with(';') || (line.ends_with('}') && line.contains('{')) {
            continue;
        }
        let count = rest().position(|line| **line == *end).map_or(0, |last| last + 1);
        let name = name.split(['(', '<']).next().unwrap_or(name);
        found.push((name.to_owned(), count));
    }
    found
}

#[test]
fn lines_are_at_most_110_columns() {
    let mut faults = Vec::new();
    for name in files().into_iter().filter(|name| name.ends_with(".rs")) {
        let text = fs::read_to_string(root().join(&name)).expect("a source");
        faults.extend(
            too_long(&text).into_iter().map(|(line, columns)| format!("{name}:{line}: {columns} columns")),
        );
    }
    assert!(faults.is_empty(), "lines of more than {COLUMNS} columns:\n{}", faults.join("\n"));
}

#[test]
fn no_source_file_is_too_long_to_read_in_one_sitting() {
    let long: Vec<String> = rust_files()
        .map(|name| (read(&name).lines().count(), name))
        .filter(|(n, _)| *n > FILE_LINES)
        .map(|(n, name)| format!("{name}: {n}"))
        .collect();
    assert!(long.is_empty(), "more than {FILE_LINES} lines, split by what the parts are about: {long:?}");
}

#[test]
fn functions_are_at_most_80_lines() {
    let mut longer = Vec::new();
    let production = |name: &String| {
        let is_ours = name.starts_with("src/") || name.starts_with("nodes/");
        is_ours && name.ends_with(".rs") && !is_test_file(name)
    };
    for name in files().into_iter().filter(production) {
        let text = fs::read_to_string(root().join(&name)).expect("a source");
        let of_file = functions(&text).into_iter().filter(|(_, lines)| *lines > LINES);
        longer.extend(of_file.map(|(function, lines)| (name.clone(), function, lines)));
    }
    let is_stated = |(name, function, _): &&(String, String, usize)| {
        LONGER.iter().any(|(file, stated)| file == name && stated == function)
    };
    let faults: Vec<_> = longer.iter().filter(|one| !is_stated(one)).collect();
    assert!(faults.is_empty(), "functions of more than {LINES} lines: {faults:#?}");
    let is_needed = |(file, stated): &&(&str, &str)| {
        longer.iter().any(|(name, function, _)| file == name && stated == function)
    };
    let stale: Vec<_> = LONGER.iter().filter(|one| !is_needed(one)).collect();
    assert!(stale.is_empty(), "no longer than {LINES} lines, take them out of the list: {stale:?}");
}

#[test]
fn long_lines_and_functions_are_found() {
    let long = "x ".repeat(60);
    assert_eq!(too_long(&format!("{long}\n// {long}\n")), [(1, 120), (2, 123)]);
    assert_eq!(too_long(&format!("let a = r#\"\n{long}\n\"#;\n{long}\n")), [(4, 120)]);
    assert!(too_long(&format!("//! | {long} |\n// {}\n", "x".repeat(150))).is_empty());
    let text = "impl A {\n    pub fn long(&self) {\n        one();\n    }\n\n    fn short() {}\n}\n";
    assert_eq!(functions(text), [("long".to_owned(), 3)]);
}
