//! Which filters a dataset has, and undoing them for one chunk: in parallel, without the library, into room
//! of a known size.
//!
//! Known are shuffle, deflate, fletcher32, LZF, Blosc, Zstandard, LZ4, bitshuffle and Prophesee's ECF. No
//! plugin is needed or loaded for any of them.

use super::codec::bits::{BitCodec, bitshuffle, unshuffle};
use super::codec::{Filled, blosc::blosc, deflate, ecf::ecf, fletcher32, lz4, lzf, zstd_frames};
use hdf5_sys::h5i::hid_t;
use hdf5_sys::h5p::{H5Pget_filter2, H5Pget_nfilters};

/// More filters than any writer stacks.
const MOST_FILTERS: i32 = 16;

/// One filter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// Of numbers of so many bytes.
    Shuffle(usize),
    Deflate,
    Fletcher32,
    Lzf,
    Blosc,
    Zstd,
    Lz4,
    /// Of numbers of so many bytes, so many in a block.
    Bitshuffle(usize, usize, BitCodec),
    Ecf,
}

impl Step {
    /// From the filter's number, as registered with The HDF Group, and its settings.
    fn new(id: i32, settings: &[u32]) -> Result<Step, String> {
        let setting = |at: usize| settings.get(at).copied().unwrap_or(0) as usize;
        Ok(match id {
            1 => Step::Deflate,
            2 => Step::Shuffle(setting(0)),
            3 => Step::Fletcher32,
            32000 => Step::Lzf,
            32001 => Step::Blosc,
            32004 => Step::Lz4,
            32008 => {
                let codec = match setting(4) {
                    0 => BitCodec::None,
                    2 => BitCodec::Lz4,
                    3 => BitCodec::Zstd,
                    other => return Err(format!("bitshuffle with codec {other}")),
                };
                Step::Bitshuffle(setting(2), setting(3), codec)
            }
            32015 => Step::Zstd,
            0x8ecf => Step::Ecf,
            other => return Err(name_of(other)),
        })
    }

    /// So many times can it shrink a chunk at most. Deflate: 1032. LZ4: 255. Zstandard: a block of 128 KiB in
    /// 4 bytes. LZF: 264 bytes in 3. ECF: six events of 16 bytes in 2, when runs make stamps and rows free.
    fn largest_ratio(self) -> u64 {
        match self {
            Step::Shuffle(_) | Step::Fletcher32 | Step::Bitshuffle(_, _, BitCodec::None) => 1,
            Step::Deflate => 1100,
            Step::Lzf => 90,
            Step::Lz4 | Step::Bitshuffle(_, _, BitCodec::Lz4) => 256,
            Step::Blosc | Step::Zstd | Step::Bitshuffle(_, _, BitCodec::Zstd) => LARGEST_RATIO,
            Step::Ecf => 64,
        }
    }
}

/// No filter shrinks more than this.
const LARGEST_RATIO: u64 = 1 << 16;

/// A filter that is not known, for messages.
fn name_of(id: i32) -> String {
    let name = match id {
        4 => "SZIP",
        5 => "N-bit",
        6 => "scale-offset",
        307 => "BZIP2",
        32013 => "ZFP",
        32026 => "Blosc2",
        other => return format!("filter number {other}"),
    };
    format!("{name} (filter number {id})")
}

/// All filters of a dataset, in the order in which they were applied. A bit of a chunk's mask counts in this
/// order too.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Pipeline {
    steps: Vec<Step>,
}

impl Pipeline {
    /// Of a dataset's creation properties; the name of the first filter that is not known. To be called under
    /// the library's lock.
    pub(crate) fn of(properties: hid_t) -> Result<Pipeline, String> {
        // SAFETY: plain queries of a live identifier; the buffers have the stated lengths.
        let count = unsafe { H5Pget_nfilters(properties) };
        if !(0..=MOST_FILTERS).contains(&count) {
            return Err(format!("{count} filters"));
        }
        let mut steps = Vec::new();
        for at in 0..count as u32 {
            let (mut flags, mut settings, mut length) = (0, [0u32; 32], 32usize);
            // SAFETY: as above; no name is asked for.
            let id = unsafe {
                let (no_name, no_config) = (std::ptr::null_mut(), std::ptr::null_mut());
                H5Pget_filter2(
                    properties,
                    at,
                    &mut flags,
                    &mut length,
                    settings.as_mut_ptr(),
                    0,
                    no_name,
                    no_config,
                )
            };
            if id < 0 {
                return Err("a filter that cannot be read".into());
            }
            steps.push(Step::new(id, &settings[..length.min(settings.len())])?);
        }
        if steps.iter().filter(|step| step.largest_ratio() > 1).count() > 1 {
            return Err("two compressions on top of each other".into());
        }
        Ok(Pipeline { steps })
    }

