//! A candidate solution: photocurrent and voltage of every knot, the digital numbers they predict, and the
//! cost.
//!
//! Every way to fill one ends in the same state equation, Eq. (1) with Eqs. (2), (3) and (6), evaluated
//! forward.

use super::interval::{Settling, fold, reach_step, settling_at};
use super::overlap::Overlap;
use super::problem::{LOG_PHOTOCURRENT_MAX, LOG_PHOTOCURRENT_MIN, PixelProblem};
use super::stage::{Chart, Stage};
use crate::front_end::{TauRule, settled_photocurrent};

/// A step is limited to this many natural-log units where the log photocurrent itself is the unknown.
const FOLDED_MOVE_LIMIT: f64 = 2.0;

/// What happens to knots that are held at their folds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Held {
    /// They stay there and follow the voltage.
    Stay,
    /// They take their measured step, if it is possible. A fold can be a false minimum: at it the light
    /// changes at first order and the step only at second, so the EVS row alone cannot pull a knot off.
    Release,
}

/// One point of the search, with everything the cost needs. All columns are as long as the knots (at least
/// one).
#[derive(Clone, Debug, Default)]
pub(super) struct Candidate {
    /// `u_k = ln i_pd(k)`.
    pub log_photocurrent: Vec<f64>,
    /// `V_FE(k)`.
    pub voltage: Vec<f64>,
    /// `d_k = V(k) - V(k-1)`; the first element is `V(1)` itself, the free level.
    pub step: Vec<f64>,
    /// `i_pd(k)`.
    pub photocurrent: Vec<f64>,
    /// gamma of the interval before each knot; the first element has no meaning.
    pub settling: Vec<Settling>,
    /// Predicted digital number per frame sample.
    pub dn: Vec<f64>,
    /// Eq. (13).
    pub cost: f64,
    /// The parts of it: of the EVS rows and of the CIS rows.
    pub evs_cost: f64,
    pub cis_cost: f64,
}

impl Candidate {
    fn resize(&mut self, knots: usize) {
        for column in [&mut self.log_photocurrent, &mut self.voltage, &mut self.step, &mut self.photocurrent]
        {
            column.resize(knots, 0.0);
        }
        self.settling.resize(knots, Settling::default());
    }

    /// Takes `log_photocurrent` (the measured step where it lies beyond a fold) and follows Eq. (1).
    ///
    /// Like the other ways to fill a candidate, returns whether the cost is finite and every value in range.
    pub(super) fn set_log_photocurrent(
        &mut self,
        problem: &PixelProblem<'_>,
        overlap: &Overlap,
        log_photocurrent: impl Iterator<Item = f64>,
    ) -> bool {
        self.resize(problem.t_s.len());
        for (k, u) in log_photocurrent.enumerate().take(problem.t_s.len()) {
            if k == 0 {
                self.start(u);
            } else if !self.set_target(problem, k, u) {
                self.make_step(problem, k, problem.steps[k], f64::NAN);
            }
        }
        self.evaluate(problem, overlap)
    }

    /// Starts at voltage `level` and makes the measured steps, as far as the front end can.
    pub(super) fn set_measured_steps(
        &mut self,
        problem: &PixelProblem<'_>,
        overlap: &Overlap,
        level: f64,
    ) -> bool {
        self.resize(problem.t_s.len());
        self.start(level);
        for k in 1..problem.t_s.len() {
            self.make_step(problem, k, problem.steps[k], f64::NAN);
        }
        self.evaluate(problem, overlap)
    }

    /// Moves every unknown of `from` by `change`; `stages`, taken at `from`, say what the unknown of each
    /// knot is.
    pub(super) fn set_moved(
        &mut self,
        problem: &PixelProblem<'_>,
        overlap: &Overlap,
        from: &Candidate,
        stages: &[Stage],
        change: &[f64],
        held: Held,
    ) -> bool {
        self.resize(problem.t_s.len());
        self.start(from.step[0] + change[0]);
        for (k, stage) in stages.iter().enumerate().skip(1) {
            match stage.chart {
                Chart::Step => {
                    let voltage_change = self.voltage[k - 1] - from.voltage[k - 1];
                    let guess = from.log_photocurrent[k] + stage.u_s * change[k] + stage.u_v * voltage_change;
                    self.make_step(problem, k, from.step[k] + change[k], guess);
                }
                Chart::LogPhotocurrent => {
                    let limited = change[k].clamp(-FOLDED_MOVE_LIMIT, FOLDED_MOVE_LIMIT);
                    let u = from.log_photocurrent[k] + limited;
                    if !self.set_target(problem, k, u) {
                        self.set_fold(problem, k, u);
                    }
                }
                Chart::Fold if held == Held::Release => {
                    self.make_step(problem, k, problem.steps[k], f64::NAN)
                }
                Chart::Fold => self.set_fold(problem, k, from.log_photocurrent[k]),
            }
        }
        self.evaluate(problem, overlap)
    }

