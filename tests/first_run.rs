//! The first two commands of a new user, for files of every kind: `init`, then `run`, without an edit, gives
//! frames sharper than those captured.
//!
//! One made-up recording (a texture that slides four pixels within an exposure) is written as each dataset
//! lays it out. What comes back is held against the true light of the scene.

#![allow(clippy::unwrap_used)]

use crate::disc::{self, Placed};
use crate::support::{Bench, root};
use photocurrent_formats::ros::testing::{
    BagWriter, Packing, Wire, compressed_image, db3, event_array, image,
};
use photocurrent_formats::{EventChunk, aedat3::made as made3, aedat4::made, catalog, joined};
use photocurrent_store::recording::Recording;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// An event: us, x, y, ON.
type Event = (i64, u16, u16, bool);

const WIDTH: usize = 48;
const HEIGHT: usize = 36;
const EXPOSURE_US: i64 = 8_000;

/// The recording, once for all tests: events, frames as 8-bit codes with their starts, truth.
struct Scene {
    /// In order of time.
    events: Vec<Event>,
    /// Start of the exposure in us, codes.
    frames: Vec<(i64, Vec<u8>)>,
    /// Middle in us, codes as a frame of the nominal exposure would have them.
    truth: Vec<(i64, Vec<f64>)>,
}

fn scene() -> &'static Scene {
    static SCENE: OnceLock<Scene> = OnceLock::new();
    SCENE.get_or_init(|| {
        let bench = Bench::new();
        let sensor = root().join("data/sensors/ideal.toml");
        let manifest = format!(
            r#"format = 1
[pipeline]
seed = 3
[nodes.sensor]
kind = "read/sensor"
params = {{ path = {sensor:?}, change = {{ frames = {{ row_time = "0 us" }}, comparator = {{ threshold_on = 0.2, threshold_off = 0.2 }} }} }}
[nodes.scene]
kind = "simulate/scene"
in = {{ sensor = "sensor" }}
params = {{ scene = "texture", width = {WIDTH}, height = {HEIGHT}, duration = "130 ms", illuminance = "800 lx" }}
[nodes.camera]
kind = "simulate/sensor"
in = {{ light = "scene.light", sensor = "sensor" }}
params = {{ frame_rate = "50 Hz", exposure = "{EXPOSURE_US} us" }}
[nodes.file]
kind = "write/recording"
in = {{ events = "camera.events", frames = "camera.frames", truth = "scene.truth" }}
"#
        );
        bench.write("scene.toml", &manifest);
        let done = bench.run(&["run", "scene.toml", "--quiet"]);
        assert_eq!(done.code, 0, "{}", done.stderr);
        read(&bench.path("out/scene/file/recording.h5"))
    })
}

fn read(path: &Path) -> Scene {
    let recording = Recording::open(path).unwrap();
    let frames = recording.frames(0).unwrap();
    let truth = recording.truth().unwrap().0;
    let block = frames.read_rows(frames.rows()).unwrap();
    // Eight-bit codes, as most cameras give them: the brightest value of the scene is 250.
    let scale = 250.0 / f64::from(block.dn.iter().copied().fold(0.0, f32::max));
    let codes = |values: &[f32]| values.iter().map(|dn| (f64::from(*dn) * scale).round() as u8).collect();
    let true_block = truth.read_rows(truth.rows()).unwrap();
    let mut chunk = EventChunk::default();
    let mut events = Vec::new();
    let opened = joined::open(catalog::named("recording").unwrap(), path, &Default::default()).unwrap();
    let mut cursor = opened.events().unwrap();
    while cursor.next(&mut chunk).unwrap() {
        events.extend(
            (0..chunk.len())
                .map(|i| (chunk.t[i] / 1000 + 1_000_000, chunk.x[i], chunk.y[i], chunk.on[i] != 0)),
        );
    }
    Scene {
        events,
        frames: (0..frames.len())
            .map(|l| (frames.meta.times.exposures[l].start.0 / 1000 + 1_000_000, codes(block.frame(l))))
            .collect(),
        truth: (0..truth.len())
            .map(|l| {
                (
                    truth.meta.times.exposures[l].mid().0 / 1000 + 1_000_000,
                    true_block.frame(l).iter().map(|dn| f64::from(*dn) * scale).collect(),
                )
            })
            .collect(),
    }
}

fn write_png(path: &Path, codes: &[u8]) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, disc::png(WIDTH, HEIGHT, codes)).unwrap();
}

