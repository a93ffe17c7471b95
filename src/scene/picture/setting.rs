//! How a picture is fitted.

use super::register::Search;

/// How a picture is fitted.
#[derive(Clone, Copy, Debug)]
pub struct PictureSetting {
    /// Distance of coefficients, pixels.
    pub pitch: f64,
    /// And while motion is found, pixels.
    pub coarse_pitch: f64,
    /// Shortest time between knots of the motion, ns.
    pub knot_ns: i64,
    /// Rounds of Gauss-Newton at most: on the coarse grid, and on the fine one.
    pub rounds: (usize, usize),
    /// And on each at least so many.
    pub least_rounds: usize,
    /// Conjugate gradients in each.
    pub steps: (usize, usize),
    /// Standard deviation of frame values beyond what is stated, DN.
    pub frame_dn: f64,
    /// And as a share of the signal.
    pub frame_share: f64,
    /// Residuals count half at this many standard deviations.
    pub robust: f64,
    /// Frame noise may be this much smaller than it is first assumed.
    pub least_misfit: f64,
    /// A further round is taken while the misfit falls by this share.
    pub gain: f64,
    /// Second differences of the picture that are always possible, as a share of its mean.
    pub least_roughness: f64,
    /// Share of the picture's overall roughness in the local one.
    pub pooled: f64,
    /// Weight of the second differences of the motion's knots, one over pixels.
    pub motion_weight: f64,
    /// Standard deviation of scale and shear, pixels at the array's edge.
    pub stretch: f64,
    /// Is the array's shading fitted?
    pub is_shaded: bool,
    /// Where more than this share of frame values does not change, a scene that stands still is tried as
    /// well.
    pub still: f64,
    /// More frame values than this are not fitted: each takes some 300 bytes.
    pub most_values: usize,
    /// How motion begins.
    pub search: Search,
    /// So many times the picture is fitted to what it leaves, from where it stands.
    pub again: usize,
    /// Conjugate gradients of each of these times, and of a draw.
    pub again_steps: usize,
    /// See there.
    pub draw_steps: usize,
    /// Seed of draws of what frames leave open.
    pub seed: u64,
    /// What a picture is sharpened over to find what its fit removes, pixels.
    pub sharpest: f64,
}

impl Default for PictureSetting {
    fn default() -> PictureSetting {
        PictureSetting {
            pitch: 0.55,
            coarse_pitch: 1.3,
            knot_ns: 10_000_000,
            rounds: (5, 5),
            least_rounds: 3,
            steps: (40, 50),
            frame_dn: 1.0,
            frame_share: 0.005,
            robust: 4.0,
            least_misfit: 0.02,
            gain: 0.05,
            least_roughness: 0.003,
            pooled: 0.1,
            motion_weight: 1.0,
            stretch: 3.0,
            is_shaded: true,
            still: 0.4,
            most_values: 1_000_000,
            search: Search::default(),
            again: 5,
            again_steps: 30,
            draw_steps: 25,
            seed: 1,
            sharpest: 0.4,
        }
    }
}
