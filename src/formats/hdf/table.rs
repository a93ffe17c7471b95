//! Events as columns of HDF5 datasets: columns of their own, members of a compound, or columns of an N x 4
//! table; walked through in pieces.
//!
//! A piece is read and unpacked at a time, a few chunks in parallel. Numbers of any type are accepted; what
//! the reader made of them is said in notes. Seeking halves the time column, a row at a time, and goes back a
//! little further so that small disorder leaves nothing out.

use super::refusal::refused;
use crate::chunk::{CHUNK_EVENTS, EventChunk};
use crate::convention::{NONE, Rules, Tally};
use crate::error::{Cause, FormatError, Loss};
use crate::losses::Losses;
use crate::recording::{EventCursor, EventsAbout};
use photocurrent_core::Extent;
use photocurrent_store::foreign::{Field, ForeignDataset, ForeignFile, RowBlock};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Events that are read at a time: several chunks, so that they are unpacked in parallel.
const PIECE: usize = 4 * CHUNK_EVENTS;

/// Events that are checked together.
const BATCH: usize = 1024;

/// Events that a seek goes back further: stamps may be out of order by so many places.
const BACK: usize = 4096;

/// A column: of which dataset, and where in its rows.
#[derive(Clone, Copy)]
pub(super) struct Column {
    source: usize,
    field: Field,
}

/// Where the events of a file stand.
pub(super) struct EventTable {
    path: PathBuf,
    sources: Vec<ForeignDataset>,
    x: Column,
    y: Column,
    t: Column,
    p: Column,
    t_in: Option<Column>,
    pub count: usize,
    /// Nanoseconds in a unit of the stamps, and what is added to them.
    pub unit_ns: i64,
    pub offset_ns: i64,
    pub extent: Option<Extent>,
    /// `index[ms]` is the first event at or after this millisecond, counted from zero of the stored stamps.
    pub index: Option<ForeignDataset>,
}

impl EventTable {
    /// Of columns of their own: x, y, t, p, and t_in where it exists.
    pub(super) fn of_columns(
        file: &ForeignFile,
        names: [&str; 4],
        t_in: Option<&str>,
    ) -> Result<EventTable, FormatError> {
        let path = file.path();
        let mut sources = Vec::new();
        let mut column = |name: &str| {
            let dataset = dataset(file, name)?;
            let wrong = || {
                FormatError::new(
                    path,
                    format!("the shape {:?}", dataset.shape()),
                    "is this the file that you meant?",
                )
                .at(dataset.at())
                .expected("a column")
            };
            // A column may also be written as [N, 1].
            let field =
                dataset.column(0).filter(|_| matches!(dataset.shape(), [_] | [_, 1])).ok_or_else(wrong)?;
            sources.push(dataset);
            Ok::<Column, FormatError>(Column { source: sources.len() - 1, field })
        };
        let [x, y, t, p] = [column(names[0])?, column(names[1])?, column(names[2])?, column(names[3])?];
        let t_in = t_in.map(&mut column).transpose()?;
        EventTable::new(path, sources, [x, y, t, p], t_in)
    }

    /// Of members x, y, t, p of a compound.
    pub(super) fn of_compound(file: &ForeignFile, name: &str) -> Result<EventTable, FormatError> {
        let dataset = dataset(file, name)?;
        let member = |member: &str| {
            let missing = || {
                FormatError::new(
                    file.path(),
                    format!("there is no member `{member}`"),
                    "is this the file that you meant?",
                )
                .at(dataset.at())
            };
            dataset.member(member).map(|field| Column { source: 0, field }).ok_or_else(missing)
        };
        let columns = [member("x")?, member("y")?, member("t")?, member("p")?];
        EventTable::new(file.path(), vec![dataset], columns, None)
    }

    /// Of a table [N, 4]; at which of its columns x, y, t, p stand.
    pub(super) fn of_rows(
        file: &ForeignFile,
        name: &str,
        order: [usize; 4],
    ) -> Result<EventTable, FormatError> {
        let dataset = dataset(file, name)?;
        let wrong = || {
            FormatError::new(
                file.path(),
                format!("the shape {:?}", dataset.shape()),
                "is this the file that you meant?",
            )
            .at(dataset.at())
            .expected("[N, 4]")
        };
        let column = |at: usize| {
            dataset
                .column(at)
                .filter(|_| matches!(dataset.shape(), [_, 4]))
                .map(|field| Column { source: 0, field })
                .ok_or_else(wrong)
        };
        let columns = [column(order[0])?, column(order[1])?, column(order[2])?, column(order[3])?];
        EventTable::new(file.path(), vec![dataset], columns, None)
    }

