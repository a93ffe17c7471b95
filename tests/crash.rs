//! Kills at random moments, interrupts, two runs at once, damaged files, nodes that fail: never a wrong
//! artefact, and the next run comes to the right end.
//!
//! Moments come from a fixed seed and are spread over the length of an undisturbed run. How far a killed run
//! gets depends on the machine; what is asserted afterwards holds at every moment.

use crate::recordings;
use crate::support::{self, Bench, digests, executed, files, results};
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::random::Random;
use photocurrent_core::testing;
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// The small pipeline, a little larger: long enough to be hit in every phase.
fn bench() -> Bench {
    let bench = Bench::new();
    let text = support::small_pipeline();
    let larger = text.replace(
        "width = 32, height = 24, duration = \"40 ms\"",
        "width = 64, height = 48, duration = \"60 ms\"",
    );
    assert_ne!(larger, text);
    bench.write("m.toml", &larger);
    bench
}

fn is_hidden(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'))
}

/// Every exported folder that is there is whole: its stamp names its files, all of them, each with its size
/// and content.
fn assert_exports_are_whole(out: &Path, when: &str) {
    let folders = std::fs::read_dir(out).into_iter().flatten().map(|entry| entry.expect("an entry").path());
    for folder in folders.filter(|path| path.is_dir() && !is_hidden(path)) {
        let stamp = std::fs::read_to_string(folder.join(".photocurrent.toml"))
            .unwrap_or_else(|error| panic!("{when}: {} has no stamp: {error}", folder.display()));
        let stamp: toml::Table = toml::from_str(&stamp).expect("a stamp is TOML");
        let mut there = files(&folder);
        there.remove(Path::new(".photocurrent.toml"));
        for file in stamp["files"].as_array().expect("files") {
            let name = file["name"].as_str().expect("a name");
            let bytes = there
                .remove(Path::new(name))
                .unwrap_or_else(|| panic!("{when}: {name} is stamped and missing"));
            assert_eq!(file["bytes"].as_integer(), Some(bytes.len() as i64), "{when}: {name}");
            assert_eq!(
                file["digest"].as_str(),
                Some(blake3::hash(&bytes).to_hex().as_str()),
                "{when}: {name}"
            );
        }
        assert!(
            there.is_empty(),
            "{when}: {} holds what its stamp does not name: {:?}",
            folder.display(),
            there.keys()
        );
    }
}

fn assert_cache_is_whole(bench: &Bench, when: &str) {
    let done = bench.run(&["cache", "verify"]);
    assert_eq!(done.code, 0, "{when}: {}{}", done.stdout, done.stderr);
    assert!(!done.stdout.contains("damaged"), "{when}: {}", done.stdout);
}

fn start(bench: &Bench, arguments: &[&str]) -> Child {
    let mut all = vec!["run", "m.toml"];
    all.extend(arguments);
    bench
        .command(&all)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the command starts")
}

/// What an undisturbed run leaves: digests, exported files, and how long it took.
struct Undisturbed {
    digests: BTreeMap<String, String>,
    files: BTreeMap<PathBuf, Vec<u8>>,
    took: Duration,
}

fn undisturbed(arguments: &[&str]) -> Undisturbed {
    let bench = bench();
    let started = Instant::now();
    let mut all = vec!["m.toml"];
    all.extend(arguments);
    let outcome = bench.outcome(&all);
    Undisturbed { took: started.elapsed(), digests: digests(&outcome), files: results(&bench.path("out/m")) }
}

fn assert_ends_as(bench: &Bench, arguments: &[&str], expected: &Undisturbed, when: &str) {
    let mut all = vec!["m.toml"];
    all.extend(arguments);
    let outcome = bench.outcome(&all);
    assert_eq!(digests(&outcome), expected.digests, "{when}");
    assert_exports_are_whole(&bench.path("out/m"), when);
    let mut found = results(&bench.path("out/m"));
    // What a killed run had half-made stands next to the results under a hidden name.
    found.retain(|path, _| !path.iter().next().is_some_and(|first| is_hidden(Path::new(first))));
    assert_eq!(found.keys().collect::<Vec<_>>(), expected.files.keys().collect::<Vec<_>>(), "{when}");
    assert!(found == expected.files, "{when}: a file differs");
}

