//! `colour_wheel`: a rotating disk with sectors of different colours.
//!
//! The hard case for a sensor whose event pixels see a mixture of colours: at a border between two sectors
//! every channel changes by another factor, the mixture by yet another, and between some colours hardly at
//! all. In grey, the disk is its luminance.

use super::ClosedScene;
use super::disk::{Disk, WALL};
use super::shapes::blend;
use photocurrent_core::Extent;
use photocurrent_core::colour::luminance;
use photocurrent_core::quantity::Rotation;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Parameters of the scene `colour_wheel`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ColourWheelParams {
    /// Speed of rotation, clockwise.
    #[schemars(extend("x-min" = "0 rpm", "x-max" = "100000 rpm"))]
    pub speed: Rotation,
    /// Number of sectors; six colours take turns.
    #[schemars(range(min = 2, max = 120))]
    pub sectors: u32,
    /// Radius of the disk, as a share of the picture's smaller side.
    #[schemars(range(min = 0.05, max = 2.0))]
    pub radius: f64,
}

impl Default for ColourWheelParams {
    fn default() -> Self {
        ColourWheelParams { speed: Rotation::new(292.0), sectors: 12, radius: 0.45 }
    }
}

/// Reflectances of red, green and blue: red, yellow, green, cyan, blue, magenta of saturated paint.
const COLOURS: [[f64; 3]; 6] = [
    [0.60, 0.08, 0.05],
    [0.85, 0.65, 0.06],
    [0.12, 0.45, 0.12],
    [0.08, 0.42, 0.55],
    [0.06, 0.10, 0.45],
    [0.60, 0.10, 0.40],
];

/// The scene.
pub struct ColourWheel {
    disk: Disk,
}

impl ColourWheel {
    /// For a picture of that size.
    pub fn new(params: &ColourWheelParams, extent: Extent) -> ColourWheel {
        ColourWheel { disk: Disk::new(extent, params.radius, params.sectors.into(), params.speed) }
    }

    /// Distance from the middle, and the place in sectors, at least 0.
    fn polar_place(&self, x: f64, y: f64, t_ns: i64) -> (f64, f64) {
        let (distance, angle) = self.disk.polar(x, y, t_ns);
        (distance, (angle / TAU).rem_euclid(1.0) * self.disk.parts)
    }

    /// Mean over a pixel of `of` each colour.
    fn mean(&self, x: f64, y: f64, t_ns: i64, of: impl Fn(&[f64; 3]) -> f64) -> f64 {
        let (distance, at) = self.polar_place(x, y, t_ns);
        let inside = self.disk.coverage(distance);
        if inside == 0.0 {
            return WALL;
        }
        // A pixel is never wider than the whole turn.
        let pixel = self.disk.pixel(distance).min(self.disk.parts);
        let (low, high) = (at - pixel / 2.0, at + pixel / 2.0);
        let mut sum = 0.0;
        let mut sector = low.floor();
        while sector < high {
            let overlap = high.min(sector + 1.0) - low.max(sector);
            sum += overlap * of(&COLOURS[sector.rem_euclid(self.disk.parts) as usize % COLOURS.len()]);
            sector += 1.0;
        }
        blend(WALL, sum / pixel, inside)
    }
}

impl ClosedScene for ColourWheel {
    fn light(&self, x: f64, y: f64, t_ns: i64) -> f64 {
        self.mean(x, y, t_ns, |colour| luminance(*colour))
    }

    fn channel(&self, channel: usize, x: f64, y: f64, t_ns: i64) -> f64 {
        self.mean(x, y, t_ns, |colour| colour[channel])
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
    fn sectors_have_their_colours_and_turn() {
        // Six sectors of 60 degrees; 500 rpm is 3 degrees a millisecond, 60 degrees in 20 ms.
        let params =
            ColourWheelParams { sectors: 6, speed: Rotation::new(500.0), ..ColourWheelParams::default() };
        let wheel = ColourWheel::new(&params, EXTENT);
        for (turns, sector) in [(0, 0), (1, 1), (4, 3), (6, 5)] {
            // The middle of a sector at that time, 18 pixels from the centre: clockwise on the screen, y
            // down.
            let angle = (60.0 * (f64::from(sector) + 0.5) + 60.0 * f64::from(turns)).to_radians();
            let (x, y) = (
                wheel.disk.centre.0 + 18.0 * libm::cos(angle),
                wheel.disk.centre.1 + 18.0 * libm::sin(angle),
            );
            for channel in 0..3 {
                let found = wheel.channel(channel, x, y, i64::from(turns) * 20_000_000);
                assert!(
                    (found - COLOURS[sector as usize][channel]).abs() < 1e-9,
                    "sector {sector}, channel {channel}: {found}"
                );
            }
        }
    }

    #[test]
    fn luminance_is_the_weighted_sum_of_the_channels_everywhere() {
        let wheel = ColourWheel::new(&ColourWheelParams::default(), EXTENT);
        for (x, y) in [(40.0, 30.0), (39.0, 29.0), (52.3, 20.1), (66.9, 30.0), (2.0, 2.0)] {
            let sum = luminance([0, 1, 2].map(|channel| wheel.channel(channel, x, y, 3_333_333)));
            assert!((wheel.light(x, y, 3_333_333) - sum).abs() < 1e-12);
        }
    }
}
