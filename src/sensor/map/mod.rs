//! The MAP estimate of one pixel: all its events and frames at once, through the exact sensor.
//!
//! Unknown is u(t) = ln i(t), linear between knots, so light is positive without a constraint. The voltage follows by the exact response to ramps;
//! the reference is latched when the readout is over ("resample") or when the event fires ("advance"); every event says that
//! voltage and reference were one threshold apart when it fired; every frame says how much light its own row collected. A prior says that
//! light moves with a speed that lasts a while, with a variance of its own at every place in time ([`Prior`]).
//!
//! The maximum of the posterior is found by Gauss-Newton steps. Each is one pass forward and one backward over a chain of small states: the cost is
//! linear in the number of knots. The posterior standard deviation comes from the same passes.
//!
//! Nothing of this is trusted blindly: how far events are trusted and which prior suits is chosen by frames that are held out ([`estimate`]).
//!
//! Limits: one pixel alone, nothing from its neighbours; the local variance is estimated from the estimate, so standard deviations are too small
//! where nothing was measured; the time constant is held over a segment.

mod chain;
mod curvature;
pub mod estimate;
pub mod frame_noise;
mod group;
mod knots;
pub mod losses;
#[cfg(test)]
mod misfit_tests;
mod prior;
mod segment;
mod smoother;
mod start;
mod state;
#[cfg(test)]
mod tests;
mod thresholds;
mod whitened;

pub use group::{MapGroup, MapTask};
pub use knots::COARSEST;
pub use prior::{Local, Prior};
pub use segment::ramp_voltage;
pub use whitened::{Column, LeftOut, Whitened, refine, whiten};

use crate::front_end::FrontEnd;
use crate::residuals::Misfit;
use chain::Chain;
use knots::Knots;
use photocurrent_core::sensor::Reset;
use prior::Segments;
use smoother::{Ask, Smoother, Want};
use start::Start;

/// An event of the pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapEvent {
    /// When it fired, ns.
    pub t_in_ns: i64,
    /// When its readout was over, ns; not before `t_in_ns`.
    pub t_off_ns: i64,
    /// +1 or -1.
    pub polarity: i8,
    /// Did nothing else happen around it, in time and space? Such an event may be noise: see [`Noise::lone`].
    pub is_lone: bool,
}

/// A frame value of the pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapFrame {
    /// Exposure of this row, ns.
    pub start_ns: i64,
    /// End of it.
    pub end_ns: i64,
    /// Digital number, black level included; finite.
    pub dn: f64,
    /// Its standard deviation, DN, positive.
    pub sigma_dn: f64,
    /// Is the value a lower bound?
    pub saturated: bool,
}

/// What is known of a pixel's light from elsewhere, at one instant: a measurement of log light with a normal error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hint {
    /// When, ns; becomes a knot.
    pub t_ns: i64,
    /// Log light.
    pub log_photocurrent: f64,
    /// Its variance, positive.
    pub variance: f64,
    /// What counts as its variance where the posterior variance is asked for, positive: hints that err together narrow it less than they hold the light.
    pub for_sigma: f64,
}

/// The pixel as a description states it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapSensor {
    /// The low-pass of Eq. (3).
    pub front_end: FrontEnd,
    /// ON threshold, natural-log units, positive.
    pub threshold_on: f64,
    /// OFF threshold, natural-log units, positive.
    pub threshold_off: f64,
    /// What the reference does after an event.
    pub reset: Reset,
    /// From `t_off` until the comparator watches again, ns.
    pub refractory_ns: i64,
    /// DN per photocurrent and second.
    pub gain: f64,
    /// DN of darkness.
    pub black_level_dn: f64,
    /// DN at which values stay; infinite = not known.
    pub saturation_dn: f64,
}

/// What a lone event says of light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LoneEvents {
    /// As much as any other.
    #[default]
    Trusted,
    /// Nothing: it only resets the pixel.
    Doubted,
}

/// How far measurements of events are trusted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Standard deviation of an event, as a part of its threshold.
    pub event: f64,
    /// Standard deviation of the first reference around the first voltage, natural-log units.
    pub reference: f64,
    /// Standard deviation of this pixel's thresholds around the stated ones, natural-log units; 0 = they are exact.
    pub threshold: f64,
    /// What lone events say.
    pub lone: LoneEvents,
}

