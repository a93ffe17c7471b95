//! HDF5 files of other programs: what is in them, and numbers of any type, read in pieces.
//!
//! Nothing of such a file is trusted. Links to other files, external and virtual storage and filter plugins
//! are off or refused; names are followed one group at a time and never into a cycle; a shape is compared
//! with the stored bytes before memory is taken, and so is every chunk. Filters are undone by us
//! (`hdf::pipeline`): none, deflate, shuffle, fletcher32, LZF, Blosc, Zstandard, LZ4, bitshuffle, Prophesee's
//! ECF.
//!
//! A damaged chunk is a [`Gap`], and reading goes on behind it. A file that ends before its stated end is
//! opened as far as it goes ([`ForeignFile::cut`]): what lies behind its end is a gap, too, or, where it is a
//! header, an error of that dataset. Before all this a copy of this process tries the file (`hdf::trial`):
//! one that ends the library is refused.

use crate::error::StoreError;
use crate::hdf::chunks::{Chunks, Hole};
pub use crate::hdf::number::{Field, Number};
use crate::hdf::number::{Form, form_of};
use crate::hdf::pipeline::Pipeline;
use crate::hdf::{Opened, locked};
use hdf5::{Attribute, Location};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// No chunk of a foreign file may be larger: one is held whole for each dataset that is read.
const LARGEST_CHUNK: usize = 256 << 20;
/// No row (all that stands at one index of the first dimension) may be larger.
const LARGEST_ROW: usize = 1 << 30;
/// Unpacked chunks that are kept for readers that come back in small steps.
const KEPT_BYTES: usize = 8 << 20;
/// No attribute, and nothing that is read in one go, may be larger.
const LARGEST_WHOLE: usize = 64 << 20;

/// An open file.
#[derive(Clone)]
pub struct ForeignFile {
    opened: Opened,
}

impl ForeignFile {
    /// Opens a file for reading.
    ///
    /// # Errors
    /// When it cannot be read, is no HDF5 file, ends the library, or is cut before its directory.
    pub fn open(path: &Path) -> Result<ForeignFile, StoreError> {
        Ok(ForeignFile { opened: Opened::read(path)? })
    }

    pub(crate) fn of(opened: Opened) -> ForeignFile {
        ForeignFile { opened }
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.opened.path
    }

    /// Its size in bytes.
    pub fn bytes(&self) -> u64 {
        self.opened.bytes
    }

    /// "the file is cut at byte 1000 of 2000", of one that ends before its stated end; `None` of a whole
    /// file.
    pub fn cut(&self) -> Option<String> {
        self.opened.cut()
    }

    /// Is there something of this name, `group/group/name`?
    pub fn has(&self, name: &str) -> bool {
        self.opened.exists(name)
    }

    /// Names in a group (empty: the root), sorted; none when there is no such group.
    ///
    /// # Errors
    /// When the file is damaged.
    pub fn names(&self, group: &str) -> Result<Vec<String>, StoreError> {
        let location = match group {
            "" => self.opened.file.as_group(),
            group if !self.has(group) => return Ok(Vec::new()),
            group => locked(|| self.opened.file.group(group)),
        };
        let names = location.and_then(|group| locked(|| group.member_names()));
        let mut names = self.opened.wrap(&format!("/{group}"), "list the group", names)?;
        names.sort();
        Ok(names)
    }

