//! The normal equations of the joint problem and their factor.
//!
//! The picture's block couples coefficients that one measurement sees: a sparse matrix on the grid, factored
//! by `faer` (supernodal, with a fill-reducing order). Motion and shading are few: they follow by the Schur
//! complement (Golub and Van Loan, Matrix Computations, 4.3).

use super::lines::SparseRows;
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMat, SymbolicSparseColMat};
use faer::{Mat, Side};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use std::ops::Range;

/// Ridge on each diagonal element, as a share of the largest: for unknowns without measurements.
const RIDGE: f64 = 1e-12;

/// Rows that are added up side by side, at least.
const LEAST_ROWS: usize = 16_384;

/// Sums of the products of rows: the picture's block by distance on the grid, and the rest.
#[derive(Clone)]
pub(super) struct NormalSums {
    width: usize,
    picture: usize,
    /// Largest distances that are coupled: columns, lines.
    reach: (usize, usize),
    /// For each coefficient those behind it within reach: line by line.
    near: Vec<f64>,
    /// Picture by rest, [coefficient][rest].
    across: Vec<f64>,
    /// Rest by rest.
    rest: DMatrix<f64>,
    /// Room: places of a row's coefficients where lines have as many columns as are coupled.
    place: Vec<usize>,
}

impl NormalSums {
    pub(super) fn new(width: usize, picture: usize, rest: usize, reach: (usize, usize)) -> NormalSums {
        NormalSums {
            width,
            picture,
            reach,
            near: vec![0.0; picture * (2 * reach.0 + 1) * (reach.1 + 1)],
            across: vec![0.0; picture * rest],
            rest: DMatrix::zeros(rest, rest),
            place: Vec::new(),
        }
    }

    /// Distances of the coefficients that rows couple.
    pub(super) fn reach_of(lines: &SparseRows, width: usize) -> (usize, usize) {
        let (mut columns, mut rows) = (0, 0);
        for r in 0..lines.len() {
            let (at, _) = lines.picture(r);
            let (Some(first), Some(last)) = (at.first(), at.last()) else { continue };
            rows = rows.max(*last as usize / width - *first as usize / width);
            let of = |at: &u32| *at as usize % width;
            let (low, high) =
                at.iter().map(of).fold((usize::MAX, 0), |(low, high), at| (low.min(at), high.max(at)));
            columns = columns.max(high - low);
        }
        (columns, rows)
    }

    /// Adds rows with a weight, in two halves where they are many.
    pub(super) fn add_all(&mut self, lines: &SparseRows, weight: &[f64]) {
        let add = |sums: &mut NormalSums, of: Range<usize>| {
            of.filter(|r| weight[*r] > 0.0).for_each(|r| sums.add(lines, r, weight[r]));
        };
        if lines.len() < LEAST_ROWS {
            return add(self, 0..lines.len());
        }
        let half = lines.len() / 2;
        let mut other = NormalSums::new(self.width, self.picture, self.rest.nrows(), self.reach);
        rayon::join(|| add(self, 0..half), || add(&mut other, half..lines.len()));
        self.near.iter_mut().zip(&other.near).for_each(|(a, b)| *a += b);
        self.across.iter_mut().zip(&other.across).for_each(|(a, b)| *a += b);
        self.rest += other.rest;
    }

    /// Adds row `r`, times a weight.
    fn add(&mut self, lines: &SparseRows, r: usize, weight: f64) {
        let (at, by) = lines.picture(r);
        let (span, columns) = (2 * self.reach.0 + 1, (2 * self.reach.0 + 1) * (self.reach.1 + 1));
        self.place.clear();
        self.place.extend(at.iter().map(|at| *at as usize / self.width * span + *at as usize % self.width));
        for (a, of_a) in at.iter().enumerate() {
            let scale = weight * f64::from(by[a]);
            let to = &mut self.near[*of_a as usize * columns..][..columns];
            for (place, by) in self.place[a..].iter().zip(&by[a..]) {
                to[place + self.reach.0 - self.place[a]] += scale * f64::from(*by);
            }
        }
        let (rest_at, rest_by) = lines.other_derivatives(r);
        let rest = self.rest.nrows();
        for (a, by_a) in at.iter().zip(by) {
            let scale = weight * f64::from(*by_a);
            let to = &mut self.across[*a as usize * rest..][..rest];
            rest_at.iter().zip(rest_by).for_each(|(at, by)| to[usize::from(*at)] += scale * f64::from(*by));
        }
        for (a, by_a) in rest_at.iter().zip(rest_by) {
            let scale = weight * f64::from(*by_a);
            for (b, by_b) in rest_at.iter().zip(rest_by) {
                self.rest[(usize::from(*a), usize::from(*b))] += scale * f64::from(*by_b);
            }
        }
    }

    /// Adds a square of few coefficients, rising: a prior's.
    pub(super) fn add_picture(&mut self, at: &[usize], by: &[f64], weight: f64) {
        let (span, columns) = (2 * self.reach.0 + 1, (2 * self.reach.0 + 1) * (self.reach.1 + 1));
        for (a, by_a) in at.iter().zip(by) {
            for (b, by_b) in at.iter().zip(by).filter(|(b, _)| *b >= a) {
                let place =
                    (b / self.width - a / self.width) * span + b % self.width + self.reach.0 - a % self.width;
                self.near[a * columns + place] += weight * by_a * by_b;
            }
        }
    }

    /// Adds a square of the rest.
    pub(super) fn add_rest(&mut self, at: &[usize], by: &[f64], weight: f64) {
        for (a, by_a) in at.iter().zip(by) {
            for (b, by_b) in at.iter().zip(by) {
                self.rest[(*a, *b)] += weight * by_a * by_b;
            }
        }
    }

