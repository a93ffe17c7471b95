//! A known target: a rotating star of bright and dark spokes before a wall, and the file that states it up to
//! ranges.
//!
//! A star is the scene `siemens_disk` of `simulate/scene`: a pixel sees the mean of its spokes along the
//! circle through its centre, and as much of the disc as an edge across a pixel lets it see. Light is
//! illuminance x photocurrent of a lux x reflectance.

use crate::random::Random;
use serde_json::{Value, json};
use std::f64::consts::PI;

/// Reflectance around the disc.
pub const WALL: f64 = 0.3;

/// The star as it really turns; lengths in pixels, angles in radians, clockwise with y down.
#[derive(Clone, Debug)]
pub struct Star {
    /// Bright spokes, and as many dark ones.
    pub spokes: f64,
    pub radius: f64,
    pub dark: f64,
    pub bright: f64,
    pub centre: [f64; 2],
    /// Radians a second.
    pub omega: f64,
    /// How long it had turned when the clock stood at 0, seconds.
    pub start: f64,
}

/// The integral of a wave that is 1 on [0, 1) and -1 on [1, 2): a triangle.
fn triangle(u: f64) -> f64 {
    1.0 - (u.rem_euclid(2.0) - 1.0).abs()
}

impl Star {
    /// What a pixel centred at (`x`, `y`) sends back of the light at time `t`.
    pub fn reflectance(&self, x: f64, y: f64, t: f64) -> f64 {
        let (dx, dy) = (x - self.centre[0], y - self.centre[1]);
        let distance = libm::sqrt(dx * dx + dy * dy);
        let on_disc = (self.radius - distance + 0.5).clamp(0.0, 1.0);
        if on_disc == 0.0 {
            return WALL;
        }
        // In spokes, of which a turn has twice the number of bright ones; the first bright one begins at +x
        // when nothing has turned yet.
        let in_spokes = self.spokes / PI;
        let at = in_spokes * (libm::atan2(dy, dx) - self.omega * (t + self.start));
        let half = 0.5 * in_spokes / distance.max(0.5);
        let wave = (triangle(at + half) - triangle(at - half)) / (2.0 * half);
        let star = 0.5 * (self.bright + self.dark) + 0.5 * (self.bright - self.dark) * wave;
        on_disc * star + (1.0 - on_disc) * WALL
    }

    /// Seconds from one bright spoke to the next.
    fn period(&self) -> f64 {
        2.0 * PI / (self.spokes * self.omega)
    }
}

/// A star, the light on it, and what is stated of both.
#[derive(Clone, Debug)]
pub struct Target {
    pub star: Star,
    /// Radius as a share of the array's shorter side.
    share: f64,
    /// Light on it, lux.
    illuminance: f64,
    /// Photocurrent of one lux.
    pub per_lux: f64,
    shift: [f64; 2],
}

/// A number of so many digits behind the point.
fn round(v: f64, digits: i32) -> f64 {
    let scale = libm::pow(10.0, f64::from(digits));
    (v * scale).round() / scale
}

/// Revolutions a minute to radians a second.
const RPM: f64 = 2.0 * PI / 60.0;

impl Target {
    /// A star before an array of that size, at 300 rpm: how fast it turns is set when the events are counted.
    pub fn draw(random: &mut Random, [width, height]: [usize; 2]) -> Self {
        let share = round(random.between(0.42, 0.49), 2);
        let shift = [random.between(-1.2, 1.2), random.between(-1.2, 1.2)];
        let centre = [0.5 * (width - 1) as f64 + shift[0], 0.5 * (height - 1) as f64 + shift[1]];
        let star = Star {
            spokes: (2 + random.below(5)) as f64,
            radius: share * width.min(height) as f64,
            dark: random.log_between(0.1, 0.3),
            bright: round(random.between(0.7, 0.92), 2),
            centre,
            omega: 300.0 * RPM,
            start: 0.0,
        };
        let illuminance = random.log_between(100.0, 600.0);
        let per_lux = round(random.log_between(40.0, 300.0) / illuminance, 4);
        Self { star, share, illuminance, per_lux, shift }
    }

    /// Photocurrent of a reflectance of 1.
    pub fn white(&self) -> f64 {
        self.illuminance * self.per_lux
    }

    /// Lets it turn `pace` times as fast, and begin somewhere within a third of the way from spoke to spoke.
    pub fn turn(&mut self, pace: f64, random: &mut Random) {
        self.star.omega *= pace;
        self.star.start = random.between(-0.15, 0.15) * self.star.period();
    }

    /// The file that states the star: what is free has a range that holds the truth, which is drawn apart
    /// from what is stated.
    pub fn file(&self, random: &mut Random) -> String {
        let star = &self.star;
        let rpm = star.omega / RPM;
        let stated = round(rpm * random.between(0.98, 1.02), 1);
        let speed = [round(0.95 * stated, 1), round(1.05 * stated, 1)];
        let lux = (self.illuminance * random.log_between(0.85, 1.18)).round();
        let light = [(0.65 * lux).round(), (1.5 * lux).round()];
        let dark = round(star.dark * random.between(0.9, 1.1), 3);
        let darks = [round(0.8 * dark, 3), round(1.25 * dark, 3)];
        let most = round(250.0 * star.period(), 3);
        format!(
            "# What stood before the sensor: a star that turns. Values in [free] are known to a range; all \
             others are as stated.\n\
             scene        = \"siemens_disk\"\n\
             siemens_disk = {{ spokes = {}, radius = {:?}, dark = {dark:?}, bright = {:?}, speed = \
             \"{stated} rpm\" }}\n\
             illuminance  = \"{lux} lx\"\n\n\
             [free]\n\
             \"siemens_disk.speed\" = [\"{} rpm\", \"{} rpm\"]\n\
             \"siemens_disk.dark\"  = [{:?}, {:?}]\n\
             illuminance          = [\"{} lx\", \"{} lx\"]\n\
             start                = [\"-{most} ms\", \"{most} ms\"]\n\
             shift_x              = [-1.5, 1.5]\n\
             shift_y              = [-1.5, 1.5]\n",
            star.spokes, self.share, star.bright, speed[0], speed[1], darks[0], darks[1], light[0], light[1],
        )
    }

