//! Folders of small pictures, stamps files, trigger edges and Y4M files made here, read as frames.

use crate::catalog::recognise;
use crate::chunk::{Edge, Trigger};
use crate::declared::{Declared, StampRole, Strobe, TimeUnit, Transfer};
use crate::error::FormatError;
use crate::event_camera_dataset::EventCameraDataset;
use crate::joined::{Joined, with_declared_frames};
use crate::npy::tests::bytes;
use crate::pictures::stamps::{self, Stamps};
use crate::pictures::triggers::pulses;
use crate::pictures::{PictureFiles, names};
use crate::recording::{EventCursor, EventsAbout, Pictures, Recording};
use crate::text::tests::collect;
use photocurrent_core::{Colour, Extent};
use proptest::prelude::*;
use std::path::{Path, PathBuf};

/// Written by Pillow (libtiff, LZW): 16 bits, [[1, 300], [65535, 4]].
const GREY_TIFF: &str = "\
49492a001400000080004002c00bfdfe0400404009000001030001000000020000000101030001000000020000000201030001000000100000000301030001000000050000000601030001\
0000000100000011010400010000000800000016010300010000000200000017010400010000000c0000001c010300010000000100000000000000\
";

/// Written by Pillow (libtiff, deflate): RGB of 8 bits, [[1, 2, 3], [4, 5, 6]].
const RGB_TIFF: &str = "\
49492a0016000000789c6364626661650300003e00160a00000103000100000002000000010103000100000001000000020103000300000094000000030103000100000008000000060103\
00010000000200000011010400010000000800000015010300010000000300000016010300010000000100000017010400010000000e0000001c0103000100000001000000000000000800\
08000800";

pub(crate) fn write_png(path: &Path, width: u32, height: u32, values: &[u8], colour: png::ColorType) {
    write_png_of(path, width, height, values, colour, png::BitDepth::Eight);
}

fn write_png_of(
    path: &Path,
    width: u32,
    height: u32,
    values: &[u8],
    colour: png::ColorType,
    depth: png::BitDepth,
) {
    let mut encoder = png::Encoder::new(std::fs::File::create(path).unwrap(), width, height);
    encoder.set_color(colour);
    encoder.set_depth(depth);
    encoder.write_header().unwrap().write_image_data(values).unwrap();
}

/// Grey pictures of 2 x 1, all of whose values are their number.
fn folder(names: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (n, name) in names.iter().enumerate() {
        write_png(&folder.path().join(name), 2, 1, &[n as u8, n as u8], png::ColorType::Grayscale);
    }
    folder
}

fn us() -> Declared {
    Declared { time_unit: Some(TimeUnit::Us), ..Declared::default() }
}

fn open(folder: &tempfile::TempDir, stamps: &str, declared: &Declared) -> Result<PictureFiles, FormatError> {
    std::fs::write(folder.path().join("timestamps.txt"), stamps).unwrap();
    PictureFiles::open(folder.path(), declared)
}

fn at(pictures: &PictureFiles) -> Vec<i64> {
    pictures.about().stamps.iter().map(|stamp| stamp.at).collect()
}

/// First value of every frame.
fn firsts(pictures: &dyn Pictures) -> Vec<f32> {
    let mut values = Vec::new();
    (0..pictures.about().stamps.len())
        .map(|frame| pictures.read(frame, &mut values).map(|()| values[0]).unwrap())
        .collect()
}

#[test]
fn names_are_sorted_by_their_numbers_and_thumbnails_are_left_out() {
    let folder = folder(&["f10.png", "f9.png", "f0100.png", ".hidden.png", "thumb_1.png", "f9b.PNG"]);
    std::fs::write(folder.path().join("notes.md"), "x").unwrap();
    std::fs::create_dir(folder.path().join("f1.png")).unwrap();
    let names: Vec<String> = names::pictures(folder.path())
        .unwrap()
        .iter()
        .map(|path| path.file_name().unwrap().to_string_lossy().into_owned())
        .collect();
    assert_eq!(names, ["f9.png", "f9b.PNG", "f10.png", "f0100.png"]);
}

