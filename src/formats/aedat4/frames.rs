//! Frames of an AEDAT4 file.
//!
//! A packet (`FRME`) is one frame: a plain stamp, start and end of the frame and of its exposure (all in
//! microseconds), the type of its values after OpenCV (8 or 16 bits; grey, BGR or BGRA), size, position on
//! the sensor, and the values row by row. Opening reads the beginnings of the packets only.

use super::chain::{Chain, Packet};
use super::flat::Table;
use super::shared::Inner;
use crate::declared::StampRole;
use crate::error::{FormatError, Loss};
use crate::losses::Losses;
use crate::recording::{FrameStamp, FramesAbout, Pictures};
use photocurrent_core::{Colour, Extent};
use std::sync::{Arc, Mutex, PoisonError};

/// The table of a frame stands before its values, within so many bytes.
const TABLE_BYTES: usize = 1 << 10;

/// How a frame's pixels stand in the file: OpenCV's type code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PixelFormat {
    /// Channels in the file: 1 grey, 3 BGR, 4 BGRA.
    stored: usize,
    /// Bytes of one value, little-endian.
    bytes: usize,
}

impl PixelFormat {
    /// From OpenCV's code: three bits of depth, then the channels less one.
    pub(super) fn of_code(code: i8) -> Option<PixelFormat> {
        let bytes = match code & 7 {
            0 => 1,
            2 => 2,
            _ => return None,
        };
        match code >> 3 {
            0 => Some(PixelFormat { stored: 1, bytes }),
            2 => Some(PixelFormat { stored: 3, bytes }),
            3 => Some(PixelFormat { stored: 4, bytes }),
            _ => None,
        }
    }

    fn channels(self) -> usize {
        if self.stored == 1 { 1 } else { 3 }
    }

    /// Adds the values of all pixels: grey, or red, green, blue where the file has blue first.
    fn add_values(self, bytes: &[u8], values: &mut Vec<f32>) {
        let channels = self.channels();
        for pixel in bytes.chunks_exact(self.bytes * self.stored) {
            match self.bytes {
                1 => values.extend(pixel[..channels].iter().rev().map(|&byte| f32::from(byte))),
                _ => values.extend(
                    pixel[..2 * channels]
                        .chunks_exact(2)
                        .rev()
                        .map(|pair| f32::from(u16::from_le_bytes([pair[0], pair[1]]))),
                ),
            }
        }
    }

    /// For people.
    fn describe(self) -> String {
        format!(
            "{} of {} bits",
            ["grey values", "BGR values", "BGRA values"][self.stored.saturating_sub(2)],
            8 * self.bytes
        )
    }
}

/// What the table of one frame says.
struct Head {
    at: i64,
    exposure: (i64, i64),
    code: i8,
    extent: Extent,
    position: (i16, i16),
    bytes: usize,
}

impl Head {
    fn of(table: &Table) -> Option<Head> {
        let size = |slot| u32::try_from(table.i16(slot)).ok().filter(|&size| size > 0);
        Some(Head {
            at: table.i64(0),
            exposure: (table.i64(3), table.i64(4)),
            code: table.i8(5),
            extent: Extent { width: size(6)?, height: size(7)? },
            position: (table.i16(8), table.i16(9)),
            bytes: table.vector_length(10)?,
        })
    }

    /// Its stamps in nanoseconds; the exposure only when it has a length.
    fn stamp(&self) -> Option<FrameStamp> {
        let (start, end) = self.exposure;
        let exposure =
            if end > start { Some((start.checked_mul(1000)?, end.checked_mul(1000)?)) } else { None };
        Some(FrameStamp { at: self.at.checked_mul(1000)?, exposure })
    }
}

/// The frames of a file.
pub(super) struct Frames {
    about: FramesAbout,
    format: PixelFormat,
    packets: Vec<Packet>,
    file: Arc<Inner>,
    chain: Mutex<Chain>,
}

