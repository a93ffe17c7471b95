//! Pixels that are solved elsewhere than on this processor.

use super::options::{MapOutcome, MapSolution, MapTask};
use photocurrent_core::{Exposure, NodeError};

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

    /// The same, but gives means of light over the exposures of each task's row in its place: light itself
    /// stays there. Every row has as many exposures.
    ///
    /// # Errors
    /// As [`Elsewhere::solve`].
    fn pictures(
        &self,
        tasks: &[MapTask<'_>],
        pictured: &[Pictured],
        exposures: &[Vec<Exposure>],
        take: &mut dyn FnMut(usize, MapMeans<'_>),
    ) -> Result<Vec<usize>, NodeError>;
}

/// What makes means of an answer.
#[derive(Clone, Copy, Debug)]
pub struct Pictured {
    /// Whose exposures count: a place among them.
    pub row: usize,
    /// Light of the pixel over that of the answer.
    pub ratio: f64,
    /// The most of it that is plausible: light is held there.
    pub most: f64,
    /// Standard deviations count for so many times as much.
    pub sigma_factor: f64,
}

/// An answer as means over exposures.
#[derive(Clone, Copy, Debug)]
pub struct MapMeans<'a> {
    /// How it came out, but for the light.
    pub outcome: MapOutcome,
    /// The brightest light of all knots, times the ratio, before it was held.
    pub brightest: f64,
    /// Mean light over each exposure.
    pub light: &'a [f32],
    /// The mean of light times the standard deviation of its logarithm; empty where none was wanted.
    pub spread: &'a [f32],
}
