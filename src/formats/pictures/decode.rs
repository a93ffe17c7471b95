//! Stored values of one picture: PNG of 8 or 16 bits, TIFF of 8 or 16 bits or floats, JPEG ([`super::jpeg`]),
//! grey or RGB; of a file, or within a message.
//!
//! Which it is follows from the first bytes, where they say so, else from the name. Values are those that are
//! stored: no profile and no gamma is applied. Alpha is left out, a palette is looked up, 1 to 4 bits are
//! widened to 8. A header may claim any size; memory is taken only when the file could hold it: deflate packs
//! at most 1032 : 1, LZW less.

pub use super::head::Head;
use super::head::{PACKED, check_size};
use super::jpeg;
use crate::error::FormatError;
use photocurrent_core::{Colour, Extent, Rows};
use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Read, Seek};
use std::path::Path;
use tiff::ColorType;
use tiff::decoder::{Decoder as Tiff, DecodingResult, Limits};
use tiff::tags::Tag;

fn damaged(path: &Path, what: impl std::fmt::Display) -> FormatError {
    FormatError::new(path, format!("the picture cannot be read: {what}"), "leave it out, or copy it again")
}

/// How a picture is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Coding {
    /// PNG.
    Png,
    /// JPEG.
    Jpeg,
    /// TIFF.
    Tiff,
}

impl Coding {
    /// By the first bytes; `None` when they are those of no picture that is read.
    pub(crate) fn of(start: &[u8]) -> Option<Coding> {
        match start {
            [0x89, b'P', b'N', b'G', ..] => Some(Coding::Png),
            [b'I', b'I', 42, 0, ..] | [b'M', b'M', 0, 42, ..] => Some(Coding::Tiff),
            _ => start.starts_with(jpeg::MAGIC).then_some(Coding::Jpeg),
        }
    }

    /// Of a file: by its first bytes, else by its name.
    fn of_file(path: &Path) -> Result<Coding, FormatError> {
        let mut start = Vec::new();
        let read = File::open(path).and_then(|file| file.take(4).read_to_end(&mut start));
        read.map_err(|error| FormatError::io(path, &error))?;
        let extension =
            path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).unwrap_or_default();
        Ok(Coding::of(&start).unwrap_or(match extension.as_str() {
            "tif" | "tiff" => Coding::Tiff,
            "jpg" | "jpeg" => Coding::Jpeg,
            _ => Coding::Png,
        }))
    }
}

/// Bytes of a JPEG file before its values: profiles and previews can stand there.
const JPEG_HEAD: u64 = 1 << 20;

/// Reads the header of a picture, and follows its parts to the end without decoding them: a picture that is
/// cut off is no whole one.
///
/// # Errors
/// When the file cannot be read, is cut off, or is no picture of a form that is read.
pub fn head(path: &Path) -> Result<Head, FormatError> {
    match Coding::of_file(path)? {
        Coding::Tiff => {
            let (mut decoder, head) = open_tiff(path)?;
            ends_tiff(path, &mut decoder)?;
            Ok(head)
        }
        Coding::Png => {
            let (_, head) = open_png(path)?;
            ends_png(path)?;
            Ok(head)
        }
        Coding::Jpeg => {
            let io = |error: std::io::Error| FormatError::io(path, &error);
            let file = File::open(path).map_err(io)?;
            let length = file.metadata().map_err(io)?.len();
            let mut start = Vec::new();
            file.take(JPEG_HEAD).read_to_end(&mut start).map_err(io)?;
            jpeg::head(&start, length).map_err(|error| damaged(path, error))
        }
    }
}

