//! AEDAT 2.0 and 1.0: recordings of jAER.
//!
//! A line `#!AER-DAT2.0`, comment lines, then records of eight bytes: a 32-bit address and a 32-bit stamp in
//! microseconds, both big-endian. (1.0: addresses of 16 bits, six bytes a record.) What an address means
//! depends on the camera, which a comment names (`# AEChip: ...DVS128`); where none does, it must be
//! declared.
//!
//! - DVS128: polarity in bit 0 (0 is ON: so in jAER and in the driver of dv-processing), column in bits 1 to
//!   7, row in 8 to 14, falling edge of the sync input in 15.
//! - DAVIS: bit 31 clear for events (set: samples of the frames' converter or of the inertial sensor), row in
//!   bits 22 to 30, column in 12 to 21, polarity in 11 (1 is ON), bit 10 for a signal on the external input,
//!   whose edge stands in the lowest three bits (2 falling, 3 rising) in newer files.
//!
//! Both count columns from the right and rows from below: jAER itself mirrors the column and draws upwards.
//! Given are columns from the left and rows from above, as v2e, `tonic` and DV have them. Stamps of 32 bits
//! run over after 71 minutes; they are continued.
//!
//! Sources: jAER (`DVS128`, `DavisChip`, `DavisBaseCamera`), iniVation's page on AEDAT formats.
//!
//! Limits: frames of DAVIS cameras, which stand in the file as single samples of the converter, are not put
//! together; they are counted. Random access goes back to the first event.

use crate::chunk::{CHUNK_EVENTS, Edge, EventChunk, Trigger};
use crate::declared::Declared;
use crate::error::{Cause, FormatError, Loss};
use crate::format::{Format, Probe};
use crate::losses::Losses;
use crate::recording::{EventCursor, EventsAbout, Recording};
use photocurrent_core::Extent;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// AEDAT 2.0 and 1.0.
pub(crate) static FORMAT: Format = Format { id: "aedat2", name: "AEDAT 2.0 (jAER)", recognises, open };

/// Comment lines beyond this belong to no header.
const MOST_HEADER: u64 = 1 << 20;

fn recognises(probe: &Probe) -> bool {
    ["#!AER-DAT1.", "#!AER-DAT2."].iter().any(|line| probe.head.starts_with(line.as_bytes()))
}

fn open(path: &Path, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    Ok(Box::new(Aedat2::open(path, declared)?))
}

/// Cameras by what their addresses mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Family {
    Dvs128,
    Davis,
}

/// A camera whose addresses are known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Camera {
    /// What its name in jAER contains, in lower case.
    name: &'static str,
    family: Family,
    extent: Extent,
}

const CAMERAS: [Camera; 8] = [
    Camera { name: "dvs128", family: Family::Dvs128, extent: Extent { width: 128, height: 128 } },
    Camera { name: "tmpdiff128", family: Family::Dvs128, extent: Extent { width: 128, height: 128 } },
    Camera { name: "davis240", family: Family::Davis, extent: Extent { width: 240, height: 180 } },
    Camera { name: "sbret10", family: Family::Davis, extent: Extent { width: 240, height: 180 } },
    Camera { name: "sbret20", family: Family::Davis, extent: Extent { width: 240, height: 180 } },
    Camera { name: "davis346", family: Family::Davis, extent: Extent { width: 346, height: 260 } },
    Camera { name: "davis640", family: Family::Davis, extent: Extent { width: 640, height: 480 } },
    Camera { name: "davisrgbw640", family: Family::Davis, extent: Extent { width: 640, height: 480 } },
];

impl Camera {
    fn of_name(name: &str) -> Option<Camera> {
        let name = name.to_lowercase();
        CAMERAS.into_iter().find(|camera| name.contains(camera.name))
    }
}

/// What an address means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Word {
    Event {
        x: u16,
        y: u16,
        on: bool,
    },
    /// An event whose pixel the camera does not have.
    Outside,
    /// A signal on the input, with its edge when the file has it.
    Signal(Option<Edge>),
    /// A sample of the converter or of the inertial sensor.
    Sample,
}

