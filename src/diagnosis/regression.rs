//! Least squares from sums of products, so that fits on one part of the data can be judged on another without going through it again.

use nalgebra::{DMatrix, DVector};

/// Columns are drawn to zero as by this share of their own square: so little that only columns of others' sums feel it.
pub const RIDGE: f64 = 1e-6;

/// Standard error of an estimate, from what it is with each part of the data left out.
pub fn jackknife(left_out: &[f64]) -> f64 {
    let n = f64::max(left_out.len() as f64, 1.0);
    let mean = left_out.iter().sum::<f64>() / n;
    libm::sqrt((n - 1.0) / n * left_out.iter().map(|one| (one - mean) * (one - mean)).sum::<f64>())
}

/// Sums of products of some columns and what they are to explain.
#[derive(Clone, Debug, PartialEq)]
pub struct Products {
    columns: usize,
    /// Symmetric, row by row; the last column is the one that is explained.
    sums: Vec<f64>,
    /// Number of rows.
    pub rows: f64,
}

impl Products {
    /// Of no rows yet.
    pub fn new(columns: usize) -> Products {
        Products { columns, sums: vec![0.0; (columns + 1) * (columns + 1)], rows: 0.0 }
    }

    /// Adds a row: what is not 0 of its columns, as (column, value), what they are to explain, and its weight.
    pub fn add(&mut self, row: &[(usize, f64)], explained: f64, weight: f64) {
        let size = self.columns + 1;
        for &(a, x) in row {
            for &(b, z) in row {
                self.sums[a * size + b] += weight * x * z;
            }
            self.sums[a * size + self.columns] += weight * x * explained;
            self.sums[self.columns * size + a] += weight * x * explained;
        }
        self.sums[size * size - 1] += weight * explained * explained;
        self.rows += 1.0;
    }

    /// Adds other rows.
    pub fn merge(&mut self, other: &Products) {
        self.sums.iter_mut().zip(&other.sums).for_each(|(sum, more)| *sum += more);
        self.rows += other.rows;
    }

    /// The coefficients of least squares, with columns that `keep` refuses at 0. Columns are drawn to zero as by a `ridge`'s share of their own square.
    pub fn solve(&self, keep: impl Fn(usize) -> bool, ridge: f64) -> Vec<f64> {
        self.solve_beside(keep, ridge, |_| 0.0)
    }

    /// The same with the columns that are not kept at given coefficients.
    pub fn solve_beside(&self, keep: impl Fn(usize) -> bool, ridge: f64, given: impl Fn(usize) -> f64) -> Vec<f64> {
        let size = self.columns + 1;
        let kept: Vec<usize> = (0..self.columns).filter(|&n| keep(n) && self.sums[n * size + n] > 0.0).collect();
        let scale: Vec<f64> = kept.iter().map(|&n| libm::sqrt(self.sums[n * size + n])).collect();
        let matrix =
            DMatrix::from_fn(kept.len(), kept.len(), |a, b| self.sums[kept[a] * size + kept[b]] / (scale[a] * scale[b]) + if a == b { ridge } else { 0.0 });
        let right = DVector::from_fn(kept.len(), |a, _| {
            let beside = (0..self.columns).filter(|&n| !keep(n)).map(|n| given(n) * self.sums[kept[a] * size + n]).sum::<f64>();
            (self.sums[kept[a] * size + self.columns] - beside) / scale[a]
        });
        let mut coefficients: Vec<f64> = (0..self.columns).map(|n| if keep(n) { 0.0 } else { given(n) }).collect();
        if let Some(found) = matrix.cholesky().map(|of| of.solve(&right)) {
            for (at, &n) in kept.iter().enumerate() {
                coefficients[n] = found[at] / scale[at];
            }
        }
        coefficients
    }

    /// Products of columns that are known twice, `n` and `n + columns / 2`, each time with errors of its own: products of one with the other have no share of those.
    pub fn of_twins(&self) -> Products {
        let (half, size) = (self.columns / 2, self.columns + 1);
        let at = |a: usize, b: usize| self.sums[a * size + b];
        let mut twins = Products { rows: self.rows, ..Products::new(half) };
        for a in 0..half {
            for b in 0..half {
                twins.sums[a * (half + 1) + b] = 0.5 * (at(a, b + half) + at(a + half, b));
            }
            let explained = 0.5 * (at(a, self.columns) + at(a + half, self.columns));
            twins.sums[a * (half + 1) + half] = explained;
            twins.sums[half * (half + 1) + a] = explained;
        }
        twins.sums[(half + 1) * (half + 1) - 1] = at(self.columns, self.columns);
        twins
    }

