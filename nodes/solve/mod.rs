//! From events and frames to photocurrent.

pub mod pixel;
