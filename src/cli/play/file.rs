//! A recording of any format, or a cached result with events or frames.
//!
//! A page for looking needs less than a solver: what a file does not record of its frames (exposure, row
//! time, curve of the values) is assumed here and stated on the page, unless the user states it.

use super::films::Film;
use super::options::PlayOptions;
use super::source::{Source, stretch};
use crate::declared::refused;
use crate::failure::{Failure, usage};
use crate::inspect::{reading_bar, unknown};
use crate::numbers::in_ms;
use crate::parts::Parts;
use indicatif::ProgressBar;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{NodeError, TimeSpan, Value};
use photocurrent_formats::arrange::{Arranged, EVENTS_BUDGET, Settings, arrange};
use photocurrent_formats::{
    EventChunk, EventCursor, FormatError, Recording, StampRole, Transfer, joined, recognise,
};
use photocurrent_nodes::show::{Packer, Shown};
use photocurrent_store::open_value;
use std::path::{Path, PathBuf};

/// How long a frame is taken to be exposed where nothing states it: a mark, no exposure.
const MARK_NS: i64 = 1000;
/// A few stamps far from all others do not widen what is played: of the stamps this share lies within.
const SHARE: f64 = 0.999;
/// From so many times the length of that share on, they are left out.
const TOO_LONG: i64 = 10;

