//! What runs again after a change, and what does not; what the commands say about it before; and the cache's
//! own commands.
//!
//! The expected lists follow from the wiring of [`support::small_pipeline`] alone: a change reruns the nodes
//! that depend on what was changed, as far as results differ, and no others.

use crate::support::{self, Bench, digests, executed, files, results};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

const ALL: [&str; 10] =
    ["edi", "frames", "psnr", "psnr_edi", "recording", "render", "scene", "sensor", "solve", "table"];

/// A bench with the small pipeline as `m.toml`, its sensor description next to it as `sensor.toml`.
fn bench() -> Bench {
    let bench = Bench::new();
    std::fs::copy(support::root().join("data/sensors/hybrid.toml"), bench.path("sensor.toml"))
        .expect("the sensor description");
    bench.write("m.toml", &local_pipeline());
    bench
}

fn local_pipeline() -> String {
    replaced(
        &support::small_pipeline(),
        &format!("{:?}", support::root().join("data/sensors/hybrid.toml")),
        "\"sensor.toml\"",
    )
}

/// A replacement that replaces nothing would make a test that tests nothing.
fn replaced(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "the text has no `{from}`");
    text.replace(from, to)
}

fn edit(bench: &Bench, name: &str, from: &str, to: &str) {
    let text = std::fs::read_to_string(bench.path(name)).expect("a text file");
    bench.write(name, &replaced(&text, from, to));
}

fn states(bench: &Bench, arguments: &[&str]) -> BTreeMap<String, String> {
    let mut all = vec!["plan", "--json", "m.toml"];
    all.extend(arguments);
    let done = bench.run(&all);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let plan: serde_json::Value = serde_json::from_str(&done.stdout).expect("--json prints JSON");
    let state = |task: &serde_json::Value| {
        (
            task["node"].as_str().expect("a name").to_string(),
            task["state"].as_str().expect("a state").to_string(),
        )
    };
    plan["tasks"].as_array().expect("tasks").iter().map(state).collect()
}

fn explained(bench: &Bench, node: &str, arguments: &[&str]) -> String {
    let mut all = vec!["explain", "m.toml", node];
    all.extend(arguments);
    let done = bench.run(&all);
    assert_eq!(done.code, 0, "{}", done.stderr);
    done.stdout
}

#[test]
fn a_second_run_executes_nothing_and_says_so() {
    let bench = bench();
    let first = bench.outcome(&["m.toml"]);
    assert_eq!(executed(&first), ALL);
    let exported = results(&bench.path("out"));
    let second = bench.run(&["run", "m.toml"]);
    assert_eq!(second.code, 0, "{}", second.stderr);
    assert!(
        second.stderr.contains("0 nodes executed: all 10 results were in the cache"),
        "{}",
        second.stderr
    );
    let third = bench.outcome(&["m.toml"]);
    assert_eq!((executed(&third), third["reused"].as_u64()), (vec![], Some(10)));
    assert_eq!(digests(&third), digests(&first));
    assert_eq!(results(&bench.path("out")), exported);
}

#[test]
fn a_changed_weight_reruns_the_solver_and_what_follows_as_plan_and_explain_predict() {
    let bench = bench();
    let first = bench.outcome(&["m.toml"]);
    let change = ["--set", "nodes.solve.params.cis_weight=2"];

    let predicted = states(&bench, &change);
    let those = |state: &str| {
        predicted
            .iter()
            .filter(|(_, found)| *found == state)
            .map(|(node, _)| node.as_str())
            .collect::<Vec<_>>()
    };
    assert_eq!(those("miss"), ["solve"]);
    assert_eq!(those("waits"), ["frames", "psnr", "render", "table"]);
    assert_eq!(those("hit"), ["edi", "psnr_edi", "recording", "scene", "sensor"]);
    assert_eq!(explained(&bench, "solve", &change), "solve: would run\n  params.cis_weight 1.0 -> 2.0\n");
    assert_eq!(explained(&bench, "render", &change), "render: waits for solve\n");
    assert_eq!(explained(&bench, "edi", &change), "edi: in the cache\n");

    let second = bench.outcome(&["m.toml", change[0], change[1]]);
    assert_eq!(executed(&second), ["frames", "psnr", "render", "solve", "table"]);
    let (before, after) = (digests(&first), digests(&second));
    assert_ne!(
        after["solve.tracks"], before["solve.tracks"],
        "a weight that changes nothing would test nothing"
    );
    assert_eq!(after["recording.events"], before["recording.events"]);
    // The way back is in the cache: only the files have to be written again, over those of the other weight.
    assert_eq!(executed(&bench.outcome(&["m.toml"])), ["frames", "table"]);
}

