//! Pictures of a folder with the pulses of a trigger line, or with stamps, of which some are missing: what
//! `init` proposes, what a reader refuses, what is lost.
//!
//! One recording is made here: a bright disc crosses a striped ramp, 64 x 48 pixels, 15 pictures of 10 ms,
//! one every 20 ms, and edges of a trigger line. Each test leaves something out or inverts the line; the
//! pictures' true times are known.

#![allow(clippy::unwrap_used)]

use crate::support::Bench;
use photocurrent_core::Extent;
use photocurrent_formats::evt::evt3_writer::Writer;
use photocurrent_formats::{Edge, EventChunk, Trigger};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::sync::OnceLock;

const WIDTH: usize = 64;
const HEIGHT: usize = 48;
/// The scene's zero on the clock of the camera, us.
const BASE_US: i64 = 6_437_000;
const EXPOSURE_US: i64 = 10_000;
const COUNT: usize = 15;

/// Start of exposure `n`, us from the scene's zero.
fn start_us(n: usize) -> i64 {
    2_000 + 20_000 * n as i64
}

/// Values of a pixel, 0 to 255, at a time in seconds.
fn light(t: f64, x: usize, y: usize) -> f64 {
    let (fx, fy) = (x as f64, y as f64);
    let base = 40.0 + 60.0 * fx / WIDTH as f64 + 30.0 * libm::sin(fy / 5.0);
    let (cx, cy) =
        (0.15 * WIDTH as f64 + 200.0 * t, 0.5 * HEIGHT as f64 + 0.2 * HEIGHT as f64 * libm::sin(6.0 * t));
    let disc = 1.0 / (1.0 + libm::exp((libm::hypot(fx - cx, fy - cy) - 0.16 * HEIGHT as f64) / 0.8));
    base * (1.0 - disc) + 200.0 * disc
}

struct Scene {
    /// us from zero, x, y, ON; in order of time.
    events: Vec<(i64, u16, u16, bool)>,
    pictures: Vec<Vec<u8>>,
}

fn scene() -> &'static Scene {
    static SCENE: OnceLock<Scene> = OnceLock::new();
    SCENE.get_or_init(|| {
        let mut events = Vec::new();
        for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
            let log = |t: f64| libm::log(light(t, x, y) + 1.0);
            let (mut reference, mut before) = (log(0.0), log(0.0));
            for step in 1..=600 {
                let now = log(step as f64 * 5e-4);
                while (now - reference).abs() >= 0.25 {
                    let is_on = now > reference;
                    reference += if is_on { 0.25 } else { -0.25 };
                    let part = ((reference - before) / (now - before)).clamp(0.0, 1.0);
                    events.push((((step as f64 - 1.0 + part) * 500.0) as i64, x as u16, y as u16, is_on));
                }
                before = now;
            }
        }
        events.sort_unstable();
        let mean = |n: usize, x: usize, y: usize| {
            (0..10)
                .map(|k| light((start_us(n) as f64 + 1_000.0 * (k as f64 + 0.5)) * 1e-6, x, y))
                .sum::<f64>()
                / 10.0
        };
        let picture = |n: usize| {
            (0..HEIGHT)
                .flat_map(|y| (0..WIDTH).map(move |x| (x, y)))
                .map(|(x, y)| mean(n, x, y).round() as u8)
                .collect()
        };
        Scene { events, pictures: (0..COUNT).map(picture).collect() }
    })
}

/// An edge: us from the scene's zero, and which way.
type At = (i64, Edge);

/// Both edges of the pulses of some pictures; `opens` is the edge that opens the shutter.
fn edges(of: &[usize], opens: Edge) -> Vec<At> {
    let closes = if opens == Edge::Rising { Edge::Falling } else { Edge::Rising };
    of.iter().flat_map(|n| [(start_us(*n), opens), (start_us(*n) + EXPOSURE_US, closes)]).collect()
}

fn all() -> Vec<usize> {
    (0..COUNT).collect()
}

