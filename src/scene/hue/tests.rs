//! Hue that moves in closed form, and light of one mixture under it.

use super::*;
use crate::film::EventTimes;
use crate::flow::Flow;
use photocurrent_core::random::Random;
use photocurrent_core::{Colour, Exposure, Extent, FrameBlock, FramesMeta, Sensor, TrackBand, testing};
use std::sync::Arc;

const EXTENT: Extent = Extent { width: 40, height: 24 };
const SPEED: [f64; 2] = [0.8, 0.3];
const GAIN: f64 = 1000.0;
/// Tracks have a knot so often, ns.
const KNOT_NS: i64 = 250_000;
const END_NS: i64 = 20_000_000;

/// Log photocurrent of the mixture at a place of what slides.
fn log(u: f64, v: f64) -> f64 {
    4.6 + 0.3 * libm::sin(0.8 * u + 0.3) * libm::cos(0.7 * v) + 0.2 * libm::sin(0.4 * u - 0.9 * v)
}

/// Ratios of red, green and blue there: their mean is 1.
fn hue(u: f64, v: f64) -> [f64; 3] {
    let (a, b) = (0.5 * libm::sin(0.45 * u) * libm::cos(0.3 * v), 0.3 * libm::cos(0.35 * u + 0.4 * v));
    [1.0 + a, 1.0 + b, 1.0 - a - b]
}

fn at(x: usize, y: usize, t_ns: i64) -> (f64, f64) {
    let ms = t_ns as f64 * 1e-6;
    (x as f64 - SPEED[0] * ms, y as f64 - SPEED[1] * ms)
}

/// Frames of 20 ms of it, exposed so long, with noise of so many DN.
fn captured(length_ns: i64, noise_dn: f64) -> FrameSequence {
    let exposures: Vec<Exposure> =
        [1, 9, 17].map(|ms| Exposure::new(ms * 1_000_000, ms * 1_000_000 + length_ns)).to_vec();
    let meta = (*testing::captured(EXTENT, exposures.clone(), 0, |_, _, _| 0.0).meta).clone();
    let meta = FramesMeta { colour: Colour::Rgb, ..meta };
    let mut block = FrameBlock::zeros(0..exposures.len(), EXTENT.rows(), meta.row_values());
    let mut random = Random::new(5, &[]);
    let parts = 40;
    for (l, exposure) in exposures.iter().enumerate() {
        for (x, y) in pixels() {
            for channel in 0..3 {
                let of = |n: i64| {
                    let t_ns = exposure.start.0 + (2 * n + 1) * length_ns / (2 * parts);
                    let (u, v) = at(x, y, t_ns);
                    libm::exp(log(u, v)) * hue(u, v)[channel]
                };
                let mean = (0..parts).map(of).sum::<f64>() / parts as f64;
                let dn = GAIN * mean * exposure.seconds() + noise_dn * random.normal();
                block.row_mut(l, y as u32)[3 * x + channel] = dn as f32;
            }
        }
    }
    FrameSequence::in_memory(Arc::new(meta), block)
}

fn pixels() -> impl Iterator<Item = (usize, usize)> {
    (0..EXTENT.height as usize).flat_map(|y| (0..EXTENT.width as usize).map(move |x| (x, y)))
}

fn tracks() -> LogTracks {
    let mut band = TrackBand::begin(0, EXTENT.width);
    for (x, y) in pixels() {
        band.push((0..=END_NS / KNOT_NS).map(|n| {
            let (u, v) = at(x, y, n * KNOT_NS);
            (n * KNOT_NS, libm::exp(log(u, v)) as f32)
        }));
    }
    LogTracks::new(EXTENT, band, &Arc::new(EventTimes::new(pixels().map(|_| Vec::new()))))
}

fn size() -> (usize, usize) {
    (EXTENT.width as usize, EXTENT.height as usize)
}

