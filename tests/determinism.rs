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
    for output in
        ["recording.events", "recording.frames", "scene.light", "scene.truth", "solve.tracks", "render.frames", "edi.frames", "psnr.scores", "table.table"]
    {
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
    ("recording.events", "218c400fb3687067f941fec0e96b0b20e4a4cf4d4e57e2930446b35139d9c222"),
    ("recording.frames", "7303c87bd990d0e1b516cf1c86e78871dcc95d9d9f911a83518da4ef982f0426"),
    ("solve.tracks", "dc00b24805e73dc2e56d108e637822b96a4bff617e92d6e0c9d94d4730e89775"),
    ("render.frames", "517efab63b529a49a4ab77b06d510082e6d83fda0932712eb1699e0ae9301785"),
    ("edi.frames", "7ab10b60a9049249d6c48b4ed41869a3c9dc3c60d06e31ce5b4c4a5d048095fd"),
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
