//! Exact fits: scene and size of an effect, in turn and together.

use super::super::evidence::RankedEffect;
use super::super::setting::{ERRORS, LARGEST_EFFECT_SIZE};
use super::fit::{FitData, SceneFit};
use super::places::BaseFit;
use crate::candidates::{CANDIDATES, Signs, Trial};
use photocurrent_scene::free::{FreeScene, PixelPrediction};

/// Steps of a size that fall by a share of the last go as far as all that would follow (Aitken); a share of
/// at most this.
const SLOWEST: f64 = 0.6;
/// A size that moves by less than this share needs no further correction.
const STILL: f64 = 0.003;

/// Where the last correction changed what is left of a scene that is one problem by more than this, nats an
/// event, more follow: up to so many in all. A clock's offset of 1 ms before noisy frames came to 1.74
/// effect sizes of 1.82 with three, and gained a fifth of what it does.
const STILL_CHANGES: f64 = 0.01;
const MOST_CORRECTIONS: usize = 9;

/// A fit of an effect with its size.
pub(super) struct ExactFit<'a, L> {
    pub candidate: usize,
    pub effect_size: f64,
    /// Standard error of it.
    pub error: f64,
    pub fit: SceneFit<'a, L>,
    /// Of each pixel, nats.
    pub left_out: Vec<f64>,
    pub predicted: Vec<PixelPrediction>,
}

impl<'a, L: FreeScene> SceneFit<'a, L> {
    /// Changes the sensor to `trial`. The light takes a step with it where that lowers the misfit. `columns`:
    /// prediction before, and its change by the sensor's `steps`.
    pub(super) fn follow_trial(
        &mut self,
        trial: Trial,
        (predicted, columns): &(Vec<PixelPrediction>, Vec<Vec<f32>>),
        steps: &[f64],
    ) -> Result<(), String> {
        let before = self.light.objective(predicted);
        let still = self.light.clone();
        self.light.step_with_effects(predicted, columns, steps);
        self.apply(trial);
        self.predict()?;
        let moved = self.light.objective(&self.predicted()?);
        if moved < before {
            return Ok(());
        }
        let followed = (std::mem::replace(&mut self.light, still), self.current.take());
        self.predict()?;
        if moved < self.light.objective(&self.predicted()?) {
            (self.light, self.current) = followed;
        }
        Ok(())
    }

    /// Estimates light and effect size alternately; effects applied before keep their sizes. `corrections`:
    /// least number of corrections; more follow while the misfit changes.
    pub(super) fn exact(
        &self,
        candidate: usize,
        begin: f64,
        corrections: usize,
    ) -> Result<ExactFit<'a, L>, String> {
        let is_switch = CANDIDATES[candidate].signs == Signs::Switch;
        let (mut effect_size, mut error) = (0.0, 0.0);
        let mut next = if is_switch { 1.0 } else { bounded(candidate, begin) };
        let mut is_still = is_switch;
        let mut fit = self.clone();
        let mut last: Option<f64> = None;
        let mut left = f64::INFINITY;
        let mut column = if L::IS_ONE { fit.score_effects(&[candidate], None)?.column } else { None };
        let most = if L::IS_ONE { corrections.max(MOST_CORRECTIONS) } else { corrections };
        for turn in 0..most {
            let trial = self.trial_with(candidate, next);
            match column.take() {
                Some(column) => fit.follow_trial(trial, &column, &[next - effect_size])?,
                None => fit.apply(trial),
            }
            effect_size = next;
            fit.applied = self.applied.clone();
            fit.applied.push((candidate, effect_size));
            fit.newton_rounds(self.ground.steps)?;
            if is_still || turn + 1 == most {
                break;
            }
            if L::IS_ONE {
                let before = std::mem::replace(&mut left, fit.light.objective(&fit.predicted()?));
                let moves = (before - left).abs() > STILL_CHANGES * fit.ground.scored_events() as f64;
                if turn + 1 >= corrections && !moves {
                    break;
                }
            }
            let scored = fit.score_effects(&[candidate], None)?;
            if let Some(step) = scored.sizes[0] {
                let most = 1.0 + effect_size.abs();
                let falls = last.filter(|_| L::IS_ONE).map_or(0.0, |last| (step / last).clamp(0.0, SLOWEST));
                last = Some(step);
                let step = step / (1.0 - falls);
                is_still = step.abs() < STILL * effect_size.abs();
                next = bounded(candidate, effect_size + step.clamp(-most, most));
                error = ERRORS / scored.information[0].sqrt();
            }
            column = scored.column.filter(|_| L::IS_ONE);
        }
        ExactFit::from_fit(candidate, (effect_size, error), fit)
    }
}

/// Sizes within physics.
pub(super) fn bounded(candidate: usize, effect_size: f64) -> f64 {
    let most = LARGEST_EFFECT_SIZE;
    let least = if CANDIDATES[candidate].signs == Signs::Both { -most } else { 1e-3 };
    effect_size.clamp(least, most)
}

impl<'a, L: FreeScene> ExactFit<'a, L> {
    /// The current fit with the effect's size and its standard error.
    pub(super) fn from_fit(
        candidate: usize,
        (effect_size, error): (f64, f64),
        mut fit: SceneFit<'a, L>,
    ) -> Result<ExactFit<'a, L>, String> {
        let predicted = fit.predicted()?;
        let left_out = fit.light.left_out(&predicted);
        fit.release();
        Ok(ExactFit { candidate, effect_size, error, fit, left_out, predicted })
    }

    /// Takes the place of a first size and gain.
    pub(super) fn replace(&self, one: &mut RankedEffect, level: &BaseFit, ground: &FitData<'_, L>) {
        let gains: Vec<f64> = self
            .left_out
            .iter()
            .zip(&level.left_out)
            .enumerate()
            .filter(|(place, _)| ground.is_measured(*place))
            .map(|(_, (with, without))| with - without)
            .collect();
        let events = ground.events() as f64;
        let sum: f64 = gains.iter().sum();
        let mean = sum / gains.len().max(1) as f64;
        let square: f64 = gains.iter().map(|gain| (gain - mean) * (gain - mean)).sum();
        one.gain = sum / events;
        one.gain_error = square.sqrt() / events;
        one.effect_size = self.effect_size;
        one.error = f64::max(self.error, one.error);
        one.value = CANDIDATES[self.candidate].value(self.effect_size, ground.scales, ground.nominal);
        one.is_exact = true;
        one.located = self
            .fit
            .own
            .is_none()
            .then(|| level.locate(ground, self.candidate, (&self.fit.light, &self.predicted)));
    }
}
