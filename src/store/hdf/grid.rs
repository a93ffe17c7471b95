//! Reading boxes of an n-dimensional dataset: only the chunks that a box touches, unpacked in parallel.
//!
//! A dataset whose filters are shuffle and deflate, in native number type, is read chunk by chunk as raw bytes and unpacked here.
//! Anything else that the library can read (contiguous, LZF, big-endian) goes through the ordinary, slower read. Both give the same numbers.

use super::pack::{Filters, unpack};
use super::{Item, Opened, locked};
use crate::error::StoreError;
use crate::threads;
use hdf5::Dataset;
use hdf5::filters::Filter;
use hdf5::types::TypeDescriptor;
use hdf5_sys::h5::{herr_t, hsize_t};
use hdf5_sys::h5i::hid_t;
use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};

unsafe extern "C" {
    /// Part of HDF5 since 1.10.2; the binding crate does not declare it. Its by-coordinate sibling walks all chunks, this one does not.
    fn H5Dget_chunk_storage_size(dataset: hid_t, offset: *const hsize_t, size: *mut hsize_t) -> herr_t;
}

/// Chunks that are unpacked at a time: enough for all cores, little memory.
const BATCH: usize = 64;

/// A dataset of numbers that can be read box by box, from many threads.
pub(crate) struct Grid<T> {
    opened: Opened,
    at: String,
    dataset: Dataset,
    /// Length along each dimension.
    pub shape: Vec<usize>,
    packed: Option<Packed>,
    recent: Option<Recent<T>>,
}

struct Packed {
    chunk: Vec<usize>,
    filters: Filters,
}

impl<T: Item> Grid<T> {
    /// Opens `/name`; `None` when there is none. Refuses another number type, naming both.
    pub fn open(opened: &Opened, name: &str) -> Result<Option<Grid<T>>, StoreError> {
        let at = format!("/{name}");
        let Some(dataset) = opened.dataset(name)? else { return Ok(None) };
        let found = opened.wrap(&at, "read the number type", locked(|| dataset.dtype().and_then(|dtype| dtype.to_descriptor())))?;
        let expected = T::type_descriptor();
        if found != expected {
            let hint = format!("write the dataset as {expected}");
            return Err(opened.content(&at, format!("numbers of type {found}"), format!("numbers of type {expected}"), hint));
        }
        let shape = locked(|| dataset.shape());
        let packed = locked(|| packed_form::<T>(&dataset));
        Ok(Some(Grid { opened: opened.clone(), at, dataset, shape, packed, recent: None }))
    }

    /// Keeps up to `bytes` of unpacked chunks, for readers that come back for the next frame of the same chunks.
    pub fn keeping(self, bytes: usize) -> Grid<T> {
        Grid { recent: Some(Recent { budget: bytes, kept: Mutex::default() }), ..self }
    }

    /// The numbers of the box that begins at `start` and has `count` numbers along each dimension, last dimension fastest.
    pub fn read(&self, start: &[usize], count: &[usize]) -> Result<Vec<T>, StoreError> {
        let inside = start.len() == self.shape.len() && count.len() == self.shape.len();
        let inside = inside && (0..self.shape.len()).all(|d| start[d].checked_add(count[d]).is_some_and(|end| end <= self.shape[d]));
        if !inside {
            return Err(self.opened.content(
                &self.at,
                format!("the shape {:?}", self.shape),
                format!("numbers from {start:?} on, {count:?} of them"),
                "the file changed or is damaged: write it again",
            ));
        }
        let mut values = vec![T::default(); count.iter().product()];
        if values.is_empty() {
            return Ok(values);
        }
        match &self.packed {
            Some(packed) => self.read_packed(packed, start, count, &mut values)?,
            None => self.read_ordinary(start, count, &mut values)?,
        }
        Ok(values)
    }

    fn read_packed(&self, packed: &Packed, start: &[usize], count: &[usize], values: &mut [T]) -> Result<(), StoreError> {
        for batch in chunks_of(start, count, &packed.chunk).chunks(BATCH) {
            let chunks: Result<Vec<Arc<Vec<T>>>, StoreError> = threads::map(batch, |origin| self.chunk(packed, origin)).into_iter().collect();
            for (origin, chunk) in batch.iter().zip(chunks?) {
                copy_overlap(origin, &packed.chunk, &chunk, start, count, values);
            }
        }
        Ok(())
    }

