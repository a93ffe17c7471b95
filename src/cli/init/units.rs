//! The units of stamps that no file states, from both streams together.
//!
//! Each unit makes one rate of events a pixel, one rate of frames, and one overlap of the two. All pairs of
//! units are scored by how usual these are; a unit that is recorded or stated is fixed, unless what is
//! recorded is impossible: files lie about their units too. The best pair is proposed with its evidence, and
//! the second best is named.
//!
//! Limits: rates are those of cameras with frames (some 1 to 1,000 events a pixel and second, 10 to 1,000
//! frames a second, none below 0.2); a time lapse is proposed wrongly.

use super::fill::Fill;
use crate::parts::Parts;
use photocurrent_formats::gather::{Scan, scan};
use photocurrent_formats::hazard::time;
use photocurrent_formats::pictures::PictureFiles;
use photocurrent_formats::{Declared, FormatError, Pairing, TimeUnit, joined};
use photocurrent_nodes::read::foreign::All;
use photocurrent_nodes::read::formats::takes;

const UNITS: [TimeUnit; 4] = [TimeUnit::S, TimeUnit::Ms, TimeUnit::Us, TimeUnit::Ns];

/// Share of the events that the span is taken of: a few strays do not widen it.
pub const DENSE: f64 = 0.98;

/// Natural logarithm of a normal density of the decades of a quantity, without its constant.
fn usual(value: f64, middle: f64, decades: f64) -> f64 {
    let off = (libm::log10(value.max(1e-300)) - middle) / decades;
    -0.5 * off * off
}

/// What is impossible weighs so much.
const IMPOSSIBLE: f64 = -20.0;

/// A stream as one unit makes it.
#[derive(Clone, Copy, Debug)]
struct Stream {
    unit: TimeUnit,
    /// From first to last, strays left out, ns.
    span: (f64, f64),
    /// How usual rate and form of the stamps are.
    score: f64,
    /// Events a pixel and second; frames a second.
    rate_hz: f64,
}

/// How usual a unit is for stamps that are, or are not, whole numbers of it.
fn convention(unit: TimeUnit, is_whole: bool) -> f64 {
    match (is_whole, unit) {
        (true, TimeUnit::Us) | (false, TimeUnit::S) => 0.0,
        (true, TimeUnit::Ns) => -0.7,
        (true, TimeUnit::Ms) | (false, TimeUnit::Ms | TimeUnit::Us) => -1.5,
        (true, TimeUnit::S) | (false, TimeUnit::Ns) => -3.0,
    }
}

fn is_whole(stamps: &[i64], unit: TimeUnit) -> bool {
    // In microseconds whole nanoseconds and decimal seconds show; coarser units are tried with their own
    // step.
    stamps.iter().all(|t| t % unit.ns() == 0)
}

/// Events as a unit makes them.
fn of_events(found: &Scan, unit: TimeUnit, whole: bool) -> Option<Stream> {
    let (first, last) = found.dense_span(DENSE)?;
    let (x, y) = found.corner?;
    let pixels = (f64::from(x) + 1.0) * (f64::from(y) + 1.0);
    let seconds = last.saturating_sub(first) as f64 * 1e-9;
    if seconds <= 0.0 {
        return None;
    }
    let rate_hz = DENSE * found.count as f64 / seconds / pixels;
    let plausible = if (1e-5..5e3).contains(&rate_hz) { 0.0 } else { IMPOSSIBLE };
    Some(Stream {
        unit,
        span: (first as f64, last as f64),
        score: usual(rate_hz, 0.7, 1.0) + plausible + convention(unit, whole),
        rate_hz,
    })
}

