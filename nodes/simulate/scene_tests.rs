//! Tests of `simulate/scene`: sampled light against the scene itself, bands, truth, messages.

use super::scenes::tests::ALL;
use super::*;
use photocurrent_core::{Rows, light, testing};
use std::sync::Arc;

fn sensor() -> Sensor {
    let mut sensor = Sensor::unknown("test");
    sensor.optics.photocurrent_per_lux = Some(0.2);
    sensor.frames.gain = Some(1000.0);
    sensor.frames.black_level_dn = Some(5.0);
    sensor
}

fn small(scene: scenes::Name) -> Params {
    Params { scene, width: 40, height: 30, duration: Duration::new(40_000_000), ..Params::default() }
}

fn run(params: Params, rows: Rows) -> Out {
    let node = SimulateScene::build(params).unwrap();
    testing::with_context(rows, &["light", "truth"], |cx| node.run(In { sensor: Arc::new(sensor()) }, cx))
        .0
        .unwrap()
}

const ROWS: Rows = Rows { start: 0, end: 30 };

#[test]
fn between_instants_light_is_the_scene_within_the_tolerance() {
    for name in ALL {
        let params = small(name);
        let out = run(params.clone(), ROWS);
        let band = out.light.read(ROWS).unwrap();
        // The context of tests has the seed 7.
        let scene = params.details.scene(name, Extent { width: 40, height: 30 }, 7);
        let mut worst: f64 = 0.0;
        for (x, y) in ROWS.iter().flat_map(|y| (0..40).map(move |x| (x, y))) {
            let pixel = band.pixel(x, y);
            assert!(
                pixel.t.is_sorted_by(|a, b| a < b)
                    && pixel.t[0] == 0
                    && pixel.t.iter().all(|t| *t <= 40_000_000),
                "{name:?}"
            );
            for t in (0..=97).map(|k| k * 411_237) {
                let exact = 60.0 * scene.light(f64::from(x), f64::from(y), t);
                worst = worst.max(libm::log(light::at(pixel, t).unwrap() / exact).abs());
            }
        }
        assert!(worst < 1.1e-3, "{name:?} is off by {worst}");
    }
}

#[test]
fn bands_are_rows_of_the_whole() {
    let rows = Rows { start: 11, end: 17 };
    for name in ALL {
        let (whole, band) = (run(small(name), ROWS), run(small(name), rows));
        assert_eq!(whole.light.read(rows).unwrap(), band.light.read(rows).unwrap());
        assert_eq!(whole.truth.0.read_rows(rows).unwrap(), band.truth.0.read_rows(rows).unwrap());
    }
}

#[test]
fn every_value_is_the_scene_behind_its_filter_and_truth_may_have_all_three() {
    let extent = Extent { width: 40, height: 30 };
    for name in ["rgb", "bayer_grbg", "quad_bayer_rggb"] {
        let colour = Colour::named(name).unwrap();
        let params = Params {
            colour,
            truth_colour: Some(Colour::Rgb),
            truth_rate: Rate::new(100.0),
            ..small(scenes::Name::ColourWheel)
        };
        let out = run(params.clone(), ROWS);
        let scene = params.details.scene(params.scene, extent, 7);
        assert_eq!((out.light.meta.colour, out.truth.0.meta.colour), (colour, Colour::Rgb));
        let (light, truth) = (out.light.read(ROWS).unwrap(), out.truth.0.read_rows(ROWS).unwrap());
        for (x, y) in [(5, 9), (20, 15), (21, 14), (27, 22), (33, 3)] {
            for channel in 0..3 {
                for (l, t) in [(0, 0), (2, 20_000_000)] {
                    let exact = 60.0 * scene.channel(channel as usize, f64::from(x), f64::from(y), t);
                    let value = if colour == Colour::Rgb { 3 * x + channel } else { x };
                    if colour.channel(value, y) == Some(channel as usize) {
                        assert!((light::at(light.pixel(value, y), t).unwrap() / exact - 1.0).abs() < 2e-3);
                    }
                    // DN = black + gain x photocurrent x exposure.
                    assert!(
                        (f64::from(truth.row(l, y)[(3 * x + channel) as usize])
                            - (5.0 + 1000.0 * exact * 6.5e-3))
                            .abs()
                            < 1e-3
                    );
                }
            }
        }
    }
}

