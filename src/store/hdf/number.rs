//! Numbers of any width, sign and byte order, and the members of compounds, read as i64, f64 or f32.

use super::locked;
use hdf5_sys::h5i::hid_t;
use hdf5_sys::h5t;
use std::fmt;

/// A type of number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Number {
    /// Signed, 1 byte.
    I8,
    /// Unsigned, 1 byte.
    U8,
    /// Signed, 2 bytes.
    I16,
    /// Unsigned, 2 bytes.
    U16,
    /// Signed, 4 bytes.
    I32,
    /// Unsigned, 4 bytes.
    U32,
    /// Signed, 8 bytes.
    I64,
    /// Unsigned, 8 bytes.
    U64,
    /// Floating point, 4 bytes.
    F32,
    /// Floating point, 8 bytes.
    F64,
}

impl Number {
    /// Bytes of one.
    pub fn bytes(self) -> usize {
        match self {
            Number::I8 | Number::U8 => 1,
            Number::I16 | Number::U16 => 2,
            Number::I32 | Number::U32 | Number::F32 => 4,
            Number::I64 | Number::U64 | Number::F64 => 8,
        }
    }

    /// Floating point?
    pub fn is_float(self) -> bool {
        matches!(self, Number::F32 | Number::F64)
    }

    /// As people write it: "u16".
    pub fn name(self) -> &'static str {
        match self {
            Number::I8 => "i8",
            Number::U8 => "u8",
            Number::I16 => "i16",
            Number::U16 => "u16",
            Number::I32 => "i32",
            Number::U32 => "u32",
            Number::I64 => "i64",
            Number::U64 => "u64",
            Number::F32 => "f32",
            Number::F64 => "f64",
        }
    }
}

impl fmt::Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Where a number stands in the bytes of a row, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    pub(crate) number: Number,
    pub(crate) is_big_endian: bool,
    /// Was it declared as a truth value?
    pub(crate) is_bool: bool,
    pub(crate) offset: usize,
}

impl Field {
    /// Its type of number.
    pub fn number(&self) -> Number {
        self.number
    }

    /// As people write its type: "u16", "bool".
    pub fn name(&self) -> &'static str {
        if self.is_bool { "bool" } else { self.number.name() }
    }

    /// The same field so many bytes later.
    pub(crate) fn later(self, bytes: usize) -> Field {
        Field { offset: self.offset + bytes, ..self }
    }

    /// Does it lie inside rows of so many bytes?
    pub(crate) fn fits(&self, stride: usize) -> bool {
        self.offset.checked_add(self.number.bytes()).is_some_and(|end| end <= stride)
    }

    /// Adds the numbers of all rows as integers: a number that is no integer or too large becomes the nearest
    /// one, NaN becomes 0.
    pub(crate) fn integers(&self, bytes: &[u8], stride: usize, out: &mut Vec<i64>) {
        if !self.fits(stride) {
            return;
        }
        let all = Rows { bytes, stride, field: *self };
        match self.number {
            Number::I8 => all.each(out, |b| i64::from(i8::from_le_bytes(b))),
            Number::U8 => all.each(out, |b| i64::from(u8::from_le_bytes(b))),
            Number::I16 => all.each(out, |b| i64::from(i16::from_le_bytes(b))),
            Number::U16 => all.each(out, |b| i64::from(u16::from_le_bytes(b))),
            Number::I32 => all.each(out, |b| i64::from(i32::from_le_bytes(b))),
            Number::U32 => all.each(out, |b| i64::from(u32::from_le_bytes(b))),
            Number::I64 => all.each(out, i64::from_le_bytes),
            Number::U64 => all.each(out, |b| i64::try_from(u64::from_le_bytes(b)).unwrap_or(i64::MAX)),
            Number::F32 => all.each(out, |b| f32::from_le_bytes(b).round() as i64),
            Number::F64 => all.each(out, |b| f64::from_le_bytes(b).round() as i64),
        }
    }

    /// Adds the numbers of all rows as f64.
    pub(crate) fn floats(&self, bytes: &[u8], stride: usize, out: &mut Vec<f64>) {
        if !self.fits(stride) {
            return;
        }
        let all = Rows { bytes, stride, field: *self };
        match self.number {
            Number::I8 => all.each(out, |b| f64::from(i8::from_le_bytes(b))),
            Number::U8 => all.each(out, |b| f64::from(u8::from_le_bytes(b))),
            Number::I16 => all.each(out, |b| f64::from(i16::from_le_bytes(b))),
            Number::U16 => all.each(out, |b| f64::from(u16::from_le_bytes(b))),
            Number::I32 => all.each(out, |b| f64::from(i32::from_le_bytes(b))),
            Number::U32 => all.each(out, |b| f64::from(u32::from_le_bytes(b))),
            Number::I64 => all.each(out, |b| i64::from_le_bytes(b) as f64),
            Number::U64 => all.each(out, |b| u64::from_le_bytes(b) as f64),
            Number::F32 => all.each(out, |b| f64::from(f32::from_le_bytes(b))),
            Number::F64 => all.each(out, f64::from_le_bytes),
        }
    }
}

