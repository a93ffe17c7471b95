//! Writes small bags and MCAP files, message by message, after the published layouts: for tests, not for
//! recordings.
//!
//! ```
//! use photocurrent_formats::ros::testing::{BagWriter, Packing, Wire, event_array, image};
//! let mut bag = BagWriter::new(Packing::Lz4);
//! let events = bag.connect("/dvs/events", "dvs_msgs/EventArray");
//! let pictures = bag.connect("/dvs/image_raw", "sensor_msgs/Image");
//! bag.message(events, 1_000, &event_array(Wire::Ros1, 1_000, (4, 2), &[(900, 3, 1, true)]));
//! bag.message(pictures, 2_000, &image(Wire::Ros1, 1_500, (4, 2), "mono8", 4, &[7; 8]));
//! let bytes = bag.finish().unwrap();
//! assert!(bytes.starts_with(b"#ROSBAG V2.0\n"));
//! ```

use std::io::{Result, Write};

/// How messages are serialised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wire {
    /// ROS 1.
    Ros1,
    /// CDR, little-endian.
    Cdr,
    /// CDR, big-endian.
    CdrBig,
}

/// How chunks are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    /// As they are.
    None,
    /// bzip2: bags only.
    Bz2,
    /// LZ4 frames.
    Lz4,
    /// Zstandard: MCAP only.
    Zstd,
}

impl Packing {
    fn name(self) -> &'static str {
        match self {
            Packing::None => "none",
            Packing::Bz2 => "bz2",
            Packing::Lz4 => "lz4",
            Packing::Zstd => "zstd",
        }
    }

    fn pack(self, bytes: &[u8]) -> Result<Vec<u8>> {
        match self {
            Packing::None => Ok(bytes.to_vec()),
            Packing::Bz2 => {
                let mut writer = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::fast());
                writer.write_all(bytes)?;
                writer.finish()
            }
            Packing::Lz4 => {
                let mut writer = lz4_flex::frame::FrameEncoder::new(Vec::new());
                writer.write_all(bytes)?;
                Ok(writer.finish()?)
            }
            Packing::Zstd => zstd::stream::encode_all(bytes, 1),
        }
    }
}

/// Writes fields of a message.
struct Fields {
    bytes: Vec<u8>,
    wire: Wire,
}

impl Fields {
    fn new(wire: Wire) -> Fields {
        let bytes = match wire {
            Wire::Ros1 => vec![],
            Wire::Cdr => vec![0, 1, 0, 0],
            Wire::CdrBig => vec![0, 0, 0, 0],
        };
        Fields { bytes, wire }
    }

    /// A number from its little-endian bytes.
    fn put<const N: usize>(&mut self, mut number: [u8; N]) {
        if self.wire != Wire::Ros1 {
            // Counted from behind the four bytes that state the representation.
            while !(self.bytes.len() - 4).is_multiple_of(N) {
                self.bytes.push(0);
            }
        }
        if self.wire == Wire::CdrBig {
            number.reverse();
        }
        self.bytes.extend(number);
    }

    fn u32(&mut self, number: u32) {
        self.put(number.to_le_bytes());
    }

    fn string(&mut self, text: &str) {
        let zero: &[u8] = if self.wire == Wire::Ros1 { b"" } else { b"\0" };
        self.sequence(&[text.as_bytes(), zero].concat());
    }

    fn sequence(&mut self, bytes: &[u8]) {
        self.u32(bytes.len() as u32);
        self.bytes.extend(bytes);
    }

    fn time(&mut self, ns: i64) {
        self.u32((ns / 1_000_000_000) as u32);
        self.u32((ns % 1_000_000_000) as u32);
    }

    fn header(&mut self, stamp: i64) {
        if self.wire == Wire::Ros1 {
            self.u32(0);
        }
        self.time(stamp);
        self.string("cam");
    }
}

