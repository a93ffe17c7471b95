//! Frames and maps: dense grids in chunks of a few rows (and a few frames), so that a row band and a time
//! range are both cheap.

use super::columns::{create_group, each_band, required};
use crate::error::StoreError;
use crate::hdf::Opened;
use crate::hdf::grid::Grid;
use crate::hdf::write::{GridWriter, frames_per_chunk, rows_per_chunk};
use crate::threads;
use photocurrent_core::frames::FrameSource;
use photocurrent_core::handle::BandSource;
use photocurrent_core::map::MapBand;
use photocurrent_core::value::ValueDigest;
use photocurrent_core::{DataError, FrameBlock, FrameSequence, FramesMeta, MapMeta, MapSet, Meta, Rows};
use std::ops::Range;
use std::sync::Arc;

/// Chunks that wait to be packed together.
const QUEUE: usize = 32;

/// Memory for unpacked chunks of one sequence, so that reading frame after frame unpacks each chunk once.
const KEPT_BYTES: usize = 64 << 20;

/// Memory for one read while a part is copied into the file.
const COPIED_BYTES: usize = 128 << 20;

/// Frames of any kind being written to a dataset \[n, h, row values\], strip of rows by strip of rows.
pub(crate) struct StripWriter {
    writer: GridWriter,
    frames: usize,
    height: usize,
    row_values: usize,
    strip_rows: usize,
    chunk_frames: usize,
    /// The strip being filled, as [frame][row of the strip][value].
    strip: Vec<f32>,
    /// Rows complete in the file or in the strip.
    next_row: usize,
    queue: Vec<(Vec<usize>, Vec<f32>)>,
}

impl StripWriter {
    /// Creates the dataset. `tail` are the dimensions after the rows: `[w]` or `[w, channels]`.
    pub(crate) fn create<T: crate::hdf::Item>(
        opened: &Opened,
        name: &str,
        frames: usize,
        height: usize,
        tail: &[usize],
    ) -> Result<StripWriter, StoreError> {
        let row_values: usize = tail.iter().product();
        let row_bytes = row_values * 4;
        let strip_rows = rows_per_chunk(height, frames * row_bytes);
        let chunk_frames = frames_per_chunk(frames, strip_rows, row_bytes);
        let shape = [&[frames, height], tail].concat();
        let chunk: Vec<usize> = [&[chunk_frames, strip_rows], tail].concat();
        let writer = GridWriter::create::<T>(opened, name, &shape, &chunk, false)?;
        let strip = vec![0.0; frames * strip_rows * row_values];
        Ok(StripWriter {
            writer,
            frames,
            height,
            row_values,
            strip_rows,
            chunk_frames,
            strip,
            next_row: 0,
            queue: Vec::new(),
        })
    }

    /// The dataset, for its attributes.
    pub(crate) fn dataset(&self) -> &hdf5::Dataset {
        self.writer.dataset()
    }

    /// Adds the next rows of all frames; `convert` makes what is stored of a DN.
    pub(crate) fn append<T: crate::hdf::Item>(
        &mut self,
        block: &FrameBlock,
        convert: impl Fn(f32) -> T + Sync,
    ) -> Result<(), StoreError> {
        for row in block.rows.iter() {
            let in_strip = self.next_row % self.strip_rows;
            for frame in block.frames.clone() {
                let at = (frame * self.strip_rows + in_strip) * self.row_values;
                self.strip[at..at + self.row_values].copy_from_slice(block.row(frame, row));
            }
            self.next_row += 1;
            if self.next_row.is_multiple_of(self.strip_rows) || self.next_row == self.height {
                self.queue_strip(&convert)?;
            }
        }
        Ok(())
    }

    fn queue_strip<T: crate::hdf::Item>(
        &mut self,
        convert: &(impl Fn(f32) -> T + Sync),
    ) -> Result<(), StoreError> {
        if self.strip.is_empty() {
            return Ok(());
        }
        let first_row = (self.next_row - 1) / self.strip_rows * self.strip_rows;
        let chunk_values = self.chunk_frames * self.strip_rows * self.row_values;
        // In the strip, the frames of a chunk follow each other: a chunk is one piece of it.
        for (i, piece) in self.strip.chunks(chunk_values).enumerate() {
            let mut chunk = piece.to_vec();
            chunk.resize(chunk_values, 0.0);
            let mut origin = vec![i * self.chunk_frames, first_row];
            origin.resize(self.dataset().ndim(), 0);
            self.queue.push((origin, chunk));
        }
        self.strip.fill(0.0);
        if self.queue.len() >= QUEUE || self.next_row == self.height {
            self.flush(convert)?;
        }
        Ok(())
    }

    fn flush<T: crate::hdf::Item>(&mut self, convert: &(impl Fn(f32) -> T + Sync)) -> Result<(), StoreError> {
        // A few chunks at a time, so that the converted copies stay small however many frames there are.
        for part in self.queue.chunks(QUEUE) {
            let converted: Vec<(Vec<usize>, Vec<T>)> = threads::map(part, |(origin, values)| {
                (origin.clone(), values.iter().map(|&value| convert(value)).collect())
            });
            self.writer.write(&converted)?;
        }
        self.queue.clear();
        Ok(())
    }

    /// How many rows of a part to read at once.
    pub(crate) fn rows_at_once(&self) -> u32 {
        let per_row = (self.frames * self.row_values * 4).max(1);
        (COPIED_BYTES / per_row).clamp(1, 64) as u32
    }
}

/// Frames being written.
pub(super) struct FramesBody(StripWriter);

