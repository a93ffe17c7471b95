//! A sensor's prediction for a pixel on the present light: its events and frame values.

use photocurrent_sensor::front_end::FrontEnd;

/// An event as a sensor predicts it on the present light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PredictedEvent {
    /// When it fired, ns.
    pub t_ns: i64,
    /// When its reference was taken, ns.
    pub reference_ns: i64,
    /// +1 or -1.
    pub polarity: f64,
    /// Its threshold, positive, natural-log units.
    pub threshold: f64,
    /// Voltage less reference less signed threshold, natural-log units.
    pub excess: f64,
    /// How fast the voltage moved at both instants, root of the sum of squares, ln/s.
    pub slope_per_s: f64,
    /// How fast it moved when the event fired, in the event's direction, ln/s.
    pub rise_per_s: f64,
}

/// A frame value as a sensor predicts it on the present light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PredictedFrame {
    /// Begin of the exposure, ns.
    pub start_ns: i64,
    /// And its end.
    pub end_ns: i64,
    /// Predicted less recorded, DN.
    pub residual_dn: f64,
    /// About how bright it is, DN above black.
    pub signal_dn: f64,
}

/// A sensor's prediction for one pixel.
#[derive(Clone, Debug, Default)]
pub struct PixelPrediction {
    /// The low-pass, for derivatives.
    pub low_pass: FrontEnd,
    /// DN of a photocurrent of 1 over a second.
    pub gain: f64,
    /// Frame values that are known and not saturated.
    pub frames: Vec<PredictedFrame>,
    /// Events whose reference is known.
    pub events: Vec<PredictedEvent>,
    /// Instants at which none fired: events that would have, had their excess been in their direction.
    pub quiet: Vec<PredictedEvent>,
}
