//! The packets of an AEDAT 3.1 file: a header of 28 bytes each, then events of one kind and one size.
//!
//! Header, little-endian: kind (i16), source (i16), bytes of an event, place of its stamp, overflow of the
//! clock, capacity, events, valid events (i32 each). The content has as many bytes as the capacity times the
//! bytes of an event. A header is taken for one only when its fields fit together; where a header or a length
//! is damaged, the next header that fits is searched for, and what stands between is lost.

use crate::error::FormatError;
use crate::losses::Losses;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Bytes of a header.
pub(super) const HEAD: u64 = 28;
/// Events of signals: resets of the clock, edges on inputs.
pub(super) const SPECIAL: u16 = 0;
/// Events of pixels.
pub(super) const POLARITY: u16 = 1;
/// Frames.
pub(super) const FRAME: u16 = 2;
/// Bytes of a frame before its values.
pub(super) const FRAME_HEAD: u64 = 36;
/// Kinds that the format defines end below this.
const KINDS: u16 = 32;
/// No event of any kind is longer: a frame of 4096 x 4096 pixels with four channels.
const MOST_EVENT: u32 = 128 << 20;
/// The clock overflows every 36 minutes; so often it does in 70 years.
const MOST_OVERFLOWS: u32 = 1 << 20;
/// What is read from the file at a time.
const BUFFER: usize = 1 << 16;

/// One packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Packet {
    /// Where its header begins.
    pub at: u64,
    /// What its events are.
    pub kind: u16,
    /// Which source they come from.
    pub source: u16,
    /// Bytes of an event.
    pub size: u32,
    /// How often the clock of 31 bits had overflowed.
    pub overflow: u32,
    /// Events that are there, valid or not.
    pub number: u32,
    /// Events that are marked as valid.
    pub valid: u32,
    /// Bytes of the content.
    length: u64,
}

impl Packet {
    /// The header at a place, when its fields fit together.
    fn parse(head: &[u8; HEAD as usize], at: u64) -> Option<Packet> {
        let short = |k: usize| u16::from_le_bytes([head[k], head[k + 1]]);
        let long = |k: usize| u32::from_le_bytes([head[k], head[k + 1], head[k + 2], head[k + 3]]);
        let (kind, source, size, place, overflow) = (short(0), short(2), long(4), long(8), long(12));
        let (capacity, number, valid) = (long(16), long(20), long(24));
        let sized = match kind {
            SPECIAL | POLARITY => size == 8 && place == 4,
            FRAME => u64::from(size) >= FRAME_HEAD,
            _ => size >= 4,
        };
        let sound = kind < KINDS
            && source < 1 << 15
            && sized
            && size <= MOST_EVENT
            && place < size
            && overflow < MOST_OVERFLOWS;
        let counted = valid <= number && number <= capacity && capacity < 1 << 31;
        let length = u64::from(capacity) * u64::from(size);
        (sound && counted).then_some(Packet { at, kind, source, size, overflow, number, valid, length })
    }

    /// Where the content begins.
    pub(super) fn content(&self) -> u64 {
        self.at + HEAD
    }

    fn end(&self) -> u64 {
        self.content() + self.length
    }

    /// A stamp of this packet in ns: the clock's 31 bits, continued by the overflow; `None` for one that is
    /// negative.
    pub(super) fn time_ns(&self, stamp: i32) -> Option<i64> {
        let stamp = u32::try_from(stamp).ok()?;
        // 20 bits of overflow and 31 of the stamp: in ns below 2^61.
        Some((i64::from(self.overflow) << 31 | i64::from(stamp)) * 1000)
    }

    /// For messages.
    pub(super) fn place(&self) -> String {
        format!("packet at byte {}", self.at)
    }
}

/// Walks from packet to packet.
pub(super) struct Packets {
    path: PathBuf,
    file: BufReader<File>,
    /// Where the first header stands.
    first: u64,
    size: u64,
    /// Where the next header should stand.
    at: u64,
    /// What was damaged.
    pub losses: Losses,
}

impl Packets {
    /// Before the first packet, which stands at `first`.
    ///
    /// # Errors
    /// When the file cannot be opened.
    pub(super) fn open(path: &Path, first: u64) -> Result<Packets, FormatError> {
        let io = |error: std::io::Error| FormatError::io(path, &error);
        let file = File::open(path).map_err(io)?;
        let size = file.metadata().map_err(io)?.len();
        Ok(Packets {
            path: path.into(),
            file: BufReader::with_capacity(BUFFER, file),
            first,
            size,
            at: first,
            losses: Losses::default(),
        })
    }

    /// Goes back to the first packet.
    pub(super) fn rewind(&mut self) {
        self.at = self.first;
    }

    /// Where the walk stands, of how many bytes.
    pub(super) fn position(&self) -> (u64, u64) {
        (self.at.min(self.size), self.size)
    }

