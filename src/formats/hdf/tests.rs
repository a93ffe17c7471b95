//! Files in `data/formats` are written by h5py (see the script in that folder); what they hold follows
//! formulas that are repeated here.
#![allow(clippy::unwrap_used)]

use crate::catalog::recognise;
use crate::chunk::{Edge, EventChunk, Trigger};
use crate::declared::Declared;
use crate::recording::Recording;
use photocurrent_core::{Colour, Extent};
use std::path::{Path, PathBuf};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/formats").join(name)
}

fn open(path: &Path, id: &str, declared: &Declared) -> Box<dyn Recording> {
    let format = recognise(path).unwrap().unwrap();
    assert_eq!(format.id, id);
    (format.open)(path, declared).unwrap()
}

/// All events from here on, and what was lost.
fn all(recording: &dyn Recording, from: Option<i64>) -> (EventChunk, usize) {
    let mut cursor = recording.events().unwrap();
    if let Some(from) = from {
        cursor.seek(from).unwrap();
    }
    let (mut chunk, mut events) = (EventChunk::default(), EventChunk::default());
    while cursor.next(&mut chunk).unwrap() {
        events.t.extend(&chunk.t);
        events.x.extend(&chunk.x);
        events.y.extend(&chunk.y);
        events.on.extend(&chunk.on);
    }
    (events, cursor.losses().len())
}

/// The script's formula: stamps in us.
fn expected(range: std::ops::Range<i64>, width: i64, height: i64, zero_us: i64) -> EventChunk {
    let mut events = EventChunk::default();
    range.for_each(|i| {
        events.push((zero_us + i * 13) * 1000, (i * 7 % width) as u16, (i * 11 % height) as u16, i % 2 == 1)
    });
    events
}

#[test]
fn dsec_comes_out_with_its_offset_and_is_sought_by_time() {
    let recording = open(&fixture("dsec_blosc_zstd.h5"), "dsec", &Declared::default());
    let about = recording.events_about().unwrap();
    assert_eq!((about.extent, about.tick_ns, about.count, about.has_t_in), (None, 1000, Some(5000), false));
    assert_eq!(
        (about.stamps.as_str(), about.notes.as_slice()),
        ("u32 microseconds", &["t_offset of 49599000000 us added".to_string()][..])
    );
    let zero = 49_599_000_000;
    assert_eq!(all(&*recording, None), (expected(0..5000, 640, 480, zero), 0));
    // A seek leaves nothing out at or after the time asked for.
    for us in [-1, 0, 1, 13 * 4500, 13 * 4999, 13 * 4999 + 1, 1 << 40] {
        let t = (zero + us) * 1000;
        let events = all(&*recording, Some(t)).0;
        let wanted = (0..5000).filter(|i| i * 13 >= us).count();
        assert_eq!(events.t.iter().filter(|&&other| other >= t).count(), wanted, "seek to {us} us");
    }
    let declared = Declared { extent: Some(Extent { width: 600, height: 480 }), ..Declared::default() };
    let (events, losses) = all(&*open(&fixture("dsec_blosc_zstd.h5"), "dsec", &declared), None);
    assert_eq!(
        (events.len(), losses),
        ((0..5000).filter(|i| i * 7 % 640 < 600).count(), 21),
        "of 309 events outside 20 are listed and the others counted"
    );
}