/// Writes `events.raw` with edges on a line.
fn write_events(bench: &Bench, edges: &[At], line: u16) {
    let mut writer =
        Writer::new(Vec::new(), Extent { width: WIDTH as u32, height: HEIGHT as u32 }, &[]).unwrap();
    let mut edges = edges.iter().peekable();
    let ns = |us: i64| (us + BASE_US) * 1000;
    let mut chunk = EventChunk::default();
    for (t, x, y, on) in &scene().events {
        while let Some((at, edge)) = edges.next_if(|edge| edge.0 <= *t) {
            writer.write(&chunk).unwrap();
            chunk.clear();
            writer.write_trigger(&Trigger { t: ns(*at), line, edge: *edge }).unwrap();
        }
        chunk.push(ns(*t), *x, *y, *on);
    }
    writer.write(&chunk).unwrap();
    edges.for_each(|(at, edge)| writer.write_trigger(&Trigger { t: ns(*at), line, edge: *edge }).unwrap());
    fs::write(bench.path("events.raw"), writer.finish().unwrap()).unwrap();
}

/// Writes picture `n` of the scene under a number.
fn write_picture(bench: &Bench, n: usize, number: usize) {
    fs::create_dir_all(bench.path("frames")).unwrap();
    let file = fs::File::create(bench.path(&format!("frames/{number:06}.png"))).unwrap();
    let mut encoder = png::Encoder::new(file, WIDTH as u32, HEIGHT as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().unwrap().write_image_data(&scene().pictures[n]).unwrap();
}

/// Pictures by their own numbers.
fn write_pictures(bench: &Bench, of: &[usize]) {
    of.iter().for_each(|n| write_picture(bench, *n, *n));
}

/// Runs `init` and gives the manifest, its talk and the exit code.
fn init(bench: &Bench, files: &[&str], options: &[&str]) -> (String, String, i32) {
    let done = bench.run(&[&["init"], files, &["-o", "my.toml"], options].concat());
    (fs::read_to_string(bench.path("my.toml")).unwrap_or_default(), done.stderr, done.code)
}

/// The marked line of a parameter.
fn fill<'a>(manifest: &'a str, name: &str) -> &'a str {
    manifest
        .lines()
        .find(|line| line.starts_with(&format!("{name} = ")))
        .unwrap_or_else(|| panic!("`{name}` stands in\n{manifest}"))
}

/// The offset of clocks that `init` proposes, ms. On this scene it is about -1 ms though the pairing is
/// right; a wrong level is off by 10 ms, a wrong pulse by 20.
fn offset_ms(bench: &Bench) -> f64 {
    let sensor = fs::read_to_string(bench.path("my.sensor.toml")).unwrap();
    let line = sensor.lines().find_map(|line| line.strip_prefix("clock_offset = { offset = \""));
    line.map_or(0.0, |line| line.split(' ').next().unwrap().parse().unwrap())
}

/// PSNR of the rendered frames against the light at their own times, where the disc passes.
fn score(folder: &Path, zero_us: i64) -> f64 {
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
    let (mut square, mut count) = (0.0, 0.0);
    for line in table.lines().filter(|line| line.starts_with(|c: char| c.is_ascii_digit())).step_by(5) {
        let cells: Vec<&str> = line.split(',').collect();
        let t = (cells[3].parse::<f64>().unwrap() / 1000.0 + zero_us as f64) * 1e-6;
        let mut reader =
            png::Decoder::new(std::io::BufReader::new(fs::File::open(folder.join(cells[4])).unwrap()))
                .read_info()
                .unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut bytes).unwrap();
        for (n, pair) in bytes.chunks_exact(2).enumerate() {
            // Pictures are read as sRGB, so the truth is their linear value.
            let coded = light(t, n % WIDTH, n / WIDTH) / 255.0;
            let truth = 255.0
                * if coded <= 0.04045 { coded / 12.92 } else { libm::pow((coded + 0.055) / 1.055, 2.4) };
            let error = f64::from(u16::from_be_bytes([pair[0], pair[1]])) * scale - truth;
            square += error * error;
            count += 1.0;
        }
    }
    10.0 * libm::log10(255.0 * 255.0 * count / square)
}

/// The time that became zero, us from the scene's zero: the first event or the first exposure.
fn zero_us(first_exposure: usize) -> i64 {
    scene().events[0].0.min(start_us(first_exposure))
}

