//! Walks the chain of packets: each has eight bytes of stream number and length, then its content.
//!
//! The walk does not trust the lengths: a packet has to name a known stream, end within the file and begin as
//! its compression does. Where that fails, the next such place is looked for, byte by byte, and what lies
//! between is a loss. A packet that was skipped unread may have had a wrong length; then the search begins
//! inside of it, so that one damaged length costs one packet.

use super::decompress::{MOST_BYTES, Plain};
use super::header::Header;
use crate::error::FormatError;
use crate::losses::Losses;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Bytes of a packet's head, and of the beginning of its content that is looked at.
const HEAD: u64 = 12;

/// A packet's head.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Packet {
    /// Where its head stands.
    pub at: u64,
    /// Its stream.
    pub stream: u32,
    /// Bytes of its content.
    pub length: u64,
}

impl Packet {
    /// Where the next packet stands.
    pub(super) fn end(&self) -> u64 {
        self.at + 8 + self.length
    }

    /// For messages.
    pub(super) fn place(&self) -> String {
        format!("bytes {} to {}", self.at, self.end())
    }
}

/// A walk.
pub(super) struct Chain {
    path: PathBuf,
    file: BufReader<File>,
    /// Where the file is read next.
    position: u64,
    header: Arc<Header>,
    /// Where the packets end.
    end: u64,
    /// Where the next packet should stand.
    at: u64,
    /// A packet whose length has not been proven by its content.
    unproven: Option<u64>,
    /// Bytes of content that proved to be damaged: a file that is nothing else must not be read again and
    /// again.
    wasted: u64,
    /// The content as it stands in the file; longer than what is in use.
    raw: Vec<u8>,
    plain: Plain,
}

impl Chain {
    /// A walk from the first packet to `end`.
    ///
    /// # Errors
    /// When the file has gone.
    pub(super) fn new(
        path: &Path,
        header: &Arc<Header>,
        end: u64,
        buffer: usize,
    ) -> Result<Chain, FormatError> {
        let file = File::open(path).map_err(|error| FormatError::io(path, &error))?;
        let (raw, plain) = (Vec::new(), Plain::default());
        let file = BufReader::with_capacity(buffer, file);
        Ok(Chain {
            path: path.into(),
            file,
            position: 0,
            header: header.clone(),
            end,
            at: header.first,
            unproven: None,
            wasted: 0,
            raw,
            plain,
        })
    }

    /// Where the walk stands, and where it ends.
    pub(super) fn position(&self) -> (u64, u64) {
        (self.at.min(self.end), self.end)
    }

    /// Goes on at a packet.
    pub(super) fn go_to(&mut self, at: u64) {
        self.at = at;
        self.unproven = None;
    }

    fn io(&self, error: &std::io::Error) -> FormatError {
        FormatError::io(&self.path, error)
    }

    fn seek(&mut self, at: u64) -> Result<(), FormatError> {
        if self.position != at {
            // Within the buffer this costs nothing; the distance fits, because both are places in a file.
            let moved = at as i64 - self.position as i64;
            self.file.seek_relative(moved).map_err(|error| self.io(&error))?;
            self.position = at;
        }
        Ok(())
    }

