//! Frame nonlinearity: twice the light is not quite twice the digital number.
//!
//! The conversion from charge to voltage and the amplifiers bend a little. Dark and full scale are right by
//! definition; between them the digital number is off by a parabola that is `fraction` of full scale in the
//! middle: with `x` from 0 (dark) to 1 (full), `x + 4 fraction x (1 - x)`. Typical: 0.1 to 2 % (EMVA 1288
//! linearity error); a residual gamma: 10 % and more.
//!
//! Other sensors are right in the dark and fall behind towards full scale, as a source follower or a well
//! that fills does: `x / (1 + compression x)`.
//!
//! Parameters: `fraction`, positive = mid tones too bright; `compression`, what full light lacks over what it
//! reads; `full_scale_dn`, where the curve ends (absent = the stated saturation; with neither known nothing
//! can be said and nothing is changed). It follows the digital number: with another exposure time it stays at
//! its DN, while a departure of the events' logarithm stays at its photocurrent.
//!
//! Source: EMVA 1288, linearity error.
//! Limits: one curve for all pixels; beyond dark and full scale it goes on as a straight line.

use super::sought::{GAIN, Measure, Search, Size, Sought};
use super::{Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, Reading, Site, Stage, Unit};

/// Full scale of what is sought: over the range that is used, as the rest of it carries no information.
const FULL_SCALE: &[(&str, Size)] = &[("full_scale_dn", Size::Of(1.0, Measure::LargestDn))];

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "frame_nonlinearity",
        stage: Stage::Exposure,
        about: "The digital number is not proportional to the collected light",
        equation: "x = (DN - black) / (full - black); x_read = (x + 4 * fraction * x * (1 - x)) / (1 + \
                   compression * x)",
        parameters: &[
            ParameterDecl {
                name: "fraction",
                unit: Unit::Number("fraction"),
                null: Some(0.0),
                allowed: (-0.25, 0.25),
                plausible: (-0.1, 0.1),
                about: "error at half scale as a share of full scale; positive = mid tones too bright",
            },
            ParameterDecl {
                name: "compression",
                unit: Unit::Number("fraction"),
                null: Some(0.0),
                allowed: (-0.4, 10.0),
                plausible: (0.0, 1.0),
                about: "what full light lacks over what it reads, with dark as stated; positive = bright \
                        tones too dark",
            },
            ParameterDecl {
                name: "full_scale_dn",
                unit: Unit::Number("DN"),
                null: None,
                allowed: (1.0, 1e9),
                plausible: (255.0, 65_535.0),
                about: "DN at which the curve is right again; absent = the stated saturation",
            },
        ],
        covariate: "dn",
        signature: "frame residuals follow one smooth curve in DN, zero at dark and full scale, the same at \
                    every exposure time",
        confused_with: &["black_level", "threshold_scale", "dark_current"],
        source: "EMVA 1288",
        apart: &[(
            "black_level",
            "a series of exposures of a static scene: a straight line that misses zero, or a curve",
        )],
        search: Search::For(&[
            Sought {
                typical: Size::Fixed(0.06),
                material: GAIN,
                others: FULL_SCALE,
                is_made: false,
                is_of_swing: true,
                ..Sought::both("fraction")
            },
            Sought {
                typical: Size::Fixed(0.15),
                material: GAIN,
                others: FULL_SCALE,
                comes_last: true,
                is_of_swing: true,
                ..Sought::positive("compression")
            },
        ]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(FrameNonlinearity {
        fraction: parameters.get("fraction").unwrap_or(0.0),
        compression: parameters.get("compression").unwrap_or(0.0),
        full_scale_dn: parameters.get("full_scale_dn"),
    }))
}

/// A parabola between dark and full scale.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct FrameNonlinearity {
    /// Error at half scale over full scale, -0.25 to 0.25 (the curve then still rises everywhere).
    pub fraction: f64,
    /// What full light lacks over what it reads, -0.4 to 10.
    pub compression: f64,
    /// DN at which the curve ends; none = the stated saturation.
    pub full_scale_dn: Option<f64>,
}

impl Effect for FrameNonlinearity {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn dn(&self, _site: &Site, reading: &Reading, dn: f64) -> f64 {
        let range = self.full_scale_dn.unwrap_or(reading.saturation) - reading.black_level;
        if !(range > 0.0 && range.is_finite()) {
            return dn;
        }
        let x = (dn - reading.black_level) / range;
        // The parabola, and its tangents beyond both ends.
        let bend = x.min(1.0) * (1.0 - x.max(0.0));
        let bent = x + 4.0 * self.fraction * bend;
        // Above full scale the curve goes on; below dark it is straight.
        reading.black_level + range * bent / (1.0 + self.compression * x.max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const READING: Reading =
        Reading { frame: 0, previous_charge: 0.0, gain: 850.0, black_level: 23.0, saturation: 1023.0 };
    const SITE: Site = Site { x: 0, y: 0, width: 4, height: 4, seed: 1 };

    fn read(fraction: f64, dn: f64) -> f64 {
        FrameNonlinearity { fraction, ..FrameNonlinearity::default() }.dn(&SITE, &READING, dn)
    }

    #[test]
    fn dark_and_full_scale_are_right_and_half_scale_is_off_by_the_fraction() {
        for fraction in [-0.25, 0.02] {
            assert!((read(fraction, 23.0) - 23.0).abs() < 1e-9);
            assert!((read(fraction, 523.0) - (523.0 + 1000.0 * fraction)).abs() < 1e-9);
            assert!((read(fraction, 1023.0) - 1023.0).abs() < 1e-9);
        }
    }

    #[test]
    fn more_light_never_reads_less() {
        for fraction in [-0.25, 0.25] {
            let read: Vec<f64> = (-100..1500).map(|dn| read(fraction, f64::from(dn))).collect();
            // The curve is flat at one end: there rounding decides.
            assert!(read.is_sorted_by(|less, more| *less <= more + 1e-9));
        }
    }

    #[test]
    fn a_full_scale_of_its_own_counts_before_the_stated_one() {
        let effect =
            FrameNonlinearity { fraction: 0.1, full_scale_dn: Some(223.0), ..FrameNonlinearity::default() };
        assert!((effect.dn(&SITE, &READING, 123.0) - 143.0).abs() < 1e-12);
    }

    #[test]
    fn without_a_full_scale_nothing_changes() {
        let unknown = Reading { saturation: f64::INFINITY, ..READING };
        assert_eq!(
            FrameNonlinearity { fraction: 0.1, ..FrameNonlinearity::default() }.dn(&SITE, &unknown, 500.0),
            500.0
        );
    }

    #[test]
    fn compression_leaves_the_dark_alone_and_takes_its_share_of_full_light() {
        let read = |dn: f64| {
            FrameNonlinearity { compression: 0.25, ..FrameNonlinearity::default() }.dn(&SITE, &READING, dn)
        };
        assert!((read(1023.0) - 23.0 - 1000.0 / 1.25).abs() < 1e-9);
        assert!((read(23.1) - 23.1).abs() < 1e-5 && read(10.0) == 10.0);
        assert!((read(523.0) - 23.0 - 500.0 / 1.125).abs() < 1e-9);
    }
}
