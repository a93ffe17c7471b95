//! A small recording both ways: events and frames of a scene to light, and light to pictures.

use crate::card;
use photocurrent_core::document::Source;
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::{EventStream, Exposure, Extent, FrameSequence, Rows, Sensor, TrackSet, testing};
use photocurrent_gpu::{Card, CardOptions};
use photocurrent_sensor::exposure::LogLinearTrack;
use photocurrent_solve::{Elsewhere, Host, Pictures, Recording, SolveOptions, picture_rows, solve_rows};
use std::sync::atomic::{AtomicU64, Ordering};

const EXTENT: Extent = Extent { width: 32, height: 20 };
const STEP_NS: i64 = 50_000;
const END_NS: i64 = 60_000_000;

/// Two waves and a bar with steep edges, which move to the right.
fn log_light(x: u32, y: u32, t_ns: i64) -> f64 {
    let at = 0.5 * f64::from(x) + 0.2 * f64::from(y) - t_ns as f64 * 4e-7;
    let bar = libm::tanh(4.0 * libm::sin(0.35 * at));
    3.6 + 0.5 * libm::sin(at) + 0.2 * libm::sin(2.3 * at + 1.0) + 0.4 * bar
}

/// What is collected of a pixel, photocurrent times seconds.
fn collected(x: u32, y: u32, exposure: Exposure) -> f64 {
    let instants = (exposure.start.0..exposure.end.0).step_by(STEP_NS as usize);
    instants.map(|t| libm::exp(log_light(x, y, t + STEP_NS / 2))).sum::<f64>() * STEP_NS as f64 * 1e-9
}

fn recorded() -> (EventStream, FrameSequence, Sensor) {
    let mut events = Vec::new();
    for (x, y) in (0..EXTENT.height).flat_map(|y| (0..EXTENT.width).map(move |x| (x, y))) {
        let mut reference = log_light(x, y, 0);
        for t in (0..END_NS).step_by(STEP_NS as usize) {
            let moved = log_light(x, y, t) - reference;
            if moved.abs() >= 0.2 {
                let polarity = if moved > 0.0 { Polarity::On } else { Polarity::Off };
                events.push(Event { x: x as u16, y: y as u16, polarity, t, t_in: Some(t) });
                reference = log_light(x, y, t);
            }
        }
    }
    let exposures: Vec<Exposure> =
        (0..7).map(|l| Exposure::new(l * 8_000_000, l * 8_000_000 + 5_000_000)).collect();
    let frames = testing::captured(EXTENT, exposures.clone(), 0, |l, x, y| {
        if (x, y) == (5, 11) { f32::NAN } else { (1000.0 * collected(x, y, exposures[l])) as f32 }
    });
    let text = "format = \"photocurrent-sensor/1\"\n[front_end]\ntau_0 = \"20 us\"\nalpha = \"1 ms\"\n\
                [comparator]\nthreshold_on = 0.2\nthreshold_off = 0.2\n[readout]\nrefractory = \"10 us\"\n\
                [frames]\ngain = 1000.0\n";
    (
        testing::stream(EXTENT, events),
        frames,
        Sensor::parse(&Source::new("s.toml", "", text)).expect("a sensor"),
    )
}

/// A card, and how many pixels it left to the processor.
struct OnCard<'a>(&'a Card, AtomicU64);

impl Host for OnCard<'_> {
    fn elsewhere(&self) -> Option<&dyn Elsewhere> {
        Some(self.0)
    }

    fn left_here(&self, pixels: u64) {
        self.1.fetch_add(pixels, Ordering::Relaxed);
    }
}

/// PSNR of pictures of 200 us at 1 kHz against those of the scene, dB, in the range of the scene's.
fn psnr(tracks: &TrackSet) -> f64 {
    let band = tracks.read(tracks.rows()).expect("in memory");
    let (mut square, mut count, mut brightest) = (0.0, 0, 0.0_f64);
    for t in 1..55 {
        let exposure = Exposure::new(t * 1_000_000, t * 1_000_000 + 200_000);
        for (x, y) in (0..EXTENT.height).flat_map(|y| (0..EXTENT.width).map(move |x| (x, y))) {
            let track = band.pixel(x, y);
            if track.t.is_empty() {
                continue;
            }
            let light: Vec<f64> = track.photocurrent.iter().map(|i| f64::from(*i)).collect();
            let truth = collected(x, y, exposure);
            let miss = LogLinearTrack::new(track.t, &light).integral(exposure) - truth;
            (square, count, brightest) = (square + miss * miss, count + 1, brightest.max(truth));
        }
    }
    10.0 * libm::log10(brightest * brightest / (square / f64::from(count)))
}

