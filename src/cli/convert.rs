//! `photocurrent convert`: a recording in another format, whole or a part of it.
//!
//! Events pass through in pieces; the file appears whole or not at all. What was damaged in the input is left out, reported, and makes the exit code 3.

use crate::args::{ConvertOptions, Written};
use crate::common::{Done, Failure};
use photocurrent_core::quantity::Duration;
use photocurrent_formats::arrange::{Arranged, EVENTS_BUDGET, Settings, arrange};
use photocurrent_formats::csv::CsvWriter;
use photocurrent_formats::trim::Crop;
use photocurrent_formats::{EventChunk, EventCursor, FormatError, Recording, TimeUnit, evt, format, joined};
use photocurrent_nodes::read::foreign::All;
use photocurrent_store::{RecordingContent, write_recording};
use std::io::BufWriter;
use std::path::Path;
use tempfile::NamedTempFile;

/// Writes `options.input` as `options.output`.
pub fn convert(options: &ConvertOptions) -> Done {
    let (input, output) = (&options.input, &options.output);
    let to = match options.to {
        Some(to) => to,
        None => by_ending(output)?,
    };
    if output.exists() && !options.force {
        return Err(usage(format!("{} exists\n  hint: give another name, or --force to replace it", output.display())));
    }
    if output.exists() && input.canonicalize().ok() == output.canonicalize().ok() {
        return Err(usage(format!("{} is the input itself\n  hint: give another name", output.display())));
    }
    let all = All::stated(input, &options.state).map_err(|error| usage(format!("--state: {error}")))?;
    let settings = Settings { start: time(&options.start, "--start")?, end: time(&options.end, "--end")?, crop: crop(options)?, ..all.settings() };
    if let (Some(start), Some(end)) = (settings.start, settings.end)
        && end <= start
    {
        return Err(usage(format!("the window ends at {end}, and begins at {start}")));
    }
    let found = format::recognise(input).map_err(refused)?;
    let found =
        found.ok_or_else(|| usage(format!("{}: this is no recording of a known format\n  hint: photocurrent inspect says what was found", input.display())))?;
    let recording = joined::open(found, input, &settings.declared).map_err(refused)?;
    if to == Written::Recording {
        return whole(options, recording.as_ref(), &settings);
    }
    events(options, to, recording.as_ref(), &settings)
}

fn by_ending(path: &Path) -> Result<Written, Failure> {
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    match ending.as_str() {
        "h5" | "hdf5" => Ok(Written::Recording),
        "csv" | "txt" => Ok(Written::Csv),
        "raw" => Ok(Written::Evt3),
        _ => Err(usage(format!("{}: the ending does not say what to write\n  hint: end the name in .h5, .csv or .raw, or state --to", path.display()))),
    }
}

fn usage(message: String) -> Failure {
    Failure::Other { message, code: 2 }
}

/// Input data that cannot be taken.
fn refused(error: FormatError) -> Failure {
    Failure::Other { message: error.to_string(), code: if error.undeclared.is_some() { 2 } else { 3 } }
}

fn time(text: &Option<String>, option: &str) -> Result<Option<Duration>, Failure> {
    text.as_ref().map(|text| text.parse().map_err(|error| usage(format!("{option}: {error}")))).transpose()
}

fn crop(options: &ConvertOptions) -> Result<Option<Crop>, Failure> {
    match options.crop[..] {
        [x, y, width, height] if width > 0 && height > 0 => Ok(Some(Crop { x, y, width, height })),
        [] => Ok(None),
        _ => Err(usage("--crop takes X,Y,WIDTH,HEIGHT in pixels, width and height at least 1".into())),
    }
}

/// Says what was lost on stderr, and gives the exit code.
fn ending(options: &ConvertOptions, arranged: &Arranged, what: &str) -> u8 {
    arranged.notes.iter().for_each(|note| eprintln!("note: {note}"));
    arranged.counts.iter().filter(|(n, _)| *n > 0).for_each(|(n, what)| eprintln!("note: {n} {what}"));
    arranged.losses.iter().for_each(|loss| eprintln!("data lost: {}: {}", loss.at, loss.what));
    eprintln!("{}: {what}", options.output.display());
    if arranged.losses.is_empty() { 0 } else { 3 }
}

