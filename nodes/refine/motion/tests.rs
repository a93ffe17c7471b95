//! Claims about the node, on small recordings whose light is known.

use super::*;
use crate::refine::fixtures::{
    EXTENT, GAIN, decibels, error, error_in, every_pixel_for_itself, record, sensor, solve, texture,
};
use crate::refine::pseudo_measurement::{MeasuredPixel, SolverSensor};
use crate::solve::paper::SolvePaper;
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::{EventStream, FrameSequence, TrackBand, testing};
use photocurrent_scene::film::EventTimes;
use photocurrent_sensor::map::{Hint, MapFrame};
use photocurrent_solve::{PaperOptions, ReadoutModel};

fn refine(tracks: &TrackSet, events: &EventStream, frames: &FrameSequence, rounds: u32) -> TrackSet {
    let node = RefineMotion::build(Params { rounds, ..Params::default() }).unwrap();
    let input =
        In { tracks: tracks.clone(), events: events.clone(), frames: frames.clone(), sensor: sensor() };
    testing::with_context(EXTENT.rows(), &["tracks"], |cx| node.run(input, cx)).0.unwrap().tracks
}

#[test]
fn a_texture_that_slides_comes_out_better() {
    let (events, frames) = record(texture);
    let alone = solve(&events, &frames);
    let together = refine(&alone, &events, &frames, 3);
    let (before, after) = (error(&alone, texture), error(&together, texture));
    assert!(decibels(before, after) > 2.0, "{before} became {after}: {} dB", decibels(before, after));
}

#[test]
fn pixels_that_have_nothing_to_do_with_each_other_stay_as_they_are() {
    let (events, frames) = record(every_pixel_for_itself);
    let alone = solve(&events, &frames);
    let together = refine(&alone, &events, &frames, 3);
    let (before, after) = (error(&alone, every_pixel_for_itself), error(&together, every_pixel_for_itself));
    assert!(decibels(before, after) > -0.1, "{before} became {after}: {} dB", decibels(before, after));
}

#[test]
fn options_of_the_solver_stand_next_to_those_of_the_node() {
    let stated = serde_json::json!({ "rounds": 2, "knot_spacing": "500 us", "front_end": "ideal" });
    let params: Params = serde_json::from_value(stated).unwrap();
    assert_eq!((params.rounds, params.solver.knot_spacing.ns()), (2, 500_000));
    let again = serde_json::to_value(&params).unwrap();
    assert_eq!((&again["front_end"], &again["sigma"]), (&"ideal".into(), &true.into()));
    // With another spacing, tracks have other knots.
    let (events, frames) = record(texture);
    let first = solve(&events, &frames);
    let with = |spacing: &str| {
        let params =
            serde_json::from_value(serde_json::json!({ "rounds": 1, "knot_spacing": spacing })).unwrap();
        let input =
            In { tracks: first.clone(), events: events.clone(), frames: frames.clone(), sensor: sensor() };
        let node = RefineMotion::build(params).unwrap();
        let tracks =
            testing::with_context(EXTENT.rows(), &["tracks"], |cx| node.run(input, cx)).0.unwrap().tracks;
        tracks.read(EXTENT.rows()).unwrap().t.len()
    };
    assert!(with("500 us") < with("250 us"));
}

/// A texture whose tracks are its light, when the track of pixel (12, 8) is moved by `own`, natural-log
/// units.
fn tracks_of_light(own: f64) -> LogTracks {
    let mut band = TrackBand::begin(0, EXTENT.width);
    for p in 0..EXTENT.pixels() {
        let (x, y) = (p % 24, p / 24);
        let moved = if (x, y) == (12, 8) { own } else { 0.0 };
        band.push((0..400).map(|n| (n * 100_000, libm::exp(texture(x, y, n as f64 * 0.1) + moved) as f32)));
    }
    let fired = EventTimes::new((0..EXTENT.pixels()).map(|_| vec![20_000_000]));
    LogTracks::new(EXTENT, band, &Arc::new(fired))
}

