//! What a pixel's solution is: its light over time.

/// The light of a pixel over time, log-linear between instants.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PixelTrack {
    /// Instants, ns, rising.
    pub t_ns: Vec<i64>,
    /// Photocurrent, in units in which `frames.gain` counts.
    pub photocurrent: Vec<f64>,
    /// Standard deviation of its natural logarithm.
    pub log_sigma: Vec<f64>,
    /// Did the solution converge? Otherwise it is the double-integral estimate.
    pub has_converged: bool,
}
