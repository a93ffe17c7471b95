//! Text files written by hand, read as events, and back.

use crate::csv::{Csv, CsvWriter, FORMAT};
use crate::declared::{Column, Declared, TimeUnit};
use crate::error::Loss;
use crate::format::Probe;
use crate::recording::{EventCursor, Recording};
use crate::{EventChunk, FormatError};
use photocurrent_core::Extent;
use proptest::prelude::*;
use std::path::{Path, PathBuf};

/// All events of a recording, piece by piece, and what was lost.
pub(crate) fn collect(recording: &dyn Recording) -> (EventChunk, Vec<Loss>) {
    let mut cursor = recording.events().unwrap();
    let all = drain(cursor.as_mut());
    (all, cursor.losses())
}

/// The events that a cursor still gives.
pub(crate) fn drain(cursor: &mut dyn EventCursor) -> EventChunk {
    let (mut all, mut chunk) = (EventChunk::default(), EventChunk::default());
    while cursor.next(&mut chunk).unwrap() {
        all.t.extend_from_slice(&chunk.t);
        all.x.extend_from_slice(&chunk.x);
        all.y.extend_from_slice(&chunk.y);
        all.on.extend_from_slice(&chunk.on);
        if let Some(t_in) = &chunk.t_in {
            all.t_in.get_or_insert_with(Vec::new).extend_from_slice(t_in);
        }
    }
    assert!(chunk.is_empty(), "the last piece is empty");
    let (position, of) = cursor.position();
    assert_eq!(position, of, "all is read");
    all
}

fn file(text: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("events.csv");
    std::fs::write(&path, text).unwrap();
    (folder, path)
}

fn open(text: &[u8], declared: &Declared) -> Result<(EventChunk, Vec<Loss>, Csv), FormatError> {
    let (_folder, path) = file(text);
    let csv = Csv::open(&path, declared)?;
    let (events, losses) = collect(&csv);
    Ok((events, losses, csv))
}

fn is_recognised(text: &[u8]) -> bool {
    let (_folder, path) = file(text);
    (FORMAT.recognises)(&Probe::new(&path).unwrap())
}

fn declared(columns: &[Column], unit: TimeUnit) -> Declared {
    Declared { columns: Some(columns.to_vec()), time_unit: Some(unit), ..Declared::default() }
}

const TXYP: [Column; 4] = [Column::T, Column::X, Column::Y, Column::P];

#[test]
fn every_separator_header_and_polarity_reads_the_same() {
    for text in [
        "t [us],x,y,p\n5,1,2,1\n7,3,4,0\n",
        "timestamp_us;x;y;polarity\r\n5; 1 ;2;true\r\n7;3;4;false\r\n",
        "# a comment\nt_us\tx\ty\ton\n5\t1\t2\t+1\n\n% another\n7\t3\t4\t-1",
        "  t [us]  x y p \n 5   1  2 1.0 \n 7 3 4 -1.0\n",
        "# time_unit=us\nt,x,y,p\n5,1,2,1\n7,3,4,0\n",
        "# t_us x y p\n5 1 2 1\n7 3 4 0\n",
        "\u{feff}\"p\",\"y\",\"x\",\"ts (us)\"\n1,2,1,5\n0,4,3,7\n",
        "# timestamps in microseconds\nt,x,y,p,more\n5,1,2,1,left\n7,3,4,0,out\n",
        "t_ns,x,y,p\n5e3,1,2,1\n7000.0,3,4,0\n",
    ] {
        let (events, losses, csv) = open(text.as_bytes(), &Declared::default()).unwrap();
        assert_eq!(
            (events.t, events.x, events.y, events.on),
            (vec![5000, 7000], vec![1, 3], vec![2, 4], vec![1, 0]),
            "{text}"
        );
        assert_eq!(losses, [], "{text}");
        assert!(is_recognised(text.as_bytes()), "{text}");
        assert_eq!(csv.events_about().unwrap().count, None);
    }
}

