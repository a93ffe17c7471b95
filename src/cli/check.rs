//! `photocurrent check`: looks for mistakes in whatever it is given, a manifest with everything it names, a recording, a sensor description, the output of a run.
//!
//! Exit code 0: none found; 2: a manifest or description has mistakes; 3: data have. Every independent mistake is told at once.

use crate::args::CheckOptions;
use crate::common::{Done, Failure, print_count, within_machine};
use crate::file_kind::{FileKind, Reader};
use crate::problems;
use photocurrent_core::document::{Problem, Source};
use photocurrent_core::{Apart, Exposure, FrameTimes, Rows, Sensor, TimeSpan};
use photocurrent_engine::{Plan, Selection};
use photocurrent_formats::hazard::Severity;
use photocurrent_formats::{Declared, EventChunk, Format};
use photocurrent_nodes::{read_effects, spans};
use photocurrent_store::recording::Recording;
use photocurrent_store::{StoreError, open_value};
use std::path::Path;

/// The exit code of data that failed a check.
const BROKEN: u8 = 3;

/// Checks a file by what it is.
pub fn check(options: &CheckOptions) -> Done {
    let path = &options.file;
    let kind = FileKind::of(path);
    if !options.sets.is_empty() && !matches!(kind, FileKind::Manifest | FileKind::Missing) {
        return Err(kind.refuse(path, "check --set", "a manifest"));
    }
    match &kind {
        FileKind::Manifest | FileKind::Missing => check_manifest(options),
        FileKind::Recording(Reader::Ours) => check_recording(path),
        FileKind::Recording(Reader::Format(format)) => check_format(path, format),
        FileKind::Sensor => check_sensor(path),
        FileKind::RunFolder | FileKind::Scores => check_scores(path),
        FileKind::Diagnosis => check_diagnosis(path),
        FileKind::Artefact => {
            let value = open_value(path).map_err(|error| data(error.to_string()))?;
            eprintln!("{}: a cached result of type {}; `photocurrent cache verify` reads all of it", path.display(), value.data_type());
            Ok(0)
        }
        FileKind::Other(_) => Err(kind.refuse(path, "check", "a manifest, a recording, a sensor description or the output folder of a run")),
    }
}

/// A failure of data.
fn data(message: String) -> Failure {
    Failure::Other { message, code: BROKEN }
}

fn check_manifest(options: &CheckOptions) -> Done {
    let catalogue = photocurrent_nodes::catalogue();
    let (_, plan) = Plan::load(&options.file, &options.sets, &catalogue, &Selection::default())?;
    within_machine(&plan)?;
    eprintln!("{}: {} nodes in {} variant(s), no mistake found", options.file.display(), plan.tasks.len(), plan.variants.len());
    Ok(0)
}

/// Mistakes of data, as they are found.
struct Findings<'a> {
    path: &'a Path,
    /// Said in one line each.
    lines: Vec<String>,
    /// In a text inside the file, at their places.
    problems: Vec<Problem>,
}

