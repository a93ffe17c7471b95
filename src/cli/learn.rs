//! `photocurrent learn`: what a diagnosis knows beforehand, made anew.

use crate::args::LearnOptions;
use crate::case::{self, Unread, usage};
use crate::common::{Done, Failure};
use crate::terminal::say;
use indicatif::{ProgressBar, ProgressStyle};
use photocurrent_core::Extent;
use photocurrent_diagnosis::candidates::CANDIDATES;
use photocurrent_diagnosis::floor::Null;
use photocurrent_diagnosis::knowledge::Knowledge;
use photocurrent_diagnosis::proposer::NetSetting;
use photocurrent_diagnosis::scenes::MadeUp;
use photocurrent_diagnosis::summaries;
use photocurrent_diagnosis::train::{Example, TrainingSetting, bias_of, examples_of, learn as knowledge_of, null_of};
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
    let known = options.nulls.iter().map(|path| null(path, options.seed)).collect::<Result<Vec<(Null, Null)>, Failure>>()?;
    let (nulls, mut biases): (Vec<Null>, Vec<Null>) = known.into_iter().unzip();
    let setting = TrainingSetting { seed: options.seed, strengths: options.strengths as usize };
    let mut examples = Vec::new();
    for number in 0..options.scenes {
        let case = || MadeUp::new(setting.seed, number, extent, DURATION_S).recording();
        examples.extend(made_before(&made.join(format!("{number:05}.bin")), names.len(), || examples_of(&case()?, &setting, number))?);
        if number.is_multiple_of(BIASES) {
            biases.extend(bias(&made.join(format!("{number:05}.bias")), number, || bias_of(&case()?, format!("made up {number}")))?);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let net = NetSetting { seed: options.seed, steps: options.steps as usize, ..NetSetting::default() };
    let knowledge = knowledge_of(&names, &examples, &nulls, &biases, &net);
    let bytes = knowledge.to_bytes();
    write(&options.out.join("knowledge.bin"), &bytes)?;
    // The network as a diagnosis has it: its numbers are rounded in the file.
    let kept = Knowledge::from_bytes(&bytes).map_err(|why| Failure::other(format!("the knowledge cannot be read again: {why}")))?;
    if let Some(net) = &kept.net {
        write(&options.out.join("proposer.onnx"), &net.to_onnx())?;
    }
    if !options.quiet {
        let (scenes, nulls) = (options.scenes, knowledge.floor.nulls.len());
        say!("{scenes} scenes, {} examples, {nulls} recordings without an effect; the files are in {}", examples.len(), options.out.display());
    }
    Ok(0)
}

/// A size such as 96x72.
pub fn extent(size: &str) -> Result<Extent, Failure> {
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
fn made_before(path: &Path, length: usize, make: impl FnOnce() -> Result<Vec<Example>, String>) -> Result<Vec<Example>, Failure> {
    if let Ok(bytes) = std::fs::read(path) {
        let found = Example::all_from_bytes(&bytes);
        if !found.is_empty() && found.iter().all(|example| example.deviation.len() == length) {
            return Ok(found);
        }
    }
    let made = make().map_err(|why| Failure::other(format!("{}: {why}", path.display())))?;
    write(path, &made.iter().flat_map(Example::to_bytes).collect::<Vec<u8>>())?;
    Ok(made)
}

/// Of every so many made-up scenes the biases are worked out, which takes as long as its examples.
const BIASES: u64 = 8;

/// The biases of a made-up scene, kept as an example without a candidate.
fn bias(path: &Path, number: u64, make: impl FnOnce() -> Result<Null, String>) -> Result<Option<Null>, Failure> {
    let as_example = |null: Null| vec![Example { candidate: None, strength: 0.0, context: null.context, deviation: null.deviation }];
    let found = made_before(path, CANDIDATES.len(), || make().map(as_example))?;
    Ok(found.into_iter().next().map(|one| Null { name: format!("made up {number}"), context: one.context, deviation: one.deviation }))
}

/// By how much a recording without an effect deviates, and its biases.
fn null(path: &Path, seed: u64) -> Result<(Null, Null), Failure> {
    let case = match case::read(path, None, None) {
        Ok(case) => case,
        Err(Unread::Content(why)) => return Err(usage(why)),
        Err(Unread::Other(failure)) => return Err(failure),
    };
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let wrong = |why: String| usage(format!("{}: {why}", path.display()));
    Ok((null_of(&case, name.clone(), seed).map_err(wrong)?, bias_of(&case, name).map_err(wrong)?))
}

/// Writes a file whole or not at all.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let partial = path.with_extension("tmp");
    let failed = |error: std::io::Error| Failure::other(format!("{}: cannot write it: {error}", path.display()));
    std::fs::write(&partial, bytes).map_err(failed)?;
    std::fs::rename(&partial, path).map_err(failed)
}