    /// The next packet; `None` at the end. Its content must be read before the next call or not at all.
    ///
    /// # Errors
    /// When the file cannot be read any more.
    pub(super) fn next(&mut self) -> Result<Option<Packet>, FormatError> {
        if self.at >= self.size {
            return Ok(None);
        }
        let start = self.at;
        let mut packet = match self.header(start)? {
            Some(packet) => packet,
            None => {
                let found = self.search(start + 1)?;
                let end = found.map_or(self.size, |packet| packet.at);
                let what = "these bytes are no packet; what they held is lost";
                self.losses.add(
                    "stretches of bytes that are no packet",
                    || format!("bytes {start} to {end}"),
                    || what.into(),
                );
                match found {
                    Some(packet) => packet,
                    None => {
                        self.at = self.size;
                        return Ok(None);
                    }
                }
            }
        };
        let claimed = packet.end();
        let follows = claimed == self.size || claimed < self.size && self.header(claimed)?.is_some();
        if !follows {
            // Either this length is wrong, or the header behind it; or the file ends here.
            let next = self.search(packet.content())?.map(|packet| packet.at);
            let end = match next {
                Some(next) if next < claimed => next,
                _ => claimed.min(self.size),
            };
            if end < claimed {
                packet.length = end - packet.content();
                let held = packet.length / u64::from(packet.size);
                let (number, at) = (packet.number, packet.place());
                let what = match held < u64::from(number) {
                    true => format!("it claims {number} events and holds {held}; those are read"),
                    false => "its header claims more bytes than it has; its events are read".into(),
                };
                self.losses.add("packets that are cut off", || at, || what);
                packet.number = packet.number.min(u32::try_from(held).unwrap_or(u32::MAX));
            }
        }
        self.at = packet.end();
        Ok(Some(packet))
    }

    /// Replaces `bytes` by `count` events of a packet, from the event numbered `from` on; by fewer where the
    /// file has become shorter.
    ///
    /// # Errors
    /// When the file cannot be read any more.
    pub(super) fn read(
        &mut self,
        packet: &Packet,
        from: u32,
        count: u32,
        bytes: &mut Vec<u8>,
    ) -> Result<(), FormatError> {
        let size = u64::from(packet.size);
        let count = count.min(packet.number.saturating_sub(from));
        self.fetch(packet.content() + u64::from(from) * size, u64::from(count) * size, bytes)
    }

    /// Replaces `bytes` by up to `length` bytes from a place of the file.
    ///
    /// # Errors
    /// When the file cannot be read any more.
    pub(super) fn fetch(&mut self, at: u64, length: u64, bytes: &mut Vec<u8>) -> Result<(), FormatError> {
        bytes.clear();
        self.go_to(at)?;
        (&mut self.file)
            .take(length)
            .read_to_end(bytes)
            .map_err(|error| FormatError::io(&self.path, &error))?;
        Ok(())
    }

    /// Goes to a place; what the buffer holds is kept.
    fn go_to(&mut self, at: u64) -> Result<(), FormatError> {
        let io = |error: std::io::Error| FormatError::io(&self.path, &error);
        let here = self.file.stream_position().map_err(io)?;
        match i64::try_from(at).ok().zip(i64::try_from(here).ok()) {
            Some((at, here)) => self.file.seek_relative(at - here).map_err(io),
            None => self.file.seek(SeekFrom::Start(at)).map(|_| ()).map_err(io),
        }
    }

    /// The header at a place; `None` when none stands there.
    fn header(&mut self, at: u64) -> Result<Option<Packet>, FormatError> {
        if self.size.saturating_sub(at) < HEAD {
            return Ok(None);
        }
        self.go_to(at)?;
        let mut head = [0; HEAD as usize];
        match self.file.read_exact(&mut head) {
            Ok(()) => Ok(Packet::parse(&head, at)),
            Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => Ok(None),
            Err(error) => Err(FormatError::io(&self.path, &error)),
        }
    }

    /// The next header from a place on. It must have events of a kind that is read, or of the inertial
    /// sensor, and a plausible follower.
    fn search(&mut self, from: u64) -> Result<Option<Packet>, FormatError> {
        const STRIDE: usize = BUFFER - HEAD as usize;
        let mut window = Vec::new();
        let mut start = from;
        while start < self.size {
            self.fetch(start, BUFFER as u64, &mut window)?;
            let heads = window.windows(HEAD as usize).enumerate();
            let fits = heads.filter_map(|(k, head)| {
                Packet::parse(head.try_into().ok()?, start + k as u64).filter(Packet::is_distinct)
            });
            // Each is held against what follows it: of more in one window nothing sensible comes.
            let candidates: Vec<Packet> = fits.take(64).collect();
            for candidate in candidates {
                let end = candidate.end();
                if end == self.size
                    || end < self.size && self.header(end)?.is_some()
                    || end > self.size && candidate.number > 0
                {
                    return Ok(Some(candidate));
                }
            }
            if window.len() < BUFFER {
                break;
            }
            start += STRIDE as u64;
        }
        Ok(None)
    }
}

impl Packet {
    /// Could its header hardly be anything else? Empty packets and kinds that are not read could be zeros, or
    /// any small numbers.
    fn is_distinct(&self) -> bool {
        self.kind <= FRAME && self.number > 0 && self.source < 1 << 8
    }
}
