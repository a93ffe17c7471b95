//! Walks over a text file of any size, one block at a time.

use super::fields::is_comment;
use super::layout::Layout;
use super::line::{self, Event};
use crate::chunk::{CHUNK_EVENTS, EventChunk};
use crate::convention::Tally;
use crate::error::{Cause, FormatError, Loss};
use crate::losses::Losses;
use crate::recording::EventCursor;
use std::fs::File;
use std::io::{ErrorKind, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Bytes that are held at a time; no line may be longer.
const BLOCK: usize = 1 << 18;

/// A cursor over the events of a text file.
pub(crate) struct TextCursor {
    path: PathBuf,
    file: File,
    layout: Arc<Layout>,
    block: Vec<u8>,
    /// The bytes of `block` that are not yet read.
    unread: std::ops::Range<usize>,
    /// Bytes of the file before the end of `block`; of the whole file.
    taken: u64,
    bytes: u64,
    /// Number of the next line, from 1.
    line: u64,
    ended: bool,
    /// Inside a line that is longer than a block.
    overlong: bool,
    losses: Losses,
}

impl TextCursor {
    /// Opens a file at its first line of data.
    pub(crate) fn open(path: &Path, layout: Arc<Layout>) -> Result<TextCursor, FormatError> {
        let io = |error: std::io::Error| FormatError::io(path, &error);
        let mut file = File::open(path).map_err(io)?;
        let bytes = file.metadata().map_err(io)?.len();
        let (start, line) = layout.start;
        file.seek(SeekFrom::Start(start)).map_err(io)?;
        Ok(TextCursor {
            path: path.into(),
            file,
            layout,
            block: vec![0; BLOCK],
            unread: 0..0,
            taken: start,
            bytes,
            line,
            ended: false,
            overlong: false,
            losses: Losses::default(),
        })
    }

    /// Moves what is unread to the front and fills the block up.
    fn refill(&mut self) -> Result<(), FormatError> {
        self.block.copy_within(self.unread.clone(), 0);
        self.unread = 0..self.unread.len();
        while self.unread.end < BLOCK {
            match self.file.read(&mut self.block[self.unread.end..]) {
                Ok(0) => {
                    self.ended = true;
                    break;
                }
                Ok(read) => {
                    self.unread.end += read;
                    self.taken += read as u64;
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(FormatError::io(&self.path, &error)),
            }
        }
        Ok(())
    }

    /// Counts what all lines hold.
    pub(crate) fn tally(mut self, tally: &mut Tally) -> Result<(), FormatError> {
        while let Some((from, to, whole)) = self.line()? {
            self.line += 1;
            let line = &self.block[from..to];
            if std::mem::take(&mut self.overlong) || is_comment(line) {
                continue;
            }
            if let Ok(stored) = line::stored(line, &self.layout)
                && whole
            {
                tally.add(stored.t, stored.x, stored.y, stored.p);
            }
        }
        Ok(())
    }

    /// The place of the next line in the block, and whether a line feed ends it; `None` at the end of the
    /// file.
    #[inline]
    fn line(&mut self) -> Result<Option<(usize, usize, bool)>, FormatError> {
        loop {
            let (from, to) = (self.unread.start, self.unread.end);
            match memchr::memchr(b'\n', &self.block[from..to]) {
                Some(length) => {
                    self.unread.start = from + length + 1;
                    return Ok(Some((from, from + length, true)));
                }
                None if self.ended => {
                    self.unread = to..to;
                    return Ok((from < to).then_some((from, to, false)));
                }
                None if to - from == BLOCK => {
                    if !self.overlong {
                        let number = self.line;
                        let what = || format!("the line is longer than {BLOCK} bytes and was left out");
                        self.losses.add(
                            "lines of no plausible length were left out",
                            || format!("line {number}"),
                            what,
                        );
                    }
                    self.overlong = true;
                    self.unread = 0..0;
                }
                None => self.refill()?,
            }
        }
    }

    /// Reads one line, without its line feed. `whole` says that there was one.
    #[inline]
    fn take(&mut self, from: usize, to: usize, whole: bool, chunk: &mut EventChunk) {
        let number = self.line;
        self.line += 1;
        let line = &self.block[from..to];
        if std::mem::take(&mut self.overlong) || is_comment(line) {
            return;
        }
        match line::read(line, &self.layout) {
            Ok(Event { t, x, y, on, t_in }) => {
                chunk.push(t, x, y, on);
                if let Some(all) = &mut chunk.t_in {
                    all.push(t_in);
                }
            }
            Err(_) if !whole => {
                let shown = line::shown(line);
                self.losses.add_by(
                    Cause::Cut,
                    "lines that are cut off",
                    1,
                    || format!("line {number}"),
                    || format!("the file ends inside the line {shown}; its event is lost"),
                );
            }
            Err(wrong) => self.losses.add_by(
                wrong.cause(),
                wrong.kind(),
                1,
                || format!("line {number}"),
                || wrong.what(line, &self.layout),
            ),
        }
    }
}

impl EventCursor for TextCursor {
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        chunk.clear();
        match (self.layout.has_t_in, &chunk.t_in) {
            (true, None) => chunk.t_in = Some(Vec::new()),
            (false, Some(_)) => chunk.t_in = None,
            _ => {}
        }
        while chunk.len() < CHUNK_EVENTS {
            let Some((from, to, whole)) = self.line()? else { break };
            self.take(from, to, whole, chunk);
        }
        Ok(!(chunk.is_empty() && self.ended && self.unread.is_empty()))
    }

    fn seek(&mut self, _t_ns: i64) -> Result<(), FormatError> {
        // Lines need not be sorted by time, so that only the beginning is safe.
        *self = TextCursor::open(&self.path, self.layout.clone())?;
        Ok(())
    }

    fn losses(&self) -> Vec<Loss> {
        self.losses.list()
    }

    fn position(&self) -> (u64, u64) {
        (self.taken - self.unread.len() as u64, self.bytes.max(self.taken))
    }
}
