//! The picture and the correction of its motion that explain frames best: one sparse least-squares problem.
//!
//! A frame value is the mean of the picture over the instants of its own row's exposure, and from one event of a pixel to its next the picture
//! becomes so many times as bright: both are linear in the picture's coefficients, and nearly so in the correction of the motion. The normal equations are never formed:
//! conjugate gradients on the rows (CGLS; Björck 1996, section 7.4), with the diagonal as preconditioner.

use super::grid::{Grid, Taps};
use super::pose::CORRECTIONS;

/// Measurements of the picture: row r is the sum over `taps[first[r]..first[r + 1]]`, each by its share.
#[derive(Clone, Debug, Default)]
pub(super) struct Rows {
    pub first: Vec<u32>,
    pub taps: Vec<Taps>,
    /// What each of the taps counts.
    pub share: Vec<f32>,
    /// What was measured.
    pub value: Vec<f32>,
    /// One over its standard deviation.
    pub weight: Vec<f32>,
    /// Derivatives by the corrections of the motion.
    pub by_motion: Vec<[f32; CORRECTIONS]>,
}

/// What is fitted.
#[derive(Clone, Debug, Default)]
pub(super) struct Unknowns {
    pub surface: Vec<f32>,
    pub motion: [f32; CORRECTIONS],
}

/// How the solution is held where nothing was measured.
#[derive(Clone, Copy, Debug)]
pub(super) struct Smoothness {
    /// One over the standard deviation of a second difference of coefficients.
    pub surface: f32,
    /// One over the standard deviation of a correction of the motion, pixels per millisecond.
    pub motion: f32,
}

impl Rows {
    pub fn len(&self) -> usize {
        self.value.len()
    }

    /// What the picture says of row r.
    pub fn predict(&self, grid: &Grid, unknowns: &Unknowns, r: usize) -> f32 {
        let sum: f32 = self.taps_of(r).map(|(taps, share)| share * grid.look(&unknowns.surface, taps.first, &taps.x, &taps.y)).sum();
        let moved: f32 = self.by_motion[r].iter().zip(&unknowns.motion).map(|(a, b)| a * b).sum();
        sum + moved
    }

    /// The places that row r saw, and what each counts.
    fn taps_of(&self, r: usize) -> impl Iterator<Item = (&Taps, f32)> {
        let range = self.first[r] as usize..self.first[r + 1] as usize;
        self.taps[range.clone()].iter().zip(self.share[range].iter().copied())
    }

    /// Adds the transposed of row r times `value`.
    fn spread(&self, grid: &Grid, into: &mut Unknowns, r: usize, value: f32) {
        for (taps, share) in self.taps_of(r) {
            grid.spread(&mut into.surface, taps, value * share);
        }
        for (into, by) in into.motion.iter_mut().zip(&self.by_motion[r]) {
            *into += value * by;
        }
    }

    /// How often each coefficient was measured by the first `count` rows.
    pub fn coverage(&self, grid: &Grid, count: usize) -> Vec<f32> {
        let mut sum = vec![0.0; grid.len()];
        for (taps, share) in (0..count).flat_map(|r| self.taps_of(r)) {
            grid.spread(&mut sum, taps, share);
        }
        sum
    }

    /// Forgets all rows.
    pub fn clear(&mut self) {
        let Rows { first, taps, share, value, weight, by_motion } = self;
        first.clear();
        first.push(0);
        taps.clear();
        share.clear();
        value.clear();
        weight.clear();
        by_motion.clear();
    }
}

/// Second differences along both axes: calls with three indices.
fn second_differences(grid: &Grid, mut with: impl FnMut(usize, usize, usize)) {
    for j in 0..grid.height {
        for i in 0..grid.width {
            let at = j * grid.width + i;
            if i > 0 && i + 1 < grid.width {
                with(at - 1, at, at + 1);
            }
            if j > 0 && j + 1 < grid.height {
                with(at - grid.width, at, at + grid.width);
            }
        }
    }
}