    /// The truth for the list of answers.
    pub fn answer(&self, pace: f64) -> Value {
        let star = &self.star;
        json!({
            "family": "siemens_disk", "pace": pace, "spokes": star.spokes, "radius": self.share,
            "dark": star.dark, "bright": star.bright,
            "speed_rpm": star.omega / RPM, "start_s": star.start, "shift_x": self.shift[0],
            "shift_y": self.shift[1],
            "illuminance_lx": self.illuminance, "per_lux": self.per_lux,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn star() -> Star {
        Star {
            spokes: 5.0,
            radius: 20.0,
            dark: 0.1,
            bright: 0.8,
            centre: [30.5, 24.0],
            omega: 10.0,
            start: 2e-3,
        }
    }

    /// Reflectance at a distance and angle from the centre.
    fn at(star: &Star, distance: f64, angle: f64, t: f64) -> f64 {
        star.reflectance(
            star.centre[0] + distance * libm::cos(angle),
            star.centre[1] + distance * libm::sin(angle),
            t,
        )
    }

    #[test]
    fn a_pixel_sees_the_mean_of_its_spokes_along_the_circle() {
        let star = star();
        // The mean over an arc of one pixel of a wave that is bright on [0, pi / 5) and dark on [pi / 5, 2 pi
        // / 5), by counting.
        for (distance, angle, t) in [(12.3, 0.4, 7e-3), (3.1, 2.0, 0.1), (18.9, -1.3, 0.03), (0.2, 1.0, 0.01)]
        {
            let arc = 1.0 / f64::max(distance, 0.5);
            let turned = 10.0 * (t + 2e-3);
            let n = 200_000;
            let bright = (0..n).filter(|k| {
                let along = angle - turned + arc * ((f64::from(*k) + 0.5) / f64::from(n) - 0.5);
                ((along * 5.0 / PI).floor() as i64).rem_euclid(2) == 0
            });
            let mean = 0.1 + 0.7 * bright.count() as f64 / f64::from(n);
            assert!(
                (at(&star, distance, angle, t) - mean).abs() < 2e-4,
                "{distance} {angle} {t}: {} {mean}",
                at(&star, distance, angle, t)
            );
        }
    }

    #[test]
    fn an_edge_turns_clockwise_with_the_stated_speed() {
        let star = star();
        for t in [-2e-3, 0.0, 0.013, 0.2] {
            let edge = 10.0 * (t + 2e-3);
            assert!((at(&star, 15.0, edge, t) - 0.45).abs() < 1e-9, "the edge is half bright and half dark");
            assert!(
                (at(&star, 15.0, edge + 0.1, t) - 0.8).abs() < 1e-12
                    && (at(&star, 15.0, edge - 0.1, t) - 0.1).abs() < 1e-12
            );
            // Half way up the ramp that the edge makes over one pixel.
            assert!((at(&star, 15.0, edge + 0.25 / 15.0, t) - (0.45 + 0.25 * 0.7)).abs() < 1e-9);
        }
    }

    #[test]
    fn the_rim_covers_one_pixel_and_the_wall_is_beyond() {
        let star = star();
        let inside = 0.8;
        for (beyond, share) in [(-0.5, 1.0), (-0.2, 0.7), (0.0, 0.5), (0.4, 0.1), (0.5, 0.0), (9.0, 0.0)] {
            let seen = at(&star, 20.0 + beyond, 0.02 + 0.3, 0.0);
            assert!((seen - (share * inside + (1.0 - share) * WALL)).abs() < 1e-9, "{beyond}: {seen}");
        }
    }

    #[test]
    fn what_is_stated_has_ranges_that_hold_the_truth() {
        let mut random = Random::named("targets");
        for _ in 0..200 {
            let mut target = Target::draw(&mut random, [64, 48]);
            let pace = random.log_between(0.15, 3.0);
            target.turn(pace, &mut random);
            let text = target.file(&mut random);
            let range = |name: &str| -> [f64; 2] {
                let line = text
                    .lines()
                    .find(|line| line.trim_start_matches('"').starts_with(name) && line.contains('['))
                    .expect("a line of that name");
                let inner =
                    line.split_once('[').and_then(|(_, rest)| rest.split_once(']')).expect("a range").0;
                let ends: Vec<f64> = inner
                    .split(',')
                    .map(|end| end.trim_matches([' ', '"']).split(' ').next().unwrap().parse().unwrap())
                    .collect();
                [ends[0], ends[1]]
            };
            let truth = [
                ("siemens_disk.speed", target.star.omega / RPM),
                ("siemens_disk.dark", target.star.dark),
                ("illuminance", target.illuminance),
                ("start", 1e3 * target.star.start),
                ("shift_x", target.shift[0]),
                ("shift_y", target.shift[1]),
            ];
            for (name, truth) in truth {
                let [low, high] = range(name);
                let margin = 0.05 * (high - low);
                assert!(
                    (low + margin..high - margin).contains(&truth),
                    "{name} = {truth} is not well \
                                                            within {low} to {high}\n{text}"
                );
            }
        }
    }
}
