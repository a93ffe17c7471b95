//! Random surfaces: a texture in memory that repeats every 512 pixels, and unlimited noise that is computed
//! at every place.

use super::shapes::blend;
use photocurrent_core::random::Random;

/// A random surface that repeats every [`Texture::SIDE`] pixels and has the same contrast in every octave, as
/// natural pictures do (a 1/f spectrum).
pub struct Texture {
    nodes: Vec<f32>,
}

/// Spacing of the octaves' random grids, pixels: divisors of the side.
const OCTAVES: [usize; 6] = [64, 32, 16, 8, 4, 2];

impl Texture {
    /// Pixels after which the texture repeats; a power of two.
    pub const SIDE: usize = 512;

    /// A texture with reflectances from `low` to `high`, evenly spread in their logarithm.
    pub fn new(low: f64, high: f64, seed: u64, stream: u64) -> Texture {
        let side = Texture::SIDE;
        let mut sums = vec![0.0; side * side];
        for (octave, &spacing) in OCTAVES.iter().enumerate() {
            let cells = side / spacing;
            let mut random = Random::new(seed, &[stream, octave as u64]);
            let grid: Vec<f64> = (0..cells * cells).map(|_| random.uniform()).collect();
            // The finest octave lies at the limit of what pixels resolve and gets less weight.
            let weight = if spacing == 2 { 0.4 } else { 1.0 };
            let smooth = |part: usize| {
                let f = part as f64 / spacing as f64;
                f * f * (3.0 - 2.0 * f)
            };
            for (at, sum) in sums.iter_mut().enumerate() {
                let (x, y) = (at % side, at / side);
                let (fx, fy) = (smooth(x % spacing), smooth(y % spacing));
                let node = |dx: usize, dy: usize| {
                    grid[(y / spacing + dy) % cells * cells + (x / spacing + dx) % cells]
                };
                *sum +=
                    weight * blend(blend(node(0, 0), node(1, 0), fx), blend(node(0, 1), node(1, 1), fx), fy);
            }
        }
        let least = sums.iter().copied().fold(f64::INFINITY, f64::min);
        let most = sums.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let steepness = libm::log(high / low) / (most - least);
        // Rounding to f32 must not leave the range.
        let nodes = sums
            .iter()
            .map(|sum| (low * libm::exp((sum - least) * steepness)).clamp(low, high) as f32)
            .collect();
        Texture { nodes }
    }

    /// A texture between this (0) and another (1) in the logarithm.
    pub fn blend(&self, other: &Texture, share: f64) -> Texture {
        let mix = |(own, other): (&f32, &f32)| {
            let log = blend(libm::log(f64::from(*own)), libm::log(f64::from(*other)), share);
            // Rounding to f32 must not leave the range of the two.
            (libm::exp(log) as f32).clamp(own.min(*other), own.max(*other))
        };
        Texture { nodes: self.nodes.iter().zip(&other.nodes).map(mix).collect() }
    }

    /// The value at any place, linear between whole pixels.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        let (left, top) = (floor_to_integer(x), floor_to_integer(y));
        let (fx, fy) = (x - left as f64, y - top as f64);
        let mask = Texture::SIDE - 1;
        let (column, row) = (left as usize & mask, top as usize & mask);
        let node = |dx: usize, dy: usize| {
            f64::from(self.nodes[((row + dy) & mask) * Texture::SIDE + ((column + dx) & mask)])
        };
        blend(blend(node(0, 0), node(1, 0), fx), blend(node(0, 1), node(1, 1), fx), fy)
    }
}

/// The largest whole number not above `at`: `floor` for coordinates of scenes, without the function call that
/// it is on processors without SSE 4.1.
fn floor_to_integer(at: f64) -> i64 {
    let towards_zero = at as i64;
    towards_zero - i64::from(towards_zero as f64 > at)
}

/// A smooth random surface without end, between 0 and 1, of features of a size in pixels.
pub fn smooth_noise(seed: u64, x: f64, y: f64, size: f64) -> f64 {
    let (u, v) = (x / size, y / size);
    let (a, b) = (u.floor(), v.floor());
    let smooth = |s: f64| s * s * s * (s * (6.0 * s - 15.0) + 10.0);
    let (s, t) = (smooth(u - a), smooth(v - b));
    let corner =
        |da: i64, db: i64| Random::new(seed, &[(a as i64 + da) as u64, (b as i64 + db) as u64]).uniform();
    let (top, bottom) =
        (corner(0, 0) * (1.0 - s) + corner(1, 0) * s, corner(0, 1) * (1.0 - s) + corner(1, 1) * s);
    top * (1.0 - t) + bottom * t
}

/// [`smooth_noise`] of four sizes, whose mean power falls with frequency; about 0 to 1.
pub fn noise(seed: u64, x: f64, y: f64) -> f64 {
    const SIZES: [f64; 4] = [26.0, 11.0, 5.0, 2.4];
    const SHARES: [f64; 4] = [0.40, 0.30, 0.20, 0.10];
    (0..4)
        .map(|n| {
            let (u, v) = (x + 31.7 * n as f64, y - 17.3 * n as f64);
            SHARES[n] * smooth_noise(seed.wrapping_add(n as u64), u, v, SIZES[n])
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_numbers_below_a_place_are_its_floor() {
        for at in [-3.0, -2.5, -0.0, 0.0, 0.999, 1.0, 1e-300, -1e-300, 123_456.75, -123_456.75] {
            assert_eq!(floor_to_integer(at), at.floor() as i64, "{at}");
        }
    }

    #[test]
    fn texture_has_about_the_same_contrast_in_every_octave() {
        let texture = Texture::new(0.05, 0.8, 3, 1);
        // Variance of differences at distance d grows slowly for 1/f: by a third from one octave to the next.
        // The finest octave is left out: it has less weight, and pixels are linear.
        let spread = |d: f64| {
            let pairs = (0..4000).map(|k| (f64::from(k % 63) * 4.0, f64::from(k / 63) * 4.0));
            let squares: Vec<f64> = pairs
                .map(|(x, y)| libm::log(texture.at(x, y) / texture.at(x + d, y)))
                .map(|v| v * v)
                .collect();
            squares.iter().sum::<f64>() / squares.len() as f64
        };
        let growth = [4.0, 8.0, 16.0].map(|d| spread(2.0 * d) / spread(d));
        assert!(growth.iter().all(|growth| (1.1..1.6).contains(growth)), "{growth:?}");
    }
}
