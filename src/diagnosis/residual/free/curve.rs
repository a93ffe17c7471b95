//! An uncatalogued curve, estimated jointly with the scene: knots and scene take Newton steps together, like
//! parameters that a description states as ranges ([`super::unknowns`]).

use super::super::open::CovariateCurve;
use super::super::setting::ERRORS;
use super::fit::{FitData, SceneFit};
use super::places::BaseFit;
use super::unknowns::NormalEquations;
use crate::candidates::Trial;
use crate::dependence::Dependence;
use nalgebra::{DMatrix, DVector};
use photocurrent_scene::free::FreeScene;

/// Turns of curve and scene at most.
const TURNS: usize = 8;
/// Finite differences, as a share of the curve's largest value.
const PROBE: f64 = 0.05;
/// Largest step of a knot per round, as a share of the largest value; smaller steps end the rounds.
const FARTHEST: f64 = 1.0;
const STILL: f64 = 0.01;
/// Standard deviation of the prior of each knot, about 0, as a multiple of the largest value of the curve
/// that was found without the scene.
const PRIOR: f64 = 3.0;

/// The best curve refitted with the scene, its common offset, and that scene. A curve on residuals of a scene
/// estimated without it lacks what that scene absorbed. `None` where the sensor cannot have it
/// ([`Dependence::parameters`]) or has another one.
///
/// # Errors
/// When its sensor cannot be applied.
pub(super) fn with_scene<'a, L: FreeScene>(
    nothing: &SceneFit<'a, L>,
    (best, without): (&CovariateCurve, &BaseFit),
    ground: &FitData<'_, L>,
) -> Result<Option<(Dependence, SceneFit<'a, L>)>, String> {
    let start_ns = ground.case.span.0;
    let mut curve = best.dependence.clone();
    curve.value.iter_mut().for_each(|value| *value += best.mean);
    curve.is_with_scene = true;
    let Trial { nominal, effects } = &nothing.trial;
    let with = |curve: &Dependence| -> Option<Trial> {
        Some(Trial { nominal: nominal.clone(), effects: curve.apply_to_effects(effects, start_ns)? })
    };
    let largest = curve.value.iter().fold(0.0, |most, value| f64::max(most, value.abs()));
    let Some(trial) = with(&curve).filter(|_| largest > 0.0) else { return Ok(None) };
    let count = curve.value.len();
    let prior = DMatrix::identity(count, count) / (PRIOR * largest * PRIOR * largest);
    let mut fit = nothing.clone();
    fit.apply(trial);
    fit.settled(1)?;
    for _ in 0..TURNS {
        let probe = PROBE * largest;
        let moved = |k: usize| {
            let mut moved = curve.clone();
            moved.value[k] += probe;
            with(&moved).map(|trial| (trial, probe))
        };
        let Some(steps) = (0..count).map(moved).collect::<Option<Vec<_>>>() else { return Ok(None) };
        let NormalEquations { score, information, columns } = fit.normal(&steps)?;
        let now = DVector::from_column_slice(&curve.value);
        let Some(factor) = (&information + &prior).cholesky() else { return Ok(None) };
        let far = FARTHEST * largest;
        let step = factor.solve(&-(score + &prior * now)).map(|by| by.clamp(-far, far));
        // Errors are larger than the information has them.
        if let Some(sure) = (information / (ERRORS * ERRORS) + &prior).try_inverse() {
            curve.error = (0..count).map(|k| libm::sqrt(sure[(k, k)])).collect();
        }
        curve.value.iter_mut().zip(step.iter()).for_each(|(value, by)| *value += by);
        let Some(trial) = with(&curve) else { return Ok(None) };
        fit.follow_trial(trial, &columns, step.as_slice())?;
        fit.release();
        fit.rounds(1)?;
        if step.amax() < STILL * largest {
            break;
        }
    }
    let level = BaseFit::from_fit(&mut fit)?;
    let gained = level.left_out.iter().zip(&without.left_out).map(|(with, without)| with - without);
    curve.nats_per_event = gained.sum::<f64>() / ground.events().max(1) as f64;
    curve.formulas = level.formulas(ground, &curve);
    Ok(Some((curve, fit)))
}
