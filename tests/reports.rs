//! `photocurrent report`: a page out of finished runs, whatever they lack.

use crate::support::{Bench, Done, small_pipeline};
use serde_json::Value;

fn says(done: &Done, code: i32, parts: &[&str]) {
    assert_eq!(done.code, code, "{}", done.stderr);
    parts
        .iter()
        .for_each(|part| assert!(done.stderr.contains(part), "`{part}` is missing from\n{}", done.stderr));
}

/// The page of a run, and what its scripts read.
fn report(bench: &Bench, arguments: &[&str]) -> (String, Value) {
    let done = bench.run(&[&["report", "m.toml", "-o", "page.html"], arguments].concat());
    assert_eq!((done.code, done.stdout.as_str()), (0, "page.html\n"), "{}", done.stderr);
    let html = std::fs::read_to_string(bench.path("page.html")).expect("the page");
    let data =
        html.split("id=\"page-data\">").nth(1).and_then(|rest| rest.split("</script>").next()).expect("data");
    let data = serde_json::from_str(data).expect("JSON");
    (html, data)
}

fn labels(data: &Value) -> Vec<String> {
    data["groups"][0]["sequences"]
        .as_array()
        .into_iter()
        .flatten()
        .map(|one| one["label"].as_str().unwrap_or_default().to_string())
        .collect()
}

#[test]
fn a_failed_method_is_a_visible_cell_and_the_rest_is_shown() {
    let bench = Bench::new();
    let broken = "
[nodes.mine]
kind = \"baseline/exec\"
in = { events = \"recording.events\", frames = \"recording.frames\", sensor = \"sensor\" }
params = { command = [\"false\"], version = \"1\", white = 1023 }
[nodes.psnr_mine]
kind = \"score/psnr\"
in = { frames = \"mine\", truth = \"scene.truth\", sensor = \"sensor\" }
";
    bench.write("m.toml", &format!("{}{broken}", small_pipeline()));
    let done = bench.run(&["run", "m.toml", "--quiet"]);
    assert_eq!(done.code, 1, "{}", done.stderr);
    let (html, data) = report(&bench, &[]);
    assert!(html.contains("class=\"number none\"") && html.contains(">no result</td>"), "the cell");
    assert!(
        html.contains("mine (baseline/exec) failed") && html.contains("psnr_mine was skipped: it needs mine"),
        "the reasons"
    );
    assert!(
        labels(&data).contains(&"truth".to_string()) && !labels(&data).contains(&"mine".to_string()),
        "{:?}",
        labels(&data)
    );
    // `table` shows the cell too, and `check` takes the file.
    let table = bench.run(&["table", "m.toml"]);
    assert!(table.stdout.contains("| mine | no result |"), "{}", table.stdout);
    says(&bench.run(&["check", "out/m"]), 0, &["no mistake found"]);
}

#[test]
fn what_the_cache_lost_is_said_with_the_command_that_makes_it() {
    let bench = Bench::new();
    bench.write("m.toml", &small_pipeline());
    assert_eq!(bench.run(&["run", "m.toml", "--quiet"]).code, 0);
    std::fs::remove_dir_all(bench.path(".photocurrent")).expect("a cache");
    let (html, data) = report(&bench, &[]);
    assert!(
        html.contains("photocurrent run m.toml</code> makes it again") && html.contains("psnr_db"),
        "scores stay, pictures are named"
    );
    assert_eq!(labels(&data), [""; 0]);
    assert!(!bench.path(".photocurrent").exists(), "looking makes no folder");
}

#[test]
fn a_page_keeps_its_size_and_follows_the_pixels_asked_for() {
    let bench = Bench::new();
    bench.write("m.toml", &small_pipeline());
    assert_eq!(bench.run(&["run", "m.toml", "--quiet"]).code, 0);
    let (whole, data) = report(&bench, &["--pixel", "3,2", "--pixel", "0,0"]);
    let places: Vec<(i64, i64)> = data["pixels"]
        .as_array()
        .expect("pixels")
        .iter()
        .map(|pixel| (pixel["x"].as_i64().unwrap_or(-1), pixel["y"].as_i64().unwrap_or(-1)))
        .collect();
    assert_eq!(places, [(3, 2), (0, 0)]);
    assert!(data["pixels"][0]["solved"][0]["knots"].as_array().is_some_and(|knots| knots.len() > 1));
    let all = data["groups"][0]["instants_ns"].as_array().expect("instants").len();
    let most = whole.len() - 20_000;
    let (small, data) = report(&bench, &["--pixel", "3,2", "--max-size", &most.to_string()]);
    assert!(small.len() <= most, "{} of {most}", small.len());
    let group = &data["groups"][0];
    let fewer = group["instants_ns"].as_array().expect("instants").len();
    assert!(fewer < all || group["shrink"] != 1, "{fewer} of {all}");
    assert!(small.contains("instants are embedded"), "and says so");
    // The same run gives the same page.
    assert_eq!(report(&bench, &["--pixel", "3,2", "--pixel", "0,0"]).0, whole);
    says(
        &bench.run(&["report", "m.toml", "--max-size", "10kB"]),
        2,
        &["cannot be made as small as", "--max-size"],
    );
}

#[test]
fn what_is_no_run_is_refused_with_what_to_do() {
    let bench = Bench::new();
    bench.write("m.toml", &small_pipeline());
    says(&bench.run(&["report", "m.toml"]), 2, &["out/m/run.json is not there", "photocurrent run m.toml"]);
    says(&bench.run(&["report", "nowhere"]), 2, &["nowhere/run.json is not there"]);
    bench.write("notes.txt", "Dear reader,\n");
    says(
        &bench.run(&["report", "notes.txt"]),
        2,
        &["`report` takes a manifest that was run, or the folder that a run wrote to"],
    );
    bench.write("old/run.json", "{\"schema\": \"photocurrent-run/0\"}");
    says(&bench.run(&["report", "old"]), 2, &["the form is `photocurrent-run/0`"]);
    assert_eq!(bench.run(&["run", "m.toml", "--quiet"]).code, 0);
    says(&bench.run(&["report", "m.toml", "--pixel", "900,0"]), 2, &["--pixel 900,0: the pixel is outside"]);
    says(
        &bench.run(&["report", "m.toml", "--variant", "x=1"]),
        2,
        &["no variant of m has this in its name", "base"],
    );
}
