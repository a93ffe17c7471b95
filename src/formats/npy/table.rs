//! Events whose columns are numpy arrays: one array a column, an array of N x 4, an array of records, or a
//! mix.
//!
//! Arrays that lie side by side are read side by side, a piece at a time, so that memory does not grow with
//! the file.

use super::header::{Element, Header, Number, Scalar, each};
use super::place::{Bytes, Place};
use crate::chunk::{CHUNK_EVENTS, EventChunk};
use crate::convention::{Rules, Tally};
use crate::declared::{Column, TimeUnit};
use crate::error::{Cause, FormatError, Loss};
use crate::losses::Losses;
use crate::recording::EventCursor;
use crate::warped::{self, Warped};
use photocurrent_core::Extent;
use std::collections::HashSet;
use std::io::{ErrorKind, Read};
use std::path::Path;
use std::sync::Arc;

/// Bytes of a row that are still plausible for an event.
const WIDEST: usize = 256;

/// A run of rows in one array: where it begins, how long a row is, and what stands in it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Source {
    pub(crate) place: Place,
    pub(crate) start: u64,
    pub(crate) stride: usize,
    pub(crate) fields: Vec<(Column, Scalar, usize)>,
    pub(crate) rows: u64,
}

/// The columns of an event stream.
#[derive(Clone, Debug, PartialEq, Default)]
pub(crate) struct Table {
    pub(crate) sources: Vec<Source>,
    /// Rows that every source has.
    pub(crate) rows: u64,
}

/// How stored numbers become events.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reading {
    pub(crate) unit: TimeUnit,
    pub(crate) scale: u32,
    /// Coordinates of 16 bits that are this large or larger are negative: 65,536 was added when they were
    /// stored.
    pub(crate) wraps_at: Option<(i64, i64)>,
    pub(crate) extent: Option<Extent>,
    pub(crate) has_t_in: bool,
    /// What polarities and coordinates mean.
    pub(crate) rules: Rules,
}

/// What a name of an array or of a field means.
pub(crate) fn column_named(name: &str) -> Option<Column> {
    match name.to_ascii_lowercase().as_str() {
        "t" | "ts" | "time" | "times" | "timestamp" | "timestamps" => Some(Column::T),
        "x" | "xs" => Some(Column::X),
        "y" | "ys" => Some(Column::Y),
        "p" | "ps" | "pol" | "polarity" | "polarities" | "on" => Some(Column::P),
        "t_in" => Some(Column::TIn),
        _ => None,
    }
}

impl Table {
    /// Adds an array that holds one column, N or N x 1 or 1 x N.
    pub(crate) fn add_column(
        &mut self,
        column: Column,
        place: Place,
        header: &Header,
    ) -> Result<(), FormatError> {
        let Element::Number(number) = &header.element else {
            return Err(shape_error(&place, header, "one number an event"));
        };
        let sides: Vec<u64> = header.shape.iter().copied().filter(|side| *side != 1).collect();
        let rows = match sides.as_slice() {
            [] => header.elements().unwrap_or(0).min(1),
            [rows] => *rows,
            _ => return Err(shape_error(&place, header, "one number an event")),
        };
        self.push(Source {
            place,
            start: header.start,
            stride: number.bytes,
            fields: vec![(column, *number, 0)],
            rows,
        });
        Ok(())
    }

    /// Adds an array of several columns, N x k: what they hold, from the left.
    pub(crate) fn add_columns(
        &mut self,
        columns: &[Column],
        place: Place,
        header: &Header,
    ) -> Result<(), FormatError> {
        let Element::Number(number) = &header.element else {
            return Err(shape_error(&place, header, "rows of numbers"));
        };
        let (Some(&rows), Some(&width), true) =
            (header.shape.first(), header.shape.get(1), header.shape.len() == 2)
        else {
            return Err(shape_error(&place, header, "rows of numbers"));
        };
        if width < columns.len() as u64 || width > (WIDEST / number.bytes) as u64 {
            return Err(shape_error(&place, header, &format!("{} columns", columns.len())));
        }
        let used = columns.iter().enumerate().filter(|(_, column)| **column != Column::Skip);
        if header.fortran {
            for (index, column) in used {
                let start = header.start + index as u64 * rows * number.bytes as u64;
                self.push(Source {
                    place: place.clone(),
                    start,
                    stride: number.bytes,
                    fields: vec![(*column, *number, 0)],
                    rows,
                });
            }
        } else {
            let fields = used.map(|(index, column)| (*column, *number, index * number.bytes)).collect();
            self.push(Source {
                place,
                start: header.start,
                stride: number.bytes * width as usize,
                fields,
                rows,
            });
        }
        Ok(())
    }

