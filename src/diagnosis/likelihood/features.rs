//! A recording in numbers that effects move: scores of all columns, and how residuals scatter; and what simulated recordings with an effect would give for them.
//!
//! An effect moves more than its own score, and the scene that is estimated with the wrong sensor takes over much of it. Both are the same in a simulated recording with that effect
//! on the estimated scene, when it goes through all of the estimation again. So the difference between recording and control (the stated sensor on the same scene) is
//! matched with the differences that effects make, in the metric of the information matrix.

use super::score::{PixelScore, Probe, Scores, pair, probes, scores};
use super::view::{Prepared, View};
use crate::candidates::{CANDIDATES, Scales, Trial};
use crate::case::Case;
use crate::faithful::came_again;
use crate::nominal::Nominal;
use crate::record::{Conditions, Described, record};
use crate::sample::Sample;
use crate::scene::{Scene, SceneSetting};
use photocurrent_sensor::map::Prior;

/// Scatter: squares of events, squares of frames, products of neighbouring events, per-pixel thresholds apart, and events that do not come again.
pub const SCATTERS: usize = 5;
/// Share of the pixels that is left away, those with the largest residuals.
const DROPPED: f64 = 0.03;
/// By how much of a strength the estimation itself is biased from scene to scene, in a column of usual information.
const BIAS: f64 = 0.05;
/// By how much scatter differs between simulators, natural-log units.
const SCATTER_BIAS: f64 = 0.2;
/// What share of a response a simulated effect misses.
const INEXACT: f64 = 0.1;
/// A column with less information than this says nothing.
const LEAST_INFORMATION: f64 = 1e-6;
/// Standard deviation of what says nothing.
const UNSEEN: f64 = 1e3;
/// The least mean square whose logarithm is taken.
const LEAST_MEAN: f64 = 1e-3;
/// A share of events that do not come again weighs as much as so many times that in the logarithm of a scatter.
const MISSED_WEIGHT: f64 = 5.0;

/// Everything that stays the same from estimation to estimation.
#[derive(Clone, Copy)]
pub struct Bench<'a> {
    /// The recording.
    pub case: &'a Case,
    /// The stated sensor.
    pub nominal: &'a Nominal,
    /// Which pixels.
    pub sample: &'a Sample,
    /// How light is estimated.
    pub setting: &'a SceneSetting,
    /// What strengths are measured by.
    pub scales: &'a Scales,
    /// Noise of simulated recordings.
    pub conditions: Conditions,
    /// The prior of each pixel of the sample.
    pub priors: &'a [Prior],
}

/// Sums over some blocks.
#[derive(Clone, Debug, Default)]
pub struct Features {
    /// Scores of the columns, then the scatters.
    pub values: Vec<f64>,
    /// Information, as in [`PixelScore::information`].
    pub information: Vec<f64>,
    /// Numbers that the scatters sum up.
    pub counts: [f64; SCATTERS],
    /// Over-dispersion, at least 1.
    pub dispersion: f64,
}

/// Features of all blocks, and of the pixels behind them.
#[derive(Clone, Debug, Default)]
pub struct Measured {
    /// Candidates of the columns.
    pub columns: Vec<usize>,
    /// Of each block.
    pub blocks: Vec<Features>,
    /// The pixels.
    pub scores: Scores,
}

impl Bench<'_> {
    /// Estimates the light of a recording with the stated sensor and takes its features.
    ///
    /// # Errors
    /// When the description's effects cannot be combined.
    pub fn measure(&self, case: &Case) -> Result<(Scene, Measured), String> {
        let scene = Scene::estimate_with(case, self.nominal, self.sample, self.setting, self.priors);
        let measured = self.measure_scene(case, &scene)?;
        Ok((scene, measured))
    }

    /// The features of a recording whose light is estimated already.
    ///
    /// # Errors
    /// When the description's effects cannot be combined.
    pub fn measure_scene(&self, case: &Case, scene: &Scene) -> Result<Measured, String> {
        let stated = Trial::stated(self.nominal);
        let base = Prepared::new(case, &stated)?;
        let again = record(case, self.nominal, self.sample, scene, &Described::new(), &Conditions::default())?;
        let view = View::new(case, self.nominal, self.sample, scene, self.setting);
        let probes: Vec<Probe> = probes(&view, &stated, self.scales);
        let scores = scores(&view, self.nominal, &base, scene, self.priors, self.setting, &probes);
        let came = |place: usize| {
            let pixel = self.sample.pixels[place] as usize;
            let (recorded, simulated) = (case.events.of(pixel), again.events.of(pixel));
            let all = recorded.len() + simulated.len();
            (all - 2 * came_again(recorded, simulated), all)
        };
        Ok(Measured::new(scores, self.sample, came))
    }

    /// What the stated sensor with effects would have recorded of a scene, measured, and the light that the stated sensor makes of it.
    ///
    /// # Errors
    /// When effects cannot be combined.
    pub fn expect(&self, scene: &Scene, trial: &Trial) -> Result<(Scene, Measured), String> {
        let described: Described = trial.effects.clone();
        let case = record(self.case, &trial.nominal, self.sample, scene, &described, &self.conditions)?;
        self.measure(&case)
    }
}

