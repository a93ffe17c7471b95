//! Events: ON and OFF steps of log light, each with its pixel and stamps.
//!
//! Canonical order is (y, t, x): row by row, and inside a row by off-pixel time, then column, ties in file
//! order. So a row band is one contiguous piece, and a pixel's events are found by one counting sort of a row
//! ([`EventRow::by_pixel`]).

use crate::digest::{Digest, DigestBuilder};
use crate::error::DataError;
use crate::extent::{Extent, Rows};
use crate::handle::{Band, BandMeta, Handle, InTime};
use crate::offsets::{gather, interleaved, interleaved_offsets, offsets_of, range_within};
use crate::time::TimeSpan;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Which way the light went.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Polarity {
    /// Brighter.
    On,
    /// Darker.
    Off,
}

impl Polarity {
    /// `+1` or `-1`.
    pub fn sign(self) -> f64 {
        match self {
            Polarity::On => 1.0,
            Polarity::Off => -1.0,
        }
    }

    /// From the recorded bit: 1 is ON.
    pub fn from_bit(bit: u8) -> Polarity {
        if bit == 0 { Polarity::Off } else { Polarity::On }
    }
}

/// What is known about an event stream before its data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EventsMeta {
    /// Size of the sensor.
    pub extent: Extent,
    /// The time that the stream covers, at least from the first stamp to just after the last; `None` when
    /// that is not known and there is no event.
    pub span: Option<TimeSpan>,
    /// Does every event carry its in-pixel time?
    pub has_t_in: bool,
    /// Does every event carry a compensated log step?
    pub has_step: bool,
    /// Width of a stamp's interval, when the recorder states it.
    pub t_resolution_ns: Option<i64>,
    /// About how many events, for memory estimates only: no part of the content.
    pub count_hint: Option<u64>,
}

impl BandMeta for EventsMeta {
    type Band = EventBand;

    fn extent(&self) -> Extent {
        self.extent
    }

    fn write_digest(&self, digest: &mut DigestBuilder) {
        digest.text("events/1").integer(self.extent.width.into()).integer(self.extent.height.into());
        let span = self.span.map_or((1, 0), |span| (span.start.0, span.end.0));
        digest.integer(span.0).integer(span.1).integer(self.has_t_in.into()).integer(self.has_step.into());
        digest.integer(self.t_resolution_ns.unwrap_or(-1));
    }
}

/// A stream of events, read by row band.
pub type EventStream = Handle<EventsMeta>;

/// The events of some rows, as a structure of arrays in canonical order.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct EventBand {
    start_row: u32,
    offsets: Vec<usize>,
    /// Column of each event.
    pub x: Vec<u16>,
    /// 1 = ON, 0 = OFF.
    pub on: Vec<u8>,
    /// Off-pixel time in ns, not decreasing inside a row.
    pub t: Vec<i64>,
    /// In-pixel time in ns; same length as `t`, or absent.
    pub t_in: Option<Vec<i64>>,
    /// Signed log step after latency compensation, Eq. (12); same length as `t`, or absent.
    pub step: Option<Vec<f32>>,
}

/// One event as it arrives, before ordering.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// Column.
    pub x: u16,
    /// Row.
    pub y: u16,
    /// Direction.
    pub polarity: Polarity,
    /// Off-pixel time, ns.
    pub t: i64,
    /// In-pixel time, ns.
    pub t_in: Option<i64>,
}

