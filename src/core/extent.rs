//! How large the sensor is, and which of its rows are meant.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Width and height of the pixel array.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Extent {
    /// Pixels in a row; `x` runs over `0..width`.
    pub width: u32,
    /// Rows; `y` runs over `0..height`.
    pub height: u32,
}

impl Extent {
    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// How many of these pixels lie along the side of one of `coarse`; `None` when it is no whole number, or
    /// another one for width and height.
    ///
    /// ```
    /// use photocurrent_core::Extent;
    /// let of = |width, height| Extent { width, height };
    /// assert_eq!(of(12, 8).multiple_of(of(3, 2)), Some(4));
    /// assert_eq!(of(12, 8).multiple_of(of(6, 8)), None);
    /// ```
    pub fn multiple_of(&self, coarse: Extent) -> Option<u32> {
        let ratio = self.width.checked_div(coarse.width)?;
        (ratio > 0
            && coarse.width.checked_mul(ratio) == Some(self.width)
            && coarse.height.checked_mul(ratio) == Some(self.height))
        .then_some(ratio)
    }

    /// All rows.
    pub fn rows(&self) -> Rows {
        Rows { start: 0, end: self.height }
    }
}

impl fmt::Display for Extent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} x {}", self.width, self.height)
    }
}

/// A band of rows, `start <= y < end`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Rows {
    /// First row inside.
    pub start: u32,
    /// First row after.
    pub end: u32,
}

impl Rows {
    /// Number of rows.
    pub fn len(&self) -> usize {
        self.end.saturating_sub(self.start) as usize
    }

    /// No row at all?
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Are all rows of `other` in here?
    pub fn contains(&self, other: Rows) -> bool {
        other.is_empty() || (self.start <= other.start && other.end <= self.end)
    }

    /// The rows that are in both.
    pub fn intersect(&self, other: Rows) -> Rows {
        let start = self.start.max(other.start);
        Rows { start, end: self.end.min(other.end).max(start) }
    }

    /// Grown by `halo` rows on both sides, inside `limit`.
    pub fn with_halo(&self, halo: u32, limit: Rows) -> Rows {
        Rows { start: self.start.saturating_sub(halo), end: self.end.saturating_add(halo) }.intersect(limit)
    }

    /// Cut into bands of at most `height` rows, top to bottom. A `height` of 0 counts as 1.
    pub fn bands(&self, height: u32) -> Vec<Rows> {
        let height = height.max(1);
        let mut bands = Vec::new();
        let mut start = self.start;
        while start < self.end {
            let end = self.end.min(start.saturating_add(height));
            bands.push(Rows { start, end });
            start = end;
        }
        bands
    }

    /// The row numbers.
    pub fn iter(&self) -> std::ops::Range<u32> {
        self.start..self.end
    }
}

impl fmt::Display for Rows {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "rows {}..{}", self.start, self.end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_cover_every_row_once() {
        let all = Rows { start: 3, end: 20 };
        for height in 0..30 {
            let rows: Vec<u32> = all.bands(height).iter().flat_map(Rows::iter).collect();
            assert_eq!(rows, (3..20).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_halo_stays_on_the_sensor() {
        let limit = Rows { start: 0, end: 10 };
        assert_eq!(Rows { start: 1, end: 9 }.with_halo(3, limit), limit);
    }
}
