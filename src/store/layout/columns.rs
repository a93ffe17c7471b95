//! Events: flat columns in canonical order, with offsets per row, so that a row band is one piece; and what
//! other columns need too.

use crate::error::StoreError;
use crate::hdf::Opened;
use crate::hdf::grid::Grid;
use crate::hdf::write::ColumnWriter;
use crate::threads;
use photocurrent_core::handle::InTime;
use photocurrent_core::handle::{Band, BandMeta, BandSource, Handle};
use photocurrent_core::value::ValueDigest;
use photocurrent_core::{DataError, EventBand, EventStream, EventsMeta, Rows, TimeSpan};
use std::ops::Range;
use std::sync::Arc;

/// Rows that are read, hashed and packed together.
const ROWS_AT_ONCE: u32 = 64;

/// Events of a row that are looked through; in longer rows a window is searched for.
const SEARCHED: usize = 1 << 16;

pub(super) const DAMAGED: &str = "the artefact is damaged: run the pipeline again";

/// Reads a part band by band and adds its rows to the digest, where one is made. What is in memory is one
/// band, and not copied.
pub(super) fn each_band<M: BandMeta>(
    part: &Handle<M>,
    mut digest: Option<&mut ValueDigest>,
    mut take: impl FnMut(&M::Band) -> Result<(), StoreError>,
) -> Result<(), StoreError> {
    let mut take = |band: &M::Band| {
        if let Some(digest) = &mut digest {
            let rows: Vec<u32> = band.rows().iter().collect();
            digest.add_rows(&threads::map(&rows, |row| band.row_digest(*row)));
        }
        take(band)
    };
    if let Some(band) = part.borrowed() {
        return take(band);
    }
    let mut bands = part.rows().bands(ROWS_AT_ONCE).into_iter();
    bands.try_for_each(|rows| take(&part.read(rows).map_err(StoreError::Source)?))
}

/// Events being written.
pub(super) struct EventsBody {
    x: ColumnWriter<u16>,
    p: ColumnWriter<u8>,
    t: ColumnWriter<i64>,
    t_in: Option<ColumnWriter<i64>>,
    step: Option<ColumnWriter<f32>>,
    row_offsets: Vec<u64>,
}

impl EventsBody {
    pub(super) fn create(opened: &Opened, meta: &EventsMeta) -> Result<EventsBody, StoreError> {
        create_group(opened, "events")?;
        Ok(EventsBody {
            x: ColumnWriter::new(opened, "events/x"),
            p: ColumnWriter::new(opened, "events/p"),
            t: ColumnWriter::new(opened, "events/t"),
            t_in: meta.has_t_in.then(|| ColumnWriter::new(opened, "events/t_in")),
            step: meta.has_step.then(|| ColumnWriter::new(opened, "events/step")),
            row_offsets: vec![0],
        })
    }

    pub(super) fn append(
        &mut self,
        opened: &Opened,
        part: &EventStream,
        digest: Option<&mut ValueDigest>,
    ) -> Result<(), StoreError> {
        each_band(part, digest, |band| {
            if band.t_in.is_some() != self.t_in.is_some() || band.step.is_some() != self.step.is_some() {
                return Err(StoreError::Misuse {
                    path: opened.path.clone(),
                    what: "a band has other event columns than its stream announces".into(),
                });
            }
            let before = self.t.len() as u64;
            self.row_offsets.extend(band.offsets()[1..].iter().map(|&offset| before + offset as u64));
            self.x.append(&band.x)?;
            self.p.append(&band.on)?;
            self.t.append(&band.t)?;
            if let (Some(column), Some(values)) = (&mut self.t_in, &band.t_in) {
                column.append(values)?;
            }
            if let (Some(column), Some(values)) = (&mut self.step, &band.step) {
                column.append(values)?;
            }
            Ok(())
        })
    }

    pub(super) fn finish(self, opened: &Opened) -> Result<(), StoreError> {
        self.x.finish()?;
        self.p.finish()?;
        let times = [Some(self.t.finish()?), self.t_in.map(ColumnWriter::finish).transpose()?];
        for column in times.iter().flatten() {
            opened.set_text_attribute(column.dataset(), "unit", "ns")?;
        }
        self.step.map(ColumnWriter::finish).transpose()?;
        write_offsets(opened, "events/row_offsets", &self.row_offsets)
    }
}

fn write_offsets(opened: &Opened, name: &str, offsets: &[u64]) -> Result<(), StoreError> {
    let mut column = ColumnWriter::new(opened, name);
    column.append(offsets)?;
    column.finish().map(drop)
}

/// Makes a group, before anything is put into it.
pub(crate) fn create_group(opened: &Opened, name: &str) -> Result<hdf5::Group, StoreError> {
    opened.wrap(
        &format!("/{name}"),
        "create the group",
        crate::hdf::locked(|| opened.file.create_group(name)),
    )
}

/// A dataset that the artefact must have.
pub(super) fn required<T: crate::hdf::Item>(opened: &Opened, name: &str) -> Result<Grid<T>, StoreError> {
    Grid::open(opened, name)?
        .ok_or_else(|| opened.content(&format!("/{name}"), "nothing", "a dataset", DAMAGED))
}

/// A column as long as the others.
pub(super) fn column<T: crate::hdf::Item>(
    opened: &Opened,
    name: &str,
    length: usize,
) -> Result<Grid<T>, StoreError> {
    let grid = required(opened, name)?;
    if grid.shape != [length] {
        return Err(opened.content(
            &format!("/{name}"),
            format!("the shape {:?}", grid.shape),
            format!("[{length}]"),
            DAMAGED,
        ));
    }
    Ok(grid)
}

