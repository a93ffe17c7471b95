//! The wiring of the estimates: what they refuse, which inputs they use, the form of their table, and that a
//! scene with known values gives these. The numerics are tested where they stand, in
//! `photocurrent_sensor::estimate`.

use super::*;
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::quantity::Duration;
use photocurrent_core::{Exposure, Extent, Node, testing};
use std::collections::BTreeMap;

const EXTENT: Extent = Extent { width: 40, height: 32 };
const PERIOD_NS: i64 = 20_000_000;
const FRAMES: i64 = 10;
const THRESHOLD: f64 = 0.15;

/// Logarithm of the light: waves that drift.
fn log_light(speed: f64, x: f64, y: f64, t_ns: i64) -> f64 {
    let x = x - speed * t_ns as f64 * 1e-9;
    0.5 * libm::sin(0.41 * x + 0.23 * y)
        + 0.35 * libm::sin(0.17 * x - 0.31 * y + 1.0)
        + 0.25 * libm::sin(0.73 * x + 0.11 * y + 2.0)
}

/// Crossings of whole thresholds, stamped `late_ns` later, and frames of `black` and the light's value in the
/// middle of short exposures.
fn recording(speed: f64, late_ns: i64, black: f32) -> (EventStream, FrameSequence) {
    recorded(|x, y, t_ns| log_light(speed, x, y, t_ns), late_ns, black, (0.0, 0.0))
}

/// The same of any light, by place and time; frames see it `moved` pixels right and down of where events do.
fn recorded(
    log_light: impl Fn(f64, f64, i64) -> f64,
    late_ns: i64,
    black: f32,
    moved: (f64, f64),
) -> (EventStream, FrameSequence) {
    let mut events = Vec::new();
    for (x, y) in (0..EXTENT.height).flat_map(|y| (0..EXTENT.width).map(move |x| (x, y))) {
        let light = |t_ns: i64| log_light(f64::from(x), f64::from(y), t_ns);
        let mut level = libm::floor(light(0) / THRESHOLD);
        for t in (0..(FRAMES + 1) * PERIOD_NS).step_by(100_000) {
            let now = light(t) / THRESHOLD;
            let event = |polarity| Event { x: x as u16, y: y as u16, polarity, t: t + late_ns, t_in: None };
            while now >= level + 1.0 {
                level += 1.0;
                events.push(event(Polarity::On));
            }
            while now < level - 1.0 {
                level -= 1.0;
                events.push(event(Polarity::Off));
            }
        }
    }
    let exposures: Vec<Exposure> =
        (0..FRAMES).map(|l| Exposure::new(10_000_000 + l * PERIOD_NS, 10_500_000 + l * PERIOD_NS)).collect();
    let mids: Vec<i64> = exposures.iter().map(|exposure| exposure.mid().0).collect();
    let frames = testing::captured(EXTENT, exposures, 0, |frame, x, y| {
        let (x, y) = (f64::from(x) - moved.0, f64::from(y) - moved.1);
        black + 300.0 * libm::exp(log_light(x, y, mids[frame])) as f32
    });
    (testing::stream(EXTENT, events), frames)
}

fn metas(events: &EventStream, frames: &FrameSequence) -> PortMetas {
    PortMetas::new(BTreeMap::from([
        ("events".to_string(), vec![Meta::Events(events.meta.clone())]),
        ("frames".to_string(), vec![Meta::Frames(frames.meta.clone())]),
    ]))
}

/// Rows by quantity: value, low, high, unit.
type TableValues = BTreeMap<String, (f64, f64, f64, String)>;

/// What a node gives of streams, and its notes.
fn run<N: Node<In = In>>(
    node: &N,
    events: &EventStream,
    frames: &FrameSequence,
    table: impl Fn(N::Out) -> Arc<Table>,
) -> (TableValues, Vec<String>) {
    assert_eq!(
        node.plan(&metas(events, frames)).unwrap()[0],
        Meta::Table(Arc::new(TableMeta { scores: false }))
    );
    let input = In { events: events.clone(), frames: frames.clone(), sensor: None };
    let (out, notes) = testing::with_context(frames.rows(), &["estimates"], |cx| node.run(input, cx));
    let table = table(out.unwrap());
    let names: Vec<&str> = table.columns().iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names[..5], ["quantity", "value", "ci95_low", "ci95_high", "unit"]);
    let text = |row: usize, column: usize| match &table.columns()[column].1 {
        Column::Texts(texts) => texts[row].clone(),
        other => panic!("no text: {other:?}"),
    };
    let number = |row: usize, column: usize| match &table.columns()[column].1 {
        Column::Numbers(numbers) => numbers[row],
        other => panic!("no number: {other:?}"),
    };
    (
        ((0..table.len())
            .map(|row| (text(row, 0), (number(row, 1), number(row, 2), number(row, 3), text(row, 4)))))
        .collect(),
        notes,
    )
}

