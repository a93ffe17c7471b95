//! PNG files, grey or RGB, 8 or 16 bits, without any statement of gamma.

use super::cannot_write;
use photocurrent_core::NodeError;
use png::{BitDepth, ColorType, Compression, Encoder};
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

/// A picture to write.
pub(crate) struct Picture<'a> {
    /// Values in a row are `width * channels`.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// 1 is grey, 3 is RGB.
    pub channels: u32,
    /// Bits of one value.
    pub depth: BitDepth,
    /// Rows from the top; 16-bit values with their high byte first.
    pub bytes: &'a [u8],
    /// A text that viewers can show.
    pub comment: Option<&'a str>,
}

impl Picture<'_> {
    /// Writes it with quick compression.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub(crate) fn save(&self, path: &Path) -> Result<(), NodeError> {
        let file = File::create(path).map_err(|error| cannot_write(path, &error))?;
        self.encode(BufWriter::new(file)).map_err(|error| cannot_write(path, &error))
    }

    /// Encodes it with quick compression.
    pub(crate) fn encode(&self, to: impl std::io::Write) -> Result<(), png::EncodingError> {
        self.encode_as(to, Compression::Fast)
    }

    /// Encodes it for a place where size counts.
    pub(crate) fn encode_small(&self, to: impl std::io::Write) -> Result<(), png::EncodingError> {
        self.encode_as(to, Compression::Balanced)
    }

    fn encode_as(&self, to: impl std::io::Write, compression: Compression) -> Result<(), png::EncodingError> {
        let mut encoder = Encoder::new(to, self.width, self.height);
        encoder.set_color(if self.channels == 1 { ColorType::Grayscale } else { ColorType::Rgb });
        encoder.set_depth(self.depth);
        encoder.set_compression(compression);
        if let Some(comment) = self.comment {
            encoder.add_text_chunk("Comment".into(), comment.into())?;
        }
        let mut writer = encoder.write_header()?;
        writer.write_image_data(self.bytes)?;
        writer.finish()
    }
}

/// Reads a PNG back, for tests: values as they stand in the file, and its header.
#[cfg(test)]
pub(crate) fn load(path: &Path) -> (Vec<u16>, png::Info<'static>) {
    let mut reader =
        png::Decoder::new(std::io::BufReader::new(File::open(path).unwrap())).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut bytes).unwrap();
    let values = match reader.info().bit_depth {
        BitDepth::Sixteen => bytes.chunks(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect(),
        _ => bytes.iter().map(|&byte| byte.into()).collect(),
    };
    (values, reader.info().clone())
}
