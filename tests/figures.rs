//! The tables of README.md and docs/ are what the commands next to them print today.
//!
//! A table whose numbers a command makes has a line before it, invisible on the page:
//!
//! ```text
//! <!-- made by: photocurrent run pipelines/quickstart.toml -->
//! ```
//!
//! What follows it is compared: of a code block every line must stand in the output, in this order and
//! unbroken (`...` at the end of a line stands for the rest of it; a line that begins with `$ ` is the
//! command itself); of a Markdown table the numbers of each row must stand in the output in this order. With
//! `> FILE` at the end the output is that file, below the folder where the command runs, and not what it
//! printed. Files that the page says to save (`<!-- file: NAME -->`) are there. Several commands are joined
//! by ` && `.
//!
//! `made by, slowly:` marks what takes more than some seconds. `make figures` holds those as well:
//! `cargo test --release --test photocurrent figures -- --include-ignored`.
//!
//! What a reader sees: below every table of numbers stands a line that begins with `Made by` and names the
//! command (`` `photocurrent ...` ``, or that which stands above) and, after a semicolon or comma, how long
//! it takes, or that it was `not timed`; or with `No command makes it:` and why.
//!
//! Limits: of a Markdown table, labels are not compared, only numbers; times are not measured again; a table
//! with fewer than a quarter of its cells numbers is none of numbers.

use crate::pages;
use crate::support::root;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;

/// A table in a text, with the command that makes it.
#[derive(Debug, PartialEq)]
struct Figure {
    /// File and line.
    place: String,
    slow: bool,
    command: String,
    lines: Vec<String>,
}

/// The figures of a Markdown text.
fn figures(name: &str, text: &str) -> Vec<Figure> {
    let lines: Vec<&str> = text.lines().collect();
    let mut found = Vec::new();
    for (at, line) in lines.iter().enumerate() {
        let Some(inside) = line.trim().strip_prefix("<!-- made by").and_then(|rest| rest.strip_suffix("-->"))
        else {
            continue;
        };
        let place = format!("{name}:{}", at + 1);
        let (kind, command) =
            inside.split_once(':').unwrap_or_else(|| panic!("{place}: a colon stands before the command"));
        let slow = match kind.trim() {
            "" => false,
            ", slowly" => true,
            other => panic!("{place}: `made by` or `made by, slowly`, and not `made by{other}`"),
        };
        let mut rest = lines[at + 1..].iter().map(|line| line.trim_end()).skip_while(|line| line.is_empty());
        let first = rest.next().unwrap_or_default();
        let body: Vec<&str> = if first.starts_with("```") {
            rest.take_while(|line| *line != "```")
                .filter(|line| !line.starts_with("$ ") && !line.is_empty())
                .collect()
        } else {
            std::iter::once(first).chain(rest).take_while(|line| line.starts_with('|')).collect()
        };
        assert!(!body.is_empty(), "{place}: a code block or a table follows");
        found.push(Figure {
            place,
            slow,
            command: command.trim().into(),
            lines: body.into_iter().map(String::from).collect(),
        });
    }
    found
}

/// All figures of README.md and docs/.
fn all_figures() -> Vec<Figure> {
    pages::names().iter().flat_map(|name| figures(name, &pages::read(name))).collect()
}

/// The numbers with a decimal point that are cells of their own in a row of a Markdown table.
fn numbers(row: &str) -> Vec<String> {
    let cells = row.split('|').map(|cell| cell.trim().trim_matches('*').to_string());
    cells.filter(|cell| cell.contains('.') && cell.parse::<f64>().is_ok()).collect()
}

