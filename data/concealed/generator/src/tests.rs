//! The whole chain against algebra: ramps, still scenes, balances, and steps of half the length.

use crate::array::{Event, Timing, run};
use crate::digest::sha256_hex;
use crate::draw::{STEPS, draw};
use crate::frames::{Numbers, digitise};
use crate::law::Law;
use crate::light::{Light, NODE, cubic};
use crate::plan::Plan;
use crate::random::Random;
use crate::scene::{Family, Grid, Scene};
use crate::sensor::{Physics, Queue, Reset, Sensor};
use crate::stamps::stamp;
use crate::star::{Star, Target};

const W: usize = 12;
const H: usize = 9;

fn plain() -> Physics {
    Physics::of(Sensor {
        tau_0: 40e-6,
        alpha: 0.0,
        on: 0.2,
        off: 0.21,
        threshold_noise: 0.0,
        states_threshold_noise: false,
        reset: Reset::Resample,
        refractory: 100e-6,
        latency_min: 5e-6,
        latency_more: 1e-12,
        gain: 1000.0,
        black: 10.0,
        saturation: 1023.0,
        row_time: 20e-6,
        read_noise: 0.0,
        full_well: 0.0,
        states_frame_noise: false,
        per_lux: 0.0,
    })
}

fn timing(steps: usize) -> Timing {
    let exposures = (0..6).map(|l| 3e-3 + 8e-3 * f64::from(l)).map(|t| [t, t + 4e-3]).collect();
    Timing { start: 2e-3, end: 60e-3, reset_at_start: true, node: NODE, steps, exposures }
}

fn scene(family: Family) -> Scene {
    Scene { family, mean: libm::log(50.0), contrast: 0.8, pace: 3.0, flicker: None }
}

fn ramp(slope: f64) -> Scene {
    Scene { contrast: 1.0, mean: 0.0, pace: 1.0, ..scene(Family::Ramp { slope }) }
}

fn events_of(scene: &Scene, physics: &Physics, steps: usize) -> Vec<Event> {
    run(scene, physics, W, H, &timing(steps), &mut Random::named("run")).0
}

/// The instants at which one pixel fired.
fn instants(events: &[Event], pixel: usize) -> Vec<f64> {
    events.iter().filter(|event| event.pixel == pixel).map(|event| event.t_in).collect()
}

#[test]
fn a_ramp_fires_once_every_threshold_and_blind_time() {
    // Behind a low-pass a ramp is a ramp: from reset to event it takes threshold / slope, then latency and
    // refractory period.
    for slope in [30.0, -30.0] {
        let times = instants(&events_of(&ramp(slope), &plain(), STEPS), 40);
        let threshold = if slope > 0.0 { 0.2 } else { 0.21 };
        assert!(times.len() >= 7);
        assert!((times[0] - (2e-3 + threshold / 30.0)).abs() < 1e-9, "{}", times[0]);
        for pair in times.windows(2) {
            assert!((pair[1] - pair[0] - (threshold / 30.0 + 105e-6)).abs() < 1e-9, "{pair:?}");
        }
    }
}

#[test]
fn a_leak_adds_to_a_ramp_and_fires_on_a_still_scene() {
    let physics = Physics { leak: 40.0, parasitic: 0.5, ..plain() };
    // A flat scene of photocurrent 1: V_ref falls by 40 x 0.2 + 0.5 ln/s.
    let still = instants(&events_of(&ramp(0.0), &physics, STEPS), 7);
    assert!(still.len() >= 2);
    for pair in still.windows(2) {
        assert!((pair[1] - pair[0] - (0.2 / 8.5 + 105e-6)).abs() < 1e-9, "{pair:?}");
    }
    let physics = Physics { leak: 40.0, ..plain() };
    let rising = instants(&events_of(&ramp(30.0), &physics, STEPS), 7);
    assert!((rising[1] - rising[0] - (0.2 / 38.0 + 105e-6)).abs() < 1e-9);
}

