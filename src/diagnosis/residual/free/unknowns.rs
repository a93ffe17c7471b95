//! Estimates parameters that the description states as a range, jointly with the scene; the range is a prior
//! with the mean and variance of a uniform distribution.

use super::super::setting::ERRORS;
use super::fit::{FitData, SceneFit};
use super::score::StepColumns;
use crate::candidates::Trial;
use crate::report::SceneEstimate;
use crate::unknowns::UnknownParameter;
use nalgebra::{DMatrix, DVector};
use photocurrent_scene::free::{FreeScene, PixelPrediction};

/// Rounds of the scene with the middle of each range, and turns of numbers and scene at most.
const ROUNDS: usize = 9;
const TURNS: usize = 10;
/// Finite differences, as a share of a range.
const PROBE: f64 = 0.01;
/// A number moves by no more than this share of its range in a turn.
const FARTHEST: f64 = 0.25;
/// Largest last step of a parameter, as a share of its standard error.
const STILL: f64 = 0.05;

/// Normal equations of the parameters over all pixels, the scene eliminated.
pub(super) struct NormalEquations {
    pub score: DVector<f64>,
    pub information: DMatrix<f64>,
    /// Prediction, and its change by a unit step of each parameter.
    pub columns: (Vec<PixelPrediction>, Vec<Vec<f32>>),
}

impl NormalEquations {
    /// Change of the events' excesses by a step of each parameter, root mean square share of their
    /// thresholds.
    fn moves(&self) -> Vec<f64> {
        let count = self.score.len();
        let (mut squares, mut events) = (vec![0.0; count], 0.0);
        for (of, columns) in self.columns.0.iter().zip(&self.columns.1) {
            let of_events = columns[of.frames.len() * count..].chunks_exact(count);
            for (event, column) in of.events.iter().zip(of_events) {
                events += 1.0;
                for (square, by) in squares.iter_mut().zip(column) {
                    let share = f64::from(*by) / event.threshold;
                    *square += share * share;
                }
            }
        }
        squares.iter().map(|square| libm::sqrt(square / f64::max(events, 1.0))).collect()
    }
}

/// Estimates parameters on a scene.
///
/// # Errors
/// When the description cannot be applied, or the parameters are not identifiable.
pub(super) fn estimate<L: FreeScene>(
    ground: &FitData<'_, L>,
    unknowns: &[UnknownParameter],
) -> Result<Vec<SceneEstimate>, String> {
    let bounds: Vec<[f64; 2]> = unknowns.iter().map(UnknownParameter::bounds).collect();
    let count = unknowns.len();
    let middle = DVector::from_fn(count, |k, _| f64::midpoint(bounds[k][0], bounds[k][1]));
    let width = |k: usize| bounds[k][1] - bounds[k][0];
    // Variance of an even distribution.
    let prior =
        DMatrix::from_fn(count, count, |i, j| if i == j { 12.0 / (width(i) * width(i)) } else { 0.0 });
    let with = |at: &DVector<f64>| {
        let nominal = unknowns
            .iter()
            .zip(at)
            .fold(ground.nominal.clone(), |with, (one, at)| one.with_estimate(&with, *at));
        Trial::nominal(&nominal)
    };
    let mut at = middle.clone();
    let mut fit = SceneFit::new(ground, &with(&at));
    fit.rounds(ROUNDS)?;
    let (mut errors, mut moves) = (vec![0.0; count], vec![0.0; count]);
    for _ in 0..TURNS {
        let moved = (0..count).map(|k| {
            let mut moved = at.clone();
            moved[k] += PROBE * width(k);
            (with(&moved), PROBE * width(k))
        });
        let normal = fit.normal(&moved.collect::<Vec<_>>())?;
        moves = normal.moves();
        let NormalEquations { score, information, columns } = normal;
        let factor = (&information + &prior).cholesky();
        let step = factor.map(|factor| factor.solve(&-(score + &prior * (&at - &middle))));
        let step = step.ok_or("what is left open of the description does not change what is measured")?;
        // Errors are larger than the information has them.
        let sure = (information / (ERRORS * ERRORS) + &prior).try_inverse();
        errors =
            (0..count).map(|k| sure.as_ref().map_or(width(k), |sure| libm::sqrt(sure[(k, k)]))).collect();
        let mut is_still = true;
        let before = at.clone();
        for k in 0..count {
            let far = FARTHEST * width(k);
            let next = (at[k] + step[k].clamp(-far, far)).clamp(bounds[k][0], bounds[k][1]);
            is_still &= (next - at[k]).abs() < STILL * errors[k];
            at[k] = next;
        }
        match L::IS_ONE {
            true => fit.follow_trial(with(&at), &columns, (&at - before).as_slice())?,
            false => fit.apply(with(&at)),
        }
        // What is left falls by a factor, and the noise that everything is weighed by with it.
        fit.release();
        fit.rounds(1)?;
        fit.settled(1)?;
        if is_still {
            break;
        }
    }
    // All events may miss in common what they miss in the median: a scene that is too soft does.
    let left = fit.median_event_misfit()?;
    let error = |k: usize| {
        let even = width(k) / libm::sqrt(12.0);
        libm::hypot(errors[k], if moves[k] > 0.0 { left / moves[k] } else { even }).min(even)
    };
    Ok(unknowns.iter().enumerate().map(|(k, one)| one.estimated(at[k], error(k))).collect())
}

impl<L: FreeScene> SceneFit<'_, L> {
    /// Score and information of steps from the fit's own sensor, each to a sensor and so far.
    pub(super) fn normal(&mut self, steps: &[(Trial, f64)]) -> Result<NormalEquations, String> {
        let prediction = self.predict()?;
        let mut prepared = vec![self.prepared(&self.trial)?];
        for (trial, _) in steps {
            prepared.push(self.prepared(trial)?);
        }
        let mut rows = self.rows(&prepared, &prediction.light).into_iter();
        let base = rows.next().unwrap_or_default();
        let moved: Vec<StepColumns> =
            rows.zip(steps).map(|(rows, (_, step))| StepColumns { rows, back: None, step: *step }).collect();
        let columns = self.ground.columns(&base, &moved);
        let predicted = self.predicted()?;
        self.light.prepare(&predicted);
        let count = steps.len();
        let scores = self.light.score(&predicted, &columns, count);
        let (score, information) = (DVector::zeros(count), DMatrix::zeros(count, count));
        let mut normal = NormalEquations { score, information, columns: (predicted, columns) };
        for (_, found) in scores.iter().enumerate().filter(|(place, _)| self.ground.has_events(*place)) {
            let Some(found) = found else { continue };
            normal.score += DVector::from_column_slice(&found.score);
            normal.information += DMatrix::from_row_slice(count, count, &found.information);
        }
        Ok(normal)
    }
}