    fn chunk(&self, packed: &Packed, origin: &[usize]) -> Result<Arc<Vec<T>>, StoreError> {
        if let Some(chunk) = self.recent.as_ref().and_then(|recent| recent.get(origin)) {
            return Ok(chunk);
        }
        let mut values = vec![T::default(); packed.chunk.iter().product()];
        match self.raw_chunk(origin)? {
            Some((bytes, mask)) => {
                let damaged = |why| self.opened.content(&self.at, why, "a whole chunk", "the file is damaged: copy or make it again");
                unpack(bytes, packed.filters, mask, &mut values).map_err(damaged)?;
            }
            // Never written: the library knows the fill value.
            None => {
                let count: Vec<usize> = (0..origin.len()).map(|d| packed.chunk[d].min(self.shape[d] - origin[d])).collect();
                let mut part = vec![T::default(); count.iter().product()];
                self.read_ordinary(origin, &count, &mut part)?;
                copy_overlap(origin, &count, &part, origin, &packed.chunk, &mut values);
            }
        }
        let chunk = Arc::new(values);
        if let Some(recent) = &self.recent {
            recent.put(origin, &chunk);
        }
        Ok(chunk)
    }

    /// The stored bytes of a chunk and the mask of filters left out; `None` when it was never written.
    fn raw_chunk(&self, origin: &[usize]) -> Result<Option<(Vec<u8>, u32)>, StoreError> {
        let offset: Vec<hsize_t> = origin.iter().map(|&o| o as hsize_t).collect();
        let failed =
            |doing| StoreError::Library { path: self.opened.path.clone(), at: self.at.clone(), doing, detail: format!("the chunk at {origin:?} is damaged") };
        locked(|| {
            let mut size: hsize_t = 0;
            // SAFETY: the dataset is open and chunked, and `offset` has one entry per dimension.
            if unsafe { H5Dget_chunk_storage_size(self.dataset.id(), offset.as_ptr(), &mut size) } < 0 {
                return Err(failed("find a chunk"));
            }
            if size == 0 {
                return Ok(None);
            }
            if size > self.opened.bytes {
                return Err(failed("believe the size of a chunk"));
            }
            let (mut bytes, mut mask) = (vec![0u8; size as usize], 0u32);
            let defaults = hdf5_sys::h5p::H5P_DEFAULT;
            // SAFETY: the buffer has the size that the library just stated, under the same lock.
            let status = unsafe { hdf5_sys::h5d::H5Dread_chunk1(self.dataset.id(), defaults, offset.as_ptr(), &mut mask, bytes.as_mut_ptr().cast()) };
            if status < 0 { Err(failed("read a chunk")) } else { Ok(Some((bytes, mask))) }
        })
    }

    fn read_ordinary(&self, start: &[usize], count: &[usize], values: &mut [T]) -> Result<(), StoreError> {
        use hdf5_sys::{h5d, h5p, h5s};
        let start: Vec<hsize_t> = start.iter().map(|&n| n as hsize_t).collect();
        let count: Vec<hsize_t> = count.iter().map(|&n| n as hsize_t).collect();
        let result = locked(|| {
            let native = hdf5::Datatype::from_type::<T>()?;
            // SAFETY: the box lies inside the dataset (checked by `read`), the memory space has the same number of elements as `values`,
            // and both spaces are closed again whatever happens in between.
            let status = unsafe {
                let file_space = h5d::H5Dget_space(self.dataset.id());
                let memory_space = h5s::H5Screate_simple(count.len() as i32, count.as_ptr(), std::ptr::null());
                let (stride, block) = (std::ptr::null(), std::ptr::null());
                let selected = h5s::H5Sselect_hyperslab(file_space, h5s::H5S_seloper_t::H5S_SELECT_SET, start.as_ptr(), stride, count.as_ptr(), block);
                let status = if selected < 0 {
                    selected
                } else {
                    h5d::H5Dread(self.dataset.id(), native.id(), memory_space, file_space, h5p::H5P_DEFAULT, values.as_mut_ptr().cast())
                };
                h5s::H5Sclose(memory_space);
                h5s::H5Sclose(file_space);
                status
            };
            if status < 0 { Err(hdf5::Error::from("stored numbers are damaged, cut short, or use a filter that is not built in")) } else { Ok(()) }
        });
        self.opened.wrap(&self.at, "read numbers", result)
    }
}

