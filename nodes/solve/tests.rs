//! Claims about the node, on small streams.

use super::map::SolveMap;
use super::paper::SolvePaper;
use super::*;
use crate::baseline::edi::{self, BaselineEdi};
use crate::render::rows::{self, RenderRows};
use crate::sampling::Sampling;
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::handle::Band;
use photocurrent_core::quantity::{Duration, Rate};
use photocurrent_core::random::Random;
use photocurrent_core::{Between, EventsMeta, Exposure, Extent, FramesMeta, Node, NodeError, Rows, testing};
use photocurrent_solve::{FrontEndModel, Model, PLANES, PaperOptions, Precision, ReadoutModel, SolveOptions};

pub(super) fn sensor() -> Arc<Sensor> {
    let mut sensor = Sensor::unknown("test");
    sensor.front_end.tau_0 = Some(Duration::new(20_000));
    sensor.front_end.alpha = Some(Duration::new(2_000_000));
    sensor.comparator.threshold_on = Some(0.2);
    sensor.comparator.threshold_off = Some(0.25);
    sensor.readout.refractory = Some(Duration::new(60_000));
    sensor.frames.gain = Some(1000.0);
    sensor.frames.saturation_dn = Some(1023.0);
    Arc::new(sensor)
}

/// One of the kinds.
#[derive(Clone, Copy)]
pub(super) enum Way {
    Map(SolveOptions),
    Paper(PaperOptions),
}

impl Way {
    pub(super) fn run(self, input: In, cx: &Context) -> Result<Out, NodeError> {
        match self {
            Way::Map(options) => SolveMap::build(options.into())?.run(input, cx),
            Way::Paper(options) => SolvePaper::build(options)?.run(input, cx),
        }
    }

    pub(super) fn is_map(self) -> bool {
        matches!(self, Way::Map(_))
    }
}

fn solve(way: Way, events: EventStream, frames: FrameSequence, rows: Rows) -> (Out, Vec<String>) {
    let (out, notes) = testing::with_context(rows, &["tracks", "map"], |cx| {
        way.run(In { events, frames, sensor: sensor() }, cx)
    });
    (out.unwrap(), notes)
}

/// The paper's cost, everything else as it is by default.
pub(super) fn paper() -> Way {
    Way::Paper(PaperOptions::default())
}

fn ideal() -> PaperOptions {
    PaperOptions { front_end: FrontEndModel::Ideal, readout: ReadoutModel::None, ..PaperOptions::default() }
}

/// Where `implausible` stands among the planes.
const IMPLAUSIBLE: usize = PLANES.len() - 1;

const EXTENT: Extent = Extent { width: 5, height: 4 };

/// A walk of ON and OFF around zero net change, so that no pixel runs away.
pub(super) fn walk(extent: Extent, until_ns: i64) -> EventStream {
    let mut events = Vec::new();
    for y in 0..extent.height {
        for x in 0..extent.width {
            let mut random = Random::new(11, &[x.into(), y.into()]);
            let mut t = 0;
            loop {
                t += 200_000 + (random.uniform() * 1.5e6) as i64;
                if t + 20_000 >= until_ns {
                    break;
                }
                events.push(Event {
                    x: x as u16,
                    y: y as u16,
                    polarity: Polarity::from_bit((random.bits() & 1) as u8),
                    t: t + 20_000,
                    t_in: Some(t),
                });
            }
        }
    }
    testing::stream(extent, events)
}

pub(super) fn exposures(count: i64) -> Vec<Exposure> {
    (0..count).map(|l| Exposure::new(l * 8_000_000, l * 8_000_000 + 6_000_000)).collect()
}

fn frames(count: i64) -> FrameSequence {
    let mut random = Random::new(5, &[]);
    testing::captured(EXTENT, exposures(count), 30_000, |_, _, _| (100.0 + 300.0 * random.uniform()) as f32)
}

