//! The one explicit list of all formats.
//!
//! A file is held against them from the top: those that are recognised by a signature stand before those that are recognised by what they look like.

use crate::format::Format;
use crate::{evt, mcap, rosbag};

/// Every format, in the order in which a file is held against them.
pub static FORMATS: &[&Format] = &[&evt::EVT2, &evt::EVT21, &evt::EVT3, &evt::DAT, &rosbag::FORMAT, &mcap::FORMAT];
