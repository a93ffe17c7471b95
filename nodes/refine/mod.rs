//! Photocurrent that is known already, solved again with more knowledge; and frames of it, refined by a
//! network.

mod again;
mod caution;
mod fallback;
#[cfg(test)]
mod fixtures;
pub mod motion;
pub mod onnx;
pub mod picture;
pub mod steered;
mod trust;