/// What of a figure the output does not say.
fn difference(figure: &[String], output: &str) -> Option<String> {
    if figure[0].starts_with('|') {
        let words: Vec<&str> = output
            .split(|c: char| c.is_whitespace() || c == '|' || c == ',')
            .map(|word| word.trim_matches('*'))
            .collect();
        for row in figure {
            let mut words = words.iter();
            if let Some(missing) = numbers(row).iter().find(|number| !words.any(|word| word == number)) {
                return Some(format!("{row}\n  {missing} is not there, or not in this order"));
            }
        }
        return None;
    }
    let printed: Vec<&str> = output.lines().map(str::trim_end).filter(|line| !line.is_empty()).collect();
    let alike = |wanted: &String, line: &&str| match wanted.split_once("...") {
        Some((begin, _)) => line.starts_with(begin),
        None => line == wanted,
    };
    let is_there = printed.windows(figure.len().min(printed.len()).max(1)).any(|lines| {
        lines.len() == figure.len() && figure.iter().zip(lines).all(|(wanted, line)| alike(wanted, line))
    });
    (!is_there).then(|| figure.join("\n"))
}

/// Runs the commands of figures, each once, and says what is out of date.
fn hold(slow: bool) {
    let mut by_command: BTreeMap<String, Vec<Figure>> = BTreeMap::new();
    for figure in all_figures().into_iter().filter(|figure| figure.slow == slow) {
        let command = figure.command.split(" > ").next().unwrap_or_default().to_string();
        by_command.entry(command).or_default().push(figure);
    }
    assert!(
        slow || by_command.len() >= 3,
        "README.md and docs/ have tables that are cheap to make: {:?}",
        by_command.keys()
    );
    let mut stale = Vec::new();
    for (command, figures) in by_command {
        let bench = pages::bench(figures[0].place.split(':').next().unwrap_or_default());
        let mut output = String::new();
        for part in command.split(" && ") {
            let words: Vec<&str> = part.split_whitespace().collect();
            assert_eq!(
                words.first(),
                Some(&"photocurrent"),
                "{}: `{part}` is no command of ours",
                figures[0].place
            );
            let done = bench.run(&words[1..]);
            assert_eq!(done.code, 0, "{}: `{part}` failed:\n{}", figures[0].place, done.stderr);
            output += &done.stdout;
        }
        for figure in figures {
            let text = match figure.command.split_once(" > ") {
                Some((_, file)) => fs::read_to_string(bench.path(file.trim()))
                    .unwrap_or_else(|error| panic!("{}: {file}: {error}", figure.place)),
                None => output.clone(),
            };
            if let Some(missing) = difference(&figure.lines, &text) {
                stale.push(format!(
                    "{}: `{}` gives something else than\n{missing}\n\nnamely:\n{}",
                    figure.place,
                    figure.command,
                    text.chars().take(4000).collect::<String>()
                ));
            }
        }
    }
    assert!(
        stale.is_empty(),
        "figures are stale; write down what the commands print:\n\n{}",
        stale.join("\n\n")
    );
}

#[test]
fn figures_that_are_cheap_to_make_are_those_of_today() {
    hold(false);
}

#[test]
#[ignore = "takes minutes; `make figures` runs it"]
fn figures_that_take_longer_are_those_of_today() {
    hold(true);
}

#[test]
fn tables_of_scores_in_the_readme_say_what_makes_them() {
    let marked: BTreeSet<String> = all_figures()
        .into_iter()
        .filter(|figure| figure.place.starts_with("README.md"))
        .flat_map(|figure| figure.lines)
        .collect();
    let readme = fs::read_to_string(root().join("README.md")).expect("README.md");
    // Our tables have a line of dashes under their head.
    let mut lines = readme.lines().peekable();
    while let Some(line) = lines.next() {
        let is_head = lines.peek().is_some_and(|next| next.starts_with("---") && next.contains("  --"));
        assert!(
            !is_head || marked.contains(line),
            "README.md: the table that begins with `{line}` needs a line `<!-- made by: ... -->` before it"
        );
    }
}

