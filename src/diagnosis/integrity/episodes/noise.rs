//! Bursts of events without light: everywhere at once, of both signs, each pixel by itself.

use super::{BLOCKS, Episode, Failure, LONGEST, block, stretch};
use crate::integrity::array::Stamped;
use photocurrent_scene::case::Case;

/// Bins of time, ns.
const BIN_NS: i64 = 500_000;
/// The quiet blocks: so many with the lowest rates.
const QUIET: usize = 4;
/// In a burst they fire so many times as often.
const TIMES: f64 = 1.6;
/// Log likelihood of the burst over an even rate, nats.
const NATS: f64 = 100.0;
/// What is added is the same in all blocks but so many, within this factor.
const OTHERS: usize = 2;
const EVEN: f64 = 1.6;
/// Share of ON among what is added.
const ON: std::ops::RangeInclusive<f64> = 0.3..=0.7;
/// Of the events that are added at most so many times as many have one of the same sign next to them within
/// this time, ns, as chance makes, and so much less than of the others.
const NEAR_NS: i64 = 1_000_000;
const BY_CHANCE: f64 = 1.5;
/// Shorter is a flash of the light, ns.
const SHORTEST_NS: i64 = 10_000_000;

/// The burst that is the least probable at the rate of the rest.
pub(super) fn noise(case: &Case, stream: &[Stamped]) -> Option<Episode> {
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
    let mut found = (0, bins - 1, 0.0);
    let mut rate = quiet.iter().sum::<f64>() / bins as f64 / TIMES;
    for _ in 0..4 {
        let (low, high) = (rate.max(0.01), TIMES * rate.max(0.01));
        let score = |count: &f64| count * libm::log(high / low) - (high - low);
        found = stretch(quiet.iter().map(score))?;
        let inside = found.1 - found.0 + 1;
        let of_rest: f64 = quiet[..found.0].iter().chain(&quiet[found.1 + 1..]).sum();
        if inside == bins {
            return None;
        }
        rate = of_rest / (bins - inside) as f64;
    }
    let (first, last, nats) = found;
    let (length, rest) = ((last - first + 1) as f64, (bins - (last - first + 1)) as f64);
    let of = |block: usize| {
        let inside: f64 = counts[block][first..=last].iter().sum();
        (inside / length - (counts[block].iter().sum::<f64>() - inside) / rest) / pixels[block]
    };
    let inside: f64 = quiet[first..=last].iter().sum();
    let is_burst = nats >= NATS
        && length * BIN_NS as f64 >= SHORTEST_NS as f64
        && length <= LONGEST * bins as f64
        && inside / length >= TIMES * f64::max(rate, 0.01);
    let added = order.iter().map(|&block| of(block)).sum::<f64>() / order.len() as f64;
    let is_even = |block: &usize| (1.0 / EVEN..=EVEN).contains(&(of(*block) / added));
    let even = (0..BLOCKS * BLOCKS).filter(|&block| pixels[block] > 0.0).filter(is_even).count();
    let blocks = pixels.iter().filter(|pixels| **pixels > 0.0).count();
    if !is_burst || even + OTHERS < blocks {
        return None;
    }
    let time_ns = [start + first as i64 * BIN_NS, (start + (last as i64 + 1) * BIN_NS).min(end)];
    let of_time = (time_ns, [length, rest].map(|bins| bins * BIN_NS as f64));
    let quiet_pixels = order.iter().map(|&block| pixels[block]).sum();
    let watched: Vec<Stamped> =
        stream.iter().filter(|event| order.contains(&block(case, event.pixel))).copied().collect();
    let on = without_light(case, &watched, of_time, quiet_pixels)?;
    let hz = added * 1e9 / BIN_NS as f64;
    let seen = format!(
        "{hz:.1} events a pixel and second more than before and after, everywhere, of both signs ({:.0} \
             % ON), each pixel by itself",
        100.0 * on
    );
    Some(Episode::everywhere(case, Failure::Noise, time_ns, nats / NATS, seen))
}

/// The share of ON among what is added between two instants, where it is of both signs and has no neighbours
/// but by chance; lengths: of that time, and of the rest, ns.
fn without_light(
    case: &Case,
    watched: &[Stamped],
    (time_ns, lengths): ([i64; 2], [f64; 2]),
    pixels: f64,
) -> Option<f64> {
    let near = near(case, watched);
    let of = |is_in: bool, length: f64| {
        let is_of = |event: &Stamped| (time_ns[0]..time_ns[1]).contains(&event.t_ns) == is_in;
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
fn near(case: &Case, events: &[Stamped]) -> Vec<bool> {
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let mut last = vec![[i64::MIN / 2; 2]; case.extent.pixels()];
    let one = |event: &Stamped| {
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
