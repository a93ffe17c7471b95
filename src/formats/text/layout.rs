//! How the lines of one file are to be read.

use super::fields::Separator;
use crate::convention::Rules;
use crate::declared::{Column, TimeUnit};
use photocurrent_core::Extent;

/// How the lines of one file are to be read.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Layout {
    pub(crate) separator: Separator,
    pub(crate) columns: Vec<Column>,
    pub(crate) unit: TimeUnit,
    /// Stored coordinates in a pixel.
    pub(crate) scale: u32,
    pub(crate) extent: Option<Extent>,
    /// Does a column hold in-pixel times?
    pub(crate) has_t_in: bool,
    /// What polarities and coordinates mean.
    pub(crate) rules: Rules,
    /// Byte at which the first line of data begins, and its number, from 1.
    pub(crate) start: (u64, u64),
}
