//! Hot rows: all pixels of some rows fire far too often.
//!
//! Pixels of a row share wires for request, acknowledge and reset. A wire that couples to its neighbour or a
//! weak driver disturbs them all, so whole rows show as bright lines in a picture of event counts. Which rows
//! they are does not change: either they are listed, or a share of rows is drawn from the seed. Typical:
//! single rows, at block borders or at the array's edge, 10 to 100 Hz a pixel.
//!
//! Sources: row noise in counts of recordings with equal stamps per row; no published rate, so check against
//! a dark recording. Limits: pixels of a row fire independently, with both signs, at one rate; a row whose
//! pixels fire together is not here.

use super::background_activity::{either, poisson};
use super::sought::{SHARE, Search, Size, Sought};
use super::{
    Chance, Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, Site, Spontaneous, Stage, Unit,
    row_random,
};
use photocurrent_core::random::Random;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "hot_rows",
        stage: Stage::Comparator,
        about: "All pixels of some rows fire by themselves at a high rate",
        equation: "each pixel of the listed rows (or of a share `fraction` of all rows) fires ON or OFF, a \
                   Poisson process of this rate",
        parameters: &[
            ParameterDecl {
                name: "rate",
                unit: Unit::Rate,
                null: Some(0.0),
                allowed: (0.0, 1e6),
                plausible: (1.0, 500.0),
                about: "events per second of each pixel of a hot row, both signs together",
            },
            ParameterDecl {
                name: "rows",
                unit: Unit::Indices,
                null: None,
                allowed: (0.0, 65_535.0),
                plausible: (0.0, 65_535.0),
                about: "which rows, from 0; give this or `fraction`",
            },
            ParameterDecl {
                name: "fraction",
                unit: Unit::Number("fraction"),
                null: Some(0.0),
                allowed: (0.0, 1.0),
                plausible: (0.001, 0.1),
                about: "share of the rows, drawn from the seed; give this or `rows`",
            },
        ],
        covariate: "row",
        signature: "whole rows fire at a high rate all the time, both signs, the rows next to them do not",
        confused_with: &["hot_pixels", "background_activity", "a horizontal edge in the scene"],
        source: "counts per row of recordings; no published rate",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Fixed(0.03),
            material: SHARE,
            others: &[("rate", Size::Fixed(60.0))],
            is_made: false,
            ..Sought::random("fraction")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    let rate_hz = parameters.need("rate")?;
    let which = match (parameters.list("rows"), parameters.get("fraction")) {
        (Some(rows), None) => Which::Listed(rows.to_vec()),
        (None, Some(fraction)) => Which::Share(fraction),
        (Some(_), Some(_)) => {
            return Err(format!("`effects.{}` takes `rows` or `fraction`, not both", KIND.decl.id));
        }
        (None, None) => return Err(format!("`effects.{}` needs `rows` or `fraction`", KIND.decl.id)),
    };
    Ok(Box::new(HotRows { which, rate_hz }))
}

/// Which rows are hot.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Which {
    /// These, from 0.
    Listed(Vec<u32>),
    /// A share of all rows, 0 to 1, drawn from the seed.
    Share(f64),
}

/// Rows that fire by themselves.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct HotRows {
    /// Which rows.
    pub which: Which,
    /// Events per second of each of their pixels, at least zero.
    pub rate_hz: f64,
}

impl HotRows {
    /// Whether the row is hot. The same at every call.
    pub(super) fn is_hot(&self, seed: u64, y: u32) -> bool {
        match &self.which {
            Which::Listed(rows) => rows.contains(&y),
            Which::Share(fraction) => row_random(seed, y, KIND.decl.id).uniform() < *fraction,
        }
    }
}

impl Effect for HotRows {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn spontaneous(
        &self,
        site: &Site,
        random: &mut Random,
        start_ns: i64,
        end_ns: i64,
        out: &mut Vec<Spontaneous>,
    ) {
        if self.is_hot(site.seed, site.y) {
            poisson(self.rate_hz, random, start_ns, end_ns, either, out);
        }
    }

    fn chance(&self) -> Option<Chance> {
        Some(Chance::default())
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{described, refused, sites};
    use serde_json::{Value, json};

    fn counts(parameters: Value) -> Vec<f64> {
        let effect = described("hot_rows", parameters);
        let mut counts = vec![0.0; 100];
        for site in sites() {
            let mut out = Vec::new();
            effect.spontaneous(&site, &mut site.random("test"), 0, 500_000_000, &mut out);
            counts[site.y as usize] += out.len() as f64;
        }
        counts
    }

    #[test]
    fn listed_rows_fire_at_the_stated_rate_and_no_other() {
        for (y, count) in counts(json!({ "rows": [3, 42], "rate": "20 Hz" })).into_iter().enumerate() {
            // 200 pixels x 20 Hz x 0.5 s; five sigma.
            let expected = if y == 3 || y == 42 { 2000.0 } else { 0.0 };
            assert!(f64::abs(count - expected) <= 5.0 * f64::sqrt(expected), "row {y}: {count}");
        }
    }

    #[test]
    fn a_share_of_rows_is_hot_as_a_whole() {
        let counts = counts(json!({ "fraction": 0.2, "rate": "20 Hz" }));
        let hot = counts.iter().filter(|&&count| count > 0.0).count();
        // Binomial: 20 of 100 with sigma 4; five sigma.
        assert!((1..40).contains(&hot), "{hot}");
        assert!(counts.iter().all(|&count| count == 0.0 || f64::abs(count - 2000.0) < 224.0));
    }

    #[test]
    fn rows_are_listed_or_drawn() {
        assert_eq!(
            refused("hot_rows", json!({ "rate": "1 Hz" })),
            "`effects.hot_rows` needs `rows` or `fraction`"
        );
        let both = json!({ "rate": "1 Hz", "rows": [1], "fraction": 0.1 });
        assert_eq!(refused("hot_rows", both), "`effects.hot_rows` takes `rows` or `fraction`, not both");
    }
}
