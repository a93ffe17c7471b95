//! Shows mistakes where they stand: file, line, column, caret, what to do. The one place that renders them.

use annotate_snippets::{AnnotationKind, Group, Level, Renderer, Snippet};
use photocurrent_core::document::Problem;
use std::io::IsTerminal;

/// Writes all problems to stderr, and how many there are.
pub fn show(problems: &[Problem]) {
    let coloured = std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none() && std::env::var_os("TERM").is_none_or(|term| term != "dumb");
    let renderer = if coloured { Renderer::styled() } else { Renderer::plain() };
    for problem in problems {
        eprintln!("{}\n", renderer.render(&[group(problem)]));
    }
    let (count, what) = (problems.len(), if problems.len() == 1 { "mistake" } else { "mistakes" });
    eprintln!("{count} {what}; nothing ran");
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