#[cfg(unix)]
#[test]
fn a_name_that_is_not_utf_8_is_read() {
    use std::os::unix::ffi::OsStrExt;
    let folder = folder(&["a.png"]);
    let odd = folder.path().join(std::ffi::OsStr::from_bytes(b"b\xff.png"));
    std::fs::copy(folder.path().join("a.png"), odd).unwrap();
    assert_eq!(at(&open(&folder, "1\n2\n", &us()).unwrap()), [1000, 2000]);
}

#[test]
fn stamps_are_read_in_every_form() {
    let folder = folder(&["a.png", "b.png", "c.png"]);
    let stamp = |text: &str, declared: &Declared| {
        open(&folder, text, declared)
            .map(|pictures| (at(&pictures), pictures.about().stamps[0].exposure))
            .unwrap()
    };
    for text in [
        "10\n20\n30\n",
        "# in us\n10\n20\n30",
        "t_us\n10\n20\n30\n",
        "0 10\n1 20\n2 30\n",
        "a.png 10\nb.png 20\nc.png 30\n",
        "c.png,30\na.png,10\nb.png,20\n",
    ] {
        let (mut stamps, exposure) = stamp(text, &us());
        stamps.sort_unstable();
        assert_eq!((stamps, exposure), (vec![10_000, 20_000, 30_000], None), "{text}");
    }
    for text in [
        "10 15\n20 25\n30 35\n",
        "1 10 15\n2 20 25\n3 30 35\n",
        "# exposure_start_timestamp_us, exposure_end_timestamp_us\n10, 15\n20, 25\n30, 35\n",
    ] {
        assert_eq!(stamp(text, &us()), (vec![10_000, 20_000, 30_000], Some((10_000, 15_000))), "{text}");
    }
    let error = open(&folder, "0.01\n0.02\n0.03\n", &Declared::default()).err().unwrap();
    assert_eq!((error.undeclared, error.hint.contains("\"s\"")), (Some("stamps_unit"), true), "{error}");
    let error = open(&folder, "10 20 15\n20 5 25\n", &us()).err().unwrap();
    assert!(error.hint.contains("header"), "{error}");
}

#[test]
fn rendered_frames_of_this_project_are_read_back() {
    let folder = folder(&["000000.png", "000001.png"]);
    let text = "# dn = offset + scale * code; offset=0.0 scale=0.015610; exposure_dn_of_ns=4200000; \
                row_time_ns=30\nindex,t_start_ns,t_end_ns,t_mid_ns,file,offset_dn,scale_dn\n0,100,300,200,000000.png,0.0,0.01561\n1,400,600,500,000001.png,0.0,0.01561\n";
    std::fs::write(folder.path().join("frames.csv"), text).unwrap();
    let pictures = PictureFiles::open(folder.path(), &Declared::default()).unwrap();
    let about = pictures.about();
    assert_eq!((about.stamps[1].at, about.stamps[1].exposure), (400, Some((400, 600))));
    assert_eq!(
        (about.stamp_role, about.row_time_ns, about.transfer),
        (Some(StampRole::Start), Some(30), Some(Transfer::Linear))
    );
    assert!(about.notes.iter().any(|note| note.contains("scale=0.015610")), "{:?}", about.notes);
}

