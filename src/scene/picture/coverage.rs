//! The light of a picture on a pixel, and how many exposures cover the place that lies there: where none
//! does, the picture is its neighbourhood extrapolated.

use super::estimate::ScenePicture;
use super::motion::AffineMap;
use super::products;

/// The still ground behind a pixel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StillGround {
    /// Its photocurrent; not finite where it is not known.
    pub ground: f64,
    /// [`ScenePicture::unit`].
    unit: f64,
}

impl StillGround {
    /// Photocurrent of the ground that shows behind a picture of this opacity.
    fn visible_share(&self, hidden: f64) -> f64 {
        (1.0 - hidden / self.unit) * self.ground
    }

    /// The derivative of that by a coefficient's value.
    pub(crate) fn by_hidden(&self) -> f64 {
        -self.ground / self.unit
    }
}

impl ScenePicture {
    /// Log photocurrent of a pixel at steady instants; outside of the picture the nearest value in time
    /// holds. `None` when it never saw the picture.
    pub fn log_light(&self, x: usize, y: usize, maps: &[AffineMap]) -> Option<Vec<f64>> {
        let place = (x as f64 - self.centre.0, y as f64 - self.centre.1);
        let pixel = y * (2.0 * self.centre.0 + 1.0) as usize + x;
        let shade = self.shade(place);
        let (own, hidden) = self.fields();
        let mut log = products::values(&self.grid, own, maps, place);
        if let Some(behind) = self.still_ground(pixel) {
            let hidden = products::values(&self.grid, hidden, maps, place);
            log.iter_mut().zip(hidden).for_each(|(light, hidden)| *light += behind.visible_share(hidden));
        }
        products::logarithms(&mut log, shade, self.least);
        let first = log.iter().copied().find(|value| !value.is_nan())?;
        let mut last = first;
        for value in &mut log {
            last = if value.is_nan() { last } else { *value };
            *value = last;
        }
        Some(log)
    }

    /// Coefficients of the picture, and of how much it hides; these empty where nothing is behind it.
    pub(super) fn fields(&self) -> (&[f32], &[f32]) {
        self.surface.split_at(self.grid.coefficients())
    }

    /// The still ground of a pixel, `y * width + x` of the array; none where nothing is behind the picture.
    pub(crate) fn still_ground(&self, pixel: usize) -> Option<StillGround> {
        let ground = f64::from(*self.ground.get(pixel)?);
        Some(StillGround { ground, unit: self.unit })
    }

    /// Photocurrent at a place of the picture, shading left out; none outside of it.
    pub(crate) fn value(&self, behind: Option<StillGround>, (x, y): (f64, f64)) -> Option<f64> {
        let (own, hidden) = self.fields();
        let still = match behind {
            Some(behind) => behind.visible_share(self.grid.value(hidden, x, y)?),
            None => 0.0,
        };
        Some(self.grid.value(own, x, y)? + still)
    }

    /// Its derivatives by the place, a pixel.
    pub(crate) fn gradient(&self, behind: Option<StillGround>, (x, y): (f64, f64)) -> (f64, f64) {
        let (own, hidden) = self.fields();
        let (gx, gy) = self.grid.gradient(own, x, y);
        let Some(by) = behind.map(|behind| behind.by_hidden()) else { return (gx, gy) };
        let (hx, hy) = self.grid.gradient(hidden, x, y);
        (gx + by * hx, gy + by * hy)
    }

    /// Number of exposures that recorded the place of the picture at a pixel, at steady instants; 0 outside
    /// of the picture, and for a picture that was not fitted.
    pub fn exposures_seen(&self, x: usize, y: usize, maps: &[AffineMap]) -> Vec<f64> {
        if self.coverage.is_empty() {
            return vec![0.0; maps.len()];
        }
        let place = (x as f64 - self.centre.0, y as f64 - self.centre.1);
        let mut exposures = products::values(&self.grid, &self.coverage, maps, place);
        exposures.iter_mut().filter(|sum| sum.is_nan()).for_each(|sum| *sum = 0.0);
        exposures
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::PictureSetting;
    use crate::picture::motion::apply;
    use crate::testing;
    use photocurrent_core::Extent;

    #[test]
    fn exposures_are_those_during_which_a_place_lay_on_the_array() {
        let case = testing::texture(Extent { width: 24, height: 18 }, 9);
        let picture = ScenePicture::fit(&case, &case.nominal().unwrap(), &PictureSetting::default()).unwrap();
        let fitted = picture.residual.iter().filter(|residual| residual.is_finite()).count() as f64;
        let all = picture.coverage.iter().map(|sum| f64::from(*sum)).sum::<f64>()
            * picture.grid.pitch
            * picture.grid.pitch;
        assert!((all / fitted - 1.0).abs() < 1e-3, "{all} of {fitted}");
        // Does a place lie on the array at an instant? By the inverse of the map.
        let times = &case.frames.as_ref().unwrap().times;
        let inside = |place: (f64, f64), t_ns: i64| {
            let map = picture.motion.at(t_ns);
            let (dx, dy) = (place.0 - map[0], place.1 - map[3]);
            let determinant = map[1] * map[5] - map[2] * map[4];
            let (x, y) =
                ((map[5] * dx - map[2] * dy) / determinant, (map[1] * dy - map[4] * dx) / determinant);
            x.abs() <= picture.centre.0 + 0.5 && y.abs() <= picture.centre.1 + 0.5
        };
        let mut compared = (0, 0);
        let instants = (0..40).map(|k| case.span.0 + (case.span.1 - case.span.0) * k / 40);
        for t_ns in instants {
            let map = picture.motion.at(t_ns);
            for (x, y) in [(0, 0), (23, 0), (0, 17), (23, 17), (12, 9), (1, 9)] {
                let found = picture.exposures_seen(x, y, &[map])[0];
                let place = apply(&map, x as f64 - picture.centre.0, y as f64 - picture.centre.1);
                let of_frame = |l: usize| {
                    let exposure = times.exposure(l, case.extent.height / 2);
                    let within = (0..60)
                        .filter(|n| {
                            inside(place, exposure.start.0 + (exposure.end.0 - exposure.start.0) * n / 60)
                        })
                        .count();
                    within as f64 / 60.0
                };
                let expected: f64 = (0..times.len()).map(of_frame).sum();
                // Splines blur the array's border over two pixels.
                compared.0 += 1;
                compared.1 += usize::from((found - expected).abs() < 0.5 + 0.1 * expected);
            }
        }
        assert!(10 * compared.1 > 9 * compared.0, "{compared:?}");
    }
}
