//! How many events there are over time, in bins that grow with the recording.
//!
//! A stream does not say beforehand how long it is. So bins begin narrow, and are joined two by two whenever
//! an event falls outside.

use serde::Serialize;

/// Bins: more than a screen is wide, so that joining two leaves enough.
const BINS: usize = 256;
/// Width of a bin at first, ns.
const FIRST_BIN_NS: u64 = 1_000;

/// Events over time.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RateSurvey {
    /// Start of the first bin, ns.
    pub start_ns: i64,
    /// Width of a bin, ns.
    pub bin_ns: u64,
    /// Events in each bin, from the first to the last that has any.
    pub counts: Vec<u64>,
    /// Earliest and latest stamp in each of these bins, ns; none where it is empty.
    #[serde(skip)]
    pub ends: Vec<Option<(i64, i64)>>,
}

impl RateSurvey {
    /// The stretch of `bins` neighbouring bins that holds most events: how many, and their earliest and
    /// latest stamp, ns. None without events.
    pub fn densest(&self, bins: usize) -> Option<(u64, i64, i64)> {
        let bins = bins.clamp(1, self.counts.len().max(1));
        let held = |from: usize| self.counts[from..from + bins].iter().sum::<u64>();
        let from = (0..=self.counts.len().checked_sub(bins)?)
            .max_by_key(|from| (held(*from), std::cmp::Reverse(*from)))?;
        let ends = self.ends.get(from..from + bins)?.iter().flatten();
        let (first, last) = ends.copied().reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
        Some((held(from), first, last))
    }
}

/// Counts events over time.
#[derive(Clone, Debug)]
pub(super) struct Rate {
    start: i128,
    bin: u64,
    counts: Vec<u64>,
    ends: Vec<Option<(i64, i64)>>,
    is_empty: bool,
}

impl Rate {
    pub(super) fn new() -> Rate {
        Rate { start: 0, bin: FIRST_BIN_NS, counts: vec![0; BINS], ends: vec![None; BINS], is_empty: true }
    }

    /// Takes an event at `t`, ns.
    #[inline]
    pub(super) fn add(&mut self, t: i64) {
        if self.is_empty {
            self.is_empty = false;
            self.start = i128::from(t);
        }
        let mut at = i128::from(t) - self.start;
        if at < 0 || at >= i128::from(self.bin) * BINS as i128 {
            at = self.grow(t);
        }
        let bin = (at as u128 / u128::from(self.bin)) as usize;
        self.counts[bin] += 1;
        let (first, last) = self.ends[bin].get_or_insert((t, t));
        (*first, *last) = ((*first).min(t), (*last).max(t));
    }

    #[cold]
    fn grow(&mut self, t: i64) -> i128 {
        loop {
            let at = i128::from(t) - self.start;
            let length = i128::from(self.bin) * BINS as i128;
            if (0..length).contains(&at) {
                return at;
            }
            let joined: Vec<u64> = self.counts.chunks(2).map(|pair| pair.iter().sum()).collect();
            let both = |pair: &[Option<(i64, i64)>]| {
                pair.iter().flatten().copied().reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
            };
            let joined_ends: Vec<Option<(i64, i64)>> = self.ends.chunks(2).map(both).collect();
            (self.counts, self.ends) = (vec![0; BINS], vec![None; BINS]);
            let from = if at < 0 { BINS / 2 } else { 0 };
            self.counts[from..from + BINS / 2].copy_from_slice(&joined);
            self.ends[from..from + BINS / 2].copy_from_slice(&joined_ends);
            if at < 0 {
                self.start -= length;
            }
            self.bin *= 2;
        }
    }

    pub(super) fn survey(self) -> RateSurvey {
        let (Some(first), Some(last)) =
            (self.counts.iter().position(|n| *n > 0), self.counts.iter().rposition(|n| *n > 0))
        else {
            return RateSurvey::default();
        };
        let start = self.start + first as i128 * i128::from(self.bin);
        RateSurvey {
            start_ns: start.clamp(i64::MIN.into(), i64::MAX.into()) as i64,
            bin_ns: self.bin,
            counts: self.counts[first..=last].to_vec(),
            ends: self.ends[first..=last].to_vec(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_grow_to_both_sides_and_lose_no_event() {
        let mut rate = Rate::new();
        let stamps = [0, 5_000_000, -3_000_000, 999, 1_000_000_000, i64::MAX, i64::MIN];
        stamps.iter().for_each(|t| rate.add(*t));
        assert_eq!(rate.survey().counts.iter().sum::<u64>(), stamps.len() as u64);
    }

    #[test]
    fn the_densest_stretch_has_exact_ends_however_wide_a_bin_is() {
        let mut rate = Rate::new();
        (0..150).for_each(|k| rate.add(1_702_000_000_000 + k));
        (0..18_286).for_each(|k| rate.add(5_000 + k * 16_000));
        let found = rate.survey();
        assert!(found.bin_ns > 1_000_000_000, "{} ns", found.bin_ns);
        assert_eq!(found.densest(4), Some((18_286, 5_000, 5_000 + 18_285 * 16_000)));
        assert_eq!(RateSurvey::default().densest(4), None);
    }

    #[test]
    fn an_even_rate_stays_even() {
        let mut rate = Rate::new();
        (0..100_000).for_each(|k| rate.add(k * 1_000));
        let found = rate.survey();
        assert_eq!((found.start_ns, found.bin_ns), (0, 512_000));
        assert!(found.counts[..found.counts.len() - 1].iter().all(|n| *n == 512), "{:?}", found.counts);
    }
}
