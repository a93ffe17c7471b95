//! Frame gain steps: the brightness of whole frames jumps although the light does not.
//!
//! Automatic gain, a tone curve that follows the scene, or a lamp correction multiplies all pixels of a frame
//! by one factor, holds it for some frames, and then takes another. The black level stays. Typical: 1 to 20 %
//! per jump.
//!
//! Parameters: `sigma`, the spread of the logarithm of the factor; `every`, the number of frames that share a
//! factor (absent = 1). The first `every` frames have the stated gain. Light that really changes shows in the
//! events too.
//!
//! Source: automatic gain control as in any camera. Limits: factors are drawn independently (normal in the
//! logarithm) and at a fixed pace; no dependence on the scene.

use super::sought::{SPREAD, Search, Size, Sought};
use super::{
    Chance, Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, Reading, Site, Stage, Unit, row_random,
};

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "frame_gain_steps",
        stage: Stage::Exposure,
        about: "The gain of whole frames jumps from time to time",
        equation: "DN = black_level + g(frame) * gain * integral of i; ln g normal with spread sigma, new \
                   every `every` frames",
        parameters: &[
            ParameterDecl {
                name: "sigma",
                unit: Unit::Number("ln"),
                null: Some(0.0),
                allowed: (0.0, 5.0),
                plausible: (1e-3, 0.5),
                about: "standard deviation of the logarithm of the factor",
            },
            ParameterDecl {
                name: "every",
                unit: Unit::Number("frames"),
                null: Some(1.0),
                allowed: (1.0, 1e9),
                plausible: (1.0, 100.0),
                about: "frames that share a factor, rounded; absent = 1",
            },
        ],
        covariate: "time",
        signature: "all pixels of a frame are off by one factor, another one some frames later; events show \
                    nothing",
        confused_with: &["exposure_time", "image_lag", "flicker that the frames alone sample"],
        source: "automatic gain control",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Fixed(0.05),
            material: SPREAD,
            is_made: false,
            ..Sought::random("sigma")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(FrameGainSteps {
        sigma: parameters.need("sigma")?,
        every: parameters.get("every").map_or(1, |frames| frames.round() as usize),
    }))
}

/// A gain that jumps between groups of frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FrameGainSteps {
    /// Standard deviation of the logarithm of the factor, at least zero.
    pub sigma: f64,
    /// Frames that share a factor, at least one.
    pub every: usize,
}

impl FrameGainSteps {
    /// The factor of all pixels of a frame, 1 for the first `every`.
    pub(super) fn factor(&self, seed: u64, frame: usize) -> f64 {
        match frame / self.every {
            0 => 1.0,
            group => libm::exp(self.sigma * row_random(seed, group as u32, KIND.decl.id).normal()),
        }
    }
}

impl Effect for FrameGainSteps {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn dn(&self, site: &Site, reading: &Reading, dn: f64) -> f64 {
        reading.black_level + (dn - reading.black_level) * self.factor(site.seed, reading.frame)
    }

    fn chance(&self) -> Option<Chance> {
        Some(Chance { of_frames: self.sigma, ..Chance::default() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEPS: FrameGainSteps = FrameGainSteps { sigma: 0.1, every: 5 };

    fn ratio(x: u32, y: u32, frame: usize, dn: f64) -> f64 {
        let reading =
            Reading { frame, previous_charge: 0.0, gain: 850.0, black_level: 16.0, saturation: 1023.0 };
        (STEPS.dn(&Site { x, y, width: 9, height: 7, seed: 11 }, &reading, dn) - 16.0) / (dn - 16.0)
    }

    #[test]
    fn a_frame_has_one_factor_for_all_pixels_and_lights() {
        for frame in [0, 7, 93] {
            assert!(
                [(8, 6, 500.0), (3, 1, 20.0)].iter().all(|&(x, y, dn)| (ratio(x, y, frame, dn)
                    / ratio(0, 0, frame, 300.0)
                    - 1.0)
                    .abs()
                    < 1e-12)
            );
        }
    }

    #[test]
    fn the_factor_holds_for_its_frames_and_then_jumps() {
        let factors: Vec<f64> = (0..20).map(|frame| STEPS.factor(11, frame)).collect();
        assert!(factors[..5].iter().all(|&factor| factor == 1.0));
        for group in factors.chunks(5) {
            assert!(group.iter().all(|&factor| factor == group[0]));
        }
        assert!((1..4).all(|group| factors[5 * group] != factors[5 * group - 5]));
    }

    #[test]
    fn the_logarithms_spread_by_sigma() {
        let n = 4000;
        let logs: Vec<f64> = (1..=n).map(|group| libm::log(STEPS.factor(3, 5 * group))).collect();
        let mean = logs.iter().sum::<f64>() / n as f64;
        let spread = (logs.iter().map(|log| (log - mean) * (log - mean)).sum::<f64>() / n as f64).sqrt();
        // Five standard errors: sigma over sqrt(n) and over sqrt(2 n).
        assert!(mean.abs() < 5.0 * 0.1 / (n as f64).sqrt());
        assert!((spread - 0.1).abs() < 5.0 * 0.1 / (2.0 * n as f64).sqrt());
    }
}
