//! This project's solvers, timed like the peers: processor time of the thread, the fastest of many.

use crate::cases::Case;
use photocurrent_sensor::inverse::{LaneGroup, PixelProblem, SolveOptions, Start, Workspace, solve_from};
use photocurrent_sensor::residuals::cost;
use rustix::time::{ClockId, clock_gettime};

/// One method's answer to one pixel.
#[derive(Clone, Copy)]
pub struct Answer {
    /// Set-up apart from the solve, seconds; zero where there is none apart.
    pub setup_s: f64,
    /// Seconds.
    pub solve_s: f64,
    pub iterations: f64,
    /// Eq. (13), restated by `residuals::cost` whoever found it.
    pub cost: f64,
}

/// How often a solve is repeated at least, and for how long.
#[derive(Clone, Copy)]
pub struct Repeat {
    pub least: usize,
    pub seconds: f64,
}

fn processor_s() -> f64 {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}

/// Seconds of the fastest of many runs.
fn fastest(repeat: Repeat, mut run: impl FnMut()) -> f64 {
    let (begin, mut best) = (processor_s(), f64::INFINITY);
    for n in 0..1000 {
        let from = processor_s();
        if n >= repeat.least && from - begin >= repeat.seconds {
            break;
        }
        run();
        best = best.min(processor_s() - from);
    }
    best
}

/// The scalar solver, from the frames as it ships (its own search for a start included) or from the case's
/// start.
pub fn scalar(cases: &[Case], from_frames: bool, repeat: Repeat) -> Vec<Answer> {
    let mut workspace = Workspace::default();
    let options = SolveOptions::default();
    let answer = |case: &Case| {
        let problem = case.problem();
        let start = if from_frames { Start::FromFrames } else { Start::LogPhotocurrent(&case.start) };
        let solve_s = fastest(repeat, || {
            let solution = solve_from(divan::black_box(&problem), start, &options, &mut workspace);
            divan::black_box(solution.map(|solution| solution.cost).ok());
        });
        let solution =
            solve_from(&problem, start, &options, &mut workspace).expect("the problem is well posed");
        let cost =
            if solution.has_converged() { cost(&problem, solution.log_photocurrent) } else { f64::NAN };
        Answer { setup_s: 0.0, solve_s, iterations: solution.iterations as f64, cost }
    };
    cases.iter().map(answer).collect()
}

/// Up to sixteen pixels at once in single precision, each charged its share; one that is handed back is
/// charged its scalar solve as well.
pub fn lanes(cases: &[Case], together: usize, scalar: &[Answer], repeat: Repeat) -> Vec<Answer> {
    let mut group = LaneGroup::default();
    let mut answers = Vec::new();
    for (cases, scalar) in cases.chunks(together).zip(scalar.chunks(together)) {
        let problems: Vec<PixelProblem<'_>> = cases.iter().map(Case::problem).collect();
        let share_s = fastest(repeat, || group.solve(divan::black_box(&problems))) / problems.len() as f64;
        for (n, problem) in problems.iter().enumerate() {
            answers.push(match group.solution(n).map(|solution| solution.log_photocurrent()) {
                Some(u) => {
                    let u: Vec<f64> = u.map(f64::from).collect();
                    Answer { setup_s: 0.0, solve_s: share_s, iterations: f64::NAN, cost: cost(problem, &u) }
                }
                None => Answer { solve_s: share_s + scalar[n].solve_s, ..scalar[n] },
            });
        }
    }
    answers
}

/// How many pixels the lanes hand back to the scalar solver.
pub fn handed_back(cases: &[Case]) -> usize {
    let mut group = LaneGroup::default();
    let is_handed_back = |case: &&Case| {
        group.solve(&[case.problem()]);
        group.solution(0).is_none()
    };
    cases.iter().filter(is_handed_back).count()
}
