//! Noise bursts: random events of both signs on the whole array, independent between pixels.

use super::{BLOCKS, Episode, Failure, LONGEST, block, stretch};
use crate::integrity::array::StampedEvent;
use photocurrent_scene::case::Case;
use std::ops::Range;

/// Bins of time, ns.
const BIN_NS: i64 = 500_000;
/// Number of quiet blocks, those with the lowest rates.
const QUIET: usize = 4;
/// Least ratio of their rate in a burst to that of the rest.
const TIMES: f64 = 1.6;
/// Log likelihood of the burst over an even rate, nats.
const NATS: f64 = 100.0;
/// Number of blocks in which the added rate may differ by more than this factor.
const OTHERS: usize = 2;
const EVEN: f64 = 1.6;
/// Share of ON among what is added.
const ON: std::ops::RangeInclusive<f64> = 0.3..=0.7;
/// Added events have neighbours of the same sign within this time, ns, at most this many times as often as by
/// chance, and that much less often than other events.
const NEAR_NS: i64 = 1_000_000;
const BY_CHANCE: f64 = 1.5;
/// Search range of the ends, bins.
const AROUND: usize = 30;
/// Least number of bins for the rate just outside.
const LEAST_OUTSIDE: usize = 5;
/// Shorter is a flash of the light, ns.
const SHORTEST_NS: i64 = 10_000_000;

/// The burst that is the least probable at the rate of the rest.
pub(super) fn noise(case: &Case, stream: &[StampedEvent]) -> Option<Episode> {
    let (start, end) = (stream.first()?.t_ns, stream.last()?.t_ns);
    let bins = ((end - start) / BIN_NS + 1) as usize;
    let bin = |t_ns: i64| ((t_ns - start) / BIN_NS) as usize;
    let mut counts = vec![vec![0.0_f64; bins]; BLOCKS * BLOCKS];
    stream.iter().for_each(|event| counts[block(case, event.pixel)][bin(event.t_ns)] += 1.0);
    let mut pixels = [0.0; BLOCKS * BLOCKS];
    (0..case.extent.pixels() as u32).for_each(|pixel| pixels[block(case, pixel)] += 1.0);
    let mut order: Vec<usize> = (0..BLOCKS * BLOCKS).filter(|&block| pixels[block] > 0.0).collect();
    let total = |block: usize| counts[block].iter().sum::<f64>() / pixels[block];
    order.sort_by(|a, b| total(*a).total_cmp(&total(*b)));
    order.truncate(QUIET);
    let quiet: Vec<f64> = (0..bins).map(|bin| order.iter().map(|&block| counts[block][bin]).sum()).collect();
    let (first, last, nats, rate) = densest_stretch(&quiet)?;
    // A scene that grows busier at its end moves that: it is where all blocks jump.
    let all: Vec<f64> = (0..bins).map(|bin| counts.iter().map(|of| of[bin]).sum()).collect();
    let (first, last) = (jump(&all, first, last), jump(&all, last + 1, first).saturating_sub(1));
    if last <= first {
        return None;
    }
    let (length, rest) = ((last - first + 1) as f64, (bins - (last - first + 1)) as f64);
    let ends = around_ends(first, last, bins);
    let whole = [[first..last + 1, 0..first], [first..last + 1, last + 1..bins]];
    let inside: f64 = quiet[first..=last].iter().sum();
    let is_burst = nats >= NATS
        && length * BIN_NS as f64 >= SHORTEST_NS as f64
        && length <= LONGEST * bins as f64
        && !ends.is_empty()
        && inside / length >= TIMES * f64::max(rate, 0.01);
    let blocks = pixels.iter().filter(|pixels| **pixels > 0.0).count();
    // The scene moves from block to block: what is added is even at the ends, or in the mean.
    let of_all = |ends: &[EndBins]| -> (f64, usize) {
        let of = |block: usize| added(&counts[block], ends) / pixels[block];
        let usual = order.iter().map(|&block| of(block)).sum::<f64>() / order.len() as f64;
        let is_even = |block: &usize| (1.0 / EVEN..=EVEN).contains(&(of(*block) / usual));
        (usual, (0..BLOCKS * BLOCKS).filter(|&block| pixels[block] > 0.0).filter(is_even).count())
    };
    let ((usual, in_mean), (_, at_ends)) = (of_all(&whole), of_all(&ends));
    let even = in_mean.max(at_ends);
    if !is_burst || even + OTHERS < blocks {
        return None;
    }
    let time_ns = [start + first as i64 * BIN_NS, (start + (last as i64 + 1) * BIN_NS).min(end)];
    let of_time = (time_ns, [length, rest].map(|bins| bins * BIN_NS as f64));
    let quiet_pixels = order.iter().map(|&block| pixels[block]).sum();
    let watched: Vec<StampedEvent> =
        stream.iter().filter(|event| order.contains(&block(case, event.pixel))).copied().collect();
    let on = without_light(case, &watched, of_time, quiet_pixels)?;
    let hz = usual * 1e9 / BIN_NS as f64;
    let seen = format!(
        "{hz:.1} events a pixel and second more than before and after, everywhere, of both signs ({:.0} \
             % ON), each pixel by itself",
        100.0 * on
    );
    Some(Episode::on_whole_array(case, Failure::Noise, time_ns, nats / NATS, seen))
}

