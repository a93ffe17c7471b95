//! An opened RAW or DAT file: a cursor that decodes piece by piece, and a sparse index for jumps in time.
//!
//! The index has the state of the decoder every few megabytes, and the latest stamp before it. It grows on
//! the way, whoever reads; a jump beyond it decodes from its end. All cursors of a recording share it.

use super::decoder::Decoder;
use super::faults::Faults;
use super::header::{self, Header};
use crate::bias;
use crate::chunk::{EventChunk, Trigger};
use crate::error::{Cause, FormatError, Loss};
use crate::losses::Losses;
use crate::recording::{EventCursor, EventsAbout, Recording};
use photocurrent_core::Extent;
use std::fs::File;
use std::io::{ErrorKind, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Bytes decoded at a time: 16,000 to 50,000 events, in a second-level cache with their columns.
const PIECE: usize = 1 << 17;
/// Bytes from one entry of the index to the next.
const STRIDE: u64 = 1 << 22;
/// Bytes from which the layout of a DAT file is found.
pub(super) const LOOK: usize = 1 << 15;

/// Reads at most so many bytes from a place of a file.
pub(super) fn read_at(path: &Path, at: u64, most: usize) -> Result<Vec<u8>, FormatError> {
    let io = |error: std::io::Error| FormatError::io(path, &error);
    let mut file = File::open(path).map_err(io)?;
    file.seek(SeekFrom::Start(at)).map_err(io)?;
    let mut bytes = Vec::new();
    file.take(most as u64).read_to_end(&mut bytes).map_err(io)?;
    Ok(bytes)
}

/// The header of a file, and the file's size.
pub(super) fn read_header(path: &Path) -> Result<(Header, u64), FormatError> {
    let head = read_at(path, 0, header::LONGEST)?;
    let bytes = std::fs::metadata(path).map_err(|error| FormatError::io(path, &error))?.len();
    let Some(header) = Header::parse(&head) else {
        return Err(FormatError::new(
            path,
            "no header of `% key value` lines",
            "name a RAW or DAT file as the camera's software wrote it",
        )
        .at("byte 0"));
    };
    Ok((header, bytes))
}

/// What is known at a place of the file.
#[derive(Clone)]
struct Mark<D> {
    /// Byte, at a word's begin.
    at: u64,
    decoder: D,
    /// The latest stamp of the events before.
    latest: i64,
}

/// An opened file.
struct Raw<D> {
    path: PathBuf,
    data_at: u64,
    about: EventsAbout,
    extent: Option<Extent>,
    facts: Vec<(String, String)>,
    index: Arc<Mutex<Vec<Mark<D>>>>,
}

/// So many bytes hold a time word in every sound file: sensors write one every few microseconds.
const BEGINNING: u64 = 1 << 20;

/// What is known of the events without the decoder.
pub(super) struct About {
    pub encoding: String,
    pub stamps: String,
    pub extent: Option<Extent>,
    pub notes: Vec<String>,
    /// Is every word an event, so that the number of events follows from the size of the file?
    pub is_counted: bool,
}

/// Opens a file whose header is read.
pub(super) fn open<D: Decoder>(
    path: &Path,
    header: &Header,
    bytes: u64,
    known: About,
    decoder: D,
) -> Box<dyn Recording> {
    let data_at = header.data_at as u64;
    let count = known.is_counted.then(|| bytes.saturating_sub(data_at) / D::WORD as u64);
    let extent = known.extent;
    let mut notes = known.notes;
    // A recording that was begun in midstream begins so: nothing is damaged.
    let early = before_time(path, data_at, decoder.clone()).early;
    if early > 0 {
        notes.push(format!(
            "{early} events or trigger edges stand before the first time word and have no \
                            time; they are left out"
        ));
    }
    let about = EventsAbout { extent, tick_ns: 1000, count, has_t_in: false, stamps: known.stamps, notes };
    let mut facts = vec![("encoding".to_owned(), known.encoding)];
    facts.extend(header.facts());
    facts.extend(bias::next_to(path));
    let start = Mark { at: data_at, decoder, latest: i64::MIN };
    Box::new(Raw {
        path: path.into(),
        data_at,
        about,
        extent,
        facts,
        index: Arc::new(Mutex::new(vec![start])),
    })
}

/// What the beginning of the words lacks; nothing when it cannot be read, which the cursor reports.
fn before_time<D: Decoder>(path: &Path, data_at: u64, mut decoder: D) -> Faults {
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|mut file| {
        file.seek(SeekFrom::Start(data_at)).and_then(|_| file.take(BEGINNING).read_to_end(&mut bytes))
    });
    if read.is_ok() {
        decoder.decode(&bytes, &mut EventChunk::default(), &mut Vec::new());
    }
    *decoder.faults()
}

