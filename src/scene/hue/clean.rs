//! Denoises the ratios of a frame.
//!
//! A hue changes little from pixel to pixel, so it is a mean over a neighbourhood and over the frames before
//! and after: of the values over that of the mixtures. Each place is weighted by its distance, by the
//! similarity of its ratios in terms of their noise, and by the similarity of its light. Without noise, only
//! equal hues have a weight.

use crate::image::Image;
use crate::statistics::{MEDIAN_NORMAL, quantile};
use rayon::prelude::*;

/// A larger ratio is noise in the dark.
pub(super) const MOST: f32 = 64.0;
/// Places are taken so far away at most, pixels.
const REACH: usize = 3;
/// Standard deviation of their distance, pixels.
const NEAR: f64 = 2.0;
/// Standard deviations from which ratios belong to different objects.
const APART: f64 = 1.2;
/// And so is light whose logarithm differs by so much.
const OTHER_LIGHT: f64 = 0.4;
/// Values are never known more exactly than to this part of the mean light.
const FLOOR: f64 = 0.003;
/// Levels of light at which noise is estimated, alike in number of values.
const LEVELS: usize = 8;

/// The mixture of a frame, and its values.
type MixtureAndValues = (Image, Vec<Image>);

/// The ratios of each frame; `mean` is the mean of all mixtures.
pub(super) fn without_noise(frames: &[MixtureAndValues], mean: f64) -> Vec<Vec<Image>> {
    let floor = f64::max(FLOOR * mean, f64::MIN_POSITIVE);
    let noise = RatioNoise::new(frames, floor);
    let pilots: Vec<PilotRatios> =
        frames.par_iter().map(|frame| PilotRatios::new(frame, &noise, floor)).collect();
    (0..frames.len()).map(|l| denoise_frame(frames, &pilots, l)).collect()
}

/// Standard deviation of a value about its ratio's part of the mixture, for each value of an event pixel, at
/// levels of light.
struct RatioNoise {
    /// Rising levels of the mixture.
    light: Vec<f64>,
    /// [value][level]
    sigma: Vec<Vec<f64>>,
}

impl RatioNoise {
    /// The smaller of the differences between frames, in which most pixels stand still, and of second
    /// differences between pixels, where most hues are smooth.
    fn new(frames: &[MixtureAndValues], floor: f64) -> RatioNoise {
        let mut sorted: Vec<f32> = frames.iter().flat_map(|(mixture, _)| &mixture.values).copied().collect();
        sorted.sort_unstable_by(f32::total_cmp);
        let at = |share: f64| quantile(&sorted, share);
        let edges: Vec<f32> = (1..LEVELS).map(|n| at(n as f64 / LEVELS as f64)).collect();
        let light = (0..LEVELS).map(|n| f64::from(at((n as f64 + 0.5) / LEVELS as f64))).collect();
        let level = |light: f32| edges.partition_point(|edge| *edge <= light);
        let of_value = |n: usize| {
            let (mut changes, mut bends) = (vec![Vec::new(); LEVELS], vec![Vec::new(); LEVELS]);
            let apart =
                |(mixture, values): &MixtureAndValues, k: usize| values[n].values[k] - mixture.values[k];
            for (l, frame) in frames.iter().enumerate() {
                let mixture = &frame.0;
                for (k, light) in mixture.values.iter().enumerate() {
                    let (level, x) = (level(*light), k % mixture.width);
                    if let Some(before) = l.checked_sub(1).map(|before| &frames[before]) {
                        changes[level].push((apart(frame, k) - apart(before, k)).abs());
                    }
                    if x > 0 && x + 1 < mixture.width {
                        let (left, right) = (apart(frame, k - 1), apart(frame, k + 1));
                        bends[level].push((left - 2.0 * apart(frame, k) + right).abs());
                    }
                }
            }
            // The variance of a change is that of two values, of a bend that of six.
            let of = |of_values: f64, all: &mut Vec<f32>| median(all).map(|m| m / libm::sqrt(of_values));
            let sigma = |(changes, bends): (&mut Vec<f32>, &mut Vec<f32>)| {
                let least = of(2.0, changes).into_iter().chain(of(6.0, bends)).reduce(f64::min);
                f64::max(least.unwrap_or(0.0) / MEDIAN_NORMAL, floor)
            };
            changes.iter_mut().zip(&mut bends).map(sigma).collect()
        };
        let values = frames.first().map_or(0, |(_, values)| values.len());
        RatioNoise { light, sigma: (0..values).into_par_iter().map(of_value).collect() }
    }

