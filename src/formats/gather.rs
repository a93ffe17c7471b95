//! Events of a file, by row: what turns a stream in time order into bands that nodes read, in bounded memory.
//!
//! Two passes over a cursor. [`scan`] finds what must be known before any data: how many events, from when to
//! when, how far the coordinates reach. [`gather`] sorts them by groups of rows as they come; what exceeds
//! the budget goes to an unnamed temporary file, group by group, and a band is read back and put into
//! canonical order (row, time, column) when it is asked for.
//!
//! Limits: a band is held whole, so a budget is kept only by those who read few rows at a time. The temporary
//! file takes 13 bytes an event (21 with in-pixel times), in the system's folder for temporary files.

use crate::chunk::EventChunk;
use crate::error::{FormatError, Loss};
use crate::recording::EventCursor;
use crate::trim::Crop;
use photocurrent_core::handle::BandSource;
use photocurrent_core::{DataError, EventBand, Extent, Rows};
use std::fs::File;
use std::io::Write;
use std::os::unix::fs::FileExt;

/// What one pass over all events finds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scan {
    /// Events.
    pub count: u64,
    /// Earliest and latest stamp; `None` without events.
    pub span: Option<(i64, i64)>,
    /// Events stamped earlier than the event ahead of them.
    pub disordered: u64,
    /// Largest column and row; `None` without events.
    pub corner: Option<(u16, u16)>,
    /// What was left out because it is damaged.
    pub losses: Vec<Loss>,
    /// Every n-th stamp in file order, at most [`KEPT_STAMPS`] of them.
    pub some_stamps: Vec<i64>,
    /// Events of each column and each row, up to the largest.
    pub places: (Vec<u64>, Vec<u64>),
}

/// Stamps that a scan keeps, at most.
const KEPT_STAMPS: usize = 1 << 16;

impl Scan {
    /// The shortest span that holds a share (0 to 1) of the kept stamps; a few strays do not widen it. `None`
    /// without events.
    pub fn dense_span(&self, share: f64) -> Option<(i64, i64)> {
        let mut sorted = self.some_stamps.clone();
        sorted.sort_unstable();
        let inside = ((share * sorted.len() as f64).ceil() as usize).clamp(1, sorted.len().max(1));
        sorted
            .windows(inside)
            .map(|window| (window[0], window[inside - 1]))
            .min_by_key(|(first, last)| last.saturating_sub(*first))
    }
}

impl Scan {
    /// Largest column and row without the few events beyond: a share (0 to 1) of the events lies within each.
    /// `None` without events.
    pub fn reach(&self, share: f64) -> Option<(u16, u16)> {
        let within = |counts: &[u64]| {
            let (mut below, wanted) = (0, (share * self.count as f64).ceil() as u64);
            counts.iter().position(|count| {
                below += count;
                below >= wanted.max(1)
            })
        };
        Some((within(&self.places.0)? as u16, within(&self.places.1)? as u16))
    }

    /// Events outside of an array.
    pub fn outside(&self, width: u32, height: u32) -> u64 {
        let beyond = |counts: &[u64], from: u32| counts.iter().skip(from as usize).sum::<u64>();
        // An event beyond both is counted twice: an upper bound, and mostly the number.
        (beyond(&self.places.0, width) + beyond(&self.places.1, height)).min(self.count)
    }
}

