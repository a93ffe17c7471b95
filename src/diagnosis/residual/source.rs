//! The scene that residuals are taken on, whoever states it: a moving picture, patches of it, a known target.

use super::control::Behind;
use super::gate::Gate;
use super::light::Light;
use crate::case::Case;
use crate::integrity::median;
use crate::nominal::Nominal;
use crate::picture::{Picture, PictureSetting};
use photocurrent_sensor::conditional::at;
use photocurrent_sensor::elementary::ln;
use rayon::prelude::*;
use std::sync::Arc;

/// What a pixel looks at: a part of the scene and a cell of it.
pub type Cell = (u32, i64, i64);

/// A scene that frames (or the user) state without the events that are to be explained.
pub trait Source: Sync {
    /// In a word, for reports.
    fn name(&self) -> &'static str;

    /// Log photocurrent of some pixels at the instants of [`Light::blank`]; empty where it is not known.
    fn log_of(&self, case: &Case, step_ns: i64, pixels: &[usize]) -> Vec<Vec<f32>>;

    /// How many exposures saw what some pixels look at, at the same instants; empty where the scene stands without frames.
    fn exposures_of(&self, _case: &Case, _step_ns: i64, pixels: &[usize]) -> Vec<Vec<f32>> {
        vec![Vec::new(); pixels.len()]
    }

    /// Log photocurrent of every pixel at steady instants; empty where it is not known.
    fn light(&self, case: &Case, step_ns: i64) -> Light {
        let mut light = Light::blank(case, step_ns);
        let rows: Vec<Vec<usize>> = (0..case.extent.pixels()).collect::<Vec<_>>().chunks(case.extent.width.max(1) as usize).map(<[usize]>::to_vec).collect();
        light.log = rows.par_iter().flat_map(|pixels| self.log_of(case, step_ns, pixels)).collect();
        light
    }

    /// Does it stand without the recording's frames? Then effects of frames show in their values; otherwise they show in the light that frames imply.
    fn is_known(&self) -> bool {
        false
    }

    /// For each free parameter of the scene where it stands in its range, 0 to 1, and the step of its derivatives, a share of the range, away from the nearer end; nothing where none is free.
    fn free(&self) -> Vec<(f64, f64)> {
        Vec::new()
    }

    /// The light of some pixels (of all where there is no list) with free parameters moved by shares of their ranges; none where they make no scene.
    fn moved(&self, _case: &Case, _step_ns: i64, _pixels: Option<&[u32]>, _by: &[f64]) -> Option<Light> {
        None
    }

    /// Which events count.
    fn gate(&self, case: &Case, least_dn: f64, spread: f64) -> Gate {
        Gate::new(case, self.residual(), (least_dn, f64::INFINITY), spread)
    }

    /// Residual of every frame value, DN as [frame][y][x]; NaN where it took no part.
    fn residual(&self) -> &[f32];

    /// Standard deviation that a frame value of `signal` DN above black is found to have.
    fn sigma(&self, nominal: &Nominal, signal: f64) -> f64;

    /// Which cell of the scene a pixel sees at an instant, with cells of `side` pixels: what is wrong with the scene is alike in all pixels that see the same cell.
    fn cell(&self, case: &Case, pixel: usize, t_ns: i64, side: f64) -> Cell;

    /// The same scene fitted anew to another recording of it.
    ///
    /// # Errors
    /// When that recording's frames cannot be fitted.
    fn refit(&self, case: &Case, nominal: &Nominal) -> Result<Box<dyn Source>, String>;

    /// The same scene as rough as it may be: what frames leave open of it drawn at random, edges as sharp as the fit cannot resolve; none where nothing is open.
    ///
    /// # Errors
    /// When the recording's frames cannot be fitted.
    fn rough(&self, case: &Case, nominal: &Nominal, step_ns: i64, seed: u64) -> Result<Option<Behind>, String>;

