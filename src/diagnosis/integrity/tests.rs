//! The direct tests on recordings whose fault was put in by hand, not by the effects of the catalogue.

use super::*;
use photocurrent_core::Extent;
use photocurrent_core::random::Random;
use photocurrent_scene::case::{PixelEvent, PixelEvents};

/// 24 x 20 pixels that see a wave at 30 Hz: bursts of five events of a sign, some milliseconds apart, at
/// times of their own in each pixel.
fn bursts(step_ns: i64) -> Case {
    bursts_on(Extent { width: 24, height: 20 }, 5, step_ns)
}

/// On an array of another size, with a seed.
pub(super) fn bursts_on(extent: Extent, seed: u64, step_ns: i64) -> Case {
    let mut random = Random::new(seed, &[1]);
    let pixels = (0..extent.pixels()).map(|_| {
        let mut events = Vec::new();
        let mut t = (random.uniform() * 30e6) as i64;
        let mut polarity = 1;
        while t < 290_000_000 {
            for _ in 0..5 {
                let stamp = t - t.rem_euclid(step_ns);
                events.push(PixelEvent { t_in_ns: stamp, t_off_ns: stamp, polarity });
                t += 2_000_000 + (random.uniform() * 1e6) as i64;
            }
            t += 5_000_000 + (random.uniform() * 1e6) as i64;
            polarity = -polarity;
        }
        events
    });
    let base = crate::testing::case();
    Case {
        extent,
        span: (0, 300_000_000),
        events: PixelEvents::new(pixels),
        has_t_in: false,
        t_resolution_ns: 1000,
        frames: None,
        sensor: base.sensor,
    }
}

/// With events changed pixel by pixel.
pub(super) fn with_changed_events(
    mut case: Case,
    mut change: impl FnMut(usize, &mut Vec<PixelEvent>),
) -> Case {
    let pixels: Vec<Vec<PixelEvent>> = (0..case.events.pixels())
        .map(|pixel| {
            let mut events = case.events.of_pixel(pixel).to_vec();
            change(pixel, &mut events);
            events
        })
        .collect();
    case.events = PixelEvents::new(pixels);
    case
}

pub(super) fn add(events: &mut Vec<PixelEvent>, random: &mut Random, count: usize, polarity: i8) {
    for _ in 0..count {
        let t = (random.uniform() * 3e5) as i64 * 1000;
        events.push(PixelEvent { t_in_ns: t, t_off_ns: t, polarity });
    }
}

fn direct_tests(case: &Case) -> Integrity {
    integrity(case, case.nominal().ok().as_ref())
}

fn single_departure<'a>(found: &'a Integrity, id: &str) -> &'a Departure {
    assert_eq!(found.findings.iter().map(|finding| finding.id).collect::<Vec<_>>(), [id]);
    &found.findings[0]
}

fn value(finding: &Departure, parameter: &str) -> f64 {
    finding.parameters.iter().find(|(name, _)| *name == parameter).unwrap().1
}

#[test]
fn a_nominal_recording_gives_no_finding() {
    let found = direct_tests(&bursts(1000));
    assert_eq!(found.findings, []);
    assert!(found.broken.is_empty() && found.masked.is_empty(), "{found:?}");
}

#[test]
fn a_coarser_grid_is_found_with_its_step() {
    let finding = direct_tests(&bursts(115_000));
    assert!((value(single_departure(&finding, "timestamp_quantization"), "step") - 115e-6).abs() < 1e-9);
}

#[test]
fn a_clock_that_runs_slow_is_no_coarser_grid() {
    // 0.5 % slow: the stated grid of 1 us becomes one of 0.995 us.
    let case = with_changed_events(bursts(1000), |_, events| {
        events.iter_mut().for_each(|event| {
            event.t_in_ns = event.t_in_ns / 1000 * 995;
            event.t_off_ns = event.t_in_ns;
        });
    });
    assert_eq!(direct_tests(&case).findings, []);
}

#[test]
fn stamps_off_their_grid_are_jitter() {
    let mut random = Random::new(6, &[]);
    let case = with_changed_events(bursts(1000), |_, events| {
        events.iter_mut().for_each(|event| {
            event.t_in_ns += (30e3 * random.normal()) as i64;
            event.t_off_ns = event.t_in_ns;
        });
    });
    single_departure(&direct_tests(&case), "timestamp_jitter");
}

