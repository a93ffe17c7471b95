//! What the reader of AEDAT4 claims, on files made by hand.

use super::made::{self, How, Piece};
use super::*;
use crate::chunk::{Edge, EventChunk};
use crate::declared::StampRole;
use photocurrent_core::Colour;
use proptest::prelude::*;
use std::io::Read;

const STREAMS: [(&str, u32, u32); 4] = [("EVTS", 3, 2), ("FRME", 2, 1), ("IMUS", 0, 0), ("TRIG", 0, 0)];

type Event = (i64, u16, u16, u8);

/// Writes bytes to a file of their own and gives its path to `work`.
fn with_path<T>(bytes: &[u8], work: impl FnOnce(&Path) -> T) -> T {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("clip.aedat4");
    std::fs::write(&path, bytes).unwrap();
    work(&path)
}

fn with<T>(bytes: &[u8], work: impl FnOnce(Aedat4) -> T) -> T {
    with_path(bytes, |path| work(Aedat4::open(path, &Declared::default()).unwrap()))
}

fn rest(cursor: &mut dyn EventCursor) -> Vec<Event> {
    let (mut chunk, mut events) = (EventChunk::default(), Vec::new());
    while cursor.next(&mut chunk).unwrap() {
        events.extend((0..chunk.len()).map(|k| (chunk.t[k], chunk.x[k], chunk.y[k], chunk.on[k])));
    }
    assert!(chunk.is_empty());
    events
}

/// All events, and all losses of the recording and of the cursor.
fn read(recording: &Aedat4) -> (Vec<Event>, Vec<Loss>) {
    let mut cursor = recording.events().unwrap();
    let events = rest(cursor.as_mut());
    let losses = [recording.losses(), cursor.losses()].concat();
    (events, losses)
}

/// Three packets of events, two frames, a packet of the inertial sensor and one of triggers: in file order,
/// ten microseconds a packet.
fn pieces() -> Vec<Piece> {
    vec![
        made::events(0, &[(1000, 2, 1, 1), (1003, 0, 0, 0)]),
        made::frame(1, 1004, (1004, 1008), 0, (2, 1), &[7, 8]),
        made::triggers(2, &[(5, 5)]),
        made::events(0, &[(1010, 1, 1, 0), (1012, 1, 0, 255)]),
        made::triggers(
            3,
            &[(1004, 8), (1008, 9), (1010, 1), (1011, 2), (1012, 3), (1013, 4), (1014, 5), (1015, 77)],
        ),
        made::frame(1, 1014, (1014, 1018), 0, (2, 1), &[9, 10]),
        made::events(0, &[(1020, 2, 0, 1)]),
    ]
}

const EVENTS: [Event; 5] = [
    (1_000_000, 2, 1, 1),
    (1_003_000, 0, 0, 0),
    (1_010_000, 1, 1, 0),
    (1_012_000, 1, 0, 1),
    (1_020_000, 2, 0, 1),
];

#[test]
fn a_packet_without_its_vector_of_events_has_none() {
    let mut bytes = made::file(
        How::Plain,
        &STREAMS,
        &[made::events(0, &[(1000, 2, 1, 1)]), made::events(0, &[(1020, 2, 0, 1)])],
        false,
    );
    // Behind the identifier: two sizes, then where the table has the vector. Zero is nowhere.
    let places = bytes.windows(4).enumerate().filter(|(_, window)| *window == b"EVTS");
    // The first is the name of the kind in the header.
    let list = places.map(|(at, _)| at).nth(1).unwrap() + 4;
    bytes[list + 4..list + 6].fill(0);
    assert_eq!(with(&bytes, |recording| read(&recording).0), [(1_020_000, 2, 0, 1)]);
}

