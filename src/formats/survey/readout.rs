//! Events in step with the readout of the frames, row by row.
//!
//! Where reading a row of a frame fires its pixels, events lie on a line over row and time since the frame
//! began: one delay from row to row, the same in every frame. Events of each sign are counted by band of rows
//! and phase of the frame period, in groups of frames. The line with most events over those around it is
//! looked for in half of the groups and measured in the other half, so that what chance finds in one half is
//! not found in the other.
//!
//! Limits: lines whose delay over the whole height is at most a frame period; a line that crosses the end of
//! the period goes on at its start.

use photocurrent_core::Extent;
use serde::Serialize;

/// Bands of rows.
const BANDS: usize = 64;
/// Bins of the frame period.
const BINS: usize = 256;
/// Bins that a line is wide: a sixty-fourth of the period.
const WIDE: usize = 4;
/// The events around are those up to so many widths to each side of the line, less the nearest.
const AROUND: usize = 6;
/// Groups that frames are dealt to, one after another.
const GROUPS: usize = 8;
/// Bins from one delay that is tried to the next, over the whole height.
const SWEEP: usize = 2;
/// Events of a sign, at least: fewer leave bins around a line empty.
const FEWEST: u64 = 2_000;

/// Events of one sign in step with the readout of the frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ReadoutSurvey {
    /// ON or OFF events.
    pub is_on: bool,
    /// Delay from one row to the next, ns; 0 = all rows at once.
    pub row_ns: f64,
    /// From the start of a frame's exposure to the line in row 0, ns.
    pub phase_ns: f64,
    /// Events on the line, as a multiple of those around it, in frames in which it was not looked for.
    pub over: f64,
    /// How far that is above one, in standard errors from group to group of frames.
    pub sigma: f64,
}

/// Counts of events of one sign: [group][band][bin].
struct Counts {
    all: u64,
    counts: Vec<u32>,
}

/// Counts events by sign, row and phase.
pub(super) struct Readout {
    height: u32,
    of_sign: [Counts; 2],
}

/// A line over bands and bins: bins from the first row to beyond the last, and the bin in which it begins.
#[derive(Clone, Copy, PartialEq, Debug)]
struct Line {
    sweep: i64,
    start: usize,
}

impl Readout {
    /// For an array of a height; none without rows.
    pub(super) fn new(extent: Extent) -> Option<Readout> {
        let counts = || Counts { all: 0, counts: vec![0; GROUPS * BANDS * BINS] };
        (extent.height > 0).then(|| Readout { height: extent.height, of_sign: [counts(), counts()] })
    }

    /// Takes an event at a phase, 0 to 1, of a frame.
    #[inline]
    pub(super) fn add(&mut self, frame: usize, phase: f64, y: u16, on: u8) {
        if u32::from(y) >= self.height {
            return;
        }
        let (band, bin) =
            (usize::from(y) * BANDS / self.height as usize, ((phase * BINS as f64) as usize).min(BINS - 1));
        let of_sign = &mut self.of_sign[usize::from(on & 1)];
        of_sign.all += 1;
        of_sign.counts[((frame % GROUPS) * BANDS + band) * BINS + bin] += 1;
    }

    /// The lines of both signs, OFF first; those of a sign with few events, or without a group to measure in,
    /// are left out.
    pub(super) fn survey(&self, period_ns: f64) -> Vec<ReadoutSurvey> {
        let found = |sign: usize| {
            Some(ReadoutSurvey { is_on: sign == 1, ..self.of_sign[sign].line(period_ns, self.height)? })
        };
        (0..2).filter_map(found).collect()
    }
}

impl Counts {
    fn line(&self, period_ns: f64, height: u32) -> Option<ReadoutSurvey> {
        if self.all < FEWEST {
            return None;
        }
        let mut ratios = Vec::new();
        let (mut on_line, mut around) = (0.0, 0.0);
        for half in 0..2 {
            let line = self.best(|group| group % 2 == half)?;
            for group in (0..GROUPS).filter(|group| group % 2 != half) {
                let (on, usual) = measure(&self.sums(line.sweep, |g| g == group), line.start);
                (on_line, around) = (on_line + on, around + usual);
                ratios.extend((usual > 0.0).then(|| on / usual - 1.0));
            }
        }
        let n = ratios.len() as f64;
        if ratios.len() < GROUPS / 2 || around == 0.0 {
            return None;
        }
        let mean = ratios.iter().sum::<f64>() / n;
        let variance = ratios.iter().map(|ratio| (ratio - mean) * (ratio - mean)).sum::<f64>() / (n - 1.0);
        let line = self.best(|_| true)?;
        Some(ReadoutSurvey {
            is_on: false,
            row_ns: line.sweep as f64 / BINS as f64 * period_ns / f64::from(height),
            phase_ns: (line.start as f64 + 0.5 * WIDE as f64) / BINS as f64 * period_ns,
            over: on_line / around,
            sigma: mean / (variance / n).sqrt().max(1e-3),
        })
    }

