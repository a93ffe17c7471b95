//! Walks over the events of one topic.

use super::contents::Contents;
use super::messages::{Event, EventArray, EventPacket, Kind};
use super::packets::{Encoding, PacketDecoder};
use super::piece::Envelope;
use super::topics::Group;
use super::walk::Walker;
use super::wire::{Layout, Wire, label};
use crate::chunk::{CHUNK_EVENTS, EventChunk, Trigger};
use crate::error::{Cause, FormatError, Loss};
use crate::losses::Losses;
use crate::recording::EventCursor;
use photocurrent_core::Extent;
use std::sync::Arc;

/// Bytes of a packet that are decoded at a time: a vector word of two bytes can give twelve events.
const PACKET_PART: usize = 1 << 15;

/// Where the events come from.
#[derive(Clone)]
pub(crate) struct Stream {
    /// The file.
    pub contents: Arc<Contents>,
    /// The topic.
    pub group: Group,
    /// Encoding of packets; `None` for arrays.
    pub encoding: Option<Encoding>,
    /// Events outside are left out.
    pub extent: Option<Extent>,
    /// Is added to sensor times, ns.
    pub shift_ns: i64,
}

/// A part of a message that is still to be decoded.
enum Pending {
    /// Events of an array: place of the next, and how many are left.
    Array { at: usize, left: u32, layout: Layout },
    /// Bytes of a packet, from and to; and its stamp.
    Packet { from: usize, to: usize, stamp: i64 },
}

/// A cursor over the events of a topic.
pub(crate) struct Cursor {
    stream: Stream,
    walker: Walker,
    decoder: Option<PacketDecoder>,
    /// The connection and the number of the last packet.
    last: Option<(u32, u64)>,
    /// Is it not known how often the sensor's time has wrapped?
    lost_wraps: bool,
    /// What is added for wraps that the decoder did not see, ns.
    wraps_ns: i64,
    pending: Option<Pending>,
    /// Edges of the packets since the last call.
    pub triggers: Vec<Trigger>,
}

impl Cursor {
    /// At the first event.
    pub(crate) fn new(stream: Stream) -> Cursor {
        let walker = Walker::new(&stream.contents, &stream.group.ids());
        Cursor {
            stream,
            walker,
            decoder: None,
            last: None,
            lost_wraps: false,
            wraps_ns: 0,
            pending: None,
            triggers: Vec::new(),
        }
    }

    /// Goes to the first message of a piece.
    fn go_to(&mut self, piece: usize) {
        self.walker.go_to(piece);
        self.decoder = None;
        self.last = None;
        self.lost_wraps = piece > 0;
        self.wraps_ns = 0;
        self.pending = None;
    }

    /// Takes up a message that the walker has read.
    fn begin(&mut self, envelope: Envelope) {
        let Walker { body, losses, .. } = &mut self.walker;
        let at = || format!("message received at {} ns", envelope.received);
        let wire = self.stream.group.serial(envelope.id).and_then(|serial| serial.wire(body));
        if self.stream.group.kind == Kind::EventArray {
            let Some(array) = wire.and_then(EventArray::read) else {
                losses.add("messages that are no event array", at, || {
                    "the message is no event array; it is left out".into()
                });
                return;
            };
            let held = (body.len() - array.at) / EventArray::EVENT_BYTES;
            if array.count as usize > held {
                let what = format!("it claims {} events and holds {held}; those are read", array.count);
                losses.add_by(Cause::Cut, "event arrays that are cut off", 1, at, || what);
            }
            let left = array.count.min(u32::try_from(held).unwrap_or(u32::MAX));
            self.pending = Some(Pending::Array { at: array.at, left, layout: array.layout });
            return;
        }
        let Some(packet) = wire.and_then(EventPacket::read) else {
            losses.add("messages that are no event packet", at, || {
                "the message is no event packet; it is left out".into()
            });
            return;
        };
        let Some(encoding) =
            self.stream.encoding.filter(|encoding| Some(*encoding) == Encoding::named(packet.encoding))
        else {
            losses.add("packets in another encoding", at, || {
                format!("the packet is encoded as `{}`, unlike the first", label(packet.encoding))
            });
            return;
        };
        let same = matches!(self.last, Some((id, _)) if id == envelope.id);
        if !same || self.decoder.is_none() {
            // Another driver, or the same one started again: nothing that was left over holds.
            self.lost_wraps |= self.last.is_some();
            self.decoder = Some(PacketDecoder::new(encoding, self.stream.extent));
            self.wraps_ns = 0;
        } else if let Some((_, before)) = self.last
            && packet.sequence != before.wrapping_add(1)
        {
            let missing = packet
                .sequence
                .checked_sub(before)
                .map_or("the numbers of packets begin again".to_string(), |step| {
                    format!("{} packets before it are missing", step.saturating_sub(1))
                });
            losses.add("gaps between packets", at, || {
                format!("packet {} follows packet {before}: {missing}", packet.sequence)
            });
            self.lost_wraps = true;
        }
        self.last = Some((envelope.id, packet.sequence));
        if let Some(decoder) = &mut self.decoder {
            decoder.begin(packet.time_base, packet.big);
        }
        let to = packet.at + packet.events.len();
        let stamp = if packet.stamp.is_sound() { packet.stamp.ns } else { 0 };
        self.pending = Some(Pending::Packet { from: packet.at, to, stamp });
    }