#[test]
fn hot_rows_are_not_called_hot_pixels() {
    let mut random = Random::new(7, &[]);
    let case = with_changed_events(bursts(1000), |pixel, events| {
        if pixel / 24 == 9 {
            add(events, &mut random, 40, 1);
        }
    });
    let found = direct_tests(&case);
    let rows = single_departure(&found, "hot_rows");
    assert_eq!(rows.pixels, (9 * 24..10 * 24).collect::<Vec<u32>>());
    assert!((value(rows, "rate") / (40.0 / 0.3) - 1.0).abs() < 0.1, "{rows:?}");
    assert_eq!(found.masked, rows.pixels);
}

#[test]
fn hot_pixels_are_found_with_their_rate() {
    let mut random = Random::new(8, &[]);
    let case = with_changed_events(bursts(1000), |pixel, events| {
        if pixel == 100 || pixel == 333 {
            add(events, &mut random, 200, -1);
        }
    });
    let found = direct_tests(&case);
    let hot = single_departure(&found, "hot_pixels");
    assert_eq!(hot.pixels, [100, 333]);
    assert!((value(hot, "rate") / (200.0 / 0.3) - 1.0).abs() < 0.1, "{hot:?}");
    assert_eq!(found.masked, [100, 333]);
}

#[test]
fn a_row_at_the_rim_is_held_against_nothing() {
    let mut random = Random::new(7, &[]);
    let case = with_changed_events(bursts(1000), |pixel, events| {
        if pixel / 24 == 0 {
            add(events, &mut random, 40, 1);
        }
    });
    assert!(direct_tests(&case).findings.iter().all(|finding| finding.id != "hot_rows"));
}

/// Frames every 10 ms that see what the events add up to, as a light would have it.
fn with_its_frames(mut case: Case) -> Case {
    let nominal = case.nominal().unwrap();
    let times: Vec<i64> = (1..28).map(|l| l * 10_000_000).collect();
    let exposures = times.iter().map(|t| photocurrent_core::Exposure::new(*t, *t + 1_000)).collect();
    let step =
        |polarity: i8| if polarity > 0 { nominal.pixel.threshold_on } else { -nominal.pixel.threshold_off };
    let sum = |pixel: usize, t_ns: i64| {
        case.events
            .of_pixel(pixel)
            .iter()
            .filter(|event| event.t_in_ns < t_ns)
            .map(|event| step(event.polarity))
            .sum::<f64>()
    };
    let dn = times
        .iter()
        .flat_map(|t| (0..case.extent.pixels()).map(|pixel| (200.0 * libm::exp(sum(pixel, *t))) as f32))
        .collect();
    case.frames = Some(photocurrent_scene::case::CaseFrames::new(
        photocurrent_core::FrameTimes::new(exposures, 0).unwrap(),
        dn,
    ));
    case
}

#[test]
fn a_pixel_that_sees_more_than_its_neighbours_is_not_hot() {
    let mut random = Random::new(8, &[]);
    let mut busy = |share: f64| {
        with_changed_events(bursts(1000), |pixel, events| {
            if pixel == 100 {
                // Pairs of both signs, so that its light stays where it is on average.
                for n in 0..(200.0 * share) as i64 {
                    let t = (random.uniform() * 2.9e5) as i64 * 1000;
                    let polarity = if n % 2 == 0 { 1 } else { -1 };
                    events.push(PixelEvent { t_in_ns: t, t_off_ns: t, polarity });
                }
            }
        })
    };
    let is_hot = |case: &Case| direct_tests(case).findings.iter().any(|finding| finding.id == "hot_pixels");
    let case = busy(1.0);
    let seen = with_its_frames(case.clone());
    assert!(!is_hot(&seen));
    // The same events over frames that know nothing of them.
    assert!(is_hot(&Case { frames: with_its_frames(bursts(1000)).frames, ..case }));
}

#[test]
fn a_light_that_blinks_once_is_no_hot_pixel() {
    let case = with_changed_events(bursts(1000), |pixel, events| {
        if pixel == 100 {
            events.extend((0..200).map(|k| PixelEvent {
                t_in_ns: 120_000_000 + k * 90_000,
                t_off_ns: 120_000_000 + k * 90_000,
                polarity: 1,
            }));
        }
    });
    assert!(direct_tests(&case).findings.iter().all(|finding| finding.id != "hot_pixels"));
}

