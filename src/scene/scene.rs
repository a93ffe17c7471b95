//! The trait of scenes: a moving picture, patches of it, a known target, known light.

use crate::block::Block;
use crate::case::Case;
use crate::gate::PredictionGate;
use crate::light::LogLight;
use crate::nominal::Nominal;
use crate::statistics::median;
use rayon::prelude::*;
use std::any::Any;

/// A part of the scene and a cell of it.
pub type SceneCell = (u32, i64, i64);

/// Allowance for frame errors that are due to the scene itself, DN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameTolerance {
    /// Any value.
    pub any_dn: f64,
    /// Allowance for errors common to neighbouring values.
    pub alike_dn: f64,
}

/// A scene that is estimated from frames, or stated by the user, without the events to be explained.
pub trait Scene: Sync {
    /// In a word, for reports.
    fn name(&self) -> &'static str;

    /// Natural logarithm of the photocurrent of some pixels (`y * width + x`) at the instants of
    /// [`LogLight::blank`], steps in ns; empty where it is not known.
    fn log_light(&self, case: &Case, step_ns: i64, pixels: &[usize]) -> Vec<Vec<f32>>;

    /// Number of exposures that recorded the place of the scene at each of some pixels, at the same instants;
    /// empty where the scene is known without frames.
    fn exposures_seen(&self, _case: &Case, _step_ns: i64, pixels: &[usize]) -> Vec<Vec<f32>> {
        vec![Vec::new(); pixels.len()]
    }

    /// Residual of every frame value, DN as [frame][y][x]; NaN where it took no part.
    fn residual(&self) -> &[f32];

    /// Standard deviation of a frame value of `signal` DN above black, DN: as assumed, times
    /// [`Scene::misfit`].
    fn sigma(&self, nominal: &Nominal, signal: f64) -> f64;

    /// Median absolute residual of frames, standard deviations as they were first assumed; 1 when the noise
    /// explains it.
    fn misfit(&self) -> f64;

    /// Allowance for frame errors of the scene; `None` where it is known without the recording's frames.
    /// Effects of frames then show in frame values and not in the light that frames imply.
    fn tolerance(&self) -> Option<FrameTolerance>;

    /// The part of the scene that lies on a pixel at an instant, ns, and the place in it, pixels.
    fn part_and_place(&self, case: &Case, pixel: usize, t_ns: i64) -> (u32, f64, f64);

    /// The same scene fitted anew to another recording of it.
    ///
    /// # Errors
    /// When that recording's frames cannot be fitted.
    fn refit(&self, case: &Case, nominal: &Nominal) -> Result<Box<dyn Scene>, String>;

    /// A posterior sample of the scene, sharpened to the resolution limit of the fit; none where the scene is
    /// known exactly.
    ///
    /// # Errors
    /// When the recording's frames cannot be fitted.
    fn posterior_sample(
        &self,
        case: &Case,
        nominal: &Nominal,
        seed: u64,
    ) -> Result<Option<Box<dyn Scene>>, String>;

    /// Itself, for downcasts to a kind of scene; `None` where no kind needs that.
    fn as_any(&self) -> Option<&dyn Any> {
        None
    }

    /// Its free parameters, of a target.
    fn target(&self) -> Option<&dyn FreeParameters> {
        None
    }
}

/// A scene in closed form with free parameters that were fitted.
pub trait FreeParameters: Sync {
    /// Each free parameter's place in its range, 0 to 1, and the step of its derivatives, a share of the
    /// range, away from the nearer end.
    fn free(&self) -> Vec<(f64, f64)>;

    /// The light of some pixels (of all where there is no list) with free parameters moved by shares of their
    /// ranges; none where they make no scene.
    fn moved_light(&self, case: &Case, step_ns: i64, pixels: Option<&[u32]>, by: &[f64]) -> Option<LogLight>;
}

impl dyn Scene + '_ {
    /// Is it known without the recording's frames?
    pub fn is_known(&self) -> bool {
        self.tolerance().is_none()
    }

    /// Log photocurrent of every pixel at steady instants; empty where it is not known.
    pub fn light(&self, case: &Case, step_ns: i64) -> LogLight {
        self.light_of(case, step_ns, &Block::whole_array(case.extent))
    }

    /// The same of a block of pixels; empty elsewhere.
    pub(crate) fn light_of(&self, case: &Case, step_ns: i64, block: &Block) -> LogLight {
        let mut light = LogLight::blank(case, step_ns);
        let pixels: Vec<usize> = block.pixels(case.extent).iter().map(|pixel| *pixel as usize).collect();
        let rows = pixels.par_chunks(block.width.max(1));
        let log: Vec<Vec<f32>> = rows.flat_map(|row| self.log_light(case, step_ns, row)).collect();
        pixels.iter().zip(log).for_each(|(pixel, log)| light.log[*pixel] = log);
        light
    }

    /// Frames predicted by this scene, DN as [frame][y][x]; NaN outside of it.
    pub fn frames(&self, case: &Case) -> Vec<f32> {
        let pixels = case.extent.pixels();
        let of =
            |(n, residual): (usize, &f32)| (case.dn(n / pixels, n % pixels) - f64::from(*residual)) as f32;
        self.residual().iter().enumerate().map(of).collect()
    }

    /// The gate of events: frames must be predicted to `least_dn`, or to `spread` median absolute deviations.
    pub fn gate(&self, case: &Case, least_dn: f64, spread: f64) -> PredictionGate {
        self.tolerance().map_or_else(PredictionGate::accept_all, |FrameTolerance { any_dn, alike_dn }| {
            PredictionGate::new(case, self.residual(), (f64::max(least_dn, any_dn), alike_dn), spread)
        })
    }

    /// The cell of `side` pixels at a pixel at an instant, ns: errors of the scene are common to all pixels
    /// on one cell.
    pub fn cell(&self, case: &Case, pixel: usize, t_ns: i64, side: f64) -> SceneCell {
        let (part, x, y) = self.part_and_place(case, pixel, t_ns);
        (part, (x / side).floor() as i64, (y / side).floor() as i64)
    }
}

/// Where something moves before something else, most frame values are those of what stands still and do not
/// constrain how well the rest is predicted: errors below this share of a threshold
/// are small enough for its events.
pub const STEP: f64 = 0.15;

/// [`STEP`] of a threshold as a change of a usual frame value, DN.
pub(crate) fn usual_step_dn(case: &Case, nominal: &Nominal) -> f64 {
    let mut signals: Vec<f64> = case
        .frames
        .iter()
        .flat_map(|frames| frames.every_nth(7))
        .map(|dn| f64::from(dn) - nominal.number.black_level)
        .collect();
    signals.retain(|signal| *signal > 0.0);
    let threshold = 0.5 * (nominal.pixel.threshold_on + nominal.pixel.threshold_off);
    if signals.is_empty() { 0.0 } else { STEP * threshold * median(&mut signals) }
}
