//! Files of event cameras and of their frames: recognised by content, read in pieces, never trusted.
//!
//! - [`catalog`]: the one explicit list of all formats, in the order in which a file is held against them.
//! - `format`: what a format is, and how a file is recognised ([`catalog::recognise`]).
//! - `recording`: what an opened file gives: a cursor over its events, pictures by index, triggers, facts,
//!   losses.
//! - `declared`: what a user states because the file cannot: a unit, columns, an exposure.
//! - `chunk`: events as columns, a piece at a time.
//! - [`gather`]: events sorted by row in bounded memory, as nodes take them.
//! - [`evt`]: Prophesee RAW (EVT2, EVT2.1, EVT3) and DAT; [`bias`]: settings of these sensors.
//! - [`survey`]: one pass over a recording: everything that a person, or the judge of hazards, wants to know.
//! - [`hazard`]: what is wrong or unknown, with evidence and what to do.
//! - `rosbag`, `rosbag2`, `mcap`: bags of ROS 1 and 2 and MCAP files, whose messages and chunks [`ros`]
//!   reads.
//! - `error`: why a file is refused, and what was lost of a damaged one.
//! - [`pairings`]: which of several ways to pair pictures with times agrees with the events.
//! - [`joined`]: events of one file with frames of another place; `transfer`: from stored values to linear
//!   ones; [`ycbcr`]: luma and chroma; [`calibration`]: facts of a sensor.
//! - [`placed`]: a mirrored picture, a shift by whole pixels, frames that are left out, as they are stated.
//! - `losses`: what was left out, as a list that stays short.
//! - `convention`: unusual ways of storing events that are no damage; [`instead`]: what a file is that is no
//!   recording.
//! - [`aedat4`], [`aedat3`], `aedat2`, `event_stream`: one module a format.
//!
//! Times are i64 nanoseconds on the file's own clock; x and y are whole event pixels; 1 is ON. A reader holds
//! one piece, whatever the size of the file, and takes no memory that the file only claims to need. What is
//! damaged is left out and reported as a `error::Loss`: what is whole is read.
//!
//! ```
//! use photocurrent_formats::{Declared, EventChunk, TimeUnit, recognise};
//! let folder = tempfile::tempdir().unwrap();
//! let path = folder.path().join("events.csv");
//! std::fs::write(&path, "t,x,y,p\n10,3,1,1\n25,0,2,0\n").unwrap();
//!
//! let format = recognise(&path).unwrap().expect("lines of numbers are events");
//! // The file does not state its unit of time, so the caller does.
//! let declared = Declared { time_unit: Some(TimeUnit::Us), ..Declared::default() };
//! let recording = (format.open)(&path, &declared).unwrap();
//! let (mut cursor, mut events) = (recording.events().unwrap(), EventChunk::default());
//! assert!(cursor.next(&mut events).unwrap());
//! assert_eq!((format.id, events.t, events.on), ("csv", vec![10_000, 25_000], vec![1, 0]));
//! ```

#![cfg_attr(not(test), warn(unreachable_pub))]

mod aedat2;
pub mod aedat3;
pub mod aedat4;
pub mod arrange;
pub mod bias;
pub mod calibration;
pub mod catalog;
mod chunk;
mod convention;
pub mod csv;
mod decimal;
mod declared;
mod error;
mod event_camera_dataset;
mod event_stream;
mod event_utils_memmap;
mod evidence;
pub mod evt;
mod format;
pub mod gather;
pub mod hazard;
pub mod hdf;
mod hs_ergb;
#[cfg(test)]
mod incomplete_tests;
pub mod instead;
pub mod joined;
mod known;
mod lattice;
mod losses;
mod mcap;
mod npy;
mod npz;
pub mod pairings;
pub mod pictures;
pub mod placed;
pub mod places;
mod projection;
mod recording;
mod restamped;
pub mod ros;
mod rosbag;
mod rosbag2;
pub mod survey;
mod text;
mod transfer;
pub mod trim;
mod warped;
pub mod ycbcr;

pub use catalog::{FORMATS, recognise};
pub use chunk::{Edge, EventChunk, Trigger};
pub use declared::{
    Column, Counter, Declared, Mirror, Pairing, Polarity, Shift, StampRole, Strobe, TimeUnit, Transfer,
};
pub use error::{FormatError, Loss};
pub use format::{Format, Probe};
pub use recording::{Convention, EventCursor, EventsAbout, FrameStamp, FramesAbout, Pictures, Recording};
