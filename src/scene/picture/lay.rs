//! Frame values as rows of the least-squares problem: the part of the grid that each pixel collects light
//! from during its exposure.

use super::coverage::StillGround;
use super::estimate::{PictureFit, ScenePicture};
use super::motion::{AffineMap, AffinePose, DEGREES, apply, derivatives, map_of};
use super::rows::{LANES, MeasurementRows, POSES, REST, TOUCHED};
use super::shading::{self, TERMS};
use super::spline::{ORDER, SplineGrid, weights};
use super::system::stamp;
use rayon::prelude::*;

/// Gauss-Legendre instants of an exposure (of -1 to 1) and their shares of the mean.
const INSTANTS: [(f64, f64); 6] = [
    (-0.932_469_514_203_152, 0.085_662_246_189_585),
    (-0.661_209_386_466_264_5, 0.180_380_786_524_069_3),
    (-0.238_619_186_083_196_9, 0.233_956_967_286_345_5),
    (0.238_619_186_083_196_9, 0.233_956_967_286_345_5),
    (0.661_209_386_466_264_5, 0.180_380_786_524_069_3),
    (0.932_469_514_203_152, 0.085_662_246_189_585),
];

/// One instant of a row's exposure.
#[derive(Clone, Copy)]
struct RowInstant {
    map: AffineMap,
    pose: AffinePose,
    knot: usize,
    weights: [f64; ORDER],
    share: f64,
}

/// How a row of a frame is exposed.
struct RowExposure {
    instants: [RowInstant; 6],
    /// The first knot of the motion that it depends on.
    knot: usize,
    /// So many knots from there on.
    touched: u8,
    /// Digital numbers of a photocurrent of 1.
    factor: f64,
}

/// Intervals of the grid in which the place of a pixel stands at the instants of its exposure.
type GridPlaces = [(usize, usize, f64, f64); 6];

/// The part of the grid that a pixel covers during its exposure.
struct Footprint {
    /// First column and line.
    low: (usize, usize),
    columns: usize,
    lines: usize,
}

impl Footprint {
    fn from_places(located: &GridPlaces, grid: &SplineGrid) -> Footprint {
        let low = (
            located.iter().map(|at| at.0).min().unwrap_or(0),
            located.iter().map(|at| at.1).min().unwrap_or(0),
        );
        let high = (
            located.iter().map(|at| at.0).max().unwrap_or(0),
            located.iter().map(|at| at.1).max().unwrap_or(0),
        );
        let (columns, lines) = ((high.0 - low.0 + ORDER).next_multiple_of(LANES), high.1 - low.1 + ORDER);
        // Padding stands within the grid.
        Footprint { low: (low.0.min(grid.width - columns), low.1), columns, lines }
    }

    /// Shares of the coefficients of a signal in which a photocurrent of 1 is `scale`.
    fn fill(&self, stencil: &mut Vec<f32>, located: &GridPlaces, instants: &[RowInstant; 6], scale: f64) {
        stencil.clear();
        stencil.resize(self.columns * self.lines, 0.0);
        for ((i, j, f, g), instant) in located.iter().zip(instants) {
            stamp(
                stencil,
                self.columns,
                self.low,
                (*i, *j),
                &weights(*f),
                &weights(*g),
                scale * instant.share,
            );
        }
    }
}