impl EventBand {
    /// Sorts events of the given rows into canonical order; the sort is stable, so ties keep file order.
    /// `t_in` is kept when every event has it.
    ///
    /// # Errors
    /// When an event lies outside `rows`.
    pub fn from_events(rows: Rows, events: Vec<Event>) -> Result<EventBand, DataError> {
        if let Some(event) = events.iter().find(|e| !(rows.start..rows.end).contains(&e.y.into())) {
            return Err(DataError::new(format!("an event at row {} does not belong to {rows}", event.y)));
        }
        let row_of = |event: &Event| event.y as usize - rows.start as usize;
        let mut offsets = vec![0; rows.len() + 1];
        for event in &events {
            offsets[row_of(event) + 1] += 1;
        }
        for i in 1..offsets.len() {
            offsets[i] += offsets[i - 1];
        }
        // Rows by counting; in a row, stamp, column and place as given are the digits of one number.
        let mut next = offsets.clone();
        let mut order = vec![0_u128; events.len()];
        for (place, event) in events.iter().enumerate() {
            let to = &mut next[row_of(event)];
            let stamp = event.t as u64 ^ (1 << 63);
            order[*to] = u128::from(stamp) << 64 | u128::from(event.x) << 48 | place as u128;
            *to += 1;
        }
        offsets.windows(2).for_each(|row| order[row[0]..row[1]].sort_unstable());
        let sorted = || order.iter().map(|digits| &events[(digits & 0xFFFF_FFFF_FFFF) as usize]);
        Ok(EventBand {
            start_row: rows.start,
            x: sorted().map(|e| e.x).collect(),
            on: sorted().map(|e| (e.polarity == Polarity::On) as u8).collect(),
            t: sorted().map(|e| e.t).collect(),
            t_in: sorted().map(|e| e.t_in).collect(),
            step: None,
            offsets,
        })
    }

    /// Puts columns in file order (usually by time) into canonical order: one counting sort by row, then only
    /// rows that are out of time order and equal stamps are sorted; ties keep file order.
    ///
    /// # Errors
    /// When columns differ in length or an event lies outside `rows`.
    pub fn from_file_order(
        rows: Rows,
        y: &[u16],
        x: &[u16],
        on: &[u8],
        t: &[i64],
        t_in: Option<&[i64]>,
    ) -> Result<EventBand, DataError> {
        let n = y.len();
        if x.len() != n || on.len() != n || t.len() != n || t_in.is_some_and(|column| column.len() != n) {
            return Err(DataError::new("the columns of an event band do not fit each other"));
        }
        if let Some(outside) = y.iter().find(|&&y| !(rows.start..rows.end).contains(&u32::from(y))) {
            return Err(DataError::new(format!("an event at row {outside} does not belong to {rows}")));
        }
        let row_of = |i: usize| (u32::from(y[i]) - rows.start) as usize;
        let mut offsets = vec![0; rows.len() + 1];
        (0..n).for_each(|i| offsets[row_of(i) + 1] += 1);
        for row in 1..offsets.len() {
            offsets[row] += offsets[row - 1];
        }
        let mut next = offsets.clone();
        let mut order = vec![0; n];
        for i in 0..n {
            let row = row_of(i);
            order[next[row]] = i;
            next[row] += 1;
        }
        for row in 0..rows.len() {
            let row = &mut order[offsets[row]..offsets[row + 1]];
            if !row.is_sorted_by_key(|&i| t[i]) {
                row.sort_by_key(|&i| t[i]);
            }
            row.chunk_by_mut(|&a, &b| t[a] == t[b]).for_each(|ties| ties.sort_by_key(|&i| x[i]));
        }
        fn gather<T: Copy>(order: &[usize], column: &[T]) -> Vec<T> {
            order.iter().map(|&i| column[i]).collect()
        }
        let t_in = t_in.map(|column| gather(&order, column));
        EventBand::from_columns(
            rows.start,
            offsets,
            gather(&order, x),
            gather(&order, on),
            gather(&order, t),
            t_in,
            None,
        )
    }

    /// The band with events of one time, pixel and sign once each.
    ///
    /// # Errors
    /// As [`EventBand::from_columns`].
    pub fn without_duplicates(self) -> Result<EventBand, DataError> {
        let mut kept: Vec<usize> = Vec::with_capacity(self.t.len());
        let mut offsets = vec![0];
        for row in self.offsets.windows(2) {
            let first = kept.len();
            for i in row[0]..row[1] {
                // Ties stand together, sorted by column.
                let is_tie = |k: &&usize| (self.t[**k], self.x[**k]) == (self.t[i], self.x[i]);
                if !kept[first..].iter().rev().take_while(is_tie).any(|k| self.on[*k] == self.on[i]) {
                    kept.push(i);
                }
            }
            offsets.push(kept.len());
        }
        fn pick<T: Copy>(kept: &[usize], column: &[T]) -> Vec<T> {
            kept.iter().map(|&i| column[i]).collect()
        }
        let t_in = self.t_in.as_ref().map(|column| pick(&kept, column));
        let step = self.step.as_ref().map(|column| pick(&kept, column));
        EventBand::from_columns(
            self.start_row,
            offsets,
            pick(&kept, &self.x),
            pick(&kept, &self.on),
            pick(&kept, &self.t),
            t_in,
            step,
        )
    }

