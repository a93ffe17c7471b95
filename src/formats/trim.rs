//! A part of an event stream: a rectangle of pixels, a window of time, another zero; and a stream brought
//! into order of time.

use crate::chunk::{CHUNK_EVENTS, EventChunk};
use crate::error::{FormatError, Loss};
use crate::recording::EventCursor;
use std::path::Path;

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crop {
    /// First column inside.
    pub x: u32,
    /// First row inside.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl Crop {
    /// Where a pixel stands in the rectangle; `None` outside.
    #[inline]
    pub fn inside(self, x: u16, y: u16) -> Option<(u16, u16)> {
        let (x, y) = (u32::from(x).checked_sub(self.x)?, u32::from(y).checked_sub(self.y)?);
        (x < self.width && y < self.height).then_some((x as u16, y as u16))
    }
}

/// What is kept, and how it is moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trim {
    /// Only these pixels; they are numbered from 0 afterwards.
    pub crop: Option<Crop>,
    /// Only events at or after this, on the file's clock, ns.
    pub start_ns: i64,
    /// Only events before this.
    pub end_ns: i64,
    /// Are the stamps in order, so that nothing after `end_ns` is wanted?
    pub ordered: bool,
    /// Subtracted from every stamp.
    pub zero_ns: i64,
}

/// A cursor over a part of another's events.
pub struct Trimmed {
    inner: Box<dyn EventCursor>,
    trim: Trim,
    piece: EventChunk,
    ended: bool,
}

impl Trimmed {
    /// Begins at the first event that is kept.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn new(mut inner: Box<dyn EventCursor>, trim: Trim) -> Result<Trimmed, FormatError> {
        if trim.start_ns > i64::MIN {
            inner.seek(trim.start_ns)?;
        }
        Ok(Trimmed { inner, trim, piece: EventChunk::default(), ended: false })
    }
}

impl EventCursor for Trimmed {
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        chunk.clear();
        if self.ended || !self.inner.next(&mut self.piece)? {
            return Ok(false);
        }
        let (trim, piece) = (&self.trim, &self.piece);
        let mut t_in = piece.t_in.as_ref().map(|_| Vec::with_capacity(piece.len()));
        for i in 0..piece.len() {
            let (t, x, y) = (piece.t[i], piece.x[i], piece.y[i]);
            if t < trim.start_ns {
                continue;
            }
            if t >= trim.end_ns {
                if trim.ordered {
                    self.ended = true;
                    break;
                }
                continue;
            }
            let (x, y) = match trim.crop {
                None => (x, y),
                Some(crop) => match crop.inside(x, y) {
                    Some(place) => place,
                    None => continue,
                },
            };
            chunk.push(t.saturating_sub(trim.zero_ns), x, y, piece.on[i] != 0);
            if let (Some(kept), Some(t_in)) = (&mut t_in, &piece.t_in) {
                kept.push(t_in[i].saturating_sub(trim.zero_ns));
            }
        }
        chunk.t_in = t_in;
        Ok(true)
    }

    fn seek(&mut self, t_ns: i64) -> Result<(), FormatError> {
        self.ended = false;
        self.inner.seek(t_ns.saturating_add(self.trim.zero_ns).max(self.trim.start_ns))
    }

    crate::recording::forward_cursor!(inner);
}

/// No more events are sorted in memory: about 1.3 GB of columns.
const MOST_SORTED: usize = 100_000_000;

/// All events of a stream that is out of order, sorted by time; ties keep file order.
pub struct InOrder {
    sorted: EventChunk,
    next: usize,
    losses: Vec<Loss>,
}

