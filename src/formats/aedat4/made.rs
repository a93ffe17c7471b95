//! A few bytes of AEDAT4 by hand, for tests: FlatBuffers tables laid out after the published schemas.
//!
//! Bytes are made here, so panics are mistakes of a test.

#![allow(clippy::unwrap_used, clippy::type_complexity)]

use std::io::Write;

/// A table of one root with every field present: `fields` in order of their slots, each aligned to its size;
/// `tail` is a vector that the last field points to. Positions count from behind the four bytes of the length
/// that is written before it, alignment from their start.
pub fn flat_table(identifier: &[u8; 4], fields: &[Vec<u8>], tail: &[u8]) -> Vec<u8> {
    // Root offset, identifier, list of fields (padded to 4), table, tail.
    let list_length = 4 + 2 * fields.len();
    let list_at = 8;
    let table_at = (list_at + list_length).next_multiple_of(8) + 4;
    let mut table = ((table_at - list_at) as i32).to_le_bytes().to_vec();
    let mut slots = Vec::new();
    for field in fields {
        table.resize(table.len().next_multiple_of(field.len()), 0);
        slots.push(table.len() as u16);
        table.extend(field);
    }
    let tail_at = (table_at + table.len()).next_multiple_of(8);
    let last = *slots.last().unwrap() as usize;
    table[last..last + 4].copy_from_slice(&((tail_at - table_at - last) as u32).to_le_bytes());
    let mut bytes = (table_at as u32).to_le_bytes().to_vec();
    bytes.extend(identifier);
    bytes.extend((list_length as u16).to_le_bytes());
    bytes.extend((table.len() as u16).to_le_bytes());
    slots.iter().for_each(|slot| bytes.extend(slot.to_le_bytes()));
    bytes.resize(table_at, 0);
    bytes.extend(table);
    bytes.resize(tail_at, 0);
    bytes.extend(tail);
    bytes
}

fn vector(count: usize, bytes: &[u8]) -> Vec<u8> {
    [&(count as u32).to_le_bytes()[..], bytes].concat()
}

/// How a file is compressed in a test; the number in its header follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum How {
    /// Bytes as they are.
    Plain,
    /// LZ4 blocks of 64 KiB, linked, without checksums: what cameras write.
    Lz4,
    /// LZ4 with all checksums and independent blocks.
    Lz4Checked,
    /// Zstandard with the size of the content.
    Zstd,
    /// Zstandard without it.
    ZstdStream,
}

impl How {
    /// All of them.
    pub const ALL: [How; 5] = [How::Plain, How::Lz4, How::Lz4Checked, How::Zstd, How::ZstdStream];

    fn code(self) -> i32 {
        match self {
            How::Plain => 0,
            How::Lz4 => 1,
            How::Lz4Checked => 2,
            How::Zstd => 3,
            How::ZstdStream => 4,
        }
    }

    /// Compresses bytes.
    pub fn apply(self, bytes: &[u8]) -> Vec<u8> {
        use lz4_flex::frame::{BlockMode, BlockSize, FrameEncoder, FrameInfo};
        let lz4 = |info: FrameInfo| {
            let mut encoder = FrameEncoder::with_frame_info(info, Vec::new());
            encoder.write_all(bytes).unwrap();
            encoder.finish().unwrap()
        };
        match self {
            How::Plain => bytes.to_vec(),
            How::Lz4 => lz4(FrameInfo::new().block_mode(BlockMode::Linked).block_size(BlockSize::Max64KB)),
            How::Lz4Checked => lz4(FrameInfo::new()
                .block_mode(BlockMode::Independent)
                .block_checksums(true)
                .content_checksum(true)),
            How::Zstd => zstd::bulk::compress(bytes, 3).unwrap(),
            How::ZstdStream => zstd::stream::encode_all(bytes, 19).unwrap(),
        }
    }
}

/// A packet before it is compressed.
pub struct Piece {
    stream: u32,
    table: Vec<u8>,
    elements: i64,
    span: (i64, i64),
}

fn piece(stream: u32, table: Vec<u8>, elements: usize, span: (i64, i64)) -> Piece {
    let table = [&(table.len() as u32).to_le_bytes()[..], &table].concat();
    Piece { stream, table, elements: elements as i64, span }
}

/// Events: stamp in us, column, row, polarity.
pub fn events(stream: u32, events: &[(i64, i16, i16, u8)]) -> Piece {
    let mut bytes = Vec::new();
    for (t, x, y, on) in events {
        bytes.extend(t.to_le_bytes());
        bytes.extend(x.to_le_bytes());
        bytes.extend(y.to_le_bytes());
        bytes.extend([*on, 0, 0, 0]);
    }
    let span = (events.first().map_or(0, |event| event.0), events.last().map_or(0, |event| event.0));
    piece(stream, flat_table(b"EVTS", &[vec![0; 4]], &vector(events.len(), &bytes)), events.len(), span)
}

