//! Claims about frames with colours or more pixels than the events: what must come out as of grey frames, by
//! algebra.

use super::paper::SolvePaper;
use super::tests::{Way, exposures, paper, sensor, walk};
use super::*;
use crate::baseline::edi::{self, BaselineEdi};
use crate::render::rows::{self, RenderRows};
use crate::sampling::Sampling;
use photocurrent_core::handle::Band;
use photocurrent_core::quantity::Rate;
use photocurrent_core::random::Random;
use photocurrent_core::{Colour, Extent, FramesMeta, Grain, Meta, Node, PortMetas, Rows, testing};
use photocurrent_solve::co_located::values_of;
use photocurrent_solve::{FrontEndModel, PaperOptions, Precision, SolveOptions};

const EVENTS: Extent = Extent { width: 3, height: 2 };

fn solve(way: Way, events: &EventStream, frames: &FrameSequence, sensor: Arc<Sensor>) -> Out {
    let input = In { events: events.clone(), frames: frames.clone(), sensor };
    testing::with_context(frames.rows(), &["tracks", "map"], |cx| way.run(input, cx)).0.unwrap()
}

/// Frames at `ratio` times the events' extent whose value `v` of row `y` is `of(frame, x, y, v)`.
fn frames(ratio: u32, colour: Colour, count: i64, of: impl Fn(usize, u32, u32, u32) -> f32) -> FrameSequence {
    let extent = Extent { width: ratio * EVENTS.width, height: ratio * EVENTS.height };
    let wide = testing::captured(values_of(extent, colour), exposures(count), 0, |l, v, y| {
        of(l, v / colour.channels(), y, v)
    });
    let meta = FramesMeta { extent, colour, ..(*wide.meta).clone() };
    FrameSequence::in_memory(Arc::new(meta), wide.read_rows(wide.rows()).unwrap())
}

/// The value of event pixel (x, y) in a grey frame.
fn grey(l: usize, x: u32, y: u32) -> f32 {
    (100.0 + 300.0 * Random::new(5, &[l as u64, x.into(), y.into()]).uniform()) as f32
}

/// Two methods; in double precision, so that rounding does not hide a mistake. These events and frames
/// contradict each other, and with a front end that is slow in the dark a second start may then go another
/// way after rounding: the MAP estimate is asked with an ideal one.
fn methods() -> [Way; 2] {
    [
        Way::Paper(double()),
        Way::Map(SolveOptions { front_end: FrontEndModel::Ideal, ..SolveOptions::default() }),
    ]
}

fn double() -> PaperOptions {
    PaperOptions { precision: Precision::Double, ..PaperOptions::default() }
}

/// The track of value `v` of row `y`, as (t, photocurrent).
fn track(out: &Out, v: u32, y: u32) -> Vec<(i64, f32)> {
    let band = out.tracks.read(out.tracks.rows()).unwrap();
    let track = band.pixel(v, y);
    track.t.iter().copied().zip(track.photocurrent.iter().copied()).collect()
}

fn assert_alike(found: &[(i64, f32)], expected: &[(i64, f32)], factor: f64, tolerance: f64) {
    assert!(
        found.len() == expected.len() && found.len() > 2,
        "{} knots, expected {}",
        found.len(),
        expected.len()
    );
    for ((t, i), (expected_t, expected_i)) in found.iter().zip(expected) {
        assert_eq!(t, expected_t);
        let apart = f64::from(*i) / (factor * f64::from(*expected_i)) - 1.0;
        assert!(apart.abs() < tolerance, "{i} at {t}, expected {factor} x {expected_i}");
    }
}

#[test]
fn a_mosaic_of_the_events_pixels_is_solved_as_grey_frames_are() {
    let events = walk(EVENTS, 30_000_000);
    for way in methods() {
        let mono = solve(way, &events, &frames(1, Colour::Mono, 4, |l, x, y, _| grey(l, x, y)), sensor());
        for name in ["bayer_rggb", "quad_bayer_gbrg"] {
            let colour = Colour::named(name).unwrap();
            let mosaic = solve(way, &events, &frames(1, colour, 4, |l, x, y, _| grey(l, x, y)), sensor());
            assert_eq!(mosaic.tracks.meta.colour, colour);
            let band = |out: &Out| out.tracks.read(out.tracks.rows()).unwrap();
            assert_eq!(band(&mosaic), band(&mono));
        }
    }
}

