//! Where the pixels of an event array lie on the frames, by what a recording's files state.

use crate::declared::Declared;
use crate::error::FormatError;
use crate::hs_ergb::HsErgb;
use photocurrent_core::Extent;
use std::path::{Path, PathBuf};

/// An event array next to frames of another camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Columns and rows of the array.
    pub extent: Extent,
    /// Column and row on the frames of each of its pixels, row by row, pixels.
    pub places: Vec<(f64, f64)>,
    /// What the places of events lie off these, root mean square, pixels of the frames.
    pub residual: f64,
    /// The files that state it.
    pub files: Vec<PathBuf>,
}

/// The array of a sequence of HS-ERGB or BS-ERGB whose events were warped onto its pictures; none where their
/// places are whole pixels, or no lattice.
///
/// # Errors
/// When the folder is no such sequence, or cannot be read.
pub fn of_sequence(path: &Path) -> Result<Option<Array>, FormatError> {
    Ok(HsErgb::open(path, &Declared::default())?.array())
}