#[test]
fn truth_is_illuminance_times_reflectance_times_exposure() {
    let params = Params {
        illuminance: Illuminance::new(1000.0),
        exposure: Duration::new(2_000_000),
        ..small(scenes::Name::SiemensDisk)
    };
    let out = run(params, ROWS);
    assert_eq!(out.truth.0.meta.times.len(), 40);
    let dn = out.truth.0.read_rows(ROWS).unwrap();
    // The wall next to the disk: 5 DN of darkness + 1000 DN/s x 0.2 / lx x 1000 lx x 0.3 x 2 ms.
    assert_eq!(dn.row(17, 0)[0], 125.0);
    let band = out.light.read(ROWS).unwrap();
    assert_eq!((band.pixel(0, 0).t, band.pixel(0, 0).photocurrent), ([0].as_slice(), [60.0].as_slice()));
}

#[test]
fn what_is_not_asked_for_is_not_drawn() {
    let node = SimulateScene::build(small(scenes::Name::Fan)).unwrap();
    let out = testing::with_context(ROWS, &["light"], |cx| node.run(In { sensor: Arc::new(sensor()) }, cx))
        .0
        .unwrap();
    assert!(out.truth.0.read_rows(ROWS).unwrap().dn.iter().all(|dn| *dn == 0.0));
}

#[test]
fn parameters_of_another_scene_are_refused() {
    let mut params = small(scenes::Name::SiemensDisk);
    params.details.fan.blades = 3;
    let error = SimulateScene::build(params).err().unwrap();
    assert_eq!(error.message, "`fan` is set, but the scene is \"siemens_disk\"");
    assert_eq!(error.param.as_deref(), Some("fan"));
}

#[test]
fn a_sensor_that_does_not_say_what_a_lux_is_worth_is_refused() {
    let node = SimulateScene::build(Params::default()).unwrap();
    let metas = PortMetas::new(
        [("sensor".to_string(), vec![Meta::Sensor(Arc::new(Sensor::unknown("blank")))])].into(),
    );
    let error = node.plan(&metas).unwrap_err();
    assert!(format!("{error} {:?}", error.notes).contains("optics.photocurrent_per_lux"), "{error}");
}

#[test]
fn a_pellet_that_does_not_fit_is_refused() {
    let mut params = small(scenes::Name::Pellet);
    params.details.pellet.radius = 15.0;
    assert_eq!(
        SimulateScene::build(params).err().unwrap().message,
        "a pellet of radius 15 does not fit into 40 x 30 pixels"
    );
}

#[test]
fn an_ideal_sensor_fires_once_for_each_threshold_of_the_scenes_own_log_light() {
    use super::super::sensor::{self, SimulateSensor};
    let params =
        Params { width: 24, height: 16, duration: Duration::new(20_000_000), ..small(scenes::Name::Pellet) };
    let (extent, rows) = (Extent { width: 24, height: 16 }, Rows { start: 0, end: 16 });
    let mut ideal = sensor();
    ideal.front_end.tau_0 = Some(Duration::new(0));
    ideal.front_end.alpha = Some(Duration::new(0));
    ideal.comparator.threshold_on = Some(0.2);
    ideal.comparator.threshold_off = Some(0.2);
    ideal.readout.refractory = Some(Duration::new(0));
    ideal.frames.row_time = Some(Duration::new(30_000));
    let camera = SimulateSensor::build(sensor::Params {
        latency_spread: Duration::new(0),
        ..sensor::Params::default()
    })
    .unwrap();
    let input = sensor::In { light: run(params.clone(), rows).light, sensor: Arc::new(ideal) };
    let out = testing::with_context(rows, &["events", "frames"], |cx| camera.run(input, cx)).0.unwrap();
    let band = out.events.read(rows).unwrap();
    // The context of tests has the seed 7.
    let scene = params.details.scene(scenes::Name::Pellet, extent, 7);
    let mut checked = 0;
    for y in 0..16 {
        let row = band.row(y);
        let index = row.by_pixel(24);
        for x in 0..24_u32 {
            let log = |t| libm::log(scene.light(f64::from(x), f64::from(y), t));
            let mut net = 0.0;
            for &k in index.pixel(x as usize) {
                net += if row.on[k] == 1 { 0.2 } else { -0.2 };
                // Light is sampled to a thousandth of its logarithm; a stamp is a whole nanosecond.
                let change = log(row.t[k]) - log(0);
                assert!((net - change).abs() < 5e-3, "({x}, {y}): {net} against {change}");
                checked += 1;
            }
        }
    }
    assert!(checked > 500, "{checked} events");
}

#[test]
fn the_plan_knows_about_how_many_instants_there_will_be() {
    for name in ALL {
        let node = SimulateScene::build(small(name)).unwrap();
        let count = *run(small(name), ROWS).light.read(ROWS).unwrap().offsets().last().unwrap() as f64;
        let estimated = node.instants() * node.extent().pixels() as f64;
        assert!(
            (count / 2.0..count * 2.0).contains(&estimated),
            "{name:?}: {estimated} instants were planned, {count} came"
        );
    }
}
