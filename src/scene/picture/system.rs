//! One sparse least-squares problem: coefficients of the picture, of its motion and of the shading that
//! explain frame values.
//!
//! Each row is the mean of the picture over one pixel's exposure: the stencils of all its instants are added
//! up first, so that a row costs as many products as it has coefficients. Conjugate gradients on the normal
//! equations, which are never formed (CGLS; Björck 1996, section 7.4), with the diagonal as preconditioner
//! for the picture and the Cholesky factor of their block for motion and shading. Sums are taken in fixed
//! parts: the same bytes for any number of threads.

use super::motion::DEGREES;
use super::products::{self, SmoothnessPull};
use super::rows::{MeasurementRows, REST};
use super::shading::TERMS;
use super::spline::{ORDER, SplineGrid};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use photocurrent_core::random::Random;
use rayon::prelude::*;
use std::ops::Range;

/// The unknowns of a picture, or a step of them.
#[derive(Clone, Debug, Default)]
pub(crate) struct PictureUnknowns {
    /// Coefficients of the picture; behind them, before a still ground, of how much of the ground it hides.
    pub picture: Vec<f32>,
    /// Six numbers for each knot, then the shading's terms.
    pub rest: Vec<f64>,
}

/// Weights of the second differences of the picture: one over their standard deviation.
#[derive(Clone, Debug, Default)]
pub(crate) struct Smoothness {
    /// Along x, at each coefficient.
    pub along_x: Vec<f32>,
    /// Along y.
    pub along_y: Vec<f32>,
    /// Of a change of the slope along x from row to row.
    pub across: Vec<f32>,
    /// One over the standard deviation of a step of each of the rest; 0 = fixed.
    pub rest: Vec<f64>,
    /// One over the standard deviation of each of the rest from zero; 0 = anything.
    pub rest_size: Vec<f64>,
    /// Weight of second differences of the motion's coefficients.
    pub motion: f64,
}

impl MeasurementRows {
    /// Residuals of another surface under the same motion and shading.
    pub(crate) fn update_residuals(&mut self, grid: &SplineGrid, surface: &[f32]) {
        let parts: Vec<Vec<f32>> = self
            .summing_ranges()
            .into_par_iter()
            .map(|range| {
                let mut signal = vec![0.0; range.len()];
                products::directional_derivatives(self, grid.width, surface, range, &mut signal);
                signal
            })
            .collect();
        self.residual.clear();
        self.residual
            .extend(parts.iter().flatten().zip(&self.measured).map(|(signal, measured)| measured - signal));
        self.residual
            .iter_mut()
            .zip(&self.is_saturated)
            .filter(|(_, is)| **is)
            .for_each(|(residual, _)| *residual = residual.max(0.0));
    }
}

/// Room for the sums of each part.
struct RangeSums {
    parts: Vec<(Range<usize>, PictureUnknowns)>,
}

impl RangeSums {
    fn new(rows: &MeasurementRows, grid: &SplineGrid, knots: usize) -> RangeSums {
        let blank = || PictureUnknowns {
            picture: vec![0.0; rows.layers() * grid.coefficients()],
            rest: vec![0.0; knots * DEGREES + TERMS],
        };
        RangeSums { parts: rows.summing_ranges().into_iter().map(|range| (range, blank())).collect() }
    }

    /// `of` for each part, and the sum of all in `out`.
    fn add_up(&mut self, out: &mut PictureUnknowns, of: impl Fn(Range<usize>, &mut PictureUnknowns) + Sync) {
        let part = |(range, sum): &mut (Range<usize>, PictureUnknowns)| {
            sum.picture.fill(0.0);
            sum.rest.fill(0.0);
            of(range.clone(), sum);
        };
        match &mut self.parts[..] {
            [one] => part(one),
            parts => parts.par_iter_mut().for_each(part),
        }
        let (first, others) = self.parts.split_first().expect("there is a part");
        out.picture.copy_from_slice(&first.1.picture);
        out.rest.copy_from_slice(&first.1.rest);
        for (_, part) in others {
            out.picture.iter_mut().zip(&part.picture).for_each(|(a, b)| *a += b);
            out.rest.iter_mut().zip(&part.rest).for_each(|(a, b)| *a += b);
        }
    }

