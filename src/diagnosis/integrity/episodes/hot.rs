//! Temporarily hot pixels: they fire far more often than their neighbours, at nearly even intervals or with
//! one sign.

use super::{Episode, Failure, LONGEST};
use photocurrent_scene::case::{Case, PixelEvent};
use photocurrent_scene::statistics::median;

/// Least number of events in a burst.
const FEWEST: usize = 30;
/// Longest interval within a burst, in median intervals.
const LONGER: f64 = 3.0;
/// Least ratio to the rate of the pixels around; or to the rate of the other sign, where at most this share
/// of them fires.
const TIMES: f64 = 20.0;
const CLIMBS: f64 = 20.0;
const AROUND: f64 = 0.25;
/// Intervals are even where nine of ten lie within this factor of each other; or so much is of one sign.
const EVEN: f64 = 3.0;
const ONE_SIGN: f64 = 0.8;
/// Before and behind the row the pixel fires at most at this share of its rate: others are always hot.
const QUIET: f64 = 0.25;
/// Pixels that begin within this time of each other, and end so, are one episode, ns.
const TOGETHER_NS: i64 = 5_000_000;
/// Shorter is a moving edge, ns.
const SHORTEST_NS: i64 = 5_000_000;

/// Consecutive events of one pixel.
struct EventBurst {
    pixel: u32,
    from: i64,
    to: i64,
    /// Statistic over its threshold.
    statistic: f64,
    hz: f64,
}

/// Episodes of pixels.
pub(in super::super) fn hot_pixel_episodes(case: &Case) -> Vec<Episode> {
    let span = case.span.1 - case.span.0;
    let mut rows: Vec<EventBurst> =
        (0..case.extent.pixels()).filter_map(|pixel| row(case, pixel, span)).collect();
    rows.sort_by_key(|row| (row.from, row.pixel));
    let mut groups: Vec<Vec<EventBurst>> = Vec::new();
    for row in rows {
        let is_of = |group: &&mut Vec<EventBurst>| {
            let first = &group[0];
            (row.from - first.from).abs() <= TOGETHER_NS && (row.to - first.to).abs() <= TOGETHER_NS
        };
        match groups.iter_mut().find(is_of) {
            Some(group) => group.push(row),
            None => groups.push(vec![row]),
        }
    }
    groups.iter().map(|group| episode(case, group)).collect()
}

/// The longest row of events of a pixel that the light cannot make.
fn row(case: &Case, pixel: usize, span: i64) -> Option<EventBurst> {
    let events = case.events.of_pixel(pixel);
    if events.len() < FEWEST {
        return None;
    }
    let gaps: Vec<f64> = events.windows(2).map(|pair| (pair[1].t_off_ns - pair[0].t_off_ns) as f64).collect();
    let middle = median(&mut gaps.clone());
    let (mut from, mut best) = (0, (0, 0));
    for k in 0..=gaps.len() {
        if k == gaps.len() || gaps[k] > LONGER * middle {
            if k - from > best.1 - best.0 {
                best = (from, k);
            }
            from = k + 1;
        }
    }
    let (first, last) = best;
    let of_row = &events[first..=last];
    let (begin, end) = (of_row[0].t_off_ns, of_row[of_row.len() - 1].t_off_ns);
    let seconds = (end - begin) as f64 * 1e-9;
    let is_episode =
        of_row.len() >= FEWEST && end - begin >= SHORTEST_NS && (end - begin) as f64 <= LONGEST * span as f64;
    let outside = (events.len() - of_row.len()) as f64 / (span - (end - begin)).max(1) as f64;
    if !is_episode || outside > QUIET * of_row.len() as f64 / (end - begin) as f64 {
        return None;
    }
    let mut sorted = gaps[first..last].to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| sorted[(share * (sorted.len() - 1) as f64) as usize];
    let on = of_row.iter().filter(|event| event.polarity > 0).count() as f64 / of_row.len() as f64;
    let is_even = at(0.95) <= EVEN * at(0.05);
    if !(is_even || on >= ONE_SIGN || on <= 1.0 - ONE_SIGN) {
        return None;
    }
    let width = case.extent.width as usize;
    let (x, y) = (pixel % width, pixel / width);
    let rows = y.saturating_sub(1)..(y + 2).min(case.extent.height as usize);
    let (mut around, mut climbs): (Vec<f64>, Vec<f64>) = rows
        .flat_map(|row| (x.saturating_sub(1)..(x + 2).min(width)).map(move |column| row * width + column))
        .filter(|&other| other != pixel)
        .map(|other| {
            let events = case.events.of_pixel(other);
            let before = |t: i64| events.partition_point(|event| event.t_off_ns < t);
            let during = &events[before(begin)..before(end + 1)];
            (during.len() as f64, polarity_imbalance(during))
        })
        .unzip();
    let times = of_row.len() as f64 / (median(&mut around) + 1.0);
    let climb = polarity_imbalance(of_row) / CLIMBS;
    let hz = (of_row.len() - 1) as f64 / seconds;
    let is_hot = times >= TIMES || climb >= 1.0 && median(&mut climbs) <= AROUND * CLIMBS * climb;
    let statistic = f64::max(times / TIMES, climb);
    is_hot.then_some(EventBurst { pixel: pixel as u32, from: begin, to: end, statistic, hz })
}

/// Absolute difference of the numbers of ON and OFF events.
fn polarity_imbalance(events: &[PixelEvent]) -> f64 {
    events.iter().map(|event| f64::from(event.polarity)).sum::<f64>().abs()
}

fn episode(case: &Case, group: &[EventBurst]) -> Episode {
    let mut pixels: Vec<u32> = group.iter().map(|row| row.pixel).collect();
    pixels.sort_unstable();
    let ends = |value: fn(&(u32, u32)) -> u32| {
        let all = pixels.iter().map(|&pixel| value(&case.pixel_place(pixel as usize)));
        [all.clone().min().unwrap_or(0), all.max().unwrap_or(0)]
    };
    let (rows, columns) = (ends(|place| place.1), ends(|place| place.0));
    let mut hz: Vec<f64> = group.iter().map(|row| row.hz).collect();
    let mut statistics: Vec<f64> = group.iter().map(|row| row.statistic).collect();
    // A row may go on with events of the pixel's own light.
    let middle = |value: fn(&EventBurst) -> i64| {
        let mut all: Vec<i64> = group.iter().map(value).collect();
        all.sort_unstable();
        all[all.len() / 2]
    };
    Episode {
        failure: Failure::Hot,
        time_ns: [middle(|row| row.from), middle(|row| row.to)],
        rows,
        columns,
        statistic: median(&mut statistics),
        seen: format!(
            "{} pixels fire {:.0} times a second in the median, from one instant to another, whatever those \
             around them do",
            pixels.len(),
            median(&mut hz)
        ),
        pixels,
    }
}
