//! Failures put into recordings by hand, between known instants.

use super::super::integrity;
use super::super::tests::{bursts_on, with_changed_events};
use super::*;
use photocurrent_core::Extent;
use photocurrent_core::random::Random;
use photocurrent_scene::case::PixelEvent;

const EXTENT: Extent = Extent { width: 64, height: 48 };
/// When failures begin and end, ns.
const BEGIN: i64 = 100_000_000;
const END: i64 = 180_000_000;

fn nominal_case() -> Case {
    bursts_on(EXTENT, 5, 1000)
}

fn episodes_found(case: &Case) -> Vec<Episode> {
    episodes(case, &EventsByTime::from_case(case), (hot::hot_pixel_episodes(case), &[]), 0.0).0
}

/// The one failure that is found, which begins and ends within 2 ms of where it does.
fn single_episode(case: &Case, failure: Failure) -> Episode {
    let found = episodes_found(case);
    assert_eq!(found.iter().map(|one| one.failure).collect::<Vec<_>>(), [failure], "{found:?}");
    let [begin, end] = found[0].time_ns;
    assert!((begin - BEGIN).abs() <= 2_000_000 && (end - END).abs() <= 2_000_000, "{found:?}");
    found[0].clone()
}

fn is_inside(event: &PixelEvent) -> bool {
    (BEGIN..END).contains(&event.t_off_ns)
}

fn at(t_ns: i64, polarity: i8) -> PixelEvent {
    PixelEvent { t_in_ns: t_ns, t_off_ns: t_ns, polarity }
}

#[test]
fn a_nominal_recording_has_none() {
    assert_eq!(episodes_found(&nominal_case()), []);
}

#[test]
fn a_stalled_readout_is_found_with_its_gaps() {
    let stall = 5_000_000;
    let case = with_changed_events(nominal_case(), |_, events| {
        for event in events.iter_mut().filter(|event| is_inside(event)) {
            let released = BEGIN + ((event.t_off_ns - BEGIN) / stall + 1) * stall;
            *event = at(released.min(END - 1000), event.polarity);
        }
    });
    let one = single_episode(&case, Failure::Stall);
    assert!(one.seen.contains("16 gaps of 5.00 ms"), "{}", one.seen);
}

#[test]
fn packets_that_come_twice_are_found() {
    let twice = |from: i64, to: i64| {
        with_changed_events(nominal_case(), move |_, events| {
            let is_copied = |event: &&PixelEvent| {
                (from..to).contains(&event.t_off_ns) && event.t_off_ns / 1_000_000 % 4 == 0
            };
            let copies: Vec<PixelEvent> = events.iter().filter(is_copied).copied().collect();
            events.extend(copies);
            events.sort_by_key(|event| event.t_off_ns);
        })
    };
    let one = single_episode(&twice(BEGIN, END + 1_000_000), Failure::Copies);
    // A quarter comes twice, a fifth of all; the scene is a little busier in those milliseconds.
    assert!(one.seen.contains("have the pixel, stamp and sign of the one before (21 %)"), "{}", one.seen);
    assert!(one.rows[0] <= 1 && one.rows[1] >= 46 && one.columns[0] <= 1 && one.columns[1] >= 62);
    // What happens all the time is the reader's hazard.
    assert_eq!(episodes_found(&twice(0, i64::MAX)), []);
}

#[test]
fn stuck_signs_are_found_and_light_that_rises_everywhere_is_none() {
    let stuck = |share: f64| {
        let mut random = Random::new(3, &[]);
        with_changed_events(nominal_case(), move |_, events| {
            for event in events.iter_mut().filter(|event| is_inside(event)) {
                event.polarity = if random.uniform() < share { 1 } else { event.polarity };
            }
        })
    };
    let whole = single_episode(&stuck(1.0), Failure::Sign);
    assert!(whole.seen.starts_with("OFF events carry the sign of ON"), "{}", whole.seen);
    single_episode(&stuck(0.8), Failure::Sign);
    // Half of the array alone is the scene's.
    let half = with_changed_events(nominal_case(), |pixel, events| {
        for event in events.iter_mut().filter(|event| is_inside(event) && pixel % 64 < 32) {
            event.polarity = 1;
        }
    });
    assert_eq!(episodes_found(&half), []);
}

