//! The picture: a smooth surface over its own coordinates, of quadratic B-splines.

/// Places next to each other along one axis that a point of the surface depends on.
pub(super) const TAPS: usize = 3;

/// Where the coefficients stand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Grid {
    /// Place of the first coefficient, pixels from the sensor's middle.
    pub x0: f64,
    pub y0: f64,
    /// Distance of coefficients, pixels.
    pub pitch: f64,
    pub width: usize,
    pub height: usize,
}

/// What a point of the surface is made of: nine coefficients.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Taps {
    /// Index of the first of them.
    pub first: u32,
    pub x: [f32; TAPS],
    pub y: [f32; TAPS],
}

impl Grid {
    /// The grid of `pitch` pixels over a box of places.
    pub fn over(low: (f64, f64), high: (f64, f64), pitch: f64) -> Grid {
        let count = |low: f64, high: f64| ((high - low) / pitch).ceil() as usize + 2 * TAPS;
        Grid { x0: low.0 - TAPS as f64 * pitch, y0: low.1 - TAPS as f64 * pitch, pitch, width: count(low.0, high.0), height: count(low.1, high.1) }
    }

    pub fn len(&self) -> usize {
        self.width * self.height
    }

    /// The taps of a place and the derivatives of its weights by the place, per pixel; `None` outside.
    #[inline]
    pub fn taps(&self, x: f64, y: f64) -> Option<(Taps, [f32; TAPS], [f32; TAPS])> {
        let (x, y) = ((x - self.x0) / self.pitch, (y - self.y0) / self.pitch);
        let (i, j) = (x.round(), y.round());
        if !(i >= 1.0 && j >= 1.0 && i + 2.0 <= self.width as f64 && j + 2.0 <= self.height as f64) {
            return None;
        }
        let weights = |f: f64| [(0.5 * (0.5 - f) * (0.5 - f)) as f32, (0.75 - f * f) as f32, (0.5 * (0.5 + f) * (0.5 + f)) as f32];
        let slopes = |f: f64| [((f - 0.5) / self.pitch) as f32, (-2.0 * f / self.pitch) as f32, ((f + 0.5) / self.pitch) as f32];
        let (f, g) = (x - i, y - j);
        let first = (j as usize - 1) * self.width + (i as usize - 1);
        Some((Taps { first: first as u32, x: weights(f), y: weights(g) }, slopes(f), slopes(g)))
    }

    /// The surface with these weights.
    #[inline]
    pub fn look(&self, surface: &[f32], first: u32, x: &[f32; TAPS], y: &[f32; TAPS]) -> f32 {
        let mut sum = 0.0;
        for (j, y) in y.iter().enumerate() {
            let line = &surface[first as usize + j * self.width..][..TAPS];
            sum += y * (x[0] * line[0] + x[1] * line[1] + x[2] * line[2]);
        }
        sum
    }

    /// Adds `value` times the weights to the coefficients.
    #[inline]
    pub fn spread(&self, surface: &mut [f32], taps: &Taps, value: f32) {
        for (j, y) in taps.y.iter().enumerate() {
            let line = &mut surface[taps.first as usize + j * self.width..][..TAPS];
            for (x, line) in taps.x.iter().zip(line) {
                *line += value * y * x;
            }
        }
    }
}
