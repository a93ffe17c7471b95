//! Parameters of the motion estimate, and of predictions from neighbours along it.

use photocurrent_core::quantity::Duration;

/// How motion is estimated, and which tracks along it predict.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionParams {
    /// Speeds are cut to this, pixels per ms.
    pub fastest: f64,
    /// Difference of log light with half the weight.
    pub robust: f64,
    /// Least squared log light that a motion must explain to be used.
    pub least_contrast: f64,
    /// A place takes the motion of all pixels, or that of another place, where that leaves less by this part
    /// than its own does.
    pub clear_gain: f64,
    /// Other places whose motion is tried lie so far away by column or by row, pixels.
    pub farther: Vec<u32>,
    /// Standard deviation of the neighbourhood in which they are compared, pixels.
    pub neighbourhood: f64,
    /// Largest time between a neighbour's light and the pixel's.
    pub longest: Duration,
    /// Time from an event of its pixel at which a track has half the weight.
    pub fresh: Duration,
    /// Largest ratio of that loss of weight: the least weight is one over this and one.
    pub stalest: f64,
}

impl Default for MotionParams {
    fn default() -> MotionParams {
        MotionParams {
            fastest: 6.0,
            robust: 0.1,
            least_contrast: 1e-4,
            clear_gain: 0.5,
            farther: vec![8, 14],
            neighbourhood: 1.5,
            longest: Duration::new(12_000_000),
            fresh: Duration::new(1_500_000),
            stalest: 15.0,
        }
    }
}