fn arranged(options: &ConvertOptions, recording: &dyn Recording, settings: &Settings) -> Result<Arranged, Failure> {
    arrange(&options.input, recording, settings, |_: &dyn EventCursor| Ok::<(), FormatError>(())).map_err(refused)
}

/// Writes our own recording: both streams on one clock, linear digital numbers, the sensor description.
fn whole(options: &ConvertOptions, recording: &dyn Recording, settings: &Settings) -> Done {
    let arranged = arranged(options, recording, settings)?;
    let events = arranged.gather(recording, EVENTS_BUDGET, |_: &dyn EventCursor| Ok::<(), FormatError>(())).map_err(refused)?.map(|(events, _)| events);
    let frames = arranged.frame_sequence();
    let extent = events.as_ref().map(|events| events.meta.extent).or(frames.as_ref().map(|frames| frames.meta.extent));
    let extent =
        extent.ok_or_else(|| Failure::Other { message: format!("{}: there is neither an event nor a frame in it", options.input.display()), code: 3 })?;
    let content = RecordingContent { events: events.as_ref(), frames: frames.as_ref(), sensor: recording.sensor_text(), ..RecordingContent::empty(extent) };
    let count = write_recording(&options.output, &content)?;
    let frames = frames.map_or(0, |frames| frames.len());
    Ok(ending(options, &arranged, &format!("{count} events, {frames} frames")))
}

/// Where events go.
enum Sink {
    Csv(CsvWriter<BufWriter<NamedTempFile>>),
    Evt3(evt::evt3_writer::Writer<BufWriter<NamedTempFile>>),
}

/// Writes events alone.
fn events(options: &ConvertOptions, to: Written, recording: &dyn Recording, settings: &Settings) -> Done {
    let arranged = arranged(options, recording, settings)?;
    let meta = arranged.events.clone().map_err(|why| Failure::Other { message: format!("{why}: there is nothing to write"), code: 3 })?;
    let extent = meta.extent;
    let mut cursor = arranged.cursor(recording, options.from_zero).map_err(refused)?;
    let failed = |error: std::io::Error| Failure::other(format!("{}: cannot write: {error}", options.output.display()));
    let folder = options.output.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let file = BufWriter::with_capacity(1 << 20, NamedTempFile::new_in(folder).map_err(failed)?);
    let unit = unit(options)?;
    let mut sink = match to {
        Written::Csv => Sink::Csv(CsvWriter::new(file, unit, Some(extent), meta.has_t_in).map_err(failed)?),
        _ => Sink::Evt3(evt::evt3_writer::Writer::new(file, extent, &[]).map_err(failed)?),
    };
    let (mut chunk, mut count) = (EventChunk::default(), 0);
    while cursor.next(&mut chunk).map_err(refused)? {
        count += chunk.len();
        match &mut sink {
            Sink::Csv(writer) => writer.write(&chunk),
            Sink::Evt3(writer) => writer.write(&chunk),
        }
        .map_err(failed)?;
    }
    let mut file = match sink {
        Sink::Csv(writer) => writer.finish().map_err(failed)?,
        Sink::Evt3(writer) => {
            if writer.shift_ns() != 0 {
                eprintln!("note: EVT3 begins below 16.8 s: {} us were subtracted from every stamp", writer.shift_ns() / 1000);
            }
            writer.finish().map_err(failed)?
        }
    };
    std::io::Write::flush(&mut file).map_err(failed)?;
    let file = file.into_inner().map_err(|error| failed(error.into_error()))?;
    file.as_file().sync_all().map_err(failed)?;
    file.persist(&options.output).map_err(|error| failed(error.error))?;
    Ok(ending(options, &arranged, &format!("{count} events")))
}

fn unit(options: &ConvertOptions) -> Result<TimeUnit, Failure> {
    match options.unit.as_deref() {
        None | Some("us") => Ok(TimeUnit::Us),
        Some("s") => Ok(TimeUnit::S),
        Some("ms") => Ok(TimeUnit::Ms),
        Some("ns") => Ok(TimeUnit::Ns),
        Some(other) => Err(usage(format!("--unit {other}: use s, ms, us or ns"))),
    }
}
