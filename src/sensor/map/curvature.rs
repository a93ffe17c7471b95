//! The curvature of all later measurements by the states: what posterior variances are made of.
//!
//! Where only some lanes do a step, `chosen` gives of two numbers, with the step and without, that of each
//! lane.

use super::state::{Transition, each_state};
use crate::scalar::Scalar;

/// All of the matrix.
#[derive(Clone, Copy, Debug)]
pub(super) struct Curvature<T, const N: usize>([[T; N]; N]);

impl<T: Scalar, const N: usize> Curvature<T, N> {
    /// Of no measurement yet.
    pub(super) fn new() -> Self {
        Curvature([[T::from_f64(0.0); N]; N])
    }

    /// Along a row of a covariance, from both sides.
    #[inline(always)]
    pub(super) fn along<const M: usize>(&self, row: &[T; M]) -> T {
        let mut sum = T::from_f64(0.0);
        each_state!(a in 0, N => sum = sum + row[a] * self.of_row(a, row));
        sum
    }

    #[inline(always)]
    fn of_row<const M: usize>(&self, a: usize, row: &[T; M]) -> T {
        let mut sum = T::from_f64(0.0);
        each_state!(b in 0, N => sum = sum + self.0[a][b] * row[b]);
        sum
    }

    /// `Lambda := H'H / S + (I - K H)' Lambda (I - K H)`, with H the sight of what was measured, K its gain
    /// and S the variance of its innovation.
    #[inline(always)]
    pub(super) fn untake<const M: usize>(&mut self, sight: &[T; N], gain: &[T; M], information: T) {
        let mut along = [T::from_f64(0.0); N];
        each_state!(a in 0, N => along[a] = self.of_row(a, gain));
        let mut both = T::from_f64(0.0);
        each_state!(a in 0, N => both = both + along[a] * gain[a]);
        let both = both + information;
        each_state!(a in 0, N => each_state!(b in 0, N => {
            let change = both * sight[a] * sight[b] - along[a] * sight[b] - sight[a] * along[b];
            self.0[a][b] = self.0[a][b] + change;
        }));
    }

    /// State `of` became zero.
    #[inline(always)]
    pub(super) fn forget(&mut self, of: usize, chosen: impl Fn(T, T) -> T) {
        let zero = T::from_f64(0.0);
        each_state!(a in 0, N => {
            self.0[a][of] = chosen(zero, self.0[a][of]);
            self.0[of][a] = chosen(zero, self.0[of][a]);
        });
    }

    /// Column and row `to` grow by `sign` times those of `of`.
    #[inline(always)]
    pub(super) fn add(&mut self, to: usize, of: usize, sign: T, chosen: impl Fn(T, T) -> T) {
        each_state!(a in 0, N => self.0[a][to] = chosen(self.0[a][to] + sign * self.0[a][of], self.0[a][to]));
        each_state!(a in 0, N => self.0[to][a] = chosen(self.0[to][a] + sign * self.0[of][a], self.0[to][a]));
    }

    /// `F' Lambda F`. Sums in another order made the matrix not quite symmetric: a lane without the step
    /// keeps its rows, and has no transpose.
    #[inline(always)]
    pub(super) fn unpredict(&mut self, f: &Transition<T>, chosen: impl Fn(T, T) -> T) {
        each_state!(a in 0, N => f.transposed(&mut self.0[a]));
        // The columns are done, now the rows, which are columns of the transpose.
        let half = self.0;
        each_state!(a in 0, N => {
            let mut column = [T::from_f64(0.0); N];
            each_state!(b in 0, N => column[b] = half[b][a]);
            f.transposed(&mut column);
            each_state!(b in 0, N => self.0[a][b] = chosen(column[b], half[a][b]));
        });
    }
}
