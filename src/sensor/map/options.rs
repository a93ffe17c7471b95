//! How a pixel is solved, and what comes out.

use super::prior::Prior;
use super::problem::{MapProblem, Noise, Offsets};
use crate::misfit::Misfit;

/// How the problem is solved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapOptions {
    /// The prior.
    pub prior: Prior,
    /// Knots lie at most this far apart, ns.
    pub spacing_ns: i64,
    /// Most Gauss-Newton steps. The default suffices for ramps of five events, which take 17 to 62: every
    /// step estimates the local variance of the prior anew, and
    /// light and variance settle together. After five steps such light has the status
    /// [`MapStatus::Unfinished`], and mostly errs less, by up to 0.06 natural-log units rms.
    pub max_iterations: usize,
    /// The iteration ends when no log light moves further than this.
    pub tolerance: f64,
    /// Compute standard deviations?
    pub with_sigma: bool,
    /// When a pixel is solved from a second start; none = never.
    pub second: Option<SecondStart>,
}

/// A second start, for pixels whose first answer does not explain what was measured.
///
/// In the dark the front end is slow, and what the voltage does is explained as well by light that falls
/// slowly as by light that fell at once; from the double integral the iteration finds
/// the first and then cannot leave it. With a large standard deviation of events, frames lead to the other;
/// from there events count in full again.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SecondStart {
    /// Standard deviation of an event on the way to it, as a part of its threshold.
    pub event: f64,
    /// Most steps on the way to it, and most from there.
    pub steps: usize,
    /// It is tried where squared misfits of events are above this, per event: light that explains them better
    /// than that is not far away.
    pub least_misfit: f64,
    /// And all squared misfits below this, per event and frame value: beyond, events and frames contradict
    /// each other, and no start helps.
    pub most_misfit: f64,
    /// And taken where all together become smaller by this part.
    pub gain: f64,
}

impl SecondStart {
    /// Suits most recordings.
    pub const USUAL: SecondStart =
        SecondStart { event: 0.3, steps: 8, least_misfit: 0.1, most_misfit: 30.0, gain: 0.2 };

    /// The problem and the options on the way to it, and from there.
    pub(super) fn stages<'a>(
        &self,
        problem: &MapProblem<'a>,
        options: &MapOptions,
    ) -> [(MapProblem<'a>, MapOptions); 2] {
        let noise = Noise { event: f64::max(problem.noise.event, self.event), ..problem.noise };
        let options = MapOptions { max_iterations: self.steps, ..*options };
        [(MapProblem { noise, ..*problem }, options), (*problem, options)]
    }

    /// Is it worth a try for a pixel whose answer misses by `misfit`, the sum of squares, and by `apart`
    /// without the no-event constraint?
    pub(super) fn is_worth_a_try(
        &self,
        problem: &MapProblem<'_>,
        status: MapStatus,
        misfit: f64,
        apart: &Misfit,
    ) -> bool {
        let measured = (problem.events.len() + problem.frames.len()) as f64;
        let is_amiss = apart.event_square > self.least_misfit * apart.events as f64
            && misfit < self.most_misfit * measured;
        // With a front end that is as fast in the dark there is one answer.
        problem.sensor.front_end.alpha_s > 0.0 && (status == MapStatus::Failed || is_amiss)
    }

    /// Is the second answer, as (status, misfit), better than the first?
    pub(super) fn is_better(&self, first: (MapStatus, f64), second: (MapStatus, f64)) -> bool {
        second.0 != MapStatus::Failed
            && (first.0 == MapStatus::Failed || second.1 < (1.0 - self.gain) * first.1)
    }
}

impl Default for MapOptions {
    fn default() -> MapOptions {
        MapOptions {
            prior: Prior::default(),
            spacing_ns: 250_000,
            max_iterations: 100,
            tolerance: 2e-3,
            with_sigma: false,
            second: Some(SecondStart::USUAL),
        }
    }
}

/// How a pixel came out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapStatus {
    /// The last step was short.
    Converged,
    /// Out of iterations, but every step went down.
    Unfinished,
    /// No step went down, or the light ran away between the frames: the answer is the start, a double
    /// integral.
    Failed,
}

/// The answer for one pixel, borrowed from the workspace.
#[derive(Clone, Copy, Debug)]
pub struct MapSolution<'a> {
    /// Knots, ns, rising.
    pub t_ns: &'a [i64],
    /// Log light at each knot; linear between.
    pub log_photocurrent: &'a [f64],
    /// Posterior variance of it where requested, else empty.
    pub variance: &'a [f64],
    /// How it came out, but for the light.
    pub outcome: MapOutcome,
}

/// How a pixel came out, but for its light.
#[derive(Clone, Copy, Debug)]
pub struct MapOutcome {
    /// Thresholds and first reference of this pixel.
    pub offsets: Offsets,
    /// How it went.
    pub status: MapStatus,
    /// Gauss-Newton steps that were taken.
    pub iterations: usize,
    /// Log of the measurements' marginal likelihood, of the problem linearised at the answer.
    pub log_evidence: f64,
    /// How far its events and frames are from the predictions, in the standard deviations that they are
    /// assumed to.
    pub misfit: Misfit,
    /// The largest of the squares that the misfit sums up.
    pub largest_square: f64,
    /// When that event fired or that exposure ended, ns; the first knot where nothing was measured.
    pub largest_ns: i64,
    /// Whether it was solved from a second start.
    pub second: Second,
}

/// What became of a pixel's second start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Second {
    /// None was tried.
    #[default]
    Untried,
    /// It was tried, and the first answer kept.
    Refused,
    /// The answer is its.
    Kept,
}

/// Are the log of the marginal likelihood and the misfit wanted?
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Evidence {
    Wanted,
    /// It is left at zero, and so is the misfit, which saves a pass.
    Unwanted,
}

/// A pixel that is to be solved, and how.
#[derive(Clone, Copy, Debug)]
pub struct MapTask<'a> {
    /// The pixel.
    pub problem: MapProblem<'a>,
    /// How it is solved.
    pub options: MapOptions,
}
