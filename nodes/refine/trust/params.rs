//! The parameters of what a node makes of predicted light.

use photocurrent_core::quantity::Duration;

/// How far light that others predict is trusted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TrustParams {
    /// No prediction is taken for better than this, natural-log units.
    pub floor: f64,
    /// What is predicted may come early or late by so much: steep edges err in their place, not in their
    /// height.
    pub late: Duration,
    /// Predictions for instants next to each other err together: each counts as if its variance were so many
    /// times as large.
    pub together: f64,
    /// Predictions within this time have one error in common: all of them narrow the posterior variance no
    /// more than one of them does. A picture is wrong at a place, and a pixel sees that place for long.
    pub one_error: Duration,
    /// What a pixel's events and frames, and what two sources, contradict a prediction by is pooled over this
    /// time.
    pub pooled: Duration,
    /// And over this, to see whether there is anything in the predictions at all.
    pub wide: Duration,
    /// What a frame weighs against an event when a pixel judges what is predicted.
    pub frame_weight: f64,
    /// One source alone can contradict nobody: its variance counts so many times.
    pub one_sided: f64,
    /// Nothing is predicted any more where contradictions, as a part of a squared threshold, reach this: by
    /// itself a pixel knows its light to a part of a threshold.
    pub most_contradiction: f64,
    /// Predictions must make the error of frames that were held out smaller by this part to be used in a
    /// region at all.
    pub clear_gain: f64,
    /// Pixels that were asked for frames that were held out count half so far away, pixels.
    pub near: f64,
    /// What the mean of all pixels that were asked weighs against those near, in pixels.
    pub everywhere: f64,
}

impl Default for TrustParams {
    fn default() -> TrustParams {
        TrustParams {
            floor: 0.01,
            late: Duration::new(50_000),
            together: 4.0,
            one_error: Duration::new(200_000_000),
            pooled: Duration::new(3_000_000),
            wide: Duration::new(15_000_000),
            frame_weight: 3.0,
            one_sided: 4.0,
            // At a half, chance hits of pixels that have nothing to do with each other still cost 0.13 dB.
            most_contradiction: 0.25,
            clear_gain: 0.03,
            near: 8.0,
            everywhere: 6.0,
        }
    }
}