/// Walks from chunk to chunk up to IEND. Values that were changed within a chunk show only when they are
/// decoded.
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
    for (offsets, counts) in
        [(Tag::StripOffsets, Tag::StripByteCounts), (Tag::TileOffsets, Tag::TileByteCounts)]
    {
        let mut list =
            |tag: Tag| decoder.find_tag_unsigned_vec::<u64>(tag).ok().flatten().unwrap_or_default();
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
    match Coding::of_file(path)? {
        Coding::Tiff => read_tiff(path, values),
        Coding::Png => {
            let (reader, head) = open_png(path)?;
            png_values(reader, &head, values).map_err(|error| damaged(path, error))?;
            Ok(head)
        }
        Coding::Jpeg => {
            let bytes = std::fs::read(path).map_err(|error| FormatError::io(path, &error))?;
            jpeg::read(&bytes, values).map_err(|error| damaged(path, error))
        }
    }
}

/// Calls `each` with the stored values of some rows, from top to bottom; channels stand next to each other.
/// Rows of a PNG picture below them are not decoded, unless it is interlaced.
///
/// # Errors
/// As [`head`], and when the picture is damaged or has fewer rows.
pub fn rows(path: &Path, rows: Rows, each: &mut dyn FnMut(&Head, &[f32])) -> Result<(), FormatError> {
    let mut values = Vec::new();
    if Coding::of_file(path)? == Coding::Png {
        let (mut reader, head) = open_png(path)?;
        let channels = reader.output_color_type().0.samples();
        if !reader.info().interlaced {
            for y in 0..rows.end {
                let row = reader
                    .next_row()
                    .map_err(|error| damaged(path, error))?
                    .ok_or_else(|| damaged(path, format!("it ends after {y} rows")))?;
                if y >= rows.start {
                    values.clear();
                    push_png(row.data(), channels, &head, &mut values);
                    each(&head, &values);
                }
            }
            return Ok(());
        }
    }
    let head = read(path, &mut values)?;
    if rows.end > head.extent.height {
        return Err(damaged(path, format!("it ends after {} rows", head.extent.height)));
    }
    let length = head.extent.width as usize * head.colour.channels() as usize;
    values.chunks_exact(length).skip(rows.start as usize).take(rows.len()).for_each(|row| each(&head, row));
    Ok(())
}

/// The head of a picture that stands in a message: PNG or JPEG. `start` may be the beginning of its `length`
/// bytes.
pub(crate) fn head_of(coding: Coding, start: &[u8], length: u64) -> Result<Head, String> {
    match coding {
        Coding::Png => png_head(Cursor::new(start), length).map(|(_, head)| head),
        Coding::Jpeg => jpeg::head(start, length),
        Coding::Tiff => Err("TIFF is not read in messages".into()),
    }
}

/// Replaces `values` by those of a picture that stands in a message.
pub(crate) fn read_of(coding: Coding, bytes: &[u8], values: &mut Vec<f32>) -> Result<Head, String> {
    values.clear();
    match coding {
        Coding::Png => {
            let (reader, head) = png_head(Cursor::new(bytes), bytes.len() as u64)?;
            png_values(reader, &head, values)?;
            Ok(head)
        }
        Coding::Jpeg => jpeg::read(bytes, values),
        Coding::Tiff => Err("TIFF is not read in messages".into()),
    }
}

fn open_png(path: &Path) -> Result<(png::Reader<BufReader<File>>, Head), FormatError> {
    let file = File::open(path).map_err(|error| FormatError::io(path, &error))?;
    let bytes = file.metadata().map_err(|error| FormatError::io(path, &error))?.len();
    png_head(BufReader::new(file), bytes).map_err(|error| damaged(path, error))
}

