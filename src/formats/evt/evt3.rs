//! EVT3: words of 16 bits, of which each says only what has changed since the one before.
//!
//! The upper four bits are the kind: 0 row, 2 event (column and polarity), 3 column and polarity at which a vector begins, 4 and 5 vectors of 12 and 8
//! columns, 6 and 8 the lower and upper 12 bits of the time, 10 a trigger edge, 7, 13, 14 and 15 other data that carry no events.
//! Source: "EVT 3.0 Format" of the Prophesee documentation. Time is 24 bits of microseconds; [`super::clock`] continues it over its wraps.
//!
//! An upper time word that differs from the one before sets the lower bits to zero until the next lower time word, as the maker's own decoder
//! has it. A lower time word that steps back is not a carry: cameras do write stamps out of order by some microseconds.

use super::clock::Clock;
use super::faults::{BURST, Bounds, Buffer, Faults};
use super::{Decoder, trigger};
use crate::chunk::{EventChunk, Trigger};
use photocurrent_core::Extent;

/// Ticks of the upper time word are 4096 us.
const HIGH_NS: i64 = 4_096_000;
/// Steps of the upper time word up to 0.26 s may go either way.
const SLACK: i64 = 64;
/// No row was named yet, or the row is not one of events.
const NO_ROW: u16 = u16::MAX;
/// Words between two looks at the buffer: each may be a vector of 12 events.
const STRIDE: usize = BURST / 12;
/// Beyond every column; vectors do not run further.
const FAR: u32 = 1 << 15;

/// Decodes EVT3 words; its state lasts from call to call.
#[derive(Clone, Debug)]
pub struct Evt3Decoder {
    clock: Clock,
    high: u16,
    high_ns: i64,
    t: i64,
    y: u16,
    base: u32,
    base_on: u8,
    bounds: Bounds,
    faults: Faults,
}

impl Default for Evt3Decoder {
    fn default() -> Self {
        Evt3Decoder::new()
    }
}

impl Evt3Decoder {
    /// At the beginning of a stream.
    pub fn new() -> Evt3Decoder {
        let bounds = Bounds::new(None, 2048);
        let clock = Clock::new(12, SLACK, HIGH_NS);
        Evt3Decoder { clock, high: 0, high_ns: 0, t: 0, y: NO_ROW, base: 0, base_on: 0, bounds, faults: Faults::default() }
    }

    /// Leaves out events outside this extent.
    #[must_use]
    pub fn with_extent(mut self, extent: Option<Extent>) -> Evt3Decoder {
        self.bounds = Bounds::new(extent, 2048);
        self
    }

    /// What was left out so far.
    pub fn faults(&self) -> &Faults {
        &self.faults
    }

    /// Decodes the whole words of `bytes`, appends events and trigger edges (times in ns), and gives the number of bytes that were used.
    pub fn decode(&mut self, bytes: &[u8], out: &mut EventChunk, triggers: &mut Vec<Trigger>) -> usize {
        let (words, _) = bytes.as_chunks::<2>();
        let mut rest = words;
        if !self.clock.is_set() {
            rest = self.seek_time(words);
        }
        let mut buffer = Buffer::new();
        for some in rest.chunks(STRIDE) {
            self.decode_some(some, &mut buffer, triggers);
            buffer.pass(out);
        }
        buffer.flush(out);
        2 * words.len()
    }