#[test]
fn counts_that_differ_are_noted_and_a_wrong_first_line_is_found() {
    let folder = folder(&["a.png", "b.png", "c.png", "d.png"]);
    let error = open(&folder, "10\n20\n30\n", &us()).err().unwrap();
    assert_eq!(error.undeclared, Some("first_pulse"), "{error}");
    assert!(
        error.found.contains("4 pictures and 3 stamps")
            && error.hint.contains("`first_pulse = -1`")
            && error.hint.contains("`first_pulse = 0`"),
        "{error}"
    );
    let pictures = open(&folder, "10\n20\n30\n", &Declared { first_pulse: Some(-1), ..us() }).unwrap();
    assert_eq!((at(&pictures), firsts(&pictures)), (vec![10_000, 20_000, 30_000], vec![1.0, 2.0, 3.0]));
    assert!(
        pictures
            .about()
            .notes
            .iter()
            .any(|note| note.contains("1 pictures have no stamp and were left out: a.png")),
        "{:?}",
        pictures.about().notes
    );
    let pictures = open(&folder, "3\n1000000\n1000010\n1000020\n1000030\n", &us()).unwrap();
    assert_eq!(at(&pictures)[0], 1_000_000_000, "{:?}", pictures.about().notes);
    assert!(pictures.about().notes.iter().any(|note| note.contains("wrong lines at the front")));
    assert_eq!(
        open(&folder, "10\n20\n30\n40\n50\n", &us()).err().unwrap().undeclared,
        Some("first_pulse"),
        "evenly spaced lines show no wrong one"
    );
    let pictures = open(&folder, "a.png 10\nx.png 20\nc.png 30\n", &us()).unwrap();
    assert_eq!((at(&pictures), firsts(&pictures)), (vec![10_000, 30_000], vec![0.0, 2.0]));
}

#[test]
fn no_stamps_are_asked_for() {
    let folder = folder(&["a.png"]);
    assert_eq!(
        PictureFiles::open(folder.path(), &Declared::default()).err().unwrap().undeclared,
        Some("stamps")
    );
    let elsewhere = tempfile::tempdir().unwrap();
    let stamps = elsewhere.path().join("s.txt");
    std::fs::write(&stamps, "7\n").unwrap();
    let pictures =
        PictureFiles::open(folder.path(), &Declared { stamps: Some(stamps.clone()), ..us() }).unwrap();
    assert_eq!(pictures.files(), [folder.path().join("a.png"), stamps]);
}

#[test]
fn damaged_and_odd_pictures_are_losses() {
    let folder = folder(&["a.png", "b.png", "c.png", "d.png"]);
    std::fs::write(folder.path().join("b.png"), b"\x89PNG\r\n\x1a\n....").unwrap();
    write_png(&folder.path().join("c.png"), 3, 1, &[9; 3], png::ColorType::Grayscale);
    let pictures = open(&folder, "1\n2\n3\n4\n", &us()).unwrap();
    assert_eq!(
        (at(&pictures), firsts(&pictures)),
        (vec![1000, 4000], vec![0.0, 3.0]),
        "the others keep their stamps"
    );
    let losses: Vec<&str> = pictures.losses().iter().map(|loss| loss.at.as_str()).collect();
    assert_eq!(losses, ["b.png", "c.png"]);
}

