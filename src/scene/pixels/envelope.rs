//! Symmetric positive definite systems whose rows begin where their first unknown is: an envelope, and its
//! Cholesky factor, which fills nothing outside of it.
//!
//! Light of one pixel is a spline in time: frame values and second differences couple unknowns a few knots
//! apart, and an event couples those at its time with those at the time of its reference. So most rows are
//! short, and a factor costs the sum of their squares.
//!
//! Source: George and Liu, Computer Solution of Large Sparse Positive Definite Systems (1981), chapter 4.

/// A lower triangle by rows: row `k` holds its columns from `first[k]` to `k`.
#[derive(Clone, Debug, Default)]
pub(super) struct EnvelopeMatrix {
    first: Vec<usize>,
    /// Where the row's column 0 would be; may lie before the values.
    at: Vec<isize>,
    values: Vec<f64>,
}

impl EnvelopeMatrix {
    /// All zero; `first`: the first column of each row, at most the row itself.
    pub(super) fn reset(&mut self, first: &[usize]) {
        self.first.clear();
        self.first.extend_from_slice(first);
        self.at.clear();
        let mut end = 0;
        for (row, first) in first.iter().enumerate() {
            self.at.push(end as isize - *first as isize);
            end += row + 1 - first;
        }
        self.values.clear();
        self.values.resize(end, 0.0);
    }

    /// Number of unknowns.
    pub(super) fn len(&self) -> usize {
        self.first.len()
    }

    fn row(&self, row: usize) -> &[f64] {
        let end = (self.at[row] + row as isize) as usize;
        &self.values[end - (row - self.first[row])..=end]
    }

    /// Adds to an element inside the envelope, `column` at most `row`.
    #[inline]
    pub(super) fn add(&mut self, row: usize, column: usize, by: f64) {
        debug_assert!(self.first[row] <= column && column <= row);
        self.values[(self.at[row] + column as isize) as usize] += by;
    }

    /// Adds `weight` times the square of a row of a Jacobian that begins at column `from`.
    pub(super) fn add_square(&mut self, from: usize, row: &[f64], weight: f64) {
        for (i, a) in row.iter().enumerate().filter(|(_, a)| **a != 0.0) {
            let start = (self.at[from + i] + from as isize) as usize;
            let to = &mut self.values[start..=start + i];
            to.iter_mut().zip(row).for_each(|(to, b)| *to += weight * a * b);
        }
    }

    /// Replaces the matrix by its Cholesky factor; false where it is not positive definite to rounding.
    #[must_use]
    pub(super) fn factor(&mut self) -> bool {
        for row in 0..self.len() {
            let first = self.first[row];
            let begin = (self.at[row] + first as isize) as usize;
            let (before, of_row) = self.values.split_at_mut(begin);
            for column in first..row {
                let from = first.max(self.first[column]);
                let other = (self.at[column] + from as isize) as usize;
                let diagonal = (self.at[column] + column as isize) as usize;
                let sum = dot(&of_row[from - first..column - first], &before[other..diagonal]);
                of_row[column - first] = (of_row[column - first] - sum) / before[diagonal];
            }
            let of_row = &mut of_row[..=row - first];
            let (last, rest) = of_row.split_last_mut().expect("a row has its diagonal");
            let left = *last - dot(rest, rest);
            if left.is_nan() || left <= 1e-14 * *last {
                return false;
            }
            *last = left.sqrt();
        }
        true
    }

    /// Replaces a factor by the inverse of its matrix, of which the envelope alone is computed.
    ///
    /// Source: Takahashi, Fagan and Chen, Formation of a sparse bus impedance matrix and its application to
    /// short circuit study (1973).
    pub(super) fn invert(&mut self, room: &mut InverseRoom) {
        let count = self.len();
        let InverseRoom { factor, sum, rows } = room;
        sum.clear();
        sum.resize(count, 0.0);
        factor.clear();
        factor.resize(count, 0.0);
        for j in (0..count).rev() {
            rows.clear();
            rows.extend((j + 1..count).filter(|k| self.first[*k] <= j));
            let diagonal = self.values[(self.at[j] + j as isize) as usize];
            let Some(&last) = rows.last() else {
                self.values[(self.at[j] + j as isize) as usize] = 1.0 / (diagonal * diagonal);
                continue;
            };
            for k in rows.iter() {
                factor[*k] = self.values[(self.at[*k] + j as isize) as usize];
            }
            for k in rows.iter() {
                let begin = (self.at[*k] + j as isize + 1) as usize;
                let row = &self.values[begin..begin + k - j];
                let (own, before) = row.split_last().expect("a row has its diagonal");
                let with = factor[*k];
                sum[*k] += own * with + dot(before, &factor[j + 1..*k]);
                sum[j + 1..*k].iter_mut().zip(before).for_each(|(to, z)| *to += with * z);
            }
            let mut squares = 0.0;
            for k in rows.iter() {
                let z = -sum[*k] / diagonal;
                squares += factor[*k] * z;
                self.values[(self.at[*k] + j as isize) as usize] = z;
            }
            self.values[(self.at[j] + j as isize) as usize] = (1.0 / diagonal - squares) / diagonal;
            factor[j + 1..=last].fill(0.0);
            sum[j + 1..=last].fill(0.0);
        }
    }

