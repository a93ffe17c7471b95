//! Time to simulate pixels: without effects by kind of light and on one core and two, and with one effect at
//! a time.
//!
//! Run with `cargo bench -p photocurrent-sensor --bench forward`. The light is synthetic and lasts 50 ms, in
//! two kinds: as a video gives it, three sines sampled every 20 us (2,500 pixel-steps and about 40 events a
//! pixel), and as a scene of moving edges gives it, with instants only at the ends of edges (about 130 events
//! a pixel). Front ends without a closed form choose their own steps; their items are counted alike, so that
//! times compare.

use divan::Bencher;
use divan::counter::ItemsCount;
use photocurrent_core::sensor::Reset;
use photocurrent_sensor::effects::{Effect, Site, from_description};
use photocurrent_sensor::forward::{Chain, LOG_STEP, LinearLight, Noiseless, Pixel, simulate};
use photocurrent_sensor::front_end::FrontEnd;
use serde_json::Value;

const SPAN_NS: i64 = 50_000_000;
const VIDEO_STEP_NS: i64 = 20_000;
/// Pixels simulated per thread.
const PIXELS: usize = 50;
const SITE: Site = Site { x: 3, y: 5, width: 64, height: 48, seed: 20_240_607 };

fn main() {
    divan::main();
}

struct Samples {
    t_ns: Vec<i64>,
    photocurrent: Vec<f64>,
}

/// Three sines with 0.9 of a log unit in all: about 40 events in 50 ms.
fn log_light(t_ns: i64) -> f64 {
    let t = t_ns as f64 / 1e9;
    0.4 * libm::sin(500.0 * t) + 0.3 * libm::sin(1300.0 * t + 1.0) + 0.2 * libm::sin(2100.0 * t + 2.0)
}

/// Sampled every 20 us.
fn video() -> Samples {
    let t_ns: Vec<i64> = (0..=SPAN_NS / VIDEO_STEP_NS).map(|n| n * VIDEO_STEP_NS).collect();
    let photocurrent = t_ns.iter().map(|&t| libm::exp(log_light(t))).collect();
    Samples { t_ns, photocurrent }
}

/// What edges of a moving pattern make of a pixel: every 2.5 ms light goes from 0.2 to 1 or back within 1 ms,
/// in a straight line, and stays.
fn edges() -> Samples {
    let instants = (0..20_i64).flat_map(|edge| [edge * 2_500_000, edge * 2_500_000 + 1_000_000]);
    let levels = (0..20).flat_map(|edge| if edge % 2 == 0 { [0.2, 1.0] } else { [1.0, 0.2] });
    Samples { t_ns: instants.collect(), photocurrent: levels.collect() }
}

fn still() -> Samples {
    Samples { photocurrent: vec![0.4; 2501], ..video() }
}

fn pixel() -> Pixel {
    let front_end = FrontEnd { tau_0_s: 30e-6, alpha_s: 100e-6 };
    Pixel {
        front_end,
        threshold_on: 0.2,
        threshold_off: 0.2,
        latency_ns: 5_000,
        latency_spread_ns: 0.0,
        refractory_ns: 50_000,
        log_step: LOG_STEP,
    }
}

fn effects(text: &str) -> Vec<Box<dyn Effect>> {
    let described: Value = serde_json::from_str(text).expect("the description is JSON");
    from_description(&serde_json::from_value(described).expect("a table of tables"))
        .expect("the description is right")
}

fn run(samples: &Samples, effects: &[Box<dyn Effect>]) -> usize {
    let chain = Chain {
        pixel: pixel(),
        reset: Reset::Resample,
        effects,
        tolerance: photocurrent_sensor::forward::TOLERANCE,
    };
    simulate(
        &chain,
        &SITE,
        &LinearLight::new(&samples.t_ns, &samples.photocurrent),
        0,
        SPAN_NS,
        &mut Noiseless,
    )
    .len()
}

/// A block of pixels on each of some threads; gives the events of one.
fn run_on(threads: usize, samples: &Samples) -> usize {
    std::thread::scope(|scope| {
        let block = || (0..PIXELS).map(|_| run(divan::black_box(samples), &[])).sum();
        let others: Vec<_> = (1..threads).map(|_| scope.spawn(block)).collect();
        let own: usize = block();
        own + others.into_iter().map(|other| other.join().unwrap_or(0)).sum::<usize>()
    })
}

#[divan::bench(args = [1, 2])]
fn steps_of_video(bencher: Bencher, threads: usize) {
    let samples = video();
    bencher
        .counter(ItemsCount::new(threads * PIXELS * samples.t_ns.len()))
        .bench(|| run_on(threads, &samples));
}

#[divan::bench(args = [1, 2])]
fn events_of_video(bencher: Bencher, threads: usize) {
    let samples = video();
    bencher.counter(ItemsCount::new(run_on(threads, &samples))).bench(|| run_on(threads, &samples));
}

#[divan::bench(args = [1, 2])]
fn events_of_edges(bencher: Bencher, threads: usize) {
    let samples = edges();
    bencher.counter(ItemsCount::new(run_on(threads, &samples))).bench(|| run_on(threads, &samples));
}

#[divan::bench]
fn steps_of_still_video(bencher: Bencher) {
    let samples = still();
    bencher.counter(ItemsCount::new(samples.t_ns.len())).bench(|| run(&samples, &[]));
}

/// One effect at a time on the light of a video; the difference from none is what it costs.
#[divan::bench(args = [
    "{}",
    r#"{"dark_current": {"current": 0.1}}"#,
    r#"{"time_constant": {"alpha": "200 us"}}"#,
    r#"{"second_pole": {"tau": "300 us"}}"#,
    r#"{"threshold_scale": {"fraction": 0.1}}"#,
    r#"{"threshold_asymmetry": {"fraction": 0.1}}"#,
    r#"{"refractory": {"refractory": "80 us"}}"#,
    r#"{"reset_memory": {"fraction": 0.1}}"#,
    r#"{"leak_events": {"rate": "1 Hz"}}"#,
    r#"{"parasitic_leak": {"coefficient": 0.1}}"#,
    r#"{"clock_offset": {"offset": "1 ms"}}"#,
])]
fn steps_with(bencher: Bencher, described: &str) {
    let (samples, effects) = (video(), effects(described));
    bencher.counter(ItemsCount::new(samples.t_ns.len())).bench(|| run(&samples, &effects));
}
