//! Files made by hand: recognised, read whole, cut off, damaged, searched by time.

use crate::chunk::EventChunk;
use crate::{Declared, EventCursor, Recording, recognise};
use photocurrent_core::Extent;
use std::io::Write;
use tempfile::NamedTempFile;

fn file(suffix: &str, parts: &[&[u8]]) -> NamedTempFile {
    let mut file = tempfile::Builder::new().suffix(suffix).tempfile().expect("a temporary file");
    parts.iter().for_each(|part| file.write_all(part).expect("written"));
    file
}

/// Opens bytes as a file, which lives as long as what is given with it.
fn opened(suffix: &str, parts: &[&[u8]], id: &str) -> (Box<dyn Recording>, NamedTempFile) {
    let file = file(suffix, parts);
    (open(&file, id), file)
}

fn open(file: &NamedTempFile, id: &str) -> Box<dyn Recording> {
    let format = recognise(file.path()).expect("readable").expect("a known format");
    assert_eq!(format.id, id);
    (format.open)(file.path(), &Declared::default()).expect("opens")
}

fn read(cursor: &mut dyn EventCursor) -> EventChunk {
    let (mut all, mut chunk) = (EventChunk::default(), EventChunk::default());
    while cursor.next(&mut chunk).expect("readable") {
        all.t.extend(&chunk.t);
        all.x.extend(&chunk.x);
        all.y.extend(&chunk.y);
        all.on.extend(&chunk.on);
    }
    assert!(chunk.is_empty());
    all
}

fn words<T: Copy, const N: usize>(words: &[T], bytes: fn(T) -> [u8; N]) -> Vec<u8> {
    words.iter().flat_map(|&word| bytes(word)).collect()
}

#[test]
fn each_encoding_is_recognised_and_read() {
    let evt3 = words(&[0x8001_u16, 0x6002, 4, 0x2805, 0xA101], u16::to_le_bytes);
    let evt2 = words(
        &[0x8000_0040_u32, 0x1000_0000 | 2 << 22 | 5 << 11 | 4, 0xA000_0101 | 2 << 22],
        u32::to_le_bytes,
    );
    let evt21 = words(
        &[
            0x8000_0040_u64 << 32,
            (0x1000_0000 | 2 << 22 | 5 << 11 | 4) << 32 | 1,
            (0xA000_0101 | 2 << 22) << 32,
        ],
        u64::to_le_bytes,
    );
    let legacy = words(
        &[0x8000_0040_u64, 1 << 32 | 0x1000_0000 | 2 << 22 | 5 << 11 | 4, 0xA000_0101 | 2 << 22],
        u64::to_le_bytes,
    );
    let cases: [(&str, &str, &[u8]); 6] = [
        ("evt3", "% format EVT3;height=720;width=1280\n% end\n", &evt3),
        ("evt3", "% Date 2020-09-25\n% system_ID 48\n% evt 3.0\n", &evt3),
        ("evt2", "% evt 2.0\n% plugin_name hal_plugin_imx636_evk4\n", &evt2),
        ("evt21", "% format EVT21;endianness=little\n% geometry 1280x720\n% end\n", &evt21),
        ("evt21", "% format EVT21;endianness=legacy\n% sensor_generation 4.2\n% end\n", &legacy),
        ("evt21", "% evt 2.1\n% integrator_name Prophesee\n% system_ID 49\n", &legacy),
    ];
    for (id, header, data) in cases {
        let file = file(".raw", &[header.as_bytes(), data]);
        let recording = open(&file, id);
        let about = recording.events_about().expect("events");
        assert_eq!(
            (about.extent, about.tick_ns),
            (Some(Extent { width: 1280, height: 720 }), 1000),
            "{header}"
        );
        let says = header.contains("width=") || header.contains("geometry");
        assert_eq!(
            about.notes.iter().any(|note| note.starts_with("size of the sensor that the header names")),
            !says,
            "{header}"
        );
        let mut cursor = recording.events().expect("a cursor");
        let events = read(&mut *cursor);
        assert_eq!(
            (&events.t[..], events.x[0], events.y[0], events.on[0]),
            (&[4_098_000_i64][..], 5, 4, 1),
            "{header}"
        );
        assert!(cursor.losses().is_empty());
        assert_eq!(cursor.position(), (data.len() as u64, data.len() as u64));
        assert_eq!(
            recording
                .triggers()
                .expect("readable")
                .iter()
                .map(|edge| (edge.t, edge.line))
                .collect::<Vec<_>>(),
            [(4_098_000, 1)]
        );
    }
}

