//! The length of the exposure from how frames are blurred.
//!
//! A frame is the mean of the light over its exposure. Events say how the light went meanwhile, so for each length of the exposure they predict how much the
//! logarithm of the mean differs from the logarithm in the middle, and with it the change from one frame to the next. The length with the smallest
//! residual is the exposure.
//!
//! Limits: the middle of the exposure must be right ([`super::offset()`] gives it up to the latency of events). Only light that bends within an
//! exposure tells its length: slow scenes have none. Noise of events is smoothed by a mean over any time, so that some length always explains
//! noisy events a little better, the wrong one: only a length that explains much is given. Real recordings rarely have one.

use super::draw::{estimate, top};
use super::{Estimate, Panel};

/// Lengths that are tried, from 0 on.
const LENGTHS: usize = 33;
/// Instants of an exposure whose mean is taken.
const INSTANTS: usize = 12;
/// The residual must fall by this share from the shortest length, or from the longest, to the best: noise alone makes it fall by up to a fifth.
const LEAST_GAIN: f64 = 0.4;
/// Places with less light change over a pair of frames, in events a pixel, are left out.
const FEWEST_A_PIXEL: f32 = 2.0;

/// Length of the exposure, ns, with thresholds `(on, off)` and events `offset_ns` later than frames; none where no length stands out.
pub fn exposure(panel: &Panel, thresholds: (f64, f64), offset_ns: f64) -> Option<Estimate> {
    let period = panel.period_ns()? as f64;
    let lengths: Vec<f64> = (0..LENGTHS).map(|n| n as f64 / (LENGTHS - 1) as f64 * period).collect();
    let parts = panel.part_count();
    let units = panel.pairs() * parts;
    let mut sums = vec![0.0; LENGTHS * units];
    let mut pair = 0;
    for stretch in &panel.stretches {
        let summed = stretch.summed(thresholds.0 as f32, thresholds.1 as f32);
        let counted = stretch.summed(1.0, -1.0);
        let frames = stretch.mids_ns.len();
        let mids: Vec<f64> = stretch.mids_ns.iter().map(|mid| *mid as f64 + offset_ns).collect();
        // [length][frame][place]; none where the exposure leaves the stretch.
        for (n, length) in lengths.iter().enumerate() {
            let means: Vec<Option<Vec<f32>>> = mids.iter().map(|mid| log_mean(panel, stretch, &summed, *mid, *length)).collect();
            for frame in 1..frames {
                let (Some(before), Some(after)) = (&means[frame - 1], &means[frame]) else { continue };
                let mut events = vec![0.0; panel.places()];
                stretch.add_at(&counted, mids[frame], 1.0, &mut events);
                stretch.add_at(&counted, mids[frame - 1], -1.0, &mut events);
                for place in 0..panel.places() {
                    let change = stretch.logs(frame)[place] - stretch.logs(frame - 1)[place];
                    if change.is_finite() && events[place] >= FEWEST_A_PIXEL * panel.pixels[place] as f32 {
                        let left = f64::from((change - (after[place] - before[place])).clamp(-2.0, 2.0));
                        sums[n * units + (pair + frame - 1) * parts + usize::from(panel.parts[place])] += left * left;
                    }
                }
            }
        }
        pair += frames.saturating_sub(1);
    }
    let some: Vec<usize> = (0..units).filter(|unit| (0..LENGTHS).all(|n| sums[n * units + unit] > 0.0)).collect();
    if some.len() < 2 {
        return None;
    }
    let residuals = |weights: &[f64]| -> Vec<f64> {
        (0..LENGTHS).map(|n| -some.iter().zip(weights).map(|(unit, weight)| weight * sums[n * units + unit]).sum::<f64>()).collect()
    };
    let step = period / (LENGTHS - 1) as f64;
    let best = |weights: &[f64]| top(&residuals(weights)).map(|at| at * step);
    let all = residuals(&vec![1.0; some.len()]);
    let least = -all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let shows = least < (1.0 - LEAST_GAIN) * -all[0] && least < (1.0 - LEAST_GAIN) * -all[LENGTHS - 1];
    if shows { estimate(some.len(), best) } else { None }
}

/// Logarithm of the mean over an exposure of what events say of the light, at every place; none where the exposure leaves the stretch.
fn log_mean(panel: &Panel, stretch: &super::Stretch, summed: &[f32], mid: f64, length: f64) -> Option<Vec<f32>> {
    let places = panel.places();
    let mut middle = vec![0.0; places];
    if !stretch.add_at(summed, mid, 1.0, &mut middle) {
        return None;
    }
    let mut mean = vec![0.0f32; places];
    let mut now = vec![0.0f32; places];
    for n in 0..INSTANTS {
        now.fill(0.0);
        let at = mid + ((n as f64 + 0.5) / INSTANTS as f64 - 0.5) * length;
        if !stretch.add_at(summed, at, 1.0, &mut now) {
            return None;
        }
        for (((mean, now), middle), pixels) in mean.iter_mut().zip(&now).zip(&middle).zip(&panel.pixels) {
            *mean += libm::expf((now - middle) / *pixels as f32) / INSTANTS as f32;
        }
    }
    Some(mean.iter().zip(&middle).zip(&panel.pixels).map(|((mean, middle), pixels)| libm::logf(*mean) + middle / *pixels as f32).collect())
}
