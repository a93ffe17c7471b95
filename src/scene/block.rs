//! A rectangle of an array's pixels.

use photocurrent_core::Extent;
use serde::{Deserialize, Serialize};

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Block {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Block {
    /// The whole array.
    pub fn whole_array(extent: Extent) -> Block {
        Block { x: 0, y: 0, width: extent.width as usize, height: extent.height as usize }
    }

    /// Its pixels as `y * width + x` of the array, row by row.
    pub fn pixels(&self, extent: Extent) -> Vec<u32> {
        let Block { x, y, width, height } = *self;
        let of_row = |y: usize| (x..x + width).map(move |x| (y * extent.width as usize + x) as u32);
        (y..y + height).flat_map(of_row).collect()
    }
}
