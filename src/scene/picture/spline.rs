//! Uniform cubic B-splines: the weights of the four coefficients around a place, along one axis.

/// Coefficients along one axis that a value depends on.
pub(crate) const ORDER: usize = 4;

/// Weights of the four coefficients from the one before the interval on, at a share `f` (0 to 1) of the
/// interval.
#[inline(always)]
pub(crate) fn weights(f: f64) -> [f64; ORDER] {
    let g = 1.0 - f;
    [
        g * g * g / 6.0,
        (4.0 - 6.0 * f * f + 3.0 * f * f * f) / 6.0,
        (4.0 - 6.0 * g * g + 3.0 * g * g * g) / 6.0,
        f * f * f / 6.0,
    ]
}

/// Derivatives of [`weights`] by `f`.
#[inline]
pub(crate) fn slopes(f: f64) -> [f64; ORDER] {
    let g = 1.0 - f;
    [-0.5 * g * g, -2.0 * f + 1.5 * f * f, 2.0 * g - 1.5 * g * g, 0.5 * f * f]
}

/// The picture's coefficients on a plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplineGrid {
    /// Place of the first coefficient, pixels from the array's centre.
    pub x0: f64,
    /// See there.
    pub y0: f64,
    /// Distance of coefficients, pixels.
    pub pitch: f64,
    /// Columns of coefficients.
    pub width: usize,
    /// Rows of coefficients.
    pub height: usize,
}

impl SplineGrid {
    /// The grid of `pitch` pixels over a box of places, with one interval to spare on each side.
    pub fn covering(low: (f64, f64), high: (f64, f64), pitch: f64) -> SplineGrid {
        let count = |low: f64, high: f64| ((high - low) / pitch).ceil().max(0.0) as usize + ORDER + 2;
        SplineGrid {
            x0: low.0 - 2.0 * pitch,
            y0: low.1 - 2.0 * pitch,
            pitch,
            width: count(low.0, high.0),
            height: count(low.1, high.1),
        }
    }

    /// Number of coefficients.
    pub fn coefficients(&self) -> usize {
        self.width * self.height
    }

    /// The interval of a place along both axes (column and row of the first of its coefficients) and its
    /// share of it; `None` outside.
    #[inline(always)]
    pub fn locate(&self, x: f64, y: f64) -> Option<(usize, usize, f64, f64)> {
        let (x, y) = ((x - self.x0) / self.pitch, (y - self.y0) / self.pitch);
        // Whole parts of positive numbers; what is not is outside.
        let (i, j) = (x as i64 as f64, y as i64 as f64);
        let inside = i >= 1.0 && j >= 1.0 && i + 3.0 <= self.width as f64 && j + 3.0 <= self.height as f64;
        inside.then(|| (i as usize - 1, j as usize - 1, x - i, y - j))
    }

    /// The value of a surface at a place; `None` outside.
    #[inline(always)]
    pub fn value(&self, surface: &[f32], x: f64, y: f64) -> Option<f64> {
        let (i, j, f, g) = self.locate(x, y)?;
        let (wx, wy) = (weights(f), weights(g));
        let mut sum = 0.0;
        for (row, wy) in wy.iter().enumerate() {
            let line = &surface[(j + row) * self.width + i..][..ORDER];
            sum += wy
                * (wx[0] * f64::from(line[0])
                    + wx[1] * f64::from(line[1])
                    + wx[2] * f64::from(line[2])
                    + wx[3] * f64::from(line[3]));
        }
        Some(sum)
    }

    /// The value of a surface at a place; outside of the grid that of its edge.
    pub fn nearest(&self, surface: &[f32], x: f64, y: f64) -> f64 {
        let edge = |at: f64, first: f64, count: usize| {
            at.clamp(first + 1.001 * self.pitch, first + (count as f64 - 3.001) * self.pitch)
        };
        self.value(surface, edge(x, self.x0, self.width), edge(y, self.y0, self.height)).unwrap_or(f64::NAN)
    }

    /// A grid over the same places with `by` coefficients for one.
    #[must_use]
    pub fn finer(&self, by: usize) -> SplineGrid {
        SplineGrid {
            pitch: self.pitch / by as f64,
            width: self.width * by,
            height: self.height * by,
            ..*self
        }
    }

    /// The gradient of a surface at a place, per pixel; zero outside.
    #[inline]
    pub fn gradient(&self, surface: &[f32], x: f64, y: f64) -> (f64, f64) {
        let Some((i, j, f, g)) = self.locate(x, y) else { return (0.0, 0.0) };
        let (wx, wy, sx, sy) = (weights(f), weights(g), slopes(f), slopes(g));
        let mut sum = (0.0, 0.0);
        for row in 0..ORDER {
            let line = &surface[(j + row) * self.width + i..][..ORDER];
            let (mut value, mut slope) = (0.0, 0.0);
            for (n, c) in line.iter().enumerate() {
                value += wx[n] * f64::from(*c);
                slope += sx[n] * f64::from(*c);
            }
            sum.0 += wy[row] * slope;
            sum.1 += sy[row] * value;
        }
        (sum.0 / self.pitch, sum.1 / self.pitch)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_reproduced_and_gradients_are_differences() {
        let grid = SplineGrid::covering((-3.0, -2.0), (4.0, 5.0), 0.7);
        let line: Vec<f32> = (0..grid.coefficients())
            .map(|k| {
                (2.0 + 0.5 * (grid.x0 + grid.pitch * (k % grid.width) as f64)
                    - 0.25 * (grid.y0 + grid.pitch * (k / grid.width) as f64)) as f32
            })
            .collect();
        for (x, y) in [(-3.0, -2.0), (0.2, 1.3), (4.0, 5.0)] {
            assert!((grid.value(&line, x, y).unwrap() - (2.0 + 0.5 * x - 0.25 * y)).abs() < 1e-5);
        }
        assert_eq!(grid.value(&line, 9.0, 0.0), None);
        let rough: Vec<f32> = (0..grid.coefficients()).map(|k| libm::sin(1.7 * k as f64) as f32).collect();
        let (x, y, step) = (0.31, 1.77, 1e-4);
        let difference = |dx: f64, dy: f64| {
            (grid.value(&rough, x + dx, y + dy).unwrap() - grid.value(&rough, x - dx, y - dy).unwrap())
                / (2.0 * step)
        };
        let (gx, gy) = grid.gradient(&rough, x, y);
        assert!((gx - difference(step, 0.0)).abs() < 1e-5 && (gy - difference(0.0, step)).abs() < 1e-5);
    }
}
