//! The MAP estimate: a row of pixels cut out of the recording, and their MAP estimates put together.

use crate::model::Model;
use crate::options::NO_EVENT_SIGMA;
use crate::plausible::Plausible;
use crate::row::{KnownOfRows, Recorded, RowData, RowSetting};
use crate::status::{PLANES, Status, map_meta, planes};
use crate::track::PixelTrack;
use photocurrent_core::series::to_bfloat16;
use photocurrent_core::{MapBand, NodeError, Rows, TrackBand, TracksMeta};
use photocurrent_sensor::effects::Site;
use photocurrent_sensor::elementary::{exp, exp_all};
use photocurrent_sensor::map::estimate::{HoldOut, Miss};
use photocurrent_sensor::map::losses::{self, Plain};
use photocurrent_sensor::map::{
    Hint, MapFrame, MapGroup, MapOptions, MapOutcome, MapProblem, MapSolution, MapStatus, MapTask, Noise,
    Pictured, PixelEvent, estimate,
};
use photocurrent_sensor::residuals::Misfit;
use photocurrent_sensor::undo::{Estimate, Known, Memory, Undo};
use rayon::prelude::*;
use std::sync::{Mutex, PoisonError};

/// So many pixels of a row are looked at to estimate the noise of its events.
const SAMPLED_PIXELS: usize = 16;
/// A knot is left away where the line between its neighbours misses it by less than this, natural-log units.
const THINNED_TO: f64 = 2e-4;
/// The same of the logarithm of its standard deviation.
const SIGMA_THINNED_TO: f64 = 0.05;

/// Solves the pixels of a row; keeps its memory from row to row.
#[derive(Default)]
pub struct RowSolver {
    group: MapGroup,
    taken: Taken,
    part: Part,
    /// Memory of solvers that work side by side.
    groups: Mutex<Vec<MapGroup>>,
}

/// Pixels of a row that one thread solves where a row is shared out.
const SHARED_OUT: usize = 128;

/// Some pixels of a row, solved.
#[derive(Default)]
pub(crate) struct Part {
    /// Knots of the pixels with their standard deviations, in the order in which they were solved, and where
    /// each pixel's stand.
    knots: Vec<(i64, f32, f32)>,
    knots_of: Vec<std::ops::Range<usize>>,
    thinner: Thinner,
    planes: Vec<[f32; PLANES.len()]>,
    /// How each came out when nothing was taken for lost.
    plain: Vec<Plain>,
}

/// Pixels of a row, posed.
pub(crate) struct Posed<'a> {
    pub(crate) model: &'a Model,
    pub(crate) setting: &'a RowSetting,
    pub(crate) data: &'a RowData,
    /// Those that have a frame.
    pub(crate) lit: &'a [usize],
    pub(crate) tasks: Vec<MapTask<'a>>,
}

impl Posed<'_> {
    /// What makes means of the answer of a pixel, in a row of that place.
    pub(crate) fn pictured(&self, row: usize, n: usize) -> Pictured {
        let x = self.lit[n];
        Pictured {
            row,
            ratio: self.data.light_ratio(x),
            most: self.data.plausible(x).held(f64::INFINITY),
            sigma_factor: self.setting.sigma_factor,
        }
    }
}

impl Part {
    /// Solves `lit` of the pixels of a row.
    fn solve(
        &mut self,
        group: &mut MapGroup,
        model: &Model,
        setting: &RowSetting,
        taken: &Taken,
        lit: &[usize],
        hints: Option<&[Vec<Hint>]>,
    ) {
        let Taken { data, given } = taken;
        let hints_of = |x: usize| hints.map_or(&[] as &[Hint], |hints| hints[x].as_slice());
        let tasks: Vec<MapTask<'_>> =
            lit.iter().map(|&x| task(model, setting, data, x, hints_of(x))).collect();
        let known = known_of(model, &tasks, lit, data, given, group);
        let posed = Posed { model, setting, data, lit, tasks: with_known(&tasks, &known) };
        self.begin(lit.len());
        group.solve(&posed.tasks, |n, solution| self.put(&posed, n, &solution));
        self.solve_losses(&posed, group);
    }

