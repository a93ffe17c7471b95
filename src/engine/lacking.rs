//! What the sensor descriptions of a plan lack, reported in one piece: the fields, who needs each, where they
//! belong, and how they are written.

use photocurrent_core::document::{Origin, Problem, Source};
use photocurrent_core::lacking::{as_toml, needed};
use std::path::PathBuf;

/// One description and what nodes found missing in it.
pub(crate) struct Lacking {
    /// The node that gives it.
    pub from: String,
    /// The file it is read from.
    pub file: Option<PathBuf>,
    /// Field and the nodes that need it, in the order in which they were asked for.
    pub fields: Vec<(String, Vec<String>)>,
    /// How often somebody was refused.
    pub refusals: usize,
}

impl Lacking {
    /// Notes that `node` needs `fields`.
    pub(crate) fn add(&mut self, fields: &[String], node: &str) {
        self.refusals += 1;
        for field in fields {
            match self.fields.iter_mut().find(|(known, _)| known == field) {
                Some((_, nodes)) if nodes.iter().all(|known| known != node) => nodes.push(node.into()),
                Some(_) => {}
                None => self.fields.push((field.clone(), vec![node.into()])),
            }
        }
    }

    /// All of it as one mistake; `None` when a single refusal said all there is to say.
    pub(crate) fn problem(&self) -> Option<Problem> {
        if self.refusals < 2 || self.fields.is_empty() {
            return None;
        }
        let text = self
            .file
            .as_ref()
            .filter(|file| file.extension().is_some_and(|e| e == "toml"))
            .and_then(|file| std::fs::read_to_string(file).ok());
        let source =
            self.file.as_ref().zip(text).map(|(file, text)| Source::new(file.to_string_lossy(), "", text));
        let count = self.fields.len();
        let fields = if count == 1 { "1 field".into() } else { format!("{count} fields") };
        let of = self
            .file
            .as_ref()
            .map_or(format!("of the node `{}`", self.from), |file| format!("in {}", file.display()));
        let message = format!("in all, the sensor description {of} lacks {fields} that this pipeline needs");
        let mut problem = match &source {
            Some(source) => Problem::at(
                &Origin {
                    source: source.clone(),
                    span: 0..source.text.find('\n').unwrap_or(source.text.len()),
                },
                message,
            ),
            None => Problem::new(message),
        };
        for (path, nodes) in &self.fields {
            let about = needed(path).map(|needed| format!(": {}", needed.about)).unwrap_or_default();
            let table = path.split_once('.').map_or("", |(table, _)| table);
            let place = source
                .as_ref()
                .and_then(|source| source.text.lines().position(|line| line.trim() == format!("[{table}]")));
            let place = place
                .map(|line| format!("; its table [{table}] stands in line {}", line + 1))
                .unwrap_or_default();
            problem = problem.note(format!("`{path}`{about}; for {}{place}", nodes.join(", ")));
        }
        let paths: Vec<String> = self.fields.iter().map(|(path, _)| path.clone()).collect();
        Some(problem.help(format!(
            "state them as your sensor has them (the values here are examples):\n{}",
            as_toml(&paths).trim_end()
        )))
    }
}
