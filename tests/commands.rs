//! The commands in README.md and docs/ do what the pages say.
//!
//! A code block with commands of ours has an invisible line before it:
//!
//! - `<!-- runs -->`: every command is run, in the order of the page, in a folder that has the project's
//!   pipelines, data and docs, and the files that the page says to save (`<!-- file: NAME -->` before their
//!   blocks). What stands below a line `$ command` is output, compared line by line; `...` stands for the
//!   rest of a line, and a line of it alone for any lines. `runs, failing` is for commands that find a
//!   mistake.
//! - `<!-- runs, slowly -->`: the same, for what takes more than some seconds; `make figures` runs it.
//! - `<!-- made by: COMMAND -->`: a table, held by `figures`; its command is run here as well, before those
//!   below it.
//! - `<!-- not run: WHY -->`: for what cannot run here: your file, a cluster, minutes of work.
//!
//! A block of commands without such a line is refused.

use crate::pages::{self, Block};
use crate::support::Bench;

/// What a page has a reader type, without its comment: `photocurrent` and its arguments.
fn command(line: &str) -> Option<&str> {
    let line = line.trim().trim_start_matches("$ ");
    let rest =
        line.strip_prefix("target/release/photocurrent").or_else(|| line.strip_prefix("photocurrent"))?;
    let rest = rest.split(" #").next().unwrap_or_default();
    let first = rest.split_whitespace().next()?;
    (rest.starts_with(' ') && first.chars().all(|c| c.is_ascii_lowercase() || c == '-')).then_some(rest)
}

/// Arguments as a shell takes them apart: quotes hold together.
fn words(text: &str) -> Vec<String> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    for c in text.chars() {
        match quote {
            Some(end) if c == end => quote = None,
            None if c == '\'' || c == '"' => {
                quote = Some(c);
                word.get_or_insert_default();
            }
            None if c == ' ' => words.extend(word.take()),
            _ => word.get_or_insert_default().push(c),
        }
    }
    words.extend(word);
    words
}

/// The commands of a block, each with the output that stands below it.
fn steps(block: &Block) -> Vec<(String, Vec<String>)> {
    let shows_output = block.lines.iter().any(|line| line.starts_with("$ "));
    let mut found: Vec<(String, Vec<String>)> = Vec::new();
    for line in &block.lines {
        let is_command = if shows_output {
            line.starts_with("$ ")
        } else {
            !line.trim().is_empty() && !line.starts_with('#')
        };
        match found.last_mut() {
            _ if is_command => found.push((line.clone(), Vec::new())),
            Some((_, output)) if shows_output => output.push(line.clone()),
            _ => {}
        }
    }
    found
}

/// Do the lines stand in the output, in this order and unbroken but for `...`?
fn shows(output: &str, wanted: &[String]) -> bool {
    let printed: Vec<&str> = output.lines().map(str::trim_end).filter(|line| !line.is_empty()).collect();
    let wanted: Vec<&str> =
        wanted.iter().map(|line| line.trim_end()).filter(|line| !line.is_empty()).collect();
    fn from(printed: &[&str], wanted: &[&str]) -> bool {
        match wanted {
            [] => true,
            ["...", rest @ ..] => (0..=printed.len()).any(|at| from(&printed[at..], rest)),
            [first, rest @ ..] => printed.split_first().is_some_and(|(line, others)| {
                let alike = match first.split_once("...") {
                    Some((begin, _)) => line.starts_with(begin),
                    None => line == first,
                };
                alike && from(others, rest)
            }),
        }
    }
    (0..=printed.len()).any(|at| from(&printed[at..], &wanted))
}

