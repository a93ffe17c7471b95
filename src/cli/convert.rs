//! `photocurrent convert`: a recording in another format, whole or a part of it.
//!
//! Events pass through in pieces; the file appears whole or not at all. What was damaged in the input is left
//! out, reported, and makes the exit code 3.

use crate::args::{ConvertOptions, Written};
use crate::failure::{Done, Failure, usage};
use crate::terminal::say;
use photocurrent_core::EventsMeta;
use photocurrent_formats::arrange::{Arranged, Settings, arrange};
use photocurrent_formats::csv::CsvWriter;
use photocurrent_formats::hdf::write;
use photocurrent_formats::{EventChunk, EventCursor, FormatError, Recording, catalog, evt, joined};
use photocurrent_nodes::spans::check_window;
use photocurrent_store::recording::DnType;
use photocurrent_store::stream::{StreamedFrames, StreamedRecording};
use photocurrent_store::{StoreError, unnamed_in};
use std::io::BufWriter;
use std::path::Path;
use std::sync::Arc;
use tempfile::NamedTempFile;

/// Writes `options.input` as `options.output`.
pub fn convert(options: &ConvertOptions) -> Done {
    let (input, output) = (&options.input, &options.output);
    let to = match options.to {
        Some(to) => to,
        None => by_ending(output)?,
    };
    if output.exists() && !options.force {
        return Err(usage(format!(
            "{} exists\n  hint: give another name, or --force to replace it",
            output.display()
        )));
    }
    if output.exists() && input.canonicalize().ok() == output.canonicalize().ok() {
        return Err(usage(format!("{} is the input itself\n  hint: give another name", output.display())));
    }
    let settings = Settings {
        start: options.start,
        end: options.end,
        crop: options.crop,
        ..options.declared.parameters(input).settings()
    };
    check_window(settings.start, settings.end).map_err(|error| usage(error.message))?;
    let found = catalog::recognise(input).map_err(refused)?;
    let found = found.ok_or_else(|| crate::inspect::unknown(input))?;
    let recording = joined::open(found, input, &settings.declared).map_err(refused)?;
    match to {
        Written::Recording => whole(options, recording.as_ref(), &settings),
        Written::Dsec => dsec(options, recording.as_ref(), &settings),
        Written::Csv | Written::Evt3 => events(options, to, recording.as_ref(), &settings),
    }
}

fn by_ending(path: &Path) -> Result<Written, Failure> {
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    match ending.as_str() {
        "h5" | "hdf5" => Ok(Written::Recording),
        "csv" | "txt" => Ok(Written::Csv),
        "raw" => Ok(Written::Evt3),
        _ => Err(usage(format!(
            "{}: the ending does not say what to write\n  hint: end the name in .h5, \
                                .csv or .raw, or state --to",
            path.display()
        ))),
    }
}

fn refused(error: FormatError) -> Failure {
    crate::declared::refused(&error)
}

/// Says what was lost on stderr, and gives the exit code.
fn ending(options: &ConvertOptions, arranged: &Arranged, from_zero: bool, what: &str) -> u8 {
    // Where the file's clock stays, its zero is no news.
    arranged
        .notes
        .iter()
        .filter(|note| from_zero || !note.starts_with("t = 0 is "))
        .for_each(|note| say!("note: {note}"));
    arranged.counts.iter().filter(|(n, _)| *n > 0).for_each(|(n, what)| say!("note: {n} {what}"));
    arranged.losses.iter().for_each(|loss| say!("data lost: {}: {}", loss.at, loss.what));
    say!("{}: {what}", options.output.display());
    if arranged.losses.is_empty() { 0 } else { 3 }
}

fn arranged(
    options: &ConvertOptions,
    recording: &dyn Recording,
    settings: &Settings,
) -> Result<Arranged, Failure> {
    arrange(&options.input, recording, settings, |_: &dyn EventCursor| Ok::<(), FormatError>(()))
        .map_err(refused)
}