#[test]
fn whole_files_give_the_same_however_they_are_compressed() {
    for how in How::ALL {
        for with_table in [false, true] {
            with(&made::file(how, &STREAMS, &pieces(), with_table), |recording| {
                assert_eq!(read(&recording).0, EVENTS, "{how:?}");
                // The trigger of kind 77 is asked for first below.
                assert_eq!(read(&recording).1, []);
                let about = recording.events_about().unwrap();
                assert_eq!((about.extent, about.tick_ns), (Some(Extent { width: 3, height: 2 }), 1000));
                assert_eq!(about.count, with_table.then_some(5));
                let pictures = recording.pictures().unwrap();
                let mut values = vec![1.0];
                pictures.read(1, &mut values).unwrap();
                assert_eq!(values, [9.0, 10.0]);
                let about = pictures.about();
                assert_eq!(
                    (about.bits, about.colour, about.stamp_role),
                    (8, Colour::Mono, Some(StampRole::Start))
                );
                let stamps = [(1_004_000, 1_008_000), (1_014_000, 1_018_000)];
                assert_eq!(
                    about.stamps,
                    stamps.map(|exposure| crate::FrameStamp { at: exposure.0, exposure: Some(exposure) })
                );
                assert!(pictures.read(2, &mut values).is_err());
            });
        }
    }
}

#[test]
fn a_long_packet_of_linked_blocks_is_what_an_independent_encoder_was_given() {
    // 200,000 events are 3.2 MB: fifty blocks, each of which refers to the one before.
    let list: Vec<(i64, i16, i16, u8)> = (0..200_000)
        .map(|k: i64| (k / 3, (k * k % 3) as i16, (k % 2) as i16, u8::from(k % 5 == 0)))
        .collect();
    for how in How::ALL {
        with(&made::file(how, &STREAMS, &[made::events(0, &list)], true), |recording| {
            let (events, losses) = read(&recording);
            assert_eq!(losses, []);
            assert_eq!(events.len(), list.len());
            assert!(
                events.iter().zip(&list).all(|(a, b)| *a == (1000 * b.0, b.1 as u16, b.2 as u16, b.3)),
                "{how:?}"
            );
        });
    }
}

/// A clip of a DAVIS346, and what another decoder (PyPI `aedat` 2.3.0) finds in it.
#[test]
fn the_traffic_clip_is_what_another_decoder_finds_in_it() {
    let path =
        Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../data/recordings/davis346_traffic.aedat4"));
    let recording = Aedat4::open(path, &Declared::default()).unwrap();
    let (events, losses) = read(&recording);
    assert_eq!((events.len(), losses.len()), (78_830, 0));
    assert_eq!(recording.events_about().unwrap().count, Some(78_830));
    let sums = events.iter().fold((0, 0, 0), |sums: (u64, u64, u64), event| {
        (sums.0 + u64::from(event.1), sums.1 + u64::from(event.2), sums.2 + u64::from(event.3))
    });
    assert_eq!(sums, (14_861_513, 15_061_593, 41_257));
    assert_eq!(events.iter().map(|event| i128::from(event.0)).sum::<i128>(), 125_273_730_997_963_369_624_000);
    let pictures = recording.pictures().unwrap();
    let (mut values, mut sum) = (Vec::new(), 0.0);
    for k in 0..59 {
        pictures.read(k, &mut values).unwrap();
        sum += values.iter().map(|value| f64::from(*value)).sum::<f64>();
    }
    assert_eq!(sum, 409_067_057.0);
    let about = pictures.about();
    let first = crate::FrameStamp {
        at: 1_589_163_147_365_215_000,
        exposure: Some((1_589_163_147_364_965_000, 1_589_163_147_365_465_000)),
    };
    assert_eq!((about.stamps.len(), about.stamps[0], about.stamp_role), (59, first, Some(StampRole::Middle)));
    assert_eq!(recording.triggers().unwrap(), []);
    let signals = recording.facts().into_iter().find(|(name, _)| name == "trigger signals").unwrap().1;
    assert_eq!(
        signals,
        "59 begins of frames, 59 ends of frames, 59 begins of exposures, 59 ends of exposures"
    );

    // Half of the file: about half of the events, and the same ones.
    let bytes = std::fs::read(path).unwrap();
    with(&bytes[..bytes.len() / 2], |half| {
        let (some, losses) = read(&half);
        assert!(
            some.len() > 30_000 && some.len() < 50_000 && losses.len() >= 2,
            "{} events, {losses:?}",
            some.len()
        );
        assert_eq!(some, events[..some.len()]);
    });
}

