//! Which thresholds are passed on: those of the recording where others are stated, and the stated ones where
//! nothing contradicts them.

use super::*;
use photocurrent_core::document::Source;
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::random::Random;
use photocurrent_core::{EventStream, Exposure, Extent, FrameSequence, FrameTimes, testing};
use photocurrent_sensor::effects::Site;
use photocurrent_sensor::forward::{
    Chain, FrameReadout, LinearLight, Noiseless, TOLERANCE, read_frames, simulate,
};
use photocurrent_sensor::model::Model;
use std::collections::BTreeMap;

const EXTENT: Extent = Extent { width: 48, height: 40 };
const END_NS: i64 = 130_000_000;
const PERIOD_NS: i64 = 8_000_000;
const RIGHT: ThresholdPair = (0.2, 0.21);

fn sensor((on, off): ThresholdPair) -> Arc<Sensor> {
    let text = format!(
        "format = \"photocurrent-sensor/1\"\n[front_end]\ntau_0 = \"30 us\"\nalpha = \"8 ms\"\n[comparator]\n\
         threshold_on = {on}\nthreshold_off = {off}\n[readout]\nlatency_min = \"10 us\"\n\
         refractory = \"30 us\"\n[frames]\ngain = 800\nblack_level_dn = 20\nsaturation_dn = \
                        1023\nread_noise_dn = 3\nrow_time = \"20 us\"\n"
    );
    Arc::new(Sensor::parse(&Source::new("s.toml", "", text)).unwrap())
}

/// Waves that run along x, brighter to the right.
fn log_light(x: u32, y: u32, t_ns: i64) -> f64 {
    let t = t_ns as f64 * 1e-9;
    4.0 + 0.01 * f64::from(x)
        + 0.7 * libm::tanh(2.0 * libm::sin(90.0 * t - 0.4 * f64::from(x) - 0.3 * f64::from(y)))
}

/// What a sensor with the right thresholds records in so many frames, with a read noise of 3 DN.
fn recording(frames: i64) -> (EventStream, FrameSequence) {
    let model = Model::of(&sensor(RIGHT));
    let times = FrameTimes::new(
        (0..frames).map(|l| Exposure::new(l * PERIOD_NS, l * PERIOD_NS + 5_000_000)).collect(),
        20_000,
    )
    .unwrap();
    let t_ns: Vec<i64> = (0..=END_NS / 100_000).map(|n| n * 100_000).collect();
    let readout = FrameReadout {
        number: model.number,
        saturation: model.saturation_dn,
        row_time_ns: model.row_time_ns,
    };
    let (mut events, mut dn) = (Vec::new(), Vec::new());
    for (x, y) in (0..EXTENT.height).flat_map(|y| (0..EXTENT.width).map(move |x| (x, y))) {
        let current: Vec<f64> = t_ns.iter().map(|&t| libm::exp(log_light(x, y, t))).collect();
        let light = LinearLight::new(&t_ns, &current);
        let site = Site { x, y, width: EXTENT.width, height: EXTENT.height, seed: 3 };
        let chain = Chain { pixel: model.pixel, reset: model.reset, effects: &[], tolerance: TOLERANCE };
        for event in simulate(&chain, &site, &light, 0, END_NS, &mut Noiseless)
            .into_iter()
            .filter_map(|fired| fired.recorded)
        {
            let polarity = Polarity::from_bit(u8::from(event.polarity > 0));
            events.push(Event {
                x: x as u16,
                y: y as u16,
                polarity,
                t: event.t_off_ns,
                t_in: Some(event.t_in_ns),
            });
        }
        let exposures: Vec<Exposure> = (0..times.len()).map(|l| times.exposure(l, y)).collect();
        dn.push(read_frames(&readout, &[], &site, &light, &exposures));
    }
    let mut random = Random::new(5, &[]);
    let noisy =
        |l: usize, x: u32, y: u32| (dn[(y * EXTENT.width + x) as usize][l] + 3.0 * random.normal()) as f32;
    (testing::stream(EXTENT, events), testing::captured(EXTENT, times.exposures.to_vec(), 20_000, noisy))
}

/// What the node makes of a recording and a description, and its note on that.
fn run((events, frames): &(EventStream, FrameSequence), sensor: Option<&Arc<Sensor>>) -> (Out, String) {
    let node = EstimateThresholds::build(Params {
        offset: Some(Duration::new(0)),
        pixels: 256,
        ..Params::default()
    })
    .unwrap();
    let input = In { events: events.clone(), frames: frames.clone(), sensor: sensor.cloned() };
    let (out, notes) =
        testing::with_context(frames.rows(), &["estimates", "sensor"], |cx| node.run(input, cx));
    (out.unwrap(), notes.into_iter().filter(|note| note.contains("description")).collect())
}

