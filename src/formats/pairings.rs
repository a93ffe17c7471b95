//! Which of several ways to pair pictures with times agrees with the events.
//!
//! A picture changes from one exposure to the next by what events report between the two. For every way to
//! pair (which level of the strobe is an open shutter, which pulse belongs to the first picture, whether
//! holes and gaps count) the log changes of neighbouring pictures are held against the events between their
//! middles: the correlation over places, at the delay of events at which it is largest. The delay is bounded,
//! so that no pairing borrows the place of its neighbour.
//!
//! Limits: it needs motion. Events that are later than 3 ms or a quarter of the period count for the pairing
//! that is later by as much; so a period near the latency of a pixel decides little, and is no clear answer
//! ([`Comparison::clear`]). The row time must be known: rows that are exposed one after another look like
//! early events.

use crate::chunk::{Edge, EventChunk};
use crate::declared::{Declared, Pairing, Strobe};
use crate::error::FormatError;
use crate::format::Format;
use crate::pictures::pairing::{Candidate, Sides};
use crate::pictures::partners::{Times, remainder};
use crate::pictures::stamps::{self, Row};
use crate::pictures::triggers::pulses;
use crate::pictures::{Found, find, rows_of, stamps_file};
use crate::recording::Recording;
use crate::survey::pictures::chosen;
use photocurrent_core::Extent;
use std::collections::BTreeMap;
use std::path::Path;

/// Places across and down, at most.
const ACROSS: u32 = 32;
/// Pictures whose values are read, at most.
const PICTURES: usize = 64;
/// Neighbours in a run of them.
const RUN: usize = 8;
/// Steps of a period.
const STEPS: i64 = 16;
/// Delays of events that are tried, in steps, at most: a quarter of the period, since the two levels of a
/// strobe lie half a period apart.
const DELAYS: i64 = STEPS / 4;
/// Counters of events, at most: 32 MB.
const COUNTERS: usize = 1 << 23;
/// Ways that are compared, at most.
const WAYS: usize = 4096;
/// What costs so much more than the cheapest is not compared.
const DEAREST: u32 = 16;
/// A weaker correlation is none.
const LEAST: f64 = 0.15;
/// A second best with less than this part of the best correlation is clearly worse.
const CLEARLY: f64 = 0.9;
/// What counts propose is passed over where it has less than this part of the best correlation. On simulated
/// discs a wrong level has 0.75 to 0.82, a wrong pulse 0.2 to 0.4.
const PASSED_OVER: f64 = 0.85;
/// A latency of a pixel may be as long, ns: longer delays are not tried, and a period of less than twice this
/// decides nothing.
const LATENCY_NS: i64 = 3_000_000;
/// A step of the grey scale, as a part of the largest value: added before the logarithm, so that darkness is
/// finite.
const DARK: f32 = 1.0 / 255.0;

/// One way to pair.
#[derive(Clone, Debug, PartialEq)]
pub struct Way {
    /// Which level is an open shutter; none for stamps, and for a line with edges of one kind.
    pub strobe: Option<Strobe>,
    /// By what missing ones are recognised.
    pub by: Pairing,
    /// The slot of the first picture.
    pub first: i64,
    /// What speaks against it by counts, numbers and periods, in quarters of one that is missing at an end.
    pub cost: u32,
    /// Pulses or stamps with all that belongs to them.
    pub whole: usize,
    /// Middle length of an exposure, ns, where it is known.
    pub exposure_ns: Option<i64>,
    /// What is left over: "1 picture and 0 pulses without a partner".
    pub remainder: String,
    /// Does a reader take it where only `strobe` is stated?
    pub is_plain: bool,
    /// Picture and the middle of its exposure, ns, of the pictures that are compared.
    pairs: Vec<(usize, i64)>,
    /// Correlation of the pictures' changes with the events, and how late events are there, ns; none where it
    /// was not compared.
    pub agreement: Option<(f64, i64)>,
}

/// All ways, with their agreement.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// The one to take first: by agreement where that is clear, by counts otherwise.
    pub ways: Vec<Way>,
    /// Number of pictures.
    pub pictures: usize,
    /// Does the agreement with the events decide?
    pub clear: bool,
}

