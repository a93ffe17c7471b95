//! `photocurrent diagnose`.

use crate::args::DiagnoseOptions;
use crate::case::{self, Unread, usage};
use crate::common::{Done, Failure, human_seconds, print};
use indicatif::{ProgressBar, ProgressStyle};
use photocurrent_core::Sensor;
use photocurrent_diagnosis::diagnose::{Diagnosis, Setting, broken};
use photocurrent_diagnosis::fitted::with_findings;
use photocurrent_diagnosis::knowledge::Knowledge;
use photocurrent_diagnosis::page::page;
use photocurrent_diagnosis::report::{Report, Verdict, short};
use std::fmt::Write;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The files of a report, by which a folder of an earlier one is known.
const REPORT: &str = "diagnosis.json";
const SENSOR: &str = "sensor.fitted.toml";
const PAGE: &str = "report.html";

/// The exit code of data that failed a check.
const BROKEN: u8 = 3;

/// Diagnoses a recording and writes the report.
pub fn diagnose(options: &DiagnoseOptions) -> Done {
    let started = Instant::now();
    let folder = options.out.clone().unwrap_or_else(|| Path::new("out").join(options.recording.file_stem().unwrap_or_default()));
    check_free(&folder)?;
    let knowledge = knowledge(options)?;
    if let Some(threads) = options.threads {
        // It can only fail when something made the pool before us, and then that one works as well.
        let _ = rayon::ThreadPoolBuilder::new().num_threads(threads as usize).build_global();
    }
    let bar = bar(options.quiet);
    bar.set_message("reading the recording");
    let case = match case::read(&options.recording, options.sensor.as_deref(), options.quiet) {
        Ok(case) => case,
        Err(Unread::Content(why)) => {
            bar.finish_and_clear();
            let report = broken(&why, options.seed);
            write(&folder, &[(REPORT, text(&report)?), (PAGE, page(&report, None, None))])?;
            show(options, &report, &[], &folder, started)?;
            return Ok(BROKEN);
        }
        Err(Unread::Other(failure)) => return Err(failure),
    };
    let setting = Setting { seed: options.seed, ..Setting::default() };
    let roads = if options.direct { Vec::new() } else { photocurrent_diagnosis::roads::all(knowledge) };
    let found = photocurrent_diagnosis::diagnose::diagnose(&case, &setting, &roads, |stage| bar.set_message(stage.to_owned()));
    bar.finish_and_clear();
    let found = found.map_err(|error| Failure::Other { message: format!("{}: {error}", options.recording.display()), code: 2 })?;
    let mut files = vec![(REPORT, text(&found.report)?), (PAGE, page(&found.report, Some(&case), Some(&found)))];
    if let Some(fitted) = &found.fitted {
        files.push((SENSOR, fitted_text(fitted, &found)));
    }
    write(&folder, &files)?;
    show(options, &found.report, &found.failed, &folder, started)?;
    Ok(if found.report.verdict == Verdict::BrokenData { BROKEN } else { 0 })
}

fn text(report: &Report) -> Result<String, Failure> {
    report.to_json().map_err(|why| Failure::other(format!("the report cannot be written as JSON: {why}")))
}

/// What says on a terminal how far we are.
fn bar(quiet: bool) -> ProgressBar {
    if quiet || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new_spinner();
    bar.set_style(ProgressStyle::with_template("{spinner} {msg} {elapsed}").unwrap_or_else(|_| ProgressStyle::default_spinner()));
    bar.enable_steady_tick(std::time::Duration::from_millis(120));
    bar
}

/// What synthesis knows beforehand: the file that is named, or what is built in.
fn knowledge(options: &DiagnoseOptions) -> Result<Option<Knowledge>, Failure> {
    let Some(path) = &options.knowledge else { return Knowledge::shipped().map(Some).map_err(|why| usage(format!("the knowledge that is built in: {why}"))) };
    let bytes = std::fs::read(path).map_err(|error| usage(format!("{}: cannot read the knowledge: {error}", path.display())))?;
    Knowledge::from_bytes(&bytes).map(Some).map_err(|why| usage(format!("{}: this is no knowledge of the diagnosis: {why}", path.display())))
}

