//! The hue of captured frames, carried along the motion to any instant.
//!
//! An event pixel sees the mixture of the values of a frame that lie on it ([`GreyFrames`]): three channels,
//! the pixels of a mosaic, or pixels finer than its own. Events therefore give the mixture over time, and do
//! not determine how light divides between the values: that is known when a frame is exposed, as the ratio of
//! each value to the mixture. Between frames what has a hue moves, and its hue with it. So a ratio is taken
//! from the frames before and after, where the motion leads there from the pixel ([`MotionPath`]), and at the
//! pixel itself. Which of these four it is, the mixture states: light of the frame there, against light now,
//! over the neighbourhood. Where none agrees (something is uncovered, and seen in neither frame) the frames
//! count by their distance in time.
//!
//! Ratios are means of values over means of mixtures with equal weights, so the weighted sum of what comes
//! out is the mixture that went in, whatever the hue: the grey answer stays the grey answer.
//!
//! Limits: ratios of a frame whose exposure is long against the motion are those of blurred light; of a thing
//! that no frame shows, the hue is that of its neighbourhood.

mod clean;
mod path;
mod sharp;
mod taps;
#[cfg(test)]
mod tests;

pub use path::MotionPath;

use crate::alignment::{Alignment, BilinearWeights};
use crate::film::LogTracks;
use crate::grey::{GreyFrames, SaturatedMean};
use crate::image::{Image, smooth};
use clean::MOST;
use photocurrent_core::{DataError, Extent, FrameSequence, FrameTimes};
use sharp::ExposureLight;
use taps::BilinearTaps;

/// Light that is this part of the mean or less is dark: its logarithm states little.
const DARK: f64 = 0.05;
/// Mixtures whose logarithms differ by so much over a neighbourhood are of other things.
const ALIKE: f64 = 0.1;
/// Standard deviation of that neighbourhood, pixels.
const NEIGHBOURHOOD: f64 = 1.0;
/// Weight of the pixel itself relative to the place along the motion, for equal similarity.
const OWN: f64 = 0.1;
/// Weight of a place where nothing agrees.
const LEAST: f64 = 1e-5;

/// A captured frame as mixture and values, all on the grid of the event pixels, per second of exposure.
#[derive(Clone)]
struct Captured {
    /// Light of the event pixels at the middle of the exposure; 0 = not known.
    mixture: Image,
    /// Its logarithm, dark light apart.
    log: Image,
    /// For each value of an event pixel its light then: the ratio times the mixture.
    values: Vec<Image>,
}

/// Captured frames from which hue is taken.
pub struct Hues {
    grey: GreyFrames,
    times: FrameTimes,
    frames: Vec<Captured>,
    /// Added to light before its logarithm is taken.
    dark: f64,
}

impl Hues {
    /// Of captured frames next to event pixels, whose mixture `tracks` hold and whose motion is `path`; the
    /// description's `gain` is that of the frames.
    ///
    /// With an event array on another grid, from which the tracks were interpolated, ratios are those to the
    /// mixture as that array gives it: what it does not resolve is in them, and moves along.
    ///
    /// # Errors
    /// When the frames cannot be read.
    pub fn new(
        grey: GreyFrames,
        frames: &FrameSequence,
        (tracks, gain): (&LogTracks, f64),
        path: &MotionPath<'_>,
        array: Option<&Alignment>,
    ) -> Result<Hues, DataError> {
        let meta = &frames.meta;
        let times = grey.times(&meta.times);
        let (ratio, channels) = (grey.ratio, grey.colour.channels());
        let (width, height) = (meta.extent.width / ratio, meta.extent.height / ratio);
        let mixtures = grey.read(frames, SaturatedMean::Mean)?;
        let pixels = (width * height) as usize;
        let mut raw = Vec::with_capacity(frames.len());
        for (l, mixture) in mixtures.chunks_exact(pixels.max(1)).enumerate() {
            let block = frames.read(l..l + 1, meta.extent.rows())?;
            let dn = block.frame(l);
            let per_second = 1.0 / times.exposures[l].seconds();
            let image = |of: &dyn Fn(u32, u32) -> f64| Image {
                width: width as usize,
                height: height as usize,
                values: (0..pixels as u32)
                    .map(|at| {
                        let light = of(at % width, at / width) * per_second;
                        // What is not known counts nowhere: neither in a value nor in its mixture.
                        let is_known = mixture[at as usize].is_finite();
                        if is_known { light as f32 } else { 0.0 }
                    })
                    .collect(),
            };
            let value = |n: usize| {
                image(&|x, y| {
                    let (value, row) = grey.value_place(n, (x, y));
                    let at = row as usize * (width * ratio * channels) as usize + value as usize;
                    grey.light(f64::from(dn[at]), value, row)
                })
            };
            let values: Vec<Image> = (0..grey.values()).map(value).collect();
            let mixture = image(&|x, y| grey.above(f64::from(mixture[(y * width + x) as usize])));
            raw.push((mixture, values));
        }
        if let Some(array) = array {
            let around = array.bilinear_weights(Extent { width, height });
            raw.iter_mut().for_each(|(mixture, _)| *mixture = resolved(mixture, array, &around));
        }
        let sum: f64 = raw.iter().flat_map(|(mixture, _)| &mixture.values).map(|u| f64::from(*u)).sum();
        let mean = sum / usize::max(raw.len() * pixels, 1) as f64;
        let dark = f64::max(DARK * mean, f64::MIN_POSITIVE);
        let ratios = clean::without_noise(&raw, mean);
        // Every event pixel has the same, or none sees a mixture.
        let weights = grey.weights((0, 0));
        let frame = |(frame, mut ratios): (usize, Vec<Image>)| {
            let exposed = ExposureLight { tracks, path, times: &times, frame };
            sharp::sharpen(&mut ratios, &exposed);
            if array.is_none() {
                of_the_mixture(&mut ratios, weights);
            }
            // As the tracks have it: sharp, at the middle of the exposure.
            let mut mixture = exposed.light(&exposed.mid_exposure());
            mixture.values.iter_mut().for_each(|light| *light *= gain as f32);
            let log = mixture.values.iter().map(|u| log_of(f64::from(*u), dark)).collect();
            for ratio in &mut ratios {
                ratio.values.iter_mut().zip(&mixture.values).for_each(|(ratio, light)| *ratio *= light);
            }
            Captured { log: Image { values: log, ..mixture }, mixture, values: ratios }
        };
        let frames = ratios.into_iter().enumerate().map(frame).collect();
        Ok(Hues { grey, times, frames, dark })
    }

