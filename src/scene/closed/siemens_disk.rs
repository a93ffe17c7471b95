//! `siemens_disk`: a rotating disk with spokes, on which the sharpness of edges is measured.
//!
//! Spokes are stripes along circles, averaged over a pixel in closed form, so the middle fades to grey
//! without moire.

use super::disk::{Disk, WALL};
use super::shapes::{blend, stripes};
use super::{BRIGHTEST, ClosedScene, DARKEST};
use photocurrent_core::Extent;
use photocurrent_core::quantity::Rotation;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Parameters of the scene `siemens_disk`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SiemensDiskParams {
    /// Speed of rotation, clockwise.
    #[schemars(extend("x-min" = "0 rpm", "x-max" = "100000 rpm"))]
    pub speed: Rotation,
    /// Number of bright spokes, and of dark ones between them.
    #[schemars(range(min = 1, max = 200))]
    pub spokes: u32,
    /// Radius of the disk, as a share of the picture's smaller side.
    #[schemars(range(min = 0.05, max = 2.0))]
    pub radius: f64,
    /// Reflectance of dark spokes.
    #[schemars(range(min = 0.03, max = 0.95))]
    pub dark: f64,
    /// Reflectance of bright spokes.
    #[schemars(range(min = 0.03, max = 0.95))]
    pub bright: f64,
}

impl Default for SiemensDiskParams {
    fn default() -> Self {
        SiemensDiskParams { speed: Rotation::new(292.0), spokes: 8, radius: 0.45, dark: 0.05, bright: 0.9 }
    }
}

/// The scene.
pub struct SiemensDisk {
    /// Its parts are dark and bright spokes.
    disk: Disk,
    dark: f64,
    bright: f64,
}

impl SiemensDisk {
    /// For a picture of that size.
    pub fn new(params: &SiemensDiskParams, extent: Extent) -> SiemensDisk {
        SiemensDisk {
            disk: Disk::new(extent, params.radius, 2.0 * f64::from(params.spokes), params.speed),
            dark: params.dark.clamp(DARKEST, BRIGHTEST),
            bright: params.bright.clamp(DARKEST, BRIGHTEST),
        }
    }

    /// Distance from the middle, and the place in stripes.
    fn polar_place(&self, x: f64, y: f64, t_ns: i64) -> (f64, f64) {
        let (distance, angle) = self.disk.polar(x, y, t_ns);
        (distance, angle / TAU * self.disk.parts)
    }
}

impl ClosedScene for SiemensDisk {
    fn light(&self, x: f64, y: f64, t_ns: i64) -> f64 {
        let (distance, at) = self.polar_place(x, y, t_ns);
        let inside = self.disk.coverage(distance);
        if inside == 0.0 {
            return WALL;
        }
        blend(WALL, blend(self.dark, self.bright, stripes(at, self.disk.pixel(distance))), inside)
    }

    fn speed(&self, x: f64, y: f64) -> f64 {
        self.disk.speed(x, y)
    }

    fn still_until(&self, x: f64, y: f64, t_ns: i64) -> i64 {
        self.disk.still_until(self.polar_place(x, y, t_ns), t_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::super::EXTENT;
    use super::*;

    #[test]
    fn an_edge_turns_by_speed_times_time() {
        let disk = SiemensDisk::new(
            &SiemensDiskParams { speed: Rotation::new(300.0), ..SiemensDiskParams::default() },
            EXTENT,
        );
        let middle = (disk.dark + disk.bright) / 2.0;
        // At t = 0 an edge points along +x; 300 rpm is 1.8 degrees per millisecond.
        for ms in [0, 3, 10, 41] {
            let angle = 1.8_f64.to_radians() * f64::from(ms);
            let place = |angle: f64| {
                (disk.disk.centre.0 + 20.0 * libm::cos(angle), disk.disk.centre.1 + 20.0 * libm::sin(angle))
            };
            let at = |angle: f64| {
                let (x, y) = place(angle);
                disk.light(x, y, i64::from(ms) * 1_000_000)
            };
            assert!((at(angle) - middle).abs() < 1e-6, "{} at {ms} ms", at(angle));
            assert!(at(angle + 0.05) > 0.8 && at(angle - 0.05) < 0.1);
        }
    }

    #[test]
    fn anti_aliasing_keeps_the_mean_of_a_ring() {
        let disk = SiemensDisk::new(&SiemensDiskParams::default(), EXTENT);
        for distance in [1.0, 3.0, 8.0, 20.0] {
            let n = 3600;
            let ring = (0..n).map(|k| TAU * f64::from(k) / f64::from(n));
            let sum: f64 = ring
                .map(|a| {
                    disk.light(
                        disk.disk.centre.0 + distance * libm::cos(a),
                        disk.disk.centre.1 + distance * libm::sin(a),
                        5_000_000,
                    )
                })
                .sum();
            assert!((sum / f64::from(n) - (disk.dark + disk.bright) / 2.0).abs() < 2e-3);
        }
    }
}