    /// The frames that this scene gives, DN as [frame][y][x]; NaN where it does not reach.
    fn frames(&self, case: &Case) -> Vec<f32> {
        let pixels = case.extent.pixels();
        self.residual().iter().enumerate().map(|(n, residual)| (case.dn(n / pixels, n % pixels) - f64::from(*residual)) as f32).collect()
    }

    /// Median absolute residual of frames, standard deviations as they were first assumed; 1 when the noise explains it.
    fn misfit(&self) -> f64;
}

/// Where something moves before something else, most frame values are those of what stands still and do not constrain how well the rest is predicted: errors below this share of a threshold
/// are small enough for its events.
pub const STEP: f64 = 0.15;

/// What [`STEP`] of a threshold is of a usual frame value, DN.
pub(super) fn usual_step_dn(case: &Case, nominal: &Nominal) -> f64 {
    let mut signals: Vec<f64> = case.frames.iter().flat_map(|frames| frames.every(7)).map(|dn| f64::from(dn) - nominal.number.black_level).collect();
    signals.retain(|signal| *signal > 0.0);
    let threshold = 0.5 * (nominal.pixel.threshold_on + nominal.pixel.threshold_off);
    if signals.is_empty() { 0.0 } else { STEP * threshold * median(&mut signals) }
}

/// One moving picture, with how it was fitted.
pub struct MovingPicture {
    /// The picture.
    pub picture: Picture,
    /// How it was fitted.
    pub setting: PictureSetting,
    /// What is wrong in the same way with neighbouring values is allowed to be so much, DN; and with any value where the picture moves before a still ground.
    pub structure_dn: f64,
    /// Does the scene move as one? Not where pictures of some parts of it predict them better.
    pub is_one: bool,
}

impl MovingPicture {
    /// Fits one to a recording's frames.
    ///
    /// # Errors
    /// As [`Picture::fit`].
    pub fn fit(case: &Case, nominal: &Nominal, setting: &PictureSetting) -> Result<MovingPicture, String> {
        MovingPicture::fit_where(case, nominal, setting, None)
    }

    /// The same, to the values of pixels that are asked for.
    pub(super) fn fit_where(case: &Case, nominal: &Nominal, setting: &PictureSetting, asked: Option<&[bool]>) -> Result<MovingPicture, String> {
        Ok(MovingPicture::new(Picture::fit_where(case, nominal, setting, asked)?, setting, case, nominal))
    }

    /// Of a picture that was fitted.
    pub fn new(picture: Picture, setting: &PictureSetting, case: &Case, nominal: &Nominal) -> MovingPicture {
        MovingPicture { picture, setting: *setting, structure_dn: usual_step_dn(case, nominal), is_one: true }
    }

    /// The same with another picture.
    pub(super) fn with(&self, picture: Picture) -> MovingPicture {
        MovingPicture { picture, setting: self.setting, structure_dn: self.structure_dn, is_one: self.is_one }
    }
}

