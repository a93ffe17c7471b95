//! Events as voxel grids: counts of events in cells of pixel and time, the form in which networks take them.
//!
//! Each event is shared between the two nearest of `bins` instants, spread evenly from the first to the last
//! instant of a window, by its distance to them (Zhu et al., CVPR 2019, Eqs. (1) and (2)).

use photocurrent_core::events::Polarity;
use photocurrent_core::handle::Band;
use photocurrent_core::{EventBand, Extent};
use photocurrent_solve::pixel_events::StepRule;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// How ON and OFF events are distinguished.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Signs {
    /// ON counts 1, OFF counts -1: one channel a bin.
    #[default]
    Signed,
    /// Both count 1, in channels of their own: those of ON first.
    Separate,
}

/// What the cells of a grid are divided by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Normalise {
    /// Nothing: events.
    #[default]
    #[serde(rename = "none")]
    Nothing,
    /// Cells that are not 0 less their mean, over their standard deviation; left as they are where all are
    /// equal.
    Std,
    /// The largest magnitude.
    Max,
}

/// Between which instants bins are spread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stretch {
    /// The ends of the window.
    #[default]
    Window,
    /// The first and the last event in it.
    Events,
}

/// How a grid is made of the events of a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    /// Instants, at least 1.
    pub bins: usize,
    /// How ON and OFF events are distinguished.
    pub signs: Signs,
    /// What cells are divided by.
    pub normalise: Normalise,
    /// Between which instants bins are spread.
    pub stretch: Stretch,
    /// Time runs backward: the last event comes first, and ON counts as OFF.
    pub reversed: bool,
}

/// An event on the frames' clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Fired {
    t: i64,
    x: u16,
    y: u16,
    is_on: bool,
}

/// All events of a recording in the order of time, 16 bytes each.
#[derive(Default)]
pub struct Timeline(Vec<Fired>);

impl Timeline {
    /// Of a band of all rows; `rule` dates the events.
    pub fn new(band: &EventBand, rule: &StepRule) -> Timeline {
        let mut all = Vec::with_capacity(band.len());
        for y in band.rows().iter() {
            let row = band.row(y);
            let fired = |k: usize| Fired {
                t: rule.time(&row, k),
                x: row.x[k],
                y: y as u16,
                is_on: Polarity::from_bit(row.on[k]) == Polarity::On,
            };
            all.extend((0..row.len()).map(fired));
        }
        // Stable: equal stamps stay in the order of rows.
        all.sort_by_key(|event| event.t);
        Timeline(all)
    }

    /// Of columns of one length, in any order: times in one unit, columns, rows, and 1 for ON.
    pub fn from_columns(t: &[i64], x: &[u16], y: &[u16], on: &[u8]) -> Timeline {
        let at = |k: usize| Fired { t: t[k], x: x[k], y: y[k], is_on: on[k] != 0 };
        let mut all: Vec<Fired> = (0..t.len()).map(at).collect();
        if !all.is_sorted_by_key(|event| event.t) {
            all.sort_by_key(|event| event.t);
        }
        Timeline(all)
    }

    /// The first and the last stamp, ns.
    pub fn span(&self) -> Option<(i64, i64)> {
        Some((self.0.first()?.t, self.0.last()?.t))
    }

    /// By pixel of `size` (width, height): is there no event of it at all?
    pub fn silent(&self, size: (usize, usize)) -> Vec<bool> {
        let mut silent = vec![true; size.0 * size.1];
        for event in &self.0 {
            silent[usize::from(event.y) * size.0 + usize::from(event.x)] = false;
        }
        silent
    }

    /// The grid of a window (its end left out) as [channel][y][x], of pictures of `size` (width, height) at
    /// least as large as the sensor; and its number of events.
    pub fn grid(&self, window: Range<i64>, grid: Grid, size: (usize, usize)) -> (Vec<f32>, usize) {
        let from = self.0.partition_point(|event| event.t < window.start);
        let to = self.0.partition_point(|event| event.t < window.end).max(from);
        let events = &self.0[from..to];
        let plane = size.0 * size.1;
        let mut cells = vec![0.0_f32; grid.channels() * plane];
        let (first, last) = match (grid.stretch, events) {
            (Stretch::Events, [first, .., last]) => (first.t, last.t),
            _ => (window.start, window.end),
        };
        let per_ns = (grid.bins - 1) as f64 / i64::max(last - first, 1) as f64;
        for event in events {
            let forward = (event.t - first) as f64 * per_ns;
            let (at, is_on) = if grid.reversed {
                ((grid.bins - 1) as f64 - forward, !event.is_on)
            } else {
                (forward, event.is_on)
            };
            let at = at.clamp(0.0, (grid.bins - 1) as f64);
            let bin = usize::min(at as usize, grid.bins.saturating_sub(2));
            let share = (at - bin as f64) as f32;
            let (channel, sign) = match grid.signs {
                Signs::Signed => (bin, if is_on { 1.0 } else { -1.0 }),
                Signs::Separate => (bin + if is_on { 0 } else { grid.bins }, 1.0),
            };
            let cell = channel * plane + usize::from(event.y) * size.0 + usize::from(event.x);
            cells[cell] += sign * (1.0 - share);
            if share > 0.0 {
                cells[cell + plane] += sign * share;
            }
        }
        grid.normalise.apply(&mut cells);
        (cells, events.len())
    }