#[test]
fn with_an_ideal_sensor_and_one_frame_it_is_the_double_integral() {
    let (events, frames) = (walk(EXTENT, 6_000_000), frames(1));
    let sampling = Sampling { rate: Rate::new(5000.0), ..Sampling::default() };
    let (solved, _) = solve(Way::Paper(ideal()), events.clone(), frames.clone(), EXTENT.rows());
    let render =
        RenderRows::build(rows::Params { sampling: sampling.clone(), ..rows::Params::default() }).unwrap();
    let ours = testing::with_context(EXTENT.rows(), &["frames"], |cx| {
        render.run(rows::In { tracks: solved.tracks, sensor: sensor(), at: None }, cx)
    })
    .0
    .unwrap()
    .frames;
    let double_integral = BaselineEdi::build(edi::Params { sampling, ..edi::Params::default() }).unwrap();
    let input = edi::In { events, frames, sensor: Some(sensor()), contrast: None, at: None };
    let theirs = testing::with_context(EXTENT.rows(), &["frames"], |cx| double_integral.run(input, cx))
        .0
        .unwrap()
        .frames;
    assert_eq!(ours.meta, theirs.meta);
    let (ours, theirs) = (ours.read_rows(EXTENT.rows()).unwrap(), theirs.read_rows(EXTENT.rows()).unwrap());
    // Tracks are f32: a few rounding errors of 6e-8 each.
    assert!(ours.dn.iter().zip(&theirs.dn).all(|(a, b)| (a / b - 1.0).abs() < 1e-6));
    assert!(
        ours.dn.iter().any(|dn| (dn / ours.dn[0] - 1.0).abs() > 0.2),
        "the picture must change for the test to mean something"
    );
}

#[test]
fn rows_are_solved_alike_whatever_the_band() {
    let (events, frames) = (walk(EXTENT, 30_000_000), frames(4));
    let whole =
        solve(paper(), events.clone(), frames.clone(), EXTENT.rows()).0.tracks.read(EXTENT.rows()).unwrap();
    for band in EXTENT.rows().bands(3) {
        let part = solve(paper(), events.clone(), frames.clone(), band).0.tracks.read(band).unwrap();
        assert_eq!(part, whole.slice(band));
    }
}

fn most_probable() -> Way {
    Way::Map(SolveOptions::default())
}

#[test]
fn rows_have_the_same_map_estimate_whatever_the_band() {
    let (events, frames) = (walk(EXTENT, 30_000_000), frames(4));
    let (whole, _) = solve(most_probable(), events.clone(), frames.clone(), EXTENT.rows());
    assert_eq!(whole.tracks.meta.between, Between::LogLinear);
    let whole = whole.tracks.read(EXTENT.rows()).unwrap();
    for band in EXTENT.rows().bands(3) {
        let part = solve(most_probable(), events.clone(), frames.clone(), band).0.tracks.read(band).unwrap();
        assert_eq!(part, whole.slice(band));
    }
}

#[test]
fn bands_of_a_task_share_what_suits_their_block_and_a_row_its_pixels() {
    use photocurrent_core::context::{Common, Notes, Silent};
    // Wider than what one thread takes of a row, and higher than a block.
    let extent = Extent { width: 290, height: 18 };
    let events = walk(extent, 15_000_000);
    let mut random = Random::new(6, &[]);
    // Some pixels have no frame, first and last ones of what is shared out among them.
    let frames = testing::captured(extent, exposures(2), 30_000, |_, x, _| {
        if [0, 127, 128, 200, 289].contains(&x) {
            f32::NAN
        } else {
            (100.0 + 300.0 * random.uniform()) as f32
        }
    });
    let whole = solve(most_probable(), events.clone(), frames.clone(), extent.rows()).0;
    let (tracks, map) = (whole.tracks.read(extent.rows()).unwrap(), whole.map.read(extent.rows()).unwrap());
    let (node, common) = (most_probable(), Common::default());
    let (wanted, cancel, notes) = (["tracks".into(), "map".into()].into(), false.into(), Notes::default());
    let band = |rows: Rows, around: u32| {
        let at_hand = rows.with_halo(around, extent.rows());
        let input = In { events: events.cut(at_hand), frames: frames.cut(at_hand), sensor: sensor() };
        node.run(input, &Context::new(rows, 7, &wanted, &Silent, &cancel, None, &notes).sharing(&common))
    };
    let row = |start: u32| Rows { start, end: start + 1 };
    // The first band of a block looks at all of it; those after it need their neighbours only.
    assert!(band(row(3), 1).is_err());
    for (rows, around) in [(row(2), 16), (row(3), 1), (row(15), 1), (row(16), 16), (row(17), 1)] {
        let out = band(rows, around).unwrap();
        assert_eq!(out.tracks.read(rows).unwrap(), tracks.slice(rows), "{rows}");
        assert_eq!(format!("{:?}", out.map.read(rows).unwrap()), format!("{:?}", map.slice(rows)), "{rows}");
    }
}

