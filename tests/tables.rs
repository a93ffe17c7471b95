//! `photocurrent table`: the scores of a finished run, laid out, marked and drawn.

use crate::support::{Bench, small_pipeline};
use serde_json::Value;

/// A run of two variants: (bench, pooled lines).
fn finished() -> (Bench, Vec<Value>) {
    let bench = Bench::new();
    let ablation = "[ablation]\nabout = \"weights\"\n[ablation.sweep]\n\"nodes.solve.params.evs_weight\" = \
                    [1.0, 1000.0]\n";
    bench.write("m.toml", &format!("{}\n{ablation}", small_pipeline()));
    let done = bench.run(&["run", "m.toml", "--quiet", "--to", "psnr", "--to", "psnr_edi"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let text = std::fs::read_to_string(bench.path("out/m/metrics.pooled.jsonl")).expect("the metrics");
    (bench, text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect())
}

#[test]
fn a_table_shows_the_numbers_of_the_run_in_every_format() {
    let (bench, pooled) = finished();
    let value = |variant: &str, node: &str, key: &str| {
        let line = pooled.iter().find(|line| line["variant"] == variant && line["node"] == node);
        line.and_then(|line| line[key].as_f64()).expect("a number")
    };
    let table = |arguments: &[&str]| {
        let done = bench.run(&[&["table", "m.toml"], arguments].concat());
        assert_eq!(done.code, 0, "{}", done.stderr);
        done.stdout
    };
    let ours = |key| ["evs_weight=1", "evs_weight=1000"].map(|variant| value(variant, "psnr", key));
    let edi = value("evs_weight=1", "psnr_edi", "value");

    // Rows and columns by themselves: the ablation's axis, and the methods next to each other.
    let csv = table(&["--format", "csv"]);
    let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows[0], ["evs_weight", "psnr", "edi"]);
    for (row, (level, value)) in rows[1..].iter().zip([("1", ours("value")[0]), ("1000", ours("value")[1])]) {
        assert_eq!((row[0], row[1].parse(), row[2].parse()), (level, Ok(value), Ok(edi)), "{csv}");
    }
    // The other way round, the smallest frames, one digit, the better of each column in bold.
    let text = table(&[
        "--rows",
        "method",
        "--columns",
        "evs_weight",
        "--statistic",
        "min",
        "--digits",
        "1",
        "--rename",
        "psnr=ours",
    ]);
    let least = |node: &str| {
        ["evs_weight=1", "evs_weight=1000"].map(|variant| format!("{:.1}", value(variant, node, "min")))
    };
    let plain = text.replace("**", "");
    assert!(
        plain.contains(&format!("| ours | {} |", least("psnr").join(" | ")))
            && plain.contains(&format!("| edi | {} |", least("psnr_edi").join(" | "))),
        "{text}"
    );
    assert!(text.contains("**") && text.ends_with("psnr_db [dB], higher is better.\n"), "{text}");
    assert!(table(&["--format", "latex"]).contains("\\toprule"));
    let lines = table(&["--format", "jsonl"]);
    let lines: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    assert_eq!(lines.len(), 4);
    assert_eq!(
        (&lines[0]["evs_weight"], &lines[0]["method"], lines[0]["value"].as_f64()),
        (&"1".into(), &"psnr".into(), Some(ours("value")[0]))
    );
    // Frame by frame.
    let frames =
        table(&["--rows", "frame", "--columns", "evs_weight", "--where", "method=edi", "--format", "csv"]);
    assert_eq!(frames.lines().count(), 1 + 40);
}

#[test]
fn a_table_is_drawn_over_its_levels() {
    let (bench, _) = finished();
    let done = bench.run(&[
        "table",
        "m.toml",
        "--rows",
        "evs_weight",
        "--columns",
        "method",
        "--plot",
        "out/weights.svg",
    ]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let svg = std::fs::read_to_string(bench.path("out/weights.svg")).expect("a figure");
    assert!(
        ["evs_weight", "psnr_db [dB]", "edi"]
            .iter()
            .all(|text| svg.lines().any(|line| line.trim_end() == *text)),
        "{svg}"
    );
    assert_eq!(svg.matches("<circle").count(), 4, "two curves of two points");
    let done = bench.run(&["table", "m.toml", "--rows", "evs_weight", "--plot", "weights.pdf"]);
    assert_eq!(done.code, 2);
    assert!(done.stderr.contains("ends in .svg or .png"), "{}", done.stderr);
}

#[test]
fn what_is_not_there_is_named_with_what_is() {
    let (bench, _) = finished();
    let error = |arguments: &[&str]| {
        let done = bench.run(&[&["table"], arguments].concat());
        assert_eq!((done.code, done.stdout.as_str()), (2, ""));
        done.stderr
    };
    assert_eq!(
        error(&["m.toml", "--metric", "ssim"]),
        "error: there is no metric `ssim`; there are psnr_db\n"
    );
    assert!(
        error(&["m.toml", "--rows", "scene"])
            .contains("there is no axis `scene`; there are file, evs_weight, node, method, metric")
    );
    assert!(
        error(&["m.toml", "--rows", "evs_weight", "--columns", "metric"])
            .contains("they differ in `node`, `method`")
    );
    bench.write("other.toml", "format = 1\n");
    assert!(error(&["other.toml"]).contains("run `photocurrent run other.toml` first"));
    // What to do next is said whatever it was that is not there.
    assert!(
        error(&["no/such.toml"])
            .contains("no/such.toml: there is no such manifest\n  name a manifest that was run")
    );
    assert!(error(&["out/none"]).contains("out/none is not there\n  name a manifest that was run"));
    std::fs::create_dir(bench.path("empty")).expect("a folder");
    assert!(error(&["empty"]).contains(
        "the folder has no metrics.pooled.jsonl\n  name a folder that `photocurrent run` wrote scores to"
    ));
    bench.write("broken.jsonl", "{\"variant\": \"base\"}\n");
    assert!(error(&["broken.jsonl"]).contains("broken.jsonl:1: no `node`"));
}
