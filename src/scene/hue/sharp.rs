//! Ratios of a frame as they are at the middle of its exposure, from those of its blurred light.
//!
//! A value collects `integral r(x, t) i(x, t) dt` over the exposure, with the mixture's light `i`, which the
//! tracks state, and the ratio `r`, which moves along: what is at x at instant t is at another place at the
//! middle of the exposure. So the ratios there are those that, carried along the motion and weighted by the
//! light, give the ratios that were collected. They are found by the iteration of Richardson (1972) and Lucy
//! (1974), which keeps them positive and changes nothing where nothing moves.

use super::path::MotionPath;
use super::taps::BilinearTaps;
use crate::film::LogTracks;
use crate::image::Image;
use photocurrent_core::FrameTimes;
use rayon::prelude::*;

/// Instants of an exposure; the motion between two of them is a pixel or so.
const MOST_INSTANTS: usize = 16;
const LEAST_INSTANTS: usize = 4;
/// Motion over the exposure, pixels, below which nothing is deblurred.
const STILL: f32 = 0.25;
/// Steps of the iteration: more of them sharpen noise as well.
const STEPS: usize = 10;
/// A ratio is corrected by this factor at most in a step.
const MOST: f32 = 4.0;

/// An exposure of all rows, and the light in it.
pub(super) struct ExposureLight<'a> {
    pub tracks: &'a LogTracks,
    pub path: &'a MotionPath<'a>,
    pub times: &'a FrameTimes,
    pub frame: usize,
}

impl ExposureLight<'_> {
    fn size(&self) -> (usize, usize) {
        (self.tracks.extent.width as usize, self.tracks.extent.height as usize)
    }

    /// For each row the instant at a share of its exposure.
    fn instants(&self, share: f64) -> Vec<i64> {
        let of = |row: usize| {
            let exposure = self.times.exposure(self.frame, row as u32);
            exposure.start.0 + (share * exposure.length_ns() as f64) as i64
        };
        (0..self.size().1).map(of).collect()
    }

    /// Photocurrent of every pixel at these instants of its row; 0 where it is not known.
    pub(super) fn light(&self, t_ns: &[i64]) -> Image {
        let (width, height) = self.size();
        let of = |k: usize| {
            let (x, y) = (k % width, k / width);
            self.tracks.at(x, y, t_ns[y]).map_or(0.0, |log| libm::exp(log) as f32)
        };
        Image { width, height, values: (0..width * height).into_par_iter().map(of).collect() }
    }

    /// The middle of the exposure of each row.
    pub(super) fn mid_exposure(&self) -> Vec<i64> {
        self.instants(0.5)
    }
}

/// Sharpens the `ratios` of a frame.
pub(super) fn sharpen(ratios: &mut [Image], exposed: &ExposureLight<'_>) {
    let size = exposed.size();
    let (start, middle, end) = (exposed.instants(0.0), exposed.mid_exposure(), exposed.instants(1.0));
    let moved = |from: &[i64], to: &[i64]| exposed.path.follow_pixels(size, from, &|row| to[row]);
    let farthest = (moved(&middle, &start).iter().chain(&moved(&middle, &end)).enumerate())
        .map(|(k, (x, y))| {
            let k = k % (size.0 * size.1);
            libm::hypotf(x - (k % size.0) as f32, y - (k / size.0) as f32)
        })
        .fold(0.0, f32::max);
    if 2.0 * farthest < STILL {
        return;
    }
    let count = ((2.0 * farthest) as usize).clamp(LEAST_INSTANTS, MOST_INSTANTS);
    let instants: Vec<ExposureInstant> = (0..count)
        .map(|n| {
            let t_ns = exposed.instants((n as f64 + 0.5) / count as f64);
            ExposureInstant {
                light: exposed.light(&t_ns),
                to_middle: BilinearTaps::new(exposed.path, size, &t_ns, &|row| middle[row]),
                from_middle: BilinearTaps::new(exposed.path, size, &middle, &|row| t_ns[row]),
            }
        })
        .collect();
    ratios.par_iter_mut().for_each(|ratio| {
        let collected = ratio.clone();
        for _ in 0..STEPS {
            let correction = correction(&collected, ratio, &instants);
            let step = |k: usize| {
                let (mut sum, mut weight) = (0.0, 0.0);
                for ExposureInstant { light, from_middle, .. } in &instants {
                    let light = from_middle.read(light, k);
                    sum += light * from_middle.read(&correction, k);
                    weight += light;
                }
                if weight > 0.0 { sum / weight } else { 1.0 }
            };
            ratio.values.iter_mut().enumerate().for_each(|(k, ratio)| *ratio *= step(k));
        }
    });
}

/// An instant of an exposure.
struct ExposureInstant {
    light: Image,
    /// Places, at mid-exposure, of the objects at each pixel now,
    to_middle: BilinearTaps,
    /// and places now of the objects at each pixel at mid-exposure.
    from_middle: BilinearTaps,
}

/// Correction: each pixel's measured ratio over the prediction from these ratios.
fn correction(collected: &Image, ratio: &Image, instants: &[ExposureInstant]) -> Image {
    let of = |(k, collected): (usize, &f32)| {
        let (mut sum, mut weight) = (0.0, 0.0);
        for ExposureInstant { light, to_middle, .. } in instants {
            sum += light.values[k] * to_middle.read(ratio, k);
            weight += light.values[k];
        }
        if sum > 0.0 { (collected * weight / sum).clamp(1.0 / MOST, MOST) } else { 1.0 }
    };
    Image { values: collected.values.iter().enumerate().map(of).collect(), ..*collected }
}
