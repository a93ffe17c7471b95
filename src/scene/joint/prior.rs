//! Variances of the picture's second differences, one each, by expectation maximisation.

use super::super::picture::spline::SplineGrid;
use super::fields::GridFields;

/// Differences at each coefficient: along x, along y and across.
const KINDS: usize = 3;
/// The mean is over the coefficients up to this far on either side.
const NEAR: usize = 2;
/// Three differences stand on each coefficient, each with a variance: together they let it vary less than
/// each alone, and each variance is as many times larger than the mean square.
const SHARED: f64 = 3.0;
/// Differences that are always possible, as a share of the picture's mean.
const LEAST: f64 = 0.001;

/// Variances of second differences, [field][kind][coefficient].
#[derive(Clone, Debug)]
pub(super) struct DifferencePrior {
    variance: Vec<f64>,
}

/// The coefficients of a difference and their factors; none where it would leave the grid.
fn difference(grid: &SplineGrid, kind: usize, k: usize) -> Option<([usize; 4], [f64; 4], usize)> {
    let (w, x, y) = (grid.width, k % grid.width, k / grid.width);
    match kind {
        0 => (x > 0 && x + 1 < w).then_some(([k.wrapping_sub(1), k, k + 1, 0], [1.0, -2.0, 1.0, 0.0], 3)),
        1 => (y > 0 && y + 1 < grid.height).then_some((
            [k.wrapping_sub(w), k, k + w, 0],
            [1.0, -2.0, 1.0, 0.0],
            3,
        )),
        _ => (x + 1 < w && y + 1 < grid.height).then_some((
            [k, k + 1, k + w, k + w + 1],
            [1.0, -1.0, -1.0, 1.0],
            4,
        )),
    }
}

impl DifferencePrior {
    /// From a picture and a posterior sample of it, both in the order of unknowns.
    pub(super) fn estimate(fields: &GridFields, picture: &[f64], open: Option<&[f64]>) -> DifferencePrior {
        let (grid, count) = (&fields.grid, fields.grid.coefficients());
        let mean = picture.iter().sum::<f64>() / picture.len() as f64;
        let least = (LEAST * mean) * (LEAST * mean);
        let mut variance = Vec::with_capacity(fields.count * KINDS * count);
        for (field, kind) in (0..fields.count).flat_map(|field| (0..KINDS).map(move |kind| (field, kind))) {
            let square = |k: usize| {
                let Some((at, by, n)) = difference(grid, kind, k) else { return 0.0 };
                let of = |values: &[f64]| -> f64 {
                    (0..n).map(|i| by[i] * values[fields.unknown(field, at[i])]).sum()
                };
                let open = open.map_or(0.0, of);
                of(picture) * of(picture) + open * open
            };
            let squares: Vec<f64> = (0..count).map(square).collect();
            variance.extend((0..count).map(|k| {
                let (x, y) = (k % grid.width, k / grid.width);
                let (mut sum, mut n) = (0.0, 0.0);
                for j in y.saturating_sub(NEAR)..(y + NEAR + 1).min(grid.height) {
                    for i in x.saturating_sub(NEAR)..(x + NEAR + 1).min(grid.width) {
                        (sum, n) = (sum + squares[j * grid.width + i], n + 1.0);
                    }
                }
                SHARED * sum / n + least
            }));
        }
        DifferencePrior { variance }
    }

    /// Every difference: its unknowns, rising, their factors, and one over its variance.
    pub(super) fn for_each_difference(
        &self,
        fields: &GridFields,
        mut with: impl FnMut(&[usize], &[f64], f64),
    ) {
        let count = fields.grid.coefficients();
        for (n, variance) in self.variance.iter().enumerate() {
            let (field, kind, k) = (n / count / KINDS, n / count % KINDS, n % count);
            if let Some((at, by, n)) = difference(&fields.grid, kind, k) {
                with(&at.map(|k| fields.unknown(field, k))[..n], &by[..n], 1.0 / variance);
            }
        }
    }
}
