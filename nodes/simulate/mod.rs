//! Recordings with known truth.

pub mod pellet;
