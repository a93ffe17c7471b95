//! The records inside one piece of a recording: a compressed chunk, a run of records that stand in the file
//! as they are, or rows of a database.
//!
//! A piece is decompressed as it is read, and one message is held at a time: what a piece claims to need is
//! never taken. Anything that is wrong ends the piece with a reason; the pieces after it can still be read.

use super::bag;
use super::mcap;
use super::piece::{Container, Envelope, MOST_MESSAGE, Record, Source, Topic};
use super::sqlite::Rows;

/// What stands before the data of a bag's record is short text.
const MOST_HEADER: u32 = 1 << 16;
/// Definitions of topics are text; those of other types can be long.
const MOST_DEFINITION: u64 = 16 << 20;
/// Walks over the records of one piece.
pub(crate) struct Records {
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
    pub(crate) fn new(container: Container, source: Source, first_id: u32) -> Records {
        Records { first_id, inner: Inner::Stream(Stream { source, container, at: 0, header: Vec::new() }) }
    }

    /// From the first row of a piece.
    pub(crate) fn of_rows(rows: Rows, first_id: u32) -> Records {
        Records { first_id, inner: Inner::Rows(Box::new(rows)) }
    }

    /// Bytes (of a database: rows) of the piece before the next record.
    pub(crate) fn at(&self) -> u64 {
        match &self.inner {
            Inner::Stream(stream) => stream.at,
            Inner::Rows(rows) => rows.at(),
        }
    }

    /// Goes over bytes or rows up to a record that stands at `offset`.
    pub(crate) fn forward(&mut self, offset: u64) -> Result<(), String> {
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

    /// The next record; `None` at the end of the piece. `body` is replaced by the first `most` bytes of a
    /// message whose connection is `wanted`, and emptied for any other record.
    pub(crate) fn next(
        &mut self,
        wanted: &dyn Fn(u32) -> bool,
        most: u64,
        body: &mut Vec<u8>,
    ) -> Result<Option<Record>, String> {
        body.clear();
        let first = self.first_id;
        let wanted = |id: u32| wanted(id.wrapping_add(first));
        let record = match &mut self.inner {
            Inner::Rows(rows) => rows.next(&wanted, most, body)?,
            Inner::Stream(stream) if stream.container == Container::Bag => {
                stream.next_of_bag(&wanted, most, body)?
            }
            Inner::Stream(stream) => stream.next_of_mcap(&wanted, most, body)?,
        };
        Ok(record.map(|record| match record {
            Record::Message(envelope) => {
                Record::Message(Envelope { id: envelope.id.wrapping_add(first), ..envelope })
            }
            Record::Topic(topic) => Record::Topic(Topic { id: topic.id.wrapping_add(first), ..topic }),
            other => other,
        }))
    }
}

impl Stream {
    fn next_of_bag(
        &mut self,
        wanted: &dyn Fn(u32) -> bool,
        most: u64,
        body: &mut Vec<u8>,
    ) -> Result<Option<Record>, String> {
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

    fn next_of_mcap(
        &mut self,
        wanted: &dyn Fn(u32) -> bool,
        most: u64,
        body: &mut Vec<u8>,
    ) -> Result<Option<Record>, String> {
        let Some([op]) = self.source.array::<1>()? else { return Ok(None) };
        let length = u64::from_le_bytes(self.source.array::<8>()?.ok_or("the piece ends within a record")?);
        if op == 0 {
            return Err("a record has the opcode 0".into());
        }
        let offset = self.at;
        self.at = self.at.saturating_add(9).saturating_add(length);
        Ok(Some(match op {
            mcap::MESSAGE => {
                let length = length
                    .checked_sub(mcap::MESSAGE_HEAD as u64)
                    .ok_or("a message is shorter than its own head")?;
                let head =
                    self.source.array::<{ mcap::MESSAGE_HEAD }>()?.ok_or("the piece ends within a record")?;
                let (id, received) = mcap::message_head(&head);
                self.body(wanted(id), length, most, body)?;
                Record::Message(Envelope { id, received, offset, length })
            }
            mcap::SCHEMA | mcap::CHANNEL if length <= MOST_DEFINITION => {
                self.source.take(length, body)?;
                let record = if op == mcap::SCHEMA {
                    mcap::schema(body)
                } else {
                    mcap::channel(body).map(Record::Topic)
                };
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
