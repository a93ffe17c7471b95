//! Scenes that are estimated from frames and events together: what an effect of the sensor changes of the
//! measurements they follow in part, and it is known how far.

mod noise;
mod predicted;

use crate::case::Case;
use crate::light::Light;
use crate::scene::Cell;
pub use noise::{LEAST_SHARE, Noise, frame_noise};
pub(crate) use noise::{MOST_OF_RISE, frame_scale, is_rising, line, rise};
pub use predicted::{Predicted, PredictedEvent, PredictedFrame};

/// Efficient score of some effects, and its covariance: with H the normal matrix of the scene, g its
/// gradient, B the columns of effects, W the weights, rho the residuals and G = J'W B it is B'W rho -
/// G'H^-1 g, and the information is B'W B - G'H^-1 G.
#[derive(Clone, Debug, Default)]
pub struct Score {
    /// Of each effect: derivative of half the weighted squares by its size, the scene adapted.
    pub score: Vec<f64>,
    /// Its information on all effects: K x K, the scene adapted.
    pub information: Vec<f64>,
    /// The diagonal when the scene is known.
    pub known: Vec<f64>,
}

/// A scene that follows frames and events. The caller predicts the measurements at any sensor; only
/// derivatives are taken here. `predicted` is always of each pixel, on the light as it stands.
pub trait FreeScene: Clone + Send + Sync {
    /// Pixels with fewer events than this bring errors of frames only.
    const FEWEST_EVENTS: usize;
    /// Is it one problem, in which a step may prove too long?
    const IS_ONE: bool;

    /// Its pixels (`y * width + x` of the array), in the order of everything that is predicted.
    fn pixels(&self) -> &[u32];

    /// The light of its pixels, empty elsewhere.
    fn light(&self, case: &Case) -> Light;

    /// Do the events of a pixel, by its place, take part in the scene and in scores?
    fn takes_part(&self, place: usize) -> bool;

    /// Are gains measured on them?
    fn is_measured(&self, place: usize) -> bool;

    /// What events miss their thresholds by on the scene, a median share of them.
    fn left(&self, predicted: &[Predicted]) -> f64;

    /// The cell of the scene that one of its pixels sees at an instant, ns, smaller than what the scene
    /// resolves: what is wrong with the scene is alike for all pixels on one cell. None where no two
    /// pixels see the same.
    fn cell(&self, _case: &Case, _pixel: usize, _t_ns: i64) -> Option<Cell> {
        None
    }

    /// Has the noise of events settled, so that further rounds change little?
    fn has_settled(&self) -> bool {
        false
    }

    /// One round: a Newton step, then prior and noise.
    fn round(&mut self, predicted: &[Predicted]);

    /// A Newton step; prior and noise stay.
    fn settle(&mut self, predicted: &[Predicted]);

    /// Efficient score of effects: what each pixel's measurements add to it; none where they add nothing.
    /// `columns`: for each pixel what an effect size of 1 changes of its frame values, its events' excesses,
    /// the logarithms of the slopes at its events, and excesses where none fired, `effects` values for each.
    fn score(&self, predicted: &[Predicted], columns: &[Vec<f32>], effects: usize) -> Vec<Option<Score>>;

    /// What effects of a size each gain from each pixel, nats: as [`FreeScene::left_out`] with a Newton step,
    /// and beyond what that step gains without one; none where nothing is measured. `columns` as in
    /// [`FreeScene::score`].
    fn gains(&self, predicted: &[Predicted], columns: &[Vec<f32>], sizes: &[f64]) -> Vec<Option<Vec<f64>>>;

    /// Of each pixel the log density of its events' times when the scene is estimated from other
    /// measurements, and of none between them, nats; and, where these do not bind the scene to the frames,
    /// that of its frame values.
    fn left_out(&self, predicted: &[Predicted]) -> Vec<f64>;

    /// What steps of one problem lessen, nats.
    fn objective(&self, _predicted: &[Predicted]) -> f64 {
        0.0
    }

    /// Goes back part of the last step of one problem where it did not lessen what it should, and all of it
    /// where shorter ones do not, either; `true` where it did.
    fn back(&mut self, _predicted: &[Predicted]) -> bool {
        false
    }

    /// A Newton step of one problem together with effects that change by these sizes, so that the scene need
    /// not follow them step by step; `columns` as in [`FreeScene::score`].
    fn follow(&mut self, _predicted: &[Predicted], _columns: &[Vec<f32>], _sizes: &[f64]) {}

    /// How much more probable each event that gains are measured on is with what one sensor predicts than
    /// with what another does, nats, of each pixel; both by the noise that the first leaves, which the scene
    /// is estimated with.
    fn event_gains(&self, with: &[Predicted], without: &[Predicted]) -> Vec<Vec<f64>>;

    /// Makes ready for [`FreeScene::score`] and [`FreeScene::gains`], and for steps from here on.
    fn prepare(&mut self, _predicted: &[Predicted]) {}

    /// Gives back room that can be filled again.
    fn release(&mut self) {}
}
