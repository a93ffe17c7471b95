//! Tests whether a second covariate multiplies a curve.
//!
//! Cells of both covariates are scored like bins ([`super::binned`]). The best product, one factor per bin of
//! each, estimated alternately, is compared with the curve alone.

use super::super::laid::{CovariateBins, CovariateColumns};
use super::super::open::{CovariateCurve, LEAST_IN_BIN, bins, moving};
use super::binned::{BinnedHalf, BinnedScene, MOVED, share_of};
use super::fit::BY_CHANCE;
use crate::covariates::Covariate;
use crate::dependence::{AffectedQuantity, SecondFactor};
use nalgebra::{DMatrix, DVector};
use photocurrent_scene::free::FreeScene;
use rayon::prelude::*;

/// Covariates that may multiply a curve.
const SECOND: [Covariate; 9] = [
    Covariate::Polarity,
    Covariate::PreviousPolarity,
    Covariate::RowParity,
    Covariate::ColumnParity,
    Covariate::ColumnBlock,
    Covariate::Row,
    Covariate::Column,
    Covariate::Radius,
    Covariate::Time,
];
/// Bins of one that is a number on a scale.
const BINS: usize = 4;
/// Turns of both curves.
const TURNS: usize = 12;
/// Least gain of a product, as a share of its first curve's: the best of nine always gains a little. Not
/// calibrated.
const WORTH: f64 = 0.15;

/// A product: first curve, and factors of which the largest is 1.
#[derive(Clone)]
struct CurveProduct {
    first: DVector<f64>,
    second: DVector<f64>,
}

impl CurveProduct {
    /// The best product for cells [first][second].
    fn best_of_cells(
        half: &BinnedHalf,
        (of_first, of_second): (usize, usize),
        prior: f64,
    ) -> Option<CurveProduct> {
        let mut second = DVector::from_element(of_second, 1.0);
        let mut first = DVector::zeros(of_first);
        for _ in 0..TURNS {
            let by = DMatrix::from_fn(of_first * of_second, of_first, |cell, i| {
                if cell / of_second == i { second[cell % of_second] } else { 0.0 }
            });
            first = half.project(&by).sizes(prior)?;
            let by = DMatrix::from_fn(of_first * of_second, of_second, |cell, j| {
                if cell % of_second == j { first[cell / of_second] } else { 0.0 }
            });
            second = half.project(&by).sizes(1.0)?;
            let largest = second.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
            if largest == 0.0 {
                return None;
            }
            second /= largest;
            first *= largest;
        }
        Some(CurveProduct { first, second })
    }
}

impl<L: FreeScene> BinnedScene<'_, '_, L> {
    /// Multiplies a curve by one over a second variable where that gains more than chance.
    pub(super) fn multiply(&self, found: &mut CovariateCurve) {
        let curve = &found.dependence;
        let laid = |covariate: Covariate| self.observed.laid.iter().find(|laid| laid.covariate == covariate);
        let Some((first, moved)) = laid(curve.covariate)
            .and_then(|first| Some((first, MOVED.iter().find(|(moved, _)| *moved == curve.moved)?)))
        else {
            return;
        };
        let Some(alone) = self.curves(first).into_iter().find(|one| one.dependence.moved == moved.0) else {
            return;
        };
        let best = SECOND
            .into_par_iter()
            .filter(|second| *second != curve.covariate)
            .filter_map(|second| {
                let (product, factor, columns) = self.product((first, laid(second)?), *moved)?;
                let (gain, error) = *self.compared(&[[&columns, &alone.columns[0]]]).first()?;
                Some((gain[0] - gain[1], error, product, factor))
            })
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let Some((gain, error, product, factor)) = best else { return };
        if gain < BY_CHANCE * error || gain < WORTH * found.gain || gain <= 0.0 {
            return;
        }
        let bins = bins(first);
        let curve = &mut found.dependence;
        // What is the same in all bins is part of the product.
        curve.value = product.first.iter().copied().collect();
        curve.at = bins.at;
        curve.steps.clear();
        curve.times = Some(factor);
        curve.nats_per_event += gain;
        found.mean = 0.0;
        found.gain += gain;
        found.control_gain += (1.0 - share_of(curve.covariate)) * gain;
    }

    /// The best product over two covariates, and its change of each event.
    fn product(
        &self,
        (first, second): (&CovariateColumns, &CovariateColumns),
        (moved, prior): (AffectedQuantity, f64),
    ) -> Option<(CurveProduct, SecondFactor, Vec<f32>)> {
        let (events, threshold) = (&self.observed.events, self.fit.ground.scales.threshold);
        let (a, b) =
            (bins(first), CovariateBins::new(&second.at, BINS, LEAST_IN_BIN, second.covariate.is_class()));
        let (of_first, of_second) = (a.at.len(), b.at.len());
        if of_first < 2 || of_second < 2 {
            return None;
        }
        let cell = |a: Option<u32>, b: Option<u32>| Some(a? as usize * of_second + b? as usize);
        let here: Vec<Option<usize>> = a.of.iter().zip(&b.of).map(|(i, j)| cell(*i, *j)).collect();
        let before: Vec<Option<usize>> =
            first.before.iter().zip(&second.before).map(|(x, y)| cell(a.bin(*x), b.bin(*y))).collect();
        let one = |is: bool| f64::from(u8::from(is));
        let columns: Vec<_> = (0..of_first * of_second)
            .map(|n| {
                let is = |cell: &Option<usize>| one(*cell == Some(n));
                moving(events, moved, threshold, |k| is(&here[k]), |k| is(&before[k]))
            })
            .collect();
        let of: Vec<&[f32]> = columns.iter().map(|column| &column.of[..]).collect();
        let halves = self.halves(&of, of.len()).pop()?;
        let size = (of_first, of_second);
        let whole = CurveProduct::best_of_cells(&halves[0].plus(&halves[1]), size, prior)?;
        let half = |n: usize| CurveProduct::best_of_cells(&halves[n], size, prior);
        let sizes = match L::IS_ONE {
            true => [whole.clone(), whole.clone()],
            false => [half(0)?, half(1)?],
        };
        let column = |k: usize| {
            // Of an event by sizes that it took no part in.
            let of = &sizes[1 - (self.observed.block[k] % 2) as usize];
            let by =
                |n: usize| of.first[n / of_second] * of.second[n % of_second] * f64::from(columns[n].of[k]);
            (0..columns.len()).map(by).sum::<f64>() as f32
        };
        let moves = (0..events.pixel.len()).map(column).collect();
        let by = whole.second.iter().copied().collect();
        Some((whole, SecondFactor { covariate: second.covariate, at: b.at, by }, moves))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_product_of_cells_is_that_which_made_them() {
        // Score of sizes x under an information: -I x.
        let (first, second) = ([0.1, -0.05, 0.02], [1.0, 0.25]);
        let cells = DVector::from_fn(6, |n, _| first[n / 2] * second[n % 2]);
        let information =
            DMatrix::from_fn(6, 6, |i, j| if i == j { 4e6 } else { 3e5 / (1.0 + i.abs_diff(j) as f64) });
        let half = BinnedHalf { score: -(&information * cells), information };
        let found = CurveProduct::best_of_cells(&half, (3, 2), 0.5).expect("a product");
        let off = |found: &DVector<f64>, expected: &[f64]| {
            found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
        };
        assert!(off(&found.first, &first) < 1e-4 && off(&found.second, &second) < 1e-3, "{}", found.first);
    }
}
