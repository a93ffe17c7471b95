//! Photocurrent that is known already, solved again with more knowledge.

mod again;
mod caution;
mod film;
#[cfg(test)]
mod fixtures;
mod flow;
pub mod motion;
pub mod picture;
pub mod steered;
mod trust;
