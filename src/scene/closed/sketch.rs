//! Sketches: scenes with edges of a stated width on surfaces without end, at any real time. The decision of a
//! diagnosis is calibrated on random ones.
//!
//! A texture that drifts and shakes, a turning star, discs that fly over a slow texture, a photograph that
//! shakes, zooms and turns, a layer that moves before another one; a fan, a walking figure, a thrown ball
//! before a still ground. A sketch is a few numbers, so its size and length can be anything. Limits: grey;
//! objects are opaque; a place is a point, and the stated edge stands for the pixel.

use super::shapes::{blend, bone, coverage_at_depth, from_line, rotate};
use super::surface::{noise, smooth_noise};
use std::f64::consts::TAU;

/// The moving object.
#[derive(Clone, Debug)]
#[allow(missing_docs)] // Each variant's text names its numbers.
pub enum SketchMotion {
    /// A texture at a velocity, px/s, shaken with an amplitude, px, at a frequency, Hz.
    Texture { velocity: (f64, f64), shake_px: f64, shake_hz: f64 },
    /// Spokes that turn, and how fast, rad/s, around a centre.
    Star { spokes: f64, rate: f64, centre: (f64, f64) },
    /// Discs of a radius and shade (0 to 1) at a velocity, over a texture that drifts.
    Discs { radius: f64, shade: f64, velocity: (f64, f64), pitch: f64, drift: (f64, f64) },
    /// A texture with edges, shaken, turned and zoomed around the middle: amplitudes in px, rad and as a
    /// share, each with its frequency, Hz, and a drift, px/s.
    Photograph {
        middle: (f64, f64),
        shake: (f64, f64),
        turn: (f64, f64),
        zoom: (f64, f64),
        drift: (f64, f64),
    },
    /// Shapes of a size, px, with a texture of their own at a velocity, px/s, before a texture at another.
    Layers { size: f64, front: (f64, f64), back: (f64, f64) },
    /// Blades that turn, rad/s, within a radius around a centre before a still texture; half the angle of a
    /// blade.
    Fan { blades: f64, rate: f64, centre: (f64, f64), radius: f64, half: f64, shade: f64 },
    /// A figure of a height, px, that walks, px/s, so many steps a second, from a place on.
    Figure { height: f64, speed: f64, steps_hz: f64, begin: (f64, f64), shade: f64 },
    /// A ball of a radius with a texture, from a place with a velocity, px/s, falling, px/s^2, for so long,
    /// ns, and turning, rad/s.
    Ball { radius: f64, begin: (f64, f64), velocity: (f64, f64), fall: f64, flight_ns: f64, rate: f64 },
}

/// A motion with its surfaces, edges and light.
#[derive(Clone, Debug)]
pub struct Sketch {
    /// What moves.
    pub motion: SketchMotion,
    /// Of its surfaces.
    pub seed: u64,
    /// Of textures, as a share of all shades.
    pub contrast: f64,
    /// Width of edges, pixels, on either side.
    pub edge: f64,
    /// Photocurrent of dark surfaces,
    pub low: f64,
    /// and of bright ones.
    pub high: f64,
}

fn length((x, y): (f64, f64)) -> f64 {
    libm::hypot(x, y)
}

/// How far within the outline of a figure of a height a place is, pixels; `swing`: angle of a leg, rad.
fn within_figure(at: (f64, f64), hip: (f64, f64), height: f64, swing: f64) -> f64 {
    let neck = (hip.0, hip.1 - 0.3 * height);
    let off = |a: (f64, f64), b: (f64, f64)| length(from_line(at, a, b));
    let limb = |from: (f64, f64), angle: f64, length: f64, thick: f64| {
        thick * height - off(from, bone(from, length, angle))
    };
    let parts = [
        limb(hip, swing, 0.5 * height, 0.05),
        limb(hip, -swing, 0.5 * height, 0.05),
        limb(neck, -swing, 0.35 * height, 0.035),
        limb(neck, swing, 0.35 * height, 0.035),
        0.09 * height - off(hip, neck),
        0.09 * height - libm::hypot(at.0 - neck.0, at.1 - neck.1 + 0.13 * height),
    ];
    parts.into_iter().fold(f64::NEG_INFINITY, f64::max)
}