#[test]
fn comments_the_order_of_keys_and_the_spelling_of_units_rerun_nothing() {
    let bench = bench();
    let text = replaced(
        &local_pipeline(),
        r#"in = { tracks = "solve.tracks", sensor = "sensor" }"#,
        "in = { tracks = \"solve.tracks\", sensor = \"sensor\" }\nparams = \
         { exposure = \"100 us\", rate = \"1 kHz\" }",
    );
    bench.write("m.toml", &text);
    bench.outcome(&["m.toml"]);
    let spelled = [
        (
            "a comment",
            format!("# What it is for.\n{}", replaced(&text, "seed = 7", "seed = 7 # drawn by lot")),
        ),
        (
            "the order of keys",
            replaced(&text, "cis_weight = 1.0, evs_weight = 1000.0", "evs_weight = 1000.0, cis_weight = 1.0"),
        ),
        ("microseconds as milliseconds", replaced(&text, "\"100 us\"", "\"0.1 ms\"")),
        ("milliseconds as seconds", replaced(&text, "\"40 ms\"", "\"0.04 s\"")),
        ("kilohertz as hertz", replaced(&text, "\"1 kHz\"", "\"1000 Hz\"")),
        ("a whole number without its point", replaced(&text, "cis_weight = 1.0", "cis_weight = 1")),
        (
            "a default written out",
            replaced(&text, "cis_weight = 1.0", "cis_weight = 1.0, front_end = \"low_pass\""),
        ),
        (
            "dotted keys",
            replaced(
                &text,
                "params = { exposure = \"100 us\", rate = \"1 kHz\" }",
                "params.rate = \"1 kHz\"\nparams.exposure = \"100 us\"",
            ),
        ),
    ];
    for (what, text) in spelled {
        bench.write("m.toml", &text);
        assert_eq!(executed(&bench.outcome(&["m.toml"])), [""; 0], "{what}");
    }
}

#[test]
fn a_renamed_node_and_a_moved_manifest_rerun_nothing() {
    let bench = bench();
    let first = bench.outcome(&["m.toml", "--out", "out"]);
    let renamed = replaced(
        &replaced(&local_pipeline(), "[nodes.solve]", "[nodes.invert]"),
        "\"solve.tracks\"",
        "\"invert.tracks\"",
    );
    bench.write("renamed.toml", &renamed);
    assert_eq!(executed(&bench.outcome(&["renamed.toml", "--out", "out"])), [""; 0]);

    bench.write("far/away/m.toml", &local_pipeline());
    std::fs::copy(bench.path("sensor.toml"), bench.path("far/away/sensor.toml")).expect("a copy");
    let moved = bench.outcome(&["far/away/m.toml", "--out", "out"]);
    assert_eq!(executed(&moved), [""; 0]);
    assert_eq!(digests(&moved), digests(&first));
}

#[test]
fn a_changed_value_in_an_input_file_reruns_what_depends_on_it_and_the_file_is_named() {
    let bench = bench();
    bench.outcome(&["m.toml"]);
    edit(&bench, "sensor.toml", "threshold_on    = 0.20", "threshold_on    = 0.25");
    let why = explained(&bench, "sensor", &[]);
    assert!(
        why.starts_with("sensor: would run\n  file ")
            && why.ends_with("sensor.toml changed content\n")
            && why.lines().count() == 2,
        "{why}"
    );
    assert_eq!(executed(&bench.outcome(&["m.toml"])), ALL);
}

