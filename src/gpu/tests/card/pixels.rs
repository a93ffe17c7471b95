//! Pixels with known light: events and frames of the forward model, of five kinds.

use photocurrent_core::Exposure;
use photocurrent_core::random::Random;
use photocurrent_core::sensor::Reset;
use photocurrent_sensor::effects::Site;
use photocurrent_sensor::forward::{Chain, LOG_STEP, LinearLight, Pixel, PixelNoise, TOLERANCE, simulate};
use photocurrent_sensor::front_end::FrontEnd;
use photocurrent_sensor::map::{MapFrame, MapProblem, MapSensor, PixelEvent};

pub(crate) const SPAN_NS: i64 = 100_000_000;
const STEP_NS: i64 = 50_000;
const PERIOD_NS: i64 = 9_000_000;
const EXPOSURE_NS: i64 = 6_500_000;
const FRONT_END: FrontEnd = FrontEnd { tau_0_s: 20e-6, alpha_s: 12e-3 };
const SATURATION_DN: f64 = 1023.0;

struct Noise(Random);

impl PixelNoise for Noise {
    fn uniform(&mut self) -> f64 {
        self.0.uniform()
    }

    fn threshold_offset(&mut self) -> f64 {
        0.01 * self.0.normal()
    }
}

/// What a pixel measured.
pub(crate) struct Measured {
    pub(crate) events: Vec<PixelEvent>,
    pub(crate) frames: Vec<MapFrame>,
    reset: Reset,
}

/// Log light of pixel `n` at `t_s`: edges, texture, a single edge, light that falls into the dark at once,
/// slow waves. None saturates a frame.
fn log_light(n: u64, t_s: f64) -> f64 {
    let phase = n as f64 * 0.7;
    let level = 3.4 + 0.8 * libm::sin(n as f64 * 0.37);
    match n % 5 {
        0 => level + 0.75 * libm::tanh(9.0 * libm::sin(209.4 * t_s + phase)),
        1 => level + 0.4 * libm::sin(300.0 * t_s + phase) + 0.3 * libm::sin(780.0 * t_s + 1.3 * phase),
        2 => level + 0.6 * libm::tanh((t_s - 0.04 - 0.002 * libm::sin(phase)) / 1e-3),
        3 => level - 0.8 - 1.5 * libm::tanh((t_s - 0.05 - 0.01 * libm::sin(phase)) / 2e-4),
        _ => level + 0.8 * libm::sin(60.0 * t_s + phase),
    }
}

/// Pixel `n` with this reset, its log light raised by `raised`.
pub(crate) fn measured(n: u64, reset: Reset, raised: f64) -> Measured {
    let t_ns: Vec<i64> = (0..=SPAN_NS / STEP_NS).map(|k| k * STEP_NS).collect();
    let current: Vec<f64> = t_ns.iter().map(|&t| libm::exp(raised + log_light(n, t as f64 * 1e-9))).collect();
    let light = LinearLight::new(&t_ns, &current);
    let mut noise = Noise(Random::new(n, &[1]));
    let pixel = Pixel {
        front_end: FRONT_END,
        threshold_on: 0.20,
        threshold_off: 0.21,
        latency_ns: 1_000,
        latency_spread_ns: 0.0,
        refractory_ns: 50_000,
        log_step: LOG_STEP,
    };
    let chain = Chain { pixel, reset, effects: &[], tolerance: TOLERANCE };
    let site = Site { x: n as u32, y: 0, width: 4_096, height: 1, seed: 0 };
    let fired = simulate(&chain, &site, &light, 0, SPAN_NS, &mut noise);
    let frame = |l: i64| {
        let (start_ns, end_ns) = (l * PERIOD_NS, l * PERIOD_NS + EXPOSURE_NS);
        let clean = 850.0 * light.integral(Exposure::new(start_ns, end_ns));
        let sigma = |dn: f64| libm::sqrt(0.09 + 0.1023 * f64::max(dn, 0.0));
        let dn = f64::min(libm::round(clean + sigma(clean) * noise.0.normal()), SATURATION_DN);
        let (of_noise, share) = (sigma(dn), 0.02 * dn);
        MapFrame {
            start_ns,
            end_ns,
            dn,
            sigma_dn: libm::sqrt(1.0 + of_noise * of_noise + share * share),
            saturated: dn >= SATURATION_DN,
        }
    };
    let frames = (0..11).map(frame).collect();
    Measured { events: fired.iter().map(|fired| fired.event).collect(), frames, reset }
}

/// The first `count` pixels.
pub(crate) fn pixels(count: u64) -> Vec<Measured> {
    (0..count).map(|n| measured(n, Reset::Resample, 0.0)).collect()
}

impl Measured {
    /// Its problem.
    pub(crate) fn problem(&self) -> MapProblem<'_> {
        let sensor = MapSensor {
            front_end: FRONT_END,
            threshold_on: 0.20,
            threshold_off: 0.21,
            reset: self.reset,
            refractory_ns: 50_000,
            gain: 850.0,
            black_level_dn: 0.0,
            saturation_dn: SATURATION_DN,
        };
        let (events, frames) = (&self.events, &self.frames);
        MapProblem { no_event_sigma: 0.03, ..MapProblem::new(sensor, events, frames, (0, SPAN_NS)) }
    }
}
