//! Time of the MAP estimate of pixels, one after the other and eight at a time, and to choose the noise and
//! the prior of a row, per event.
//!
//! Run with `cargo bench -p photocurrent-sensor --bench map`. Pixels come from the forward model with the
//! values of `data/sensors/hybrid.toml` and its noise: 250 ms, 30 frames at 120 fps of 6.5 ms. Three kinds of
//! light: edges (quiet between them), texture (never still), and a pixel that sees a single edge. Knots per
//! event are printed first.

use divan::Bencher;
use divan::counter::ItemsCount;
use photocurrent_core::Exposure;
use photocurrent_core::sensor::Reset;
use photocurrent_sensor::effects::Site;
use photocurrent_sensor::forward::{Chain, LOG_STEP, LinearLight, Pixel, PixelNoise, simulate};
use photocurrent_sensor::front_end::FrontEnd;
use photocurrent_sensor::map::estimate::Choosing;
use photocurrent_sensor::map::{
    MapFrame, MapGroup, MapOptions, MapProblem, MapSensor, MapStatus, MapTask, PixelEvent, SecondStart,
    estimate, solve,
};

const SPAN_NS: i64 = 250_000_000;
const STEP_NS: i64 = 50_000;
const PIXELS: u64 = 16;
const FRONT_END: FrontEnd = FrontEnd { tau_0_s: 20e-6, alpha_s: 12e-3 };
const THRESHOLD_ON: f64 = 0.20;
const THRESHOLD_OFF: f64 = 0.21;
const THRESHOLD_NOISE: f64 = 0.01;
const REFRACTORY_NS: i64 = 50_000;
const GAIN: f64 = 850.0;
const READ_NOISE_DN: f64 = 0.3;
const DN_PER_ELECTRON: f64 = 1023.0 / 10_000.0;
const KINDS: [&str; 3] = ["edges", "texture", "sparse"];

/// As many steps as `solve/pixel` takes at most.
fn five_steps() -> MapOptions {
    MapOptions { max_iterations: 5, ..MapOptions::default() }
}

fn main() {
    for kind in KINDS {
        let pixels = pixels(kind);
        let (mut knots, mut steps, mut events) = (0, 0, 0);
        let mut group = MapGroup::default();
        for pixel in &pixels {
            let solution = solve(&pixel.problem(), &five_steps(), &mut group);
            assert!(
                solution.outcome.status != MapStatus::Failed,
                "a bench of double-integral estimates would flatter"
            );
            knots += solution.t_ns.len();
            steps += solution.outcome.iterations * solution.t_ns.len();
            events += pixel.events.len();
        }
        eprintln!(
            "{kind}: {events} events, {knots} knots, {steps} knots x steps: {:.2} knots per event",
            knots as f64 / events as f64
        );
    }
    divan::main();
}

/// Numbers of [0, 1) from a fixed stream.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Mean 0, standard deviation 1: twelve uniform numbers.
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.next()).sum::<f64>() - 6.0
    }
}

impl PixelNoise for Random {
    fn uniform(&mut self) -> f64 {
        self.next()
    }

    fn threshold_offset(&mut self) -> f64 {
        THRESHOLD_NOISE * self.normal()
    }
}

struct Recorded {
    events: Vec<PixelEvent>,
    frames: Vec<MapFrame>,
}

/// Log light of pixel `n` at `t_s`.
fn log_light(kind: &str, n: u64, t_s: f64) -> f64 {
    let phase = n as f64 * 0.7;
    match kind {
        // Up and down once in 30 ms, each within about a millisecond.
        "edges" => 4.1 + 0.75 * libm::tanh(9.0 * libm::sin(209.4 * t_s + phase)),
        "texture" => {
            4.1 + 0.4 * libm::sin(300.0 * t_s + phase)
                + 0.3 * libm::sin(780.0 * t_s + 1.3 * phase)
                + 0.2 * libm::sin(1260.0 * t_s + 1.7 * phase)
        }
        _ => 4.0 + 0.6 * libm::tanh((t_s - 0.1 - 0.003 * phase) / 1e-3),
    }
}

fn pixels(kind: &str) -> Vec<Recorded> {
    let pixel = Pixel {
        front_end: FRONT_END,
        threshold_on: THRESHOLD_ON,
        threshold_off: THRESHOLD_OFF,
        latency_ns: 1_000,
        latency_spread_ns: 0.0,
        refractory_ns: REFRACTORY_NS,
        log_step: LOG_STEP,
    };
    let t_ns: Vec<i64> = (0..=SPAN_NS / STEP_NS).map(|k| k * STEP_NS).collect();
    let recorded = |n| {
        let current: Vec<f64> =
            t_ns.iter().map(|&t| libm::exp(log_light(kind, n, t as f64 * 1e-9))).collect();
        let light = LinearLight::new(&t_ns, &current);
        let mut noise = Random(n + 20_240_607);
        let site = Site { x: n as u32, y: 0, width: PIXELS as u32, height: 1, seed: 0 };
        let fired = simulate(
            &Chain {
                pixel,
                reset: Reset::Resample,
                effects: &[],
                tolerance: photocurrent_sensor::forward::TOLERANCE,
            },
            &site,
            &light,
            0,
            SPAN_NS,
            &mut noise,
        );
        let events = fired.iter().map(|fired| fired.event).collect();
        let frames = (0..30).map(|l| {
            let (start_ns, end_ns) = (l * 8_333_333, l * 8_333_333 + 6_500_000);
            let clean = GAIN * light.integral(Exposure::new(start_ns, end_ns));
            let sigma = |dn: f64| libm::sqrt(READ_NOISE_DN * READ_NOISE_DN + DN_PER_ELECTRON * dn);
            let dn = libm::round(clean + sigma(clean) * noise.normal());
            MapFrame {
                start_ns,
                end_ns,
                dn,
                sigma_dn: libm::sqrt(1.0 + sigma(dn) * sigma(dn)),
                saturated: dn >= 1023.0,
            }
        });
        Recorded { frames: frames.collect(), events }
    };
    (0..PIXELS).map(recorded).collect()
}

