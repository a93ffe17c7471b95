//! Events as lines of text: how a line is laid out ([`sniff`]), how it is read ([`line`]), and a cursor over
//! a file of any size ([`cursor`]).
//!
//! What the lines mean comes from a header line, from comments, or from the user. Lines are parsed by hand,
//! without memory taken per line; decimal seconds become nanoseconds exactly.

pub(crate) mod cursor;
pub(crate) mod fields;
pub(crate) mod layout;
pub(crate) mod line;
pub(crate) mod sniff;
#[cfg(test)]
pub(crate) mod tests;
