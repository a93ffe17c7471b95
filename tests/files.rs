//! What a command does with a file: it is recognised by its content, its mistakes are reported at once and
//! not without end, and streams on two clocks are refused before anything is made from them.

use crate::recordings::{EXTENT, events, exposures, frames, pipeline, write, write_content};
use crate::support::{self, Bench, Done, small_pipeline};
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::{Exposure, testing};
use photocurrent_store::RecordingContent;
use std::process::Stdio;

fn says(done: &Done, code: i32, parts: &[&str]) {
    let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    assert_eq!(done.code, code, "{}", done.stderr);
    parts.iter().for_each(|part| {
        assert!(words(&done.stderr).contains(&words(part)), "`{part}` is missing from\n{}", done.stderr)
    });
    assert!(!done.stderr.contains("panicked"), "{}", done.stderr);
}

fn sensor() -> String {
    std::fs::read_to_string(support::root().join("data/sensors/hybrid.toml")).expect("a sensor description")
}

/// Frames at the time of day, events from 0 on: the forgotten `t_offset`.
fn on_two_clocks(offset_ns: i64) -> Bench {
    let bench = Bench::new();
    let late = exposures(3).iter().map(|exposure| exposure.delayed(offset_ns)).collect();
    let frames = testing::captured(EXTENT, late, 0, |_, x, _| 100.0 + x as f32);
    let (events, sensor) = (events(), sensor());
    write_content(
        &bench.path("rec.h5"),
        &RecordingContent {
            events: Some(&events),
            frames: Some(&frames),
            sensor: Some(&sensor),
            ..RecordingContent::empty(EXTENT)
        },
    );
    bench.write("m.toml", &pipeline());
    bench
}

/// The command with no more address space than a small machine has: what would take 22 GB is killed here, and
/// not the machine.
fn bounded(bench: &Bench, arguments: &str) -> Done {
    let command = format!("ulimit -v 6000000; exec {} {arguments}", env!("CARGO_BIN_EXE_photocurrent"));
    let mut shell = std::process::Command::new("sh");
    let output = shell
        .args(["-c", &command])
        .current_dir(bench.path(""))
        .env("NO_COLOR", "1")
        .stdin(Stdio::null())
        .output()
        .expect("a shell");
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    Done {
        code: output.status.code().unwrap_or(-1),
        stdout: text(output.stdout),
        stderr: text(output.stderr),
    }
}

#[test]
fn events_and_frames_on_two_clocks_are_refused_everywhere_before_anything_is_made() {
    for (offset_ns, shown) in [
        (1_600_000_000_000_000_000, "1600000000 s"),
        (1_000_000_000_000, "1000 s"),
        (-1_000_000_000_000, "-1000 s"),
    ] {
        let bench = on_two_clocks(offset_ns);
        let spans = [
            "no moment in common: events from 0.005001 s to",
            &format!("frames from {shown} to"),
            "`t_offset`",
        ];
        says(&bounded(&bench, "check rec.h5"), 3, &spans);
        for command in ["check m.toml", "plan m.toml", "run m.toml"] {
            let done = bounded(&bench, command);
            says(&done, 2, &spans);
            says(&done, 2, &["nodes.solve", "reads it from"]);
        }
        let done = bounded(&bench, "diagnose rec.h5 -o found");
        assert_eq!(done.code, 3, "{}", done.stderr);
        assert!(
            done.stdout.starts_with("broken_data: ") && done.stdout.contains("no moment in common"),
            "{}",
            done.stdout
        );
        let report = std::fs::read_to_string(bench.path("found/diagnosis.json")).expect("a report");
        assert!(report.contains("\"broken_data\"") && report.contains("t_offset"), "{report}");
        assert!(!bench.path("out").exists(), "nothing ran");
    }
}

