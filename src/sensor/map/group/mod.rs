//! Many pixels, eight at a time, one in each lane of a vector.
//!
//! The passes over a chain wait for their own results most of the time; eight chains side by side wait together. The same equations in the same
//! order as for one pixel alone, so that the answer is the same to the last bit (the evidence to rounding), whichever pixels share a
//! group. Pixels that ask for a second start wait until eight of them do. Left to the solver of one pixel: pixels that fail, and standard deviations of those with hints.

mod again;
mod columns;
mod passes;
mod stream;
#[cfg(test)]
mod tests;
mod variance;

use super::knots::Knots;
use super::prior::{Prior, Segments};
use super::smoother::FIRST_VARIANCE;
use super::start::Start;
use super::state::{ON, STATES};
use super::{
    Evidence, FIRST_DAMPING, LOG_LIMIT, LONGEST_STEP, MapOptions, MapProblem, MapSolution, MapStatus, MapWorkspace, NO_EVENT_FROM, Noise, Offsets,
    has_run_away, solve_with, thresholds, variance_at,
};
use crate::residuals::Misfit;
use crate::wide::{Flags, WIDTH, Wide};
use again::Waiting;
use columns::{Columns, Common, Cost, Family, Pixel, adapt, misfits, moved, run};
use passes::{Ask, Line, Memory, WideOffsets, step};
use stream::{EVENT, NO_EVENT, Stream};

/// A pixel that is to be solved, and how.
#[derive(Clone, Copy, Debug)]
pub struct MapTask<'a> {
    /// The pixel.
    pub problem: MapProblem<'a>,
    /// How it is solved.
    pub options: MapOptions,
}

/// Solves many pixels; keeps its memory from call to call.
///
/// Each gets what [`super::solve`] gives it alone: the same light to the last bit, and the evidence to rounding.
#[derive(Clone, Debug, Default)]
pub struct MapGroup {
    alone: MapWorkspace,
    lanes: [Lane; WIDTH],
    columns: Columns,
    u: Vec<Wide>,
    trial: Vec<Wide>,
    change: Vec<Wide>,
    lines: Vec<Line>,
    exact: Memory<ON>,
    free: Memory<STATES>,
    waiting: Waiting,
    variance: Vec<Wide>,
    of_pixel: Vec<f64>,
    order: Vec<usize>,
}

/// One pixel of a group.
#[derive(Clone, Debug, Default)]
struct Lane {
    knots: Knots,
    segments: Segments,
    start: Start,
    stream: Stream,
    /// The start, later the answer.
    u: Vec<f64>,
    state: LaneState,
}

/// How far a lane has come.
#[derive(Clone, Copy, Debug)]
struct LaneState {
    /// Is it still on its way?
    steps: bool,
    status: MapStatus,
    iterations: usize,
    /// Refused attempts at the current step.
    attempts: usize,
    damping: f64,
    offsets: Offsets,
    /// What the prior expects of the thresholds at the current step.
    expected: Offsets,
    /// 0 while the no-event constraint does not count.
    no_event_sigma: f64,
    /// Of where it stands: all, and the parts that do not depend on the prior.
    cost: f64,
    measured: f64,
    no_event_square: f64,
    /// How much of the step is taken.
    share: f64,
    /// As the task states it.
    noise: Noise,
}

impl Default for LaneState {
    fn default() -> LaneState {
        LaneState {
            steps: false,
            status: MapStatus::Unfinished,
            iterations: 0,
            attempts: 0,
            damping: 0.0,
            offsets: Offsets::default(),
            expected: Offsets::default(),
            no_event_sigma: 0.0,
            cost: 0.0,
            measured: 0.0,
            no_event_square: 0.0,
            share: 1.0,
            noise: Noise::default(),
        }
    }
}

impl LaneState {
    fn no_event(&self, square: f64) -> f64 {
        if self.no_event_sigma > 0.0 { square / (self.no_event_sigma * self.no_event_sigma) } else { 0.0 }
    }

    /// Sum of the squares of misfits and of the broken no-event constraint.
    fn misfit(&self, problem: &MapProblem<'_>) -> f64 {
        let sigma = problem.no_event_sigma;
        self.measured + if sigma > 0.0 { self.no_event_square / (sigma * sigma) } else { 0.0 }
    }

