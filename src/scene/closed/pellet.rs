//! `pellet`: round pellets that fly straight and bounce off the borders, before a textured wall.

use super::shapes::{arrival, blend, bounce, hypot};
use super::surface::Texture;
use super::{BRIGHTEST, ClosedScene};
use photocurrent_core::Extent;
use photocurrent_core::random::Random;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Parameters of the scene `pellet`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PelletParams {
    /// Number of pellets.
    #[schemars(range(min = 1, max = 100))]
    pub pellets: u32,
    /// Radius of a pellet, pixels.
    #[schemars(range(min = 0.5, max = 1000.0))]
    pub radius: f64,
    /// Speed of the fastest pellet, pixels per millisecond; the others are down to half as fast.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub speed: f64,
}

impl Default for PelletParams {
    fn default() -> Self {
        PelletParams { pellets: 3, radius: 4.0, speed: 12.0 }
    }
}

/// Straight flights, reflected by the borders: start and velocity in pixels and pixels per nanosecond.
pub struct Flights {
    flights: Vec<[f64; 4]>,
    radius: f64,
    width: f64,
    height: f64,
}

impl Flights {
    /// Draws them. A pellet must fit into the picture.
    pub fn new(count: u32, radius: f64, speed: f64, extent: Extent, seed: u64) -> Flights {
        let mut random = Random::new(seed, &[0]);
        let (width, height) = (f64::from(extent.width), f64::from(extent.height));
        let flights = (0..count)
            .map(|_| {
                let speed = speed * (0.5 + 0.5 * random.uniform()) * 1e-6;
                let angle = std::f64::consts::TAU * random.uniform();
                [
                    random.uniform() * width,
                    random.uniform() * height,
                    speed * libm::cos(angle),
                    speed * libm::sin(angle),
                ]
            })
            .collect();
        Flights { flights, radius, width, height }
    }

    /// Where the pellets' centres are.
    pub fn centres(&self, t_ns: i64) -> impl Iterator<Item = (f64, f64)> {
        let inside = |size: f64| size - 1.0 - self.radius;
        let t = t_ns as f64;
        let centre = move |[x, y, vx, vy]: &[f64; 4]| {
            (
                bounce(x + vx * t, self.radius, inside(self.width)),
                bounce(y + vy * t, self.radius, inside(self.height)),
            )
        };
        self.flights.iter().map(centre)
    }

    /// How much of a pixel pellets at `centres` cover, 0 to 1; the rim is one pixel wide.
    pub fn coverage(&self, x: f64, y: f64, centres: impl IntoIterator<Item = (f64, f64)>) -> f64 {
        let reach = (self.radius + 0.5) * (self.radius + 0.5);
        let mut seen_through = 1.0;
        for (cx, cy) in centres {
            let squared = (x - cx) * (x - cx) + (y - cy) * (y - cy);
            if squared < reach {
                seen_through *= 1.0 - (self.radius + 0.5 - squared.sqrt()).min(1.0);
            }
        }
        1.0 - seen_through
    }

    fn speeds(&self) -> impl Iterator<Item = f64> {
        self.flights.iter().map(|[_, _, vx, vy]| hypot(*vx, *vy))
    }
}

/// Is there a place in the picture for a pellet of that radius?
pub fn fits(radius: f64, extent: Extent) -> bool {
    2.0 * radius + 1.0 < f64::from(extent.width.min(extent.height))
}

/// The scene.
pub struct Pellets {
    flights: Flights,
    fastest: f64,
    wall: Texture,
}

impl Pellets {
    /// For a picture of that size.
    pub fn new(params: &PelletParams, extent: Extent, seed: u64) -> Pellets {
        let flights = Flights::new(params.pellets, params.radius, params.speed, extent, seed);
        let fastest = flights.speeds().fold(0.0, f64::max);
        Pellets { flights, fastest, wall: Texture::new(0.1, 0.5, seed, 1) }
    }
}

impl ClosedScene for Pellets {
    fn light(&self, x: f64, y: f64, t_ns: i64) -> f64 {
        blend(self.wall.at(x, y), BRIGHTEST, self.flights.coverage(x, y, self.flights.centres(t_ns)))
    }

    fn speed(&self, _: f64, _: f64) -> f64 {
        self.fastest
    }

    fn still_until(&self, x: f64, y: f64, t_ns: i64) -> i64 {
        let pellets = self.flights.centres(t_ns).zip(self.flights.speeds());
        pellets
            .map(|((cx, cy), speed)| {
                arrival(t_ns, (hypot(x - cx, y - cy) - self.flights.radius).abs(), speed)
            })
            .min()
            .unwrap_or(i64::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::super::EXTENT;
    use super::*;

    #[test]
    fn the_brightest_place_is_where_a_pellet_is() {
        let scene = Pellets::new(&PelletParams { pellets: 1, ..PelletParams::default() }, EXTENT, 7);
        for t in [0, 3_000_000, 47_000_000] {
            let (x, y) = scene.flights.centres(t).next().unwrap();
            assert_eq!(scene.light(x.round(), y.round(), t), BRIGHTEST);
            assert!((4.0..76.0).contains(&x) && (4.0..56.0).contains(&y));
            // Beyond the rim the wall is seen.
            assert_eq!(scene.light(x + 4.6, y, t), scene.wall.at(x + 4.6, y));
        }
    }

    #[test]
    fn pellets_fly_as_fast_as_stated() {
        let flights = Flights::new(50, 2.0, 8.0, EXTENT, 7);
        assert!(flights.speeds().all(|speed| (4.0e-6..8.0e-6).contains(&speed)));
    }
}
