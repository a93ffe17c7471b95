//! The same bits for any number of threads, any band height, any machine.
//!
//! Digests are over contents, so equal digests are equal numbers to the last bit.

use crate::support::{self, Bench, digests, executed};
use std::collections::BTreeMap;

fn run(how: &[&str]) -> BTreeMap<String, String> {
    let bench = Bench::new();
    bench.write("m.toml", &support::small_pipeline());
    let mut arguments = vec!["m.toml"];
    arguments.extend(how);
    let outcome = bench.outcome(&arguments);
    assert_eq!(executed(&outcome).len(), 10, "a result from a cache would prove nothing");
    digests(&outcome)
}

#[test]
fn results_do_not_depend_on_threads_or_the_height_of_bands() {
    let expected = run(&["--threads", "1"]);
    for output in [
        "recording.events",
        "recording.frames",
        "scene.light",
        "scene.truth",
        "solve.tracks",
        "render.frames",
        "edi.frames",
        "psnr.scores",
        "table.table",
    ] {
        assert!(expected.contains_key(output), "{output} is not among {:?}", expected.keys());
    }
    for threads in ["1", "2"] {
        for rows in ["1", "5", "7"] {
            assert_eq!(
                run(&["--threads", threads, "--band-rows", rows]),
                expected,
                "{threads} threads, bands of {rows} rows"
            );
        }
    }
    assert_eq!(run(&["--threads", "2"]), expected);
    // So little memory that the engine itself cuts into bands, and waits.
    assert_eq!(run(&["--threads", "2", "--memory", "100kB"]), expected);
}

#[test]
fn pixels_that_wait_for_each_other_do_not_depend_on_threads_or_the_height_of_bands() {
    let sensor = "kind = \"read/sensor\"\nparams = { path = \"hybrid.toml\", change = \
                             { effects = { readout_queue = { service = \"2 us\" } } } }";
    let scene = "kind = \"simulate/scene\"\nin.sensor = \"sensor\"\nparams = \
                 { scene = \"fan\", width = 24, height = 20, duration = \"20 ms\" }";
    let recording = "kind = \"simulate/sensor\"\nin = { light = \"scene.light\", sensor = \"sensor\" }";
    let queued = format!(
        "format = 1\n[nodes.sensor]\n{sensor}\n[nodes.scene]\n{scene}\n[nodes.recording]\n{recording}\n"
    );
    let run = |text: &str, how: &[&str]| {
        let bench = Bench::new();
        std::fs::copy(support::root().join("data/sensors/hybrid.toml"), bench.path("hybrid.toml"))
            .expect("a description");
        bench.write("m.toml", text);
        digests(&bench.outcome(&[&["m.toml"], how].concat()))
    };
    let expected = run(&queued, &["--threads", "1"]);
    assert_eq!(run(&queued, &["--threads", "2", "--band-rows", "3"]), expected);
    let alone = run(&queued.replace("2 us", "0 us"), &["--band-rows", "3"]);
    assert_eq!(alone["scene.light"], expected["scene.light"]);
    assert_ne!(
        alone["recording.events"], expected["recording.events"],
        "a queue that nobody waits in would prove nothing"
    );
    assert_eq!(alone["recording.frames"], expected["recording.frames"]);
}

/// What the small pipeline gives, recorded. It does not depend on the machine: transcendental functions come
/// from `libm` and the sensor crate, and no multiply-add is fused.
///
/// A change here means "results change": bump the `revision` of the node whose output is the first to differ,
/// or caches keep the old result under the new code's key, and say so in the changelog under *Results
/// change*. Then record the new values: `UPDATE_EXPECT=1 cargo test --test photocurrent determinism` prints
/// them.
const GOLDEN: [(&str, &str); 5] = [
    ("recording.events", "89d71da92dd3c761a10386e9672e831b6402dffe37f7fa2ebbea6fd443f00e35"),
    ("recording.frames", "9a8002d8e76271df977dbcec4b082e5445e4c49103835a9acbd35fdab6bd7e77"),
    ("solve.tracks", "af1a998d6823cfbcc33bedcd0e9bc57afab82c5c06aa612981d92f3b324085e3"),
    ("render.frames", "75f187354b0d70f8bc9dff1bed06165abc7799be42d0e24a97821a040a568c2d"),
    ("edi.frames", "4df4bbaa88b4bf44c4f55cfa84ed663166f16e81150b6cd99a5547d13f433568"),
];

#[test]
fn results_are_those_that_were_recorded() {
    let found = run(&[]);
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        // Written past the test harness, which holds back what a passing test prints.
        use std::io::Write;
        let lines: String =
            GOLDEN.iter().map(|(output, _)| format!("    ({output:?}, {:?}),\n", found[*output])).collect();
        std::io::stderr().write_all(format!("\n{lines}").as_bytes()).expect("stderr");
        return;
    }
    let changed: Vec<&str> = GOLDEN
        .iter()
        .filter(|(output, digest)| found[*output] != *digest)
        .map(|(output, _)| *output)
        .collect();
    assert!(
        changed.is_empty(),
        "results change: {changed:?}\nwhen that is meant, bump the revision of the first node of these, \
         write it into the changelog, and record with UPDATE_EXPECT=1"
    );
}
