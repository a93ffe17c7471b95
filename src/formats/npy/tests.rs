//! Arrays written by numpy 2 and by hand, read as events and frames.

use crate::catalog::recognise;
use crate::declared::{Column, Declared, TimeUnit};
use crate::error::FormatError;
use crate::event_utils_memmap::Memmap;
use crate::format::Probe;
use crate::hs_ergb::HsErgb;
use crate::npy::header::{self, Element, Kind};
use crate::npz::{self, Npz};
use crate::recording::Recording;
use crate::text::tests::collect;
use photocurrent_core::Extent;
use proptest::prelude::*;
use std::path::{Path, PathBuf};

/// `numpy.savez_compressed(t=[5, 7, 9] as i64, x=[1, 2, 3] as u16, y=[4, 5, 6] as u16, p=[True, False,
/// True])`.
const COMPRESSED: &str = "\
504b03042d0000000800000021003dceca0cffffffffffffffff05001400742e6e70790100100098000000000000004d000000000000009bec17ea1b10c9c850c650ad9e925a9c5ca46ea5\
a06e9369a1aea3a09e965f54529498179f5f94920a12774bcc294e058a17672416a402f91ac63a9a3a0ab50a14002e5606086087d29c501a00504b03042d00000008000000210057ca31ab\
ffffffffffffffff05001400782e6e70790100100086000000000000004a000000000000009bec17ea1b10c9c850c650ad9e925a9c5ca46ea5a06e536aa4aea3a09e965f54529498179f5f\
94920a12774bcc294e058a17672416a402f91ac63a9a3a0ab50a14002e46062606660600504b03042d00000008000000210018975c1bffffffffffffffff05001400792e6e707901001000\
86000000000000004a000000000000009bec17ea1b10c9c850c650ad9e925a9c5ca46ea5a06e536aa4aea3a09e965f54529498179f5f94920a12774bcc294e058a17672416a402f91ac63a\
9a3a0ab50a14002e16065606360600504b03042d00000008000000210016938cbbffffffffffffffff05001400702e6e707901001000830000000000000047000000000000009bec17ea1b\
10c9c850c650ad9e925a9c5ca46ea5a05e9364a8aea3a09e965f54529498179f5f94920a12774bcc294e058a17672416a402f91ac63a9a3a0ab50a14002e46064600504b01022d032d0000\
000800000021003dceca0c4d00000098000000050000000000000000000000800100000000742e6e7079504b01022d032d00000008000000210057ca31ab4a000000860000000500000000\
00000000000000800184000000782e6e7079504b01022d032d00000008000000210018975c1b4a00000086000000050000000000000000000000800105010000792e6e7079504b01022d03\
2d00000008000000210016938cbb4700000083000000050000000000000000000000800186010000702e6e7079504b05060000000004000400cc000000040200000000\
";

/// `numpy.save` of two aligned records x u16, y u16, t f64, p i8: (10, 3, 4.0, -1), (20, 5, 6.0, 1).
const RECORDS: &str = "\
934e554d50590100b6007b276465736372273a205b282778272c20273c753227292c20282779272c20273c753227292c202827272c20277c563427292c20282774272c20273c663827292c\
20282770272c20277c693127292c202827272c20277c563727295d2c2027666f727472616e5f6f72646572273a2046616c73652c20277368617065273a2028322c292c207d202020202020\
20202020202020202020202020202020202020202020202020202020202020202020202020202020200a0a000300db5500000000000000001040ff868c102e7f0000140005002e7f000000\
000000000018400104b3182e7f0000";

/// `numpy.save` of a 2 x 4 array in Fortran order: [[0.5, 1, 2, 1], [0.75, 3, 4, 0]].
const FORTRAN: &str = "\
934e554d5059010076007b276465736372273a20273c6638272c2027666f727472616e5f6f72646572273a20547275652c20277368617065273a2028322c2034292c207d20202020202020\
202020202020202020202020202020202020202020202020202020202020202020202020202020202020202020202020202020200a000000000000e03f000000000000e83f000000000000\
f03f000000000000084000000000000000400000000000001040000000000000f03f0000000000000000";

pub(crate) fn bytes(hex: &str) -> Vec<u8> {
    let digits: Vec<u8> = hex.bytes().filter(u8::is_ascii_hexdigit).collect();
    digits.chunks(2).map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}

/// An npy file of version 1, after NEP 1.
pub(crate) fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n");
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend((header.len() as u16).to_le_bytes());
    file.extend(header.as_bytes());
    file.extend(data);
    file
}

