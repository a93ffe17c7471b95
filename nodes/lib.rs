//! Every node kind of photocurrent: one file each, in families.
//!
//! A node knows its inputs, parameters and seed, and nothing of the graph around it. [`catalog`] is the one
//! list of all of them. What several nodes share stands next to the families: [`sampling`] (when virtual
//! frames are exposed), [`reconstruct`] (what methods that start from captured frames do alike), [`spans`]
//! (clocks that differ, and spans that are too long), [`held`] (means of held values over the exposures of
//! many frames), [`onnx`] (networks), [`backend`] (processor or card). [`show`] is what a
//! report shows of results.

#![warn(unreachable_pub)]

pub mod align;
mod backend;
pub mod baseline;
pub mod catalog;
mod command;
pub mod compensate;
mod crop;
pub mod diagnose;
pub mod estimate;
mod held;
mod onnx;
pub mod read;
mod reconstruct;
pub mod refine;
pub mod render;
pub mod sampling;
pub mod score;
pub mod show;
pub mod simulate;
pub mod solve;
pub mod spans;
pub mod split;
pub mod write;

pub use catalog::catalogue;
/// The effects that a sensor description states, held against the catalogue.
pub use photocurrent_sensor::effects::from_description as read_effects;
/// What a sensor may do beyond the paper's model, for those who list it.
pub use photocurrent_sensor::effects::sought::{Grows, Search, Signs, Size, Sought};
pub use photocurrent_sensor::effects::{EffectDecl, ParameterDecl, Unit, catalogue as effects};
