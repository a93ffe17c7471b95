//! Light that comes from other pixels: the kernels of effects, applied to a plane of photocurrents at one
//! instant.
//!
//! Kernels follow one another in the order of the catalogue. Beyond the edge of the plane the nearest pixel
//! stands in, so a band of rows gives the values of the whole array when it carries [`halo`] rows more on
//! each inner side.

use crate::effects::{Domain, Effect, Kernel, Tap};
use crate::elementary::{exp, ln};

/// How many pixels away the light of the event path may come from.
pub fn halo(effects: &[Box<dyn Effect>]) -> u32 {
    let reach = |kernel: Kernel| {
        kernel.taps.iter().map(|tap| tap.dx.unsigned_abs().max(tap.dy.unsigned_abs())).max().unwrap_or(0)
    };
    effects.iter().filter_map(|effect| effect.kernel()).map(reach).sum()
}

/// Effects whose kernels act before and behind the logarithm cannot be joined into one sum.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("effects that mix neighbours before and behind the logarithm cannot be combined")]
pub struct TwoDomains;

/// The kernels of all effects, one after another, as one; nothing when no effect has a kernel.
///
/// # Errors
///
/// When they act in two domains.
pub fn joined(effects: &[Box<dyn Effect>]) -> Result<Option<Kernel>, TwoDomains> {
    let mut kernels = effects.iter().filter_map(|effect| effect.kernel());
    let Some(mut whole) = kernels.next() else { return Ok(None) };
    for next in kernels {
        if next.domain != whole.domain {
            return Err(TwoDomains);
        }
        let mut taps: Vec<Tap> = Vec::new();
        for (a, b) in whole.taps.iter().flat_map(|a| next.taps.iter().map(move |b| (a, b))) {
            let (dx, dy, weight) = (a.dx + b.dx, a.dy + b.dy, a.weight * b.weight);
            match taps.iter_mut().find(|tap| (tap.dx, tap.dy) == (dx, dy)) {
                Some(tap) => tap.weight += weight,
                None => taps.push(Tap { dx, dy, weight }),
            }
        }
        whole.taps = taps;
    }
    Ok(Some(whole))
}

/// The place `by` away from `at` on a side of `size` pixels; beyond the edge the nearest pixel stands in.
pub fn stand_in(at: usize, by: i32, size: usize) -> usize {
    (at as i64 + i64::from(by)).clamp(0, size as i64 - 1) as usize
}

/// The weighted sum of the photocurrents that `light` gives for each tap, in the kernel's domain.
pub fn mixed(kernel: &Kernel, light: impl Fn(&Tap) -> f64) -> f64 {
    match kernel.domain {
        Domain::Linear => kernel.taps.iter().map(|tap| tap.weight * light(tap)).sum(),
        Domain::Log => libm::exp(kernel.taps.iter().map(|tap| tap.weight * libm::log(light(tap))).sum()),
    }
}

/// The logarithm of the weighted sum at `count` instants; `log_light` appends the log light of a tap at each
/// of them.
pub(crate) fn mixed_log(
    kernel: &Kernel,
    count: usize,
    mut log_light: impl FnMut(&Tap, &mut Vec<f64>),
) -> Vec<f64> {
    let (mut sum, mut log) = (vec![0.0; count], Vec::with_capacity(count));
    for tap in &kernel.taps {
        log.clear();
        log_light(tap, &mut log);
        match kernel.domain {
            Domain::Log => sum.iter_mut().zip(&log).for_each(|(sum, u)| *sum += tap.weight * u),
            Domain::Linear => sum.iter_mut().zip(&log).for_each(|(sum, u)| *sum += tap.weight * exp(*u)),
        }
    }
    if kernel.domain == Domain::Linear {
        sum.iter_mut().for_each(|sum| *sum = ln(f64::max(*sum, f64::MIN_POSITIVE)));
    }
    sum
}
