//! Scenes and sensors simulated for training: a drifting or shaken texture, a turning star, discs that fly
//! over a slow texture, a photograph that shakes, zooms and turns, a layer that moves before another one, a
//! fan, a walking figure, a thrown ball, the last three before a still ground; light, speed, thresholds, time
//! constants, reset rules, exposures and stamps over the ranges of cameras that such recordings are made
//! with.
//!
//! Everything follows from a seed. Light is analytic in place and time, so its size, length and number of
//! pixels can be anything. Limits: grey, no flicker, no noise of the light; objects are opaque and bright or
//! dark.

use crate::candidates::Trial;
use crate::curves::Curves;
use crate::record::{Conditions, record};
use crate::sample::Sample;
use photocurrent_core::quantity::Duration;
use photocurrent_core::random::Random;
use photocurrent_core::sensor::Reset;
use photocurrent_core::{Exposure, Extent, FrameTimes, Sensor};
use photocurrent_scene::case::{Case, CaseFrames, PixelEvents};
use rayon::prelude::*;

/// What moves.
#[derive(Clone, Debug)]
enum Motion {
    /// A texture at a velocity, px/s, shaken with an amplitude, px, at a frequency, Hz.
    Texture { velocity: (f64, f64), shake_px: f64, shake_hz: f64 },
    /// Spokes that turn, and how fast, rad/s, around a centre.
    Star { spokes: f64, rate: f64, centre: (f64, f64) },
    /// Discs of a radius and shade (0 to 1) at a velocity, over a texture that drifts.
    Discs { radius: f64, shade: f64, velocity: (f64, f64), pitch: f64, drift: (f64, f64) },
    /// A texture with edges, shaken, turned and zoomed around the middle: amplitudes in px, rad and as a
    /// share, each with its frequency, Hz, and a drift, px/s.
    Photograph { shake: (f64, f64), turn: (f64, f64), zoom: (f64, f64), drift: (f64, f64) },
    /// Shapes of a size, px, with a texture of their own at a velocity, px/s, before a texture at another.
    Layers { size: f64, front: (f64, f64), back: (f64, f64) },
    /// Blades that turn, rad/s, within a radius around a centre before a still texture; half the angle of a
    /// blade.
    Fan { blades: f64, rate: f64, centre: (f64, f64), radius: f64, half: f64, shade: f64 },
    /// A figure of a height, px, that walks, px/s, so many steps a second, from a place on.
    Figure { height: f64, speed: f64, steps_hz: f64, begin: (f64, f64), shade: f64 },
    /// A ball of a radius with a texture, from a place with a velocity, px/s, falling, px/s^2, and turning,
    /// rad/s.
    Ball { radius: f64, begin: (f64, f64), velocity: (f64, f64), fall: f64, rate: f64 },
}

impl Motion {
    /// In a word.
    fn name(&self) -> &'static str {
        match self {
            Motion::Texture { .. } => "texture",
            Motion::Star { .. } => "star",
            Motion::Discs { .. } => "discs",
            Motion::Photograph { .. } => "photograph",
            Motion::Layers { .. } => "layers",
            Motion::Fan { .. } => "fan",
            Motion::Figure { .. } => "figure",
            Motion::Ball { .. } => "ball",
        }
    }
}

/// A simulated scene before a simulated sensor.
#[derive(Clone, Debug)]
pub struct MadeUp {
    motion: Motion,
    low: f64,
    high: f64,
    seed: u64,
    contrast: f64,
    /// Width of edges, pixels, on either side.
    edge: f64,
    sensor: Sensor,
    exposures: Vec<Exposure>,
    resolution_ns: i64,
    extent: Extent,
    span: (i64, i64),
    /// Electrons a digital number, and read noise, DN, of frames; nobody states it.
    noise: Option<(f64, f64)>,
    /// Noise of thresholds that nobody states, natural-log units.
    unstated_noise: f64,
    /// Light is taken this often, ns.
    step_ns: i64,
}