#[test]
fn a_dat_file_says_its_version_count_and_size() {
    let record = |t: u32, place: u64| place << 32 | u64::from(t);
    let data = words(&[record(9, 1 << 28 | 4 << 14 | 5), record(10, 6)], u64::to_le_bytes);
    let header: &[u8] = b"% Data file containing CD events.\n% Version 2\n% Width 640\n% Height 480\n";
    let second = opened(".dat", &[header, &[12, 8], &data], "dat");
    let about = second.0.events_about().expect("events");
    assert_eq!((about.extent, about.count), (Some(Extent { width: 640, height: 480 }), Some(2)));
    let first = opened(
        ".dat",
        &[b"% Version 1\n", &[0, 8], &words(&[record(9, 1 << 17 | 4 << 9 | 5)], u64::to_le_bytes)],
        "dat",
    );
    for (recording, _file) in [first, second] {
        let events = read(&mut *recording.events().expect("a cursor"));
        assert_eq!((events.t[0], events.x[0], events.y[0], events.on[0]), (9_000, 5, 4, 1));
    }
    // Without a version, the bits that are used decide.
    for (place, y) in [(1 << 17 | 4 << 9 | 5, 4), (1 << 28 | 17 << 14 | 5, 17)] {
        let (recording, _file) = opened(
            ".dat",
            &[b"% Date 2014\n", &[0, 8], &words(&[record(9, place)], u64::to_le_bytes)],
            "dat",
        );
        let events = read(&mut *recording.events().expect("a cursor"));
        assert_eq!((events.x[0], events.y[0], events.on[0]), (5, y, 1));
    }
}

#[test]
fn what_is_no_dat_of_change_events_is_refused_or_not_recognised() {
    let triggers = file(".dat", &[b"% Version 2\n", &[14, 8], &[0; 8]]);
    let format = recognise(triggers.path()).expect("readable").expect("a DAT file");
    let error = (format.open)(triggers.path(), &Declared::default()).err().expect("refused").to_string();
    assert!(error.contains("byte 12") && error.contains("type 14"), "{error}");
    let empty = file(".dat", &[b"% Version 2\n"]);
    let format = recognise(empty.path()).expect("readable").expect("a DAT file");
    assert!((format.open)(empty.path(), &Declared::default()).is_err());
    for other in [
        &b"% a paper\n\\documentclass"[..],
        b"%PDF-1.7\n",
        b"% format HISTO3D;width=2\n% end\n",
        b"",
        b"%",
        b"%\n",
    ] {
        assert!(recognise(file(".txt", &[other]).path()).expect("readable").is_none(), "{other:?}");
    }
}

#[test]
fn a_file_cut_off_within_a_word_says_where() {
    let header: &[u8] = b"% evt 2.0\n";
    let data = words(&[0x8000_0001_u32, 0, 1 << 22], u32::to_le_bytes);
    let (recording, _file) = opened(".raw", &[header, &data[..11]], "evt2");
    let mut cursor = recording.events().expect("a cursor");
    assert_eq!(read(&mut *cursor).t, [64_000]);
    assert_eq!(cursor.losses().len(), 1);
    assert_eq!(cursor.losses()[0].at, "bytes 18 to 21");
    // A line feed at the end is no loss; neither is a second reading of the same place.
    let (recording, _file) = opened(".raw", &[header, &data, b"\n"], "evt2");
    let mut cursor = recording.events().expect("a cursor");
    assert_eq!(read(&mut *cursor).len(), 2);
    assert!(cursor.losses().is_empty());
}

