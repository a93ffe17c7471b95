//! Proposals for pictures without times of their own: the trigger line, which of its levels is an open
//! shutter, and which pulse or stamp belongs to the first picture.
//!
//! Both levels and every pulse that may be the first picture's are held against the events; what is proposed
//! stands in the manifest with what speaks for the others. Frames in a file or folder with the events are
//! read with each first stamp that may be ([`by_trial`]).
//!
//! Limits: a picture that is lost between others whose stamps are all there has no first stamp that fits;
//! then nothing is proposed.

use super::fill::Fill;
use super::readings;
use crate::failure::Failure;
use crate::parts::Parts;
use photocurrent_core::quantity::Duration;
use photocurrent_formats::pairings::{Comparison, Way, compare, likeliest_line};
use photocurrent_formats::survey::alternatives::{
    Alternative, LEAST_EXPLAINED, Much, compare as compare_readings,
};
use photocurrent_formats::{FormatError, Recording, StampRole, joined};
use photocurrent_nodes::read::foreign::All;
use photocurrent_nodes::read::formats::takes;

/// Is it open how pictures and times are paired? So it is for every trigger line whose strobe is not stated,
/// and where a reader refuses to pair.
pub fn is_open(all: &All, error: Option<&FormatError>) -> bool {
    match error.and_then(|error| error.undeclared) {
        Some(name) => ["strobe", "first_pulse", "pairing"].contains(&name),
        None => {
            error.is_none()
                && all.trigger_line.is_some()
                && (all.strobe.is_none() || all.first_pulse.is_none())
        }
    }
}

/// The trigger line that has about as many pulses as there are pictures, put into `all`.
pub fn line(parts: &Parts, all: &mut All) -> Option<Fill> {
    let (line, [rising, falling], pictures) =
        likeliest_line(parts.format, &parts.recording, &all.settings().declared)?;
    all.trigger_line = Some(line);
    let why = format!(
        "no file states when the frames were taken; trigger line {line} of the event file has {rising} \
         rising and {falling} falling edges, for {pictures} pictures"
    );
    Some(Fill::open("trigger_line", line.to_string(), why))
}

/// What one edge a frame means.
pub fn stamp(all: &mut All) -> Fill {
    all.stamp = Some(StampRole::Start);
    let why = "the trigger line has one edge a frame: mostly the start of its exposure, at some cameras the \
               end. A wrong one shifts frames against events";
    Fill::open("stamp", "\"start\"", why)
}

/// The pairing to take, put into `all`; nothing where everything about it is recorded or stated.
pub fn proposed(parts: &Parts, all: &mut All) -> Result<Vec<Fill>, Failure> {
    let row_time_ns = all.row_time.map_or(0, Duration::ns);
    let found = compare(parts.format, &parts.recording, &all.settings().declared, row_time_ns)
        .map_err(|error| crate::declared::refused(&error))?;
    let Some(comparison) = found else { return Ok(Vec::new()) };
    let Some(best) = comparison.ways.first() else { return Ok(Vec::new()) };
    let mut fills = Vec::new();
    if let (Some(level), None) = (best.strobe, all.strobe) {
        all.strobe = Some(level);
        let why = strobe(&comparison, best);
        fills.push(Fill::open("strobe", format!("\"{}\"", level.name()), why));
    }
    if !best.is_plain {
        let other = comparison
            .ways
            .iter()
            .find(|way| way.strobe == best.strobe && (way.first, way.by) != (best.first, best.by));
        if all.first_pulse.is_none() {
            all.first_pulse = Some(best.first);
            fills.push(Fill::open("first_pulse", best.first.to_string(), first(&comparison, best, other)));
        }
        if all.pairing.is_none() && comparison.ways.iter().any(|way| way.by != best.by) {
            all.pairing = Some(best.by);
            let why = "by what a missing picture, pulse or stamp is recognised: holes in the numbers of \
                       names, gaps between times, both, or nothing (order)";
            fills.push(Fill::open("pairing", format!("\"{}\"", best.by.name()), why));
        }
    }
    Ok(fills)
}

/// First stamps that are tried, to both sides of 0.
const TRIED: i64 = 3;

