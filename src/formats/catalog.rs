//! The one explicit list of all formats.
//!
//! A file is held against them from the top: those that are recognised by a signature stand before those that are recognised by what they look like.

use crate::format::Format;
use crate::hdf;

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
