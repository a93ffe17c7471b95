//! Recomputes the numbers of the diagnosis' decision from simulated recordings, with cross-validation.
//!
//! A developer's program: `make calibrate` runs it for each kind of scene. Users run the built-in numbers;
//! `data/diagnosis` has the training sets.

mod example;
mod fit;
mod simulated;

use clap::{Parser, ValueEnum};
use example::{CalibrationExample, example};
use fit::{ValidationScore, calibrate as model_of, validate};
use indicatif::{ProgressBar, ProgressStyle};
use photocurrent_core::Extent;
use photocurrent_diagnosis::decide::DecisionThresholds;
use photocurrent_diagnosis::decide::model::DecisionModel;
use rayon::prelude::*;
use serde::Serialize;
use simulated::{SceneModelKind, SimulationSetting};
use std::collections::BTreeMap;
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Computes the numbers of the diagnosis' decision from simulated recordings, with cross-validation.
#[derive(Parser)]
#[command(name = "photocurrent-calibrate", version)]
struct Options {
    /// Simulated recordings: with nothing, one effect, two, or what is in no catalogue; some six seconds each
    /// on two cores at 64x48
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..))]
    recordings: u64,
    /// Kind of scene
    #[arg(long, value_enum, default_value = "picture")]
    scene: SceneKind,
    /// Size of the simulated arrays, pixels [default: 64x48; 40x30 of known light]
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = extent)]
    size: Option<Extent>,
    /// Parts of the cross-validation
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u64).range(2..))]
    folds: u64,
    /// Folder for decision.json and examples.jsonl; recordings that are in it are not simulated again
    #[arg(short, long, value_name = "FOLDER", default_value = "out/decision")]
    out: PathBuf,
    /// Seed of everything random
    #[arg(long, value_name = "N", default_value_t = 7)]
    seed: u64,
    /// Print only errors
    #[arg(short, long)]
    quiet: bool,
}

/// Kinds of scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum SceneKind {
    /// A moving picture, fitted to the frames
    Picture,
    /// Scenes that do not move as one, in parts
    Parts,
    /// Light that is known but for a few numbers
    Given,
    /// Any scene, the light of each pixel free in time
    Pixels,
    /// A moving picture of frames and events together
    Joint,
}

impl SceneKind {
    fn name(self) -> &'static str {
        match self {
            SceneKind::Picture => "picture",
            SceneKind::Parts => "parts",
            SceneKind::Given => "given",
            SceneKind::Pixels => "pixels",
            SceneKind::Joint => "joint",
        }
    }

    fn setting(self, size: Option<Extent>) -> SimulationSetting {
        let usual = SimulationSetting::for_model(match self {
            SceneKind::Picture => SceneModelKind::Picture,
            SceneKind::Parts => SceneModelKind::Parts,
            SceneKind::Given => SceneModelKind::Given,
            SceneKind::Pixels => SceneModelKind::Pixels,
            SceneKind::Joint => SceneModelKind::Joint,
        });
        SimulationSetting { extent: size.unwrap_or(usual.extent), ..usual }
    }
}

fn main() -> ExitCode {
    match calibrate_from_options(&Options::parse(), &mut std::io::stderr()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(why) => {
            // Nobody is left to read it.
            let _ = writeln!(std::io::stderr(), "error: {why}");
            ExitCode::FAILURE
        }
    }
}

/// The file `decision.json`.
#[derive(Serialize)]
struct CalibrationFile {
    seed: u64,
    size: String,
    /// Recordings without a scene.
    without: usize,
    /// Of each kind of scene.
    models: BTreeMap<String, FittedModel>,
}

#[derive(Serialize)]
struct FittedModel {
    model: DecisionModel,
    validation: ValidationScore,
}