    /// The largest change of a log photocurrent between two candidates.
    pub(super) fn distance(&self, other: &Candidate) -> f64 {
        let pairs = self.log_photocurrent.iter().zip(&other.log_photocurrent);
        pairs.fold(0.0, |largest, (a, b)| {
            let change = (a - b).abs();
            if change > largest { change } else { largest }
        })
    }

    /// Eq. (6): the front end has settled at the first knot.
    fn start(&mut self, level: f64) {
        self.log_photocurrent[0] = level;
        self.photocurrent[0] = settled_photocurrent(level);
        self.voltage[0] = level;
        self.step[0] = level;
    }

    /// Settles towards log photocurrent `u` at knot `k`: a step of gamma (u - V), Eq. (1).
    /// Returns whether `u` lies on the near side of the fold; otherwise the knot is not complete.
    fn set_target(&mut self, problem: &PixelProblem<'_>, k: usize, u: f64) -> bool {
        self.set_knot(problem, k, u);
        let settling = self.settling[k];
        let drive = u - self.voltage[k - 1];
        if problem.tau_rule == TauRule::End && settling.gamma + settling.slope * drive < 0.0 {
            return false;
        }
        self.set_step(k, settling.gamma * drive);
        true
    }

    /// Makes the largest fall that exists.
    fn set_fold(&mut self, problem: &PixelProblem<'_>, k: usize, guess: f64) {
        let dt_s = problem.t_s[k] - problem.t_s[k - 1];
        let reached = fold(&problem.front_end, self.voltage[k - 1], dt_s, guess);
        self.set_knot(problem, k, reached.u);
        self.set_step(k, reached.step);
    }

    /// Finds the log photocurrent at knot `k` that causes `step`. A `guess` outside the possible is ignored.
    fn make_step(&mut self, problem: &PixelProblem<'_>, k: usize, step: f64, guess: f64) {
        let dt_s = problem.t_s[k] - problem.t_s[k - 1];
        let voltage = self.voltage[k - 1];
        match problem.tau_rule {
            TauRule::Start => {
                let before = self.photocurrent[k - 1];
                self.settling[k] = settling_at(&problem.front_end, before, dt_s);
                let u = voltage + step / self.settling[k].gamma;
                self.log_photocurrent[k] = u;
                self.photocurrent[k] = settled_photocurrent(u);
                self.set_step(k, step);
            }
            TauRule::End => {
                let reached = reach_step(&problem.front_end, voltage, step, dt_s, guess);
                self.set_knot(problem, k, reached.u);
                self.set_step(k, reached.step);
            }
        }
    }

    /// Sets everything at knot `k` but its step and voltage.
    fn set_knot(&mut self, problem: &PixelProblem<'_>, k: usize, u: f64) {
        let dt_s = problem.t_s[k] - problem.t_s[k - 1];
        self.log_photocurrent[k] = u;
        self.photocurrent[k] = settled_photocurrent(u);
        let sets_tau = problem.tau_rule.pick(self.photocurrent[k - 1], self.photocurrent[k]);
        self.settling[k] = settling_at(&problem.front_end, sets_tau, dt_s);
    }

    fn set_step(&mut self, k: usize, step: f64) {
        self.step[k] = step;
        self.voltage[k] = self.voltage[k - 1] + step;
    }

    /// Sums up digital numbers and cost; returns whether they are to be trusted.
    fn evaluate(&mut self, problem: &PixelProblem<'_>, overlap: &Overlap) -> bool {
        // NaN is outside too. Outside the range, squares of photocurrents could overflow.
        let range = LOG_PHOTOCURRENT_MIN..=LOG_PHOTOCURRENT_MAX;
        if !self.log_photocurrent.iter().all(|u| range.contains(u)) {
            return false;
        }
        let mut cost = 0.0;
        for (step, measured) in self.step.iter().zip(problem.steps).skip(1) {
            cost += (measured - step) * (measured - step);
        }
        cost *= problem.evs_weight;
        (self.evs_cost, self.cis_cost) = (cost, 0.0);
        self.dn.clear();
        for (l, frame) in problem.frames.iter().enumerate() {
            let held = overlap.row(l).iter().zip(&self.photocurrent);
            let integral: f64 = held.map(|(seconds, i)| seconds * i).sum();
            let dn = problem.black_level + problem.gain * integral;
            let part = frame.weight * (frame.dn - dn) * (frame.dn - dn);
            cost += part;
            self.cis_cost += part;
            self.dn.push(dn);
        }
        self.cost = cost;
        cost.is_finite()
    }
}
