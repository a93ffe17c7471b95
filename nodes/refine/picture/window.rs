//! One window of time, and the picture that explains its frames.

use super::fit::{Rows, Smoothness, Unknowns, improve};
use super::grid::Grid;
use super::pose::{CORRECTIONS, Pose, apply};
use crate::refine::again::Row;
use crate::refine::film::LogTracks;
use crate::refine::flow::Flow;
use photocurrent_sensor::map::estimate::is_kept_back;

/// What all windows share.
pub(super) struct Scene<'a> {
    pub rows: &'a [Row],
    /// Extent of the sensor, pixels.
    pub size: (usize, usize),
    /// Log light of the pixels, and how it moves.
    pub log: &'a LogTracks,
    pub flow: &'a Flow,
    /// DN per photocurrent and second, and DN of darkness.
    pub scale: (f64, f64),
    /// Typical photocurrent.
    pub bright: f64,
    /// Distance of coefficients, pixels.
    pub pitch: f64,
    /// Are the frames left out that a choice is judged by?
    pub keep_back: bool,
}

/// A picture and how it moves.
pub(super) struct Window {
    pub middle_ns: i64,
    pose: Pose,
    grid: Grid,
    surface: Vec<f32>,
    coverage: Vec<f32>,
    least_coverage: f32,
    centre: (f64, f64),
    bright: f64,
}

/// Instants of an exposure lie about so many pixels apart.
const BLUR_STEP: f64 = 0.4;
/// Standard deviation of second differences of coefficients, in typical photocurrents.
const ROUGHNESS: f32 = 0.5;
/// Standard deviation of corrections of the motion, pixels per millisecond.
const MOTION_SIGMA: f32 = 0.1;
/// Conjugate gradients of each round; the motion is corrected from the second one on.
const ROUNDS: [usize; 3] = [25, 20, 30];
/// A residual of so many robust standard deviations counts half.
const ROBUST: f32 = 3.0;
/// Standard deviation of how far light moved between two events, natural-log units.
const CHANGE_SIGMA: f64 = 0.03;
/// At most so many changes between events for each pixel of the sensor.
const MOST_CHANGES: usize = 10;
/// A place is known where so many frames saw it.
const LEAST_COVERAGE: f32 = 0.7;

/// Something measured, before it is put on a grid: a sum over instants.
struct Seen {
    row: usize,
    x: usize,
    /// Index of its first instant in the row's list, and how many.
    instants: (usize, usize),
    what: What,
    value: f32,
    weight: f32,
}

/// What is measured.
#[derive(Clone, Copy, Debug, PartialEq)]
enum What {
    /// A frame value: the mean over an exposure.
    Mean,
    /// From one event of a pixel to its next, light became so many times as bright: the later value less this times the earlier one is zero.
    Change(f32),
}

impl Seen {
    /// What instant n of its own counts.
    fn counts(&self, n: usize) -> f32 {
        match self.what {
            What::Mean => 1.0 / self.instants.1 as f32,
            What::Change(factor) if n == 0 => -factor,
            What::Change(_) => 1.0,
        }
    }
}

