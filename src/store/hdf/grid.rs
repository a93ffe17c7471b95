//! Datasets of one number type, read box by box: [`Chunks`] with a type.

use super::chunks::Chunks;
use super::{Item, Opened, locked};
use crate::error::StoreError;
use hdf5::types::TypeDescriptor;

/// A dataset of numbers that can be read box by box, from many threads.
pub(crate) struct Grid<T> {
    chunks: Chunks,
    /// Length along each dimension.
    pub shape: Vec<usize>,
    of: std::marker::PhantomData<T>,
}

impl<T: Item> Grid<T> {
    /// Opens `/name`; `None` when there is none. Refuses another number type, naming both.
    pub(crate) fn open(opened: &Opened, name: &str) -> Result<Option<Grid<T>>, StoreError> {
        let at = format!("/{name}");
        let Some(dataset) = opened.dataset(name)? else { return Ok(None) };
        let found = opened.wrap(
            &at,
            "read the number type",
            locked(|| dataset.dtype().and_then(|dtype| dtype.to_descriptor())),
        )?;
        let expected = T::type_descriptor();
        if found != expected {
            let hint = format!("write the dataset as {expected}");
            return Err(opened.content(
                &at,
                format!("numbers of type {found}"),
                format!("numbers of type {expected}"),
                hint,
            ));
        }
        let native = locked(|| {
            dataset.dtype().is_ok_and(|dtype| dtype.byte_order() != hdf5::datatype::ByteOrder::BigEndian)
        });
        let memory = opened.wrap(&at, "read the number type", locked(hdf5::Datatype::from_type::<T>))?;
        let chunks = Chunks::new(opened, &at, dataset, memory, native);
        Ok(Some(Grid { shape: chunks.shape.clone(), chunks, of: std::marker::PhantomData }))
    }

    /// Keeps up to `bytes` of unpacked chunks, for readers that come back for the next frame of the same
    /// chunks.
    pub(crate) fn keeping(self, bytes: usize) -> Grid<T> {
        Grid { chunks: self.chunks.keeping(bytes), ..self }
    }

    /// The numbers of the box that begins at `start` and has `count` numbers along each dimension, last
    /// dimension fastest.
    pub(crate) fn read(&self, start: &[usize], count: &[usize]) -> Result<Vec<T>, StoreError> {
        // A box that is not inside is refused below, before it is trusted in size.
        let inside = start.len() == count.len()
            && count.iter().zip(&self.shape).all(|(count, length)| count <= length);
        let mut values = vec![T::default(); if inside { count.iter().product() } else { 0 }];
        self.chunks.read(start, count, bytemuck::cast_slice_mut(&mut values), None)?;
        Ok(values)
    }

    /// All numbers of a column, or a part of it.
    pub(crate) fn column(&self, range: std::ops::Range<usize>) -> Result<Vec<T>, StoreError> {
        self.read(&[range.start], &[range.len()])
    }
}

/// The number type of `/name`, as a message says it; `None` when there is no such dataset.
pub(crate) fn number_type(opened: &Opened, name: &str) -> Result<Option<TypeDescriptor>, StoreError> {
    let Some(dataset) = opened.dataset(name)? else { return Ok(None) };
    opened
        .wrap(
            &format!("/{name}"),
            "read the number type",
            locked(|| dataset.dtype().and_then(|dtype| dtype.to_descriptor())),
        )
        .map(Some)
}