impl Measured {
    fn new(scores: Scores, sample: &Sample, missed: impl Fn(usize) -> (usize, usize)) -> Measured {
        let chi = |pixel: &PixelScore| pixel.square / pixel.count as f64;
        let mut all: Vec<f64> = scores.pixels.iter().map(chi).collect();
        all.sort_by(f64::total_cmp);
        let limit = all.get(((1.0 - DROPPED) * all.len() as f64) as usize).copied().unwrap_or(f64::INFINITY);
        let dispersion = f64::max(all.get(all.len() / 2).copied().unwrap_or(1.0), 1.0);
        let m = scores.candidates.len();
        let empty = Features { values: vec![0.0; m + SCATTERS], information: vec![0.0; m * (m + 1) / 2], counts: [0.0; SCATTERS], dispersion };
        let mut blocks = vec![empty; sample.block.iter().map(|block| *block as usize + 1).max().unwrap_or(0)];
        let threshold = scores.candidates.iter().position(|&candidate| CANDIDATES[candidate].id == "threshold_scale");
        for pixel in scores.pixels.iter().filter(|pixel| chi(pixel) <= limit) {
            let block = &mut blocks[sample.block[pixel.place] as usize];
            block.values.iter_mut().zip(&pixel.score).for_each(|(sum, value)| *sum += value);
            block.information.iter_mut().zip(&pixel.information).for_each(|(sum, value)| *sum += value);
            let apart = threshold.map_or(0.0, |j| pixel.score[j] * pixel.score[j] / f64::max(pixel.information[pair(j, j)], 1e-12));
            let events = (pixel.count - pixel.frames) as f64;
            let (missed, all) = missed(pixel.place);
            let scatters = [pixel.square - pixel.frame_square, pixel.frame_square, pixel.lagged, apart, missed as f64];
            for (k, (scatter, count)) in scatters.into_iter().zip([events, pixel.frames as f64, events, 1.0, all as f64]).enumerate() {
                block.values[m + k] += scatter;
                block.counts[k] += count;
            }
        }
        Measured { columns: scores.candidates.clone(), blocks, scores }
    }

    /// Sums over all blocks.
    pub fn sum(&self) -> Features {
        let mut sum = Features::default();
        for block in &self.blocks {
            if sum.values.is_empty() {
                sum = block.clone();
                continue;
            }
            sum.values.iter_mut().zip(&block.values).for_each(|(sum, value)| *sum += value);
            sum.information.iter_mut().zip(&block.information).for_each(|(sum, value)| *sum += value);
            sum.counts.iter_mut().zip(&block.counts).for_each(|(sum, value)| *sum += value);
        }
        sum
    }
}

impl Features {
    /// Numbers that move in proportion to an effect, whatever the number of measurements: of each column the strength that a linear step finds, then logarithms and shares of
    /// the scatters.
    pub fn responses(&self) -> Vec<f64> {
        let m = self.values.len().saturating_sub(SCATTERS);
        let mut responses: Vec<f64> = (0..m)
            .map(|j| {
                let information = self.information[pair(j, j)];
                if information > LEAST_INFORMATION { self.values[j] / information } else { 0.0 }
            })
            .collect();
        let Some(scatters) = self.values.get(m..) else { return responses };
        let mean = |k: usize| scatters[k] / f64::max(self.counts[k], 1.0);
        let log = |k: usize| libm::log(f64::max(mean(k), LEAST_MEAN));
        responses.extend([log(0), log(1), mean(2) / f64::max(mean(0), LEAST_MEAN), log(3), MISSED_WEIGHT * mean(4)]);
        responses
    }

    /// The covariance of responses around what an effect makes of them, factored: noise of the measurements, biases of the estimation (of one size for columns of one
    /// information), and a share of what is to be explained (`moved`), since no simulated effect is exact.
    pub fn metric(&self, moved: &[f64]) -> Metric {
        let n = self.values.len();
        let m = n - SCATTERS;
        let mut covariance = vec![vec![0.0; n]; n];
        let information = |j: usize| self.information[pair(j, j)];
        let mut usual: Vec<f64> = (0..m).map(information).filter(|information| *information > LEAST_INFORMATION).collect();
        usual.sort_by(f64::total_cmp);
        let usual = usual.get(usual.len() / 2).copied().unwrap_or(1.0);
        for a in 0..m {
            for b in 0..=a {
                if information(a) > LEAST_INFORMATION && information(b) > LEAST_INFORMATION {
                    covariance[a][b] = self.dispersion * self.information[pair(a, b)] / (information(a) * information(b));
                }
            }
            covariance[a][a] += if information(a) > LEAST_INFORMATION { BIAS * BIAS * usual / information(a) } else { UNSEEN * UNSEEN };
        }
        for (k, count) in self.counts.iter().enumerate() {
            covariance[m + k][m + k] = SCATTER_BIAS * SCATTER_BIAS + 2.0 / f64::max(*count, 1.0);
        }
        for (k, moved) in moved.iter().enumerate() {
            covariance[k][k] += INEXACT * INEXACT * moved * moved;
        }
        Metric::new(covariance)
    }
}

/// A covariance, factored.
pub struct Metric {
    lower: Vec<Vec<f64>>,
}

impl Metric {
    /// Of the lower half of a covariance.
    pub(super) fn new(mut matrix: Vec<Vec<f64>>) -> Metric {
        let n = matrix.len();
        for a in 0..n {
            for b in 0..=a {
                let mut rest = matrix[a][b];
                for k in 0..b {
                    rest -= matrix[a][k] * matrix[b][k];
                }
                // Columns of one effect can be parallel: what is left of the later one is rounding.
                matrix[a][b] = if a == b { f64::max(rest, 1e-9 * matrix[a][a].abs() + 1e-12).sqrt() } else { rest / matrix[b][b] };
            }
        }
        Metric { lower: matrix }
    }

    /// In standard deviations, independent of each other.
    pub fn whitened(&self, values: &[f64]) -> Vec<f64> {
        let mut white: Vec<f64> = Vec::with_capacity(values.len());
        for (row, value) in self.lower.iter().zip(values) {
            let sum: f64 = row.iter().zip(&white).map(|(a, b)| a * b).sum();
            white.push((value - sum) / row[white.len()]);
        }
        white
    }
}
