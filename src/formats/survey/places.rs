//! Where events come from: pixels, rows, columns.
//!
//! Counters of every pixel up to [`MOST_PIXELS`]; beyond, of rows and columns only. What a scene looks like
//! is smooth over a few pixels; a pixel that fires a hundred times as often as those around it, a row that is
//! silent between rows that are not, and columns that alternate, are the sensor's.

use photocurrent_core::Extent;
use serde::Serialize;

/// Pixels that have counters of their own: 12 bytes each.
pub const MOST_PIXELS: usize = 1 << 24;
/// Pixels and lines that are listed.
const MOST_LISTED: usize = 16;
/// A hot pixel has at least so many events: fewer may be chance.
const FEWEST_OF_HOT: u32 = 32;
/// And so many times as many as the second of the eight around it, one being added to those: the pixels of a
/// line have two like themselves.
const HOT_TIMES: u32 = 24;
/// A row or column is silent when its neighbours have so many events on average.
const FEWEST_AROUND: f64 = 50.0;
/// Half the width of the window of rows or columns that a line is compared with.
const WINDOW: usize = 4;

/// A pixel and its events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct HotPixel {
    /// Column.
    pub x: u32,
    /// Row.
    pub y: u32,
    /// Its events.
    pub events: u32,
}

/// A period in the counts of rows or columns.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LinePattern {
    /// It repeats after so many lines.
    pub period: u32,
    /// The line of the period that differs most, from 0.
    pub phase: u32,
    /// Its events over those of its neighbours.
    pub ratio: f64,
    /// How sure that is, in standard errors.
    pub sigma: f64,
}

/// Counts of lines, rows or columns.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LinesSurvey {
    /// Lines without an event between lines that have many.
    pub silent: u64,
    /// The first of them.
    pub silent_list: Vec<u32>,
    /// Lines with over three times the events of their neighbours.
    pub loud: u64,
    /// The first of them.
    pub loud_list: Vec<u32>,
    /// What repeats.
    pub pattern: Option<LinePattern>,
}

/// Where events come from.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PlacesSurvey {
    /// Largest column and row that has an event.
    pub largest: (u32, u32),
    /// Smallest ones.
    pub smallest: (u32, u32),
    /// Do `active_pixels` and the hot ones hold? Not for arrays that are too large for a counter a pixel.
    pub counted_pixels: bool,
    /// Pixels with an event.
    pub active_pixels: u64,
    /// Pixels that fire far more than those around them.
    pub hot_pixels: u64,
    /// Their share of the events.
    pub hot_share: f64,
    /// Those with most events.
    pub hottest: Vec<HotPixel>,
    /// Rows.
    pub rows: LinesSurvey,
    /// Columns.
    pub columns: LinesSurvey,
    /// Events that repeat time, place and sign of the event of their pixel before.
    pub duplicates: u64,
    /// Times from an event of a pixel to the next of the same sign, counted by powers of two of nanoseconds.
    pub intervals: Vec<u64>,
}

impl PlacesSurvey {
    /// The time below which a share of the same-sign intervals of a pixel lies, ns, within a factor of two;
    /// none without intervals.
    pub fn interval_quantile_ns(&self, share: f64) -> Option<f64> {
        let all: u64 = self.intervals.iter().sum();
        let mut below = 0;
        for (bit, count) in self.intervals.iter().enumerate() {
            below += count;
            if below > 0 && below as f64 >= share * all as f64 {
                return Some(libm::exp2(bit as f64 + 0.5));
            }
        }
        None
    }
}

/// Counts places.
pub(super) struct Places {
    rows: Vec<u64>,
    columns: Vec<u64>,
    /// By row, grown as rows are met: events of each pixel, and the last one's time with its sign in the
    /// lowest bit.
    pixels: Vec<Vec<(u32, i64)>>,
    held: usize,
    is_held: bool,
    smallest: (u16, u16),
    largest: (u16, u16),
    duplicates: u64,
    intervals: [u64; 64],
}

impl Places {
    pub(super) fn new() -> Places {
        Places {
            rows: Vec::new(),
            columns: Vec::new(),
            pixels: Vec::new(),
            held: 0,
            is_held: true,
            smallest: (u16::MAX, u16::MAX),
            largest: (0, 0),
            duplicates: 0,
            intervals: [0; 64],
        }
    }

    /// Takes an event.
    #[inline]
    pub(super) fn add(&mut self, t: i64, x: u16, y: u16, on: u8) {
        let (column, row) = (usize::from(x), usize::from(y));
        if column >= self.columns.len() || row >= self.rows.len() {
            self.columns.resize(self.columns.len().max(column + 1), 0);
            self.rows.resize(self.rows.len().max(row + 1), 0);
        }
        self.rows[row] += 1;
        self.columns[column] += 1;
        self.smallest = (self.smallest.0.min(x), self.smallest.1.min(y));
        self.largest = (self.largest.0.max(x), self.largest.1.max(y));
        if self.is_held {
            self.pixel(t, column, row, on);
        }
    }

