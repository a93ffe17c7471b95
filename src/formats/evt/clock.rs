//! Times of few bits, continued over their wraps.
//!
//! EVT3 has 24 bits of microseconds and wraps every 16.777216 s; EVT2 and EVT2.1 have 34 bits (4.8 h), DAT 32
//! (71 min). A time that steps back is no wrap in itself: time words of real cameras repeat, and come
//! slightly out of order. So the smallest step is taken, forward or back, through a wrap or not: 4095, 0,
//! 4095, 0 is one wrap, one step back through it, and one wrap again.
//!
//! The period of EVT3 is so short that a gap may be longer than half of it. There, a step beyond the slack is
//! taken as one forward; and when the next time word is back where the one before was, that word was damaged
//! (a stray), and the leap is undone: one wrong word must not shift all that follows.

/// Times stay within this many ns of zero, whatever a damaged file says, so that their differences are no
/// overflow.
const FURTHEST_NS: i64 = i64::MAX / 4;

/// Continues a time over its wraps.
#[derive(Clone, Debug)]
pub(crate) struct Clock {
    /// Ticks after which the stored time begins again.
    period: i64,
    /// Steps up to this many ticks are taken as they are, forward and back.
    slack: i64,
    /// Length of a tick, ns.
    tick_ns: i64,
    /// Ticks since the file's zero; `None` before the first time word.
    ticks: Option<i64>,
    /// Where the time stood before it leapt, until the next time word.
    before_leap: Option<i64>,
}

impl Clock {
    /// A clock of so many bits.
    pub(super) fn new(bits: u32, slack: i64, tick_ns: i64) -> Clock {
        Clock { period: 1 << bits, slack, tick_ns, ticks: None, before_leap: None }
    }

    /// Has it a time?
    pub(super) fn is_set(&self) -> bool {
        self.ticks.is_some()
    }

    /// The time, ns.
    pub(super) fn ns(&self) -> i64 {
        self.ticks.unwrap_or(0).saturating_mul(self.tick_ns).clamp(-FURTHEST_NS, FURTHEST_NS)
    }

    /// What reads `raw` and lies nearest to `from`.
    fn nearest(&self, from: i64, raw: i64) -> i64 {
        let ahead = raw.wrapping_sub(from).rem_euclid(self.period);
        from.saturating_add(if ahead > self.period / 2 { ahead - self.period } else { ahead })
    }

    /// Takes a stored time. True if the one before it was a stray.
    pub(super) fn set(&mut self, raw: i64) -> bool {
        let Some(now) = self.ticks else {
            self.ticks = Some(raw);
            return false;
        };
        let near = self.nearest(now, raw);
        let small = near.abs_diff(now) <= self.slack.unsigned_abs();
        if let Some(before) = self.before_leap.take()
            && !small
        {
            let back = self.nearest(before, raw);
            if back.abs_diff(before) <= self.slack.unsigned_abs() {
                self.ticks = Some(back);
                return true;
            }
        }
        if small {
            self.ticks = Some(near);
        } else {
            self.before_leap = Some(now);
            self.ticks = Some(if near > now { near } else { near.saturating_add(self.period) });
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(raw: &[i64]) -> Vec<i64> {
        let mut clock = Clock::new(12, 64, 1);
        raw.iter()
            .map(|&raw| {
                clock.set(raw);
                clock.ns()
            })
            .collect()
    }

    #[test]
    fn a_wrap_goes_on_and_a_small_step_back_does_not_wrap() {
        assert_eq!(times(&[4094, 4095, 0, 1]), [4094, 4095, 4096, 4097]);
        assert_eq!(times(&[100, 99, 100, 101]), [100, 99, 100, 101]);
    }

    #[test]
    fn a_step_back_through_the_wrap_counts_it_once() {
        assert_eq!(times(&[4095, 0, 4095, 0, 1]), [4095, 4096, 4095, 4096, 4097]);
    }

    #[test]
    fn a_gap_of_most_of_a_period_goes_forward() {
        assert_eq!(times(&[10, 4000, 4001]), [10, 4000, 4001]);
        assert_eq!(times(&[3000, 2000, 2001]), [3000, 4096 + 2000, 4096 + 2001]);
    }

    #[test]
    fn one_damaged_time_word_does_not_shift_what_follows() {
        for wrong in (0..4096).filter(|wrong: &i64| wrong.abs_diff(2001) > 64 && wrong.abs_diff(2000) > 64) {
            assert_eq!(times(&[2000, wrong, 2001, 2002])[2..], [2001, 2002], "after {wrong}");
        }
    }

    #[test]
    fn times_of_a_hostile_file_stay_finite() {
        let mut clock = Clock::new(28, 1 << 27, 64_000);
        for n in 0..3_000_000_i64 {
            clock.set((n << 27) & ((1 << 28) - 1));
        }
        assert_eq!(clock.ns().abs(), FURTHEST_NS);
    }
}
