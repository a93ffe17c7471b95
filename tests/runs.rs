//! Past runs of a manifest in one table: what was set, what changed, what came of it.

use crate::support::{Bench, small_pipeline};
use serde_json::Value;

/// The rows of the table, head and rule left out, each cut at two or more spaces.
fn rows(text: &str) -> Vec<Vec<String>> {
    let cells = |line: &str| {
        line.split("  ").map(str::trim).filter(|cell| !cell.is_empty()).map(String::from).collect()
    };
    text.lines().skip(2).map(cells).collect()
}

fn score(bench: &Bench, node: &str) -> String {
    let text = std::fs::read_to_string(bench.path("out/m/metrics.pooled.jsonl")).expect("scores");
    let mut lines = text.lines().map(|line| serde_json::from_str::<Value>(line).expect("JSON"));
    let value = lines.find(|line| line["node"] == node).expect("the score")["value"].as_f64();
    format!("{:.3}", value.expect("a number"))
}

#[test]
fn every_run_is_a_row_with_what_was_set_and_what_changed() {
    let bench = Bench::new();
    bench.write("m.toml", &small_pipeline());
    let none = bench.run(&["runs", "m.toml"]);
    assert!(none.code == 2 && none.stderr.contains("no run of it is known"), "{}", none.stderr);

    assert_eq!(bench.run(&["run", "m.toml", "--quiet"]).code, 0);
    let first = score(&bench, "psnr");
    let set = "nodes.solve.params.evs_weight=10";
    assert_eq!(bench.run(&["run", "m.toml", "--quiet", "--set", set]).code, 0);
    let second = score(&bench, "psnr");
    assert_ne!(first, second, "a weight that changes nothing would test nothing");
    // A change in the file, and a bound that does not hold.
    let text = small_pipeline().replace("cis_weight = 1.0", "cis_weight = 3.0");
    bench.write("m.toml", &format!("{text}[nodes.psnr.expect]\npsnr_db = {{ at_least = 100.0 }}\n"));
    assert_eq!(bench.run(&["run", "m.toml", "--quiet"]).code, 5);

    let done = bench.run(&["runs", "m.toml", "--metric", "psnr.psnr_db"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert!(done.stdout.starts_with("ended (UTC)"), "{}", done.stdout);
    let found = rows(&done.stdout);
    assert_eq!(found.len(), 3, "{}", done.stdout);
    // The first run has nothing set, so no cell there.
    assert_eq!(found[0][1..3], ["base".to_string(), first]);
    let changed = "--set nodes.solve.params.evs_weight=10; solve.evs_weight 1000.0 -> 10.0";
    assert_eq!(found[1][1..4], ["base".to_string(), changed.into(), second]);
    let third = &found[2];
    assert_eq!(third[2], "solve.cis_weight default -> 3.0; solve.evs_weight 10.0 -> 1000.0");
    assert_eq!(third[3], score(&bench, "psnr"));
    assert_eq!(third.last().expect("cells"), "5, 1 bound broken");
    assert_eq!(found[0][4..6], ["10".to_string(), "0".into()], "executed and reused");

    let last: Value =
        serde_json::from_str(&bench.run(&["runs", "m.toml", "--json", "--last", "1"]).stdout).expect("JSON");
    let last = last.as_array().expect("runs");
    assert_eq!((last.len(), &last[0]["code"], &last[0]["broken"]), (1, &5.into(), &1.into()));
    let wrong = bench.run(&["runs", "m.toml", "--metric", "ssim"]);
    assert!(
        wrong.code == 2 && wrong.stderr.contains("there are: psnr.psnr_db, psnr_edi.psnr_db"),
        "{}",
        wrong.stderr
    );
}

#[test]
fn variants_have_rows_of_their_own_and_a_cut_line_is_passed_over() {
    let bench = Bench::new();
    let ablation = "
[ablation.sweep]
\"nodes.solve.params.evs_weight\" = [10.0, 1000.0]
";
    bench.write("m.toml", &format!("{}{ablation}", small_pipeline()));
    assert_eq!(bench.run(&["run", "m.toml", "--quiet"]).code, 0);
    let log = std::fs::read_dir(bench.path(".photocurrent/runs")).expect("a log").next().expect("one");
    let log = log.expect("an entry").path();
    let line = std::fs::read_to_string(&log).expect("a line");
    std::fs::write(&log, format!("{line}{}\n{line}", &line[..line.len() / 2])).expect("a log");
    let done = bench.run(&["runs", "m.toml", "--metric", "psnr.psnr_db"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let variants: Vec<String> = rows(&done.stdout).into_iter().map(|row| row[1].clone()).collect();
    assert_eq!(variants, ["evs_weight=10", "evs_weight=1000"].repeat(2), "{}", done.stdout);
    assert!(done.stderr.contains("note: 1 line of "), "{}", done.stderr);
}