#[test]
fn a_scene_with_known_values_gives_them_in_their_units() {
    let (events, frames) = recording(250.0, 3_000_000, 0.0);
    let (found, _) =
        run(&offset::EstimateOffset::build(offset::Params::default()).unwrap(), &events, &frames, |out| {
            out.estimates
        });
    let (late, low, high, unit) = &found["offset"];
    assert!((late - 3.0).abs() < 0.5 && low <= late && late <= high && unit == "ms", "{found:?}");
    assert!(found.contains_key("drift"), "{found:?}");
    let (found, _) = run(
        &row_time::EstimateRowTime::build(row_time::Params::default()).unwrap(),
        &events,
        &frames,
        |out| out.estimates,
    );
    let (row_time, _, _, unit) = &found["row_time"];
    assert!(unit == "us" && (row_time.is_nan() || row_time.abs() <= 20.0), "{found:?}");
    let (found, notes) = run(
        &thresholds::EstimateThresholds::build(thresholds::Params::default()).unwrap(),
        &events,
        &frames,
        |out| out.estimates,
    );
    for name in ["threshold_on", "threshold_off"] {
        let (_, low, high, unit) = &found[name];
        assert!(*low <= THRESHOLD && THRESHOLD <= *high && unit == "ln", "{found:?}");
    }
    assert!(notes[0].contains("too dark") && notes[0].contains("ms later"), "{notes:?}");
}

#[test]
fn rows_and_a_stated_front_end_are_no_offset() {
    // What the light of row y is, all of it is later by 100 us times y and by the 3 ms of the front end:
    // frames of a rolling shutter show the first and events both.
    let (events, frames) = recording(250.0, 3_000_000, 0.0);
    let block = events.read(frames.rows()).unwrap();
    let mut later = Vec::new();
    for y in frames.rows().iter() {
        let row = block.row(y);
        for k in 0..row.len() {
            let polarity = if row.on[k] == 1 { Polarity::On } else { Polarity::Off };
            later.push(Event {
                x: row.x[k],
                y: y as u16,
                polarity,
                t: row.t[k] + 100_000 * i64::from(y),
                t_in: None,
            });
        }
    }
    let events = testing::stream(EXTENT, later);
    let values = frames.read(0..frames.len(), frames.rows()).unwrap();
    let rolling = testing::captured(EXTENT, frames.meta.times.exposures.to_vec(), 100_000, |frame, x, y| {
        values.row(frame, y)[x as usize]
    });
    let mut sensor = Sensor::unknown("slow");
    (sensor.front_end.tau_0, sensor.front_end.alpha, sensor.frames.gain) =
        (Some(Duration::new(3_000_000)), Some(Duration::new(0)), Some(1e5));
    let node = offset::EstimateOffset::build(offset::Params::default()).unwrap();
    let of = |frames: &FrameSequence, sensor: Option<Sensor>| {
        let input = In { events: events.clone(), frames: frames.clone(), sensor: sensor.map(Arc::new) };
        let (out, _) = testing::with_context(frames.rows(), &["estimates"], |cx| node.run(input, cx));
        match &out.unwrap().estimates.columns()[1].1 {
            Column::Numbers(numbers) => numbers[0],
            other => panic!("no number: {other:?}"),
        }
    };
    assert!(of(&rolling, Some(sensor)).abs() < 0.5, "{}", of(&rolling, None));
    assert!((of(&rolling, None) - 3.0).abs() < 0.5);
    // As if all rows were exposed at once: half of 32 rows more.
    assert!((of(&frames, None) - 4.6).abs() < 0.6, "{}", of(&frames, None));
}

#[test]
fn a_stated_offset_is_used_and_not_estimated() {
    let (events, frames) = recording(250.0, 3_000_000, 0.0);
    let node = |ms: i64| {
        thresholds::EstimateThresholds::build(thresholds::Params {
            offset: Some(Duration::new(ms * 1_000_000)),
            ..Default::default()
        })
        .unwrap()
    };
    let (_, notes) = run(&node(-2), &events, &frames, |out| out.estimates);
    assert!(notes[0].contains("events taken -2.000 ms later"), "{notes:?}");
}

