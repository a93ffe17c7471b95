//! `photocurrent check`: looks for mistakes in whatever it is given, a manifest with everything it names, a
//! recording, a sensor description, the output of a run.
//!
//! Exit code 0: none found; 2: a manifest or description has mistakes; 3: data have. Every independent
//! mistake is reported at once.

use crate::args::CheckOptions;
use crate::declared::refused;
use crate::failure::{Done, Failure, usage};
use crate::file_kind::{FileKind, Reader};
use crate::inspect::{Seen, look};
use crate::numbers::print_count;
use crate::parts::Parts;
use crate::problems;
use crate::terminal::{print_json, say};
use photocurrent_core::document::{Problem, Source};
use photocurrent_core::{Rows, Sensor};
use photocurrent_engine::{Plan, Selection};
use photocurrent_formats::hazard::Severity;
use photocurrent_formats::{Declared, Format, recognise};
use photocurrent_nodes::{read_effects, spans};
use photocurrent_store::recording::Recording;
use photocurrent_store::{StoreError, open_value};
use serde_json::json;
use std::path::{Path, PathBuf};

/// The exit code of data that failed a check.
const BROKEN: u8 = 3;

/// Checks a file by what it is, and reports for people or for programs.
pub fn check(options: &CheckOptions) -> Done {
    let path = &options.files[0];
    match look_at(options) {
        Ok(found) if options.json => found.print_json(),
        Ok(found) => found.show(),
        Err(Failure::Problems(problems)) if options.json => {
            Findings { problems, code: 2, ..Findings::new(path) }.print_json()
        }
        Err(Failure::Other { message, code }) if options.json => {
            Findings { lines: vec![message], code, ..Findings::new(path) }.print_json()
        }
        Err(failure) => Err(failure),
    }
}

fn look_at(options: &CheckOptions) -> Result<Findings, Failure> {
    let path = &options.files[0];
    if options.files.len() > 1 {
        return check_together(options);
    }
    let kind = FileKind::of(path);
    if !options.sets.is_empty() && !matches!(kind, FileKind::Manifest | FileKind::Missing) {
        return Err(kind.refuse(path, "check --set", "a manifest"));
    }
    match &kind {
        FileKind::Manifest | FileKind::Missing => check_manifest(options),
        FileKind::Recording(Reader::Ours) => check_recording(options),
        FileKind::Recording(Reader::Format(format)) => {
            check_format(path, format, &options.declared.declared())
        }
        FileKind::Sensor => check_sensor(path),
        FileKind::RunFolder | FileKind::Scores => check_scores(path),
        FileKind::Diagnosis => check_diagnosis(path),
        FileKind::Artefact => {
            let value = open_value(path).map_err(|error| data(error.to_string()))?;
            Ok(Findings::new(path).of(format!(
                "the header of a cached result of type {} (`photocurrent cache verify` reads all of it)",
                value.data_type()
            )))
        }
        FileKind::Instead(_) | FileKind::Other(_) => Err(kind.refuse(
            path,
            "check",
            "a manifest, a recording, a sensor description or the output folder of a run",
        )),
    }
}

/// A failure of data.
fn data(message: String) -> Failure {
    Failure::Other { message, code: BROKEN }
}

fn check_manifest(options: &CheckOptions) -> Result<Findings, Failure> {
    let catalogue = photocurrent_nodes::catalogue();
    let selection = Selection { memory: options.memory, ..Selection::default() };
    let (_, plan) = Plan::load(&options.files[0], &options.sets, &catalogue, &selection)?;
    Ok(Findings::new(&options.files[0]).of(format!(
        "{} nodes in {} variant(s)",
        plan.tasks.len(),
        plan.variants.len()
    )))
}

/// What a check found: mistakes, and what is only suspicious or worth knowing.
struct Findings {
    path: PathBuf,
    /// What was looked at.
    what: String,
    /// Suspicious, but data may be like this.
    hazards: Vec<String>,
    notes: Vec<String>,
    /// Mistakes that are said in one line each.
    lines: Vec<String>,
    /// Mistakes in a text, at their places.
    problems: Vec<Problem>,
    /// The exit code where there are mistakes.
    code: u8,
}

impl Findings {
    fn new(path: &Path) -> Findings {
        Findings {
            path: path.to_path_buf(),
            what: String::new(),
            hazards: Vec::new(),
            notes: Vec::new(),
            lines: Vec::new(),
            problems: Vec::new(),
            code: BROKEN,
        }
    }

    /// States what was looked at.
    fn of(self, what: impl Into<String>) -> Findings {
        Findings { what: what.into(), ..self }
    }

    fn add(&mut self, error: StoreError) {
        match error {
            StoreError::Several { mistakes, .. } => {
                self.lines.extend(mistakes.iter().map(ToString::to_string))
            }
            error => self.lines.push(error.to_string()),
        }
    }

