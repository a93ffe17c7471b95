//! Waves of light over an array, their frames averaged over 16 of 25 ms and their events fired by a
//! comparator that is written out here.

use super::Departure;
use super::means::{PairProposals, proposed};
use photocurrent_core::{Exposure, Extent, FrameTimes};
use photocurrent_scene::case::{Case, CaseFrames, PixelEvent, PixelEvents};

const PERIOD_NS: i64 = 25_000_000;
const EXPOSURE_NS: i64 = 16_000_000;
const FRAMES: i64 = 16;
const STEP_NS: i64 = 50_000;
/// As stated: of ON, of OFF.
const STATED: (f64, f64) = (0.1, 0.11);
/// DN of one unit of photocurrent in an exposure.
const DN: f64 = 16.0;

/// True parameters that the description does not state.
#[derive(Clone, Copy, Default)]
struct TrueSensor {
    late_ns: i64,
    /// Photocurrent that events see and frames do not.
    dark: f64,
    /// Thresholds, as shares of those stated, less one.
    scale: f64,
    /// Of ON alone.
    scale_on: f64,
}

fn camera(actual: TrueSensor) -> Case {
    let extent = Extent { width: 30, height: 16 };
    let log = |pixel: usize, t_ns: i64| {
        let (x, y) = ((pixel % 30) as f64, (pixel / 30) as f64);
        let phase = 0.35 * x + 0.5 * y - 60.0 * t_ns as f64 * 1e-9;
        // In the last columns nothing moves, and they show that frames are without noise.
        let swing = if x < 22.0 { 1.0 } else { 0.0 };
        1.0 + 1.2 * libm::sin(0.11 * x + 0.17 * y)
            + swing * (0.6 * libm::sin(phase) + 0.3 * libm::sin(1.7 * phase + 1.0))
    };
    let (on, off) =
        (STATED.0 * (1.0 + actual.scale) * (1.0 + actual.scale_on), STATED.1 * (1.0 + actual.scale));
    let mut frames = vec![0.0; FRAMES as usize * extent.pixels()];
    let pixels: Vec<Vec<PixelEvent>> = (0..extent.pixels())
        .map(|pixel| {
            for frame in 0..FRAMES {
                let steps = EXPOSURE_NS / STEP_NS;
                let light = |n: i64| libm::exp(log(pixel, frame * PERIOD_NS + n * STEP_NS + STEP_NS / 2));
                frames[frame as usize * extent.pixels() + pixel] =
                    (DN * (0..steps).map(light).sum::<f64>() / steps as f64) as f32;
            }
            let voltage = |t_ns: i64| libm::log(libm::exp(log(pixel, t_ns)) + actual.dark);
            let (mut events, mut reference) = (Vec::new(), voltage(0));
            for n in 1..FRAMES * PERIOD_NS / STEP_NS {
                let (t_ns, away) = (n * STEP_NS, voltage(n * STEP_NS) - reference);
                if away >= on || away <= -off {
                    let t = t_ns + actual.late_ns;
                    events.push(PixelEvent {
                        t_in_ns: t,
                        t_off_ns: t,
                        polarity: if away > 0.0 { 1 } else { -1 },
                    });
                    reference += if away > 0.0 { on } else { -off };
                }
            }
            events
        })
        .collect();
    let exposures = (0..FRAMES).map(|l| Exposure::new(l * PERIOD_NS, l * PERIOD_NS + EXPOSURE_NS)).collect();
    let mut sensor = crate::testing::sensor();
    sensor.front_end.tau_0 = Some(photocurrent_core::quantity::Duration::new(0));
    sensor.front_end.alpha = Some(photocurrent_core::quantity::Duration::new(0));
    sensor.comparator.threshold_on = Some(STATED.0);
    sensor.comparator.threshold_off = Some(STATED.1);
    sensor.frames.gain = Some(DN / (EXPOSURE_NS as f64 * 1e-9));
    Case {
        extent,
        span: (0, FRAMES * PERIOD_NS),
        events: PixelEvents::new(pixels),
        has_t_in: false,
        t_resolution_ns: 1000,
        frames: Some(CaseFrames::new(FrameTimes::new(exposures, 0).unwrap(), frames)),
        sensor,
    }
}

fn proposals_for(actual: TrueSensor) -> PairProposals {
    let case = camera(actual);
    proposed(&case, &case.nominal().unwrap(), &[])
}

/// The number of a finding.
fn value(findings: &[Departure], id: &str) -> f64 {
    findings
        .iter()
        .find(|finding| finding.id == id)
        .unwrap_or_else(|| panic!("{id} is not in {findings:?}"))
        .parameters[0]
        .1
}

#[test]
fn of_a_sensor_as_stated_nothing_is_proposed() {
    assert_eq!(proposals_for(TrueSensor::default()), PairProposals::default());
}

#[test]
fn events_that_come_late_show_by_how_much() {
    for late_ms in [4.0, -6.0] {
        let found = proposals_for(TrueSensor { late_ns: (late_ms * 1e6) as i64, ..TrueSensor::default() });
        let late = found.late.unwrap();
        assert!((late.parameters[0].1 * 1e3 - late_ms).abs() < 0.3, "{late:?}");
        assert!(late.heldout.unwrap().nats > 100.0, "{late:?}");
        assert_eq!(found.contrast, Vec::<Vec<Departure>>::new());
    }
}

#[test]
fn other_thresholds_are_measured() {
    let found = proposals_for(TrueSensor { scale: -0.3, ..TrueSensor::default() });
    let thresholds = &found.contrast[0];
    assert_eq!((found.contrast.len(), thresholds.len()), (1, 1), "{found:?}");
    assert!((value(thresholds, "threshold_scale") + 0.3).abs() < 0.03, "{thresholds:?}");
    // ON half as much again: 25 % more in the mean, and 20 % of that apart.
    let found = proposals_for(TrueSensor { scale_on: 0.5, ..TrueSensor::default() });
    assert!((value(&found.contrast[0], "threshold_scale") - 0.25).abs() < 0.03, "{found:?}");
    assert!((value(&found.contrast[0], "threshold_asymmetry") - 0.2).abs() < 0.03, "{found:?}");
}

#[test]
fn a_current_that_frames_do_not_see_is_measured_with_delay_and_thresholds() {
    let found =
        proposals_for(TrueSensor { late_ns: 3_000_000, dark: 1.5, scale: -0.25, ..TrueSensor::default() });
    assert!((found.late.as_ref().unwrap().parameters[0].1 - 3e-3).abs() < 0.3e-3, "{found:?}");
    // Thresholds alone would be as stated: a quarter less, and a quarter less contrast.
    let [with] = found.contrast.as_slice() else { panic!("{found:?}") };
    assert!((value(with, "dark_current") / 1.5 - 1.0).abs() < 0.15, "{with:?}");
    assert!((value(with, "threshold_scale") + 0.25).abs() < 0.03, "{with:?}");
}

#[test]
fn frames_of_short_exposure_are_not_its_business() {
    let mut case = camera(TrueSensor { late_ns: 4_000_000, ..TrueSensor::default() });
    if let Some(frames) = &mut case.frames {
        let exposures = (0..FRAMES)
            .map(|l| Exposure::new(l * PERIOD_NS + 7_000_000, l * PERIOD_NS + 9_000_000))
            .collect();
        frames.times = FrameTimes::new(exposures, 0).unwrap();
    }
    assert_eq!(proposed(&case, &case.nominal().unwrap(), &[]), PairProposals::default());
}