/// The fitted description with a word on where it comes from.
fn fitted_text(sensor: &Sensor, found: &Diagnosis) -> String {
    let claims: Vec<_> = found.report.effects.iter().map(|effect| (effect.id.clone(), effect.also_possible.clone())).collect();
    with_findings(sensor, &claims)
}

/// Refuses a folder that holds anything but an earlier report.
fn check_free(folder: &Path) -> Result<(), Failure> {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return if folder.exists() { Err(usage(format!("{}: this is a file; -o takes a folder", folder.display()))) } else { Ok(()) };
    };
    let foreign = entries.flatten().map(|entry| entry.file_name()).find(|name| ![REPORT, SENSOR, PAGE].iter().any(|own| name == *own));
    match foreign {
        Some(name) => {
            let name = name.to_string_lossy();
            Err(usage(format!("{}: the folder holds something else than a report (`{name}`)\n  hint: give a new folder: -o FOLDER", folder.display())))
        }
        None => Ok(()),
    }
}

/// Writes all files or none: into a folder beside, which then takes the place of the old one.
fn write(folder: &Path, files: &[(&str, String)]) -> Result<(), Failure> {
    let failed = |doing: &'static str| move |error: std::io::Error| Failure::other(format!("{}: cannot {doing}: {error}", folder.display()));
    let parent: PathBuf = folder.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new(".")).into();
    std::fs::create_dir_all(&parent).map_err(failed("make the folder"))?;
    let beside = tempfile::Builder::new().prefix(".diagnosis-").tempdir_in(&parent).map_err(failed("make a folder beside it"))?;
    let new = beside.path().join("new");
    std::fs::create_dir(&new).map_err(failed("make a folder beside it"))?;
    for (name, text) in files {
        std::fs::write(new.join(name), text).map_err(failed("write the report"))?;
    }
    if folder.exists() {
        std::fs::rename(folder, beside.path().join("old")).map_err(failed("replace the earlier report"))?;
    }
    std::fs::rename(&new, folder).map_err(failed("put the report in place"))
}

/// The answer on stdout, the talk on stderr.
fn show(options: &DiagnoseOptions, report: &Report, failed: &[String], folder: &Path, started: Instant) -> Result<(), Failure> {
    failed.iter().for_each(|why| eprintln!("warning: {why}"));
    if options.json {
        print(&text(report)?)?;
    } else if !options.quiet {
        print(&summary(report))?;
    }
    if !options.quiet {
        eprintln!("the report is in {} ({})", folder.display(), human_seconds(started.elapsed().as_secs_f64()));
    }
    Ok(())
}

fn summary(report: &Report) -> String {
    let mut text = format!("{}: {}\n", report.verdict.name(), report.summary);
    for effect in &report.effects {
        let _ = writeln!(text, "\n{}\n  {}\n  {}", effect.id, effect.plain, effect.equation);
        for (key, parameter) in &effect.parameters {
            let interval = parameter.ci95.map(|[low, high]| format!(" ({} to {})", short(low), short(high))).unwrap_or_default();
            let nominal = parameter.nominal.map(|nominal| format!(", stated {}", short(nominal))).unwrap_or_default();
            let _ = writeln!(text, "  {key} = {}{interval}{nominal} [{}]", short(parameter.estimate), parameter.unit);
        }
        if !effect.also_possible.is_empty() {
            let _ = writeln!(text, "  also possible: {}", effect.also_possible.join(", "));
        }
    }
    for property in &report.scene {
        let _ = writeln!(text, "\nthe scene: {} at {:.0} Hz, depth {:.2}", property.property, property.frequency_hz, property.depth);
    }
    if let Some(psnr) = report.fit.heldout_frame_psnr_db {
        let _ = writeln!(text, "\nframes kept back: {:.1} dB as stated, {:.1} dB as fitted", psnr.before, psnr.after);
    }
    for advice in &report.next_experiment {
        let _ = writeln!(text, "next: {advice}");
    }
    text
}
