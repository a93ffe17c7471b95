//! A picture between its pixels: a cubic B-spline through all of them, widened where pixels of the photo are
//! closer together than those of the sensor.
//!
//! A photo's value is the mean over its pixel, so where the sensor's pixels are as large, a shifted photo is
//! what a smooth curve through the values says there. The cubic B-spline through them (Unser, Aldroubi and
//! Eden 1993) is that curve: twice smooth, so that motion makes no kinks and no events of its own, and off by
//! at most (TAU / wavelength)^4 / 360 of the amplitude for a wave of `wavelength` pixels: 0.1 percent at 8
//! pixels. Where the photo is shrunk, its pixels are `spacing` > 1 to one of the sensor; the kernel is then
//! widened by as much and normalised, which blurs away what the sensor's pixels could not resolve instead of
//! letting it alias. The width changes smoothly with the motion, as a filter with steps (a pyramid, a count
//! of samples) would not.
//!
//! The price: next to hard edges the curve overshoots by up to a tenth of the edge; a shrunk photo is softer
//! than a box average would make it.

/// What is seen beyond the border of the photo.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Outside {
    /// The photo again, mirrored at its outermost pixels.
    #[default]
    Mirror,
    /// The nearest place of the border.
    Hold,
}

/// A photo as a smooth function of the place.
pub struct Spline {
    width: usize,
    height: usize,
    coefficients: Vec<f32>,
    outside: Outside,
}

/// The pole of the filter that turns values into coefficients: sqrt(3) - 2.
const POLE: f64 = -0.267_949_192_431_122_7;

/// Pixels of the photo to one of the sensor, at most: the kernel reaches over four times as many in each
/// direction.
pub const WIDEST: f64 = 16.0;

/// Further than this many pixels, the filter has forgotten all but 1e-17.
const MEMORY: usize = 30;

impl Spline {
    /// Through `values`, row after row; the centre of the first pixel is at (0, 0).
    ///
    /// # Panics
    /// When there are not `width * height` values.
    pub fn new(width: usize, height: usize, mut values: Vec<f64>, outside: Outside) -> Spline {
        assert_eq!(values.len(), width * height, "a photo has a value for every pixel");
        for row in values.chunks_exact_mut(width) {
            to_coefficients(row);
        }
        let mut column = vec![0.0; height];
        for x in 0..width {
            (0..height).for_each(|y| column[y] = values[y * width + x]);
            to_coefficients(&mut column);
            (0..height).for_each(|y| values[y * width + x] = column[y]);
        }
        Spline {
            width,
            height,
            coefficients: values.into_iter().map(|value| value as f32).collect(),
            outside,
        }
    }

    /// Size of the photo in pixels: width, height.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// The value at a place, in pixels of the photo; `spacing` is how many of them are one of the sensor, and
    /// counts from 1 to [`WIDEST`].
    pub fn at(&self, x: f64, y: f64, spacing: f64) -> f64 {
        let spread = spacing.clamp(1.0, WIDEST);
        let (x, y) = match self.outside {
            Outside::Mirror => (x, y),
            Outside::Hold => (x.clamp(0.0, (self.width - 1) as f64), y.clamp(0.0, (self.height - 1) as f64)),
        };
        let reach = |at: f64| (at - 2.0 * spread).ceil() as i64..=(at + 2.0 * spread).floor() as i64;
        let mut across = [(0, 0.0); 4 * WIDEST as usize + 1];
        let mut taps = 0;
        let (mut weights_x, mut weights_y) = (0.0, 0.0);
        for i in reach(x) {
            across[taps] = (mirrored(i, self.width), kernel((i as f64 - x) / spread));
            weights_x += across[taps].1;
            taps += 1;
        }
        let mut sum = 0.0;
        for j in reach(y) {
            let weight = kernel((j as f64 - y) / spread);
            let row = &self.coefficients[mirrored(j, self.height) * self.width..][..self.width];
            sum += weight * across[..taps].iter().map(|(i, weight)| weight * f64::from(row[*i])).sum::<f64>();
            weights_y += weight;
        }
        sum / (weights_x * weights_y)
    }
}

/// The cubic B-spline: 2/3 in the middle, 0 from 2 on.
fn kernel(at: f64) -> f64 {
    let at = at.abs();
    if at < 1.0 {
        2.0 / 3.0 - at * at * (1.0 - 0.5 * at)
    } else if at < 2.0 {
        let left = 2.0 - at;
        left * left * left / 6.0
    } else {
        0.0
    }
}

/// The place of a pixel beyond the border, mirrored at the outermost pixels.
fn mirrored(at: i64, size: usize) -> usize {
    if (0..size as i64).contains(&at) {
        return at as usize;
    }
    if size == 1 {
        return 0;
    }
    let period = 2 * (size as i64 - 1);
    let at = at.rem_euclid(period);
    at.min(period - at) as usize
}