/// Walks over all events once. `advance` hears how many events each piece had, and may stop the walk.
///
/// # Errors
/// When the file cannot be read, or `advance` says so.
pub fn scan<E: From<FormatError>>(
    cursor: &mut dyn EventCursor,
    mut advance: impl FnMut(&dyn EventCursor) -> Result<(), E>,
) -> Result<Scan, E> {
    let (mut scan, mut chunk, mut ahead) = (Scan::default(), EventChunk::default(), i64::MIN);
    let (mut every, mut next) = (1u64, 0u64);
    while cursor.next(&mut chunk)? {
        if let (Some(&first), Some(&x), Some(&y)) =
            (chunk.t.first(), chunk.x.iter().max(), chunk.y.iter().max())
        {
            while next < scan.count + chunk.len() as u64 {
                scan.some_stamps.push(chunk.t[(next - scan.count) as usize]);
                next += every;
                if scan.some_stamps.len() == KEPT_STAMPS {
                    every *= 2;
                    next = next.next_multiple_of(every);
                    let mut index = 0;
                    scan.some_stamps.retain(|_| {
                        index += 1;
                        index % 2 == 1
                    });
                }
            }
            let most = |column: &[u16]| usize::from(column.iter().copied().max().unwrap_or(0)) + 1;
            for (counts, column) in [(&mut scan.places.0, &chunk.x), (&mut scan.places.1, &chunk.y)] {
                if counts.len() < most(column) {
                    counts.resize(most(column), 0);
                }
                column.iter().for_each(|at| counts[usize::from(*at)] += 1);
            }
            scan.count += chunk.len() as u64;
            let (mut earliest, mut latest) = scan.span.unwrap_or((first, first));
            for &t in &chunk.t {
                scan.disordered += u64::from(t < ahead);
                ahead = t;
                (earliest, latest) = (earliest.min(t), latest.max(t));
            }
            scan.span = Some((earliest, latest));
            let corner = scan.corner.unwrap_or((0, 0));
            scan.corner = Some((corner.0.max(x), corner.1.max(y)));
        }
        advance(cursor)?;
    }
    scan.losses = cursor.losses();
    Ok(scan)
}

/// What to gather.
#[derive(Clone, Copy, Debug)]
pub struct Wanted {
    /// Size of the pixel array, or of the part of it that is wanted; events outside the array are left out
    /// and counted.
    pub extent: Extent,
    /// The wanted part; `None` is the whole array. Its pixels are numbered from 0.
    pub crop: Option<Crop>,
    /// The file's time that becomes 0, ns.
    pub zero_ns: i64,
    /// Only events at or after this, ns from `zero_ns`.
    pub start_ns: i64,
    /// Only events before this.
    pub end_ns: i64,
    /// Are the stamps in order, so that nothing after `end_ns` is wanted?
    pub ordered: bool,
    /// With in-pixel times?
    pub t_in: bool,
    /// Bytes to hold in memory before a temporary file is used.
    pub budget: usize,
    /// Are events that are there twice read once?
    pub drop_duplicates: bool,
}

/// Rows of one group: few enough that a group is small, so many that the file has few pieces.
const GROUPS: u32 = 64;

/// The columns of some events of one group of rows.
#[derive(Default)]
struct Columns {
    y: Vec<u16>,
    x: Vec<u16>,
    on: Vec<u8>,
    t: Vec<i64>,
    t_in: Vec<i64>,
}

impl Columns {
    fn bytes(&self) -> usize {
        self.t.len() * (2 + 2 + 1 + 8) + self.t_in.len() * 8
    }

    fn clear(&mut self) {
        self.y.clear();
        self.x.clear();
        self.on.clear();
        self.t.clear();
        self.t_in.clear();
    }

    fn append(&mut self, other: &Columns) {
        self.y.extend_from_slice(&other.y);
        self.x.extend_from_slice(&other.x);
        self.on.extend_from_slice(&other.on);
        self.t.extend_from_slice(&other.t);
        self.t_in.extend_from_slice(&other.t_in);
    }

    /// Only the events of some rows, in the same order.
    fn keep(&mut self, rows: Rows) {
        let wanted: Vec<usize> =
            (0..self.y.len()).filter(|&i| (rows.start..rows.end).contains(&u32::from(self.y[i]))).collect();
        if wanted.len() == self.y.len() {
            return;
        }
        fn pick<T: Copy>(column: &mut Vec<T>, wanted: &[usize]) {
            if !column.is_empty() {
                *column = wanted.iter().map(|&i| column[i]).collect();
            }
        }
        pick(&mut self.x, &wanted);
        pick(&mut self.on, &wanted);
        pick(&mut self.t, &wanted);
        pick(&mut self.t_in, &wanted);
        pick(&mut self.y, &wanted);
    }
}

