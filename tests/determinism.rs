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
    assert_eq!(executed(&outcome).len(), 9, "a result from a cache would prove nothing");
    digests(&outcome)
}

#[test]
fn results_do_not_depend_on_threads_or_the_height_of_bands() {
    let expected = run(&["--threads", "1"]);
    for output in ["scene.events", "scene.frames", "scene.truth", "solve.tracks", "render.frames", "edi.frames", "psnr.scores", "table.table"] {
        assert!(expected.contains_key(output), "{output} is not among {:?}", expected.keys());
    }
    for threads in ["1", "2"] {
        for rows in ["1", "5", "7"] {
            assert_eq!(run(&["--threads", threads, "--band-rows", rows]), expected, "{threads} threads, bands of {rows} rows");
        }
    }
    assert_eq!(run(&["--threads", "2"]), expected);
    // So little memory that the engine itself cuts into bands, and waits.
    assert_eq!(run(&["--threads", "2", "--memory", "100kB"]), expected);
}

/// What the small pipeline gives, recorded. It does not depend on the machine: transcendental functions come from `libm`, and no multiply-add is
/// fused.
///
/// A change here means "results change": bump the `revision` of the node whose output is the first to differ, or caches keep the old
/// result under the new code's key, and say so in the changelog under *Results change*. Then record the new values:
/// `UPDATE_EXPECT=1 cargo test --test photocurrent determinism` prints them.
const GOLDEN: [(&str, &str); 5] = [
    ("scene.events", "e89221bda80abb7603457bf853fbb79adf7c9ce87ef9c69013b7ee503659bf98"),
    ("scene.frames", "4071e5a624aa39263c0935c146f1cbd5c25b28c1fa1fa747cbb5015f698f0d36"),
    ("solve.tracks", "6e92d1a5e89881a60e3f31f39508297b7c7a656f83e7fd36f647b5ad99d312a3"),
    ("render.frames", "54205b32400428bd73db8e6706b615455a988795ac4957823f975c9a16b1351d"),
    ("edi.frames", "d2cf5c7eba73dbf4407a8b0c754d439181ad8ecf8fd17a3b8933724c6c0291f8"),
];

#[test]
fn results_are_those_that_were_recorded() {
    let found = run(&[]);
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        // Written past the test harness, which holds back what a passing test prints.
        use std::io::Write;
        let lines: String = GOLDEN.iter().map(|(output, _)| format!("    ({output:?}, {:?}),\n", found[*output])).collect();
        std::io::stderr().write_all(format!("\n{lines}").as_bytes()).expect("stderr");
        return;
    }
    let changed: Vec<&str> = GOLDEN.iter().filter(|(output, digest)| found[*output] != *digest).map(|(output, _)| *output).collect();
    assert!(
        changed.is_empty(),
        "results change: {changed:?}\nwhen that is meant, bump the revision of the first node of these, write it into the changelog, and record with UPDATE_EXPECT=1"
    );
}
