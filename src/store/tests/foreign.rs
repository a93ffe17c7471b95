//! Files of other programs: `data/formats/filters.h5` was written by h5py and hdf5plugin (see the script next
//! to it), so every number here comes from outside the code under test.
#![allow(clippy::unwrap_used)]

use photocurrent_store::foreign::{ForeignFile, Number, Value};
use std::path::{Path, PathBuf};

fn fixture() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/formats/filters.h5")
}

/// The formula of the script.
fn number(i: i64) -> i64 {
    (i * i) % 1009 + 3 * i
}

fn column(file: &ForeignFile, name: &str) -> Vec<i64> {
    file.dataset(name).unwrap().unwrap().integers().unwrap()
}

#[test]
fn every_number_type_is_read() {
    let file = ForeignFile::open(&fixture()).unwrap();
    assert_eq!(
        file.names("").unwrap(),
        ["compound", "long", "packed", "plain", "scalar", "table", "text", "unknown"]
    );
    let names = file.names("plain").unwrap();
    assert_eq!(names.len(), 14);
    for name in names {
        let of = |i: i64| match name.as_str() {
            "u1" | "i1" => number(i) % 100,
            "bool" => i64::from(i % 3 == 0),
            _ => number(i),
        };
        let dataset = file.dataset(&format!("plain/{name}")).unwrap().unwrap();
        assert_eq!(dataset.shape(), [300], "{name}");
        assert_eq!(dataset.integers().unwrap(), (0..300).map(of).collect::<Vec<_>>(), "{name}");
        assert_eq!(dataset.floats().unwrap(), (0..300).map(|i| of(i) as f64).collect::<Vec<_>>(), "{name}");
        let bytes: usize = name.trim_start_matches(|c: char| !c.is_ascii_digit()).parse().unwrap_or(1);
        assert_eq!(dataset.numbers().unwrap().number().bytes(), bytes, "{name}");
    }
    assert_eq!(file.dataset("plain/bool").unwrap().unwrap().numbers().unwrap().name(), "bool");
    assert_eq!(file.dataset("plain/big_f8").unwrap().unwrap().numbers().unwrap().number(), Number::F64);
}

#[test]
fn every_filter_is_undone_without_a_plugin() {
    let file = ForeignFile::open(&fixture()).unwrap();
    let names = file.names("packed").unwrap();
    assert_eq!(names.len(), 25);
    for name in names {
        assert_eq!(
            column(&file, &format!("packed/{name}")),
            (0..300).map(number).collect::<Vec<_>>(),
            "{name}"
        );
    }
    for name in file.names("long").unwrap() {
        assert_eq!(
            column(&file, &format!("long/{name}")),
            (0..40_000).map(|i| i / 37).collect::<Vec<i64>>(),
            "{name}"
        );
    }
    let error = file.dataset("unknown/bzip2").err().unwrap().to_string();
    assert!(
        error.contains("/unknown/bzip2: found numbers packed by BZIP2") && error.contains("h5repack"),
        "{error}"
    );
}

#[test]
fn rows_of_tables_and_compounds_are_read_in_pieces() {
    let file = ForeignFile::open(&fixture()).unwrap();
    let table = file.dataset("table").unwrap().unwrap();
    let compound = file.dataset("compound").unwrap().unwrap();
    assert_eq!((table.shape(), compound.shape()), (&[300, 4][..], &[300][..]));
    let of = |i: i64| [number(i), i % 40, i % 30, i % 2];
    for (c, member) in ["t", "x", "y", "p"].into_iter().enumerate() {
        for rows in [0..300, 17..19, 299..300, 5..5] {
            let expected: Vec<i64> = rows.clone().map(|i| of(i as i64)[c]).collect();
            let mut found = Vec::new();
            table.rows_at(rows.clone()).unwrap().integers(table.column(c).unwrap(), &mut found);
            assert_eq!(found, expected, "column {c}, rows {rows:?}");
            found.clear();
            compound.rows_at(rows.clone()).unwrap().integers(compound.member(member).unwrap(), &mut found);
            assert_eq!(found, expected, "member {member}, rows {rows:?}");
        }
    }
    assert!(table.column(4).is_none() && compound.member("z").is_none() && compound.numbers().is_none());
    assert!(table.rows_at(299..301).is_err());
}

