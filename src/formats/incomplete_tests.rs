//! Folders of datasets of which one file is missing: each names it, and where it comes from. Whole ones are
//! read by the tests of their formats.

use crate::catalog::recognise;
use crate::declared::Declared;
use crate::error::FormatError;
use std::path::Path;

/// Writes files (one that ends in `/` is a folder) and opens their folder.
fn open(files: &[&str], expected: &str) -> FormatError {
    let folder = tempfile::tempdir().unwrap();
    for name in files {
        let path = folder.path().join(name);
        match name.strip_suffix('/') {
            Some(_) => std::fs::create_dir_all(&path).unwrap(),
            None => {
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                write(&path);
            }
        }
    }
    let format = recognise(folder.path()).unwrap().unwrap_or_else(|| panic!("{files:?} is recognised"));
    assert_eq!(format.id, expected, "{files:?}");
    (format.open)(folder.path(), &Declared::default()).err().unwrap_or_else(|| panic!("{files:?} is refused"))
}

fn write(path: &Path) {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("png") => crate::pictures::tests::write_png(path, 2, 1, &[1, 2], png::ColorType::Grayscale),
        _ => std::fs::write(path, "0.1 images/a.png\n").unwrap(),
    }
}

#[test]
fn an_event_camera_dataset_folder_without_events_says_so() {
    let error = open(&["images.txt", "calib.txt", "images/a.png"], "ecd");
    assert!(
        error.found.contains("events.txt is missing")
            && error.hint.contains("davis_data")
            && error.hint.contains("images.txt"),
        "{error}"
    );
    let packed = open(&["images.txt", "images/a.png", "events.zip"], "ecd");
    assert!(packed.found.contains("events.zip is there") && packed.hint.contains("unzip"), "{packed}");
    // Pictures with a list of stamps next to them are pictures.
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("a.png"));
    std::fs::create_dir(folder.path().join("images")).unwrap();
    std::fs::write(folder.path().join("images.txt"), "0.1 a.png\n").unwrap();
    assert_eq!(recognise(folder.path()).unwrap().unwrap().id, "pictures");
}

#[test]
fn a_dsec_sequence_without_events_names_the_archive_that_has_them() {
    let error = open(&["images/left/rectified/000000.png", "images/timestamps.txt"], "dsec");
    assert!(
        error.found.contains("events/left/events.h5 is missing")
            && error.hint.contains("_events_left.zip of dsec.ifi.uzh.ch"),
        "{error}"
    );
    let packed = open(&["images/left/distorted/000000.png", "events_left.zip"], "dsec");
    assert!(packed.hint.contains("unzip") && packed.hint.contains("events/left"), "{packed}");
}

#[test]
fn an_hs_ergb_sequence_without_event_files_names_the_first() {
    for files in [
        &["events_aligned/", "images_corrected/000000.png", "images_corrected/timestamp.txt"][..],
        &["events/", "images/000000.png", "timestamp.txt"],
    ] {
        let error = open(files, "hs_ergb");
        assert!(error.found.contains("/000000.npz") && error.hint.contains("HS-ERGB"), "{error}");
    }
    let error = open(&["images_aligned/000000.png", "timestamp.txt"], "hs_ergb");
    assert!(error.found.contains("folder of event files is missing"), "{error}");
}

#[test]
fn a_memmap_folder_without_an_array_names_it() {
    for (files, missing) in [
        (["events_ts.npy", "events_xy.npy"], "events_p.npy is missing"),
        (["events_ts.npy", "events_p.npy"], "events_xy.npy is missing"),
        (["xy.npy", "p.npy"], "events_ts.npy is missing"),
    ] {
        let error = open(&files, "memmap");
        assert!(error.found.contains(missing) && error.hint.contains("EVREAL"), "{error}");
    }
}