#[test]
fn random_events_of_both_signs_are_background_activity() {
    let mut random = Random::new(9, &[]);
    let case = with_changed_events(bursts(1000), |_, events| {
        add(events, &mut random, 2, 1);
        add(events, &mut random, 2, -1);
    });
    let found = direct_tests(&case);
    let rate = value(single_departure(&found, "background_activity"), "rate");
    // Four in 0.3 s; the estimate comes from the few that stand right after an event.
    assert!(rate > 5.0 && rate < 30.0, "{rate}");
}

/// 24 x 20 pixels over which a wide wave moves: bursts of ten events of a sign, at nearly the same times in
/// neighbours.
fn wide_wave() -> Case {
    wide_wave_on(bursts(1000), 15)
}

/// Instead of the events of another recording, with a seed.
pub(super) fn wide_wave_on(case: Case, seed: u64) -> Case {
    let mut random = Random::new(seed, &[1]);
    let width = case.extent.width as usize;
    with_changed_events(case, |pixel, events| {
        events.clear();
        let (mut t, mut polarity) = (1_000_000 + (pixel % width) as i64 * 400_000, 1);
        while t < 290_000_000 {
            for _ in 0..10 {
                let stamp = (t + (random.uniform() * 3e5) as i64) / 1000 * 1000;
                events.push(PixelEvent { t_in_ns: stamp, t_off_ns: stamp, polarity });
                t += 2_500_000;
            }
            t += 6_000_000;
            polarity = -polarity;
        }
    })
}

#[test]
fn events_against_the_light_are_noise_with_its_rate() {
    assert_eq!(direct_tests(&wide_wave()).findings, []);
    let mut random = Random::new(16, &[]);
    let noisy = |on: usize, off: usize, random: &mut Random| {
        with_changed_events(wide_wave(), |_, events| {
            add(events, random, on, 1);
            add(events, random, off, -1);
        })
    };
    // Three of each sign in 0.3 s: 20 a second and pixel.
    let found = contrary::noise(&noisy(3, 3, &mut random), &[]).unwrap();
    assert!((value(&found, "rate") / 20.0 - 1.0).abs() < 0.3, "{found:?}");
    assert_eq!(found.polarity, "both");
    let found = contrary::noise(&noisy(5, 0, &mut random), &[]).unwrap();
    assert!((value(&found, "rate") / 16.7 - 1.0).abs() < 0.3, "{found:?}");
    assert_eq!(found.polarity, "on");
    // All from one corner: something there, but not noise of all pixels.
    let corner = with_changed_events(wide_wave(), |pixel, events| {
        if pixel == 26 || pixel == 52 {
            add(events, &mut random, 60, 1);
            add(events, &mut random, 60, -1);
        }
    });
    assert!(contrary::noise(&corner, &[]).is_none());
}

#[test]
fn a_strong_impulse_at_the_readout_shows_where_all_moves() {
    let exposures = (0..15)
        .map(|l| photocurrent_core::Exposure::new(l * 20_000_000, l * 20_000_000 + 4_000_000))
        .collect();
    let frames = photocurrent_scene::case::CaseFrames::new(
        photocurrent_core::FrameTimes::new(exposures, 0).unwrap(),
        // No pixel stands still.
        (0..15 * 480).map(|k| 100.0 + 40.0 * ((k / 480) % 2) as f32 + (k % 7) as f32).collect(),
    );
    let quiet = Case { frames: Some(frames), ..bursts(1000) };
    assert!(direct_tests(&quiet).findings.is_empty());
    // ON events 9.1 ms after the start of the frame, 100 us later from row to row; the others are of the
    // scene, OFF more often than ON.
    let coupled = with_changed_events(quiet, |pixel, events| {
        events.retain(|event| event.polarity < 0 || event.t_in_ns % 3_000 == 0);
        events.extend((0..15).map(|l| {
            let t = l * 20_000_000 + 9_100_000 + (pixel / 24) as i64 * 100_000;
            PixelEvent { t_in_ns: t, t_off_ns: t, polarity: 1 }
        }));
    });
    let found = direct_tests(&coupled);
    let coupling = found
        .findings
        .iter()
        .find(|finding| finding.id == "frame_coupling")
        .unwrap_or_else(|| panic!("{found:?}"));
    assert_eq!(coupling.polarity, "on");
    assert!(
        (value(coupling, "row_time") - 100e-6).abs() < 2e-6
            && (value(coupling, "phase") - 9.1e-3).abs() < 0.3e-3,
        "{coupling:?}"
    );
}

