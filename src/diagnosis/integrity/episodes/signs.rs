//! Stuck polarity: for a while events of one sign are recorded with the other, at the same rate.

use super::{BLOCKS, Episode, Failure, LONGEST, block, stretch};
use crate::integrity::array::StampedEvent;
use photocurrent_scene::case::Case;

/// Share of the rarer sign that is left where polarity is stuck.
const LEFT: f64 = 0.3;
/// And at most so much, in each block.
const MOST_LEFT: f64 = 0.5;
/// Log likelihood of the stretch with that share over the rest's, nats.
const NATS: f64 = 200.0;
/// Blocks with this many expected events of that sign must nearly all agree, and at least this many.
const EXPECTED: f64 = 20.0;
const AGREE: f64 = 0.95;
const FEWEST_BLOCKS: usize = 6;
/// The rate of all events stays within this factor.
const RATE: f64 = 2.0;
/// Part of the stretch next to each end in which the share must have jumped.
const EDGE: f64 = 0.1;
/// Least share of the sign outside of the interval.
const STANDS: f64 = 0.7;
/// Least number of events of a quarter of the active pixels in the interval: light that rises as far is rare.
const CLIMBS: usize = 3;
/// Shorter is a change of the light, ns.
const SHORTEST_NS: i64 = 20_000_000;

/// The stretch in which one sign is missing, the likelier of both.
pub(super) fn signs(case: &Case, stream: &[StampedEvent]) -> Option<Episode> {
    let found = [1, -1].into_iter().filter_map(|sign| stuck(case, stream, sign));
    found.max_by(|a, b| a.statistic.total_cmp(&b.statistic))
}

/// Events of a stretch: all of them, and those of the missing sign.
#[derive(Clone, Copy, Default)]
struct SignCounts {
    all: f64,
    missing: f64,
}

impl SignCounts {
    fn count_events<'a>(events: impl Iterator<Item = &'a StampedEvent>, sign: i8) -> SignCounts {
        events.fold(SignCounts::default(), |sum, event| SignCounts {
            all: sum.all + 1.0,
            missing: sum.missing + f64::from(u8::from(event.polarity != sign)),
        })
    }

    fn missing_share(&self) -> f64 {
        self.missing / f64::max(self.all, 1.0)
    }
}

/// Events stuck at `sign`.
fn stuck(case: &Case, stream: &[StampedEvent], sign: i8) -> Option<Episode> {
    let (start, end) = (stream.first()?.t_ns, stream.last()?.t_ns);
    let mut usual = SignCounts::count_events(stream.iter(), sign).missing_share();
    let mut found = (0, 0, 0.0);
    // The share of the rest is known once the stretch is.
    for _ in 0..3 {
        let share = LEFT * usual;
        if usual <= 0.0 || usual >= 1.0 {
            return None;
        }
        let (missing, other) = (libm::log(LEFT), libm::log((1.0 - share) / (1.0 - usual)));
        found = stretch(stream.iter().map(|event| if event.polarity == sign { other } else { missing }))?;
        let rest = stream[..found.0].iter().chain(&stream[found.1 + 1..]);
        usual = SignCounts::count_events(rest, sign).missing_share();
    }
    let (first, last, nats) = found;
    let time_ns = [stream[first].t_ns, stream[last].t_ns];
    let length = time_ns[1] - time_ns[0];
    let rest_ns = end - start - length;
    if nats < NATS || length < SHORTEST_NS || length as f64 > LONGEST * (end - start) as f64 {
        return None;
    }
    let inside = &stream[first..=last];
    let rate = (inside.len() as f64 / length as f64)
        / ((stream.len() - inside.len()) as f64 / f64::max(rest_ns as f64, 1.0));
    let is_sharp = jumps(stream, (first, last), (length, usual), sign);
    if !(1.0 / RATE..=RATE).contains(&rate)
        || !is_sharp
        || !climbs(inside)
        || !agree(case, stream, found, sign)
    {
        return None;
    }
    let share = SignCounts::count_events(inside.iter(), sign).missing_share();
    let name = |sign: i8| if sign > 0 { "ON" } else { "OFF" };
    let seen = format!(
        "{} events carry the sign of {}: {:.1} % of the events are {0}, of the others {:.1} %, at the \
             same rate",
        name(-sign),
        name(sign),
        100.0 * share,
        100.0 * usual
    );
    Some(Episode::on_whole_array(case, Failure::Sign, time_ns, nats / NATS, seen))
}

/// Does the share jump at both ends, where the recording goes on behind them?
fn jumps(
    stream: &[StampedEvent],
    (first, last): (usize, usize),
    (length, usual): (i64, f64),
    sign: i8,
) -> bool {
    let edge_ns = (EDGE * length as f64) as i64;
    let of = |from: i64, to: i64| {
        let at = |t: i64| stream.partition_point(|event| event.t_ns < t);
        SignCounts::count_events(stream[at(from)..at(to)].iter(), sign)
    };
    let (begin, end) = (stream[first].t_ns, stream[last].t_ns);
    let stands =
        |counts: SignCounts| counts.all * usual < EXPECTED || counts.missing_share() >= STANDS * usual;
    let is_missing =
        |counts: SignCounts| counts.all * usual < EXPECTED || counts.missing_share() <= MOST_LEFT * usual;
    stands(of(begin - edge_ns, begin))
        && stands(of(end + 1, end + edge_ns))
        && is_missing(of(begin, begin + edge_ns))
        && is_missing(of(end - edge_ns, end + 1))
}

/// Would the light of a quarter of the pixels have had to rise, or to fall, by several thresholds?
fn climbs(inside: &[StampedEvent]) -> bool {
    let mut pixels: Vec<u32> = inside.iter().map(|event| event.pixel).collect();
    pixels.sort_unstable();
    let mut counts: Vec<usize> = pixels.chunk_by(|a, b| a == b).map(<[u32]>::len).collect();
    counts.sort_unstable();
    counts.get(3 * counts.len() / 4).is_some_and(|count| *count >= CLIMBS)
}

/// Is the sign missing in all blocks that can show it?
fn agree(case: &Case, stream: &[StampedEvent], (first, last, _): (usize, usize, f64), sign: i8) -> bool {
    let mut blocks = [[SignCounts::default(); 2]; BLOCKS * BLOCKS];
    for (k, event) in stream.iter().enumerate() {
        let counts = &mut blocks[block(case, event.pixel)][usize::from((first..=last).contains(&k))];
        counts.all += 1.0;
        counts.missing += f64::from(u8::from(event.polarity != sign));
    }
    let shown = |[rest, inside]: &&[SignCounts; 2]| inside.all * rest.missing_share() >= EXPECTED;
    let shown: Vec<&[SignCounts; 2]> = blocks.iter().filter(shown).collect();
    let agree = shown
        .iter()
        .filter(|[rest, inside]| inside.missing_share() <= MOST_LEFT * rest.missing_share())
        .count();
    shown.len() >= FEWEST_BLOCKS && agree as f64 >= AGREE * shown.len() as f64
}
