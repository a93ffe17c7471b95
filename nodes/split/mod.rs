//! Splits: what is fitted is kept apart from what is tested.

pub mod frames;
