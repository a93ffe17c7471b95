//! The pages of README.md and docs/, and the code blocks in them.

use crate::support::{Bench, root};
use std::collections::BTreeSet;
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
            None if is_fence => {
                inside = Some(Block {
                    place: format!("{name}:{}", at + 1),
                    mark: std::mem::take(&mut mark),
                    lines: Vec::new(),
                })
            }
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
            assert!(
                Path::new(name).is_relative() && !name.contains(".."),
                "{}: a file is saved below the root",
                block.place
            );
            bench.write(name, &(block.lines.join("\n") + "\n"));
        }
    }
    bench
}

/// The anchor of a heading, as GitHub makes it.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().chars().filter(|c| c.is_alphanumeric() || [' ', '-', '_'].contains(c));
    kept.collect::<String>().to_lowercase().replace(' ', "-")
}

/// The anchors of a text: its headings, outside of code blocks.
fn anchors(text: &str) -> BTreeSet<String> {
    let mut inside = false;
    let lines = text.lines().filter(|line| {
        inside ^= line.trim_start().starts_with("```");
        !inside && line.starts_with('#')
    });
    lines.map(|line| anchor(line.trim_start_matches('#'))).collect()
}

/// The targets of links in a text, outside of code.
fn links(text: &str) -> Vec<String> {
    let mut inside = false;
    let mut found = Vec::new();
    for line in text.lines() {
        inside ^= line.trim_start().starts_with("```");
        // What stands between single back-ticks is code.
        let line: String = line.split('`').step_by(2).collect();
        if !inside {
            found.extend(
                line.split("](").skip(1).filter_map(|rest| Some(rest.split_once(')')?.0.to_string())),
            );
        }
    }
    found
}

#[test]
fn no_link_is_dead() {
    let mut pages = names();
    pages.extend(
        [
            "CHANGELOG.md",
            "CONTRIBUTING.md",
            "data/README.md",
            "data/concealed/README.md",
            "data/diagnosis/README.md",
            "data/recordings/README.md",
        ]
        .map(String::from),
    );
    let (mut dead, mut count) = (Vec::new(), 0);
    for name in &pages {
        let text = read(name);
        let folder = Path::new(name).parent().unwrap_or(Path::new(""));
        for link in
            links(&text).into_iter().filter(|link| !link.contains("://") && !link.starts_with("mailto:"))
        {
            count += 1;
            let (file, heading) =
                link.split_once('#').map_or((link.as_str(), None), |(file, heading)| (file, Some(heading)));
            let path = root().join(folder).join(file);
            if !file.is_empty() && !path.exists() {
                dead.push(format!("{name}: {link}: there is no such file"));
            } else if let Some(heading) = heading {
                let target = if file.is_empty() {
                    text.clone()
                } else {
                    fs::read_to_string(&path).unwrap_or_default()
                };
                if !anchors(&target).contains(heading) {
                    dead.push(format!("{name}: {link}: there is no such heading"));
                }
            }
        }
    }
    assert!(count > 100 && dead.is_empty(), "dead links:\n{}\n", dead.join("\n"));
}

#[test]
fn links_and_headings_are_read_as_they_are_shown() {
    assert_eq!(anchor(" `method = \"map\"`, in short"), "method--map-in-short");
    assert_eq!(links("see [a](b.md#c) and `[no](link)`\n```\n[none](x)\n```\n[d](e)"), ["b.md#c", "e"]);
    assert!(anchors("# One two\n```\n# no\n```\n## Three").contains("three"));
}