    /// Adds up all rows, each times its factor and, with a step, its derivative along it.
    fn transposed(
        &mut self,
        rows: &MeasurementRows,
        grid: &SplineGrid,
        knots: usize,
        with_rest: bool,
        step: Option<&PictureUnknowns>,
        factor: &[f32],
        out: &mut PictureUnknowns,
    ) {
        self.add_up(out, |range, sum| {
            for (run, rest) in rows.same_knot_runs(range) {
                let rest = if with_rest { rest } else { 0 };
                let indices = rows.indices(knots, rows.knot[run.start] as usize);
                let along: [f32; REST] =
                    indices.map(|at| at.zip(step).map_or(0.0, |(at, step)| step.rest[at] as f32));
                let mut of_rest = [0.0_f32; REST];
                let step = step.map(|step| (&step.picture[..], &along));
                products::transposed(
                    rows,
                    grid.width,
                    run,
                    step,
                    rest,
                    factor,
                    &mut sum.picture,
                    &mut of_rest,
                );
                indices[..rest]
                    .iter()
                    .zip(of_rest)
                    .filter_map(|(at, of)| Some(((*at)?, of)))
                    .for_each(|(at, of)| sum.rest[at] += f64::from(of));
            }
        });
    }
}

/// The differences that are held small: indices of the coefficients with their factors, and the weight.
fn differences(grid: &SplineGrid, smooth: &Smoothness, mut with: impl FnMut([usize; 4], [f32; 4], f32)) {
    let w = grid.width;
    let layers = smooth.along_x.len() / grid.coefficients().max(1);
    for (layer, j) in (0..layers).flat_map(|layer| (0..grid.height).map(move |j| (layer, j))) {
        for i in 0..w {
            let at = layer * grid.coefficients() + j * w + i;
            if i > 0 && i + 1 < w {
                with([at - 1, at, at + 1, at], [1.0, -2.0, 1.0, 0.0], smooth.along_x[at]);
            }
            if j > 0 && j + 1 < grid.height {
                with([at - w, at, at + w, at], [1.0, -2.0, 1.0, 0.0], smooth.along_y[at]);
            }
            if i + 1 < w && j + 1 < grid.height {
                with([at, at + 1, at + w, at + w + 1], [1.0, -1.0, -1.0, 1.0], smooth.across[at]);
            }
        }
    }
}

fn motion_differences(knots: usize, mut with: impl FnMut(usize, usize, usize)) {
    for k in 1..knots.saturating_sub(1) {
        for d in 0..DEGREES {
            with((k - 1) * DEGREES + d, k * DEGREES + d, (k + 1) * DEGREES + d);
        }
    }
}

/// Squares of the weighted differences.
pub(crate) fn roughness(grid: &SplineGrid, smooth: &Smoothness, picture: &[f32]) -> f64 {
    let mut sum = 0.0;
    differences(grid, smooth, |at, by, weight| {
        let value: f32 = at.iter().zip(by).map(|(&at, by)| by * picture[at]).sum();
        sum += f64::from(weight * value) * f64::from(weight * value);
    });
    sum
}