impl Window {
    /// The picture of `middle_ns` plus and minus `reach_ns`; `None` when no frame is inside.
    pub fn fit(scene: &Scene<'_>, middle_ns: i64, reach_ns: i64) -> Option<Window> {
        let (width, height) = scene.size;
        let centre = (0.5 * (width - 1) as f64, 0.5 * (height - 1) as f64);
        let half = 0.5 * width as f64;
        let motion = |t_ns: i64| scene.flow.affine_at(t_ns);
        let pose_of = |correction: &[f64; CORRECTIONS]| Pose::new(motion, half, middle_ns, reach_ns, correction);
        let mut correction = [0.0; CORRECTIONS];
        let mut pose = pose_of(&correction);
        // Instants of each sensor row, and what was seen over them.
        let mut instants: Vec<Vec<i64>> = vec![Vec::new(); height];
        let mut seen = Vec::new();
        for row in scene.rows {
            look_at_row(scene, row, (middle_ns - reach_ns, middle_ns + reach_ns), &mut instants[row.row as usize], &mut seen);
        }
        if seen.is_empty() {
            return None;
        }
        let (frame_values, exposed) = (seen.len(), instants.clone());
        look_at_events(scene, (middle_ns - reach_ns, middle_ns + reach_ns), &mut instants, &mut seen);
        let grid = cover(&pose, &exposed, (width, height), centre, scene.pitch);
        let mut unknowns = Unknowns { surface: vec![1.0; grid.len()], ..Unknowns::default() };
        let mut weights: Vec<f32> = seen.iter().map(|seen| seen.weight).collect();
        let mut rows = Rows::default();
        for (round, steps) in ROUNDS.into_iter().enumerate() {
            let laid = Laid { grid: &grid, pose: &pose, tilted: (round > 0).then(|| tilted(&pose_of, &correction)) };
            lay(&mut rows, &laid, &instants, &seen, &weights, &unknowns.surface, centre);
            let smooth = Smoothness { surface: 1.0 / ROUGHNESS, motion: 1.0 / MOTION_SIGMA };
            unknowns.motion = [0.0; CORRECTIONS];
            improve(&rows, &grid, &smooth, &mut unknowns, steps);
            for (correction, fitted) in correction.iter_mut().zip(&unknowns.motion) {
                *correction += f64::from(*fitted);
            }
            pose = pose_of(&correction);
            if round + 1 < ROUNDS.len() {
                reweigh(&rows, &grid, &unknowns, &seen, &mut weights);
            }
        }
        let coverage = rows.coverage(&grid, frame_values);
        let least_coverage = LEAST_COVERAGE * (scene.pitch * scene.pitch) as f32;
        Some(Window { middle_ns, pose, grid, surface: unknowns.surface, coverage, least_coverage, centre, bright: scene.bright })
    }

    /// Log light that the picture foretells for a pixel at an instant of the window.
    pub fn log_at(&self, x: usize, y: usize, t_ns: i64) -> Option<f64> {
        let (px, py) = apply(&self.pose.at(t_ns), x as f64 - self.centre.0, y as f64 - self.centre.1);
        let (taps, _, _) = self.grid.taps(px, py)?;
        if self.grid.look(&self.coverage, taps.first, &taps.x, &taps.y) < self.least_coverage {
            return None;
        }
        let value = f64::from(self.grid.look(&self.surface, taps.first, &taps.x, &taps.y));
        (value > 1e-3).then(|| libm::log(value * self.bright))
    }
}

/// The frame values of a row whose exposures lie inside a span.
fn look_at_row(scene: &Scene<'_>, row: &Row, span: (i64, i64), instants: &mut Vec<i64>, seen: &mut Vec<Seen>) {
    let y = row.row as usize;
    let (gain, black_level) = scene.scale;
    let mut exposures: Vec<(i64, i64, (usize, usize))> = Vec::new();
    for x in 0..scene.size.0 {
        let frames = row.frames_of(x);
        for (l, frame) in frames.iter().enumerate() {
            let is_left_out = frame.saturated || frame.start_ns < span.0 || frame.end_ns > span.1;
            if is_left_out || (scene.keep_back && is_kept_back(l, frames.len())) {
                continue;
            }
            let known = exposures.iter().find(|known| (known.0, known.1) == (frame.start_ns, frame.end_ns)).map(|known| known.2);
            let range = known.unwrap_or_else(|| {
                let length = frame.end_ns - frame.start_ns;
                let p = scene.flow.affine_at((frame.start_ns + frame.end_ns) / 2);
                let fastest = p[0].abs() + p[1].abs() + p[2].abs() + p[3].abs() + p[4].abs() + p[5].abs();
                let count = ((fastest * length as f64 * 1e-6 / BLUR_STEP).ceil() as usize).clamp(3, 32);
                let range = (instants.len(), count);
                instants.extend((0..count as i64).map(|n| frame.start_ns + (2 * n + 1) * length / (2 * count as i64)));
                exposures.push((frame.start_ns, frame.end_ns, range));
                range
            });
            let collected = gain * (frame.end_ns - frame.start_ns) as f64 * 1e-9 * scene.bright;
            let (value, weight) = ((frame.dn - black_level) / collected, collected / frame.sigma_dn);
            seen.push(Seen { row: y, x, instants: range, what: What::Mean, value: value as f32, weight: weight as f32 });
        }
    }
}

