//! What all parts of a recording share.

use super::header::Header;
use super::index::{Index, Mark};
use crate::error::FormatError;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

/// The file, its header and its index.
pub(super) struct Inner {
    pub(super) path: PathBuf,
    pub(super) header: Arc<Header>,
    pub(super) index: Index,
    /// Marks with times, where they had to be found by reading.
    pub(super) marks: OnceLock<Vec<Mark>>,
}

impl Inner {
    /// Where to begin to read events: from the data table, or found by `find` once.
    pub(super) fn marks(
        &self,
        find: impl FnOnce(&Inner) -> Result<Vec<Mark>, FormatError>,
    ) -> Result<&[Mark], FormatError> {
        if let Some(marks) = self.index.marks.as_ref().or(self.marks.get()) {
            return Ok(marks);
        }
        let found = find(self)?;
        Ok(self.marks.get_or_init(|| found))
    }
}
