//! Where packets stand: from the data table behind the last packet, or, where that is missing or wrong, from
//! a walk over the heads.
//!
//! The data table (`FTAB`) has a row for every packet: where its content stands, stream and length, how many
//! elements it has, and its first and last stamp. It is taken only when its rows follow each other without a
//! gap from the first packet to the table itself. Of event packets only every so many bytes one is kept, so
//! that the index of a long recording stays small.

use super::chain::{Chain, Packet, read_at};
use super::decompress::{MOST_BYTES, Plain};
use super::flat::Table;
use super::header::Header;
use crate::error::{Cause, FormatError};
use crate::losses::Losses;
use std::path::Path;
use std::sync::Arc;

/// At least so many bytes of the file lie between two marks.
const MARK_BYTES: u64 = 1 << 18;

/// More trigger packets than these are not listed; they are then looked for by a walk.
const MOST_TRIGGERS: usize = 1 << 20;

/// A place to begin to read events.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Mark {
    /// Where a packet of events stands.
    pub at: u64,
    /// The latest stamp of this packet and of those up to the next mark, us.
    pub latest_us: i64,
}

/// What is known of the packets.
#[derive(Clone, Debug, Default)]
pub(super) struct Index {
    /// Where the packets end.
    pub end: u64,
    /// Places to begin to read events; without times when the file has no data table.
    pub marks: Option<Vec<Mark>>,
    /// How many events there are, when the file says so.
    pub events: Option<u64>,
    /// Every packet of the frame stream.
    pub frames: Vec<Packet>,
    /// Every packet of triggers; `None` when there are too many to list.
    pub triggers: Option<Vec<Packet>>,
    /// How many packets, and how many of other streams than those above.
    pub packets: u64,
    /// Does the file have a whole data table?
    pub has_table: bool,
}

/// Which streams are looked for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wanted {
    /// Events.
    pub events: Option<u32>,
    /// Frames.
    pub frames: Option<u32>,
    /// Triggers.
    pub triggers: Option<u32>,
}

impl Index {
    /// Finds all packets.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub(super) fn new(
        path: &Path,
        header: &Arc<Header>,
        wanted: Wanted,
        losses: &mut Losses,
    ) -> Result<Index, FormatError> {
        let mut end = header.size;
        match header.table {
            Some(at) if at >= header.first && at < header.size => match table(path, header, at, wanted) {
                Ok(index) => return Ok(index),
                Err(why) => {
                    losses.add(
                        "data tables that are damaged",
                        || format!("bytes {at} to {}", header.size),
                        || {
                            format!(
                                "the data table is damaged: {why}; the packets were looked for one by one"
                            )
                        },
                    );
                    let start = read_at(path, at, 4)?;
                    // The packets end where something stands that looks like the table.
                    if start.try_into().is_ok_and(|start| header.compression.begins(start, header.size - at))
                    {
                        end = at;
                    }
                }
            },
            Some(at) => {
                let what = || {
                    format!(
                        "the file ends here, and its data table should stand at byte {at}: the end is cut off"
                    )
                };
                losses.add_by(
                    Cause::Cut,
                    "ends that are cut off",
                    1,
                    || format!("byte {}", header.size),
                    what,
                );
            }
            None => {}
        }
        walk(path, header, end, wanted, losses)
    }

    fn add(&mut self, packet: Packet, wanted: Wanted) {
        self.packets += 1;
        if Some(packet.stream) == wanted.frames {
            self.frames.push(packet);
        } else if Some(packet.stream) == wanted.triggers {
            match &mut self.triggers {
                Some(list) if list.len() < MOST_TRIGGERS => list.push(packet),
                _ => self.triggers = None,
            }
        }
    }

    /// Puts a packet of events into the marks.
    fn mark(marks: &mut Vec<Mark>, at: u64, latest_us: i64) {
        match marks.last_mut() {
            Some(last) if at < last.at + MARK_BYTES => last.latest_us = last.latest_us.max(latest_us),
            _ => marks.push(Mark { at, latest_us }),
        }
    }
}

