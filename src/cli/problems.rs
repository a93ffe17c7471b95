//! Shows mistakes where they stand: file, line, column, caret, what to do. The one place that renders them.
//!
//! A file that is something else than it was taken for can hold a mistake in every line: of one kind, twenty
//! are shown and the rest is counted.

use crate::numbers::{grouped, print_count};
use crate::terminal::{is_terminal, say};
use annotate_snippets::{AnnotationKind, Group, Level, Renderer, Snippet};
use photocurrent_core::document::Problem;
use std::collections::BTreeMap;

/// Mistakes of one kind that are shown.
const SHOWN: usize = 20;

/// Writes all problems to stderr, and how many there are; nothing has run.
pub fn show(problems: &[Problem]) {
    render(problems);
    say!("{}; nothing ran", print_count(problems.len(), "mistake"));
}

/// Writes all problems to stderr.
pub fn render(problems: &[Problem]) {
    let coloured = is_terminal()
        && std::env::var_os("NO_COLOR").is_none()
        && std::env::var_os("TERM").is_none_or(|term| term != "dumb");
    let renderer = if coloured { Renderer::styled() } else { Renderer::plain() };
    let messages: Vec<&str> = problems.iter().map(|problem| problem.message.as_str()).collect();
    let (shown, more) = fewest(&messages);
    shown.iter().for_each(|&at| say!("{}\n", renderer.render(&[group(&problems[at])])));
    more.iter().for_each(|line| say!("{line}\n"));
}

/// Writes mistakes that are reported in a line each.
pub fn lines(lines: &[String]) {
    let messages: Vec<&str> = lines.iter().map(String::as_str).collect();
    let (shown, more) = fewest(&messages);
    shown.iter().for_each(|&at| say!("error: {}", lines[at]));
    more.iter().for_each(|line| say!("{line}"));
}

/// Which of the messages are shown, and a line for each kind of which there are more.
fn fewest(messages: &[&str]) -> (Vec<usize>, Vec<String>) {
    let mut kinds: BTreeMap<String, (usize, usize)> = BTreeMap::new();
    let mut shown = Vec::new();
    for (at, message) in messages.iter().enumerate() {
        let (count, _) = kinds.entry(kind(message)).and_modify(|(count, _)| *count += 1).or_insert((1, at));
        if *count <= SHOWN {
            shown.push(at);
        }
    }
    let mut more: Vec<(usize, usize)> = kinds.into_values().filter(|(count, _)| *count > SHOWN).collect();
    more.sort_by_key(|(_, first)| *first);
    let line = |(count, first): (usize, usize)| {
        let like: String = messages[first].lines().next().unwrap_or_default().chars().take(80).collect();
        format!("and {} more like: {like}", grouped((count - SHOWN) as u64))
    };
    (shown, more.into_iter().map(line).collect())
}

/// A message without its numbers and quoted words: what mistakes of one kind have in common.
fn kind(message: &str) -> String {
    let mut kind = String::new();
    let mut quote = None;
    for c in message.chars() {
        match quote {
            Some(end) if c == end => quote = None,
            Some(_) => {}
            None if c == '`' || c == '"' => quote = Some(c),
            None if c.is_ascii_digit() => {}
            None => kind.push(c),
        }
    }
    kind
}

fn group(problem: &Problem) -> Group<'_> {
    let mut group = Group::with_title(Level::ERROR.primary_title(&problem.message));
    if let Some(at) = &problem.at {
        let text = &at.source.text;
        let end = at.span.end.min(text.len());
        let start = at.span.start.min(end);
        let annotation = AnnotationKind::Primary.span(start..end).label(&problem.label);
        group = group.element(Snippet::source(text).path(at.source.name.as_str()).annotation(annotation));
    }
    group = group.elements(problem.notes.iter().map(|note| Level::NOTE.message(note)));
    group.elements(problem.help.iter().map(|help| Level::HELP.message(help)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_one_kind_twenty_are_shown_and_the_rest_is_counted() {
        let mut messages: Vec<String> = (0..1254).map(|n| format!("line {n}: `word{n}` is no key")).collect();
        messages.insert(700, "something else".into());
        let messages: Vec<&str> = messages.iter().map(String::as_str).collect();
        let (shown, more) = fewest(&messages);
        assert_eq!((shown.len(), shown[19], shown[20]), (21, 19, 700));
        assert_eq!(more, ["and 1,234 more like: line 0: `word0` is no key"]);
        assert_eq!(fewest(&messages[..20]).1, [""; 0]);
    }
}
