//! DAT: decoded events of Prophesee cameras, records of eight bytes: a time of 32 bits in microseconds, and
//! column, row and polarity in 32 more.
//!
//! Version 2 has 14 bits of column, 14 of row, and the polarity above them. Version 1 (ATIS) has 9 bits, 8
//! bits and one. Source: "DAT File Format" of the Prophesee documentation; for version 1 the loaders that the
//! maker published for Matlab. The time wraps after 71 minutes; it goes on from one record to the next by the
//! smallest step, forward or back.

use super::decoder::Decoder;
use super::faults::{BURST, Bounds, Buffer, Faults};
use crate::chunk::{EventChunk, Trigger};
use photocurrent_core::Extent;

/// Where column, row and polarity stand in a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DatLayout {
    /// Version 1: 9 bits of column, 8 of row, 1 of polarity.
    V1,
    /// Version 2: 14 bits of column, 14 of row, 4 of polarity.
    V2,
}

/// Times stay within this many us of zero, whatever a damaged file says.
const FURTHEST_US: i64 = i64::MAX / 4_000;

/// Decodes records of DAT; its state lasts from call to call.
#[derive(Clone, Debug)]
pub struct DatDecoder {
    layout: DatLayout,
    /// The time, continued; `None` before the first record.
    us: Option<i64>,
    bounds: Bounds,
    faults: Faults,
}

impl DatDecoder {
    /// At the first record.
    pub fn new(layout: DatLayout) -> DatDecoder {
        DatDecoder { layout, us: None, bounds: Bounds::new(None, 1 << 14), faults: Faults::default() }
    }

    /// Leaves out events outside this extent.
    #[must_use]
    pub fn with_extent(mut self, extent: Option<Extent>) -> DatDecoder {
        self.bounds = Bounds::new(extent, 1 << 14);
        self
    }

    /// What was left out so far.
    pub fn faults(&self) -> &Faults {
        &self.faults
    }

    /// Decodes the whole records of `bytes`, appends events (times in ns), and gives the number of bytes that
    /// were used.
    pub fn decode(&mut self, bytes: &[u8], out: &mut EventChunk) -> usize {
        let (records, _) = bytes.as_chunks::<8>();
        match self.layout {
            DatLayout::V1 => self.decode_bits::<9, 8>(records, out),
            DatLayout::V2 => self.decode_bits::<14, 14>(records, out),
        }
        8 * records.len()
    }

    fn decode_bits<const X: u32, const Y: u32>(&mut self, records: &[[u8; 8]], out: &mut EventChunk) {
        let Some(first) = records.first() else { return };
        let mut us = self.us.unwrap_or_else(|| i64::from(u64::from_le_bytes(*first) as u32));
        let Bounds { width, height } = self.bounds;
        let mut outside = 0;
        let mut buffer = Buffer::new();
        for some in records.chunks(BURST) {
            for record in some {
                let record = u64::from_le_bytes(*record);
                us += i64::from((record as u32).wrapping_sub(us as u32) as i32);
                let place = (record >> 32) as u32;
                let (x, y) = ((place & ((1 << X) - 1)) as u16, ((place >> X) & ((1 << Y) - 1)) as u16);
                let keep = (x < width) & (y < height);
                buffer.put(keep, us * 1000, x, y, ((place >> (X + Y)) & 1) as u8);
                outside += u64::from(!keep);
            }
            // At most BURST half periods may have been added: far from an overflow.
            us = us.clamp(-FURTHEST_US, FURTHEST_US);
            buffer.pass(out);
        }
        buffer.flush(out);
        self.us = Some(us);
        self.faults.outside += outside;
    }
}

impl Decoder for DatDecoder {
    const WORD: usize = 8;

    fn decode(&mut self, bytes: &[u8], out: &mut EventChunk, _: &mut Vec<Trigger>) -> usize {
        DatDecoder::decode(self, bytes, out)
    }

    fn faults(&self) -> &Faults {
        &self.faults
    }
}
