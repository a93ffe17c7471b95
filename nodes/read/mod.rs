//! Readers: recordings and sensor descriptions come in here.
//!
//! A reader has no inputs. It looks at its file while planning, so that the rest of the pipeline knows extent, time span and which streams
//! there are before any data are read; what a file does not have becomes an absent output with the reason.

pub mod aedat4;
pub mod recording;
pub mod sensor;

use photocurrent_core::NodeError;
use photocurrent_core::quantity::InputPath;
use std::path::Path;

/// Refuses a reader without a path.
fn need_path(path: &InputPath, example: &str) -> Result<(), NodeError> {
    if path.path().as_os_str().is_empty() {
        return Err(NodeError::usage("`path` is missing").hint(format!("name the file, such as `path = \"{example}\"`")).param("path"));
    }
    Ok(())
}

/// A file that could not be read, in the reader's terms.
fn cannot_read(path: &Path, error: &std::io::Error) -> NodeError {
    let hint = match error.kind() {
        std::io::ErrorKind::InvalidData => "save it as UTF-8",
        _ => "paths are relative to the manifest that names them",
    };
    NodeError::files(photocurrent_core::error::cannot_read(path, error)).hint(hint).param("path")
}

/// The file's name without its folder: what messages call it.
fn short_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}
