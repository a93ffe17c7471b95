//! Reads AEDAT4 files: the recordings of DAVIS cameras (DV, dv-processing).
//!
//! An AEDAT4 file is a header (an XML list of streams) and a chain of packets, each compressed, each belonging to one stream. Events and
//! frames are taken, IMU and trigger packets are left. Stamps are microseconds of the camera's clock and become nanoseconds; t = 0 is the
//! earliest stamp of the file (an event, or a frame's start of exposure), and a note says how much was subtracted. A frame's exposure is what
//! its two exposure stamps say: `t_s` and `t_e` of Eq. (5). The camera's stamp is the only one an event has, so it is the off-pixel time.
//!
//! Before anything is decoded, the chain of packets is walked once by its lengths alone: a file that was cut off is refused with the number of
//! whole packets, instead of giving a shorter recording.
//!
//! Limits: the whole window is held in memory (40 bytes an event, 4 bytes a frame value). One event and one frame stream are read, those
//! with the lowest number. Frames are linear DN only if the camera wrote them so; the file does not say.

use aedat::base::{Decoder, Packet, ParseError, StreamContent};
use aedat::{events_generated, frame_generated};
use photocurrent_core::events::Event;
use photocurrent_core::quantity::{Duration, InputPath};
use photocurrent_core::value::DataType;
use photocurrent_core::{
    Colour, Context, Decl, EventBand, EventStream, EventsMeta, Exposure, Extent, FileRef, FrameBlock, FrameScale, FrameSequence, FrameTimes, FramesMeta, Grain,
    Meta, Node, NodeError, Polarity, PortMetas, TimeSpan,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;

/// Parameters of `read/aedat4`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The recording, an AEDAT4 file; relative to the manifest that names it.
    pub path: InputPath,
    /// Leave out what was stamped before this time; counted from the earliest stamp of the file. Default: the beginning.
    #[schemars(extend("x-min" = "0 ns"))]
    pub start: Option<Duration>,
    /// Leave out events stamped at or after this time, and frames whose exposure ends after it; counted as `start`. Default: the end.
    #[schemars(extend("x-min" = "0 ns"))]
    pub end: Option<Duration>,
    /// Delay from one row's exposure to the next. 0 is a global shutter, which DAVIS cameras have; the file does not state it.
    #[schemars(extend("x-min" = "0 ns"))]
    pub row_time: Duration,
}

photocurrent_core::ports! {
    /// Nothing is needed.
    pub struct In {}
}

photocurrent_core::ports! {
    /// What the file holds.
    pub struct Out {
        /// The events, with off-pixel times only.
        events: Option<EventStream>,
        /// The frames as captured: grey, or colour as red, green, blue.
        frames: Option<FrameSequence>,
    }
}

/// The node.
pub struct ReadAedat4 {
    params: Params,
}

/// Microsecond stamps.
const NS_PER_US: i64 = 1000;

/// How a frame's pixels stand in the file: OpenCV's type code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct PixelFormat {
    /// Channels in the file: 1 grey, 3 BGR, 4 BGRA.
    stored: usize,
    /// Bytes of one value, little-endian.
    bytes: usize,
}

impl PixelFormat {
    fn of_code(code: i8) -> Option<PixelFormat> {
        let bytes = match code & 7 {
            0 => 1,
            2 => 2,
            _ => return None,
        };
        match code >> 3 {
            0 => Some(PixelFormat { stored: 1, bytes }),
            2 => Some(PixelFormat { stored: 3, bytes }),
            3 => Some(PixelFormat { stored: 4, bytes }),
            _ => None,
        }
    }

    fn channels(self) -> usize {
        if self.stored == 1 { 1 } else { 3 }
    }

    /// Values in the order of the file's pixels, colour as red, green, blue.
    fn values(self, bytes: &[u8]) -> impl Iterator<Item = f32> + '_ {
        let value = move |at: usize| if self.bytes == 1 { f32::from(bytes[at]) } else { f32::from(u16::from_le_bytes([bytes[at], bytes[at + 1]])) };
        let channels = self.channels();
        (0..bytes.len() / (self.bytes * self.stored)).flat_map(move |pixel| {
            // The file has blue first.
            (0..channels).map(move |c| value((pixel * self.stored + (channels - 1 - c)) * self.bytes))
        })
    }
}

