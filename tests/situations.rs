//! Situations of real users, from public reports: files whose stamps, sizes or streams do not fit each other,
//! made small and held to what is right.
//!
//! One recording serves all: a bright disc crosses a striped ramp, 96 x 72 pixels, 0.3 s, 15 frames of 10 ms,
//! events of a threshold of 0.25. Its light is known, and what `init` and `run` give is scored against it.
//! [`disc`] makes it; each test makes of it what a user had.

#![allow(clippy::unwrap_used)]

use crate::disc::{self, Disc, Frames, HEIGHT, WIDTH, npz, write_pictures, write_stamps};
use crate::support::{Bench, Done};
use std::fs;
use std::sync::OnceLock;

/// What is lost against the recording as it should be, dB, at most.
const LOSS_DB: f64 = 0.5;

/// `init` with these arguments; the manifest is `my.toml`.
fn init(bench: &Bench, arguments: &[&str]) -> Done {
    let mut all = vec!["init", "-o", "my.toml"];
    all.extend(arguments);
    bench.run(&all)
}

/// The manifest and the description that `init` wrote.
fn written(bench: &Bench) -> (String, String) {
    (
        fs::read_to_string(bench.path("my.toml")).unwrap(),
        fs::read_to_string(bench.path("my.sensor.toml")).unwrap(),
    )
}

/// The line of a parameter.
fn line<'a>(manifest: &'a str, name: &str) -> &'a str {
    manifest
        .lines()
        .find(|line| line.starts_with(&format!("{name} =")))
        .unwrap_or_else(|| panic!("{name} stands in\n{manifest}"))
}

/// Runs the manifest and scores it; `zero_s`: the scene's time at the run's zero.
fn scored(bench: &Bench, zero_s: f64) -> f64 {
    let done = bench.run(&["run", "my.toml", "--to", "frames", "--quiet"]);
    assert_eq!(done.code, 0, "{}\n{}", done.stderr, written(bench).0);
    disc::score(&bench.path("out/my/frames"), zero_s)
}

/// The score of the recording with nothing wrong.
fn control_db() -> f64 {
    static CONTROL: OnceLock<f64> = OnceLock::new();
    *CONTROL.get_or_init(|| {
        let bench = Bench::new();
        usual_files(&bench);
        let done = init(&bench, &["events.npz", "frames", "--extent", "96x72", "--time-unit", "us"]);
        assert_eq!(done.code, 0, "{}", done.stderr);
        let found = scored(&bench, Disc::get().zero_s());
        assert!(found > 39.0, "{found:.2} dB");
        found
    })
}

/// As good as the recording that has nothing wrong, within [`LOSS_DB`].
fn is_right(bench: &Bench) {
    let (found, sound) = (scored(bench, Disc::get().zero_s()), control_db());
    assert!(found > sound - LOSS_DB, "{found:.2} dB, {sound:.2} dB with nothing wrong\n{}", written(bench).0);
}

/// The usual files: npz of events, and a folder of pictures with start and end of every exposure in
/// microseconds.
fn usual_files(bench: &Bench) {
    let disc = Disc::get();
    npz(&bench.path("events.npz"), &disc.events);
    write_pictures(&bench.path("frames"), &disc.frames.pictures);
    write_stamps(
        &bench.path("frames/timestamps.txt"),
        disc.frames.starts_us.iter().map(|start| format!("{start} {}", start + disc::EXPOSURE_US)),
    );
}

const EXTENT: [&str; 2] = ["--extent", "96x72"];

