//! The problem linearised at a candidate: how each unknown moves the voltages, the photocurrents and the
//! rows.
//!
//! Idea: change the unknowns from `u_k` to `d_1 = V(1)` and `d_k = V(k) - V(k-1)`. Then every EVS row of Eq.
//! (13) is `measured step - d_k`, an identity, and only the few CIS rows are nonlinear. Their gradients come
//! from one backward sweep each over the chain of intervals.
//!
//! At a fold (see `interval`) a step no longer determines the photocurrent, so there `u_k` itself stays the
//! unknown ([`Chart::LogPhotocurrent`]) and the EVS row is the nonlinear one. Its second derivative is kept,
//! because at a fold the first one vanishes while the residual does not. Dim pixels have many such knots,
//! bright ones none.

use super::candidate::Candidate;
use super::overlap::Overlap;
use super::problem::PixelProblem;
use super::stage::{Chart, Stage};
use crate::front_end::TauRule;

/// Below this share of gamma, the slope of step by log photocurrent is too close to a fold to divide by.
///
/// Any value between 0 and 1 gives the same minimum. With 0.25, dim pixels near a fold crept (steps shrinking
/// by a tenth); with 0.5 the curvature below catches them.
const FOLD_SLOPE: f64 = 0.5;

/// Curvature, as a share of that at full settling, that a folded knot has at least: keeps the step finite.
const LEAST_CURVATURE: f64 = 1e-6;

/// Below this share of gamma, the slope is that of a knot which was stopped at its fold.
const AT_FOLD: f64 = 1e-9;

/// The stages of all knots; the first is the free level and has no EVS row.
#[derive(Clone, Debug, Default)]
pub(super) struct Linearised {
    pub stages: Vec<Stage>,
    /// Derivative of half the EVS cost by each unknown.
    pub evs_gradient: Vec<f64>,
    /// Derivatives of the digital numbers by each unknown, one row of knots per frame sample.
    pub dn_gradients: Vec<f64>,
}

impl Linearised {
    /// Linearises `problem` at `at`.
    pub(super) fn fill(&mut self, problem: &PixelProblem<'_>, overlap: &Overlap, at: &Candidate) {
        let knots = at.step.len();
        self.stages.clear();
        self.stages.push(Stage { step_s: 1.0, u_s: 1.0, ..Stage::default() });
        self.stages.extend((1..knots).map(|k| stage(problem, at, k)));
        self.evs_gradient.resize(knots, 0.0);
        if self.has_fold() {
            treat_folds(problem, overlap, at, &mut self.stages);
        }
        let pull = |k: usize| problem.evs_weight * (at.step[k] - problem.steps[k]);
        pull_back(&self.stages, |_| 0.0, pull, &mut self.evs_gradient);
        self.dn_gradients.clear();
        self.dn_gradients.resize(problem.frames.len() * knots, 0.0);
        for (l, gradient) in self.dn_gradients.chunks_exact_mut(knots).enumerate() {
            let row = overlap.row(l);
            // Knots after the exposure keep the zero they were given.
            let used = row.len();
            let dn_by_u = |k: usize| problem.gain * at.photocurrent[k] * row[k];
            pull_back(&self.stages[..used], dn_by_u, |_| 0.0, &mut gradient[..used]);
        }
    }

    /// Whether some knot lies at or near a fold.
    pub(super) fn has_fold(&self) -> bool {
        self.charts().any(|chart| chart != Chart::Step)
    }

    /// Whether some knot is held at its fold.
    pub(super) fn has_held(&self) -> bool {
        self.charts().any(|chart| chart == Chart::Fold)
    }

    /// What the unknown of each knot is.
    pub(super) fn charts(&self) -> impl Iterator<Item = Chart> + '_ {
        self.stages.iter().map(|stage| stage.chart)
    }
}