#[test]
fn only_edges_on_lines_are_triggers() {
    with(&made::file(How::Lz4, &STREAMS, &pieces(), true), |recording| {
        let edge = |t, line, edge| Trigger { t, line, edge };
        let expected = [
            edge(1_010_000, 0, Edge::Rising),
            edge(1_011_000, 0, Edge::Falling),
            edge(1_013_000, 1, Edge::Rising),
            edge(1_014_000, 1, Edge::Falling),
        ];
        assert_eq!(recording.triggers().unwrap(), expected);
        let facts = recording.facts();
        let fact = |name: &str| facts.iter().find(|(known, _)| known == name).unwrap().1.clone();
        assert!(
            fact("trigger signals").contains("1 pulses on the input, 1 rising edges of the generator"),
            "{}",
            fact("trigger signals")
        );
        assert!(
            fact("trigger signals").ends_with("1 begins of exposures, 1 ends of exposures"),
            "{}",
            fact("trigger signals")
        );
        assert_eq!((fact("camera"), fact("compression")), ("DAVIS346 serial 00000007".into(), "LZ4".into()));
        assert_eq!(
            (fact("first event"), fact("packets")),
            ("1000 us on the camera's clock".into(), "7".into())
        );
        assert!(recording.losses().iter().any(|loss| loss.what.contains("kind 77")));
    });
}

#[test]
fn after_seek_no_event_at_or_after_the_time_is_missing() {
    // 3,000 packets of 20 events with stamps that do not run straight on; more than one mark.
    let list: Vec<Vec<(i64, i16, i16, u8)>> = (0..3000)
        .map(|p| {
            (0..20).map(|k: i64| (100 * p + (k * 7919 + p * 31) % 100, ((k + p) % 3) as i16, 0, 1)).collect()
        })
        .collect();
    let pieces: Vec<Piece> = list.iter().map(|events| made::events(0, events)).collect();
    // What tables say are the first and last stamp; give them events in order.
    let sorted: Vec<Piece> = list
        .iter()
        .map(|events| {
            let mut events = events.clone();
            events.sort();
            made::events(0, &events)
        })
        .collect();
    for bytes in
        [made::file(How::Plain, &STREAMS, &pieces, false), made::file(How::Plain, &STREAMS, &sorted, true)]
    {
        with(&bytes, |recording| {
            let all = read(&recording).0;
            let mut cursor = recording.events().unwrap();
            for t in [i64::MIN, 0, 123_456_789, 299_000_000, 299_999_000, 299_999_001, i64::MAX, 150_000_000]
            {
                cursor.seek(t).unwrap();
                let after = rest(cursor.as_mut());
                let wanted = all.iter().filter(|event| event.0 >= t).count();
                assert_eq!(after.iter().filter(|event| event.0 >= t).count(), wanted, "{t}");
                assert_eq!(after, all[all.len() - after.len()..]);
                if t > 100_000_000 && t < 299_000_000 {
                    assert!(after.len() < all.len() * 4 / 5, "{} of {}", after.len(), all.len());
                }
            }
        });
    }
}

