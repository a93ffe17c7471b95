//! Events of an AEDAT4 file, packet by packet.
//!
//! A packet (`EVTS`) is one vector of structures of 16 bytes: stamp in microseconds (i64), column and row
//! (i16), polarity (u8), three bytes of nothing.

use super::chain::{Chain, Packet};
use super::index::{EVENT, Mark, elements, marks_by_reading};
use super::shared::Inner;
use crate::chunk::{CHUNK_EVENTS, EventChunk};
use crate::error::{Cause, FormatError, Loss};
use crate::losses::Losses;
use crate::recording::EventCursor;
use photocurrent_core::Extent;
use std::sync::Arc;

/// Stamps beyond this do not fit into nanoseconds of 64 bits.
const MOST_US: i64 = i64::MAX / 1000;

/// A walk through the events.
pub(super) struct Cursor {
    file: Arc<Inner>,
    chain: Chain,
    stream: u32,
    extent: Extent,
    /// Which bytes of the packet at hand have not been given.
    rest: std::ops::Range<usize>,
    /// That packet's place, for messages.
    packet: Option<Packet>,
    losses: Losses,
}

impl Cursor {
    /// At the first event.
    ///
    /// # Errors
    /// When the file has gone.
    pub(super) fn new(file: &Arc<Inner>, stream: u32, extent: Extent) -> Result<Cursor, FormatError> {
        let chain = Chain::new(&file.path, &file.header, file.index.end, 1 << 16)?;
        Ok(Cursor {
            file: file.clone(),
            chain,
            stream,
            extent,
            rest: 0..0,
            packet: None,
            losses: Losses::default(),
        })
    }

    /// Loads the next packet that has events. False at the end.
    fn load(&mut self) -> Result<bool, FormatError> {
        while let Some(packet) = self.chain.next(&mut self.losses)? {
            if packet.stream != self.stream || !self.chain.load(&packet, usize::MAX, &mut self.losses)? {
                continue;
            }
            let content = self.chain.content();
            match elements(content) {
                Some(events) => {
                    // An absent vector is empty and does not stand in the content.
                    let start = if events.is_empty() {
                        0
                    } else {
                        events.as_ptr() as usize - content.as_ptr() as usize
                    };
                    self.rest = start..start + events.len();
                    self.chain.proven();
                    self.packet = Some(packet);
                    if !self.rest.is_empty() {
                        return Ok(true);
                    }
                }
                None => self.chain.spoiled(
                    &packet,
                    "it is not the table of events that it should be",
                    &mut self.losses,
                ),
            }
        }
        Ok(false)
    }
}

/// Is an event in the array, with a stamp that fits?
#[inline]
fn is_inside(t: i64, x: u16, y: u16, extent: Extent) -> bool {
    // Coordinates are signed; a negative one is far too large here.
    u32::from(x) < extent.width && u32::from(y) < extent.height && (-MOST_US..=MOST_US).contains(&t)
}

#[inline]
fn event(bytes: &[u8; EVENT]) -> (i64, u16, u16, u8) {
    let [t @ .., _, _, _, _, _, _, _, _] = *bytes;
    (
        i64::from_le_bytes(t),
        u16::from_le_bytes([bytes[8], bytes[9]]),
        u16::from_le_bytes([bytes[10], bytes[11]]),
        u8::from(bytes[12] != 0),
    )
}

/// Adds events to a chunk, and says how many were left out because they lie outside the array.
fn decode(events: &[u8], extent: Extent, chunk: &mut EventChunk) -> usize {
    let (events, _) = events.as_chunks::<EVENT>();
    let start = chunk.len();
    let end = start + events.len();
    chunk.t.resize(end, 0);
    chunk.x.resize(end, 0);
    chunk.y.resize(end, 0);
    chunk.on.resize(end, 0);
    let columns = chunk.t[start..]
        .iter_mut()
        .zip(&mut chunk.x[start..])
        .zip(&mut chunk.y[start..])
        .zip(&mut chunk.on[start..]);
    let mut all_inside = true;
    for (bytes, (((t, x), y), on)) in events.iter().zip(columns) {
        let event = event(bytes);
        all_inside &= is_inside(event.0, event.1, event.2, extent);
        (*t, *x, *y, *on) = (event.0.wrapping_mul(1000), event.1, event.2, event.3);
    }
    if !all_inside {
        // Rare: again, one by one.
        let mut kept = start;
        for bytes in events {
            let (t, x, y, on) = event(bytes);
            if is_inside(t, x, y, extent) {
                (chunk.t[kept], chunk.x[kept], chunk.y[kept], chunk.on[kept]) = (t * 1000, x, y, on);
                kept += 1;
            }
        }
        chunk.t.truncate(kept);
        chunk.x.truncate(kept);
        chunk.y.truncate(kept);
        chunk.on.truncate(kept);
    }
    end - chunk.len()
}

impl EventCursor for Cursor {
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        chunk.clear();
        chunk.t_in = None;
        while chunk.len() < CHUNK_EVENTS {
            if self.rest.is_empty() && !self.load()? {
                return Ok(!chunk.is_empty());
            }
            let end = self.rest.end.min(self.rest.start + EVENT * (CHUNK_EVENTS - chunk.len()));
            let outside = decode(&self.chain.content()[self.rest.start..end], self.extent, chunk);
            self.rest.start = end;
            let what = || {
                format!(
                    "{outside} events lie outside the {} pixels, or have impossible stamps; \
                                   they are left out",
                    self.extent
                )
            };
            let at = || self.packet.map(|packet| packet.place()).unwrap_or_default();
            self.losses.add_by(
                Cause::Outside,
                "events outside the pixels or with impossible stamps were left out",
                outside as u64,
                at,
                what,
            );
        }
        Ok(true)
    }

    fn seek(&mut self, t_ns: i64) -> Result<(), FormatError> {
        let t_us = t_ns.div_euclid(1000);
        let marks = self
            .file
            .marks(|file| marks_by_reading(&file.path, &file.header, file.index.end, self.stream))?;
        let mut latest = i64::MIN;
        // The first mark whose packets have, or come after, the latest stamp so far that is not before the
        // time.
        let mark = marks.iter().find(|mark| {
            latest = latest.max(mark.latest_us);
            latest >= t_us
        });
        self.rest = 0..0;
        self.chain.go_to(mark.map_or(self.file.index.end, |mark: &Mark| mark.at));
        Ok(())
    }

    fn losses(&self) -> Vec<Loss> {
        self.losses.list()
    }

    fn position(&self) -> (u64, u64) {
        self.chain.position()
    }
}