impl Camera {
    #[inline]
    fn word(self, address: u32) -> Word {
        let (column, row, on) = match self.family {
            Family::Dvs128 if address & 0xffff_8000 == 0x8000 => return Word::Signal(Some(Edge::Falling)),
            Family::Dvs128 if address & 0xffff_8000 != 0 => return Word::Outside,
            Family::Dvs128 => (address >> 1 & 0x7f, address >> 8 & 0x7f, address & 1 == 0),
            Family::Davis if address >> 31 == 1 => return Word::Sample,
            Family::Davis if address >> 10 & 1 == 1 => {
                let edge = match address & 7 {
                    2 => Some(Edge::Falling),
                    3 => Some(Edge::Rising),
                    _ => None,
                };
                return Word::Signal(edge);
            }
            Family::Davis => (address >> 12 & 0x3ff, address >> 22 & 0x1ff, address >> 11 & 1 == 1),
        };
        if column >= self.extent.width || row >= self.extent.height {
            return Word::Outside;
        }
        // Both are below 1024.
        Word::Event {
            x: (self.extent.width - 1 - column) as u16,
            y: (self.extent.height - 1 - row) as u16,
            on,
        }
    }
}

/// An opened file.
struct Aedat2 {
    path: PathBuf,
    /// Where the first record stands.
    first: u64,
    size: u64,
    /// Bytes of a record: 6 or 8.
    record: usize,
    camera: Camera,
    /// The camera's name in the header.
    chip: Option<String>,
    version: String,
    about: EventsAbout,
}

impl Aedat2 {
    fn open(path: &Path, declared: &Declared) -> Result<Aedat2, FormatError> {
        let io = |error: std::io::Error| FormatError::io(path, &error);
        let file = File::open(path).map_err(io)?;
        let size = file.metadata().map_err(io)?.len();
        let mut file = BufReader::new(file);
        let (mut first, mut lines) = (0, Vec::new());
        // The records begin behind the line that says so, or where a line is no comment. A record may begin
        // with `#` as well; but no text has such bytes.
        while first < MOST_HEADER && file.fill_buf().map_err(io)?.first() == Some(&b'#') {
            let mut line = Vec::new();
            let count = file.by_ref().take(1 << 16).read_until(b'\n', &mut line).map_err(io)?;
            if line.iter().any(|byte| byte.is_ascii_control() && !b"\t\r\n".contains(byte)) {
                break;
            }
            first += count as u64;
            lines.push(String::from_utf8_lossy(&line).trim_end().to_owned());
            if line.starts_with(b"#End Of ASCII Header") {
                break;
            }
        }
        let version =
            lines.first().and_then(|line| line.strip_prefix("#!AER-DAT")).unwrap_or_default().to_owned();
        let record = match version.split('.').next() {
            Some("1") => 6,
            Some("2") => 8,
            _ => {
                let hint = "let the program find the format by itself";
                return Err(FormatError::new(path, "the file does not begin as AEDAT files do", hint)
                    .at("line 1")
                    .expected("`#!AER-DAT2.0`"));
            }
        };
        let chip =
            lines.iter().find_map(|line| line.split_once("AEChip:")).map(|(_, name)| name.trim().to_owned());
        let named = declared.camera.as_deref().or(chip.as_deref());
        let by_extent =
            || declared.extent.and_then(|extent| CAMERAS.into_iter().find(|camera| camera.extent == extent));
        let Some(camera) = named.and_then(Camera::of_name).or_else(by_extent) else {
            let found = match named {
                Some(name) => format!("the layout of addresses of the camera `{name}` is not known"),
                None => "no comment says which camera the addresses are from".into(),
            };
            let names: Vec<&str> = CAMERAS.iter().map(|camera| camera.name).collect();
            return Err(FormatError::new(
                path,
                found,
                format!("name the camera; one of {}", names.join(", ")),
            )
            .undeclared("camera"));
        };
        let about = EventsAbout {
            extent: Some(camera.extent),
            tick_ns: 1000,
            count: None,
            has_t_in: false,
            stamps: "i32 microseconds, continued when they run over".into(),
            notes: vec![
                "columns counted from the left and rows from above; the file has them from the \
                         right and from below"
                    .into(),
            ],
        };
        Ok(Aedat2 { path: path.into(), first, size, record, camera, chip, version, about })
    }

    fn cursor(&self) -> Result<Cursor, FormatError> {
        let mut file = File::open(&self.path).map_err(|error| FormatError::io(&self.path, &error))?;
        file.seek(SeekFrom::Start(self.first)).map_err(|error| FormatError::io(&self.path, &error))?;
        let (path, size, first, record, camera) =
            (self.path.clone(), self.size, self.first, self.record, self.camera);
        Ok(Cursor {
            path,
            file,
            first,
            at: first,
            size,
            record,
            camera,
            time_us: None,
            bytes: Vec::new(),
            samples: 0,
            losses: Losses::default(),
        })
    }
}

