//! Packing with the two filters that every HDF5 reader has, shuffle and deflate, done by us so that it can
//! run in parallel.
//!
//! Shuffle puts the first bytes of all numbers together, then the second bytes, and so on: neighbouring
//! numbers share their high bytes, which deflate then finds. The low bytes of measured numbers are noise, in
//! which deflate finds nothing and takes longest: such a plane of bytes becomes blocks of the stream that are
//! stored as they are. The result is bit for bit what `H5Dread` expects of a chunk with these two filters.
//!
//! Source of the stream: RFC 1950 (its head and checksum) and RFC 1951 (its blocks).

use flate2::{Compress, Compression, FlushCompress};
use multiversion::multiversion;

/// Bit of the filter mask that says "deflate (the second filter) was left out for this chunk".
const WITHOUT_DEFLATE: u32 = 0b10;
/// The same of both filters.
pub(super) const AS_IT_IS: u32 = 0b11;

/// Head of a zlib stream: deflate, a window of 32 KiB, the quickest level.
const HEAD: [u8; 2] = [0x78, 0x01];

/// Most bytes of a block that is stored as it is.
const LONGEST_STORED: usize = 0xFFFF;

/// The last block of a stream, empty.
const LAST: [u8; 5] = [1, 0, 0, 0xFF, 0xFF];

/// One in so many bytes of a plane is tried before all of it is deflated: of a chunk of eight frames two, so
/// that what repeats from frame to frame is found.
const TRIED_ONE_IN: usize = 4;

/// A plane of fewer bytes than this is not tried.
const FEWEST_TRIED: usize = 16384;

/// A plane is stored where its part that was tried shrinks by less than one in so many.
const SHRINKS_BY_ONE_IN: usize = 8;

/// Shuffles and deflates one chunk; also gives the filter mask, since a chunk that does not shrink is kept
/// shuffled only.
pub(crate) fn pack<T: bytemuck::Pod>(values: &[T]) -> (Vec<u8>, u32) {
    let shuffled = shuffle(bytemuck::cast_slice(values), size_of::<T>());
    let mut packed = Vec::with_capacity(shuffled.len());
    packed.extend(HEAD);
    let mut deflate = Compress::new(Compression::new(1), false);
    for plane in shuffled.chunks(values.len().max(1)) {
        if !push_deflated(&mut deflate, plane, &mut packed) {
            push_stored(plane, &mut packed);
        }
    }
    packed.extend(LAST);
    packed.extend(simd_adler32::adler32(&shuffled.as_slice()).to_be_bytes());
    if packed.len() < shuffled.len() { (packed, 0) } else { (shuffled, WITHOUT_DEFLATE) }
}

/// Adds a plane to a stream in blocks of its own; false where that does not make it smaller, and nothing is
/// added.
fn push_deflated(deflate: &mut Compress, plane: &[u8], packed: &mut Vec<u8>) -> bool {
    let begin = packed.len();
    if plane.len() >= FEWEST_TRIED {
        let tried = plane.len() / TRIED_ONE_IN;
        let middle = (plane.len() - tried) / 2;
        let shrinks = push_blocks(deflate, &plane[middle..middle + tried], packed, SHRINKS_BY_ONE_IN);
        packed.truncate(begin);
        if !shrinks {
            return false;
        }
    }
    let shrinks = push_blocks(deflate, plane, packed, usize::MAX);
    if !shrinks {
        packed.truncate(begin);
    }
    shrinks
}

/// Adds bytes, deflated, up to the end of a byte; true where they come out shorter by one in `by`.
fn push_blocks(deflate: &mut Compress, bytes: &[u8], packed: &mut Vec<u8>, by: usize) -> bool {
    let begin = packed.len();
    let most = bytes.len() - bytes.len() / by;
    packed.reserve(most);
    deflate.reset();
    // It writes into what is reserved and no further: where that is used up, bytes or the end of a block may
    // be missing.
    let status = deflate.compress_vec(bytes, packed, FlushCompress::Sync);
    let length = packed.len() - begin;
    status.is_ok() && length < most && deflate.total_in() as usize == bytes.len()
}

/// Adds bytes as they are.
fn push_stored(bytes: &[u8], packed: &mut Vec<u8>) {
    for block in bytes.chunks(LONGEST_STORED) {
        let length = block.len() as u16;
        packed.push(0);
        packed.extend(length.to_le_bytes());
        packed.extend((!length).to_le_bytes());
        packed.extend(block);
    }
}

