//! Which reading of both streams agrees best: as they are, mirrored, moved by whole pixels, with an offset of
//! the clocks.
//!
//! A shift in time explains much: a picture moved along its motion, a mirrored one, a strobe read upside
//! down. So where `inspect` finds the two streams apart, the readings are held against each other on pairs of
//! frames that nothing was fitted to ([`compare`]). A mirror or a shift is proposed where it explains clearly
//! more than an offset does.
//!
//! Where events use a small part of an array that has the frames' size, arrays of which the frames are a
//! multiple are compared too ([`smaller_array`]).
//!
//! Limits: shifts are searched for by steps of one pixel from none and from what patches suggest; of a scene
//! that moves one way a shift along the motion and an offset explain the same, and the offset is taken.

use photocurrent_core::Extent;
use photocurrent_formats::hazard::{self, Finding, Limits};
use photocurrent_formats::survey::Survey;
use photocurrent_formats::survey::alternatives::{
    Alternative, LEAST_AHEAD, LEAST_EXPLAINED, Much, Scored, compare, decided,
};
use photocurrent_formats::{FormatError, Mirror, Recording, Shift};
use std::collections::BTreeMap;

/// Events that are counted for a reading, at most: enough for every pair of frames that is compared.
pub const EVENTS: u64 = 5_000_000;
/// Steps of the search for a shift, at most.
const STEPS: usize = 12;

/// What agrees best.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reading {
    /// How the frames are mirrored.
    pub mirror: Option<Mirror>,
    /// How far the events lie right of and below the frames' picture.
    pub shift: Option<Shift>,
    /// Are ON and OFF exchanged?
    pub is_inverted: bool,
    /// The size of the event array, where it is another than the recording's.
    pub extent: Option<Extent>,
    /// What each reading explains, for people.
    pub why: String,
}

/// Pairs of frames that decide whether streams agree, at least.
const FEWEST: usize = 4;

/// Findings that an offset of the clocks would explain away.
const APART: [&str; 3] = ["mirrored", "displaced", "events_late"];

/// Compares the readings of a recording where its findings give reason to. `None` where they do not, or
/// nothing moves.
///
/// # Errors
/// When the recording cannot be read any more.
pub fn best(
    recording: &dyn Recording,
    survey: &Survey,
    findings: &[Finding],
) -> Result<Option<Reading>, FormatError> {
    if findings.iter().any(|finding| finding.id == "small_part_used")
        && let Some(reading) = smaller_array(recording, survey)?
    {
        return Ok(Some(reading));
    }
    // Streams that agree at no shift at all may be exchanged in sign.
    let is_unclear = survey.lag.as_ref().is_some_and(|lag| lag.pairs >= FEWEST && lag.late_ns.is_none());
    if !is_unclear && !findings.iter().any(|finding| APART.contains(&finding.id)) {
        return Ok(None);
    }
    let suggested = survey
        .lag
        .as_ref()
        .and_then(|lag| lag.grid.as_ref())
        .and_then(|grid| hazard::shift_of(grid, &Limits::default()));
    let span_ns = survey.events.as_ref().and_then(|events| events.span_ns);
    let trials = Trials { recording, much: Much { span_ns, events: EVENTS, extent: None } };
    match trials.way()? {
        Some(Reading { is_inverted: false, mirror, .. }) => {
            let start = suggested.filter(|_| mirror.is_none()).map(|shift| (-shift.right, -shift.down));
            trials.against_offset(mirror, trials.shift(mirror, start)?).map(Some)
        }
        decided => Ok(decided),
    }
}

/// The frames as they are, or mirrored.
fn mirrored(way: Option<Mirror>) -> Alternative {
    let name = way.map_or("as they are".to_owned(), |way| format!("mirrored {}", way.name()));
    Alternative::new(name).mirrored(
        matches!(way, Some(Mirror::LeftRight | Mirror::Both)),
        matches!(way, Some(Mirror::TopBottom | Mirror::Both)),
    )
}