fn numbers(out: &Out, name: &str) -> Vec<f64> {
    let (_, column) = out.estimates.columns().iter().find(|(column, _)| column == name).unwrap();
    if let Column::Numbers(numbers) = column { numbers.clone() } else { panic!("{name} is no number") }
}

#[test]
fn wrong_thresholds_are_replaced_by_those_of_the_recording() {
    let recorded = recording(16);
    for factors in [(1.6, 1.28), (0.625, 0.78), (1.25, 1.0)] {
        let stated = (RIGHT.0 * factors.0, RIGHT.1 * factors.1);
        let description = sensor(stated);
        let (out, note) = run(&recorded, Some(&description));
        let passed = out.sensor.clone().unwrap();
        let used = super::stated_thresholds(&passed).unwrap();
        let is_near = |used: f64, right: f64| (used / right - 1.0).abs() < 0.1;
        assert!(is_near(used.0, RIGHT.0) && is_near(used.1, RIGHT.1), "{factors:?}: {note}");
        // Nothing else of the description changes.
        assert_eq!(with_thresholds(&passed, stated), *description);
        assert!(
            note.contains(&format!("instead of the description's {:.3} and {:.3}", stated.0, stated.1)),
            "{note}"
        );
        assert_eq!(
            (numbers(&out, "description")[..2].to_vec(), numbers(&out, "used")[..2].to_vec()),
            (vec![stated.0, stated.1], vec![used.0, used.1])
        );
        let gain: Vec<f64> =
            ["value", "ci95_low", "ci95_high"].iter().map(|name| numbers(&out, name)[2]).collect();
        assert!(0.03 < gain[1] && gain[1] < gain[0] && gain[0] < gain[2] && gain[0] < 1.0, "{gain:?}");
    }
}

#[test]
fn right_thresholds_stay_to_the_bit() {
    let (out, note) = run(&recording(16), Some(&sensor(RIGHT)));
    assert_eq!(out.sensor.as_ref(), Some(&sensor(RIGHT)), "{note}");
    assert!(note.starts_with("the description's thresholds 0.200 and 0.210 stay: "), "{note}");
    assert_eq!(numbers(&out, "used")[..2], [RIGHT.0, RIGHT.1]);
}

#[test]
fn without_evidence_the_description_stays_with_a_note() {
    let description = sensor((0.4, 0.4));
    let stays = |recorded: &(EventStream, FrameSequence), description: &Arc<Sensor>, why: &str| {
        let (out, note) = run(recorded, Some(description));
        assert_eq!(out.sensor.as_ref(), Some(description), "{note}");
        assert!(note.contains(why), "{note}");
        assert!(numbers(&out, "value")[2].is_nan(), "nothing was compared");
    };
    let (events, frames) = recording(3);
    stays(
        &(events, frames.clone()),
        &description,
        "the description's thresholds stay: of 3 frames none can be held out, as 4 are needed",
    );
    let (_, many) = recording(6);
    let few = vec![Event { x: 3, y: 3, polarity: Polarity::On, t: 5_000_000, t_in: Some(4_990_000) }];
    stays(
        &(testing::stream(EXTENT, few), many),
        &description,
        "0 events of 0 pixels in 0 tiles are too few, as 40 in 6 tiles are needed",
    );
    let mut unknown = (*description).clone();
    unknown.frames.gain = None;
    stays(
        &recording(6),
        &Arc::new(unknown.clone()),
        "the description's thresholds stay: solve/map needs `frames.gain`",
    );
    unknown.comparator.threshold_on = None;
    stays(&recording(6), &Arc::new(unknown), "does not state both thresholds");
    let (out, _) = run(&recording(6), None);
    assert!(out.sensor.is_none() && numbers(&out, "description").iter().all(|stated| stated.is_nan()));
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let recorded = recording(8);
    let passed = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&recorded, Some(&sensor((0.3, 0.25)))).0.sensor.unwrap())
    };
    let one = passed(1);
    assert_eq!(one, passed(3));
    assert_ne!(stated_thresholds(&one), Some((0.3, 0.25)));
}

#[test]
fn the_description_is_planned_as_it_is_given() {
    let (events, frames) = recording(4);
    let node = EstimateThresholds::build(Params::default()).unwrap();
    let streams =
        [("events", Meta::Events(events.meta.clone())), ("frames", Meta::Frames(frames.meta.clone()))];
    let metas = |sensor: Option<Meta>| {
        let inputs = streams.iter().cloned().chain(sensor.map(|sensor| ("sensor", sensor)));
        PortMetas::new(inputs.map(|(port, meta)| (port.to_string(), vec![meta])).collect::<BTreeMap<_, _>>())
    };
    let given = Meta::Sensor(sensor(RIGHT));
    assert_eq!(node.plan(&metas(Some(given.clone()))).unwrap()[1], given);
    assert!(matches!(node.plan(&metas(None)).unwrap()[1], Meta::Absent { data_type: DataType::Sensor, .. }));
}
