//! Rows of a pipeline made apart and merged are the bytes of one process; a part is made once, and a part of
//! something else is refused.

use crate::support::{Bench, Done, digests};
use std::collections::BTreeMap;
use std::path::Path;

/// Light, events and frames, tracks, frames, scores and files: Pixel, Row and Whole in one chain, with rows
/// that reach over the edges of parts.
const PIPELINE: &str = r#"
format = 1
[pipeline]
seed = 5
[nodes.sensor]
kind = "read/sensor"
params = { path = "sensor.toml" }
[nodes.scene]
kind = "simulate/scene"
in = { sensor = "sensor" }
params = { scene = "texture", width = 32, height = 40, duration = "50 ms" }
[nodes.recording]
kind = "simulate/sensor"
in = { light = "scene.light", sensor = "sensor" }
[nodes.solve]
kind = "solve/map"
in = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }
[nodes.render]
kind = "render/rows"
in = { tracks = "solve.tracks", sensor = "sensor" }
params = { rate = "1 kHz", exposure = "100 us" }
[nodes.psnr]
kind = "score/psnr"
in = { frames = "render", truth = "scene.truth", sensor = "sensor" }
[nodes.pictures]
kind = "write/frames"
in = { frames = "render" }
"#;

fn bench() -> Bench {
    let bench = Bench::new();
    bench.write(
        "sensor.toml",
        &std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("data/sensors/hybrid.toml"))
            .expect("a description"),
    );
    bench.write("m.toml", PIPELINE);
    bench
}

/// What `--json` printed.
fn json(done: &Done) -> serde_json::Value {
    serde_json::from_str(&done.stdout)
        .unwrap_or_else(|_| panic!("--json prints JSON: {}{}", done.stdout, done.stderr))
}

fn pictures(bench: &Bench, out: &str) -> BTreeMap<String, Vec<u8>> {
    let folder = bench.path(out).join("pictures");
    let names = std::fs::read_dir(&folder).expect("pictures").map(|entry| entry.expect("an entry").path());
    let pictures = names.filter(|path| path.extension().is_some_and(|extension| extension == "png"));
    pictures
        .map(|path| {
            (
                path.file_name().expect("a name").to_string_lossy().into_owned(),
                std::fs::read(&path).expect("a file"),
            )
        })
        .collect()
}

fn part(bench: &Bench, rows: &str, name: &str, more: &[&str]) -> Done {
    bench.run(
        &[&["run", "m.toml", "--cache", &format!("cache-{name}"), "--rows", rows, "--part", name], more]
            .concat(),
    )
}

#[test]
fn parts_are_the_bytes_of_one_process_whatever_they_are_cut_into() {
    let bench = bench();
    let whole = bench.run(&["run", "m.toml", "--cache", "one", "--out", "out-one", "--json"]);
    assert_eq!(whole.code, 0, "{}", whole.stderr);
    // No rows: what must be whole before any, and how many rows there are.
    let prepared = part(&bench, "0..0", "prepared", &["--json"]);
    assert_eq!(
        (prepared.code, &json(&prepared)["all_rows"], &json(&prepared)["nodes"]),
        (0, &40.into(), &serde_json::json!([])),
        "{}",
        prepared.stderr
    );
    // Each in a cache of its own, as on machines that share nothing; one in bands of three rows, with two
    // threads.
    for (rows, name, more) in [
        ("0..13", "a", &[] as &[&str]),
        ("13..14", "b", &["--threads", "1"]),
        ("14..40", "c", &["--band-rows", "3", "--threads", "2"]),
    ] {
        let done = part(&bench, rows, name, more);
        assert_eq!(done.code, 0, "{}", done.stderr);
    }
    let merged =
        bench.run(&["merge", "m.toml", "c", "a", "b", "--cache", "joined", "--out", "out-joined", "--json"]);
    assert_eq!(merged.code, 0, "{}", merged.stderr);
    assert_eq!(digests(&json(&merged)), digests(&json(&whole)));
    let expected = pictures(&bench, "out-one");
    assert!(expected.len() > 10, "{}", expected.len());
    assert!(pictures(&bench, "out-joined") == expected, "files are the same, byte for byte");
    // The cache says the same whoever filled it: nothing is left to do, in either.
    let again = bench.run(&["run", "m.toml", "--cache", "joined", "--out", "out-joined", "--json"]);
    assert_eq!(json(&again)["executed"], 0);
}

#[test]
fn a_part_is_made_once_and_goes_on_where_it_stopped() {
    let bench = bench();
    let first = part(&bench, "0..20", "p", &["--json", "--band-rows", "5"]);
    assert_eq!(first.code, 0, "{}", first.stderr);
    assert_eq!(
        (json(&first)["nodes"].as_array().expect("nodes").len(), &json(&first)["all_rows"]),
        (4, &40.into())
    );
    let again = part(&bench, "0..20", "p", &["--json"]);
    assert_eq!((again.code, json(&again)["nodes"].as_array().map(Vec::len)), (0, Some(0)));
    // As a kill leaves it: without the file that makes it complete, and without some bands.
    let bands = bench.path("p").join("bands");
    let mut names: Vec<_> =
        std::fs::read_dir(&bands).expect("bands").map(|entry| entry.expect("an entry").path()).collect();
    names.sort();
    let before: BTreeMap<_, _> =
        names.iter().map(|path| (path.clone(), std::fs::read(path).expect("a file"))).collect();
    std::fs::remove_file(bench.path("p").join("part.toml")).expect("it is there");
    names.iter().step_by(3).for_each(|path| std::fs::remove_file(path).expect("it is there"));
    let on = part(&bench, "0..20", "p", &["--band-rows", "5"]);
    assert_eq!(on.code, 0, "{}", on.stderr);
    let after: BTreeMap<_, _> =
        before.keys().map(|path| (path.clone(), std::fs::read(path).expect("it is there again"))).collect();
    assert!(after == before, "bands are the same, byte for byte");
}

#[test]
fn what_does_not_fit_together_is_refused_with_what_to_do() {
    let bench = bench();
    assert_eq!(part(&bench, "0..20", "p", &[]).code, 0);
    let cases: [(&[&str], u8, &[&str]); 6] = [
        (&["merge", "m.toml", "p"], 3, &["no part has rows 20..40", "--rows 20..40 --part"]),
        (&["merge", "m.toml", "nowhere"], 1, &["part.toml", "run it again"]),
        (
            &["merge", "m.toml", "p", "--set", "nodes.recording.params.frame_rate=\"100 fps\""],
            3,
            &["another pipeline", "recording"],
        ),
        (&["run", "m.toml", "--rows", "0..10", "--part", "p"], 1, &["part of rows 0..20", "another folder"]),
        (&["run", "m.toml", "--rows", "30..50", "--part", "q"], 2, &["30..50", "between 0 and 40"]),
        (&["run", "m.toml", "--rows", "0..10"], 2, &["--part"]),
    ];
    for (arguments, code, said) in cases {
        let done = bench.run(arguments);
        assert_eq!(done.code, i32::from(code), "{arguments:?}: {}", done.stderr);
        for text in said {
            assert!(done.stderr.contains(text), "{arguments:?} should say `{text}`: {}", done.stderr);
        }
    }
    bench.write("full/mine.txt", "my notes");
    let done = bench.run(&["run", "m.toml", "--rows", "0..10", "--part", "full"]);
    assert!(done.code == 1 && done.stderr.contains("mine.txt"), "{}", done.stderr);
    assert!(bench.path("full").join("mine.txt").exists());
}