#[test]
fn attributes_texts_and_scalars_are_read() {
    let file = ForeignFile::open(&fixture()).unwrap();
    assert_eq!(file.attribute_names("").unwrap(), ["bytes", "number", "numbers", "text"]);
    assert_eq!(file.attribute("", "text").unwrap(), Some(Value::Text("a text".into())));
    assert_eq!(file.attribute("", "bytes").unwrap(), Some(Value::Text("640x480".into())));
    assert_eq!(file.attribute("", "numbers").unwrap(), Some(Value::Integers(vec![480, 640])));
    assert_eq!(file.attribute("", "number").unwrap(), Some(Value::Floats(vec![0.5])));
    assert_eq!(file.attribute("packed", "nothing").unwrap(), None);
    assert_eq!(file.attribute("nowhere", "nothing").unwrap(), None);
    assert_eq!(column(&file, "scalar"), [1_234_567_890_123]);
    assert_eq!(file.text("text").unwrap().as_deref(), Some("a longer text"));
    assert!(file.dataset("text").is_err(), "a text is no dataset of numbers");
    assert!(
        file.dataset("packed/nothing").unwrap().is_none() && file.dataset("no/such/thing").unwrap().is_none()
    );
}

/// Reads everything that can be read.
fn devour(path: &Path) -> usize {
    let Ok(file) = ForeignFile::open(path) else { return 0 };
    let mut read = 0;
    for group in ["", "plain", "packed", "long", "unknown"] {
        let _ = file
            .attribute_names(group)
            .map(|names| names.iter().filter(|name| file.attribute(group, name).is_ok()).count());
        for name in file.names(group).unwrap_or_default() {
            let name = if group.is_empty() { name } else { format!("{group}/{name}") };
            if let Ok(Some(dataset)) = file.dataset(&name) {
                read +=
                    dataset.rows_at(0..dataset.rows().min(50_000)).map_or(0, |block| 1 + block.gaps().len());
            }
        }
    }
    read
}

#[test]
fn a_changed_byte_gives_numbers_gaps_or_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("changed.h5");
    let bytes = std::fs::read(fixture()).unwrap();
    std::fs::write(&path, &bytes).unwrap();
    let whole = devour(&path);
    assert!(whole > 40);
    let mut random = photocurrent_core::random::Random::new(7, &[]);
    for _ in 0..150 {
        let mut changed = bytes.clone();
        for _ in 0..1 + random.bits() % 3 {
            let at = (random.bits() % bytes.len() as u64) as usize;
            changed[at] = if random.bits().is_multiple_of(2) {
                random.bits() as u8
            } else {
                changed[at] ^ (1 << (random.bits() % 8))
            };
        }
        // A file that is replaced, not rewritten: the library remembers open files by their place on the
        // disk.
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, &changed).unwrap();
        devour(&path);
    }
}

#[test]
fn a_file_without_its_directory_is_refused_with_a_hint() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.h5");
    let bytes = std::fs::read(fixture()).unwrap();
    for length in [0, 7, 8, 60] {
        std::fs::write(&path, &bytes[..length]).unwrap();
        let error = ForeignFile::open(&path).err().unwrap().to_string();
        assert!(error.contains("cut.h5") && error.contains("hint:"), "{error}");
    }
}

/// A file on which HDF5 1.10 divides by zero: a dataset whose chunks have length 0.
fn with_chunks_of_length_0(path: &Path) {
    let file = hdf5::File::create(path).unwrap();
    file.new_dataset::<u16>().chunk([64]).shape([300]).create("x").unwrap().write(&vec![7u16; 300]).unwrap();
    file.close().unwrap();
    let mut bytes = std::fs::read(path).unwrap();
    // The layout message: version 3, chunked, two numbers, an address, the chunk's length and the size of an
    // element.
    let at =
        bytes.windows(19).position(|w| w[..3] == [3, 2, 2] && w[11..] == [64, 0, 0, 0, 2, 0, 0, 0]).unwrap()
            + 11;
    bytes[at] = 0;
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn a_file_that_ends_the_library_is_refused_and_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("zero.h5");
    with_chunks_of_length_0(&path);
    for _ in 0..2 {
        // HDF5 2 refuses the dataset, 1.10 would have ended this process.
        let refused = ForeignFile::open(&path)
            .and_then(|file| file.dataset("x").map(|_| ()))
            .err()
            .unwrap()
            .to_string();
        assert!(refused.contains("zero.h5") && refused.contains("/x"), "{refused}");
        std::thread::sleep(std::time::Duration::from_millis(40));
    }
}