fn column<const N: usize>(code: &str, values: &[[u8; N]]) -> Vec<u8> {
    npy(&format!("'{code}'"), &format!("({},)", values.len()), values.as_flattened())
}

/// A zip archive of stored members, written by hand after the format's note (APPNOTE): local headers,
/// directory, end.
pub(crate) fn stored(members: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let (mut file, mut directory) = (Vec::new(), Vec::new());
    for (name, data) in members {
        let mut crc = flate2::Crc::new();
        crc.update(data);
        let mut common = Vec::new();
        common.extend([20, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        common.extend(crc.sum().to_le_bytes());
        common.extend((data.len() as u32).to_le_bytes());
        common.extend((data.len() as u32).to_le_bytes());
        common.extend((name.len() as u16).to_le_bytes());
        common.extend([0, 0]);
        directory.extend(b"PK\x01\x02\x14\x00");
        directory.extend(&common);
        directory.extend([0; 10]);
        directory.extend((file.len() as u32).to_le_bytes());
        directory.extend(name.as_bytes());
        file.extend(b"PK\x03\x04");
        file.extend(&common);
        file.extend(name.as_bytes());
        file.extend(data);
    }
    let (count, start) = (members.len() as u16, file.len() as u32);
    file.extend(&directory);
    file.extend(b"PK\x05\x06\x00\x00\x00\x00");
    file.extend(count.to_le_bytes());
    file.extend(count.to_le_bytes());
    file.extend((directory.len() as u32).to_le_bytes());
    file.extend(start.to_le_bytes());
    file.extend([0, 0]);
    file
}

fn us() -> Declared {
    Declared { time_unit: Some(TimeUnit::Us), ..Declared::default() }
}

fn file(name: &str, content: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, content).unwrap();
    (folder, path)
}

fn recognised(path: &Path) -> Option<&'static str> {
    recognise(path).unwrap().map(|format| format.id)
}

#[test]
fn an_archive_of_numpy_gives_its_events() {
    let (_folder, path) = file("events.npz", &bytes(COMPRESSED));
    assert_eq!(recognised(&path), Some("npz"));
    let error = Npz::open(&path, &Declared::default()).err().unwrap();
    assert_eq!(error.undeclared, Some("time_unit"));
    let npz = Npz::open(&path, &us()).unwrap();
    assert_eq!(npz.events_about().unwrap().count, Some(3));
    assert_eq!(npz.events_about().unwrap().stamps, "i64 us");
    let (events, losses) = collect(&npz);
    assert_eq!(
        (events.t, events.x, events.y, events.on),
        (vec![5000, 7000, 9000], vec![1, 2, 3], vec![4, 5, 6], vec![1, 0, 1])
    );
    assert_eq!(losses, []);
}

