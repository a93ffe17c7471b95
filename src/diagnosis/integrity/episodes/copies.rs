//! Packets that are transmitted twice: events of one pixel, stamp and sign are repeated for a while.

use super::{Episode, Failure, LONGEST, stretch};
use crate::integrity::array::StampedEvent;
use photocurrent_scene::case::Case;

/// Share of the events that are copies within the failure, and at other times.
const WITHIN: f64 = 0.2;
const OTHERWISE: f64 = 0.002;
/// Log likelihood of the failure over none, nats.
const NATS: f64 = 100.0;

/// The stretch of events with copies that is the least probable without a failure.
pub(super) fn copies(case: &Case, stream: &[StampedEvent]) -> Option<Episode> {
    let (start, end) = (stream.first()?.t_ns, stream.last()?.t_ns);
    // Events of one stamp are in the order of their pixels.
    let is_copy = |k: usize| k > 0 && stream[k] == stream[k - 1];
    let (copy, other) = (libm::log(WITHIN / OTHERWISE), libm::log((1.0 - WITHIN) / (1.0 - OTHERWISE)));
    let scores = (0..stream.len()).map(|k| if is_copy(k) { copy } else { other });
    let (first, last, nats) = stretch(scores)?;
    let time_ns = [stream[first].t_ns, stream[last].t_ns];
    let found: Vec<u32> = (first..=last).filter(|&k| is_copy(k)).map(|k| stream[k].pixel).collect();
    let share = found.len() as f64 / (last + 1 - first) as f64;
    if nats < NATS || (time_ns[1] - time_ns[0]) as f64 > LONGEST * (end - start) as f64 {
        return None;
    }
    let ends = |of: &dyn Fn(u32) -> u32| {
        let all = found.iter().map(|&pixel| of(pixel));
        [all.clone().min().unwrap_or(0), all.max().unwrap_or(0)]
    };
    let seen = format!(
        "{} of {} events have the pixel, stamp and sign of the one before ({:.0} %)",
        found.len(),
        last + 1 - first,
        100.0 * share
    );
    let width = case.extent.width;
    let (rows, columns) = (ends(&|pixel| pixel / width), ends(&|pixel| pixel % width));
    let whole = Episode::on_whole_array(case, Failure::Copies, time_ns, nats / NATS, seen);
    Some(Episode { rows, columns, ..whole })
}
