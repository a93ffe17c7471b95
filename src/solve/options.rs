//! How a recording is solved: the parameters of `solve/map` and of `solve/paper`.

use photocurrent_core::NodeError;
use photocurrent_core::quantity::Duration;
use serde::{Deserialize, Serialize};

/// How the front end's delay is treated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum FrontEndModel {
    /// No delay: V_FE = V_DC, tau = 0 in Eq. (7).
    Ideal,
    /// A first-order low-pass with tau = tau_0 + alpha / i_pd, Eqs. (1)-(3).
    #[default]
    LowPass,
}

/// How readout latency and refractory period are treated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum ReadoutModel {
    /// Not at all: Eq. (8).
    None,
    /// By the local slope: Eqs. (9)-(12).
    #[default]
    Slope,
}

/// Which photocurrent sets the time constant of an interval.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum TauChoice {
    /// The one at its start, as Eqs. (2) and (3) are printed.
    Start,
    /// The one at its end, which drives the voltage in Eq. (1): better at every steep edge.
    #[default]
    End,
}

/// How exactly Eq. (13) is minimised.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    /// Sixteen pixels at once in single precision: costs to four digits, more than ten times as fast. Pixels
    /// near a fold are solved in double precision.
    #[default]
    Single,
    /// One pixel after the other in double precision: the reference.
    Double,
}

/// Which frames are solved together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Joint {
    /// Two consecutive frames at a time.
    #[default]
    Pairs,
    /// All frames of the recording at once.
    All,
}

/// Where the first unknown of a window stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum FirstKnot {
    /// At the window's start, so that the first event's step counts too.
    #[default]
    Window,
    /// At the first event, as printed: its step is not used.
    Event,
}

/// How the MAP estimate is made.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct SolveOptions {
    /// How the front end's delay is treated.
    pub front_end: FrontEndModel,
    /// Standard deviation of an event as a part of its threshold; absent = chosen for each block of 16 rows
    /// so that frames that are held out are predicted best.
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0.0)))]
    pub event_noise: Option<f64>,
    /// Model error of a frame value, as a part of it, in addition to the noise that the sensor description
    /// states, 1 DN, and what pixels without events show beyond that.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0)))]
    pub frame_noise: f64,
    /// Knots near events lie at most this far apart; in quiet gaps they widen with the distance from an
    /// event, to 8 ms or a 64th of the frame period.
    #[cfg_attr(feature = "schema", schemars(extend("x-min" = "10 us")))]
    pub knot_spacing: Duration,
    /// Every knot of the tracks carries a standard deviation: what measurements and prior leave open, widened
    /// where frames that are held out show that to be too little.
    pub sigma: bool,
    /// How often the light is solved again with what the description's `[effects]` did to events at the light
    /// found before; 0 = `[effects]` are left as they are, in events and frames; absent = 2, or 4 where
    /// effects mix the photocurrent of neighbours. Without `[effects]` it has no effect.
    #[cfg_attr(feature = "schema", schemars(range(max = 20)))]
    pub undo_rounds: Option<u32>,
    /// How far the light of a pixel may rise above that of its brightest frame, natural-log units: what is
    /// brighter is held there, the pixel is counted and the plane `implausible` of `map` states how far it
    /// went. 3 is a factor of 20. Raise it for lights that flash between frames, or beyond saturation.
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0.0)))]
    pub plausible_range: f64,
    /// Most steps tried for one problem; more than 5 make it follow its own estimate.
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 5)))]
    pub max_iterations: u32,
}

impl Default for SolveOptions {
    fn default() -> Self {
        SolveOptions {
            front_end: FrontEndModel::LowPass,
            event_noise: None,
            frame_noise: FRAME_NOISE,
            knot_spacing: KNOT_SPACING,
            sigma: true,
            undo_rounds: None,
            plausible_range: PLAUSIBLE_RANGE,
            max_iterations: STEPS,
        }
    }
}

