//! Hazards of events and frames together: clocks that do not meet, events in step with frames, late events,
//! mirrored pictures, trigger edges.

use super::{Findings, Severity, count, mirror_of, percent, shift_of, time};
use crate::survey::grid::GridSurvey;
use crate::survey::interval::Interval;
use crate::survey::lag::LagSurvey;
use crate::survey::lines::LineSurvey;
use crate::survey::pictures::FramesSurvey;
use crate::survey::{EventsSurvey, Survey};

/// Adds what there is to say.
pub(super) fn judge(survey: &Survey, found: &mut Findings) {
    match (&survey.events, &survey.frames) {
        (Some(events), Some(frames)) if events.count > 0 && frames.count > 0 => {
            if overlap(events, frames, found) {
                step(survey, found);
                late(survey, frames, found);
            }
            sizes(events, frames, found);
        }
        (None, Some(_)) => found.fact(
            "frames_only",
            "there are frames and no events",
            "no event stream in this file",
            "name the file of the events too",
        ),
        (Some(_), None) => found.fact(
            "events_only",
            "there are events and no frames",
            "no frames in this file",
            "name the frames too, if there are any",
        ),
        _ => {}
    }
}

fn span(span: (i64, i64)) -> String {
    format!("{} to {}", time(span.0 as f64), time(span.1 as f64))
}

/// Do the spans meet?
fn overlap(events: &EventsSurvey, frames: &FramesSurvey, found: &mut Findings) -> bool {
    let (Some(of_events), Some(of_frames)) = (events.span_ns, frames.span_ns) else { return false };
    let shared = of_events.1.min(of_frames.1).saturating_sub(of_events.0.max(of_frames.0));
    let (long_events, long_frames) =
        (of_events.1.saturating_sub(of_events.0), of_frames.1.saturating_sub(of_frames.0));
    let spans = format!("events from {}, frames from {}", span(of_events), span(of_frames));
    // As for a plan (`photocurrent_core::Apart`): frames that end shortly before the first event are within a
    // period, a lone frame within the events' length.
    let slack = frames.period.map_or(long_events, |period| period.median_ns);
    if shared < -slack.max(0) {
        // Clocks that began together are off by the difference of their starts.
        let offset = of_frames.0.saturating_sub(of_events.0);
        let ratio = (of_frames.0 as f64 / of_events.0.max(1) as f64).abs();
        let is_unit = [1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9]
            .into_iter()
            .find(|unit| (ratio / unit - 1.0).abs() < 0.05 && of_events.0 > 0);
        let advice = match is_unit {
            Some(_) => "the two are of one clock in different units: state the unit of the one that is wrong"
                .to_owned(),
            None if offset.unsigned_abs() > 1_000_000_000_000_000_000 => {
                format!(
                    "one clock is that of the day: an offset was not added, or added twice; add {} ns \
                         to the events' stamps",
                    offset
                )
            }
            None => format!(
                "an offset was not added, or added twice; {offset} ns added to the events' \
                             stamps makes both begin together"
            ),
        };
        found.error("no_overlap", "events and frames do not overlap in time", spans, advice);
        return false;
    }
    if (shared as f64) < found.limits.overlap_share * long_events.min(long_frames) as f64 {
        found.hazard(
            "little_overlap",
            "events and frames overlap little in time",
            format!("{spans}: {} are common", time(shared as f64)),
            "check the offset between the two clocks",
        );
    }
    true
}

fn step(survey: &Survey, found: &mut Findings) {
    let Some(phase) = survey.phase.as_ref().filter(|phase| phase.frames >= found.limits.phase_fewest) else {
        return;
    };
    let peak = phase.profile[phase.peak];
    let by_row = phase
        .readout
        .iter()
        .filter(|line| line.over > found.limits.phase_peak && line.sigma > found.limits.readout_sigma);
    let (over, evidence) = match by_row.max_by(|a, b| a.sigma.total_cmp(&b.sigma)) {
        Some(line) => (
            line.over,
            format!(
                "{} events {} after a frame begins in row 0, and {} later from row to row, are {:.2} times \
                 those around ({:.0} sigma over {} frames)",
                if line.is_on { "ON" } else { "OFF" },
                time(line.phase_ns),
                time(line.row_ns),
                line.over,
                line.sigma,
                phase.frames
            ),
        ),
        None if peak > found.limits.phase_peak && phase.peak_sigma > found.limits.phase_sigma => {
            let mean_on = phase.on_share.iter().sum::<f64>() / phase.on_share.len() as f64;
            (
                peak,
                format!(
                    "{} after a frame begins {peak:.2} times the mean rate ({:.0} sigma over {} frames); {} \
                     ON there, {} otherwise",
                    time((phase.peak as f64 + 0.5) * phase.bin_ns as f64),
                    phase.peak_sigma,
                    phase.frames,
                    percent(phase.on_share[phase.peak]),
                    percent(mean_on)
                ),
            )
        }
        None => return,
    };
    found.add(
        "frame_coupled_events",
        if over > found.limits.phase_strong { Severity::Hazard } else { Severity::Fact },
        "some events come in step with the frames",
        evidence,
        "the switching of the frame path fires pixels: state `frame_coupling` in the description, or cut \
         that phase out; a lamp in step with the frames does this too",
    );
}