/// `dvs_msgs/EventArray`: events of time (ns), x, y, ON.
pub fn event_array(
    wire: Wire,
    stamp: i64,
    (width, height): (u32, u32),
    events: &[(i64, u16, u16, bool)],
) -> Vec<u8> {
    let mut fields = Fields::new(wire);
    fields.header(stamp);
    fields.u32(height);
    fields.u32(width);
    fields.u32(events.len() as u32);
    for (t, x, y, on) in events {
        fields.put(x.to_le_bytes());
        fields.put(y.to_le_bytes());
        fields.time(*t);
        fields.put([u8::from(*on)]);
    }
    fields.bytes
}

/// `event_camera_msgs/EventPacket`.
pub fn event_packet(
    wire: Wire,
    stamp: i64,
    (width, height): (u32, u32),
    (sequence, time_base): (u64, u64),
    encoding: &str,
    events: &[u8],
) -> Vec<u8> {
    let mut fields = Fields::new(wire);
    fields.header(stamp);
    fields.u32(height);
    fields.u32(width);
    fields.put(sequence.to_le_bytes());
    fields.put(time_base.to_le_bytes());
    fields.string(encoding);
    fields.put([0]);
    fields.sequence(events);
    fields.bytes
}

/// `sensor_msgs/Image`, of values as they stand in it.
pub fn image(
    wire: Wire,
    stamp: i64,
    (width, height): (u32, u32),
    encoding: &str,
    step: u32,
    values: &[u8],
) -> Vec<u8> {
    let mut fields = Fields::new(wire);
    fields.header(stamp);
    fields.u32(height);
    fields.u32(width);
    fields.string(encoding);
    fields.put([0]);
    fields.u32(step);
    fields.sequence(values);
    fields.bytes
}

/// `sensor_msgs/CompressedImage`, of the bytes of a PNG or JPEG file.
pub fn compressed_image(wire: Wire, stamp: i64, format: &str, bytes: &[u8]) -> Vec<u8> {
    let mut fields = Fields::new(wire);
    fields.header(stamp);
    fields.string(format);
    fields.sequence(bytes);
    fields.bytes
}

/// EVT3 words of events of time (us of the sensor's clock), x, y, ON: four words each, nothing left out.
pub fn evt3(events: &[(i64, u16, u16, bool)]) -> Vec<u8> {
    let words = events.iter().flat_map(|(t, x, y, on)| {
        let high = 0x8000 | ((t >> 12) & 0xfff) as u16;
        let low = 0x6000 | (t & 0xfff) as u16;
        [high, low, *y & 0x7ff, 0x2000 | u16::from(*on) << 11 | x & 0x7ff]
    });
    words.flat_map(u16::to_le_bytes).collect()
}

/// A bag of ROS 2 in SQLite, as a file's bytes, with pages of 1 KiB: names and types of its topics; topic,
/// time of receipt and body of its messages.
///
/// # Errors
/// When SQLite or the folder for temporary files refuses.
pub fn db3(
    topics: &[(&str, &str)],
    messages: &[(u32, i64, Vec<u8>)],
) -> std::result::Result<Vec<u8>, Box<dyn std::error::Error>> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("made.db3");
    let database = rusqlite::Connection::open(&path)?;
    database.execute_batch(
        "PRAGMA page_size = 1024; PRAGMA journal_mode = OFF; BEGIN;
         CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT \
         NULL,serialization_format TEXT NOT NULL,offered_qos_profiles TEXT NOT NULL);
         CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,timestamp INTEGER NOT NULL, \
         data BLOB NOT NULL);
         CREATE INDEX timestamp_idx ON messages (timestamp ASC);",
    )?;
    for (k, (name, type_name)) in topics.iter().enumerate() {
        database
            .execute("INSERT INTO topics VALUES (?1, ?2, ?3, 'cdr', '')", (k as i64 + 1, name, type_name))?;
    }
    for (topic, received, body) in messages {
        database.execute(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (?1, ?2, ?3)",
            (i64::from(*topic) + 1, received, body),
        )?;
    }
    database.execute_batch("COMMIT")?;
    drop(database);
    Ok(std::fs::read(&path)?)
}