impl<T: Item> Grid<T> {
    /// All numbers of a column, or a part of it.
    pub fn column(&self, range: std::ops::Range<usize>) -> Result<Vec<T>, StoreError> {
        self.read(&[range.start], &[range.len()])
    }
}

/// The number type of `/name`, as a message says it; `None` when there is no such dataset.
pub(crate) fn number_type(opened: &Opened, name: &str) -> Result<Option<TypeDescriptor>, StoreError> {
    let Some(dataset) = opened.dataset(name)? else { return Ok(None) };
    opened.wrap(&format!("/{name}"), "read the number type", locked(|| dataset.dtype().and_then(|dtype| dtype.to_descriptor()))).map(Some)
}

fn packed_form<T: Item>(dataset: &Dataset) -> Option<Packed> {
    let chunk = dataset.chunk()?;
    let native = dataset.dtype().ok()?.byte_order() != hdf5::datatype::ByteOrder::BigEndian;
    let filters = match dataset.filters().as_slice() {
        [] => Filters::None,
        [Filter::Shuffle] => Filters::Shuffle,
        [Filter::Deflate(_)] => Filters::Deflate,
        [Filter::Shuffle, Filter::Deflate(_)] => Filters::ShuffleDeflate,
        _ => return None,
    };
    (native && chunk.iter().all(|&n| n > 0)).then_some(Packed { chunk, filters })
}

/// Origins of the chunks that a box touches, in storage order.
fn chunks_of(start: &[usize], count: &[usize], chunk: &[usize]) -> Vec<Vec<usize>> {
    let mut origins = vec![Vec::new()];
    for d in 0..start.len() {
        let first = start[d] / chunk[d];
        let last = (start[d] + count[d] - 1) / chunk[d];
        origins = origins.into_iter().flat_map(|origin| (first..=last).map(move |c| [origin.as_slice(), &[c * chunk[d]]].concat())).collect();
    }
    origins
}

/// Copies what two boxes share from one to the other, run by run along the last dimension.
fn copy_overlap<T: Copy>(from_start: &[usize], from_count: &[usize], from: &[T], to_start: &[usize], to_count: &[usize], to: &mut [T]) {
    let last = from_start.len() - 1;
    let low: Vec<usize> = (0..=last).map(|d| from_start[d].max(to_start[d])).collect();
    let high: Vec<usize> = (0..=last).map(|d| (from_start[d] + from_count[d]).min(to_start[d] + to_count[d])).collect();
    if (0..=last).any(|d| low[d] >= high[d]) {
        return;
    }
    let run = high[last] - low[last];
    let offset = |at: &[usize], start: &[usize], count: &[usize]| (0..=last).fold(0, |flat, d| flat * count[d] + at[d] - start[d]);
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

/// Unpacked chunks that were used last, up to a budget; the oldest goes first.
struct Recent<T> {
    budget: usize,
    kept: Mutex<Kept<T>>,
}

struct Kept<T> {
    chunks: HashMap<Vec<usize>, Arc<Vec<T>>>,
    order: VecDeque<Vec<usize>>,
    bytes: usize,
}

impl<T> Default for Kept<T> {
    fn default() -> Self {
        Kept { chunks: HashMap::new(), order: VecDeque::new(), bytes: 0 }
    }
}

impl<T> Recent<T> {
    fn get(&self, origin: &[usize]) -> Option<Arc<Vec<T>>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner).chunks.get(origin).cloned()
    }

    fn put(&self, origin: &[usize], chunk: &Arc<Vec<T>>) {
        let size = size_of_val(chunk.as_slice());
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.chunks.insert(origin.to_vec(), chunk.clone()).is_some() {
            return;
        }
        kept.order.push_back(origin.to_vec());
        kept.bytes += size;
        while kept.bytes > self.budget
            && let Some(oldest) = kept.order.pop_front()
        {
            kept.chunks.remove(&oldest);
            kept.bytes -= size;
        }
    }
}