/// Numbers in rows.
struct Rows<'a> {
    bytes: &'a [u8],
    stride: usize,
    field: Field,
}

impl Rows<'_> {
    fn each<const W: usize, T>(&self, out: &mut Vec<T>, of: impl Fn([u8; W]) -> T) {
        let Field { offset, is_big_endian, .. } = self.field;
        if self.stride == W && !is_big_endian {
            out.extend(self.bytes.as_chunks::<W>().0.iter().map(|number| of(*number)));
            return;
        }
        out.extend(self.bytes.chunks_exact(self.stride).map(|row| {
            let mut number = [0; W];
            number.copy_from_slice(&row[offset..offset + W]);
            if is_big_endian {
                number.reverse();
            }
            of(number)
        }));
    }
}

/// A stored type: one number, or named numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Form {
    Number(Field),
    Compound(Vec<(String, Field)>),
    /// A text or something else that holds no numbers.
    Other,
}

/// Members of a compound that are looked at.
const MOST_MEMBERS: u32 = 64;

/// What a stored type is. To be called with a live type identifier.
pub(crate) fn form_of(kind: hid_t) -> Form {
    locked(|| {
        if let Some(field) = field_of(kind, 0) {
            return Form::Number(field);
        }
        // SAFETY: plain queries of a live type identifier; names are copied and freed by the library, members
        // closed.
        unsafe {
            if h5t::H5Tget_class(kind) != h5t::H5T_class_t::H5T_COMPOUND {
                return Form::Other;
            }
            let count = u32::try_from(h5t::H5Tget_nmembers(kind)).unwrap_or(0).min(MOST_MEMBERS);
            let member = |at: u32| {
                let name = h5t::H5Tget_member_name(kind, at);
                if name.is_null() {
                    return None;
                }
                let text = std::ffi::CStr::from_ptr(name).to_string_lossy().into_owned();
                hdf5_sys::h5::H5free_memory(name.cast());
                let member = h5t::H5Tget_member_type(kind, at);
                if member < 0 {
                    return None;
                }
                let field = field_of(member, h5t::H5Tget_member_offset(kind, at));
                h5t::H5Tclose(member);
                field.map(|field| (text, field))
            };
            Form::Compound((0..count).filter_map(member).collect())
        }
    })
}

/// A number of one of the standard types. Truth values of h5py are an enumeration of i8.
fn field_of(kind: hid_t, offset: usize) -> Option<Field> {
    use hdf5::globals::*;
    let types: [(Number, i64, i64); 10] = [
        (Number::U8, *H5T_STD_U8LE, *H5T_STD_U8BE),
        (Number::I8, *H5T_STD_I8LE, *H5T_STD_I8BE),
        (Number::U16, *H5T_STD_U16LE, *H5T_STD_U16BE),
        (Number::I16, *H5T_STD_I16LE, *H5T_STD_I16BE),
        (Number::U32, *H5T_STD_U32LE, *H5T_STD_U32BE),
        (Number::I32, *H5T_STD_I32LE, *H5T_STD_I32BE),
        (Number::U64, *H5T_STD_U64LE, *H5T_STD_U64BE),
        (Number::I64, *H5T_STD_I64LE, *H5T_STD_I64BE),
        (Number::F32, *H5T_IEEE_F32LE, *H5T_IEEE_F32BE),
        (Number::F64, *H5T_IEEE_F64LE, *H5T_IEEE_F64BE),
    ];
    // SAFETY: comparisons of live type identifiers; the type below an enumeration is closed.
    unsafe {
        let is_bool = h5t::H5Tget_class(kind) == h5t::H5T_class_t::H5T_ENUM;
        let number = if is_bool { h5t::H5Tget_super(kind) } else { kind };
        if number < 0 {
            return None;
        }
        let found = types.iter().find_map(|&(name, little, big)| {
            let is = |other| h5t::H5Tequal(number, other) > 0;
            if is(little) { Some((name, false)) } else { is(big).then_some((name, true)) }
        });
        if is_bool {
            h5t::H5Tclose(number);
        }
        found.map(|(number, is_big_endian)| Field { number, is_big_endian, is_bool, offset })
    }
}