    /// Decodes a part of the message that was taken up.
    fn go_on(&mut self, pending: Pending, chunk: &mut EventChunk) {
        match pending {
            Pending::Array { at, left, layout } => self.array(at, left, layout, chunk),
            Pending::Packet { from, to, stamp } => self.packet(from, to, stamp, chunk),
        }
    }

    fn array(&mut self, at: usize, left: u32, layout: Layout, chunk: &mut EventChunk) {
        let Walker { body, losses, .. } = &mut self.walker;
        let now = left.min(CHUNK_EVENTS as u32);
        let mut wire = Wire::resume(body, at, layout);
        let (width, height) =
            self.stream.extent.map_or((1 << 16, 1 << 16), |extent| (extent.width, extent.height));
        let (mut outside, mut timeless, mut missing) = (0_u32, 0_u32, 0_u32);
        for k in 0..now {
            let Some(event) = Event::read(&mut wire) else {
                missing = now - k;
                break;
            };
            if u32::from(event.x) >= width || u32::from(event.y) >= height {
                outside += 1;
            } else if !event.stamp.is_sound() {
                timeless += 1;
            } else {
                chunk.push(event.stamp.ns, event.x, event.y, event.on);
            }
        }
        lose_events(losses, at, [0, u64::from(outside), 0, 0], self.stream.extent);
        let what = || format!("{timeless} events have no sound stamp; they are left out");
        losses.add_by(
            Cause::Stamp,
            "events without a sound stamp were left out",
            u64::from(timeless),
            || format!("event array, byte {at}"),
            what,
        );
        if missing > 0 {
            losses.add_by(
                Cause::Cut,
                "event arrays that are cut off",
                1,
                || format!("event array, byte {at}"),
                || format!("the last {missing} events are cut off"),
            );
        } else if left > now {
            self.pending = Some(Pending::Array { at: wire.at(), left: left - now, layout });
        }
    }

    fn packet(&mut self, from: usize, to: usize, stamp: i64, chunk: &mut EventChunk) {
        let Walker { body, losses, .. } = &mut self.walker;
        let Some(decoder) = &mut self.decoder else { return };
        let until = to.min(from + PACKET_PART);
        let (events, edges) = (chunk.t.len(), self.triggers.len());
        let before = decoder.faults().counts();
        decoder.decode(body.get(from..until).unwrap_or_default(), chunk, &mut self.triggers);
        let after = decoder.faults().counts();
        lose_events(
            losses,
            from,
            [0, 1, 2, 3].map(|k| after[k].saturating_sub(before[k])),
            self.stream.extent,
        );
        if self.lost_wraps && stamp != 0 {
            let first = chunk.t.get(events).copied().or_else(|| self.triggers.get(edges).map(|edge| edge.t));
            if let Some(first) = first {
                self.wraps_ns =
                    missed_wraps(decoder.encoding(), stamp.saturating_sub(self.stream.shift_ns), first);
                self.lost_wraps = false;
            }
        }
        let shift = self.stream.shift_ns.saturating_add(self.wraps_ns);
        for t in &mut chunk.t[events..] {
            *t = t.saturating_add(shift);
        }
        for edge in &mut self.triggers[edges..] {
            edge.t = edge.t.saturating_add(shift);
        }
        if until < to {
            self.pending = Some(Pending::Packet { from: until, to, stamp });
        }
    }

