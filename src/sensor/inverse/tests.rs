//! The solver against algebra, limits and symmetries; the reference problems are in `reference_tests`.

use super::candidate::Held;
use super::stage::Chart;
use super::*;
use crate::front_end::{FrontEnd, TauRule};
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;

const INDOOR: FrontEnd = FrontEnd { tau_0_s: 30e-6, alpha_s: 1e-4 };
const RULES: [TauRule; 2] = [TauRule::Start, TauRule::End];

const T_S: [f64; 6] = [0.0, 6e-4, 2e-3, 4.1e-3, 4.9e-3, 6.4e-3];
const STEPS: [f64; 6] = [0.0, 0.2, -0.25, 0.2, 0.3, -0.2];
const FRAMES: [FrameSample; 2] = [
    FrameSample { start_s: -1e-3, end_s: 3e-3, dn: 240.0, weight: 0.04 },
    FrameSample { start_s: 3.5e-3, end_s: 7e-3, dn: 250.0, weight: 0.04 },
];

/// A well-behaved indoor pixel: every fall is within reach.
pub(super) fn problem() -> PixelProblem<'static> {
    PixelProblem {
        t_s: &T_S,
        steps: &STEPS,
        frames: &FRAMES,
        evs_weight: 2500.0,
        front_end: INDOOR,
        tau_rule: TauRule::End,
        black_level: 16.0,
        gain: 1.5e5,
    }
}

/// The same with one fall far beyond what the low-pass can make in its interval.
fn folded_problem() -> PixelProblem<'static> {
    PixelProblem { steps: &[0.0, 0.2, -0.25, 0.2, -2.5, -0.2], ..problem() }
}

struct Owned {
    u: Vec<f64>,
    cost: f64,
    outcome: Outcome,
}

fn solved(problem: &PixelProblem<'_>) -> Owned {
    let mut workspace = Workspace::default();
    let solution = solve(problem, &SolveOptions::default(), &mut workspace).expect("well posed");
    Owned { u: solution.log_photocurrent.to_vec(), cost: solution.cost, outcome: solution.outcome }
}

/// A candidate with its linearisation: the measured steps from level -1, moved off a fold so that both sides
/// exist.
fn linearised(problem: &PixelProblem<'_>) -> (Overlap, Candidate, Linearised) {
    let (mut overlap, mut at, mut linear) = (Overlap::default(), Candidate::default(), Linearised::default());
    overlap.fill(problem);
    assert!(at.set_measured_steps(problem, &overlap, -1.0));
    linear.fill(problem, &overlap, &at);
    if linear.has_fold() {
        let lifted: Vec<f64> = at
            .log_photocurrent
            .iter()
            .zip(linear.charts())
            .map(|(u, chart)| if chart == Chart::Step { *u } else { u + 0.05 })
            .collect();
        assert!(at.set_log_photocurrent(problem, &overlap, lifted.into_iter()));
        linear.fill(problem, &overlap, &at);
    }
    (overlap, at, linear)
}

/// `at` with unknown `k` moved by `change`.
fn moved(
    problem: &PixelProblem<'_>,
    overlap: &Overlap,
    at: &Candidate,
    linear: &Linearised,
    k: usize,
    change: f64,
) -> Candidate {
    let mut changes = vec![0.0; at.step.len()];
    changes[k] = change;
    let mut trial = Candidate::default();
    assert!(trial.set_moved(problem, overlap, at, &linear.stages, &changes, Held::Stay));
    trial
}

#[test]
fn gradients_of_the_digital_numbers_match_central_differences() {
    for tau_rule in RULES {
        for problem in [problem(), folded_problem()] {
            let problem = PixelProblem { tau_rule, ..problem };
            let (overlap, at, linear) = linearised(&problem);
            let knots = problem.t_s.len();
            for k in 0..knots {
                let h = 1e-5;
                let above = moved(&problem, &overlap, &at, &linear, k, h);
                let below = moved(&problem, &overlap, &at, &linear, k, -h);
                for l in 0..problem.frames.len() {
                    let numeric = (above.dn[l] - below.dn[l]) / (2.0 * h);
                    let ours = linear.dn_gradients[l * knots + k];
                    let message = format!("{tau_rule:?}, knot {k}, frame {l}: {ours} against {numeric}");
                    assert!((ours - numeric).abs() < 1e-5 * (1.0 + ours.abs()), "{message}");
                }
            }
        }
    }
}