/// From values to the coefficients of the spline through them, mirrored at the ends: one pass forward, one
/// back.
fn to_coefficients(line: &mut [f64]) {
    let size = line.len();
    if size < 2 {
        return;
    }
    let mut power = 1.0;
    let mut start = 0.0;
    for k in 0..MEMORY {
        start += power * line[mirrored(k as i64, size)];
        power *= POLE;
    }
    line[0] = start;
    for k in 1..size {
        line[k] += POLE * line[k - 1];
    }
    line[size - 1] = POLE / (POLE * POLE - 1.0) * (line[size - 1] + POLE * line[size - 2]);
    for k in (0..size - 1).rev() {
        line[k] = POLE * (line[k + 1] - line[k]);
    }
    line.iter_mut().for_each(|value| *value *= 6.0);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// Values between 0 and 1 without any order.
    fn noise(width: usize, height: usize) -> Vec<f64> {
        (0..width * height)
            .map(|k| ((k as u32).wrapping_mul(2_654_435_761) >> 8) as f64 / f64::from(1 << 24))
            .collect()
    }

    #[test]
    fn the_curve_passes_through_every_value() {
        for (width, height) in [(9, 7), (2, 3), (1, 4), (1, 1), (40, 1)] {
            let values = noise(width, height);
            let photo = Spline::new(width, height, values.clone(), Outside::Mirror);
            for (k, value) in values.iter().enumerate() {
                let found = photo.at((k % width) as f64, (k / width) as f64, 1.0);
                assert!((found - value).abs() < 1e-6, "{width} x {height}, {k}: {found}, {value} expected");
            }
        }
    }

    #[test]
    fn between_pixels_a_wave_is_off_by_its_fourth_power() {
        for wavelength in [8.0, 12.0, 24.0] {
            let wave = |x: f64| 0.5 + 0.4 * libm::sin(TAU * x / wavelength);
            let photo = Spline::new(96, 1, (0..96).map(|x| wave(f64::from(x))).collect(), Outside::Mirror);
            // Mirroring breaks the wave's slope at the ends; that is forgotten within some pixels.
            let worst = (0..600)
                .map(|k| 18.0 + f64::from(k) * 0.1)
                .map(|x| (photo.at(x, 0.0, 1.0) - wave(x)).abs())
                .fold(0.0, f64::max);
            // A wave loses (w / TAU)^4 times the sum of 1 / k^4 over all whole k but 0, which is w^4 / 720,
            // and its aliases together are as strong.
            let bound = 0.4 * libm::pow(TAU / wavelength, 4.0) / 360.0;
            assert!((0.9..1.05).contains(&(worst / bound)), "{worst} at {wavelength}, {bound} expected");
        }
    }

    #[test]
    fn a_constant_stays_one_however_wide_the_kernel() {
        let photo = Spline::new(20, 20, vec![0.3; 400], Outside::Hold);
        for spacing in [0.2, 1.0, 1.7, 3.3, 8.0] {
            for at in [-7.0, 0.0, 3.3, 9.9, 40.0] {
                assert!((photo.at(at, 0.7 * at, spacing) - 0.3).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn what_the_sensors_pixels_cannot_resolve_becomes_grey() {
        // Stripes of one pixel: the finest there are. Seen at one sensor pixel for two of the photo they are
        // beyond its limit.
        let photo = Spline::new(64, 64, (0..64 * 64).map(|k| f64::from(k % 2)).collect(), Outside::Mirror);
        let contrast = |spacing: f64| {
            let seen: Vec<f64> =
                (0..40).map(|k| photo.at(20.0 + 0.37 * f64::from(k), 30.0, spacing)).collect();
            seen.iter().fold(0.0, |most: f64, v| most.max(*v))
                - seen.iter().fold(1.0, |least: f64, v| least.min(*v))
        };
        assert!(
            contrast(1.0) > 0.98 && contrast(2.0) < 0.05 && contrast(4.0) < 0.01,
            "{} {} {}",
            contrast(1.0),
            contrast(2.0),
            contrast(4.0)
        );
        // And it gets there without a step.
        let steps: Vec<f64> = (0..=200).map(|k| photo.at(20.1, 30.0, 1.0 + 0.01 * f64::from(k))).collect();
        assert!(steps.windows(2).all(|pair| (pair[1] - pair[0]).abs() < 0.02));
    }

    #[test]
    fn beyond_the_border_the_photo_is_mirrored_or_held() {
        let values = noise(12, 10);
        let (mirror, hold) = (
            Spline::new(12, 10, values.clone(), Outside::Mirror),
            Spline::new(12, 10, values, Outside::Hold),
        );
        for (outside, inside) in [
            ((-3.25, 4.5), (3.25, 4.5)),
            ((11.0 + 2.6, 4.5), (11.0 - 2.6, 4.5)),
            ((5.0, -7.75), (5.0, 7.75)),
            ((5.5 + 22.0, 1.0), (5.5, 1.0)),
        ] {
            assert!(
                (mirror.at(outside.0, outside.1, 1.0) - mirror.at(inside.0, inside.1, 1.0)).abs() < 1e-9,
                "{outside:?}"
            );
        }
        for (outside, border) in
            [((-3.25, 4.5), (0.0, 4.5)), ((99.0, 4.5), (11.0, 4.5)), ((5.0, 9.5), (5.0, 9.0))]
        {
            assert_eq!(hold.at(outside.0, outside.1, 1.0), hold.at(border.0, border.1, 1.0), "{outside:?}");
        }
    }
}
