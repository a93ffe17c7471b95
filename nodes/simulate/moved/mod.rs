//! A photo that moves: the picture as a smooth function ([`spline`]) under a motion that is exact at any
//! instant ([`motion`]).

pub mod motion;
pub mod spline;

use motion::Motion;
use photocurrent_scene::closed::ClosedScene;
use spline::Spline;

/// A photo's luminance, and its red, green and blue where it is seen in colours; all of one size.
pub struct Planes {
    /// Luminance, 0 to 1.
    pub grey: Spline,
    /// Light behind each filter.
    pub channels: Option<[Spline; 3]>,
}

/// A photo under a motion, as a scene: its reflectance is the photo's light, from `black` to 1.
pub struct MovingPhoto<'a> {
    photo: &'a Planes,
    motion: Motion,
    /// Darkest light, as a share of white's.
    black: f64,
    /// End of the light, ns: bounds of speed hold until then.
    end_ns: i64,
}

impl<'a> MovingPhoto<'a> {
    /// Of light from 0 to `end_ns`.
    pub fn new(photo: &'a Planes, motion: Motion, black: f64, end_ns: i64) -> MovingPhoto<'a> {
        MovingPhoto { photo, motion, black, end_ns }
    }
}

impl MovingPhoto<'_> {
    fn seen(&self, plane: &Spline, x: f64, y: f64, t_ns: i64) -> f64 {
        let seen = self.motion.seen(x, y, t_ns);
        plane.at(seen.x, seen.y, seen.spacing).clamp(self.black, 1.0)
    }
}

impl ClosedScene for MovingPhoto<'_> {
    fn light(&self, x: f64, y: f64, t_ns: i64) -> f64 {
        self.seen(&self.photo.grey, x, y, t_ns)
    }

    fn channel(&self, channel: usize, x: f64, y: f64, t_ns: i64) -> f64 {
        let plane = self.photo.channels.as_ref().map_or(&self.photo.grey, |channels| &channels[channel]);
        self.seen(plane, x, y, t_ns)
    }

    fn speed(&self, x: f64, y: f64) -> f64 {
        self.motion.fastest(x, y, self.end_ns)
    }

    fn still_until(&self, _: f64, _: f64, t_ns: i64) -> i64 {
        if self.motion.rests() { i64::MAX } else { t_ns }
    }
}

#[cfg(test)]
mod tests {
    use super::motion::tests::{SIZE, lively};
    use super::spline::Outside;
    use super::*;

    #[test]
    fn nothing_crosses_a_pixel_faster_than_the_scene_says() {
        // A slope of the photo's light times the speed bounds what changes; this photo's steepest slope is
        // 0.4 of 16 / TAU a pixel.
        let wave = |x: usize, y: usize| {
            0.5 + 0.4 * libm::sin((x as f64 + 0.5 * y as f64) * std::f64::consts::TAU / 16.0)
        };
        let grey = Spline::new(
            64,
            48,
            (0..48).flat_map(|y| (0..64).map(move |x| wave(x, y))).collect(),
            Outside::Mirror,
        );
        let photo = Planes { grey, channels: None };
        let steepest = 0.4 * std::f64::consts::TAU / 16.0 * 1.25_f64.sqrt() * 1.01;
        let end = 80_000_000;
        let scene = MovingPhoto::new(&photo, lively(), 0.01, end);
        let mut most: f64 = 0.0;
        for (x, y) in
            (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (f64::from(x), f64::from(y)))).step_by(37)
        {
            for t in (0..79).map(|k| k * 1_000_000 + 137) {
                let change = (scene.light(x, y, t + 1000) - scene.light(x, y, t)).abs() / 1000.0;
                most = most.max(change / (steepest * scene.speed(x, y)));
            }
        }
        // The bound holds, and is no idle one.
        assert!(most <= 1.0 && most > 0.3, "{most}");
    }
}
