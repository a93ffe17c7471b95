//! The synthetic clip that other authors' programs were run on, and what they gave: an outside opinion on the
//! baselines.
//!
//! Data: `data/baselines` (README there). Light is 48 x 32 pixels over 0.3 s; events are ideal, threshold
//! 0.05 in log(1 + I).

use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::{EventStream, Exposure, Extent, FrameSequence, testing};
use std::fs;

/// Size of the clip.
pub(crate) const EXTENT: Extent = Extent { width: 48, height: 32 };
/// Pixels of the clip.
pub(crate) const PIXELS: usize = 48 * 32;
/// Threshold of the clip's events, in log(1 + I).
pub(crate) const CONTRAST: f64 = 0.05;

fn bytes(name: &str) -> Vec<u8> {
    fs::read(format!(concat!(env!("CARGO_MANIFEST_DIR"), "/../data/baselines/{}"), name))
        .expect("a file of data/baselines")
}

/// Pictures of 64-bit numbers, each as [row][column].
pub(crate) fn pictures(name: &str) -> Vec<Vec<f64>> {
    let numbers: Vec<f64> =
        bytes(name).chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().expect("eight bytes"))).collect();
    numbers.chunks_exact(PIXELS).map(<[f64]>::to_vec).collect()
}

/// Every pixel's events, as (time in us, sign).
pub(crate) fn events() -> Vec<Vec<(i64, f64)>> {
    let mut words = bytes("clip_events.u32")
        .chunks_exact(4)
        .map(|b| u32::from_le_bytes(b.try_into().expect("four bytes")))
        .collect::<Vec<_>>()
        .into_iter();
    let mut next = || words.next().expect("as many words as the counts say");
    (0..PIXELS)
        .map(|_| {
            (0..next())
                .map(|_| next())
                .map(|word| (i64::from(word / 2), if word % 2 == 1 { 1.0 } else { -1.0 }))
                .collect()
        })
        .collect()
}

/// The events as a stream.
pub(crate) fn stream() -> EventStream {
    let of = |pixel: usize, (t_us, sign): (i64, f64)| Event {
        x: (pixel % 48) as u16,
        y: (pixel / 48) as u16,
        polarity: if sign > 0.0 { Polarity::On } else { Polarity::Off },
        t: t_us * 1000,
        t_in: None,
    };
    testing::stream(
        EXTENT,
        events()
            .into_iter()
            .enumerate()
            .flat_map(|(pixel, list)| list.into_iter().map(move |e| of(pixel, e)))
            .collect(),
    )
}

/// The eight frames: middles 20 ms + 40 ms x l, exposed 20 ms, 8 bits.
pub(crate) fn frames() -> FrameSequence {
    let dn = bytes("clip_frames.u8");
    let exposures =
        (0..8).map(|l| Exposure::new(10_000_000 + l * 40_000_000, 30_000_000 + l * 40_000_000)).collect();
    testing::captured(EXTENT, exposures, 0, |l, x, y| f32::from(dn[l * PIXELS + (y * 48 + x) as usize]))
}

/// Largest difference of two pictures.
pub(crate) fn apart(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold(0.0, |worst, (a, b)| if (a - b).abs() <= worst { worst } else { (a - b).abs() })
}
