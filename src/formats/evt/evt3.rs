//! EVT3: words of 16 bits, of which each says only what has changed since the one before.
//!
//! The upper four bits are the kind: 0 row, 2 event (column and polarity), 3 column and polarity at which a
//! vector begins, 4 and 5 vectors of 12 and 8 columns, 6 and 8 the lower and upper 12 bits of the time, 10 a
//! trigger edge, 7, 13, 14 and 15 other data that carry no events. Source: "EVT 3.0 Format" of the Prophesee
//! documentation. Time is 24 bits of microseconds; [`super::clock`] continues it over its wraps.
//!
//! An upper time word that differs from the one before sets the lower bits to zero until the next lower time
//! word, as the maker's own decoder has it. A lower time word that steps back is not a carry: cameras do
//! write stamps out of order by some microseconds.

use super::clock::Clock;
use super::decoder::{Decoder, trigger};
use super::faults::{BURST, Bounds, Buffer, Faults};
use crate::chunk::{EventChunk, Trigger};
use photocurrent_core::Extent;

/// Ticks of the upper time word are 4096 us.
const HIGH_NS: i64 = 4_096_000;
/// Steps of the upper time word up to 0.26 s may go either way.
const SLACK: i64 = 64;
/// Words between two looks at the buffer: each may be a vector of 12 events.
const STRIDE: usize = BURST / 12;

/// What words have said, in one number of four lanes of 16 bits, so that a word changes it without a branch:
/// the row; column and polarity of a vector's begin; the lower bits of the time; columns that vectors have
/// gone on since.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Said(u64);

impl Said {
    /// Nothing yet: the row is beyond every extent.
    const NOTHING: Said = Said(Said::NO_ROW);
    const NO_ROW: u64 = 0x8000;
    const LOW: u32 = 32;
    const RUN: u32 = 48;
    /// Which lanes a word of each kind sets: a row its own, a vector's begin two, a lower time word its own.
    const SETS: [u64; 16] =
        [0xFFFF, 0, 0, 0xFFFF_0000_FFFF_0000, 0, 0, 0xFFFF_0000_0000, 0, 0, 0, 0, 0, 0, 0, 0, 0];

    /// After a word.
    #[inline(always)]
    fn after(self, word: u16) -> Said {
        let sets = Said::SETS[usize::from(word >> 12)];
        // The value in the three lower lanes at once.
        let value = u64::from(word & 0xFFF) * 0x0001_0001_0001;
        Said(self.0 & !sets | value & sets)
    }

    /// After a vector; far beyond the last column it goes no further.
    #[inline(always)]
    fn after_columns(self, columns: u64) -> Said {
        Said(self.0 + if self.0 >> Said::RUN < 4096 { columns << Said::RUN } else { 0 })
    }

    #[inline(always)]
    fn row(self) -> u16 {
        self.0 as u16 & 0x87FF
    }

    #[inline(always)]
    fn low_ns(self) -> i64 {
        ((self.0 >> Said::LOW) & 0xFFF) as i64 * 1000
    }

    /// Column where the next vector begins.
    #[inline(always)]
    fn column(self) -> u32 {
        ((self.0 >> 16) & 0x7FF) as u32 + (self.0 >> Said::RUN) as u32
    }

    /// Polarity of vectors.
    #[inline(always)]
    fn on(self) -> u8 {
        (self.0 >> 27) as u8 & 1
    }

    fn without_row(self) -> Said {
        Said(self.0 & !0xFFFF | Said::NO_ROW)
    }

    fn without_low(self) -> Said {
        Said(self.0 & !(0xFFFF << Said::LOW))
    }
}

/// Decodes EVT3 words; its state lasts from call to call.
#[derive(Clone, Debug)]
pub struct Evt3Decoder {
    clock: Clock,
    high: u16,
    high_ns: i64,
    said: Said,
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
        Evt3Decoder { clock, high: 0, high_ns: 0, said: Said::NOTHING, bounds, faults: Faults::default() }
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