/// A tenth of a per mille: the light ratio is a quotient of sums that rounding leaves a little off 1, and
/// Newton's steps stop where they please.
const ROUNDING: f64 = 1e-4;

#[test]
fn grey_light_in_three_channels_or_in_many_pixels_is_the_grey_answer() {
    let events = walk(EVENTS, 30_000_000);
    for way in methods() {
        let mono = solve(way, &events, &frames(1, Colour::Mono, 4, |l, x, y, _| grey(l, x, y)), sensor());
        for (ratio, name) in [(1, "rgb"), (2, "mono"), (2, "bayer_grbg"), (2, "rgb"), (4, "quad_bayer_rggb")]
        {
            let colour = Colour::named(name).unwrap();
            let many = solve(
                way,
                &events,
                &frames(ratio, colour, 4, |l, x, y, _| grey(l, x / ratio, y / ratio)),
                sensor(),
            );
            let copies = ratio * colour.channels();
            assert_eq!(many.tracks.meta.extent.width, EVENTS.width * ratio);
            assert_eq!(many.map.meta.extent, many.tracks.meta.extent);
            for (v, y) in
                [(0, 0), (copies - 1, ratio - 1), (2 * copies, ratio), (3 * copies - 1, 2 * ratio - 1)]
            {
                assert_alike(&track(&many, v, y), &track(&mono, v / copies, y / ratio), 1.0, ROUNDING);
            }
        }
    }
}

/// One frame leaves no misfit: every value's light is then its factor times the event pixel's, also through
/// the front end, whose delay depends on the event pixel's light alone. Were the delay taken from the value's
/// own light, a factor of 0.2 would make it five times as long.
#[test]
fn a_value_sees_its_share_of_the_event_pixels_light() {
    let events = walk(EVENTS, 6_000_000);
    let factors = [0.2, 1.7, 0.9, 1.2];
    for front_end in [FrontEndModel::LowPass, FrontEndModel::Ideal] {
        let way = Way::Paper(PaperOptions { front_end, ..double() });
        let mono = solve(way, &events, &frames(1, Colour::Mono, 1, |l, x, y, _| grey(l, x, y)), sensor());
        let share = |x: u32, y: u32| factors[(2 * (y % 2) + x % 2) as usize];
        // The factors' mean is 1, so the block's mean is the grey value.
        let bayer = Colour::named("bayer_rggb").unwrap();
        let many = solve(
            way,
            &events,
            &frames(2, bayer, 1, |l, x, y, _| (share(x, y) * f64::from(grey(l, x / 2, y / 2))) as f32),
            sensor(),
        );
        for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1), (4, 2), (5, 3)] {
            assert_alike(&track(&many, x, y), &track(&mono, x / 2, y / 2), share(x, y), ROUNDING);
        }
    }
}

#[test]
fn a_channels_gain_is_removed_and_rendered_again() {
    let events = walk(EVENTS, 30_000_000);
    let gains = [2.0, 1.0, 0.5];
    let mut coloured = (*sensor()).clone();
    coloured.frames.channel_gain = Some(gains);
    coloured.frames.saturation_dn = None;
    let coloured = Arc::new(coloured);
    let shown =
        |l: usize, x: u32, y: u32, v: u32| (f64::from(grey(l, x, y)) * gains[(v % 3) as usize]) as f32;
    for way in methods() {
        let captured = frames(1, Colour::Rgb, 1, shown);
        let mono = solve(way, &events, &frames(1, Colour::Mono, 1, |l, x, y, _| grey(l, x, y)), sensor());
        let out = solve(way, &events, &captured, coloured.clone());
        // What is trusted of a frame depends on its DN, so the MAP estimate may differ a little with gain.
        let tolerance = if way.is_map() { 0.02 } else { ROUNDING };
        for v in 0..9 {
            assert_alike(&track(&out, v, 1), &track(&mono, v / 3, 1), 1.0, tolerance);
        }
        let node = RenderRows::build(rows::Params::default()).unwrap();
        let input = rows::In { tracks: out.tracks, sensor: coloured.clone(), at: Some(captured.clone()) };
        let again =
            testing::with_context(captured.rows(), &["frames"], |cx| node.run(input, cx)).0.unwrap().frames;
        assert_eq!(again.meta, captured.meta);
        let (again, captured) =
            (again.read_rows(again.rows()).unwrap().dn, captured.read_rows(captured.rows()).unwrap().dn);
        // the MAP estimate follows a frame to twice the noise that is assumed of it, 2 %.
        let followed = if way.is_map() { 0.04 } else { 0.02 };
        assert!(
            again.iter().zip(&captured).all(|(again, dn)| (again / dn - 1.0).abs() < followed),
            "{again:?}\n{captured:?}"
        );
    }
}