/// Compares every way to pair the declared frames with the times of a trigger line, or with stamps; none
/// where names pair them, or there is nothing to compare. `row_time_ns` is the delay from one row of a frame
/// to the next.
///
/// # Errors
/// When events, pictures or stamps cannot be read.
pub fn compare(
    format: &Format,
    path: &Path,
    declared: &Declared,
    row_time_ns: i64,
) -> Result<Option<Comparison>, FormatError> {
    let Some(frames) = &declared.frames else { return Ok(None) };
    let recording = (format.open)(path, declared)?;
    let found = find(frames)?;
    let mut ways = ways(recording.as_ref(), frames, &found, declared)?;
    if ways.is_empty() {
        return Ok(None);
    }
    ways.sort_by_key(|way| way.cost);
    let dearest = ways[0].cost + DEAREST;
    ways.retain(|way| way.cost <= dearest);
    ways.truncate(WAYS);
    let half = row_time_ns.saturating_mul(i64::from(found.about.extent.height) / 2);
    ways.iter_mut().flat_map(|way| &mut way.pairs).for_each(|pair| pair.1 = pair.1.saturating_add(half));
    let period = agree(recording.as_ref(), &found, &mut ways)?;
    let score = |way: &Way| way.agreement.map_or(f64::NEG_INFINITY, |agreement| agreement.0);
    let mut by_agreement: Vec<usize> = (0..ways.len()).collect();
    by_agreement.sort_by(|a, b| score(&ways[*b]).total_cmp(&score(&ways[*a])).then(a.cmp(b)));
    let best = by_agreement[0];
    // Two ways that give the same pairs are one.
    let second = by_agreement.iter().find(|n| ways[**n].pairs != ways[best].pairs);
    let ahead = second.is_none_or(|second| score(&ways[*second]) < CLEARLY * score(&ways[best]));
    let by_counts =
        ways.iter().filter(|way| way.cost == ways[0].cost).map(score).fold(f64::NEG_INFINITY, f64::max);
    let ahead = ahead && (ways[best].cost == ways[0].cost || by_counts < PASSED_OVER * score(&ways[best]));
    let clear = ways.len() > 1
        && score(&ways[best]) >= LEAST
        && ahead
        && period.is_some_and(|period| period >= 2 * LATENCY_NS);
    if clear {
        ways = by_agreement.into_iter().map(|n| ways[n].clone()).collect();
    } else {
        // By counts; of ways that cost the same, an exposure of less than half of the period, then the better
        // agreement.
        let is_long =
            |way: &Way| way.exposure_ns.zip(period).is_some_and(|(exposure, period)| 2 * exposure > period);
        ways.sort_by(|a, b| {
            (a.cost, is_long(a)).cmp(&(b.cost, is_long(b))).then(score(b).total_cmp(&score(a)))
        });
    }
    // Of the same pairs, the first says it.
    let mut kept: Vec<Way> = Vec::new();
    for way in ways {
        if !kept.iter().take(8).any(|other| other.pairs == way.pairs) {
            kept.push(way);
        }
    }
    Ok(Some(Comparison { ways: kept, pictures: found.names.len(), clear }))
}

/// The trigger line of the event file whose edges are as many as the pictures, about: its number, its rising
/// and falling edges, and how many pictures there are; none without edges or pictures.
pub fn likeliest_line(format: &Format, path: &Path, declared: &Declared) -> Option<(u16, [usize; 2], usize)> {
    let pictures = find(declared.frames.as_ref()?).ok()?.names.len();
    let mut lines: BTreeMap<u16, [usize; 2]> = BTreeMap::new();
    for trigger in (format.open)(path, declared).ok()?.triggers().ok()? {
        lines.entry(trigger.line).or_default()[usize::from(trigger.edge == Edge::Falling)] += 1;
    }
    let most = |edges: &[usize; 2]| edges[0].max(edges[1]);
    let (line, edges) = lines
        .into_iter()
        .min_by_key(|(_, edges)| (most(edges).abs_diff(pictures), std::cmp::Reverse(most(edges))))?;
    Some((line, edges, pictures))
}

