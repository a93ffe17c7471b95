//! Single pixels of the first run: what was recorded of them, and what each solver made of it.

use super::films::sensor;
use super::run::{Output, Run, Styles};
use crate::failure::{Failure, usage};
use photocurrent_core::{NodeError, TimeSpan, Value};
use photocurrent_nodes::show::{Photocurrent, Seen, Shown, Tone, lively, seen, solved};
use photocurrent_page::{Bar, Event, Group, Pixel, Residual, RunPage, Solved};

/// Followed when none is named.
const USUAL: usize = 8;

/// Adds the pixels.
pub fn follow(
    run: &Run,
    asked: &[(u32, u32)],
    styles: &mut Styles,
    page: &mut RunPage,
) -> Result<(), Failure> {
    let Some(group) = page.groups.first().cloned() else {
        page.pixel_notes.push("No pixel is followed: there are no pictures to pick it from.".into());
        return Ok(());
    };
    let (width, height) = (group.width * group.shrink, group.height * group.shrink);
    if let Some((x, y)) = asked.iter().find(|(x, y)| *x >= width || *y >= height) {
        return Err(usage(format!(
            "--pixel {x},{y}: the pixel is outside, the pictures have {width} x {height}\n  hint: keep x \
             below {width}, and y below {height}"
        )));
    }
    let stored = Stored::load(run, height as usize);
    let Some(sensor) = sensor(run) else {
        page.pixel_notes.push(
            "No sensor description is stored with the run, so no voltages are shown: connect `read/sensor`, \
             or a recording with a description."
                .into(),
        );
        return Ok(());
    };
    let captured = stored.frames.iter().find(|shown| shown.is_captured());
    let Some(first) = stored.frames.iter().find(|shown| shown.is_truth()).or(captured) else {
        return Ok(());
    };
    let failed = |error: NodeError| Failure::other(format!("a pixel cannot be followed: {error}"));
    let mut tone = Tone::of(first, Some(&sensor)).map_err(failed)?;
    (tone.black, tone.white) = (group.black, group.white);
    let places = match (asked, &stored.events) {
        ([], Some(events)) => lively(events, USUAL).map_err(failed)?,
        _ => asked.to_vec(),
    };
    if places.is_empty() {
        page.pixel_notes.push(
            "The cache holds no events of the run at the size of its pictures: name pixels with `--pixel \
             X,Y` to follow their frames and photocurrent."
                .into(),
        );
    }
    if stored.tracks.is_empty() {
        page.pixel_notes.push(
            "The cache holds no photocurrent of single pixels: `solve/map` gives it, and `pipeline.keep = \
             [\"NODE.tracks\"]` stores what nothing else takes."
                .into(),
        );
    }
    for (x, y) in places {
        let seen = seen(stored.events.as_ref(), captured, &sensor, &tone, x, y).map_err(failed)?;
        let mut pixel = pixel(&seen, &group, x, y);
        for (value, label) in &stored.tracks {
            if let Some(found) = solved(value, &seen, &sensor, x, y).map_err(failed)? {
                pixel.solved.push(shown(found, &group, label, styles.of(label)));
            }
        }
        page.pixels.push(pixel);
    }
    Ok(())
}

/// What the cache has of a run at the size of its pictures.
struct Stored {
    events: Option<Value>,
    /// The truth first.
    frames: Vec<Shown>,
    /// Photocurrents, each with its label.
    tracks: Vec<(Value, String)>,
}

impl Stored {
    fn load(run: &Run, height: usize) -> Stored {
        let has_size = |value: &Value| value.meta().rows().map(|rows| rows.len()) == Some(height);
        let load = |data_type: &str| {
            let values =
                outputs(run, data_type).into_iter().filter_map(|(output, _)| run.value(&output).ok());
            values.filter(has_size).collect::<Vec<_>>()
        };
        let frames = load("truth").into_iter().chain(load("frames")).filter_map(Shown::of).collect();
        let mut tracks = tracks(run, outputs(run, "tracks"));
        tracks.retain(|(value, _)| has_size(value));
        Stored { events: load("events").into_iter().next(), frames, tracks }
    }
}