#[test]
fn records_and_fortran_order_are_read() {
    let (_folder, path) = file("records.npy", &bytes(RECORDS));
    assert_eq!(recognised(&path), Some("npz"));
    let (events, _) = collect(&Npz::open(&path, &us()).unwrap());
    assert_eq!(
        (events.t, events.x, events.y, events.on),
        (vec![4000, 6000], vec![10, 20], vec![3, 5], vec![0, 1])
    );
    let (_folder, path) = file("fortran.npy", &bytes(FORTRAN));
    let error =
        Npz::open(&path, &Declared { time_unit: Some(TimeUnit::S), ..Declared::default() }).err().unwrap();
    assert_eq!(error.undeclared, Some("columns"));
    assert!(error.hint.contains(r#"["t", "x", "y", "p"]"#), "{error}");
    let columns = Some(vec![Column::T, Column::X, Column::Y, Column::P]);
    let (events, _) = collect(
        &Npz::open(&path, &Declared { columns, time_unit: Some(TimeUnit::S), ..Declared::default() })
            .unwrap(),
    );
    assert_eq!(
        (events.t, events.x, events.y, events.on),
        (vec![500_000_000, 750_000_000], vec![1, 3], vec![2, 4], vec![1, 0])
    );
}

#[test]
fn a_damaged_archive_says_what_is_lost() {
    let whole = bytes(COMPRESSED);
    let (_folder, path) = file("cut.npz", &whole[..whole.len() - 100]);
    let error = Npz::open(&path, &us()).err().unwrap();
    assert!(error.hint.contains("copy it again"), "{error}");
    // A bit of a value: only the checksum knows. Members stored without deflate are not summed, so that this
    // is one in a deflated array.
    let mut seen = 0;
    for at in 0..whole.len() {
        let mut broken = whole.clone();
        broken[at] ^= 0x10;
        std::fs::write(&path, &broken).unwrap();
        if let Ok(npz) = Npz::open(&path, &us()) {
            let (events, losses) = collect(&npz);
            assert!(events.len() <= 3);
            seen += usize::from(losses.iter().any(|loss| loss.what.contains("checksum")));
        }
    }
    assert!(seen > 0, "some broken bit was found by its checksum");
}

#[test]
fn columns_of_other_lengths_and_lying_shapes_are_losses() {
    let t = column("<u4", &[1_u32, 2, 3].map(u32::to_le_bytes));
    let x = column("<u2", &[1_u16, 2].map(u16::to_le_bytes));
    let y = npy("'>u2'", "(1000000000000,)", &[0, 1, 0, 2, 0, 3]);
    let p = column("|i1", &[1_i8, -1, 5].map(i8::to_le_bytes));
    let (_folder, path) = file("odd.npz", &stored(&[("t.npy", t), ("x.npy", x), ("y.npy", y), ("p.npy", p)]));
    let npz = Npz::open(&path, &us()).unwrap();
    assert_eq!(npz.events_about().unwrap().count, Some(2));
    assert!(npz.losses()[0].what.contains("claims 1000000000000 rows and 3 are there"), "{:?}", npz.losses());
    let (events, _) = collect(&npz);
    assert_eq!((events.y, events.on), (vec![1, 2], vec![1, 0]), "big-endian rows");
}

#[test]
fn events_that_cannot_be_are_counted_by_kind() {
    let t = column("<f8", &[0.5, f64::NAN, f64::INFINITY, 1e300, 2.0, 3.0].map(f64::to_le_bytes));
    let x = column("<i2", &[1_i16, 1, 1, 1, -1, 1].map(i16::to_le_bytes));
    let y = column("<i2", &[1_i16; 6].map(i16::to_le_bytes));
    let p = column("|u1", &[1_u8, 1, 1, 1, 1, 7].map(u8::to_le_bytes));
    let (_folder, path) =
        file("odd.npz", &stored(&[("timestamp.npy", t), ("x.npy", x), ("y.npy", y), ("polarity.npy", p)]));
    let (events, losses) = collect(&Npz::open(&path, &us()).unwrap());
    assert_eq!(events.t, [500]);
    assert_eq!(losses.iter().filter(|loss| loss.what.contains("its stamp is not finite")).count(), 3);
    assert_eq!(
        losses.iter().map(|loss| loss.at.as_str()).collect::<Vec<_>>(),
        ["event 1", "event 2", "event 3", "event 4", "event 5"]
    );
}

#[test]
fn missing_keys_and_pickled_objects_are_named() {
    let (_folder, path) = file(
        "few.npz",
        &stored(&[
            ("t.npy", column("<u4", &[1_u32.to_le_bytes()])),
            ("x.npy", column("<u2", &[1_u16.to_le_bytes()])),
        ]),
    );
    let error = Npz::open(&path, &us()).err().unwrap();
    assert!(error.found.contains("no array for `y`; it holds t, x"), "{error}");
    let (_folder, path) = file(
        "other.npz",
        &stored(&[
            ("frames.npy", npy("'|u1'", "(1, 2, 2)", &[0; 4])),
            ("times.npy", column("<u4", &[1_u32.to_le_bytes()])),
        ]),
    );
    let error = Npz::open(&path, &us()).err().unwrap();
    assert!(error.found.contains("it holds frames, times"), "{error}");
    let (_folder, path) = file("objects.npy", &npy("'|O'", "(3,)", b"\x80\x04"));
    assert!(Npz::open(&path, &us()).err().unwrap().found.contains("pickled"));
}

#[test]
fn headers_are_read_after_nep_1() {
    let read = |file: &[u8]| header::read(&mut &*file).unwrap();
    let header = read(&npy("'<f4'", "(2, 3)", &[])).unwrap();
    assert_eq!((header.shape.as_slice(), header.fortran), (&[2, 3][..], false));
    let Element::Number(scalar) = header.element else { panic!() };
    assert_eq!((scalar.kind, scalar.bytes), (Kind::Float, 4));
    for (descr, shape) in [
        ("'<f4'", "(99999999999999999999,)"),
        ("'<f8'", "(4294967296, 4294967296)"),
        ("'<c8'", "(1,)"),
        ("'<u3'", "(1,)"),
        ("[]", "(1,)"),
        ("'<u2'", "3"),
    ] {
        assert!(read(&npy(descr, shape, &[])).is_err(), "{descr} {shape}");
    }
    let mut long = b"\x93NUMPY\x02\x00".to_vec();
    long.extend(u32::MAX.to_le_bytes());
    assert!(read(&long).unwrap_err().contains("4294967295"));
}

fn memmap(folder: &Path) {
    std::fs::write(
        folder.join("events_ts.npy"),
        column("<f8", &[0.000_001, 0.25, 0.5].map(f64::to_le_bytes)),
    )
    .unwrap();
    std::fs::write(
        folder.join("events_xy.npy"),
        npy("'<u2'", "(3, 2)", [1_u16, 2, 3, 4, 5, 5].map(u16::to_le_bytes).as_flattened()),
    )
    .unwrap();
    std::fs::write(folder.join("events_p.npy"), npy("'|u1'", "(3, 1)", &[1, 0, 1])).unwrap();
    let images: Vec<u8> = (0..2 * 8 * 6).collect();
    std::fs::write(folder.join("images.npy"), npy("'|u1'", "(2, 6, 8, 1)", &images)).unwrap();
    std::fs::write(
        folder.join("images_ts.npy"),
        npy("'<f8'", "(2, 1)", [0.1_f64, 0.2].map(f64::to_le_bytes).as_flattened()),
    )
    .unwrap();
    std::fs::write(folder.join("metadata.json"), r#"{"sensor_resolution": [6, 8]}"#).unwrap();
}

#[test]
fn a_memmap_folder_gives_events_and_frames() {
    let folder = tempfile::tempdir().unwrap();
    memmap(folder.path());
    assert_eq!(recognised(folder.path()), Some("memmap"));
    let recording = Memmap::open(folder.path(), &Declared::default()).unwrap();
    assert_eq!(
        recording.events_about().unwrap().extent,
        Some(Extent { width: 8, height: 6 }),
        "height comes first in the file"
    );
    let (events, losses) = collect(&recording);
    assert_eq!(
        (events.t, events.x, events.y),
        (vec![1000, 250_000_000, 500_000_000], vec![1, 3, 5], vec![2, 4, 5])
    );
    assert_eq!(losses.len(), 0);
    let frames = recording.pictures().unwrap();
    assert_eq!(
        frames.about().stamps.iter().map(|stamp| stamp.at).collect::<Vec<_>>(),
        [100_000_000, 200_000_000]
    );
    assert_eq!((frames.about().bits, frames.about().stamp_role, frames.about().transfer), (8, None, None));
    let mut values = Vec::new();
    frames.read(1, &mut values).unwrap();
    assert_eq!(values, (48..96).map(|value| value as f32).collect::<Vec<_>>());
    assert!(frames.read(2, &mut values).is_err());
    assert_eq!(recording.files().len(), 6);
}

#[test]
fn whole_stamps_of_a_memmap_need_a_unit_and_a_cut_array_is_a_loss() {
    let folder = tempfile::tempdir().unwrap();
    memmap(folder.path());
    std::fs::write(folder.path().join("events_ts.npy"), column("<i8", &[1_i64, 2, 3].map(i64::to_le_bytes)))
        .unwrap();
    assert_eq!(
        Memmap::open(folder.path(), &Declared::default()).err().unwrap().undeclared,
        Some("time_unit")
    );
    let images = std::fs::read(folder.path().join("images.npy")).unwrap();
    std::fs::write(folder.path().join("images.npy"), &images[..images.len() - 1]).unwrap();
    let recording = Memmap::open(folder.path(), &us()).unwrap();
    assert!(
        recording.losses()[0].what.contains("claims 2 frames and 1 are there"),
        "{:?}",
        recording.losses()
    );
    assert_eq!(recording.pictures().unwrap().about().stamps.len(), 1);
}

/// A sequence with two event files and three pictures of 8 x 6, coordinates times `scale`.
fn sequence(scale: u16, more: &[(u16, u16)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for inner in ["events_aligned", "images_corrected"] {
        std::fs::create_dir(folder.path().join(inner)).unwrap();
    }
    for n in 0..2_u32 {
        let mut pixels: Vec<(u16, u16)> = (0..40).map(|k| ((k % 8) * scale, (k % 6) * scale)).collect();
        pixels.extend(more);
        let t: Vec<[u8; 8]> = (0..pixels.len())
            .map(|k| (1_000_000 + i64::from(n) * 5_000 + 100 * k as i64).to_le_bytes())
            .collect();
        let x: Vec<[u8; 2]> = pixels.iter().map(|(x, _)| x.to_le_bytes()).collect();
        let y: Vec<[u8; 2]> = pixels.iter().map(|(_, y)| y.to_le_bytes()).collect();
        let p: Vec<[u8; 1]> = (0..pixels.len()).map(|k| [(k % 2) as u8]).collect();
        let members = [
            ("x.npy", column("<u2", &x)),
            ("y.npy", column("<u2", &y)),
            ("timestamp.npy", column("<i8", &t)),
            ("polarity.npy", column("|b1", &p)),
        ];
        std::fs::write(folder.path().join(format!("events_aligned/{n:06}.npz")), stored(&members)).unwrap();
    }
    for n in 0..3 {
        crate::pictures::tests::write_png(
            &folder.path().join(format!("images_corrected/{n:06}.png")),
            8,
            6,
            &[n; 8 * 6 * 3],
            png::ColorType::Rgb,
        );
    }
    std::fs::write(folder.path().join("images_corrected/timestamp.txt"), "1000000\n1005000\n").unwrap();
    folder
}

#[test]
fn a_sequence_of_whole_pixels_is_read_as_it_is() {
    let folder = sequence(1, &[]);
    assert_eq!(recognised(folder.path()), Some("hs_ergb"));
    let recording = HsErgb::open(folder.path(), &Declared::default()).unwrap();
    let (events, losses) = collect(&recording);
    assert_eq!((events.len(), losses.len()), (80, 0));
    assert_eq!((events.t[0], events.t[79], events.x[7], events.y[5]), (1_000_000_000, 1_008_900_000, 7, 5));
    let frames = recording.pictures().unwrap();
    assert_eq!(
        frames.about().stamps.iter().map(|stamp| stamp.at).collect::<Vec<_>>(),
        [1_000_000_000, 1_005_000_000]
    );
    assert!(
        frames.about().notes.iter().any(|note| note.contains("3 pictures and 2 stamps")),
        "{:?}",
        frames.about().notes
    );
    assert_eq!(recording.files().len(), 2 + 3 + 1);
}

#[test]
fn coordinates_of_a_32nd_pixel_are_divided_and_negative_ones_are_outside() {
    // BS-ERGB: -16/32 rounds to 0, -32/32 lies outside; both were stored 65,536 too large.
    let folder = sequence(32, &[(65_520, 0), (65_504, 0), (7 * 32 + 15, 5 * 32), (8 * 32, 0)]);
    let recording = HsErgb::open(folder.path(), &Declared::default()).unwrap();
    let notes = &recording.events_about().unwrap().notes;
    assert!(notes.iter().any(|note| note.contains("divided by 32")), "{notes:?}");
    let (events, losses) = collect(&recording);
    assert_eq!((events.x[7], events.y[5], events.x[40], events.x[41]), (7, 5, 0, 7));
    assert_eq!((events.len(), losses.len()), (84, 4));
    assert_eq!(losses[2].at, "000001.npz, event 41");
}

#[test]
fn coordinates_that_fit_neither_are_asked_for() {
    let folder = sequence(2, &[]);
    let error = HsErgb::open(folder.path(), &Declared::default()).err().unwrap();
    assert_eq!(error.undeclared, Some("coordinate_scale"));
    let declared = Declared { coordinate_scale: Some(2), ..Declared::default() };
    assert_eq!(collect(&HsErgb::open(folder.path(), &declared).unwrap()).0.len(), 80);
}

#[test]
fn a_broken_event_file_is_a_loss_and_the_others_are_read() {
    let folder = sequence(1, &[]);
    std::fs::write(folder.path().join("events_aligned/000001.npz"), b"PK\x03\x04 broken").unwrap();
    let (events, losses) = collect(&HsErgb::open(folder.path(), &Declared::default()).unwrap());
    assert_eq!((events.len(), losses.len(), losses[0].at.as_str()), (40, 1, "000001.npz"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn damaged_files_do_not_panic(
        which in 0_usize..3,
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in any::<prop::sample::Index>(),
    ) {
        let mut content = bytes([COMPRESSED, RECORDS, FORTRAN][which]);
        for (at, byte) in changes {
            let at = at.index(content.len());
            content[at] = byte;
        }
        let keep = content.len() - cut.index(content.len()) / 8;
        content.truncate(keep);
        let (_folder, path) = file("x.npz", &content);
        let _ = Probe::new(&path).map(|probe| (npz::FORMAT.recognises)(&probe));
        let columns = Some(vec![Column::T, Column::X, Column::Y, Column::P]);
        if let Ok(npz) = Npz::open(&path, &Declared { columns, ..us() }) {
            // Shapes may claim anything; the data end them.
            let result: Result<(), FormatError> = (|| {
                let mut cursor = npz.events()?;
                let mut chunk = crate::EventChunk::default();
                while cursor.next(&mut chunk)? {}
                Ok(())
            })();
            let _ = result;
        }
    }
}