/// One frame as it stands in the file.
struct StoredFrame {
    begin_us: i64,
    end_us: i64,
    format: PixelFormat,
    /// Empty when only times were asked for.
    pixels: Vec<u8>,
}

/// The whole content of a file, on the camera's clock.
#[derive(Default)]
struct Content {
    /// Extent of the event stream; `None` when the file has none.
    events_extent: Option<Extent>,
    /// Extent of the frame stream; `None` when the file has none.
    frames_extent: Option<Extent>,
    /// Events in file order; `t` in microseconds.
    events: Vec<Event>,
    frames: Vec<StoredFrame>,
    /// Streams of events or frames that were not read.
    other_streams: usize,
}

/// What the node gives: on the recording's own clock, windowed and in order.
struct Recording {
    events: Result<(Arc<EventsMeta>, Vec<Event>), String>,
    frames: Result<(Arc<FramesMeta>, Vec<StoredFrame>), String>,
    notes: Vec<String>,
    counts: Vec<(usize, String)>,
}

/// Walks the chain of packets by their lengths and says how many there are; refuses a file that is cut off.
fn count_packets(path: &Path) -> Result<u64, NodeError> {
    const MAGIC: &[u8; 14] = b"#!AER-DAT4.0\r\n";
    let name = super::short_name(path);
    let trouble = |error: std::io::Error| super::cannot_read(path, &error);
    let mut file = File::open(path).map_err(trouble)?;
    let size = file.metadata().map_err(trouble)?.len();
    let mut start = Vec::new();
    file.by_ref().take(18).read_to_end(&mut start).map_err(trouble)?;
    if !start.starts_with(MAGIC) {
        let found: String = start.iter().take(12).map(|&byte| if byte.is_ascii_graphic() || byte == b' ' { byte as char } else { '.' }).collect();
        return Err(NodeError::input(format!("{name} is not an AEDAT4 file: it begins with `{found}`, not with `#!AER-DAT4.0`"))
            .hint("AEDAT 2 and 3, RAW and DAT files have to be converted first; a recording of this project is read with read/recording")
            .param("path"));
    }
    let cut = |what: String| {
        NodeError::input(format!("{name} is cut off: {what}"))
            .note(format!("the file has {size} bytes"))
            .hint("copy it again from where it was recorded, or export the readable part with the camera's own software")
            .param("path")
    };
    let header_length = match start.get(14..18) {
        Some(bytes) => u64::from(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
        None => return Err(cut("it ends inside the header; no packet was read".into())),
    };
    if 18 + header_length > size {
        return Err(cut("it ends inside the header; no packet was read".into()));
    }
    // The decoder trusts this header blindly; check it first. Its length counts as a prefix: alignment starts there.
    let mut header = start[14..].to_vec();
    file.by_ref().take(header_length).read_to_end(&mut header).map_err(trouble)?;
    let data_table = aedat::base::ioheader_generated::size_prefixed_root_as_ioheader(&header)
        .map_err(|error| NodeError::input(format!("the header of {name} is damaged: {error}")).param("path"))?
        .file_data_position();
    let end = u64::try_from(data_table).ok();
    let (mut at, mut packets) = (18 + header_length, 0);
    loop {
        if end == Some(at) || (end.is_none() && at == size) {
            return Ok(packets);
        }
        let mut head = Vec::new();
        file.seek(SeekFrom::Start(at)).map_err(trouble)?;
        file.by_ref().take(8).read_to_end(&mut head).map_err(trouble)?;
        let length = head.get(4..8).map(|bytes| u64::from(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])));
        match length {
            Some(length) if at + 8 + length <= size => at += 8 + length,
            Some(length) => {
                let needed = at + 8 + length;
                return Err(cut(format!("packet {} needs the bytes up to {needed}; {packets} whole packets come before it", packets + 1)));
            }
            None => return Err(cut(format!("it ends at the head of packet {}; {packets} whole packets come before it", packets + 1))),
        }
        packets += 1;
    }
}

