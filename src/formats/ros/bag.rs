//! ROS 1 bags, version 2.0: finds the chunks and the topics of a file.
//!
//! A bag is a line of text and then records: a header of `name=value` fields, and data. Messages stand in
//! chunks, which may be compressed; at the end an index names every connection and where every chunk begins.
//! A recorder that was killed leaves no index: then the chunks are found one after another and are read
//! through once. Source: the bag format 2.0 of the ROS wiki.
//!
//! Limits: encrypted bags and version 1 are refused by name.

use super::contents::{Contents, Piece, Survey};
use super::messages::Serial;
use super::piece::{Container, Source, Topic};
use super::wire::label;
use crate::error::FormatError;
use crate::losses::Losses;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// The first line.
pub(crate) const MAGIC: &[u8] = b"#ROSBAG V2.0\n";
/// Record of a message.
pub(crate) const MESSAGE: u8 = 2;
const BAG_HEADER: u8 = 3;
const INDEX: u8 = 4;
const CHUNK: u8 = 5;
const CHUNK_INFO: u8 = 6;
/// Record of a connection.
pub(crate) const CONNECTION: u8 = 7;

/// More than any header of a record has.
const MOST_HEADER: u64 = 1 << 16;
/// More than any record of the index has: 8 bytes a connection, or the definition of a message.
const MOST_INDEX_RECORD: u64 = 16 << 20;

/// Walks over the fields of a header; ends at the first that is cut off.
fn fields(header: &[u8]) -> impl Iterator<Item = (&[u8], &[u8])> {
    let mut rest = header;
    std::iter::from_fn(move || {
        let (length, after) = rest.split_first_chunk::<4>()?;
        let length = u32::from_le_bytes(*length) as usize;
        let field = after.get(..length)?;
        rest = &after[length..];
        let equals = field.iter().position(|&byte| byte == b'=')?;
        Some((&field[..equals], &field[equals + 1..]))
    })
}

/// The value of a field.
fn field<'a>(header: &'a [u8], name: &str) -> Option<&'a [u8]> {
    fields(header).find(|(key, _)| *key == name.as_bytes()).map(|(_, value)| value)
}

fn field_u32(header: &[u8], name: &str) -> Option<u32> {
    Some(u32::from_le_bytes(field(header, name)?.try_into().ok()?))
}

fn field_u64(header: &[u8], name: &str) -> Option<u64> {
    Some(u64::from_le_bytes(field(header, name)?.try_into().ok()?))
}

/// A time: u32 seconds and u32 nanoseconds.
fn field_time(header: &[u8], name: &str) -> Option<i64> {
    let both = field_u64(header, name)?;
    Some(((both & 0xffff_ffff) as i64) * 1_000_000_000 + (both >> 32) as i64)
}

/// What a record is.
pub(crate) fn op(header: &[u8]) -> Option<u8> {
    field(header, "op")?.first().copied()
}

/// Connection and time of receipt of a message.
pub(crate) fn message_head(header: &[u8]) -> Option<(u32, i64)> {
    Some((field_u32(header, "conn")?, field_time(header, "time")?))
}

/// A connection, from header and data of its record.
pub(crate) fn topic(header: &[u8], data: &[u8]) -> Option<Topic> {
    let name = label(field(header, "topic")?);
    let type_name = label(field(data, "type").unwrap_or_default());
    Some(Topic {
        id: field_u32(header, "conn")?,
        name,
        type_name,
        schema: 0,
        serial: Serial::Ros1,
        messages: None,
    })
}

/// A record outside of a chunk: its header, and where its data stand.
struct Outer {
    header: Vec<u8>,
    data: u64,
    length: u64,
}

/// The record that begins at `at`; `None` when none does: its header is cut off or is no such thing.
fn outer(file: &mut File, size: u64, at: u64) -> std::io::Result<Option<Outer>> {
    if size.saturating_sub(at) < 8 {
        return Ok(None);
    }
    file.seek(SeekFrom::Start(at))?;
    let mut number = [0; 4];
    file.read_exact(&mut number)?;
    let header_length = u64::from(u32::from_le_bytes(number));
    if header_length > MOST_HEADER || at + 8 + header_length > size {
        return Ok(None);
    }
    let mut header = vec![0; header_length as usize];
    file.read_exact(&mut header)?;
    file.read_exact(&mut number)?;
    Ok(op(&header).map(|_| Outer {
        header,
        data: at + 8 + header_length,
        length: u64::from(u32::from_le_bytes(number)),
    }))
}