    /// Of so many pixels, none of them solved.
    pub(crate) fn begin(&mut self, pixels: usize) {
        self.knots.clear();
        self.knots_of.clear();
        self.knots_of.resize(pixels, 0..0);
        self.planes.clear();
        self.planes.resize(pixels, [0.0; PLANES.len()]);
        self.plain.clear();
        self.plain.resize(pixels, Plain::default());
    }

    /// Takes the answer of a pixel.
    pub(crate) fn put(&mut self, posed: &Posed<'_>, n: usize, solution: &MapSolution<'_>) {
        let Posed { model, setting, data, lit, .. } = posed;
        let begin = self.knots.len();
        let (ratio, plausible) = (data.light_ratio(lit[n]), data.plausible(lit[n]));
        let widened = (ratio, setting.sigma_factor);
        let brightest = self.thinner.thin(solution, &model.undo, widened, plausible, &mut self.knots);
        self.knots_of[n] = begin..self.knots.len();
        self.put_outcome(posed, n, &solution.outcome, brightest);
    }

    /// Takes how a pixel came out, and its brightest light, but not its light.
    pub(crate) fn put_outcome(&mut self, posed: &Posed<'_>, n: usize, outcome: &MapOutcome, brightest: f64) {
        self.plain[n] = Plain::of(outcome);
        let status = match outcome.status {
            MapStatus::Failed => Status::FellBack,
            _ if posed.tasks[n].problem.frames.iter().all(|frame| frame.saturated) => Status::Saturated,
            MapStatus::Converged | MapStatus::Unfinished => Status::Converged,
        };
        let excess = posed.data.plausible(posed.lit[n]).excess(brightest);
        self.planes[n] = planes(status, outcome.iterations, -outcome.log_evidence, &outcome.misfit, excess);
    }

    /// The knots of each pixel; none of those whose light was not taken.
    pub(crate) fn knots(&self) -> impl Iterator<Item = &[(i64, f32, f32)]> {
        self.knots_of.iter().map(|range| &self.knots[range.clone()])
    }

    /// Solves again the pixels that have lost events.
    pub(crate) fn solve_losses(&mut self, posed: &Posed<'_>, group: &mut MapGroup) {
        let tasks = &posed.tasks;
        let lost = losses::lost_before(tasks, &self.plain, group);
        let again: Vec<usize> = (0..tasks.len()).filter(|&n| !lost[n].is_empty()).collect();
        let with_losses = |&n: &usize| MapTask {
            problem: MapProblem { lost_before: &lost[n], ..tasks[n].problem },
            ..tasks[n]
        };
        let with_losses: Vec<MapTask<'_>> = again.iter().map(with_losses).collect();
        group.solve(&with_losses, |n, solution| self.put(posed, again[n], &solution));
    }
}

/// A loaded row.
#[derive(Default)]
pub struct Taken {
    data: RowData,
    /// What is known of the events of every pixel; empty = to be worked out from each alone.
    given: Vec<Known>,
}

impl Taken {
    /// The loaded row.
    pub fn data(&self) -> &RowData {
        &self.data
    }
}

/// Estimates of the pixels of a row.
#[derive(Default)]
pub struct RowLight {
    t_ns: Vec<i64>,
    log: Vec<f64>,
    of: Vec<std::ops::Range<usize>>,
    failed: Vec<bool>,
}

impl RowLight {
    /// Of pixel x: log photocurrent at instants, linear between; empty where it has no frame.
    pub fn of(&self, x: usize) -> (&[i64], &[f64]) {
        (&self.t_ns[self.of[x].clone()], &self.log[self.of[x].clone()])
    }

    /// Is it the double-integral estimate?
    pub fn has_failed(&self, x: usize) -> bool {
        self.failed[x]
    }
}