#[test]
fn memory_shortens_the_step_to_the_next_event_of_a_ramp() {
    // V - V_ref after the reset is f (V - V_ref_before) = f (threshold + blind x slope), which is in the
    // steady state d = f (threshold + 105 us x slope + ...): at the event the distance is the threshold, at
    // the reset 105 us x slope more.
    let physics = Physics { memory: 0.1, ..plain() };
    let times = instants(&events_of(&ramp(30.0), &physics, STEPS), 3);
    let left = 0.1 * (0.2 + 105e-6 * 30.0);
    for pair in times[1..].windows(2) {
        assert!((pair[1] - pair[0] - ((0.2 - left) / 30.0 + 105e-6)).abs() < 1e-9, "{pair:?}");
    }
}

#[test]
fn a_slew_limit_and_a_high_pass_act_as_their_equations_say() {
    let slow = Physics { rise: 20.0, ..plain() };
    let times = instants(&events_of(&ramp(30.0), &slow, STEPS), 3);
    assert!((times[4] - times[3] - (0.2 / 20.0 + 105e-6)).abs() < 1e-9);
    // Behind the high-pass a ramp rests at slope x tau = 0.15 for good: below the threshold, and nothing
    // fires after a reset there.
    let high = Physics { high_pass: 5e-3, ..plain() };
    assert!(instants(&events_of(&ramp(30.0), &high, STEPS), 3).is_empty());
    let wider = Physics { high_pass: 10e-3, ..plain() };
    assert_eq!(
        instants(&events_of(&ramp(30.0), &wider, STEPS), 3).len(),
        1,
        "0.3 at rest: one threshold \
                                                            and no second"
    );
}

#[test]
fn thresholds_that_move_the_reference_add_up_to_the_voltage() {
    let mut physics = plain();
    physics.sensor.reset = Reset::Advance;
    physics.sensor.refractory = 0.0;
    physics.sensor.latency_min = 1e-6;
    physics.sensor.tau_0 = 20e-6;
    let drift = Family::draw("drift", &mut Random::named("drift"), W as f64, H as f64, 1.0);
    let scene = scene(drift);
    let events = events_of(&scene, &physics, STEPS);
    assert!(events.len() > W * H * 4, "{}", events.len());
    let mut light = Light::new(&scene, &physics, W, H);
    let (mut first, mut last) = (light.node(), light.node());
    // What the low-pass holds is the light of about tau_0 before.
    light.fill(2e-3 - 20e-6, &mut first);
    light.fill(60e-3 - 20e-6, &mut last);
    for p in 0..W * H {
        let steps: f64 = events
            .iter()
            .filter(|event| event.pixel == p)
            .map(|event| if event.on { 0.2 } else { -0.21 })
            .sum();
        let rest = last.settled[p] - first.settled[p] - steps;
        assert!((-0.215..0.205).contains(&rest), "pixel {p}: {rest} is left over, more than a threshold");
    }
}

#[test]
fn half_the_step_moves_half_of_the_events_by_less_than_twenty_nanoseconds() {
    let mut physics = plain();
    physics.sensor.alpha = 50.0 * 150e-6;
    physics.second_tau = 100e-6;
    for name in ["drift", "spokes"] {
        let scene = scene(Family::draw(name, &mut Random::named(name), 72.0, 54.0, 0.8));
        let (coarse, fine) = (events_of(&scene, &physics, STEPS), events_of(&scene, &physics, 2 * STEPS));
        let mut moved = Vec::new();
        for p in 0..W * H {
            let (a, b) = (instants(&coarse, p), instants(&fine, p));
            assert_eq!(a.len(), b.len(), "{name}, pixel {p}");
            moved.extend(a.iter().zip(&b).map(|(a, b)| (a - b).abs()));
        }
        moved.sort_by(f64::total_cmp);
        // A voltage wrong by 2e-6 ln shifts an event by more where the voltage is slow, and by much where it
        // just reaches a threshold.
        let [middle, most] = [50, 98].map(|percent| moved[moved.len() * percent / 100]);
        assert!(
            moved.len() > 300 && middle < 20e-9 && most < 1e-6,
            "{name}: {} events, half within \
                                                            {middle} s, 98 % within {most} s",
            moved.len()
        );
    }
}

