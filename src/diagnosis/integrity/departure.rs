//! What a direct test finds.

use serde::{Deserialize, Serialize};

/// A departure from the description that a direct test saw.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Departure {
    /// Catalogue id.
    pub id: &'static str,
    /// Estimates by parameter, in the unit of its declaration; empty when the test gives none.
    pub parameters: Vec<(&'static str, f64)>,
    /// What the test measured.
    pub statistic: f64,
    /// The value from which it counts.
    pub threshold: f64,
    /// Share of the events, or of the rows or pixels, that are touched.
    pub share: f64,
    /// `on`, `off` or `both`.
    pub polarity: &'static str,
    /// Pixels that are touched (`y * width + x`, rising); empty = all.
    pub pixels: Vec<u32>,
    /// What was seen, in a sentence.
    pub seen: String,
    /// What it gains on measurements that its estimate did not see; none where that was not worked out.
    pub heldout: Option<Heldout>,
    /// 95 % intervals by parameter (`again`); those that were worked out.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub ci95: Vec<(&'static str, [f64; 2])>,
}

/// Nats that half of the array must gain by what is estimated on the other half.
pub(super) const NATS: f64 = 30.0;

impl Departure {
    /// Of a test that predicts each half of the array from the other: `nats` in all, on so many events.
    pub(crate) fn of_halves(
        id: &'static str,
        parameter: (&'static str, f64),
        nats: f64,
        events: usize,
        seen: String,
    ) -> Departure {
        let heldout = Some(Heldout { nats, events });
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
pub struct Heldout {
    /// Over the nominal description, nats.
    pub nats: f64,
    /// The events that it was measured on.
    pub events: usize,
}

impl Heldout {
    /// Nats an event; 0 without events.
    pub fn per_event(&self) -> f64 {
        self.nats / self.events.max(1) as f64
    }
}