fn late(survey: &Survey, frames: &FramesSurvey, found: &mut Findings) {
    let (Some(lag), Some(period)) = (&survey.lag, frames.period) else { return };
    let period = period.median_ns as f64;
    if let Some((way, r)) = mirror_of(lag, found.limits) {
        let how = way.name();
        let as_is = lag.mirrored[0];
        found.hazard(
            "mirrored",
            format!("events and frames may be mirrored, {how}"),
            format!(
                "events correlate {r:.2} with the changes of the frames when mirrored, {as_is:.2} as they are"
            ),
            "look at a picture of both; flip one of them",
        );
    }
    if let Some(grid) = &lag.grid {
        displaced(grid, found);
    }
    let Some(late) = lag.late_ns.filter(|_| lag.correlation.0 >= found.limits.correlation) else { return };
    let interval = format!("{} (95 % {} to {})", time(late.value), time(late.ci95.0), time(late.ci95.1));
    let explained = lag
        .front_end_ns
        .map_or_else(String::new, |ns| format!(", and {} more that the stated front end explains", time(ns)));
    let of_row =
        if lag.row_time_ns.is_none() { ", of the middle row as the row time is not recorded" } else { "" };
    let evidence = format!(
        "{interval}{explained}{of_row}; correlation {:.2} there, {:.2} without a shift, over {}",
        lag.correlation.0,
        lag.correlation.1,
        count(lag.pairs as u64, "pair of frames", "pairs of frames")
    );
    // What a stated front end explains is not part of it; where none is stated, dim light may be what is
    // late.
    let share = found.limits.late_share * period;
    let beyond = lag
        .front_end_ns
        .map_or(share.max(found.limits.late_ns), |ns| share + found.limits.late_explained * ns);
    // What moves far within an exposure is a streak in a frame: which part of it the events show is not
    // certain, and the two correlate weakly.
    let streak = frames
        .exposure
        .filter(|_| lag.correlation.0 < found.limits.late_correlation)
        .map_or(0.0, |exposure| 0.5 * exposure.median_ns as f64);
    let beyond = beyond + streak;
    if late.ci95.0 > 0.5 * beyond && late.value > beyond
        || late.ci95.1 < -0.5 * beyond && late.value < -beyond
    {
        let way = if late.value > 0.0 { "late" } else { "early" };
        found.hazard(
            "events_late",
            format!("events are {way} against the frames"),
            evidence,
            "a latency, an offset of the clocks, or a stamp that means another part of the exposure: \
             estimate/offset measures it; state the offset, or the latency in the description",
        );
    } else {
        found.fact(
            "in_time",
            "events and frames show the same changes",
            format!("events later by {evidence}"),
            "nothing",
        );
    }
    if let Some(drift) = lag.drift_ns_per_s {
        drifts(drift, lag, period, found);
    }
}

/// Do the clocks drift apart?
fn drifts(drift: Interval, lag: &LagSurvey, period_ns: f64, found: &mut Findings) {
    let least = found.limits.drift_share * period_ns
        + found.limits.drift_explained * lag.front_end_ns.unwrap_or(found.limits.late_ns);
    let (early, late) = lag.drift_halves_ns_per_s;
    // Each half of the picture by itself must show it: what moves in one part only is no clock.
    let halves = [early, late].map(|half| half * drift.value.signum() * lag.drift_over_s);
    let is_sure = lag.pairs >= found.limits.drift_pairs
        && (drift.ci95.0 > 0.0 || drift.ci95.1 < 0.0)
        && halves.iter().all(|half| *half > 0.5 * least);
    if is_sure
        && drift.value.abs() * lag.drift_over_s > least
        && lag.drift_correlation.0 > lag.drift_correlation.1 + found.limits.drift_gain
    {
        let per_s = |ns: f64| format!("{:.0}", ns * 1e-3);
        found.hazard(
            "clock_drift",
            "the clocks of events and frames drift apart",
            format!(
                "{} us a second (95 % {} to {}), {} over {}; {} and {} us a second in the two halves of the \
                 picture",
                per_s(drift.value),
                per_s(drift.ci95.0),
                per_s(drift.ci95.1),
                time(drift.value * lag.drift_over_s),
                time(lag.drift_over_s * 1e9),
                per_s(early),
                per_s(late)
            ),
            "state `clock_drift` in the description, or record with a common trigger",
        );
    }
}

