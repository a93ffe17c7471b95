//! Reset memory: the reset is incomplete, and part of the old reference stays.
//!
//! An event after one of the same polarity then comes early, one after the opposite polarity late, by the
//! same contrast at every speed. Typical: 1 to 10 %.
//!
//! Source: charge injection and incomplete settling of the reset switch. Confused with: a wrong refractory
//! period (whose error grows with the slope) and a second pole (which delays the first event of a burst
//! only).

use super::sought::{SHARE, Search, Size, Sought};
use super::{Effect, EffectDecl, EffectKind, History, ParameterDecl, Parameters, Site, Stage, Unit};
use photocurrent_core::random::Random;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "reset_memory",
        stage: Stage::Reset,
        about: "The reset is incomplete: part of the old reference stays",
        equation: "V_ref = V + fraction (V_ref_before - V)",
        parameters: &[ParameterDecl {
            name: "fraction",
            unit: Unit::Number("fraction"),
            null: Some(0.0),
            allowed: (-0.95, 0.95),
            plausible: (-0.1, 0.2),
            about: "the part of the old reference that stays; negative = the reset overshoots",
        }],
        covariate: "previous_polarity",
        signature: "after the same polarity events come early, after the opposite one late, by fraction x \
                    threshold",
        confused_with: &["refractory", "second_pole", "time_constant"],
        source: "Lichtsteiner, Posch and Delbruck 2008 (reset switch)",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Fixed(0.3),
            material: SHARE,
            is_of_swing: true,
            ..Sought::both("fraction")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(ResetMemory { fraction: parameters.need("fraction")? }))
}

/// An incomplete reset.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ResetMemory {
    /// The part of the old reference that stays, between -1 and 1.
    pub fraction: f64,
}

impl Effect for ResetMemory {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn reference(
        &self,
        _site: &Site,
        _history: &History,
        _random: &mut Random,
        ideal: f64,
        before: f64,
    ) -> f64 {
        ideal + self.fraction * (before - ideal)
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::*;
    use super::*;

    #[test]
    fn the_same_polarity_comes_early_and_the_opposite_late() {
        // Up at 20 per second for 50 ms, then down. Without memory steps are 0.2 of 1.0.
        let triangle = Samples::of_log(100 * MS, |t| {
            -1.0 + if t < 0.0501 { 20.0 * t } else { 1.002 - 20.0 * (t - 0.0501) }
        });
        let events =
            recorded(ideal_pixel(), vec![Box::new(ResetMemory { fraction: 0.1 })], &triangle, 100 * MS);
        // Levels: 0.2, then every 0.18 up to 0.92; the reference stays at 0.90; the first OFF at 0.70, 0.22
        // below the last level.
        let levels = [0.2, 0.38, 0.56, 0.74, 0.92, 0.70, 0.52, 0.34, 0.16];
        assert_eq!(events.len(), levels.len());
        for (k, (event, level)) in events.iter().zip(levels).enumerate() {
            let expected_s = if k < 5 { level / 20.0 } else { 0.0501 + (1.002 - level) / 20.0 };
            assert!((event.t_in_ns as f64 / 1e9 - expected_s).abs() < 1e-6, "event {k}");
            assert_eq!(event.polarity, if k < 5 { 1 } else { -1 });
        }
    }
}
