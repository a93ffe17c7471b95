//! A picture, and its values between pixels.

/// A picture: values row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Pixels of a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Values as [y * width + x].
    pub values: Vec<f32>,
}

impl Image {
    /// Value and gradient by x and y at a place in pixels from the first one, bilinear; `None` outside.
    #[inline]
    pub fn sample(&self, x: f64, y: f64) -> Option<(f64, f64, f64)> {
        let (width, height) = (self.width, self.height);
        if !(x >= 0.0 && y >= 0.0 && x <= (width - 1) as f64 && y <= (height - 1) as f64) {
            return None;
        }
        let ((i, dx), (j, dy)) = (bracketing_index(x, width), bracketing_index(y, height));
        // One row or column alone has no next one.
        let (right, below) = (usize::from(width > 1), if height > 1 { width } else { 0 });
        let v = |at: usize| f64::from(self.values[at]);
        let at = j * width + i;
        let (a, b, c, d) = (v(at), v(at + right), v(at + below), v(at + below + right));
        let value = (1.0 - dy) * ((1.0 - dx) * a + dx * b) + dy * ((1.0 - dx) * c + dx * d);
        Some((value, (1.0 - dy) * (b - a) + dy * (d - c), (1.0 - dx) * (c - a) + dx * (d - b)))
    }

    /// Place of the middle, pixels.
    pub(crate) fn centre(&self) -> (f64, f64) {
        (0.5 * (self.width as f64 - 1.0), 0.5 * (self.height as f64 - 1.0))
    }

    /// Smoothed with the binomial weights 1 2 1 along both axes, `times` over.
    #[must_use]
    pub(crate) fn smoothed(&self, times: usize) -> Image {
        let (w, h) = (self.width, self.height);
        let mut values = self.values.clone();
        for _ in 0..times {
            let old = values.clone();
            for y in 0..h {
                for x in 0..w {
                    let (l, r) = (old[y * w + x.saturating_sub(1)], old[y * w + (x + 1).min(w - 1)]);
                    values[y * w + x] = 0.25 * l + 0.5 * old[y * w + x] + 0.25 * r;
                }
            }
            let old = values.clone();
            for y in 0..h {
                for x in 0..w {
                    let (l, r) = (old[y.saturating_sub(1) * w + x], old[(y + 1).min(h - 1) * w + x]);
                    values[y * w + x] = 0.25 * l + 0.5 * old[y * w + x] + 0.25 * r;
                }
            }
        }
        Image { values, ..*self }
    }

    /// Of half as many pixels along either side, each the mean of four.
    pub(crate) fn halved(&self) -> Image {
        let (w, h) = (self.width / 2, self.height / 2);
        let at = |x: usize, y: usize| self.values[y * self.width + x];
        let values = (0..w * h)
            .map(|k| {
                let (x, y) = (2 * (k % w), 2 * (k / w));
                0.25 * (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1))
            })
            .collect();
        Image { width: w, height: h, values }
    }

    /// Smoothed by a Gaussian of `sigma` pixels; beyond the border it goes on as at the border.
    #[must_use]
    pub fn smoothed_by(&self, sigma: f64) -> Image {
        Image { values: smooth(&self.values, self.width, self.height, sigma), ..*self }
    }
}

/// The index of the first of the two samples around a place, and the distance behind it. Beyond the border
/// the place is extrapolated.
#[inline]
pub(crate) fn bracketing_index(at: f64, count: usize) -> (usize, f64) {
    let first = usize::min(at.max(0.0) as usize, count.saturating_sub(2));
    (first, at - first as f64)
}

/// A picture smoothed by a Gaussian; beyond the border it goes on as at the border.
pub fn smooth(picture: &[f32], width: usize, height: usize, sigma: f64) -> Vec<f32> {
    let reach = (2.5 * sigma).ceil() as usize;
    let half: Vec<f64> =
        (0..=reach).map(|k| libm::exp(-0.5 * (k as f64 / sigma) * (k as f64 / sigma))).collect();
    let total = half[0] + 2.0 * half[1..].iter().sum::<f64>();
    let kernel: Vec<f32> = half.iter().map(|w| (w / total) as f32).collect();
    let mut across = vec![0.0; picture.len()];
    for (line, out) in picture.chunks_exact(width).zip(across.chunks_exact_mut(width)) {
        for (x, value) in out.iter_mut().enumerate() {
            *value = kernel[0] * line[x];
            for (k, w) in kernel.iter().enumerate().skip(1) {
                *value += w * (line[x.saturating_sub(k)] + line[usize::min(x + k, width - 1)]);
            }
        }
    }
    let mut down = vec![0.0; picture.len()];
    for y in 0..height {
        let out = &mut down[y * width..(y + 1) * width];
        for (k, w) in kernel.iter().enumerate() {
            let (above, below) = (y.saturating_sub(k) * width, usize::min(y + k, height - 1) * width);
            for (x, value) in out.iter_mut().enumerate() {
                *value +=
                    if k == 0 { w * across[above + x] } else { w * (across[above + x] + across[below + x]) };
            }
        }
    }
    down
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_is_sampled_exactly_and_nothing_is_outside() {
        let plane = |x: f64, y: f64| 3.0 + 0.5 * x - 0.25 * y;
        for (width, height) in [(4, 3), (1, 3), (4, 1)] {
            let values =
                (0..width * height).map(|k| plane((k % width) as f64, (k / width) as f64) as f32).collect();
            let image = Image { width, height, values };
            let (x, y) = (0.75 * (width - 1) as f64, 0.5 * (height - 1) as f64);
            let (value, by_x, by_y) = image.sample(x, y).unwrap();
            assert_eq!(value, plane(x, y));
            assert_eq!(
                (by_x, by_y),
                (if width > 1 { 0.5 } else { 0.0 }, if height > 1 { -0.25 } else { 0.0 })
            );
            assert!(image.sample(-0.01, 0.0).is_none() && image.sample(0.0, height as f64 - 0.9).is_none());
        }
    }
}
