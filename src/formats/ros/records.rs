//! The records inside one piece of a recording: a compressed chunk, a run of records that stand in the file as they are, or rows of a database.
//!
//! A piece is decompressed as it is read, and one message is held at a time: what a piece claims to need is never taken. Anything that is wrong
//! ends the piece with a reason; the pieces after it can still be read.

use super::bag;
use super::mcap;
use super::messages::Serial;
use super::sqlite::Rows;
use super::wire::label;
use std::fs::File;
use std::io::{BufReader, Read};

/// Which container a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Container {
    /// ROS 1 bag, version 2.0.
    Bag,
    /// MCAP.
    Mcap,
    /// SQLite database of rosbag2.
    Sqlite,
}

/// One message longer than this is left out: no camera sends it, and it is held whole.
pub const MOST_MESSAGE: u64 = 256 << 20;
/// A compressed chunk that claims more than this is left out: it would be a day's work for a few bytes.
pub const MOST_CHUNK: u64 = 1 << 30;
/// What stands before the data of a bag's record is short text.
const MOST_HEADER: u32 = 1 << 16;
/// Definitions of topics are text; those of other types can be long.
const MOST_DEFINITION: u64 = 16 << 20;
/// What is read from a file at a time.
const FILE_BUFFER: usize = 1 << 16;

/// The bytes of a piece, decompressed.
pub enum Source {
    /// They stand in the file so; these many are left.
    Plain(BufReader<File>, u64),
    /// They come out of a decompressor; it gives these many at most.
    Packed(Box<dyn Read + Send>, u64),
}

impl Source {
    /// Bytes of a file from where it stands, as they are.
    pub fn plain(file: File, length: u64) -> Source {
        Source::Plain(BufReader::with_capacity(FILE_BUFFER, file), length)
    }

    /// `length` compressed bytes of a file from where it stands, which give `claimed` bytes. The compression by its name in bags and MCAP.
    ///
    /// # Errors
    /// When the compression is unknown, or claims too much.
    pub fn packed(file: File, length: u64, compression: &[u8], claimed: u64) -> Result<Source, String> {
        if matches!(compression, b"" | b"none") {
            return Ok(Source::plain(file, length));
        }
        if claimed > MOST_CHUNK {
            return Err(format!("the chunk claims {claimed} bytes uncompressed; {MOST_CHUNK} at most are read"));
        }
        let bytes = BufReader::with_capacity(FILE_BUFFER, file).take(length);
        let reader: Box<dyn Read + Send> = match compression {
            b"bz2" => Box::new(bzip2::bufread::BzDecoder::new(bytes)),
            b"lz4" => Box::new(lz4_flex::frame::FrameDecoder::new(bytes)),
            b"zstd" => {
                let mut decoder = zstd::stream::read::Decoder::with_buffer(bytes).map_err(|error| error.to_string())?;
                // The window that a frame asks for is allocated at once; recorders ask for 8 MiB at most.
                decoder.window_log_max(25).map_err(|error| error.to_string())?;
                Box::new(decoder)
            }
            other => return Err(format!("the chunk is compressed by `{}`, which is not read (none, bz2, lz4 and zstd are)", label(other))),
        };
        Ok(Source::Packed(reader, claimed))
    }

    fn left(&self) -> u64 {
        match self {
            Source::Plain(_, left) | Source::Packed(_, left) => *left,
        }
    }

    /// Replaces `bytes` by the next `length`; grows with what comes, not with what is claimed.
    fn take(&mut self, length: u64, bytes: &mut Vec<u8>) -> Result<(), String> {
        bytes.clear();
        if length > self.left() {
            return Err(format!("a record claims {length} bytes where {} are left", self.left()));
        }
        let got = match self {
            Source::Plain(reader, left) => {
                *left -= length;
                reader.take(length).read_to_end(bytes)
            }
            Source::Packed(reader, left) => {
                *left -= length;
                reader.take(length).read_to_end(bytes)
            }
        };
        match got {
            Ok(got) if got as u64 == length => Ok(()),
            Ok(_) => Err("the piece ends within a record".into()),
            Err(error) => Err(format!("the piece cannot be decompressed further ({error})")),
        }
    }

