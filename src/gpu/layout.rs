//! Pixels as the shaders read them: laid out by the solver's own code, rounded to single precision, side by
//! side in groups.

use crate::structs::{Pixel, Place, State};
use crate::template::codes::{CONVERGED, KEPT, REFUSED, UNFINISHED};
use crate::template::{Family, LANES, Variant, columns};
use photocurrent_sensor::map::laid::{self, Laid};
use photocurrent_sensor::map::{
    MapOptions, MapOutcome, MapProblem, MapSolution, MapStatus, MapTask, Offsets, Prior, Second,
};
use photocurrent_sensor::residuals::Misfit;
use rayon::prelude::*;

/// Distances between steps that fit where the neighbourhoods of the prior stand.
const FARTHEST: usize = 0xffff;

/// A step, rounded: a number for each column that is given.
#[derive(Clone, Copy, Debug, Default)]
struct Packed {
    what: u32,
    given: [u32; columns::GIVEN as usize],
}

/// A pixel of a batch.
pub(crate) struct Cut {
    /// Its place among the tasks.
    pub place: usize,
    pixel: Pixel,
    t_ns: Vec<i64>,
    last_steps: Vec<u32>,
    steps: Vec<Packed>,
}

/// The shaders that a task takes.
pub(crate) fn variant(task: &MapTask<'_>) -> Variant {
    let family = match task.options.prior {
        Prior::Local(_) => Family::Local,
        Prior::Walk { .. } => Family::Walk,
        Prior::IntegratedWalk { .. } => Family::Integrated,
    };
    Variant { free: task.problem.noise.threshold > 0.0, family }
}

/// Lays out a task; none where it does not fit the shaders.
pub(crate) fn cut(place: usize, task: &MapTask<'_>, laid: &mut Laid) -> Option<Cut> {
    laid.lay(task);
    let u = laid.start();
    let mut before = u[0];
    let mut steps = Vec::with_capacity(laid.len());
    for (s, step) in laid.steps().enumerate() {
        let mut given = [0; columns::GIVEN as usize];
        let mut put = |column: u32, value: f64| given[column as usize] = (value as f32).to_bits();
        put(columns::LENGTH, step.length_s);
        put(columns::TARGET, step.target);
        put(columns::EXPOSURE, step.exposure);
        put(columns::REACH, step.reach_s);
        put(columns::PER_NEARBY, step.per_nearby);
        if step.length_s > 0.0 {
            put(columns::START, u[step.knot] - before);
            before = u[step.knot];
            if step.per_nearby > 0.0 {
                let (low, high) = (s - step.nearby.0 as usize, step.nearby.1 as usize - s);
                if low > FARTHEST || high > FARTHEST {
                    return None;
                }
                given[columns::NEAR as usize] = (low as u32) << 16 | high as u32;
            }
        }
        steps.push(Packed { what: step.what, given });
    }
    Some(Cut {
        place,
        pixel: pixel(task, laid),
        t_ns: laid.t_ns().to_vec(),
        last_steps: laid.last_steps().map(|s| s as u32).collect(),
        steps,
    })
}

fn pixel(task: &MapTask<'_>, laid: &Laid) -> Pixel {
    let MapTask { problem, options } = task;
    let MapProblem { sensor, noise, events, frames, .. } = problem;
    let MapOptions { prior, second, max_iterations, tolerance, .. } = *options;
    let (spread, tails) = match prior {
        Prior::Local(local) => (local.floor_per_s * local.floor_per_s, local.memory_s),
        Prior::Walk { per_s, nu } => (nu * per_s, nu + 1.0),
        Prior::IntegratedWalk { per_s3, nu } => (nu * per_s3, nu + 1.0),
    };
    let rising = events.iter().filter(|event| event.polarity > 0).count();
    let second_of = |of: fn(&photocurrent_sensor::map::SecondStart) -> f64| second.as_ref().map_or(0.0, of);
    Pixel {
        cell: 0,
        steps: laid.len() as u32,
        max_iterations: max_iterations as u32,
        second_steps: second.map_or(0, |second| second.steps as u32),
        start: laid.start()[0] as f32,
        // Beyond what single precision has, all is plausible.
        limit: laid.brightest().clamp(-1e30, 1e30) as f32,
        tolerance: tolerance as f32,
        tau_0_s: sensor.front_end.tau_0_s as f32,
        alpha_s: sensor.front_end.alpha_s as f32,
        on: sensor.threshold_on as f32,
        off: sensor.threshold_off as f32,
        event: noise.event as f32,
        reference_variance: (noise.reference * noise.reference) as f32,
        threshold_variance: (noise.threshold * noise.threshold) as f32,
        no_event_sigma: problem.no_event_sigma as f32,
        stamp_sigma_s: problem.stamp_sigma_s as f32,
        spread: spread as f32,
        tails: tails as f32,
        second_event: second_of(|second| second.event) as f32,
        least_misfit: second_of(|second| second.least_misfit) as f32,
        most_misfit: second_of(|second| second.most_misfit) as f32,
        second_keeps: (1.0 - second_of(|second| second.gain)) as f32,
        measured: (events.len() + frames.len()) as f32,
        rising: rising as f32,
        falling: (events.len() - rising) as f32,
    }
}

/// Pixels that the card solves at once, in its memory's order.
#[derive(Default)]
pub(crate) struct Batch {
    pub cuts: Vec<Cut>,
    /// Constants of each pixel, with its first cell.
    pub pixels: Vec<Pixel>,
    /// Cells of a column.
    pub cells: u32,
    /// Columns one after the other.
    pub given: Vec<u32>,
    pub whats: Vec<u32>,
}