#[test]
fn light_between_nodes_is_that_of_the_formula() {
    let physics = plain();
    for name in Family::NAMES {
        let scene = scene(Family::draw(name, &mut Random::named(name), 72.0, 54.0, 0.7));
        let mut light = Light::new(&scene, &physics, 72, 54);
        let mut nodes = [(); 4].map(|()| light.node());
        let mut between = light.node();
        let mut worst = 0.0f64;
        for k in 0..20 {
            let t = 5e-3 + 3e-3 * f64::from(k);
            for (n, node) in nodes.iter_mut().enumerate() {
                light.fill(t + (n as f64 - 1.0) * NODE, node);
            }
            light.fill(t + 0.5 * NODE, &mut between);
            let weights = cubic(0.5);
            for p in 0..72 * 54 {
                let value: f64 = (0..4).map(|n| weights[n] * nodes[n].settled[p]).sum();
                worst = worst.max((value - between.settled[p]).abs());
            }
        }
        // A thousandth of a threshold; the worst is where a disc turns round.
        assert!(worst < 2e-4, "{name}: {worst} ln");
    }
}

#[test]
fn noise_events_come_at_their_rate() {
    let mut physics = Physics { background: 60.0, hot_rows: vec![4], hot_row_rate: 400.0, ..plain() };
    physics.sensor.refractory = 20e-6;
    let events = events_of(&ramp(0.0), &physics, STEPS);
    let seconds = 58e-3;
    // Blind for 25 us an event: rate / (1 + 25 us x rate).
    let expected = |rate: f64, pixels: f64| rate / (1.0 + 25e-6 * rate) * seconds * pixels;
    let hot = events.iter().filter(|event| event.pixel / W == 4).count() as f64;
    let rest = events.len() as f64 - hot;
    for (found, expected) in [(hot, expected(460.0, W as f64)), (rest, expected(60.0, (W * (H - 1)) as f64))]
    {
        // Four standard deviations of a count.
        assert!((found - expected).abs() < 4.0 * expected.sqrt(), "{found} {expected}");
    }
    let on = events.iter().filter(|event| event.on).count() as f64;
    assert!((on - 0.5 * events.len() as f64).abs() < 2.0 * (events.len() as f64).sqrt());
}

#[test]
fn events_that_happen_at_once_wait_for_each_other() {
    // A flat ramp fires the whole array at once: the k-th of N waits k service times, and its reset comes
    // that much later.
    let physics = Physics { queue: Some(Queue { service: 1e-6, shown: true }), ..plain() };
    let events = events_of(&ramp(30.0), &physics, STEPS);
    let n = W * H;
    let mut waits: Vec<f64> =
        events[..n].iter().map(|event| (event.t_off - event.t_in - 5e-6) * 1e6).collect();
    waits.sort_by(f64::total_cmp);
    for (k, wait) in waits.iter().enumerate() {
        assert!((wait - k as f64).abs() < 1e-3, "{k}: {wait}");
    }
    let hidden = Physics { queue: Some(Queue { service: 1e-6, shown: false }), ..plain() };
    let quiet = events_of(&ramp(30.0), &hidden, STEPS);
    assert!(quiet.iter().all(|event| (event.t_off - event.t_in - 5e-6).abs() < 1e-9), "stamps show nothing");
    let same = |events: &[Event]| instants(events, 50);
    assert!(
        same(&events).iter().zip(same(&quiet)).all(|(a, b)| (a - b).abs() < 1e-12),
        "the resets are the same"
    );
}

