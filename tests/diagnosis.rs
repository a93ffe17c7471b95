//! `photocurrent diagnose`: from a recording to its report, and every way in which it refuses.

use crate::recordings;
use crate::support::{self, Bench, Done};
use photocurrent_core::testing;
use photocurrent_store::{RecordingContent, write_recording};
use serde_json::Value;
use std::path::Path;

/// Records a texture with effects that the description in the file does not state, as `rec.h5`.
fn bench(effects: &str) -> Bench {
    let bench = Bench::new();
    let sensor = support::root().join("data/sensors/hybrid.toml");
    let pipeline = format!(
        r#"format = 1
[pipeline]
seed = 3
[nodes.sensor]
kind = "read/sensor"
params = {{ path = {sensor:?} }}
[nodes.real]
kind = "read/sensor"
params = {{ path = {sensor:?}, change = {{ effects = {{ {effects} }} }} }}
[nodes.scene]
kind = "simulate/scene"
in.sensor = "sensor"
params = {{ scene = "texture", width = 32, height = 24, duration = "90 ms", illuminance = "1000 lx" }}
[nodes.camera]
kind = "simulate/sensor"
in = {{ light = "scene.light", sensor = "real" }}
[nodes.file]
kind = "write/recording"
in = {{ events = "camera.events", frames = "camera.frames", sensor = "sensor" }}
"#
    );
    bench.write("make.toml", &pipeline);
    let done = bench.run(&["run", "make.toml", "--out", "made", "--quiet"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let written = find(&bench.path("made"), "h5").expect("a recording was written");
    std::fs::rename(written, bench.path("rec.h5")).expect("it is moved");
    bench
}

fn find(folder: &Path, extension: &str) -> Option<std::path::PathBuf> {
    std::fs::read_dir(folder).ok()?.flatten().find_map(|entry| {
        let path = entry.path();
        if path.is_dir() { find(&path, extension) } else { Some(path).filter(|path| path.extension().is_some_and(|found| found == extension)) }
    })
}

fn read(bench: &Bench, name: &str) -> String {
    std::fs::read_to_string(bench.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

fn says(done: &Done, code: i32, parts: &[&str]) {
    assert_eq!(done.code, code, "{}", done.stderr);
    parts.iter().for_each(|part| assert!(done.stderr.contains(part), "`{part}` in\n{}", done.stderr));
}

#[test]
fn a_coarser_grid_is_named_and_explained_by_the_fitted_description() {
    let bench = bench(r#"timestamp_quantization = { step = "130 us" }"#);
    let done = bench.run(&["diagnose", "rec.h5", "-o", "found", "--json"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let report: Value = serde_json::from_str(&done.stdout).expect("--json prints JSON");
    assert_eq!(report["schema"], "photocurrent-diagnosis/1");
    assert_eq!(report["verdict"], "named", "{report}");
    assert_eq!(report["effects"][0]["id"], "timestamp_quantization");
    let step = report["effects"][0]["parameters"]["step_s"]["estimate"].as_f64().expect("an estimate");
    assert!((step / 130e-6 - 1.0).abs() < 1e-3, "{step}");
    assert_eq!(read(&bench, "found/diagnosis.json"), done.stdout);
    assert!(read(&bench, "found/report.html").contains("timestamp_quantization"));
    // With the fitted description nothing is missing any more.
    assert!(read(&bench, "found/sensor.fitted.toml").contains("[effects.timestamp_quantization]"));
    std::fs::copy(bench.path("found/sensor.fitted.toml"), bench.path("fitted.toml")).expect("a copy");
    let again = bench.run(&["diagnose", "rec.h5", "--sensor", "fitted.toml", "-o", "again", "--json"]);
    let report: Value = serde_json::from_str(&again.stdout).expect("--json prints JSON");
    assert_eq!(report["verdict"], "consistent", "{report}");
    assert!(!bench.path("again/sensor.fitted.toml").exists());
}

#[test]
fn a_sound_recording_is_consistent_and_its_report_the_same_with_one_thread_or_two() {
    let bench = bench("");
    for threads in ["1", "2"] {
        let done = bench.run(&["diagnose", "rec.h5", "-o", threads, "--threads", threads]);
        assert_eq!(done.code, 0, "{}", done.stderr);
        assert!(done.stdout.starts_with("consistent: "), "{}", done.stdout);
    }
    for name in ["diagnosis.json", "report.html"] {
        assert_eq!(read(&bench, &format!("1/{name}")), read(&bench, &format!("2/{name}")), "{name}");
    }
    // A report takes the place of an earlier one, and of nothing else.
    assert_eq!(bench.run(&["diagnose", "rec.h5", "-o", "1"]).code, 0);
    bench.write("mine/notes.txt", "mine");
    says(&bench.run(&["diagnose", "rec.h5", "-o", "mine"]), 2, &["`notes.txt`", "-o FOLDER"]);
    assert_eq!(read(&bench, "mine/notes.txt"), "mine");
    says(&bench.run(&["diagnose", "rec.h5", "-o", "make.toml"]), 2, &["make.toml", "takes a folder"]);
}

#[test]
fn data_without_a_picture_are_broken_and_reported() {
    let bench = Bench::new();
    let black = testing::captured(recordings::EXTENT, recordings::exposures(4), 30_000, |_, _, _| 0.0);
    let text = std::fs::read_to_string(support::root().join("data/sensors/hybrid.toml")).expect("a sensor description");
    let content = RecordingContent { frames: Some(&black), sensor: Some(&text), ..RecordingContent::empty(recordings::EXTENT) };
    write_recording(&bench.path("black.h5"), &content).expect("the store writes it");
    let done = bench.run(&["diagnose", "black.h5", "-o", "found"]);
    assert_eq!(done.code, 3, "{}", done.stderr);
    assert!(done.stdout.starts_with("broken_data: ") && done.stdout.contains("hold no picture"), "{}", done.stdout);
    let report: Value = serde_json::from_str(&read(&bench, "found/diagnosis.json")).expect("JSON");
    assert_eq!(report["verdict"], "broken_data");
}

#[test]
fn frames_alone_are_insufficient() {
    let bench = Bench::new();
    let text = std::fs::read_to_string(support::root().join("data/sensors/hybrid.toml")).expect("a sensor description");
    let frames = recordings::frames(4);
    let content = RecordingContent { frames: Some(&frames), sensor: Some(&text), ..RecordingContent::empty(recordings::EXTENT) };
    write_recording(&bench.path("frames.h5"), &content).expect("the store writes it");
    let done = bench.run(&["diagnose", "frames.h5", "-o", "found"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert!(done.stdout.starts_with("insufficient: 0 events"), "{}", done.stdout);
}

#[test]
fn what_cannot_be_diagnosed_says_why() {
    let bench = Bench::new();
    says(&bench.run(&["diagnose", "nowhere.h5"]), 1, &["nowhere.h5"]);
    recordings::write(&bench.path("plain.h5"), Some(&recordings::events()), Some(&recordings::frames(3)));
    says(&bench.run(&["diagnose", "plain.h5"]), 2, &["no sensor description", "--sensor"]);
    says(&bench.run(&["diagnose", "plain.h5", "--sensor", "none.toml"]), 2, &["none.toml", "cannot read"]);
    bench.write("noise.bin", "nothing that anybody knows");
    says(&bench.run(&["diagnose", "plain.h5", "--knowledge", "noise.bin"]), 2, &["noise.bin", "no knowledge"]);
    bench.write("empty.toml", "format = \"photocurrent-sensor/1\"\n");
    says(&bench.run(&["diagnose", "plain.h5", "--sensor", "empty.toml"]), 2, &["front_end.tau_0", "comparator.threshold_on", "frames.gain"]);
    assert!(!bench.path("out").exists(), "nothing is left behind");
}
