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
    let trouble = match error.kind() {
        std::io::ErrorKind::NotFound => "there is no such file".to_string(),
        std::io::ErrorKind::InvalidData => "it is not text in UTF-8".to_string(),
        _ => error.to_string(),
    };
    NodeError::files(format!("cannot read {}: {trouble}", path.display())).hint("paths are relative to the manifest that names them").param("path")
}

/// The file's name without its folder: what messages call it.
fn short_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}
