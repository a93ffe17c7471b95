//! What a decoder had to leave out, counted; and the small buffer through which all decoders give their
//! events.

use crate::chunk::EventChunk;
use photocurrent_core::Extent;

/// Words and events that a decoder left out, counted since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// Events and trigger edges that stand before the first time word (of EVT2, EVT2.1 and EVT3): they have
    /// no time.
    pub early: u64,
    /// Events outside the extent, and events of EVT3 before any row was named.
    pub outside: u64,
    /// Words of a kind that the format does not define.
    pub unknown: u64,
    /// Time words that leap away and back again; events between the leap and the return carry a wrong stamp.
    pub strays: u64,
}

impl Faults {
    /// The counts in one order, for a loop over kinds.
    pub(crate) fn counts(&self) -> [u64; 4] {
        [self.early, self.outside, self.unknown, self.strays]
    }
}

/// The first column and the first row outside; 2048 is what the bits of EVT words can say at most.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    pub width: u16,
    pub height: u16,
}

impl Bounds {
    /// From an extent; without one, `most` in both directions.
    pub(super) fn new(extent: Option<Extent>, most: u16) -> Bounds {
        let within = |n: u32| u16::try_from(n).unwrap_or(most).min(most);
        extent.map_or(Bounds { width: most, height: most }, |extent| Bounds {
            width: within(extent.width),
            height: within(extent.height),
        })
    }
}

/// Events of a buffer: 13 KiB, so that they stay in the first-level cache until they go out.
const N: usize = 1024;

/// Most events that may be put between two calls of [`Buffer::pass`].
pub(crate) const BURST: usize = 768;

/// Events on their way out.
///
/// Every word writes into it, whether it is an event or not, and only the count decides whether the write
/// stands: a branch on the kind of a word would be mispredicted about every fifth time. The index is masked,
/// so that no write needs a check of bounds.
pub(crate) struct Buffer {
    t: [i64; N],
    x: [u16; N],
    y: [u16; N],
    on: [u8; N],
    n: usize,
}

impl Buffer {
    pub(super) fn new() -> Buffer {
        Buffer { t: [0; N], x: [0; N], y: [0; N], on: [0; N], n: 0 }
    }

    /// Puts an event that stands only if `keep`.
    #[inline(always)]
    pub(super) fn put(&mut self, keep: bool, t: i64, x: u16, y: u16, on: u8) {
        let at = self.n % N;
        self.t[at] = t;
        self.x[at] = x;
        self.y[at] = y;
        self.on[at] = on;
        self.n += usize::from(keep);
    }

    /// How many events it holds.
    pub(super) fn len(&self) -> usize {
        self.n
    }

    /// Makes room for [`BURST`] events.
    #[inline]
    pub(super) fn pass(&mut self, out: &mut EventChunk) {
        if self.n > N - BURST {
            self.flush(out);
        }
    }

    /// Gives all events to `out`.
    pub(super) fn flush(&mut self, out: &mut EventChunk) {
        let n = self.n.min(N);
        out.t.extend_from_slice(&self.t[..n]);
        out.x.extend_from_slice(&self.x[..n]);
        out.y.extend_from_slice(&self.y[..n]);
        out.on.extend_from_slice(&self.on[..n]);
        self.n = 0;
    }
}
