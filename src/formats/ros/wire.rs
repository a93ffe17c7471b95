//! Reads the numbers of a ROS message, one field after another, in either of its two serialisations.
//!
//! ROS 1 puts fields side by side, little-endian, a string or sequence after its u32 length. ROS 2 uses CDR
//! (OMG, "Common Data Representation"): four bytes that state the byte order, then the same fields, each
//! aligned to its own size counted from there, and strings that end in a zero byte. Every read answers `None`
//! at the end of the bytes: nothing is allocated, nothing panics.

/// How a message is serialised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Layout {
    /// ROS 1: packed, little-endian.
    Ros1,
    /// CDR, as ROS 2 writes it.
    Cdr {
        /// Big-endian numbers?
        big: bool,
        /// Alignment of 8-byte numbers: 8 in the first version of CDR, 4 in the second.
        widest: usize,
    },
}

/// Bytes of the note that stands before CDR fields.
const CDR_NOTE: usize = 4;

/// A place in a message.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wire<'a> {
    bytes: &'a [u8],
    at: usize,
    layout: Layout,
}

impl<'a> Wire<'a> {
    /// The first field of a ROS 1 message.
    pub(crate) fn ros1(bytes: &'a [u8]) -> Wire<'a> {
        Wire { bytes, at: 0, layout: Layout::Ros1 }
    }

    /// The first field of a CDR message; `None` when its four bytes name another representation.
    pub(crate) fn cdr(bytes: &'a [u8]) -> Option<Wire<'a>> {
        // The second byte: 0 and 1 are CDR, 6 and 7 plain CDR of the second version; odd is little-endian.
        // Others hold parameter lists.
        let (big, widest) = match bytes.get(..2)? {
            [0, 0] => (true, 8),
            [0, 1] => (false, 8),
            [0, 6] => (true, 4),
            [0, 7] => (false, 4),
            _ => return None,
        };
        (bytes.len() >= CDR_NOTE).then_some(Wire { bytes, at: CDR_NOTE, layout: Layout::Cdr { big, widest } })
    }

    /// Goes on in a message at a place that [`Wire::at`] gave.
    pub(crate) fn resume(bytes: &'a [u8], at: usize, layout: Layout) -> Wire<'a> {
        Wire { bytes, at, layout }
    }

    /// The place of the next field, in bytes from the start of the message.
    pub(crate) fn at(&self) -> usize {
        self.at
    }

    /// How the message is serialised.
    pub(crate) fn layout(&self) -> Layout {
        self.layout
    }

    fn align(&mut self, size: usize) {
        if let Layout::Cdr { widest, .. } = self.layout {
            let size = size.min(widest);
            self.at = CDR_NOTE + (self.at - CDR_NOTE).next_multiple_of(size);
        }
    }

    /// The next `N` bytes as they stand, after alignment, in little-endian order.
    #[inline]
    fn number<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.align(N);
        let mut number: [u8; N] = self.bytes.get(self.at..self.at.checked_add(N)?)?.try_into().ok()?;
        self.at += N;
        if matches!(self.layout, Layout::Cdr { big: true, .. }) {
            number.reverse();
        }
        Some(number)
    }

    /// The next field, a byte.
    #[inline]
    pub(crate) fn u8(&mut self) -> Option<u8> {
        self.number::<1>().map(|[byte]| byte)
    }

    /// The next field.
    #[inline]
    pub(crate) fn u16(&mut self) -> Option<u16> {
        self.number().map(u16::from_le_bytes)
    }

    /// The next field.
    #[inline]
    pub(crate) fn u32(&mut self) -> Option<u32> {
        self.number().map(u32::from_le_bytes)
    }

    /// The next field.
    #[inline]
    pub(crate) fn u64(&mut self) -> Option<u64> {
        self.number().map(u64::from_le_bytes)
    }

    /// The next field, a time of seconds and nanoseconds, in ns. Nanoseconds of a whole second or more are
    /// kept: see [`Stamp::is_sound`].
    #[inline]
    pub(crate) fn stamp(&mut self) -> Option<Stamp> {
        let seconds = self.u32()?;
        let nanoseconds = self.u32()?;
        let seconds = match self.layout {
            Layout::Ros1 => i64::from(seconds),
            Layout::Cdr { .. } => i64::from(seconds as i32),
        };
        Some(Stamp { ns: seconds * 1_000_000_000 + i64::from(nanoseconds), nanoseconds })
    }

    /// The next field, a string without its final zero byte, or a sequence of bytes: which of both is the
    /// caller's to say.
    pub(crate) fn string(&mut self) -> Option<&'a [u8]> {
        let bytes = self.sequence()?;
        Some(match self.layout {
            Layout::Ros1 => bytes,
            Layout::Cdr { .. } => bytes.strip_suffix(&[0]).unwrap_or(bytes),
        })
    }

    /// The next field, a sequence of bytes.
    pub(crate) fn sequence(&mut self) -> Option<&'a [u8]> {
        let length = usize::try_from(self.u32()?).ok()?;
        let bytes = self.bytes.get(self.at..self.at.checked_add(length)?)?;
        self.at += length;
        Some(bytes)
    }
}

/// A time of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stamp {
    /// Nanoseconds in all.
    pub ns: i64,
    nanoseconds: u32,
}

impl Stamp {
    /// Are its nanoseconds less than a second? Where they are not, the bytes are damaged or are no such time.
    pub(crate) fn is_sound(&self) -> bool {
        self.nanoseconds < 1_000_000_000
    }
}
/// Text of a file for a message: no control characters, not longer than a line.
pub(crate) fn label(bytes: &[u8]) -> String {
    const MOST: usize = 120;
    let clean = |c: char| if c.is_control() { '?' } else { c };
    // No character has more than four bytes: this many hold what is shown.
    let start = bytes.get(..4 * MOST).unwrap_or(bytes);
    let mut text: String = String::from_utf8_lossy(start).chars().map(clean).take(MOST).collect();
    if bytes.len() > text.len() {
        text.push_str("...");
    }
    text
}
