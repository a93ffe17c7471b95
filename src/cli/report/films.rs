//! Which sequences are shown, at which instants, and how large, so that the page keeps its size.
//!
//! Shown are the frames that scorers judge, what they are judged by, and what was captured; without scorers
//! all frames. Instants are thinned out evenly down to [`FEWEST`]; if that is not enough, pictures get half
//! the size, and again.

use super::run::{Output, Run, Styles};
use super::scores::best_row;
use crate::failure::Failure;
use crate::numbers::human_bytes;
use photocurrent_core::{Extent, NodeError, Sensor, Value};
use photocurrent_nodes::show::{Shown, Tone};
use photocurrent_page::{Film, Group, Picture, RunPage, png_uri};
use std::sync::Arc;

/// More sequences than these are hard to choose from.
const MOST: usize = 16;
/// Fewer instants than these are no film.
const FEWEST: usize = 12;
/// More do not help the eye.
const MOST_INSTANTS: usize = 400;
const MOST_SHRINK: u32 = 16;
/// The grey line of what was captured; the truth has a line of its own.
const CAPTURED: usize = 6;

/// Kinds of sequences in the order in which they are shown.
const KINDS: [&str; 3] = ["truth", "captured", "method"];

/// A sequence that is shown.
struct Candidate {
    label: String,
    shown: Shown,
    /// Do scorers compare with it?
    is_reference: bool,
}

impl Candidate {
    fn kind(&self) -> &'static str {
        KINDS[self.rank()]
    }

    /// The truth first, then what was captured.
    fn rank(&self) -> usize {
        if self.shown.is_truth() {
            0
        } else if self.shown.is_captured() {
            1
        } else {
            2
        }
    }
}

/// Sequences of one run and size.
struct Scene {
    run: String,
    extent: Extent,
    all: Vec<Candidate>,
    sensor: Option<Arc<Sensor>>,
}

/// The description of the sensor of a run.
pub fn sensor(run: &Run) -> Option<Arc<Sensor>> {
    let outputs: Vec<Output> = run.variants().flat_map(|variant| run.outputs(variant, "sensor")).collect();
    outputs.iter().find_map(|output| match run.value(output) {
        Ok(Value::Sensor(sensor)) => Some(sensor),
        _ => None,
    })
}

/// Adds the pictures of all runs.
pub fn pictures(runs: &[Run], styles: &mut Styles, budget: u64, page: &mut RunPage) -> Result<(), Failure> {
    let mut scenes: Vec<Scene> = Vec::new();
    for run in runs {
        let (found, notes) = candidates(run);
        page.picture_notes.extend(notes);
        let sensor = sensor(run);
        for candidate in found {
            let extent = candidate.shown.extent();
            match scenes.iter_mut().find(|scene| scene.run == run.name && scene.extent == extent) {
                Some(scene) => scene.all.push(candidate),
                None => scenes.push(Scene {
                    run: run.name.clone(),
                    extent,
                    all: vec![candidate],
                    sensor: sensor.clone(),
                }),
            }
        }
    }
    let share = budget / scenes.len().max(1) as u64;
    for Scene { run: name, extent, all, sensor } in scenes {
        let several = runs.len() > 1 || page.groups.iter().any(|group| group.name.starts_with(&name));
        let name = if several { format!("{name}, {extent} pixels") } else { name };
        let group = group(name, &all, sensor.as_deref(), styles, share, page)?;
        page.groups.push(group);
    }
    if let Some(first) = page.groups.first_mut() {
        first.holds_pixels = true;
    }
    Ok(())
}

