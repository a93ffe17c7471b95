//! The solver: groups of pixels, their Gauss-Newton steps, and their answers.

use super::super::options::{Evidence, MapOutcome, MapSolution, MapStatus, MapTask};
use super::super::prior::Prior;
use super::super::problem::{MapProblem, Offsets, has_run_away};
use super::super::state::{ON, STATES};
use super::columns::{Columns, Common, Family, Pixel, adapt, misfits, moved, run};
use super::lane::{
    Lane, LaneState, begin_step, is_advancing, is_exact, judge, lanes_of, offsets, starts_alike, wide,
};
use super::passes::{self, Ask, Line, Memory, WideOffsets, step};
use super::stream::{EVENT, LIGHT, NO_EVENT};
use super::variance;
use super::waiting::Waiting;
use crate::misfit::Misfit;
use crate::wide::{Flags, WIDTH, Wide};

/// Variance of the first log light around the start value: free for all practical light.
pub const FIRST_VARIANCE: f64 = 9.0;
/// Steps longer than this are cut, natural-log units.
pub const LONGEST_STEP: f64 = 1.5;
/// Log light stays inside plus and minus this.
pub const LOG_LIMIT: f64 = 40.0;

/// Solves many pixels; keeps its memory from call to call.
///
/// Each gets what it gets alone, to the last bit.
#[derive(Clone, Debug, Default)]
pub struct MapGroup {
    pub(super) side_by_side: InStep<WIDTH>,
    /// For a pixel that is solved alone: idle lanes would cost as much as pixels.
    alone: InStep<1>,
    order: Vec<usize>,
    answer: Answer,
}

/// Pixels that go in step, with the memory of their passes.
#[derive(Clone, Debug)]
pub(super) struct InStep<const W: usize> {
    pub(super) lanes: [Lane; W],
    pub(super) columns: Columns<W>,
    pub(super) u: Vec<Wide<W>>,
    pub(super) trial: Vec<Wide<W>>,
    pub(super) change: Vec<Wide<W>>,
    pub(super) lines: Vec<Line<W>>,
    pub(super) exact: Memory<ON, W>,
    pub(super) free: Memory<STATES, W>,
    pub(super) waiting: Waiting,
    pub(super) variance: Vec<Wide<W>>,
    pub(super) of_pixel: Vec<f64>,
}

impl<const W: usize> Default for InStep<W> {
    fn default() -> InStep<W> {
        InStep {
            lanes: std::array::from_fn(|_| Lane::default()),
            columns: Columns::default(),
            u: Vec::new(),
            trial: Vec::new(),
            change: Vec::new(),
            lines: Vec::new(),
            exact: Memory::default(),
            free: Memory::default(),
            waiting: Waiting::default(),
            variance: Vec::new(),
            of_pixel: Vec::new(),
        }
    }
}

/// The answer for a pixel that is solved alone.
#[derive(Clone, Debug, Default)]
struct Answer {
    t_ns: Vec<i64>,
    log_photocurrent: Vec<f64>,
    variance: Vec<f64>,
}

impl MapGroup {
    /// Solves `tasks` and gives each answer, with its place in `tasks`, to `take`, in any order.
    ///
    /// Quickest when pixels with about equally many events are among them; eight or more, of one front end
    /// and one family of priors.
    pub fn solve(&mut self, tasks: &[MapTask<'_>], mut take: impl FnMut(usize, MapSolution<'_>)) {
        self.solve_with(tasks, Evidence::Wanted, &mut take);
    }