#[test]
fn frames_of_constant_light_read_gain_times_light_times_exposure() {
    let still = Scene { mean: libm::log(30.0), ..ramp(0.0) };
    let physics = Physics { exposure_more: 0.5e-3, lag: 0.1, nonlinearity: 0.05, falloff: 0.3, ..plain() };
    let (_, charge) = run(&still, &physics, W, H, &timing(STEPS), &mut Random::named("frames"));
    assert!(charge.iter().flatten().all(|q| (q - 30.0 * 4.5e-3).abs() < 1e-12));
    let frames = digitise(&charge, &physics, W, Numbers::Sixteenths, &mut Random::named("dn"));
    let x = 0.7 * 1.1 * 1000.0 * 30.0 * 4.5e-3 / 1013.0;
    let corner = 10.0 + 1013.0 * (x + 0.2 * x * (1.0 - x));
    assert!((frames[2][0] - corner).abs() <= 1.0 / 32.0, "{} {corner}", frames[2][0]);
}

#[test]
fn rows_of_a_rolling_shutter_see_a_ramp_later() {
    // The integral of exp(s t) over an exposure grows by exp(s row_time) from row to row.
    let mut physics = plain();
    physics.sensor.row_time = 35e-6;
    let (_, charge) = run(&ramp(20.0), &physics, W, H, &timing(STEPS), &mut Random::named("rows"));
    let first = (libm::exp(20.0 * 7e-3) - libm::exp(20.0 * 3e-3)) / 20.0;
    for row in 0..H {
        let expected = first * libm::exp(20.0 * 35e-6 * row as f64);
        assert!((charge[0][row * W] / expected - 1.0).abs() < 1e-9, "row {row}");
    }
}

#[test]
fn stamps_are_changed_by_clock_row_and_step() {
    let event = |pixel: usize, t: f64| Event { pixel, on: true, t_in: t, t_off: t + 5e-6, lost: false };
    let physics =
        Physics { clock_offset: 300e-6, clock_rate: 0.01, skew_per_row: 10e-6, quantum: 50e-6, ..plain() };
    let stamped =
        stamp(&[event(2 * W, 10e-3), event(0, 20e-3)], &physics, W, H, 1000, &mut Random::named("stamps"));
    // 10 ms x 1.01 + 0.3 ms + 20 us = 10.42 ms, down to 10.4; 20 ms x 1.01 + 0.3 ms = 20.5 ms.
    assert_eq!((stamped[0].t_in, stamped[0].t, stamped[1].t_in), (10_400_000, 10_400_000, 20_500_000));
}

#[test]
fn laws_outside_the_catalogue_do_what_they_say() {
    let with = |law: Law| Physics { law: Some(law), ..plain() };
    // Rows of even index need 10 % more.
    let parity = events_of(&ramp(30.0), &with(Law::RowParity { skew: 0.1 }), STEPS);
    let gap = |times: Vec<f64>| times[2] - times[1];
    assert!((gap(instants(&parity, 0)) - (0.22 / 30.0 + 105e-6)).abs() < 1e-9);
    assert!((gap(instants(&parity, W)) - (0.18 / 30.0 + 105e-6)).abs() < 1e-9);
    // The reset of row 5 comes 5 x 20 us later.
    let late = events_of(&ramp(30.0), &with(Law::RowReset { per_row: 20e-6 }), STEPS);
    assert!((gap(instants(&late, 5 * W)) - (0.2 / 30.0 + 205e-6)).abs() < 1e-9);
    // After an event the threshold is 0.2 (1 + 0.5 exp(-t / 5 ms)) with t since it: the crossing solves 30 (t
    // - 105 us) = that.
    let tired = events_of(&ramp(30.0), &with(Law::Hysteresis { rise: 0.5, decay: 5e-3 }), STEPS);
    let t = gap(instants(&tired, 30));
    let miss = 30.0 * (t - 105e-6) - 0.2 * (1.0 + 0.5 * libm::exp(-t / 5e-3));
    assert!(miss.abs() < 1e-6, "{miss}");
    // Decided 1 ms / sqrt(30) late, and the reset with it.
    let slow = events_of(&ramp(30.0), &with(Law::SlowComparator { strength: 1e-3, most: 1e-3 }), STEPS);
    assert!((gap(instants(&slow, 30)) - (0.2 / 30.0 + 105e-6 + 1e-3 / 30.0f64.sqrt())).abs() < 1e-9);
}