/// Is a cell of a table a number, with a unit or a remark?
fn is_number(cell: &str) -> bool {
    let plain = cell.replace("<u>", "").replace("</u>", "").replace(['*', '`', ','], "");
    let first = plain.split_whitespace().next().unwrap_or_default();
    first.parse::<f64>().is_ok()
        && first.contains(|c: char| c.is_ascii_digit())
        && plain.split_whitespace().count() <= 3
}

/// Lines and heads of the tables of numbers in a text, with the line that follows each: of Markdown, and of
/// outputs that a command makes.
fn tables(text: &str) -> Vec<(usize, String, String)> {
    let lines: Vec<&str> = text.lines().collect();
    let after = |from: usize| {
        lines[from.min(lines.len())..].iter().find(|line| !line.trim().is_empty()).unwrap_or(&"").to_string()
    };
    let (mut found, mut at) = (Vec::new(), 0);
    while at < lines.len() {
        let begun = at;
        if lines[at].trim_start().starts_with("```") {
            at += 1
                + lines[at + 1..].iter().take_while(|line| !line.trim_start().starts_with("```")).count()
                + 1;
            // Our own tables have a line of dashes under their head.
            let head = lines[begun..at.min(lines.len())]
                .windows(2)
                .find(|pair| pair[1].starts_with("---") && pair[1].contains("  --"));
            found.extend(head.map(|pair| (begun + 1, pair[0].to_owned(), after(at))));
        } else if lines[at].starts_with('|') {
            at += lines[at..].iter().take_while(|line| line.starts_with('|')).count();
            let cells: Vec<&str> = lines[(begun + 2).min(at)..at]
                .iter()
                .flat_map(|row| row.trim_matches('|').split('|').skip(1))
                .map(str::trim)
                .collect();
            if 4 * cells.iter().filter(|cell| is_number(cell)).count() >= cells.len().max(1) {
                found.push((begun + 1, lines[begun].to_owned(), after(at)));
            }
        } else {
            at += 1;
        }
    }
    found
}

/// Does a line say what makes a table, and how long that takes?
fn says_how(line: &str) -> bool {
    let Some(rest) = line.strip_prefix("Made by ").or_else(|| line.strip_prefix("Means of ")) else {
        return line.starts_with("No command makes it: ");
    };
    let is_named = [
        "`photocurrent ",
        "`cargo ",
        "`python ",
        "above",
        "same command",
        "commands at the top",
        "commands of ",
        "in the table",
    ]
    .iter()
    .any(|by| rest.contains(by));
    let units = ["s", "ms", "minute", "minutes", "hour", "hours", "seconds", "Seconds"];
    let is_timed =
        rest.contains("not timed") || rest.split([' ', '.', ',', ';']).any(|word| units.contains(&word));
    is_named && is_timed
}

#[test]
fn every_table_of_numbers_says_what_makes_it_and_how_long_that_takes() {
    // These pages are written by the program.
    let generated = ["docs/nodes.md", "docs/effects.md"];
    let (mut silent, mut count) = (Vec::new(), 0);
    for name in pages::names().iter().filter(|name| !generated.contains(&name.as_str())) {
        for (line, head, below) in tables(&pages::read(name)) {
            count += 1;
            if !says_how(&below) {
                silent.push(format!("{name}:{line}: {head}"));
            }
        }
    }
    assert!(
        count > 30 && silent.is_empty(),
        "below these tables stands no line `Made by COMMAND; TIME` or `No command makes it: WHY`:\n{}\n",
        silent.join("\n")
    );
}

