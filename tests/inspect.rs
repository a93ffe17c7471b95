//! `inspect` and `check` of recordings: events and frames of several files held together, exit codes, and the
//! form of `--json`.
//!
//! The scene is made here: a texture of waves whose halves drift against each other over 96 x 72 pixels, its
//! logarithm known in closed form. Events are the crossings of whole thresholds, frames the light at the
//! middle of a short exposure; both are written as plain files.

use crate::support::Bench;
use serde_json::Value;
use std::path::PathBuf;

const WIDTH: i64 = 96;
const HEIGHT: i64 = 72;
const FRAMES: i64 = 12;
const PERIOD_US: i64 = 20_000;
const EXPOSURE_US: i64 = 1_000;
const THRESHOLD: f64 = 0.2;

/// How the files are made.
#[derive(Clone, Copy, Default)]
struct Made {
    /// Pixels by which the frames' picture lies right of and below the events'.
    right: i64,
    down: i64,
    /// Added to the events' stamps, us.
    late_us: i64,
    /// Added to the frames' stamps, us.
    frames_later_us: i64,
    /// Columns that frames have beyond those of the events.
    wider: i64,
}

/// Logarithm of the light, over its mean.
fn log_light(x: i64, y: i64, t_us: i64) -> f64 {
    let s = t_us as f64 * 1e-6;
    // Above one way, below the other: of one motion a shift in time and one in place would look alike.
    let way = if y < HEIGHT / 2 { 1.0 } else { -1.0 };
    let (x, y) = (x as f64 - way * 150.0 * s, y as f64 + way * 60.0 * s);
    let wave = |a: f64, b: f64, phase: f64| libm::sin(a * x + b * y + phase);
    0.3 * wave(0.41, 0.23, 0.0)
        + 0.2 * wave(0.17, -0.39, 1.0)
        + 0.2 * wave(-0.13, 0.61, 2.0)
        + 0.1 * wave(0.9, 0.3, 0.5)
}

/// Writes `events.csv`, `film.y4m` and `stamps.txt`.
fn scene(made: Made) -> Bench {
    let bench = Bench::new();
    let mut events: Vec<(i64, i64, i64, u8)> = Vec::new();
    for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
        let mut level = (log_light(x, y, 0) / THRESHOLD).floor();
        for t in (0..(FRAMES + 1) * PERIOD_US).step_by(250) {
            let now = log_light(x, y, t) / THRESHOLD;
            // One level of hysteresis: the crossing of a level up, and of the one below it down.
            while now >= level + 1.0 {
                level += 1.0;
                events.push((t + made.late_us, x, y, 1));
            }
            while now < level - 1.0 {
                level -= 1.0;
                events.push((t + made.late_us, x, y, 0));
            }
        }
    }
    events.sort_unstable();
    let lines: String = events.iter().map(|(t, x, y, p)| format!("{t},{x},{y},{p}\n")).collect();
    bench.write("events.csv", &format!("t,x,y,p\n{lines}"));
    let mut film =
        format!("YUV4MPEG2 W{} H{HEIGHT} F50:1 Ip A1:1 Cmono XCOLORRANGE=FULL\n", WIDTH + made.wider)
            .into_bytes();
    let mut stamps = String::new();
    for frame in 0..FRAMES {
        let start = 10_000 + frame * PERIOD_US;
        stamps +=
            &format!("{} {}\n", start + made.frames_later_us, start + EXPOSURE_US + made.frames_later_us);
        film.extend(b"FRAME\n");
        for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH + made.wider).map(move |x| (x, y))) {
            film.push(
                (110.0 * libm::exp(log_light(x - made.right, y - made.down, start + EXPOSURE_US / 2)))
                    .round()
                    .min(255.0) as u8,
            );
        }
    }
    std::fs::write(bench.path("film.y4m"), film).expect("a film");
    bench.write("stamps.txt", &stamps);
    bench
}

/// Events, frames and stamps, in any order.
const TOGETHER: [&str; 7] =
    ["film.y4m", "events.csv", "stamps.txt", "--time-unit", "us", "--extent", "96x72"];

fn inspected(bench: &Bench) -> (i32, Value) {
    let mut arguments = vec!["inspect", "--json"];
    arguments.extend(TOGETHER);
    let done = bench.run(&arguments);
    (
        done.code,
        serde_json::from_str(&done.stdout)
            .unwrap_or_else(|error| panic!("{error}: {}\n{}", done.stdout, done.stderr)),
    )
}

