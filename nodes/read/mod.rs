//! Readers: recordings and sensor descriptions come in here.
//!
//! A reader has no inputs. It looks at its file while planning, so that the rest of the pipeline knows extent, time span and which streams
//! there are before any data are read; what a file does not have becomes an absent output with the reason.

pub mod aedat4;
pub mod recording;
pub mod sensor;

use photocurrent_core::context::{Notes, Silent};
use photocurrent_core::quantity::{Duration, InputPath};
use photocurrent_core::{Context, Node, NodeError, Rows};
use std::io::Read;
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Does a file begin as AEDAT4 files do?
pub fn is_aedat4(path: &Path) -> bool {
    let mut start = [0; 10];
    std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut start)).is_ok() && start.starts_with(b"#!AER-DAT4")
}

/// Both streams of an AEDAT4 file, for those who look at it before a graph does; `row_time` as in [`aedat4::Params`].
///
/// # Errors
/// As `read/aedat4`: when the file cannot be read, is cut off, or holds what cannot be.
pub fn whole_aedat4(path: &Path, row_time: Duration) -> Result<aedat4::Out, NodeError> {
    let params = aedat4::Params { path: InputPath::new(path), row_time, ..aedat4::Params::default() };
    let wanted = ["events", "frames"].map(String::from).into_iter().collect();
    let (cancel, notes) = (AtomicBool::new(false), Notes::default());
    let everything = Rows { start: 0, end: 0 };
    aedat4::ReadAedat4::build(params)?.run(aedat4::In {}, &Context::new(everything, 0, &wanted, &Silent, &cancel, None, &notes))
}

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
