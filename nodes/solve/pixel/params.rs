//! The parameters of `solve/pixel`.
//!
//! Its two methods share few of them. Those that one method reads alone are `Option`s, so that one that was stated can be distinguished from one that was not:
//! what would do nothing is refused.

use photocurrent_core::NodeError;
use photocurrent_core::quantity::Duration;
use photocurrent_sensor::map::SecondStart;
use photocurrent_sensor::map::estimate::Choosing;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What is solved for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// The paper's least squares: one unknown per event, held between events.
    Paper,
    /// The MAP estimate: fine knots, exact reset, all frames at once, and a prior.
    #[default]
    Map,
}

/// How the front end's delay is treated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FrontEndModel {
    /// No delay: V_FE = V_DC, tau = 0 in Eq. (7).
    Ideal,
    /// A first-order low-pass with tau = tau_0 + alpha / i_pd, Eqs. (1)-(3).
    #[default]
    LowPass,
}

/// How readout latency and refractory period are treated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ReadoutModel {
    /// Not at all: Eq. (8).
    None,
    /// By the local slope: Eqs. (9)-(12).
    #[default]
    Slope,
}

/// Which photocurrent sets the time constant of an interval.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TauChoice {
    /// The one at its start, as Eqs. (2) and (3) are printed.
    Start,
    /// The one at its end, which drives the voltage in Eq. (1): better at every steep edge.
    #[default]
    End,
}

/// How exactly Eq. (13) is minimised.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    /// Sixteen pixels at once in single precision: costs to four digits, more than ten times as fast. Pixels near a fold are solved in double precision.
    #[default]
    Single,
    /// One pixel after the other in double precision: the reference.
    Double,
}

/// Which frames are solved together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Joint {
    /// Two consecutive frames at a time.
    #[default]
    Pairs,
    /// All frames of the recording at once.
    All,
}

/// Where the first unknown of a window stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FirstKnot {
    /// At the window's start, so that the first event's step counts too.
    #[default]
    Window,
    /// At the first event, as printed: its step is not used.
    Event,
}

/// What it takes to decide for something that is not usual, for `method = "map"`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Decisions {
    /// So many pixels of each block of 16 rows choose its noise and prior, at least.
    #[schemars(range(min = 1, max = 65536))]
    pub pixels: u32,
    /// A noise or a prior that is not the usual one must predict frames that are held out better by this part.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub clear_gain: f64,
    /// A third of those pixels looks at everything that is tried, the others only at what loses at most this part more than the best does there.
    #[schemars(range(min = 0.0))]
    pub reach: f64,
    /// A pixel is solved from a second start where its events are missed by more than this: mean square, in their standard deviations. 1e9 = never.
    #[schemars(range(min = 0.0))]
    pub second_misfit: f64,
    /// And where events and frames together are missed by less than this: beyond, they contradict each other, and no start helps.
    #[schemars(range(min = 0.0))]
    pub second_most_misfit: f64,
    /// Standard deviation of an event on the way to the second start, as a part of its threshold.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub second_event_noise: f64,
    /// Most steps on the way to it.
    #[schemars(range(min = 1, max = 100))]
    pub second_steps: u32,
    /// What is found from there is taken where it makes all squared misfits together smaller by this part.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub second_gain: f64,
}

impl Decisions {
    /// Of noise and prior.
    pub(super) fn choosing(&self) -> Choosing {
        Choosing { clear_gain: self.clear_gain, reach: self.reach }
    }

    /// Of a second start.
    pub(super) fn second(&self) -> SecondStart {
        SecondStart {
            event: self.second_event_noise,
            steps: self.second_steps as usize,
            least_misfit: self.second_misfit,
            most_misfit: self.second_most_misfit,
            gain: self.second_gain,
        }
    }
}

impl Default for Decisions {
    fn default() -> Self {
        let (choosing, second) = (Choosing::USUAL, SecondStart::USUAL);
        Decisions {
            pixels: CHOOSING_PIXELS,
            clear_gain: choosing.clear_gain,
            reach: choosing.reach,
            second_misfit: second.least_misfit,
            second_most_misfit: second.most_misfit,
            second_event_noise: second.event,
            second_steps: second.steps as u32,
            second_gain: second.gain,
        }
    }
}

