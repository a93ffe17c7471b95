//! The rounds of the fit: registration, then picture, motion and shading together, with noise and smoothness
//! estimated on the way.

use super::begin::{begin_motion, exposure_s, images, unchanged};
use super::motion::{AffineMap, DEGREES, PictureMotion, RIGID, apply, compose};
use super::register::{RegisterSearch, register};
use super::rows::{LANES, MeasurementRows};
use super::setting::{
    FRAME_NOISE, GAIN, LEAST_MISFIT, LEAST_ROUGHNESS, LEAST_ROUNDS, MOTION_WEIGHT, POOLED, PictureSetting,
    ROBUST, SEED, STILL, STRETCH,
};
use super::shading::{self, TERMS};
use super::spline::SplineGrid;
use super::system::{PictureUnknowns, Smoothness, add, posterior_draw, roughness, solve, twicing_step};
use crate::block::Block;
use crate::case::Case;
use crate::nominal::Nominal;
use crate::statistics::MEDIAN_NORMAL;
use photocurrent_core::random::Random;
use rayon::prelude::*;

/// Fit of a picture to the frames.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PictureReport {
    /// Median absolute residual of the frame values over 0.6745 standard deviations, round by round: 1 when
    /// the noise explains it.
    pub misfit: Vec<f64>,
    /// Correlation of each frame with the one before, registered.
    pub correlation: Vec<f64>,
    /// The frame noise that was fitted: DN and share of the signal.
    pub noise: (f64, f64),
}

/// A moving picture.
#[derive(Clone, Debug)]
pub struct ScenePicture {
    /// Where its coefficients stand.
    pub grid: SplineGrid,
    /// The coefficients, in photocurrent units; before a still ground behind them those of how much of it is
    /// hidden, times [`ScenePicture::unit`].
    pub surface: Vec<f32>,
    /// The still ground of every pixel, photocurrent, not finite where it is not known; empty where the
    /// picture is all there is.
    pub ground: Vec<f32>,
    /// Photocurrent that coefficients of what is hidden are in units of.
    pub unit: f64,
    /// How it lies on the array.
    pub motion: PictureMotion,
    /// The shading.
    pub shading: [f64; TERMS],
    /// Least photocurrent that is predicted.
    pub least: f64,
    /// How well it explains the frames.
    pub report: PictureReport,
    /// Residual of every frame value, DN, as [frame][y][x]; NaN where it took no part.
    pub residual: Vec<f32>,
    /// How many exposures saw the place of each coefficient; empty where it is not as it was fitted.
    pub(super) coverage: Vec<f32>,
    pub(crate) centre: (f64, f64),
}

impl ScenePicture {
    /// Fits a picture to the frames of a recording.
    ///
    /// # Errors
    /// With fewer than three frames, an array below 8 x 8 pixels, or frames without light.
    pub fn fit(case: &Case, nominal: &Nominal, setting: &PictureSetting) -> Result<ScenePicture, String> {
        ScenePicture::fit_where(case, nominal, setting, None)
    }

