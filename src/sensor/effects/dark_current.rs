//! Dark current: a constant adds to the photocurrent before the logarithm.
//!
//! Contrast shrinks in the dark: a relative change of light moves the logarithm by `i / (i + current)` of
//! what it should, and the front end's delay saturates at `alpha / current`. The frame path integrates the
//! light alone, so events and frames disagree in the dark.
//!
//! Source: McReynolds, Graca and Delbruck 2024 (arXiv 2404.07656): much of "the threshold rises in dim light"
//! is this. Confused with: a black level of the frames (which compresses the frames' contrast instead).
//! Limits: constant; it doubles every 8 to 10 K.

use super::sought::{Measure, Search, Size, Sought};
use super::{Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, Site, Stage, Unit};

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "dark_current",
        stage: Stage::FrontEnd,
        about: "A constant adds to the photocurrent before the logarithm",
        equation: "V_DC = ln(i + current), tau = tau_0 + alpha / (i + current)",
        parameters: &[ParameterDecl {
            name: "current",
            unit: Unit::Number("photocurrent"),
            null: Some(0.0),
            allowed: (0.0, 1e9),
            plausible: (1e-3, 10.0),
            about: "photocurrent units that are there without light",
        }],
        covariate: "photocurrent",
        signature: "log contrast is i / (i + current) of the frames, both polarities alike; latency \
                    saturates in the dark",
        confused_with: &["black_level", "threshold_scale"],
        source: "McReynolds, Graca and Delbruck 2024, arXiv 2404.07656",
        apart: &[("black_level", "a frame with the lens covered: it reads the black level")],
        search: Search::For(&[Sought {
            typical: Size::Of(0.15, Measure::Light),
            material: Size::Of(0.005, Measure::Light),
            is_of_swing: true,
            ..Sought::positive("current")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(DarkCurrent { current: parameters.need("current")? }))
}

/// A current without light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct DarkCurrent {
    /// Photocurrent units, at least zero.
    pub current: f64,
}

impl Effect for DarkCurrent {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn event_light(&self, _site: &Site, _t_ns: i64, i: f64) -> f64 {
        i + self.current
    }

    fn added_photocurrent(&self) -> f64 {
        self.current
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::*;
    use super::*;
    use crate::forward::{Chain, Noiseless, Pixel, simulate};
    use crate::front_end::FrontEnd;
    use photocurrent_core::sensor::Reset;

    #[test]
    fn the_log_gain_falls_in_the_dark() {
        let dark: Vec<Box<dyn Effect>> = vec![Box::new(DarkCurrent { current: 0.3 })];
        // Light doubles slowly; the gain over that octave is ln((2 i + d) / (i + d)) / ln 2.
        for i in [0.03, 0.3, 30.0] {
            let fine = Pixel { threshold_on: 0.002, threshold_off: 0.002, ..ideal_pixel() };
            let ramp = Samples { t_ns: vec![0, 100 * MS], photocurrent: vec![i, 2.0 * i] };
            let chain = Chain {
                pixel: fine,
                reset: Reset::Resample,
                effects: &dark,
                tolerance: crate::forward::TOLERANCE,
            };
            let events = simulate(&chain, &SITE, &ramp.light(), 0, 100 * MS, &mut Noiseless);
            let expected = libm::log((2.0 * i + 0.3) / (i + 0.3)) / 0.002;
            assert_eq!(events.len(), expected as usize, "at {i}");
        }
    }

    #[test]
    fn the_delay_saturates() {
        let slow = Pixel { front_end: FrontEnd { tau_0_s: 0.0, alpha_s: 1e-4 }, ..ideal_pixel() };
        let jump = Samples::jump(1e-6, 0.1);
        let events = recorded(slow, vec![Box::new(DarkCurrent { current: 0.1 })], &jump, 10 * MS);
        // From ln 0.1 to ln 0.2 with alpha / 0.2 = 0.5 ms.
        let expected_s = -0.5e-3 * libm::log(1.0 - 0.2 / libm::log(2.0));
        assert!(((events[0].t_in_ns - MS) as f64 / 1e9 - expected_s).abs() < 1e-7);
    }
}
