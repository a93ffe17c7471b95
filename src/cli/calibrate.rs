//! `photocurrent calibrate`: the numbers of the diagnosis' decision, made anew from made-up recordings.

use crate::args::{CalibrateOptions, CalibratedScene};
use crate::failure::{Done, Failure, usage};
use crate::terminal::say;
use indicatif::{ProgressBar, ProgressStyle};
use photocurrent_core::Extent;
use photocurrent_diagnosis::decide::Decision;
use photocurrent_diagnosis::decide::calibrate::{Example, Validation, calibrate as model_of, example, validate};
use photocurrent_diagnosis::decide::model::Model;
use photocurrent_diagnosis::made::{Kind, MadeSetting};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::Path;

/// What is written.
#[derive(Serialize)]
struct Calibrated {
    seed: u64,
    size: String,
    /// Recordings without a scene.
    without: usize,
    /// Of each kind of scene.
    models: BTreeMap<String, Fitted>,
}

#[derive(Serialize)]
struct Fitted {
    model: Model,
    validation: Validation,
}

/// Makes recordings one by one, so that a stopped run goes on where it was, then model and validation.
pub fn calibrate(options: &CalibrateOptions) -> Done {
    let (kind, scene) = match options.scene {
        CalibratedScene::Picture => (Kind::Picture, "picture"),
        CalibratedScene::Parts => (Kind::Parts, "parts"),
        CalibratedScene::Given => (Kind::Given, "given"),
    };
    let usual = MadeSetting::of(kind);
    let size = options.size.clone().unwrap_or_else(|| format!("{}x{}", usual.extent.width, usual.extent.height));
    let made = MadeSetting { extent: extent(&size)?, ..usual };
    let folder = options.out.join(format!("made-{scene}-{size}-{}", options.seed));
    std::fs::create_dir_all(&folder).map_err(|error| Failure::other(format!("{}: cannot make the folder: {error}", folder.display())))?;
    let bar = bar(options);
    let one = |number: u64| -> Result<Option<Example>, Failure> {
        let path = folder.join(format!("{number:05}.json"));
        // Effects that cannot be combined make no recording; the next number makes another.
        let example = match made_before(&path) {
            Some(example) => Some(example),
            None => example(options.seed, number, &made).ok().map(|one| kept(&path, one)).transpose()?,
        };
        bar.inc(1);
        Ok(example)
    };
    let examples: Vec<Option<Example>> = (0..options.recordings).into_par_iter().map(one).collect::<Result<_, Failure>>()?;
    let examples: Vec<Example> = examples.into_iter().flatten().collect();
    bar.finish_and_clear();
    let lines = examples.iter().map(|one| serde_json::to_string(&one.facts_alone())).collect::<Result<Vec<String>, _>>();
    let lines = lines.map_err(|error| Failure::other(format!("examples.jsonl cannot be written: {error}")))?;
    write(&options.out.join("examples.jsonl"), (lines.join("\n") + "\n").as_bytes())?;
    let decision = Decision::default();
    let mut kinds: BTreeMap<String, Vec<Example>> = BTreeMap::new();
    for one in &examples {
        let kind = one.facts.as_ref().map_or("none", |facts| if facts.scene.is_empty() { scene } else { &facts.scene });
        kinds.entry(kind.to_owned()).or_default().push(one.clone());
    }
    let without = kinds.remove("none").map_or(0, |none| none.len());
    let fit = |(kind, of_kind): (String, Vec<Example>)| {
        let model = model_of(&of_kind.iter().collect::<Vec<&Example>>());
        let validation = validate(&of_kind, options.folds as usize, &decision);
        if !options.quiet {
            report(&kind, &validation);
        }
        (kind, Fitted { model, validation })
    };
    let models: BTreeMap<String, Fitted> = kinds.into_iter().map(fit).collect();
    let calibrated = Calibrated { seed: options.seed, size, without, models };
    let text = serde_json::to_string_pretty(&calibrated).map_err(|error| Failure::other(format!("decision.json cannot be written: {error}")))?;
    write(&options.out.join("decision.json"), text.as_bytes())?;
    if !options.quiet {
        let out = options.out.display();
        say!(
            "{} recordings, {without} of them without a scene; the models are in {out}/decision.json, what they were calibrated on in {out}/examples.jsonl",
            examples.len()
        );
    }
    Ok(0)
}

fn made_before(path: &Path) -> Option<Example> {
    let Example { truth, found, .. } = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
    Some(Example::new(truth, found))
}

fn kept(path: &Path, example: Example) -> Result<Example, Failure> {
    let text = serde_json::to_vec(&example).map_err(|error| Failure::other(format!("{}: {error}", path.display())))?;
    write(path, &text)?;
    Ok(example)
}

fn report(kind: &str, found: &Validation) {
    let share = |part: usize, of: usize| 100.0 * part as f64 / f64::max(of as f64, 1.0);
    say!("{kind}: cross-validated, {} recordings:", found.recordings);
    say!("  nothing    {:4}  something claimed in {} ({:.1} %)", found.nothing.0, found.nothing.1, share(found.nothing.1, found.nothing.0));
    let (count, claimed, first, set) = found.one;
    say!(
        "  one        {count:4}  claimed {claimed}, first {first} ({:.0} %), in the set {set} ({:.0} %), a second one named in {}",
        share(first, count),
        share(set, count),
        found.surplus
    );
    let (count, both, f1) = found.two;
    say!("  two        {count:4}  both {both} ({:.0} %), F1 {:.2}", share(both, count), f1 / f64::max(count as f64, 1.0));
    let (count, unnamed, forced) = found.other;
    say!("  no catalogue {count:2}  unnamed {unnamed} ({:.0} %), named {forced} ({:.0} %)", share(unnamed, count), share(forced, count));
    for (from, to, claims, right) in found.reliability.iter().filter(|bin| bin.2 > 0) {
        say!("  posterior {from:.1} to {to:.1}: {right} of {claims} right");
    }
}

fn bar(options: &CalibrateOptions) -> ProgressBar {
    if options.quiet || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(options.recordings);
    bar.set_style(ProgressStyle::with_template("{bar:40} {pos}/{len} recordings, {eta} left").unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar
}

/// A size such as 96x72.
fn extent(size: &str) -> Result<Extent, Failure> {
    let wrong = || usage(format!("--size {size}: expected WIDTHxHEIGHT in pixels, such as 96x72, each from 16 to 4096"));
    let (width, height) = size.split_once('x').ok_or_else(wrong)?;
    let number = |text: &str| text.parse::<u32>().ok().filter(|n| (16..=4096).contains(n)).ok_or_else(wrong);
    Ok(Extent { width: number(width)?, height: number(height)? })
}

/// Writes a file whole or not at all.
fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let partial = path.with_extension("tmp");
    let failed = |error: std::io::Error| Failure::other(format!("{}: cannot write it: {error}", path.display()));
    std::fs::write(&partial, bytes).map_err(failed)?;
    std::fs::rename(&partial, path).map_err(failed)
}