    /// Decodes the whole words of `bytes`, appends events and trigger edges (times in ns), and gives the
    /// number of bytes that were used.
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
                2 | 10 => self.faults.early += 1,
                4 | 5 => {
                    let (set, columns) = vector(word);
                    self.faults.early += u64::from(set.count_ones());
                    self.said = self.said.after_columns(columns);
                }
                // A lower time word has no meaning without an upper one.
                6 => {}
                1 => self.said = self.said.without_row(),
                _ => self.said = self.said.after(word),
            }
        }
        &[]
    }

    /// The inner loop: what events are made of without a branch on the kind, vectors with one, all else
    /// apart.
    #[inline]
    fn decode_some(&mut self, words: &[[u8; 2]], buffer: &mut Buffer, triggers: &mut Vec<Trigger>) {
        const PLAIN: u32 = 1 << 0 | 1 << 2 | 1 << 3 | 1 << 6;
        let Bounds { width, height } = self.bounds;
        let (mut said, mut high_ns) = (self.said, self.high_ns);
        let (mut found, before) = (0, buffer.len());
        for word in words {
            let word = u16::from_le_bytes(*word);
            let kind = word >> 12;
            if (PLAIN >> kind) & 1 == 1 {
                let (x, y, is_event) = (word & 0x7FF, said.row(), kind == 2);
                let keep = is_event & (x < width) & (y < height);
                buffer.put(keep, high_ns + said.low_ns(), x, y, (word >> 11) as u8 & 1);
                found += usize::from(is_event);
                said = said.after(word);
            } else if kind == 4 || kind == 5 {
                let (mut set, columns) = vector(word);
                let (t, first, y, on) = (high_ns + said.low_ns(), said.column(), said.row(), said.on());
                let (row, width) = (y < height, u32::from(width));
                // Most vectors hold one event or two; the first two are put without a branch.
                for _ in 0..2 {
                    let x = first + set.trailing_zeros();
                    buffer.put((set != 0) & row & (x < width), t, x as u16, y, on);
                    found += usize::from(set != 0);
                    set &= set.wrapping_sub(1);
                }
                while set != 0 {
                    let x = first + set.trailing_zeros();
                    buffer.put(row & (x < width), t, x as u16, y, on);
                    found += 1;
                    set &= set - 1;
                }
                said = said.after_columns(columns);
            } else {
                said = self.decode_rare(word, said, triggers);
                high_ns = self.high_ns;
            }
        }
        self.said = said;
        self.faults.outside += (found - (buffer.len() - before)) as u64;
    }

    /// Words that are no part of an event: upper time words, triggers, others.
    #[inline(never)]
    fn decode_rare(&mut self, word: u16, said: Said, triggers: &mut Vec<Trigger>) -> Said {
        match word >> 12 {
            8 => return self.time_high(word & 0xFFF, said),
            10 => triggers.push(trigger(self.high_ns + said.low_ns(), word, (word >> 8) & 0xF)),
            // More data of a kind that carries no events: counters, inertial sensors, continuations.
            7 | 13 | 14 | 15 => {}
            // A row of intensity measurements, of old cameras: what follows are no events.
            1 => {
                self.faults.unknown += 1;
                return said.without_row();
            }
            _ => self.faults.unknown += 1,
        }
        said
    }

    /// Takes an upper time word. A new one holds with lower bits of zero until the next lower time word.
    fn time_high(&mut self, raw: u16, said: Said) -> Said {
        if self.clock.is_set() && raw == self.high {
            return said;
        }
        self.faults.strays += u64::from(self.clock.set(i64::from(raw)));
        self.high = raw;
        self.high_ns = self.clock.ns();
        said.without_low()
    }
}

/// The columns that a vector word has set, and how many it covers.
#[inline(always)]
fn vector(word: u16) -> (u32, u64) {
    if word >> 12 == 4 { (u32::from(word & 0xFFF), 12) } else { (u32::from(word & 0xFF), 8) }
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
