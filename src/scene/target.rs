//! A known target: a scene in closed form whose free parameters are fitted to the frames, with their
//! posterior errors.
//!
//! The fit is damped Gauss-Newton with robust weights (Student's t) on a sample of the frame values. Each of
//! these is the mean of the scene over its row's exposure. It starts at the best places of a search over the
//! parameters' ranges, or at a given place. The parameters' errors, and the part of a sensor effect that they
//! absorbed, are fitted with every effect by the derivative of every residual by each free parameter
//! ([`FreeParameters`]).

use crate::case::Case;
use crate::closed::ClosedScene;
use crate::known::KnownLight;
use crate::light::{LightKnots, LogLight};
use crate::nominal::Nominal;
use crate::scene::{FrameTolerance, FreeParameters, Scene};
use nalgebra::{DMatrix, DVector};
use photocurrent_core::random::Random;
use photocurrent_sensor::conditional::at_each;
use photocurrent_sensor::elementary::ln;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Scenes in closed form that differ by some free parameters.
pub trait TargetForm: Send + Sync {
    /// Number of free parameters.
    fn count(&self) -> usize;

    /// The scene with parameters at shares of their ranges, 0 to 1; none where they make none.
    fn at(&self, shares: &[f64]) -> Option<Box<dyn ClosedScene>>;
}

/// How a target is fitted.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct TargetSetting {
    /// Frame values that are fitted, at most.
    #[schemars(range(min = 100, max = 1_000_000))]
    pub values: usize,
    /// Places of the ranges at which the search begins.
    #[schemars(range(min = 1, max = 10_000_000))]
    pub tries: usize,
    /// Seed of these places.
    #[serde(skip)]
    pub seed: u64,
}

impl Default for TargetSetting {
    fn default() -> TargetSetting {
        TargetSetting { values: 20_000, tries: 20_000, seed: 1 }
    }
}

/// One frame value that is fitted.
#[derive(Clone, Copy)]
struct MeasuredValue {
    x: f64,
    y: f64,
    start_ns: i64,
    end_ns: i64,
    dn: f64,
}

/// Standard deviation of frame values beyond what is stated: DN, and a share of the signal.
const FRAME_NOISE: (f64, f64) = (1.0, 0.01);
/// Degrees of freedom of their errors.
const NU: f64 = 3.0;
/// Number of frame values in the search.
const SEARCHED: usize = 400;
/// Starting places that are fitted.
const BEST: usize = 8;
/// Rounds of the fit.
const ROUNDS: usize = 40;
/// Step of the derivatives, as a share of a range.
const STEP: f64 = 1e-4;
/// Largest motion, pixels, between two evaluated instants of an exposure, and the least and largest number of
/// instants.
const INSTANT_PX: f64 = 0.4;
/// See there.
const INSTANTS: (usize, usize) = (4, 96);
/// Number of instants in the search.
const ROUGH: usize = 4;

/// A target fitted to frames.
pub struct FittedTarget {
    form: Arc<dyn TargetForm>,
    setting: TargetSetting,
    shares: Vec<f64>,
    /// Triangular root of the covariance that the frames leave, shares.
    root: DMatrix<f64>,
    /// Median residual of the fitted frame values, standard deviations.
    left: f64,
    light: KnownLight,
}

/// Data of a target's fit.
struct TargetFit<'a> {
    form: &'a dyn TargetForm,
    nominal: &'a Nominal,
    measured: Vec<MeasuredValue>,
}

/// Weighted sums of a round.
struct WeightedSums {
    normal: DMatrix<f64>,
    right: DVector<f64>,
}