#[test]
fn laws_over_place_and_time_do_what_they_say() {
    let of = |law: Law, slope: f64| events_of(&ramp(slope), &Physics { law: Some(law), ..plain() }, STEPS);
    let gap = |events: &[Event], pixel: usize, n: usize| {
        let times = instants(events, pixel);
        times[n + 1] - times[n]
    };
    // From an event to the next: what it takes to `threshold`, and latency and refractory period.
    let takes = |threshold: f64| threshold / 30.0 + 105e-6;
    let near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-8, "{found} {expected}");
    // Rows 3 to 5 need 20 % more.
    let band = of(Law::RowBand { rise: 0.2, first: 3, last: 5 }, 30.0);
    for (row, threshold) in [(2, 0.2), (3, 0.24), (5, 0.24), (6, 0.2)] {
        near(gap(&band, row * W, 1), takes(threshold));
    }
    // Column 3 is a quarter of a period of 12 columns: the crest; column 9 the trough.
    let wave = of(Law::ColumnWave { depth: 0.1, period: 12.0, phase: 0.0 }, 30.0);
    for (column, threshold) in [(0, 0.2), (3, 0.22), (9, 0.18)] {
        near(gap(&wave, column, 1), takes(threshold));
    }
    // The corner and the centre, OFF events alone.
    let [on, off] = [30.0, -30.0].map(|slope| of(Law::RadiusOff { rise: 0.1 }, slope));
    near(gap(&on, 0, 1), takes(0.2));
    near(gap(&off, 0, 1), takes(0.21 * 1.1));
    let centre = |y: f64, x: f64| 2.0 * (x * x + y * y) / (5.5 * 5.5 + 4.0 * 4.0) - 1.0;
    near(gap(&off, 4 * W + 5, 1), takes(0.21 * (1.0 + 0.1 * centre(0.0, -0.5))));
    // The last row of nine leaks 10 thresholds a second, row 4 half of that, and ON events come sooner.
    let leak = of(Law::RowLeak { rate: 10.0 }, 30.0);
    for (row, rate) in [(0, 0.0), (4, 5.0), (8, 10.0)] {
        near(gap(&leak, row * W, 1), 0.2 / (30.0 + 0.2 * rate) + 105e-6);
    }
    // From 30 ms on; the event in whose wait the step falls crosses there or later.
    let step = of(Law::TimeStep { rise: 0.15, at: 30e-3 }, 30.0);
    let times = instants(&step, 40);
    for pair in times.windows(2) {
        if pair[1] < 29e-3 {
            near(pair[1] - pair[0], takes(0.2));
        } else if pair[0] > 30e-3 {
            near(pair[1] - pair[0], takes(0.23));
        }
    }
    // 0.2 (1 + 0.3 exp(-t / 20 ms)) at the crossing.
    let warm = instants(&of(Law::Warming { rise: 0.3, decay: 20e-3 }, 30.0), 40);
    for pair in warm.windows(2) {
        let threshold = 0.2 * (1.0 + 0.3 * libm::exp(-pair[1] / 20e-3));
        assert!((pair[1] - pair[0] - takes(threshold)).abs() < 1e-7, "{pair:?}");
    }
    // Stamps alone: the pixel's own events are where they were.
    let plain = instants(&events_of(&ramp(30.0), &plain(), STEPS), 0);
    let parity = of(Law::ParityDelay { delay: 2e-4 }, 30.0);
    for (row, late) in [(0, 0.0), (1, 2e-4), (2, 0.0)] {
        near(instants(&parity, row * W)[3], plain[3] + late);
    }
    let swing = of(Law::DelayWave { depth: 4e-4, frequency: 100.0, phase: 0.5 }, 30.0);
    for (n, t) in plain.iter().enumerate().take(7) {
        let late = 2e-4 * (1.0 + libm::sin(200.0 * std::f64::consts::PI * t + 0.5));
        near(instants(&swing, 0)[n], t + late);
    }
    // Half of the events of the last row, none of the first one's: 12 pixels of some eight events.
    let lost = of(Law::RowLoss { most: 0.5 }, 30.0);
    let count = |row: usize| lost.iter().filter(|event| event.pixel / W == row).count();
    assert!(count(0) >= 80 && (0.3..0.7).contains(&(count(8) as f64 / count(0) as f64)), "{}", count(8));
}

