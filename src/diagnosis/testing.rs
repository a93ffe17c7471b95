//! A small recording for tests: a sine of light that moves across an array, as the stated sensor records it.

use crate::curves::LogLightCurves;
use crate::record::{EffectParameters, SimulatedConditions, record};
use crate::sample::PixelSample;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{Exposure, Extent, FrameTimes, Sensor};
use photocurrent_scene::case::{Case, CaseFrames, PixelEvents};

/// The sensor of [`case`].
pub fn sensor() -> Sensor {
    let mut sensor = Sensor::unknown("test");
    sensor.front_end.tau_0 = Some(Duration::new(30_000));
    sensor.front_end.alpha = Some(Duration::new(5_000_000));
    sensor.comparator.threshold_on = Some(0.2);
    sensor.comparator.threshold_off = Some(0.21);
    sensor.readout.refractory = Some(Duration::new(50_000));
    sensor.readout.latency_min = Some(Duration::new(1_000));
    sensor.frames.gain = Some(1000.0);
    sensor.frames.row_time = Some(Duration::new(20_000));
    sensor
}

/// The scene of [`case`]: log light of every pixel at knots a quarter of a millisecond apart.
pub fn scene(case: &Case) -> LogLightCurves {
    let instants: Vec<i64> = (0..=i64::midpoint(0, case.span.1 / 125_000)).map(|k| k * 250_000).collect();
    LogLightCurves::from_pixels((0..case.extent.pixels()).map(|pixel| {
        let (x, y) = case.pixel_place(pixel);
        let log_light = |t: &i64| {
            let at = 0.5 * f64::from(x) + 0.2 * f64::from(y) - *t as f64 * 4e-7;
            4.0 + 0.6 * libm::sin(at) + 0.2 * libm::sin(2.3 * at + 1.0)
        };
        (instants.clone(), instants.iter().map(log_light).collect(), true)
    }))
}

/// A recording of 12 x 10 pixels, 60 ms and 7 frames without any effect.
pub fn case() -> Case {
    case_with(&EffectParameters::new())
}

/// The same with effects that the description does not state.
pub fn case_with(effects: &EffectParameters) -> Case {
    case_of(7, effects)
}

/// The same with so many frames, 8 ms apart, and 4 ms after the end of the last period.
pub fn case_of(frames: usize, effects: &EffectParameters) -> Case {
    let extent = Extent { width: 12, height: 10 };
    let exposures: Vec<Exposure> =
        (0..frames as i64).map(|l| Exposure::new(l * 8_000_000, l * 8_000_000 + 4_000_000)).collect();
    let blank = Case {
        extent,
        span: (0, 8_000_000 * frames as i64 + 4_000_000),
        events: PixelEvents::new(vec![Vec::new(); extent.pixels()]),
        has_t_in: true,
        t_resolution_ns: 1,
        frames: Some(CaseFrames::new(
            FrameTimes::new(exposures, 20_000).unwrap(),
            vec![f32::NAN; frames * extent.pixels()],
        )),
        sensor: sensor(),
    };
    let sample = PixelSample::every_pixel(&blank, 4);
    record(
        &blank,
        &blank.nominal().unwrap(),
        &sample,
        &scene(&blank),
        effects,
        &SimulatedConditions::default(),
    )
    .unwrap()
}