impl Recorded {
    fn problem(&self) -> MapProblem<'_> {
        let sensor = MapSensor {
            front_end: FRONT_END,
            threshold_on: THRESHOLD_ON,
            threshold_off: THRESHOLD_OFF,
            reset: Reset::Resample,
            refractory_ns: REFRACTORY_NS,
            gain: GAIN,
            black_level_dn: 0.0,
            saturation_dn: f64::INFINITY,
        };
        let (events, frames) = (&self.events, &self.frames);
        MapProblem { no_event_sigma: 0.03, ..MapProblem::new(sensor, events, frames, (0, SPAN_NS)) }
    }
}

fn events(pixels: &[Recorded]) -> ItemsCount {
    ItemsCount::new(pixels.iter().map(|pixel| pixel.events.len()).sum::<usize>())
}

#[divan::bench(args = KINDS)]
fn events_solved(bencher: Bencher<'_, '_>, kind: &str) {
    let pixels = pixels(kind);
    let problems: Vec<MapProblem<'_>> = pixels.iter().map(Recorded::problem).collect();
    let (mut group, options) = (MapGroup::default(), five_steps());
    bencher.counter(events(&pixels)).bench_local(|| {
        problems.iter().map(|problem| solve(problem, &options, &mut group).outcome.log_evidence).sum::<f64>()
    });
}

/// The same, eight pixels at a time.
#[divan::bench(args = KINDS)]
fn events_solved_in_groups(bencher: Bencher<'_, '_>, kind: &str) {
    solve_in_groups(bencher, kind, five_steps());
}

/// The same with the standard deviation of the light at every knot, as `solve/map` asks for it unless it is
/// switched off.
#[divan::bench(args = KINDS)]
fn events_solved_in_groups_with_sigma(bencher: Bencher<'_, '_>, kind: &str) {
    solve_in_groups(bencher, kind, MapOptions { with_sigma: true, ..five_steps() });
}

/// The same as `solve/map` has it where second starts are rarely kept, as on these pixels.
#[divan::bench(args = KINDS)]
fn events_solved_in_groups_with_sigma_seldom_again(bencher: Bencher<'_, '_>, kind: &str) {
    let second = Some(SecondStart { least_misfit: 0.5, ..SecondStart::USUAL });
    solve_in_groups(bencher, kind, MapOptions { with_sigma: true, second, ..five_steps() });
}

fn solve_in_groups(bencher: Bencher<'_, '_>, kind: &str, options: MapOptions) {
    let pixels = pixels(kind);
    let tasks: Vec<MapTask<'_>> =
        pixels.iter().map(|pixel| MapTask { problem: pixel.problem(), options }).collect();
    let mut group = MapGroup::default();
    bencher.counter(events(&pixels)).bench_local(|| {
        let mut sum = 0.0;
        group.solve(&tasks, |_, solution| sum += solution.outcome.log_evidence);
        sum
    });
}

#[divan::bench(args = KINDS)]
fn knots_solved(bencher: Bencher<'_, '_>, kind: &str) {
    let pixels = pixels(kind);
    let problems: Vec<MapProblem<'_>> = pixels.iter().map(Recorded::problem).collect();
    let (mut group, options) = (MapGroup::default(), five_steps());
    let knots: usize = problems.iter().map(|problem| solve(problem, &options, &mut group).t_ns.len()).sum();
    bencher.counter(ItemsCount::new(knots)).bench_local(|| {
        problems.iter().map(|problem| solve(problem, &options, &mut group).outcome.log_evidence).sum::<f64>()
    });
}

/// Noise and prior of a row from sixteen pixels: divide by the width of a row over sixteen for the share of a
/// pixel.
#[divan::bench(args = KINDS)]
fn events_chosen(bencher: Bencher<'_, '_>, kind: &str) {
    let pixels = pixels(kind);
    let problems: Vec<MapProblem<'_>> = pixels.iter().map(Recorded::problem).collect();
    let (mut group, options) = (MapGroup::default(), five_steps());
    bencher
        .counter(events(&pixels))
        .bench_local(|| estimate::choose(&problems, None, &Choosing::USUAL, &options, &mut group));
}
