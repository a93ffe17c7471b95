//! Time to simulate one pixel: without effects by kind of light, and with one effect at a time.
//!
//! Run with `cargo bench -p photocurrent-sensor --bench forward`. Light is synthetic, 50 ms sampled every 20 us; a step is `max_step_ns` of 5 us,
//! so "items" are pixel-steps (10,000 per pixel) where nothing else is said. Front ends without a closed form choose their own steps;
//! their items are counted alike, so that times compare.

use divan::Bencher;
use divan::counter::ItemsCount;
use photocurrent_core::sensor::Reset;
use photocurrent_sensor::effects::{Effect, Site, from_description};
use photocurrent_sensor::forward::{Chain, LOG_STEP, LinearLight, Noiseless, Pixel, simulate};
use photocurrent_sensor::front_end::FrontEnd;
use serde_json::Value;

const SPAN_NS: i64 = 50_000_000;
const STEP_NS: i64 = 5_000;
const SITE: Site = Site { x: 3, y: 5, width: 64, height: 48, seed: 20_240_607 };

fn main() {
    divan::main();
}

struct Samples {
    t_ns: Vec<i64>,
    photocurrent: Vec<f64>,
}

/// Three sines with 0.9 of a log unit in all: about 40 events in 50 ms.
fn textured() -> Samples {
    let t_ns: Vec<i64> = (0..=SPAN_NS / 20_000).map(|n| n * 20_000).collect();
    let log = |t: f64| 0.4 * libm::sin(500.0 * t) + 0.3 * libm::sin(1300.0 * t + 1.0) + 0.2 * libm::sin(2100.0 * t + 2.0);
    let photocurrent = t_ns.iter().map(|&t| libm::exp(log(t as f64 / 1e9))).collect();
    Samples { t_ns, photocurrent }
}

fn still() -> Samples {
    Samples { photocurrent: vec![0.4; 2501], ..textured() }
}

fn pixel() -> Pixel {
    let front_end = FrontEnd { tau_0_s: 30e-6, alpha_s: 100e-6 };
    Pixel { front_end, threshold_on: 0.2, threshold_off: 0.2, latency_ns: 5_000, latency_spread_ns: 0.0, refractory_ns: 50_000, log_step: LOG_STEP }
}

fn effects(text: &str) -> Vec<Box<dyn Effect>> {
    let described: Value = serde_json::from_str(text).expect("the description is JSON");
    from_description(&serde_json::from_value(described).expect("a table of tables")).expect("the description is right")
}

fn run(samples: &Samples, effects: &[Box<dyn Effect>]) -> usize {
    let chain = Chain { pixel: pixel(), reset: Reset::Resample, effects };
    simulate(&chain, &SITE, &LinearLight::new(&samples.t_ns, &samples.photocurrent), 0, SPAN_NS, &mut Noiseless).len()
}

#[divan::bench]
fn steps_of_still_light(bencher: Bencher) {
    let samples = still();
    bencher.counter(ItemsCount::new((SPAN_NS / STEP_NS) as usize)).bench(|| run(&samples, &[]));
}

#[divan::bench]
fn steps_of_textured_light(bencher: Bencher) {
    let samples = textured();
    bencher.counter(ItemsCount::new((SPAN_NS / STEP_NS) as usize)).bench(|| run(&samples, &[]));
}

#[divan::bench]
fn events_of_textured_light(bencher: Bencher) {
    let samples = textured();
    bencher.counter(ItemsCount::new(run(&samples, &[]))).bench(|| run(&samples, &[]));
}

/// One effect at a time; the difference from textured light without effects is what it costs.
#[divan::bench(args = [
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
    let (samples, effects) = (textured(), effects(described));
    bencher.counter(ItemsCount::new((SPAN_NS / STEP_NS) as usize)).bench(|| run(&samples, &effects));
}
