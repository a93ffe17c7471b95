//! `photocurrent inspect`.

use crate::args::InspectOptions;
use crate::common::{Done, Failure, human_bytes, print, print_json};
use crate::file_kind::need_data;
use photocurrent_core::{TimeSpan, Value};
use photocurrent_store::open_value;
use photocurrent_store::recording::Recording;
use serde_json::json;
use std::fmt::Write;

/// Shows what a file holds.
pub fn inspect(options: &InspectOptions) -> Done {
    need_data(&options.file, "inspect")?;
    let recording = match Recording::open(&options.file) {
        Ok(recording) => recording,
        Err(not_a_recording) => {
            // A cached artefact says so itself; for anything else the recording's complaint is the useful one.
            let Ok(value) = open_value(&options.file) else { return Err(not_a_recording.into()) };
            return artefact(&value, options.json);
        }
    };
    let found = recording.inspect();
    if options.json {
        print_json(&serde_json::to_value(&found).map_err(|error| Failure::other(error.to_string()))?)?;
        return Ok(0);
    }
    let mut text = format!("{}  {}\nsensor   {} x {} pixels\n", found.path, human_bytes(found.bytes), found.width, found.height);
    match &found.events {
        None => text.push_str("events   none recorded\n"),
        Some(events) => {
            let _ = writeln!(text, "events   {}{}", events.count, span(events.span));
            if let (Some(rate), Some(per_pixel)) = (events.events_per_s, events.events_per_pixel_s) {
                let _ = writeln!(text, "         {rate:.0} events/s, {per_pixel:.2} per pixel and second");
            }
            let _ = writeln!(
                text,
                "         stamps: off-pixel{}{}",
                if events.has_t_in { " and in-pixel" } else { " only" },
                events.t_resolution_ns.map(|ns| format!(", resolution {ns} ns")).unwrap_or_default()
            );
        }
    }
    match &found.frames {
        None => text.push_str("frames   none recorded\n"),
        Some(frames) => {
            let _ = writeln!(text, "frames   {}{}", frames.count, span(frames.span));
            let rate = frames.frames_per_s.map(|rate| format!("{rate:.3} per second, ")).unwrap_or_default();
            let exposure = frames.exposure.map(|e| format!("exposure {} us, ", e.median_ns as f64 / 1e3)).unwrap_or_default();
            let row_time = frames.row_time_ns.map_or("not stated".to_string(), |ns| if ns == 0 { "0 (global shutter)".into() } else { format!("{ns} ns") });
            let _ = writeln!(text, "         {rate}{exposure}row time {row_time}, {}, {}", frames.colour, frames.number_type);
            let per_event_pixel = frames.pixels_per_event_pixel;
            if per_event_pixel > 1 {
                let _ = writeln!(text, "         {} x {} pixels, {per_event_pixel} x {per_event_pixel} on each event pixel", frames.width, frames.height);
            }
        }
    }
    match &found.truth {
        None => text.push_str("truth    none: real data, or not given\n"),
        Some(truth) => drop(writeln!(text, "truth    {} instants{}", truth.count, span(truth.span))),
    }
    let _ = writeln!(text, "nominal sensor description: {}", if found.has_sensor { "included" } else { "none" });
    print(&text)?;
    Ok(0)
}

fn span(span: Option<TimeSpan>) -> String {
    span.map(|span| format!(", from {} to {}", span.start, span.end)).unwrap_or_default()
}

fn artefact(value: &Value, as_json: bool) -> Done {
    let meta = serde_json::to_value(value.meta()).map_err(|error| Failure::other(error.to_string()))?;
    if as_json {
        print_json(&json!({"type": value.data_type().name(), "meta": meta}))?;
        return Ok(0);
    }
    let mut text = format!("artefact of type {}\n", value.data_type());
    if let Value::Table(table) = value {
        let mut rows = vec![table.columns().iter().map(|(name, _)| name.clone()).collect()];
        rows.extend((0..table.len()).map(|row| table.columns().iter().map(|(_, column)| column.cell(row)).collect()));
        text.push_str(&crate::tables::draw(&rows));
        table.notes.iter().for_each(|(name, note)| text.push_str(&format!("{name}: {note}\n")));
    } else if let Value::Diagnosis(document) = value {
        text.push_str(document.text());
    } else {
        text.push_str(&serde_json::to_string_pretty(&meta).map_err(|error| Failure::other(error.to_string()))?);
    }
    print(&text)?;
    Ok(0)
}
