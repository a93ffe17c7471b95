//! Pictures and times without a partner, and how messages name them.

use super::stamps::Row;

/// What times are, for messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Times {
    /// Pulses of this trigger line.
    Pulses(u16),
    /// Stamps of a file.
    Stamps,
}

impl Times {
    pub(super) fn one(self) -> &'static str {
        if self == Times::Stamps { "stamp" } else { "pulse" }
    }

    pub(super) fn many(self) -> String {
        match self {
            Times::Pulses(line) => format!("pulses of trigger line {line}"),
            Times::Stamps => "stamps".into(),
        }
    }
}

/// Pictures without a time, and times without a picture.
pub(super) fn alone(pictures: usize, rows: &[Row], pairs: &[(usize, usize)]) -> (Vec<usize>, Vec<usize>) {
    let (mut has_time, mut has_picture) = (vec![false; pictures], vec![false; rows.len()]);
    pairs.iter().for_each(|(picture, row)| (has_time[*picture], has_picture[*row]) = (true, true));
    let none = |has: Vec<bool>| {
        has.into_iter().enumerate().filter(|(_, has)| !has).map(|(n, _)| n).collect::<Vec<_>>()
    };
    (none(has_time), none(has_picture).into_iter().filter(|row| rows[*row].is_whole).collect())
}

/// How many of both sides a candidate leaves without a partner: "1 picture and 2 pulses have no partner".
pub(crate) fn remainder(pictures: usize, rows: &[Row], pairs: &[(usize, usize)], times: Times) -> String {
    let (pictures, unused) = alone(pictures, rows, pairs);
    let count = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
    format!("{} and {} without a partner", count(pictures.len(), "picture"), count(unused.len(), times.one()))
}
