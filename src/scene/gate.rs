//! Selects the events around which the scene predicts the frames.

use crate::case::Case;

/// A place is predicted where frames miss by less than this, DN.
pub const LEAST_DN: f64 = 1.0;
/// The same limit in median absolute deviations.
pub const SPREAD: f64 = 4.5;

/// Mask of the places and frames that the scene predicts.
pub struct PredictionGate {
    /// Empty: all of them.
    good: Vec<bool>,
    middle_ns: Vec<Vec<i64>>,
    width: usize,
    pixels: usize,
}

impl PredictionGate {
    /// Accepts every event.
    pub fn accept_all() -> PredictionGate {
        PredictionGate { good: Vec::new(), middle_ns: Vec::new(), width: 1, pixels: 1 }
    }

    /// From residuals of frames as [frame][y][x], DN (NaN = not evaluated). A place is predicted where no
    /// residual of its 3 x 3 neighbourhood exceeds `least_dn` and `spread` median absolute deviations. Noise
    /// has no structure. Where residuals of neighbours are alike, deviations are those of their differences,
    /// or what `structure_dn` allows, and the mean of the neighbourhood is at most a third of them.
    pub fn new(
        case: &Case,
        residual: &[f32],
        (least_dn, structure_dn): (f64, f64),
        spread: f64,
    ) -> PredictionGate {
        let (width, height) = (case.extent.width as usize, case.extent.height as usize);
        let pixels = width * height;
        let all = spread * finite_median(residual.iter().copied());
        let rows = residual.chunks_exact(width);
        let white = spread
            * finite_median(rows.flat_map(|row| row.windows(2).map(|pair| pair[1] - pair[0])))
            * std::f64::consts::FRAC_1_SQRT_2;
        let allowed = |white: f64| f64::max(least_dn, f64::min(all, f64::max(white, structure_dn))) as f32;
        let (most, most_mean) = (allowed(white), allowed(white / 3.0));
        let count = case.frame_count();
        let mut good = vec![false; residual.len()];
        for l in 0..count {
            for y in 0..height {
                for x in 0..width {
                    let near = (y.saturating_sub(1)..(y + 2).min(height))
                        .flat_map(|j| (x.saturating_sub(1)..(x + 2).min(width)).map(move |i| j * width + i));
                    let (mut sum, mut number, mut is_good) = (0.0, 0.0, true);
                    for at in near {
                        let r = residual[l * pixels + at];
                        is_good &= r.abs() <= most;
                        (sum, number) = (sum + r, number + 1.0);
                    }
                    good[l * pixels + y * width + x] = is_good && (sum / number).abs() <= most_mean;
                }
            }
        }
        let times = case.frames.as_ref().map(|frames| &frames.times);
        let middle_ns = (0..height)
            .map(|y| {
                (0..count)
                    .filter_map(|l| times.map(|times| times.exposure(l, y as u32)))
                    .map(|exposure| i64::midpoint(exposure.start.0, exposure.end.0))
                    .collect()
            })
            .collect();
        PredictionGate { good, middle_ns, width, pixels }
    }

    /// Is an event of a pixel at an instant, ns, accepted? Both frames around it must be predicted there.
    pub fn accepts(&self, pixel: usize, t_ns: i64) -> bool {
        if self.good.is_empty() {
            return true;
        }
        let middle = &self.middle_ns[pixel / self.width];
        let after = middle.partition_point(|&t| t <= t_ns);
        let good = |l: usize| self.good[l * self.pixels + pixel];
        after > 0 && after < middle.len() && good(after - 1) && good(after)
    }
}

/// Median of sizes, those that are not finite left out; 0 of none.
fn finite_median(values: impl Iterator<Item = f32>) -> f64 {
    let mut sizes: Vec<f32> = values.filter(|r| r.is_finite()).map(f32::abs).collect();
    let at = sizes.len() / 2;
    if sizes.is_empty() { 0.0 } else { f64::from(*sizes.select_nth_unstable_by(at, f32::total_cmp).1) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use photocurrent_core::Extent;
    use photocurrent_core::random::Random;

    #[test]
    fn noise_is_predicted_and_what_neighbours_share_is_not() {
        let case = testing::texture(Extent { width: 24, height: 18 }, 6);
        let mut random = Random::new(5, &[]);
        let mut residual: Vec<f32> =
            (0..case.frame_count() * 432).map(|_| (5.0 * random.normal()) as f32).collect();
        let share = |gate: &PredictionGate, at: &dyn Fn(usize) -> bool| {
            let of: Vec<bool> =
                gate.good.iter().enumerate().filter(|(k, _)| at(*k)).map(|(_, good)| *good).collect();
            of.iter().filter(|good| **good).count() as f64 / of.len() as f64
        };
        // Nine normal values all within 4.5 median absolute deviations: 0.9976 to the ninth power, and their
        // mean.
        let everywhere = |_: usize| true;
        assert!(share(&PredictionGate::new(&case, &residual, (1.0, 0.0), 4.5), &everywhere) > 0.94);
        // Half of the array misses by twice the noise: the median of all is then larger, but differences of
        // neighbours show it.
        let left = |k: usize| k % 24 < 11;
        residual.iter_mut().enumerate().filter(|(k, _)| k % 24 < 12).for_each(|(_, r)| *r += 10.0);
        let gate = PredictionGate::new(&case, &residual, (1.0, 0.0), 4.5);
        assert!(share(&gate, &left) < 0.05, "{}", share(&gate, &left));
        assert!(share(&gate, &|k| k % 24 > 13) > 0.9);
        assert!(
            share(&PredictionGate::new(&case, &residual, (1.0, 30.0), 4.5), &left) > 0.9,
            "what is allowed counts"
        );
        residual[30] = f32::NAN;
        let gate = PredictionGate::new(&case, &residual, (1.0, 30.0), 4.5);
        assert!(!gate.good[30] && !gate.good[5], "where the scene does not reach nothing is predicted");
    }
}