impl TargetFit<'_> {
    /// Residuals in standard deviations; none where the parameters make no scene.
    fn residuals(&self, shares: &[f64], measured: &[MeasuredValue], is_rough: bool) -> Option<Vec<f64>> {
        let scene = self.form.at(shares)?;
        let number = self.nominal.number;
        let of = |one: &MeasuredValue| {
            let length = (one.end_ns - one.start_ns) as f64;
            let wanted = (length * scene.speed(one.x, one.y) / INSTANT_PX) as usize;
            let count = if is_rough { ROUGH } else { wanted.clamp(INSTANTS.0, INSTANTS.1) };
            let instant = |k: usize| one.start_ns + (length * (k as f64 + 0.5) / count as f64) as i64;
            let mean = (0..count).map(|k| scene.light(one.x, one.y, instant(k))).sum::<f64>() / count as f64;
            let signal = number.gain * mean * (1e-9 * length);
            (one.dn - number.black_level - signal) / self.nominal.frame_sigma_dn(signal, FRAME_NOISE)
        };
        Some(measured.par_iter().with_min_len(256).map(of).collect())
    }

    /// Minus the log density of Student's t.
    fn cost(&self, shares: &[f64], measured: &[MeasuredValue], is_rough: bool) -> f64 {
        self.residuals(shares, measured, is_rough).map_or(f64::INFINITY, |left| {
            left.iter().map(|z| 0.5 * (NU + 1.0) * libm::log1p(z * z / NU)).sum()
        })
    }

    fn round(&self, at: &[f64], measured: &[MeasuredValue]) -> Option<WeightedSums> {
        let n = at.len();
        let now = self.residuals(at, measured, false)?;
        let mut columns = Vec::with_capacity(n);
        for k in 0..n {
            let mut moved = at.to_vec();
            let by = if moved[k] + STEP > 1.0 { -STEP } else { STEP };
            moved[k] += by;
            let then = self.residuals(&moved, measured, false)?;
            columns.push(then.iter().zip(&now).map(|(then, now)| (then - now) / by).collect::<Vec<f64>>());
        }
        let weights: Vec<f64> = now.iter().map(|z| (NU + 1.0) / (NU + z * z)).collect();
        let sum = |a: &[f64], b: &[f64]| -> f64 {
            a.iter().zip(b).zip(&weights).map(|((a, b), w)| a * b * w).sum()
        };
        Some(WeightedSums {
            normal: DMatrix::from_fn(n, n, |i, j| sum(&columns[i], &columns[j])),
            right: DVector::from_fn(n, |i, _| -sum(&columns[i], &now)),
        })
    }

    /// Damped Gauss-Newton from a place.
    fn descend(&self, from: &[f64], measured: &[MeasuredValue]) -> (f64, Vec<f64>) {
        let n = from.len();
        let mut at = from.to_vec();
        let mut cost = self.cost(&at, measured, false);
        let mut damping = 1e-3;
        for _ in 0..ROUNDS {
            let Some(WeightedSums { normal, right }) = self.round(&at, measured) else { break };
            let mut is_better = false;
            for _ in 0..8 {
                let mut damped = normal.clone();
                (0..n).for_each(|k| damped[(k, k)] += damping * (normal[(k, k)] + 1e-9));
                let Some(step) = damped.cholesky().map(|factor| factor.solve(&right)) else { break };
                let next: Vec<f64> =
                    at.iter().zip(step.iter()).map(|(at, step)| (at + step).clamp(0.0, 1.0)).collect();
                let other = self.cost(&next, measured, false);
                if other < cost {
                    let gain = cost - other;
                    (at, cost, damping, is_better) = (next, other, 0.3 * damping, gain > 1e-9 * cost);
                    break;
                }
                damping *= 10.0;
            }
            if !is_better {
                break;
            }
        }
        (cost, at)
    }

    /// A subset of about `count` frame values, evenly spaced.
    fn thinned(&self, count: usize) -> Vec<MeasuredValue> {
        self.measured.iter().step_by(self.measured.len().div_ceil(count).max(1)).copied().collect()
    }

    /// The best place of the ranges.
    fn search(&self, setting: &TargetSetting) -> Vec<f64> {
        let n = self.form.count();
        if n == 0 {
            return Vec::new();
        }
        let (few, some) = (self.thinned(SEARCHED), self.thinned(8 * SEARCHED));
        let mut found: Vec<(f64, Vec<f64>)> = (0..setting.tries)
            .into_par_iter()
            .map(|k| {
                let mut random = Random::new(setting.seed, &[0x7a, k as u64]);
                let at: Vec<f64> = (0..n).map(|_| random.uniform()).collect();
                (self.cost(&at, &few, true), at)
            })
            .collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found.truncate(BEST);
        let fitted = found.iter().map(|(_, at)| self.descend(at, &some)).min_by(|a, b| a.0.total_cmp(&b.0));
        fitted.map_or_else(|| vec![0.5; n], |(_, at)| at)
    }

    /// Triangular root of the covariance at a place, and the median residual.
    fn covariance_root(&self, at: &[f64]) -> (DMatrix<f64>, f64) {
        let n = at.len();
        let mut left: Vec<f64> =
            self.residuals(at, &self.measured, false).unwrap_or_default().iter().map(|z| z.abs()).collect();
        left.sort_by(f64::total_cmp);
        let median = left.get(left.len() / 2).copied().unwrap_or(f64::NAN);
        let scale = if median.is_finite() { median / 0.765 } else { 1.0 };
        let round = self.round(at, &self.measured);
        // A parameter that frames do not constrain is open to a third of its range.
        let least = 1.0 / (OPEN * OPEN);
        let root = round.and_then(|round| {
            let curvature = DMatrix::from_fn(n, n, |i, j| {
                round.normal[(i, j)] / (scale * scale) + if i == j { least } else { 0.0 }
            });
            curvature.try_inverse()?.cholesky().map(|factor| factor.l())
        });
        (root.unwrap_or_else(|| DMatrix::zeros(n, n)), median)
    }
}

