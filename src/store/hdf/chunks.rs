//! Boxes of an n-dimensional dataset as plain bytes: only the chunks that a box touches, unpacked in
//! parallel.
//!
//! A chunked dataset whose filters are known ([`Pipeline`]) is read chunk by chunk as stored bytes and
//! unpacked here. Anything else that the library can read (contiguous, other filters that are built in) goes
//! through the ordinary, slower read.
//!
//! A damaged chunk is an error, or a [`Hole`] for readers that go on behind it.

use super::pipeline::Pipeline;
use super::{Opened, locked};
use crate::error::StoreError;
use crate::threads;
use hdf5::{Dataset, Datatype};
use hdf5_sys::h5::{herr_t, hsize_t};
use hdf5_sys::h5d::H5D_fill_value_t;
use hdf5_sys::h5i::hid_t;
use std::collections::{HashMap, VecDeque};
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

unsafe extern "C" {
    /// Part of HDF5 since 1.10.2; the binding crate does not declare it. Its by-coordinate sibling walks all
    /// chunks, this one does not.
    fn H5Dget_chunk_storage_size(dataset: hid_t, offset: *const hsize_t, size: *mut hsize_t) -> herr_t;
}

/// Chunks that are unpacked at a time: enough for all cores, little memory.
const BATCH: usize = 64;
/// Bytes that are unpacked at a time, unless a single chunk has more.
const BATCH_BYTES: usize = 64 << 20;

/// Chunks of a dataset that a trial reads.
const TRIED_CHUNKS: usize = 16;
/// Bytes of a chunk or row that a trial reads at most.
const TRIED_BYTES: usize = 4 << 20;

/// A dataset that can be read box by box, from many threads.
pub(crate) struct Chunks {
    pub opened: Opened,
    pub at: String,
    pub dataset: Dataset,
    /// Length along each dimension.
    pub shape: Vec<usize>,
    /// Bytes of one element.
    pub item: usize,
    /// The type in which the ordinary read gives elements.
    memory: Datatype,
    packed: Option<Packed>,
    /// Rows of a dataset without chunks that stand in the file; fewer than all where it is cut.
    whole_rows: usize,
    recent: Option<Recent>,
}

struct Packed {
    chunk: Vec<usize>,
    pipeline: Pipeline,
    /// One element of a chunk that was never written.
    fill: Vec<u8>,
}

/// Rows (first dimension) whose numbers are not there, filled with something.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Hole {
    pub rows: Range<usize>,
    /// "the checksum of a chunk is wrong".
    pub why: String,
}

impl Chunks {
    /// Of a dataset that passed the checks of [`Opened::dataset`]. Elements have `memory`'s size and, without
    /// `native`, its bytes as they are stored.
    pub(crate) fn new(opened: &Opened, at: &str, dataset: Dataset, memory: Datatype, native: bool) -> Chunks {
        let (shape, item) = locked(|| (dataset.shape(), memory.size()));
        let packed = if native { locked(|| packed_form(&dataset, &memory, item)) } else { None };
        let whole_rows = whole_rows(opened, &dataset, &shape, item);
        Chunks {
            opened: opened.clone(),
            at: at.into(),
            dataset,
            shape,
            item,
            memory,
            packed,
            whole_rows,
            recent: None,
        }
    }

    /// Keeps up to `bytes` of unpacked chunks, one at least, for readers that come back to the same chunks.
    pub(crate) fn keeping(self, bytes: usize) -> Chunks {
        Chunks { recent: Some(Recent { budget: bytes, kept: Mutex::default() }), ..self }
    }

    /// Fills `out` with the box that begins at `start` and has `count` elements along each dimension, last
    /// dimension fastest. A damaged chunk is an error, or a hole when `holes` are collected.
    pub(crate) fn read(
        &self,
        start: &[usize],
        count: &[usize],
        out: &mut [u8],
        mut holes: Option<&mut Vec<Hole>>,
    ) -> Result<(), StoreError> {
        let inside = start.len() == self.shape.len() && count.len() == self.shape.len();
        let inside = inside
            && (0..self.shape.len())
                .all(|d| start[d].checked_add(count[d]).is_some_and(|end| end <= self.shape[d]));
        if !inside || out.len() != count.iter().product::<usize>() * self.item {
            return Err(self.opened.content(
                &self.at,
                format!("the shape {:?}", self.shape),
                format!("numbers from {start:?} on, {count:?} of them"),
                "the file changed or is damaged: write it again",
            ));
        }
        if out.is_empty() {
            return Ok(());
        }
        let Some(packed) = &self.packed else {
            return self.read_without_chunks(start, count, out, holes);
        };
        let chunk_bytes = packed.chunk.iter().product::<usize>() * self.item;
        let batch = (BATCH_BYTES / chunk_bytes.max(1)).clamp(1, BATCH);
        for batch in chunks_of(start, count, &packed.chunk).chunks(batch) {
            let chunks = threads::map(batch, |origin| self.chunk(packed, origin));
            for (origin, chunk) in batch.iter().zip(chunks) {
                match (chunk, &mut holes) {
                    (Ok(chunk), holes) => {
                        copy_overlap(origin, &packed.chunk, &chunk.bytes, start, count, out, self.item);
                        if let (Some(holes), false) = (holes, chunk.is_written) {
                            holes.push(self.hole(packed, origin, "it was never written".into()));
                        }
                    }
                    (Err(why), Some(holes)) => holes.push(self.hole(packed, origin, why)),
                    (Err(why), None) => {
                        return Err(self.opened.content(
                            &self.at,
                            why,
                            "a whole chunk",
                            "the file is damaged: copy or make it again",
                        ));
                    }
                }
            }
        }
        Ok(())
    }

