//! Bounds on scores: what a run says of them, where it is stored, the exit code.
//!
//! Limits are set around what the run itself measured, which `metrics.pooled.jsonl` states; what is tested is
//! the verdict on it.

use crate::support::{Bench, executed, small_pipeline};
use serde_json::Value;

/// A pooled score of the last run of `m.toml`: `value`, `min` and so on of `psnr.psnr_db`.
fn psnr(bench: &Bench, number: &str) -> f64 {
    let text = std::fs::read_to_string(bench.path("out/m/metrics.pooled.jsonl")).expect("scores");
    let line = text.lines().map(|line| serde_json::from_str::<Value>(line).expect("JSON"));
    let line = line.into_iter().find(|line| line["node"] == "psnr").expect("the score");
    line[number].as_f64().expect("a number")
}

fn with_bounds(bounds: &str) -> String {
    format!("{}[nodes.psnr.expect]\n{bounds}\n", small_pipeline())
}

#[test]
fn a_bound_runs_nothing_anew_and_decides_the_exit_code() {
    let bench = Bench::new();
    bench.write("m.toml", &small_pipeline());
    assert_eq!(bench.run(&["run", "m.toml"]).code, 0);
    let measured = psnr(&bench, "value");
    let keys = crate::support::files(&bench.path(".photocurrent/keys")).into_keys().collect::<Vec<_>>();

    bench.write("m.toml", &with_bounds(&format!("psnr_db = {{ at_least = {} }}", measured + 0.5)));
    let broken = bench.run(&["run", "m.toml"]);
    assert_eq!(broken.code, 5, "{}", broken.stderr);
    let said = format!("error: psnr.psnr_db is {measured:.3} dB, expected at least {}", measured + 0.5);
    let line = 1 + small_pipeline().lines().count() + 1;
    for part in
        ["0 nodes executed", &said, &format!("(m.toml:{line}:1)"), "expect: 0 of 1 bound pass, 1 fail"]
    {
        assert!(broken.stderr.contains(part), "`{part}` is missing from\n{}", broken.stderr);
    }
    let quiet = bench.run(&["run", "m.toml", "--quiet"]);
    assert!(quiet.code == 5 && quiet.stderr.starts_with(&said), "{}", quiet.stderr);
    let others = crate::support::files(&bench.path(".photocurrent/keys")).into_keys().collect::<Vec<_>>();
    assert_eq!(others, keys, "a bound is no ingredient");

    let set = format!("nodes.psnr.expect.psnr_db.at_least={}", measured - 0.5);
    let held = bench.run(&["run", "m.toml", "--set", &set]);
    assert_eq!(held.code, 0, "{}", held.stderr);
    assert!(held.stderr.contains("expect: 1 of 1 bound pass\n"), "{}", held.stderr);
}

#[test]
fn a_warning_changes_no_exit_code_and_the_worst_frame_has_a_bound_of_its_own() {
    let bench = Bench::new();
    bench.write("m.toml", &small_pipeline());
    assert_eq!(bench.run(&["run", "m.toml", "--quiet"]).code, 0);
    let (mean, worst) = (psnr(&bench, "value"), psnr(&bench, "min"));
    assert!(worst < mean - 0.1, "frames that do not differ would test nothing: {worst} and {mean}");
    let between = (mean + worst) / 2.0;
    bench.write(
        "m.toml",
        &with_bounds(&format!(
            "psnr_db = [{{ at_least = {between}, warn_below = {} }}, \
             {{ at_least = {between}, of = \"min\" }}]",
            mean + 1.0
        )),
    );
    let done = bench.run(&["run", "m.toml", "--json"]);
    assert_eq!(done.code, 5, "{}", done.stderr);
    assert!(
        done.stderr.contains(&format!("warning: psnr.psnr_db is {mean:.3} dB: a warning below"))
            && done.stderr.contains(&format!("error: psnr.psnr_db (min) is {worst:.3} dB, expected")),
        "{}",
        done.stderr
    );
    let outcome: Value = serde_json::from_str(&done.stdout).expect("--json prints JSON");
    assert_eq!(executed(&outcome), Vec::<String>::new());
    let record = std::fs::read_to_string(bench.path("out/m/run.json")).expect("run.json");
    let record: Value = serde_json::from_str(&record).expect("JSON");
    assert_eq!(record["expect"], outcome["expect"]);
    let found: Vec<(&Value, f64)> = outcome["expect"]
        .as_array()
        .expect("bounds")
        .iter()
        .map(|bound| (&bound["verdict"], bound["value"].as_f64().expect("a value")))
        .collect();
    assert_eq!(found, [(&Value::from("warn"), mean), (&Value::from("fail"), worst)]);

    // A warning alone.
    let set = format!("nodes.psnr.expect.psnr_db=[{{ warn_below = {} }}]", mean + 1.0);
    let done = bench.run(&["run", "m.toml", "--set", &set]);
    assert!(done.code == 0 && done.stderr.contains("expect: 0 of 1 bound pass, 1 warn"), "{}", done.stderr);
}

