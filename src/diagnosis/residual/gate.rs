//! Which events count: those around which the scene predicts the frames.

use crate::case::Case;

/// Which places of which frames the scene predicts.
pub struct Gate {
    /// Empty: all of them.
    good: Vec<bool>,
    middle_ns: Vec<Vec<i64>>,
    width: usize,
    pixels: usize,
}

impl Gate {
    /// Every event counts.
    pub fn open() -> Gate {
        Gate { good: Vec::new(), middle_ns: Vec::new(), width: 1, pixels: 1 }
    }

    /// From residuals of frames as [frame][y][x], DN (NaN = took no part): a place is predicted where none of its 3 x 3 neighbourhood misses by more than `least_dn` and
    /// `spread` median absolute deviations.
    pub fn new(case: &Case, residual: &[f32], least_dn: f64, spread: f64) -> Gate {
        let (width, height) = (case.extent.width as usize, case.extent.height as usize);
        let pixels = width * height;
        let mut sizes: Vec<f32> = residual.iter().filter(|r| r.is_finite()).map(|r| r.abs()).collect();
        sizes.sort_by(f32::total_cmp);
        let middle = f64::from(sizes.get(sizes.len() / 2).copied().unwrap_or(0.0));
        let most = f64::max(least_dn, spread * middle) as f32;
        let count = case.frame_count();
        let mut good = vec![false; residual.len()];
        for l in 0..count {
            for y in 0..height {
                for x in 0..width {
                    let near = (y.saturating_sub(1)..(y + 2).min(height)).flat_map(|j| (x.saturating_sub(1)..(x + 2).min(width)).map(move |i| j * width + i));
                    good[l * pixels + y * width + x] = near.map(|at| residual[l * pixels + at]).all(|r| r.abs() <= most);
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
        Gate { good, middle_ns, width, pixels }
    }

    /// Does an event of a pixel at an instant count? Both frames around it must be predicted there.
    pub fn keeps(&self, pixel: usize, t_ns: i64) -> bool {
        if self.good.is_empty() {
            return true;
        }
        let middle = &self.middle_ns[pixel / self.width];
        let after = middle.partition_point(|&t| t <= t_ns);
        let good = |l: usize| self.good[l * self.pixels + pixel];
        after > 0 && after < middle.len() && good(after - 1) && good(after)
    }
}
