//! Pictures with edges: a photograph of overlapping shapes over a texture, and a page of text.
//!
//! A picture is a cubic B-spline over a lattice of half a pixel, periodic in 128 pixels. The spline alone
//! softens by 0.29 px; shapes are painted with what is missing to the wanted softness.

use super::{bounded, edge, texture};
use crate::random::Random;
use crate::texture::{Texture, weights};
use std::f64::consts::PI;

const SIDE: usize = 256;
/// Lattice points a pixel.
const FINE: f64 = 2.0;
/// Variance of a cubic B-spline, in px^2: a third of the square of its spacing.
const SPLINE: f64 = 1.0 / (3.0 * FINE * FINE);

#[derive(Clone, Debug)]
pub struct Picture(Vec<f64>);

/// A shape to be painted, around its own centre.
#[derive(Clone, Copy, Debug)]
enum Shape {
    /// Half axes and direction.
    Ellipse([f64; 2], f64),
    /// Half sides and direction.
    Box([f64; 2], f64),
    /// A stroke: vector from its start to its end, and half its width.
    Stroke([f64; 2], f64),
    /// A circle's line: radius, and half its width.
    Ring(f64, f64),
}

impl Shape {
    /// How much of the shape covers a point, with edges of `sigma`.
    fn covers(self, x: f64, y: f64, sigma: f64) -> f64 {
        let turned = |angle: f64| {
            let (sin, cos) = (libm::sin(angle), libm::cos(angle));
            [cos * x + sin * y, cos * y - sin * x]
        };
        match self {
            Self::Ellipse([a, b], angle) => {
                let [u, v] = turned(angle);
                let r = libm::sqrt(u * u / (a * a) + v * v / (b * b));
                // Distance to first order: (1 - r) over the gradient of r.
                let gradient = libm::sqrt(u * u / (a * a * a * a) + v * v / (b * b * b * b)) / r.max(1e-9);
                edge((1.0 - r) / gradient.max(1e-3), sigma)
            }
            Self::Box([a, b], angle) => {
                let [u, v] = turned(angle);
                edge(a - u.abs(), sigma) * edge(b - v.abs(), sigma)
            }
            Self::Stroke([dx, dy], half) => {
                let along = ((x * dx + y * dy) / (dx * dx + dy * dy)).clamp(0.0, 1.0);
                let (u, v) = (x - along * dx, y - along * dy);
                edge(half - libm::sqrt(u * u + v * v), sigma)
            }
            Self::Ring(radius, half) => edge(half - (libm::sqrt(x * x + y * y) - radius).abs(), sigma),
        }
    }

    /// No point further from the centre than this is covered, but for edges.
    fn reach(self) -> f64 {
        match self {
            Self::Ellipse([a, b], _) => a.max(b),
            Self::Box([a, b], _) => a + b,
            Self::Stroke([dx, dy], half) => dx.abs() + dy.abs() + half,
            Self::Ring(radius, half) => radius + half,
        }
    }
}

impl Picture {
    fn of(texture: &Texture, level: f64, share: f64) -> Self {
        let place = |n: usize| n as f64 / FINE;
        Self(
            (0..SIDE * SIDE)
                .map(|n| level + share * bounded(texture.at(place(n % SIDE), place(n / SIDE))))
                .collect(),
        )
    }

    /// Paints a shape at (x, y); `level` gives what it shows at a distance from there.
    fn paint(&mut self, [x, y]: [f64; 2], shape: Shape, sigma: f64, level: impl Fn(f64, f64) -> f64) {
        let reach = shape.reach() + 3.0 * sigma;
        let range = |at: f64| {
            let (from, to) = ((FINE * (at - reach)).ceil() as i64, (FINE * (at + reach)).floor() as i64);
            from..=to.min(from + SIDE as i64 - 1)
        };
        let wrap = |n: i64| n.rem_euclid(SIDE as i64) as usize;
        for row in range(y) {
            for column in range(x) {
                let (u, v) = (column as f64 / FINE - x, row as f64 / FINE - y);
                let cover = shape.covers(u, v, sigma);
                if cover > 0.0 {
                    let value = &mut self.0[wrap(row) * SIDE + wrap(column)];
                    *value += cover * (level(u, v) - *value);
                }
            }
        }
    }

