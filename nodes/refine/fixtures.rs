//! Small recordings whose light is known, for the tests of this folder.

use crate::solve;
use crate::solve::map::SolveMap;
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::quantity::Duration;
use photocurrent_core::random::Random;
use photocurrent_core::{EventStream, Exposure, Extent, FrameSequence, Node, Sensor, TrackSet, testing};
use photocurrent_scene::film::{EventTimes, LogTracks};
use photocurrent_sensor::effects::Site;
use photocurrent_sensor::forward::{Chain, LOG_STEP, LinearLight, Noiseless, Pixel, simulate};
use photocurrent_sensor::front_end::FrontEnd;
use photocurrent_solve::SolveOptions;
use std::sync::Arc;

pub(super) const EXTENT: Extent = Extent { width: 24, height: 16 };
pub(super) const END_NS: i64 = 40_000_000;
pub(super) const GAIN: f64 = 1000.0;

pub(super) fn sensor() -> Arc<Sensor> {
    let mut sensor = Sensor::unknown("test");
    sensor.front_end.tau_0 = Some(Duration::new(20_000));
    sensor.front_end.alpha = Some(Duration::new(2_000_000));
    sensor.comparator.threshold_on = Some(0.25);
    sensor.comparator.threshold_off = Some(0.25);
    sensor.readout.refractory = Some(Duration::new(50_000));
    sensor.frames.gain = Some(GAIN);
    Arc::new(sensor)
}

/// The sensor's recording of light with the logarithm `log(x, y, ms)`.
pub(super) fn record(log: impl Fn(usize, usize, f64) -> f64) -> (EventStream, FrameSequence) {
    let t_ns: Vec<i64> = (0..=END_NS / 50_000).map(|n| n * 50_000).collect();
    let exposures: Vec<Exposure> =
        (0..5).map(|l| Exposure::new(l * 8_800_000, l * 8_800_000 + 4_000_000)).collect();
    let front_end = FrontEnd { tau_0_s: 20e-6, alpha_s: 2e-3 };
    let pixel = Pixel {
        front_end,
        threshold_on: 0.25,
        threshold_off: 0.25,
        latency_ns: 1_000,
        latency_spread_ns: 0.0,
        refractory_ns: 50_000,
        log_step: LOG_STEP,
    };
    let (mut events, mut dn) = (Vec::new(), Vec::new());
    for y in 0..EXTENT.height {
        for x in 0..EXTENT.width {
            let current: Vec<f64> =
                t_ns.iter().map(|&t| libm::exp(log(x as usize, y as usize, t as f64 * 1e-6))).collect();
            let light = LinearLight::new(&t_ns, &current);
            let site = Site { x, y, width: EXTENT.width, height: EXTENT.height, seed: 0 };
            let fired = simulate(
                &Chain {
                    pixel,
                    reset: photocurrent_core::sensor::Reset::Resample,
                    effects: &[],
                    tolerance: photocurrent_sensor::forward::TOLERANCE,
                },
                &site,
                &light,
                0,
                END_NS,
                &mut Noiseless,
            );
            events.extend(fired.iter().map(|fired| Event {
                x: x as u16,
                y: y as u16,
                polarity: Polarity::from_bit(u8::from(fired.event.polarity > 0)),
                t: fired.event.t_off_ns,
                t_in: Some(fired.event.t_in_ns),
            }));
            dn.push(
                exposures
                    .iter()
                    .map(|&exposure| (GAIN * light.integral(exposure)) as f32)
                    .collect::<Vec<f32>>(),
            );
        }
    }
    let frames = testing::captured(EXTENT, exposures, 0, |l, x, y| dn[(y * EXTENT.width + x) as usize][l]);
    (testing::stream(EXTENT, events), frames)
}

/// A texture that slides by 0.7 and 0.2 pixels a millisecond.
pub(super) fn texture(x: usize, y: usize, ms: f64) -> f64 {
    let (x, y) = (x as f64 - 0.7 * ms, y as f64 - 0.2 * ms);
    4.6 + 0.3 * libm::sin(0.8 * x + 0.3) * libm::cos(0.7 * y)
        + 0.2 * libm::sin(0.4 * x - 0.9 * y)
        + 0.1 * libm::sin(1.3 * x + 0.5 * y)
}

/// Light that swings in every pixel as it pleases.
pub(super) fn every_pixel_for_itself(x: usize, y: usize, ms: f64) -> f64 {
    let mut random = Random::new(3, &[x as u64, y as u64]);
    let (rate, phase) = (0.3 + 0.5 * random.uniform(), 7.0 * random.uniform());
    4.6 + 0.4 * libm::sin(rate * ms + phase)
}

pub(super) fn solve(events: &EventStream, frames: &FrameSequence) -> TrackSet {
    let node = SolveMap::build(SolveOptions::default().into()).unwrap();
    let input = solve::In { events: events.clone(), frames: frames.clone(), sensor: sensor() };
    testing::with_context(EXTENT.rows(), &["tracks", "map"], |cx| node.run(input, cx)).0.unwrap().tracks
}

/// Rms error of log light, every half millisecond from the first frame to the last.
pub(super) fn error(tracks: &TrackSet, log: impl Fn(usize, usize, f64) -> f64) -> f64 {
    error_in(0..EXTENT.width as usize, tracks, log)
}

/// The same of some columns.
pub(super) fn error_in(
    columns: std::ops::Range<usize>,
    tracks: &TrackSet,
    log: impl Fn(usize, usize, f64) -> f64,
) -> f64 {
    let tracks = LogTracks::new(
        EXTENT,
        tracks.read(EXTENT.rows()).unwrap(),
        &Arc::new(EventTimes::new(std::iter::empty())),
    );
    let (mut sum, mut count) = (0.0, 0.0);
    for y in 0..EXTENT.height as usize {
        for x in columns.clone() {
            for n in 4..76 {
                let t_ns = n * 500_000;
                let off = tracks.at(x, y, t_ns).unwrap() - log(x, y, t_ns as f64 * 1e-6);
                (sum, count) = (sum + off * off, count + 1.0);
            }
        }
    }
    libm::sqrt(sum / count)
}

pub(super) fn decibels(before: f64, after: f64) -> f64 {
    20.0 * libm::log10(before / after)
}
