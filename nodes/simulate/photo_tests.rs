//! Tests of `simulate/photo`: waves and exponentials that move have light in closed form.

use super::super::stored::tests::{save, wide};
use super::*;
use crate::simulate::sensor::{self as camera, SimulateSensor};
use photocurrent_core::colour::Order;
use photocurrent_core::{Rows, light, testing};
use png::{BitDepth, ColorType};
use std::path::Path;
use std::sync::Arc;
use tempfile::TempDir;

fn sensor() -> Sensor {
    let mut sensor = Sensor::unknown("test");
    sensor.optics.photocurrent_per_lux = Some(0.2);
    sensor.frames.gain = Some(1000.0);
    sensor.frames.black_level_dn = Some(5.0);
    sensor
}

/// A photo of `width` x `height` with linear 16-bit values, 0 to 1.
fn photo(width: u32, height: u32, value: impl Fn(f64, f64) -> f64) -> (TempDir, Params) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("photo.png");
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (f64::from(x), f64::from(y))));
    let values: Vec<u16> = pixels.map(|(x, y)| (value(x, y) * 65535.0).round() as u16).collect();
    save(&path, width, height, (ColorType::Grayscale, BitDepth::Sixteen), &wide(&values));
    let params = Params {
        path: InputPath::new(path),
        transfer: Transfer::Linear,
        width: 24,
        height: 8,
        duration: Duration::new(40_000_000),
        ..Params::default()
    };
    (folder, params)
}

fn run(params: Params, rows: Rows) -> Out {
    let node = SimulatePhoto::build(params).unwrap();
    testing::with_context(rows, &["light", "truth"], |cx| node.run(In { sensor: Arc::new(sensor()) }, cx))
        .0
        .unwrap()
}

const ROWS: Rows = Rows { start: 0, end: 8 };
const WAVELENGTH: f64 = 24.0;

/// A wave along x.
fn wave(x: f64) -> f64 {
    0.5 + 0.4 * libm::sin(TAU * x / WAVELENGTH)
}

/// Holds light and truth of every pixel against `expected` at (x, y) and seconds, as a share of white.
fn compare(out: &Out, tolerance: f64, expected: impl Fn(f64, f64, f64) -> f64) {
    let band = out.light.read(ROWS).unwrap();
    let truth = out.truth.0.read_rows(ROWS).unwrap();
    for (x, y) in ROWS.iter().flat_map(|y| (0..24).map(move |x| (x, y))) {
        for t in (0..=97).map(|k| k * 411_237) {
            let share = expected(f64::from(x), f64::from(y), t as f64 * 1e-9);
            let off = libm::log(light::at(band.pixel(x, y), t).unwrap() / (60.0 * share)).abs();
            assert!(off < tolerance, "({x}, {y}) at {t} ns is off by {off}");
        }
        for (l, exposure) in out.truth.0.meta.times.exposures.iter().enumerate() {
            let share = expected(f64::from(x), f64::from(y), exposure.start.0 as f64 * 1e-9);
            let off = (f64::from(truth.row(l, y)[x as usize]) - 5.0) / (60.0 * 6.5 * share) - 1.0;
            // In the trough at 0.1 of white the curve is off by 0.4 (TAU / 24)^4 / 360 at most, a twentieth
            // of a thousandth, and 16 bits by three times as much.
            assert!(off.abs() < 3e-4, "({x}, {y}) in true frame {l} is off by {off}");
        }
    }
}

#[test]
fn a_wave_that_slides_is_a_wave_in_time() {
    let (_folder, still) = photo(120, 40, |x, _| wave(x));
    let out = run(Params { speed: 500.0, truth_rate: Rate::new(10_000.0), ..still }, ROWS);
    assert_eq!(out.truth.0.meta.times.len(), 400);
    // The middle of 120 columns is in the middle of 24: column 48 is at 0.
    compare(&out, 1.3e-3, |x, _, t| wave(x + 48.0 - 500.0 * t));
}

