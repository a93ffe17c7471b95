//! Prophesee's event codec (filter 0x8ECF): a chunk of at most 65,535 events, column by column.
//!
//! Written after the layout of the published codec (`hdf5_ecf`). All numbers are little-endian: a u32 (count
//! << 2, bit 1: y, x and p packed together, bit 0: x and p packed together), the first stamp as u64, then
//!
//! - stamps: a byte is (step << 4 | run); run 15 means that a u16 with the run follows; step 15 means that
//!   the byte carries four more bits of a larger step, lowest first, until another byte ends it;
//! - y: a u16 is (y << 5 | run), run 31 means that a u16 with the run follows;
//! - x: a u16 is (x << 5 | mask), bit 4 - j of the mask saying that an event at x + j + 1 follows;
//! - p: a byte is (p << 7 | run), run 127 means that a u16 with the run follows;
//! - x and p together: four times 12 bits (x << 1 | p) in three u16; y, x and p together: four times 24 bits
//!   (y << 12 | x << 1 | p) in three u32.
//!
//! An event comes out as 16 bytes {x u16, y u16, p i16, two bytes of nothing, t i64}, as the datasets declare
//! it.

use super::{Bytes, Filled, full};

/// Events in a chunk at most.
const MOST: usize = 65_535;
/// Bytes of an event.
pub(crate) const EVENT: usize = 16;

/// Unpacks a chunk. A last chunk may hold fewer events than there is room for: the rest becomes zero.
pub(crate) fn ecf(bytes: &[u8], out: &mut [u8]) -> Filled {
    let mut from = Bytes::new(bytes);
    let head = from.u32()?;
    let count = (head >> 2) as usize;
    if count > MOST || count * EVENT > out.len() {
        return Err(format!("ECF: {count} events in a chunk for {}", (out.len() / EVENT).min(MOST)));
    }
    if !out.len().is_multiple_of(EVENT) {
        return full(count * EVENT, out);
    }
    let (events, rest) = out.split_at_mut(count * EVENT);
    rest.fill(0);
    let (events, _) = events.as_chunks_mut::<EVENT>();
    if count == 0 {
        return Ok(());
    }
    stamps(&mut from, events)?;
    if head & 2 != 0 {
        return packed_24(&mut from, events);
    }
    rows(&mut from, events)?;
    if head & 1 != 0 {
        return packed_12(&mut from, events);
    }
    columns(&mut from, events)?;
    polarities(&mut from, events)
}

type Event = [u8; EVENT];

fn set(event: &mut Event, at: usize, value: u16) {
    [event[at], event[at + 1]] = value.to_le_bytes();
}

/// Gives a run of events to `of`, refusing one that is empty (it would never end) or longer than what is
/// left.
fn run(events: &mut [Event], at: &mut usize, length: usize, mut of: impl FnMut(&mut Event)) -> Filled {
    let left = events.len() - *at;
    if length == 0 || length > left {
        return Err(format!("ECF: a run of {length} where {left} events are left"));
    }
    events[*at..*at + length].iter_mut().for_each(&mut of);
    *at += length;
    Ok(())
}

fn stamps(from: &mut Bytes, events: &mut [Event]) -> Filled {
    let mut t = u64::from_le_bytes(from.array()?);
    let mut at = 0;
    while at < events.len() {
        let mut byte = from.u8()?;
        let (mut step, mut shift) = (0u64, 0);
        while byte >> 4 == 15 {
            if shift >= 64 {
                return Err("ECF: a step of more than 64 bits".into());
            }
            step |= u64::from(byte & 15) << shift;
            shift += 4;
            byte = from.u8()?;
        }
        t = t.wrapping_add(step).wrapping_add(u64::from(byte >> 4));
        let length = if byte & 15 == 15 { from.u16()?.into() } else { usize::from(byte & 15) };
        let stamp = t.to_le_bytes();
        run(events, &mut at, length, |event| event[8..].copy_from_slice(&stamp))?;
    }
    Ok(())
}

fn rows(from: &mut Bytes, events: &mut [Event]) -> Filled {
    let mut at = 0;
    while at < events.len() {
        let word = from.u16()?;
        let length = if word & 31 == 31 { from.u16()?.into() } else { usize::from(word & 31) };
        run(events, &mut at, length, |event| set(event, 2, word >> 5))?;
    }
    Ok(())
}