#[test]
fn the_map_estimate_reads_like_the_frames_and_moves_like_the_events() {
    // Every pixel brightens by e^0.8 = 2.2255 around 7 ms, between two exposures, in four ON events of 0.2
    // that come 300 us apart.
    let mut events = Vec::new();
    for y in 0..EXTENT.height {
        for x in 0..EXTENT.width {
            events.extend((0..4).map(|k| 6_600_000 + k * 300_000).map(|t| Event {
                x: x as u16,
                y: y as u16,
                polarity: Polarity::On,
                t: t + 2_000,
                t_in: Some(t),
            }));
        }
    }
    let frames = testing::captured(EXTENT, exposures(2), 0, |l, _, _| if l == 0 { 600.0 } else { 1335.3 });
    let mut bright = (*sensor()).clone();
    (bright.front_end.alpha, bright.frames.saturation_dn) = (Some(Duration::new(0)), None);
    let node = most_probable();
    let input =
        In { events: testing::stream(EXTENT, events), frames: frames.clone(), sensor: Arc::new(bright) };
    let (solved, notes) = testing::with_context(EXTENT.rows(), &["tracks", "map"], |cx| node.run(input, cx));
    assert!(notes.is_empty(), "{notes:?}");
    let tracks = solved.unwrap().tracks;
    let render = RenderRows::build(rows::Params::default()).unwrap();
    let input = rows::In { tracks: tracks.clone(), sensor: sensor(), at: Some(frames) };
    let again = testing::with_context(EXTENT.rows(), &["frames"], |cx| render.run(input, cx))
        .0
        .unwrap()
        .frames
        .read_rows(EXTENT.rows())
        .unwrap();
    let band = tracks.read(EXTENT.rows()).unwrap();
    for y in EXTENT.rows().iter() {
        for x in 0..EXTENT.width {
            // Frames count to two percent, and the events agree with them.
            let (first, second) = (again.row(0, y)[x as usize], again.row(1, y)[x as usize]);
            assert!((first - 600.0).abs() < 12.0 && (second - 1335.3).abs() < 27.0, "{first} and {second}");
            let track = band.pixel(x, y);
            let at = |t: i64| track.photocurrent[track.t.partition_point(|&knot| knot <= t) - 1];
            // 600 DN = 1000 x 6 ms x 100; it has not moved at 6 ms and has arrived at 8 ms.
            assert!(
                (at(5_900_000) / 100.0 - 1.0).abs() < 0.05 && (at(8_100_000) / 222.55 - 1.0).abs() < 0.05,
                "{track:?}"
            );
        }
    }
}

#[test]
fn compensated_steps_are_refused_where_the_readout_is_undone_anyway() {
    let events = EventsMeta { has_step: true, ..(*walk(EXTENT, 1_000_000).meta).clone() };
    let error = Model::of_map(&SolveOptions::default(), &sensor(), &events).err().unwrap();
    assert!(error.message.contains("compensated steps"), "{}", error.message);
}

#[test]
fn solved_tracks_reproduce_the_frames_they_came_from() {
    let frames =
        testing::captured(EXTENT, exposures(2), 30_000, |_, x, y| 100.0 + 40.0 * x as f32 + 10.0 * y as f32);
    let (solved, notes) = solve(paper(), walk(EXTENT, 14_000_000), frames.clone(), EXTENT.rows());
    let render = RenderRows::build(rows::Params::default()).unwrap();
    let input = rows::In { tracks: solved.tracks.clone(), sensor: sensor(), at: Some(frames.clone()) };
    let again = testing::with_context(EXTENT.rows(), &["frames"], |cx| render.run(input, cx))
        .0
        .unwrap()
        .frames
        .read_rows(EXTENT.rows())
        .unwrap();
    let original = frames.read_rows(EXTENT.rows()).unwrap();
    let map = solved.map.read(EXTENT.rows()).unwrap();
    let mut converged = 0;
    for y in EXTENT.rows().iter() {
        for x in (0..5).filter(|x| map.row(0, y)[*x] == 0.0) {
            // A squared DN weighs as much as a squared log unit, so frames are met to a small part of one DN.
            assert!((0..2).all(|l| (again.row(l, y)[x] - original.row(l, y)[x]).abs() < 0.5), "({x}, {y})");
            converged += 1;
        }
    }
    assert!(converged >= 15, "{notes:?}");
}

