//! Row skew: each row of the array stamps with a delay of its own.
//!
//! Rows are collected one after another, or the clock reaches them over wires of different length, so an
//! event of row 100 is stamped later (or earlier) than one of row 0 that fired together with it. A moving
//! vertical edge then looks sheared. The delay grows along the rows, or it differs at random from row to row,
//! or both. Typical: nanoseconds to microseconds a row.
//!
//! Sources: sensors that scan their rows; recordings in which all events of a row share a stamp. Limits:
//! constant in time and load; the load is `readout_queue`, a wrong row time of the frames is `row_time`.

use super::sought::{Measure, Search, Size, Sought, TIME};
use super::{
    Chance, Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, PixelEvent, Site, Stage, Unit,
    row_random,
};
use photocurrent_core::random::Random;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "row_skew",
        stage: Stage::Time,
        about: "Each row stamps its events with a delay of its own",
        equation: "t_recorded = t_true + per_row * y + sigma * z(y), z ~ N(0, 1) once for each row",
        parameters: &[
            ParameterDecl {
                name: "per_row",
                unit: Unit::Time,
                null: Some(0.0),
                allowed: (-1.0, 1.0),
                plausible: (-1e-4, 1e-4),
                about: "recorded minus true time grows by this from one row to the next; zero in row 0, \
                        negative = later rows are stamped early",
            },
            ParameterDecl {
                name: "sigma",
                unit: Unit::Time,
                null: Some(0.0),
                allowed: (0.0, 1.0),
                plausible: (1e-7, 1e-3),
                about: "standard deviation of a row's own delay, constant in time",
            },
        ],
        covariate: "row",
        signature: "events come late by an amount linear in the row (or of the row's own), the same in a \
                    row at all times and slopes",
        confused_with: &["row_time", "clock_offset", "readout_queue"],
        source: "sensors that scan their rows",
        apart: &[],
        search: Search::For(&[
            Sought {
                typical: Size::Fixed(8e-6),
                material: Size::Over(&TIME, Measure::Rows),
                ..Sought::both("per_row")
            },
            Sought {
                typical: Size::Fixed(150e-6),
                material: TIME,
                is_made: false,
                ..Sought::random("sigma")
            },
        ]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    let (per_row_ns, sigma) = (parameters.get_ns("per_row"), parameters.get("sigma"));
    if per_row_ns.is_none() && sigma.is_none() {
        return Err(format!("`effects.{}` needs `per_row` or `sigma`", KIND.decl.id));
    }
    Ok(Box::new(RowSkew { per_row_ns: per_row_ns.unwrap_or(0), sigma_ns: 1e9 * sigma.unwrap_or(0.0) }))
}

/// A delay of stamps that depends on the row.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct RowSkew {
    /// Growth of the delay from one row to the next, nanoseconds, any sign.
    pub per_row_ns: i64,
    /// Standard deviation of a row's own delay, nanoseconds, at least zero.
    pub sigma_ns: f64,
}

impl RowSkew {
    /// Recorded minus true time in a row, nanoseconds.
    pub(super) fn delay_ns(&self, seed: u64, y: u32) -> i64 {
        let own = if self.sigma_ns > 0.0 {
            self.sigma_ns * row_random(seed, y, KIND.decl.id).normal()
        } else {
            0.0
        };
        self.per_row_ns * i64::from(y) + own.round() as i64
    }
}

impl Effect for RowSkew {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn stamp(&self, site: &Site, _random: &mut Random, event: &mut PixelEvent) {
        let delay_ns = self.delay_ns(site.seed, site.y);
        event.t_in_ns += delay_ns;
        event.t_off_ns += delay_ns;
    }

    fn chance(&self) -> Option<Chance> {
        (self.sigma_ns > 0.0).then(|| Chance {
            of_stamps_s: self.sigma_ns * 1e-9,
            known: Some(Box::new(RowSkew { sigma_ns: 0.0, ..*self })),
            ..Chance::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{described, moments, refused, site};
    use super::*;
    use serde_json::json;

    fn delay(effect: &dyn Effect, x: u32, y: u32, t_ns: i64) -> i64 {
        let mut event = PixelEvent { t_in_ns: t_ns, t_off_ns: t_ns + 1_000, polarity: 1 };
        effect.stamp(&site(x, y), &mut Random::new(1, &[]), &mut event);
        assert_eq!(event.t_off_ns - event.t_in_ns, 1_000, "both stamps move together");
        event.t_in_ns - t_ns
    }

    #[test]
    fn the_delay_is_linear_in_the_row_and_nothing_else() {
        let effect = described("row_skew", json!({ "per_row": "-2 us" }));
        for y in 0..100 {
            for (x, t_ns) in [(0, 0), (7, 5_000), (199, 3_000_000_000)] {
                assert_eq!(delay(&*effect, x, y, t_ns), -2_000 * i64::from(y));
            }
        }
    }

    #[test]
    fn random_delays_belong_to_their_rows() {
        let effect = described("row_skew", json!({ "sigma": "3 us" }));
        let delays: Vec<f64> = (0..100).map(|y| delay(&*effect, 0, y, 0) as f64).collect();
        let (mean, sigma) = moments(&delays);
        // Five standard errors with 100 rows.
        assert!(mean.abs() < 1_500.0, "{mean}");
        assert!((sigma - 3_000.0).abs() < 1_070.0, "{sigma}");
        assert!((0..100).all(|y| delay(&*effect, 150, y, 77_000) as f64 == delays[y as usize]));
    }

    #[test]
    fn at_least_one_parameter_is_needed() {
        assert_eq!(refused("row_skew", json!({})), "`effects.row_skew` needs `per_row` or `sigma`");
    }
}
