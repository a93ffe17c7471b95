//! Colour through the command: from a scene to pictures by way of a recording on disk, whatever the bands.

use crate::support::{self, Bench, digests};
use std::collections::BTreeMap;

/// A disk of coloured sectors behind a Bayer mosaic, an event pixel on each 2 x 2 of its pixels.
fn pipeline() -> String {
    let sensor = support::root().join("data/sensors/hybrid.toml");
    format!(
        r#"format = 1
[nodes.sensor]
kind = "read/sensor"
params = {{ path = {sensor:?}, change = {{ optics = {{ event_weights = [0.3, 0.6, 0.1] }}, frames = {{ channel_gain = [0.8, 1.0, 0.6] }} }} }}
[nodes.scene]
kind = "simulate/scene"
in.sensor = "sensor"
params = {{ scene = "colour_wheel", colour = "bayer_rggb", width = 24, height = 20, duration = "40 ms" }}
[nodes.camera]
kind = "simulate/sensor"
in = {{ light = "scene.light", sensor = "sensor" }}
params = {{ pixels_per_event_pixel = 2 }}
[nodes.file]
kind = "write/recording"
in = {{ events = "camera.events", frames = "camera.frames", sensor = "sensor", truth = "scene.truth" }}
"#
    )
}

/// From the file that [`pipeline`] wrote.
const SOLVE: &str = r#"format = 1
[nodes.recording]
kind = "read/recording"
params = { path = "out/m/file/recording.h5" }
[nodes.solve]
kind = "solve/paper"
in = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }
params = { evs_weight = 1000.0 }
[nodes.map]
kind = "solve/map"
in = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }
params = { max_iterations = 2 }
[nodes.render]
kind = "render/rows"
in = { tracks = "solve.tracks", sensor = "recording.sensor" }
[nodes.edi]
kind = "baseline/edi"
in = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }
[nodes.colours]
kind = "render/demosaic"
in = { frames = "render" }
[nodes.psnr]
kind = "score/psnr"
in = { frames = "render", truth = "recording.truth", sensor = "recording.sensor" }
[nodes.sheet]
kind = "write/contact_sheet"
in = { frames = ["recording.frames", "colours"], events = "recording.events" }
params = { labels = ["captured", "in colour"] }
"#;

fn run(bench: &Bench, how: &[&str]) -> BTreeMap<String, String> {
    digests(&bench.outcome(&[&["solve.toml", "--cache"], how].concat()))
}

#[test]
fn a_mosaic_comes_back_from_disk_and_is_solved_alike_in_every_band() {
    let bench = Bench::new();
    bench.write("m.toml", &pipeline());
    bench.write("solve.toml", SOLVE);
    let simulated = digests(&bench.outcome(&["m.toml"]));
    let banded =
        digests(&bench.outcome(&["m.toml", "--cache", "again", "--band-rows", "3", "--threads", "2"]));
    assert_eq!(simulated, banded);
    let whole = run(&bench, &["whole", "--threads", "1"]);
    assert_eq!(simulated["camera.frames"], whole["recording.frames"]);
    // A block of two rows shares an event pixel: bands cut through it.
    for rows in ["1", "3"] {
        assert_eq!(
            run(&bench, &[&format!("band{rows}"), "--threads", "2", "--band-rows", rows]),
            whole,
            "bands of {rows} rows"
        );
    }
    assert!(
        whole.contains_key("colours.frames")
            && whole.contains_key("map.tracks")
            && whole.contains_key("edi.frames"),
        "{:?}",
        whole.keys()
    );
    assert!(bench.path("out/solve/sheet/contact_sheet.png").is_file());
}

#[test]
fn what_takes_no_colour_says_so_and_names_what_does() {
    let bench = Bench::new();
    let node = |kind: &str, frames: &str| {
        format!("{}[nodes.last]\nkind = \"{kind}\"\nin = {{ {frames} }}\n", pipeline())
    };
    let both = "events = \"camera.events\", frames = \"camera.frames\", sensor = \"sensor\"";
    for (kind, inputs, expected) in [
        (
            "baseline/akf",
            both,
            "baseline/akf works on grey frames of the events' pixels, and these are \
                                bayer_rggb with 2 x 2 pixels on each event pixel",
        ),
        ("baseline/contrast", both, "baseline/contrast works on grey frames of the events' pixels"),
        (
            "score/ssim",
            "frames = \"camera.frames\", truth = \"scene.truth\"",
            "the frames are a bayer_rggb mosaic, and a window of SSIM takes neighbours",
        ),
    ] {
        bench.write("bad.toml", &node(kind, inputs));
        let done = bench.run(&["run", "bad.toml"]);
        assert_eq!(done.code, 2, "{}", done.stderr);
        assert!(done.stderr.contains(expected), "{}", done.stderr);
    }
}

/// An event pixel sees a mixture whose steps are not those of any channel. A solver that took every event for
/// a step of each channel would be worse than the double integral here (by 1 dB on this disk); one that knows
/// from the frames how much a pixel's colour changes is far better.
#[test]
fn the_map_estimate_of_changing_colours_is_not_misled_by_events_of_their_mixture() {
    let bench = Bench::new();
    let scene = pipeline()
        .replace("bayer_rggb", "rgb")
        .replace("duration = \"40 ms\"", "duration = \"80 ms\"")
        .replace("width = 24", "width = 32");
    let scene = scene.replace("pixels_per_event_pixel = 2", "pixels_per_event_pixel = 1");
    let inputs = "events = \"camera.events\", frames = \"camera.frames\", sensor = \"sensor\"";
    let methods = format!(
        r#"[nodes.map]
kind = "solve/map"
in = {{ {inputs} }}
params = {{ }}
[nodes.render]
kind = "render/rows"
in = {{ tracks = "map.tracks", sensor = "sensor" }}
params = {{ end = "75 ms" }}
[nodes.edi]
kind = "baseline/edi"
in = {{ {inputs} }}
params = {{ end = "75 ms" }}
[nodes.psnr]
kind = "score/psnr"
in = {{ frames = "render", truth = "scene.truth", sensor = "sensor" }}
[nodes.psnr_edi]
kind = "score/psnr"
in = {{ frames = "edi", truth = "scene.truth", sensor = "sensor" }}
"#
    );
    bench.write("m.toml", &(scene + &methods));
    bench.outcome(&["m.toml"]);
    let pooled = std::fs::read_to_string(bench.path("out/m/metrics.pooled.jsonl")).expect("pooled metrics");
    let psnr = |node: &str| -> f64 {
        let lines = pooled
            .lines()
            .map(|line| serde_json::from_str::<serde_json::Value>(line).expect("a line of JSON"));
        lines.into_iter().find(|line| line["node"] == node).expect("the node's line")["value"]
            .as_f64()
            .expect("a number")
    };
    let (map, edi) = (psnr("psnr"), psnr("psnr_edi"));
    assert!(map > edi + 3.0, "map {map} dB, EDI {edi} dB");
}
