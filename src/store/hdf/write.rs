//! Writing numbers: chunks packed in parallel, then handed to the library as raw bytes in a fixed order.

use super::pack::{AS_IT_IS, pack};
use super::{Item, Opened, locked};
use crate::error::StoreError;
use crate::threads;
use hdf5::{Dataset, Extent, Extents, SimpleExtents};
use hdf5_sys::h5::hsize_t;

/// Numbers in a chunk of a column: 512 kB of stamps.
const COLUMN_CHUNK: usize = 1 << 16;

/// Chunks that a column collects before it packs them together.
const COLUMN_BATCH: usize = 16;

/// A dataset of fixed shape, written chunk by chunk.
pub(crate) struct GridWriter {
    opened: Opened,
    at: String,
    dataset: Dataset,
}

impl GridWriter {
    /// Creates `/name` with shuffle and deflate; `growing` lets the first dimension grow later.
    /// A shape without numbers is stored without chunks, and nothing may be written to it.
    pub(crate) fn create<T: Item>(
        opened: &Opened,
        name: &str,
        shape: &[usize],
        chunk: &[usize],
        growing: bool,
    ) -> Result<GridWriter, StoreError> {
        let at = format!("/{name}");
        let dataset = locked(|| {
            // Times of modification would make equal contents unequal files.
            let builder = opened.file.new_dataset::<T>().obj_track_times(false);
            if shape.contains(&0) && !growing {
                return builder.no_chunk().shape(shape).create(name);
            }
            let extents: Vec<Extent> = shape
                .iter()
                .enumerate()
                .map(|(d, &n)| if growing && d == 0 { Extent::resizable(n) } else { Extent::from(n) })
                .collect();
            builder
                .shuffle()
                .deflate(1)
                .chunk(chunk)
                .shape(Extents::Simple(SimpleExtents::new(extents)))
                .create(name)
        });
        Ok(GridWriter {
            opened: opened.clone(),
            at: at.clone(),
            dataset: opened.wrap(&at, "create the dataset", dataset)?,
        })
    }

    /// The dataset, for its attributes.
    pub(crate) fn dataset(&self) -> &Dataset {
        &self.dataset
    }

    /// Writes whole chunks, each with its origin and padded to full size; packs them in parallel where the
    /// file packs.
    pub(crate) fn write<T: Item, C: AsRef<[T]> + Sync>(
        &self,
        chunks: &[(Vec<usize>, C)],
    ) -> Result<(), StoreError> {
        if !self.opened.packs {
            return chunks.iter().try_for_each(|(origin, values)| {
                self.write_chunk(origin, bytemuck::cast_slice(values.as_ref()), AS_IT_IS)
            });
        }
        let packed: Vec<(Vec<u8>, u32)> = threads::map(chunks, |(_, values)| pack(values.as_ref()));
        let mut packed = chunks.iter().zip(packed);
        packed.try_for_each(|((origin, _), (bytes, mask))| self.write_chunk(origin, &bytes, mask))
    }

    fn write_chunk(&self, origin: &[usize], bytes: &[u8], mask: u32) -> Result<(), StoreError> {
        let offset: Vec<hsize_t> = origin.iter().map(|&o| o as hsize_t).collect();
        let defaults = hdf5_sys::h5p::H5P_DEFAULT;
        // SAFETY: the dataset is open and chunked, `offset` has one entry per dimension, and the buffer its
        // stated length.
        let status = locked(|| unsafe {
            hdf5_sys::h5d::H5Dwrite_chunk(
                self.dataset.id(),
                defaults,
                mask,
                offset.as_ptr(),
                bytes.len(),
                bytes.as_ptr().cast(),
            )
        });
        if status >= 0 {
            return Ok(());
        }
        Err(StoreError::Library {
            path: self.opened.path.clone(),
            at: self.at.clone(),
            doing: "write numbers",
            detail: format!("the chunk at {origin:?} was refused; is the disk full?"),
        })
    }

    fn grow(&self, length: usize) -> Result<(), StoreError> {
        self.opened.wrap(&self.at, "enlarge the dataset", locked(|| self.dataset.resize(length)))
    }
}

