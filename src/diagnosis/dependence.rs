//! A curve over a covariate that no effect of the catalogue has, as it was measured.

use crate::covariates::Covariate;
use crate::report::short;
use serde::{Deserialize, Serialize};

/// What is moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Moved {
    /// Both thresholds, as a share of them.
    Threshold,
    /// Stamps, seconds later.
    Stamps,
    /// Events that no light makes: ON less OFF, a second and a pixel.
    Rate,
    /// All events, as a share of their rate.
    EventRate,
}

impl Moved {
    /// Where it enters, by the names of docs/formats.md.
    pub fn insertion(self) -> &'static str {
        match self {
            Moved::Threshold | Moved::EventRate => "comparator",
            Moved::Stamps => "time",
            Moved::Rate => "reset",
        }
    }

    /// As an equation, for departures `c`.
    pub fn equation(self) -> &'static str {
        match self {
            Moved::Threshold => "threshold * (1 + c)",
            Moved::Stamps => "stamp + c",
            Moved::Rate => "rate of ON less OFF events + c",
            Moved::EventRate => "rate of events * (1 + c)",
        }
    }
}

/// A curve over a covariate, and what it explains.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dependence {
    /// What it moves.
    pub moved: Moved,
    /// What it depends on.
    pub covariate: Covariate,
    /// Of a rhythm, its period, seconds.
    pub period_s: Option<f64>,
    /// Mean of the covariate in each bin.
    pub at: Vec<f64>,
    /// By how much in each bin, less the mean of all: a share, seconds, or events a second.
    pub value: Vec<f64>,
    /// Half the difference of what two halves of the pixels say; of a rate of events, its standard error.
    pub error: Vec<f64>,
    /// Share of the squares that it removes, on pixels that it was not fitted to; of a rate of events, the
    /// share of those of counts.
    pub taken: f64,
    /// The same over its standard error from part to part of the array; of a rate of events, what its test
    /// measured.
    pub significance: f64,
    /// Held-out gain in log-likelihood, nats an event.
    pub nats_per_event: f64,
}

impl Dependence {
    /// As an equation with the measured curve.
    pub fn equation(&self) -> String {
        let name = self.covariate.name();
        let point = |(at, value): (&f64, &f64)| match self.moved {
            Moved::Threshold | Moved::EventRate => format!("{:+.1} % at {}", 100.0 * value, short(*at)),
            Moved::Stamps => format!("{:+.0} us at {}", 1e6 * value, short(*at)),
            Moved::Rate => format!("{value:+.2} Hz at {}", short(*at)),
        };
        let points: Vec<String> = self.at.iter().zip(&self.value).map(point).collect();
        let rhythm =
            self.period_s.map_or_else(String::new, |period_s| format!(" of {} Hz", short(1.0 / period_s)));
        format!("{}, c({name}){rhythm} = {}", self.moved.equation(), points.join(", "))
    }
}