/// Writes a bag of ROS 1.
pub struct BagWriter {
    packing: Packing,
    /// A chunk is closed when it has this many bytes.
    chunk_bytes: usize,
    connections: Vec<Vec<u8>>,
    out: Vec<u8>,
    chunk: Chunk,
    infos: Vec<Vec<u8>>,
    trouble: Result<()>,
}

/// The chunk that is being filled.
#[derive(Default)]
struct Chunk {
    bytes: Vec<u8>,
    /// Connection, time and place of every message.
    messages: Vec<(u32, i64, usize)>,
}

/// Header fields of a record of a bag.
fn fields(pairs: &[(&str, &[u8])]) -> Vec<u8> {
    let field = |(name, value): &(&str, &[u8])| {
        let text = [name.as_bytes(), b"=", value].concat();
        [&(text.len() as u32).to_le_bytes()[..], &text].concat()
    };
    pairs.iter().flat_map(field).collect()
}

fn record(header: &[u8], data: &[u8]) -> Vec<u8> {
    [&(header.len() as u32).to_le_bytes()[..], header, &(data.len() as u32).to_le_bytes(), data].concat()
}

fn bag_time(ns: i64) -> [u8; 8] {
    let both = (ns / 1_000_000_000) as u64 | ((ns % 1_000_000_000) as u64) << 32;
    both.to_le_bytes()
}

impl BagWriter {
    /// An empty bag.
    pub fn new(packing: Packing) -> BagWriter {
        let mut out = b"#ROSBAG V2.0\n".to_vec();
        out.extend(BagWriter::bag_header(0, 0, 0));
        let trouble = Ok(());
        BagWriter {
            packing,
            chunk_bytes: 1 << 16,
            connections: vec![],
            out,
            chunk: Chunk::default(),
            infos: vec![],
            trouble,
        }
    }

    /// Closes chunks at another size.
    #[must_use]
    pub fn chunks_of(mut self, bytes: usize) -> BagWriter {
        self.chunk_bytes = bytes;
        self
    }

    /// The first record, which is filled up to 4096 bytes.
    fn bag_header(index: u64, connections: u32, chunks: u32) -> Vec<u8> {
        let header = fields(&[
            ("op", &[3]),
            ("index_pos", &index.to_le_bytes()),
            ("conn_count", &connections.to_le_bytes()),
            ("chunk_count", &chunks.to_le_bytes()),
        ]);
        let padding = vec![b' '; 4096 - 8 - header.len()];
        record(&header, &padding)
    }

    /// Adds a connection; gives its number.
    pub fn connect(&mut self, topic: &str, type_name: &str) -> u32 {
        let id = self.connections.len() as u32;
        let header = fields(&[("op", &[7]), ("topic", topic.as_bytes()), ("conn", &id.to_le_bytes())]);
        let data = fields(&[
            ("topic", topic.as_bytes()),
            ("type", type_name.as_bytes()),
            ("md5sum", b"*"),
            ("message_definition", b""),
        ]);
        let connection = record(&header, &data);
        self.chunk.bytes.extend(&connection);
        self.connections.push(connection);
        id
    }

    /// Adds a message that was received at a time.
    pub fn message(&mut self, id: u32, received: i64, body: &[u8]) {
        self.chunk.messages.push((id, received, self.chunk.bytes.len()));
        let header = fields(&[("op", &[2]), ("conn", &id.to_le_bytes()), ("time", &bag_time(received))]);
        self.chunk.bytes.extend(record(&header, body));
        if self.chunk.bytes.len() >= self.chunk_bytes {
            self.close();
        }
    }

