//! Kernels of the conjugate gradients: products of rows with steps, sums of rows, and the smoothness term.
//!
//! Sums are taken in [`LANES`] side by side, and nothing is contracted: the same bits on every processor.

use super::motion::{AffineMap, apply};
use super::rows::{LANES, MeasurementRows, REST};
use super::spline::SplineGrid;
use multiversion::multiversion;
use photocurrent_sensor::elementary::ln;
use std::ops::Range;

/// Sum of side-by-side sums, in a fixed order.
#[inline(always)]
fn lane_sum(sum: [f32; LANES]) -> f32 {
    let [a, b, c, d, e, f, g, h] = sum;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

/// Lines of a stencil with the coefficients below them: `with(line's lanes, place)`.
#[inline(always)]
fn lanes(
    corner: usize,
    columns: usize,
    width: usize,
    stencil: &[u16],
    mut with: impl FnMut(&[u16; LANES], usize),
) {
    if columns == LANES {
        for (j, line) in stencil.as_chunks::<LANES>().0.iter().enumerate() {
            with(line, corner + j * width);
        }
        return;
    }
    for (j, line) in stencil.chunks_exact(columns).enumerate() {
        for (n, lanes) in line.as_chunks::<LANES>().0.iter().enumerate() {
            with(lanes, corner + j * width + n * LANES);
        }
    }
}

#[inline(always)]
fn along_row(rows: &MeasurementRows, width: usize, picture: &[f32], r: usize) -> f32 {
    let (corner, columns, stencil) = rows.line(r);
    let mut sum = [0.0_f32; LANES];
    lanes(corner, columns, width, stencil, |line, at| {
        let under: &[f32] = &picture[at..at + LANES];
        for lane in 0..LANES {
            sum[lane] += f32::from(line[lane]) * under[lane];
        }
    });
    let mut joint = lane_sum(sum);
    if let Some(behind) = rows.behind.get(r) {
        let half = picture.len() / 2;
        let mut sum = [0.0_f32; LANES];
        lanes(corner, columns, width, stencil, |line, at| {
            let under: &[f32] = &picture[half + at..half + at + LANES];
            for lane in 0..LANES {
                sum[lane] += f32::from(line[lane]) * under[lane];
            }
        });
        joint -= behind * lane_sum(sum);
    }
    rows.unit[r] * joint
}

/// Derivatives of rows along a step of the picture.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub fn directional_derivatives(
    rows: &MeasurementRows,
    width: usize,
    picture: &[f32],
    range: Range<usize>,
    out: &mut [f32],
) {
    for (r, out) in range.zip(out) {
        *out = along_row(rows, width, picture, r);
    }
}

/// Adds rows of one run, each times its factor and, with a step, its derivative along it. Of everything but
/// the picture, the first `rest` numbers take part.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub fn transposed(
    rows: &MeasurementRows,
    width: usize,
    run: Range<usize>,
    step: Option<(&[f32], &[f32; REST])>,
    rest: usize,
    factor: &[f32],
    sum: &mut [f32],
    of_rest: &mut [f32; REST],
) {
    for r in run {
        let mut value = factor[r];
        let by_rest: &[i16] = if rest > 0 { &rows.by_rest[r][..rest] } else { &[] };
        if let Some((picture, along)) = step {
            let mut derivative = along_row(rows, width, picture, r);
            if rest > 0 {
                let mut sum = [0.0_f32; LANES];
                for (a, b) in by_rest.as_chunks::<LANES>().0.iter().zip(along.as_chunks::<LANES>().0) {
                    for lane in 0..LANES {
                        sum[lane] += f32::from(a[lane]) * b[lane];
                    }
                }
                derivative += rows.rest_unit[r] * lane_sum(sum);
            }
            value *= derivative;
        }
        let (corner, columns, stencil) = rows.line(r);
        let by = value * rows.unit[r];
        lanes(corner, columns, width, stencil, |line, at| {
            let under: &mut [f32] = &mut sum[at..at + LANES];
            for lane in 0..LANES {
                under[lane] += by * f32::from(line[lane]);
            }
        });
        if let Some(behind) = rows.behind.get(r) {
            let (half, by) = (sum.len() / 2, -behind * by);
            lanes(corner, columns, width, stencil, |line, at| {
                let under: &mut [f32] = &mut sum[half + at..half + at + LANES];
                for lane in 0..LANES {
                    under[lane] += by * f32::from(line[lane]);
                }
            });
        }
        if rest > 0 {
            let by = value * rows.rest_unit[r];
            of_rest.iter_mut().zip(by_rest).for_each(|(sum, a)| *sum += by * f32::from(*a));
        }
    }
}

/// Adds the squares of rows, each times its factor: the diagonal of the picture's block.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub fn squares(rows: &MeasurementRows, width: usize, range: Range<usize>, factor: &[f32], sum: &mut [f32]) {
    for r in range {
        let (corner, columns, stencil) = rows.line(r);
        let by = factor[r] * rows.unit[r] * rows.unit[r];
        lanes(corner, columns, width, stencil, |line, at| {
            let under: &mut [f32] = &mut sum[at..at + LANES];
            for lane in 0..LANES {
                let a = f32::from(line[lane]);
                under[lane] += by * a * a;
            }
        });
        if let Some(behind) = rows.behind.get(r) {
            let (half, by) = (sum.len() / 2, behind * behind * by);
            lanes(corner, columns, width, stencil, |line, at| {
                let under: &mut [f32] = &mut sum[half + at..half + at + LANES];
                for lane in 0..LANES {
                    let a = f32::from(line[lane]);
                    under[lane] += by * a * a;
                }
            });
        }
    }
}