/// How light changed from each event of a pixel to its next, inside a span.
fn look_at_events(scene: &Scene<'_>, span: (i64, i64), instants: &mut [Vec<i64>], seen: &mut Vec<Seen>) {
    let inside = |t_ns: i64| t_ns >= span.0 && t_ns <= span.1;
    let width = scene.size.0;
    let in_row = |row: &Row| (0..width).map(|x| row.events_of(x).iter().filter(|event| inside(event.t_in_ns)).count()).sum::<usize>();
    let count: usize = scene.rows.iter().map(in_row).sum();
    let every = usize::max(count.div_ceil(MOST_CHANGES * width * scene.size.1), 1);
    let mut passed = 0;
    for row in scene.rows {
        let y = row.row as usize;
        for x in 0..width {
            for pair in row.events_of(x).windows(2) {
                let (from_ns, to_ns) = (pair[0].t_in_ns, pair[1].t_in_ns);
                if !inside(from_ns) || !inside(to_ns) || to_ns <= from_ns {
                    continue;
                }
                passed += 1;
                if passed % every != 0 {
                    continue;
                }
                let (Some(from), Some(to)) = (scene.log.at(x, y, from_ns), scene.log.at(x, y, to_ns)) else { continue };
                let first = instants[y].len();
                instants[y].extend([from_ns, to_ns]);
                let level = libm::exp(0.5 * (from + to)) / scene.bright;
                let weight = (1.0 / (CHANGE_SIGMA * level)) as f32;
                seen.push(Seen { row: y, x, instants: (first, 2), what: What::Change(libm::exp(to - from) as f32), value: 0.0, weight });
            }
        }
    }
}

/// The grid that holds every pixel at every instant.
fn cover(pose: &Pose, instants: &[Vec<i64>], (width, height): (usize, usize), centre: (f64, f64), pitch: f64) -> Grid {
    let (mut low, mut high) = ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY));
    for &t in instants.iter().flatten() {
        let map = pose.at(t);
        for (x, y) in [(0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)] {
            let (px, py) = apply(&map, x as f64 - centre.0, y as f64 - centre.1);
            low = (f64::min(low.0, px), f64::min(low.1, py));
            high = (f64::max(high.0, px), f64::max(high.1, py));
        }
    }
    // Corrections of the motion may lead a little outside.
    let margin = 3.0;
    Grid::over((low.0 - margin, low.1 - margin), (high.0 + margin, high.1 + margin), pitch)
}

/// The poses with each correction a little larger.
fn tilted(pose_of: &impl Fn(&[f64; CORRECTIONS]) -> Pose, correction: &[f64; CORRECTIONS]) -> [Pose; CORRECTIONS] {
    std::array::from_fn(|k| {
        let mut more = *correction;
        more[k] += TILT;
        pose_of(&more)
    })
}

/// How much a correction is changed to see what it does, pixels per millisecond.
const TILT: f64 = 1e-3;

/// Where the picture lies.
struct Laid<'a> {
    grid: &'a Grid,
    pose: &'a Pose,
    /// The same with each correction a little larger.
    tilted: Option<[Pose; CORRECTIONS]>,
}

/// Puts what was seen on the grid.
fn lay(rows: &mut Rows, laid: &Laid<'_>, instants: &[Vec<i64>], seen: &[Seen], weights: &[f32], surface: &[f32], centre: (f64, f64)) {
    rows.clear();
    let grid = laid.grid;
    for (seen, &weight) in seen.iter().zip(weights) {
        let (x, y) = (seen.x as f64 - centre.0, seen.row as f64 - centre.1);
        let begun = rows.taps.len();
        let mut by_motion = [0.0; CORRECTIONS];
        for n in 0..seen.instants.1 {
            let t_ns = instants[seen.row][seen.instants.0 + n];
            let (px, py) = apply(&laid.pose.at(t_ns), x, y);
            let Some((taps, slope_x, slope_y)) = grid.taps(px, py) else { continue };
            let share = seen.counts(n);
            rows.taps.push(taps);
            rows.share.push(share);
            if let Some(tilted) = &laid.tilted {
                let gradient = (grid.look(surface, taps.first, &slope_x, &taps.y), grid.look(surface, taps.first, &taps.x, &slope_y));
                for (by, pose) in by_motion.iter_mut().zip(tilted) {
                    let (qx, qy) = apply(&pose.at(t_ns), x, y);
                    *by += share * (gradient.0 * ((qx - px) / TILT) as f32 + gradient.1 * ((qy - py) / TILT) as f32);
                }
            }
        }
        let whole = rows.taps.len() - begun == seen.instants.1;
        rows.first.push(rows.taps.len() as u32);
        rows.value.push(seen.value);
        rows.weight.push(if whole { weight } else { 0.0 });
        rows.by_motion.push(by_motion);
    }
}