/// A column of numbers whose length is not known before its end.
pub(crate) struct ColumnWriter<T> {
    opened: Opened,
    name: String,
    writer: Option<GridWriter>,
    written: usize,
    pending: Vec<T>,
}

impl<T: Item> ColumnWriter<T> {
    /// Of the dataset `/name`, which comes into being with the first full chunk, or at the end.
    pub(crate) fn new(opened: &Opened, name: &str) -> ColumnWriter<T> {
        ColumnWriter {
            opened: opened.clone(),
            name: name.into(),
            writer: None,
            written: 0,
            pending: Vec::new(),
        }
    }

    /// Numbers so far.
    pub(crate) fn len(&self) -> usize {
        self.written + self.pending.len()
    }

    /// Adds numbers. Many at once are packed from where they are.
    pub(crate) fn append(&mut self, mut values: &[T]) -> Result<(), StoreError> {
        const BATCH: usize = COLUMN_BATCH * COLUMN_CHUNK;
        if !self.pending.is_empty() && self.pending.len() + values.len() >= BATCH {
            let (first, rest) = values.split_at(values.len().min(self.missing_of_chunk()));
            self.pending.extend_from_slice(first);
            let pending = std::mem::take(&mut self.pending);
            self.write(&pending, COLUMN_CHUNK)?;
            (self.pending, values) = (pending, rest);
            self.pending.clear();
        }
        while self.pending.is_empty() && values.len() >= BATCH {
            let (batch, rest) = values.split_at(BATCH);
            self.write(batch, COLUMN_CHUNK)?;
            values = rest;
        }
        self.pending.extend_from_slice(values);
        Ok(())
    }

    /// Numbers that the last chunk of what is pending has room for.
    fn missing_of_chunk(&self) -> usize {
        self.pending.len().next_multiple_of(COLUMN_CHUNK) - self.pending.len()
    }

    fn write(&mut self, values: &[T], chunk: usize) -> Result<(), StoreError> {
        let writer = match self.writer.take() {
            Some(writer) => writer,
            None => GridWriter::create::<T>(&self.opened, &self.name, &[0], &[chunk], true)?,
        };
        writer.grow(self.written + values.len())?;
        let chunks: Vec<(Vec<usize>, std::borrow::Cow<[T]>)> = values
            .chunks(chunk)
            .enumerate()
            .map(|(i, part)| {
                let mut part = std::borrow::Cow::Borrowed(part);
                if part.len() < chunk {
                    part.to_mut().resize(chunk, T::default());
                }
                (vec![self.written + i * chunk], part)
            })
            .collect();
        writer.write(&chunks)?;
        self.written += values.len();
        self.writer = Some(writer);
        Ok(())
    }

    /// Writes the rest and gives the dataset, for its attributes.
    pub(crate) fn finish(mut self) -> Result<GridWriter, StoreError> {
        if !self.pending.is_empty() {
            // A short column gets one chunk of its own length.
            let chunk =
                if self.writer.is_some() { COLUMN_CHUNK } else { self.pending.len().min(COLUMN_CHUNK) };
            let pending = std::mem::take(&mut self.pending);
            self.write(&pending, chunk)?;
        }
        match self.writer {
            Some(writer) => Ok(writer),
            None => GridWriter::create::<T>(&self.opened, &self.name, &[0], &[1], false),
        }
    }
}

/// Rows that stand together in a chunk of frames or maps: at most 8, so that a band reads little it does not
/// need, and fewer when a strip of so many rows through everything would not fit 64 MiB.
pub(crate) fn rows_per_chunk(height: usize, bytes_per_row: usize) -> usize {
    ((64 << 20) / bytes_per_row.max(1)).clamp(1, 8).min(height.max(1))
}

/// Frames that stand together in a chunk: 8 keeps a single frame cheap to read, and a chunk stays below 1
/// MiB.
pub(crate) fn frames_per_chunk(frames: usize, rows: usize, row_bytes: usize) -> usize {
    ((1 << 20) / (rows * row_bytes).max(1)).clamp(1, 8).min(frames.max(1))
}