impl PictureFit<'_> {
    /// Rows of all frame values on the grid at the present motion.
    pub(super) fn frame_rows(&self, with_rest: bool) -> MeasurementRows {
        let height = self.case.extent.height as usize;
        let count = self.case.frame_count();
        let parts: Vec<MeasurementRows> = (0..count * height)
            .into_par_iter()
            .map(|n| self.lay_row(n / height, n % height, with_rest))
            .collect();
        let mut rows = MeasurementRows { first: vec![0], ..MeasurementRows::default() };
        for part in parts {
            let begun = rows.stencil.len() as u32;
            rows.first.extend(part.first.iter().skip(1).map(|at| at + begun));
            rows.unit.extend(part.unit);
            rows.measured.extend(part.measured);
            rows.is_saturated.extend(part.is_saturated);
            rows.touched.extend(part.touched);
            rows.corner.extend(part.corner);
            rows.stencil.extend(part.stencil);
            rows.residual.extend(part.residual);
            rows.weight.extend(part.weight);
            rows.knot.extend(part.knot);
            rows.by_rest.extend(part.by_rest);
            rows.rest_unit.extend(part.rest_unit);
            rows.signal.extend(part.signal);
            rows.index.extend(part.index);
            rows.behind.extend(part.behind);
        }
        rows
    }

    /// How row `y` of frame `l` is exposed.
    fn row_exposure(&self, l: usize, y: usize) -> RowExposure {
        let motion = &self.picture.motion;
        let times = &self.case.frames.as_ref().expect("frames are there").times;
        let exposure = times.exposure(l, y as u32);
        let (start, end) = (exposure.start.0, exposure.end.0);
        let seconds = (end - start) as f64 * 1e-9;
        let instants: [RowInstant; 6] = INSTANTS.map(|(place, share)| {
            let t_ns = i64::midpoint(start, end) + (0.5 * place * (end - start) as f64) as i64;
            let (knot, weights) = motion.weights(t_ns);
            let pose = motion.pose(t_ns);
            RowInstant { map: map_of(&pose, motion.half), pose, knot, weights, share }
        });
        let knot = instants[0].knot;
        let touched = instants
            .iter()
            .map(|instant| (instant.knot - knot + ORDER).min(TOUCHED))
            .max()
            .unwrap_or(TOUCHED) as u8;
        RowExposure { instants, knot, touched, factor: self.nominal.number.gain * seconds }
    }

    /// Derivative of a frame value at a place by the knots of the motion. `scale`: of the signal, `behind`:
    /// the ground there.
    fn by_motion(
        &self,
        row: &RowExposure,
        place: (f64, f64),
        scale: f64,
        behind: Option<StillGround>,
    ) -> [f32; REST] {
        let motion = &self.picture.motion;
        let mut by_rest = [0.0_f32; REST];
        for instant in &row.instants {
            let (gx, gy) = self.picture.gradient(behind, apply(&instant.map, place.0, place.1));
            let by = derivatives(&instant.map, &instant.pose, motion.half, place.0, place.1)
                .map(|(dx, dy)| gx * dx + gy * dy);
            for (n, weight) in instant.weights.iter().enumerate() {
                let at = (instant.knot - row.knot + n).min(TOUCHED - 1);
                let share = scale * instant.share * weight;
                by_rest[POSES + at * DEGREES..][..DEGREES]
                    .iter_mut()
                    .zip(by)
                    .for_each(|(sum, by)| *sum += (share * by) as f32);
            }
        }
        by_rest
    }

    /// Puts the values of row `y` of frame `l` on the grid.
    fn lay_row(&self, l: usize, y: usize, with_rest: bool) -> MeasurementRows {
        let ScenePicture { grid, motion, shading: terms, centre, .. } = &self.picture;
        let (surface, hidden) = self.picture.fields();
        let row = self.row_exposure(l, y);
        let RowExposure { instants, knot, touched, factor } = &row;
        let number = self.nominal.number;
        let mut rows = MeasurementRows { first: vec![0], ..MeasurementRows::default() };
        let mut stencil: Vec<f32> = Vec::new();
        for x in 0..self.case.extent.width as usize {
            let pixel = y * self.case.extent.width as usize + x;
            let dn = self.case.dn(l, pixel);
            let behind = self.picture.still_ground(pixel);
            if !dn.is_finite()
                || self.selected.is_some_and(|selected| !selected[pixel])
                || behind.is_some_and(|behind| !behind.ground.is_finite())
            {
                continue;
            }
            let place = (x as f64 - centre.0, y as f64 - centre.1);
            let unit = (place.0 / motion.half, place.1 / motion.half);
            let basis = shading::basis(unit.0, unit.1);
            let scale = factor * shading::factor(terms, &basis);
            let located: [Option<(usize, usize, f64, f64)>; 6] = instants.map(|instant| {
                let (px, py) = apply(&instant.map, place.0, place.1);
                grid.locate(px, py)
            });
            if located.iter().any(Option::is_none) {
                continue;
            }
            let located = located.map(Option::unwrap_or_default);
            let footprint = Footprint::from_places(&located, grid);
            footprint.fill(&mut stencil, &located, instants, scale);
            let Footprint { low, columns, .. } = footprint;
            let corner = low.1 * grid.width + low.0;
            let along = |surface: &[f32]| -> f32 {
                stencil
                    .chunks_exact(columns)
                    .enumerate()
                    .map(|(j, line)| {
                        line.iter().zip(&surface[corner + j * grid.width..]).map(|(a, c)| a * c).sum::<f32>()
                    })
                    .sum()
            };
            // A ground that nothing hides is no matter of the fit.
            let (mut signal, mut still) = (along(surface), 0.0);
            if let Some(behind) = behind {
                let by = -behind.by_hidden() as f32;
                signal -= by * along(hidden);
                still = scale * behind.ground;
                rows.behind.push(by);
            }
            let mut residual = dn - number.black_level - still - f64::from(signal);
            let signal_dn = f64::max(dn - number.black_level, 0.0);
            let is_saturated = dn >= self.nominal.saturation_dn;
            if is_saturated {
                // At least that much.
                residual = f64::max(residual, 0.0);
            }
            let mut by_rest =
                if with_rest { self.by_motion(&row, place, scale, behind) } else { [0.0; REST] };
            rows.push_stencil(corner as u32, columns as u32, &stencil);
            rows.measured.push((dn - number.black_level - still) as f32);
            rows.is_saturated.push(is_saturated);
            rows.touched.push(*touched);
            rows.residual.push(residual as f32);
            let index = l * self.case.extent.pixels() + pixel;
            let is_fitted = self.counts.is_none_or(|counts| counts[index]);
            rows.weight.push(if is_fitted { (1.0 / self.sigma(signal_dn)) as f32 } else { 0.0 });
            rows.knot.push(*knot as u32);
            by_rest[..TERMS]
                .iter_mut()
                .zip(basis)
                .for_each(|(by, b)| *by = b as f32 * (signal + still as f32));
            rows.push_rest(&by_rest);
            rows.signal.push(signal_dn as f32);
            rows.index.push(index as u32);
        }
        rows
    }
}
