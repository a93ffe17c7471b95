//! Events against frames: how late events are, whether the clocks drift apart, and whether the two see one picture.
//!
//! The picture is cut into some four thousand places. Frames give the mean logarithm of each, events their numbers in sixteenths of the frame period;
//! [`photocurrent_sensor::estimate`] finds the shift at which the two agree. The same with the events' picture mirrored shows mirrored data.
//!
//! Limits: places are several pixels wide, so that fine motion shows less; what a scene without motion hides stays hidden.

use super::grid::{Grid, GridSurvey};
use super::pictures::middle;
use super::places::MOST_PIXELS;
use crate::recording::FramesAbout;
use photocurrent_core::Extent;
use photocurrent_sensor::estimate::{self, Centring, Estimate, Stretch};
use serde::Serialize;

/// Places, about.
const PLACES: u32 = 4096;
/// Steps of time from frame to frame.
const STEPS: i64 = 16;
/// Counters of events, at most: recordings with long gaps between frames get wider steps.
const MOST_COUNTERS: usize = 1 << 23;
/// A step of the grey scale: added before the logarithm, as parts of the largest value, so that darkness is finite.
const DARK: f32 = 1.0 / 255.0;

/// A value with its interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Interval {
    /// The value.
    pub value: f64,
    /// Its 95 % interval.
    pub ci95: (f64, f64),
}

impl From<Estimate> for Interval {
    fn from(estimate: Estimate) -> Interval {
        Interval { value: estimate.value, ci95: estimate.ci95 }
    }
}

/// Events against frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LagSurvey {
    /// Pairs of frames that were compared.
    pub pairs: usize,
    /// How late events are, ns; none where the two do not clearly agree.
    pub late_ns: Option<Interval>,
    /// Correlation at that shift, and without one.
    pub correlation: (f64, f64),
    /// Change of the shift, ns a second.
    pub drift_ns_per_s: Option<Interval>,
    /// From the early to the late frames of the drift, s.
    pub drift_over_s: f64,
    /// Whether both lie on one pixel grid; none where sizes do not agree, or nothing moves.
    pub grid: Option<GridSurvey>,
    /// Correlation of where events are with where frames change: as they are, mirrored left to right, top to bottom, both.
    pub mirrored: [f64; 4],
}

/// Frames and events as they come.
pub(super) struct Panel {
    panel: estimate::Panel,
    place_of: Vec<u32>,
    /// Event pixels.
    width: u32,
    height: u32,
    across: u32,
    down: u32,
    /// Of each frame that is read: its stretch and place in it.
    at: Vec<(usize, usize, usize)>,
    now: usize,
    centring: Centring,
    frame: Extent,
    channels: usize,
    dark: f32,
    grid: Option<Grid>,
}

