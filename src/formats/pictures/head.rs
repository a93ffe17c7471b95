//! What the head of a picture states, and whether its values fit into the file.

use photocurrent_core::{Colour, Extent};

/// Most that is packed into a byte.
pub(super) const PACKED: u64 = 1100;

/// Most pixels of a frame: 16,384 x 16,384.
const LARGEST: u64 = 1 << 28;

/// What a header says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Head {
    /// Size.
    pub extent: Extent,
    /// Grey, or three channels.
    pub colour: Colour,
    /// Bits of a value; 32 are floats.
    pub bits: u32,
    /// Are there values of alpha, which are left out?
    pub has_alpha: bool,
    /// Does the picture say that its values are encoded as sRGB?
    pub says_srgb: bool,
    /// More pictures in the same file, which are not read.
    pub has_more: bool,
}

/// Could so many bytes hold so many pixels?
pub(crate) fn check_size(bytes: u64, extent: Extent, bits_a_pixel: u64) -> Result<(), String> {
    let pixels = u64::from(extent.width) * u64::from(extent.height);
    if pixels == 0
        || pixels > LARGEST
        || pixels.saturating_mul(bits_a_pixel) / 8 > bytes.saturating_mul(PACKED)
    {
        return Err(format!("its header claims {extent} pixels, which {bytes} bytes cannot hold"));
    }
    Ok(())
}