    /// The time of the first event of a piece.
    fn first_time(&self, piece: usize) -> Result<Option<i64>, FormatError> {
        let mut probe = Cursor::new(self.stream.clone());
        probe.go_to(piece);
        let mut chunk = EventChunk::default();
        while chunk.is_empty() {
            if !probe.step(&mut chunk)? || probe.walker.piece() != piece {
                return Ok(None);
            }
        }
        Ok(chunk.t.first().copied())
    }

    /// Decodes a little more. False at the end.
    fn step(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        match self.pending.take() {
            Some(pending) => self.go_on(pending, chunk),
            None => match self.walker.advance()? {
                Some(envelope) => self.begin(envelope),
                None => return Ok(false),
            },
        }
        Ok(true)
    }
}

/// How many wraps lie between the time that a packet should have and the time that was decoded from it, in
/// ns.
fn missed_wraps(encoding: Encoding, expected: i64, decoded: i64) -> i64 {
    let Some(wrap) = encoding.wrap_ns() else { return 0 };
    let off = expected.saturating_sub(decoded).saturating_add(wrap / 2);
    off.div_euclid(wrap).saturating_mul(wrap)
}

/// Notes events that a decoder left out: before any time, outside, unknown words, strays.
fn lose_events(losses: &mut Losses, at: usize, counts: [u64; 4], extent: Option<Extent>) {
    let size = extent
        .map(|extent| format!("{}x{}", extent.width, extent.height))
        .unwrap_or("the pixel array".into());
    let [early, outside, unknown, strays] = counts;
    let mut note = |kind: &'static str, count: u64, what: &str| {
        let cause = if kind.starts_with("events outside") { Cause::Outside } else { Cause::Damage };
        losses.add_by(
            cause,
            kind,
            count,
            || format!("event message, byte {at} of it"),
            || format!("{count} {what}"),
        );
    };
    note(
        "events outside the pixel array were left out",
        outside,
        &format!("events lie outside {size}; they are left out"),
    );
    note(
        "events before the first time were left out",
        early,
        "events come before the first time; they are left out",
    );
    note("words of no known kind were left out", unknown, "words are of no known kind; they are left out");
    note(
        "times that leap away and back were undone",
        strays,
        "times leap away and back; events in between have a wrong stamp",
    );
}

impl EventCursor for Cursor {
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        chunk.clear();
        self.triggers.clear();
        while chunk.len() < CHUNK_EVENTS / 2 && self.triggers.len() < CHUNK_EVENTS {
            if !self.step(chunk)? {
                return Ok(!chunk.is_empty());
            }
        }
        Ok(true)
    }

    /// Looks into pieces, halving their number each time, and goes to the one before that whose events begin
    /// after `t_ns`.
    fn seek(&mut self, t_ns: i64) -> Result<(), FormatError> {
        let ids = self.stream.group.ids();
        let has = |counts: &Vec<(u32, u64)>| counts.iter().any(|(id, _)| ids.contains(id));
        let pieces = self.stream.contents.pieces.iter().enumerate();
        let with: Vec<usize> = pieces
            .filter(|(_, piece)| piece.counts.as_ref().is_none_or(has))
            .map(|(index, _)| index)
            .collect();
        let (mut low, mut high) = (0, with.len());
        while low < high {
            let middle = low + (high - low) / 2;
            // A piece without events does not say; then an earlier one is looked at.
            match self.first_time(with[middle])? {
                Some(first) if first <= t_ns => low = middle + 1,
                _ => high = middle,
            }
        }
        // The last piece that begins in time, and one before it: messages overlap, and words of a packet can
        // go on in the next.
        self.go_to(low.checked_sub(2).map_or(0, |index| with[index]));
        Ok(())
    }

    fn losses(&self) -> Vec<Loss> {
        self.walker.losses.list()
    }

    fn position(&self) -> (u64, u64) {
        (self.walker.position(), self.stream.contents.size)
    }
}
