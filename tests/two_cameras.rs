//! Two cameras behind a beam splitter, in colour: events that were warped onto the pictures serve as well as
//! events of the pictures' own pixels.
//!
//! A scene in closed form is seen twice: by an event array whose pixels are those of the pictures, and by one
//! with a pitch of 1.16 pixels that is turned a little. Both are written as HS-ERGB lays sequences out, one
//! picture of four is kept, and the three between are predicted.

#![allow(clippy::unwrap_used)]

use crate::disc::{self, Placed};
use crate::support::{Bench, root};
use photocurrent_sensor::forward::{LOG_STEP, LinearLight, Noiseless, Pixel, simulate_events};
use photocurrent_sensor::front_end::FrontEnd;
use std::fs;

const WIDTH: usize = 96;
const HEIGHT: usize = 72;
const FRAMES: i64 = 17;
const PERIOD_US: i64 = 6_667;
const EXPOSURE_US: i64 = 1_000;
const THRESHOLD: f64 = 0.2;

/// Red, green and blue light of a place at an instant, of 1: a bluish ground, before which a reddish disc
/// with a pattern of its own passes.
fn light(x: f64, y: f64, ms: f64) -> [f64; 3] {
    let sin = libm::sin;
    let ground = 0.35 + 0.12 * sin(0.35 * x + 0.2) * sin(0.3 * y) + 0.08 * sin(0.15 * x - 0.4 * y);
    let (dx, dy) = (x - 20.0 - 0.45 * ms, y - 30.0 - 0.08 * ms);
    let disc = 0.45 + 0.2 * sin(0.5 * dx) * sin(0.45 * dy + 0.5);
    // The edge is two pixels wide.
    let inside = 1.0 / (1.0 + libm::exp(2.0 * (libm::hypot(dx, dy) - 16.0)));
    let mix = |ground: f64, disc: f64| (1.0 - inside) * ground + inside * disc;
    [mix(0.6 * ground, disc), mix(0.8 * ground, 0.6 * disc), mix(ground, 0.4 * disc)]
}

/// Events of an array whose pixel (column, row) sees the place that `place` gives, each with that place,
/// moved by `off`.
fn events(columns: i64, rows: i64, place: impl Fn(i64, i64) -> (f64, f64), off: (f64, f64)) -> Vec<Placed> {
    let pixel = Pixel {
        front_end: FrontEnd { tau_0_s: 10e-6, alpha_s: 1e-9 },
        threshold_on: THRESHOLD,
        threshold_off: THRESHOLD,
        latency_ns: 0,
        latency_spread_ns: 0.0,
        refractory_ns: 50_000,
        log_step: LOG_STEP,
    };
    let end_ns = FRAMES * PERIOD_US * 1_000;
    let t_ns: Vec<i64> = (0..=end_ns / 200_000).map(|n| n * 200_000).collect();
    let mut all = Vec::new();
    for (column, row) in (0..columns).flat_map(|column| (0..rows).map(move |row| (column, row))) {
        let (x, y) = place(column, row);
        if !(-0.5..WIDTH as f64 - 0.5).contains(&x) || !(-0.5..HEIGHT as f64 - 0.5).contains(&y) {
            continue;
        }
        // It sees the mixture of the colours.
        let mixture: Vec<f64> =
            t_ns.iter().map(|t| light(x, y, *t as f64 * 1e-6).iter().sum::<f64>() / 3.0).collect();
        let fired = simulate_events(&pixel, &LinearLight::new(&t_ns, &mixture), 0, end_ns, &mut Noiseless);
        let at = ((32.0 * (x + off.0)).round() as i64, (32.0 * (y + off.1)).round() as i64);
        all.extend(fired.iter().map(|event| (event.t_off_ns / 1_000, at.0, at.1, event.polarity > 0)));
    }
    all.sort_unstable();
    all
}

/// A picture whose exposure begins at an instant, as 8-bit codes of sRGB.
fn picture(start_us: i64) -> Vec<u8> {
    let code = |light: f64| {
        let share =
            if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * libm::pow(light, 1.0 / 2.4) - 0.055 };
        (255.0 * share).round() as u8
    };
    let mut codes = Vec::with_capacity(3 * WIDTH * HEIGHT);
    for (y, x) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (y, x))) {
        let mut sum = [0.0; 3];
        for n in 0..5 {
            let ms = 1e-3 * (start_us as f64 + (f64::from(n) + 0.5) / 5.0 * EXPOSURE_US as f64);
            sum.iter_mut().zip(light(x as f64, y as f64, ms)).for_each(|(sum, light)| *sum += light / 5.0);
        }
        codes.extend(sum.map(code));
    }
    codes
}

