//! What a solution takes from its caller: whether to go on, what other bands of the same recording chose, and
//! which processor solves.

use crate::row::RowSetting;
use photocurrent_core::{Context, NodeError};
use photocurrent_sensor::map::Elsewhere;

/// Settings that bands of a recording share, and interruptions. `()` shares nothing and never interrupts.
pub trait Host: Sync {
    /// What another band chose for a block of rows, if one did.
    fn recall(&self, _block: u32) -> Option<RowSetting> {
        None
    }

    /// Keeps what was chosen for a block of rows.
    fn keep(&self, _block: u32, _setting: RowSetting) {}

    /// `rows` more of the result are done.
    ///
    /// # Errors
    /// When the solution is to be given up.
    fn advance(&self, _rows: u64) -> Result<(), NodeError> {
        Ok(())
    }

    /// Where the pixels of [`crate::solve_rows`] are solved; none = on this processor.
    fn elsewhere(&self) -> Option<&dyn Elsewhere> {
        None
    }

    /// So many pixels were solved on this processor, since the other one does not take them.
    fn left_here(&self, _pixels: u64) {}
}

impl Host for () {}

impl Host for Context<'_> {
    fn recall(&self, block: u32) -> Option<RowSetting> {
        Context::recall(self, block.into()).map(|setting| *setting)
    }

    fn keep(&self, block: u32, setting: RowSetting) {
        Context::keep(self, block.into(), setting);
    }

    fn advance(&self, rows: u64) -> Result<(), NodeError> {
        Context::advance(self, rows)
    }
}