/// PSNR against the truth nearest in time, between the first and the last frame but one, with a peak of 250.
fn psnr(frames: &[(i64, Vec<f64>)]) -> f64 {
    let scene = scene();
    let (first, last) = (scene.frames[1].0, scene.frames[scene.frames.len() - 2].0);
    let (mut square, mut count) = (0.0, 0.0);
    for (t, values) in frames.iter().filter(|(t, _)| (first..last).contains(t)) {
        let (_, truth) = scene.truth.iter().min_by_key(|(at, _)| (at - t).abs()).unwrap();
        for (value, truth) in values.iter().zip(truth) {
            square += (value - truth) * (value - truth);
            count += 1.0;
        }
    }
    assert!(count > 0.0, "frames were rendered between the captured ones");
    10.0 * libm::log10(250.0 * 250.0 * count / square)
}

/// The rendered frames of a run: middle in us since the first event or exposure, linear values.
fn rendered(folder: &Path) -> Vec<(i64, Vec<f64>)> {
    let table = fs::read_to_string(folder.join("frames.csv")).unwrap();
    let scale: f64 = table
        .lines()
        .next()
        .unwrap()
        .split("scale=")
        .nth(1)
        .unwrap()
        .split(';')
        .next()
        .unwrap()
        .parse()
        .unwrap();
    let rows = table.lines().filter(|line| line.starts_with(|c: char| c.is_ascii_digit()));
    let frame = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        let decoder =
            png::Decoder::new(std::io::BufReader::new(fs::File::open(folder.join(cells[4])).unwrap()));
        let mut reader = decoder.read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut bytes).unwrap();
        let values = bytes
            .chunks_exact(2)
            .map(|pair| f64::from(u16::from_be_bytes([pair[0], pair[1]])) * scale)
            .collect();
        (cells[3].parse::<i64>().unwrap() / 1000, values)
    };
    rows.map(frame).collect()
}

/// `init` and `run` on files in a bench; the frames must be nearer to the truth than repeating the captured
/// ones, by a good margin.
fn two_commands(bench: &Bench, files: &[&str], options: &[&str]) {
    let mut arguments = vec!["init"];
    arguments.extend(files);
    arguments.extend(["-o", "my.toml"]);
    arguments.extend(options);
    let done = bench.run(&arguments);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert!(done.stderr.contains("next: photocurrent run my.toml"), "{}", done.stderr);
    let manifest = fs::read_to_string(bench.path("my.toml")).unwrap();
    let done = bench.run(&["run", "my.toml", "--quiet"]);
    assert_eq!(done.code, 0, "{}\n{manifest}", done.stderr);
    let scene = scene();
    let zero = scene.events[0].0.min(scene.frames[0].0);
    // Of pictures in colour the red.
    let red = |values: Vec<f64>| values.iter().step_by(values.len() / (WIDTH * HEIGHT)).copied().collect();
    let ours: Vec<(i64, Vec<f64>)> = rendered(&bench.path("out/my/frames"))
        .into_iter()
        .map(|(t, values)| (t + zero, red(values)))
        .collect();
    let captured =
        |t: i64| scene.frames.iter().min_by_key(|(start, _)| (start + EXPOSURE_US / 2 - t).abs()).unwrap();
    let repeated: Vec<(i64, Vec<f64>)> = ours
        .iter()
        .map(|(t, _)| (*t, captured(*t).1.iter().map(|code| f64::from(*code)).collect()))
        .collect();
    let (ours, repeated) = (psnr(&ours), psnr(&repeated));
    // Half the error at least: a shift of a frame period, a wrong curve or events of the wrong sign all fall
    // below.
    assert!(
        ours > repeated + 3.0,
        "sharp frames have {ours:.1} dB, captured ones {repeated:.1} dB\n{manifest}"
    );
    assert!(
        bench.path("out/my/sheet/contact_sheet.png").is_file()
            && bench.path("out/my/frames/preview").is_dir(),
        "there is something to look at"
    );
    // And the third command.
    let report = crate::diagnosis::follows_init(bench, files);
    assert_eq!(
        report["effects"].as_array().map(Vec::len),
        Some(0),
        "nothing is wrong with this sensor: {}",
        report["summary"]
    );
}

/// What this test knows of the scene and a dataset does not record; a user knows it too, or looks at the
/// marked lines.
const KNOWN: [&str; 6] = ["--exposure", "8 ms", "--stamp", "start", "--transfer", "linear"];

