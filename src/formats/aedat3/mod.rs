//! AEDAT 3.1: recordings of cAER and of older versions of DV.
//!
//! A line `#!AER-DAT3.1`, comment lines (`#Format: RAW`, `#Source 1: DAVIS346`), `#!END-HEADER`, then packets
//! of events of one kind, little-endian: see [`packets`]. Polarity events are 32 bits of data (valid in bit
//! 0, polarity in 1, row in 2 to 16, column in 17 to 31) and a stamp in microseconds, whose 31 bits every
//! packet continues by its overflow. Special events are edges on the camera's inputs; frames come with their
//! exposures. Columns count from the left and rows from above, in events and frames alike. What a packet or
//! frame has damaged is left out; the others are read.
//!
//! Sources: iniVation's page on AEDAT 3.1, and the event headers of libcaer (`common.h`, `polarity.h`,
//! `frame.h`, `special.h`).
//!
//! Limits: one source of several is read, the first or the one that is named. Compressed files
//! (`SerializedTS`, `PNG`) and AEDAT 3.0, whose rows count from below, are refused. Regions of interest are
//! left out. Random access goes back to the first packet. Samples of the inertial sensor are left.

mod frames;
#[doc(hidden)]
pub mod made;
mod packets;
#[cfg(test)]
mod tests;

use crate::chunk::{CHUNK_EVENTS, Edge, EventChunk, Trigger};
use crate::declared::Declared;
use crate::error::{FormatError, Loss};
use crate::format::{Format, Probe};
use crate::losses::Losses;
use crate::recording::{EventCursor, EventsAbout, Pictures, Recording};
use frames::{Finder, Frames};
use packets::{FRAME, POLARITY, Packet, Packets, SPECIAL};
use photocurrent_core::Extent;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// AEDAT 3.1.
pub static FORMAT: Format = Format { id: "aedat3", name: "AEDAT 3.1 (cAER)", recognises, open };

/// Comment lines beyond this belong to no header.
const MOST_HEADER: u64 = 1 << 20;

fn recognises(probe: &Probe) -> bool {
    probe.head.starts_with(b"#!AER-DAT3.")
}

fn open(path: &Path, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    Ok(Box::new(Aedat3::open(path, declared)?))
}

/// Sizes of pixel arrays by names of cameras, in lower case; the first that a name begins with.
const CAMERAS: [(&str, u32, u32); 9] = [
    ("dvs128", 128, 128),
    ("edvs", 128, 128),
    ("dvs132", 132, 104),
    ("davis128", 128, 128),
    ("davis208", 208, 192),
    ("davis240", 240, 180),
    ("davis346", 346, 260),
    ("davis640", 640, 480),
    ("davishet640", 640, 480),
];

fn extent_of(name: &str) -> Option<Extent> {
    let name = name.to_lowercase();
    let (_, width, height) = CAMERAS.into_iter().find(|(known, ..)| name.starts_with(known))?;
    Some(Extent { width, height })
}

/// What the comment lines say.
#[derive(Default)]
struct Header {
    /// Number and name of every source.
    sources: Vec<(u16, String)>,
    start_time: Option<String>,
    /// Where the first packet stands.
    first: u64,
}

impl Header {
    fn read(path: &Path) -> Result<Header, FormatError> {
        let io = |error: std::io::Error| FormatError::io(path, &error);
        let mut file = BufReader::new(File::open(path).map_err(io)?);
        let mut header = Header::default();
        let mut count = 0;
        while header.first < MOST_HEADER && file.fill_buf().map_err(io)?.first() == Some(&b'#') {
            let mut line = Vec::new();
            let length = file.by_ref().take(1 << 16).read_until(b'\n', &mut line).map_err(io)?;
            let text = String::from_utf8_lossy(&line).trim().to_owned();
            if count == 0 && !text.starts_with("#!AER-DAT3.1") {
                let found = format!("the first line is `{}`", crate::ros::wire::label(text.as_bytes()));
                let hint = "convert it to AEDAT4 with DV (its rows count from below), or let the program \
                            find the format by itself";
                return Err(FormatError::new(path, found, hint).at("line 1").expected("`#!AER-DAT3.1`"));
            }
            // Without the line that ends them, comments end where a line is no text.
            if line.iter().any(|byte| byte.is_ascii_control() && !b"\t\r\n".contains(byte)) {
                break;
            }
            header.first += length as u64;
            count += 1;
            if text.starts_with("#!END-HEADER") {
                break;
            }
            header.take(path, &text, count)?;
        }
        if count == 0 {
            return Err(FormatError::new(
                path,
                "the file does not begin as AEDAT files do",
                "let the program find the format by itself",
            )
            .expected("`#!AER-DAT3.1`"));
        }
        Ok(header)
    }

