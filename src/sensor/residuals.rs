//! Residuals: measured minus predicted, for a candidate photocurrent of one pixel.
//!
//! The rows of Eq. (13) in one plain function over any number type: first the N - 1 EVS rows (Eq. 8 or 12),
//! then the M CIS rows (Eq. 5). The solver does not run on it (it eliminates the EVS rows first); it is the
//! independent statement that the solver's gradients are checked against, and what a diagnosis looks at.
//!
//! Residuals are raw, in natural-log units (EVS) and DN (CIS). Times the square root of its weight, a row is
//! whitened.

use crate::front_end::{FrontEnd, settle, settled_photocurrent, time_constant};
use crate::inverse::PixelProblem;
pub use crate::misfit::Misfit;
use crate::scalar::Scalar;

/// How many rows `problem` has: one per interval between knots, then one per frame sample.
pub(crate) fn row_count(problem: &PixelProblem<'_>) -> usize {
    problem.t_s.len().saturating_sub(1) + problem.frames.len()
}

/// Measured minus predicted, all EVS rows and then all CIS rows: Eqs. (1)-(8).
///
/// `front_end` is given apart from the problem so that derivatives by its parameters can be taken too.
/// `log_photocurrent` has one value per knot; `out` receives [`row_count`] values.
///
/// # Panics
///
/// When the problem has no knot or the lengths do not fit.
pub fn residuals<S: Scalar>(
    problem: &PixelProblem<'_>,
    front_end: &FrontEnd<S>,
    log_photocurrent: &[S],
    out: &mut Vec<S>,
) {
    let knots = problem.t_s.len();
    assert!(knots > 0 && log_photocurrent.len() == knots, "one log photocurrent per knot");
    out.clear();
    let mut voltage = log_photocurrent[0];
    for k in 1..knots {
        let (before, u) = (log_photocurrent[k - 1], log_photocurrent[k]);
        let tau_s = time_constant(front_end, settled_photocurrent(problem.tau_rule.pick(before, u)));
        let dt_s = S::from_f64(problem.t_s[k] - problem.t_s[k - 1]);
        let next = settle(voltage, u, dt_s, tau_s);
        out.push(S::from_f64(problem.steps[k]) - (next - voltage));
        voltage = next;
    }
    for frame in problem.frames {
        let mut integral = S::from_f64(0.0);
        for (k, &u) in log_photocurrent.iter().enumerate() {
            integral = integral
                + S::from_f64(held_s(problem.t_s, k, frame.start_s, frame.end_s)) * settled_photocurrent(u);
        }
        let dn = S::from_f64(problem.black_level) + S::from_f64(problem.gain) * integral;
        out.push(S::from_f64(frame.dn) - dn);
    }
}

/// The cost of Eq. (13) at `log_photocurrent`: the weighted sum of squared [`residuals`], without a factor
/// 1/2.
pub fn cost(problem: &PixelProblem<'_>, log_photocurrent: &[f64]) -> f64 {
    let mut rows = Vec::with_capacity(row_count(problem));
    residuals(problem, &problem.front_end, log_photocurrent, &mut rows);
    let (evs, cis) = rows.split_at(problem.t_s.len() - 1);
    let evs_cost: f64 = evs.iter().map(|row| row * row * problem.evs_weight).sum();
    let cis_cost: f64 = cis.iter().zip(problem.frames).map(|(row, frame)| row * row * frame.weight).sum();
    evs_cost + cis_cost
}

/// The dense Jacobian of [`residuals`] by the log photocurrents, by dual numbers, one pass per column:
/// row-major, [`row_count`] x N.
#[cfg(test)]
pub(crate) fn jacobian(problem: &PixelProblem<'_>, log_photocurrent: &[f64]) -> Vec<f64> {
    use crate::scalar::Dual;
    let knots = log_photocurrent.len();
    let front_end = problem.front_end.lift::<Dual<f64>>();
    let mut jacobian = vec![0.0; row_count(problem) * knots];
    let mut rows = Vec::new();
    for column in 0..knots {
        let lift = |(k, &u): (usize, &f64)| if k == column { Dual::variable(u) } else { Dual::constant(u) };
        let lifted: Vec<_> = log_photocurrent.iter().enumerate().map(lift).collect();
        residuals(problem, &front_end, &lifted, &mut rows);
        for (row, residual) in rows.iter().enumerate() {
            jacobian[row * knots + column] = residual.tangent;
        }
    }
    jacobian
}