/// Runs a block, and says what of it is not so.
fn run(bench: &Bench, block: &Block) -> Vec<String> {
    // A table is held by `figures`; here its command has run before those below it.
    if let Some(made_by) = block.mark.strip_prefix("made by: ") {
        for arguments in made_by.split(" > ").next().unwrap_or_default().split(" && ").filter_map(command) {
            bench.run(&arguments.split_whitespace().collect::<Vec<_>>());
        }
        return Vec::new();
    }
    let mut wrong = Vec::new();
    for (line, output) in steps(block) {
        let Some(arguments) = command(&line) else {
            panic!("{}: `{line}` is no command of ours: give it a block of its own", block.place)
        };
        let (arguments, file) = match arguments.split_once(" > ") {
            Some((arguments, file)) => (arguments, Some(file.trim())),
            None => (arguments, None),
        };
        let arguments = words(arguments);
        let done = bench.run(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
        if let Some(file) = file {
            bench.write(file, &done.stdout);
        }
        if (done.code == 0) == block.mark.contains("failing") {
            wrong.push(format!(
                "{}: `{line}` ended with exit code {}:\n{}",
                block.place, done.code, done.stderr
            ));
        } else if !output.is_empty()
            && !shows(&format!("{}{}", done.stdout, done.stderr), &output)
            && !shows(&format!("{}{}", done.stderr, done.stdout), &output)
        {
            wrong.push(format!(
                "{}: `{line}` prints something else:\n{}{}",
                block.place, done.stdout, done.stderr
            ));
        }
    }
    wrong
}

fn run_all(slow: bool) {
    let mut wrong = Vec::new();
    let mut count = 0;
    for name in pages::names() {
        let blocks = pages::blocks(&name, &pages::read(&name));
        let wanted: Vec<&Block> =
            blocks.iter().filter(|block| is_run(block) && block.mark.contains("slowly") == slow).collect();
        if wanted.is_empty() {
            continue;
        }
        let bench = pages::bench(&name);
        // What is slow may stand on what is quick.
        for block in blocks.iter().filter(|block| {
            (is_run(block) && (slow || !block.mark.contains("slowly"))) || block.mark.starts_with("made by: ")
        }) {
            wrong.extend(run(&bench, block));
            count += 1;
        }
    }
    assert!(
        count > 0 && wrong.is_empty(),
        "commands of the pages do not do what the pages say:\n\n{}",
        wrong.join("\n\n")
    );
}

fn is_run(block: &Block) -> bool {
    block.mark.split(',').next() == Some("runs")
}

#[test]
fn commands_of_the_pages_run() {
    run_all(false);
}

#[test]
#[ignore = "takes minutes; `make figures` runs it"]
fn commands_of_the_pages_that_take_longer_run() {
    run_all(true);
}

#[test]
fn every_block_of_commands_says_whether_it_is_run() {
    let known = ["runs", "runs, failing", "runs, slowly"];
    let mut silent = Vec::new();
    for name in pages::names() {
        for block in pages::blocks(&name, &pages::read(&name)) {
            let has_commands = block.lines.iter().any(|line| command(line).is_some());
            let is_said = known.contains(&block.mark.as_str())
                || block.mark.starts_with("made by")
                || block.mark.starts_with("not run: ");
            if has_commands && !is_said {
                silent.push(format!("{}: {}", block.place, block.lines[0]));
            }
        }
    }
    assert!(
        silent.is_empty(),
        "a line `<!-- runs -->` (or another of tests/commands.rs) stands before a block of commands:\n{}\n",
        silent.join("\n")
    );
}

#[test]
fn output_that_differs_is_found() {
    let wanted = |text: &str| text.lines().map(String::from).collect::<Vec<_>>();
    assert!(shows("a\nb 1.5 s\nc\nd\n", &wanted("b ...\nc")) && shows("a\nb\nc\nd\n", &wanted("a\n...\nd")));
    assert!(!shows("a\nb\nc\n", &wanted("a\nc")) && !shows("a\n", &wanted("b")) && !shows("", &wanted("a")));
    assert_eq!(words(" run m.toml --set 'a.b=\"x y\"'"), ["run", "m.toml", "--set", "a.b=\"x y\""]);
    assert_eq!(command("$ target/release/photocurrent run a.toml   # now"), Some(" run a.toml  "));
    assert_eq!(command("photocurrent-core"), None);
    let block = &pages::blocks("p", "<!-- runs -->\n```\n$ photocurrent nodes\nkind\n```\n")[0];
    assert_eq!(
        (block.mark.as_str(), steps(block)),
        ("runs", vec![("$ photocurrent nodes".into(), vec!["kind".to_string()])])
    );
}
