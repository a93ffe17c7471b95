//! Bodies that cover each other: shapes in several depths, and people who walk.

use super::{bounded, each, edge, speeds, texture};
use crate::random::Random;
use crate::scene::Grid;
use crate::texture::Texture;
use serde_json::{Value, json};
use std::f64::consts::PI;

/// Shapes in several depths before a texture, nearer ones faster.
#[derive(Clone, Debug)]
pub struct Layers {
    ground: Texture,
    drift: [f64; 2],
    /// From far to near.
    layers: Vec<Layer>,
    sigma: f64,
}

#[derive(Clone, Debug)]
struct Layer {
    velocity: [f64; 2],
    skin: Texture,
    level: f64,
    /// Centre, half axes, direction, and whether it is a box.
    shapes: Vec<([f64; 2], [f64; 2], f64, bool)>,
}

impl Layers {
    pub fn draw(random: &mut Random, [width, height]: [f64; 2], sigma: f64) -> Self {
        let angle = random.between(0.0, 2.0 * PI);
        let count = 2 + random.below(2);
        let layers = (0..count)
            .map(|depth| {
                let speed = random.between(100.0, 180.0) * (1.0 + depth as f64);
                let angle = angle + random.between(-0.9, 0.9) + if random.chance(0.3) { PI } else { 0.0 };
                let shape = |random: &mut Random| {
                    let size = random.log_between(4.5, 13.0);
                    let place = [random.between(-25.0, width + 25.0), random.between(-25.0, height + 25.0)];
                    let sides = [size, (size * random.between(0.5, 1.0)).max(3.0)];
                    (place, sides, random.between(0.0, PI), random.chance(0.5))
                };
                Layer {
                    velocity: [speed * libm::cos(angle), speed * libm::sin(angle)],
                    skin: texture(random),
                    level: random.sign() * random.between(0.2, 0.7),
                    shapes: (0..8).map(|_| shape(random)).collect(),
                }
            })
            .collect();
        let drift = [random.between(-80.0, 80.0), random.between(-80.0, 80.0)];
        Self { ground: texture(random), drift, layers, sigma }
    }

    pub fn pattern(&self, t: f64, grid: &Grid, out: &mut [f64]) {
        each(grid, out, |x, y| {
            let mut value = 0.7 * bounded(self.ground.at(x - self.drift[0] * t, y - self.drift[1] * t));
            for layer in &self.layers {
                let (u, v) = (x - layer.velocity[0] * t, y - layer.velocity[1] * t);
                let open: f64 =
                    layer.shapes.iter().map(|shape| 1.0 - covers(shape, u, v, self.sigma)).product();
                if open < 1.0 {
                    let skin = layer.level + 0.4 * bounded(layer.skin.at(u, v));
                    value += (1.0 - open) * (skin - value);
                }
            }
            value
        });
    }

    pub fn answer(&self, pace: f64) -> Value {
        let of = |layer: &Layer| libm::sqrt(layer.velocity.iter().map(|v| v * v).sum::<f64>());
        json!({ "layers": self.layers.len(), "speed_px_s": speeds(self.layers.iter().map(of), pace),
                "ground_px_s": self.drift.map(|v| v * pace) })
    }
}

/// How much of a shape of a layer covers a point.
fn covers(
    (place, [a, b], angle, is_box): &([f64; 2], [f64; 2], f64, bool),
    x: f64,
    y: f64,
    sigma: f64,
) -> f64 {
    let (dx, dy) = (x - place[0], y - place[1]);
    if dx.abs().max(dy.abs()) > a + b + 3.0 * sigma {
        return 0.0;
    }
    let (sin, cos) = (libm::sin(*angle), libm::cos(*angle));
    let (u, v) = (cos * dx + sin * dy, cos * dy - sin * dx);
    if *is_box {
        edge(a - u.abs(), sigma) * edge(b - v.abs(), sigma)
    } else {
        let r = libm::sqrt(u * u / (a * a) + v * v / (b * b) + 1e-4);
        edge((1.0 - r) * 0.5 * (a + b), sigma)
    }
}

/// People who walk to and fro in a place, each at a pace of its own; nearer ones are larger and in front.
#[derive(Clone, Debug)]
pub struct Crowd {
    ground: Texture,
    /// How the camera follows, px/s of the nearest.
    pan: f64,
    /// From far to near.
    people: Vec<Person>,
    sigma: f64,
    width: f64,
}

#[derive(Clone, Debug)]
struct Person {
    tall: f64,
    /// Place of the feet at time 0.
    feet: [f64; 2],
    speed: f64,
    /// Strides a second, and where in a stride it is at time 0.
    stride: [f64; 2],
    /// Levels of head, arms, body and legs.
    levels: [f64; 4],
}

/// A limb: its ends, half its width, and its level.
type Limb = ([f64; 2], [f64; 2], f64, f64);

impl Crowd {
    /// Beyond the array on both sides, so that nobody appears from nowhere.
    const BEYOND: f64 = 30.0;

