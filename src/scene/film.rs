//! Tracks as functions of time, and as pictures of log light at steady instants, in which motion is
//! estimated.

use crate::image::Image;
use photocurrent_core::{Extent, TrackBand, time};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// Log light of every pixel at any instant.
pub struct LogTracks {
    /// Size of the array.
    pub extent: Extent,
    /// When its pixels had events.
    pub fired: Arc<EventTimes>,
    offsets: Vec<usize>,
    t_ns: Vec<i64>,
    log: Vec<f32>,
}

impl LogTracks {
    /// From a band with all rows.
    pub fn new(extent: Extent, band: TrackBand, fired: &Arc<EventTimes>) -> LogTracks {
        let offsets = band.offsets().to_vec();
        let log = band
            .photocurrent
            .par_iter()
            .map(|&i| libm::log(f64::max(f64::from(i), f64::MIN_POSITIVE)) as f32)
            .collect();
        LogTracks { extent, fired: fired.clone(), offsets, t_ns: band.t, log }
    }

    /// Log light of a pixel at an instant; `None` where it is not known.
    pub fn at(&self, x: usize, y: usize, t_ns: i64) -> Option<f64> {
        let (t, log) = self.knots(y * self.extent.width as usize + x);
        log_between(t, log, t.partition_point(|&knot| knot <= t_ns), t_ns)
    }

    /// Log light of a pixel at instants in rising order.
    fn log_at_instants(
        &self,
        pixel: usize,
        instants: impl Iterator<Item = i64>,
    ) -> impl Iterator<Item = Option<f64>> {
        let (t, log) = self.knots(pixel);
        let mut after = None;
        instants.map(move |t_ns| {
            let mut now = after.unwrap_or_else(|| t.partition_point(|&knot| knot <= t_ns));
            while t.get(now).is_some_and(|knot| *knot <= t_ns) {
                now += 1;
            }
            after = Some(now);
            log_between(t, log, now, t_ns)
        })
    }

    fn knots(&self, pixel: usize) -> (&[i64], &[f32]) {
        let range = self.offsets[pixel]..self.offsets[pixel + 1];
        (&self.t_ns[range.clone()], &self.log[range])
    }
}

/// Log light at an instant; `after` is the number of the first knot behind it.
fn log_between(t: &[i64], log: &[f32], after: usize, t_ns: i64) -> Option<f64> {
    time::between(t, after, t_ns, |k| f64::from(log[k]), |a, b, share| a + share * (b - a))
}

/// Times of the pixels' events.
pub struct EventTimes {
    offsets: Vec<usize>,
    t_ns: Vec<i64>,
}

impl EventTimes {
    /// Of the pixels in order, each with rising instants.
    pub fn new(pixels: impl Iterator<Item = Vec<i64>>) -> EventTimes {
        let mut fired = EventTimes { offsets: vec![0], t_ns: Vec::new() };
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

/// Pictures in which motion is estimated lie so far apart, ns.
pub const STEP_NS: i64 = 500_000;

/// Log light of all pixels at some of the steady instants of a recording.
pub struct LogFilm {
    /// The first picture's number, of all instants of the recording.
    pub first: usize,
    /// The pictures.
    pub pictures: Vec<Image>,
}

impl LogFilm {
    /// Number of instants between two.
    pub fn count(span: (i64, i64)) -> usize {
        ((span.1 - span.0) / STEP_NS + 1) as usize
    }

    /// Pictures of the tracks at the steps `numbers` from `start_ns`. A pixel without a track counts as grey.
    pub fn new(tracks: &LogTracks, start_ns: i64, numbers: Range<usize>) -> LogFilm {
        let (width, height) = (tracks.extent.width as usize, tracks.extent.height as usize);
        let row = |y: usize| -> Vec<f32> {
            let mut lines = vec![f32::NAN; numbers.len() * width];
            for x in 0..width {
                let instants = numbers.clone().map(|n| start_ns + n as i64 * STEP_NS);
                for (n, log) in tracks.log_at_instants(y * width + x, instants).enumerate() {
                    lines[n * width + x] = log.map_or(f32::NAN, |log| log as f32);
                }
            }
            lines
        };
        let rows: Vec<Vec<f32>> = (0..height).into_par_iter().map(row).collect();
        let picture = |n: usize| -> Image {
            let mut picture: Vec<f32> =
                rows.iter().flat_map(|lines| &lines[n * width..(n + 1) * width]).copied().collect();
            let sum = picture
                .iter()
                .filter(|u| !u.is_nan())
                .fold((0.0, 0.0), |(sum, n), u| (sum + f64::from(*u), n + 1.0));
            let grey = if sum.1 > 0.0 { (sum.0 / sum.1) as f32 } else { 0.0 };
            picture.iter_mut().filter(|u| u.is_nan()).for_each(|u| *u = grey);
            Image { width, height, values: picture }
        };
        LogFilm { first: numbers.start, pictures: (0..numbers.len()).into_par_iter().map(picture).collect() }
    }

    /// The film with every picture smoothed by a Gaussian of `sigma` pixels.
    pub fn smoothed(&self, sigma: f64) -> LogFilm {
        let pictures = self.pictures.par_iter().map(|picture| picture.smoothed_by(sigma)).collect();
        LogFilm { first: self.first, pictures }
    }
}
