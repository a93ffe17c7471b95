//! The forward model against closed forms of a ramp, a step and a blind pixel.

use super::super::response::{Response, StepResponse};
use super::super::steps::Steps;
use super::super::*;
use crate::front_end::FrontEnd;
use photocurrent_core::Exposure;

const MS: i64 = 1_000_000;

fn pixel() -> Pixel {
    Pixel {
        front_end: FrontEnd::IDEAL,
        threshold_on: 0.2,
        threshold_off: 0.2,
        latency_ns: 0,
        latency_spread_ns: 0.0,
        refractory_ns: 0,
        log_step: LOG_STEP,
    }
}

/// Instants and photocurrents of a ramp of `ln i` with `slope` per second, finely sampled.
fn log_ramp(slope: f64, duration_ns: i64) -> (Vec<i64>, Vec<f64>) {
    let t_ns: Vec<i64> = (0..=duration_ns / 10_000).map(|n| n * 10_000).collect();
    let photocurrent = t_ns.iter().map(|&t| libm::exp(-1.0 + slope * t as f64 / 1e9)).collect();
    (t_ns, photocurrent)
}

/// A jump of `ln i` by `jump` at 1 ms, made in one nanosecond.
fn log_jump(jump: f64) -> ([i64; 4], [f64; 4]) {
    let after = libm::exp(-1.0 + jump);
    ([0, MS - 1, MS, 40 * MS], [libm::exp(-1.0), libm::exp(-1.0), after, after])
}

#[test]
fn a_ramp_fires_once_per_threshold() {
    for slope in [37.0, -37.0] {
        let (t_ns, photocurrent) = log_ramp(slope, 50 * MS);
        let light = LinearLight::new(&t_ns, &photocurrent);
        let events = simulate_events(&pixel(), &light, 0, 50 * MS, &mut Noiseless);
        assert_eq!(events.len(), 9); // 1.85 / 0.2
        for (n, event) in events.iter().enumerate() {
            let expected_ns = 0.2 * (n + 1) as f64 / slope.abs() * 1e9;
            // Between samples 10 us apart, i is linear instead of ln i: (37 * 1e-5)^2 / 8 of a log unit, 0.5
            // us.
            assert!((event.t_in_ns as f64 - expected_ns).abs() < 600.0);
            assert_eq!(event.polarity, if slope > 0.0 { 1 } else { -1 });
            assert_eq!(event.t_in_ns, event.t_off_ns);
        }
    }
}

#[test]
fn a_jump_fires_along_the_exponential_of_the_low_pass() {
    let tau_s = 2e-3;
    let pixel = Pixel { front_end: FrontEnd { tau_0_s: tau_s, alpha_s: 0.0 }, ..pixel() };
    for jump in [0.9, -0.9] {
        let (t_ns, photocurrent) = log_jump(jump);
        let events =
            simulate_events(&pixel, &LinearLight::new(&t_ns, &photocurrent), 0, 40 * MS, &mut Noiseless);
        assert_eq!(events.len(), 4); // 0.9 / 0.2
        for (n, event) in events.iter().enumerate() {
            let expected_s = 1e-3 - tau_s * libm::log(1.0 - 0.2 * (n + 1) as f64 / 0.9);
            // The jump's own nanosecond, and rounding.
            assert!((event.t_in_ns as f64 - expected_s * 1e9).abs() < 3.0);
        }
    }
}

#[test]
fn a_bright_pixel_answers_sooner_than_a_dark_one() {
    let pixel = Pixel { front_end: FrontEnd { tau_0_s: 0.0, alpha_s: 1e-4 }, ..pixel() };
    let first_event = |scale: f64| {
        let (t_ns, photocurrent) = log_jump(0.5);
        let photocurrent = photocurrent.map(|i| i * scale);
        let events =
            simulate_events(&pixel, &LinearLight::new(&t_ns, &photocurrent), 0, 40 * MS, &mut Noiseless);
        events[0].t_in_ns - MS
    };
    // After the jump tau = alpha / i is constant, so delays are proportional to it.
    let (bright, dark) = (first_event(1.0), first_event(0.1));
    assert!((dark as f64 / bright as f64 - 10.0).abs() < 1e-3);
}

#[test]
fn latency_and_refractory_period_move_the_reference() {
    let slope = 37.0;
    let (t_ns, photocurrent) = log_ramp(slope, 50 * MS);
    let pixel = Pixel { latency_ns: 400_000, refractory_ns: 600_000, ..pixel() };
    let events = simulate_events(&pixel, &LinearLight::new(&t_ns, &photocurrent), 0, 50 * MS, &mut Noiseless);
    let period_ns = 0.2 / slope * 1e9 + 1e6;
    assert_eq!(events.len(), 7);
    for (n, event) in events.iter().enumerate() {
        let expected_ns = 0.2 / slope * 1e9 + n as f64 * period_ns;
        assert!((event.t_in_ns as f64 - expected_ns).abs() < 600.0 * (n + 1) as f64);
        assert_eq!(event.t_off_ns - event.t_in_ns, 400_000);
    }
}