/// `A' A x` with all weights, and the smoothness.
fn normal(rows: &Rows, grid: &Grid, smooth: &Smoothness, x: &Unknowns, out: &mut Unknowns) {
    out.surface.fill(0.0);
    out.motion = [0.0; CORRECTIONS];
    for r in 0..rows.len() {
        let weight = rows.weight[r] * rows.weight[r];
        if weight > 0.0 {
            rows.spread(grid, out, r, weight * rows.predict(grid, x, r));
        }
    }
    let square = smooth.surface * smooth.surface;
    second_differences(grid, |a, b, c| {
        let pull = square * (x.surface[a] - 2.0 * x.surface[b] + x.surface[c]);
        out.surface[a] += pull;
        out.surface[b] -= 2.0 * pull;
        out.surface[c] += pull;
    });
    for (out, x) in out.motion.iter_mut().zip(&x.motion) {
        *out += smooth.motion * smooth.motion * x;
    }
}

fn dot(a: &Unknowns, b: &Unknowns) -> f64 {
    let sum = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
    sum(&a.surface, &b.surface) + sum(&a.motion, &b.motion)
}

/// `x += by * step`.
fn add(x: &mut Unknowns, by: f64, step: &Unknowns) {
    let by = by as f32;
    x.surface.iter_mut().zip(&step.surface).for_each(|(x, step)| *x += by * step);
    x.motion.iter_mut().zip(&step.motion).for_each(|(x, step)| *x += by * step);
}

/// Improves `unknowns` by `steps` conjugate gradients.
pub(super) fn improve(rows: &Rows, grid: &Grid, smooth: &Smoothness, unknowns: &mut Unknowns, steps: usize) {
    let zeros = || Unknowns { surface: vec![0.0; grid.len()], motion: [0.0; CORRECTIONS] };
    // The diagonal: sums of squares of the rows' entries (taps of one row that overlap count apart, which is close enough).
    let mut diagonal = zeros();
    for r in 0..rows.len() {
        let weight = rows.weight[r] * rows.weight[r];
        for (taps, share) in rows.taps_of(r) {
            let squares = Taps { first: taps.first, x: taps.x.map(|w| w * w), y: taps.y.map(|w| w * w) };
            grid.spread(&mut diagonal.surface, &squares, weight * share.abs());
        }
        for (into, by) in diagonal.motion.iter_mut().zip(&rows.by_motion[r]) {
            *into += weight * by * by;
        }
    }
    let least = 6.0 * smooth.surface * smooth.surface;
    diagonal.surface.iter_mut().for_each(|d| *d = 1.0 / (*d + least));
    diagonal.motion.iter_mut().for_each(|d| *d = 1.0 / (*d + smooth.motion * smooth.motion));
    let preconditioned = |r: &Unknowns| Unknowns {
        surface: r.surface.iter().zip(&diagonal.surface).map(|(r, d)| r * d).collect(),
        motion: std::array::from_fn(|k| r.motion[k] * diagonal.motion[k]),
    };

    let mut product = zeros();
    let mut residual = zeros();
    normal(rows, grid, smooth, unknowns, &mut product);
    for r in 0..rows.len() {
        let weight = rows.weight[r] * rows.weight[r];
        rows.spread(grid, &mut residual, r, weight * rows.value[r]);
    }
    add(&mut residual, -1.0, &product);
    let mut z = preconditioned(&residual);
    let mut direction = z.clone();
    let mut size = dot(&residual, &z);
    let begun = size;
    for _step in 0..steps {
        if size.is_nan() || size <= 1e-10 * begun {
            break;
        }
        normal(rows, grid, smooth, &direction, &mut product);
        let share = size / dot(&direction, &product);
        if !share.is_finite() {
            break;
        }
        add(unknowns, share, &direction);
        add(&mut residual, -share, &product);
        z = preconditioned(&residual);
        let next = dot(&residual, &z);
        let mut turned = z.clone();
        add(&mut turned, next / size, &direction);
        direction = turned;
        size = next;
    }
}
