//! The solver against Ceres: the same problems from the same start in one run; times, growth with the number
//! of events, and agreement of costs.
//!
//! `cargo bench -p photocurrent-sensor --bench ceres`; needs g++, pkg-config and Debian's libceres-dev (2.1
//! or later), and says so when they are not there. Every time is processor time of one thread, the fastest of
//! many repetitions in warm memory, and then the median over pixels (the mean shows the rare pixel that needs
//! many rounds). Ceres' time is that of its solve alone; building its problem is given apart. Ours contains
//! everything, the search for the start too.
//!
//! Peers: `tiny.cpp` is Ceres' header-only `TinySolver`, built for this processor; `library.cpp` the library
//! with dense normal equations, with dense QR (both over N unknowns with the analytic Jacobian), and sparse
//! over a chain of states (u, V, charge) whose equations are stiff rows.

// Tables are what this bench is for.
#![allow(clippy::print_stdout)]

mod cases;
mod ours;
mod peers;
#[path = "../problems/mod.rs"]
mod problems;

use cases::Case;
use ours::{Answer, Repeat};
use peers::{Peers, Unbuilt};
use photocurrent_sensor::front_end::TauRule;
use std::process::ExitCode;

const SIZES: [usize; 3] = [20, 100, 400];
const PIXELS: u64 = 64;
/// Costs further apart than this, relatively, belong to different minima (or to a search that has not ended).
const OTHER_MINIMUM: f64 = 1e-3;
/// Names and columns of methods, in the order of the tables.
const METHODS: [(&str, &str); 7] = [
    ("lanes", "ours, f32, 16 lanes"),
    ("scalar", "ours, f64"),
    ("given", "ours, f64, start given"),
    ("tiny", "Ceres TinySolver, LLT, native"),
    ("dense", "Ceres dense normal Cholesky"),
    ("qr", "Ceres dense QR"),
    ("chain", "Ceres sparse, chain"),
];

type Answers = Vec<(&'static str, Vec<Answer>)>;

fn main() -> ExitCode {
    // Cargo hands every bench the filter meant for one, and runs benches as tests without `--bench`.
    let filters: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let is_asked = filters.is_empty() || filters.iter().any(|filter| "ceres".contains(filter.as_str()));
    if !std::env::args().any(|word| word == "--bench") || !is_asked {
        return ExitCode::SUCCESS;
    }
    let peers = match Peers::build() {
        Ok(peers) => peers,
        Err(Unbuilt::Missing(what)) => {
            eprintln!(
                "skipped: the comparison with Ceres needs {what}; on Debian: apt-get install g++ \
                       pkg-config libceres-dev"
            );
            return ExitCode::SUCCESS;
        }
        Err(Unbuilt::Failed(what)) => {
            eprintln!("error: {what}");
            return ExitCode::FAILURE;
        }
    };
    match compare(&peers) {
        Ok(()) => ExitCode::SUCCESS,
        Err(what) => {
            eprintln!("error: {what}");
            ExitCode::FAILURE
        }
    }
}

fn compare(peers: &Peers) -> Result<(), String> {
    for (tau_rule, name) in [(TauRule::End, "end"), (TauRule::Start, "start, as printed")] {
        let mut by_size = Vec::new();
        for knots in SIZES {
            let repeat = if knots < 400 {
                Repeat { least: 20, seconds: 0.02 }
            } else {
                Repeat { least: 3, seconds: 0.05 }
            };
            let cases = cases::synthetic(knots, tau_rule, PIXELS);
            println!(
                "time constant at the {name}, N = {knots}: {PIXELS} pixels; lanes hand back {}",
                ours::handed_back(&cases)
            );
            by_size.push(answers(peers, &cases, 16, repeat)?);
        }
        println!("\n## Time constant at the {name}: M = 3, {PIXELS} pixels each\n");
        print_times(&by_size);
        for (knots, answers) in SIZES.iter().zip(&by_size) {
            println!("Costs against ours in f64, N = {knots}:\n");
            print_agreement(answers);
        }
    }
    println!("## The reference problems of data/solver\n");
    let cases = cases::reference();
    println!("lanes hand back {} of {}\n", ours::handed_back(&cases), cases.len());
    print_agreement(&answers(peers, &cases, 1, Repeat { least: 1, seconds: 0.0 })?);
    Ok(())
}

/// `together` pixels share a group of lanes: pixels of one sensor.
fn answers(peers: &Peers, cases: &[Case], together: usize, repeat: Repeat) -> Result<Answers, String> {
    let scalar = ours::scalar(cases, true, repeat);
    let mut answers = vec![
        ("lanes", ours::lanes(cases, together, &scalar, repeat)),
        ("scalar", scalar),
        ("given", ours::scalar(cases, false, repeat)),
    ];
    answers.extend(peers.solve(cases, repeat)?);
    Ok(answers)
}

fn of<'a>(answers: &'a Answers, method: &str) -> &'a [Answer] {
    answers.iter().find(|(name, _)| *name == method).map_or(&[], |(_, answers)| answers)
}