#[test]
fn pictures_that_are_cut_off_are_losses_and_keep_their_place_in_the_order() {
    let folder = tempfile::tempdir().unwrap();
    let noise: Vec<u8> = (0..64 * 64).map(|n: u32| (n.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    for n in 0..5 {
        write_png(&folder.path().join(format!("{n}.png")), 64, 64, &noise, png::ColorType::Grayscale);
    }
    let cut = |name: &str, to: &dyn Fn(usize) -> usize| {
        let path = folder.path().join(name);
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, &whole[..to(whole.len())]).unwrap();
    };
    cut("1.png", &|length| length / 2);
    // Without its last chunk alone; and of a length that was reserved and never written, as after a loss of
    // power.
    cut("3.png", &|length| length - 12);
    let path = folder.path().join("4.png");
    let mut content = std::fs::read(&path).unwrap();
    let half = content.len() / 2;
    content[half..].fill(0);
    std::fs::write(&path, content).unwrap();
    let pictures = open(&folder, "1\n2\n3\n4\n5\n", &us()).unwrap();
    assert_eq!(at(&pictures), [1000, 3000]);
    let losses: Vec<(&str, bool)> =
        pictures.losses().iter().map(|loss| (loss.at.as_str(), loss.what.contains("cut off"))).collect();
    assert_eq!(losses, [("1.png", true), ("3.png", true), ("4.png", false)], "{:?}", pictures.losses());
    let tiff = folder.path().join("a.tif");
    std::fs::write(&tiff, &bytes(RGB_TIFF)[..20]).unwrap();
    assert!(super::decode::head(&tiff).is_err());
    let mut content = bytes(RGB_TIFF);
    // The count of bytes of its one strip, 20, becomes 2000.
    let at = content.windows(12).position(|entry| entry[..2] == [0x17, 1]).unwrap();
    content[at + 8..at + 10].copy_from_slice(&2000_u16.to_le_bytes());
    std::fs::write(&tiff, content).unwrap();
    assert!(super::decode::head(&tiff).unwrap_err().found.contains("cut off"));
}

#[test]
fn depths_and_colours_keep_their_stored_values() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let read = |path: &Path| {
        let mut values = Vec::new();
        super::decode::read(path, &mut values).map(|head| (values, head.bits, head.colour))
    };
    write_png_of(&path, 2, 1, &[1, 2, 255, 255], png::ColorType::Grayscale, png::BitDepth::Sixteen);
    assert_eq!(read(&path).unwrap(), (vec![258.0, 65_535.0], 16, Colour::Mono));
    write_png(&path, 1, 1, &[1, 2, 3, 99], png::ColorType::Rgba);
    assert_eq!(read(&path).unwrap(), (vec![1.0, 2.0, 3.0], 8, Colour::Rgb));
    write_png(&path, 1, 1, &[7, 99], png::ColorType::GrayscaleAlpha);
    assert_eq!(read(&path).unwrap(), (vec![7.0], 8, Colour::Mono));
    write_png_of(&path, 8, 1, &[0b1010_0000], png::ColorType::Grayscale, png::BitDepth::One);
    assert_eq!(read(&path).unwrap().0, [255.0, 0.0, 255.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let path = folder.path().join("a.tif");
    std::fs::write(&path, bytes(GREY_TIFF)).unwrap();
    assert_eq!(read(&path).unwrap(), (vec![1.0, 300.0, 65_535.0, 4.0], 16, Colour::Mono));
    std::fs::write(&path, bytes(RGB_TIFF)).unwrap();
    assert_eq!(read(&path).unwrap(), (vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0], 8, Colour::Rgb));
}

#[test]
fn a_picture_that_claims_to_be_huge_takes_no_memory() {
    let folder = folder(&["a.png"]);
    let path = folder.path().join("a.png");
    let mut content = std::fs::read(&path).unwrap();
    // The size in IHDR, and its checksum.
    content[16..24].copy_from_slice(&[0x00, 0x7f, 0xff, 0xff, 0x00, 0x7f, 0xff, 0xff]);
    let mut crc = flate2::Crc::new();
    crc.update(&content[12..29]);
    content[29..33].copy_from_slice(&crc.sum().to_be_bytes());
    std::fs::write(&path, content).unwrap();
    let error = super::decode::head(&path).unwrap_err();
    assert!(error.found.contains("cannot hold"), "{error}");
}

#[test]
fn names_are_sorted_as_people_count() {
    let mut found =
        ["f10.png", "f2.png", "f2b.png", "F1.png", "f02.png", "f0010.png", "f.png", "f2.10.png", "f2.9.png"]
            .map(PathBuf::from);
    names::sort(&mut found);
    let expected =
        ["F1.png", "f.png", "f2.9.png", "f2.10.png", "f02.png", "f2.png", "f2b.png", "f0010.png", "f10.png"];
    assert_eq!(found, expected.map(PathBuf::from));
}

fn y4m(header: &str, frames: &[&[u8]]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("video.y4m");
    let mut content = format!("YUV4MPEG2 {header}\n").into_bytes();
    for frame in frames {
        content.extend(b"FRAME\n");
        content.extend(*frame);
    }
    std::fs::write(&path, content).unwrap();
    (folder, path)
}

#[test]
fn a_grey_video_has_its_luma_and_the_rate_of_its_header() {
    let (_folder, path) = y4m("W2 H1 F30000:1001 Ip A1:1 Cmono", &[&[1, 2], &[3, 4], &[5]]);
    assert_eq!(recognise(&path).unwrap().map(|format| format.id), Some("pictures"));
    let pictures = PictureFiles::open(&path, &Declared::default()).unwrap();
    assert_eq!((at(&pictures), firsts(&pictures)), (vec![0, 33_366_667], vec![1.0, 3.0]));
    assert!(pictures.about().notes.iter().any(|note| note.contains("constant rate, 30000/1001")));
    assert!(pictures.losses()[0].what.contains("frame 2 is cut off"), "{:?}", pictures.losses());
    std::fs::write(path.with_extension("txt"), "# in us\n5\n90005\n").unwrap();
    let pictures = PictureFiles::open(&path, &Declared::default()).unwrap();
    assert_eq!(at(&pictures), [5000, 90_005_000]);
    assert!(
        pictures
            .about()
            .notes
            .iter()
            .any(|note| note.contains("33366667 ns, the stamps' mostly 90000000 ns")),
        "{:?}",
        pictures.about().notes
    );
}

#[test]
fn what_a_header_leaves_open_is_noted() {
    let notes = |header: &str| {
        let (_folder, path) = y4m(header, &[&[16; 3]]);
        super::y4m::Y4m::open(&path).unwrap().notes()
    };
    let notes = |header: &str, what: &str| notes(header).iter().filter(|note| note.contains(what)).count();
    assert_eq!(notes("W1 H1 F1:1 C444", "limited was taken: 16 to 235"), 1);
    assert_eq!(notes("W1 H1 F1:1 C444", "BT.709: the header states no matrix"), 1);
    assert_eq!(notes("W1 H1 F1:1 C444 XCOLORSPACE=BT601", "no matrix (`XCOLORSPACE=BT601` is not known)"), 1);
    assert_eq!(notes("W1 H1 F1:1 C444 It", "interlaced (`It`)"), 1);
    assert_eq!(notes("W3 H1 F1:1 Ip Cmono", "BT.709") + notes("W3 H1 F1:1 Ip Cmono", "interlaced"), 0);
}

#[test]
fn colour_is_converted_by_bt_709_in_both_ranges() {
    let read = |header: &str, frame: &[u8]| {
        let (_folder, path) = y4m(header, &[frame]);
        let pictures = PictureFiles::open(&path, &Declared::default()).unwrap();
        let mut values = Vec::new();
        pictures.read(0, &mut values).unwrap();
        values.iter().map(|value| value.round()).collect::<Vec<_>>()
    };
    // Limited range: white is 235, black 16; red is Y 63, Cb 102, Cr 240 (ITU-R BT.709, rounded).
    assert_eq!(
        read(
            "W2 H2 F25:1 C444 XCOLORRANGE=LIMITED",
            &[235, 16, 63, 126, 128, 128, 102, 128, 128, 128, 240, 128]
        ),
        { [255, 255, 255, 0, 0, 0, 255, 1, 0, 128, 128, 128].map(|value| value as f32).to_vec() }
    );
    // The same red of 10 bits: Y 250, Cb 409, Cr 960, low byte first.
    assert_eq!(read("W1 H1 F25:1 C444p10", &[250, 0, 0x99, 0x01, 0xc0, 0x03]), [1023.0, 0.0, 0.0]);
    // Full range: red is Y 54, Cb 99, Cr 255.
    let red = read("W2 H2 F25:1 C420jpeg XCOLORRANGE=FULL", &[54, 54, 54, 54, 99, 255]);
    assert!(red.chunks(3).all(|pixel| pixel[0] >= 253.0 && pixel[1] <= 1.0 && pixel[2] <= 1.0), "{red:?}");
    assert_eq!(read("W1 H1 F1:1 Cmono10", &[0xff, 0x03]), [1023.0]);
}

fn edge(t: i64, rising: bool) -> Trigger {
    Trigger { t, line: 0, edge: if rising { Edge::Rising } else { Edge::Falling } }
}

/// Exposures of a line where rising opens.
fn exposures_from_triggers(triggers: &[Trigger], line: u16) -> (Vec<(i64, i64)>, Vec<String>) {
    let found = pulses(triggers, line, Strobe::ActiveHigh);
    (found.all.iter().filter_map(|pulse| pulse.exposure).collect(), found.notes)
}

#[test]
fn edges_become_exposures_and_missing_ones_are_counted() {
    let whole: Vec<Trigger> =
        (0..10).flat_map(|k| [edge(1_000_000 * k, true), edge(1_000_000 * k + 400_000, false)]).collect();
    let (exposures, notes) = exposures_from_triggers(&whole, 0);
    assert_eq!((exposures.len(), exposures[3], notes.len()), (10, (3_000_000, 3_400_000), 0));
    let without = |gone: usize| {
        whole
            .iter()
            .enumerate()
            .filter(|(index, _)| *index != gone)
            .map(|(_, edge)| *edge)
            .collect::<Vec<_>>()
    };
    let (exposures, notes) = exposures_from_triggers(&without(7), 0);
    assert_eq!(
        exposures.iter().map(|exposure| exposure.0 / 1_000_000).collect::<Vec<_>>(),
        [0, 1, 2, 4, 5, 6, 7, 8, 9]
    );
    assert!(
        notes[0].contains("1 falling edges of line 0 are missing (the first at 4000000 ns)"),
        "{notes:?}"
    );
    let (exposures, notes) = exposures_from_triggers(&without(6), 0);
    assert_eq!((exposures.len(), notes[0].contains("1 rising edges")), (9, true), "{notes:?}");
    let mut bounced = whole.clone();
    bounced.insert(5, edge(2_000_300, true));
    let (exposures, notes) = exposures_from_triggers(&bounced, 0);
    assert_eq!(
        (exposures.len(), exposures[2].0, notes[0].contains("spurious")),
        (10, 2_000_000, true),
        "{notes:?}"
    );
    let (exposures, notes) = exposures_from_triggers(&whole[1..19], 0);
    assert_eq!((exposures.len(), notes.len()), (8, 2), "{notes:?}");
    // Stamps as far apart as 64 bits allow; found by chance.
    assert!(
        exposures_from_triggers(
            &[edge(172_556_990_397_798_370, false), edge(-9_050_815_046_456_977_438, false)],
            0
        )
        .0
        .is_empty()
    );
    assert!(exposures_from_triggers(&whole, 3).1[0].contains("lines with edges: [0]"));
}

/// An event recording with triggers and no events.
struct OnlyTriggers(Vec<Trigger>);

impl Recording for OnlyTriggers {
    fn events_about(&self) -> Option<&EventsAbout> {
        None
    }
    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        Err(FormatError::new(Path::new("x.raw"), "no events", "none"))
    }
    fn triggers(&self) -> Result<Vec<Trigger>, FormatError> {
        Ok(self.0.clone())
    }
    fn files(&self) -> Vec<PathBuf> {
        vec!["x.raw".into()]
    }
}

