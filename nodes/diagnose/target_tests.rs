//! A star is found by what is free about it, and what cannot be free is refused.

use super::*;
use crate::simulate::scene::SimulateScene;
use crate::simulate::sensor::SimulateSensor;
use photocurrent_core::testing;
use serde_json::json;

const EXTENT: Extent = Extent { width: 40, height: 30 };

fn sensor() -> Arc<Sensor> {
    let mut sensor = Sensor::unknown("test");
    sensor.front_end.tau_0 = Some(Duration::new(0));
    sensor.front_end.alpha = Some(Duration::new(0));
    sensor.comparator.threshold_on = Some(0.2);
    sensor.comparator.threshold_off = Some(0.2);
    sensor.readout.refractory = Some(Duration::new(0));
    sensor.optics.photocurrent_per_lux = Some(0.5);
    sensor.frames.gain = Some(800.0);
    sensor.frames.row_time = Some(Duration::new(10_000));
    Arc::new(sensor)
}

/// What the sensor records of a star whose parameters are given.
fn recording(star: Value, sensor: &Arc<Sensor>) -> (EventStream, FrameSequence) {
    let node = SimulateScene::build(serde_json::from_value(star).unwrap()).unwrap();
    let source = crate::simulate::source::In { sensor: sensor.clone() };
    let light = testing::with_context(EXTENT.rows(), &["light"], |cx| node.run(source, cx)).0.unwrap().light;
    let camera = SimulateSensor::build(serde_json::from_value(json!({})).unwrap()).unwrap();
    let input = crate::simulate::sensor::In { light, sensor: sensor.clone() };
    let out =
        testing::with_context(EXTENT.rows(), &["events", "frames"], |cx| camera.run(input, cx)).0.unwrap();
    (out.events, out.frames)
}

fn built(params: &Value) -> Result<DiagnoseTarget, NodeError> {
    DiagnoseTarget::build(serde_json::from_value(params.clone()).unwrap())
}

#[test]
fn a_star_is_found_by_its_speed_and_light() {
    let sensor = sensor();
    let star = json!({
        "scene": "siemens_disk", "width": 40, "height": 30, "duration": "60 ms", "illuminance": "300 lx",
        "siemens_disk": { "speed": "292 rpm" },
    });
    let (events, frames) = recording(star, &sensor);
    let free = json!({
        "siemens_disk.speed": ["270 rpm", "310 rpm"], "illuminance": ["150 lx", "500 lx"],
        "start": ["-2 ms", "2 ms"],
    });
    let node =
        built(&json!({ "scene": "siemens_disk", "free": free, "tries": 2000, "values": 4000 })).unwrap();
    let input = In { events: Some(events), frames, sensor };
    let out = testing::with_context(EXTENT.rows(), &["light", "fitted"], |cx| node.run(input, cx)).0.unwrap();
    let Some(Column::Numbers(found)) = out.fitted.column("value") else { panic!("numbers") };
    let Some(Column::Texts(names)) = out.fitted.column("parameter") else { panic!("names") };
    for (name, truth, error) in
        [("siemens_disk.speed", 292.0, 0.3), ("illuminance", 300.0, 1.0), ("start", 0.0, 0.02)]
    {
        let value = found[names.iter().position(|one| one == name).unwrap()];
        assert!((value - truth).abs() < error, "{name}: {value} is {truth}");
    }
}

#[test]
fn what_is_no_number_of_the_target_and_ranges_that_are_none_are_refused() {
    let error = |free: Value| built(&json!({ "scene": "siemens_disk", "free": free })).err().unwrap().message;
    assert_eq!(
        error(json!({ "siemens_disk.colour": [0, 1] })),
        "`siemens_disk.colour` is no number of this target"
    );
    assert_eq!(error(json!({ "tries": [0, 1] })), "`tries` is no number of this target");
    assert!(error(json!({ "start": [0, 1] })).contains("the range of `start`"));
    assert!(error(json!({ "start": ["1 ms", "0 ms"] })).contains("the range of `start`"));
    assert!(error(json!({ "start": ["1 lx", "2 lx"] })).contains("`start` cannot be"));
}
