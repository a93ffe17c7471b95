//! Event rates over the phase of the frames in each row, and over the parity of the row: no scene depends on
//! these.
//!
//! With a rolling shutter nothing in the scene is in step with the exposure of each row. Events are counted
//! by frame and phase on the clock of their row, and compared with the mean count around in time. A departure
//! at one phase that repeats from frame to frame, by more than it varies there, is the sensor's. Light that
//! flickers with the frames repeats too, but on one clock for all rows. So the departure must be smaller when
//! all rows are given the clock of the first. A global shutter has one clock, and the test abstains.
//!
//! Textures do not distinguish odd rows from even ones. A row is compared with the mean of the two next to
//! it, in parts of the array and of the recording. A difference of one sign in nearly all parts and most rows
//! is the sensor's.
//!
//! `frame_coupling` of the catalogue causes events of one sign at one phase and suppresses the other. It has
//! tests of its own, which come first. Here both signs must differ alike.

use crate::covariates::Covariate;
use crate::dependence::{AffectedQuantity, Dependence};
use photocurrent_scene::case::Case;

/// Width of a bin of phase, ns.
const BIN_NS: f64 = 250_000.0;
/// Number of bins to each side with which a count is compared.
const AROUND: usize = 6;
/// Fewest frames, and events in a bin of a frame.
const FEWEST_FRAMES: usize = 8;
const FEWEST_EVENTS: f64 = 8.0;
/// Least ratio of the repeating to the varying departure. By chance it is 1; recordings without such a
/// dependence reach 3.6, those with one 40 and more.
const LEAST_REGULARITY: f64 = 12.0;
/// And so much more than on one clock for all rows.
const BY_ROWS: f64 = 1.2;
/// At some phase the rate differs by this share.
const LEAST_SHARE: f64 = 0.15;
/// Least departure of the weaker sign, as a share of the stronger.
const OF_OTHER_SIGN: f64 = 0.3;
/// Parts of the array, and of the recording, in which rows are compared.
const PARTS: (usize, usize) = (6, 10);
/// Least difference between odd and even rows, standard errors; recordings without such a dependence reach
/// 4.3.
const LEAST_SIGMAS: f64 = 8.0;
/// By this share,
const LEAST_PARITY: f64 = 0.02;
/// and with one sign in this share of the parts, and of the rows.
const SAME_PARTS: f64 = 0.9;
const SAME_ROWS: f64 = 0.8;

/// Dependences that repeat, strongest first; pixels of `masked` are left out.
pub(crate) fn dependences(case: &Case, masked: &[u32]) -> Vec<Dependence> {
    let mut found: Vec<Dependence> =
        by_phase(case, masked).into_iter().chain(by_parity(case, masked)).collect();
    found.sort_by(|a, b| score(b).total_cmp(&score(a)));
    found
}

/// Statistic of a dependence of [`dependences`] over its threshold.
pub(crate) fn score(dependence: &Dependence) -> f64 {
    dependence.significance
        / if dependence.covariate == Covariate::RowParity { LEAST_SIGMAS } else { LEAST_REGULARITY }
}

/// Counts by frame and phase.
struct FoldedCounts {
    frames: usize,
    bins: usize,
    /// Row by row, a frame each.
    counts: Vec<f64>,
    /// The means around in time.
    around: Vec<f64>,
}

impl FoldedCounts {
    /// Of the events of some signs, on the clock of each row, or that of the first row for all.
    fn new(case: &Case, masked: &[u32], by_rows: bool, signs: &[i8]) -> Option<FoldedCounts> {
        let times = &case.frames.as_ref()?.times;
        let period_ns = times.mean_period_ns()?;
        let (frames, bins) = (times.len() - 1, (period_ns / BIN_NS).round() as usize);
        if frames < FEWEST_FRAMES || bins < 2 * AROUND {
            return None;
        }
        let mut counts = vec![0.0; frames * bins];
        for pixel in (0..case.events.pixels()).filter(|pixel| masked.binary_search(&(*pixel as u32)).is_err())
        {
            let row = if by_rows { case.pixel_place(pixel).1 } else { 0 };
            for event in case.events.of_pixel(pixel).iter().filter(|event| signs.contains(&event.polarity)) {
                let Some(frame) = times.last_begun(row, event.t_in_ns).filter(|frame| *frame < frames) else {
                    continue;
                };
                let phase_ns = (event.t_in_ns - times.exposure(frame, row).start.0) as f64;
                let bin = (phase_ns / period_ns * bins as f64) as usize;
                counts[frame * bins + bin.min(bins - 1)] += 1.0;
            }
        }
        if counts.iter().sum::<f64>() < 0.5 * FEWEST_EVENTS * (counts.len() * signs.len()) as f64 {
            return None;
        }
        let mut sums = vec![0.0];
        counts.iter().for_each(|count| sums.push(sums[sums.len() - 1] + count));
        let around = |k: usize| {
            let (from, to) = (k.saturating_sub(AROUND), (k + AROUND + 1).min(counts.len()));
            (sums[to] - sums[from]) / (to - from) as f64
        };
        let around = (0..counts.len()).map(around).collect();
        Some(FoldedCounts { frames, bins, counts, around })
    }