#[test]
fn events_are_joined_with_pictures_by_trigger_edges() {
    let folder = folder(&["a.png", "b.png"]);
    let events =
        || Box::new(OnlyTriggers(vec![edge(10, true), edge(15, false), edge(1000, true), edge(1005, false)]));
    let declared =
        Declared { frames: Some(folder.path().into()), trigger_line: Some(0), ..Declared::default() };
    let joined = with_declared_frames(events(), &declared).unwrap();
    let frames = joined.pictures().unwrap();
    assert_eq!(
        frames.about().stamps.iter().map(|stamp| stamp.exposure).collect::<Vec<_>>(),
        [Some((10, 15)), Some((1000, 1005))]
    );
    assert_eq!(
        (frames.about().stamp_role, firsts(frames.as_ref())),
        (Some(StampRole::Start), vec![0.0, 1.0])
    );
    assert_eq!(joined.files().len(), 3);
    let error = Joined::new(events(), folder.path(), &Declared::default()).err().unwrap();
    assert_eq!(error.undeclared, Some("stamps"));
    assert!(error.found.contains("2 rising and 2 falling edges on trigger line 0"), "{error}");
    let error =
        Joined::new(events(), folder.path(), &Declared { trigger_line: Some(4), ..Declared::default() })
            .err()
            .unwrap();
    assert_eq!(error.undeclared, Some("trigger_line"));
}

