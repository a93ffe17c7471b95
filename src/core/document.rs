//! TOML with its positions kept, so that every mistake can be shown where it stands.
//!
//! Converting a `toml::Table` to a struct loses the spans. So a text becomes a [`Tree`] whose every key and
//! value knows its origin; manifests overlay such trees, [`crate::schema`] checks them, and only what passed
//! is turned into a struct. A mistake is a [`Problem`]: data, rendered in one place by the command.

use std::fmt;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

/// A text and where it came from.
#[derive(Debug, PartialEq, Eq)]
pub struct Source {
    /// As shown to the reader: a path, or `--set`.
    pub name: String,
    /// Folder that relative paths in it start from.
    pub folder: PathBuf,
    /// The text itself.
    pub text: String,
}

impl Source {
    /// Shared, because every value points to it.
    pub fn new(name: impl Into<String>, folder: impl Into<PathBuf>, text: impl Into<String>) -> Arc<Source> {
        Arc::new(Source { name: name.into(), folder: folder.into(), text: text.into() })
    }
}

/// A place in a text.
#[derive(Clone, PartialEq, Eq)]
pub struct Origin {
    /// Which text.
    pub source: Arc<Source>,
    /// Bytes in it.
    pub span: Range<usize>,
}

impl Origin {
    /// Line and column of the start, both from 1; the column counts characters.
    pub fn line_column(&self) -> (usize, usize) {
        let before = &self.source.text[..self.span.start.min(self.source.text.len())];
        let line_start = before.rfind('\n').map_or(0, |at| at + 1);
        (before.matches('\n').count() + 1, before[line_start..].chars().count() + 1)
    }
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (line, column) = self.line_column();
        write!(f, "{}:{line}:{column}", self.source.name)
    }
}

impl fmt::Debug for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")
    }
}

/// A mistake in a text, or in what it asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// What is wrong, in one sentence without a full stop.
    pub message: String,
    /// Where.
    pub at: Option<Origin>,
    /// Short text at the caret.
    pub label: String,
    /// Facts behind it.
    pub notes: Vec<String>,
    /// What to do.
    pub help: Option<String>,
}

impl Problem {
    /// At a place.
    pub fn at(origin: &Origin, message: impl Into<String>) -> Problem {
        Problem { at: Some(origin.clone()), ..Problem::new(message) }
    }

    /// At no place.
    pub fn new(message: impl Into<String>) -> Problem {
        Problem { message: message.into(), at: None, label: String::new(), notes: Vec::new(), help: None }
    }

    /// Adds the text at the caret.
    pub fn label(mut self, label: impl Into<String>) -> Problem {
        self.label = label.into();
        self
    }

    /// Adds a fact.
    pub fn note(mut self, note: impl Into<String>) -> Problem {
        self.notes.push(note.into());
        self
    }

    /// Says what to do.
    pub fn help(mut self, help: impl Into<String>) -> Problem {
        self.help = Some(help.into());
        self
    }

    /// Suggests the known name nearest to `found`, when one is near.
    pub fn did_you_mean<'a>(self, found: &str, known: impl IntoIterator<Item = &'a str>) -> Problem {
        let known: Vec<&str> = known.into_iter().collect();
        match nearest(found, known.iter().copied()) {
            Some(name) => self.help(format!("did you mean `{name}`?")),
            None if known.is_empty() => self,
            None => self.note(format!("known: {}", known.join(", "))),
        }
    }
}

/// The known name nearest to `found`, when it is near enough to be a slip of the hand: less than half of the
/// letters differ, and of a long name few.
pub fn nearest<'a>(found: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    known
        .into_iter()
        .map(|name| (strsim::damerau_levenshtein(found, name), name))
        .filter(|(distance, name)| {
            let longer = name.chars().count().max(found.chars().count());
            *distance <= 1 + longer / 4 && 2 * *distance < longer
        })
        .min()
        .map(|(_, name)| name)
}

/// A key or value with its place.
#[derive(Clone, Debug, PartialEq)]
pub struct Tree {
    /// What it is.
    pub item: Item,
    /// Where it stands.
    pub origin: Origin,
}

/// What a value is.
#[derive(Clone, Debug, PartialEq)]
pub enum Item {
    /// A text.
    String(String),
    /// A whole number.
    Integer(i64),
    /// A number with a point or exponent.
    Float(f64),
    /// `true` or `false`.
    Boolean(bool),
    /// A date; nothing here takes one, but the message should say so.
    Datetime(String),
    /// A list.
    Array(Vec<Tree>),
    /// A table.
    Table(Table),
}

/// A key and where it stands.
#[derive(Clone, Debug, PartialEq)]
pub struct Key {
    /// The name.
    pub name: String,
    /// Where it stands.
    pub origin: Origin,
}

/// Keys and values in written order.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Table {
    /// The entries; no key twice.
    pub entries: Vec<(Key, Tree)>,
}

impl Table {
    /// The value of a key.
    pub fn get(&self, name: &str) -> Option<&Tree> {
        self.entries.iter().find(|(key, _)| key.name == name).map(|(_, tree)| tree)
    }

    /// The value of a key, to change.
    pub fn get_mut(&mut self, name: &str) -> Option<&mut Tree> {
        self.entries.iter_mut().find(|(key, _)| key.name == name).map(|(_, tree)| tree)
    }

    /// The key itself, with its place.
    pub fn key(&self, name: &str) -> Option<&Key> {
        self.entries.iter().map(|(key, _)| key).find(|key| key.name == name)
    }

    /// Sets a key, keeping its position when it exists.
    pub fn set(&mut self, key: Key, tree: Tree) {
        match self.entries.iter_mut().find(|(k, _)| k.name == key.name) {
            Some(entry) => *entry = (key, tree),
            None => self.entries.push((key, tree)),
        }
    }