/// Opens the chunk that begins at a place.
///
/// # Errors
/// `Ok(Err)` says why there is no chunk to read there.
pub(crate) fn open_piece(
    mut file: File,
    size: u64,
    piece: &Piece,
) -> std::io::Result<Result<Source, String>> {
    let Some(record) = outer(&mut file, size, piece.at)? else {
        return Ok(Err("no record begins where the index says".into()));
    };
    if op(&record.header) != Some(CHUNK) {
        return Ok(Err("no chunk begins where the index says".into()));
    }
    let compression = field(&record.header, "compression").unwrap_or_default().to_vec();
    // What the chunk claims beyond the end of the file is not there; the claimed size decompressed bounds the
    // work.
    let length = record.length.min(size - record.data);
    let claimed = field_u32(&record.header, "size").map_or(u64::from(u32::MAX), u64::from);
    file.seek(SeekFrom::Start(record.data))?;
    Ok(Source::packed(file, length, &compression, claimed))
}

/// Reads what stands at the end of a bag, or finds the chunks where nothing does.
///
/// # Errors
/// When the file cannot be read, or is no bag of this version.
pub(crate) fn open(path: &Path, survey: Survey) -> Result<Contents, FormatError> {
    let io = |error: std::io::Error| FormatError::io(path, &error);
    let mut file = File::open(path).map_err(io)?;
    let size = file.metadata().map_err(io)?.len();
    let mut magic = Vec::new();
    (&mut file).take(MAGIC.len() as u64).read_to_end(&mut magic).map_err(io)?;
    if magic != MAGIC {
        let found = format!("the first line is `{}`", label(&magic));
        return Err(FormatError::new(
            path,
            found,
            "bags of version 1 are brought to 2.0 by `rosbag migrate`",
        )
        .expected("`#ROSBAG V2.0`"));
    }
    let start = MAGIC.len() as u64;
    let mut contents = Contents::new(path, size, Container::Bag);
    let mut losses = Losses::default();
    let head =
        outer(&mut file, size, start).map_err(io)?.filter(|record| op(&record.header) == Some(BAG_HEADER));
    if head
        .as_ref()
        .and_then(|record| field(&record.header, "encryptor"))
        .is_some_and(|name| !name.is_empty())
    {
        return Err(FormatError::new(path, "the bag is encrypted", "decrypt it with `rosbag decrypt`"));
    }
    let indexed = match &head {
        Some(record) => read_index(&mut file, size, &record.header, &mut contents).map_err(io)?,
        None => {
            losses.add(
                "bag headers that are damaged",
                || format!("byte {start}"),
                || "the header of the bag is damaged".into(),
            );
            false
        }
    };
    if !indexed {
        contents.topics.clear();
        let first = head.map_or(start, |record| record.data.saturating_add(record.length)).min(size);
        contents.pieces = find_chunks(&mut file, size, first, &mut losses).map_err(io)?;
        let what = format!(
            "the bag has no index at its end: its recorder was stopped, or it is cut off; its {} \
                     chunks were read one by one",
            contents.pieces.len()
        );
        losses.add("indexes that are missing", || format!("byte {size}"), || what);
        contents.losses = losses;
        contents = survey(contents)?;
    } else {
        contents.losses = losses;
    }
    let compression = match contents.pieces.first() {
        Some(piece) => outer(&mut file, size, piece.at)
            .map_err(io)?
            .and_then(|record| field(&record.header, "compression").map(label)),
        None => None,
    };
    contents.facts.insert(0, ("container".into(), "ROS 1 bag 2.0".into()));
    if let Some(compression) = compression {
        contents.facts.push(("compression".into(), compression));
    }
    Ok(contents)
}

/// Reads connections and chunks from the index; false when there is none, or not the whole.
fn read_index(
    file: &mut File,
    size: u64,
    bag_header: &[u8],
    contents: &mut Contents,
) -> std::io::Result<bool> {
    let (Some(mut at), Some(connections), Some(chunks)) = (
        field_u64(bag_header, "index_pos"),
        field_u32(bag_header, "conn_count"),
        field_u32(bag_header, "chunk_count"),
    ) else {
        return Ok(false);
    };
    if at < MAGIC.len() as u64 || at > size {
        return Ok(false);
    }
    let mut data = Vec::new();
    let mut counts: BTreeMap<u32, u64> = BTreeMap::new();
    while at < size {
        let Some(record) = outer(file, size, at)? else { return Ok(false) };
        if record.length > MOST_INDEX_RECORD || record.length > size - record.data {
            return Ok(false);
        }
        data.clear();
        file.take(record.length).read_to_end(&mut data)?;
        match op(&record.header) {
            Some(CONNECTION) => {
                let Some(topic) = topic(&record.header, &data) else { return Ok(false) };
                contents.topics.push(topic);
            }
            Some(CHUNK_INFO) => {
                let Some(piece) = chunk_info(&record.header, &data, size) else { return Ok(false) };
                for (id, messages) in piece.counts.iter().flatten() {
                    *counts.entry(*id).or_default() += messages;
                }
                contents.pieces.push(piece);
            }
            _ => {}
        }
        at = record.data + record.length;
    }
    for topic in &mut contents.topics {
        topic.messages = Some(counts.get(&topic.id).copied().unwrap_or(0));
    }
    contents.pieces.sort_by_key(|piece| piece.at);
    Ok(contents.topics.len() == connections as usize && contents.pieces.len() == chunks as usize)
}

