//! Input data that are empty, odd, damaged or wrong: each state has an outcome that is stated here, in exit
//! code and words, and none is a panic.
//!
//! Exit code 2: the planner found it, nothing ran. Exit code 3: it came up while reading. Recordings are
//! written by the store or damaged byte by byte; what the store's writer cannot be made to write (columns of
//! wrong type or length, a missing unit) is tested with its reader.

use crate::support::{self, Bench, Done};
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::{EventStream, Exposure, Extent, FrameSequence, Truth, Value, testing};
use photocurrent_store::{Cache, RecordingContent, write_recording};
use std::path::{Path, PathBuf};

pub const EXTENT: Extent = Extent { width: 12, height: 10 };

/// A pipeline from `rec.h5` to files; the models need no more than off-pixel times.
pub fn pipeline() -> String {
    let sensor = support::root().join("data/sensors/hybrid.toml");
    format!(
        r#"format = 1
[nodes.sensor]
kind = "read/sensor"
params = {{ path = {sensor:?} }}
[nodes.recording]
kind = "read/recording"
params = {{ path = "rec.h5" }}
[nodes.solve]
kind = "solve/paper"
in = {{ events = "recording.events", frames = "recording.frames", sensor = "sensor" }}
params = {{ front_end = "ideal", readout = "none", cis_weight = 1.0, evs_weight = 1000.0 }}
[nodes.render]
kind = "render/rows"
in = {{ tracks = "solve.tracks", sensor = "sensor" }}
[nodes.frames]
kind = "write/frames"
in = {{ frames = "render" }}
"#
    )
}

/// Exposures of 4 ms every 10 ms.
pub fn exposures(count: i64) -> Vec<Exposure> {
    (0..count).map(|l| Exposure::new(l * 10_000_000, l * 10_000_000 + 4_000_000)).collect()
}

/// Brighter from column to column, 200 to 310 DN, the same in every frame.
pub fn dn(x: u32) -> f32 {
    200.0 + 10.0 * x as f32
}

pub fn frames(count: i64) -> FrameSequence {
    testing::captured(EXTENT, exposures(count), 30_000, |_, x, _| dn(x))
}

/// Up and down again in every pixel of row 2, between the first and the second frame.
pub fn pulses() -> Vec<Event> {
    let pulse = |x: u16| {
        let event =
            |polarity, t_in| Event { x, y: 2, polarity, t: t_in + 1_000 + i64::from(x), t_in: Some(t_in) };
        [event(Polarity::On, 5_000_000), event(Polarity::Off, 7_000_000)]
    };
    (0..EXTENT.width as u16).flat_map(pulse).collect()
}

pub fn events() -> EventStream {
    testing::stream(EXTENT, pulses())
}

/// Writes a recording. The library locks the file it writes, and a command that another test starts just then
/// inherits the open file with its lock for as long as it lives: so what the commands read is a copy.
pub fn write_content(path: &Path, content: &RecordingContent) {
    let original = path.with_extension("original");
    write_recording(&original, content).expect("the store writes it");
    std::fs::write(path, std::fs::read(&original).expect("the recording")).expect("a copy");
    std::fs::remove_file(original).expect("removed");
}

pub fn write(path: &Path, events: Option<&EventStream>, frames: Option<&FrameSequence>) {
    write_content(path, &RecordingContent { events, frames, ..RecordingContent::empty(EXTENT) });
}

/// A recording with what true frames need: light that stands still, seen every millisecond.
pub fn write_with_truth(path: &Path, events: &EventStream) {
    let instants = (0..20).map(|t| Exposure::new(t * 1_000_000, t * 1_000_000 + 1)).collect();
    let truth = Truth(testing::captured(EXTENT, instants, 0, |_, x, _| dn(x)));
    write_content(
        path,
        &RecordingContent {
            events: Some(events),
            frames: Some(&frames(3)),
            truth: Some(&truth),
            ..RecordingContent::empty(EXTENT)
        },
    );
}

fn bench(events: Option<&EventStream>, frames: Option<&FrameSequence>) -> Bench {
    let bench = Bench::new();
    write(&bench.path("rec.h5"), events, frames);
    bench.write("m.toml", &pipeline());
    bench
}

fn assert_says(done: &Done, code: i32, parts: &[&str]) {
    assert_eq!(done.code, code, "{}", done.stderr);
    assert!(!done.stderr.contains("panicked"), "{}", done.stderr);
    // Lines may be folded and framed; words are what counts.
    let said = words(&done.stderr);
    for part in parts {
        assert!(said.contains(&words(part)), "`{part}` is missing from\n{}", done.stderr);
    }
}

