//! Tests of `simulate/video`: light against what was stored, events at times from algebra, bands, windows of
//! time, messages.

use super::super::stored::tests::{save, wide};
use super::*;
use crate::simulate::sensor::{self as camera, SimulateSensor};
use photocurrent_core::{Extent, light, testing};
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

const GREY: (ColorType, BitDepth) = (ColorType::Grayscale, BitDepth::Sixteen);

/// A folder of grey pictures of 16 bits, `f1.png` and so on; the value at (x, y) of frame k is
/// `value(k, x, y)`.
fn pictures(frames: u32, extent: Extent, value: impl Fn(u32, u32, u32) -> u16) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for k in 0..frames {
        let values: Vec<u16> = extent
            .rows()
            .iter()
            .flat_map(|y| (0..extent.width).map(move |x| (x, y)))
            .map(|(x, y)| value(k, x, y))
            .collect();
        save(
            &folder.path().join(format!("f{}.png", k + 1)),
            extent.width,
            extent.height,
            GREY,
            &wide(&values),
        );
    }
    folder
}

/// White is 60 (300 lx x 0.2 / lx), frames are a millisecond apart, values are linear.
fn linear(path: &Path) -> Params {
    Params {
        path: InputPath::new(path),
        rate: Some(Rate::new(1000.0)),
        transfer: Some(Transfer::Linear),
        ..Params::default()
    }
}

fn plan(params: Params) -> Result<Vec<Meta>, NodeError> {
    let metas = PortMetas::new([("sensor".to_string(), vec![Meta::Sensor(Arc::new(sensor()))])].into());
    SimulateVideo::build(params)?.plan(&metas)
}

fn run_rows(params: Params, rows: Rows) -> Out {
    let node = SimulateVideo::build(params).unwrap();
    testing::with_context(rows, &["light", "truth"], |cx| node.run(In { sensor: Arc::new(sensor()) }, cx))
        .0
        .unwrap()
}

fn run(params: Params) -> Out {
    let Meta::Light(meta) = &plan(params.clone()).unwrap()[0] else { panic!("light") };
    run_rows(params, meta.extent.rows())
}

const THREE: Extent = Extent { width: 3, height: 1 };

#[test]
fn light_is_what_was_stored_and_what_stands_still_costs_one_instant() {
    // One pixel rises by 5 a frame, one is constant, one turns in frame 10.
    let value =
        |k: u32, x: u32, _: u32| [20_000 + 5 * k, 30_000, 40_000 - 1000 * k.abs_diff(10)][x as usize] as u16;
    let folder = pictures(33, THREE, value);
    let band = run(linear(folder.path())).light.read(THREE.rows()).unwrap();
    for (x, k) in (0..3).flat_map(|x| (0..33).map(move |k| (x, k))) {
        let expected = (60.0 * (f64::from(value(k, x, 0)) / 65535.0)) as f32;
        assert_eq!(
            light::at(band.pixel(x, 0), i64::from(k) * 1_000_000).unwrap() as f32,
            expected,
            "pixel {x}, frame {k}"
        );
    }
    assert_eq!(
        (band.pixel(1, 0).t, band.pixel(1, 0).photocurrent),
        ([0].as_slice(), [(60.0 * (30_000.0 / 65535.0)) as f32].as_slice())
    );
    let turns = band.pixel(2, 0);
    assert!(turns.t.contains(&0) && turns.t.contains(&10_000_000), "{:?}", turns.t);
    // With some tolerance only the turn stays.
    let loose = run(Params { tolerance: 1e-5, ..linear(folder.path()) }).light.read(THREE.rows()).unwrap();
    assert_eq!(loose.pixel(0, 0).t, [0, 32_000_000]);
    assert_eq!(loose.pixel(2, 0).t, [0, 10_000_000, 32_000_000]);
}

#[test]
fn a_ramp_that_floats_hold_exactly_costs_two_instants() {
    // White is 65535 / 1024, so that every stored value is exact in f32 too.
    let folder = pictures(50, THREE, |k, x, _| (1000 + 100 * k * x) as u16);
    let mut exact = sensor();
    exact.optics.photocurrent_per_lux = Some(65535.0 / 1024.0);
    let node = SimulateVideo::build(Params {
        illuminance: Illuminance::new(1.0),
        black: 1e-6,
        ..linear(folder.path())
    })
    .unwrap();
    let out =
        testing::with_context(THREE.rows(), &["light"], |cx| node.run(In { sensor: Arc::new(exact) }, cx))
            .0
            .unwrap();
    let band = out.light.read(THREE.rows()).unwrap();
    assert_eq!(
        (band.pixel(2, 0).t, band.pixel(2, 0).photocurrent),
        ([0, 49_000_000].as_slice(), [1000.0 / 1024.0, 10_800.0 / 1024.0].as_slice())
    );
}