/// How Eq. (13) is solved.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct PaperOptions {
    /// How the front end's delay is treated.
    pub front_end: FrontEndModel,
    /// How readout latency and refractory period are treated; `slope` needs in-pixel times.
    pub readout: ReadoutModel,
    /// Which photocurrent sets the time constant of an interval.
    pub tau_rule: TauChoice,
    /// How exactly it computes.
    pub precision: Precision,
    /// Which frames are solved together.
    pub frames: Joint,
    /// Where the first unknown of a window stands.
    pub first_knot: FirstKnot,
    /// Weight of a squared frame residual, per DN^2; the paper has 1.
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0.0)))]
    pub cis_weight: f64,
    /// Weight of a squared event residual, per natural-log unit squared; the paper has 1.
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0.0)))]
    pub evs_weight: f64,
    /// How far the light of a pixel may rise above that of its brightest frame, natural-log units: what is
    /// brighter is held there, the pixel is counted and the plane `implausible` of `map` states how far it
    /// went. 3 is a factor of 20. Raise it for lights that flash between frames, or beyond saturation.
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0.0)))]
    pub plausible_range: f64,
    /// Most steps tried for one problem.
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 10000)))]
    pub max_iterations: u32,
}

impl Default for PaperOptions {
    fn default() -> Self {
        PaperOptions {
            front_end: FrontEndModel::LowPass,
            readout: ReadoutModel::Slope,
            tau_rule: TauChoice::End,
            precision: Precision::Single,
            frames: Joint::Pairs,
            first_knot: FirstKnot::Window,
            cis_weight: 1.0,
            evs_weight: 1.0,
            plausible_range: PLAUSIBLE_RANGE,
            max_iterations: 100,
        }
    }
}

/// Frame values are not assumed to better than this, DN: simulated frames can be free of noise, and a misfit
/// would then count without limit.
pub(crate) const LEAST_FRAME_SIGMA_DN: f64 = 1.0;
/// How far voltage and reference may be apart beyond a threshold without an event, natural-log units.
pub(crate) const NO_EVENT_SIGMA: f64 = 0.03;
/// The usual [`SolveOptions::frame_noise`].
pub(crate) const FRAME_NOISE: f64 = 0.02;
/// The usual [`SolveOptions::knot_spacing`].
const KNOT_SPACING: Duration = Duration::new(250_000);

/// More steps than this do not improve a pixel.
pub(crate) const STEPS: u32 = 5;

/// The usual [`SolveOptions::undo_rounds`].
const UNDO_ROUNDS: u32 = 2;
/// The same where effects mix the photocurrent of neighbours, which converges more slowly: a blur by 0.7
/// pixels leaves half of its error after two rounds, a fifth after four.
const MIXED_UNDO_ROUNDS: u32 = 4;

/// The usual `plausible_range`.
const PLAUSIBLE_RANGE: f64 = 3.0;

impl SolveOptions {
    pub(crate) fn undo_rounds(&self, is_mixed: bool) -> u32 {
        self.undo_rounds.unwrap_or(if is_mixed { MIXED_UNDO_ROUNDS } else { UNDO_ROUNDS })
    }

    /// Refuses what a schema cannot.
    ///
    /// # Errors
    /// When `plausible_range` is not above 0.
    pub fn check(&self) -> Result<(), NodeError> {
        check_range(self.plausible_range)
    }
}

impl PaperOptions {
    /// Refuses what a schema cannot.
    ///
    /// # Errors
    /// When `plausible_range` is not above 0.
    pub fn check(&self) -> Result<(), NodeError> {
        check_range(self.plausible_range)
    }
}

fn check_range(plausible_range: f64) -> Result<(), NodeError> {
    if plausible_range > 0.0 {
        return Ok(());
    }
    Err(NodeError::usage(format!("`plausible_range` is {plausible_range}, and must be above 0"))
        .param("plausible_range"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_that_holds_all_light_down_is_refused() {
        for range in [0.0, -1.0, f64::NAN] {
            assert!(SolveOptions { plausible_range: range, ..SolveOptions::default() }.check().is_err());
            assert!(PaperOptions { plausible_range: range, ..PaperOptions::default() }.check().is_err());
        }
    }
}
