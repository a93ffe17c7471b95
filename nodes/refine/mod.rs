//! Photocurrent that is known already, solved again with more knowledge.

pub mod motion;