#[test]
fn the_gradient_of_the_evs_rows_matches_central_differences() {
    for problem in [problem(), folded_problem()] {
        let (overlap, at, linear) = linearised(&problem);
        let evs_cost = |candidate: &Candidate| -> f64 {
            let rows = candidate.step.iter().zip(problem.steps).skip(1);
            rows.map(|(step, measured)| problem.evs_weight * (measured - step) * (measured - step)).sum()
        };
        for k in 0..problem.t_s.len() {
            let h = 1e-5;
            let above = evs_cost(&moved(&problem, &overlap, &at, &linear, k, h));
            let below = evs_cost(&moved(&problem, &overlap, &at, &linear, k, -h));
            let numeric = (above - below) / (4.0 * h); // the gradient is that of half the cost
            assert!((linear.evs_gradient[k] - numeric).abs() < 1e-3 * (1.0 + numeric.abs()));
        }
    }
}

#[test]
fn only_an_impossible_fall_changes_the_unknown() {
    let charts = |problem| linearised(&problem).2.charts().collect::<Vec<_>>();
    assert!(charts(problem()).iter().all(|&chart| chart == Chart::Step));
    let folded = charts(folded_problem());
    assert_eq!(folded.iter().filter(|&&chart| chart == Chart::LogPhotocurrent).count(), 1);
    assert_eq!(folded[4], Chart::LogPhotocurrent);
}

#[test]
fn the_small_system_gives_the_step_of_the_dense_one() {
    for damping in [0.0, 0.3] {
        let problem = problem();
        let (_, at, linear) = linearised(&problem);
        let knots = problem.t_s.len();
        // Half the gradient and Hessian of the cost in the unknowns, written out.
        let mut hessian = DMatrix::<f64>::zeros(knots, knots);
        let mut gradient = DVector::<f64>::zeros(knots);
        for k in 1..knots {
            hessian[(k, k)] = problem.evs_weight * (1.0 + damping);
            gradient[k] = problem.evs_weight * (at.step[k] - problem.steps[k]);
        }
        for (l, frame) in problem.frames.iter().enumerate() {
            let row = DVector::from_row_slice(&linear.dn_gradients[l * knots..(l + 1) * knots]);
            hessian += frame.weight * &row * row.transpose();
            gradient += frame.weight * (at.dn[l] - frame.dn) * &row;
        }
        // The level is damped by its curvature with everything else minimised over: its Schur complement.
        let rest = hessian.view((1, 1), (knots - 1, knots - 1)).into_owned();
        let coupling = hessian.view((1, 0), (knots - 1, 1)).into_owned();
        let solved_coupling = rest.cholesky().expect("positive definite").solve(&coupling);
        let schur = hessian[(0, 0)] - coupling.dot(&solved_coupling);
        hessian[(0, 0)] += damping * schur;
        let dense = hessian.cholesky().expect("positive definite").solve(&-gradient);
        let mut newton = NewtonStep::default();
        assert!(newton.compute(&problem, &linear, &at.dn, damping));
        for k in 0..knots {
            assert!((newton.change[k] - dense[k]).abs() < 1e-10, "{} against {}", newton.change[k], dense[k]);
        }
    }
}

#[test]
fn an_ideal_front_end_with_one_frame_is_the_event_based_double_integral() {
    // Blurred B = DN / (G T); sharp L(start) = B * T / S with S the integral of exp(c a(t)), a(t) the events
    // so far.
    let (start_s, end_s, dn, c) = (1e-3, 9e-3, 777.0, 0.21);
    let t_s = [start_s, 2e-3, 2.5e-3, 6e-3, 8.1e-3];
    let frames = [FrameSample { start_s, end_s, dn, weight: 0.3 }];
    let steps = [0.0, c, c, -c, c];
    for tau_rule in RULES {
        let ideal = PixelProblem {
            t_s: &t_s,
            steps: &steps,
            frames: &frames,
            black_level: 0.0,
            front_end: FrontEnd::IDEAL,
            tau_rule,
            ..problem()
        };
        let a = [0.0, 1.0, 2.0, 1.0, 2.0];
        let hold_s = [1e-3, 0.5e-3, 3.5e-3, 2.1e-3, 0.9e-3];
        let sum: f64 = a.iter().zip(hold_s).map(|(a, hold)| libm::exp(c * a) * hold).sum();
        let blurred = dn / (ideal.gain * (end_s - start_s));
        let solution = solved(&ideal);
        assert_eq!(solution.outcome, Outcome::Converged);
        for (u, a) in solution.u.iter().zip(a) {
            let sharp = blurred * (end_s - start_s) * libm::exp(c * a) / sum;
            assert!((libm::exp(*u) / sharp - 1.0).abs() < 1e-9);
        }
        assert!(solution.cost < 1e-15);
    }
}

