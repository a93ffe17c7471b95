//! Frames of an AEDAT 3.1 file.
//!
//! A frame is: 32 bits of marks (valid in bit 0, channels in 1 to 3, colour filter in 4 to 7), begin and end
//! of the frame, begin and end of its exposure (i32 microseconds each), width and height, column and row of
//! its first pixel (i32), then 16-bit values row by row. Values of a converter with fewer bits are shifted up
//! to 16 by the recorder. Opening reads what stands before the values.

use super::packets::{FRAME_HEAD, Packet, Packets};
use crate::declared::StampRole;
use crate::error::FormatError;
use crate::losses::Losses;
use crate::recording::{FrameStamp, FramesAbout, Pictures};
use photocurrent_core::colour::Order;
use photocurrent_core::{Colour, Extent};
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// What stands before the values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Head {
    is_valid: bool,
    colour: Option<Colour>,
    /// Values of a pixel that are stored.
    stored: usize,
    filter: u32,
    stamps: [i32; 4],
    extent: Option<Extent>,
    position: (i32, i32),
}

impl Head {
    fn parse(bytes: &[u8]) -> Option<Head> {
        let number = |k: usize| Some(u32::from_le_bytes(*bytes.get(4 * k..)?.first_chunk::<4>()?));
        let signed = |k: usize| number(k).map(u32::cast_signed);
        let marks = number(0)?;
        let (stored, filter) = ((marks >> 1 & 7) as usize, marks >> 4 & 15);
        let side = |k: usize| {
            signed(k).and_then(|side| u32::try_from(side).ok()).filter(|side| (1..=1 << 14).contains(side))
        };
        Some(Head {
            is_valid: marks & 1 == 1,
            colour: colour(stored, filter),
            stored,
            filter,
            stamps: [signed(1)?, signed(2)?, signed(3)?, signed(4)?],
            extent: side(5).zip(side(6)).map(|(width, height)| Extent { width, height }),
            position: (signed(7)?, signed(8)?),
        })
    }

    /// Start of the exposure and, when it has a length, both its ends.
    fn stamp(&self, packet: &Packet) -> Option<FrameStamp> {
        let [frame, _, start, end] = self.stamps.map(|stamp| packet.time_ns(stamp));
        let exposure = start.zip(end).filter(|(start, end)| end > start);
        Some(FrameStamp { at: exposure.map(|exposure| exposure.0).or(start).or(frame)?, exposure })
    }

    fn values(&self) -> u64 {
        self.extent.map_or(0, |extent| extent.pixels() as u64 * self.stored as u64)
    }
}

/// Colours of a frame; `None` for those that are not read. Filters are named clockwise from the upper left
/// pixel.
fn colour(stored: usize, filter: u32) -> Option<Colour> {
    match (stored, filter) {
        (1, 0) => Some(Colour::Mono),
        (1, 1) => Some(Colour::Bayer(Order::Rggb)),
        (1, 2) => Some(Colour::Bayer(Order::Grbg)),
        (1, 3) => Some(Colour::Bayer(Order::Gbrg)),
        (1, 4) => Some(Colour::Bayer(Order::Bggr)),
        (3 | 4, _) => Some(Colour::Rgb),
        _ => None,
    }
}

/// Collects the frames while the packets are gone over.
#[derive(Default)]
pub(super) struct Finder {
    first: Option<(Extent, Colour, usize)>,
    stamps: Vec<FrameStamp>,
    places: Vec<u64>,
    invalid: u64,
    timeless: u64,
    bytes: Vec<u8>,
}

