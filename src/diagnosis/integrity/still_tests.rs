//! A static scene in front of a camera whose pixels fire now and then, at instants that are made up here.

use super::coupling::coupling;
use super::rest;
use super::still::{leak, still_pixels};
use photocurrent_core::random::Random;
use photocurrent_core::{Exposure, Extent, FrameTimes};
use photocurrent_scene::case::{Case, CaseFrames, PixelEvent, PixelEvents};

const WIDTH: usize = 48;
const HEIGHT: usize = 40;
const FRAMES: usize = 50;
const PERIOD_NS: i64 = 20_000_000;

/// 50 frames of 48 x 40 pixels at 50 Hz with noise of 1 DN; a strip of columns at the right moves. `event`
/// returns when, in which pixel and with which sign the n-th of 150 events comes.
fn camera(mut event: impl FnMut(usize, &mut Random) -> (i64, usize, i8)) -> Case {
    let mut random = Random::new(3, &[]);
    let dn = (0..FRAMES * WIDTH * HEIGHT).map(|k| {
        let moves = if k % WIDTH >= WIDTH - 6 { 40.0 * ((k / (WIDTH * HEIGHT)) % 2) as f64 } else { 0.0 };
        (80.0 + moves + random.normal()) as f32
    });
    let dn = dn.collect();
    let exposures =
        (0..FRAMES as i64).map(|l| Exposure::new(l * PERIOD_NS, l * PERIOD_NS + 500_000)).collect();
    let mut pixels = vec![Vec::new(); WIDTH * HEIGHT];
    let mut random = Random::new(4, &[]);
    for n in 0..150 {
        let (t, pixel, polarity) = event(n, &mut random);
        pixels[pixel].push(PixelEvent { t_in_ns: t, t_off_ns: t, polarity });
    }
    Case {
        extent: Extent { width: WIDTH as u32, height: HEIGHT as u32 },
        span: (0, FRAMES as i64 * PERIOD_NS),
        events: PixelEvents::new(pixels),
        has_t_in: false,
        t_resolution_ns: 1000,
        frames: Some(CaseFrames::new(FrameTimes::new(exposures, 0).unwrap(), dn)),
        sensor: crate::testing::sensor(),
    }
}

/// Each pixel in which nothing moves fires ON events at this rate, Hz.
pub(super) fn leaking(seed: u64, rate_hz: f64) -> Case {
    let mut random = Random::new(seed, &[7]);
    let mut case = camera(|_, random| (any_time(random), 0, 1));
    let end = case.span.1;
    case.events = PixelEvents::new((0..WIDTH * HEIGHT).map(|pixel| {
        let (mut t, mut events) = (0, Vec::new());
        loop {
            t += (-libm::log(1.0 - random.uniform()) / rate_hz * 1e9) as i64;
            if t >= end || pixel % WIDTH >= WIDTH - 6 {
                return events;
            }
            events.push(PixelEvent { t_in_ns: t, t_off_ns: t, polarity: 1 });
        }
    }));
    case
}

/// A pixel among those that nothing near moves in.
fn pixel(random: &mut Random) -> usize {
    let (x, y) = ((random.uniform() * 38.0) as usize, (random.uniform() * HEIGHT as f64) as usize);
    y * WIDTH + x
}

fn any_time(random: &mut Random) -> i64 {
    (random.uniform() * FRAMES as f64 * PERIOD_NS as f64) as i64
}

fn still_leak_and_coupling(case: &Case) -> (usize, Option<super::Departure>, Option<super::Departure>) {
    let nominal = case.nominal().unwrap();
    let still = still_pixels(case, &nominal, &[]);
    (still.len(), leak(case, &nominal, &still, &[]), coupling(case, &nominal, &still, &[]))
}

fn value(finding: &super::Departure, parameter: &str) -> f64 {
    finding.parameters.iter().find(|(name, _)| *name == parameter).unwrap().1
}

#[test]
fn still_pixels_keep_their_distance_from_what_moves() {
    let (still, leak, coupling) = still_leak_and_coupling(&camera(|_, random| {
        (any_time(random), pixel(random), if random.uniform() < 0.5 { 1 } else { -1 })
    }));
    // 42 columns stand still, and the four next to the strip are too near.
    assert!((still as f64 / (38.0 * HEIGHT as f64) - 1.0).abs() < 0.05, "{still}");
    // As many OFF as ON, at any time: noise, of which these tests do not report.
    assert!(leak.is_none() && coupling.is_none(), "{leak:?} {coupling:?}");
}

