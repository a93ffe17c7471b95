//! Texts and small numbers: attributes and scalar strings, in the forms that h5py, MATLAB and we write.
//!
//! A text may be of variable or fixed length, ASCII or UTF-8, a scalar or one element; an integer may have
//! any width.

use super::{Opened, locked};
use crate::error::StoreError;
use hdf5::types::{TypeDescriptor, VarLenUnicode};
use hdf5::{Attribute, Container, Location};
use std::str::FromStr;

/// No text is longer: sensor descriptions and metas take kilobytes to megabytes.
const LONGEST_TEXT: usize = 1 << 28;

impl Opened {
    fn attribute(&self, location: &Location, at: &str, name: &str) -> Result<Option<Attribute>, StoreError> {
        let names = self.wrap(at, "list the attributes", locked(|| location.attr_names()))?;
        if !names.iter().any(|other| other == name) {
            return Ok(None);
        }
        self.wrap(&format!("{at}: attribute `{name}`"), "open it", locked(|| location.attr(name))).map(Some)
    }

    /// A text attribute; `None` when absent.
    pub(crate) fn text_attribute(
        &self,
        location: &Location,
        at: &str,
        name: &str,
    ) -> Result<Option<String>, StoreError> {
        let Some(attribute) = self.attribute(location, at, name)? else { return Ok(None) };
        self.text(&format!("{at}: attribute `{name}`"), &attribute).map(Some)
    }

    /// An integer attribute; `None` when absent.
    pub(crate) fn integer_attribute(
        &self,
        location: &Location,
        at: &str,
        name: &str,
    ) -> Result<Option<i64>, StoreError> {
        let Some(attribute) = self.attribute(location, at, name)? else { return Ok(None) };
        let at = format!("{at}: attribute `{name}`");
        let wrong = |found: String| {
            self.content(&at, found, "one integer", "write the attribute as an integer scalar")
        };
        let kind = self.wrap(
            &at,
            "read its type",
            locked(|| attribute.dtype().and_then(|dtype| dtype.to_descriptor())),
        )?;
        if !matches!(kind, TypeDescriptor::Integer(_) | TypeDescriptor::Unsigned(_)) {
            return Err(wrong(kind.to_string()));
        }
        if locked(|| attribute.size()) != 1 {
            return Err(wrong(format!("the shape {:?}", locked(|| attribute.shape()))));
        }
        let values = self.wrap(&at, "read it", locked(|| attribute.read_raw::<i64>()))?;
        values.first().copied().map(Some).ok_or_else(|| wrong("nothing".into()))
    }

    /// One text, of an attribute or a scalar dataset.
    pub(crate) fn text(&self, at: &str, container: &Container) -> Result<String, StoreError> {
        let wrong = |found: String| self.content(at, found, "one UTF-8 text", "write it as a scalar string");
        let dtype = self.wrap(at, "read its type", locked(|| container.dtype()))?;
        let kind = self.wrap(at, "read its type", locked(|| dtype.to_descriptor()))?;
        if locked(|| container.size()) != 1 {
            return Err(wrong(format!("the shape {:?}", locked(|| container.shape()))));
        }
        match kind {
            TypeDescriptor::VarLenUnicode | TypeDescriptor::VarLenAscii => {
                self.variable_text(at, container, kind == TypeDescriptor::VarLenAscii)
            }
            TypeDescriptor::FixedAscii(size) | TypeDescriptor::FixedUnicode(size) if size <= LONGEST_TEXT => {
                let mut bytes = vec![0u8; size];
                let status = locked(|| {
                    // SAFETY: the buffer holds exactly one element of the stored type, which the size check
                    // above established.
                    unsafe {
                        if is_attribute(container) {
                            hdf5_sys::h5a::H5Aread(container.id(), dtype.id(), bytes.as_mut_ptr().cast())
                        } else {
                            let all = hdf5_sys::h5s::H5S_ALL;
                            hdf5_sys::h5d::H5Dread(
                                container.id(),
                                dtype.id(),
                                all,
                                all,
                                hdf5_sys::h5p::H5P_DEFAULT,
                                bytes.as_mut_ptr().cast(),
                            )
                        }
                    }
                });
                if status < 0 {
                    return Err(StoreError::Library {
                        path: self.path.clone(),
                        at: at.into(),
                        doing: "read the text",
                        detail: "the library gave no reason".into(),
                    });
                }
                while matches!(bytes.last(), Some(0 | b' ')) {
                    bytes.pop();
                }
                String::from_utf8(bytes).map_err(|_| wrong("bytes that are no UTF-8".into()))
            }
            other => Err(wrong(other.to_string())),
        }
    }

