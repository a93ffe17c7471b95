//! Black level: a frame in darkness does not read what the description says.
//!
//! An offset is added to every digital number before it is recorded. In the logarithm it squeezes the
//! contrast of dark pixels, so events seem to show more contrast there than frames: the opposite of a dark
//! current, which squeezes the events' contrast. Typical: a few DN; drift with temperature, or a pedestal
//! that was subtracted twice.
//!
//! Parameter: `black_level_dn`, the real DN of darkness; its null is the description's own.
//!
//! Source: EMVA 1288, dark signal.
//! Limits: one value for all pixels and frames.

use super::sought::{Field, Measure, Search, Size, Sought};
use super::{Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, Reading, Site, Stage, Unit};

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "black_level",
        stage: Stage::Exposure,
        about: "Darkness reads another digital number than stated",
        equation: "DN = black_level_dn + gain * integral of i",
        parameters: &[ParameterDecl {
            name: "black_level_dn",
            unit: Unit::Number("DN"),
            null: None,
            allowed: (-1e6, 1e6),
            plausible: (-50.0, 300.0),
            about: "real DN of a dark pixel",
        }],
        covariate: "dn",
        signature: "frames differ by the same DN at every light; in the dark frames show less contrast than \
                    events (more, when it is below the stated one)",
        confused_with: &["dark_current", "frame_nonlinearity", "image_lag"],
        source: "EMVA 1288",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Larger(&Size::Of(0.12, Measure::Signal), &Size::Fixed(10.0)),
            material: Size::Of(0.005, Measure::Signal),
            field: Some(Field::BlackLevel),
            is_of_swing: true,
            ..Sought::both("black_level_dn")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(BlackLevel { black_level_dn: parameters.need("black_level_dn")? }))
}

/// A real black level that differs from the stated one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct BlackLevel {
    /// Real DN of a dark pixel.
    pub black_level_dn: f64,
}

impl Effect for BlackLevel {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn dn(&self, _site: &Site, reading: &Reading, dn: f64) -> f64 {
        dn + (self.black_level_dn - reading.black_level)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const READING: Reading =
        Reading { frame: 0, previous_charge: 0.0, gain: 850.0, black_level: 16.0, saturation: 1023.0 };
    const SITE: Site = Site { x: 0, y: 0, width: 4, height: 4, seed: 1 };

    #[test]
    fn the_same_offset_is_added_at_every_light() {
        let effect = BlackLevel { black_level_dn: 20.0 };
        assert_eq!([16.0, 300.0, 900.0].map(|dn| effect.dn(&SITE, &READING, dn)), [20.0, 304.0, 904.0]);
    }

    #[test]
    fn the_stated_level_is_no_change() {
        assert_eq!(BlackLevel { black_level_dn: 16.0 }.dn(&SITE, &READING, 300.0), 300.0);
    }
}
