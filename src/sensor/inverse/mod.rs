//! The inverse model: from events and frame values of one pixel to its photocurrent over time.
//!
//! The photocurrent is wanted at every event, such that (a) the front end, following it with its delay, moves
//! by the measured step from event to event, and (b) its integral over each exposure gives the measured
//! digital number. That is a nonlinear least-squares problem per pixel, Eq. (13), and pixels do not interact.
//!
//! Ideas, in the order of the files:
//!
//! - `problem`: what is given, what comes out, what is refused.
//! - `interval`: one interval between knots, and its inverse: which photocurrent makes a given voltage step.
//! - `overlap`: which hold lies in which exposure.
//! - `level`: the closed form without front-end delay: the start, and the double-integral estimate.
//! - `candidate`: a point of the search and its cost.
//! - `linear`: unknowns `d_k = V(k) - V(k-1)` turn the EVS rows into identities; gradients by backward
//!   sweeps.
//! - `chain`, `newton`: the Gauss-Newton step from an M x M system.
//! - `lanes`: the same for sixteen pixels at once in single precision.
//! - this file: the damped iteration (Levenberg-Marquardt) around them.
//!
//! Limits: photocurrent is constant between knots, so a pixel without events in an exposure is flat there.
//! With [`crate::front_end::TauRule::End`] a fall that the low-pass cannot make leaves a residual in its EVS
//! row (see `interval`). The cost is not convex: minima beyond a fold are excluded on purpose, and a start
//! far too dark can be caught at one (`a_start_far_too_dark_can_stop_at_a_fold`); from the frames every
//! reference problem reaches its optimum. A pixel at or below black cannot be solved and returns the
//! double-integral estimate, flagged.
//!
//! ```
//! # use photocurrent_sensor::front_end::{FrontEnd, TauRule};
//! # use photocurrent_sensor::inverse::{FrameSample, PixelProblem, SolveOptions, Workspace, solve};
//! let problem = PixelProblem {
//!     t_s: &[0.0, 4e-3],
//!     steps: &[0.0, 0.2],
//!     frames: &[FrameSample { start_s: 0.0, end_s: 8e-3, dn: 400.0, weight: 1.0 }],
//!     evs_weight: 1e4,
//!     front_end: FrontEnd { tau_0_s: 30e-6, alpha_s: 20e-6 },
//!     tau_rule: TauRule::End,
//!     black_level: 0.0,
//!     gain: 1e5,
//! };
//! let mut workspace = Workspace::default();
//! let solution = solve(&problem, &SolveOptions::default(), &mut workspace)?;
//! assert!(solution.has_converged());
//! assert!((solution.dn[0] - 400.0).abs() < 1e-6);
//! # Ok::<(), photocurrent_sensor::inverse::ProblemError>(())
//! ```

mod candidate;
mod chain;
mod interval;
mod lanes;
mod level;
mod linear;
mod newton;
mod overlap;
mod problem;
#[cfg(test)]
mod reference_tests;
#[cfg(test)]
mod round_trip_tests;
mod stage;
#[cfg(test)]
mod tests;

pub use lanes::{LaneGroup, LaneSolution};
pub use problem::{
    FrameSample, LOG_PHOTOCURRENT_MAX, LOG_PHOTOCURRENT_MIN, Outcome, PixelProblem, ProblemError, Solution,
    SolveOptions, Start,
};

use candidate::{Candidate, Held};
use level::fit_level;
use linear::Linearised;
use newton::NewtonStep;
use overlap::Overlap;

/// Damping after which an iteration is given up: steps are then far below rounding.
const DAMPING_LIMIT: f64 = 1e12;
/// First damping after a refused undamped step.
const DAMPING_START: f64 = 1e-3;
/// Factor by which damping rises and falls.
const DAMPING_FACTOR: f64 = 10.0;
/// Relative rise of the cost that counts as rounding: a step that small would otherwise be refused at random.
const COST_NOISE: f64 = 1e-12;
/// Least relative gain for which a knot is released from its fold.
const RELEASE_GAIN: f64 = 1e-6;
/// A step counts for convergence only when damping does not shorten it.
const DAMPING_NEGLIGIBLE: f64 = 1e-2;

/// Memory for [`solve`]: one per thread, reused for every pixel, so that nothing is allocated after the
/// largest one.
///
/// Holds no state between pixels: the result does not depend on what was solved before.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    overlap: Overlap,
    closed_form: Vec<f64>,
    current: Candidate,
    trial: Candidate,
    linear: Linearised,
    newton: NewtonStep,
}

/// Solves Eq. (13) for one pixel, starting from the frames.
///
/// Returns an error only for a problem that cannot be posed. One that does not converge gives the safe
/// estimate, marked in [`Solution::outcome`]: that is data, for the caller to count and show.
pub fn solve<'w>(
    problem: &PixelProblem<'_>,
    options: &SolveOptions,
    workspace: &'w mut Workspace,
) -> Result<Solution<'w>, ProblemError> {
    solve_from(problem, Start::FromFrames, options, workspace)
}

