//! What suits a recording: how noisy its events and frames are and which prior fits, estimated from the
//! recording itself.
//!
//! Rows are taken in blocks that start at multiples of [`BLOCK_ROWS`], whatever band is asked for, so that
//! bands do not change results: a node that solves a row reads its whole block, and one row around it. Pixels
//! are looked at all over the block, so that the choice rests on many and costs less than the solution.

use crate::host::Host;
use crate::model::Model;
use crate::options::{STEPS, SolveOptions};
use crate::row::{KnownOfRows, Recorded, RowData, RowSetting};
use crate::row_solver::{known, problem, with_known};
use photocurrent_core::{NodeError, Rows, TracksMeta};
use photocurrent_sensor::effects::Site;
use photocurrent_sensor::map::estimate::Choosing;
use photocurrent_sensor::map::losses::{self, Plain};
use photocurrent_sensor::map::{
    MapFrame, MapGroup, MapOptions, MapProblem, MapTask, Noise, PixelEvent, SecondStart, estimate,
    frame_noise,
};
use photocurrent_sensor::undo::Known;
use rayon::prelude::*;
use std::ops::Range;

/// Rows of a block.
pub const BLOCK_ROWS: u32 = 16;
/// So many rows around a band are read: the rest of its blocks, and one more for neighbours.
pub const HALO_ROWS: u32 = BLOCK_ROWS;
/// Rows around one whose events are company to its own.
pub const COMPANY_ROWS: u32 = 1;

/// So many pixels of each block choose its noise and prior, at least: 64 lose up to 0.1 dB
/// (docs/decisions/0013).
const CHOOSING_PIXELS: usize = 192;

/// The settings of some rows.
pub struct Settings {
    first_block: u32,
    of_blocks: Vec<RowSetting>,
}

impl Settings {
    /// Some rows and the rest of their blocks.
    pub fn blocks_of(rows: Rows, all: Rows) -> Rows {
        Rows { start: rows.start / BLOCK_ROWS * BLOCK_ROWS, end: rows.end.next_multiple_of(BLOCK_ROWS) }
            .intersect(all)
    }

    /// The blocks of some rows.
    fn numbers(rows: Rows) -> Range<u32> {
        let first = rows.start / BLOCK_ROWS;
        first..rows.end.div_ceil(BLOCK_ROWS).max(first)
    }

    /// Those of `rows` that an earlier band of the same task chose, where it did for all of them.
    pub fn chosen(rows: Rows, host: &dyn Host) -> Option<Settings> {
        let blocks = Settings::numbers(rows);
        let of_blocks: Option<Vec<RowSetting>> = blocks.clone().map(|block| host.recall(block)).collect();
        Some(Settings { first_block: blocks.start, of_blocks: of_blocks? })
    }

    /// The same as [`Settings::choose`], but what was chosen once is for all bands of the task.
    pub fn choose_once(
        params: &SolveOptions,
        model: &Model,
        recorded: &Recorded<'_>,
        rows: Rows,
        given: Option<&KnownOfRows>,
        host: &dyn Host,
    ) -> Result<Settings, NodeError> {
        if let Some(settings) = Settings::chosen(rows, host) {
            return Ok(settings);
        }
        let settings = Settings::choose(params, model, recorded, rows, given)?;
        settings.keep(host);
        Ok(settings)
    }

    /// Chooses the settings of `rows` for all bands of the task, where pixels are solved alone: `take` takes
    /// in one row after the other, so that a block need not be at hand at once.
    pub fn choose_row_by_row(
        params: &SolveOptions,
        model: &Model,
        meta: &TracksMeta,
        rows: Rows,
        host: &dyn Host,
        mut take: impl FnMut(&mut RowData, u32) -> Result<(), NodeError>,
    ) -> Result<(), NodeError> {
        let blocks = Settings::numbers(rows);
        let of_block = |block: u32| choose(params, model, meta, rows_of(block, meta), &mut take, None);
        let settings = Settings {
            first_block: blocks.start,
            of_blocks: blocks.map(of_block).collect::<Result<_, NodeError>>()?,
        };
        settings.keep(host);
        Ok(())
    }

    /// For the bands to come.
    fn keep(&self, host: &dyn Host) {
        (self.first_block..).zip(&self.of_blocks).for_each(|(block, setting)| host.keep(block, *setting));
    }