#[test]
fn one_stamp_far_from_all_others_makes_no_endless_film() {
    let bench = Bench::new();
    let mut stamps: Vec<Event> = (0..20)
        .map(|n| Event { x: n % 12, y: 2, polarity: Polarity::On, t: i64::from(n) * 1_000_000, t_in: None })
        .collect();
    stamps.push(Event { x: 1, y: 1, polarity: Polarity::Off, t: 1_700_000_000_000_000_000, t_in: None });
    write(&bench.path("rec.h5"), Some(&testing::stream(EXTENT, stamps)), Some(&frames(3)));
    bench.write("m.toml", &pipeline());
    let done = bounded(&bench, "plan m.toml");
    let why = [
        "nodes.solve: the recording lasts from 0 s to 1700000000.000000001 s, and 0.00 % of that has \
                frames near",
        "start = \"0 s\", end = ",
    ];
    says(&done, 2, &why);
    let map = pipeline().replace(
        "params = { front_end = \"ideal\", readout = \"none\", cis_weight = 1.0, evs_weight = 1000.0 }",
        "params = { front_end = \"ideal\" }",
    );
    let map = map.replace("solve/paper", "solve/map");
    assert!(map.contains("solve/map") && !map.contains("readout"));
    bench.write("map.toml", &map);
    says(&bounded(&bench, "plan map.toml"), 2, &why);
    // The part that matters can be had.
    let part = "[nodes.part]\nkind = \"split/time\"\nin = \
                { events = \"recording.events\", frames = \"recording.frames\" }\nparams = \
                { start = \"0 s\", end = \"25 ms\" }\n";
    let cut = pipeline().replace(
        "events = \"recording.events\", frames = \"recording.frames\"",
        "events = \"part.events\", frames = \"part.frames\"",
    );
    bench.write("part.toml", &(cut + part));
    says(&bounded(&bench, "plan part.toml"), 0, &[]);
}

#[test]
fn every_command_knows_what_it_was_given() {
    let bench = Bench::new();
    let (stream, text) = (events(), sensor());
    let frames = frames(3);
    write_content(
        &bench.path("data.bin"),
        &RecordingContent {
            events: Some(&stream),
            frames: Some(&frames),
            sensor: Some(&text),
            ..RecordingContent::empty(EXTENT)
        },
    );
    bench.write("hybrid.txt", &text);
    bench.write("small.toml", &small_pipeline());
    says(&bench.run(&["check", "data.bin"]), 0, &["24 events, 3 frames", "no mistake found"]);
    says(&bench.run(&["check", "hybrid.txt"]), 0, &["the sensor description", "no mistake found"]);
    says(&bench.run(&["check", "small.toml"]), 0, &["no mistake found"]);
    for command in ["run", "plan", "graph"] {
        says(
            &bench.run(&[command, "data.bin"]),
            2,
            &[
                &format!("`{command}` takes a manifest, and this is a recording"),
                "photocurrent inspect data.bin",
            ],
        );
        says(
            &bench.run(&[command, "hybrid.txt"]),
            2,
            &["this is a sensor description", "photocurrent check hybrid.txt"],
        );
    }
    says(&bench.run(&["explain", "data.bin", "solve"]), 2, &["`explain` takes a manifest"]);
    says(&bench.run(&["inspect", "small.toml"]), 2, &["`inspect` takes a recording", "this is a manifest"]);
    says(
        &bench.run(&["diagnose", "small.toml"]),
        2,
        &["small.toml: the manifest reads no recording", "--sensor SENSOR.toml"],
    );
    says(
        &bench.run(&["diagnose", "hybrid.txt"]),
        2,
        &["`diagnose` takes a recording, or a manifest that reads one, and this is a sensor description"],
    );
    says(
        &bench.run(&["table", "data.bin"]),
        2,
        &["`table` takes a manifest that was run", "this is a recording"],
    );
    assert!(!bench.path("out").exists());
    // What a run wrote, and what a diagnosis wrote.
    says(&bench.run(&["run", "small.toml", "--progress", "none", "--to", "psnr"]), 0, &[]);
    says(&bench.run(&["check", "out/small"]), 0, &["the output of a run", "no mistake found"]);
    says(
        &bench.run(&["run", "out/small"]),
        2,
        &["this is the output folder of a run", "photocurrent table out/small"],
    );
    says(&bench.run(&["inspect", "out/small"]), 2, &["the output folder of a run"]);
    let lines = std::fs::read_to_string(bench.path("out/small/metrics.jsonl")).expect("scores");
    bench.write("bad/metrics.jsonl", &format!("{lines}no JSON\n"));
    says(&bench.run(&["check", "bad"]), 3, &["bad/metrics.jsonl:", "no JSON", "1 mistake"]);
    bench.write("diagnosis.json", "{\"schema\": \"photocurrent-diagnosis/1\"}");
    says(&bench.run(&["run", "diagnosis.json"]), 2, &["this is a diagnosis"]);
    says(&bench.run(&["check", "diagnosis.json"]), 3, &["this is no diagnosis"]);
    // The same for programs: the same exit code, on stdout.
    let json = |arguments: &[&str], code: i32| -> serde_json::Value {
        let done = bench.run(arguments);
        assert!(done.code == code && done.stderr.is_empty(), "{}", done.stderr);
        let found: serde_json::Value = serde_json::from_str(&done.stdout).expect("JSON");
        assert!(found["schema"] == "photocurrent-check/1" && found["exit_code"] == code, "{found}");
        found
    };
    let good = json(&["check", "data.bin", "--json"], 0);
    assert!(
        good["checked"] == "24 events, 3 frames" && good["mistakes"].as_array().is_some_and(Vec::is_empty),
        "{good}"
    );
    let bad = json(&["check", "bad", "--json"], 3);
    assert!(
        bad["mistakes"][0]["message"]
            .as_str()
            .is_some_and(|message| message.starts_with("bad/metrics.jsonl:")),
        "{bad}"
    );
    bench.write("typo.toml", &small_pipeline().replace("evs_weight", "evs_wait"));
    let typo = json(&["check", "typo.toml", "--json"], 2);
    let line = small_pipeline().lines().position(|line| line.contains("evs_weight")).expect("the line") + 1;
    assert!(
        typo["mistakes"][0]["line"] == line
            && typo["mistakes"][0]["file"].as_str().is_some_and(|file| file.ends_with("typo.toml")),
        "{typo}"
    );
    // The camera's own file, under another name.
    let clip = support::root().join("data/recordings/davis346_traffic.aedat4");
    std::fs::copy(clip, bench.path("clip")).expect("a copy");
    says(&bench.run(&["run", "clip"]), 2, &["this is a recording", "AEDAT4"]);
    says(&bench.run(&["check", "clip"]), 0, &["events", "no mistake found"]);
}

