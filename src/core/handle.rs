//! A value is a handle: data is read by row band, whether it lives in memory or in the store.
//!
//! A second of one megapixel is hundreds of millions of events. So no node holds a whole recording; it asks a
//! handle for the rows it works on. [`Handle`] is the common part of events, tracks and maps: what is known
//! of the data (its meta), which rows are there, and a source to read them from. Frames, which are also read
//! by time, have their own in [`crate::frames`].

use crate::digest::{Digest, DigestBuilder};
use crate::error::DataError;
use crate::extent::{Extent, Rows};
use crate::time::TimeSpan;
use std::sync::Arc;

/// What a kind of banded data knows about itself.
pub trait BandMeta: Send + Sync + 'static {
    /// The data of some rows.
    type Band: Band<Meta = Self>;

    /// Size of the sensor.
    fn extent(&self) -> Extent;

    /// Writes every attribute that is part of the content.
    fn write_digest(&self, digest: &mut DigestBuilder);
}

/// The data of some rows.
pub trait Band: Send + Sync + Sized + 'static {
    /// What is known about data of this kind.
    type Meta: BandMeta<Band = Self>;

    /// Which rows.
    fn rows(&self) -> Rows;

    /// The digest of one row's bytes in canonical order. Independent of the band it is in.
    fn row_digest(&self, row: u32) -> Digest;

    /// Bytes that some rows take in memory; they must be inside.
    fn bytes(&self, rows: Rows) -> u64;

    /// Only the given rows, which must be inside.
    fn slice(&self, rows: Rows) -> Self;

    /// The same data, as that of rows from `start_row` on.
    fn moved(self, start_row: u32) -> Self;

    /// Bands that follow each other without gap, as one.
    fn concat(parts: Vec<Self>) -> Self;
}

/// A band whose data have stamps.
pub trait InTime: Band {
    /// Only what is stamped within the window.
    fn within(&self, window: TimeSpan) -> Self;

    /// Parts of the same rows, in order of time, as one.
    ///
    /// # Panics
    /// When there is no part: a broken invariant of the engine.
    fn follow(parts: Vec<Self>) -> Self;
}

/// Where bands come from.
pub trait BandSource<B>: Send + Sync {
    /// Reads some rows; only called with rows that the handle holds.
    fn read(&self, rows: Rows) -> Result<B, DataError>;

    /// All of it without a copy, when it is in memory.
    fn borrowed(&self) -> Option<&B> {
        None
    }

    /// Bytes that some rows take when they are read, where that is known without reading them.
    fn bytes(&self, _rows: Rows) -> Option<u64> {
        None
    }

    /// Reads what of some rows is stamped within a window of time; only called with rows that the handle
    /// holds. A source that can leave out the rest without reading it does.
    fn read_within(&self, rows: Rows, window: TimeSpan) -> Result<B, DataError>
    where
        B: InTime,
    {
        if rows.len() < 2 {
            return Ok(self.read(rows)?.within(window));
        }
        // Row by row, so that one at a time is held in full.
        let bands: Result<Vec<B>, DataError> =
            rows.bands(1).into_iter().map(|row| Ok(self.read(row)?.within(window))).collect();
        Ok(B::concat(bands?))
    }
}

impl<B: Band> BandSource<B> for B {
    fn read(&self, rows: Rows) -> Result<B, DataError> {
        Ok(self.slice(rows))
    }

    fn borrowed(&self) -> Option<&B> {
        Some(self)
    }

    fn bytes(&self, rows: Rows) -> Option<u64> {
        Some(Band::bytes(self, rows))
    }
}

/// Banded data that can be read again and again, from many threads.
pub struct Handle<M: BandMeta> {
    /// What is known about it.
    pub meta: Arc<M>,
    rows: Rows,
    source: Arc<dyn BandSource<M::Band>>,
}

impl<M: BandMeta> Clone for Handle<M> {
    fn clone(&self) -> Self {
        Handle { meta: self.meta.clone(), rows: self.rows, source: self.source.clone() }
    }
}

impl<M: BandMeta> Handle<M> {
    /// From a source that can read `rows`.
    pub fn new(meta: Arc<M>, rows: Rows, source: Arc<dyn BandSource<M::Band>>) -> Self {
        Handle { meta, rows, source }
    }