/// A smooth random surface between 0 and 1, of features of a size in pixels.
fn surface(seed: u64, x: f64, y: f64, size: f64) -> f64 {
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

/// A texture of mean power falling with frequency, about 0 to 1.
fn texture(seed: u64, x: f64, y: f64) -> f64 {
    const SIZES: [f64; 4] = [26.0, 11.0, 5.0, 2.4];
    const SHARES: [f64; 4] = [0.40, 0.30, 0.20, 0.10];
    (0..4)
        .map(|n| {
            SHARES[n]
                * surface(seed.wrapping_add(n as u64), x + 31.7 * n as f64, y - 17.3 * n as f64, SIZES[n])
        })
        .sum()
}

/// Distance of a place from a line between two others.
fn from_line(at: (f64, f64), a: (f64, f64), b: (f64, f64)) -> f64 {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let along = (((at.0 - a.0) * dx + (at.1 - a.1) * dy) / f64::max(dx * dx + dy * dy, 1e-9)).clamp(0.0, 1.0);
    libm::hypot(at.0 - a.0 - along * dx, at.1 - a.1 - along * dy)
}

/// What a scene is drawn from, and what is drawn before all else.
struct Draws {
    random: Random,
    /// Which motion it is, 0 to 1.
    kind: f64,
    /// Direction, rad.
    angle: f64,
    /// Sense, -1 or 1.
    sign: f64,
    /// Of the array, pixels.
    width: f64,
    height: f64,
}

impl Draws {
    fn new(seed: u64, index: u64, extent: Extent) -> Draws {
        let mut random = Random::new(seed, &[index, 77]);
        let mut between = |low: f64, high: f64| low + (high - low) * random.uniform();
        let kind = between(0.0, 1.0);
        let angle = between(0.0, std::f64::consts::TAU);
        let sign = if between(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
        let (width, height) = (f64::from(extent.width), f64::from(extent.height));
        Draws { random, kind, angle, sign, width, height }
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.random.uniform()
    }

    /// What moves; `ends` as in [`MadeUp::of`].
    fn motion(&mut self, ends: [f64; 7]) -> Motion {
        match ends.iter().position(|end| self.kind < *end) {
            Some(0) => self.texture(),
            Some(1) => self.star(),
            Some(2) => self.photograph(),
            Some(3) => self.layers(),
            Some(4) => self.fan(),
            Some(5) => self.figure(),
            Some(6) => self.ball(),
            _ => self.discs(),
        }
    }

    /// A texture that drifts and shakes.
    fn texture(&mut self) -> Motion {
        let Draws { angle, .. } = *self;
        let speed = self.between(400.0, 1200.0);
        Motion::Texture {
            velocity: (speed * libm::cos(angle), speed * libm::sin(angle)),
            shake_px: self.between(0.5, 3.0),
            shake_hz: self.between(5.0, 15.0),
        }
    }

    /// A star that turns.
    fn star(&mut self) -> Motion {
        let Draws { sign, width, height, .. } = *self;
        let rate = sign * self.between(1.5, 5.5) * std::f64::consts::TAU;
        let centre = (0.5 * width + self.between(-5.0, 5.0), 0.5 * height + self.between(-5.0, 5.0));
        Motion::Star { spokes: self.between(3.0, 6.0).floor(), rate, centre }
    }

    /// A photograph that shakes, zooms and turns.
    fn photograph(&mut self) -> Motion {
        let Draws { angle, sign, .. } = *self;
        let (share, hz) = (self.between(0.0, 1.0), self.between(3.0, 12.0));
        let speed = self.between(100.0, 700.0);
        Motion::Photograph {
            shake: (self.between(1.0, 8.0), hz),
            turn: (sign * self.between(0.02, 0.2), self.between(2.0, 8.0)),
            zoom: (self.between(0.02, 0.12), self.between(2.0, 6.0)),
            drift: (share * speed * libm::cos(angle), share * speed * libm::sin(angle)),
        }
    }

    /// Shapes before a texture.
    fn layers(&mut self) -> Motion {
        let Draws { angle, .. } = *self;
        let (front, back, turn) =
            (self.between(300.0, 1200.0), self.between(50.0, 500.0), self.between(0.5, 5.0));
        let along = |speed: f64, angle: f64| (speed * libm::cos(angle), speed * libm::sin(angle));
        Motion::Layers {
            size: self.between(12.0, 24.0),
            front: along(front, angle),
            back: along(back, angle + turn),
        }
    }

    /// A fan.
    fn fan(&mut self) -> Motion {
        let Draws { angle, sign, width, height, .. } = *self;
        let centre = (0.5 * width + self.between(-5.0, 5.0), 0.5 * height + self.between(-5.0, 5.0));
        let (blades, rate, radius) = (
            self.between(2.0, 6.0).floor(),
            sign * self.between(1.0, 9.0) * std::f64::consts::TAU,
            height * self.between(0.35, 0.6),
        );
        Motion::Fan {
            blades,
            rate,
            centre,
            radius,
            half: self.between(0.2, 0.45) * std::f64::consts::TAU / blades / 2.0,
            shade: if angle < 3.0 { 0.0 } else { 0.95 },
        }
    }

    /// A walking figure.
    fn figure(&mut self) -> Motion {
        let Draws { angle, sign, width, height, .. } = *self;
        let tall = height * self.between(0.5, 0.9);
        let begin = (width * self.between(0.2, 0.8), 0.5 * height + self.between(-3.0, 3.0));
        Motion::Figure {
            height: tall,
            speed: sign * self.between(60.0, 400.0),
            steps_hz: self.between(1.5, 5.0),
            begin,
            shade: if angle < 4.0 { 0.0 } else { 0.95 },
        }
    }

    /// A thrown ball.
    fn ball(&mut self) -> Motion {
        let Draws { sign, width, height, .. } = *self;
        let (radius, speed) = (height * self.between(0.12, 0.25), self.between(200.0, 900.0));
        let begin = (0.5 * width - 0.3 * sign * width, height * self.between(0.35, 0.7));
        Motion::Ball {
            radius,
            begin,
            velocity: (sign * speed, -self.between(0.0, 300.0)),
            fall: self.between(500.0, 4000.0),
            rate: sign * self.between(0.0, 25.0),
        }
    }

    /// Discs that fly over a texture.
    fn discs(&mut self) -> Motion {
        let Draws { angle, sign, .. } = *self;
        let (speed, drift) = (self.between(700.0, 2300.0), self.between(80.0, 180.0));
        let shade = if sign > 0.0 { 1.1 } else { -0.05 };
        let velocity = (speed * libm::cos(angle), speed * libm::sin(angle));
        Motion::Discs {
            radius: self.between(2.5, 5.5),
            shade,
            velocity,
            pitch: self.between(60.0, 110.0),
            drift: (drift * libm::sin(angle), drift * libm::cos(angle)),
        }
    }

    /// A description of a sensor and the length of its exposures, ns; `which`: of what kind it is, 0 to 1.
    fn sensor(&mut self, which: f64) -> (Sensor, i64) {
        let us = |us: f64| Some(Duration::new((us * 1e3).round() as i64));
        let mut sensor = Sensor::unknown("made up");
        let threshold = self.between(0.15, 0.25);
        sensor.comparator.threshold_on = Some(threshold);
        sensor.comparator.threshold_off = Some(threshold * self.between(0.92, 1.09));
        sensor.comparator.reset = if which < 0.4 { Reset::Resample } else { Reset::Advance };
        sensor.readout.refractory = us(if which < 0.4 { self.between(30.0, 90.0).round() } else { 0.0 });
        sensor.readout.latency_min = us(1.0);
        let tau_0 = self.between(8.0, 48.0);
        sensor.front_end.tau_0 = us(if which < 0.2 { 0.0 } else { tau_0 });
        sensor.front_end.alpha = us(self.between(7_500.0, 31_000.0));
        let exposure_ns = (self.between(3.0e6, 4.5e6)).round() as i64;
        sensor.frames.gain =
            Some(self.between(600.0, 1200.0) * if self.between(0.0, 1.0) < 0.5 { 0.8 } else { 1.0 });
        sensor.frames.row_time = us(self.between(25.0, 45.0));
        sensor.frames.saturation_dn = Some(1023.0);
        (sensor, exposure_ns)
    }
}

/// How far within the outline of a figure of a height a place is, pixels; `swing`: angle of a leg, rad.
fn within_figure(at: (f64, f64), hip: (f64, f64), height: f64, swing: f64) -> f64 {
    let leg = 0.5 * height;
    let foot = |angle: f64, length: f64, from: (f64, f64)| {
        (from.0 + length * libm::sin(angle), from.1 + length * libm::cos(angle))
    };
    let neck = (hip.0, hip.1 - 0.3 * height);
    let limb = |from: (f64, f64), angle: f64, length: f64, thick: f64| {
        thick * height - from_line(at, from, foot(angle, length, from))
    };
    let parts = [
        limb(hip, swing, leg, 0.05),
        limb(hip, -swing, leg, 0.05),
        limb(neck, -swing, 0.35 * height, 0.035),
        limb(neck, swing, 0.35 * height, 0.035),
        0.09 * height - from_line(at, hip, neck),
        0.09 * height - libm::hypot(at.0 - neck.0, at.1 - neck.1 + 0.13 * height),
    ];
    parts.into_iter().fold(f64::NEG_INFINITY, f64::max)
}

/// The sharpest edges, pixels on either side.
const SHARPEST: f64 = 0.35;

impl MadeUp {
    /// Scene number `index` of a seed, on an array of an extent, for some seconds: a texture, a star or
    /// discs.
    pub fn new(seed: u64, index: u64, extent: Extent, duration_s: f64) -> MadeUp {
        MadeUp::of(seed, index, extent, duration_s, [0.5, 0.85, 0.85, 0.85, 0.85, 0.85, 0.85])
    }

    /// The same of what does not move as one: layers, a fan, a figure, a ball.
    pub fn in_parts(seed: u64, index: u64, extent: Extent, duration_s: f64) -> MadeUp {
        MadeUp::of(seed, index, extent, duration_s, [0.0, 0.0, 0.0, 0.3, 0.6, 0.8, 1.0])
    }

    #[cfg(test)]
    /// The same of a photograph that shakes, zooms and turns.
    pub fn photograph(seed: u64, index: u64, extent: Extent, duration_s: f64) -> MadeUp {
        MadeUp::of(seed, index, extent, duration_s, [0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    }

    /// `ends`: up to which draw from 0 to 1 a scene is a texture, a star, a photograph, layers, a fan, a
    /// figure, a ball; discs from there on.
    fn of(seed: u64, index: u64, extent: Extent, duration_s: f64, ends: [f64; 7]) -> MadeUp {
        let mut draws = Draws::new(seed, index, extent);
        let motion = draws.motion(ends);
        let (low, high) = (draws.between(26.0, 38.0), draws.between(150.0, 205.0));
        let which = draws.between(0.0, 1.0);
        let (sensor, exposure_ns) = draws.sensor(which);
        let first_ns = draws.between(1e5, 6e5).round() as i64;
        let span = (0, (duration_s * 1e9) as i64);
        let period_ns = 8_333_333;
        let rows_ns = sensor.frames.row_time.map_or(0, Duration::ns) * i64::from(extent.height);
        let exposures = (0..)
            .map(|l| Exposure::new(first_ns + l * period_ns, first_ns + l * period_ns + exposure_ns))
            .take_while(|exposure| exposure.end.0 + rows_ns < span.1)
            .collect();
        let resolution_ns = if which < 0.2 || (0.4..0.7).contains(&which) {
            1_000
        } else if which < 0.4 {
            1
        } else {
            20_000
        };
        let contrast = draws.between(0.8, 1.6);
        // Pixels are not points and lenses are not perfect: no edge is sharper than about a third of a pixel
        // on either side.
        let edge = f64::max(draws.between(0.1, 0.9), SHARPEST);
        MadeUp {
            motion,
            low,
            high,
            seed: seed.wrapping_mul(1009).wrapping_add(index),
            contrast,
            edge,
            sensor,
            exposures,
            resolution_ns,
            extent,
            span,
            noise: None,
            unstated_noise: 0.0,
            step_ns: 200_000,
        }
    }

    /// Target number `index` of a seed: a star or discs before a plain wall, thresholds with noise, frames
    /// with stated noise or none.
    pub fn target(seed: u64, index: u64, extent: Extent, duration_s: f64) -> MadeUp {
        let mut random = Random::new(seed, &[index, 78]);
        let mut between = |low: f64, high: f64| low + (high - low) * random.uniform();
        let mut made = MadeUp::new(seed, index, extent, duration_s);
        if let Motion::Texture { velocity, .. } = made.motion {
            let rate = between(3.0, 12.0) * std::f64::consts::TAU * if velocity.0 > 0.0 { 1.0 } else { -1.0 };
            let centre = (
                0.5 * f64::from(extent.width) + between(-2.0, 2.0),
                0.5 * f64::from(extent.height) + between(-2.0, 2.0),
            );
            made.motion = Motion::Star { spokes: between(2.0, 6.0).floor(), rate, centre };
        }
        // No ground behind discs: a wall.
        made.contrast = 0.0;
        let noise = between(0.008, 0.035) * made.sensor.comparator.threshold_on.unwrap_or(0.2);
        if between(0.0, 1.0) < 0.75 {
            made.sensor.comparator.threshold_noise = Some(noise);
        } else {
            made.unstated_noise = noise;
        }
        if between(0.0, 1.0) < 0.6 {
            made.sensor.frames.read_noise_dn = Some(between(0.3, 4.0));
            made.sensor.frames.full_well_e = Some(between(9_000.0, 30_000.0));
        }
        made.step_ns = 25_000;
        made
    }

    /// With dark and bright light changed by factors.
    #[must_use]
    pub fn lit(self, dark: f64, bright: f64) -> MadeUp {
        MadeUp { low: self.low * dark, high: self.high * bright, ..self }
    }

    /// How fast things cross a place, pixels a second at most.
    pub fn px_per_s(&self, x: f64, y: f64) -> f64 {
        let length = |(x, y): (f64, f64)| libm::hypot(x, y);
        match &self.motion {
            Motion::Texture { velocity, shake_px, shake_hz } => {
                length(*velocity) + 2.0 * std::f64::consts::TAU * shake_hz * shake_px
            }
            Motion::Star { rate, centre, .. } => {
                rate.abs() * f64::max(libm::hypot(x - centre.0, y - centre.1), 1.0)
            }
            Motion::Discs { velocity, drift, .. } => f64::max(length(*velocity), length(*drift)),
            Motion::Photograph { shake, turn, zoom, drift } => {
                let edge = libm::hypot(f64::from(self.extent.width), f64::from(self.extent.height)) / 2.0;
                length(*drift)
                    + std::f64::consts::TAU
                        * (shake.0 * shake.1 + edge * (turn.0.abs() * turn.1 + zoom.0 * zoom.1))
            }
            Motion::Layers { front, back, .. } => f64::max(length(*front), length(*back)),
            Motion::Fan { rate, radius, .. } => rate.abs() * radius,
            Motion::Figure { height, speed, steps_hz, .. } => {
                speed.abs() + 0.25 * height * std::f64::consts::TAU * steps_hz
            }
            Motion::Ball { radius, velocity, fall, rate, .. } => {
                length(*velocity) + fall * self.span.1 as f64 * 1e-9 + rate.abs() * radius
            }
        }
    }

    /// After how long its light is the same again, seconds; 0 when it does not.
    pub fn period_s(&self) -> f64 {
        match &self.motion {
            Motion::Fan { blades, rate, .. } => std::f64::consts::TAU / (blades * rate.abs()),
            Motion::Star { spokes, rate, .. } => std::f64::consts::TAU / (spokes * rate.abs()),
            Motion::Discs { velocity, pitch, .. } => pitch / libm::hypot(velocity.0, velocity.1),
            _ => 0.0,
        }
    }

    /// With edges of a width, pixels on either side.
    #[cfg(test)]
    pub fn with_edge(self, edge: f64) -> MadeUp {
        MadeUp { edge, ..self }
    }

    /// With frames of whole digital numbers that have shot noise of so many electrons a digital number, and
    /// read noise, DN; none of it is stated.
    #[must_use]
    pub fn with_frame_noise(self, noise: Option<(f64, f64)>) -> MadeUp {
        MadeUp { noise, ..self }
    }

    /// Log photocurrent at a place and time, seconds.
    pub(crate) fn log_light(&self, x: f64, y: f64, t: f64) -> f64 {
        let shade = match &self.motion {
            Motion::Texture { velocity, shake_px, shake_hz } => {
                let shake = shake_px * libm::sin(std::f64::consts::TAU * shake_hz * t);
                0.5 + self.contrast
                    * (texture(self.seed, x - velocity.0 * t - shake, y - velocity.1 * t + shake) - 0.5)
            }
            Motion::Star { spokes, rate, centre } => {
                let (dx, dy) = (x - centre.0, y - centre.1);
                let radius = libm::sqrt(dx * dx + dy * dy);
                let wave = libm::sin(spokes * (libm::atan2(dy, dx) - rate * t));
                let sharp = (wave * f64::max(radius, 1.0) / spokes / self.edge).clamp(-1.0, 1.0);
                0.5 + 0.5 * sharp
            }
            Motion::Discs { radius, shade, velocity, pitch, drift } => {
                // A plain wall has no texture to be worked out.
                let ground = if self.contrast == 0.0 {
                    0.5
                } else {
                    0.5 + self.contrast * (texture(self.seed, x - drift.0 * t, y - drift.1 * t) - 0.5)
                };
                let wrap = |at: f64| (at / pitch - (at / pitch).floor() - 0.5) * pitch;
                let (dx, dy) = (wrap(x - velocity.0 * t), wrap(y - velocity.1 * t));
                let inside =
                    (0.5 + 0.5 * (radius - libm::sqrt(dx * dx + dy * dy)) / self.edge).clamp(0.0, 1.0);
                ground + (shade - ground) * inside
            }
            Motion::Photograph { shake, turn, zoom, drift } => {
                self.photograph_shade((x, y), t, [*shake, *turn, *zoom], *drift)
            }
            Motion::Layers { size, front, back } => {
                let (u, v) = (x - front.0 * t, y - front.1 * t);
                let inside = 0.5
                    + 0.5
                        * ((surface(self.seed ^ 0x52, u, v, *size) - 0.55) * 0.5 * size / self.edge)
                            .clamp(-1.0, 1.0);
                let (near, far) =
                    (texture(self.seed ^ 0x53, u, v), texture(self.seed, x - back.0 * t, y - back.1 * t));
                0.5 + self.contrast * (far + (near - far) * inside - 0.5)
            }
            Motion::Fan { blades, rate, centre, radius, half, shade } => {
                let (dx, dy) = (x - centre.0, y - centre.1);
                let r = libm::hypot(dx, dy);
                let pitch = std::f64::consts::TAU / blades;
                let turned = (libm::atan2(dy, dx) - rate * t).rem_euclid(pitch) - 0.5 * pitch;
                let depth = f64::min((half - turned.abs()) * f64::max(r, 1.0), f64::min(radius - r, r - 2.0));
                self.before_ground(x, y, depth, *shade)
            }
            Motion::Figure { height, speed, steps_hz, begin, shade } => {
                let hip = (begin.0 + speed * t, begin.1);
                let swing = 0.5 * libm::sin(std::f64::consts::TAU * steps_hz * t);
                self.before_ground(x, y, within_figure((x, y), hip, *height, swing), *shade)
            }
            Motion::Ball { radius, begin, velocity, fall, rate } => {
                let (dx, dy) =
                    (x - begin.0 - velocity.0 * t, y - begin.1 - velocity.1 * t - 0.5 * fall * t * t);
                let (c, s) = (libm::cos(rate * t), libm::sin(rate * t));
                let own =
                    0.5 + self.contrast * (texture(self.seed ^ 0x54, c * dx + s * dy, c * dy - s * dx) - 0.5);
                self.before_ground(x, y, radius - libm::hypot(dx, dy), own)
            }
        };
        libm::log(f64::max(self.low + (self.high - self.low) * shade.clamp(-0.1, 1.1), 2.0))
    }

    /// Shade of a photograph at a place and time; amplitudes and frequencies of its shaking, turning and
    /// zooming.
    fn photograph_shade(&self, at: (f64, f64), t: f64, swings: [(f64, f64); 3], drift: (f64, f64)) -> f64 {
        let ((x, y), [shake, turn, zoom]) = (at, swings);
        let swing = |of: (f64, f64), phase: f64| of.0 * libm::sin(std::f64::consts::TAU * of.1 * t + phase);
        let (angle, scale) = (swing(turn, 0.3), libm::exp(swing(zoom, 1.1)));
        let (c, s) = (scale * libm::cos(angle), scale * libm::sin(angle));
        let (dx, dy) = (x - 0.5 * f64::from(self.extent.width), y - 0.5 * f64::from(self.extent.height));
        let (u, v) = (
            c * dx - s * dy - drift.0 * t - swing(shake, 0.0),
            s * dx + c * dy - drift.1 * t - swing(shake, 1.9),
        );
        let shape =
            0.5 + 0.5 * ((surface(self.seed ^ 0x51, u, v, 13.0) - 0.5) * 6.0 / self.edge).clamp(-1.0, 1.0);
        0.5 + self.contrast * (0.6 * texture(self.seed, u, v) + 0.4 * shape - 0.5)
    }

    /// A shade before a still texture, `depth` pixels within its outline.
    fn before_ground(&self, x: f64, y: f64, depth: f64, shade: f64) -> f64 {
        let ground = 0.5 + self.contrast * (texture(self.seed, x, y) - 0.5);
        ground + (shade - ground) * (0.5 + 0.5 * depth / self.edge).clamp(0.0, 1.0)
    }

    /// What moves, in a word.
    pub fn name(&self) -> &'static str {
        self.motion.name()
    }

    /// Log photocurrent of every pixel at instants.
    fn log_tracks(&self) -> Vec<(Vec<i64>, Vec<f64>)> {
        let step_ns = self.step_ns;
        let instants: Vec<i64> = (0..=self.span.1 / step_ns).map(|k| k * step_ns).collect();
        let width = self.extent.width as usize;
        let of = |pixel: usize| {
            let (x, y) = ((pixel % width) as f64, (pixel / width) as f64);
            (instants.clone(), instants.iter().map(|t| self.log_light(x, y, *t as f64 * 1e-9)).collect())
        };
        (0..self.extent.pixels()).into_par_iter().map(of).collect()
    }

    /// The light of every pixel: instants, ns, and photocurrent.
    pub fn light(&self) -> Vec<(Vec<i64>, Vec<f64>)> {
        self.log_tracks()
            .into_iter()
            .map(|(t, log)| (t, log.iter().map(|u| libm::exp(*u)).collect()))
            .collect()
    }

    /// The recording of this scene by this sensor, with nothing beyond the description.
    ///
    /// # Errors
    /// Never for the sensors made here; the message of [`Case::nominal`] or [`record`] otherwise.
    pub fn recording(&self) -> Result<Case, String> {
        self.recording_through(None)
    }

    /// The recording of this scene by a sensor that differs from the description.
    ///
    /// # Errors
    /// When the effects of `trial` cannot be combined.
    pub fn recording_through(&self, trial: Option<&Trial>) -> Result<Case, String> {
        let frames =
            FrameTimes::new(self.exposures.clone(), self.sensor.frames.row_time.map_or(0, Duration::ns))
                .map_err(|why| why.to_string())?;
        let dn = vec![f32::NAN; frames.len() * self.extent.pixels()];
        let blank = Case {
            extent: self.extent,
            span: self.span,
            events: PixelEvents::new(vec![Vec::new(); self.extent.pixels()]),
            has_t_in: true,
            t_resolution_ns: self.resolution_ns,
            frames: Some(CaseFrames::new(frames, dn)),
            sensor: self.sensor.clone(),
        };
        let pixels = self.log_tracks().into_iter().map(|(t, log)| (t, log, true));
        let nominal = blank.nominal().map_err(|why| why.to_string())?;
        let stated = Trial::stated(&nominal);
        let mut trial = trial.unwrap_or(&stated).clone();
        trial.nominal.threshold_noise = f64::max(trial.nominal.threshold_noise, self.unstated_noise);
        let mut recorded = record(
            &blank,
            &trial.nominal,
            &Sample::all(&blank, 6),
            &Curves::from_pixels(pixels),
            &trial.effects,
            &Conditions { seed: self.seed, ..Conditions::default() },
        )?;
        if let (Some((electrons, read_dn)), Some(frames)) = (self.noise, &mut recorded.frames) {
            let mut random = Random::new(self.seed, &[0x7e]);
            *frames = frames.map(|_, dn| {
                let signal = f64::max(f64::from(dn) - nominal.number.black_level, 0.0);
                let noisy =
                    f64::from(dn) + libm::sqrt(signal / electrons + read_dn * read_dn) * random.normal();
                noisy.round().clamp(0.0, nominal.saturation_dn) as f32
            });
        }
        Ok(recorded)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_number_gives_the_same_recording_and_another_number_another() {
        let extent = Extent { width: 18, height: 12 };
        let of = |index: u64| MadeUp::new(5, index, extent, 0.05).recording().unwrap();
        let (a, b, c) = (of(1), of(1), of(2));
        assert_eq!(a.events, b.events);
        assert_ne!(a.events, c.events);
        assert!(a.events.len() > 200 && c.frame_count() >= 4);
    }
}