#[test]
fn a_large_text_is_not_read_as_a_manifest_and_mistakes_of_one_kind_are_counted() {
    let bench = Bench::new();
    let line = "0.003811 96 133 0\n";
    bench.write("events.txt", &line.repeat(2_000_000));
    let begun = std::time::Instant::now();
    let done = bench.run(&["run", "events.txt"]);
    assert_eq!(done.code, 2, "{}", done.stderr);
    assert!(
        done.stderr.contains("`run` takes a manifest") && done.stderr.lines().count() < 6,
        "{}",
        done.stderr
    );
    assert!(begun.elapsed().as_secs_f64() < 2.0, "{:?} to recognise a text", begun.elapsed());
    // The same in a manifest's clothes: mistakes in every line are shown twenty times, in time that grows
    // with the text.
    bench.write("events.toml", &format!("format = 1\n{}", line.repeat(20_000)));
    let begun = std::time::Instant::now();
    let done = bench.run(&["check", "events.toml"]);
    assert_eq!(done.code, 2);
    assert!(
        done.stderr.matches("error: not TOML").count() <= 100 && done.stderr.contains("more like: not TOML"),
        "{}",
        &done.stderr[..2000]
    );
    assert!(begun.elapsed().as_secs_f64() < 20.0, "{:?} for 20,000 mistakes", begun.elapsed());
}

#[test]
fn what_run_refuses_in_a_recording_check_finds() {
    let bench = Bench::new();
    let (stream, frames) = (events(), frames(3));
    let text = sensor() + "\n[frams]\nx = 1\n";
    write_content(
        &bench.path("rec.h5"),
        &RecordingContent {
            events: Some(&stream),
            frames: Some(&frames),
            sensor: Some(&text),
            ..RecordingContent::empty(EXTENT)
        },
    );
    says(&bench.run(&["check", "rec.h5"]), 3, &["`frams` is not a", "rec.h5:/sensor:", "1 mistake"]);
}

