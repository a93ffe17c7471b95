//! `photocurrent inspect`: what recordings hold, and what is wrong with them or not known.
//!
//! Files are recognised by their content. A recording of any format is read once
//! ([`photocurrent_formats::survey`]) and judged ([`photocurrent_formats::hazard`]); events and frames that
//! lie in several files are one recording; a cached artefact says what it is. Hazards do not fail the
//! command: exit code 0 when files are readable, 3 when one is damaged (what is whole is reported), 2 when
//! one is none of ours.

mod screen;

use crate::args::InspectOptions;
use crate::declared::refused;
use crate::failure::{Done, Failure};
use crate::file_kind::need_data;
use crate::parts::Parts;
use crate::terminal::{is_terminal, print, print_json, say};
use indicatif::{ProgressBar, ProgressStyle};
use photocurrent_core::Value;
use photocurrent_formats::hazard::{self, Finding, Limits};
use photocurrent_formats::instead::what_it_is;
use photocurrent_formats::survey::{Most, Survey, survey};
use photocurrent_formats::{Declared, Format, FormatError, Probe, joined, recognise};
use photocurrent_store::open_value;
use serde_json::json;
use std::path::{Path, PathBuf};

/// The exit code of damaged data.
const DAMAGED: u8 = 3;
/// The version of what `--json` prints.
const SCHEMA: &str = "photocurrent-inspect/1";

/// A recording that was read once.
pub struct Seen {
    pub format: &'static Format,
    pub bytes: u64,
    pub survey: Survey,
    pub findings: Vec<Finding>,
}

/// Shows what files hold.
pub fn inspect(options: &InspectOptions) -> Done {
    let declared = options.declared.declared();
    let (mut code, mut texts, mut objects) = (0, Vec::new(), Vec::new());
    let mut alone = options.files.as_slice();
    if let Some(parts) = Parts::one_recording(&options.files) {
        match together(&parts, &options.files, &declared, options.json) {
            Ok((text, object, of_files)) => {
                texts.push(text);
                objects.push(object);
                (code, alone) = (of_files, &[]);
            }
            Err(Failure::Other { message, code: of_files }) => {
                say!("error: events and frames cannot be held together: {message}");
                code = of_files;
            }
            Err(failure) => return Err(failure),
        }
    }
    for path in alone {
        match one(path, &declared, options.json) {
            Ok((text, object, of_file)) => {
                texts.push(text);
                objects.push(object);
                code = code.max(of_file);
            }
            // One file is reported as it is; of several, the others are reported all the same.
            Err(failure) if options.files.len() == 1 => return Err(failure),
            Err(Failure::Other { message, code: of_file }) => {
                say!("error: {message}");
                objects.push(json!({"file": path.display().to_string(), "error": message}));
                code = code.max(of_file);
            }
            Err(failure) => return Err(failure),
        }
    }
    if options.json {
        print_json(&json!({"schema": SCHEMA, "files": objects}))?;
    } else {
        print(&texts.join("\n"))?;
    }
    Ok(code)
}

/// Text, JSON and exit code of one file.
fn one(path: &Path, declared: &Declared, quiet: bool) -> Result<(String, serde_json::Value, u8), Failure> {
    need_data(path, "inspect")?;
    let file = path.display().to_string();
    let wrong = |error: FormatError| {
        if path.exists() { refused(&error) } else { Failure::Other { message: error.to_string(), code: 2 } }
    };
    let Some(format) = recognise(path).map_err(wrong)? else {
        let value = open_value(path).map_err(|_| unknown(path))?;
        let (text, object) = artefact(&value, &file)?;
        return Ok((text, object, 0));
    };
    shown(file, look(path, format, declared, quiet).map_err(|error| refused(&error))?)
}

/// Text, JSON and exit code of events and frames that lie in several files.
fn together(
    parts: &Parts,
    files: &[PathBuf],
    declared: &Declared,
    quiet: bool,
) -> Result<(String, serde_json::Value, u8), Failure> {
    let names: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
    shown(
        names.join(" + "),
        look(&parts.recording, parts.format, &parts.declared(declared), quiet)
            .map_err(|error| refused(&error))?,
    )
}

