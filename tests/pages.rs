//! The pages of README.md and docs/, and the code blocks in them.

use crate::support::{Bench, root};
use std::fs;
use std::path::Path;

/// A block between fences, with the invisible line that stands before it.
#[derive(Debug)]
pub struct Block {
    /// Page and line of its first fence.
    pub place: String,
    /// What stands in `<!-- ... -->` right before it; empty without.
    pub mark: String,
    pub lines: Vec<String>,
}

/// Every page, README.md first; generated ones too.
pub fn names() -> Vec<String> {
    fn walk(folder: &str, found: &mut Vec<String>) {
        for entry in fs::read_dir(root().join(folder)).expect("a folder") {
            let entry = entry.expect("an entry");
            let name = format!("{folder}/{}", entry.file_name().to_string_lossy());
            if entry.path().is_dir() {
                walk(&name, found);
            } else if name.ends_with(".md") {
                found.push(name);
            }
        }
    }
    let mut found = Vec::new();
    walk("docs", &mut found);
    found.sort();
    found.insert(0, "README.md".into());
    found
}

pub fn read(name: &str) -> String {
    fs::read_to_string(root().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// The blocks of a text.
pub fn blocks(name: &str, text: &str) -> Vec<Block> {
    let mut found = Vec::new();
    let (mut mark, mut inside) = (String::new(), None::<Block>);
    for (at, line) in text.lines().enumerate() {
        let is_fence = line.trim_start().starts_with("```");
        match &mut inside {
            Some(_) if is_fence => found.extend(inside.take()),
            Some(block) => block.lines.push(line.to_string()),
            None if is_fence => inside = Some(Block { place: format!("{name}:{}", at + 1), mark: std::mem::take(&mut mark), lines: Vec::new() }),
            None => match line.trim().strip_prefix("<!-- ").and_then(|rest| rest.strip_suffix(" -->")) {
                Some(text) => mark = text.trim().to_string(),
                None if line.trim().is_empty() => {}
                None => mark.clear(),
            },
        }
    }
    found
}

/// A folder as a reader of a page has it: the project's files, and those that the page says to save.
pub fn bench(page: &str) -> Bench {
    let bench = Bench::new();
    for folder in ["pipelines", "data", "docs"] {
        std::os::unix::fs::symlink(root().join(folder), bench.path(folder)).expect("a link");
    }
    for block in blocks(page, &read(page)) {
        if let Some(name) = block.mark.strip_prefix("file: ") {
            assert!(Path::new(name).is_relative() && !name.contains(".."), "{}: a file is saved below the root", block.place);
            bench.write(name, &(block.lines.join("\n") + "\n"));
        }
    }
    bench
}
