//! What suits a recording: how noisy its events and frames are and which prior fits, estimated from the recording itself.
//!
//! Rows are taken in blocks that start at multiples of [`BLOCK_ROWS`], whatever band is asked for, so that bands do not change results: a node
//! that solves a row reads its whole block, and one row around it. Pixels are looked at all over the block, so that
//! the choice rests on many and costs less than the solution.

use super::map::{RowSetting, known, problem, with_known};
use super::neighbours::KnownOfRows;
use super::row::{Recorded, RowData};
use super::{MAP_STEPS, Model, Params};
use photocurrent_core::{NodeError, Rows};
use photocurrent_sensor::effects::Site;
use photocurrent_sensor::map::losses::{self, Plain};
use photocurrent_sensor::map::{MapEvent, MapFrame, MapGroup, MapOptions, MapProblem, MapTask, Noise, estimate, frame_noise};
use photocurrent_sensor::undo::Known;
use rayon::prelude::*;

/// Rows of a block.
pub(super) const BLOCK_ROWS: u32 = 16;
/// So many rows around a band are read: the rest of its blocks, and one more for neighbours.
pub(crate) const HALO_ROWS: u32 = BLOCK_ROWS;
/// So many pixels of a block are looked at, at least.
const SAMPLED_PIXELS: usize = 64;
/// Second starts take three times as many steps as first ones: they are taken where at least this share of the pixels that are looked at has its answer from one.
const LEAST_SECOND: f64 = 0.05;

/// The settings of some rows.
pub(crate) struct Settings {
    first_block: u32,
    of_blocks: Vec<RowSetting>,
}

impl Settings {
    /// Some rows and the rest of their blocks.
    pub fn blocks_of(rows: Rows, all: Rows) -> Rows {
        Rows { start: rows.start / BLOCK_ROWS * BLOCK_ROWS, end: rows.end.next_multiple_of(BLOCK_ROWS) }.intersect(all)
    }

    /// Chooses the settings of `rows`, with what is known of their events from neighbours, if that is the case. What is at hand includes their blocks.
    pub fn choose(params: &Params, model: &Model, recorded: &Recorded<'_>, rows: Rows, given: Option<&KnownOfRows>) -> Result<Settings, NodeError> {
        let first_block = rows.start / BLOCK_ROWS;
        let blocks = first_block..rows.end.div_ceil(BLOCK_ROWS).max(first_block);
        let of_block = |block: u32| {
            let rows = Rows { start: block * BLOCK_ROWS, end: (block + 1) * BLOCK_ROWS }.intersect(recorded.meta.extent.rows());
            choose(params, model, recorded, rows, given)
        };
        let of_blocks: Result<Vec<RowSetting>, NodeError> = blocks.into_par_iter().map(of_block).collect();
        Ok(Settings { first_block, of_blocks: of_blocks? })
    }

    /// That of a row.
    pub fn of(&self, row: u32) -> &RowSetting {
        &self.of_blocks[(row / BLOCK_ROWS - self.first_block) as usize]
    }
}

fn choose(params: &Params, model: &Model, recorded: &Recorded<'_>, rows: Rows, given: Option<&KnownOfRows>) -> Result<RowSetting, NodeError> {
    let per_row = SAMPLED_PIXELS.div_ceil(rows.len());
    let mut data = RowData::default();
    let mut differences = Vec::new();
    let mut possible = 0;
    let mut sample: Vec<(Vec<MapEvent>, Vec<MapFrame>)> = Vec::new();
    let mut recorded_events: Vec<(Site, Vec<MapEvent>)> = Vec::new();
    let mut given_of: Vec<Known> = Vec::new();
    for row in rows.iter() {
        data.take(model, recorded, row, 0.0)?;
        let mut active = Vec::new();
        for x in 0..data.width() {
            let (events, frames) = (data.events_of(x), data.frames_of(x));
            differences.extend(frame_noise::differences(events, frames));
            possible += frames.len().saturating_sub(2);
            let in_company = events.iter().filter(|event| !event.is_lone).count();
            if in_company > 0 && !frames.is_empty() {
                active.push((in_company, x));
            }
        }
        // Spread over their number of events.
        active.sort_unstable();
        let taken = usize::min(active.len(), per_row);
        for n in 0..taken {
            let (_, x) = active[(2 * n + 1) * active.len() / (2 * taken)];
            sample.push((data.events_of(x).to_vec(), data.frames_of(x).to_vec()));
            let (site, events) = data.recorded_of(x);
            recorded_events.push((site, events.to_vec()));
            given_of.extend(given.map(|given| given.of(row)[x].clone()));
        }
    }
    let span = (recorded.meta.span.start.0, recorded.meta.span.end.0);
    let max_iterations = usize::min(params.max_iterations as usize, MAP_STEPS);
    let mut options = MapOptions { spacing_ns: params.knot_spacing().ns(), max_iterations, with_sigma: params.sigma(), ..MapOptions::default() };
    let frame_dn = frame_noise::missing_dn(&mut differences, possible);
    for frame in sample.iter_mut().flat_map(|(_, frames)| frames) {
        frame.sigma_dn = libm::sqrt(frame.sigma_dn * frame.sigma_dn + frame_dn * frame_dn);
    }
    let mut group = MapGroup::default();
    let problems: Vec<_> = sample.iter().map(|(events, frames)| problem(model, events, frames, span, Noise::default())).collect();
    let tasks: Vec<MapTask<'_>> = problems.iter().map(|&problem| MapTask { problem, options }).collect();
    let looks: Vec<(Site, &[MapEvent])> = recorded_events.iter().map(|(site, events)| (*site, events.as_slice())).collect();
    let known = if given.is_some() { given_of } else { known(model, &tasks, &looks, &mut group) };
    let problems: Vec<_> = with_known(&tasks, &known).into_iter().map(|task| task.problem).collect();
    // Or pixels that have lost events would choose for all.
    let (lost, second) = losses_of(&problems, &options, &mut group);
    let usual = options.second.take();
    let least = LEAST_SECOND * problems.len() as f64;
    let are_many = |second: usize| second as f64 >= least;
    options.second = usual.filter(|_| are_many(second));
    let problems: Vec<_> = problems.into_iter().zip(&lost).map(|(problem, lost_before)| MapProblem { lost_before, ..problem }).collect();
    let choice = estimate::choose(&problems, params.event_noise, &options, &mut group);
    options.prior = choice.prior;
    let problems: Vec<_> = problems.into_iter().map(|problem| MapProblem { noise: choice.noise, ..problem }).collect();
    let second = losses_of(&problems, &MapOptions { second: usual, ..options }, &mut group).1;
    options.second = usual.filter(|_| are_many(second));
    let sigma_factor = if params.sigma() { estimate::too_narrow_by(&mut estimate::misses(&problems, &options, &mut group)) } else { 1.0 };
    Ok(RowSetting { span, noise: choice.noise, options, frame_dn, sigma_factor })
}

/// The events of each problem before which events were lost ([`losses::lost_before`]), and how many have their answer from a second start.
fn losses_of(problems: &[MapProblem<'_>], options: &MapOptions, group: &mut MapGroup) -> (Vec<Vec<u32>>, usize) {
    let options = MapOptions { with_sigma: false, ..*options };
    let tasks: Vec<MapTask<'_>> = problems.iter().map(|&problem| MapTask { problem, options }).collect();
    let mut plain = vec![Plain::default(); tasks.len()];
    let mut second = 0;
    group.solve(&tasks, |n, solution| {
        plain[n] = Plain::of(&solution);
        second += usize::from(solution.is_second);
    });
    (losses::lost_before(&tasks, &plain, group), second)
}