    /// Adds an array of records, by the names of their fields.
    pub(crate) fn add_records(&mut self, place: Place, header: &Header) -> Result<(), FormatError> {
        let Element::Record(named, bytes) = &header.element else {
            return Err(shape_error(&place, header, "records"));
        };
        if *bytes > WIDEST || header.shape.len() != 1 {
            return Err(shape_error(&place, header, "one record an event"));
        }
        let fields = named
            .iter()
            .filter_map(|(name, scalar, at)| column_named(name).map(|column| (column, *scalar, *at)))
            .collect();
        self.push(Source { place, start: header.start, stride: *bytes, fields, rows: header.shape[0] });
        Ok(())
    }

    fn push(&mut self, source: Source) {
        self.rows = if self.sources.is_empty() { source.rows } else { self.rows.min(source.rows) };
        self.sources.push(source);
    }

    /// Counts what all rows hold, as `reading` takes stamps and coordinates.
    pub(crate) fn tally(self: &Arc<Table>, reading: Reading, tally: &mut Tally) -> Result<(), FormatError> {
        TableCursor::open(self.clone(), Reading { rules: Rules::default(), ..reading })?.tally(tally)
    }

    /// How a column is stored.
    pub(crate) fn scalar(&self, column: Column) -> Option<Scalar> {
        self.sources
            .iter()
            .flat_map(|source| &source.fields)
            .find(|field| field.0 == column)
            .map(|field| field.1)
    }

    /// Says what is missing, or twice there.
    pub(crate) fn check(&self, path: &Path, names: &str) -> Result<(), FormatError> {
        for (column, name) in [(Column::T, "t"), (Column::X, "x"), (Column::Y, "y"), (Column::P, "p")] {
            let count = self
                .sources
                .iter()
                .flat_map(|source| &source.fields)
                .filter(|field| field.0 == column)
                .count();
            if count != 1 {
                let what = if count == 0 { "no" } else { "more than one" };
                return Err(FormatError::new(
                    path,
                    format!("{what} array for `{name}`; it holds {names}"),
                    "save events with the keys t, x, y and p",
                )
                .expected(
                    "arrays t, x, y, p (or timestamp, polarity), records with these fields, or \
                               one array of N x 4",
                ));
            }
        }
        Ok(())
    }

    /// What the sources disagree about: losses to be reported when opening. A plain file's rows are cut to
    /// what it has.
    pub(crate) fn compare(&mut self) -> Result<Vec<Loss>, FormatError> {
        let mut losses = Vec::new();
        for source in &mut self.sources {
            let room = source.place.bytes()?.saturating_sub(source.start) / source.stride.max(1) as u64;
            if source.rows > room {
                let what = format!(
                    "its header claims {} rows and {room} are there; the file is cut off",
                    source.rows
                );
                losses.push(Loss::new(source.place.name(), what).by(Cause::Cut));
                source.rows = room;
            }
        }
        self.rows = self.sources.iter().map(|source| source.rows).min().unwrap_or(0);
        for source in &self.sources {
            if source.rows > self.rows && losses.is_empty() {
                let what = format!(
                    "it has {} rows and another array only {}; the rest belongs to no event",
                    source.rows, self.rows
                );
                losses.push(Loss::new(source.place.name(), what));
            }
        }
        Ok(losses)
    }

    /// Some rows of a column, spread over the array where that is cheap: the first of them, and the last of
    /// an array that is not deflated.
    pub(crate) fn sample(&self, column: Column, most: usize) -> Result<Vec<f64>, FormatError> {
        let mut values = Vec::new();
        let Some(source) =
            self.sources.iter().find(|source| source.fields.iter().any(|field| field.0 == column))
        else {
            return Ok(values);
        };
        let Some((_, scalar, at)) = source.fields.iter().find(|field| field.0 == column).copied() else {
            return Ok(values);
        };
        let most = most.min(usize::try_from(self.rows).unwrap_or(usize::MAX));
        let mut firsts = vec![0];
        if self.rows > 2 * most as u64 && source.place.member.is_none() {
            firsts.push(self.rows - most as u64);
        }
        for first in firsts {
            let mut bytes = source.place.open(source.start + first * source.stride as u64)?;
            let mut rows = vec![0; most * source.stride];
            let whole = fill(&mut bytes, &mut rows, &source.place)? / source.stride;
            each(scalar, &rows[..whole * source.stride], source.stride, at, |number| {
                values.push(match number {
                    Number::Whole(value) => value as f64,
                    Number::Beyond => f64::INFINITY,
                    Number::Fraction(value) => value,
                });
            });
        }
        Ok(values)
    }
}

