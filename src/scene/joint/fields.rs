//! The fields of a joint picture on its grid: the picture and, before a still ground, its opacity. At one
//! place their coefficients are adjacent among the unknowns, as measurements couple them.

use super::super::picture::spline::SplineGrid;
use crate::picture::ScenePicture;

/// Fields on a grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct GridFields {
    pub grid: SplineGrid,
    /// 1, or 2 before a still ground.
    pub count: usize,
}

impl GridFields {
    pub(super) fn from_picture(picture: &ScenePicture) -> GridFields {
        GridFields { grid: picture.grid, count: if picture.ground.is_empty() { 1 } else { 2 } }
    }

    /// Number of coefficients of all fields.
    pub(super) fn coefficients(&self) -> usize {
        self.count * self.grid.coefficients()
    }

    /// Unknowns in a line of the grid.
    pub(super) fn width(&self) -> usize {
        self.count * self.grid.width
    }

    /// The unknown that coefficient `k` of a field is.
    pub(super) fn unknown(&self, field: usize, k: usize) -> usize {
        self.count * k + field
    }

    /// Values of a picture, field after field, in the order of unknowns.
    pub(super) fn unknowns(&self, surface: &[f32]) -> Vec<f64> {
        let of_each = self.grid.coefficients();
        let at = |n: usize| f64::from(surface[n % self.count * of_each + n / self.count]);
        (0..surface.len()).map(at).collect()
    }

    /// A step of all unknowns, field after field; the rest behind them as it is.
    pub(super) fn by_field(&self, step: &[f64]) -> Vec<f64> {
        let of_each = self.grid.coefficients();
        let (picture, rest) = step.split_at(self.coefficients());
        let of = |n: usize| picture[self.unknown(n / of_each, n % of_each)];
        (0..picture.len()).map(of).chain(rest.iter().copied()).collect()
    }
}