/// A walk through the records.
struct Cursor {
    path: PathBuf,
    file: File,
    first: u64,
    at: u64,
    size: u64,
    record: usize,
    camera: Camera,
    /// The last stamp, continued over the ends of the counter.
    time_us: Option<i64>,
    bytes: Vec<u8>,
    /// Records that are neither events nor signals.
    samples: u64,
    losses: Losses,
}

impl Cursor {
    /// Reads the next records, and gives each with its time in microseconds. False at the end.
    fn step(&mut self, mut take: impl FnMut(i64, Word)) -> Result<bool, FormatError> {
        let io = |error: std::io::Error| FormatError::io(&self.path, &error);
        self.bytes.clear();
        let wanted = (self.record * CHUNK_EVENTS) as u64;
        let count = self
            .file
            .by_ref()
            .take(wanted.min(self.size - self.at))
            .read_to_end(&mut self.bytes)
            .map_err(io)?;
        let (start, record) = (self.at, self.record);
        self.at += count as u64;
        if count == 0 {
            self.at = self.size;
            return Ok(false);
        }
        let left = count % record;
        if left > 0 {
            let at = || format!("bytes {} to {}", self.at - left as u64, self.at);
            self.losses.add_by(Cause::Cut, "records that are cut off", 1, at, || {
                "the last record is cut off and left out".into()
            });
        }
        let mut outside = 0_u64;
        for bytes in self.bytes.chunks_exact(record) {
            let (address, stamp) = match *bytes {
                [a, b, c, d, e, f, g, h] => {
                    (u32::from_be_bytes([a, b, c, d]), u32::from_be_bytes([e, f, g, h]))
                }
                [a, b, c, d, e, f] => (u32::from_be_bytes([0, 0, a, b]), u32::from_be_bytes([c, d, e, f])),
                _ => continue,
            };
            // The distance to the stamp before, whichever way is shorter around the counter.
            let time_us = match self.time_us {
                None => i64::from(stamp as i32),
                Some(before) => before.wrapping_add(i64::from(stamp.wrapping_sub(before as u32) as i32)),
            };
            self.time_us = Some(time_us);
            match self.camera.word(address) {
                Word::Sample => self.samples += 1,
                Word::Outside => outside += 1,
                word => take(time_us, word),
            }
        }
        let what = || {
            format!(
                "{outside} addresses name no pixel of the {} pixels of this camera; they are left out",
                self.camera.extent
            )
        };
        self.losses.add_by(
            Cause::Outside,
            "addresses outside the pixel array were left out",
            outside,
            || format!("bytes {start} to {}", self.at),
            what,
        );
        Ok(true)
    }
}

impl EventCursor for Cursor {
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        chunk.clear();
        chunk.t_in = None;
        self.step(|time_us, word| {
            if let Word::Event { x, y, on } = word {
                chunk.push(time_us.saturating_mul(1000), x, y, on);
            }
        })
    }

    fn seek(&mut self, _: i64) -> Result<(), FormatError> {
        // Times of records further on are known only from those before.
        self.file.seek(SeekFrom::Start(self.first)).map_err(|error| FormatError::io(&self.path, &error))?;
        (self.at, self.time_us) = (self.first, None);
        Ok(())
    }

    fn losses(&self) -> Vec<Loss> {
        self.losses.list()
    }

    fn position(&self) -> (u64, u64) {
        (self.at, self.size)
    }
}

impl Recording for Aedat2 {
    fn events_about(&self) -> Option<&EventsAbout> {
        Some(&self.about)
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        Ok(Box::new(self.cursor()?))
    }

    fn triggers(&self) -> Result<Vec<Trigger>, FormatError> {
        let (mut cursor, mut triggers) = (self.cursor()?, Vec::new());
        let mut take = |time_us: i64, word| {
            if let Word::Signal(Some(edge)) = word {
                triggers.push(Trigger { t: time_us.saturating_mul(1000), line: 0, edge });
            }
        };
        while cursor.step(&mut take)? {}
        Ok(triggers)
    }

    fn facts(&self) -> Vec<(String, String)> {
        let mut facts = vec![("version".to_owned(), format!("AEDAT {}", self.version))];
        if let Some(chip) = &self.chip {
            facts.push(("camera".into(), chip.clone()));
        }
        if self.camera.family == Family::Davis {
            facts.push((
                "frames".into(),
                "samples of frames and of the inertial sensor, if there are any, are not read".into(),
            ));
        }
        facts
    }

    fn files(&self) -> Vec<PathBuf> {
        vec![self.path.clone()]
    }
}

#[cfg(test)]
#[path = "aedat2_tests.rs"]
mod tests;
