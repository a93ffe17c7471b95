//! Light that comes from other pixels, of a whole plane, one kernel after another: what the kernels joined
//! into one are compared with.

use crate::effects::{Effect, Kernel};
use crate::forward::neighbours::{mixed, stand_in};

/// The light of the event path from the light on the array, both row by row; nothing when no effect has a
/// kernel.
pub(crate) fn event_plane(
    effects: &[Box<dyn Effect>],
    width: usize,
    height: usize,
    plane: &[f64],
) -> Option<Vec<f64>> {
    let kernels: Vec<Kernel> = effects.iter().filter_map(|effect| effect.kernel()).collect();
    let (first, others) = kernels.split_first()?;
    Some(
        others.iter().fold(weighted(first, width, height, plane), |plane, kernel| {
            weighted(kernel, width, height, &plane)
        }),
    )
}

/// The weighted sum at every pixel.
fn weighted(kernel: &Kernel, width: usize, height: usize, plane: &[f64]) -> Vec<f64> {
    assert_eq!(plane.len(), width * height, "a plane has one value per pixel");
    let sum_at = |x: usize, y: usize| {
        mixed(kernel, |tap| plane[stand_in(y, tap.dy, height) * width + stand_in(x, tap.dx, width)])
    };
    (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| sum_at(x, y)).collect()
}
