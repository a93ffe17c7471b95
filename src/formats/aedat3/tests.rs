//! What the reader of AEDAT 3.1 claims, on packets made by hand after the published layout.

use super::*;
use crate::aedat3::made::{frame, header, packet, polarity, special};
use proptest::prelude::*;

/// us, x, y, ON.
type Event = (i64, u16, u16, bool);

fn with<T>(bytes: &[u8], declared: &Declared, work: impl FnOnce(Result<Aedat3, FormatError>) -> T) -> T {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("clip.aedat");
    std::fs::write(&path, bytes).unwrap();
    work(Aedat3::open(&path, declared))
}

fn read(recording: &Aedat3) -> (Vec<Event>, Vec<Loss>) {
    let (mut cursor, mut chunk, mut events) =
        (recording.events().unwrap(), EventChunk::default(), Vec::new());
    while cursor.next(&mut chunk).unwrap() {
        events
            .extend((0..chunk.len()).map(|k| (chunk.t[k] / 1000, chunk.x[k], chunk.y[k], chunk.on[k] == 1)));
    }
    (events, cursor.losses())
}

fn some(count: i64) -> Vec<Event> {
    (0..count).map(|k| (1_000 + 37 * k, (k * 7 % 346) as u16, (k * 5 % 260) as u16, k % 3 == 0)).collect()
}

fn file(parts: &[Vec<u8>]) -> Vec<u8> {
    [header("DAVIS346"), parts.concat()].concat()
}

#[test]
fn the_bits_of_an_event_are_those_of_the_published_layout() {
    // Column 3, row 2, ON, valid: 3 << 17 | 2 << 2 | 1 << 1 | 1; stamp 5 us.
    let event = [0x0b, 0, 6, 0, 5, 0, 0, 0];
    let head = [1, 0, 1, 0, 8, 0, 0, 0, 4, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0];
    with(&file(&[head.to_vec(), event.to_vec()]), &Declared::default(), |recording| {
        let recording = recording.unwrap();
        assert_eq!(read(&recording), (vec![(5, 3, 2, true)], vec![]));
        let about = recording.events_about().unwrap();
        assert_eq!((about.extent, about.count), (Some(Extent { width: 346, height: 260 }), Some(1)));
    });
}

#[test]
fn stamps_go_on_with_the_overflow_of_their_packet() {
    let late = [((3 << 31) + 7, 1, 1, false)];
    let bytes = file(&[polarity(0, &[(0x7fff_ffff, 0, 0, true)]), polarity(3, &late)]);
    with(&bytes, &Declared::default(), |recording| {
        assert_eq!(read(&recording.unwrap()).0, [(0x7fff_ffff, 0, 0, true), late[0]])
    });
}

#[test]
fn frames_come_with_their_exposures_and_inputs_with_their_edges() {
    let values: Vec<u16> = (0..346 * 260_u32).map(|k| (k as u16 % 1024) << 6).collect();
    let bytes = file(&[
        polarity(0, &some(10)),
        frame(1, (1, 0), (2_000, 7_000), (346, 260), &values),
        special(0, &[(100, 2), (200, 3), (300, 4), (400, 1), (500, 6), (600, 13), (700, 0)]),
        polarity(0, &some(10)),
    ]);
    with(&bytes, &Declared::default(), |recording| {
        let recording = recording.unwrap();
        let pictures = recording.pictures().unwrap();
        let us = |t: i64| ((1_i64 << 31) + t) * 1000;
        assert_eq!(pictures.about().stamps[0].exposure, Some((us(2_000), us(7_000))));
        assert_eq!((pictures.about().bits, pictures.about().stamp_role), (16, Some(crate::StampRole::Start)));
        let mut out = Vec::new();
        pictures.read(0, &mut out).unwrap();
        assert!(out.iter().zip(&values).all(|(a, b)| *a == f32::from(*b)) && out.len() == values.len());
        let edge = |t, line, edge| Trigger { t, line, edge };
        let expected = [
            edge(100_000, 0, Edge::Rising),
            edge(200_000, 0, Edge::Falling),
            edge(500_000, 1, Edge::Rising),
            edge(600_000, 3, Edge::Falling),
        ];
        assert_eq!(recording.triggers().unwrap(), expected);
        assert!(recording.facts().contains(&("resets of the clock".into(), "1".into())));
        assert_eq!(read(&recording).0.len(), 20);
    });
}

