//! What changes its shape all over: water, fire, and a surface that swings.

use super::motion::Motion;
use super::picture::Picture;
use super::{bounded, each, speeds, texture};
use crate::random::Random;
use crate::scene::Grid;
use crate::texture::Texture;
use serde_json::{Value, json};
use std::f64::consts::PI;

/// One travelling wave: wave vector (rad/px), angular frequency (rad/s), phase, and slope.
#[derive(Clone, Copy, Debug)]
struct Wave {
    k: [f64; 2],
    omega: f64,
    phase: f64,
    slope: [f64; 2],
}

/// Travelling waves: the log light follows their slope, the bottom is seen through them, and where the slope
/// mirrors the sun there is a glint.
#[derive(Clone, Debug)]
pub struct Water {
    waves: Vec<Wave>,
    /// How the log light follows the slopes.
    sky: [f64; 2],
    sun: [f64; 2],
    /// Width of a glint, in slope.
    glint: f64,
    bottom: Texture,
    /// Pixels the bottom is shifted by a slope of 1.
    depth: f64,
}

impl Water {
    const WAVES: usize = 10;

    pub fn draw(random: &mut Random) -> Self {
        let wind = random.between(0.0, 2.0 * PI);
        // Of water deep enough: the speed goes with the root of the wavelength.
        let speed = random.between(90.0, 160.0);
        let mut waves: Vec<Wave> = (0..Self::WAVES)
            .map(|_| {
                let length = random.log_between(5.0, 45.0);
                let (angle, k) = (wind + random.between(-0.9, 0.9), 2.0 * PI / length);
                let slope = libm::pow(length / 15.0, -0.2);
                let direction = [libm::cos(angle), libm::sin(angle)];
                Wave {
                    k: direction.map(|c| k * c),
                    omega: k * speed * libm::sqrt(length / 12.0),
                    phase: random.between(0.0, 2.0 * PI),
                    slope: direction.map(|c| slope * c),
                }
            })
            .collect();
        let square: f64 = waves
            .iter()
            .map(|wave| 0.5 * (wave.slope[0] * wave.slope[0] + wave.slope[1] * wave.slope[1]))
            .sum();
        let scale = 1.0 / libm::sqrt(square);
        waves.iter_mut().for_each(|wave| wave.slope = wave.slope.map(|s| s * scale));
        let (sky, sun) = (wind + random.between(-0.7, 0.7), wind + random.between(-0.6, 0.6));
        let high = random.between(1.1, 1.6);
        Self {
            waves,
            sky: [0.3 * libm::cos(sky), 0.3 * libm::sin(sky)],
            sun: [high * libm::cos(sun), high * libm::sin(sun)],
            glint: random.between(0.25, 0.4),
            bottom: texture(random),
            depth: random.between(1.0, 3.0),
        }
    }

    pub fn pattern(&self, t: f64, grid: &Grid, out: &mut [f64]) {
        // Cosine and sine of each wave along a row, by turning on from pixel to pixel.
        let turns: Vec<[f64; 2]> =
            self.waves.iter().map(|wave| [libm::cos(wave.k[0]), libm::sin(wave.k[0])]).collect();
        for (row, values) in out.chunks_exact_mut(grid.columns).enumerate() {
            let y = grid.top + row as f64;
            let mut now: Vec<[f64; 2]> = self
                .waves
                .iter()
                .map(|wave| {
                    let at = wave.k[0] * grid.left + wave.k[1] * y - wave.omega * t + wave.phase;
                    [libm::cos(at), libm::sin(at)]
                })
                .collect();
            for (column, value) in values.iter_mut().enumerate() {
                let mut slope = [0.0; 2];
                for ((wave, now), turn) in self.waves.iter().zip(&mut now).zip(&turns) {
                    slope[0] += wave.slope[0] * now[0];
                    slope[1] += wave.slope[1] * now[0];
                    *now = [now[0] * turn[0] - now[1] * turn[1], now[1] * turn[0] + now[0] * turn[1]];
                }
                *value = self.light(grid.left + column as f64, y, slope);
            }
        }
    }

    fn light(&self, x: f64, y: f64, slope: [f64; 2]) -> f64 {
        let bottom = bounded(self.bottom.at(x + self.depth * slope[0], y + self.depth * slope[1]));
        let (dx, dy) = (slope[0] - self.sun[0], slope[1] - self.sun[1]);
        let near = 1.0 / (1.0 + (dx * dx + dy * dy) / (self.glint * self.glint));
        self.sky[0] * slope[0] + self.sky[1] * slope[1] + 0.25 * bottom - 0.2 + 1.1 * near * near
    }

    pub fn answer(&self, pace: f64) -> Value {
        let of = |wave: &Wave| {
            let k = libm::sqrt(wave.k[0] * wave.k[0] + wave.k[1] * wave.k[1]);
            [2.0 * PI / k, wave.omega / k]
        };
        json!({ "wavelength_px": speeds(self.waves.iter().map(|wave| of(wave)[0]), 1.0),
                "speed_px_s": speeds(self.waves.iter().map(|wave| of(wave)[1]), pace) })
    }
}