/// Outputs of a type with their labels, each once; tracks are called as the frames rendered from them.
fn outputs(run: &Run, data_type: &str) -> Vec<(Output, String)> {
    let mut found: Vec<(Output, String)> = Vec::new();
    for variant in run.variants() {
        for output in run.outputs(variant, data_type) {
            if !found.iter().any(|(known, _)| *known == output) {
                let rendered = (data_type == "tracks").then(|| followed_by(run, &output)).flatten();
                let label = run.label_in(rendered.as_ref().unwrap_or(&output), variant);
                found.push((output, label));
            }
        }
    }
    found
}

/// The first block of the frames that are rendered from tracks, where those are joined; a label; the tracks,
/// with their shares of time.
type Found = (Option<Output>, String, Vec<(Value, TimeSpan)>);

/// Tracks that can be had; those of blocks of time as one, as the frames that are rendered from them.
fn tracks(run: &Run, outputs: Vec<(Output, String)>) -> Vec<(Value, String)> {
    let mut found: Vec<Found> = Vec::new();
    for (output, label) in outputs {
        let Ok(value) = run.value(&output) else { continue };
        let (first, share) = followed_by(run, &output).and_then(|shown| run.share(&shown)).unzip();
        let part = (value, share.unwrap_or(TimeSpan::new(i64::MIN, i64::MAX)));
        match found.iter_mut().find(|(known, ..)| first.is_some() && *known == first) {
            Some((.., parts)) => parts.push(part),
            None => found.push((first, label, vec![part])),
        }
    }
    let joined = |(_, label, parts): Found| Some((Value::joined_in_time(parts).ok()?, label));
    found.into_iter().filter_map(joined).collect()
}

/// The frames that are rendered from tracks.
fn followed_by(run: &Run, tracks: &Output) -> Option<Output> {
    let takes = |task: usize| run.record.tasks[task].inputs.iter().any(|input| input.from.contains(tracks));
    let renders = (0..run.record.tasks.len())
        .find(|&task| run.record.tasks[task].kind.starts_with("render/") && takes(task))?;
    let port = run.record.tasks[renders].outputs.iter().find(|(_, stored)| stored.data_type == "frames")?;
    Some((renders, port.0.clone()))
}

/// The time that the charts show, with some room, ns.
fn span(group: &Group) -> std::ops::RangeInclusive<i64> {
    let (first, last) =
        (group.instants_ns.first().copied().unwrap_or(0), group.instants_ns.last().copied().unwrap_or(0));
    let room = (last - first) / 20;
    first - room..=last + room
}

fn pixel(seen: &Seen, group: &Group, x: u32, y: u32) -> Pixel {
    let span = span(group);
    let events = seen.events.iter().filter(|(t, _)| span.contains(t)).map(|&(t_ns, on)| Event { t_ns, on });
    let exposures =
        seen.exposures.iter().filter(|one| span.contains(&one.start_ns) || span.contains(&one.end_ns));
    let bar = |one: &photocurrent_nodes::show::Exposed| Bar {
        frame: one.frame,
        from_ns: one.start_ns,
        to_ns: one.end_ns,
        dn: one.dn,
        shown_dn: one.shown_dn,
    };
    Pixel { x, y, events: events.collect(), exposures: exposures.map(bar).collect(), solved: Vec::new() }
}

fn shown(found: Photocurrent, group: &Group, label: &str, style: usize) -> Solved {
    let span = span(group);
    let short = |value: f64| format!("{value:.4}").parse().unwrap_or(value);
    let curve = |points: Vec<(i64, f64)>| {
        points.into_iter().filter(|(t, _)| span.contains(t)).map(|(t, v)| (t, short(v))).collect::<Vec<_>>()
    };
    let residuals = |points: Vec<(i64, f64)>| {
        curve(points).into_iter().map(|(t_ns, value)| Residual { t_ns, value }).collect()
    };
    Solved {
        label: label.into(),
        style,
        is_held: found.is_held,
        knots: curve(found.knots),
        band: found
            .band
            .into_iter()
            .filter(|(t, ..)| span.contains(t))
            .map(|(t, low, high)| (t, short(low), short(high)))
            .collect(),
        front_end: curve(found.front_end),
        frame_residuals: residuals(found.frame_residuals),
        event_residuals: residuals(found.event_residuals),
    }
}