    /// The same, to the values of selected pixels ([`FitStart::selected`]).
    ///
    /// # Errors
    /// As [`ScenePicture::fit`].
    pub fn fit_where(
        case: &Case,
        nominal: &Nominal,
        setting: &PictureSetting,
        selected: Option<&[bool]>,
    ) -> Result<ScenePicture, String> {
        let frames = case
            .frames
            .as_ref()
            .filter(|frames| frames.times.len() >= 3)
            .ok_or("a moving picture needs at least three frames")?;
        let (width, height) = (case.extent.width as usize, case.extent.height as usize);
        if width.min(height) < 8 {
            return Err(format!(
                "a moving picture needs at least 8 x 8 pixels, the array has {}",
                case.extent
            ));
        }
        let count = frames.times.len();
        let values =
            count * selected.map_or(width * height, |selected| selected.iter().filter(|is| **is).count());
        if values > setting.most_values {
            return Err(format!(
                "a moving picture is fitted to at most {} frame values, the recording has {values}",
                setting.most_values
            ));
        }
        let images = images(case, nominal);
        // Registration of neighbours, chained.
        let pairs: Vec<(AffineMap, f64)> = (1..count)
            .into_par_iter()
            .map(|l| register(&images[l - 1], &images[l], &RegisterSearch::default(), None))
            .collect();
        let mut poses: Vec<AffineMap> = vec![[0.0, 1.0, 0.0, 0.0, 0.0, 1.0]];
        for (pair, _) in &pairs {
            poses.push(compose(poses.last().expect("one is there"), pair));
        }
        // Where much stands still, what registration followed may be the smaller part of it.
        let still = vec![poses[0]; count];
        let motions = [&poses[..], &still[..]];
        let tried = if unchanged(case, nominal) > STILL { &motions[..] } else { &motions[..1] };
        let mut picture = ScenePicture::fit_from(
            case,
            nominal,
            setting,
            tried,
            FitStart { selected, ..FitStart::default() },
        );
        picture.report.correlation = pairs.iter().map(|pair| pair.1).collect();
        Ok(picture)
    }

    /// Fits a picture from the best of some motions on, each the poses of the frames.
    ///
    /// # Panics
    /// Without any.
    pub fn fit_from(
        case: &Case,
        nominal: &Nominal,
        setting: &PictureSetting,
        poses: &[&[AffineMap]],
        begin: FitStart<'_>,
    ) -> ScenePicture {
        let all = poses.iter().map(|poses| PictureFit::coarse(case, nominal, setting, poses, begin));
        let best = all.min_by(|a, b| a.loss().total_cmp(&b.loss())).expect("motion begins somewhere");
        best.fine()
    }

    /// Fits the frames of another recording of the same scene, from here on.
    pub fn refit(
        &self,
        case: &Case,
        nominal: &Nominal,
        setting: &PictureSetting,
        counts: Option<&[bool]>,
    ) -> ScenePicture {
        let mut fit = PictureFit::new(case, nominal, setting, self.motion.clone(), self.fit_start(counts));
        fit.picture = ScenePicture {
            report: PictureReport { misfit: Vec::new(), ..self.report.clone() },
            ..self.clone()
        };
        fit.rounds(setting.rounds.0, setting.rounds.0 + setting.rounds.1, setting.steps.1);
        fit.picture
    }

    /// A posterior sample of the scene: it explains the frames as well as the fit, and is as rough as scenes
    /// are.
    pub fn posterior_sample(
        &self,
        case: &Case,
        nominal: &Nominal,
        setting: &PictureSetting,
        counts: Option<&[bool]>,
        seed: u64,
    ) -> ScenePicture {
        let mut fit = PictureFit::new(case, nominal, setting, self.motion.clone(), self.fit_start(counts));
        fit.picture = self.clone();
        let knots = self.motion.knots.len();
        let mut rows = fit.frame_rows(false);
        fit.reweigh(&mut rows);
        let mut random = Random::new(seed, &[0xd4]);
        let smooth = fit.smoothness(knots, None);
        let open = posterior_draw(&rows, &self.grid, &smooth, knots, setting.draw_steps, &mut random);
        let smooth = fit.smoothness(knots, Some(&open));
        let open = posterior_draw(&rows, &self.grid, &smooth, knots, setting.draw_steps, &mut random);
        fit.picture.surface.iter_mut().zip(&open).for_each(|(c, open)| *c += open);
        rows.update_residuals(&fit.picture.grid, &fit.picture.surface);
        fit.keep_residuals(&rows);
        fit.picture
    }

    /// The grid of everything that a block of pixels sees during exposures.
    pub(crate) fn covering(&self, case: &Case, block: &Block, pitch: f64) -> SplineGrid {
        cover(case, &self.motion, self.centre, pitch, block)
    }