#[test]
fn rows_of_one_block_are_solved_alike_whatever_the_band() {
    let events = walk(EVENTS, 30_000_000);
    let quad = Colour::named("quad_bayer_bggr").unwrap();
    let frames = frames(2, quad, 3, |l, x, y, _| grey(l, x, y));
    let whole = solve(paper(), &events, &frames, sensor()).tracks.read(frames.rows()).unwrap();
    let metas = [
        ("events".to_string(), vec![Meta::Events(events.meta.clone())]),
        ("frames".to_string(), vec![Meta::Frames(frames.meta.clone())]),
    ];
    let node = SolvePaper::build(PaperOptions::default()).unwrap();
    assert_eq!(node.grain(&PortMetas::new(metas.into())), Grain::Row { halo: 1 });
    for band in frames.rows().bands(1) {
        // As the engine cuts them: events whole, frames with their halo.
        let reach = band.with_halo(1, frames.rows());
        let input = In { events: events.clone(), frames: frames.cut(reach), sensor: sensor() };
        let part = testing::with_context(band, &["tracks"], |cx| node.run(input, cx))
            .0
            .unwrap()
            .tracks
            .read(band)
            .unwrap();
        assert_eq!(part, whole.slice(band));
    }
}

#[test]
fn the_double_integral_of_a_value_takes_the_events_of_its_event_pixel() {
    let events = walk(EVENTS, 30_000_000);
    let params = edi::Params {
        sampling: Sampling { rate: Rate::new(500.0), ..Sampling::default() },
        ..edi::Params::default()
    };
    let run = |frames: FrameSequence| {
        let input = edi::In {
            events: events.clone(),
            frames: frames.clone(),
            sensor: Some(sensor()),
            contrast: None,
            at: None,
        };
        let out = testing::with_context(frames.rows(), &["frames"], |cx| {
            BaselineEdi::build(params.clone()).unwrap().run(input, cx)
        })
        .0
        .unwrap()
        .frames;
        assert_eq!((out.meta.extent, out.meta.colour), (frames.meta.extent, frames.meta.colour));
        out.read_rows(out.rows()).unwrap()
    };
    let value = |l: usize, x: u32, y: u32, v: u32| grey(l, x, y) + v as f32;
    let many = run(frames(2, Colour::Rgb, 3, value));
    for (v, y) in [(0, 0), (7, 1), (17, 3)] {
        // A grey frame of this value alone, at its event pixel.
        let one = run(frames(1, Colour::Mono, 3, |l, _, _, _| value(l, v / 3, y, v)));
        for l in many.frames.clone() {
            assert_eq!(many.row(l, y)[v as usize], one.row(l, y / 2)[v as usize / 6]);
        }
    }
}

#[test]
fn frames_of_no_whole_multiple_are_refused() {
    let metas = |frames: FrameSequence| {
        let events = walk(EVENTS, 1_000_000);
        let sensor = Meta::Sensor(sensor());
        let of = |name: &str, meta: Meta| (name.to_string(), vec![meta]);
        PortMetas::new(
            [
                of("events", Meta::Events(events.meta)),
                of("frames", Meta::Frames(frames.meta)),
                of("sensor", sensor),
            ]
            .into(),
        )
    };
    let error = SolvePaper::build(PaperOptions::default())
        .unwrap()
        .plan(&metas(testing::frames(6, 5, 2)))
        .unwrap_err();
    assert_eq!(error.message, "events are 3 x 2, frames are 6 x 5");
    assert!(error.hint.unwrap().contains("a whole multiple"));
    let rows = Rows { start: 0, end: 4 };
    assert_eq!(
        SolvePaper::build(PaperOptions::default()).unwrap().plan(&metas(testing::frames(6, 4, 2))).unwrap()
            [0]
        .rows(),
        Some(rows)
    );
}