/// A run of events of one group in the temporary file.
struct Piece {
    at: u64,
    events: usize,
}

/// All events of one group of rows.
#[derive(Default)]
struct Group {
    spilled: Vec<Piece>,
    held: Columns,
}

/// Events sorted by groups of rows.
pub struct Gathered {
    extent: Extent,
    rows_per_group: u32,
    groups: Vec<Group>,
    file: Option<File>,
    has_t_in: bool,
    drop_duplicates: bool,
    /// Events that are here.
    pub count: u64,
    /// Events that lie outside the extent, and were left out.
    pub outside: u64,
    /// Earliest and latest stamp that is here, ns from zero.
    pub span: Option<(i64, i64)>,
}

/// Reads all events that are wanted. `advance` as in [`scan`].
///
/// # Errors
/// When the file cannot be read, no temporary file can be written, or `advance` says so.
pub fn gather<E: From<FormatError> + From<DataError>>(
    cursor: &mut dyn EventCursor,
    wanted: Wanted,
    mut advance: impl FnMut(&dyn EventCursor) -> Result<(), E>,
) -> Result<Gathered, E> {
    let height = wanted.extent.height.max(1);
    let rows_per_group = height.div_ceil(GROUPS).max(1);
    let groups = (0..height.div_ceil(rows_per_group)).map(|_| Group::default()).collect();
    let mut all = Gathered {
        extent: wanted.extent,
        rows_per_group,
        groups,
        file: None,
        has_t_in: wanted.t_in,
        drop_duplicates: wanted.drop_duplicates,
        count: 0,
        outside: 0,
        span: None,
    };
    let mut chunk = EventChunk::default();
    let mut written = 0;
    if wanted.start_ns > i64::MIN {
        cursor.seek(wanted.start_ns.saturating_add(wanted.zero_ns))?;
    }
    'read: while cursor.next(&mut chunk)? {
        for i in 0..chunk.len() {
            let t = chunk.t[i].saturating_sub(wanted.zero_ns);
            if t < wanted.start_ns {
                continue;
            }
            if t >= wanted.end_ns {
                if wanted.ordered {
                    break 'read;
                }
                continue;
            }
            let (x, y) = match wanted.crop {
                None => (chunk.x[i], chunk.y[i]),
                Some(crop) => match crop.inside(chunk.x[i], chunk.y[i]) {
                    Some(place) => place,
                    None => continue,
                },
            };
            if u32::from(x) >= wanted.extent.width || u32::from(y) >= wanted.extent.height {
                all.outside += 1;
                continue;
            }
            let (earliest, latest) = all.span.unwrap_or((t, t));
            all.span = Some((earliest.min(t), latest.max(t)));
            all.count += 1;
            let held = &mut all.groups[(u32::from(y) / rows_per_group) as usize].held;
            held.y.push(y);
            held.x.push(x);
            held.on.push(chunk.on[i]);
            held.t.push(t);
            if wanted.t_in {
                held.t_in
                    .push(chunk.t_in.as_ref().map_or(t, |column| column[i].saturating_sub(wanted.zero_ns)));
            }
        }
        let bytes: usize = all.groups.iter().map(|group| group.held.bytes()).sum();
        if bytes > wanted.budget {
            all.spill(&mut written).map_err(|error| {
                DataError::new(format!("cannot write a temporary file for {} events: {error}", all.count))
            })?;
        }
        advance(cursor)?;
    }
    Ok(all)
}

impl Gathered {
    /// Moves everything held to the file.
    fn spill(&mut self, written: &mut u64) -> std::io::Result<()> {
        let file = match &mut self.file {
            Some(file) => file,
            none => none.insert(tempfile::tempfile()?),
        };
        for group in self.groups.iter_mut().filter(|group| !group.held.t.is_empty()) {
            let held = &mut group.held;
            for bytes in [
                bytemuck::cast_slice(&held.y),
                bytemuck::cast_slice(&held.x),
                held.on.as_slice(),
                bytemuck::cast_slice(&held.t),
                bytemuck::cast_slice(&held.t_in),
            ] {
                file.write_all(bytes)?;
            }
            group.spilled.push(Piece { at: *written, events: held.t.len() });
            *written += held.bytes() as u64;
            held.clear();
        }
        Ok(())
    }