/// The step that lessens the sum of squares most: residuals of the rows, roughness of `now` plus the step.
///
/// `with_rest`: motion and shading move too. `steps`: conjugate gradients at most.
pub(crate) fn solve(
    rows: &MeasurementRows,
    grid: &SplineGrid,
    smooth: &Smoothness,
    now: &PictureUnknowns,
    knots: usize,
    with_rest: bool,
    steps: usize,
) -> PictureUnknowns {
    let mut normal = NormalOperator::new(rows, grid, smooth, knots, with_rest);
    let mut residual = normal.blank();
    let factor: Vec<f32> =
        normal.squares.iter().zip(&rows.residual).map(|(square, residual)| square * residual).collect();
    normal.sums.transposed(rows, grid, knots, with_rest, None, &factor, &mut residual);
    let mut held = normal.blank();
    normal.pull(now, &mut held);
    add(&mut residual, -1.0, &held);
    normal.conjugate_gradients(residual, steps)
}

/// A step of the picture from its residuals without the smoothness term, which restores part of the detail
/// that smoothness removed (twicing; Tukey, Exploratory Data Analysis, 1977; Osher et al., Multiscale
/// Modeling and Simulation 4, 2005). Motion and shading are fixed. `begin`: initial value, the step of the
/// time before; empty is zero.
pub(crate) fn twicing_step(
    rows: &MeasurementRows,
    grid: &SplineGrid,
    smooth: &Smoothness,
    knots: usize,
    steps: usize,
    begin: &[f32],
) -> Vec<f32> {
    let mut normal = NormalOperator::new(rows, grid, smooth, knots, false);
    let mut residual = normal.blank();
    let factor: Vec<f32> =
        normal.squares.iter().zip(&rows.residual).map(|(square, residual)| square * residual).collect();
    normal.sums.transposed(rows, grid, knots, false, None, &factor, &mut residual);
    let mut from = normal.blank();
    if !begin.is_empty() {
        from.picture.copy_from_slice(begin);
        let mut product = normal.blank();
        normal.product(&from, &mut product);
        add(&mut residual, -1.0, &product);
    }
    let step = normal.conjugate_gradients(residual, steps);
    add(&mut from, 1.0, &step);
    from.picture
}

/// A random departure of the picture that measurements and smoothness leave open: a draw of a Gaussian with
/// the posterior's covariance, motion and shading held.
///
/// By perturbation: random residuals with the noise of each row and random differences with the variance of
/// each weight, fitted (Papandreou and Yuille, NIPS 2010).
pub(crate) fn posterior_draw(
    rows: &MeasurementRows,
    grid: &SplineGrid,
    smooth: &Smoothness,
    knots: usize,
    steps: usize,
    random: &mut Random,
) -> Vec<f32> {
    let mut normal = NormalOperator::new(rows, grid, smooth, knots, false);
    let mut residual = normal.blank();
    let noise: Vec<f32> = rows.weight.iter().map(|weight| weight * random.normal() as f32).collect();
    normal.sums.transposed(rows, grid, knots, false, None, &noise, &mut residual);
    differences(grid, smooth, |at, by, weight| {
        let noise = weight * random.normal() as f32;
        at.iter().zip(by).for_each(|(&at, by)| residual.picture[at] += by * noise);
    });
    normal.conjugate_gradients(residual, steps).picture
}

/// The normal equations as a linear operator.
struct NormalOperator<'a> {
    rows: &'a MeasurementRows,
    grid: &'a SplineGrid,
    smooth: &'a Smoothness,
    knots: usize,
    with_rest: bool,
    /// Squares of the rows' weights.
    squares: Vec<f32>,
    differences: SmoothnessPull,
    sums: RangeSums,
}

