//! Which picture belongs to which time, where no name says so: pictures of a folder with the pulses of a
//! trigger line, or with the lines of a stamps file.
//!
//! Either side may miss some. A hole in the numbers of the pictures' names shows a picture that is lost; a
//! gap of whole periods between the times shows a pulse that is. Both give every picture and every time a
//! slot on a line of even steps, and a pairing is the slot of the first picture ([`Candidate::first`]). Each
//! candidate has a cost: what it leaves without a partner at either end, and holes and gaps that it does not
//! use. The cheapest is taken where nothing else comes near; otherwise it is a question, and never an answer
//! ([`Unclear`]).
//!
//! Limits: a first pulse and a last picture that are both missing leave no trace in counts, numbers and
//! periods. Only events show that: see [`crate::pairings`].

use super::partners::{Times, remainder};
use super::stamps::Row;
use crate::declared::{Declared, Pairing};
use crate::error::FormatError;
use std::path::Path;

/// What it costs to leave something at one end without a partner.
const END: u32 = 4;
/// The most that more than one of them add, and the most that unused holes or gaps add.
const MORE: u32 = 4;
/// Holes in numbers, or gaps between times, that a pairing makes no use of.
const UNUSED: u32 = 2;
/// A second candidate that costs less than this more is a doubt.
const MARGIN: u32 = 4;
/// Candidates that are compared one by one.
const COMPARED: usize = 1 << 12;

/// A way to pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Candidate {
    /// By what missing ones are recognised.
    pub by: Pairing,
    /// The slot of the first picture; 0 is the first time.
    pub first: i64,
    /// What speaks against it, in quarters of one that is missing at an end.
    pub cost: u32,
}

/// No pairing is clearly the best.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Unclear {
    /// The cheapest, and one that is nearly as cheap and pairs differently.
    pub(crate) best: Candidate,
    pub(crate) second: Candidate,
}

/// One side on a line of even steps.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Side {
    /// Slots by order, then by numbers or times; the same where nothing is missing.
    slots: Vec<i64>,
    /// How many are missing between the first and the last.
    missing: i64,
}

impl Side {
    fn last(&self, uses: bool) -> i64 {
        if uses { self.slots.last().copied().unwrap_or(0) } else { self.slots.len() as i64 - 1 }
    }

    fn slot(&self, n: usize, uses: bool) -> i64 {
        if uses { self.slots[n] } else { n as i64 }
    }

    /// How many lie below a slot.
    fn below(&self, slot: i64, uses: bool) -> usize {
        if uses {
            self.slots.partition_point(|own| *own < slot)
        } else {
            slot.clamp(0, self.slots.len() as i64) as usize
        }
    }
}

/// Both sides.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Sides {
    pictures: Side,
    times: Side,
    /// How many of the times before each are whole.
    whole_before: Vec<usize>,
    /// Number of the first picture, where names count by ones.
    first_number: Option<i64>,
    /// The slot of the first picture where times are numbered as the pictures are.
    same_numbers: Option<i64>,
    /// Are times written with the pictures, one for each?
    together: bool,
}