#[test]
fn a_value_that_the_scene_does_not_determine_is_nan_with_a_note() {
    let (events, frames) = recording(0.0, 0, 0.0);
    let (found, notes) =
        run(&offset::EstimateOffset::build(offset::Params::default()).unwrap(), &events, &frames, |out| {
            out.estimates
        });
    assert!(
        found["offset"].0.is_nan() && found["offset"].1.is_nan() && notes[0].contains("do not clearly agree"),
        "{found:?} {notes:?}"
    );
    let (found, notes) = run(
        &row_time::EstimateRowTime::build(row_time::Params::default()).unwrap(),
        &events,
        &frames,
        |out| out.estimates,
    );
    assert!(found["row_time"].0.is_nan() && notes[0].contains("too few bands"), "{notes:?}");
    let (found, notes) = run(
        &thresholds::EstimateThresholds::build(thresholds::Params::default()).unwrap(),
        &events,
        &frames,
        |out| out.estimates,
    );
    assert!(found["threshold_on"].0.is_nan() && notes[0].contains("too few bright pixels"), "{notes:?}");
    let (found, notes) = run(
        &exposure::EstimateExposure::build(exposure::Params::default()).unwrap(),
        &events,
        &frames,
        |out| out.estimates,
    );
    assert!(found["exposure"].0.is_nan() && notes[0].contains("thresholds are not known"), "{notes:?}");
    let given = exposure::Params { thresholds: Some([0.2, 0.2]), ..Default::default() };
    let (_, notes) =
        run(&exposure::EstimateExposure::build(given).unwrap(), &events, &frames, |out| out.estimates);
    assert!(notes[0].contains("nothing moves"), "{notes:?}");
}

#[test]
fn streams_that_do_not_fit_are_refused_while_planning() {
    let (events, frames) = recording(0.0, 0, 0.0);
    let node = offset::EstimateOffset::build(offset::Params::default()).unwrap();
    let odd = testing::captured(
        Extent { width: 50, height: 32 },
        vec![Exposure::new(0, 1), Exposure::new(9, 10)],
        0,
        |_, _, _| 1.0,
    );
    let error = node.plan(&metas(&events, &odd)).unwrap_err();
    assert!(
        error.message.contains("50 x 32") && error.message.contains("40 x 32") && error.hint.is_some(),
        "{error}"
    );
    let day = 1_600_000_000_000_000_000;
    let late = frames.meta.times.exposures.iter().map(|exposure| exposure.delayed(day)).collect();
    let apart = testing::captured(EXTENT, late, 0, |_, _, _| 1.0);
    assert!(
        node.plan(&metas(&testing::events(40, 32), &apart))
            .unwrap_err()
            .message
            .contains("no moment in common")
    );
}

fn known_times(late_ns: f64, thresholds: Option<(f64, f64)>) -> held_out::KnownTimes {
    held_out::KnownTimes { late_ns: Some(late_ns), thresholds, ..held_out::KnownTimes::default() }
}

#[test]
fn frames_that_are_held_out_choose_the_thresholds() {
    let (events, frames) = recording(250.0, 3_000_000, 0.0);
    let near = |found: &held_out::HeldOut| {
        let one = &found.threshold;
        let (low, high) = one.ci95;
        assert!(
            low <= THRESHOLD && THRESHOLD <= high && libm::log(one.value / THRESHOLD).abs() < 0.3,
            "{one:?}"
        );
    };
    // A pair that is far off is clearly worse; a blend too.
    let found = held_out::chosen(&events, &frames, &known_times(3e6, Some((0.4, 0.4)))).unwrap().unwrap();
    near(&found);
    assert!(found.given.is_some_and(|error| error > 2.0 * found.error), "{found:?}");
    assert!(!found.blend.1 && found.blend.0 > 2.0 * found.error, "{found:?}");
    // Of five frames each of the three between is held out in turn.
    let few = held_out::chosen(&events, &frames.select((0..5).collect()), &known_times(3e6, None))
        .unwrap()
        .unwrap();
    near(&few);
    assert!(few.given.is_none());
    // Three cannot be judged, and neither can what does not move.
    assert!(
        held_out::chosen(&events, &frames.select((0..3).collect()), &known_times(3e6, None))
            .unwrap()
            .is_none()
    );
    let (still, frames) = recording(0.0, 0, 0.0);
    assert!(held_out::chosen(&still, &frames, &known_times(0.0, None)).unwrap().is_none());
}

