//! Triangular light, at a speed of each pixel's own, and a comparator written out here.

use super::Departure;
use super::changes::findings;
use photocurrent_core::random::Random;
use photocurrent_core::{Exposure, Extent, FrameTimes};
use photocurrent_scene::case::{Case, CaseFrames, PixelEvent, PixelEvents};

const PERIOD_NS: i64 = 40_000_000;
const FRAMES: i64 = 26;
const THRESHOLD: f64 = 0.2;

/// 40 x 32 pixels, a second at 25 Hz with exposures of 500 us. Thresholds are a fifth more than stated,
/// events are stamped `late_ns` late, pixels are blind for `blind_ns`.
fn camera(late_ns: i64, blind_ns: i64) -> Case {
    seeded(21, late_ns, blind_ns)
}

/// Another one for each seed.
pub(super) fn seeded(seed: u64, late_ns: i64, blind_ns: i64) -> Case {
    let extent = Extent { width: 40, height: 32 };
    let mut random = Random::new(seed, &[]);
    let mut frames = vec![0.0; FRAMES as usize * extent.pixels()];
    let pixels: Vec<Vec<PixelEvent>> = (0..extent.pixels())
        .map(|pixel| {
            // Up for 90 ms and down for 90 ms, by 1 to 4.5 in log light; in the last ten columns nothing
            // moves, and they show that frames are without noise.
            let (height, phase) =
                (if pixel % 40 < 30 { 1.0 + 3.5 * random.uniform() } else { 0.0 }, random.uniform());
            let log = |t_ns: i64| {
                let turn = (t_ns as f64 / 180e6 + phase).rem_euclid(1.0);
                height * (2.0 * turn - 1.0).abs()
            };
            for frame in 0..FRAMES {
                frames[frame as usize * extent.pixels() + pixel] =
                    (20.0 * libm::exp(log(frame * PERIOD_NS + 250_000))) as f32;
            }
            let (mut events, mut t, mut reference) = (Vec::new(), 0, log(0));
            while t < FRAMES * PERIOD_NS {
                t += 40_000;
                let away = log(t) - reference;
                if away.abs() >= 1.2 * THRESHOLD {
                    events.push(PixelEvent {
                        t_in_ns: t + late_ns,
                        t_off_ns: t + late_ns,
                        polarity: if away > 0.0 { 1 } else { -1 },
                    });
                    t += blind_ns;
                    reference = log(t);
                }
            }
            events
        })
        .collect();
    let exposures = (0..FRAMES).map(|l| Exposure::new(l * PERIOD_NS, l * PERIOD_NS + 500_000)).collect();
    let mut sensor = crate::testing::sensor();
    sensor.comparator.threshold_on = Some(THRESHOLD);
    sensor.comparator.threshold_off = Some(THRESHOLD);
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

fn clock_and_refractory(case: &Case) -> (Option<Departure>, Option<Departure>) {
    let all = findings(case, &case.nominal().unwrap(), &[]);
    let of = |id: &str| all.iter().find(|finding| finding.id == id).cloned();
    (of("clock_offset"), of("refractory"))
}

#[test]
fn a_sensor_as_stated_but_for_its_thresholds_is_neither_late_nor_blind() {
    assert_eq!(clock_and_refractory(&camera(0, 0)), (None, None));
}

#[test]
fn events_of_a_late_clock_show_by_how_much() {
    for late_ms in [4.0, -7.0] {
        let (offset, blind) = clock_and_refractory(&camera((late_ms * 1e6) as i64, 0));
        let offset = offset.unwrap();
        assert!((offset.parameters[0].1 * 1e3 - late_ms).abs() < 0.5, "{offset:?}");
        assert!(offset.heldout.unwrap().nats > 100.0, "{offset:?}");
        assert!(blind.is_none(), "{blind:?}");
    }
}

#[test]
fn events_that_are_early_by_less_than_an_interval_have_no_name() {
    // The shortest intervals are 5 ms: pixels that are blind for 3 ms lose light after their events, and
    // these look as early.
    assert_eq!(clock_and_refractory(&camera(-3_000_000, 0)), (None, None));
}

#[test]
fn light_that_is_lost_after_events_is_a_blind_time() {
    // With a threshold of 0.24 and slopes of 11 to 50 per second, events are 8 to 25 ms apart; 3 ms of that
    // is blind.
    let mut case = camera(0, 3_000_000);
    let (offset, blind) = clock_and_refractory(&case);
    let blind = blind.unwrap();
    assert!((blind.parameters[0].1 / 3e-3 - 1.0).abs() < 0.2, "{blind:?}");
    assert!(blind.heldout.unwrap().nats > 100.0, "{blind:?}");
    assert!(offset.is_none(), "{offset:?}");
    // Stated, it is no finding.
    case.sensor.readout.refractory = Some(photocurrent_core::quantity::Duration::new(3_000_000));
    assert_eq!(clock_and_refractory(&case), (None, None));
}

#[test]
fn both_at_once_are_separated() {
    let (offset, blind) = clock_and_refractory(&camera(5_000_000, 2_000_000));
    let (offset, blind) = (offset.unwrap(), blind.unwrap());
    assert!((offset.parameters[0].1 - 5e-3).abs() < 0.7e-3, "{offset:?}");
    assert!((blind.parameters[0].1 / 2e-3 - 1.0).abs() < 0.3, "{blind:?}");
}

#[test]
fn frames_that_average_over_their_period_decide_nothing() {
    let mut case = camera(4_000_000, 0);
    if let Some(frames) = &mut case.frames {
        let exposures = (0..FRAMES)
            .map(|l| Exposure::new(l * PERIOD_NS - 9_000_000, l * PERIOD_NS + 9_000_000))
            .collect();
        frames.times = FrameTimes::new(exposures, 0).unwrap();
    }
    assert_eq!(clock_and_refractory(&case), (None, None));
}
