//! What the reader of a file needs of a decoder, and what decoders share.

use super::faults::Faults;
use crate::chunk::{Edge, EventChunk, Trigger};

/// What the reader of a file needs of a decoder.
pub(crate) trait Decoder: Clone + Send + Sync + 'static {
    /// Bytes of a word.
    const WORD: usize;

    /// Decodes whole words; gives the number of bytes that were used.
    fn decode(&mut self, bytes: &[u8], out: &mut EventChunk, triggers: &mut Vec<Trigger>) -> usize;

    /// What was left out so far.
    fn faults(&self) -> &Faults;
}

/// A trigger edge: bit 0 of its word is the level after it.
pub(super) fn trigger(t: i64, word: u16, line: u16) -> Trigger {
    Trigger { t, line, edge: if word & 1 == 1 { Edge::Rising } else { Edge::Falling } }
}
