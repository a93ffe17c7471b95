//! Light that is integrated over exposures on another processor: [`crate::exposure`] of many pixels at once.

use photocurrent_core::{Exposure, NodeError};
use std::ops::Range;

/// Light of pixels over time, in columns: pixel `p` has the knots `offsets[p]..offsets[p + 1]`.
#[derive(Clone, Copy, Debug)]
pub struct Columns<'a> {
    /// One for each pixel, and a last one.
    pub offsets: &'a [usize],
    /// Instants, ns, not falling inside a pixel.
    pub t_ns: &'a [i64],
    /// Photocurrent at each, as many.
    pub light: &'a [f32],
    /// Standard deviation of its logarithm at each; empty = not wanted.
    pub sigma: &'a [f32],
    /// Is the logarithm of light linear between knots? Otherwise the earlier knot's value holds.
    pub is_linear: bool,
}

/// Pixels that are exposed alike: a row.
#[derive(Clone, Debug)]
pub struct ExposedRow {
    /// Their places among the columns' pixels.
    pub pixels: Range<usize>,
    /// Exposures, the same number for every row of a call; in order of time it is quickest.
    pub exposures: Vec<Exposure>,
}

/// A row's means over one exposure.
#[derive(Clone, Copy, Debug)]
pub struct RowMeans<'a> {
    /// Its place among the rows.
    pub row: usize,
    /// The exposure's place.
    pub exposure: usize,
    /// Mean light of each pixel; NaN of one without knots.
    pub light: &'a [f32],
    /// Mean of light times the standard deviation of its logarithm, which is log-linear between knots; empty
    /// where the columns have none.
    pub spread: &'a [f32],
}

/// Takes means of light over exposures as [`crate::exposure`] does, but for rounding to single precision.
pub trait Integrate: Sync {
    /// Gives the means of every row, its exposures in order, to `take`; gives the places of the rows that it
    /// does not take, rising: with numbers that are not finite, or too many knots.
    ///
    /// # Errors
    /// When the other processor fails. What was given by then is right.
    fn means(
        &self,
        columns: Columns<'_>,
        rows: &[ExposedRow],
        take: &mut dyn FnMut(RowMeans<'_>),
    ) -> Result<Vec<usize>, NodeError>;
}
