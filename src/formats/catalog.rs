//! The one explicit list of all formats.
//!
//! A file is held against them from the top: those that are recognised by a signature stand before those that are recognised by what they look like.

use crate::format::Format;
use crate::hdf;

/// Every format, in the order in which a file is held against them.
pub static FORMATS: &[&Format] = &[
    &hdf::recording::FORMAT,
    &hdf::prophesee::FORMAT,
    &hdf::m3ed::FORMAT,
    &hdf::mvsec::FORMAT,
    &hdf::event_utils::FORMAT,
    &hdf::dsec::FORMAT,
    &hdf::v2e::FORMAT,
];
