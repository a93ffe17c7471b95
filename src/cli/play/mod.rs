//! `photocurrent play`: one page of HTML that plays a recording, or what a run made of one: events, captured
//! frames and reconstructed ones side by side in time. Nothing is run, nothing calculated.
//!
//! [`file`] opens a recording or a cached result, [`run`] what a run left in its folder and its cache, and
//! both give a [`source::Source`]; [`films`] picks and encodes pictures. Events are packed by
//! `photocurrent-nodes`. The page itself is that of `photocurrent-page`.

mod file;
mod films;
pub mod options;
mod run;
mod source;

use crate::failure::{Done, Failure, usage, write_whole};
use crate::file_kind::FileKind;
use crate::numbers::{grouped, human_bytes, in_ms};
use crate::terminal::{print, say};
use films::{Films, in_binary, in_text};
use options::PlayOptions;
use photocurrent_core::TimeSpan;
use photocurrent_core::quantity::Duration;
use photocurrent_nodes::show::Packed;
use photocurrent_page::{PlayPage, PlayedEvents};
use source::Source;

/// Room for everything but pictures and events, bytes.
const REST: u64 = 80_000;
/// So often the page is made smaller.
const TRIES: usize = 5;
/// The exit code of damaged data, as that of `inspect`.
const DAMAGED: u8 = 3;

/// Writes the page and prints its path.
pub fn play(options: &PlayOptions) -> Done {
    if let (Some(from), Some(to)) = (options.from, options.to)
        && to <= from
    {
        return Err(usage(format!(
            "--from {from} --to {to}: the stretch ends before it begins\n  hint: make --to later than --from"
        )));
    }
    let mut source = match &options.files[..] {
        [one] => match FileKind::of(one) {
            FileKind::Manifest | FileKind::RunFolder => run::source(one, options)?,
            FileKind::Artefact => file::artefact(one, options)?,
            kind @ (FileKind::Sensor | FileKind::Diagnosis | FileKind::Scores) => {
                return Err(kind.refuse(one, "play", "a recording, a manifest that was run, or its folder"));
            }
            _ => file::recording(&options.files, options)?,
        },
        files => file::recording(files, options)?,
    };
    let html = fitting(&mut source, options.max_size)?;
    let output = options.output.clone().unwrap_or_else(|| source.folder.join("play.html"));
    write_whole(&output, html.as_bytes())?;
    if !options.quiet {
        source.notes.iter().for_each(|note| say!("note: {}", note.replace('`', "")));
        say!("{} in one file; open it in a browser", human_bytes(html.len() as u64));
    }
    print(&output.display().to_string())?;
    Ok(if source.is_damaged { DAMAGED } else { 0 })
}

/// The page within `most` bytes; what was left out for that is added to the notes.
fn fitting(source: &mut Source, most: u64) -> Result<String, Failure> {
    let mut budget = most.saturating_sub(REST);
    let notes = source.notes.clone();
    let mut packed = source.events.as_mut().map(|packer| packer.pack(in_binary(budget)));
    let films = Films::of(&source.films, source.sensor.as_deref())?;
    for _ in 0..TRIES {
        source.notes.clone_from(&notes);
        let of_events = packed.as_ref().map_or(0, |packed| in_text(packed.bytes()));
        let of_pictures = films.as_ref().map_or(0, |films| films.bytes());
        // Whoever needs less than half leaves the rest to the other.
        let share = match (of_events <= budget / 2, of_pictures <= budget / 2) {
            (true, _) => of_events,
            (false, true) => budget - of_pictures,
            (false, false) => budget / 2,
        };
        if let Some(packer) = source.events.as_mut().filter(|_| of_events > share) {
            packed = Some(packer.pack(in_binary(share)));
        }
        let is_empty = packed.as_ref().is_some_and(|packed| packed.kept == 0 && packed.on + packed.off > 0);
        if is_empty {
            break;
        }
        let page = page(source, packed.as_ref(), films.as_ref(), budget.saturating_sub(share))?;
        let html = page.html();
        let over = (html.len() as u64).saturating_sub(most);
        if over == 0 {
            source.notes.clone_from(&page.notes);
            return Ok(html);
        }
        budget = budget.saturating_sub(over + over / 10 + 1000);
    }
    let hint = "hint: give more, such as --max-size 25MB, or a shorter stretch with --from and --to";
    Err(usage(format!("the page cannot be made as small as {}\n  {hint}", human_bytes(most))))
}

fn page(
    source: &Source,
    packed: Option<&Packed>,
    films: Option<&Films>,
    of_pictures: u64,
) -> Result<PlayPage, Failure> {
    let mut page = PlayPage {
        title: source.title.clone(),
        facts: source.facts.clone(),
        from_ns: source.span.start.0,
        to_ns: source.span.end.0,
        notes: source.notes.clone(),
        ..PlayPage::default()
    };
    let (start, end) = (in_ms(source.span.start.0), in_ms(source.span.end.0));
    page.facts.push(("time".into(), format!("{start} to {end} ms")));
    if let Some(packed) = packed {
        about(packed, source.span, &mut page);
        page.events = Some(PlayedEvents {
            width: packed.width,
            height: packed.height,
            start_ns: packed.start_ns,
            slice_ns: packed.slice_ns,
            slices: packed.slices,
            share: packed.kept as f64 / (packed.on + packed.off).max(1) as f64,
            on_counts: packed.on_counts.clone(),
            off_counts: packed.off_counts.clone(),
            lengths: packed.lengths.clone(),
            places: packed.places.clone(),
        });
    }
    if let Some(films) = films {
        films.encode(of_pictures, &mut page)?;
    }
    let is_best = |label: &str| Some(label) == source.best.as_deref();
    let longest = page.films.iter().filter(|film| film.kind == "method").map(|film| film.frames.len()).max();
    let is_first =
        |film: &photocurrent_page::PlayedFilm| film.kind == "method" && Some(film.frames.len()) == longest;
    page.first = source
        .films
        .iter()
        .zip(&page.films)
        .position(|(film, played)| is_best(&film.label) && is_first(played))
        .or_else(|| page.films.iter().rposition(is_first))
        .unwrap_or(0);
    Ok(page)
}

/// What is stated of the events.
fn about(packed: &Packed, span: TimeSpan, page: &mut PlayPage) {
    let all = packed.on + packed.off;
    let slice = Duration::new(packed.slice_ns);
    page.facts.push((
        "events".into(),
        format!(
            "{}: {} ON, {} OFF; {} a second; {} x {} pixels",
            grouped(all),
            grouped(packed.on),
            grouped(packed.off),
            grouped((all as f64 / (span.length_ns().max(1) as f64 * 1e-9)).round() as u64),
            packed.width,
            packed.height
        ),
    ));
    page.facts.push(("times of events".into(), format!("kept to {slice}, the smallest step of the slider")));
    if packed.kept < all {
        page.notes.push(format!(
            "{} of {} events are drawn, chosen at random; counts and rates are those of all. `--max-size` \
             allows more, `--from` and `--to` choose a shorter stretch.",
            grouped(packed.kept),
            grouped(all)
        ));
    }
    if packed.outside > 0 {
        page.notes.push(format!(
            "{} events lie outside of the {} x {} pixels and are left out of everything.",
            grouped(packed.outside),
            packed.width,
            packed.height
        ));
    }
}