    /// Departures of a phase from what is around, in standard deviations of pure chance, frame by frame.
    fn departures(&self, bin: usize) -> impl Iterator<Item = f64> {
        (0..self.frames)
            .map(move |frame| frame * self.bins + bin)
            .map(|k| (self.counts[k] - self.around[k]) / libm::sqrt(f64::max(self.around[k], 1.0)))
    }

    /// Ratio of the squares of the repeating to the varying departure, relative to its value by chance.
    fn regularity(&self) -> f64 {
        let n = self.frames as f64;
        let (mut repeats, mut differs) = (0.0, 0.0);
        for bin in 0..self.bins {
            let mean = self.departures(bin).sum::<f64>() / n;
            repeats += n * mean * mean;
            differs += self.departures(bin).map(|one| (one - mean) * (one - mean)).sum::<f64>() / (n - 1.0);
        }
        repeats / f64::max(differs, 0.3 * self.bins as f64)
    }

    /// The rate of a phase over that around, less 1, from the frames that `with` keeps.
    fn relative_rate(&self, bin: usize, with: impl Fn(usize) -> bool) -> f64 {
        let sum = |of: &[f64]| {
            (0..self.frames)
                .filter(|frame| with(*frame))
                .map(|frame| of[frame * self.bins + bin])
                .sum::<f64>()
        };
        (sum(&self.counts) + 1.0) / (sum(&self.around) + 1.0) - 1.0
    }

    /// Gain in log-likelihood of the counts of every other frame by the curve of the others, both ways.
    fn nats(&self) -> f64 {
        let mut gain = 0.0;
        for half in 0..2 {
            for bin in 0..self.bins {
                let share = self.relative_rate(bin, |frame| frame % 2 != half);
                for k in (half..self.frames).step_by(2).map(|frame| frame * self.bins + bin) {
                    gain += self.counts[k] * libm::log1p(share) - self.around[k] * share;
                }
            }
        }
        gain
    }
}

fn by_phase(case: &Case, masked: &[u32]) -> Option<Dependence> {
    let folded = FoldedCounts::new(case, masked, true, &[-1, 1])?;
    let regularity = folded.regularity();
    let value: Vec<f64> = (0..folded.bins).map(|bin| folded.relative_rate(bin, |_| true)).collect();
    let most = (0..folded.bins).max_by(|a, b| value[*a].abs().total_cmp(&value[*b].abs()))?;
    if regularity < LEAST_REGULARITY
        || value[most].abs() < LEAST_SHARE
        || regularity < BY_ROWS * FoldedCounts::new(case, masked, false, &[-1, 1])?.regularity()
    {
        return None;
    }
    let of_sign =
        |sign: i8| Some(FoldedCounts::new(case, masked, true, &[sign])?.relative_rate(most, |_| true));
    let (off, on) = (of_sign(-1)?, of_sign(1)?);
    if f64::min(off / on, on / off) < OF_OTHER_SIGN {
        return None;
    }
    let n = folded.frames as f64;
    let error = |bin: usize| {
        let around = (0..folded.frames).map(|frame| folded.around[frame * folded.bins + bin]).sum::<f64>();
        let mean = folded.departures(bin).sum::<f64>() / n;
        let spread = folded.departures(bin).map(|one| (one - mean) * (one - mean)).sum::<f64>() / (n - 1.0);
        libm::sqrt(spread / f64::max(around, 1.0))
    };
    let (before, after) = (0..folded.bins)
        .flat_map(|bin| folded.departures(bin).map(move |one| (bin, one)))
        .fold((0.0, 0.0), |(before, after), (bin, one)| {
            let mean = folded.departures(bin).sum::<f64>() / n;
            (before + one * one, after + (one - mean) * (one - mean))
        });
    let period_s = case.frames.as_ref()?.times.mean_period_ns()? * 1e-9;
    Some(Dependence {
        at: (0..folded.bins).map(|bin| (bin as f64 + 0.5) / folded.bins as f64 * period_s).collect(),
        error: (0..folded.bins).map(error).collect(),
        value,
        taken: 1.0 - after / f64::max(before, 1e-300),
        significance: regularity,
        nats_per_event: folded.nats() / case.events.len() as f64,
        ..Dependence::empty_over(Covariate::FramePhase, AffectedQuantity::EventRate)
    })
}

