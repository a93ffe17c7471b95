//! `slingshot_egg`: a small fast pellet hits an egg, and the debris flies apart.
//!
//! The egg is cut into shards: bands of random height across a slanted frame, each cut at random places. At
//! the instant of the hit they still make the whole egg, without a seam; from then on each flies straight,
//! away from the hit and forwards, and tumbles. The pellet goes on behind, slower. Where shards overlap, the
//! pixel is their mean by coverage.

use super::shapes::{arrival, blend, covered, hypot, rotate};
use super::surface::Texture;
use super::{BRIGHTEST, ClosedScene};
use photocurrent_core::Extent;
use photocurrent_core::quantity::Duration;
use photocurrent_core::random::Random;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Parameters of the scene `slingshot_egg`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SlingshotEggParams {
    /// Speed of the pellet before the hit, pixels per millisecond, to the right.
    #[schemars(range(min = 0.1, max = 1000.0))]
    pub speed: f64,
    /// Radius of the pellet, pixels.
    #[schemars(range(min = 0.5, max = 1000.0))]
    pub radius: f64,
    /// When the pellet hits.
    #[schemars(extend("x-min" = "0 ns", "x-max" = "1000 s"))]
    pub impact: Duration,
    /// Speed of the fastest debris, pixels per millisecond.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub debris_speed: f64,
}

impl Default for SlingshotEggParams {
    fn default() -> Self {
        SlingshotEggParams { speed: 15.0, radius: 3.0, impact: Duration::new(20_000_000), debris_speed: 2.0 }
    }
}

/// What is left of the pellet's speed after the hit.
const SLOWED: f64 = 0.6;

/// Reflectance of the pellet.
const PELLET: f64 = 0.05;

/// How the frame that the egg is cut along stands, radians.
const SLANT: f64 = 0.45;

/// A shard: a rectangle of the slanted frame, bounded by the shell.
struct Shard {
    /// Its middle when the egg was whole, from the egg's middle.
    home: (f64, f64),
    /// Half its sides along the slanted frame, pixels.
    half: (f64, f64),
    /// Pixels per nanosecond.
    velocity: (f64, f64),
    /// Radians per nanosecond.
    spin: f64,
    /// Of its fastest corner, pixels per nanosecond.
    fastest: f64,
}

impl Shard {
    /// From its middle to its corners, pixels.
    fn corner(&self) -> f64 {
        hypot(self.half.0, self.half.1)
    }
}

/// Cuts `-reach` to `reach` into stretches of random length, 0.5 to 1.5 of `mean`: middle and half length of
/// each. The last one may stand over.
fn random_stretches(reach: f64, mean: f64, random: &mut Random) -> Vec<(f64, f64)> {
    let mut stretches = Vec::new();
    let mut at = -reach;
    while at < reach {
        let half = 0.5 * mean * (0.5 + random.uniform());
        stretches.push((at + half, half));
        at += 2.0 * half;
    }
    stretches
}

/// The scene.
pub struct SlingshotEgg {
    centre: (f64, f64),
    /// Half axes of the egg, pixels.
    axes: (f64, f64),
    pieces: Vec<Shard>,
    /// The pellet's middle when it hits.
    hit: (f64, f64),
    impact_ns: i64,
    pellet_speed: f64,
    pellet_radius: f64,
    /// Of the debris.
    fastest: f64,
    wall: Texture,
}