#[test]
fn a_changed_comment_in_an_input_file_reruns_its_reader_only() {
    let bench = bench();
    let first = bench.outcome(&["m.toml"]);
    edit(
        &bench,
        "sensor.toml",
        "# Eq. (3): bandwidth of a bright pixel",
        "# Eq. (3): bandwidth of a very bright pixel",
    );
    let why = explained(&bench, "sensor", &[]);
    assert!(why.contains("sensor.toml changed content"), "{why}");
    assert_eq!(states(&bench, &[])["solve"], "waits");
    let second = bench.outcome(&["m.toml"]);
    assert_eq!(executed(&second), ["sensor"]);
    assert_eq!(digests(&second), digests(&first));
}

#[test]
fn equal_results_upstream_stop_a_rerun() {
    let bench = bench();
    bench.outcome(&["m.toml"]);
    // A name changes no number, so whoever takes the description runs, gives what it gave, and nobody after
    // that runs.
    edit(&bench, "sensor.toml", "hybrid, indoor", "hybrid, in a room");
    assert_eq!(
        executed(&bench.outcome(&["m.toml"])),
        ["edi", "recording", "render", "scene", "sensor", "solve"]
    );
}

#[test]
fn a_forced_node_runs_and_equal_output_ends_it_there() {
    let bench = bench();
    let first = bench.outcome(&["m.toml"]);
    let forced = bench.outcome(&["m.toml", "--force", "solve"]);
    assert_eq!(executed(&forced), ["solve"]);
    assert_eq!(digests(&forced), digests(&first));
    let unknown = bench.run(&["run", "m.toml", "--force", "solv"]);
    assert_eq!(unknown.code, 2);
    assert!(unknown.stderr.contains("did you mean `solve`?"), "{}", unknown.stderr);
}

#[test]
fn exported_files_that_are_gone_or_cut_short_rerun_only_their_writer() {
    let bench = bench();
    bench.outcome(&["m.toml"]);
    let whole = results(&bench.path("out"));
    let frame = bench.path("out/m/frames/000003.png");
    assert!(whole.contains_key(Path::new("m/frames/000003.png")));
    type Harm = fn(&Path);
    let harms: [(&str, &str, Harm); 4] = [
        ("frames", "frames/000003.png", |path| std::fs::remove_file(path).expect("gone")),
        ("frames", "frames/000003.png", |path| std::fs::write(path, "half").expect("cut")),
        ("frames", "frames", |path| std::fs::remove_dir_all(path).expect("gone")),
        ("table", "table/table.md", |path| std::fs::remove_file(path).expect("gone")),
    ];
    for (writer, name, harm) in harms {
        harm(&bench.path("out/m").join(name));
        assert_eq!(states(&bench, &[])[writer], "miss", "{name}");
        assert_eq!(executed(&bench.outcome(&["m.toml"])), [writer], "{name}");
        assert_eq!(results(&bench.path("out")), whole, "{name}");
    }
    std::fs::remove_file(&frame).expect("gone");
    assert_eq!(explained(&bench, "frames", &[]), "frames: would run\n  exported file 000003.png is gone\n");
}

#[test]
fn another_output_folder_reruns_the_writers_only() {
    let bench = bench();
    bench.outcome(&["m.toml"]);
    assert_eq!(executed(&bench.outcome(&["m.toml", "--out", "elsewhere"])), ["frames", "table"]);
    assert!(
        bench.path("elsewhere/frames/frames.csv").is_file()
            && bench.path("out/m/frames/frames.csv").is_file()
    );
}

#[test]
fn somebodys_own_files_are_not_overwritten_and_the_way_out_is_said() {
    let bench = bench();
    let mine = bench.write("out/m/frames/holiday.txt", "mine");
    let refused = bench.run(&["run", "m.toml", "--json"]);
    assert_eq!(refused.code, 1, "{}", refused.stderr);
    for part in [
        "out/m/frames holds files that this tool did not write there",
        "holiday.txt",
        "move them away, or choose another output folder with `--out`",
    ] {
        assert!(refused.stderr.contains(part), "{}", refused.stderr);
    }
    assert_eq!(
        files(&bench.path("out/m/frames")),
        BTreeMap::from([(PathBuf::from(mine.file_name().expect("a name")), b"mine".to_vec())])
    );
    // Everything else is done; the writer alone remains.
    let outcome: serde_json::Value = serde_json::from_str(&refused.stdout).expect("JSON");
    assert_eq!((outcome["executed"].as_u64(), outcome["failed"].as_u64()), (Some(9), Some(1)));
    std::fs::remove_file(mine).expect("moved away");
    assert_eq!(executed(&bench.outcome(&["m.toml"])), ["frames"]);

    // Also among files of ours: what the stamp does not name stays.
    let mine = bench.write("out/m/frames/holiday.txt", "mine");
    let refused = bench.run(&["run", "m.toml", "--set", "nodes.solve.params.cis_weight=2"]);
    assert_eq!(refused.code, 1, "{}", refused.stderr);
    assert_eq!(std::fs::read(mine).expect("still there"), b"mine");
}