/// Text, JSON and exit code of what was read.
fn shown(file: String, seen: Seen) -> Result<(String, serde_json::Value, u8), Failure> {
    let text = screen::screen(&file, seen.format.name, seen.bytes, &seen.survey, &seen.findings);
    let to_json = |value: Result<serde_json::Value, serde_json::Error>| {
        value.map_err(|error| Failure::other(error.to_string()))
    };
    let object = json!({
        "file": file,
        "format": seen.format.id,
        "format_name": seen.format.name,
        "bytes": seen.bytes,
        "survey": to_json(serde_json::to_value(&seen.survey))?,
        "findings": to_json(serde_json::to_value(&seen.findings))?,
    });
    Ok((text, object, if seen.survey.losses.is_empty() { 0 } else { DAMAGED }))
}

/// Reads a recording once and judges it; `quiet` draws no bar.
pub fn look(
    path: &Path,
    format: &'static Format,
    declared: &Declared,
    quiet: bool,
) -> Result<Seen, FormatError> {
    let recording = joined::open(format, path, declared)?;
    let bytes = recording
        .files()
        .iter()
        .filter_map(|file| std::fs::metadata(file).ok())
        .map(|metadata| metadata.len())
        .sum();
    let bar = reading_bar(quiet);
    let survey = survey(&*recording, format.id, &Most::default(), |part| {
        if let Some(bar) = &bar {
            bar.set_position((part * 1000.0) as u64);
        }
    })?;
    if let Some(bar) = bar {
        bar.finish_and_clear();
    }
    let findings = hazard::findings(&survey, &Limits::default());
    Ok(Seen { format, bytes, survey, findings })
}

/// A bar of a thousand parts for a file that is read, where a person sits at a terminal and wants one.
pub fn reading_bar(quiet: bool) -> Option<ProgressBar> {
    let bar = (!quiet && is_terminal()).then(|| ProgressBar::new(1000))?;
    bar.set_style(
        ProgressStyle::with_template("reading {wide_bar} {eta}")
            .unwrap_or_else(|_| ProgressStyle::default_bar()),
    );
    Some(bar)
}

/// What to say of a file that is none of ours.
pub fn unknown(path: &Path) -> Failure {
    if let Some(instead) = Probe::new(path).ok().and_then(|probe| what_it_is(&probe)) {
        return Failure::Other { message: instead.refusal(path).to_string(), code: 2 };
    }
    let names: Vec<&str> = photocurrent_formats::FORMATS.iter().map(|format| format.name).collect();
    let hint = format!("known are {}; and cached artefacts (.h5)", names.join(", "));
    Failure::Other {
        message: format!("{}: this is no recording of a known format\n  hint: {hint}", path.display()),
        code: 2,
    }
}

/// Text and JSON of a cached artefact.
fn artefact(value: &Value, file: &str) -> Result<(String, serde_json::Value), Failure> {
    let meta = serde_json::to_value(value.meta()).map_err(|error| Failure::other(error.to_string()))?;
    let object = json!({"file": file, "type": value.data_type().name(), "meta": meta});
    let mut text = format!("artefact of type {}\n", value.data_type());
    if let Value::Table(table) = value {
        let mut rows = vec![table.columns().iter().map(|(name, _)| name.clone()).collect()];
        rows.extend(
            (0..table.len()).map(|row| table.columns().iter().map(|(_, column)| column.cell(row)).collect()),
        );
        text.push_str(&crate::tables::draw(&rows));
        table.notes.iter().for_each(|(name, note)| text.push_str(&format!("{name}: {note}\n")));
    } else if let Value::Diagnosis(document) = value {
        text.push_str(document.text());
    } else {
        text.push_str(
            &serde_json::to_string_pretty(&meta).map_err(|error| Failure::other(error.to_string()))?,
        );
    }
    Ok((text, object))
}
