//! Claims about the node, on tracks whose light is known.

use super::*;
use crate::refine::fixtures::{END_NS, EXTENT, decibels, error, record, sensor, texture};
use crate::solve::paper::SolvePaper;
use photocurrent_core::random::Random;
use photocurrent_core::{TimeSpan, testing};
use photocurrent_solve::PaperOptions;
use std::sync::Arc;

fn steer_rows(tracks: &TrackSet, rows: Rows) -> TrackBand {
    let node = RefineSteered::build(Params::default()).unwrap();
    testing::with_context(rows, &["tracks"], |cx| node.run(In { tracks: tracks.clone() }, cx))
        .0
        .unwrap()
        .tracks
        .read(rows)
        .unwrap()
}

fn steer(tracks: &TrackSet) -> TrackSet {
    TrackSet::in_memory(tracks.meta.clone(), steer_rows(tracks, EXTENT.rows()))
}

/// Tracks of light whose logarithm is `log(x, y, ms)`, with knots every quarter millisecond that are off by
/// `noise`.
fn tracks(log: impl Fn(usize, usize, f64) -> f64, noise: f64) -> TrackSet {
    let meta = TracksMeta {
        extent: EXTENT,
        span: TimeSpan::new(0, END_NS),
        nominal_exposure_ns: 4_000_000,
        between: Between::LogLinear,
        colour: Colour::Mono,
        has_sigma: false,
        count_hint: None,
    };
    let mut band = TrackBand::begin(0, EXTENT.width);
    let mut random = Random::new(4, &[]);
    for p in 0..EXTENT.pixels() {
        // Knots of different pixels never coincide with each other nor with the film.
        let first = 1_000 * (1 + p as i64 % 97);
        let knots = (0..).map(|n| first + n * 250_000).take_while(|&t| t < END_NS);
        band.push(knots.map(|t| {
            let u = log(p % EXTENT.width as usize, p / EXTENT.width as usize, t as f64 * 1e-6)
                + noise * random.normal();
            (t, libm::exp(u) as f32)
        }));
    }
    TrackSet::in_memory(Arc::new(meta), band)
}

#[test]
fn noise_on_a_sliding_texture_is_removed() {
    let rough = tracks(texture, 0.05);
    let (before, after) = (error(&rough, texture), error(&steer(&rough), texture));
    // Independent noise bends the tensor too: 2.8 dB are found.
    assert!(decibels(before, after) > 2.0, "{before} became {after}: {} dB", decibels(before, after));
}

/// A slanted edge, 1 in log light and steeper than a pixel, that moves by 1.2 pixels a millisecond.
fn edge(x: usize, y: usize, ms: f64) -> f64 {
    let across = x as f64 + 0.4 * y as f64 - 1.2 * (ms - 10.0);
    4.6 - 0.5 * libm::tanh(2.0 * across)
}

#[test]
fn an_edge_that_moves_across_is_not_blurred_across_its_motion() {
    let exact = tracks(edge, 0.0);
    let worst = |tracks: &TrackSet| {
        let band = tracks.read(EXTENT.rows()).unwrap();
        let mut worst: f64 = 0.0;
        for p in 0..EXTENT.pixels() {
            let (x, y) = (p % EXTENT.width as usize, p / EXTENT.width as usize);
            let track = band.pixel(x as u32, y as u32);
            for (&t, &i) in track.t.iter().zip(track.photocurrent) {
                worst = worst.max((libm::log(f64::from(i)) - edge(x, y, t as f64 * 1e-6)).abs());
            }
        }
        worst
    };
    // Noise of 0.035 is what the Gaussian may take; a mean over its window of 1.5 pixels would be off by
    // about 0.25 next to the edge.
    let (off, rough) = (worst(&steer(&exact)), tracks(edge, 0.05));
    assert!(off < 0.05, "{off}");
    let gain = decibels(error(&rough, edge), error(&steer(&rough), edge));
    assert!(gain > 6.0, "{gain} dB");
}

#[test]
fn still_pixels_stay_bit_by_bit_next_to_moving_ones() {
    let half = |x: usize, y: usize, ms: f64| if x < 12 { texture(x, y, 0.0) } else { texture(x, y, ms) };
    let rough = tracks(half, 0.01);
    let (before, after) = (rough.read(EXTENT.rows()).unwrap(), steer(&rough).read(EXTENT.rows()).unwrap());
    assert_eq!((before.offsets(), &before.t), (after.offsets(), &after.t));
    for y in EXTENT.rows().iter() {
        for x in 0..EXTENT.width {
            let same = before.pixel(x, y) == after.pixel(x, y);
            assert_eq!(same, x < 12, "({x}, {y})");
        }
    }
}