/// Makes every node run, so that a run on a full cache is as long as one on an empty cache.
fn force_all() -> Vec<&'static str> {
    ["sensor", "scene", "recording", "solve", "render", "edi", "psnr", "psnr_edi", "table", "frames"]
        .iter()
        .flat_map(|node| ["--force", node])
        .collect()
}

#[test]
fn a_run_killed_at_any_moment_leaves_nothing_wrong_and_the_next_one_completes() {
    // Twenty kills, all on one cache and one output folder that are never cleaned. Each seed of the pipeline
    // is killed twice before it may finish: the first time with everything to be made and the files of the
    // seed before to be replaced, the second time on what the first left.
    let bench = bench();
    let mut random = Random::new(20, &[]);
    let mut killed = 0;
    for seed in 1..=10 {
        let set = format!("pipeline.seed={seed}");
        let expected = undisturbed(&["--set", &set]);
        for kill in 0..2 {
            // The first moment is the very start, so that at least one run is always hit.
            let moment = expected.took.mul_f64(if seed == 1 && kill == 0 { 0.0 } else { random.uniform() });
            let when = format!("seed {seed}, kill {kill} after {moment:?}");
            let mut arguments = vec!["--set", set.as_str(), "-q"];
            arguments.extend(force_all());
            let mut child = start(&bench, &arguments);
            std::thread::sleep(moment);
            child.kill().expect("a signal can be sent to a child that was not waited for");
            killed += usize::from(child.wait().expect("it ends").code().is_none());
            if bench.path(".photocurrent").is_dir() {
                assert_cache_is_whole(&bench, &when);
            }
            assert_exports_are_whole(&bench.path("out/m"), &when);
        }
        assert_ends_as(&bench, &["--set", &set], &expected, &format!("seed {seed}"));
        assert_cache_is_whole(&bench, &format!("seed {seed}, at the end"));
    }
    assert!(killed > 0, "no run was hit: nothing was tested");
    // Writers clear away what killed ones left.
    bench.outcome(&["m.toml", "--force", "table", "--force", "frames"]);
    let left: Vec<PathBuf> = files(&bench.path("out/m"))
        .into_keys()
        .filter(|path| path.to_string_lossy().contains(".partial"))
        .collect();
    assert!(left.is_empty(), "{left:?}");
}

/// Reads what the command says until it says that a node has begun; false when it ended before.
fn wait_for_start(child: &mut Child, node: &str) -> bool {
    let lines = BufReader::new(child.stderr.take().expect("stderr is a pipe"));
    let mark = format!("started  {node} (");
    let mut seen = false;
    let mut lines = lines.lines();
    while let Some(Ok(line)) = lines.next() {
        if line.starts_with(&mark) {
            seen = true;
            break;
        }
    }
    // The rest is read too: a full pipe would hold the command up.
    std::thread::spawn(move || lines.for_each(drop));
    seen
}

#[test]
fn an_interrupt_ends_with_130_and_the_next_run_goes_on() {
    ends_with_130_and_goes_on("INT");
    ends_with_130_and_goes_on("TERM");
}

/// The shell's own `kill` is there wherever a shell is.
fn send(signal: &str, child: &Child) {
    let sent =
        std::process::Command::new("sh").args(["-c", &format!("kill -{signal} {}", child.id())]).status();
    assert!(sent.is_ok_and(|status| status.success()), "{signal} was not sent");
}

fn ends_with_130_and_goes_on(signal: &str) {
    let bench = bench();
    let mut interrupted = None;
    // A run may be over before the signal arrives; another seed then tries again.
    for seed in 1..=50 {
        let set = format!("pipeline.seed={seed}");
        let mut child = start(&bench, &["--set", &set]);
        assert!(wait_for_start(&mut child, "scene"));
        if child.try_wait().expect("a child").is_none() {
            send(signal, &child);
        }
        let code = child.wait().expect("it ends").code();
        assert!(code == Some(130) || code == Some(0), "{code:?} after {signal}");
        assert_cache_is_whole(&bench, &set);
        assert_exports_are_whole(&bench.path("out/m"), &set);
        if code == Some(130) {
            interrupted = Some(set);
            break;
        }
    }
    let set = interrupted.expect("one of fifty runs is interrupted before it is over");
    let after = ["--set", set.as_str()];
    // The description was read before the scene began, and what is finished stays.
    let plan = bench.run(&["plan", "m.toml", "--json", after[0], after[1]]);
    let plan: Value = serde_json::from_str(&plan.stdout).expect("JSON");
    assert_eq!((&plan["tasks"][0]["node"], &plan["tasks"][0]["state"]), (&"sensor".into(), &"hit".into()));
    assert_ends_as(&bench, &after, &undisturbed(&after), &set);
}

