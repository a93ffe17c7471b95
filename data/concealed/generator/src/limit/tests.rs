//! Detection limits against closed forms, on a ramp and on still light.

use super::*;
use crate::array::{Timing, run};
use crate::light::NODE;
use crate::scene::{Family, Scene};
use crate::sensor::{Reset, Sensor};

const SLOPE: f64 = 30.0;

fn sensor(reset: Reset) -> Sensor {
    Sensor {
        tau_0: 40e-6,
        alpha: 1e-9,
        on: 0.2,
        off: 0.21,
        threshold_noise: 0.003,
        states_threshold_noise: true,
        reset,
        refractory: 100e-6,
        latency_min: 5e-6,
        latency_more: 1e-12,
        gain: 1000.0,
        black: 10.0,
        saturation: 1023.0,
        row_time: 20e-6,
        read_noise: 0.0,
        full_well: 0.0,
        states_frame_noise: false,
        per_lux: 0.0,
    }
}

/// The limits of effects on a ramp of 12 x 9 pixels, the number of events, and the noise of each.
fn limits(reset: Reset, ids: &[&str]) -> (Vec<f64>, f64, f64) {
    let exposures = (0..6).map(|l| 3e-3 + 8e-3 * f64::from(l)).map(|t| [t, t + 4e-3]).collect();
    let timing = Timing { start: 2e-3, end: 60e-3, reset_at_start: true, node: NODE, steps: 8, exposures };
    let family = Family::Ramp { slope: SLOPE };
    let scene = Scene { family, mean: 0.0, contrast: 1.0, pace: 1.0, flicker: None };
    let physics = Physics::of(sensor(reset));
    let setting = Setting { light: 2.0, period: 8e-3, readout_phase: 0.0, width: 12, height: 9, rate: 1e4 };
    let mut events = run(&scene, &physics, 12, 9, &timing, &mut Random::named("limit")).0;
    events.sort_by(|a, b| a.t_in.total_cmp(&b.t_in));
    let known = Known { scene: &scene, timing: &timing, size: [12, 9], events: &events, has_t_in: true };
    let kept = Kept { step: 20e-6, numbers: Numbers::Sixteenths };
    let reference = Reference::new(known, &physics, &setting, kept);
    assert!(reference.events.iter().all(|weight| *weight > 0.0), "every event is a crossing");
    let random = Random::named("effect");
    let found = ids.iter().map(|id| reference.limit(id, &random).expect("an id").expect("a size")).collect();
    let stamp = SLOPE * 20e-6;
    let sigma = libm::sqrt(0.003 * 0.003 + 0.002 * 0.002 + stamp * stamp / 12.0);
    (found, events.len() as f64, sigma)
}

#[test]
fn on_a_ramp_limits_are_five_standard_errors() {
    for reset in [Reset::Resample, Reset::Advance] {
        let (limits, n, sigma) = limits(reset, &["threshold_scale", "leak_events"]);
        assert!(n > 700.0);
        // A threshold of 0.2 (1 + f): each event moves by 0.2 f.
        let scale = 5.0 * sigma / (0.2 * n.sqrt());
        assert!((limits[0] / scale - 1.0).abs() < 0.03, "{} {scale}", limits[0]);
        // A leak of so many thresholds a second acts for the 0.2 / 30 s from reset to event, give or take
        // the noise.
        let leak = 5.0 * sigma / (0.2 * (0.2 / SLOPE) * n.sqrt());
        assert!((limits[1] / leak - 1.0).abs() < 0.04, "{reset:?}: {} {leak}", limits[1]);
    }
}

#[test]
fn on_a_ramp_a_later_reset_moves_every_event_but_the_first() {
    let (limits, n, sigma) = limits(Reset::Resample, &["refractory"]);
    let expected = 5.0 * sigma / (SLOPE * (n - 108.0).sqrt());
    assert!((limits[0] / expected - 1.0).abs() < 0.03, "{} {expected}", limits[0]);
}

#[test]
fn random_and_counted_effects_have_the_limits_of_their_rules() {
    let ids =
        ["threshold_noise", "threshold_mismatch", "timestamp_jitter", "background_activity", "event_loss"];
    let (limits, n, sigma) = limits(Reset::Resample, &ids);
    // n draws of variance s^2 on a variance sigma^2; 108 draws that n / 108 events show each.
    for (limit, draws, variance) in [
        (limits[0], n, sigma * sigma),
        (limits[1], 108.0, sigma * sigma * 108.0 / n),
        (limits[2], n, (sigma / SLOPE).powi(2)),
    ] {
        let r = limit * limit / variance;
        let gain = 0.5 * draws * (r - libm::log(1.0 + r));
        assert!((gain / NATS - 1.0).abs() < 0.06, "{limit}: {gain} nats");
    }
    assert!((limits[3] * 108.0 * 58e-3 - 25.0).abs() < 1e-9 && (limits[4] * n - 25.0).abs() < 1e-9);
}

#[test]
fn frame_values_count_with_no_less_than_a_third_of_a_dn() {
    let (limits, ..) = limits(Reset::Resample, &["black_level"]);
    // 6 frames of 108 values, which only the brightest of reach saturation.
    let expected = 5.0 * 0.3 / (6.0f64 * 108.0).sqrt();
    assert!((limits[0] / expected - 1.0).abs() < 0.04, "{} {expected}", limits[0]);
}