impl Frames {
    /// Reads the beginnings of all frames' packets. `None` when there is no frame. Frames that differ from
    /// the first are left out: a loss each.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub(super) fn new(
        file: &Arc<Inner>,
        stated: Option<Extent>,
        notes: Vec<String>,
    ) -> Result<(Option<Frames>, Vec<Loss>), FormatError> {
        let mut losses = Losses::default();
        let mut chain = Chain::new(&file.path, &file.header, file.index.end, 1 << 12)?;
        let (mut stamps, mut packets) = (Vec::new(), Vec::new());
        let mut first: Option<(Extent, PixelFormat)> = None;
        for packet in &file.index.frames {
            if !chain.load(packet, TABLE_BYTES, &mut losses)? {
                continue;
            }
            let mut leave_out =
                |what: String| losses.add("frames that were left out", || packet.place(), || what);
            let head = Table::root_of_start(chain.content(), b"FRME").as_ref().and_then(Head::of);
            let Some(head) = head else {
                leave_out(
                    "the packet is damaged and left out: it is not the table of a frame that it should be"
                        .into(),
                );
                continue;
            };
            let (extent, format, stamp) = match usable(&head, first, stated) {
                Ok(usable) => usable,
                Err(why) => {
                    leave_out(why);
                    continue;
                }
            };
            first = Some((extent, format));
            stamps.push(stamp);
            packets.push(*packet);
        }
        let Some((extent, format)) = first else { return Ok((None, losses.list())) };
        let mut about = FramesAbout {
            extent,
            colour: if format.channels() == 3 { Colour::Rgb } else { Colour::Mono },
            bits: 8 * format.bytes as u32,
            stamp_role: role(&stamps),
            stamps,
            row_time_ns: None,
            transfer: None,
            notes,
        };
        if format.stored == 4 {
            about.notes.push("the fourth channel of the frames (alpha) was left out".into());
        }
        let without = about.stamps.iter().filter(|stamp| stamp.exposure.is_none()).count();
        if without > 0 {
            about.notes.push(format!(
                "{without} of {} frames have no exposure: its end is not after its start",
                about.stamps.len()
            ));
        }
        Ok((
            Some(Frames { about, format, packets, file: file.clone(), chain: Mutex::new(chain) }),
            losses.list(),
        ))
    }
}

/// Size, pixel format and stamp of a frame, or why it is left out.
fn usable(
    head: &Head,
    first: Option<(Extent, PixelFormat)>,
    stated: Option<Extent>,
) -> Result<(Extent, PixelFormat, FrameStamp), String> {
    let extent = first.map_or(stated.unwrap_or(head.extent), |(extent, _)| extent);
    if head.extent != extent || head.position != (0, 0) {
        let (x, y) = head.position;
        return Err(format!(
            "a frame of {} pixels at ({x}, {y}) is left out, because the others have {extent} pixels",
            head.extent
        ));
    }
    let Some(format) = PixelFormat::of_code(head.code) else {
        return Err(format!(
            "a frame of pixel type {} is left out: it is neither grey nor BGR of 8 or 16 bits",
            head.code
        ));
    };
    if let Some((_, others)) = first.filter(|(_, others)| *others != format) {
        return Err(format!(
            "a frame with {} is left out, because the others have {}",
            format.describe(),
            others.describe()
        ));
    }
    let needed = extent.pixels() * format.stored * format.bytes;
    if head.bytes != needed {
        return Err(format!(
            "a frame with {} bytes of values is left out, because {needed} are needed",
            head.bytes
        ));
    }
    let Some(stamp) = head.stamp() else {
        return Err("a frame with an impossible stamp is left out".into());
    };
    Ok((extent, format, stamp))
}

/// What the plain stamps mean: what they are of every frame that has an exposure, when that is one and the
/// same. Middles are rounded to a microsecond.
fn role(stamps: &[FrameStamp]) -> Option<StampRole> {
    let timed = || stamps.iter().filter_map(|stamp| stamp.exposure.map(|exposure| (stamp.at, exposure)));
    timed().next()?;
    if timed().all(|(at, (start, _))| at == start) {
        Some(StampRole::Start)
    } else if timed().all(|(at, (_, end))| at == end) {
        Some(StampRole::End)
    } else if timed().all(|(at, (start, end))| (at - (start / 2 + end / 2)).abs() <= 1000) {
        Some(StampRole::Middle)
    } else {
        None
    }
}

impl Pictures for Frames {
    fn about(&self) -> &FramesAbout {
        &self.about
    }

    fn read(&self, frame: usize, values: &mut Vec<f32>) -> Result<(), FormatError> {
        values.clear();
        let damaged = |at: String, what: &str| {
            FormatError::new(
                &self.file.path,
                format!("frame {frame} is damaged: {what}"),
                "read the recording without it",
            )
            .at(at)
        };
        let Some(packet) = self.packets.get(frame) else {
            return Err(FormatError::new(
                &self.file.path,
                format!("there is no frame {frame}, but {}", self.packets.len()),
                "ask for one of them",
            ));
        };
        let mut chain = self.chain.lock().unwrap_or_else(PoisonError::into_inner);
        let mut losses = Losses::default();
        if !chain.load(packet, usize::MAX, &mut losses)? {
            return Err(damaged(
                packet.place(),
                losses.list().first().map_or("it cannot be decompressed", |loss| loss.what.as_str()),
            ));
        }
        let pixels = Table::root(chain.content(), b"FRME").and_then(|table| table.vector(10, 1));
        let needed = self.about.extent.pixels() * self.format.stored * self.format.bytes;
        let pixels = pixels
            .filter(|pixels| pixels.len() == needed)
            .ok_or_else(|| damaged(packet.place(), "its values are not all there"))?;
        values.reserve(self.about.extent.pixels() * self.format.channels());
        self.format.add_values(pixels, values);
        Ok(())
    }
}
