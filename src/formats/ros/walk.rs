//! Walks over the messages of some topics, through all pieces of a file, and goes to a message by its place.

use super::contents::Contents;
use super::piece::{Container, Envelope, Record};
use super::records::Records;
use super::sqlite::Rows;
use super::{bag, mcap, packed};
use crate::error::FormatError;
use crate::losses::Losses;
use std::fs::File;
use std::sync::Arc;

/// Opens a piece.
///
/// # Errors
/// When the file has gone; `Ok(Err)` says why the piece cannot be read.
pub(crate) fn open_piece(contents: &Contents, index: usize) -> Result<Result<Records, String>, FormatError> {
    let Some(piece) = contents.pieces.get(index) else { return Ok(Err("there is no such piece".into())) };
    let Some(part) = contents.parts.get(piece.file) else { return Ok(Err("there is no such file".into())) };
    let io = |error: std::io::Error| FormatError::io(&part.path, &error);
    if let Some(rows) = piece.rows {
        return Ok(
            Rows::open(&part.path, &part.database, rows).map(|rows| Records::of_rows(rows, part.first_id))
        );
    }
    let file = File::open(&part.path).map_err(io)?;
    let size = file.metadata().map_err(io)?.len();
    if piece.at > size {
        return Ok(Err("the file has become shorter since it was opened".into()));
    }
    let source = match part.container {
        Container::Bag => bag::open_piece(file, size, piece),
        Container::Mcap | Container::Sqlite => mcap::open_piece(file, size, piece),
    };
    Ok(source.map_err(io)?.map(|source| Records::new(part.container, source, part.first_id)))
}

/// A place between messages.
pub(crate) struct Walker {
    contents: Arc<Contents>,
    /// Connections whose messages are given.
    wanted: Vec<u32>,
    /// Bytes of a message that are kept.
    most: u64,
    piece: usize,
    records: Option<Records>,
    /// The message that was given last.
    pub body: Vec<u8>,
    /// What could not be read.
    pub losses: Losses,
}

impl Walker {
    /// Before the first message.
    pub(crate) fn new(contents: &Arc<Contents>, wanted: &[u32]) -> Walker {
        Walker {
            contents: contents.clone(),
            wanted: wanted.to_vec(),
            most: u64::MAX,
            piece: 0,
            records: None,
            body: Vec::new(),
            losses: Losses::default(),
        }
    }

    /// Keeps only the first bytes of every message.
    #[must_use]
    pub(crate) fn heads(mut self, most: u64) -> Walker {
        self.most = most;
        self
    }

    /// The piece of the message that was given last.
    pub(crate) fn piece(&self) -> usize {
        self.piece
    }

    /// Goes to the start of a piece.
    pub(crate) fn go_to(&mut self, piece: usize) {
        self.piece = piece;
        self.records = None;
    }

    /// Where the walker stands, in bytes of the file, to a piece.
    pub(crate) fn position(&self) -> u64 {
        let before = |file: usize| self.contents.parts.get(file).map_or(0, |part| part.before);
        self.contents
            .pieces
            .get(self.piece)
            .map_or(self.contents.size, |piece| before(piece.file).saturating_add(piece.at))
    }

    /// The next message; its bytes are in `body`.
    ///
    /// # Errors
    /// When the file has gone.
    pub(crate) fn advance(&mut self) -> Result<Option<Envelope>, FormatError> {
        let contents = self.contents.clone();
        while let Some(piece) = contents.pieces.get(self.piece) {
            if self.records.is_none() {
                let has = |id: &u32| {
                    piece.counts.as_ref().is_none_or(|counts| counts.iter().any(|(known, _)| known == id))
                };
                if !self.wanted.iter().any(has) {
                    self.piece += 1;
                    continue;
                }
                match open_piece(&self.contents, self.piece)? {
                    Ok(records) => self.records = Some(records),
                    Err(what) => self.lose(&what, None),
                }
            }
            let Some(records) = &mut self.records else { continue };
            let at = records.at();
            let wanted = &self.wanted;
            match records.next(&|id| wanted.contains(&id), self.most, &mut self.body) {
                Ok(Some(Record::Message(envelope))) if self.wanted.contains(&envelope.id) => {
                    match packed::unpack(envelope, self.most, &mut self.body) {
                        Ok(envelope) => return Ok(Some(envelope)),
                        Err(what) => {
                            let at = || format!("message received at {} ns", envelope.received);
                            self.losses.add("messages that cannot be decompressed", at, || {
                                format!("{what}; it is left out")
                            });
                        }
                    }
                }
                Ok(Some(_)) => {}
                Ok(None) => {
                    self.piece += 1;
                    self.records = None;
                }
                Err(what) => self.lose(&what, Some(at)),
            }
        }
        Ok(None)
    }

    /// Goes to the message at a place that [`Walker::advance`] gave, and reads it.
    ///
    /// # Errors
    /// When the file has gone; `Ok(Err)` says why the message cannot be read any more.
    pub(crate) fn fetch(
        &mut self,
        piece: usize,
        offset: u64,
    ) -> Result<Result<Envelope, String>, FormatError> {
        if self.piece != piece || self.records.as_ref().is_none_or(|records| records.at() > offset) {
            self.piece = piece;
            self.records = None;
            match open_piece(&self.contents, piece)? {
                Ok(records) => self.records = Some(records),
                Err(what) => return Ok(Err(what)),
            }
        }
        let Some(records) = &mut self.records else { return Ok(Err("the piece is not open".into())) };
        let got = records.forward(offset).and_then(|()| records.next(&|_| true, self.most, &mut self.body));
        match got {
            Ok(Some(Record::Message(envelope))) => Ok(packed::unpack(envelope, self.most, &mut self.body)),
            Ok(_) => {
                self.records = None;
                Ok(Err("there is no message any more where one was".into()))
            }
            Err(what) => {
                self.records = None;
                Ok(Err(what))
            }
        }
    }

    /// Notes that the rest of this piece cannot be read, and goes to the next.
    fn lose(&mut self, what: &str, within: Option<u64>) {
        let place = self.contents.place(self.piece);
        let of_rows = self.contents.pieces.get(self.piece).is_some_and(|piece| piece.rows.is_some());
        let within =
            within
                .map(|at| {
                    if of_rows { format!(", {at} rows on") } else { format!(", {at} bytes into its content") }
                })
                .unwrap_or_default();
        let what = format!(
            "{what}; the messages that follow in {} are lost",
            if of_rows { "these rows" } else { "this chunk" }
        );
        self.losses.add("chunks that are damaged", || format!("{place}{within}"), || what);
        self.piece += 1;
        self.records = None;
    }
}