/// Adds the weighted products of the rows' derivatives by the other unknowns, over one run: the first `rest`
/// numbers.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub fn other_products(
    rows: &MeasurementRows,
    run: Range<usize>,
    rest: usize,
    factor: &[f32],
    sum: &mut [[f32; REST]; REST],
) {
    for r in run {
        let by_rest = rows.by_rest[r].map(f32::from);
        let by_rest = &by_rest[..rest];
        let unit = factor[r] * rows.rest_unit[r] * rows.rest_unit[r];
        for (sum, a) in sum.iter_mut().zip(by_rest) {
            let by = unit * a;
            sum[..rest].iter_mut().zip(by_rest).for_each(|(sum, b)| *sum += by * b);
        }
    }
}

/// Squares of the weights of second differences.
pub(super) struct SmoothnessPull {
    along_x: Vec<f32>,
    along_y: Vec<f32>,
    across: Vec<f32>,
}

impl SmoothnessPull {
    /// Of weights.
    pub(super) fn new(along_x: &[f32], along_y: &[f32], across: &[f32]) -> SmoothnessPull {
        let squares = |weights: &[f32]| weights.iter().map(|w| w * w).collect();
        SmoothnessPull { along_x: squares(along_x), along_y: squares(along_y), across: squares(across) }
    }

    /// Adds the pull of smoothness.
    pub(super) fn add(&self, grid: &SplineGrid, picture: &[f32], out: &mut [f32]) {
        let count = grid.coefficients();
        for (layer, (picture, out)) in
            picture.chunks_exact(count).zip(out.chunks_exact_mut(count)).enumerate()
        {
            let of = layer * count..(layer + 1) * count;
            pull(
                [&self.along_x[of.clone()], &self.along_y[of.clone()], &self.across[of]],
                grid.width,
                grid.height,
                picture,
                out,
            );
        }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
fn pull(
    [along_x, along_y, across]: [&[f32]; 3],
    width: usize,
    height: usize,
    picture: &[f32],
    out: &mut [f32],
) {
    let line = |all: &[f32], j: usize| -> Range<usize> { j * width..((j + 1) * width).min(all.len()) };
    // What each difference pulls with, and nothing before the first one and behind the last one.
    let mut pulls = vec![0.0_f32; width + 2];
    for j in 0..height {
        let range = line(picture, j);
        let c = &picture[range.clone()];
        if width > 2 {
            let weights = &along_x[range.clone()];
            for i in 1..width - 1 {
                pulls[i + 1] = weights[i] * (c[i - 1] - 2.0 * c[i] + c[i + 1]);
            }
            (pulls[1], pulls[width]) = (0.0, 0.0);
            let (before, at, after) = (&pulls[..width], &pulls[1..=width], &pulls[2..]);
            let out = &mut out[range.clone()];
            for i in 0..width {
                out[i] += before[i] - 2.0 * at[i] + after[i];
            }
        }
        if j > 0 && j + 1 < height {
            let (up, down, weights) =
                (&picture[line(picture, j - 1)], &picture[line(picture, j + 1)], &along_y[range.clone()]);
            let (first, last) = out[(j - 1) * width..(j + 2) * width].split_at_mut(width);
            let (middle, last) = last.split_at_mut(width);
            for i in 0..width {
                let pull = weights[i] * (up[i] - 2.0 * c[i] + down[i]);
                first[i] += pull;
                middle[i] -= 2.0 * pull;
                last[i] += pull;
            }
        }
        if j + 1 < height && width > 1 {
            let (down, weights) = (&picture[line(picture, j + 1)], &across[range]);
            for i in 0..width - 1 {
                pulls[i + 1] = weights[i] * (c[i] - c[i + 1] - down[i] + down[i + 1]);
            }
            pulls[width] = 0.0;
            let (before, at) = (&pulls[..width], &pulls[1..=width]);
            let (upper, lower) = out[j * width..(j + 2) * width].split_at_mut(width);
            for i in 0..width {
                let pull = at[i] - before[i];
                upper[i] += pull;
                lower[i] -= pull;
            }
        }
    }
}

/// Sum of products.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub fn dot(a: &[f32], b: &[f32]) -> f64 {
    let mut sum = [0.0_f64; LANES];
    let ((a, a_end), (b, b_end)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for (a, b) in a.iter().zip(b) {
        for lane in 0..LANES {
            sum[lane] += f64::from(a[lane]) * f64::from(b[lane]);
        }
    }
    let end: f64 = a_end.iter().zip(b_end).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
    sum.iter().sum::<f64>() + end
}

/// Values of a surface where maps take a place; NaN outside of it.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub fn values(grid: &SplineGrid, surface: &[f32], maps: &[AffineMap], place: (f64, f64)) -> Vec<f64> {
    let mut values = Vec::with_capacity(maps.len());
    for map in maps {
        let (x, y) = apply(map, place.0, place.1);
        values.push(grid.value(surface, x, y).unwrap_or(f64::NAN));
    }
    values
}

/// Logarithms of values times a factor, `least` at least; NaN stays.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub fn logarithms(values: &mut [f64], factor: f64, least: f64) {
    for value in values {
        let log = ln(f64::max(*value * factor, least));
        *value = if value.is_nan() { f64::NAN } else { log };
    }
}