    fn new(
        path: &Path,
        sources: Vec<ForeignDataset>,
        [x, y, t, p]: [Column; 4],
        t_in: Option<Column>,
    ) -> Result<EventTable, FormatError> {
        let count = sources.first().map_or(0, ForeignDataset::rows);
        if let Some(other) = sources.iter().find(|other| other.rows() != count) {
            let found = format!("{} numbers, but {} in {}", other.rows(), count, sources[0].at());
            return Err(FormatError::new(
                path,
                found,
                "the writer stopped early or the file is damaged: copy or record it again",
            )
            .at(other.at()));
        }
        Ok(EventTable {
            path: path.into(),
            sources,
            x,
            y,
            t,
            p,
            t_in,
            count,
            unit_ns: 1000,
            offset_ns: 0,
            extent: None,
            index: None,
        })
    }

    /// What is known before reading, with notes on unusual types.
    pub(super) fn about(&self, notes: Vec<String>) -> EventsAbout {
        let unit = match self.unit_ns {
            1 => "nanoseconds",
            1000 => "microseconds",
            1_000_000 => "milliseconds",
            _ => "seconds",
        };
        let float = self.t.field.number().is_float();
        let mut notes = notes;
        if float {
            let bits = if self.t.field.name() == "f32" {
                "f32 has 24 bits: 16 s are counted in steps of 1.9 us"
            } else {
                "f64 has 53 bits: a Unix time is counted in steps of 238 ns"
            };
            notes.push(format!("stamps are floating-point {unit}, rounded to nanoseconds ({bits})"));
        }
        for (column, name) in [(self.x, "columns"), (self.y, "rows")] {
            if column.field.number().is_float() {
                notes.push(format!("{name} of pixels are stored as {}", column.field.name()));
            }
        }
        EventsAbout {
            extent: self.extent,
            tick_ns: if float { 1 } else { self.unit_ns },
            count: Some(self.count as u64),
            has_t_in: self.t_in.is_some(),
            stamps: format!("{} {unit}", self.t.field.name()),
            notes,
        }
    }

    /// The smallest and largest polarity of the first events, for a note on -1/+1.
    pub(super) fn polarity_note(&self) -> Option<String> {
        let block = self.sources[self.p.source].rows_at(0..self.count.min(1000)).ok()?;
        let mut p = Vec::new();
        block.integers(self.p.field, &mut p);
        let name = self.p.field.name();
        if p.contains(&-1) {
            Some(format!("polarity is stored as {name}, -1 for OFF and 1 for ON"))
        } else {
            (name != "u8").then(|| format!("polarity is stored as {name}"))
        }
    }

    /// The first column and row outside; those that a coordinate of 16 bits cannot name when the extent is
    /// not known.
    fn sides(&self) -> (i64, i64) {
        self.extent.map_or((65_536, 65_536), |extent| {
            (i64::from(extent.width).min(65_536), i64::from(extent.height).min(65_536))
        })
    }

    /// One stamp in nanoseconds; `None` when it is no time.
    fn stamp(&self, row: usize) -> Option<i64> {
        let block = self.sources[self.t.source].rows_at(row..row + 1).ok()?;
        if !block.gaps().is_empty() {
            return None;
        }
        let mut stamps = Stamps::default();
        stamps.read(self, &block);
        stamps.get(self, 0)
    }

    /// The first event at or after a time, if stamps rise; then some back.
    fn place_of(&self, t_ns: i64) -> usize {
        let mut range = 0..self.count;
        if let Some(index) = &self.index {
            let ms = t_ns.saturating_sub(self.offset_ns).div_euclid(1_000_000);
            let entry = |ms: i64| -> Option<usize> {
                let at = usize::try_from(ms).ok().filter(|&at| at < index.rows())?;
                let (block, mut found) = (index.rows_at(at..at + 1).ok()?, Vec::new());
                block.integers(index.column(0)?, &mut found);
                usize::try_from(*found.first()?).ok().filter(|&at| at <= self.count)
            };
            // The index is used only as far as the stamps at its places agree.
            if let Some(low) = entry(ms)
                && (low == 0 || self.stamp(low - 1).is_some_and(|t| t < t_ns))
            {
                range.start = low;
            }
            if let Some(high) = entry(ms + 1)
                && high >= range.start
                && (high == self.count || self.stamp(high).is_some_and(|t| t >= t_ns))
            {
                range.end = high;
            }
        }
        while !range.is_empty() {
            let middle = range.start + range.len() / 2;
            match self.stamp(middle) {
                Some(t) if t >= t_ns => range.end = middle,
                Some(_) => range.start = middle + 1,
                // A stamp that cannot be read carries no information: begin before it.
                None => break,
            }
        }
        range.start.saturating_sub(BACK)
    }
}