fn shuffle(bytes: &[u8], item: usize) -> Vec<u8> {
    let mut out = vec![0; bytes.len()];
    match item {
        1 => out.copy_from_slice(bytes),
        4 => shuffle_of_4(bytes.as_chunks().0, &mut out),
        8 => shuffle_of_8(bytes.as_chunks().0, &mut out),
        _ => {
            let n = bytes.len() / item;
            for (j, plane) in out.chunks_exact_mut(n.max(1)).enumerate() {
                for (to, from) in plane.iter_mut().zip(bytes[j..].iter().step_by(item)) {
                    *to = *from;
                }
            }
        }
    }
    out
}

/// Plane by plane; a byte is what a shifted number leaves of itself, which vectors do for many at once.
macro_rules! shuffle_of {
    ($name:ident, $number:ty) => {
        #[multiversion(targets(
            "x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd",
            "x86_64+avx2",
            "aarch64+neon"
        ))]
        fn $name(items: &[[u8; size_of::<$number>()]], out: &mut [u8]) {
            for (j, plane) in out.chunks_exact_mut(items.len().max(1)).enumerate() {
                for (to, from) in plane.iter_mut().zip(items) {
                    *to = (<$number>::from_le_bytes(*from) >> (8 * j)) as u8;
                }
            }
        }
    };
}
shuffle_of!(shuffle_of_4, u32);
shuffle_of!(shuffle_of_8, u64);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hdf::pipeline::Step;
    use crate::hdf::pipeline::testing::pipeline;
    use proptest::prelude::*;

    fn unpack<T: bytemuck::Pod>(bytes: Vec<u8>, mask: u32, values: &mut [T]) -> Result<(), String> {
        pipeline(&[Step::Shuffle(size_of::<T>()), Step::Deflate]).undo(
            bytes,
            mask,
            bytemuck::cast_slice_mut(values),
        )
    }

    proptest! {
        #[test]
        fn what_is_packed_comes_back(values: Vec<i64>, small: Vec<u16>, bytes: Vec<u8>) {
            let (packed, mask) = pack(&values);
            let mut back = vec![0i64; values.len()];
            unpack(packed, mask, &mut back).unwrap();
            prop_assert_eq!(back, values);
            let (packed, mask) = pack(&small);
            let mut back = vec![0u16; small.len()];
            unpack(packed, mask, &mut back).unwrap();
            prop_assert_eq!(back, small);
            let (packed, mask) = pack(&bytes);
            let mut back = vec![0u8; bytes.len()];
            unpack(packed, mask, &mut back).unwrap();
            prop_assert_eq!(back, bytes);
        }
    }

    #[test]
    fn noise_is_kept_without_deflate_and_order_is_not() {
        let mut random = photocurrent_core::random::Random::new(1, &[]);
        let noise: Vec<i64> = (0..4096).map(|_| random.bits() as i64).collect();
        assert_eq!(pack(&noise).1, WITHOUT_DEFLATE);
        let order: Vec<i64> = (0..4096).collect();
        let (packed, mask) = pack(&order);
        assert_eq!(mask, 0);
        assert!(packed.len() < 8 * 4096 / 3);
    }

    #[test]
    fn planes_of_noise_are_stored_in_a_stream_that_any_reader_of_zlib_takes() {
        let mut random = photocurrent_core::random::Random::new(1, &[]);
        for length in [0, 1, 3, 5_000, 65_535, 65_536, 70_001] {
            // Two planes of noise and six of order.
            let values: Vec<i64> = (0..length).map(|n| (n << 32) | (random.bits() & 0xFFFF) as i64).collect();
            let (packed, mask) = pack(&values);
            let mut back = vec![0i64; values.len()];
            unpack(packed.clone(), mask, &mut back).unwrap();
            assert_eq!(back, values);
            if length > 5_000 {
                assert_eq!(mask, 0);
                let size = packed.len() as i64;
                assert!((2 * length..3 * length).contains(&size), "{length}: {size}");
                let mut other = Vec::new();
                std::io::Read::read_to_end(&mut flate2::read::ZlibDecoder::new(&*packed), &mut other)
                    .unwrap();
                assert_eq!(other, shuffle(bytemuck::cast_slice(&values), 8));
            }
        }
    }

    #[test]
    fn damaged_bytes_are_refused_and_never_grow() {
        let (packed, mask) = pack(&vec![7i64; 1000]);
        let mut back = vec![0i64; 1000];
        assert!(unpack(packed[..packed.len() / 2].to_vec(), mask, &mut back).is_err());
        assert!(unpack(packed, mask, &mut back[..10]).is_err());
        assert!(unpack(vec![1, 2, 3], 0b11, &mut back).is_err());
    }
}