/// The interval of bins with more events that is least probable at the rate of the rest: first and last bin,
/// nats, and that rate, events per bin.
fn densest_stretch(counts: &[f64]) -> Option<(usize, usize, f64, f64)> {
    let bins = counts.len();
    let mut found = (0, bins - 1, 0.0);
    let mut rate = counts.iter().sum::<f64>() / bins as f64 / TIMES;
    for _ in 0..4 {
        let (low, high) = (rate.max(0.01), TIMES * rate.max(0.01));
        let score = |count: &f64| count * libm::log(high / low) - (high - low);
        found = stretch(counts.iter().map(score))?;
        let inside = found.1 - found.0 + 1;
        if inside == bins {
            return None;
        }
        let of_rest: f64 = counts[..found.0].iter().chain(&counts[found.1 + 1..]).sum();
        rate = of_rest / (bins - inside) as f64;
    }
    Some((found.0, found.1, found.2, rate))
}

/// Bins just inside and just outside of an end.
type EndBins = [Range<usize>; 2];

/// The ends of a burst that lie within the recording.
fn around_ends(first: usize, last: usize, bins: usize) -> Vec<EndBins> {
    let begin = [first..(first + AROUND).min(last + 1), first.saturating_sub(AROUND)..first];
    let inside = (last + 1).saturating_sub(AROUND).max(first)..last + 1;
    let end = [inside, last + 1..(last + 1 + AROUND).min(bins)];
    [begin, end].into_iter().filter(|[_, outside]| outside.len() >= LEAST_OUTSIDE).collect()
}

/// Events a bin inside of the ends less those outside, of ranges that are not empty.
fn added(counts: &[f64], ends: &[EndBins]) -> f64 {
    let of = |range: &Range<usize>| (counts[range.clone()].iter().sum::<f64>(), range.len() as f64);
    let sums = ends.iter().fold([(0.0, 0.0); 2], |sums, end| {
        let one = |k: usize| (sums[k].0 + of(&end[k]).0, sums[k].1 + of(&end[k]).1);
        [one(0), one(1)]
    });
    let [inside, outside] = sums.map(|(sum, length)| sum / f64::max(length, 1.0));
    inside - outside
}

/// The instant around an end of a burst at which rates change most, as a bin, not beyond its `other` end.
fn jump(counts: &[f64], end: usize, other: usize) -> usize {
    let (mut from, mut to) = (end.saturating_sub(AROUND), (end + AROUND).min(counts.len()));
    if end <= other {
        to = to.min(other);
    } else {
        from = from.max(other + 1);
    }
    // It may have begun before the recording, or go on behind it.
    if end == 0 || end == counts.len() || to < from + 2 {
        return end;
    }
    let sum = |range: Range<usize>| counts[range.clone()].iter().sum::<f64>();
    let gain = |at: usize| {
        let of = |range: Range<usize>| {
            let (sum, length) = (sum(range.clone()), range.len() as f64);
            if sum > 0.0 { sum * libm::log(sum / length) } else { 0.0 }
        };
        of(from..at) + of(at..to)
    };
    (from + 1..to).max_by(|a, b| gain(*a).total_cmp(&gain(*b))).unwrap_or(end)
}

/// Share of ON among the events added between two instants, where both signs occur and neighbours are by
/// chance; lengths of that interval and of the rest, ns.
fn without_light(
    case: &Case,
    watched: &[StampedEvent],
    (time_ns, lengths): ([i64; 2], [f64; 2]),
    pixels: f64,
) -> Option<f64> {
    let near = has_near_neighbour(case, watched);
    let of = |is_in: bool, length: f64| {
        let is_of = |event: &StampedEvent| (time_ns[0]..time_ns[1]).contains(&event.t_ns) == is_in;
        let events = watched.iter().zip(&near).filter(|(event, _)| is_of(event));
        let sum = events.fold([0.0; 3], |[all, on, near], (event, is_near)| {
            let one = |is: bool| f64::from(u8::from(is));
            [all + 1.0, on + one(event.polarity > 0), near + one(*is_near)]
        });
        sum.map(|count| count / length)
    };
    let [inside, usual] = [of(true, lengths[0]), of(false, lengths[1])];
    let [all, on, near] = [0, 1, 2].map(|k| inside[k] - usual[k]);
    // A rate of one sign in the eight pixels around, and the chance of an event of it.
    let chance = |rate: f64| 1.0 - libm::exp(-4.0 * rate / pixels * NEAR_NS as f64);
    let by_chance = all * chance(inside[0]) + (usual[0] - usual[2]) * chance(all);
    let on = on / all;
    (ON.contains(&on) && near <= BY_CHANCE * by_chance).then_some(on)
}

/// Which events have one of the same sign in the eight pixels around within [`NEAR_NS`] before.
fn has_near_neighbour(case: &Case, events: &[StampedEvent]) -> Vec<bool> {
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let mut last = vec![[i64::MIN / 2; 2]; case.extent.pixels()];
    let one = |event: &StampedEvent| {
        let (x, y) = (event.pixel as usize % width, event.pixel as usize / width);
        let sign = usize::from(event.polarity > 0);
        let mut is_near = false;
        for row in y.saturating_sub(1)..(y + 2).min(height) {
            for other in row * width + x.saturating_sub(1)..row * width + (x + 2).min(width) {
                is_near |= other != event.pixel as usize && event.t_ns - last[other][sign] <= NEAR_NS;
            }
        }
        last[event.pixel as usize][sign] = event.t_ns;
        is_near
    };
    events.iter().map(one).collect()
}