    /// The line that stands out most among the frames of some groups.
    fn best(&self, takes: impl Fn(usize) -> bool) -> Option<Line> {
        let mut best: Option<(f64, Line)> = None;
        let most = (BINS / SWEEP) as i64;
        for sweep in (-most..=most).map(|n| n * SWEEP as i64) {
            let sums = self.sums(sweep, &takes);
            for start in 0..BINS {
                let (on, usual) = measure(&sums, start);
                let stands_out = (on - usual) / (usual + 1.0).sqrt();
                if best.is_none_or(|(most, _)| stands_out > most) {
                    best = Some((stands_out, Line { sweep, start }));
                }
            }
        }
        best.map(|(_, line)| line)
    }

    /// Events by bin of the first row, along lines of one sweep, in some groups.
    fn sums(&self, sweep: i64, takes: impl Fn(usize) -> bool) -> Vec<u32> {
        let mut sums = vec![0; BINS];
        for group in (0..GROUPS).filter(|group| takes(*group)) {
            for band in 0..BANDS {
                let shift = ((sweep as f64 * (band as f64 + 0.5) / BANDS as f64).round() as i64)
                    .rem_euclid(BINS as i64) as usize;
                let row = &self.counts[(group * BANDS + band) * BINS..][..BINS];
                let (before, after) = row.split_at(shift);
                sums.iter_mut().zip(after.iter().chain(before)).for_each(|(sum, count)| *sum += count);
            }
        }
        sums
    }
}

/// Events on a line that begins at a bin, and as many as the ones around it would give.
fn measure(sums: &[u32], start: usize) -> (f64, f64) {
    let within = |from: usize, to: usize| (from..to).map(|bin| f64::from(sums[bin % BINS])).sum::<f64>();
    // Bins count from one period ahead, so that none is negative.
    let at = start + BINS;
    let on = within(at, at + WIDE);
    let usual = within(at - AROUND * WIDE, at - WIDE) + within(at + 2 * WIDE, at + (AROUND + 1) * WIDE);
    (on, usual / (2 * (AROUND - 1)) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::random::Random;

    const EXTENT: Extent = Extent { width: 40, height: 128 };
    const PERIOD_NS: f64 = 40e6;

    /// Events anywhere, and for each row and frame a coupled ON event by chance when the row is read.
    fn counted(coupled: f64, row_ns: f64, wanders: bool) -> Vec<ReadoutSurvey> {
        let (mut readout, mut random) = (Readout::new(EXTENT).unwrap(), Random::new(5, &[]));
        for frame in 0..16 {
            for _ in 0..4_000 {
                readout.add(
                    frame,
                    random.uniform(),
                    (random.uniform() * 128.0) as u16,
                    u8::from(random.uniform() < 0.5),
                );
            }
            let start_ns = if wanders { random.uniform() * PERIOD_NS } else { 19e6 };
            for y in 0..128 {
                if random.uniform() < coupled {
                    readout.add(frame, ((start_ns + f64::from(y) * row_ns) / PERIOD_NS) % 1.0, y, 1);
                }
            }
        }
        readout.survey(PERIOD_NS)
    }

    #[test]
    fn rows_that_fire_when_they_are_read_give_delay_and_phase() {
        let found = counted(0.4, 70_000.0, false);
        let on = found.iter().find(|found| found.is_on).unwrap();
        // 128 rows x 0.4 next to 2000 / 64 on the line.
        assert!(on.over > 2.0 && on.sigma > 8.0, "{on:?}");
        assert!((on.row_ns - 70_000.0).abs() < 3_000.0 && (on.phase_ns - 19e6).abs() < 0.6e6, "{on:?}");
        let off = found.iter().find(|found| !found.is_on).unwrap();
        assert!(off.sigma < 4.0 && off.over < 1.2, "{off:?}");
    }

    #[test]
    fn what_is_at_another_phase_in_each_frame_is_not_in_step() {
        for found in counted(0.4, 70_000.0, true).into_iter().chain(counted(0.0, 0.0, false)) {
            assert!(found.sigma < 4.0 && found.over < 1.2, "{found:?}");
        }
        assert_eq!(Readout::new(EXTENT).unwrap().survey(PERIOD_NS), []);
    }
}