    /// Takes what makes data meaningless as a mistake, and notes the rest that is suspicious.
    fn judge(&mut self, seen: &Seen) {
        for finding in &seen.findings {
            let text = format!(
                "{}: {} ({})\n  hint: {}",
                self.path.display(),
                finding.message,
                finding.evidence,
                finding.what_to_do
            );
            match finding.severity {
                Severity::Error => self.lines.push(text),
                Severity::Hazard => self.hazards.push(text),
                Severity::Question | Severity::Fact => {}
            }
        }
    }

    fn mistakes(&self) -> usize {
        self.lines.len() + self.problems.len()
    }

    fn exit_code(&self) -> u8 {
        if self.mistakes() == 0 { 0 } else { self.code }
    }

    /// Reports all of it on stderr.
    fn show(&self) -> Done {
        self.hazards.iter().for_each(|text| say!("hazard: {text}"));
        self.notes.iter().for_each(|text| say!("note: {}: {text}", self.path.display()));
        problems::lines(&self.lines);
        problems::render(&self.problems);
        match self.mistakes() {
            0 => say!("{}: {}, no mistake found", self.path.display(), self.what),
            count => say!("{}: {}; {}", self.path.display(), self.what, print_count(count, "mistake")),
        }
        Ok(self.exit_code())
    }

    /// Prints all of it on stdout, `photocurrent-check/1`.
    fn print_json(&self) -> Done {
        let place = |problem: &Problem| {
            let place = problem.at.as_ref().map(|at| (at.source.name.clone(), at.line_column()));
            json!({
                "message": problem.message, "notes": problem.notes, "help": problem.help,
                "file": place.as_ref().map(|(file, _)| file),
                "line": place.as_ref().map(|(_, (line, _))| line),
                "column": place.as_ref().map(|(_, (_, column))| column),
            })
        };
        let mistakes =
            self.lines.iter().map(|line| json!({"message": line})).chain(self.problems.iter().map(place));
        print_json(&json!({
            "schema": "photocurrent-check/1", "file": self.path.display().to_string(), "checked": self.what,
            "mistakes": mistakes.collect::<Vec<_>>(),
            "hazards": self.hazards, "notes": self.notes, "exit_code": self.exit_code(),
        }))?;
        Ok(self.exit_code())
    }
}

/// Reads a whole recording of this project's form: events, frames, description, and whether its clocks agree.
fn check_recording(options: &CheckOptions) -> Result<Findings, Failure> {
    let path = &options.files[0];
    let mut findings = Findings::new(path);
    let recording = match Recording::open(path) {
        Ok(recording) => recording,
        Err(error) => {
            findings.add(error);
            return Ok(findings.of("the header was read"));
        }
    };
    let sensor = recording.sensor_text().and_then(|text| {
        let source = Source::new(format!("{}:/sensor", path.display()), path.parent().unwrap_or(path), text);
        let (sensor, mistakes) = parse_sensor(&source);
        findings.problems.extend(mistakes);
        sensor
    });
    let row_time_ns = recording
        .row_time_ns()
        .or(sensor.as_ref().and_then(|sensor| sensor.frames.row_time).map(|row_time| row_time.ns()));
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
        // One picture at a time; what cannot be read is reported once.
        let broken = (0..frames.times.len()).find_map(|l| source.read(l..l + 1, frames.extent.rows()).err());
        findings.lines.extend(broken.map(|error| error.message));
        if row_time_ns.is_none() {
            findings.notes.push(
                "the row time of the frames is stated nowhere; who reads them must state it \
                                 (0 is a global shutter)"
                    .into(),
            );
        }
    }
    // The judge of every format, once the form is right.
    if findings.lines.is_empty()
        && let Ok(Some(format)) = recognise(path)
    {
        findings
            .judge(&look(path, format, &options.declared.declared(), true).map_err(|error| refused(&error))?);
    }
    let count = recording.exposures().map_or(0, <[_]>::len);
    Ok(findings.of(format!("{} events, {count} frames", recording.event_count())))
}

/// Events and frames that lie in several files.
fn check_together(options: &CheckOptions) -> Result<Findings, Failure> {
    let names = || options.files.iter().map(|file| file.display().to_string()).collect::<Vec<_>>().join(", ");
    let Some(parts) = Parts::one_recording(&options.files).filter(|_| options.sets.is_empty()) else {
        let hint = "hint: name one file, or a file of events with its frames (and their stamps)";
        return Err(usage(format!(
            "{}: `check` takes one manifest, recording or description, and these are \
                                  not one recording\n  {hint}",
            names()
        )));
    };
    check_format(&parts.recording, parts.format, &parts.declared(&options.declared.declared()))
}

/// Reads a whole recording of any format: what was lost, and what makes its data meaningless; what is only
/// suspicious is noted.
fn check_format(path: &Path, format: &'static Format, declared: &Declared) -> Result<Findings, Failure> {
    let mut findings = Findings::new(path);
    let seen = look(path, format, declared, true).map_err(|error| refused(&error))?;
    findings.lines.extend(
        seen.survey.losses.iter().map(|loss| format!("{}: {}: {}", path.display(), loss.at, loss.what)),
    );
    findings.judge(&seen);
    Ok(findings.of(format.name))
}

