//! Errors of the store as errors of this crate.

use crate::error::FormatError;
use photocurrent_store::StoreError;
use std::path::Path;

/// What to do about a damaged file.
pub(super) const COPY: &str = "the file is damaged: copy or record it again";

/// Turns an error of the store into one of this crate.
pub(crate) fn refused(path: &Path, error: StoreError) -> FormatError {
    match error {
        StoreError::Content { path, at, found, expected, hint } => {
            FormatError::new(&path, format!("found {found}"), hint).at(at).expected(expected)
        }
        StoreError::NotReadable { path, found, hint } => FormatError::new(&path, found, hint),
        StoreError::Io { path, source, .. } => FormatError::io(&path, &source),
        StoreError::Library { path, at, doing, detail } => {
            FormatError::new(&path, format!("cannot {doing}: {detail}"), COPY).at(at)
        }
        other => FormatError::new(path, other.to_string(), COPY),
    }
}