impl<'a> NormalOperator<'a> {
    fn new(
        rows: &'a MeasurementRows,
        grid: &'a SplineGrid,
        smooth: &'a Smoothness,
        knots: usize,
        with_rest: bool,
    ) -> NormalOperator<'a> {
        NormalOperator {
            rows,
            grid,
            smooth,
            knots,
            with_rest,
            squares: rows.weight.iter().map(|weight| weight * weight).collect(),
            differences: SmoothnessPull::new(&smooth.along_x, &smooth.along_y, &smooth.across),
            sums: RangeSums::new(rows, grid, knots),
        }
    }

    fn blank(&self) -> PictureUnknowns {
        PictureUnknowns {
            picture: vec![0.0; self.rows.layers() * self.grid.coefficients()],
            rest: vec![0.0; self.knots * DEGREES + TERMS],
        }
    }

    /// Adds the pull of smoothness, of the motion's smoothness and of sizes.
    fn pull(&self, x: &PictureUnknowns, out: &mut PictureUnknowns) {
        self.differences.add(self.grid, &x.picture, &mut out.picture);
        motion_differences(self.knots, |a, b, c| {
            let pull = self.smooth.motion * self.smooth.motion * (x.rest[a] - 2.0 * x.rest[b] + x.rest[c]);
            out.rest[a] += pull;
            out.rest[b] -= 2.0 * pull;
            out.rest[c] += pull;
        });
        out.rest
            .iter_mut()
            .zip(&x.rest)
            .zip(&self.smooth.rest_size)
            .for_each(|((out, x), hold)| *out += hold * hold * x);
    }

    fn product(&mut self, x: &PictureUnknowns, out: &mut PictureUnknowns) {
        self.sums.transposed(self.rows, self.grid, self.knots, self.with_rest, Some(x), &self.squares, out);
        self.pull(x, out);
        out.rest
            .iter_mut()
            .zip(&x.rest)
            .zip(&self.smooth.rest)
            .for_each(|((out, x), hold)| *out += hold * hold * x);
        self.zero_fixed(out);
    }

    /// Sets the steps of fixed unknowns to 0.
    fn zero_fixed(&self, x: &mut PictureUnknowns) {
        x.rest
            .iter_mut()
            .zip(&self.smooth.rest)
            .filter(|(_, hold)| !self.with_rest || **hold == 0.0)
            .for_each(|(x, _)| *x = 0.0);
    }

    fn conjugate_gradients(&mut self, mut residual: PictureUnknowns, steps: usize) -> PictureUnknowns {
        let precondition = Preconditioner::new(self);
        self.zero_fixed(&mut residual);
        let (mut step, mut z, mut product) = (self.blank(), self.blank(), self.blank());
        precondition.apply(&residual, &mut z);
        self.zero_fixed(&mut z);
        let mut direction = z.clone();
        let mut size = dot(&residual, &z);
        let begun = size;
        for _ in 0..steps {
            if size.is_nan() || size <= 1e-9 * begun {
                break;
            }
            self.product(&direction, &mut product);
            let share = size / dot(&direction, &product);
            if !share.is_finite() {
                break;
            }
            add(&mut step, share, &direction);
            add(&mut residual, -share, &product);
            precondition.apply(&residual, &mut z);
            self.zero_fixed(&mut z);
            let next = dot(&residual, &z);
            let by = next / size;
            direction.picture.iter_mut().zip(&z.picture).for_each(|(d, z)| *d = z + by as f32 * *d);
            direction.rest.iter_mut().zip(&z.rest).for_each(|(d, z)| *d = z + by * *d);
            size = next;
        }
        step
    }
}

struct Preconditioner {
    picture: Vec<f32>,
    rest: Option<Cholesky<f64, Dyn>>,
}

impl Preconditioner {
    fn new(of: &mut NormalOperator<'_>) -> Preconditioner {
        let mut sum = of.blank();
        let (rows, grid, squares) = (of.rows, of.grid, &of.squares);
        of.sums.add_up(&mut sum, |range, sum| {
            products::squares(rows, grid.width, range, squares, &mut sum.picture)
        });
        let mut picture = sum.picture;
        differences(grid, of.smooth, |at, by, weight| {
            at.iter().zip(by).for_each(|(&at, by)| picture[at] += by * by * weight * weight)
        });
        picture.iter_mut().for_each(|d| *d = if *d > 0.0 { 1.0 / *d } else { 0.0 });
        let rest = of.with_rest.then(|| block(of)).and_then(Cholesky::new);
        Preconditioner { picture, rest }
    }

