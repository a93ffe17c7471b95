//! How a camera moves before a flat picture: a hand that shakes, drift, turning, and growing.

use crate::random::Random;
use serde_json::{Value, json};
use std::f64::consts::PI;

/// A movement; its shaking runs by the clock, the rest by the family's time.
#[derive(Clone, Debug)]
pub struct Motion {
    centre: [f64; 2],
    velocity: [f64; 2],
    /// Radians a second.
    turn: f64,
    /// ln of the size a second.
    zoom: f64,
    /// For x and y: amplitude (px), frequency (Hz) and phase of two swings each.
    shake: [[[f64; 3]; 2]; 2],
}

/// A movement at one instant: an affine map from a pixel to the picture.
#[derive(Clone, Copy, Debug)]
pub struct At {
    centre: [f64; 2],
    shift: [f64; 2],
    cos: f64,
    sin: f64,
}

impl At {
    /// Where the picture is seen that pixel (x, y) shows.
    pub fn of(&self, x: f64, y: f64) -> [f64; 2] {
        let (dx, dy) = (x - self.centre[0] - self.shift[0], y - self.centre[1] - self.shift[1]);
        [self.centre[0] + self.cos * dx - self.sin * dy, self.centre[1] + self.sin * dx + self.cos * dy]
    }
}

impl Motion {
    fn still(random: &mut Random, [width, height]: [f64; 2], speed: f64) -> Self {
        let angle = random.between(0.0, 2.0 * PI);
        Self {
            centre: [width * random.between(0.3, 0.7), height * random.between(0.3, 0.7)],
            velocity: [speed * libm::cos(angle), speed * libm::sin(angle)],
            turn: 0.0,
            zoom: 0.0,
            shake: [[[0.0; 3]; 2]; 2],
        }
    }

    /// Straight on at up to `speed` (px/s), turning by up to `turn` (rad/s).
    pub fn drift(random: &mut Random, size: [f64; 2], speed: f64, turn: f64) -> Self {
        let speed = speed * random.between(0.6, 1.0);
        let mut motion = Self::still(random, size, speed);
        motion.turn = turn * random.between(-1.0, 1.0);
        motion
    }

    /// A camera in a hand: shaking by `reach` px at 3 to 12 Hz in both directions, with some drift, turning
    /// and growing.
    pub fn hand(random: &mut Random, size: [f64; 2], reach: [f64; 2]) -> Self {
        let speed = random.between(20.0, 250.0);
        let mut motion = Self::still(random, size, speed);
        motion.turn = random.between(-1.5, 1.5);
        motion.zoom = random.between(-1.2, 1.2);
        let swing = |random: &mut Random, share: f64| {
            let amplitude = share * random.log_between(reach[0], reach[1]);
            [amplitude, random.between(3.0, 12.0), random.between(0.0, 2.0 * PI)]
        };
        for axis in &mut motion.shake {
            *axis = [swing(random, 0.75), swing(random, 0.25)];
        }
        motion
    }

    /// A page that is pulled along its lines or across them, and shaken.
    pub fn page(random: &mut Random, size: [f64; 2]) -> Self {
        let mut motion = Self::hand(random, size, [0.5, 3.0]);
        let (along, across) = (random.sign() * random.between(120.0, 350.0), random.between(-60.0, 60.0));
        motion.velocity = if random.chance(0.6) { [along, across] } else { [across, along] };
        motion.turn = random.between(-1.0, 1.0);
        motion.zoom = random.between(-0.5, 0.5);
        motion
    }

    /// The map at `clock` (s), when the family's own time is `t`.
    pub fn at(&self, clock: f64, t: f64) -> At {
        let shake = |axis: &[[f64; 3]; 2]| -> f64 {
            axis.iter().map(|[reach, hz, phase]| reach * libm::sin(2.0 * PI * hz * clock + phase)).sum()
        };
        let shift = [0, 1].map(|k| shake(&self.shake[k]) + self.velocity[k] * t);
        let (scale, angle) = (libm::exp(-self.zoom * t), -self.turn * t);
        At { centre: self.centre, shift, cos: scale * libm::cos(angle), sin: scale * libm::sin(angle) }
    }

    pub fn answer(&self, pace: f64) -> Value {
        let swings: Vec<&[f64; 3]> = self.shake.iter().flatten().filter(|[reach, ..]| *reach > 0.0).collect();
        json!({
            "velocity_px_s": self.velocity.map(|v| v * pace), "turn_rad_s": self.turn * pace,
            "zoom_per_s": self.zoom * pace,
            "shake_px": swings.iter().map(|swing| swing[0]).collect::<Vec<f64>>(),
            "shake_hz": swings.iter().map(|swing| swing[1]).collect::<Vec<f64>>(),
        })
    }
}