/// Pseudo-measurements of that pixel, with its frame brighter by `brighter`.
fn hints(own: f64, brighter: f64, velocity: [f32; 2]) -> Vec<Hint> {
    let tracks = tracks_of_light(own);
    let event =
        photocurrent_sensor::map::PixelEvent { t_in_ns: 20_000_000, t_off_ns: 20_001_000, polarity: 1 };
    // The mean light of an exposure of 4 ms.
    let light: f64 =
        (0..400).map(|n| libm::exp(texture(12, 8, 18.0 + 0.01 * (n as f64 + 0.5)))).sum::<f64>() / 400.0;
    let dn = GAIN * 4e-3 * light * libm::exp(brighter);
    let frame = MapFrame { start_ns: 18_000_000, end_ns: 22_000_000, dn, sigma_dn: 0.01, saturated: false };
    let (span, flow) = ((0, 39_900_000), Flow::uniform((24, 16), velocity, velocity));
    let model = SolverSensor { model: photocurrent_sensor::model::Model::of(&sensor()), added: 0.0 };
    let measured = MeasuredPixel {
        sensor: &model,
        extent: EXTENT,
        place: (12, 8),
        events: &[event],
        frames: &[frame],
        threshold: 0.25,
    };
    let mut hints = Vec::new();
    let predict =
        |t_ns: i64| advect::neighbours(&tracks, (&flow, &MotionParams::default(), 0.5), (12, 8), span, t_ns);
    PseudoMeasurements::new(&PseudoMeasurementParams::default())
        .hints(predict, &tracks, span, 500_000, &measured, &mut hints);
    hints
}

#[test]
fn neighbours_along_the_motion_predict_a_pixel() {
    let hints = hints(0.0, 0.0, [0.7, 0.2]);
    assert!(hints.len() > 70);
    for hint in hints {
        let off = hint.log_photocurrent - texture(12, 8, hint.t_ns as f64 * 1e-6);
        // What a cubic through pixels leaves of waves seven pixels long.
        assert!(off.abs() < 0.01, "{off} at {}", hint.t_ns);
    }
}

#[test]
fn a_pixel_never_hints_itself_but_judges_its_hints() {
    let predicted =
        |hints: &[Hint]| hints.iter().map(|hint| (hint.t_ns, hint.log_photocurrent)).collect::<Vec<_>>();
    let plain = hints(0.0, 0.0, [0.7, 0.2]);
    assert_eq!(predicted(&plain), predicted(&hints(0.1, 0.0, [0.7, 0.2])));
    let moved = hints(0.0, 0.05, [0.7, 0.2]);
    assert_eq!(predicted(&plain), predicted(&moved));
    assert!(plain.iter().zip(&moved).all(|(plain, moved)| moved.variance > plain.variance));
    // Hints that miss its frame by four thresholds are none.
    assert!(hints(0.0, 1.0, [0.7, 0.2]).is_empty());
}

#[test]
fn motions_that_explain_a_place_as_well_add_an_ambiguity_variance() {
    let (tracks, span, t_ns) = (tracks_of_light(0.3), (0, 39_900_000), 20_250_000);
    let params = MotionParams::default();
    let predict = |rival: [f32; 2], ambiguity: f64| {
        let flow = Flow::uniform((24, 16), [0.7, 0.2], rival);
        advect::neighbours(&tracks, (&flow, &params, ambiguity), (12, 8), span, t_ns).unwrap()
    };
    let (own, other) = (predict([0.7, 0.2], 0.5), [-0.5, 0.3]);
    let alone = advect::neighbours(
        &tracks,
        (&Flow::uniform((24, 16), other, other), &params, 0.5),
        (12, 8),
        span,
        t_ns,
    )
    .unwrap();
    let ambiguity = |log: f64| 0.5 * (log - own.log) * (log - own.log);
    assert_eq!(own.ambiguity, 0.0);
    // It is the difference to the other prediction, and nothing else changes.
    let predicted = predict(other, 0.5);
    assert_eq!((predicted.log, predicted.innovation), (own.log, own.innovation));
    assert!(
        ambiguity(alone.log) > 1e-3 && (predicted.ambiguity - ambiguity(alone.log)).abs() < 1e-12,
        "{} and {}",
        predicted.ambiguity,
        ambiguity(alone.log)
    );
    // Without motion the prediction is the pixel's own track.
    let still = tracks.at(12, 8, t_ns).unwrap();
    assert!((predict([0.0, 0.0], 0.5).ambiguity - ambiguity(still)).abs() < 1e-12);
    assert_eq!(predict(other, 0.0).ambiguity, 0.0);
}

#[test]
fn without_motion_there_are_no_hints() {
    assert!(hints(0.0, 0.0, [0.0, 0.0]).is_empty());
    // Slower than a pixel in the longest time.
    assert!(hints(0.0, 0.0, [0.05, 0.05]).is_empty());
}