    fn take(&mut self, path: &Path, line: &str, number: usize) -> Result<(), FormatError> {
        let value = |name: &str| line.strip_prefix(name).map(str::trim);
        if let Some(format) = value("#Format:").filter(|format| *format != "RAW" && !format.is_empty()) {
            let found =
                format!("its packets are in the format `{}`", crate::ros::wire::label(format.as_bytes()));
            let hint = "convert it to AEDAT4 with DV, or record it in the format RAW";
            return Err(FormatError::new(path, found, hint)
                .at(format!("line {number}"))
                .expected("`#Format: RAW`"));
        }
        if let Some((id, name)) = value("#Source").and_then(|rest| rest.split_once(':'))
            && let Ok(id) = id.trim().parse::<u16>()
        {
            self.sources.push((id, crate::ros::wire::label(name.trim().as_bytes())));
        }
        if let Some(time) = value("#Start-Time:") {
            self.start_time = Some(crate::ros::wire::label(time.as_bytes()));
        }
        Ok(())
    }

    fn describe(&self) -> String {
        let all: Vec<String> = self.sources.iter().map(|(id, name)| format!("{id} ({name})")).collect();
        if all.is_empty() { "none is named".into() } else { all.join(", ") }
    }

    /// The source that is named by its number or its name, or the first; `None` where the header has none.
    fn choose(&self, path: &Path, named: Option<&str>) -> Result<Option<&(u16, String)>, FormatError> {
        let Some(named) = named else { return Ok(self.sources.first()) };
        let is_named =
            |(id, name): &&(u16, String)| name.eq_ignore_ascii_case(named) || id.to_string() == named;
        self.sources.iter().find(is_named).map(Some).ok_or_else(|| {
            let found = format!("no source is called `{named}`; there are: {}", self.describe());
            FormatError::new(path, found, "name one of them as `camera`, by its number or its name")
                .undeclared("camera")
        })
    }
}

/// An opened file.
pub struct Aedat3 {
    path: PathBuf,
    header: Header,
    source: Option<(u16, String)>,
    about: Option<EventsAbout>,
    frames: Option<Arc<Frames>>,
    facts: Vec<(String, String)>,
    losses: Losses,
}

/// Counts of what the packets hold.
#[derive(Default)]
struct Counts {
    packets: u64,
    events: u64,
    valid: u64,
    of_others: u64,
}

impl Aedat3 {
    /// Reads the header, and goes over the packets' headers once.
    ///
    /// # Errors
    /// When the file is no AEDAT 3.1 or is compressed, a source that was named is not there, or the size of
    /// the pixel array is not known.
    pub fn open(path: &Path, declared: &Declared) -> Result<Aedat3, FormatError> {
        let header = Header::read(path)?;
        let source = header.choose(path, declared.camera.as_deref())?.cloned();
        let by_name = source.as_ref().and_then(|(_, name)| extent_of(name));
        let (mut counts, mut finder, mut losses) = (Counts::default(), Finder::default(), Losses::default());
        let mut packets = Packets::open(path, header.first)?;
        while let Some(packet) = packets.next()? {
            counts.packets += 1;
            if source.as_ref().is_some_and(|(id, _)| *id != packet.source) {
                counts.of_others += 1;
            } else if packet.kind == POLARITY {
                counts.events += u64::from(packet.number);
                counts.valid += u64::from(packet.valid.min(packet.number));
            } else if packet.kind == FRAME {
                finder.add(&mut packets, &packet, by_name, &mut losses)?;
            }
        }
        losses.append(std::mem::take(&mut packets.losses), |at| at);
        packets.rewind();
        let frames = finder.finish(path.into(), packets, Vec::new()).map(Arc::new);
        let about = match counts.events {
            0 => None,
            _ => Some(events_about(path, &source, (declared.extent, by_name), frames.as_deref(), &counts)?),
        };
        if about.is_none() && frames.is_none() {
            let lost =
                losses.list().first().map(|loss| format!("; {}: {}", loss.at, loss.what)).unwrap_or_default();
            let found = format!(
                "no packet of source {} has events or frames{lost}",
                source.as_ref().map_or("any".into(), |(id, _)| id.to_string())
            );
            let hint = format!("name another source as `camera`; there are: {}", header.describe());
            return Err(FormatError::new(path, found, hint));
        }
        let mut facts = vec![("version".to_owned(), "AEDAT 3.1".to_owned())];
        let mut add = |name: &str, what: String| facts.push((name.into(), what));
        if let Some((_, name)) = &source {
            add("camera", name.clone());
        }
        if header.sources.len() > 1 {
            add("sources", header.describe());
        }
        if let Some(time) = &header.start_time {
            add("start", time.clone());
        }
        add("packets", counts.packets.to_string());
        if counts.of_others > 0 {
            add("packets of other sources", format!("{}, not read", counts.of_others));
        }
        Ok(Aedat3 { path: path.into(), header, source, about, frames, facts, losses })
    }