/// Reads everything that is wanted.
fn read_content(path: &Path, with_pixels: bool, mut advance: impl FnMut() -> Result<(), NodeError>) -> Result<Content, NodeError> {
    let name = super::short_name(path);
    let decoder = Decoder::new_from_file(path).map_err(|error| match error {
        ParseError::Io(error) => super::cannot_read(path, &error),
        ParseError::UnsupportedStreamType(_) => {
            NodeError::input(format!("{name} has a stream of a type that is not events, frames, IMU or triggers")).hint("export the recording without it")
        }
        other => NodeError::input(format!("the header of {name} is damaged: {other}")).param("path"),
    })?;
    let mut content = Content::default();
    let mut streams: Vec<_> = decoder.id_to_stream.iter().collect();
    streams.sort_by_key(|(id, _)| **id);
    let (mut events_id, mut frames_id) = (None, None);
    for (id, stream) in streams {
        let (taken, extent) = match stream.content {
            StreamContent::Events => (&mut events_id, &mut content.events_extent),
            StreamContent::Frame => (&mut frames_id, &mut content.frames_extent),
            StreamContent::Imus | StreamContent::Triggers => continue,
        };
        if taken.is_some() {
            content.other_streams += 1;
            continue;
        }
        *taken = Some(*id);
        *extent = Some(Extent { width: stream.width.into(), height: stream.height.into() });
        if stream.width == 0 || stream.height == 0 {
            return Err(NodeError::input(format!("{name} states an extent of {} x {} for stream {id}", stream.width, stream.height)).param("path"));
        }
    }
    for (k, packet) in decoder.enumerate() {
        let damaged = |what: String| NodeError::input(format!("packet {} of {name} is damaged: {what}", k + 1)).param("path");
        let packet = packet.map_err(|error| damaged(error.to_string()))?;
        if Some(packet.stream_id) == events_id {
            add_events(&packet, &mut content, &damaged)?;
        } else if Some(packet.stream_id) == frames_id {
            add_frame(&packet, &mut content, with_pixels, &damaged)?;
        }
        advance()?;
    }
    Ok(content)
}

fn add_events(packet: &Packet, content: &mut Content, damaged: &impl Fn(String) -> NodeError) -> Result<(), NodeError> {
    let Some(extent) = content.events_extent else { return Ok(()) };
    let table = events_generated::size_prefixed_root_as_event_packet(&packet.buffer).map_err(|error| damaged(error.to_string()))?;
    for event in table.elements().unwrap_or_default() {
        let inside = |value: i16, limit: u32| u16::try_from(value).ok().filter(|&value| u32::from(value) < limit);
        let (Some(x), Some(y)) = (inside(event.x(), extent.width), inside(event.y(), extent.height)) else {
            return Err(damaged(format!(
                "event {} is at ({}, {}), outside the {extent} pixels that the header states",
                content.events.len(),
                event.x(),
                event.y()
            )));
        };
        // The polarity byte is read as a number: a file may hold any value there, and a `bool` may not.
        content.events.push(Event { x, y, polarity: Polarity::from_bit(event.0[12]), t: event.t(), t_in: None });
    }
    Ok(())
}

fn add_frame(packet: &Packet, content: &mut Content, with_pixels: bool, damaged: &impl Fn(String) -> NodeError) -> Result<(), NodeError> {
    let Some(extent) = content.frames_extent else { return Ok(()) };
    let frame = frame_generated::size_prefixed_root_as_frame(&packet.buffer).map_err(|error| damaged(error.to_string()))?;
    let l = content.frames.len();
    let whole = i64::from(frame.width()) == i64::from(extent.width) && i64::from(frame.height()) == i64::from(extent.height);
    if !whole || frame.offset_x() != 0 || frame.offset_y() != 0 {
        let (width, height, x, y) = (frame.width(), frame.height(), frame.offset_x(), frame.offset_y());
        return Err(NodeError::input(format!("frame {l} is {width} x {height} pixels at ({x}, {y}), and the header states {extent}"))
            .hint("record without a region of interest")
            .param("path"));
    }
    let code = frame.format().0;
    let format =
        PixelFormat::of_code(code).ok_or_else(|| damaged(format!("frame {l} has the pixel format {code}, which is neither grey nor BGR of 8 or 16 bits")))?;
    if let Some(first) = content.frames.first().filter(|first| first.format != format) {
        return Err(damaged(format!(
            "frame {l} has {} x {} bits a pixel, frame 0 has {} x {}",
            format.stored,
            8 * format.bytes,
            first.format.stored,
            8 * first.format.bytes
        )));
    }
    let pixels = frame.pixels().unwrap_or_default();
    let expected = extent.pixels() * format.stored * format.bytes;
    if pixels.len() != expected {
        return Err(damaged(format!("frame {l} has {} bytes of pixels, and {expected} are needed", pixels.len())));
    }
    let (begin_us, end_us) = (frame.exposure_begin_t(), frame.exposure_end_t());
    if end_us <= begin_us {
        return Err(NodeError::input(format!("frame {l} has an exposure from {begin_us} to {end_us} us"))
            .note("without the begin and the end of its exposure, a frame cannot be compared with events")
            .param("path"));
    }
    content.frames.push(StoredFrame { begin_us, end_us, format, pixels: if with_pixels { pixels.to_vec() } else { Vec::new() } });
    Ok(())
}

