//! How many events there are over time, in bins that grow with the recording.
//!
//! A stream does not say beforehand how long it is. So bins begin narrow, and are joined two by two whenever an event falls outside.

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
}

/// Counts events over time.
#[derive(Clone, Debug)]
pub(super) struct Rate {
    start: i128,
    bin: u64,
    counts: Vec<u64>,
    is_empty: bool,
}

impl Rate {
    pub fn new() -> Rate {
        Rate { start: 0, bin: FIRST_BIN_NS, counts: vec![0; BINS], is_empty: true }
    }

    /// Takes an event at `t`, ns.
    #[inline]
    pub fn add(&mut self, t: i64) {
        if self.is_empty {
            self.is_empty = false;
            self.start = i128::from(t);
        }
        let mut at = i128::from(t) - self.start;
        if at < 0 || at >= i128::from(self.bin) * BINS as i128 {
            at = self.grow(t);
        }
        self.counts[(at as u128 / u128::from(self.bin)) as usize] += 1;
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
            self.counts = vec![0; BINS];
            let from = if at < 0 { BINS / 2 } else { 0 };
            self.counts[from..from + BINS / 2].copy_from_slice(&joined);
            if at < 0 {
                self.start -= length;
            }
            self.bin *= 2;
        }
    }

    pub fn survey(self) -> RateSurvey {
        let (Some(first), Some(last)) = (self.counts.iter().position(|n| *n > 0), self.counts.iter().rposition(|n| *n > 0)) else {
            return RateSurvey::default();
        };
        let start = self.start + first as i128 * i128::from(self.bin);
        RateSurvey { start_ns: start.clamp(i64::MIN.into(), i64::MAX.into()) as i64, bin_ns: self.bin, counts: self.counts[first..=last].to_vec() }
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
    fn an_even_rate_stays_even() {
        let mut rate = Rate::new();
        (0..100_000).for_each(|k| rate.add(k * 1_000));
        let found = rate.survey();
        assert_eq!((found.start_ns, found.bin_ns), (0, 512_000));
        assert!(found.counts[..found.counts.len() - 1].iter().all(|n| *n == 512), "{:?}", found.counts);
    }
}