#[test]
fn everything_that_a_description_lacks_is_reported_at_once() {
    let bench = Bench::new();
    write(&bench.path("rec.h5"), Some(&events()), Some(&frames(3)));
    bench.write(
        "bare.toml",
        "format = \"photocurrent-sensor/1\"\nname = \"bare\"\n[frames]\nblack_level_dn = 10\n",
    );
    let manifest = r#"format = 1
[nodes.sensor]
kind = "read/sensor"
params.path = "bare.toml"
[nodes.recording]
kind = "read/recording"
params.path = "rec.h5"
[nodes.solve]
kind = "solve/map"
in = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }
[nodes.render]
kind = "render/rows"
in = { tracks = "solve.tracks", sensor = "sensor" }
params = { shutter = "rolling" }
"#;
    bench.write("m.toml", manifest);
    let done = bench.run(&["check", "m.toml"]);
    let fields = [
        "front_end.tau_0",
        "front_end.alpha",
        "readout.refractory",
        "comparator.threshold_on",
        "comparator.threshold_off",
        "frames.gain",
        "frames.row_time",
    ];
    let said = [
        "lacks 7 fields that this pipeline needs",
        "bare.toml:1",
        "nodes.solve",
        "nodes.render",
        "its table [frames] stands in line 3",
        "row_time = \"0 us\"",
    ];
    says(&done, 2, &[&fields[..], &said[..]].concat());
    // What it says to add is what is needed.
    let start = done.stderr.rfind("[front_end]").expect("what to add");
    let added: String = done.stderr[start..]
        .lines()
        .map(|line| line.trim_start_matches([' ', '=', '|']))
        .take_while(|line| !line.contains("mistake"))
        .collect::<Vec<_>>()
        .join("\n");
    bench.write("bare.toml", &format!("format = \"photocurrent-sensor/1\"\n{added}\n"));
    says(&bench.run(&["check", "m.toml"]), 0, &["no mistake found"]);
}

#[test]
fn a_run_without_a_terminal_speaks_in_plain_lines() {
    let bench = Bench::new();
    bench.write("small.toml", &small_pipeline());
    let done = bench.run(&["run", "small.toml"]);
    says(&done, 0, &["started solve (solve/paper)", "done solve (solve/paper), ", "nodes executed"]);
    assert!(!done.stderr.contains('{'), "{}", done.stderr);
    let nodes = small_pipeline().matches("[nodes.").count();
    assert!(done.stderr.lines().count() <= 2 * nodes + 12, "{}", done.stderr);
    let done = bench.run(&["run", "small.toml", "--progress", "json", "--force", "solve"]);
    let lines: Vec<serde_json::Value> =
        done.stderr.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
    let of = |event: &str| lines.iter().filter(|line| line["event"] == event).count();
    assert_eq!((of("planned"), of("started") >= 1, of("finished")), (1, true, nodes), "{}", done.stderr);
    let done = bench.run(&["run", "small.toml", "--progress", "none", "--force", "solve"]);
    assert!(!done.stderr.contains("started") && done.stderr.contains("nodes executed"), "{}", done.stderr);
    assert_eq!(bench.run(&["run", "small.toml", "--quiet"]).stderr, "");
}

#[test]
fn a_clip_that_begins_or_ends_with_its_frames_is_one_clock() {
    let bench = Bench::new();
    // One picture, and events after it.
    let frame = testing::captured(EXTENT, vec![Exposure::new(0, 4_000_000)], 0, |_, x, _| 100.0 + x as f32);
    write(&bench.path("rec.h5"), Some(&events()), Some(&frame));
    says(&bench.run(&["check", "rec.h5"]), 0, &["24 events, 1 frames", "no mistake found"]);
}

/// The exit code of a command whose stdout and stderr nobody reads.
fn unheard(bench: &Bench, arguments: &[&str]) -> i32 {
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    let status = bench
        .command(arguments)
        .stdin(Stdio::null())
        .stdout(writer.try_clone().expect("a pipe"))
        .stderr(writer)
        .status();
    status.expect("the command starts").code().unwrap_or(-1)
}

#[test]
fn a_reader_that_goes_away_changes_no_exit_code() {
    let bench = Bench::new();
    bench.write("m.toml", &small_pipeline());
    bench.write("bad.toml", "format = 1\n[nodes.a]\nkind = \"read/nothing\"\n");
    // 130 whole lines of text, and one that is cut: what is whole is read, and the exit code says that it is
    // damaged.
    let lines: String = (0..130).map(|k| format!("{},{},3,{}\n", k * 100, k % 20, k % 2)).collect();
    bench.write("cut.csv", &format!("t,x,y,p\n{lines}13000,5\n"));
    let cases: [(&[&str], i32); 9] = [
        (&["nodes"], 0),
        (&["nodes", "--markdown"], 0),
        (&["completions", "bash"], 0),
        (&["check", "bad.toml"], 2),
        (&["check", "nowhere.toml"], 2),
        (&["inspect", "cut.csv", "--time-unit", "us"], 3),
        (&["inspect", "cut.csv", "--time-unit", "us", "--json"], 3),
        (&["run", "m.toml", "--progress", "plain"], 0),
        (&["run", "m.toml", "--progress", "json", "--json", "--force", "solve"], 0),
    ];
    for (arguments, code) in cases {
        assert_eq!(unheard(&bench, arguments), code, "{arguments:?}");
    }
}

