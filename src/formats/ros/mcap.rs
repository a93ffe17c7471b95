//! MCAP files: finds the chunks and the topics of a file.
//!
//! An MCAP file is eight magic bytes, then records: an opcode, a u64 length, content; then the magic bytes
//! again. Messages stand in chunks, which may be compressed, or as they are between them. A summary before
//! the end names channels and chunks; where it is missing, records are gone over one by one. Source: the MCAP
//! specification, version 0 of the format.
//!
//! Limits: checksums are not compared; attachments and metadata are not read.

use super::contents::{Contents, Piece, Survey};
use super::messages::Serial;
use super::piece::{Container, Record, Source, Topic};
use super::wire::label;
use crate::error::{Cause, FormatError};
use crate::losses::Losses;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// The first and the last bytes.
pub(crate) const MAGIC: &[u8] = b"\x89MCAP0\r\n";
const HEADER: u8 = 1;
const FOOTER: u8 = 2;
/// Record of a type of messages.
pub(crate) const SCHEMA: u8 = 3;
/// Record of a channel.
pub(crate) const CHANNEL: u8 = 4;
/// Record of a message.
pub(crate) const MESSAGE: u8 = 5;
const CHUNK: u8 = 6;
const CHUNK_INDEX: u8 = 8;
const STATISTICS: u8 = 11;
const DATA_END: u8 = 15;

/// Bytes of a message's content before its own bytes: channel, sequence, two times.
pub(crate) const MESSAGE_HEAD: usize = 22;
/// Opcode, length, content of the footer, magic bytes.
const TAIL: u64 = 9 + 20 + 8;
/// Names and indices in a summary are not longer.
const MOST_SUMMARY_RECORD: u64 = 16 << 20;
/// A run of records outside of chunks is cut into pieces of about this many bytes.
const RUN: u64 = 4 << 20;

/// Reads fields of a record's content.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn bytes(&mut self, length: usize) -> Option<&'a [u8]> {
        let (head, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(head)
    }

    fn u16(&mut self) -> Option<u16> {
        Some(u16::from_le_bytes(self.bytes(2)?.try_into().ok()?))
    }

    fn u32(&mut self) -> Option<u32> {
        Some(u32::from_le_bytes(self.bytes(4)?.try_into().ok()?))
    }

    fn u64(&mut self) -> Option<u64> {
        Some(u64::from_le_bytes(self.bytes(8)?.try_into().ok()?))
    }

    fn string(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()?;
        self.bytes(length as usize)
    }
}

/// A time in ns; MCAP has u64.
fn time(ns: u64) -> i64 {
    i64::try_from(ns).unwrap_or(i64::MAX)
}

/// Channel and time of receipt of a message.
pub(crate) fn message_head(head: &[u8; MESSAGE_HEAD]) -> (u32, i64) {
    let [a, b, _, _, _, _, t @ .., _, _, _, _, _, _, _, _] = *head;
    (u32::from(u16::from_le_bytes([a, b])), time(u64::from_le_bytes(t)))
}

/// A type of messages.
pub(crate) fn schema(content: &[u8]) -> Option<Record> {
    let mut fields = Fields(content);
    let id = fields.u16()?;
    Some(Record::Schema(id, label(fields.string()?)))
}

/// A channel; its type is filled in when its schema is known.
pub(crate) fn channel(content: &[u8]) -> Option<Topic> {
    let mut fields = Fields(content);
    let id = u32::from(fields.u16()?);
    let schema = fields.u16()?;
    let name = label(fields.string()?);
    let serial = match fields.string()? {
        b"ros1" => Serial::Ros1,
        b"cdr" => Serial::Cdr,
        _ => Serial::Other,
    };
    Some(Topic { id, name, type_name: String::new(), schema, serial, messages: None })
}

/// Gives every channel the name of its schema.
pub(crate) fn name_types(topics: &mut [Topic], schemas: &BTreeMap<u16, String>) {
    for topic in topics {
        if let Some(name) = schemas.get(&topic.schema) {
            topic.type_name.clone_from(name);
        }
    }
}

/// Opcode and length of the record at a place; `None` when the file ends before.
fn outer(file: &mut File, size: u64, at: u64) -> std::io::Result<Option<(u8, u64)>> {
    if size.saturating_sub(at) < 9 {
        return Ok(None);
    }
    file.seek(SeekFrom::Start(at))?;
    let mut head = [0; 9];
    file.read_exact(&mut head)?;
    let [op, length @ ..] = head;
    Ok(Some((op, u64::from_le_bytes(length))))
}