#[test]
fn on_events_at_any_time_where_nothing_moves_are_a_leak_with_their_rate() {
    let (still, leak, coupling) =
        still_leak_and_coupling(&camera(|_, random| (any_time(random), pixel(random), 1)));
    let leak = leak.unwrap();
    assert!((value(&leak, "rate") / (150.0 / still as f64 / 1.0) - 1.0).abs() < 0.05, "{leak:?}");
    assert!(leak.heldout.unwrap().nats > 90.0, "{leak:?}"); // 150 ln 2 = 104
    assert!(coupling.is_none(), "{coupling:?}");
}

/// Brighter from row to row, up to fifteen times; of the events, one in `every` comes where it likes, and the
/// others in proportion to the row.
fn brighter_below(every: usize) -> Case {
    let bright = |pixel: usize| 1.0 + (pixel / WIDTH) as f64;
    let mut case = camera(|n, random| {
        loop {
            let pixel = pixel(random);
            if n % every == every - 1 || random.uniform() * HEIGHT as f64 <= bright(pixel) {
                break (any_time(random), pixel, 1);
            }
        }
    });
    let frames = case.frames.as_mut().unwrap();
    *frames = frames.map(|k, dn| (f64::from(dn) + 40.0 * bright(k % (WIDTH * HEIGHT))) as f32);
    case
}

#[test]
fn a_leak_that_grows_with_the_light_is_the_lights() {
    let case = brighter_below(usize::MAX);
    let (still, leak, _) = still_leak_and_coupling(&case);
    let leak = leak.unwrap();
    assert_eq!(leak.id, "parasitic_leak");
    // 0.2 a threshold, one event in so many pixels and seconds for the mean light.
    let nominal = case.nominal().unwrap();
    let light =
        |row: f64| (80.0 + 40.0 * (1.0 + row) - nominal.number.black_level) / (nominal.number.gain * 500e-6);
    let mean = (0..HEIGHT).map(|row| light(row as f64)).sum::<f64>() / HEIGHT as f64;
    let rate = 150.0 / still as f64;
    assert!(
        (value(&leak, "coefficient") / (rate * nominal.pixel.threshold_on / mean) - 1.0).abs() < 0.1,
        "{leak:?}"
    );
}

#[test]
fn a_leak_independent_of_light_is_a_leak() {
    assert_eq!(still_leak_and_coupling(&brighter_below(1)).1.unwrap().id, "leak_events");
}

#[test]
fn on_events_of_one_pixel_or_of_one_moment_are_no_leak() {
    assert!(still_leak_and_coupling(&camera(|_, random| (any_time(random), 5 * WIDTH + 5, 1))).1.is_none());
    assert!(
        still_leak_and_coupling(&camera(|_, random| (300_000_000 + any_time(random) / 20, pixel(random), 1)))
            .1
            .is_none()
    );
}

#[test]
fn events_when_their_row_is_read_are_coupling_with_its_delay() {
    // Rows 120 us apart from 2.3 ms after the start of the exposure on; one event in five at any time.
    let (_, leak, coupling) = still_leak_and_coupling(&camera(|n, random| {
        let pixel = pixel(random);
        let read = (random.uniform() * FRAMES as f64) as i64 * PERIOD_NS
            + 2_300_000
            + (pixel / WIDTH) as i64 * 120_000
            + (50_000.0 * random.uniform()) as i64;
        (if n % 5 == 0 { any_time(random) } else { read }, pixel, 1)
    }));
    let coupling = coupling.unwrap();
    assert!((value(&coupling, "row_time") - 120e-6).abs() < 2e-6, "{coupling:?}");
    assert!((value(&coupling, "phase") - 2.3e-3).abs() < 0.1e-3, "{coupling:?}");
    assert!((value(&coupling, "period") - 20e-3).abs() < 1e-9, "{coupling:?}");
    assert_eq!(coupling.polarity, "on");
    // Four of five in a fiftieth of the time, less what 50 counted parts cost: each gains no more than ln(0.8
    // * 50).
    let nats = coupling.heldout.unwrap();
    assert!(nats.per_event() > 1.0 && nats.per_event() < 3.7, "{nats:?}");
    assert!(leak.is_some(), "coupling brings events forward; that there are any is the leak's doing");
}