#[test]
fn noise_of_one_step_is_kept_to_the_bit() {
    let value = |k: u32, x: u32, y: u32| {
        30_000 + ((k * 7919 + x * 104_729 + y * 1_299_709).wrapping_mul(2_654_435_761) >> 30) as u16
    };
    let extent = Extent { width: 8, height: 4 };
    let folder = pictures(40, extent, value);
    let band = run(linear(folder.path())).light.read(extent.rows()).unwrap();
    for (x, y, k) in (0..8).flat_map(|x| (0..4).flat_map(move |y| (0..40).map(move |k| (x, y, k)))) {
        let expected = (60.0 * (f64::from(value(k, x, y)) / 65535.0)) as f32;
        assert_eq!(
            (light::at(band.pixel(x, y), i64::from(k) * 1_000_000).unwrap() as f32).to_bits(),
            expected.to_bits()
        );
    }
}

#[test]
fn an_ideal_sensor_fires_on_a_ramp_when_algebra_says() {
    // 6000 at the first frame, 54000 at the 25th: i = 6000 (1 + t / 3 ms).
    let folder = pictures(25, THREE, |k, x, _| if x == 0 { 30_000 } else { (6000 + 2000 * k) as u16 });
    let out = run(linear(folder.path()));
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
    let seen = testing::with_context(THREE.rows(), &["events"], |cx| {
        node.run(camera::In { light: out.light, sensor: Arc::new(ideal) }, cx)
    })
    .0
    .unwrap();
    let events = seen.events.read(THREE.rows()).unwrap();
    let times: Vec<i64> = events.x.iter().zip(&events.t).filter(|(x, _)| **x == 1).map(|(_, t)| *t).collect();
    assert!(events.x.iter().all(|x| *x > 0), "what is constant is silent");
    // ln(1 + t / 3 ms) passes 0.2 n; ln 9 is 2.197: ten events.
    assert_eq!(times.len(), 10);
    for (n, t) in (1..).zip(&times) {
        let expected = 3e6 * (libm::exp(0.2 * f64::from(n)) - 1.0);
        // The simulator takes log light in pieces of 0.01, each off by 1.25e-5 at most: 340 ns where the
        // slope is least.
        assert!((*t as f64 - expected).abs() < 400.0, "event {n} at {t}, {expected} expected");
    }
}

#[test]
fn truth_is_the_film_at_instants_and_linear_between_frames() {
    let folder = pictures(5, THREE, |k, x, _| (10_000 * (1 + k % 2) + x) as u16);
    let out = run(Params {
        truth_rate: Rate::new(4000.0),
        exposure: Duration::new(2_000_000),
        ..linear(folder.path())
    });
    assert_eq!(out.truth.0.meta.times.len(), 16);
    let dn = out.truth.0.read_rows(THREE.rows()).unwrap();
    for l in 0..16 {
        // A triangle between 10000 and 20000 with a period of two frames; 5 DN of darkness, 1000 DN/s, 2 ms.
        let phase = f64::from(l) / 4.0 % 2.0;
        let stored = 10_000.0 * (1.0 + if phase < 1.0 { phase } else { 2.0 - phase });
        let expected = 5.0 + 2.0 * 60.0 * stored / 65535.0;
        assert!((f64::from(dn.row(l as usize, 0)[0]) - expected).abs() < 1e-5 * expected, "frame {l}");
    }
}

#[test]
fn the_light_may_begin_and_end_between_frames() {
    let folder = pictures(9, THREE, |k, x, _| if x == 0 { 9000 } else { (1000 + 1000 * k * k) as u16 });
    let params = Params {
        start: Duration::new(2_500_000),
        duration: Some(Duration::new(3_250_000)),
        truth_rate: Rate::new(2000.0),
        ..linear(folder.path())
    };
    let out = run(params);
    assert_eq!(out.light.meta.span.end.0, 3_250_000);
    let band = out.light.read(THREE.rows()).unwrap();
    let pixel = band.pixel(1, 0);
    assert_eq!(pixel.t, [0, 500_000, 1_500_000, 2_500_000, 3_250_000]);
    // Half-way from 5000 to 10000, then frames 3, 4, 5, then three quarters from 26000 to 37000.
    for (found, stored) in pixel.photocurrent.iter().zip([7500.0, 10_000.0, 17_000.0, 26_000.0, 34_250.0]) {
        assert!((f64::from(*found) / (60.0 * stored / 65535.0) - 1.0).abs() < 1e-6, "{found}, {stored}");
    }
    assert_eq!(band.pixel(0, 0).t, [0]);
    let truth = out.truth.0.read_rows(THREE.rows()).unwrap();
    assert!((f64::from(truth.row(0, 0)[1]) - (5.0 + 6.5 * 60.0 * 7500.0 / 65535.0)).abs() < 1e-3);
}

#[test]
fn dark_is_bounded_and_white_is_the_illuminance() {
    let folder = pictures(2, THREE, |_, x, _| [0, 65535, 600][x as usize]);
    let band = run(Params { illuminance: Illuminance::new(1000.0), ..linear(folder.path()) })
        .light
        .read(THREE.rows())
        .unwrap();
    assert_eq!([0, 1, 2].map(|x| band.pixel(x, 0).photocurrent[0]), [2.0, 200.0, 2.0]);
}

