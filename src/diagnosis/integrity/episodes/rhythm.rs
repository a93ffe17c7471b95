//! A rhythm of the events in a rectangle of the array or all of it, for a while: light that flickers there.
//! Its phase is the same everywhere, unlike that of moving objects.
//!
//! Limits were set on three simulated recordings; docs/diagnosis.md lists the results on others.

use super::{BLOCKS, Episode, Failure, LONGEST, block, cell_side, stretch};
use crate::integrity::array::{LAMPS_HZ, LAMPS_STEP_NS, StampedEvent, slow_mean};
use photocurrent_scene::case::Case;
use std::f64::consts::TAU;

/// Frequencies that are tried first are so far apart, Hz.
const APART_HZ: usize = 5;
/// Length of the windows in which a rhythm is first searched, bins.
const WINDOW: usize = 80;
/// Log likelihood of the rhythm in the best window from which on it is followed, and in all, nats.
const HOPEFUL: f64 = 12.0;
const NATS: f64 = 100.0;
/// Corrections of frequency, phase, size and ends.
const CORRECTIONS: usize = 6;
/// Frequencies within one correction.
const FINE: i32 = 24;
/// Least distance of other frequencies, parts of a period over the length.
const OTHERS: f64 = 3.0;
/// Least number of periods.
const PERIODS: f64 = 3.0;
/// Least standard deviations that a rhythm would have beyond its end.
const SHOWS: f64 = 4.0;
/// Of the blocks' amplitudes so much is common.
const COHERENCE: f64 = 0.9;
/// Events per bin and block that are added to rates, so that rare ones have little weight.
const FLOOR: f64 = 0.25;

/// Events in one rhythm.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct EventRhythm {
    /// Frequency, Hz.
    pub(crate) hz: f64,
    /// Events of a pixel and second more of one sign than of the other where they are most.
    pub(crate) amplitude: f64,
    /// First and last instant, ns.
    pub(crate) time_ns: [i64; 2],
    /// First and last row.
    pub(crate) rows: [u32; 2],
    /// First and last column.
    pub(crate) columns: [u32; 2],
    /// Is it in a part of the recording only, as far as events at other times show?
    pub(crate) for_a_while: bool,
    /// Gain in log-likelihood over its threshold.
    statistic: f64,
}

impl EventRhythm {
    /// As an episode.
    pub(super) fn episode(&self, case: &Case) -> Episode {
        let EventRhythm { hz, amplitude, time_ns, rows, columns, .. } = self;
        let seen = format!(
            "events rise and fall together at {hz:.1} Hz in rows {} to {} and columns {} to {}, by \
             {amplitude:.0} a pixel and second more of one sign than of the other, and not before and after",
            rows[0], rows[1], columns[0], columns[1]
        );
        let whole = Episode::on_whole_array(case, Failure::Rhythm, *time_ns, self.statistic, seen);
        Episode { rows: *rows, columns: *columns, ..whole }
    }
}

/// A wave of signs with the bins in which it is.
struct SignWave {
    hz: f64,
    /// At the first stamp.
    phase: f64,
    first: usize,
    last: usize,
    /// Gain in log-likelihood, relative to that of other frequencies where this exceeds chance.
    nats: f64,
}

impl SignWave {
    /// Of an instant after the first stamp, ns.
    fn at(&self, t_ns: i64) -> f64 {
        libm::cos(TAU * self.hz * t_ns as f64 * 1e-9 + self.phase)
    }
}

