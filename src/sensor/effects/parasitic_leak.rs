//! Parasitic leak: stray light on the reference's storage node makes it leak in proportion to the
//! photocurrent.
//!
//! As [`super::leak_events`], but a bright pixel leaks faster. Separating both needs about 1.5 decades of
//! light.
//!
//! Source: Nozaki and Delbruck 2017. The photocurrent is that of the light, without dark current.
//! Limits: proportional; the storage node's own spectral response is not modelled.

use super::sought::{Measure, Search, Size, Sought};
use super::{Effect, EffectDecl, EffectKind, Leak, ParameterDecl, Parameters, Site, Stage, Thresholds, Unit};

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "parasitic_leak",
        stage: Stage::Reset,
        about: "The stored reference leaks in proportion to the light",
        equation: "dV_ref/dt = -coefficient * i",
        parameters: &[ParameterDecl {
            name: "coefficient",
            unit: Unit::Number("1/s per photocurrent"),
            null: Some(0.0),
            allowed: (0.0, 1e6),
            plausible: (1e-4, 1.0),
            about: "ln/s per photocurrent unit; ON events in a static scene come at coefficient x i / \
                    threshold_on",
        }],
        covariate: "photocurrent*time_since_last_event",
        signature: "as leak_events, with a rate that grows with the photocurrent",
        confused_with: &["leak_events", "threshold_asymmetry"],
        source: "Nozaki and Delbruck 2017",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Over(&Size::Of(12.0, Measure::Threshold), Measure::Light),
            ..Sought::positive("coefficient")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(ParasiticLeak { per_photocurrent_per_s: parameters.need("coefficient")? }))
}

/// A leak of the reference that light drives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ParasiticLeak {
    /// ln/s per photocurrent unit, at least zero.
    pub per_photocurrent_per_s: f64,
}

impl Effect for ParasiticLeak {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn leak(&self, _site: &Site, _stated: &Thresholds) -> Leak {
        Leak { constant_per_s: 0.0, per_photocurrent_per_s: self.per_photocurrent_per_s }
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::*;
    use super::*;

    #[test]
    fn a_static_pixel_fires_on_at_a_rate_proportional_to_its_light() {
        for i in [0.5, 5.0] {
            let events = recorded(
                ideal_pixel(),
                vec![Box::new(ParasiticLeak { per_photocurrent_per_s: 4.0 })],
                &Samples::constant(i),
                499 * MS,
            );
            assert_eq!(count(&events, -1), 0);
            assert_eq!(events.len(), (0.499 * 4.0 * i / 0.2) as usize);
            for interval in intervals_s(&events) {
                assert!((interval - 0.2 / (4.0 * i)).abs() < 1e-8);
            }
        }
    }
}