    /// From columns that are in canonical order already; `offsets` has one entry per row and a last one.
    ///
    /// # Errors
    /// When lengths disagree, offsets do not rise, or a row is not in time order: the artefact is damaged.
    pub fn from_columns(
        start_row: u32,
        offsets: Vec<usize>,
        x: Vec<u16>,
        on: Vec<u8>,
        t: Vec<i64>,
        t_in: Option<Vec<i64>>,
        step: Option<Vec<f32>>,
    ) -> Result<EventBand, DataError> {
        let band = EventBand { start_row, offsets, x, on, t, t_in, step };
        let n = band.t.len();
        let lengths = band.x.len() == n
            && band.on.len() == n
            && band.t_in.as_ref().is_none_or(|c| c.len() == n)
            && band.step.as_ref().is_none_or(|c| c.len() == n);
        let rising = band.offsets.first() == Some(&0)
            && band.offsets.last() == Some(&n)
            && band.offsets.windows(2).all(|w| w[0] <= w[1]);
        if !lengths || !rising || !band.rows().iter().all(|row| band.row(row).t.is_sorted()) {
            return Err(DataError::new("the columns of an event band do not fit each other"));
        }
        Ok(band)
    }

    /// An event band without events.
    pub fn empty(rows: Rows, meta: &EventsMeta) -> EventBand {
        EventBand {
            start_row: rows.start,
            offsets: vec![0; rows.len() + 1],
            t_in: meta.has_t_in.then(Vec::new),
            step: meta.has_step.then(Vec::new),
            ..EventBand::default()
        }
    }

    /// Number of events.
    pub fn len(&self) -> usize {
        self.t.len()
    }

    /// No event at all?
    pub fn is_empty(&self) -> bool {
        self.t.is_empty()
    }

    /// Index of the first event of each row, and the number of events.
    pub fn offsets(&self) -> &[usize] {
        &self.offsets
    }

    /// The events of one row.
    pub fn row(&self, row: u32) -> EventRow<'_> {
        let at = (row - self.start_row) as usize;
        let range = self.offsets[at]..self.offsets[at + 1];
        EventRow {
            first: range.start,
            x: &self.x[range.clone()],
            on: &self.on[range.clone()],
            t: &self.t[range.clone()],
            t_in: self.t_in.as_ref().map(|c| &c[range.clone()]),
            step: self.step.as_ref().map(|c| &c[range]),
        }
    }
}

impl Band for EventBand {
    type Meta = EventsMeta;

    fn rows(&self) -> Rows {
        Rows { start: self.start_row, end: self.start_row + self.offsets.len().saturating_sub(1) as u32 }
    }

    fn row_digest(&self, row: u32) -> Digest {
        let row = self.row(row);
        let mut digest = DigestBuilder::new("events-row/1");
        digest.slice(row.x).slice(row.on).slice(row.t);
        if let Some(t_in) = row.t_in {
            digest.slice(t_in);
        }
        if let Some(step) = row.step {
            digest.slice(step);
        }
        digest.finish()
    }

    fn bytes(&self, rows: Rows) -> u64 {
        let (from, to) = ((rows.start - self.start_row) as usize, (rows.end - self.start_row) as usize);
        let each = 11 + 8 * u64::from(self.t_in.is_some()) + 4 * u64::from(self.step.is_some());
        (self.offsets[to] - self.offsets[from]) as u64 * each
    }

    fn moved(self, start_row: u32) -> EventBand {
        EventBand { start_row, ..self }
    }

    fn slice(&self, rows: Rows) -> EventBand {
        let (from, to) = ((rows.start - self.start_row) as usize, (rows.end - self.start_row) as usize);
        let range = self.offsets[from]..self.offsets[to];
        EventBand {
            start_row: rows.start,
            offsets: self.offsets[from..=to].iter().map(|offset| offset - range.start).collect(),
            x: self.x[range.clone()].to_vec(),
            on: self.on[range.clone()].to_vec(),
            t: self.t[range.clone()].to_vec(),
            t_in: self.t_in.as_ref().map(|c| c[range.clone()].to_vec()),
            step: self.step.as_ref().map(|c| c[range].to_vec()),
        }
    }

