//! Time to solve one pixel, by number of events: divide by N for the time per pixel-event.
//!
//! Run with `cargo bench -p photocurrent-sensor --bench inverse`. Problems are those of `problems`; the
//! workspace is warm, as it is for all but the first pixel of a run.

use divan::Bencher;
use divan::counter::ItemsCount;
use photocurrent_sensor::front_end::TauRule;
use photocurrent_sensor::inverse::{LaneGroup, PixelProblem, SolveOptions, Workspace, solve};
use problems::{Columns, SEED, columns};

mod problems;

fn main() {
    divan::main();
}

fn bench_rule(bencher: Bencher<'_, '_>, knots: usize, tau_rule: TauRule) {
    let columns = columns(knots, SEED);
    let problem = columns.problem(tau_rule);
    let options = SolveOptions::default();
    let mut workspace = Workspace::default();
    let solution = solve(&problem, &options, &mut workspace).expect("the problem is well posed");
    assert!(solution.has_converged(), "a bench of a double-integral estimate would flatter");
    bencher.counter(ItemsCount::new(knots)).bench_local(|| {
        solve(divan::black_box(&problem), &options, &mut workspace).map(|solution| solution.cost)
    });
}

#[divan::bench(args = [20, 100, 400])]
fn solve_tau_end(bencher: Bencher<'_, '_>, knots: usize) {
    bench_rule(bencher, knots, TauRule::End);
}

#[divan::bench(args = [20, 100, 400])]
fn solve_tau_start(bencher: Bencher<'_, '_>, knots: usize) {
    bench_rule(bencher, knots, TauRule::Start);
}

/// Sixteen pixels, one per lane; divide by 16 N for the time per pixel-event.
fn bench_lanes(bencher: Bencher<'_, '_>, knots: usize, tau_rule: TauRule) {
    let columns: Vec<Columns> = (0..16).map(|n| columns(knots, SEED + n)).collect();
    let problems: Vec<PixelProblem<'_>> = columns.iter().map(|columns| columns.problem(tau_rule)).collect();
    let mut group = LaneGroup::default();
    group.solve(&problems);
    let solved = (0..16).filter(|n| group.solution(*n).is_some()).count();
    assert!(solved >= 15, "a bench of pixels handed back would flatter: {solved}");
    bencher.counter(ItemsCount::new(16 * knots)).bench_local(|| group.solve(divan::black_box(&problems)));
}

#[divan::bench(args = [20, 100, 400])]
fn lanes_tau_end(bencher: Bencher<'_, '_>, knots: usize) {
    bench_lanes(bencher, knots, TauRule::End);
}

#[divan::bench(args = [20, 100, 400])]
fn lanes_tau_start(bencher: Bencher<'_, '_>, knots: usize) {
    bench_lanes(bencher, knots, TauRule::Start);
}