#[test]
fn the_report_shows_bounds_first_and_marks_the_node() {
    let bench = Bench::new();
    bench.write("m.toml", &with_bounds("psnr_db = { at_least = 100.0 }"));
    assert_eq!(bench.run(&["run", "m.toml", "--quiet"]).code, 5);
    let done = bench.run(&["report", "m.toml", "-o", "page.html"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let html = std::fs::read_to_string(bench.path("page.html")).expect("the page");
    for part in [
        "<caption>Bounds on scores</caption>",
        "<th scope=\"row\">psnr.psnr_db</th><td class=\"broken\">\u{2715} out of bounds</td>",
        "<td>at least 100</td>",
        "expected at least 100</p>",
        "<g class=\"node executed broken\"><title>psnr, score/psnr</title>",
        ">out of bounds, ran ",
    ] {
        assert!(html.contains(part), "`{part}` is missing");
    }
    assert_eq!(html.matches("executed broken").count(), 1, "the other score has no bound");
}

#[test]
fn a_score_that_a_run_does_not_have_is_not_checked() {
    let bench = Bench::new();
    let broken = "
[nodes.mine]
kind = \"baseline/exec\"
in = { events = \"recording.events\", frames = \"recording.frames\", sensor = \"sensor\" }
params = { command = [\"false\"], version = \"1\", white = 1023 }
[nodes.psnr_mine]
kind = \"score/psnr\"
in = { frames = \"mine\", truth = \"scene.truth\", sensor = \"sensor\" }
expect = { psnr_db = { at_least = 20.0 } }
";
    bench.write("m.toml", &format!("{}{broken}", with_bounds("psnr_db = { at_least = 100.0 }")));
    let done = bench.run(&["run", "m.toml"]);
    assert_eq!(done.code, 1, "a failed node comes before a broken bound\n{}", done.stderr);
    for part in
        ["not checked: psnr_mine.psnr_db: this run has no result of psnr_mine", ", 1 fail, 1 unchecked"]
    {
        assert!(done.stderr.contains(part), "`{part}` is missing from\n{}", done.stderr);
    }
    // A run that does not reach a node does not judge it.
    let part = bench.run(&["run", "m.toml", "--to", "edi"]);
    assert!(part.code == 0 && !part.stderr.contains("expect"), "{}", part.stderr);
}

#[test]
fn variants_have_bounds_of_their_own() {
    let bench = Bench::new();
    let ablation = "
[ablation.axes.weight]
low  = { nodes.solve.params.evs_weight = 10.0, nodes.psnr.expect.psnr_db.at_least = 1.0 }
high = { nodes.solve.params.evs_weight = 1000.0 }
";
    bench.write("m.toml", &format!("{}{ablation}", with_bounds("psnr_db = { at_least = 100.0 }")));
    let done = bench.run(&["run", "m.toml"]);
    assert_eq!(done.code, 5, "{}", done.stderr);
    assert!(
        done.stderr.contains("error: weight=high: psnr.psnr_db is ")
            && !done.stderr.contains("weight=low: psnr.psnr_db")
            && done.stderr.contains("expect: 1 of 2 bounds pass, 1 fail"),
        "{}",
        done.stderr
    );
}

#[test]
fn the_manual_lists_the_scores_that_may_have_bounds() {
    let page = Bench::new().run(&["nodes", "score/heldout"]).stdout;
    assert!(
        page.contains("Scores, on which `expect` sets bounds: `heldout_rmse_dn`, `heldout_psnr_db`"),
        "{page}"
    );
}