    /// A dataset of numbers; `None` when there is nothing of this name.
    ///
    /// # Errors
    /// When it is no dataset of numbers, lies in other files, uses a filter that is not known, or claims more
    /// than it can hold.
    pub fn dataset(&self, name: &str) -> Result<Option<ForeignDataset>, StoreError> {
        let at = format!("/{name}");
        let Some(dataset) = self.opened.dataset(name)? else { return Ok(None) };
        let memory = self.opened.wrap(&at, "read the number type", locked(|| dataset.dtype()))?;
        let form = form_of(memory.id());
        let item = locked(|| memory.size());
        if form == Form::Other || item == 0 {
            let hint = "is this the file that you meant?";
            return Err(self.opened.content(
                &at,
                "something else than numbers",
                "integers or floating-point numbers, or a compound of them",
                hint,
            ));
        }
        let properties =
            self.opened.wrap(&at, "read how the dataset is stored", locked(|| dataset.create_plist()))?;
        if let Err(filter) = locked(|| Pipeline::of(properties.id())) {
            let hint = format!("pack the file again: h5repack -f GZIP=1 {} OUT", self.path().display());
            return Err(self.opened.content(
                &at,
                format!("numbers packed by {filter}"),
                "a filter that is known (docs/formats.md lists them)",
                hint,
            ));
        }
        let chunk = locked(|| dataset.chunk())
            .map_or(0, |chunk| chunk.iter().fold(item, |bytes, &n| bytes.saturating_mul(n)));
        let shape = locked(|| dataset.shape());
        let row = shape.iter().skip(1).fold(item, |bytes, &n| bytes.saturating_mul(n));
        for (bytes, most, what) in [(chunk, LARGEST_CHUNK, "chunks"), (row, LARGEST_ROW, "rows")] {
            if bytes > most {
                let hint = "write the file again in smaller pieces";
                return Err(self.opened.content(
                    &at,
                    format!("{what} of {bytes} bytes"),
                    format!("{what} of at most {most} bytes"),
                    hint,
                ));
            }
        }
        let chunks = Chunks::new(&self.opened, &at, dataset, memory, true).keeping(KEPT_BYTES);
        Ok(Some(ForeignDataset { inner: Arc::new(Inner { chunks, form, row }) }))
    }

    /// A text, stored as a dataset; `None` when there is nothing of this name.
    ///
    /// # Errors
    /// When it is no text.
    pub fn text(&self, name: &str) -> Result<Option<String>, StoreError> {
        let Some(dataset) = self.opened.dataset(name)? else { return Ok(None) };
        self.opened.text(&format!("/{name}"), &dataset).map(Some)
    }

    /// Names of the attributes of a group or dataset (empty: the root), sorted; none when there is no such
    /// thing.
    ///
    /// # Errors
    /// When the file is damaged.
    pub fn attribute_names(&self, of: &str) -> Result<Vec<String>, StoreError> {
        let Some(location) = self.location(of)? else { return Ok(Vec::new()) };
        let mut names =
            self.opened.wrap(&format!("/{of}"), "list the attributes", locked(|| location.attr_names()))?;
        names.sort();
        Ok(names)
    }

    /// An attribute of a group or dataset (empty: the root); `None` when it is not there or holds neither a
    /// text nor numbers.
    ///
    /// # Errors
    /// When the file is damaged.
    pub fn attribute(&self, of: &str, name: &str) -> Result<Option<Value>, StoreError> {
        let Some(location) = self.location(of)? else { return Ok(None) };
        let at = format!("/{of}: attribute `{name}`");
        if !self
            .opened
            .wrap(&at, "list the attributes", locked(|| location.attr_names()))?
            .iter()
            .any(|other| other == name)
        {
            return Ok(None);
        }
        let attribute = self.opened.wrap(&at, "open it", locked(|| location.attr(name)))?;
        self.value(&at, &attribute)
    }

    pub(crate) fn location(&self, of: &str) -> Result<Option<Location>, StoreError> {
        let file: &Location = &self.opened.file;
        if of.is_empty() {
            return Ok(Some(file.clone()));
        }
        if !self.has(of) {
            return Ok(None);
        }
        let object = locked(|| match self.opened.file.dataset(of) {
            Ok(dataset) => dataset.as_location(),
            Err(_) => self.opened.file.group(of).and_then(|group| group.as_location()),
        });
        self.opened.wrap(&format!("/{of}"), "open it", object).map(Some)
    }

    fn value(&self, at: &str, attribute: &Attribute) -> Result<Option<Value>, StoreError> {
        let kind = self.opened.wrap(at, "read its type", locked(|| attribute.dtype()))?;
        let (count, item) = locked(|| (attribute.size(), kind.size()));
        let Form::Number(field) = form_of(kind.id()) else {
            return Ok(self.opened.text(at, attribute).ok().map(Value::Text));
        };
        let size = count.saturating_mul(item);
        if size > LARGEST_WHOLE.min(self.opened.bytes as usize) {
            return Err(self.opened.content(
                at,
                format!("{count} numbers"),
                "an attribute that fits the file",
                "the file is damaged: copy it again",
            ));
        }
        let mut bytes = vec![0u8; size];
        // SAFETY: the buffer holds all elements of the stored type.
        let status = locked(|| unsafe {
            hdf5_sys::h5a::H5Aread(attribute.id(), kind.id(), bytes.as_mut_ptr().cast())
        });
        if status < 0 {
            let detail = "the library gave no reason".into();
            return Err(StoreError::Library {
                path: self.opened.path.clone(),
                at: at.into(),
                doing: "read it",
                detail,
            });
        }
        Ok(Some(if field.number().is_float() {
            let mut numbers = Vec::new();
            field.floats(&bytes, item, &mut numbers);
            Value::Floats(numbers)
        } else {
            let mut numbers = Vec::new();
            field.integers(&bytes, item, &mut numbers);
            Value::Integers(numbers)
        }))
    }
}

