//! Pixels that wait for a second start.

use super::lane::LaneState;

/// Pixels that wait for a second start, with their first answers. Fewer than two groups of them.
#[derive(Clone, Debug, Default)]
pub(super) struct Waiting {
    /// Their places among the tasks.
    pub places: Vec<usize>,
    pub states: Vec<LaneState>,
    /// Log light at their knots, one vector each; longer than `places`, for its memory.
    pub light: Vec<Vec<f64>>,
}

impl Waiting {
    pub(super) fn push(&mut self, place: usize, state: LaneState, light: &mut Vec<f64>) {
        let at = self.places.len();
        self.places.push(place);
        self.states.push(state);
        if self.light.len() == at {
            self.light.push(Vec::new());
        }
        std::mem::swap(&mut self.light[at], light);
    }

    /// Leaves the first `count` away.
    pub(super) fn leave(&mut self, count: usize) {
        self.places.drain(..count);
        self.states.drain(..count);
        self.light.rotate_left(count);
    }
}
