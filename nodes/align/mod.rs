//! Two cameras become one: what an event array saw and what frames show, on the pixels of either.

pub mod recording;
pub mod tracks;