/// What an attribute holds.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// One text.
    Text(String),
    /// Integers or truth values; one or several.
    Integers(Vec<i64>),
    /// Floating-point numbers; one or several.
    Floats(Vec<f64>),
}

impl Value {
    /// Its numbers as f64; none of a text.
    pub fn numbers(&self) -> Vec<f64> {
        match self {
            Value::Text(_) => Vec::new(),
            Value::Integers(numbers) => numbers.iter().map(|&number| number as f64).collect(),
            Value::Floats(numbers) => numbers.clone(),
        }
    }

    /// Its text; `None` of numbers.
    pub fn text(&self) -> Option<&str> {
        match self {
            Value::Text(text) => Some(text),
            _ => None,
        }
    }
}

/// A dataset of numbers or of compounds of numbers. Cheap to clone; may be read from many threads.
#[derive(Clone)]
pub struct ForeignDataset {
    inner: Arc<Inner>,
}

struct Inner {
    chunks: Chunks,
    form: Form,
    /// Bytes of all that stands at one index of the first dimension.
    row: usize,
}

impl ForeignDataset {
    /// "/events/t".
    pub fn at(&self) -> &str {
        &self.inner.chunks.at
    }

    /// Length along each dimension; none for a scalar.
    pub fn shape(&self) -> &[usize] {
        &self.inner.chunks.shape
    }

    /// Rows: the length of the first dimension; 1 of a scalar.
    pub fn rows(&self) -> usize {
        self.shape().first().copied().unwrap_or(1)
    }

    /// Its numbers; `None` of compounds.
    pub fn numbers(&self) -> Option<Field> {
        match &self.inner.form {
            Form::Number(field) => Some(*field),
            _ => None,
        }
    }

    /// The member of a compound; `None` of numbers, without such a member, or where it would lie outside of
    /// its row: a damaged file can say so.
    pub fn member(&self, name: &str) -> Option<Field> {
        match &self.inner.form {
            Form::Compound(members) => members
                .iter()
                .find(|(other, _)| other == name)
                .map(|(_, field)| *field)
                .filter(|field| field.fits(self.inner.row)),
            _ => None,
        }
    }

    /// The numbers of one column of a dataset \[rows, columns\]; of the only one without a second dimension.
    pub fn column(&self, column: usize) -> Option<Field> {
        let Form::Number(field) = &self.inner.form else { return None };
        let columns = match self.shape() {
            [_] => 1,
            [_, columns] => *columns,
            _ => return None,
        };
        (column < columns).then(|| field.later(column * self.inner.chunks.item))
    }

    /// Reads rows. Damaged pieces become gaps; what they hold then means nothing.
    ///
    /// # Errors
    /// When the file cannot be read, or there are no such rows.
    pub fn rows_at(&self, rows: Range<usize>) -> Result<RowBlock, StoreError> {
        let shape = self.shape();
        let mut block =
            RowBlock { bytes: Vec::new(), row: self.inner.row, first: rows.start, gaps: Vec::new() };
        if rows.start > rows.end || rows.end > self.rows() {
            let chunks = &self.inner.chunks;
            let hint = "the file changed while it was read";
            return Err(chunks.opened.content(
                &chunks.at,
                format!("{} rows", self.rows()),
                format!("rows up to {}", rows.end),
                hint,
            ));
        }
        let bytes = rows.len().checked_mul(self.inner.row).filter(|&bytes| bytes <= LARGEST_ROW);
        let Some(bytes) = bytes else {
            return Err(StoreError::Misuse {
                path: self.inner.chunks.opened.path.clone(),
                what: format!("{} rows were asked for at once", rows.len()),
            });
        };
        block.bytes = vec![0; bytes];
        let (mut start, mut count) = (vec![0; shape.len()], shape.to_vec());
        if let (Some(start), Some(count)) = (start.first_mut(), count.first_mut()) {
            (*start, *count) = (rows.start, rows.len());
        }
        let mut holes = Vec::new();
        self.inner.chunks.read(&start, &count, &mut block.bytes, Some(&mut holes))?;
        for Hole { rows: hole, why } in holes {
            let rows = hole.start.max(rows.start)..hole.end.min(rows.end);
            match block.gaps.last_mut() {
                Some(gap) if gap.rows == rows => {}
                Some(gap) if gap.why == why && gap.rows.end == rows.start => gap.rows.end = rows.end,
                _ => block.gaps.push(Gap { rows, why }),
            }
        }
        Ok(block)
    }

