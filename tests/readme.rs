//! The commands of README.md exist, and the changelog begins with what is not released.

use crate::support::{Bench, root};
use crate::tidy::read;
use std::collections::BTreeSet;

/// The lines of code blocks in a Markdown text.
fn code_lines(text: &str) -> Vec<&str> {
    let mut inside = false;
    let lines = text.lines().filter(|line| {
        let fence = line.trim_start().starts_with("```");
        inside ^= fence;
        inside && !fence
    });
    lines.map(|line| line.trim().trim_start_matches("$ ")).collect()
}

#[test]
fn the_readmes_commands_exist() {
    let readme = read("README.md");
    let makefile = read("Makefile");
    let targets: BTreeSet<&str> = makefile
        .lines()
        .filter(|line| !line.starts_with([' ', '\t', '#', '.']))
        .filter_map(|line| line.split_once(':'))
        .map(|(name, _)| name.trim())
        .collect();
    let help = Bench::new().run(&["--help"]).stdout;
    let mut commands = 0;
    for line in code_lines(&readme) {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["make", ref named @ ..] => {
                for target in named
                    .iter()
                    .take_while(|word| !word.starts_with('#'))
                    .filter(|word| !word.contains('=') && !word.starts_with('-'))
                {
                    assert!(
                        targets.contains(target),
                        "README.md has `{line}`, and the Makefile has no \
                                                       target `{target}`: it has {targets:?}"
                    );
                }
                commands += 1;
            }
            [program, subcommand, ..] if program == "photocurrent" || program.ends_with("/photocurrent") => {
                let known = subcommand.starts_with('-')
                    || help
                        .lines()
                        .any(|l| l.get(15..).is_some_and(|l| l.split(' ').next() == Some(subcommand)));
                assert!(known, "README.md has `{line}`, and there is no command `{subcommand}`");
                let named = words
                    .iter()
                    .take_while(|word| !word.starts_with('#'))
                    .filter(|word| word.starts_with("pipelines/") || word.starts_with("data/"));
                named.for_each(|path| {
                    assert!(root().join(path).exists(), "README.md has `{line}`, and {path} does not exist")
                });
                commands += 1;
            }
            _ => {}
        }
    }
    assert!(commands >= 2, "README.md shows how to run and how to test, as code blocks");
}

#[test]
fn the_changelog_begins_with_what_is_not_released_yet() {
    let changelog = read("CHANGELOG.md");
    let head = changelog.lines().find(|line| line.starts_with("## ")).unwrap_or_default();
    assert!(
        head.to_lowercase().contains("unreleased"),
        "the first heading of CHANGELOG.md is `## Unreleased`, and is `{head}`"
    );
}
