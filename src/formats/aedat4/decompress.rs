//! Decompresses packets: LZ4 frames, Zstandard frames, or bytes as they are.
//!
//! Cameras write a packet every few milliseconds, a few kilobytes each. LZ4 frames of the plain form that
//! they use (no checksums, no dictionary) are taken apart here, block by block into one buffer that is used
//! again: a general decoder clears a window for every packet, which takes longer than the events in it. All
//! other LZ4 frames go through the general decoder of `lz4_flex`. Source: "LZ4 Frame Format Description".

use std::io::Read;

/// No packet may be larger than this when it is decompressed: 8 million events, or a frame of 64 megapixels.
pub(super) const MOST_BYTES: usize = 1 << 27;

/// How packets are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Compression {
    /// Not at all.
    None,
    /// An LZ4 frame each.
    Lz4,
    /// A Zstandard frame each.
    Zstd,
}

impl Compression {
    /// From the number in the header.
    pub(super) fn of_code(code: i32) -> Option<Compression> {
        match code {
            0 => Some(Compression::None),
            1 | 2 => Some(Compression::Lz4),
            3 | 4 => Some(Compression::Zstd),
            _ => None,
        }
    }

    /// For people.
    pub(super) fn name(self) -> &'static str {
        match self {
            Compression::None => "none",
            Compression::Lz4 => "LZ4",
            Compression::Zstd => "Zstandard",
        }
    }

    /// Could a packet of `length` bytes begin so? `start` is its first four bytes.
    pub(super) fn begins(self, start: [u8; 4], length: u64) -> bool {
        match self {
            // A table begins with its own size.
            Compression::None => u64::from(u32::from_le_bytes(start)) + 4 == length,
            Compression::Lz4 => start == LZ4_MAGIC || start == LZ4_LEGACY_MAGIC,
            Compression::Zstd => start == [0x28, 0xb5, 0x2f, 0xfd],
        }
    }
}

const LZ4_MAGIC: [u8; 4] = [0x04, 0x22, 0x4d, 0x18];
const LZ4_LEGACY_MAGIC: [u8; 4] = [0x02, 0x21, 0x4c, 0x18];

/// A buffer for decompressed packets, used again and again.
#[derive(Default)]
pub(super) struct Plain {
    /// Longer than what is in use: it is not cleared between packets.
    buffer: Vec<u8>,
    used: usize,
    /// Kept, because to make one takes longer than to decompress a packet.
    zstd: Option<zstd::bulk::Decompressor<'static>>,
}

impl Plain {
    /// What was decompressed last.
    pub(super) fn bytes(&self) -> &[u8] {
        &self.buffer[..self.used]
    }

    /// Decompresses a packet; at least its first `wanted` bytes, or all when there are fewer.
    ///
    /// # Errors
    /// When the bytes are damaged, or grow beyond [`MOST_BYTES`]: says why.
    pub(super) fn fill(
        &mut self,
        compression: Compression,
        packet: &[u8],
        wanted: usize,
    ) -> Result<(), String> {
        self.used = 0;
        match compression {
            Compression::None => {
                self.room(packet.len());
                self.buffer[..packet.len()].copy_from_slice(packet);
                self.used = packet.len();
                Ok(())
            }
            Compression::Lz4 => match plain_lz4_blocks(packet) {
                Some((most, linked, blocks)) => self.lz4_blocks(blocks, most, linked, wanted),
                None => self.stream(lz4_flex::frame::FrameDecoder::new(packet), wanted),
            },
            Compression::Zstd => self.zstd(packet, wanted),
        }
    }

    /// Makes the buffer hold `size` bytes.
    fn room(&mut self, size: usize) {
        if self.buffer.len() < size {
            self.buffer.resize(size, 0);
        }
    }