/// Standard deviation of a parameter within its range, as a share, before the frames.
const OPEN: f64 = 0.3;

fn measured(case: &Case, nominal: &Nominal, values: usize) -> Vec<MeasuredValue> {
    let Some(times) = case.frames.as_ref().map(|frames| &frames.times) else { return Vec::new() };
    let all = times.len() * case.extent.pixels();
    let step = all.div_ceil(values.max(1)).max(1);
    let of = |k: usize| {
        let (l, pixel) = (k / case.extent.pixels(), k % case.extent.pixels());
        let (x, y) = case.pixel_place(pixel);
        let (dn, exposure) = (case.dn(l, pixel), times.exposure(l, y));
        let counts = dn.is_finite() && dn < nominal.saturation_dn;
        counts.then_some(MeasuredValue {
            x: x.into(),
            y: y.into(),
            start_ns: exposure.start.0,
            end_ns: exposure.end.0,
            dn,
        })
    };
    let mut random = Random::new(1, &[0x5e]);
    (0..all.div_ceil(step))
        .filter_map(|n| of((n * step + (random.uniform() * step as f64) as usize).min(all - 1)))
        .collect()
}

impl FittedTarget {
    /// Fits one to a recording's frames, all of the ranges searched; none where its parameters make no scene.
    pub fn fit(
        case: &Case,
        nominal: &Nominal,
        form: Arc<dyn TargetForm>,
        setting: TargetSetting,
    ) -> Option<FittedTarget> {
        let fit = TargetFit { form: &*form, nominal, measured: measured(case, nominal, setting.values) };
        let from = fit.search(&setting);
        FittedTarget::from(&fit, case, nominal, &form, setting, &from)
    }

    /// Fits a target from a place (shares of ranges), without a search; `None` where its parameters make no
    /// scene.
    pub fn fit_near(
        case: &Case,
        nominal: &Nominal,
        form: Arc<dyn TargetForm>,
        setting: TargetSetting,
        from: &[f64],
    ) -> Option<FittedTarget> {
        let fit = TargetFit { form: &*form, nominal, measured: measured(case, nominal, setting.values) };
        FittedTarget::from(&fit, case, nominal, &form, setting, from)
    }

    fn from(
        fit: &TargetFit<'_>,
        case: &Case,
        nominal: &Nominal,
        form: &Arc<dyn TargetForm>,
        setting: TargetSetting,
        from: &[f64],
    ) -> Option<FittedTarget> {
        let shares = if from.is_empty() { Vec::new() } else { fit.descend(from, &fit.measured).1 };
        let (root, left) = fit.covariance_root(&shares);
        let light = all_knots(&*form.at(&shares)?, case);
        let light = KnownLight::new(case, nominal, light.into());
        Some(FittedTarget { form: form.clone(), setting, shares, root, left, light })
    }

    /// The free parameters as shares of their ranges.
    pub fn shares(&self) -> &[f64] {
        &self.shares
    }

    /// Posterior standard deviations of the free parameters, shares of their ranges.
    pub fn errors(&self) -> Vec<f64> {
        (0..self.shares.len()).map(|k| self.root.row(k).norm()).collect()
    }

