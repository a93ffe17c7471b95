//! What a recording holds, as far as its index states it.

use super::piece::{Container, Topic};
use crate::error::FormatError;
use crate::losses::Losses;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Reads a file through that has no index ([`super::scan::survey`]).
pub(crate) type Survey = fn(Contents) -> Result<Contents, FormatError>;

/// What a recording holds, as far as its index says.
pub(crate) struct Contents {
    /// The file, or the folder of several.
    pub path: PathBuf,
    /// Bytes of all files.
    pub size: u64,
    /// The files, in the order of recording.
    pub parts: Vec<Part>,
    /// Connections; several can belong to one topic.
    pub topics: Vec<Topic>,
    /// Chunks, runs of records and ranges of rows, in file order.
    pub pieces: Vec<Piece>,
    /// All files whose content decides what is read.
    pub files: Vec<PathBuf>,
    /// What it says, for people.
    pub facts: Vec<(String, String)>,
    /// What was damaged.
    pub losses: Losses,
}

impl Contents {
    pub(super) fn new(path: &Path, size: u64, container: Container) -> Contents {
        let part = Part { path: path.into(), container, first_id: 0, before: 0, database: Arc::default() };
        let (topics, pieces, facts, losses) = (Vec::new(), Vec::new(), Vec::new(), Losses::default());
        Contents {
            path: path.into(),
            size,
            parts: vec![part],
            topics,
            pieces,
            files: vec![path.into()],
            facts,
            losses,
        }
    }

    /// Where a piece stands, for messages.
    pub(crate) fn place(&self, piece: usize) -> String {
        let Some(piece) = self.pieces.get(piece) else { return "the end".into() };
        let file = match self.parts.as_slice() {
            [_] => String::new(),
            parts => parts
                .get(piece.file)
                .and_then(|part| part.path.file_name())
                .map(|name| format!("{}, ", name.to_string_lossy()))
                .unwrap_or_default(),
        };
        match piece.rows {
            Some((first, last)) => format!("{file}rows {first} to {last}"),
            None => format!("{file}chunk at byte {}", piece.at),
        }
    }
}

/// One file of a recording.
#[derive(Clone, Debug)]
pub(crate) struct Part {
    /// The file.
    pub path: PathBuf,
    /// What it is.
    pub container: Container,
    /// Added to the numbers of its connections, so that those of several files differ.
    pub first_id: u32,
    /// Bytes of the files before it.
    pub before: u64,
    /// What is known of it when it is a database.
    pub database: Arc<Database>,
}

/// A chunk of messages; or a run of records outside of chunks; or a range of rows.
#[derive(Clone, Debug)]
pub(crate) struct Piece {
    /// Which file of the recording it is in.
    pub file: usize,
    /// Where its record begins; of rows, about where they stand.
    pub at: u64,
    /// Length of a run; `None` for a chunk, whose record states it.
    pub length: Option<u64>,
    /// Numbers of its first and its last row, in a database.
    pub rows: Option<(i64, i64)>,
    /// When its first and its last message were received, ns.
    pub received: (i64, i64),
    /// How many messages of which connection, when known.
    pub counts: Option<Vec<(u32, u64)>>,
}

/// What is known of a database, for those who read its rows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Database {
    /// Is the file shorter than its header says?
    pub(super) cut: bool,
    /// Numbers in `topics`, and what messages call them here.
    pub(super) ids: BTreeMap<i64, u32>,
}