#[test]
fn a_diagnosis_in_the_middle_of_a_long_step_stops_and_leaves_nothing_behind() {
    let bench = Bench::new();
    recordings::write(&bench.path("rec.h5"), Some(&recordings::events()), Some(&recordings::frames(3)));
    std::fs::create_dir(bench.path("temporary")).expect("a folder");
    let sensor = support::root().join("data/sensors/hybrid.toml");
    let mut command =
        bench.command(&["diagnose", "rec.h5", "--sensor", sensor.to_str().expect("UTF-8"), "-o", "answer"]);
    let command = command
        .env("TMPDIR", bench.path("temporary"))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    let mut child = command.spawn().expect("the command starts");
    let begun = wait_for_start(&mut child, "integrity");
    if begun && child.try_wait().expect("a child").is_none() {
        send("TERM", &child);
    }
    let code = child.wait().expect("it ends").code();
    // It may be over before the signal arrives.
    assert!(begun && (code == Some(130) || code == Some(0)), "{code:?}");
    assert_eq!(files(&bench.path("temporary")).len(), 0);
    if bench.path(".photocurrent").is_dir() {
        assert_cache_is_whole(&bench, "after a diagnosis");
    }
}

#[test]
fn a_disk_that_is_full_ends_what_it_must_and_spoils_nothing() {
    let bench = bench();
    let expected = undisturbed(&[]);
    let mut ended = 0;
    // A process that may write files of so many blocks only gets the same message as one on a full disk: that
    // a write failed.
    for blocks in [8, 32, 128, 300, 600] {
        let limited = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$0\" \"$@\"");
        let mut command = std::process::Command::new("sh");
        command
            .args(["-c", &limited, env!("CARGO_BIN_EXE_photocurrent"), "run", "m.toml", "-q"])
            .current_dir(bench.path(""));
        let output = command.output().expect("a shell");
        let (when, said) = (format!("{blocks} blocks"), String::from_utf8_lossy(&output.stderr).into_owned());
        match output.status.code() {
            Some(1) => {
                assert!(
                    said.contains("cannot write") || said.contains("is the disk full?"),
                    "{when}: {said}"
                );
                assert!(
                    said.contains(".photocurrent") || said.contains("out/m"),
                    "{when}: no file is named: {said}"
                );
                ended += 1;
            }
            code => assert_eq!(code, Some(0), "{when}: {said}"),
        }
        assert_cache_is_whole(&bench, &when);
        assert_exports_are_whole(&bench.path("out/m"), &when);
    }
    assert!(ended > 0, "no run came to the limit: nothing was tested");
    assert_ends_as(&bench, &[], &expected, "with room again");
}

#[test]
fn a_cache_that_cannot_be_written_is_said_before_anything_runs() {
    let bench = bench();
    bench.write("file", "not a folder");
    let done = bench.run(&["run", "m.toml", "--cache", "file/cache"]);
    assert_eq!(done.code, 1, "{}", done.stderr);
    assert!(done.stderr.contains("file/cache") && !done.stderr.contains("started"), "{}", done.stderr);
    assert_eq!(std::fs::read_to_string(bench.path("file")).expect("the file"), "not a folder");

    // A finished cache that may only be read.
    let expected = undisturbed(&[]);
    bench.outcome(&["m.toml"]);
    let data = bench.path(".photocurrent/data");
    let mode = |mode: u32| {
        std::fs::set_permissions(&data, std::os::unix::fs::PermissionsExt::from_mode(mode)).expect("a mode")
    };
    mode(0o555);
    // The superuser may write nevertheless.
    if std::fs::write(data.join("probe"), "").is_err() {
        let done = bench.run(&["run", "m.toml", "--set", "pipeline.seed=9"]);
        assert_eq!(done.code, 1, "{}", done.stderr);
        assert!(done.stderr.contains(".photocurrent"), "{}", done.stderr);
    }
    mode(0o755);
    let _ = std::fs::remove_file(data.join("probe"));
    assert_cache_is_whole(&bench, "after it was read-only");
    assert_ends_as(&bench, &[], &expected, "after it was read-only");
}

