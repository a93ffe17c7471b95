//! The ten families of the plan `field`: views as a camera outdoors or in a room has them, each a formula in
//! place and time.
//!
//! Edges are fifth-order steps whose derivative has a stated standard deviation, so that light is twice
//! differentiable in place and time. A view has two times: that of the clock, in which a hand shakes and a
//! surface swings, and the family's own, in which things travel and which a pace scales.

mod bodies;
mod motion;
mod picture;
mod surfaces;
#[cfg(test)]
mod tests;
mod wheels;

use crate::random::Random;
use crate::scene::Grid;
use crate::texture::Texture;
use bodies::{Crowd, Layers};
use motion::Motion;
use picture::Picture;
use serde_json::{Value, json};
use surfaces::{Fire, Warp, Water};
use wheels::{Fan, Wheel};

/// A view with its drawn parameters; lengths in pixels.
#[derive(Clone, Debug)]
pub enum View {
    /// A texture drifts and turns.
    Texture {
        texture: Texture,
        motion: Motion,
    },
    /// A picture with edges, before a camera in a hand.
    Photograph {
        picture: Picture,
        motion: Motion,
    },
    /// A star of bright and dark sectors turns before a texture.
    Star(Wheel),
    /// Blades of a fan turn before a photograph.
    Fan(Fan),
    /// Shapes in several depths pass before a texture.
    Layers(Layers),
    Water(Water),
    Fire(Fire),
    Crowd(Crowd),
    /// A photograph on a surface that swings.
    Warp(Warp),
    /// A page of text, in a hand.
    Text {
        picture: Picture,
        motion: Motion,
    },
}

/// 0 to 1 within about `sigma` of zero: the integral of a bump of standard deviation `sigma`, exactly 0 and 1
/// beyond 2.65 `sigma`.
fn edge(d: f64, sigma: f64) -> f64 {
    let u = (d / (2.645_751_311_064_590_7 * sigma)).clamp(-1.0, 1.0);
    0.5 + u * (15.0 - u * u * (10.0 - 3.0 * u * u)) / 16.0
}

/// Calls `value` for every place of the grid.
fn each(grid: &Grid, out: &mut [f64], value: impl Fn(f64, f64) -> f64) {
    for (row, values) in out.chunks_exact_mut(grid.columns).enumerate() {
        let y = grid.top + row as f64;
        for (column, v) in values.iter_mut().enumerate() {
            *v = value(grid.left + column as f64, y);
        }
    }
}

/// Keeps a texture's value within -1 and 1.
fn bounded(v: f64) -> f64 {
    v / libm::sqrt(1.0 + v * v)
}

impl View {
    pub const NAMES: [&'static str; 10] =
        ["texture", "photograph", "star", "fan", "layers", "water", "fire", "crowd", "warp", "text"];

    /// Draws a view by name for an array of that size. `sigma` is the softness of edges, pixels.
    pub fn draw(name: &str, random: &mut Random, [width, height]: [f64; 2], sigma: f64) -> Option<Self> {
        let size = [width, height];
        Some(match name {
            "texture" => {
                let texture = texture(random);
                Self::Texture { texture, motion: Motion::drift(random, size, 300.0, 4.0) }
            }
            "photograph" => {
                let picture = Picture::photograph(random, sigma);
                Self::Photograph { picture, motion: Motion::hand(random, size, [1.0, 8.0]) }
            }
            "star" => Self::Star(Wheel::draw(random, size, sigma)),
            "fan" => Self::Fan(Fan::draw(random, size, sigma)),
            "layers" => Self::Layers(Layers::draw(random, size, sigma)),
            "water" => Self::Water(Water::draw(random)),
            "fire" => Self::Fire(Fire::draw(random, size)),
            "crowd" => Self::Crowd(Crowd::draw(random, size, sigma)),
            "warp" => Self::Warp(Warp::draw(random, size, sigma)),
            "text" => {
                let picture = Picture::page(random, sigma);
                Self::Text { picture, motion: Motion::page(random, size) }
            }
            _ => return None,
        })
    }

    /// The pattern at `clock` (s), when the family's own time is `t`.
    pub fn pattern(&self, clock: f64, t: f64, grid: &Grid, out: &mut [f64]) {
        match self {
            Self::Texture { texture, motion } => {
                let at = motion.at(clock, t);
                each(grid, out, |x, y| {
                    let [u, v] = at.of(x, y);
                    bounded(texture.at(u, v))
                });
            }
            Self::Photograph { picture, motion } | Self::Text { picture, motion } => {
                let at = motion.at(clock, t);
                each(grid, out, |x, y| {
                    let [u, v] = at.of(x, y);
                    picture.at(u, v)
                });
            }
            Self::Star(wheel) => wheel.pattern(clock, t, grid, out),
            Self::Fan(fan) => fan.pattern(t, grid, out),
            Self::Layers(layers) => layers.pattern(t, grid, out),
            Self::Water(water) => water.pattern(t, grid, out),
            Self::Fire(fire) => fire.pattern(clock, t, grid, out),
            Self::Crowd(crowd) => crowd.pattern(t, grid, out),
            Self::Warp(warp) => warp.pattern(clock, t, grid, out),
        }
    }

    /// The numbers that say how the view moves, for the list of answers; speeds at that pace.
    pub fn answer(&self, pace: f64) -> Value {
        match self {
            Self::Texture { motion, .. } | Self::Photograph { motion, .. } | Self::Text { motion, .. } => {
                motion.answer(pace)
            }
            Self::Star(wheel) => wheel.answer(pace),
            Self::Fan(fan) => fan.answer(pace),
            Self::Layers(layers) => layers.answer(pace),
            Self::Water(water) => water.answer(pace),
            Self::Fire(fire) => fire.answer(pace),
            Self::Crowd(crowd) => crowd.answer(pace),
            Self::Warp(warp) => warp.answer(pace),
        }
    }
}

/// A texture of finer detail than those of the other plans.
fn texture(random: &mut Random) -> Texture {
    let (finest, slope) = (random.between(3.5, 7.0), random.between(1.1, 1.6));
    Texture::draw(random, finest, slope, 200)
}

/// Speeds in pixels a second at a pace.
fn speeds(of: impl IntoIterator<Item = f64>, pace: f64) -> Value {
    json!(of.into_iter().map(|speed| pace * speed).collect::<Vec<f64>>())
}
