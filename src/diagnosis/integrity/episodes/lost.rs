//! A rectangle of the array without events for a while, between two instants common to all of it.

use super::{Episode, Failure, LONGEST, cell_side};
use crate::integrity::array::StampedEvent;
use photocurrent_scene::case::Case;

/// Least number of events expected in a cell's gap.
const EXPECTED: f64 = 12.0;
/// Gaps of cells are one where they share this much of the longer one.
const SHARED: f64 = 0.8;
/// Least number of cells, and their least share of the rectangle.
const FEWEST: usize = 4;
const FILLED: f64 = 0.8;
/// Cells outside go on firing at this share of their rate, and this share of them does.
const GOES_ON: f64 = 0.3;
const OUTSIDE: f64 = 0.7;
/// Just before and after the gap, within this share of it, the rectangle fires with this share of its rate,
/// where that many events are expected.
const EDGE: f64 = 0.1;
const STANDS: f64 = 0.4;
const EDGE_EVENTS: f64 = 20.0;
/// Rows and columns are without events but for this part of the gap at each end, or this long, ns.
const RIM: i64 = 20;
const RIM_NS: i64 = 2_000_000;

/// A cell's longest gap.
#[derive(Clone, Copy)]
struct LongestGap {
    from: i64,
    to: i64,
    /// Events a nanosecond at other times.
    rate: f64,
}

impl LongestGap {
    fn expected(&self) -> f64 {
        self.rate * (self.to - self.from) as f64
    }

    /// Shared time over the longer one's.
    fn shares(&self, other: &LongestGap) -> f64 {
        let shared = self.to.min(other.to) - self.from.max(other.from);
        shared.max(0) as f64 / i64::max(self.to - self.from, other.to - other.from).max(1) as f64
    }
}

/// The rectangle whose gap is the least probable.
pub(super) fn lost(case: &Case, stream: &[StampedEvent]) -> Option<Episode> {
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let side = cell_side(case);
    let across = width.div_ceil(side);
    let mut times: Vec<Vec<i64>> = vec![Vec::new(); across * height.div_ceil(side)];
    let cell = |pixel: u32| (pixel as usize / width / side) * across + pixel as usize % width / side;
    stream.iter().for_each(|event| times[cell(event.pixel)].push(event.t_ns));
    let span = (stream.first()?.t_ns, stream.last()?.t_ns);
    let gaps: Vec<Option<LongestGap>> = times.iter().map(|times| gap(times, span)).collect();
    let anchor = gaps.iter().flatten().max_by(|a, b| a.expected().total_cmp(&b.expected()))?;
    let is_member = |cell: usize| gaps[cell].is_some_and(|one| one.shares(anchor) >= SHARED);
    let members: Vec<usize> = (0..gaps.len()).filter(|&cell| is_member(cell)).collect();
    let of = |value: fn(usize, usize) -> usize| {
        let all = members.iter().map(|&cell| value(cell, across));
        (all.clone().min().unwrap_or(0), all.max().unwrap_or(0))
    };
    let (left, right) = of(|cell, across| cell % across);
    let (top, bottom) = of(|cell, across| cell / across);
    let is_in =
        |cell: usize| (left..=right).contains(&(cell % across)) && (top..=bottom).contains(&(cell / across));
    let can_show = |cell: &usize| gaps[*cell].is_some();
    let within: Vec<usize> = (0..gaps.len()).filter(|&cell| is_in(cell)).filter(can_show).collect();
    let begins = members.iter().filter_map(|&cell| Some(gaps[cell]?.from)).max()?;
    let ends = members.iter().filter_map(|&cell| Some(gaps[cell]?.to)).min()?;
    let is_filled = members.len() >= FEWEST && members.len() as f64 >= FILLED * within.len() as f64;
    if !is_filled || ends <= begins || (ends - begins) as f64 > LONGEST * (span.1 - span.0) as f64 {
        return None;
    }
    let within_ns = |cell: usize, from: i64, to: i64| {
        (times[cell].partition_point(|t| *t < to) - times[cell].partition_point(|t| *t < from)) as f64
    };
    let length = (ends - begins) as f64;
    // The rest of the array fires on.
    let outside: Vec<usize> = (0..gaps.len()).filter(|&cell| !is_in(cell)).filter(can_show).collect();
    let goes_on = |cell: &&usize| {
        let rate = times[**cell].len() as f64 / (span.1 - span.0) as f64;
        within_ns(**cell, begins, ends) >= GOES_ON * rate * length
    };
    let going = outside.iter().filter(goes_on).count();
    if outside.len() < FEWEST || (going as f64) < OUTSIDE * outside.len() as f64 {
        return None;
    }
    // Sharp ends, but for that of the recording.
    let edge = (EDGE * length) as i64;
    let stands = |from: i64, to: i64| {
        let (from, to) = (from.max(span.0), to.min(span.1));
        let rate: f64 = members.iter().filter_map(|&cell| Some(gaps[cell]?.rate)).sum();
        let expected = rate * (to - from).max(0) as f64;
        let there: f64 = members.iter().map(|&cell| within_ns(cell, from, to)).sum();
        expected >= EDGE_EVENTS && there >= STANDS * expected
    };
    let is_first = begins <= span.0 + edge;
    let is_last = ends >= span.1 - edge;
    if !(is_first || stands(begins - edge, begins + 1)) || !(is_last || stands(ends, ends + edge)) {
        return None;
    }
    let rate: f64 = members.iter().filter_map(|&cell| Some(gaps[cell]?.rate)).sum();
    let cells = [left, right, top, bottom].map(|at| at * side);
    let [rows, columns] = edges(case, stream, (begins, ends), (cells, side));
    Some(Episode {
        failure: Failure::Lost,
        time_ns: [begins, ends],
        rows,
        columns,
        pixels: Vec::new(),
        statistic: rate * length / (EXPECTED * FEWEST as f64),
        seen: format!(
            "rows {} to {} and columns {} to {} have no event for {:.1} ms, where {:.0} would have come; \
             the rest of the array fires on",
            rows[0],
            rows[1],
            columns[0],
            columns[1],
            length * 1e-6,
            rate * length
        ),
    })
}

