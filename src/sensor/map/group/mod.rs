//! Many pixels, eight at a time, one in each lane of a vector.
//!
//! The passes over a chain wait for their own results most of the time; eight chains side by side wait
//! together. Lanes never mix, so that the answer is the same to
//! the last bit whichever pixels share a group. Pixels that ask for a second start wait until eight of them
//! do.

mod again;
mod columns;
mod lane;
mod passes;
mod solve;
#[cfg(test)]
mod step_tests;
pub(super) mod stream;
#[cfg(test)]
mod tests;
mod variance;
mod waiting;

pub use lane::{ATTEMPTS, FIRST_DAMPING, NO_EVENT_FROM};
pub use passes::LOG_TWO_PI;
pub use solve::MapGroup;
pub use solve::{FIRST_VARIANCE, LOG_LIMIT, LONGEST_STEP};