    /// Out of attempts: as good as it gets when some step went down, else a failure.
    fn give_up(&mut self) {
        self.status = if self.iterations > 1 { MapStatus::Unfinished } else { MapStatus::Failed };
        self.steps = false;
    }
}

/// Attempts at a step before no step goes down any more.
const ATTEMPTS: usize = 6;

impl MapGroup {
    /// Solves `tasks` and gives each answer, with its place in `tasks`, to `take`, in any order.
    ///
    /// Quickest when pixels with about equally many events are among them; eight or more, of one front end and one family of priors.
    pub fn solve(&mut self, tasks: &[MapTask<'_>], take: impl FnMut(usize, MapSolution<'_>)) {
        self.solve_with(tasks, Evidence::Wanted, take);
    }

    /// The same, with the evidence or without.
    pub(super) fn solve_with(&mut self, tasks: &[MapTask<'_>], evidence: Evidence, mut take: impl FnMut(usize, MapSolution<'_>)) {
        let mut order = std::mem::take(&mut self.order);
        order.clear();
        order.extend(0..tasks.len());
        // Pixels of a group should be about equally long. Nothing else depends on the order.
        let family = |n: usize| match tasks[n].options.prior {
            Prior::Local(_) => 0,
            Prior::Walk { .. } => 1,
            Prior::IntegratedWalk { .. } => 2,
        };
        order.sort_by_key(|&n| (is_exact(&tasks[n]), family(n), tasks[n].problem.events.len(), tasks[n].problem.hints.len(), n));
        let mut rest = order.as_slice();
        while let Some(&first) = rest.first() {
            let alike = |n: usize| {
                tasks[n].problem.sensor.front_end == tasks[first].problem.sensor.front_end
                    && is_advancing(&tasks[n]) == is_advancing(&tasks[first])
                    && (is_exact(&tasks[n]), family(n)) == (is_exact(&tasks[first]), family(first))
            };
            let count = rest.iter().take(WIDTH).take_while(|n| alike(**n)).count();
            let (group, later) = rest.split_at(count);
            rest = later;
            if count == 1 {
                take(first, solve_with(&tasks[first].problem, &tasks[first].options, evidence, &mut self.alone));
            } else {
                self.group(tasks, group, evidence, &mut take);
            }
            let is_last = rest.first().is_none_or(|&next| !alike(next));
            self.again(tasks, is_last, evidence, &mut take);
        }
        self.order = order;
    }

    fn group(&mut self, all: &[MapTask<'_>], group: &[usize], evidence: Evidence, take: &mut impl FnMut(usize, MapSolution<'_>)) {
        let tasks = lanes_of(all, group);
        let common = self.begin(&tasks, group.len());
        let first = self.u[0];
        self.descend(&tasks, &common, first, group.len());
        let waits = self.wait(&tasks, group);
        self.finish(&common, &tasks, first, evidence, |l| (!waits[l]).then_some(group.get(l).copied()).flatten(), take);
    }

