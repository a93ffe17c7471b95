//! `photocurrent play`: a page that plays a recording or a run, whatever they lack, within its size.

use crate::support::{Bench, Done, root, small_pipeline};
use serde_json::Value;

fn says(done: &Done, code: i32, parts: &[&str]) {
    assert_eq!(done.code, code, "{}", done.stderr);
    parts
        .iter()
        .for_each(|part| assert!(done.stderr.contains(part), "`{part}` is missing from\n{}", done.stderr));
}

/// A page, and what its script reads.
fn play(bench: &Bench, code: i32, arguments: &[&str]) -> (String, Value) {
    let done = bench.run(&[&["play", "-o", "page.html"], arguments].concat());
    assert_eq!((done.code, done.stdout.as_str()), (code, "page.html\n"), "{}", done.stderr);
    let html = std::fs::read_to_string(bench.path("page.html")).expect("the page");
    let data =
        html.split("id=\"page-data\">").nth(1).and_then(|rest| rest.split("</script>").next()).expect("data");
    let data = serde_json::from_str(data).expect("JSON");
    (html, data)
}

/// Bytes of base64.
fn bytes(text: &Value) -> Vec<u8> {
    const DIGITS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let text = text.as_str().expect("base64").trim_end_matches('=').as_bytes();
    let digit = |c: &u8| DIGITS.iter().position(|d| d == c).expect("a digit") as u32;
    text.chunks(4)
        .flat_map(|four| {
            let bits = four.iter().enumerate().fold(0, |sum, (k, c)| sum | digit(c) << (18 - 6 * k));
            bits.to_be_bytes()[1..four.len()].to_vec()
        })
        .collect()
}

/// Numbers of LEB128.
fn numbers(bytes: &[u8]) -> Vec<u64> {
    let mut all = Vec::new();
    let (mut number, mut shift) = (0, 0);
    for byte in bytes {
        number |= u64::from(byte & 0x7f) << shift;
        shift += 7;
        if byte & 0x80 == 0 {
            all.push(number);
            (number, shift) = (0, 0);
        }
    }
    all
}

/// Slice, column, row and sign of every event that a page holds.
fn events(data: &Value) -> Vec<(usize, u64, u64, bool)> {
    let events = &data["events"];
    let (lengths, places) = (numbers(&bytes(&events["lengths"])), bytes(&events["places"]));
    let width = events["width"].as_u64().expect("a width");
    let (mut all, mut begin) = (Vec::new(), 0);
    for (slice, length) in lengths.iter().enumerate() {
        let end = begin + *length as usize;
        let mut place = 0;
        for step in numbers(&places[begin..end]) {
            place += step;
            all.push((slice, place / 2 % width, place / 2 / width, place % 2 == 1));
        }
        begin = end;
    }
    assert_eq!(begin, places.len(), "lengths are those of the places");
    all
}

fn labels(data: &Value) -> Vec<&str> {
    data["films"].as_array().into_iter().flatten().filter_map(|film| film["label"].as_str()).collect()
}

fn clip(name: &str) -> String {
    root().join("data/recordings").join(name).display().to_string()
}

#[test]
fn events_of_a_text_stand_on_the_page_as_they_are() {
    let bench = Bench::new();
    // Times in microseconds from 100 on, of which the first is 0 on the page.
    bench.write("e.csv", "t,x,y,p\n100,3,2,1\n150,3,2,0\n4100,7,5,1\n9000,0,0,0\n");
    let (html, data) = play(&bench, 0, &["e.csv", "--extent", "8x6", "--time-unit", "us"]);
    assert_eq!(data["events"]["slice_ns"], 100_000);
    let expected = [(0, 3, 2, false), (0, 3, 2, true), (40, 7, 5, true), (89, 0, 0, false)];
    assert_eq!(events(&data), expected);
    let counts = |name: &str| numbers(&bytes(&data["events"][name]));
    assert_eq!((counts("on_counts")[0], counts("off_counts")[0], counts("on_counts")[40]), (1, 1, 1));
    assert!(html.contains("4: 2 ON, 2 OFF") && html.contains("There are no frames"), "the facts");
    let markup = html.split("page-data").next().expect("a beginning");
    assert!(html.contains("content=\"photocurrent play\"") && !markup.contains("data-film"));
    // A stretch: 1 to 5 ms after the first.
    let stretch = ["e.csv", "--extent", "8x6", "--time-unit", "us", "--from", "1ms", "--to", "5ms"];
    let (_, data) = play(&bench, 0, &stretch);
    assert_eq!((events(&data), &data["from_ns"]), (vec![(30, 7, 5, true)], &Value::from(1_000_000)));
    // Without a name for the page it lies in a folder of the recording's name.
    let done = bench.run(&["play", "e.csv", "--extent", "8x6", "--time-unit", "us", "--quiet"]);
    assert_eq!((done.code, done.stdout.as_str(), done.stderr.as_str()), (0, "out/e/play.html\n", ""));
}