/// Reads the header of a PNG picture of so many bytes.
fn png_head<R: BufRead + Seek>(source: R, bytes: u64) -> Result<(png::Reader<R>, Head), String> {
    let mut decoder = png::Decoder::new_with_limits(source, png::Limits { bytes: 64 << 20 });
    decoder.set_transformations(png::Transformations::EXPAND);
    let reader = decoder.read_info().map_err(|error| error.to_string())?;
    let info = reader.info();
    let extent = Extent { width: info.width, height: info.height };
    let (colour, depth) = reader.output_color_type();
    check_size(bytes, extent, info.bits_per_pixel() as u64)?;
    let head = Head {
        extent,
        colour: if matches!(colour, png::ColorType::Rgb | png::ColorType::Rgba) {
            Colour::Rgb
        } else {
            Colour::Mono
        },
        bits: if depth == png::BitDepth::Sixteen { 16 } else { 8 },
        has_alpha: matches!(colour, png::ColorType::GrayscaleAlpha | png::ColorType::Rgba),
        says_srgb: info.srgb.is_some(),
        has_more: info.animation_control.is_some(),
    };
    Ok((reader, head))
}

fn png_values<R: BufRead + Seek>(
    mut reader: png::Reader<R>,
    head: &Head,
    values: &mut Vec<f32>,
) -> Result<(), String> {
    let bytes = reader.output_buffer_size().ok_or("it is too large")?;
    let (colour, _) = reader.output_color_type();
    let mut stored = vec![0; bytes];
    reader.next_frame(&mut stored).map_err(|error| error.to_string())?;
    values.reserve(head.extent.pixels() * head.colour.channels() as usize);
    push_png(&stored, colour.samples(), head, values);
    Ok(())
}

/// Appends the values of decoded pixels of so many channels, without alpha.
fn push_png(stored: &[u8], channels: usize, head: &Head, values: &mut Vec<f32>) {
    let kept = head.colour.channels() as usize;
    if head.bits == 16 {
        for pixel in stored.chunks_exact(2 * channels) {
            values.extend(
                pixel
                    .chunks_exact(2)
                    .take(kept)
                    .map(|sample| f32::from(u16::from_be_bytes([sample[0], sample[1]]))),
            );
        }
    } else {
        for pixel in stored.chunks_exact(channels) {
            values.extend(pixel[..kept].iter().map(|&sample| f32::from(sample)));
        }
    }
}

fn open_tiff(path: &Path) -> Result<(Tiff<BufReader<File>>, Head), FormatError> {
    let file = File::open(path).map_err(|error| FormatError::io(path, &error))?;
    let bytes = file.metadata().map_err(|error| FormatError::io(path, &error))?.len();
    let mut limits = Limits::default();
    // Bounds lists in the directory too, whose length a few bytes can claim.
    limits.decoding_buffer_size =
        usize::try_from(bytes.saturating_mul(PACKED)).unwrap_or(usize::MAX).clamp(1 << 16, 1 << 30);
    // A strip or tile is read whole before it is decompressed: it cannot be longer than the file.
    limits.intermediate_buffer_size = usize::try_from(bytes).unwrap_or(usize::MAX);
    let mut decoder =
        Tiff::new(BufReader::new(file)).map_err(|error| damaged(path, error))?.with_limits(limits);
    let (width, height) = decoder.dimensions().map_err(|error| damaged(path, error))?;
    let stored = decoder.colortype().map_err(|error| damaged(path, error))?;
    let (colour, bits) = match stored {
        ColorType::Gray(bits @ (8 | 16 | 32)) => (Colour::Mono, bits),
        ColorType::RGB(bits @ (8 | 16 | 32)) | ColorType::RGBA(bits @ (8 | 16 | 32)) => (Colour::Rgb, bits),
        other => {
            return Err(damaged(path, format!("{other:?} is not read; grey or RGB of 8, 16 or 32 bits is")));
        }
    };
    let extent = Extent { width, height };
    let channels = if colour == Colour::Rgb { 3 } else { 1 };
    check_size(bytes, extent, channels * u64::from(bits)).map_err(|error| damaged(path, error))?;
    let (has_alpha, has_more) = (matches!(stored, ColorType::RGBA(_)), decoder.more_images());
    Ok((decoder, Head { extent, colour, bits: u32::from(bits), has_alpha, says_srgb: false, has_more }))
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
