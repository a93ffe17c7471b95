//! What a run made: its events, what was captured, and every sequence that was rendered.

use super::films::Film;
use super::options::PlayOptions;
use super::source::{Source, stretch};
use crate::failure::{Failure, usage};
use crate::report::run::{Output, Run};
use crate::report::{best, sensor};
use photocurrent_core::{EventStream, TimeSpan, Value};
use photocurrent_nodes::show::{Packer, Shown, clock_offset_ns};
use std::path::Path;

/// More sequences than these are hard to choose from.
const MOST: usize = 16;

/// A sequence of the run: its label, its node where that is called otherwise, its frames.
type Sequence = (String, Option<String>, Shown);

/// Opens a manifest that was run, or the folder that a run wrote to.
pub fn source(path: &Path, options: &PlayOptions) -> Result<Source, Failure> {
    let run = Run::open(path, "play", &options.variants, options.cache.as_deref())?;
    let mut notes = Vec::new();
    let sequences = sequences(&run, &mut notes);
    let events = events(&run, &mut notes);
    let ends = |shown: &Shown| {
        shown
            .exposures()
            .iter()
            .map(|one| TimeSpan { start: one.start, end: one.end })
            .reduce(TimeSpan::union)
    };
    let spans = sequences.iter().filter_map(|(.., shown)| ends(shown));
    let sensor = sensor(&run);
    // Recorded = true + offset, of the events' clock against that of the frames.
    let shift_ns = clock_offset_ns(sensor.as_deref()).map_err(|error| usage(error.to_string()))?;
    let of_events = events.as_ref().and_then(|events| events.meta.span).map(|span| span.moved(-shift_ns));
    let Some(whole) = spans.chain(of_events).reduce(TimeSpan::union) else {
        return Err(usage(format!(
            "{}: the run has neither events nor frames to play{}\n  hint: `photocurrent run {}` makes what \
             the cache does not have",
            run.folder.display(),
            notes.first().map_or_else(String::new, |note: &String| format!(": {}", note.replace('`', ""))),
            run.record.manifest
        )));
    };
    let span = stretch(options, whole, &run.name)?;
    let packer = match &events {
        Some(events) => {
            let mut packer = Packer::new(events.meta.extent, span, options.max_size);
            packer
                .push_all(events, shift_ns)
                .map_err(|error| Failure::other(format!("the events cannot be read: {error}")))?;
            Some(packer)
        }
        None => {
            notes.push(format!("There are no events: the run of {} has none.", run.record.manifest));
            None
        }
    };
    let within = |(label, node, shown): Sequence| Film::within(span, label, node, shown);
    let films: Vec<Film> = sequences.into_iter().filter_map(within).collect();
    if !films.iter().any(|film| !film.shown.is_captured() && !film.shown.is_truth()) {
        notes.push("There is no reconstruction: no node of the run renders frames in this stretch.".into());
    }
    let manifest = run.record.manifest.rsplit('/').next().unwrap_or_default().to_string();
    let mut facts = vec![("run".into(), format!("{manifest}, by photocurrent {}", run.record.version))];
    if shift_ns != 0 {
        let shift = format!("shown {} ms earlier than their stamps: the clock offset", shift_ns as f64 / 1e6);
        facts.push(("clock of the events".into(), shift));
    }
    Ok(Source {
        title: run.name.clone(),
        folder: run.folder.clone(),
        facts,
        notes,
        span,
        events: packer,
        films,
        sensor,
        best: best(&run)?,
        is_damaged: false,
    })
}

fn is_source(run: &Run, output: &Output) -> bool {
    ["read/", "simulate/"].iter().any(|family| run.record.tasks[output.0].kind.starts_with(family))
}

/// Outputs of a type, each once, in running order.
fn outputs(run: &Run, data_type: &str) -> Vec<(Output, String)> {
    let mut found: Vec<(Output, String)> = Vec::new();
    for variant in run.variants() {
        for output in run.outputs(variant, data_type) {
            // Blocks of time that are joined are shown as the whole, by the first of them.
            let is_rest = run.share(&output).is_some_and(|(first, _)| first != output);
            if !is_rest && !found.iter().any(|(known, _)| *known == output) {
                let label = run.label_in(&output, variant);
                found.push((output, label));
            }
        }
    }
    found
}

/// The first events that were read or simulated, whole: what others made of them is not recorded.
fn events(run: &Run, notes: &mut Vec<String>) -> Option<EventStream> {
    let all: Vec<(Output, String)> =
        outputs(run, "events").into_iter().filter(|(output, _)| is_source(run, output)).collect();
    let mut loaded = None;
    for (output, label) in &all {
        match run.value(output) {
            Ok(Value::Events(events)) => {
                loaded = Some((events, label));
                break;
            }
            Ok(_) => {}
            Err(why) => notes.push(lacking(run, label, &why)),
        }
    }
    let (events, label) = loaded?;
    if all.len() > 1 {
        notes.push(format!(
            "The events are those of {label}, of {} that the run has: choose with `--variant NAME`.",
            all.len()
        ));
    }
    Some(events)
}

fn lacking(run: &Run, label: &str, why: &str) -> String {
    format!("{label} is not shown: {why}. `photocurrent run {}` makes it again.", run.record.manifest)
}

/// The truth, what was captured, and what was rendered.
fn sequences(run: &Run, notes: &mut Vec<String>) -> Vec<Sequence> {
    let (mut truth, mut captured, mut methods) = (Vec::new(), Vec::new(), Vec::new());
    for (output, label) in outputs(run, "truth").into_iter().chain(outputs(run, "frames")) {
        let task = &run.record.tasks[output.0];
        if !task.end.is_well() || !task.outputs.contains_key(&output.1) {
            continue;
        }
        match run.value(&output).map(Shown::of) {
            Ok(Some(shown)) if shown.is_truth() => truth.push(("truth".into(), None, shown)),
            // What a node cut out of captured frames is shown as a part of them.
            Ok(Some(shown)) if shown.is_captured() && !is_source(run, &output) => {}
            Ok(Some(shown)) => {
                let node = (!label.contains(&task.label)).then(|| task.label.clone());
                let to = if shown.is_captured() { &mut captured } else { &mut methods };
                to.push((label, node, shown));
            }
            Ok(None) => {}
            Err(why) => notes.push(lacking(run, &label, &why)),
        }
    }
    if let [(label, node, _)] = captured.as_mut_slice() {
        *node = node.take().or_else(|| Some(label.clone()));
        *label = "captured".into();
    }
    // The truth of another scene or size has no use next to what is shown.
    truth.truncate(1);
    let mut all: Vec<Sequence> = truth.into_iter().chain(captured).chain(methods).collect();
    if all.len() > MOST {
        let left: Vec<String> = all.split_off(MOST).into_iter().map(|(label, ..)| label).collect();
        notes.push(format!(
            "{MOST} sequences are shown, and {} are not, such as {}: choose with `--variant NAME`.",
            left.len(),
            left[0]
        ));
    }
    all
}
