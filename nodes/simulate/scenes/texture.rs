//! `texture`: a natural texture that slides, so that every pixel changes all the time.

use super::shapes::Texture;
use super::{BRIGHTEST, DARKEST, Scene};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Parameters of the scene `texture`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TextureParams {
    /// How fast it slides, pixels per millisecond.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub speed: f64,
    /// Where to, degrees clockwise from the right.
    #[schemars(range(min = -180.0, max = 180.0))]
    pub heading: f64,
}

impl Default for TextureParams {
    fn default() -> Self {
        TextureParams { speed: 1.0, heading: 30.0 }
    }
}

/// The scene.
pub struct SlidingTexture {
    surface: Texture,
    /// Pixels per nanosecond.
    velocity: (f64, f64),
    speed: f64,
}

impl SlidingTexture {
    /// The same for every size of picture.
    pub fn new(params: &TextureParams, seed: u64) -> SlidingTexture {
        let (speed, heading) = (params.speed * 1e-6, params.heading.to_radians());
        SlidingTexture { surface: Texture::new(DARKEST, BRIGHTEST, seed, 1), velocity: (speed * libm::cos(heading), speed * libm::sin(heading)), speed }
    }
}

impl Scene for SlidingTexture {
    fn reflectance(&self, x: f64, y: f64, t_ns: i64) -> f64 {
        self.surface.at(x - self.velocity.0 * t_ns as f64, y - self.velocity.1 * t_ns as f64)
    }

    fn speed(&self, _: f64, _: f64) -> f64 {
        self.speed
    }

    fn still_until(&self, _: f64, _: f64, t_ns: i64) -> i64 {
        if self.speed == 0.0 { i64::MAX } else { t_ns }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_that_slides_along_sees_the_same() {
        let texture = SlidingTexture::new(&TextureParams { speed: 3.0, heading: -90.0 }, 7);
        for (x, y) in [(0.0, 0.0), (13.5, 200.25)] {
            // 3 pixels per millisecond up.
            assert!((texture.reflectance(x, y, 0) - texture.reflectance(x, y - 21.0, 7_000_000)).abs() < 1e-6);
        }
    }
}
