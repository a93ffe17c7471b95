//! Bags of ROS 2: a folder of `ros2 bag record` (`metadata.yaml` and files of messages, SQLite or MCAP), or
//! one SQLite file (`.db3`) of it.
//!
//! The messages are those of [`crate::mcap`]. See [`crate::ros`], in it [`crate::ros::folder`] and
//! [`crate::ros::sqlite`].
//!
//! Limits: a file that was compressed as a whole (`.db3.zstd`) is recognised and refused; messages that were
//! compressed one by one are read.

use crate::declared::Declared;
use crate::error::FormatError;
use crate::format::{Format, Probe};
use crate::recording::Recording;
use crate::ros::{folder, recording, sqlite};
use std::path::Path;

/// ROS 2 bag.
pub(crate) static FORMAT: Format =
    Format { id: "rosbag2", name: "ROS 2 bag (folder, or SQLite)", recognises, open };

fn recognises(probe: &Probe) -> bool {
    let names = probe.names.as_deref().unwrap_or_default();
    let is_bag = probe.has(folder::METADATA) && names.iter().any(|name| folder::is_storage(name));
    is_bag
        || names.iter().any(|name| name.ends_with(".db3"))
        || probe.head.starts_with(sqlite::MAGIC)
        || folder::packed_kind(&probe.head).is_some()
}

fn open(path: &Path, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    let probe = Probe::new(path)?;
    let contents = match &probe.names {
        Some(names) => folder::open(path, names)?,
        None => folder::open_file(path)?,
    };
    recording::open(contents, declared)
}
