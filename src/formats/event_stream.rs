//! Event Stream 2 (`.es`): recordings of the International Centre for Neuromorphic Systems and its tools
//! (`sepia`, `faery`).
//!
//! Fifteen bytes of head (`Event Stream`, version), a byte for the kind of events, width and height (u16),
//! then events with times as steps from one to the next, in microseconds. All little-endian.
//!
//! - DVS: a byte 0xff adds 127 us, 0xfe does nothing; any other byte is (step << 1 | polarity), then column
//!   and row, two bytes each.
//! - ATIS: a byte of 0xfc to 0xff adds 63 us times its lowest two bits; any other is (step << 2 | polarity <<
//!   1 | exposure), then column and row. Events with the bit of exposure are measurements of light, no
//!   changes of it: they are left out.
//!
//! Rows count from below in the file; given are rows from above, as `faery` does. Source: the README of
//! neuromorphicsystems/event_stream.
//!
//! A stated `extent` stands in for that of the file: rows count from its last.
//!
//! Limits: the file begins at time 0 and has no index, so that a search for a time goes back to the first
//! event. Steps have no mark to find after a damaged byte: an event outside of the pixels ends what can be
//! read, because all that follows would be made up. Generic and colour events have no polarity and are
//! refused.

use crate::chunk::{CHUNK_EVENTS, EventChunk};
use crate::declared::Declared;
use crate::error::{FormatError, Loss};
use crate::format::{Format, Probe};
use crate::losses::Losses;
use crate::recording::{EventCursor, EventsAbout, Recording};
use photocurrent_core::Extent;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Event Stream 2.
pub(crate) static FORMAT: Format =
    Format { id: "event_stream", name: "Event Stream (.es)", recognises, open };

const MAGIC: &[u8; 12] = b"Event Stream";

/// Bytes before the first event.
const HEAD: u64 = 20;

fn recognises(probe: &Probe) -> bool {
    probe.head.starts_with(MAGIC)
}

fn open(path: &Path, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    Ok(Box::new(EventStream::open(path, declared.extent)?))
}

/// What the events are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Dvs,
    Atis,
}

/// An opened file.
struct EventStream {
    path: PathBuf,
    size: u64,
    kind: Kind,
    version: String,
    about: EventsAbout,
    extent: Extent,
}

impl EventStream {
    fn open(path: &Path, stated: Option<Extent>) -> Result<EventStream, FormatError> {
        let io = |error: std::io::Error| FormatError::io(path, &error);
        let file = File::open(path).map_err(io)?;
        let size = file.metadata().map_err(io)?.len();
        let mut head = Vec::new();
        file.take(HEAD).read_to_end(&mut head).map_err(io)?;
        let refuse = |at: &str, found: String, expected: &str, hint: &str| {
            FormatError::new(path, found, hint).at(at).expected(expected)
        };
        if !head.starts_with(MAGIC) {
            return Err(refuse(
                "byte 0",
                "the file does not begin as Event Stream files do".into(),
                "`Event Stream`",
                "let the program find the format by itself",
            ));
        }
        let cut = || {
            FormatError::new(
                path,
                format!("the file ends at byte {size}, inside its header; no event can be read"),
                "copy it again",
            )
        };
        let (version, kind) = match head.get(12..16) {
            Some([major, minor, patch, kind]) => ((*major, format!("{major}.{minor}.{patch}")), *kind),
            _ => return Err(cut()),
        };
        if version.0 != 2 {
            return Err(refuse(
                "byte 12",
                format!("version {} of Event Stream", version.1),
                "version 2",
                "convert it with the event_stream tools",
            ));
        }
        let kind = kind_of(path, kind)?;
        let [.., w0, w1, h0, h1] = *head.first_chunk::<20>().ok_or_else(cut)?;
        let recorded = Extent {
            width: u16::from_le_bytes([w0, w1]).into(),
            height: u16::from_le_bytes([h0, h1]).into(),
        };
        // Coordinates have 16 bits.
        let sides = 1..=1 << 16;
        let extent = stated
            .filter(|stated| sides.contains(&stated.width) && sides.contains(&stated.height))
            .unwrap_or(recorded);
        if extent.width == 0 || extent.height == 0 {
            let hint = "state its `extent`, such as 640 x 480; or copy the file again: its header is damaged";
            return Err(refuse("byte 16", format!("an extent of {extent}"), "at least one pixel", hint)
                .undeclared("extent"));
        }
        let mut notes = vec!["rows counted from above; the file has them from below".to_owned()];
        if extent != recorded {
            notes.push(format!("the extent is declared as {extent}; the file states {recorded}"));
        }
        if kind == Kind::Atis {
            notes.push(
                "events that measure the exposure of a pixel (threshold crossings of an ATIS) are left out"
                    .into(),
            );
        }
        let about = EventsAbout {
            extent: Some(extent),
            tick_ns: 1000,
            count: None,
            has_t_in: false,
            stamps: "steps of whole microseconds".into(),
            notes,
        };
        Ok(EventStream { path: path.into(), size, kind, version: version.1, about, extent })
    }
}