    fn close(&mut self) {
        let chunk = std::mem::take(&mut self.chunk);
        if chunk.bytes.is_empty() {
            return;
        }
        let packed = match self.packing.pack(&chunk.bytes) {
            Ok(packed) => packed,
            Err(error) => {
                self.trouble = Err(error);
                return;
            }
        };
        let at = self.out.len() as u64;
        let size = (chunk.bytes.len() as u32).to_le_bytes();
        self.out.extend(record(
            &fields(&[("compression", self.packing.name().as_bytes()), ("op", &[5]), ("size", &size)]),
            &packed,
        ));
        let mut counts = Vec::new();
        let mut sum = 0_u32;
        for id in 0..self.connections.len() as u32 {
            let of: Vec<_> = chunk.messages.iter().filter(|(known, _, _)| *known == id).collect();
            if of.is_empty() {
                continue;
            }
            let entries: Vec<u8> = of
                .iter()
                .flat_map(|(_, t, at)| [&bag_time(*t)[..], &(*at as u32).to_le_bytes()].concat())
                .collect();
            let count = (of.len() as u32).to_le_bytes();
            self.out.extend(record(
                &fields(&[
                    ("op", &[4]),
                    ("ver", &1_u32.to_le_bytes()),
                    ("conn", &id.to_le_bytes()),
                    ("count", &count),
                ]),
                &entries,
            ));
            counts.extend([id.to_le_bytes(), count].concat());
            sum += 1;
        }
        let times = chunk.messages.iter().map(|(_, t, _)| *t);
        let (first, last) = (times.clone().min().unwrap_or(0), times.max().unwrap_or(0));
        let header = fields(&[
            ("op", &[6]),
            ("ver", &1_u32.to_le_bytes()),
            ("chunk_pos", &at.to_le_bytes()),
            ("start_time", &bag_time(first)),
            ("end_time", &bag_time(last)),
            ("count", &sum.to_le_bytes()),
        ]);
        self.infos.push(record(&header, &counts));
    }

    /// The file.
    ///
    /// # Errors
    /// When a chunk could not be compressed.
    pub fn finish(mut self) -> Result<Vec<u8>> {
        self.close();
        self.trouble?;
        let index = self.out.len() as u64;
        let magic = b"#ROSBAG V2.0\n".len();
        let header = BagWriter::bag_header(index, self.connections.len() as u32, self.infos.len() as u32);
        self.out[magic..magic + header.len()].copy_from_slice(&header);
        self.out.extend(self.connections.concat());
        self.out.extend(self.infos.concat());
        Ok(self.out)
    }

    /// The file of a recorder that was killed: without an index.
    ///
    /// # Errors
    /// When a chunk could not be compressed.
    pub fn unfinished(mut self) -> Result<Vec<u8>> {
        self.close();
        self.trouble?;
        Ok(self.out)
    }
}

/// Writes an MCAP file.
pub struct McapWriter {
    packing: Packing,
    /// Are messages put into chunks?
    chunked: bool,
    chunk_bytes: usize,
    definitions: Vec<u8>,
    counts: Vec<u64>,
    out: Vec<u8>,
    chunk: Vec<u8>,
    times: Option<(i64, i64)>,
    indices: Vec<Vec<u8>>,
    trouble: Result<()>,
}

fn mcap_record(op: u8, content: &[u8]) -> Vec<u8> {
    [&[op][..], &(content.len() as u64).to_le_bytes(), content].concat()
}

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}

impl McapWriter {
    const MAGIC: &[u8] = b"\x89MCAP0\r\n";

    /// An empty file.
    pub fn new(packing: Packing) -> McapWriter {
        let mut out = McapWriter::MAGIC.to_vec();
        out.extend(mcap_record(1, &[text("ros2"), text("test")].concat()));
        McapWriter {
            packing,
            chunked: true,
            chunk_bytes: 1 << 16,
            definitions: vec![],
            counts: vec![],
            out,
            chunk: vec![],
            times: None,
            indices: vec![],
            trouble: Ok(()),
        }
    }

    /// Closes chunks at another size.
    #[must_use]
    pub fn chunks_of(mut self, bytes: usize) -> McapWriter {
        self.chunk_bytes = bytes;
        self
    }

    /// Writes messages outside of chunks.
    #[must_use]
    pub fn without_chunks(mut self) -> McapWriter {
        self.chunked = false;
        self
    }