/// Simulators and text exports state no size of the array, and a dark border fires no event:
/// SensorsINI/v2e#29, uzh-rpg/timelens-pp#4.
#[test]
fn events_that_do_not_reach_the_last_rows_take_the_size_of_the_frames() {
    let bench = Bench::new();
    usual_files(&bench);
    let done = init(&bench, &["events.npz", "frames"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let (manifest, _) = written(&bench);
    let extent = line(&manifest, "extent");
    assert!(
        extent.starts_with("extent = { width = 96, height = 72 } # FILL: ")
            && extent.contains("column 95 and row 63"),
        "{extent}"
    );
    is_right(&bench);
    // Without `init` the size is not guessed either.
    let bare = manifest.lines().filter(|line| !line.starts_with("extent =")).collect::<Vec<_>>().join("\n");
    bench.write("bare.toml", &bare);
    let done = bench.run(&["run", "bare.toml"]);
    assert!(
        done.code == 2 && done.stderr.contains("extent = { width = 96, height = 72 }"),
        "{}",
        done.stderr
    );
}

/// The same in text, where the largest coordinates by chance divide the frames' size: a quarter of the array
/// fires.
#[test]
fn a_size_that_fits_by_chance_is_marked() {
    let bench = Bench::new();
    let disc = Disc::get();
    let quarter: Vec<_> = disc.events.iter().filter(|event| event.x < 48 && event.y < 36).copied().collect();
    npz(&bench.path("events.npz"), &quarter);
    write_pictures(&bench.path("frames"), &disc.frames.pictures);
    write_stamps(
        &bench.path("frames/timestamps.txt"),
        disc.frames.starts_us.iter().map(|start| format!("{start} {}", start + disc::EXPOSURE_US)),
    );
    let done = init(&bench, &["events.npz", "frames", "--time-unit", "us"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert!(line(&written(&bench).0, "extent").contains("# FILL: "), "{}", written(&bench).0);
}

/// A camera that was paused for an hour between two frames, a clock that was set meanwhile
/// (pupil-labs/pupil#1449): work grows with events and frames, not with the span.
#[test]
fn a_pause_of_an_hour_costs_no_memory_and_one_part_is_rendered() {
    let disc = Disc::get();
    let bench = Bench::new();
    let pause_us = 3_600_000_000;
    let later = |t: i64| if t >= 150_000 { t + pause_us } else { t };
    let mut events = disc.events.clone();
    events.iter_mut().for_each(|event| event.t_us = later(event.t_us));
    npz(&bench.path("events.npz"), &events);
    write_pictures(&bench.path("frames"), &disc.frames.pictures);
    write_stamps(
        &bench.path("frames/timestamps.txt"),
        disc.frames
            .starts_us
            .iter()
            .map(|start| format!("{} {}", later(*start), later(*start) + disc::EXPOSURE_US)),
    );
    let done = bench.run_within(
        1 << 30,
        &["init", "-o", "my.toml", "events.npz", "frames", EXTENT[0], EXTENT[1], "--time-unit", "us"],
    );
    assert_eq!(done.code, 0, "{}", done.stderr);
    let (manifest, _) = written(&bench);
    assert!(line(&manifest, "start").contains("frames pause for up to 3600"), "{manifest}");
    let done = bench.run_within(2 << 30, &["run", "my.toml", "--to", "frames", "--quiet"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let found = disc::score(&bench.path("out/my/frames"), disc.zero_s());
    assert!(found > control_db() - 1.0, "{found:.2} dB, {:.2} dB with nothing wrong", control_db());
    // Without the window the plan refuses, and names it.
    let whole = manifest
        .lines()
        .filter(|line| !line.starts_with("start =") && !line.starts_with("end ="))
        .collect::<Vec<_>>()
        .join("\n");
    bench.write("whole.toml", &whole);
    let done = bench.run_within(1 << 30, &["plan", "whole.toml"]);
    assert!(
        done.code == 2
            && done.stderr.contains("has frames near")
            && done.stderr.contains("start = \"0.000576 s\", end = "),
        "{} {}",
        done.code,
        done.stderr
    );
}

/// Events of a simulator in nanoseconds, its stamps of frames in seconds: uzh-rpg/rpg_esim#70.
#[test]
fn events_in_nanoseconds_and_stamps_in_seconds_are_distinguished() {
    let disc = Disc::get();
    let bench = Bench::new();
    let mut events = disc.events.clone();
    events.iter_mut().for_each(|event| event.t_us *= 1000);
    npz(&bench.path("events.npz"), &events);
    write_pictures(&bench.path("frames"), &disc.frames.pictures);
    write_stamps(
        &bench.path("frames/timestamps.txt"),
        disc.frames.starts_us.iter().map(|start| format!("{:.6}", *start as f64 * 1e-6)),
    );
    let known = ["--exposure", "10 ms", "--stamp", "start"];
    let done = init(&bench, &[&["events.npz", "frames", EXTENT[0], EXTENT[1]][..], &known].concat());
    assert_eq!(done.code, 0, "{}", done.stderr);
    let (manifest, _) = written(&bench);
    assert!(line(&manifest, "time_unit").starts_with("time_unit = \"ns\" # FILL: "), "{manifest}");
    assert!(line(&manifest, "stamps_unit").starts_with("stamps_unit = \"s\" # FILL: "), "{manifest}");
    is_right(&bench);
    // One unit for both would make one stamp of all: refused with the parameter that is missing.
    bench.write(
        "one.toml",
        &manifest.lines().filter(|line| !line.starts_with("stamps_unit =")).collect::<Vec<_>>().join("\n"),
    );
    let done = bench.run(&["run", "one.toml"]);
    assert!(done.code == 2 && done.stderr.contains("stamps_unit = \"s\""), "{}", done.stderr);
    // With a stated unit of the events the other is proposed.
    let done = bench.run(
        &[
            &["init", "-o", "stated.toml", "events.npz", "frames", EXTENT[0], EXTENT[1], "--time-unit", "ns"]
                [..],
            &known,
        ]
        .concat(),
    );
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert!(
        line(&fs::read_to_string(bench.path("stated.toml")).unwrap(), "stamps_unit")
            .starts_with("stamps_unit = \"s\"")
    );
}

/// The first events have a clock of their own: open-neuromorphic/expelliarmus#6 (some forty stamps below 50,
/// then above 3e9).
#[test]
fn leftover_events_decide_no_unit_and_are_left_out() {
    let disc = Disc::get();
    let bench = Bench::new();
    usual_files(&bench);
    let mut events = disc.events.clone();
    events[..150].iter_mut().for_each(|event| event.t_us += 1_702_309_120);
    npz(&bench.path("events.npz"), &events);
    let done = init(&bench, &["events.npz", "frames", EXTENT[0], EXTENT[1]]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let (manifest, _) = written(&bench);
    assert!(line(&manifest, "time_unit").starts_with("time_unit = \"us\" # FILL: "), "{manifest}");
    assert!(
        line(&manifest, "end").len() > 4 && line(&manifest, "start").contains("150 of 1844"),
        "{manifest}"
    );
    // The first exposure begins before the first event that is left.
    let zero_s = disc.frames.starts_us[0] as f64 * 1e-6;
    let found = scored(&bench, zero_s);
    // As good as a recording that never had those events, one in twelve.
    let without = Bench::new();
    usual_files(&without);
    npz(&without.path("events.npz"), &disc.events[150..]);
    let done = init(&without, &["events.npz", "frames", EXTENT[0], EXTENT[1], "--time-unit", "us"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let expected = scored(&without, zero_s);
    assert!(found > expected - 0.1, "{found:.2} dB, {expected:.2} dB without them");
    assert!(expected > control_db() - 2.0 * LOSS_DB, "{expected:.2} dB");
}

/// Pictures that were saved the other way round than the events: uzh-rpg/DSEC#25 asks for the transformation
/// that fits the two.
#[test]
fn a_mirrored_picture_is_a_question_with_its_parameter() {
    let disc = Disc::get();
    let bench = Bench::new();
    usual_files(&bench);
    let mut events = disc.events.clone();
    events.iter_mut().for_each(|event| event.x = WIDTH as u16 - 1 - event.x);
    npz(&bench.path("events.npz"), &events);
    let done = init(&bench, &["events.npz", "frames", EXTENT[0], EXTENT[1]]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let (manifest, _) = written(&bench);
    assert!(line(&manifest, "mirror").starts_with("mirror = \"left_right\" # FILL: "), "{manifest}");
    is_right(&bench);
}

/// Events of a part of the array that was cropped elsewhere than the frames: 82magnolia/n_imagenet#6,
/// uzh-rpg/rpg_timelens#28.
#[test]
fn a_shift_by_whole_pixels_is_a_question_with_its_parameter_and_no_clock_offset() {
    let disc = Disc::get();
    let bench = Bench::new();
    usual_files(&bench);
    let moved: Vec<_> = disc
        .events
        .iter()
        .filter(|event| event.x >= 3 && event.y + 2 < HEIGHT as u16)
        .map(|event| disc::Event { x: event.x - 3, y: event.y + 2, ..*event })
        .collect();
    npz(&bench.path("events.npz"), &moved);
    let done = init(&bench, &["events.npz", "frames", EXTENT[0], EXTENT[1]]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let (manifest, sensor) = written(&bench);
    assert!(line(&manifest, "shift").starts_with("shift = { right = -3, down = 2 } # FILL: "), "{manifest}");
    assert!(!sensor.contains("clock_offset"), "{sensor}");
    // Three columns and two rows have no events; with an offset in place of the shift it has some 12 dB less.
    let found = scored(&bench, moved[0].t_us as f64 * 1e-6);
    assert!(found > control_db() - 4.0, "{found:.2} dB");
}

/// Events twice make twice the contrast: prophesee-ai/prophesee-automotive-dataset-toolbox#44 (14 % of the
/// events of GEN1).
#[test]
fn events_that_are_there_twice_are_read_once() {
    let disc = Disc::get();
    let bench = Bench::new();
    usual_files(&bench);
    let mut events: Vec<_> = disc.events.iter().flat_map(|event| [*event, *event]).collect();
    events.sort_by_key(|event| event.t_us);
    npz(&bench.path("events.npz"), &events);
    let done = init(&bench, &["events.npz", "frames", EXTENT[0], EXTENT[1]]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert!(
        line(&written(&bench).0, "drop_duplicates").starts_with("drop_duplicates = true #"),
        "{}",
        written(&bench).0
    );
    is_right(&bench);
}

/// A picture that a recorder wrote twice: SensorsINI/v2e#60, anqixu/ueye_cam#37.
#[test]
fn repeated_frames_are_left_out() {
    let disc = Disc::get();
    let bench = Bench::new();
    usual_files(&bench);
    let mut frames =
        Frames { starts_us: disc.frames.starts_us.clone(), pictures: disc.frames.pictures.clone() };
    // The sixth picture was not new, and was stamped all the same.
    frames.pictures[6] = frames.pictures[5].clone();
    write_pictures(&bench.path("frames"), &frames.pictures);
    let done = init(&bench, &["events.npz", "frames", EXTENT[0], EXTENT[1]]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert!(
        line(&written(&bench).0, "skip_frames").starts_with("skip_frames = [6] #"),
        "{}",
        written(&bench).0
    );
    let found = scored(&bench, disc.zero_s());
    assert!(found > control_db() - 1.5, "{found:.2} dB, {:.2} dB with nothing wrong", control_db());
}

/// The column of polarity is constant, or one sign was switched off: idsc-frazzoli/retina#177 counts how far
/// the two drift apart.
#[test]
fn one_polarity_is_refused_unless_it_is_accepted() {
    let disc = Disc::get();
    let bench = Bench::new();
    usual_files(&bench);
    let mut events = disc.events.clone();
    events.iter_mut().for_each(|event| event.is_on = true);
    npz(&bench.path("events.npz"), &events);
    let done = init(&bench, &["events.npz", "frames", EXTENT[0], EXTENT[1]]);
    assert!(
        done.code == 2
            && done.stderr.contains("one_polarity")
            && done.stderr.contains("--accept one_polarity"),
        "{}",
        done.stderr
    );
    let done = init(&bench, &["events.npz", "frames", EXTENT[0], EXTENT[1], "--accept", "one_polarity"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert!(
        written(&bench).0.lines().any(|line| line.starts_with("# FILL: one_polarity: ")),
        "{}",
        written(&bench).0
    );
}

/// ON means darker: robotology/event-driven#165.
#[test]
fn exchanged_polarity_is_a_question_with_its_parameter() {
    let disc = Disc::get();
    let bench = Bench::new();
    usual_files(&bench);
    let mut events = disc.events.clone();
    events.iter_mut().for_each(|event| event.is_on = !event.is_on);
    npz(&bench.path("events.npz"), &events);
    let done = init(&bench, &["events.npz", "frames", EXTENT[0], EXTENT[1]]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert!(
        line(&written(&bench).0, "invert_polarity").starts_with("invert_polarity = true # FILL: "),
        "{}",
        written(&bench).0
    );
    is_right(&bench);
}

/// Single events far outside of the array: eventbasedvision/eTraM#12 (row 33014 of 720),
/// prophesee-ai/prophesee-automotive-dataset-toolbox#36 (column 1308 of 1280).
#[test]
fn single_events_far_outside_decide_no_size() {
    let disc = Disc::get();
    let bench = Bench::new();
    usual_files(&bench);
    let mut events = disc.events.clone();
    (events[500].y, events[900].x) = (33_014, 1_308);
    npz(&bench.path("events.npz"), &events);
    let done = init(&bench, &["events.npz", "frames"]);
    // Two events are lost, which the exit code states.
    assert_eq!(done.code, 3, "{}", done.stderr);
    let (manifest, _) = written(&bench);
    let extent = line(&manifest, "extent");
    assert!(
        extent.starts_with("extent = { width = 96, height = 72 } # FILL: ") && extent.contains("2 of 1844"),
        "{extent}"
    );
    let done = bench.run(&["run", "my.toml", "--to", "frames", "--quiet"]);
    assert_eq!(done.code, 3, "{}", done.stderr);
    let found = disc::score(&bench.path("out/my/frames"), disc.zero_s());
    assert!(found > control_db() - LOSS_DB, "{found:.2} dB");
}

/// Columns and rows in the other order: SensorsINI/v2e#37.
#[test]
fn exchanged_columns_and_rows_are_refused_with_the_option() {
    let disc = Disc::get();
    let bench = Bench::new();
    usual_files(&bench);
    let text: String = disc
        .events
        .iter()
        .map(|event| format!("{} {} {} {}\n", event.t_us, event.y, event.x, u8::from(event.is_on)))
        .collect();
    bench.write("events.txt", &text);
    let done = init(&bench, &["events.txt", "frames", "--columns", "t,x,y,p"]);
    assert!(
        done.code == 2 && done.stderr.contains("swapped") && done.stderr.contains("--columns"),
        "{}",
        done.stderr
    );
    let done = init(&bench, &["events.txt", "frames", "--columns", "t,y,x,p"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    is_right(&bench);
}

/// Events of 1280 x 720 pixels with frames of 960 x 640: intelpro/CMTA#2.
#[test]
fn sizes_that_do_not_fit_are_refused_with_both() {
    let disc = Disc::get();
    let bench = Bench::new();
    usual_files(&bench);
    let events: Vec<_> = disc
        .events
        .iter()
        .map(|event| disc::Event { x: event.x * 4 / 3, y: event.y * 9 / 8, ..*event })
        .collect();
    npz(&bench.path("events.npz"), &events);
    let done = init(&bench, &["events.npz", "frames", "--extent", "128x81"]);
    assert!(
        done.code == 2 && done.stderr.contains("128 x 81") && done.stderr.contains("96 x 72"),
        "{}",
        done.stderr
    );
}

/// A simulator's recording in the layout of the Event Camera Dataset, with pictures of twice the size:
/// uzh-rpg/rpg_esim writes it so where the camera that renders is finer. The cameras of the published
/// sequences are known, those of a simulator are not.
#[test]
fn frames_finer_than_the_events_in_a_layout_that_takes_their_size_are_a_question() {
    let disc = Disc::get();
    let bench = Bench::new();
    let finer = |values: &Vec<u8>| {
        (0..4 * WIDTH * HEIGHT)
            .map(|i| values[i / (2 * WIDTH) / 2 * WIDTH + i % (2 * WIDTH) / 2])
            .collect::<Vec<u8>>()
    };
    write_pictures(&bench.path("clip/images"), &disc.frames.pictures.iter().map(finer).collect::<Vec<_>>());
    let seconds = |t_us: i64| format!("{}.{:06}", t_us / 1_000_000, t_us % 1_000_000);
    let events: String = disc
        .events
        .iter()
        .map(|event| format!("{} {} {} {}\n", seconds(event.t_us), event.x, event.y, u8::from(event.is_on)))
        .collect();
    bench.write("clip/events.txt", &events);
    let list = disc
        .frames
        .starts_us
        .iter()
        .enumerate()
        .map(|(l, start)| format!("{} images/{l:06}.png\n", seconds(*start)))
        .collect::<String>();
    bench.write("clip/images.txt", &list);
    let done = init(&bench, &["clip", "--exposure", "10 ms", "--stamp", "start"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let (manifest, _) = written(&bench);
    let extent = line(&manifest, "extent");
    assert!(
        extent.starts_with("extent = { width = 96, height = 72 } # FILL: ")
            && extent.contains("an array of 96 x 72 explains"),
        "{extent}"
    );
    assert!(line(&manifest, "transfer").starts_with("transfer = \"srgb\" # FILL: "), "{manifest}");
    is_right(&bench);
}

/// A sequence of DSEC whose first stamp is missing: fifteen pictures and fourteen stamps, one of a period
/// between all of them. The events show which end misses it.
#[test]
fn a_first_stamp_that_is_missing_is_found_by_the_events_in_a_folder_too() {
    let disc = Disc::get();
    let bench = Bench::new();
    let rows: String = disc
        .events
        .iter()
        .map(|event| format!("{},{},{},{}\n", event.t_us, event.x, event.y, u8::from(event.is_on)))
        .collect();
    bench.write(
        "events.csv",
        &format!("# photocurrent-events/1 time_unit=us width={WIDTH} height={HEIGHT}\nt,x,y,p\n{rows}"),
    );
    fs::create_dir_all(bench.path("clip/events/left")).unwrap();
    let done = bench.run(&["convert", "events.csv", "clip/events/left/events.h5", "--to", "dsec"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    write_pictures(&bench.path("clip/images/left/rectified"), &disc.frames.pictures);
    let stamps =
        disc.frames.starts_us[1..].iter().map(|start| format!("{start}, {}", start + disc::EXPOSURE_US));
    write_stamps(&bench.path("clip/images/left/exposure_timestamps_left.txt"), stamps);
    let done = init(&bench, &["clip"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let manifest = written(&bench).0;
    let first = line(&manifest, "first_pulse");
    assert!(
        first.starts_with("first_pulse = -1 # FILL: ") && first.contains("in the second half"),
        "{first}"
    );
    let found = scored(&bench, disc.zero_s());
    assert!(found > control_db() - 1.5, "{found:.2} dB, {:.2} dB with nothing wrong", control_db());
    // Without `init` the reader refuses, and names both.
    let bare =
        manifest.lines().filter(|line| !line.starts_with("first_pulse =")).collect::<Vec<_>>().join("\n");
    bench.write("bare.toml", &bare);
    let done = bench.run(&["run", "bare.toml"]);
    assert!(
        done.code == 2
            && done.stderr.contains("`first_pulse = -1`")
            && done.stderr.contains("`first_pulse = 0`"),
        "{}",
        done.stderr
    );
}

/// Frames of 5 electrons a step of 8 bits and 2 steps of read noise, as dim light gives them: readings are
/// decided as on clean frames.
#[test]
fn readings_hold_on_noisy_frames() {
    let disc = Disc::get();
    let mut state = 5u64;
    // Sum of twelve even numbers: nearly normal, with a variance of 1.
    let mut normal = || {
        let mut even = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        (0..12).map(|_| even()).sum::<f64>() - 6.0
    };
    let mut noisy = |value: u8| {
        (f64::from(value) + normal() * (f64::from(value) / 5.0 + 4.0).sqrt()).round().clamp(0.0, 255.0) as u8
    };
    let pictures: Vec<Vec<u8>> = disc
        .frames
        .pictures
        .iter()
        .map(|values| values.iter().map(|value| noisy(*value)).collect())
        .collect();
    let lines = |change: &dyn Fn(&disc::Event) -> disc::Event, skipped: usize| {
        let bench = Bench::new();
        npz(&bench.path("events.npz"), &disc.events.iter().map(change).collect::<Vec<_>>());
        write_pictures(&bench.path("frames"), &pictures);
        let stamps = disc.frames.starts_us[skipped..]
            .iter()
            .map(|start| format!("{start} {}", start + disc::EXPOSURE_US));
        write_stamps(&bench.path("frames/timestamps.txt"), stamps);
        let done = init(&bench, &["events.npz", "frames", EXTENT[0], EXTENT[1]]);
        assert_eq!(done.code, 0, "{}", done.stderr);
        let (manifest, sensor) = written(&bench);
        let is_reading = |line: &&str| {
            ["mirror", "shift", "invert_polarity", "first_pulse", "clock_offset"]
                .iter()
                .any(|name| line.starts_with(name))
        };
        manifest
            .lines()
            .chain(sensor.lines())
            .filter(is_reading)
            .map(|line| line.split(" #").next().unwrap().to_owned())
            .collect::<Vec<_>>()
    };
    assert_eq!(lines(&|event| *event, 0), [""; 0]);
    assert_eq!(
        lines(&|event| disc::Event { x: WIDTH as u16 - 1 - event.x, ..*event }, 0),
        ["mirror = \"left_right\""]
    );
    assert_eq!(lines(&|event| disc::Event { is_on: !event.is_on, ..*event }, 0), ["invert_polarity = true"]);
    assert_eq!(lines(&|event| *event, 1), ["first_pulse = -1"]);
}
