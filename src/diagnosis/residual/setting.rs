//! Settings of the evidence.

use super::located::LocatedSetting;
use photocurrent_core::quantity::Duration;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Known light is sampled at least this often, ns.
pub(super) const KNOWN_STEP_NS: i64 = 25_000;
/// Ratio of actual standard errors to those of the information, on scenes estimated from events: by nominal
/// recordings.
pub(super) const ERRORS: f64 = 3.0;
/// Least threshold noise, as a share of the threshold.
pub(super) const LEAST_NOISE: f64 = 1e-3;
/// Effect size of the finite differences, as a share of a usual one.
pub(super) const PROBE: f64 = 0.05;
/// Least first-order gain of an effect that is fitted exactly, as a share of the best gain.
pub(super) const WORTH_REFINING: f64 = 0.3;
/// Largest last step of a size, as a share of it.
pub(super) const STILL: f64 = 0.003;
/// Largest effect size of a search.
pub(super) const LARGEST_EFFECT_SIZE: f64 = 12.0;
/// Least noise of single events that matters, of thresholds or of stamps at the median slope, as a share of
/// the threshold.
pub(super) const LEAST_EVENT_NOISE: f64 = 0.015;
/// Threshold noise on known light that a description without `threshold_noise` includes, as a share of the
/// threshold.
pub(super) const LEAST_UNSTATED_NOISE: f64 = 0.05;
/// Least gain of a spread of delays in the comparator, nats an event.
pub(super) const LEAST_SPREAD: f64 = 0.1;
/// Events within one cell of the picture see the same of it, pixels.
pub(super) const CELL: f64 = 0.5;
/// Where the voltage moves slower than this share of the median, an event's time constrains no more than
/// there.
pub(super) const LEAST_SLOPE: f64 = 0.1;
/// Number of uncatalogued curves that are reported.
pub(super) const DEPENDENCES: usize = 6;

/// How evidence is computed.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct EvidenceSetting {
    /// Light of the scene is sampled this often.
    #[schemars(extend("x-min" = "10 us", "x-max" = "10 ms"))]
    pub step: Duration,
    /// About so many events are evaluated.
    #[schemars(range(min = 500))]
    pub events: usize,
    /// Of at most so many pixels.
    #[schemars(range(min = 20))]
    pub pixels: usize,
    /// Fewer events than this in places that frames predict are no evidence.
    #[schemars(range(min = 100))]
    pub least_events: usize,
    /// Nor is a smaller share of all events.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub least_share: f64,
    /// Side of the blocks that gains are held out by, pixels.
    #[schemars(range(min = 2, max = 64))]
    pub block: usize,
    /// So many of the best effects are fitted exactly.
    #[schemars(range(min = 1, max = 60))]
    pub refined: usize,
    /// And so many of a second effect in addition to the first.
    #[schemars(range(min = 1, max = 60))]
    pub refined_second: usize,
    /// In so many rounds for each size.
    #[schemars(range(min = 1, max = 20))]
    pub rounds: usize,
    /// The picture may be softer than the scene by so many times what the control's is.
    #[schemars(range(min = 0.0))]
    pub softness: f64,
    /// Seed of the control.
    #[serde(skip)]
    pub seed: u64,
    /// Settings of the location of effects.
    #[serde(skip)]
    pub located: LocatedSetting,
}

impl Default for EvidenceSetting {
    fn default() -> EvidenceSetting {
        EvidenceSetting {
            step: Duration::new(100_000),
            events: 6_000,
            pixels: 500,
            least_events: 500,
            least_share: 0.05,
            block: 8,
            refined: 6,
            refined_second: 4,
            rounds: 3,
            softness: 3.0,
            seed: 1,
            located: LocatedSetting::default(),
        }
    }
}