impl InOrder {
    /// Reads everything.
    ///
    /// # Errors
    /// When the file cannot be read, or there are too many events.
    pub fn new(mut inner: Box<dyn EventCursor>) -> Result<InOrder, FormatError> {
        let (mut all, mut chunk) = (EventChunk::default(), EventChunk::default());
        while inner.next(&mut chunk)? {
            if all.len() + chunk.len() > MOST_SORTED {
                let found = format!("events out of order, more than {MOST_SORTED} of them");
                return Err(FormatError::new(
                    Path::new(""),
                    found,
                    "take a part of the recording: --start and --end",
                ));
            }
            all.t.extend_from_slice(&chunk.t);
            all.x.extend_from_slice(&chunk.x);
            all.y.extend_from_slice(&chunk.y);
            all.on.extend_from_slice(&chunk.on);
            if let Some(t_in) = &chunk.t_in {
                all.t_in.get_or_insert_default().extend_from_slice(t_in);
            }
        }
        let mut order: Vec<u32> = (0..all.len() as u32).collect();
        order.sort_by_key(|&i| all.t[i as usize]);
        fn gather<T: Copy>(order: &[u32], column: &[T]) -> Vec<T> {
            order.iter().map(|&i| column[i as usize]).collect()
        }
        let t_in = all.t_in.as_ref().map(|column| gather(&order, column));
        let sorted = EventChunk {
            t: gather(&order, &all.t),
            x: gather(&order, &all.x),
            y: gather(&order, &all.y),
            on: gather(&order, &all.on),
            t_in,
        };
        Ok(InOrder { sorted, next: 0, losses: inner.losses() })
    }
}

impl EventCursor for InOrder {
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        chunk.clear();
        let piece = self.next..self.sorted.len().min(self.next + CHUNK_EVENTS);
        if piece.is_empty() {
            return Ok(false);
        }
        chunk.t.extend_from_slice(&self.sorted.t[piece.clone()]);
        chunk.x.extend_from_slice(&self.sorted.x[piece.clone()]);
        chunk.y.extend_from_slice(&self.sorted.y[piece.clone()]);
        chunk.on.extend_from_slice(&self.sorted.on[piece.clone()]);
        chunk.t_in = self.sorted.t_in.as_ref().map(|column| column[piece.clone()].to_vec());
        self.next = piece.end;
        Ok(true)
    }

    fn seek(&mut self, t_ns: i64) -> Result<(), FormatError> {
        self.next = self.sorted.t.partition_point(|&t| t < t_ns);
        Ok(())
    }

    fn losses(&self) -> Vec<Loss> {
        self.losses.clone()
    }

    fn position(&self) -> (u64, u64) {
        (self.next as u64, self.sorted.len() as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten pieces of ten events: event i at time 10 i, in column i mod 7 and row i mod 5.
    struct Counting(u64);

    impl EventCursor for Counting {
        fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
            chunk.clear();
            let first = self.0 * 10;
            if first >= 100 {
                return Ok(false);
            }
            (first..first + 10)
                .for_each(|i| chunk.push(10 * i as i64, (i % 7) as u16, (i % 5) as u16, i % 2 == 0));
            self.0 += 1;
            Ok(true)
        }
        fn seek(&mut self, t_ns: i64) -> Result<(), FormatError> {
            self.0 = (t_ns.max(0) as u64 / 100).min(10);
            Ok(())
        }
        fn losses(&self) -> Vec<Loss> {
            Vec::new()
        }
        fn position(&self) -> (u64, u64) {
            (self.0, 10)
        }
    }

    #[test]
    fn a_rectangle_and_a_window_are_kept_and_numbered_from_zero() {
        let crop = Some(Crop { x: 2, y: 1, width: 3, height: 2 });
        let trim = Trim { crop, start_ns: 155, end_ns: 705, ordered: true, zero_ns: 100 };
        let mut trimmed = Trimmed::new(Box::new(Counting(0)), trim).unwrap();
        let (mut found, mut chunk) = (Vec::new(), EventChunk::default());
        while trimmed.next(&mut chunk).unwrap() {
            found.extend((0..chunk.len()).map(|i| (chunk.t[i], chunk.x[i], chunk.y[i], chunk.on[i])));
        }
        let inside = |i: &i64| {
            (155..705).contains(&(10 * i)) && (2..5).contains(&(i % 7)) && (1..3).contains(&(i % 5))
        };
        let expected: Vec<_> = (0..100)
            .filter(inside)
            .map(|i| (10 * i - 100, (i % 7 - 2) as u16, (i % 5 - 1) as u16, u8::from(i % 2 == 0)))
            .collect();
        assert_eq!(found, expected);
        assert!(!expected.is_empty());
    }
}