impl Default for Noise {
    fn default() -> Noise {
        Noise::USUAL
    }
}

impl Noise {
    /// Before anything is known of a recording.
    pub const USUAL: Noise = Noise { event: 0.1, reference: 0.05, threshold: 0.0, lone: LoneEvents::Trusted };

    fn event_variance(&self, threshold: f64) -> f64 {
        let sigma = self.event * threshold;
        sigma * sigma
    }
}

/// What is estimated of a pixel besides its light: how far it is from the stated values, natural-log units.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Offsets {
    /// First reference less first voltage.
    pub reference: f64,
    /// Added to the ON threshold.
    pub on: f64,
    /// Added to the OFF threshold.
    pub off: f64,
}

impl Offsets {
    fn cost(&self, noise: &Noise) -> f64 {
        let part = |value: f64, sigma: f64| if sigma > 0.0 { (value / sigma) * (value / sigma) } else { 0.0 };
        part(self.reference, noise.reference) + part(self.on, noise.threshold) + part(self.off, noise.threshold)
    }

    fn moved(&self, by: &Offsets, share: f64) -> Offsets {
        Offsets { reference: self.reference + share * by.reference, on: self.on + share * by.on, off: self.off + share * by.off }
    }
}

/// Everything measured and known about one pixel.
#[derive(Clone, Copy, Debug)]
pub struct MapProblem<'a> {
    /// Events in order of in-pixel time.
    pub events: &'a [MapEvent],
    /// Frame values, in order of time, exposures apart from each other.
    pub frames: &'a [MapFrame],
    /// What is known from elsewhere, in order of time; may be empty. No part of `log_evidence`, which then says how well the pixel's own
    /// measurements were predicted.
    pub hints: &'a [Hint],
    /// First instant that is asked for, ns; the pixel is taken as settled there.
    pub start_ns: i64,
    /// Last instant, ns.
    pub end_ns: i64,
    /// The pixel.
    pub sensor: MapSensor,
    /// How far events are trusted.
    pub noise: Noise,
    /// Standard deviation of a stamp, seconds.
    pub stamp_sigma_s: f64,
    /// Softness of "no event, so no threshold was crossed", natural-log units; 0 = not used. Counts in the last steps only.
    pub no_event_sigma: f64,
    /// Numbers of events before which events were lost, rising; may be empty. The gap before them is no constraint, and they only take the reference anew.
    pub lost_before: &'a [u32],
    /// What each event's signed step from the reference is known to be beyond its threshold (drift of the reference since the reset, thresholds of that moment),
    /// natural-log units; empty = nothing. The no-event constraint does not know of it.
    pub beyond: &'a [f64],
}

impl MapProblem<'_> {
    /// [`MapProblem::beyond`] of an event.
    pub(crate) fn beyond_of(&self, event: u32) -> f64 {
        self.beyond.get(event as usize).copied().unwrap_or(0.0)
    }
}

/// How the problem is solved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapOptions {
    /// The prior.
    pub prior: Prior,
    /// Knots lie at most this far apart, ns.
    pub spacing_ns: i64,
    /// Most Gauss-Newton steps. The default suffices for ramps of five events, which take 17 to 62: every step estimates the local variance of the prior anew, and
    /// light and variance settle together. After five steps such light has the status [`MapStatus::Unfinished`], and mostly errs less, by up to 0.06 natural-log units rms.
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
/// In the dark the front end is slow, and what the voltage does is explained as well by light that falls slowly as by light that fell at once; from the double integral the iteration finds
/// the first and then cannot leave it. With a large standard deviation of events, frames lead to the other; from there events count in full again.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SecondStart {
    /// Standard deviation of an event on the way to it, as a part of its threshold.
    pub event: f64,
    /// Most steps on the way to it, and most from there.
    pub steps: usize,
    /// It is tried where squared misfits of events are above this, per event: light that explains them better than that is not far away.
    pub least_misfit: f64,
    /// And all squared misfits below this, per event and frame value: beyond, events and frames contradict each other, and no start helps.
    pub most_misfit: f64,
    /// And taken where all together become smaller by this part.
    pub gain: f64,
}

impl SecondStart {
    /// Suits most recordings.
    pub const USUAL: SecondStart = SecondStart { event: 0.3, steps: 8, least_misfit: 0.1, most_misfit: 30.0, gain: 0.2 };