#[test]
fn windows_that_are_full_have_lost_events() {
    let case = bursts(1000);
    let stream = EventsByTime::from_case(&case);
    let mut kept = std::collections::BTreeMap::<i64, usize>::new();
    let mut lost = 0;
    let mut pixels = vec![Vec::new(); case.extent.pixels()];
    for event in &stream.0 {
        let window = kept.entry(event.t_ns / 2_000_000).or_default();
        if *window == 150 {
            lost += 1;
            continue;
        }
        *window += 1;
        pixels[event.pixel as usize].push(PixelEvent {
            t_in_ns: event.t_ns,
            t_off_ns: event.t_ns,
            polarity: event.polarity,
        });
    }
    let share = lost as f64 / stream.0.len() as f64;
    let capped = Case { events: PixelEvents::new(pixels), ..case };
    let found = direct_tests(&capped);
    let estimate = value(single_departure(&found, "event_loss"), "fraction");
    assert!(share > 0.1 && (estimate / share - 1.0).abs() < 0.2, "{estimate} {share}");
}

#[test]
fn a_row_that_waits_for_the_other_is_a_queue() {
    // Groups of six rows that leave 3 us apart, at times off any common grid.
    let mut turn = 0;
    let case = with_changed_events(bursts(1000), |_, events| {
        events.iter_mut().for_each(|event| {
            turn += 1;
            event.t_off_ns = event.t_off_ns / 200_000 * 200_000
                + (event.t_off_ns / 200_000 * 37) % 91 * 1000
                + turn % 6 * 3000;
            event.t_in_ns = event.t_off_ns;
        });
    });
    let found = direct_tests(&case);
    let queue = found
        .findings
        .iter()
        .find(|finding| finding.id == "readout_queue")
        .unwrap_or_else(|| panic!("{found:?}"));
    assert!((value(queue, "service") - 3e-6).abs() < 1e-9);
}

#[test]
fn events_before_the_blind_time_is_over_contradict_it() {
    let mut case = bursts(1000);
    // Intervals are 2 to 3 ms; the description states 2.5 ms.
    case.sensor.readout.refractory = Some(photocurrent_core::quantity::Duration::new(2_500_000));
    let found = direct_tests(&case);
    let blind = value(single_departure(&found, "refractory"), "refractory");
    assert!((blind - 2e-3).abs() < 0.1e-3, "{blind}");
}

#[test]
fn broken_and_insufficient_data_are_reported() {
    let stopped = with_changed_events(bursts(1000), |_, events| {
        events.iter_mut().for_each(|event| {
            event.t_in_ns = 7;
            event.t_off_ns = 7;
        });
    });
    assert!(direct_tests(&stopped).broken.iter().any(|why| why.contains("one and the same time")));
    let early = Case {
        has_t_in: true,
        ..with_changed_events(bursts(1000), |_, events| {
            events.iter_mut().for_each(|event| event.t_off_ns -= 5000)
        })
    };
    assert!(direct_tests(&early).broken.iter().any(|why| why.contains("before they fire")));
    // Microseconds that were read as nanoseconds.
    let mut fast = with_changed_events(bursts(1000), |_, events| {
        events.iter_mut().for_each(|event| {
            event.t_in_ns /= 1000;
            event.t_off_ns /= 1000;
        });
    });
    fast.span = (fast.span.0 / 1000, fast.span.1 / 1000);
    assert!(
        direct_tests(&fast).broken.iter().any(|why| why.contains("of a larger unit")),
        "{:?}",
        direct_tests(&fast).broken
    );
    let few = with_changed_events(bursts(1000), |pixel, events| events.truncate(usize::from(pixel < 20)));
    let found = direct_tests(&few);
    assert!(
        found.broken.is_empty() && found.lacking.iter().any(|why| why.starts_with("20 events")),
        "{found:?}"
    );
    let mut dark = crate::testing::case();
    dark.frames = dark.frames.map(|frames| frames.map(|_, _| 0.0));
    assert!(direct_tests(&dark).broken.iter().any(|why| why.contains("hold no picture")));
}

