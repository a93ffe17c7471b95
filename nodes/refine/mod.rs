//! Refines solved photocurrent with additional information, and frames of it with a network.

mod again;
mod fallback;
#[cfg(test)]
mod fixtures;
pub mod motion;
pub mod onnx;
pub mod picture;
mod pseudo_measurement;
pub mod steered;
mod variance_factor;