    fn read(&mut self, bytes: &mut [u8]) -> Result<(), FormatError> {
        self.file.read_exact(bytes).map_err(|error| self.io(&error))?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    /// The packet whose head these twelve bytes are, when it is one.
    fn packet(&self, at: u64, head: [u8; HEAD as usize]) -> Option<Packet> {
        let [a, b, c, d, e, f, g, h, start @ ..] = head;
        let (stream, length) =
            (u32::from_le_bytes([a, b, c, d]), u64::from(u32::from_le_bytes([e, f, g, h])));
        let fits = length >= 4 && at + 8 + length <= self.end && length <= MOST_BYTES as u64;
        let known = || self.header.streams.iter().any(|known| known.id == stream);
        (fits && known() && self.header.compression.begins(start, length)).then_some(Packet {
            at,
            stream,
            length,
        })
    }

    /// The next packet's head; `None` at the end.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub(super) fn next(&mut self, losses: &mut Losses) -> Result<Option<Packet>, FormatError> {
        if self.at >= self.end {
            return Ok(None);
        }
        let mut found = None;
        if self.at + HEAD <= self.end {
            let mut head = [0; HEAD as usize];
            self.seek(self.at)?;
            self.read(&mut head)?;
            found = self.packet(self.at, head);
        }
        if found.is_none() {
            let from = self.unproven.unwrap_or(self.at);
            found =
                if self.wasted > 2 * self.header.size + (1 << 24) { None } else { self.search(from + 1)? };
            match found {
                Some(packet) => {
                    let what = || "the chain of packets is damaged here; what was in it is lost".into();
                    losses.add("pieces that are damaged", || format!("bytes {from} to {}", packet.at), what);
                }
                None => {
                    let what = || "the last packet is cut off or damaged; what was in it is lost".into();
                    losses.add(
                        "pieces that are damaged",
                        || format!("bytes {} to {}", self.at, self.end),
                        what,
                    );
                    self.at = self.end;
                    return Ok(None);
                }
            }
        }
        if let Some(packet) = found {
            self.at = packet.end();
            self.unproven = Some(packet.at);
        }
        Ok(found)
    }

    /// The first place from `from` on that looks like a packet.
    fn search(&mut self, from: u64) -> Result<Option<Packet>, FormatError> {
        let mut at = from;
        let mut bytes = vec![0; 1 << 16];
        while at + HEAD <= self.end {
            let count = (self.end - at).min(bytes.len() as u64) as usize;
            self.seek(at)?;
            self.read(&mut bytes[..count])?;
            for (k, window) in bytes[..count].windows(HEAD as usize).enumerate() {
                let head = std::array::from_fn(|i| window[i]);
                if let Some(packet) = self.packet(at + k as u64, head) {
                    return Ok(Some(packet));
                }
            }
            at += (count as u64).saturating_sub(HEAD - 1).max(1);
        }
        Ok(None)
    }

    /// Reads and decompresses a packet, at least its first `wanted` bytes; [`Chain::content`] has it then.
    /// False when it is damaged, and that is noted.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub(super) fn load(
        &mut self,
        packet: &Packet,
        wanted: usize,
        losses: &mut Losses,
    ) -> Result<bool, FormatError> {
        self.seek(packet.at + 8)?;
        let length = packet.length as usize;
        // No longer than the rest of the file: the head was held against it.
        if self.raw.len() < length {
            self.raw.resize(length, 0);
        }
        let mut raw = std::mem::take(&mut self.raw);
        let read = self.read(&mut raw[..length]);
        let filled = self.plain.fill(self.header.compression, &raw[..length], wanted);
        self.raw = raw;
        read?;
        match filled {
            Ok(()) => Ok(true),
            Err(why) => {
                self.spoiled(packet, &why, losses);
                Ok(false)
            }
        }
    }

    /// Notes that a packet is damaged.
    pub(super) fn spoiled(&mut self, packet: &Packet, why: &str, losses: &mut Losses) {
        self.wasted += packet.length;
        self.unproven = Some(packet.at);
        losses.add(
            "packets that are damaged",
            || packet.place(),
            || format!("the packet is damaged and left out: {why}"),
        );
    }

    /// Notes that a packet is whole: its length is what it says.
    pub(super) fn proven(&mut self) {
        self.unproven = None;
    }

    /// What [`Chain::load`] read.
    pub(super) fn content(&self) -> &[u8] {
        self.plain.bytes()
    }
}

/// Reads bytes anywhere in a file.
///
/// # Errors
/// When they are not there.
pub(super) fn read_at(path: &Path, at: u64, length: u64) -> Result<Vec<u8>, FormatError> {
    let io = |error: std::io::Error| FormatError::io(path, &error);
    let mut file = File::open(path).map_err(io)?;
    file.seek(SeekFrom::Start(at)).map_err(io)?;
    let mut bytes = Vec::new();
    file.take(length).read_to_end(&mut bytes).map_err(io)?;
    Ok(bytes)
}