#[test]
fn the_caches_commands_list_weigh_check_and_clear() {
    let bench = bench();
    let before = bench.run(&["cache", "ls"]);
    assert_eq!(before.code, 2);
    assert!(
        before.stderr.contains("there is no cache at .photocurrent")
            && before.stderr.contains("--cache names another"),
        "{}",
        before.stderr
    );
    let first = bench.outcome(&["m.toml"]);

    let json = |arguments: &[&str]| -> serde_json::Value {
        let done = bench.run(arguments);
        assert_eq!(done.code, 0, "{}", done.stderr);
        serde_json::from_str(&done.stdout).expect("JSON")
    };
    let listed = json(&["cache", "ls", "--json"]);
    let mut kinds: Vec<&str> = listed
        .as_array()
        .expect("a list")
        .iter()
        .map(|entry| entry["kind"].as_str().expect("a kind"))
        .collect();
    kinds.sort_unstable();
    let expected = [
        "baseline/edi",
        "read/sensor",
        "render/rows",
        "score/psnr",
        "score/psnr",
        "simulate/scene",
        "simulate/sensor",
        "solve/paper",
        "write/frames",
        "write/table",
    ];
    assert_eq!(kinds, expected);
    let text = bench.run(&["cache", "ls"]).stdout;
    assert!(text.lines().count() == 12 && text.contains("simulate/scene"), "{text}");

    // Contents are stored once: as many files as there are different digests.
    let different: BTreeSet<String> = digests(&first).into_values().collect();
    let used = json(&["cache", "du", "--json"]);
    assert_eq!(
        (used["records"].as_u64(), used["contents"].as_u64()),
        (Some(10), Some(different.len() as u64))
    );
    let on_disk = |ending: &str| {
        let data = std::fs::read_dir(bench.path(".photocurrent/data"))
            .expect("data")
            .map(|entry| entry.expect("an entry"));
        data.filter(|entry| entry.path().extension().is_some_and(|e| e == ending))
            .map(|entry| entry.metadata().expect("metadata").len())
            .sum::<u64>()
    };
    assert_eq!(used["content_bytes"].as_u64(), Some(on_disk("h5")));
    assert_eq!((used["unreferenced_bytes"].as_u64(), used["temporary_bytes"].as_u64()), (Some(0), Some(0)));

    let checked = json(&["cache", "verify", "--json"]);
    assert_eq!(
        (checked["good_records"].as_u64(), checked["good_contents"].as_u64()),
        (Some(10), Some(different.len() as u64))
    );
    assert_eq!(
        (checked["damaged"].as_array(), checked["orphans"].as_array()),
        (Some(&vec![]), Some(&vec![]))
    );

    // Room enough and young enough: everything stays, and is used.
    let kept = json(&["cache", "gc", "--max-size", "1GB", "--older-than", "1", "--json"]);
    assert_eq!(
        (kept["records"].as_u64(), kept["freed_bytes"].as_u64(), kept["kept_bytes"].as_u64()),
        (Some(0), Some(0), Some(on_disk("h5")))
    );
    assert_eq!(executed(&bench.outcome(&["m.toml"])), [""; 0]);

    let rehearsed = json(&["cache", "gc", "--older-than", "0", "--dry-run", "--json"]);
    assert_eq!(rehearsed["records"].as_u64(), Some(10));
    assert_eq!(json(&["cache", "du", "--json"]), used);
    let cleared = bench.run(&["cache", "gc", "--older-than", "0"]);
    assert!(
        cleared.stdout.starts_with(&format!("removed 10 records and {} contents, ", different.len())),
        "{}",
        cleared.stdout
    );
    let empty = json(&["cache", "du", "--json"]);
    assert_eq!(
        (empty["records"].as_u64(), empty["contents"].as_u64(), on_disk("h5"), on_disk("sum")),
        (Some(0), Some(0), 0, 0)
    );
    let again = bench.outcome(&["m.toml"]);
    assert_eq!((executed(&again), digests(&again)), (ALL.map(String::from).to_vec(), digests(&first)));
}