    /// The problem and the options on the way to it, and from there.
    fn stages<'a>(&self, problem: &MapProblem<'a>, options: &MapOptions) -> [(MapProblem<'a>, MapOptions); 2] {
        let noise = Noise { event: f64::max(problem.noise.event, self.event), ..problem.noise };
        let options = MapOptions { max_iterations: self.steps, ..*options };
        [(MapProblem { noise, ..*problem }, options), (*problem, options)]
    }

    /// Is it worth a try for a pixel whose answer misses by `misfit`, the sum of squares, and by `apart` without the no-event constraint?
    fn is_worth_a_try(&self, problem: &MapProblem<'_>, status: MapStatus, misfit: f64, apart: &Misfit) -> bool {
        let measured = (problem.events.len() + problem.frames.len()) as f64;
        let is_amiss = apart.event_square > self.least_misfit * apart.events as f64 && misfit < self.most_misfit * measured;
        // With a front end that is as fast in the dark there is one answer.
        problem.sensor.front_end.alpha_s > 0.0 && (status == MapStatus::Failed || is_amiss)
    }

    /// Is the second answer, as (status, misfit), better than the first?
    fn is_better(&self, first: (MapStatus, f64), second: (MapStatus, f64)) -> bool {
        second.0 != MapStatus::Failed && (first.0 == MapStatus::Failed || second.1 < (1.0 - self.gain) * first.1)
    }
}

impl Default for MapOptions {
    fn default() -> MapOptions {
        MapOptions { prior: Prior::default(), spacing_ns: 250_000, max_iterations: 100, tolerance: 2e-3, with_sigma: false, second: Some(SecondStart::USUAL) }
    }
}

/// How a pixel came out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapStatus {
    /// The last step was short.
    Converged,
    /// Out of iterations, but every step went down.
    Unfinished,
    /// No step went down, or the light ran away between the frames: the answer is the start, a double integral.
    Failed,
}

/// The answer for one pixel, borrowed from the workspace.
#[derive(Clone, Copy, Debug)]
pub struct MapSolution<'a> {
    /// Knots, ns, rising.
    pub t_ns: &'a [i64],
    /// Log light at each knot; linear between.
    pub log_photocurrent: &'a [f64],
    /// Posterior variance of it where asked for, else empty.
    pub variance: &'a [f64],
    /// Thresholds and first reference of this pixel.
    pub offsets: Offsets,
    /// How it went.
    pub status: MapStatus,
    /// Gauss-Newton steps that were taken.
    pub iterations: usize,
    /// Log of the measurements' marginal likelihood, of the problem linearised at the answer.
    pub log_evidence: f64,
    /// How far its events and frames are from the predictions, in the standard deviations that they are assumed to.
    pub misfit: Misfit,
    /// The largest of the squares that the misfit sums up.
    pub largest_square: f64,
}

/// Memory that is kept from pixel to pixel.
#[derive(Clone, Debug, Default)]
pub struct MapWorkspace {
    knots: Knots,
    segments: Segments,
    chain: Chain,
    trial_chain: Chain,
    smoother: Smoother,
    start: Start,
    u: Vec<f64>,
    trial: Vec<f64>,
}

/// Steps longer than this are cut, natural-log units.
const LONGEST_STEP: f64 = 1.5;
/// First damping: a standard deviation of a change of a tenth.
const FIRST_DAMPING: f64 = 100.0;
/// The step from which the no-event constraint counts, from 1.
const NO_EVENT_FROM: usize = 4;
/// Light brighter than the brightest frame's mean by more than this is not trusted, natural-log units.
const RUN_AWAY: f64 = 2.5;
/// Log light stays inside plus and minus this.
const LOG_LIMIT: f64 = 40.0;

/// Solves one pixel.
pub fn solve<'w>(problem: &MapProblem<'_>, options: &MapOptions, workspace: &'w mut MapWorkspace) -> MapSolution<'w> {
    solve_with(problem, options, Evidence::Wanted, workspace)
}

/// Are the log of the marginal likelihood and the misfit wanted?
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Evidence {
    Wanted,
    /// It is left at zero, and so is the misfit, which saves a pass.
    Unwanted,
}