/// Some bytes of a Y4M film: 4 x 6 pixels of 4:2:0 at 500 frames per second.
fn y4m() -> Vec<u8> {
    let mut bytes = b"YUV4MPEG2 W4 H6 F500:1 Ip C420jpeg\n".to_vec();
    for k in 0..7u8 {
        bytes.extend_from_slice(b"FRAME\n");
        bytes.extend((0..24).map(|p| 20 + 8 * p + k * (p % 5)));
        bytes.extend((0..12).map(|p| 128 + (p + k) % 3));
    }
    bytes
}

#[test]
fn bands_are_rows_of_the_whole() {
    let extent = Extent { width: 5, height: 6 };
    let folder = pictures(40, extent, |k, x, y| (3000 + 977 * ((k * (x + 1)) % 13) + 2000 * y) as u16);
    let file = folder.path().join("film.y4m");
    std::fs::write(&file, y4m()).unwrap();
    let cases = [linear(folder.path()), Params { path: InputPath::new(file), ..Params::default() }];
    for params in cases {
        let (whole, rows) = (run(params.clone()), Rows { start: 1, end: 4 });
        let band = run_rows(params, rows);
        assert_eq!(whole.light.read(rows).unwrap(), band.light.read(rows).unwrap());
        assert_eq!(whole.truth.0.read_rows(rows).unwrap(), band.truth.0.read_rows(rows).unwrap());
    }
}

#[test]
fn a_y4m_file_states_its_rate_and_another_one_may_be_stated() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("film.y4m");
    std::fs::write(&path, y4m()).unwrap();
    let end =
        |rate| match &plan(Params { path: InputPath::new(&path), rate, ..Params::default() }).unwrap()[0] {
            Meta::Light(meta) => (meta.extent, meta.span.end.0),
            _ => panic!("light"),
        };
    assert_eq!(end(None), (Extent { width: 4, height: 6 }, 12_000_000));
    assert_eq!(end(Some(Rate::new(6000.0))).1, 1_000_000);
}

#[test]
fn every_file_counts_for_the_key_in_the_order_of_the_film() {
    let folder = pictures(12, THREE, |k, _, _| k as u16);
    let node = SimulateVideo::build(linear(folder.path())).unwrap();
    let names: Vec<String> = node.files().iter().map(|file| short_name(&file.path)).collect();
    let expected: Vec<String> = (1..=12).map(|k| format!("f{k}.png")).collect();
    assert_eq!(names, expected);
}

#[test]
fn films_that_cannot_be_are_refused() {
    let folder = pictures(3, THREE, |_, _, _| 0);
    let message = |params: Params| plan(params).unwrap_err().message;
    assert_eq!(message(Params::default()), "`path` is missing");
    assert!(message(linear(Path::new("no/such/folder"))).contains("no/such/folder: there is no such file"));
    assert_eq!(
        message(Params { rate: None, ..linear(folder.path()) }),
        "`rate` is missing, and the film does not say how fast it was taken"
    );
    assert_eq!(
        message(Params { range: Some(Range::Full), ..linear(folder.path()) }),
        "`range` is set, and pictures always use all of theirs"
    );
    let late = plan(Params { start: Duration::new(2_000_000), ..linear(folder.path()) }).unwrap_err();
    assert!(
        late.message.starts_with("`start` is 2 ms, and ") && late.param.as_deref() == Some("start"),
        "{late}"
    );
    let long =
        plan(Params { duration: Some(Duration::new(2_000_001)), ..linear(folder.path()) }).unwrap_err();
    assert!(
        long.message.ends_with("is shorter than `duration` asks for: 2 ms are left from `start` on"),
        "{long}"
    );
    assert_eq!(long.notes, ["3 frames at 1 kHz: the last is 2 ms after the first"]);
    let slow =
        plan(Params { rate: Some(Rate::new(0.001)), truth_rate: Rate::new(1e6), ..linear(folder.path()) })
            .unwrap_err();
    assert_eq!(slow.message, "`truth_rate` asks for 2000000000 true frames, and 10000000 are the most");
    let one = pictures(1, THREE, |_, _, _| 0);
    assert!(message(linear(one.path())).ends_with("has one frame, and light between frames needs two"));
    let empty = tempfile::tempdir().unwrap();
    assert!(message(linear(empty.path())).starts_with("there is no PNG, TIFF or JPEG picture in "));
    assert_eq!(
        message(linear(&folder.path().join("f1.png"))),
        "f1.png: it is no Y4M file: it begins with `.PNG.`, expected `YUV4MPEG2 W... H...`"
    );
}

#[test]
fn a_sensor_that_does_not_say_what_a_lux_is_worth_is_refused() {
    let folder = pictures(2, THREE, |_, _, _| 0);
    let metas = PortMetas::new(
        [("sensor".to_string(), vec![Meta::Sensor(Arc::new(Sensor::unknown("blank")))])].into(),
    );
    let error = SimulateVideo::build(linear(folder.path())).unwrap().plan(&metas).unwrap_err();
    assert!(format!("{error} {:?}", error.notes).contains("optics.photocurrent_per_lux"), "{error}");
}
