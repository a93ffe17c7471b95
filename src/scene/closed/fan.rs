//! `fan`: rotating blades before a textured wall.
//!
//! Blades are sectors bent backwards, each of its own even grey, around a dark hub. Their edges are all that
//! changes.

use super::disk::Disk;
use super::shapes::{arrival, blend, covered};
use super::surface::Texture;
use super::{ClosedScene, DARKEST};
use photocurrent_core::Extent;
use photocurrent_core::quantity::Rotation;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Parameters of the scene `fan`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FanParams {
    /// Speed of rotation, clockwise.
    #[schemars(extend("x-min" = "0 rpm", "x-max" = "100000 rpm"))]
    pub speed: Rotation,
    /// Number of blades.
    #[schemars(range(min = 1, max = 24))]
    pub blades: u32,
    /// From the hub's middle to a blade's tip, as a share of the picture's smaller side.
    #[schemars(range(min = 0.05, max = 2.0))]
    pub radius: f64,
    /// Share of a turn that blades cover.
    #[schemars(range(min = 0.05, max = 0.95))]
    pub cover: f64,
}

impl Default for FanParams {
    fn default() -> Self {
        FanParams { speed: Rotation::new(900.0), blades: 5, radius: 0.45, cover: 0.5 }
    }
}

/// A blade's tip lags behind its root by this, radians.
const BEND: f64 = 0.7;

/// The hub's radius in radii of the fan.
const HUB: f64 = 0.15;

/// The scene.
pub struct Fan {
    /// Its parts are blades with their gaps.
    disk: Disk,
    cover: f64,
    wall: Texture,
}

impl Fan {
    /// For a picture of that size.
    pub fn new(params: &FanParams, extent: Extent, seed: u64) -> Fan {
        Fan {
            disk: Disk::new(extent, params.radius, params.blades.into(), params.speed),
            cover: params.cover,
            wall: Texture::new(0.08, 0.3, seed, 1),
        }
    }

    /// Distance from the centre, and the place between blades: 0 to `cover` is on the blade whose number
    /// comes third.
    fn blade_place(&self, x: f64, y: f64, t_ns: i64) -> (f64, f64, f64) {
        let (distance, angle) = self.disk.polar(x, y, t_ns);
        let at = (angle + BEND * distance / self.disk.radius) / TAU * self.disk.parts;
        (distance, at - at.floor(), at.floor().rem_euclid(self.disk.parts))
    }

    /// Pixels along the circle per place between blades.
    fn arc(&self, distance: f64) -> f64 {
        TAU * distance / self.disk.parts
    }
}

impl ClosedScene for Fan {
    fn light(&self, x: f64, y: f64, t_ns: i64) -> f64 {
        let (distance, part, blade) = self.blade_place(x, y, t_ns);
        let wall = self.wall.at(x, y);
        let hub = covered(distance - HUB * self.disk.radius);
        let reach = self.disk.coverage(distance);
        if reach == 0.0 {
            return wall;
        }
        // Greys from 0.9 down to 0.5, so that each blade differs from the next.
        let grey = |blade: f64| blend(0.9, 0.5, blade / self.disk.parts);
        let arc = self.arc(distance).max(1e-9);
        // Across the gap's middle the nearest blade is the next one.
        let middle = (1.0 + self.cover) / 2.0;
        let (from_first, from_last, blade) = if part < middle {
            (-part, part - self.cover, blade)
        } else {
            (1.0 - part, part - 1.0 - self.cover, (blade + 1.0).rem_euclid(self.disk.parts))
        };
        let on_blade = (covered(from_first * arc) + covered(from_last * arc) - 1.0).max(0.0);
        let disk = blend(blend(wall, grey(blade), on_blade), DARKEST, hub);
        blend(wall, disk, reach)
    }

    fn speed(&self, x: f64, y: f64) -> f64 {
        self.disk.speed(x, y)
    }

    fn still_until(&self, x: f64, y: f64, t_ns: i64) -> i64 {
        let (distance, part, _) = self.blade_place(x, y, t_ns);
        if distance > self.disk.radius + 0.5 || distance < HUB * self.disk.radius - 0.5 {
            return i64::MAX;
        }
        let to_edge = part.min(1.0 - part).min((part - self.cover).abs());
        // Edges count as one pixel wide on both sides: the middle of a narrow gap is where the nearest blade
        // changes.
        arrival(t_ns, to_edge * self.arc(distance), self.disk.turning * distance)
    }
}

#[cfg(test)]
mod tests {
    use super::super::EXTENT;
    use super::*;

    #[test]
    fn after_one_blades_turn_the_next_blade_stands_there() {
        let fan =
            Fan::new(&FanParams { speed: Rotation::new(60_000.0 / 5.0), ..FanParams::default() }, EXTENT, 7);
        // 200 turns per second and five blades: one blade further every millisecond.
        let (x, y) = (fan.disk.centre.0 + 14.0, fan.disk.centre.1 - 5.0);
        for t in [0, 137_000, 420_000] {
            let (_, now, blade) = fan.blade_place(x, y, t);
            let (_, then, next) = fan.blade_place(x, y, t + 1_000_000);
            assert!((now - then).abs() < 1e-6, "{now} against {then}");
            // Blades turn forwards, so a place falls back by one.
            assert_eq!((next + 1.0).rem_euclid(5.0), blade);
        }
    }

    #[test]
    fn blades_cover_their_share_of_the_wall() {
        let fan = Fan::new(&FanParams { cover: 0.3, ..FanParams::default() }, EXTENT, 7);
        let (x, y) = (fan.disk.centre.0 + 20.0, fan.disk.centre.1);
        let n = 4000;
        // One turn lasts 1 / 15 s; blades are brighter than 0.4, the wall is darker.
        let on = (0..n).filter(|k| fan.light(x, y, i64::from(*k) * 66_666_667 / i64::from(n)) > 0.4).count();
        assert!((on as f64 / f64::from(n) - 0.3).abs() < 0.02, "{on} of {n}");
    }
}