    fn concat(parts: Vec<EventBand>) -> EventBand {
        let mut parts = parts.into_iter();
        let mut whole = parts.next().expect("at least one band to join");
        for part in parts {
            let before = whole.len();
            whole.offsets.extend(part.offsets[1..].iter().map(|offset| offset + before));
            whole.x.extend(part.x);
            whole.on.extend(part.on);
            whole.t.extend(part.t);
            whole.t_in.iter_mut().zip(part.t_in).for_each(|(whole, part)| whole.extend(part));
            whole.step.iter_mut().zip(part.step).for_each(|(whole, part)| whole.extend(part));
        }
        whole
    }
}

impl InTime for EventBand {
    fn within(&self, window: TimeSpan) -> EventBand {
        let of_row = |row: u32| {
            let row = self.row(row);
            let range = range_within(row.t, window);
            row.first + range.start..row.first + range.end
        };
        let kept: Vec<Range<usize>> = self.rows().iter().map(of_row).collect();
        EventBand {
            start_row: self.start_row,
            offsets: offsets_of(&kept),
            x: gather(&kept, &self.x),
            on: gather(&kept, &self.on),
            t: gather(&kept, &self.t),
            t_in: self.t_in.as_ref().map(|column| gather(&kept, column)),
            step: self.step.as_ref().map(|column| gather(&kept, column)),
        }
    }

    fn follow(parts: Vec<EventBand>) -> EventBand {
        let first = parts.first().expect("at least one band to join");
        fn all<T: Copy>(parts: &[EventBand], column: impl Fn(&EventBand) -> &[T]) -> Vec<T> {
            interleaved(&parts.iter().map(|part| (part.offsets(), column(part))).collect::<Vec<_>>())
        }
        EventBand {
            start_row: first.start_row,
            offsets: interleaved_offsets(&parts.iter().map(EventBand::offsets).collect::<Vec<_>>()),
            x: all(&parts, |part| &part.x),
            on: all(&parts, |part| &part.on),
            t: all(&parts, |part| &part.t),
            t_in: first.t_in.is_some().then(|| all(&parts, |part| part.t_in.as_deref().unwrap_or_default())),
            step: first.step.is_some().then(|| all(&parts, |part| part.step.as_deref().unwrap_or_default())),
        }
    }
}

/// The events of one row, in time order.
#[derive(Clone, Copy, Debug)]
pub struct EventRow<'a> {
    /// Index of its first event in the band.
    pub first: usize,
    /// Columns.
    pub x: &'a [u16],
    /// 1 = ON, 0 = OFF.
    pub on: &'a [u8],
    /// Off-pixel times, ns.
    pub t: &'a [i64],
    /// In-pixel times, ns.
    pub t_in: Option<&'a [i64]>,
    /// Compensated log steps.
    pub step: Option<&'a [f32]>,
}

/// Which events of a row belong to which pixel.
#[derive(Clone, Debug, Default)]
pub struct PixelIndex {
    offsets: Vec<usize>,
    order: Vec<usize>,
}

impl PixelIndex {
    /// Indices into the row of the events of column `x`, in time order.
    pub fn pixel(&self, x: usize) -> &[usize] {
        &self.order[self.offsets[x]..self.offsets[x + 1]]
    }
}

