//! What solves and renders pixels: this processor, or a graphics card where the program was built with the
//! feature `gpu`.

use photocurrent_core::node::Working;
use photocurrent_core::{NodeError, TracksMeta};
use photocurrent_sensor::integrate::Integrate;
use photocurrent_solve::{Elsewhere, elsewhere_bytes};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What does a node's work on pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Backend {
    /// This processor: the same bits on every machine.
    #[default]
    Cpu,
    /// A graphics card with a Vulkan driver: the same to about 1e-5, with bits that depend on card, driver
    /// and version. They are part of the key. `PHOTOCURRENT_ADAPTER` names the card to take.
    Gpu,
}

/// Bytes of knots and means that a thread brings to a card and back at once, but for whole rows.
pub(crate) const BATCH_BYTES: usize = 32 << 20;

/// Bytes of these on their way: themselves, and the driver's copy.
const MEANS_BYTES: u64 = 2 * BATCH_BYTES as u64;

/// What works, with its name.
#[derive(Default)]
pub(crate) struct Machine {
    card: Option<String>,
}

/// An opened card, as what it does.
#[derive(Clone, Copy)]
pub(crate) struct OnCard {
    /// Solves pixels.
    pub(crate) solver: &'static dyn Elsewhere,
    /// Integrates their light.
    pub(crate) integrator: &'static dyn Integrate,
}

impl Machine {
    /// # Errors
    /// When a card is wanted, and there is none or the program was built without.
    pub(crate) fn new(backend: Backend) -> Result<Machine, NodeError> {
        Ok(Machine { card: if backend == Backend::Cpu { None } else { Some(card::name()?) } })
    }

    /// Of a card: its name, driver and version.
    pub(crate) fn name(&self) -> Option<&str> {
        self.card.as_deref()
    }

    /// Memory that tracks of this kind take while they are solved or rendered on a card, where it is one.
    pub(crate) fn working(&self, tracks: Option<&TracksMeta>) -> Working {
        let Some(_) = self.name() else { return Working::default() };
        Working { per_thread: tracks.map_or(0, elsewhere_bytes) + MEANS_BYTES, banded: 0 }
    }

    /// The card, if it is one.
    ///
    /// # Errors
    /// When it cannot be opened, or is another one than planned.
    pub(crate) fn open(&self) -> Result<Option<OnCard>, NodeError> {
        self.name().map(card::open).transpose()
    }
}

#[cfg(feature = "gpu")]
mod card {
    use super::{NodeError, OnCard};
    use photocurrent_gpu::{Card, CardOptions};
    use std::sync::OnceLock;

    /// The card of this process: its memory is taken once.
    static CARD: OnceLock<Result<Card, NodeError>> = OnceLock::new();

    pub(super) fn name() -> Result<String, NodeError> {
        photocurrent_gpu::card_name()
    }

    pub(super) fn open(name: &str) -> Result<OnCard, NodeError> {
        let card = CARD.get_or_init(|| Card::open(CardOptions::default())).as_ref().map_err(Clone::clone)?;
        if card.name() != name {
            return Err(NodeError::failed(format!(
                "{name} was planned with, and {} is here now",
                card.name()
            ))
            .hint("run it again")
            .param("backend"));
        }
        Ok(OnCard { solver: card, integrator: card })
    }
}

#[cfg(not(feature = "gpu"))]
mod card {
    use super::{NodeError, OnCard};

    fn missing() -> NodeError {
        NodeError::usage("`backend = \"gpu\"` is not in this program: it was built without the feature `gpu`")
            .hint("build it with `cargo build --release --features gpu`, or leave `backend` at \"cpu\"")
            .param("backend")
    }

    pub(super) fn name() -> Result<String, NodeError> {
        Err(missing())
    }

    pub(super) fn open(_name: &str) -> Result<OnCard, NodeError> {
        Err(missing())
    }
}

#[cfg(test)]
#[cfg(feature = "gpu")]
pub(crate) mod testing {
    /// Is there a card? Where there is none, tests of it are skipped; those of the crate of cards print so,
    /// and fail where one is required.
    pub(crate) fn has_card() -> bool {
        super::card::name().is_ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::baseline::edi::BaselineEdi;
    use crate::render::rows::RenderRows;
    use crate::solve::map::SolveMap;
    use photocurrent_core::Node;
    use serde_json::json;

    fn on_card<N: Node>() -> Result<N, NodeError> {
        N::build(serde_json::from_value(json!({ "backend": "gpu" })).unwrap())
    }

    fn names_the_parameter<N: Node>() {
        match on_card::<N>() {
            Ok(node) => assert_eq!(node.machine(), Some(card::name().unwrap())),
            Err(error) => {
                assert_eq!(error.param.as_deref(), Some("backend"));
                assert!(cfg!(feature = "gpu") || error.message.contains("feature `gpu`"), "{error:?}");
            }
        }
        // Which processor it is has no part in keys.
        assert!(N::build(N::Params::default()).unwrap().machine().is_none());
        assert_eq!(serde_json::to_value(N::Params::default()).unwrap()["backend"], "cpu");
    }

    #[test]
    fn a_card_that_cannot_be_is_an_error_that_names_the_parameter() {
        names_the_parameter::<SolveMap>();
        names_the_parameter::<RenderRows>();
        names_the_parameter::<BaselineEdi>();
    }
}