impl ReadAedat4 {
    /// The recording's own clock, the window, the order.
    fn arrange(&self, content: Content) -> Result<Recording, NodeError> {
        let name = super::short_name(self.params.path.path());
        let mut counts = vec![(content.other_streams, format!("further streams of events or frames in {name} were not read"))];
        let stamps = content.events.iter().map(|event| event.t).chain(content.frames.iter().map(|frame| frame.begin_us));
        let zero_us = stamps.min().unwrap_or(0);
        let notes = vec![format!("t = 0 is {zero_us} us on the camera's clock")];
        let ns = |us: i64| {
            us.checked_sub(zero_us)
                .and_then(|us| us.checked_mul(NS_PER_US))
                .ok_or_else(|| NodeError::input(format!("the stamps {zero_us} us and {us} us in {name} cannot belong to one recording")).param("path"))
        };
        let (start, end) = (self.params.start.map_or(i64::MIN, Duration::ns), self.params.end.map_or(i64::MAX, Duration::ns));
        let window = || match (self.params.start, self.params.end) {
            (None, None) => String::new(),
            (start, end) => format!(" from {} to {}", start.unwrap_or_default(), end.map_or("the end".into(), |end| end.to_string())),
        };

        let events = match content.events_extent {
            None => Err(format!("{name} has no event stream")),
            Some(extent) => {
                let unsorted = content.events.windows(2).filter(|pair| pair[1].t < pair[0].t).count();
                counts.push((unsorted, format!("events in {name} are stamped earlier than the event before; sorted by time")));
                let mut events = content.events;
                for event in &mut events {
                    event.t = ns(event.t)?;
                }
                events.retain(|event| (start..end).contains(&event.t));
                let span = events.iter().map(|event| TimeSpan::new(event.t, event.t + 1)).reduce(TimeSpan::union);
                let (t_resolution_ns, count_hint) = (Some(NS_PER_US), Some(events.len() as u64));
                Ok((Arc::new(EventsMeta { extent, span, has_t_in: false, has_step: false, t_resolution_ns, count_hint }), events))
            }
        };

        let frames = match content.frames_extent {
            None => Err(format!("{name} has no frame stream")),
            Some(extent) => {
                let unsorted = content.frames.windows(2).filter(|pair| pair[1].begin_us < pair[0].begin_us).count();
                counts.push((unsorted, format!("frames in {name} begin earlier than the frame before; sorted by time")));
                let mut frames = Vec::new();
                for frame in content.frames {
                    let exposure = Exposure::new(ns(frame.begin_us)?, ns(frame.end_us)?);
                    if exposure.start.0 >= start && exposure.end.0 <= end {
                        frames.push((exposure, frame));
                    }
                }
                frames.sort_by_key(|(exposure, _)| exposure.start);
                match frames.first().map(|(_, frame)| if frame.format.channels() == 3 { Colour::Rgb } else { Colour::Mono }) {
                    None => Err(format!("{name} has no frame{}", window())),
                    Some(colour) => {
                        let times = FrameTimes::new(frames.iter().map(|(exposure, _)| *exposure).collect(), self.params.row_time.ns())?;
                        let meta = FramesMeta { extent, colour, times, scale: FrameScale::Captured };
                        Ok((Arc::new(meta), frames.into_iter().map(|(_, frame)| frame).collect()))
                    }
                }
            }
        };
        Ok(Recording { events, frames, notes, counts })
    }
}