fn ways(
    recording: &dyn Recording,
    frames: &Path,
    found: &Found,
    declared: &Declared,
) -> Result<Vec<Way>, FormatError> {
    let mut all = Vec::new();
    if let Some(line) = declared.trigger_line {
        let triggers = recording.triggers()?;
        for strobe in [Strobe::ActiveHigh, Strobe::ActiveLow] {
            if declared.strobe.is_some_and(|stated| stated != strobe) {
                continue;
            }
            let of_line = pulses(&triggers, line, strobe);
            let (has_both, rows) = (of_line.has_both, rows_of(&of_line));
            add(&mut all, found, &rows, declared, Times::Pulses(line), has_both.then_some(strobe));
            if !has_both {
                break;
            }
        }
    } else if let Some(file) = stamps_file(frames, declared) {
        let mut stamps = stamps::read(&file, declared, None)?;
        if stamps.rows.iter().all(|row| row.name.is_none()) {
            stamps.settle(found.names.len());
            add(&mut all, found, &stamps.rows, declared, Times::Stamps, None);
        }
    }
    Ok(all)
}

fn add(
    all: &mut Vec<Way>,
    found: &Found,
    rows: &[Row],
    declared: &Declared,
    times: Times,
    strobe: Option<Strobe>,
) {
    let picked = picked(found, 1);
    let sides = Sides::new(&found.names, rows);
    let candidates = sides.candidates(declared);
    let Some(dearest) = candidates.first().map(|best| best.cost + DEAREST) else { return };
    let whole = rows.iter().filter(|row| row.is_whole).count();
    let mut lengths: Vec<i64> =
        rows.iter().filter_map(|row| row.exposure).map(|(start, end)| end.saturating_sub(start)).collect();
    lengths.sort_unstable();
    let exposure_ns = lengths.get(lengths.len() / 2).copied();
    let plain = sides.decide(declared).ok().flatten().map(|candidate| sides.pairs(&candidate));
    let middle = |row: &Row| {
        row.exposure.map_or(row.at, |(start, end)| start.saturating_add(end.saturating_sub(start) / 2))
    };
    for candidate in candidates.iter().take_while(|candidate| candidate.cost <= dearest).take(WAYS) {
        let Candidate { by, first, cost } = *candidate;
        let places = sides.pairs(candidate);
        let remainder = remainder(found.names.len(), rows, &places, times);
        let usable = places.iter().filter(|(picture, row)| picked[*picture] && rows[*row].is_whole);
        let pairs = usable.map(|(picture, row)| (*picture, middle(&rows[*row]))).collect();
        // The pulse of a pair is seen in its number, not in its exposure: as many whole exposures as pictures
        // speak for a level.
        let is_plain = plain.as_ref() == Some(&places);
        let uneven = if strobe.is_some() { 2 * (whole.abs_diff(found.names.len()).min(4) as u32) } else { 0 };
        all.push(Way {
            strobe,
            by,
            first,
            cost: cost + uneven,
            whole,
            exposure_ns,
            remainder,
            is_plain,
            pairs,
            agreement: None,
        });
    }
}

/// Pictures that are compared: whole ones of a few runs of neighbours, and of these runs one of `every`.
fn picked(found: &Found, every: usize) -> Vec<bool> {
    let mut picked = vec![false; found.names.len()];
    let some = chosen(found.names.len(), PICTURES);
    some.chunks(RUN)
        .step_by(every)
        .flatten()
        .filter(|picture| found.whole[**picture])
        .for_each(|picture| picked[*picture] = true);
    picked
}

/// A stretch of time with counters of events.
struct Window {
    start: i64,
    steps: usize,
    /// First counter.
    at: usize,
}

/// Fills in the agreement of every way; gives the period, ns, where there is one.
fn agree(recording: &dyn Recording, found: &Found, ways: &mut [Way]) -> Result<Option<i64>, FormatError> {
    let mut periods: Vec<i64> = ways[0]
        .pairs
        .windows(2)
        .map(|pair| pair[1].1.saturating_sub(pair[0].1))
        .filter(|period| *period > 0)
        .collect();
    periods.sort_unstable();
    let Some(period) = periods.get(periods.len() / 2).copied() else { return Ok(None) };
    let step = (period / STEPS).max(1);
    let extent = recording.events_about().and_then(|about| about.extent).unwrap_or(found.about.extent);
    let mut settings = [(1, ACROSS), (1, ACROSS / 2), (4, ACROSS / 4)].into_iter();
    let (picked, across, down, windows) = loop {
        let Some((every, across)) = settings.next() else { return Ok(Some(period)) };
        let picked = picked(found, every);
        let (across, down) = (across.min(extent.width.max(1)), across.min(extent.height.max(1)));
        let windows = windows(ways, &picked, period, step);
        let steps: usize = windows.iter().fold(0, |sum, window| sum.saturating_add(window.steps + 1));
        if steps.saturating_mul((across * down) as usize) <= COUNTERS {
            break (picked, across, down, windows);
        }
    };
    let places = (across * down) as usize;
    let latest = (LATENCY_NS / step).min(DELAYS);
    let logs = logs(found, &picked, across, down);
    let sums = sums(recording, &windows, extent, (across, down), step)?;
    for way in ways.iter_mut() {
        let pairs: Vec<(usize, i64)> = way
            .pairs
            .iter()
            .copied()
            .filter(|(picture, _)| picked[*picture] && !logs[*picture].is_empty())
            .collect();
        let scores = (0..=latest).filter_map(|delay| {
            let late = delay * step;
            correlation(&pairs, &logs, &windows, &sums, (places, step), late)
                .map(|correlation| (correlation, late))
        });
        way.agreement = scores.max_by(|a, b| a.0.total_cmp(&b.0));
    }
    Ok(Some(period))
}