    /// Skips to the first upper time word: events before it have no time. Rows and bases are kept.
    fn seek_time<'a>(&mut self, words: &'a [[u8; 2]]) -> &'a [[u8; 2]] {
        for (at, word) in words.iter().enumerate() {
            let word = u16::from_le_bytes(*word);
            match word >> 12 {
                8 => return &words[at..],
                0 => self.y = word & 0x7FF,
                1 => self.y = NO_ROW,
                2 => self.faults.early += 1,
                3 => self.set_base(word),
                4 => self.skip_vector(word & 0xFFF, 12),
                5 => self.skip_vector(word & 0xFF, 8),
                _ => {}
            }
        }
        &[]
    }

    fn skip_vector(&mut self, set: u16, columns: u32) {
        self.faults.early += u64::from(set.count_ones());
        self.base = (self.base + columns).min(FAR);
    }

    fn set_base(&mut self, word: u16) {
        self.base = u32::from(word & 0x7FF);
        self.base_on = ((word >> 11) & 1) as u8;
    }

    /// The inner loop: what events are made of without a branch on the kind, all else apart.
    #[inline]
    fn decode_some(&mut self, words: &[[u8; 2]], buffer: &mut Buffer, triggers: &mut Vec<Trigger>) {
        const PLAIN: u32 = 1 << 0 | 1 << 2 | 1 << 3 | 1 << 6;
        let Bounds { width, height } = self.bounds;
        let (mut t, mut y, mut base, mut base_on) = (self.t, self.y, self.base, self.base_on);
        let mut outside = 0;
        for word in words {
            let word = u16::from_le_bytes(*word);
            let kind = word >> 12;
            if (PLAIN >> kind) & 1 == 1 {
                let x = word & 0x7FF;
                let on = ((word >> 11) & 1) as u8;
                let is_event = kind == 2;
                let keep = is_event & (x < width) & (y < height);
                buffer.put(keep, t, x, y, on);
                outside += u64::from(is_event & !keep);
                y = if kind == 0 { x } else { y };
                base = if kind == 3 { u32::from(x) } else { base };
                base_on = if kind == 3 { on } else { base_on };
                t = if kind == 6 { self.high_ns + i64::from(word & 0xFFF) * 1000 } else { t };
            } else if kind == 4 || kind == 5 {
                let (mask, columns) = if kind == 4 { (0xFFF, 12) } else { (0xFF, 8) };
                let mut set = u32::from(word & mask);
                let row = y < height;
                let width = u32::from(width);
                // Most vectors hold one event or two; the first two are put without a branch.
                for _ in 0..2 {
                    let x = base + set.trailing_zeros();
                    let keep = (set != 0) & row & (x < width);
                    buffer.put(keep, t, x as u16, y, base_on);
                    outside += u64::from((set != 0) & !keep);
                    set &= set.wrapping_sub(1);
                }
                while set != 0 {
                    let x = base + set.trailing_zeros();
                    let keep = row & (x < width);
                    buffer.put(keep, t, x as u16, y, base_on);
                    outside += u64::from(!keep);
                    set &= set - 1;
                }
                base = (base + columns).min(FAR);
            } else {
                match kind {
                    8 => t = self.time_high(word & 0xFFF, t),
                    10 => triggers.push(trigger(t, word, (word >> 8) & 0xF)),
                    // More data of a kind that carries no events: counters, inertial sensors, continuations.
                    7 | 13 | 14 | 15 => {}
                    // A row of intensity measurements, of old cameras: what follows are no events.
                    1 => {
                        y = NO_ROW;
                        self.faults.unknown += 1;
                    }
                    _ => self.faults.unknown += 1,
                }
            }
        }
        (self.t, self.y, self.base, self.base_on) = (t, y, base, base_on);
        self.faults.outside += outside;
    }

    /// Takes an upper time word; gives the time that holds until the next lower one.
    fn time_high(&mut self, raw: u16, t: i64) -> i64 {
        let known = self.clock.is_set();
        if known && raw == self.high {
            return t;
        }
        self.faults.strays += u64::from(self.clock.set(i64::from(raw)));
        self.high = raw;
        self.high_ns = self.clock.ns();
        self.high_ns
    }
}

impl Decoder for Evt3Decoder {
    const WORD: usize = 2;

    fn decode(&mut self, bytes: &[u8], out: &mut EventChunk, triggers: &mut Vec<Trigger>) -> usize {
        Evt3Decoder::decode(self, bytes, out, triggers)
    }

    fn faults(&self) -> &Faults {
        &self.faults
    }
}