    #[inline]
    fn pixel(&mut self, t: i64, column: usize, row: usize, on: u8) {
        if row >= self.pixels.len() {
            self.pixels.resize_with(row + 1, Vec::new);
        }
        if column >= self.pixels[row].len() {
            // To the widest row so far, so that a row grows a few times only.
            let width = self.columns.len().max(column + 1);
            self.held += width - self.pixels[row].len();
            if self.held > MOST_PIXELS {
                self.is_held = false;
                self.pixels = Vec::new();
                return;
            }
            self.pixels[row].resize(width, (0, 0));
        }
        let (count, last) = &mut self.pixels[row][column];
        let now = (t & !1) | i64::from(on & 1);
        if *count > 0 && (*last & 1) == (now & 1) {
            let interval = (now & !1).wrapping_sub(*last & !1);
            if interval == 0 {
                self.duplicates += 1;
            } else if interval > 0 {
                self.intervals[63 - (interval as u64 | 1).leading_zeros() as usize] += 1;
            }
        }
        *count = count.saturating_add(1);
        *last = now;
    }

    pub(super) fn survey(self, stated: Option<Extent>) -> PlacesSurvey {
        let mut found = PlacesSurvey {
            largest: (self.largest.0.into(), self.largest.1.into()),
            smallest: (
                self.smallest.0.min(self.largest.0).into(),
                self.smallest.1.min(self.largest.1).into(),
            ),
            counted_pixels: self.is_held,
            duplicates: self.duplicates,
            intervals: self.intervals.to_vec(),
            ..PlacesSurvey::default()
        };
        let height = stated.map_or(self.rows.len(), |extent| extent.height as usize).max(self.rows.len());
        let width = stated.map_or(self.columns.len(), |extent| extent.width as usize).max(self.columns.len());
        let stretch = |mut counts: Vec<u64>, to: usize| {
            counts.resize(to, 0);
            counts
        };
        let hot = self.hot(&mut found);
        // A hot pixel is no pattern of its row.
        let (mut rows, mut columns) = (stretch(self.rows, height), stretch(self.columns, width));
        for pixel in &hot {
            rows[pixel.y as usize] = rows[pixel.y as usize].saturating_sub(pixel.events.into());
            columns[pixel.x as usize] = columns[pixel.x as usize].saturating_sub(pixel.events.into());
        }
        found.rows = lines(&rows);
        found.columns = lines(&columns);
        found
    }

    fn hot(&self, found: &mut PlacesSurvey) -> Vec<HotPixel> {
        let of =
            |x: usize, y: usize| self.pixels.get(y).and_then(|row| row.get(x)).map_or(0, |(count, _)| *count);
        let (mut hot, mut events, mut all) = (Vec::new(), 0u64, 0u64);
        for (y, row) in self.pixels.iter().enumerate() {
            for (x, (count, _)) in row.iter().enumerate() {
                found.active_pixels += u64::from(*count > 0);
                all += u64::from(*count);
                if *count < FEWEST_OF_HOT {
                    continue;
                }
                // Beyond the edge the edge goes on; so a corner has no neighbours, and is never hot.
                let (right, bottom) = (self.columns.len() - 1, self.rows.len() - 1);
                let mut around = [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)].map(
                    |(dx, dy): (isize, isize)| {
                        of(x.saturating_add_signed(dx).min(right), y.saturating_add_signed(dy).min(bottom))
                    },
                );
                around.sort_unstable();
                if *count > HOT_TIMES * (1 + around[6]) {
                    hot.push(HotPixel { x: x as u32, y: y as u32, events: *count });
                    events += u64::from(*count);
                }
            }
        }
        found.hot_pixels = hot.len() as u64;
        found.hot_share = events as f64 / all.max(1) as f64;
        let mut hottest = hot.clone();
        hottest.sort_by_key(|pixel| (std::cmp::Reverse(pixel.events), pixel.y, pixel.x));
        hottest.truncate(MOST_LISTED);
        found.hottest = hottest;
        hot
    }
}

/// Silent and loud lines, and what repeats.
fn lines(counts: &[u64]) -> LinesSurvey {
    let mut found = LinesSurvey::default();
    let mut ratios = Vec::with_capacity(counts.len());
    for (line, &count) in counts.iter().enumerate() {
        let from = line.saturating_sub(WINDOW);
        let to = (line + WINDOW + 1).min(counts.len());
        let mut neighbours: Vec<u64> =
            (from..to).filter(|other| *other != line).map(|other| counts[other]).collect();
        neighbours.sort_unstable();
        let middle = neighbours.get(neighbours.len() / 2).copied().unwrap_or(0) as f64;
        // An edge of the picture has neighbours on one side only: lines outside of the scene are not silent
        // lines.
        let is_between =
            from + WINDOW == line && to == line + WINDOW + 1 && counts[line - 1] > 0 && counts[line + 1] > 0;
        if count == 0 && is_between && middle >= FEWEST_AROUND {
            found.silent += 1;
            found.silent_list.push(line as u32);
        }
        if count as f64 > 3.0 * (middle + FEWEST_AROUND) {
            found.loud += 1;
            found.loud_list.push(line as u32);
        }
        ratios.push((middle >= FEWEST_AROUND && count > 0).then(|| {
            libm::log(count as f64 / (neighbours.iter().sum::<u64>() as f64 / neighbours.len() as f64))
        }));
    }
    found.silent_list.truncate(MOST_LISTED);
    found.loud_list.truncate(MOST_LISTED);
    // Longer periods are tried where shorter ones show nothing: 4 repeats whatever 2 does.
    found.pattern = [2, 4, 8, 16].into_iter().find_map(|period| pattern(&ratios, period));
    found
}