impl RowSolver {
    /// Takes in a row and solves it, with what is known of its events from neighbours, if that is the case;
    /// `shared_out` over all threads, which changes no bit.
    pub fn row(
        &mut self,
        model: &Model,
        setting: &RowSetting,
        recorded: &Recorded<'_>,
        row: u32,
        given: Option<&KnownOfRows>,
        shared_out: bool,
    ) -> Result<(TrackBand, MapBand), NodeError> {
        self.take(model, setting, recorded, row)?;
        if let Some(given) = given {
            self.give(given.of(row).to_vec());
        }
        if !shared_out {
            return Ok(self.solve(model, setting, recorded.meta, row, None));
        }
        let (groups, taken, lit) = (&self.groups, &self.taken, self.lit());
        let solve = |lit: &[usize]| {
            let pool = || groups.lock().unwrap_or_else(PoisonError::into_inner);
            let mut group = pool().pop().unwrap_or_default();
            let mut part = Part::default();
            part.solve(&mut group, model, setting, taken, lit, None);
            pool().push(group);
            part
        };
        let parts: Vec<Part> = lit.par_chunks(SHARED_OUT).map(solve).collect();
        Ok(together(setting, recorded.meta, row, lit.chunks(SHARED_OUT).zip(&parts)))
    }

    /// Takes in a row and solves the pixels of some columns, with what is known of its events from
    /// neighbours, if that is the case. Empty for a pixel without a frame.
    ///
    /// # Errors
    /// As [`RowSolver::take`].
    pub(crate) fn some(
        &mut self,
        model: &Model,
        setting: &RowSetting,
        recorded: &Recorded<'_>,
        row: u32,
        columns: &[usize],
        given: Option<&KnownOfRows>,
    ) -> Result<Vec<PixelTrack>, NodeError> {
        self.take(model, setting, recorded, row)?;
        if let Some(given) = given {
            self.give(given.of(row).to_vec());
        }
        let lit: Vec<usize> =
            columns.iter().copied().filter(|&x| !self.taken.data.frames_of(x).is_empty()).collect();
        self.part.solve(&mut self.group, model, setting, &self.taken, &lit, None);
        let mut solved = lit.iter().zip(self.part.knots_of.iter().zip(&self.part.planes)).peekable();
        let of_column = |x: &usize| match solved.next_if(|(lit, _)| *lit == x) {
            Some((_, (range, planes))) => {
                let knots = &self.part.knots[range.clone()];
                PixelTrack {
                    t_ns: knots.iter().map(|(t, ..)| *t).collect(),
                    photocurrent: knots.iter().map(|(_, i, _)| f64::from(*i)).collect(),
                    log_sigma: knots.iter().map(|(.., sigma)| f64::from(*sigma)).collect(),
                    has_converged: planes[0] != Status::FellBack as u8 as f32,
                }
            }
            None => PixelTrack::default(),
        };
        Ok(columns.iter().map(of_column).collect())
    }

    /// The pixels that have a frame.
    pub(crate) fn lit(&self) -> Vec<usize> {
        let data = &self.taken.data;
        (0..data.width()).filter(|&x| !data.frames_of(x).is_empty()).collect()
    }

    /// Takes in a row.
    pub fn take(
        &mut self,
        model: &Model,
        setting: &RowSetting,
        recorded: &Recorded<'_>,
        row: u32,
    ) -> Result<(), NodeError> {
        self.taken.given.clear();
        self.taken.data.take(model, recorded, row, setting.frame_dn)
    }

    /// What is known of the events of every pixel of the loaded row.
    pub fn give(&mut self, known: Vec<Known>) {
        self.taken.given = known;
    }

    /// The loaded row, by itself: the solver's memory is much larger, and serves many rows.
    pub fn hand_over(&mut self) -> Taken {
        std::mem::take(&mut self.taken)
    }

    /// Takes in a row that was handed over, for as long as `with` goes on.
    pub fn with<T>(&mut self, taken: &mut Taken, with: impl FnOnce(&mut RowSolver) -> T) -> T {
        std::mem::swap(&mut self.taken, taken);
        let done = with(self);
        std::mem::swap(&mut self.taken, taken);
        done
    }