/// The rhythm that is the least probable without one.
pub(super) fn rhythm(case: &Case, stream: &[StampedEvent]) -> Option<EventRhythm> {
    let (start, end) = (stream.first()?.t_ns, stream.last()?.t_ns);
    let bins = ((end - start) / LAMPS_STEP_NS + 1) as usize;
    if bins < 2 * WINDOW {
        return None;
    }
    let (signed, weights) = whitened(&BlockCounts::from_stream(case, stream, start, bins));
    let found = followed(&signed, &weights)?;
    let length = found.last + 1 - found.first;
    if found.nats < NATS || (length as f64) * LAMPS_STEP_NS as f64 * 1e-9 * found.hz < PERIODS {
        return None;
    }
    let part = |event: &StampedEvent| f64::from(event.polarity) * found.at(event.t_ns - start);
    let mut time_ns = [found.first, found.last + 1].map(|bin| (start + bin as i64 * LAMPS_STEP_NS).min(end));
    let of = |from: i64, to: i64| {
        let [first, last] = [from, to].map(|t| stream.partition_point(|event| event.t_ns < t));
        (stream[first..last].iter().map(part).sum::<f64>(), (last - first) as f64)
    };
    let inside = of(time_ns[0], time_ns[1]);
    // An end is one where so many events come beyond it that the rhythm would show among them.
    let ends = |(sum, count): (f64, f64)| {
        let expected = inside.0 / inside.1 * count;
        expected >= SHOWS * libm::sqrt(0.5 * count) && sum < 0.5 * expected
    };
    let is_end = [ends(of(start, time_ns[0])), ends(of(time_ns[1], end))];
    time_ns = [if is_end[0] { time_ns[0] } else { start }, if is_end[1] { time_ns[1] } else { end }];
    let first = stream.partition_point(|event| event.t_ns < time_ns[0]);
    let last = stream.partition_point(|event| event.t_ns < time_ns[1]);
    let inside = &stream[first..last];
    let (rows, columns, mean) = rectangle(case, inside, &part)?;
    let share = (time_ns[1] - time_ns[0]) as f64 / (end - start) as f64;
    is_common(case, inside, (rows, columns), &found, start).then(|| EventRhythm {
        hz: found.hz,
        amplitude: 2e9 * mean / (time_ns[1] - time_ns[0]) as f64,
        time_ns,
        rows,
        columns,
        for_a_while: share <= LONGEST,
        statistic: found.nats / NATS,
    })
}

/// Events of blocks and bins: all, and ON less OFF.
struct BlockCounts {
    all: Vec<Vec<f64>>,
    signed: Vec<Vec<f64>>,
}

impl BlockCounts {
    fn from_stream(case: &Case, stream: &[StampedEvent], start: i64, bins: usize) -> BlockCounts {
        let none = vec![vec![0.0; bins]; BLOCKS * BLOCKS];
        let mut counts = BlockCounts { all: none.clone(), signed: none };
        for event in stream {
            let (block, bin) = (block(case, event.pixel), ((event.t_ns - start) / LAMPS_STEP_NS) as usize);
            counts.all[block][bin] += 1.0;
            counts.signed[block][bin] += f64::from(event.polarity);
        }
        counts
    }
}

/// Signed counts of all blocks as one weighted series with standard deviation 1 per bin; and the change of it
/// by one more ON event in each block.
fn whitened(counts: &BlockCounts) -> (Vec<f64>, Vec<f64>) {
    let bins = counts.all[0].len();
    let mut sums = vec![[0.0_f64; 3]; bins];
    for (all, signed) in counts.all.iter().zip(&counts.signed) {
        let (rates, slow) = (slow_mean(all), slow_mean(signed));
        for (bin, [sum, variance, weight]) in sums.iter_mut().enumerate() {
            let one = 1.0 / (rates[bin] + FLOOR);
            *sum += one * (signed[bin] - slow[bin]);
            *variance += one * one * rates[bin];
            *weight += one;
        }
    }
    let by = |sum: f64, variance: f64| if variance > 0.0 { sum / libm::sqrt(variance) } else { 0.0 };
    sums.iter().map(|[sum, variance, weight]| (by(*sum, *variance), by(*weight, *variance))).unzip()
}

/// Log likelihood that a rhythm of a frequency in some bins gains, its phase at the first bin of all, and its
/// amplitude, events a block and bin.
fn frequency_gain(signed: &[f64], weights: &[f64], range: (usize, usize), hz: f64) -> (f64, f64, f64) {
    let (mut re, mut im, mut squares) = (0.0, 0.0, 0.0);
    for k in range.0..range.1 {
        let phase = TAU * hz * (k as f64 + 0.5) * LAMPS_STEP_NS as f64 * 1e-9;
        re += signed[k] * weights[k] * libm::cos(phase);
        im -= signed[k] * weights[k] * libm::sin(phase);
        squares += weights[k] * weights[k];
    }
    let squares = f64::max(squares, 1e-12);
    ((re * re + im * im) / squares, libm::atan2(im, re), 2.0 * libm::hypot(re, im) / squares)
}