#[test]
fn a_file_cut_anywhere_gives_its_whole_packets_and_says_that_it_is_cut() {
    for how in [How::Plain, How::Lz4, How::Zstd] {
        let bytes = made::file(how, &STREAMS, &pieces(), true);
        let header = made::header(how, 0, &STREAMS).len();
        let mut seen = Vec::new();
        for length in 0..bytes.len() {
            with_path(&bytes[..length], |path| match Aedat4::open(path, &Declared::default()) {
                Err(error) => assert!(length < header, "{length}: {error}"),
                Ok(recording) => {
                    let (events, losses) = read(&recording);
                    assert_eq!(events, EVENTS[..events.len()]);
                    assert!(!losses.is_empty(), "{how:?} cut at {length}");
                    seen.push(events.len());
                }
            });
        }
        assert!(seen.is_sorted());
        assert_eq!((seen[0], seen[seen.len() - 1]), (0, 5));
        seen.dedup();
        assert_eq!(seen, [0, 2, 4, 5]);
    }
}

#[test]
fn a_recorder_that_was_killed_leaves_no_table_and_no_loss() {
    with(&made::file(How::Lz4, &STREAMS, &pieces(), false), |recording| {
        assert_eq!(read(&recording), (EVENTS.to_vec(), vec![]))
    });
}

#[test]
fn no_flipped_byte_makes_the_reader_panic_or_spoils_more_than_a_packet() {
    for how in [How::Plain, How::Lz4, How::Zstd] {
        let bytes = made::file(how, &STREAMS, &pieces(), true);
        let header = made::header(how, 0, &STREAMS).len();
        for i in 0..bytes.len() {
            for flip in [0x01, 0x80, 0xff]
                .into_iter()
                .skip(if how == How::Plain { 0 } else { i % 3 })
                .take(if how == How::Plain { 3 } else { 1 })
            {
                let mut damaged = bytes.clone();
                damaged[i] ^= flip;
                with_path(&damaged, |path| {
                    let Ok(recording) = Aedat4::open(path, &Declared::default()) else {
                        return assert!(i < header, "byte {i}");
                    };
                    let _ = (recording.triggers(), recording.facts());
                    if let Some(pictures) = recording.pictures() {
                        let mut values = Vec::new();
                        (0..pictures.about().stamps.len()).for_each(|k| drop(pictures.read(k, &mut values)));
                    }
                    if recording.events_about().is_none() {
                        return;
                    }
                    let mut cursor = recording.events().unwrap();
                    let events = rest(cursor.as_mut());
                    cursor.seek(1_010_000).unwrap();
                    rest(cursor.as_mut());
                    // Two of five events are in the largest packet.
                    if i >= header {
                        let same = EVENTS.iter().filter(|event| events.contains(event)).count();
                        assert!(same >= 3, "byte {i} of {}, {how:?}: {same} events", bytes.len());
                    }
                });
            }
        }
    }
}

#[test]
fn a_wrong_length_costs_one_packet_even_of_a_stream_that_is_not_read() {
    let bytes = made::file(How::Lz4, &STREAMS, &pieces(), false);
    // The third packet is of the inertial sensor, and nobody decompresses it.
    let mut at = made::header(How::Lz4, -1, &STREAMS).len();
    for _ in 0..2 {
        at += 8 + u32::from_le_bytes(bytes[at + 4..at + 8].try_into().unwrap()) as usize;
    }
    for length in [200u32, 40, 4, 7] {
        let mut damaged = bytes.clone();
        damaged[at + 4..at + 8].copy_from_slice(&length.to_le_bytes());
        with(&damaged, |recording| {
            let (events, losses) = read(&recording);
            assert_eq!(events, EVENTS, "{length}");
            assert!(losses.iter().any(|loss| loss.at.starts_with(&format!("bytes {at} to "))), "{losses:?}");
        });
    }
}

#[test]
fn events_outside_the_pixels_are_left_out_and_counted() {
    let packet =
        made::events(0, &[(10, 2, 1, 1), (11, 3, 0, 1), (12, -1, 0, 1), (i64::MAX, 0, 0, 1), (13, 0, 0, 0)]);
    with(&made::file(How::Plain, &STREAMS, &[packet], false), |recording| {
        let (events, losses) = read(&recording);
        assert_eq!(events, [(10_000, 2, 1, 1), (13_000, 0, 0, 0)]);
        assert_eq!(losses.len(), 1);
        assert!(losses[0].what.starts_with("3 events lie outside the 3 x 2 pixels"), "{losses:?}");
    });
}

