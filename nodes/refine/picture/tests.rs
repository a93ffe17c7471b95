//! Claims about the node, on small recordings whose light is known, and about the algebra of the fit.

use super::fit::{Rows, Smoothness, Unknowns, improve};
use super::grid::{Grid, Taps};
use super::pose::CORRECTIONS;
use super::*;
use crate::refine::fixtures::{EXTENT, decibels, error, every_pixel_for_itself, record, sensor, solve, texture};
use nalgebra::{DMatrix, DVector};
use photocurrent_core::random::Random;
use photocurrent_core::{EventStream, FrameSequence, testing};

fn refine(tracks: &TrackSet, events: &EventStream, frames: &FrameSequence) -> TrackSet {
    let node = RefinePicture::build(Params::default()).unwrap();
    let input = In { tracks: tracks.clone(), events: events.clone(), frames: frames.clone(), sensor: sensor() };
    testing::with_context(EXTENT.rows(), &["tracks"], |cx| node.run(input, cx)).0.unwrap().tracks
}

#[test]
fn a_texture_that_slides_comes_out_better() {
    let (events, frames) = record(texture);
    let alone = solve(&events, &frames);
    let together = refine(&alone, &events, &frames);
    let (before, after) = (error(&alone, texture), error(&together, texture));
    assert!(decibels(before, after) > 3.0, "{before} became {after}: {} dB", decibels(before, after));
}

#[test]
fn pixels_that_have_nothing_to_do_with_each_other_stay_as_they_are() {
    let (events, frames) = record(every_pixel_for_itself);
    let alone = solve(&events, &frames);
    let together = refine(&alone, &events, &frames);
    let (before, after) = (error(&alone, every_pixel_for_itself), error(&together, every_pixel_for_itself));
    assert!(decibels(before, after) > -0.1, "{before} became {after}: {} dB", decibels(before, after));
}

#[test]
fn threads_do_not_change_a_bit() {
    let (events, frames) = record(texture);
    let alone = solve(&events, &frames);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| refine(&alone, &events, &frames).read(EXTENT.rows()).unwrap())
    };
    assert_eq!(with(1), with(3));
}

const GRID: Grid = Grid { x0: -2.0, y0: -1.5, pitch: 0.7, width: 9, height: 8 };

/// Forty rows of one to three places each, with derivatives by the motion.
fn rows() -> Rows {
    let mut random = Random::new(5, &[]);
    let mut rows = Rows::default();
    rows.clear();
    for r in 0..40 {
        let count = 1 + r % 3;
        for _ in 0..count {
            rows.taps.push(GRID.taps(-1.2 + 4.0 * random.uniform(), -0.7 + 3.4 * random.uniform()).unwrap().0);
            // The last place of every fourth row counts the other way, as an event's earlier light does.
            rows.share.push(if r % 4 == 0 { -0.9 } else { 1.0 / count as f32 });
        }
        rows.first.push(rows.taps.len() as u32);
        rows.value.push(random.uniform() as f32);
        rows.weight.push(if r == 7 { 0.0 } else { 1.0 + r as f32 / 20.0 });
        rows.by_motion.push(std::array::from_fn(|_| random.uniform() as f32 - 0.5));
    }
    rows
}