impl<D: Decoder> Raw<D> {
    fn cursor(&self) -> Result<Cursor<D>, FormatError> {
        let file = File::open(&self.path).map_err(|error| FormatError::io(&self.path, &error))?;
        let bytes = file.metadata().map_err(|error| FormatError::io(&self.path, &error))?.len();
        let start = lock(&self.index)[0].clone();
        let mut cursor = Cursor {
            path: self.path.clone(),
            file,
            bytes,
            data_at: self.data_at,
            mark: start,
            known: Faults::default(),
            piece: Vec::new(),
            triggers: Vec::new(),
            losses: Losses::default(),
            extent: self.extent,
            index: self.index.clone(),
        };
        cursor.go_to_mark()?;
        Ok(cursor)
    }
}

impl<D: Decoder> Recording for Raw<D> {
    fn events_about(&self) -> Option<&EventsAbout> {
        Some(&self.about)
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        Ok(Box::new(self.cursor()?))
    }

    fn triggers(&self) -> Result<Vec<Trigger>, FormatError> {
        let mut cursor = self.cursor()?;
        let mut all = Vec::new();
        let mut chunk = EventChunk::default();
        while cursor.next(&mut chunk)? {
            all.append(&mut cursor.triggers);
        }
        Ok(all)
    }

    fn facts(&self) -> Vec<(String, String)> {
        self.facts.clone()
    }

    fn files(&self) -> Vec<PathBuf> {
        vec![self.path.clone()]
    }
}

/// The index is only ever added to: what a panicking thread left is whole.
fn lock<D>(index: &Mutex<Vec<Mark<D>>>) -> std::sync::MutexGuard<'_, Vec<Mark<D>>> {
    index.lock().unwrap_or_else(PoisonError::into_inner)
}

struct Cursor<D> {
    path: PathBuf,
    file: File,
    bytes: u64,
    data_at: u64,
    /// Where it stands.
    mark: Mark<D>,
    /// Faults of the decoder that have been reported, or belong to what was not read.
    known: Faults,
    piece: Vec<u8>,
    /// Edges of the last piece.
    triggers: Vec<Trigger>,
    losses: Losses,
    extent: Option<Extent>,
    index: Arc<Mutex<Vec<Mark<D>>>>,
}

impl<D: Decoder> Cursor<D> {
    /// Takes up reading at its mark.
    fn go_to_mark(&mut self) -> Result<(), FormatError> {
        self.known = *self.mark.decoder.faults();
        self.file.seek(SeekFrom::Start(self.mark.at)).map_err(|error| FormatError::io(&self.path, &error))?;
        Ok(())
    }

    /// Reads a piece; only at the end of the file is it smaller than [`PIECE`].
    fn fill(&mut self) -> Result<usize, FormatError> {
        self.piece.resize(PIECE, 0);
        let mut read = 0;
        while read < PIECE {
            match self.file.read(&mut self.piece[read..]) {
                Ok(0) => break,
                Ok(n) => read += n,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(FormatError::io(&self.path, &error)),
            }
        }
        Ok(read)
    }