/// Seconds that knot `k` holds inside an exposure: the first one from for ever, the last one for ever.
fn held_s(t_s: &[f64], k: usize, start_s: f64, end_s: f64) -> f64 {
    let from = if k == 0 { start_s } else { Scalar::max(t_s[k], start_s) };
    let to = if k + 1 == t_s.len() { end_s } else { Scalar::min(t_s[k + 1], end_s) };
    Scalar::max(to - from, 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::front_end::TauRule;
    use crate::inverse::FrameSample;
    use crate::scalar::Dual;

    const FRAMES: [FrameSample; 2] = [
        FrameSample { start_s: -1e-3, end_s: 3e-3, dn: 300.0, weight: 0.04 },
        FrameSample { start_s: 3.5e-3, end_s: 7e-3, dn: 210.0, weight: 0.04 },
    ];
    const T_S: [f64; 5] = [0.0, 6e-4, 2e-3, 4.1e-3, 4.2e-3];
    const U: [f64; 5] = [-1.0, -0.7, -1.4, -2.3, -1.9];

    fn problem(tau_rule: TauRule, front_end: FrontEnd) -> PixelProblem<'static> {
        PixelProblem {
            t_s: &T_S,
            steps: &[0.0, 0.2, -0.4, -0.3, 0.2],
            frames: &FRAMES,
            evs_weight: 2500.0,
            front_end,
            tau_rule,
            black_level: 16.0,
            gain: 1.5e5,
        }
    }

    const INDOOR: FrontEnd = FrontEnd { tau_0_s: 30e-6, alpha_s: 1e-4 };

    #[test]
    fn the_jacobian_matches_central_differences() {
        for tau_rule in [TauRule::Start, TauRule::End] {
            let problem = problem(tau_rule, INDOOR);
            let by_duals = jacobian(&problem, &U);
            let (mut above, mut below) = (Vec::new(), Vec::new());
            for column in 0..U.len() {
                let h = 1e-5;
                let mut moved = U;
                moved[column] += h;
                residuals(&problem, &INDOOR, &moved, &mut above);
                moved[column] -= 2.0 * h;
                residuals(&problem, &INDOOR, &moved, &mut below);
                for row in 0..above.len() {
                    let numeric = (above[row] - below[row]) / (2.0 * h);
                    let dual = by_duals[row * U.len() + column];
                    // Third derivatives of the CIS rows are near 300 DN: h^2 times that is 3e-8.
                    assert!((dual - numeric).abs() < 1e-6 * (1.0 + dual.abs()), "{dual} against {numeric}");
                }
            }
        }
    }

    #[test]
    fn an_ideal_front_end_measures_differences_of_log_photocurrent() {
        let problem = problem(TauRule::Start, FrontEnd::IDEAL);
        let mut rows = Vec::new();
        residuals(&problem, &FrontEnd::IDEAL, &U, &mut rows);
        for k in 1..U.len() {
            assert!((rows[k - 1] - (problem.steps[k] - (U[k] - U[k - 1]))).abs() < 1e-14);
        }
    }

    #[test]
    fn derivatives_by_the_front_end_parameters_match_central_differences() {
        let problem = problem(TauRule::End, INDOOR);
        let lifted = U.map(Dual::constant);
        let front_end = FrontEnd { alpha_s: Dual::variable(INDOOR.alpha_s), ..INDOOR.lift() };
        let (mut duals, mut above, mut below) = (Vec::new(), Vec::new(), Vec::new());
        residuals(&problem, &front_end, &lifted, &mut duals);
        let h = 1e-9;
        residuals(&problem, &FrontEnd { alpha_s: INDOOR.alpha_s + h, ..INDOOR }, &U, &mut above);
        residuals(&problem, &FrontEnd { alpha_s: INDOOR.alpha_s - h, ..INDOOR }, &U, &mut below);
        for row in 0..duals.len() {
            let numeric = (above[row] - below[row]) / (2.0 * h);
            assert!((duals[row].tangent - numeric).abs() < 1e-5 * (1.0 + numeric.abs()));
        }
    }
}