    /// Median residual of the fitted frame values, standard deviations: 0.67 is noise alone.
    pub fn median_residual(&self) -> f64 {
        self.left
    }
}

/// The light of every pixel of a recording.
fn all_knots(scene: &dyn ClosedScene, case: &Case) -> Vec<LightKnots> {
    let of = |pixel: usize| {
        let (x, y) = case.pixel_place(pixel);
        scene.knots(x.into(), y.into(), case.span)
    };
    (0..case.extent.pixels()).into_par_iter().map(of).collect()
}

impl FreeParameters for FittedTarget {
    fn free(&self) -> Vec<(f64, f64)> {
        // Wide enough to reach across the bends of an edge.
        let step = |(share, error): (&f64, f64)| {
            (*share, error.clamp(STEP, 0.02) * if *share > 0.5 { -1.0 } else { 1.0 })
        };
        self.shares.iter().zip(self.errors()).map(step).collect()
    }

    fn moved_light(&self, case: &Case, step_ns: i64, pixels: Option<&[u32]>, by: &[f64]) -> Option<LogLight> {
        let shares: Vec<f64> =
            self.shares.iter().zip(by).map(|(share, by)| (share + by).clamp(0.0, 1.0)).collect();
        let scene = self.form.at(&shares)?;
        let mut light = LogLight::blank(case, step_ns);
        let instants: Vec<i64> = (0..light.count).map(|n| light.instant(n)).collect();
        let every: Vec<u32>;
        let pixels = match pixels {
            Some(pixels) => pixels,
            None => {
                every = (0..case.extent.pixels() as u32).collect();
                &every
            }
        };
        let of = |&pixel: &u32| -> Vec<f32> {
            let (x, y) = case.pixel_place(pixel as usize);
            let (t, photocurrent) = scene.knots(x.into(), y.into(), case.span);
            let mut at = Vec::with_capacity(instants.len());
            at_each(&t, &photocurrent, &instants, &mut at);
            at.iter().map(|light| ln(f64::max(*light, f64::MIN_POSITIVE)) as f32).collect()
        };
        let found: Vec<Vec<f32>> = pixels.par_iter().map(of).collect();
        for (&pixel, log) in pixels.iter().zip(found) {
            light.log[pixel as usize] = log;
        }
        Some(light)
    }
}

impl Scene for FittedTarget {
    fn name(&self) -> &'static str {
        self.light.name()
    }

    fn log_light(&self, case: &Case, step_ns: i64, pixels: &[usize]) -> Vec<Vec<f32>> {
        self.light.log_light(case, step_ns, pixels)
    }

    fn tolerance(&self) -> Option<FrameTolerance> {
        self.light.tolerance()
    }

    fn residual(&self) -> &[f32] {
        self.light.residual()
    }

    fn sigma(&self, nominal: &Nominal, signal: f64) -> f64 {
        self.light.sigma(nominal, signal)
    }

    fn part_and_place(&self, case: &Case, pixel: usize, t_ns: i64) -> (u32, f64, f64) {
        self.light.part_and_place(case, pixel, t_ns)
    }

    fn refit(&self, case: &Case, nominal: &Nominal) -> Result<Box<dyn Scene>, String> {
        let fitted = FittedTarget::fit_near(case, nominal, self.form.clone(), self.setting, &self.shares);
        Ok(Box::new(fitted.ok_or("the target's parameters make no scene")?))
    }

    fn posterior_sample(
        &self,
        case: &Case,
        nominal: &Nominal,
        seed: u64,
    ) -> Result<Option<Box<dyn Scene>>, String> {
        let n = self.shares.len();
        let mut random = Random::new(seed, &[0x7b]);
        let draw = &self.root * DVector::from_fn(n, |_, _| random.normal());
        let shares: Vec<f64> =
            self.shares.iter().zip(draw.iter()).map(|(share, by)| (share + by).clamp(0.0, 1.0)).collect();
        let scene = self.form.at(&shares).ok_or("the target's parameters make no scene")?;
        let light = all_knots(&*scene, case);
        Ok(Some(Box::new(KnownLight::new(case, nominal, light.into()))))
    }

    fn misfit(&self) -> f64 {
        self.light.misfit()
    }

    fn target(&self) -> Option<&dyn FreeParameters> {
        Some(self)
    }
}
