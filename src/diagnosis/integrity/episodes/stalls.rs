//! Stalls of the readout: no event for milliseconds, then all delayed ones at once.

use super::{Episode, Failure, LONGEST};
use crate::integrity::array::StampedEvent;
use photocurrent_scene::case::Case;
use photocurrent_scene::statistics::median;

/// Shorter gaps are no stalls, ns.
const SHORTEST_NS: i64 = 500_000;
/// Longest release, as a share of the gap before it.
const RELEASED: f64 = 0.05;
/// Least number of consecutive gaps.
const FEWEST: usize = 3;
/// Least number of events in a release, median: a chance of exp(-20) that none came before.
const LEAST_EVENTS: f64 = 20.0;

/// The longest row of gaps with releases between them.
pub(super) fn stalls(case: &Case, stream: &[StampedEvent]) -> Option<Episode> {
    let (first, last) = (stream.first()?.t_ns, stream.last()?.t_ns);
    // Gaps as the numbers of the events before them.
    let gaps: Vec<usize> = (1..stream.len())
        .filter(|&k| stream[k].t_ns - stream[k - 1].t_ns >= SHORTEST_NS)
        .map(|k| k - 1)
        .collect();
    let length = |k: usize| stream[k + 1].t_ns - stream[k].t_ns;
    let follows = |pair: &[usize]| {
        let released_ns = stream[pair[1]].t_ns - stream[pair[0] + 1].t_ns;
        released_ns as f64 <= RELEASED * length(pair[0]) as f64
    };
    let mut best: &[usize] = &[];
    let mut from = 0;
    for k in 1..=gaps.len() {
        if k == gaps.len() || !follows(&gaps[k - 1..=k]) {
            let row = &gaps[from..k];
            let is_longer = |row: &[usize]| row.last().map_or(0, |end| end - row[0]);
            if row.len() >= FEWEST && is_longer(row) > is_longer(best) {
                best = row;
            }
            from = k;
        }
    }
    let (begin, end) = (*best.first()?, *best.last()?);
    let mut released: Vec<f64> = best.windows(2).map(|pair| (pair[1] - pair[0]) as f64).collect();
    let events = median(&mut released);
    let time_ns = [stream[begin].t_ns, stream[end + 1].t_ns];
    if events < LEAST_EVENTS || (time_ns[1] - time_ns[0]) as f64 > LONGEST * (last - first) as f64 {
        return None;
    }
    let mut lengths: Vec<f64> = best.iter().map(|&k| length(k) as f64).collect();
    let seen = format!(
        "events wait and are released together: {} gaps of {:.2} ms in the median, one after the \
             other, with {events:.0} events at once behind each",
        best.len(),
        median(&mut lengths) * 1e-6
    );
    Some(Episode::on_whole_array(case, Failure::Stall, time_ns, events / LEAST_EVENTS, seen))
}