    /// Solves one pixel.
    pub fn solve_one(&mut self, task: &MapTask<'_>) -> MapSolution<'_> {
        let mut answer = std::mem::take(&mut self.answer);
        let mut outcome = None;
        self.solve(std::slice::from_ref(task), |_, solution| {
            solution.t_ns.clone_into(&mut answer.t_ns);
            solution.log_photocurrent.clone_into(&mut answer.log_photocurrent);
            solution.variance.clone_into(&mut answer.variance);
            outcome = Some(solution.outcome);
        });
        self.answer = answer;
        let Answer { t_ns, log_photocurrent, variance } = &self.answer;
        MapSolution { t_ns, log_photocurrent, variance, outcome: outcome.expect("every task has one answer") }
    }

    /// Solves `tasks`, with the evidence or without. Not generic, so that the passes are compiled once, here.
    pub(crate) fn solve_with(
        &mut self,
        tasks: &[MapTask<'_>],
        evidence: Evidence,
        take: &mut dyn FnMut(usize, MapSolution<'_>),
    ) {
        let mut order = std::mem::take(&mut self.order);
        order.clear();
        order.extend(0..tasks.len());
        // Pixels of a group should be about equally long. Nothing else depends on the order.
        let family = |n: usize| match tasks[n].options.prior {
            Prior::Local(_) => 0,
            Prior::Walk { .. } => 1,
            Prior::IntegratedWalk { .. } => 2,
        };
        order.sort_by_key(|&n| {
            (is_exact(&tasks[n]), family(n), tasks[n].problem.events.len(), tasks[n].problem.hints.len(), n)
        });
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
                self.alone.group(tasks, group, evidence, take);
                self.alone.again(tasks, true, evidence, take);
            } else {
                self.side_by_side.group(tasks, group, evidence, take);
            }
            let is_last = rest.first().is_none_or(|&next| !alike(next));
            self.side_by_side.again(tasks, is_last, evidence, take);
        }
        self.order = order;
    }
}

impl<const W: usize> InStep<W> {
    fn group(
        &mut self,
        all: &[MapTask<'_>],
        group: &[usize],
        evidence: Evidence,
        take: &mut dyn FnMut(usize, MapSolution<'_>),
    ) {
        let tasks = lanes_of(all, group);
        let common = self.begin(&tasks, group.len());
        let first = self.u[0];
        self.descend(&tasks, &common, first, group.len());
        let waits = self.wait(&tasks, group);
        self.finish(
            &common,
            &tasks,
            first,
            evidence,
            |l| (!waits[l]).then_some(group.get(l).copied()).flatten(),
            take,
        );
    }

    /// Gives the answers of lanes to `take`: of those that have a place.
    pub(super) fn finish(
        &mut self,
        common: &Common<W>,
        tasks: &[&MapTask<'_>; W],
        first: Wide<W>,
        evidence: Evidence,
        place: impl Fn(usize) -> Option<usize>,
        take: &mut dyn FnMut(usize, MapSolution<'_>),
    ) {
        if (0..W).all(|l| place(l).is_none()) {
            return;
        }
        self.fall_back(common, tasks, &place);
        let with_sigma = tasks.iter().any(|task| task.options.with_sigma);
        let has_hints = tasks.iter().any(|task| !task.problem.hints.is_empty());
        let is_judged = evidence == Evidence::Wanted;
        let is_exact = is_exact(tasks[0]);
        let mut log_evidence = [0.0; W];
        // Pseudo-measurements have another variance in the posterior variance than in the rest, which takes a
        // pass of its own.
        if is_judged && (has_hints || !with_sigma) {
            log_evidence = self.judge_all(common, first, is_exact, false);
        }
        let misfits = if is_judged { misfits(&self.lines) } else { [(Misfit::default(), 0.0, 0); W] };
        if with_sigma {
            self.widen_hints();
            let of_all = self.judge_all(common, first, is_exact, true);
            log_evidence = if has_hints { log_evidence } else { of_all };
        }
        for (l, n) in (0..W).filter_map(|l| Some((l, place(l)?))) {
            let (task, lane) = (tasks[l], &self.lanes[l]);
            let LaneState { offsets, status, iterations, second, .. } = lane.state;
            if task.options.with_sigma {
                lane.stream.of_knots(&self.variance, l, &mut self.of_pixel);
            } else {
                self.of_pixel.clear();
            }
            let (log_evidence, (misfit, largest_square, at)) =
                (if is_judged { log_evidence[l] } else { 0.0 }, misfits[l]);
            let (t_ns, log_photocurrent, variance) = (&lane.knots.t_ns, &lane.u, &self.of_pixel);
            let largest_ns = t_ns[lane.stream.steps[at].knot as usize];
            let outcome = MapOutcome {
                offsets,
                status,
                iterations,
                log_evidence,
                misfit,
                largest_square,
                largest_ns,
                second,
            };
            take(n, MapSolution { t_ns, log_photocurrent, variance, outcome });
        }
    }

    /// Gives each lane that has a place its light: the answer, or the start where that failed or is
    /// implausible.
    fn fall_back(
        &mut self,
        common: &Common<W>,
        tasks: &[&MapTask<'_>; W],
        place: impl Fn(usize) -> Option<usize>,
    ) {
        let mut has_failed = false;
        for l in (0..W).filter(|l| place(*l).is_some()) {
            self.take_lane(l);
            let (problem, lane) = (&tasks[l].problem, &mut self.lanes[l]);
            if lane.state.status != MapStatus::Failed && !has_run_away(problem, &lane.u) {
                continue;
            }
            has_failed = true;
            (lane.state.status, lane.state.offsets) = (MapStatus::Failed, Offsets::default());
            lane.start.fill(problem, &lane.knots, &mut lane.u);
            lane.stream.spread(&lane.u, l, &mut self.u);
        }
        if has_failed {
            self.measure(common);
        }
    }

    /// Pseudo-measurements get the variance that counts for the posterior variance.
    pub(super) fn widen_hints(&mut self) {
        for (l, lane) in self.lanes.iter().enumerate() {
            for (line, step) in
                self.lines.iter_mut().zip(&lane.stream.steps).filter(|(_, step)| step.what & LIGHT != 0)
            {
                line.variance.0[l] = step.for_sigma;
            }
        }
    }

    /// Iterates all lanes that step, until none does.
    pub(super) fn descend(
        &mut self,
        tasks: &[&MapTask<'_>; W],
        common: &Common<W>,
        first: Wide<W>,
        count: usize,
    ) {
        while self.lanes.iter().any(|lane| lane.state.steps) {
            let prior_cost = adapt(&mut self.columns, common, &self.u);
            for (l, lane) in self.lanes.iter_mut().enumerate() {
                begin_step(&mut lane.state, tasks[l], prior_cost.0[l]);
            }
            let damping = wide(&self.lanes, |state| if state.steps { state.damping } else { 0.0 });
            let ask = ask(&self.lanes, &self.columns, &self.lines, (first, self.u[0]), damping);
            let (longest, by) = if is_exact(tasks[0]) {
                step(&ask, &mut self.exact, &mut self.change)
            } else {
                step(&ask, &mut self.free, &mut self.change)
            };
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
    pub(super) fn take_lane(&mut self, l: usize) {
        let lane = &mut self.lanes[l];
        lane.stream.of_knots(&self.u, l, &mut lane.u);
    }

    /// What the lanes have in common, and their constants.
    pub(super) fn common(&self, tasks: &[&MapTask<'_>; W]) -> Common<W> {
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
    pub(super) fn measure(&mut self, common: &Common<W>) {
        let cost = run(&self.columns, common, &self.u, &offsets(&self.lanes), &mut self.lines);
        for (l, lane) in self.lanes.iter_mut().enumerate() {
            let of_offsets = lane.state.offsets.cost(&lane.state.noise);
            (lane.state.measured, lane.state.no_event_square) =
                (cost.measured.0[l] + of_offsets, cost.no_event_square.0[l]);
        }
    }

    /// Lays out the pixels of a group, each at its start.
    pub(super) fn begin(&mut self, tasks: &[&MapTask<'_>; W], count: usize) -> Common<W> {
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

    /// Puts the pixels of a group into their lanes, with the light that they have; those that step go on from
    /// there.
    pub(super) fn load(
        &mut self,
        tasks: &[&MapTask<'_>; W],
        count: usize,
        steps: impl Fn(usize) -> bool,
    ) -> Common<W> {
        let common = self.common(tasks);
        for (l, lane) in self.lanes.iter_mut().enumerate() {
            let MapTask { problem, options } = tasks[l];
            lane.state = LaneState {
                steps: l < count && options.max_iterations > 0 && steps(l),
                noise: problem.noise,
                ..LaneState::default()
            };
            if l < count {
                lane.stream.fill(problem, &lane.knots);
            }
        }
        let pixels: [Pixel<'_>; W] = std::array::from_fn(|l| {
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
    fn accept(&mut self, common: &Common<W>, accepted: Wide<W>) {
        if accepted == Wide::ONE {
            std::mem::swap(&mut self.u, &mut self.trial);
            return;
        }
        for (u, trial) in self.u.iter_mut().zip(&self.trial) {
            *u = accepted.equal(1.0, *trial, *u);
        }
        run(&self.columns, common, &self.u, &offsets(&self.lanes), &mut self.lines);
    }

    /// The evidence of each lane; the posterior variance of log light at each step as well where it is asked
    /// for.
    pub(super) fn judge_all(
        &mut self,
        common: &Common<W>,
        first: Wide<W>,
        is_exact: bool,
        with_variance: bool,
    ) -> [f64; W] {
        adapt(&mut self.columns, common, &self.u);
        // As measured: what the prior expects of thresholds has no part in it.
        self.lanes.iter_mut().for_each(|lane| lane.state.expected = Offsets::default());
        let ask = ask(&self.lanes, &self.columns, &self.lines, (first, self.u[0]), Wide::ZERO);
        let evidence = match (with_variance, is_exact) {
            (false, true) => passes::evidence::<ON, W>(&ask),
            (false, false) => passes::evidence::<STATES, W>(&ask),
            (true, true) => variance::variance::<ON, W>(&ask, &mut self.exact, &mut self.variance),
            (true, false) => variance::variance::<STATES, W>(&ask, &mut self.free, &mut self.variance),
        };
        std::array::from_fn(|l| evidence.log(l))
    }
}

/// What the passes are asked for at `here`, the first log light, when the prior expects `first` of it.
pub(super) fn ask<'a, const W: usize>(
    lanes: &[Lane; W],
    columns: &'a Columns<W>,
    lines: &'a [Line<W>],
    (first, here): (Wide<W>, Wide<W>),
    damping: Wide<W>,
) -> Ask<'a, W> {
    let offsets = offsets(lanes);
    Ask {
        lines,
        expected: &columns.expected,
        what: &columns.what,
        events: Flags(std::array::from_fn(|l| {
            if lanes[l].state.no_event_sigma > 0.0 { EVENT | NO_EVENT } else { EVENT }
        })),
        damping,
        first: first - here,
        offsets: WideOffsets {
            on: offsets.on - wide(lanes, |state| state.expected.on),
            off: offsets.off - wide(lanes, |state| state.expected.off),
            ..offsets
        },
        first_variance: FIRST_VARIANCE,
        reference_variance: wide(lanes, |state| state.noise.reference * state.noise.reference),
        threshold_variance: wide(lanes, |state| state.noise.threshold * state.noise.threshold),
    }
}
