//! Where the pixels of an event array lie on the frames, by what a recording's files state.

use crate::declared::Declared;
use crate::error::FormatError;
use crate::hs_ergb::HsErgb;
use std::path::Path;

pub use crate::warped::Array;

/// The array of a sequence of HS-ERGB or BS-ERGB whose events were warped onto its pictures; none where their
/// places are whole pixels, or no lattice.
///
/// # Errors
/// When the folder is no such sequence, or cannot be read.
pub fn of_sequence(path: &Path) -> Result<Option<Array>, FormatError> {
    Ok(HsErgb::open(path, &Declared::default())?.array())
}