    /// Data in memory.
    pub fn in_memory(meta: Arc<M>, band: M::Band) -> Self {
        Handle { meta, rows: band.rows(), source: Arc::new(band) }
    }

    /// All rows without a copy, when they are in memory as one band; otherwise [`Handle::read`] them.
    pub fn borrowed(&self) -> Option<&M::Band> {
        self.source.borrowed().filter(|band| band.rows() == self.rows)
    }

    /// The rows that can be read.
    pub fn rows(&self) -> Rows {
        self.rows
    }

    /// Reads some rows.
    ///
    /// # Errors
    /// When a row is asked for that the handle does not hold, or the source cannot be read.
    pub fn read(&self, rows: Rows) -> Result<M::Band, DataError> {
        self.check(rows)?;
        self.source.read(rows)
    }

    /// Reads what of some rows is stamped within a window of time.
    ///
    /// # Errors
    /// As [`Handle::read`].
    pub fn read_within(&self, rows: Rows, window: TimeSpan) -> Result<M::Band, DataError>
    where
        M::Band: InTime,
    {
        self.check(rows)?;
        self.source.read_within(rows, window)
    }

    fn check(&self, rows: Rows) -> Result<(), DataError> {
        if self.rows.contains(rows) {
            Ok(())
        } else {
            Err(DataError::new(format!("{rows} were asked for, but only {} are here", self.rows)))
        }
    }

    /// Bytes that some rows take when they are read, where that is known without reading them; only of rows
    /// that are here.
    pub fn bytes(&self, rows: Rows) -> Option<u64> {
        self.source.bytes(self.rows.intersect(rows))
    }

    /// The same data, restricted to some rows.
    pub fn cut(&self, rows: Rows) -> Self {
        Handle { rows: self.rows.intersect(rows), ..self.clone() }
    }

    /// Parts that follow each other without gap, as one handle.
    ///
    /// # Panics
    /// When there is no part or the parts leave a gap: a broken invariant of the scheduler.
    pub fn splice(parts: Vec<Self>) -> Self {
        let rows = spliced_rows(parts.iter().map(|part| part.rows));
        Handle { meta: parts[0].meta.clone(), rows, source: Arc::new(Spliced(parts)) }
    }
}

/// The rows of consecutive parts together; panics when they leave a gap.
pub(crate) fn spliced_rows(mut parts: impl Iterator<Item = Rows>) -> Rows {
    let first = parts.next().expect("a splice has at least one part");
    parts.fold(first, |whole, part| {
        assert_eq!(whole.end, part.start, "spliced parts follow each other without gap");
        Rows { start: whole.start, end: part.end }
    })
}

struct Spliced<M: BandMeta>(Vec<Handle<M>>);

impl<M: BandMeta> BandSource<M::Band> for Spliced<M> {
    fn read(&self, rows: Rows) -> Result<M::Band, DataError> {
        // An empty request still needs a band of the right form: the first part gives it.
        if rows.is_empty() {
            return self.0[0].read(Rows { start: self.0[0].rows.start, end: self.0[0].rows.start });
        }
        let overlapping = self.0.iter().filter(|part| !part.rows.intersect(rows).is_empty());
        let bands: Result<Vec<M::Band>, DataError> =
            overlapping.map(|part| part.read(part.rows.intersect(rows))).collect();
        Ok(M::Band::concat(bands?))
    }

    fn bytes(&self, rows: Rows) -> Option<u64> {
        self.0.iter().filter(|part| !part.rows.intersect(rows).is_empty()).map(|part| part.bytes(rows)).sum()
    }

    fn read_within(&self, rows: Rows, window: TimeSpan) -> Result<M::Band, DataError>
    where
        M::Band: InTime,
    {
        let overlapping: Vec<&Handle<M>> =
            self.0.iter().filter(|part| !part.rows.intersect(rows).is_empty()).collect();
        if overlapping.is_empty() {
            return self.read(rows);
        }
        let bands: Result<Vec<M::Band>, DataError> =
            overlapping.into_iter().map(|part| part.read_within(part.rows.intersect(rows), window)).collect();
        Ok(M::Band::concat(bands?))
    }
}
