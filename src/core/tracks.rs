//! Tracks: the photocurrent of every pixel over time, what the solver finds and the renderer integrates.
//!
//! A pixel's track is a list of knots. Between knots the photocurrent is held (the paper's zero-order hold): knot k's value lasts
//! until knot k+1; before the first knot its value holds, after the last one the last. Pixels stand in row-major order, one flat list of
//! knots with an offset per pixel, so a row band is one contiguous piece.

use crate::digest::{Digest, DigestBuilder};
use crate::error::DataError;
use crate::extent::{Extent, Rows};
use crate::handle::{Band, BandMeta, Handle};
use crate::time::TimeSpan;
use serde::{Deserialize, Serialize};

/// What is known about tracks before their data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TracksMeta {
    /// Size of the sensor.
    pub extent: Extent,
    /// The time that events or frames cover.
    pub span: TimeSpan,
    /// Length of an ordinary frame's exposure in the recording, ns: the scale of rendered DN.
    pub nominal_exposure_ns: i64,
    /// About how many knots, for memory estimates only: no part of the content.
    pub count_hint: Option<u64>,
}

impl BandMeta for TracksMeta {
    type Band = TrackBand;

    fn extent(&self) -> Extent {
        self.extent
    }

    fn write_digest(&self, digest: &mut DigestBuilder) {
        digest.text("tracks/1").integer(self.extent.width.into()).integer(self.extent.height.into());
        digest.integer(self.span.start.0).integer(self.span.end.0).integer(self.nominal_exposure_ns);
    }
}

/// Tracks of all pixels, read by row band.
pub type TrackSet = Handle<TracksMeta>;

/// The tracks of some rows.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct TrackBand {
    start_row: u32,
    width: u32,
    offsets: Vec<usize>,
    /// Time of each knot, ns, rising inside a pixel.
    pub t: Vec<i64>,
    /// Photocurrent from that knot on, in the units of the sensor description's gain.
    pub photocurrent: Vec<f32>,
}

/// One pixel's knots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Track<'a> {
    /// Time of each knot, ns.
    pub t: &'a [i64],
    /// Photocurrent from that knot on.
    pub photocurrent: &'a [f32],
}

impl TrackBand {
    /// An empty band that pixels are pushed to, left to right and top to bottom.
    pub fn begin(start_row: u32, width: u32) -> TrackBand {
        TrackBand { start_row, width, offsets: vec![0], ..TrackBand::default() }
    }

    /// Adds the next pixel.
    pub fn push(&mut self, knots: impl IntoIterator<Item = (i64, f32)>) {
        for (t, photocurrent) in knots {
            self.t.push(t);
            self.photocurrent.push(photocurrent);
        }
        self.offsets.push(self.t.len());
    }

    /// From columns in canonical order; `offsets` has one entry per pixel and a last one.
    ///
    /// # Errors
    /// When lengths disagree or offsets do not rise: the artefact is damaged.
    pub fn from_columns(start_row: u32, width: u32, offsets: Vec<usize>, t: Vec<i64>, photocurrent: Vec<f32>) -> Result<TrackBand, DataError> {
        let whole_rows = width > 0 && !offsets.is_empty() && (offsets.len() - 1).is_multiple_of(width as usize);
        let rising = offsets.first() == Some(&0) && offsets.last() == Some(&t.len()) && offsets.windows(2).all(|w| w[0] <= w[1]);
        if !whole_rows || !rising || t.len() != photocurrent.len() {
            return Err(DataError::new("the columns of a track band do not fit each other"));
        }
        Ok(TrackBand { start_row, width, offsets, t, photocurrent })
    }

    /// Index of the first knot of each pixel, and the number of knots.
    pub fn offsets(&self) -> &[usize] {
        &self.offsets
    }

    /// The track of pixel (x, row).
    pub fn pixel(&self, x: u32, row: u32) -> Track<'_> {
        let at = ((row - self.start_row) * self.width + x) as usize;
        let range = self.offsets[at]..self.offsets[at + 1];
        Track { t: &self.t[range.clone()], photocurrent: &self.photocurrent[range] }
    }

    fn row_pixels(&self, rows: Rows) -> std::ops::Range<usize> {
        let width = self.width as usize;
        (rows.start - self.start_row) as usize * width..(rows.end - self.start_row) as usize * width
    }
}

impl Band for TrackBand {
    type Meta = TracksMeta;

    fn rows(&self) -> Rows {
        let rows = (self.offsets.len().saturating_sub(1) as u32).checked_div(self.width).unwrap_or(0);
        Rows { start: self.start_row, end: self.start_row + rows }
    }

    fn row_digest(&self, row: u32) -> Digest {
        let pixels = self.row_pixels(Rows { start: row, end: row + 1 });
        let counts: Vec<u64> = pixels.clone().map(|p| (self.offsets[p + 1] - self.offsets[p]) as u64).collect();
        let knots = self.offsets[pixels.start]..self.offsets[pixels.end];
        let mut digest = DigestBuilder::new("tracks-row/1");
        digest.slice(&counts).slice(&self.t[knots.clone()]).slice(&self.photocurrent[knots]);
        digest.finish()
    }

    fn slice(&self, rows: Rows) -> TrackBand {
        let pixels = self.row_pixels(rows);
        let knots = self.offsets[pixels.start]..self.offsets[pixels.end];
        TrackBand {
            start_row: rows.start,
            width: self.width,
            offsets: self.offsets[pixels.start..=pixels.end].iter().map(|offset| offset - knots.start).collect(),
            t: self.t[knots.clone()].to_vec(),
            photocurrent: self.photocurrent[knots].to_vec(),
        }
    }

    fn concat(parts: Vec<TrackBand>) -> TrackBand {
        let mut parts = parts.into_iter();
        let mut whole = parts.next().expect("at least one band to join");
        for part in parts {
            let before = whole.t.len();
            whole.offsets.extend(part.offsets[1..].iter().map(|offset| offset + before));
            whole.t.extend(part.t);
            whole.photocurrent.extend(part.photocurrent);
        }
        whole
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn band() -> TrackBand {
        let mut band = TrackBand::begin(4, 3);
        for pixel in 0..12 {
            band.push((0..pixel % 4).map(|k| (k * 100, (pixel * 10 + k) as f32)));
        }
        band
    }

    #[test]
    fn cutting_and_joining_gives_the_same_band() {
        let band = band();
        assert_eq!(band.rows(), Rows { start: 4, end: 8 });
        for height in 1..5 {
            let parts: Vec<TrackBand> = band.rows().bands(height).into_iter().map(|rows| band.slice(rows)).collect();
            assert!(parts.iter().all(|part| part.rows().iter().all(|row| part.row_digest(row) == band.row_digest(row))));
            assert_eq!(TrackBand::concat(parts), band);
        }
    }

    #[test]
    fn a_pixel_finds_its_own_knots() {
        let band = band();
        assert_eq!(band.pixel(2, 6).t.len(), 8 % 4);
        assert_eq!(band.pixel(1, 6).photocurrent, [70.0, 71.0, 72.0]);
    }

    #[test]
    fn columns_that_do_not_fit_are_refused() {
        assert!(TrackBand::from_columns(0, 2, vec![0, 1, 3], vec![0, 1], vec![0.0, 1.0]).is_err());
        assert!(TrackBand::from_columns(0, 2, vec![0, 1], vec![0], vec![0.0]).is_err());
    }
}