    fn cursor(&self) -> Result<Cursor, FormatError> {
        let packets = Packets::open(&self.path, self.header.first)?;
        let extent = self.about.as_ref().and_then(|about| about.extent);
        let source = self.source.as_ref().map(|(id, _)| *id);
        Ok(Cursor { packets, source, extent, pending: None, bytes: Vec::new(), losses: Losses::default() })
    }

    /// The signals of all special events.
    fn signals(&self) -> Result<Signals, FormatError> {
        let mut cursor = self.cursor()?;
        let mut signals = Signals::default();
        while let Some(packet) = cursor.packets.next()? {
            if packet.kind != SPECIAL || cursor.source.is_some_and(|id| id != packet.source) {
                continue;
            }
            let mut from = 0;
            while from < packet.number {
                let count = (packet.number - from).min(CHUNK_EVENTS as u32);
                cursor.packets.read(&packet, from, count, &mut cursor.bytes)?;
                words(&cursor.bytes).for_each(|(data, stamp)| signals.add(&packet, data, stamp));
                from += count;
            }
        }
        Ok(signals)
    }
}

/// What is known of the events. The size of the pixel array is that which is declared, that of the named
/// camera, or that of the frames.
fn events_about(
    path: &Path,
    source: &Option<(u16, String)>,
    (declared, by_name): (Option<Extent>, Option<Extent>),
    frames: Option<&Frames>,
    counts: &Counts,
) -> Result<EventsAbout, FormatError> {
    let mut notes = Vec::new();
    let extent = match (declared, by_name, frames) {
        (Some(extent), ..) | (None, Some(extent), _) => extent,
        (None, None, Some(frames)) => {
            notes.push("no size of the event array is known for this camera; the frames' was taken".into());
            frames.about().extent
        }
        (None, None, None) => {
            let found = match source {
                Some((_, name)) => format!("the size of the pixel array of `{name}` is not known"),
                None => "no comment says which camera the events are from".into(),
            };
            return Err(
                FormatError::new(path, found, "state its `extent`, such as 346 x 260").undeclared("extent")
            );
        }
    };
    let invalid = counts.events - counts.valid;
    if invalid > 0 {
        notes.push(format!(
            "{invalid} events are marked as invalid in the file (by a filter of the \
                            recorder); they are left out"
        ));
    }
    let stamps = "i32 microseconds of 31 bits, continued by the overflow of their packet".into();
    Ok(EventsAbout {
        extent: Some(extent),
        tick_ns: 1000,
        count: Some(counts.valid),
        has_t_in: false,
        stamps,
        notes,
    })
}

/// Data and stamps of events of eight bytes.
fn words(bytes: &[u8]) -> impl Iterator<Item = (u32, i32)> {
    let word = |&[a, b, c, d, e, f, g, h]: &[u8; 8]| {
        (u32::from_le_bytes([a, b, c, d]), i32::from_le_bytes([e, f, g, h]))
    };
    bytes.as_chunks::<8>().0.iter().map(word)
}

/// Signals of the camera.
#[derive(Default)]
struct Signals {
    edges: Vec<Trigger>,
    resets: u64,
    pulses: u64,
}

impl Signals {
    fn add(&mut self, packet: &Packet, data: u32, stamp: i32) {
        let Some(t) = packet.time_ns(stamp).filter(|_| data & 1 == 1) else { return };
        let (line, edge) = match data >> 1 & 0x7f {
            1 => return self.resets += 1,
            4 | 8 | 11 => return self.pulses += 1,
            2 => (0, Edge::Rising),
            3 => (0, Edge::Falling),
            6 => (1, Edge::Rising),
            7 => (1, Edge::Falling),
            9 => (2, Edge::Rising),
            10 => (2, Edge::Falling),
            // The camera's own generator of signals.
            12 => (3, Edge::Rising),
            13 => (3, Edge::Falling),
            _ => return,
        };
        self.edges.push(Trigger { t, line, edge });
    }
}