    /// Gives the answers of lanes to `take`: of those that have a place.
    fn finish(
        &mut self,
        common: &Common,
        tasks: &[&MapTask<'_>; WIDTH],
        first: Wide,
        evidence: Evidence,
        place: impl Fn(usize) -> Option<usize>,
        take: &mut impl FnMut(usize, MapSolution<'_>),
    ) {
        if (0..WIDTH).all(|l| place(l).is_none()) {
            return;
        }
        // Hints count as another variance for standard deviations than for the light.
        let with_sigma = tasks.iter().any(|task| task.options.with_sigma) && tasks.iter().all(|task| task.problem.hints.is_empty());
        let is_judged = evidence == Evidence::Wanted;
        let mut log_evidence = [0.0; WIDTH];
        if is_judged || with_sigma {
            log_evidence = self.judge_all(common, first, is_exact(tasks[0]), with_sigma);
        }
        let misfits = if is_judged { misfits(&self.lines) } else { [(Misfit::default(), 0.0); WIDTH] };
        for (l, n) in (0..WIDTH).filter_map(|l| Some((l, place(l)?))) {
            self.take_lane(l);
            let (task, lane) = (tasks[l], &mut self.lanes[l]);
            if lane.state.status == MapStatus::Failed || has_run_away(&task.problem, &lane.u) {
                take(n, solve_with(&task.problem, &task.options, evidence, &mut self.alone));
                continue;
            }
            let LaneState { offsets, status, iterations, .. } = lane.state;
            let variance: &[f64] = match (task.options.with_sigma, with_sigma) {
                (false, _) => &[],
                (true, true) => {
                    lane.stream.of_knots(&self.variance, l, &mut self.of_pixel);
                    &self.of_pixel
                }
                (true, false) => variance_at(task, &lane.u, &offsets, lane.state.no_event_sigma, &mut self.alone),
            };
            let (log_evidence, (misfit, largest_square)) = (if is_judged { log_evidence[l] } else { 0.0 }, misfits[l]);
            take(
                n,
                MapSolution { t_ns: &lane.knots.t_ns, log_photocurrent: &lane.u, variance, offsets, status, iterations, log_evidence, misfit, largest_square },
            );
        }
    }

    /// Iterates all lanes that step, until none does.
    fn descend(&mut self, tasks: &[&MapTask<'_>; WIDTH], common: &Common, first: Wide, count: usize) {
        while self.lanes.iter().any(|lane| lane.state.steps) {
            let prior_cost = adapt(&mut self.columns, common, &self.u);
            for (l, lane) in self.lanes.iter_mut().enumerate() {
                begin_step(&mut lane.state, tasks[l], prior_cost.0[l]);
            }
            let damping = wide(&self.lanes, |state| if state.steps { state.damping } else { 0.0 });
            let ask = ask(&self.lanes, &self.columns, &self.lines, (first, self.u[0]), damping);
            let (longest, by) = if is_exact(tasks[0]) { step(&ask, &mut self.exact, &mut self.change) } else { step(&ask, &mut self.free, &mut self.change) };
            for (l, lane) in self.lanes.iter_mut().enumerate() {
                lane.state.share = f64::min(1.0, LONGEST_STEP / longest.0[l]);
            }
            let share = wide(&self.lanes, |state| state.share);
            moved(&self.u, &self.change, share, Wide::splat(LOG_LIMIT), &mut self.trial);
            let offsets = offsets(&self.lanes).moved(&by, share);
            let cost = run(&self.columns, common, &self.trial, &offsets, &mut self.lines);
            let mut accepted = Wide::ZERO;
            for (l, lane) in self.lanes.iter_mut().enumerate() {
                let is_better = judge(&mut lane.state, tasks[l], &cost, l, longest.0[l], offsets.lane(l));
                accepted.0[l] = if is_better || l >= count { 1.0 } else { 0.0 };
            }
            self.accept(common, accepted);
        }
    }

    /// The log light of a lane becomes that of its pixel.
    fn take_lane(&mut self, l: usize) {
        let lane = &mut self.lanes[l];
        lane.stream.of_knots(&self.u, l, &mut lane.u);
    }

    /// What the lanes have in common, and their constants.
    fn common(&self, tasks: &[&MapTask<'_>; WIDTH]) -> Common {
        let family = Family::of(tasks.map(|task| task.options.prior));
        let of = |part: fn(&MapProblem<'_>) -> f64| Wide(std::array::from_fn(|l| part(&tasks[l].problem)));
        Common {
            front_end: tasks[0].problem.sensor.front_end,
            family,
            advances: is_advancing(tasks[0]),
            on: of(|problem| problem.sensor.threshold_on),
            off: of(|problem| problem.sensor.threshold_off),
            stamp_sigma_s: of(|problem| problem.stamp_sigma_s),
        }
    }

    /// Runs the lanes where they stand.
    fn measure(&mut self, common: &Common) {
        let cost = run(&self.columns, common, &self.u, &offsets(&self.lanes), &mut self.lines);
        for (l, lane) in self.lanes.iter_mut().enumerate() {
            let of_offsets = lane.state.offsets.cost(&lane.state.noise);
            (lane.state.measured, lane.state.no_event_square) = (cost.measured.0[l] + of_offsets, cost.no_event_square.0[l]);
        }
    }

    /// Lays out the pixels of a group, each at its start.
    fn begin(&mut self, tasks: &[&MapTask<'_>; WIDTH], count: usize) -> Common {
        for l in 0..count {
            let MapTask { problem, options } = tasks[l];
            let (before, lanes) = self.lanes.split_at_mut(l);
            match before.last().filter(|_| starts_alike(tasks[l - 1], tasks[l])) {
                Some(before) => {
                    lanes[0].knots.copy(&before.knots);
                    lanes[0].u.clone_from(&before.u);
                }
                None => {
                    lanes[0].knots.lay(problem, options.spacing_ns);
                    lanes[0].start.fill(problem, &lanes[0].knots, &mut lanes[0].u);
                }
            }
            lanes[0].segments.lay(&lanes[0].knots.t_ns, &options.prior);
        }
        let common = self.load(tasks, count, |_| true);
        self.measure(&common);
        common
    }

    /// Puts the pixels of a group into their lanes, with the light that they have; those that step go on from there.
    fn load(&mut self, tasks: &[&MapTask<'_>; WIDTH], count: usize, steps: impl Fn(usize) -> bool) -> Common {
        let common = self.common(tasks);
        for (l, lane) in self.lanes.iter_mut().enumerate() {
            let MapTask { problem, options } = tasks[l];
            lane.state = LaneState { steps: l < count && options.max_iterations > 0 && steps(l), noise: problem.noise, ..LaneState::default() };
            if l < count {
                lane.stream.fill(problem, &lane.knots);
            }
        }
        let pixels: [Pixel<'_>; WIDTH] = std::array::from_fn(|l| {
            let lane = &self.lanes[usize::min(l, count - 1)];
            Pixel { stream: &lane.stream, segments: &lane.segments, u: &lane.u }
        });
        let steps = self.columns.fill(&common, &pixels, &mut self.u);
        self.trial.resize(steps, Wide::ZERO);
        self.change.resize(steps, Wide::ZERO);
        self.lines.resize(steps, Line::default());
        common
    }

    /// Lanes with 1 go on from the trial, the others from where they were.
    fn accept(&mut self, common: &Common, accepted: Wide) {
        if accepted == Wide::ONE {
            std::mem::swap(&mut self.u, &mut self.trial);
            return;
        }
        for (u, trial) in self.u.iter_mut().zip(&self.trial) {
            *u = accepted.equal(1.0, *trial, *u);
        }
        run(&self.columns, common, &self.u, &offsets(&self.lanes), &mut self.lines);
    }

    /// The evidence of each lane; the posterior variance of log light at each step as well where it is asked for.
    fn judge_all(&mut self, common: &Common, first: Wide, is_exact: bool, with_variance: bool) -> [f64; WIDTH] {
        adapt(&mut self.columns, common, &self.u);
        // As measured: what the prior expects of thresholds has no part in it.
        self.lanes.iter_mut().for_each(|lane| lane.state.expected = Offsets::default());
        let ask = ask(&self.lanes, &self.columns, &self.lines, (first, self.u[0]), Wide::ZERO);
        let evidence = match (with_variance, is_exact) {
            (false, true) => passes::evidence::<ON>(&ask),
            (false, false) => passes::evidence::<STATES>(&ask),
            (true, true) => variance::variance::<ON>(&ask, &mut self.exact, &mut self.variance),
            (true, false) => variance::variance::<STATES>(&ask, &mut self.free, &mut self.variance),
        };
        std::array::from_fn(|l| evidence.log(l))
    }
}

/// The tasks of a group; lanes without a pixel repeat the last.
fn lanes_of<'a, 'b>(all: &'a [MapTask<'b>], group: &[usize]) -> [&'a MapTask<'b>; WIDTH] {
    std::array::from_fn(|l| &all[group[usize::min(l, group.len() - 1)]])
}

fn wide(lanes: &[Lane; WIDTH], of: impl Fn(&LaneState) -> f64) -> Wide {
    Wide(std::array::from_fn(|l| of(&lanes[l].state)))
}

fn offsets(lanes: &[Lane; WIDTH]) -> WideOffsets {
    let part = |of: fn(&Offsets) -> f64| wide(lanes, |state| of(&state.offsets));
    WideOffsets { reference: part(|offsets| offsets.reference), on: part(|offsets| offsets.on), off: part(|offsets| offsets.off) }
}

/// What the passes are asked for at `here`, the first log light, when the prior expects `first` of it.
fn ask<'a>(lanes: &[Lane; WIDTH], columns: &'a Columns, lines: &'a [Line], (first, here): (Wide, Wide), damping: Wide) -> Ask<'a> {
    let offsets = offsets(lanes);
    Ask {
        lines,
        expected: &columns.expected,
        what: &columns.what,
        events: Flags(std::array::from_fn(|l| if lanes[l].state.no_event_sigma > 0.0 { EVENT | NO_EVENT } else { EVENT })),
        damping,
        first: first - here,
        offsets: WideOffsets { on: offsets.on - wide(lanes, |state| state.expected.on), off: offsets.off - wide(lanes, |state| state.expected.off), ..offsets },
        first_variance: FIRST_VARIANCE,
        reference_variance: wide(lanes, |state| state.noise.reference * state.noise.reference),
        threshold_variance: wide(lanes, |state| state.noise.threshold * state.noise.threshold),
    }
}

/// Are both tasks of one pixel, so that they have the same knots and the same start?
fn starts_alike(one: &MapTask<'_>, other: &MapTask<'_>) -> bool {
    let (a, b) = (&one.problem, &other.problem);
    let same = a.lost_before == b.lost_before
        && a.beyond == b.beyond
        && std::ptr::eq(a.events, b.events)
        && std::ptr::eq(a.frames, b.frames)
        && std::ptr::eq(a.hints, b.hints);
    let solved = |task: &MapTask<'_>| (task.problem.start_ns, task.problem.end_ns, task.problem.sensor, task.problem.noise.lone, task.options.spacing_ns);
    same && solved(one) == solved(other)
}

/// Are the thresholds exact?
fn is_exact(task: &MapTask<'_>) -> bool {
    task.problem.noise.threshold <= 0.0
}

fn is_advancing(task: &MapTask<'_>) -> bool {
    task.problem.sensor.reset != photocurrent_core::sensor::Reset::Resample
}

/// A new step of a lane, unless it is at another attempt.
fn begin_step(state: &mut LaneState, task: &MapTask<'_>, prior_cost: f64) {
    if !state.steps || state.attempts > 0 {
        return;
    }
    state.iterations += 1;
    if state.iterations == NO_EVENT_FROM {
        state.no_event_sigma = task.problem.no_event_sigma;
    }
    state.expected = thresholds::expected(&task.problem, prior_cost, &state.offsets);
    let pulled = thresholds::pulled(&state.expected, &state.offsets, &task.problem.noise);
    state.cost = state.measured + prior_cost + state.no_event(state.no_event_square) - pulled;
    if !state.cost.is_finite() {
        state.status = MapStatus::Failed;
        state.steps = false;
    }
}

/// What becomes of a lane after a step: is its trial accepted?
fn judge(state: &mut LaneState, task: &MapTask<'_>, cost: &Cost, l: usize, longest: f64, offsets: Offsets) -> bool {
    if !state.steps {
        return false;
    }
    let measured = cost.measured.0[l] + offsets.cost(&task.problem.noise);
    let pulled = thresholds::pulled(&state.expected, &offsets, &task.problem.noise);
    let total = measured + cost.prior.0[l] + state.no_event(cost.no_event_square.0[l]) - pulled;
    // A step at the level of rounding may go up by rounding.
    let goes_down = longest.is_finite() && total <= state.cost * (1.0 + 1e-9) + 1e-9;
    if !goes_down {
        state.damping = f64::max(state.damping * 10.0, FIRST_DAMPING);
        state.attempts += 1;
        if state.attempts == ATTEMPTS {
            state.give_up();
        }
        return false;
    }
    (state.measured, state.no_event_square, state.offsets) = (measured, cost.no_event_square.0[l], offsets);
    state.damping = if state.damping > FIRST_DAMPING { state.damping * 0.1 } else { 0.0 };
    state.attempts = 0;
    if longest < task.options.tolerance {
        state.status = MapStatus::Converged;
        state.steps = false;
    } else if state.iterations == task.options.max_iterations {
        state.steps = false;
    }
    true
}