    /// Makes the calls that reading makes, with little to read: of some chunks, or of the first and the last
    /// row.
    pub(crate) fn try_out(&self) {
        self.inner.chunks.try_out();
    }

    /// Rows from the first on that a cut file still holds, found by halving: chunks stand in the order in
    /// which they were written. All rows of a file that is whole, damaged ones included.
    ///
    /// # Errors
    /// As [`ForeignDataset::rows_at`].
    pub fn rows_before_the_cut(&self) -> Result<usize, StoreError> {
        let rows = self.rows();
        if self.inner.chunks.opened.stated_bytes.is_none() {
            return Ok(rows);
        }
        let (mut whole, mut lost) = (0, rows);
        while whole < lost {
            let middle = whole + (lost - whole) / 2;
            if self.rows_at(middle..middle + 1)?.gaps.is_empty() { whole = middle + 1 } else { lost = middle }
        }
        Ok(whole)
    }

    /// All numbers as integers, of a dataset that is small: of a cut file, those before the cut. A damaged
    /// piece is an error.
    ///
    /// # Errors
    /// As [`ForeignDataset::rows_at`], and when the dataset is large, damaged, or holds compounds.
    pub fn integers(&self) -> Result<Vec<i64>, StoreError> {
        let (block, field) = self.small()?;
        let mut numbers = Vec::new();
        field.integers(&block.bytes, field.number().bytes(), &mut numbers);
        Ok(numbers)
    }

    /// All numbers as f64, of a dataset that is small: of a cut file, those before the cut. A damaged piece
    /// is an error.
    ///
    /// # Errors
    /// As [`ForeignDataset::integers`].
    pub fn floats(&self) -> Result<Vec<f64>, StoreError> {
        let (block, field) = self.small()?;
        let mut numbers = Vec::new();
        field.floats(&block.bytes, field.number().bytes(), &mut numbers);
        Ok(numbers)
    }

    fn small(&self) -> Result<(RowBlock, Field), StoreError> {
        let chunks = &self.inner.chunks;
        let wrong = |found: String, expected: &str| {
            chunks.opened.content(&chunks.at, found, expected, "is this the file that you meant?")
        };
        let field = self.numbers().ok_or_else(|| wrong("compounds".into(), "numbers"))?;
        if self.inner.row.saturating_mul(self.rows()) > LARGEST_WHOLE {
            return Err(wrong(format!("the shape {:?}", self.shape()), "a short list"));
        }
        let block = self.rows_at(0..self.rows_before_the_cut()?)?;
        match block.gaps.first() {
            Some(gap) => Err(wrong(gap.why.clone(), "a whole chunk")),
            None => Ok((block, field)),
        }
    }
}

/// Rows that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Gap {
    /// Which, counted from the start of the dataset.
    pub rows: Range<usize>,
    /// Why: "the checksum of a chunk is wrong".
    pub why: String,
}

/// Some rows of a dataset, as they are stored.
pub struct RowBlock {
    bytes: Vec<u8>,
    row: usize,
    first: usize,
    gaps: Vec<Gap>,
}

impl RowBlock {
    /// The first row.
    pub fn first(&self) -> usize {
        self.first
    }

    /// Rows in this block that are damaged or were never written.
    pub fn gaps(&self) -> &[Gap] {
        &self.gaps
    }

    /// Adds a field of every row as integers: the nearest one of other numbers, 0 of NaN.
    pub fn integers(&self, field: Field, out: &mut Vec<i64>) {
        field.integers(&self.bytes, self.row, out);
    }

    /// Adds a field of every row as f64.
    pub fn floats(&self, field: Field, out: &mut Vec<f64>) {
        field.floats(&self.bytes, self.row, out);
    }

    /// Adds all numbers of the rows as f64, for rows of many numbers such as pictures.
    pub fn all(&self, field: Field, out: &mut Vec<f64>) {
        field.floats(&self.bytes, field.number().bytes(), out);
    }
}