#[test]
fn a_real_clip_is_whole_within_its_size_and_says_what_a_smaller_page_lacks() {
    let bench = Bench::new();
    let path = clip("davis346_traffic.aedat4");
    let inspected = bench.run(&["inspect", &path, "--json"]);
    let survey: Value = serde_json::from_str(&inspected.stdout).expect("JSON");
    let survey = &survey["files"][0]["survey"];
    let (whole, data) = play(&bench, 0, &[&path]);
    assert_eq!(Some(events(&data).len() as u64), survey["events"]["count"].as_u64());
    assert_eq!(data["films"][0]["frames"].as_array().map(Vec::len), Some(59));
    assert_eq!(data["events"]["share"], 1.0);
    assert!(!whole.contains("--max-size"), "nothing was left out");
    assert_eq!(play(&bench, 0, &[&path]).0, whole, "the same recording gives the same page");

    let (small, data) = play(&bench, 0, &[&path, "--max-size", "400kB"]);
    assert!(small.len() <= 400_000 && small.len() > 200_000, "{}", small.len());
    let (kept, share) = (events(&data).len() as f64, data["events"]["share"].as_f64().expect("a share"));
    assert!(share < 1.0 && (kept / 78_830.0 - share).abs() < 1e-9, "{kept} is {share}");
    let all: u64 = ["on_counts", "off_counts"]
        .iter()
        .map(|name| numbers(&bytes(&data["events"][name])).iter().sum::<u64>())
        .sum();
    assert_eq!(all, 78_830, "rates stay those of all events");
    assert!(small.contains("of 78,830 events are drawn") && small.contains("Pictures that are embedded"));
    says(
        &bench.run(&["play", &path, "--max-size", "60kB"]),
        2,
        &["cannot be made as small as 60.0 kB", "--max-size"],
    );
}

#[test]
fn a_run_is_played_with_its_truth_and_its_methods_by_their_nodes() {
    let bench = Bench::new();
    bench.write("m.toml", &small_pipeline());
    says(&bench.run(&["play", "m.toml"]), 2, &["out/m/run.json is not there", "photocurrent run m.toml"]);
    assert_eq!(bench.run(&["run", "m.toml", "--quiet"]).code, 0);
    let (html, data) = play(&bench, 0, &["m.toml"]);
    assert_eq!(labels(&data), ["truth", "captured (recording.frames)", "ours (render)", "EDI (edi)"]);
    let kinds: Vec<&Value> = data["films"].as_array().expect("films").iter().map(|f| &f["kind"]).collect();
    assert_eq!(kinds, ["truth", "captured", "method", "method"]);
    let best = data["first"].as_u64().expect("the first") as usize;
    assert!(best == 2 || best == 3);
    assert!(events(&data).len() > 100 && html.contains("m.toml, by photocurrent"));
    // The folder of the run, a stretch of it.
    let (_, data) = play(&bench, 0, &["out/m", "--from", "10ms", "--to", "20ms"]);
    assert_eq!((&data["from_ns"], &data["to_ns"]), (&Value::from(10_000_000), &Value::from(20_000_000)));
    let film = &data["films"][2];
    let inside = |frame: &Value| {
        frame["to_ns"].as_i64() > Some(10_000_000) && frame["from_ns"].as_i64() < Some(20_000_000)
    };
    assert!(film["frames"].as_array().is_some_and(|all| !all.is_empty() && all.iter().all(inside)));
    let done = bench.run(&["play", "m.toml", "--quiet"]);
    assert_eq!((done.code, done.stdout.as_str()), (0, "out/m/play.html\n"), "{}", done.stderr);

    // What the cache lost is said.
    std::fs::remove_dir_all(bench.path(".photocurrent")).expect("a cache");
    says(
        &bench.run(&["play", "m.toml"]),
        2,
        &["neither events nor frames to play", "photocurrent run m.toml"],
    );
}