    /// Writes its mark into the index, if it stands a stride beyond the last one.
    fn note(&self) {
        let mut index = lock(&self.index);
        if index.last().is_some_and(|last| self.mark.at >= last.at.saturating_add(STRIDE)) {
            index.push(self.mark.clone());
        }
    }

    /// Reports what the decoder left out in the piece before the mark. Events before any time are no damage:
    /// a note counts them.
    fn report_faults(&mut self, begin: u64) {
        let now = *self.mark.decoder.faults();
        let known = std::mem::replace(&mut self.known, now);
        if now == known {
            return;
        }
        let at = || format!("bytes {begin} to {}", self.mark.at);
        let outside = now.outside.saturating_sub(known.outside);
        let array =
            self.extent.map_or("what the format can have".into(), |extent| format!("{extent} pixels"));
        let what = || format!("{outside} events lie outside {array}, or have no row; they are left out");
        self.losses.add_by(
            Cause::Outside,
            "events outside the pixel array, or without a row, were left out",
            outside,
            at,
            what,
        );
        let unknown = now.unknown.saturating_sub(known.unknown);
        self.losses.add_items("words of no known kind were left out", unknown, at, || {
            format!("{unknown} words are of no known kind; they are left out")
        });
        let strays = now.strays.saturating_sub(known.strays);
        let what = || {
            format!(
                "{strays} time words leap away and the next one back; they are undone, events \
                               between have a wrong stamp"
            )
        };
        self.losses.add_items("time words that leap away and back were undone", strays, at, what);
    }
}

impl<D: Decoder> EventCursor for Cursor<D> {
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        chunk.clear();
        chunk.t_in = None;
        self.triggers.clear();
        let read = self.fill()?;
        let used = self.mark.decoder.decode(&self.piece[..read], chunk, &mut self.triggers);
        let begin = self.mark.at;
        self.mark.at += used as u64;
        self.mark.latest = chunk.t.iter().copied().fold(self.mark.latest, i64::max);
        self.report_faults(begin);
        let left = read - used;
        if left > 0 {
            // Only the end of the file is no whole word. Some programs end a file with a line feed.
            if self.piece[used..read] != *b"\n" {
                let what = || {
                    format!(
                        "the file ends within a word of {} bytes: it is cut off, and what \
                                       came after it is lost",
                        D::WORD
                    )
                };
                self.losses.add_by(
                    Cause::Cut,
                    "words that are cut off",
                    1,
                    || format!("bytes {} to {}", self.mark.at, self.mark.at + left as u64),
                    what,
                );
            }
            self.file.seek(SeekFrom::End(0)).map_err(|error| FormatError::io(&self.path, &error))?;
        }
        if used > 0 {
            self.note();
        }
        Ok(used > 0)
    }

    fn seek(&mut self, t_ns: i64) -> Result<(), FormatError> {
        let best = |index: &[Mark<D>]| {
            let behind = index.partition_point(|mark| mark.latest < t_ns);
            (index[behind.saturating_sub(1)].clone(), behind == index.len())
        };
        let (mark, is_last) = best(&lock(&self.index));
        self.mark = mark;
        self.go_to_mark()?;
        if !is_last {
            return Ok(());
        }
        // Beyond the index: it grows until it covers the time, or the file ends. What is left out on the way
        // is reported when it is read.
        let losses = self.losses.clone();
        let mut chunk = EventChunk::default();
        while self.mark.latest < t_ns && self.next(&mut chunk)? {}
        self.losses = losses;
        self.mark = best(&lock(&self.index)).0;
        self.go_to_mark()
    }

    fn losses(&self) -> Vec<Loss> {
        self.losses.list()
    }

    fn position(&self) -> (u64, u64) {
        (self.mark.at - self.data_at, self.bytes.saturating_sub(self.data_at))
    }
}
