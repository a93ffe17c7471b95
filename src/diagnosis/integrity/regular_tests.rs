//! Rates that a scene cannot have, thinned by hand out of a scene's.

use super::regular::dependences;
use crate::covariates::Covariate;
use photocurrent_core::random::Random;
use photocurrent_core::{Exposure, Extent, FrameTimes};
use photocurrent_scene::case::{Case, CaseFrames, PixelEvent, PixelEvents};

const PERIOD_NS: i64 = 8_000_000;
const ROW_NS: i64 = 40_000;

/// 48 x 36 pixels that see waves for 20 frames; an event of a row, at an instant, of a sign stays with the
/// chance that `keep` gives it.
fn waves(keep: impl Fn(u32, i64, i8) -> f64) -> Case {
    let extent = Extent { width: 48, height: 36 };
    let mut random = Random::new(8, &[2]);
    let pixels = (0..extent.pixels()).map(|pixel| {
        let (x, y) = (pixel as u32 % 48, pixel as u32 / 48);
        let mut events = Vec::new();
        let mut t = 0;
        while t < 20 * PERIOD_NS {
            t += (-3e6 * libm::log(1.0 - random.uniform())) as i64;
            let wave = 0.6 + 0.4 * libm::sin(0.4 * f64::from(x) + 0.3 * f64::from(y) - t as f64 * 2e-7);
            let sign = if random.uniform() < 0.5 { 1 } else { -1 };
            if random.uniform() < wave * keep(y, t, sign) {
                events.push(PixelEvent { t_in_ns: t, t_off_ns: t, polarity: sign });
            }
        }
        events
    });
    let exposures: Vec<Exposure> =
        (0..20).map(|l| Exposure::new(l * PERIOD_NS, l * PERIOD_NS + 4_000_000)).collect();
    let frames =
        CaseFrames::new(FrameTimes::new(exposures, ROW_NS).unwrap(), vec![500.0; 20 * extent.pixels()]);
    let sensor = crate::testing::sensor();
    Case {
        extent,
        span: (0, 20 * PERIOD_NS),
        events: PixelEvents::new(pixels),
        has_t_in: true,
        t_resolution_ns: 1,
        frames: Some(frames),
        sensor,
    }
}

/// Is it between 4 and 5 ms after the start of the exposure of a row?
fn is_blind(row: u32, t: i64) -> bool {
    (4_000_000..5_000_000).contains(&(t - i64::from(row) * ROW_NS).rem_euclid(PERIOD_NS))
}

#[test]
fn a_scene_alone_has_no_such_dependence() {
    assert_eq!(dependences(&waves(|_, _, _| 1.0), &[]), []);
}

#[test]
fn events_that_stay_away_at_one_phase_of_every_row_are_reported_with_that_phase() {
    let found = dependences(&waves(|row, t, _| if is_blind(row, t) { 0.3 } else { 1.0 }), &[]);
    let [dependence] = &found[..] else { panic!("{found:?}") };
    assert_eq!(dependence.covariate, Covariate::FramePhase);
    for (at, value) in dependence.at.iter().zip(&dependence.value) {
        // Of 13 bins around the dip, its four hold 0.3: 0.3 / (1 - 0.7 * 4 / 13) less 1, or near that.
        if (4e-3..5e-3).contains(at) {
            assert!((value + 0.62).abs() < 0.08, "{at} {value}")
        } else {
            assert!(*value > -0.1 && *value < 0.4, "{at} {value}")
        }
    }
    assert!(
        dependence.error.iter().all(|error| *error < 0.05)
            && dependence.taken > 0.5
            && dependence.nats_per_event > 0.01,
        "{dependence:?}"
    );
}

#[test]
fn events_of_one_sign_at_one_phase_are_the_coupling_s() {
    let more = |signs: &'static [i8]| {
        waves(move |row, t, sign| if is_blind(row, t) && signs.contains(&sign) { 1.0 } else { 0.5 })
    };
    assert_eq!(dependences(&more(&[1]), &[]), []);
    assert_eq!(dependences(&more(&[1, -1]), &[]).len(), 1);
}

#[test]
fn light_that_flickers_with_the_frames_is_the_scene_s() {
    assert_eq!(dependences(&waves(|_, t, _| if is_blind(0, t) { 0.3 } else { 1.0 }), &[]), []);
    // Nor can it be distinguished where all rows have one clock.
    let mut global = waves(|_, t, _| if is_blind(0, t) { 0.3 } else { 1.0 });
    let frames = global.frames.as_mut().unwrap();
    frames.times = FrameTimes::new(frames.times.exposures.to_vec(), 0).unwrap();
    assert_eq!(dependences(&global, &[]), []);
}

#[test]
fn rows_that_differ_by_parity_are_reported_with_their_share() {
    let found = dependences(&waves(|row, _, _| if row % 2 == 1 { 0.8 } else { 1.0 }), &[]);
    let [dependence] = &found[..] else { panic!("{found:?}") };
    assert_eq!(dependence.covariate, Covariate::RowParity);
    // (1 - 0.8) / (1 + 0.8)
    assert!(
        (dependence.value[0] - 0.111).abs() < 0.02
            && (dependence.value[1] + dependence.value[0]).abs() < 1e-12,
        "{dependence:?}"
    );
    assert!(dependence.nats_per_event > 0.003 && dependence.error[0] < 0.02, "{dependence:?}");
    // Some busy rows are no parity.
    let busy = waves(|row, _, _| if [6, 14, 22, 30].contains(&row) { 1.0 } else { 0.6 });
    assert_eq!(dependences(&busy, &[]), []);
}