#[test]
fn conjugate_gradients_reach_the_solution_of_dense_algebra() {
    let (rows, n) = (rows(), GRID.len());
    let smooth = Smoothness { surface: 0.3, motion: 0.2 };
    let mut dense: Vec<Vec<f64>> = Vec::new();
    let mut values = Vec::new();
    for r in 0..rows.len() {
        let mut line = vec![0.0; n + CORRECTIONS];
        for n in rows.first[r] as usize..rows.first[r + 1] as usize {
            let (taps, share) = (&rows.taps[n], rows.share[n]);
            for (j, y) in taps.y.iter().enumerate() {
                for (i, x) in taps.x.iter().enumerate() {
                    line[taps.first as usize + j * GRID.width + i] += f64::from(y * x * share * rows.weight[r]);
                }
            }
        }
        for k in 0..CORRECTIONS {
            line[n + k] = f64::from(rows.by_motion[r][k] * rows.weight[r]);
        }
        dense.push(line);
        values.push(f64::from(rows.value[r] * rows.weight[r]));
    }
    let mut prior = |entries: &[(usize, f64)]| {
        let mut line = vec![0.0; n + CORRECTIONS];
        entries.iter().for_each(|&(at, value)| line[at] = value);
        dense.push(line);
        values.push(0.0);
    };
    for j in 0..GRID.height {
        for i in 0..GRID.width {
            let at = j * GRID.width + i;
            if i > 0 && i + 1 < GRID.width {
                prior(&[(at - 1, 0.3), (at, -0.6), (at + 1, 0.3)]);
            }
            if j > 0 && j + 1 < GRID.height {
                prior(&[(at - GRID.width, 0.3), (at, -0.6), (at + GRID.width, 0.3)]);
            }
        }
    }
    (0..CORRECTIONS).for_each(|k| prior(&[(n + k, 0.2)]));
    let matrix = DMatrix::from_fn(dense.len(), n + CORRECTIONS, |r, c| dense[r][c]);
    let expected = (matrix.transpose() * &matrix).cholesky().unwrap().solve(&(matrix.transpose() * DVector::from_vec(values)));
    let mut found = Unknowns { surface: vec![0.5; n], ..Unknowns::default() };
    improve(&rows, &GRID, &smooth, &mut found, 200);
    for (k, expected) in expected.iter().enumerate() {
        let found = if k < n { found.surface[k] } else { found.motion[k - n] };
        assert!((f64::from(found) - expected).abs() < 2e-3, "{k}: {found} against {expected}");
    }
}

#[test]
fn slopes_of_the_surface_are_its_differences() {
    let mut random = Random::new(9, &[]);
    let surface: Vec<f32> = (0..GRID.len()).map(|_| random.uniform() as f32).collect();
    let at = |x: f64, y: f64| {
        let Taps { first, x, y } = GRID.taps(x, y).unwrap().0;
        f64::from(GRID.look(&surface, first, &x, &y))
    };
    for (x, y) in [(0.31, 0.4), (-0.8, 1.77), (2.0, 0.02)] {
        let (taps, slope_x, slope_y) = GRID.taps(x, y).unwrap();
        let slopes = (GRID.look(&surface, taps.first, &slope_x, &taps.y), GRID.look(&surface, taps.first, &taps.x, &slope_y));
        let step = 1e-2;
        let differences = ((at(x + step, y) - at(x - step, y)) / (2.0 * step), (at(x, y + step) - at(x, y - step)) / (2.0 * step));
        assert!((f64::from(slopes.0) - differences.0).abs() < 2e-3 && (f64::from(slopes.1) - differences.1).abs() < 2e-3);
    }
}

#[test]
fn a_motion_that_is_a_little_wrong_is_corrected_and_the_picture_foretells_the_light() {
    let (events, frames) = record(texture);
    let tracks = solve(&events, &frames);
    let node = RefinePicture::build(Params::default()).unwrap();
    let meta = node.solver.meta("test", &tracks.meta, &events.meta, &frames.meta).unwrap();
    let again = testing::with_context(EXTENT.rows(), &["tracks"], |cx| node.solver.take_in(meta, &events, &frames, &sensor(), cx)).0.unwrap();
    // The texture slides by 0.7 and 0.2 pixels a millisecond.
    let flow = Flow::steady(24, 16, [0.65, 0.24]);
    let log = LogTracks::new(EXTENT, &tracks.read(EXTENT.rows()).unwrap(), &again.fired());
    let scene = Scene { rows: &again.rows, size: (24, 16), log: &log, flow: &flow, scale: again.scale(), bright: 100.0, pitch: 0.8, keep_back: false };
    let window = Window::fit(&scene, 20_000_000, 14_000_000).unwrap();
    let (mut squares, mut count) = (0.0, 0.0);
    for n in 0..25 {
        let t_ns = 8_000_000 + n * 1_000_000;
        for (x, y) in [(12, 8), (9, 6), (15, 9), (11, 11)] {
            if let Some(log) = window.log_at(x, y, t_ns) {
                let off = log - texture(x, y, t_ns as f64 * 1e-6);
                (squares, count) = (squares + off * off, count + 1.0);
            }
        }
    }
    // The uncorrected motion would be half a pixel off at the window's ends, where light changes by up to 0.3 a pixel.
    let rms = libm::sqrt(squares / count);
    assert!(count > 60.0 && rms < 0.03, "{rms} of {count}");
}