/// Writes our own recording: both streams on one clock, linear digital numbers, the sensor description.
fn whole(options: &ConvertOptions, recording: &dyn Recording, settings: &Settings) -> Done {
    let arranged = arranged(options, recording, settings)?;
    let (events, frames) = (arranged.events.as_ref().ok(), arranged.frame_sequence());
    let extent = events.map(|events| events.extent).or(frames.as_ref().map(|frames| frames.meta.extent));
    let extent = extent.ok_or_else(|| Failure::Other {
        message: format!("{}: there is neither an event nor a frame in it", options.input.display()),
        code: 3,
    })?;
    let read = |frame: usize, values: &mut Vec<f32>| {
        let block = frames
            .as_ref()
            .map(|frames| frames.read(frame..frame + 1, frames.rows()))
            .transpose()
            .map_err(StoreError::Source)?;
        *values = block.map(|block| block.dn).unwrap_or_default();
        Ok(())
    };
    let content = StreamedRecording {
        extent,
        events: events.map(|events| events.has_t_in),
        t_resolution_ns: events.and_then(|events| events.t_resolution_ns),
        frames: frames.as_ref().map(|frames| StreamedFrames {
            extent: frames.meta.extent,
            colour: frames.meta.colour,
            dn: if arranged.whole_numbers() { DnType::U16 } else { DnType::F32 },
            row_time_ns: frames.meta.times.row_time_ns,
            exposures: frames
                .meta
                .times
                .exposures
                .iter()
                .map(|exposure| (exposure.start.0, exposure.end.0))
                .collect(),
            read: &read,
        }),
        sensor: recording.sensor_text(),
    };
    let mut cursor = events.map(|_| arranged.cursor(recording, true)).transpose().map_err(refused)?;
    let cursor: Option<&mut dyn EventCursor> =
        cursor.as_mut().map(|cursor| &mut **cursor as &mut dyn EventCursor);
    let written = write::write_recording(&options.output, cursor, &content).map_err(refused)?;
    let count = content.frames.map_or(0, |frames| frames.exposures.len());
    Ok(ending(options, &arranged, true, &format!("{} events, {count} frames", written.events)))
}

/// Writes events in the layout of DSEC.
fn dsec(options: &ConvertOptions, recording: &dyn Recording, settings: &Settings) -> Done {
    let arranged = arranged(options, recording, settings)?;
    let meta = events_of(&arranged)?;
    let mut cursor = arranged.cursor(recording, options.from_zero).map_err(refused)?;
    let written =
        write::write_dsec(&options.output, &mut *cursor, meta.extent, meta.has_t_in).map_err(refused)?;
    written.notes.iter().for_each(|note| say!("note: {note}"));
    Ok(ending(options, &arranged, options.from_zero, &format!("{} events", written.events)))
}

fn events_of(arranged: &Arranged) -> Result<Arc<EventsMeta>, Failure> {
    arranged
        .events
        .clone()
        .map_err(|why| Failure::Other { message: format!("{why}: there is nothing to write"), code: 3 })
}

/// Where events go.
enum Sink {
    Csv(CsvWriter<BufWriter<NamedTempFile>>),
    Evt3(evt::evt3_writer::Writer<BufWriter<NamedTempFile>>),
}

/// Writes events alone.
fn events(options: &ConvertOptions, to: Written, recording: &dyn Recording, settings: &Settings) -> Done {
    let arranged = arranged(options, recording, settings)?;
    let meta = events_of(&arranged)?;
    let extent = meta.extent;
    let mut cursor = arranged.cursor(recording, options.from_zero).map_err(refused)?;
    let failed = |error: std::io::Error| {
        Failure::other(format!("{}: cannot write: {error}", options.output.display()))
    };
    let folder =
        options.output.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let file = BufWriter::with_capacity(1 << 20, unnamed_in(folder).map_err(failed)?);
    let mut sink = match to {
        Written::Csv => {
            Sink::Csv(CsvWriter::new(file, options.unit, Some(extent), meta.has_t_in).map_err(failed)?)
        }
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
                say!(
                    "note: EVT3 begins below 16.8 s: {} us were subtracted from every stamp",
                    writer.shift_ns() / 1000
                );
            }
            writer.finish().map_err(failed)?
        }
    };
    std::io::Write::flush(&mut file).map_err(failed)?;
    let file = file.into_inner().map_err(|error| failed(error.into_error()))?;
    file.as_file().sync_all().map_err(failed)?;
    file.persist(&options.output).map_err(|error| failed(error.error))?;
    Ok(ending(options, &arranged, options.from_zero, &format!("{count} events")))
}
