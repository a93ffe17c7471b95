//! A rotating disk before a wall: shared by scenes with sectors around a centre.

use super::shapes::{arrival, covered, hypot, picture_centre, radians_per_ns, to_border};
use photocurrent_core::Extent;
use photocurrent_core::quantity::Rotation;
use std::f64::consts::TAU;

/// Reflectance around the disk.
pub(super) const WALL: f64 = 0.3;

/// The disk; its middle is that of the picture.
pub(super) struct Disk {
    pub centre: (f64, f64),
    pub radius: f64,
    /// Equal parts in a turn.
    pub parts: f64,
    /// Radians per nanosecond.
    pub turning: f64,
}

impl Disk {
    /// With `radius` a part of the picture's shorter side.
    pub(super) fn new(extent: Extent, radius: f64, parts: f64, speed: Rotation) -> Disk {
        Disk {
            centre: picture_centre(extent),
            radius: radius * f64::from(extent.width.min(extent.height)),
            parts,
            turning: radians_per_ns(speed),
        }
    }

    /// Distance from the middle, pixels, and the angle on the disk, radians.
    pub(super) fn polar(&self, x: f64, y: f64, t_ns: i64) -> (f64, f64) {
        let (dx, dy) = (x - self.centre.0, y - self.centre.1);
        (hypot(dx, dy), libm::atan2(dy, dx) - self.turning * t_ns as f64)
    }

    /// Share of a pixel at a distance from the centre that the disk covers.
    pub(super) fn coverage(&self, distance: f64) -> f64 {
        covered(distance - self.radius)
    }

    /// Width of a pixel so far from the middle, in parts.
    pub(super) fn pixel(&self, distance: f64) -> f64 {
        self.parts / (TAU * distance.max(0.5))
    }

    /// Pixels per nanosecond at a place.
    pub(super) fn speed(&self, x: f64, y: f64) -> f64 {
        self.turning * hypot(x - self.centre.0, y - self.centre.1).clamp(1.0, self.radius + 1.0)
    }

    /// The earliest instant, ns, at which a border between parts can reach a pixel at this distance from the
    /// centre and place `at` in parts.
    pub(super) fn still_until(&self, (distance, at): (f64, f64), t_ns: i64) -> i64 {
        if distance >= self.radius + 0.5 {
            return i64::MAX;
        }
        let part = TAU * distance / self.parts;
        arrival(t_ns, to_border(at) * part, self.turning * distance)
    }
}