fn shape_error(place: &Place, header: &Header, expected: &str) -> FormatError {
    let element = match &header.element {
        Element::Number(number) => number.name(),
        Element::Record(fields, _) => format!(
            "records of {}",
            fields.iter().map(|field| field.0.as_str()).collect::<Vec<_>>().join(", ")
        ),
    };
    FormatError::new(
        &place.path,
        format!("an array of shape {:?} of {element}", header.shape),
        "save events as arrays t, x, y, p of one length",
    )
    .at(place.name())
    .expected(expected.to_string())
}

/// Fills the buffer as far as the data go; what cannot be unpacked ends them.
fn fill(bytes: &mut Bytes, buffer: &mut [u8], place: &Place) -> Result<usize, FormatError> {
    let mut filled = 0;
    while filled < buffer.len() {
        match bytes.read(&mut buffer[filled..]) {
            Ok(0) => break,
            Ok(read) => filled += read,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            // A damaged member, not a disk that fails.
            Err(error)
                if place.member.is_some()
                    && matches!(
                        error.kind(),
                        ErrorKind::InvalidInput | ErrorKind::InvalidData | ErrorKind::UnexpectedEof
                    ) =>
            {
                break;
            }
            Err(error) => return Err(FormatError::io(&place.path, &error)),
        }
    }
    Ok(filled)
}

/// A number that stands for "not to be read".
const NONE: i64 = crate::convention::NONE;

/// A cursor over a table.
pub(crate) struct TableCursor {
    table: Arc<Table>,
    reading: Reading,
    /// Places have fractions, and these pixels have their events.
    warped: Option<Arc<Warped>>,
    /// Are places read in parts of a pixel?
    is_fine: bool,
    /// Of each event that warped places were spread to, the row that it comes from.
    rows_of: Vec<usize>,
    streams: Vec<Bytes>,
    row: u64,
    rows: Vec<u8>,
    columns: [Vec<i64>; 5],
    losses: Losses,
}

fn slot(column: Column) -> usize {
    match column {
        Column::T => 0,
        Column::X => 1,
        Column::Y => 2,
        Column::P => 3,
        Column::TIn | Column::Skip => 4,
    }
}

impl TableCursor {
    /// Opens all sources at their first row.
    pub(crate) fn open(table: Arc<Table>, reading: Reading) -> Result<TableCursor, FormatError> {
        let streams =
            table.sources.iter().map(|source| source.place.open(source.start)).collect::<Result<_, _>>()?;
        Ok(TableCursor {
            table,
            reading,
            warped: None,
            is_fine: false,
            rows_of: Vec::new(),
            streams,
            row: 0,
            rows: Vec::new(),
            columns: Default::default(),
            losses: Losses::default(),
        })
    }

    /// The same, where pixels have the events of warped places.
    pub(crate) fn open_warped(
        table: Arc<Table>,
        reading: Reading,
        warped: Option<Arc<Warped>>,
    ) -> Result<TableCursor, FormatError> {
        let is_fine = warped.is_some();
        Ok(TableCursor { warped, is_fine, ..TableCursor::open(table, reading)? })
    }

    /// Distinct places of at most so many rows, in parts of a pixel.
    pub(crate) fn places(mut self, most: usize, places: &mut HashSet<(i64, i64)>) -> Result<(), FormatError> {
        self.is_fine = true;
        let mut rows = 0;
        while rows < most
            && let Some((wanted, got)) = self.load()?
        {
            let [_, x, y, ..] = &self.columns;
            let is_place = |(x, y): &(i64, i64)| *x != NONE && *y != NONE;
            places.extend(x.iter().copied().zip(y.iter().copied()).take(got).filter(is_place));
            rows += got;
            self.row = if got < wanted { self.table.rows } else { self.row + got as u64 };
        }
        Ok(())
    }

    /// Gives every event to the pixels that its place belongs to; one that belongs to none is outside.
    fn spread(&mut self, warped: &Warped, rows: usize) -> usize {
        let [t, x, y, p, _] = &self.columns;
        let mut spread: [Vec<i64>; 5] = Default::default();
        self.rows_of.clear();
        for k in 0..rows {
            let mut push = |x: i64, y: i64| {
                spread.iter_mut().zip([t[k], x, y, p[k]]).for_each(|(to, value)| to.push(value));
                self.rows_of.push(k);
            };
            let (pixels, width) = (warped.pixels_of((x[k], y[k])), warped.extent().width);
            if pixels.is_empty() {
                push(NONE, NONE);
            }
            pixels.iter().for_each(|pixel| push((pixel % width).into(), (pixel / width).into()));
        }
        self.columns = spread;
        self.rows_of.len()
    }

