//! Packing with the two filters that every HDF5 reader has, shuffle and deflate, done by us so that it can
//! run in parallel.
//!
//! Shuffle puts the first bytes of all numbers together, then the second bytes, and so on: neighbouring
//! numbers share their high bytes, which deflate then finds. The result is bit for bit what `H5Dread` expects
//! of a chunk with these two filters.

use flate2::{Compress, Compression, FlushCompress, Status};

/// Bit of the filter mask that says "deflate (the second filter) was left out for this chunk".
const WITHOUT_DEFLATE: u32 = 0b10;

/// Shuffles and deflates one chunk; also gives the filter mask, since a chunk that does not shrink is kept
/// shuffled only.
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
    fn damaged_bytes_are_refused_and_never_grow() {
        let (packed, mask) = pack(&vec![7i64; 1000]);
        let mut back = vec![0i64; 1000];
        assert!(unpack(packed[..packed.len() / 2].to_vec(), mask, &mut back).is_err());
        assert!(unpack(packed, mask, &mut back[..10]).is_err());
        assert!(unpack(vec![1, 2, 3], 0b11, &mut back).is_err());
    }
}