#[test]
fn tables_of_numbers_and_what_stands_below_them_are_read() {
    let text = "| a | b |\n| --- | --- |\n| x | **2.5** dB |\n\nMade by `photocurrent run a.toml`; 3 \
                s.\n\n| a | b |\n| --- | --- |\n| 0 | done |\n";
    assert_eq!(
        tables(text),
        [(1, "| a | b |".to_owned(), "Made by `photocurrent run a.toml`; 3 s.".to_owned())]
    );
    assert_eq!(tables("```\na  b\n---  ---\n1  2\n```\nx\n"), [(1, "a  b".to_owned(), "x".to_owned())]);
    for good in [
        "Made by `photocurrent run a.toml`; 3 s.",
        "Made by the command above; not timed.",
        "No command makes it: numbers of the paper.",
    ] {
        assert!(says_how(good), "{good}");
    }
    for bad in ["Made by `photocurrent run a.toml`.", "Made by hand; 3 s.", "So it is.", ""] {
        assert!(!says_how(bad), "{bad}");
    }
}

/// The rows of a list of docs/concealed.md: truth, and what was said.
fn concealed(list: &str) -> Vec<(String, String)> {
    let text = pages::read("docs/concealed.md");
    let after = |text: &str, mark: &str| {
        text.split_once(mark).unwrap_or_else(|| panic!("docs/concealed.md has {mark}")).1.to_string()
    };
    let text = after(&text, &format!("## {list}"));
    let rows = text
        .lines()
        .skip_while(|line| !line.starts_with('|'))
        .take_while(|line| line.starts_with('|'))
        .skip(2);
    rows.map(|row| row.split('|').map(|cell| cell.trim().to_string()).collect::<Vec<_>>())
        .map(|cells| (cells[2].clone(), cells[4].clone()))
        .collect()
}

#[test]
fn the_readmes_blind_rates_are_those_of_the_lists() {
    let named = |rows: &[(String, String)]| {
        let holds =
            |(truth, said): &&(String, String)| said.split([',', '(', ' ', '`']).any(|name| name == truth);
        rows.iter().filter(holds).count()
    };
    let (single, nothing) = (concealed("One effect"), concealed("Nothing"));
    let quiet = ["consistent", "insufficient"];
    let false_alarms =
        nothing.iter().filter(|(_, said)| !quiet.iter().any(|word| said.contains(word))).count();
    let undecided = single.iter().filter(|(_, said)| said.contains("insufficient")).count();
    let wanted = format!(
        "{false_alarms} false alarms in {}; of {} effects near the detection limit of known light",
        nothing.len(),
        single.len(),
    );
    let also = format!("{} is named and {undecided} are `insufficient`", named(&single));
    let readme = pages::read("README.md");
    assert!(readme.contains(&wanted) && readme.contains(&also), "README.md should have: {wanted} ... {also}");
}

#[test]
fn a_figure_that_differs_in_a_digit_is_found() {
    let text = "x\n<!-- made by: photocurrent run a.toml -->\n```\n$ photocurrent run a.toml\nlabel  \
                psnr\n-----  ----\nours   1.25\n```\n<!-- made by, slowly: photocurrent run b.toml -->\n\n| \
                a | b |\n| --- | --- |\n| ours (0.3) | **2.50** |\n\ny\n";
    let found = figures("t.md", text);
    assert_eq!(
        (found[0].place.as_str(), found[0].slow, found[0].command.as_str()),
        ("t.md:2", false, "photocurrent run a.toml")
    );
    assert_eq!(found[0].lines, ["label  psnr", "-----  ----", "ours   1.25"]);
    assert_eq!(difference(&found[0].lines, "\nlabel  psnr\n-----  ----\nours   1.25\nEDI    1.00\n"), None);
    // A digit, and a row that is left out in between.
    assert!(difference(&found[0].lines, "label  psnr\n-----  ----\nours   1.26\n").is_some());
    assert!(difference(&found[0].lines, "label  psnr\n-----  ----\nEDI    1.00\nours   1.25\n").is_some());
    assert_eq!(difference(&["{\"a\": 1, ...".into()], "{\"a\": 1, \"b\": 2}\n"), None);
    assert!(found[1].slow && found[1].lines.len() == 3);
    assert_eq!(difference(&found[1].lines, "ours  2.50\n"), None);
    assert!(difference(&found[1].lines, "ours  2.51\n").is_some());
}