/// A frame: plain stamp, exposure, OpenCV's type, size, bytes of its values.
pub fn frame(
    stream: u32,
    stamp: i64,
    exposure: (i64, i64),
    format: i8,
    size: (i16, i16),
    pixels: &[u8],
) -> Piece {
    let long = |t: i64| t.to_le_bytes().to_vec();
    let short = |v: i16| v.to_le_bytes().to_vec();
    let stamps = [long(stamp), long(0), long(0), long(exposure.0), long(exposure.1)];
    let fields =
        [&stamps[..], &[vec![format as u8], short(size.0), short(size.1), short(0), short(0), vec![0; 4]]]
            .concat();
    piece(stream, flat_table(b"FRME", &fields, &vector(pixels.len(), pixels)), 1, (stamp, stamp))
}

/// Triggers: stamp in us, kind. Each is a table of its own.
pub fn triggers(stream: u32, signals: &[(i64, u8)]) -> Piece {
    let rows: Vec<Vec<u8>> =
        signals.iter().map(|(t, kind)| [&[*kind, 0, 0, 0][..], &t.to_le_bytes()].concat()).collect();
    piece(stream, rows_table(b"TRIG", &[8, 16, 8, 4], &rows), signals.len(), (0, 0))
}

/// The head of a file: `streams` are kind, width, height.
pub fn header(how: How, table_at: i64, streams: &[(&str, u32, u32)]) -> Vec<u8> {
    let mut xml = String::from("<dv version=\"2.0\"><node name=\"outInfo\">");
    for (id, (kind, width, height)) in streams.iter().enumerate() {
        xml += &format!(
            "<node name=\"{id}\"><attr key=\"typeIdentifier\">{kind}</attr><attr \
                         key=\"originalOutputName\">out{id}</attr><node name=\"info\">"
        );
        xml += &format!(
            "<attr key=\"source\">DAVIS346_00000007</attr><attr \
                         key=\"sizeX\">{width}</attr><attr key=\"sizeY\">{height}</attr></node></node>"
        );
    }
    xml += "</node></dv>";
    let text = vector(xml.len(), &[xml.as_bytes(), &[0]].concat());
    let table = flat_table(
        b"IOHE",
        &[how.code().to_le_bytes().to_vec(), table_at.to_le_bytes().to_vec(), vec![0; 4]],
        &text,
    );
    [b"#!AER-DAT4.0\r\n", &(table.len() as u32).to_le_bytes()[..], &table].concat()
}

/// A whole file, with or without the data table behind its packets.
pub fn file(how: How, streams: &[(&str, u32, u32)], pieces: &[Piece], with_table: bool) -> Vec<u8> {
    let mut bytes = header(how, -1, streams);
    let mut rows = Vec::new();
    for piece in pieces {
        let content = how.apply(&piece.table);
        bytes.extend(piece.stream.to_le_bytes());
        bytes.extend((content.len() as u32).to_le_bytes());
        rows.push((
            bytes.len() as i64,
            piece.stream as i32,
            content.len() as i32,
            piece.elements,
            piece.span,
        ));
        bytes.extend(content);
    }
    if with_table {
        let head = header(how, bytes.len() as i64, streams);
        bytes[..head.len()].copy_from_slice(&head);
        let table = data_table(&rows);
        bytes.extend(how.apply(&[&(table.len() as u32).to_le_bytes()[..], &table].concat()));
    }
    bytes
}

/// Rows: place of the content, stream, length, elements, first and last stamp.
fn data_table(rows: &[(i64, i32, i32, i64, (i64, i64))]) -> Vec<u8> {
    let row = |(at, stream, length, elements, span): &(i64, i32, i32, i64, (i64, i64))| {
        [
            &at.to_le_bytes()[..],
            &stream.to_le_bytes(),
            &length.to_le_bytes(),
            &elements.to_le_bytes(),
            &span.0.to_le_bytes(),
            &span.1.to_le_bytes(),
        ]
        .concat()
    };
    rows_table(b"FTAB", &[14, 44, 4, 12, 20, 28, 36], &rows.iter().map(row).collect::<Vec<_>>())
}

/// A table whose one field is a vector of tables: `list` is the list of fields that serves all of those,
/// `rows` are their bytes behind the distance to it.
fn rows_table(identifier: &[u8; 4], list: &[u16], rows: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = 40u32.to_le_bytes().to_vec();
    bytes.extend(identifier);
    list.iter().for_each(|entry| bytes.extend(entry.to_le_bytes()));
    // The root's list of one field, at 24; the root at 40.
    bytes.resize(24, 0);
    [6u16, 8, 4].iter().for_each(|entry| bytes.extend(entry.to_le_bytes()));
    bytes.resize(40, 0);
    bytes.extend(16i32.to_le_bytes());
    bytes.extend(4u32.to_le_bytes());
    bytes.extend((rows.len() as u32).to_le_bytes());
    let start = bytes.len();
    let size = 4 + rows.first().map_or(0, Vec::len);
    let row_at = |k: usize| start + 4 * rows.len() + size * k;
    (0..rows.len()).for_each(|k| bytes.extend(((row_at(k) - start - 4 * k) as u32).to_le_bytes()));
    for (k, row) in rows.iter().enumerate() {
        bytes.extend((row_at(k) as i32 - 8).to_le_bytes());
        bytes.extend(row);
    }
    bytes
}
