//! `basketball`: a ball with seams and pebbled skin that spins, bounces on the floor and runs between the
//! walls.
//!
//! The ball is a sphere seen from far away: a pixel inside the outline is a point of the surface, turned back
//! by the spin to find what is there. Outline and seams are anti-aliased by coverage; light comes from above
//! left.

use super::shapes::{arrival, blend, bounce, covered, hypot, radians_per_ns};
use super::surface::Texture;
use super::{ClosedScene, DARKEST};
use photocurrent_core::Extent;
use photocurrent_core::quantity::{Duration, Rotation};
use photocurrent_core::random::Random;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Parameters of the scene `basketball`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BasketballParams {
    /// Radius of the ball, as a share of the picture's smaller side.
    #[schemars(range(min = 0.02, max = 0.45))]
    pub radius: f64,
    /// Speed of its spin.
    #[schemars(extend("x-min" = "0 rpm", "x-max" = "100000 rpm"))]
    pub spin: Rotation,
    /// Time from one bounce on the floor to the next.
    #[schemars(extend("x-min" = "1 ms", "x-max" = "1000 s"))]
    pub bounce: Duration,
    /// Speed along the floor, pixels per millisecond.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub speed: f64,
}

impl Default for BasketballParams {
    fn default() -> Self {
        BasketballParams {
            radius: 0.22,
            spin: Rotation::new(150.0),
            bounce: Duration::new(300_000_000),
            speed: 0.6,
        }
    }
}

/// Half the width of a seam, and where the outer seams run, in radii.
const SEAM: f64 = 0.03;
const OUTER_SEAM: f64 = 0.62;

/// Reflectance of the leather where a pebble is brightest, and the darkest and the brightest place of its
/// skin as parts of that.
const LEATHER: f64 = 0.6;
const PEBBLES: (f64, f64) = (0.45, 1.0);

/// The flattest slant at which the surface is shown, as the cosine to the viewer.
const RIM: f64 = 0.3;

/// Where light comes from: right, down, towards the viewer.
const LIGHT: [f64; 3] = [-0.4, -0.6, 0.69];

/// The scene.
pub struct Basketball {
    radius: f64,
    size: (f64, f64),
    start: f64,
    /// Pixels per nanosecond.
    speed: f64,
    bounce_ns: f64,
    /// Radians per nanosecond, and around what.
    spin: f64,
    axis: [f64; 3],
    skin: Texture,
    wall: Texture,
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl Basketball {
    /// For a picture of that size.
    pub fn new(params: &BasketballParams, extent: Extent, seed: u64) -> Basketball {
        let mut random = Random::new(seed, &[0]);
        let (width, height) = (f64::from(extent.width), f64::from(extent.height));
        // Mostly towards the viewer, so that seams turn in the picture; tilted, so that they also come and
        // go.
        let (tilt, around) = (0.4 + 0.4 * random.uniform(), TAU * random.uniform());
        let axis =
            [libm::sin(tilt) * libm::cos(around), libm::sin(tilt) * libm::sin(around), libm::cos(tilt)];
        Basketball {
            radius: params.radius * width.min(height),
            size: (width, height),
            start: width * (0.25 + 0.25 * random.uniform()),
            speed: params.speed * 1e-6,
            bounce_ns: params.bounce.ns() as f64,
            spin: radians_per_ns(params.spin),
            axis,
            skin: Texture::new(PEBBLES.0, PEBBLES.1, seed, 2),
            wall: Texture::new(0.1, 0.6, seed, 1),
        }
    }

    /// How far the ball rises, pixels.
    fn rise(&self) -> f64 {
        (self.size.1 - 1.0 - 2.0 * self.radius) * 0.9
    }

    /// Where the ball's middle is: a parabola between bounces, starting at the top.
    fn centre(&self, t_ns: i64) -> (f64, f64) {
        let t = t_ns as f64;
        let flight = (t / self.bounce_ns + 0.5).rem_euclid(1.0);
        let up = 1.0 - (2.0 * flight - 1.0) * (2.0 * flight - 1.0);
        let walls = (self.radius, self.size.0 - 1.0 - self.radius);
        (
            bounce(self.start + self.speed * t, walls.0, walls.1),
            self.size.1 - 1.0 - self.radius - self.rise() * up,
        )
    }

    fn fastest(&self) -> f64 {
        hypot(self.speed, 4.0 * self.rise() / self.bounce_ns)
    }

    /// The ball's surface at a normal: shade, skin and seams.
    fn surface(&self, normal: [f64; 3], t_ns: i64) -> f64 {
        let angle = -self.spin * t_ns as f64;
        let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
        let (k, n) = (self.axis, normal);
        let across = [k[1] * n[2] - k[2] * n[1], k[2] * n[0] - k[0] * n[2], k[0] * n[1] - k[1] * n[0]];
        let along = dot(k, n) * (1.0 - cosine);
        let [bx, by, bz] = [0, 1, 2].map(|i| n[i] * cosine + across[i] * sine + k[i] * along);
        let to_seam = bx.abs().min(by.abs()).min((bx.abs() - OUTER_SEAM - 0.25 * by * by).abs());
        // Near the rim the surface is seen at a slant and a seam takes fewer pixels.
        let pixels = self.radius * normal[2].max(RIM);
        let seam = covered((to_seam - SEAM) * pixels) * (2.0 * SEAM * pixels).min(1.0);
        // There a pixel holds many pebbles and shows their mean. The skin is laid on along each axis,
        // weighted by how squarely it lies there: one plane alone would draw streaks where the sphere turns
        // away from it.
        let laid = |u: f64, v: f64| self.skin.at(self.radius * u, self.radius * v);
        let pebbles = bx * bx * laid(by, bz) + by * by * laid(bz, bx) + bz * bz * laid(bx, by);
        let skin = LEATHER
            * blend((PEBBLES.0 * PEBBLES.1).sqrt(), pebbles, (2.0 * (normal[2] - RIM)).clamp(0.0, 1.0));
        let shade = 0.35 + 0.65 * dot(normal, LIGHT).max(0.0);
        (shade * blend(skin, 0.05, seam)).max(DARKEST)
    }
}

impl ClosedScene for Basketball {
    fn light(&self, x: f64, y: f64, t_ns: i64) -> f64 {
        let (cx, cy) = self.centre(t_ns);
        let (dx, dy) = (x - cx, y - cy);
        let distance = hypot(dx, dy);
        let wall = self.wall.at(x, y);
        let inside = covered(distance - self.radius);
        if inside == 0.0 {
            return wall;
        }
        // On the outline the surface just inside is meant: seen at a slant at which it does not yet change
        // all at once.
        let shrink = ((1.0 - RIM * RIM).sqrt() * self.radius / distance.max(1e-9)).min(1.0) / self.radius;
        let (nx, ny) = (dx * shrink, dy * shrink);
        blend(wall, self.surface([nx, ny, (1.0 - nx * nx - ny * ny).max(0.0).sqrt()], t_ns), inside)
    }