    /// The factor; none where the equations are singular.
    pub(super) fn factor(self) -> Option<NormalFactor> {
        let llt = self.sparse().and_then(|(matrix, symbolic)| {
            Llt::try_new_with_symbolic(symbolic, matrix.as_ref(), Side::Lower).ok()
        })?;
        let (picture, rest) = (self.picture, self.rest.nrows());
        let across = DMatrix::from_row_slice(picture, rest, &self.across);
        let mut through = Mat::<f64>::from_fn(picture, rest, |i, j| self.across[i * rest + j]);
        llt.solve_in_place(through.as_mut());
        let through = DMatrix::from_fn(picture, rest, |i, j| through[(i, j)]);
        let schur = Cholesky::new(&self.rest - across.transpose() * &through)?;
        Some(NormalFactor { llt, across, through, schur })
    }

    /// The picture's block, its lower half.
    fn sparse(&self) -> Option<(SparseColMat<usize, f64>, SymbolicLlt<usize>)> {
        let (span, columns) = (2 * self.reach.0 + 1, (2 * self.reach.0 + 1) * (self.reach.1 + 1));
        let largest = (0..self.picture).map(|k| self.near[k * columns + self.reach.0]).fold(0.0, f64::max);
        let (mut begin, mut at, mut values) = (vec![0], Vec::new(), Vec::new());
        for k in 0..self.picture {
            for (place, value) in self.near[k * columns..][..columns].iter().enumerate() {
                let is_own = place == self.reach.0;
                if is_own || *value != 0.0 {
                    at.push(k + place / span * self.width + place % span - self.reach.0);
                    values.push(if is_own { value + RIDGE * largest } else { *value });
                }
            }
            begin.push(at.len());
        }
        let symbolic = SymbolicSparseColMat::new_checked(self.picture, self.picture, begin, None, at);
        let matrix = SparseColMat::new(symbolic, values);
        let symbolic = SymbolicLlt::try_new(matrix.symbolic(), Side::Lower).ok()?;
        Some((matrix, symbolic))
    }
}

/// The factor of the normal equations.
pub(super) struct NormalFactor {
    llt: Llt<usize, f64>,
    across: DMatrix<f64>,
    /// The inverse of the picture's block times `across`.
    through: DMatrix<f64>,
    schur: Cholesky<f64, Dyn>,
}

impl NormalFactor {
    /// Solves for each of some right sides, in place: the picture's coefficients, then the rest.
    pub(super) fn solve(&self, sides: &mut [Vec<f64>]) {
        let (picture, rest) = (self.through.nrows(), self.through.ncols());
        let mut of_picture = Mat::<f64>::from_fn(picture, sides.len(), |i, j| sides[j][i]);
        self.llt.solve_in_place(of_picture.as_mut());
        for (j, side) in sides.iter_mut().enumerate() {
            let own = DVector::from_fn(picture, |i, _| of_picture[(i, j)]);
            let left = DVector::from_column_slice(&side[picture..]) - self.across.tr_mul(&own);
            let of_rest = self.schur.solve(&left);
            let own = own - &self.through * &of_rest;
            side[..picture].copy_from_slice(own.as_slice());
            side[picture..picture + rest].copy_from_slice(of_rest.as_slice());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::lines::SparseDerivatives;
    use super::*;
    use photocurrent_core::random::Random;

    #[test]
    fn solutions_are_those_of_the_dense_equations() {
        let (width, height, rest) = (9, 8, 3);
        let picture = width * height;
        let mut random = Random::new(5, &[]);
        let mut lines = SparseRows::new();
        for _ in 0..200 {
            let corner = (random.uniform() * 5.0) as usize + width * (random.uniform() * 5.0) as usize;
            let mut of_picture: Vec<(u32, f32)> =
                (0..9).map(|n| ((corner + n % 3 + n / 3 * width) as u32, random.normal() as f32)).collect();
            // One unknown twice.
            of_picture.push((corner as u32, 0.5));
            let of_rest: Vec<(u16, f32)> = (0..rest as u16).map(|n| (n, random.normal() as f32)).collect();
            let mut row = SparseDerivatives { of_picture, of_rest };
            row.sum();
            lines.push_difference((&row, &SparseDerivatives::default()), 1.0, true);
        }
        let all = picture + rest;
        let mut dense = DMatrix::<f64>::identity(all, all);
        let mut sums = NormalSums::new(width, picture, rest, NormalSums::reach_of(&lines, width));
        for r in 0..lines.len() {
            let weight = 0.5 + random.uniform();
            let mut row = vec![0.0; all];
            lines.add_row(r, 1.0, &mut row, picture);
            let row = DVector::from_vec(row);
            dense += weight * &row * row.transpose();
            sums.add(&lines, r, weight);
        }
        (0..picture).for_each(|k| sums.add_picture(&[k], &[1.0], 1.0));
        (0..rest).for_each(|k| sums.add_rest(&[k], &[1.0], 1.0));
        let factor = sums.factor().unwrap();
        let mut sides: Vec<Vec<f64>> = (0..3).map(|_| (0..all).map(|_| random.normal()).collect()).collect();
        let inverse = dense.cholesky().unwrap();
        let expected: Vec<DVector<f64>> =
            sides.iter().map(|side| inverse.solve(&DVector::from_column_slice(side))).collect();
        factor.solve(&mut sides);
        for (found, expected) in sides.iter().zip(expected) {
            let off = (DVector::from_column_slice(found) - &expected).norm() / expected.norm();
            assert!(off < 1e-9, "{off}");
        }
    }
}
