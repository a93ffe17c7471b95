//! The head of an AEDAT4 file: how its packets are compressed, where they end, and which streams there are.
//!
//! After the line `#!AER-DAT4.0` stands a table (`IOHE`) with the compression, the position of the data table
//! behind the last packet (-1: none), and an XML text that lists the streams: `dv` > `outInfo` > one node a
//! stream, with its four-letter kind, size and camera.

use super::decompress::Compression;
use super::flat::Table;
use crate::error::FormatError;
use crate::recording::not_read;
use photocurrent_core::Extent;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// What every AEDAT4 file begins with.
pub(super) const MAGIC: &[u8; 14] = b"#!AER-DAT4.0\r\n";

/// A header that claims more than this is none.
const MOST_HEADER: u64 = 1 << 26;

/// What a stream's packets hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Content {
    /// Events.
    Events,
    /// Frames.
    Frames,
    /// Trigger signals.
    Triggers,
    /// Samples of an inertial sensor, or what else there may be.
    Other,
}

/// One stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Stream {
    /// Its number, which every packet bears.
    pub id: u32,
    /// What it holds.
    pub content: Content,
    /// The four letters that stand for that: `EVTS`.
    pub kind: String,
    /// What the recorder called it: `events`.
    pub name: Option<String>,
    /// The camera: `DAVIS346_00000336`.
    pub source: Option<String>,
    /// Size of the pixel array.
    pub extent: Option<Extent>,
}

/// What the head says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Header {
    /// How packets are compressed.
    pub compression: Compression,
    /// Where the first packet stands.
    pub first: u64,
    /// Where the data table should stand; `None` when there is none.
    pub table: Option<u64>,
    /// Size of the file.
    pub size: u64,
    /// All streams, by number.
    pub streams: Vec<Stream>,
}

impl Header {
    /// Reads the head of a file.
    ///
    /// # Errors
    /// When it is not an AEDAT4 file, ends within its head, or the head is damaged.
    pub(super) fn read(path: &Path) -> Result<Header, FormatError> {
        let io = |error: std::io::Error| FormatError::io(path, &error);
        let mut file = File::open(path).map_err(io)?;
        let size = file.metadata().map_err(io)?.len();
        let mut start = Vec::new();
        file.by_ref().take(18).read_to_end(&mut start).map_err(io)?;
        if !start.starts_with(MAGIC) {
            let found: String = start
                .iter()
                .take(12)
                .map(|&byte| if byte.is_ascii_graphic() || byte == b' ' { byte as char } else { '.' })
                .collect();
            return Err(FormatError::new(
                path,
                format!("the file begins with `{found}`"),
                "let the program find the format by itself, or convert the file",
            )
            .at("byte 0")
            .expected("`#!AER-DAT4.0`, as AEDAT4 files begin"));
        }
        let cut = || {
            let hint = "copy it again from where it was recorded";
            FormatError::new(
                path,
                format!("the file ends at byte {size}, inside its header; no packet can be read"),
                hint,
            )
        };
        let length = start
            .get(14..18)
            .and_then(|bytes| bytes.try_into().ok())
            .map(|bytes| u64::from(u32::from_le_bytes(bytes)))
            .ok_or_else(cut)?;
        if 18 + length > size {
            return Err(cut());
        }
        let damaged = |what: String| {
            FormatError::new(
                path,
                format!("the header is damaged: {what}"),
                "copy the file again from where it was recorded",
            )
        };
        if length > MOST_HEADER {
            return Err(damaged(format!("it says to have {length} bytes")).at("byte 14"));
        }
        // Its length counts as a part of the table: positions start behind it.
        let mut bytes = start[14..].to_vec();
        file.by_ref().take(length).read_to_end(&mut bytes).map_err(io)?;
        let table = Table::root(&bytes, b"IOHE")
            .ok_or_else(|| damaged("it is not the table that it should be".into()).at("byte 14"))?;
        let compression = Compression::of_code(table.i32(0));
        let compression = compression.ok_or_else(|| {
            damaged(format!("compression {} is none that is known (0 to 4 are)", table.i32(0)))
        })?;
        let text =
            table.vector(2, 1).ok_or_else(|| damaged("its list of streams does not fit into it".into()))?;
        let text = std::str::from_utf8(text)
            .map_err(|error| damaged(format!("its list of streams is no UTF-8 text: {error}")))?;
        let streams = streams(text).map_err(damaged)?;
        let table = if table.has(1) { u64::try_from(table.i64(1)).ok() } else { None };
        Ok(Header { compression, first: 18 + length, table, size, streams })
    }

