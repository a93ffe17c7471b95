//! `photocurrent diagnose`: from a recording to its report, and every way in which it refuses.

use crate::recordings;
use crate::support::{self, Bench, Done, executed};
use photocurrent_core::testing;
use photocurrent_store::RecordingContent;
use serde_json::Value;
use std::collections::BTreeMap;

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
    let text = std::fs::read_to_string(support::root().join("data/sensors/hybrid.toml"))
        .expect("a sensor description");
    let content = RecordingContent {
        frames: Some(&black),
        sensor: Some(&text),
        ..RecordingContent::empty(recordings::EXTENT)
    };
    recordings::write_content(&bench.path("black.h5"), &content);
    let done = bench.run(&["diagnose", "black.h5", "-o", "found"]);
    assert_eq!(done.code, 3, "{}", done.stderr);
    assert!(
        done.stdout.starts_with("broken_data: ") && done.stdout.contains("hold no picture"),
        "{}",
        done.stdout
    );
    let report: Value = serde_json::from_str(&read(&bench, "found/diagnosis.json")).expect("JSON");
    assert_eq!(report["verdict"], "broken_data");
}

#[test]
fn frames_alone_are_insufficient() {
    let bench = Bench::new();
    let text = std::fs::read_to_string(support::root().join("data/sensors/hybrid.toml"))
        .expect("a sensor description");
    let frames = recordings::frames(4);
    let content = RecordingContent {
        frames: Some(&frames),
        sensor: Some(&text),
        ..RecordingContent::empty(recordings::EXTENT)
    };
    recordings::write_content(&bench.path("frames.h5"), &content);
    let done = bench.run(&["diagnose", "frames.h5", "-o", "found"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert!(done.stdout.starts_with("insufficient: 0 events"), "{}", done.stdout);
}

/// A real camera. What was read off the clip otherwise: the camera's own triggers say that a readout of 260
/// rows takes 9.18 ms, 35.3 us a row, right after the exposure; no two events of a pixel and sign are closer
/// than 0.97 ms; pixels that stand still have 2 to 4 ON events in a thousand seconds; events follow frames by
/// milliseconds; held-out frames are predicted best with smaller thresholds.
#[test]
fn a_davis_camera_couples_leaks_is_blind_late_and_more_sensitive_than_stated() {
    let bench = Bench::new();
    let clip = support::root().join("data/recordings/davis346_traffic.aedat4");
    let sheet = support::root().join("data/sensors/davis346_sheet.toml");
    let done = bench.run(&["diagnose", clip.to_str().expect("UTF-8"), "--direct"]);
    says(&done, 2, &["no sensor description", "--sensor"]);
    let done = bench.run(&[
        "diagnose",
        clip.to_str().expect("UTF-8"),
        "--direct",
        "--sensor",
        sheet.to_str().expect("UTF-8"),
        "-o",
        "found",
    ]);
    says(&done, 0, &["t = 0 is 1589163147364965 us on the clock of davis346_traffic.aedat4"]);
    let report: Value = serde_json::from_str(&read(&bench, "found/diagnosis.json")).expect("JSON");
    let effects = report["effects"].as_array().expect("effects");
    let number = |id: &str, key: &str| {
        let effect = effects
            .iter()
            .find(|effect| effect["id"] == id)
            .unwrap_or_else(|| panic!("{id} in {}", report["summary"]));
        assert!(effect["evidence"]["heldout_nats"].as_f64().expect("a gain") > 30.0, "{effect}");
        effect["parameters"][key]["estimate"].as_f64().unwrap_or_else(|| panic!("{key} in {effect}"))
    };
    assert_eq!(effects.len(), 5, "{}", report["summary"]);
    assert!((number("frame_coupling", "row_time_s") - 35.3e-6).abs() < 0.3e-6);
    assert!((0.0..1e-3).contains(&number("frame_coupling", "phase_s")));
    assert!((0.7e-3..1.4e-3).contains(&number("refractory", "refractory_s")));
    assert!((0.002..0.004).contains(&number("leak_events", "rate_hz")));
    assert!((1e-3..7e-3).contains(&number("clock_offset", "offset_s")));
    // Thresholds of 0.25 to 0.35 for the stated 0.49 and 0.46 predict held-out frames best.
    assert!((-0.45..-0.25).contains(&number("threshold_scale", "fraction")));
    let fitted = read(&bench, "found/sensor.fitted.toml");
    for part in ["[effects.frame_coupling]", "row_time", "[effects.leak_events]", "[effects.clock_offset]"] {
        assert!(fitted.contains(part), "`{part}` in\n{fitted}");
    }
}

/// What was read off the clip without this program (data/README.md): events agree with frames best 5 ms
/// later, the wait for a threshold included, and the log change for an event is 0.31 to 0.6.
#[test]
fn a_dim_davis_camera_is_late_more_sensitive_and_has_a_dark_current_where_held_out_frames_agree() {
    let bench = Bench::new();
    let pipeline = support::root().join("pipelines/cradle.toml");
    let found = |least_better_db: &str| -> Value {
        let set = format!("nodes.confirm.params.least_better_db={least_better_db}");
        let done = bench.run(&[
            "run",
            pipeline.to_str().expect("UTF-8"),
            "--to",
            "answer",
            "--set",
            &set,
            "--out",
            "found",
        ]);
        assert_eq!(done.code, 0, "{}", done.stderr);
        serde_json::from_str(&read(&bench, "found/answer/diagnosis.json")).expect("JSON")
    };
    let report = found("1.0");
    let number = |id: &str, key: &str| {
        let effect =
            report["effects"].as_array().and_then(|all| all.iter().find(|effect| effect["id"] == id));
        effect
            .and_then(|effect| effect["parameters"][key]["estimate"].as_f64())
            .unwrap_or_else(|| panic!("{id} in {}", report["summary"]))
    };
    assert!((1e-3..5e-3).contains(&number("clock_offset", "offset_s")));
    // The dark half of the clip is below 25 DN, and 1 is 1 DN.
    assert!((2.5..25.0).contains(&number("dark_current", "current")));
    // 0.28 to 0.4 for the stated 0.49 and 0.46, as a dark current leaves less to the thresholds.
    assert!((-0.43..-0.15).contains(&number("threshold_scale", "fraction")));
    let none = found("50.0");
    let is_named =
        |id: &str| none["effects"].as_array().expect("effects").iter().any(|effect| effect["id"] == id);
    assert!(
        !["clock_offset", "dark_current", "threshold_scale"].into_iter().any(is_named),
        "{}",
        none["summary"]
    );
}

#[test]
fn what_cannot_be_diagnosed_says_why() {
    let bench = Bench::new();
    says(
        &bench.run(&["diagnose", "nowhere.h5"]),
        2,
        &["nowhere.h5", "cannot read the recording", "docs/recordings.md"],
    );
    recordings::write(&bench.path("plain.h5"), Some(&recordings::events()), Some(&recordings::frames(3)));
    says(&bench.run(&["diagnose", "plain.h5"]), 2, &["no sensor description", "--sensor"]);
    says(&bench.run(&["diagnose", "plain.h5", "--sensor", "none.toml"]), 2, &["none.toml", "cannot read"]);
    bench.write("empty.toml", "format = \"photocurrent-sensor/1\"\n");
    says(
        &bench.run(&["diagnose", "plain.h5", "--sensor", "empty.toml"]),
        2,
        &["comparator.threshold_on", "frames.gain", "photocurrent init"],
    );
    assert!(!bench.path("out").exists(), "nothing is left behind");
}

#[test]
fn neither_threads_nor_the_graph_change_a_byte_and_a_second_run_has_nothing_to_do() {
    let bench = Bench::new();
    let root = support::root();
    let recording = root.join("data/concealed/recordings/0ca5a116.h5");
    let done = bench.run(&[
        "diagnose",
        recording.to_str().expect("a path"),
        "-o",
        "command",
        "--threads",
        "1",
        "--cache",
        "of the command",
    ]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let manifest = root.join("pipelines/diagnose/recording.toml").display().to_string();
    let path = format!("nodes.recording.params.path={recording:?}");
    let named = "nodes.answer.params.recording=\"0ca5a116.h5\"";
    let arguments = [
        manifest.as_str(),
        "--set",
        &path,
        "--set",
        named,
        "--out",
        "graph",
        "--threads",
        "2",
        "--to",
        "answer",
    ];
    assert!(executed(&bench.outcome(&arguments)).contains(&"confirm".to_string()));
    for name in ["diagnosis.json", "report.html", "sensor.fitted.toml"] {
        let there = bench.path(&format!("command/{name}")).exists();
        assert_eq!(bench.path(&format!("graph/answer/{name}")).exists(), there, "{name}");
        if there {
            assert_eq!(
                read(&bench, &format!("graph/answer/{name}")),
                read(&bench, &format!("command/{name}")),
                "{name}"
            );
        }
    }
    assert_eq!(executed(&bench.outcome(&arguments)), [""; 0]);
    // The examination's stages have the same keys, so that only the judgement is left to do.
    let concealed = root.join("pipelines/diagnose/concealed.toml").display().to_string();
    let examined = bench.outcome(&[
        &concealed,
        "--variant",
        "recording=0ca5a116",
        "--to",
        "right",
        "--out",
        "concealed",
    ]);
    assert_eq!(executed(&examined), ["right"]);
    let table = bench.run(&[
        "table",
        "concealed",
        "--rows",
        "card.truth",
        "--columns",
        "card.said",
        "--metric",
        "count",
        "--sum",
    ]);
    assert_eq!(table.code, 0, "{}", table.stderr);
    assert!(table.stdout.contains("none"), "{}", table.stdout);
}

/// Another description than the recording's own, which also states the row time that the frames do not; the
/// stages of an earlier run come from the cache.
#[test]
fn a_description_next_to_the_recording_counts_and_a_second_run_is_read_from_the_cache() {
    let bench = Bench::new();
    let text = std::fs::read_to_string(support::root().join("data/sensors/hybrid.toml"))
        .expect("a sensor description");
    bench.write("mine.toml", &text);
    let frames = recordings::frames(4);
    let content = RecordingContent {
        events: Some(&recordings::events()),
        frames: Some(&frames),
        ..RecordingContent::empty(recordings::EXTENT)
    };
    recordings::write_content(&bench.path("plain.h5"), &content);
    let run = |out: &str| {
        let done =
            bench.run(&["diagnose", "plain.h5", "--sensor", "mine.toml", "-o", out, "--progress", "json"]);
        assert_eq!(done.code, 0, "{}", done.stderr);
        let count = |end: &str| {
            done.stderr.lines().filter(|line| line.contains(&format!("\"end\":\"{end}\""))).count()
        };
        (count("done"), count("reused"), read(&bench, &format!("{out}/diagnosis.json")))
    };
    // In the same folder: the second report takes the place of the first.
    let (first, second) = (run("found"), run("found"));
    assert!(first.0 >= 5 && first.1 == 0, "{first:?}");
    // Files are written anew, and nothing else is done.
    assert!(second.0 <= 1 && second.0 + second.1 == first.0, "{second:?}");
    assert_eq!(first.2, second.2);
    let names: Vec<_> = std::fs::read_dir(bench.path("found"))
        .expect("the folder")
        .flatten()
        .map(|entry| entry.file_name())
        .collect();
    assert!(
        names.iter().all(|name| ["diagnosis.json", "report.html", "sensor.fitted.toml"]
            .iter()
            .any(|own| name == own)),
        "{names:?}"
    );
}

#[test]
fn a_cache_that_cannot_be_opened_is_reported_and_the_answer_comes_all_the_same() {
    let bench = Bench::new();
    let text = std::fs::read_to_string(support::root().join("data/sensors/hybrid.toml"))
        .expect("a sensor description");
    let frames = recordings::frames(4);
    let content = RecordingContent {
        frames: Some(&frames),
        sensor: Some(&text),
        ..RecordingContent::empty(recordings::EXTENT)
    };
    recordings::write_content(&bench.path("frames.h5"), &content);
    bench.write("occupied", "a file where a folder should be");
    let done = bench.run(&["diagnose", "frames.h5", "-o", "found", "--cache", "occupied"]);
    says(&done, 0, &["nothing is kept for later runs", "occupied"]);
    assert!(done.stdout.starts_with("insufficient"), "{}", done.stdout);
}

/// After `init` of these files as `my.toml`: `diagnose` ends in a report, with the description by itself and
/// with the manifest, without an edit. The report by the manifest.
pub fn follows_init(bench: &Bench, files: &[&str]) -> Value {
    reported(bench, &[files, &["--sensor", "my.sensor.toml"]].concat());
    reported(bench, &["my.toml"])
}

/// The report of a diagnosis with a description by `init`, which lists what is left out.
fn reported(bench: &Bench, arguments: &[&str]) -> Value {
    let done = bench.run(&[&["diagnose"], arguments, &["-o", "found"]].concat());
    assert_eq!(done.code, 0, "{arguments:?}\n{}", done.stderr);
    assert!(
        done.stdout.contains("not tested: time_constant") && bench.path("found/report.html").is_file(),
        "{}",
        done.stdout
    );
    let report: Value = serde_json::from_str(&read(bench, "found/diagnosis.json")).expect("JSON");
    let left_out = report["not_testable"].as_array().expect("a list");
    for id in ["time_constant", "threshold_mismatch"] {
        let why = left_out
            .iter()
            .find(|one| one["id"] == id)
            .and_then(|one| one["why"].as_str())
            .unwrap_or_else(|| panic!("{id} in {report}"));
        for part in ["front_end.tau_0 and front_end.alpha are not stated", "would add", "maker's sheet"] {
            assert!(why.contains(part), "`{part}` in {why}");
        }
    }
    assert!(
        report["next_experiment"].to_string().contains("state front_end.tau_0 and front_end.alpha"),
        "{}",
        report["next_experiment"]
    );
    report
}

/// The whole of both real clips; nobody edits what `init` proposes.
#[test]
fn a_diagnosis_follows_init_on_real_clips() {
    for (clip, found) in [("davis346_traffic", "frame_coupling"), ("davis346_cradle", "")] {
        let bench = Bench::new();
        let path = support::root().join(format!("data/recordings/{clip}.aedat4")).display().to_string();
        assert_eq!(bench.run(&["init", &path, "-o", "my.toml"]).code, 0, "{clip}");
        let report = reported(&bench, &[&path, "--sensor", "my.sensor.toml"]);
        let ids: Vec<&str> = report["effects"]
            .as_array()
            .expect("effects")
            .iter()
            .filter_map(|effect| effect["id"].as_str())
            .collect();
        assert!(found.is_empty() || ids.contains(&found), "{clip}: {ids:?}");
        // Nothing is named that needs the front end.
        assert!(!ids.contains(&"time_constant") && !ids.contains(&"second_pole"), "{clip}: {ids:?}");
    }
}

/// The pooled scores of a run, by node and metric.
fn scores(bench: &Bench, folder: &str) -> BTreeMap<(String, String), f64> {
    let text = read(bench, &format!("{folder}/metrics.pooled.jsonl"));
    let lines = text.lines().map(|line| serde_json::from_str::<Value>(line).expect("a JSON object a line"));
    let text = |line: &Value, key: &str| line[key].as_str().expect("a text").to_string();
    lines
        .map(|line| ((text(&line, "node"), text(&line, "metric")), line["value"].as_f64().expect("a number")))
        .collect()
}

/// A texture, seen by a sensor that is blind for 50 us, and stated to be so for 700 us. At 4 pixels a
/// millisecond held-out frames prefer the true time to any longer one; at 8 they prefer 2 ms to it.
fn hidden_refractory(more: &str) -> String {
    let path = support::root().join("data/sensors/hybrid.toml");
    let sensor = |name: &str, refractory: &str| {
        let change = format!(
            "comparator = {{ threshold_on = 0.1, threshold_off = 0.105 }}, readout = \
                              {{ refractory = \"{refractory}\" }}"
        );
        format!(
            "[nodes.{name}]\nkind = \"read/sensor\"\nparams = \
                 {{ path = {path:?}, change = {{ {change} }} }}\n"
        )
    };
    let parts = [
        "format = 1\n[pipeline]\nseed = 1\n".into(),
        sensor("stated", "700 us"),
        sensor("actual", "50 us"),
        "[nodes.scene]\nkind = \"simulate/scene\"\nin = { sensor = \"stated\" }\n".into(),
        "params = { scene = \"texture\", width = 40, height = 30, duration = \"60 ms\", illuminance = \"800 \
         lx\", texture = { speed = 4.0 } }\n"
            .into(),
        "[nodes.recording]\nkind = \"simulate/sensor\"\nin = \
         { light = \"scene.light\", sensor = \"actual\" }\n"
            .into(),
        more.into(),
    ];
    parts.concat()
}

#[test]
fn the_fitted_description_gives_back_the_true_light_better_than_the_stated_one() {
    let bench = Bench::new();
    let streams = "events = \"recording.events\", frames = \"recording.frames\"";
    let diagnosis = format!(
        "[nodes.integrity]\nkind = \"diagnose/integrity\"\nin = {{ {streams}, sensor = \"stated\" }}\n\
         [nodes.confirm]\nkind = \"diagnose/confirm\"\nin = {{ {streams}, sensor = \"stated\", integrity = \
         \"integrity.findings\" }}\n\
         [nodes.answer]\nkind = \"write/diagnosis\"\nin = \
                                  {{ report = \"confirm.report\", page = \"confirm.page\", sensor = \
                                                \"confirm.sensor\" }}\n"
    );
    let manifest = bench.write("diagnosis.toml", &hidden_refractory(&diagnosis)).display().to_string();
    bench.outcome(&[&manifest]);
    let report: Value =
        serde_json::from_str(&read(&bench, "out/diagnosis/answer/diagnosis.json")).expect("JSON");
    assert_eq!(report["summary"], "refractory");
    // Held-out frames agree better after than before.
    let of = |when: &str| {
        report["fit"]["heldout_frame_psnr_db"][when].as_f64().unwrap_or_else(|| panic!("{when} in {report}"))
    };
    assert!(of("after") > of("before") + 3.0, "{report}");
    // The description that was written is read, simulates, and solves.
    let solved = |name: &str| {
        format!(
            "[nodes.solve_{name}]\nkind = \"solve/map\"\nin = {{ {streams}, sensor = \"{name}\" }}\n\
             [nodes.render_{name}]\nkind = \"render/rows\"\nin = {{ tracks = \"solve_{name}.tracks\", sensor \
             = \"stated\" }}\n\
             params = {{ rate = \"1 kHz\", exposure = \"100 us\", end = \"56 ms\" }}\n\
             [nodes.psnr_{name}]\nkind = \"score/psnr\"\nin = {{ frames = \"render_{name}\", truth = \
             \"scene.truth\", sensor = \"stated\" }}\n\
             params = {{ region = \"moving\" }}\n"
        )
    };
    let again = "[nodes.fitted]\nkind = \"read/sensor\"\nparams = \
                 { path = \"out/diagnosis/answer/sensor.fitted.toml\" }\n\
                 [nodes.again]\nkind = \"simulate/sensor\"\nin = \
                                         { light = \"scene.light\", sensor = \"fitted\" }\n";
    let proof = [again, &solved("stated"), &solved("fitted")].concat();
    let manifest = bench.write("proof.toml", &hidden_refractory(&proof)).display().to_string();
    assert!(executed(&bench.outcome(&[&manifest])).contains(&"again".to_string()));
    let scores = scores(&bench, "out/proof");
    let psnr = |name: &str| scores[&(format!("psnr_{name}"), "psnr_db".to_string())];
    assert!(
        psnr("fitted") > psnr("stated") + 1.0,
        "{} dB fitted, {} dB nominal",
        psnr("fitted"),
        psnr("stated")
    );
}

#[test]
fn direct_tests_alone_are_reported_as_such() {
    let bench = Bench::new();
    let recording = support::root().join("data/concealed/recordings/0ca5a116.h5");
    let done = bench.run(&["diagnose", recording.to_str().expect("a path"), "-o", "found", "--direct"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let report: Value = serde_json::from_str(&read(&bench, "found/diagnosis.json")).expect("JSON");
    assert_eq!(report["provenance"]["stages"], serde_json::json!(["integrity"]));
}

/// A star on a bench, recorded by a sensor that is slower than its description.
const STAR: &str = r#"
format = 1
[pipeline]
seed = 1
[nodes.actual]
kind   = "read/sensor"
params = { path = "SENSORS/hybrid.toml", change = { front_end = { alpha = "24 ms" } } }
[nodes.scene]
kind   = "simulate/scene"
in     = { sensor = "actual" }
params = { scene = "siemens_disk", siemens_disk = { speed = "292 rpm" }, width = 32, height = 24, duration = "80 ms" }
[nodes.camera]
kind = "simulate/sensor"
in   = { light = "scene.light", sensor = "actual" }
[nodes.file]
kind = "write/recording"
in   = { events = "camera.events", frames = "camera.frames" }
"#;

#[test]
fn on_a_known_target_a_slower_front_end_has_its_name_and_size() {
    let bench = Bench::new();
    let sensors = support::root().join("data/sensors").display().to_string();
    bench.write("star.toml", &STAR.replace("SENSORS", &sensors));
    let done = bench.run(&["run", "star.toml", "--out", "star"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let target = "scene = \"siemens_disk\"\n[free]\n\"siemens_disk.speed\" = [\"270 rpm\", \"310 \
                  rpm\"]\nilluminance = [\"200 lx\", \"400 lx\"]\n";
    bench.write("target.toml", target);
    let sensor = format!("{sensors}/hybrid.toml");
    let diagnose = |target: &str| {
        bench.run(&[
            "diagnose",
            "star/file/recording.h5",
            "--sensor",
            &sensor,
            "--scene",
            target,
            "-o",
            "found",
        ])
    };
    let done = diagnose("target.toml");
    says(&done, 0, &["siemens_disk.speed = 29", "illuminance = "]);
    let report: Value = serde_json::from_str(&read(&bench, "found/diagnosis.json")).expect("JSON");
    assert_eq!(report["effects"][0]["id"], "time_constant", "{}", report["summary"]);
    let alpha = report["effects"][0]["parameters"]["alpha_s"]["estimate"]
        .as_f64()
        .unwrap_or_else(|| panic!("{}", report["effects"][0]));
    assert!((alpha / 24e-3 - 1.0).abs() < 0.05, "{alpha}");
    bench.write("wrong.toml", "scene = \"siemens_disk\"\nsiemens_disk = { spoke = 8 }\n");
    says(
        &diagnose("wrong.toml"),
        2,
        &["wrong.toml:2", "`siemens_disk.spoke` is no parameter", "diagnose/target"],
    );
    bench.write("range.toml", "scene = \"siemens_disk\"\nfree = { start = [\"2 ms\", \"1 ms\"] }\n");
    says(&diagnose("range.toml"), 2, &["range.toml", "the range of `start`", "same unit"]);
    says(&diagnose("none.toml"), 2, &["none.toml", "cannot read the scene"]);
}
