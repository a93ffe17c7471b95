//! What scenes are made of: edges and stripes averaged over a pixel, places that move, random texture.
//!
//! Anti-aliasing is along the edge's normal: an edge covers a pixel from none to all while it moves by one
//! pixel. That is exact for edges along rows or columns and keeps the mean for all others (the ramp is a
//! little steeper than a slanted edge's own).

use photocurrent_core::random::Random;

/// How much of a pixel lies inside a shape, 0 to 1, from the signed distance of its centre to the outline,
/// pixels; positive is outside.
pub fn covered(distance: f64) -> f64 {
    (0.5 - distance).clamp(0.0, 1.0)
}

/// Mean over a pixel of stripes that are 1 on `[0, 1)` and 0 on `[1, 2)`, and so on. `at` is the pixel's
/// centre in stripes, `width` its size in stripes.
pub fn stripes(at: f64, width: f64) -> f64 {
    let whole = |to: f64| {
        let turns = (to / 2.0).floor();
        turns + (to - 2.0 * turns).min(1.0)
    };
    (whole(at + width / 2.0) - whole(at - width / 2.0)) / width
}

/// Distance from a place in stripes to the nearest border between two.
pub fn to_border(at: f64) -> f64 {
    let part = at - at.floor();
    part.min(1.0 - part)
}

/// `low` to `high` as `share` goes from 0 to 1.
pub fn blend(low: f64, high: f64, share: f64) -> f64 {
    low + (high - low) * share
}

/// A coordinate that runs on for ever, reflected between two walls.
pub fn bounce(at: f64, low: f64, high: f64) -> f64 {
    let span = high - low;
    let phase = (at - low).rem_euclid(2.0 * span);
    low + if phase > span { 2.0 * span - phase } else { phase }
}

/// (x, y) turned by an angle given as (sine, cosine); with `y` down, a positive angle is clockwise on the
/// screen.
pub fn turned((x, y): (f64, f64), (sine, cosine): (f64, f64)) -> (f64, f64) {
    (x * cosine - y * sine, x * sine + y * cosine)
}

/// When something that is `distance` pixels away can be here at the earliest. The distance that a pixel's own
/// half and its corner take is left out.
pub fn arrival(t_ns: i64, distance: f64, speed: f64) -> i64 {
    // The square pixel's filter is one pixel wide along any normal; a hundredth more is for rounding.
    let clear = distance - 0.51;
    if clear <= 0.0 {
        return t_ns;
    }
    let wait = clear / speed;
    // Beyond a hundred years it does not come.
    if wait > 3e18 { i64::MAX } else { t_ns.saturating_add(wait as i64) }
}

/// Distance from a place to a line from `a` to `b`, pixels.
pub fn to_line((x, y): (f64, f64), a: (f64, f64), b: (f64, f64)) -> f64 {
    let (along_x, along_y) = (b.0 - a.0, b.1 - a.1);
    let length = along_x * along_x + along_y * along_y;
    let share = if length == 0.0 {
        0.0
    } else {
        (((x - a.0) * along_x + (y - a.1) * along_y) / length).clamp(0.0, 1.0)
    };
    hypot(x - a.0 - share * along_x, y - a.1 - share * along_y)
}

/// Length of (x, y).
pub fn hypot(x: f64, y: f64) -> f64 {
    (x * x + y * y).sqrt()
}

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
    pub fn mixed(&self, other: &Texture, share: f64) -> Texture {
        let mix = |(own, other): (&f32, &f32)| {
            let log = blend(libm::log(f64::from(*own)), libm::log(f64::from(*other)), share);
            // Rounding to f32 must not leave the range of the two.
            (libm::exp(log) as f32).clamp(own.min(*other), own.max(*other))
        };
        Texture { nodes: self.nodes.iter().zip(&other.nodes).map(mix).collect() }
    }

    /// The value at any place, linear between whole pixels.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        let (left, top) = (whole(x), whole(y));
        let (fx, fy) = (x - left as f64, y - top as f64);
        let mask = Texture::SIDE - 1;
        let (column, row) = (left as usize & mask, top as usize & mask);
        let node = |dx: usize, dy: usize| {
            f64::from(self.nodes[((row + dy) & mask) * Texture::SIDE + ((column + dx) & mask)])
        };
        blend(blend(node(0, 0), node(1, 0), fx), blend(node(0, 1), node(1, 1), fx), fy)
    }
}

/// The largest whole number that is not above `at`: what `floor` gives for places of any scene, without the
/// call that it is on processors without SSE 4.1.
fn whole(at: f64) -> i64 {
    let towards_zero = at as i64;
    towards_zero - i64::from(towards_zero as f64 > at)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_numbers_below_a_place_are_its_floor() {
        for at in [-3.0, -2.5, -0.0, 0.0, 0.999, 1.0, 1e-300, -1e-300, 123_456.75, -123_456.75] {
            assert_eq!(whole(at), at.floor() as i64, "{at}");
        }
    }

    #[test]
    fn a_coordinate_bounces_between_its_walls() {
        assert_eq!([5.0, 12.0, 15.0, 21.0].map(|at| bounce(at, 2.0, 10.0)), [5.0, 8.0, 5.0, 5.0]);
    }

    #[test]
    fn averaging_over_a_pixel_keeps_the_mean_of_stripes() {
        for width in [0.05, 0.3, 1.0, 2.7] {
            let n = 4000;
            let mean =
                (0..n).map(|k| stripes(-3.0 + 8.0 * (f64::from(k) + 0.5) / f64::from(n), width)).sum::<f64>()
                    / f64::from(n);
            assert!((mean - 0.5).abs() < 1e-3, "{mean} at {width}");
        }
        // As wide as a whole period, nothing is left to see.
        assert!((stripes(0.77, 2.0) - 0.5).abs() < 1e-12);
        for (at, mean) in [(0.5, 1.0), (1.5, 0.0), (-0.5, 0.0), (1.0, 0.5)] {
            assert!((stripes(at, 0.2) - mean).abs() < 1e-12);
        }
    }

    #[test]
    fn a_disk_drawn_by_coverage_has_its_area() {
        let radius = 7.3;
        let area: f64 = (0..40)
            .flat_map(|y| {
                (0..40).map(move |x| covered(hypot(f64::from(x) - 19.2, f64::from(y) - 20.7) - radius))
            })
            .sum();
        // Coverage along the normal leaves out the outline's bend: pi / 12 of area in all.
        assert!((area - std::f64::consts::PI * radius * radius).abs() < 0.5, "{area}");
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

    #[test]
    fn what_is_far_needs_time() {
        assert_eq!(arrival(5, 0.3, 1e-6), 5);
        assert_eq!(arrival(5, 10.51, 1e-6), 5 + 10_000_000);
        assert_eq!(arrival(5, 10.0, 0.0), i64::MAX);
        assert_eq!(to_line((3.0, 4.0), (0.0, 0.0), (0.0, 2.0)), hypot(3.0, 2.0));
    }
}
