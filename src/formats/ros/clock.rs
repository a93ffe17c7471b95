//! Brings times of an event packet from the sensor's clock to that of ROS.
//!
//! A driver stamps a packet (`header.stamp`) when its bytes arrive on the host: never before its first event,
//! and later by what USB and the scheduler take. So `header.stamp` minus the first event's sensor time is the
//! offset of the clocks plus a delay of zero or more, and the smallest of many such differences is nearest to
//! the offset. It is taken over the first packets and then held: stamps jitter by milliseconds, the sensor's
//! clock does not.

use super::contents::Contents;
use super::messages::EventPacket;
use super::packets::{Encoding, PacketDecoder};
use super::topics::Group;
use super::walk::Walker;
use crate::chunk::EventChunk;
use crate::error::FormatError;
use std::sync::Arc;

/// Packets with events over which the smallest difference is taken.
const PACKETS: usize = 64;
/// Packets that are looked at for them.
const MOST_LOOKED_AT: usize = 1024;
/// Bytes of a packet that are decoded to find its first event.
const START_BYTES: usize = 4096;

/// How sensor times become ROS times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Shift {
    /// Is added to sensor times, ns.
    pub ns: i64,
    /// By how much the differences spread over the packets that were looked at, ns.
    pub spread_ns: i64,
    /// How many packets.
    pub packets: usize,
}

/// Looks at the first packets of a topic. `None` when none of them has an event.
///
/// # Errors
/// When the file has gone.
pub(crate) fn shift(
    contents: &Arc<Contents>,
    group: &Group,
    encoding: Encoding,
) -> Result<Option<Shift>, FormatError> {
    let mut walker = Walker::new(contents, &group.ids());
    let mut decoder = PacketDecoder::new(encoding, None);
    let (mut chunk, mut triggers) = (EventChunk::default(), Vec::new());
    let mut found: Option<Shift> = None;
    let mut largest = i64::MIN;
    for _ in 0..MOST_LOOKED_AT {
        let Some(envelope) = walker.advance()? else { break };
        let wire = group.serial(envelope.id).and_then(|serial| serial.wire(&walker.body));
        let Some(packet) = wire
            .and_then(EventPacket::read)
            .filter(|packet| Encoding::named(packet.encoding) == Some(encoding))
        else {
            continue;
        };
        decoder.begin(packet.time_base, packet.big);
        chunk.clear();
        // The rest is decoded too: it carries the wraps of the time.
        for part in packet.events.chunks(START_BYTES) {
            let known = chunk.t.first().copied();
            decoder.decode(part, &mut chunk, &mut triggers);
            if let Some(t) = known {
                chunk.clear();
                chunk.t.push(t);
            }
        }
        let first = chunk.t.first().copied();
        chunk.t.clear();
        triggers.clear();
        let Some(first) = first.filter(|_| packet.stamp.is_sound() && packet.stamp.ns != 0) else { continue };
        let difference = packet.stamp.ns.saturating_sub(first);
        largest = largest.max(difference);
        let so_far = found.unwrap_or(Shift { ns: difference, spread_ns: 0, packets: 0 });
        let ns = so_far.ns.min(difference);
        found = Some(Shift { ns, spread_ns: largest.saturating_sub(ns), packets: so_far.packets + 1 });
        if so_far.packets + 1 == PACKETS {
            break;
        }
    }
    Ok(found)
}