    /// Adds a channel whose messages are serialised so; gives its number.
    pub fn connect(&mut self, topic: &str, type_name: &str, wire: Wire) -> u16 {
        let id = self.counts.len() as u16;
        let encoding = if wire == Wire::Ros1 { "ros1" } else { "cdr" };
        let schema = [&(id + 1).to_le_bytes()[..], &text(type_name), &text("ros2msg"), &text("")].concat();
        let channel = [
            &id.to_le_bytes()[..],
            &(id + 1).to_le_bytes(),
            &text(topic),
            &text(encoding),
            &0_u32.to_le_bytes(),
        ]
        .concat();
        let definition = [mcap_record(3, &schema), mcap_record(4, &channel)].concat();
        if self.chunked {
            self.chunk.extend(&definition)
        } else {
            self.out.extend(&definition)
        }
        self.definitions.extend(definition);
        self.counts.push(0);
        id
    }

    /// Adds a message that was received at a time.
    pub fn message(&mut self, id: u16, received: i64, body: &[u8]) {
        let time = (received as u64).to_le_bytes();
        let message =
            mcap_record(5, &[&id.to_le_bytes()[..], &0_u32.to_le_bytes(), &time, &time, body].concat());
        self.counts[usize::from(id)] += 1;
        if !self.chunked {
            self.out.extend(message);
            return;
        }
        let (first, last) = self.times.unwrap_or((received, received));
        self.times = Some((first.min(received), last.max(received)));
        self.chunk.extend(message);
        if self.chunk.len() >= self.chunk_bytes {
            self.close();
        }
    }

    fn close(&mut self) {
        let records = std::mem::take(&mut self.chunk);
        if records.is_empty() {
            return;
        }
        let packed = match self.packing.pack(&records) {
            Ok(packed) => packed,
            Err(error) => {
                self.trouble = Err(error);
                return;
            }
        };
        let (first, last) = self.times.take().unwrap_or((0, 0));
        let times = [(first as u64).to_le_bytes(), (last as u64).to_le_bytes()].concat();
        let name = text(if self.packing == Packing::None { "" } else { self.packing.name() });
        let size = (records.len() as u64).to_le_bytes();
        let packed_size = (packed.len() as u64).to_le_bytes();
        let content = [&times[..], &size, &0_u32.to_le_bytes(), &name, &packed_size, &packed].concat();
        let chunk = mcap_record(6, &content);
        let places = [(self.out.len() as u64).to_le_bytes(), (chunk.len() as u64).to_le_bytes()].concat();
        let index =
            [&times[..], &places, &0_u32.to_le_bytes(), &0_u64.to_le_bytes(), &name, &packed_size, &size]
                .concat();
        self.indices.push(mcap_record(8, &index));
        self.out.extend(chunk);
    }

    /// The file.
    ///
    /// # Errors
    /// When a chunk could not be compressed.
    pub fn finish(mut self) -> Result<Vec<u8>> {
        self.close();
        self.trouble?;
        self.out.extend(mcap_record(15, &0_u32.to_le_bytes()));
        let summary = self.out.len() as u64;
        let counts: Vec<u8> = (0_u16..)
            .zip(&self.counts)
            .flat_map(|(id, count)| [&id.to_le_bytes()[..], &count.to_le_bytes()].concat())
            .collect();
        let channels = self.counts.len() as u32;
        let statistics = [
            &self.counts.iter().sum::<u64>().to_le_bytes()[..],
            &(channels as u16).to_le_bytes(),
            &channels.to_le_bytes(),
            &[0; 8],
            &(self.indices.len() as u32).to_le_bytes(),
            &[0; 16],
            &(counts.len() as u32).to_le_bytes(),
            &counts,
        ];
        self.out.extend(self.definitions);
        self.out.extend(mcap_record(11, &statistics.concat()));
        self.out.extend(self.indices.concat());
        self.out.extend(mcap_record(2, &[&summary.to_le_bytes()[..], &[0; 12]].concat()));
        self.out.extend(McapWriter::MAGIC);
        Ok(self.out)
    }

    /// The file of a recorder that was killed: without an end.
    ///
    /// # Errors
    /// When a chunk could not be compressed.
    pub fn unfinished(mut self) -> Result<Vec<u8>> {
        self.close();
        self.trouble?;
        Ok(self.out)
    }
}
