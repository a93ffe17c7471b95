//! Efficient scores of effects on a joint picture, and gains with a joint step.

use super::normal::NormalFactor;
use super::problem::{CurrentPicture, JointRows};
use crate::free::{MOST_OF_RISE, PixelPrediction, PredictedEvent, Score};
use rayon::prelude::*;

/// Contribution of each pixel's rows to the scores of effects; `None` where there is none. `columns`: as in
/// [`crate::free::FreeScene::score`], of `effects` effects.
pub(super) fn scores(
    standing: &CurrentPicture<'_>,
    problem: &JointRows,
    factor: &NormalFactor,
    predicted: &[PixelPrediction],
    (columns, effects): (&[Vec<f32>], usize),
) -> Vec<Option<Score>> {
    let count = standing.coefficients();
    let all = standing.unknowns().len();
    let column =
        |r: usize| &columns[problem.place[r] as usize][problem.row_of(r, predicted) * effects..][..effects];
    let mut sides = vec![vec![0.0; all]; effects];
    for r in problem.used() {
        for (side, by) in sides.iter_mut().zip(column(r)).filter(|(_, by)| **by != 0.0) {
            problem.add_row(r, problem.weight[r] * f64::from(*by), side, count);
        }
    }
    sides.push(standing.gradient(problem));
    factor.solve(&mut sides);
    let mut scores: Vec<Option<Score>> = predicted.iter().map(|_| None).collect();
    let mut moved = vec![0.0; effects];
    for r in problem.used() {
        let column = column(r);
        if column.iter().all(|by| *by == 0.0) {
            continue;
        }
        let of = scores[problem.place[r] as usize].get_or_insert_with(|| Score {
            score: vec![0.0; effects],
            information: vec![0.0; effects * effects],
            known: vec![0.0; effects],
        });
        let weight = problem.weight[r];
        let left = problem.residual[r] - problem.directional_derivative(r, &sides[effects], count);
        for (k, moved) in moved.iter_mut().enumerate() {
            *moved = f64::from(column[k]) - problem.directional_derivative(r, &sides[k], count);
        }
        for (k, by) in column.iter().enumerate().filter(|(_, by)| **by != 0.0) {
            let by = weight * f64::from(*by);
            of.score[k] += by * left;
            of.known[k] += by * f64::from(column[k]);
            let to = &mut of.information[k * effects..][..effects];
            to.iter_mut().zip(&moved).for_each(|(to, moved)| *to += by * moved);
        }
    }
    scores
}

/// The step of all unknowns while effects change by these sizes.
pub(super) fn step_with(
    standing: &CurrentPicture<'_>,
    problem: &JointRows,
    factor: &NormalFactor,
    predicted: &[PixelPrediction],
    (columns, sizes): (&[Vec<f32>], &[f64]),
) -> Vec<f64> {
    let (effects, count) = (sizes.len(), standing.coefficients());
    let mut side = vec![standing.gradient(problem)];
    for r in problem.used() {
        let column = &columns[problem.place[r] as usize][problem.row_of(r, predicted) * effects..][..effects];
        let by: f64 = column.iter().zip(sizes).map(|(by, size)| f64::from(*by) * size).sum();
        if by != 0.0 {
            problem.add_row(r, problem.weight[r] * by, &mut side[0], count);
        }
    }
    factor.solve(&mut side);
    side[0].iter().map(|by| -by).collect()
}

/// Gain of effects of `sizes` from each pixel, nats, with a step of all unknowns, less the gain of that step
/// without the effect. `left_out`: log densities of each pixel's events, given a prediction.
pub(super) fn gains(
    standing: &CurrentPicture<'_>,
    problem: &JointRows,
    factor: &NormalFactor,
    predicted: &[PixelPrediction],
    (columns, sizes): (&[Vec<f32>], &[f64]),
    left_out: impl Fn(&[PixelPrediction]) -> Vec<f64> + Sync,
) -> Vec<Vec<f64>> {
    let (effects, count) = (sizes.len(), standing.coefficients());
    let mut sides = vec![standing.gradient(problem); effects + 1];
    for r in problem.used() {
        let column = &columns[problem.place[r] as usize][problem.row_of(r, predicted) * effects..][..effects];
        for ((side, by), size) in sides.iter_mut().zip(column).zip(sizes) {
            let by = f64::from(*by) * size;
            if by != 0.0 {
                problem.add_row(r, problem.weight[r] * by, side, count);
            }
        }
    }
    factor.solve(&mut sides);
    let with = |k: usize| -> Vec<f64> {
        let mut moved = predicted.to_vec();
        let size = sizes.get(k).copied().unwrap_or(0.0);
        for r in 0..problem.frames() {
            let (place, n) = (problem.place[r] as usize, problem.number[r] as usize);
            let Some(frame) = moved[place].frames.get_mut(n) else { continue };
            let by = if k < effects { size * f64::from(columns[place][n * effects + k]) } else { 0.0 };
            frame.residual_dn += by - problem.directional_derivative(r, &sides[k], count);
        }
        for r in problem.event_rows() {
            let (place, n) = (problem.place[r] as usize, problem.number[r] as usize);
            let (frames, events) = (predicted[place].frames.len(), predicted[place].events.len());
            let by = |row: usize| {
                if k < effects { size * f64::from(columns[place][row * effects + k]) } else { 0.0 }
            };
            let event: &mut PredictedEvent = &mut moved[place].events[n];
            event.excess += by(frames + n) - problem.directional_derivative(r, &sides[k], count);
            let of_rise = by(frames + events + n)
                - problem.directional_derivative(r + problem.events.len(), &sides[k], count);
            event.rise_per_s *= libm::exp(of_rise.clamp(-MOST_OF_RISE, MOST_OF_RISE));
        }
        left_out(&moved)
    };
    let all: Vec<Vec<f64>> = (0..=effects).into_par_iter().map(with).collect();
    let of = |place: usize| (0..effects).map(|k| all[k][place] - all[effects][place]).collect();
    (0..predicted.len()).map(of).collect()
}