    /// Hands over what was left out.
    pub(crate) fn into_losses(self) -> Losses {
        self.losses
    }

    /// Reads the next rows of all columns as they are stored: how many were wanted, and how many there are.
    /// `None` at the end.
    fn load(&mut self) -> Result<Option<(usize, usize)>, FormatError> {
        let wanted =
            usize::try_from(self.table.rows.saturating_sub(self.row)).unwrap_or(usize::MAX).min(CHUNK_EVENTS);
        if wanted == 0 {
            return Ok(None);
        }
        for column in &mut self.columns {
            column.clear();
        }
        let mut got = wanted;
        let table = self.table.clone();
        for (source, stream) in table.sources.iter().zip(&mut self.streams) {
            self.rows.resize(wanted * source.stride, 0);
            let whole =
                fill(stream, &mut self.rows[..wanted * source.stride], &source.place)? / source.stride;
            got = got.min(whole);
            for &(column, scalar, at) in &source.fields {
                let into = &mut self.columns[slot(column)];
                let rows = &self.rows[..whole * source.stride];
                let Reading { unit, scale, wraps_at, .. } = self.reading;
                match column {
                    Column::T | Column::TIn => {
                        each(scalar, rows, source.stride, at, |number| into.push(time(number, unit)))
                    }
                    Column::X if self.is_fine => each(scalar, rows, source.stride, at, |number| {
                        into.push(part(number, scale, wraps_at.map(|(x, _)| x)))
                    }),
                    Column::Y if self.is_fine => each(scalar, rows, source.stride, at, |number| {
                        into.push(part(number, scale, wraps_at.map(|(_, y)| y)))
                    }),
                    Column::X => each(scalar, rows, source.stride, at, |number| {
                        into.push(pixel(number, scale, wraps_at.map(|(x, _)| x)))
                    }),
                    Column::Y => each(scalar, rows, source.stride, at, |number| {
                        into.push(pixel(number, scale, wraps_at.map(|(_, y)| y)))
                    }),
                    Column::P => each(scalar, rows, source.stride, at, |number| into.push(polarity(number))),
                    Column::Skip => {}
                }
            }
        }
        Ok(Some((wanted, got)))
    }

    /// Counts what all rows hold.
    pub(crate) fn tally(mut self, tally: &mut Tally) -> Result<(), FormatError> {
        while let Some((wanted, got)) = self.load()? {
            let [t, x, y, p, _] = &self.columns;
            (0..got).for_each(|k| tally.add(t[k], x[k], y[k], p[k]));
            self.row = if got < wanted { self.table.rows } else { self.row + got as u64 };
        }
        Ok(())
    }

    fn take(&mut self, chunk: &mut EventChunk, rows: usize) {
        let [t, x, y, p, t_in] = &self.columns;
        let (width, height) = self
            .reading
            .extent
            .map_or((1 << 16, 1 << 16), |extent| (i64::from(extent.width), i64::from(extent.height)));
        let first = self.row;
        for k in 0..rows {
            let (inside_x, inside_y) =
                ((0..width.min(1 << 16)).contains(&x[k]), (0..height.min(1 << 16)).contains(&y[k]));
            let has_t_in = !self.reading.has_t_in || t_in[k] != NONE;
            let on = self.reading.rules.on(p[k]);
            if let Some(on) = on.filter(|_| inside_x && inside_y && t[k] != NONE && has_t_in) {
                chunk.push(t[k], x[k] as u16, y[k] as u16, on);
                if let Some(all) = &mut chunk.t_in {
                    all.push(t_in[k]);
                }
                continue;
            }
            let row = self.rows_of.get(k).copied().unwrap_or(k);
            let at = || format!("event {}", first + row as u64);
            if t[k] == NONE || !has_t_in {
                self.losses.add_by(
                    Cause::Stamp,
                    "events without a finite stamp were left out",
                    1,
                    at,
                    || "its stamp is not finite, or beyond 292 years; it was left out".into(),
                );
            } else if on.is_none() {
                let what = || "its polarity is none of 0, 1, -1; it was left out".into();
                self.losses.add_by(
                    Cause::Polarity,
                    "events whose polarity is none of 0, 1, -1 were left out",
                    1,
                    at,
                    what,
                );
            } else {
                let what = || match self.reading.extent {
                    Some(extent) => format!("its pixel lies outside {extent}; it was left out"),
                    None => "its pixel is negative, not finite or beyond 65,535; it was left out".into(),
                };
                self.losses.add_by(
                    Cause::Outside,
                    "events outside the pixel array were left out",
                    1,
                    at,
                    what,
                );
            }
        }
    }
}