/// The kind of events by its number in the header.
fn kind_of(path: &Path, number: u8) -> Result<Kind, FormatError> {
    match number {
        1 => Ok(Kind::Dvs),
        2 => Ok(Kind::Atis),
        other => {
            let name = match other {
                0 => "generic events".into(),
                3 => "AMD events".into(),
                4 => "colour events".into(),
                _ => format!("events of kind {other}"),
            };
            let found = format!("{name}, which have no polarity");
            Err(FormatError::new(path, found, "export it as DVS events")
                .at("byte 15")
                .expected("DVS or ATIS events (1 or 2)"))
        }
    }
}

/// A walk through the bytes.
struct Cursor {
    path: PathBuf,
    file: File,
    kind: Kind,
    extent: Extent,
    size: u64,
    /// Where in the file the first byte that has not been used stands.
    at: u64,
    time_us: i64,
    /// Bytes that have been read; those before `used` have been used.
    bytes: Vec<u8>,
    used: usize,
    losses: Losses,
}

/// Why a piece came to its end.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stop {
    /// The chunk is full, or the bytes at hand are used.
    Piece,
    /// An event outside the pixels.
    Outside(u16, u16),
}

impl Cursor {
    /// Reads on behind the bytes that have not been used.
    fn fill(&mut self) -> Result<usize, FormatError> {
        self.bytes.drain(..self.used);
        self.used = 0;
        let have = self.bytes.len() as u64;
        let wanted = (self.size - (self.at + have).min(self.size)).min(1 << 18);
        let count = self
            .file
            .by_ref()
            .take(wanted)
            .read_to_end(&mut self.bytes)
            .map_err(|error| FormatError::io(&self.path, &error))?;
        Ok(count)
    }

    /// Decodes the bytes at hand.
    fn decode(&mut self, chunk: &mut EventChunk) -> Stop {
        let bytes = &self.bytes[self.used..];
        let (mut k, mut t) = (0, self.time_us);
        let (width, height) = (self.extent.width, self.extent.height);
        let mut stop = Stop::Piece;
        while let Some(&first) = bytes.get(k) {
            let (step, on, skip) = match self.kind {
                Kind::Dvs if first >= 0xfe => {
                    t += if first == 0xff { 127 } else { 0 };
                    k += 1;
                    continue;
                }
                Kind::Atis if first >= 0xfc => {
                    t += 63 * i64::from(first & 3);
                    k += 1;
                    continue;
                }
                Kind::Dvs => (first >> 1, first & 1 == 1, false),
                Kind::Atis => (first >> 2, first & 2 == 2, first & 1 == 1),
            };
            let Some(&[x0, x1, y0, y1]) = bytes.get(k + 1..).and_then(|rest| rest.first_chunk::<4>()) else {
                break;
            };
            if chunk.len() >= CHUNK_EVENTS {
                break;
            }
            let (x, y) = (u16::from_le_bytes([x0, x1]), u16::from_le_bytes([y0, y1]));
            if u32::from(x) >= width || u32::from(y) >= height {
                stop = Stop::Outside(x, y);
                break;
            }
            k += 5;
            t += i64::from(step);
            if !skip {
                // Below the height, which is 65,536 at most.
                chunk.push(t * 1000, x, (height - 1) as u16 - y, on);
            }
        }
        self.used += k;
        self.at += k as u64;
        self.time_us = t;
        stop
    }

