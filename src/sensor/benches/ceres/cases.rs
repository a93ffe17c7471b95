//! The problems that are compared: synthetic ones by size, and the reference problems; and where every solver
//! starts.

use crate::problems::{Columns, SEED, columns};
use photocurrent_sensor::front_end::{FrontEnd, TauRule, settled_photocurrent, settling, time_constant};
use photocurrent_sensor::inverse::{FrameSample, PixelProblem, SolveOptions, Workspace, solve};
use photocurrent_sensor::residuals::cost;
use serde::Deserialize;

const REFERENCE: &str = include_str!("../../../../data/solver/reference_problems.json");

/// One pixel's problem, owned, with a start for solvers that need one.
pub struct Case {
    columns: Columns,
    front_end: FrontEnd,
    tau_rule: TauRule,
    gain: f64,
    /// ln i per knot: where this project's solver starts too.
    pub start: Vec<f64>,
}

impl Case {
    fn new(columns: Columns, front_end: FrontEnd, tau_rule: TauRule, gain: f64) -> Case {
        let mut case = Case { columns, front_end, tau_rule, gain, start: Vec::new() };
        case.start = start(&case.problem());
        case
    }

    /// The problem as the solver takes it.
    pub fn problem(&self) -> PixelProblem<'_> {
        PixelProblem { front_end: self.front_end, gain: self.gain, ..self.columns.problem(self.tau_rule) }
    }
}

/// `pixels` synthetic problems of `knots` events, with seeds that follow one another.
pub fn synthetic(knots: usize, tau_rule: TauRule, pixels: u64) -> Vec<Case> {
    let case = |n| {
        let columns = columns(knots, SEED + n);
        let problem = columns.problem(tau_rule);
        let (front_end, gain) = (problem.front_end, problem.gain);
        Case::new(columns, front_end, tau_rule, gain)
    };
    (0..pixels).map(case).collect()
}

#[derive(Deserialize)]
struct Reference {
    tau0_ms: f64,
    gain_dn_per_unit_ms: f64,
    problems: Vec<Given>,
}

#[derive(Deserialize)]
struct Given {
    tau_rule: String,
    alpha: f64,
    t_ms: Vec<f64>,
    c: Vec<f64>,
    cis: Vec<[f64; 3]>,
}

/// The problems of `data/solver`; their weights are those of the synthetic ones.
pub fn reference() -> Vec<Case> {
    let reference: Reference = serde_json::from_str(REFERENCE).expect("the reference file parses");
    let case = |given: &Given| {
        let columns = Columns {
            t_s: given.t_ms.iter().map(|t| t * 1e-3).collect(),
            steps: given.c.clone(),
            frames: given
                .cis
                .iter()
                .map(|&[start, end, dn]| FrameSample {
                    start_s: start * 1e-3,
                    end_s: end * 1e-3,
                    dn,
                    weight: 0.04,
                })
                .collect(),
        };
        let front_end = FrontEnd { tau_0_s: reference.tau0_ms * 1e-3, alpha_s: given.alpha * 1e-3 };
        let tau_rule = if given.tau_rule == "prev" { TauRule::Start } else { TauRule::End };
        Case::new(columns, front_end, tau_rule, reference.gain_dn_per_unit_ms * 1e3)
    };
    reference.problems.iter().map(case).collect()
}

/// The cheaper of two: the closed form of an ideal front end, or photocurrents that make the measured steps,
/// from the same level.
fn start(problem: &PixelProblem<'_>) -> Vec<f64> {
    // Without any iteration the solver gives its closed form.
    let none = SolveOptions { max_iterations: 0, ..SolveOptions::default() };
    let closed_form = solve(problem, &none, &mut Workspace::default())
        .expect("the problem is well posed")
        .log_photocurrent
        .to_vec();
    match with_measured_steps(problem, closed_form[0]) {
        Some(exact) if cost(problem, &exact) <= cost(problem, &closed_form) => exact,
        _ => closed_form,
    }
}

/// Photocurrents that make every measured step, or nothing where one asks for a fall that the front end
/// cannot make.
fn with_measured_steps(problem: &PixelProblem<'_>, level: f64) -> Option<Vec<f64>> {
    let mut found = vec![level];
    let mut voltage = level;
    for k in 1..problem.t_s.len() {
        let (step, dt_s, before) = (problem.steps[k], problem.t_s[k] - problem.t_s[k - 1], found[k - 1]);
        let gamma = |u: f64| {
            settling(
                dt_s,
                time_constant(&problem.front_end, settled_photocurrent(problem.tau_rule.pick(before, u))),
            )
        };
        let excess = |u: f64| gamma(u) * (u - voltage) - step;
        // Outwards until the step is made, then by halves. Far steps would pass a fold unseen.
        let stride = if step < 0.0 { -0.02 } else { 0.02 };
        let mut far = voltage;
        while excess(far) * stride < 0.0 {
            far += stride;
            if (far - voltage).abs() > 20.0 {
                return None;
            }
        }
        let mut near = far - stride;
        for _ in 0..60 {
            let middle = 0.5 * (near + far);
            if excess(middle) * stride < 0.0 { near = middle } else { far = middle }
        }
        found.push(far);
        voltage += step;
    }
    Some(found)
}