#[test]
fn heaps_of_texts_that_are_damaged_anywhere_are_survived() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("texts.h5");
    let file = hdf5::File::create(&path).unwrap();
    let text: hdf5::types::VarLenUnicode = "640x480, a sensor".parse().unwrap();
    file.new_attr::<hdf5::types::VarLenUnicode>().create("geometry").unwrap().write_scalar(&text).unwrap();
    file.close().unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let heap = bytes.windows(4).position(|w| w == b"GCOL").unwrap();
    let read = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        ForeignFile::open(&path).and_then(|file| file.attribute("", "geometry"))
    };
    assert_eq!(read(&bytes).unwrap(), Some(Value::Text("640x480, a sensor".into())));
    // The size of the heap, and index, count and size of its first text. Some of the changes cost the library
    // a second of endless work.
    for at in (heap + 8..heap + 40).step_by(4) {
        for wrong in [&[1u8][..], &[0xff; 8], &[0; 8]] {
            let mut changed = bytes.clone();
            changed[at..at + wrong.len()].copy_from_slice(wrong);
            let _ = read(&changed);
        }
    }
}

/// Datasets with and without chunks, in both generations of superblocks and indices, cut at many places.
#[test]
fn a_cut_file_gives_rows_before_the_cut_and_gaps_behind_it() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, path) = (folder.path().join("whole.h5"), folder.path().join("cut.h5"));
    let rows = 4000usize;
    let right: Vec<u32> = (0..rows as u32).map(|i| i.wrapping_mul(2_654_435_761)).collect();
    for (latest, chunked) in [(false, false), (false, true), (true, false), (true, true)] {
        let file = hdf5::File::with_options()
            .with_fapl(|fapl| if latest { fapl.libver_latest() } else { fapl })
            .create(&whole)
            .unwrap();
        let build = file.new_dataset::<u32>().shape([rows]);
        let build = if chunked { build.chunk([100]) } else { build };
        build.create("t").unwrap().write(&right).unwrap();
        drop(build);
        file.close().unwrap();
        let bytes = std::fs::read(&whole).unwrap();
        let mut before = 0;
        for k in 1..20 {
            let length = bytes.len() * k / 20;
            std::fs::write(&path, &bytes[..length]).unwrap();
            let Ok(file) = ForeignFile::open(&path) else { continue };
            assert_eq!(file.cut(), Some(format!("the file is cut at byte {length} of {}", bytes.len())));
            let Ok(Some(dataset)) = file.dataset("t") else { continue };
            let block = dataset.rows_at(0..rows).unwrap();
            let mut found = Vec::new();
            block.integers(dataset.numbers().unwrap(), &mut found);
            let lost: usize = block.gaps().iter().map(|gap| gap.rows.len()).sum();
            for i in (0..rows).filter(|i| !block.gaps().iter().any(|gap| gap.rows.contains(i))) {
                assert_eq!(
                    found[i],
                    i64::from(right[i]),
                    "row {i} of cut {k}, latest {latest}, chunked {chunked}"
                );
            }
            assert!(
                lost > 0 && block.gaps().iter().all(|gap| gap.why.contains("cut at byte")),
                "{:?}",
                block.gaps()
            );
            assert_eq!(dataset.integers().unwrap().len(), dataset.rows_before_the_cut().unwrap());
            before = before.max(rows - lost);
        }
        assert!(before > rows / 2, "{before} rows, latest {latest}, chunked {chunked}");
    }
}