/// The sequences of a run in the order in which they are shown, and what there is to say about those that are
/// not.
fn candidates(run: &Run) -> (Vec<Candidate>, Vec<String>) {
    let mut notes = Vec::new();
    let mut wanted: Vec<(Output, String, bool)> = Vec::new();
    let has_scorers = run.variants().any(|variant| {
        run.tasks(variant)
            .any(|(at, _)| run.judged(at).is_some() && run.record.tasks[at].kind.starts_with("score/"))
    });
    let mut add = |output: Output, label: String, is_reference: bool| match wanted
        .iter_mut()
        .find(|(known, ..)| *known == output)
    {
        Some(known) => known.2 |= is_reference,
        None => wanted.push((output, label, is_reference)),
    };
    for variant in run.variants() {
        for (at, _) in run.tasks(variant).filter(|(_, task)| task.kind.starts_with("score/")) {
            for port in ["truth", "held"] {
                run.inputs(at, port)
                    .iter()
                    .for_each(|output| add(output.clone(), run.label_in(output, variant), true));
            }
            run.judged(at)
                .into_iter()
                .for_each(|output| add(output.clone(), run.label_in(output, variant), false));
        }
        let sources = run.outputs(variant, "frames").into_iter().filter(|(at, _)| {
            ["read/", "simulate/"].iter().any(|family| run.record.tasks[*at].kind.starts_with(family))
        });
        sources.for_each(|output| add(output.clone(), run.label_in(&output, variant), false));
    }
    if !has_scorers {
        for variant in run.variants() {
            run.outputs(variant, "frames")
                .into_iter()
                .for_each(|output| add(output.clone(), run.label_in(&output, variant), false));
        }
    }
    let mut all: Vec<Candidate> = Vec::new();
    for (output, label, is_reference) in wanted {
        let task = &run.record.tasks[output.0];
        if !task.end.is_well() || !task.outputs.contains_key(&output.1) {
            continue;
        }
        match run.value(&output).map(Shown::of) {
            Ok(Some(shown)) => {
                let label = if shown.is_truth() { "truth".into() } else { label };
                all.push(Candidate { label, shown, is_reference });
            }
            Ok(None) => {}
            Err(why) => notes.push(format!(
                "{label} is not shown: {why}. `photocurrent run {}` makes it again.",
                run.record.manifest
            )),
        }
    }
    all.sort_by_key(Candidate::rank);
    if let [one] =
        all.iter_mut().filter(|candidate| candidate.kind() == "captured").collect::<Vec<_>>().as_mut_slice()
    {
        one.label = "captured".into();
    }
    if all.len() > MOST {
        let left: Vec<String> = all.split_off(MOST).into_iter().map(|candidate| candidate.label).collect();
        notes.push(format!(
            "{MOST} sequences of {} are shown, and {} are not, such as {}: choose with `--variant NAME`.",
            run.name,
            left.len(),
            left[0]
        ));
    }
    if all.is_empty() && notes.is_empty() {
        notes.push(format!("No pictures of {}: the run has no frames.", run.name));
    }
    notes.dedup();
    (all, notes)
}

/// Chooses instants and size, and encodes.
fn group(
    name: String,
    all: &[Candidate],
    sensor: Option<&Sensor>,
    styles: &mut Styles,
    budget: u64,
    page: &mut RunPage,
) -> Result<Group, Failure> {
    let failed = |error: NodeError| Failure::other(format!("the pictures of {name} cannot be made: {error}"));
    let reference = all
        .iter()
        .position(|one| one.is_reference)
        .or_else(|| all.iter().position(|one| one.kind() == "method"))
        .unwrap_or(0);
    let middles: Vec<Vec<i64>> = all.iter().map(|one| one.shown.middles_ns()).collect();
    let instants = common(
        &middles[reference],
        all.iter().zip(&middles).filter(|(one, _)| one.kind() == "method").map(|(_, middles)| middles),
    );
    let extent = all[reference].shown.extent();
    let tone = Tone::of(&all[reference].shown, sensor).map_err(failed)?;
    let mut films = Films { all, middles, tone, shrink: 1 };
    let count = films.fit(&instants, extent, budget).map_err(failed)?;
    let shrink = films.shrink;
    if count < instants.len() || shrink > 1 {
        let size = if shrink > 1 { format!(", at 1/{shrink} of their size") } else { String::new() };
        page.picture_notes.push(format!(
            "{name}: {count} of {} instants are embedded{size}, to keep within {} of pictures: `--max-size` \
             allows more.",
            instants.len(),
            human_bytes(budget)
        ));
    }
    let last = instants.len() - 1;
    let place = |k: usize| if count == 1 { instants.len() / 2 } else { k * last / (count - 1) };
    let chosen: Vec<i64> = (0..count).map(|k| instants[place(k)]).collect();
    let sequences = films.encode(&chosen, styles).map_err(failed)?;
    Ok(Group {
        first: first_pair(&sequences, best_row(page)),
        name,
        width: extent.width / shrink,
        height: extent.height / shrink,
        shrink,
        black: films.tone.black,
        white: films.tone.white,
        instants_ns: chosen,
        holds_pixels: false,
        sequences,
    })
}

/// Sequences of one size and how their pictures are made.
struct Films<'a> {
    all: &'a [Candidate],
    /// Middles of the exposures of each, ns.
    middles: Vec<Vec<i64>>,
    tone: Tone,
    /// Pixels to one of a picture, in each direction.
    shrink: u32,
}

