//! Why a command stops, and files that it writes whole or not at all.

use photocurrent_core::document::Problem;
use photocurrent_store::{StoreError, unnamed_in};
use std::io::Write;
use std::path::Path;

/// Why a command stops.
pub enum Failure {
    /// The manifest or what it asks for is wrong; nothing ran.
    Problems(Vec<Problem>),
    /// Anything else.
    Other {
        /// What, in the reader's terms.
        message: String,
        /// For the shell.
        code: u8,
    },
}

impl Failure {
    /// With exit code 1.
    pub fn other(message: impl Into<String>) -> Failure {
        Failure::Other { message: message.into(), code: 1 }
    }
}

impl From<Vec<Problem>> for Failure {
    fn from(problems: Vec<Problem>) -> Failure {
        Failure::Problems(problems)
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Failure {
        Failure::other(error.to_string())
    }
}

impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Failure {
        Failure::other(error.to_string())
    }
}

/// An exit code, or why not.
pub type Done = Result<u8, Failure>;

/// Refuses a path that a manifest cannot name.
pub fn must_be_utf8(path: &Path) -> Result<(), Failure> {
    if path.to_str().is_some() {
        return Ok(());
    }
    Err(Failure::Other {
        message: format!(
            "{}: a manifest names files in UTF-8, and this name is not\n  hint: rename the file",
            path.display()
        ),
        code: 2,
    })
}

/// Writes a file whole or not at all.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let failed = |error: std::io::Error| Failure::other(format!("{}: cannot write: {error}", path.display()));
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(failed)?;
    let mut file = unnamed_in(folder).map_err(failed)?;
    file.write_all(bytes).map_err(failed)?;
    file.as_file().sync_all().map_err(failed)?;
    file.persist(path).map_err(|error| failed(error.error))?;
    Ok(())
}

/// A mistake in the arguments or in what they name.
pub fn usage(message: impl Into<String>) -> Failure {
    Failure::Other { message: message.into(), code: 2 }
}