impl Sides {
    /// Of pictures by name in order, and of times.
    pub(crate) fn new(names: &[String], rows: &[Row]) -> Sides {
        let times: Vec<i64> = rows.iter().map(|row| row.at).collect();
        let index: Option<Vec<i64>> = rows.iter().map(|row| row.index).collect();
        // No more slots than are worth their memory: numbers may be as far apart as 64 bits allow.
        let most = 4 * (names.len() + rows.len()) as i64 + 64;
        let rises = |index: &Vec<i64>| index.windows(2).all(|pair| pair[0] < pair[1]);
        let reaches = |index: &Vec<i64>| {
            index.first().zip(index.last()).is_some_and(|(first, last)| last.saturating_sub(*first) <= most)
        };
        let index = index.filter(|index| rises(index) && reaches(index));
        let count = |n: usize| (0..n as i64).collect::<Vec<i64>>();
        let bounded = |slots: Vec<i64>| {
            if slots.last().is_some_and(|last| *last > most) { count(slots.len()) } else { slots }
        };
        let stepped = |values: &[i64]| slots(values, usual(values)).unwrap_or_else(|| count(values.len()));
        let times = index.as_deref().map_or_else(
            || stepped(&times),
            |index| index.iter().map(|n| n.saturating_sub(index[0])).collect(),
        );
        let numbers = numbers(names);
        let span = times.last().copied().unwrap_or(0);
        let (pictures, by_ones) = match &numbers {
            None => (count(names.len()), false),
            Some(numbers) => {
                // Every second picture of a camera that was triggered each time, or names that count by twos.
                let reach = numbers[numbers.len() - 1].saturating_sub(numbers[0]);
                let by_ones = reach <= span.saturating_add(span / 2).saturating_add(2) || usual(numbers) == 1;
                (
                    slots(numbers, if by_ones { 1 } else { usual(numbers) })
                        .unwrap_or_else(|| count(names.len())),
                    by_ones,
                )
            }
        };
        // What is missing cannot be more than the other side has: a number that begins anew, a pause.
        let pictures = bounded(shortened(pictures, span.max(rows.len() as i64 - 1)));
        let times = if index.is_some() {
            times
        } else {
            bounded(shortened(times, pictures.last().copied().unwrap_or(0)))
        };
        let side = |slots: Vec<i64>| Side {
            missing: slots.last().map_or(0, |last| last + 1 - slots.len() as i64),
            slots,
        };
        let first_number = numbers.filter(|_| by_ones).and_then(|numbers| numbers.first().copied());
        let first_index = index.and_then(|index| index.first().copied());
        let same_numbers =
            first_number.zip(first_index).map(|(number, index)| number.saturating_sub(index)).filter(|_| {
                // From 0 and from 1: one of the two counts differently, or misses its first.
                first_number.zip(first_index).is_some_and(|(a, b)| (a.min(b), a.max(b)) != (0, 1))
            });
        let mut whole_before = vec![0];
        rows.iter().for_each(|row| {
            whole_before.push(whole_before[whole_before.len() - 1] + usize::from(row.is_whole))
        });
        let together = first_index.is_none() && rows.iter().all(|row| row.line > 0);
        Sides {
            pictures: side(pictures),
            times: side(times),
            whole_before,
            first_number,
            same_numbers,
            together,
        }
    }

    /// The pairs of a candidate: picture and time, by their places.
    pub(crate) fn pairs(&self, candidate: &Candidate) -> Vec<(usize, usize)> {
        let (by_number, by_time) = (candidate.by.uses_numbers(), candidate.by.uses_times());
        let (mut pairs, mut time) = (Vec::new(), 0);
        for picture in 0..self.pictures.slots.len() {
            let slot = self.pictures.slot(picture, by_number).saturating_add(candidate.first);
            while time < self.times.slots.len() && self.times.slot(time, by_time) < slot {
                time += 1;
            }
            if time < self.times.slots.len() && self.times.slot(time, by_time) == slot {
                pairs.push((picture, time));
            }
        }
        pairs
    }

    /// Holes and gaps of one side cost the same whether one or the other is used, so only what is left at the
    /// ends counts, and what is not used.
    fn cost(&self, by: Pairing, first: i64) -> u32 {
        let (by_number, by_time) = (by.uses_numbers(), by.uses_times());
        let counts = by_number || self.pictures.missing == 0;
        let few = |n: usize| if n == 0 { 0 } else { END + MORE.min(n as u32 - 1) };
        let whole = |from: usize, to: usize| self.whole_before[to] - self.whole_before[from];
        let (pictures, times) = (self.pictures.slots.len(), self.times.slots.len());
        let (last_picture, last_time) =
            (self.pictures.last(by_number).saturating_add(first), self.times.last(by_time));
        let before = if first > 0 {
            let left = few(whole(0, self.times.below(first, by_time)));
            // Names that begin at 2 show that two pictures are lost, if they count from 0.
            match self.first_number.filter(|number| *number >= 2) {
                Some(number) if counts && first == number => left.min(1),
                Some(number) if counts && first == number - 1 => left.min(2),
                _ => left,
            }
        } else {
            few(self.pictures.below(first.saturating_neg(), by_number))
        };
        let after = if last_picture < last_time {
            few(whole(self.times.below(last_picture.saturating_add(1), by_time), times))
        } else {
            few(pictures - self.pictures.below(last_time.saturating_add(1).saturating_sub(first), by_number))
        };
        let ends = if counts && self.same_numbers == Some(first) { 0 } else { before + after };
        let unused = |uses: bool, missing: i64| {
            if uses || missing == 0 { 0 } else { UNUSED + MORE.min(missing.min(8) as u32 - 1) }
        };
        ends + unused(by_number, self.pictures.missing) + unused(by_time, self.times.missing)
    }