impl<'a> Findings<'a> {
    fn new(path: &'a Path) -> Findings<'a> {
        Findings { path, lines: Vec::new(), problems: Vec::new() }
    }

    fn add(&mut self, error: StoreError) {
        match error {
            StoreError::Several { mistakes, .. } => self.lines.extend(mistakes.iter().map(ToString::to_string)),
            error => self.lines.push(error.to_string()),
        }
    }

    /// Adds what makes results meaningless, and says how much else there is to know.
    fn hazards(&mut self, format: &'static Format, declared: &Declared) {
        // What cannot be read is told by who reads it for itself.
        let Ok(found) = crate::inspect::hazards(self.path, format, declared) else { return };
        // Clocks apart are told with the offset of the description.
        for one in found.iter().filter(|one| one.severity == Severity::Error && one.id != "no_overlap") {
            self.lines.push(format!("{}: {}: {}\n  hint: {}", self.path.display(), one.message, one.evidence, one.what_to_do));
        }
        let more = found.iter().filter(|one| matches!(one.severity, Severity::Hazard | Severity::Question)).count();
        if more > 0 {
            eprintln!("note: {}: {}; `photocurrent inspect` says which", self.path.display(), print_count(more, "more finding"));
        }
    }

    fn apart(&mut self, apart: &Apart) {
        self.lines.push(format!("{}: {}\n  hint: {}", self.path.display(), apart.message(), apart.hint()));
    }

    /// Tells all of them, or that there is none; `what` was looked at.
    fn finish(self, what: &str) -> Done {
        let count = self.lines.len() + self.problems.len();
        if count == 0 {
            eprintln!("{}: {what}, no mistake found", self.path.display());
            return Ok(0);
        }
        problems::lines(&self.lines);
        problems::render(&self.problems);
        eprintln!("{}: {what}; {}", self.path.display(), print_count(count, "mistake"));
        Ok(BROKEN)
    }
}

/// Reads a whole recording of this project's form: events, frames, description, and whether its clocks agree.
fn check_recording(path: &Path) -> Done {
    let mut findings = Findings::new(path);
    let recording = match Recording::open(path) {
        Ok(recording) => recording,
        Err(error) => {
            findings.add(error);
            return findings.finish("the header was read");
        }
    };
    let sensor = recording.sensor_text().and_then(|text| {
        let source = Source::new(format!("{}:/sensor", path.display()), path.parent().unwrap_or(path), text);
        let (sensor, mistakes) = parse_sensor(&source);
        findings.problems.extend(mistakes);
        sensor
    });
    let row_time_ns = recording.row_time_ns().or(sensor.as_ref().and_then(|sensor| sensor.frames.row_time).map(|row_time| row_time.ns()));
    let frames = recording.frames_meta(row_time_ns.unwrap_or(0)).filter(|frames| !frames.times.is_empty());
    if let (Some(events), Some(frames)) = (recording.events_meta(), &frames)
        && let Err(error) = spans::check_one_clock(events, frames, sensor.as_ref())
    {
        findings.lines.push(format!("{}: {error}", path.display()));
    }
    // The first scan checks every event, whichever rows it is for.
    if let Err(error) = recording.read_events(Rows { start: 0, end: 1 }) {
        findings.add(error);
    }
    if let (Some(frames), Some(source)) = (&frames, recording.frames_source()) {
        // One picture at a time; what cannot be read is told once.
        let broken = (0..frames.times.len()).find_map(|l| source.read(l..l + 1, frames.extent.rows()).err());
        findings.lines.extend(broken.map(|error| error.message));
        if row_time_ns.is_none() {
            eprintln!("note: {}: the row time of the frames is stated nowhere; who reads them must state it (0 is a global shutter)", path.display());
        }
    }
    if let Ok(Some(format)) = photocurrent_formats::recognise(path) {
        findings.hazards(format, &Declared::default());
    }
    let count = recording.exposures().map_or(0, <[_]>::len);
    findings.finish(&format!("{} events, {count} frames", recording.event_count()))
}

/// Reads a whole recording of any format: what was lost, stamps that go back, clocks that do not agree.
fn check_format(path: &Path, format: &'static Format) -> Done {
    let mut findings = Findings::new(path);
    let recording = match (format.open)(path, &Declared::default()) {
        Ok(recording) => recording,
        Err(error) if error.undeclared.is_some() => return Err(Failure::Other { message: error.to_string(), code: 2 }),
        Err(error) => return Err(data(error.to_string())),
    };
    let lost = |at: &str, what: &str| format!("{}: {at}: {what}", path.display());
    findings.lines.extend(recording.losses().iter().map(|loss| lost(&loss.at, &loss.what)));
    let mut seen = Seen::default();
    if recording.events_about().is_some() {
        let mut cursor = recording.events().map_err(|error| data(error.to_string()))?;
        let mut chunk = EventChunk::default();
        while cursor.next(&mut chunk).map_err(|error| data(error.to_string()))? {
            seen.add(&chunk.t);
        }
        findings.lines.extend(cursor.losses().iter().map(|loss| lost(&loss.at, &loss.what)));
    }
    let mut frames = 0;
    if let Some(pictures) = recording.pictures() {
        let about = pictures.about();
        frames = about.stamps.len();
        let mut values = Vec::new();
        findings.lines.extend((0..frames).filter_map(|frame| pictures.read(frame, &mut values).err()).map(|error| error.to_string()));
        let mut exposures: Vec<Exposure> = about
            .stamps
            .iter()
            .map(|stamp| stamp.exposure.unwrap_or((stamp.at, stamp.at)))
            .map(|(start, end)| Exposure::new(start, end.max(start.saturating_add(1))))
            .collect();
        exposures.sort_unstable_by_key(|exposure| exposure.start);
        let times = FrameTimes::new(exposures, 0).map_err(|error| data(error.to_string()))?;
        if let Some(apart) = Apart::of(seen.span, &times, 1) {
            findings.apart(&apart);
        }
    }
    findings.hazards(format, &Declared::default());
    if seen.back > 0 {
        eprintln!("note: {}: {} of {} events are stamped before the one ahead of them; readers sort them", path.display(), seen.back, seen.count);
    }
    findings.finish(&format!("{}: {} events, {frames} frames", format.name, seen.count))
}

/// What went by of an event stream.
#[derive(Default)]
struct Seen {
    count: u64,
    back: u64,
    last: Option<i64>,
    span: Option<TimeSpan>,
}

impl Seen {
    fn add(&mut self, stamps: &[i64]) {
        self.count += stamps.len() as u64;
        for &t in stamps {
            self.back += u64::from(self.last.is_some_and(|last| last > t));
            self.last = Some(t);
        }
        if let (Some(&low), Some(&high)) = (stamps.iter().min(), stamps.iter().max()) {
            let here = TimeSpan::new(low, high.saturating_add(1));
            self.span = Some(self.span.map_or(here, |span| span.union(here)));
        }
    }
}

/// The description, and every mistake in it; its effects are held against the catalogue.
fn parse_sensor(source: &std::sync::Arc<Source>) -> (Option<Sensor>, Vec<Problem>) {
    match Sensor::parse(source) {
        Ok(sensor) => {
            let mistakes = read_effects(&sensor.effects)
                .err()
                .map(|why| Problem::new(format!("{}: {why}", source.name)).help("`photocurrent effects` lists what there is"));
            (Some(sensor), mistakes.into_iter().collect())
        }
        Err(mistakes) => (None, mistakes),
    }
}

fn check_sensor(path: &Path) -> Done {
    let text = std::fs::read_to_string(path).map_err(|error| Failure::Other { message: photocurrent_core::error::cannot_read(path, &error), code: 2 })?;
    let (sensor, mistakes) = parse_sensor(&Source::new(path.display().to_string(), path.parent().unwrap_or(path), text));
    let Some(sensor) = sensor.filter(|_| mistakes.is_empty()) else { return Err(Failure::Problems(mistakes)) };
    let absent = absent(&sensor);
    let unknown =
        if absent.is_empty() { "every field that methods ask for is stated".into() } else { format!("not stated, so unknown: {}", absent.join(", ")) };
    eprintln!("{}: the sensor description \"{}\", no mistake found\n{unknown}", path.display(), sensor.name);
    Ok(0)
}

/// The fields that some method asks for and this description leaves out.
fn absent(sensor: &Sensor) -> Vec<&'static str> {
    let fields = serde_json::to_value(sensor).unwrap_or_default();
    let stated = |path: &str| path.split('.').try_fold(&fields, |value, key| value.get(key)).is_some_and(|value| !value.is_null());
    photocurrent_core::lacking::NEEDED.iter().map(|needed| needed.path).filter(|path| !stated(path)).collect()
}

