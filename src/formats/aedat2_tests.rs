//! What the reader of AEDAT 2.0 claims, on records made by hand.

use super::*;
use proptest::prelude::*;

const DVS128: &str = "#!AER-DAT2.0\r\n# This is a raw AE data file\r\n# AEChip: \
                      ch.unizh.ini.jaer.chip.retina.DVS128\r\n";
const DAVIS346: &str = "#!AER-DAT2.0\r\n# AEChip: eu.seebetter.ini.chips.davis.Davis346blue\r\n";

fn file(head: &str, records: &[(u32, u32)]) -> Vec<u8> {
    let mut bytes = head.as_bytes().to_vec();
    records
        .iter()
        .for_each(|(address, stamp)| bytes.extend([address.to_be_bytes(), stamp.to_be_bytes()].concat()));
    bytes
}

fn with<T>(bytes: &[u8], declared: &Declared, work: impl FnOnce(Result<Aedat2, FormatError>) -> T) -> T {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("clip.aedat");
    std::fs::write(&path, bytes).unwrap();
    assert!(!bytes.starts_with(b"#!AER-DAT2.") || recognises(&Probe::new(&path).unwrap()));
    work(Aedat2::open(&path, declared))
}

/// ns, x, y, ON.
type Event = (i64, u16, u16, u8);

fn read(recording: &Aedat2) -> (Vec<Event>, Vec<Loss>) {
    let (mut cursor, mut chunk, mut events) =
        (recording.events().unwrap(), EventChunk::default(), Vec::new());
    while cursor.next(&mut chunk).unwrap() {
        events.extend((0..chunk.len()).map(|k| (chunk.t[k], chunk.x[k], chunk.y[k], chunk.on[k])));
    }
    (events, cursor.losses())
}

fn events(bytes: &[u8]) -> Vec<(i64, u16, u16, u8)> {
    with(bytes, &Declared::default(), |recording| read(&recording.unwrap()).0)
}

#[test]
fn a_dvs128_counts_columns_from_the_right_and_rows_from_below() {
    // Polarity bit 0 is ON. Column 0, row 0 is the lower right corner.
    assert_eq!(
        events(&file(DVS128, &[(0, 5), (127 << 1 | 127 << 8 | 1, 6)])),
        [(5000, 127, 127, 1), (6000, 0, 0, 0)]
    );
}

#[test]
fn a_davis_skips_samples_and_gives_edges_of_its_input() {
    let address = |column: u32, row: u32, on: u32| row << 22 | column << 12 | on << 11;
    let records = [
        (address(0, 0, 1), 10),
        (1 << 31 | address(3, 3, 0), 11),
        (address(345, 259, 0), 12),
        (1 << 10 | 3, 13),
        (1 << 10 | 2, 14),
        (1 << 10, 15),
        (address(346, 0, 0), 16),
    ];
    with(&file(DAVIS346, &records), &Declared::default(), |recording| {
        let recording = recording.unwrap();
        let (events, losses) = read(&recording);
        assert_eq!(events, [(10_000, 345, 259, 1), (12_000, 0, 0, 0)]);
        assert!(
            losses.len() == 1 && losses[0].what.starts_with("1 addresses name no pixel of the 346 x 260"),
            "{losses:?}"
        );
        let edge = |t, edge| Trigger { t, line: 0, edge };
        assert_eq!(recording.triggers().unwrap(), [edge(13_000, Edge::Rising), edge(14_000, Edge::Falling)]);
        assert_eq!(recording.events_about().unwrap().extent, Some(Extent { width: 346, height: 260 }));
    });
}

#[test]
fn stamps_go_on_when_their_counter_runs_over() {
    let stamps: Vec<i64> =
        events(&file(DVS128, &[(0, 0x7fff_ffff), (0, 0x8000_0001), (0, 0xffff_fffe), (0, 3), (0, 1)]))
            .iter()
            .map(|event| event.0)
            .collect();
    let us = [0x7fff_ffff_i64, 0x8000_0001, 0xffff_fffe, (1 << 32) + 3, (1 << 32) + 1];
    assert_eq!(stamps, us.map(|us| 1000 * us));
}

#[test]
fn version_1_has_addresses_of_16_bits() {
    let bytes = [
        b"#!AER-DAT1.0\n# AEChip: ch.unizh.ini.jaer.chip.retina.Tmpdiff128\n".as_slice(),
        &[0, 1, 0, 0, 0, 9, 0x80, 0, 0, 0, 0, 10],
    ]
    .concat();
    with(&bytes, &Declared::default(), |recording| {
        let recording = recording.unwrap();
        assert_eq!(read(&recording).0, [(9000, 127, 127, 0)]);
        assert_eq!(recording.triggers().unwrap(), [Trigger { t: 10_000, line: 0, edge: Edge::Falling }]);
    });
}

#[test]
fn a_camera_that_is_not_named_must_be_declared() {
    let bytes = file("#!AER-DAT2.0\r\n", &[(1, 5)]);
    with(&bytes, &Declared::default(), |recording| {
        assert_eq!(recording.err().unwrap().undeclared, Some("camera"))
    });
    let declared = Declared { camera: Some("DVS128".into()), ..Declared::default() };
    with(&bytes, &declared, |recording| assert_eq!(read(&recording.unwrap()).0, [(5000, 127, 127, 0)]));
    let declared = Declared { extent: Some(Extent { width: 240, height: 180 }), ..Declared::default() };
    with(&bytes, &declared, |recording| assert_eq!(read(&recording.unwrap()).0, [(5000, 239, 179, 0)]));
    let unknown = Declared { camera: Some("cochlea".into()), ..Declared::default() };
    with(&bytes, &unknown, |recording| assert!(recording.err().unwrap().found.contains("`cochlea`")));
}

#[test]
fn a_first_record_that_begins_like_a_comment_is_a_record() {
    // 0x23 is `#`, and rows 140 and 141 of a DAVIS346 begin so. The stamps contain the end of a line.
    let records = [(0x2300_0800, 0x0000_0a0a), (0x2340_0000, 0x0000_0a0b)];
    let expected = [(2_570_000, 345, 119, 1), (2_571_000, 345, 118, 0)];
    assert_eq!(events(&file(DAVIS346, &records)), expected);
    assert_eq!(events(&file(&format!("{DAVIS346}#End Of ASCII Header\r\n"), &records)), expected);
}

#[test]
fn a_file_cut_anywhere_gives_its_whole_records_and_a_loss() {
    let bytes = file(DVS128, &[(0, 5), (2, 6), (4, 7)]);
    let all = events(&bytes);
    for length in DVS128.len()..=bytes.len() {
        let (events, losses) =
            with(&bytes[..length], &Declared::default(), |recording| read(&recording.unwrap()));
        let whole = (length - DVS128.len()) / 8;
        assert_eq!(events, all[..whole]);
        assert_eq!(losses.len(), usize::from(!(length - DVS128.len()).is_multiple_of(8)));
    }
}

proptest! {
    #[test]
    fn random_records_and_flipped_bytes_never_panic(
        tail in proptest::collection::vec(any::<u8>(), 0..200),
        at in any::<proptest::sample::Index>(),
        value in any::<u8>(),
    ) {
        for head in [DVS128, DAVIS346] {
            let mut bytes = [head.as_bytes(), &tail].concat();
            let at = at.index(bytes.len());
            bytes[at] = value;
            with(&bytes, &Declared { camera: Some("davis346".into()), ..Declared::default() }, |recording| {
                if let Ok(recording) = recording {
                    let _ = (read(&recording), recording.triggers(), recording.facts());
                }
            });
        }
    }
}
