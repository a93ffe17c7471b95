//! One lane of a group: its pixel, how far it has come, and what becomes of it after a step.

use super::super::knots::Knots;
use super::super::options::{MapStatus, MapTask, Second};
use super::super::prior::Segments;
use super::super::problem::{MapProblem, Noise, Offsets};
use super::super::start::Start;
use super::super::thresholds;
use super::columns::Cost;
use super::passes::WideOffsets;
use super::stream::Stream;
use crate::wide::Wide;

/// Attempts at a step before no step goes down any more.
pub const ATTEMPTS: usize = 6;
/// First damping: a standard deviation of a change of a tenth.
pub const FIRST_DAMPING: f64 = 100.0;
/// The step from which the no-event constraint counts, from 1.
pub const NO_EVENT_FROM: usize = 4;

/// One pixel of a group.
#[derive(Clone, Debug, Default)]
pub(super) struct Lane {
    pub knots: Knots,
    pub segments: Segments,
    pub start: Start,
    pub stream: Stream,
    /// The start, later the answer.
    pub u: Vec<f64>,
    pub state: LaneState,
}

/// How far a lane has come.
#[derive(Clone, Copy, Debug)]
pub(super) struct LaneState {
    /// Is it still on its way?
    pub steps: bool,
    pub status: MapStatus,
    pub iterations: usize,
    /// Refused attempts at the current step.
    pub attempts: usize,
    pub damping: f64,
    pub offsets: Offsets,
    /// What the prior expects of the thresholds at the current step.
    pub expected: Offsets,
    /// 0 while the no-event constraint does not count.
    pub no_event_sigma: f64,
    /// Of where it stands: all, and the parts that do not depend on the prior.
    pub cost: f64,
    pub measured: f64,
    pub no_event_square: f64,
    /// How much of the step is taken.
    pub share: f64,
    /// As the task states it.
    pub noise: Noise,
    pub second: Second,
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
            second: Second::Untried,
        }
    }
}

impl LaneState {
    pub(super) fn no_event(&self, square: f64) -> f64 {
        if self.no_event_sigma > 0.0 { square / (self.no_event_sigma * self.no_event_sigma) } else { 0.0 }
    }

    /// Sum of the squares of misfits and of the broken no-event constraint.
    pub(super) fn misfit(&self, problem: &MapProblem<'_>) -> f64 {
        let sigma = problem.no_event_sigma;
        self.measured + if sigma > 0.0 { self.no_event_square / (sigma * sigma) } else { 0.0 }
    }

    /// Out of attempts: as good as it gets when some step went down, else a failure.
    fn give_up(&mut self) {
        self.status = if self.iterations > 1 { MapStatus::Unfinished } else { MapStatus::Failed };
        self.steps = false;
    }
}

/// The tasks of a group; lanes without a pixel repeat the last.
pub(super) fn lanes_of<'a, 'b, const W: usize>(
    all: &'a [MapTask<'b>],
    group: &[usize],
) -> [&'a MapTask<'b>; W] {
    std::array::from_fn(|l| &all[group[usize::min(l, group.len() - 1)]])
}

pub(super) fn wide<const W: usize>(lanes: &[Lane; W], of: impl Fn(&LaneState) -> f64) -> Wide<W> {
    Wide(std::array::from_fn(|l| of(&lanes[l].state)))
}

pub(super) fn offsets<const W: usize>(lanes: &[Lane; W]) -> WideOffsets<W> {
    let part = |of: fn(&Offsets) -> f64| wide(lanes, |state| of(&state.offsets));
    WideOffsets {
        reference: part(|offsets| offsets.reference),
        on: part(|offsets| offsets.on),
        off: part(|offsets| offsets.off),
    }
}

/// Are both tasks of one pixel, so that they have the same knots and the same start?
pub(super) fn starts_alike(one: &MapTask<'_>, other: &MapTask<'_>) -> bool {
    let (a, b) = (&one.problem, &other.problem);
    let same = a.lost_before == b.lost_before
        && a.beyond == b.beyond
        && std::ptr::eq(a.events, b.events)
        && std::ptr::eq(a.frames, b.frames)
        && std::ptr::eq(a.hints, b.hints);
    let solved = |task: &MapTask<'_>| {
        (
            task.problem.start_ns,
            task.problem.end_ns,
            task.problem.sensor,
            task.problem.noise.lone,
            task.options.spacing_ns,
        )
    };
    same && solved(one) == solved(other)
}

/// Are the thresholds exact?
pub(super) fn is_exact(task: &MapTask<'_>) -> bool {
    task.problem.noise.threshold <= 0.0
}

pub(super) fn is_advancing(task: &MapTask<'_>) -> bool {
    task.problem.sensor.reset != photocurrent_core::sensor::Reset::Resample
}

/// A new step of a lane, unless it is at another attempt.
pub(super) fn begin_step(state: &mut LaneState, task: &MapTask<'_>, prior_cost: f64) {
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
pub(super) fn judge<const W: usize>(
    state: &mut LaneState,
    task: &MapTask<'_>,
    cost: &Cost<W>,
    l: usize,
    longest: f64,
    offsets: Offsets,
) -> bool {
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
