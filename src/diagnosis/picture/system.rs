//! One sparse least-squares problem: coefficients of the picture, of its motion and of the shading that explain frame values.
//!
//! Each row is the mean of the picture over one pixel's exposure: the stencils of all its instants are added up first, so that a row costs as many products as it has
//! coefficients. Conjugate gradients on the normal equations, which are never formed (CGLS; Björck 1996, section 7.4), with the diagonal as preconditioner for the picture
//! and the Cholesky factor of their block for motion and shading. Sums are taken in fixed parts: the same bytes for any number of threads.

use super::motion::DEGREES;
use super::shading::TERMS;
use super::spline::{Grid, ORDER};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use photocurrent_core::random::Random;
use rayon::prelude::*;

/// Knots that one exposure may touch.
pub const TOUCHED: usize = 6;
/// Parts in which sums over rows are taken.
const PARTS: usize = 8;
/// Lines of stencils are padded to a multiple of this, so that they are added up side by side.
pub const LANES: usize = 4;
/// Derivatives of a row by everything but the picture: poses of the knots it touches, shading, and zeros up to whole lanes.
pub const REST: usize = (TOUCHED * DEGREES + TERMS).next_multiple_of(LANES);

/// Measurements, ready to be fitted.
#[derive(Clone, Debug, Default)]
pub struct Rows {
    /// Where the stencil of a row begins in `stencil`; one more than rows.
    pub first: Vec<u32>,
    /// The first coefficient of a row's stencil, and its columns, a multiple of [`LANES`].
    pub corner: Vec<(u32, u32)>,
    /// Derivatives by coefficients, stencil after stencil, row-major.
    pub stencil: Vec<f32>,
    /// What is not yet explained, DN.
    pub residual: Vec<f32>,
    /// One over the standard deviation; 0 = left out.
    pub weight: Vec<f32>,
    /// The first knot that the exposure touches.
    pub knot: Vec<u32>,
    /// Derivatives by the poses of the knots from there on, then by the shading's terms.
    pub by_rest: Vec<[f32; REST]>,
    /// The measured value above black, DN.
    pub signal: Vec<f32>,
    /// Which frame value it is: index as [frame][y][x].
    pub index: Vec<u32>,
}

/// What is fitted, or a step of it.
#[derive(Clone, Debug, Default)]
pub struct Unknowns {
    /// Coefficients of the picture.
    pub picture: Vec<f32>,
    /// Six numbers for each knot, then the shading's terms.
    pub rest: Vec<f64>,
}

/// Weights of the second differences of the picture: one over their standard deviation.
#[derive(Clone, Debug, Default)]
pub struct Smoothness {
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

impl Rows {
    /// Number of rows.
    pub fn count(&self) -> usize {
        self.residual.len()
    }

    fn line(&self, r: usize) -> (usize, usize, &[f32]) {
        let (corner, columns) = self.corner[r];
        (corner as usize, columns as usize, &self.stencil[self.first[r] as usize..self.first[r + 1] as usize])
    }

    /// The derivative of row r along a step of the picture.
    #[inline]
    fn along(&self, grid: &Grid, picture: &[f32], r: usize) -> f32 {
        let (corner, columns, stencil) = self.line(r);
        let mut sum = [0.0_f32; LANES];
        for (j, line) in stencil.chunks_exact(columns).enumerate() {
            let at = corner + j * grid.width;
            dot_lanes(&mut sum, line, &picture[at..at + columns]);
        }
        sum.iter().sum()
    }

    /// Numbers of the rest that the rows of a knot touch; none beyond the last knot and in the padding.
    fn indices(&self, knots: usize, knot: usize) -> [Option<usize>; REST] {
        std::array::from_fn(|n| {
            if n < TOUCHED * DEGREES {
                Some(knot * DEGREES + n).filter(|at| *at < knots * DEGREES)
            } else {
                Some(n - TOUCHED * DEGREES).filter(|term| *term < TERMS).map(|term| knots * DEGREES + term)
            }
        })
    }

