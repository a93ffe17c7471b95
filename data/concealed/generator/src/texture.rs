//! A smooth random picture on a torus whose amplitudes fall as a power of the spatial frequency, as those of
//! natural pictures do.
//!
//! The picture is a cubic B-spline: twice differentiable everywhere, so that light at a moving point has no
//! kinks in time.

use crate::random::Random;
use std::f64::consts::PI;

const SIZE: usize = 128;

/// A picture; it repeats every 128 pixels in both directions.
#[derive(Clone, Debug)]
pub struct Texture(Vec<f64>);

impl Texture {
    /// Draws `waves` plane waves with wavelengths of `finest` pixels and more and amplitudes `|k|^-slope`;
    /// mean 0, variance 1.
    pub fn draw(random: &mut Random, finest: f64, slope: f64, waves: usize) -> Self {
        let most = SIZE as f64 / finest;
        let mut picture = vec![0.0; SIZE * SIZE];
        let table: Vec<f64> = (0..SIZE).map(|n| libm::cos(2.0 * PI * n as f64 / SIZE as f64)).collect();
        for _ in 0..waves {
            // The length is uniform in its logarithm: every octave gets as many waves.
            let length = random.log_between(1.0, most);
            let angle = random.between(0.0, PI);
            let (kx, ky) =
                ((length * libm::cos(angle)).round() as i64, (length * libm::sin(angle)).round() as i64);
            let k2 = (kx * kx + ky * ky) as f64;
            if k2 == 0.0 {
                continue;
            }
            // A ring of |k| holds 2 pi |k| d|k| modes, and a draw per octave |k| d ln|k|: one factor |k| is
            // in the draw already.
            let amplitude = libm::pow(k2, -0.5 * (slope - 1.0));
            let phase = random.below(SIZE) as i64;
            for (y, row) in picture.chunks_exact_mut(SIZE).enumerate() {
                for (x, value) in row.iter_mut().enumerate() {
                    *value += amplitude
                        * table[(kx * x as i64 + ky * y as i64 + phase).rem_euclid(SIZE as i64) as usize];
                }
            }
        }
        let variance = picture.iter().map(|v| v * v).sum::<f64>() / picture.len() as f64;
        let scale = 1.0 / libm::sqrt(variance);
        Self(picture.into_iter().map(|v| v * scale).collect())
    }

    /// The picture at a point; any finite coordinates.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        let (left, top) = (x.floor(), y.floor());
        let (wx, wy) = (weights(x - left), weights(y - top));
        let wrap = |n: f64, k: usize| (n as i64 + k as i64 - 1).rem_euclid(SIZE as i64) as usize;
        let columns = [wrap(left, 0), wrap(left, 1), wrap(left, 2), wrap(left, 3)];
        let mut sum = 0.0;
        for (k, w) in wy.iter().enumerate() {
            let row = &self.0[wrap(top, k) * SIZE..][..SIZE];
            sum += w
                * (wx[0] * row[columns[0]]
                    + wx[1] * row[columns[1]]
                    + wx[2] * row[columns[2]]
                    + wx[3] * row[columns[3]]);
        }
        sum
    }
}

/// The four weights of a uniform cubic B-spline at `u` in 0 .. 1.
pub fn weights(u: f64) -> [f64; 4] {
    let v = 1.0 - u;
    [
        v * v * v / 6.0,
        (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0,
        (4.0 - 6.0 * v * v + 3.0 * v * v * v) / 6.0,
        u * u * u / 6.0,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_picture_repeats_and_has_no_kink_at_a_lattice_line() {
        let texture = Texture::draw(&mut Random::named("texture"), 6.0, 1.5, 150);
        assert!((texture.at(3.25, 90.5) - texture.at(3.25 - 128.0, 90.5 + 256.0)).abs() < 1e-12);
        // The one-sided differences of a curve without kink agree to second order in the step.
        let h = 1e-4;
        let right = (texture.at(10.0 + h, 7.3) - texture.at(10.0, 7.3)) / h;
        let left = (texture.at(10.0, 7.3) - texture.at(10.0 - h, 7.3)) / h;
        assert!((right - left).abs() < 1e-3, "{right} {left}");
        assert!(right.abs() > 1e-3, "the place tells a kink from none: {right}");
    }

    #[test]
    fn constants_are_kept() {
        for u in [0.0, 0.3, 0.999] {
            assert!((weights(u).iter().sum::<f64>() - 1.0).abs() < 1e-15);
        }
    }
}