/// A chunk, from its entry in the index.
fn chunk_info(header: &[u8], data: &[u8], size: u64) -> Option<Piece> {
    let at = field_u64(header, "chunk_pos").filter(|&at| at < size)?;
    let counts = data.as_chunks::<8>().0.iter().map(|pair| {
        let (id, messages) = (
            u32::from_le_bytes([pair[0], pair[1], pair[2], pair[3]]),
            u32::from_le_bytes([pair[4], pair[5], pair[6], pair[7]]),
        );
        (id, u64::from(messages))
    });
    let received = (field_time(header, "start_time")?, field_time(header, "end_time")?);
    Some(Piece { file: 0, at, length: None, rows: None, received, counts: Some(counts.collect()) })
}

/// Goes from record to record and notes the chunks. After bytes that are no record, looks for the next chunk.
fn find_chunks(file: &mut File, size: u64, first: u64, losses: &mut Losses) -> std::io::Result<Vec<Piece>> {
    let mut pieces = Vec::new();
    let mut at = first;
    while at < size {
        let record =
            outer(file, size, at)?.filter(|record| matches!(op(&record.header), Some(MESSAGE..=CONNECTION)));
        let Some(record) = record else {
            let next = next_chunk(file, size, at)?;
            let end = next.unwrap_or(size);
            losses.add(
                "stretches of bytes that are no record",
                || format!("bytes {at} to {end}"),
                || "these are no records; what they held is lost".into(),
            );
            at = end;
            continue;
        };
        if op(&record.header) == Some(CHUNK) {
            pieces.push(Piece { file: 0, at, length: None, rows: None, received: (0, 0), counts: None });
        }
        // A length that is wrong would carry over everything after it: what follows must be a record, or the
        // end of the file.
        let end = record.data + record.length;
        let follows = end == size
            || outer(file, size, end)?
                .is_some_and(|next| matches!(op(&next.header), Some(INDEX..=CONNECTION)));
        at = match follows {
            true => end,
            // A record that is cut off by the end of the file is read as far as it goes; another is followed
            // by bytes that are no record.
            false => next_chunk(file, size, record.data)?.unwrap_or(end.min(size)),
        };
    }
    Ok(pieces)
}

/// Looks for the header of a chunk from a place on; `None` when there is none.
fn next_chunk(file: &mut File, size: u64, from: u64) -> std::io::Result<Option<u64>> {
    const FIELD: &[u8] = b"\x04\x00\x00\x00op=\x05";
    /// The header of a chunk has three short fields, in any order: `op` is at most this far behind its start.
    const BEFORE: u64 = 64;
    const WINDOW: u64 = 1 << 16;
    let mut start = from;
    let mut window = Vec::new();
    while start < size {
        file.seek(SeekFrom::Start(start))?;
        window.clear();
        file.take(WINDOW).read_to_end(&mut window)?;
        for place in places(&window, FIELD) {
            let place = start + place as u64;
            for candidate in (from.max(place.saturating_sub(BEFORE))..place.saturating_sub(3)).rev() {
                let Some(record) = outer(file, size, candidate)? else { continue };
                let holds_it = candidate + 4 + record.header.len() as u64 > place;
                if holds_it
                    && op(&record.header) == Some(CHUNK)
                    && field(&record.header, "compression").is_some()
                {
                    return Ok(Some(candidate));
                }
            }
        }
        if window.len() < WINDOW as usize {
            break;
        }
        start += WINDOW - FIELD.len() as u64;
    }
    Ok(None)
}

/// Every place of `needle`.
fn places<'a>(bytes: &'a [u8], needle: &'a [u8]) -> impl Iterator<Item = usize> + 'a {
    bytes
        .windows(needle.len())
        .enumerate()
        .filter(move |(_, window)| *window == needle)
        .map(|(place, _)| place)
}
