//! The filter Blosc (32001): a chunk in blocks, each shuffled by byte or bit and packed by one of several
//! codecs.
//!
//! A chunk begins with 16 bytes: versions, flags, size of a number, bytes in all, bytes in a block, packed
//! bytes. Then the start of every block. A block may be split into one stream for each byte of a number.
//! Snappy, which nobody builds in, is refused by name.

use super::bits::{unshuffle, unshuffle_bits};
use super::{Bytes, Filled, deflate, full, literal, lz4_block, repeat, zstd_frames};

/// A block is split into streams only when each stream would have at least so many bytes, and numbers have at
/// most so many.
const LEAST_STREAM: usize = 128;
const MOST_STREAMS: usize = 16;

/// Unpacks a chunk into `out`.
pub(crate) fn blosc(bytes: &[u8], out: &mut [u8]) -> Filled {
    let mut header = Bytes::new(bytes);
    let [version, _, flags, item] = header.array()?;
    let (size, block, packed) = (header.u32()? as usize, header.u32()? as usize, header.u32()? as usize);
    if !(1..=2).contains(&version) {
        return Err(format!("Blosc: version {version}, and only 1 and 2 are known"));
    }
    full(size, out)?;
    // A lying size would only cut the chunk's own bytes.
    let bytes = bytes.get(..packed).ok_or("Blosc: the chunk is cut short")?;
    let item = usize::from(item).max(1);
    if flags & 2 != 0 {
        out.copy_from_slice(bytes.get(16..16 + size).ok_or("Blosc: the chunk is cut short")?);
        return Ok(());
    }
    if size == 0 {
        return Ok(());
    }
    if block == 0 {
        return Err("Blosc: blocks of 0 bytes".into());
    }
    let unpack = codec(flags >> 5)?;
    let (by_byte, by_bit, may_split) = (flags & 1 != 0 && item > 1, flags & 4 != 0, flags & 16 == 0);
    let mut starts = Bytes::new(bytes.get(16..).unwrap_or_default());
    let mut ordered = Vec::new();
    for room in out.chunks_mut(block) {
        let start = starts.u32()? as usize;
        let from = Bytes::new(bytes.get(start..).ok_or("Blosc: a block begins outside its chunk")?);
        let whole = room.len() == block;
        let streams =
            if may_split && whole && item <= MOST_STREAMS && block / item >= LEAST_STREAM { item } else { 1 };
        if by_byte || by_bit {
            ordered.resize(room.len(), 0);
            streams_into(from, streams, unpack, &mut ordered)?;
            if by_byte { unshuffle(&ordered, item, room)? } else { bits_into(&ordered, item, room)? }
        } else {
            streams_into(from, streams, unpack, room)?;
        }
    }
    Ok(())
}

/// Unpacks one stream into room of its length.
type Codec = fn(&[u8], &mut [u8]) -> Filled;

fn codec(number: u8) -> Result<Codec, String> {
    match number {
        0 => Ok(blosclz),
        1 => Ok(lz4_block),
        2 => Err("Blosc: Snappy is not supported; pack the file again with another codec".into()),
        3 => Ok(deflate),
        4 => Ok(zstd_frames),
        other => Err(format!("Blosc: codec {other} is not known")),
    }
}

fn streams_into(mut from: Bytes, streams: usize, unpack: Codec, room: &mut [u8]) -> Filled {
    let each = room.len() / streams;
    for stream in room.chunks_mut(each.max(1)).take(streams) {
        let size = from.u32()? as usize;
        let packed = from.take(size)?;
        if size == stream.len() { stream.copy_from_slice(packed) } else { unpack(packed, stream)? }
    }
    Ok(())
}

/// Bitshuffle of a block: only when its count of numbers is a multiple of eight, and what is left over stands
/// as it is.
fn bits_into(ordered: &[u8], item: usize, room: &mut [u8]) -> Filled {
    let count = room.len() / item;
    let done = if count.is_multiple_of(8) { count * item } else { 0 };
    unshuffle_bits(&ordered[..done], item, &mut room[..done])?;
    room[done..].copy_from_slice(&ordered[done..]);
    Ok(())
}

/// BloscLZ, a relative of FastLZ: literals and repetitions with 13-bit distances, or 16 more bits beyond
/// those.
fn blosclz(bytes: &[u8], out: &mut [u8]) -> Filled {
    const NEAR: usize = 8191;
    let (mut from, mut at) = (Bytes::new(bytes), 0);
    // The first control byte is a run of literals, whatever its upper bits say.
    let mut control = usize::from(from.u8()?) & 31;
    loop {
        if control >= 32 {
            let mut length = (control >> 5) - 1;
            if length == 6 {
                loop {
                    let more = from.u8()?;
                    length += usize::from(more);
                    if more != 255 {
                        break;
                    }
                    if length > out.len() {
                        return Err("a repetition points outside".into());
                    }
                }
            }
            let (high, low) = ((control & 31) << 8, usize::from(from.u8()?));
            let far = low == 255 && high == 31 << 8;
            let distance =
                if far { usize::from(u16::from_be_bytes(from.array()?)) + NEAR } else { high + low };
            repeat(out, at, distance + 1, length + 3)?;
            at += length + 3;
        } else {
            let run = from.take(control + 1)?;
            literal(out, at, run)?;
            at += run.len();
        }
        if from.is_empty() {
            return full(at, out);
        }
        control = usize::from(from.u8()?);
    }
}