impl FramesBody {
    pub(super) fn create(opened: &Opened, meta: &FramesMeta) -> Result<FramesBody, StoreError> {
        create_group(opened, "frames")?;
        StripWriter::create::<f32>(
            opened,
            "frames/dn",
            meta.times.len(),
            meta.extent.height as usize,
            &[meta.row_values()],
        )
        .map(FramesBody)
    }

    pub(super) fn append(
        &mut self,
        part: &FrameSequence,
        mut digest: Option<&mut ValueDigest>,
    ) -> Result<(), StoreError> {
        for rows in part.rows().bands(self.0.rows_at_once()) {
            let block = part.read_rows(rows).map_err(StoreError::Source)?;
            if let Some(digest) = &mut digest {
                let rows: Vec<u32> = rows.iter().collect();
                digest.add_rows(&threads::map(&rows, |row| block.row_digest(*row)));
            }
            self.0.append(&block, |dn| dn)?;
        }
        Ok(())
    }

    pub(super) fn finish(self) -> Result<(), StoreError> {
        // The last row of the sensor flushed everything.
        Ok(())
    }
}

/// A map being written, to a dataset \[h, planes, w\].
pub(super) struct MapBody {
    writer: GridWriter,
    chunk_rows: usize,
    row_values: usize,
    first_row: usize,
    pending: Vec<f32>,
}

impl MapBody {
    pub(super) fn create(opened: &Opened, meta: &MapMeta) -> Result<MapBody, StoreError> {
        create_group(opened, "map")?;
        let (height, planes, width) =
            (meta.extent.height as usize, meta.planes.len(), meta.extent.width as usize);
        let chunk_rows = rows_per_chunk(height, planes * width * 4);
        let writer = GridWriter::create::<f32>(
            opened,
            "map/values",
            &[height, planes, width],
            &[chunk_rows, planes, width],
            false,
        )?;
        Ok(MapBody { writer, chunk_rows, row_values: planes * width, first_row: 0, pending: Vec::new() })
    }

    pub(super) fn append(
        &mut self,
        part: &MapSet,
        digest: Option<&mut ValueDigest>,
    ) -> Result<(), StoreError> {
        each_band(part, digest, |band| {
            self.pending.extend_from_slice(&band.values);
            if self.pending.len() >= QUEUE * self.chunk_rows * self.row_values {
                self.flush(false)
            } else {
                Ok(())
            }
        })
    }

    fn flush(&mut self, last: bool) -> Result<(), StoreError> {
        let chunk_values = self.chunk_rows * self.row_values;
        if chunk_values == 0 {
            return Ok(());
        }
        let count =
            if last { self.pending.len() } else { self.pending.len() - self.pending.len() % chunk_values };
        let mut chunks = Vec::new();
        for piece in self.pending[..count].chunks(chunk_values) {
            let mut chunk = piece.to_vec();
            chunk.resize(chunk_values, 0.0);
            chunks.push((vec![self.first_row, 0, 0], chunk));
            self.first_row += self.chunk_rows;
        }
        self.pending.drain(..count);
        self.writer.write(&chunks)
    }

    pub(super) fn finish(mut self, opened: &Opened, meta: &Meta) -> Result<(), StoreError> {
        self.flush(true)?;
        let Meta::Map(meta) = meta else { return Ok(()) };
        opened.set_text_attribute(self.writer.dataset(), "planes", &meta.planes.join("\n"))
    }
}

struct FramesSource {
    grid: Grid<f32>,
    row_values: usize,
}

impl FrameSource for FramesSource {
    fn read(&self, frames: Range<usize>, rows: Rows) -> Result<FrameBlock, DataError> {
        let dn = self
            .grid
            .read(&[frames.start, rows.start as usize, 0], &[frames.len(), rows.len(), self.row_values])?;
        Ok(FrameBlock { frames, rows, row_values: self.row_values, dn })
    }
}

pub(super) fn open_frames(opened: &Opened, meta: Arc<FramesMeta>) -> Result<FrameSequence, StoreError> {
    let grid = required::<f32>(opened, "frames/dn")?;
    let expected = [meta.times.len(), meta.extent.height as usize, meta.row_values()];
    if grid.shape != expected {
        let hint = "the artefact is damaged: run the pipeline again";
        return Err(opened.content(
            "/frames/dn",
            format!("the shape {:?}", grid.shape),
            format!("{expected:?}"),
            hint,
        ));
    }
    let (rows, row_values) = (meta.extent.rows(), meta.row_values());
    Ok(FrameSequence::new(meta, rows, Arc::new(FramesSource { grid: grid.keeping(KEPT_BYTES), row_values })))
}

struct MapSource {
    opened: Opened,
    grid: Grid<f32>,
    meta: Arc<MapMeta>,
}

impl BandSource<MapBand> for MapSource {
    fn read(&self, rows: Rows) -> Result<MapBand, DataError> {
        let values = self
            .grid
            .read(&[rows.start as usize, 0, 0], &[rows.len(), self.grid.shape[1], self.grid.shape[2]])?;
        MapBand::from_values(rows, &self.meta, values).ok_or_else(|| {
            DataError::new(format!("{}: /map/values does not fit its planes", self.opened.path.display()))
        })
    }
}

pub(super) fn open_map(opened: &Opened, meta: Arc<MapMeta>) -> Result<MapSet, StoreError> {
    let grid = required::<f32>(opened, "map/values")?;
    let expected = [meta.extent.height as usize, meta.planes.len(), meta.extent.width as usize];
    if grid.shape != expected {
        let hint = "the artefact is damaged: run the pipeline again";
        return Err(opened.content(
            "/map/values",
            format!("the shape {:?}", grid.shape),
            format!("{expected:?}"),
            hint,
        ));
    }
    let rows = meta.extent.rows();
    Ok(MapSet::new(meta.clone(), rows, Arc::new(MapSource { opened: opened.clone(), grid, meta })))
}
