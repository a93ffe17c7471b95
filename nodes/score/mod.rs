//! How good it is, each number with the card that defines it.

pub mod bew;
pub mod card;
pub mod compare;
pub mod coverage;
pub mod diagnosis;
pub mod edge;
pub mod glitch;
pub mod heldout;
pub mod lpips;
pub mod matching;
pub mod pixel_error;
pub mod psnr;
pub mod region;
pub mod ssim;