    /// The part of the picture that a block of pixels sees, on a grid of the setting's pitch.
    pub(crate) fn on_block(
        &self,
        case: &Case,
        nominal: &Nominal,
        setting: &PictureSetting,
        block: &Block,
    ) -> ScenePicture {
        let mut fit = PictureFit::new(case, nominal, setting, self.motion.clone(), self.fit_start(None));
        fit.picture = self.clone();
        fit.refine(block);
        fit.picture.coverage.clear();
        fit.picture
    }

    /// Rows of the frame values of a block of pixels, at the present picture.
    pub(crate) fn rows_of_block(
        &self,
        case: &Case,
        nominal: &Nominal,
        setting: &PictureSetting,
        block: &Block,
    ) -> MeasurementRows {
        let mut selected = vec![false; case.extent.pixels()];
        block.pixels(case.extent).iter().for_each(|pixel| selected[*pixel as usize] = true);
        let begin = FitStart { selected: Some(&selected), ..self.fit_start(None) };
        let mut fit = PictureFit::new(case, nominal, setting, self.motion.clone(), begin);
        fit.picture = self.clone();
        fit.frame_rows(true)
    }

    /// Six numbers for each knot of the motion, then the shading's terms.
    pub(crate) fn motion_and_shading(&self) -> Vec<f64> {
        self.motion.knots.iter().flatten().copied().chain(self.shading).collect()
    }

    /// Moves by a share of a step of everything: coefficients, then the rest.
    pub(crate) fn move_by(&mut self, step: &[f64], share: f64) {
        let (of_surface, of_rest) = step.split_at(self.surface.len());
        self.surface.iter_mut().zip(of_surface).for_each(|(c, by)| *c += (share * by) as f32);
        let rest = self.motion.knots.iter_mut().flatten().chain(&mut self.shading);
        rest.zip(of_rest).for_each(|(value, by)| *value += share * by);
    }

    /// The factor that light of the picture at a place, pixels from the array's centre, is multiplied with.
    pub(crate) fn shade(&self, place: (f64, f64)) -> f64 {
        let half = self.motion.half;
        shading::factor(&self.shading, &shading::basis(place.0 / half, place.1 / half))
    }

    fn fit_start<'a>(&'a self, counts: Option<&'a [bool]>) -> FitStart<'a> {
        FitStart { counts, ground: (!self.ground.is_empty()).then_some(&self.ground[..]), selected: None }
    }

    /// Standard deviation that a frame value of `signal` DN above black was assumed to have.
    pub fn sigma(&self, nominal: &Nominal, signal: f64) -> f64 {
        nominal.frame_sigma_dn(signal, self.report.noise)
    }

    /// Place on the picture of a pixel at an instant, pixels.
    pub fn place_on_picture(&self, case: &Case, pixel: usize, t_ns: i64) -> (f64, f64) {
        let (x, y) = case.pixel_place(pixel);
        apply(&self.motion.at(t_ns), f64::from(x) - self.centre.0, f64::from(y) - self.centre.1)
    }
}

/// Initial values of a fit.
#[derive(Clone, Copy, Default)]
pub struct FitStart<'a> {
    /// Which frame values are fitted, [frame][y][x]; all of them without it.
    pub counts: Option<&'a [bool]>,
    /// The still ground behind the picture, photocurrent, for each pixel; not finite where it is not known.
    pub ground: Option<&'a [f32]>,
    /// Pixels that are fitted; the others are left out, as if without frame values. All without it.
    pub selected: Option<&'a [bool]>,
}

/// The state of a fit.
pub(super) struct PictureFit<'a> {
    pub(super) case: &'a Case,
    pub(super) nominal: &'a Nominal,
    pub(super) setting: &'a PictureSetting,
    pub(super) counts: Option<&'a [bool]>,
    pub(super) selected: Option<&'a [bool]>,
    pub(super) picture: ScenePicture,
    /// Frame values predicted by the picture, over the signal's factor; kept for the weights.
    pub(super) typical: f64,
    pub(super) scale: f64,
}

