//! One screen of facts about a recording, and what is to be said of it.

use crate::numbers::human_bytes;
use photocurrent_formats::hazard::{Finding, Severity, percent, time};
use photocurrent_formats::survey::lines::LineSurvey;
use photocurrent_formats::survey::pictures::{FramesSurvey, Spread};
use photocurrent_formats::survey::{EventsSurvey, Survey};
use std::fmt::Write;

/// Columns of a curve.
const WIDE: usize = 60;
/// Facts of the file that are shown.
const MOST_FACTS: usize = 6;
/// Findings of one severity that are shown.
const MOST_FINDINGS: usize = 20;

/// The screen of one file.
pub fn screen(path: &str, format: &str, bytes: u64, survey: &Survey, findings: &[Finding]) -> String {
    let mut text = format!("{path}\n{:<9}{format}, {}\n", "format", human_bytes(bytes));
    match &survey.events {
        None => text.push_str("events   none\n"),
        Some(events) => text.push_str(&of_events(events)),
    }
    match &survey.frames {
        None => text.push_str("frames   none\n"),
        Some(frames) => text.push_str(&of_frames(frames)),
    }
    for (n, line) in survey.triggers.iter().enumerate() {
        let _ = writeln!(text, "{:<9}{}", if n == 0 { "triggers" } else { "" }, of_line(line));
    }
    if let Some(late) = survey.lag.as_ref().and_then(|lag| lag.late_ns.map(|late| (late, lag))) {
        let (late, lag) = late;
        let _ = writeln!(
            text,
            "{:<9}events later than frames by {} (95 % {} to {}){}, correlation {:.2}",
            "clocks",
            time(late.value),
            time(late.ci95.0),
            time(late.ci95.1),
            lag.front_end_ns
                .map_or_else(String::new, |ns| format!(" beyond the {} of the stated front end", time(ns))),
            lag.correlation.0
        );
    }
    for (n, (name, value)) in survey.facts.iter().take(MOST_FACTS).enumerate() {
        let _ = writeln!(text, "{:<9}{name}: {value}", if n == 0 { "file" } else { "" });
    }
    let _ = writeln!(
        text,
        "{:<9}{}",
        "sensor",
        if survey.has_sensor { "a description is included" } else { "no description included" }
    );
    text.push_str(&of_findings(findings));
    text
}

fn of_events(events: &EventsSurvey) -> String {
    let mut text = String::new();
    let (width, height) = events.extent.unwrap_or((events.places.largest.0 + 1, events.places.largest.1 + 1));
    let about = if events.extent.is_some() { "" } else { " or more" };
    let cut = if events.is_cut { " (those that were read)" } else { "" };
    let _ = writeln!(
        text,
        "{:<9}{}{cut} of {width} x {height}{about} pixels, {} ON",
        "events",
        thousands(events.count),
        percent(events.on_share())
    );
    text.push_str(&of_rate(events));
    let stamps = &events.stamps;
    let stored =
        if events.stored_as.is_empty() { String::new() } else { format!(", stored as {}", events.stored_as) };
    let step = if stamps.step_ns == 0 { "unknown".to_owned() } else { time(stamps.step_ns as f64) };
    let _ = write!(
        text,
        "{:<9}step {step} (stated {}){stored}; {} equal to the one before",
        "stamps",
        time(stamps.tick_ns as f64),
        percent(stamps.equal_share)
    );
    let _ = writeln!(
        text,
        "{}",
        if stamps.backward > 0 { format!("; {} steps back", stamps.backward) } else { String::new() }
    );
    if let Some(in_pixel) = &events.in_pixel {
        let (least, mean, most) = in_pixel.latency_ns;
        let _ = writeln!(
            text,
            "{:<9}in-pixel times too: {} to {} before the off-pixel ones, mean {}",
            "",
            time(least as f64),
            time(most as f64),
            time(mean)
        );
    }
    let places = &events.places;
    let _ = write!(
        text,
        "{:<9}columns {} to {}, rows {} to {}",
        "places", places.smallest.0, places.largest.0, places.smallest.1, places.largest.1
    );
    if places.counted_pixels {
        let _ = write!(
            text,
            "; {} of the pixels fire",
            percent(places.active_pixels as f64 / events.pixels().max(1) as f64)
        );
    }
    let _ = writeln!(
        text,
        "{}",
        if places.hot_pixels > 0 { format!(", {} of them hot", places.hot_pixels) } else { String::new() }
    );
    events.notes.iter().for_each(|note| text.push_str(&format!("{:<9}{note}\n", "")));
    text
}