/// Counts of the rows of one part of the array and the recording.
fn rows_of_parts(case: &Case, masked: &[u32]) -> Vec<Vec<f64>> {
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let length = ((case.span.1 - case.span.0) / PARTS.1 as i64).max(1);
    let mut parts = vec![vec![0.0; height]; PARTS.0 * PARTS.1];
    for pixel in (0..case.events.pixels()).filter(|pixel| masked.binary_search(&(*pixel as u32)).is_err()) {
        let (x, y) = (pixel % width, pixel / width);
        for event in case.events.of_pixel(pixel) {
            let time = (((event.t_in_ns - case.span.0) / length).max(0) as usize).min(PARTS.1 - 1);
            parts[time * PARTS.0 + x * PARTS.0 / width][y] += 1.0;
        }
    }
    parts
}

fn by_parity(case: &Case, masked: &[u32]) -> Option<Dependence> {
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    // A row of which much is left out is none.
    let mut left_out = vec![0; height];
    masked.iter().for_each(|pixel| left_out[*pixel as usize / width] += 1);
    let rows: Vec<usize> = (1..height.saturating_sub(1))
        .filter(|y| (y - 1..=y + 1).all(|row| left_out[row] * 4 < width))
        .collect();
    if rows.len() < height / 2 || height < 8 {
        return None;
    }
    let parts = rows_of_parts(case, masked);
    let sign = |y: usize| if y.is_multiple_of(2) { 1.0 } else { -1.0 };
    // Even rows less odd ones, half of the difference, as each row has it.
    let contrast = |part: &[f64], y: usize| 0.5 * sign(y) * (part[y] - 0.5 * (part[y - 1] + part[y + 1]));
    let all = |part: &[f64]| rows.iter().map(|y| part[*y]).sum::<f64>();
    let usual = parts.iter().map(|part| all(part)).sum::<f64>() / parts.len() as f64;
    let contrasts: Vec<(f64, f64)> = parts
        .iter()
        .filter(|part| all(part) > 0.1 * usual)
        .map(|part| (rows.iter().map(|y| contrast(part, *y)).sum::<f64>(), all(part)))
        .collect();
    let n = contrasts.len() as f64;
    let (sum, events) = contrasts.iter().fold((0.0, 0.0), |sums, one| (sums.0 + one.0, sums.1 + one.1));
    let spread = libm::sqrt(
        contrasts.iter().map(|one| (one.0 - sum / n) * (one.0 - sum / n)).sum::<f64>()
            / f64::max(n - 1.0, 1.0),
    );
    let (share, sigmas) = (sum / f64::max(events, 1.0), sum.abs() / f64::max(spread * libm::sqrt(n), 1e-9));
    let same = |values: &mut dyn Iterator<Item = f64>| {
        let (agree, count) = values.fold((0.0, 0.0), |(agree, count), one| {
            (agree + f64::from(u8::from(one * sum > 0.0)), count + 1.0)
        });
        agree / f64::max(count, 1.0)
    };
    let of_row = |y: &usize| parts.iter().map(|part| contrast(part, *y)).sum::<f64>();
    let is_steady = same(&mut contrasts.iter().map(|one| one.0)) >= SAME_PARTS
        && same(&mut rows.iter().map(of_row)) >= SAME_ROWS;
    if events < FEWEST_EVENTS * parts.len() as f64
        || sigmas < LEAST_SIGMAS
        || share.abs() < LEAST_PARITY
        || !is_steady
    {
        return None;
    }
    // Rows of each half of the parts, predicted from those next to them with the share of the other half.
    let (mut gain, mut before, mut after) = (0.0, 0.0, 0.0);
    for half in 0..2 {
        let of = |which: usize| {
            parts
                .iter()
                .enumerate()
                .filter(move |(k, _)| (k / PARTS.0 + k % PARTS.0) % 2 == which)
                .map(|(_, part)| part)
        };
        let (sum, events) = of(1 - half).fold((0.0, 0.0), |sums, part| {
            (sums.0 + rows.iter().map(|y| contrast(part, *y)).sum::<f64>(), sums.1 + all(part))
        });
        let share = (sum / f64::max(events, 1.0)).clamp(-0.9, 0.9);
        for (part, y) in of(half).flat_map(|part| rows.iter().map(move |y| (part, *y))) {
            let mean = 0.5 * (part[y - 1] + part[y + 1]);
            let ratio = (1.0 + sign(y) * share) / (1.0 - sign(y) * share);
            gain += part[y] * libm::log(ratio) - mean * (ratio - 1.0);
            before += (part[y] - mean) * (part[y] - mean);
            after += (part[y] - ratio * mean) * (part[y] - ratio * mean);
        }
    }
    Some(Dependence {
        at: vec![0.0, 1.0],
        value: vec![share, -share],
        error: vec![share.abs() / sigmas; 2],
        taken: 1.0 - after / f64::max(before, 1e-300),
        significance: sigmas,
        nats_per_event: gain / case.events.len() as f64,
        ..Dependence::empty_over(Covariate::RowParity, AffectedQuantity::EventRate)
    })
}