#[test]
fn noise_in_dim_light_and_a_gain_by_column_do_what_they_say() {
    // Light of e^0 and less: thresholds spread by 5 % at the middle, by 10 % at a quarter of it.
    let law = |middle: f64| Physics { law: Some(Law::DimNoise { share: 0.05, middle }), ..plain() };
    let spread = |middle: f64| {
        let events = events_of(&ramp(10.0), &law(middle), STEPS);
        let firsts: Vec<f64> = (0..W * H).filter_map(|p| instants(&events, p).first().copied()).collect();
        let mean = firsts.iter().sum::<f64>() / firsts.len() as f64;
        libm::sqrt(firsts.iter().map(|t| (t - mean) * (t - mean)).sum::<f64>() / firsts.len() as f64)
    };
    // The threshold drawn at 2 ms, of 0.2 and 0.21, at a slope of 10 a second.
    let expected = 0.05 * 0.205 / 10.0;
    assert!((spread(1.0) / expected - 1.0).abs() < 0.25, "{}", spread(1.0) / expected);
    assert!((spread(4.0) / expected - 2.0).abs() < 0.5, "{}", spread(4.0) / expected);
    let gain = Physics { law: Some(Law::ColumnGain { slope: 0.2 }), ..plain() };
    let number = |physics: &Physics| {
        digitise(&[vec![0.3; W * H]], physics, W, Numbers::Sixteenths, &mut Random::named("frame"))[0].clone()
    };
    let (with, without) = (number(&gain), number(&plain()));
    for (column, factor) in [(0, 0.8), (11, 1.2)] {
        assert!(((with[column] - 10.0) / (without[column] - 10.0) - factor).abs() < 1e-3);
    }
}

#[test]
fn the_stored_version_comes_out_as_it_is_stored() {
    // The second recording of the stored version, b7aea23d: the digest is of the values in that file.
    let mut draft = draw(Plan::Short, 1, "sealed physics, second edition").expect("a recording of the plan");
    let (events, charge) = run(&draft.scene, &draft.physics, 72, 54, &draft.timing, &mut draft.random);
    let frames = digitise(&charge, &draft.physics, 72, draft.numbers, &mut draft.random);
    let stamped = stamp(&events, &draft.physics, 72, 54, draft.resolution, &mut draft.random);
    let mut bytes: Vec<u8> = stamped.iter().flat_map(|event| event.t.to_le_bytes()).collect();
    bytes.extend(stamped.iter().flat_map(|event| ((event.pixel % 72) as u16).to_le_bytes()));
    bytes.extend(stamped.iter().flat_map(|event| ((event.pixel / 72) as u16).to_le_bytes()));
    bytes.extend(stamped.iter().map(|event| u8::from(event.on)));
    bytes.extend(frames.iter().flatten().flat_map(|dn| dn.to_le_bytes()));
    bytes.extend(draft.nominal.description().bytes());
    assert_eq!(sha256_hex(&bytes), "3464ede121c88c6e7bf3c96b0d4b303bab8b16e88fbe03ec3790fd7a54135065");
}