#[test]
fn a_dsec_folder_has_its_pictures_with_their_exposures() {
    let folder = tempfile::tempdir().unwrap();
    let (events, pictures) = (folder.path().join("events/left"), folder.path().join("images/left/rectified"));
    std::fs::create_dir_all(&events).unwrap();
    std::fs::create_dir_all(&pictures).unwrap();
    std::fs::copy(fixture("dsec_blosc_zstd.h5"), events.join("events.h5")).unwrap();
    for k in 0..2u8 {
        let mut encoder =
            png::Encoder::new(std::fs::File::create(pictures.join(format!("00000{k}.png"))).unwrap(), 2, 1);
        encoder.set_color(png::ColorType::Rgb);
        encoder.write_header().unwrap().write_image_data(&[k, 1, 2, 3, 4, 5]).unwrap();
    }
    let exposures = "# exposure_start_timestamp_us, exposure_end_timestamp_us\n49599000100, \
                     49599000300\n49599050100, 49599050900\n";
    std::fs::write(folder.path().join("images/left/exposure_timestamps_left.txt"), exposures).unwrap();
    let recording = open(folder.path(), "dsec", &Declared::default());
    assert_eq!(all(&*recording, None).0.len(), 5000);
    let pictures = recording.pictures().unwrap();
    let about = pictures.about();
    assert_eq!((about.extent, about.colour, about.bits), (Extent { width: 2, height: 1 }, Colour::Rgb, 8));
    assert_eq!(about.stamps[1].exposure, Some((49_599_050_100_000, 49_599_050_900_000)));
    assert_eq!((about.stamp_role, about.stamps[0].at), (Some(crate::StampRole::Start), 49_599_000_100_000));
    let mut values = Vec::new();
    pictures.read(1, &mut values).unwrap();
    assert_eq!(values, [1.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
    assert!(pictures.read(2, &mut values).is_err());
    assert_eq!(recording.files().len(), 4, "the folder, the events, two pictures, their stamps");
}

#[test]
fn of_a_folder_of_two_dsec_cameras_left_is_read_with_a_note() {
    let folder = tempfile::tempdir().unwrap();
    for side in ["left", "right"] {
        let events = folder.path().join(format!("events/{side}"));
        std::fs::create_dir_all(&events).unwrap();
        std::fs::copy(fixture("dsec_blosc_zstd.h5"), events.join("events.h5")).unwrap();
    }
    let notes =
        |declared: &Declared| open(folder.path(), "dsec", declared).events_about().unwrap().notes.clone();
    let note = "events and frames are those of left; not read: right (`camera` chooses)".to_string();
    assert!(notes(&Declared::default()).contains(&note), "{:?}", notes(&Declared::default()));
    let stated = notes(&Declared { camera: Some("right".into()), ..Declared::default() });
    assert!(!stated.iter().any(|note| note.contains("not read")), "{stated:?}");
}

#[test]
fn m3ed_is_read_by_camera() {
    let recording = open(&fixture("m3ed.h5"), "m3ed", &Declared::default());
    assert_eq!(recording.events_about().unwrap().extent, Some(Extent { width: 1280, height: 720 }));
    assert_eq!(all(&*recording, None), (expected(0..1000, 1280, 720, 0), 0));
    let note = "events are those of left; not read: right (`camera` chooses)";
    assert!(
        recording.events_about().unwrap().notes.iter().any(|found| found == note),
        "{:?}",
        recording.events_about().unwrap().notes
    );
    let note = "frames are those of left; not read: rgb (`frame_camera` chooses)";
    assert!(recording.pictures().unwrap().about().notes.iter().any(|found| found == note));
    let declared =
        Declared { camera: Some("right".into()), frame_camera: Some("rgb".into()), ..Declared::default() };
    let recording = open(&fixture("m3ed.h5"), "m3ed", &declared);
    assert_eq!(all(&*recording, None), (expected(0..3000, 1280, 720, 0), 0));
    let pictures = recording.pictures().unwrap();
    assert_eq!((pictures.about().colour, pictures.about().stamps[2].at), (Colour::Rgb, 80_000_000));
    let mut values = Vec::new();
    pictures.read(1, &mut values).unwrap();
    assert_eq!(
        (values.len(), &values[..3]),
        (72, &[74.0, 73.0, 72.0][..]),
        "blue, green, red are turned round"
    );
    let declared = Declared { camera: Some("middle".into()), ..Declared::default() };
    let error = (super::m3ed::FORMAT.open)(&fixture("m3ed.h5"), &declared).err().unwrap();
    assert_eq!(error.undeclared, Some("camera"));
    assert!(error.hint.contains("left, right"), "{error}");
}

/// A file whose compound of events has a member that lies outside of it.
#[test]
fn a_member_outside_of_its_compound_is_refused() {
    let mut bytes = std::fs::read(fixture("prophesee_plain.h5")).unwrap();
    bytes[2094] = 0x20;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.h5");
    std::fs::write(&path, bytes).unwrap();
    let refused = (super::prophesee::FORMAT.open)(&path, &Declared::default()).err().unwrap();
    assert!(refused.to_string().contains("CD/events"), "{refused}");
}

/// A file in which four bytes of `prophesee/left/x`'s fill value claim 2 GB: HDF5 1.10 ended the process on
/// it.
#[test]
fn a_fill_value_with_a_wrong_size_is_survived() {
    let mut bytes = std::fs::read(fixture("m3ed.h5")).unwrap();
    bytes[9036..9040].copy_from_slice(&i32::MAX.to_le_bytes());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.h5");
    std::fs::write(&path, bytes).unwrap();
    if let Ok(recording) = (super::m3ed::FORMAT.open)(&path, &Declared::default()) {
        all(&*recording, None);
    }
}

#[test]
fn mvsec_has_seconds_and_signed_polarity() {
    let recording = open(&fixture("mvsec.h5"), "mvsec", &Declared::default());
    let about = recording.events_about().unwrap();
    assert_eq!(
        (about.extent, about.tick_ns, about.stamps.as_str()),
        (Some(Extent { width: 346, height: 260 }), 1, "f64 seconds")
    );
    assert!(
        about.notes.iter().any(|note| note.contains("238 ns"))
            && about.notes.iter().any(|note| note.contains("-1 for OFF")),
        "{:?}",
        about.notes
    );
    let (events, losses) = all(&*recording, None);
    let right = expected(0..2000, 346, 260, 1_504_645_177_000_000);
    assert_eq!((events.x, events.y, events.on, losses), (right.x, right.y, right.on, 0));
    assert!(
        events.t.iter().zip(&right.t).all(|(found, right)| (found - right).abs() <= 120),
        "half a step of f64 at this time"
    );
    let pictures = recording.pictures().unwrap();
    assert!((pictures.about().stamps[1].at - 1_504_645_177_023_000_000).abs() <= 120);
    let mut values = Vec::new();
    pictures.read(1, &mut values).unwrap();
    assert_eq!((values.len(), values[5 * 346 + 7], values.iter().sum::<f32>()), (346 * 260, 200.0, 200.0));
}

#[test]
fn v2e_and_event_utils_are_read() {
    let recording = open(&fixture("v2e.h5"), "v2e_hdf5", &Declared::default());
    assert_eq!(all(&*recording, None), (expected(0..2000, 346, 260, 0), 0));
    assert!(recording.events_about().unwrap().notes[0].contains("32-bit seconds"));
    assert_eq!(recording.pictures().unwrap().about().stamps[1].at, 10_000_000);

    let recording = open(&fixture("event_utils.h5"), "event_utils_hdf5", &Declared::default());
    assert_eq!(recording.events_about().unwrap().extent, Some(Extent { width: 40, height: 30 }));
    assert_eq!(all(&*recording, None), (expected(0..2000, 40, 30, 0), 0));
    let pictures = recording.pictures().unwrap();
    assert_eq!((pictures.about().stamps.len(), pictures.about().stamps[1].at), (2, 11_000_000));
    let mut values = Vec::new();
    pictures.read(1, &mut values).unwrap();
    assert_eq!(&values[..3], [3.0, 2.0, 1.0]);
}

#[test]
fn prophesee_is_the_same_with_and_without_its_codec() {
    let mut right = EventChunk::default();
    for i in 0..3000i64 {
        let (x, y) = (i * 3 % 7 + i / 5 % 600, i / 50 % 480);
        right.push((913_716_224 + i / 3 * 2 + i / 40 * 1000) * 1000, x as u16, y as u16, i / 200 % 2 == 1);
    }
    for name in ["prophesee_plain.h5", "prophesee_ecf.h5"] {
        let recording = open(&fixture(name), "prophesee_hdf5", &Declared::default());
        assert_eq!(recording.events_about().unwrap().extent, Some(Extent { width: 640, height: 480 }));
        assert_eq!(all(&*recording, None), (right.clone(), 0), "{name}");
        let triggers = recording.triggers().unwrap();
        assert_eq!(
            (triggers.len(), triggers[1]),
            (4, Trigger { t: 913_716_724_000, line: 0, edge: Edge::Falling })
        );
        assert_eq!(recording.facts(), [("serial number".to_string(), "00000293".to_string())]);
    }
}

#[test]
fn triggers_that_are_left_out_are_a_loss() {
    let file = photocurrent_store::foreign::ForeignFile::open(&fixture("prophesee_plain.h5")).unwrap();
    let mut losses = Vec::new();
    let triggers = super::prophesee::triggers(&file, 3, &mut losses).unwrap();
    assert_eq!((triggers.len(), losses.len()), (3, 1));
    assert_eq!(
        (losses[0].at.as_str(), losses[0].what.as_str()),
        ("triggers 3 to 3", "no more than 3 triggers are read; the others are left out")
    );
    super::prophesee::triggers(&file, 4, &mut losses).unwrap();
    assert_eq!(losses.len(), 1);
}

#[test]
fn what_is_written_as_dsec_comes_back_and_its_index_keeps_its_promise() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.h5");
    let extent = Extent { width: 1280, height: 720 };
    let declared = Declared { camera: Some("right".into()), ..Declared::default() };
    let source = open(&fixture("m3ed.h5"), "m3ed", &declared);
    let written = super::write::write_dsec(
        &path,
        &mut *source.events().unwrap(),
        extent,
        source.events_about().unwrap().has_t_in,
    )
    .unwrap();
    assert_eq!((written.events, written.notes.len(), written.losses.len()), (3000, 0, 0));
    let back = open(&path, "dsec", &Declared::default());
    assert_eq!(back.events_about().unwrap().extent, Some(extent));
    assert_eq!(all(&*back, None), (expected(0..3000, 1280, 720, 0), 0));
    let file = photocurrent_store::foreign::ForeignFile::open(&path).unwrap();
    let column = |name: &str| file.dataset(name).unwrap().unwrap().integers().unwrap();
    let (t, index) = (column("events/t"), column("ms_to_idx"));
    assert_eq!(index.len(), 2999 * 13 / 1000 + 1);
    for (ms, &at) in index.iter().enumerate() {
        let (ms, at) = (ms as i64, at as usize);
        assert!(t[at] >= ms * 1000 && (at == 0 || t[at - 1] < ms * 1000), "{ms} ms");
    }
    // MVSEC's stamps are no whole microseconds, and small pixels do not hold its events.
    let source = open(&fixture("mvsec.h5"), "mvsec", &Declared::default());
    let written = super::write::write_dsec(
        &path,
        &mut *source.events().unwrap(),
        Extent { width: 346, height: 260 },
        source.events_about().unwrap().has_t_in,
    )
    .unwrap();
    assert!(written.notes[0].contains("rounded to whole microseconds"), "{:?}", written.notes);
    assert_eq!(
        all(&*open(&path, "dsec", &Declared::default()), None).0,
        expected(0..2000, 346, 260, 1_504_645_177_000_000)
    );
    let error = super::write::write_dsec(
        &path,
        &mut *source.events().unwrap(),
        Extent { width: 300, height: 260 },
        source.events_about().unwrap().has_t_in,
    )
    .err()
    .unwrap()
    .to_string();
    assert!(error.contains("outside the 300 x 260 pixels"), "{error}");
    assert_eq!(all(&*open(&path, "dsec", &Declared::default()), None).0.len(), 2000, "what was there stays");
}

#[test]
fn a_streamed_recording_is_a_recording() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.h5");
    let source = open(&fixture("event_utils.h5"), "event_utils_hdf5", &Declared::default());
    let pictures = source.pictures().unwrap();
    let read = |frame: usize, values: &mut Vec<f32>| {
        pictures.read(frame, values).map_err(|error| photocurrent_store::StoreError::Source(error.into()))
    };
    let extent = Extent { width: 40, height: 30 };
    let frames = photocurrent_store::stream::StreamedFrames {
        extent,
        colour: Colour::Rgb,
        dn: photocurrent_store::DnType::U16,
        row_time_ns: 0,
        exposures: vec![(500_000, 1_500_000), (10_500_000, 11_500_000)],
        read: &read,
    };
    let content = photocurrent_store::stream::StreamedRecording {
        extent,
        events: Some(false),
        t_resolution_ns: Some(1000),
        frames: Some(frames),
        sensor: None,
    };
    assert_eq!(
        super::write::write_recording(&path, Some(&mut *source.events().unwrap()), &content).unwrap().events,
        2000
    );
    let back = open(&path, "recording", &Declared::default());
    assert_eq!(all(&*back, None), (expected(0..2000, 40, 30, 0), 0));
    let about = back.events_about().unwrap();
    assert_eq!((about.extent, about.tick_ns, about.has_t_in), (Some(extent), 1000, false));
    let (mut values, mut right) = (Vec::new(), Vec::new());
    back.pictures().unwrap().read(1, &mut values).unwrap();
    pictures.read(1, &mut right).unwrap();
    assert_eq!(values, right);
    assert_eq!(back.pictures().unwrap().about().stamps[1].exposure, Some((10_500_000, 11_500_000)));
    // Stored as u16: no floats.
    assert_eq!(back.pictures().unwrap().about().bits, 16);
    // The whole of it passes the checks of a recording.
    assert_eq!(
        photocurrent_store::Recording::open(&path).unwrap().read_events(extent.rows()).unwrap().t.len(),
        2000
    );
}