    /// Every candidate that leaves at least one pair, the cheapest first; of one cost, those with the most
    /// pairs by order of [`Candidate::first`].
    pub(crate) fn candidates(&self, declared: &Declared) -> Vec<Candidate> {
        let (holes, gaps) = (self.pictures.missing > 0, self.times.missing > 0);
        let all = [
            (Pairing::NumbersAndTimes, true, true),
            (Pairing::Numbers, true, false),
            (Pairing::Times, false, true),
            (Pairing::Order, false, false),
        ];
        let mut found = Vec::new();
        for (by, numbers, times) in all {
            let is_one = declared
                .pairing
                .map_or_else(|| (!numbers || holes) && (!times || gaps), |stated| stated == by);
            if !is_one || self.pictures.slots.is_empty() || self.times.slots.is_empty() {
                continue;
            }
            let range = -self.pictures.last(numbers)..=self.times.last(times);
            match declared.first_pulse {
                Some(first) => found.extend(range.contains(&first).then(|| Candidate {
                    by,
                    first,
                    cost: self.cost(by, first),
                })),
                None => found.extend(range.map(|first| Candidate { by, first, cost: self.cost(by, first) })),
            }
        }
        found.sort_by_key(|candidate| candidate.cost);
        found
    }

    /// The pairing, where one is clearly the best; none where there is nothing to pair.
    pub(crate) fn decide(&self, declared: &Declared) -> Result<Option<Candidate>, Unclear> {
        let is_open = declared.first_pulse.is_none() && declared.pairing.is_none();
        if is_open && self.together && self.pictures.slots.len() == self.times.slots.len() {
            return Ok(Some(Candidate { by: Pairing::Order, first: 0, cost: 0 }));
        }
        let candidates = self.candidates(declared);
        let Some(&best) = candidates.first() else { return Ok(None) };
        let pairs = self.pairs(&best);
        let near =
            candidates.iter().skip(1).take_while(|other| other.cost < best.cost + MARGIN).take(COMPARED);
        match near.copied().find(|other| self.pairs(other) != pairs) {
            Some(second) => Err(Unclear { best, second }),
            None => Ok(Some(best)),
        }
    }
}

/// Frames of an array and the times of another: `(frame, time)` of those that belong together, and a note
/// where some have no partner. Equal numbers belong together in order; of unequal ones a gap of whole periods
/// between the times is a time that is missing.
///
/// # Errors
/// When it stays open which belong together, with the ways to state it.
pub(crate) fn of_array(
    path: &Path,
    frames: usize,
    times: &[i64],
    declared: &Declared,
) -> Result<Paired, FormatError> {
    if frames == times.len() && declared.first_pulse.is_none() && declared.pairing.is_none() {
        return Ok(((0..frames).map(|n| (n, n)).collect(), None));
    }
    let rows: Vec<Row> = times.iter().map(|at| Row::at(*at, None, true)).collect();
    let sides = Sides::new(&vec![String::new(); frames], &rows);
    let what = format!("{frames} frames and {} stamps", times.len());
    match sides.decide(declared) {
        Ok(Some(candidate)) => {
            let pairs = sides.pairs(&candidate);
            let note = format!(
                "{what}: paired by the period of the stamps; {}",
                remainder(frames, &rows, &pairs, Times::Stamps)
            );
            Ok((pairs, Some(note)))
        }
        Ok(None) => Ok((Vec::new(), Some(format!("{what}: none belongs to another")))),
        Err(Unclear { best, second }) => {
            let with_by = best.by != second.by;
            let of = |candidate: &Candidate| {
                format!(
                    "{} leaves {}",
                    stated(candidate, with_by),
                    remainder(frames, &rows, &sides.pairs(candidate), Times::Stamps)
                )
            };
            let hint = format!("state it: {}, {}", of(&best), of(&second));
            let field = if best.first == second.first { "pairing" } else { "first_pulse" };
            Err(FormatError::new(
                path,
                format!("{what}: counts and gaps between the stamps leave open which belong together"),
                hint,
            )
            .undeclared(field))
        }
    }
}

