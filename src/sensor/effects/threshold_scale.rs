//! Threshold scale: both contrast thresholds differ from the stated ones by one factor.
//!
//! Every event stands for `1 + fraction` times the stated step, so the events between two frames add up to
//! too much or too little contrast, by the same factor at every light level and speed.
//!
//! Source: bias settings drift with temperature and from chip to chip. Confused with: a frame gamma (only the
//! product of both shows).

use super::sought::{Field, GAIN, Search, Size, Sought};
use super::{
    Effect, EffectDecl, EffectKind, History, ParameterDecl, Parameters, Site, Stage, Thresholds, Unit,
};
use photocurrent_core::random::Random;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "threshold_scale",
        stage: Stage::Comparator,
        about: "Both contrast thresholds differ from the stated ones by one factor",
        equation: "theta_on = stated_on (1 + fraction), theta_off = stated_off (1 + fraction)",
        parameters: &[ParameterDecl {
            name: "fraction",
            unit: Unit::Number("fraction"),
            null: Some(0.0),
            allowed: (-0.9, 10.0),
            plausible: (-0.3, 0.3),
            about: "relative error of both thresholds; positive = true thresholds are larger, fewer events",
        }],
        covariate: "slope",
        signature: "the contrast between frames is 1 + fraction times what the events add up to",
        confused_with: &["frame_nonlinearity", "threshold_asymmetry", "dark_current"],
        source: "Lichtsteiner, Posch and Delbruck 2008",
        apart: &[
            (
                "lateral_inhibition",
                "a large even surface that grows brighter: without a surround that \
                                    differs there is nothing to inhibit",
            ),
            (
                "dark_current",
                "the same scene in twice the light: a dark current matters half as much, a \
                              threshold as before",
            ),
            ("black_level", "a frame with the lens covered: it reads the black level"),
            ("threshold_drift", "a recording four times as long: a drift grows with it"),
        ],
        search: Search::For(&[Sought {
            typical: Size::Fixed(0.2),
            material: GAIN,
            field: Some(Field::Thresholds { off: 1.0 }),
            is_of_swing: true,
            is_followed: true,
            ..Sought::both("fraction")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(ThresholdScale { fraction: parameters.need("fraction")? }))
}

/// A common relative error of both thresholds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ThresholdScale {
    /// True over stated threshold, minus one; above -1.
    pub fraction: f64,
}

impl Effect for ThresholdScale {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn thresholds(
        &self,
        _site: &Site,
        _history: &History,
        _random: &mut Random,
        _t_reset_ns: i64,
        thresholds: &mut Thresholds,
    ) {
        thresholds.on *= 1.0 + self.fraction;
        thresholds.off *= 1.0 + self.fraction;
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::*;
    use super::*;

    #[test]
    fn events_stand_for_larger_steps_in_both_directions() {
        for slope in [37.0, -37.0] {
            let ramp = Samples::of_log(50 * MS, |t| -1.0 + slope * t);
            let events =
                recorded(ideal_pixel(), vec![Box::new(ThresholdScale { fraction: 0.5 })], &ramp, 50 * MS);
            assert_eq!(events.len(), 6); // 1.85 / (0.2 x 1.5)
            for interval in intervals_s(&events) {
                assert!((interval - 0.3 / 37.0).abs() < 1e-6);
            }
        }
    }
}
