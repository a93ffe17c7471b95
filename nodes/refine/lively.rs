//! Where and when pixels fire in company: nothing is seen to move elsewhere.

use photocurrent_core::Extent;
use photocurrent_sensor::map::MapEvent;

/// Side of the squares that are lively or not, pixels.
const SIDE: usize = 8;
/// A place is lively that has a lively square so many squares away: as far as the widest look at a neighbourhood reaches.
const AROUND: usize = 3;
/// Length of the times that are lively or not, ns.
const STEP_NS: i64 = 16_000_000;
/// An event is company for what happens so long before and after it, ns.
const LONG_NS: i64 = 12_000_000;

/// Which squares of the sensor are lively at which times.
pub(super) struct Lively {
    columns: usize,
    lines: usize,
    start_ns: i64,
    /// Square after square of time after time: does it fire, and is it lively?
    fires: Vec<bool>,
    is: Vec<bool>,
}

impl Lively {
    /// From the events of all pixels, with column and row; an event that has no other of its polarity near carries no information.
    pub fn new<'a>(extent: Extent, span: (i64, i64), events: impl Iterator<Item = (usize, usize, &'a [MapEvent])>) -> Lively {
        let (columns, lines) = ((extent.width as usize).div_ceil(SIDE), (extent.height as usize).div_ceil(SIDE));
        let times = ((span.1 - span.0) / STEP_NS + 1) as usize;
        let none = vec![false; times * columns * lines];
        let mut lively = Lively { columns, lines, start_ns: span.0, fires: none, is: Vec::new() };
        for (x, y, events) in events {
            for event in events.iter().filter(|event| !event.is_lone) {
                for time in lively.times((event.t_in_ns - LONG_NS, event.t_in_ns + LONG_NS)) {
                    lively.fires[(time * lines + y / SIDE) * columns + x / SIDE] = true;
                }
            }
        }
        lively.is = lively.fires.chunks_exact(columns * lines).flat_map(|squares| lively.around(squares, AROUND)).collect();
        lively
    }

    /// Squares that lie no more than so many squares from some.
    fn around(&self, squares: &[bool], reach: usize) -> Vec<bool> {
        let Lively { columns, lines, .. } = *self;
        let mut around = vec![false; squares.len()];
        for at in (0..squares.len()).filter(|at| squares[*at]) {
            let (line, column) = (at / columns, at % columns);
            for line in line.saturating_sub(reach)..usize::min(line + reach + 1, lines) {
                around[line * columns + column.saturating_sub(reach)..line * columns + usize::min(column + reach + 1, columns)].fill(true);
            }
        }
        around
    }

    /// Squares of which one holds at some time between two instants.
    fn at_some(&self, of: &[bool], between: (i64, i64)) -> Vec<bool> {
        let mut squares = vec![false; self.columns * self.lines];
        for time in self.times(between) {
            squares.iter_mut().zip(&of[time * self.columns * self.lines..]).for_each(|(square, is)| *square |= is);
        }
        squares
    }

    /// Which pixels, row by row, lie in or next to a square that fires in company between two instants.
    pub fn pixels(&self, between: (i64, i64), extent: Extent) -> Vec<bool> {
        let squares = self.around(&self.at_some(&self.fires, between), 1);
        let of_row = |y: usize| (0..extent.width as usize).map(move |x| y / SIDE * self.columns + x / SIDE);
        (0..extent.height as usize).flat_map(of_row).map(|square| squares[square]).collect()
    }

    /// Numbers of those of these pixels, by column and row, that are lively at some time between two instants.
    pub fn places(&self, between: (i64, i64), pixels: impl Iterator<Item = (usize, usize)>) -> Vec<usize> {
        let squares = self.at_some(&self.is, between);
        pixels.enumerate().filter(|(_, (x, y))| squares[y / SIDE * self.columns + x / SIDE]).map(|(n, _)| n).collect()
    }

    /// Numbers of the times between two instants.
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

    fn lively(is_lone: bool) -> Lively {
        let event = MapEvent { t_in_ns: 100_000_000, t_off_ns: 100_001_000, polarity: 1, is_lone };
        Lively::new(EXTENT, (0, 1_000_000_000), [(60, 40, &[event][..])].into_iter())
    }

    #[test]
    fn places_near_an_event_in_company_are_lively_for_a_while() {
        let lively = lively(false);
        let at = |x: usize, y: usize, ms: i64| !lively.places((ms * 1_000_000, ms * 1_000_000), [(x, y)].into_iter()).is_empty();
        assert!(at(60, 40, 100) && at(60 + 16, 40 - 16, 100) && at(60, 40, 90) && at(60, 40, 111));
        assert!(!at(60 + 40, 40, 100) && !at(60, 40 + 40, 100) && !at(60, 40, 50) && !at(60, 40, 150));
        // A span of time counts as a whole.
        assert_eq!(lively.places((0, 1_000_000_000), [(0, 0), (60, 40), (199, 99)].into_iter()), [1]);
        let pixels = lively.pixels((0, 1_000_000_000), EXTENT);
        assert!(pixels[40 * 200 + 60] && pixels[33 * 200 + 60] && !pixels[20 * 200 + 60]);
    }

    #[test]
    fn an_event_without_company_is_noise() {
        assert!(lively(true).places((0, 1_000_000_000), [(60, 40)].into_iter()).is_empty());
    }
}