impl SlingshotEgg {
    /// For a picture of that size.
    pub fn new(params: &SlingshotEggParams, extent: Extent, seed: u64) -> SlingshotEgg {
        let (width, height) = (f64::from(extent.width), f64::from(extent.height));
        let side = width.min(height);
        let (centre, axes) = ((0.62 * width, 0.5 * height), (0.16 * side, 0.21 * side));
        // A little above the middle.
        let above = 0.25 * axes.1;
        let face = axes.0 * (1.0 - (above / axes.1) * (above / axes.1)).sqrt();
        let hit = (centre.0 - face - params.radius, centre.1 - above);
        let mean = (0.055 * side).max(2.0);
        let mut random = Random::new(seed, &[0]);
        let mut pieces = Vec::new();
        // The half axes' larger one, and the outline's filter.
        let reach = axes.0.max(axes.1) + 1.0;
        for (v, half_v) in random_stretches(reach, mean, &mut random) {
            for (u, half_u) in random_stretches(reach, mean, &mut random) {
                let (home, half) = (rotate((u, v), (libm::sin(SLANT), libm::cos(SLANT))), (half_u, half_v));
                // The distance is exact at the outline only, so there is room to spare: what has no shell
                // costs a little time and shows nothing.
                if outside_ellipse(home, axes) > 1.5 * hypot(half_u, half_v) + 1.0 {
                    continue;
                }
                let (away_x, away_y) = (home.0 + centre.0 - hit.0, home.1 + centre.1 - hit.1);
                let distance = hypot(away_x, away_y).max(1.0);
                let speed = params.debris_speed * 1e-6 * (0.3 + 0.7 * random.uniform()) / 1.4;
                // Away from the hit and forwards, and a little askew: not faster than 1.4 of that in all.
                let askew = 0.3 * (random.uniform() - 0.5);
                let velocity =
                    (speed * (away_x / distance * 0.9 + 0.3), speed * (away_y / distance * 0.9 + askew));
                // Up to ten turns per second.
                let spin = TAU * 20e-9 * (random.uniform() - 0.5);
                let fastest = hypot(velocity.0, velocity.1) + spin.abs() * (hypot(half_u, half_v) + 0.5);
                pieces.push(Shard { home, half, velocity, spin, fastest });
            }
        }
        SlingshotEgg {
            centre,
            axes,
            fastest: pieces.iter().map(|piece| piece.fastest).fold(0.0, f64::max),
            pieces,
            hit,
            impact_ns: params.impact.ns(),
            pellet_speed: params.speed * 1e-6,
            pellet_radius: params.radius,
            wall: Texture::new(0.08, 0.4, seed, 1),
        }
    }

    fn pellet_at(&self, t_ns: i64) -> (f64, f64) {
        let since = (t_ns - self.impact_ns) as f64;
        (self.hit.0 + self.pellet_speed * since * if since > 0.0 { SLOWED } else { 1.0 }, self.hit.1)
    }

    /// The shell's reflectance at a place from the egg's middle: light comes from above left.
    fn shell_reflectance(&self, (x, y): (f64, f64)) -> f64 {
        let (u, v) = (x / self.axes.0 + 0.35, y / self.axes.1 + 0.4);
        (0.93 - 0.2 * (u * u + v * v)).clamp(0.3, BRIGHTEST)
    }

    /// Share of the pixel that egg covers (more than one where pieces overlap), and that times its
    /// reflectance.
    fn egg(&self, x: f64, y: f64, t_ns: i64) -> (f64, f64) {
        let (x, y) = (x - self.centre.0, y - self.centre.1);
        if t_ns <= self.impact_ns {
            let share = covered(outside_ellipse((x, y), self.axes));
            return (share, if share > 0.0 { share * self.shell_reflectance((x, y)) } else { 0.0 });
        }
        let since = (t_ns - self.impact_ns) as f64;
        let (mut shares, mut light) = (0.0, 0.0);
        for piece in &self.pieces {
            let (dx, dy) =
                (x - piece.home.0 - piece.velocity.0 * since, y - piece.home.1 - piece.velocity.1 * since);
            if hypot(dx, dy) > piece.corner() + 1.0 {
                continue;
            }
            let angle = -piece.spin * since;
            let from_home = rotate((dx, dy), (libm::sin(angle), libm::cos(angle)));
            let at = (from_home.0 + piece.home.0, from_home.1 + piece.home.1);
            let (u, v) = rotate(from_home, (-libm::sin(SLANT), libm::cos(SLANT)));
            let share = covered(u.abs() - piece.half.0) * covered(v.abs() - piece.half.1);
            if share > 0.0 {
                let share = share * covered(outside_ellipse(at, self.axes));
                shares += share;
                light += share * self.shell_reflectance(at);
            }
        }
        (shares, light)
    }
}

/// Signed distance to an ellipse around the origin, exact to first order at the outline.
fn outside_ellipse((x, y): (f64, f64), (a, b): (f64, f64)) -> f64 {
    let (size, slope) = (hypot(x / a, y / b), hypot(x / (a * a), y / (b * b)));
    if slope == 0.0 { -a.min(b) } else { size * (size - 1.0) / slope }
}

