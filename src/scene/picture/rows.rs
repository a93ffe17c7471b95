//! Frame values as rows of the least-squares problem: their derivatives, and the ranges in which they are
//! summed.

use super::motion::DEGREES;
use super::shading::TERMS;
use super::spline::SplineGrid;
use std::ops::Range;

/// Knots that one exposure may touch.
pub(crate) const TOUCHED: usize = 6;
/// Parts in which sums over rows are taken, at most.
const PARTS: usize = 8;
/// Least number of rows of each range.
const LEAST_ROWS: usize = 4_096;
/// Lines of stencils are padded to a multiple of this, so that they are added up side by side.
pub(crate) const LANES: usize = 8;
/// Derivatives of a row by the shading's terms come first, and the poses behind them from here on.
pub(crate) const POSES: usize = TERMS.next_multiple_of(LANES);
/// Derivatives of a row by everything but the picture: shading, poses of the knots it touches, each with
/// zeros up to whole lanes.
pub(crate) const REST: usize = POSES + (TOUCHED * DEGREES).next_multiple_of(LANES);

/// Measurements, ready to be fitted.
#[derive(Clone, Debug, Default)]
pub(crate) struct MeasurementRows {
    /// Where the stencil of a row begins in `stencil`; one more than rows.
    pub first: Vec<u32>,
    /// The first coefficient of a row's stencil, and its columns, a multiple of [`LANES`].
    pub corner: Vec<(u32, u32)>,
    /// Derivatives by coefficients, stencil after stencil, row-major, in units of their row: they are never
    /// negative.
    pub stencil: Vec<u16>,
    /// The unit of each row.
    pub unit: Vec<f32>,
    /// Measured values, DN above black.
    pub measured: Vec<f32>,
    /// Is it at least that much?
    pub is_saturated: Vec<bool>,
    /// Residuals, DN.
    pub residual: Vec<f32>,
    /// One over the standard deviation; 0 = left out.
    pub weight: Vec<f32>,
    /// The first knot that the exposure touches.
    pub knot: Vec<u32>,
    /// How many it touches.
    pub touched: Vec<u8>,
    /// Derivatives by the shading's terms; from [`POSES`] on by the poses of the knots: in units of their
    /// row.
    pub by_rest: Vec<[i16; REST]>,
    /// The unit of each row.
    pub rest_unit: Vec<f32>,
    /// The measured value above black, DN.
    pub signal: Vec<f32>,
    /// Which frame value it is: index as [frame][y][x].
    pub index: Vec<u32>,
    /// Before a still ground: the ground of each row, in units of the second half of the surface, which takes
    /// it off. Empty without one.
    pub behind: Vec<f32>,
}

impl MeasurementRows {
    /// Number of rows.
    pub(crate) fn count(&self) -> usize {
        self.residual.len()
    }

    /// Surfaces that rows depend on.
    pub(crate) fn layers(&self) -> usize {
        1 + usize::from(!self.behind.is_empty())
    }

    /// Corner, columns and stencil of row r.
    #[inline]
    pub(crate) fn line(&self, r: usize) -> (usize, usize, &[u16]) {
        let (corner, columns) = self.corner[r];
        (corner as usize, columns as usize, &self.stencil[self.first[r] as usize..self.first[r + 1] as usize])
    }

    /// Takes a stencil in, whose lines have `columns`.
    pub(crate) fn push_stencil(&mut self, corner: u32, columns: u32, stencil: &[f32]) {
        let most = stencil.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
        let per = f32::from(u16::MAX) / most;
        self.stencil.extend(stencil.iter().map(|a| (a * per + 0.5) as u16));
        self.unit.push(most / f32::from(u16::MAX));
        self.corner.push((corner, columns));
        self.first.push(self.stencil.len() as u32);
    }

    /// Takes derivatives by shading and poses in.
    pub(crate) fn push_rest(&mut self, by_rest: &[f32; REST]) {
        let most = by_rest.iter().fold(f32::MIN_POSITIVE, |most, by| f32::max(most, by.abs()));
        let per = f32::from(i16::MAX) / most;
        self.by_rest.push(by_rest.map(|by| (by * per).round_ties_even() as i16));
        self.rest_unit.push(most / f32::from(i16::MAX));
    }

    /// Derivatives of row r by shading and poses.
    #[cfg(test)]
    pub(super) fn other_derivatives(&self, r: usize) -> [f32; REST] {
        self.by_rest[r].map(|by| f32::from(by) * self.rest_unit[r])
    }

    /// Numbers of the rest that the rows of a knot touch; none beyond the last knot and in the padding.
    pub(crate) fn indices(&self, knots: usize, knot: usize) -> [Option<usize>; REST] {
        std::array::from_fn(|n| match n.checked_sub(POSES) {
            Some(n) if n < TOUCHED * DEGREES => Some(knot * DEGREES + n).filter(|at| *at < knots * DEGREES),
            Some(_) => None,
            None => Some(n).filter(|term| *term < TERMS).map(|term| knots * DEGREES + term),
        })
    }

    /// Ranges of rows that are summed one by one.
    pub(super) fn summing_ranges(&self) -> Vec<Range<usize>> {
        let parts = (self.count() / LEAST_ROWS).clamp(1, PARTS);
        let length = self.count().div_ceil(parts).max(1);
        (0..parts).map(|n| (n * length).min(self.count())..((n + 1) * length).min(self.count())).collect()
    }

    /// Rows of a range that touch the same knots, and how many numbers they have in addition to the picture.
    pub(super) fn same_knot_runs(&self, range: Range<usize>) -> impl Iterator<Item = (Range<usize>, usize)> {
        let mut at = range.start;
        std::iter::from_fn(move || {
            let begun = at;
            let of = |r: usize| (self.knot[r], self.touched[r]);
            while at < range.end && of(at) == of(begun) {
                at += 1;
            }
            (begun < at).then(|| {
                (begun..at, POSES + (usize::from(self.touched[begun]) * DEGREES).next_multiple_of(LANES))
            })
        })
    }

    /// Number of exposures of each coefficient's place among the fitted frame values: one that covers it
    /// throughout counts 1, one that passes less.
    pub(super) fn coverage(&self, grid: &SplineGrid) -> Vec<f32> {
        let mut coverage = vec![0.0; grid.coefficients()];
        // A frame spreads one value over each square pixel of the picture.
        let per_coefficient = (1.0 / (grid.pitch * grid.pitch)) as f32;
        for r in (0..self.count()).filter(|r| self.weight[*r] > 0.0) {
            let (corner, columns, stencil) = self.line(r);
            let all: f32 = stencil.iter().map(|a| f32::from(*a)).sum();
            for (j, line) in stencil.chunks_exact(columns).enumerate() {
                let there = &mut coverage[corner + j * grid.width..][..columns];
                there.iter_mut().zip(line).for_each(|(sum, a)| *sum += f32::from(*a) / all * per_coefficient);
            }
        }
        coverage
    }
}