    /// The stream of a kind that is to be read: the one that was named, or that with the lowest number; then
    /// a note on the others.
    ///
    /// # Errors
    /// When there is none of that name.
    pub(super) fn choose(
        &self,
        path: &Path,
        content: Content,
        named: Option<&str>,
        field: &'static str,
    ) -> Result<(Option<&Stream>, Option<String>), FormatError> {
        let all: Vec<&Stream> = self.streams.iter().filter(|stream| stream.content == content).collect();
        let Some(wanted) = named else {
            let Some((first, rest)) = all.split_first() else { return Ok((None, None)) };
            let others: Vec<String> = rest.iter().map(|stream| stream.describe()).collect();
            let others: Vec<&str> = others.iter().map(String::as_str).collect();
            let what = if content == Content::Events { "events" } else { "frames" };
            let note = (!others.is_empty())
                .then(|| not_read(what, &format!("stream {}", first.describe()), &others, field));
            return Ok((Some(first), note));
        };
        let is = |stream: &&&Stream| {
            stream.id.to_string() == wanted
                || stream.name.as_deref() == Some(wanted)
                || stream.source.as_deref() == Some(wanted)
        };
        match all.iter().find(is) {
            Some(stream) => Ok((Some(stream), None)),
            // The camera of the events may be named where another stream is looked for.
            None if all.is_empty() => Ok((None, None)),
            None => {
                let names: Vec<String> = all.iter().map(|stream| stream.describe()).collect();
                Err(FormatError::new(
                    path,
                    format!("no stream is called `{wanted}`"),
                    format!("name one of these by its number: {}", names.join("; ")),
                )
                .undeclared(field))
            }
        }
    }
}

impl Stream {
    /// For people: "0 EVTS `events` 346 x 260 of DAVIS346_00000336".
    pub(super) fn describe(&self) -> String {
        let name = self.name.as_ref().map(|name| format!(" `{name}`")).unwrap_or_default();
        let extent = self.extent.map(|extent| format!(" {extent}")).unwrap_or_default();
        let source = self.source.as_ref().map(|source| format!(" of {source}")).unwrap_or_default();
        format!("{} {}{name}{extent}{source}", self.id, self.kind)
    }
}

/// The streams that the XML text lists, by number.
fn streams(text: &str) -> Result<Vec<Stream>, String> {
    // A recorder may end the text with a zero byte.
    let document = roxmltree::Document::parse(text.trim_end_matches('\0'))
        .map_err(|error| format!("its list of streams is no XML: {error}"))?;
    let list = document
        .descendants()
        .find(|node| node.has_tag_name("node") && node.attribute("name") == Some("outInfo"));
    let list = list.ok_or("its list of streams has no node `outInfo`")?;
    let mut streams = Vec::new();
    for node in list.children().filter(|node| node.has_tag_name("node")) {
        let value = |of: roxmltree::Node, key: &str| {
            of.children()
                .find(|node| node.has_tag_name("attr") && node.attribute("key") == Some(key))
                .and_then(|node| node.text())
                .map(|text| text.trim().to_owned())
        };
        let name = node.attribute("name").unwrap_or_default();
        let id = name.parse::<u32>().map_err(|_| format!("a stream is numbered `{name}`"))?;
        let kind =
            value(node, "typeIdentifier").ok_or_else(|| format!("stream {id} has no `typeIdentifier`"))?;
        let content = match kind.as_str() {
            "EVTS" => Content::Events,
            "FRME" => Content::Frames,
            "TRIG" => Content::Triggers,
            _ => Content::Other,
        };
        let info =
            node.children().find(|node| node.has_tag_name("node") && node.attribute("name") == Some("info"));
        let said = |key: &str| info.and_then(|info| value(info, key));
        let size = |key: &str| {
            said(key).and_then(|text| text.parse::<u16>().ok()).filter(|&size| size > 0).map(u32::from)
        };
        let extent = size("sizeX").zip(size("sizeY")).map(|(width, height)| Extent { width, height });
        streams.push(Stream {
            id,
            content,
            kind,
            name: value(node, "originalOutputName"),
            source: said("source"),
            extent,
        });
    }
    streams.sort_by_key(|stream| stream.id);
    if streams.windows(2).any(|pair| pair[0].id == pair[1].id) {
        return Err("two streams have one number".into());
    }
    if streams.is_empty() {
        return Err("it lists no stream".into());
    }
    Ok(streams)
}
