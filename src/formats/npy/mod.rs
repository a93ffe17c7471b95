//! Arrays as numpy stores them: the header of an npy file ([`header`]), where arrays lie in files and npz
//! archives ([`place`]), and events whose columns are such arrays ([`table`]).
//!
//! Source: NEP 1 and `numpy.lib.format`, versions 1 to 3. An npz file is a zip archive of npy files, stored
//! or deflated. Limits: no pickled objects, no complex numbers, no nested records.

pub(crate) mod header;
pub(crate) mod pictures;
pub(crate) mod place;
pub(crate) mod table;
#[cfg(test)]
pub(crate) mod tests;