    /// `r' A r` of a row that begins at column `from`; all pairs of its elements lie in the envelope.
    pub(super) fn square_of(&self, from: usize, row: &[f64]) -> f64 {
        let mut sum = 0.0;
        for (i, a) in row.iter().enumerate().filter(|(_, a)| **a != 0.0) {
            let start = (self.at[from + i] + from as isize) as usize;
            let values = &self.values[start..=start + i];
            sum += a * (2.0 * dot(&values[..i], &row[..i]) + values[i] * a);
        }
        sum
    }

    /// Solves `L x = b` in place, where `b` is zero before `from`; of a factor.
    pub(super) fn forward(&self, b: &mut [f64], from: usize) {
        for row in from..self.len() {
            let values = self.row(row);
            let first = self.first[row].max(from);
            let skip = first - self.first[row];
            let (last, rest) = values.split_last().expect("a row has its diagonal");
            b[row] = (b[row] - dot(&rest[skip..], &b[first..row])) / last;
        }
    }

    /// Solves `L' x = b` in place; of a factor.
    pub(super) fn backward(&self, b: &mut [f64]) {
        for row in (0..self.len()).rev() {
            let (last, rest) = self.row(row).split_last().expect("a row has its diagonal");
            let x = b[row] / last;
            b[row] = x;
            let to = &mut b[self.first[row]..row];
            to.iter_mut().zip(rest).for_each(|(to, value)| *to -= x * value);
        }
    }
}

/// Room for an inverse.
#[derive(Debug, Default)]
pub(super) struct InverseRoom {
    factor: Vec<f64>,
    sum: Vec<f64>,
    rows: Vec<usize>,
}

/// Of equal lengths, in eight sums, so that it is vectorised.
#[inline]
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    let (a_chunks, b_chunks) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f64 = a_chunks.remainder().iter().zip(b_chunks.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a_chunks.zip(b_chunks) {
        for lane in 0..8 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    rest + ((sums[0] + sums[4]) + (sums[1] + sums[5])) + ((sums[2] + sums[6]) + (sums[3] + sums[7]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    /// Rows of a Jacobian as they occur: bands, and pairs of bands far apart.
    fn rows() -> Vec<(usize, Vec<f64>)> {
        let mut rows: Vec<(usize, Vec<f64>)> =
            (0..18).map(|k| (k, vec![1.0, -2.0 + 0.1 * k as f64, 1.0])).collect();
        let mut far = vec![0.0; 13];
        (far[0], far[1], far[11], far[12]) = (-0.4, -0.6, 0.3, 0.7);
        rows.push((4, far));
        rows.extend((0..20).map(|k| (k, vec![0.3])));
        rows
    }

    fn envelope_and_dense() -> (EnvelopeMatrix, DMatrix<f64>) {
        let (rows, count) = (rows(), 20);
        let mut first: Vec<usize> = (0..count).collect();
        for (from, row) in &rows {
            for k in (0..row.len()).filter(|k| row[*k] != 0.0) {
                first[from + k] = first[from + k].min(*from);
            }
        }
        let (mut envelope, mut dense) = (EnvelopeMatrix::default(), DMatrix::zeros(count, count));
        envelope.reset(&first);
        for (n, (from, row)) in rows.iter().enumerate() {
            let weight = 1.0 + n as f64;
            envelope.add_square(*from, row, weight);
            for i in 0..row.len() {
                for j in 0..row.len() {
                    dense[(from + i, from + j)] += weight * row[i] * row[j];
                }
            }
        }
        (envelope, dense)
    }

    #[test]
    fn a_factor_solves_what_a_dense_one_solves() {
        let (mut envelope, dense) = envelope_and_dense();
        assert!(envelope.factor());
        let right = DVector::from_fn(20, |k, _| libm::sin(k as f64));
        let expected = dense.cholesky().unwrap().solve(&right);
        let mut x: Vec<f64> = right.iter().copied().collect();
        envelope.forward(&mut x, 0);
        envelope.backward(&mut x);
        x.iter().zip(expected.iter()).for_each(|(x, e)| assert!((x - e).abs() < 1e-11, "{x} is {e}"));
    }

    #[test]
    fn the_variance_of_a_row_is_that_of_a_dense_inverse() {
        let (mut envelope, dense) = envelope_and_dense();
        assert!(envelope.factor());
        envelope.invert(&mut InverseRoom::default());
        let inverse = dense.try_inverse().unwrap();
        for (from, row) in rows() {
            let mut column = vec![0.0; 20];
            column[from..from + row.len()].copy_from_slice(&row);
            let of_row = DVector::from_column_slice(&column);
            let expected = (of_row.transpose() * &inverse * &of_row)[(0, 0)];
            let found = envelope.square_of(from, &row);
            assert!((found - expected).abs() < 1e-12 * expected.max(1.0), "{found} is {expected}");
        }
    }

    #[test]
    fn what_is_not_positive_definite_is_refused() {
        let mut envelope = EnvelopeMatrix::default();
        envelope.reset(&[0, 0]);
        envelope.add_square(0, &[1.0, -1.0], 1.0);
        assert!(!envelope.factor());
    }
}