fn checked(bench: &Bench) -> (i32, String) {
    let mut arguments = vec!["check"];
    arguments.extend(TOGETHER);
    let done = bench.run(&arguments);
    (done.code, done.stderr)
}

fn finding<'a>(entry: &'a Value, id: &str) -> Option<&'a Value> {
    entry["findings"].as_array().expect("findings").iter().find(|finding| finding["id"] == id)
}

/// Value and ends of an interval.
fn interval(value: &Value) -> (f64, f64, f64) {
    let number = |value: &Value| value.as_f64().expect("a number");
    (number(&value["value"]), number(&value["ci95"][0]), number(&value["ci95"][1]))
}

#[test]
fn events_and_frames_of_several_files_are_one_recording() {
    let bench = scene(Made::default());
    let (code, all) = inspected(&bench);
    let files = all["files"].as_array().expect("files");
    assert_eq!((code, files.len()), (0, 1), "{all}");
    let entry = &files[0];
    assert_eq!(
        (&entry["survey"]["frames"]["count"], &entry["survey"]["events"]["extent"][0]),
        (&FRAMES.into(), &WIDTH.into())
    );
    for id in ["in_time", "on_one_grid"] {
        assert!(finding(entry, id).is_some(), "{id} is missing: {:#}", entry["findings"]);
    }
    for id in ["events_only", "frames_only", "displaced", "events_late", "sizes_differ"] {
        assert!(finding(entry, id).is_none(), "{id}: {:#}", entry["findings"]);
    }
    // The score without a shift is nearly that at the best one.
    let lag = &entry["survey"]["lag"];
    let (best, none) = (lag["correlation"][0].as_f64().unwrap(), lag["correlation"][1].as_f64().unwrap());
    assert!(best > 0.8 && none > best - 0.05, "{lag}");
    let (code, said) = checked(&bench);
    assert!(code == 0 && said.contains("no mistake found"), "{said}");
}

#[test]
fn a_shift_in_time_or_place_is_a_hazard_with_the_shift_that_was_made() {
    let entry = &inspected(&scene(Made { late_us: 8_000, ..Made::default() })).1["files"][0];
    assert_eq!(
        finding(entry, "events_late").map(|found| &found["severity"]),
        Some(&"hazard".into()),
        "{:#}",
        entry["findings"]
    );
    let (late, low, high) = interval(&entry["survey"]["lag"]["late_ns"]);
    assert!((late - 8e6).abs() < 1e6 && low < late && late < high, "{late} ({low} to {high})");
    let entry = &inspected(&scene(Made { right: 2, down: -1, ..Made::default() })).1["files"][0];
    assert_eq!(
        finding(entry, "displaced").map(|found| &found["severity"]),
        Some(&"hazard".into()),
        "{:#}",
        entry["findings"]
    );
    let grid = &entry["survey"]["lag"]["grid"];
    for (way, made) in [("right_px", 2.0), ("down_px", -1.0)] {
        let (found, low, high) = interval(&grid[way]);
        assert!((found - made).abs() < 0.4 && high - low < 1.0, "{way}: {found} ({low} to {high})");
    }
    assert!(grid["correlation"][0].as_f64() > grid["correlation"][1].as_f64(), "{grid}");
}

#[test]
fn clocks_apart_fail_a_check_and_sizes_that_differ_are_a_question() {
    let bench = scene(Made { frames_later_us: 1_000_000_000, ..Made::default() });
    let (code, all) = inspected(&bench);
    let error = finding(&all["files"][0], "no_overlap").expect("no_overlap");
    assert_eq!((code, &error["severity"]), (0, &"error".into()));
    assert!(error["what_to_do"].as_str().unwrap().contains("1000009750000 ns"), "{error}");
    let (code, said) = checked(&bench);
    assert!(code == 3 && said.contains("do not overlap in time"), "{said}");
    let (_, all) = inspected(&scene(Made { wider: 5, ..Made::default() }));
    assert!(finding(&all["files"][0], "sizes_differ").is_some(), "{:#}", all["files"][0]["findings"]);
}