    /// What is known of the events of the pixels `lit` of the loaded row, which `tasks` pose.
    pub(crate) fn known(
        &self,
        model: &Model,
        tasks: &[MapTask<'_>],
        lit: &[usize],
        group: &mut MapGroup,
    ) -> Vec<Known> {
        known_of(model, tasks, lit, &self.taken.data, &self.taken.given, group)
    }

    /// Estimates of the pixels of the loaded row, without more than what was given.
    pub fn light(&mut self, model: &Model, setting: &RowSetting, meta: &TracksMeta) -> RowLight {
        let width = meta.extent.width as usize;
        let lit = self.lit();
        let RowSolver { group, taken: Taken { data, given }, part: Part { knots, thinner, .. }, .. } = self;
        let setting = RowSetting { options: MapOptions { with_sigma: false, ..setting.options }, ..*setting };
        let tasks: Vec<MapTask<'_>> = lit.iter().map(|&x| task(model, &setting, data, x, &[])).collect();
        let known: Vec<Known> =
            if given.is_empty() { Vec::new() } else { lit.iter().map(|&x| given[x].clone()).collect() };
        let mut light = RowLight { of: vec![0..0; width], failed: vec![false; width], ..RowLight::default() };
        group.solve(&with_known(&tasks, &known), |n, solution| {
            let ratio = data.light_ratio(lit[n]);
            knots.clear();
            thinner.thin(&solution, &model.undo, (ratio, 1.0), data.plausible(lit[n]), knots);
            let begin = light.t_ns.len();
            light.t_ns.extend(knots.iter().map(|(t, _, _)| t));
            // As it was posed: in the photocurrent of the event pixel, and with what effects add to it.
            light.log.extend(knots.iter().map(|(_, i, _)| {
                model.undo.sum(libm::log(f64::max(f64::from(*i) / ratio, f64::MIN_POSITIVE)))
            }));
            light.of[lit[n]] = begin..light.t_ns.len();
            light.failed[lit[n]] = solution.outcome.status == MapStatus::Failed;
        });
        light
    }

    /// The loaded row.
    pub fn data(&self) -> &RowData {
        &self.taken.data
    }

    /// Solves the loaded row, with what is known from elsewhere for each of its pixels.
    pub fn solve(
        &mut self,
        model: &Model,
        setting: &RowSetting,
        meta: &TracksMeta,
        row: u32,
        hints: Option<&[Vec<Hint>]>,
    ) -> (TrackBand, MapBand) {
        let lit = self.lit();
        self.part.solve(&mut self.group, model, setting, &self.taken, &lit, hints);
        together(setting, meta, row, [(lit.as_slice(), &self.part)].into_iter())
    }

    /// Pixels of the loaded row that have events and frames, spread over their number of events; at most
    /// [`SAMPLED_PIXELS`].
    pub fn sample(&self) -> Vec<usize> {
        let data = &self.taken.data;
        let mut pixels: Vec<usize> = (0..data.width())
            .filter(|&x| !data.events_of(x).is_empty() && !data.frames_of(x).is_empty())
            .collect();
        pixels.sort_by_key(|&x| (data.events_of(x).len(), x));
        let taken = usize::min(pixels.len(), SAMPLED_PIXELS);
        (0..taken).map(|n| pixels[(2 * n + 1) * pixels.len() / (2 * taken)]).collect()
    }

    /// How badly hints, one set after the other, and its other measurements predict the frames of a pixel
    /// that are held out ([`estimate::prediction_errors`]).
    pub fn prediction_errors(
        &mut self,
        model: &Model,
        setting: &RowSetting,
        x: usize,
        hints: &[Vec<Hint>],
    ) -> Vec<f64> {
        self.with_known(model, setting, x, |problem, group| {
            let problems: Vec<MapProblem<'_>> =
                hints.iter().map(|hints| MapProblem { hints, ..problem }).collect();
            estimate::prediction_errors(&problems, &setting.options, group)
        })
    }

    /// What a pixel's other measurements predict of its frames that are held out
    /// ([`estimate::predictions`]).
    pub fn predictions(
        &mut self,
        model: &Model,
        setting: &RowSetting,
        x: usize,
        held: &[(HoldOut, Vec<Hint>)],
    ) -> Vec<(usize, f64)> {
        self.with_known(model, setting, x, |problem, group| {
            estimate::predictions(&problem, held, &setting.options, group)
        })
    }

    /// How the frames of a pixel that are held out are missed by hints and its other measurements
    /// ([`estimate::misses`]).
    pub fn misses(&mut self, model: &Model, setting: &RowSetting, x: usize, hints: &[Hint]) -> Vec<Miss> {
        self.with_known(model, setting, x, |problem, group| {
            estimate::misses(&[MapProblem { hints, ..problem }], &setting.options, group)
        })
    }

    /// What `answer` makes of the problem of a pixel of the loaded row, with what is known of its events.
    fn with_known<T>(
        &mut self,
        model: &Model,
        setting: &RowSetting,
        x: usize,
        answer: impl FnOnce(MapProblem<'_>, &mut MapGroup) -> T,
    ) -> T {
        let RowSolver { group, taken: Taken { data, given }, .. } = self;
        let task = [MapTask { problem: of_pixel(model, setting, data, x), options: setting.options }];
        let known = known_of(model, &task, &[x], data, given, group);
        answer(with_known(&task, &known)[0].problem, group)
    }
}

/// The parts of a row, left to right, as one.
pub(crate) fn together<'a>(
    setting: &RowSetting,
    meta: &TracksMeta,
    row: u32,
    parts: impl Iterator<Item = (&'a [usize], &'a Part)> + Clone,
) -> (TrackBand, MapBand) {
    let mut tracks = TrackBand::begin(row, meta.extent.width);
    tracks.reserve(parts.clone().map(|(_, part)| part.knots.len()).sum(), setting.options.with_sigma);
    let mut map = MapBand::zeros(Rows { start: row, end: row + 1 }, &map_meta(meta.extent));
    // As it stays where a pixel has no frame.
    for (plane, value) in planes(Status::NoFrame, 0, 0.0, &Misfit::default(), 0.0).into_iter().enumerate() {
        map.row_mut(plane, row).fill(value);
    }
    let mut push = |knots: &[(i64, f32, f32)]| {
        let knots = knots.iter().copied();
        if setting.options.with_sigma {
            tracks.push_with_sigma(knots)
        } else {
            tracks.push(knots.map(|(t, i, _)| (t, i)))
        }
    };
    let mut next = 0;
    for (lit, part) in parts {
        for (n, &x) in lit.iter().enumerate() {
            (next..x).for_each(|_| push(&[]));
            push(&part.knots[part.knots_of[n].clone()]);
            part.planes[n].iter().enumerate().for_each(|(plane, value)| map.row_mut(plane, row)[x] = *value);
            next = x + 1;
        }
    }
    (next..meta.extent.width as usize).for_each(|_| push(&[]));
    (tracks, map)
}

/// The problem of pixel x of a row.
pub(crate) fn task<'a>(
    model: &Model,
    setting: &RowSetting,
    data: &'a RowData,
    x: usize,
    hints: &'a [Hint],
) -> MapTask<'a> {
    let unrest = data.unrest(x);
    let off = |sigma: f64, unit: f64| {
        if unrest > 0.0 { libm::sqrt(sigma * sigma + unrest / (unit * unit)) } else { sigma }
    };
    let noise = Noise { event: off(setting.noise.event, model.threshold()), ..setting.noise };
    let problem = of_pixel(model, &RowSetting { noise, ..*setting }, data, x);
    let no_event_sigma = if data.has_event_pixel(x) { off(problem.no_event_sigma, 1.0) } else { 0.0 };
    MapTask { problem: MapProblem { hints, no_event_sigma, ..problem }, options: setting.options }
}