/// The first stamp with which the events explain most of the frames' change, put into `all`, for a reader
/// that leaves it open. `None` where the halves of the recording disagree, or one decides nothing.
pub fn by_trial(parts: &Parts, all: &mut All) -> Result<Option<Fill>, Failure> {
    let refused = |error: FormatError| crate::declared::refused(&error);
    if all.first_pulse.is_some() || all.pairing.is_some() || !takes(parts.format.id, "first_pulse") {
        return Ok(None);
    }
    let read = |first: i64| {
        let mut trial = all.clone();
        trial.first_pulse = Some(first);
        let recording = joined::open(parts.format, &parts.recording, &trial.settings().declared).ok()?;
        let frames = recording.pictures()?.about().stamps.len();
        Some((first, recording, frames))
    };
    let mut trials: Vec<_> = (-TRIED..=TRIED).filter_map(read).collect();
    let most = trials.iter().map(|(_, _, frames)| *frames).max().unwrap_or(0);
    trials.retain(|(_, _, frames)| *frames == most);
    let stamps = |recording: &dyn Recording| {
        recording
            .pictures()
            .map(|pictures| pictures.about().stamps.iter().map(|stamp| stamp.at).collect::<Vec<_>>())
    };
    let [start, middle, end] =
        match trials.first().and_then(|(_, recording, _)| stamps(recording.as_ref())).as_deref() {
            Some([start, .., end]) if trials.len() > 1 => [*start, start.midpoint(*end), *end],
            _ => return Ok(None),
        };
    let mut whys: Vec<(i64, String)> = Vec::new();
    for (span_ns, half) in [((start, middle), "first"), ((middle, end), "second")] {
        let much = Much { span_ns: Some(span_ns), events: readings::EVENTS, extent: None };
        let mut scored = Vec::new();
        for (first, recording, _) in &trials {
            let found = compare_readings(recording.as_ref(), &[Alternative::new(first.to_string())], &much)
                .map_err(refused)?;
            scored.extend(found.into_iter().map(|one| (*first, one.explained)));
        }
        scored.sort_by(|a, b| b.1.value.total_cmp(&a.1.value));
        let [(best, explained), (second, less), ..] = scored.as_slice() else { return Ok(None) };
        if explained.ci95.0 < LEAST_EXPLAINED.max(less.ci95.1) {
            return Ok(None);
        }
        let percent = |share: f64| 100.0 * share;
        let why = format!(
            "in the {half} half events explain {:.0} % of the frames' change with {best}, {:.0} % with \
             {second}",
            percent(explained.value),
            percent(less.value)
        );
        whys.push((*best, why));
    }
    let [(first, in_first), (other, in_second)] = whys.as_slice() else { return Ok(None) };
    if first != other {
        return Ok(None);
    }
    all.first_pulse = Some(*first);
    let why = format!(
        "which stamp belongs to the first frame follows from no count: {in_first}, \
                       {in_second}. A wrong one shifts every frame by whole periods"
    );
    Ok(Some(Fill::open("first_pulse", first.to_string(), why)))
}

/// How well a way agrees with the events.
fn agreement(way: &Way) -> String {
    match way.agreement {
        Some((correlation, late)) => {
            format!("agreement with the events {correlation:.2}, {} late", Duration::new(late))
        }
        None => "agreement with the events not measured".into(),
    }
}

/// Whether the events decide.
fn verdict(comparison: &Comparison) -> &'static str {
    if comparison.clear { "" } else { "; this is not clear, so compare both" }
}

fn strobe(comparison: &Comparison, best: &Way) -> String {
    let of = |way: &Way| {
        let edges = way.strobe.map_or("", |strobe| strobe.edges());
        let length = way.exposure_ns.map_or_else(String::new, |ns| format!(" of {}", Duration::new(ns)));
        format!(
            "{edges}: {} whole exposures{length} for {} pictures, {}",
            way.whole,
            comparison.pictures,
            agreement(way)
        )
    };
    let other = comparison.ways.iter().find(|way| way.strobe != best.strobe);
    let other = other.map_or_else(|| "the other level pairs nothing".into(), of);
    format!(
        "which level is an open shutter is not recorded; {}; {other}{}. A wrong one shifts every frame \
             by half a period",
        of(best),
        verdict(comparison)
    )
}

fn first(comparison: &Comparison, best: &Way, other: Option<&Way>) -> String {
    let second = other.map_or_else(String::new, |way| {
        let by =
            if way.by == best.by { String::new() } else { format!(" with pairing = \"{}\"", way.by.name()) };
        format!("; second best is {}{by}: {}, {}", way.first, way.remainder, agreement(way))
    });
    format!(
        "which pulse or stamp belongs to the first of {} pictures follows from no count: {}, {}{second}{}. \
         A wrong one shifts every frame by whole periods",
        comparison.pictures,
        best.remainder,
        agreement(best),
        verdict(comparison)
    )
}