/// The description, and every mistake in it; its effects are held against the catalogue.
fn parse_sensor(source: &std::sync::Arc<Source>) -> (Option<Sensor>, Vec<Problem>) {
    match Sensor::parse(source) {
        Ok(sensor) => {
            let mistakes = read_effects(&sensor.effects).err().map(|why| {
                Problem::new(format!("{}: {why}", source.name))
                    .help("`photocurrent effects` lists what there is")
            });
            (Some(sensor), mistakes.into_iter().collect())
        }
        Err(mistakes) => (None, mistakes),
    }
}

fn check_sensor(path: &Path) -> Result<Findings, Failure> {
    let text = std::fs::read_to_string(path).map_err(|error| Failure::Other {
        message: photocurrent_core::error::cannot_read(path, &error),
        code: 2,
    })?;
    let (sensor, mistakes) =
        parse_sensor(&Source::new(path.display().to_string(), path.parent().unwrap_or(path), text));
    let Some(sensor) = sensor.filter(|_| mistakes.is_empty()) else {
        return Err(Failure::Problems(mistakes));
    };
    let absent = absent(&sensor);
    let unknown = if absent.is_empty() {
        "every field that methods ask for is stated".into()
    } else {
        format!("not stated, so unknown: {}", absent.join(", "))
    };
    Ok(Findings {
        notes: vec![unknown],
        ..Findings::new(path).of(format!("the sensor description \"{}\"", sensor.name))
    })
}

/// The fields that some method asks for and this description leaves out.
fn absent(sensor: &Sensor) -> Vec<&'static str> {
    let fields = serde_json::to_value(sensor).unwrap_or_default();
    let stated = |path: &str| {
        path.split('.').try_fold(&fields, |value, key| value.get(key)).is_some_and(|value| !value.is_null())
    };
    photocurrent_core::lacking::NEEDED.iter().map(|needed| needed.path).filter(|path| !stated(path)).collect()
}

/// Lines of scores: of a folder that a run wrote, or of one file.
fn check_scores(path: &Path) -> Result<Findings, Failure> {
    let names = ["metrics.jsonl", "metrics.pooled.jsonl", "pooled.jsonl"];
    let files: Vec<_> = if path.is_dir() {
        names.iter().map(|name| path.join(name)).filter(|file| file.is_file()).collect()
    } else {
        vec![path.to_path_buf()]
    };
    let mut findings = Findings::new(path);
    let mut scores = 0;
    for file in &files {
        let text = std::fs::read_to_string(file)
            .map_err(|error| data(photocurrent_core::error::cannot_read(file, &error)))?;
        for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            let wrong = match serde_json::from_str::<serde_json::Value>(line) {
                // What was not measured has no metric, and says what is missing.
                Ok(value) if value["missing"].is_string() => None,
                Ok(value) => ["variant", "node", "metric"]
                    .iter()
                    .find(|key| !value[**key].is_string())
                    .map(|key| format!("no `{key}`")),
                Err(error) => Some(format!("no JSON: {error}")),
            };
            scores += 1;
            findings.lines.extend(wrong.map(|wrong| format!("{}:{}: {wrong}", file.display(), number + 1)));
        }
    }
    Ok(findings.of(format!("the output of a run, {}", print_count(scores, "score"))))
}

fn check_diagnosis(path: &Path) -> Result<Findings, Failure> {
    let file = if path.is_dir() { path.join("diagnosis.json") } else { path.to_path_buf() };
    if file.extension().is_some_and(|extension| extension == "html") {
        return Ok(Findings::new(&file)
            .of("the page of a diagnosis (open it in a browser; its numbers are \
                                           in diagnosis.json next to it)"));
    }
    let text = std::fs::read_to_string(&file)
        .map_err(|error| data(photocurrent_core::error::cannot_read(&file, &error)))?;
    let report: photocurrent_diagnosis::report::Report = serde_json::from_str(&text)
        .map_err(|error| data(format!("{}: this is no diagnosis: {error}", file.display())))?;
    Ok(Findings {
        notes: vec![format!("{}: {}", report.verdict.name(), report.summary)],
        ..Findings::new(&file).of("a diagnosis")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_description_leaves_out_is_named() {
        let text = "format = \"photocurrent-sensor/1\"\n[frames]\ngain = 3.0\nrow_time = \"0 us\"\n";
        let (sensor, mistakes) = parse_sensor(&Source::new("s.toml", "", text));
        let absent = absent(&sensor.unwrap());
        assert!(
            mistakes.is_empty()
                && absent.contains(&"front_end.tau_0")
                && !absent.contains(&"frames.gain")
                && !absent.contains(&"frames.row_time"),
            "{absent:?}"
        );
    }
}