fn dataset(file: &ForeignFile, name: &str) -> Result<ForeignDataset, FormatError> {
    let missing = || {
        FormatError::new(
            file.path(),
            "there is no such dataset",
            "the file is cut short, or has another layout",
        )
        .at(format!("/{name}"))
    };
    file.dataset(name).map_err(|error| refused(file.path(), error))?.ok_or_else(missing)
}

/// Stamps as they are stored.
#[derive(Default)]
struct Stamps {
    integers: Vec<i64>,
    floats: Vec<f64>,
}

impl Stamps {
    fn read(&mut self, table: &EventTable, block: &RowBlock) {
        self.integers.clear();
        self.floats.clear();
        if table.t.field.number().is_float() {
            block.floats(table.t.field, &mut self.floats)
        } else {
            block.integers(table.t.field, &mut self.integers)
        }
    }

    /// In nanoseconds of the file's clock; `None` when it is no time.
    fn get(&self, table: &EventTable, at: usize) -> Option<i64> {
        let ns = match self.floats.get(at) {
            Some(&stored) => nanoseconds(stored, table.unit_ns)?,
            None => self.integers.get(at)?.checked_mul(table.unit_ns)?,
        };
        ns.checked_add(table.offset_ns)
    }
}

/// A floating-point stamp in nanoseconds: whole units and the fraction apart, so that nothing is lost beyond
/// what f64 has lost already.
pub(super) fn nanoseconds(stored: f64, unit_ns: i64) -> Option<i64> {
    let (whole, fraction) = (stored.trunc(), stored.fract());
    if !whole.is_finite() || whole.abs() > i64::MAX as f64 / unit_ns as f64 / 2.0 {
        return None;
    }
    (whole as i64).checked_mul(unit_ns)?.checked_add((fraction * unit_ns as f64).round() as i64)
}

/// A coordinate column: integers, and fractions where they are stored as floating point.
#[derive(Default)]
struct Coordinates {
    integers: Vec<i64>,
    floats: Vec<f64>,
}

impl Coordinates {
    fn read(&mut self, column: Column, block: &RowBlock) {
        self.integers.clear();
        self.floats.clear();
        if column.field.number().is_float() {
            block.floats(column.field, &mut self.floats);
        }
        block.integers(column.field, &mut self.integers);
    }

    fn is_whole(&self, at: usize) -> bool {
        self.floats.get(at).is_none_or(|value| value.fract() == 0.0)
    }
}

impl EventTable {
    /// Counts what all rows hold that can be read.
    pub(super) fn tally(&self, tally: &mut Tally) -> Result<(), FormatError> {
        let (mut x, mut y, mut p, mut t) = (Vec::new(), Vec::new(), Vec::new(), Stamps::default());
        for first in (0..self.count).step_by(PIECE) {
            let rows = first..self.count.min(first + PIECE);
            let blocks = self
                .sources
                .iter()
                .map(|source| source.rows_at(rows.clone()).map_err(|error| refused(&self.path, error)));
            let blocks = blocks.collect::<Result<Vec<_>, _>>()?;
            for (column, values) in [(self.x, &mut x), (self.y, &mut y), (self.p, &mut p)] {
                values.clear();
                blocks[column.source].integers(column.field, values);
            }
            t.read(self, &blocks[self.t.source]);
            let is_lost = |row: usize| {
                blocks.iter().any(|block| block.gaps().iter().any(|gap| gap.rows.contains(&row)))
            };
            let is_whole = blocks.iter().all(|block| block.gaps().is_empty());
            for i in (0..rows.len()).filter(|i| is_whole || !is_lost(first + i)) {
                tally.add(t.get(self, i).unwrap_or(NONE), x[i], y[i], p[i]);
            }
        }
        Ok(())
    }
}