/// The longest gap of a cell; `None` where too few events were expected in it.
fn gap(times: &[i64], span: (i64, i64)) -> Option<LongestGap> {
    let ends =
        std::iter::once(span.0).chain(times.iter().copied()).zip(times.iter().copied().chain([span.1]));
    let (from, to) = ends.max_by_key(|(from, to)| to - from)?;
    let rest = (span.1 - span.0 - (to - from)).max(1) as f64;
    let found = LongestGap { from, to, rate: times.len() as f64 / rest };
    (found.expected() >= EXPECTED).then_some(found)
}

/// Rows and columns without events: from the cells outwards, up to the first with events.
fn edges(
    case: &Case,
    stream: &[StampedEvent],
    (begins, ends): (i64, i64),
    ([left, right, top, bottom], side): ([usize; 4], usize),
) -> [[u32; 2]; 2] {
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let (right, bottom) = ((right + side).min(width), (bottom + side).min(height));
    let (mut rows, mut columns) = (vec![0_usize; height], vec![0_usize; width]);
    // The last event of the cells lies before the beginning, and other pixels' may be later.
    let rim = ((ends - begins) / RIM).min(RIM_NS);
    let (begins, ends) = (begins + rim, ends - rim);
    for event in stream.iter().filter(|event| event.t_ns > begins && event.t_ns < ends) {
        let (x, y) = (event.pixel as usize % width, event.pixel as usize / width);
        if (left..right).contains(&x) {
            rows[y] += 1;
        }
        if (top..bottom).contains(&y) {
            columns[x] += 1;
        }
    }
    let grown = |counts: &[usize], from: usize, to: usize| {
        let first = (0..from).rev().take_while(|&at| counts[at] == 0).last().unwrap_or(from);
        let last = (to..counts.len()).take_while(|&at| counts[at] == 0).last().unwrap_or(to - 1);
        [first as u32, last as u32]
    };
    [grown(&rows, top, bottom), grown(&columns, left, right)]
}
