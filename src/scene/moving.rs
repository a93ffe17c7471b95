//! One moving picture of the whole array, as a scene.

use crate::case::Case;
use crate::light::LogLight;
use crate::nominal::Nominal;
use crate::picture::{PictureSetting, ScenePicture};
use crate::scene::{FrameTolerance, Scene, usual_step_dn};
use std::any::Any;

/// One moving picture, with how it was fitted.
#[derive(Clone, Debug)]
pub struct MovingPicture {
    /// The picture.
    pub picture: ScenePicture,
    /// How it was fitted.
    pub setting: PictureSetting,
    /// Allowance for errors common to neighbouring values, DN; and for any value where the picture moves
    /// before a still ground.
    pub structure_dn: f64,
    /// Does the scene move as one? Not where pictures of some parts of it predict them better.
    pub is_one: bool,
}

impl MovingPicture {
    /// Fits one to a recording's frames.
    ///
    /// # Errors
    /// As [`ScenePicture::fit`].
    pub fn fit(case: &Case, nominal: &Nominal, setting: &PictureSetting) -> Result<MovingPicture, String> {
        MovingPicture::fit_where(case, nominal, setting, None)
    }

    /// The same, to the values of selected pixels.
    pub(crate) fn fit_where(
        case: &Case,
        nominal: &Nominal,
        setting: &PictureSetting,
        selected: Option<&[bool]>,
    ) -> Result<MovingPicture, String> {
        Ok(MovingPicture::new(
            ScenePicture::fit_where(case, nominal, setting, selected)?,
            setting,
            case,
            nominal,
        ))
    }

    /// Of a picture that was fitted.
    pub fn new(
        picture: ScenePicture,
        setting: &PictureSetting,
        case: &Case,
        nominal: &Nominal,
    ) -> MovingPicture {
        MovingPicture { picture, setting: *setting, structure_dn: usual_step_dn(case, nominal), is_one: true }
    }

    /// The same with another picture.
    pub(crate) fn with_picture(&self, picture: ScenePicture) -> MovingPicture {
        MovingPicture { picture, setting: self.setting, structure_dn: self.structure_dn, is_one: self.is_one }
    }
}

impl Scene for MovingPicture {
    fn name(&self) -> &'static str {
        if self.picture.ground.is_empty() && self.is_one { "picture" } else { "patches" }
    }

    fn log_light(&self, case: &Case, step_ns: i64, pixels: &[usize]) -> Vec<Vec<f32>> {
        let maps: Vec<_> =
            LogLight::instants(case, step_ns).map(|t_ns| self.picture.motion.at(t_ns)).collect();
        let of = |&pixel: &usize| {
            let (x, y) = case.pixel_place(pixel);
            self.picture
                .log_light(x as usize, y as usize, &maps)
                .map_or_else(Vec::new, |log| log.iter().map(|u| *u as f32).collect())
        };
        pixels.iter().map(of).collect()
    }

    fn exposures_seen(&self, case: &Case, step_ns: i64, pixels: &[usize]) -> Vec<Vec<f32>> {
        let maps: Vec<_> =
            LogLight::instants(case, step_ns).map(|t_ns| self.picture.motion.at(t_ns)).collect();
        let of = |&pixel: &usize| {
            let (x, y) = case.pixel_place(pixel);
            self.picture
                .exposures_seen(x as usize, y as usize, &maps)
                .into_iter()
                .map(|seen| seen as f32)
                .collect()
        };
        pixels.iter().map(of).collect()
    }

    fn tolerance(&self) -> Option<FrameTolerance> {
        let any_dn = if self.picture.ground.is_empty() { 0.0 } else { self.structure_dn };
        Some(FrameTolerance { any_dn, alike_dn: self.structure_dn })
    }

    fn residual(&self) -> &[f32] {
        &self.picture.residual
    }

    fn sigma(&self, nominal: &Nominal, signal: f64) -> f64 {
        self.misfit() * self.picture.sigma(nominal, signal)
    }

    fn part_and_place(&self, case: &Case, pixel: usize, t_ns: i64) -> (u32, f64, f64) {
        let (x, y) = self.picture.place_on_picture(case, pixel, t_ns);
        (0, x, y)
    }

    fn refit(&self, case: &Case, nominal: &Nominal) -> Result<Box<dyn Scene>, String> {
        Ok(Box::new(self.with_picture(self.picture.refit(case, nominal, &self.setting, None))))
    }

    fn posterior_sample(
        &self,
        case: &Case,
        nominal: &Nominal,
        seed: u64,
    ) -> Result<Option<Box<dyn Scene>>, String> {
        let drawn = self.picture.posterior_sample(case, nominal, &self.setting, None, seed);
        Ok(Some(Box::new(self.with_picture(drawn.sharpened(self.setting.sharpest)))))
    }

    fn as_any(&self) -> Option<&dyn Any> {
        Some(self)
    }

    fn misfit(&self) -> f64 {
        self.picture.report.misfit.last().copied().unwrap_or(f64::NAN)
    }
}
