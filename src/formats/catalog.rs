//! The one explicit list of all formats, and which one a file has.
//!
//! A file is held against them from the top: those that are recognised by a signature stand before those that
//! are recognised by what they look like.

use crate::error::FormatError;
use crate::format::{Format, Probe};
use crate::hdf;
use std::path::Path;

/// Every format, in the order in which a file is held against them.
pub static FORMATS: &[&Format] = &[
    // By a signature.
    &crate::aedat4::FORMAT,
    &crate::aedat3::FORMAT,
    &crate::aedat2::FORMAT,
    &crate::event_stream::FORMAT,
    &crate::evt::EVT2,
    &crate::evt::EVT21,
    &crate::evt::EVT3,
    &crate::evt::DAT,
    &crate::rosbag::FORMAT,
    &crate::rosbag2::FORMAT,
    &crate::mcap::FORMAT,
    &crate::npz::FORMAT,
    // By what an HDF5 file holds.
    &hdf::recording::FORMAT,
    &hdf::prophesee::FORMAT,
    &hdf::m3ed::FORMAT,
    &hdf::mvsec::FORMAT,
    &hdf::event_utils::FORMAT,
    &hdf::dsec::FORMAT,
    &hdf::v2e::FORMAT,
    // By what stands in a folder.
    &crate::event_camera_dataset::FORMAT,
    &crate::hs_ergb::FORMAT,
    &crate::event_utils_memmap::FORMAT,
    &crate::pictures::FORMAT,
    // By what it looks like.
    &crate::csv::FORMAT,
];

/// Which format a file or folder has; `None` when it is none of ours.
///
/// # Errors
/// When it is not there or may not be read, and when it is an HDF5 file that cannot be opened: no layout can
/// be recognised in that.
pub fn recognise(path: &Path) -> Result<Option<&'static Format>, FormatError> {
    let probe = Probe::new(path)?;
    let found = FORMATS.iter().copied().find(|format| (format.recognises)(&probe));
    if found.is_none() && probe.is_hdf5() {
        hdf::readable(path)?;
    }
    Ok(found)
}

/// A format by its id.
pub fn named(id: &str) -> Option<&'static Format> {
    FORMATS.iter().copied().find(|format| format.id == id)
}
