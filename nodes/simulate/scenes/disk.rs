//! A disk that turns before a wall: what scenes with parts around a middle share.

use super::shapes::{arrival, covered, hypot, to_border};
use photocurrent_core::Extent;
use photocurrent_core::quantity::Rotation;
use std::f64::consts::TAU;

/// Reflectance around the disk.
pub(crate) const WALL: f64 = 0.3;

/// The disk; its middle is that of the picture.
pub(crate) struct Disk {
    pub centre: (f64, f64),
    radius: f64,
    /// Equal parts in a turn.
    pub parts: f64,
    /// Radians per nanosecond.
    turning: f64,
}

impl Disk {
    /// With `radius` a part of the picture's shorter side.
    pub(crate) fn new(extent: Extent, radius: f64, parts: f64, speed: Rotation) -> Disk {
        Disk {
            centre: (f64::from(extent.width - 1) / 2.0, f64::from(extent.height - 1) / 2.0),
            radius: radius * f64::from(extent.width.min(extent.height)),
            parts,
            turning: TAU * speed.turns_per_s() * 1e-9,
        }
    }

    /// Distance from the middle, pixels, and the place on the disk in turns.
    pub(crate) fn place(&self, x: f64, y: f64, t_ns: i64) -> (f64, f64) {
        let (dx, dy) = (x - self.centre.0, y - self.centre.1);
        let angle = libm::atan2(dy, dx) - self.turning * t_ns as f64;
        (hypot(dx, dy), angle / TAU)
    }

    /// How much of a pixel so far from the middle is on the disk.
    pub(crate) fn inside(&self, distance: f64) -> f64 {
        covered(distance - self.radius)
    }

    /// Width of a pixel so far from the middle, in parts.
    pub(crate) fn pixel(&self, distance: f64) -> f64 {
        self.parts / (TAU * distance.max(0.5))
    }

    /// Pixels per nanosecond at a place.
    pub(crate) fn speed(&self, x: f64, y: f64) -> f64 {
        self.turning * hypot(x - self.centre.0, y - self.centre.1).clamp(1.0, self.radius + 1.0)
    }

    /// When the next border between parts may come to a pixel that is so far from the middle, and at `at` in
    /// parts.
    pub(crate) fn still_until(&self, (distance, at): (f64, f64), t_ns: i64) -> i64 {
        if distance >= self.radius + 0.5 {
            return i64::MAX;
        }
        let part = TAU * distance / self.parts;
        arrival(t_ns, to_border(at) * part, self.turning * distance)
    }
}
