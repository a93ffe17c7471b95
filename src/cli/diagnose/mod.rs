//! `photocurrent diagnose`: looks at what it is given ([`given`]), runs the stages as a graph ([`graph`]),
//! puts the report in place and prints its summary.

pub(crate) mod given;
mod graph;

pub use given::Given;

use crate::args::DiagnoseOptions;
use crate::case::{self, Unread};
use crate::failure::{Done, Failure, usage};
use crate::numbers::human_seconds;
use crate::terminal::{print, say};
use photocurrent_diagnosis::diagnose::unreadable_report;
use photocurrent_diagnosis::page::{page, with_names};
use photocurrent_diagnosis::report::{Report, Verdict};
use photocurrent_diagnosis::units::readable;
use photocurrent_diagnosis::unstated::reason_without_source;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;
use tempfile::TempDir;

/// The files of a report, by which a folder of an earlier one is known.
const REPORT: &str = "diagnosis.json";
const SENSOR: &str = "sensor.fitted.toml";
const PAGE: &str = "report.html";

/// The exit code of data that failed a check.
const BROKEN: u8 = 3;

/// Diagnoses a recording and writes the report.
pub fn diagnose(options: &DiagnoseOptions) -> Done {
    let started = Instant::now();
    let given = Given::new(options)?;
    let folder = options.out.clone().unwrap_or_else(|| given.folder.clone());
    check_free(&folder)?;
    if !options.quiet {
        given.notes.iter().for_each(|note| say!("note: {note}"));
    }
    // What is wrong with the input is reported in the words of this command, before the graph begins.
    let sensor = match case::look(&given, options.memory) {
        Ok(sensor) => sensor,
        Err(Unread::Content(why)) => {
            let report = unreadable_report(&why, options.seed);
            let scratch = scratch(&folder)?;
            std::fs::write(scratch.path().join(REPORT), text(&report)?)?;
            std::fs::write(
                scratch.path().join(PAGE),
                with_names(
                    &page(&report, None, None),
                    Some(&graph::file_name(given.path())),
                    given.sensor.as_deref().map(graph::file_name).as_deref(),
                ),
            )?;
            put(scratch.path(), &folder, &scratch)?;
            show(options, &report, &folder, started)?;
            return Ok(BROKEN);
        }
        Err(Unread::Other(failure)) => return Err(failure),
    };
    let scratch = scratch(&folder)?;
    let answered = match graph::run(options, &given, &sensor, scratch.path())? {
        Ok(answered) => answered,
        Err(code) => return Ok(code),
    };
    let report = std::fs::read_to_string(answered.files.join(REPORT))?;
    let report: Report = serde_json::from_str(&report)
        .map_err(|error| Failure::other(format!("the report cannot be read again: {error}")))?;
    put(&answered.files, &folder, &scratch)?;
    answered.warnings.iter().for_each(|why| say!("warning: {why}"));
    let summary = first_line(&report);
    for (node, note) in answered.notes.iter().filter(|(_, note)| *note != summary) {
        if !options.quiet {
            say!("note: {node}: {note}");
        }
    }
    show(options, &report, &folder, started)?;
    Ok(if report.verdict == Verdict::BrokenData { BROKEN } else { 0 })
}

fn text(report: &Report) -> Result<String, Failure> {
    report.to_json().map_err(|why| Failure::other(format!("the report cannot be written as JSON: {why}")))
}

/// Refuses a folder that holds anything but an earlier report.
fn check_free(folder: &Path) -> Result<(), Failure> {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return if folder.exists() {
            Err(usage(format!("{}: this is a file; -o takes a folder", folder.display())))
        } else {
            Ok(())
        };
    };
    let foreign = entries
        .flatten()
        .map(|entry| entry.file_name())
        .find(|name| ![REPORT, SENSOR, PAGE].iter().any(|own| name == *own));
    match foreign {
        Some(name) => {
            let name = name.to_string_lossy();
            Err(usage(format!(
                "{}: the folder holds something else than a report (`{name}`)\n  hint: give a \
                               new folder: -o FOLDER",
                folder.display()
            )))
        }
        None => Ok(()),
    }
}

