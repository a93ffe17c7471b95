//! Recordings with known truth, made by the simulator: textures that move over a small array, frames that are
//! true means of the light.

use super::*;
use crate::forward::{LinearLight, Noiseless, Pixel, simulate_events};
use crate::front_end::FrontEnd;
use photocurrent_core::random::Random;

const WIDTH: u32 = 48;
const HEIGHT: u32 = 32;
const PERIOD_NS: i64 = 20_000_000;
const FRAMES: usize = 9;

/// How a recording is made.
#[derive(Clone, Copy)]
struct Made {
    /// Thresholds.
    on: f64,
    off: f64,
    /// Added to the events' stamps, ns, and more of it with time, ns a second.
    late_ns: i64,
    drift_ns_per_s: f64,
    exposure_ns: i64,
    row_time_ns: i64,
    /// Pixels a second.
    speed: f64,
    /// Time constant of the front end times photocurrent, s.
    alpha_s: f64,
    /// Share of events that are lost, and of noise events that are added; stamps wander by as many periods.
    noise: f64,
}

const PLAIN: Made = Made {
    on: 0.2,
    off: 0.2,
    late_ns: 0,
    drift_ns_per_s: 0.0,
    exposure_ns: 2_000_000,
    row_time_ns: 0,
    speed: 250.0,
    alpha_s: 0.0,
    noise: 0.0,
};

/// Logarithm of the light: waves that drift, of several lengths so that nothing repeats from frame to frame.
fn log_light(made: &Made, x: f64, y: f64, t_ns: f64) -> f64 {
    let x = x - made.speed * t_ns * 1e-9;
    1.0 + 0.55 * libm::sin(0.41 * x + 0.23 * y)
        + 0.35 * libm::sin(0.17 * x - 0.31 * y + 1.0)
        + 0.25 * libm::sin(0.73 * x + 0.11 * y + 2.0)
}

/// Events and frames; with `states` the front end is stated.
fn stated(made: Made, states: bool) -> Panel {
    let mut panel = Panel::new(&(0..WIDTH * HEIGHT).collect::<Vec<u32>>(), WIDTH, HEIGHT);
    let mids: Vec<i64> = (0..FRAMES as i64).map(|l| 30_000_000 + l * PERIOD_NS).collect();
    let mut stretch = Stretch::new(mids.clone(), PERIOD_NS + PERIOD_NS / 4, PERIOD_NS / 64, panel.places());
    let end_ns = 60_000_000 + FRAMES as i64 * PERIOD_NS;
    let pixel = Pixel {
        front_end: FrontEnd { tau_0_s: 0.0, alpha_s: made.alpha_s },
        threshold_on: made.on,
        threshold_off: made.off,
        latency_ns: 0,
        latency_spread_ns: 0.0,
        refractory_ns: 0,
        log_step: 0.1,
    };
    let mut random = Random::new(7, &[]);
    let (mut centring, mut late) = (Centring::new(panel.places(), PERIOD_NS / 4), Vec::new());
    let t_ns: Vec<i64> = (0..=end_ns / 250_000).map(|n| n * 250_000).collect();
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let place = (y * WIDTH + x) as usize;
            let light: Vec<f64> =
                t_ns.iter().map(|t| libm::exp(log_light(&made, x.into(), y.into(), *t as f64))).collect();
            let mut events: Vec<(i64, bool)> = Vec::new();
            for event in simulate_events(&pixel, &LinearLight::new(&t_ns, &light), 0, end_ns, &mut Noiseless)
            {
                let wander = (made.noise * PERIOD_NS as f64 * random.normal()) as i64;
                if random.uniform() >= made.noise {
                    events.push((event.t_in_ns + wander, event.polarity > 0));
                }
                if random.uniform() < made.noise {
                    events.push(((random.uniform() * end_ns as f64) as i64, random.uniform() < 0.5));
                }
            }
            events.sort_unstable();
            for (t_in_ns, was_on) in events {
                let t = t_in_ns + made.late_ns + (made.drift_ns_per_s * t_in_ns as f64 * 1e-9) as i64;
                late.extend(centring.next(place, t, was_on).map(|(t, is_on)| (t, place, is_on)));
            }
            for (frame, mid) in mids.iter().enumerate() {
                let start = (mid - made.exposure_ns / 2 + i64::from(y) * made.row_time_ns) as f64;
                let instants = (0..40).map(|n| start + (f64::from(n) + 0.5) / 40.0 * made.exposure_ns as f64);
                let mean =
                    instants.map(|t| libm::exp(log_light(&made, x.into(), y.into(), t)) / 40.0).sum::<f64>();
                stretch.frame_mut(frame)[place] = libm::log(mean) as f32;
            }
        }
    }
    late.extend(centring.rest().map(|(place, t, is_on)| (t, place, is_on)));
    if states {
        // Frames read the photocurrent itself.
        let delay =
            Delay::new(FrontEnd { tau_0_s: 0.0, alpha_s: made.alpha_s }, 1.0, 1e9, 0.5 * PERIOD_NS as f64)
                .unwrap();
        (0..FRAMES).for_each(|frame| stretch.delay(frame, |log| delay.ns(libm::exp(f64::from(log)))));
    }
    for (t, place, is_on) in late {
        let lag_ns = stretch.lag_ns(t, place);
        stretch.event(t - lag_ns as i64, place, is_on);
    }
    panel.stretches.push(stretch);
    panel
}

