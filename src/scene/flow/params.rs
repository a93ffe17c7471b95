//! The parameters of how motion is estimated, and of the neighbours that predict along it.

use photocurrent_core::quantity::Duration;

/// How motion is estimated, and which tracks along it predict.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionParams {
    /// Speeds are cut to this, pixels per ms.
    pub fastest: f64,
    /// Differences of log light of this size count half.
    pub robust: f64,
    /// What a motion must explain, as squared log light, to be used.
    pub least_contrast: f64,
    /// A place takes the motion of all pixels, or that of another place, where that leaves less by this part
    /// than its own does.
    pub clear_gain: f64,
    /// Other places whose motion is tried lie so far away by column or by row, pixels.
    pub farther: Vec<u32>,
    /// Standard deviation of the neighbourhood in which they are compared, pixels.
    pub neighbourhood: f64,
    /// A neighbour predicts only what passes it at most so long before or after the pixel.
    pub longest: Duration,
    /// A track counts half so long after or before an event of its pixel.
    pub fresh: Duration,
    /// And never less than one part in so many and one.
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