    /// Makes the calls that reading makes, some of them: a few chunks are looked up and, where they are
    /// small, read as they are stored; without chunks, the first and the last row are read. Starts no thread
    /// and unpacks nothing.
    pub(crate) fn try_out(&self) {
        let rows = self.shape.first().copied().unwrap_or(1);
        let row = self.shape.iter().skip(1).fold(self.item, |bytes, &n| bytes.saturating_mul(n));
        if rows == 0 || row == 0 {
            return;
        }
        let Some(packed) = &self.packed else {
            let mut out = vec![0; if row <= TRIED_BYTES { row } else { 0 }];
            for first in [0, rows - 1] {
                let (mut start, mut count) = (vec![0; self.shape.len()], self.shape.clone());
                if let (Some(start), Some(count)) = (start.first_mut(), count.first_mut()) {
                    (*start, *count) = (first, 1);
                }
                if !out.is_empty() {
                    drop(self.read_ordinary(&start, &count, &mut out));
                }
            }
            return;
        };
        let counts: Vec<usize> =
            (0..self.shape.len()).map(|d| self.shape[d].div_ceil(packed.chunk[d])).collect();
        let all = counts.iter().fold(1usize, |all, &n| all.saturating_mul(n));
        for k in 0..TRIED_CHUNKS.min(all) {
            let mut flat =
                (k as u128 * (all - 1) as u128 / (TRIED_CHUNKS.min(all) - 1).max(1) as u128) as usize;
            let mut origin = vec![0; counts.len()];
            for d in (0..counts.len()).rev() {
                origin[d] = flat % counts[d] * packed.chunk[d];
                flat /= counts[d];
            }
            let unpacked = packed.chunk.iter().fold(self.item, |bytes, &n| bytes.saturating_mul(n));
            if unpacked <= TRIED_BYTES {
                drop(self.stored(&origin, unpacked));
            }
        }
    }

    fn hole(&self, packed: &Packed, origin: &[usize], why: String) -> Hole {
        Hole { rows: origin[0]..(origin[0] + packed.chunk[0]).min(self.shape[0]), why }
    }

    fn chunk(&self, packed: &Packed, origin: &[usize]) -> Result<Arc<Chunk>, String> {
        if let Some(chunk) = self.recent.as_ref().and_then(|recent| recent.get(origin)) {
            return Ok(chunk);
        }
        let mut bytes = vec![0; packed.chunk.iter().product::<usize>() * self.item];
        let stored = self.stored(origin, bytes.len())?;
        let is_written = stored.is_some();
        match stored {
            Some((stored, mask)) => packed.pipeline.undo(stored, mask, &mut bytes)?,
            None if packed.fill.iter().any(|&byte| byte != 0) => {
                bytes.chunks_exact_mut(self.item).for_each(|item| item.copy_from_slice(&packed.fill))
            }
            None => {}
        }
        let chunk = Arc::new(Chunk { bytes, is_written });
        if let Some(recent) = &self.recent {
            recent.put(origin, &chunk);
        }
        Ok(chunk)
    }