/// Neighbours are pictures that follow each other within four periods.
fn is_near(a: (usize, i64), b: (usize, i64), period: i64) -> bool {
    b.1 > a.1 && b.1.saturating_sub(a.1) <= period.saturating_mul(4)
}

/// The times that some way needs, joined, in order.
fn windows(ways: &[Way], picked: &[bool], period: i64, step: i64) -> Vec<Window> {
    let mut spans: Vec<(i64, i64)> = Vec::new();
    for way in ways {
        let pairs: Vec<(usize, i64)> =
            way.pairs.iter().copied().filter(|(picture, _)| picked[*picture]).collect();
        let near = pairs.windows(2).filter(|pair| is_near(pair[0], pair[1], period));
        spans.extend(
            near.map(|pair| (pair[0].1.saturating_sub(step), pair[1].1.saturating_add((DELAYS + 2) * step))),
        );
        // Ways overlap nearly everywhere: joined now and then, so that the list stays short.
        if spans.len() > 1 << 16 {
            spans = joined(spans);
        }
    }
    let mut at = 0;
    let window = |(start, end): (i64, i64)| {
        let steps = (end.saturating_sub(start) / step + 1).max(1) as usize;
        let window = Window { start, steps, at };
        at += steps + 1;
        window
    };
    joined(spans).into_iter().map(window).collect()
}

fn joined(mut spans: Vec<(i64, i64)>) -> Vec<(i64, i64)> {
    spans.sort_unstable();
    let mut all: Vec<(i64, i64)> = Vec::new();
    for (start, end) in spans {
        match all.last_mut() {
            Some(last) if start <= last.1 => last.1 = last.1.max(end),
            _ => all.push((start, end)),
        }
    }
    all
}

/// Mean logarithm of every place in the picked pictures; empty for others, and for those that cannot be read.
fn logs(found: &Found, picked: &[bool], across: u32, down: u32) -> Vec<Vec<f32>> {
    let (extent, channels) = (found.about.extent, found.about.colour.channels() as usize);
    let mut values = Vec::new();
    let mut dark = 0.0_f32;
    let mut all = vec![Vec::new(); picked.len()];
    for picture in (0..picked.len()).filter(|picture| picked[*picture]) {
        if found.read(picture, &mut values).is_err() || values.len() < extent.pixels() * channels {
            continue;
        }
        if dark == 0.0 {
            dark = (DARK * values.iter().copied().filter(|value| value.is_finite()).fold(0.0, f32::max))
                .max(1e-6);
        }
        let (mut sums, mut counts) =
            (vec![0.0_f32; (across * down) as usize], vec![0_u32; (across * down) as usize]);
        for (y, row) in (0..extent.height).zip(values.chunks_exact(extent.width as usize * channels)) {
            for (x, pixel) in (0..extent.width).zip(row.chunks_exact(channels)) {
                let value = pixel.iter().sum::<f32>() / channels as f32;
                if value.is_finite() {
                    let place = place(x, y, extent, (across, down));
                    sums[place] += libm::logf(value.max(0.0) + dark);
                    counts[place] += 1;
                }
            }
        }
        all[picture] = sums.iter().zip(counts).map(|(sum, count)| sum / count.max(1) as f32).collect();
    }
    all
}

fn place(x: u32, y: u32, extent: Extent, (across, down): (u32, u32)) -> usize {
    let scaled = |at: u32, of: u32, to: u32| u64::from(at) * u64::from(to) / u64::from(of.max(1));
    (scaled(y, extent.height, down) * u64::from(across) + scaled(x, extent.width, across)) as usize
}

