//! How a recording differs from what the nominal sensor would have recorded of the same scene, in summaries; and how it would differ with an effect.
//!
//! The scene is the recording's own, through its events and anchored to its frames ([`Band`]), so it absorbs part of every effect. A template goes the whole
//! way as well: the effect is put on, the scene is estimated anew from what was recorded with it, and the nominal sensor records that scene. What is absorbed in
//! a recording is absorbed in the template.

use crate::band::Band;
use crate::candidates::{Scales, Trial};
use crate::case::Case;
use crate::nominal::Nominal;
use crate::record::{Conditions, record};
use crate::sample::Sample;
use crate::scene::Scene;
use crate::summaries::{Summaries, View, context, summaries};

/// Blocks across for a deviation that is to be judged.
pub const FULL: u32 = 3;
/// Blocks across for templates.
pub const LEAN: u32 = 1;

/// A recording prepared for comparison.
pub struct Prepared<'a> {
    /// The recording.
    pub case: &'a Case,
    /// Its sensor as stated.
    pub nominal: Nominal,
    /// Pixels that are looked at.
    pub sample: Sample,
    /// How bright, fast and busy it is.
    pub scales: Scales,
    /// Its scene, anchored.
    pub scene: Scene,
    /// What simulated recordings of it add.
    pub conditions: Conditions,
    /// Its summaries.
    pub own: Summaries,
    /// Those less the nominal sensor's of the same scene.
    pub deviation: Vec<f64>,
    /// What kind of recording it is.
    pub context: Vec<f64>,
}

impl<'a> Prepared<'a> {
    /// Samples, reconstructs and compares a recording. `across` is how many blocks are taken from each band of six rows ([`Sample::spread`]):
    /// [`FULL`] for a deviation that is to be judged, [`LEAN`] for templates, which have little noise.
    ///
    /// # Errors
    /// When effects of its description are not understood.
    pub fn new(case: &'a Case, nominal: Nominal, across: u32, seed: u64) -> Result<Prepared<'a>, String> {
        let sample = Sample::spread(case, across);
        let scales = Scales::of(case, &nominal);
        let bands = Band::all(case, &nominal, &sample);
        let view = View { case, nominal: &nominal, sample: &sample, bands: &bands, scales: &scales };
        let own = summaries(&view);
        let context = context(&view, &own);
        let scene = Band::scene(case, &bands);
        let conditions = Conditions { seed, ..Conditions::default() };
        let mut prepared = Prepared { case, nominal, sample, scales, scene, conditions, own, deviation: Vec::new(), context };
        prepared.conditions.frame_share = frame_noise(case, &prepared.nominal, &prepared.sample, &prepared.scene, &bands)?;
        prepared.deviation = prepared.against_nominal(case, &prepared.scene, &prepared.own, seed)?;
        Ok(prepared)
    }

    /// How a recording of this scene with a trial's sensor would differ from the nominal one: a template, noise included.
    ///
    /// # Errors
    /// When the trial's effects are not understood or cannot be combined.
    pub fn template(&self, trial: &Trial, seed: u64) -> Result<Vec<f64>, String> {
        let conditions = Conditions { seed, ..self.conditions };
        let recorded = record(self.case, &trial.nominal, &self.sample, &self.scene, &trial.effects, &conditions)?;
        let bands = Band::all(&recorded, &self.nominal, &self.sample);
        let own = summaries(&View { case: &recorded, nominal: &self.nominal, sample: &self.sample, bands: &bands, scales: &self.scales });
        let scene = Band::scene(&recorded, &bands);
        self.against_nominal(&recorded, &scene, &own, seed)
    }

    fn against_nominal(&self, case: &Case, scene: &Scene, own: &Summaries, seed: u64) -> Result<Vec<f64>, String> {
        // Another seed: noise of the comparison must not be the noise of the recording.
        let conditions = Conditions { seed: seed ^ 0x5eed, ..self.conditions };
        let again = record(case, &self.nominal, &self.sample, scene, &Default::default(), &conditions)?;
        let bands = Band::all(&again, &self.nominal, &self.sample);
        let nominal = summaries(&View { case: &again, nominal: &self.nominal, sample: &self.sample, bands: &bands, scales: &self.scales });
        Ok(own.values.iter().zip(&nominal.values).map(|(own, nominal)| own - nominal).collect())
    }
}

/// What kind of recording it is ([`crate::summaries::context`]).
pub fn context_of(case: &Case, nominal: &Nominal) -> Vec<f64> {
    let sample = Sample::spread(case, FULL);
    let bands = Band::all(case, nominal, &sample);
    let view = View { case, nominal, sample: &sample, bands: &bands, scales: &Scales::of(case, nominal) };
    context(&view, &summaries(&view))
}

/// Noise of frame values that is not stated, as a share of the signal.
///
/// # Errors
/// When effects of the description are not understood.
pub fn unstated_frame_noise(case: &Case, nominal: &Nominal) -> Result<f64, String> {
    let sample = Sample::spread(case, FULL);
    let bands = Band::all(case, nominal, &sample);
    frame_noise(case, nominal, &sample, &Band::scene(case, &bands), &bands)
}

/// Roughness of closures beyond what the nominal sensor's recording of the scene has.
fn frame_noise(case: &Case, nominal: &Nominal, sample: &Sample, scene: &Scene, bands: &[Band]) -> Result<f64, String> {
    let own = roughness(case, sample, bands);
    let again = record(case, nominal, sample, scene, &Default::default(), &Conditions::default())?;
    let modelled = roughness(&again, sample, &Band::all(&again, nominal, sample));
    let rest = own * own - modelled * modelled;
    // Model error of half a percent is everywhere.
    Ok(libm::sqrt(f64::max(rest - 0.005 * 0.005, 0.0)))
}

/// The part of closures that is white both from frame to frame and from pixel to pixel, as a standard deviation of frame values' logarithm.
fn roughness(case: &Case, sample: &Sample, bands: &[Band]) -> f64 {
    let width = case.extent.width as usize;
    let bend = |place: usize, frame: usize| -> Option<f64> {
        let frames = &bands[place].frames;
        let at = frames.iter().position(|f| f.frame == frame)?;
        let (before, after) = (at.checked_sub(1).and_then(|at| frames.get(at))?, frames.get(at + 1)?);
        Some(frames[at].closure - 0.5 * (before.closure + after.closure))
    };
    let mut rough: Vec<f64> = Vec::new();
    for (n, pixel) in sample.pixels.iter().enumerate().filter(|(n, _)| sample.is_inner[*n]) {
        let pixel = *pixel as usize;
        for frame in (1..case.frame_count()).step_by(2) {
            let around: Vec<f64> = [pixel - 1, pixel + 1, pixel - width, pixel + width]
                .into_iter()
                .filter_map(|other| sample.place(other).and_then(|place| bend(place, frame)))
                .collect();
            if let (4, Some(own)) = (around.len(), bend(n, frame)) {
                rough.push((own - around.iter().sum::<f64>() / 4.0).abs());
            }
        }
    }
    rough.sort_by(f64::total_cmp);
    // The quarter with the least: there light is smooth, and the noise is all there is. For a normal distribution it is 0.319 sigma.
    crate::summaries::quantile(&rough, 0.25) / 0.319 / libm::sqrt(1.5 * 1.25)
}