    /// The stored bytes of a chunk and the mask of filters left out; `None` when it was never written.
    fn stored(&self, origin: &[usize], unpacked: usize) -> Result<Option<(Vec<u8>, u32)>, String> {
        let offset: Vec<hsize_t> = origin.iter().map(|&o| o as hsize_t).collect();
        // Of a cut file all chunks behind the cut have one reason, so that they make one gap.
        let failed = |doing: &str| {
            self.opened.cut().unwrap_or_else(|| format!("the library cannot {doing} the chunk at {origin:?}"))
        };
        locked(|| {
            let mut size: hsize_t = 0;
            // SAFETY: the dataset is open and chunked, and `offset` has one entry per dimension.
            if unsafe { H5Dget_chunk_storage_size(self.dataset.id(), offset.as_ptr(), &mut size) } < 0 {
                return Err(failed("find"));
            }
            if size == 0 {
                return Ok(None);
            }
            // No filter makes noise twice as long.
            if size > self.opened.bytes || size > 2 * unpacked as u64 + (1 << 16) {
                return Err(format!("the chunk at {origin:?} claims {size} bytes for {unpacked}"));
            }
            let (mut bytes, mut mask) = (vec![0u8; size as usize], 0u32);
            let defaults = hdf5_sys::h5p::H5P_DEFAULT;
            // SAFETY: the buffer has the size that the library just stated, under the same lock.
            let status = unsafe {
                hdf5_sys::h5d::H5Dread_chunk1(
                    self.dataset.id(),
                    defaults,
                    offset.as_ptr(),
                    &mut mask,
                    bytes.as_mut_ptr().cast(),
                )
            };
            if status < 0 {
                return Err(failed("read"));
            }
            Ok(Some((bytes, mask)))
        })
    }

    /// Rows that lie behind the end of a cut file are a hole, or an error.
    fn read_without_chunks(
        &self,
        start: &[usize],
        count: &[usize],
        out: &mut [u8],
        holes: Option<&mut Vec<Hole>>,
    ) -> Result<(), StoreError> {
        let (first, rows) = (start.first().copied().unwrap_or(0), count.first().copied().unwrap_or(1));
        let there = self.whole_rows.clamp(first, first + rows) - first;
        if there == rows {
            return self.read_ordinary(start, count, out);
        }
        let why = self.opened.cut().unwrap_or_default();
        let Some(holes) = holes else {
            return Err(self.opened.content(&self.at, why, "a whole file", "copy or record it again"));
        };
        holes.push(Hole { rows: first + there..first + rows, why });
        if there == 0 {
            return Ok(());
        }
        let part = out.len() / rows * there;
        let count = [&[there], &count[1..]].concat();
        self.read_ordinary(start, &count, &mut out[..part])
    }

    fn read_ordinary(&self, start: &[usize], count: &[usize], out: &mut [u8]) -> Result<(), StoreError> {
        use hdf5_sys::{h5d, h5p, h5s};
        let start: Vec<hsize_t> = start.iter().map(|&n| n as hsize_t).collect();
        let count: Vec<hsize_t> = count.iter().map(|&n| n as hsize_t).collect();
        let result = locked(|| {
            // SAFETY: the box lies inside the dataset and `out` has room for its elements (checked by
            // `read`), the memory space has the same number of elements, and both spaces are closed again
            // whatever happens in between. A dataset of one element has no box: all of it is read.
            let status = unsafe {
                if start.is_empty() {
                    h5d::H5Dread(
                        self.dataset.id(),
                        self.memory.id(),
                        h5s::H5S_ALL,
                        h5s::H5S_ALL,
                        h5p::H5P_DEFAULT,
                        out.as_mut_ptr().cast(),
                    )
                } else {
                    let file_space = h5d::H5Dget_space(self.dataset.id());
                    let memory_space =
                        h5s::H5Screate_simple(count.len() as i32, count.as_ptr(), std::ptr::null());
                    let (stride, block) = (std::ptr::null(), std::ptr::null());
                    let selected = h5s::H5Sselect_hyperslab(
                        file_space,
                        h5s::H5S_seloper_t::H5S_SELECT_SET,
                        start.as_ptr(),
                        stride,
                        count.as_ptr(),
                        block,
                    );
                    let status = if selected < 0 {
                        selected
                    } else {
                        h5d::H5Dread(
                            self.dataset.id(),
                            self.memory.id(),
                            memory_space,
                            file_space,
                            h5p::H5P_DEFAULT,
                            out.as_mut_ptr().cast(),
                        )
                    };
                    h5s::H5Sclose(memory_space);
                    h5s::H5Sclose(file_space);
                    status
                }
            };
            if status < 0 {
                Err(hdf5::Error::from(
                    "stored numbers are damaged, cut short, or use a filter that is not built in",
                ))
            } else {
                Ok(())
            }
        });
        self.opened.wrap(&self.at, "read numbers", result)
    }
}

/// A chunk without its filters.
struct Chunk {
    bytes: Vec<u8>,
    is_written: bool,
}

