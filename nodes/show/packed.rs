//! Events of a stretch of time, packed for a page that plays them.
//!
//! Time is cut into slices of one length, a tenth of a millisecond where the stretch is short. Of every slice
//! stand the number of ON and of OFF events, and the pixels of its events: as `2 (y x width + x) + ON`, in
//! rising order, each as its difference from the one before (the first from 0), in groups of seven bits, the
//! lowest first, with the highest bit set where another group follows (LEB128). One event takes one to three
//! bytes.
//!
//! Where that does not fit, events are left out at random, each with the same probability; the numbers of
//! each slice stay those of all events.
//!
//! Limits: within a slice the order of events is lost. For looking, never for scores.

use photocurrent_core::random::Random;
use photocurrent_core::{EventStream, Extent, NodeError, Sensor, TimeSpan};
use photocurrent_solve::pixel_events::clock_offset;

/// Of so many rows events are read at a time.
const ROWS: u32 = 16;
/// The shortest slice, ns.
const SHORTEST_NS: i64 = 100_000;
/// So many slices at most where they are shorter than [`LONG_NS`], and where they are not.
const MOST_SHORT: i64 = 100_000;
const MOST_LONG: i64 = 1_000_000;
const LONG_NS: i64 = 1_000_000;
/// A slice without any event takes so many bytes.
const EMPTY_BYTES: i64 = 3;
/// Bits of a pixel and its sign in a key.
const PLACE_BITS: u32 = 40;
/// The stream of random numbers that decides what is left out.
const STREAM: [u64; 1] = [0x9a7c];

/// How much later than the frames' clock that of the events counts, ns; 0 where no description states it.
///
/// # Errors
/// When the description's clock offset is not understood.
pub fn clock_offset_ns(sensor: Option<&Sensor>) -> Result<i64, NodeError> {
    Ok(sensor.map(clock_offset).transpose()?.map_or(0, |offset| offset.offset_ns))
}

/// Takes events one by one, in any order.
pub struct Packer {
    extent: Extent,
    span: TimeSpan,
    slice_ns: i64,
    on: Vec<u32>,
    off: Vec<u32>,
    /// Slice, pixel and sign of each event that is kept.
    keys: Vec<u64>,
    /// The probability with which an event is kept.
    share: f64,
    most: usize,
    random: Random,
    outside: u64,
}

/// Events of a stretch of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Packed {
    /// Columns of the array.
    pub width: u32,
    /// Rows of the array.
    pub height: u32,
    /// Where the first slice begins, ns.
    pub start_ns: i64,
    /// Length of a slice, ns.
    pub slice_ns: i64,
    /// Number of slices.
    pub slices: usize,
    /// ON events of the stretch.
    pub on: u64,
    /// OFF events of the stretch.
    pub off: u64,
    /// How many of both are packed.
    pub kept: u64,
    /// Events of the stretch that lie outside of the array, and are in no number.
    pub outside: u64,
    /// Of each slice, as LEB128: the number of its ON events.
    pub on_counts: Vec<u8>,
    /// Of each slice, as LEB128: the number of its OFF events.
    pub off_counts: Vec<u8>,
    /// Of each slice, as LEB128: how many bytes of `places` are its own.
    pub lengths: Vec<u8>,
    /// The pixels.
    pub places: Vec<u8>,
}

impl Packed {
    /// Bytes of it all.
    pub fn bytes(&self) -> u64 {
        (self.on_counts.len() + self.off_counts.len() + self.lengths.len() + self.places.len()) as u64
    }
}

/// The shortest slice, ns, that cuts a stretch into so few that they fit into `budget` bytes with room for
/// events: 1, 2 or 5 times a power of ten.
fn slice_of(span: TimeSpan, budget: u64) -> i64 {
    let mut slice = SHORTEST_NS;
    loop {
        let slices = (span.length_ns().max(1) as u64).div_ceil(slice as u64) as i64;
        let most = if slice < LONG_NS { MOST_SHORT } else { MOST_LONG };
        if slices <= most && slices * EMPTY_BYTES <= (budget / 4) as i64 || slice > span.length_ns() {
            return slice;
        }
        let leads_two = slice.to_string().starts_with('2');
        slice = if leads_two { slice / 2 * 5 } else { slice * 2 };
    }
}