#[test]
fn a_missing_unit_is_asked_for_with_evidence() {
    let mut text = String::from("t,x@320,y@240,on\n");
    for k in 0..1999 {
        text += &format!("0,{},{},{}\n", k % 320, k / 320, k % 2);
    }
    let error = open(text.as_bytes(), &Declared::default()).err().unwrap();
    assert_eq!(error.undeclared, Some("time_unit"));
    assert!(error.found.contains("whole numbers, 1 distinct among 1999"), "{error}");
    let us = Declared { time_unit: Some(TimeUnit::Us), ..Declared::default() };
    let (events, losses, csv) = open(text.as_bytes(), &us).unwrap();
    assert_eq!((events.len(), losses.len()), (1999, 0));
    assert_eq!(
        csv.events_about().unwrap().extent,
        Some(Extent { width: 320, height: 240 }),
        "faery writes the size into the header"
    );
    let error =
        open(b"t,x,y,p\n0.001,1,1,1\n0.002,1,1,1\n0.003,1,1,0\n", &Declared::default()).err().unwrap();
    assert!(error.hint.contains("\"s\""), "{error}");
}

#[test]
fn columns_without_a_header_are_asked_for_and_proposed() {
    let text = b"100 7 3 1\n250 2 9 0\n250 5 5 1\n";
    assert!(is_recognised(text));
    let error = open(text, &Declared { time_unit: Some(TimeUnit::Us), ..Declared::default() }).err().unwrap();
    assert_eq!(error.undeclared, Some("columns"));
    assert!(error.hint.contains(r#"["t", "x", "y", "p"]"#), "{error}");
    let (events, ..) = open(text, &declared(&TXYP, TimeUnit::Ms)).unwrap();
    assert_eq!(events.t, [100_000_000, 250_000_000, 250_000_000]);
    // Prophesee's samples have another order.
    let (events, ..) = open(
        b"7,3,1,100\n2,9,0,250\n",
        &declared(&[Column::X, Column::Y, Column::P, Column::T], TimeUnit::Us),
    )
    .unwrap();
    assert_eq!((events.x, events.on, events.t), (vec![7, 2], vec![1, 0], vec![100_000, 250_000]));
    let error =
        open(text, &declared(&[Column::T, Column::X, Column::X, Column::P], TimeUnit::Us)).err().unwrap();
    assert!(error.found.contains("one column `x`"), "{error}");
}

#[test]
fn other_text_is_no_event_file() {
    for text in [
        "format = \"photocurrent-sensor/1\"\nname = \"x\"\n",
        "index,t_start_ns,t_end_ns,t_mid_ns,file\n0,1,2,3,000000.png\n",
        "0.1\n0.2\n0.3\n",
        "0.1 images/a.png\n",
        "a,b,c,d\n1,2,3,4\n",
        "1 2 3 4\0\n",
        "%PDF-1.4 of something\nnot an event\n",
        "",
    ] {
        assert!(!is_recognised(text.as_bytes()), "{text}");
    }
}

#[test]
fn damaged_lines_are_losses_with_their_numbers() {
    let text = b"t_us,x,y,p\n1,2,3,1\n2,two,3,1\n3,4\n4,5,6,2\n5,999,6,1\n6,-1,6,1\n\
                 99999999999999999999,1,1,1\nnan,1,1,1\n9,1,1,1\n10,1,1";
    let extent = Some(Extent { width: 100, height: 100 });
    let (events, losses, _) = open(text, &Declared { extent, ..Declared::default() }).unwrap();
    assert_eq!(events.t, [1000, 9000]);
    let at: Vec<&str> = losses.iter().map(|loss| loss.at.as_str()).collect();
    assert_eq!(at, ["line 3", "line 4", "line 5", "line 6", "line 7", "line 8", "line 9", "line 11"]);
    assert!(losses[0].what.contains("column 2 of `2,two,3,1` is no number"), "{losses:?}");
    assert!(losses[3].what.contains("outside 100 x 100"), "{losses:?}");
    assert!(losses[7].what.contains("ends inside"), "{losses:?}");
}

#[test]
fn a_million_damaged_lines_are_few_losses_and_an_endless_line_is_one() {
    let mut text = b"t_us,x,y,p\n1,2,3,1\n".to_vec();
    text.extend(b"x\n".repeat(100_000));
    text.extend(vec![b'7'; 1_000_000]);
    text.extend(b"\n2,2,3,1\n");
    let (events, losses, _) = open(&text, &Declared::default()).unwrap();
    assert_eq!(events.t, [1000, 2000]);
    assert!(losses[20].what.starts_with("99980 more"), "{}", losses[20].what);
    assert_eq!((losses.len(), losses[21].at.as_str()), (22, "line 100003"));
}

#[test]
fn first_line_of_width_and_height_is_the_extent() {
    let (events, _, csv) =
        open(b"240 180\n0.5 1 2 1\n0.75 239 179 0\n", &declared(&TXYP, TimeUnit::S)).unwrap();
    assert_eq!(events.t, [500_000_000, 750_000_000]);
    assert_eq!(csv.events_about().unwrap().extent, Some(Extent { width: 240, height: 180 }));
    assert_eq!(csv.events_about().unwrap().tick_ns, 10_000_000, "two places");
}

#[test]
fn more_events_than_a_piece_keep_their_order_and_seek_starts_again() {
    let mut text = String::from("t_us,x,y,p\n");
    for k in 0..200_000 {
        text += &format!("{k},{},{},{}\n", k % 640, k % 480, k % 2);
    }
    let (_folder, path) = file(text.as_bytes());
    let csv = Csv::open(&path, &Declared::default()).unwrap();
    let mut cursor = csv.events().unwrap();
    let all = drain(cursor.as_mut());
    assert_eq!(all.t, (0..200_000).map(|k| k * 1000).collect::<Vec<_>>());
    cursor.seek(5).unwrap();
    assert_eq!(drain(cursor.as_mut()), all);
}

fn written(chunk: &EventChunk, unit: TimeUnit, extent: Option<Extent>) -> Vec<u8> {
    let mut writer = CsvWriter::new(Vec::new(), unit, extent, chunk.t_in.is_some()).unwrap();
    writer.write(chunk).unwrap();
    writer.finish().unwrap()
}

#[test]
fn written_text_is_readable_by_people() {
    let chunk = EventChunk {
        t: vec![1_500, -2_000],
        x: vec![1, 2],
        y: vec![3, 4],
        on: vec![1, 0],
        t_in: Some(vec![1_499, -2_001]),
    };
    let text =
        String::from_utf8(written(&chunk, TimeUnit::Us, Some(Extent { width: 8, height: 6 }))).unwrap();
    assert_eq!(
        text,
        "# photocurrent-events/1 time_unit=us width=8 \
                      height=6\nt,x,y,p,t_in\n1.500,1,3,1,1.499\n-2,2,4,0,-2.001\n"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn what_is_written_is_read_back_without_a_declaration(
        events in proptest::collection::vec(
            (
                any::<i64>().prop_map(|t| t / 2), 0_u16..346, 0_u16..260, 0_u8..2,
                any::<i64>().prop_map(|t| t / 2),
            ),
            1..300,
        ),
        unit in prop_oneof![Just(TimeUnit::S), Just(TimeUnit::Ms), Just(TimeUnit::Us), Just(TimeUnit::Ns)],
        has_t_in in any::<bool>(),
        has_extent in any::<bool>(),
    ) {
        let mut chunk = EventChunk { t_in: has_t_in.then(Vec::new), ..EventChunk::default() };
        for (t, x, y, on, t_in) in events {
            chunk.push(t, x, y, on == 1);
            if let Some(all) = &mut chunk.t_in {
                all.push(t_in);
            }
        }
        let extent = has_extent.then_some(Extent { width: 346, height: 260 });
        let text = written(&chunk, unit, extent);
        let (events, losses, csv) = open(&text, &Declared::default()).unwrap();
        prop_assert_eq!(events, chunk);
        prop_assert_eq!(losses, vec![]);
        prop_assert_eq!(csv.events_about().unwrap().extent, extent);
    }

    #[test]
    fn no_text_panics(
        text in proptest::collection::vec(
            prop_oneof![Just(b'\n'), Just(b','), Just(b' '), Just(b'#'), Just(b'1'), Just(b'.'), any::<u8>()],
            0..600,
        ),
    ) {
        let found = crate::text::sniff::look(&text, &text, text.len() as u64);
        let _ = crate::text::sniff::proposal(&found.sample, found.fields);
        let (_folder, path) = file(&text);
        let _ = (FORMAT.recognises)(&Probe::new(&path).unwrap());
        for declared in [Declared::default(), declared(&TXYP, TimeUnit::S)] {
            if let Ok(csv) = Csv::open(&path, &declared) {
                collect(&csv);
            }
        }
    }
}

#[test]
fn a_missing_file_is_an_error_with_its_name() {
    let error = Csv::open(Path::new("/nowhere/events.csv"), &Declared::default()).err().unwrap();
    assert!(error.to_string().contains("/nowhere/events.csv"), "{error}");
}
