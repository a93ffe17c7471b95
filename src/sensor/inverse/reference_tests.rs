//! The solver against problems whose optimum other solvers found (scipy, Ceres): see `data/solver/README.md`.

use super::*;
use crate::front_end::{FrontEnd, TauRule};
use crate::readout::compensated_step;
use crate::residuals::{cost, residuals};
use serde::Deserialize;

const FILE: &str = include_str!("../../../data/solver/reference_problems.json");

#[derive(Deserialize)]
struct Reference {
    tau0_ms: f64,
    gain_dn_per_unit_ms: f64,
    sigma_evs: f64,
    sigma_cis_dn: f64,
    problems: Vec<Given>,
}

#[derive(Deserialize)]
struct Given {
    tau_rule: String,
    alpha: f64,
    t_ms: Vec<f64>,
    c: Vec<f64>,
    cis: Vec<[f64; 3]>,
    u0: Vec<f64>,
    opt_log_i: Vec<f64>,
    cost: f64,
    events_tin_toff_p: Option<Vec<[f64; 3]>>,
    threshold: Option<f64>,
    trp_ms: Option<f64>,
}

/// Hands `check` every problem, in our units, with what the file says of it.
fn for_each_problem(mut check: impl FnMut(usize, &PixelProblem<'_>, &Given)) {
    let reference: Reference = serde_json::from_str(FILE).expect("the reference file parses");
    assert_eq!(reference.problems.len(), 29);
    for (index, given) in reference.problems.iter().enumerate() {
        let t_s: Vec<f64> = given.t_ms.iter().map(|t| t * 1e-3).collect();
        let weight = 1.0 / (reference.sigma_cis_dn * reference.sigma_cis_dn);
        let frames: Vec<FrameSample> = given
            .cis
            .iter()
            .map(|&[start, end, dn]| FrameSample { start_s: start * 1e-3, end_s: end * 1e-3, dn, weight })
            .collect();
        let problem = PixelProblem {
            t_s: &t_s,
            steps: &given.c,
            frames: &frames,
            evs_weight: 1.0 / (reference.sigma_evs * reference.sigma_evs),
            front_end: FrontEnd { tau_0_s: reference.tau0_ms * 1e-3, alpha_s: given.alpha * 1e-3 },
            tau_rule: if given.tau_rule == "prev" { TauRule::Start } else { TauRule::End },
            black_level: 0.0,
            gain: reference.gain_dn_per_unit_ms * 1e3,
        };
        check(index, &problem, given);
    }
}

/// Panics unless `solution` is the file's optimum: cost to 1e-6, log photocurrents to 1e-4 where a frame sees
/// them.
fn assert_is_optimum(index: usize, problem: &PixelProblem<'_>, given: &Given, solution: &Solution<'_>) {
    assert!(solution.has_converged(), "problem {index} did not converge");
    let relative = solution.cost / given.cost - 1.0;
    assert!(relative.abs() < 1e-6, "problem {index}: cost {} instead of {}", solution.cost, given.cost);
    // An independent reading of the cost, straight from Eqs. (1)-(8).
    let restated = cost(problem, solution.log_photocurrent);
    assert!(
        (restated / solution.cost - 1.0).abs() < 1e-10,
        "problem {index}: {restated} and {}",
        solution.cost
    );
    let jacobian = crate::residuals::jacobian(problem, solution.log_photocurrent);
    let (knots, evs_rows) = (problem.t_s.len(), problem.t_s.len() - 1);
    for (k, (u, optimum)) in solution.log_photocurrent.iter().zip(&given.opt_log_i).enumerate() {
        let is_seen = (0..problem.frames.len()).any(|l| jacobian[(evs_rows + l) * knots + k].abs() > 1e-3);
        if is_seen {
            assert!((u - optimum).abs() < 1e-4, "problem {index}, knot {k}: {u} instead of {optimum}");
        }
    }
}

#[test]
fn every_reference_optimum_is_reached_from_the_frames() {
    let mut workspace = Workspace::default();
    for_each_problem(|index, problem, given| {
        let solution =
            solve(problem, &SolveOptions::default(), &mut workspace).expect("a well-posed problem");
        assert_is_optimum(index, problem, given, &solution);
        assert!(solution.iterations <= 8, "problem {index} took {} steps", solution.iterations);
    });
}

#[test]
fn every_reference_optimum_is_reached_from_other_starts() {
    let mut workspace = Workspace::default();
    for_each_problem(|index, problem, given| {
        let knots = given.u0.len();
        let flat = vec![given.u0.iter().sum::<f64>() / knots as f64; knots];
        let wavy: Vec<f64> =
            (0..knots).map(|k| given.u0[k] + 0.5 * libm::sin(1.7 * k as f64 + index as f64)).collect();
        let bright: Vec<f64> = given.u0.iter().map(|u| u + 1.5).collect();
        let dark: Vec<f64> = given.u0.iter().map(|u| u - 0.6).collect();
        for start in [&given.u0, &given.opt_log_i, &flat, &wavy, &bright, &dark] {
            let start = Start::LogPhotocurrent(start);
            let solution =
                solve_from(problem, start, &SolveOptions::default(), &mut workspace).expect("well posed");
            assert_is_optimum(index, problem, given, &solution);
        }
    });
}

#[test]
fn a_start_far_too_dark_can_stop_at_a_fold() {
    // A known limit: from e^-1 of the level, knots of problem 8 get caught at their folds, a false minimum on
    // the way down. The start from the frames never comes from so far below.
    let mut workspace = Workspace::default();
    for_each_problem(|index, problem, given| {
        let dark: Vec<f64> = given.u0.iter().map(|u| u - 1.0).collect();
        let start = Start::LogPhotocurrent(&dark);
        let solution =
            solve_from(problem, start, &SolveOptions::default(), &mut workspace).expect("well posed");
        if index == 8 {
            assert!(solution.has_converged() && solution.cost > given.cost);
        } else {
            assert_is_optimum(index, problem, given, &solution);
        }
    });
}

#[test]
fn a_darker_minimum_beyond_the_folds_is_not_taken() {
    // The printed cost of problem 8 has a lower minimum (39.75) with knots 9 and 10 at -3.8 and -4.0 instead
    // of -2.0 and -2.5: steps that the linear low-pass makes twice, once with a light so dark that it hardly
    // answers.
    let mut workspace = Workspace::default();
    for_each_problem(|index, problem, given| {
        if index == 8 {
            let mut start = given.opt_log_i.clone();
            (start[9], start[10]) = (-3.7967, -4.0178);
            assert!(cost(problem, &start) < 50.0, "nearly as cheap, though the rest is not adapted");
            let start = Start::LogPhotocurrent(&start);
            let solution =
                solve_from(problem, start, &SolveOptions::default(), &mut workspace).expect("well posed");
            assert_is_optimum(index, problem, given, &solution);
        }
    });
}

#[test]
fn lanes_reach_the_optimum_to_four_digits_or_hand_the_pixel_back() {
    let mut group = LaneGroup::default();
    let mut solved = 0;
    for_each_problem(|index, problem, given| {
        group.solve(&[*problem]);
        if let Some(solution) = group.solution(0) {
            let u: Vec<f64> = solution.log_photocurrent().map(f64::from).collect();
            let relative = cost(problem, &u) / given.cost - 1.0;
            assert!(relative.abs() < 1e-4, "problem {index}: {relative}");
            assert!((f64::from(solution.cost) / given.cost - 1.0).abs() < 1e-3 && solution.iterations > 0);
            solved += 1;
        }
    });
    // Problem 14 lies at a fold.
    assert_eq!(solved, 28);
}

#[test]
fn the_misfit_is_that_of_the_rows_written_down_apart() {
    let (mut workspace, mut group) = (Workspace::default(), LaneGroup::default());
    for_each_problem(|index, problem, _| {
        let check = |u: &[f64], misfit: &crate::residuals::Misfit, tolerance: f64| {
            let mut rows = Vec::new();
            residuals(problem, &problem.front_end, u, &mut rows);
            let (evs, cis) = rows.split_at(problem.t_s.len() - 1);
            let event_square: f64 = evs.iter().map(|row| problem.evs_weight * row * row).sum();
            let frame_square: f64 =
                cis.iter().zip(problem.frames).map(|(row, frame)| frame.weight * row * row).sum();
            assert_eq!((misfit.events, misfit.frames), (evs.len(), cis.len()));
            // Rows that nearly vanish have lost their digits.
            let near = |found: f64, expected: f64| (found - expected).abs() <= tolerance * (expected + 1.0);
            assert!(
                near(misfit.event_square, event_square) && near(misfit.frame_square, frame_square),
                "{index}: {misfit:?} {event_square} {frame_square}"
            );
        };
        let solution = solve(problem, &SolveOptions::default(), &mut workspace).expect("well posed");
        check(solution.log_photocurrent, &solution.misfit, 1e-9);
        group.solve(&[*problem]);
        if let Some(solution) = group.solution(0) {
            let u: Vec<f64> = solution.log_photocurrent().map(f64::from).collect();
            check(&u, &solution.misfit, 2e-3);
        }
    });
}

#[test]
fn a_pixel_does_not_depend_on_its_lane_or_its_neighbours() {
    let mut group = LaneGroup::default();
    let bits = |group: &LaneGroup, n: usize| {
        group.solution(n).map(|solution| solution.log_photocurrent().map(f32::to_bits).collect::<Vec<u32>>())
    };
    for_each_problem(|_, problem, _| {
        group.solve(&[*problem]);
        let alone = bits(&group, 0);
        // Next to shorter pixels, which settle sooner or later, and next to itself.
        let cut = |knots: usize| PixelProblem {
            t_s: &problem.t_s[..knots],
            steps: &problem.steps[..knots],
            ..*problem
        };
        group.solve(&[cut(2), cut(problem.t_s.len() / 2 + 2), *problem, cut(3), *problem]);
        assert!(bits(&group, 2) == alone && bits(&group, 4) == alone);
    });
}

#[test]
fn solutions_have_the_same_bits_on_every_machine() {
    // FNV-1a over the bits of every solution. Changes only with a deliberate change of the arithmetic (then
    // bump the revision of the nodes that solve); never with the build profile, the processor or the vector
    // width.
    let mut workspace = Workspace::default();
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for_each_problem(|_, problem, _| {
        let solution =
            solve(problem, &SolveOptions::default(), &mut workspace).expect("a well-posed problem");
        for u in solution.log_photocurrent {
            hash = (hash ^ u.to_bits()).wrapping_mul(0x0000_0100_0000_01b3);
        }
    });
    assert_eq!(hash, 0x419b_ae8c_cfed_bb94);
}

#[test]
fn the_cost_of_a_given_optimum_is_the_given_cost() {
    for_each_problem(|index, problem, given| {
        let ours = cost(problem, &given.opt_log_i);
        // The file rounds steps to nine digits: up to 5e-10 * 2 * residual / sigma^2 per event.
        assert!((ours / given.cost - 1.0).abs() < 1e-6, "problem {index}: {ours} instead of {}", given.cost);
    });
}

#[test]
fn compensated_steps_are_those_of_the_reference() {
    let mut compared = 0;
    for_each_problem(|index, _, given| {
        let (Some(events), Some(threshold), Some(refractory)) =
            (&given.events_tin_toff_p, given.threshold, given.trp_ms)
        else {
            return;
        };
        let t_in: Vec<f64> = events.iter().map(|event| event[0] * 1e-3).collect();
        let t_off: Vec<f64> = events.iter().map(|event| event[1] * 1e-3).collect();
        let steps: Vec<f64> = events.iter().map(|event| event[2] * threshold).collect();
        for k in 1..steps.len() {
            let step = compensated_step(steps[k], t_in[k - 1], t_off[k - 1], t_in[k], refractory * 1e-3);
            // The file rounds steps to nine digits.
            assert!((step - given.c[k]).abs() < 1e-8, "problem {index}, event {k}: {step} {}", given.c[k]);
            compared += 1;
        }
    });
    assert!(compared > 300);
}
