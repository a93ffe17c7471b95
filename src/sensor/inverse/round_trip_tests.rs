//! Simulate a pixel, invert it, compare: the forward model integrates what the inverse model approximates.

use super::*;
use crate::forward::{LOG_STEP, LinearLight, Noiseless, Pixel, PixelNoise, simulate_events};
use crate::front_end::{FrontEnd, TauRule};
use crate::readout::compensated_step;
use photocurrent_core::Exposure;

const GAIN: f64 = 1.5e5;

/// The front end that the round trip simulates.
const SIMULATED: FrontEnd = FrontEnd { tau_0_s: 30e-6, alpha_s: 5e-5 };

/// One smooth pixel, simulated without blind time and solved with `front_end`: the rms error of `ln i` at the
/// events inside the frames.
fn round_trip_error(front_end: FrontEnd, tau_rule: TauRule) -> f64 {
    let t_ns: Vec<i64> = (0..=1500).map(|n| n * 20_000).collect();
    let current: Vec<f64> =
        t_ns.iter().map(|&t| libm::exp(-1.2 + 0.8 * libm::sin(t as f64 * 4e-7))).collect();
    let light = LinearLight::new(&t_ns, &current);
    let pixel = Pixel {
        front_end: SIMULATED,
        threshold_on: 0.05,
        threshold_off: 0.05,
        latency_ns: 0,
        latency_spread_ns: 0.0,
        refractory_ns: 0,
        log_step: LOG_STEP,
    };
    let events = simulate_events(&pixel, &light, 0, 30_000_000, &mut Noiseless);
    let frames: Vec<FrameSample> = [(1, 9), (11, 19), (21, 29)]
        .map(|(start, end)| {
            let exposure = Exposure::new(start * 1_000_000, end * 1_000_000);
            let dn = GAIN * light.integral(exposure);
            FrameSample { start_s: start as f64 * 1e-3, end_s: end as f64 * 1e-3, dn, weight: 0.04 }
        })
        .to_vec();
    let t_s: Vec<f64> = events.iter().map(|event| event.t_in_ns as f64 / 1e9).collect();
    let steps: Vec<f64> = events.iter().map(|event| 0.05 * f64::from(event.polarity)).collect();
    let problem = pixel_problem(&t_s, &steps, &frames, front_end, tau_rule);
    let mut workspace = Workspace::default();
    let solution = solve(&problem, &SolveOptions::default(), &mut workspace).expect("well posed");
    assert!(solution.has_converged());
    let seen = solution.log_photocurrent.iter().zip(&events).filter(|(_, event)| event.t_in_ns > 1_000_000);
    let squares: Vec<f64> =
        seen.map(|(u, event)| u - libm::log(light.at(event.t_in_ns))).map(|error| error * error).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn a_smooth_pixel_comes_back_better_with_its_front_end() {
    let (end, start) =
        (round_trip_error(SIMULATED, TauRule::End), round_trip_error(SIMULATED, TauRule::Start));
    let ideal = round_trip_error(FrontEnd::IDEAL, TauRule::End);
    // The photocurrent is held between events one threshold (0.05) apart, and an interval's light is summed
    // up in its end: errors of about one threshold are the model's own. Ignoring the delay (0.25 ms) costs
    // more.
    assert!(end < 0.05, "rms error {end}");
    assert!(start < 0.05, "rms error {start}");
    assert!(ideal > 1.4 * end, "{ideal} against {end}");
}

fn pixel_problem<'a>(
    t_s: &'a [f64],
    steps: &'a [f64],
    frames: &'a [FrameSample],
    front_end: FrontEnd,
    tau_rule: TauRule,
) -> PixelProblem<'a> {
    PixelProblem { t_s, steps, frames, evs_weight: 1111.0, front_end, tau_rule, black_level: 0.0, gain: GAIN }
}

/// A fixed stream of numbers, so that the test sees the same pixels everywhere.
struct Dice(u64);

impl PixelNoise for Dice {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// How many of `pixels` dim, noisy, fast pixels converge, compensated for readout.
fn converged_dim_pixels(pixels: usize, tau_rule: TauRule) -> usize {
    let mut dice = Dice(7);
    let front_end = FrontEnd { tau_0_s: 30e-6, alpha_s: 3e-4 };
    let pixel = Pixel {
        front_end,
        threshold_on: 0.2,
        threshold_off: 0.2,
        latency_ns: 20_000,
        latency_spread_ns: 40_000.0,
        refractory_ns: 60_000,
        log_step: LOG_STEP,
    };
    let mut workspace = Workspace::default();
    let mut converged = 0;
    for _ in 0..pixels {
        let (mut now, mut level) = (0, 0.02 + 0.95 * dice.uniform());
        let (mut t_ns, mut current) = (vec![0], vec![level]);
        while now < 35_000_000 {
            now += (5e5 + 6e6 * dice.uniform()) as i64;
            t_ns.push(now);
            current.push(level);
            now += (5e4 + 1e6 * dice.uniform()) as i64;
            level = 0.02 + 0.95 * dice.uniform() * dice.uniform();
            t_ns.push(now);
            current.push(level);
        }
        let light = LinearLight::new(&t_ns, &current);
        let events = simulate_events(&pixel, &light, 0, 35_000_000, &mut dice);
        // Stamps are quantised to a microsecond, as sensors do.
        let t_in_s: Vec<f64> = events.iter().map(|event| (event.t_in_ns / 1000) as f64 / 1e6).collect();
        let t_off_s: Vec<f64> = events.iter().map(|event| (event.t_off_ns / 1000) as f64 / 1e6).collect();
        let plain: Vec<f64> = events.iter().map(|event| 0.2 * f64::from(event.polarity)).collect();
        let mut steps = plain.clone();
        for k in 1..plain.len() {
            steps[k] = compensated_step(plain[k], t_in_s[k - 1], t_off_s[k - 1], t_in_s[k], 60e-6);
        }
        let frames = [0, 1, 2, 3].map(|l| {
            let start_ns = 500_000 + 8_333_333 * l;
            let exposure = Exposure::new(start_ns, start_ns + 6_500_000);
            let dn = (GAIN * light.integral(exposure)).round();
            FrameSample {
                start_s: start_ns as f64 / 1e9,
                end_s: exposure.end.0 as f64 / 1e9,
                dn,
                weight: 0.04,
            }
        });
        let problem = pixel_problem(&t_in_s, &steps, &frames, front_end, tau_rule);
        let solution = solve(&problem, &SolveOptions::default(), &mut workspace).expect("well posed");
        converged += usize::from(solution.has_converged());
    }
    converged
}

#[test]
fn nearly_all_dim_pixels_converge_with_the_time_constant_of_the_end() {
    // Folds are common here. A fall that the low-pass cannot make must not cost the pixel its solution.
    let converged = converged_dim_pixels(200, TauRule::End);
    assert!(converged >= 199, "{converged} of 200");
}

#[test]
fn many_dim_pixels_fail_with_the_time_constant_as_printed() {
    // The printed rule asks for absurd targets at edges out of the dark. That is a property of the model:
    // kept, and visible here, because it is why the end's time constant is the default.
    let converged = converged_dim_pixels(200, TauRule::Start);
    assert!(converged < 190, "{converged} of 200");
}
