//! Exposure time: a frame collects light for longer or shorter than the recording states.
//!
//! Pulses that reset and read a row have lengths and delays of their own, so the real exposure differs from
//! the programmed one by a fixed time. The readout is what gets a stamp, so the exposure keeps its end and
//! the start moves. Typical: 1 to 100 us.
//!
//! Parameter: `difference`, real minus stated length; positive = longer. All digital numbers are off by
//! `difference / length`; while the light changes, the exposure's centre is also earlier by half the
//! difference. With a free gain only the second part is left, and frames of different lengths show the first.
//!
//! Source: EMVA 1288 on exposure time as set and as real.
//! Limits: the same for all rows and frames; an exposure that would end before it starts collects nothing.

use super::sought::{Measure, Search, Size, Sought};
use super::{Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, RowSite, Stage, Unit};
use photocurrent_core::Exposure;

/// Twice [`super::sought::DELAY`]: half of a difference is a shift of the middle.
const MATTERS: Size = Size::Larger(&Size::Fixed(4e-6), &Size::Of(1.1, Measure::StampWidth));

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "exposure_time",
        stage: Stage::Exposure,
        about: "Frames are exposed for longer or shorter than stated",
        equation: "t_start = stated t_start - difference; t_end as stated",
        parameters: &[ParameterDecl {
            name: "difference",
            unit: Unit::Time,
            null: Some(0.0),
            allowed: (-100.0, 100.0),
            plausible: (-1e-3, 1e-3),
            about: "real minus stated exposure length; positive = longer, at its start",
        }],
        covariate: "dn",
        signature: "frames are off by a factor that depends on the exposure length, and by a delay of half \
                    the difference",
        confused_with: &["frame_gain_steps", "clock_offset", "image_lag"],
        source: "EMVA 1288",
        apart: &[
            ("black_level", "the same scene with half the exposure: a black level stays"),
            (
                "frame_nonlinearity",
                "the same scene with half the exposure: only a nonlinearity changes the \
                                    ratio of bright to dark",
            ),
            ("image_lag", "a lamp that is switched off: lag leaves a trace in the next frame"),
        ],
        search: Search::For(&[Sought {
            typical: Size::Of(0.12, Measure::Exposure),
            material: MATTERS,
            ..Sought::both("difference")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(ExposureTime { difference_ns: parameters.need_ns("difference")? }))
}

/// A real exposure length that differs from the stated one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct ExposureTime {
    /// Real minus stated length, nanoseconds.
    pub difference_ns: i64,
}

impl Effect for ExposureTime {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn exposure(&self, _row: &RowSite, exposure: Exposure) -> Exposure {
        let end_ns = exposure.end.0;
        Exposure::new((exposure.start.0 - self.difference_ns).min(end_ns), end_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::simulated::{MS, SITE, Samples};
    use crate::exposure::DigitalNumber;
    use crate::forward::{FrameReadout, read_frames};

    fn exposed(difference_ns: i64) -> Exposure {
        ExposureTime { difference_ns }
            .exposure(&RowSite { y: 3, height: 9, frame: 0, row_time_ns: 0 }, Exposure::new(1_000, 5_000))
    }

    #[test]
    fn the_start_moves_and_the_length_changes_by_the_difference() {
        assert_eq!(exposed(200), Exposure::new(800, 5_000));
        assert_eq!(exposed(-1_500), Exposure::new(2_500, 5_000));
        assert_eq!(exposed(0), Exposure::new(1_000, 5_000));
    }

    #[test]
    fn frames_gain_in_proportion_and_on_a_ramp_half_the_difference_less() {
        let effects: [Box<dyn Effect>; 1] = [Box::new(ExposureTime { difference_ns: MS })];
        let readout = FrameReadout {
            number: DigitalNumber { black_level: 16.0, gain: 850.0 },
            saturation: 1023.0,
            row_time_ns: 0,
        };
        let read = |samples: &Samples| {
            read_frames(&readout, &effects, &SITE, &samples.light(), &[Exposure::new(5 * MS, 15 * MS)])[0]
                - 16.0
        };
        assert!((read(&Samples::constant(20.0)) - 850.0 * 20.0 * 11e-3).abs() < 1e-9);
        // Light 1000 t: its mean over 4 to 15 ms is that of the middle, 9.5 ms.
        let ramp = Samples { t_ns: vec![MS, 20 * MS], photocurrent: vec![1.0, 20.0] };
        assert!((read(&ramp) - 850.0 * 9.5 * 11e-3).abs() < 1e-9);
    }

    #[test]
    fn an_exposure_never_ends_before_it_starts() {
        assert_eq!(exposed(-9_000), Exposure::new(5_000, 5_000));
    }
}