/// The same without hints and what colours do.
fn of_pixel<'a>(model: &Model, setting: &RowSetting, data: &'a RowData, x: usize) -> MapProblem<'a> {
    let (events, is_lone) = (data.events_of(x), data.is_lone(x));
    problem(model, events, is_lone, data.frames_of(x), setting.span, setting.noise)
}

/// What was given of the events of pixels `lit` of a row, or what each alone says.
fn known_of(
    model: &Model,
    tasks: &[MapTask<'_>],
    lit: &[usize],
    data: &RowData,
    given: &[Known],
    group: &mut MapGroup,
) -> Vec<Known> {
    if !given.is_empty() {
        return lit.iter().map(|&x| given[x].clone()).collect();
    }
    let recorded: Vec<(Site, &[PixelEvent])> = lit.iter().map(|&x| data.recorded_of(x)).collect();
    known(model, tasks, &recorded, group)
}

/// What effects did to the events of each problem ([`photocurrent_sensor::undo::Undo::at_light`]), at the
/// light that solves it: found in rounds, each with what the one before found. Empty where no effect is to be
/// undone. `recorded`: the pixels, and their events with stamps as recorded.
pub(crate) fn known(
    model: &Model,
    tasks: &[MapTask<'_>],
    recorded: &[(Site, &[PixelEvent])],
    group: &mut MapGroup,
) -> Vec<Known> {
    if !model.undo.needs_light() {
        return Vec::new();
    }
    let of = |task: &MapTask<'_>| Known { events: task.problem.events.to_vec(), ..Known::default() };
    let mut known: Vec<Known> = tasks.iter().map(of).collect();
    let mut memory = Memory::default();
    for _ in 0..model.undo_rounds {
        let mut next = known.clone();
        let mut now = with_known(tasks, &known);
        now.iter_mut().for_each(|task| task.options.with_sigma = false);
        group.solve(&now, |n, solution| {
            let (site, recorded) = recorded[n];
            let light = Estimate { t_ns: solution.t_ns, own: solution.log_photocurrent, seen: None };
            if solution.outcome.status != MapStatus::Failed {
                model.undo.at_light(
                    &model.sensor,
                    &site,
                    light,
                    recorded,
                    tasks[n].problem.events,
                    &mut next[n],
                    &mut memory,
                );
            }
        });
        known = next;
    }
    known
}

/// The problems with what is known of their events.
pub(crate) fn with_known<'a>(tasks: &[MapTask<'a>], known: &'a [Known]) -> Vec<MapTask<'a>> {
    let of = |(n, task): (usize, &MapTask<'a>)| {
        let problem = known.get(n).map_or(task.problem, |known| {
            let no_event_sigma = match task.problem.no_event_sigma {
                sigma if sigma > 0.0 && known.apart > 0.0 => libm::hypot(sigma, known.apart),
                sigma => sigma,
            };
            MapProblem { events: &known.events, beyond: &known.beyond, no_event_sigma, ..task.problem }
        });
        MapTask { problem, ..*task }
    };
    tasks.iter().enumerate().map(of).collect()
}

/// The problem of a pixel.
pub(crate) fn problem<'a>(
    model: &Model,
    events: &'a [PixelEvent],
    is_lone: &'a [bool],
    frames: &'a [MapFrame],
    span: (i64, i64),
    noise: Noise,
) -> MapProblem<'a> {
    MapProblem {
        events,
        is_lone,
        frames,
        hints: &[],
        start_ns: span.0,
        end_ns: span.1,
        sensor: model.sensor.map_sensor(),
        noise: Noise { threshold: libm::hypot(noise.threshold, model.undo.chance.of_pixels), ..noise },
        stamp_sigma_s: libm::hypot(model.stamp_sigma_s, model.undo.chance.of_stamps_s),
        no_event_sigma: NO_EVENT_SIGMA,
        lost_before: &[],
        beyond: &[],
    }
}