    /// Events near an instant as [ON, OFF][y][x] of pictures of `size` (width, height) at least as large as
    /// the sensor: each counts as 1 at the instant, and linearly less up to `reach_ns` away.
    pub fn near(&self, instant: i64, reach_ns: i64, size: (usize, usize)) -> Vec<f32> {
        let plane = size.0 * size.1;
        let mut counts = vec![0.0_f32; 2 * plane];
        let from = self.0.partition_point(|event| event.t <= instant.saturating_sub(reach_ns));
        for event in self.0[from..].iter().take_while(|event| event.t < instant.saturating_add(reach_ns)) {
            let weight = 1.0 - event.t.abs_diff(instant) as f64 / reach_ns as f64;
            let channel = if event.is_on { 0 } else { plane };
            counts[channel + usize::from(event.y) * size.0 + usize::from(event.x)] += weight as f32;
        }
        counts
    }
}

impl Grid {
    /// Channels of its tensor.
    pub fn channels(&self) -> usize {
        match self.signs {
            Signs::Signed => self.bins,
            Signs::Separate => 2 * self.bins,
        }
    }
}

impl Normalise {
    fn apply(self, cells: &mut [f32]) {
        match self {
            Normalise::Nothing => {}
            Normalise::Std => {
                let filled = || cells.iter().filter(|cell| **cell != 0.0).map(|cell| f64::from(*cell));
                let count = filled().count() as f64;
                let mean = filled().sum::<f64>() / count;
                let deviation =
                    libm::sqrt(filled().map(|cell| (cell - mean) * (cell - mean)).sum::<f64>() / count);
                if deviation > 0.0 {
                    cells
                        .iter_mut()
                        .filter(|cell| **cell != 0.0)
                        .for_each(|cell| *cell = ((f64::from(*cell) - mean) / deviation) as f32);
                }
            }
            Normalise::Max => {
                let largest = cells.iter().fold(0.0, |largest, cell| f32::max(largest, cell.abs()));
                if largest > 0.0 {
                    cells.iter_mut().for_each(|cell| *cell /= largest);
                }
            }
        }
    }
}

/// Largest sensor that stamps can address.
pub fn addresses(extent: Extent) -> bool {
    extent.width <= 1 << 16 && extent.height <= 1 << 16
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (3, 2);
    const PLAIN: Grid = Grid {
        bins: 3,
        signs: Signs::Signed,
        normalise: Normalise::Nothing,
        stretch: Stretch::Window,
        reversed: false,
    };

    /// ON at (1, 0) a quarter into the window 0 .. 1000, OFF at (2, 1) at three quarters of it, one more ON
    /// outside.
    fn timeline() -> Timeline {
        let at = |t, x, y, is_on| Fired { t, x, y, is_on };
        Timeline(vec![at(250, 1, 0, true), at(750, 2, 1, false), at(1000, 0, 0, true)])
    }

    fn cells(grid: Grid) -> Vec<(usize, f32)> {
        timeline()
            .grid(0..1000, grid, SIZE)
            .0
            .into_iter()
            .enumerate()
            .filter(|(_, cell)| *cell != 0.0)
            .collect()
    }

    #[test]
    fn an_event_is_shared_by_the_two_nearest_bins() {
        // Bins at 0, 500 and 1000: both events lie halfway. Cells are (bin * 2 + y) * 3 + x.
        assert_eq!(cells(PLAIN), [(1, 0.5), (7, 0.5), (11, -0.5), (17, -0.5)]);
        assert_eq!(timeline().grid(0..1000, PLAIN, SIZE).1, 2, "the end of the window is left out");
        assert_eq!(cells(Grid { bins: 1, ..PLAIN }), [(1, 1.0), (5, -1.0)]);
    }

    #[test]
    fn events_near_an_instant_count_the_less_the_further_they_are() {
        // Channels of 6 cells: ON at (1, 0) is 250 away from 500, OFF at (2, 1) too, and the third event lies
        // at the reach's end.
        let near = |instant, reach| {
            timeline()
                .near(instant, reach, SIZE)
                .into_iter()
                .enumerate()
                .filter(|(_, n)| *n != 0.0)
                .collect::<Vec<_>>()
        };
        assert_eq!(near(500, 500), [(1, 0.5), (11, 0.5)]);
        assert_eq!(near(1000, 400), [(0, 1.0), (11, 0.375)]);
        assert_eq!(near(5000, 400), []);
    }

    #[test]
    fn polarities_have_channels_of_their_own_when_asked() {
        // ON in channels 0 to 2, OFF in 3 to 5.
        assert_eq!(
            cells(Grid { signs: Signs::Separate, ..PLAIN }),
            [(1, 0.5), (7, 0.5), (29, 0.5), (35, 0.5)]
        );
    }

    #[test]
    fn backward_the_last_event_comes_first_with_the_other_sign() {
        assert_eq!(cells(Grid { reversed: true, ..PLAIN }), [(5, 0.5), (7, -0.5), (11, 0.5), (13, -0.5)]);
    }

    #[test]
    fn bins_are_stretched_over_the_events_when_asked() {
        assert_eq!(cells(Grid { stretch: Stretch::Events, ..PLAIN }), [(1, 1.0), (17, -1.0)]);
    }

    #[test]
    fn filled_cells_are_standardised_and_empty_ones_stay_empty() {
        // 0.5, 0.5, -0.5, -0.5 have mean 0 and standard deviation 0.5.
        assert_eq!(
            cells(Grid { normalise: Normalise::Std, ..PLAIN }),
            [(1, 1.0), (7, 1.0), (11, -1.0), (17, -1.0)]
        );
        assert_eq!(
            cells(Grid { normalise: Normalise::Max, ..PLAIN }),
            [(1, 1.0), (7, 1.0), (11, -1.0), (17, -1.0)]
        );
        let none = timeline().grid(300..700, Grid { normalise: Normalise::Std, ..PLAIN }, SIZE);
        assert!(none.1 == 0 && none.0.iter().all(|cell| *cell == 0.0));
    }
}