#[test]
fn frames_that_no_light_makes_are_broken() {
    let of_frames = |change: &dyn Fn(usize, &mut f32)| {
        let mut case = crate::testing::case();
        case.frames = case.frames.map(|frames| {
            frames.map(|k, mut dn| {
                change(k, &mut dn);
                dn
            })
        });
        direct_tests(&case).broken.join("; ")
    };
    assert_eq!(of_frames(&|_, _| {}), "");
    assert!(of_frames(&|_, dn| *dn = -*dn).contains("are negative"));
    assert!(
        of_frames(&|k, dn| if k == 17 {
            *dn = f32::INFINITY
        })
        .starts_with("1 of 840 frame values are infinite")
    );
    assert!(of_frames(&|_, dn| *dn = f32::NAN).contains("are not numbers"));
    // Single values may be marked as not known, and noise may go below zero.
    assert_eq!(
        of_frames(&|k, dn| if k % 9 == 0 {
            *dn = f32::NAN
        } else if k % 5 == 0 {
            *dn = -0.5
        }),
        ""
    );
}

#[test]
fn bursts_in_step_with_the_frames_are_coupling() {
    let extent_pixels = 480;
    let exposures = (0..15)
        .map(|l| photocurrent_core::Exposure::new(l * 20_000_000, l * 20_000_000 + 4_000_000))
        .collect();
    let frames = photocurrent_scene::case::CaseFrames::new(
        photocurrent_core::FrameTimes::new(exposures, 0).unwrap(),
        (0..15 * extent_pixels).map(|k| 100.0 + (k % 7) as f32).collect(),
    );
    let quiet = Case { frames: Some(frames), ..bursts(1000) };
    assert_eq!(direct_tests(&quiet).findings, []);
    let coupled = with_changed_events(quiet, |pixel, events| {
        if pixel % 4 == 0 {
            events.extend((0..15).map(|l| {
                let t = l * 20_000_000 + 9_100_000 + pixel as i64 * 300;
                PixelEvent { t_in_ns: t, t_off_ns: t, polarity: 1 }
            }));
        }
    });
    let found = direct_tests(&coupled);
    let coupling = found
        .findings
        .iter()
        .find(|finding| finding.id == "frame_coupling")
        .unwrap_or_else(|| panic!("{found:?}"));
    assert_eq!(coupling.polarity, "on");
}

#[test]
fn a_rhythm_common_to_all_pixels_is_the_lights_and_no_finding() {
    // Log light 0.4 sin(2 pi 100 t) with thresholds 0.2 and 0.21: ON while it rises, OFF while it falls, at
    // phases of each pixel's own.
    let mut random = Random::new(11, &[]);
    let case = with_changed_events(bursts(1000), |_, events| {
        events.clear();
        for period in 0..30 {
            for (polarity, centre) in [(1, 0), (-1, 5_000_000)] {
                for _ in 0..3 {
                    let t = period * 10_000_000 + centre + ((random.uniform() - 0.5) * 4e6) as i64;
                    if t >= 0 {
                        events.push(PixelEvent {
                            t_in_ns: t / 1000 * 1000,
                            t_off_ns: t / 1000 * 1000,
                            polarity,
                        });
                    }
                }
            }
        }
    });
    let found = direct_tests(&case);
    assert_eq!(found.scene.len(), 1, "{found:?}");
    assert!((found.scene[0].frequency_hz - 100.0).abs() < 2.0, "{found:?}");
    assert!(direct_tests(&bursts(1000)).scene.is_empty());
}

#[test]
fn clocks_that_share_no_time_are_broken_data_with_both_times_in_the_message() {
    let mut case = crate::testing::case();
    let moved = |event: &PixelEvent| PixelEvent {
        t_in_ns: event.t_in_ns + 5_000_000_000,
        t_off_ns: event.t_off_ns + 5_000_000_000,
        ..*event
    };
    case.events = PixelEvents::new(
        (0..case.events.pixels()).map(|pixel| case.events.of_pixel(pixel).iter().map(moved).collect()),
    );
    case.span = (0, 5_100_000_000);
    let why = data::unusable_data(&case);
    assert!(
        why.len() == 1
            && why[0].contains("share no time")
            && why[0].contains("frames are exposed 0.000000 to"),
        "{why:?}"
    );
}