#[test]
fn a_vanishing_time_constant_approaches_the_ideal_front_end() {
    let ideal = solved(&PixelProblem { front_end: FrontEnd::IDEAL, ..problem() });
    for tau_rule in RULES {
        let fast = FrontEnd { tau_0_s: 1e-6, alpha_s: 1e-6 };
        let nearly = solved(&PixelProblem { front_end: fast, tau_rule, ..problem() });
        for (a, b) in ideal.u.iter().zip(&nearly.u) {
            assert!((a - b).abs() < 1e-12, "the shortest interval is 60 time constants");
        }
    }
}

#[test]
fn shifting_time_changes_nothing() {
    let here = solved(&problem());
    let t_s = T_S.map(|t| t + 2.0);
    let frames =
        FRAMES.map(|frame| FrameSample { start_s: frame.start_s + 2.0, end_s: frame.end_s + 2.0, ..frame });
    let there = solved(&PixelProblem { t_s: &t_s, frames: &frames, ..problem() });
    for (a, b) in here.u.iter().zip(&there.u) {
        assert!((a - b).abs() < 1e-9); // f64 seconds near 2 resolve 2e-16 s of 6e-4 s
    }
}

#[test]
fn brighter_light_with_a_scaled_front_end_is_the_same_picture() {
    // Doubling gain^-1, alpha and photocurrent together leaves tau = alpha / i and every DN alone.
    let here = solved(&problem());
    let front_end = FrontEnd { alpha_s: 2.0 * INDOOR.alpha_s, ..INDOOR };
    let there = solved(&PixelProblem { front_end, gain: problem().gain / 2.0, ..problem() });
    for (a, b) in here.u.iter().zip(&there.u) {
        assert!((a + std::f64::consts::LN_2 - b).abs() < 1e-8);
    }
}

#[test]
fn swapping_polarity_mirrors_an_ideal_pixel_about_its_level() {
    let one_frame = [FrameSample { start_s: -1e-3, end_s: 0.5e-3, dn: 120.0, weight: 1.0 }];
    let mirrored_steps = STEPS.map(|step| -step);
    let here = PixelProblem { frames: &one_frame, front_end: FrontEnd::IDEAL, ..problem() };
    let mirrored = solved(&PixelProblem { steps: &mirrored_steps, ..here });
    let here = solved(&here);
    for (a, b) in here.u.iter().zip(&mirrored.u) {
        assert!((a + b - 2.0 * here.u[0]).abs() < 1e-9);
    }
}

#[test]
fn a_pixel_without_events_is_constant() {
    for t_s in [&[] as &[f64], &[1e-3]] {
        let steps = vec![0.0; t_s.len()];
        let solution = solved(&PixelProblem { t_s, steps: &steps, ..problem() });
        assert_eq!(solution.outcome, Outcome::Converged);
        // One unknown i: sum w a (DN - b) / sum w a^2, with a = G T.
        let (mut along, mut square) = (0.0, 0.0);
        for frame in FRAMES {
            let a = 1.5e5 * (frame.end_s - frame.start_s);
            along += a * (frame.dn - 16.0);
            square += a * a;
        }
        assert_eq!(solution.u.len(), 1);
        assert!((libm::exp(solution.u[0]) / (along / square) - 1.0).abs() < 1e-12);
    }
}

#[test]
fn a_pixel_at_black_is_a_marked_fall_back() {
    let frames = FRAMES.map(|frame| FrameSample { dn: 15.0, ..frame });
    let solution = solved(&PixelProblem { frames: &frames, ..problem() });
    assert_eq!(solution.outcome, Outcome::FellBack);
    assert!(solution.u.iter().all(|&u| u == LOG_PHOTOCURRENT_MIN));
}

#[test]
fn a_pixel_out_of_iterations_is_the_ideal_front_ends_estimate() {
    let mut workspace = Workspace::default();
    let options = SolveOptions { max_iterations: 1, step_tolerance: 1e-8 };
    let solution = solve(&problem(), &options, &mut workspace).expect("well posed");
    assert!(!solution.has_converged());
    for k in 1..STEPS.len() {
        let step = solution.log_photocurrent[k] - solution.log_photocurrent[k - 1];
        assert!((step - STEPS[k]).abs() < 1e-14);
    }
    assert_eq!(solution.log_photocurrent, solution.front_end_voltage);
}