    /// How values lie on the event pixels.
    pub fn grey(&self) -> &GreyFrames {
        &self.grey
    }

    /// Ratio of each value of an event pixel to the mixture, as pictures over the event pixels; 1 where
    /// unknown.
    ///
    /// `light`: the mixture per second of exposure; `t_ns`: mid-exposure of each of its rows.
    pub fn ratios(&self, light: &Image, t_ns: &[i64], path: &MotionPath<'_>) -> Vec<Image> {
        let (width, height) = (light.width, light.height);
        let log: Vec<f32> = light.values.iter().map(|u| log_of(f64::from(*u), self.dark)).collect();
        let pixels = width * height;
        let mut sums = vec![vec![0.0_f32; pixels]; self.grey.values()];
        let mut mixture = vec![0.0_f32; pixels];
        for (l, share) in self.bracketing_frames(height / 2, t_ns[height / 2]) {
            let at = |row: usize| self.times.exposure(l, row as u32).mid().0;
            let Captured { mixture: of_frame, log: of_log, values } = &self.frames[l];
            let own = (OWN, BilinearTaps::identity(width, height));
            let moved = (1.0, BilinearTaps::new(path, (width, height), t_ns, &at));
            for (prior, taps) in [own, moved] {
                let apart = |k: usize| {
                    let apart = taps.read(of_log, k) - log[k];
                    apart * apart
                };
                let apart: Vec<f32> = (0..pixels).map(apart).collect();
                let apart = smooth(&apart, width, height, NEIGHBOURHOOD);
                let weight = |apart: f32| {
                    prior * share * (libm::exp(-0.5 * f64::from(apart) / (ALIKE * ALIKE)) + LEAST)
                };
                let weights: Vec<f32> = apart.into_iter().map(|apart| weight(apart) as f32).collect();
                let add = |sum: &mut Vec<f32>, image: &Image| {
                    sum.iter_mut().enumerate().for_each(|(k, sum)| *sum += weights[k] * taps.read(image, k))
                };
                add(&mut mixture, of_frame);
                sums.iter_mut().zip(values).for_each(|(sum, value)| add(sum, value));
            }
        }
        let ratio = |(value, mixture): (f32, f32)| {
            if mixture > 0.0 { f32::clamp(value / mixture, 0.0, MOST) } else { 1.0 }
        };
        let ratios = |sum: Vec<f32>| Image {
            width,
            height,
            values: sum.into_iter().zip(mixture.iter().copied()).map(ratio).collect(),
        };
        sums.into_iter().map(ratios).collect()
    }

    /// The frames before and after an instant in a row, and their weights.
    fn bracketing_frames(&self, row: usize, t_ns: i64) -> Vec<(usize, f64)> {
        let mid = |l: usize| self.times.exposure(l, row as u32).mid().0;
        let count = self.frames.len();
        match (0..count).find(|l| mid(*l) > t_ns) {
            Some(0) => vec![(0, 1.0)],
            None => vec![(count - 1, 1.0)],
            Some(n) => {
                let share = (t_ns - mid(n - 1)) as f64 / (mid(n) - mid(n - 1)) as f64;
                vec![(n - 1, 1.0 - share), (n, share)]
            }
        }
    }
}

/// A picture as the pixels of an event array see it, interpolated between them; as it is where none is near.
fn resolved(picture: &Image, array: &Alignment, around: &[BilinearWeights]) -> Image {
    let seen = array.to_events(picture);
    let of = |(around, own): (&BilinearWeights, &f32)| {
        // A picture has 0 where nothing is known.
        if around.is_known() && *own > 0.0 { around.interpolate(&seen.values) } else { *own }
    };
    Image { values: around.iter().zip(&picture.values).map(of).collect(), ..*picture }
}

/// Scales the ratios of each pixel so that their weighted sum is the mixture.
fn of_the_mixture(ratios: &mut [Image], weights: &[f64]) {
    for k in 0..ratios.first().map_or(0, |ratio| ratio.values.len()) {
        let sum: f64 = ratios.iter().zip(weights).map(|(r, weight)| f64::from(r.values[k]) * weight).sum();
        if sum > 0.0 {
            ratios.iter_mut().for_each(|ratio| ratio.values[k] /= sum as f32);
        }
    }
}

fn log_of(light: f64, dark: f64) -> f32 {
    libm::log(f64::max(light, 0.0) + dark) as f32
}
