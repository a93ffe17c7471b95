//! From photocurrent to pictures.

pub mod colour;
pub mod demosaic;
pub mod grey;
mod job;
mod on_card;
#[cfg(test)]
#[cfg(feature = "gpu")]
mod on_card_tests;
mod reading;
pub mod rows;