#[test]
fn a_strobe_that_is_inverted_is_proposed_from_counts_and_events() {
    let control = {
        let bench = Bench::new();
        write_events(&bench, &edges(&all(), Edge::Rising), 0);
        write_pictures(&bench, &all());
        let (manifest, talk, code) = init(&bench, &["events.raw", "frames"], &[]);
        assert_eq!(code, 0, "{talk}");
        assert!(fill(&manifest, "strobe").starts_with("strobe = \"active_high\" # FILL: "), "{manifest}");
        let done = bench.run(&["run", "my.toml", "--quiet"]);
        assert_eq!(done.code, 0, "{}", done.stderr);
        score(&bench.path("out/my/frames"), zero_us(0))
    };
    let bench = Bench::new();
    write_events(&bench, &edges(&all(), Edge::Falling), 0);
    write_pictures(&bench, &all());
    let (manifest, talk, code) = init(&bench, &["events.raw", "frames"], &[]);
    assert_eq!(code, 0, "{talk}");
    let line = fill(&manifest, "strobe");
    assert!(line.starts_with("strobe = \"active_low\" # FILL: "), "{line}");
    for evidence in [
        "15 whole exposures of 10 ms for 15 pictures",
        "14 whole exposures of 10 ms for 15 pictures",
        "agreement with the events",
    ] {
        assert!(line.contains(evidence), "{line}");
    }
    assert!(
        offset_ms(&bench).abs() < 2.0,
        "an inverted strobe is no offset of clocks: {} ms",
        offset_ms(&bench)
    );
    let done = bench.run(&["run", "my.toml", "--quiet"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let found = score(&bench.path("out/my/frames"), zero_us(0));
    assert!((found - control).abs() < 0.5, "inverted: {found:.1} dB, upright: {control:.1} dB");
    // Without the line, a reader refuses: rising to falling gives one exposure less than there are pictures.
    fs::write(
        bench.path("my.toml"),
        manifest.lines().filter(|line| !line.starts_with("strobe")).collect::<Vec<_>>().join("\n"),
    )
    .unwrap();
    let done = bench.run(&["run", "my.toml", "--quiet"]);
    assert!([2, 3].contains(&done.code), "{}: {}", done.code, done.stderr);
    assert!(
        done.stderr.contains("strobe = \"active_low\"") && done.stderr.contains("14 whole exposures"),
        "{}",
        done.stderr
    );
}

/// As in AravisProject/aravis#818: the camera drops the first picture after the trigger starts, and numbers
/// the others from 0.
#[test]
fn a_dropped_first_picture_is_found_by_the_events_and_refused_without_them() {
    let bench = Bench::new();
    write_events(&bench, &edges(&all(), Edge::Rising), 0);
    (1..COUNT).for_each(|n| write_picture(&bench, n, n - 1));
    let (manifest, talk, code) = init(&bench, &["events.raw", "frames"], &["--strobe", "active_high"]);
    assert_eq!(code, 0, "{talk}");
    let line = fill(&manifest, "first_pulse");
    assert!(line.starts_with("first_pulse = 1 # FILL: ") && line.contains("second best is "), "{line}");
    assert!(line.contains("0 pictures and 1 pulse without a partner"), "{line}");
    fs::write(
        bench.path("my.toml"),
        manifest.lines().filter(|line| !line.starts_with("first_pulse")).collect::<Vec<_>>().join("\n"),
    )
    .unwrap();
    let done = bench.run(&["run", "my.toml", "--quiet"]);
    assert!([2, 3].contains(&done.code), "{}: {}", done.code, done.stderr);
    assert!(
        done.stderr.contains("14 pictures and 15 pulses of trigger line 0")
            && done.stderr.contains("`first_pulse = 1`"),
        "{}",
        done.stderr
    );
}

/// As tub-rip/CoCapture#21 wants to be checked: as many pictures as pulses. Here both miss one, at different
/// ends, so that counts are equal.
#[test]
fn equal_counts_of_other_pictures_are_found_by_the_events() {
    let bench = Bench::new();
    let (pulses, pictures): (Vec<usize>, Vec<usize>) = ((1..COUNT).collect(), (0..COUNT - 1).collect());
    write_events(&bench, &edges(&pulses, Edge::Rising), 0);
    write_pictures(&bench, &pictures);
    let (manifest, talk, code) = init(&bench, &["events.raw", "frames"], &[]);
    assert_eq!(code, 0, "{talk}");
    assert!(fill(&manifest, "first_pulse").starts_with("first_pulse = -1 # FILL: "), "{manifest}");
    assert!(
        offset_ms(&bench).abs() < 2.0,
        "a pulse too few is no offset of clocks: {} ms",
        offset_ms(&bench)
    );
}

/// As in ros-event-camera/frequency_cam#4, where edges must alternate, or one was missed; and
/// TheImagingSource/ic4-examples#46: fewer pictures than triggers.
#[test]
fn a_missed_edge_and_a_lost_picture_shift_no_other() {
    let bench = Bench::new();
    let mut line: Vec<At> = edges(&all(), Edge::Rising);
    // The closing edge of pulse 4.
    line.remove(9);
    write_events(&bench, &line, 2);
    write_pictures(&bench, &all().into_iter().filter(|n| *n != 9).collect::<Vec<_>>());
    let (manifest, talk, code) = init(&bench, &["events.raw", "frames"], &[]);
    assert_eq!(code, 0, "{talk}");
    assert!(fill(&manifest, "trigger_line").starts_with("trigger_line = 2 # FILL: "), "{manifest}");
    assert!(fill(&manifest, "strobe").starts_with("strobe = \"active_high\""), "{manifest}");
    for note in [
        "1 falling edges of line 2 are missing",
        "were left out: 000004.png",
        "1 pulses have no picture and were left out: 6619000000 ns",
    ] {
        assert!(talk.contains(note), "{note}\n{talk}");
    }
    let seen = bench.run(&["inspect", "events.raw", "frames", "--trigger-line", "2", "--json"]);
    let seen: serde_json::Value = serde_json::from_str(&seen.stdout).unwrap();
    assert_eq!(
        (&seen["files"][0]["survey"]["frames"]["count"], &seen["files"][0]["survey"]["frames"]["gap_count"]),
        (&13.into(), &2.into())
    );
}

#[test]
fn one_edge_a_frame_leaves_exposure_and_stamp_as_questions() {
    let bench = Bench::new();
    let line: Vec<At> =
        edges(&all(), Edge::Rising).into_iter().filter(|edge| edge.1 == Edge::Rising).collect();
    write_events(&bench, &line, 0);
    write_pictures(&bench, &all());
    let (manifest, talk, code) = init(&bench, &["events.raw", "frames"], &[]);
    assert_eq!(code, 0, "{talk}");
    assert!(!manifest.contains("strobe"), "{manifest}");
    assert!(
        fill(&manifest, "exposure").contains("# FILL: ")
            && fill(&manifest, "stamp").starts_with("stamp = \"start\" # FILL: "),
        "{manifest}"
    );
}

/// As in ercanburak/EVREAL#5, where the first lines of the stamps have no picture, and halajun/VDO_SLAM#28:
/// always one stamp too many.
#[test]
fn stamps_that_are_one_too_many_are_a_question_that_the_events_answer() {
    let bench = Bench::new();
    write_events(&bench, &[], 0);
    (1..COUNT).for_each(|n| write_picture(&bench, n, n - 1));
    let mut stamps = String::from("start_us,end_us\n");
    (0..COUNT).for_each(|n| {
        writeln!(stamps, "{},{}", start_us(n) + BASE_US, start_us(n) + BASE_US + EXPOSURE_US).unwrap()
    });
    bench.write("frames/timestamps.txt", &stamps);
    let (manifest, talk, code) = init(&bench, &["events.raw", "frames"], &[]);
    assert_eq!(code, 0, "{talk}");
    assert!(fill(&manifest, "first_pulse").starts_with("first_pulse = 1 # FILL: "), "{manifest}");
    assert!(talk.contains("1 stamps have no picture and were left out: 6439000000 ns"), "{talk}");
}

#[test]
fn a_picture_that_is_cut_in_half_is_left_out_with_its_stamp() {
    let bench = Bench::new();
    write_events(&bench, &[], 0);
    write_pictures(&bench, &all());
    let mut stamps = String::from("start_us,end_us\n");
    (0..COUNT).for_each(|n| {
        writeln!(stamps, "{},{}", start_us(n) + BASE_US, start_us(n) + BASE_US + EXPOSURE_US).unwrap()
    });
    bench.write("frames/timestamps.txt", &stamps);
    let broken = bench.path("frames/000005.png");
    let whole = fs::read(&broken).unwrap();
    fs::write(&broken, &whole[..whole.len() / 2]).unwrap();
    let (_, talk, code) = init(&bench, &["events.raw", "frames"], &[]);
    assert_eq!(code, 3, "{talk}");
    assert!(talk.contains("data lost: 000005.png: the picture cannot be read: it is cut off"), "{talk}");
    let done = bench.run(&["run", "my.toml"]);
    assert_eq!(done.code, 3, "{}", done.stderr);
    assert!(done.stderr.contains("000005.png"), "{}", done.stderr);
    let found = score(&bench.path("out/my/frames"), zero_us(0));
    assert!(found > 30.0, "{found:.1} dB");
}
