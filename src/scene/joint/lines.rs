//! Rows of the joint problem: derivatives of each measurement by the picture and by the other unknowns.

use super::super::picture::rows::MeasurementRows;
use super::fields::GridFields;
use std::ops::Range;

/// Sparse rows: derivatives by coefficients of the picture, rising, and by motion and shading.
#[derive(Clone, Debug, Default)]
pub(super) struct SparseRows {
    first: Vec<usize>,
    at: Vec<u32>,
    by: Vec<f32>,
    rest_first: Vec<usize>,
    rest_at: Vec<u16>,
    rest_by: Vec<f32>,
}

impl SparseRows {
    pub(super) fn new() -> SparseRows {
        SparseRows { first: vec![0], rest_first: vec![0], ..SparseRows::default() }
    }

    pub(super) fn len(&self) -> usize {
        self.first.len() - 1
    }

    /// Rows of frame values, from the picture's own fit and in its order.
    pub(super) fn from_frame_rows(rows: &MeasurementRows, fields: &GridFields, knots: usize) -> SparseRows {
        let mut lines = SparseRows::new();
        for r in 0..rows.count() {
            let (corner, columns, stencil) = rows.line(r);
            // What is hidden of a still ground is missing.
            let behind = rows.behind.get(r).map(|behind| -behind);
            for (j, line) in stencil.chunks_exact(columns).enumerate() {
                for (i, value) in line.iter().enumerate().filter(|(_, value)| **value != 0) {
                    let k = corner + j * fields.grid.width + i;
                    for (field, share) in [Some(1.0), behind].into_iter().flatten().enumerate() {
                        lines.at.push(fields.unknown(field, k) as u32);
                        lines.by.push(share * f32::from(*value) * rows.unit[r]);
                    }
                }
            }
            let rest = rows.indices(knots, rows.knot[r] as usize);
            for (at, by) in rest.iter().zip(&rows.by_rest[r]).filter(|(_, by)| **by != 0) {
                if let Some(at) = at {
                    lines.rest_at.push(*at as u16);
                    lines.rest_by.push(f32::from(*by) * rows.rest_unit[r]);
                }
            }
            lines.end();
        }
        lines
    }

    /// Takes a row in: the difference of two, times a factor; an empty one where it takes no part.
    pub(super) fn push_difference(
        &mut self,
        (a, b): (&SparseDerivatives, &SparseDerivatives),
        by: f64,
        takes_part: bool,
    ) {
        if takes_part {
            difference(&a.of_picture, &b.of_picture, by as f32, &mut self.at, &mut self.by);
            difference(&a.of_rest, &b.of_rest, by as f32, &mut self.rest_at, &mut self.rest_by);
        }
        self.end();
    }

    fn end(&mut self) {
        self.first.push(self.at.len());
        self.rest_first.push(self.rest_at.len());
    }

    /// Rows of another list behind these.
    pub(super) fn extend(&mut self, other: &SparseRows) {
        let (begun, rest_begun) = (self.at.len(), self.rest_at.len());
        self.first.extend(other.first[1..].iter().map(|at| at + begun));
        self.rest_first.extend(other.rest_first[1..].iter().map(|at| at + rest_begun));
        self.at.extend_from_slice(&other.at);
        self.by.extend_from_slice(&other.by);
        self.rest_at.extend_from_slice(&other.rest_at);
        self.rest_by.extend_from_slice(&other.rest_by);
    }

    /// Derivatives of row `r` by the picture.
    pub(super) fn picture(&self, r: usize) -> (&[u32], &[f32]) {
        let of: Range<usize> = self.first[r]..self.first[r + 1];
        (&self.at[of.clone()], &self.by[of])
    }

    /// And by the rest.
    pub(super) fn other_derivatives(&self, r: usize) -> (&[u16], &[f32]) {
        let of: Range<usize> = self.rest_first[r]..self.rest_first[r + 1];
        (&self.rest_at[of.clone()], &self.rest_by[of])
    }

    /// Derivative of row `r` along a step of `picture` coefficients and of the rest behind them.
    pub(super) fn directional_derivative(&self, r: usize, step: &[f64], picture: usize) -> f64 {
        let (at, by) = self.picture(r);
        let (rest_at, rest_by) = self.other_derivatives(r);
        let of_picture: f64 = at.iter().zip(by).map(|(at, by)| f64::from(*by) * step[*at as usize]).sum();
        let of_rest: f64 = rest_at
            .iter()
            .zip(rest_by)
            .map(|(at, by)| f64::from(*by) * step[picture + usize::from(*at)])
            .sum();
        of_picture + of_rest
    }

    /// Adds row `r` times a factor to a vector of all unknowns.
    pub(super) fn add_row(&self, r: usize, factor: f64, to: &mut [f64], picture: usize) {
        let (at, by) = self.picture(r);
        at.iter().zip(by).for_each(|(at, by)| to[*at as usize] += factor * f64::from(*by));
        let (at, by) = self.other_derivatives(r);
        at.iter().zip(by).for_each(|(at, by)| to[picture + usize::from(*at)] += factor * f64::from(*by));
    }
}

/// Derivatives of one value by the unknowns of the picture and by the others.
#[derive(Clone, Debug, Default)]
pub(super) struct SparseDerivatives {
    pub of_picture: Vec<(u32, f32)>,
    pub of_rest: Vec<(u16, f32)>,
}

impl SparseDerivatives {
    /// Puts derivatives in order of their unknowns, those by one added up.
    pub(super) fn sum(&mut self) {
        sum(&mut self.of_picture);
        sum(&mut self.of_rest);
    }
}

fn sum<A: Ord + Copy>(row: &mut Vec<(A, f32)>) {
    row.sort_unstable_by_key(|(unknown, _)| *unknown);
    row.dedup_by(|next, sum| {
        let is_same = next.0 == sum.0;
        if is_same {
            sum.1 += next.1;
        }
        is_same
    });
}

/// Indices of unknowns, rising, with derivatives.
type SparseRow<A> = [(A, f32)];

/// Puts the difference of two ordered rows, times a factor, behind others.
fn difference<A: Ord + Copy>(
    a: &SparseRow<A>,
    b: &SparseRow<A>,
    by: f32,
    to: &mut Vec<A>,
    to_by: &mut Vec<f32>,
) {
    let (mut i, mut j) = (0, 0);
    while i < a.len() || j < b.len() {
        let (of_a, of_b) = (a.get(i), b.get(j));
        let unknown = match (of_a, of_b) {
            (Some(a), Some(b)) => a.0.min(b.0),
            (Some(one), None) | (None, Some(one)) => one.0,
            (None, None) => break,
        };
        let mut derivative = 0.0;
        if let Some(one) = of_a.filter(|one| one.0 == unknown) {
            derivative += one.1;
            i += 1;
        }
        if let Some(one) = of_b.filter(|one| one.0 == unknown) {
            derivative -= one.1;
            j += 1;
        }
        to.push(unknown);
        to_by.push(by * derivative);
    }
}