/// Writes a sequence of all pictures.
fn sequence(bench: &Bench, name: &str, events: &[Placed]) {
    let frames: Vec<(i64, Vec<u8>)> = (0..FRAMES).map(|l| (l * PERIOD_US, picture(l * PERIOD_US))).collect();
    disc::hs_ergb(&bench.path(name), (WIDTH, HEIGHT), &frames, events);
}

/// How events of another array come to the pixels of the pictures.
#[derive(Clone, Copy, PartialEq)]
enum Way {
    /// Each pixel of the pictures has the events of the event pixel that sees it.
    Pixels,
    /// Solved on the event array's own pixels.
    Array,
    /// The same at places that were estimated once more.
    Estimated,
}

/// PSNR of the pictures that were not kept, dB, over all and over moving pixels: ours, and of a repetition.
fn predicted(bench: &Bench, name: &str, way: Way) -> ([[f64; 2]; 2], String) {
    let sensor = root().join("data/sensors/ideal.toml");
    let (before, events, frames, alignment) = match way {
        Way::Pixels => ("", "recording.events", "split.kept", ""),
        Way::Array => (
            r#"
[nodes.alignment]
kind = "read/alignment"
params = { path = "NAME" }
[nodes.array]
kind = "align/recording"
in = { events = "recording.events", frames = "split.kept", alignment = "alignment" }
"#,
            "array.events",
            "array.frames",
            "alignment",
        ),
        Way::Estimated => (
            r#"
[nodes.places]
kind = "read/alignment"
params = { path = "NAME" }
[nodes.array]
kind = "estimate/alignment"
in = { events = "recording.events", frames = "split.kept", alignment = "places", sensor = "sensor" }
"#,
            "array.events",
            "array.frames",
            "array.alignment",
        ),
    };
    let before = before.replace("NAME", name);
    let (after, tracks, alignment) = if way == Way::Pixels {
        (String::new(), "refine.tracks", String::new())
    } else {
        let alignment = format!(", alignment = {alignment:?}");
        let back = r#"
[nodes.back]
kind = "align/tracks"
in = { tracks = "refine.tracks", frames = "split.kept", events = "array.events"ALIGNMENT }
"#;
        (back.replace("ALIGNMENT", &alignment), "back.tracks", alignment)
    };
    let manifest = format!(
        r#"format = 1
[pipeline]
about = "Pictures between the kept ones."
[nodes.sensor]
kind = "read/sensor"
params = {{ path = {sensor:?}, change = {{ frames = {{ row_time = "0 us", saturation_dn = 255.0, black_level_dn = 0.0, gain = 1000.0 }}, comparator = {{ threshold_on = {THRESHOLD}, threshold_off = {THRESHOLD} }} }} }}
[nodes.recording]
kind = "read/hs_ergb"
params = {{ path = {name:?}, exposure = "{EXPOSURE_US} us", transfer = "srgb", stamp = "start" }}
[nodes.split]
kind = "split/frames"
in = {{ frames = "recording.frames" }}
params = {{ keep_every = 4 }}
{before}
[nodes.grey]
kind = "render/grey"
in = {{ frames = {frames:?}, events = {events:?}, sensor = "sensor" }}
[nodes.solve]
kind = "solve/map"
in = {{ events = {events:?}, frames = "grey.frames", sensor = "sensor" }}
params = {{ front_end = "ideal" }}
[nodes.refine]
kind = "refine/motion"
in = {{ tracks = "solve.tracks", events = {events:?}, frames = "grey.frames", sensor = "sensor" }}
params = {{ front_end = "ideal" }}
{after}
[nodes.render]
kind = "render/rows"
in = {{ tracks = {tracks:?}, sensor = "sensor", at = "split.held" }}
[nodes.colour]
kind = "render/colour"
in = {{ frames = "render.frames", captured = "split.kept", tracks = {tracks:?}, events = {events:?}, sensor = "sensor"{alignment} }}
[nodes.repeat]
kind = "baseline/repeat"
in = {{ frames = "split.kept", sensor = "sensor", at = "split.held" }}
[nodes.ours]
kind = "score/heldout"
in = {{ frames = "colour.frames", held = "split.held", sensor = "sensor" }}
[nodes.repeated]
kind = "score/heldout"
in = {{ frames = "repeat.frames", held = "split.held", sensor = "sensor" }}
"#
    );
    bench.write(&format!("{name}.toml"), &manifest);
    let done = bench.run(&["run", &format!("{name}.toml"), "--out", &format!("out_{name}")]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let metrics = fs::read_to_string(bench.path(&format!("out_{name}/metrics.pooled.jsonl"))).unwrap();
    let value = |node: &str, metric: &str| -> f64 {
        let is_it =
            |line: &serde_json::Value| line["node"] == node && line["metric"] == format!("heldout_{metric}");
        let mut lines = metrics.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
        lines.find(is_it).unwrap_or_else(|| panic!("{node} {metric} in {metrics}"))["value"].as_f64().unwrap()
    };
    let both =
        ["ours", "repeated"].map(|node| ["psnr_db", "psnr_moving_db"].map(|metric| value(node, metric)));
    (both, done.stderr)
}

/// Places of an array with a pitch of 1.16 pixels that is turned a little.
fn warped(column: i64, row: i64) -> (f64, f64) {
    let (x, y) = (1.16 * column as f64, 1.16 * row as f64);
    (x - 0.02 * y + 0.3, y + 0.02 * x - 1.1)
}

#[test]
fn events_of_another_camera_predict_pictures_in_colour_as_well_as_those_of_the_same_pixels() {
    let bench = Bench::new();
    let own = events(WIDTH as i64, HEIGHT as i64, |x, y| (x as f64, y as f64), (0.0, 0.0));
    sequence(&bench, "aligned", &own);
    sequence(&bench, "warped", &events(90, 68, warped, (0.0, 0.0)));
    let seen = bench.run(&["inspect", "warped"]);
    assert!(seen.stdout.contains("with a pitch of 1.16"), "{} {}", seen.stdout, seen.stderr);
    let ([aligned, repeated], _) = predicted(&bench, "aligned", Way::Pixels);
    let ([by_pixels, _], _) = predicted(&bench, "warped", Way::Pixels);
    let ([warped, _], _) = predicted(&bench, "warped", Way::Array);
    let figures = format!(
        "aligned {aligned:.2?}, warped {warped:.2?}, by pixels {by_pixels:.2?}, repeated {repeated:.2?} dB"
    );
    println!("{figures}");
    // A decibel is what another geometry may cost; repetition shows that there is something to predict.
    for n in [0, 1] {
        assert!(warped[n] > aligned[n] - 1.0, "{figures}");
        assert!(aligned[n] > repeated[n] + 6.0, "{figures}");
    }
}

#[test]
fn places_that_are_off_by_a_pixel_are_estimated_from_events_and_kept_pictures() {
    let bench = Bench::new();
    sequence(&bench, "off", &events(90, 68, warped, (0.9, -0.6)));
    let ([off, _], _) = predicted(&bench, "off", Way::Array);
    let ([found, _], notes) = predicted(&bench, "off", Way::Estimated);
    println!("off by (0.9, -0.6): {off:.2?}, estimated {found:.2?} dB\n{notes}");
    assert!(notes.contains("array: places moved: a shift of -0.9"), "{notes}");
    // A pixel costs five decibels where something moves.
    assert!(found[0] > off[0] + 3.0 && found[1] > off[1] + 3.0, "{off:?} {found:?}");
    // Places that are right stay, to the bit.
    sequence(&bench, "right", &events(90, 68, warped, (0.0, 0.0)));
    let ([right, _], _) = predicted(&bench, "right", Way::Array);
    let ([kept, _], notes) = predicted(&bench, "right", Way::Estimated);
    assert!(notes.contains("array: the alignment stays") && kept == right, "{right:?} {kept:?} {notes}");
}

#[test]
fn events_and_frames_of_one_real_array_stay_where_they_are() {
    let bench = Bench::new();
    for clip in ["cradle", "traffic"] {
        let path = root().join(format!("data/recordings/davis346_{clip}.aedat4"));
        let manifest = format!(
            r#"format = 1
[pipeline]
about = "One array."
[nodes.recording]
kind = "read/aedat4"
params = {{ path = {path:?} }}
[nodes.array]
kind = "estimate/alignment"
in = {{ events = "recording.events", frames = "recording.frames" }}
"#
        );
        bench.write("one.toml", &manifest);
        let done = bench.run(&["run", "one.toml"]);
        assert_eq!(done.code, 0, "{}", done.stderr);
        assert!(done.stderr.contains("array: the alignment stays"), "{}", done.stderr);
    }
}