    /// Goes over the next `length` bytes.
    fn skip(&mut self, length: u64) -> Result<(), String> {
        if length > self.left() {
            return Err(format!("a record claims {length} bytes where {} are left", self.left()));
        }
        match self {
            Source::Plain(reader, left) => {
                *left -= length;
                let step = i64::try_from(length).map_err(|_| "a record claims too much".to_string())?;
                reader.seek_relative(step).map_err(|error| error.to_string())
            }
            Source::Packed(reader, left) => {
                *left -= length;
                match std::io::copy(&mut reader.take(length), &mut std::io::sink()) {
                    Ok(got) if got == length => Ok(()),
                    Ok(_) => Err("the piece ends within a record".into()),
                    Err(error) => Err(format!("the piece cannot be decompressed further ({error})")),
                }
            }
        }
    }

    /// Reads a number of four bytes; `None` where the piece ends before its first.
    fn u32(&mut self) -> Result<Option<u32>, String> {
        Ok(self.array::<4>()?.map(u32::from_le_bytes))
    }

    /// The next `N` bytes; `None` where the piece ends before the first.
    fn array<const N: usize>(&mut self) -> Result<Option<[u8; N]>, String> {
        let mut bytes = [0; N];
        let mut got = 0;
        let limit = usize::try_from(self.left()).unwrap_or(usize::MAX).min(N);
        while got < limit {
            let read = match self {
                Source::Plain(reader, _) => reader.read(&mut bytes[got..limit]),
                Source::Packed(reader, _) => reader.read(&mut bytes[got..limit]),
            };
            match read {
                Ok(0) => break,
                Ok(read) => got += read,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(format!("the piece cannot be decompressed further ({error})")),
            }
        }
        match self {
            Source::Plain(_, left) | Source::Packed(_, left) => *left -= got as u64,
        }
        match got {
            0 => Ok(None),
            got if got == N => Ok(Some(bytes)),
            _ => Err("the piece ends within a record".into()),
        }
    }
}

/// One record of a piece.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Record {
    /// A message.
    Message(Envelope),
    /// What a connection is.
    Topic(Topic),
    /// The name of a type of messages (MCAP), by its number.
    Schema(u16, String),
    /// Something that is not needed.
    Other,
}

/// What a container says about a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Envelope {
    /// Which connection (channel).
    pub id: u32,
    /// When it was received, ns.
    pub received: i64,
    /// Where its record begins, in bytes of the piece; in a database, how many numbers of rows after the first.
    pub offset: u64,
    /// Bytes of the message, of which the buffer may hold fewer.
    pub length: u64,
}

/// A connection (in MCAP, a channel): who sends what under which name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    /// Its number.
    pub id: u32,
    /// Name of the topic: `/dvs/events`. Several connections can have the same.
    pub name: String,
    /// Type of its messages; in MCAP until the schema is found, empty.
    pub type_name: String,
    /// Number of the schema, in MCAP.
    pub schema: u16,
    /// How they are serialised.
    pub serial: Serial,
    /// How many messages, when the file says so.
    pub messages: Option<u64>,
}

/// Walks over the records of one piece.
pub struct Records {
    /// Added to the numbers of connections.
    first_id: u32,
    inner: Inner,
}

enum Inner {
    Stream(Stream),
    Rows(Box<Rows>),
}

/// Records one after another, as bags and MCAP files have them.
struct Stream {
    source: Source,
    container: Container,
    /// Bytes of the piece before the next record.
    at: u64,
    header: Vec<u8>,
}

impl Records {
    /// From the first record of a piece of a file, whose connections are numbered from `first_id`.
    pub fn new(container: Container, source: Source, first_id: u32) -> Records {
        Records { first_id, inner: Inner::Stream(Stream { source, container, at: 0, header: Vec::new() }) }
    }

    /// From the first row of a piece.
    pub fn of_rows(rows: Rows, first_id: u32) -> Records {
        Records { first_id, inner: Inner::Rows(Box::new(rows)) }
    }

    /// Bytes (of a database: rows) of the piece before the next record.
    pub fn at(&self) -> u64 {
        match &self.inner {
            Inner::Stream(stream) => stream.at,
            Inner::Rows(rows) => rows.at(),
        }
    }

    /// Goes over bytes or rows up to a record that stands at `offset`.
    pub fn forward(&mut self, offset: u64) -> Result<(), String> {
        let step = offset.checked_sub(self.at()).ok_or("the record has been passed")?;
        match &mut self.inner {
            Inner::Stream(stream) => {
                stream.source.skip(step)?;
                stream.at = offset;
            }
            Inner::Rows(rows) => rows.forward(offset),
        }
        Ok(())
    }

