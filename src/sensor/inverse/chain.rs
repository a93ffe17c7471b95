//! The quadratic form of the EVS rows, factored along the chain of knots.
//!
//! Stage `k` costs `ss s^2 + 2 sv s V + vv V^2` in its unknown `s` and the voltage change `V` handed to it,
//! and hands on `V' = (1 + step_v) V + step_s s`. Minimising from the last knot backwards leaves one number
//! per knot (the cost to come, `P V^2`), as in a linear-quadratic regulator. Without folds `P` stays 0 and
//! everything is a division.

use super::linear::Linearised;

/// The factored chain.
#[derive(Clone, Debug, Default)]
pub(super) struct Chain {
    inverse_pivots: Vec<f64>,
    /// How much an unknown answers to the voltage handed to it.
    feedback: Vec<f64>,
    has_fold: bool,
}

impl Chain {
    /// Factors the chain with `damping` added, and returns the curvature left for the free level (`P` at the
    /// first knot).
    pub(super) fn factor(&mut self, linear: &Linearised, damping: f64) -> f64 {
        let knots = linear.stages.len();
        self.inverse_pivots.resize(knots, 1.0);
        self.has_fold = linear.has_fold();
        self.feedback.resize(knots, 0.0);
        let mut to_come = 0.0;
        for (k, stage) in linear.stages.iter().enumerate().skip(1).rev() {
            let kept = 1.0 + stage.step_v;
            let ss = stage.curvature_ss + damping * stage.damping + stage.step_s * stage.step_s * to_come;
            let sv = stage.curvature_sv + stage.step_s * kept * to_come;
            let vv = stage.curvature_vv + kept * kept * to_come;
            self.inverse_pivots[k] = 1.0 / ss;
            self.feedback[k] = -sv * self.inverse_pivots[k];
            let left = vv + sv * self.feedback[k];
            // A fold's second derivatives can make this negative: dropping it keeps every step a descent.
            to_come = if left > 0.0 { left } else { 0.0 };
        }
        to_come
    }

    /// Minimises the chain's cost minus `pull(k) s_k` over all knots but the first, which is held at `level`.
    pub(super) fn solve(
        &self,
        linear: &Linearised,
        pull: impl Fn(usize) -> f64,
        level: f64,
        out: &mut [f64],
    ) {
        if !self.has_fold {
            // Nothing answers to the voltage: every unknown minimises its own row.
            for (k, (out, inverse_pivot)) in out.iter_mut().zip(&self.inverse_pivots).enumerate() {
                *out = pull(k) * inverse_pivot;
            }
            out[0] = level;
            return;
        }
        let mut voltage_pull = 0.0;
        for (k, stage) in linear.stages.iter().enumerate().skip(1).rev() {
            let total = pull(k) + stage.step_s * voltage_pull;
            out[k] = total * self.inverse_pivots[k];
            voltage_pull = (1.0 + stage.step_v) * voltage_pull + self.feedback[k] * total;
        }
        out[0] = level;
        let mut voltage = level;
        for (k, stage) in linear.stages.iter().enumerate().skip(1) {
            out[k] += self.feedback[k] * voltage;
            voltage = (1.0 + stage.step_v) * voltage + stage.step_s * out[k];
        }
    }
}