#[test]
fn a_folder_of_the_event_camera_dataset() {
    let bench = Bench::new();
    let mut text = String::new();
    scene().events.iter().for_each(|(t, x, y, on)| {
        writeln!(text, "{}.{:06} {x} {y} {}", t / 1_000_000, t % 1_000_000, u8::from(*on)).unwrap()
    });
    bench.write("clip/events.txt", &text);
    let mut list = String::new();
    for (l, (t, codes)) in scene().frames.iter().enumerate() {
        writeln!(list, "{}.{:06} images/frame_{l:08}.png", t / 1_000_000, t % 1_000_000).unwrap();
        write_png(&bench.path(&format!("clip/images/frame_{l:08}.png")), codes);
    }
    bench.write("clip/images.txt", &list);
    two_commands(&bench, &["clip"], &KNOWN);
}

#[test]
fn a_sequence_of_dsec() {
    let bench = Bench::new();
    write_csv(&bench, "events.csv");
    fs::create_dir_all(bench.path("clip/events/left")).unwrap();
    let done = bench.run(&["convert", "events.csv", "clip/events/left/events.h5", "--to", "dsec"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let mut exposures = String::from("# start, end\n");
    for (l, (t, codes)) in scene().frames.iter().enumerate() {
        writeln!(exposures, "{t}, {}", t + EXPOSURE_US).unwrap();
        write_png(&bench.path(&format!("clip/images/left/rectified/{l:06}.png")), codes);
    }
    bench.write("clip/images/left/exposure_timestamps_left.txt", &exposures);
    two_commands(&bench, &["clip"], &["--transfer", "linear"]);
}

fn write_csv(bench: &Bench, name: &str) -> PathBuf {
    let mut text = format!("# photocurrent-events/1 time_unit=us width={WIDTH} height={HEIGHT}\nt,x,y,p\n");
    scene().events.iter().for_each(|(t, x, y, on)| writeln!(text, "{t},{x},{y},{}", u8::from(*on)).unwrap());
    bench.write(name, &text)
}

#[test]
fn an_evt3_file_with_a_folder_of_pictures() {
    let bench = Bench::new();
    write_csv(&bench, "events.csv");
    let done = bench.run(&["convert", "events.csv", "clip.raw"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let mut stamps = String::from("file,start_us,end_us\n");
    for (l, (t, codes)) in scene().frames.iter().enumerate() {
        writeln!(stamps, "{l}.png,{t},{}", t + EXPOSURE_US).unwrap();
        write_png(&bench.path(&format!("frames/{l}.png")), codes);
    }
    bench.write("frames/timestamps.txt", &stamps);
    two_commands(&bench, &["clip.raw", "frames"], &["--transfer", "linear"]);
}

#[test]
fn an_aedat4_file() {
    let bench = Bench::new();
    let events: Vec<(i64, i16, i16, u8)> =
        scene().events.iter().map(|(t, x, y, on)| (*t, *x as i16, *y as i16, u8::from(*on))).collect();
    let mut pieces: Vec<made::Piece> = events.chunks(1000).map(|part| made::events(0, part)).collect();
    let size = (WIDTH as i16, HEIGHT as i16);
    pieces.extend(
        scene().frames.iter().map(|(t, codes)| made::frame(1, *t, (*t, t + EXPOSURE_US), 0, size, codes)),
    );
    let streams = [("EVTS", WIDTH as u32, HEIGHT as u32), ("FRME", WIDTH as u32, HEIGHT as u32)];
    fs::write(bench.path("clip.aedat4"), made::file(made::How::Lz4, &streams, &pieces, true)).unwrap();
    // Everything is recorded.
    two_commands(&bench, &["clip.aedat4"], &[]);
}

#[test]
fn a_bag_of_ros() {
    let bench = Bench::new();
    let mut bag = BagWriter::new(Packing::None);
    let (events, images) = (
        bag.connect("/dvs/events", "dvs_msgs/EventArray"),
        bag.connect("/dvs/image_raw", "sensor_msgs/Image"),
    );
    let size = (WIDTH as u32, HEIGHT as u32);
    for part in scene().events.chunks(500) {
        let part: Vec<Event> = part.iter().map(|(t, x, y, on)| (t * 1000, *x, *y, *on)).collect();
        let last = part.last().unwrap().0;
        bag.message(events, last, &event_array(Wire::Ros1, last, size, &part));
    }
    for (t, codes) in &scene().frames {
        bag.message(images, t * 1000, &image(Wire::Ros1, t * 1000, size, "mono8", WIDTH as u32, codes));
    }
    fs::write(bench.path("clip.bag"), bag.finish().unwrap()).unwrap();
    two_commands(&bench, &["clip.bag"], &KNOWN);
}

#[test]
fn a_bag_of_ros_with_compressed_pictures() {
    let bench = Bench::new();
    let mut bag = BagWriter::new(Packing::Lz4);
    let (events, images) = (
        bag.connect("/dvs/events", "dvs_msgs/EventArray"),
        bag.connect("/dvs/image_raw/compressed", "sensor_msgs/CompressedImage"),
    );
    for part in scene().events.chunks(500) {
        let part: Vec<Event> = part.iter().map(|(t, x, y, on)| (t * 1000, *x, *y, *on)).collect();
        let last = part.last().unwrap().0;
        bag.message(events, last, &event_array(Wire::Ros1, last, (WIDTH as u32, HEIGHT as u32), &part));
    }
    for (t, codes) in &scene().frames {
        bag.message(
            images,
            t * 1000,
            &compressed_image(
                Wire::Ros1,
                t * 1000,
                "mono8; png compressed ",
                &disc::png(WIDTH, HEIGHT, codes),
            ),
        );
    }
    fs::write(bench.path("clip.bag"), bag.finish().unwrap()).unwrap();
    two_commands(&bench, &["clip.bag"], &KNOWN);
}

#[test]
fn a_bag_of_ros_2_in_sqlite_as_a_file_and_as_a_folder() {
    let bench = Bench::new();
    let topics = [("/dvs/events", "dvs_msgs/msg/EventArray"), ("/dvs/image_raw", "sensor_msgs/msg/Image")];
    let size = (WIDTH as u32, HEIGHT as u32);
    let mut messages: Vec<(u32, i64, Vec<u8>)> = Vec::new();
    for part in scene().events.chunks(500) {
        let part: Vec<Event> = part.iter().map(|(t, x, y, on)| (t * 1000, *x, *y, *on)).collect();
        let last = part.last().unwrap().0;
        messages.push((0, last, event_array(Wire::Cdr, last, size, &part)));
    }
    for (t, codes) in &scene().frames {
        messages.push((1, t * 1000, image(Wire::Cdr, t * 1000, size, "mono8", WIDTH as u32, codes)));
    }
    messages.sort_by_key(|message| message.1);
    fs::write(bench.path("clip.db3"), db3(&topics, &messages).unwrap()).unwrap();
    two_commands(&bench, &["clip.db3"], &KNOWN);
    // The same, split as a long recording is.
    let (first, second) = messages.split_at(messages.len() / 2);
    bench.write(
        "bag/metadata.yaml",
        "rosbag2_bagfile_information:\n  version: 5\n  \
                                      relative_file_paths:\n    - bag_0.db3\n    - bag_1.db3\n",
    );
    fs::write(bench.path("bag/bag_0.db3"), db3(&topics, first).unwrap()).unwrap();
    fs::write(bench.path("bag/bag_1.db3"), db3(&topics, second).unwrap()).unwrap();
    fs::remove_file(bench.path("my.toml")).unwrap();
    fs::remove_file(bench.path("my.sensor.toml")).unwrap();
    two_commands(&bench, &["bag"], &KNOWN);
}

#[test]
fn an_aedat_3_file() {
    let bench = Bench::new();
    let mut parts = vec![made3::header("DAVISprototype")];
    parts.extend(scene().events.chunks(1000).map(|part| made3::polarity(0, part)));
    for (t, codes) in &scene().frames {
        let values: Vec<u16> = codes.iter().map(|code| u16::from(*code)).collect();
        parts.push(made3::frame(0, (1, 0), (*t, t + EXPOSURE_US), (WIDTH as u32, HEIGHT as u32), &values));
    }
    fs::write(bench.path("clip.aedat"), parts.concat()).unwrap();
    // Everything is recorded.
    two_commands(&bench, &["clip.aedat"], &[]);
}

/// A sequence with these events, in shades of grey or of a colour: green and blue as parts of red.
fn hs_ergb(bench: &Bench, events: &[Placed], hue: Option<[f64; 2]>) {
    let in_colour = |codes: &[u8], [green, blue]: [f64; 2]| -> Vec<u8> {
        let part = |code: &u8, part: f64| (f64::from(*code) * part).round() as u8;
        codes.iter().flat_map(|code| [*code, part(code, green), part(code, blue)]).collect()
    };
    let shown = |(t, codes): &(i64, Vec<u8>)| (*t, hue.map_or(codes.clone(), |hue| in_colour(codes, hue)));
    let frames: Vec<(i64, Vec<u8>)> = scene().frames.iter().map(shown).collect();
    disc::hs_ergb(&bench.path("clip"), (WIDTH, HEIGHT), &frames, events);
}

#[test]
fn a_sequence_of_hs_ergb() {
    let bench = Bench::new();
    let place = |event: &Event| (event.0, 32 * i64::from(event.1), 32 * i64::from(event.2), event.3);
    hs_ergb(&bench, &scene().events.iter().map(place).collect::<Vec<_>>(), None);
    two_commands(&bench, &["clip"], &KNOWN);
}

#[test]
fn a_sequence_of_hs_ergb_in_colour_is_solved_as_its_mixture() {
    let bench = Bench::new();
    let place = |event: &Event| (event.0, 32 * i64::from(event.1), 32 * i64::from(event.2), event.3);
    let hue = [0.7, 0.4];
    hs_ergb(&bench, &scene().events.iter().map(place).collect::<Vec<_>>(), Some(hue));
    two_commands(&bench, &["clip"], &KNOWN);
    let manifest = fs::read_to_string(bench.path("my.toml")).unwrap();
    for kind in ["render/grey", "refine/motion", "render/colour"] {
        assert!(manifest.contains(kind), "{manifest}");
    }
    for (_, values) in rendered(&bench.path("out/my/frames")) {
        // Codes of dark places are rounded by much, and white is clipped.
        for pixel in values.chunks_exact(3).filter(|pixel| (60.0..254.0).contains(&pixel[0])) {
            for (value, part) in pixel[1..].iter().zip(hue) {
                assert!((value / pixel[0] - part).abs() < 0.02, "{pixel:?}, {part} of red");
            }
        }
    }
}

#[test]
fn a_sequence_of_hs_ergb_whose_events_were_warped_has_no_pixel_without_them() {
    // Event pixels of another camera, 1.16 pixels of the frames apart and turned a little: each has the
    // events of the pixel that lies nearest to its place.
    let bench = Bench::new();
    let warped = |column: i64, row: i64| {
        let (x, y) = (1.16 * column as f64, 1.16 * row as f64);
        (x - 0.02 * y + 0.3, y + 0.02 * x + 0.1)
    };
    let mut of_pixel: std::collections::HashMap<(i64, i64), Vec<&Event>> = Default::default();
    for event in &scene().events {
        of_pixel.entry((event.1.into(), event.2.into())).or_default().push(event);
    }
    let mut events = Vec::new();
    let mut without = vec![true; WIDTH * HEIGHT];
    for (column, row) in (0..45).flat_map(|column| (0..35).map(move |row| (column, row))) {
        let (x, y) = warped(column, row);
        let nearest = ((x + 0.5).floor() as i64, (y + 0.5).floor() as i64);
        if let Some(without) = without.get_mut((nearest.1 * WIDTH as i64 + nearest.0) as usize) {
            *without = false;
        }
        let (x, y) = ((32.0 * x).round() as i64, (32.0 * y).round() as i64);
        let seen = of_pixel.get(&nearest).into_iter().flatten();
        events.extend(seen.map(|event| (event.0, x, y, event.3)));
    }
    events.sort_by_key(|event| event.0);
    // Rounded, a quarter of the pixels had none.
    assert!(without.iter().filter(|is| **is).count() > WIDTH * HEIGHT / 5);
    hs_ergb(&bench, &events, None);
    let seen = bench.run(&["inspect", "clip"]);
    assert!(seen.stdout.contains("with a pitch of 1.16"), "{} {}", seen.stdout, seen.stderr);
    two_commands(&bench, &["clip"], &KNOWN);
    let manifest = fs::read_to_string(bench.path("my.toml")).unwrap();
    for kind in ["read/alignment", "estimate/alignment", "align/tracks", "render/colour"] {
        assert!(manifest.contains(kind), "{manifest}");
    }
}

#[test]
fn unknowns_are_proposed_and_marked_and_the_manifest_runs_all_the_same() {
    let bench = Bench::new();
    write_csv(&bench, "events.csv");
    let mut stamps = String::new();
    for (l, (t, codes)) in scene().frames.iter().enumerate() {
        writeln!(stamps, "{t}").unwrap();
        write_png(&bench.path(&format!("frames/{l}.png")), codes);
    }
    bench.write("stamps.txt", &stamps);
    let done =
        bench.run(&["init", "events.csv", "frames", "stamps.txt", "-o", "my.toml", "--time-unit", "us"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let (manifest, sensor) = (
        fs::read_to_string(bench.path("my.toml")).unwrap(),
        fs::read_to_string(bench.path("my.sensor.toml")).unwrap(),
    );
    for name in ["exposure", "stamp", "row_time", "transfer"] {
        let line = manifest
            .lines()
            .find(|line| line.starts_with(&format!("{name} =")))
            .unwrap_or_else(|| panic!("{name} stands in\n{manifest}"));
        assert!(line.contains("# FILL: "), "{line}");
    }
    assert!(
        sensor.lines().any(|line| line.starts_with("threshold_on =") && line.contains("# FILL: ")),
        "{sensor}"
    );
    assert_eq!(bench.run(&["run", "my.toml", "--quiet"]).code, 0);
    // By the files alone a reader needs what the manifest states: its name, or the options.
    fs::copy(bench.path("my.sensor.toml"), bench.path("other.toml")).unwrap();
    let files = [
        "diagnose",
        "events.csv",
        "frames",
        "stamps.txt",
        "--sensor",
        "other.toml",
        "--direct",
        "-o",
        "found",
        "--time-unit",
        "us",
    ];
    let done = bench.run(&files);
    assert!(
        done.code == 2
            && done.stderr.contains("photocurrent diagnose my.toml")
            && done.stderr.contains("state it: --"),
        "{}",
        done.stderr
    );
    let done = bench.run(&[&files[..], &KNOWN, &["--row-time", "0 us"]].concat());
    assert_eq!(done.code, 0, "{}", done.stderr);
    // Next to its manifest the description is enough.
    let done = bench.run(&[
        "diagnose",
        "events.csv",
        "frames",
        "stamps.txt",
        "--sensor",
        "my.sensor.toml",
        "--direct",
        "-o",
        "found",
    ]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let note = done
        .stderr
        .lines()
        .find(|line| line.ends_with(" as in my.toml"))
        .unwrap_or_else(|| panic!("{}", done.stderr));
    assert!(
        ["time_unit", "exposure", "stamp", "row_time", "transfer"].iter().all(|name| note.contains(name)),
        "{note}"
    );
    // Nothing is overwritten unasked.
    let again = bench.run(&["init", "events.csv", "frames", "stamps.txt", "-o", "my.toml"]);
    assert!(again.code == 2 && again.stderr.contains("--force"), "{}", again.stderr);
}

#[test]
fn what_is_converted_there_and_back_is_the_same() {
    let bench = Bench::new();
    let first = fs::read_to_string(write_csv(&bench, "a.csv")).unwrap();
    for (to, options) in [("b.h5", vec!["--to", "dsec"]), ("b.raw", vec![])] {
        let mut arguments = vec!["convert", "a.csv", to];
        arguments.extend(options);
        assert_eq!(bench.run(&arguments).code, 0, "{to}");
        assert_eq!(bench.run(&["convert", to, "c.csv", "--force"]).code, 0, "{to}");
        assert_eq!(fs::read_to_string(bench.path("c.csv")).unwrap(), first, "{to}");
    }
    // Our own recording begins at zero; a part of it is what the text says of that part.
    assert_eq!(bench.run(&["convert", "a.csv", "d.h5"]).code, 0);
    assert_eq!(
        bench
            .run(&["convert", "d.h5", "e.csv", "--crop", "8,4,20,10", "--start", "20 ms", "--end", "60 ms"])
            .code,
        0
    );
    let zero = scene().events[0].0;
    let inside = |event: &&Event| {
        (20_000..60_000).contains(&(event.0 - zero))
            && (8..28).contains(&event.1)
            && (4..14).contains(&event.2)
    };
    let expected: Vec<String> = scene()
        .events
        .iter()
        .filter(inside)
        .map(|(t, x, y, on)| format!("{},{},{},{}", t - zero, x - 8, y - 4, u8::from(*on)))
        .collect();
    let part = fs::read_to_string(bench.path("e.csv")).unwrap();
    let found: Vec<&str> =
        part.lines().filter(|line| line.starts_with(|c: char| c.is_ascii_digit())).collect();
    assert_eq!(found, expected);
    assert!(!expected.is_empty());
}