/// Parameters of `solve/pixel`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// What is solved for. `front_end`, `plausible_range` and `max_iterations` count for both methods; every other parameter names the one that reads it, and is refused with
    /// the other.
    pub method: Method,
    /// For `map`: standard deviation of an event as a part of its threshold; absent = chosen for each block of 16 rows so that frames
    /// that are held out are predicted best.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub event_noise: Option<f64>,
    /// For `map`: model error of a frame value, as a part of it, in addition to the noise that the sensor description states, 1 DN, and what pixels without
    /// events show beyond that; absent = 0.02.
    #[schemars(range(min = 0.0))]
    pub frame_noise: Option<f64>,
    /// For `map`: knots near events lie at most this far apart; in quiet gaps they widen with the distance from an event, to 8 ms; absent = 250 us.
    #[schemars(extend("x-min" = "10 us"))]
    pub knot_spacing: Option<Duration>,
    /// For `map`: every knot of the tracks carries a standard deviation: what measurements and prior leave open, widened where frames that are held out
    /// show that to be too little; absent = true.
    pub sigma: Option<bool>,
    /// For `map`: how often the light is solved again with what the description's `[effects]` did to events at the light found before; 0 = `[effects]` are left as they are, in events
    /// and frames; absent = 2, or 4 where effects mix the photocurrent of neighbours. Without `[effects]` it has no effect.
    #[schemars(range(max = 20))]
    pub undo_rounds: Option<u32>,
    /// For `map`: what it takes to choose another noise or prior, or to solve a pixel from a second start; absent = what was measured to suit most recordings.
    pub decisions: Option<Decisions>,
    /// How the front end's delay is treated.
    pub front_end: FrontEndModel,
    /// For `paper`: how readout latency and refractory period are treated; absent = `slope`, which needs in-pixel times.
    pub readout: Option<ReadoutModel>,
    /// For `paper`: which photocurrent sets the time constant of an interval; absent = `end`.
    pub tau_rule: Option<TauChoice>,
    /// For `paper`: how exactly it computes; absent = `single`.
    pub precision: Option<Precision>,
    /// For `paper`: which frames are solved together; absent = `pairs`.
    pub frames: Option<Joint>,
    /// For `paper`: where the first unknown of a window stands; absent = `window`.
    pub first_knot: Option<FirstKnot>,
    /// For `paper`: weight of a squared frame residual, per DN^2; absent = 1, as the paper has it.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub cis_weight: Option<f64>,
    /// For `paper`: weight of a squared event residual, per natural-log unit squared; absent = 1, as the paper has it.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub evs_weight: Option<f64>,
    /// How far the light of a pixel may rise above that of its brightest frame, natural-log units: what is brighter is held there, the pixel is counted and the
    /// plane `implausible` of `map` says how far it went. 3 is a factor of 20. Raise it for lights that flash between frames, or beyond saturation.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub plausible_range: f64,
    /// Most steps tried for one problem; `map` never takes more than 5: more make it follow its own estimate.
    #[schemars(range(min = 1, max = 10000))]
    pub max_iterations: u32,
}

impl Default for Params {
    fn default() -> Self {
        Params {
            method: Method::Map,
            event_noise: None,
            frame_noise: None,
            knot_spacing: None,
            sigma: None,
            undo_rounds: None,
            decisions: None,
            front_end: FrontEndModel::LowPass,
            readout: None,
            tau_rule: None,
            precision: None,
            frames: None,
            first_knot: None,
            cis_weight: None,
            evs_weight: None,
            plausible_range: PLAUSIBLE_RANGE,
            max_iterations: 100,
        }
    }
}

/// What `frame_noise` is when nobody says.
pub(crate) const FRAME_NOISE: f64 = 0.02;
/// What `knot_spacing` is when nobody says.
pub(crate) const KNOT_SPACING: Duration = Duration::new(250_000);

/// What `decisions.pixels` is when nobody says.
const CHOOSING_PIXELS: u32 = 192;

/// What `undo_rounds` is when nobody says.
const UNDO_ROUNDS: u32 = 2;
/// The same where effects mix the photocurrent of neighbours, which converges more slowly: a blur by 0.7 pixels leaves half of its error after two rounds, a fifth after four.
const MIXED_UNDO_ROUNDS: u32 = 4;

/// What `plausible_range` is when nobody says.
const PLAUSIBLE_RANGE: f64 = 3.0;

impl Params {
    pub(super) fn sigma(&self) -> bool {
        self.sigma.unwrap_or(true)
    }

    pub(super) fn knot_spacing(&self) -> Duration {
        self.knot_spacing.unwrap_or(KNOT_SPACING)
    }

    pub(super) fn undo_rounds(&self, is_mixed: bool) -> u32 {
        self.undo_rounds.unwrap_or(if is_mixed { MIXED_UNDO_ROUNDS } else { UNDO_ROUNDS })
    }

    pub(super) fn decisions(&self) -> Decisions {
        self.decisions.unwrap_or_default()
    }

    pub(super) fn readout(&self) -> ReadoutModel {
        self.readout.unwrap_or_default()
    }

    /// Of frame and event residuals.
    pub(super) fn weights(&self) -> (f64, f64) {
        (self.cis_weight.unwrap_or(1.0), self.evs_weight.unwrap_or(1.0))
    }