    fn parts(&self) -> Vec<std::ops::Range<usize>> {
        let length = self.count().div_ceil(PARTS).max(1);
        (0..PARTS).map(|n| (n * length).min(self.count())..((n + 1) * length).min(self.count())).collect()
    }

    /// Adds up `value(r, derivative of row r along a step)` times row r over all rows; without a step that derivative is zero.
    fn transposed(&self, grid: &Grid, knots: usize, with_rest: bool, step: Option<&Unknowns>, value: impl Fn(usize, f32) -> f32 + Sync) -> Unknowns {
        let count = knots * DEGREES + TERMS;
        let parts: Vec<Unknowns> = self
            .parts()
            .into_par_iter()
            .map(|range| {
                let mut sum = Unknowns { picture: vec![0.0; grid.coefficients()], rest: vec![0.0; count] };
                let rows: Vec<usize> = range.collect();
                // Rows of one knot stand together: the rest is gathered and added up once for all of them.
                for run in rows.chunk_by(|&a, &b| self.knot[a] == self.knot[b]) {
                    let indices = self.indices(knots, self.knot[run[0]] as usize);
                    let along: [f32; REST] = indices.map(|at| at.zip(step).map_or(0.0, |(at, step)| step.rest[at] as f32));
                    let mut of_rest = [0.0_f32; REST];
                    for &r in run {
                        let mut derivative = step.map_or(0.0, |step| self.along(grid, &step.picture, r));
                        if with_rest && step.is_some() {
                            let mut lanes = [0.0_f32; LANES];
                            dot_lanes(&mut lanes, &self.by_rest[r], &along);
                            derivative += lanes.iter().sum::<f32>();
                        }
                        let value = value(r, derivative);
                        if value == 0.0 {
                            continue;
                        }
                        let (corner, columns, stencil) = self.line(r);
                        for (j, line) in stencil.chunks_exact(columns).enumerate() {
                            let at = corner + j * grid.width;
                            sum.picture[at..at + columns].iter_mut().zip(line).for_each(|(c, a)| *c += value * a);
                        }
                        if with_rest {
                            of_rest.iter_mut().zip(&self.by_rest[r]).for_each(|(sum, a)| *sum += value * a);
                        }
                    }
                    indices.iter().zip(of_rest).filter_map(|(at, of)| Some(((*at)?, of))).for_each(|(at, of)| sum.rest[at] += f64::from(of));
                }
                sum
            })
            .collect();
        let mut parts = parts.into_iter();
        let mut sum = parts.next().unwrap_or_default();
        for part in parts {
            sum.picture.iter_mut().zip(&part.picture).for_each(|(a, b)| *a += b);
            sum.rest.iter_mut().zip(&part.rest).for_each(|(a, b)| *a += b);
        }
        sum
    }
}

/// Adds products to side-by-side sums; both slices have whole lanes.
#[inline]
fn dot_lanes(sum: &mut [f32; LANES], a: &[f32], b: &[f32]) {
    for (a, b) in a.as_chunks::<LANES>().0.iter().zip(b.as_chunks::<LANES>().0) {
        for lane in 0..LANES {
            sum[lane] += a[lane] * b[lane];
        }
    }
}

/// The differences that are held small: indices of the coefficients with their factors, and the weight.
fn differences(grid: &Grid, smooth: &Smoothness, mut with: impl FnMut([usize; 4], [f32; 4], f32)) {
    let w = grid.width;
    for j in 0..grid.height {
        for i in 0..w {
            let at = j * w + i;
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
pub fn roughness(grid: &Grid, smooth: &Smoothness, picture: &[f32]) -> f64 {
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
pub fn solve(rows: &Rows, grid: &Grid, smooth: &Smoothness, now: &Unknowns, knots: usize, with_rest: bool, steps: usize) -> Unknowns {
    let mut residual = rows.transposed(grid, knots, with_rest, None, |r, _| rows.weight[r] * rows.weight[r] * rows.residual[r]);
    let mut held = Unknowns { picture: vec![0.0; grid.coefficients()], rest: vec![0.0; knots * DEGREES + TERMS] };
    pull(grid, smooth, knots, now, &mut held);
    add(&mut residual, -1.0, &held);
    conjugate_gradients(rows, grid, smooth, knots, with_rest, residual, steps)
}

/// The step of the picture that the residuals alone ask for, from where it stands: what smoothness took away, given back in part (twicing; Tukey, Exploratory Data Analysis, 1977;
/// Osher et al., Multiscale Modeling and Simulation 4, 2005). Motion and shading are held.
pub fn again(rows: &Rows, grid: &Grid, smooth: &Smoothness, knots: usize, steps: usize) -> Vec<f32> {
    let residual = rows.transposed(grid, knots, false, None, |r, _| rows.weight[r] * rows.weight[r] * rows.residual[r]);
    conjugate_gradients(rows, grid, smooth, knots, false, residual, steps).picture
}

/// A random departure of the picture that measurements and smoothness leave open: a draw of a Gaussian with the posterior's covariance, motion and shading held.
///
/// By perturbation: random residuals with the noise of each row and random differences with the variance of each weight, fitted (Papandreou and Yuille, NIPS 2010).
pub fn draw(rows: &Rows, grid: &Grid, smooth: &Smoothness, knots: usize, steps: usize, random: &mut Random) -> Vec<f32> {
    let noise: Vec<f32> = (0..rows.count()).map(|_| random.normal() as f32).collect();
    let mut residual = rows.transposed(grid, knots, false, None, |r, _| rows.weight[r] * noise[r]);
    differences(grid, smooth, |at, by, weight| {
        let noise = weight * random.normal() as f32;
        at.iter().zip(by).for_each(|(&at, by)| residual.picture[at] += by * noise);
    });
    conjugate_gradients(rows, grid, smooth, knots, false, residual, steps).picture
}

/// Adds the pull of smoothness, of the motion's smoothness and of sizes.
fn pull(grid: &Grid, smooth: &Smoothness, knots: usize, x: &Unknowns, out: &mut Unknowns) {
    differences(grid, smooth, |at, by, weight| {
        let value: f32 = at.iter().zip(by).map(|(&at, by)| by * x.picture[at]).sum();
        let pull = weight * weight * value;
        at.iter().zip(by).for_each(|(&at, by)| out.picture[at] += by * pull);
    });
    motion_differences(knots, |a, b, c| {
        let pull = smooth.motion * smooth.motion * (x.rest[a] - 2.0 * x.rest[b] + x.rest[c]);
        out.rest[a] += pull;
        out.rest[b] -= 2.0 * pull;
        out.rest[c] += pull;
    });
    out.rest.iter_mut().zip(&x.rest).zip(&smooth.rest_size).for_each(|((out, x), hold)| *out += hold * hold * x);
}

fn conjugate_gradients(rows: &Rows, grid: &Grid, smooth: &Smoothness, knots: usize, with_rest: bool, mut residual: Unknowns, steps: usize) -> Unknowns {
    let normal = |x: &Unknowns| {
        let mut out = rows.transposed(grid, knots, with_rest, Some(x), |r, derivative| rows.weight[r] * rows.weight[r] * derivative);
        pull(grid, smooth, knots, x, &mut out);
        out.rest.iter_mut().zip(&x.rest).zip(&smooth.rest).for_each(|((out, x), hold)| *out += hold * hold * x);
        out
    };
    let fixed = |x: &mut Unknowns| {
        x.rest.iter_mut().zip(&smooth.rest).filter(|(_, hold)| !with_rest || **hold == 0.0).for_each(|(x, _)| *x = 0.0);
    };
    let precondition = Preconditioner::new(rows, grid, smooth, knots, with_rest);
    fixed(&mut residual);
    let mut step = Unknowns { picture: vec![0.0; grid.coefficients()], rest: vec![0.0; knots * DEGREES + TERMS] };
    let mut z = precondition.apply(&residual);
    fixed(&mut z);
    let mut direction = z.clone();
    let mut size = dot(&residual, &z);
    let begun = size;
    for _ in 0..steps {
        if size.is_nan() || size <= 1e-9 * begun {
            break;
        }
        let mut product = normal(&direction);
        fixed(&mut product);
        let share = size / dot(&direction, &product);
        if !share.is_finite() {
            break;
        }
        add(&mut step, share, &direction);
        add(&mut residual, -share, &product);
        z = precondition.apply(&residual);
        fixed(&mut z);
        let next = dot(&residual, &z);
        let by = next / size;
        direction.picture.iter_mut().zip(&z.picture).for_each(|(d, z)| *d = z + by as f32 * *d);
        direction.rest.iter_mut().zip(&z.rest).for_each(|(d, z)| *d = z + by * *d);
        size = next;
    }
    step
}

struct Preconditioner {
    picture: Vec<f32>,
    rest: Option<Cholesky<f64, Dyn>>,
}

impl Preconditioner {
    fn new(rows: &Rows, grid: &Grid, smooth: &Smoothness, knots: usize, with_rest: bool) -> Preconditioner {
        let parts: Vec<Vec<f32>> = rows
            .parts()
            .into_par_iter()
            .map(|range| {
                let mut sum = vec![0.0_f32; grid.coefficients()];
                for r in range {
                    let weight = rows.weight[r] * rows.weight[r];
                    let (corner, columns, stencil) = rows.line(r);
                    for (j, line) in stencil.chunks_exact(columns).enumerate() {
                        let at = corner + j * grid.width;
                        sum[at..at + columns].iter_mut().zip(line).for_each(|(c, a)| *c += weight * a * a);
                    }
                }
                sum
            })
            .collect();
        let mut picture = vec![0.0_f32; grid.coefficients()];
        parts.iter().for_each(|part| picture.iter_mut().zip(part).for_each(|(a, b)| *a += b));
        differences(grid, smooth, |at, by, weight| at.iter().zip(by).for_each(|(&at, by)| picture[at] += by * by * weight * weight));
        picture.iter_mut().for_each(|d| *d = if *d > 0.0 { 1.0 / *d } else { 0.0 });
        let rest = with_rest.then(|| block(rows, smooth, knots)).and_then(Cholesky::new);
        Preconditioner { picture, rest }
    }

    fn apply(&self, x: &Unknowns) -> Unknowns {
        let picture = x.picture.iter().zip(&self.picture).map(|(x, d)| x * d).collect();
        let rest = match &self.rest {
            Some(factor) => factor.solve(&DVector::from_column_slice(&x.rest)).as_slice().to_vec(),
            None => vec![0.0; x.rest.len()],
        };
        Unknowns { picture, rest }
    }
}

/// The block of the normal equations for motion and shading.
fn block(rows: &Rows, smooth: &Smoothness, knots: usize) -> DMatrix<f64> {
    let count = knots * DEGREES + TERMS;
    let parts: Vec<DMatrix<f64>> = rows
        .parts()
        .into_par_iter()
        .map(|range| {
            let mut sum = DMatrix::<f64>::zeros(count, count);
            let mut entries: Vec<(usize, f64)> = Vec::new();
            for r in range.filter(|&r| rows.weight[r] > 0.0) {
                entries.clear();
                let indices = rows.indices(knots, rows.knot[r] as usize);
                let of_row = indices.iter().zip(&rows.by_rest[r]).filter(|(_, value)| **value != 0.0);
                entries.extend(of_row.filter_map(|(at, value)| Some(((*at)?, f64::from(*value) * f64::from(rows.weight[r])))));
                for (k, &(a, va)) in entries.iter().enumerate() {
                    for &(b, vb) in &entries[..=k] {
                        sum[(a, b)] += va * vb;
                    }
                }
            }
            sum
        })
        .collect();
    let mut sum = DMatrix::<f64>::zeros(count, count);
    parts.iter().for_each(|part| sum += part);
    let square = smooth.motion * smooth.motion;
    motion_differences(knots, |a, b, c| {
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

fn dot(a: &Unknowns, b: &Unknowns) -> f64 {
    let picture: f64 = a.picture.iter().zip(&b.picture).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
    picture + a.rest.iter().zip(&b.rest).map(|(a, b)| a * b).sum::<f64>()
}

/// `x += by * step`.
pub fn add(x: &mut Unknowns, by: f64, step: &Unknowns) {
    x.picture.iter_mut().zip(&step.picture).for_each(|(x, step)| *x += by as f32 * step);
    x.rest.iter_mut().zip(&step.rest).for_each(|(x, step)| *x += by * step);
}

/// Adds the weights of one instant to a stencil of `columns` columns whose corner is (`i0`, `j0`).
#[inline]
pub fn stamp(stencil: &mut [f32], columns: usize, corner: (usize, usize), at: (usize, usize), wx: &[f64; ORDER], wy: &[f64; ORDER], share: f64) {
    let (di, dj) = (at.0 - corner.0, at.1 - corner.1);
    for (row, wy) in wy.iter().enumerate() {
        let line = &mut stencil[(dj + row) * columns + di..][..ORDER];
        line.iter_mut().zip(wx).for_each(|(a, wx)| *a += (share * wy * wx) as f32);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    /// Rows that see four by four coefficients of a picture each, at random places, with random weights and shading.
    fn problem() -> (Rows, Grid, Smoothness, usize) {
        let mut random = Random::new(5, &[]);
        let grid = Grid { x0: 0.0, y0: 0.0, pitch: 1.0, width: 8, height: 6 };
        let knots = 7;
        let mut rows = Rows { first: vec![0], ..Rows::default() };
        for r in 0..90 {
            let (i, j) = ((random.uniform() * 4.9) as usize, (random.uniform() * 2.9) as usize);
            rows.stencil.extend((0..16).map(|_| random.normal() as f32));
            rows.first.push(rows.stencil.len() as u32);
            rows.corner.push(((j * grid.width + i) as u32, 4));
            rows.residual.push(random.normal() as f32);
            rows.weight.push(0.5 + random.uniform() as f32);
            rows.knot.push(r / 46);
            rows.by_rest.push(std::array::from_fn(|n| if n < TOUCHED * DEGREES + TERMS { random.normal() as f32 } else { 0.0 }));
        }
        let rest = knots * DEGREES + TERMS;
        let n = grid.coefficients();
        let smooth =
            Smoothness { along_x: vec![0.7; n], along_y: vec![0.9; n], across: vec![0.4; n], rest: vec![0.5; rest], rest_size: vec![0.3; rest], motion: 0.6 };
        (rows, grid, smooth, knots)
    }

    /// The same problem with all its rows written out, of measurements and of what is held small; and its right side.
    fn written_out(rows: &Rows, grid: &Grid, smooth: &Smoothness, knots: usize) -> (DMatrix<f64>, DVector<f64>) {
        let (n, rest) = (grid.coefficients(), knots * DEGREES + TERMS);
        let mut lines: Vec<(DVector<f64>, f64)> = Vec::new();
        for r in 0..rows.count() {
            let mut line = DVector::zeros(n + rest);
            let (corner, columns, stencil) = rows.line(r);
            for (k, a) in stencil.iter().enumerate() {
                line[corner + k / columns * grid.width + k % columns] = f64::from(*a);
            }
            let indices = rows.indices(knots, rows.knot[r] as usize);
            indices.iter().zip(&rows.by_rest[r]).for_each(|(at, a)| {
                if let Some(at) = at {
                    line[n + at] = f64::from(*a);
                }
            });
            let weight = f64::from(rows.weight[r]);
            lines.push((line * weight, f64::from(rows.residual[r]) * weight));
        }
        differences(grid, smooth, |at, by, weight| {
            let mut line = DVector::zeros(n + rest);
            at.iter().zip(by).for_each(|(&at, by)| line[at] += f64::from(by * weight));
            lines.push((line, 0.0));
        });
        motion_differences(knots, |a, b, c| {
            let mut line = DVector::zeros(n + rest);
            (line[n + a], line[n + b], line[n + c]) = (smooth.motion, -2.0 * smooth.motion, smooth.motion);
            lines.push((line, 0.0));
        });
        for k in 0..rest {
            for hold in [smooth.rest[k], smooth.rest_size[k]] {
                let mut line = DVector::zeros(n + rest);
                line[n + k] = hold;
                lines.push((line, 0.0));
            }
        }
        let mut normal = DMatrix::zeros(n + rest, n + rest);
        let mut right = DVector::zeros(n + rest);
        for (line, value) in &lines {
            normal += line * line.transpose();
            right += line * *value;
        }
        (normal, right)
    }

    #[test]
    fn the_step_is_that_of_all_rows_written_out() {
        let (rows, grid, smooth, knots) = problem();
        let (normal, right) = written_out(&rows, &grid, &smooth, knots);
        let exact = normal.cholesky().unwrap().solve(&right);
        let now = Unknowns { picture: vec![0.0; grid.coefficients()], rest: vec![0.0; knots * DEGREES + TERMS] };
        let found = solve(&rows, &grid, &smooth, &now, knots, true, 400);
        let all: Vec<f64> = found.picture.iter().map(|c| f64::from(*c)).chain(found.rest.iter().copied()).collect();
        all.iter().zip(exact.iter()).for_each(|(a, b)| assert!((a - b).abs() < 2e-3, "{a} is {b}"));
    }

    #[test]
    fn draws_have_the_covariance_that_is_left_open() {
        let (rows, grid, mut smooth, knots) = problem();
        smooth.rest = vec![0.0; knots * DEGREES + TERMS];
        let n = grid.coefficients();
        let (normal, _) = written_out(&rows, &grid, &smooth, knots);
        let open = normal.view((0, 0), (n, n)).clone_owned().cholesky().unwrap().inverse();
        let mut random = Random::new(9, &[]);
        const DRAWS: usize = 600;
        let mut squares = vec![0.0; n];
        for _ in 0..DRAWS {
            let one = draw(&rows, &grid, &smooth, knots, 200, &mut random);
            squares.iter_mut().zip(&one).for_each(|(sum, c)| *sum += f64::from(c * c) / DRAWS as f64);
        }
        // The mean over coefficients is good to a percent or two, each to a sixth (three standard deviations).
        let ratio: Vec<f64> = squares.iter().enumerate().map(|(k, square)| square / open[(k, k)]).collect();
        assert!((ratio.iter().sum::<f64>() / n as f64 - 1.0).abs() < 0.05, "{ratio:?}");
        assert!(ratio.iter().all(|ratio| (0.75..1.3).contains(ratio)), "{ratio:?}");
    }

    #[test]
    fn fitting_again_what_is_left_gives_back_what_smoothness_took() {
        let (mut rows, grid, smooth, knots) = problem();
        let mut random = Random::new(2, &[]);
        let truth: Vec<f32> = (0..grid.coefficients()).map(|_| random.normal() as f32).collect();
        rows.residual = (0..rows.count()).map(|r| rows.along(&grid, &truth, r)).collect();
        let far = |picture: &[f32]| picture.iter().zip(&truth).map(|(a, b)| (a - b) * (a - b)).sum::<f32>();
        let first = again(&rows, &grid, &smooth, knots, 200);
        rows.residual = (0..rows.count()).map(|r| rows.residual[r] - rows.along(&grid, &first, r)).collect();
        let second: Vec<f32> = again(&rows, &grid, &smooth, knots, 200).iter().zip(&first).map(|(a, b)| a + b).collect();
        assert!(far(&second) < 0.5 * far(&first), "{} and {}", far(&second), far(&first));
    }
}
