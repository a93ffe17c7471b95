//! The readers of docs/readers, run by the interpreters they are for, against what the command itself writes
//! of the same data.
//!
//! Events are compared with the text that `convert` writes, frames with decoded PNG, and a track with the
//! rendered frames: the mean of its photocurrent over an exposure, times gain and nominal exposure, is their
//! DN (Eq. (5)). Where an interpreter or its library is missing, the test says so and ends; `make test`
//! installs h5py.

use crate::support::{Bench, root, small_pipeline};
use serde_json::Value;
use std::process::Command;

/// Pixels that are looked at, and the frame.
const PIXELS: [(usize, usize); 3] = [(3, 5), (16, 12), (30, 20)];
const FRAME: usize = 20;
/// `gain` of data/sensors/hybrid.toml times the exposure of its frames, 6.5 ms.
const DN_PER_PHOTOCURRENT: f64 = 850.0 * 6.5e-3;

/// A run with a recording, frames in both forms, and tracks that hold and that are log-linear.
fn finished() -> Bench {
    let bench = Bench::new();
    let more = r#"
[nodes.store]
kind = "write/recording"
in = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }
[nodes.one_file]
kind = "write/frames"
in = { frames = "render" }
params = { format = "hdf5_u16" }
[nodes.map]
kind = "solve/map"
in = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }
[nodes.render_map]
kind = "render/rows"
in = { tracks = "map.tracks", sensor = "sensor" }
[nodes.map_file]
kind = "write/frames"
in = { frames = "render_map" }
params = { format = "hdf5_f32" }
"#;
    bench.write("m.toml", &(small_pipeline() + more));
    let done = bench.run(&["run", "m.toml", "--quiet"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let done = bench.run(&["convert", "out/m/store/recording.h5", "events.csv", "--unit", "ns"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    bench
}

/// Number of events, and sums over them of x, y, ON and time in ns, of the text.
fn sums_of_text(bench: &Bench) -> Vec<i64> {
    let text = std::fs::read_to_string(bench.path("events.csv")).expect("events");
    let mut lines = text.lines().skip_while(|line| !line.starts_with(|c: char| c.is_ascii_alphabetic()));
    let names: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let rows: Vec<Vec<i64>> = lines
        .map(|line| line.split(',').map(|cell| cell.parse().expect("a whole number")).collect())
        .collect();
    let sum = |name: &str| {
        rows.iter().map(|row| row[names.iter().position(|n| *n == name).expect("a column")]).sum::<i64>()
    };
    let mut sums = vec![rows.len() as i64];
    sums.extend(["x", "y", "p", "t"].map(sum));
    assert!(rows.len() > 100, "there is something to compare");
    sums
}

/// DN of the pixels in the PNG of a frame.
fn dn_of_png(bench: &Bench) -> Vec<f64> {
    let listing = std::fs::read_to_string(bench.path("out/m/frames/frames.csv")).expect("frames.csv");
    let rows: Vec<Vec<&str>> =
        listing.lines().filter(|line| !line.starts_with('#')).map(|line| line.split(',').collect()).collect();
    let cell = |name: &str| rows[1 + FRAME][rows[0].iter().position(|n| *n == name).expect("a column")];
    let file = std::fs::File::open(bench.path("out/m/frames").join(cell("file"))).expect("a picture");
    let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().expect("PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut bytes).expect("pixels");
    let code = |&(x, y): &(usize, usize)| {
        let at = (y * info.width as usize + x) * 2;
        f64::from(u16::from_be_bytes([bytes[at], bytes[at + 1]]))
    };
    let number = |name: &str| cell(name).parse::<f64>().expect("a number");
    PIXELS.iter().map(|pixel| number("offset_dn") + number("scale_dn") * code(pixel)).collect()
}

fn near(found: &Value, expected: &[f64], relative: f64, what: &str) {
    let found: Vec<f64> =
        found.as_array().expect("numbers").iter().map(|number| number.as_f64().expect("a number")).collect();
    assert_eq!(found.len(), expected.len(), "{what}");
    for (a, b) in found.iter().zip(expected) {
        assert!(
            *b > 10.0 && (a - b).abs() <= relative * b,
            "{what}: {found:?}, and the command says {expected:?}"
        );
    }
}

/// Holds what a reader printed against what the command says.
fn hold(bench: &Bench, printed: &str) {
    let found: Value =
        serde_json::from_str(printed.trim()).unwrap_or_else(|error| panic!("{error}: {printed}"));
    assert_eq!(found["sums"], serde_json::json!(sums_of_text(bench)), "events");
    let dn = dn_of_png(bench);
    // Both forms have codes of the same scale; the mean of a track is taken from instants 1 us apart, over an
    // exposure of 100 us.
    near(&found["dn"], &dn, 1e-6, "frames.h5");
    let expected: Vec<f64> = dn.iter().map(|dn| dn / DN_PER_PHOTOCURRENT).collect();
    near(&found["held"], &expected, 0.01, "the track that holds");
}

/// A Python that has h5py: the first on the path, or the system's, for which `make readers` installs it.
fn python() -> Option<&'static str> {
    let has_it = |name: &&str| {
        Command::new(name)
            .args(["-c", "import h5py, numpy"])
            .output()
            .is_ok_and(|output| output.status.success())
    };
    let found = ["python3", "/usr/bin/python3"].into_iter().find(has_it);
    if found.is_none() {
        eprintln!("skipped: no python3 with h5py and numpy here; `make readers` installs them");
    }
    found
}

#[test]
fn a_python_script_is_a_method_among_others() {
    let Some(python) = python() else { return };
    let bench = Bench::new();
    let manifest = root().join("pipelines/python/integrate.toml").display().to_string();
    let done = bench.run(&[
        "run",
        &manifest,
        "--to",
        "table",
        "--set",
        &format!("nodes.mine.params.command=[\"{python}\", \"{{file0}}\", \"{{file1}}\"]"),
    ]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    // The how-to shows what it prints; events say more than repeating a frame, and less than the whole model.
    let page = std::fs::read_to_string(root().join("docs/own-method.md")).expect("docs/own-method.md");
    assert!(page.contains(done.stdout.trim()), "docs/own-method.md should show\n{}", done.stdout);
    let of = |label: &str| -> f64 {
        let row = done.stdout.lines().find(|line| line.starts_with(label)).expect("a row");
        row.split_whitespace().next_back().and_then(|cell| cell.parse().ok()).expect("a number")
    };
    assert!(of("all compensations") > of("mine") && of("mine") > of("frame repetition"), "{}", done.stdout);
}

#[test]
fn the_python_reader_reads_what_the_command_writes() {
    let Some(python) = python() else { return };
    let bench = finished();
    let script = format!(
        r#"
import json, sys
sys.path.insert(0, sys.argv[1])
import numpy as np
import photocurrent_files as pf

pixels, frame = {PIXELS:?}, {FRAME}
recording = pf.recording("out/m/store/recording.h5")
events = recording["events"]
one_file, by_map = pf.frames("out/m/one_file/frames.h5"), pf.frames("out/m/map_file/frames.h5")
cached = pf.frames(pf.output("out/m", "render_map", "frames"))
assert recording["sensor"].startswith("format") and recording["frames"]["dn"].shape[1:] == (24, 32)
assert np.array_equal(cached["dn"], by_map["dn"]) and np.array_equal(cached["start_ns"], by_map["start_ns"]) and cached["row_time_ns"] == 0
instants = np.arange(one_file["start_ns"][frame], one_file["end_ns"][frame], 1000)
held, linear = (pf.Tracks(pf.output("out/m", node, "tracks")) for node in ("solve", "map"))
assert (held.meta["between"], linear.meta["between"]) == ("hold", "log_linear")
mean = lambda tracks: [float(tracks.at(x, y, instants).mean()) for x, y in pixels]
dn = lambda frames: [float(frames["dn"][frame, y, x]) for x, y in pixels]
print(json.dumps({{
    "sums": [len(events["t"])] + [int(events[name].astype(np.int64).sum()) for name in "xypt"],
    "dn": dn(one_file), "held": mean(held), "linear": mean(linear), "dn_map": dn(by_map),
}}))
"#
    );
    // The list of pixels is Python as it is Rust.
    let done = Command::new(python)
        .arg("-c")
        .arg(script)
        .arg(root().join("docs/readers"))
        .current_dir(bench.path(""))
        .output()
        .expect("python");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let printed = String::from_utf8_lossy(&done.stdout);
    hold(&bench, &printed);
    let found: Value = serde_json::from_str(&printed).expect("JSON");
    let by_map: Vec<f64> = found["dn_map"]
        .as_array()
        .expect("numbers")
        .iter()
        .map(|dn| dn.as_f64().expect("a number") / DN_PER_PHOTOCURRENT)
        .collect();
    near(&found["linear"], &by_map, 0.002, "the log-linear track");
}

#[test]
fn the_octave_reader_reads_what_the_command_writes() {
    if !Command::new("octave-cli").arg("--version").output().is_ok_and(|output| output.status.success()) {
        eprintln!("skipped: no octave-cli here; Debian has it as `octave`");
        return;
    }
    let bench = finished();
    let listing = std::fs::read_to_string(bench.path("out/m/frames/frames.csv")).expect("frames.csv");
    let row: Vec<&str> = listing
        .lines()
        .filter(|line| !line.starts_with('#'))
        .nth(1 + FRAME)
        .expect("a frame")
        .split(',')
        .collect();
    let script = format!(
        r#"
addpath ("{readers}");
pf = photocurrent_files ();
r = pf.recording ("out/m/store/recording.h5");
sums = [numel(r.events.t), sum(double (r.events.x)), sum(double (r.events.y)), sum(double (r.events.p)), sum(int64 (r.events.t), "native")];
f = load ("-hdf5", "out/m/one_file/frames.h5", "frames");
pixels = [{pixels}];
start_ns = double (f.frames.exposure_start({at})); end_ns = double (f.frames.exposure_end({at}));
instants = start_ns : 1000 : end_ns - 1;
file = pf.output ("out/m", "solve", "tracks");
for k = 1:rows (pixels)
  x = pixels(k, 1); y = pixels(k, 2);
  dn(k) = {offset} + {scale} * double (f.frames.dn(x + 1, y + 1, {at}));
  [t_ns, photocurrent] = pf.pixel (file, x, y, 32);
  held(k) = mean (photocurrent(max (lookup (double (t_ns), instants), 1)));
endfor
printf ("{{\"sums\": [%d, %d, %d, %d, %d], \"dn\": [%.17g, %.17g, %.17g], \"held\": [%.17g, %.17g, %.17g]}}\n", sums, dn, held);
"#,
        readers = root().join("docs/readers").display(),
        pixels = PIXELS.map(|(x, y)| format!("{x} {y}")).join("; "),
        at = FRAME + 1,
        offset = row[5],
        scale = row[6],
    );
    bench.write("read.m", &script);
    let done =
        Command::new("octave-cli").arg("read.m").current_dir(bench.path("")).output().expect("octave-cli");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    hold(&bench, &String::from_utf8_lossy(&done.stdout));
}
