//! MCAP files, as ROS 2 records them (and Foxglove): the messages of [`crate::rosbag`], in either
//! serialisation of ROS. See [`crate::ros`].
//!
//! A folder of `ros2 bag record` is one of [`crate::rosbag2`]; a folder of MCAP files is read here too.

use crate::declared::Declared;
use crate::error::FormatError;
use crate::format::{Format, Probe};
use crate::recording::Recording;
use crate::ros::{folder, mcap, recording, scan};
use std::path::Path;

/// MCAP.
pub(crate) static FORMAT: Format = Format { id: "mcap", name: "MCAP", recognises, open };

fn recognises(probe: &Probe) -> bool {
    let names = probe.names.as_deref().unwrap_or_default();
    probe.head.starts_with(mcap::MAGIC)
        || probe.has(folder::METADATA) && names.iter().any(|name| name.ends_with(".mcap"))
}

fn open(path: &Path, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    let contents = match &Probe::new(path)?.names {
        Some(names) => folder::open(path, names)?,
        None => mcap::open(path, scan::survey)?,
    };
    recording::open(contents, declared)
}