#[test]
fn dead_saturated_and_unknown_pixels_have_stated_outcomes() {
    let dn = |_: usize, x: u32, _: u32| [0.0, 1023.0, f32::NAN, 200.0, 200.0][x as usize];
    let frames = testing::captured(EXTENT, exposures(2), 0, dn);
    let (solved, notes) = solve(paper(), walk(EXTENT, 14_000_000), frames.clone(), EXTENT.rows());
    let tracks = solved.tracks.read(EXTENT.rows()).unwrap();
    assert!(tracks.pixel(0, 0).photocurrent.iter().all(|i| *i < 1e-10));
    assert!(tracks.pixel(1, 0).photocurrent.iter().all(|i| i.is_finite() && *i > 0.0));
    assert!(tracks.pixel(2, 0).t.is_empty());
    let map = solved.map.read(EXTENT.rows()).unwrap();
    assert_eq!(&map.row(0, 0)[..4], [1.0, 2.0, 3.0, 0.0]);
    let probable = solve(most_probable(), walk(EXTENT, 14_000_000), frames, EXTENT.rows()).0;
    let tracks = probable.tracks.read(EXTENT.rows()).unwrap();
    assert!(tracks.photocurrent.iter().all(|i| i.is_finite() && *i > 0.0));
    assert!(tracks.pixel(2, 0).t.is_empty());
    assert_eq!(&probable.map.read(EXTENT.rows()).unwrap().row(0, 0)[1..3], [2.0, 3.0]);
    assert_eq!(notes.len(), 3, "{notes:?}");
}

#[test]
fn residuals_of_events_and_frames_are_mapped_apart() {
    let step = |x: u16, y: u16, k: i64| Event {
        x,
        y,
        polarity: Polarity::from_bit((k % 2) as u8),
        t: k * 1_300_000 + 20_000,
        t_in: Some(k * 1_300_000),
    };
    let events: Vec<Event> =
        (0..4).flat_map(|y| (1..5).flat_map(move |x| (1..10).map(move |k| step(x, y, k)))).collect();
    let frames = testing::captured(EXTENT, exposures(2), 0, |_, x, _| if x == 4 { f32::NAN } else { 200.0 });
    for way in [
        paper(),
        Way::Paper(PaperOptions { precision: Precision::Double, ..PaperOptions::default() }),
        most_probable(),
    ] {
        let (solved, _) = solve(way, testing::stream(EXTENT, events.clone()), frames.clone(), EXTENT.rows());
        let map = solved.map.read(EXTENT.rows()).unwrap();
        assert_eq!(solved.map.meta.planes[3..5], ["event_residual", "frame_residual"]);
        for y in EXTENT.rows().iter() {
            let (event, frame) = (map.row(3, y), map.row(4, y));
            assert!(event[0].is_nan() && (1..4).all(|x| event[x] >= 0.0), "{event:?}");
            assert!(frame[4].is_nan() && (0..4).all(|x| frame[x] >= 0.0), "{frame:?}");
        }
    }
}

#[test]
fn weights_four_times_as_large_double_the_residuals() {
    // Both weights together move no minimum.
    let residuals = |weight: f64| {
        let way = Way::Paper(PaperOptions {
            precision: Precision::Double,
            cis_weight: weight,
            evs_weight: weight,
            ..PaperOptions::default()
        });
        let map =
            solve(way, walk(EXTENT, 14_000_000), frames(3), EXTENT.rows()).0.map.read(EXTENT.rows()).unwrap();
        EXTENT
            .rows()
            .iter()
            .flat_map(|y| [map.row(3, y).to_vec(), map.row(4, y).to_vec()])
            .flatten()
            .collect::<Vec<f32>>()
    };
    let (once, four) = (residuals(1.0), residuals(4.0));
    assert!(once.iter().filter(|rms| **rms > 1e-3).count() > 10, "{once:?}");
    assert!(
        once.iter().zip(&four).all(|(once, four)| (four - 2.0 * once).abs() <= 1e-3 * (1e-2 + four)),
        "{once:?} {four:?}"
    );
}

