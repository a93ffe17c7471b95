//! What happens to the picture between the scene and the event pixels, on a grid with a margin around the
//! array.

use crate::scene::Grid;

/// Pixels around the array that optics may draw on.
pub const MARGIN: usize = 4;

/// The discrete Gaussian of variance `sigma^2` (Lindeberg 1990): `exp(-s) I_n(s)` with `s = sigma^2`, for n =
/// 0 .. MARGIN.
pub fn gaussian(sigma: f64) -> [f64; MARGIN + 1] {
    let s = sigma * sigma;
    let mut weights = [0.0; MARGIN + 1];
    for (n, weight) in weights.iter_mut().enumerate() {
        // The power series of the modified Bessel function; s is about 1 at most, so a few terms give all
        // digits.
        let mut term = 1.0;
        for k in 1..=n {
            term *= 0.5 * s / k as f64;
        }
        let mut sum = term;
        for k in 1..40 {
            term *= 0.25 * s * s / (k as f64 * (k + n) as f64);
            sum += term;
        }
        *weight = libm::exp(-s) * sum;
    }
    // What lies beyond the margin goes to the middle's side: the light's sum is kept.
    let total = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
    weights.map(|w| w / total)
}

/// Blurs `light` (row by row over `grid`) in place; values beyond the grid repeat its edge.
pub fn blur(light: &mut [f64], grid: &Grid, weights: &[f64; MARGIN + 1], scratch: &mut [f64]) {
    let (w, h) = (grid.columns, grid.rows);
    let near = |at: usize, step: isize, end: usize| (at as isize + step).clamp(0, end as isize - 1) as usize;
    for y in 0..h {
        for x in 0..w {
            let sum: f64 = (1..=MARGIN)
                .map(|n| {
                    weights[n]
                        * (light[y * w + near(x, n as isize, w)] + light[y * w + near(x, -(n as isize), w)])
                })
                .sum();
            scratch[y * w + x] = weights[0] * light[y * w + x] + sum;
        }
    }
    for y in 0..h {
        for x in 0..w {
            let sum: f64 = (1..=MARGIN)
                .map(|n| {
                    weights[n]
                        * (scratch[near(y, n as isize, h) * w + x]
                            + scratch[near(y, -(n as isize), h) * w + x])
                })
                .sum();
            light[y * w + x] = weights[0] * scratch[y * w + x] + sum;
        }
    }
}

/// `(1 - fraction) value + fraction mean(value of the 4 nearest)`, of light: neighbours share it.
pub fn share(light: &mut [f64], grid: &Grid, fraction: f64, scratch: &mut [f64]) {
    around(light, grid, scratch, |own, four, _| (1.0 - fraction) * own + 0.25 * fraction * four);
}

/// `value - fraction mean(value of the 8 neighbours)`, of the log of light: the surround inhibits.
pub fn inhibit(log_light: &mut [f64], grid: &Grid, fraction: f64, scratch: &mut [f64]) {
    around(log_light, grid, scratch, |own, four, corners| own - 0.125 * fraction * (four + corners));
}

/// Replaces every value but the outermost by a function of itself, the sum of its 4 nearest and the sum of
/// its 4 corners.
fn around(values: &mut [f64], grid: &Grid, scratch: &mut [f64], of: impl Fn(f64, f64, f64) -> f64) {
    let w = grid.columns;
    scratch.copy_from_slice(values);
    for y in 1..grid.rows - 1 {
        for x in 1..w - 1 {
            let at = y * w + x;
            let four = scratch[at - 1] + scratch[at + 1] + scratch[at - w] + scratch[at + w];
            let corners =
                scratch[at - w - 1] + scratch[at - w + 1] + scratch[at + w - 1] + scratch[at + w + 1];
            values[at] = of(scratch[at], four, corners);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_discrete_gaussian_has_the_stated_variance() {
        for sigma in [0.3, 0.7, 1.0] {
            let weights = gaussian(sigma);
            let sum = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
            let variance: f64 =
                2.0 * weights.iter().enumerate().map(|(n, w)| (n * n) as f64 * w).sum::<f64>();
            assert!((sum - 1.0).abs() < 1e-14);
            // What is cut off beyond four pixels is 3e-4 of the weight for sigma 1, at a distance of 5: 0.8 %
            // of the variance.
            assert!((variance / (sigma * sigma) - 1.0).abs() < 1e-2, "{sigma}: {variance}");
        }
    }

    #[test]
    fn a_point_of_light_is_shared_and_kept() {
        let grid = Grid { left: 0.0, top: 0.0, columns: 13, rows: 13 };
        let (mut light, mut scratch) = (vec![0.0; 169], vec![0.0; 169]);
        light[6 * 13 + 6] = 1.0;
        share(&mut light, &grid, 0.2, &mut scratch);
        assert_eq!((light[6 * 13 + 6], light[6 * 13 + 7], light[5 * 13 + 7]), (0.8, 0.05, 0.0));
        blur(&mut light, &grid, &gaussian(0.6), &mut scratch);
        assert!((light.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        let mut flat = vec![2.0; 169];
        inhibit(&mut flat, &grid, 0.3, &mut scratch);
        assert!((flat[6 * 13 + 6] - 1.4).abs() < 1e-12);
    }
}
