//! Time stamps: what step they really have, whether they go back, whether they were floats once.
//!
//! A file that says "microseconds" may hold stamps of a millisecond, stamps in clumps, stamps of a counter
//! that starts again, or stamps that were single-precision seconds. All of it shows in the differences from
//! one event to the next, in file order, and in how each stamp lies on coarser grids.
//!
//! Limits: a grid that is not a whole number of nanoseconds shows as the coarsest whole one that fits.

use serde::Serialize;

/// Differences up to so many steps are counted one by one.
const EXACT: usize = 4096;
/// Steps back that are kept as examples.
const MOST_EXAMPLES: usize = 8;
/// A single-precision second must be so many steps of the file apart for its grid to be reported from the
/// file's own.
const FLOAT_STEPS: f64 = 8.0;

/// A place at which time goes back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct StepBack {
    /// Index of the event that is earlier than the one before it.
    pub event: u64,
    /// Stamp of the one before, ns.
    pub from_ns: i64,
    /// Its own stamp, ns.
    pub to_ns: i64,
}

/// What the stamps of a stream are like.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct StampsSurvey {
    /// Step of the stored stamps as the format has it, ns.
    pub tick_ns: i64,
    /// Coarsest step on which all stamps lie, ns, seen from the first; 0 when all are equal.
    pub step_ns: i64,
    /// Difference between different neighbours that is met most often, ns; 0 when none was counted.
    pub common_step_ns: i64,
    /// Middle difference between different neighbours, ns.
    pub median_step_ns: i64,
    /// Share of events that have the stamp of the one before.
    pub equal_share: f64,
    /// Most events in a row with one stamp.
    pub longest_equal: u64,
    /// How often time goes back from one event to the next.
    pub backward: u64,
    /// Furthest step back, ns.
    pub furthest_back_ns: i64,
    /// The first steps back.
    pub back_examples: Vec<StepBack>,
    /// Events whose stamp is far enough from zero for single-precision seconds to show.
    pub float_tested: u64,
    /// Those of them that lie on a single-precision second.
    pub float_hits: u64,
}

/// Counts stamps as they come.
#[derive(Clone, Debug)]
pub(super) struct Stamps {
    tick_ns: i64,
    first: Option<i64>,
    before: i64,
    events: u64,
    step: u64,
    equal: u64,
    run: u64,
    longest_run: u64,
    backward: u64,
    furthest: i64,
    examples: Vec<StepBack>,
    exact: Vec<u64>,
    coarse: [u64; 64],
    float_tested: u64,
    float_hits: u64,
    /// From this distance from zero on, single-precision seconds are `FLOAT_STEPS` steps apart.
    float_from_ns: i64,
}

impl Stamps {
    pub(super) fn new(tick_ns: i64) -> Stamps {
        let tick_ns = tick_ns.max(1);
        // Singles of [2^k, 2^(k+1)) seconds are 2^(k-23) s apart: the first octave in which that is wide
        // enough.
        let seconds = libm::exp2(libm::ceil(libm::log2(FLOAT_STEPS * tick_ns as f64 * 1e-9)) + 23.0);
        let float_from_ns = if seconds < 9e9 { (seconds * 1e9) as i64 } else { i64::MAX };
        Stamps {
            tick_ns,
            first: None,
            before: 0,
            events: 0,
            step: 0,
            equal: 0,
            run: 0,
            longest_run: 0,
            backward: 0,
            furthest: 0,
            examples: Vec::new(),
            exact: vec![0; EXACT],
            coarse: [0; 64],
            float_tested: 0,
            float_hits: 0,
            float_from_ns,
        }
    }

    /// Takes the next stamp, ns.
    #[inline]
    pub(super) fn add(&mut self, t: i64) {
        let first = *self.first.get_or_insert(t);
        let from_first = t.abs_diff(first);
        // The greatest common divisor changes a few dozen times at most.
        if self.step == 0 || !from_first.is_multiple_of(self.step) {
            self.step = gcd(self.step, from_first);
        }
        if self.events > 0 {
            let difference = t.wrapping_sub(self.before);
            if difference == 0 {
                self.equal += 1;
                self.run += 1;
                self.longest_run = self.longest_run.max(self.run);
            } else {
                self.run = 1;
                if t < self.before {
                    self.back(t);
                } else {
                    let steps = difference as u64 / self.tick_ns as u64;
                    if let Some(count) = self.exact.get_mut(steps as usize) {
                        *count += 1;
                    }
                    self.coarse[63 - (difference as u64 | 1).leading_zeros() as usize] += 1;
                }
            }
        } else {
            self.run = 1;
            self.longest_run = 1;
        }
        if t >= self.float_from_ns {
            self.float_tested += 1;
            let nearest = (f64::from((t as f64 * 1e-9) as f32) * 1e9 - t as f64).abs();
            self.float_hits += u64::from(nearest <= self.tick_ns as f64);
        }
        self.before = t;
        self.events += 1;
    }

