//! Numbers that the description states as a range, estimated with the scene: both take steps together, the
//! range as a prior (mean and variance of even probability in it).

use super::super::setting::ERRORS;
use super::fit::{Fit, Ground};
use super::score::Moved;
use crate::candidates::Trial;
use crate::report::Estimate;
use crate::unknowns::Unknown;
use nalgebra::{DMatrix, DVector};
use photocurrent_scene::free::{FreeScene, Predicted};

/// Rounds of the scene with the middle of each range, and turns of numbers and scene at most.
const ROUNDS: usize = 9;
const TURNS: usize = 10;
/// Finite differences, as a share of a range.
const PROBE: f64 = 0.01;
/// A number moves by no more than this share of its range in a turn.
const FARTHEST: f64 = 0.25;
/// Numbers that move by less than this share of their errors stand.
const STILL: f64 = 0.05;

/// What all pixels' rows have of numbers, the scene adapted.
pub(super) struct Normal {
    pub score: DVector<f64>,
    pub information: DMatrix<f64>,
    /// What is predicted, and what a step of each number changes of it.
    pub columns: (Vec<Predicted>, Vec<Vec<f32>>),
}

impl Normal {
    /// What a step of each number changes of events' excesses, root mean square shares of their thresholds.
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

/// Estimates numbers on a scene.
///
/// # Errors
/// When the description cannot be applied, or nothing is known of the numbers.
pub(super) fn estimate<L: FreeScene>(
    ground: &Ground<'_, L>,
    unknowns: &[Unknown],
) -> Result<Vec<Estimate>, String> {
    let bounds: Vec<[f64; 2]> = unknowns.iter().map(Unknown::bounds).collect();
    let count = unknowns.len();
    let middle = DVector::from_fn(count, |k, _| f64::midpoint(bounds[k][0], bounds[k][1]));
    let width = |k: usize| bounds[k][1] - bounds[k][0];
    // Variance of an even distribution.
    let prior =
        DMatrix::from_fn(count, count, |i, j| if i == j { 12.0 / (width(i) * width(i)) } else { 0.0 });
    let with = |at: &DVector<f64>| {
        let nominal =
            unknowns.iter().zip(at).fold(ground.nominal.clone(), |with, (one, at)| one.put(&with, *at));
        Trial::stated(&nominal)
    };
    let mut at = middle.clone();
    let mut fit = Fit::begin(ground, &with(&at));
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
        let Normal { score, information, columns } = normal;
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
            true => fit.follow(with(&at), &columns, (&at - before).as_slice())?,
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
    let left = fit.left()?;
    let error = |k: usize| {
        let even = width(k) / libm::sqrt(12.0);
        libm::hypot(errors[k], if moves[k] > 0.0 { left / moves[k] } else { even }).min(even)
    };
    Ok(unknowns.iter().enumerate().map(|(k, one)| one.estimated(at[k], error(k))).collect())
}

impl<L: FreeScene> Fit<'_, L> {
    /// Score and information of steps from the fit's own sensor, each to a sensor and so far.
    pub(super) fn normal(&mut self, steps: &[(Trial, f64)]) -> Result<Normal, String> {
        let prediction = self.predict()?;
        let mut prepared = vec![self.prepared(&self.trial)?];
        for (trial, _) in steps {
            prepared.push(self.prepared(trial)?);
        }
        let mut rows = self.rows(&prepared, &prediction.light).into_iter();
        let base = rows.next().unwrap_or_default();
        let moved: Vec<Moved> =
            rows.zip(steps).map(|(rows, (_, step))| Moved { rows, back: None, step: *step }).collect();
        let columns = self.ground.columns(&base, &moved);
        let predicted = self.predicted()?;
        self.light.prepare(&predicted);
        let count = steps.len();
        let scores = self.light.score(&predicted, &columns, count);
        let (score, information) = (DVector::zeros(count), DMatrix::zeros(count, count));
        let mut normal = Normal { score, information, columns: (predicted, columns) };
        for (_, found) in scores.iter().enumerate().filter(|(place, _)| self.ground.has_events(*place)) {
            let Some(found) = found else { continue };
            normal.score += DVector::from_column_slice(&found.score);
            normal.information += DMatrix::from_row_slice(count, count, &found.information);
        }
        Ok(normal)
    }
}
