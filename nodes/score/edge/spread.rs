//! The edge spread function: pixels by their distance to the edge, plateaus, and where thresholds are
//! crossed.

use super::line::Line;
use super::types::{Direction, Lines, Refusal};
use photocurrent_core::table::percentile;
use std::collections::BTreeMap;

/// Bins per pixel along the normal.
const BINS_PER_PIXEL: f64 = 4.0;
/// Fewest samples of a bin.
const LEAST_SAMPLES: u32 = 2;
/// Widest hole between two bins of a rise along the normal, pixels.
const WIDEST_HOLE: f64 = 0.75;
/// A crossing counts as another one only after the profile went this far to the other side of the threshold,
/// share of contrast.
const HYSTERESIS: f64 = 0.1;
/// How much the outer fifth may differ from the next one, share of contrast.
const MOST_CHANGE: f64 = 0.1;

/// What one line adds to a bin.
#[derive(Clone, Copy)]
struct Piece {
    line: u32,
    samples: u32,
    distance: f64,
    value: f64,
}

/// All pixels by their distance to the edge.
pub struct Spread {
    /// (distance, value), sorted by distance.
    samples: Vec<(f64, f64)>,
    bins: BTreeMap<i64, Vec<Piece>>,
    least_samples: u32,
    lines: u32,
    direction: Direction,
}

/// The levels on both sides.
#[derive(Clone, Copy, Debug)]
pub struct Plateaus {
    dark: f64,
    bright: f64,
    /// Levels of the next fifths, towards the edge.
    next: [f64; 2],
    /// Standard deviation, DN.
    pub noise: f64,
}

impl Plateaus {
    /// Bright less dark, DN.
    pub fn contrast(&self) -> f64 {
        self.bright - self.dark
    }

    /// Do values still change where the plateaus are?
    pub fn still_changes(&self) -> bool {
        [self.next[0] - self.dark, self.bright - self.next[1]]
            .iter()
            .any(|change| change.abs() > MOST_CHANGE * self.contrast())
    }
}

impl Spread {
    pub(crate) fn new(lines: &Lines, line: &Line, direction: Direction) -> Spread {
        let mut spread = Spread::empty(direction);
        spread.add(lines, line, |value| value);
        spread.sorted()
    }

    /// Of several pictures of an edge, each by its own position; contrasts are 1 in all of them, so that
    /// values are shares.
    pub(crate) fn joined<'a>(
        pictures: impl Iterator<Item = (&'a Lines, &'a Line, &'a Plateaus)>,
        direction: Direction,
    ) -> Spread {
        let mut spread = Spread::empty(direction);
        for (lines, line, plateaus) in pictures {
            spread.add(lines, line, |value| (value - plateaus.dark) / plateaus.contrast());
        }
        spread.sorted()
    }

    fn empty(direction: Direction) -> Spread {
        let least_samples = if direction == Direction::Normal { LEAST_SAMPLES } else { 1 };
        Spread { samples: Vec::new(), bins: BTreeMap::new(), least_samples, lines: 0, direction }
    }

    fn add(&mut self, lines: &Lines, line: &Line, scaled: impl Fn(f64) -> f64) {
        for (j, values) in lines.iter().enumerate() {
            let number = self.lines;
            self.lines += 1;
            for (i, value) in values.iter().enumerate() {
                let (distance, value) = (line.distance(j, i as f64 - line.at(j)), scaled(*value));
                self.samples.push((distance, value));
                let bin = match self.direction {
                    Direction::Normal => (distance * BINS_PER_PIXEL).floor() as i64,
                    Direction::Row => i as i64,
                };
                let pieces = self.bins.entry(bin).or_default();
                match pieces.last_mut().filter(|piece| piece.line == number) {
                    Some(piece) => {
                        (piece.samples, piece.distance, piece.value) =
                            (piece.samples + 1, piece.distance + distance, piece.value + value)
                    }
                    None => pieces.push(Piece { line: number, samples: 1, distance, value }),
                }
            }
        }
    }

    fn sorted(mut self) -> Spread {
        self.samples.sort_by(|a, b| a.0.total_cmp(&b.0));
        self
    }

    /// How many lines it was made of.
    pub fn lines(&self) -> usize {
        self.lines as usize
    }

    /// Medians of the outer fifth of each side.
    ///
    /// # Errors
    /// When one side is empty.
    pub fn plateaus(&self) -> Result<Plateaus, Refusal> {
        let (Some(first), Some(last)) = (self.samples.first(), self.samples.last()) else {
            return Err(Refusal::TooSmall);
        };
        let part = |from: f64, to: f64| -> Result<Vec<f64>, Refusal> {
            let mut values: Vec<f64> = self
                .samples
                .iter()
                .filter(|(d, _)| *d >= from && *d <= to)
                .map(|(_, value)| *value)
                .collect();
            values.sort_by(f64::total_cmp);
            if values.is_empty() { Err(Refusal::AtTheBorder) } else { Ok(values) }
        };
        let (low, high) = (first.0, last.0);
        let (dark, bright) = (part(low, 0.8 * low)?, part(0.8 * high, high)?);
        let next =
            [percentile(&part(0.8 * low, 0.6 * low)?, 0.5), percentile(&part(0.6 * high, 0.8 * high)?, 0.5)];
        let median = |values: &[f64]| percentile(values, 0.5);
        let mean_square = |values: &[f64]| {
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / values.len() as f64
        };
        let noise = ((mean_square(&dark) + mean_square(&bright)) / 2.0).sqrt();
        Ok(Plateaus { dark: median(&dark), bright: median(&bright), next, noise })
    }