    /// Chooses the settings of `rows`, with what is known of their events from neighbours, if that is the
    /// case. What is at hand includes their blocks.
    pub fn choose(
        params: &SolveOptions,
        model: &Model,
        recorded: &Recorded<'_>,
        rows: Rows,
        given: Option<&KnownOfRows>,
    ) -> Result<Settings, NodeError> {
        let blocks = Settings::numbers(rows);
        let first_block = blocks.start;
        let of_block = |block: u32| {
            let mut take = |data: &mut RowData, row: u32| data.take(model, recorded, row, 0.0);
            choose(params, model, recorded.meta, rows_of(block, recorded.meta), &mut take, given)
        };
        let of_blocks: Result<Vec<RowSetting>, NodeError> = blocks.into_par_iter().map(of_block).collect();
        Ok(Settings { first_block, of_blocks: of_blocks? })
    }

    /// That of a row.
    pub fn of(&self, row: u32) -> &RowSetting {
        &self.of_blocks[(row / BLOCK_ROWS - self.first_block) as usize]
    }
}

/// The rows of a block.
fn rows_of(block: u32, meta: &TracksMeta) -> Rows {
    Rows { start: block * BLOCK_ROWS, end: (block + 1) * BLOCK_ROWS }.intersect(meta.extent.rows())
}

fn choose(
    params: &SolveOptions,
    model: &Model,
    meta: &TracksMeta,
    rows: Rows,
    take: &mut impl FnMut(&mut RowData, u32) -> Result<(), NodeError>,
    given: Option<&KnownOfRows>,
) -> Result<RowSetting, NodeError> {
    let per_row = CHOOSING_PIXELS.div_ceil(rows.len());
    let mut data = RowData::default();
    let mut unexplained = Unexplained::default();
    let span = (meta.span.start.0, meta.span.end.0);
    let mut sample = Sample::new(params, span);
    let mut given_of: Vec<Known> = Vec::new();
    for row in rows.iter() {
        take(&mut data, row)?;
        let mut active = Vec::new();
        for x in 0..data.width() {
            unexplained.add(&data, x);
            let in_company = events_in_company(&data, x);
            if in_company > 0 && !data.frames_of(x).is_empty() {
                active.push((in_company, x));
            }
        }
        // Spread over their number of events.
        active.sort_unstable();
        let taken = usize::min(active.len(), per_row);
        for n in 0..taken {
            let (_, x) = active[(2 * n + 1) * active.len() / (2 * taken)];
            sample.push(&data, x);
            given_of.extend(given.map(|given| given.of(row)[x].clone()));
        }
    }
    let frame_dn = unexplained.frame_dn();
    sample.add_noise(frame_dn);
    let mut group = MapGroup::default();
    let options = sample.options;
    Ok(sample.with_problems(
        model,
        0..sample.len(),
        given.map(|_| given_of),
        &mut group,
        |problems, group| {
            let choice = estimate::choose(problems, params.event_noise, &Choosing::USUAL, &options, group);
            let options = MapOptions { prior: choice.prior, second: choice.second, ..options };
            let problems: Vec<_> =
                problems.iter().map(|problem| MapProblem { noise: choice.noise, ..*problem }).collect();
            let sigma_factor = if params.sigma {
                estimate::too_narrow_by(&mut estimate::misses(&problems, &options, group))
            } else {
                1.0
            };
            RowSetting { span, noise: choice.noise, options, frame_dn, sigma_factor }
        },
    ))
}

/// How many events of a pixel are not alone.
pub fn events_in_company(data: &RowData, x: usize) -> usize {
    data.in_company(x).count()
}

/// What frames differ by without an event.
#[derive(Default)]
pub struct Unexplained {
    differences: Vec<frame_noise::Difference>,
    possible: usize,
}

impl Unexplained {
    /// Takes in a pixel.
    pub fn add(&mut self, data: &RowData, x: usize) {
        let frames = data.frames_of(x);
        self.differences.extend(frame_noise::differences(data.events_of(x), frames));
        self.possible += frames.len().saturating_sub(2);
    }

    /// The standard deviation of frame values that the description does not explain, DN.
    pub fn frame_dn(&mut self) -> f64 {
        frame_noise::missing_dn(&mut self.differences, self.possible)
    }
}