    /// The next record; `None` at the end of the piece. `body` is replaced by the first `most` bytes of a message whose connection is `wanted`, and
    /// emptied for any other record.
    pub fn next(&mut self, wanted: &dyn Fn(u32) -> bool, most: u64, body: &mut Vec<u8>) -> Result<Option<Record>, String> {
        body.clear();
        let first = self.first_id;
        let wanted = |id: u32| wanted(id.wrapping_add(first));
        let record = match &mut self.inner {
            Inner::Rows(rows) => rows.next(&wanted, most, body)?,
            Inner::Stream(stream) if stream.container == Container::Bag => stream.next_of_bag(&wanted, most, body)?,
            Inner::Stream(stream) => stream.next_of_mcap(&wanted, most, body)?,
        };
        Ok(record.map(|record| match record {
            Record::Message(envelope) => Record::Message(Envelope { id: envelope.id.wrapping_add(first), ..envelope }),
            Record::Topic(topic) => Record::Topic(Topic { id: topic.id.wrapping_add(first), ..topic }),
            other => other,
        }))
    }
}

impl Stream {
    fn next_of_bag(&mut self, wanted: &dyn Fn(u32) -> bool, most: u64, body: &mut Vec<u8>) -> Result<Option<Record>, String> {
        let Some(header_length) = self.source.u32()? else { return Ok(None) };
        if header_length > MOST_HEADER {
            return Err(format!("what should be the header of a record claims {header_length} bytes"));
        }
        let mut header = std::mem::take(&mut self.header);
        self.source.take(u64::from(header_length), &mut header)?;
        let length = u64::from(self.source.u32()?.ok_or("the piece ends within a record")?);
        let head = bag::message_head(&header);
        let op = bag::op(&header);
        let offset = self.at;
        self.at += 8 + u64::from(header_length) + length;
        let record = match (op, head) {
            (Some(bag::MESSAGE), Some((id, received))) => {
                self.body(wanted(id), length, most, body)?;
                Record::Message(Envelope { id, received, offset, length })
            }
            (Some(bag::CONNECTION), _) if length <= MOST_DEFINITION => {
                self.source.take(length, body)?;
                let topic = bag::topic(&header, body);
                body.clear();
                Record::Topic(topic.ok_or("a connection has no number or no topic")?)
            }
            (Some(bag::MESSAGE), None) => return Err("a message has no connection or no time".into()),
            (Some(_), _) => {
                self.source.skip(length)?;
                Record::Other
            }
            (None, _) => return Err("the header of a record has no `op`".into()),
        };
        self.header = header;
        Ok(Some(record))
    }

    fn next_of_mcap(&mut self, wanted: &dyn Fn(u32) -> bool, most: u64, body: &mut Vec<u8>) -> Result<Option<Record>, String> {
        let Some([op]) = self.source.array::<1>()? else { return Ok(None) };
        let length = u64::from_le_bytes(self.source.array::<8>()?.ok_or("the piece ends within a record")?);
        if op == 0 {
            return Err("a record has the opcode 0".into());
        }
        let offset = self.at;
        self.at = self.at.saturating_add(9).saturating_add(length);
        Ok(Some(match op {
            mcap::MESSAGE => {
                let length = length.checked_sub(mcap::MESSAGE_HEAD as u64).ok_or("a message is shorter than its own head")?;
                let head = self.source.array::<{ mcap::MESSAGE_HEAD }>()?.ok_or("the piece ends within a record")?;
                let (id, received) = mcap::message_head(&head);
                self.body(wanted(id), length, most, body)?;
                Record::Message(Envelope { id, received, offset, length })
            }
            mcap::SCHEMA | mcap::CHANNEL if length <= MOST_DEFINITION => {
                self.source.take(length, body)?;
                let record = if op == mcap::SCHEMA { mcap::schema(body) } else { mcap::channel(body).map(Record::Topic) };
                body.clear();
                record.ok_or("a definition of a topic ends early")?
            }
            _ => {
                self.source.skip(length)?;
                Record::Other
            }
        }))
    }

    /// Reads the body of a message, or goes over it.
    fn body(&mut self, wanted: bool, length: u64, most: u64, body: &mut Vec<u8>) -> Result<(), String> {
        if !wanted {
            return self.source.skip(length);
        }
        let kept = length.min(most);
        if kept > MOST_MESSAGE {
            return Err(format!("a message claims {length} bytes; {MOST_MESSAGE} at most are read"));
        }
        if length > self.source.left() {
            return Err(format!("a message claims {length} bytes where {} are left", self.source.left()));
        }
        self.source.take(kept, body)?;
        self.source.skip(length - kept)
    }
}