    /// Refuses what was stated and would do nothing: a reader of the manifest would count on it.
    pub(super) fn check(&self) -> Result<(), NodeError> {
        if self.plausible_range.is_nan() || self.plausible_range <= 0.0 {
            return Err(NodeError::usage(format!("`plausible_range` is {}, and must be above 0", self.plausible_range)).param("plausible_range"));
        }
        let of_map = [
            ("event_noise", self.event_noise.is_some()),
            ("frame_noise", self.frame_noise.is_some()),
            ("knot_spacing", self.knot_spacing.is_some()),
            ("sigma", self.sigma.is_some()),
            ("undo_rounds", self.undo_rounds.is_some()),
            ("decisions", self.decisions.is_some()),
        ];
        let of_paper = [
            ("readout", self.readout.is_some()),
            ("tau_rule", self.tau_rule.is_some()),
            ("precision", self.precision.is_some()),
            ("frames", self.frames.is_some()),
            ("first_knot", self.first_knot.is_some()),
            ("cis_weight", self.cis_weight.is_some()),
            ("evs_weight", self.evs_weight.is_some()),
        ];
        let (not_read, method, reader) = match self.method {
            Method::Map => (of_paper.as_slice(), "\"map\"` (the default)", "paper"),
            Method::Paper => (of_map.as_slice(), "\"paper\"`", "map"),
        };
        let idle: Vec<&str> = not_read.iter().filter(|(_, is_given)| *is_given).map(|(name, _)| *name).collect();
        let Some(first) = idle.first() else { return Ok(()) };
        let names: Vec<String> = idle.iter().map(|name| format!("`{name}`")).collect();
        let (all, does, it) = match names.as_slice() {
            [one] => (one.clone(), "does", "it"),
            [others @ .., last] => (format!("{} and {last}", others.join(", ")), "do", "them"),
            [] => return Ok(()),
        };
        Err(NodeError::usage(format!("{all} {does} nothing with `method = {method}: `method = \"{reader}\"` alone reads {it}"))
            .hint(format!("take {it} out, or set `method = \"{reader}\"`"))
            .param(*first))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn refusal(params: serde_json::Value) -> Option<NodeError> {
        let params: Params = serde_json::from_value(params).unwrap();
        params.check().err()
    }

    #[test]
    fn what_the_other_method_reads_is_refused_by_name() {
        let error = refusal(json!({ "evs_weight": 1.0 })).unwrap();
        assert_eq!(error.message, "`evs_weight` does nothing with `method = \"map\"` (the default): `method = \"paper\"` alone reads it");
        assert_eq!((error.param.as_deref(), error.hint.as_deref()), (Some("evs_weight"), Some("take it out, or set `method = \"paper\"`")));
        let error = refusal(json!({ "method": "paper", "sigma": true, "frame_noise": 0.02, "event_noise": 0.1 })).unwrap();
        assert!(error.message.starts_with("`event_noise`, `frame_noise` and `sigma` do nothing with `method = \"paper\"`: "), "{}", error.message);
        assert_eq!(error.hint.as_deref(), Some("take them out, or set `method = \"map\"`"));
    }

    #[test]
    fn decisions_that_are_not_stated_are_those_of_the_solver() {
        let stated = |params: serde_json::Value| serde_json::from_value::<Params>(params).unwrap().decisions();
        for decisions in [stated(json!({})), stated(json!({ "decisions": {} }))] {
            assert_eq!((decisions.choosing(), decisions.second()), (Choosing::USUAL, SecondStart::USUAL));
        }
        let stated = stated(json!({ "decisions": { "clear_gain": 0.5, "second_misfit": 7.0 } }));
        let (choosing, second) = (Choosing { clear_gain: 0.5, ..Choosing::USUAL }, SecondStart { least_misfit: 7.0, ..SecondStart::USUAL });
        assert_eq!((stated.choosing(), stated.second()), (choosing, second));
    }

    /// Every parameter with a value, for each method: `method` accepts those of its own and the shared ones, and no others.
    #[test]
    fn each_parameter_is_read_by_one_method_or_by_both() {
        let of_map = [
            ("event_noise", json!(0.1)),
            ("frame_noise", json!(0.02)),
            ("knot_spacing", json!("250 us")),
            ("sigma", json!(true)),
            ("undo_rounds", json!(1)),
            ("decisions", json!({})),
        ];
        let of_paper = [
            ("readout", json!("slope")),
            ("tau_rule", json!("end")),
            ("precision", json!("single")),
            ("frames", json!("pairs")),
            ("first_knot", json!("window")),
            ("cis_weight", json!(1.0)),
            ("evs_weight", json!(1.0)),
        ];
        let shared = [("front_end", json!("ideal")), ("plausible_range", json!(2.0)), ("max_iterations", json!(7))];
        let all = serde_json::to_value(Params::default()).unwrap();
        assert_eq!(all.as_object().unwrap().len(), 1 + of_map.len() + of_paper.len() + shared.len(), "a parameter is missing here");
        let is_refused = |method: &str, (name, value): &(&str, serde_json::Value)| refusal(json!({ "method": method, (*name): value })).is_some();
        assert!(of_map.iter().all(|given| !is_refused("map", given) && is_refused("paper", given)));
        assert!(of_paper.iter().all(|given| is_refused("map", given) && !is_refused("paper", given)));
        assert!(shared.iter().all(|given| !is_refused("map", given) && !is_refused("paper", given)));
    }
}
