//! Files that are no recordings, and recordings with unusual conventions, as a user meets them: `inspect`,
//! `init`, `check`, `run` and `diagnose`.

use crate::support::Bench;
use std::fmt::Write as _;
use std::path::Path;

/// What is downloaded or exported in place of a recording: name, bytes, the message, what to do.
fn strangers() -> Vec<(&'static str, Vec<u8>, &'static str, &'static str)> {
    let pointer = format!(
        "version https://git-lfs.github.com/spec/v1\noid sha256:{}\nsize 123456789\n",
        "0123456789abcdef".repeat(4)
    )
    .into_bytes();
    let mut words = Vec::new();
    for k in 0..400_u16 {
        words.extend([
            0x8000 | (0x200 + k / 100),
            0x6000 | (k * 9 % 0xfff),
            k % 72,
            0x2000 | (k % 2) << 11 | (k % 96),
        ]);
    }
    vec![
        ("pointer.h5", pointer.clone(), "a Git LFS pointer to a file of 123456789 bytes", "git lfs pull"),
        ("events.txt", pointer, "a Git LFS pointer", "git lfs pull"),
        (
            "page.raw",
            b"<!DOCTYPE html><html><head><title>Sign in</title></head></html>\n".to_vec(),
            "a web page (`Sign in`)",
            "download again",
        ),
        ("empty.raw", Vec::new(), "an empty file (0 bytes)", "fetch the file again"),
        ("events.pkl", b"\x80\x04\x95\x10\0\0\0\0\0\0\0".to_vec(), "pickled Python objects", "numpy.savez"),
        ("film.mp4", b"\0\0\0\x20ftypisom\0\0\x02\0isomiso2".to_vec(), "a film", "ffmpeg"),
        (
            "headless.raw",
            words.iter().flat_map(|word: &u16| word.to_le_bytes()).collect(),
            "looks like EVT3 words",
            "printf",
        ),
    ]
}

#[test]
fn every_command_says_what_a_file_is_instead_of_a_recording() {
    let bench = Bench::new();
    for (name, bytes, what, todo) in strangers() {
        std::fs::write(bench.path(name), bytes).expect("a file");
        let manifest = format!(
            "format = 1\n[nodes.r]\nkind = \"read/npz\"\nparams = {{ path = {name:?}, time_unit = \"us\" }}\n"
        );
        bench.write("m.toml", &manifest);
        for command in [
            &["inspect", name][..],
            &["init", name, "-o", "my.toml"],
            &["check", name],
            &["run", "m.toml"],
            &["diagnose", name],
        ] {
            let done = bench.run(command);
            assert!(done.code > 0, "{command:?} of {name}: {}", done.stderr);
            assert!(
                done.stderr.contains(what) && done.stderr.contains(todo),
                "{command:?} of {name}: {}",
                done.stderr
            );
        }
        assert!(!bench.path("my.toml").exists(), "{name}: nothing is written");
    }
}

/// 4,000 events of 20 x 10 pixels, one every 10 us, as text with one polarity code or another; six frames.
fn recording(bench: &Bench, name: &str, polarity: impl Fn(usize) -> i64, origin: usize) {
    let mut text = "# t_us x y p\n".to_string();
    for k in 0..4000 {
        let _ = writeln!(text, "{} {} {} {}", 10 * k, k % 20 + origin, k / 7 % 10 + origin, polarity(k));
    }
    bench.write(name, &text);
}

fn pictures(folder: &Path) {
    std::fs::create_dir_all(folder).expect("a folder");
    for k in 0..6_u8 {
        let file = std::fs::File::create(folder.join(format!("00000{k}.png"))).expect("a file");
        let mut encoder = png::Encoder::new(file, 20, 10);
        encoder.set_color(png::ColorType::Grayscale);
        let values: Vec<u8> = (0..200_u8).map(|v| v / 2 + 10 * k).collect();
        encoder.write_header().expect("a header").write_image_data(&values).expect("a picture");
    }
    let stamps: String = (0..6).map(|k| format!("{} {}\n", 1000 + 6000 * k, 3000 + 6000 * k)).collect();
    std::fs::write(folder.join("timestamps.txt"), stamps).expect("a file");
}

