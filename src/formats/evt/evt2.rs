//! EVT2: words of 32 bits, an event each; and EVT2.1: words of 64 bits, up to 32 events of one row each.
//!
//! The upper four bits are the kind: 0 and 1 OFF and ON events, 8 the upper 28 bits of the time, 10 a trigger
//! edge, 13, 14 and 15 other data without events. An event has the lower 6 bits of its time, 11 bits of
//! column and 11 of row. A word of EVT2.1 is such a word and, below it, a mask of the 32 columns from there
//! on. Source: "EVT 2.0 Format" and "EVT 2.1 Format" of the Prophesee documentation.
//!
//! Two orders of the halves of an EVT2.1 word exist: little-endian as a whole, and "legacy" (IMX636), where
//! the half with the kind comes first.

use super::clock::Clock;
use super::decoder::{Decoder, trigger};
use super::faults::{BURST, Bounds, Buffer, Faults};
use crate::chunk::{EventChunk, Trigger};
use photocurrent_core::Extent;

/// Ticks of the upper time word are 64 us.
const HIGH_NS: i64 = 64_000;
const HIGH_BITS: u32 = 28;
const KIND: u32 = 28;

/// What both decoders know of the time and of what they left out.
#[derive(Clone, Debug)]
struct Core {
    clock: Clock,
    high_ns: i64,
    bounds: Bounds,
    faults: Faults,
}

impl Core {
    fn new() -> Core {
        // Half the period is over two hours: the smallest step is right, forward or back.
        let clock = Clock::new(HIGH_BITS, 1 << (HIGH_BITS - 1), HIGH_NS);
        Core { clock, high_ns: 0, bounds: Bounds::new(None, 2048), faults: Faults::default() }
    }

    /// Time of an event or trigger word.
    #[inline(always)]
    fn t(&self, word: u32) -> i64 {
        self.high_ns + i64::from((word >> 22) & 0x3F) * 1000
    }

    /// A word that is no event.
    fn other(&mut self, word: u32, triggers: &mut Vec<Trigger>) {
        match word >> KIND {
            8 => {
                self.faults.strays += u64::from(self.clock.set(i64::from(word & 0x0FFF_FFFF)));
                self.high_ns = self.clock.ns();
            }
            10 if self.clock.is_set() => {
                triggers.push(trigger(self.t(word), word as u16, ((word >> 8) & 0x1F) as u16))
            }
            10 => self.faults.early += 1,
            // Inertial sensors, counters, continuations.
            13..=15 => {}
            _ => self.faults.unknown += 1,
        }
    }
}

/// Decodes EVT2 words; its state lasts from call to call.
#[derive(Clone, Debug)]
pub struct Evt2Decoder {
    core: Core,
}

impl Default for Evt2Decoder {
    fn default() -> Self {
        Evt2Decoder::new()
    }
}

impl Evt2Decoder {
    /// At the beginning of a stream.
    pub fn new() -> Evt2Decoder {
        Evt2Decoder { core: Core::new() }
    }

    /// Leaves out events outside this extent.
    #[must_use]
    pub fn with_extent(mut self, extent: Option<Extent>) -> Evt2Decoder {
        self.core.bounds = Bounds::new(extent, 2048);
        self
    }

    /// What was left out so far.
    pub fn faults(&self) -> &Faults {
        &self.core.faults
    }

