//! `photocurrent learn`: what a diagnosis knows beforehand, made anew.

use crate::args::LearnOptions;
use crate::case::{self, Unread, usage};
use crate::common::{Done, Failure};
use indicatif::{ProgressBar, ProgressStyle};
use photocurrent_core::Extent;
use photocurrent_diagnosis::floor::Null;
use photocurrent_diagnosis::proposer::NetSetting;
use photocurrent_diagnosis::scenes::MadeUp;
use photocurrent_diagnosis::summaries;
use photocurrent_diagnosis::train::{Example, TrainingSetting, examples_of, learn as knowledge_of, null_of};
use std::io::IsTerminal;
use std::path::Path;

/// Length of a made-up recording, seconds.
const DURATION_S: f64 = 0.15;

/// Makes knowledge: examples of made-up scenes, scene by scene so that a stopped run goes on where it was, then floor and network.
pub fn learn(options: &LearnOptions) -> Done {
    let extent = extent(&options.size)?;
    let names = summaries::names().map_err(usage)?;
    let made = options.out.join(format!("scenes-{}-{}-{}", options.size, options.seed, options.strengths));
    std::fs::create_dir_all(&made).map_err(|error| Failure::other(format!("{}: cannot make the folder: {error}", made.display())))?;
    let bar = bar(options);
    let nulls = options.nulls.iter().map(|path| null(path, options.seed)).collect::<Result<Vec<Null>, Failure>>()?;
    let setting = TrainingSetting { seed: options.seed, strengths: options.strengths as usize };
    let mut examples = Vec::new();
    for number in 0..options.scenes {
        examples.extend(scene(&made, number, extent, &setting, names.len())?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let net = NetSetting { seed: options.seed, steps: options.steps as usize, ..NetSetting::default() };
    let knowledge = knowledge_of(&names, &examples, &nulls, &net);
    write(&options.out.join("knowledge.bin"), &knowledge.to_bytes())?;
    if let Some(net) = &knowledge.net {
        write(&options.out.join("proposer.onnx"), &net.to_onnx())?;
    }
    if !options.quiet {
        let (scenes, nulls) = (options.scenes, knowledge.floor.nulls.len());
        eprintln!("{scenes} scenes, {} examples, {nulls} recordings without an effect; the files are in {}", examples.len(), options.out.display());
    }
    Ok(0)
}

fn extent(size: &str) -> Result<Extent, Failure> {
    let wrong = || usage(format!("--size {size}: expected WIDTHxHEIGHT in pixels, such as 96x72, each from 16 to 4096"));
    let (width, height) = size.split_once('x').ok_or_else(wrong)?;
    let number = |text: &str| text.parse::<u32>().ok().filter(|n| (16..=4096).contains(n)).ok_or_else(wrong);
    Ok(Extent { width: number(width)?, height: number(height)? })
}

fn bar(options: &LearnOptions) -> ProgressBar {
    if options.quiet || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(options.scenes);
    bar.set_style(ProgressStyle::with_template("{bar:40} {pos}/{len} scenes, {eta} left").unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar
}

/// The examples of a made-up scene: those that were made before, or new ones, which are kept.
fn scene(folder: &Path, number: u64, extent: Extent, setting: &TrainingSetting, summaries: usize) -> Result<Vec<Example>, Failure> {
    let path = folder.join(format!("{number:05}.bin"));
    if let Ok(bytes) = std::fs::read(&path) {
        let found = Example::all_from_bytes(&bytes);
        if !found.is_empty() && found.iter().all(|example| example.deviation.len() == summaries) {
            return Ok(found);
        }
    }
    let failed = |why: String| Failure::other(format!("scene {number}: {why}"));
    let case = MadeUp::new(setting.seed, number, extent, DURATION_S).recording().map_err(failed)?;
    let found = examples_of(&case, setting, number).map_err(failed)?;
    write(&path, &found.iter().flat_map(Example::to_bytes).collect::<Vec<u8>>())?;
    Ok(found)
}

/// By how much a recording without an effect deviates.
fn null(path: &Path, seed: u64) -> Result<Null, Failure> {
    let case = match case::read(path, None, true) {
        Ok(case) => case,
        Err(Unread::Content(why)) => return Err(usage(why)),
        Err(Unread::Other(failure)) => return Err(failure),
    };
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    null_of(&case, name, seed).map_err(|why| usage(format!("{}: {why}", path.display())))
}

/// Writes a file whole or not at all.
fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let beside = path.with_extension("tmp");
    let failed = |error: std::io::Error| Failure::other(format!("{}: cannot write it: {error}", path.display()));
    std::fs::write(&beside, bytes).map_err(failed)?;
    std::fs::rename(&beside, path).map_err(failed)
}
