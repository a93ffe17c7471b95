//! What a piece of a recording is read as: bytes, records, messages, connections.

use super::messages::Serial;
use super::wire::label;
use std::fs::File;
use std::io::{BufReader, Read};

/// Which container a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Container {
    /// ROS 1 bag, version 2.0.
    Bag,
    /// MCAP.
    Mcap,
    /// SQLite database of rosbag2.
    Sqlite,
}

/// One message longer than this is left out: no camera sends it, and it is held whole.
pub(crate) const MOST_MESSAGE: u64 = 256 << 20;
/// A compressed chunk that claims more than this is left out: it would be a day's work for a few bytes.
const MOST_CHUNK: u64 = 1 << 30;
/// What is read from a file at a time.
const FILE_BUFFER: usize = 1 << 16;

/// The bytes of a piece, decompressed.
pub(crate) enum Source {
    /// They stand in the file so; these many are left.
    Plain(BufReader<File>, u64),
    /// They come out of a decompressor; it gives these many at most.
    Packed(Box<dyn Read + Send>, u64),
}

impl Source {
    /// Bytes of a file from where it stands, as they are.
    pub(crate) fn plain(file: File, length: u64) -> Source {
        Source::Plain(BufReader::with_capacity(FILE_BUFFER, file), length)
    }

    /// `length` compressed bytes of a file from where it stands, which give `claimed` bytes. The compression
    /// by its name in bags and MCAP.
    ///
    /// # Errors
    /// When the compression is unknown, or claims too much.
    pub(crate) fn packed(
        file: File,
        length: u64,
        compression: &[u8],
        claimed: u64,
    ) -> Result<Source, String> {
        if matches!(compression, b"" | b"none") {
            return Ok(Source::plain(file, length));
        }
        if claimed > MOST_CHUNK {
            return Err(format!(
                "the chunk claims {claimed} bytes uncompressed; {MOST_CHUNK} at most are read"
            ));
        }
        let bytes = BufReader::with_capacity(FILE_BUFFER, file).take(length);
        let reader: Box<dyn Read + Send> = match compression {
            b"bz2" => Box::new(bzip2::bufread::BzDecoder::new(bytes)),
            b"lz4" => Box::new(lz4_flex::frame::FrameDecoder::new(bytes)),
            b"zstd" => {
                let mut decoder =
                    zstd::stream::read::Decoder::with_buffer(bytes).map_err(|error| error.to_string())?;
                // The window that a frame asks for is allocated at once; recorders ask for 8 MiB at most.
                decoder.window_log_max(25).map_err(|error| error.to_string())?;
                Box::new(decoder)
            }
            other => {
                return Err(format!(
                    "the chunk is compressed by `{}`, which is not read (none, bz2, lz4 and zstd are)",
                    label(other)
                ));
            }
        };
        Ok(Source::Packed(reader, claimed))
    }

    pub(super) fn left(&self) -> u64 {
        match self {
            Source::Plain(_, left) | Source::Packed(_, left) => *left,
        }
    }

    /// Replaces `bytes` by the next `length`; grows with what comes, not with what is claimed.
    pub(super) fn take(&mut self, length: u64, bytes: &mut Vec<u8>) -> Result<(), String> {
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
    pub(super) fn skip(&mut self, length: u64) -> Result<(), String> {
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
    pub(super) fn u32(&mut self) -> Result<Option<u32>, String> {
        Ok(self.array::<4>()?.map(u32::from_le_bytes))
    }

    /// The next `N` bytes; `None` where the piece ends before the first.
    pub(super) fn array<const N: usize>(&mut self) -> Result<Option<[u8; N]>, String> {
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
pub(crate) enum Record {
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
pub(crate) struct Envelope {
    /// Which connection (channel).
    pub id: u32,
    /// When it was received, ns.
    pub received: i64,
    /// Where its record begins, in bytes of the piece; in a database, how many numbers of rows after the
    /// first.
    pub offset: u64,
    /// Bytes of the message, of which the buffer may hold fewer.
    pub length: u64,
}

/// A connection (in MCAP, a channel): who sends what under which name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Topic {
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