/// Opens a chunk, or a run of records.
///
/// # Errors
/// `Ok(Err)` says why there is nothing to read there.
pub(crate) fn open_piece(
    mut file: File,
    size: u64,
    piece: &Piece,
) -> std::io::Result<Result<Source, String>> {
    if let Some(length) = piece.length {
        file.seek(SeekFrom::Start(piece.at))?;
        return Ok(Ok(Source::plain(file, length.min(size - piece.at))));
    }
    let Some((CHUNK, length)) = outer(&mut file, size, piece.at)? else {
        return Ok(Err("no chunk begins where the index says".into()));
    };
    // Times of the first and the last message, size, checksum; then the name of the compression and the
    // length of the records.
    let mut head = [0; 32];
    let available = size - piece.at - 9;
    if length.min(available) < 40 {
        return Ok(Err("the chunk is cut off".into()));
    }
    file.read_exact(&mut head)?;
    let number = |at: usize| u64::from_le_bytes([0, 1, 2, 3, 4, 5, 6, 7].map(|k| head[at + k]));
    let claimed = number(16);
    let name_length = number(24) >> 32;
    if name_length > 64 || length.min(available) < 40 + name_length {
        return Ok(Err("the head of the chunk is damaged".into()));
    }
    let mut compression = vec![0; name_length as usize];
    file.read_exact(&mut compression)?;
    let mut records = [0; 8];
    file.read_exact(&mut records)?;
    let held = length.min(available) - 40 - name_length;
    Ok(Source::packed(file, u64::from_le_bytes(records).min(held), &compression, claimed))
}

/// Reads the summary at the end, or goes over the records where there is none.
///
/// # Errors
/// When the file cannot be read, or is no MCAP.
pub(crate) fn open(path: &Path, survey: Survey) -> Result<Contents, FormatError> {
    let io = |error: std::io::Error| FormatError::io(path, &error);
    let mut file = File::open(path).map_err(io)?;
    let size = file.metadata().map_err(io)?.len();
    let mut magic = Vec::new();
    (&mut file).take(MAGIC.len() as u64).read_to_end(&mut magic).map_err(io)?;
    if magic != MAGIC {
        return Err(FormatError::new(
            path,
            "this is no MCAP file: its first bytes are others",
            "check the path",
        ));
    }
    let mut contents = Contents::new(path, size, Container::Mcap);
    let mut losses = Losses::default();
    let start = MAGIC.len() as u64;
    contents.facts.push(("container".into(), "MCAP".into()));
    if let Some((HEADER, length)) = outer(&mut file, size, start).map_err(io)? {
        let mut content = Vec::new();
        (&mut file).take(length.min(1 << 16)).read_to_end(&mut content).map_err(io)?;
        let mut fields = Fields(&content);
        for name in ["profile", "library"] {
            if let Some(text) = fields.string().filter(|text| !text.is_empty()) {
                contents.facts.push((name.into(), label(text)));
            }
        }
    }
    let summary = read_summary(&mut file, size, &mut contents).map_err(io)?;
    if summary != Summary::Whole {
        contents.topics.clear();
        contents.pieces = find_pieces(&mut file, size, start, &mut losses).map_err(io)?;
        if summary == Summary::Missing {
            let what = "the file has no end record: its recorder was stopped, or it is cut off; its records \
                        were read one by one"
                .into();
            losses.add("summaries that are missing or damaged", || format!("byte {size}"), || what);
        }
        contents.losses = losses;
        contents = survey(contents)?;
    }
    Ok(contents)
}

/// What the end of a file has.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Summary {
    /// Channels and chunks.
    Whole,
    /// An end, without all that is needed: allowed.
    Short,
    /// No end.
    Missing,
}

