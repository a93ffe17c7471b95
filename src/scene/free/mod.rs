//! Scenes that are estimated from frames and events together. They absorb part of an effect of the sensor,
//! and that part is computed.

mod noise;
mod predicted;

use crate::case::Case;
use crate::light::LogLight;
use crate::scene::SceneCell;
pub use noise::{LEAST_SHARE, SceneNoise, frame_noise};
pub(crate) use noise::{MOST_OF_RISE, frame_scale, is_rising, line, rise};
pub use predicted::{PixelPrediction, PredictedEvent, PredictedFrame};

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

/// A scene estimated from frames and events. The caller predicts the measurements for any sensor; only
/// derivatives are computed here. `predicted` is always of each pixel, on the present light.
pub trait FreeScene: Clone + Send + Sync {
    /// Pixels with fewer events than this bring errors of frames only.
    const FEWEST_EVENTS: usize;
    /// Is it one problem, in which a step may prove too long?
    const IS_ONE: bool;

    /// Its pixels (`y * width + x` of the array), in the order of everything that is predicted.
    fn pixels(&self) -> &[u32];

    /// The light of its pixels, empty elsewhere.
    fn light(&self, case: &Case) -> LogLight;

    /// Do the events of a pixel, by its place, take part in the scene and in scores?
    fn takes_part(&self, place: usize) -> bool;

    /// Are gains measured on them?
    fn is_measured(&self, place: usize) -> bool;

    /// Median misfit of the events, as a share of their thresholds.
    fn median_event_misfit(&self, predicted: &[PixelPrediction]) -> f64;

    /// The cell of the scene at one of its pixels at an instant, ns, smaller than the scene's resolution:
    /// errors of the scene are common to all pixels on one cell. `None` where no two pixels share one.
    fn cell(&self, _case: &Case, _pixel: usize, _t_ns: i64) -> Option<SceneCell> {
        None
    }

    /// Has the noise of events settled, so that further rounds change little?
    fn has_settled(&self) -> bool {
        false
    }

    /// One round: a Newton step, then prior and noise.
    fn newton_and_noise(&mut self, predicted: &[PixelPrediction]);

    /// A Newton step; prior and noise stay.
    fn newton_step(&mut self, predicted: &[PixelPrediction]);

    /// Efficient score of effects: the contribution of each pixel's measurements; `None` where there is none.
    /// `columns`: for each pixel the change, by an effect size of 1, of its frame values, its events'
    /// excesses, the log slopes at its events, and excesses at instants without one; `effects` values for
    /// each.
    fn score(
        &self,
        predicted: &[PixelPrediction],
        columns: &[Vec<f32>],
        effects: usize,
    ) -> Vec<Option<Score>>;

    /// Gain of effects of given sizes from each pixel, nats: as [`FreeScene::left_out`] with a Newton step,
    /// less the gain of that step without the effect. `None` without measurements. `columns` as in
    /// [`FreeScene::score`].
    fn gains(
        &self,
        predicted: &[PixelPrediction],
        columns: &[Vec<f32>],
        sizes: &[f64],
    ) -> Vec<Option<Vec<f64>>>;

    /// Of each pixel the log density of its events' times when the scene is estimated from other
    /// measurements, and of none between them, nats; and, where these do not bind the scene to the frames,
    /// that of its frame values.
    fn left_out(&self, predicted: &[PixelPrediction]) -> Vec<f64>;

    /// Objective that steps of one problem minimise, nats.
    fn objective(&self, _predicted: &[PixelPrediction]) -> f64 {
        0.0
    }

    /// Shortens the last step of one problem where it did not lower the objective, and undoes it where
    /// shorter ones do not either; returns `true` where it did.
    fn shorten_step(&mut self, _predicted: &[PixelPrediction]) -> bool {
        false
    }

    /// A Newton step of one problem together with effects that change by these sizes, so that the scene need
    /// not follow them step by step; `columns` as in [`FreeScene::score`].
    fn step_with_effects(&mut self, _predicted: &[PixelPrediction], _columns: &[Vec<f32>], _sizes: &[f64]) {}

    /// Difference in log density of each held-out event between the predictions of two sensors, nats, by
    /// pixel. Both use the noise of the first, with which the scene is estimated.
    fn event_gains(&self, with: &[PixelPrediction], without: &[PixelPrediction]) -> Vec<Vec<f64>>;

    /// Makes ready for [`FreeScene::score`] and [`FreeScene::gains`], and for steps from here on.
    fn prepare(&mut self, _predicted: &[PixelPrediction]) {}

    /// Frees buffers that can be recomputed.
    fn release(&mut self) {}
}