#[test]
fn what_is_no_one_recording_is_shown_file_by_file() {
    let bench = scene(Made::default());
    // A folder of a picture, and nothing that says when it was taken.
    let folder: PathBuf = bench.path("frames");
    std::fs::create_dir(&folder).expect("a folder");
    let film = std::fs::read(bench.path("film.y4m")).expect("the film");
    let values = &film[film.len() - (WIDTH * HEIGHT) as usize..];
    let mut encoder = png::Encoder::new(
        std::fs::File::create(folder.join("0.png")).expect("a file"),
        WIDTH as u32,
        HEIGHT as u32,
    );
    encoder.set_color(png::ColorType::Grayscale);
    encoder.write_header().and_then(|mut writer| writer.write_image_data(values)).expect("a picture");
    let done = bench.run(&["inspect", "events.csv", "frames", "--time-unit", "us", "--json"]);
    let all: Value = serde_json::from_str(&done.stdout).expect("JSON");
    assert_eq!((done.code, all["files"].as_array().map(Vec::len)), (2, Some(2)), "{}", done.stderr);
    assert!(
        done.stderr.contains("cannot be held together") && done.stderr.contains("stamps"),
        "{}",
        done.stderr
    );
    // Two recordings of events.
    let done = bench.run(&["inspect", "events.csv", "events.csv", "--time-unit", "us", "--json"]);
    let all: Value = serde_json::from_str(&done.stdout).expect("JSON");
    assert_eq!((done.code, all["files"].as_array().map(Vec::len)), (0, Some(2)), "{}", done.stderr);
    let done = bench.run(&["check", "events.csv", "events.csv"]);
    assert!(
        done.code == 2 && done.stderr.contains("takes one manifest, recording or description"),
        "{}",
        done.stderr
    );
}

#[test]
fn exit_codes_are_those_of_the_manual() {
    let bench = scene(Made::default());
    bench.write("prose.txt", "Dear reader,\nthis is none.\n");
    bench.write("no_unit.csv", "t,x,y,p\n100,5,3,1\n250,6,3,0\n400,7,3,1\n");
    bench.write("cut.csv", "t,x,y,p\n100,5,3,1\n250,6,3,0\n400,7\n");
    let cases: [(&[&str], i32, &str); 6] = [
        (&["inspect", "events.csv", "--time-unit", "us"], 0, ""),
        (&["inspect", "nowhere.raw"], 2, "nowhere.raw"),
        (&["inspect", "prose.txt"], 2, "this is no recording of a known format"),
        (&["inspect", "no_unit.csv"], 2, "--time-unit"),
        (&["inspect", "cut.csv", "--time-unit", "us"], 3, ""),
        (&["inspect", "cut.csv", "prose.txt", "--time-unit", "us"], 3, "prose.txt"),
    ];
    for (arguments, code, says) in cases {
        let done = bench.run(arguments);
        assert!(
            done.code == code && done.stderr.contains(says),
            "{arguments:?}: {}\n{}",
            done.code,
            done.stderr
        );
    }
}

/// Names and types of everything in a value, a line each; of a list its first element, of a map of numbers
/// all.
fn form(at: &str, value: &Value, lines: &mut Vec<String>) {
    match value {
        Value::Object(fields) => {
            fields.iter().for_each(|(name, value)| form(&format!("{at}.{name}"), value, lines))
        }
        Value::Array(elements) => match elements.first() {
            Some(first) => form(&format!("{at}[]"), first, lines),
            None => lines.push(format!("{at}: empty list")),
        },
        Value::Null => lines.push(format!("{at}: null")),
        Value::Bool(_) => lines.push(format!("{at}: bool")),
        Value::Number(_) => lines.push(format!("{at}: number")),
        Value::String(_) => lines.push(format!("{at}: text")),
    }
}

/// What programs rely on: a name that goes away or changes its type breaks them, and needs another `schema`.
#[test]
fn the_form_of_json_is_the_one_that_is_kept() {
    let (_, all) = inspected(&scene(Made::default()));
    let mut lines = Vec::new();
    form("", &all, &mut lines);
    let found = lines.join("\n") + "\n";
    let path = crate::support::root().join("tests/inspect.form");
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        std::fs::write(&path, &found).expect("written");
    }
    let expected = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        found == expected,
        "the form of --json is not tests/inspect.form; when the new one is meant: UPDATE_EXPECT=1 cargo \
         test --test photocurrent inspect\n{found}"
    );
}