impl Films<'_> {
    /// How many instants fit into a budget of bytes; where these are too few, pictures get smaller.
    fn fit(&mut self, instants: &[i64], extent: Extent, budget: u64) -> Result<usize, NodeError> {
        let probe = instants[instants.len() / 2];
        let most = instants.len().min(MOST_INSTANTS);
        loop {
            let mut bytes = 0;
            for (one, middles) in self.all.iter().zip(&self.middles) {
                bytes += one.shown.png(nearest(middles, probe), &self.tone, self.shrink)?.len() as u64;
            }
            // Base64 writes four letters for three bytes.
            let fitting = (budget / (bytes * 4 / 3 + 100 * self.all.len() as u64).max(1)) as usize;
            let smaller = self.shrink * 2;
            let can_shrink =
                smaller <= MOST_SHRINK && extent.width / smaller >= 16 && extent.height / smaller >= 16;
            if fitting >= most.min(FEWEST) || !can_shrink {
                return Ok(fitting.clamp(1, most));
            }
            self.shrink = smaller;
        }
    }

    /// The sequences at some instants; a picture that is shown at several is stored once.
    fn encode(&self, chosen: &[i64], styles: &mut Styles) -> Result<Vec<Film>, NodeError> {
        let mut sequences = Vec::new();
        for (one, middles) in self.all.iter().zip(&self.middles) {
            let mut film = Film {
                label: one.label.clone(),
                kind: one.kind(),
                style: if one.kind() == "method" { styles.of(&one.label) } else { CAPTURED },
                ..Film::default()
            };
            for &instant in chosen {
                let frame = nearest(middles, instant);
                let at = match film.frames.iter().rposition(|known| known.frame == frame) {
                    Some(at) => at,
                    None => {
                        let src = png_uri(&one.shown.png(frame, &self.tone, self.shrink)?);
                        film.frames.push(Picture { frame, t_ns: middles[frame], src });
                        film.frames.len() - 1
                    }
                };
                film.at.push(at);
            }
            sequences.push(film);
        }
        Ok(sequences)
    }
}

/// The instants at which every method has frames, all of them where there are none in common.
fn common<'a>(instants: &[i64], methods: impl Iterator<Item = &'a Vec<i64>>) -> Vec<i64> {
    let ends = |(from, to): (i64, i64), middles: &Vec<i64>| {
        (from.max(middles.first().copied().unwrap_or(from)), to.min(middles.last().copied().unwrap_or(to)))
    };
    let (from, to) = methods.fold((i64::MIN, i64::MAX), ends);
    let found: Vec<i64> = instants.iter().copied().filter(|t| (from..=to).contains(t)).collect();
    if found.is_empty() { instants.to_vec() } else { found }
}

/// What was captured on the left, and the best method on the right, else the first.
fn first_pair(sequences: &[Film], best: Option<&str>) -> [usize; 2] {
    let find = |kind: &str| sequences.iter().position(|one| one.kind == kind);
    let last = sequences.len() - 1;
    let left = find("captured").or_else(|| find("truth")).unwrap_or(0);
    let best = sequences.iter().position(|one| Some(one.label.as_str()) == best);
    [left, best.or_else(|| find("method")).filter(|right| *right != left).unwrap_or(last)]
}

/// The place of the number that is nearest; of two equally near ones the first. Numbers rise.
fn nearest(middles: &[i64], instant: i64) -> usize {
    let after = middles.partition_point(|&middle| middle < instant);
    match (after.checked_sub(1), middles.get(after)) {
        (Some(before), Some(&next)) if instant - middles[before] > next - instant => after,
        (Some(before), _) => before,
        (None, _) => after,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_frame_is_shown() {
        let middles = [10, 20, 40];
        assert_eq!([0, 10, 15, 16, 30, 31, 90].map(|t| nearest(&middles, t)), [0, 0, 0, 1, 1, 2, 2]);
    }

    #[test]
    fn a_captured_sequence_and_a_method_are_shown_first() {
        let film = |(at, kind): (usize, &&'static str)| Film {
            kind,
            label: format!("film {at}"),
            ..Film::default()
        };
        let films = |kinds: &[&'static str]| kinds.iter().enumerate().map(film).collect::<Vec<_>>();
        assert_eq!(first_pair(&films(&["truth", "captured", "method", "method"]), None), [1, 2]);
        assert_eq!(first_pair(&films(&["truth", "captured", "method", "method"]), Some("film 3")), [1, 3]);
        assert_eq!(first_pair(&films(&["method", "method"]), None), [0, 1]);
        assert_eq!(first_pair(&films(&["captured"]), None), [0, 0]);
    }

    #[test]
    fn instants_are_those_that_every_method_has() {
        let (short, long) = (vec![10, 20, 30], vec![0, 40]);
        assert_eq!(common(&[0, 10, 20, 30, 40], [&short, &long].into_iter()), [10, 20, 30]);
        assert_eq!(common(&[0, 40], [&short].into_iter()), [0, 40]);
    }
}