/// Frames with their times, and a note where some have none.
pub(crate) type Paired = (Vec<(usize, usize)>, Option<String>);

/// The lower middle of the steps; 0 without any.
fn usual(values: &[i64]) -> i64 {
    let mut steps: Vec<i64> = values.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
    steps.sort_unstable();
    if steps.is_empty() { 0 } else { steps[(steps.len() - 1) / 2] }
}

/// From the first time to the last, in usual steps; none where a step is no whole number of them.
pub(crate) fn periods(times: &[i64]) -> Option<i64> {
    slots(times, usual(times)).and_then(|slots| slots.last().copied())
}

/// Values as whole numbers of steps from the first; none where a step is no whole number of usual ones, to a
/// quarter.
fn slots(values: &[i64], usual: i64) -> Option<Vec<i64>> {
    let mut all = Vec::with_capacity(values.len());
    all.push(0_i64);
    for pair in values.windows(2) {
        let step = pair[1].checked_sub(pair[0]).filter(|step| *step > 0 && usual > 0)?;
        let steps = step.saturating_add(usual / 2) / usual;
        if steps < 1 || step.abs_diff(steps.saturating_mul(usual)) > usual.unsigned_abs() / 4 {
            return None;
        }
        all.push(all[all.len() - 1].checked_add(steps)?);
    }
    all.truncate(values.len());
    Some(all)
}

/// With steps longer than `most` as single ones.
fn shortened(slots: Vec<i64>, most: i64) -> Vec<i64> {
    let mut at = 0_i64;
    let mut before = slots.first().copied().unwrap_or(0);
    slots
        .into_iter()
        .map(|slot| {
            let step = slot - before;
            before = slot;
            at = at.saturating_add(if step > most.max(1) { 1 } else { step });
            at
        })
        .collect()
}

/// The numbers by which names are counted: the last group of digits that rises from name to name.
fn numbers(names: &[String]) -> Option<Vec<i64>> {
    let groups = |name: &String| -> Vec<Option<i64>> {
        let stem = name.rsplit_once('.').map_or(name.as_str(), |(stem, _)| stem);
        stem.split(|c: char| !c.is_ascii_digit())
            .filter(|digits| !digits.is_empty())
            .map(|digits| digits.parse().ok())
            .collect()
    };
    let all: Vec<Vec<Option<i64>>> = names.iter().map(groups).collect();
    let count = all.first()?.len();
    if all.iter().any(|groups| groups.len() != count) {
        return None;
    }
    (0..count).rev().find_map(|n| {
        let column: Option<Vec<i64>> = all.iter().map(|groups| groups[n]).collect();
        column.filter(|column| column.windows(2).all(|pair| pair[0] < pair[1]))
    })
}

/// One of several ways to pair, as it is stated, and what it leaves over.
pub(crate) fn stated(candidate: &Candidate, with_by: bool) -> String {
    let by = if with_by { format!(", `pairing = \"{}\"`", candidate.by.name()) } else { String::new() };
    format!("`first_pulse = {}`{by}", candidate.first)
}

#[cfg(test)]
#[path = "pairing_tests.rs"]
mod tests;