    /// Sum of squares that coefficients leave.
    pub fn left(&self, coefficients: &[f64]) -> f64 {
        let size = self.columns + 1;
        let with = |a: usize| if a == self.columns { -1.0 } else { coefficients[a] };
        (0..size).map(|a| with(a) * (0..size).map(|b| with(b) * self.sums[a * size + b]).sum::<f64>()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::random::Random;

    #[test]
    fn coefficients_that_made_the_data_come_back_and_leave_the_noise() {
        let mut random = Random::new(2, &[]);
        let truth = [1.5, -0.25, 0.0];
        let (mut products, mut noise, mut half) = (Products::new(3), 0.0, Products::new(3));
        for n in 0..2000 {
            let row: Vec<(usize, f64)> = (0..3).map(|k| (k, random.normal() + if k == 2 { 0.3 } else { 0.0 })).collect();
            let off = 0.1 * random.normal();
            let explained = row.iter().map(|(k, x)| truth[*k] * x).sum::<f64>() + off;
            noise += 2.0 * off * off;
            products.add(&row, explained, 2.0);
            if n < 1000 {
                half.add(&row, explained, 2.0);
            }
        }
        let found = products.solve(|_| true, 0.0);
        assert!(found.iter().zip(truth).all(|(a, b)| (a - b).abs() < 0.01), "{found:?}");
        // The residual of a fit is that of the truth but for three degrees of freedom.
        assert!((products.left(&truth) / noise - 1.0).abs() < 1e-9 && products.left(&found) <= noise && products.left(&found) > 0.99 * noise);
        let without = products.solve(|n| n != 0, 0.0);
        assert!(without[0] == 0.0 && products.left(&without) > 100.0 * noise);
        let mut twice = half.clone();
        twice.merge(&half);
        assert_eq!(twice.rows, 2000.0);
        assert!(twice.solve(|_| true, 0.0).iter().zip(half.solve(|_| true, 0.0)).all(|(a, b)| (a - b).abs() < 1e-12));
    }

    #[test]
    fn leaving_values_out_of_a_mean_gives_its_standard_error() {
        let mut random = Random::new(6, &[]);
        let values: Vec<f64> = (0..50).map(|_| random.normal()).collect();
        let sum: f64 = values.iter().sum();
        let spread = values.iter().map(|value| (value - sum / 50.0) * (value - sum / 50.0)).sum::<f64>() / 49.0;
        let left_out: Vec<f64> = values.iter().map(|value| (sum - value) / 49.0).collect();
        assert!((jackknife(&left_out) - libm::sqrt(spread / 50.0)).abs() < 1e-12 && jackknife(&[]) == 0.0);
    }

    #[test]
    fn what_is_known_twice_is_not_made_smaller_by_its_errors() {
        let mut random = Random::new(4, &[]);
        let truth = [0.8, -1.2];
        let (mut once, mut twice) = (Products::new(2), Products::new(4));
        for _ in 0..40_000 {
            let clean: [f64; 2] = std::array::from_fn(|_| random.normal());
            let explained = truth[0] * clean[0] + truth[1] * clean[1] + 0.5 * random.normal();
            let seen: [f64; 4] = std::array::from_fn(|n| clean[n % 2] + random.normal());
            once.add(&[(0, seen[0]), (1, seen[1])], explained, 1.0);
            twice.add(&seen.into_iter().enumerate().collect::<Vec<_>>(), explained, 1.0);
        }
        let (small, right) = (once.solve(|_| true, 0.0), twice.of_twins().solve(|_| true, 0.0));
        for k in 0..2 {
            assert!((small[k] / truth[k] - 0.5).abs() < 0.03 && (right[k] / truth[k] - 1.0).abs() < 0.04, "{small:?} {right:?}");
        }
        assert!((twice.of_twins().left(&right) / (0.25 * 40_000.0) - 1.0).abs() < 0.1);
    }
}
