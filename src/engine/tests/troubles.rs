//! Toys that go wrong in a way asked for, and one that is heavy.

use super::toys::{AddParams, Plane, decl, head, map_pixels, meta, plane_meta};
use photocurrent_core::document::Problem;
use photocurrent_core::{Context, Decl, Grain, MapBand, MapSet, Meta, Node, NodeError, PortMetas};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

#[derive(Clone, Copy, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Mischief {
    /// Passes its input on.
    #[default]
    None,
    /// Returns an error.
    Fails,
    /// Returns an error about its input.
    BadInput,
    /// Panics.
    Panics,
    /// Gives another plane than it planned.
    Lies,
    /// Waits until the run is cancelled.
    Waits,
    /// Complains about a text file, while planning.
    Complains,
    /// Misses a file, while planning.
    Misses,
}

#[derive(Serialize, Deserialize, JsonSchema, Default)]
#[serde(default, deny_unknown_fields)]
pub struct TroubleParams {
    /// What goes wrong.
    mischief: Mischief,
}

/// Goes wrong in the way asked for.
pub struct Trouble(TroubleParams);

impl Node for Trouble {
    const DECL: Decl = decl("solve/trouble", Grain::Pixel);
    head!(Trouble(TroubleParams), Plane => Plane);
    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        if matches!(self.0.mischief, Mischief::Complains) {
            return Err(NodeError::usage("the description has a mistake")
                .problems(vec![Problem::new("line 3 is wrong")]));
        }
        if matches!(self.0.mischief, Mischief::Misses) {
            return Err(NodeError::files("cannot read w.onnx: there is no such file").hint("put it there"));
        }
        Ok(vec![plane_meta(inputs)])
    }
    fn run(&self, input: Plane, cx: &Context) -> Result<Plane, NodeError> {
        match self.0.mischief {
            Mischief::None | Mischief::Complains | Mischief::Misses => {
                Ok(Plane { plane: map_pixels(&input.plane, cx, |value| value)? })
            }
            Mischief::Fails => Err(NodeError::failed("nothing works today").hint("try tomorrow")),
            Mischief::BadInput => Err(NodeError::input("pixel 3 is not a number")),
            Mischief::Panics => panic!("index 5 is beyond 3"),
            Mischief::Lies => {
                let meta = meta(1, 1);
                let band = MapBand::zeros(meta.extent.rows(), &meta);
                Ok(Plane { plane: MapSet::in_memory(Arc::new(meta), band) })
            }
            Mischief::Waits => loop {
                cx.advance(1)?;
                std::thread::sleep(std::time::Duration::from_millis(2));
            },
        }
    }
}

/// Estimates of the heavy nodes that run now, and the most there ever were together.
pub static HEAVY_NOW: AtomicU64 = AtomicU64::new(0);
pub static HEAVY_MOST: AtomicU64 = AtomicU64::new(0);

/// Takes a while, and records how much memory its kind takes together.
pub struct Heavy;

impl Node for Heavy {
    const DECL: Decl = decl("solve/heavy", Grain::Whole);
    type Params = AddParams;
    type In = Plane;
    type Out = Plane;
    fn build(_: AddParams) -> Result<Self, NodeError> {
        Ok(Heavy)
    }
    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![plane_meta(inputs)])
    }
    fn run(&self, input: Plane, cx: &Context) -> Result<Plane, NodeError> {
        // One input and, waiting for the writer, two outputs: as the scheduler counts.
        let bytes = 3 * Meta::Map(input.plane.meta.clone()).estimated_bytes();
        HEAVY_MOST.fetch_max(HEAVY_NOW.fetch_add(bytes, Ordering::SeqCst) + bytes, Ordering::SeqCst);
        std::thread::sleep(std::time::Duration::from_millis(30));
        HEAVY_NOW.fetch_sub(bytes, Ordering::SeqCst);
        Ok(Plane { plane: map_pixels(&input.plane, cx, |value| value)? })
    }
}
