//! JPEG pictures written by Pillow, `data/formats/make_jpeg.py`, read here; cut and changed.

use super::decode::{Coding, head_of, read_of};
use super::jpeg;
use photocurrent_core::{Colour, Extent};
use std::path::Path;

fn picture(name: &str) -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/formats").join(name)).unwrap()
}

const EXTENT: Extent = Extent { width: 16, height: 8 };

#[test]
fn grey_and_colour_come_as_they_were_up_to_what_jpeg_loses() {
    let mut values = Vec::new();
    let head = jpeg::read(&picture("grey.jpg"), &mut values).unwrap();
    assert_eq!((head.extent, head.colour, head.bits, values.len()), (EXTENT, Colour::Mono, 8, 128));
    for (k, value) in values.iter().enumerate() {
        let (x, y) = ((k % 16) as f32, (k / 16) as f32);
        assert!((value - 10.0 * x - 5.0 * y).abs() <= 2.0, "{x} {y}: {value}");
    }
    for name in ["colour.jpg", "progressive.jpg"] {
        let head = jpeg::read(&picture(name), &mut values).unwrap();
        assert_eq!((head.extent, head.colour, values.len()), (EXTENT, Colour::Rgb, 384));
        for (k, pixel) in values.as_chunks::<3>().0.iter().enumerate() {
            let (x, y) = ((k % 16) as f32, (k / 16) as f32);
            let off =
                pixel.iter().zip([200.0, 12.0 * x, 20.0 * y]).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(off <= 6.0, "{name}, {x} {y}: {pixel:?}");
        }
    }
}

#[test]
fn a_picture_cut_anywhere_is_refused_and_never_half_grey() {
    for name in ["grey.jpg", "colour.jpg", "progressive.jpg"] {
        let whole = picture(name);
        let mut values = Vec::new();
        for length in 0..whole.len() - 2 {
            assert!(
                jpeg::read(&whole[..length], &mut values).is_err(),
                "{name}, {length} of {} bytes",
                whole.len()
            );
        }
    }
}

#[test]
fn a_size_that_the_bytes_cannot_hold_is_refused_before_memory_is_taken() {
    let mut bytes = picture("grey.jpg");
    let frame = bytes.windows(2).position(|pair| pair == [0xff, 0xc0]).unwrap();
    bytes[frame + 5..frame + 9].copy_from_slice(&[0xff; 4]);
    let error = jpeg::read(&bytes, &mut Vec::new()).unwrap_err();
    assert!(error.contains("65535 x 65535") || error.to_lowercase().contains("width"), "{error}");
}

#[test]
fn changed_bytes_are_survived_and_a_beginning_states_the_head() {
    let mut values = Vec::new();
    for name in ["grey.jpg", "colour.jpg", "progressive.jpg"] {
        let whole = picture(name);
        assert_eq!(Coding::of(&whole), Some(Coding::Jpeg));
        let scan = whole.windows(2).position(|pair| pair == [0xff, 0xda]).unwrap();
        assert_eq!(
            head_of(Coding::Jpeg, &whole[..scan + 20], whole.len() as u64).unwrap().extent,
            EXTENT,
            "{name}"
        );
        for at in 0..whole.len() {
            for value in [0, 1, 0x7f, 0xff, whole[at] ^ 0x10] {
                let mut bytes = whole.clone();
                bytes[at] = value;
                if let Ok(head) = read_of(Coding::Jpeg, &bytes, &mut values) {
                    assert_eq!(values.len(), head.extent.pixels() * head.colour.channels() as usize);
                }
            }
        }
    }
}