    /// Gives up on the rest of the file.
    fn end(&mut self, what: String) {
        self.losses.add("pieces that are damaged", || format!("bytes {} to {}", self.at, self.size), || what);
        self.at = self.size;
        self.bytes.clear();
        self.used = 0;
    }
}

impl EventCursor for Cursor {
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        chunk.clear();
        chunk.t_in = None;
        while chunk.len() < CHUNK_EVENTS && self.at < self.size {
            match self.decode(chunk) {
                Stop::Outside(x, y) => {
                    let what = format!(
                        "an event at ({x}, {y}) lies outside the {} pixels: a byte is damaged, and \
                                 nothing behind it can be trusted",
                        self.extent
                    );
                    self.end(what);
                }
                Stop::Piece if chunk.len() >= CHUNK_EVENTS || self.at >= self.size => {}
                Stop::Piece => {
                    if self.fill()? == 0 {
                        self.end("the last event is cut off and left out".into());
                    }
                }
            }
        }
        Ok(!chunk.is_empty())
    }

    fn seek(&mut self, _: i64) -> Result<(), FormatError> {
        self.file.seek(SeekFrom::Start(HEAD)).map_err(|error| FormatError::io(&self.path, &error))?;
        (self.at, self.time_us, self.used) = (HEAD, 0, 0);
        self.bytes.clear();
        Ok(())
    }

    fn losses(&self) -> Vec<Loss> {
        self.losses.list()
    }

    fn position(&self) -> (u64, u64) {
        (self.at, self.size)
    }
}

impl Recording for EventStream {
    fn events_about(&self) -> Option<&EventsAbout> {
        Some(&self.about)
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        let file = File::open(&self.path).map_err(|error| FormatError::io(&self.path, &error))?;
        let (path, kind, extent, size) = (self.path.clone(), self.kind, self.extent, self.size);
        let mut cursor = Cursor {
            path,
            file,
            kind,
            extent,
            size,
            at: HEAD,
            time_us: 0,
            bytes: Vec::new(),
            used: 0,
            losses: Losses::default(),
        };
        cursor.seek(0)?;
        Ok(Box::new(cursor))
    }

    fn facts(&self) -> Vec<(String, String)> {
        let kind = match self.kind {
            Kind::Dvs => "DVS",
            Kind::Atis => "ATIS",
        };
        vec![("version".into(), self.version.clone()), ("events".into(), kind.into())]
    }

