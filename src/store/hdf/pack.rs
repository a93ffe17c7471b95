//! The two filters that every HDF5 reader has, shuffle and deflate, done by us so that they can run in parallel.
//!
//! Shuffle puts the first bytes of all numbers together, then the second bytes, and so on: neighbouring numbers share their high
//! bytes, which deflate then finds. The result is bit for bit what `H5Dread` expects of a chunk with these two filters.

use flate2::{Compress, Compression, Decompress, FlushCompress, FlushDecompress, Status};

/// Bit of the filter mask that says "deflate (the second filter) was left out for this chunk".
const WITHOUT_DEFLATE: u32 = 0b10;

/// Which filters a dataset has, in order. A mask bit counts in this order too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Filters {
    None,
    Shuffle,
    Deflate,
    ShuffleDeflate,
}

impl Filters {
    /// Shuffle and deflate for a chunk with this mask of filters that were left out.
    fn applied(self, mask: u32) -> (bool, bool) {
        let kept = |bit: u32| mask & (1 << bit) == 0;
        match self {
            Filters::None => (false, false),
            Filters::Shuffle => (kept(0), false),
            Filters::Deflate => (false, kept(0)),
            Filters::ShuffleDeflate => (kept(0), kept(1)),
        }
    }
}

/// Shuffles and deflates one chunk; also gives the filter mask, since a chunk that does not shrink is kept shuffled only.
pub(crate) fn pack<T: bytemuck::Pod>(values: &[T]) -> (Vec<u8>, u32) {
    let shuffled = shuffle(bytemuck::cast_slice(values), size_of::<T>());
    let mut packed = Vec::with_capacity(shuffled.len());
    let mut deflate = Compress::new(Compression::new(1), true);
    // `compress_vec` never grows its output: not reaching the end means that the chunk does not shrink.
    match deflate.compress_vec(&shuffled, &mut packed, FlushCompress::Finish) {
        Ok(Status::StreamEnd) => (packed, 0),
        _ => (shuffled, WITHOUT_DEFLATE),
    }
}

/// Undoes [`pack`] and its subsets into `values`; the reason in words when the bytes are not what they should be.
pub(crate) fn unpack<T: bytemuck::Pod>(bytes: Vec<u8>, filters: Filters, mask: u32, values: &mut [T]) -> Result<(), String> {
    let (shuffled, deflated) = filters.applied(mask);
    let size = size_of_val(values);
    let raw = if deflated { inflate(&bytes, size)? } else { bytes };
    if raw.len() != size {
        return Err(format!("a chunk has {} bytes instead of {size}", raw.len()));
    }
    let out = bytemuck::cast_slice_mut(values);
    if shuffled {
        unshuffle(&raw, size_of::<T>(), out)
    } else {
        out.copy_from_slice(&raw)
    }
    Ok(())
}

fn inflate(bytes: &[u8], size: usize) -> Result<Vec<u8>, String> {
    let mut raw = Vec::with_capacity(size);
    let mut inflate = Decompress::new(true);
    // The output is bounded by `size`, whatever the stream claims.
    match inflate.decompress_vec(bytes, &mut raw, FlushDecompress::Finish) {
        Ok(Status::StreamEnd) => Ok(raw),
        Ok(_) => Err("a compressed chunk does not end where it should".into()),
        Err(error) => Err(format!("a compressed chunk is damaged ({error})")),
    }
}

fn shuffle(bytes: &[u8], item: usize) -> Vec<u8> {
    if item == 1 {
        return bytes.to_vec();
    }
    let mut out = vec![0; bytes.len()];
    let n = bytes.len() / item;
    for (j, plane) in out.chunks_exact_mut(n.max(1)).enumerate() {
        for (to, from) in plane.iter_mut().zip(bytes[j..].iter().step_by(item)) {
            *to = *from;
        }
    }
    out
}

fn unshuffle(bytes: &[u8], item: usize, out: &mut [u8]) {
    match item {
        2 => gather::<2>(bytes, out),
        4 => gather::<4>(bytes, out),
        8 => gather::<8>(bytes, out),
        // One byte has nothing to shuffle, and no other width occurs in our layouts.
        _ => out.copy_from_slice(bytes),
    }
}

fn gather<const W: usize>(bytes: &[u8], out: &mut [u8]) {
    let n = bytes.len() / W;
    let planes: [&[u8]; W] = std::array::from_fn(|j| &bytes[j * n..(j + 1) * n]);
    let (numbers, _) = out.as_chunks_mut::<W>();
    for (i, number) in numbers.iter_mut().enumerate() {
        *number = std::array::from_fn(|j| planes[j][i]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_packed_comes_back(values: Vec<i64>, small: Vec<u16>, bytes: Vec<u8>) {
            let (packed, mask) = pack(&values);
            let mut back = vec![0i64; values.len()];
            unpack(packed, Filters::ShuffleDeflate, mask, &mut back).unwrap();
            prop_assert_eq!(back, values);
            let (packed, mask) = pack(&small);
            let mut back = vec![0u16; small.len()];
            unpack(packed, Filters::ShuffleDeflate, mask, &mut back).unwrap();
            prop_assert_eq!(back, small);
            let (packed, mask) = pack(&bytes);
            let mut back = vec![0u8; bytes.len()];
            unpack(packed, Filters::ShuffleDeflate, mask, &mut back).unwrap();
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
    fn damaged_bytes_are_refused_and_never_grow() {
        let (packed, mask) = pack(&vec![7i64; 1000]);
        let mut back = vec![0i64; 1000];
        assert!(unpack(packed[..packed.len() / 2].to_vec(), Filters::ShuffleDeflate, mask, &mut back).is_err());
        assert!(unpack(packed, Filters::ShuffleDeflate, mask, &mut back[..10]).is_err());
        assert!(unpack(vec![1, 2, 3], Filters::None, 0, &mut back).is_err());
    }
}
