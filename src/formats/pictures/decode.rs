//! Stored values of one picture: PNG of 8 or 16 bits, TIFF of 8 or 16 bits or floats, grey or RGB.
//!
//! Values are those that are stored: no profile and no gamma is applied. Alpha is left out, a palette is looked up, 1 to 4 bits are widened to 8.
//! A header may claim any size; memory is taken only when the file could hold it: deflate packs at most 1032 : 1, LZW less.

use crate::error::FormatError;
use photocurrent_core::{Colour, Extent};
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;
use tiff::ColorType;
use tiff::decoder::{Decoder as Tiff, DecodingResult, Limits};
use tiff::tags::Tag;

/// What a header says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Head {
    pub(crate) extent: Extent,
    pub(crate) colour: Colour,
    pub(crate) bits: u32,
    /// Does the picture say that its values are encoded as sRGB?
    pub(crate) says_srgb: bool,
    /// More pictures in the same file, which are not read.
    pub(crate) has_more: bool,
}

/// Most that is packed into a byte.
const PACKED: u64 = 1100;

fn damaged(path: &Path, what: impl std::fmt::Display) -> FormatError {
    FormatError::new(path, format!("the picture cannot be read: {what}"), "leave it out, or copy it again")
}

fn is_tiff(path: &Path) -> bool {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).unwrap_or_default();
    extension.starts_with("tif")
}

/// Reads the header of a picture, and follows its parts to the end without decoding them: a picture that is cut off is no whole one.
pub(crate) fn head(path: &Path) -> Result<Head, FormatError> {
    if is_tiff(path) {
        let (mut decoder, head) = open_tiff(path)?;
        ends_tiff(path, &mut decoder)?;
        Ok(head)
    } else {
        let (_, head) = open_png(path)?;
        ends_png(path)?;
        Ok(head)
    }
}

/// Walks from chunk to chunk up to IEND. Values that were changed within a chunk show only when they are decoded.
fn ends_png(path: &Path) -> Result<(), FormatError> {
    let io = |error: std::io::Error| FormatError::io(path, &error);
    let file = File::open(path).map_err(io)?;
    let bytes = file.metadata().map_err(io)?.len();
    let cut = |at: u64| damaged(path, format!("it is cut off: its data go on after byte {at} of {bytes}"));
    let mut reader = BufReader::with_capacity(4096, file);
    let mut at = 8_u64;
    reader.seek_relative(8).map_err(io)?;
    loop {
        // Length, type, data, checksum.
        let mut begin = [0; 8];
        if at + 12 > bytes || reader.read_exact(&mut begin).is_err() {
            return Err(cut(at.min(bytes)));
        }
        let [a, b, c, d, kind @ ..] = begin;
        let length = i64::from(u32::from_be_bytes([a, b, c, d])) + 4;
        if !kind.iter().all(u8::is_ascii_alphabetic) {
            return Err(damaged(path, format!("at byte {at} of {bytes} no chunk begins")));
        }
        at += 8 + length.unsigned_abs();
        if at > bytes {
            return Err(cut(bytes));
        }
        if kind == *b"IEND" {
            return Ok(());
        }
        reader.seek_relative(length).map_err(io)?;
    }
}

/// Holds the ends of strips and tiles against the length of the file.
fn ends_tiff<R: Read + Seek>(path: &Path, decoder: &mut Tiff<R>) -> Result<(), FormatError> {
    let bytes = std::fs::metadata(path).map_err(|error| FormatError::io(path, &error))?.len();
    for (offsets, counts) in [(Tag::StripOffsets, Tag::StripByteCounts), (Tag::TileOffsets, Tag::TileByteCounts)] {
        let mut list = |tag: Tag| decoder.find_tag_unsigned_vec::<u64>(tag).ok().flatten().unwrap_or_default();
        let (offsets, counts) = (list(offsets), list(counts));
        if offsets.iter().zip(&counts).any(|(offset, count)| offset.saturating_add(*count) > bytes) {
            return Err(damaged(path, format!("it is cut off: its data go on after byte {bytes}")));
        }
    }
    Ok(())
}

/// Replaces `values` by those of a picture.
pub(crate) fn read(path: &Path, values: &mut Vec<f32>) -> Result<Head, FormatError> {
    values.clear();
    if is_tiff(path) { read_tiff(path, values) } else { read_png(path, values) }
}

/// Most pixels of a frame: 16,384 x 16,384.
const LARGEST: u64 = 1 << 28;

/// Could a file of `bytes` hold so many pixels?
fn check_size(path: &Path, bytes: u64, extent: Extent, bits_a_pixel: u64) -> Result<(), FormatError> {
    let pixels = u64::from(extent.width) * u64::from(extent.height);
    if pixels == 0 || pixels > LARGEST || pixels.saturating_mul(bits_a_pixel) / 8 > bytes.saturating_mul(PACKED) {
        return Err(damaged(path, format!("its header claims {extent} pixels, which a file of {bytes} bytes cannot hold")));
    }
    Ok(())
}

