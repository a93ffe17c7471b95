//! Stored values of one JPEG picture: 8 bits, grey or colour, baseline or progressive.
//!
//! Decoded by `zune-jpeg` without its SIMD: it is maintained (the `image` crate decodes by it), safe code
//! throughout in that form, gives the same values on every machine, and its `strict_mode` refuses damaged
//! codes; `jpeg-decoder` gets no more than repairs. Colours are red, green, blue. A header may claim any
//! size: the picture is decoded only when so many bytes could hold it.
//!
//! Limits: four channels (CMYK), lossless and arithmetic coding and 12 bits are refused; a profile or a
//! rotation that a picture carries is not applied.

use super::head::{Head, check_size};
use photocurrent_core::{Colour, Extent};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// The first bytes.
pub(crate) const MAGIC: &[u8] = &[0xff, 0xd8, 0xff];

/// Most pixels of a picture: 8,192 x 8,192.
const LARGEST: u64 = 1 << 26;

/// Reads the head of a picture from its beginning; it has `length` bytes in all.
pub(crate) fn head(bytes: &[u8], length: u64) -> Result<Head, String> {
    open(bytes, length).map(|(_, head)| head)
}

/// Over bytes in memory.
type Decoder<'a> = JpegDecoder<ZCursor<&'a [u8]>>;

fn open(bytes: &[u8], length: u64) -> Result<(Decoder<'_>, Head), String> {
    let options =
        DecoderOptions::default().set_strict_mode(true).set_max_width(1 << 16).set_max_height(1 << 16);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(|error| format!("{error:?}"))?;
    let info = decoder.info().ok_or("it has no frame header")?;
    let colour = match info.components {
        1 => Colour::Mono,
        3 => Colour::Rgb,
        other => return Err(format!("it has {other} channels; grey and colour of three are read")),
    };
    let extent = Extent { width: info.width.into(), height: info.height.into() };
    // A block of 64 values takes a bit at least, and colours stand for four pixels at most.
    check_size(length, extent, 8)?;
    if extent.pixels() as u64 > LARGEST {
        return Err(format!("its header claims {extent} pixels; {LARGEST} at most are read"));
    }
    let space = if colour == Colour::Mono { ColorSpace::Luma } else { ColorSpace::RGB };
    decoder.set_options(options.jpeg_set_out_colorspace(space));
    Ok((decoder, Head { extent, colour, bits: 8, has_alpha: false, says_srgb: true, has_more: false }))
}

/// Replaces `values` by those of a picture.
pub(crate) fn read(bytes: &[u8], values: &mut Vec<f32>) -> Result<Head, String> {
    values.clear();
    let (mut decoder, head) = open(bytes, bytes.len() as u64)?;
    // The decoder fills what is cut off with grey. No scan holds these two bytes, so that the last of each is
    // a marker: of the last scan, and of the end.
    let last = |marker: u8| bytes.windows(2).rposition(|pair| pair == [0xff, marker]);
    if last(0xd9) < last(0xda) {
        return Err("it is cut off: there is no end behind its last scan".into());
    }
    let stored = decoder.decode().map_err(|error| format!("{error:?}"))?;
    let needed = head.extent.pixels() * head.colour.channels() as usize;
    if stored.len() != needed {
        return Err(format!("it has {} samples, and {needed} are needed", stored.len()));
    }
    values.extend(stored.iter().map(|&value| f32::from(value)));
    Ok(head)
}
