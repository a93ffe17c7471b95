//! Events from the order of rows into the order of time, in bounded memory: for recordings, which are written
//! in that of time.
//!
//! Two passes over the rows. The first draws instants that cut time into slices of about equal numbers of
//! events; the second puts every event into its slice, in memory as long as they are few and in a temporary
//! file beyond that. Then each slice is sorted by itself. Equal stamps stay in the order of rows, and inside
//! a row in their own.

use crate::error::StoreError;
use photocurrent_core::{EventBand, EventStream, Rows};
use std::fs::File;
use std::io::Write;
use std::os::unix::fs::FileExt;
use std::path::Path;

/// How much is held at a time.
#[derive(Clone, Copy)]
pub(super) struct Sizes {
    /// About how many events are put into the order of time at once.
    pub slice: usize,
    /// Events that may be held in memory before the temporary file is used.
    pub held: usize,
    /// About how many bytes of rows are read at once.
    pub band: u64,
}

impl Default for Sizes {
    fn default() -> Sizes {
        Sizes { slice: 1 << 20, held: 4 << 20, band: 32 << 20 }
    }
}

/// Events as columns.
#[derive(Default)]
pub(super) struct Slice {
    pub t: Vec<i64>,
    /// Empty where in-pixel times are not known.
    pub t_in: Vec<i64>,
    pub x: Vec<u16>,
    pub y: Vec<u16>,
    pub on: Vec<u8>,
}

impl Slice {
    fn append(&mut self, other: &Slice) {
        self.t.extend_from_slice(&other.t);
        self.t_in.extend_from_slice(&other.t_in);
        self.x.extend_from_slice(&other.x);
        self.y.extend_from_slice(&other.y);
        self.on.extend_from_slice(&other.on);
    }

    fn bytes(&self) -> u64 {
        (self.t.len() * 13 + self.t_in.len() * 8) as u64
    }

    fn clear(&mut self) {
        self.t.clear();
        self.t_in.clear();
        self.x.clear();
        self.y.clear();
        self.on.clear();
    }

    /// By stamp, what is equal as it stands.
    fn sorted(&self) -> Slice {
        let mut order: Vec<u32> = (0..self.t.len() as u32).collect();
        // Stable, and quick for pieces that are in order.
        order.sort_by_key(|&index| self.t[index as usize]);
        fn picked<T: Copy>(order: &[u32], column: &[T]) -> Vec<T> {
            if column.is_empty() {
                Vec::new()
            } else {
                order.iter().map(|&index| column[index as usize]).collect()
            }
        }
        Slice {
            t: picked(&order, &self.t),
            t_in: picked(&order, &self.t_in),
            x: picked(&order, &self.x),
            y: picked(&order, &self.y),
            on: picked(&order, &self.on),
        }
    }
}

/// A slice of time on its way: what lies in the file, and what came after it.
#[derive(Default)]
struct Pieces {
    spilled: Vec<(u64, usize)>,
    held: Slice,
}

/// Gives all events in the order of time, slice after slice.
///
/// # Errors
/// When events cannot be read, no temporary file can be written, or `take` says so.
pub(super) fn for_slices_of_time(
    events: &EventStream,
    sizes: Sizes,
    mut take: impl FnMut(&Slice) -> Result<(), StoreError>,
) -> Result<(), StoreError> {
    let (ends, bands) = ends_of_slices(events, sizes)?;
    let mut slices: Vec<Pieces> = (0..=ends.len()).map(|_| Pieces::default()).collect();
    let (mut spool, mut held) = (Spool { has_t_in: events.meta.has_t_in, ..Spool::default() }, 0);
    for rows in bands {
        let band = events.read(rows).map_err(StoreError::Source)?;
        for row in rows.iter() {
            put(&band, row, &ends, &mut slices);
        }
        held += band.len();
        if held > sizes.held {
            slices.iter_mut().try_for_each(|slice| spool.spill(slice))?;
            held = 0;
        }
    }
    for pieces in slices {
        let slice = spool.load(pieces)?;
        if !slice.t.is_empty() {
            take(&slice.sorted())?;
        }
    }
    Ok(())
}

/// Instants at which slices end, and bands of about the wanted size.
fn ends_of_slices(events: &EventStream, sizes: Sizes) -> Result<(Vec<i64>, Vec<Rows>), StoreError> {
    let all = events.rows();
    let bytes = events
        .bytes(all)
        .unwrap_or_else(|| photocurrent_core::Meta::Events(events.meta.clone()).estimated_bytes());
    let height = (sizes.band / (bytes / all.len().max(1) as u64).max(1)).clamp(1, u64::from(u32::MAX)) as u32;
    let bands = all.bands(height);
    // Every hundredth part of a slice marks where slices may end: they differ by some per cent in size, and
    // by more where many stamps are equal.
    let (step, mut marks, mut count) = ((sizes.slice / 100).max(1), Vec::new(), 0);
    for rows in &bands {
        let band = events.read(*rows).map_err(StoreError::Source)?;
        marks.extend(band.t.iter().skip((step - count % step) % step).step_by(step).copied());
        count += band.len();
    }
    marks.sort_unstable();
    let slices = count.div_ceil(sizes.slice.max(1));
    Ok(((1..slices).map(|k| marks[marks.len() * k / slices]).collect(), bands))
}