#[test]
fn colours_are_given_as_red_green_blue_and_mosaics_by_their_upper_left_pixel() {
    use photocurrent_core::{Colour, colour::Order};
    let rgba: Vec<u16> = (0..2 * 2 * 4).collect();
    with(&file(&[frame(0, (4, 0), (1, 2), (2, 2), &rgba)]), &Declared::default(), |recording| {
        // The camera's name states another size: the frame is no whole one.
        assert!(recording.err().unwrap().to_string().contains("a frame of 2 x 2 pixels"));
    });
    let unknown = [header("prototype"), frame(0, (4, 0), (1, 2), (2, 2), &rgba)].concat();
    with(&unknown, &Declared::default(), |recording| {
        let pictures = recording.unwrap().pictures().unwrap();
        let mut out = Vec::new();
        pictures.read(0, &mut out).unwrap();
        assert_eq!(
            (pictures.about().colour, out),
            (Colour::Rgb, vec![0.0, 1.0, 2.0, 4.0, 5.0, 6.0, 8.0, 9.0, 10.0, 12.0, 13.0, 14.0])
        );
    });
    for (filter, order) in [(1, Order::Rggb), (2, Order::Grbg), (3, Order::Gbrg), (4, Order::Bggr)] {
        let bytes = [header("prototype"), frame(0, (1, filter), (1, 2), (2, 2), &[1, 2, 3, 4])].concat();
        with(&bytes, &Declared::default(), |recording| {
            assert_eq!(recording.unwrap().pictures().unwrap().about().colour, Colour::Bayer(order))
        });
    }
}

#[test]
fn what_a_filter_of_the_recorder_marked_is_left_out_and_counted() {
    let mut bytes = file(&[polarity(0, &some(3))]);
    let second = bytes.len() - 16;
    bytes[second] &= !1;
    // The header's count of valid events follows such a mark.
    bytes[second - 8 - 4] = 2;
    with(&bytes, &Declared::default(), |recording| {
        let recording = recording.unwrap();
        assert_eq!(read(&recording).0, [some(3)[0], some(3)[2]]);
        assert!(recording.events_about().unwrap().notes[0].starts_with("1 events are marked as invalid"));
    });
}

#[test]
fn a_source_of_several_is_chosen_by_name_or_number_and_an_unknown_camera_needs_an_extent() {
    let two = |second: u16| {
        let head = "#!AER-DAT3.1\n#Source 1: DVS128\n#-Source 7: gone\n#Source 2: prototype\n#!END-HEADER\n"
            .as_bytes()
            .to_vec();
        let event = |x: u32| [(x << 17 | 3).to_le_bytes(), 9_u32.to_le_bytes()].concat();
        [head, packet(1, 1, 8, 0, &[event(1)]), packet(1, second, 8, 0, &[event(2), event(3)])].concat()
    };
    with(&two(2), &Declared::default(), |recording| {
        assert_eq!(read(&recording.unwrap()).0, [(9, 1, 0, true)])
    });
    let named =
        |camera: &str, extent| Declared { camera: Some(camera.into()), extent, ..Declared::default() };
    with(&two(2), &named("2", None), |recording| {
        assert_eq!(recording.err().unwrap().undeclared, Some("extent"))
    });
    let extent = Some(Extent { width: 3, height: 3 });
    with(&two(2), &named("prototype", extent), |recording| {
        let (events, losses) = read(&recording.unwrap());
        assert_eq!((events, losses.len()), (vec![(9, 2, 0, true)], 1));
    });
    with(&two(2), &named("gone", None), |recording| {
        assert!(recording.err().unwrap().found.contains("1 (DVS128), 2 (prototype)"))
    });
    with(&two(1), &named("2", extent), |recording| assert!(recording.err().unwrap().hint.contains("DVS128")));
}