impl Packer {
    /// For events of an array within `span`, of which `budget` bytes may be made.
    pub fn new(extent: Extent, span: TimeSpan, budget: u64) -> Packer {
        let slice_ns = slice_of(span, budget);
        let slices = (span.length_ns().max(1) as u64).div_ceil(slice_ns as u64) as usize;
        Packer {
            extent,
            span,
            slice_ns,
            on: vec![0; slices],
            off: vec![0; slices],
            keys: Vec::new(),
            share: 1.0,
            // An event takes a byte or more: half of twice as many still fill the budget.
            most: 2 * budget.max(1) as usize,
            random: Random::new(0, &STREAM),
            outside: 0,
        }
    }

    /// Takes an event; one outside of the stretch is passed over.
    #[inline]
    pub fn push(&mut self, t_ns: i64, x: u16, y: u16, is_on: bool) {
        if t_ns < self.span.start.0 || t_ns >= self.span.end.0 {
            return;
        }
        if u32::from(x) >= self.extent.width || u32::from(y) >= self.extent.height {
            self.outside += 1;
            return;
        }
        let slice = ((t_ns - self.span.start.0) / self.slice_ns) as usize;
        let counts = if is_on { &mut self.on } else { &mut self.off };
        counts[slice] += 1;
        if self.share < 1.0 && self.random.uniform() >= self.share {
            return;
        }
        let place = 2 * (u64::from(y) * u64::from(self.extent.width) + u64::from(x)) + u64::from(is_on);
        self.keys.push((slice as u64) << PLACE_BITS | place);
        if self.keys.len() > self.most {
            self.thin(0.5);
        }
    }

    /// Takes the events of a stream, each `shift_ns` earlier.
    ///
    /// # Errors
    /// When the events cannot be read.
    pub fn push_all(&mut self, events: &EventStream, shift_ns: i64) -> Result<(), NodeError> {
        let window = self.span.moved(shift_ns);
        for rows in events.rows().bands(ROWS) {
            let band = events.read_within(rows, window)?;
            for y in rows.iter() {
                let row = band.row(y);
                for ((&t, &x), &on) in row.t.iter().zip(row.x).zip(row.on) {
                    self.push(t - shift_ns, x, y as u16, on == 1);
                }
            }
        }
        Ok(())
    }

    /// Leaves out events at random; each stays with probability `share`.
    fn thin(&mut self, share: f64) {
        self.share *= share;
        let random = &mut self.random;
        self.keys.retain(|_| random.uniform() < share);
    }

    /// All of it in at most `budget` bytes, as far as leaving out events allows. What is left out is gone for
    /// the next call as well.
    pub fn pack(&mut self, budget: u64) -> Packed {
        self.keys.sort_unstable();
        loop {
            let packed = self.encoded();
            let (bytes, places) = (packed.bytes(), packed.places.len() as u64);
            if bytes <= budget || places == 0 {
                return packed;
            }
            let room = budget.saturating_sub(bytes - places) as f64;
            self.thin(0.97 * room / places as f64);
        }
    }

    fn encoded(&self) -> Packed {
        let sum = |counts: &[u32]| counts.iter().map(|&count| u64::from(count)).sum();
        let all = |counts: &[u32]| {
            let mut bytes = Vec::with_capacity(counts.len());
            counts.iter().for_each(|&count| push_number(count.into(), &mut bytes));
            bytes
        };
        let mut packed = Packed {
            width: self.extent.width,
            height: self.extent.height,
            start_ns: self.span.start.0,
            slice_ns: self.slice_ns,
            slices: self.on.len(),
            on: sum(&self.on),
            off: sum(&self.off),
            kept: self.keys.len() as u64,
            outside: self.outside,
            on_counts: all(&self.on),
            off_counts: all(&self.off),
            ..Packed::default()
        };
        let mut keys = self.keys.iter().peekable();
        for slice in 0..self.on.len() as u64 {
            let (begin, mut last) = (packed.places.len(), 0);
            while let Some(&key) = keys.next_if(|key| **key >> PLACE_BITS == slice) {
                let place = key & ((1 << PLACE_BITS) - 1);
                push_number(place - last, &mut packed.places);
                last = place;
            }
            push_number((packed.places.len() - begin) as u64, &mut packed.lengths);
        }
        packed
    }
}

