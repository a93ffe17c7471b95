//! The numbers of the filter.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// With or without the faults of the released code.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Variant {
    /// Exact deblurring, and every frame's own value in its certainty.
    #[default]
    Corrected,
    /// As the authors' code runs, faults included.
    AsReleased,
}

/// From where to where the filter runs, and when a picture is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Sequence {
    /// The whole recording, pictures at their instants.
    #[default]
    Whole,
    /// From the second frame to the second-to-last, pictures at the first event after their instants; those
    /// outside are not known.
    AsReleased,
}

/// The numbers of the filter.
#[derive(Clone, Debug)]
pub struct Settings {
    /// With or without faults.
    pub variant: Variant,
    /// From where to where.
    pub sequence: Sequence,
    /// Takes the latent picture of each frame instead of the frame itself.
    pub deblur: bool,
    /// 1/s.
    pub process_noise: f64,
    /// 1/s.
    pub isolated_noise: f64,
    /// 1/s.
    pub refractory_noise: f64,
    /// ns.
    pub refractory_ns: i64,
    /// Each of two.
    pub border_noise: f64,
    /// Bounds between which steps are scaled.
    pub scale: (f64, f64),
    /// Variance at the start.
    pub covariance: f64,
    /// Certainty of digital numbers.
    pub weight: Certainty,
}

/// Inverse variance of every 8-bit value.
#[derive(Clone, Debug)]
pub struct Certainty(pub(super) Vec<f64>);

impl Certainty {
    /// Of a value from 0 to 255, the nearest whole one; of one that is not known, that of 0.
    pub fn of(&self, value: f64) -> f64 {
        self.0[(value.round().max(0.0) as usize).min(255)]
    }
}