/// Rows of a dataset without chunks that lie before the end of a file; all of them when the file is whole.
fn whole_rows(opened: &Opened, dataset: &Dataset, shape: &[usize], item: usize) -> usize {
    let rows = shape.first().copied().unwrap_or(1);
    let row = shape.iter().skip(1).fold(item, |bytes, &n| bytes.saturating_mul(n));
    // A dataset in its header has no address.
    match locked(|| dataset.offset()) {
        Some(offset) if opened.stated_bytes.is_some() && row > 0 => {
            rows.min((opened.bytes.saturating_sub(offset) / row as u64) as usize)
        }
        _ => rows,
    }
}

fn packed_form(dataset: &Dataset, memory: &Datatype, item: usize) -> Option<Packed> {
    let chunk = dataset.chunk()?;
    let properties = dataset.create_plist().ok()?;
    let pipeline = Pipeline::of(properties.id()).ok()?;
    let mut fill = vec![0; item];
    let mut defined = H5D_fill_value_t::H5D_FILL_VALUE_DEFAULT;
    // SAFETY: the buffer holds one element of the type. A fill value of a damaged file may have a size and
    // nothing else; the library asks its type all the same, and the process would end there: so it is asked
    // first whether the value is whole.
    let got = unsafe {
        hdf5_sys::h5p::H5Pfill_value_defined(properties.id(), &mut defined) >= 0
            && matches!(defined, H5D_fill_value_t::H5D_FILL_VALUE_USER_DEFINED)
            && hdf5_sys::h5p::H5Pget_fill_value(properties.id(), memory.id(), fill.as_mut_ptr().cast()) >= 0
    };
    if !got {
        fill.fill(0);
    }
    chunk.iter().all(|&n| n > 0).then_some(Packed { chunk, pipeline, fill })
}

/// Origins of the chunks that a box touches, in storage order.
fn chunks_of(start: &[usize], count: &[usize], chunk: &[usize]) -> Vec<Vec<usize>> {
    let mut origins = vec![Vec::new()];
    for d in 0..start.len() {
        let first = start[d] / chunk[d];
        let last = (start[d] + count[d] - 1) / chunk[d];
        origins = origins
            .into_iter()
            .flat_map(|origin| (first..=last).map(move |c| [origin.as_slice(), &[c * chunk[d]]].concat()))
            .collect();
    }
    origins
}

/// Copies what two boxes of `item`-byte elements share from one to the other, run by run along the last
/// dimension.
fn copy_overlap(
    from_start: &[usize],
    from_count: &[usize],
    from: &[u8],
    to_start: &[usize],
    to_count: &[usize],
    to: &mut [u8],
    item: usize,
) {
    let last = from_start.len() - 1;
    let low: Vec<usize> = (0..=last).map(|d| from_start[d].max(to_start[d])).collect();
    let high: Vec<usize> =
        (0..=last).map(|d| (from_start[d] + from_count[d]).min(to_start[d] + to_count[d])).collect();
    if (0..=last).any(|d| low[d] >= high[d]) {
        return;
    }
    let run = (high[last] - low[last]) * item;
    let offset = |at: &[usize], start: &[usize], count: &[usize]| {
        (0..=last).fold(0, |flat, d| flat * count[d] + at[d] - start[d]) * item
    };
    let mut at = low.clone();
    loop {
        let (source, target) = (offset(&at, from_start, from_count), offset(&at, to_start, to_count));
        to[target..target + run].copy_from_slice(&from[source..source + run]);
        // The next run: count up over all dimensions but the last.
        let mut d = last;
        loop {
            if d == 0 {
                return;
            }
            d -= 1;
            at[d] += 1;
            if at[d] < high[d] {
                break;
            }
            at[d] = low[d];
        }
    }
}

/// Unpacked chunks that were used last, up to a budget; the oldest goes first, and the last one stays
/// whatever its size.
struct Recent {
    budget: usize,
    kept: Mutex<Kept>,
}

#[derive(Default)]
struct Kept {
    chunks: HashMap<Vec<usize>, Arc<Chunk>>,
    order: VecDeque<Vec<usize>>,
    bytes: usize,
}

impl Recent {
    fn get(&self, origin: &[usize]) -> Option<Arc<Chunk>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner).chunks.get(origin).cloned()
    }

    fn put(&self, origin: &[usize], chunk: &Arc<Chunk>) {
        let size = chunk.bytes.len();
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.chunks.insert(origin.to_vec(), chunk.clone()).is_some() {
            return;
        }
        kept.order.push_back(origin.to_vec());
        kept.bytes += size;
        while kept.bytes > self.budget
            && kept.order.len() > 1
            && let Some(oldest) = kept.order.pop_front()
        {
            kept.chunks.remove(&oldest);
            kept.bytes -= size;
        }
    }
}
