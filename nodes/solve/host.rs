//! A node's context, with the machine that solves its pixels.

use crate::backend::{Machine, OnCard};
use photocurrent_core::{Context, NodeError};
use photocurrent_solve::row::RowSetting;
use photocurrent_solve::{Elsewhere, Host};

/// A node's context, on its machine.
pub(super) struct OnMachine<'a> {
    cx: &'a Context<'a>,
    card: Option<OnCard>,
}

impl<'a> OnMachine<'a> {
    /// Notes which card it is, if it is one.
    ///
    /// # Errors
    /// When it cannot be opened, or is another one than planned.
    pub(super) fn new(cx: &'a Context<'a>, machine: &Machine) -> Result<OnMachine<'a>, NodeError> {
        let Some(name) = machine.name() else { return Ok(OnMachine { cx, card: None }) };
        let card = machine.open()?;
        cx.note(format!(
            "solved on {name}; noise and prior were chosen, effects undone and lost events found on the \
             processor"
        ));
        Ok(OnMachine { cx, card })
    }
}

impl Host for OnMachine<'_> {
    fn recall(&self, block: u32) -> Option<RowSetting> {
        Host::recall(self.cx, block)
    }

    fn keep(&self, block: u32, setting: RowSetting) {
        Host::keep(self.cx, block, setting);
    }

    fn advance(&self, rows: u64) -> Result<(), NodeError> {
        Host::advance(self.cx, rows)
    }

    fn elsewhere(&self) -> Option<&dyn Elsewhere> {
        self.card.as_ref().map(|card| card.solver as &dyn Elsewhere)
    }

    fn left_here(&self, pixels: u64) {
        self.cx.count(pixels, "pixels were solved on the processor: too long for the card's memory");
    }
}