/// ON less OFF events of every place, summed over time from the start of each window: [step][place].
fn sums(
    recording: &dyn Recording,
    windows: &[Window],
    extent: Extent,
    grid: (u32, u32),
    step: i64,
) -> Result<Vec<f32>, FormatError> {
    let places = (grid.0 * grid.1) as usize;
    let mut sums = vec![0.0_f32; windows.last().map_or(0, |window| window.at + window.steps + 1) * places];
    let mut cursor = recording.events()?;
    let mut chunk = EventChunk::default();
    let mut now = 0;
    while cursor.next(&mut chunk)? {
        for (((&t, &x), &y), &on) in chunk.t.iter().zip(&chunk.x).zip(&chunk.y).zip(&chunk.on) {
            let (x, y) = (u32::from(x), u32::from(y));
            if x >= extent.width || y >= extent.height {
                continue;
            }
            let steps_in = |window: &Window| {
                t.checked_sub(window.start)
                    .map(|since| since.div_euclid(step))
                    .filter(|n| (0..window.steps as i64).contains(n))
            };
            let mut within = windows.get(now).and_then(steps_in);
            if within.is_none() {
                now = windows.partition_point(|window| window.start <= t).saturating_sub(1);
                within = windows.get(now).and_then(steps_in);
            }
            if let Some(n) = within {
                sums[(windows[now].at + n as usize + 1) * places + place(x, y, extent, grid)] +=
                    if on == 1 { 1.0 } else { -1.0 };
            }
        }
    }
    for window in windows {
        for row in window.at + 1..=window.at + window.steps {
            let (before, after) = sums.split_at_mut(row * places);
            after[..places]
                .iter_mut()
                .zip(&before[(row - 1) * places..])
                .for_each(|(after, before)| *after += before);
        }
    }
    Ok(sums)
}

/// Of the log changes from picture to picture with the events between the middles, `late` later; none without
/// a change.
fn correlation(
    pairs: &[(usize, i64)],
    logs: &[Vec<f32>],
    windows: &[Window],
    sums: &[f32],
    (places, step): (usize, i64),
    late: i64,
) -> Option<f64> {
    let at = |window: &Window, t: i64| -> Option<(usize, f32)> {
        let since = t.checked_sub(window.start)?;
        let n = since.div_euclid(step);
        (0..window.steps as i64)
            .contains(&n)
            .then(|| ((window.at + n as usize) * places, since.rem_euclid(step) as f32 / step as f32))
    };
    let (mut both, mut of_events, mut of_pictures) = (0.0_f64, 0.0_f64, 0.0_f64);
    for pair in pairs.windows(2).filter(|pair| is_near(pair[0], pair[1], step.saturating_mul(STEPS + 1))) {
        let (from, to) = (pair[0].1.saturating_add(late), pair[1].1.saturating_add(late));
        let n = windows.partition_point(|window| window.start <= from);
        let Some(window) = n.checked_sub(1).map(|n| &windows[n]) else { continue };
        let (Some((a, a_part)), Some((b, b_part))) = (at(window, from), at(window, to)) else { continue };
        let sum = |row: usize, part: f32, place: usize| {
            sums[row + place] + part * (sums[row + places + place] - sums[row + place])
        };
        let events =
            levelled((0..places).map(|place| sum(b, b_part, place) - sum(a, a_part, place)).collect());
        let change = levelled(
            logs[pair[1].0].iter().zip(&logs[pair[0].0]).map(|(after, before)| after - before).collect(),
        );
        for (event, change) in events.iter().zip(&change) {
            let (event, change) = (f64::from(*event), f64::from(*change));
            both += event * change;
            of_events += event * event;
            of_pictures += change * change;
        }
    }
    (of_events > 0.0 && of_pictures > 0.0).then(|| both / (of_events * of_pictures).sqrt())
}

/// Less the mean, with the largest values brought in: one hot place must not decide.
fn levelled(mut values: Vec<f32>) -> Vec<f32> {
    let count = values.len().max(1) as f32;
    let mean = values.iter().sum::<f32>() / count;
    values.iter_mut().for_each(|value| *value -= mean);
    let limit = 8.0 * (values.iter().map(|value| value * value).sum::<f32>() / count).sqrt();
    values.iter_mut().for_each(|value| *value = value.clamp(-limit, limit));
    values
}
