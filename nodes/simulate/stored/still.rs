//! One PNG picture as relative light: grey or RGB, 8 or 16 bits; fewer bits and palettes are widened to 8.

use super::{Curve, cannot_read, short_name};
use photocurrent_core::{Extent, NodeError, Rows};
use photocurrent_formats::ycbcr::LUMINANCE;
use png::{BitDepth, ColorType, Decoder, DecodingError, Reader, Transformations};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// The size of a picture, from its header alone.
///
/// # Errors
/// When the file cannot be read, is no PNG picture, or has transparency.
pub fn extent(path: &Path) -> Result<Extent, NodeError> {
    let reader = open(path)?;
    Ok(Extent { width: reader.info().width, height: reader.info().height })
}

/// Calls `each` with the relative light of some rows, from top to bottom; rows below are not decoded.
///
/// # Errors
/// As [`extent`], and when the picture is damaged or has fewer rows.
pub fn read(path: &Path, curve: &Curve, rows: Rows, each: &mut dyn FnMut(&[f64])) -> Result<(), NodeError> {
    let mut reader = open(path)?;
    let (colour, depth) = reader.output_color_type();
    let mut light = Vec::with_capacity(reader.info().width as usize);
    let mut give = |y: u32, bytes: &[u8]| {
        if y >= rows.start {
            light.clear();
            match depth {
                BitDepth::Sixteen => {
                    let table = curve.sixteen();
                    add_light(bytes.chunks_exact(2).map(|pair| table[usize::from(u16::from_be_bytes([pair[0], pair[1]]))]), colour, &mut light);
                }
                _ => add_light(bytes.iter().map(|value| curve.eight()[usize::from(*value)]), colour, &mut light),
            }
            each(&light);
        }
    };
    if reader.info().interlaced {
        // The passes of an interlaced picture end together: it is decoded whole.
        let size = reader.output_buffer_size().ok_or_else(|| damaged(path, "it is larger than memory"))?;
        let mut bytes = vec![0; size];
        let frame = reader.next_frame(&mut bytes).map_err(|error| trouble(path, error))?;
        (0..rows.end.min(frame.height)).for_each(|y| give(y, &bytes[y as usize * frame.line_size..][..frame.line_size]));
        return Ok(());
    }
    for y in 0..rows.end {
        match reader.next_row().map_err(|error| trouble(path, error))? {
            Some(row) => give(y, row.data()),
            None => return Err(damaged(path, &format!("it ends after {y} rows"))),
        }
    }
    Ok(())
}

fn add_light(values: impl Iterator<Item = f64>, colour: ColorType, light: &mut Vec<f64>) {
    if colour == ColorType::Grayscale {
        return light.extend(values);
    }
    let mut values = values;
    while let (Some(red), Some(green), Some(blue)) = (values.next(), values.next(), values.next()) {
        // The weights add up to one but for rounding; grey stays exactly what it is.
        let grey = red == green && green == blue;
        light.push(if grey { red } else { LUMINANCE[0] * red + LUMINANCE[1] * green + LUMINANCE[2] * blue });
    }
}

fn open(path: &Path) -> Result<Reader<BufReader<File>>, NodeError> {
    let file = File::open(path).map_err(|error| cannot_read(path, &error))?;
    let mut decoder = Decoder::new(BufReader::new(file));
    decoder.set_transformations(Transformations::EXPAND);
    let reader = decoder.read_info().map_err(|error| trouble(path, error))?;
    if [ColorType::GrayscaleAlpha, ColorType::Rgba].contains(&reader.output_color_type().0) {
        return Err(NodeError::input(format!("{} has transparency, and light has none", short_name(path)))
            .hint("save it without an alpha channel: grey or RGB, 8 or 16 bits")
            .param("path"));
    }
    Ok(reader)
}

fn trouble(path: &Path, error: DecodingError) -> NodeError {
    match error {
        DecodingError::IoError(error) if error.kind() != std::io::ErrorKind::UnexpectedEof => cannot_read(path, &error),
        other => damaged(path, &other.to_string()),
    }
}

fn damaged(path: &Path, what: &str) -> NodeError {
    NodeError::input(format!("{} is no whole PNG picture: {what}", short_name(path)))
        .hint("copy it again from where it was made, or save it as PNG")
        .param("path")
}
