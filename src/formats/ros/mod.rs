//! Recordings of ROS: bags of ROS 1, and MCAP files and SQLite databases of ROS 2, with events and pictures in messages.
//!
//! - [`wire`], [`messages`], [`packets`]: what is in a message: fields, event arrays, event packets, pictures.
//! - [`records`], [`bag`], [`mcap`], [`sqlite`], [`scan`]: what is in a file: chunks, connections, the index at its end, or none; [`folder`]: bags of several files.
//! - [`walk`]: from message to message.
//! - [`topics`]: which topic the events and the pictures come from.
//! - [`clock`]: from the sensor's clock to that of ROS.
//! - [`events`], [`pictures`], [`recording`]: what a reader is given.
//! - [`testing`]: a writer of small bags and MCAP files, for tests.
//!
//! **Clocks.** Messages of ROS carry `header.stamp` on the clock of the host. Events of `dvs_msgs` and of libcaer do so too. Packets of Prophesee sensors hold
//! the sensor's own time, which cannot be compared with the stamps of pictures. Their events are therefore moved by one constant, see [`clock`]: intervals between
//! events stay what the sensor measured, and what the two clocks drift apart stays visible as an offset between events and pictures.
//!
//! **Memory.** One message, and the window of a decompressor; an index costs some bytes a chunk, pictures some bytes each.
//! Why not the crates `rosbag` and `mcap`: the first maps the whole file, which ends the program when the file shrinks meanwhile, needs an index, and allocates
//! what a chunk claims; the second stops at the first damaged record and would be a second way through the same messages.

pub mod bag;
pub mod clock;
pub mod events;
pub mod folder;
pub mod mcap;
pub mod messages;
mod packed;
pub mod packets;
pub mod pictures;
pub mod recording;
pub mod records;
pub mod scan;
pub mod sqlite;
#[doc(hidden)]
pub mod testing;
pub mod topics;
pub mod walk;
pub mod wire;

#[cfg(test)]
mod rosbag2_tests;
#[cfg(test)]
mod tests;

use crate::losses::Losses;
use records::{Container, Topic};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What a recording holds, as far as its index says.
pub struct Contents {
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
    fn new(path: &Path, size: u64, container: Container) -> Contents {
        let part = Part { path: path.into(), container, first_id: 0, before: 0, database: Arc::default() };
        let (topics, pieces, facts, losses) = (Vec::new(), Vec::new(), Vec::new(), Losses::default());
        Contents { path: path.into(), size, parts: vec![part], topics, pieces, files: vec![path.into()], facts, losses }
    }

    /// Where a piece stands, for messages.
    pub fn place(&self, piece: usize) -> String {
        let Some(piece) = self.pieces.get(piece) else { return "the end".into() };
        let file = match self.parts.as_slice() {
            [_] => String::new(),
            parts => parts.get(piece.file).and_then(|part| part.path.file_name()).map(|name| format!("{}, ", name.to_string_lossy())).unwrap_or_default(),
        };
        match piece.rows {
            Some((first, last)) => format!("{file}rows {first} to {last}"),
            None => format!("{file}chunk at byte {}", piece.at),
        }
    }
}

/// One file of a recording.
#[derive(Clone, Debug)]
pub struct Part {
    /// The file.
    pub path: PathBuf,
    /// What it is.
    pub container: Container,
    /// Added to the numbers of its connections, so that those of several files differ.
    pub first_id: u32,
    /// Bytes of the files before it.
    pub before: u64,
    /// What is known of it when it is a database.
    pub database: Arc<sqlite::Database>,
}

/// A chunk of messages; or a run of records outside of chunks; or a range of rows.
#[derive(Clone, Debug)]
pub struct Piece {
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