impl Node for ReadAedat4 {
    const DECL: Decl = Decl {
        kind: "read/aedat4",
        about: "Reads events and frames of an AEDAT4 file (DAVIS cameras).",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["AEDAT 4.0 file format, iniVation", "crate aedat 1.3 (decoder)"],
        example: r#"
[nodes.recording]
kind   = "read/aedat4"
params = { path = "davis346_traffic.aedat4", end = "1 s" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        super::need_path(&params.path, "recording.aedat4")?;
        for (param, value) in [("start", params.start), ("end", params.end), ("row_time", Some(params.row_time))] {
            if let Some(value) = value.filter(|value| value.ns() < 0) {
                return Err(NodeError::usage(format!("`{param}` is {value}, and must not be negative")).param(param));
            }
        }
        if let (Some(start), Some(end)) = (params.start, params.end)
            && end <= start
        {
            return Err(NodeError::usage(format!("the window ends at {end}, and begins at {start}")).param("end"));
        }
        Ok(ReadAedat4 { params })
    }

    fn plan(&self, _: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let path = self.params.path.path();
        count_packets(path)?;
        let recording = self.arrange(read_content(path, false, || Ok(()))?)?;
        let events = recording.events.map(|(meta, _)| Meta::Events(meta)).unwrap_or_else(|why| Meta::Absent { data_type: DataType::Events, why });
        let frames = recording.frames.map(|(meta, _)| Meta::Frames(meta)).unwrap_or_else(|why| Meta::Absent { data_type: DataType::Frames, why });
        Ok(vec![events, frames])
    }

    fn run(&self, _: In, cx: &Context) -> Result<Out, NodeError> {
        let path = self.params.path.path();
        cx.begin(count_packets(path)?, "packets");
        let recording = self.arrange(read_content(path, cx.wants("frames"), || cx.advance(1))?)?;
        recording.notes.into_iter().for_each(|note| cx.note(note));
        recording.counts.iter().for_each(|(n, what)| cx.count(*n as u64, what));
        let events = match recording.events {
            Ok((meta, events)) if cx.wants("events") => {
                let mut band = EventBand::from_events(meta.extent.rows(), events)?;
                // Of no event, all have an in-pixel time; the meta says that these have none.
                band.t_in = None;
                Some(EventStream::in_memory(meta, band))
            }
            _ => None,
        };
        let frames = match recording.frames {
            Ok((meta, stored)) if cx.wants("frames") => {
                let mut dn = Vec::with_capacity(stored.len() * meta.row_values() * meta.extent.height as usize);
                stored.iter().for_each(|frame| dn.extend(frame.format.values(&frame.pixels)));
                let block = FrameBlock { frames: 0..stored.len(), rows: meta.extent.rows(), row_values: meta.row_values(), dn };
                Some(FrameSequence::in_memory(meta, block))
            }
            _ => None,
        };
        Ok(Out { events, frames })
    }

    fn files(&self) -> Vec<FileRef> {
        vec![FileRef { param: "path".into(), path: self.params.path.path().into() }]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::Rows;
    use photocurrent_core::testing::with_context;

    const CLIP: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../data/recordings/davis346_traffic.aedat4");

    fn plan(params: Params) -> Result<Vec<Meta>, NodeError> {
        ReadAedat4::build(params)?.plan(&PortMetas::default())
    }

    fn run(params: Params) -> Result<(Out, Vec<String>), NodeError> {
        let node = ReadAedat4::build(params)?;
        let (out, notes) = with_context(Rows { start: 0, end: 0 }, &["events", "frames"], |cx| node.run(In {}, cx));
        Ok((out?, notes))
    }

    fn at(path: impl Into<std::path::PathBuf>) -> Params {
        Params { path: InputPath::new(path), ..Params::default() }
    }

    /// Writes bytes to a file of their own and gives them to `work`.
    fn with_file<T>(bytes: &[u8], work: impl FnOnce(Params) -> T) -> T {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("clip.aedat4");
        std::fs::write(&path, bytes).unwrap();
        work(at(path))
    }

    // A few bytes of AEDAT4 by hand, after the published layout: FlatBuffers tables with every field present, nothing compressed.

    /// A table of one root: `fields` in order of their slot, each aligned to its size; `tail` is a vector that the last field points to.
    /// Positions count from behind the four bytes of the length that is written before it, alignment from their start.
    fn flat_table(identifier: &[u8; 4], fields: &[Vec<u8>], tail: &[u8]) -> Vec<u8> {
        // Root offset, identifier, vtable (padded to 4), table, tail.
        let vtable_length = 4 + 2 * fields.len();
        let vtable_at = 8;
        let table_at = (vtable_at + vtable_length).next_multiple_of(8) + 4;
        let mut table = ((table_at - vtable_at) as i32).to_le_bytes().to_vec();
        let mut slots = Vec::new();
        for field in fields {
            table.resize(table.len().next_multiple_of(field.len()), 0);
            slots.push(table.len() as u16);
            table.extend(field);
        }
        let tail_at = (table_at + table.len()).next_multiple_of(8);
        let pointer_at = table_at + *slots.last().unwrap() as usize;
        let last = *slots.last().unwrap() as usize;
        table[last..last + 4].copy_from_slice(&((tail_at - pointer_at) as u32).to_le_bytes());
        let mut bytes = (table_at as u32).to_le_bytes().to_vec();
        bytes.extend(identifier);
        bytes.extend((vtable_length as u16).to_le_bytes());
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

    fn packet(stream: u32, table: Vec<u8>) -> Vec<u8> {
        let length = table.len() as u32;
        [&stream.to_le_bytes()[..], &(length + 4).to_le_bytes(), &length.to_le_bytes(), &table].concat()
    }

    fn header(streams: &[(&str, u32, u32)]) -> Vec<u8> {
        let mut xml = String::from("<dv version=\"2.0\"><node name=\"outInfo\">");
        for (id, (kind, width, height)) in streams.iter().enumerate() {
            xml += &format!(
                "<node name=\"{id}\"><attr key=\"typeIdentifier\">{kind}</attr><node name=\"info\"><attr key=\"sizeX\">{width}</attr><attr key=\"sizeY\">{height}</attr></node></node>"
            );
        }
        xml += "</node></dv>";
        let text = vector(xml.len(), &[xml.as_bytes(), &[0]].concat());
        let table = flat_table(b"IOHE", &[vec![0; 4], (-1i64).to_le_bytes().to_vec(), vec![0; 4]], &text);
        [b"#!AER-DAT4.0\r\n", &(table.len() as u32).to_le_bytes()[..], &table].concat()
    }

    fn event_packet(stream: u32, events: &[(i64, i16, i16, u8)]) -> Vec<u8> {
        let mut bytes = Vec::new();
        for (t, x, y, on) in events {
            bytes.extend(t.to_le_bytes());
            bytes.extend(x.to_le_bytes());
            bytes.extend(y.to_le_bytes());
            bytes.extend([*on, 0, 0, 0]);
        }
        packet(stream, flat_table(b"EVTS", &[vec![0; 4]], &vector(events.len(), &bytes)))
    }

    fn frame_packet(stream: u32, exposure: (i64, i64), format: i8, size: (i16, i16), pixels: &[u8]) -> Vec<u8> {
        let stamp = |t: i64| t.to_le_bytes().to_vec();
        let short = |v: i16| v.to_le_bytes().to_vec();
        let fields = [
            stamp(0),
            stamp(0),
            stamp(0),
            stamp(exposure.0),
            stamp(exposure.1),
            vec![format as u8],
            short(size.0),
            short(size.1),
            short(0),
            short(0),
            vec![0; 4],
        ];
        packet(stream, flat_table(b"FRME", &fields, &vector(pixels.len(), pixels)))
    }

    #[test]
    fn the_traffic_clip_has_the_events_and_frames_that_its_authors_count() {
        let (out, notes) = run(at(CLIP)).unwrap();
        let (events, frames) = (out.events.unwrap(), out.frames.unwrap());
        let extent = Extent { width: 346, height: 260 };
        assert_eq!((events.meta.extent, frames.meta.extent, frames.meta.colour), (extent, extent, Colour::Mono));
        let band = events.read(extent.rows()).unwrap();
        assert_eq!(band.len(), 78_830);
        assert_eq!(band.t_in, None);
        assert_eq!(frames.len(), 59);
        // Exposure 500 us, a frame every 40 ms with a spread of 0.13 us; stamps are whole microseconds.
        let exposures = &frames.meta.times.exposures;
        assert!(exposures.iter().all(|exposure| exposure.length_ns() == 500_000));
        assert!(exposures.windows(2).all(|pair| ((pair[1].start - pair[0].start) - 40_000_000).abs() <= 1000));
        assert_eq!(frames.meta.times.row_time_ns, 0);
        // 52.3 % of all events are ON; the clip lasts 2.36 s.
        let on = band.on.iter().filter(|&&on| on == 1).count() as f64 / band.len() as f64;
        assert!((on - 0.523).abs() < 0.0005, "{on}");
        assert_eq!(events.meta.span.unwrap().length_ns(), 2_359_945_001);
        assert!(frames.read_rows(extent.rows()).unwrap().dn.iter().all(|dn| (0.0..=255.0).contains(dn) && dn.fract() == 0.0));
        assert_eq!(notes.len(), 1);
        assert!(notes[0].starts_with("t = 0 is 1") && notes[0].ends_with(" us on the camera's clock"), "{notes:?}");
    }

    #[test]
    fn the_plan_knows_what_the_run_gives() {
        let window = Params { start: Some(Duration::new(500_000_000)), end: Some(Duration::new(1_000_000_000)), ..at(CLIP) };
        let metas = plan(window.clone()).unwrap();
        let (out, _) = run(window).unwrap();
        let (events, frames) = (out.events.unwrap(), out.frames.unwrap());
        assert_eq!(metas, [Meta::Events(events.meta.clone()), Meta::Frames(frames.meta.clone())]);
        // The window is cut out, and the clock stays that of the file.
        let span = events.meta.span.unwrap();
        assert!(span.start.0 >= 500_000_000 && span.end.0 <= 1_000_000_000 && span.length_ns() > 490_000_000);
        assert!((12..=13).contains(&frames.len()), "half a second holds 12 or 13 frames of 25 fps, not {}", frames.len());
    }

    #[test]
    fn a_file_that_was_cut_off_is_refused_with_the_number_of_packets_read() {
        let bytes = std::fs::read(CLIP).unwrap();
        let whole = count_packets(Path::new(CLIP)).unwrap();
        let error = with_file(&bytes[..bytes.len() / 2], plan).unwrap_err();
        assert!(error.message.starts_with("clip.aedat4 is cut off: ") && error.message.contains(" whole packets come before it"), "{error}");
        let read: u64 = error.message.split(' ').rev().nth(5).unwrap().parse().unwrap();
        assert!(read > whole / 3 && read < whole, "{read} of {whole}");
        assert!(with_file(&bytes[..200], plan).unwrap_err().message.contains("inside the header; no packet was read"));
        assert!(with_file(&bytes[..16], plan).unwrap_err().message.contains("inside the header; no packet was read"));
    }

    #[test]
    fn a_cut_between_two_packets_does_not_pass_for_the_end() {
        let bytes = std::fs::read(CLIP).unwrap();
        let header = 18 + u32::from_le_bytes(bytes[14..18].try_into().unwrap()) as usize;
        let first = 8 + u32::from_le_bytes(bytes[header + 4..header + 8].try_into().unwrap()) as usize;
        let error = with_file(&bytes[..header + first], plan).unwrap_err();
        assert!(error.message.ends_with("it ends at the head of packet 2; 1 whole packets come before it"), "{error}");
    }

    #[test]
    fn another_format_is_told_by_its_first_bytes() {
        let error = with_file(b"#!AER-DAT2.0\r\nold", plan).unwrap_err();
        assert!(error.message.contains("begins with `#!AER-DAT2.0`, not with `#!AER-DAT4.0`"), "{error}");
        assert!(with_file(b"\x89HDF", plan).unwrap_err().message.contains("begins with `.HDF`"));
        assert!(plan(at("no/such.aedat4")).unwrap_err().message.contains("no/such.aedat4: there is no such file"));
    }

    #[test]
    fn no_damage_to_any_single_byte_of_a_small_file_makes_the_reader_panic() {
        let frame = frame_packet(1, (20, 30), 0, (2, 1), &[7, 8]);
        let bytes = [header(&[("EVTS", 3, 2), ("FRME", 2, 1)]), event_packet(0, &[(10, 2, 1, 1), (11, 0, 0, 0)]), frame].concat();
        assert!(with_file(&bytes, plan).is_ok());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("clip.aedat4");
        for i in 0..bytes.len() {
            for flip in [0x01, 0x80, 0xff] {
                let mut damaged = bytes.clone();
                damaged[i] ^= flip;
                std::fs::write(&path, &damaged).unwrap();
                let _ = run(at(&path));
            }
        }
    }

    #[test]
    fn streams_that_are_not_there_are_absent_with_the_reason() {
        let metas = with_file(&[header(&[("EVTS", 3, 2)]), event_packet(0, &[(10, 2, 1, 1)])].concat(), plan).unwrap();
        assert_eq!(metas[1], Meta::Absent { data_type: DataType::Frames, why: "clip.aedat4 has no frame stream".into() });
        let metas = with_file(&header(&[("EVTS", 3, 2), ("FRME", 2, 1)]), plan).unwrap();
        let Meta::Events(events) = &metas[0] else { panic!("an event stream without events is still a stream") };
        assert_eq!(events.span, None);
        assert_eq!(metas[1], Meta::Absent { data_type: DataType::Frames, why: "clip.aedat4 has no frame".into() });
    }

    #[test]
    fn an_event_outside_the_stated_pixels_is_an_error() {
        let error = with_file(&[header(&[("EVTS", 3, 2)]), event_packet(0, &[(10, 2, 1, 1), (11, 3, 0, 1)])].concat(), plan).unwrap_err();
        assert_eq!(error.message, "packet 1 of clip.aedat4 is damaged: event 1 is at (3, 0), outside the 3 x 2 pixels that the header states");
    }

    #[test]
    fn events_out_of_order_are_sorted_and_counted() {
        let bytes = [header(&[("EVTS", 3, 2)]), event_packet(0, &[(1012, 0, 0, 1), (1010, 1, 0, 0), (1012, 2, 0, 255)])].concat();
        let (out, notes) = with_file(&bytes, run).unwrap();
        let band = out.events.unwrap().read(Rows { start: 0, end: 2 }).unwrap();
        assert_eq!((band.t, band.x, band.on), (vec![0, 2000, 2000], vec![1, 0, 2], vec![0, 1, 1]));
        let told = ["t = 0 is 1010 us on the camera's clock", "1 events in clip.aedat4 are stamped earlier than the event before; sorted by time"];
        assert_eq!(notes, told);
    }

    #[test]
    fn sixteen_bit_and_colour_frames_are_read_as_their_formats_say() {
        // OpenCV's codes: 2 is 16-bit grey, 16 is 8-bit BGR. The stamps come first to last out of order.
        let grey = [1u16, 2, 3, 1023].iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let bytes = [header(&[("FRME", 2, 2)]), frame_packet(0, (900, 950), 2, (2, 2), &grey), frame_packet(0, (800, 850), 2, (2, 2), &[0; 8])].concat();
        let (out, notes) = with_file(&bytes, run).unwrap();
        let frames = out.frames.unwrap();
        assert!(out.events.is_none());
        assert_eq!(frames.meta.times.exposures[1], Exposure::new(100_000, 150_000));
        assert_eq!(frames.read(1..2, frames.rows()).unwrap().dn, [1.0, 2.0, 3.0, 1023.0]);
        assert_eq!(notes.len(), 2);

        let bytes = [header(&[("FRME", 2, 1)]), frame_packet(0, (5, 6), 16, (2, 1), &[1, 2, 3, 11, 12, 13])].concat();
        let frames = with_file(&bytes, run).unwrap().0.frames.unwrap();
        assert_eq!(frames.meta.colour, Colour::Rgb);
        assert_eq!(frames.read_rows(frames.rows()).unwrap().dn, [3.0, 2.0, 1.0, 13.0, 12.0, 11.0]);
    }

    #[test]
    fn a_frame_that_does_not_fit_the_header_is_an_error() {
        let with_frame = |packet: Vec<u8>| with_file(&[header(&[("FRME", 2, 1)]), packet].concat(), plan).unwrap_err().message;
        assert_eq!(with_frame(frame_packet(0, (5, 6), 0, (1, 1), &[1])), "frame 0 is 1 x 1 pixels at (0, 0), and the header states 2 x 1");
        assert!(with_frame(frame_packet(0, (5, 6), 0, (2, 1), &[1])).contains("1 bytes of pixels, and 2 are needed"));
        assert!(with_frame(frame_packet(0, (6, 6), 0, (2, 1), &[1, 2])).contains("an exposure from 6 to 6 us"));
        assert!(with_frame(frame_packet(0, (5, 6), 5, (2, 1), &[1, 2])).contains("pixel format 5"));
    }

    #[test]
    fn a_window_that_ends_before_it_begins_is_refused() {
        let error = ReadAedat4::build(Params { start: Some(Duration::new(5)), end: Some(Duration::new(5)), ..at("x.aedat4") }).err().unwrap();
        assert_eq!(error.param.as_deref(), Some("end"));
    }
}