    fn apply(&self, x: &PictureUnknowns, out: &mut PictureUnknowns) {
        out.picture.iter_mut().zip(&x.picture).zip(&self.picture).for_each(|((out, x), d)| *out = x * d);
        match &self.rest {
            Some(factor) => {
                out.rest.copy_from_slice(factor.solve(&DVector::from_column_slice(&x.rest)).as_slice())
            }
            None => out.rest.fill(0.0),
        }
    }
}

/// The block of the normal equations for motion and shading.
fn block(of: &NormalOperator<'_>) -> DMatrix<f64> {
    let NormalOperator { rows, smooth, knots, squares, .. } = of;
    let count = knots * DEGREES + TERMS;
    let parts: Vec<DMatrix<f64>> = rows
        .summing_ranges()
        .into_par_iter()
        .map(|range| {
            let mut sum = DMatrix::<f64>::zeros(count, count);
            for (run, rest) in rows.same_knot_runs(range) {
                let indices = rows.indices(*knots, rows.knot[run.start] as usize);
                let mut of_run = [[0.0_f32; REST]; REST];
                products::other_products(rows, run, rest, squares, &mut of_run);
                for (a, of_run) in indices.iter().zip(&of_run) {
                    for (b, of_both) in indices.iter().zip(of_run) {
                        if let (Some(a), Some(b)) = (*a, *b)
                            && b <= a
                        {
                            sum[(a, b)] += f64::from(*of_both);
                        }
                    }
                }
            }
            sum
        })
        .collect();
    let mut sum = DMatrix::<f64>::zeros(count, count);
    parts.iter().for_each(|part| sum += part);
    let square = smooth.motion * smooth.motion;
    motion_differences(*knots, |a, b, c| {
        for (m, fm) in [(a, 1.0), (b, -2.0), (c, 1.0)] {
            for (n, fn_) in [(a, 1.0), (b, -2.0), (c, 1.0)] {
                if n <= m {
                    sum[(m, n)] += square * fm * fn_;
                }
            }
        }
    });
    for n in 0..count {
        let hold = smooth.rest[n];
        if hold == 0.0 {
            for m in 0..count {
                sum[(n.max(m), n.min(m))] = 0.0;
            }
            sum[(n, n)] = 1.0;
        } else {
            sum[(n, n)] += hold * hold + smooth.rest_size[n] * smooth.rest_size[n] + 1e-12;
        }
        for m in 0..n {
            sum[(m, n)] = sum[(n, m)];
        }
    }
    sum
}

fn dot(a: &PictureUnknowns, b: &PictureUnknowns) -> f64 {
    products::dot(&a.picture, &b.picture) + a.rest.iter().zip(&b.rest).map(|(a, b)| a * b).sum::<f64>()
}

/// `x += by * step`.
pub(crate) fn add(x: &mut PictureUnknowns, by: f64, step: &PictureUnknowns) {
    x.picture.iter_mut().zip(&step.picture).for_each(|(x, step)| *x += by as f32 * step);
    x.rest.iter_mut().zip(&step.rest).for_each(|(x, step)| *x += by * step);
}

/// Adds the weights of one instant to a stencil of `columns` columns whose corner is (`i0`, `j0`).
#[inline]
pub(crate) fn stamp(
    stencil: &mut [f32],
    columns: usize,
    corner: (usize, usize),
    at: (usize, usize),
    wx: &[f64; ORDER],
    wy: &[f64; ORDER],
    share: f64,
) {
    let (di, dj) = (at.0 - corner.0, at.1 - corner.1);
    for (row, wy) in wy.iter().enumerate() {
        let line = &mut stencil[(dj + row) * columns + di..][..ORDER];
        line.iter_mut().zip(wx).for_each(|(a, wx)| *a += (share * wy * wx) as f32);
    }
}

#[cfg(test)]
#[path = "system_tests.rs"]
mod tests;