/// Simulates recordings one by one, so that a stopped run can continue, then fits and validates the models.
fn calibrate_from_options(options: &Options, log: &mut impl Write) -> Result<(), String> {
    let setting = options.scene.setting(options.size);
    let size = format!("{}x{}", setting.extent.width, setting.extent.height);
    let examples = examples(options, &setting, &size)?;
    let lines = examples.iter().map(|one| serde_json::to_string(&one.facts_alone()));
    let lines: Vec<String> =
        lines.collect::<Result<_, _>>().map_err(|error| format!("examples.jsonl: {error}"))?;
    write(&options.out.join("examples.jsonl"), (lines.join("\n") + "\n").as_bytes())?;
    let mut kinds: BTreeMap<String, Vec<CalibrationExample>> = BTreeMap::new();
    for one in &examples {
        let of_scene = |scene: &str| if scene.is_empty() { options.scene.name() } else { scene }.to_owned();
        let kind = one.facts.as_ref().map_or("none".to_owned(), |facts| of_scene(&facts.scene));
        kinds.entry(kind).or_default().push(one.clone());
    }
    let without = kinds.remove("none").map_or(0, |none| none.len());
    let fit = |(kind, of_kind): (String, Vec<CalibrationExample>)| {
        let model = model_of(&of_kind.iter().collect::<Vec<&CalibrationExample>>());
        (
            kind,
            FittedModel {
                model,
                validation: validate(&of_kind, options.folds as usize, &DecisionThresholds::default()),
            },
        )
    };
    let models: BTreeMap<String, FittedModel> = kinds.into_iter().map(fit).collect();
    let mut text: String = models.iter().map(|(kind, fitted)| report(kind, &fitted.validation)).collect();
    let (count, out) = (examples.len(), options.out.display());
    text += &format!(
        "{count} recordings, {without} of them without a scene; \
         the models are in {out}/decision.json, what they were calibrated on in {out}/examples.jsonl\n"
    );
    let calibrated = CalibrationFile { seed: options.seed, size, without, models };
    let document =
        serde_json::to_string_pretty(&calibrated).map_err(|error| format!("decision.json: {error}"))?;
    write(&options.out.join("decision.json"), document.as_bytes())?;
    if !options.quiet {
        // Nobody is left to read it.
        let _ = log.write_all(text.as_bytes());
    }
    Ok(())
}

/// The examples of a seed: read where an earlier run wrote them, simulated where not.
fn examples(
    options: &Options,
    setting: &SimulationSetting,
    size: &str,
) -> Result<Vec<CalibrationExample>, String> {
    let folder = options.out.join(format!("made-{}-{size}-{}", options.scene.name(), options.seed));
    let failed = |error: std::io::Error| format!("{}: cannot make the folder: {error}", folder.display());
    std::fs::create_dir_all(&folder).map_err(failed)?;
    let bar = bar(options);
    let one = |number: u64| -> Result<Option<CalibrationExample>, String> {
        let path = folder.join(format!("{number:05}.json"));
        // Effects that cannot be combined make no recording; the next number makes another.
        let found = match stored(&path) {
            Some(example) => Some(example),
            None => match example(options.seed, number, setting) {
                Ok(example) => Some(store(&path, example)?),
                Err(_) => None,
            },
        };
        bar.inc(1);
        Ok(found)
    };
    let found: Vec<Option<CalibrationExample>> =
        (0..options.recordings).into_par_iter().map(one).collect::<Result<_, _>>()?;
    bar.finish_and_clear();
    Ok(found.into_iter().flatten().collect())
}

fn stored(path: &Path) -> Option<CalibrationExample> {
    let CalibrationExample { truth, found, .. } = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
    Some(CalibrationExample::new(truth, found))
}

fn store(path: &Path, example: CalibrationExample) -> Result<CalibrationExample, String> {
    let text = serde_json::to_vec(&example).map_err(|error| format!("{}: {error}", path.display()))?;
    write(path, &text)?;
    Ok(example)
}

