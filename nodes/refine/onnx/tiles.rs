//! Tiles: a large picture in squares that a network sees one at a time, each with some of its surroundings.
//!
//! Only what lies inside of a square is kept of what the network gives there, so every pixel is refined once.
//! Where the surroundings reach as far as the network looks, the whole picture would have given the same.

/// A picture's width or height is a multiple of this for the network.
pub const MULTIPLE: usize = 16;

/// Along one side: the network's input, and the part of its output that is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileSpan {
    /// First pixel that is seen.
    pub start: usize,
    /// Pixels that are seen, a multiple of [`MULTIPLE`]; those beyond the picture repeat its border.
    pub seen: usize,
    /// First pixel that is kept.
    pub kept: usize,
    /// End of the kept part, at most the picture's side.
    pub end: usize,
}

/// The spans of one side of a picture: `tile` kept pixels each, with `surroundings` on either side of them,
/// both multiples of [`MULTIPLE`].
pub fn spans(side: usize, tile: usize, surroundings: usize) -> Vec<TileSpan> {
    let padded = side.next_multiple_of(MULTIPLE);
    let span = |kept: usize| {
        let start = kept.saturating_sub(surroundings);
        let end = (kept + tile).min(padded);
        TileSpan { start, seen: (end + surroundings).min(padded) - start, kept, end: end.min(side) }
    };
    (0..side).step_by(tile).map(span).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pixel_is_kept_once_and_tiles_begin_where_cells_do() {
        for (side, tile, surroundings) in
            [(1, 16, 16), (16, 16, 0), (100, 32, 16), (346, 256, 48), (260, 256, 48), (500, 64, 32)]
        {
            let spans = spans(side, tile, surroundings);
            let kept: Vec<usize> = spans.iter().flat_map(|span| span.kept..span.end).collect();
            assert_eq!(kept, (0..side).collect::<Vec<_>>());
            for span in spans {
                assert!(span.start % MULTIPLE == 0 && span.seen % MULTIPLE == 0, "{span:?}");
                assert!(span.start <= span.kept && span.end <= span.start + span.seen, "{span:?}");
                assert!(span.start == 0 || span.kept - span.start == surroundings, "{span:?}");
            }
        }
    }

    #[test]
    fn a_picture_that_fits_is_one_tile() {
        assert_eq!(spans(96, 256, 48), [TileSpan { start: 0, seen: 96, kept: 0, end: 96 }]);
        assert_eq!(spans(90, 256, 48), [TileSpan { start: 0, seen: 96, kept: 0, end: 90 }]);
    }
}
