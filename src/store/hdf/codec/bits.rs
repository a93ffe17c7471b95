//! Orders of bytes and bits that make numbers easier to compress: shuffle (by byte) and bitshuffle (by bit),
//! undone.

use super::{Bytes, Filled, full, lz4_block, zstd_frames};

/// Undoes shuffle: all first bytes stand together, then all second bytes, and so on; what is left of a last
/// number stands at the end.
pub(crate) fn unshuffle(bytes: &[u8], item: usize, out: &mut [u8]) -> Filled {
    full(bytes.len(), out)?;
    match item {
        0 => return Err("numbers of 0 bytes".into()),
        1 => out.copy_from_slice(bytes),
        2 => gather::<2>(bytes, out),
        4 => gather::<4>(bytes, out),
        8 => gather::<8>(bytes, out),
        16 => gather::<16>(bytes, out),
        _ => {
            let n = bytes.len() / item;
            for (i, number) in out.chunks_exact_mut(item).enumerate() {
                for (j, byte) in number.iter_mut().enumerate() {
                    *byte = bytes[j * n + i];
                }
            }
        }
    }
    let rest = bytes.len() - bytes.len() % item;
    out[rest..].copy_from_slice(&bytes[rest..]);
    Ok(())
}

fn gather<const W: usize>(bytes: &[u8], out: &mut [u8]) {
    let n = bytes.len() / W;
    let planes: [&[u8]; W] = std::array::from_fn(|j| &bytes[j * n..(j + 1) * n]);
    let (numbers, _) = out.as_chunks_mut::<W>();
    for (i, number) in numbers.iter_mut().enumerate() {
        *number = std::array::from_fn(|j| planes[j][i]);
    }
}

/// Undoes bitshuffle of numbers whose count is a multiple of 8: row 8 b + k holds bit k of byte b of every
/// number, eight numbers to a byte.
pub(crate) fn unshuffle_bits(bytes: &[u8], item: usize, out: &mut [u8]) -> Filled {
    full(bytes.len(), out)?;
    if item == 0 || !bytes.len().is_multiple_of(8 * item) {
        return Err(format!("{} bytes are no multiple of eight {item}-byte numbers", bytes.len()));
    }
    let row = bytes.len() / item / 8;
    for byte in 0..item {
        let rows = &bytes[byte * 8 * row..(byte + 1) * 8 * row];
        for group in 0..row {
            let eight = u64::from_le_bytes(std::array::from_fn(|k| rows[k * row + group]));
            for (i, value) in transposed(eight).to_le_bytes().into_iter().enumerate() {
                out[(group * 8 + i) * item + byte] = value;
            }
        }
    }
    Ok(())
}

/// Transposes 8 x 8 bits, byte i bit k to byte k bit i (Warren, Hacker's Delight, 7-3).
fn transposed(bits: u64) -> u64 {
    let swap = |bits: u64, mask: u64, by: u32| {
        let moved = (bits ^ (bits >> by)) & mask;
        bits ^ moved ^ (moved << by)
    };
    let bits = swap(bits, 0x00aa_00aa_00aa_00aa, 7);
    let bits = swap(bits, 0x0000_cccc_0000_cccc, 14);
    swap(bits, 0x0000_0000_f0f0_f0f0, 28)
}

/// What packs the blocks of the filter bitshuffle (32008).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BitCodec {
    None,
    Lz4,
    Zstd,
}

/// Undoes the filter bitshuffle; `block` numbers stand in a block, 0 for the usual count.
pub(crate) fn bitshuffle(bytes: &[u8], item: usize, block: usize, codec: BitCodec, out: &mut [u8]) -> Filled {
    if item == 0 {
        return Err("numbers of 0 bytes".into());
    }
    let mut from = Bytes::new(bytes);
    let block_bytes = if codec == BitCodec::None {
        let usual = (8192 / item / 8 * 8).max(128);
        (if block == 0 { usual } else { block }).saturating_mul(item)
    } else {
        full(from.u64_be()?.try_into().unwrap_or(usize::MAX), out)?;
        from.u32_be()? as usize
    };
    if block_bytes == 0 || !block_bytes.is_multiple_of(8 * item) {
        return Err(format!("blocks of {block_bytes} bytes for {item}-byte numbers"));
    }
    // Whole blocks, then a shorter one of whole eights, then what is left as it is.
    let ordered = out.len() - out.len() % (8 * item);
    let (ordered, rest) = out.split_at_mut(ordered);
    let mut unpacked = Vec::new();
    for room in ordered.chunks_mut(block_bytes) {
        let size = if codec == BitCodec::None { room.len() } else { from.u32_be()? as usize };
        let packed = from.take(size)?;
        if codec == BitCodec::None {
            unshuffle_bits(packed, item, room)?;
            continue;
        }
        unpacked.resize(room.len(), 0);
        if codec == BitCodec::Lz4 {
            lz4_block(packed, &mut unpacked)?
        } else {
            zstd_frames(packed, &mut unpacked)?
        }
        unshuffle_bits(&unpacked, item, room)?;
    }
    rest.copy_from_slice(from.take(rest.len())?);
    Ok(())
}