#[test]
fn an_output_folder_that_cannot_be_made_is_said_before_anything_runs() {
    let bench = bench();
    bench.write("file", "not a folder");
    for out in ["file", "file/out"] {
        let done = bench.run(&["run", "m.toml", "--out", out]);
        assert_eq!(done.code, 1, "{}", done.stderr);
        assert!(
            done.stderr.contains(&format!("{out}: cannot make the folder")) && done.stderr.contains("--out"),
            "{}",
            done.stderr
        );
        assert!(!done.stderr.contains("started"), "{}", done.stderr);
    }
    assert_eq!(std::fs::read_to_string(bench.path("file")).expect("the file"), "not a folder");
}

#[test]
fn an_input_file_that_goes_away_midway_fails_its_reader_alone() {
    let bench = Bench::new();
    let write = || {
        recordings::write(&bench.path("rec.h5"), Some(&recordings::events()), Some(&recordings::frames(3)))
    };
    write();
    // The scene is longer than it takes to remove a file, and one thread takes nodes in order.
    let scene = support::small_pipeline().replace(
        "width = 32, height = 24, duration = \"40 ms\"",
        "width = 96, height = 72, duration = \"100 ms\"",
    );
    let given = "[nodes.given]\nkind = \"read/recording\"\nparams = { path = \"rec.h5\" }\n\
        [nodes.repeated]\nkind = \"baseline/repeat\"\nin = \
        { frames = \"given.frames\", sensor = \"sensor\", at = \"given.frames\" }\n";
    bench.write("m.toml", &format!("{scene}{given}"));
    let mut child = start(&bench, &["--threads", "1"]);
    assert!(wait_for_start(&mut child, "scene"));
    std::fs::remove_file(bench.path("rec.h5")).expect("removed");
    assert_eq!(child.wait().expect("it ends").code(), Some(1));
    assert_cache_is_whole(&bench, "after the file went away");
    assert_exports_are_whole(&bench.path("out/m"), "after the file went away");
    // It is named, what does not need it was done, and with the file it goes on from there.
    let again = bench.run(&["run", "m.toml"]);
    assert!(again.code != 0 && again.stderr.contains("rec.h5"), "{}", again.stderr);
    write();
    assert_eq!(executed(&bench.outcome(&["m.toml"])), ["given", "repeated"]);
}

#[test]
fn two_runs_at_once_on_one_cache_and_one_folder_are_both_right() {
    let bench = bench();
    for seed in 1..=4 {
        let set = format!("pipeline.seed={seed}");
        let spawn = |threads: &str| {
            let mut command =
                bench.command(&["run", "m.toml", "--json", "--set", &set, "--threads", threads]);
            command
                .stdin(Stdio::null())
                .stdout(Stdio::piped())
                .stderr(Stdio::piped())
                .spawn()
                .expect("the command starts")
        };
        let both = [spawn("1"), spawn("2")];
        let ended = both.map(|child| child.wait_with_output().expect("it ends"));
        let expected = undisturbed(&["--set", &set]);
        for output in ended {
            assert_eq!(
                output.status.code(),
                Some(0),
                "seed {seed}: {}",
                String::from_utf8_lossy(&output.stderr)
            );
            let outcome: Value = serde_json::from_slice(&output.stdout).expect("JSON");
            assert_eq!(digests(&outcome), expected.digests, "seed {seed}");
        }
        assert_cache_is_whole(&bench, &set);
        assert_ends_as(&bench, &["--set", &set], &expected, &set);
    }
}

/// A run of the small pipeline, to be damaged.
struct Damaged {
    bench: Bench,
    outcome: Value,
}

impl Damaged {
    fn new() -> Damaged {
        let bench = bench();
        let outcome = bench.outcome(&["m.toml"]);
        Damaged { bench, outcome }
    }

    fn data(&self, output: &str) -> PathBuf {
        self.bench.path(".photocurrent/data").join(format!("{}.h5", digests(&self.outcome)[output]))
    }

    fn record(&self, node: &str) -> PathBuf {
        let task = self.outcome["tasks"]
            .as_array()
            .expect("tasks")
            .iter()
            .find(|task| task["node"] == node)
            .expect("the node");
        self.bench.path(".photocurrent/keys").join(format!("{}.toml", task["key"].as_str().expect("a key")))
    }