    /// Everything of one group, in file order.
    fn load(&self, group: &Group) -> std::io::Result<Columns> {
        fn column<T: bytemuck::Pod>(
            file: &File,
            at: &mut u64,
            events: usize,
            column: &mut Vec<T>,
        ) -> std::io::Result<()> {
            let begin = column.len();
            column.resize(begin + events, T::zeroed());
            let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut column[begin..]);
            file.read_exact_at(bytes, *at)?;
            *at += bytes.len() as u64;
            Ok(())
        }
        let mut all = Columns::default();
        if let Some(file) = &self.file {
            for piece in &group.spilled {
                let (mut at, events) = (piece.at, piece.events);
                column(file, &mut at, events, &mut all.y)?;
                column(file, &mut at, events, &mut all.x)?;
                column(file, &mut at, events, &mut all.on)?;
                column(file, &mut at, events, &mut all.t)?;
                if self.has_t_in {
                    column(file, &mut at, events, &mut all.t_in)?;
                }
            }
        }
        all.append(&group.held);
        Ok(all)
    }
}

impl BandSource<EventBand> for Gathered {
    fn read(&self, rows: Rows) -> Result<EventBand, DataError> {
        let rows = rows.intersect(self.extent.rows());
        let mut all = Columns::default();
        if !rows.is_empty() {
            for group in &self.groups[(rows.start / self.rows_per_group) as usize
                ..=((rows.end - 1) / self.rows_per_group) as usize]
            {
                let mut part = self.load(group).map_err(|error| {
                    DataError::new(format!("cannot read a temporary file of events: {error}"))
                })?;
                part.keep(rows);
                all.append(&part);
            }
        }
        let t_in = self.has_t_in.then_some(all.t_in.as_slice());
        let band = EventBand::from_file_order(rows, &all.y, &all.x, &all.on, &all.t, t_in)?;
        if self.drop_duplicates { band.without_duplicates() } else { Ok(band) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::Polarity;
    use photocurrent_core::events::Event;
    use photocurrent_core::handle::Band;
    use photocurrent_core::random::Random;

    /// Chunks that are already there.
    struct Made {
        chunks: Vec<EventChunk>,
        next: usize,
    }

    impl EventCursor for Made {
        fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
            let Some(given) = self.chunks.get(self.next) else {
                chunk.clear();
                return Ok(false);
            };
            *chunk = given.clone();
            self.next += 1;
            Ok(true)
        }
        fn seek(&mut self, _: i64) -> Result<(), FormatError> {
            self.next = 0;
            Ok(())
        }
        fn losses(&self) -> Vec<Loss> {
            Vec::new()
        }
        fn position(&self) -> (u64, u64) {
            (self.next as u64, self.chunks.len() as u64)
        }
    }

    const EXTENT: Extent = Extent { width: 5, height: 130 };

    /// Three chunks out of time order, some pixels outside, with in-pixel times.
    fn made() -> Made {
        let mut random = Random::new(5, &[]);
        let mut draw = |limit: u64| random.bits() % limit;
        let chunks = (0..3).map(|_| {
            let mut chunk = EventChunk::default();
            let mut t_in = Vec::new();
            for _ in 0..400 {
                let t = draw(300) as i64;
                chunk.push(1000 + t, draw(6) as u16, draw(132) as u16, draw(2) == 1);
                t_in.push(1000 + t - 1);
            }
            chunk.t_in = Some(t_in);
            chunk
        });
        Made { chunks: chunks.collect(), next: 0 }
    }

    fn go(budget: usize, start_ns: i64, end_ns: i64) -> Gathered {
        let wanted = Wanted {
            extent: EXTENT,
            crop: None,
            zero_ns: 1000,
            start_ns,
            end_ns,
            ordered: false,
            t_in: true,
            budget,
            drop_duplicates: false,
        };
        gather::<DataError>(&mut made(), wanted, |_| Ok(())).unwrap()
    }

    fn expected(start: i64, end: i64) -> EventBand {
        let mut events = Vec::new();
        for chunk in made().chunks {
            for i in 0..chunk.len() {
                let t = chunk.t[i] - 1000;
                if chunk.x[i] < 5 && chunk.y[i] < 130 && (start..end).contains(&t) {
                    events.push(Event {
                        x: chunk.x[i],
                        y: chunk.y[i],
                        polarity: Polarity::from_bit(chunk.on[i]),
                        t,
                        t_in: Some(t - 1),
                    });
                }
            }
        }
        EventBand::from_events(EXTENT.rows(), events).unwrap()
    }

    #[test]
    fn gathered_events_are_those_sorted_at_once_with_and_without_a_file() {
        for budget in [usize::MAX, 3000, 0] {
            let all = go(budget, i64::MIN, i64::MAX);
            assert_eq!(all.file.is_some(), budget < usize::MAX, "the budget decides whether a file is used");
            assert_eq!(all.read(EXTENT.rows()).unwrap(), expected(i64::MIN, i64::MAX));
            for rows in [Rows { start: 0, end: 1 }, Rows { start: 2, end: 77 }, Rows { start: 129, end: 130 }]
            {
                assert_eq!(all.read(rows).unwrap(), expected(i64::MIN, i64::MAX).slice(rows));
            }
        }
    }

    #[test]
    fn a_window_and_pixels_outside_are_left_out() {
        let all = go(usize::MAX, 50, 200);
        assert_eq!(all.read(EXTENT.rows()).unwrap(), expected(50, 200));
        let outside = |c: &EventChunk| {
            (0..c.len())
                .filter(|&i| (50..200).contains(&(c.t[i] - 1000)) && (c.x[i] >= 5 || c.y[i] >= 130))
                .count()
        };
        assert_eq!(all.outside as usize, made().chunks.iter().map(outside).sum::<usize>());
        assert!(all.outside > 0);
    }

    #[test]
    fn a_scan_finds_span_corner_and_disorder() {
        let found = scan::<FormatError>(&mut made(), |_| Ok(())).unwrap();
        let all: Vec<i64> = made().chunks.iter().flat_map(|c| c.t.clone()).collect();
        assert_eq!(found.count, 1200);
        assert_eq!(found.span, Some((*all.iter().min().unwrap(), *all.iter().max().unwrap())));
        assert_eq!(found.disordered as usize, all.windows(2).filter(|w| w[1] < w[0]).count());
        assert_eq!(found.corner, Some((5, 131)));
        assert_eq!(found.some_stamps, all);
        let mut columns: Vec<u16> = made().chunks.iter().flat_map(|c| c.x.clone()).collect();
        columns.sort_unstable();
        assert_eq!(
            (found.reach(1.0), found.reach(0.5).map(|(x, _)| x)),
            (Some((5, 131)), Some(columns[599]))
        );
        assert_eq!(
            found.outside(5, 132),
            made().chunks.iter().flat_map(|c| &c.x).filter(|x| **x >= 5).count() as u64
        );
    }

    #[test]
    fn strays_do_not_widen_the_dense_span_and_few_stamps_are_kept() {
        let chunk = |range: std::ops::Range<i64>, offset: i64| {
            let mut chunk = EventChunk::default();
            range.for_each(|t| chunk.push(t + offset, 0, 0, true));
            chunk
        };
        let chunks = vec![chunk(0..1_500, 1_000_000_000), chunk(0..100_000, 0), chunk(100_000..200_001, 0)];
        let found = scan::<FormatError>(&mut Made { chunks, next: 0 }, |_| Ok(())).unwrap();
        assert!(found.some_stamps.len() < KEPT_STAMPS && found.some_stamps.len() > KEPT_STAMPS / 4);
        let (first, last) = found.dense_span(0.98).unwrap();
        assert!(first >= 0 && last <= 200_000 && last - first > 190_000, "{first} {last}");
        assert_eq!(Scan::default().dense_span(0.98), None);
    }
}