/// Walks through a table.
pub(super) struct TableCursor {
    table: Arc<EventTable>,
    /// What polarities and coordinates mean.
    rules: Rules,
    /// The next row to be read from the file.
    next: usize,
    /// What is read and not given yet, and from which place on.
    ready: EventChunk,
    given: usize,
    losses: Losses,
    /// Rows that were damaged and why, those that follow each other as one.
    damaged: Vec<(Range<usize>, String)>,
    x: Coordinates,
    y: Coordinates,
    t: Stamps,
    p: Vec<i64>,
    t_in: Vec<i64>,
}

impl TableCursor {
    pub(super) fn new(table: Arc<EventTable>, rules: Rules) -> TableCursor {
        let ready = EventChunk { t_in: table.t_in.map(|_| Vec::new()), ..EventChunk::default() };
        TableCursor {
            table,
            rules,
            next: 0,
            ready,
            given: 0,
            losses: Losses::default(),
            damaged: Vec::new(),
            x: Coordinates::default(),
            y: Coordinates::default(),
            t: Stamps::default(),
            p: Vec::new(),
            t_in: Vec::new(),
        }
    }

    /// Reads and checks the next piece into `ready`.
    fn fill(&mut self) -> Result<(), FormatError> {
        let table = self.table.clone();
        let rows = self.next..table.count.min(self.next + PIECE);
        self.next = rows.end;
        self.ready.clear();
        self.given = 0;
        let mut damaged: Vec<(Range<usize>, String)> = Vec::new();
        let mut blocks = Vec::new();
        for source in &table.sources {
            let block = source.rows_at(rows.clone()).map_err(|error| refused(&table.path, error))?;
            damaged.extend(
                block.gaps().iter().map(|gap| (gap.rows.clone(), format!("{}: {}", source.at(), gap.why))),
            );
            blocks.push(block);
        }
        self.x.read(table.x, &blocks[table.x.source]);
        self.y.read(table.y, &blocks[table.y.source]);
        self.t.read(&table, &blocks[table.t.source]);
        self.p.clear();
        blocks[table.p.source].integers(table.p.field, &mut self.p);
        self.t_in.clear();
        if let Some(column) = table.t_in {
            blocks[column.source].integers(column.field, &mut self.t_in);
        }
        for (lost, why) in &damaged {
            match self
                .damaged
                .iter_mut()
                .find(|(open, other)| (open.start..=open.end).contains(&lost.start) && other == why)
            {
                Some((open, _)) => open.end = open.end.max(lost.end),
                None => self.damaged.push((lost.clone(), why.clone())),
            }
        }
        let mut from = rows.start;
        while from < rows.end {
            // Whole rows up to the next damaged piece.
            let inside =
                damaged.iter().filter(|(lost, _)| lost.contains(&from)).map(|(lost, _)| lost.end).max();
            if let Some(end) = inside {
                from = end.min(rows.end);
                continue;
            }
            let to = damaged
                .iter()
                .map(|(lost, _)| lost.start)
                .filter(|&start| start > from)
                .min()
                .unwrap_or(rows.end)
                .min(rows.end);
            for batch in (from - rows.start..to - rows.start).step_by(BATCH) {
                let batch = batch..(batch + BATCH).min(to - rows.start);
                if !self.take_sound(&table, batch.clone()) {
                    batch.for_each(|i| self.take(&table, rows.start + i, i));
                }
            }
            from = to;
        }
        Ok(())
    }

    /// Puts events into `ready`, whole columns at a time, if none of them has to be left out and all are
    /// stored as integers; else does nothing.
    fn take_sound(&mut self, table: &EventTable, batch: std::ops::Range<usize>) -> bool {
        if !(self.x.floats.is_empty()
            && self.y.floats.is_empty()
            && self.t.floats.is_empty()
            && table.t_in.is_none())
        {
            return false;
        }
        let (x, y) = (&self.x.integers[batch.clone()], &self.y.integers[batch.clone()]);
        let (t, p) = (&self.t.integers[batch.clone()], &self.p[batch]);
        let (width, height) = table.sides();
        // Without branches, so that the compiler works on several events at once.
        let places = x
            .iter()
            .zip(y)
            .fold(true, |sound, (&x, &y)| sound & (0..width).contains(&x) & (0..height).contains(&y));
        let polarities =
            self.rules.is_usual() && p.iter().fold(true, |sound, &p| sound & (-1..=1).contains(&p));
        let (low, high) = t.iter().fold((i64::MAX, i64::MIN), |(low, high), &t| (low.min(t), high.max(t)));
        let fits =
            |t: i64| t.checked_mul(table.unit_ns).and_then(|ns| ns.checked_add(table.offset_ns)).is_some();
        if !(places && polarities && fits(low) && fits(high)) {
            return false;
        }
        self.ready.t.extend(t.iter().map(|&t| t * table.unit_ns + table.offset_ns));
        self.ready.x.extend(x.iter().map(|&x| x as u16));
        self.ready.y.extend(y.iter().map(|&y| y as u16));
        self.ready.on.extend(p.iter().map(|&p| u8::from(p == 1)));
        true
    }

