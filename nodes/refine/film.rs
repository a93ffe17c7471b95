//! Tracks as functions of time, and as a film of log light for the eye that looks for motion.

use photocurrent_core::{Extent, Rows, TrackBand};
use rayon::prelude::*;
use std::sync::Arc;

/// Log light of every pixel at any instant.
pub(super) struct LogTracks {
    pub extent: Extent,
    /// When its pixels had events.
    pub fired: Arc<Fired>,
    offsets: Vec<usize>,
    t_ns: Vec<i64>,
    log: Vec<f64>,
}

impl LogTracks {
    /// Of a band that holds all rows.
    pub fn new(extent: Extent, band: &TrackBand, fired: &Arc<Fired>) -> LogTracks {
        let log = band.photocurrent.iter().map(|&i| libm::log(f64::max(f64::from(i), f64::MIN_POSITIVE))).collect();
        LogTracks { extent, fired: fired.clone(), offsets: band.offsets().to_vec(), t_ns: band.t.clone(), log }
    }

    /// Log light of a pixel at an instant; `None` where nothing is known.
    pub fn at(&self, x: usize, y: usize, t_ns: i64) -> Option<f64> {
        let pixel = y * self.extent.width as usize + x;
        let range = self.offsets[pixel]..self.offsets[pixel + 1];
        let (t, log) = (&self.t_ns[range.clone()], &self.log[range]);
        let after = t.partition_point(|&knot| knot <= t_ns);
        match (after.checked_sub(1), t.get(after)) {
            (None, None) => None,
            (None, Some(_)) => Some(log[0]),
            (Some(before), None) => Some(log[before]),
            (Some(before), Some(&next)) => {
                let share = (t_ns - t[before]) as f64 / (next - t[before]) as f64;
                Some(log[before] + share * (log[after] - log[before]))
            }
        }
    }
}

/// When the pixels had events.
pub(super) struct Fired {
    offsets: Vec<usize>,
    t_ns: Vec<i64>,
}

impl Fired {
    /// Of the pixels in order, each with rising instants.
    pub fn new(pixels: impl Iterator<Item = Vec<i64>>) -> Fired {
        let mut fired = Fired { offsets: vec![0], t_ns: Vec::new() };
        for pixel in pixels {
            fired.t_ns.extend(pixel);
            fired.offsets.push(fired.t_ns.len());
        }
        fired
    }

    /// Milliseconds from an instant to the nearest event of a pixel; infinity where it has none.
    pub fn apart_ms(&self, pixel: usize, t_ns: i64) -> f64 {
        let t = &self.t_ns[self.offsets[pixel]..self.offsets[pixel + 1]];
        let after = t.partition_point(|&event| event < t_ns);
        let since = after.checked_sub(1).map_or(f64::INFINITY, |before| (t_ns - t[before]) as f64);
        let until = t.get(after).map_or(f64::INFINITY, |&event| (event - t_ns) as f64);
        f64::min(since, until) * 1e-6
    }
}

/// Pictures in which motion is looked for lie so far apart, ns.
pub(super) const STEP_NS: i64 = 500_000;

/// Log light of all pixels at steady instants.
pub(super) struct Film {
    pub width: usize,
    pub height: usize,
    pub start_ns: i64,
    pub step_ns: i64,
    /// Pictures as [y * width + x].
    pub pictures: Vec<Vec<f32>>,
}

impl Film {
    /// Of tracks between two instants. A pixel without a track counts as grey.
    pub fn new(tracks: &LogTracks, span: (i64, i64)) -> Film {
        let (width, height) = (tracks.extent.width as usize, tracks.extent.height as usize);
        let count = ((span.1 - span.0) / STEP_NS + 1) as usize;
        let picture = |n: usize| -> Vec<f32> {
            let t = span.0 + n as i64 * STEP_NS;
            let known: Vec<Option<f64>> =
                Rows { start: 0, end: height as u32 }.iter().flat_map(|y| (0..width).map(move |x| (x, y as usize))).map(|(x, y)| tracks.at(x, y, t)).collect();
            let sum = known.iter().flatten().fold((0.0, 0.0), |(sum, n), u| (sum + u, n + 1.0));
            let grey = if sum.1 > 0.0 { sum.0 / sum.1 } else { 0.0 };
            known.iter().map(|u| u.unwrap_or(grey) as f32).collect()
        };
        let pictures = (0..count).into_par_iter().map(picture).collect();
        Film { width, height, start_ns: span.0, step_ns: STEP_NS, pictures }
    }

    /// The film with every picture smoothed by a Gaussian of `sigma` pixels.
    pub fn smoothed(&self, sigma: f64) -> Film {
        let pictures = self.pictures.par_iter().map(|picture| smooth(picture, self.width, self.height, sigma)).collect();
        Film { pictures, ..*self }
    }
}

/// A picture smoothed by a Gaussian; beyond the border it goes on as at the border.
pub(super) fn smooth(picture: &[f32], width: usize, height: usize, sigma: f64) -> Vec<f32> {
    let reach = (2.5 * sigma).ceil() as usize;
    let half: Vec<f64> = (0..=reach).map(|k| libm::exp(-0.5 * (k as f64 / sigma) * (k as f64 / sigma))).collect();
    let total = half[0] + 2.0 * half[1..].iter().sum::<f64>();
    let kernel: Vec<f32> = half.iter().map(|w| (w / total) as f32).collect();
    let mut across = vec![0.0; picture.len()];
    for (line, out) in picture.chunks_exact(width).zip(across.chunks_exact_mut(width)) {
        for (x, value) in out.iter_mut().enumerate() {
            *value = kernel[0] * line[x];
            for (k, w) in kernel.iter().enumerate().skip(1) {
                *value += w * (line[x.saturating_sub(k)] + line[usize::min(x + k, width - 1)]);
            }
        }
    }
    let mut down = vec![0.0; picture.len()];
    for y in 0..height {
        let out = &mut down[y * width..(y + 1) * width];
        for (k, w) in kernel.iter().enumerate() {
            let (above, below) = (y.saturating_sub(k) * width, usize::min(y + k, height - 1) * width);
            for (x, value) in out.iter_mut().enumerate() {
                *value += if k == 0 { w * across[above + x] } else { w * (across[above + x] + across[below + x]) };
            }
        }
    }
    down
}