#[test]
fn events_of_another_scene_are_worse_than_a_blend() {
    let (_, frames) = recording(40.0, 0, 0.0);
    // What moves the other way, and faster.
    let (others, _) = recording(-400.0, 0, 0.0);
    let found = held_out::chosen(&others, &frames, &known_times(0.0, None)).unwrap().unwrap();
    assert!(found.blend.1 && found.blend.0 < found.error, "{found:?}");
}

/// Waves that turn around the middle of the array: light moves every way.
fn rotating_waves(x: f64, y: f64, t_ns: i64) -> f64 {
    let (sine, cosine) = libm::sincos(9.0 * t_ns as f64 * 1e-9);
    let (x, y) = (x - 19.5, y - 15.5);
    log_light(0.0, cosine * x + sine * y, cosine * y - sine * x, 0)
}

/// Places that `estimate/alignment` gives for the pixels of the array, less the pixels; its table; its note.
fn aligned(events: &EventStream, frames: &FrameSequence) -> (Vec<(f32, f32)>, Vec<f64>, String) {
    let node = alignment::EstimateAlignment::build(alignment::Params::default()).unwrap();
    let (events, frames) = (events.clone(), frames.clone());
    let input = alignment::In { events, frames, alignment: None, sensor: None };
    let (out, notes) =
        testing::with_context(EXTENT.rows(), &["alignment", "events", "frames", "estimates"], |cx| {
            node.run(input, cx)
        });
    let out = out.unwrap();
    let band = out.alignment.read(EXTENT.rows()).unwrap();
    let places = (0..EXTENT.height).flat_map(|y| (0..EXTENT.width).map(move |x| (x, y)));
    let off =
        |(x, y): (u32, u32)| (band.row(0, y)[x as usize] - x as f32, band.row(1, y)[x as usize] - y as f32);
    let Column::Numbers(values) = &out.estimates.columns()[1].1 else { panic!("no numbers") };
    (places.map(off).collect(), values.clone(), notes[0].clone())
}

#[test]
fn a_shift_of_a_fraction_of_a_pixel_is_found_and_applied() {
    let (events, frames) = recorded(rotating_waves, 2_000_000, 0.0, (1.3, -0.6));
    let (off, values, note) = aligned(&events, &frames);
    assert!((values[0] - 1.3).abs() < 0.15 && (values[1] + 0.6).abs() < 0.15, "{values:?} {note}");
    assert!(note.contains("places moved:"), "{note}");
    assert!(off.iter().all(|(x, y)| (x - 1.3).abs() < 0.5 && (y + 0.6).abs() < 0.5), "{:?}", off[0]);
}

#[test]
fn an_alignment_that_is_right_or_that_nothing_shows_stays() {
    for (events, frames) in [recorded(rotating_waves, 2_000_000, 0.0, (0.0, 0.0)), recording(0.0, 0, 0.0)] {
        let (off, values, note) = aligned(&events, &frames);
        assert!(off.iter().all(|off| *off == (0.0, 0.0)), "{values:?} {note}");
        assert!(note.contains("stays"), "{note}");
    }
}

#[test]
fn frames_that_are_held_out_choose_offset_and_exposure() {
    // Exposed for 9 ms around the middle, stated as 1 ms; events 4 ms late, which is not stated.
    let (speed, late_ns, length_ns) = (500.0, 4_000_000, 9_000_000);
    let (events, sharp) = recording(speed, late_ns, 0.0);
    let mids: Vec<i64> = sharp.meta.times.exposures.iter().map(|exposure| exposure.mid().0).collect();
    let stated = mids.iter().map(|mid| Exposure::new(mid - 500_000, mid + 500_000)).collect();
    let frames = testing::captured(EXTENT, stated, 0, |frame, x, y| {
        let at = |n: i64| mids[frame] + (2 * n - 17) * length_ns / 36;
        let light = |n: i64| libm::exp(log_light(speed, f64::from(x), f64::from(y), at(n)));
        (300.0 * (0..18).map(light).sum::<f64>() / 18.0) as f32
    });
    let given = held_out::KnownTimes { anchor: Some(0.5), ..held_out::KnownTimes::default() };
    let found = held_out::chosen(&events, &frames, &given).unwrap().unwrap();
    let late = found.late_ns.expect("clearly better");
    assert!((late.value - late_ns as f64).abs() < 2e6, "{found:?}");
    let exposure = found.exposure_ns.expect("clearly better");
    assert!((exposure.value - length_ns as f64).abs() < 4e6 && exposure.holds(exposure.value), "{found:?}");
    assert!(libm::log(found.threshold.value / THRESHOLD).abs() < 0.4, "{found:?}");
}