/// The strongest rhythm of a window, followed as far as it goes.
fn followed(signed: &[f64], weights: &[f64]) -> Option<SignWave> {
    let starts = (0..signed.len() - WINDOW).step_by(WINDOW / 2);
    let windows = starts.flat_map(|from| {
        let frequencies = LAMPS_HZ.step_by(APART_HZ).map(f64::from);
        frequencies.map(move |hz| (frequency_gain(signed, weights, (from, from + WINDOW), hz).0, from, hz))
    });
    let (gain, from, mut hz) = windows.max_by(|a, b| a.0.total_cmp(&b.0))?;
    if gain < HOPEFUL {
        return None;
    }
    let is_tried = |hz: &f64| (f64::from(LAMPS_HZ.start)..f64::from(LAMPS_HZ.end)).contains(hz);
    let mut range = (from, from + WINDOW);
    let mut found = None;
    for _ in 0..CORRECTIONS {
        // The frequency is known to a part of a period over the length.
        let apart = 1.0 / (FINE as f64 * (range.1 - range.0) as f64 * LAMPS_STEP_NS as f64 * 1e-9);
        let tried = (-FINE..=FINE).map(|n| hz + f64::from(n) * apart).filter(is_tried);
        let of = |hz: f64| (frequency_gain(signed, weights, range, hz), hz);
        let ((_, phase, amplitude), best) = tried.map(of).max_by(|a, b| a.0.0.total_cmp(&b.0.0))?;
        hz = best;
        let score = |k: usize| {
            let time_s = (k as f64 + 0.5) * LAMPS_STEP_NS as f64 * 1e-9;
            let mean = amplitude * weights[k] * libm::cos(TAU * hz * time_s + phase);
            mean * signed[k] - 0.5 * mean * mean
        };
        let (first, last, nats) = stretch((0..signed.len()).map(score))?;
        range = (first, last + 1);
        found = Some(SignWave { hz, phase, first, last, nats });
    }
    // Scenes are no white noise: what other frequencies gain in the same bins is no rhythm of one.
    let mut found = found?;
    let width_hz = OTHERS / ((range.1 - range.0) as f64 * LAMPS_STEP_NS as f64 * 1e-9);
    let others = LAMPS_HZ.step_by(APART_HZ).map(f64::from).filter(|other| (other - hz).abs() > width_hz);
    let gains: Vec<f64> = others.map(|hz| frequency_gain(signed, weights, range, hz).0).collect();
    found.nats /= f64::max(gains.iter().sum::<f64>() / gains.len().max(1) as f64, 1.0);
    Some(found)
}

/// The rectangle whose events follow a rhythm: rows, columns, and the mean amplitude of its pixels. `part`:
/// an event's share of the rhythm.
fn rectangle(
    case: &Case,
    events: &[StampedEvent],
    part: &dyn Fn(&StampedEvent) -> f64,
) -> Option<([u32; 2], [u32; 2], f64)> {
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let side = cell_side(case);
    let (across, down) = (width.div_ceil(side), height.div_ceil(side));
    let mut pixels = vec![0.0; width * height];
    events.iter().for_each(|event| pixels[event.pixel as usize] += part(event));
    let mut cells = vec![(0.0, 0.0); across * down];
    for (pixel, value) in pixels.iter().enumerate() {
        let cell = &mut cells[pixel / width / side * across + pixel % width / side];
        (cell.0, cell.1) = (cell.0 + value, cell.1 + 1.0);
    }
    let mut means: Vec<f64> = cells.iter().map(|(sum, count)| sum / count).collect();
    means.sort_by(f64::total_cmp);
    let usual = means[means.len() - 1 - means.len() / 8];
    let least = 0.5 * usual;
    let scores: Vec<f64> = cells.iter().map(|(sum, count)| sum - least * count).collect();
    let (rows, columns) = best_rectangle(&scores, across)?;
    // Rows within the columns, and columns within the rows, to a pixel.
    let [mut top, mut bottom] = [rows[0] * side, ((rows[1] + 1) * side).min(height)];
    let [mut left, mut right] = [columns[0] * side, ((columns[1] + 1) * side).min(width)];
    let row = |y: usize, (left, right): (usize, usize)| {
        pixels[y * width + left..y * width + right].iter().sum::<f64>() - least * (right - left) as f64
    };
    let column = |x: usize, (top, bottom): (usize, usize)| {
        (top..bottom).map(|y| pixels[y * width + x] - least).sum::<f64>()
    };
    (top, bottom) = ends((top, bottom), side, height, &|y| row(y, (left, right)));
    (left, right) = ends((left, right), side, width, &|x| column(x, (top, bottom)));
    let inside: f64 = (top..bottom).map(|y| row(y, (left, right)) + least * (right - left) as f64).sum();
    let count = ((bottom - top) * (right - left)) as f64;
    let ends = |from: usize, to: usize| [from as u32, to as u32 - 1];
    Some((ends(top, bottom), ends(left, right), inside / count))
}