    pub fn draw(random: &mut Random, [width, height]: [f64; 2], sigma: f64) -> Self {
        let mut people: Vec<Person> = (0..28 + random.below(15))
            .map(|_| {
                let tall = height * random.log_between(0.15, 0.62);
                let speed = random.sign() * tall * random.between(4.0, 11.0);
                // A stride carries as far as the person is tall, or a little less.
                let stride = speed.abs() / (tall * random.between(0.75, 0.95));
                let dressed = random.sign() * random.between(0.2, 1.0);
                let legs = random.between(-1.0, 0.4);
                Person {
                    tall,
                    feet: [
                        random.between(-Self::BEYOND, width + Self::BEYOND),
                        height * (0.3 + random.between(-0.02, 0.02)) + 1.15 * tall,
                    ],
                    speed,
                    stride: [stride, random.unit()],
                    levels: [random.between(-0.3, 0.7), 0.8 * dressed, dressed, legs],
                }
            })
            .collect();
        people.sort_by(|a, b| a.tall.total_cmp(&b.tall));
        let pan = random.between(-150.0, 150.0);
        Self { ground: texture(random), pan, people, sigma, width }
    }

    pub fn pattern(&self, t: f64, grid: &Grid, out: &mut [f64]) {
        let shift = 0.3 * self.pan * t;
        each(grid, out, |x, y| 0.1 + 0.6 * bounded(self.ground.at(x + shift, y)));
        let tallest = self.people.last().map_or(1.0, |person| person.tall);
        for person in &self.people {
            let span = self.width + 2.0 * Self::BEYOND;
            let along = person.feet[0] + (person.speed - self.pan * (0.3 + 0.7 * person.tall / tallest)) * t;
            let x = (along + Self::BEYOND).rem_euclid(span) - Self::BEYOND;
            for limb in person.limbs(x, t) {
                paint(&limb, self.sigma, grid, out);
            }
        }
    }

    pub fn answer(&self, pace: f64) -> Value {
        let fastest = self.people.iter().map(|person| person.speed.abs()).fold(0.0, f64::max);
        let quickest = self.people.iter().map(|person| person.stride[0]).fold(0.0, f64::max);
        json!({ "people": self.people.len(), "fastest_px_s": fastest * pace,
                "most_strides_per_s": quickest * pace, "pan_px_s": self.pan * pace })
    }
}

impl Person {
    /// The limbs with the feet at `x`, from the far side to the near one.
    fn limbs(&self, x: f64, t: f64) -> [Limb; 6] {
        let (tall, way) = (self.tall, self.speed.signum());
        let turn = 2.0 * PI * (self.stride[0] * t + self.stride[1]);
        let swing = libm::sin(turn);
        // The body is highest where the legs pass each other.
        let lift = 0.02 * tall * libm::cos(2.0 * turn);
        let y = self.feet[1] - lift;
        let (hip, neck) = ([x, y - 0.48 * tall], [x + 0.02 * way * tall, y - 0.8 * tall]);
        let shoulder = [neck[0], neck[1] + 0.03 * tall];
        let hang = |from: [f64; 2], long: f64, angle: f64| {
            [from[0] + long * libm::sin(angle), from[1] + long * libm::cos(angle)]
        };
        let [head, arms, body, legs] = self.levels;
        let leg = |angle: f64, level: f64| (hip, hang(hip, 0.47 * tall, angle), 0.05 * tall, level);
        let arm =
            |angle: f64, level: f64| (shoulder, hang(shoulder, 0.36 * tall, angle), 0.035 * tall, level);
        let crown = [neck[0], neck[1] - 0.1 * tall];
        [
            arm(0.6 * swing, 0.8 * arms),
            leg(-0.5 * swing, 0.8 * legs),
            leg(0.5 * swing, legs),
            (hip, neck, 0.1 * tall, body),
            (crown, [crown[0], crown[1] - 0.03 * tall], 0.075 * tall, head),
            arm(-0.6 * swing, arms),
        ]
    }
}

/// Covers what is there with a limb, whose edges are soft.
fn paint(&(from, to, half, level): &Limb, sigma: f64, grid: &Grid, out: &mut [f64]) {
    let reach = half + 2.7 * sigma;
    let range = |low: f64, high: f64, origin: f64, count: usize| {
        let first = (low - reach - origin).ceil().max(0.0);
        let last = (high + reach - origin).floor().min(count as f64 - 1.0);
        first as usize..if last < first { first as usize } else { last as usize + 1 }
    };
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let square = dx * dx + dy * dy;
    for row in range(from[1].min(to[1]), from[1].max(to[1]), grid.top, grid.rows) {
        let v = grid.top + row as f64 - from[1];
        for column in range(from[0].min(to[0]), from[0].max(to[0]), grid.left, grid.columns) {
            let u = grid.left + column as f64 - from[0];
            let along = ((u * dx + v * dy) / square).clamp(0.0, 1.0);
            let (a, b) = (u - along * dx, v - along * dy);
            // Rounded at the middle line, where a distance has a ridge.
            let d = libm::sqrt(a * a + b * b + 0.1);
            let value = &mut out[row * grid.columns + column];
            *value += edge(half + 0.1 - d, sigma) * (level - *value);
        }
    }
}