impl ClosedScene for SlingshotEgg {
    fn light(&self, x: f64, y: f64, t_ns: i64) -> f64 {
        let (shares, light) = self.egg(x, y, t_ns);
        let (px, py) = self.pellet_at(t_ns);
        let pellet = covered(hypot(x - px, y - py) - self.pellet_radius);
        // The pellet flies before the wall and, from the hit on, behind the shell.
        let behind = blend(self.wall.at(x, y), PELLET, pellet);
        if shares <= 1.0 { light + (1.0 - shares) * behind } else { light / shares }
    }

    fn speed(&self, _: f64, y: f64) -> f64 {
        let on_its_way = (y - self.hit.1).abs() < self.pellet_radius + 1.0;
        if on_its_way { self.pellet_speed.max(self.fastest) } else { self.fastest }
    }

    fn still_until(&self, x: f64, y: f64, t_ns: i64) -> i64 {
        let (px, py) = self.pellet_at(t_ns);
        let pellet = arrival(t_ns, (hypot(x - px, y - py) - self.pellet_radius).abs(), self.pellet_speed);
        let (x, y) = (x - self.centre.0, y - self.centre.1);
        let since = (t_ns - self.impact_ns).max(0) as f64;
        let start = t_ns.max(self.impact_ns);
        let arrivals = self.pieces.iter().map(|piece| {
            let (dx, dy) =
                (x - piece.home.0 - piece.velocity.0 * since, y - piece.home.1 - piece.velocity.1 * since);
            // Half a pixel of the filter goes round the corner of a shard.
            arrival(start, hypot(dx, dy) - piece.corner() - 0.25, piece.fastest)
        });
        // Before the hit the whole egg stands still.
        pellet.min(arrivals.min().unwrap_or(i64::MAX))
    }
}

#[cfg(test)]
mod tests {
    use super::super::EXTENT;
    use super::*;

    fn egg() -> SlingshotEgg {
        SlingshotEgg::new(&SlingshotEggParams::default(), EXTENT, 7)
    }

    #[test]
    fn pieces_make_the_whole_egg_without_a_seam_when_the_pellet_hits() {
        let egg = egg();
        for (x, y) in
            EXTENT.rows().iter().flat_map(|y| (0..EXTENT.width).map(move |x| (f64::from(x), f64::from(y))))
        {
            let (before, after) = (egg.egg(x, y, 20_000_000), egg.egg(x, y, 20_000_001));
            assert!(
                (before.0 - after.0).abs() < 1e-4 && (before.1 - after.1).abs() < 1e-4,
                "({x}, {y}): {before:?} and {after:?}"
            );
        }
    }

    #[test]
    fn the_egg_keeps_its_area_until_debris_leaves_the_picture() {
        let egg = egg();
        let area = |ms: i64| -> f64 {
            let pixels = EXTENT
                .rows()
                .iter()
                .flat_map(|y| (0..EXTENT.width).map(move |x| (f64::from(x), f64::from(y))));
            pixels.map(|(x, y)| egg.egg(x, y, ms * 1_000_000).0).sum()
        };
        assert!((area(10) - std::f64::consts::PI * egg.axes.0 * egg.axes.1).abs() < 1.0, "{}", area(10));
        // Turned shards are small rectangles, drawn with the filter along their own axes: a hundredth.
        assert!((area(25) / area(10) - 1.0).abs() < 0.02, "{} becomes {}", area(10), area(25));
    }

    #[test]
    fn the_pellet_flies_as_fast_as_stated_and_touches_the_shell_at_the_hit() {
        let egg = egg();
        let (before, hit) = (egg.pellet_at(18_000_000), egg.pellet_at(20_000_000));
        assert!((hit.0 - before.0 - 30.0).abs() < 1e-9 && hit.1 == before.1);
        let gap = outside_ellipse((hit.0 + egg.pellet_radius - egg.centre.0, hit.1 - egg.centre.1), egg.axes);
        assert!(gap.abs() < 1e-9, "{gap}");
        assert!(egg.light(before.0.round(), before.1.round(), 18_000_000) < 0.06);
    }

    #[test]
    fn debris_is_no_faster_than_stated() {
        let egg = egg();
        assert!(egg.pieces.len() > 20);
        assert!(egg.pieces.iter().all(|piece| hypot(piece.velocity.0, piece.velocity.1) <= 2.0e-6));
    }
}