#[test]
fn colour_and_sixteen_bits_are_read_as_their_types_say() {
    // OpenCV's codes: 2 is 16-bit grey, 16 is 8-bit BGR, 24 is 8-bit BGRA, 18 is 16-bit BGR.
    let values = |code: i8, bytes: &[u8]| {
        with(
            &made::file(
                How::Lz4,
                &[("FRME", 2, 1)],
                &[made::frame(0, 0, (5, 6), code, (2, 1), bytes)],
                false,
            ),
            |recording| {
                let pictures = recording.pictures().unwrap();
                let mut values = Vec::new();
                pictures.read(0, &mut values).unwrap();
                (values, pictures.about().bits, pictures.about().colour)
            },
        )
    };
    assert_eq!(values(2, &[1, 0, 255, 3]), (vec![1.0, 1023.0], 16, Colour::Mono));
    assert_eq!(values(16, &[1, 2, 3, 11, 12, 13]), (vec![3.0, 2.0, 1.0, 13.0, 12.0, 11.0], 8, Colour::Rgb));
    assert_eq!(
        values(24, &[1, 2, 3, 99, 11, 12, 13, 99]),
        (vec![3.0, 2.0, 1.0, 13.0, 12.0, 11.0], 8, Colour::Rgb)
    );
    assert_eq!(
        values(18, &[1, 0, 2, 0, 3, 1, 4, 0, 5, 0, 6, 0]),
        (vec![259.0, 2.0, 1.0, 6.0, 5.0, 4.0], 16, Colour::Rgb)
    );
}

#[test]
fn frames_that_differ_are_left_out_and_frames_without_exposure_are_not() {
    let pieces = [
        made::frame(0, 50, (0, 0), 0, (2, 1), &[1, 2]),
        made::frame(0, 60, (58, 62), 0, (2, 1), &[3, 4]),
        made::frame(0, 70, (68, 72), 0, (1, 1), &[5]),
        made::frame(0, 80, (78, 82), 2, (2, 1), &[1, 2, 3, 4]),
        made::frame(0, 90, (88, 92), 0, (2, 1), &[6]),
        made::frame(0, 95, (88, 92), 5, (2, 1), &[6, 7]),
    ];
    with(&made::file(How::Plain, &[("FRME", 2, 1)], &pieces, true), |recording| {
        let pictures = recording.pictures().unwrap();
        let about = pictures.about();
        assert_eq!(
            about.stamps.iter().map(|stamp| (stamp.at, stamp.exposure)).collect::<Vec<_>>(),
            [(50_000, None), (60_000, Some((58_000, 62_000)))]
        );
        assert_eq!(about.stamp_role, Some(StampRole::Middle));
        assert_eq!(about.notes, ["1 of 2 frames have no exposure: its end is not after its start"]);
        assert!(recording.events_about().is_none() && recording.events().is_err());
        let whats: Vec<String> = recording.losses().into_iter().map(|loss| loss.what).collect();
        assert_eq!(whats.len(), 4, "{whats:?}");
        assert!(
            whats[0].contains("1 x 1 pixels at (0, 0)")
                && whats[1].contains("16 bits")
                && whats[2].contains("1 bytes")
                && whats[3].contains("type 5")
        );
    });
}