/// Checks that some offsets rise and end inside the columns, and gives them relative to the first.
pub(super) fn relative(
    opened: &Opened,
    at: &str,
    offsets: Vec<u64>,
    length: usize,
) -> Result<(usize, Vec<usize>), StoreError> {
    let first = offsets.first().copied().unwrap_or(0);
    if !offsets.is_sorted() || offsets.last().is_some_and(|&last| last > length as u64) {
        return Err(opened.content(
            at,
            "offsets that do not rise, or point outside",
            format!("rising offsets up to {length}"),
            DAMAGED,
        ));
    }
    Ok((first as usize, offsets.iter().map(|&offset| (offset - first) as usize).collect()))
}

struct EventsSource {
    opened: Opened,
    x: Grid<u16>,
    p: Grid<u8>,
    t: Grid<i64>,
    t_in: Option<Grid<i64>>,
    step: Option<Grid<f32>>,
    row_offsets: Grid<u64>,
}

impl EventsSource {
    fn band(&self, rows: Rows) -> Result<EventBand, StoreError> {
        let offsets = self.row_offsets.column(rows.start as usize..rows.start as usize + rows.len() + 1)?;
        let (first, offsets) = relative(&self.opened, "/events/row_offsets", offsets, self.t.shape[0])?;
        let range = first..first + offsets.last().copied().unwrap_or(0);
        self.columns(rows.start, offsets, range)
    }

    /// A range of the columns, whose rows have these offsets in it.
    fn columns(
        &self,
        start_row: u32,
        offsets: Vec<usize>,
        range: Range<usize>,
    ) -> Result<EventBand, StoreError> {
        let ((x, p), (t, t_in)) = threads::both(
            || (self.x.column(range.clone()), self.p.column(range.clone())),
            || {
                (
                    self.t.column(range.clone()),
                    self.t_in.as_ref().map(|column| column.column(range.clone())).transpose(),
                )
            },
        );
        let step = self.step.as_ref().map(|column| column.column(range)).transpose()?;

        EventBand::from_columns(start_row, offsets, x?, p?, t?, t_in?, step).map_err(|error| {
            self.opened.content("/events", error.message, "columns in (y, t, x) order", DAMAGED)
        })
    }

    /// What of some rows is stamped within a window. Of rows that are long, what lies outside is not read but
    /// for a few stamps.
    fn band_within(&self, rows: Rows, window: TimeSpan) -> Result<EventBand, StoreError> {
        let offsets = self.row_offsets.column(rows.start as usize..rows.start as usize + rows.len() + 1)?;
        let (first, offsets) = relative(&self.opened, "/events/row_offsets", offsets, self.t.shape[0])?;
        let mut parts = Vec::new();
        for (row, ends) in rows.bands(1).into_iter().zip(offsets.windows(2)) {
            if ends[1] - ends[0] <= SEARCHED {
                parts.push(self.band(row)?.within(window));
                continue;
            }
            let from = self.first_not_before(first + ends[0]..first + ends[1], window.start.0)?;
            let to = self.first_not_before(from..first + ends[1], window.end.0)?;
            parts.push(self.columns(row.start, vec![0, to - from], from..to)?);
        }
        Ok(if parts.is_empty() { self.band(rows)? } else { EventBand::concat(parts) })
    }

    /// The first place in a rising range of stamps that is not before `t_ns`.
    fn first_not_before(&self, range: Range<usize>, t_ns: i64) -> Result<usize, StoreError> {
        let Range { mut start, mut end } = range;
        while end - start > SEARCHED {
            let middle = start + (end - start) / 2;
            if self.t.column(middle..middle + 1)?.first().is_some_and(|t| *t < t_ns) {
                start = middle + 1
            } else {
                end = middle
            }
        }
        Ok(start + self.t.column(start..end)?.partition_point(|t| *t < t_ns))
    }
}

impl BandSource<EventBand> for EventsSource {
    fn read(&self, rows: Rows) -> Result<EventBand, DataError> {
        Ok(self.band(rows)?)
    }

    fn read_within(&self, rows: Rows, window: TimeSpan) -> Result<EventBand, DataError> {
        Ok(self.band_within(rows, window)?)
    }

    fn bytes(&self, rows: Rows) -> Option<u64> {
        let each = 11 + 8 * u64::from(self.t_in.is_some()) + 4 * u64::from(self.step.is_some());
        Some(between(&self.row_offsets, rows.start as usize, rows.end as usize)? * each)
    }
}

/// How many elements lie between two places of a column of offsets; none when it cannot be read.
pub(super) fn between(offsets: &Grid<u64>, from: usize, to: usize) -> Option<u64> {
    let at = |place: usize| offsets.column(place..place + 1).ok()?.first().copied();
    at(to)?.checked_sub(at(from)?)
}

pub(super) fn open_events(opened: &Opened, meta: &EventsMeta) -> Result<EventStream, StoreError> {
    let t: Grid<i64> = required(opened, "events/t")?;
    let n = t.shape.first().copied().unwrap_or(0);
    let source = EventsSource {
        opened: opened.clone(),
        x: column(opened, "events/x", n)?,
        p: column(opened, "events/p", n)?,
        t: column(opened, "events/t", n)?,
        t_in: meta.has_t_in.then(|| column(opened, "events/t_in", n)).transpose()?,
        step: meta.has_step.then(|| column(opened, "events/step", n)).transpose()?,
        row_offsets: column(opened, "events/row_offsets", meta.extent.height as usize + 1)?,
    };
    let meta = EventsMeta { count_hint: Some(n as u64), ..meta.clone() };
    let rows = meta.extent.rows();
    Ok(EventStream::new(Arc::new(meta), rows, Arc::new(source)))
}
