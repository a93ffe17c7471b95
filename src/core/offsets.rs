//! Lists of lists in flat columns: offsets and columns of parts cut out and of parts joined.

use crate::time::TimeSpan;
use std::ops::Range;

/// Where the stamps of a rising list lie within the window.
pub(crate) fn range_within(t: &[i64], window: TimeSpan) -> Range<usize> {
    let (from, to) = (t.partition_point(|t| *t < window.start.0), t.partition_point(|t| *t < window.end.0));
    from..to.max(from)
}

/// The ranges of a column, one after the other.
pub(crate) fn gather<T: Copy>(ranges: &[Range<usize>], column: &[T]) -> Vec<T> {
    let mut all = Vec::with_capacity(ranges.iter().map(Range::len).sum());
    ranges.iter().for_each(|range| all.extend_from_slice(&column[range.clone()]));
    all
}

/// Offsets of lists that have the lengths of ranges.
pub(crate) fn offsets_of(ranges: &[Range<usize>]) -> Vec<usize> {
    let mut offsets = vec![0];
    ranges.iter().for_each(|range| offsets.push(offsets[offsets.len() - 1] + range.len()));
    offsets
}

/// Lists of several parts, `(offsets, column)` each, so that the first lists of all parts stand together,
/// then the second ones.
pub(crate) fn interleaved<T: Copy>(parts: &[(&[usize], &[T])]) -> Vec<T> {
    let lists = parts.first().map_or(0, |(offsets, _)| offsets.len().saturating_sub(1));
    let mut all = Vec::with_capacity(parts.iter().map(|(_, column)| column.len()).sum());
    for list in 0..lists {
        parts
            .iter()
            .for_each(|(offsets, column)| all.extend_from_slice(&column[offsets[list]..offsets[list + 1]]));
    }
    all
}

/// Offsets of lists that were [`interleaved`].
pub(crate) fn interleaved_offsets(parts: &[&[usize]]) -> Vec<usize> {
    let lists = parts.first().map_or(0, |offsets| offsets.len());
    (0..lists).map(|list| parts.iter().map(|offsets| offsets[list]).sum()).collect()
}