impl<'a> PictureFit<'a> {
    fn new(
        case: &'a Case,
        nominal: &'a Nominal,
        setting: &'a PictureSetting,
        motion: PictureMotion,
        begin: FitStart<'a>,
    ) -> PictureFit<'a> {
        let centre =
            (0.5 * (f64::from(case.extent.width) - 1.0), 0.5 * (f64::from(case.extent.height) - 1.0));
        let grid = cover(case, &motion, centre, setting.coarse_pitch, &Block::whole_array(case.extent));
        let mut light: Vec<f64> = Vec::new();
        for l in 0..case.frame_count() {
            let seconds = exposure_s(case, l, 0);
            let values = (0..case.extent.pixels()).step_by(5).map(|pixel| case.dn(l, pixel));
            light.extend(
                values
                    .filter(|dn| dn.is_finite())
                    .map(|dn| (dn - nominal.number.black_level) / (nominal.number.gain * seconds)),
            );
        }
        light.sort_by(f64::total_cmp);
        let typical = light.get(light.len() / 2).copied().unwrap_or(1.0).max(1e-9);
        let picture = ScenePicture {
            grid,
            surface: if begin.ground.is_some() {
                vec![0.0; 2 * grid.coefficients()]
            } else {
                vec![typical as f32; grid.coefficients()]
            },
            ground: begin.ground.map_or_else(Vec::new, <[f32]>::to_vec),
            unit: typical,
            motion,
            shading: [0.0; TERMS],
            least: 1e-3 * typical,
            report: PictureReport { noise: FRAME_NOISE, ..PictureReport::default() },
            residual: Vec::new(),
            coverage: Vec::new(),
            centre,
        };
        PictureFit {
            case,
            nominal,
            setting,
            counts: begin.counts,
            selected: begin.selected,
            picture,
            typical,
            scale: 1.0,
        }
    }

    /// Fitted on the coarse grid, from poses of the frames on.
    fn coarse(
        case: &'a Case,
        nominal: &'a Nominal,
        setting: &'a PictureSetting,
        poses: &[AffineMap],
        begin: FitStart<'a>,
    ) -> PictureFit<'a> {
        let mut fit = PictureFit::new(case, nominal, setting, begin_motion(case, poses, setting), begin);
        fit.rounds(0, setting.rounds.0, setting.steps.0);
        fit
    }

    /// And from there on the fine one.
    fn fine(mut self) -> ScenePicture {
        let PictureSetting { rounds, steps, .. } = *self.setting;
        self.refine(&Block::whole_array(self.case.extent));
        self.rounds(rounds.0, rounds.0 + rounds.1, steps.1);
        self.picture
    }

    /// Robust loss of the frame residuals, on a scale that does not depend on the picture.
    fn loss(&self) -> f64 {
        let residual = self.picture.residual.iter().enumerate().filter(|(_, residual)| residual.is_finite());
        let of = |(n, residual): (usize, &f32)| {
            let pixels = self.case.extent.pixels();
            let signal =
                f64::max(self.case.dn(n / pixels, n % pixels) - self.nominal.number.black_level, 0.0);
            let z = f64::from(*residual) / (ROBUST * self.sigma(signal));
            (libm::log1p(z * z), 1.0)
        };
        let (sum, count) = residual.map(of).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        sum / f64::max(count, 1.0)
    }

    /// Lays what a block of pixels sees of the picture on the fine grid.
    fn refine(&mut self, block: &Block) {
        let fine = self.picture.covering(self.case, block, self.setting.pitch);
        let ScenePicture { grid, surface, .. } = &self.picture;
        let value = |surface: &[f32], n: usize| {
            let x = fine.x0 + (n % fine.width) as f64 * fine.pitch;
            let y = fine.y0 + (n / fine.width) as f64 * fine.pitch;
            grid.nearest(surface, x, y) as f32
        };
        let layers = surface.chunks_exact(grid.coefficients());
        self.picture.surface = layers
            .flat_map(|surface| (0..fine.coefficients()).map(move |n| (surface, n)))
            .map(|(surface, n)| value(surface, n))
            .collect();
        self.picture.grid = fine;
    }

    /// From round `begin` on: the first one leaves motion alone, the second shading.
    fn rounds(&mut self, begin: usize, end: usize, steps: usize) {
        let knots = self.picture.motion.knots.len();
        let mut smooth = self.first_smoothness(knots);
        let mut rows = self.frame_rows(begin > 0);
        if begin > 0 {
            self.reweigh(&mut rows);
            smooth = self.smoothness(knots, None);
        }
        let mut best = self.cost(&rows, &smooth);
        for round in begin..end {
            let with_rest = round >= 1;
            let with_shading = self.setting.is_shaded && round >= 2;
            let hold_motion = 1.0 / 2.0;
            smooth.rest = vec![hold_motion; knots * DEGREES];
            smooth.rest.extend([if with_shading { 2.0 } else { 0.0 }; TERMS]);
            smooth.motion = MOTION_WEIGHT;
            // Scale and shear are as little as frames allow: a star has no scale.
            let stretch = 1.0 / STRETCH;
            smooth.rest_size =
                (0..knots * DEGREES).map(|n| if n % DEGREES >= RIGID { stretch } else { 0.0 }).collect();
            smooth.rest_size.extend([1.0; TERMS]);
            let now = PictureUnknowns { picture: self.picture.surface.clone(), rest: self.flat() };
            let step = solve(&rows, &self.picture.grid, &smooth, &now, knots, with_rest, steps);
            let mut by = 1.0;
            let before = self.picture.clone();
            loop {
                self.apply_step(&before, &step, by);
                rows = self.frame_rows(round + 1 >= 1);
                let cost = self.cost(&rows, &smooth);
                if cost < best || by < 0.2 || round == 0 {
                    break;
                }
                by *= 0.5;
            }
            let misfit = self.reweigh(&mut rows);
            let last = self.picture.report.misfit.last().copied();
            self.picture.report.misfit.push(misfit);
            let open = (begin > 0).then(|| {
                let mut random = Random::new(SEED, &[round as u64]);
                posterior_draw(
                    &rows,
                    &self.picture.grid,
                    &smooth,
                    knots,
                    self.setting.draw_steps,
                    &mut random,
                )
            });
            smooth = self.smoothness(knots, open.as_deref());
            best = self.cost(&rows, &smooth);
            if round + 1 >= begin + LEAST_ROUNDS && last.is_some_and(|last| misfit > (1.0 - GAIN) * last) {
                break;
            }
        }
        if begin > 0 {
            let mut step = Vec::new();
            for _ in 0..self.setting.again {
                // Weakly constrained parts need about the same step every time.
                step =
                    twicing_step(&rows, &self.picture.grid, &smooth, knots, self.setting.again_steps, &step);
                self.picture.surface.iter_mut().zip(&step).for_each(|(c, step)| *c += step);
                rows.update_residuals(&self.picture.grid, &self.picture.surface);
                self.reweigh(&mut rows);
            }
        }
        self.keep_residuals(&rows);
    }

    fn flat(&self) -> Vec<f64> {
        let mut rest: Vec<f64> = self.picture.motion.knots.iter().flatten().copied().collect();
        rest.extend(self.picture.shading);
        rest
    }

    fn apply_step(&mut self, before: &ScenePicture, step: &PictureUnknowns, by: f64) {
        let mut now = PictureUnknowns {
            picture: before.surface.clone(),
            rest: before.motion.knots.iter().flatten().copied().chain(before.shading).collect(),
        };
        add(&mut now, by, step);
        let knots = before.motion.knots.len();
        for (k, knot) in self.picture.motion.knots.iter_mut().enumerate() {
            knot.copy_from_slice(&now.rest[k * DEGREES..(k + 1) * DEGREES]);
        }
        self.picture.shading.copy_from_slice(&now.rest[knots * DEGREES..]);
        self.picture.surface = now.picture;
    }

    fn cost(&self, rows: &MeasurementRows, smooth: &Smoothness) -> f64 {
        let robust = ROBUST * self.scale;
        let misfit: f64 = (0..rows.count())
            .filter(|&r| rows.weight[r] > 0.0)
            .map(|r| {
                let z = f64::from(rows.residual[r]) / self.sigma_of(rows, r);
                robust * robust * libm::log1p((z / robust) * (z / robust))
            })
            .sum();
        misfit / (self.scale * self.scale) + roughness(&self.picture.grid, smooth, &self.picture.surface)
    }

    /// The standard deviation that a row's value is assumed to have, without robustness.
    fn sigma_of(&self, rows: &MeasurementRows, r: usize) -> f64 {
        self.sigma(f64::from(rows.signal[r]))
    }

    pub(super) fn sigma(&self, signal: f64) -> f64 {
        self.picture.sigma(self.nominal, signal)
    }

    fn first_smoothness(&self, knots: usize) -> Smoothness {
        let n = self.picture.surface.len();
        let weight = (1.0 / (0.3 * self.typical)) as f32;
        Smoothness {
            along_x: vec![weight; n],
            along_y: vec![weight; n],
            across: vec![weight; n],
            rest: vec![0.0; knots * DEGREES + TERMS],
            rest_size: vec![0.0; knots * DEGREES + TERMS],
            motion: 0.0,
        }
    }

    /// Smoothness weights from the picture's own second differences: their mean square nearby, a share of the
    /// overall one, and a constant. `open` is a posterior sample of the picture's error: a fitted picture
    /// alone is smoother than the scene, and a little more so in every round.
    fn smoothness(&self, knots: usize, open: Option<&[f32]>) -> Smoothness {
        let grid = &self.picture.grid;
        let (w, h) = (grid.width, grid.height);
        let least = (LEAST_ROUGHNESS * self.typical) as f32;
        let layers = self
            .picture
            .surface
            .chunks_exact(w * h)
            .enumerate()
            .map(|(n, c)| (c, open.map(|open| &open[n * w * h..(n + 1) * w * h])));
        let layers: Vec<(&[f32], Option<&[f32]>)> = layers.collect();
        let of_layer = |(c, open): (&[f32], Option<&[f32]>),
                        difference: &dyn Fn(&[f32], usize, usize) -> f32|
         -> Vec<f32> {
            let square = |surface: &[f32], k: usize| {
                difference(surface, k % w, k / w) * difference(surface, k % w, k / w)
            };
            let square: Vec<f32> =
                (0..w * h).map(|k| square(c, k) + open.map_or(0.0, |open| square(open, k))).collect();
            let mean: f32 = square.iter().sum::<f32>() / square.len() as f32;
            let mut sorted = square.clone();
            let middle = sorted.len() / 2;
            sorted.select_nth_unstable_by(middle, f32::total_cmp);
            let overall = f32::min(2.0 * sorted[middle], mean);
            (0..w * h)
                .map(|k| {
                    let (x, y) = (k % w, k / w);
                    let (mut sum, mut n) = (0.0, 0.0);
                    for j in y.saturating_sub(1)..(y + 2).min(h) {
                        for i in x.saturating_sub(1)..(x + 2).min(w) {
                            sum += square[j * w + i];
                            n += 1.0;
                        }
                    }
                    1.0 / (sum / n + POOLED as f32 * overall + least * least).sqrt()
                })
                .collect()
        };
        let field = |difference: &dyn Fn(&[f32], usize, usize) -> f32| -> Vec<f32> {
            layers.iter().flat_map(|layer| of_layer(*layer, difference)).collect()
        };
        let along_x = field(&|c, x, y| {
            if x > 0 && x + 1 < w { c[y * w + x - 1] - 2.0 * c[y * w + x] + c[y * w + x + 1] } else { 0.0 }
        });
        let along_y = field(&|c, x, y| {
            if y > 0 && y + 1 < h {
                c[(y - 1) * w + x] - 2.0 * c[y * w + x] + c[(y + 1) * w + x]
            } else {
                0.0
            }
        });
        let across = field(&|c, x, y| {
            let at = y * w + x;
            if x + 1 < w && y + 1 < h { c[at] - c[at + 1] - c[at + w] + c[at + w + 1] } else { 0.0 }
        });
        Smoothness {
            along_x,
            along_y,
            across,
            rest: vec![0.0; knots * DEGREES + TERMS],
            rest_size: vec![0.0; knots * DEGREES + TERMS],
            motion: 0.0,
        }
    }

    /// Updates robust weights and the noise scale; returns the misfit.
    fn reweigh(&mut self, rows: &mut MeasurementRows) -> f64 {
        let z: Vec<f64> =
            (0..rows.count()).map(|r| f64::from(rows.residual[r]).abs() / self.sigma_of(rows, r)).collect();
        let mut sizes: Vec<f64> =
            z.iter().zip(&rows.weight).filter(|(_, weight)| **weight > 0.0).map(|(z, _)| *z).collect();
        let middle = sizes.len() / 2;
        if sizes.is_empty() {
            return 0.0;
        }
        sizes.select_nth_unstable_by(middle, f64::total_cmp);
        let misfit = sizes[middle] / MEDIAN_NORMAL;
        self.scale = misfit.max(LEAST_MISFIT);
        for r in 0..rows.count() {
            if rows.weight[r] == 0.0 {
                continue;
            }
            let far = z[r] / (ROBUST * self.scale);
            rows.weight[r] =
                (1.0 / (self.sigma_of(rows, r) * self.scale * libm::sqrt(1.0 + far * far))) as f32;
        }
        misfit
    }

    fn keep_residuals(&mut self, rows: &MeasurementRows) {
        let mut residual = vec![f32::NAN; self.case.frame_count() * self.case.extent.pixels()];
        for (at, value) in rows.index.iter().zip(&rows.residual) {
            residual[*at as usize] = *value;
        }
        self.picture.residual = residual;
        self.picture.coverage = rows.coverage(&self.picture.grid);
    }
}