/// LEB128.
fn push_number(mut number: u64, bytes: &mut Vec<u8>) {
    while number >= 0x80 {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXTENT: Extent = Extent { width: 100, height: 50 };

    fn packer(span: TimeSpan, budget: u64) -> Packer {
        Packer::new(EXTENT, span, budget)
    }

    #[test]
    fn events_stand_in_their_slices_as_the_form_states() {
        let mut packer = packer(TimeSpan::new(1_000_000, 1_250_000), 1000);
        // By hand: 2 (3 x 100 + 7) + 1 = 615 = 4 x 128 + 103; the next is 2 behind it; a slice of nothing;
        // (99, 49) OFF is 9998 = 78 x 128 + 14.
        packer.push(1_000_000, 7, 3, true);
        packer.push(1_099_999, 8, 3, true);
        packer.push(1_200_000, 99, 49, false);
        // Not in the stretch, and not on the array.
        packer.push(999_999, 0, 0, true);
        packer.push(1_250_000, 0, 0, true);
        packer.push(1_200_000, 100, 0, true);
        let packed = packer.pack(1000);
        assert_eq!((packed.slice_ns, packed.slices, packed.start_ns), (100_000, 3, 1_000_000));
        assert_eq!((packed.on, packed.off, packed.kept, packed.outside), (2, 1, 3, 1));
        assert_eq!(packed.places, [103 | 0x80, 4, 2, 14 | 0x80, 78]);
        assert_eq!(packed.lengths, [3, 0, 2]);
        assert_eq!((packed.on_counts, packed.off_counts), (vec![2, 0, 0], vec![0, 0, 1]));
    }

    #[test]
    fn a_budget_is_kept_and_the_numbers_stay_those_of_all_events() {
        let fill = |budget| {
            let mut packer = packer(TimeSpan::new(0, 1_000_000), budget);
            for k in 0..20_000_i64 {
                packer.push(k * 50, (k * 7 % 100) as u16, (k * 13 % 50) as u16, k % 4 == 0);
            }
            packer.pack(budget)
        };
        let whole = fill(1 << 20);
        assert_eq!((whole.on, whole.off, whole.kept), (5_000, 15_000, 20_000));
        let small = fill(4000);
        assert_eq!((small.on, small.off), (5_000, 15_000));
        assert!(small.bytes() <= 4000 && small.bytes() > 3200, "{}", small.bytes());
        assert_eq!(small, fill(4000), "the same events are left out each time");
        // A quarter of what is kept is ON, as of all: within four standard deviations.
        let mut on = 0;
        let mut at = small.places.iter();
        for length in small_lengths(&small) {
            let (mut read, mut place) = (0, 0);
            while read < length {
                let (mut number, mut shift) = (0_u64, 0);
                loop {
                    let byte = at.next().unwrap();
                    read += 1;
                    number |= u64::from(byte & 0x7f) << shift;
                    shift += 7;
                    if byte & 0x80 == 0 {
                        break;
                    }
                }
                place += number;
                on += place & 1;
            }
        }
        let (kept, on) = (small.kept as f64, on as f64);
        assert!((on - 0.25 * kept).abs() < 4.0 * (kept * 0.25 * 0.75).sqrt(), "{on} of {kept}");
    }

    fn small_lengths(packed: &Packed) -> Vec<u64> {
        let mut lengths = vec![0_u64];
        let mut shift = 0;
        for byte in &packed.lengths {
            *lengths.last_mut().unwrap() |= u64::from(byte & 0x7f) << shift;
            shift += 7;
            if byte & 0x80 == 0 {
                lengths.push(0);
                shift = 0;
            }
        }
        lengths.pop();
        lengths
    }

    #[test]
    fn slices_are_short_where_they_can_be() {
        let slice = |ms: i64, budget| slice_of(TimeSpan::new(0, ms * 1_000_000), budget);
        assert_eq!(slice(80, 10 << 20), 100_000);
        assert_eq!(slice(9_999, 10 << 20), 100_000);
        assert_eq!(slice(30_000, 10 << 20), 500_000);
        assert_eq!(slice(600_000, 20 << 20), 1_000_000);
        assert_eq!(slice(3_600_000, 20 << 20), 5_000_000);
        assert_eq!(slice(80, 100), 10_000_000, "eight slices of three bytes are a quarter of it");
        assert_eq!(slice(80, 0), 100_000_000, "there is always an answer");
        assert_eq!(slice(0, 1000), 100_000);
    }

    #[test]
    fn nothing_is_packed_as_nothing() {
        let packed = packer(TimeSpan::new(0, 0), 1000).pack(1000);
        assert_eq!((packed.slices, packed.kept, packed.places.len()), (1, 0, 0));
    }
}