#[test]
fn no_room_at_all_leaves_nothing() {
    let bench = bench();
    bench.outcome(&["m.toml"]);
    let none = bench.run(&["cache", "gc", "--max-size", "0"]);
    assert!(
        none.code == 0 && none.stdout.starts_with("removed 10 records"),
        "{}{}",
        none.stdout,
        none.stderr
    );
    assert!(none.stdout.ends_with("0 B stay\n"), "{}", none.stdout);
}

#[test]
fn looking_makes_no_folder() {
    let bench = bench();
    let before = files(&bench.path(""));
    let looks: [&[&str]; 9] = [
        &["plan", "m.toml"],
        &["plan", "m.toml", "--json"],
        &["explain", "m.toml", "solve"],
        &["check", "m.toml"],
        &["graph", "m.toml"],
        &["graph", "m.toml", "--format", "svg"],
        &["nodes"],
        &["nodes", "solve/paper"],
        &["schema"],
    ];
    for look in looks {
        let done = bench.run(look);
        assert_eq!(done.code, 0, "{look:?}: {}", done.stderr);
        assert_eq!(files(&bench.path("")), before, "{look:?}");
        let entries = std::fs::read_dir(bench.path("")).expect("the bench").count();
        assert_eq!(entries, 2, "{look:?} made a folder");
    }
}

#[test]
fn looking_at_a_cache_leaves_it_as_it_was() {
    let bench = bench();
    bench.outcome(&["m.toml"]);
    let kept = || ["keys", "data", "history"].map(|name| files(&bench.path(".photocurrent").join(name)));
    let (cache, out) = (kept(), files(&bench.path("out")));
    for look in [
        &["plan", "m.toml", "--set", "pipeline.seed=8"][..],
        &["explain", "m.toml", "scene", "--set", "pipeline.seed=8"],
        &["cache", "ls"],
        &["cache", "verify"],
    ] {
        assert_eq!(bench.run(look).code, 0, "{look:?}");
        assert!(kept() == cache && files(&bench.path("out")) == out, "{look:?}");
    }
    assert_eq!(
        explained(&bench, "scene", &["--set", "pipeline.seed=8"]),
        "scene: would run\n  seed 7 -> 8\n"
    );
}

#[test]
fn a_part_of_the_pipeline_runs_what_it_needs_and_the_rest_later() {
    let bench = bench();
    let part = bench.outcome(&["m.toml", "--to", "render"]);
    assert_eq!(executed(&part), ["recording", "render", "scene", "sensor", "solve"]);
    assert!(!bench.path("out/m/frames").exists());
    // The scene's true frames were not wanted then and are now, so it runs again; its other outputs come out
    // as before, and what took them stays.
    let whole = bench.outcome(&["m.toml"]);
    assert_eq!(executed(&whole), ["edi", "frames", "psnr", "psnr_edi", "scene", "table"]);
    assert_eq!(digests(&whole)["render.frames"], digests(&part)["render.frames"]);
    assert_eq!(executed(&bench.outcome(&["m.toml", "--to", "render"])), [""; 0]);
}

#[test]
fn bands_threads_and_memory_are_no_part_of_a_key() {
    let bench = bench();
    let first = bench.outcome(&["m.toml", "--threads", "2"]);
    let hows: [&[&str]; 6] = [
        &["--band-rows", "1"],
        &["--band-rows", "5"],
        &["--band-rows", "7", "--threads", "1"],
        &["--threads", "3"],
        &["--memory", "1MB"],
        &["--memory", "8GiB"],
    ];
    for how in hows {
        let mut arguments = vec!["m.toml"];
        arguments.extend(how);
        let again = bench.outcome(&arguments);
        assert_eq!(executed(&again), [""; 0], "{how:?}");
        assert_eq!(digests(&again), digests(&first), "{how:?}");
    }
}
