//! Just enough of FlatBuffers to read the few tables of AEDAT4, with every offset checked.
//!
//! A table is a block of bytes with an offset to its list of fields; a field is absent or stands at an offset
//! in the table. Everything little-endian. A damaged buffer gives `None` or a default, never a panic. Source:
//! FlatBuffers, "Internals".

/// Reads `N` bytes at `at`.
fn bytes<const N: usize>(buffer: &[u8], at: usize) -> Option<[u8; N]> {
    buffer.get(at..at.checked_add(N)?)?.try_into().ok()
}

/// A `u32` at `at`.
fn u32_at(buffer: &[u8], at: usize) -> Option<usize> {
    bytes(buffer, at).map(|value| u32::from_le_bytes(value) as usize)
}

/// A table in a buffer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Table<'a> {
    buffer: &'a [u8],
    /// Where the table stands.
    at: usize,
    /// Where its list of fields stands, and how many bytes that has.
    fields: (usize, usize),
}

impl<'a> Table<'a> {
    /// The root of a buffer that begins with its size; `identifier` is the four letters of its kind.
    pub(super) fn root(buffer: &'a [u8], identifier: &[u8; 4]) -> Option<Table<'a>> {
        let size = u32_at(buffer, 0)?;
        let buffer = buffer.get(4..size.checked_add(4)?)?;
        Self::root_of(buffer, identifier)
    }

    /// The root of the beginning of such a buffer, of which the end may be missing.
    pub(super) fn root_of_start(buffer: &'a [u8], identifier: &[u8; 4]) -> Option<Table<'a>> {
        Self::root_of(buffer.get(4..)?, identifier)
    }

    fn root_of(buffer: &'a [u8], identifier: &[u8; 4]) -> Option<Table<'a>> {
        if buffer.get(4..8)? != identifier {
            return None;
        }
        Self::at(buffer, u32_at(buffer, 0)?)
    }

    fn at(buffer: &'a [u8], at: usize) -> Option<Table<'a>> {
        let back = i64::from(i32::from_le_bytes(bytes(buffer, at)?));
        let fields = usize::try_from(i64::try_from(at).ok()?.checked_sub(back)?).ok()?;
        let length = usize::from(u16::from_le_bytes(bytes(buffer, fields)?));
        (fields.checked_add(length)? <= buffer.len()).then_some(Table {
            buffer,
            at,
            fields: (fields, length),
        })
    }

    /// Where a field stands; `None` when the table does not have it.
    fn field(&self, slot: usize) -> Option<usize> {
        let entry = 4 + 2 * slot;
        if entry + 2 > self.fields.1 {
            return None;
        }
        let offset = u16::from_le_bytes(bytes(self.buffer, self.fields.0 + entry)?);
        (offset != 0).then_some(self.at + usize::from(offset))
    }

    /// A field of 64 bits; 0 when it is absent, as the format has it.
    pub(super) fn i64(&self, slot: usize) -> i64 {
        self.field(slot).and_then(|at| bytes(self.buffer, at)).map_or(0, i64::from_le_bytes)
    }

    /// A field of 32 bits; 0 when it is absent.
    pub(super) fn i32(&self, slot: usize) -> i32 {
        self.field(slot).and_then(|at| bytes(self.buffer, at)).map_or(0, i32::from_le_bytes)
    }

    /// A field of 16 bits; 0 when it is absent.
    pub(super) fn i16(&self, slot: usize) -> i16 {
        self.field(slot).and_then(|at| bytes(self.buffer, at)).map_or(0, i16::from_le_bytes)
    }

    /// A field of 8 bits; 0 when it is absent.
    pub(super) fn i8(&self, slot: usize) -> i8 {
        self.field(slot).and_then(|at| bytes(self.buffer, at)).map_or(0, i8::from_le_bytes)
    }

    /// A field that is a structure of two 32-bit numbers.
    pub(super) fn two_i32(&self, slot: usize) -> Option<(i32, i32)> {
        let at = self.field(slot)?;
        Some((i32::from_le_bytes(bytes(self.buffer, at)?), i32::from_le_bytes(bytes(self.buffer, at + 4)?)))
    }

    /// Has the table this field?
    pub(super) fn has(&self, slot: usize) -> bool {
        self.field(slot).is_some()
    }

    /// Where a vector's elements begin in the buffer, and how many it says there are.
    fn vector_at(&self, slot: usize) -> Option<(usize, usize)> {
        let at = self.field(slot)?;
        let vector = at.checked_add(u32_at(self.buffer, at)?)?;
        Some((vector.checked_add(4)?, u32_at(self.buffer, vector)?))
    }

    /// How many elements a vector says to have; 0 when it is absent.
    pub(super) fn vector_length(&self, slot: usize) -> Option<usize> {
        if self.has(slot) { self.vector_at(slot).map(|(_, count)| count) } else { Some(0) }
    }

    /// The bytes of a vector of elements of `size` bytes; empty when it is absent, `None` when it does not
    /// fit into the buffer.
    pub(super) fn vector(&self, slot: usize, size: usize) -> Option<&'a [u8]> {
        if !self.has(slot) {
            return Some(&[]);
        }
        let (start, count) = self.vector_at(slot)?;
        self.buffer.get(start..start.checked_add(count.checked_mul(size)?)?)
    }

    /// The tables that a vector points to. Those that are damaged are `None`.
    pub(super) fn tables(&self, slot: usize) -> impl Iterator<Item = Option<Table<'a>>> + use<'a> {
        let buffer = self.buffer;
        let pointers = self.vector(slot, 4).unwrap_or_default();
        let start = self.vector_at(slot).map_or(0, |(start, _)| start);
        (0..pointers.len() / 4).map(move |k| {
            let at = start + 4 * k;
            Table::at(buffer, at.checked_add(u32_at(buffer, at)?)?)
        })
    }
}