    /// The next run says what is damaged, runs these nodes, and everything is as before and stays so.
    fn is_repaired(&self, arguments: &[&str], nodes: &[&str], damaged: &Path) {
        let mut all = vec!["run", "--json", "m.toml"];
        all.extend(arguments);
        let done = self.bench.run(&all);
        assert_eq!(done.code, 0, "{}", done.stderr);
        let outcome: Value = serde_json::from_str(&done.stdout).expect("JSON");
        assert_eq!(executed(&outcome), nodes);
        assert_eq!(digests(&outcome), digests(&self.outcome));
        let name = damaged.file_name().expect("a name").to_string_lossy().into_owned();
        let warnings = outcome["warnings"].as_array().expect("warnings");
        assert!(
            warnings.iter().any(|warning| warning.as_str().expect("a text").contains(&name)),
            "{name} is not named in {warnings:?}"
        );
        assert!(done.stderr.contains(&name), "{}", done.stderr);
        assert_cache_is_whole(&self.bench, &name);
        assert_eq!(executed(&self.bench.outcome(&["m.toml"])), [""; 0]);
    }
}

fn flip_a_byte(path: &Path) {
    let mut bytes = std::fs::read(path).expect("the file");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(path, bytes).expect("written");
}

fn truncate(path: &Path) {
    let bytes = std::fs::read(path).expect("the file");
    std::fs::write(path, &bytes[..bytes.len() / 2]).expect("written");
}

fn delete(path: &Path) {
    std::fs::remove_file(path).expect("removed");
}

#[test]
fn a_result_that_is_cut_short_or_gone_is_made_again() {
    let damaged = Damaged::new();
    let events = damaged.data("recording.events");
    for harm in [truncate, delete] {
        harm(&events);
        assert_eq!(damaged.bench.run(&["cache", "verify"]).code, 3);
        let plan = damaged.bench.run(&["explain", "m.toml", "recording"]);
        assert!(
            plan.stdout.starts_with("recording: would run\n  record damaged: output `events`: "),
            "{}",
            plan.stdout
        );
        damaged.is_repaired(&[], &["recording"], &events);
    }
}

#[test]
fn a_result_with_a_wrong_byte_is_noticed_when_it_is_read_and_made_again() {
    let damaged = Damaged::new();
    let events = damaged.data("recording.events");
    flip_a_byte(&events);
    let verified = damaged.bench.run(&["cache", "verify"]);
    assert_eq!(verified.code, 3);
    assert!(
        verified.stdout.contains(&format!(
            "damaged: .photocurrent/data/{}",
            events.file_name().expect("a name").to_string_lossy()
        )),
        "{}",
        verified.stdout
    );
    damaged.is_repaired(&["--force", "solve"], &["recording", "solve"], &events);
}

#[test]
fn a_table_with_a_wrong_byte_is_made_again_and_not_an_error_for_ever() {
    // Every run reads the tables of scores, for its report.
    let damaged = Damaged::new();
    let scores = damaged.data("psnr.scores");
    flip_a_byte(&scores);
    damaged.is_repaired(&[], &["psnr"], &scores);
}

#[test]
fn a_damaged_record_is_made_again() {
    let damaged = Damaged::new();
    let record = damaged.record("solve");
    let harms: [fn(&Path); 3] = [
        truncate,
        |path| std::fs::write(path, "key = 7").expect("written"),
        |path| {
            let text = std::fs::read_to_string(path).expect("the record");
            let other = text.replace("\nrevision = ", "\nrevision = 9");
            assert_ne!(other, text);
            std::fs::write(path, other).expect("written");
        },
    ];
    for harm in harms {
        harm(&record);
        assert_eq!(damaged.bench.run(&["cache", "verify"]).code, 3);
        damaged.is_repaired(&[], &["solve"], &record);
    }
}

#[test]
fn a_record_that_is_gone_is_a_plain_miss() {
    let damaged = Damaged::new();
    delete(&damaged.record("solve"));
    let outcome = damaged.bench.outcome(&["m.toml"]);
    assert_eq!(
        (executed(&outcome), digests(&outcome)),
        (vec!["solve".to_string()], digests(&damaged.outcome))
    );
    assert_eq!(outcome["warnings"].as_array(), Some(&vec![]));
}

/// A recording with an event outside its sensor: nobody can know before the events are read.
fn write_bad_recording(path: &Path) {
    let mut events = recordings::pulses();
    events.push(Event { x: 4000, y: 1, polarity: Polarity::On, t: 8_000_000, t_in: Some(7_999_000) });
    recordings::write_with_truth(path, &testing::stream(recordings::EXTENT, events));
}