fn mean(answers: &[Answer], quantity: impl Fn(&Answer) -> f64) -> f64 {
    answers.iter().map(quantity).sum::<f64>() / answers.len() as f64
}

fn median(answers: &[Answer], quantity: impl Fn(&Answer) -> f64) -> f64 {
    let mut values: Vec<f64> = answers.iter().map(quantity).collect();
    values.sort_by(f64::total_cmp);
    0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2])
}

fn print_times(by_size: &[Answers]) {
    println!("Microseconds a pixel, median (mean):\n");
    println!(
        "| method | N = 20 | 100 | 400 | growth 100 to 400 | times ours f64 | times ours f32 | set-up \
              apart | steps |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    let solve_s = |answers: &Answers, method: &str| median(of(answers, method), |answer| answer.solve_s);
    for (method, name) in METHODS {
        let cells = |cell: &dyn Fn(&Answers) -> String| by_size.iter().map(cell).collect::<Vec<_>>();
        let times = cells(&|answers| {
            format!(
                "{} ({})",
                digits(1e6 * solve_s(answers, method)),
                digits(1e6 * mean(of(answers, method), |answer| answer.solve_s))
            )
        });
        let growth = solve_s(&by_size[2], method) / solve_s(&by_size[1], method);
        let to_scalar = cells(&|answers| digits(solve_s(answers, method) / solve_s(answers, "scalar")));
        let to_lanes = cells(&|answers| digits(solve_s(answers, method) / solve_s(answers, "lanes")));
        let setup = cells(&|answers| digits(1e6 * median(of(answers, method), |answer| answer.setup_s)));
        let steps = cells(&|answers| {
            format!("{:.0}", median(of(answers, method), |answer| answer.iterations)).replace("NaN", "-")
        });
        let [to_scalar, to_lanes, setup, steps] =
            [to_scalar, to_lanes, setup, steps].map(|cells| cells.join(" / "));
        println!(
            "| {name} | {} | {growth:.1} | {to_scalar} | {to_lanes} | {setup} | {steps} |",
            times.join(" | ")
        );
    }
    println!();
}

/// Three digits, or whole above a hundred; a dash where nothing is apart.
fn digits(value: f64) -> String {
    match value {
        0.0 => "-".to_string(),
        value if value < 10.0 => format!("{value:.2}"),
        value if value < 100.0 => format!("{value:.1}"),
        value => format!("{value:.0}"),
    }
}

/// For each method, how far its costs lie from the scalar solver's.
fn print_agreement(answers: &Answers) {
    println!(
        "| method | same minimum | largest relative difference there | another, cheaper | another, \
              dearer | not converged |"
    );
    println!("| --- | --- | --- | --- | --- | --- |");
    for (method, name) in METHODS.into_iter().filter(|(method, _)| *method != "scalar") {
        let relative = of(answers, method)
            .iter()
            .zip(of(answers, "scalar"))
            .map(|(theirs, ours)| theirs.cost / ours.cost - 1.0);
        let (mut same, mut worst, mut cheaper, mut dearer, mut open) = (0, 0.0, 0, 0, 0);
        for relative in relative {
            if relative.is_nan() {
                open += 1;
            } else if relative < -OTHER_MINIMUM {
                cheaper += 1;
            } else if relative > OTHER_MINIMUM {
                dearer += 1;
            } else {
                same += 1;
                worst = if relative.abs() > worst { relative.abs() } else { worst };
            }
        }
        println!("| {name} | {same} | {worst:.0e} | {cheaper} | {dearer} | {open} |");
    }
    println!();
}