/// The strongest phase of a period, where it is significant.
fn pattern(ratios: &[Option<f64>], period: usize) -> Option<LinePattern> {
    /// At least so many lines in each phase.
    const FEWEST: usize = 8;
    /// A difference of less than this is nothing that anyone needs to know.
    const LEAST: f64 = 0.05;
    /// Standard errors: of the thirty phases of all periods one is this far off by chance in a hundred
    /// million recordings.
    const SURE: f64 = 7.0;
    let mut strongest: Option<LinePattern> = None;
    for phase in 0..period {
        let of: Vec<f64> = ratios.iter().skip(phase).step_by(period).flatten().copied().collect();
        let others: Vec<f64> = ratios
            .iter()
            .enumerate()
            .filter(|(line, _)| line % period != phase)
            .filter_map(|(_, ratio)| *ratio)
            .collect();
        if of.len() < FEWEST || others.len() < FEWEST {
            return None;
        }
        let ((a, sa), (b, sb)) = (mean_and_error(&of), mean_and_error(&others));
        let sigma = (a - b).abs() / (sa * sa + sb * sb).sqrt().max(1e-12);
        if (a - b).abs() > LEAST && sigma > SURE && strongest.is_none_or(|found| sigma > found.sigma) {
            strongest = Some(LinePattern {
                period: period as u32,
                phase: phase as u32,
                ratio: libm::exp(a - b),
                sigma,
            });
        }
    }
    strongest
}

fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance =
        values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / (n - 1.0).max(1.0);
    (mean, (variance / n).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::random::Random;

    fn survey(events: impl IntoIterator<Item = (u16, u16, u32)>) -> PlacesSurvey {
        let mut places = Places::new();
        let mut t = 0;
        for (x, y, count) in events {
            for _ in 0..count {
                t += 10;
                places.add(t, x, y, 1);
            }
        }
        places.survey(None)
    }

    fn noisy(extra: impl Fn(u16, u16) -> f64) -> PlacesSurvey {
        let mut random = Random::new(1, &[]);
        let mut all = Vec::new();
        for y in 0..64 {
            for x in 0..64 {
                all.push((x, y, (8.0 * extra(x, y) + 2.8 * random.normal()).max(0.0).round() as u32));
            }
        }
        survey(all)
    }

    #[test]
    fn a_pixel_that_never_stops_is_hot_and_an_edge_is_not() {
        let found = noisy(|x, y| if (x, y) == (7, 9) { 100.0 } else { 1.0 });
        assert_eq!((found.hot_pixels, found.hottest[0].x, found.hottest[0].y), (1, 7, 9));
        assert_eq!(noisy(|x, _| if x == 7 { 100.0 } else { 1.0 }).hot_pixels, 0);
    }

    #[test]
    fn silent_and_loud_rows_are_found_by_their_number() {
        let found = noisy(|_, y| [1.0, 0.0, 5.0][usize::from(y == 20) + 2 * usize::from(y == 40)]);
        assert_eq!((found.rows.silent_list, found.rows.loud_list), (vec![], vec![40]));
        let found = survey((0..64).flat_map(|y| (0..64).map(move |x| (x, y, if y == 20 { 0 } else { 3 }))));
        assert_eq!(found.rows.silent_list, [20]);
    }

    #[test]
    fn columns_that_alternate_are_a_pattern_and_noise_is_none() {
        let found = noisy(|x, _| if x % 2 == 1 { 1.3 } else { 1.0 });
        let pattern = found.columns.pattern.unwrap();
        assert_eq!(pattern.period, 2);
        assert!(
            (pattern.ratio - 1.3).abs() < 0.06 || (pattern.ratio - 1.0 / 1.3).abs() < 0.05,
            "{pattern:?}"
        );
        assert_eq!((found.rows.pattern, noisy(|_, _| 1.0).columns.pattern), (None, None));
    }

    #[test]
    fn an_event_that_is_there_twice_is_counted() {
        let mut places = Places::new();
        for (t, on) in [(10, 1), (10, 1), (10, 0), (5_000, 0), (5_000, 0)] {
            places.add(t, 3, 4, on);
        }
        let found = places.survey(Some(Extent { width: 10, height: 10 }));
        assert_eq!((found.duplicates, found.intervals.iter().sum::<u64>(), found.largest), (2, 1, (3, 4)));
    }
}