#[test]
fn effects_scenes_and_sensors_of_the_stored_version_are_drawn_again() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../answers.json");
    let text = std::fs::read_to_string(path).expect("the stored answers");
    let stored: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let stored = stored["recordings"].as_array().expect("a list");
    // Some of those with an effect: each draws its size in a way of its own.
    for (index, answer) in stored.iter().enumerate().skip(34).step_by(11) {
        let draft = draw(Plan::Short, index, "sealed physics, second edition").expect("a recording");
        for (key, value) in draft.answer.as_object().expect("an object") {
            assert_eq!(*value, answer[key], "recording {index}, {key}");
        }
    }
}

#[test]
fn a_star_is_lit_by_lux_times_what_a_lux_is_worth_times_reflectance() {
    let mut target = Target::draw(&mut Random::named("star"), [64, 48]);
    target.turn(0.8, &mut Random::named("turn"));
    let Star { spokes, radius, dark, bright, centre, omega, start } = target.star.clone();
    let scene = Scene {
        family: Family::Star(target.star.clone()),
        mean: libm::log(target.white()),
        contrast: 1.0,
        pace: 1.0,
        flicker: None,
    };
    let (mut seen, t) = (vec![0.0; 64 * 48], 0.123);
    scene.log_light(t, &Grid { left: 0.0, top: 0.0, columns: 64, rows: 48 }, 64.0, 48.0, &mut seen);
    let mut counted = [0; 3];
    for (p, seen) in seen.iter().enumerate() {
        let (dx, dy) = ((p % 64) as f64 - centre[0], (p / 64) as f64 - centre[1]);
        let distance = dx.hypot(dy);
        let turns = (dy.atan2(dx) - omega * (t + start)) / std::f64::consts::TAU;
        let spoke = 2.0 * spokes * turns;
        let to_edge = (spoke - spoke.round()).abs() * std::f64::consts::PI * distance / spokes;
        let reflectance = match () {
            () if distance > radius + 0.5 => 0.3,
            // Further from an edge than half a pixel.
            () if distance < radius - 0.5 && to_edge > 0.51 => {
                [bright, dark][(spoke.floor() as i64).rem_euclid(2) as usize]
            }
            () => continue,
        };
        counted[if reflectance == bright { 0 } else { 1 + usize::from(reflectance == dark) }] += 1;
        assert!(
            (seen - libm::log(target.white() * reflectance)).abs() < 1e-9,
            "pixel {p}: {} for \
                                                            {reflectance}",
            libm::exp(*seen) / target.white()
        );
    }
    assert!(counted.iter().all(|n| *n > 300), "{counted:?}");
}

#[test]
fn light_of_a_star_between_nodes_is_that_of_the_formula() {
    let physics = plain();
    let target = Target::draw(&mut Random::named("star"), [96, 72]);
    let scene = Scene {
        family: Family::Star(target.star.clone()),
        mean: libm::log(target.white()),
        contrast: 1.0,
        pace: 1.0,
        flicker: None,
    };
    let mut light = Light::new(&scene, &physics, 96, 72);
    let mut nodes = [(); 4].map(|()| light.node());
    let mut between = light.node();
    let (mut worst, mut sum) = (0.0f64, 0.0);
    for k in 0..20 {
        let t = 5e-3 + 3e-3 * f64::from(k);
        for (n, node) in nodes.iter_mut().enumerate() {
            light.fill(t + (n as f64 - 1.0) * 0.25 * NODE, node);
        }
        light.fill(t + 0.125 * NODE, &mut between);
        let weights = cubic(0.5);
        for p in 0..96 * 72 {
            let value: f64 = (0..4).map(|n| weights[n] * nodes[n].settled[p]).sum();
            worst = worst.max((value - between.settled[p]).abs());
            sum += (value - between.settled[p]).abs() / (20.0 * 96.0 * 72.0);
        }
    }
    // The corners of the ramp that an edge makes, for some microseconds; everywhere else light is straight or
    // still.
    assert!(worst < 1e-2 && sum < 2e-6, "{worst} ln at most, {sum} ln on average");
}
