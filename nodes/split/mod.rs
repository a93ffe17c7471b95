//! Splits: what is fitted is kept apart from what is tested, and a block of time from the rest.

pub mod frames;
pub mod time;
