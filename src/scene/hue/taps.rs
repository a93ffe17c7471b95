//! Values of a picture between its pixels, where every pixel of another picture needs one.

use super::path::MotionPath;
use crate::image::Image;

/// Where every pixel of a picture is read in another one: the number of the first of four pixels, and how far
/// to the right of and below it.
pub(super) struct BilinearTaps {
    width: usize,
    at: Vec<(u32, f32, f32)>,
}

impl BilinearTaps {
    fn at_places(width: usize, height: usize, places: impl Iterator<Item = (f32, f32)>) -> BilinearTaps {
        let tap = |(x, y): (f32, f32)| {
            let (x, y) = (x.clamp(0.0, (width - 1) as f32), y.clamp(0.0, (height - 1) as f32));
            let (i, j) = (usize::min(x as usize, width - 2), usize::min(y as usize, height - 2));
            ((j * width + i) as u32, x - i as f32, y - j as f32)
        };
        BilinearTaps { width, at: places.map(tap).collect() }
    }

    /// At the pixels themselves.
    pub(super) fn identity(width: usize, height: usize) -> BilinearTaps {
        let places = (0..width * height).map(|k| ((k % width) as f32, (k / width) as f32));
        BilinearTaps::at_places(width, height, places)
    }

    /// Where the motion leads to.
    pub(super) fn new(
        path: &MotionPath<'_>,
        (width, height): (usize, usize),
        t_ns: &[i64],
        at: &(dyn Fn(usize) -> i64 + Sync),
    ) -> BilinearTaps {
        BilinearTaps::at_places(width, height, path.follow_pixels((width, height), t_ns, at).into_iter())
    }

    /// A picture's value for pixel k, bilinear.
    pub(super) fn read(&self, image: &Image, k: usize) -> f32 {
        let (at, dx, dy) = self.at[k];
        let at = at as usize;
        let v = &image.values;
        let above = v[at] + dx * (v[at + 1] - v[at]);
        let below = v[at + self.width] + dx * (v[at + self.width + 1] - v[at + self.width]);
        above + dy * (below - above)
    }
}