/// When events begin and end, and how many there are over time.
fn of_rate(events: &EventsSurvey) -> String {
    let mut text = String::new();
    if let Some((first, last)) = events.span_ns {
        let rate = events.rate_of_pixel_hz().map_or_else(String::new, |rate| {
            format!(
                ", {} a second, {rate:.3} a pixel and second",
                rough(events.count as f64 / events.seconds())
            )
        });
        let _ = writeln!(
            text,
            "{:<9}{} to {}: {}{rate}",
            "",
            time(first as f64),
            time(last as f64),
            time(events.seconds() * 1e9)
        );
        let bin = events.rate.bin_ns as f64 * (events.rate.counts.len() as f64 / WIDE as f64).max(1.0);
        let most =
            events.rate.counts.iter().copied().max().unwrap_or(0) as f64 / (events.rate.bin_ns as f64 * 1e-9);
        let _ = writeln!(
            text,
            "{:<9}{}  a column is {}, the top {} a second",
            "rate",
            curve(&events.rate.counts),
            time(bin),
            rough(most)
        );
    }
    text
}

fn of_frames(frames: &FramesSurvey) -> String {
    let mut text = String::new();
    let bits = if frames.bits == 32 { "floats".to_owned() } else { format!("{} bits", frames.bits) };
    let _ = writeln!(
        text,
        "{:<9}{} of {} x {} pixels, {}, {bits}",
        "frames",
        thousands(frames.count),
        frames.width,
        frames.height,
        frames.colour
    );
    let spread = |of: Spread| {
        let ends = if of.max_ns - of.min_ns > of.median_ns / 1000 {
            format!(" ({} to {})", time(of.min_ns as f64), time(of.max_ns as f64))
        } else {
            String::new()
        };
        format!("{}{ends}", time(of.median_ns as f64))
    };
    let mut parts = Vec::new();
    if let Some((first, last)) = frames.span_ns {
        parts.push(format!("{} to {}", time(first as f64), time(last as f64)));
    }
    if let Some(period) = frames.period {
        parts.push(format!("one every {}, {:.3} a second", spread(period), 1e9 / period.median_ns as f64));
    }
    parts.push(frames.exposure.map_or_else(
        || "exposure not recorded".to_owned(),
        |exposure| format!("exposure {}", spread(exposure)),
    ));
    parts.push(if frames.gap_count > 0 { format!("{} gaps", frames.gap_count) } else { "no gap".to_owned() });
    let _ = writeln!(text, "{:<9}{}", "", parts.join("; "));
    let row_time = frames.row_time_ns.map_or_else(
        || "not recorded".to_owned(),
        |ns| if ns == 0 { "0 (global shutter)".to_owned() } else { time(ns as f64) },
    );
    let values = &frames.values;
    let clipped = if values.clipped_share > 0.0 {
        format!(", {} of them at the largest", percent(values.clipped_share))
    } else {
        String::new()
    };
    let _ = writeln!(
        text,
        "{:<9}row time {row_time}; values {:.4} to {:.4}, mean {:.4}{clipped} ({} read)",
        "",
        Short(values.min),
        Short(values.max),
        Short(values.mean),
        if values.read.len() as u64 == frames.count {
            "all frames".to_owned()
        } else {
            format!("{} frames", values.read.len())
        }
    );
    frames.notes.iter().for_each(|note| text.push_str(&format!("{:<9}{note}\n", "")));
    text
}