fn columns(from: &mut Bytes, events: &mut [Event]) -> Filled {
    let mut at = 0;
    while at < events.len() {
        let word = from.u16()?;
        let x = word >> 5;
        set(&mut events[at], 0, x);
        at += 1;
        for j in 0..5 {
            if word & (1 << (4 - j)) != 0 && at < events.len() {
                set(&mut events[at], 0, x + j + 1);
                at += 1;
            }
        }
    }
    Ok(())
}

fn polarities(from: &mut Bytes, events: &mut [Event]) -> Filled {
    let mut at = 0;
    while at < events.len() {
        let byte = from.u8()?;
        let length = if byte & 127 == 127 { from.u16()?.into() } else { usize::from(byte & 127) };
        run(events, &mut at, length, |event| set(event, 4, (byte >> 7).into()))?;
    }
    Ok(())
}

fn packed_12(from: &mut Bytes, events: &mut [Event]) -> Filled {
    for four in events.chunks_mut(4) {
        let [a, b, c] = [from.u16()?, from.u16()?, from.u16()?];
        let values = [a >> 4, (a & 0xf) | ((b >> 8) << 4), (b & 0xff) | ((c >> 12) << 8), c & 0xfff];
        for (event, value) in four.iter_mut().zip(values) {
            set(event, 0, value >> 1);
            set(event, 4, value & 1);
        }
    }
    Ok(())
}

fn packed_24(from: &mut Bytes, events: &mut [Event]) -> Filled {
    for four in events.chunks_mut(4) {
        let [a, b, c] = [from.u32()?, from.u32()?, from.u32()?];
        let values = [a >> 8, (a & 0xff) | ((b >> 16) << 8), (b & 0xffff) | ((c >> 24) << 16), c & 0xff_ffff];
        for (event, value) in four.iter_mut().zip(values) {
            set(event, 0, ((value >> 1) & 0x7ff) as u16);
            set(event, 2, ((value >> 12) & 0x7ff) as u16);
            set(event, 4, (value & 1) as u16);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(x: u16, y: u16, p: u16, t: u64) -> Event {
        let mut event = [0; EVENT];
        set(&mut event, 0, x);
        set(&mut event, 2, y);
        set(&mut event, 4, p);
        event[8..].copy_from_slice(&t.to_le_bytes());
        event
    }

    /// Packed bytes that the published codec's own tests demand, written out by hand.
    #[test]
    fn the_published_examples_are_unpacked() {
        // One event, everything packed together: count 1 << 2 | 2, first stamp 4, a run of 1 at step 0, 2 <<
        // 12 | 1 << 1 | 0 in the upper 24 bits.
        let bytes = [&[6, 0, 0, 0, 4, 0, 0, 0, 0, 0, 0, 0, 0x01, 0, 0x02, 0x20, 0][..], &[0; 8]].concat();
        let mut out = [0; EVENT];
        ecf(&bytes, &mut out).unwrap();
        assert_eq!(out, event(1, 2, 0, 4));
        // Two events of one stamp and row, x and p packed together: 0 << 1 | 1 and 10 << 1 | 1 as 12 bits
        // each.
        let bytes =
            [9, 0, 0, 0, 0x10, 0x27, 0, 0, 0, 0, 0, 0, 0x02, 0xe2, 0x02, 0x15, 0x00, 0x00, 0x01, 0, 0];
        let mut out = [0; 3 * EVENT];
        ecf(&bytes, &mut out).unwrap();
        assert_eq!(
            out.as_chunks::<EVENT>().0,
            [event(0, 23, 1, 10_000), event(10, 23, 1, 10_000), [0; EVENT]]
        );
    }

    #[test]
    fn a_chunk_that_is_cut_anywhere_is_refused() {
        let bytes =
            [9, 0, 0, 0, 0x10, 0x27, 0, 0, 0, 0, 0, 0, 0x02, 0xe2, 0x02, 0x15, 0x00, 0x00, 0x01, 0, 0];
        for length in 0..bytes.len() {
            assert!(ecf(&bytes[..length], &mut [0; 2 * EVENT]).is_err(), "{length} bytes");
        }
        assert!(ecf(&bytes, &mut [0; EVENT]).is_err(), "more events than there is room for");
        // A run of no events would never end.
        let empty = [6, 0, 0, 0, 4, 0, 0, 0, 0, 0, 0, 0, 0x00, 0x00];
        assert!(ecf(&empty, &mut [0; EVENT]).is_err());
    }
}
