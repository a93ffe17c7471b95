//! Second starts, for pixels whose first answer does not explain what was measured: such pixels wait until
//! eight of them are together.
//!
//! A second start takes three times as many steps as the first: lanes that ask for none would only wait for
//! the others.

use super::super::options::{Evidence, MapSolution, MapTask, Second, SecondStart};
use super::super::problem::Offsets;
use super::columns::misfits;
use super::lane::{LaneState, lanes_of};
use super::solve::InStep;
use std::array::from_fn;

impl<const W: usize> InStep<W> {
    /// Lets lanes that ask for a second start wait, and says which.
    pub(super) fn wait(&mut self, tasks: &[&MapTask<'_>; W], group: &[usize]) -> [bool; W] {
        let apart = misfits(&self.lines);
        from_fn(|l| {
            let (state, MapTask { problem, options }) = (&self.lanes[l].state, tasks[l]);
            let is_worth_it = |second: &SecondStart| {
                second.is_worth_a_try(problem, state.status, state.misfit(problem), &apart[l].0)
            };
            let waits = l < group.len() && options.second.as_ref().is_some_and(is_worth_it);
            if waits {
                self.take_lane(l);
                let lane = &mut self.lanes[l];
                self.waiting.push(group[l], lane.state, &mut lane.u);
            }
            waits
        })
    }

    /// Solves pixels that wait from their second start, as long as a group of them is full, or until none
    /// waits where no more are to come; of both answers the better goes to `take`.
    pub(super) fn again(
        &mut self,
        all: &[MapTask<'_>],
        is_last: bool,
        evidence: Evidence,
        take: &mut dyn FnMut(usize, MapSolution<'_>),
    ) {
        while self.waiting.places.len() >= if is_last { 1 } else { W } {
            let count = usize::min(self.waiting.places.len(), W);
            self.group_again(all, count, evidence, take);
            self.waiting.leave(count);
        }
    }

    fn group_again(
        &mut self,
        all: &[MapTask<'_>],
        count: usize,
        evidence: Evidence,
        take: &mut dyn FnMut(usize, MapSolution<'_>),
    ) {
        let places: [usize; W] = from_fn(|l| self.waiting.places[usize::min(l, count - 1)]);
        let tasks = lanes_of(all, &places[..count]);
        self.begin(&tasks, count);
        let first = self.u[0];
        let seconds: [SecondStart; W] = from_fn(|l| tasks[l].options.second.unwrap_or(SecondStart::USUAL));
        for stage in 0..2 {
            let staged: [MapTask<'_>; W] = from_fn(|l| {
                let (problem, options) = seconds[l].stages(&tasks[l].problem, &tasks[l].options)[stage];
                MapTask { problem, options }
            });
            let staged: [&MapTask<'_>; W] = from_fn(|l| &staged[l]);
            let so_far: [Offsets; W] =
                from_fn(|l| if stage == 0 { Offsets::default() } else { self.lanes[l].state.offsets });
            let common = self.load(&staged, count, |_| true);
            for (lane, offsets) in self.lanes.iter_mut().zip(so_far).take(count) {
                lane.state.offsets = offsets;
            }
            self.measure(&common);
            self.descend(&staged, &common, first, count);
            (0..count).for_each(|l| self.take_lane(l));
        }
        for l in 0..count {
            let misfit = |state: &LaneState| state.misfit(&tasks[l].problem);
            let (plain, state) = (self.waiting.states[l], &mut self.lanes[l].state);
            if seconds[l].is_better((plain.status, misfit(&plain)), (state.status, misfit(state))) {
                state.iterations += plain.iterations;
                state.second = Second::Kept;
                continue;
            }
            *state = LaneState { second: Second::Refused, ..plain };
            self.lanes[l].stream.spread(&self.waiting.light[l], l, &mut self.u);
        }
        let common = self.common(&tasks);
        self.measure(&common);
        self.finish(&common, &tasks, first, evidence, |l| (l < count).then(|| places[l]), take);
    }
}