#[test]
fn of_several_streams_the_named_one_is_read() {
    let streams = [("EVTS", 3, 2), ("EVTS", 5, 5)];
    let bytes = made::file(
        How::Plain,
        &streams,
        &[made::events(0, &[(1, 0, 0, 1)]), made::events(1, &[(2, 4, 4, 0)])],
        true,
    );
    with_path(&bytes, |path| {
        let open = |camera: Option<&str>| {
            Aedat4::open(path, &Declared { camera: camera.map(String::from), ..Declared::default() })
        };
        assert_eq!(read(&open(None).unwrap()).0, [(1000, 0, 0, 1)]);
        assert_eq!(
            open(None).unwrap().events_about().unwrap().notes,
            ["events are those of stream 0 EVTS `out0` 3 x 2 of DAVIS346_00000007; not read: 1 EVTS `out1` \
              5 x 5 of DAVIS346_00000007 (`camera` chooses)"]
        );
        assert_eq!(read(&open(Some("1")).unwrap()).0, [(2000, 4, 4, 0)]);
        assert_eq!(read(&open(Some("out1")).unwrap()).0, [(2000, 4, 4, 0)]);
        let error = open(Some("left")).err().unwrap();
        assert_eq!(error.undeclared, Some("camera"));
        assert!(error.hint.contains("0 EVTS `out0` 3 x 2 of DAVIS346_00000007; 1 EVTS"), "{error}");
    });
}

#[test]
fn an_extent_that_the_header_lacks_must_be_declared() {
    let bytes = made::file(How::Plain, &[("EVTS", 0, 0)], &[made::events(0, &[(1, 9, 9, 1)])], false);
    with_path(&bytes, |path| {
        assert_eq!(Aedat4::open(path, &Declared::default()).err().unwrap().undeclared, Some("extent"));
        let declared = Declared { extent: Some(Extent { width: 10, height: 10 }), ..Declared::default() };
        assert_eq!(read(&Aedat4::open(path, &declared).unwrap()).0, [(1000, 9, 9, 1)]);
    });
}

#[test]
fn other_files_are_refused_with_what_they_begin_with() {
    with_path(b"#!AER-DAT2.0\r\nold", |path| {
        assert!(!recognises(&Probe::new(path).unwrap()));
        let error = Aedat4::open(path, &Declared::default()).err().unwrap();
        assert!(error.to_string().contains("begins with `#!AER-DAT2.0`, expected `#!AER-DAT4.0`"), "{error}");
    });
    with_path(&made::header(How::Plain, -1, &STREAMS), |path| {
        assert!(recognises(&Probe::new(path).unwrap()))
    });
}

#[test]
fn a_packet_that_would_grow_without_end_is_left_out() {
    // 200 MiB of zeros in 30 kB: more than a packet may have.
    let bomb = zstd::stream::encode_all(std::io::repeat(0).take(200 << 20), 1).unwrap();
    let mut bytes = made::file(How::Zstd, &STREAMS, &pieces()[..1], false);
    bytes.extend(0u32.to_le_bytes());
    bytes.extend((bomb.len() as u32).to_le_bytes());
    bytes.extend(bomb);
    with(&bytes, |recording| {
        let (events, losses) = read(&recording);
        assert_eq!(events, EVENTS[..2]);
        assert!(losses[0].what.contains("it grows beyond 128 MiB"), "{losses:?}");
    });
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn random_bytes_behind_a_good_header_never_panic(
        tail in proptest::collection::vec(any::<u8>(), 0..400),
        k in 0..3usize,
        at in 0..500i64,
    ) {
        let how = [How::Plain, How::Lz4, How::Zstd][k];
        let bytes = [made::header(how, at, &STREAMS), tail].concat();
        with(&bytes, |recording| {
            let _ = (
                read(&recording), recording.triggers(), recording.facts(), recording.pictures().is_some(),
            );
        });
    }

    #[test]
    fn several_damaged_bytes_never_panic(
        places in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..12),
        k in 0..5usize,
    ) {
        let mut bytes = made::file(How::ALL[k], &STREAMS, &pieces(), true);
        places.iter().for_each(|(at, value)| { let at = at.index(bytes.len()); bytes[at] = *value; });
        with_path(&bytes, |path| {
            let Ok(recording) = Aedat4::open(path, &Declared::default()) else { return };
            let _ = (recording.triggers(), recording.facts(), recording.pictures().is_some());
            if recording.events_about().is_some() {
                read(&recording);
            }
        });
    }
}
