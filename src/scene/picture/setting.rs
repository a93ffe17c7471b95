//! Settings of a picture's fit.

use photocurrent_core::quantity::Duration;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Standard deviation of frame values beyond what is stated: DN, and a share of the signal.
pub(crate) const FRAME_NOISE: (f64, f64) = (1.0, 0.005);
/// Standard deviations at which a residual has half the weight.
pub(crate) const ROBUST: f64 = 4.0;
/// Rounds of Gauss-Newton on each grid, at least.
pub(super) const LEAST_ROUNDS: usize = 3;
/// Frame noise may be this much smaller than it is first assumed.
pub(super) const LEAST_MISFIT: f64 = 0.02;
/// A further round is taken while the misfit falls by this share.
pub(super) const GAIN: f64 = 0.05;
/// Second differences of the picture that are always possible, as a share of its mean.
pub(super) const LEAST_ROUGHNESS: f64 = 0.003;
/// Share of the picture's overall roughness in the local one.
pub(super) const POOLED: f64 = 0.1;
/// Weight of the second differences of the motion's knots, one over pixels.
pub(crate) const MOTION_WEIGHT: f64 = 1.0;
/// Standard deviation of scale and shear, pixels at the array's edge.
pub(crate) const STRETCH: f64 = 3.0;
/// Share of unchanging frame values above which a scene before a still ground is tried as well.
pub(super) const STILL: f64 = 0.4;
/// Seed of posterior samples.
pub(super) const SEED: u64 = 1;

/// How a picture is fitted.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct PictureSetting {
    /// Distance of the picture's coefficients, pixels.
    #[schemars(range(min = 0.3, max = 4.0))]
    pub pitch: f64,
    /// Shortest time between knots of the picture's motion.
    #[schemars(extend("x-min" = "1 ms", "x-max" = "1 s"))]
    pub knot: Duration,
    /// Number of further fits of the picture to its residuals (twicing).
    #[schemars(range(max = 50))]
    pub again: usize,
    /// Most frame values of a fit: of a longer recording the neighbouring frames with the most events are
    /// used; a fit takes some 300 bytes for each.
    #[schemars(range(min = 1_000))]
    pub most_values: usize,
    /// Radius over which a picture is sharpened for the control, to measure what its fit removes, pixels.
    #[schemars(range(min = 0.0, max = 4.0))]
    pub sharpest: f64,
    /// Distance of coefficients while motion is found, pixels.
    #[serde(skip)]
    pub coarse_pitch: f64,
    /// Rounds of Gauss-Newton at most: on the coarse grid, and on the fine one.
    #[serde(skip)]
    pub rounds: (usize, usize),
    /// Conjugate gradients in each.
    #[serde(skip)]
    pub steps: (usize, usize),
    /// Conjugate gradients of each of the times that the picture is fitted again.
    #[serde(skip)]
    pub again_steps: usize,
    /// And of a posterior sample.
    #[serde(skip)]
    pub draw_steps: usize,
    /// Is the array's shading fitted?
    #[serde(skip)]
    pub is_shaded: bool,
}

impl Default for PictureSetting {
    fn default() -> PictureSetting {
        PictureSetting {
            pitch: 0.55,
            knot: Duration::new(10_000_000),
            again: 5,
            most_values: 1_000_000,
            sharpest: 0.4,
            coarse_pitch: 1.3,
            rounds: (5, 5),
            steps: (40, 50),
            again_steps: 30,
            draw_steps: 25,
            is_shaded: true,
        }
    }
}

impl PictureSetting {
    /// Settings for pictures of parts of the array, from those for the whole.
    #[must_use]
    pub fn for_parts(&self) -> PictureSetting {
        let PictureSetting { pitch, knot, sharpest, .. } = *self;
        PictureSetting {
            pitch,
            knot,
            sharpest,
            rounds: (4, 4),
            steps: (30, 60),
            again: 3,
            again_steps: 40,
            draw_steps: 30,
            is_shaded: false,
            ..PictureSetting::default()
        }
    }
}