    /// What is missing to edges of `sigma` in the picture.
    fn painted(sigma: f64) -> f64 {
        libm::sqrt((sigma * sigma - SPLINE).max(0.01))
    }

    /// Shapes of all sizes cover each other, as leaves do, over a texture whose amplitudes fall as a power of
    /// frequency.
    pub fn photograph(random: &mut Random, sigma: f64) -> Self {
        let grain = texture(random);
        let mut picture = Self::of(&grain, 0.0, 0.8);
        let sigma = Self::painted(sigma);
        for _ in 0..110 {
            // Numbers fall with the cube of size: each size covers as much as any other.
            let size = 2.0 / libm::sqrt(random.between(0.012, 1.0));
            let (aspect, angle) = (random.between(0.4, 1.0), random.between(0.0, PI));
            let sides = [size, (aspect * size).max(1.5)];
            let shape =
                if random.chance(0.5) { Shape::Ellipse(sides, angle) } else { Shape::Box(sides, angle) };
            let place = [random.between(0.0, 128.0), random.between(0.0, 128.0)];
            let level = random.between(-0.9, 0.9);
            let shade = [random.between(-0.3, 0.3) / size, random.between(-0.3, 0.3) / size];
            let rough = random.between(0.0, 0.3);
            picture.paint(place, shape, sigma, |u, v| {
                level + shade[0] * u + shade[1] * v + rough * bounded(grain.at(place[1] + u, place[0] + v))
            });
        }
        picture
    }

    /// Lines of words: dark strokes on paper.
    pub fn page(random: &mut Random, sigma: f64) -> Self {
        let mut picture = Self::of(&texture(random), 0.75, 0.06);
        let sigma = Self::painted(sigma);
        let lines = 9 + random.below(5);
        let pitch = 128.0 / lines as f64;
        let tall = 0.62 * pitch;
        let half = (0.075 * tall).max(0.45);
        let glyphs: Vec<Vec<([f64; 2], Shape)>> = (0..16).map(|_| glyph(random, tall, half)).collect();
        for line in 0..lines {
            let mut x = 0.0;
            while x < 126.0 - 0.6 * tall {
                if random.chance(0.17) {
                    x += 0.5 * tall;
                }
                let y = (line as f64 + 0.2) * pitch;
                for (place, shape) in &glyphs[random.below(glyphs.len())] {
                    picture.paint([x + place[0], y + place[1]], *shape, sigma, |_, _| -0.9);
                }
                x += 0.75 * tall;
            }
        }
        picture
    }

    /// The picture at a point; any finite coordinates, pixels.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        let (x, y) = (FINE * x, FINE * y);
        let (left, top) = (x.floor(), y.floor());
        let (wx, wy) = (weights(x - left), weights(y - top));
        let wrap = |n: f64, k: i64| (n as i64 + k - 1).rem_euclid(SIDE as i64) as usize;
        let columns = [0, 1, 2, 3].map(|k| wrap(left, k));
        let mut sum = 0.0;
        for (k, w) in wy.iter().enumerate() {
            let row = &self.0[wrap(top, k as i64) * SIDE..][..SIDE];
            sum += w
                * (wx[0] * row[columns[0]]
                    + wx[1] * row[columns[1]]
                    + wx[2] * row[columns[2]]
                    + wx[3] * row[columns[3]]);
        }
        sum
    }
}

/// A letter of no alphabet: three or four strokes between points of a grid of 3 x 4, one of them a ring
/// now and then.
fn glyph(random: &mut Random, tall: f64, half: f64) -> Vec<([f64; 2], Shape)> {
    let point =
        |random: &mut Random| [0.26 * tall * random.below(3) as f64, tall / 3.0 * random.below(4) as f64];
    let mut strokes = Vec::new();
    if random.chance(0.4) {
        let radius = 0.24 * tall;
        let centre = [radius, if random.chance(0.5) { radius } else { tall - radius }];
        strokes.push((centre, Shape::Ring(radius, half)));
    }
    for _ in 0..3 {
        let (from, mut to) = (point(random), point(random));
        if from == to {
            to = [from[0], if from[1] > 0.5 * tall { 0.0 } else { tall }];
        }
        strokes.push((from, Shape::Stroke([to[0] - from[0], to[1] - from[1]], half)));
    }
    strokes
}