/// Textures rise at three speeds and bend each other; the light of each place flickers.
#[derive(Clone, Debug)]
pub struct Fire {
    textures: [Texture; 3],
    rise: [f64; 3],
    /// Reach (px), frequency (Hz) and phase of the swaying.
    sway: [f64; 3],
    flicker: f64,
    depth: f64,
    height: f64,
}

impl Fire {
    pub fn draw(random: &mut Random, [_, height]: [f64; 2]) -> Self {
        Self {
            textures: [texture(random), texture(random), texture(random)],
            rise: [random.between(60.0, 110.0), random.between(120.0, 190.0), random.between(40.0, 90.0)],
            sway: [random.between(1.0, 4.0), random.between(3.0, 8.0), random.between(0.0, 2.0 * PI)],
            flicker: random.between(8.0, 16.0),
            depth: random.between(0.3, 0.6),
            height,
        }
    }

    pub fn pattern(&self, clock: f64, t: f64, grid: &Grid, out: &mut [f64]) {
        let [slow, fast, bend] = &self.textures;
        let [reach, hz, phase] = self.sway;
        each(grid, out, |x, y| {
            let up = 1.0 - y / self.height;
            let sway = reach * (0.3 + up) * libm::sin(2.0 * PI * hz * clock + phase + 0.08 * y);
            let bending = bounded(bend.at(x, y + self.rise[2] * t));
            let u = x + sway + 3.0 * bending;
            let flame = 0.6 * bounded(slow.at(u, y + self.rise[0] * t))
                + 0.5 * bounded(fast.at(u, y + self.rise[1] * t));
            let flicker = self.depth * libm::sin(2.0 * PI * self.flicker * clock + 2.5 * bending + 0.05 * x);
            bounded(flame * (1.0 + 0.5 * flicker) + 0.5 * flicker + 0.8 * (0.5 - up))
        });
    }

    pub fn answer(&self, pace: f64) -> Value {
        json!({ "rise_px_s": self.rise.map(|v| v * pace), "sway_px": self.sway[0], "sway_hz": self.sway[1],
                "flicker_hz": self.flicker })
    }
}

/// A photograph on a surface that swings: a displacement of several waves that stand.
#[derive(Clone, Debug)]
pub struct Warp {
    picture: Picture,
    motion: Motion,
    modes: Vec<Mode>,
}

/// One standing wave of the displacement.
#[derive(Clone, Copy, Debug)]
struct Mode {
    k: [f64; 2],
    phase: f64,
    /// Displacement at its crest, pixels.
    reach: [f64; 2],
    hz: f64,
    start: f64,
}

impl Warp {
    pub fn draw(random: &mut Random, size: [f64; 2], sigma: f64) -> Self {
        let picture = Picture::photograph(random, sigma);
        let motion = Motion::drift(random, size, 120.0, 0.5);
        let mode = |random: &mut Random| {
            let (length, way) = (random.between(35.0, 90.0), random.between(0.0, 2.0 * PI));
            let (k, across) = (2.0 * PI / length, random.between(0.0, 2.0 * PI));
            // A quarter of a radian of shear at most for each: nothing folds.
            let reach = random.between(0.15, 0.25) / k;
            Mode {
                k: [k * libm::cos(way), k * libm::sin(way)],
                phase: random.between(0.0, 2.0 * PI),
                reach: [reach * libm::cos(across), reach * libm::sin(across)],
                hz: random.between(3.0, 8.0),
                start: random.between(0.0, 2.0 * PI),
            }
        };
        let modes = (0..4).map(|_| mode(random)).collect();
        Self { picture, motion, modes }
    }

    pub fn pattern(&self, clock: f64, t: f64, grid: &Grid, out: &mut [f64]) {
        let at = self.motion.at(clock, t);
        let reaches: Vec<f64> =
            self.modes.iter().map(|mode| libm::sin(2.0 * PI * mode.hz * clock + mode.start)).collect();
        each(grid, out, |x, y| {
            let mut moved = [x, y];
            for (mode, now) in self.modes.iter().zip(&reaches) {
                let crest = now * libm::sin(mode.k[0] * x + mode.k[1] * y + mode.phase);
                moved[0] += mode.reach[0] * crest;
                moved[1] += mode.reach[1] * crest;
            }
            let [u, v] = at.of(moved[0], moved[1]);
            self.picture.at(u, v)
        });
    }

    pub fn answer(&self, pace: f64) -> Value {
        let reach = |mode: &Mode| libm::sqrt(mode.reach[0] * mode.reach[0] + mode.reach[1] * mode.reach[1]);
        let mut answer = self.motion.answer(pace);
        answer["swing_px"] = speeds(self.modes.iter().map(reach), 1.0);
        answer["swing_hz"] = speeds(self.modes.iter().map(|mode| mode.hz), 1.0);
        answer
    }
}
