//! Changed files of every format: none may panic, loop, or break what readers promise. The long run is
//! `cargo run --release --example fuzz`.
#![allow(clippy::unwrap_used)]

mod common;

use common::{Random, Seed, mutate, read, seeds};
use photocurrent_formats::{FORMATS, catalog};

/// Changed copies of every seed: HDF5 files are slower to open than all others together.
fn copies(seed: &Seed) -> usize {
    if seed.files[0].0.ends_with(".h5") { 8 } else { 60 }
}

#[test]
fn every_format_has_a_seed_that_is_read_whole() {
    let seeds = seeds::all();
    for format in FORMATS {
        let of: Vec<&Seed> = seeds.iter().filter(|seed| seed.format == format.id).collect();
        assert!(!of.is_empty(), "{} has no seed", format.id);
        // Our own recordings are made from a file of another kind, which is refused.
        for seed in of.iter().filter(|seed| seed.format != "recording") {
            let folder = tempfile::tempdir().unwrap();
            let path = seed.write(folder.path(), None);
            let outcome = read(&path, format, &seed.declared);
            assert!(
                outcome.opened,
                "{}: {}",
                seed.format,
                (format.open)(&path, &seed.declared).err().unwrap()
            );
            assert!(
                outcome.events >= 40 || outcome.pictures >= 2,
                "{} {}: {outcome:?}",
                seed.format,
                seed.files[0].0
            );
        }
    }
}

#[test]
fn changed_files_of_every_format_are_survived() {
    let mut random = Random::new(22);
    for seed in seeds::all() {
        let format = catalog::named(seed.format).unwrap();
        for _ in 0..copies(&seed) {
            let folder = tempfile::tempdir().unwrap();
            let changed = mutate(&seed, &mut random);
            let path = changed.write(folder.path(), None);
            read(&path, format, &changed.declared);
        }
    }
}
