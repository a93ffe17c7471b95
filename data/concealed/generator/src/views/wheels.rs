//! What turns: a star of sectors on a disc, and the blades of a fan.

use super::picture::Picture;
use super::{bounded, each, edge, texture};
use crate::random::Random;
use crate::scene::Grid;
use crate::texture::Texture;
use serde_json::{Value, json};
use std::f64::consts::PI;

/// A disc of bright and dark sectors whose centre sways.
#[derive(Clone, Debug)]
pub struct Wheel {
    /// Bright sectors, and as many dark ones.
    count: f64,
    centre: [f64; 2],
    radius: f64,
    omega: f64,
    /// Reach (px), frequency (Hz) and phase of the centre's swing.
    sway: [f64; 3],
    sigma: f64,
    ground: Texture,
}

/// A place as seen from a centre: distance, rounded within a fifth of a pixel, and angle.
fn polar(x: f64, y: f64, centre: [f64; 2]) -> [f64; 2] {
    let (dx, dy) = (x - centre[0], y - centre[1]);
    [libm::sqrt(dx * dx + dy * dy + 0.04), libm::atan2(dy, dx)]
}

impl Wheel {
    pub fn draw(random: &mut Random, [width, height]: [f64; 2], sigma: f64) -> Self {
        Self {
            count: (6 + random.below(11)) as f64,
            centre: [width * random.between(0.42, 0.58), height * random.between(0.42, 0.58)],
            radius: height * random.between(0.4, 0.52),
            omega: random.sign() * random.between(4.0, 9.0),
            sway: [random.between(0.3, 2.0), random.between(3.0, 9.0), random.between(0.0, 2.0 * PI)],
            sigma,
            ground: texture(random),
        }
    }

    pub fn pattern(&self, clock: f64, t: f64, grid: &Grid, out: &mut [f64]) {
        let [reach, hz, phase] = self.sway;
        let swing = reach * libm::sin(2.0 * PI * hz * clock + phase);
        let centre = [self.centre[0] + swing, self.centre[1] - 0.5 * swing];
        each(grid, out, |x, y| {
            let [r, angle] = polar(x, y, centre);
            let ground = 0.3 * bounded(self.ground.at(x, y));
            let inside = edge(self.radius - r, self.sigma);
            if inside == 0.0 {
                return ground;
            }
            // Times r / count: the distance to the nearest edge, so that edges are equally soft everywhere.
            let d = libm::sin(self.count * (angle - self.omega * t)) * r / self.count;
            // At the hub sectors are finer than pixels, and grey.
            let fine = edge(r - 0.35 * self.count, 0.1 * self.count);
            let sectors = 0.9 * fine * (2.0 * edge(d, self.sigma) - 1.0);
            inside * sectors + (1.0 - inside) * ground
        });
    }

    pub fn answer(&self, pace: f64) -> Value {
        json!({ "sectors": self.count, "omega_rad_s": self.omega * pace, "sway_px": self.sway[0],
                "sway_hz": self.sway[1] })
    }
}

/// Dark blades around a hub before a picture that drifts slowly.
#[derive(Clone, Debug)]
pub struct Fan {
    blades: f64,
    /// Half of a blade's share of its sector, radians of the sector's turn.
    half: f64,
    /// Radians a blade's middle lags behind a pixel further out.
    twist: f64,
    centre: [f64; 2],
    hub: f64,
    radius: f64,
    omega: f64,
    level: f64,
    sigma: f64,
    ground: Picture,
    drift: [f64; 2],
}

impl Fan {
    pub fn draw(random: &mut Random, [width, height]: [f64; 2], sigma: f64) -> Self {
        Self {
            blades: (3 + random.below(4)) as f64,
            half: PI * random.between(0.3, 0.55),
            twist: random.between(-0.03, 0.03),
            centre: [width * random.between(0.4, 0.6), height * random.between(0.4, 0.6)],
            hub: height * random.between(0.07, 0.11),
            radius: height * random.between(0.44, 0.58),
            omega: random.sign() * 2.0 * PI * random.between(3.0, 6.0),
            level: -random.between(0.6, 0.95),
            sigma,
            ground: Picture::photograph(random, sigma),
            drift: [random.between(-60.0, 60.0), random.between(-30.0, 30.0)],
        }
    }

    pub fn pattern(&self, t: f64, grid: &Grid, out: &mut [f64]) {
        let steep = libm::sin(self.half) * self.blades;
        let threshold = libm::cos(self.half);
        each(grid, out, |x, y| {
            let mut value = 0.3 + 0.7 * self.ground.at(x - self.drift[0] * t, y - self.drift[1] * t);
            let [r, angle] = polar(x, y, self.centre);
            let within = edge(self.radius - r, self.sigma);
            if within > 0.0 {
                let turn = libm::cos(self.blades * (angle - self.omega * t - self.twist * r));
                let blade = within * edge((turn - threshold) * r / steep, self.sigma);
                value += blade * (self.level + 0.15 * turn - value);
                let hub = edge(self.hub - r, self.sigma);
                value += hub * (-0.5 - value);
            }
            value
        });
    }

    pub fn answer(&self, pace: f64) -> Value {
        json!({ "blades": self.blades, "turns_per_s": self.omega * pace / (2.0 * PI),
                "ground_px_s": self.drift.map(|v| v * pace) })
    }
}