#[test]
fn other_versions_and_packed_formats_are_refused_with_what_to_do() {
    with(b"#!AER-DAT3.0\r\n", &Declared::default(), |recording| {
        assert!(recording.err().unwrap().to_string().contains("rows count from below"))
    });
    with(b"#!AER-DAT3.1\r\n#Format: SerializedTS\r\n", &Declared::default(), |recording| {
        let error = recording.err().unwrap().to_string();
        assert!(
            error.contains("line 2") && error.contains("`SerializedTS`") && error.contains("DV"),
            "{error}"
        );
    });
    with(&header("DAVIS346"), &Declared::default(), |recording| assert!(recording.is_err()));
}

#[test]
fn a_damaged_packet_costs_itself_and_no_other() {
    let parts: Vec<Vec<u8>> = some(400).chunks(50).map(|part| polarity(0, part)).collect();
    let whole = file(&parts);
    let third = header("DAVIS346").len() + parts[0].len() + parts[1].len();
    // Its kind, the size of its events, its capacity, far too much of each.
    for (at, lost) in [(1, 50), (5, 50), (16, 0), (18, 0)] {
        let mut bytes = whole.clone();
        bytes[third + at] = 0x7f;
        with(&bytes, &Declared::default(), |recording| {
            let recording = recording.unwrap();
            let (events, losses) = read(&recording);
            assert_eq!(events.len(), 400 - lost, "byte {at}: {losses:?}");
            assert_eq!(losses.len(), 1, "byte {at}: {losses:?}");
            assert_eq!(recording.losses(), losses);
        });
    }
    // Bytes that were lost, and others that came in.
    for cut in [
        [&whole[..third + 100], &whole[third + 133..]].concat(),
        [&whole[..third], &[9; 77], &whole[third..]].concat(),
    ] {
        with(&cut, &Declared::default(), |recording| {
            let (events, losses) = read(&recording.unwrap());
            assert!(events.len() >= 395 - 50 && !losses.is_empty(), "{} {losses:?}", events.len());
        });
    }
}

#[test]
fn a_file_cut_anywhere_gives_its_whole_events_and_a_loss() {
    let bytes = file(&[polarity(0, &some(3)), polarity(0, &some(2))]);
    let (start, first) = (header("DAVIS346").len(), 28 + 3 * 8);
    for length in start + 28 + 8..bytes.len() {
        let (events, losses) =
            with(&bytes[..length], &Declared::default(), |recording| read(&recording.unwrap()));
        let inside = length - start;
        let whole = if inside < first + 28 { (inside - 28) / 8 } else { 3 + (inside - first - 28) / 8 };
        assert_eq!(events.len(), whole.min(if inside < first + 28 { 3 } else { 5 }), "{length}");
        assert_eq!(losses.is_empty(), inside == first, "{length}: {losses:?}");
    }
}

proptest! {
    #[test]
    fn random_packets_never_panic(
        tail in proptest::collection::vec(any::<u8>(), 0..400),
        at in any::<proptest::sample::Index>(),
        value in any::<u8>(),
    ) {
        let mut bytes = [
            file(&[polarity(0, &some(4)), frame(0, (1, 0), (5, 9), (8, 6), &[7; 48])]), tail,
            polarity(0, &some(4)),
        ].concat();
        let at = at.index(bytes.len());
        bytes[at] = value;
        with(&bytes, &Declared {
            extent: Some(Extent { width: 8, height: 6 }), ..Declared::default()
        }, |recording| {
            if let Ok(recording) = recording {
                let _ = (
                    recording.events().map(|_| read(&recording)), recording.triggers(), recording.facts(),
                );
                if let Some(pictures) = recording.pictures() {
                    let _ = pictures.read(0, &mut Vec::new());
                }
            }
        });
    }
}
