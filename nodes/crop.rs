//! A rectangle of a picture, as a parameter.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A part of a frame, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Crop {
    /// Leftmost column, counted from 0.
    pub x: u32,
    /// Topmost row, counted from 0.
    pub y: u32,
    /// Number of columns, 1 or more.
    #[schemars(range(min = 1))]
    pub width: u32,
    /// Number of rows, 1 or more.
    #[schemars(range(min = 1))]
    pub height: u32,
}