/// The same with the events moved by whole pixels, right and down.
fn moved(way: Option<Mirror>, (right, down): (i32, i32)) -> Alternative {
    let reading = mirrored(way).shifted(right, down);
    if (right, down) == (0, 0) {
        return reading;
    }
    Alternative { name: format!("{}, events moved {right} right and {down} down", reading.name), ..reading }
}

fn with_offset(reading: Alternative) -> Alternative {
    Alternative { name: format!("{}, with an offset", reading.name), ..reading }.fitting_offset()
}

/// Is a reading clearly behind the best one?
fn is_behind(one: &Scored) -> bool {
    one.behind.ci95.0 > 0.0 && one.behind.value > LEAST_AHEAD
}

/// Readings of one recording, each compared on as many events.
struct Trials<'a> {
    recording: &'a dyn Recording,
    much: Much,
}

impl Trials<'_> {
    fn compare(&self, readings: &[Alternative]) -> Result<Vec<Scored>, FormatError> {
        compare(self.recording, readings, &self.much)
    }

    /// How the frames are mirrored, if at all, or that ON and OFF are exchanged; each way with and without an
    /// offset. `None` where nothing explains the frames' change.
    fn way(&self) -> Result<Option<Reading>, FormatError> {
        let ways = [None, Some(Mirror::LeftRight), Some(Mirror::TopBottom), Some(Mirror::Both)];
        let mut readings: Vec<Alternative> =
            ways.into_iter().flat_map(|way| [mirrored(way), with_offset(mirrored(way))]).collect();
        readings.push(Alternative::new("ON and OFF exchanged").inverted());
        let mut scored = self.compare(&readings)?;
        let exchanged = readings.len() - 1;
        if scored.first().is_some_and(|best| best.alternative == exchanged) && decided(&scored).is_some() {
            return Ok(Some(Reading { is_inverted: true, why: listed(&scored), ..Reading::default() }));
        }
        scored.retain(|one| one.alternative != exchanged);
        let way_of = |one: &Scored| ways[one.alternative / 2];
        let Some(first) = scored.first().filter(|first| first.explained.ci95.0 > LEAST_EXPLAINED) else {
            return Ok(None);
        };
        let as_is = scored.iter().find(|one| way_of(one).is_none());
        let mirror = way_of(first).filter(|_| as_is.is_none_or(is_behind));
        Ok(Some(Reading { mirror, ..Reading::default() }))
    }

    /// By how much the events are moved, right and down, so that they explain most without an offset;
    /// searched for from none and from `start`.
    fn shift(&self, way: Option<Mirror>, start: Option<(i32, i32)>) -> Result<(i32, i32), FormatError> {
        let mut explained: BTreeMap<(i32, i32), f64> = BTreeMap::new();
        let highest = |explained: &BTreeMap<(i32, i32), f64>| {
            explained.iter().max_by(|a, b| a.1.total_cmp(b.1)).map(|(at, _)| *at)
        };
        for start in [Some((0, 0)), start].into_iter().flatten() {
            let mut centre = start;
            for _ in 0..STEPS {
                let around = (-1..=1)
                    .flat_map(|down| (-1..=1).map(move |right| (right, down)))
                    .map(|(right, down)| (centre.0 + right, centre.1 + down));
                let unknown: Vec<(i32, i32)> = around.filter(|at| !explained.contains_key(at)).collect();
                let readings: Vec<Alternative> = unknown.iter().map(|at| moved(way, *at)).collect();
                // Each pass evaluates the same tiles only if it holds the same reference.
                for one in self.compare(&readings)? {
                    explained.insert(unknown[one.alternative], one.explained.value);
                }
                match highest(&explained).filter(|highest| *highest != centre) {
                    Some(highest) => centre = highest,
                    None => break,
                }
            }
        }
        Ok(highest(&explained).unwrap_or((0, 0)))
    }

    /// A shift against an offset, on one set of pairs.
    fn against_offset(&self, mirror: Option<Mirror>, shift: (i32, i32)) -> Result<Reading, FormatError> {
        let mut finals = vec![mirrored(mirror), with_offset(mirrored(mirror))];
        if shift != (0, 0) {
            finals.push(moved(mirror, shift));
        }
        if mirror.is_some() {
            finals.push(with_offset(mirrored(None)));
        }
        let scored = self.compare(&finals)?;
        let is_shifted = shift != (0, 0)
            && scored.first().is_some_and(|best| best.alternative == 2)
            && scored.iter().filter(|one| one.alternative != 2).all(is_behind);
        Ok(Reading {
            mirror,
            shift: is_shifted.then_some(Shift { right: -shift.0, down: -shift.1 }),
            why: listed(&scored),
            ..Reading::default()
        })
    }
}

