//! Rows whose pixels are solved on another processor, many at once.

use crate::model::Model;
use crate::row::{KnownOfRows, Recorded};
use crate::row_solver::{Part, Posed, RowSolver, task, together, with_known};
use crate::settings::Settings;
use photocurrent_core::{Exposure, MapBand, NodeError, TrackBand};
use photocurrent_sensor::exposure::{LogLinearTrack, ManyExposures};
use photocurrent_sensor::map::{Elsewhere, MapGroup, MapMeans, MapSolution, MapTask, Pictured};
use photocurrent_sensor::undo::Known;

/// Rows of a recording and who solves them.
#[derive(Clone, Copy)]
pub(crate) struct ElsewhereRows<'a> {
    pub(crate) elsewhere: &'a dyn Elsewhere,
    pub(crate) model: &'a Model,
    pub(crate) settings: &'a Settings,
    pub(crate) recorded: &'a Recorded<'a>,
    pub(crate) given: Option<&'a KnownOfRows>,
}

/// Means of light of the values of a row over exposures, by exposure and value; NaN where there is no frame.
#[derive(Clone, Debug, PartialEq)]
pub struct RowPicture {
    /// The row.
    pub row: u32,
    /// Mean photocurrent, in units in which `frames.gain` counts.
    pub light: Vec<f32>,
    /// Mean of photocurrent times the standard deviation of its logarithm; empty where none is wanted.
    pub spread: Vec<f32>,
}

impl ElsewhereRows<'_> {
    /// Solves rows, all their pixels at once; gives how many of them were solved here after all.
    ///
    /// What effects did to events, and where events were lost, is found here.
    ///
    /// # Errors
    /// As [`RowSolver::take`], and when the other processor fails.
    pub(crate) fn tracks(&self, rows: &[u32]) -> Result<(Vec<(TrackBand, MapBand)>, usize), NodeError> {
        self.posed(rows, |posed, parts, group| {
            let (places, tasks) = joined(posed);
            let mut put = |i: usize, solution: MapSolution<'_>| {
                let (k, n) = places[i];
                parts[k].put(&posed[k], n, &solution);
            };
            let left = self.elsewhere.solve(&tasks, &mut put)?;
            let of_left: Vec<MapTask<'_>> = left.iter().map(|&i| tasks[i]).collect();
            group.solve(&of_left, |i, solution| put(left[i], solution));
            parts.iter_mut().zip(posed).for_each(|(part, posed)| part.solve_losses(posed, group));
            Ok((self.bands(rows, posed, parts), left.len()))
        })
    }

    /// The same with means over `exposures` of each row, as many for each, in place of tracks. Pixels that
    /// are solved here are integrated here.
    ///
    /// # Errors
    /// As [`ElsewhereRows::tracks`].
    pub(crate) fn pictures(
        &self,
        rows: &[u32],
        exposures: &[Vec<Exposure>],
    ) -> Result<(Vec<(RowPicture, MapBand)>, usize), NodeError> {
        let width = self.recorded.meta.extent.width as usize;
        let picture = |(&row, exposures): (&u32, &Vec<Exposure>)| {
            let blank = |is_wanted: bool| vec![f32::NAN; if is_wanted { width * exposures.len() } else { 0 }];
            let with_sigma = self.settings.of(row).options.with_sigma;
            RowPicture { row, light: blank(true), spread: blank(with_sigma) }
        };
        let mut pictures: Vec<RowPicture> = rows.iter().zip(exposures).map(picture).collect();
        self.posed(rows, |posed, parts, group| {
            let (places, tasks) = joined(posed);
            let pictured: Vec<Pictured> = places.iter().map(|&(k, n)| posed[k].pictured(k, n)).collect();
            let left = self.elsewhere.pictures(&tasks, &pictured, exposures, &mut |i, means| {
                let (k, n) = places[i];
                parts[k].put_outcome(&posed[k], n, &means.outcome, means.brightest);
                pictures[k].put(width, posed[k].lit[n], &means);
            })?;
            let of_left: Vec<MapTask<'_>> = left.iter().map(|&i| tasks[i]).collect();
            group.solve(&of_left, |i, solution| {
                let (k, n) = places[left[i]];
                parts[k].put(&posed[k], n, &solution);
            });
            parts.iter_mut().zip(posed).for_each(|(part, posed)| part.solve_losses(posed, group));
            for (k, part) in parts.iter().enumerate() {
                for (&x, knots) in
                    posed[k].lit.iter().zip(part.knots()).filter(|(_, knots)| !knots.is_empty())
                {
                    pictures[k].integrate(width, x, knots, &exposures[k]);
                }
            }
            let maps = self.bands(rows, posed, parts).into_iter().map(|(_, map)| map);
            Ok((pictures.into_iter().zip(maps).collect(), left.len()))
        })
    }

    /// What `work` makes of the problems of rows, and of parts that are to take their answers.
    fn posed<T>(
        &self,
        rows: &[u32],
        work: impl FnOnce(&[Posed<'_>], &mut [Part], &mut MapGroup) -> Result<T, NodeError>,
    ) -> Result<T, NodeError> {
        let ElsewhereRows { model, settings, recorded, given, .. } = *self;
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
        work(&posed, &mut parts, &mut group)
    }

    fn bands(&self, rows: &[u32], posed: &[Posed<'_>], parts: &[Part]) -> Vec<(TrackBand, MapBand)> {
        let band = |((&row, posed), part): ((&u32, &Posed<'_>), &Part)| {
            together(posed.setting, self.recorded.meta, row, [(posed.lit, part)].into_iter())
        };
        rows.iter().zip(posed).zip(parts).map(band).collect()
    }
}

/// The tasks of all rows, and the row and place there of each.
fn joined<'a>(posed: &[Posed<'a>]) -> (Vec<(usize, usize)>, Vec<MapTask<'a>>) {
    let of_row = |(k, posed): (usize, &Posed<'a>)| (0..posed.tasks.len()).map(move |n| (k, n));
    let places = posed.iter().enumerate().flat_map(of_row).collect();
    (places, posed.iter().flat_map(|posed| posed.tasks.iter().copied()).collect())
}

impl RowPicture {
    /// Takes the means of value x.
    fn put(&mut self, width: usize, x: usize, means: &MapMeans<'_>) {
        for (to, of) in [(&mut self.light, means.light), (&mut self.spread, means.spread)] {
            to.chunks_exact_mut(width).zip(of).for_each(|(of_exposure, mean)| of_exposure[x] = *mean);
        }
    }

    /// Takes value x from its knots.
    fn integrate(&mut self, width: usize, x: usize, knots: &[(i64, f32, f32)], exposures: &[Exposure]) {
        let mut many = ManyExposures::default();
        let t_ns: Vec<i64> = knots.iter().map(|(t, ..)| *t).collect();
        let light: Vec<f32> = knots.iter().map(|(_, light, _)| *light).collect();
        let spread: Vec<f32> = knots.iter().map(|(_, light, sigma)| light * sigma).collect();
        for (to, of) in [(&mut self.light, light), (&mut self.spread, spread)] {
            let integrals = many.of(&LogLinearTrack::new(&t_ns, &of), exposures);
            for ((of_exposure, exposure), integral) in
                to.chunks_exact_mut(width).zip(exposures).zip(integrals)
            {
                of_exposure[x] = (integral / exposure.seconds()) as f32;
            }
        }
    }
}