#[test]
fn threads_do_not_change_a_bit() {
    let (events, frames) = record(texture);
    let alone = solve(&events, &frames);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| refine(&alone, &events, &frames, 1).read(EXTENT.rows()).unwrap())
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn held_tracks_are_refused() {
    let (events, frames) = record(|x, _, _| 4.0 + 0.01 * x as f64);
    let node =
        SolvePaper::build(PaperOptions { readout: ReadoutModel::None, ..PaperOptions::default() }).unwrap();
    let input = crate::solve::In { events: events.clone(), frames: frames.clone(), sensor: sensor() };
    let held =
        testing::with_context(EXTENT.rows(), &["tracks", "map"], |cx| node.run(input, cx)).0.unwrap().tracks;
    let node = RefineMotion::build(Params::default()).unwrap();
    let refused = testing::with_context(EXTENT.rows(), &["tracks"], |cx| {
        node.run(In { tracks: held, events, frames, sensor: sensor() }, cx)
    })
    .0;
    let error = refused.err().unwrap();
    assert!(error.to_string().contains("log-linear"), "{error}");
    assert!(error.hint.is_some_and(|hint| hint.contains("solve/map")));
}

/// A texture that slides on the left, light that brightens and darkens slowly on the right.
fn two_halves(x: usize, y: usize, ms: f64) -> f64 {
    if x < 12 { texture(x, y, ms) } else { slow_scene(x, y, ms) }
}

fn slow_scene(x: usize, y: usize, ms: f64) -> f64 {
    4.6 + 0.2 * libm::sin(0.08 * ms + 0.3 * x as f64) + 0.1 * libm::cos(0.5 * y as f64)
}

/// The same events, those of the right half turned into their opposite and three of each.
fn spoil_right_half(events: &EventStream) -> EventStream {
    let band = events.read(EXTENT.rows()).unwrap();
    let mut all = Vec::new();
    for y in 0..EXTENT.height {
        let row = band.row(y);
        for k in 0..row.t.len() {
            let is_right = row.x[k] >= 12;
            let on = (row.on[k] == 1) != is_right;
            all.extend((0..if is_right { 3 } else { 1 }).map(|n| Event {
                x: row.x[k],
                y: y as u16,
                polarity: Polarity::from_bit(u8::from(on)),
                t: row.t[k] + n * 400_000,
                t_in: None,
            }));
        }
    }
    testing::stream(EXTENT, all)
}

fn refine_or_fall_back(
    events: &EventStream,
    frames: &FrameSequence,
    fall_back: bool,
) -> (TrackSet, Vec<String>) {
    let node = RefineMotion::build(Params { fall_back, ..Params::default() }).unwrap();
    let tracks = solve(events, frames);
    let input = In { tracks, events: events.clone(), frames: frames.clone(), sensor: sensor() };
    let (out, notes) = testing::with_context(EXTENT.rows(), &["tracks"], |cx| node.run(input, cx));
    (out.unwrap().tracks, notes)
}

#[test]
fn where_events_mislead_light_is_a_blend_of_frames_and_a_note_states_it() {
    let (events, frames) = record(two_halves);
    let events = spoil_right_half(&events);
    let (without, _) = refine_or_fall_back(&events, &frames, false);
    let (with, notes) = refine_or_fall_back(&events, &frames, true);
    let (before, after) = (error_in(12..24, &without, slow_scene), error_in(12..24, &with, slow_scene));
    assert!(decibels(before, after) > 3.0, "{before} became {after}");
    let (before, after) = (error_in(0..10, &without, texture), error_in(0..10, &with, texture));
    assert!(decibels(before, after) > -0.1, "{before} became {after} where events are right");
    assert!(notes.iter().any(|note| note.contains("is a blend of the frames before and after")), "{notes:?}");
}

#[test]
fn where_events_are_right_nothing_falls_back() {
    for light in [texture as fn(usize, usize, f64) -> f64, every_pixel_for_itself, slow_scene] {
        let (events, frames) = record(light);
        let (without, _) = refine_or_fall_back(&events, &frames, false);
        let (with, notes) = refine_or_fall_back(&events, &frames, true);
        let (one, other) = (without.read(EXTENT.rows()).unwrap(), with.read(EXTENT.rows()).unwrap());
        assert_eq!((one.t, one.photocurrent), (other.t, other.photocurrent), "{notes:?}");
    }
}
