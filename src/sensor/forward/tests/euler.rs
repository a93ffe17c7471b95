//! The engine against an integrator that shares nothing with it: explicit Euler (two half steps, so of second
//! order) on a grid a hundred times finer than the engine's step.

use super::super::*;
use crate::effects::simulated::Samples;
use crate::effects::{Drive, Effect, FrontEndModel, Leak, SecondPole, Site, Thresholds};
use crate::front_end::FrontEnd;
use photocurrent_core::random::Random;
use photocurrent_core::sensor::Reset;

const GRID_S: f64 = 50e-9;

/// Everything that a case sets.
#[derive(Clone, Copy)]
struct Case {
    model: FrontEndModel,
    leak_per_s: f64,
    per_photocurrent_per_s: f64,
    latency_ns: i64,
    refractory_ns: i64,
    reset: Reset,
}

struct Made(Case);

impl Effect for Made {
    fn id(&self) -> &'static str {
        "made"
    }

    fn front_end(&self, _site: &Site, model: &mut FrontEndModel) {
        *model = self.0.model;
    }

    fn leak(&self, _site: &Site, _stated: &Thresholds) -> Leak {
        Leak { constant_per_s: self.0.leak_per_s, per_photocurrent_per_s: self.0.per_photocurrent_per_s }
    }
}

const ON: f64 = 0.1;
const OFF: f64 = 0.12;

/// Smooth light of about a decade, four sines of 20 to 170 Hz with random phases, sampled every 20 us.
fn smooth_light(seed: u64, duration_ns: i64) -> Samples {
    let mut random = Random::new(seed, &[]);
    let tau = std::f64::consts::TAU;
    let waves: Vec<[f64; 3]> = (0..4)
        .map(|n| {
            [
                0.15 + 0.25 * random.uniform(),
                tau * (20.0 + 40.0 * f64::from(n) * random.uniform()),
                tau * random.uniform(),
            ]
        })
        .collect();
    Samples::of_log(duration_ns, |t| {
        waves.iter().map(|[depth, omega, phase]| depth * libm::sin(omega * t + phase)).sum()
    })
}

/// Times in seconds and polarities, by the midpoint form of explicit Euler with linear interpolation between
/// grid points.
fn euler(case: &Case, light: &Samples, duration_s: f64) -> Vec<(f64, i8)> {
    let model = &case.model;
    let spacing_s = (light.t_ns[1] - light.t_ns[0]) as f64 / 1e9;
    let at = |t: f64| {
        let k = ((t / spacing_s) as usize).min(light.photocurrent.len() - 2);
        let share = t / spacing_s - k as f64;
        light.photocurrent[k] + share * (light.photocurrent[k + 1] - light.photocurrent[k])
    };
    let start = libm::log(at(0.0));
    let (mut v, mut w, mut h, mut drift) = (start, start, start, 0.0);
    let seen = |v: f64, w: f64, h: f64| {
        let out = if model.second_pole.is_some() { w } else { v };
        if model.high_pass_s.is_finite() { out - h } else { out }
    };
    let rates = |t: f64, [v, w, h]: [f64; 3]| {
        let i = at(t);
        let lag = libm::log(i) - v;
        let drive = if model.drive == Drive::LargeSignal { 1.0 - libm::exp(-lag) } else { lag };
        let rate = (drive / (model.low_pass.tau_0_s + model.low_pass.alpha_s / i))
            .clamp(-model.slew_down_per_s, model.slew_up_per_s);
        let rate_w = model.second_pole.map_or(0.0, |pole| (v - w) / (pole.tau_s + pole.tau_light_s / i));
        [rate, rate_w, (if model.second_pole.is_some() { w } else { v } - h) / model.high_pass_s]
    };
    let mut before = seen(v, w, h);
    let mut reference = before;
    let mut blind_until = -1.0;
    let mut sampled = true;
    let mut events = Vec::new();
    for n in 0..(duration_s / GRID_S) as usize {
        let t = n as f64 * GRID_S;
        let first = rates(t, [v, w, h]);
        let half = |n: usize, state: f64| state + 0.5 * GRID_S * first[n];
        let middle = rates(t + 0.5 * GRID_S, [half(0, v), half(1, w), half(2, h)]);
        v += middle[0] * GRID_S;
        w += middle[1] * GRID_S;
        h += middle[2] * GRID_S;
        drift += (case.leak_per_s + case.per_photocurrent_per_s * at(t + 0.5 * GRID_S)) * GRID_S;
        let after = seen(v, w, h) + drift;
        let mut from = 0.0;
        loop {
            if t + GRID_S < blind_until {
                break;
            }
            if !sampled {
                from = f64::max(from, (blind_until - t) / GRID_S);
                if case.reset == Reset::Resample {
                    reference = before + from * (after - before);
                }
                sampled = true;
            }
            let polarity = if after >= reference + ON {
                1
            } else if after <= reference - OFF {
                -1
            } else {
                break;
            };
            let step = if polarity > 0 { ON } else { -OFF };
            from = f64::max(from, (reference + step - before) / (after - before));
            let fired = t + from * GRID_S;
            events.push((fired, polarity));
            let blind = (case.latency_ns + case.refractory_ns) as f64 / 1e9;
            if blind > 0.0 {
                blind_until = fired + blind;
                sampled = false;
            }
            if blind == 0.0 || case.reset != Reset::Resample {
                reference += step;
            }
        }
        before = after;
    }
    events
}