    fn files(&self) -> Vec<PathBuf> {
        vec![self.path.clone()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn file(kind: u8, events: &[u8]) -> Vec<u8> {
        [MAGIC.as_slice(), &[2, 0, 0, kind, 4, 0, 3, 0], events].concat()
    }

    fn with<T>(bytes: &[u8], work: impl FnOnce(Result<EventStream, FormatError>) -> T) -> T {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("clip.es");
        std::fs::write(&path, bytes).unwrap();
        work(EventStream::open(&path, None))
    }

    /// ns, x, y, ON.
    type Event = (i64, u16, u16, u8);

    fn read(bytes: &[u8]) -> (Vec<Event>, Vec<Loss>) {
        with(bytes, |recording| {
            let recording = recording.unwrap();
            let (mut cursor, mut chunk, mut events) =
                (recording.events().unwrap(), EventChunk::default(), Vec::new());
            while cursor.next(&mut chunk).unwrap() {
                events.extend((0..chunk.len()).map(|k| (chunk.t[k], chunk.x[k], chunk.y[k], chunk.on[k])));
            }
            (events, cursor.losses())
        })
    }

    /// 5 us ON at (1, 0); then 2 x 127 + 126 us later OFF at (3, 2), with a byte that does nothing between.
    const DVS: [u8; 13] = [5 << 1 | 1, 1, 0, 0, 0, 0xff, 0xfe, 0xff, 126 << 1, 3, 0, 2, 0];

    #[test]
    fn dvs_events_follow_the_published_rules() {
        assert_eq!(read(&file(1, &DVS)), (vec![(5_000, 1, 2, 1), (385_000, 3, 0, 0)], vec![]));
    }

    #[test]
    fn atis_events_follow_the_published_rules_and_measurements_are_left_out() {
        // 2 us ON at (0, 0); a measurement 62 us later; 3 x 63 us; OFF at once at (3, 2).
        let bytes = [2 << 2 | 2, 0, 0, 0, 0, 62 << 2 | 1, 1, 0, 1, 0, 0xff, 0, 3, 0, 2, 0];
        assert_eq!(read(&file(2, &bytes)), (vec![(2_000, 0, 2, 1), (253_000, 3, 0, 0)], vec![]));
    }

    #[test]
    fn a_file_longer_than_a_piece_is_one_stream() {
        let bytes: Vec<u8> = (0..150_000u32)
            .flat_map(|k| [3 << 1 | (k & 1) as u8, (k % 4) as u8, 0, (k % 3) as u8, 0])
            .collect();
        let (events, losses) = read(&file(1, &bytes));
        assert_eq!((events.len(), losses.len()), (150_000, 0));
        assert!(
            events.iter().enumerate().all(|(k, event)| *event
                == (3000 * (k as i64 + 1), (k % 4) as u16, 2 - (k % 3) as u16, (k & 1) as u8))
        );
    }

    #[test]
    fn a_file_cut_anywhere_gives_its_whole_events_and_a_loss() {
        let whole = read(&file(1, &DVS)).0;
        for length in 0..DVS.len() {
            let (events, losses) = read(&file(1, &DVS[..length]));
            let count = usize::from(length >= 5);
            assert_eq!(events, whole[..count], "{length}");
            // Behind an event and behind a step of time a file may end.
            assert_eq!(losses.len(), usize::from(!matches!(length, 0 | 5..=8)), "{length}");
        }
        for length in 0..20 {
            with(&file(1, &[])[..length], |recording| assert!(recording.is_err()));
        }
    }

    #[test]
    fn an_event_outside_the_pixels_ends_what_can_be_read() {
        let (events, losses) = read(&file(1, &[DVS.as_slice(), &[0, 4, 0, 0, 0], &DVS].concat()));
        assert_eq!(events.len(), 2);
        assert_eq!(losses[0].at, "bytes 33 to 51");
        assert!(losses[0].what.contains("(4, 0) lies outside the 4 x 3 pixels"), "{losses:?}");
    }

    #[test]
    fn a_stated_extent_stands_in_for_that_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("clip.es");
        std::fs::write(&path, file(1, &[DVS.as_slice(), &[0, 4, 0, 7, 0], &DVS].concat())).unwrap();
        let recording = EventStream::open(&path, Some(Extent { width: 6, height: 8 })).unwrap();
        let (mut cursor, mut chunk) = (recording.events().unwrap(), EventChunk::default());
        assert!(cursor.next(&mut chunk).unwrap() && cursor.losses().is_empty());
        assert_eq!((chunk.x, chunk.y), (vec![1, 3, 4, 1, 3], vec![7, 5, 0, 7, 5]));
        assert!(
            recording
                .about
                .notes
                .iter()
                .any(|note| note == "the extent is declared as 6 x 8; the file states 4 x 3"),
            "{:?}",
            recording.about.notes
        );
    }

    #[test]
    fn events_without_polarity_are_refused() {
        for (kind, name) in [(0, "generic"), (4, "colour"), (9, "kind 9")] {
            with(&file(kind, &[]), |recording| assert!(recording.err().unwrap().to_string().contains(name)));
        }
        with(b"Event Stream\x01\x00\x00\x01\x04\x00\x03\x00", |recording| {
            assert!(recording.err().unwrap().found.contains("version 1.0.0"))
        });
    }

    proptest! {
        #[test]
        fn random_bytes_never_panic(kind in 1..3u8, tail in proptest::collection::vec(any::<u8>(), 0..300),
        at in 0..20usize, flip in any::<u8>()) {
            let mut bytes = file(kind, &tail);
            read(&bytes);
            bytes[at] ^= flip;
            if with(&bytes, |recording| recording.is_ok()) {
                read(&bytes);
            }
        }
    }
}
