//! Codecs of HDF5 filters that other programs use: each fills an output of a known length, or says in words
//! what is wrong.
//!
//! Nothing here takes memory by what the bytes claim: the caller knows how long a chunk is and gives the room
//! for it. Sources: the authors' own descriptions (liblzf, c-blosc `README_CHUNK_FORMAT`, bitshuffle, the
//! HDF5 file format, Prophesee's published ECF codec).

pub(crate) mod bits;
pub(crate) mod blosc;
pub(crate) mod ecf;

/// What a codec gives: the output is full, or this is wrong.
pub(crate) type Filled = Result<(), String>;

/// Bytes that are taken from the front, never beyond their end.
pub(crate) struct Bytes<'a> {
    rest: &'a [u8],
}

impl<'a> Bytes<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Bytes<'a> {
        Bytes { rest: bytes }
    }

    pub(crate) fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let (taken, rest) = self
            .rest
            .split_at_checked(count)
            .ok_or_else(|| "it ends in the middle of a field".to_string())?;
        self.rest = rest;
        Ok(taken)
    }

    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    pub(crate) fn u8(&mut self) -> Result<u8, String> {
        Ok(self.array::<1>()?[0])
    }

    pub(crate) fn u16(&mut self) -> Result<u16, String> {
        self.array().map(u16::from_le_bytes)
    }

    pub(crate) fn u32(&mut self) -> Result<u32, String> {
        self.array().map(u32::from_le_bytes)
    }

    pub(crate) fn u32_be(&mut self) -> Result<u32, String> {
        self.array().map(u32::from_be_bytes)
    }

    pub(crate) fn u64_be(&mut self) -> Result<u64, String> {
        self.array().map(u64::from_be_bytes)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.rest.is_empty()
    }
}

/// Copies `length` bytes that begin `distance` before `at`, one by one where they overlap.
fn repeat(out: &mut [u8], at: usize, distance: usize, length: usize) -> Filled {
    if distance == 0 || distance > at || length > out.len() - at {
        return Err("a repetition points outside".into());
    }
    if distance >= length {
        out.copy_within(at - distance..at - distance + length, at);
    } else {
        for i in at..at + length {
            out[i] = out[i - distance];
        }
    }
    Ok(())
}

/// Copies bytes as they are.
fn literal(out: &mut [u8], at: usize, bytes: &[u8]) -> Filled {
    let room = out
        .get_mut(at..at + bytes.len())
        .ok_or_else(|| "there are more bytes than the chunk holds".to_string())?;
    room.copy_from_slice(bytes);
    Ok(())
}

fn full(at: usize, out: &[u8]) -> Filled {
    if at == out.len() { Ok(()) } else { Err(format!("{at} bytes come out instead of {}", out.len())) }
}

/// LZF, h5py's own filter.
pub(crate) fn lzf(bytes: &[u8], out: &mut [u8]) -> Filled {
    let (mut from, mut at) = (Bytes::new(bytes), 0);
    while !from.is_empty() {
        let control = usize::from(from.u8()?);
        let length = if control < 32 {
            let bytes = from.take(control + 1)?;
            literal(out, at, bytes)?;
            bytes.len()
        } else {
            let more = if control >> 5 == 7 { usize::from(from.u8()?) } else { 0 };
            let length = (control >> 5) + more + 2;
            let distance = ((control & 31) << 8) + usize::from(from.u8()?) + 1;
            repeat(out, at, distance, length)?;
            length
        };
        at += length;
    }
    full(at, out)
}

/// One LZ4 block.
pub(crate) fn lz4_block(bytes: &[u8], out: &mut [u8]) -> Filled {
    let written = lz4_flex::block::decompress_into(bytes, out).map_err(|error| format!("LZ4: {error}"))?;
    full(written, out)
}

/// One Zstandard frame or several.
pub(crate) fn zstd_frames(bytes: &[u8], out: &mut [u8]) -> Filled {
    let written =
        zstd::bulk::decompress_to_buffer(bytes, out).map_err(|error| format!("Zstandard: {error}"))?;
    full(written, out)
}

/// A zlib stream.
pub(crate) fn deflate(bytes: &[u8], out: &mut [u8]) -> Filled {
    let mut inflate = flate2::Decompress::new(true);
    match inflate.decompress(bytes, out, flate2::FlushDecompress::Finish) {
        Ok(flate2::Status::StreamEnd) => full(inflate.total_out() as usize, out),
        Ok(_) => Err("a compressed chunk does not end where it should".into()),
        Err(error) => Err(format!("a compressed chunk is damaged ({error})")),
    }
}

/// The filter LZ4 of HDF5 (32004): sizes in front, then blocks.
pub(crate) fn lz4(bytes: &[u8], out: &mut [u8]) -> Filled {
    let mut from = Bytes::new(bytes);
    full(from.u64_be()?.try_into().unwrap_or(usize::MAX), out)?;
    let block = from.u32_be()? as usize;
    if block == 0 && !out.is_empty() {
        return Err("blocks of 0 bytes".into());
    }
    for room in out.chunks_mut(block.max(1)) {
        let size = from.u32_be()? as usize;
        let packed = from.take(size)?;
        if size == room.len() { room.copy_from_slice(packed) } else { lz4_block(packed, room)? }
    }
    Ok(())
}

/// Cuts off and compares the checksum of the filter fletcher32.
pub(crate) fn fletcher32(mut bytes: Vec<u8>) -> Result<Vec<u8>, String> {
    let end = bytes.len().checked_sub(4).ok_or("a chunk is too short for its checksum")?;
    let stored: [u8; 4] = std::array::from_fn(|i| bytes[end + i]);
    bytes.truncate(end);
    let sum = fletcher32_of(&bytes).to_le_bytes();
    // Versions before 1.6.3 swapped the bytes of both halves on little-endian machines; the library accepts
    // both.
    if stored == sum || stored == [sum[1], sum[0], sum[3], sum[2]] {
        Ok(bytes)
    } else {
        Err("the checksum of a chunk is wrong".into())
    }
}

fn fletcher32_of(bytes: &[u8]) -> u32 {
    let (mut sum1, mut sum2) = (0u32, 0u32);
    let fold = |sum: u32| (sum & 0xffff) + (sum >> 16);
    // 360 words fit 32 bits before the sums must be folded.
    let (words, last) = bytes.as_chunks::<2>();
    for block in words.chunks(360) {
        for word in block {
            sum1 += u32::from(u16::from_be_bytes(*word));
            sum2 += sum1;
        }
        (sum1, sum2) = (fold(sum1), fold(sum2));
    }
    if let [byte] = last {
        sum1 += u32::from(*byte) << 8;
        sum2 += sum1;
        (sum1, sum2) = (fold(sum1), fold(sum2));
    }
    (fold(sum2) << 16) | fold(sum1)
}