/// Frames as a unit makes them.
fn of_frames(stamps: &[(i64, i64)], unit: TimeUnit, whole: bool) -> Option<Stream> {
    let mut periods: Vec<i64> = stamps
        .windows(2)
        .map(|pair| pair[1].0.saturating_sub(pair[0].0))
        .filter(|period| *period > 0)
        .collect();
    periods.sort_unstable();
    let period = *periods.get(periods.len() / 2)?;
    let rate_hz = 1e9 / period as f64;
    let plausible = if (0.2..3e4).contains(&rate_hz) { 0.0 } else { IMPOSSIBLE };
    let (first, last) =
        (stamps.iter().map(|stamp| stamp.0).min()?, stamps.iter().map(|stamp| stamp.1).max()?);
    Some(Stream {
        unit,
        span: (first as f64, last as f64),
        score: usual(rate_hz, 1.7, 0.6) + plausible + convention(unit, whole),
        rate_hz,
    })
}

/// How well two streams fit each other.
fn together(events: &Stream, frames: &Stream) -> f64 {
    let length = |span: (f64, f64)| (span.1 - span.0).max(1.0);
    let shared = (events.span.1.min(frames.span.1) - events.span.0.max(frames.span.0)).max(0.0);
    let share = shared / length(events.span).min(length(frames.span));
    let same = if events.unit == frames.unit { 0.5 } else { 0.0 };
    usual(length(frames.span) / length(events.span), 0.0, 0.5) - 2.0 * (1.0 - share) + same
}

fn name(unit: TimeUnit) -> String {
    format!("{unit:?}").to_lowercase()
}

/// What a pair of units makes of the recording, for people.
fn evidence(events: Option<&Stream>, frames: Option<&Stream>) -> String {
    let mut said = Vec::new();
    if let Some(events) = events {
        said.push(format!(
            "events in {} last {}, {:.3} a pixel and second",
            name(events.unit),
            time(events.span.1 - events.span.0),
            events.rate_hz
        ));
    }
    if let Some(frames) = frames {
        said.push(format!(
            "frames in {} last {}, one every {}",
            name(frames.unit),
            time(frames.span.1 - frames.span.0),
            time(1e9 / frames.rate_hz)
        ));
    }
    said.join("; ")
}

/// What one unit gives, or without one what is recorded or stated; `None` where it cannot be read so.
fn events_in(parts: &Parts, all: &All, unit: Option<TimeUnit>) -> Option<Scan> {
    let mut declared = All { time_unit: unit.or(all.time_unit), ..all.clone() }.settings().declared;
    (declared.frames, declared.stamps, declared.trigger_line) = (None, None, None);
    let recording = joined::open(parts.format, &parts.recording, &declared).ok()?;
    scan(&mut *recording.events().ok()?, |_| Ok::<(), FormatError>(())).ok()
}

/// Which picture belongs to which stamp is another question: in order they have the same period.
fn in_order(declared: &mut Declared) {
    declared.first_pulse = declared.first_pulse.or(Some(0));
    declared.pairing = declared.pairing.or(Some(Pairing::Order));
}

/// Start and end of every frame, as far as its stamps state them; `unit` as in [`events_in`].
fn frames_in(parts: &Parts, all: &All, unit: Option<TimeUnit>) -> Option<Vec<(i64, i64)>> {
    let both = |at: i64, exposure: Option<(i64, i64)>| exposure.unwrap_or((at, at));
    if let Some(place) = parts.frames.as_ref().filter(|_| all.trigger_line.is_none()) {
        let mut declared = All { stamps_unit: unit.or(all.stamps_unit), ..all.clone() }.settings().declared;
        in_order(&mut declared);
        let pictures = PictureFiles::open(place, &declared).ok()?;
        return Some(
            photocurrent_formats::Pictures::about(&pictures)
                .stamps
                .iter()
                .map(|stamp| both(stamp.at, stamp.exposure))
                .collect(),
        );
    }
    let declared =
        All { time_unit: all.time_unit.or(unit), stamps_unit: unit.or(all.stamps_unit), ..all.clone() }
            .settings()
            .declared;
    let recording = joined::open(parts.format, &parts.recording, &declared).ok()?;
    Some(recording.pictures()?.about().stamps.iter().map(|stamp| both(stamp.at, stamp.exposure)).collect())
}