/// Red, green and blue are waves of their own phases, and grey is their luminance.
#[test]
fn each_colour_of_a_photo_is_a_wave_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("colours.png");
    let of = |channel: usize, x: f64| wave(x + 5.0 * channel as f64);
    let places = (0..40_usize).flat_map(|_| (0..120_usize).flat_map(|x| [0, 1, 2].map(|c| (x, c))));
    let values: Vec<u16> = places.map(|(x, c)| (of(c, x as f64) * 65535.0).round() as u16).collect();
    save(&path, 120, 40, (ColorType::Rgb, BitDepth::Sixteen), &wide(&values));
    let still = Params {
        path: InputPath::new(path),
        transfer: Transfer::Linear,
        width: 24,
        height: 8,
        duration: Duration::new(40_000_000),
        speed: 500.0,
        ..Params::default()
    };
    let seen = |x: f64, t: i64| x + 48.0 - 500.0 * t as f64 * 1e-9;
    for (colour, channels) in [(Colour::Rgb, 3), (Colour::Bayer(Order::Rggb), 1)] {
        let out = run(Params { colour, ..still.clone() }, ROWS);
        let (band, truth) = (out.light.read(ROWS).unwrap(), out.truth.0.read_rows(ROWS).unwrap());
        for (value, y) in ROWS.iter().flat_map(|y| (0..24 * channels).map(move |value| (value, y))) {
            let channel = colour.channel(value, y).unwrap();
            for t in (0..=97).map(|k| k * 411_237) {
                let share = of(channel, seen(f64::from(value / channels), t));
                let off = libm::log(light::at(band.pixel(value, y), t).unwrap() / (60.0 * share)).abs();
                assert!(off < 1.3e-3, "{colour}, value {value} of row {y}, {t} ns: {off}");
            }
            let share = of(channel, seen(f64::from(value / channels), 0));
            let dn = f64::from(truth.row(0, y)[value as usize]);
            assert!(((dn - 5.0) / (60.0 * 6.5 * share) - 1.0).abs() < 3e-4, "{colour}: {dn}");
        }
    }
    let grey = run(still, ROWS);
    let luminance = |x: f64| 0.2126 * of(0, x) + 0.7152 * of(1, x) + 0.0722 * of(2, x);
    compare(&grey, 1.3e-3, |x, _, t| luminance(x + 48.0 - 500.0 * t));
}

#[test]
fn a_shaking_hand_and_a_slant_add_up() {
    let (_folder, still) = photo(140, 60, |x, _| wave(x));
    let shake = Shake { amplitude: 2.0, frequency: Rate::new(60.0), direction: 180.0 };
    let out = run(Params { speed: 300.0, heading: 60.0, shake, ..still }, ROWS);
    compare(&out, 1.3e-3, |x, _, t| wave(x + 58.0 - 150.0 * t + 2.0 * libm::sin(TAU * 60.0 * t)));
}

#[test]
fn a_photo_that_grows_about_a_point_stretches_its_wave() {
    let (_folder, still) = photo(120, 40, |x, _| wave(x));
    let out = run(Params { zoom: 10.0, centre: Some(Place { x: 3.0, y: 2.0 }), ..still }, ROWS);
    compare(&out, 1.3e-3, |x, _, t| wave(51.0 + (x - 3.0) * libm::exp(-10.0 * t)));
}

#[test]
fn a_turned_wave_runs_along_a_turned_axis() {
    let (_folder, still) = photo(120, 90, |x, _| wave(x));
    let out = run(Params { rotation: Rotation::new(600.0), ..still }, ROWS);
    let (cx, cy) = (11.5, 3.5);
    compare(&out, 1.3e-3, |x, y, t| {
        let angle = TAU * 10.0 * t;
        wave(59.5 + libm::cos(angle) * (x - cx) + libm::sin(angle) * (y - cy))
    });
}

#[test]
fn an_exponential_that_slides_fires_at_equal_intervals() {
    const GROWTH: f64 = 0.03;
    let (_folder, still) = photo(120, 16, |x, _| 0.02 * libm::exp(GROWTH * x));
    let params = Params { speed: 1500.0, heading: 180.0, tolerance: 1e-4, ..still };
    let out = run(Params { duration: Duration::new(30_000_000), ..params }, ROWS);
    let mut ideal = sensor();
    (ideal.front_end.tau_0, ideal.front_end.alpha) = (Some(Duration::new(0)), Some(Duration::new(0)));
    (ideal.comparator.threshold_on, ideal.comparator.threshold_off) = (Some(0.2), Some(0.2));
    (ideal.readout.refractory, ideal.frames.row_time) = (Some(Duration::new(0)), Some(Duration::new(0)));
    let params = camera::Params {
        frame_rate: Rate::new(100.0),
        exposure: Duration::new(1_000_000),
        latency_spread: Duration::new(0),
        ..camera::Params::default()
    };
    let node = SimulateSensor::build(params).unwrap();
    let seen = testing::with_context(ROWS, &["events"], |cx| {
        node.run(camera::In { light: out.light, sensor: Arc::new(ideal) }, cx)
    })
    .0
    .unwrap();
    let events = seen.events.read(ROWS).unwrap();
    // Log light rises by 0.03 x 1500 = 45 a second: a threshold of 0.2 every 4.444 ms, six times in 30 ms, on
    // all 24 x 8 pixels.
    assert_eq!(events.len(), 6 * 24 * 8);
    assert!(events.on.iter().all(|on| *on == 1));
    let worst = events.t.iter().map(|t| {
        let n = (*t as f64 * 45e-9 / 0.2).round();
        (*t as f64 - n * 0.2 / 45e-9).abs()
    });
    let worst = worst.fold(0.0, f64::max);
    // Sixteen bits step by 1.3e-4 of the darkest pixel seen; tripled by the curve and twice, for two ends:
    // 8e-4 of log light are 18 us.
    assert!(worst < 18_000.0, "{worst}");
}