impl Finder {
    /// Adds the frames of a packet. Those that differ from the first are left out, a loss each.
    ///
    /// # Errors
    /// When the file cannot be read any more.
    pub(super) fn add(
        &mut self,
        packets: &mut Packets,
        packet: &Packet,
        stated: Option<Extent>,
        losses: &mut Losses,
    ) -> Result<(), FormatError> {
        for k in 0..packet.number {
            let at = packet.content() + u64::from(k) * u64::from(packet.size);
            packets.fetch(at, FRAME_HEAD, &mut self.bytes)?;
            let mut leave_out =
                |what: String| losses.add("frames that were left out", || packet.place(), || what);
            let Some(head) = Head::parse(&self.bytes) else { continue };
            if !head.is_valid {
                self.invalid += 1;
                continue;
            }
            let (Some(extent), Some(stamp)) = (head.extent, head.stamp(packet)) else {
                leave_out("a frame with an impossible size or stamp is left out".into());
                continue;
            };
            let Some(colour) = head.colour else {
                leave_out(format!(
                    "a frame of {} channels with the colour filter {} is left out: grey, Bayer, RGB and \
                     RGBA are read",
                    head.stored, head.filter
                ));
                continue;
            };
            if FRAME_HEAD + 2 * head.values() > u64::from(packet.size) {
                leave_out(format!(
                    "a frame of {extent} pixels is left out: its packet has {} bytes for a frame",
                    packet.size
                ));
                continue;
            }
            let whole = self.first.map_or(stated.unwrap_or(extent), |(extent, ..)| extent);
            if extent != whole || head.position != (0, 0) {
                let (x, y) = head.position;
                leave_out(format!(
                    "a frame of {extent} pixels at ({x}, {y}) is left out, because the others \
                                   have {whole} pixels"
                ));
                continue;
            }
            if self.first.is_some_and(|(_, others, stored)| (others, stored) != (colour, head.stored)) {
                leave_out("a frame of other colours than the first is left out".into());
                continue;
            }
            self.first = Some((extent, colour, head.stored));
            self.timeless += u64::from(stamp.exposure.is_none());
            self.stamps.push(stamp);
            self.places.push(at);
        }
        Ok(())
    }

    /// The frames; `None` without any.
    pub(super) fn finish(self, path: PathBuf, packets: Packets, mut notes: Vec<String>) -> Option<Frames> {
        let (extent, colour, stored) = self.first?;
        if self.invalid > 0 {
            notes.push(format!(
                "{} frames are marked as invalid in the file; they are left out",
                self.invalid
            ));
        }
        if self.timeless > 0 {
            notes.push(format!(
                "{} of {} frames have no exposure: its end is not after its start",
                self.timeless,
                self.stamps.len()
            ));
        }
        let about = FramesAbout {
            extent,
            colour,
            bits: 16,
            stamps: self.stamps,
            stamp_role: Some(StampRole::Start),
            row_time_ns: None,
            transfer: None,
            notes,
        };
        Some(Frames { path, about, stored, places: self.places, packets: Mutex::new(packets) })
    }
}

/// The frames of a file.
pub(super) struct Frames {
    path: PathBuf,
    about: FramesAbout,
    stored: usize,
    /// Where every frame begins.
    places: Vec<u64>,
    packets: Mutex<Packets>,
}

impl Pictures for Frames {
    fn about(&self) -> &FramesAbout {
        &self.about
    }

    fn read(&self, frame: usize, values: &mut Vec<f32>) -> Result<(), FormatError> {
        values.clear();
        let Some(&at) = self.places.get(frame) else {
            return Err(FormatError::new(
                &self.path,
                format!("there is no frame {frame}, but {}", self.places.len()),
                "ask for one of them",
            ));
        };
        let needed = self.about.extent.pixels() * self.stored * 2;
        let mut bytes = Vec::new();
        self.packets.lock().unwrap_or_else(PoisonError::into_inner).fetch(
            at + FRAME_HEAD,
            needed as u64,
            &mut bytes,
        )?;
        if bytes.len() != needed {
            let found = format!("frame {frame} is damaged: its values are not all there");
            return Err(
                FormatError::new(&self.path, found, "read the recording without it").at(format!("byte {at}"))
            );
        }
        let channels = self.about.colour.channels() as usize;
        values.reserve(self.about.extent.pixels() * channels);
        for pixel in bytes.chunks_exact(2 * self.stored) {
            values.extend(
                pixel
                    .as_chunks::<2>()
                    .0
                    .iter()
                    .take(channels)
                    .map(|&value| f32::from(u16::from_le_bytes(value))),
            );
        }
        Ok(())
    }
}