/// What the recorded units make of a recording that no camera gives: rates that are impossible, or streams of
/// which one lasts a hundred times as long as the other. `None` of a recording that can be.
fn impossible(parts: &Parts, all: &All) -> Option<String> {
    let recording = joined::open(parts.format, &parts.recording, &all.settings().declared).ok()?;
    let found = scan(&mut *recording.events().ok()?, |_| Ok::<(), FormatError>(())).ok()?;
    let events = of_events(&found, TimeUnit::Ns, true)?;
    let frames = recording.pictures().and_then(|pictures| {
        let stamps: Vec<(i64, i64)> = pictures
            .about()
            .stamps
            .iter()
            .map(|stamp| stamp.exposure.unwrap_or((stamp.at, stamp.at)))
            .collect();
        of_frames(&stamps, TimeUnit::Ns, true)
    });
    let length = |stream: &Stream| (stream.span.1 - stream.span.0).max(1.0);
    let is_apart =
        frames.as_ref().is_some_and(|frames| !(0.01..100.0).contains(&(length(frames) / length(&events))));
    let is_impossible = |stream: &Stream| stream.score < IMPOSSIBLE;
    let rates = |frames: &Stream| {
        format!("frames one every {} for {}", time(1e9 / frames.rate_hz), time(length(frames)))
    };
    (is_apart || is_impossible(&events) || frames.as_ref().is_some_and(is_impossible)).then(|| {
        let of_events =
            format!("{:.3e} events a pixel and second for {}", events.rate_hz, time(length(&events)));
        frames.as_ref().map_or(of_events.clone(), |frames| format!("{of_events} and {}", rates(frames)))
    })
}

/// Units of events and frames together, best first; with `is_one_unit` both streams share theirs.
fn paired(
    of_events_units: &[Stream],
    of_frames_units: &[Stream],
    is_one_unit: bool,
) -> Vec<(f64, Option<Stream>, Option<Stream>)> {
    let mut pairs: Vec<(f64, Option<Stream>, Option<Stream>)> = Vec::new();
    for events in of_events_units {
        if of_frames_units.is_empty() {
            pairs.push((events.score, Some(*events), None));
        }
        for frames in of_frames_units.iter().filter(|frames| !is_one_unit || frames.unit == events.unit) {
            pairs.push((
                events.score + frames.score + together(events, frames),
                Some(*events),
                Some(*frames),
            ));
        }
    }
    if of_events_units.is_empty() {
        pairs.extend(of_frames_units.iter().map(|frames| (frames.score, None, Some(*frames))));
    }
    pairs.sort_by(|a, b| b.0.total_cmp(&a.0));
    pairs
}