/// What a pixel measured.
struct Sampled {
    events: Vec<PixelEvent>,
    is_lone: Vec<bool>,
    frames: Vec<MapFrame>,
    /// Where its event pixel is.
    site: Site,
    /// Its events with stamps as recorded.
    recorded: Vec<PixelEvent>,
}

/// Pixels that settings are tried on, cut out of the recording.
pub struct Sample {
    pixels: Vec<Sampled>,
    /// First and last instant, ns.
    span: (i64, i64),
    /// How they are solved.
    pub options: MapOptions,
}

impl Sample {
    /// Of no pixel yet.
    pub fn new(params: &SolveOptions, span: (i64, i64)) -> Sample {
        let max_iterations = params.max_iterations.min(STEPS) as usize;
        let options = MapOptions {
            spacing_ns: params.knot_spacing.ns(),
            max_iterations,
            with_sigma: params.sigma,
            second: Some(SecondStart::USUAL),
            ..MapOptions::default()
        };
        Sample { pixels: Vec::new(), span, options }
    }

    /// Takes in a pixel of a row.
    pub fn push(&mut self, data: &RowData, x: usize) {
        let (site, recorded) = data.recorded_of(x);
        self.pixels.push(Sampled {
            events: data.events_of(x).to_vec(),
            is_lone: data.is_lone(x).to_vec(),
            frames: data.frames_of(x).to_vec(),
            site,
            recorded: recorded.to_vec(),
        });
    }

    /// How many pixels there are.
    pub fn len(&self) -> usize {
        self.pixels.len()
    }

    /// Is there no pixel?
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }

    /// How many events they have together.
    pub fn events(&self) -> usize {
        self.pixels.iter().map(|pixel| pixel.events.len()).sum()
    }

    /// Adds `frame_dn` in squares to the standard deviation of every frame value.
    pub fn add_noise(&mut self, frame_dn: f64) {
        for frame in self.pixels.iter_mut().flat_map(|pixel| &mut pixel.frames) {
            frame.sigma_dn = libm::sqrt(frame.sigma_dn * frame.sigma_dn + frame_dn * frame_dn);
        }
    }

    /// What `work` makes of the problems of some pixels, in their order, with the usual noise; `given` is
    /// what is known of their events from neighbours, if that is the case.
    pub fn with_problems<T>(
        &self,
        model: &Model,
        pixels: Range<usize>,
        given: Option<Vec<Known>>,
        group: &mut MapGroup,
        work: impl FnOnce(&[MapProblem<'_>], &mut MapGroup) -> T,
    ) -> T {
        let pixels = &self.pixels[pixels];
        let posed = pixels.iter().map(|Sampled { events, is_lone, frames, .. }| {
            problem(model, events, is_lone, frames, self.span, Noise::default())
        });
        let tasks: Vec<MapTask<'_>> =
            posed.map(|problem| MapTask { problem, options: self.options }).collect();
        let looks: Vec<(Site, &[PixelEvent])> =
            pixels.iter().map(|pixel| (pixel.site, pixel.recorded.as_slice())).collect();
        let known = given.unwrap_or_else(|| known(model, &tasks, &looks, group));
        let problems: Vec<_> = with_known(&tasks, &known).into_iter().map(|task| task.problem).collect();
        // Or pixels that have lost events would choose for all.
        let lost = losses_of(&problems, &self.options, group);
        let problems: Vec<_> = problems
            .into_iter()
            .zip(&lost)
            .map(|(problem, lost_before)| MapProblem { lost_before, ..problem })
            .collect();
        work(&problems, group)
    }
}

/// The events of each problem before which events were lost ([`losses::lost_before`]).
fn losses_of(problems: &[MapProblem<'_>], options: &MapOptions, group: &mut MapGroup) -> Vec<Vec<u32>> {
    let options = MapOptions { with_sigma: false, ..*options };
    let tasks: Vec<MapTask<'_>> = problems.iter().map(|&problem| MapTask { problem, options }).collect();
    let mut plain = vec![Plain::default(); tasks.len()];
    group.solve(&tasks, |n, solution| plain[n] = Plain::of(&solution.outcome));
    losses::lost_before(&tasks, &plain, group)
}
