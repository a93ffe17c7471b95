//! Activity mask: places and times with neighbouring events. Motion is estimated nowhere else.

use photocurrent_core::Extent;

/// Side of the blocks of the mask, pixels.
const SIDE: usize = 8;
/// A block is active if a block within so many blocks had events: three blocks cover the largest window of
/// the flow.
const AROUND: usize = 3;
/// Length of the intervals of the mask, ns.
const STEP_NS: i64 = 16_000_000;
/// An event marks its block so long before and after it, ns.
const LONG_NS: i64 = 12_000_000;

/// Which blocks of the sensor are active in which intervals.
pub struct Activity {
    columns: usize,
    lines: usize,
    start_ns: i64,
    /// Block after block of interval after interval: does it fire, and is it active?
    fires: Vec<bool>,
    is_active: Vec<bool>,
}

impl Activity {
    /// From column, row and in-pixel time of all events but the isolated ones, without another of their
    /// polarity near.
    pub fn new(
        extent: Extent,
        span: (i64, i64),
        events: impl Iterator<Item = (usize, usize, i64)>,
    ) -> Activity {
        let (columns, lines) =
            ((extent.width as usize).div_ceil(SIDE), (extent.height as usize).div_ceil(SIDE));
        let times = ((span.1 - span.0) / STEP_NS + 1) as usize;
        let none = vec![false; times * columns * lines];
        let mut activity = Activity { columns, lines, start_ns: span.0, fires: none, is_active: Vec::new() };
        for (x, y, t_ns) in events {
            for time in activity.times((t_ns - LONG_NS, t_ns + LONG_NS)) {
                activity.fires[(time * lines + y / SIDE) * columns + x / SIDE] = true;
            }
        }
        activity.is_active = activity
            .fires
            .chunks_exact(columns * lines)
            .flat_map(|blocks| activity.dilated(blocks, AROUND))
            .collect();
        activity
    }

    /// Dilates a mask of blocks by `reach` blocks.
    fn dilated(&self, blocks: &[bool], reach: usize) -> Vec<bool> {
        let Activity { columns, lines, .. } = *self;
        let mut around = vec![false; blocks.len()];
        for at in (0..blocks.len()).filter(|at| blocks[*at]) {
            let (line, column) = (at / columns, at % columns);
            for line in line.saturating_sub(reach)..usize::min(line + reach + 1, lines) {
                around[line * columns + column.saturating_sub(reach)
                    ..line * columns + usize::min(column + reach + 1, columns)]
                    .fill(true);
            }
        }
        around
    }

    /// Blocks that are marked in some interval between two instants.
    fn marked_between(&self, of: &[bool], between: (i64, i64)) -> Vec<bool> {
        let mut blocks = vec![false; self.columns * self.lines];
        for time in self.times(between) {
            blocks
                .iter_mut()
                .zip(&of[time * self.columns * self.lines..])
                .for_each(|(block, is)| *block |= is);
        }
        blocks
    }

    /// Which pixels, row by row, lie in or next to a block that fires between two instants.
    pub fn active_pixels(&self, between: (i64, i64), extent: Extent) -> Vec<bool> {
        let blocks = self.dilated(&self.marked_between(&self.fires, between), 1);
        let of_row = |y: usize| (0..extent.width as usize).map(move |x| y / SIDE * self.columns + x / SIDE);
        (0..extent.height as usize).flat_map(of_row).map(|block| blocks[block]).collect()
    }

    /// Indices of the pixels (column, row) that are active at some time between two instants, ns.
    pub fn active_places(
        &self,
        between: (i64, i64),
        pixels: impl Iterator<Item = (usize, usize)>,
    ) -> Vec<usize> {
        let blocks = self.marked_between(&self.is_active, between);
        pixels
            .enumerate()
            .filter(|(_, (x, y))| blocks[y / SIDE * self.columns + x / SIDE])
            .map(|(n, _)| n)
            .collect()
    }

    /// Numbers of the intervals between two instants.
    fn times(&self, (from_ns, to_ns): (i64, i64)) -> std::ops::RangeInclusive<usize> {
        let last = self.fires.len() / (self.columns * self.lines).max(1) - 1;
        let time = |t_ns: i64| ((t_ns - self.start_ns).div_euclid(STEP_NS).max(0) as usize).min(last);
        time(from_ns)..=time(to_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXTENT: Extent = Extent { width: 200, height: 100 };

    #[test]
    fn places_near_neighbouring_events_are_active_for_a_while() {
        let activity = Activity::new(EXTENT, (0, 1_000_000_000), std::iter::once((60, 40, 100_000_000)));
        let at = |x: usize, y: usize, ms: i64| {
            !activity.active_places((ms * 1_000_000, ms * 1_000_000), [(x, y)].into_iter()).is_empty()
        };
        assert!(at(60, 40, 100) && at(60 + 16, 40 - 16, 100) && at(60, 40, 90) && at(60, 40, 111));
        assert!(!at(60 + 40, 40, 100) && !at(60, 40 + 40, 100) && !at(60, 40, 50) && !at(60, 40, 150));
        // A span of time counts as a whole.
        assert_eq!(
            activity.active_places((0, 1_000_000_000), [(0, 0), (60, 40), (199, 99)].into_iter()),
            [1]
        );
        let pixels = activity.active_pixels((0, 1_000_000_000), EXTENT);
        assert!(pixels[40 * 200 + 60] && pixels[33 * 200 + 60] && !pixels[20 * 200 + 60]);
    }
}
