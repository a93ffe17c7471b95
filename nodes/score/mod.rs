//! How good it is, each number with the card that defines it.

pub mod heldout;
pub mod matching;
pub mod psnr;
pub mod region;