/// A grid over everything that a block of pixels sees during exposures.
fn cover(case: &Case, motion: &PictureMotion, centre: (f64, f64), pitch: f64, block: &Block) -> SplineGrid {
    let (mut low, mut high) = ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY));
    let begin = (block.x as f64, block.y as f64);
    let end = (begin.0 + block.width as f64 - 1.0, begin.1 + block.height as f64 - 1.0);
    let times = &case.frames.as_ref().expect("frames are there").times;
    for l in 0..times.len() {
        let (first, last) = (times.exposure(l, 0).start.0, times.exposure(l, case.extent.height - 1).end.0);
        for n in 0..=4 {
            let map = motion.at(first + (last - first) * n / 4);
            for (x, y) in [begin, (end.0, begin.1), (begin.0, end.1), end] {
                let (px, py) = apply(&map, x - centre.0, y - centre.1);
                low = (f64::min(low.0, px), f64::min(low.1, py));
                high = (f64::max(high.0, px), f64::max(high.1, py));
            }
        }
    }
    const MARGIN: f64 = 2.0;
    let mut grid =
        SplineGrid::covering((low.0 - MARGIN, low.1 - MARGIN), (high.0 + MARGIN, high.1 + MARGIN), pitch);
    // Lines of stencils are padded to whole lanes.
    grid.width = grid.width.next_multiple_of(LANES);
    grid
}

#[cfg(test)]
#[path = "estimate_tests.rs"]
mod tests;
