//! Rows whose pixels are solved on another processor, many at once.

use crate::model::Model;
use crate::row::{KnownOfRows, Recorded};
use crate::row_solver::{Part, Posed, RowSolver, task, together, with_known};
use crate::settings::Settings;
use photocurrent_core::{MapBand, NodeError, TrackBand};
use photocurrent_sensor::map::{Elsewhere, MapGroup, MapSolution, MapTask};
use photocurrent_sensor::undo::Known;

/// Solves rows elsewhere than on this processor, all their pixels at once; gives how many of them were solved
/// here after all.
///
/// What effects did to events, and where events were lost, is found here.
///
/// # Errors
/// As [`RowSolver::take`], and when the other processor fails.
pub(crate) fn rows_elsewhere(
    elsewhere: &dyn Elsewhere,
    model: &Model,
    settings: &Settings,
    recorded: &Recorded<'_>,
    rows: &[u32],
    given: Option<&KnownOfRows>,
) -> Result<(Vec<(TrackBand, MapBand)>, usize), NodeError> {
    let mut group = MapGroup::default();
    let mut solvers: Vec<RowSolver> = Vec::new();
    for &row in rows {
        let mut solver = RowSolver::default();
        solver.take(model, settings.of(row), recorded, row)?;
        if let Some(given) = given {
            solver.give(given.of(row).to_vec());
        }
        solvers.push(solver);
    }
    let lit: Vec<Vec<usize>> = solvers.iter().map(RowSolver::lit).collect();
    let alone = |k: usize| -> Vec<MapTask<'_>> {
        let setting = settings.of(rows[k]);
        lit[k].iter().map(|&x| task(model, setting, solvers[k].data(), x, &[])).collect()
    };
    let mut known: Vec<Vec<Known>> = Vec::new();
    for (k, solver) in solvers.iter().enumerate() {
        known.push(solver.known(model, &alone(k), &lit[k], &mut group));
    }
    let posed: Vec<Posed<'_>> = (0..rows.len())
        .map(|k| {
            let (setting, data) = (settings.of(rows[k]), solvers[k].data());
            Posed { model, setting, data, lit: &lit[k], tasks: with_known(&alone(k), &known[k]) }
        })
        .collect();
    let mut parts: Vec<Part> = rows.iter().map(|_| Part::default()).collect();
    parts.iter_mut().zip(&lit).for_each(|(part, lit)| part.begin(lit.len()));
    let places: Vec<(usize, usize)> =
        lit.iter().enumerate().flat_map(|(k, lit)| (0..lit.len()).map(move |n| (k, n))).collect();
    let tasks: Vec<MapTask<'_>> = posed.iter().flat_map(|posed| posed.tasks.iter().copied()).collect();
    let mut put = |i: usize, solution: MapSolution<'_>| {
        let (k, n) = places[i];
        parts[k].put(&posed[k], n, &solution);
    };
    let left = elsewhere.solve(&tasks, &mut put)?;
    let of_left: Vec<MapTask<'_>> = left.iter().map(|&i| tasks[i]).collect();
    group.solve(&of_left, |i, solution| put(left[i], solution));
    parts.iter_mut().zip(&posed).for_each(|(part, posed)| part.solve_losses(posed, &mut group));
    let band = |k: usize| {
        together(settings.of(rows[k]), recorded.meta, rows[k], [(lit[k].as_slice(), &parts[k])].into_iter())
    };
    Ok(((0..rows.len()).map(band).collect(), left.len()))
}
