//! Time to solve one pixel, by number of events: divide by N for the time per pixel-event.
//!
//! Run with `cargo bench -p photocurrent-sensor`. Problems are synthetic (steps near +-0.2, three frames over 25 ms),
//! with the seed below; the workspace is warm, as it is for all but the first pixel of a run.

use divan::Bencher;
use divan::counter::ItemsCount;
use photocurrent_sensor::front_end::{FrontEnd, TauRule};
use photocurrent_sensor::inverse::{FrameSample, LaneGroup, PixelProblem, SolveOptions, Workspace, solve};

const SEED: u64 = 20_240_607;

fn main() {
    divan::main();
}

struct Columns {
    t_s: Vec<f64>,
    steps: Vec<f64>,
    frames: Vec<FrameSample>,
}

/// `knots` events at random instants, whose steps bring the pixel back to its level now and then.
fn columns(knots: usize, seed: u64) -> Columns {
    let mut state = seed;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let mut now = 0.0;
    let mut gaps: Vec<f64> = (0..knots).map(|_| 0.3 + uniform()).collect();
    let total: f64 = gaps.iter().sum();
    for gap in &mut gaps {
        *gap *= 25e-3 / total;
    }
    let t_s = gaps.iter().map(|gap| {
        now += gap;
        now
    });
    let t_s = t_s.collect();
    let mut level = 0.0;
    let steps = (0..knots).map(|_| {
        let sign = if level * 0.5 + uniform() - 0.5 > 0.0 { -1.0 } else { 1.0 };
        let step = sign * (0.18 + 0.04 * uniform());
        level += step;
        step
    });
    let steps = steps.collect();
    let frames = (0..3)
        .map(|l| {
            let start_s = 0.5e-3 + 8.33e-3 * l as f64;
            FrameSample { start_s, end_s: start_s + 6.5e-3, dn: 330.0 + 60.0 * uniform(), weight: 0.04 }
        })
        .collect();
    Columns { t_s, steps, frames }
}

impl Columns {
    fn problem(&self, tau_rule: TauRule) -> PixelProblem<'_> {
        PixelProblem {
            t_s: &self.t_s,
            steps: &self.steps,
            frames: &self.frames,
            evs_weight: 2500.0,
            front_end: FrontEnd { tau_0_s: 30e-6, alpha_s: 5e-6 },
            tau_rule,
            black_level: 0.0,
            gain: 153_846.0,
        }
    }
}

fn bench_rule(bencher: Bencher<'_, '_>, knots: usize, tau_rule: TauRule) {
    let columns = columns(knots, SEED);
    let problem = columns.problem(tau_rule);
    let options = SolveOptions::default();
    let mut workspace = Workspace::default();
    let solution = solve(&problem, &options, &mut workspace).expect("the problem is well posed");
    assert!(solution.has_converged(), "a bench of a safe estimate would flatter");
    bencher.counter(ItemsCount::new(knots)).bench_local(|| solve(divan::black_box(&problem), &options, &mut workspace).map(|solution| solution.cost));
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
    let solved = (0..16).filter(|n| group.log_photocurrent(*n).is_some()).count();
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