/// Solves one pixel.
fn solve_with<'w>(problem: &MapProblem<'_>, options: &MapOptions, evidence: Evidence, workspace: &'w mut MapWorkspace) -> MapSolution<'w> {
    workspace.knots.lay(problem, options.spacing_ns);
    workspace.segments.lay(&workspace.knots.t_ns, &options.prior);
    workspace.start.fill(problem, &workspace.knots, &mut workspace.u);
    let first = workspace.u[0];
    let mut found = descend(problem, options, first, Offsets::default(), workspace);
    let is_worth_a_try = |second: &SecondStart| second.is_worth_a_try(problem, found.status, found.misfit, &workspace.chain.misfit().0);
    if let Some(second) = options.second.filter(is_worth_a_try) {
        let plain = workspace.u.clone();
        workspace.start.fill(problem, &workspace.knots, &mut workspace.u);
        let mut again = Found::default();
        for (problem, options) in &second.stages(problem, options) {
            again = descend(problem, options, first, again.offsets, workspace);
        }
        if second.is_better((found.status, found.misfit), (again.status, again.misfit)) {
            found = Found { iterations: found.iterations + again.iterations, ..again };
        } else {
            workspace.u.clone_from(&plain);
            workspace.chain.run(problem, &workspace.knots, &workspace.segments, &workspace.u, &found.offsets);
        }
    }
    let MapWorkspace { knots, segments, chain, smoother, start, u, .. } = workspace;
    let Found { mut status, iterations, mut offsets, no_event_sigma, .. } = found;
    if status == MapStatus::Failed || has_run_away(problem, u) {
        status = MapStatus::Failed;
        start.fill(problem, knots, u);
        offsets = Offsets::default();
        chain.run(problem, knots, segments, u, &offsets);
    }
    let mut log_evidence = 0.0;
    if evidence == Evidence::Wanted || options.with_sigma {
        segments.adapt(u, &options.prior);
        segments.cost(u);
        let wanted = [(Want::Evidence, evidence == Evidence::Wanted), (Want::Variance, options.with_sigma)];
        for (want, _) in wanted.into_iter().filter(|(_, is_wanted)| *is_wanted) {
            smoother.solve(&ask(problem, knots, segments, chain, u, first, &offsets, no_event_sigma, 0.0, want));
            log_evidence = if want == Want::Evidence { smoother.log_evidence } else { log_evidence };
        }
    }
    let variance: &[f64] = if options.with_sigma { &smoother.variance } else { &[] };
    let (misfit, largest_square) = if evidence == Evidence::Wanted { chain.misfit() } else { Default::default() };
    MapSolution { t_ns: &knots.t_ns, log_photocurrent: u, variance, offsets, status, iterations, log_evidence, misfit, largest_square }
}

/// Where an iteration has come to.
#[derive(Clone, Copy, Debug)]
struct Found {
    offsets: Offsets,
    status: MapStatus,
    iterations: usize,
    no_event_sigma: f64,
    /// Sum of the squares of misfits and of the broken no-event constraint.
    misfit: f64,
}

impl Default for Found {
    fn default() -> Found {
        Found { offsets: Offsets::default(), status: MapStatus::Unfinished, iterations: 0, no_event_sigma: 0.0, misfit: f64::INFINITY }
    }
}

