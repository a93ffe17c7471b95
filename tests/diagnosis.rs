//! `photocurrent diagnose`: from a recording to its report, and every way in which it refuses.

use crate::recordings;
use crate::support::{self, Bench, Done, executed};
use photocurrent_core::testing;
use photocurrent_store::RecordingContent;
use serde_json::Value;

fn read(bench: &Bench, name: &str) -> String {
    std::fs::read_to_string(bench.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

fn says(done: &Done, code: i32, parts: &[&str]) {
    assert_eq!(done.code, code, "{}", done.stderr);
    parts.iter().for_each(|part| assert!(done.stderr.contains(part), "`{part}` in\n{}", done.stderr));
}

#[test]
fn data_without_a_picture_are_broken_and_reported() {
    let bench = Bench::new();
    let black = testing::captured(recordings::EXTENT, recordings::exposures(4), 30_000, |_, _, _| 0.0);
    let text = std::fs::read_to_string(support::root().join("data/sensors/hybrid.toml")).expect("a sensor description");
    let content = RecordingContent { frames: Some(&black), sensor: Some(&text), ..RecordingContent::empty(recordings::EXTENT) };
    recordings::write_content(&bench.path("black.h5"), &content);
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
    recordings::write_content(&bench.path("frames.h5"), &content);
    let done = bench.run(&["diagnose", "frames.h5", "-o", "found"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert!(done.stdout.starts_with("insufficient: 0 events"), "{}", done.stdout);
}

#[test]
fn what_cannot_be_diagnosed_says_why() {
    let bench = Bench::new();
    says(&bench.run(&["diagnose", "nowhere.h5"]), 2, &["nowhere.h5", "cannot read the recording", "photocurrent-recording/1"]);
    recordings::write(&bench.path("plain.h5"), Some(&recordings::events()), Some(&recordings::frames(3)));
    says(&bench.run(&["diagnose", "plain.h5"]), 2, &["no sensor description", "--sensor"]);
    says(&bench.run(&["diagnose", "plain.h5", "--sensor", "none.toml"]), 2, &["none.toml", "cannot read"]);
    bench.write("noise.bin", "nothing that anybody knows");
    says(&bench.run(&["diagnose", "plain.h5", "--knowledge", "noise.bin"]), 2, &["noise.bin", "no knowledge"]);
    bench.write("empty.toml", "format = \"photocurrent-sensor/1\"\n");
    says(&bench.run(&["diagnose", "plain.h5", "--sensor", "empty.toml"]), 2, &["front_end.tau_0", "comparator.threshold_on", "frames.gain"]);
    assert!(!bench.path("out").exists(), "nothing is left behind");
}

#[test]
fn neither_threads_nor_the_graph_change_a_byte_and_a_second_run_has_nothing_to_do() {
    let bench = Bench::new();
    let root = support::root();
    let recording = root.join("data/sealed/recordings/75b9f397.h5");
    let done = bench.run(&["diagnose", recording.to_str().expect("a path"), "-o", "command", "--threads", "1"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let manifest = root.join("pipelines/diagnose/recording.toml").display().to_string();
    let path = format!("nodes.recording.params.path={recording:?}");
    let arguments = [manifest.as_str(), "--set", &path, "--out", "graph", "--threads", "2"];
    assert!(executed(&bench.outcome(&arguments)).contains(&"confirm".to_string()));
    for name in ["diagnosis.json", "report.html", "sensor.fitted.toml"] {
        let there = bench.path(&format!("command/{name}")).exists();
        assert_eq!(bench.path(&format!("graph/answer/{name}")).exists(), there, "{name}");
        if there {
            assert_eq!(read(&bench, &format!("graph/answer/{name}")), read(&bench, &format!("command/{name}")), "{name}");
        }
    }
    assert_eq!(executed(&bench.outcome(&arguments)), [""; 0]);
}