    /// Decodes the whole words of `bytes`, appends events and trigger edges (times in ns), and gives the
    /// number of bytes that were used.
    pub fn decode(&mut self, bytes: &[u8], out: &mut EventChunk, triggers: &mut Vec<Trigger>) -> usize {
        let (words, _) = bytes.as_chunks::<4>();
        let mut rest = words;
        while let Some((word, after)) = rest.split_first()
            && !self.core.clock.is_set()
        {
            let word = u32::from_le_bytes(*word);
            match word >> KIND {
                0 | 1 => self.core.faults.early += 1,
                _ => self.core.other(word, triggers),
            }
            rest = after;
        }
        let Bounds { width, height } = self.core.bounds;
        let mut buffer = Buffer::new();
        for some in rest.chunks(BURST) {
            let mut outside = 0;
            for word in some {
                let word = u32::from_le_bytes(*word);
                let kind = word >> KIND;
                if kind <= 1 {
                    let (x, y) = (((word >> 11) & 0x7FF) as u16, (word & 0x7FF) as u16);
                    let keep = (x < width) & (y < height);
                    buffer.put(keep, self.core.t(word), x, y, kind as u8);
                    outside += u64::from(!keep);
                } else {
                    self.core.other(word, triggers);
                }
            }
            self.core.faults.outside += outside;
            buffer.pass(out);
        }
        buffer.flush(out);
        4 * words.len()
    }
}

impl Decoder for Evt2Decoder {
    const WORD: usize = 4;

    fn decode(&mut self, bytes: &[u8], out: &mut EventChunk, triggers: &mut Vec<Trigger>) -> usize {
        Evt2Decoder::decode(self, bytes, out, triggers)
    }

    fn faults(&self) -> &Faults {
        &self.core.faults
    }
}

/// Decodes EVT2.1 words; its state lasts from call to call.
#[derive(Clone, Debug)]
pub struct Evt21Decoder {
    core: Core,
    /// Turns the halves of a stored word: 32 for legacy files.
    turn: u32,
}

impl Default for Evt21Decoder {
    fn default() -> Self {
        Evt21Decoder::new()
    }
}

impl Evt21Decoder {
    /// At the beginning of a little-endian stream.
    pub fn new() -> Evt21Decoder {
        Evt21Decoder { core: Core::new(), turn: 0 }
    }

    /// Leaves out events outside this extent.
    #[must_use]
    pub fn with_extent(mut self, extent: Option<Extent>) -> Evt21Decoder {
        self.core.bounds = Bounds::new(extent, 2048);
        self
    }

    /// Takes words whose halves are swapped (`endianness=legacy`), or not.
    #[must_use]
    pub fn with_legacy(mut self, legacy: bool) -> Evt21Decoder {
        self.turn = if legacy { 32 } else { 0 };
        self
    }

    /// What was left out so far.
    pub fn faults(&self) -> &Faults {
        &self.core.faults
    }

    /// Decodes the whole words of `bytes`, appends events and trigger edges (times in ns), and gives the
    /// number of bytes that were used.
    pub fn decode(&mut self, bytes: &[u8], out: &mut EventChunk, triggers: &mut Vec<Trigger>) -> usize {
        let (words, _) = bytes.as_chunks::<8>();
        let Bounds { width, height } = self.core.bounds;
        let mut buffer = Buffer::new();
        for some in words.chunks(BURST / 32) {
            for word in some {
                let word = u64::from_le_bytes(*word).rotate_left(self.turn);
                let (upper, mut set) = ((word >> 32) as u32, word as u32);
                let kind = upper >> KIND;
                if kind > 1 {
                    self.core.other(upper, triggers);
                    continue;
                }
                if !self.core.clock.is_set() {
                    self.core.faults.early += u64::from(set.count_ones());
                    continue;
                }
                let (t, first, y) =
                    (self.core.t(upper), ((upper >> 11) & 0x7FF) as u16, (upper & 0x7FF) as u16);
                let row = y < height;
                while set != 0 {
                    let x = first + set.trailing_zeros() as u16;
                    let keep = row & (x < width);
                    buffer.put(keep, t, x, y, kind as u8);
                    self.core.faults.outside += u64::from(!keep);
                    set &= set - 1;
                }
            }
            buffer.pass(out);
        }
        buffer.flush(out);
        8 * words.len()
    }
}

impl Decoder for Evt21Decoder {
    const WORD: usize = 8;

    fn decode(&mut self, bytes: &[u8], out: &mut EventChunk, triggers: &mut Vec<Trigger>) -> usize {
        Evt21Decoder::decode(self, bytes, out, triggers)
    }

    fn faults(&self) -> &Faults {
        &self.core.faults
    }
}
