//! Does a second variable multiply a curve?
//!
//! Cells of both variables are scored as bins are ([`super::binned`]); the best product of one number a bin
//! of each, by turns, is held against the curve alone.

use super::super::laid::{Bins, Laid};
use super::super::open::{LEAST_IN_BIN, Open, bins, moving};
use super::binned::{Half, MOVED, On, share_of};
use super::fit::BY_CHANCE;
use crate::covariates::Covariate;
use crate::dependence::{Factor, Moved};
use nalgebra::{DMatrix, DVector};
use photocurrent_scene::free::FreeScene;
use rayon::prelude::*;

/// What may multiply a curve.
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
/// A product gains so much of what its first curve does, at the least: the best of nine always gains a
/// little. Not calibrated.
const WORTH: f64 = 0.15;

/// A product: first curve, and factors of which the largest is 1.
#[derive(Clone)]
struct Product {
    first: DVector<f64>,
    second: DVector<f64>,
}

impl Product {
    /// The best one, of cells [first][second].
    fn of(half: &Half, (of_first, of_second): (usize, usize), prior: f64) -> Option<Product> {
        let mut second = DVector::from_element(of_second, 1.0);
        let mut first = DVector::zeros(of_first);
        for _ in 0..TURNS {
            let by = DMatrix::from_fn(of_first * of_second, of_first, |cell, i| {
                if cell / of_second == i { second[cell % of_second] } else { 0.0 }
            });
            first = half.through(&by).sizes(prior)?;
            let by = DMatrix::from_fn(of_first * of_second, of_second, |cell, j| {
                if cell % of_second == j { first[cell / of_second] } else { 0.0 }
            });
            second = half.through(&by).sizes(1.0)?;
            let largest = second.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
            if largest == 0.0 {
                return None;
            }
            second /= largest;
            first *= largest;
        }
        Some(Product { first, second })
    }
}

impl<L: FreeScene> On<'_, '_, L> {
    /// Multiplies a curve by one over a second variable where that gains more than chance.
    pub(super) fn multiply(&self, found: &mut Open) {
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

    /// The best product of a curve over each of two variables, and what it moves each event by.
    fn product(
        &self,
        (first, second): (&Laid, &Laid),
        (moved, prior): (Moved, f64),
    ) -> Option<(Product, Factor, Vec<f32>)> {
        let (events, threshold) = (&self.observed.events, self.fit.ground.scales.threshold);
        let (a, b) = (bins(first), Bins::new(&second.at, BINS, LEAST_IN_BIN, second.covariate.is_class()));
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
        let whole = Product::of(&halves[0].with(&halves[1]), size, prior)?;
        let half = |n: usize| Product::of(&halves[n], size, prior);
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
        Some((whole, Factor { covariate: second.covariate, at: b.at, by }, moves))
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
        let half = Half { score: -(&information * cells), information };
        let found = Product::of(&half, (3, 2), 0.5).expect("a product");
        let off = |found: &DVector<f64>, expected: &[f64]| {
            found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
        };
        assert!(off(&found.first, &first) < 1e-4 && off(&found.second, &second) < 1e-3, "{}", found.first);
    }
}