const SCORED: &str = r#"
[nodes.psnr]
kind = "score/psnr"
in = { frames = "render", truth = "recording.truth" }
"#;

#[test]
fn a_node_that_fails_stops_only_what_hangs_on_it() {
    let bench = Bench::new();
    write_bad_recording(&bench.path("rec.h5"));
    let aside = "[nodes.scene]\nkind = \"simulate/scene\"\nin.sensor = \"sensor\"\nparams = \
                 { width = 16, height = 16 }\n[nodes.camera]\nkind = \"simulate/sensor\"\nin = \
                 { light = \"scene.light\", sensor = \"sensor\" }\n[nodes.aside]\nkind = \
                 \"write/frames\"\nin.frames = \"camera.frames\"\n";
    bench.write("m.toml", &format!("{}{aside}", recordings::pipeline()));
    let done = bench.run(&["run", "--json", "m.toml"]);
    assert_eq!(done.code, 3, "{}", done.stderr);
    for part in [
        "node recording (read/recording) failed",
        "rec.h5",
        "x = 4000, y = 1",
        "hint: ",
        "skipped: frames needs recording",
        "what is finished stays in the cache",
    ] {
        assert!(done.stderr.contains(part), "`{part}` is missing from\n{}", done.stderr);
    }
    let outcome: Value = serde_json::from_str(&done.stdout).expect("JSON");
    assert_eq!(executed(&outcome), ["aside", "camera", "scene", "sensor"]);
    let ends = |end: &str| {
        outcome["tasks"]
            .as_array()
            .expect("tasks")
            .iter()
            .filter(|task| task["end"] == end)
            .map(|task| task["node"].as_str().expect("a name"))
            .collect::<Vec<_>>()
    };
    assert_eq!((ends("failed"), ends("skipped")), (vec!["recording"], vec!["solve", "render", "frames"]));
    assert!(bench.path("out/m/aside/frames.csv").is_file() && !bench.path("out/m/frames").exists());

    // Repaired input: what was finished is not run again.
    recordings::write(&bench.path("rec.h5"), Some(&recordings::events()), Some(&recordings::frames(3)));
    assert_eq!(executed(&bench.outcome(&["m.toml"])), ["frames", "recording", "render", "solve"]);
}

#[test]
fn an_ablation_goes_on_without_a_variant_that_fails() {
    let bench = Bench::new();
    write_bad_recording(&bench.path("bad.h5"));
    recordings::write_with_truth(&bench.path("rec.h5"), &recordings::events());
    // Where the true frames end, nothing is to be rendered.
    let base = recordings::pipeline().replace(
        "in = { tracks = \"solve.tracks\", sensor = \"sensor\" }",
        "in = { tracks = \"solve.tracks\", sensor = \"sensor\" }\nparams = { end = \"20 ms\" }",
    );
    let ablation = "[ablation]\nmetrics = [\"psnr.psnr_db\"]\nbaseline = \
                    { input = \"good\" }\n[ablation.axes.input]\ngood = \
                    { nodes.recording.params.path = \"rec.h5\" }\nbad = \
                    { nodes.recording.params.path = \"bad.h5\" }\n";
    bench.write("m.toml", &format!("{base}{SCORED}{ablation}"));
    let done = bench.run(&["run", "m.toml"]);
    assert_eq!(done.code, 4, "{}", done.stderr);
    let rows: Vec<Vec<&str>> = done.stdout.lines().map(|line| line.split_whitespace().collect()).collect();
    assert_eq!(rows[0], ["input", "psnr.psnr_db", "gain"]);
    assert_eq!(
        (rows[2][0], rows[2][2], rows[3].as_slice()),
        ("good", "+0.000", &["bad", "failed", "-"][..]),
        "{}",
        done.stdout
    );
    assert!(rows[2][1].parse::<f64>().is_ok_and(f64::is_finite), "{}", done.stdout);
    assert!(done.stderr.contains("x = 4000, y = 1"), "{}", done.stderr);
    assert!(
        bench.path("out/m/input=good/frames/frames.csv").is_file()
            && !bench.path("out/m/input=bad/frames").exists()
    );
    // Nothing that is finished runs again, and the failed variant fails again.
    let again = bench.run(&["run", "--json", "m.toml"]);
    let outcome: Value = serde_json::from_str(&again.stdout).expect("JSON");
    assert_eq!((again.code, outcome["executed"].as_u64(), outcome["failed"].as_u64()), (4, Some(0), Some(1)));
}
