//! Instants and intervals in whole nanoseconds.
//!
//! A sensor's clock has no float: a microsecond stamp converts exactly, and a time-to-digital converter's
//! sub-microsecond stamp survives. Seconds in `f64` appear only inside an equation, at its door.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::{Add, Sub};

/// Nanoseconds in a second.
pub const NS_PER_S: f64 = 1e9;

/// Nanoseconds as seconds for people, every digit that counts: `0.005001 s`.
pub fn in_seconds(ns: i64) -> String {
    let (sign, ns) = (if ns < 0 { "-" } else { "" }, ns.unsigned_abs());
    let fraction = format!("{:09}", ns % 1_000_000_000);
    let fraction = fraction.trim_end_matches('0');
    let point = if fraction.is_empty() { "" } else { "." };
    format!("{sign}{}{point}{fraction} s", ns / 1_000_000_000)
}

/// An instant, in nanoseconds since the recording's own zero. May be negative.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Timestamp(pub i64);

impl Add<i64> for Timestamp {
    type Output = Timestamp;
    fn add(self, ns: i64) -> Timestamp {
        Timestamp(self.0 + ns)
    }
}

impl Sub for Timestamp {
    type Output = i64;
    fn sub(self, other: Timestamp) -> i64 {
        self.0 - other.0
    }
}

impl fmt::Display for Timestamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{:06} ms", self.0.div_euclid(1_000_000), self.0.rem_euclid(1_000_000))
    }
}

/// A half-open interval of time, `start <= t < end`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct TimeSpan {
    /// First instant inside.
    pub start: Timestamp,
    /// First instant after.
    pub end: Timestamp,
}

impl TimeSpan {
    /// From nanoseconds; an end before the start gives an empty span at the start.
    pub fn new(start_ns: i64, end_ns: i64) -> TimeSpan {
        TimeSpan { start: Timestamp(start_ns), end: Timestamp(end_ns.max(start_ns)) }
    }

    /// Length in nanoseconds, never negative.
    pub fn length_ns(&self) -> i64 {
        self.end - self.start
    }

    /// The same length, `ns` later.
    pub fn moved(self, ns: i64) -> TimeSpan {
        TimeSpan { start: self.start + ns, end: self.end + ns }
    }

    /// The smallest span that holds both.
    pub fn union(self, other: TimeSpan) -> TimeSpan {
        TimeSpan { start: self.start.min(other.start), end: self.end.max(other.end) }
    }
}

/// When a row of photodiodes collects light: `t_s`, `t_e` of Eq. (5), for one row of one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Exposure {
    /// `t_s`: the exposure starts.
    pub start: Timestamp,
    /// `t_e`: the exposure ends.
    pub end: Timestamp,
}

impl Exposure {
    /// From nanoseconds.
    pub fn new(start_ns: i64, end_ns: i64) -> Exposure {
        Exposure { start: Timestamp(start_ns), end: Timestamp(end_ns) }
    }

    /// Length in nanoseconds.
    pub fn length_ns(&self) -> i64 {
        self.end - self.start
    }

    /// Length in seconds.
    pub fn seconds(&self) -> f64 {
        self.length_ns() as f64 / NS_PER_S
    }

    /// The middle, rounded towards the start.
    pub fn mid(&self) -> Timestamp {
        Timestamp(self.start.0 + self.length_ns().div_euclid(2))
    }

    /// The same exposure of a row that is read `delay_ns` later.
    pub fn delayed(&self, delay_ns: i64) -> Exposure {
        Exposure { start: self.start + delay_ns, end: self.end + delay_ns }
    }
}

/// What is known at rising instants, ns, at another one, `t_ns`, of which number `after` is the first behind:
/// `join` of the values on both sides and of the share of the way from one to the other; beyond either end
/// the value there. `None` without instants.
#[inline]
pub fn between<T>(
    instants: &[i64],
    after: usize,
    t_ns: i64,
    value: impl Fn(usize) -> T,
    join: impl FnOnce(T, T, f64) -> T,
) -> Option<T> {
    match (after.checked_sub(1), instants.get(after)) {
        (None, None) => None,
        (None, Some(_)) => Some(value(0)),
        (Some(last), None) => Some(value(last)),
        (Some(before), Some(&next)) => {
            let share = (t_ns - instants[before]) as f64 / (next - instants[before]) as f64;
            Some(join(value(before), value(after), share))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_negative_instant_prints_with_its_whole_milliseconds_below_it() {
        assert_eq!(Timestamp(1_500_000).to_string(), "1.500000 ms");
        assert_eq!(Timestamp(-500_000).to_string(), "-1.500000 ms");
    }

    #[test]
    fn seconds_have_the_digits_that_count() {
        assert_eq!(
            [0, 5_001_000, -1_500_000_000, 1_600_000_000_000_000_000].map(in_seconds),
            ["0 s", "0.005001 s", "-1.5 s", "1600000000 s"]
        );
        assert_eq!(in_seconds(i64::MIN), "-9223372036.854775808 s");
    }

    #[test]
    fn the_middle_of_an_odd_exposure_rounds_towards_its_start() {
        assert_eq!(Exposure::new(10, 13).mid(), Timestamp(11));
    }
}