    /// Of value `n` where the mixture is `light`: linear between levels.
    fn at(&self, n: usize, light: f64) -> f64 {
        let (levels, sigma) = (&self.light, &self.sigma[n]);
        let after = levels.partition_point(|level| *level <= light);
        match after {
            0 => sigma[0],
            n if n == levels.len() => sigma[n - 1],
            n => {
                let share = (light - levels[n - 1]) / (levels[n] - levels[n - 1]);
                sigma[n - 1] + share * (sigma[n] - sigma[n - 1])
            }
        }
    }
}

/// The median, without a sort: there are as many as values of all frames.
fn median(all: &mut [f32]) -> Option<f64> {
    let middle = all.len() / 2;
    (!all.is_empty()).then(|| f64::from(*all.select_nth_unstable_by(middle, f32::total_cmp).1))
}

/// Ratios over 3 x 3 pixels, and their standard deviations.
struct PilotRatios {
    log: Vec<f32>,
    /// [pixel][value]
    ratios: Vec<f32>,
    variances: Vec<f32>,
}

impl PilotRatios {
    fn new((mixture, values): &MixtureAndValues, noise: &RatioNoise, floor: f64) -> PilotRatios {
        let (width, height, count) = (mixture.width, mixture.height, values.len());
        let mut pilot = PilotRatios { log: Vec::new(), ratios: Vec::new(), variances: Vec::new() };
        for k in 0..width * height {
            let (x, y) = (k % width, k / width);
            let around = |image: &Image| -> (f64, f64) {
                let rows = y.saturating_sub(1)..usize::min(y + 2, height);
                let columns = x.saturating_sub(1)..usize::min(x + 2, width);
                let places = rows.flat_map(|y| columns.clone().map(move |x| y * width + x));
                places.fold((0.0, 0.0), |(sum, n), at| (sum + f64::from(image.values[at]), n + 1.0))
            };
            let (sum, places) = around(mixture);
            let light = f64::max(sum, places * floor);
            pilot.log.push(libm::log(light / places) as f32);
            for (n, value) in values.iter().enumerate() {
                pilot.ratios.push((around(value).0 / light) as f32);
                let sigma = APART * noise.at(n, light / places) * libm::sqrt(places) / light;
                pilot.variances.push((sigma * sigma * count as f64) as f32);
            }
        }
        pilot
    }
}

fn denoise_frame(frames: &[MixtureAndValues], pilots: &[PilotRatios], l: usize) -> Vec<Image> {
    let (own, values) = &frames[l];
    let (width, height, count) = (own.width, own.height, values.len());
    let ratio = |sum: f32, mixture: f32| if mixture > 0.0 { (sum / mixture).clamp(0.0, MOST) } else { 1.0 };
    let others = l.saturating_sub(1)..usize::min(l + 2, frames.len());
    let near: Vec<f32> = (0..=2 * REACH * REACH)
        .map(|square| libm::exp(-0.5 * square as f64 / (NEAR * NEAR)) as f32)
        .collect();
    let row = |y: usize| -> Vec<f32> {
        let mut line = vec![0.0; width * count];
        let mut sums = vec![0.0_f32; count];
        for x in 0..width {
            let k = y * width + x;
            let pilot = &pilots[l];
            let these = k * count..(k + 1) * count;
            let (ratios, variances) = (&pilot.ratios[these.clone()], &pilot.variances[these]);
            sums.fill(0.0);
            let mut mixture = 0.0_f32;
            for other in others.clone() {
                let (theirs, (their_mixture, their_values)) = (&pilots[other], &frames[other]);
                for row in y.saturating_sub(REACH)..usize::min(y + REACH + 1, height) {
                    for column in x.saturating_sub(REACH)..usize::min(x + REACH + 1, width) {
                        let at = row * width + column;
                        let mut apart = (theirs.log[at] - pilot.log[k]) / OTHER_LIGHT as f32;
                        apart *= apart;
                        for (n, (ratio, variance)) in ratios.iter().zip(variances).enumerate() {
                            let off = ratio - theirs.ratios[at * count + n];
                            apart += off * off / (variance + theirs.variances[at * count + n]);
                        }
                        let distance = (row.abs_diff(y)).pow(2) + (column.abs_diff(x)).pow(2);
                        let weight = near[distance] * libm::expf(-0.5 * apart);
                        mixture += weight * their_mixture.values[at];
                        sums.iter_mut()
                            .zip(their_values)
                            .for_each(|(sum, value)| *sum += weight * value.values[at]);
                    }
                }
            }
            let ratios = line.iter_mut().skip(x).step_by(width);
            ratios.zip(&sums).for_each(|(value, sum)| *value = ratio(*sum, mixture));
        }
        line
    };
    let rows: Vec<Vec<f32>> = (0..height).into_par_iter().map(row).collect();
    let image = |n: usize| Image {
        width,
        height,
        values: rows.iter().flat_map(|line| &line[n * width..(n + 1) * width]).copied().collect(),
    };
    (0..count).map(image).collect()
}