impl Panel {
    /// For frames that will be read, in order; none when there are too few, or sizes are unknown.
    pub fn new(about: &FramesAbout, events: Option<Extent>, chosen: &[usize]) -> Option<Panel> {
        let extent = events.unwrap_or(about.extent);
        if extent.pixels() == 0 || extent.pixels() > MOST_PIXELS || about.extent.pixels() == 0 || chosen.len() < 2 {
            return None;
        }
        let side = (libm::sqrt(extent.pixels() as f64 / f64::from(PLACES)).ceil() as u32).max(1);
        let (across, down) = (extent.width.div_ceil(side), extent.height.div_ceil(side));
        let place_of: Vec<u32> = (0..extent.height).flat_map(|y| (0..extent.width).map(move |x| (y / side) * across + x / side)).collect();
        let mut panel = estimate::Panel::new(&place_of, extent.width, extent.height);
        // Neighbours whose middles rise belong to one stretch.
        let mids: Vec<i64> = chosen.iter().map(|frame| middle(&about.stamps[*frame])).collect();
        let mut periods: Vec<i64> = chosen.windows(2).zip(mids.windows(2)).filter(|(n, _)| n[1] == n[0] + 1).map(|(_, t)| t[1].saturating_sub(t[0])).collect();
        periods.sort_unstable();
        let period = periods.get(periods.len() / 2).copied().filter(|period| *period > 0)?;
        let (mut at, mut from) = (Vec::new(), 0);
        let mut counters = 0;
        while from < chosen.len() {
            let joins = |n: &usize| chosen[*n] == chosen[n - 1] + 1 && mids[*n] > mids[n - 1] && mids[*n].saturating_sub(mids[n - 1]) < 4 * period;
            let to = (from + 1..chosen.len()).find(|n| !joins(n)).unwrap_or(chosen.len());
            let stretch = Stretch::new(mids[from..to].to_vec(), period + period / 4, (period / STEPS).max(1), panel.places());
            counters += stretch.on.len();
            if counters > MOST_COUNTERS {
                break;
            }
            at.extend((from..to).map(|n| (chosen[n], panel.stretches.len(), n - from)));
            panel.stretches.push(stretch);
            from = to;
        }
        let centring = Centring::new(extent.pixels(), period / 4);
        let pairs: Vec<(usize, i64, i64)> =
            at.windows(2).zip(mids.windows(2)).filter(|(at, _)| at[0].1 == at[1].1).map(|(at, mids)| (at[1].0, mids[0], mids[1])).collect();
        let grid = Grid::new(about, extent, &pairs, period);
        let (frame, channels) = (about.extent, about.colour.channels() as usize);
        Some(Panel { panel, place_of, width: extent.width, height: extent.height, across, down, at, now: 0, centring, frame, channels, dark: 0.0, grid })
    }

    /// Takes the values of a frame.
    pub fn picture(&mut self, frame: usize, values: &[f32]) {
        let Ok(found) = self.at.binary_search_by_key(&frame, |at| at.0) else { return };
        let row_values = self.frame.width as usize * self.channels;
        if values.len() < row_values * self.frame.height as usize {
            return;
        }
        if self.dark == 0.0 {
            self.dark = DARK * values.iter().copied().filter(|value| value.is_finite()).fold(0.0, f32::max);
        }
        if let Some(grid) = &mut self.grid {
            grid.picture(frame, values, self.dark);
        }
        let places = self.panel.places();
        let (mut sums, mut counts) = (vec![0.0f32; places], vec![0u32; places]);
        let (dark, scale) = (self.dark.max(1e-6), |at: u32, of: u32, to: u32| ((u64::from(at) * u64::from(to)) / u64::from(of.max(1))) as usize);
        for y in 0..self.frame.height {
            let row = &values[y as usize * row_values..][..row_values];
            let places_of_row = &self.place_of[scale(y, self.frame.height, self.height) * self.width as usize..][..self.width as usize];
            for x in 0..self.frame.width {
                let place = places_of_row[scale(x, self.frame.width, self.width)] as usize;
                let value = row[x as usize * self.channels..][..self.channels].iter().sum::<f32>() / self.channels as f32;
                if value.is_finite() {
                    sums[place] += libm::logf(value.max(0.0) + dark);
                    counts[place] += 1;
                }
            }
        }
        let (_, stretch, within) = self.at[found];
        let log = self.panel.stretches[stretch].frame_mut(within);
        log.iter_mut().zip(sums).zip(counts).for_each(|((log, sum), count)| *log = if count > 0 { sum / count as f32 } else { f32::NAN });
    }

    /// Takes an event.
    #[inline]
    pub fn event(&mut self, t: i64, x: u16, y: u16, on: u8) {
        if u32::from(x) >= self.width || u32::from(y) >= self.height {
            return;
        }
        let pixel = usize::from(y) * self.width as usize + usize::from(x);
        if let Some((t, is_on)) = self.centring.next(pixel, t, on == 1) {
            self.put(pixel, t, is_on);
        }
    }