fn panel(made: Made) -> Panel {
    stated(made, false)
}

fn exactly(value: f64) -> Estimate {
    Estimate { value, ci95: (value, value) }
}

/// The interval holds the truth, or misses it by less than `slack`, and is no wider than `widest`.
fn near(found: &Estimate, truth: f64, slack: f64, widest: f64) {
    assert!(found.holds(truth) || (found.value - truth).abs() < slack, "{found:?}, truth {truth}");
    assert!(found.ci95.1 - found.ci95.0 < widest, "{found:?} is wide");
}

#[test]
fn late_events_are_as_late_as_they_were_made() {
    for late_ns in [0, 6_000_000, -3_500_000] {
        let found = offset(&panel(Made { late_ns, ..PLAIN })).unwrap();
        // An event every three milliseconds or so: a tenth of that is the step that a shift can be reported
        // from.
        near(&found.ns, late_ns as f64, 300_000.0, 1_000_000.0);
        assert!(found.correlation > 0.9, "{found:?}");
    }
}

/// tau = alpha / i: 1 to 11 ms for a photocurrent of 0.9 to 9. Of light that goes up and down that fast a
/// part of it is not certain.
#[test]
fn the_delay_of_a_stated_front_end_is_subtracted() {
    let slow = Made { alpha_s: 10e-3, ..PLAIN };
    let (unknown, known) =
        (offset(&stated(slow, false)).unwrap().ns, offset(&stated(slow, true)).unwrap().ns);
    assert!(unknown.value > 2e6 && known.value.abs() < 0.5 * unknown.value, "{unknown:?} {known:?}");
    // What is late beyond it is left.
    let late = offset(&stated(Made { late_ns: 3_000_000, ..slow }, true)).unwrap().ns;
    assert!((late.value - known.value - 3e6).abs() < 0.8e6, "{late:?}");
}

#[test]
fn a_delay_takes_its_light_from_frames() {
    let front_end = FrontEnd { tau_0_s: 1e-4, alpha_s: 2e-2 };
    let delay = Delay::new(front_end, 500.0, 4e6, 5e6).unwrap();
    // 100 DN of 500 DN a second and unit over 4 ms: a photocurrent of 50.
    assert!((delay.ns(100.0) - 5e5).abs() < 1.0);
    assert_eq!((delay.ns(0.0), delay.ns(-3.0)), (5e6, 5e6));
    assert_eq!(Delay::new(front_end, 0.0, 4e6, 5e6), None);
}

#[test]
fn nothing_that_moves_gives_no_offset() {
    assert_eq!(offset(&panel(Made { speed: 0.0, ..PLAIN })), None);
    assert_eq!(offset(&Panel::default()), None);
}

#[test]
fn clocks_that_drift_apart_do_so_at_their_rate() {
    let found = drift(&panel(Made { drift_ns_per_s: 30e6, ..PLAIN })).unwrap();
    near(&found.ns_per_s, 30e6, 8e6, 40e6);
    assert!(
        found.halves_ns_per_s.0 > 15e6
            && found.halves_ns_per_s.1 > 15e6
            && found.correlation > found.correlation_at_none,
        "{found:?}"
    );
    let none = drift(&panel(PLAIN)).unwrap();
    assert!(none.ns_per_s.holds(0.0) || none.ns_per_s.value.abs() < 6e6, "{none:?}");
}