impl Source for MovingPicture {
    fn name(&self) -> &'static str {
        if self.picture.ground.is_empty() && self.is_one { "picture" } else { "patches" }
    }

    fn log_of(&self, case: &Case, step_ns: i64, pixels: &[usize]) -> Vec<Vec<f32>> {
        let maps: Vec<_> = Light::instants(case, step_ns).map(|t_ns| self.picture.motion.at(t_ns)).collect();
        let of = |&pixel: &usize| {
            let (x, y) = case.place(pixel);
            self.picture.log_light(x as usize, y as usize, &maps).map_or_else(Vec::new, |log| log.iter().map(|u| *u as f32).collect())
        };
        pixels.iter().map(of).collect()
    }

    fn exposures_of(&self, case: &Case, step_ns: i64, pixels: &[usize]) -> Vec<Vec<f32>> {
        let maps: Vec<_> = Light::instants(case, step_ns).map(|t_ns| self.picture.motion.at(t_ns)).collect();
        let of = |&pixel: &usize| {
            let (x, y) = case.place(pixel);
            self.picture.exposures_of(x as usize, y as usize, &maps).into_iter().map(|seen| seen as f32).collect()
        };
        pixels.iter().map(of).collect()
    }

    fn gate(&self, case: &Case, least_dn: f64, spread: f64) -> Gate {
        let own = if self.picture.ground.is_empty() { 0.0 } else { self.structure_dn };
        Gate::new(case, &self.picture.residual, (f64::max(least_dn, own), self.structure_dn), spread)
    }

    fn residual(&self) -> &[f32] {
        &self.picture.residual
    }

    fn sigma(&self, nominal: &Nominal, signal: f64) -> f64 {
        self.misfit() * self.picture.sigma(nominal, signal)
    }

    fn cell(&self, case: &Case, pixel: usize, t_ns: i64, side: f64) -> Cell {
        let (x, y) = self.picture.place(case, pixel, t_ns);
        (0, (x / side).floor() as i64, (y / side).floor() as i64)
    }

    fn refit(&self, case: &Case, nominal: &Nominal) -> Result<Box<dyn Source>, String> {
        Ok(Box::new(self.with(self.picture.refit(case, nominal, &self.setting, None))))
    }

    fn rough(&self, case: &Case, nominal: &Nominal, step_ns: i64, seed: u64) -> Result<Option<Behind>, String> {
        let drawn = self.picture.drawn(case, nominal, &self.setting, None, seed);
        Ok(Some(Behind::of(case, nominal, self.with(drawn.sharpened(self.setting.sharpest)).light(case, step_ns))))
    }

    fn misfit(&self) -> f64 {
        self.picture.report.misfit.last().copied().unwrap_or(f64::NAN)
    }
}

/// Light that is known from elsewhere: a target whose motion the user states, a simulated scene, given tracks.
pub struct Given {
    light: Arc<[Knots]>,
    residual: Vec<f32>,
    misfit: f64,
    noise: (f64, f64),
}

/// The light of a pixel: instants, ns, and photocurrent, linear between; empty where it is not known.
pub type Knots = (Vec<i64>, Vec<f64>);

/// Frame values in a bin of brightness.
const BIN: usize = 64;

impl Given {
    /// Of a recording; `light` has all its pixels. Frame values count as in `setting`.
    pub fn new(case: &Case, nominal: &Nominal, light: Arc<[Knots]>, setting: &PictureSetting) -> Given {
        let mut given = Given { light, residual: Vec::new(), misfit: 1.0, noise: (setting.frame_dn, setting.frame_share) };
        given.look(case, nominal);
        given
    }

    fn look(&mut self, case: &Case, nominal: &Nominal) {
        let pixels = case.extent.pixels();
        let predicted = self.light(case, STEP_NS).frames(case, nominal);
        let left = |(k, predicted): (usize, &f32)| {
            let dn = case.dn(k / pixels, k % pixels);
            if dn >= nominal.saturation_dn { f32::NAN } else { (dn - f64::from(*predicted)) as f32 }
        };
        self.residual = predicted.iter().enumerate().map(left).collect();
        // Noise is how values of like brightness differ; what they have in common is an effect.
        let signal = |k: usize| case.dn(k / pixels, k % pixels) - f64::from(self.residual[k]) - nominal.number.black_level;
        let mut order: Vec<usize> = (0..self.residual.len()).filter(|&k| self.residual[k].is_finite()).collect();
        order.sort_by(|&a, &b| signal(a).total_cmp(&signal(b)).then(a.cmp(&b)));
        let mut shares: Vec<f64> = order
            .chunks(BIN)
            .map(|bin| {
                let mut left: Vec<f64> = bin.iter().map(|&k| f64::from(self.residual[k])).collect();
                let middle = median(&mut left);
                left.iter_mut().for_each(|r| *r = (*r - middle).abs());
                median(&mut left) / (0.6745 * nominal.frame_sigma_dn(signal(bin[bin.len() / 2]), self.noise))
            })
            .collect();
        self.misfit = if shares.is_empty() { 1.0 } else { median(&mut shares) };
    }
}