    /// So many times can a chunk be larger than its stored bytes.
    pub(crate) fn largest_ratio(&self) -> u64 {
        self.steps.iter().map(|step| step.largest_ratio()).max().unwrap_or(1)
    }

    /// Undoes the filters of a chunk, but for those that its mask leaves out, and fills `out`; the reason in
    /// words when the bytes are not what they should be.
    pub(crate) fn undo(&self, bytes: Vec<u8>, mask: u32, out: &mut [u8]) -> Filled {
        let applied: Vec<Step> = self
            .steps
            .iter()
            .enumerate()
            .filter(|(at, _)| is_applied(*at, mask))
            .map(|(_, step)| *step)
            .collect();
        let mut bytes = bytes;
        for (at, step) in applied.iter().enumerate().rev() {
            if *step == Step::Fletcher32 {
                bytes = fletcher32(bytes)?;
                continue;
            }
            // Every filter below this one keeps the length, but for checksums of 4 bytes.
            if at == 0 {
                return fill(*step, &bytes, out);
            }
            let checksums = applied[..at].iter().filter(|step| **step == Step::Fletcher32).count();
            let mut below = vec![0; out.len() + 4 * checksums];
            fill(*step, &bytes, &mut below)?;
            bytes = below;
        }
        if bytes.len() != out.len() {
            return Err(format!("a chunk has {} bytes instead of {}", bytes.len(), out.len()));
        }
        out.copy_from_slice(&bytes);
        Ok(())
    }
}

fn is_applied(at: usize, mask: u32) -> bool {
    mask & (1 << at.min(31)) == 0
}

fn fill(step: Step, bytes: &[u8], out: &mut [u8]) -> Filled {
    match step {
        Step::Shuffle(item) => unshuffle(bytes, item, out),
        Step::Deflate => deflate(bytes, out),
        Step::Fletcher32 => Err("a checksum where numbers should be".into()),
        Step::Lzf => lzf(bytes, out),
        Step::Blosc => blosc(bytes, out),
        Step::Zstd => zstd_frames(bytes, out),
        Step::Lz4 => lz4(bytes, out),
        Step::Bitshuffle(item, block, codec) => bitshuffle(bytes, item, block, codec, out),
        Step::Ecf => ecf(bytes, out),
    }
}

#[cfg(test)]
pub(crate) mod testing {
    use super::*;

    /// Any filters, for tests of other modules.
    pub fn pipeline(steps: &[Step]) -> Pipeline {
        Pipeline { steps: steps.to_vec() }
    }
}

#[cfg(test)]
mod tests {
    use super::testing::pipeline;
    use super::*;
    use proptest::prelude::*;

    const ALL: [Step; 10] = [
        Step::Shuffle(4),
        Step::Deflate,
        Step::Fletcher32,
        Step::Lzf,
        Step::Blosc,
        Step::Zstd,
        Step::Lz4,
        Step::Bitshuffle(4, 0, BitCodec::Lz4),
        Step::Bitshuffle(3, 8, BitCodec::None),
        Step::Ecf,
    ];

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        /// Whatever bytes stand in a chunk: numbers or a reason, never a panic.
        #[test]
        fn any_bytes_give_numbers_or_a_reason(
            bytes: Vec<u8>,
            room in 0usize..400,
            step in 0usize..10,
            flags: u8,
            block in 0u32..64,
        ) {
            let mut out = vec![0; room];
            let _ = pipeline(&[ALL[step]]).undo(bytes.clone(), 0, &mut out);
            let _ = pipeline(&[Step::Fletcher32, ALL[step]]).undo(bytes.clone(), 1, &mut out);
            // Headers that are trusted further: Blosc's, and ECF's.
            let size = room as u32;
            let mut blosc = vec![2, 1, flags, 4];
            [size, block, bytes.len() as u32 + 16].iter().for_each(|n| blosc.extend(n.to_le_bytes()));
            blosc.extend(&bytes);
            let _ = pipeline(&[Step::Blosc]).undo(blosc, 0, &mut out);
            let ecf = [
                &(((room as u32 / 16) << 2) | u32::from(flags & 3)).to_le_bytes()[..], &bytes,
            ].concat();
            let _ = pipeline(&[Step::Ecf]).undo(ecf, 0, &mut out);
        }
    }

    #[test]
    fn filters_that_are_not_known_are_named() {
        assert_eq!(Step::new(307, &[]).unwrap_err(), "BZIP2 (filter number 307)");
        assert_eq!(Step::new(99, &[]).unwrap_err(), "filter number 99");
        assert!(Step::new(32008, &[0, 4, 4, 0, 7]).is_err());
    }
}