/// Do both lie on one pixel grid?
fn displaced(grid: &GridSurvey, found: &mut Findings) {
    let (best, none) = grid.correlation;
    if best < found.limits.correlation {
        return;
    }
    let (right, down) = (grid.right_px, grid.down_px);
    let interval = |of: Interval, way: &str| {
        format!("{:.2} pixels {way} (95 % {:.2} to {:.2})", of.value, of.ci95.0, of.ci95.1)
    };
    let evidence = format!(
        "frames lie {} and {} of the events; correlation {best:.3} there, {none:.3} without a shift at the \
         offset that suits that best, over {}",
        interval(right, "right"),
        interval(down, "down"),
        count(grid.patches as u64, "patch", "patches")
    );
    if shift_of(grid, found.limits).is_some() {
        found.hazard(
            "displaced",
            "frames and events are shifted against each other by whole pixels",
            evidence,
            "crop one of them by that shift, or state `misalignment` in the description",
        );
    } else {
        found.fact("on_one_grid", "events and frames lie on one pixel grid", evidence, "nothing");
    }
}

fn sizes(events: &EventsSurvey, frames: &FramesSurvey, found: &mut Findings) {
    if events.count < found.limits.fewest_events {
        return;
    }
    let used = (events.places.largest.0 + 1, events.places.largest.1 + 1);
    let whole = |n: u32, of: u32| n > 0 && of.is_multiple_of(n);
    let stated = events.extent.unwrap_or(used);
    let evidence = format!(
        "events reach column {} and row {}, frames have {} x {} pixels",
        used.0 - 1,
        used.1 - 1,
        frames.width,
        frames.height
    );
    let fits = |used: (u32, u32)| used.0 <= frames.width && used.1 <= frames.height;
    if !fits(used) && fits((used.1, used.0)) && events.extent.is_none() {
        found.hazard(
            "swapped",
            "columns and rows of the events may be swapped",
            evidence,
            "look at a picture of both; state the columns in the order in which they are stored",
        );
    } else if let Some(scale) = [16, 32, 64, 128].into_iter().find(|scale| {
        used.0.div_ceil(*scale) <= frames.width
            && used.0 > frames.width * (scale / 2)
            && used.1 > frames.height * (scale / 2)
    }) {
        found.error(
            "scaled",
            format!("coordinates of the events count {scale} to a pixel"),
            evidence,
            format!("state `coordinate_scale = {scale}`"),
        );
    } else if !(whole(stated.0, frames.width) && whole(stated.1, frames.height)) && events.extent.is_some() {
        found.question(
            "sizes_differ",
            "frames are no whole multiple of the events' pixels: they are not aligned as they are",
            format!("events {} x {}, frames {} x {}", stated.0, stated.1, frames.width, frames.height),
            "align them first (a homography or a crop); both cameras must see one picture",
        );
    }
}

/// A trigger line, against the frames.
pub(super) fn line(line: &LineSurvey, frames: Option<&FramesSurvey>, found: &mut Findings) {
    let name = format!("trigger line {}", line.line);
    let edges = format!("{} rising, {} falling", line.rising, line.falling);
    // A line with one kind of edge has none to miss.
    if line.unpaired > 0 {
        found.hazard(
            "trigger_unpaired",
            format!("edges of {name} do not come in pairs"),
            format!(
                "{edges}; {} one of their own kind",
                count(line.unpaired, "edge follows", "edges follow")
            ),
            "an edge was missed: frames after it may be shifted by one; count both against the frames",
        );
    }
    if line.gaps > 0 {
        let usual = line.period.map_or_else(String::new, |period| {
            format!(", usual {}, longest {}", time(period.median_ns as f64), time(period.max_ns as f64))
        });
        found.hazard(
            "trigger_gaps",
            format!("pulses of {name} are missing"),
            format!("{}{usual}", count(line.gaps, "gap", "gaps")),
            "a pulse was missed: match edges and frames by time, not by number",
        );
    }
    let (beats, Some(frames)) = (line.rising.max(line.falling), frames) else { return };
    let is_near = beats.abs_diff(frames.count) * 5 < frames.count;
    if is_near && beats != frames.count {
        found.hazard(
            "trigger_count",
            format!("{name} has another number of pulses than there are frames"),
            format!("{beats} pulses, {} frames", frames.count),
            "a frame or a pulse was lost, at an end or between: match them by time",
        );
    }
}
