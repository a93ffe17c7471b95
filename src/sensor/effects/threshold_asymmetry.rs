//! Threshold asymmetry: the ON threshold is larger than stated and the OFF threshold smaller, or the reverse.
//!
//! A pixel that goes up and down again does not come back to where it was: the sum over its events drifts
//! with activity (a leak drifts with time). Typical: 10 to 30 % between ON and OFF.
//!
//! Source: separate comparator biases; v2e's defaults differ by 20 %. Limits: constant over the array.

use super::sought::{Field, GAIN, Search, Size, Sought};
use super::{
    Effect, EffectDecl, EffectKind, History, ParameterDecl, Parameters, Site, Stage, Thresholds, Unit,
};
use photocurrent_core::random::Random;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "threshold_asymmetry",
        stage: Stage::Comparator,
        about: "ON and OFF thresholds lie apart by more than stated",
        equation: "theta_on = stated_on (1 + fraction), theta_off = stated_off (1 - fraction)",
        parameters: &[ParameterDecl {
            name: "fraction",
            unit: Unit::Number("fraction"),
            null: Some(0.0),
            allowed: (-0.9, 0.9),
            plausible: (-0.2, 0.2),
            about: "positive = ON needs more contrast, OFF less",
        }],
        covariate: "polarity",
        signature: "ON events are late and rare, OFF events early and frequent; the sum of signed steps \
                    grows with activity",
        confused_with: &["leak_events", "large_signal_front_end", "threshold_scale"],
        source: "Hu, Liu and Delbruck, v2e (2021)",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Fixed(0.15),
            material: GAIN,
            field: Some(Field::Thresholds { off: -1.0 }),
            ..Sought::both("fraction")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(ThresholdAsymmetry { fraction: parameters.need("fraction")? }))
}

/// Thresholds that lie apart.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ThresholdAsymmetry {
    /// Relative error of the ON threshold, and minus that of the OFF threshold; between -1 and 1.
    pub fraction: f64,
}

impl Effect for ThresholdAsymmetry {
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
        thresholds.off *= 1.0 - self.fraction;
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::*;
    use super::*;

    #[test]
    fn counts_up_and_down_are_as_the_thresholds() {
        // Up by 2.405 and down again a little below the start: 2.405 / 0.24 ON events, then (2.4 + 0.05) /
        // 0.16 OFF events.
        let triangle =
            Samples::of_log(200 * MS, |t| -2.0 + if t < 0.1 { 24.05 * t } else { 2.405 - 24.55 * (t - 0.1) });
        let events = recorded(
            ideal_pixel(),
            vec![Box::new(ThresholdAsymmetry { fraction: 0.2 })],
            &triangle,
            200 * MS,
        );
        assert_eq!((count(&events, 1), count(&events, -1)), (10, 15));
        let mirrored = recorded(
            ideal_pixel(),
            vec![Box::new(ThresholdAsymmetry { fraction: -0.2 })],
            &triangle,
            200 * MS,
        );
        assert_eq!((count(&mirrored, 1), count(&mirrored, -1)), (15, 10));
    }
}
