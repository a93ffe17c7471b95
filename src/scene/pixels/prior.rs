//! Variances of the light's second differences, one per pixel and knot, by expectation maximisation.
//!
//! Source: MacKay, Bayesian interpolation, Neural Computation 4 (1992): the variance is the sum of squares
//! over the number of parameters that the measurements determine. Both are summed over neighbouring pixels
//! and knots, so that the variance follows the activity of the scene in space and time.

/// Number of neighbouring pixels to either side that are included.
const AROUND: usize = 1;
/// And knots.
const BEFORE_AND_AFTER: usize = 1;
/// Weight of a pixel's own mean over all knots, in determined differences.
const OF_PIXEL: f64 = 0.3;
/// And the mean of all pixels in a pixel's mean.
const OF_ALL: f64 = 1.0;
/// Variances between which all lie, natural-log units squared.
const LIMITS: (f64, f64) = (1e-8, 1.0);

/// Sums of squares and of decided shares over a block of pixels, [y][x][k].
pub(super) struct PriorBlock<'a> {
    pub width: usize,
    pub height: usize,
    pub square: &'a [f64],
    pub decided: &'a [f64],
}

impl PriorBlock<'_> {
    /// The variances, in the order of the squares; `all`: mean variance of all blocks.
    pub(super) fn variances(&self, all: f64) -> Vec<f64> {
        let count = self.square.len() / (self.width * self.height);
        let square = self.sum_of_neighbours(self.square, count);
        let decided = self.sum_of_neighbours(self.decided, count);
        let mut out = Vec::with_capacity(self.square.len());
        for (square, decided) in square.chunks(count).zip(decided.chunks(count)) {
            let total: f64 = square.iter().sum();
            let mean = (total + OF_ALL * all) / (decided.iter().sum::<f64>() + OF_ALL);
            out.extend((0..count).map(|k| {
                let near = k.saturating_sub(BEFORE_AND_AFTER)..(k + BEFORE_AND_AFTER + 1).min(count);
                let (s, g) = (square[near.clone()].iter().sum::<f64>(), decided[near].iter().sum::<f64>());
                ((s + OF_PIXEL * mean) / (g + OF_PIXEL)).clamp(LIMITS.0, LIMITS.1)
            }));
        }
        out
    }

    /// Sums over the pixels around each.
    fn sum_of_neighbours(&self, values: &[f64], count: usize) -> Vec<f64> {
        let mut out = vec![0.0; values.len()];
        for y in 0..self.height {
            for x in 0..self.width {
                let to = (y * self.width + x) * count;
                for ny in y.saturating_sub(AROUND)..(y + AROUND + 1).min(self.height) {
                    for nx in x.saturating_sub(AROUND)..(x + AROUND + 1).min(self.width) {
                        let from = (ny * self.width + nx) * count;
                        for k in 0..count {
                            out[to + k] += values[from + k];
                        }
                    }
                }
            }
        }
        out
    }
}

/// The mean of a variance over everything that is decided.
pub(super) fn overall(square: &[f64], decided: &[f64]) -> f64 {
    square.iter().sum::<f64>() / (decided.iter().sum::<f64>() + 1e-9)
}