/// Lets what the picture cannot explain count less; frames among frames, events among events.
fn reweigh(rows: &Rows, grid: &Grid, unknowns: &Unknowns, seen: &[Seen], weights: &mut [f32]) {
    let residuals: Vec<f32> = (0..rows.len()).map(|r| (rows.value[r] - rows.predict(grid, unknowns, r)) * seen[r].weight).collect();
    for of_frames in [true, false] {
        let alike = |r: &usize| (seen[*r].what == What::Mean) == of_frames;
        let mut sizes: Vec<f32> = (0..rows.len()).filter(alike).filter(|&r| rows.weight[r] > 0.0).map(|r| residuals[r].abs()).collect();
        if sizes.is_empty() {
            continue;
        }
        let middle = sizes.len() / 2;
        sizes.select_nth_unstable_by(middle, f32::total_cmp);
        // 1.48 of the median is the standard deviation of a normal law.
        let spread = f32::max(1.48 * sizes[middle], 1.0);
        for r in (0..rows.len()).filter(alike) {
            let far = residuals[r] / (ROBUST * spread);
            weights[r] = seen[r].weight / (spread * (1.0 + far * far));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::random::Random;

    #[test]
    fn derivatives_by_the_motion_are_those_of_differences() {
        let still = |_: i64| [0.3, 0.02, -0.05, -0.2, 0.04, 0.01];
        let pose_of = |correction: &[f64; CORRECTIONS]| Pose::new(still, 12.0, 10_000_000, 8_000_000, correction);
        let here = [0.02, -0.01, 0.0, 0.01, 0.03, 0.0, -0.02, 0.01];
        let instants = vec![vec![3_000_000, 5_000_000, 14_000_000]; 3];
        let centre = (11.5, 1.0);
        let grid = cover(&pose_of(&here), &instants, (24, 3), centre, 0.8);
        let mut random = Random::new(4, &[]);
        // A smooth surface: where second derivatives jump, differences are no derivatives.
        let surface: Vec<f32> = (0..grid.len()).map(|k| libm::sin(0.31 * (k % grid.width) as f64 + 0.23 * (k / grid.width) as f64) as f32).collect();
        let seen: Vec<Seen> = (0..20)
            .map(|n| {
                let what = if n % 3 == 2 { What::Change(1.2) } else { What::Mean };
                Seen { row: n % 3, x: (24.0 * random.uniform()) as usize, instants: [(0, 3), (1, 1), (1, 2)][n % 3], what, value: 0.0, weight: 1.0 }
            })
            .collect();
        let weights = vec![1.0; seen.len()];
        let predict = |correction: &[f64; CORRECTIONS], rows: &mut Rows, tilted: Option<[Pose; CORRECTIONS]>| -> Vec<f64> {
            let pose = pose_of(correction);
            lay(rows, &Laid { grid: &grid, pose: &pose, tilted }, &instants, &seen, &weights, &surface, centre);
            let unknowns = Unknowns { surface: surface.clone(), ..Unknowns::default() };
            (0..rows.len()).map(|r| f64::from(rows.predict(&grid, &unknowns, r))).collect()
        };
        let mut rows = Rows::default();
        predict(&here, &mut rows, Some(tilted(&pose_of, &here)));
        let step = 5e-3;
        for k in 0..CORRECTIONS {
            let (mut above, mut below) = (here, here);
            above[k] += step;
            below[k] -= step;
            let (above, below) = (predict(&above, &mut Rows::default(), None), predict(&below, &mut Rows::default(), None));
            for r in 0..seen.len() {
                let (found, expected) = (f64::from(rows.by_motion[r][k]), (above[r] - below[r]) / (2.0 * step));
                // Single precision: 1e-7 over a step of 1e-2, and the slope's own change over it.
                assert!((found - expected).abs() < 2e-2 * (0.1 + expected.abs()), "row {r}, correction {k}: {found} against {expected}");
            }
        }
    }
}
