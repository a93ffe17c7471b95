//! Latency compensation for methods that have no latch of their own.

pub mod readout;