/// First and last row and column of the cells with the largest sum, rows of `across` cells; none without a
/// positive one.
fn best_rectangle(scores: &[f64], across: usize) -> Option<([usize; 2], [usize; 2])> {
    let down = scores.len() / across;
    let mut best: Option<([usize; 2], [usize; 2], f64)> = None;
    for top in 0..down {
        let mut sums = vec![0.0; across];
        for bottom in top..down {
            sums.iter_mut().zip(&scores[bottom * across..]).for_each(|(sum, score)| *sum += score);
            let Some((left, right, sum)) = stretch(sums.iter().copied()) else { continue };
            if best.as_ref().is_none_or(|best| sum > best.2) {
                best = Some(([top, bottom], [left, right], sum));
            }
        }
    }
    best.map(|(rows, columns, _)| (rows, columns))
}

/// Ends of a range within `side` of where they are, between which the sum of scores is largest.
fn ends(
    (from, to): (usize, usize),
    side: usize,
    size: usize,
    score: &dyn Fn(usize) -> f64,
) -> (usize, usize) {
    let middle = (from + to) / 2;
    let best = |range: &mut dyn Iterator<Item = usize>| {
        let (mut sum, mut best) = (0.0, (0.0, middle));
        for at in range {
            sum += score(at);
            if sum > best.0 {
                best = (sum, at);
            }
        }
        best.1
    };
    let first = best(&mut (from.saturating_sub(side)..middle).rev());
    let last = best(&mut (middle..(to + side).min(size)));
    (first, last + 1)
}

/// Is the phase one in all blocks of a rectangle?
fn is_common(
    case: &Case,
    inside: &[StampedEvent],
    (rows, columns): ([u32; 2], [u32; 2]),
    found: &SignWave,
    start: i64,
) -> bool {
    let width = case.extent.width;
    let across =
        |at: u32, ends: [u32; 2]| (at - ends[0]) as usize * BLOCKS / (ends[1] - ends[0] + 1) as usize;
    let mut parts = [[0.0_f64; 2]; BLOCKS * BLOCKS];
    for event in inside {
        let (x, y) = (event.pixel % width, event.pixel / width);
        if (rows[0]..=rows[1]).contains(&y) && (columns[0]..=columns[1]).contains(&x) {
            let phase = TAU * found.hz * (event.t_ns - start) as f64 * 1e-9 + found.phase;
            let sign = f64::from(event.polarity);
            let part = &mut parts[across(y, rows) * BLOCKS + across(x, columns)];
            part[0] += sign * libm::cos(phase);
            part[1] += sign * libm::sin(phase);
        }
    }
    let mean = |k: usize| parts.iter().map(|part| part[k]).sum::<f64>() / parts.len() as f64;
    let power = parts.iter().map(|[a, b]| a * a + b * b).sum::<f64>() / parts.len() as f64;
    libm::hypot(mean(0), mean(1)) >= COHERENCE * libm::sqrt(power)
}