/// Reads channels and chunks from the summary.
fn read_summary(file: &mut File, size: u64, contents: &mut Contents) -> std::io::Result<Summary> {
    let Some(tail) = size.checked_sub(TAIL) else { return Ok(Summary::Missing) };
    let Some((FOOTER, 20)) = outer(file, size, tail)? else { return Ok(Summary::Missing) };
    let mut end = [0; 28];
    file.read_exact(&mut end)?;
    if &end[20..] != MAGIC {
        return Ok(Summary::Missing);
    }
    let [a, b, c, d, e, f, g, h, ..] = end;
    let mut at = u64::from_le_bytes([a, b, c, d, e, f, g, h]);
    if at == 0 {
        return Ok(Summary::Short);
    }
    let mut schemas = BTreeMap::new();
    let mut counts = BTreeMap::new();
    let mut total = None;
    let mut content = Vec::new();
    while at < tail {
        let Some((op, length)) = outer(file, size, at)? else { return Ok(Summary::Missing) };
        if length > tail - at || length > MOST_SUMMARY_RECORD {
            return Ok(Summary::Missing);
        }
        content.clear();
        file.take(length).read_to_end(&mut content)?;
        let sound = match op {
            SCHEMA => schema(&content).map(|record| {
                if let Record::Schema(id, name) = record {
                    schemas.insert(id, name);
                }
            }),
            CHANNEL => channel(&content).map(|topic| contents.topics.push(topic)),
            CHUNK_INDEX => chunk_index(&content, size).map(|(piece, compression)| {
                if contents.pieces.is_empty() {
                    let name = if compression.is_empty() { "none".into() } else { label(&compression) };
                    contents.facts.push(("compression".into(), name));
                }
                contents.pieces.push(piece);
            }),
            STATISTICS => statistics(&content).map(|(messages, of_channels)| {
                total = Some(messages);
                counts = of_channels;
            }),
            0 => None,
            _ => Some(()),
        };
        if sound.is_none() {
            return Ok(Summary::Missing);
        }
        at += 9 + length;
    }
    name_types(&mut contents.topics, &schemas);
    for topic in &mut contents.topics {
        topic.messages = total.map(|_| counts.get(&topic.id).copied().unwrap_or(0));
    }
    contents.pieces.sort_by_key(|piece| piece.at);
    // Messages may stand outside of chunks, where no index points to them; and channels need not be repeated.
    let nothing = total == Some(0);
    Ok(if nothing || !contents.topics.is_empty() && !contents.pieces.is_empty() {
        Summary::Whole
    } else {
        Summary::Short
    })
}

/// A chunk, from its entry in the summary, and the name of its compression.
fn chunk_index(content: &[u8], size: u64) -> Option<(Piece, Vec<u8>)> {
    let mut fields = Fields(content);
    let received = (time(fields.u64()?), time(fields.u64()?));
    let at = fields.u64().filter(|&at| at < size)?;
    fields.u64()?;
    fields.string()?;
    fields.u64()?;
    let compression = fields.string()?.to_vec();
    Some((Piece { file: 0, at, length: None, rows: None, received, counts: None }, compression))
}

/// How many messages in all, and of every channel.
fn statistics(content: &[u8]) -> Option<(u64, BTreeMap<u32, u64>)> {
    let mut fields = Fields(content);
    let messages = fields.u64()?;
    // Numbers of schemas (u16), channels, attachments, metadata, chunks (u32), and two times.
    fields.bytes(2 + 4 * 4 + 2 * 8)?;
    let mut pairs = Fields(fields.string()?);
    let mut counts = BTreeMap::new();
    while let (Some(id), Some(count)) = (pairs.u16(), pairs.u64()) {
        counts.insert(u32::from(id), count);
    }
    Some((messages, counts))
}

/// Goes from record to record: notes chunks, and runs of records that stand outside of them.
fn find_pieces(file: &mut File, size: u64, first: u64, losses: &mut Losses) -> std::io::Result<Vec<Piece>> {
    let mut pieces = Vec::new();
    let mut run: Option<u64> = None;
    let mut at = first;
    let whole = |from: u64, to: u64| Piece {
        file: 0,
        at: from,
        length: Some(to - from),
        rows: None,
        received: (0, 0),
        counts: None,
    };
    while let Some((op, length)) = outer(file, size, at)? {
        if matches!(op, DATA_END | FOOTER) {
            break;
        }
        let end = at.saturating_add(9).saturating_add(length);
        if op == 0 || end > size && op != CHUNK {
            let what = if op == 0 {
                "no record begins here; what follows is lost"
            } else {
                "the record is cut off; it and what follows are lost"
            };
            losses.add_by(
                Cause::Cut,
                "ends that are cut off",
                1,
                || format!("bytes {at} to {size}"),
                || what.into(),
            );
            break;
        }
        match op {
            CHUNK => {
                pieces.extend(run.take().map(|from| whole(from, at)));
                pieces.push(Piece { file: 0, at, length: None, rows: None, received: (0, 0), counts: None });
            }
            SCHEMA | CHANNEL | MESSAGE => {
                let from = *run.get_or_insert(at);
                if end - from >= RUN {
                    pieces.push(whole(from, end));
                    run = None;
                }
            }
            _ => pieces.extend(run.take().map(|from| whole(from, at))),
        }
        at = end.min(size);
    }
    pieces.extend(run.map(|from| whole(from, at)));
    if at < size && outer(file, size, at)?.is_none() {
        losses.add_by(
            Cause::Cut,
            "ends that are cut off",
            1,
            || format!("bytes {at} to {size}"),
            || "the file ends within a record".into(),
        );
    }
    Ok(pieces)
}