#[test]
fn refractory_longer_than_the_change_yields_no_second_event() {
    let (t_ns, photocurrent) = log_jump(0.9);
    let pixel = Pixel { refractory_ns: 10 * MS, ..pixel() };
    let events = simulate_events(&pixel, &LinearLight::new(&t_ns, &photocurrent), 0, 40 * MS, &mut Noiseless);
    assert_eq!(events.len(), 1);
}

#[test]
fn constant_light_is_silent() {
    let light = LinearLight::new(&[0], &[0.3]);
    let pixel = Pixel { front_end: FrontEnd { tau_0_s: 1e-4, alpha_s: 1e-4 }, ..pixel() };
    assert_eq!(simulate_events(&pixel, &light, 0, 40 * MS, &mut Noiseless), []);
}

#[test]
fn a_turn_inside_one_step_is_not_missed() {
    // The voltage still falls towards light that rises: it turns round inside the step, where both meet.
    let (front_end, start) = (FrontEnd { tau_0_s: 0.2e-3, alpha_s: 0.8e-3 }, 0.02);
    let light = LinearLight::new(&[0, 2 * MS], &[1.0, 1.05]);
    let mut steps = Steps::new();
    steps.fill(&light, &mut 0, 0, 2 * MS, 0.1);
    steps.prepare(&front_end);
    assert_eq!(steps.count, 1);
    let response = StepResponse::new(&steps, 0, start, steps.end_voltage(0, start), 0.0, 0.0);
    let turn_s = response.turning_points(0.0, 2e-3)[0].expect("the voltage turns");
    // The same low-pass in steps of 10 ns.
    let (mut v, mut least) = (start, (0.0, start));
    for n in 0..200_000 {
        let t = (f64::from(n) + 0.5) * 1e-8;
        let i = 1.0 + 25.0 * t;
        v += (libm::log(i) - v) / (0.2e-3 + 0.8e-3 / i) * 1e-8;
        if v < least.1 {
            least = (t, v);
        }
    }
    // The error left is that of the 200,000 steps.
    assert!(
        (turn_s - least.0).abs() < 1e-6 && (response.value(turn_s) - least.1).abs() < 1e-7,
        "{turn_s} {least:?}"
    );
    assert!((response.value(2e-3) - v).abs() < 3e-7);
    let (at_s, polarity) = response
        .first_crossing((0.0, start), 2e-3, start, 10.0, 0.9 * (start - least.1))
        .expect("an OFF event before the turn");
    assert_eq!(polarity, -1);
    assert!(at_s < turn_s && (response.value(at_s) - (start - 0.9 * (start - least.1))).abs() < 1e-12);
}

#[test]
fn the_random_part_of_the_latency_follows_the_caller() {
    struct Half;
    impl PixelNoise for Half {
        fn uniform(&mut self) -> f64 {
            0.5
        }
    }
    let (t_ns, photocurrent) = log_jump(0.3);
    let pixel = Pixel { latency_ns: 20_000, latency_spread_ns: 40_000.0, ..pixel() };
    let events = simulate_events(&pixel, &LinearLight::new(&t_ns, &photocurrent), 0, 40 * MS, &mut Half);
    assert_eq!(events[0].t_off_ns - events[0].t_in_ns, 20_000 + 27_726); // 40 us * ln 2
}

#[test]
fn a_raised_threshold_fires_later() {
    struct Raised;
    impl PixelNoise for Raised {
        fn threshold_offset(&mut self) -> f64 {
            0.1
        }
    }
    let (t_ns, photocurrent) = log_ramp(37.0, 50 * MS);
    let light = LinearLight::new(&t_ns, &photocurrent);
    assert_eq!(simulate_events(&pixel(), &light, 0, 50 * MS, &mut Raised).len(), 6); // 1.85 / 0.3
}

#[test]
fn the_exposure_integral_of_a_triangle_is_its_area() {
    let light = LinearLight::new(&[0, 1_000, 3_000], &[1.0, 3.0, 1.0]);
    let area = light.integral(Exposure::new(0, 3_000));
    assert!((area - 6e-6).abs() < 1e-20);
    let outside = light.integral(Exposure::new(-500, 4_000));
    assert!((outside - 7.5e-6).abs() < 1e-20);
    let inside = light.integral(Exposure::new(500, 2_000));
    assert!((inside - (1.25e-6 + 2.5e-6)).abs() < 1e-20);
}
