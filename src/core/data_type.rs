//! The kinds of value that flow between nodes.

use serde::{Deserialize, Serialize};
use std::fmt;

/// The kinds of value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DataType {
    /// An event stream.
    Events,
    /// Captured or rendered frames.
    Frames,
    /// True frames of simulated data; only scorers take them.
    Truth,
    /// Photocurrent tracks.
    Tracks,
    /// Light on the pixels, as a scene gives it.
    Light,
    /// A sensor description.
    Sensor,
    /// Named planes of one number per pixel.
    Map,
    /// Named columns.
    Table,
    /// What a stage of a diagnosis found.
    Diagnosis,
}

impl DataType {
    /// The name in manifests, records and graphs.
    pub fn name(self) -> &'static str {
        match self {
            DataType::Events => "events",
            DataType::Frames => "frames",
            DataType::Truth => "truth",
            DataType::Tracks => "tracks",
            DataType::Light => "light",
            DataType::Sensor => "sensor",
            DataType::Map => "map",
            DataType::Table => "table",
            DataType::Diagnosis => "diagnosis",
        }
    }

    /// Version of the layout, as it enters a key: a change makes every consumer's key new.
    pub fn layout_version(self) -> u32 {
        1
    }

    /// Does a window of time leave a part of such values? All others stay whole.
    pub fn has_windows(self) -> bool {
        matches!(self, DataType::Events | DataType::Frames)
    }
}

impl fmt::Display for DataType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