impl EventRow<'_> {
    /// Number of events.
    pub fn len(&self) -> usize {
        self.t.len()
    }

    /// No event at all?
    pub fn is_empty(&self) -> bool {
        self.t.is_empty()
    }

    /// Groups the events by pixel with one stable counting sort.
    pub fn by_pixel(&self, width: u32) -> PixelIndex {
        let mut offsets = vec![0; width as usize + 1];
        for &x in self.x {
            offsets[x as usize + 1] += 1;
        }
        for i in 1..offsets.len() {
            offsets[i] += offsets[i - 1];
        }
        let mut next = offsets.clone();
        let mut order = vec![0; self.x.len()];
        for (i, &x) in self.x.iter().enumerate() {
            order[next[x as usize]] = i;
            next[x as usize] += 1;
        }
        PixelIndex { offsets, order }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    fn some_events(n: usize) -> Vec<Event> {
        let mut random = Random::new(3, &[]);
        let mut draw = |limit: u64| random.bits() % limit;
        (0..n)
            .map(|_| Event {
                x: draw(5) as u16,
                y: 2 + draw(7) as u16,
                polarity: Polarity::from_bit(draw(2) as u8),
                t: draw(40) as i64,
                t_in: Some(draw(40) as i64),
            })
            .collect()
    }

    const ROWS: Rows = Rows { start: 2, end: 9 };

    #[test]
    fn a_row_digest_does_not_depend_on_the_band_around_it() {
        let band = EventBand::from_events(ROWS, some_events(500)).unwrap();
        let part = band.slice(Rows { start: 4, end: 6 });
        assert_eq!(band.row_digest(5), part.row_digest(5));
        assert_ne!(band.row_digest(5), band.row_digest(4));
    }

    #[test]
    fn what_is_there_twice_stays_once_and_other_signs_stay() {
        let event = |t, x, on| Event { x, y: 3, polarity: Polarity::from_bit(on), t, t_in: Some(t) };
        let events = vec![
            event(5, 1, 1),
            event(5, 1, 1),
            event(5, 1, 0),
            event(5, 1, 1),
            event(5, 2, 1),
            event(6, 1, 1),
        ];
        let band = EventBand::from_events(ROWS, events).unwrap().without_duplicates().unwrap();
        let row = band.row(3);
        assert_eq!((row.t, row.x, row.on), (&[5, 5, 5, 6][..], &[1, 1, 2, 1][..], &[1, 0, 1, 1][..]));
        let all = EventBand::from_events(ROWS, some_events(500)).unwrap();
        let once = all.clone().without_duplicates().unwrap();
        let distinct: std::collections::BTreeSet<_> =
            some_events(500).iter().map(|e| (e.y, e.t, e.x, e.polarity == Polarity::On)).collect();
        assert_eq!(once.t.len(), distinct.len());
    }

    #[test]
    fn cutting_and_joining_gives_the_same_band() {
        let band = EventBand::from_events(ROWS, some_events(500)).unwrap();
        for height in 1..8 {
            let parts = ROWS.bands(height).into_iter().map(|rows| band.slice(rows)).collect();
            assert_eq!(EventBand::concat(parts), band);
        }
    }

    #[test]
    fn equal_stamps_keep_file_order() {
        let event = |on| Event { x: 1, y: 2, polarity: on, t: 5, t_in: None };
        let band = EventBand::from_events(
            ROWS,
            vec![event(Polarity::Off), event(Polarity::On), event(Polarity::Off)],
        )
        .unwrap();
        assert_eq!(band.on, [0, 1, 0]);
    }

    #[test]
    fn each_pixel_gets_its_own_events_in_time_order() {
        let band = EventBand::from_events(ROWS, some_events(500)).unwrap();
        let row = band.row(3);
        let index = row.by_pixel(5);
        let total: usize = (0..5).map(|x| index.pixel(x).len()).sum();
        assert_eq!(total, row.len());
        for x in 0..5 {
            assert!(index.pixel(x).iter().all(|&k| row.x[k] as usize == x));
            assert!(index.pixel(x).iter().is_sorted_by_key(|&k| row.t[k]));
        }
    }

    #[test]
    fn columns_in_any_order_become_the_same_band_as_events() {
        let events = some_events(500);
        let column = |of: fn(&Event) -> u16| events.iter().map(of).collect::<Vec<u16>>();
        let on: Vec<u8> = events.iter().map(|e| u8::from(e.polarity == Polarity::On)).collect();
        let t: Vec<i64> = events.iter().map(|e| e.t).collect();
        let t_in: Vec<i64> = events.iter().map(|e| e.t_in.unwrap()).collect();
        let band = EventBand::from_file_order(ROWS, &column(|e| e.y), &column(|e| e.x), &on, &t, Some(&t_in))
            .unwrap();
        assert_eq!(band, EventBand::from_events(ROWS, events).unwrap());
        assert!(EventBand::from_file_order(Rows { start: 0, end: 1 }, &[1], &[0], &[0], &[0], None).is_err());
    }

    #[test]
    fn an_event_outside_the_rows_is_refused() {
        let error = EventBand::from_events(Rows { start: 0, end: 2 }, some_events(1)).unwrap_err();
        assert!(error.message.contains("does not belong to rows 0..2"));
    }
}
