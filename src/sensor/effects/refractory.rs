//! Refractory: the refractory period differs from the stated one.
//!
//! What the voltage does between the stated and the true end of the blind time is counted wrongly: an error
//! of `(true - stated) dV/dt` per event, and a lower edge of the intervals between events at another place.
//!
//! Source: Section 3; set by a bias current, so it varies with temperature. Absolute value. Confused with:
//! reset memory (an error that does not grow with the slope) and a readout latency that stamps do not show.

use super::sought::{Field, Search, Size, Sought, TIME};
use super::{Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, Site, Stage, Unit};

/// A refractory period where none is stated, seconds: what spread and light act on.
pub(super) const SOME_REFRACTORY_S: f64 = 50e-6;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "refractory",
        stage: Stage::Reset,
        about: "The refractory period differs from the stated one",
        equation: "V_ref = V(t_off + refractory)",
        parameters: &[ParameterDecl {
            name: "refractory",
            unit: Unit::Time,
            null: None,
            allowed: (0.0, 10.0),
            plausible: (0.0, 1e-3),
            about: "the true refractory period, from t_off on",
        }],
        covariate: "slope",
        signature: "every event but the first of a burst is off by (true - stated) dV/dt; intervals have \
                    another shortest length",
        confused_with: &["reset_memory", "second_pole", "readout_queue"],
        source: "Section 3",
        apart: &[
            ("refractory_light", "the same scene in twice the light: only one of the blind times changes"),
            (
                "refractory_spread",
                "a fast blinking lamp over the whole array: each pixel shows its own blind time",
            ),
            (
                "reset_memory",
                "the same scene at three times the speed: the blind time matters three times \
                              as much, the memory as before",
            ),
        ],
        search: Search::For(&[
            Sought {
                typical: Size::Fixed(250e-6),
                material: TIME,
                field: Some(Field::Refractory),
                is_of_swing: true,
                ..Sought::both("refractory")
            },
            Sought { field: Some(Field::Reset), is_made: false, ..Sought::switch("reset") },
        ]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(Refractory { refractory_ns: parameters.need_ns("refractory")? }))
}

/// The true refractory period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Refractory {
    /// Nanoseconds, at least zero.
    pub refractory_ns: i64,
}

impl Effect for Refractory {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn refractory_ns(&self, _site: &Site, _i: f64, _refractory_ns: i64) -> i64 {
        self.refractory_ns
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::*;
    use super::*;
    use crate::forward::Pixel;

    #[test]
    fn intervals_on_a_ramp_grow_by_the_true_period_at_every_slope() {
        let stated = Pixel { refractory_ns: 50_000, latency_ns: 20_000, ..ideal_pixel() };
        for slope in [20.0, 80.0] {
            let ramp = Samples::of_log(50 * MS, |t| -1.0 + slope * t);
            let events =
                recorded(stated, vec![Box::new(Refractory { refractory_ns: 300_000 })], &ramp, 50 * MS);
            for interval in intervals_s(&events) {
                assert!((interval - (0.2 / slope + 320e-6)).abs() < 1e-6);
            }
        }
    }
}
