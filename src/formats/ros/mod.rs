//! Recordings of ROS: bags of ROS 1, and MCAP files and SQLite databases of ROS 2, with events and pictures
//! in messages.
//!
//! - [`wire`], [`messages`], [`packets`]: what is in a message: fields, event arrays, event packets,
//!   pictures.
//! - [`contents`], [`piece`], [`records`], [`bag`], [`mcap`], [`sqlite`], [`scan`]: what is in a file:
//!   chunks, connections, the index at its end, or none; [`folder`]: bags of several files.
//! - [`walk`]: from message to message.
//! - [`topics`]: which topic the events and the pictures come from.
//! - [`clock`]: from the sensor's clock to that of ROS.
//! - [`events`], [`pictures`], [`recording`]: what a reader is given.
//! - [`testing`]: a writer of small bags and MCAP files, for tests.
//!
//! **Clocks.** Messages of ROS carry `header.stamp` on the clock of the host. Events of `dvs_msgs` and of
//! libcaer do so too. Packets of Prophesee sensors hold the sensor's own time, which cannot be compared with
//! the stamps of pictures. Their events are therefore moved by one constant, see [`clock`]: intervals between
//! events stay what the sensor measured, and what the two clocks drift apart stays visible as an offset
//! between events and pictures.
//!
//! **Memory.** One message, and the window of a decompressor; an index costs some bytes a chunk, pictures
//! some bytes each. Why not the crates `rosbag` and `mcap`: the first maps the whole file, which ends the
//! program when the file shrinks meanwhile, needs an index, and allocates what a chunk claims; the second
//! stops at the first damaged record and would be a second way through the same messages.

pub(crate) mod bag;
pub(crate) mod clock;
pub(crate) mod contents;
pub(crate) mod events;
pub(crate) mod folder;
pub(crate) mod mcap;
pub(crate) mod messages;
mod packed;
pub(crate) mod packets;
pub(crate) mod pictures;
pub(crate) mod piece;
pub(crate) mod recording;
pub(crate) mod records;
pub(crate) mod scan;
pub(crate) mod sqlite;
#[doc(hidden)]
pub mod testing;
pub(crate) mod topics;
pub(crate) mod walk;
pub(crate) mod wire;

#[cfg(test)]
mod rosbag2_tests;
#[cfg(test)]
mod tests;