    fn put(&mut self, pixel: usize, t: i64, is_on: bool) {
        if let Some(grid) = &mut self.grid {
            grid.event(t, pixel % self.width as usize, pixel / self.width as usize, is_on);
        }
        let place = self.place_of[pixel] as usize;
        let holds = |stretch: &Stretch| t >= stretch.start_ns && t.saturating_sub(stretch.start_ns) < stretch.step_ns.saturating_mul(stretch.steps as i64);
        if !self.panel.stretches.get(self.now).is_some_and(holds) {
            // Stretches are in order of time, and hardly overlap.
            let after = self.panel.stretches.partition_point(|stretch| stretch.start_ns <= t);
            let Some(now) = after.checked_sub(1).filter(|now| holds(&self.panel.stretches[*now])) else { return };
            self.now = now;
        }
        self.panel.stretches[self.now].event(t, place, is_on);
    }

    pub fn survey(mut self) -> Option<LagSurvey> {
        let rest: Vec<_> = self.centring.rest().collect();
        rest.into_iter().for_each(|(pixel, t, is_on)| self.put(pixel, t, is_on));
        let pairs = self.panel.pairs();
        if pairs == 0 {
            return None;
        }
        let shift = estimate::offset(&self.panel);
        let drift = shift.and_then(|_| estimate::drift(&self.panel));
        let grid = self.grid.take().and_then(|grid| grid.survey(shift.map_or(0.0, |shift| shift.ns.value)));
        Some(LagSurvey {
            pairs,
            late_ns: shift.map(|shift| shift.ns.into()),
            correlation: shift.map_or((0.0, 0.0), |shift| (shift.correlation, shift.correlation_at_none)),
            drift_ns_per_s: drift.map(|drift| drift.ns_per_s.into()),
            drift_over_s: drift.map_or(0.0, |drift| drift.over_s),
            grid,
            mirrored: self.mirrored(),
        })
    }

    /// Where frames change, against where events are, mirrored in four ways.
    fn mirrored(&self) -> [f64; 4] {
        let places = self.panel.places();
        let (mut frames, mut events) = (vec![0.0; places], vec![0.0; places]);
        for stretch in &self.panel.stretches {
            for frame in 1..stretch.mids_ns.len() {
                let logs = &stretch.log[(frame - 1) * places..(frame + 1) * places];
                for place in 0..places {
                    let change = f64::from((logs[places + place] - logs[place]).abs());
                    frames[place] += if change.is_finite() { change } else { 0.0 };
                }
            }
            for counts in stretch.on.chunks(places).chain(stretch.off.chunks(places)) {
                events.iter_mut().zip(counts).for_each(|(sum, count)| *sum += f64::from(*count));
            }
        }
        // Roots and ranks alike: one hot place must not decide.
        frames.iter_mut().chain(&mut events).for_each(|value| *value = libm::sqrt(*value));
        let at = |x: u32, y: u32| (y * self.across + x) as usize;
        [(false, false), (true, false), (false, true), (true, true)].map(|(flip_x, flip_y)| {
            let pairs = (0..self.down).flat_map(|y| (0..self.across).map(move |x| (x, y)));
            let pairs = pairs.map(|(x, y)| {
                let (fx, fy) = (if flip_x { self.across - 1 - x } else { x }, if flip_y { self.down - 1 - y } else { y });
                (events[at(x, y)], frames[at(fx, fy)])
            });
            correlation(pairs.collect())
        })
    }
}

fn correlation(pairs: Vec<(f64, f64)>) -> f64 {
    let n = pairs.len().max(1) as f64;
    let (a, b) = pairs.iter().fold((0.0, 0.0), |sums, pair| (sums.0 + pair.0 / n, sums.1 + pair.1 / n));
    let (aa, bb, ab) = pairs.iter().fold((0.0, 0.0, 0.0), |s, (x, y)| (s.0 + (x - a) * (x - a), s.1 + (y - b) * (y - b), s.2 + (x - a) * (y - b)));
    if aa * bb > 0.0 { ab / libm::sqrt(aa * bb) } else { 0.0 }
}
