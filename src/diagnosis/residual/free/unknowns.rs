//! Numbers that the description states as a range, estimated with the scene: scene and numbers in turn, the
//! range as a prior (mean and variance of even probability in it).

use super::fit::{ERRORS, Fit, Ground};
use super::score::Moved;
use crate::candidates::Trial;
use crate::report::Estimate;
use crate::unknowns::Unknown;
use nalgebra::{DMatrix, DVector};
use photocurrent_scene::free::FreeScene;

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
struct Normal {
    score: DVector<f64>,
    information: DMatrix<f64>,
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
    let mut errors = vec![0.0; count];
    for _ in 0..TURNS {
        let moved = (0..count).map(|k| {
            let mut moved = at.clone();
            moved[k] += PROBE * width(k);
            (with(&moved), PROBE * width(k))
        });
        let Normal { score, information } = fit.normal(&moved.collect::<Vec<_>>())?;
        let factor = (&information + &prior).cholesky();
        let step = factor.map(|factor| factor.solve(&-(score + &prior * (&at - &middle))));
        let step = step.ok_or("what is left open of the description does not change what is measured")?;
        // Errors are larger than the information has them.
        let sure = (information / (ERRORS * ERRORS) + &prior).try_inverse();
        errors =
            (0..count).map(|k| sure.as_ref().map_or(width(k), |sure| libm::sqrt(sure[(k, k)]))).collect();
        let mut is_still = true;
        for k in 0..count {
            let far = FARTHEST * width(k);
            let next = (at[k] + step[k].clamp(-far, far)).clamp(bounds[k][0], bounds[k][1]);
            is_still &= (next - at[k]).abs() < STILL * errors[k];
            at[k] = next;
        }
        fit.trial = with(&at);
        // What is left falls by a factor, and the noise that everything is weighed by with it.
        fit.light.release();
        fit.rounds(1)?;
        fit.settled(1)?;
        if is_still {
            break;
        }
    }
    Ok(unknowns.iter().enumerate().map(|(k, one)| one.estimated(at[k], errors[k])).collect())
}

impl<L: FreeScene> Fit<'_, L> {
    /// Score and information of steps from the fit's own sensor, each to a sensor and so far.
    fn normal(&mut self, steps: &[(Trial, f64)]) -> Result<Normal, String> {
        let light = self.light.light(self.ground.case);
        let mut prepared = vec![self.prepared(&self.trial)?];
        for (trial, _) in steps {
            prepared.push(self.prepared(trial)?);
        }
        let mut rows = self.rows(&prepared, &light).into_iter();
        let base = rows.next().unwrap_or_default();
        let moved: Vec<Moved> =
            rows.zip(steps).map(|(rows, (_, step))| Moved { rows, back: None, step: *step }).collect();
        let columns = self.ground.columns(&base, &moved);
        let predicted = self.predicted()?;
        self.light.prepare(&predicted);
        let count = steps.len();
        let mut normal = Normal { score: DVector::zeros(count), information: DMatrix::zeros(count, count) };
        let scores = self.light.score(&predicted, &columns, count);
        for (_, found) in scores.iter().enumerate().filter(|(place, _)| self.ground.has_events(*place)) {
            let Some(found) = found else { continue };
            normal.score += DVector::from_column_slice(&found.score);
            normal.information += DMatrix::from_row_slice(count, count, &found.information);
        }
        Ok(normal)
    }
}