impl Sketch {
    /// Name of the moving object.
    pub fn name(&self) -> &'static str {
        match self.motion {
            SketchMotion::Texture { .. } => "texture",
            SketchMotion::Star { .. } => "star",
            SketchMotion::Discs { .. } => "discs",
            SketchMotion::Photograph { .. } => "photograph",
            SketchMotion::Layers { .. } => "layers",
            SketchMotion::Fan { .. } => "fan",
            SketchMotion::Figure { .. } => "figure",
            SketchMotion::Ball { .. } => "ball",
        }
    }

    /// How fast things cross a place, pixels a second at most.
    pub fn px_per_s(&self, x: f64, y: f64) -> f64 {
        match self.motion {
            SketchMotion::Texture { velocity, shake_px, shake_hz } => {
                length(velocity) + 2.0 * TAU * shake_hz * shake_px
            }
            SketchMotion::Star { rate, centre, .. } => {
                rate.abs() * f64::max(libm::hypot(x - centre.0, y - centre.1), 1.0)
            }
            SketchMotion::Discs { velocity, drift, .. } => f64::max(length(velocity), length(drift)),
            SketchMotion::Photograph { middle, shake, turn, zoom, drift } => {
                let swings = shake.0 * shake.1 + length(middle) * (turn.0.abs() * turn.1 + zoom.0 * zoom.1);
                length(drift) + TAU * swings
            }
            SketchMotion::Layers { front, back, .. } => f64::max(length(front), length(back)),
            SketchMotion::Fan { rate, radius, .. } => rate.abs() * radius,
            SketchMotion::Figure { height, speed, steps_hz, .. } => {
                speed.abs() + 0.25 * height * TAU * steps_hz
            }
            SketchMotion::Ball { radius, velocity, fall, flight_ns, rate, .. } => {
                length(velocity) + fall * flight_ns * 1e-9 + rate.abs() * radius
            }
        }
    }

    /// After how long its light is the same again, seconds; 0 when it does not.
    pub fn period_s(&self) -> f64 {
        match self.motion {
            SketchMotion::Fan { blades: parts, rate, .. }
            | SketchMotion::Star { spokes: parts, rate, .. } => TAU / (parts * rate.abs()),
            SketchMotion::Discs { velocity, pitch, .. } => pitch / length(velocity),
            _ => 0.0,
        }
    }

    /// With dark and bright light changed by factors.
    #[must_use]
    pub fn lit(self, dark: f64, bright: f64) -> Sketch {
        Sketch { low: self.low * dark, high: self.high * bright, ..self }
    }

    /// Log photocurrent at a place and time, seconds.
    pub fn log_light(&self, x: f64, y: f64, t: f64) -> f64 {
        libm::log(f64::max(blend(self.low, self.high, self.shade(x, y, t).clamp(-0.1, 1.1)), 2.0))
    }

    /// Shade at a place and time, seconds: about 0 (dark) to 1.
    fn shade(&self, x: f64, y: f64, t: f64) -> f64 {
        match self.motion {
            SketchMotion::Texture { velocity, shake_px, shake_hz } => {
                let shake = shake_px * libm::sin(TAU * shake_hz * t);
                self.textured(0, x - velocity.0 * t - shake, y - velocity.1 * t + shake)
            }
            SketchMotion::Star { spokes, rate, centre } => {
                let (dx, dy) = (x - centre.0, y - centre.1);
                let radius = libm::sqrt(dx * dx + dy * dy);
                let wave = libm::sin(spokes * (libm::atan2(dy, dx) - rate * t));
                coverage_at_depth(wave * f64::max(radius, 1.0) / spokes, self.edge)
            }
            SketchMotion::Discs { radius, shade, velocity, pitch, drift } => {
                let ground = self.textured(0, x - drift.0 * t, y - drift.1 * t);
                let wrap = |at: f64| (at / pitch - (at / pitch).floor() - 0.5) * pitch;
                let (dx, dy) = (wrap(x - velocity.0 * t), wrap(y - velocity.1 * t));
                blend(ground, shade, coverage_at_depth(radius - libm::sqrt(dx * dx + dy * dy), self.edge))
            }
            SketchMotion::Photograph { middle, shake, turn, zoom, drift } => {
                let swing = |of: (f64, f64), phase: f64| of.0 * libm::sin(TAU * of.1 * t + phase);
                let (angle, scale) = (swing(turn, 0.3), libm::exp(swing(zoom, 1.1)));
                let slant = (scale * libm::sin(angle), scale * libm::cos(angle));
                let (u, v) = rotate((x - middle.0, y - middle.1), slant);
                let (u, v) = (u - drift.0 * t - swing(shake, 0.0), v - drift.1 * t - swing(shake, 1.9));
                let shape =
                    coverage_at_depth((smooth_noise(self.seed ^ 0x51, u, v, 13.0) - 0.5) * 6.0, self.edge);
                self.contrasted(0.6 * noise(self.seed, u, v) + 0.4 * shape)
            }
            SketchMotion::Layers { size, front, back } => {
                let (u, v) = (x - front.0 * t, y - front.1 * t);
                let share = coverage_at_depth(
                    (smooth_noise(self.seed ^ 0x52, u, v, size) - 0.55) * 0.5 * size,
                    self.edge,
                );
                let near = noise(self.seed ^ 0x53, u, v);
                let far = noise(self.seed, x - back.0 * t, y - back.1 * t);
                self.contrasted(blend(far, near, share))
            }
            SketchMotion::Fan { blades, rate, centre, radius, half, shade } => {
                let (dx, dy) = (x - centre.0, y - centre.1);
                let r = libm::hypot(dx, dy);
                let pitch = TAU / blades;
                let turned = (libm::atan2(dy, dx) - rate * t).rem_euclid(pitch) - 0.5 * pitch;
                let depth = f64::min((half - turned.abs()) * f64::max(r, 1.0), f64::min(radius - r, r - 2.0));
                self.before_ground(x, y, depth, shade)
            }
            SketchMotion::Figure { height, speed, steps_hz, begin, shade } => {
                let hip = (begin.0 + speed * t, begin.1);
                let swing = 0.5 * libm::sin(TAU * steps_hz * t);
                self.before_ground(x, y, within_figure((x, y), hip, height, swing), shade)
            }
            SketchMotion::Ball { radius, begin, velocity, fall, rate, .. } => {
                let (dx, dy) =
                    (x - begin.0 - velocity.0 * t, y - begin.1 - velocity.1 * t - 0.5 * fall * t * t);
                let (u, v) = rotate((dx, dy), (-libm::sin(rate * t), libm::cos(rate * t)));
                self.before_ground(x, y, radius - libm::hypot(dx, dy), self.textured(0x54, u, v))
            }
        }
    }

    /// A shade before a still texture, `depth` pixels within its outline.
    fn before_ground(&self, x: f64, y: f64, depth: f64, shade: f64) -> f64 {
        blend(self.textured(0, x, y), shade, coverage_at_depth(depth, self.edge))
    }

    /// Shade of a texture by its number at a place.
    fn textured(&self, number: u64, x: f64, y: f64) -> f64 {
        // A plain wall has no texture to be worked out.
        if self.contrast == 0.0 { 0.5 } else { self.contrasted(noise(self.seed ^ number, x, y)) }
    }

    /// A surface's value, 0 to 1, as a shade.
    fn contrasted(&self, value: f64) -> f64 {
        0.5 + self.contrast * (value - 0.5)
    }
}