/// Iterates from the light that stands in the workspace.
fn descend(problem: &MapProblem<'_>, options: &MapOptions, first: f64, mut offsets: Offsets, workspace: &mut MapWorkspace) -> Found {
    let MapWorkspace { knots, segments, chain, trial_chain, smoother, u, trial, .. } = workspace;
    let mut damping = 0.0;
    let mut status = MapStatus::Unfinished;
    let mut iterations = 0;
    // The no-event constraint traps a start that is far away, so it has its say only in the last steps.
    let mut no_event_sigma = 0.0;
    chain.run(problem, knots, segments, u, &offsets);
    while iterations < options.max_iterations {
        iterations += 1;
        if iterations == NO_EVENT_FROM {
            no_event_sigma = problem.no_event_sigma;
        }
        segments.adapt(u, &options.prior);
        let prior_cost = segments.cost(u);
        let expected = thresholds::expected(problem, prior_cost, &offsets);
        let pulled = |offsets: &Offsets| thresholds::pulled(&expected, offsets, &problem.noise);
        let cost = chain.cost(prior_cost, no_event_sigma) - pulled(&offsets);
        if !cost.is_finite() {
            status = MapStatus::Failed;
            break;
        }
        let mut longest = f64::INFINITY;
        for _attempt in 0..6 {
            let step = Ask { expected, ..ask(problem, knots, segments, chain, u, first, &offsets, no_event_sigma, damping, Want::Step) };
            smoother.solve(&step);
            longest = smoother.change.iter().fold(0.0, |longest, change| f64::max(longest, change.abs()));
            if !longest.is_finite() {
                damping = f64::max(damping * 10.0, FIRST_DAMPING);
                continue;
            }
            let share = f64::min(1.0, LONGEST_STEP / longest);
            trial.clear();
            trial.extend(u.iter().zip(&smoother.change).map(|(u, change)| (u + share * change).clamp(-LOG_LIMIT, LOG_LIMIT)));
            let moved = offsets.moved(&smoother.offsets, share);
            trial_chain.run(problem, knots, segments, trial, &moved);
            // A step at the level of rounding may go up by rounding.
            if trial_chain.cost(segments.cost(trial), no_event_sigma) - pulled(&moved) <= cost * (1.0 + 1e-9) + 1e-9 {
                std::mem::swap(u, trial);
                std::mem::swap(chain, trial_chain);
                offsets = moved;
                damping = if damping > FIRST_DAMPING { damping * 0.1 } else { 0.0 };
                break;
            }
            // The increments of where it stands, again.
            segments.cost(u);
            damping = f64::max(damping * 10.0, FIRST_DAMPING);
            longest = f64::INFINITY;
        }
        if longest < options.tolerance {
            status = MapStatus::Converged;
            break;
        }
        if !longest.is_finite() {
            // No step goes down any more: as good as it gets when some did, else a failure.
            status = if iterations > 1 { MapStatus::Unfinished } else { MapStatus::Failed };
            break;
        }
    }
    Found { offsets, status, iterations, no_event_sigma, misfit: chain.cost(0.0, problem.no_event_sigma) }
}

/// Posterior variance of log light at each knot, for light and offsets that were found elsewhere; `no_event_sigma` as it was there.
fn variance_at<'w>(task: &MapTask<'_>, found: &[f64], offsets: &Offsets, no_event_sigma: f64, workspace: &'w mut MapWorkspace) -> &'w [f64] {
    let MapTask { problem, options } = task;
    let MapWorkspace { knots, segments, chain, smoother, start, u, .. } = workspace;
    knots.lay(problem, options.spacing_ns);
    segments.lay(&knots.t_ns, &options.prior);
    start.fill(problem, knots, u);
    let first = u[0];
    u.clear();
    u.extend_from_slice(found);
    chain.run(problem, knots, segments, u, offsets);
    segments.adapt(u, &options.prior);
    segments.cost(u);
    smoother.solve(&ask(problem, knots, segments, chain, u, first, offsets, no_event_sigma, 0.0, Want::Variance));
    &smoother.variance
}

/// Is the light anywhere implausible, given what the frames collected?
fn has_run_away(problem: &MapProblem<'_>, u: &[f64]) -> bool {
    let collected = |frame: &MapFrame| frame.dn - problem.sensor.black_level_dn + 3.0 * frame.sigma_dn;
    let brightest = problem.frames.iter().fold(0.0, |most, frame| f64::max(most, collected(frame) / (frame.end_ns - frame.start_ns) as f64));
    let limit = libm::log(brightest * 1e9 / problem.sensor.gain) + RUN_AWAY;
    !problem.frames.iter().any(|frame| frame.saturated) && u.iter().any(|&u| u > limit)
}

#[expect(clippy::too_many_arguments, reason = "parts of one workspace, borrowed apart")]
fn ask<'a>(
    problem: &'a MapProblem<'_>,
    knots: &'a Knots,
    segments: &'a Segments,
    chain: &'a Chain,
    u: &'a [f64],
    first: f64,
    offsets: &'a Offsets,
    no_event_sigma: f64,
    damping: f64,
    want: Want,
) -> Ask<'a> {
    let (noise, reset) = (&problem.noise, problem.sensor.reset);
    Ask { knots, segments, chain, hints: problem.hints, u, first, offsets, noise, reset, no_event_sigma, damping, want, expected: Offsets::default() }
}