    /// Checks one event and puts it into `ready`.
    #[inline]
    fn take(&mut self, table: &EventTable, index: usize, i: usize) {
        let (x, y, p) =
            (self.rules.pixel(self.x.integers[i]), self.rules.pixel(self.y.integers[i]), self.p[i]);
        let event = || format!("event {index}");
        let Some(t) = self.t.get(table, i) else {
            let stored =
                || self.t.floats.get(i).map_or_else(|| self.t.integers[i].to_string(), f64::to_string);
            return self.losses.add_by(
                Cause::Stamp,
                "events without a sound stamp were left out",
                1,
                event,
                || format!("its stamp {} is no time; it was left out", stored()),
            );
        };
        if !(self.x.is_whole(i) && self.y.is_whole(i)) {
            let at = |of: &Coordinates| of.floats.get(i).copied().unwrap_or(of.integers[i] as f64);
            let (x, y) = (at(&self.x), at(&self.y));
            let what = || format!("its place x = {x}, y = {y} lies between pixels; it was left out");
            return self.losses.add("events between pixels were left out", event, what);
        }
        let (width, height) = table.sides();
        if !((0..width).contains(&x) && (0..height).contains(&y)) {
            let what =
                || format!("its pixel x = {x}, y = {y} lies outside {width} x {height}; it was left out");
            return self.losses.add_by(
                Cause::Outside,
                "events outside the pixel array were left out",
                1,
                event,
                what,
            );
        }
        let Some(on) = self.rules.on(p) else {
            let what = || format!("its polarity {p} is none of 0, 1, -1; it was left out");
            return self.losses.add_by(
                Cause::Polarity,
                "events whose polarity is none of 0, 1, -1 were left out",
                1,
                event,
                what,
            );
        };
        self.ready.push(t, x as u16, y as u16, on);
        if let (Some(column), Some(&t_in)) = (&mut self.ready.t_in, self.t_in.get(i)) {
            column.push(t_in.saturating_mul(table.unit_ns).saturating_add(table.offset_ns));
        }
    }
}

impl EventCursor for TableCursor {
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        chunk.clear();
        if self.given >= self.ready.len() {
            if self.next >= self.table.count {
                return Ok(false);
            }
            self.fill()?;
        }
        let part = self.given..self.ready.len().min(self.given + CHUNK_EVENTS);
        chunk.t.extend_from_slice(&self.ready.t[part.clone()]);
        chunk.x.extend_from_slice(&self.ready.x[part.clone()]);
        chunk.y.extend_from_slice(&self.ready.y[part.clone()]);
        chunk.on.extend_from_slice(&self.ready.on[part.clone()]);
        match &self.ready.t_in {
            Some(t_in) => chunk.t_in.get_or_insert_default().extend_from_slice(&t_in[part.clone()]),
            None => chunk.t_in = None,
        }
        self.given = part.end;
        Ok(true)
    }

    fn seek(&mut self, t_ns: i64) -> Result<(), FormatError> {
        self.next = self.table.place_of(t_ns);
        self.ready.clear();
        self.given = 0;
        Ok(())
    }

    fn losses(&self) -> Vec<Loss> {
        let mut losses = self.losses.clone();
        for (lost, why) in &self.damaged {
            let at = || format!("events {} to {}", lost.start, lost.end.saturating_sub(1));
            losses.add("pieces that are damaged", at, || format!("{why}; its events are lost"));
        }
        losses.list()
    }

    fn position(&self) -> (u64, u64) {
        let waiting = self.ready.len() - self.given;
        (self.next.saturating_sub(waiting) as u64, self.table.count as u64)
    }
}