/// A stamp as ns.
#[inline]
pub(crate) fn time(number: Number, unit: TimeUnit) -> i64 {
    match number {
        Number::Whole(value) => value.checked_mul(unit.ns()).unwrap_or(NONE),
        Number::Beyond => NONE,
        Number::Fraction(value) => {
            let ns = (value * unit.ns() as f64).round();
            // 2^63 is the first that does not fit; NaN fails both comparisons.
            if ns > -9.2e18 && ns < 9.2e18 { ns as i64 } else { NONE }
        }
    }
}

/// A coordinate as a pixel, halves up.
#[inline]
fn pixel(number: Number, scale: u32, wraps_at: Option<i64>) -> i64 {
    let scale = i64::from(scale);
    match number {
        Number::Whole(value) if scale == 1 => value,
        Number::Whole(value) => {
            let value = if wraps_at.is_some_and(|from| value >= from) { value - 65_536 } else { value };
            value.saturating_add(scale / 2).div_euclid(scale)
        }
        Number::Beyond => NONE,
        Number::Fraction(value) => {
            let pixel = (value / scale as f64 + 0.5).floor();
            if (-1.0..65_536.0).contains(&pixel) { pixel as i64 } else { NONE }
        }
    }
}

/// A coordinate in parts of a pixel.
#[inline]
fn part(number: Number, scale: u32, wraps_at: Option<i64>) -> i64 {
    match number {
        Number::Whole(value) => {
            let value = if wraps_at.is_some_and(|from| value >= from) { value - 65_536 } else { value };
            warped::fine(value as f64, scale)
        }
        Number::Beyond => NONE,
        Number::Fraction(value) => warped::fine(value, scale),
    }
}

/// A polarity as it is stored.
#[inline]
fn polarity(number: Number) -> i64 {
    match number {
        Number::Whole(value) => value,
        // -1 in 64 bits without a sign.
        Number::Beyond => i64::MAX,
        Number::Fraction(value) if value.fract() == 0.0 && value.abs() < 9e15 => value as i64,
        Number::Fraction(_) => NONE,
    }
}

impl EventCursor for TableCursor {
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        chunk.clear();
        match (self.reading.has_t_in, &chunk.t_in) {
            (true, None) => chunk.t_in = Some(Vec::new()),
            (false, Some(_)) => chunk.t_in = None,
            _ => {}
        }
        let Some((wanted, got)) = self.load()? else { return Ok(false) };
        let table = self.table.clone();
        let origin = self.reading.rules;
        if !origin.is_usual() && !self.is_fine {
            let [_, x, y, ..] = &mut self.columns;
            x.iter_mut().chain(y).for_each(|place| *place = origin.pixel(*place));
        }
        let events = match self.warped.clone() {
            Some(warped) => self.spread(&warped, got),
            None => got,
        };
        self.take(chunk, events);
        self.row += got as u64;
        if got < wanted {
            let (row, rows) = (self.row, self.table.rows);
            let what = || {
                format!("the data end or cannot be unpacked after {row} of {rows} events; the rest is lost")
            };
            self.losses.add_by(Cause::Cut, "arrays that end early", 1, || format!("event {row}"), what);
            self.row = rows;
        }
        if self.row >= self.table.rows {
            for (source, stream) in
                table.sources.iter().zip(&self.streams).filter(|(_, stream)| stream.is_damaged())
            {
                let _ = stream;
                let what = || {
                    "its checksum is not the one that the archive states: some of its numbers are \
                               damaged, and which ones is not known"
                        .into()
                };
                self.losses.add("arrays whose checksum is wrong", || source.place.name(), what);
            }
        }
        Ok(true)
    }

    fn seek(&mut self, _t_ns: i64) -> Result<(), FormatError> {
        // Stamps need not be sorted, so that only the beginning is safe.
        *self = TableCursor::open_warped(self.table.clone(), self.reading, self.warped.clone())?;
        Ok(())
    }

    fn losses(&self) -> Vec<Loss> {
        self.losses.list()
    }

    fn position(&self) -> (u64, u64) {
        (self.row, self.table.rows)
    }
}
