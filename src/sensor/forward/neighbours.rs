//! Light that comes from other pixels: the kernels of effects, applied to a plane of photocurrents at one instant.
//!
//! Kernels follow one another in the order of the catalogue. Beyond the edge of the plane the nearest pixel stands in, so a band of rows
//! gives the values of the whole array when it carries [`halo`] rows more on each inner side.

use crate::effects::{Domain, Effect, Kernel};

/// How many pixels away the light of the event path may come from.
pub fn halo(effects: &[Box<dyn Effect>]) -> u32 {
    let reach = |kernel: Kernel| kernel.taps.iter().map(|tap| tap.dx.unsigned_abs().max(tap.dy.unsigned_abs())).max().unwrap_or(0);
    effects.iter().filter_map(|effect| effect.kernel()).map(reach).sum()
}

/// The light of the event path from the light on the array, both row by row; nothing when no effect has a kernel.
///
/// # Panics
///
/// When the plane is not `width` by `height`.
pub fn event_plane(effects: &[Box<dyn Effect>], width: usize, height: usize, plane: &[f64]) -> Option<Vec<f64>> {
    let kernels: Vec<Kernel> = effects.iter().filter_map(|effect| effect.kernel()).collect();
    let (first, others) = kernels.split_first()?;
    Some(others.iter().fold(weighted(first, width, height, plane), |plane, kernel| weighted(kernel, width, height, &plane)))
}

/// The weighted sum at every pixel.
///
/// # Panics
///
/// When the plane is not `width` by `height`.
pub fn weighted(kernel: &Kernel, width: usize, height: usize, plane: &[f64]) -> Vec<f64> {
    assert_eq!(plane.len(), width * height, "a plane has one value per pixel");
    let logs: Vec<f64>;
    let values = match kernel.domain {
        Domain::Linear => plane,
        Domain::Log => {
            logs = plane.iter().map(|&i| libm::log(i)).collect();
            &logs
        }
    };
    let moved = |at: usize, by: i32, size: usize| (at as i64 + i64::from(by)).clamp(0, size as i64 - 1) as usize;
    let sum_at = |x: usize, y: usize| -> f64 {
        let parts = kernel.taps.iter().map(|tap| tap.weight * values[moved(y, tap.dy, height) * width + moved(x, tap.dx, width)]);
        let sum = parts.sum();
        if kernel.domain == Domain::Log { libm::exp(sum) } else { sum }
    };
    (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| sum_at(x, y)).collect()
}