/// The index that the data table gives.
fn table(path: &Path, header: &Header, position: u64, wanted: Wanted) -> Result<Index, String> {
    let length = header.size - position;
    if length > MOST_BYTES as u64 {
        return Err(format!("it has {length} bytes"));
    }
    let bytes = read_at(path, position, length).map_err(|error| error.found)?;
    let mut plain = Plain::default();
    plain.fill(header.compression, &bytes, usize::MAX)?;
    let root = Table::root(plain.bytes(), b"FTAB").ok_or("it is not the table that it should be")?;
    root.vector(0, 4).ok_or("its rows do not fit into it")?;
    let mut index = Index { end: position, has_table: true, triggers: Some(Vec::new()), ..Index::default() };
    let (mut marks, mut events) = (Vec::new(), 0u64);
    let mut at = header.first;
    for row in root.tables(0) {
        let row = row.ok_or("a row is damaged")?;
        let (stream, length) = row.two_i32(1).ok_or("a row is damaged")?;
        // The row names the place of the content, behind the head.
        if row.i64(0) != i64::try_from(at + 8).unwrap_or(i64::MAX) {
            return Err(format!(
                "a row names byte {}, and the packet before it ends at byte {at}",
                row.i64(0)
            ));
        }
        let packet = Packet { at, stream: stream as u32, length: u64::from(length as u32) };
        at = packet.end();
        if at > position {
            return Err("a row names bytes that are none of a packet".into());
        }
        index.add(packet, wanted);
        if Some(packet.stream) == wanted.events {
            events = events.saturating_add(u64::try_from(row.i64(2)).unwrap_or(0));
            Index::mark(&mut marks, packet.at, row.i64(3).max(row.i64(4)));
        }
    }
    if at != position {
        return Err(format!("its rows end at byte {at}"));
    }
    // A number of events that cannot be in so few bytes is only a claim.
    index.events = (events <= header.size.saturating_mul(16)).then_some(events);
    index.marks = Some(marks);
    Ok(index)
}

/// The index that a walk over the heads gives.
fn walk(
    path: &Path,
    header: &Arc<Header>,
    end: u64,
    wanted: Wanted,
    losses: &mut Losses,
) -> Result<Index, FormatError> {
    let mut chain = Chain::new(path, header, end, 1 << 12)?;
    let mut index = Index { end, triggers: Some(Vec::new()), ..Index::default() };
    while let Some(packet) = chain.next(losses)? {
        index.add(packet, wanted);
    }
    Ok(index)
}

/// Bytes of an event.
pub(super) const EVENT: usize = 16;

/// The bytes of a packet's events; `None` when the packet is damaged.
pub(super) fn elements(content: &[u8]) -> Option<&[u8]> {
    Table::root(content, b"EVTS")?.vector(0, EVENT)
}

/// Marks with times for a file without a data table: every packet of events is read once.
///
/// # Errors
/// When the file cannot be read.
pub(super) fn marks_by_reading(
    path: &Path,
    header: &Arc<Header>,
    end: u64,
    stream: u32,
) -> Result<Vec<Mark>, FormatError> {
    let (mut chain, mut losses, mut marks) =
        (Chain::new(path, header, end, 1 << 16)?, Losses::default(), Vec::new());
    while let Some(packet) = chain.next(&mut losses)? {
        if packet.stream != stream || !chain.load(&packet, usize::MAX, &mut losses)? {
            continue;
        }
        if let Some(events) = elements(chain.content()) {
            let stamps = events
                .chunks_exact(16)
                .filter_map(|event| event.first_chunk::<8>())
                .map(|bytes| i64::from_le_bytes(*bytes));
            let latest_us = stamps.max().unwrap_or(i64::MIN);
            chain.proven();
            Index::mark(&mut marks, packet.at, latest_us);
        }
    }
    Ok(marks)
}