    #[cold]
    fn back(&mut self, t: i64) {
        self.backward += 1;
        self.furthest = self.furthest.max(self.before.saturating_sub(t));
        let is_large = self
            .examples
            .iter()
            .map(|one| one.from_ns.saturating_sub(one.to_ns))
            .min()
            .is_none_or(|least| self.before.saturating_sub(t) > least);
        if self.examples.len() < MOST_EXAMPLES {
            self.examples.push(StepBack { event: self.events, from_ns: self.before, to_ns: t });
        } else if is_large
            && let Some(least) =
                self.examples.iter_mut().min_by_key(|one| one.from_ns.saturating_sub(one.to_ns))
        {
            // The furthest ones say most.
            *least = StepBack { event: self.events, from_ns: self.before, to_ns: t };
        }
    }

    pub(super) fn survey(mut self) -> StampsSurvey {
        self.examples.sort_by_key(|one| one.event);
        let common = self
            .exact
            .iter()
            .enumerate()
            .max_by_key(|(steps, count)| (**count, std::cmp::Reverse(*steps)))
            .filter(|(_, count)| **count > 0);
        StampsSurvey {
            tick_ns: self.tick_ns,
            step_ns: i64::try_from(self.step).unwrap_or(i64::MAX),
            common_step_ns: common.map_or(0, |(steps, _)| steps as i64 * self.tick_ns),
            median_step_ns: self.median(),
            equal_share: self.equal as f64 / self.events.saturating_sub(1).max(1) as f64,
            longest_equal: self.longest_run,
            backward: self.backward,
            furthest_back_ns: self.furthest,
            back_examples: self.examples,
            float_tested: self.float_tested,
            float_hits: self.float_hits,
        }
    }

    /// Exact where the median lies among the differences that were counted one by one, otherwise within a
    /// factor of 1.4.
    fn median(&self) -> i64 {
        let all: u64 = self.coarse.iter().sum();
        let mut below = 0;
        for (steps, count) in self.exact.iter().enumerate() {
            below += count;
            if 2 * below >= all && all > 0 {
                return steps as i64 * self.tick_ns;
            }
        }
        let mut below = 0;
        for (bit, count) in self.coarse.iter().enumerate() {
            below += count;
            if 2 * below >= all && all > 0 {
                return (libm::exp2(bit as f64 + 0.5)) as i64;
            }
        }
        0
    }
}

fn gcd(mut a: u64, mut b: u64) -> u64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(tick_ns: i64, stamps: impl IntoIterator<Item = i64>) -> StampsSurvey {
        let mut counted = Stamps::new(tick_ns);
        stamps.into_iter().for_each(|t| counted.add(t));
        counted.survey()
    }

    #[test]
    fn the_step_is_that_of_all_stamps_and_not_the_nominal_one() {
        let found = of(1_000, [7_000, 17_000, 17_000, 47_000, 57_000, 67_000]);
        assert_eq!((found.step_ns, found.common_step_ns, found.median_step_ns), (10_000, 10_000, 10_000));
        assert_eq!((found.equal_share, found.longest_equal, found.backward), (0.2, 2, 0));
        assert_eq!(of(1_000, [7_000, 7_000]).step_ns, 0);
    }

    #[test]
    fn time_that_goes_back_is_counted_and_the_furthest_steps_are_kept() {
        let mut stamps: Vec<i64> = (0..100).flat_map(|k| [k * 100, k * 100 + 50, k * 100 + 40]).collect();
        stamps.push(-5_000);
        let found = of(1, stamps);
        assert_eq!((found.backward, found.furthest_back_ns), (101, 14_940));
        assert_eq!(found.back_examples.last(), Some(&StepBack { event: 300, from_ns: 9_940, to_ns: -5_000 }));
    }

    /// Single-precision seconds between 128 and 256 s are 2^-16 s apart, 15.26 us.
    #[test]
    fn seconds_that_were_single_precision_lie_on_its_grid() {
        let microseconds = |k: i64| 130_000_000 + 37 * k;
        let rounded = of(
            1_000,
            (0..5_000).map(|k| (f64::from((microseconds(k) as f64 * 1e-6) as f32) * 1e6) as i64 * 1_000),
        );
        assert_eq!((rounded.float_tested, rounded.float_hits), (5_000, 5_000));
        let exact = of(1_000, (0..5_000).map(|k| microseconds(k) * 1_000));
        assert!(exact.float_hits * 3 < exact.float_tested, "{} of {}", exact.float_hits, exact.float_tested);
    }
}