/// Cuts sorted pixels into batches of at most so many cells. A pixel alone has a whole group's cells.
pub(crate) fn batches(mut cuts: Vec<Cut>, most_cells: u32) -> Vec<Batch> {
    // Side by side, pixels wait for the longest.
    cuts.sort_by_key(|cut| (cut.steps.len(), cut.place));
    let mut batches = Vec::new();
    let mut batch = Batch::default();
    let mut cuts = cuts.into_iter().peekable();
    while cuts.peek().is_some() {
        let group: Vec<Cut> = cuts.by_ref().take(LANES as usize).collect();
        let cells = cells_of(group.iter().map(|cut| cut.steps.len()).max().unwrap_or(0));
        if batch.cells + cells > most_cells && batch.cells > 0 {
            batches.push(std::mem::take(&mut batch));
        }
        for (lane, cut) in group.into_iter().enumerate() {
            batch.pixels.push(Pixel { cell: batch.cells + lane as u32, ..cut.pixel });
            batch.cuts.push(cut);
        }
        batch.cells += cells;
    }
    if batch.cells > 0 {
        batches.push(batch);
    }
    batches.iter_mut().for_each(Batch::spread);
    batches
}

/// The cells that a group takes whose longest pixel has so many steps.
pub(crate) fn cells_of(steps: usize) -> u32 {
    u32::try_from(steps).unwrap_or(u32::MAX / LANES).saturating_mul(LANES)
}

impl Batch {
    /// Fills the columns.
    fn spread(&mut self) {
        let cells = self.cells as usize;
        self.given.resize(cells * columns::GIVEN as usize, 0);
        self.whats.resize(cells, 0);
        let Batch { cuts, pixels, given, whats, .. } = self;
        let of_step = |pixel: &Pixel, s: usize| pixel.cell as usize + s * LANES as usize;
        for (cut, pixel) in cuts.iter().zip(pixels.iter()) {
            for (s, step) in cut.steps.iter().enumerate() {
                whats[of_step(pixel, s)] = step.what;
            }
        }
        given.par_chunks_mut(cells).enumerate().for_each(|(column, given)| {
            for (cut, pixel) in cuts.iter().zip(pixels.iter()) {
                for (s, step) in cut.steps.iter().enumerate() {
                    given[of_step(pixel, s)] = step.given[column];
                }
            }
        });
    }

    /// Gives each answer, with its place among the tasks, to `take`; `fetched` has the increments of log
    /// light, then, where `with_sigma` is true of a task, its variances.
    pub(crate) fn answers(
        &self,
        states: &[State],
        fetched: &[f32],
        with_sigma: impl Fn(usize) -> bool,
        take: &mut dyn FnMut(usize, MapSolution<'_>),
    ) {
        let (mut log, mut variance) = (Vec::new(), Vec::new());
        let (increments, variances) = fetched.split_at(usize::min(self.cells as usize, fetched.len()));
        for ((cut, pixel), state) in self.cuts.iter().zip(&self.pixels).zip(states) {
            let at = |s: usize| pixel.cell as usize + s * LANES as usize;
            let mut u = f64::from(state.here.u0);
            log.clear();
            let begins = |s: &usize| cut.steps[*s].what & laid::SEGMENT != 0;
            for s in (0..cut.steps.len()).filter(begins) {
                u += if s > 0 { f64::from(increments[at(s)]) } else { 0.0 };
                log.push(u);
            }
            variance.clear();
            if with_sigma(cut.place) {
                variance.extend(cut.last_steps.iter().map(|&s| f64::from(variances[at(s as usize)])));
            }
            let outcome = state.outcome(cut);
            take(
                cut.place,
                MapSolution { t_ns: &cut.t_ns, log_photocurrent: &log, variance: &variance, outcome },
            );
        }
    }
}

impl Cut {
    /// Its knots, ns.
    pub(crate) fn t_ns(&self) -> &[i64] {
        &self.t_ns
    }

    /// How many steps it has.
    pub(crate) fn len(&self) -> usize {
        self.steps.len()
    }
}

impl Pixel {
    /// Steps of all its starts, at most.
    pub(crate) fn most_steps(&self) -> usize {
        (self.max_iterations + 2 * self.second_steps) as usize
    }
}

impl State {
    pub(crate) fn outcome(&self, cut: &Cut) -> MapOutcome {
        let until = &cut.steps[..=self.here.largest_step as usize];
        let begun = until.iter().filter(|step| step.what & laid::SEGMENT != 0).count();
        let Place { reference, on, off, event_square, frame_square, events, frames, .. } = self.here;
        MapOutcome {
            offsets: Offsets { reference: reference.into(), on: on.into(), off: off.into() },
            status: match self.here.status {
                CONVERGED => MapStatus::Converged,
                UNFINISHED => MapStatus::Unfinished,
                _ => MapStatus::Failed,
            },
            iterations: self.here.iterations as usize,
            log_evidence: self.evidence.into(),
            misfit: Misfit {
                event_square: event_square.into(),
                events: events as usize,
                frame_square: frame_square.into(),
                frames: frames as usize,
            },
            largest_square: self.here.largest.into(),
            largest_ns: cut.t_ns[begun - 1],
            second: match self.second {
                REFUSED => Second::Refused,
                KEPT => Second::Kept,
                _ => Second::Untried,
            },
        }
    }
}