/// A folder next to the report's, on the same disk, that goes away with what is left in it.
fn scratch(folder: &Path) -> Result<TempDir, Failure> {
    let parent: PathBuf =
        folder.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new(".")).into();
    let failed = |error: std::io::Error| {
        Failure::other(format!("{}: cannot make a folder next to it: {error}", folder.display()))
    };
    std::fs::create_dir_all(&parent).map_err(failed)?;
    tempfile::Builder::new().prefix(".diagnosis-").tempdir_in(&parent).map_err(failed)
}

/// Puts the files of a report that lie in `files` in place of the earlier one, all or none.
fn put(files: &Path, folder: &Path, scratch: &TempDir) -> Result<(), Failure> {
    let failed = |doing: &'static str| {
        move |error: std::io::Error| Failure::other(format!("{}: cannot {doing}: {error}", folder.display()))
    };
    let new = scratch.path().join("new");
    std::fs::create_dir(&new).map_err(failed("make a folder next to it"))?;
    for name in [REPORT, PAGE, SENSOR].into_iter().filter(|name| files.join(name).exists()) {
        std::fs::rename(files.join(name), new.join(name)).map_err(failed("gather the report"))?;
    }
    if folder.exists() {
        std::fs::rename(folder, scratch.path().join("old")).map_err(failed("replace the earlier report"))?;
    }
    std::fs::rename(&new, folder).map_err(failed("put the report in place"))
}

/// The answer on stdout, the talk on stderr.
fn show(options: &DiagnoseOptions, report: &Report, folder: &Path, started: Instant) -> Result<(), Failure> {
    if options.json {
        print(&text(report)?)?;
    } else if !options.quiet {
        print(&summary(report))?;
    }
    if !options.quiet {
        say!("the report is in {} ({})", folder.display(), human_seconds(started.elapsed().as_secs_f64()));
    }
    Ok(())
}

fn first_line(report: &Report) -> String {
    format!("{}: {}", report.verdict.name(), report.summary)
}

fn summary(report: &Report) -> String {
    let mut text = first_line(report) + "\n";
    for effect in &report.effects {
        let _ = writeln!(text, "\n{}\n  {}\n  {}", effect.id, effect.plain, effect.equation);
        for (key, parameter) in &effect.parameters {
            let shown = |value: f64| readable(value, &parameter.unit);
            let interval = parameter
                .ci95
                .map(|[low, high]| format!(" (95 %: {} to {})", shown(low), shown(high)))
                .unwrap_or_default();
            let nominal =
                parameter.nominal.map(|nominal| format!(", nominal {}", shown(nominal))).unwrap_or_default();
            let _ = writeln!(text, "  {key} = {}{interval}{nominal}", shown(parameter.estimate));
        }
        if !effect.also_possible.is_empty() {
            let _ = writeln!(text, "  also possible: {}", effect.also_possible.join(", "));
        }
    }
    for property in &report.scene {
        let _ = writeln!(
            text,
            "\nthe scene: {} at {:.0} Hz, depth {:.2}",
            property.property, property.frequency_hz, property.depth
        );
    }
    for (why, ids) in report
        .not_testable_by_reason()
        .into_iter()
        .filter_map(|(why, ids)| Some((reason_without_source(why)?, ids)))
    {
        let _ = writeln!(text, "\nnot tested: {}\n  {why}", ids.join(", "));
    }
    if let Some(psnr) = report.fit.heldout_frame_psnr_db {
        let _ =
            writeln!(text, "\nheld-out frames: {:.1} dB nominal, {:.1} dB fitted", psnr.before, psnr.after);
    }
    for advice in &report.next_experiment {
        let _ = writeln!(text, "next: {advice}");
    }
    text
}