/// Puts a row's events, which are in order already, into their slices.
fn put(band: &EventBand, row: u32, ends: &[i64], slices: &mut [Pieces]) {
    let here = band.row(row);
    let mut from = 0;
    for (k, slice) in slices.iter_mut().enumerate() {
        let to = ends.get(k).map_or(here.len(), |&end| here.t.partition_point(|&t| t < end)).max(from);
        let held = &mut slice.held;
        held.t.extend_from_slice(&here.t[from..to]);
        held.x.extend_from_slice(&here.x[from..to]);
        held.on.extend_from_slice(&here.on[from..to]);
        held.y.extend(std::iter::repeat_n(row as u16, to - from));
        held.t_in.extend(here.t_in.iter().flat_map(|t_in| &t_in[from..to]));
        from = to;
    }
}

/// The temporary file.
#[derive(Default)]
struct Spool {
    file: Option<File>,
    written: u64,
    has_t_in: bool,
}

impl Spool {
    fn spill(&mut self, pieces: &mut Pieces) -> Result<(), StoreError> {
        let failed =
            |error: std::io::Error| StoreError::io(Path::new("temporary file"), "write events", error);
        let file = match &mut self.file {
            Some(file) => file,
            none => none.insert(tempfile::tempfile().map_err(failed)?),
        };
        let held = &mut pieces.held;
        let columns: [&[u8]; 5] = [
            bytemuck::cast_slice(&held.t),
            bytemuck::cast_slice(&held.t_in),
            bytemuck::cast_slice(&held.x),
            bytemuck::cast_slice(&held.y),
            &held.on,
        ];
        for bytes in columns {
            file.write_all(bytes).map_err(failed)?;
        }
        pieces.spilled.push((self.written, held.t.len()));
        self.written += held.bytes();
        held.clear();
        Ok(())
    }

    /// Everything of a slice, in the order in which it came.
    fn load(&self, pieces: Pieces) -> Result<Slice, StoreError> {
        let Some(file) = &self.file else { return Ok(pieces.held) };
        let mut slice = Slice::default();
        for (mut at, events) in pieces.spilled {
            let t_in = if self.has_t_in { vec![0; events] } else { Vec::new() };
            let mut piece = Slice {
                t: vec![0; events],
                x: vec![0; events],
                y: vec![0; events],
                on: vec![0; events],
                t_in,
            };
            let columns: [&mut [u8]; 5] = [
                bytemuck::cast_slice_mut(&mut piece.t),
                bytemuck::cast_slice_mut(&mut piece.t_in),
                bytemuck::cast_slice_mut(&mut piece.x),
                bytemuck::cast_slice_mut(&mut piece.y),
                &mut piece.on,
            ];
            for bytes in columns {
                file.read_exact_at(bytes, at)
                    .map_err(|error| StoreError::io(Path::new("temporary file"), "read events", error))?;
                at += bytes.len() as u64;
            }
            slice.append(&piece);
        }
        slice.append(&pieces.held);
        Ok(slice)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::events::{Event, Polarity};
    use photocurrent_core::random::Random;
    use photocurrent_core::{EventsMeta, Extent};
    use std::sync::Arc;

    /// Random events of forty rows at few instants, so that many are equal; each with its number as in-pixel
    /// time.
    fn stream(events: usize, instants: u64) -> (EventBand, EventStream) {
        let mut random = Random::new(1, &[instants]);
        let mut below = |n: u64| (random.bits() % n) as u16;
        let event = |k| Event {
            x: below(50),
            y: below(40),
            polarity: Polarity::On,
            t: i64::from(below(instants)) - 100,
            t_in: Some(k as i64 - 1_000_000),
        };
        let band =
            EventBand::from_events(Rows { start: 0, end: 40 }, (0..events).map(event).collect()).unwrap();
        let extent = Extent { width: 50, height: 40 };
        let meta = EventsMeta {
            extent,
            span: None,
            has_t_in: true,
            has_step: false,
            t_resolution_ns: None,
            count_hint: None,
        };
        (band.clone(), EventStream::in_memory(Arc::new(meta), band))
    }

    #[test]
    fn slices_of_time_put_together_are_a_stable_sort_in_memory_and_through_a_file() {
        for (events, instants, slice) in
            [(1, 5, 10), (3000, 20_000, 250), (3000, 20_000, 5000), (3000, 3, 40), (3000, 1, 40)]
        {
            let (band, stream) = stream(events, instants);
            let mut order: Vec<usize> = (0..events).collect();
            order.sort_by_key(|&index| band.t[index]);
            let row_of =
                |index: usize| (band.offsets().partition_point(|&offset| offset <= index) - 1) as u16;
            let t_in = band.t_in.as_ref().unwrap();
            let expected: Vec<(i64, i64, u16, u16)> =
                order.iter().map(|&k| (band.t[k], t_in[k], band.x[k], row_of(k))).collect();
            for (held, bytes) in [(usize::MAX, u64::MAX), (0, 1), (700, 20_000)] {
                let (mut found, mut slices) = (Vec::new(), 0);
                for_slices_of_time(&stream, Sizes { slice, held, band: bytes }, |slice| {
                    found.extend(
                        (0..slice.t.len()).map(|k| (slice.t[k], slice.t_in[k], slice.x[k], slice.y[k])),
                    );
                    assert!(slice.on.iter().all(|&on| on == 1) && slice.on.len() == slice.t.len());
                    slices += 1;
                    Ok(())
                })
                .unwrap();
                assert_eq!(found, expected);
                assert!(slices <= events.div_ceil(slice), "{slices}");
            }
        }
    }
}
