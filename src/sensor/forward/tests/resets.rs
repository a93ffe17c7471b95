//! What the reference does after an event, by each reset rule.

use super::super::*;
use crate::effects::simulated::{MS, SITE, Samples, ideal_pixel, intervals_s};
use photocurrent_core::sensor::Reset;

fn events(pixel: Pixel, reset: Reset, samples: &Samples, end_ns: i64) -> Vec<PixelEvent> {
    let chain = Chain { pixel, reset, effects: &[], tolerance: crate::forward::TOLERANCE };
    simulate(&chain, &SITE, &samples.light(), 0, end_ns, &mut Noiseless)
        .into_iter()
        .map(|fired| fired.event)
        .collect()
}

#[test]
fn without_blind_time_all_rules_are_one() {
    let light = Samples::of_log(80 * MS, |t| -1.0 + libm::sin(200.0 * t));
    let resampled = events(ideal_pixel(), Reset::Resample, &light, 80 * MS);
    assert!(resampled.len() > 40);
    assert_eq!(resampled, events(ideal_pixel(), Reset::Advance, &light, 80 * MS));
    assert_eq!(resampled, events(ideal_pixel(), Reset::AdvanceLossy, &light, 80 * MS));
}

#[test]
fn on_a_ramp_only_resampling_misses_the_blind_time() {
    // One threshold takes 10 ms, the blind time 4 ms.
    let ramp = Samples::of_log(100 * MS, |t| -1.0 + 20.0 * t);
    let pixel = Pixel { latency_ns: MS, refractory_ns: 3 * MS, ..ideal_pixel() };
    for (reset, period_s) in [(Reset::Resample, 14e-3), (Reset::Advance, 10e-3), (Reset::AdvanceLossy, 10e-3)]
    {
        let intervals = intervals_s(&events(pixel, reset, &ramp, 100 * MS));
        assert!(
            intervals.len() >= 5 && intervals.iter().all(|interval| (interval - period_s).abs() < 1e-6),
            "{reset:?} {intervals:?}"
        );
    }
}

#[test]
fn on_a_ramp_faster_than_the_blind_time_advance_fires_at_its_end_and_lossy_loses() {
    // One threshold takes 10 ms, the blind time 24 ms.
    let ramp = Samples::of_log(100 * MS, |t| -1.0 + 20.0 * t);
    let pixel = Pixel { refractory_ns: 24 * MS, ..ideal_pixel() };
    let times = |reset| {
        events(pixel, reset, &ramp, 100 * MS)
            .iter()
            .map(|event| (event.t_in_ns + MS / 2) / MS)
            .collect::<Vec<i64>>()
    };
    assert_eq!(times(Reset::Resample), [10, 44, 78]);
    assert_eq!(times(Reset::Advance), [10, 34, 58, 82]);
    // Crossings at 20 and 30 ms are lost; the one at 40 ms is the first after the end at 34 ms.
    assert_eq!(times(Reset::AdvanceLossy), [10, 40, 70]);
}

#[test]
fn after_a_jump_advance_catches_up_one_blind_time_at_a_time() {
    let pixel = Pixel { refractory_ns: MS, ..ideal_pixel() };
    let jump = Samples::jump(1.0, libm::exp(0.9));
    let times =
        |reset| events(pixel, reset, &jump, 20 * MS).iter().map(|event| event.t_in_ns).collect::<Vec<i64>>();
    assert_eq!(times(Reset::Resample).len(), 1);
    assert_eq!(times(Reset::AdvanceLossy).len(), 1);
    let caught_up = times(Reset::Advance);
    assert_eq!(caught_up.len(), 4); // 0.9 / 0.2
    assert!(caught_up.windows(2).all(|pair| pair[1] - pair[0] == MS));
}

#[test]
fn a_lost_crossing_moves_the_reference_of_the_lossy_rule_by_whole_thresholds() {
    // 0.9, then 0.15 more: 5.25 thresholds of which 4 were taken at the first jump, so 0.25 - 0.2 is left
    // over for a fifth.
    let second = |first: f64, second: f64| Samples {
        t_ns: vec![0, MS, MS + 1, 10 * MS, 10 * MS + 1],
        photocurrent: [0.0, 0.0, first, first, first + second].map(libm::exp).to_vec(),
    };
    let pixel = Pixel { refractory_ns: MS, ..ideal_pixel() };
    assert_eq!(events(pixel, Reset::AdvanceLossy, &second(0.9, 0.15), 20 * MS).len(), 2);
    assert_eq!(events(pixel, Reset::Resample, &second(0.9, 0.15), 20 * MS).len(), 1);
    assert_eq!(events(pixel, Reset::AdvanceLossy, &second(0.9, 0.05), 20 * MS).len(), 1);
}
