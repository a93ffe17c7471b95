//! A frame of the sheet, and which part of it is shown.

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

/// A frame that is shown.
pub(super) struct Shown {
    pub(super) frame: usize,
    pub(super) t_ns: i64,
    /// Values as [row][x][channel].
    pub(super) dn: Vec<f32>,
}

impl Shown {
    /// The same light as a frame of another exposure would read it.
    pub(super) fn exposed(&mut self, from_ns: i64, to_ns: i64, black: f64) {
        if from_ns != to_ns {
            let ratio = to_ns as f64 / from_ns as f64;
            self.dn.iter_mut().for_each(|dn| *dn = (black + (f64::from(*dn) - black) * ratio) as f32);
        }
    }
}
