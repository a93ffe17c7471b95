//! Bandwidth gradient: the front end is faster at one side of the array than at the other.
//!
//! Bias lines drop along the array and processing varies over the die, so the bandwidth goes linearly from
//! `1 - fraction` at the first column to `1 + fraction` at the last; both parts of the time constant are
//! divided by it. Typical: 1 to 10 %.
//!
//! Parameter: `fraction`, positive = the last column is the faster one. It shows as a delay that grows across
//! the columns, longer in the dark; an error of the time constant is the same at all columns, a gradient of
//! thresholds does not care about speed.
//!
//! Source: voltage drop along bias lines, textbook.
//! Limits: linear and along columns only; the centre column keeps the stated time constant.

use super::sought::{SHARE, Search, Size, Sought};
use super::{Effect, EffectDecl, EffectKind, FrontEndModel, ParameterDecl, Parameters, Site, Stage, Unit};

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "bandwidth_gradient",
        stage: Stage::FrontEnd,
        about: "The front end's bandwidth varies linearly across the columns",
        equation: "tau = (tau_0 + alpha / i) / (1 + fraction * across), across = -1 (first column) to +1 \
                   (last)",
        parameters: &[ParameterDecl {
            name: "fraction",
            unit: Unit::Number("fraction"),
            null: Some(0.0),
            allowed: (-0.95, 0.95),
            plausible: (-0.3, 0.3),
            about: "relative change of the bandwidth at the edge columns: + at the last, - at the first",
        }],
        covariate: "column*lag",
        signature: "events of fast edges early at one side and late at the other, more so in the dark",
        confused_with: &["time_constant", "threshold_gradient", "misalignment"],
        source: "voltage drop along bias lines",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Fixed(0.5),
            material: SHARE,
            ..Sought::both("fraction")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(BandwidthGradient { fraction: parameters.need("fraction")? }))
}

/// A bandwidth that is linear in the column.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct BandwidthGradient {
    /// Relative change at the last column, above -1 and below 1; the first column has its opposite.
    pub fraction: f64,
}

impl Effect for BandwidthGradient {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn front_end(&self, site: &Site, model: &mut FrontEndModel) {
        let bandwidth = 1.0 + self.fraction * site.across();
        model.low_pass.tau_0_s /= bandwidth;
        model.low_pass.alpha_s /= bandwidth;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::front_end::{FrontEnd, time_constant};

    /// The time constant at photocurrent 0.5 in a column of 11.
    fn tau(fraction: f64, x: u32) -> f64 {
        let mut model = FrontEndModel::plain(FrontEnd { tau_0_s: 2e-5, alpha_s: 1e-2 });
        BandwidthGradient { fraction }
            .front_end(&Site { x, y: 3, width: 11, height: 7, seed: 1 }, &mut model);
        time_constant(&model.low_pass, 0.5)
    }

    #[test]
    fn the_last_column_is_faster_by_the_fraction_and_the_first_slower() {
        let stated = 2e-5 + 1e-2 / 0.5;
        for (x, bandwidth) in [(0, 0.8), (5, 1.0), (10, 1.2)] {
            assert!((tau(0.2, x) * bandwidth / stated - 1.0).abs() < 1e-14);
            assert!((tau(0.0, x) / stated - 1.0).abs() < 1e-14);
        }
    }

    #[test]
    fn bandwidth_is_linear_in_the_column() {
        let step = |x| 1.0 / tau(0.2, x + 1) - 1.0 / tau(0.2, x);
        assert!((0..9).all(|x| (step(x) / step(9) - 1.0).abs() < 1e-10));
    }
}
