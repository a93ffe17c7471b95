//! Tests of stored pictures: transfer curves, crops and averages, PNG and Y4M bytes written by hand.

use super::folder::Pictures;
use super::y4m::Y4m;
use super::*;
use photocurrent_formats::ycbcr::Range;
use png::{BitDepth, ColorType};
use std::path::PathBuf;

/// Writes a PNG picture.
pub(crate) fn save(path: &Path, width: u32, height: u32, form: (ColorType, BitDepth), bytes: &[u8]) {
    let mut encoder = png::Encoder::new(std::fs::File::create(path).unwrap(), width, height);
    encoder.set_color(form.0);
    encoder.set_depth(form.1);
    encoder.write_header().unwrap().write_image_data(bytes).unwrap();
}

/// Bytes of 16-bit values.
pub(crate) fn wide(values: &[u16]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_be_bytes()).collect()
}

fn rows(film: &dyn Film, frame: usize, rows: Rows) -> Result<Vec<f64>, NodeError> {
    let mut light = Vec::new();
    film.read(frame, rows, &mut |row| light.extend_from_slice(row))?;
    Ok(light)
}

fn whole(film: &dyn Film, frame: usize) -> Vec<f64> {
    rows(film, frame, film.extent().rows()).unwrap()
}

fn near(found: &[f64], expected: &[f64], tolerance: f64) {
    assert!(
        found.len() == expected.len() && found.iter().zip(expected).all(|(f, e)| (f - e).abs() <= tolerance),
        "{found:?}, {expected:?} expected"
    );
}

#[test]
fn transfer_curves_undo_those_of_the_standards() {
    for k in 0..=1000 {
        let light = f64::from(k) / 1000.0;
        let bt709 = if light < 0.018 { 4.5 * light } else { 1.099 * libm::pow(light, 0.45) - 0.099 };
        let srgb =
            if light <= 0.0031308 { 12.92 * light } else { 1.055 * libm::pow(light, 1.0 / 2.4) - 0.055 };
        // The standards' constants are rounded: where their pieces meet, they do so to four digits.
        near(&[Transfer::Bt709.light(bt709), Transfer::Srgb.light(srgb)], &[light, light], 2e-4);
        if light > 0.02 {
            near(&[Transfer::Bt709.light(bt709), Transfer::Srgb.light(srgb)], &[light, light], 1e-12);
        }
    }
    assert_eq!([-0.1, 0.0, 1.0].map(|stored| Transfer::Bt709.light(stored)), [0.0, 0.0, 1.0]);
}

fn picture(folder: &Path, width: u32, height: u32, form: (ColorType, BitDepth), bytes: &[u8]) -> Pictures {
    let path = folder.join("a.png");
    save(&path, width, height, form, bytes);
    Pictures::open(vec![path], Transfer::Linear).unwrap()
}