#[test]
fn an_event_camera_dataset_folder_is_read() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("images")).unwrap();
    for n in 0..2 {
        write_png(
            &folder.path().join(format!("images/frame_{n:08}.png")),
            4,
            3,
            &[n; 12],
            png::ColorType::Grayscale,
        );
    }
    std::fs::write(
        folder.path().join("events.txt"),
        "0.003811000 3 2 0\n0.003820001 0 1 1\n0.003820001 4 1 1\n",
    )
    .unwrap();
    std::fs::write(
        folder.path().join("images.txt"),
        "0.000000 images/frame_00000000.png\n0.043889 images/frame_00000001.png\n",
    )
    .unwrap();
    std::fs::write(folder.path().join("calib.txt"), "199.0 198.8 132.1 110.7 -0.36 0.15 -0.0003 -0.0004 0\n")
        .unwrap();
    assert_eq!(recognise(folder.path()).unwrap().map(|format| format.id), Some("ecd"));
    let recording = EventCameraDataset::open(folder.path(), &Declared::default()).unwrap();
    assert_eq!(recording.events_about().unwrap().extent, Some(Extent { width: 4, height: 3 }));
    let (events, losses) = collect(&recording);
    assert_eq!((events.t, events.x, events.on), (vec![3_811_000, 3_820_001], vec![3, 0], vec![0, 1]));
    assert_eq!((losses.len(), losses[0].at.as_str()), (1, "line 3"));
    let frames = recording.pictures().unwrap();
    assert_eq!(
        (frames.about().stamps[1].at, frames.about().stamp_role, firsts(frames.as_ref())),
        (43_889_000, None, vec![0.0, 1.0])
    );
    assert_eq!((recording.files().len(), recording.facts().len()), (5, 1));
}