/// Opens a recording: one file or folder, or events with their frames and stamps.
pub fn recording(files: &[PathBuf], options: &PlayOptions) -> Result<Source, Failure> {
    let (path, format, stated) = if let [path] = files {
        let wrong = |error: FormatError| match path.exists() {
            true => refused(&error),
            false => usage(error.to_string()),
        };
        let format = recognise(path).map_err(wrong)?.ok_or_else(|| unknown(path))?;
        (path.clone(), format, options.declared.parameters(path).settings())
    } else {
        let parts = Parts::sort(files)?;
        let mut settings = options.declared.parameters(&parts.recording).settings();
        settings.declared = parts.declared(&settings.declared);
        (parts.recording, parts.format, settings)
    };
    let opened = joined::open(format, &path, &stated.declared).map_err(|error| refused(&error))?;
    let mut notes = Vec::new();
    let settings = assumed(opened.as_ref(), stated, &mut notes);
    let bar = reading_bar(options.quiet);
    let advance =
        |part: f64| bar.iter().for_each(|bar: &ProgressBar| bar.set_position((500.0 * part) as u64));
    let arranged = arrange(&path, opened.as_ref(), &settings, |cursor| {
        advance(part_of(cursor));
        Ok::<(), FormatError>(())
    })
    .map_err(|error| refused(&error))?;
    let whole = whole(&arranged, &path)?;
    let whole = without_strays(whole, &arranged, options, &mut notes);
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let span = stretch(options, whole, &name)?;
    let packer = match &arranged.events {
        Ok(meta) => {
            let mut packer = Packer::new(meta.extent, span, options.max_size);
            fill(&mut packer, &arranged, opened.as_ref(), span, |part| advance(1.0 + part))?;
            Some(packer)
        }
        Err(why) => {
            notes.push(format!("There are no events: {why}."));
            None
        }
    };
    bar.into_iter().for_each(|bar| bar.finish_and_clear());
    let shown = arranged.frame_sequence().and_then(|frames| Shown::of(Value::Frames(frames)));
    let film = shown.and_then(|shown| Film::within(span, "captured".into(), None, shown));
    match (&film, &arranged.frames) {
        (None, Ok(_)) => notes.push("There is no frame in this stretch.".into()),
        (None, Err(why)) => notes.push(format!("There are no frames: {why}.")),
        (Some(_), _) => {}
    }
    let losses = arranged.losses.iter().map(|loss| format!("Data lost: {}: {}.", loss.at, loss.what));
    notes.extend(losses);
    let is_damaged = !arranged.losses.is_empty();
    notes.extend(arranged.notes.iter().cloned());
    notes.extend(arranged.counts.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")));
    let facts = vec![("recording".into(), format!("{name}, {}", format.name))];
    let (films, events) = (film.into_iter().collect(), packer);
    Ok(Source { facts, notes, span, events, films, is_damaged, ..named(&path) })
}

/// What has the name of a file, and nothing in it.
fn named(path: &Path) -> Source {
    let name = |part: Option<&std::ffi::OsStr>| part.unwrap_or_default().to_string_lossy().into_owned();
    Source {
        title: name(path.file_name()),
        folder: Path::new("out").join(name(path.file_stem())),
        facts: Vec::new(),
        notes: Vec::new(),
        span: TimeSpan::new(0, 0),
        events: None,
        films: Vec::new(),
        sensor: None,
        best: None,
        is_damaged: false,
    }
}

/// The settings with what neither the file nor the user states of the frames.
fn assumed(recording: &dyn Recording, mut settings: Settings, notes: &mut Vec<String>) -> Settings {
    let Some(pictures) = recording.pictures() else { return settings };
    let (about, declared) = (pictures.about(), &mut settings.declared);
    if declared.exposure.is_none() && about.stamps.iter().any(|stamp| stamp.exposure.is_none()) {
        declared.exposure = Some(Duration::new(MARK_NS));
        declared.stamp = declared.stamp.or(about.stamp_role).or(Some(StampRole::Middle));
        notes.push(
            "How long frames are exposed is not recorded: they are marked at their stamps. `--exposure` and \
             `--stamp` state it."
                .into(),
        );
    } else if declared.exposure.is_some() && declared.stamp.or(about.stamp_role).is_none() {
        declared.stamp = Some(StampRole::Start);
        notes.push(
            "What a frame's stamp means is not recorded: the start of its exposure is assumed. `--stamp` \
             states it."
                .into(),
        );
    }
    if declared.transfer.or(about.transfer).is_none() {
        declared.transfer = Some(Transfer::Srgb);
        notes.push(
            "Whether values of frames are linear is not recorded: they are taken to be ordinary pictures \
             (sRGB). `--transfer` states it."
                .into(),
        );
    }
    if settings.row_time.is_none() && about.row_time_ns.is_none() {
        settings.row_time = Some(Duration::new(0));
        notes.push(
            "Whether the shutter is a rolling one is not recorded: exposures are those of row 0. \
             `--row-time` states it."
                .into(),
        );
    }
    settings
}

/// When events and frames begin and end.
fn whole(arranged: &Arranged, path: &Path) -> Result<TimeSpan, Failure> {
    let events = arranged.events.as_ref().ok().and_then(|events| events.span);
    let frames = arranged.frames.as_ref().ok().and_then(|frames| frames.times.span(1));
    events.into_iter().chain(frames).reduce(TimeSpan::union).ok_or_else(|| Failure::Other {
        message: format!("{}: there is neither an event nor a frame in it", path.display()),
        code: 3,
    })
}

/// The same without what a few stray stamps add, unless the user states a stretch.
fn without_strays(
    whole: TimeSpan,
    arranged: &Arranged,
    options: &PlayOptions,
    notes: &mut Vec<String>,
) -> TimeSpan {
    let dense = arranged.scan.as_ref().and_then(|scan| scan.dense_span(SHARE));
    let Some((first, last)) = dense.filter(|_| options.from.is_none() && options.to.is_none()) else {
        return whole;
    };
    let dense = TimeSpan::new(first - arranged.zero_ns, last - arranged.zero_ns + 1);
    let frames = arranged.frames.as_ref().ok().and_then(|frames| frames.times.span(1));
    let span = frames.map_or(dense, |frames| frames.union(dense));
    if whole.length_ns() / TOO_LONG <= span.length_ns() {
        return whole;
    }
    notes.push(format!(
        "The stamps reach from {} to {} ms, and {} % of the events lie from {} to {} ms: that is played. \
         `--from` and `--to` choose another stretch.",
        in_ms(whole.start.0),
        in_ms(whole.end.0),
        100.0 * SHARE,
        in_ms(span.start.0),
        in_ms(span.end.0)
    ));
    span
}

/// How much of a file a cursor has read, 0 to 1.
fn part_of(cursor: &dyn EventCursor) -> f64 {
    let (at, all) = cursor.position();
    at as f64 / all.max(1) as f64
}

/// Packs the events of a stretch.
fn fill(
    packer: &mut Packer,
    arranged: &Arranged,
    recording: &dyn Recording,
    span: TimeSpan,
    advance: impl Fn(f64),
) -> Result<(), Failure> {
    if arranged.drops_duplicates() {
        // Which events are there twice is known in order only.
        let all = arranged.gather(recording, EVENTS_BUDGET, |cursor| {
            advance(part_of(cursor));
            Ok::<(), NodeError>(())
        });
        let failed = |error: NodeError| Failure::other(error.to_string());
        return match all.map_err(failed)? {
            Some((events, _)) => packer.push_all(&events, 0).map_err(failed),
            None => Ok(()),
        };
    }
    let is_ordered = arranged.scan.as_ref().is_some_and(|scan| scan.disordered == 0);
    let mut cursor = recording.events().map_err(|error| refused(&error))?;
    cursor.seek(span.start.0.saturating_add(arranged.zero_ns)).map_err(|error| refused(&error))?;
    let mut chunk = EventChunk::default();
    while cursor.next(&mut chunk).map_err(|error| refused(&error))? {
        for k in 0..chunk.len() {
            packer.push(
                chunk.t[k].saturating_sub(arranged.zero_ns),
                chunk.x[k],
                chunk.y[k],
                chunk.on[k] == 1,
            );
        }
        advance(part_of(&*cursor));
        if is_ordered && chunk.t.last().is_some_and(|t| t.saturating_sub(arranged.zero_ns) >= span.end.0) {
            break;
        }
    }
    Ok(())
}

/// Opens a cached result.
pub fn artefact(path: &Path, options: &PlayOptions) -> Result<Source, Failure> {
    let value = open_value(path)?;
    let kind = value.data_type().name();
    let mut source = named(path);
    source.facts.push(("cached result".into(), format!("of type {kind}")));
    let nothing = || usage(format!("{}: there is nothing in this result to play", path.display()));
    if let Value::Events(events) = &value {
        let whole = events.meta.span.ok_or_else(nothing)?;
        source.span = stretch(options, whole, &source.title)?;
        let mut packer = Packer::new(events.meta.extent, source.span, options.max_size);
        packer.push_all(events, 0).map_err(|error| Failure::other(error.to_string()))?;
        source.events = Some(packer);
        return Ok(source);
    }
    let refusal = || {
        usage(format!(
            "{}: `play` shows events and frames, and this cached result is of type {kind}\n  hint: \
             `photocurrent inspect {0}` shows what it holds",
            path.display()
        ))
    };
    let is_film = ["frames", "truth"].contains(&kind);
    let shown = Shown::of(value).ok_or_else(|| if is_film { nothing() } else { refusal() })?;
    let ends = shown.exposures().iter().map(|one| TimeSpan { start: one.start, end: one.end });
    source.span = stretch(options, ends.reduce(TimeSpan::union).ok_or_else(nothing)?, &source.title)?;
    source.films.extend(Film::within(source.span, "frames".into(), None, shown));
    Ok(source)
}