/// Rms error of the ratios at an instant, away from the borders, where what comes in was seen by no frame;
/// and the ratios.
fn error(frames: &FrameSequence, velocity: [f64; 2], t_ns: i64) -> (f64, Vec<Image>) {
    let flow = Flow::uniform(size(), velocity.map(|v| v as f32), [0.0; 2]);
    let path = MotionPath::new(&flow);
    let grey = GreyFrames::new(EXTENT, &frames.meta, &Sensor::unknown("")).unwrap();
    let hues = Hues::new(grey, frames, (&tracks(), GAIN), &path, None).unwrap();
    let values = pixels()
        .map(|(x, y)| {
            let (u, v) = at(x, y, t_ns);
            (GAIN * libm::exp(log(u, v))) as f32
        })
        .collect();
    let light = Image { width: size().0, height: size().1, values };
    let ratios = hues.ratios(&light, &[t_ns; EXTENT.height as usize], &path);
    let (mut sum, mut count) = (0.0, 0.0);
    for (x, y) in pixels().filter(|(x, y)| (9..31).contains(x) && (6..18).contains(y)) {
        let (u, v) = at(x, y, t_ns);
        for (ratio, truth) in ratios.iter().zip(hue(u, v)) {
            let off = f64::from(ratio.values[y * size().0 + x]) - truth;
            (sum, count) = (sum + off * off, count + 1.0);
        }
    }
    (libm::sqrt(sum / count), ratios)
}

#[test]
fn hue_is_carried_along_the_motion() {
    let frames = captured(200_000, 0.0);
    let (carried, ratios) = error(&frames, SPEED, 13_100_000);
    // Half a period from both frames: what moved by three pixels and more.
    let (stays, _) = error(&frames, [0.0; 2], 13_100_000);
    assert!(carried < 0.02 && stays > 5.0 * carried, "{carried}, {stays}");
    for k in 0..size().0 * size().1 {
        let mean: f32 = ratios.iter().map(|ratio| ratio.values[k]).sum::<f32>() / 3.0;
        assert!((mean - 1.0).abs() < 1e-5, "the mixture is another one: {mean}");
    }
}

#[test]
fn at_a_frame_hue_is_that_of_the_frame() {
    let frames = captured(200_000, 0.0);
    let (off, _) = error(&frames, SPEED, 9_100_000);
    assert!(off < 0.01, "{off}");
}

#[test]
fn hue_of_a_long_exposure_is_sharpened() {
    // Six milliseconds: five pixels.
    let frames = captured(6_000_000, 0.0);
    let (sharp, _) = error(&frames, SPEED, 12_000_000);
    let grey = GreyFrames::new(EXTENT, &frames.meta, &Sensor::unknown("")).unwrap();
    let block = frames.read_rows(EXTENT.rows()).unwrap();
    let mixture = grey.read(&frames, SaturatedMean::Mean).unwrap();
    let (mut sum, mut count) = (0.0, 0.0);
    for (x, y) in pixels().filter(|(x, y)| (9..31).contains(x) && (6..18).contains(y)) {
        let (u, v) = at(x, y, 12_000_000);
        for (channel, truth) in hue(u, v).into_iter().enumerate() {
            let collected = f64::from(block.row(1, y as u32)[3 * x + channel]);
            let off = collected / f64::from(mixture[(24 + y) * size().0 + x]) - truth;
            (sum, count) = (sum + off * off, count + 1.0);
        }
    }
    let blurred: f64 = libm::sqrt(sum / count);
    assert!(sharp < 0.6 * blurred, "{sharp}, and {blurred} as it was collected");
}

#[test]
fn noise_of_hue_is_averaged_where_hues_are_alike() {
    // A twentieth of the mean light.
    let noise = 0.05 * GAIN * 100.0 * 2e-4;
    let clean = |noise_dn: f64| error(&captured(200_000, noise_dn), SPEED, 9_100_000).0;
    // A value alone would be off by the noise and a third of it (that of the mixture).
    let (without, with) = (clean(0.0), clean(noise));
    assert!(without < 0.01 && with < 0.6 * 0.05, "{without}, {with}");
}

#[test]
fn a_path_follows_the_motion_to_the_row_that_is_exposed_then() {
    let flow = Flow::uniform(size(), [0.5, 1.0], [0.0; 2]);
    let path = MotionPath::new(&flow);
    // Each row there is exposed 0.1 ms after the one before: what moves down meets its row later.
    let places = path.follow_pixels(size(), &[0; 24], &|row| 2_000_000 + row as i64 * 100_000);
    let (x, y) = places[4 * 40 + 10];
    // It arrives in row 6, at 2.6 ms.
    assert!((x - 11.3).abs() < 1e-3 && (y - 6.6).abs() < 1e-3, "({x}, {y})");
}
