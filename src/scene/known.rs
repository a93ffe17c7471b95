//! Light that is known without the recording's frames, as a scene.

use crate::case::Case;
use crate::light::{LightKnots, LogLight};
use crate::nominal::Nominal;
use crate::picture::FRAME_NOISE;
use crate::scene::{FrameTolerance, Scene};
use crate::statistics::{MEDIAN_NORMAL, median};
use photocurrent_sensor::conditional::at;
use photocurrent_sensor::elementary::ln;
use std::sync::Arc;

/// Light from another source: a target whose motion the user states, a simulated scene, known tracks.
pub struct KnownLight {
    light: Arc<[LightKnots]>,
    residual: Vec<f32>,
    misfit: f64,
}

/// Frame values in a bin of brightness.
const BIN: usize = 64;

impl KnownLight {
    /// Of a recording; `light` has all its pixels.
    pub fn new(case: &Case, nominal: &Nominal, light: Arc<[LightKnots]>) -> KnownLight {
        let mut known = KnownLight { light, residual: Vec::new(), misfit: 1.0 };
        known.compare(case, nominal);
        known
    }

    /// Compares the frames with those of the light.
    fn compare(&mut self, case: &Case, nominal: &Nominal) {
        let pixels = case.extent.pixels();
        let predicted = (self as &dyn Scene).light(case, STEP_NS).frames(case, nominal);
        let left = |(k, predicted): (usize, &f32)| {
            let dn = case.dn(k / pixels, k % pixels);
            if dn >= nominal.saturation_dn { f32::NAN } else { (dn - f64::from(*predicted)) as f32 }
        };
        self.residual = predicted.iter().enumerate().map(left).collect();
        // Noise is how values of like brightness differ; what they have in common is an effect.
        let signal = |k: usize| {
            case.dn(k / pixels, k % pixels) - f64::from(self.residual[k]) - nominal.number.black_level
        };
        let mut order: Vec<usize> =
            (0..self.residual.len()).filter(|&k| self.residual[k].is_finite()).collect();
        order.sort_by(|&a, &b| signal(a).total_cmp(&signal(b)).then(a.cmp(&b)));
        let mut shares: Vec<f64> = order
            .chunks(BIN)
            .map(|bin| {
                let mut left: Vec<f64> = bin.iter().map(|&k| f64::from(self.residual[k])).collect();
                let middle = median(&mut left);
                left.iter_mut().for_each(|r| *r = (*r - middle).abs());
                median(&mut left)
                    / (MEDIAN_NORMAL * nominal.frame_sigma_dn(signal(bin[bin.len() / 2]), FRAME_NOISE))
            })
            .collect();
        self.misfit = if shares.is_empty() { 1.0 } else { median(&mut shares) };
    }
}

/// Light is sampled this often for frames, ns.
const STEP_NS: i64 = 100_000;

impl Scene for KnownLight {
    fn name(&self) -> &'static str {
        "given"
    }

    fn log_light(&self, case: &Case, step_ns: i64, pixels: &[usize]) -> Vec<Vec<f32>> {
        let instants: Vec<i64> = LogLight::instants(case, step_ns).collect();
        let of = |&pixel: &usize| -> Vec<f32> {
            let (t, photocurrent) = &self.light[pixel];
            if t.is_empty() {
                return Vec::new();
            }
            instants
                .iter()
                .map(|&at_ns| ln(f64::max(at(t, photocurrent, at_ns), f64::MIN_POSITIVE)) as f32)
                .collect()
        };
        pixels.iter().map(of).collect()
    }

    fn tolerance(&self) -> Option<FrameTolerance> {
        None
    }

    fn residual(&self) -> &[f32] {
        &self.residual
    }

    fn sigma(&self, nominal: &Nominal, signal: f64) -> f64 {
        self.misfit * nominal.frame_sigma_dn(signal, FRAME_NOISE)
    }

    fn part_and_place(&self, _case: &Case, pixel: usize, _t_ns: i64) -> (u32, f64, f64) {
        (pixel as u32, 0.0, 0.0)
    }

    fn refit(&self, case: &Case, nominal: &Nominal) -> Result<Box<dyn Scene>, String> {
        let mut known = KnownLight { light: self.light.clone(), residual: Vec::new(), misfit: 1.0 };
        known.compare(case, nominal);
        Ok(Box::new(known))
    }

    fn posterior_sample(
        &self,
        _case: &Case,
        _nominal: &Nominal,
        _seed: u64,
    ) -> Result<Option<Box<dyn Scene>>, String> {
        Ok(None)
    }

    fn misfit(&self) -> f64 {
        self.misfit
    }
}
