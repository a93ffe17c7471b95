//! The damped Gauss-Newton step of one pixel, from an M x M system (M frames) instead of an N x N one (N
//! knots).
//!
//! The EVS rows alone form a chain: each knot's unknown has its own row, and knots are tied only through the
//! voltage that they hand on. Minimising over the chain is a scalar recursion (Riccati), which is plain
//! division wherever no fold is involved. The M dense CIS rows and the free level are added by the Woodbury
//! identity. O(N M^2) in all; exact, as long as a dense solve would be.

use super::chain::Chain;
use super::linear::Linearised;
use super::problem::PixelProblem;
use nalgebra::{Cholesky, DMatrix, DVector};

/// Storage for the step, reused from pixel to pixel.
#[derive(Clone, Debug)]
pub(super) struct NewtonStep {
    chain: Chain,
    /// Chain response to each digital number's gradient, one row of knots per frame.
    responses: Vec<f64>,
    evs_response: Vec<f64>,
    level_response: Vec<f64>,
    system: DMatrix<f64>,
    dn_pull: DVector<f64>,
    level_pull: DVector<f64>,
    solved_level_pull: DVector<f64>,
    /// The step: a change for each unknown.
    pub change: Vec<f64>,
}

impl Default for NewtonStep {
    fn default() -> Self {
        NewtonStep {
            chain: Chain::default(),
            responses: Vec::new(),
            evs_response: Vec::new(),
            level_response: Vec::new(),
            system: DMatrix::zeros(0, 0),
            dn_pull: DVector::zeros(0),
            level_pull: DVector::zeros(0),
            solved_level_pull: DVector::zeros(0),
            change: Vec::new(),
        }
    }
}

impl NewtonStep {
    /// Computes `change`; `damping` 0 is plain Gauss-Newton. Returns whether the step is finite.
    ///
    /// `dn` are the digital numbers predicted where `linear` was taken.
    pub(super) fn compute(
        &mut self,
        problem: &PixelProblem<'_>,
        linear: &Linearised,
        dn: &[f64],
        damping: f64,
    ) -> bool {
        let (knots, frames) = (linear.stages.len(), problem.frames.len());
        self.resize(knots, frames);
        let level_curvature = self.chain.factor(linear, damping);
        self.chain.solve(linear, |k| -linear.evs_gradient[k], 0.0, &mut self.evs_response);
        self.chain.solve(linear, |_| 0.0, 1.0, &mut self.level_response);
        let gradients = || linear.dn_gradients.chunks_exact(knots);
        for (gradient, response) in gradients().zip(self.responses.chunks_exact_mut(knots)) {
            self.chain.solve(linear, |k| gradient[k], 0.0, response);
        }
        for (l, gradient) in gradients().enumerate() {
            for (m, response) in self.responses.chunks_exact(knots).enumerate().take(l + 1) {
                let coupling = dot(gradient, response);
                self.system[(l, m)] = coupling;
                self.system[(m, l)] = coupling;
            }
            let frame = &problem.frames[l];
            self.system[(l, l)] += 1.0 / frame.weight;
            self.dn_pull[l] = frame.dn - dn[l] - dot(gradient, &self.evs_response);
            self.level_pull[l] = dot(gradient, &self.level_response);
        }
        self.combine(linear, level_curvature, damping) && self.change.iter().all(|change| change.is_finite())
    }

    fn resize(&mut self, knots: usize, frames: usize) {
        self.responses.clear();
        self.responses.resize(knots * frames, 0.0);
        for column in [&mut self.evs_response, &mut self.level_response, &mut self.change] {
            column.resize(knots, 0.0);
        }
        if self.system.nrows() != frames {
            self.system = DMatrix::zeros(frames, frames);
            self.dn_pull = DVector::zeros(frames);
            self.level_pull = DVector::zeros(frames);
            self.solved_level_pull = DVector::zeros(frames);
        }
    }

    /// Solves for the level and the M multipliers and adds up the responses.
    fn combine(&mut self, linear: &Linearised, level_curvature: f64, damping: f64) -> bool {
        let knots = linear.stages.len();
        // The factorisation consumes the matrix; it is handed back below, so that nothing is allocated.
        let system = std::mem::replace(&mut self.system, DMatrix::zeros(0, 0));
        let Some(factor) = Cholesky::new(system) else {
            return false;
        };
        // level = (b S^-1 r - g z) / (P_0 + b S^-1 b), with b the DN change per unit of level and z the
        // chain's response.
        self.solved_level_pull.copy_from(&self.level_pull);
        factor.solve_mut(&mut self.solved_level_pull);
        let level_gradient = dot(&linear.evs_gradient, &self.level_response);
        let curvature = level_curvature + self.level_pull.dot(&self.solved_level_pull);
        let level =
            (self.solved_level_pull.dot(&self.dn_pull) - level_gradient) / (curvature * (1.0 + damping));
        let multipliers = &mut self.dn_pull;
        multipliers.axpy(-level, &self.level_pull, 1.0);
        factor.solve_mut(multipliers);
        for k in 0..knots {
            self.change[k] = level * self.level_response[k] + self.evs_response[k];
        }
        for (multiplier, response) in multipliers.iter().zip(self.responses.chunks_exact(knots)) {
            for (change, response) in self.change.iter_mut().zip(response) {
                *change += multiplier * response;
            }
        }
        self.system = factor.unpack_dirty();
        true
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
