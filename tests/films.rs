//! Films and photos as light, through the command: which change of the pictures runs what again, and that
//! bands and threads are no part of a result.

use crate::support::{Bench, digests, executed, root};
use std::path::Path;

const SIZE: (u32, u32) = (16, 12);

/// A grey picture of 8 bits, brighter to the right, moved by `shift` pixels.
fn picture(path: &Path, shift: u32) {
    let file = std::fs::File::create(path).expect("a picture");
    let mut encoder = png::Encoder::new(file, SIZE.0, SIZE.1);
    encoder.set_color(png::ColorType::Grayscale);
    let values: Vec<u8> = (0..SIZE.1)
        .flat_map(|y| (0..SIZE.0).map(move |x| (60 + 5 * ((x + shift) % 24) + 4 * y) as u8))
        .collect();
    encoder.write_header().and_then(|mut writer| writer.write_image_data(&values)).expect("its pixels");
}

/// A film of 25 pictures and a photo, each seen by a sensor.
fn bench() -> Bench {
    let bench = Bench::new();
    let sensor = root().join("data/sensors/hybrid.toml");
    bench.write(
        "m.toml",
        &format!(
            r#"format = 1
[nodes.sensor]
kind = "read/sensor"
params = {{ path = {sensor:?} }}
[nodes.film]
kind = "simulate/video"
in = {{ sensor = "sensor" }}
params = {{ path = "frames", rate = "1 kHz" }}
[nodes.seen]
kind = "simulate/sensor"
in = {{ light = "film.light", sensor = "sensor" }}
[nodes.photo]
kind = "simulate/photo"
in = {{ sensor = "sensor" }}
params = {{ path = "photo.png", width = 12, height = 10, duration = "20 ms", speed = 300.0, rotation = "60 rpm", truth_rate = "10 kHz" }}
[nodes.snapped]
kind = "simulate/sensor"
in = {{ light = "photo.light", sensor = "sensor" }}
"#
        ),
    );
    std::fs::create_dir(bench.path("frames")).expect("a folder");
    (0..25).for_each(|k| picture(&bench.path(&format!("frames/f{k}.png")), k));
    picture(&bench.path("photo.png"), 0);
    bench
}

#[test]
fn a_changed_a_new_or_a_moved_picture_runs_its_film_again_and_another_name_does_not() {
    let bench = bench();
    let run = || executed(&bench.outcome(&["m.toml"]));
    assert_eq!(run(), ["film", "photo", "seen", "sensor", "snapped"]);
    assert_eq!(run(), [""; 0]);
    picture(&bench.path("frames/f7.png"), 20);
    assert_eq!(run(), ["film", "seen"]);
    picture(&bench.path("frames/f25.png"), 3);
    assert_eq!(run(), ["film", "seen"]);
    // The same pictures in another order: f10 stands between f9 and f11, not after f1.
    std::fs::rename(bench.path("frames/f10.png"), bench.path("frames/f26.png")).expect("a rename");
    assert_eq!(run(), ["film", "seen"]);
    // Another name in the same place, and a file that is no picture.
    std::fs::rename(bench.path("frames/f26.png"), bench.path("frames/f30.png")).expect("a rename");
    bench.write("frames/notes.txt", "taken on a rainy day");
    assert_eq!(run(), [""; 0]);
    picture(&bench.path("photo.png"), 5);
    assert_eq!(run(), ["photo", "snapped"]);
}

#[test]
fn light_from_pictures_does_not_depend_on_threads_or_the_height_of_bands() {
    let run = |how: &[&str]| {
        let outcome = bench().outcome(&[&["m.toml"], how].concat());
        assert_eq!(executed(&outcome).len(), 5, "a result from a cache would prove nothing");
        digests(&outcome)
    };
    let expected = run(&["--threads", "1"]);
    assert!(
        expected.contains_key("seen.events") && expected.contains_key("snapped.events"),
        "{:?}",
        expected.keys()
    );
    for rows in ["1", "5"] {
        assert_eq!(run(&["--threads", "2", "--band-rows", rows]), expected, "bands of {rows} rows");
    }
}