    /// Distance and share of the contrast per bin; `times` says how often each line counts (absent: once).
    pub fn profile(&self, plateaus: &Plateaus, times: Option<&[u32]>) -> Vec<(f64, f64)> {
        let one = |pieces: &Vec<Piece>| {
            let (mut samples, mut distance, mut value) = (0, 0.0, 0.0);
            for piece in pieces {
                let times = times.map_or(1, |times| times[piece.line as usize]);
                samples += times * piece.samples;
                distance += f64::from(times) * piece.distance;
                value += f64::from(times) * piece.value;
            }
            let n = f64::from(samples);
            (samples >= self.least_samples)
                .then(|| (distance / n, (value / n - plateaus.dark) / plateaus.contrast()))
        };
        self.bins.values().filter_map(one).collect()
    }
}

/// Where the profile crosses a share, each crossing once however it trembles there.
pub fn crossings(profile: &[(f64, f64)], share: f64) -> Vec<f64> {
    let mut found = Vec::new();
    let mut above: Option<bool> = None;
    // The last time the profile passed the share itself, before it went far enough to count.
    let mut passed = f64::NAN;
    for pair in profile.windows(2) {
        if (pair[0].1 < share) != (pair[1].1 < share) {
            passed = between(pair[0], pair[1], share);
        }
        let far = if pair[1].1 > share + HYSTERESIS {
            Some(true)
        } else if pair[1].1 < share - HYSTERESIS {
            Some(false)
        } else {
            None
        };
        if let Some(side) = far {
            if above.is_some_and(|before| before != side) {
                found.push(passed);
            }
            above = Some(side);
        }
    }
    found
}

/// A rise through the thresholds, distances in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rise {
    /// Where the lower threshold is crossed.
    pub low: f64,
    /// Where 50 % is crossed.
    pub half: f64,
    /// Where the upper threshold is crossed.
    pub high: f64,
}

impl Rise {
    /// From threshold to threshold.
    pub fn width(&self) -> f64 {
        self.high - self.low
    }
}

/// The crossings of `low` and `1 - low` nearest the 50 % crossing that is nearest the edge.
///
/// # Errors
/// When one of them is not there, or the bins leave a hole between them.
pub fn rise(profile: &[(f64, f64)], low: f64) -> Result<Rise, Refusal> {
    let crosses = |i: &usize, share: f64| profile[*i].1 < share && profile[*i + 1].1 >= share;
    let steps = 0..profile.len().saturating_sub(1);
    let distance = |i: &usize| between(profile[*i], profile[*i + 1], 0.5).abs();
    let half = steps
        .clone()
        .filter(|i| crosses(i, 0.5))
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
        .ok_or(Refusal::Holes)?;
    let below = (0..=half).rev().find(|i| crosses(i, low)).ok_or(Refusal::Holes)?;
    let above = (half..steps.end).find(|i| crosses(i, 1.0 - low)).ok_or(Refusal::Holes)?;
    // Along rows the bins are a pixel apart.
    let spacing = profile.windows(2).map(|pair| pair[1].0 - pair[0].0).fold(f64::INFINITY, f64::min);
    let widest = if spacing > 0.9 { 1.5 } else { WIDEST_HOLE };
    if profile[below..=above + 1].windows(2).any(|pair| pair[1].0 - pair[0].0 > widest) {
        return Err(Refusal::Holes);
    }
    let at = |i: usize, share: f64| between(profile[i], profile[i + 1], share);
    Ok(Rise { low: at(below, low), half: at(half, 0.5), high: at(above, 1.0 - low) })
}

/// Undershoot and overshoot near the edge in % of the contrast, 0 or more.
pub fn beyond(profile: &[(f64, f64)], rise: &Rise) -> (f64, f64) {
    let reach = rise.width() + 4.0;
    let near = || profile.iter().filter(|(d, _)| (d - rise.half).abs() <= reach);
    let under = near().filter(|(d, _)| *d < rise.half).map(|(_, share)| -share).fold(0.0, f64::max);
    let over = near().filter(|(d, _)| *d > rise.half).map(|(_, share)| share - 1.0).fold(0.0, f64::max);
    (100.0 * under, 100.0 * over)
}

fn between(a: (f64, f64), b: (f64, f64), share: f64) -> f64 {
    a.0 + (b.0 - a.0) * (share - a.1) / (b.1 - a.1)
}
