//! Readers: recordings and sensor descriptions come in here.
//!
//! A reader has no inputs. It looks at its file while planning, so that the rest of the pipeline knows
//! extent, time span and which streams there are before any data are read; what a file does not have becomes
//! an absent output with the reason.

pub mod alignment;
pub mod foreign;
pub mod formats;
pub mod recording;
pub mod sensor;

use photocurrent_core::NodeError;
use photocurrent_core::quantity::InputPath;
use photocurrent_formats::arrange::{Arranged, arrange};
use photocurrent_formats::{Probe, catalog, instead, joined};
use std::path::Path;

/// What a file of any format has, for those who look at it before a graph does: events and frames without
/// their data. `all` states what the file does not.
///
/// # Errors
/// When the file is of no known format, cannot be read, or something must be stated that is not.
pub fn arranged(all: &foreign::All) -> Result<Arranged, NodeError> {
    let (path, settings) = (all.path.path(), all.settings());
    let unknown = || match Probe::new(path).ok().and_then(|probe| instead::what_it_is(&probe)) {
        Some(instead) => NodeError::from(instead.refusal(path)),
        None => {
            NodeError::input(format!("{} is a recording of no known format", path.display())).param("path")
        }
    };
    let format = catalog::recognise(path)?.ok_or_else(unknown)?;
    let recording = joined::open(format, path, &settings.declared)?;
    arrange(path, recording.as_ref(), &settings, |_| Ok::<(), NodeError>(()))
}

/// Refuses a reader without a path.
fn need_path(path: &InputPath, example: &str) -> Result<(), NodeError> {
    if path.path().as_os_str().is_empty() {
        return Err(NodeError::usage("`path` is missing")
            .hint(format!("name the file, such as `path = \"{example}\"`"))
            .param("path"));
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
