//! Everything that can go wrong between memory and disk, each with its file, what was found and what to do
//! next.

use photocurrent_core::document::Problem;
use photocurrent_core::{DataError, NodeError};
use std::path::{Path, PathBuf};

/// A file could not be read, written or trusted.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The operating system refused.
    #[error("{}: cannot {doing}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried: "open the file".
        doing: &'static str,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The file is no HDF5 file, or it is cut short.
    #[error("{}: {found}\n  hint: {hint}", path.display())]
    NotReadable {
        /// The file.
        path: PathBuf,
        /// What stands there instead.
        found: String,
        /// What to do next.
        hint: String,
    },
    /// The HDF5 library refused.
    #[error("{}: {at}: cannot {doing}: {detail}", path.display())]
    Library {
        /// The file.
        path: PathBuf,
        /// Dataset, group or attribute: `/events/t`.
        at: String,
        /// What was tried.
        doing: &'static str,
        /// The library's reason.
        detail: String,
    },
    /// Something in the file is not as its format says.
    #[error("{}: {at}: found {found}, expected {expected}\n  hint: {hint}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// Dataset, group or attribute: `/events/t`.
        at: String,
        /// What is there.
        found: String,
        /// What should be there.
        expected: String,
        /// What to do next.
        hint: String,
    },
    /// Several things in the file are not as its format says; each stands for itself.
    #[error(
        "{}: {} mistakes\n{}",
        path.display(), mistakes.len(),
        mistakes.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
    )]
    Several {
        /// The file.
        path: PathBuf,
        /// Two or more, in the order of the format.
        mistakes: Vec<StoreError>,
    },
    /// An entry of the cache does not hold what its name promises; a run makes it again.
    #[error("{}: damaged cache entry: {why}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// How that was noticed.
        why: String,
    },
    /// The caller broke the contract of a writer.
    #[error("{}: {what}", path.display())]
    Misuse {
        /// The file being written.
        path: PathBuf,
        /// What went wrong.
        what: String,
    },
    /// What was to be written could not be read: the trouble lies where it comes from, not in the file being
    /// written.
    #[error(transparent)]
    Source(DataError),
    /// Somebody else uses the cache.
    #[error(
        "{}: the cache is in use by another run\n  hint: wait until it has finished, then try again",
        path.display()
    )]
    Busy {
        /// Root of the cache.
        path: PathBuf,
    },
}

impl StoreError {
    /// Of the operating system.
    pub(crate) fn io(path: &Path, doing: &'static str, source: std::io::Error) -> StoreError {
        StoreError::Io { path: path.into(), doing, source }
    }

    /// Of something that is not as its format says.
    pub(crate) fn content(
        path: &Path,
        at: &str,
        found: impl Into<String>,
        expected: impl Into<String>,
        hint: impl Into<String>,
    ) -> StoreError {
        StoreError::Content {
            path: path.into(),
            at: at.into(),
            found: found.into(),
            expected: expected.into(),
            hint: hint.into(),
        }
    }

    /// Would running the node again repair it? True for what is wrong with one entry of the cache, false for
    /// a full disk.
    pub fn is_damage(&self) -> bool {
        match self {
            StoreError::Damaged { .. }
            | StoreError::NotReadable { .. }
            | StoreError::Content { .. }
            | StoreError::Library { .. }
            | StoreError::Several { .. } => true,
            StoreError::Io { source, .. } => source.kind() == std::io::ErrorKind::NotFound,
            StoreError::Misuse { .. } | StoreError::Source(_) | StoreError::Busy { .. } => false,
        }
    }
}

/// Collects what is wrong with a file, so that all of it is reported at once.
#[derive(Debug, Default)]
pub(crate) struct Mistakes {
    found: Vec<StoreError>,
}

impl Mistakes {
    /// The value, or its mistakes noted.
    pub(crate) fn take<T>(&mut self, result: Result<T, StoreError>) -> Option<T> {
        match result {
            Ok(value) => return Some(value),
            Err(StoreError::Several { mistakes, .. }) => self.found.extend(mistakes),
            Err(error) => self.found.push(error),
        }
        None
    }

    /// Nothing wrong so far?
    pub(crate) fn is_empty(&self) -> bool {
        self.found.is_empty()
    }

    /// Everything noted, as one error.
    pub(crate) fn finish(mut self, path: &Path) -> Result<(), StoreError> {
        match self.found.len() {
            0 => Ok(()),
            1 => Err(self.found.remove(0)),
            _ => Err(StoreError::Several { path: path.into(), mistakes: self.found }),
        }
    }
}

impl From<StoreError> for DataError {
    fn from(error: StoreError) -> DataError {
        DataError::new(error.to_string())
    }
}

impl From<StoreError> for NodeError {
    fn from(error: StoreError) -> NodeError {
        match error {
            StoreError::Content { path, at, found, expected, hint } => {
                NodeError::input(format!("{}: {at}: found {found}, expected {expected}", path.display()))
                    .hint(hint)
            }
            StoreError::NotReadable { path, found, hint } => {
                NodeError::input(format!("{}: {found}", path.display())).hint(hint)
            }
            StoreError::Several { path, mistakes } => {
                let count = mistakes.len();
                let problems = mistakes.into_iter().map(|mistake| {
                    let error = NodeError::from(mistake);
                    Problem { notes: error.notes, help: error.hint, ..Problem::new(error.message) }
                });
                NodeError::input(format!("{}: {count} things are not as the format says", path.display()))
                    .problems(problems.collect())
            }
            StoreError::Misuse { .. } => NodeError::failed(error.to_string()),
            StoreError::Source(error) => error.into(),
            other => NodeError::files(other.to_string()),
        }
    }
}