#[test]
fn an_unknown_pixel_stays_unknown_and_is_skipped() {
    let rough = tracks(texture, 0.02);
    let band = rough.read(EXTENT.rows()).unwrap();
    let mut holed = TrackBand::begin(0, EXTENT.width);
    for p in 0..EXTENT.pixels() {
        let track = band.pixel((p % 24) as u32, (p / 24) as u32);
        holed.push(
            track.t.iter().copied().zip(track.photocurrent.iter().copied()).filter(|_| p != 8 * 24 + 12),
        );
    }
    let after = steer(&TrackSet::in_memory(rough.meta.clone(), holed)).read(EXTENT.rows()).unwrap();
    assert!(after.pixel(12, 8).t.is_empty());
    // Its neighbour is not drawn towards an unknown light; what is left is noise of 0.02, at most
    // five times.
    let edge = after.pixel(13, 8);
    let off = |k: usize| {
        (libm::log(f64::from(edge.photocurrent[k])) - texture(13, 8, edge.t[k] as f64 * 1e-6)).abs()
    };
    assert!((0..edge.t.len()).all(|k| off(k) < 0.1));
}

/// What the paper's solver makes of the recording of a texture: held tracks.
fn held_tracks() -> TrackSet {
    let (events, frames) = record(texture);
    let node = SolvePaper::build(PaperOptions { evs_weight: 1000.0, ..PaperOptions::default() }).unwrap();
    let input = crate::solve::In { events, frames, sensor: sensor() };
    testing::with_context(EXTENT.rows(), &["tracks", "map"], |cx| node.run(input, cx)).0.unwrap().tracks
}

/// Rms error of the logarithm of held tracks, every half millisecond.
fn held_error(tracks: &TrackSet) -> f64 {
    let band = tracks.read(EXTENT.rows()).unwrap();
    let (mut sum, mut count) = (0.0, 0.0);
    for p in 0..EXTENT.pixels() {
        let track = band.pixel((p % 24) as u32, (p / 24) as u32);
        for n in 4..76 {
            let at = track.t.partition_point(|&knot| knot <= n * 500_000).saturating_sub(1);
            let off = libm::log(f64::from(track.photocurrent[at])) - texture(p % 24, p / 24, 0.5 * n as f64);
            (sum, count) = (sum + off * off, count + 1.0);
        }
    }
    libm::sqrt(sum / count)
}

#[test]
fn what_the_papers_solver_gives_does_not_get_worse() {
    let rough = held_tracks();
    let gain = decibels(held_error(&rough), held_error(&steer(&rough)));
    assert!(gain > 0.0, "{gain} dB");
}

#[test]
fn neither_threads_nor_bands_change_a_bit() {
    for tracks in [held_tracks(), tracks(edge, 0.05)] {
        let with = |threads: usize| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap()
                .install(|| steer_rows(&tracks, EXTENT.rows()))
        };
        let whole = with(1);
        assert_eq!(whole, with(3));
        for height in [1, 5] {
            let parts =
                EXTENT.rows().bands(height).into_iter().map(|rows| steer_rows(&tracks, rows)).collect();
            assert_eq!(whole, TrackBand::concat(parts));
        }
    }
}

#[test]
fn the_mean_of_a_hold_is_its_integral() {
    let film = RowFilm {
        rows: EXTENT.rows(),
        width: 24,
        start_ns: 0,
        step_ns: 10,
        count: 4,
        values: vec![],
        known: vec![],
    };
    // 0 to 2 in the first step, level in the second, then down to -2, where it stays.
    let values = [0.0, 2.0, 2.0, -2.0];
    for (from, to, expected) in [
        (0, 10, 1.0),
        (0, 20, 1.5),
        (5, 10, 1.5),
        (20, 30, 0.0),
        (12, 17, 2.0),
        (10, 10, 2.0),
        (25, 40, -25.0 / 15.0),
    ] {
        let mean = film.mean_over_span(&values, from, to);
        assert!((mean - expected).abs() < 1e-12, "{from} to {to}: {mean}, not {expected}");
    }
}

#[test]
fn colours_are_refused() {
    let error =
        check(&TracksMeta { colour: Colour::Rgb, ..(*tracks(texture, 0.0).meta).clone() }).unwrap_err();
    assert!(error.message.contains("grey"), "{}", error.message);
}