#[test]
fn rows_that_are_read_one_after_another_give_their_delay() {
    let found = row_time(&panel(Made { row_time_ns: 100_000, late_ns: -1_000_000, ..PLAIN })).unwrap();
    near(&found, 100_000.0, 5_000.0, 40_000.0);
}

#[test]
fn thresholds_are_those_of_the_simulator() {
    for (on, off) in [(0.2, 0.2), (0.15, 0.25)] {
        let found = thresholds(&panel(Made { on, off, ..PLAIN }), 0.0).unwrap();
        near(&found.on, on, 0.0, 0.15);
        near(&found.off, off, 0.0, 0.15);
    }
}

#[test]
fn the_exposure_that_blurred_the_frames_is_found() {
    for exposure_ns in [8_000_000, 14_000_000] {
        let made = Made { exposure_ns, speed: 600.0, on: 0.1, off: 0.1, ..PLAIN };
        let found = exposure(&panel(made), (0.1, 0.1), &exactly(0.0)).unwrap();
        near(&found, exposure_ns as f64, 1_000_000.0, 6_000_000.0);
    }
    assert_eq!(
        exposure(&panel(Made { speed: 0.0, ..PLAIN }), (0.2, 0.2), &exactly(0.0)),
        Err(Unclear::NoChange)
    );
}

/// A mean over any time smooths noise: without the limit on what a length must explain, these give some five
/// to thirteen milliseconds.
#[test]
fn noise_of_events_is_no_blur() {
    for (noise, speed) in [(0.1, 120.0), (0.1, 400.0), (0.3, 250.0)] {
        let made = Made { exposure_ns: 500_000, noise, speed, ..PLAIN };
        assert!(exposure(&panel(made), (0.2, 0.2), &exactly(0.0)).is_err(), "{noise} {speed}");
    }
}

#[test]
fn noise_widens_an_offset_and_does_not_move_it() {
    let found = offset(&panel(Made { noise: 0.1, late_ns: 4_000_000, ..PLAIN })).unwrap();
    near(&found.ns, 4_000_000.0, 700_000.0, 3_000_000.0);
}

/// Thresholds and offset as the recording itself gives them, events with noise, speeds and textures that no
/// limit was chosen on: the interval holds the truth, or none is given.
#[test]
fn an_exposure_is_covered_or_not_given() {
    let mut given = 0;
    for (exposure_ns, speed, noise, on) in [
        (4_000_000, 500.0, 0.02, 0.12),
        (7_000_000, 350.0, 0.05, 0.15),
        (10_000_000, 450.0, 0.02, 0.1),
        (12_000_000, 300.0, 0.1, 0.2),
        (16_000_000, 400.0, 0.03, 0.15),
    ] {
        let panel = panel(Made { exposure_ns, speed, noise, on, off: 1.2 * on, late_ns: 1_500_000, ..PLAIN });
        let Some(late) = offset(&panel) else { continue };
        let Some(steps) = thresholds(&panel, late.ns.value) else { continue };
        if let Ok(found) = exposure(&panel, (steps.on.value, steps.off.value), &late.ns) {
            assert!(found.holds(exposure_ns as f64), "{found:?}, truth {exposure_ns}");
            given += 1;
        }
    }
    assert!(given >= 1, "{given} of five");
}

/// Dark places with frames of whole steps and pixels that lose half of their events: what a fit over all
/// places would take for thresholds twice as large.
#[test]
fn dark_places_that_lose_events_do_not_move_thresholds() {
    let mut panel = panel(PLAIN);
    let stretch = &mut panel.stretches[0];
    let (places, mut random) = (panel.rows.len(), Random::new(2, &[]));
    for place in (0..places).filter(|place| place % 2 == 0) {
        for frame in 0..FRAMES {
            let log = &mut stretch.log[frame * places + place];
            // Thirty times darker, in steps of a 255th of the brightest.
            let steps = libm::round(libm::exp(f64::from(*log)) / 30.0 * 255.0 / libm::exp(2.15));
            *log = libm::log(libm::fmax(steps, 0.5) * libm::exp(2.15) / 255.0) as f32;
        }
        for counts in [&mut stretch.on, &mut stretch.off] {
            counts
                .iter_mut()
                .skip(place)
                .step_by(places)
                .for_each(|count| *count = if random.uniform() < 0.5 { 0 } else { *count });
        }
    }
    let found = thresholds(&panel, 0.0).unwrap();
    assert!(found.too_dark > 100, "{found:?}");
    near(&found.on, 0.2, 0.0, 0.1);
    near(&found.off, 0.2, 0.0, 0.1);
}