#[test]
fn a_recording_without_events_holds_the_light_of_each_pair() {
    let (solved, _) = solve(paper(), testing::stream(EXTENT, vec![]), frames(3), EXTENT.rows());
    let tracks = solved.tracks.read(EXTENT.rows()).unwrap();
    assert_eq!(tracks.pixel(1, 1).t, [0, 8_030_000]);
}

#[test]
fn no_frame_at_all_is_refused_with_the_reason() {
    let none = FramesMeta {
        times: photocurrent_core::FrameTimes::new(vec![], 0).unwrap(),
        ..(*frames(1).meta).clone()
    };
    let error = PaperOptions::default().tracks_meta(&walk(EXTENT, 1_000_000).meta, &none).unwrap_err();
    assert_eq!(error.message, "there is no frame, and events alone leave the photocurrent's level open");
}

#[test]
fn light_that_no_frame_comes_near_is_held_and_marked() {
    // 25 ON events of 0.2 and 20 OFF events of 0.25 between two frames of 100 DN: up by e^5 = 148 and back.
    // Row 1 rises by e^2.4 only, which is plausible.
    let burst = |y: u16, on: i64, off: i64| {
        let times = (0..on).map(move |k| (Polarity::On, 5_000_000 + k * 500_000));
        let times = times.chain((0..off).map(move |k| (Polarity::Off, 20_000_000 + k * 500_000)));
        times.map(move |(polarity, t)| Event { x: 2, y, polarity, t: t + 20_000, t_in: Some(t) })
    };
    let exposures = vec![Exposure::new(0, 1_000_000), Exposure::new(40_000_000, 41_000_000)];
    let frames = testing::captured(EXTENT, exposures, 0, |_, _, _| 100.0);
    let events: Vec<Event> = burst(0, 25, 20).chain(burst(1, 12, 10)).chain(burst(2, 25, 20)).collect();
    // 100 DN in 1 ms, at 1000 DN per photocurrent and second.
    let (brightest, most) = (100.0, 100.0 * libm::exp(3.0));
    let map = SolveOptions { front_end: FrontEndModel::Ideal, ..SolveOptions::default() };
    let paper = PaperOptions { evs_weight: 1e6, ..ideal() };
    let ways = [
        (Way::Paper(paper), Way::Paper(PaperOptions { plausible_range: 6.0, ..paper })),
        (Way::Map(map), Way::Map(SolveOptions { plausible_range: 6.0, ..map })),
    ];
    for (way, wider) in ways {
        let (solved, notes) =
            solve(way, testing::stream(EXTENT, events.clone()), frames.clone(), EXTENT.rows());
        let (tracks, map) =
            (solved.tracks.read(EXTENT.rows()).unwrap(), solved.map.read(EXTENT.rows()).unwrap());
        let top =
            |y: u32| tracks.pixel(2, y).photocurrent.iter().fold(0.0, |most, i| f64::max(most, (*i).into()));
        assert_eq!(solved.map.meta.planes[IMPLAUSIBLE], "implausible");
        for y in [0, 2] {
            assert!((top(y) / most - 1.0).abs() < 1e-6, "{} is held at {most}", top(y));
            assert!((map.row(IMPLAUSIBLE, y)[2] - 5.0).abs() < 0.1, "{:?}", map.row(IMPLAUSIBLE, y));
        }
        assert!((libm::log(top(1) / brightest) - 2.4).abs() < 0.2, "{}", top(1));
        let marked = map
            .rows()
            .iter()
            .flat_map(|row| map.row(IMPLAUSIBLE, row))
            .filter(|excess| **excess != 0.0)
            .count();
        assert_eq!(marked, 2);
        let note = notes
            .iter()
            .find(|note| note.contains("`plausible_range` = 3"))
            .unwrap_or_else(|| panic!("{notes:?}"));
        assert!(
            note.starts_with("2 pixels get brighter than their brightest frame by more than a factor of 20 "),
            "{note}"
        );
        // With a wider range they are left alone.
        let (solved, notes) =
            solve(wider, testing::stream(EXTENT, events.clone()), frames.clone(), EXTENT.rows());
        let top = solved
            .tracks
            .read(EXTENT.rows())
            .unwrap()
            .pixel(2, 0)
            .photocurrent
            .iter()
            .fold(0.0, |most, i| f64::max(most, (*i).into()));
        assert!(
            (libm::log(top / brightest) - 5.0).abs() < 0.1
                && !notes.iter().any(|note| note.contains("plausible")),
            "{top} {notes:?}"
        );
    }
}