    fn zstd(&mut self, packet: &[u8], wanted: usize) -> Result<(), String> {
        // A size that is only claimed is reserved when it is small, or usual for so many bytes.
        let claimed = zstd::zstd_safe::get_frame_content_size(packet)
            .ok()
            .flatten()
            .and_then(|size| usize::try_from(size).ok());
        match claimed
            .filter(|&size| size <= (1 << 20).max(packet.len().saturating_mul(32)) && size <= MOST_BYTES)
        {
            Some(size) => {
                self.room(size);
                if self.zstd.is_none() {
                    self.zstd = Some(zstd::bulk::Decompressor::new().map_err(|error| error.to_string())?);
                }
                let Some(decompressor) = &mut self.zstd else { return Ok(()) };
                self.used = decompressor
                    .decompress_to_buffer(packet, &mut self.buffer[..size])
                    .map_err(|error| error.to_string())?;
                Ok(())
            }
            None => {
                let decoder = zstd::Decoder::with_buffer(packet).map_err(|error| error.to_string())?;
                self.stream(decoder.single_frame(), wanted)
            }
        }
    }

    fn stream(&mut self, mut decoder: impl Read, wanted: usize) -> Result<(), String> {
        loop {
            if self.used >= wanted {
                return Ok(());
            }
            // Grows only as bytes really come.
            self.room((2 * self.used).clamp(1 << 16, MOST_BYTES + 1));
            let got = decoder.read(&mut self.buffer[self.used..]).map_err(|error| error.to_string())?;
            if got == 0 {
                return Ok(());
            }
            self.used += got;
            if self.used > MOST_BYTES {
                return Err(too_large());
            }
        }
    }

    /// The blocks of an LZ4 frame: four bytes of length, whose highest bit says that the block is not
    /// compressed; a length of 0 ends the frame.
    fn lz4_blocks(
        &mut self,
        mut rest: &[u8],
        most: usize,
        linked: bool,
        wanted: usize,
    ) -> Result<(), String> {
        while self.used < wanted {
            let (length, after) =
                rest.split_first_chunk::<4>().ok_or("the compressed bytes end too early")?;
            let length = u32::from_le_bytes(*length);
            if length == 0 {
                return Ok(());
            }
            let size = (length & 0x7fff_ffff) as usize;
            let (block, after) =
                after.split_at_checked(size).ok_or("a compressed block is longer than the packet")?;
            rest = after;
            if size > most {
                return Err("a compressed block is longer than the frame allows".into());
            }
            self.room(self.used + most);
            let (before, after) = self.buffer.split_at_mut(self.used);
            self.used += if length >> 31 == 1 {
                after[..size].copy_from_slice(block);
                size
            } else if linked && !before.is_empty() {
                let window = &before[before.len().saturating_sub(1 << 16)..];
                lz4_flex::block::decompress_into_with_dict(block, &mut after[..most], window)
                    .map_err(|error| error.to_string())?
            } else {
                lz4_flex::block::decompress_into(block, &mut after[..most])
                    .map_err(|error| error.to_string())?
            };
            if self.used > MOST_BYTES {
                return Err(too_large());
            }
        }
        Ok(())
    }
}

fn too_large() -> String {
    format!("it grows beyond {} MiB when it is decompressed", MOST_BYTES >> 20)
}

/// Largest block, whether blocks are linked, and the blocks of an LZ4 frame of the plain form; `None` for all
/// other forms.
fn plain_lz4_blocks(frame: &[u8]) -> Option<(usize, bool, &[u8])> {
    let (head, blocks) = frame.split_first_chunk::<7>()?;
    let (flags, size) = (head[4], head[5]);
    // Version 1; no checksum, content size, dictionary or reserved bit.
    if head[..4] != LZ4_MAGIC || flags & !0x20 != 0x40 || size & 0x8f != 0 {
        return None;
    }
    let most = match size >> 4 {
        4 => 1 << 16,
        5 => 1 << 18,
        6 => 1 << 20,
        7 => 1 << 22,
        _ => return None,
    };
    Some((most, flags & 0x20 == 0, blocks))
}