#[test]
fn cached_results_with_events_or_frames_are_played() {
    let bench = Bench::new();
    bench.write("m.toml", &small_pipeline());
    let outcome = bench.outcome(&["m.toml"]);
    let digests = crate::support::digests(&outcome);
    let stored = |output: &str| {
        let digest = &digests[output];
        let found = crate::support::files(&bench.path(".photocurrent"));
        let path = found.keys().find(|path| path.to_string_lossy().contains(digest.as_str()));
        format!(".photocurrent/{}", path.expect("it is stored").display())
    };
    let (_, data) = play(&bench, 0, &[&stored("recording.events")]);
    assert!(events(&data).len() > 100 && labels(&data).is_empty());
    let (_, data) = play(&bench, 0, &[&stored("render.frames")]);
    assert_eq!((labels(&data), data["events"].is_null()), (vec!["frames"], true));
    says(
        &bench.run(&["play", &stored("solve.tracks")]),
        2,
        &["`play` shows events and frames, and this cached result is of type tracks"],
    );
}

#[test]
fn frames_without_exposures_are_marked_and_what_is_assumed_is_said() {
    let bench = Bench::new();
    bench.write("e.txt", "0.000 3 2 1\n0.010 5 1 0\n0.050 5 1 0\n");
    bench.write("frames/stamps.txt", "0.0\n0.02\n0.04\n");
    for k in 0..3 {
        let file = std::fs::File::create(bench.path(&format!("frames/f{k}.png"))).expect("a picture");
        let mut encoder = png::Encoder::new(file, 8, 6);
        encoder.set_color(png::ColorType::Grayscale);
        let values: Vec<u8> = (0..48).map(|at| 40 * k + at).collect();
        encoder.write_header().and_then(|mut writer| writer.write_image_data(&values)).expect("pixels");
    }
    let stated = ["--columns", "t,x,y,p", "--time-unit", "s", "--extent", "8x6", "--frames", "frames"];
    let stamps = ["--stamps", "frames/stamps.txt"];
    let (html, data) = play(&bench, 0, &[&["e.txt"], &stated[..], &stamps[..]].concat());
    assert_eq!(data["films"][0]["frames"][1]["from_ns"], 20_000_000);
    for said in ["How long frames are exposed is not recorded", "--transfer", "--row-time"] {
        assert!(html.contains(said), "{said}");
    }
    let exposure = ["--exposure", "4ms", "--stamp", "start", "--transfer", "linear", "--row-time", "0us"];
    let (html, data) = play(&bench, 0, &[&["e.txt"], &stated[..], &stamps[..], &exposure[..]].concat());
    assert_eq!(data["films"][0]["frames"][1]["to_ns"], 24_000_000);
    assert!(!html.contains("not recorded"));
}

#[test]
fn what_cannot_be_played_is_refused_with_what_to_do() {
    let bench = Bench::new();
    let sensor = root().join("data/sensors/hybrid.toml").display().to_string();
    let path = clip("davis346_cradle.aedat4");
    bench.write("notes.txt", "Dear reader,\n");
    let refused = |arguments: &[&str], parts: &[&str]| {
        says(&bench.run(&[&["play"], arguments].concat()), 2, parts);
    };
    refused(&[&sensor], &["`play` takes a recording", "a sensor description"]);
    refused(&["notes.txt"], &["notes.txt", "this is no recording of a known format"]);
    refused(&["nowhere.raw"], &["nowhere.raw"]);
    refused(&[&path, "--from", "2s", "--to", "1s"], &["the stretch ends before it begins"]);
    refused(&[&path, "--from", "3min"], &["--from ", "nothing of davis346_cradle.aedat4 lies there"]);
    assert!(!bench.path("out").exists(), "nothing is written");
    // A page is no recording.
    play(&bench, 0, &[&path, "--to", "50ms"]);
    refused(&["page.html"], &["page.html"]);
    says(&bench.run(&["report", "page.html"]), 2, &["a page that plays a recording"]);
}
