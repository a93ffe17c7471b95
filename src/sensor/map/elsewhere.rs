//! Pixels that are solved elsewhere than on this processor.

use super::options::{MapSolution, MapTask};
use photocurrent_core::NodeError;

/// Solves pixels as [`super::MapGroup`] does, but for rounding, on another processor.
pub trait Elsewhere: Sync {
    /// Solves `tasks`, with their evidence, and gives each answer, with its place in `tasks`, to `take`, in
    /// any order; gives the places of those that it does not take, rising.
    ///
    /// # Errors
    /// When the other processor fails. Answers that were given by then are right.
    fn solve(
        &self,
        tasks: &[MapTask<'_>],
        take: &mut dyn FnMut(usize, MapSolution<'_>),
    ) -> Result<Vec<usize>, NodeError>;
}
