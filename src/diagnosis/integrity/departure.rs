//! Findings of direct tests.

use serde::{Deserialize, Serialize};

/// A departure from the description that a direct test detected.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Departure {
    /// Catalogue id.
    pub id: &'static str,
    /// Estimates by parameter, in the unit of its declaration; empty where the test estimates none.
    pub parameters: Vec<(&'static str, f64)>,
    /// The test's statistic.
    pub statistic: f64,
    /// Its detection threshold.
    pub threshold: f64,
    /// Share of the events, or of the rows or pixels, that are touched.
    pub share: f64,
    /// `on`, `off` or `both`.
    pub polarity: &'static str,
    /// Pixels that are touched (`y * width + x`, rising); empty = all.
    pub pixels: Vec<u32>,
    /// The observation, in a sentence.
    pub seen: String,
    /// Gain on measurements that its estimate was not fitted to; `None` where it was not computed.
    pub heldout: Option<HalvesGain>,
    /// 95 % intervals by parameter (`again`); those that were worked out.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub ci95: Vec<(&'static str, [f64; 2])>,
}

/// Least gain of one half of the array with the estimate of the other, nats.
pub(super) const NATS: f64 = 30.0;

impl Departure {
    /// From a test that predicts each half of the array from the other: gain `nats` in all, over `events`
    /// events.
    pub(crate) fn from_halves(
        id: &'static str,
        parameter: (&'static str, f64),
        nats: f64,
        events: usize,
        seen: String,
    ) -> Departure {
        let heldout = Some(HalvesGain { nats, events });
        Departure {
            id,
            parameters: vec![parameter],
            statistic: nats,
            threshold: NATS,
            share: 1.0,
            polarity: "both",
            pixels: Vec::new(),
            seen,
            heldout,
            ci95: Vec::new(),
        }
    }

    /// The estimate of a parameter.
    pub fn value(&self, parameter: &str) -> Option<f64> {
        self.parameters.iter().find(|(name, _)| *name == parameter).map(|(_, value)| *value)
    }

    /// The 95 % interval of a parameter.
    pub fn interval(&self, parameter: &str) -> Option<[f64; 2]> {
        self.ci95.iter().find(|(name, _)| *name == parameter).map(|(_, interval)| *interval)
    }
}

/// Gain in log-likelihood on one half of the blocks of pixels with what was estimated on the other, both
/// ways.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HalvesGain {
    /// Over the nominal description, nats.
    pub nats: f64,
    /// The events that it was measured on.
    pub events: usize,
}

impl HalvesGain {
    /// Nats an event; 0 without events.
    pub fn per_event(&self) -> f64 {
        self.nats / self.events.max(1) as f64
    }
}