fn words(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Refused with this exit code, and reported in these words.
fn refuses(bench: &Bench, code: i32, parts: &[&str]) {
    assert_says(&bench.run(&["run", "m.toml"]), code, parts);
    if code == 2 {
        assert!(!bench.path("out").exists(), "nothing ran, so nothing is written");
    }
}

/// What came of a legal recording: its notes, and the rendered frames as [frame][row][column].
struct Rendered {
    notes: Vec<String>,
    dn: Vec<f32>,
    frames: usize,
}

impl Rendered {
    fn row(&self, frame: usize, row: u32) -> &[f32] {
        let (width, height) = (EXTENT.width as usize, EXTENT.height as usize);
        let start = (frame * height + row as usize) * width;
        &self.dn[start..start + width]
    }
}

fn renders(bench: &Bench) -> Rendered {
    let done = bench.run(&["run", "--json", "m.toml"]);
    assert_says(&done, 0, &[]);
    let outcome: serde_json::Value = serde_json::from_str(&done.stdout).expect("JSON");
    let notes = outcome["tasks"].as_array().expect("tasks").iter().flat_map(|task| {
        let node = task["node"].as_str().expect("a name");
        task["notes"]
            .as_array()
            .expect("notes")
            .iter()
            .map(move |note| format!("{node}: {}", note.as_str().expect("a text")))
            .collect::<Vec<_>>()
    });
    let notes: Vec<String> = notes.collect();
    // What the command says to a person must be what it says to a program.
    assert!(notes.iter().all(|note| done.stderr.contains(note)), "{}", done.stderr);
    let digest = support::digests(&outcome)["render.frames"].parse().expect("a digest");
    let cache = Cache::open(&bench.path(".photocurrent")).expect("the cache");
    let Value::Frames(frames) = cache.load(&digest).expect("the frames") else { panic!("frames") };
    let block = frames.read_rows(frames.rows()).expect("the frames' values");
    Rendered { notes, dn: block.dn, frames: frames.len() }
}

/// The light of the frames, to within what the weights let the solution deviate.
fn assert_is_the_light(row: &[f32], what: &str) {
    let light = (0..EXTENT.width).map(dn);
    assert!(
        row.iter().zip(light).all(|(found, light)| (found / light - 1.0).abs() < 1e-3),
        "{what}: {row:?}"
    );
}

#[test]
fn a_good_recording_gives_the_light_it_was_made_of() {
    let rendered = renders(&bench(Some(&events()), Some(&frames(3))));
    assert_eq!(rendered.notes, [""; 0]);
    // The frames end with row 9 of the third one, at 24.27 ms: instants 0 to 24 ms.
    assert_eq!(rendered.frames, 25);
    assert_is_the_light(rendered.row(6, 3), "a row without events");
    assert_is_the_light(rendered.row(1, 2), "before the pulse");
    // One ON event is a step of the ON threshold, 0.20: the light is up by exp(0.20) = 1.2214 while the pulse
    // lasts.
    let ratios: Vec<f32> =
        rendered.row(6, 2).iter().zip(rendered.row(1, 2)).map(|(during, before)| during / before).collect();
    assert!(ratios.iter().all(|ratio| (ratio - 1.2214).abs() < 0.01), "{ratios:?}");
}

#[test]
fn a_stream_without_events_leaves_the_light_of_the_frames() {
    let rendered = renders(&bench(Some(&testing::stream(EXTENT, Vec::new())), Some(&frames(3))));
    assert_eq!((rendered.notes.len(), rendered.frames), (0, 25));
    for row in EXTENT.rows().iter() {
        assert_is_the_light(rendered.row(12, row), "no event");
    }
}

#[test]
fn one_frame_is_enough() {
    let rendered = renders(&bench(Some(&events()), Some(&frames(1))));
    assert_eq!(rendered.notes, [""; 0]);
    assert_is_the_light(rendered.row(2, 5), "one frame");
}

#[test]
fn missing_streams_are_reported_before_anything_runs() {
    refuses(
        &bench(None, Some(&frames(3))),
        2,
        &[
            "nodes.solve: input `events` needs events, and `recording.events` has none",
            "rec.h5 has no /events",
            "m.toml:",
        ],
    );
    refuses(
        &bench(Some(&events()), None),
        2,
        &[
            "nodes.solve: input `frames` needs frames, and `recording.frames` has none",
            "rec.h5 has no /frames",
        ],
    );
    refuses(
        &bench(Some(&events()), Some(&frames(0))),
        2,
        &["input `frames` needs frames", "/frames of rec.h5 holds no frame"],
    );
}

#[test]
fn what_nobody_takes_may_be_missing() {
    let bench = bench(None, Some(&frames(3)));
    bench.write(
        "m.toml",
        "format = 1\n[nodes.recording]\nkind = \"read/recording\"\nparams.path = \
                           \"rec.h5\"\n[nodes.frames]\nkind = \"write/frames\"\nin.frames = \
                           \"recording.frames\"\n",
    );
    assert_says(&bench.run(&["run", "m.toml"]), 0, &[]);
    assert!(bench.path("out/m/frames/000002.png").is_file());
}

#[test]
fn a_model_that_needs_in_pixel_times_refuses_a_recording_without_them() {
    let plain = pulses().into_iter().map(|event| Event { t_in: None, ..event }).collect();
    let bench = bench(Some(&testing::stream(EXTENT, plain)), Some(&frames(3)));
    assert_says(&bench.run(&["run", "m.toml"]), 0, &[]);
    let done = bench.run(&["run", "m.toml", "--set", "nodes.solve.params.readout=\"slope\""]);
    assert_says(&done, 2, &["nodes.solve", "`readout = \"slope\"` needs in-pixel times", "help:"]);
}

#[test]
fn a_dead_pixel_is_dark_and_its_neighbours_are_not() {
    let dead =
        testing::captured(EXTENT, exposures(3), 30_000, |_, x, y| if (x, y) == (4, 2) { 0.0 } else { dn(x) });
    let rendered = renders(&bench(Some(&events()), Some(&dead)));
    let row = rendered.row(12, 2);
    assert!(row[4].abs() < 1e-3, "{row:?}");
    assert!([3, 5].iter().all(|&x| (row[x] / dn(x as u32) - 1.0).abs() < 0.02), "{row:?}");
    assert_eq!(
        rendered.notes,
        ["solve: 1 pixels did not converge in some window and fell back to the \
                                 double-integral estimate there"]
    );
}

#[test]
fn values_that_are_not_known_stay_unknown_and_are_counted() {
    let unknown =
        testing::captured(
            EXTENT,
            exposures(3),
            30_000,
            |_, x, y| if (x, y) == (4, 2) { f32::NAN } else { dn(x) },
        );
    let rendered = renders(&bench(Some(&events()), Some(&unknown)));
    let nan = rendered.dn.iter().filter(|dn| dn.is_nan()).count();
    assert_eq!(nan, rendered.frames);
    assert!(rendered.row(12, 2)[4].is_nan());
    let solved = "solve: 1 pixels had no usable frame value in some window (NaN): they hold their last \
                  known light there";
    assert_eq!(
        rendered.notes,
        [solved.to_string(), format!("frames: {nan} values are not known (NaN) and were written as code 0")]
    );
}

#[test]
fn a_pixel_that_is_always_saturated_is_a_lower_bound_and_counted() {
    let bright =
        testing::captured(
            EXTENT,
            exposures(3),
            30_000,
            |_, x, y| if (x, y) == (4, 3) { 1023.0 } else { dn(x) },
        );
    let rendered = renders(&bench(Some(&events()), Some(&bright)));
    assert_eq!(
        rendered.notes,
        ["solve: 1 pixels were saturated in every frame of some window: their light is a lower bound there"]
    );
    // Row 3 has no events: the bound is the saturation itself.
    assert!((rendered.row(12, 3)[4] / 1023.0 - 1.0).abs() < 1e-3, "{:?}", rendered.row(12, 3));
    assert!((rendered.row(12, 3)[5] / dn(5) - 1.0).abs() < 1e-3);
}

/// A recording whose events are as given; the stream says that they have in-pixel times.
fn with_events(change: impl FnOnce(&mut Vec<Event>)) -> Bench {
    let mut events = pulses();
    change(&mut events);
    bench(Some(&testing::stream(EXTENT, events)), Some(&frames(3)))
}

#[test]
fn an_event_outside_the_sensor_is_reported_with_count_place_and_advice() {
    let bench = with_events(|events| events[6].x = 12);
    // Events stand by time in the file: 12 ON events come first, and this one was the fourth of them.
    let said = [
        "node recording (read/recording) failed",
        "rec.h5",
        "/events/x, /events/y: found 1 event outside the sensor, the first at index 3 (x = 12, y = 2)",
        "expected x below 12 and y below 10",
        "hint: check the attributes `width` and `height`",
        "skipped: solve needs recording",
    ];
    refuses(&bench, 3, &said);
    let checked = bench.run(&["check", "rec.h5"]);
    assert_says(&checked, 3, &["rec.h5", "found 1 event outside the sensor", "hint: "]);
}

#[test]
fn an_in_pixel_time_after_the_off_pixel_time_is_reported() {
    let bench = with_events(|events| events[0].t_in = Some(events[0].t + 1));
    let said = [
        "rec.h5",
        "/events/t_in: found 1 event with its in-pixel time after its off-pixel time",
        "(t_in = 5001001 ns, t = 5001000 ns), expected t_in <= t",
        "hint: were the two columns swapped?",
    ];
    refuses(&bench, 3, &said);
}

#[test]
fn a_time_resolution_that_is_no_number_of_nanoseconds_is_reported() {
    let events = events();
    let meta = photocurrent_core::EventsMeta { t_resolution_ns: Some(-1), ..(*events.meta).clone() };
    let band = events.read(events.rows()).expect("the events");
    refuses(
        &bench(Some(&EventStream::in_memory(meta.into(), band)), Some(&frames(3))),
        2,
        &["rec.h5", "attribute `t_resolution_ns`", "found -1, expected a number of nanoseconds"],
    );
}

/// The bytes of a good recording.
fn good_bytes(bench: &Bench) -> (PathBuf, Vec<u8>) {
    let path = bench.path("rec.h5");
    let bytes = std::fs::read(&path).expect("the recording");
    (path, bytes)
}

fn position(bytes: &[u8], part: &[u8]) -> usize {
    let found: Vec<usize> =
        (0..bytes.len().saturating_sub(part.len())).filter(|&at| bytes[at..].starts_with(part)).collect();
    assert_eq!(found.len(), 1, "{part:?} stands in the file {} times", found.len());
    found[0]
}

#[test]
fn another_format_is_named() {
    let bench = bench(Some(&events()), Some(&frames(3)));
    let (path, mut bytes) = good_bytes(&bench);
    let at = position(&bytes, b"photocurrent-recording/1") + b"photocurrent-recording/".len();
    bytes[at] = b'7';
    std::fs::write(path, bytes).expect("written");
    refuses(
        &bench,
        2,
        &[
            "rec.h5",
            "found format = \"photocurrent-recording/7\", expected format = \"photocurrent-recording/1\"",
            "m.toml:",
        ],
    );
}

#[test]
fn frames_of_another_size_than_the_sensor_are_reported() {
    let bench = bench(Some(&events()), Some(&frames(3)));
    let (path, mut bytes) = good_bytes(&bench);
    // The attribute's number follows its name, behind type and shape.
    let name = position(&bytes, b"width\0");
    let value = name + position(&bytes[name..name + 128], &12i64.to_le_bytes());
    bytes[value] = 13;
    std::fs::write(path, bytes).expect("written");
    refuses(
        &bench,
        2,
        &[
            "rec.h5",
            "/frames/dn: found frames of 12 x 10 pixels, expected 13 x 10",
            "crop or bin the frames to the pixels of the event sensor",
        ],
    );
}

#[test]
fn unsorted_events_are_reported() {
    // Two stamps of eight bytes without a pattern: a column that does not shrink is stored as it is, the
    // lowest bytes of all numbers first, then the next ones. So the swap of two bytes swaps the order.
    let late = 0x1122_3344_5566_7700_i64;
    let two = [(0x40, Polarity::On), (0x51, Polarity::Off)].map(|(after, polarity)| Event {
        x: 1,
        y: 2,
        polarity,
        t: late + after,
        t_in: None,
    });
    let bench = bench(Some(&testing::stream(EXTENT, two.to_vec())), Some(&frames(3)));
    let (path, mut bytes) = good_bytes(&bench);
    let at = position(&bytes, &[0x40, 0x51, 0x77, 0x77, 0x66, 0x66, 0x55, 0x55]);
    bytes.swap(at, at + 1);
    std::fs::write(path, bytes).expect("written");
    let done = bench.run(&["run", "m.toml", "--to", "recording"]);
    assert_says(
        &done,
        3,
        &[
            "rec.h5",
            "/events/t: found 1 event earlier than the event ahead, the first at index 1",
            "hint: sort the events by t",
        ],
    );
}

#[test]
fn a_recording_cut_short_at_any_length_is_an_error_that_names_it() {
    let bench = bench(Some(&events()), Some(&frames(3)));
    let (path, bytes) = good_bytes(&bench);
    for part in 0..12 {
        // Odd lengths: damage does not come in blocks.
        let length = bytes.len() * part / 12 + part % 5;
        std::fs::write(&path, &bytes[..length]).expect("written");
        refuses(&bench, 2, &["rec.h5", "help:"]);
    }
}

#[test]
fn what_is_no_recording_at_all_is_named() {
    let bench = bench(Some(&events()), Some(&frames(3)));
    let path = bench.path("rec.h5");
    std::fs::write(&path, "").expect("written");
    refuses(
        &bench,
        2,
        &[
            "rec.h5: the file is empty, so it is no HDF5 file",
            "give an HDF5 recording; AEDAT4 files are read by the node read/aedat4",
        ],
    );
    std::fs::write(&path, "t,x,y,p\n1,2,3,1\n").expect("written");
    refuses(
        &bench,
        2,
        &[
            "rec.h5: the file (16 bytes, beginning with \"t,x,y,p\\n\") is no HDF5 file",
            "give an HDF5 recording; AEDAT4 files are read by the node read/aedat4",
        ],
    );
    std::fs::remove_file(&path).expect("removed");
    refuses(
        &bench,
        2,
        &["rec.h5: there is no such file", "paths are relative to the manifest that names them"],
    );
    std::fs::create_dir(&path).expect("a folder");
    refuses(&bench, 2, &["rec.h5: this is no regular file"]);
}

#[test]
fn a_byte_turned_over_anywhere_is_no_panic_and_names_the_file() {
    let bench = bench(Some(&events()), Some(&frames(3)));
    let (path, bytes) = good_bytes(&bench);
    for part in 1..12 {
        let mut damaged = bytes.clone();
        let at = bytes.len() * part / 12;
        damaged[at] ^= 0x55;
        std::fs::write(&path, &damaged).expect("written");
        let done = bench.run(&["run", "m.toml"]);
        assert!([0, 1, 2, 3].contains(&done.code), "byte {at}: {} {}", done.code, done.stderr);
        assert!(
            !done.stderr.contains("panic") && !done.stderr.contains("broke off"),
            "byte {at}: {}",
            done.stderr
        );
        assert!(done.code == 0 || done.stderr.contains("rec.h5"), "byte {at}: {}", done.stderr);
    }
}

fn is_png(entry: &std::io::Result<std::fs::DirEntry>) -> bool {
    entry.as_ref().is_ok_and(|entry| entry.path().extension().is_some_and(|extension| extension == "png"))
}

#[test]
fn an_aedat4_file_cut_short_gives_its_whole_packets_and_says_what_is_lost() {
    let bench = Bench::new();
    let whole = std::fs::read(support::root().join("data/recordings/davis346_traffic.aedat4"))
        .expect("the recording");
    let manifest = "format = 1\n[nodes.recording]\nkind = \"read/aedat4\"\nparams.path = \
                    \"cut.aedat4\"\n[nodes.frames]\nkind = \"write/frames\"\nin.frames = \
                    \"recording.frames\"\n";
    bench.write("m.toml", manifest);
    let cut = |length: usize| std::fs::write(bench.path("cut.aedat4"), &whole[..length]).expect("written");
    let frames = || std::fs::read_dir(bench.path("out/m/frames")).expect("frames").filter(is_png).count();
    // 59 frames follow each other through the file; the data table behind them is for seeking, without it
    // every packet is still there.
    for (length, least, most) in
        [(whole.len() * 9 / 10, 50, 56), (whole.len() / 2 + 1, 25, 33), (whole.len() - 1, 59, 59)]
    {
        cut(length);
        assert_says(&bench.run(&["run", "m.toml"]), 3, &["data lost: cut.aedat4"]);
        assert!((least..=most).contains(&frames()), "{} frames of {length} bytes", frames());
        std::fs::remove_dir_all(bench.path("out")).expect("removed");
    }
    cut(20);
    refuses(&bench, 2, &["cut.aedat4: the file ends at byte 20, inside its header", "copy it again"]);
    cut(0);
    refuses(&bench, 2, &["cut.aedat4 is not AEDAT4 (DV): it is an empty file"]);
    std::fs::write(bench.path("cut.aedat4"), b"#!AER-DAT2.0\r\n# old").expect("written");
    refuses(&bench, 2, &["cut.aedat4 is AEDAT 2.0 (jAER), and not AEDAT4 (DV)", "read it with read/aedat2"]);
}