#[test]
fn what_rests_costs_one_instant() {
    let (_folder, still) = photo(30, 20, |x, y| 0.1 + 0.02 * x + 0.01 * y);
    let band = run(still, ROWS).light.read(ROWS).unwrap();
    for (x, y) in ROWS.iter().flat_map(|y| (0..24).map(move |x| (x, y))) {
        let stored = (0.1 + 0.02 * f64::from(x + 3) + 0.01 * f64::from(y + 6)) * 60.0;
        assert_eq!(band.pixel(x, y).t, [0]);
        assert!((f64::from(band.pixel(x, y).photocurrent[0]) / stored - 1.0).abs() < 1e-4);
    }
}

#[test]
fn bands_are_rows_of_the_whole() {
    let (_folder, still) = photo(40, 30, |x, y| 0.5 + 0.2 * libm::sin(x) + 0.2 * libm::cos(1.7 * y));
    let shake = Shake { amplitude: 1.0, ..Shake::default() };
    let params = Params {
        speed: 900.0,
        heading: 33.0,
        rotation: Rotation::new(-200.0),
        zoom: -3.0,
        shake,
        outside: Outside::Hold,
        ..still
    };
    let rows = Rows { start: 3, end: 6 };
    let (whole, band) = (run(params.clone(), ROWS), run(params, rows));
    assert_eq!(whole.light.read(rows).unwrap(), band.light.read(rows).unwrap());
    assert_eq!(whole.truth.0.read_rows(rows).unwrap(), band.truth.0.read_rows(rows).unwrap());
}

#[test]
fn light_stays_between_the_darkest_and_white() {
    // A step from nothing to white: the curve overshoots, light does not.
    let (_folder, still) = photo(60, 20, |x, _| if x < 30.0 { 0.0 } else { 1.0 });
    let band = run(Params { speed: 400.0, ..still }, ROWS).light.read(ROWS).unwrap();
    let (least, most) =
        band.photocurrent.iter().fold((f32::MAX, 0.0_f32), |(least, most), i| (least.min(*i), most.max(*i)));
    assert!((least - 0.6).abs() < 1e-6 && (most - 60.0).abs() < 1e-5, "{least} {most}");
}

#[test]
fn a_photo_may_be_shrunk_first() {
    let (_folder, still) = photo(75, 27, |x, y| 0.1 + 0.01 * (x / 3.0).floor() + 0.02 * (y / 3.0).floor());
    // 25 x 9 after averaging squares of 3: the sensor's pixel (0, 0) is half a pixel inside.
    let band = run(Params { shrink: 3, ..still }, ROWS).light.read(ROWS).unwrap();
    let found = f64::from(band.pixel(10, 4).photocurrent[0]) / 60.0;
    assert!((found - (0.1 + 0.01 * 10.5 + 0.02 * 4.5)).abs() < 1e-4, "{found}");
}

#[test]
fn photos_and_motions_that_cannot_be_are_refused() {
    let (folder, still) = photo(4, 4, |_, _| 0.5);
    let plan = |params: Params| {
        let metas = PortMetas::new([("sensor".to_string(), vec![Meta::Sensor(Arc::new(sensor()))])].into());
        SimulatePhoto::build(params).and_then(|node| node.plan(&metas))
    };
    let message = |params: Params| plan(params).unwrap_err().message;
    assert!(plan(still.clone()).is_ok());
    assert_eq!(message(Params::default()), "`path` is missing");
    assert!(
        message(Params { path: InputPath::new("no/such.png"), ..still.clone() })
            .ends_with("no/such.png: there is no such file")
    );
    assert_eq!(
        message(Params { zoom: -100.0, ..still.clone() }),
        "at the end a pixel of the sensor sees 55 pixels of the photo in a row, at most 16 can be"
    );
    assert_eq!(
        message(Params { shrink: 5, ..still.clone() }),
        "4 x 4 pixels are less than one square of 5 x 5"
    );
    let clear = folder.path().join("clear.png");
    save(Path::new(&clear), 1, 1, (ColorType::Rgba, BitDepth::Eight), &[1, 2, 3, 4]);
    assert_eq!(
        message(Params { path: InputPath::new(clear), ..still.clone() }),
        "clear.png has transparency, and light has none"
    );
    let blank = PortMetas::new(
        [("sensor".to_string(), vec![Meta::Sensor(Arc::new(Sensor::unknown("blank")))])].into(),
    );
    let error = SimulatePhoto::build(still).unwrap().plan(&blank).unwrap_err();
    assert!(format!("{error} {:?}", error.notes).contains("optics.photocurrent_per_lux"), "{error}");
}