fn agree(name: &str, case: Case) {
    let duration_ns = 40_000_000;
    let (mut total, mut off) = (0, 0);
    for seed in 0..6 {
        let light = smooth_light(seed, duration_ns);
        let pixel = Pixel {
            front_end: FrontEnd::IDEAL,
            threshold_on: ON,
            threshold_off: OFF,
            latency_ns: case.latency_ns,
            latency_spread_ns: 0.0,
            refractory_ns: case.refractory_ns,
            log_step: LOG_STEP,
        };
        let effects: Vec<Box<dyn Effect>> = vec![Box::new(Made(case))];
        let chain =
            Chain { pixel, reset: case.reset, effects: &effects, tolerance: crate::forward::TOLERANCE };
        let site = Site { x: 0, y: 0, width: 1, height: 1, seed };
        let ours = simulate(&chain, &site, &light.light(), 0, duration_ns, &mut Noiseless);
        let theirs = euler(&case, &light, duration_ns as f64 / 1e9);
        assert_eq!(ours.len(), theirs.len(), "{name}, seed {seed}: as many events");
        for (ours, theirs) in ours.iter().zip(&theirs) {
            assert_eq!(ours.event.polarity, theirs.1, "{name}, seed {seed}");
            total += 1;
            off += usize::from((ours.event.t_in_ns as f64 - theirs.0 * 1e9).abs() > 1000.0);
        }
    }
    assert!(total > 100, "{name}: {total} events are few");
    assert!(
        off as f64 <= 1e-3 * f64::from(total),
        "{name}: {off} of {total} events differ by more than 1 us"
    );
}

fn plain(tau_0_s: f64, alpha_s: f64) -> Case {
    Case {
        model: FrontEndModel::plain(FrontEnd { tau_0_s, alpha_s }),
        leak_per_s: 0.0,
        per_photocurrent_per_s: 0.0,
        latency_ns: 0,
        refractory_ns: 0,
        reset: Reset::Resample,
    }
}

#[test]
fn a_fast_and_a_slow_low_pass_agree() {
    agree("fast", plain(30e-6, 0.0));
    agree("light-dependent", plain(20e-6, 300e-6));
    agree("slow", plain(0.0, 2e-3));
}

#[test]
fn blind_time_and_reset_rules_agree() {
    for reset in [Reset::Resample, Reset::Advance] {
        agree("blind", Case { latency_ns: 20_000, refractory_ns: 100_000, reset, ..plain(20e-6, 100e-6) });
    }
}

#[test]
fn leaks_agree() {
    agree(
        "leak",
        Case { leak_per_s: 3.0, per_photocurrent_per_s: 2.0, refractory_ns: 50_000, ..plain(20e-6, 100e-6) },
    );
}

#[test]
fn a_second_pole_agrees() {
    let mut case = Case { refractory_ns: 50_000, ..plain(50e-6, 100e-6) };
    case.model.second_pole = Some(SecondPole { tau_s: 300e-6, tau_light_s: 50e-6 });
    agree("second pole", case);
}

#[test]
fn a_large_signal_front_end_agrees() {
    let mut case = plain(20e-6, 3e-3);
    case.model.drive = Drive::LargeSignal;
    agree("large signal", case);
}

#[test]
fn slew_limits_agree() {
    let mut case = Case { refractory_ns: 50_000, ..plain(20e-6, 100e-6) };
    case.model.slew_down_per_s = 60.0;
    case.model.slew_up_per_s = 90.0;
    agree("slew", case);
}

#[test]
fn a_high_pass_agrees() {
    let mut case = Case { leak_per_s: 1.0, ..plain(20e-6, 100e-6) };
    case.model.high_pass_s = 10e-3;
    agree("high-pass", case);
    case.model.second_pole = Some(SecondPole { tau_s: 300e-6, tau_light_s: 0.0 });
    agree("high-pass behind a second pole", case);
}