fn open_png(path: &Path) -> Result<(png::Reader<BufReader<File>>, Head), FormatError> {
    let file = File::open(path).map_err(|error| FormatError::io(path, &error))?;
    let bytes = file.metadata().map_err(|error| FormatError::io(path, &error))?.len();
    let mut decoder = png::Decoder::new_with_limits(BufReader::new(file), png::Limits { bytes: 64 << 20 });
    decoder.set_transformations(png::Transformations::EXPAND);
    let reader = decoder.read_info().map_err(|error| damaged(path, error))?;
    let info = reader.info();
    let extent = Extent { width: info.width, height: info.height };
    let (colour, depth) = reader.output_color_type();
    check_size(path, bytes, extent, info.bits_per_pixel() as u64)?;
    let head = Head {
        extent,
        colour: if matches!(colour, png::ColorType::Rgb | png::ColorType::Rgba) { Colour::Rgb } else { Colour::Mono },
        bits: if depth == png::BitDepth::Sixteen { 16 } else { 8 },
        says_srgb: info.srgb.is_some(),
        has_more: info.animation_control.is_some(),
    };
    Ok((reader, head))
}

fn read_png(path: &Path, values: &mut Vec<f32>) -> Result<Head, FormatError> {
    let (mut reader, head) = open_png(path)?;
    let bytes = reader.output_buffer_size().ok_or_else(|| damaged(path, "it is too large"))?;
    let (colour, _) = reader.output_color_type();
    let mut stored = vec![0; bytes];
    reader.next_frame(&mut stored).map_err(|error| damaged(path, error))?;
    let channels = colour.samples();
    let kept = if head.colour == Colour::Rgb { 3 } else { 1 };
    values.reserve(head.extent.pixels() * kept);
    if head.bits == 16 {
        for pixel in stored.chunks_exact(2 * channels) {
            values.extend(pixel.chunks_exact(2).take(kept).map(|sample| f32::from(u16::from_be_bytes([sample[0], sample[1]]))));
        }
    } else {
        for pixel in stored.chunks_exact(channels) {
            values.extend(pixel[..kept].iter().map(|&sample| f32::from(sample)));
        }
    }
    Ok(head)
}

fn open_tiff(path: &Path) -> Result<(Tiff<BufReader<File>>, Head), FormatError> {
    let file = File::open(path).map_err(|error| FormatError::io(path, &error))?;
    let bytes = file.metadata().map_err(|error| FormatError::io(path, &error))?.len();
    let mut limits = Limits::default();
    // Bounds lists in the directory too, whose length a few bytes can claim.
    limits.decoding_buffer_size = usize::try_from(bytes.saturating_mul(PACKED)).unwrap_or(usize::MAX).clamp(1 << 16, 1 << 30);
    // A strip or tile is read whole before it is decompressed: it cannot be longer than the file.
    limits.intermediate_buffer_size = usize::try_from(bytes).unwrap_or(usize::MAX);
    let mut decoder = Tiff::new(BufReader::new(file)).map_err(|error| damaged(path, error))?.with_limits(limits);
    let (width, height) = decoder.dimensions().map_err(|error| damaged(path, error))?;
    let (colour, bits) = match decoder.colortype().map_err(|error| damaged(path, error))? {
        ColorType::Gray(bits @ (8 | 16 | 32)) => (Colour::Mono, bits),
        ColorType::RGB(bits @ (8 | 16 | 32)) | ColorType::RGBA(bits @ (8 | 16 | 32)) => (Colour::Rgb, bits),
        other => return Err(damaged(path, format!("{other:?} is not read; grey or RGB of 8, 16 or 32 bits is"))),
    };
    let extent = Extent { width, height };
    let channels = if colour == Colour::Rgb { 3 } else { 1 };
    check_size(path, bytes, extent, channels * u64::from(bits))?;
    let has_more = decoder.more_images();
    Ok((decoder, Head { extent, colour, bits: u32::from(bits), says_srgb: false, has_more }))
}

fn read_tiff(path: &Path, values: &mut Vec<f32>) -> Result<Head, FormatError> {
    let (mut decoder, head) = open_tiff(path)?;
    let stored = decode(&mut decoder).map_err(|error| damaged(path, error))?;
    match stored {
        DecodingResult::U8(stored) => values.extend(stored.iter().map(|&value| f32::from(value))),
        DecodingResult::U16(stored) => values.extend(stored.iter().map(|&value| f32::from(value))),
        DecodingResult::U32(stored) => values.extend(stored.iter().map(|&value| value as f32)),
        DecodingResult::F32(stored) => values.extend_from_slice(&stored),
        _ => return Err(damaged(path, "its samples are neither unsigned numbers nor floats of 32 bits")),
    }
    let kept = head.extent.pixels() * if head.colour == Colour::Rgb { 3 } else { 1 };
    let four = head.extent.pixels() * 4;
    if head.colour == Colour::Rgb && values.len() == four {
        // Alpha is left out, in place.
        for pixel in 0..head.extent.pixels() {
            values.copy_within(4 * pixel..4 * pixel + 3, 3 * pixel);
        }
        values.truncate(kept);
    }
    if values.len() != kept {
        return Err(damaged(path, format!("it has {} samples, and {kept} are needed", values.len())));
    }
    Ok(head)
}

fn decode<R: Read + Seek>(decoder: &mut Tiff<R>) -> tiff::TiffResult<DecodingResult> {
    decoder.read_image()
}
