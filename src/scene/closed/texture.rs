//! `texture`: a sliding natural texture, so that every pixel changes all the time.

use super::surface::Texture;
use super::{BRIGHTEST, ClosedScene, DARKEST};
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
    /// Difference of red, green and blue: 0 is grey, 1 makes them three independent textures.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub colourfulness: f64,
}

impl Default for TextureParams {
    fn default() -> Self {
        TextureParams { speed: 1.0, heading: 30.0, colourfulness: 0.0 }
    }
}

/// The scene.
pub struct SlidingTexture {
    surface: Texture,
    /// Red, green and blue; empty when the texture is grey.
    channels: Vec<Texture>,
    /// Pixels per nanosecond.
    velocity: (f64, f64),
    speed: f64,
}

impl SlidingTexture {
    /// The same for every size of picture.
    pub fn new(params: &TextureParams, seed: u64) -> SlidingTexture {
        let (speed, heading) = (params.speed * 1e-6, params.heading.to_radians());
        let texture = |stream| Texture::new(DARKEST, BRIGHTEST, seed, stream);
        let surface = texture(1);
        let coloured = 0..if params.colourfulness > 0.0 { 3 } else { 0 };
        let channels =
            coloured.map(|channel| surface.blend(&texture(2 + channel), params.colourfulness)).collect();
        SlidingTexture {
            surface,
            channels,
            velocity: (speed * libm::cos(heading), speed * libm::sin(heading)),
            speed,
        }
    }
}

impl SlidingTexture {
    fn log_reflectance(&self, texture: &Texture, x: f64, y: f64, t_ns: i64) -> f64 {
        texture.at(x - self.velocity.0 * t_ns as f64, y - self.velocity.1 * t_ns as f64)
    }
}

impl ClosedScene for SlidingTexture {
    fn light(&self, x: f64, y: f64, t_ns: i64) -> f64 {
        self.log_reflectance(&self.surface, x, y, t_ns)
    }

    fn channel(&self, channel: usize, x: f64, y: f64, t_ns: i64) -> f64 {
        self.log_reflectance(self.channels.get(channel).unwrap_or(&self.surface), x, y, t_ns)
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
    fn channels_differ_as_colourfulness_states() {
        let spread = |colourfulness: f64| {
            let texture =
                SlidingTexture::new(&TextureParams { colourfulness, ..TextureParams::default() }, 7);
            let apart = |k: i32| {
                let at = |channel| {
                    libm::log(texture.channel(channel, f64::from(k * 7 % 512), f64::from(k * 13 % 512), 0))
                };
                (at(0) - at(2)) * (at(0) - at(2))
            };
            libm::sqrt((0..500).map(apart).sum::<f64>() / 500.0)
        };
        assert_eq!(spread(0.0), 0.0);
        // Logarithms are mixed: half as colourful is half as far apart. (Places lie on the texture's own
        // grid, where it is not interpolated.)
        assert!(
            (spread(0.5) / spread(1.0) - 0.5).abs() < 1e-3 && spread(1.0) > 0.3,
            "{} {}",
            spread(0.5),
            spread(1.0)
        );
    }

    #[test]
    fn a_place_that_slides_along_sees_the_same() {
        let texture =
            SlidingTexture::new(&TextureParams { speed: 3.0, heading: -90.0, ..TextureParams::default() }, 7);
        for (x, y) in [(0.0, 0.0), (13.5, 200.25)] {
            // 3 pixels per millisecond up.
            assert!((texture.light(x, y, 0) - texture.light(x, y - 21.0, 7_000_000)).abs() < 1e-6);
        }
    }
}