/// Leaves knots away; keeps its memory from pixel to pixel.
#[derive(Default)]
struct Thinner {
    /// Log photocurrent of the pixel's own at each knot, and the log of its standard deviation.
    log: Vec<f64>,
    log_sigma: Vec<f64>,
    /// The knots that are kept.
    kept: Vec<usize>,
    /// Their photocurrents, and then its standard deviations.
    of_kept: Vec<f64>,
}

impl Thinner {
    /// Keeps as few knots as join up to the same light, without what effects add to it and times a ratio,
    /// within [`THINNED_TO`], and to the same standard deviation, where there is one, times a factor, within
    /// [`SIGMA_THINNED_TO`]; gives the brightest photocurrent of all knots, times the ratio.
    ///
    /// Light is held at what is plausible; its standard deviation is then at least as large as what was
    /// removed. Standard deviations are rounded to 16 bits.
    fn thin(
        &mut self,
        solution: &MapSolution<'_>,
        undo: &Undo,
        (light_ratio, sigma_factor): (f64, f64),
        plausible: Plausible,
        knots: &mut Vec<(i64, f32, f32)>,
    ) -> f64 {
        self.fill(solution, undo);
        let (t, log, log_sigma) = (solution.t_ns, &self.log[..], &self.log_sigma[..]);
        self.kept.clear();
        self.kept.push(0);
        let (mut anchor, mut light, mut sigma) = (0, Corridor::OPEN, Corridor::OPEN);
        for k in 1..t.len() {
            let mut per_run = 1.0 / (t[k] - t[anchor]) as f64;
            let (of_light, of_sigma) = (log[k] - log[anchor], log_sigma[k] - log_sigma[anchor]);
            let (mut of_light, mut of_sigma) = (of_light * per_run, of_sigma * per_run);
            if !light.holds(of_light) || !sigma.holds(of_sigma) {
                anchor = k - 1;
                self.kept.push(anchor);
                (light, sigma) = (Corridor::OPEN, Corridor::OPEN);
                per_run = 1.0 / (t[k] - t[anchor]) as f64;
                of_light = (log[k] - log[anchor]) * per_run;
                of_sigma = (log_sigma[k] - log_sigma[anchor]) * per_run;
            }
            light = light.narrowed(of_light, THINNED_TO * per_run);
            sigma = sigma.narrowed(of_sigma, SIGMA_THINNED_TO * per_run);
        }
        if t.len() > 1 {
            self.kept.push(t.len() - 1);
        }
        self.of_kept.clear();
        self.of_kept.extend(self.kept.iter().map(|&k| log[k]));
        self.of_kept.extend(self.kept.iter().map(|&k| log_sigma[k]));
        exp_all(&mut self.of_kept);
        let (light, sigma) = self.of_kept.split_at(self.kept.len());
        for ((&k, light), sigma) in self.kept.iter().zip(light).zip(sigma) {
            let (photocurrent, sigma) = (light * light_ratio, sigma * sigma_factor);
            let held = plausible.held(photocurrent);
            let sigma =
                if held < photocurrent { f64::max(sigma, libm::log(photocurrent / held)) } else { sigma };
            knots.push((t[k], held as f32, to_bfloat16(sigma as f32)));
        }
        exp(log.iter().copied().fold(f64::NEG_INFINITY, f64::max)) * light_ratio
    }

    fn fill(&mut self, solution: &MapSolution<'_>, undo: &Undo) {
        let (sum, variance) = (solution.log_photocurrent, solution.variance);
        undo.own_of(sum, &mut self.log);
        estimate::log_sigmas(variance, &mut self.log_sigma);
        self.log_sigma.resize(sum.len(), 0.0);
        if variance.is_empty() {
            return;
        }
        // A small relative change of the sum is a larger one of the pixel's own part.
        for ((log_sigma, sum), own) in self.log_sigma.iter_mut().zip(sum).zip(&self.log) {
            *log_sigma += sum - own;
        }
    }
}

/// The slopes from the last kept knot that pass every knot since within a tolerance.
#[derive(Clone, Copy)]
struct Corridor {
    low: f64,
    high: f64,
}

impl Corridor {
    const OPEN: Corridor = Corridor { low: f64::NEG_INFINITY, high: f64::INFINITY };

    fn holds(&self, slope: f64) -> bool {
        self.low <= slope && slope <= self.high
    }

    /// Only slopes within `tolerance` of this one.
    fn narrowed(self, slope: f64, tolerance: f64) -> Corridor {
        Corridor { low: f64::max(self.low, slope - tolerance), high: f64::min(self.high, slope + tolerance) }
    }
}
