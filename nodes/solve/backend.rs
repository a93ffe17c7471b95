//! What solves pixels: this processor, or a graphics card where the program was built with the feature `gpu`.

use photocurrent_core::{Context, NodeError};
use photocurrent_solve::row::RowSetting;
use photocurrent_solve::{Elsewhere, Host};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What solves the pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Backend {
    /// This processor: the same bits on every machine.
    #[default]
    Cpu,
    /// A graphics card with a Vulkan driver: log light to about 1e-5 the same, with bits that depend on card,
    /// driver and version. They are part of the key. `PHOTOCURRENT_ADAPTER` names the card to take.
    Gpu,
}

/// What solves, with its name.
pub(super) struct Machine {
    card: Option<String>,
}

impl Machine {
    /// # Errors
    /// When a card is wanted, and there is none or the program was built without.
    pub(super) fn new(backend: Backend) -> Result<Machine, NodeError> {
        Ok(Machine { card: if backend == Backend::Cpu { None } else { Some(card::name()?) } })
    }

    /// Of a card: its name, driver and version.
    pub(super) fn name(&self) -> Option<&str> {
        self.card.as_deref()
    }
}

/// A node's context, on its machine.
pub(super) struct OnMachine<'a> {
    cx: &'a Context<'a>,
    elsewhere: Option<&'static dyn Elsewhere>,
}

impl<'a> OnMachine<'a> {
    /// Notes which card it is, if it is one.
    ///
    /// # Errors
    /// When it cannot be opened, or is another one than planned.
    pub(super) fn new(cx: &'a Context<'a>, machine: &Machine) -> Result<OnMachine<'a>, NodeError> {
        let Some(name) = machine.name() else { return Ok(OnMachine { cx, elsewhere: None }) };
        let elsewhere = card::open(name)?;
        cx.note(format!(
            "solved on {name}; noise and prior were chosen, effects undone and lost events found on the processor"
        ));
        Ok(OnMachine { cx, elsewhere: Some(elsewhere) })
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
        self.elsewhere
    }

    fn left_here(&self, pixels: u64) {
        self.cx.count(pixels, "pixels were solved on the processor: too long for the card's memory");
    }
}

#[cfg(feature = "gpu")]
mod card {
    use super::{Elsewhere, NodeError};
    use photocurrent_gpu::{Card, CardOptions};
    use std::sync::OnceLock;

    /// The card of this process: its memory is taken once.
    static CARD: OnceLock<Result<Card, NodeError>> = OnceLock::new();

    pub(super) fn name() -> Result<String, NodeError> {
        photocurrent_gpu::card_name()
    }

    pub(super) fn open(name: &str) -> Result<&'static dyn Elsewhere, NodeError> {
        let card = CARD.get_or_init(|| Card::open(CardOptions::default())).as_ref().map_err(Clone::clone)?;
        if card.name() != name {
            return Err(NodeError::failed(format!(
                "{name} was planned with, and {} is here now",
                card.name()
            ))
            .hint("run it again")
            .param("backend"));
        }
        Ok(card)
    }
}

#[cfg(not(feature = "gpu"))]
mod card {
    use super::{Elsewhere, NodeError};

    fn missing() -> NodeError {
        NodeError::usage("`backend = \"gpu\"` is not in this program: it was built without the feature `gpu`")
            .hint("build it with `cargo build --release --features gpu`, or leave `backend` at \"cpu\"")
            .param("backend")
    }

    pub(super) fn name() -> Result<String, NodeError> {
        Err(missing())
    }

    pub(super) fn open(_name: &str) -> Result<&'static dyn Elsewhere, NodeError> {
        Err(missing())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::map::{Params, SolveMap};
    use photocurrent_core::Node;

    #[test]
    fn a_card_that_cannot_be_is_an_error_that_names_the_parameter() {
        let params = Params { backend: Backend::Gpu, ..Params::default() };
        match SolveMap::build(params) {
            Ok(node) => assert_eq!(node.machine(), Some(card::name().unwrap())),
            Err(error) => {
                assert_eq!(error.param.as_deref(), Some("backend"));
                assert!(cfg!(feature = "gpu") || error.message.contains("feature `gpu`"), "{error:?}");
            }
        }
    }

    #[test]
    fn which_processor_it_is_has_no_part_in_keys() {
        let of = |params: &Params| serde_json::to_value(params).unwrap();
        assert!(SolveMap::build(Params::default()).unwrap().machine().is_none());
        assert_eq!(of(&Params::default())["backend"], "cpu");
        let gpu = Params { backend: Backend::Gpu, ..Params::default() };
        assert_eq!(of(&gpu)["backend"], "gpu");
    }
}