/// Frame pixels along the side of an event pixel, at most, in the search for another array.
const MOST_TIMES: u32 = 8;

/// The array of which the frames are a whole multiple and on which events explain the frames' change, where
/// they do not explain it on the recorded one. `None` where none does.
///
/// # Errors
/// When the recording cannot be read any more.
fn smaller_array(recording: &dyn Recording, survey: &Survey) -> Result<Option<Reading>, FormatError> {
    let (Some(events), Some(pictures)) = (survey.events.as_ref(), recording.pictures()) else {
        return Ok(None);
    };
    let (frames, (x, y)) = (pictures.about().extent, events.places.largest);
    let part = |times: u32| Extent { width: frames.width / times, height: frames.height / times };
    let holds = |times: &u32| {
        frames.multiple_of(part(*times)) == Some(*times) && x < part(*times).width && y < part(*times).height
    };
    let mut scored = Vec::new();
    for extent in (2..=MOST_TIMES).filter(holds).map(part).map(Some).chain([None]) {
        let name = extent.map_or("the recorded array".to_owned(), |extent| format!("an array of {extent}"));
        let much = Much { span_ns: events.span_ns, events: EVENTS, extent };
        scored.extend(
            compare(recording, &[Alternative::new(name)], &much)?.into_iter().map(|one| (extent, one)),
        );
    }
    // Each array has its own pixels and pairs of tiles: intervals that do not meet.
    scored.sort_by(|a, b| b.1.explained.value.total_cmp(&a.1.explained.value));
    let clear =
        |best: &Scored, other: &Scored| best.explained.ci95.0 > other.explained.ci95.1.max(LEAST_EXPLAINED);
    Ok(match scored.as_slice() {
        [(Some(extent), best), rest @ ..]
            if rest.iter().all(|(_, other)| clear(best, other)) && !rest.is_empty() =>
        {
            let why = listed(&scored.iter().map(|(_, one)| one.clone()).collect::<Vec<_>>());
            Some(Reading { extent: Some(*extent), why, ..Reading::default() })
        }
        _ => None,
    })
}

/// Share of the frames' change that an offset must explain beyond none, to be proposed. The road clip of
/// `data/recordings`, whose events are 2.5 ms late, gains 0.0046, the cradle 0.018, events that were stamped
/// 4 ms late 0.09 (`photocurrent init` of each).
const OFFSET_GAIN: f64 = 0.002;

/// Does an offset of the clocks explain clearly more than none, on pairs of frames that it was not fitted to?
/// With what both explain, for people.
///
/// # Errors
/// When the recording cannot be read any more.
pub fn offset_helps(recording: &dyn Recording) -> Result<(bool, String), FormatError> {
    let readings = [Alternative::new("without an offset"), Alternative::new("with one").fitting_offset()];
    let scored = compare(recording, &readings, &Much { span_ns: None, events: EVENTS, extent: None })?;
    let is_better = match scored.as_slice() {
        [best, second, ..] => {
            best.alternative == 1 && second.behind.ci95.0 > 0.0 && second.behind.value > OFFSET_GAIN
        }
        // Too little to compare: the estimate stands.
        _ => true,
    };
    Ok((is_better, listed(&scored)))
}

/// The best three readings, for people.
fn listed(scored: &[Scored]) -> String {
    let list = scored.iter().take(3).map(|one| {
        format!("{} explains {:.0} % of the frames' change", one.name, 100.0 * one.explained.value)
    });
    list.collect::<Vec<_>>().join("; ")
}