fn stage(problem: &PixelProblem<'_>, at: &Candidate, k: usize) -> Stage {
    let weight = problem.evs_weight;
    let settling = at.settling[k];
    let drive = at.log_photocurrent[k] - at.voltage[k - 1];
    let identity_row = Stage { step_s: 1.0, curvature_ss: weight, damping: weight, ..Stage::default() };
    // d = gamma (u - V), so u = V + d / gamma.
    if problem.tau_rule == TauRule::Start {
        return Stage {
            u_s: 1.0 / settling.gamma,
            u_v: 1.0,
            u_before: -drive * settling.slope / settling.gamma,
            ..identity_row
        };
    }
    let slope = settling.gamma + settling.slope * drive;
    if slope >= FOLD_SLOPE * settling.gamma {
        return Stage { u_s: 1.0 / slope, u_v: settling.gamma / slope, ..identity_row };
    }
    let least = LEAST_CURVATURE * settling.gamma * settling.gamma;
    Stage {
        chart: Chart::LogPhotocurrent,
        step_s: slope,
        step_v: -settling.gamma,
        u_s: 1.0,
        u_v: 0.0,
        u_before: 0.0,
        step_ss: 2.0 * settling.slope + settling.curvature * drive,
        step_sv: -settling.slope,
        curvature_ss: weight * (slope * slope + least),
        curvature_sv: -weight * slope * settling.gamma,
        curvature_vv: weight * settling.gamma * settling.gamma,
        damping: weight * settling.gamma * settling.gamma,
    }
}

/// Holds knots at their folds, and adds second derivatives of the whole cost at knots near one.
///
/// One backward sweep gives the force on each step and each log photocurrent. A knot at its fold whose frames
/// ask for less light is held there. Near a fold, force times second derivative is the curvature that
/// Gauss-Newton leaves out; it is added where it helps (elsewhere the step might not descend).
fn treat_folds(problem: &PixelProblem<'_>, overlap: &Overlap, at: &Candidate, stages: &mut [Stage]) {
    let mut on_voltage = 0.0;
    for (k, stage) in stages.iter_mut().enumerate().skip(1).rev() {
        let mut direct = 0.0;
        for (l, frame) in problem.frames.iter().enumerate() {
            let seconds = overlap.row(l).get(k).copied().unwrap_or(0.0);
            direct += frame.weight * (at.dn[l] - frame.dn) * problem.gain * at.photocurrent[k] * seconds;
        }
        let on_step = problem.evs_weight * (at.step[k] - problem.steps[k]) + on_voltage;
        let is_near_fold = stage.chart == Chart::LogPhotocurrent;
        let is_at_fold = is_near_fold && stage.step_s <= -AT_FOLD * stage.step_v;
        // A digital number is exponential in a log photocurrent, so its own second derivative equals its
        // first.
        let extra = on_step * stage.step_ss + direct;
        if is_at_fold && direct > 0.0 {
            *stage = stage.held_at_fold();
        } else if is_near_fold && extra > 0.0 {
            stage.curvature_ss += extra;
            stage.curvature_sv += on_step * stage.step_sv;
        }
        on_voltage += on_step * stage.step_v + direct * stage.u_v;
    }
}

/// Turns derivatives by log photocurrents and steps into derivatives by the unknowns: one backward sweep.
fn pull_back(stages: &[Stage], by_u: impl Fn(usize) -> f64, by_step: impl Fn(usize) -> f64, out: &mut [f64]) {
    let mut by_voltage = 0.0;
    let mut carried_by_u = 0.0;
    for (k, stage) in stages.iter().enumerate().skip(1).rev() {
        let by_u = by_u(k) + carried_by_u;
        let by_step = by_step(k) + by_voltage;
        out[k] = by_u * stage.u_s + by_step * stage.step_s;
        by_voltage += by_step * stage.step_v + by_u * stage.u_v;
        carried_by_u = by_u * stage.u_before;
    }
    out[0] = by_u(0) + carried_by_u + by_voltage;
}