/// better-flow/evimo#20: polarities 0, 1, 2, 3 and so on.
#[test]
fn polarity_as_counts_is_read_whole_and_said_by_every_command() {
    let bench = Bench::new();
    recording(&bench, "plain.txt", |k| i64::from(k % 3 > 0), 0);
    recording(&bench, "counts.txt", |k| if k % 3 > 0 { 1 + (k % 5) as i64 } else { 0 }, 0);
    let said = "polarity holds counts 0 to 5: every value above 0 was read as ON";
    let seen = bench.run(&["inspect", "counts.txt", "--extent", "20x10"]);
    assert_eq!(seen.code, 0, "{}{}", seen.stdout, seen.stderr);
    assert!(
        seen.stdout.contains(said)
            && seen.stdout.contains("polarity_counts")
            && !seen.stdout.contains("copy the file"),
        "{}",
        seen.stdout
    );
    for name in ["plain", "counts"] {
        let done =
            bench.run(&["convert", &format!("{name}.txt"), &format!("{name}.csv"), "--extent", "20x10"]);
        assert_eq!(done.code, 0, "{}", done.stderr);
    }
    let text = |name: &str| std::fs::read_to_string(bench.path(name)).expect("a file");
    assert_eq!(text("plain.csv"), text("counts.csv"));
    pictures(&bench.path("frames"));
    let done = bench.run(&["init", "counts.txt", "frames", "--extent", "20x10", "-o", "my.toml"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert!(done.stderr.contains(said), "{}", done.stderr);
    // What is read as signs is left out, and the advice is no copy.
    let seen = bench.run(&["inspect", "counts.txt", "--extent", "20x10", "--polarity", "signs"]);
    assert!(
        seen.code == 3 && seen.stdout.contains("odd_polarity") && seen.stdout.contains("state `polarity`"),
        "{}",
        seen.stdout
    );
    assert!(
        !seen.stdout.contains("copy the file") && seen.stdout.contains("2133 places in all"),
        "{}",
        seen.stdout
    );
}

#[test]
fn odd_polarity_is_refused_by_its_option() {
    let bench = Bench::new();
    recording(&bench, "odd.txt", |k| [0, 1, 7, 30][k % 4], 0);
    for command in [&["inspect", "odd.txt"][..], &["init", "odd.txt", "-o", "my.toml"], &["check", "odd.txt"]]
    {
        let done = bench.run(command);
        assert_eq!(done.code, 2, "{command:?}: {}", done.stderr);
        assert!(
            done.stderr.contains("polarity takes the values 0, 1, 7, 30; 50 % of the events")
                && done.stderr.contains("--polarity"),
            "{}",
            done.stderr
        );
    }
}

/// Frames of 20 x 10 pixels show that coordinates of 1 to 20 and 1 to 10 begin at 1.
#[test]
fn coordinates_from_one_are_recognised_by_the_frames_or_stated() {
    let bench = Bench::new();
    recording(&bench, "one.txt", |k| (k % 2) as i64, 1);
    pictures(&bench.path("frames"));
    let seen = bench.run(&["inspect", "one.txt", "frames", "--stamps-unit", "us"]);
    assert!(
        seen.stdout.contains("coordinates begin at 1: 1 was subtracted"),
        "{}{}",
        seen.stdout,
        seen.stderr
    );
    let alone = bench.run(&["inspect", "one.txt"]);
    assert!(
        alone.stdout.contains("state `origin = 1`") && alone.stdout.contains("columns 1 to 20"),
        "{}",
        alone.stdout
    );
    let stated = bench.run(&["inspect", "one.txt", "--origin", "1"]);
    assert!(stated.stdout.contains("columns 0 to 19, rows 0 to 9"), "{}", stated.stdout);
    assert_eq!(bench.run(&["inspect", "one.txt", "--origin", "2"]).code, 2);
}

#[test]
fn frames_and_stamps_that_are_recordings_are_named() {
    let bench = Bench::new();
    recording(&bench, "events.txt", |k| (k % 2) as i64, 0);
    let done = bench.run(&["convert", "events.txt", "own.h5", "--extent", "20x10"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    pictures(&bench.path("frames"));
    let of = |arguments: &[&str]| {
        let done = bench.run(&[&["inspect", "events.txt"][..], arguments].concat());
        assert!(done.code > 0, "{arguments:?}: {}", done.stdout);
        done.stderr
    };
    let said = of(&["--frames", "own.h5"]);
    assert!(
        said.contains("own.h5")
            && said.contains("a recording (photocurrent recording)")
            && said.contains("a folder of PNG or TIFF pictures"),
        "{said}"
    );
    let said = of(&["--frames", "frames", "--stamps", "own.h5"]);
    assert!(
        said.contains("a recording (photocurrent recording)") && said.contains("`stamps` takes a text file"),
        "{said}"
    );
    let said = of(&["--frames", "frames", "--stamps", "frames"]);
    assert!(said.contains("this is a folder"), "{said}");
    // A text that is neither events nor stamps is none.
    bench.write("notes.txt", "Dear reader,\nthis is prose.\nIt goes on.\n");
    let done = bench.run(&["init", "events.txt", "frames", "notes.txt", "-o", "my.toml"]);
    assert!(done.code == 2 && done.stderr.contains("notes.txt"), "{}", done.stderr);
}

/// Three tenths of a second of events, and forty of them half an hour later: their counts are true to the
/// event.
#[test]
fn strays_are_counted_one_by_one() {
    let bench = Bench::new();
    let mut text = "t_us,x,y,p\n".to_string();
    for k in 0..4000_i64 {
        let stray = if k < 40 { 1_702_309_120 } else { 0 };
        let _ = writeln!(text, "{},{},{},{}", 75 * k + stray, k % 20, k / 7 % 10, k % 2);
    }
    bench.write("strays.csv", &text);
    let seen = bench.run(&["inspect", "strays.csv", "--extent", "20x10"]);
    assert!(
        seen.stdout.contains("3960 of 4000 events lie in 0.02 % of a span of 1702.309045 s; 40 lie beyond"),
        "{}",
        seen.stdout
    );
}