#[test]
fn pictures_of_a_recording_are_as_good_as_by_the_processor() {
    let Some(card) = card(CardOptions::default()) else { return };
    let (events, frames, sensor) = recorded();
    let recording = Recording { events: &events, frames: &frames, sensor: &sensor };
    let (options, rows) = (SolveOptions::default(), EXTENT.rows());
    let host = OnCard(&card, AtomicU64::new(0));
    let solve =
        |rows: Rows, host: &dyn Host| solve_rows(&recording, &options, rows, host).expect("it solves");
    let (ours, theirs) = (solve(rows, &host), solve(rows, &()));
    assert_eq!(host.1.into_inner(), 0);
    let (on_card, here) = (psnr(&ours.tracks), psnr(&theirs.tracks));
    #[allow(clippy::print_stdout)]
    {
        println!("PSNR on the card {on_card:.4} dB, on the processor {here:.4} dB");
    }
    assert!(here > 30.0 && (on_card - here).abs() < 0.01, "{on_card} and {here} dB");
    // Bands change no bit, and neither does a second time.
    let part = solve(Rows { start: 16, end: 20 }, &OnCard(&card, AtomicU64::new(0)));
    let (all, some) =
        (ours.tracks.read(rows).expect("all"), part.tracks.read(part.tracks.rows()).expect("some"));
    for (x, y) in (16..20).flat_map(|y| (0..EXTENT.width).map(move |x| (x, y))) {
        let (a, b) = (all.pixel(x, y), some.pixel(x, y));
        assert_eq!((a.t, a.photocurrent), (b.t, b.photocurrent), "pixel {x}, {y}");
    }
}

/// What is left away of tracks moves light by 2e-4 and a standard deviation by a twentieth, at most; light
/// that stays on the card has all its knots.
#[test]
fn pictures_that_stay_on_the_card_are_those_of_tracks() {
    let (Some(card), Some(small)) =
        (card(CardOptions::default()), card(CardOptions { pool_bytes: 4 << 20, ..CardOptions::default() }))
    else {
        return;
    };
    let (events, frames, sensor) = recorded();
    let recording = Recording { events: &events, frames: &frames, sensor: &sensor };
    let rows = EXTENT.rows();
    // At a stated noise nothing is chosen, which is the processor's part.
    let options = SolveOptions { event_noise: Some(0.1), frame_noise: 0.01, ..SolveOptions::default() };
    // A rolling shutter: every row has exposures of its own.
    let exposures = |row: u32| -> Vec<Exposure> {
        let start = |t: i64| t * 1_000_000 + 13_000 * i64::from(row);
        (0..60).map(|t| Exposure::new(start(t), start(t) + 200_000)).collect()
    };
    let host = OnCard(&card, AtomicU64::new(0));
    let pictures = |rows: Rows, card: &Card| -> Pictures {
        let host = OnCard(card, AtomicU64::new(0));
        let solved = picture_rows(&recording, &options, rows, &exposures, &host).expect("it solves");
        solved.expect("there is a card")
    };
    let (ours, theirs) =
        (pictures(rows, &card), solve_rows(&recording, &options, rows, &host).expect("it solves"));
    let planes = |map: &photocurrent_core::MapSet| -> Vec<u32> {
        map.read(rows).expect("in memory").values.iter().map(|value| value.to_bits()).collect()
    };
    assert!(planes(&ours.map) == planes(&theirs.map), "the map is the same");
    let band = theirs.tracks.read(rows).expect("in memory");
    let (mut of_light, mut of_sigma, mut unknown) = (0.0, 0.0, 0);
    for picture in &ours.rows {
        let exposures = exposures(picture.row);
        for (l, x) in (0..60).flat_map(|l| (0..EXTENT.width).map(move |x| (l, x))) {
            let track = band.pixel(x, picture.row);
            let at = l * EXTENT.width as usize + x as usize;
            let (light, spread) = (f64::from(picture.light[at]), f64::from(picture.spread[at]));
            if track.t.is_empty() {
                assert!(light.is_nan() && spread.is_nan());
                unknown += 1;
                continue;
            }
            let spreads: Vec<f32> = track.photocurrent.iter().zip(track.sigma).map(|(i, s)| i * s).collect();
            let mean =
                |of: &[f32]| LogLinearTrack::new(track.t, of).integral(exposures[l]) / exposures[l].seconds();
            of_light = f64::max(of_light, (light / mean(track.photocurrent) - 1.0).abs());
            of_sigma = f64::max(of_sigma, (spread / mean(&spreads) - 1.0).abs());
        }
    }
    #[allow(clippy::print_stdout)]
    {
        println!(
            "pictures on the card differ from those of tracks by {of_light:.1e}, sigmas by {of_sigma:.1e}"
        );
    }
    assert!(of_light < 4e-4 && of_sigma < 0.08 && unknown == 60, "{of_light}, {of_sigma}, {unknown}");
    // Bands and the pool change no bit.
    let bits = |pictures: &Pictures, row: u32| -> Vec<u32> {
        let picture = pictures.rows.iter().find(|picture| picture.row == row).expect("the row is there");
        picture.light.iter().chain(&picture.spread).map(|x| x.to_bits()).collect()
    };
    let (part, pooled) = (pictures(Rows { start: 16, end: 20 }, &card), pictures(rows, &small));
    assert!((16..20).all(|row| bits(&part, row) == bits(&ours, row)));
    assert!(rows.iter().all(|row| bits(&pooled, row) == bits(&ours, row)));
}