fn report(kind: &str, found: &ValidationScore) -> String {
    let share = |part: usize, of: usize| 100.0 * part as f64 / f64::max(of as f64, 1.0);
    let mut text = format!("{kind}: cross-validated, {} recordings:\n", found.recordings);
    let (count, claimed) = found.nothing;
    text += &format!("  no effect  {count:4}  findings in {claimed} ({:.1} %)\n", share(claimed, count));
    let (count, claimed, first, set) = found.one;
    text += &format!(
        "  one        {count:4}  claimed {claimed}, first {first} ({:.0} %), in the set {set} ({:.0} %), \
         a second one named in {}\n",
        share(first, count),
        share(set, count),
        found.surplus
    );
    let (count, both, f1) = found.two;
    let mean_f1 = f1 / f64::max(count as f64, 1.0);
    text += &format!("  two        {count:4}  both {both} ({:.0} %), F1 {mean_f1:.2}\n", share(both, count));
    let (count, unnamed, forced) = found.other;
    text += &format!(
        "  no catalogue {count:2}  unnamed {unnamed} ({:.0} %), named {forced} ({:.0} %)\n",
        share(unnamed, count),
        share(forced, count)
    );
    for (from, to, claims, right) in found.reliability.iter().filter(|bin| bin.2 > 0) {
        text += &format!("  posterior {from:.1} to {to:.1}: {right} of {claims} right\n");
    }
    text
}

fn bar(options: &Options) -> ProgressBar {
    if options.quiet || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(options.recordings);
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} recordings, {eta} left");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar
}

/// A size such as 96x72.
fn extent(size: &str) -> Result<Extent, String> {
    let wrong = || "expected WIDTHxHEIGHT in pixels, such as 96x72, each from 16 to 4096".to_owned();
    let (width, height) = size.split_once('x').ok_or_else(wrong)?;
    let number = |text: &str| text.parse::<u32>().ok().filter(|n| (16..=4096).contains(n)).ok_or_else(wrong);
    Ok(Extent { width: number(width)?, height: number(height)? })
}

/// Writes a file whole or not at all.
fn write(path: &Path, bytes: &[u8]) -> Result<(), String> {
    let partial = path.with_extension("tmp");
    let failed = |error: std::io::Error| format!("{}: cannot write it: {error}", path.display());
    std::fs::write(&partial, bytes).map_err(failed)?;
    std::fs::rename(&partial, path).map_err(failed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    #[test]
    fn a_decision_is_calibrated_from_nothing_and_a_stopped_run_goes_on_where_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().to_str().unwrap();
        let calibrate = |count: &str| {
            let arguments =
                ["calibrate", "--recordings", count, "--size", "24x18", "--folds", "2", "-o", out];
            let mut log = Vec::new();
            calibrate_from_options(&Options::parse_from(arguments), &mut log).unwrap();
            String::from_utf8(log).unwrap()
        };
        let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
        calibrate("2");
        let first = folder.path().join("made-picture-24x18-7/00000.json");
        let written = || std::fs::metadata(&first).and_then(|of| of.modified()).unwrap();
        let before = written();
        let log = calibrate("4");
        assert!(
            ["4 recordings", "decision.json", "examples.jsonl"].iter().all(|part| log.contains(part)),
            "{log}"
        );
        assert_eq!(written(), before);
        let found: Value = serde_json::from_str(&read("decision.json")).unwrap();
        // Each recording is of the model of its kind of scene, or without one.
        let models: Vec<&Value> = found["models"].as_object().unwrap().values().collect();
        let judged: u64 =
            models.iter().filter_map(|of_kind| of_kind["validation"]["recordings"].as_u64()).sum();
        assert_eq!(judged + found["without"].as_u64().unwrap(), 4);
        let weights = |of_kind: &&Value| of_kind["model"]["something"].as_array().map(Vec::len);
        assert!(models.iter().all(|of_kind| weights(of_kind) == Some(3)), "{found}");
        assert_eq!(read("examples.jsonl").lines().count(), 4);
    }

    #[test]
    fn a_size_is_two_numbers_of_pixels() {
        assert_eq!(extent("96x72"), Ok(Extent { width: 96, height: 72 }));
        assert!(["96", "96x", "8x72", "96x72x3"].iter().all(|size| extent(size).is_err()));
    }
}