    fn speed(&self, _: f64, _: f64) -> f64 {
        // Near the rim a place of the surface has its neighbours closer, so what is there changes sooner.
        2.0 * (self.fastest() + self.spin * self.radius)
    }

    fn still_until(&self, x: f64, y: f64, t_ns: i64) -> i64 {
        let (cx, cy) = self.centre(t_ns);
        arrival(t_ns, hypot(x - cx, y - cy) - self.radius, self.fastest())
    }
}

#[cfg(test)]
mod tests {
    use super::super::EXTENT;
    use super::*;

    #[test]
    fn the_ball_stays_inside_and_touches_the_floor() {
        let ball =
            Basketball::new(&BasketballParams { speed: 3.0, ..BasketballParams::default() }, EXTENT, 7);
        for t in (0..1000).map(|k| k * 1_370_000) {
            let (x, y) = ball.centre(t);
            assert!(
                x >= ball.radius && x <= 79.0 - ball.radius && y >= ball.radius && y <= 59.0 - ball.radius,
                "({x}, {y})"
            );
        }
        // From the top, half of 300 ms later.
        assert!((ball.centre(150_000_000).1 - (59.0 - ball.radius)).abs() < 1e-9);
    }

    #[test]
    fn it_falls_with_constant_acceleration() {
        let ball = Basketball::new(&BasketballParams::default(), EXTENT, 7);
        // From the top: the way grows with the square of time.
        let fallen = |ms: i64| ball.centre(ms * 1_000_000).1 - ball.centre(0).1;
        assert!((fallen(100) / fallen(50) - 4.0).abs() < 1e-9);
    }

    #[test]
    fn after_a_whole_turn_the_seams_stand_where_they_stood() {
        let ball = Basketball::new(
            &BasketballParams { spin: Rotation::new(600.0), ..BasketballParams::default() },
            EXTENT,
            7,
        );
        let normal = [0.3, 0.2, (1.0_f64 - 0.13).sqrt()];
        assert!((ball.surface(normal, 0) - ball.surface(normal, 100_000_000)).abs() < 1e-6);
        assert!(
            (0..100).any(|k| (ball.surface(normal, 0) - ball.surface(normal, k * 1_000_000)).abs() > 0.1)
        );
    }
}