    /// Takes a key out.
    pub fn remove(&mut self, name: &str) -> Option<(Key, Tree)> {
        let at = self.entries.iter().position(|(key, _)| key.name == name)?;
        Some(self.entries.remove(at))
    }
}

impl Tree {
    /// The table, when it is one.
    pub fn as_table(&self) -> Option<&Table> {
        match &self.item {
            Item::Table(table) => Some(table),
            _ => None,
        }
    }

    /// The text, when it is one.
    pub fn as_str(&self) -> Option<&str> {
        match &self.item {
            Item::String(text) => Some(text),
            _ => None,
        }
    }

    /// "the integer 3", "a table": for messages.
    pub fn describe(&self) -> String {
        match &self.item {
            Item::String(text) if text.chars().count() <= 40 => format!("the text \"{text}\""),
            Item::String(_) => "a long text".into(),
            Item::Integer(number) => format!("the integer {number}"),
            Item::Float(number) => format!("the number {number:?}"),
            Item::Boolean(value) => format!("`{value}`"),
            Item::Datetime(date) => format!("the date {date}"),
            Item::Array(_) => "a list".into(),
            Item::Table(_) => "a table".into(),
        }
    }
}

/// Parses TOML, keeping every place.
///
/// # Errors
/// Every syntax mistake found, not only the first.
#[cfg(feature = "graph")]
pub fn parse(source: &Arc<Source>) -> Result<Table, Vec<Problem>> {
    let (root, errors) = toml::de::DeTable::parse_recoverable(&source.text);
    let mut problems: Vec<Problem> = errors
        .iter()
        .map(|error| {
            let span = error.span().unwrap_or(0..0);
            let message = match error.message().trim_end() {
                "duplicate key" => {
                    format!("not TOML: `{}` stands twice", source.text.get(span.clone()).unwrap_or_default())
                }
                other => format!("not TOML: {other}"),
            };
            Problem::at(&Origin { source: source.clone(), span }, message)
        })
        .collect();
    let table = convert_table(source, root.get_ref(), &mut problems);
    problems.sort_by_key(|problem| problem.at.as_ref().map(|at| at.span.start));
    if problems.is_empty() { Ok(table) } else { Err(problems) }
}

#[cfg(feature = "graph")]
fn convert_table(source: &Arc<Source>, table: &toml::de::DeTable<'_>, problems: &mut Vec<Problem>) -> Table {
    let mut entries: Vec<(Key, Tree)> = table
        .iter()
        .map(|(key, value)| {
            let key = Key {
                name: key.get_ref().to_string(),
                origin: Origin { source: source.clone(), span: key.span() },
            };
            (key, convert(source, value, problems))
        })
        .collect();
    entries.sort_by_key(|(key, _)| key.origin.span.start);
    Table { entries }
}

#[cfg(feature = "graph")]
fn convert(
    source: &Arc<Source>,
    value: &serde_spanned::Spanned<toml::de::DeValue<'_>>,
    problems: &mut Vec<Problem>,
) -> Tree {
    use toml::de::DeValue;
    let origin = Origin { source: source.clone(), span: value.span() };
    let item = match value.get_ref() {
        DeValue::String(text) => Item::String(text.to_string()),
        DeValue::Integer(number) => {
            let parsed = i64::from_str_radix(number.as_str(), number.radix());
            Item::Integer(parsed.unwrap_or_else(|_| {
                problems.push(Problem::at(&origin, "a number beyond 64 bits").label("does not fit"));
                0
            }))
        }
        DeValue::Float(number) => Item::Float(number.as_str().parse().unwrap_or(f64::NAN)),
        DeValue::Boolean(value) => Item::Boolean(*value),
        DeValue::Datetime(date) => Item::Datetime(date.to_string()),
        DeValue::Array(items) => {
            Item::Array(items.iter().map(|item| convert(source, item, problems)).collect())
        }
        DeValue::Table(table) => Item::Table(convert_table(source, table, problems)),
    };
    Tree { item, origin }
}

#[cfg(all(test, feature = "graph"))]
mod tests {
    use super::*;

    fn source(text: &str) -> Arc<Source> {
        Source::new("m.toml", "", text)
    }

    #[test]
    fn every_value_knows_its_place() {
        let table = parse(&source("a = 1\n[b]\nc = \"\u{b5}x\" # why\n  d = [2.5, true]\n")).unwrap();
        let b = table.get("b").unwrap().as_table().unwrap();
        assert_eq!(b.get("c").unwrap().origin.to_string(), "m.toml:3:5");
        let Item::Array(items) = &b.get("d").unwrap().item else { panic!("d is a list") };
        assert_eq!(items[1].origin.to_string(), "m.toml:4:13");
        assert_eq!(items[0].item, Item::Float(2.5));
    }

    #[test]
    fn every_syntax_mistake_is_found() {
        let problems = parse(&source("a = \nb = 1\nc = ]\n")).unwrap_err();
        let lines: Vec<usize> = problems.iter().map(|p| p.at.as_ref().unwrap().line_column().0).collect();
        assert!(lines.contains(&1) && lines.contains(&3), "{problems:?}");
    }

    #[test]
    fn a_slip_finds_its_word_and_a_stranger_does_not() {
        let known = ["cis_weight", "evs_weight", "readout"];
        assert_eq!(nearest("cis_wieght", known), Some("cis_weight"));
        assert_eq!(nearest("colour", known), None);
        assert_eq!((nearest("none", ["off", "on"]), nearest("of", ["off", "on"])), (None, Some("off")));
    }
}