/// Lines of scores: of a folder that a run wrote, or of one file.
fn check_scores(path: &Path) -> Done {
    let names = ["metrics.jsonl", "metrics.pooled.jsonl", "pooled.jsonl"];
    let files: Vec<_> = if path.is_dir() { names.iter().map(|name| path.join(name)).filter(|file| file.is_file()).collect() } else { vec![path.to_path_buf()] };
    let mut findings = Findings::new(path);
    let mut scores = 0;
    for file in &files {
        let text = std::fs::read_to_string(file).map_err(|error| data(photocurrent_core::error::cannot_read(file, &error)))?;
        for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            let wrong = match serde_json::from_str::<serde_json::Value>(line) {
                Ok(value) => ["variant", "node", "metric"].iter().find(|key| !value[**key].is_string()).map(|key| format!("no `{key}`")),
                Err(error) => Some(format!("no JSON: {error}")),
            };
            scores += 1;
            findings.lines.extend(wrong.map(|wrong| format!("{}:{}: {wrong}", file.display(), number + 1)));
        }
    }
    findings.finish(&format!("the output of a run, {}", print_count(scores, "score")))
}

fn check_diagnosis(path: &Path) -> Done {
    let file = if path.is_dir() { path.join("diagnosis.json") } else { path.to_path_buf() };
    if file.extension().is_some_and(|extension| extension == "html") {
        eprintln!("{}: the page of a diagnosis: open it in a browser", file.display());
        return Ok(0);
    }
    let text = std::fs::read_to_string(&file).map_err(|error| data(photocurrent_core::error::cannot_read(&file, &error)))?;
    let report: photocurrent_diagnosis::report::Report =
        serde_json::from_str(&text).map_err(|error| data(format!("{}: this is no diagnosis: {error}", file.display())))?;
    eprintln!("{}: a diagnosis, no mistake found\n{}: {}", file.display(), report.verdict.name(), report.summary);
    Ok(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_went_by_is_counted_across_pieces() {
        let mut seen = Seen::default();
        seen.add(&[5, 9, 7]);
        seen.add(&[]);
        seen.add(&[6, 20]);
        assert_eq!((seen.count, seen.back, seen.span), (5, 2, Some(TimeSpan::new(5, 21))));
    }

    #[test]
    fn what_a_description_leaves_out_is_named() {
        let text = "format = \"photocurrent-sensor/1\"\n[frames]\ngain = 3.0\nrow_time = \"0 us\"\n";
        let (sensor, mistakes) = parse_sensor(&Source::new("s.toml", "", text));
        let absent = absent(&sensor.unwrap());
        assert!(
            mistakes.is_empty() && absent.contains(&"front_end.tau_0") && !absent.contains(&"frames.gain") && !absent.contains(&"frames.row_time"),
            "{absent:?}"
        );
    }
}