proptest! {
    #[test]
    fn no_stamps_file_panics(
        text in proptest::collection::vec(
            prop_oneof![Just(b'\n'), Just(b','), Just(b' '), Just(b'#'), Just(b'1'), Just(b'.'), any::<u8>()],
            0..300,
        ),
    ) {
        for declared in [Declared::default(), us()] {
            if let Ok(Stamps { rows, .. }) = stamps::parse(Path::new("s.txt"), &text, &declared, None) {
                for surplus in 0..4 {
                    let _ = stamps::leading_wrong(&rows, surplus);
                }
            }
        }
    }

    #[test]
    fn no_damaged_picture_panics(
        which in 0_usize..4,
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..5),
    ) {
        let folder = folder(&["a.png"]);
        let (name, mut content) = match which {
            0 => ("a.png", std::fs::read(folder.path().join("a.png")).unwrap()),
            1 => ("a.tif", bytes(GREY_TIFF)),
            2 => ("a.tif", bytes(RGB_TIFF)),
            _ => ("a.y4m", b"YUV4MPEG2 W2 H2 F30:1 C420\nFRAME\n123456FRAME\n123456".to_vec()),
        };
        for (at, byte) in changes {
            let at = at.index(content.len());
            content[at] = byte;
        }
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        let mut values = Vec::new();
        if which == 3 {
            if let Ok(video) = super::y4m::Y4m::open(&path) {
                let _ = (video.at(1), video.read(0, &mut values));
            }
        } else {
            let _ = super::decode::read(&path, &mut values);
        }
    }

    #[test]
    fn any_edges_give_exposures_in_order(
        edges in proptest::collection::vec((any::<i64>(), any::<bool>()), 0..40),
    ) {
        let triggers: Vec<Trigger> = edges.into_iter().map(|(t, rising)| edge(t, rising)).collect();
        let (exposures, _) = exposures_from_triggers(&triggers, 0);
        prop_assert!(exposures.iter().all(|(open, close)| open <= close));
    }
}