/// [`solve`] from a start of the caller's choice.
///
/// # Panics
///
/// When a given start does not have one value per knot.
pub fn solve_from<'w>(
    problem: &PixelProblem<'_>,
    start: Start<'_>,
    options: &SolveOptions,
    workspace: &'w mut Workspace,
) -> Result<Solution<'w>, ProblemError> {
    problem.check()?;
    workspace.overlap.fill(problem);
    let lit = fit_level(problem, &workspace.overlap, &mut workspace.closed_form);
    // One knot or none: the photocurrent is constant, and the closed form is the minimum.
    if !lit || problem.t_s.len() < 2 {
        let outcome = if lit { Outcome::Converged } else { Outcome::FellBack };
        return Ok(workspace.closed_form_solution(problem, outcome, 0));
    }
    if !workspace.start(problem, start) {
        return Ok(workspace.closed_form_solution(problem, Outcome::FellBack, 0));
    }
    let (converged, iterations) = workspace.iterate(problem, options);
    if !converged {
        return Ok(workspace.closed_form_solution(problem, Outcome::FellBack, iterations));
    }
    let solved = &workspace.current;
    Ok(Solution {
        log_photocurrent: &solved.log_photocurrent,
        front_end_voltage: &solved.voltage,
        dn: &solved.dn,
        cost: solved.cost,
        misfit: problem.misfit(solved.evs_cost, solved.cis_cost),
        iterations,
        outcome: Outcome::Converged,
    })
}

impl Workspace {
    /// Fills `current`; returns whether there is a point to start from.
    fn start(&mut self, problem: &PixelProblem<'_>, start: Start<'_>) -> bool {
        if let Start::LogPhotocurrent(given) = start {
            assert_eq!(given.len(), problem.t_s.len(), "a start has one log photocurrent per knot");
            return self.current.set_log_photocurrent(problem, &self.overlap, given.iter().copied());
        }
        // Two candidates at one level: the measured steps, or the closed form's photocurrents. The first
        // meets all EVS rows but overshoots wildly where the front end is slow; the second is tame. The
        // cheaper one starts.
        let level = self.closed_form[0];
        let with_steps = self.current.set_measured_steps(problem, &self.overlap, level);
        let closed_form = self.closed_form.iter().copied();
        let with_closed_form = self.trial.set_log_photocurrent(problem, &self.overlap, closed_form);
        if with_closed_form && !(with_steps && self.current.cost <= self.trial.cost) {
            std::mem::swap(&mut self.current, &mut self.trial);
        }
        with_steps || with_closed_form
    }

    /// Levenberg-Marquardt from `current` on; returns whether it converged, and how many steps were tried.
    fn iterate(&mut self, problem: &PixelProblem<'_>, options: &SolveOptions) -> (bool, usize) {
        let mut damping = 0.0;
        let mut is_linear_here = false;
        for iteration in 1..=options.max_iterations {
            if !is_linear_here {
                self.linear.fill(problem, &self.overlap, &self.current);
                is_linear_here = true;
            }
            let is_finite = self.newton.compute(problem, &self.linear, &self.current.dn, damping);
            let is_valid = is_finite
                && self.trial.set_moved(
                    problem,
                    &self.overlap,
                    &self.current,
                    &self.linear.stages,
                    &self.newton.change,
                    Held::Stay,
                );
            if is_valid {
                let is_small = self.trial.distance(&self.current) <= options.step_tolerance;
                let is_better = self.trial.cost <= self.current.cost * (1.0 + COST_NOISE);
                if is_better {
                    std::mem::swap(&mut self.current, &mut self.trial);
                    is_linear_here = false;
                }
                // At the minimum rounding decides whether the last tiny step lowers the cost; either end will
                // do.
                if is_small && damping <= DAMPING_NEGLIGIBLE {
                    if !self.release_folds(problem) {
                        return (true, iteration);
                    }
                    is_linear_here = false;
                    continue;
                }
                if is_better {
                    damping = if damping <= DAMPING_START { 0.0 } else { damping / DAMPING_FACTOR };
                    continue;
                }
            }
            damping = if damping == 0.0 { DAMPING_START } else { damping * DAMPING_FACTOR };
            if damping > DAMPING_LIMIT {
                return (false, iteration);
            }
        }
        (false, options.max_iterations)
    }

    /// Lets go of knots held at folds if that is cheaper; returns whether `current` changed.
    fn release_folds(&mut self, problem: &PixelProblem<'_>) -> bool {
        if !self.linear.has_held() {
            return false;
        }
        self.newton.change.fill(0.0);
        let (stages, change) = (&self.linear.stages, &self.newton.change);
        let is_valid =
            self.trial.set_moved(problem, &self.overlap, &self.current, stages, change, Held::Release);
        // By a margin, or rounding could hold and release for ever.
        let is_better = is_valid && self.trial.cost < self.current.cost * (1.0 - RELEASE_GAIN);
        if is_better {
            std::mem::swap(&mut self.current, &mut self.trial);
        }
        is_better
    }

    /// Returns the closed form, with the cost and digital numbers of an ideal front end.
    fn closed_form_solution(
        &mut self,
        problem: &PixelProblem<'_>,
        outcome: Outcome,
        iterations: usize,
    ) -> Solution<'_> {
        let mut cost = 0.0;
        self.current.dn.clear();
        for (l, frame) in problem.frames.iter().enumerate() {
            let held = self.overlap.row(l).iter().zip(&self.closed_form);
            let integral: f64 = held.map(|(seconds, &u)| seconds * libm::exp(u)).sum();
            let dn = problem.black_level + problem.gain * integral;
            cost += frame.weight * (frame.dn - dn) * (frame.dn - dn);
            self.current.dn.push(dn);
        }
        let misfit = problem.misfit(0.0, cost);
        Solution {
            log_photocurrent: &self.closed_form,
            front_end_voltage: &self.closed_form,
            dn: &self.current.dn,
            cost,
            misfit,
            iterations,
            outcome,
        }
    }
}
