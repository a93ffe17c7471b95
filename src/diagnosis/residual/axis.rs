//! Gains along an axis: the part that stands out, means by block with their errors, the form of a curve.

use serde::{Deserialize, Serialize};

/// Gain per event, nats.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MeanGain {
    /// The mean.
    pub gain: f64,
    /// Its standard error, by blocks of pixels.
    pub error: f64,
    /// Of how many events.
    pub events: usize,
}

/// The part of an axis whose mean gain differs most from the rest's, by the squares between the two; `least`:
/// events on either side, `rim`: ends with fewer belong to it.
pub(super) fn best(
    gains: &[f64],
    at: &[usize],
    steps: usize,
    is_selected: &dyn Fn(usize) -> bool,
    least: usize,
    rim: usize,
) -> Option<(usize, usize)> {
    let mut sums = vec![(0.0, 0_usize); steps + 1];
    for k in (0..gains.len()).filter(|&k| is_selected(k)) {
        sums[at[k] + 1].0 += gains[k];
        sums[at[k] + 1].1 += 1;
    }
    for step in 0..steps {
        sums[step + 1] = (sums[step + 1].0 + sums[step].0, sums[step + 1].1 + sums[step].1);
    }
    let (all, count) = sums[steps];
    let mut best = (0.0, None);
    for first in 0..steps {
        for last in first..steps {
            let (gain, events) = (sums[last + 1].0 - sums[first].0, sums[last + 1].1 - sums[first].1);
            if events < least || count - events < least {
                continue;
            }
            let (inside, outside) = (events as f64, (count - events) as f64);
            let differ = gain / inside - (all - gain) / outside;
            let squares = inside * outside * differ * differ;
            if differ > 0.0 && squares > best.0 {
                best = (squares, Some((first, last)));
            }
        }
    }
    let (first, last) = best.1?;
    Some((
        if sums[first].1 < rim { 0 } else { first },
        if count - sums[last + 1].1 < rim { steps - 1 } else { last },
    ))
}

/// Mean of sums by block (sum, how many) and its standard error.
pub(super) fn mean_gain(sums: &[(f64, f64)]) -> MeanGain {
    let (all, count) = sums.iter().fold((0.0, 0.0), |(all, count), sum| (all + sum.0, count + sum.1));
    let gain = all / f64::max(count, 1.0);
    let blocks = sums.iter().filter(|sum| sum.1 > 0.0).count() as f64;
    let spread: f64 = sums.iter().map(|(sum, count)| (sum - gain * count) * (sum - gain * count)).sum();
    // One block has no spread: its error is as large as the gain itself.
    let error = if blocks > 1.0 { libm::sqrt(spread * blocks / (blocks - 1.0)) / count } else { gain.abs() };
    MeanGain { gain, error, events: count as usize }
}

/// How a curve runs, in a word.
pub(super) fn shape(gains: &[f64], straight: f64) -> &'static str {
    let count = gains.len() as f64;
    let (middle, mean) = (0.5 * (count - 1.0), gains.iter().sum::<f64>() / f64::max(count, 1.0));
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for (n, gain) in gains.iter().enumerate() {
        let (x, y) = (n as f64 - middle, gain - mean);
        (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
    }
    if xy * xy >= straight * xx * yy {
        return if xy > 0.0 { "rises" } else { "falls" };
    }
    let (least, most) = gains.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), gain| {
        (f64::min(least, *gain), f64::max(most, *gain))
    });
    let ends = [gains[0], gains[gains.len() - 1]].map(|gain| gain - 0.5 * (least + most));
    match ends.map(|end| end < 0.0) {
        [true, true] => "peak",
        [false, false] => "valley",
        _ => "uneven",
    }
}
