//! Image lag: a frame still holds part of the light of the frame before.
//!
//! Charge that is not transferred out of the photodiode is read with the next frame: `fraction` of the charge
//! of the frame before is added. Bright objects that move leave a faint ghost one frame behind. Typical: 0.1
//! to 2 %.
//!
//! Parameter: `fraction`, of the charge of the frame before. In a static scene everything is brighter by the
//! same factor, which a gain hides; the ghost behind motion is the signature. A late exposure start shifts,
//! it does not repeat.
//!
//! Source: Fossum and Hondongwa, "A review of the pinned photodiode for CCD and CMOS image sensors" (2014).
//! Limits: linear. The simulator knows the frame before by its light alone, so the ghost lasts one frame; the
//! ghost's own ghost, `fraction^2`, is left out. The first frame has no predecessor.

use super::sought::{SHARE, Search, Size, Sought};
use super::{Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, Reading, Site, Stage, Unit};

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "image_lag",
        stage: Stage::Exposure,
        about: "A frame holds part of the frame before",
        equation: "Q_read(l) = Q(l) + fraction * Q(l - 1)",
        parameters: &[ParameterDecl {
            name: "fraction",
            unit: Unit::Number("fraction"),
            null: Some(0.0),
            allowed: (0.0, 0.99),
            plausible: (5e-4, 0.2),
            about: "share of the charge of the frame before that is read again",
        }],
        covariate: "dn",
        signature: "frame residuals are proportional to the DN of the frame before, at the same light now",
        confused_with: &["exposure_time", "black_level", "clock_offset"],
        source: "Fossum and Hondongwa 2014",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Fixed(0.08),
            material: SHARE,
            ..Sought::positive("fraction")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(ImageLag { fraction: parameters.need("fraction")? }))
}

/// Charge that is read one frame late.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ImageLag {
    /// Share of the charge of the frame before, 0 to below 1.
    pub fraction: f64,
}

impl Effect for ImageLag {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn charge(&self, _site: &Site, reading: &Reading, charge: f64) -> f64 {
        charge + self.fraction * reading.previous_charge
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::simulated::{MS, SITE, Samples};
    use crate::exposure::DigitalNumber;
    use crate::forward::{FrameReadout, read_frames};
    use photocurrent_core::Exposure;

    fn read(charge: f64, previous_charge: f64) -> f64 {
        let reading =
            Reading { frame: 1, previous_charge, gain: 850.0, black_level: 16.0, saturation: 1023.0 };
        ImageLag { fraction: 0.1 }.charge(
            &Site { x: 0, y: 0, width: 1, height: 1, seed: 1 },
            &reading,
            charge,
        )
    }

    #[test]
    fn the_fraction_of_the_frame_before_is_added_whatever_the_light_now() {
        for charge in [0.0, 0.5, 3.0] {
            assert!((read(charge, 2.0) - charge - 0.2).abs() < 1e-15);
        }
        assert_eq!(read(0.5, 0.0), 0.5);
    }

    #[test]
    fn a_flash_leaves_its_fraction_in_the_next_frame() {
        let samples = Samples { t_ns: vec![0, 10 * MS, 10 * MS + 1], photocurrent: vec![100.0, 100.0, 1.0] };
        let readout = FrameReadout {
            number: DigitalNumber { black_level: 16.0, gain: 850.0 },
            saturation: f64::INFINITY,
            row_time_ns: 0,
        };
        let frames: Vec<Exposure> =
            (0..3).map(|frame| Exposure::new(10 * frame * MS, 10 * (frame + 1) * MS)).collect();
        let effects: [Box<dyn Effect>; 1] = [Box::new(ImageLag { fraction: 0.1 })];
        let found = read_frames(&readout, &effects, &SITE, &samples.light(), &frames);
        // 850 DN for 10 ms at 100, 8.5 DN at 1; the jump itself lasts a nanosecond.
        for (dn, expected) in found.iter().zip([866.0, 16.0 + 8.5 + 85.0, 16.0 + 8.5 + 0.85]) {
            assert!((dn - expected).abs() < 1e-3, "{dn} against {expected}");
        }
    }
}