#[test]
fn a_rectangle_without_events_is_found_with_its_rows_and_columns() {
    let is_silent = |pixel: usize| (21..45).contains(&(pixel % 64)) && (9..34).contains(&(pixel / 64));
    let case = with_changed_events(nominal_case(), |pixel, events| {
        if is_silent(pixel) {
            events.retain(|event| !is_inside(event));
        }
    });
    let one = single_episode(&case, Failure::Lost);
    assert_eq!((one.rows, one.columns), ([9, 33], [21, 44]));
    // What leaves little by little is the scene's.
    let fading = with_changed_events(nominal_case(), |pixel, events| {
        let share = |t: i64| (((BEGIN - t) as f64) / 80e6).max((t - END) as f64 / 80e6).clamp(0.0, 1.0);
        let mut random = Random::new(7, &[pixel as u64]);
        if is_silent(pixel) {
            events.retain(|event| random.uniform() < share(event.t_off_ns));
        }
    });
    assert_eq!(episodes_found(&fading), []);
}

#[test]
fn a_burst_of_noise_is_found_and_one_of_a_sign_is_none() {
    let noisy = |sign: Option<i8>| {
        let mut random = Random::new(9, &[]);
        with_changed_events(nominal_case(), move |_, events| {
            for _ in 0..60 {
                let t = BEGIN + (random.uniform() * (END - BEGIN) as f64) as i64 / 1000 * 1000;
                let polarity = sign.unwrap_or(if random.uniform() < 0.5 { 1 } else { -1 });
                events.push(at(t, polarity));
            }
            events.sort_by_key(|event| event.t_off_ns);
        })
    };
    single_episode(&noisy(None), Failure::Noise);
    assert!(episodes_found(&noisy(Some(1))).iter().all(|one| one.failure != Failure::Noise));
}

#[test]
fn a_rhythm_for_a_while_is_found_with_its_frequency_and_its_part_of_the_array() {
    let is_lit = |pixel: usize| (13..50).contains(&(pixel % 64)) && (7..37).contains(&(pixel / 64));
    // Signs as those of the slope of light that goes up and down at 110 Hz, events as often as it is steep.
    let lit = |is_one: bool| {
        let mut random = Random::new(13, &[]);
        with_changed_events(nominal_case(), move |pixel, events| {
            let lag = if is_one { 0.0 } else { 0.4 * (pixel % 64) as f64 };
            for _ in 0..if is_lit(pixel) { 60 } else { 0 } {
                let t = BEGIN + (random.uniform() * (END - BEGIN) as f64) as i64 / 1000 * 1000;
                let slope = libm::cos(std::f64::consts::TAU * 110.0 * t as f64 * 1e-9 + lag);
                if random.uniform() < slope.abs() {
                    events.push(at(t, if slope > 0.0 { 1 } else { -1 }));
                }
            }
            events.sort_by_key(|event| event.t_off_ns);
        })
    };
    let case = lit(true);
    let found_one = single_episode(&case, Failure::Rhythm);
    assert_eq!((found_one.rows, found_one.columns), ([7, 36], [13, 49]));
    let (_, rhythm) = episodes(&case, &EventsByTime::from_case(&case), (Vec::new(), &[]), 0.0);
    let rhythm::EventRhythm { hz, amplitude, .. } = rhythm.unwrap();
    assert!((hz - 110.0).abs() < 0.5, "{hz}");
    // 60 events in 80 ms, as many as the slope in the mean: 2/pi; |cos| has cos^2 = 1/2 in the mean.
    let expected = 60.0 / 0.08;
    // Of 42,000 events: a standard error of half a percent, and the scene's own.
    assert!((amplitude / expected - 1.0).abs() < 0.02, "{amplitude} of {expected}");
    // The light's, with its place, and no noise.
    let of_all = integrity(&case, Some(&case.nominal().unwrap()));
    let [flicker] = &of_all.scene[..] else { panic!("{:?}", of_all.scene) };
    assert_eq!((flicker.rows, flicker.columns), (Some([7, 36]), Some([13, 49])));
    assert_eq!(flicker.time_ns, Some(found_one.time_ns));
    assert!(of_all.findings.iter().all(|finding| finding.id != "background_activity"));
    // A rhythm that runs across the array is something that moves.
    assert!(episodes_found(&lit(false)).iter().all(|one| one.failure != Failure::Rhythm));
}

#[test]
fn pixels_that_are_hot_for_a_while_are_found_together() {
    let hot = [700, 1500, 2222];
    let mut random = Random::new(11, &[]);
    let case = with_changed_events(nominal_case(), |pixel, events| {
        if hot.contains(&pixel) {
            let mut t = BEGIN as f64;
            while t < END as f64 {
                events.push(at(t as i64, 1));
                t += 1e5 * (0.8 + 0.4 * random.uniform());
            }
            events.sort_by_key(|event| event.t_off_ns);
        }
    });
    let one = single_episode(&case, Failure::Hot);
    assert_eq!(one.pixels, hot.map(|pixel| pixel as u32));
}
