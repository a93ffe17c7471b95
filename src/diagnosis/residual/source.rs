//! The scene that residuals are taken on, whoever states it: a moving picture, patches of it, a known target.

use super::light::Light;
use crate::case::Case;
use crate::nominal::Nominal;
use crate::picture::{Picture, PictureSetting};
use rayon::prelude::*;

/// What a pixel looks at: a part of the scene and a cell of it.
pub type Cell = (u32, i64, i64);

/// A scene that frames (or the user) state without the events that are to be explained.
pub trait Source: Sync {
    /// In a word, for reports.
    fn name(&self) -> &'static str;

    /// Log photocurrent of every pixel at steady instants; empty where it is not known.
    fn light(&self, case: &Case, step_ns: i64) -> Light;

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

    /// The same scene with what is left open about it drawn at random, for a control; itself where nothing is.
    ///
    /// # Errors
    /// When the recording's frames cannot be fitted.
    fn drawn(&self, case: &Case, nominal: &Nominal, seed: u64) -> Result<Option<Box<dyn Source>>, String>;

    /// The frames that this scene gives, DN as [frame][y][x]; NaN where it does not reach.
    fn frames(&self, case: &Case) -> Vec<f32> {
        let pixels = case.extent.pixels();
        self.residual().iter().enumerate().map(|(n, residual)| (case.dn(n / pixels, n % pixels) - f64::from(*residual)) as f32).collect()
    }

    /// Median absolute residual of frames, standard deviations as they were first assumed; 1 when the noise explains it.
    fn misfit(&self) -> f64;
}

/// One moving picture, with how it was fitted.
pub struct MovingPicture {
    /// The picture.
    pub picture: Picture,
    /// How it was fitted.
    pub setting: PictureSetting,
}

impl MovingPicture {
    /// Fits one to a recording's frames.
    ///
    /// # Errors
    /// As [`Picture::fit`].
    pub fn fit(case: &Case, nominal: &Nominal, setting: &PictureSetting) -> Result<MovingPicture, String> {
        Ok(MovingPicture { picture: Picture::fit(case, nominal, setting)?, setting: *setting })
    }
}

impl Source for MovingPicture {
    fn name(&self) -> &'static str {
        "picture"
    }

    fn light(&self, case: &Case, step_ns: i64) -> Light {
        let mut light = Light::blank(case, step_ns);
        let maps: Vec<_> = (0..light.count).map(|k| self.picture.motion.at(light.instant(k))).collect();
        let of = |pixel: usize| {
            let (x, y) = case.place(pixel);
            self.picture.log_light(x as usize, y as usize, &maps).map_or_else(Vec::new, |log| log.iter().map(|u| *u as f32).collect())
        };
        light.log = (0..case.extent.pixels()).into_par_iter().map(of).collect();
        light
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
        Ok(Box::new(MovingPicture { picture: self.picture.refit(case, nominal, &self.setting), setting: self.setting }))
    }

    fn drawn(&self, case: &Case, nominal: &Nominal, seed: u64) -> Result<Option<Box<dyn Source>>, String> {
        Ok(Some(Box::new(MovingPicture { picture: self.picture.drawn(case, nominal, &self.setting, seed), setting: self.setting })))
    }

    fn misfit(&self) -> f64 {
        self.picture.report.misfit.last().copied().unwrap_or(f64::NAN)
    }
}