    fn variable_text(&self, at: &str, container: &Container, ascii: bool) -> Result<String, StoreError> {
        let wrong =
            || self.content(at, "bytes that are no UTF-8", "one UTF-8 text", "write it as a scalar string");
        let bytes = if ascii {
            let texts =
                self.wrap(at, "read the text", locked(|| container.read_raw::<hdf5::types::VarLenAscii>()))?;
            texts.first().map(|text| text.as_bytes().to_vec())
        } else {
            let texts = self.wrap(at, "read the text", locked(|| container.read_raw::<VarLenUnicode>()))?;
            // `as_bytes`, not `as_str`: the file may lie about its encoding, and the latter would trust it.
            texts.first().map(|text| text.as_bytes().to_vec())
        };
        String::from_utf8(bytes.unwrap_or_default()).map_err(|_| wrong())
    }

    /// Writes a text attribute.
    pub(crate) fn set_text_attribute(
        &self,
        location: &Location,
        name: &str,
        text: &str,
    ) -> Result<(), StoreError> {
        let at = format!("attribute `{name}`");
        let value = self.variable(&at, text)?;
        self.wrap(
            &at,
            "write it",
            locked(|| {
                location
                    .new_attr::<VarLenUnicode>()
                    .create(name)
                    .and_then(|attribute| attribute.write_scalar(&value))
            }),
        )
    }

    /// Writes an integer attribute.
    pub(crate) fn set_integer_attribute(
        &self,
        location: &Location,
        name: &str,
        value: i64,
    ) -> Result<(), StoreError> {
        let result = locked(|| {
            location.new_attr::<i64>().create(name).and_then(|attribute| attribute.write_scalar(&value))
        });
        self.wrap(&format!("attribute `{name}`"), "write it", result)
    }

    /// Writes a number as an attribute.
    pub(crate) fn set_number_attribute(
        &self,
        location: &Location,
        name: &str,
        value: f64,
    ) -> Result<(), StoreError> {
        let result = locked(|| {
            location.new_attr::<f64>().create(name).and_then(|attribute| attribute.write_scalar(&value))
        });
        self.wrap(&format!("attribute `{name}`"), "write it", result)
    }

    /// Writes a scalar text as a dataset: an attribute holds 64 kB at most.
    pub(crate) fn set_text(&self, name: &str, text: &str) -> Result<(), StoreError> {
        let at = format!("/{name}");
        let value = self.variable(&at, text)?;
        let result = locked(|| {
            let dataset = self.file.new_dataset::<VarLenUnicode>().obj_track_times(false).create(name)?;
            dataset.write_scalar(&value)
        });
        self.wrap(&at, "write the text", result)
    }

    fn variable(&self, at: &str, text: &str) -> Result<VarLenUnicode, StoreError> {
        VarLenUnicode::from_str(text).map_err(|_| {
            self.content(at, "a text with a NUL character", "a text without", "remove the NUL character")
        })
    }
}

fn is_attribute(container: &Container) -> bool {
    // SAFETY: a plain query of a live identifier, called under the library's lock.
    unsafe { hdf5_sys::h5i::H5Iget_type(container.id()) == hdf5_sys::h5i::H5I_type_t::H5I_ATTR }
}