/// Light is looked at this often for frames, ns.
const STEP_NS: i64 = 100_000;

impl Source for Given {
    fn name(&self) -> &'static str {
        "given"
    }

    fn log_of(&self, case: &Case, step_ns: i64, pixels: &[usize]) -> Vec<Vec<f32>> {
        let instants: Vec<i64> = Light::instants(case, step_ns).collect();
        let of = |&pixel: &usize| -> Vec<f32> {
            let (t, photocurrent) = &self.light[pixel];
            if t.is_empty() {
                return Vec::new();
            }
            instants.iter().map(|&at_ns| ln(f64::max(at(t, photocurrent, at_ns), f64::MIN_POSITIVE)) as f32).collect()
        };
        pixels.iter().map(of).collect()
    }

    fn is_known(&self) -> bool {
        true
    }

    fn gate(&self, _case: &Case, _least_dn: f64, _spread: f64) -> Gate {
        Gate::open()
    }

    fn residual(&self) -> &[f32] {
        &self.residual
    }

    fn sigma(&self, nominal: &Nominal, signal: f64) -> f64 {
        self.misfit * nominal.frame_sigma_dn(signal, self.noise)
    }

    fn cell(&self, _case: &Case, pixel: usize, _t_ns: i64, _side: f64) -> Cell {
        (pixel as u32, 0, 0)
    }

    fn refit(&self, case: &Case, nominal: &Nominal) -> Result<Box<dyn Source>, String> {
        let mut given = Given { light: self.light.clone(), residual: Vec::new(), misfit: 1.0, noise: self.noise };
        given.look(case, nominal);
        Ok(Box::new(given))
    }

    fn rough(&self, _case: &Case, _nominal: &Nominal, _step_ns: i64, _seed: u64) -> Result<Option<Behind>, String> {
        Ok(None)
    }

    fn misfit(&self) -> f64 {
        self.misfit
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidates::{CANDIDATES, Scales, Trial};
    use crate::residual::evidence::{Evidence, EvidenceSetting, evidence};
    use crate::scenes::MadeUp;
    use photocurrent_core::Extent;

    fn seen(scene: &MadeUp, effect: Option<(&str, &str, f64)>) -> (Evidence, Option<f64>) {
        let nominal = scene.recording().unwrap().nominal().unwrap();
        let scales = Scales::of(&scene.recording().unwrap(), &nominal);
        let candidate =
            effect.map(|(id, parameter, effect_size)| (CANDIDATES.iter().find(|one| one.id == id && one.parameter == parameter).unwrap(), effect_size));
        let trial = candidate.map(|(one, effect_size)| Trial::with(&nominal, one, effect_size, &scales));
        let case = scene.recording_through(trial.as_ref()).unwrap();
        let source = Given::new(&case, &nominal, scene.light().into(), &PictureSetting::default());
        let truth = candidate.map(|(one, effect_size)| one.value(effect_size, &scales, &nominal));
        (evidence(&case, &nominal, &source, &EvidenceSetting::default()).unwrap(), truth)
    }

    #[test]
    fn on_known_light_effects_of_events_and_of_frames_come_first_with_their_size() {
        // A texture and discs, by their numbers.
        for index in 1..3 {
            let scene = MadeUp::new(3, index, Extent { width: 32, height: 24 }, 0.15);
            for effect in [("time_constant", "alpha", 1.0), ("black_level", "black_level_dn", 1.0)] {
                let (found, truth) = seen(&scene, Some(effect));
                let (best, truth) = (&found.ranked[0], truth.unwrap());
                assert_eq!(CANDIDATES[best.candidate].id, effect.0, "scene {index}: {:?}", &found.ranked[..3]);
                assert!((best.value / truth - 1.0).abs() < 0.005, "scene {index}, {}: {} is {truth}", effect.0, best.value);
            }
            let (found, _) = seen(&scene, None);
            assert!(found.ranked[0].beyond() < 0.02 && found.left[0] < 0.02, "scene {index}: {:?}", found.ranked[0]);
        }
    }
}
