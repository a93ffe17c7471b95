//! A value with its interval.

use serde::Serialize;

/// A value with its interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Interval {
    /// The value.
    pub value: f64,
    /// Its 95 % interval.
    pub ci95: (f64, f64),
}
