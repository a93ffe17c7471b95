//! Parameters of pseudo-measurements from predicted light.

use photocurrent_core::quantity::Duration;

/// Parameters of the variance of predicted light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PseudoMeasurementParams {
    /// Least standard deviation of a prediction, natural-log units.
    pub floor: f64,
    /// Time error of a prediction: steep edges have errors of their place, not of their height.
    pub late: Duration,
    /// Factor on the variance of each prediction, as neighbouring ones have common errors.
    pub together: f64,
    /// Time within which predictions have one common error: all of them narrow the posterior variance no more
    /// than one of them. A picture is wrong at a place, and a pixel sees that place for long.
    pub one_error: Duration,
    /// Time over which innovations of events, frames and two sources are pooled.
    pub pooled: Duration,
    /// Time over which they are pooled to test whether the predictions are usable at all.
    pub wide: Duration,
    /// Weight of a frame relative to an event.
    pub frame_weight: f64,
    /// Factor on the variance of a single source, which has no other to compare with.
    pub one_sided: f64,
    /// Pooled innovation, as a share of a squared threshold, from which predictions are rejected: by itself a
    /// pixel's light is accurate to a part of a threshold.
    pub most_innovation: f64,
    /// Least reduction of the error of held-out frames for predictions to be used in a region.
    pub clear_gain: f64,
    /// Distance at which a sampled pixel has half the weight, pixels.
    pub near_pixels: f64,
    /// Weight of the mean of all sampled pixels relative to those near, in pixels.
    pub mean_weight: f64,
}

impl Default for PseudoMeasurementParams {
    fn default() -> PseudoMeasurementParams {
        PseudoMeasurementParams {
            floor: 0.01,
            late: Duration::new(50_000),
            together: 4.0,
            one_error: Duration::new(200_000_000),
            pooled: Duration::new(3_000_000),
            wide: Duration::new(15_000_000),
            frame_weight: 3.0,
            one_sided: 4.0,
            // At a half, chance hits of pixels that have nothing to do with each other still cost 0.13 dB.
            most_innovation: 0.25,
            clear_gain: 0.03,
            near_pixels: 8.0,
            mean_weight: 6.0,
        }
    }
}