#[test]
fn the_size_of_an_impulse_is_counted_where_light_rises() {
    // Log light of the strip rises by 40 to 80 ln/s all the time; thresholds are 0.2. At each readout pixels
    // with less than 0.05 to go fire at once.
    let mut case = camera(|_, random| {
        let pixel = pixel(random);
        let read = (random.uniform() * FRAMES as f64) as i64 * PERIOD_NS
            + 2_300_000
            + (pixel / WIDTH) as i64 * 120_000;
        (read, pixel, 1)
    });
    let mut random = Random::new(8, &[]);
    let pixels: Vec<Vec<PixelEvent>> = (0..WIDTH * HEIGHT)
        .map(|pixel| {
            if pixel % WIDTH < WIDTH - 6 {
                return case.events.of_pixel(pixel).to_vec();
            }
            let readout = |n: i64| n * PERIOD_NS + 2_300_000 + (pixel / WIDTH) as i64 * 120_000;
            let slope = 40.0 + 40.0 * random.uniform();
            let (mut events, mut t, mut left) = (Vec::new(), readout(0), 0.2 * random.uniform());
            for n in 1..FRAMES as i64 {
                let mut fire = |t: i64| events.push(PixelEvent { t_in_ns: t, t_off_ns: t, polarity: 1 });
                while t + (left / slope * 1e9) as i64 <= readout(n) {
                    t += (left / slope * 1e9) as i64;
                    left = 0.2;
                    fire(t);
                }
                left -= slope * (readout(n) - t) as f64 * 1e-9;
                t = readout(n);
                if left < 0.05 {
                    fire(t + 10_000);
                    left = 0.2;
                }
            }
            events
        })
        .collect();
    case.events = PixelEvents::new(pixels);
    let step = value(&still_leak_and_coupling(&case).2.unwrap(), "step");
    assert!((step / 0.05 - 1.0).abs() < 0.25, "{step}");
}

/// A static scene in which all pixels record random events: `on` ON and `off` OFF ones.
fn static_scene(on: usize, off: usize, pixel: impl Fn(&mut Random) -> usize) -> Case {
    let mut case = camera(|_, random| (any_time(random), 0, 1));
    let mut random = Random::new(6, &[]);
    let dn = (0..FRAMES * WIDTH * HEIGHT).map(|_| (80.0 + random.normal()) as f32).collect();
    let times = case.frames.as_ref().unwrap().times.clone();
    case.frames = Some(CaseFrames::new(times, dn));
    let mut pixels = vec![Vec::new(); WIDTH * HEIGHT];
    for n in 0..on + off {
        let t = any_time(&mut random);
        let polarity = if n < on { 1 } else { -1 };
        pixels[pixel(&mut random)].push(PixelEvent { t_in_ns: t, t_off_ns: t, polarity });
    }
    pixels.iter_mut().for_each(|of: &mut Vec<PixelEvent>| of.sort_by_key(|event| event.t_in_ns));
    Case { events: PixelEvents::new(pixels), ..case }
}

#[test]
fn a_camera_at_rest_fires_noise_both_ways_and_a_leak_one_way() {
    let anywhere = |random: &mut Random| (random.uniform() * (WIDTH * HEIGHT) as f64) as usize;
    let seen = |case: &Case| {
        let nominal = case.nominal().unwrap();
        let still = still_pixels(case, &nominal, &[]);
        (rest::noise(case, &still, &[]), leak(case, &nominal, &still, &[]))
    };
    // One second of 1,920 pixels: 120 OFF events are 0.125 Hz of noise, and 180 ON events more a leak.
    let (noise, leak) = seen(&static_scene(300, 120, anywhere));
    assert!((noise.expect("noise").parameters[0].1 - 0.125).abs() < 0.005);
    assert!((leak.expect("a leak").parameters[0].1 - 180.0 / 1920.0).abs() < 0.005);
    // As many of both are noise alone, and ON events alone a leak.
    let (noise, leak) = seen(&static_scene(200, 200, anywhere));
    assert!(noise.is_some() && leak.is_none());
    let (noise, leak) = seen(&static_scene(300, 0, anywhere));
    assert!(noise.is_none() && leak.is_some());
    // What fires in one corner has neighbouring events: something is there that frames do not show.
    let corner =
        |random: &mut Random| (random.uniform() * 4.0) as usize * WIDTH + (random.uniform() * 4.0) as usize;
    assert!(seen(&static_scene(300, 120, corner)).0.is_none());
}

#[test]
fn noise_below_a_digital_number_is_seen_in_whole_ones() {
    let anywhere = |random: &mut Random| (random.uniform() * (WIDTH * HEIGHT) as f64) as usize;
    let mut case = static_scene(300, 120, anywhere);
    let frames = case.frames.as_ref().unwrap();
    let mut random = Random::new(8, &[]);
    // Dark: a quarter of a threshold is a quarter of a digital number there.
    let dn = (0..FRAMES * WIDTH * HEIGHT).map(|_| (5.3 + 0.35 * random.normal()).round() as f32).collect();
    case.frames = Some(CaseFrames::new(frames.times.clone(), dn));
    let deviation = super::still::noise_dn(&case, case.frames.as_ref().unwrap());
    // 0.35 and what whole numbers add (a twelfth in squares) are 0.45; the quietest fifth of few differences.
    assert!((0.3..0.6).contains(&deviation), "{deviation}");
    let nominal = case.nominal().unwrap();
    assert!(rest::noise(&case, &still_pixels(&case, &nominal, &[]), &[]).is_some());
}