#[test]
fn losses_name_their_place_and_are_bounded_in_number() {
    // In 32 pieces of 128 KiB each one word of an unknown kind.
    let mut data = words(&[0x8000_0001_u32], u32::to_le_bytes);
    data.resize(32 << 17, 0);
    (0..32).for_each(|piece| data[(piece << 17) + 7] = 0x30);
    let (recording, _file) = opened(".raw", &[b"% evt 2.0\n", &data], "evt2");
    let mut cursor = recording.events().expect("a cursor");
    read(&mut *cursor);
    let losses = cursor.losses();
    assert_eq!(losses.len(), 21);
    assert_eq!(losses[1].at, "bytes 131082 to 262154");
    assert!(losses[1].what.starts_with("1 words are of no known kind"));
    assert!(
        losses[20].at == "12 more places" && losses[20].what.starts_with("12 more of this kind: words"),
        "{:?}",
        losses[20]
    );
}

/// A file of 14 MB: an event every 8 us, time words between, times that step back by 200 us now and then.
fn long() -> (NamedTempFile, Vec<i64>) {
    let (mut data, mut times) = (vec![], vec![]);
    for n in 0..3_000_000_u32 {
        let us = if n % 1000 == 999 { n * 8 - 200 } else { n * 8 };
        if n % 8 == 0 || n % 1000 >= 998 || n % 1000 == 0 {
            data.extend((0x8000_0000 | us >> 6).to_le_bytes());
        }
        data.extend(((us & 63) << 22 | (n % 640) << 11).to_le_bytes());
        times.push(i64::from(us) * 1000);
    }
    (file(".raw", &[b"% evt 2.0\n% geometry 640x480\n", &data]), times)
}

#[test]
fn seek_leaves_out_no_event_at_or_after_the_time() {
    let (file, times) = long();
    let recording = open(&file, "evt2");
    let latest = 24_000_000_000;
    // Forward beyond the index, back, and forward within it; then to both ends.
    for t in [15_000_000_000, 3_000_000_000, 14_999_999_999, 23_999_000_000, latest, 0, i64::MIN, i64::MAX] {
        let mut cursor = recording.events().expect("a cursor");
        cursor.seek(t).expect("readable");
        let (at, of) = cursor.position();
        let events = read(&mut *cursor);
        assert_eq!(events.t[..], times[times.len() - events.len()..], "from {t}");
        let left_out = &times[..times.len() - events.len()];
        assert!(left_out.iter().all(|&before| before < t), "an event at or after {t} was left out");
        // Not more than a stride and a piece too early.
        let first = times.iter().position(|&time| time >= t).unwrap_or(times.len());
        assert!(
            first - left_out.len() < 1_200_000,
            "{} events too early for {t}; at byte {at} of {of}",
            first - left_out.len()
        );
    }
}

#[test]
fn settings_next_to_a_recording_are_facts() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.raw");
    std::fs::write(&path, b"% evt 3.0\n% serial_number 00000307\n").expect("written");
    std::fs::write(folder.path().join("a.bias"), "300 % bias_diff\n").expect("written");
    let format = recognise(&path).expect("readable").expect("EVT3");
    let recording = (format.open)(&path, &Declared::default()).expect("opens");
    let facts = recording.facts();
    assert!(facts.contains(&("camera".into(), "serial 00000307".into())), "{facts:?}");
    assert!(
        facts.iter().any(|(name, value)| name == "biases" && value.starts_with("bias_diff 300")),
        "{facts:?}"
    );
    assert_eq!(recording.events_about().expect("events").extent, None, "this header does not say it");
}