#[test]
fn a_long_run_of_one_polarity_does_not_overflow() {
    let t_s: Vec<f64> = (0..3000).map(|k| 1e-5 * k as f64).collect();
    let frames = [FrameSample { start_s: 0.0, end_s: 3e-2, dn: 900.0, weight: 1.0 }];
    for step in [1.0, -1.0] {
        let steps = vec![step; t_s.len()];
        let solution = solved(&PixelProblem { t_s: &t_s, steps: &steps, frames: &frames, ..problem() });
        assert!(solution.u.iter().all(|u| u.is_finite()) && solution.cost.is_finite());
    }
}

#[test]
fn a_workspace_remembers_nothing() {
    let mut workspace = Workspace::default();
    let options = SolveOptions::default();
    let one = [FRAMES[0]];
    let small = PixelProblem { t_s: &T_S[..3], steps: &STEPS[..3], frames: &one, ..problem() };
    let fresh = solved(&small);
    solve(&folded_problem(), &options, &mut workspace).expect("well posed");
    let reused = solve(&small, &options, &mut workspace).expect("well posed");
    assert_eq!(fresh.u, reused.log_photocurrent);
}

#[test]
fn ill_posed_problems_are_refused_with_the_place() {
    let refused = |problem: PixelProblem<'_>| problem.check().expect_err("ill posed");
    assert_eq!(refused(PixelProblem { frames: &[], ..problem() }), ProblemError::NoFrames);
    assert_eq!(
        refused(PixelProblem { t_s: &T_S[..2], ..problem() }),
        ProblemError::LengthMismatch { knots: 2, steps: 6 }
    );
    let nan = [0.0, 0.2, f64::NAN, 0.1, 0.1, 0.1];
    assert_eq!(
        refused(PixelProblem { steps: &nan, ..problem() }),
        ProblemError::NonFinite { quantity: "steps", index: 2 }
    );
    let equal = [0.0, 1e-3, 1e-3, 2e-3, 3e-3, 4e-3];
    assert_eq!(
        refused(PixelProblem { t_s: &equal, ..problem() }),
        ProblemError::KnotsNotIncreasing { index: 2 }
    );
    let backwards = [FRAMES[0], FrameSample { end_s: 0.0, ..FRAMES[1] }];
    assert_eq!(
        refused(PixelProblem { frames: &backwards, ..problem() }),
        ProblemError::EmptyExposure { index: 1 }
    );
    let weightless = [FrameSample { weight: 0.0, ..FRAMES[0] }];
    let error = refused(PixelProblem { frames: &weightless, ..problem() });
    assert_eq!(
        error.to_string(),
        "frames.weight[0] is 0, which is out of range; leave an untrusted frame out instead"
    );
}

proptest! {
    #[test]
    fn any_pixel_gives_finite_numbers(
        gaps in prop::collection::vec(1e-6_f64..3e-3, 1..30),
        signs in prop::collection::vec(-4.2_f64..4.2, 30),
        dn in prop::collection::vec(-50.0_f64..1000.0, 1..4),
        alpha_s in prop::sample::select(vec![0.0, 1e-5, 1e-4, 1e-3]),
        tau_rule in prop::sample::select(vec![TauRule::Start, TauRule::End]),
    ) {
        let mut now = 0.0;
        let t_s: Vec<f64> = gaps.iter().map(|gap| { now += gap; now }).collect();
        let frames: Vec<FrameSample> = dn.iter().enumerate().map(|(l, &dn)| {
            let start_s = 8e-3 * l as f64;
            FrameSample { start_s, end_s: start_s + 6e-3, dn, weight: 0.04 }
        }).collect();
        let front_end = FrontEnd { tau_0_s: 0.0, alpha_s };
        let steps = &signs[..t_s.len()];
        let pixel = PixelProblem { t_s: &t_s, steps, frames: &frames, front_end, tau_rule, ..problem() };
        let mut workspace = Workspace::default();
        let solution = solve(&pixel, &SolveOptions::default(), &mut workspace).expect("well posed");
        prop_assert!(solution.log_photocurrent.iter().all(|u| u.abs() <= 40.0));
        prop_assert!(solution.front_end_voltage.iter().all(|v| v.is_finite()));
        prop_assert!(solution.cost.is_finite());
        if solution.has_converged() && t_s.len() > 1 {
            let restated = crate::residuals::cost(&pixel, solution.log_photocurrent);
            prop_assert!((restated - solution.cost).abs() <= 1e-9 * (1.0 + solution.cost));
        }
    }
}
