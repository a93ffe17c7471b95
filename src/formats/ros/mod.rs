//! Recordings of ROS: bags of ROS 1 and MCAP files of ROS 2, with events and pictures in messages.
//!
//! - [`wire`], [`messages`], [`packets`]: what is in a message: fields, event arrays, event packets, pictures.
//! - [`records`], [`bag`], [`mcap`], [`scan`]: what is in a file: chunks, connections, the index at its end, or none.
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
pub mod mcap;
pub mod messages;
pub mod packets;
pub mod pictures;
pub mod recording;
pub mod records;
pub mod scan;
#[doc(hidden)]
pub mod testing;
pub mod topics;
pub mod walk;
pub mod wire;

#[cfg(test)]
mod tests;

use crate::losses::Losses;
use records::{Container, Topic};
use std::path::{Path, PathBuf};

/// What a file holds, as far as its index says.
pub struct Contents {
    /// The file.
    pub path: PathBuf,
    /// Its size in bytes.
    pub size: u64,
    /// What it is.
    pub container: Container,
    /// Connections; several can belong to one topic.
    pub topics: Vec<Topic>,
    /// Chunks and runs of records, in file order.
    pub pieces: Vec<Piece>,
    /// What it says, for people.
    pub facts: Vec<(String, String)>,
    /// What was damaged.
    pub losses: Losses,
}

impl Contents {
    fn new(path: &Path, size: u64, container: Container) -> Contents {
        Contents { path: path.into(), size, container, topics: Vec::new(), pieces: Vec::new(), facts: Vec::new(), losses: Losses::default() }
    }
}

/// A chunk of messages; or a run of records outside of chunks.
#[derive(Clone, Debug)]
pub struct Piece {
    /// Where its record begins.
    pub at: u64,
    /// Length of a run; `None` for a chunk, whose record states it.
    pub length: Option<u64>,
    /// When its first and its last message were received, ns.
    pub received: (i64, i64),
    /// How many messages of which connection, when known.
    pub counts: Option<Vec<(u32, u64)>>,
}