#[test]
fn pictures_of_every_form_are_relative_light() {
    let folder = tempfile::tempdir().unwrap();
    let grey = picture(folder.path(), 2, 2, (ColorType::Grayscale, BitDepth::Eight), &[0, 51, 102, 255]);
    assert_eq!(whole(&grey, 0), [0.0, 0.2, 0.4, 1.0]);
    assert_eq!(rows(&grey, 0, Rows { start: 1, end: 2 }).unwrap(), [0.4, 1.0]);
    let deep =
        picture(folder.path(), 3, 1, (ColorType::Grayscale, BitDepth::Sixteen), &wide(&[0, 13107, 65535]));
    assert_eq!(whole(&deep, 0), [0.0, 0.2, 1.0]);
    let bits = picture(folder.path(), 8, 1, (ColorType::Grayscale, BitDepth::One), &[0b1010_0001]);
    assert_eq!(whole(&bits, 0), [1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    let colours = picture(
        folder.path(),
        4,
        1,
        (ColorType::Rgb, BitDepth::Eight),
        &[255, 0, 0, 0, 255, 0, 0, 0, 255, 51, 51, 51],
    );
    assert_eq!(whole(&colours, 0), [0.2126, 0.7152, 0.0722, 0.2]);
    let deep_colours =
        picture(folder.path(), 1, 1, (ColorType::Rgb, BitDepth::Sixteen), &wide(&[65535, 65535, 0]));
    assert_eq!(whole(&deep_colours, 0), [0.2126 + 0.7152]);
}

#[test]
fn interlaced_pictures_and_palettes_are_read_too() {
    let folder = tempfile::tempdir().unwrap();
    // 5 x 4 pixels of value 10 y + x, interlaced (Adam7), as zlib and the PNG specification make it.
    let adam7 = "89504e470d0a1a0a0000000d4948445200000005000000040800000001145f9a0a000000244944415478da636060\
                 6061606210119360606466101567e0e2e6e1e5\
                 63909357505402000c4c0155cc3cbec10000000049454e44ae426082";
    let bytes: Vec<u8> =
        (0..adam7.len()).step_by(2).map(|at| u8::from_str_radix(&adam7[at..at + 2], 16).unwrap()).collect();
    std::fs::write(folder.path().join("a.png"), bytes).unwrap();
    let film = Pictures::open(vec![folder.path().join("a.png")], Transfer::Linear).unwrap();
    let expected: Vec<f64> =
        (1..3).flat_map(|y| (0..5).map(move |x| f64::from(10 * y + x) / 255.0)).collect();
    assert_eq!(rows(&film, 0, Rows { start: 1, end: 3 }).unwrap(), expected);
    let path = folder.path().join("p.png");
    let mut encoder = png::Encoder::new(std::fs::File::create(&path).unwrap(), 3, 1);
    encoder.set_color(ColorType::Indexed);
    encoder.set_palette(vec![255, 0, 0, 0, 255, 0, 51, 51, 51]);
    encoder.write_header().unwrap().write_image_data(&[2, 0, 1]).unwrap();
    assert_eq!(whole(&Pictures::open(vec![path], Transfer::Linear).unwrap(), 0), [0.2, 0.2126, 0.7152]);
}

#[test]
fn tiff_pictures_are_light_too() {
    let folder = tempfile::tempdir().unwrap();
    // TIFF 6.0 by hand: 2 x 2 grey values of 16 bits in one strip, little-endian.
    let mut tiff = b"II*\0\x08\0\0\0\x08\0".to_vec();
    let entries = [(256, 2), (257, 2), (258, 16), (259, 1), (262, 1), (273, 110), (277, 1), (279, 8)];
    for (tag, value) in entries.map(|(tag, value): (u16, u32)| (tag.to_le_bytes(), value.to_le_bytes())) {
        tiff.extend([&tag[..], &[4, 0, 1, 0, 0, 0], &value].concat());
    }
    tiff.extend([0; 4]);
    assert_eq!(tiff.len(), 110);
    tiff.extend([0, 13_107, 26_214, 65_535_u16].into_iter().flat_map(u16::to_le_bytes));
    let path = folder.path().join("a.tif");
    std::fs::write(&path, tiff).unwrap();
    let film = Pictures::open(vec![path], Transfer::Linear).unwrap();
    assert_eq!(
        (whole(&film, 0), rows(&film, 0, Rows { start: 1, end: 2 }).unwrap()),
        (vec![0.0, 0.2, 0.4, 1.0], vec![0.4, 1.0])
    );
    assert!(
        rows(&film, 0, Rows { start: 1, end: 3 })
            .unwrap_err()
            .message
            .starts_with("a.tif: the picture cannot be read: it ends after 2 rows")
    );
}

#[test]
fn transparent_damaged_and_differing_pictures_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let refused = |paths: Vec<PathBuf>| Pictures::open(paths, Transfer::Srgb).err().unwrap().message;
    save(&path("clear.png"), 1, 1, (ColorType::Rgba, BitDepth::Eight), &[1, 2, 3, 4]);
    assert_eq!(refused(vec![path("clear.png")]), "clear.png has transparency, and light has none");
    std::fs::write(path("text.png"), "no picture").unwrap();
    assert!(refused(vec![path("text.png")]).starts_with("text.png: the picture cannot be read: "));
    save(&path("a.png"), 3, 2, (ColorType::Grayscale, BitDepth::Eight), &[0; 6]);
    save(&path("b.png"), 3, 3, (ColorType::Grayscale, BitDepth::Eight), &[0; 9]);
    assert_eq!(
        refused(vec![path("a.png"), path("a.png"), path("b.png")]),
        "b.png has 3 x 3 pixels, and a.png has 3 x 2"
    );
    assert!(refused(vec![path("gone.png")]).ends_with("gone.png: there is no such file"));
    // Cut off inside its pixels: that shows before anything is decoded. Changed there: only decoding finds
    // it.
    let noise: Vec<u8> = (0..64 * 64u32).map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    save(&path("cut.png"), 64, 64, (ColorType::Grayscale, BitDepth::Eight), &noise);
    let mut bytes = std::fs::read(path("cut.png")).unwrap();
    std::fs::write(path("cut.png"), &bytes[..bytes.len() / 2]).unwrap();
    let cut = refused(vec![path("cut.png")]);
    assert!(cut.starts_with("cut.png: the picture cannot be read: it is cut off: "), "{cut}");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0xff;
    std::fs::write(path("changed.png"), &bytes).unwrap();
    let changed = Pictures::open(vec![path("changed.png")], Transfer::Srgb).unwrap();
    let error = rows(&changed, 0, Rows { start: 0, end: 64 }).unwrap_err();
    assert!(error.message.starts_with("changed.png: the picture cannot be read: "), "{error}");
}

#[test]
fn a_window_averages_squares_of_its_crop_in_linear_light() {
    let folder = tempfile::tempdir().unwrap();
    // Columns count 0 to 5, rows tens.
    let values: Vec<u8> = (0..5).flat_map(|y| (0..6).map(move |x| 10 * y + x)).collect();
    let film = picture(folder.path(), 6, 5, (ColorType::Grayscale, BitDepth::Eight), &values);
    let window =
        Window::new(film.extent(), Some(Crop { x: 1, y: 1, width: 4, height: 4 }), Some(2), None).unwrap();
    assert_eq!(window.extent(), Extent { width: 2, height: 2 });
    // The mean over a square of 2 x 2 from (x, y) on: 10 y + x + 5.5.
    let light = window.read(&film, 0, Rows { start: 0, end: 2 }).unwrap();
    near(&light, &[16.5, 18.5, 36.5, 38.5].map(|value| value / 255.0), 1e-15);
    assert_eq!(window.read(&film, 0, Rows { start: 1, end: 2 }).unwrap(), light[2..]);
}

#[test]
fn windows_that_do_not_fit_are_refused() {
    let stored = Extent { width: 12, height: 8 };
    let refused = |crop, width, height| Window::new(stored, crop, width, height).unwrap_err();
    let outside = refused(Some(Crop { x: 4, y: 0, width: 9, height: 8 }), None, None);
    assert_eq!(
        (outside.message.as_str(), outside.param.as_deref()),
        ("`crop` asks for 9 x 8 pixels at (4, 0), and the pictures have 12 x 8", Some("crop"))
    );
    let uneven = refused(None, Some(5), None);
    assert_eq!(uneven.message, "12 x 8 pixels do not shrink to a width of 5 by one whole factor");
    assert_eq!(uneven.hint.as_deref(), Some("it shrinks to 6 x 4, 3 x 2; for others, name a `crop` first"));
    assert_eq!(
        refused(None, Some(6), Some(8)).message,
        "12 x 8 pixels do not shrink to 6 x 8 by one whole factor"
    );
    // A stretch is no shrinking.
    assert_eq!(refused(None, None, Some(16)).param.as_deref(), Some("height"));
    assert_eq!(Window::new(stored, None, None, Some(2)).unwrap().extent(), Extent { width: 3, height: 2 });
}

fn y4m(folder: &Path, bytes: &[u8], transfer: Transfer) -> Result<Y4m, NodeError> {
    let path = folder.join("film.y4m");
    std::fs::write(&path, bytes).unwrap();
    Y4m::open(&path, transfer, None)
}

fn film_of(header: &str, frames: &[&[u8]]) -> Vec<u8> {
    let mut bytes = format!("YUV4MPEG2 {header}\n").into_bytes();
    for frame in frames {
        bytes.extend_from_slice(b"FRAME\n");
        bytes.extend_from_slice(frame);
    }
    bytes
}

#[test]
fn grey_of_every_layout_is_luma_between_black_and_white() {
    let folder = tempfile::tempdir().unwrap();
    // 3 x 2 pixels: black, a fifth, white in limited range; chroma planes round up.
    let luma = [16, 16 + 44, 235, 235, 16, 16];
    let light = [0.0, 44.0 / 219.0, 1.0, 1.0, 0.0, 0.0];
    for (name, chroma) in [
        ("mono", 0),
        ("420jpeg", 2 * 2),
        ("420", 4),
        ("422", 2 * 4),
        ("411", 4),
        ("440", 2 * 3),
        ("444", 2 * 6),
    ] {
        let frame: Vec<u8> = luma.into_iter().chain(vec![128; chroma]).collect();
        let film = y4m(
            folder.path(),
            &film_of(&format!("W3 H2 F25:1 Ip A1:1 C{name}"), &[&frame, &frame]),
            Transfer::Linear,
        )
        .unwrap();
        assert_eq!(film.frames(), 2, "{name}");
        near(&whole(&film, 1), &light, 1e-15);
        assert_eq!(rows(&film, 0, Rows { start: 1, end: 2 }).unwrap(), whole(&film, 0)[3..]);
    }
    for (name, bits, chroma) in [("mono10", 10, 0), ("420p10", 10, 4), ("422p12", 12, 8), ("444p16", 16, 12)]
    {
        let wider = |value: u8| (u16::from(value) << (bits - 8)).to_le_bytes();
        let frame: Vec<u8> = luma.into_iter().chain(vec![128; chroma]).flat_map(wider).collect();
        let film = y4m(folder.path(), &film_of(&format!("W3 H2 F25:1 C{name}"), &[&frame]), Transfer::Linear)
            .unwrap();
        near(&whole(&film, 0), &light, 1e-15);
    }
    let full =
        y4m(folder.path(), &film_of("W2 H1 F25:1 Cmono XCOLORRANGE=FULL", &[&[51, 255]]), Transfer::Linear)
            .unwrap();
    assert_eq!(whole(&full, 0), [0.2, 1.0]);
    // What is stated of a film wins over its header.
    let path = folder.path().join("film.y4m");
    near(
        &whole(&Y4m::open(&path, Transfer::Linear, Some(Range::Limited)).unwrap(), 0),
        &[35.0 / 219.0, 239.0 / 219.0],
        1e-15,
    );
    assert_eq!(full.notes(), [""; 0]);
    let silent = y4m(folder.path(), &film_of("W2 H1 F25:1 C444", &[&[128; 6]]), Transfer::Linear).unwrap();
    let expected = [
        "film.y4m does not state the range of its values; taken as limited (`range`)",
        "film.y4m does not state the matrix of its colours; taken as that of BT.709",
    ];
    assert_eq!(silent.notes(), expected);
}

#[test]
fn pure_colours_have_their_luminance() {
    let folder = tempfile::tempdir().unwrap();
    // Y, Cb, Cr of red, green, blue by the table of BT.709, each a column of two pixels in 4:2:2.
    let (luma, blue, red) = ([63, 63, 173, 173, 32, 32], [102, 42, 240], [240, 26, 118]);
    let frame: Vec<u8> = luma.into_iter().chain(blue).chain(red).collect();
    let film = y4m(folder.path(), &film_of("W6 H1 F25:1 C422", &[&frame]), Transfer::Bt709).unwrap();
    // Half a step of 8 bits is up to 1 percent of light at the bright end.
    near(&whole(&film, 0), &[0.2126, 0.2126, 0.7152, 0.7152, 0.0722, 0.0722], 0.01);
}

#[test]
fn frame_lines_with_parameters_and_rates_are_understood() {
    let folder = tempfile::tempdir().unwrap();
    let mut bytes = film_of("W1 H1 F30000:1001 Cmono", &[&[16]]);
    bytes.extend_from_slice(b"FRAME Ip XNOTE=a\n\xeb");
    let film = y4m(folder.path(), &bytes, Transfer::Linear).unwrap();
    assert_eq!((whole(&film, 0), whole(&film, 1)), (vec![0.0], vec![1.0]));
    assert_eq!(film.rate(), Some(30000.0 / 1001.0));
    assert_eq!(
        y4m(folder.path(), &film_of("W1 H1 F0:0 Cmono", &[&[16]]), Transfer::Linear).unwrap().rate(),
        None
    );
}

#[test]
fn what_cannot_be_read_as_y4m_is_named_with_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |bytes: &[u8]| y4m(folder.path(), bytes, Transfer::Linear).err().unwrap().message;
    let good = film_of("W4 H2 F25:1 Cmono", &[&[16; 8], &[16; 8]]);
    // The header has 28 bytes, a frame 6 + 8: the second begins at 42 and ends at 56.
    assert_eq!(good.len(), 56);
    let cut = |bytes: u32| {
        format!(
            "film.y4m: it is cut off: frame 1 begins at byte 42 and needs the bytes up to 56, and the \
                 file has {bytes}; whole frames before it: 1"
        )
    };
    assert_eq!(refused(&good[..55]), cut(55));
    assert_eq!(refused(&good[..48]), cut(48));
    let head = "film.y4m: it is cut off: it ends at the head of frame 1, which begins at byte 42 of 45; \
                whole frames before it: 1";
    assert_eq!(refused(&good[..45]), head);
    assert_eq!(refused(b"YUV4MPEG2 W4 H2"), "film.y4m: it is cut off: its header has no end within 15 bytes");
    assert_eq!(
        refused(&film_of("W4 H2 F25:1 It Cmono", &[])),
        "the header of film.y4m says that its frames are interlaced (`It`)"
    );
    assert_eq!(
        refused(&film_of("W4 H2 F25:1 C444alpha", &[])),
        "film.y4m has transparency, and light has none"
    );
    assert_eq!(
        refused(&film_of("W4 H2 F25:1 C410", &[])),
        "film.y4m: the header: it names the colour space `410`"
    );
    assert_eq!(
        refused(&film_of("W4 F25:1", &[])),
        "film.y4m: the header: it states no size that can be: `YUV4MPEG2 W4 F25:1`"
    );
    let shifted = film_of("W4 H2 F25:1 Cmono", &[&[16; 9], &[16; 9]]);
    let other = "film.y4m: it has no frame where one should begin: at byte 42; a frame of 4 x 2 pixels has \
                 8 bytes by the header; whole frames before it: 1";
    assert_eq!(refused(&shifted), other);
}