/// Proposes the units that are neither recorded nor stated, and puts them into `all`.
pub fn propose(parts: &Parts, all: &mut All) -> Vec<Fill> {
    let lacks = |all: &All, frames: bool| {
        let mut declared = all.settings().declared;
        let error = if frames {
            // Events' unit is no statement about frames.
            declared.time_unit = None;
            in_order(&mut declared);
            parts
                .frames
                .as_ref()
                .filter(|_| declared.trigger_line.is_none())
                .and_then(|place| PictureFiles::open(place, &declared).err())
        } else {
            (declared.frames, declared.stamps) = (None, None);
            (parts.format.open)(&parts.recording, &declared).err()
        };
        error.is_some_and(|error| error.undeclared == Some(if frames { "stamps_unit" } else { "time_unit" }))
    };
    let (mut events_lack, mut frames_lack) = (lacks(all, false), lacks(all, true));
    let mut recorded = String::new();
    if !events_lack && !frames_lack {
        // What is recorded is kept, unless no camera is like that and another unit makes one of it.
        let Some(why) = impossible(parts, all) else { return Vec::new() };
        recorded = why;
        events_lack = all.time_unit.is_none() && takes(parts.format.id, "time_unit");
        frames_lack =
            all.stamps_unit.is_none() && all.trigger_line.is_none() && takes(parts.format.id, "stamps_unit");
        if !events_lack && !frames_lack {
            return Vec::new();
        }
    }
    // One unit serves a set of files, unless what they state is impossible.
    let of_one_set = parts.frames.is_none() && recorded.is_empty();
    // Where a unit is recorded or stated there is one candidate, whose name stays open.
    let candidates = |lacks: bool, stated: Option<TimeUnit>| -> Vec<Option<TimeUnit>> {
        if lacks { UNITS.map(Some).to_vec() } else { vec![stated] }
    };
    let mut of_events_units: Vec<Stream> = Vec::new();
    for unit in candidates(events_lack, all.time_unit) {
        if let Some(found) = events_in(parts, all, unit) {
            // In their own unit whole numbers are whole; fractions of it show as a remainder.
            let shown = unit.unwrap_or(TimeUnit::Us);
            of_events_units.extend(of_events(&found, shown, is_whole(&found.some_stamps, shown)));
        }
    }
    let mut of_frames_units: Vec<Stream> = Vec::new();
    for unit in candidates(frames_lack || of_one_set && events_lack, all.stamps_unit) {
        if let Some(stamps) = frames_in(parts, all, unit) {
            let (starts, shown): (Vec<i64>, TimeUnit) =
                (stamps.iter().map(|stamp| stamp.0).collect(), unit.unwrap_or(TimeUnit::Us));
            of_frames_units.extend(of_frames(&stamps, shown, is_whole(&starts, shown)));
        }
    }
    let pairs = paired(&of_events_units, &of_frames_units, of_one_set && events_lack);
    let Some((score, events, frames)) = pairs.first().copied() else { return Vec::new() };
    let known = if recorded.is_empty() {
        "the unit is not recorded".to_owned()
    } else {
        format!("the unit that the files state makes {recorded}")
    };
    let mut why = format!("{known}; {}", evidence(events.as_ref(), frames.as_ref()));
    if let Some((second, events, frames)) = pairs.get(1).filter(|second| score - second.0 < 8.0) {
        why += &format!(
            ". Second best ({:.1} less in the logarithm of the likelihood): {}",
            score - second,
            evidence(events.as_ref(), frames.as_ref())
        );
    }
    let mut fills = Vec::new();
    if let Some(events) = events.filter(|_| events_lack) {
        all.time_unit = Some(events.unit);
        fills.push(Fill::open("time_unit", format!("\"{}\"", name(events.unit)), why.clone()));
    }
    if let Some(frames) = frames.filter(|_| frames_lack) {
        all.stamps_unit = Some(frames.unit);
        fills.push(Fill::open("stamps_unit", format!("\"{}\"", name(frames.unit)), why));
    }
    fills
}

#[cfg(test)]
mod tests {
    use super::*;

    fn events(span_s: f64, count: u64, unit: TimeUnit) -> Stream {
        let found = Scan {
            count,
            corner: Some((95, 71)),
            some_stamps: vec![0, (span_s * 1e9) as i64],
            ..Scan::default()
        };
        of_events(&found, unit, true).unwrap()
    }

    #[test]
    fn usual_rates_win_and_frames_decide_where_events_alone_do_not() {
        // 18,436 events over 300,000 units of 96 x 72 pixels: microseconds.
        let as_us = events(0.3, 18_436, TimeUnit::Us);
        let as_ns = events(0.3e-3, 18_436, TimeUnit::Ns);
        assert!(as_us.score > as_ns.score + 10.0);
        let film = |period_ns: i64, unit| {
            of_frames(&(0..15).map(|l| (l * period_ns, l * period_ns)).collect::<Vec<_>>(), unit, true)
                .unwrap()
        };
        let (right, wrong) = (film(20_000_000, TimeUnit::Us), film(20_000, TimeUnit::Ns));
        assert!(right.score + together(&as_us, &right) > wrong.score + together(&as_us, &wrong) + 5.0);
    }
}