fn of_line(line: &LineSurvey) -> String {
    let period = line
        .period
        .map_or_else(String::new, |period| format!(", one every {}", time(period.median_ns as f64)));
    let high = line.high.map_or_else(String::new, |high| format!(", up for {}", time(high.median_ns as f64)));
    format!("line {}: {} rising, {} falling{period}{high}", line.line, line.rising, line.falling)
}

fn of_findings(findings: &[Finding]) -> String {
    let mut text = String::new();
    let mut shown = 0;
    let width = findings.iter().map(|finding| finding.id.len()).max().unwrap_or(0);
    for finding in findings.iter().take(MOST_FINDINGS) {
        let _ = write!(
            text,
            "\n{:<8} {:<width$}  {}\n         {:<width$}  {}\n",
            finding.severity.name(),
            finding.id,
            finding.message,
            "",
            finding.evidence
        );
        if finding.severity != Severity::Fact {
            let _ = writeln!(text, "         {:<width$}  to do: {}", "", finding.what_to_do);
        }
        shown += 1;
    }
    if findings.len() > shown {
        let _ = writeln!(text, "\nand {} more; --json gives all", findings.len() - shown);
    }
    text
}

/// A curve of eight heights, `WIDE` columns at most.
pub fn curve(counts: &[u64]) -> String {
    const HEIGHTS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
    let columns = counts.len().min(WIDE);
    let of = |column: usize| {
        let (from, to) = (column * counts.len() / columns, (column + 1) * counts.len() / columns);
        counts[from..to].iter().sum::<u64>() as f64 / (to - from) as f64
    };
    let values: Vec<f64> = (0..columns).map(of).collect();
    let most = values.iter().copied().fold(0.0, f64::max);
    let height = |value: f64| {
        if value == 0.0 { ' ' } else { HEIGHTS[((value / most * 8.0).ceil() as usize).clamp(1, 8) - 1] }
    };
    values.into_iter().map(height).collect()
}

/// `78,830`.
fn thousands(n: u64) -> String {
    let digits = n.to_string();
    let first = digits.len() % 3;
    let mut text = digits[..first].to_owned();
    for group in digits.as_bytes()[first..].chunks(3) {
        if !text.is_empty() {
            text.push(',');
        }
        text.extend(group.iter().map(|digit| char::from(*digit)));
    }
    text
}

/// `33.4 thousand`.
fn rough(value: f64) -> String {
    match value {
        v if v < 1e3 => format!("{v:.1}"),
        v if v < 1e6 => format!("{:.1} thousand", v / 1e3),
        v if v < 1e9 => format!("{:.2} million", v / 1e6),
        v => format!("{v:.3e}"),
    }
}

/// A number without zeros at its end.
struct Short(f64);

impl std::fmt::Display for Short {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let rounded = if self.0.abs() >= 1e5 || (self.0 != 0.0 && self.0.abs() < 1e-3) {
            return write!(f, "{:.3e}", self.0);
        } else {
            format!("{:.3}", self.0)
        };
        f.write_str(rounded.trim_end_matches('0').trim_end_matches('.'))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_shows_its_top_and_its_holes() {
        assert_eq!(curve(&[0, 1, 4, 8]), " ▁▄█");
        assert_eq!(curve(&[5; 600]).chars().count(), WIDE);
        assert_eq!(curve(&[]), "");
    }

    #[test]
    fn numbers_are_for_people() {
        assert_eq!([thousands(7), thousands(1234), thousands(1_218_618)], ["7", "1,234", "1,218,618"]);
        assert_eq!(
            [Short(25.0).to_string(), Short(0.25).to_string(), Short(-3e6).to_string()],
            ["25", "0.25", "-3.000e6"]
        );
    }
}
