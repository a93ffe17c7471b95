//! The solver of the picture against the same problem written out.

use super::*;
use crate::picture::rows::{LANES, POSES, TOUCHED};
use nalgebra::DMatrix;

/// Rows that see four by four coefficients of a picture each, at random places, with random weights and
/// shading. With `has_ground`, before a random ground.
fn problem(has_ground: bool) -> (MeasurementRows, SplineGrid, Smoothness, usize) {
    let mut random = Random::new(5, &[]);
    let grid = SplineGrid { x0: 0.0, y0: 0.0, pitch: 1.0, width: 16, height: 6 };
    let knots = 7;
    let mut rows = MeasurementRows { first: vec![0], ..MeasurementRows::default() };
    for r in 0..240 {
        let (i, j) = ((random.uniform() * 8.9) as usize, (random.uniform() * 2.9) as usize);
        let stencil: Vec<f32> =
            (0..4 * LANES).map(|n| if n % LANES < 4 { random.normal().abs() as f32 } else { 0.0 }).collect();
        rows.push_stencil((j * grid.width + i) as u32, LANES as u32, &stencil);
        rows.residual.push(random.normal() as f32);
        rows.weight.push(0.5 + random.uniform() as f32);
        rows.knot.push(r / 121);
        rows.touched.push(TOUCHED as u8);
        let is_there = |n: usize| n < TERMS || (POSES..POSES + TOUCHED * DEGREES).contains(&n);
        rows.push_rest(&std::array::from_fn(|n| if is_there(n) { random.normal() as f32 } else { 0.0 }));
        rows.behind.extend(has_ground.then(|| 0.5 + random.uniform() as f32));
    }
    let rest = knots * DEGREES + TERMS;
    let n = rows.layers() * grid.coefficients();
    let smooth = Smoothness {
        along_x: vec![0.7; n],
        along_y: vec![0.9; n],
        across: vec![0.4; n],
        rest: vec![0.5; rest],
        rest_size: vec![0.3; rest],
        motion: 0.6,
    };
    (rows, grid, smooth, knots)
}

/// The same problem with all its rows written out, of measurements and of what is held small; and its
/// right side.
fn written_out(
    rows: &MeasurementRows,
    grid: &SplineGrid,
    smooth: &Smoothness,
    knots: usize,
) -> (DMatrix<f64>, DVector<f64>) {
    let (n, rest) = (rows.layers() * grid.coefficients(), knots * DEGREES + TERMS);
    let mut lines: Vec<(DVector<f64>, f64)> = Vec::new();
    for r in 0..rows.count() {
        let mut line = DVector::zeros(n + rest);
        let (corner, columns, stencil) = rows.line(r);
        for (k, a) in stencil.iter().enumerate() {
            let at = corner + k / columns * grid.width + k % columns;
            line[at] = f64::from(*a) * f64::from(rows.unit[r]);
            if let Some(behind) = rows.behind.get(r) {
                line[grid.coefficients() + at] = -f64::from(*behind) * line[at];
            }
        }
        let indices = rows.indices(knots, rows.knot[r] as usize);
        indices.iter().zip(rows.other_derivatives(r)).for_each(|(at, a)| {
            if let Some(at) = at {
                line[n + at] = f64::from(a);
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
    for has_ground in [false, true] {
        let (rows, grid, smooth, knots) = problem(has_ground);
        let (normal, right) = written_out(&rows, &grid, &smooth, knots);
        let exact = normal.cholesky().unwrap().solve(&right);
        let now = PictureUnknowns {
            picture: vec![0.0; rows.layers() * grid.coefficients()],
            rest: vec![0.0; knots * DEGREES + TERMS],
        };
        let found = solve(&rows, &grid, &smooth, &now, knots, true, 400);
        // Conjugate gradients in single precision, on twice the unknowns where there is a ground.
        let all: Vec<f64> =
            found.picture.iter().map(|c| f64::from(*c)).chain(found.rest.iter().copied()).collect();
        assert_eq!(all.len(), exact.len());
        all.iter()
            .zip(exact.iter())
            .for_each(|(a, b)| assert!((a - b).abs() < 5e-3 * (1.0 + b.abs()), "{a} is {b}"));
    }
}

#[test]
fn draws_have_the_covariance_that_is_left_open() {
    let (rows, grid, mut smooth, knots) = problem(false);
    smooth.rest = vec![0.0; knots * DEGREES + TERMS];
    let n = grid.coefficients();
    let (normal, _) = written_out(&rows, &grid, &smooth, knots);
    let open = normal.view((0, 0), (n, n)).clone_owned().cholesky().unwrap().inverse();
    let mut random = Random::new(9, &[]);
    const DRAWS: usize = 600;
    let mut squares = vec![0.0; n];
    for _ in 0..DRAWS {
        let one = posterior_draw(&rows, &grid, &smooth, knots, 200, &mut random);
        squares.iter_mut().zip(&one).for_each(|(sum, c)| *sum += f64::from(c * c) / DRAWS as f64);
    }
    // The mean over coefficients has an error of a percent or two, each of a sixth (three standard
    // deviations).
    let ratio: Vec<f64> = squares.iter().enumerate().map(|(k, square)| square / open[(k, k)]).collect();
    assert!((ratio.iter().sum::<f64>() / n as f64 - 1.0).abs() < 0.05, "{ratio:?}");
    assert!(ratio.iter().all(|ratio| (0.75..1.3).contains(ratio)), "{ratio:?}");
}

#[test]
fn fitting_again_what_is_left_gives_back_what_smoothness_took() {
    let (mut rows, grid, smooth, knots) = problem(false);
    let mut random = Random::new(2, &[]);
    let truth: Vec<f32> = (0..grid.coefficients()).map(|_| random.normal() as f32).collect();
    rows.is_saturated = vec![false; rows.count()];
    rows.measured = vec![0.0; rows.count()];
    rows.update_residuals(&grid, &truth.iter().map(|c| -c).collect::<Vec<_>>());
    rows.measured = rows.residual.clone();
    // Of the columns that rows see, which are fewer than the grid has, as stencils are padded: a little
    // more is left than of a grid that is seen whole.
    let seen = |k: &usize| k % grid.width < 12;
    let far = |picture: &[f32]| {
        (0..truth.len()).filter(seen).map(|k| (picture[k] - truth[k]) * (picture[k] - truth[k])).sum::<f32>()
    };
    let first = twicing_step(&rows, &grid, &smooth, knots, 200, &[]);
    rows.update_residuals(&grid, &first);
    let second: Vec<f32> =
        twicing_step(&rows, &grid, &smooth, knots, 200, &[]).iter().zip(&first).map(|(a, b)| a + b).collect();
    assert!(far(&second) < 0.6 * far(&first), "{} and {}", far(&second), far(&first));
}