#[test]
fn what_needs_more_than_the_stated_memory_is_refused_before_anything_runs() {
    let bench = Bench::new();
    bench.write("m.toml", &small_pipeline());
    for command in ["plan", "check", "run"] {
        says(
            &bench.run(&[command, "m.toml", "--memory", "30kB"]),
            2,
            &["nodes.", "of memory at a time, and there are 30.0 kB", "--memory"],
        );
        assert!(
            !bench.path("out").exists() && !bench.path(".photocurrent").exists(),
            "{command} left something behind"
        );
    }
    assert_eq!(bench.run(&["check", "m.toml", "--memory", "64MB"]).code, 0);
    // 2,001 frames of 16 bytes each, before any of their values.
    let sampled = small_pipeline()
        .replace("kind = \"render/rows\"", "kind = \"render/rows\"\nparams = { rate = \"50 kHz\" }");
    bench.write("list.toml", &sampled);
    says(
        &bench.run(&["plan", "list.toml", "--memory", "20kB"]),
        2,
        &["for the times of frames, and there are 20.0 kB"],
    );
    // A diagnosis holds its recording.
    let (events, frames, sensor) = (events(), frames(3), sensor());
    write_content(
        &bench.path("rec.h5"),
        &RecordingContent {
            events: Some(&events),
            frames: Some(&frames),
            sensor: Some(&sensor),
            ..RecordingContent::empty(EXTENT)
        },
    );
    says(
        &bench.run(&["diagnose", "rec.h5", "--memory", "100B"]),
        2,
        &["rec.h5: a diagnosis holds the recording", "and there are 100 B"],
    );
}

#[test]
fn two_manifests_of_one_name_do_not_replace_each_others_files() {
    let bench = Bench::new();
    bench.write("a/my.toml", &small_pipeline());
    bench.write("b/my.toml", &small_pipeline().replace("seed = 7", "seed = 8"));
    says(&bench.run(&["run", "a/my.toml", "--quiet"]), 0, &[]);
    let before = support::files(&bench.path("out"));
    for command in ["run", "plan"] {
        says(
            &bench.run(&[command, "b/my.toml"]),
            2,
            &[
                "out/my has the results of a/my.toml; they would be replaced by those of b/my.toml",
                "--out out/b-my",
            ],
        );
    }
    for command in [&["table", "b/my.toml"][..], &["report", "b/my.toml"]] {
        says(
            &bench.run(command),
            2,
            &["out/my has the results of a/my.toml; this is b/my.toml", "--out FOLDER"],
        );
    }
    assert!(support::files(&bench.path("out")) == before, "a refused run leaves everything as it was");
    // The same manifest by another path, and another manifest into a folder that is named, run as they did.
    says(&bench.run(&["run", "./b/../a/my.toml", "--quiet"]), 0, &[]);
    says(&bench.run(&["run", "b/my.toml", "--out", "out/b-my", "--quiet"]), 0, &[]);
    says(&bench.run(&["run", "b/my.toml", "--out", "out/my", "--quiet"]), 0, &[]);
    // The folder is now that of b. Moved with everything, it still is; and when its manifest is gone, it is
    // anybody's.
    std::fs::create_dir(bench.path("moved")).expect("a folder");
    for name in ["a", "b", "out"] {
        std::fs::rename(bench.path(name), bench.path("moved").join(name)).expect("a move");
    }
    let inside = |arguments: &[&str]| {
        let output =
            bench.command(arguments).current_dir(bench.path("moved")).output().expect("the command starts");
        Done {
            code: output.status.code().unwrap_or(-1),
            stdout: String::new(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    };
    says(&inside(&["run", "b/my.toml", "--quiet"]), 0, &[]);
    says(&inside(&["run", "a/my.toml", "--quiet"]), 2, &["out/my has the results of b/my.toml"]);
    std::fs::remove_file(bench.path("moved/b/my.toml")).expect("a file");
    says(&inside(&["run", "a/my.toml", "--quiet"]), 0, &[]);
}