/// A walk through the polarity events.
struct Cursor {
    packets: Packets,
    source: Option<u16>,
    extent: Option<Extent>,
    /// A packet, and its event that is read next.
    pending: Option<(Packet, u32)>,
    bytes: Vec<u8>,
    losses: Losses,
}

impl Cursor {
    fn decode(&mut self, packet: &Packet, chunk: &mut EventChunk) {
        let (width, height) = self.extent.map_or((1 << 15, 1 << 15), |extent| (extent.width, extent.height));
        let (mut outside, mut timeless) = (0_u64, 0_u64);
        for (data, stamp) in words(&self.bytes) {
            if data & 1 == 0 {
                continue;
            }
            let (x, y, on) = (data >> 17, data >> 2 & 0x7fff, data >> 1 & 1 == 1);
            match packet.time_ns(stamp) {
                None => timeless += 1,
                Some(_) if x >= width || y >= height => outside += 1,
                // Both have 15 bits.
                Some(t) => chunk.push(t, x as u16, y as u16, on),
            }
        }
        let extent = self.extent.unwrap_or(Extent { width, height });
        let what = || format!("{outside} events lie outside the {extent} pixels; they are left out");
        self.losses.add_items(
            "events outside the pixel array were left out",
            outside,
            || packet.place(),
            what,
        );
        let what = || format!("{timeless} events have a negative stamp; they are left out");
        self.losses.add_items(
            "events with an impossible stamp were left out",
            timeless,
            || packet.place(),
            what,
        );
    }
}

impl EventCursor for Cursor {
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        chunk.clear();
        chunk.t_in = None;
        while chunk.len() < CHUNK_EVENTS / 2 {
            let (packet, from) = match self.pending.take() {
                Some(pending) => pending,
                None => match self.packets.next()? {
                    Some(packet) => (packet, 0),
                    None => return Ok(!chunk.is_empty()),
                },
            };
            if packet.kind != POLARITY || self.source.is_some_and(|id| id != packet.source) {
                continue;
            }
            let count = packet.number.saturating_sub(from).min((CHUNK_EVENTS / 2) as u32);
            self.packets.read(&packet, from, count, &mut self.bytes)?;
            self.decode(&packet, chunk);
            if from + count < packet.number {
                self.pending = Some((packet, from + count));
            }
        }
        Ok(true)
    }

    fn seek(&mut self, _: i64) -> Result<(), FormatError> {
        // Nothing says that packets are in order of time, so that only the beginning is safe.
        self.packets.rewind();
        self.pending = None;
        Ok(())
    }

    fn losses(&self) -> Vec<Loss> {
        let mut all = self.packets.losses.clone();
        all.append(self.losses.clone(), |at| at);
        all.list()
    }

    fn position(&self) -> (u64, u64) {
        self.packets.position()
    }
}

impl Recording for Aedat3 {
    fn events_about(&self) -> Option<&EventsAbout> {
        self.about.as_ref()
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        if self.about.is_none() {
            return Err(FormatError::new(
                &self.path,
                "the file has no polarity events of this source",
                "use its frames only",
            ));
        }
        Ok(Box::new(self.cursor()?))
    }

    fn pictures(&self) -> Option<Arc<dyn Pictures>> {
        self.frames.clone().map(|frames| frames as Arc<dyn Pictures>)
    }

    fn triggers(&self) -> Result<Vec<Trigger>, FormatError> {
        Ok(self.signals()?.edges)
    }

    fn facts(&self) -> Vec<(String, String)> {
        let mut facts = self.facts.clone();
        if let Ok(signals) = self.signals() {
            let mut add = |name: &str, count: u64| {
                if count > 0 {
                    facts.push((name.into(), count.to_string()));
                }
            };
            add("edges on inputs", signals.edges.len() as u64);
            add("pulses on inputs", signals.pulses);
            add("resets of the clock", signals.resets);
        }
        facts
    }

    fn losses(&self) -> Vec<Loss> {
        self.losses.list()
    }

    fn files(&self) -> Vec<PathBuf> {
        vec![self.path.clone()]
    }
}
